"""Type definitions of options that several methods pass on, for type checkers and editors."""

from collections.abc import Sequence
from typing import TypedDict


class _SamplingOptions(TypedDict, total=False):
    channel: int | str | None
    depth: float | Sequence[float]
    fraction: float | Sequence[float] | None
    layering: str
    interpolation: str | None
    period: float | None
    nan_policy: str
    name: str


class ImageOptions(_SamplingOptions, total=False):
    """Options of `FlatMap.image`."""

    projection: str


class ImagesOptions(_SamplingOptions, total=False):
    """Options of `FlatMap.images` for each frame of a series."""

    depths: int | None
    projection: str | None


class StackOptions(ImagesOptions, total=False):
    """Options of `FlatMap.images`."""

    time_step: float | None


class FigureOptions(TypedDict, total=False):
    """Options of `figures.flat_map`."""

    depth: float | Sequence[float]
    fraction: float | Sequence[float] | None
    layering: str
    opacity: object | None
    parcels: object | None
    table: object | None
    underlay: str
    title: str | None
    width: float | None
