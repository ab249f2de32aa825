"""Recompute random cells of the benchmark without voxflat, from the maps and the surfaces alone.

    python docs/benchmark/recompute.py data maps/given/arap maps/given-arap.json --cells 40

It needs NumPy, SciPy and pygeodesic. The distances of two random sources of each surface are computed by pygeodesic and
compared with the stored ones; with ``--all``, all distances are computed by pygeodesic, which takes long on large
surfaces. A cell differs if it is more than 0.1 points off: 0.1 %, 0.001, 0.1 degrees or one triangle. Maps must be
.npz files of `voxflat bench run` with given cuts, or contain ``uv`` alone.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from pygeodesic import geodesic

LIMITS = {"relative_error": 1e-3, "relative_error_30mm": 1e-3, "relative_error_10mm": 1e-3, "stress_1": 1e-3}
LIMITS |= {"edge": 1e-3, "equal_area_median": 1e-3, "equal_area_p95": 1e-3, "area_beyond_1_5": 1e-3, "angle": 0.1}
LIMITS |= {"flipped": 0.5, "symmetric_dirichlet_mean": 1e-2, "autoflatten_local": 1e-3, "autoflatten_global": 1e-3}
ROWS = 1e-6  # relative difference of distances


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("maps", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--all", action="store_true", help="compute all distances by pygeodesic")
    options = parser.parse_args()
    surfaces = json.loads(options.result.read_text())["surfaces"]
    rng = np.random.default_rng(options.seed)
    cells = [(name, measure) for name in surfaces for measure in LIMITS]
    chosen = sorted(cells[number] for number in rng.permutation(len(cells))[: options.cells])
    wrong = 0
    for name in sorted({name for name, _ in chosen}):
        found = measures(options, name, surfaces[name]["bands"], rng)
        for measure in [measure for other, measure in chosen if other == name]:
            stored, own = surfaces[name]["measures"][measure], found[measure]
            stored = np.inf if stored is None else stored
            differs = not (stored == own or abs(stored - own) <= LIMITS[measure] * max(1, abs(own)))
            wrong += differs
            print(f"{name:24}{measure:26}{stored:12.6f}{own:12.6f}{'  DIFFERS' if differs else ''}", flush=True)
    print(f"{len(chosen) - wrong} of {len(chosen)} cells agree")
    raise SystemExit(wrong > 0)


def measures(options, name, bands, rng):
    with np.load(options.data / name / "cut.npz") as file:
        points, faces = file["points"], file["faces"]
    with np.load(options.maps / f"{name}.npz") as file:
        uv = np.full((len(points), 2), np.nan)
        uv[file["vertices"] if "vertices" in file else np.arange(len(points))] = file["uv"]
    kept = np.isfinite(uv[faces]).all(axis=(1, 2))
    sources, true = distances(options, name, points, faces, rng)
    flat = np.linalg.norm(uv[None] - uv[sources][:, None], axis=2)
    pairs = (true > 0) & np.isfinite(true) & np.isfinite(flat)
    true, flat = true[pairs], flat[pairs]
    scale = best_scale(true, flat)
    relative, raw = np.abs(scale * flat - true) / true, np.abs(flat - true) / true
    found = {"relative_error": relative.mean(), "relative_error_30mm": relative[true <= bands["far"]].mean()}
    found["relative_error_10mm"] = relative[true <= bands["near"]].mean()
    found["stress_1"] = np.sqrt(((scale * flat - true) ** 2).sum() / (true**2).sum())
    found |= {"autoflatten_local": raw[true <= 30].mean(), "autoflatten_global": raw.mean()}
    return found | triangles(points, faces[kept], uv, scale)


def distances(options, name, points, faces, rng):
    """Return sources and their distances: those of pygeodesic, or the stored ones after a check of two sources."""
    with np.load(options.data / name / "truth.npz") as file:
        sources, rows = file["sources"], file["cut"].astype(float)
    solver = geodesic.PyGeodesicAlgorithmExact(points, faces)
    computed = range(len(sources)) if options.all else rng.choice(len(sources), 2, replace=False)
    for number in computed:
        row, _ = solver.geodesicDistances(np.array([sources[number]]), None)
        apart = np.max(np.abs(row - rows[number])[row > 0] / row[row > 0])
        if apart > ROWS:
            raise SystemExit(f"{name}: stored distances from vertex {sources[number]} are {apart:.1e} off")
        rows[number] = row
    return sources, rows


def best_scale(true, flat):
    """Return the scale of the smallest mean relative error, by golden sections: the error is convex."""
    low, high = 0.0, 4 * np.median(true[flat > 0] / flat[flat > 0])
    golden = (np.sqrt(5) - 1) / 2
    while high - low > 1e-7 * high:
        first, second = high - golden * (high - low), low + golden * (high - low)
        if np.abs(first * flat / true - 1).sum() < np.abs(second * flat / true - 1).sum():
            high = second
        else:
            low = first
    return (low + high) / 2


def triangles(points, faces, uv, scale):
    ends = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    curved, flat = (np.linalg.norm(place[ends[:, 0]] - place[ends[:, 1]], axis=1) for place in (points, uv))
    a, b = (points[faces[:, corner]] - points[faces[:, 0]] for corner in (1, 2))
    c, d = (uv[faces[:, corner]] - uv[faces[:, 0]] for corner in (1, 2))
    area = np.linalg.norm(np.cross(a, b), axis=1) / 2
    signed = (c[:, 0] * d[:, 1] - c[:, 1] * d[:, 0]) / 2
    equal = area.sum() / np.abs(signed).sum()  # factor of areas
    at_vertices = [np.bincount(faces.ravel(), np.repeat(of, 3), len(points)) for of in (area, equal * np.abs(signed))]
    used = np.unique(faces)
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.abs(np.log2(at_vertices[1][used] / at_vertices[0][used]))
        ratio = equal * np.abs(signed) / area
        gram = np.stack([(a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)])
        of_map = equal * np.stack([(c * c).sum(axis=1), (c * d).sum(axis=1), (d * d).sum(axis=1)])
        trace = (gram[2] * of_map[0] - 2 * gram[1] * of_map[1] + gram[0] * of_map[2]) / (4 * area**2)
        energy = np.average(trace * (1 + 1 / ratio**2), weights=area)
    beyond = (np.maximum(ratio, 1 / ratio) > 1.5) @ area / area.sum()
    turned = np.degrees(np.abs(angles(points[faces]) - angles(uv[faces]))).mean(axis=1) @ area / area.sum()
    found = {"edge": np.mean(np.abs(scale * flat / curved - 1)), "angle": turned, "area_beyond_1_5": beyond}
    found |= {"equal_area_median": np.median(change), "equal_area_p95": np.percentile(change, 95)}
    flipped = min((signed > 0).sum(), (signed < 0).sum())
    return found | {"flipped": flipped, "symmetric_dirichlet_mean": energy}


def angles(corners):
    following, preceding = (np.roll(corners, step, axis=1) - corners for step in (-1, 1))
    norms = np.linalg.norm(following, axis=2) * np.linalg.norm(preceding, axis=2)
    return np.arccos(np.clip((following * preceding).sum(axis=2) / norms, -1, 1))


if __name__ == "__main__":
    main()
