"""Images of PyVista as volumes."""

from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.volumes import Volume


def volume_of(mesh: pv.DataSet, scalars: str | None = None) -> Volume:
    """Return an array of an image as a volume with its affine, without a copy."""
    image = _image(mesh)
    values, in_cells = _array(image, scalars)
    shape, affine = _grid(image, in_cells)
    colours = values.ndim == 2 and values.shape[1] in (3, 4) and values.dtype == np.uint8
    if values.ndim > 1 and not colours:
        raise InputError(
            f"array {scalars or image.active_scalars_name!r} has {values.shape[1]} components; "
            "give an array with one value a voxel"
        )
    return Volume(values.reshape(*shape, *values.shape[1:], order="F"), affine)


def _image(mesh: pv.DataSet) -> pv.ImageData:
    if isinstance(mesh, pv.ImageData):
        return mesh
    raise InputError(
        f"{type(mesh).__name__}: a mesh is flattened as it is, and has no volume; resample it onto an image by "
        "pyvista.ImageData(...).sample(mesh)"
    )


def _array(image: pv.ImageData, name: str | None) -> tuple[NDArray[Any], bool]:
    """Return an array of an image, and whether its values belong to cells instead of points."""
    points, cells = image.point_data, image.cell_data
    names = [*points.keys(), *cells.keys()]
    if name is None:
        name = image.active_scalars_name or (names[0] if len(names) == 1 else None)
    if name is None or name not in names:
        there = f"the image has the arrays {', '.join(names)}" if names else "the image has no array"
        raise InputError(f"{'scalars are not given' if name is None else f'there is no array {name!r}'}; {there}")
    if names.count(name) > 1:
        raise InputError(f"points and cells both have an array {name!r}; rename or remove one of them")
    return np.asarray((points if name in points else cells)[name]), name not in points


def _grid(image: pv.ImageData, in_cells: bool) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Return the number of voxels along each axis, and the affine from voxel indices to the image's coordinates."""
    size = np.asarray(image.dimensions)
    first = np.asarray(image.extent[::2], dtype=np.float64)  # VTK's own indices may start elsewhere than at 0
    if in_cells:
        first += np.where(size > 1, 0.5, 0.0)  # a cell's centre lies half a cell inside
        size = np.maximum(size - 1, 1)
    affine = np.array(image.index_to_physical_matrix, dtype=np.float64)
    affine[:3, 3] += affine[:3, :3] @ first
    return tuple(size.tolist()), affine
