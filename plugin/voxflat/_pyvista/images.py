"""Convert PyVista images to volumes."""

from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.volumes import Volume


def volume_of(image: pv.DataSet, scalars: str | None = None) -> Volume:
    """Return an array of an image as a volume with its affine, without a copy."""
    if not isinstance(image, pv.ImageData):
        resample = "Resample the mesh onto an image with pyvista.ImageData(...).sample(mesh)"
        raise InputError(f"a {type(image).__name__} is not a volume. {resample}")
    values, in_cells = _array(image, scalars)
    shape, affine = _grid(image, in_cells)
    colours = values.ndim == 2 and values.shape[1] in (3, 4) and values.dtype == np.uint8
    if values.ndim > 1 and not colours:
        name = scalars or image.active_scalars_name
        raise InputError(f"array {name!r} has {values.shape[1]} components. Give an array with one value per voxel")
    return Volume(values.reshape(*shape, *values.shape[1:], order="F"), affine)


def _array(image: pv.ImageData, name: str | None) -> tuple[NDArray[Any], bool]:
    """Return an array of an image, and whether its values belong to cells instead of points."""
    points, cells = image.point_data, image.cell_data
    names = [*points.keys(), *cells.keys()]
    if name is None:
        name = image.active_scalars_name or (names[0] if len(names) == 1 else None)
    if name is None or name not in names:
        there = f"The image has the arrays {', '.join(names)}" if names else "The image has no arrays"
        wrong = "scalars is not given" if name is None else f"the image has no array {name!r}"
        raise InputError(f"{wrong}. Pass the name of an array as scalars. {there}")
    if names.count(name) > 1:
        raise InputError(f"the points and the cells both have an array {name!r}. Rename or remove one of them")
    return np.asarray((points if name in points else cells)[name]), name not in points


def _grid(image: pv.ImageData, in_cells: bool) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Return the number of voxels along each axis, and the affine from voxel indices to image coordinates."""
    size = np.asarray(image.dimensions)
    first = np.asarray(image.extent[::2], dtype=np.float64)  # VTK's indices need not start at 0
    if in_cells:
        first += np.where(size > 1, 0.5, 0.0)  # the centre of a cell lies half a cell from its corner
        size = np.maximum(size - 1, 1)
    affine = np.array(image.index_to_physical_matrix, dtype=np.float64)
    affine[:3, 3] += affine[:3, :3] @ first
    return tuple(size.tolist()), affine
