"""The options of ``mesh.voxflat(...)``, as type checkers and editors know them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, TypedDict

import pyvista as pv
from numpy.typing import ArrayLike

from voxflat.arguments import Progress
from voxflat.methods import Method
from voxflat.methods.method import Rows

Seed: TypeAlias = "int | Sequence[int] | Sequence[float] | ArrayLike | pv.Cell"
"""A place on a dataset: the number of a point, a position (three floats), or a cell; of images a voxel, too."""


class PlaceOptions(TypedDict, total=False):
    """What of an image is foreground, as in `voxflat.surface`, and run control."""

    label: int | None
    threshold: float | None
    threads: int | None
    memory_limit: int | None
    progress: Progress | None


class SurfaceOptions(PlaceOptions, total=False):
    """The same, and the unit of a mesh."""

    unit: str | None


class PartOptions(SurfaceOptions, total=False):
    """Which part of a surface: `Surface.keep`, `drop`, `disk` and `polygon`."""

    keep: object | None
    drop: object | None
    seed_point: Seed | None
    radius: float | None
    polygon: ArrayLike | None


class CutOptions(PartOptions, total=False):
    """Where it is cut, as in `Surface.cut`."""

    cuts: object | None
    sphere: object | None
    relax: float | bool | None
    adapt: float | None


class FlattenOptions(CutOptions, total=False):
    """How it is flattened, as in `Surface.flatten`."""

    method: str | Method
    mirror: bool
    rows: Rows
    seed: int
