"""The layers of flat maps and pages."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from napari import Viewer
from napari.layers import Labels, Layer
from numpy.typing import NDArray

from voxflat._napari.layers.sampled import Shown
from voxflat._napari.layers.volumes import TimeAxis, finest
from voxflat._napari.results.sketch import Sketches
from voxflat.atlases.atlas import Atlas
from voxflat.io.grid import in_unit
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatImage, Raster
from voxflat.pipeline.flat_series import FlatSeries

LayerData: TypeAlias = tuple[Any, dict[str, Any], str]  # as in napari: the data, the keywords and the type

IMAGE = "voxflat_image"
"""Key of the metadata of images of a map: the `FlatImage` that the layer shows."""


STACK = "voxflat_stack"
"""Key of the metadata of flat volumes: the `FlatStack` from which they were made."""


MOVIE = "voxflat_movie"
"""Key of the metadata of flat movies: a `FlatStack` with the pixels of one frame, and the times of the frames."""


MAPS = "voxflat_maps"
"""Key of the metadata of layers that were read from the file of a movie: its `MovieMaps`."""


KEPT = "voxflat_kept"
"""Key of the metadata of labels from the window of a movie, which are kept in the viewer: a weak reference to its
`MovieMaps`."""


PART = "voxflat_part"
"""Key of the metadata of layers of a map: the part of the map that the layer shows, for `layer_name`."""

_SAME = 1e-3  # pixels, at both ends of an image: other maps have pixels of nearly the same size
_SIMILAR = 0.01  # relative difference between the pixel sizes of similar maps
_ROUNDED = 3  # pixels by which an image may be larger than its map


class Window(Protocol):
    """The window of a movie, a `FlatWindow`."""

    @property
    def drawn(self) -> list[Layer]: ...


@dataclass(frozen=True, eq=False)
class MovieMaps:
    """The maps of all frames of a movie."""

    series: FlatSeries
    time: TimeAxis
    drawn: list[Layer] = field(default_factory=list)  # points and shapes of its window, until it is opened again
    windows: weakref.WeakSet[Window] = field(default_factory=weakref.WeakSet)  # that show it

    @property
    def drawings(self) -> list[Layer]:
        """The layers that the user has drawn or edited in its window."""
        return [*self.drawn, *(layer for window in self.windows for layer in window.drawn)]


@dataclass(frozen=True, eq=False)
class SingleFrame:
    """The frame of a movie to which a single map belongs."""

    number: int
    count: int  # of all frames
    time: TimeAxis

    def hint(self, viewer: Viewer) -> str:
        """Return a message if the viewer displays another frame."""
        shown = self.time.frame(viewer, self.count)
        hint = f"This is the map of frame {self.number}, not of the displayed frame {shown}."
        return "" if shown == self.number else hint


@dataclass(frozen=True, eq=False)
class FlatLayers:
    """A flat map or an atlas, and its layers."""

    flat_map: FlatMap | Atlas
    layers: list[LayerData]  # images: the values that the map shows, if any, and the distortion
    in_space: list[LayerData] = field(default_factory=list)  # the surface of an atlas
    shown: Shown | None = None  # the values chosen in the form
    movie: MovieMaps | None = None
    frame: SingleFrame | None = None  # if only one frame of a movie was flattened
    warnings: tuple[str, ...] = ()  # of the job, such as about the values that the map shows


def layer_name(owner: str, part: str) -> str:
    """Return the name of a layer that shows a part of a map: all names begin with that of the map."""
    return f"{owner} {part}"


def flattened_name(shown: Shown, flat_map: FlatMap | Atlas, of: str) -> str:
    """Return the name of values on a map, with their depth unless they lie at the surface."""
    return f"{of}flattened" + (f", {in_unit_of(flat_map, shown.where)}" if shown.where else "")


def shown_image(flat_map: FlatMap | Atlas, name: str, shown: Shown, pixel_size: float | None) -> LayerData:
    """Return a layer with the values that a map or page shows."""
    image = shown.image(flat_map, pixel_size)
    part = flattened_name(shown, flat_map, "" if shown.name == name else f"{shown.name} ")
    data: NDArray[Any] = image.data
    keywords = {**shown.display, **described(flat_map, name, part, shown.meaning, image)}
    if shown.kind == "labels":
        data = np.nan_to_num(data).astype(np.int64)  # label 0 is transparent, like NaN in an image
    elif image.is_colour:
        keywords["rgb"] = True
    else:
        keywords.setdefault("contrast_limits", limits(data))
    return data, keywords, shown.kind


def units(flat_map: FlatMap | Atlas, axes: int) -> tuple[str, ...] | None:
    """Return the unit of each axis, or None if the flattened layer is in pixels, because napari cannot mix them."""
    return None if flat_map.origin.in_pixels else (unit_of_map(flat_map),) * axes


def unit_of_map(flat_map: FlatMap | Atlas) -> str:
    """Return the unit of a map; an unknown unit is taken as mm."""
    return "mm" if flat_map.origin.unit == "unknown" else flat_map.origin.unit


def in_unit_of(flat_map: FlatMap | Atlas, text: str) -> str:
    """Return a text about lengths in mm in the unit of a map, or without a unit if the flattened layer has none."""
    return in_unit(text, flat_map.origin.named_unit)


def described(
    flat_map: FlatMap | Atlas, owner: str, part: str, meaning: str, image: FlatImage | None = None
) -> dict[str, Any]:
    """Return the name, metadata and position of a layer; rows increase downwards in napari, but v increases upwards."""
    figures = (flat_map.distortion if isinstance(flat_map, FlatMap) else flat_map).figures()
    about: dict[str, Any] = {"voxflat": flat_map, "parameters": flat_map.metadata, "distortion": figures}
    about |= {PART: part, "colours": meaning, "axes": in_unit_of(flat_map, "rows: −v, columns: u, mm")}
    if image is None:
        return {"name": layer_name(owner, part), "metadata": about}
    about[IMAGE] = image
    u, v = image.origin
    place = {"scale": (image.pixel_size,) * 2, "translate": (-v, u), "units": units(flat_map, 2)}
    return {"name": layer_name(owner, part), "metadata": about, **place}


def hidden(data: LayerData) -> LayerData:
    """Hide a layer that the dock shows; RGB layers are hidden later, because napari cannot add them hidden in 3D."""
    values, keywords, kind = data
    return values, {**keywords, "visible": bool(keywords.get("rgb", False))}, kind


def limits(values: NDArray[Any]) -> tuple[float, float]:
    """Return contrast limits that cover most values; the limits that napari would choose may be NaN."""
    values = values.astype(np.float64)  # mesh values may be bool
    if not np.isfinite(values).any():
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.nanpercentile(values, (1, 99)))
    return (low, high) if low < high else (low - 0.5, low + 0.5)


@dataclass(frozen=True)
class Pixels:
    """Square pixels in the plane of a map."""

    shape: tuple[int, ...]
    size: float
    corner: tuple[float, ...]  # (−v, u) of the centre of the first one

    @classmethod
    def of(cls, layer: Layer) -> Pixels | None:
        """Return the pixels along the last two axes of a layer; None if they are not square and upright."""
        ends = np.zeros((3, layer.ndim))
        ends[1, -2] = ends[2, -1] = 1
        corner, down, right = (np.asarray(layer.data_to_world(end))[-2:] for end in ends)
        size = float(right[1] - corner[1])
        if size <= 0 or not np.allclose([down - corner, right - corner], size * np.eye(2), rtol=0, atol=1e-6 * size):
            return None
        return cls(tuple(finest(layer).shape[-2:]), size, tuple(corner.tolist()))

    @classmethod
    def of_raster(cls, raster: Raster) -> Pixels:
        u, v = raster.origin
        return cls(raster.shape, raster.pixel_size, (-v, u))

    def scaled(self, factor: float) -> Pixels:
        """Return the same pixels in another unit of length."""
        first, second = self.corner
        return Pixels(self.shape, factor * self.size, (factor * first, factor * second))

    def is_same(self, other: Pixels) -> bool:
        """Return whether the first and the last pixel are where those of another image are."""
        first = np.subtract(self.corner, other.corner)
        last = first + (self.size - other.size) * (np.array(self.shape) - 1)
        return self.shape == other.shape and bool(np.abs([first, last]).max() < _SAME * self.size)


def is_within(layer: Layer, world: NDArray[np.float64]) -> bool:
    """Return whether a position in the units of a layer lies within its pixels."""
    at = np.round(layer.world_to_data(world))
    return bool((at >= 0).all() and (at < finest(layer).shape[: layer.ndim]).all())


def is_opaque(layer: Layer, world: NDArray[np.float64]) -> bool:
    """Return whether a layer shows a value or a label at a position in its units."""
    value = layer.get_value(world, world=True)
    value = value[1] if layer.multiscale and value is not None else value  # after the level
    if value is None or isinstance(layer, Labels):
        return bool(value)
    pixel = np.asarray(value)
    return bool(pixel[3] > 0) if pixel.shape == (4,) else not np.isnan(pixel).any()


def place_of(layer: Layer, world: NDArray[np.float64]) -> tuple[float, float]:
    """Return the place (u, v) on its map of a position in the units of a flat layer, which the user may have moved."""
    image: FlatImage | None = layer.metadata.get(IMAGE)
    if image is None:
        return float(world[-1]), float(-world[-2])
    row, column = np.asarray(layer.world_to_data(world)).tolist()
    u, v = image.affine[:2] @ [row, column, 0, 1]
    return float(u), float(v)


class Script(Protocol):
    """Writes a script, like `Recipe`."""

    def needs_folder(self) -> bool: ...
    def script(self, folder: Path | None = None) -> str: ...


@dataclass(eq=False)
class Run:
    """A map or an atlas with its layers, the name of the flattened layer, and, if voxflat computed it, a script.

    The names of its layers begin with its title. A viewer makes the titles of its runs unique.
    """

    layers: FlatLayers
    name: str
    script: Script | None = None
    sketches: Sketches = field(default_factory=Sketches)
    title: str = ""

    def __post_init__(self) -> None:
        self.title = self.title or self.name

    @property
    def flat_map(self) -> FlatMap | Atlas:
        return self.layers.flat_map

    @property
    def pixels(self) -> list[Pixels]:
        """The pixels of the images of this map."""
        found = [
            Pixels(np.shape(data)[:2], float(keywords["scale"][0]), tuple(keywords["translate"]))
            for data, keywords, _ in self.layers.layers
        ]
        if self.layers.movie is not None and isinstance(self.flat_map, FlatMap):  # its images have the usual pixels
            found.append(Pixels.of_raster(self.flat_map.raster()))
        return found

    def has_pixels(self, pixels: Pixels) -> bool:
        """Return whether pixels are those of an image of this map."""
        return any(own.is_same(pixels) for own in self.pixels)

    def can_have_pixels(self, pixels: Pixels) -> bool:
        """Return whether pixels are those of an image of this map with another size, such as one made in Python.

        Nearly the usual size may be that of a similar map.
        """
        flat_map = self.flat_map
        if not isinstance(flat_map, FlatMap) or abs(pixels.size / flat_map.pixel_size - 1) < _SIMILAR:
            return False
        sides = np.ptp(flat_map.uv, axis=0)[::-1] / pixels.size
        if np.abs(sides - pixels.shape).max() > _ROUNDED:  # not drawn, because the pixels may be small
            return False
        return Pixels.of_raster(flat_map.raster(pixels.size)).is_same(pixels)
