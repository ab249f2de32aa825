"""Draw what flat maps do to areas: published maps and ours, before and now, in the same colours.

    python docs/benchmarks/maps_areas.py PICTURE --suit FOLDER [--more FILE.npz ...] [--before FOLDER]

The surfaces are some of `maps.py --only published`, with the same vertices and cuts. Maps are shown at the scale that
keeps the whole area, turned to lie as ours. `--save` keeps ours as .npy files; `--before` shows such files, as another
state of voxflat made them, between the published maps and today's.
"""

import argparse
from pathlib import Path

import maps_published
import numpy as np
from maps_pareto import turned
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import voxflat
from voxflat.figures.colours import AREA_LABEL, AREAS

MOST = 1.0
"""Where the colours end: half and twice the area."""

BAR = 50.0
"""What a line beside the maps is long, mm."""

PUBLISHED, BEFORE, NOW = "published", "voxflat, before", "voxflat"


def main():
    """Make the maps of each surface, print what areas do, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--suit", type=Path, help="into which suitpy was put, as `make bench-published` does")
    parser.add_argument("--more", nargs="*", type=Path, default=[], help=".npz files with V, F and flat")
    parser.add_argument("--before", type=Path, help="folder of .npy files that --save made")
    parser.add_argument("--save", type=Path, help="folder for our maps, as .npy files by the surfaces' names")
    options = parser.parse_args()
    drawn = {}
    for name, points, faces, published in surfaces(options):
        places = {PUBLISHED: published}
        if options.before is not None:
            places[BEFORE] = np.load(options.before / f"{name}.npy")
        places[NOW] = voxflat.flatten((points, faces), relax=False).uv
        if options.save is not None:
            options.save.mkdir(parents=True, exist_ok=True)
            np.save(options.save / f"{name}.npy", places[NOW])
        drawn[name] = {of: areas(points, faces, turned(one, places[NOW])) for of, one in places.items()}
        for of, (_, _, _, told) in drawn[name].items():
            print(f"{name}, {of}: {told}", flush=True)
    side_by_side(drawn).savefig(options.picture, dpi=110)


def surfaces(options):
    """Yield name, points, faces and published places of fsaverage5, SUIT's cerebellum and files of one's own."""
    yield "fsaverage5 white left", *maps_published.fsaverage5_disk("left", "white")
    if options.suit is not None:
        yield "SUIT pial", *maps_published.suit_disk(options.suit, "pial")
    for path in options.more:
        yield path.stem, *maps_published.file_disk(path)


def areas(points, faces, places):
    """Return places and log2 of the change of area at the scale that keeps the whole, faces, and their figures."""
    triangles = voxflat.measure((points, faces), places, sources=1, reference="graph").triangles
    scale = triangles.equal_area_scale
    told = f"median {triangles.equal_area_median:.2f}, 95 % {triangles.equal_area_p95:.2f}"
    return scale * places, triangles.areal + 2 * np.log2(scale), faces, told


def side_by_side(drawn):
    """Put maps of surfaces, rows, by who made them, columns, into one figure."""
    columns = list(next(iter(drawn.values())))
    sizes = [np.max([np.ptp(one[0], axis=0) for one in row.values()], axis=0) for row in drawn.values()]
    heights = [size[1] / size[0] for size in sizes]
    width = 3.4
    figure = Figure(figsize=(width * len(columns) + 1.3, width * sum(heights) + 0.4 * len(drawn)), layout="constrained")
    grid = figure.subplots(len(drawn), len(columns), squeeze=False, gridspec_kw={"height_ratios": heights})
    look = {"cmap": AREAS, "norm": Normalize(-MOST, MOST), "shading": "gouraud", "rasterized": True}
    for axes, (name, row), size in zip(grid, drawn.items(), sizes, strict=True):
        for one, column in zip(axes, columns, strict=True):
            places, values, faces, told = row[column]
            middle = (places.max(axis=0) + places.min(axis=0)) / 2
            defined = faces[np.isfinite(values)[faces].all(axis=1)]
            one.tripcolor(*(places - middle).T, np.nan_to_num(values), triangles=defined, **look)
            one.plot(*outline(places - middle, faces), color="0.35", linewidth=0.5)
            one.set(aspect="equal", xticks=[], yticks=[], frame_on=False, xlabel=f"|log2|: {told}")
            one.set(xlim=(-0.52 * size[0], 0.52 * size[0]), ylim=(-0.52 * size[1], 0.52 * size[1]))
            if one.get_subplotspec().is_first_row():
                one.set_title(column)
        axes[0].set_ylabel(name)
        corner = -0.5 * size
        axes[0].plot(corner[0] + np.array([0, BAR]), corner[[1, 1]], color="black", linewidth=1.5)
        axes[0].annotate(f"{BAR:g} mm", corner, (0, 3), textcoords="offset points", fontsize=8)
    label = f"{AREA_LABEL}, the whole area kept"
    shown = ScalarMappable(Normalize(-MOST, MOST), AREAS)
    figure.colorbar(shown, ax=grid.ravel().tolist(), label=label, extend="both", aspect=40, fraction=0.05, shrink=0.6)
    return figure


def outline(places, faces):
    """Return the lines of the boundary, with gaps between edges."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, counts = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    lines = places[edges[counts == 1]]
    return np.concatenate([lines, np.full_like(lines[:, :1], np.nan)], axis=1).reshape(-1, 2).T


if __name__ == "__main__":
    main()
