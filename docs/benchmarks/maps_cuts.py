"""Judge automatic relaxation cuts: beside those that fsaverage5's flat maps come with, and on whole closed hemispheres.

    python docs/benchmarks/maps_cuts.py [PICTURE]

`make bench-flatten` runs it, too. On fsaverage5 the medial wall is left out as the shipped map leaves it out, and
automatic cuts may be as long as the shipped ones. Each map is judged by the distances on its own cut surface; `uncut`
is its mean relative error against distances on the surface that lacks the medial wall only, between the same 300 points
and all others.
"""

import sys
import time

import anatomy
import numpy as np

import voxflat

SOURCES = 300
HEADER = (
    "| surface | cuts | mm | vertices | wall s | CPU s | all % | ≤ 30 mm % | ≤ 10 mm % | uncut % | stress-1 | edges % "
    "| area: median, 95 % | turned over | covering |"
)


def main():
    """Print the table, and draw the maps of the left hemisphere if a picture is named."""
    print(HEADER)
    print("|---" * HEADER.count("|", 1) + "|", flush=True)
    drawn = {}
    for side in anatomy.SIDES:
        hemisphere = anatomy.fsaverage5(side)
        surface = voxflat.surface((hemisphere["white"], hemisphere["faces"]))
        faces = hemisphere["flat"][1]
        wall, length = shipped_cuts(hemisphere["white"], hemisphere["faces"], faces)
        uncut, cortex = distances(surface, wall, faces), surface.drop(wall)
        for name, mm, part, how in (
            ("medial wall only", 0, cortex, {"relax": False}),
            ("shipped", length, surface.keep((hemisphere["white"], faces)), {}),
            ("automatic", None, cortex, {"relax": length}),
            ("automatic, as long as it pays", None, cortex, {"relax": True}),
        ):
            flat = report(f"fsaverage5 white {side}", name, mm, part, uncut, **how)
            if side == "left" and name in ("shipped", "automatic"):
                drawn[f"{name} cuts"] = flat
    if len(sys.argv) > 1:
        draw(drawn, sys.argv[1])
    for side in anatomy.SIDES:
        labels, affine, _ = anatomy.mni152_white_matter(side)
        surface = voxflat.surface(labels, affine=affine, repair="voxels")
        for name, relax in (("one line", False), ("automatic", None)):
            report(f"MNI152 white matter {side}, whole", name, None, surface, None, relax=relax)


def shipped_cuts(points, faces, flat):
    """Tell the medial wall from the cuts, which are strips, by what a flat map leaves out.

    Returns: `wall`, bool (V,), left-out vertices among left-out ones, and their left-out neighbours; `length`, of the
    cuts, mm: half of what they add to the boundary.
    """
    left_out = np.ones(len(points), dtype=bool)
    left_out[flat] = False
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    inside = left_out.copy()
    inside[ends[~left_out[ends[:, 1]], 0]] = False
    wall = inside.copy()
    wall[ends[inside[ends[:, 1]], 0]] = True
    wall &= left_out
    return wall, (around(points, flat) - around(points, faces[~wall[faces].any(axis=1)])) / 2


def around(points, faces):
    """Return the length of the boundary, mm."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, counts = np.unique(ends, axis=0, return_counts=True)
    once = points[edges[counts == 1]]
    return float(np.linalg.norm(once[:, 0] - once[:, 1], axis=1).sum())


def distances(surface, wall, flat):
    """Measure distances on the surface without the medial wall, from points that all maps have."""
    chosen = np.random.default_rng(0).choice(np.unique(flat), SOURCES, replace=False)
    return surface.drop(wall).geodesic(np.sort(chosen))


def error_on(rows, flat):
    """Return the mean relative error of a map against given distances, at its best scale."""
    places = np.full((rows.ids.max() + 1, 2), np.nan)
    places[flat.ids[::-1]] = flat.uv[::-1]  # of the two sides of a cut the first
    places = places[rows.ids]
    delta = np.asarray(rows, dtype=float)
    apart = np.linalg.norm(places[rows.sources][:, None] - places[None], axis=2)
    known = (delta > 0) & (apart > 0)
    ratio, weight = delta[known] / apart[known], apart[known] / delta[known]
    order = ratio.argsort()
    total = weight[order].cumsum()
    scale = ratio[order[np.searchsorted(total, total[-1] / 2)]]
    return float(np.abs(scale * weight - 1).mean())


def report(surface_name, cuts, length, surface, uncut, /, **how):
    """Make a map, print a row, and return the map."""
    wall, cpu = time.monotonic(), time.process_time()
    flat = voxflat.flatten(surface, **how)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    if length is None:
        length = sum(cut["length"] for cut in flat.metadata["automatic_cuts"])
    of, triangles = flat.distortion.best_scale, flat.distortion.triangles
    against = "" if uncut is None else f"{100 * error_on(uncut, flat):.2f}"
    print(
        f"| {surface_name} | {cuts} | {length:.0f} | {len(flat)} | {wall:.1f} | {cpu:.1f} "
        f"| {100 * of.relative_error:.2f} | {100 * of.relative_error_30mm:.2f} | {100 * of.relative_error_10mm:.2f} "
        f"| {against} | {of.stress_1:.4f} | {100 * triangles.edge:.2f} "
        f"| {triangles.equal_area_median:.3f}, {triangles.equal_area_p95:.3f} "
        f"| {triangles.flipped} | {triangles.covering} |",
        flush=True,
    )
    return flat


def draw(maps, path):
    """Draw maps side by side: how much areas are distorted, and the outline that the cuts make."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(maps), figsize=(6 * len(maps), 5.2), layout="constrained")
    for axis, (name, flat) in zip(axes, maps.items(), strict=True):
        values = 100 * flat.distortion.per_point
        drawn = axis.tripcolor(*flat.uv.T, flat.faces, values, shading="gouraud", cmap="magma", vmin=0, vmax=25)
        ends = np.concatenate([flat.faces[:, [0, 1]], flat.faces[:, [1, 2]], flat.faces[:, [2, 0]]])
        edges, counts = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
        border = flat.uv[edges[counts == 1]]
        axis.plot(*np.moveaxis(border, 2, 0).transpose(0, 2, 1), color="black", linewidth=1)
        error = 100 * flat.distortion.best_scale.relative_error
        axis.set_title(f"fsaverage5 white left, {name}: mean error {error:.1f} %", fontsize=10)
        axis.set_aspect("equal")
        axis.set_axis_off()
    figure.colorbar(drawn, ax=axes, label="mean relative error of distances from a point, %", shrink=0.8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
