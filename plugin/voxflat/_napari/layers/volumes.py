"""From napari's Image and Labels layers to volumes in RAS+ mm."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace
from voxflat.errors import InputError
from voxflat.io.chunks import is_chunked
from voxflat.io.volumes import Volume


@dataclass(frozen=True, eq=False)
class LayerVolume:
    """A layer's voxels and their place, read in the GUI's thread, for any other: the layer may change."""

    data: Any = field(repr=False)  # numpy, dask, zarr; of a multiscale layer its finest level
    place: LayerPlace
    rgb: bool
    step: tuple[int, ...] = ()  # index along each axis before the three of space: time, channels

    @classmethod
    def of(cls, layer: Layer, world: str = "RAS", step: tuple[int, ...] = ()) -> "LayerVolume":
        """Take an Image or Labels layer; raises InputError unless it has three dimensions beside `step`, in lengths."""
        if layer.ndim - len(step) > 3:
            raise InputError(
                f"layer '{layer.name}' has {layer.ndim} dimensions instead of 3: split it "
                "(Layers > Layer Type > Split Stack) and choose a part"
            )
        place = LayerPlace.of(layer, world, len(step))
        return cls(finest(layer), place, getattr(layer, "rgb", False), step)  # Labels have no rgb

    @property
    def origin(self) -> dict[str, str]:
        """For the map's metadata: the layer's name, the world's axes, the unit of length."""
        return self.place.origin

    def read(self) -> Volume:
        """Fetch the voxels, long for dask and zarr; raises InputError if the values are no volume."""
        data = np.asarray(self.data[self.step] if self.step else self.data)
        return Volume(_bytes(data) if self.rgb else data, self.place.affine, self.place.path)

    def lazily(self) -> Volume:
        """Return the volume, of dask and zarr without fetching it: what samples it reads the chunks that it meets."""
        if self.rgb or not is_chunked(self.data):
            return self.read()
        data = self.data
        if self.step:  # of zarr, an index would fetch
            from dask.array import from_array

            data = (data if hasattr(data, "dask") else from_array(data))[self.step]  # type: ignore[no-untyped-call]
        return Volume(data, self.place.affine, self.place.path)


def finest(layer: Layer) -> Any:
    """Return a layer's voxels, of a multiscale layer those of its finest level: numpy, dask, zarr."""
    return layer.data[0] if layer.multiscale else layer.data


def _bytes(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Take colours of any type, which napari shows as it does uint8, as uint8."""
    if colours.dtype == np.uint8:
        return colours
    full = 1.0 if colours.dtype.kind == "f" else float(np.iinfo(colours.dtype).max)
    return np.round(np.clip(np.nan_to_num(colours / full), 0, 1) * 255).astype(np.uint8)
