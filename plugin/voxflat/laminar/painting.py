"""Find the pixels of a flat volume to which the voxels of the grey matter belong."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_instance, checked_number, shown
from voxflat.errors import InputError
from voxflat.io.sources import as_volume
from voxflat.io.spaces import Space
from voxflat.maps.depth import Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.image_files import names_in
from voxflat.maps.plane import Planar
from voxflat.maps.raster import FlatStack, Raster, nearest_inside

_SAME = 1e-4  # largest relative difference of a pixel size, and of an origin in pixels; files have single precision
_OFF_MAP = 0.5  # largest distance of a column from the map, relative to the voxel size


def flat_volume(
    values: object, flat_map: FlatMap, pixel_size: float | None, layering: str
) -> tuple[NDArray[Any], Raster]:
    """Return a flat volume of shape (depth, row, column) and its pixels."""
    checked_instance(flat_map, FlatMap, "map", "a FlatMap, as returned by flatten")
    origin: NDArray[np.float64] | None = None
    names: tuple[str, ...] = ()
    stored: float | None = None
    if isinstance(values, FlatStack):
        data, stored, origin, names = values.data, values.pixel_size, np.array(values.origin), values.layers
    else:
        volume = as_volume(values)
        data = volume.data
        if volume.is_placed:  # an image; arrays have the depth first
            data, stored, origin = np.moveaxis(data, 2, 0), float(volume.spacing[0]), volume.affine[:2, 3]
        if volume.path is not None:
            names = names_in(volume.path)
    if data.ndim != 3 or data.dtype.kind not in "biuf":
        raise InputError(f"the flat volume has shape {data.shape}. Pass numbers of shape (depth, row, column)")
    size = None if pixel_size is None else checked_number(pixel_size, "pixel size")
    if stored is not None:
        if size is not None and not abs(size / stored - 1) < _SAME:
            raise InputError(f"the pixel size is {size:g}, but the flat volume has {stored:g}. Omit the pixel size")
        size = stored
    if size is not None and abs(size / flat_map.pixel_size - 1) < _SAME:
        size = flat_map.pixel_size
    raster = flat_map.raster(size)
    if raster.shape != data.shape[1:]:
        raise InputError(
            f"the flat volume has {data.shape[2]} x {data.shape[1]} pixels, but the map has {raster.shape[1]} x "
            f"{raster.shape[0]} at {raster.pixel_size:g} mm per pixel. Pass the map and the pixel size of the flat "
            "volume"
        )
    if origin is not None and np.abs(origin - raster.origin).max() > max(_SAME, raster.pixel_size * _SAME):
        raise InputError("the flat volume has another origin than the map. Pass the map with which it was made")
    expected = Depths.of(layering=layering, count=len(data)).names()
    for name, name_of_layer in zip(names, expected, strict=False):
        if name and not name.endswith(name_of_layer):
            raise InputError(
                f"the flat volume was sampled at the depth {shown(name)} instead of {name_of_layer!r}. Make it with "
                f"depths={len(data)}, and pass the same layering"
            )
    return data, raster


def on_map(
    planar: Planar, halfway: NDArray[np.float64], affine: NDArray[np.float64], space: Space
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the positions (u, v) of the columns that lie on a map, and which ones do."""
    size = float(np.linalg.norm(affine[:3, :3], axis=0).max())
    uv, _ = planar.points_to_map(halfway, _OFF_MAP * size, space="scanner" if space.is_known else "surface")
    is_on = np.isfinite(uv[:, 0])
    return uv[is_on], is_on


def pixels_of(uv: NDArray[np.float64], raster: Raster) -> NDArray[np.int64]:
    """Return the row and the column of the pixel at positions on the map, shape (2, P)."""
    u, v = raster.origin
    positions = np.stack([v - uv[:, 1], uv[:, 0] - u]) / raster.pixel_size
    rows, columns = np.rint(positions).astype(np.int64).clip(0, np.array(raster.shape)[:, None] - 1)
    _, inside = nearest_inside(raster)
    return inside[:, rows, columns]
