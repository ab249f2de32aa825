"""How near its optimum the default map is: descent from many other starts, and a lower bound that no map can beat.

    make bench-optimum
    python docs/benchmarks/optimum.py --only white-left,sheet --starts 5

On each surface the energy is that of the default map: the same sources, distances and dials. From each start descent
goes on with ten times the steps (`patience`). Starts are maps from other sources (other landmarks and decimations, 400
or other numbers of them) and of other weightings, the published map, Tutte's maps to a circle and to ellipses whose
axis lies elsewhere, and the default's own map stretched, warped, or as it is. Rotations alone change no energy.

Said are the default's energy, the least that was found and how far below it is, and from which start. Beside it stands
the mean relative error among some random points by exact distances, the default's and the least map's at their best
scales, and what no places in the plane can beat (`optimum_bound`).
"""

import argparse
import sys
import time
from pathlib import Path

import anatomy
import maps_published
import maps_tables
import numpy as np
import optimum_bound
from distances_tables import table

import voxflat

PATIENCE = 10
POINTS = 40
AIM = 0.01
NOTHING = 1e-4  # an energy of which it does not matter how much less another one is
FINE = 30_000  # vertices up to which Tutte's maps begin
FRESH = ("seed", "sources", "weighting", "tutte", "warp")


def main():
    """Print a row for each surface; fail if a map is more than 1 % above the least."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help=f"surfaces, with commas between: {', '.join(SURFACES)}")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--suit", type=Path, help="into which suitpy was put, as `make bench-published` does")
    parser.add_argument("--more", nargs="*", type=Path, default=[], help=".npz files with V, F and flat")
    options = parser.parse_args()
    rows, wrong = [], []
    for name in options.only.split(",") if options.only else SURFACES:
        found = SURFACES[name](options)
        if found is None:
            print(f"{name} is left out: give --suit", file=sys.stderr)
            continue
        rows.append(row(name, *found, options, wrong))
    for path in options.more:
        rows.append(row(path.stem, *maps_published.file_disk(path), options, wrong))
    columns = ["surface", "vertices", "starts", "energy", "least", "below %", "from", "within 1 %", "CPU s"]
    columns += ["error among points %", "least map's", "no map below"]
    table("How near the optimum", columns, rows)
    if wrong:
        raise SystemExit("\n".join(wrong))


# ------------------------------------------------------------------------------------------------ surfaces


def _fsaverage5(side, kind):
    return lambda options: maps_tables.fsaverage5_disk(side, kind)


def _mni152(options):
    labels, affine, _ = anatomy.mni152_white_matter("left")
    flat = voxflat.flatten(voxflat.surface(labels, affine=affine, repair="voxels"))
    return flat.points, flat.faces, None


def _suit(kind):
    return lambda options: None if options.suit is None else maps_published.suit_disk(options.suit, kind)


def _sheet(options):
    """Return an irregular sheet, rolled up: but for what its triangles cut off it can be flat."""
    rng = np.random.default_rng(0)
    u, v = (n.astype(float).ravel() for n in np.indices((111, 81)))
    is_inner = (u > 0) & (u < 110) & (v > 0) & (v < 80)
    flat = np.stack([u, v], 1) + is_inner[:, None] * rng.uniform(-0.3, 0.3, (len(u), 2))
    number = np.arange(len(u)).reshape(111, 81)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    angle = flat[:, 0] / 22
    return np.stack([22 * np.cos(angle), 22 * np.sin(angle), flat[:, 1]], 1), faces, flat


SURFACES = {
    f"{kind}-{side}": _fsaverage5(side, kind) for side in ("left", "right") for kind in ("white", "mid", "pial")
}
SURFACES |= {"mni152-left": _mni152, "suit-pial": _suit("pial"), "suit-white": _suit("white"), "sheet": _sheet}


# -------------------------------------------------------------------------------------------------- starts


def row(name, points, faces, published, options, wrong):
    """Return the cells of a surface's row."""
    begun = time.process_time()
    disk = (points, faces)
    default = voxflat.flatten(disk, relax=False)
    surface = voxflat.surface(disk)
    known = {}
    for label, start in starts(disk, default, published, options.starts):
        try:
            known[label] = again(disk, default, start)
        except voxflat.InputError as error:
            print(f"{name}, {label}: {error}", file=sys.stderr)
        else:
            print(f"{name}, {label}: {known[label][0]:.6f}", file=sys.stderr, flush=True)
    energy = default.metadata["descent"]["energies"][-1]
    label = min(known, key=lambda one: known[one][0])
    least, places = known[label]
    below = 1 - least / energy
    if below > AIM and energy > NOTHING:
        wrong.append(f"{name}: the map from {label} has {100 * below:.2f} % less energy than the default")
    near = sum(found < (1 + AIM) * min(least, energy) for found, _ in known.values())
    sample = np.random.default_rng(0).choice(len(surface), POINTS, replace=False)
    rows = surface.geodesic(sample, geodesic="exact")[:, sample].astype(float)
    apart = 0.5 * (rows + rows.T)
    errors = [least_error_at_best_scale(apart, uv[sample]) for uv in (default.uv, places)]
    return [
        name,
        f"{len(points):,}",
        str(len(known)),
        f"{energy:.6f}",
        f"{least:.6f}",
        f"{100 * below:.2f}",
        label,
        f"{near} of {len(known)}",
        f"{time.process_time() - begun:.0f}",
        *(f"{100 * error:.2f}" for error in errors),
        f"{100 * optimum_bound.least_error(apart):.2f}",
    ]


def starts(disk, default, published, count):
    """Yield starts, each with what it is."""
    yield "itself", default.uv
    left = count - 1
    if published is not None:
        yield "published", published
        left -= 1
    for n in range(left):
        kind, number = FRESH[n % len(FRESH)], n // len(FRESH)
        rng = np.random.default_rng(n)
        if kind == "tutte" and len(default) > FINE:
            kind = "seed"
            number += 100
        if kind == "seed":
            yield f"seed {number + 1}", voxflat.flatten(disk, relax=False, seed=number + 1).uv
        elif kind == "sources":
            sources = (200, 800, 100, 1200)[number % 4]
            yield (
                f"{sources} sources",
                voxflat.flatten(disk, method=voxflat.methods.Voxflat(sources=sources), relax=False, seed=number).uv,
            )
        elif kind == "weighting":
            weighting = (0.25, 0.75, 0.0, 1.0)[number % 4]
            yield (
                f"weighting {weighting}",
                voxflat.flatten(disk, method=voxflat.methods.Voxflat(weighting=weighting), relax=False).uv,
            )
        elif kind == "tutte":
            longer = (1.0, 1.5, 2.0, 3.0)[number % 4]
            yield f"ellipse {longer:g}:1", stretched(on_circle(*disk), longer, rng)
        else:
            yield f"warped {number}", warped(stretched(default.uv, 1.2 + 0.2 * number, rng), rng)


def again(disk, default, start):
    """Return the energy that descent ends with from a start, and the map: with the default's sources and distances."""
    core = voxflat.surface(disk).cut(relax=False).surface.core
    sources = default.sources.astype(np.uint32)
    geodesic = default.metadata["geodesic"]
    found = core.voxflat(
        sources,
        0,
        geodesic,
        method=voxflat.methods.Voxflat(start=np.ascontiguousarray(start, float)),
        patience=PATIENCE,
    )
    return found["convergence"][0][-1], found["uv"]


def on_circle(points, faces):
    """Return Tutte's map to a circle, by equal springs; its border by the lengths of its edges."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    is_inner = np.isin(ends[:, 0] * len(points) + ends[:, 1], ends[:, 1] * len(points) + ends[:, 0])
    after = dict(ends[~is_inner].tolist())
    loop = [next(iter(after))]
    while (vertex := after[loop[-1]]) != loop[0]:
        loop.append(vertex)
    lengths = np.linalg.norm(points[np.roll(loop, -1)] - points[loop], axis=1)
    angles = 2 * np.pi * (np.cumsum(lengths) - lengths) / lengths.sum()
    places = np.zeros((len(points), 2))
    places[loop] = np.stack([np.cos(angles), np.sin(angles)], 1)
    both = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    links = coo_array((np.ones(len(both)), both.T), shape=(len(points), len(points))).tocsr()
    degree = np.asarray(links.sum(axis=1)).ravel()
    springs = (coo_array((degree, (np.arange(len(points)),) * 2), shape=links.shape) - links).tocsr()
    inner = np.setdiff1d(np.arange(len(points)), loop)
    places[inner] = spsolve(springs[inner][:, inner].tocsc(), -(springs[inner][:, loop] @ places[loop]))
    return places


def stretched(places, longer, rng):
    """Return places stretched along a random direction."""
    angle = rng.uniform(0, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return places @ turn * [np.sqrt(longer), 1 / np.sqrt(longer)]


def warped(places, rng):
    """Return places moved by random waves as long as half of the map, without a fold."""
    size = np.ptp(places, axis=0).max()
    waves = rng.normal(size=(4, 2)) * 2 / size
    ways = rng.normal(size=(4, 2))
    slope = 2 * np.pi * (np.linalg.norm(waves, axis=1) * np.linalg.norm(ways, axis=1)).sum()
    phases = rng.uniform(0, 2 * np.pi, 4)
    return places + 0.7 / slope * np.sin(2 * np.pi * places @ waves.T + phases) @ ways


def least_error_at_best_scale(apart, uv):
    """Return the mean of |s d/δ − 1| over all pairs at the scale s at which it is least."""
    upper = np.triu_indices(len(apart), 1)
    ratio = np.linalg.norm(uv[upper[0]] - uv[upper[1]], axis=1) / apart[upper]
    order = np.argsort(1 / ratio)  # the median of 1/ratio, weighted by ratio
    share = np.cumsum(ratio[order])
    scale = 1 / ratio[order[np.searchsorted(share, 0.5 * share[-1])]]
    return np.abs(scale * ratio - 1).mean()


if __name__ == "__main__":
    main()
