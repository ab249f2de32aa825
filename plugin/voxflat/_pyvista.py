"""PyVista: ``mesh.voxflat(...)`` on every ``pyvista.PolyData`` and ``pyvista.ImageData``, and flat maps as meshes.

PyVista (0.48 and later) loads this module on the first use of ``.voxflat``; before, ``import voxflat._pyvista`` does.

PyVista's coordinates are taken as RAS+ mm: x grows to the right, y to the front, z upwards. An image from a reader that
keeps LPS coordinates, as ITK's do, has to be turned first (origin and the first two rows of its direction matrix times
−1), or left and right, front and back are exchanged in what the map calls "superior up, seen from outside".
"""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from voxflat.atlases.atlas import Atlas
from voxflat.atlases.making import patches
from voxflat.atlases.pieces import FIGURES
from voxflat.errors import InputError
from voxflat.io.volumes import Volume
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.pictures import place
from voxflat.methods.flatten import flatten

__all__ = ["VoxflatAccessor", "to_page_polydata", "to_polydata", "to_surface_polydata"]


def to_polydata(flat_map: FlatMap, *, picture_shape: tuple[int, ...] = (1, 1)) -> pv.PolyData:
    """Return a flat map as a mesh in the plane z = 0, in mm.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    picture_shape : tuple of ints
        Height and width (its ``shape``) of the picture that the texture coordinates are for; by default a square one.

    Returns
    -------
    pyvista.PolyData
        Point data ``distortion`` (mean relative error of the distances from each point, a fraction; active),
        ``voxel_ids`` (i, j, k) or ``vertex_ids``, ``surface_points`` (RAS+ mm) and texture coordinates, by which a
        picture lies as in `FlatMap.texture`. Cell data ``torn``: no surface lies in between. Field data ``voxflat``:
        metadata and distortion figures, ``json.loads(mesh.field_data["voxflat"][0])``.
    """
    return _mesh(flat_map, np.column_stack([flat_map.uv, np.zeros(len(flat_map))]), picture_shape)


def to_surface_polydata(flat_map: FlatMap, *, picture_shape: tuple[int, ...] = (1, 1)) -> pv.PolyData:
    """Return the surface patch of a flat map as a mesh in space, RAS+ mm.

    Parameters
    ----------
    flat_map, picture_shape
        As in `to_polydata`.

    Returns
    -------
    pyvista.PolyData
        The same faces and data as in `to_polydata`. Faces that are torn reach across gaps in space.
    """
    return _mesh(flat_map, flat_map.points, picture_shape)


def to_page_polydata(atlas: Atlas, *, packing: str = "boxes") -> pv.PolyData:
    """Return the page of an atlas as a mesh in the plane z = 0, in mm.

    Parameters
    ----------
    atlas : Atlas
        An atlas, such as `voxflat.patches` returns.
    packing : {"boxes", "shapes"}
        As in `Atlas.page`.

    Returns
    -------
    pyvista.PolyData
        Its cells are the surface's triangles, in their order. Cell data ``patch`` (active), ``piece`` (not the
        same where patches are glued), ``isometric`` (C),
        ``quasi_conformal`` (K) and ``areal``; point data ``voxel_ids`` or ``vertex_ids``, ``surface_points`` (RAS+ mm)
        and texture coordinates, by which an image of the page lies on it; field data ``voxflat``: the metadata.
    """
    page = atlas.page(packing=packing)
    corners: Any = atlas.uv_faces
    mesh: pv.PolyData = pv.PolyData.from_regular_faces(np.column_stack([page.uv, np.zeros(len(page.uv))]), corners)
    _add_figures(mesh, atlas)
    is_voxels = atlas.metadata["kind"] == "voxels"
    mesh.point_data["voxel_ids" if is_voxels else "vertex_ids"] = atlas.ids[atlas.vertex_ids]
    mesh.point_data["surface_points"] = atlas.points[atlas.vertex_ids]
    mesh.active_texture_coordinates = page.texture_coordinates()
    mesh.field_data["voxflat"] = [json.dumps(atlas.metadata)]
    mesh.set_active_scalars("patch", preference="cell")
    return mesh


def _atlas(surface: Any, max_angle: float | None, glue: float | None, options: dict[str, Any]) -> Atlas:
    """Return the patches of a surface, glued if that is wanted."""
    atlas = patches(surface, max_angle, **options)
    if glue is None:
        return atlas
    return atlas.glue(glue, threads=options.get("threads"), progress=options.get("progress"))


def _carry(mesh: pv.DataSet, flat: pv.PolyData, ids: NDArray[np.int64]) -> None:
    """Carry the point arrays of a mesh over to a flat one, unless that has one of the name."""
    for name in mesh.point_data:
        if name not in flat.point_data:
            flat.point_data[name] = mesh.point_data[name][ids]


def _add_figures(mesh: pv.PolyData, atlas: Atlas) -> None:
    """Add to each triangle which patch it belongs to, and how much it is distorted."""
    mesh.cell_data["patch"] = atlas.patch_ids
    mesh.cell_data["piece"] = atlas.piece_ids
    for name in FIGURES:
        mesh.cell_data[name] = getattr(atlas, name)


class VoxflatAccessor:
    """Flatten a mesh, or a surface of an image: ``mesh.voxflat(...)``.

    Parameters
    ----------
    mesh : pyvista.DataSet
        ``PolyData`` of triangles, or an ``ImageData`` with a label volume or intensities, as point data or as cell
        data; in RAS+ mm. Other datasets are refused when it is called.

    Examples
    --------
    >>> import pyvista as pv
    >>> image = pv.ImageData(dimensions=(30, 40, 3))
    >>> image["labels"] = (image.points[:, 2] == 1).astype("uint8")
    >>> flat = image.voxflat()  # a flat map as PolyData, in mm
    >>> flat_map = image.voxflat.flatten()  # the same as voxflat.FlatMap
    >>> patch = image.voxflat.to_surface_polydata(flat_map)  # and the surface, with the same data
    >>> plane = pv.Plane().triangulate()
    >>> flat = plane.voxflat()  # meshes, too: every point array is carried over
    >>> page = pv.Sphere().voxflat.patches(max_angle=20)  # a surface of any topology, in certified patches
    """

    to_polydata = staticmethod(to_polydata)
    to_surface_polydata = staticmethod(to_surface_polydata)
    to_page_polydata = staticmethod(to_page_polydata)

    def __init__(self, mesh: pv.DataSet) -> None:
        self._mesh = mesh

    def __call__(self, scalars: str | None = None, **options: Any) -> pv.PolyData:
        """Flatten the mesh, or a surface of the image, into the plane z = 0.

        Parameters
        ----------
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        **options
            ``label``, ``threshold``, ``keep``, ``seed_point``, ``radius`` and all others as in `flatten`.

        Returns
        -------
        pyvista.PolyData
            As from `to_polydata`; of a mesh, every point array is carried over, unless `to_polydata` has one of that
            name.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`.
        """
        flat_map = self.flatten(scalars, **options)
        flat = to_polydata(flat_map)
        if not flat_map.is_voxels:
            _carry(self._mesh, flat, flat_map.ids)
        return flat

    def flatten(
        self, scalars: str | None = None, *, keep: object | None = None, drop: object | None = None, **options: Any
    ) -> FlatMap:
        """Flatten the mesh, or a surface of the image.

        Parameters
        ----------
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        keep : str, pyvista.ImageData, ndarray, path, image object or Volume, optional
            A mask of what to flatten: the name of another array of this dataset, another image, or what
            `voxflat.flatten` takes.
        drop : as `keep`, optional
            What not to flatten, such as the medial wall.
        **options
            For images ``label=3`` or ``threshold=0.5`` say what is foreground; ``seed_point=(i, j, k)``, of a mesh the
            number of a point, and ``radius=45.0`` (mm) cut out a patch. These and all others are the keyword arguments
            of `voxflat.flatten`. Voxel indices count from 0 at the image's first point or cell; `voxel_at` finds them
            from coordinates.

        Returns
        -------
        FlatMap

        Raises
        ------
        InputError
            If the dataset is neither ``PolyData`` of triangles nor ``ImageData``, the array is missing or has several
            components, or `voxflat.flatten` refuses it; the message says what to do.
        Cancelled
            As in `voxflat.flatten`.
        """
        if isinstance(self._mesh, pv.PolyData):
            if scalars is not None:
                raise InputError(f"scalars is {scalars!r}, but a mesh is flattened as it is; leave it out")
            return flatten(self._mesh, keep=self._region(keep), drop=self._region(drop), **options)
        return flatten(self.volume(scalars), keep=self._region(keep), drop=self._region(drop), **options)

    def patches(
        self,
        max_angle: float | None = None,
        *,
        scalars: str | None = None,
        glue: float | None = None,
        packing: str = "boxes",
        **options: Any,
    ) -> pv.PolyData:
        """Flatten the mesh, or a surface of the image, in patches with a certificate.

        Parameters
        ----------
        max_angle : float, optional
            Greatest inclination to a patch's plane, degrees; by default 10.
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        glue : float, optional
            Glue the patches within this bound on C, as `FlatAtlas.glue` does.
        packing : {"boxes", "shapes"}
            How the page is packed, as in `Atlas.page`.
        **options
            ``bound``, ``count``, ``label``, ``threshold`` and all others as in `voxflat.patches`.

        Returns
        -------
        pyvista.PolyData
            The page, as from `to_page_polydata`; of a mesh every point array is carried over. A mesh gets ``patch``,
            ``piece``, ``isometric``, ``quasi_conformal`` and ``areal`` of its triangles as cell data of its own.

        Raises
        ------
        InputError, Cancelled
            As in `voxflat.patches`.
        """
        if not isinstance(self._mesh, pv.PolyData):
            return to_page_polydata(_atlas(self.volume(scalars), max_angle, glue, options), packing=packing)
        if scalars is not None:
            raise InputError(f"scalars is {scalars!r}, but a mesh is flattened as it is; leave it out")
        atlas = _atlas(self._mesh, max_angle, glue, options)
        page = to_page_polydata(atlas, packing=packing)
        _carry(self._mesh, page, page.point_data["vertex_ids"])
        _add_figures(self._mesh, atlas)
        return page

    def _region(self, region: object) -> object:
        """Return a region as `voxflat.flatten` takes it."""
        if isinstance(region, pv.DataSet):
            return VoxflatAccessor(region).volume()
        if not isinstance(region, str):
            return region
        is_mesh = isinstance(self._mesh, pv.PolyData)
        names = self._mesh.point_data.keys() if is_mesh else self._mesh.array_names
        if region in names:
            return np.asarray(self._mesh.point_data[region]) != 0 if is_mesh else self.volume(region)
        if not os.path.exists(region):
            there = ", ".join(names) or "none"
            raise InputError(f"{region!r} is neither an array of the points (there are: {there}) nor a file")
        return region

    def volume(self, scalars: str | None = None) -> Volume:
        """Return an array of the image as a volume with its affine, without a copy.

        Parameters
        ----------
        scalars : str, optional
            Name of the array; by default the active one, or the only one.

        Returns
        -------
        Volume
            For the functions of voxflat: ``voxflat.check(image.voxflat.volume())``,
            ``flat_map.image(image.voxflat.volume("T1"))``. Colours, uint8 with 3 or 4 components, are a volume, too.

        Raises
        ------
        InputError
            If the dataset is no ``ImageData``, or the array is missing or has several components.
        """
        image = _image(self._mesh)
        values, in_cells = _array(image, scalars)
        shape, affine = _grid(image, in_cells)
        colours = values.ndim == 2 and values.shape[1] in (3, 4) and values.dtype == np.uint8
        if values.ndim > 1 and not colours:
            raise InputError(
                f"array {scalars or image.active_scalars_name!r} has {values.shape[1]} components; "
                "give an array with one value a voxel"
            )
        return Volume(values.reshape(*shape, *values.shape[1:], order="F"), affine)

    def voxel_at(self, point: ArrayLike, scalars: str | None = None) -> tuple[int, int, int]:
        """Find the voxel at a point, for use as a seed point.

        Parameters
        ----------
        point : array_like, shape (3,)
            RAS+ mm, as ``image.points`` are.
        scalars : str, optional
            Name of the array, which may be of points or of cells; by default the active one, or the only one.

        Returns
        -------
        tuple of 3 ints
            Indices of the voxel with the nearest centre.

        Raises
        ------
        InputError
            If the point lies outside the image.
        """
        volume = self.volume(scalars)
        place = np.linalg.solve(volume.affine, [*np.asarray(point, dtype=np.float64), 1.0])[:3]
        i, j, k = np.rint(place).astype(int).tolist()
        if not all(0 <= index < size for index, size in zip((i, j, k), volume.data.shape, strict=False)):
            raise InputError(
                f"the point {np.asarray(point).tolist()} mm lies outside the image, {tuple(self._mesh.bounds)}"
            )
        return i, j, k


# ------------------------------------------------------------------------------------- meshes out


def _mesh(flat_map: FlatMap, points: NDArray[np.float64], picture_shape: tuple[int, ...]) -> pv.PolyData:
    faces: Any = flat_map.faces.astype(np.int64)
    mesh: pv.PolyData = pv.PolyData.from_regular_faces(points, faces)
    mesh.cell_data["torn"] = flat_map.torn
    mesh.point_data["voxel_ids" if flat_map.is_voxels else "vertex_ids"] = flat_map.ids
    mesh.point_data["surface_points"] = flat_map.points
    mesh.point_data["distortion"] = flat_map.distortion.per_point
    mesh.active_texture_coordinates = place(flat_map.uv, picture_shape)
    mesh.field_data["voxflat"] = [json.dumps(flat_map.description())]
    mesh.set_active_scalars("distortion", preference="point")
    return mesh


# -------------------------------------------------------------------------------------- images in


def _image(mesh: pv.DataSet) -> pv.ImageData:
    if isinstance(mesh, pv.ImageData):
        return mesh
    remedy = (
        "a mesh is flattened as it is, and has no volume"
        if isinstance(mesh, pv.PolyData)
        else "give PolyData, such as mesh.extract_surface().triangulate(), or an ImageData, whose spacing is even; "
        "resample onto one by pyvista.ImageData(...).sample(mesh)"
    )
    raise InputError(f"{type(mesh).__name__}: {remedy}")


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


if hasattr(pv, "register_dataset_accessor"):  # PyVista 0.48
    pv.register_dataset_accessor("voxflat", pv.DataSet)(VoxflatAccessor)
else:
    dataset: Any = pv.DataSet
    dataset.voxflat = property(VoxflatAccessor)
