"""Shapes that flat maps find hard: those of the tests, and what becomes of each."""

import sys
from pathlib import Path

from distances_tables import table

import voxflat

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))

import hard_shapes


def adversarial(options):
    """Flatten the shapes of `tests/methods/test_adversarial.py`."""
    rows = []
    for shape in (*hard_shapes.MESHES, *hard_shapes.VOLUMES):
        name = shape.__name__.replace("_", " ")
        try:
            made = voxflat.flatten(hard_shapes.surface(shape))
        except voxflat.InputError as error:
            rows.append([name, *[""] * 7, str(error)])
            continue
        triangles = made.distortion.triangles
        counts = (triangles.flipped, triangles.collapsed, triangles.covering, triangles.crossings)
        errors = 100 * made.distortion.best_scale.relative_error, 100 * triangles.edge
        said = "; ".join(warning.split(": ")[0] for warning in made.metadata["warnings"])
        rows.append([name, f"{len(made):,}", *(f"{error:.2f}" for error in errors), *map(str, counts), said])
    columns = ("shape", "vertices", "all %", "edges %", "turned over", "without area", "covering", "crossings", "said")
    table("Hard shapes", columns, rows)
