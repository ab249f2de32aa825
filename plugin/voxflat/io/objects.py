"""Read surfaces and values from nilearn, nibabel, trimesh, meshio and VTK objects without importing these packages."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import array_of
from voxflat.errors import InputError
from voxflat.io.channels import Channels, points_of_nibabel
from voxflat.io.files import naming
from voxflat.io.formats import gifti
from voxflat.io.formats.polygons import of_scene
from voxflat.io.formats.vtk import as_numpy, dataset_parts
from voxflat.io.grid import NOT_KNOWN, unit_of
from voxflat.io.meshes import Mesh, read_mesh
from voxflat.io.partners import check_side
from voxflat.io.triangles import triangulated
from voxflat.io.volumes import Volume

_IMAGES = "a nibabel (NIfTI, GIFTI, CIFTI) or ITK image, a nilearn SurfaceImage"
_PACKAGES = "nilearn, trimesh, meshio, PyVista or VTK"
SUPPORTED = f"a path, a NumPy array, a tuple (points, faces), {_IMAGES}, or a {_PACKAGES} mesh"
"""Description of the input that `voxflat.surface` accepts, for use in messages."""

_STRUCTURES = {"left": "CortexLeft", "right": "CortexRight"}


def mesh_of_object(source: object) -> Mesh | None:
    """Return the surface in an object of another package, or None for other objects."""
    for is_one, convert in _MESHES:
        if is_one(source):
            with naming(type(source).__name__, "convert it to a file or to arrays"):
                return convert(source)
    return None


def values_of_object(source: object, points: int, structure: str | None) -> Channels | None:
    """Return the values at a surface's vertices in an object of another package, or None for other objects."""
    if isinstance(source, np.ndarray | list | tuple):
        return None
    with naming(type(source).__name__, "pass the values of this surface"):
        if hasattr(source, "dataobj"):
            return points_of_nibabel(source, points, structure)
        parts = _value_parts(source)
        if parts is not None:
            return Channels.of_array(_of_side(parts, points, structure))
        if not is_gifti(source) or gifti._has_triangles(source):
            return None
        values, side = gifti.values(source), source.meta.get("AnatomicalStructurePrimary")  # type: ignore[attr-defined]
        if len(values) != points:
            raise InputError(f"has {len(values)} values, but the surface has {points} points. Pass one value per point")
        check_side(type(source).__name__, side, structure, "Pass the values of that hemisphere")
        return Channels.of_array(values, gifti.map_names(source))


def is_values(source: object) -> bool:
    """Return whether an object contains values at a surface's vertices, but no surface."""
    return is_gifti(source) or _value_parts(source) is not None


def is_gifti(source: object) -> bool:
    """Return whether an object is a nibabel GIFTI image."""
    return hasattr(source, "darrays") and hasattr(source, "agg_data")


def _has(*names: str) -> Callable[[object], bool]:
    return lambda source: all(hasattr(source, name) for name in names)


def _is_dataset(source: object) -> bool:
    return _has("GetCellType", "GetPoints", "GetNumberOfCells")(source) and not is_image(source)


def is_image(source: object) -> bool:
    """Return whether an object is VTK's or PyVista's image data."""
    return _has("GetCellType", "GetScalarPointer")(source)


def _has_parts(source: object) -> bool:
    parts = getattr(source, "parts", None)
    return isinstance(parts, Mapping) and all(hasattr(part, "coordinates") for part in parts.values())


def _of_nilearn(mesh: Any) -> Mesh:
    path = getattr(mesh, "file_path", None)  # the file of a FileMesh contains more information
    return Mesh(mesh.coordinates, mesh.faces) if path is None else read_mesh(path)


def _of_parts(mesh: Any) -> Mesh:
    if len(mesh.parts) != 1:
        raise InputError(f"has the parts {', '.join(mesh.parts)}. Pass one of them, such as .parts['left']")
    ((side, part),) = mesh.parts.items()
    return replace(_of_nilearn(part), structure=_STRUCTURES.get(side))


def _of_surface_image(image: Any) -> Mesh:
    if len(image.mesh.parts) != 1:
        raise InputError("has two hemispheres. Pass one of them, such as .mesh.parts['left']")
    return _of_parts(image.mesh)


def _of_meshio(mesh: Any) -> Mesh:
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.pad(points, ((0, 0), (0, 1)))
    forms = ("triangle", "quad", "polygon")
    polygons = [np.asarray(block.data, dtype=np.int64) for block in mesh.cells if block.type in forms]
    if not polygons:
        kinds = ", ".join(sorted({str(block.type) for block in mesh.cells})) or "no cells"
        raise InputError(f"contains no triangles, quadrilaterals or polygons ({kinds}). Extract its surface first")
    corners = np.concatenate([block.ravel() for block in polygons])
    lengths = np.concatenate([np.full(len(block), block.shape[1]) for block in polygons])
    places, warnings = triangulated(points, corners, lengths)
    return Mesh(points, corners[places], warnings=warnings, declared_unit="unknown")


def mesh_of_dataset(dataset: Any) -> tuple[Mesh, NDArray[np.int64]]:
    """Return the outer surface of a VTK dataset with the dataset's own points, and the cell of each triangle."""
    parts, cells = dataset_parts(dataset)
    return Mesh(**parts, declared_unit="unknown"), cells


def _of_blocks(blocks: Any) -> Mesh:
    """Return the surfaces of all blocks as one, like those of a GLB file."""
    all_blocks = [blocks.GetBlock(number) for number in range(blocks.GetNumberOfBlocks())]
    meshes = [mesh for block in all_blocks if block is not None and (mesh := mesh_of_object(block)) is not None]
    if not meshes or len(meshes) < sum(block is not None for block in all_blocks):
        raise InputError(f"has {len(all_blocks)} blocks, {len(meshes)} of which are surfaces. Pass only the surfaces")
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    warnings = tuple(dict.fromkeys(warning for mesh in meshes for warning in mesh.warnings))
    return Mesh(np.concatenate([mesh.points for mesh in meshes]), faces, warnings=warnings, declared_unit="unknown")


def _of_trimesh(mesh: Any) -> Mesh:
    units = getattr(mesh, "units", None)
    units = None if units in ("", "none", "unknown") else units  # trimesh turns None into text
    unit = unit_of(units) or "unknown"
    unknown = f"the trimesh object is in {units!r}, which voxflat does not know, so the unit {NOT_KNOWN}"
    warning = () if unit != "unknown" or units is None else (unknown,)
    if hasattr(mesh, "graph"):
        return replace(Mesh(**of_scene(mesh)), declared_unit=unit, warnings=warning)
    texture = getattr(mesh.visual, "uv", None)  # one pair for each vertex
    placed = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), declared_unit=unit, warnings=warning)
    return placed if texture is None else replace(placed, texture_coordinates=np.asarray(texture)[:, :2])


def image_volume(image: Any, name: str | None = None) -> Volume:
    """Return an array of VTK's image data as a volume with its affine, without a copy; by default the active array."""
    if not is_image(image):
        resample = "Resample the mesh onto an image with pyvista.ImageData(...).sample(mesh)"
        raise InputError(f"the {type(image).__name__} is not a volume. {resample}")
    sides = (image.GetPointData(), image.GetCellData())
    names = [[side.GetArrayName(number) for number in range(side.GetNumberOfArrays())] for side in sides]
    arrays = [*names[0], *names[1]]
    if name is None:
        active = [side.GetScalars().GetName() for side in sides if side.GetScalars() is not None]
        preferred = getattr(image, "active_scalars_name", None)  # of PyVista
        name = preferred or next(iter(active), arrays[0] if len(arrays) == 1 else None)
    if name is None or name not in arrays:
        there = f"The image has the arrays {', '.join(arrays)}" if arrays else "The image has no arrays"
        wrong = "no array of the image is active" if name is None else f"the image has no array {name!r}"
        raise InputError(f"{wrong}. Pass the name of an array as scalars, or to image.voxflat.volume(). {there}")
    if arrays.count(name) > 1:
        raise InputError(f"the points and the cells both have an array {name!r}. Rename or remove one of them")
    in_cells = name in names[1]
    values = as_numpy(sides[in_cells].GetArray(name))
    if values.ndim > 1 and not (values.shape[1] in (3, 4) and values.dtype == np.uint8):  # colours
        raise InputError(f"array {name!r} has {values.shape[1]} components. Pass an array with one value per voxel")
    shape, affine = _image_grid(image, in_cells)
    return Volume(values.reshape(*shape, *values.shape[1:], order="F"), affine)


def _image_grid(image: Any, in_cells: bool) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Return the number of voxels along each axis, and the affine from voxel indices to image coordinates."""
    size = np.asarray(image.GetDimensions())
    first = np.asarray(image.GetExtent()[::2], dtype=np.float64)  # VTK's indices need not start at 0
    if in_cells:
        first += np.where(size > 1, 0.5, 0.0)  # the centre of a cell lies half a cell from its corner
        size = np.maximum(size - 1, 1)
    matrix = image.GetIndexToPhysicalMatrix()
    affine = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
    affine[:3, 3] += affine[:3, :3] @ first
    return tuple(size.tolist()), affine


_Reader: TypeAlias = tuple[Callable[[object], bool], Callable[[Any], Mesh]]

_MESHES: tuple[_Reader, ...] = (
    (_is_dataset, lambda dataset: mesh_of_dataset(dataset)[0]),  # of VTK and PyVista
    (_has("GetNumberOfBlocks", "GetBlock"), _of_blocks),
    (_has("coordinates", "faces", "n_vertices"), _of_nilearn),  # InMemoryMesh, FileMesh
    (lambda given: _has_parts(getattr(given, "mesh", None)), _of_surface_image),
    (_has_parts, _of_parts),  # PolyMesh
    (lambda given: is_gifti(given) and gifti._has_triangles(given), lambda image: Mesh(**gifti.surface(image))),
    (_has("points", "cells", "cells_dict"), _of_meshio),
    (_has("vertices", "faces", "face_normals"), _of_trimesh),
    (_has("geometry", "graph", "units"), _of_trimesh),  # a trimesh scene
)


def _value_parts(source: object) -> Mapping[str, Any] | None:
    """Return the values of each hemisphere in a nilearn SurfaceImage or PolyData, or None for other objects."""
    data = getattr(source, "data", None) if hasattr(source, "mesh") else source
    parts = getattr(data, "parts", None)
    if not isinstance(parts, Mapping) or not all(hasattr(part, "shape") for part in parts.values()):
        return None
    return parts


def _of_side(parts: Mapping[str, Any], points: int, structure: str | None) -> NDArray[Any]:
    """Return the values of the hemisphere that matches a surface."""
    fitting = {side: part for side, part in parts.items() if len(part) == points}
    sides = {side: part for side, part in fitting.items() if _STRUCTURES.get(side) == structure}
    if sides:
        return array_of(next(iter(sides.values())), "values", as_nan=True)
    if structure in _STRUCTURES.values() and structure not in map(_STRUCTURES.get, parts):
        raise InputError(f"has values for {', '.join(parts)}, but the surface belongs to {structure}. Pass its values")
    if len(fitting) == 1:
        return array_of(next(iter(fitting.values())), "values", as_nan=True)
    if fitting:
        both = f"has {points} values for each hemisphere, and the hemisphere of the surface is unknown"
        raise InputError(f"{both}. Pass one part, such as .data.parts['left']")
    lengths = ", ".join(f"{len(part)} values for {side}" for side, part in parts.items())
    raise InputError(f"has {lengths}, but the surface has {points} points")
