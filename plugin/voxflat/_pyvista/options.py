"""Type definitions of the options of ``mesh.voxflat(...)``, for type checkers and editors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, TypedDict

import pyvista as pv
from numpy.typing import ArrayLike

from voxflat.arguments import Progress
from voxflat.methods import Method
from voxflat.methods.method import Rows

Seed: TypeAlias = "int | Sequence[int] | Sequence[float] | ArrayLike | pv.Cell"
"""A seed point of a dataset: a point number, a position (three floats) or a cell; in an image also a voxel."""


class PlaceOptions(TypedDict, total=False):
    """Options that select the foreground of an image, as in `voxflat.surface`, and control the run."""

    label: int | None
    threshold: float | None
    threads: int | None
    memory_limit: int | None
    progress: Progress | None


class SurfaceOptions(PlaceOptions, total=False):
    """The options of `PlaceOptions`, and the unit of the coordinates, which VTK does not store."""

    unit: str | None


class PartOptions(SurfaceOptions, total=False):
    """Options that choose a part of the surface, as in `Surface.keep`, `drop`, `disk` and `polygon`."""

    keep: object | None
    drop: object | None
    seed_point: Seed | None
    radius: float | None
    polygon: ArrayLike | None


class CutOptions(PartOptions, total=False):
    """Options that place the cuts, as in `Surface.cut`."""

    cuts: object | None
    sphere: object | None
    relax: float | bool | None
    adapt: float | None


class FlattenOptions(CutOptions, total=False):
    """Options for flattening, as in `Surface.flatten`."""

    method: str | Method
    mirror: bool
    rows: Rows
    seed: int


class MeasureOptions(PlaceOptions, total=False):
    """Options for measuring a map, as in `VoxflatAccessor.measure`."""

    sources: int | None
    reference: str | None
    bands: Sequence[float] | None
    seed: int
    progress_bar: bool
