"""The options of `voxflat.flatten`, as type checkers and editors know them for ``mesh.voxflat(...)``.

A test holds that they are those of `voxflat.flatten`, and mypy that a misspelt one is found.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TypeAlias, TypedDict

import pyvista as pv
from numpy.typing import ArrayLike

from voxflat.arguments import Progress

Seed: TypeAlias = "int | Sequence[int] | Sequence[float] | ArrayLike | pv.Cell"
"""A place on a dataset: the number of a point, a position (three floats), or a cell; of images a voxel, too."""


class PlaceOptions(TypedDict, total=False):
    """What of an image is foreground, and how much memory and how many threads are used."""

    label: int | None
    threshold: float | None
    threads: int | None
    memory_limit: int | None
    progress: Progress | None


class PartOptions(PlaceOptions, total=False):
    """Which part of a surface, and where it is cut."""

    keep: object | None
    drop: object | None
    seed_point: Seed | None
    radius: float | None
    polygon: ArrayLike | None
    cuts: object | None
    sphere: object | None


class CutOptions(PartOptions, total=False):
    """Where it is cut further."""

    relax: float | bool | None
    adapt: float | None


class FlattenOptions(CutOptions, total=False):
    """How it is flattened."""

    method: str
    mirror: bool
    sources: int | ArrayLike | None
    sampling: str | None
    geodesic: str | None
    weighting: float | None
    scale: str | None
    max_area: float | None
    start: object | None
    link_lengths: str | None
    neighbourhood: int | str | None
    starts: int | None
    bound: float | None
    seed: int
    keep_rows: bool
    store: str | os.PathLike[str] | None
