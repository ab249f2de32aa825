"""Convert napari Image and Labels layers to volumes in RAS+ positions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace
from voxflat.errors import InputError
from voxflat.io.chunks import is_chunked
from voxflat.io.volumes import Volume


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """The position of the frames of a movie in the world of the viewer."""

    axis: int  # from the last one, such as -4
    start: float  # of frame 0
    step: float

    def frame(self, point: Sequence[float], count: int) -> int:
        """Return the frame at a point of the viewer."""
        at = point[self.axis] if len(point) >= -self.axis else self.start
        return int(np.clip(round((at - self.start) / self.step), 0, count - 1))

    def place(self, frame: int) -> float:
        """Return the position of a frame along the axis."""
        return self.start + frame * self.step


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


def shown_step(layer: Layer, point: Sequence[float]) -> tuple[int, ...]:
    """Return the time point and channel of a layer at a point of the viewer."""
    index = layer.world_to_data(point[-layer.ndim :])[: layer.ndim - 3]
    return tuple(int(np.clip(round(n), 0, size - 1)) for n, size in zip(index, finest(layer).shape, strict=False))


def time_axis(layer: Layer) -> TimeAxis:
    """Return the position of the first axis of a layer in the world of the viewer."""
    ends = np.zeros((2, layer.ndim))
    ends[1, 0] = 1
    start, following = (float(layer.data_to_world(end)[0]) for end in ends)
    return TimeAxis(-layer.ndim, start, following - start)


def _bytes(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert colours of any type to uint8, as napari displays them."""
    if colours.dtype == np.uint8:
        return colours
    full = 1.0 if colours.dtype.kind == "f" else float(np.iinfo(colours.dtype).max)
    return np.round(np.clip(np.nan_to_num(colours / full), 0, 1) * 255).astype(np.uint8)
