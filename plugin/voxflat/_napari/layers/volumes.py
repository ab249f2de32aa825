"""Convert napari Image and Labels layers to volumes in RAS+ positions."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pint
from napari import Viewer
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace, in_units_of, unit_ratio
from voxflat.errors import InputError
from voxflat.io.channels import Timing
from voxflat.io.chunks import is_chunked
from voxflat.io.volumes import Volume


def _units(*names: str) -> tuple[Any, ...]:
    """Return units of napari by their names."""
    return tuple(map(pint.get_application_registry().Unit, names))  # type: ignore[no-untyped-call]


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """The position of the frames of a movie, in the units of its layer."""

    axis: int = -4  # from the last one
    start: float = 0.0  # of frame 0
    step: float = 1.0
    units: tuple[Any, ...] = field(default_factory=partial(_units, "pixel"))  # of the axes before the last three
    others: tuple[tuple[float, float, int], ...] = ()  # start, step and size of the axes between time and space

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> "TimeAxis":
        """Read the position of the frames from the description of a saved movie."""
        others = tuple(map(tuple, record["others"]))
        return cls(**{**record, "units": _units(*record["units"]), "others": others})

    def record(self) -> dict[str, Any]:
        return {**vars(self), "units": list(map(str, self.units))}

    def frame(self, viewer: Viewer, count: int) -> int:
        """Return the frame that a viewer displays."""
        point = viewer.dims.point
        at = point[self.axis] * self._ratio(viewer) if len(point) >= -self.axis else self.start
        return int(np.clip(round((at - self.start) / self.step), 0, count - 1))

    def place(self, frame: int) -> float:
        """Return the position of a frame along the axis."""
        return self.start + frame * self.step

    def go_to(self, viewer: Viewer, frame: int) -> None:
        """Move the time slider of a viewer to a frame."""
        axis = viewer.dims.ndim + self.axis
        if axis >= 0:
            viewer.dims.set_point(axis, self.place(frame) / self._ratio(viewer))

    def _ratio(self, viewer: Viewer) -> float:
        """Return the unit of time of a viewer in that of the layer."""
        units = viewer.layers.units
        known = units is not None and len(units) >= -self.axis
        return float(unit_ratio([units[self.axis]], self.units[:1])[0]) if known else 1.0

    @property
    def timing(self) -> Timing | None:
        """The times of the frames, if the unit of the axis is one of time."""
        if not self.units[0].is_compatible_with("s"):
            return None
        second = float((1 * self.units[0]).to("s").magnitude)
        return Timing.told(self.step * second, self.start * second)

    def leading(self, viewer: Viewer, frame: int) -> tuple[float, ...]:
        """Return the position of a frame along all axes but the last three, at the displayed channel."""
        point, units = viewer.dims.point[self.axis + 1 : -3], viewer.layers.units
        if len(point) != len(self.others):  # the layer was removed
            return self.place(frame), *(start for start, _, _ in self.others)
        ratio = np.ones(len(point)) if units is None else unit_ratio(tuple(units)[self.axis + 1 : -3], self.units[1:])
        return self.place(frame), *(np.asarray(point) * ratio).tolist()

    def placed(self, affine: NDArray[np.float64], frame: int = 0) -> NDArray[np.float64]:
        """Extend the affine of a volume to an array of frames, the first of which is given, and 1 along other axes.

        An axis of size 1 spans all channels, so that they all show the same volume.
        """
        count = -self.axis - 3
        found = np.eye(count + 4)
        found[count:, count:] = affine
        found[0, [0, -1]] = self.step, self.place(frame)
        for row, (start, step, size) in enumerate(self.others, 1):
            found[row, [row, -1]] = size * step, start + step * (size - 1) / 2
        return found


@dataclass(frozen=True, eq=False)
class LayerVolume:
    """The voxels of a layer, read in the GUI thread for use in other threads because the layer may change."""

    data: Any = field(repr=False)  # numpy, dask or zarr; the finest level of a multiscale layer
    place: LayerPlace
    rgb: bool
    step: tuple[int, ...] = ()  # index along each leading axis, such as time or channels

    @classmethod
    def of(cls, layer: Layer, world: str = "RAS", step: tuple[int, ...] = ()) -> "LayerVolume":
        """Read an Image or Labels layer; raises InputError unless it has three length axes in addition to `step`."""
        if layer.ndim - len(step) > 3:
            raise InputError(
                f"Layer '{layer.name}' has {layer.ndim} dimensions, not 3. Split it (Layers → Layer Type → Split "
                "Stack), then choose one of the new layers"
            )
        place = LayerPlace.of(layer, world, len(step))
        return cls(finest(layer), place, getattr(layer, "rgb", False), step)  # Labels layers have no attribute rgb

    @property
    def origin(self) -> dict[str, str]:
        return self.place.origin

    def read(self) -> Volume:
        """Load the voxels, which may be slow for dask and zarr arrays; raises InputError if they are not a volume."""
        data = np.asarray(self.data[self.step] if self.step else self.data)
        return Volume(_bytes(data) if self.rgb else data, self.place.affine, self.place.path, unit=self.place.unit)

    def lazily(self) -> Volume:
        """Return the volume without loading dask and zarr arrays; sampling reads only the chunks that it needs."""
        if self.rgb or not is_chunked(self.data):
            return self.read()
        data = self.data
        if self.step:  # indexing would load a zarr array
            from dask.array import from_array

            data = (data if hasattr(data, "dask") else from_array(data))[self.step]  # type: ignore[no-untyped-call]
        return Volume(data, self.place.affine, self.place.path, unit=self.place.unit)


def frames_of(volume: LayerVolume) -> tuple[LayerVolume, ...]:
    """Return all frames of a movie along its first axis; other leading axes, such as channels, keep their index."""
    return tuple(replace(volume, step=(frame, *volume.step[1:])) for frame in range(volume.data.shape[0]))


def finest(layer: Layer) -> Any:
    """Return the voxels of a layer as numpy, dask or zarr, at the finest level of a multiscale layer."""
    return layer.data[0] if layer.multiscale else layer.data


class OutsideError(InputError):
    """The layer has no values at the displayed frame."""


def nearest_step(layer: Layer, viewer: Viewer) -> tuple[int, ...]:
    """Return the time point and channel of a layer that are nearest to those that the viewer displays."""
    index = _index(layer, in_units_of(layer, viewer.dims.point, viewer.layers.units))
    return tuple(int(np.clip(n, 0, size - 1)) for n, size in zip(index, finest(layer).shape, strict=False))


def shown_step(layer: Layer, viewer: Viewer, moment: tuple[TimeAxis, int] | None = None) -> tuple[int, ...]:
    """Return the time point and channel of a layer that the viewer displays, or those at a frame of a movie.

    Raises InputError if the layer has no values there, or if its time axis is not that of the movie.
    """
    point = in_units_of(layer, viewer.dims.point, viewer.layers.units)
    if moment is not None and layer.ndim >= -moment[0].axis:
        time, frame = moment
        point[time.axis] = time.place(frame) * unit_ratio(time.units[:1], [layer.units[time.axis]])[0]
    index = _index(layer, point)
    if any(not 0 <= n < size for n, size in zip(index, finest(layer).shape, strict=False)):
        raise OutsideError(f"Layer '{layer.name}' has no values at the displayed position of the time slider")
    return index


def _index(layer: Layer, point: NDArray[np.float64]) -> tuple[int, ...]:
    """Return the index along all axes but the last three at a point in the units of a layer."""
    return tuple(round(n) for n in layer.world_to_data(point)[: layer.ndim - 3])


def check_time(layer: Layer, time: TimeAxis, count: int) -> None:
    """Raise InputError if the time axis of a layer lies on another axis of a movie, because of a channel axis."""
    shape = finest(layer).shape
    if layer.ndim <= 3 or layer.ndim == -time.axis:
        return
    is_first = shape[0] == count
    is_aligned = layer.ndim > -time.axis and shape[time.axis] == count
    if is_first or not (is_aligned or layer.ndim < -time.axis):
        raise InputError(
            f"The frames of '{layer.name}' lie along another axis than those of the map, because only one of the "
            "layers has channels. Split the channels: open each one as a layer with the axes t, z, y, x"
        )


def time_axis(layer: Layer) -> TimeAxis:
    """Return the position of the axes of a layer before the last three in the world of the viewer."""
    count = layer.ndim - 3
    starts = np.asarray(layer.data_to_world(np.zeros(layer.ndim)))[:count]
    ends = [np.asarray(layer.data_to_world(end))[n] for n, end in enumerate(np.eye(layer.ndim)[:count])]
    steps, sizes = (np.asarray(ends) - starts).tolist(), finest(layer).shape[:count]
    (start, step, _), *others = zip(starts.tolist(), steps, sizes, strict=True)
    return TimeAxis(-layer.ndim, start, step, tuple(layer.units[:count]), tuple(others))


def _bytes(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert colours of any type to uint8, as napari displays them."""
    if colours.dtype == np.uint8:
        return colours
    full = 1.0 if colours.dtype.kind == "f" else float(np.iinfo(colours.dtype).max)
    return np.round(np.clip(np.nan_to_num(colours / full), 0, 1) * 255).astype(np.uint8)
