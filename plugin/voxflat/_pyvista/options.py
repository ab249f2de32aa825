"""The options of `voxflat.flatten`, as type checkers and editors know them for ``mesh.voxflat(...)``.

A test holds that they are those of `voxflat.flatten`, and mypy that a misspelt one is found.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TypedDict

from numpy.typing import ArrayLike

from voxflat.arguments import Progress


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
    seed_point: Sequence[int] | int | None
    radius: float | None
    polygon: ArrayLike | None
    cuts: object | None


class FlattenOptions(PartOptions, total=False):
    """How it is flattened."""

    method: str
    sphere: object | None
    mirror: bool
    relax: float | bool | None
    adapt: float | None
    sources: int | ArrayLike | None
    sampling: str | None
    geodesic: str | None
    weighting: float | None
    scale: str | None
    link_lengths: str | None
    neighbourhood: int | str | None
    starts: int | None
    bound: float | None
    seed: int
    keep_rows: bool
    store: str | os.PathLike[str] | None
