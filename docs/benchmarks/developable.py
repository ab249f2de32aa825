"""Flatten planar and developable surfaces, which have a map without distortion, by voxflat and other tools.

    make bench-developable
    python docs/benchmarks/developable.py --only coarse --shapes u_shape slit

Edges and angles of maps are compared with those of the triangles in space, without scaling. ARAP and SLIM are those of
`make bench-flatten`; `saucan2006` is voxflat's method. "all %" is the mean error of the distances, which are exact.
"""

import argparse

import numpy as np
import tables
from developable_shapes import SHAPES, angle_changes, closed_cube, edge_ratios
from maps_peers import made_by

import voxflat

FINER = {"coarse": 1, "middle": 2, "fine": 5}
"""The divisor of the 2 mm long edges."""

MAPS = {"voxflat": ("voxflat", {}), "ARAP": ("ARAP", {}), "SLIM": ("SLIM", {})}
MAPS |= {"saucan2006": ("voxflat", {"method": "saucan2006", "relax": False})}
"""The tool and options of each map."""

COLUMNS = ("shape", "map", "vertices", "edges, least", "most", "mean %", "angles °, mean", "most", "flipped")
COLUMNS += ("overlapping", "cut edges", "all %", "wall s")

MOST_LONGER, MOST_TURNED = 0.2, 0.1  # limits of the changes of lengths, %, and of angles, degrees


def at(name):
    """Return a section of all shapes at a resolution."""

    def section(options):
        shapes = [shape for shape in SHAPES if shape.__name__ in options.shapes]
        rows = [row for shape in shapes for row in rows_of(shape, FINER[name], options)]
        tables.table(f"Developable surfaces, {name}", COLUMNS, rows)

    return section


def closed(options):
    """Flatten a closed cube, which voxflat cuts open."""
    rows = [row for finer in FINER.values() for row in rows_of(closed_cube, finer, options, ["voxflat"])]
    tables.table("A closed cube", COLUMNS, rows)


def rows_of(shape, finer, options, maps=None):
    points, faces = shape(finer)[:2]
    rows = []
    for name in options.maps if maps is None else maps:
        maker, given = MAPS[name]
        for made in made_by([maker], {"points": points, "faces": faces, "options": given}, options).values():
            rows.append(cells(shape.__name__, name, made, len(points)))
    return rows


def cells(shape, name, made, vertices):
    flat = made.flat
    surface = flat.points, flat.faces.astype(np.int64)
    ratios, changes = edge_ratios(*surface, flat.uv), angle_changes(*surface, flat.uv)
    distortion = voxflat.compare(surface, {name: flat.uv}, sources=100, reference="exact")[name]
    triangles = distortion.triangles
    longer, turned = 100 * np.abs(ratios - 1).max(), changes.max()
    if name == "voxflat":
        tables.judged(longer, ".3f", MOST_LONGER, f"{shape}, {vertices:,} vertices, length of an edge, %")
        tables.judged(turned, ".3f", MOST_TURNED, f"{shape}, {vertices:,} vertices, angle, °")
    return [
        *(shape, name, f"{vertices:,}", f"{ratios.min():.4f}", f"{ratios.max():.4f}"),
        *(f"{100 * np.abs(ratios - 1).mean():.4f}", f"{changes.mean():.4f}", f"{turned:.3f}"),
        *(str(triangles.flipped), str(triangles.covering), str(len(flat.points) - vertices)),
        *(f"{100 * distortion.raw.relative_error:.3f}", f"{made.wall:.1f}"),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [shape.__name__ for shape in SHAPES]
    sections = {name: at(name) for name in FINER} | {"closed": closed}
    parser.add_argument("--only", help=f"comma-separated sections: {', '.join(sections)}")
    parser.add_argument("--shapes", nargs="+", default=names, choices=names)
    parser.add_argument("--maps", nargs="+", default=list(MAPS), choices=MAPS)
    parser.add_argument("--limit", type=float, default=600, help="maximal seconds per map")
    tables.run(sections, parser)


if __name__ == "__main__":
    main()
