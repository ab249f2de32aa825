"""Flat maps: what `voxflat.flatten` returns."""

import importlib
import math
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import array_of, checked_path, checked_switch, is_number, log, shown
from voxflat.distances.store import write_provenance
from voxflat.distances.table import Table
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.io.files import SAVED_ENDINGS, require
from voxflat.io.formats import gifti
from voxflat.io.grid import in_unit, warn_of_unit
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.notebook import page
from voxflat.io.patches import FLAT_PATCH_ENDINGS, PATCH_ENDING, Patch, write_patch
from voxflat.io.provenance import Record, resolved, saving, telling
from voxflat.io.spaces import Space
from voxflat.maps.drawn_regions import regions_of
from voxflat.maps.map_files import mesh_of_vertices, read_map, write_map
from voxflat.maps.plane import FlatTriangles, Planar
from voxflat.maps.raster import FlatImage
from voxflat.maps.regions import Regions
from voxflat.maps.sampler import Sampler, usual_spacing
from voxflat.maps.textures.pictures import as_picture, check_cover, check_values, place, values_at
from voxflat.maps.textures.textured import TexturedSurface
from voxflat.surfaces.manifold import patch_of

MAP_ENDINGS = (*SAVED_ENDINGS, ".surf.gii", *FLAT_PATCH_ENDINGS, ".vtp", ".ply", ".obj")


@dataclass(frozen=True, eq=False)
class FlatMap(Planar):
    """A flattened surface.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        The points' places in the plane, mm. The surface is seen from outside, superior up.
    points : ndarray of float64, shape (N, 3)
        The points on the surface, RAS+ mm in `space`: of a mesh the coordinates of its file.
    normals : ndarray of float64, shape (N, 3)
        Unit vectors that point outside, to the background (RAS+); NaN for a sheet, which has background on both sides.
    ids : ndarray of int64, shape (N, 3) or (N,)
        Their voxel indices (i, j, k), or vertex numbers in the mesh; the two sides of a cut share one. Vertices of a
        mesh that were merged with another at their place have a row each, the last ones, there and in no triangle.
    faces : ndarray of uint32, shape (F, 3)
        Triangles of points that cover the map, counterclockwise but for those that are turned over.
    torn : ndarray of bool, shape (F,)
        Triangles whose corners are neighbours in the plane but not on the surface: there the map is squeezed or folded.
        Only maps over the 26-neighbour graph can have them, whose triangles are made in the plane.
    sources : ndarray of int64, shape (m,)
        The points from which distances were measured, as numbers into the rows above.
    eigenvalues : ndarray of float64, shape (K,)
        The scaling's eigenvalues of the largest magnitude, mm²; two that stand out mean a planar surface.
    distortion : Distortion
        What flattening did to the distances.
    metadata : dict
        Parameters, affine, versions, checksum of the input, topology.
    rows : ndarray of float32, shape (m, N), or Table, or None
        Geodesic distances from the sources, mm, if they were asked for. Those of a store (``metadata["store"]``) stay
        there: `save` leaves them out, and merged vertices have no column.
    bridges : ndarray of int64, shape (B, 3)
        Vertices of triangles that the mesh has and the map has not, though all their corners are in the map: a patch
        file must not bring them back.
    curvature : ndarray of float64, shape (N,), or None
        Mean curvature at the points, 1/mm, positive on gyri: `Surface.mean_curvature` of the whole surface, before it
        was cut. None for the method "grossmann2002", whose surface has no triangles.
    sulcal_depth : ndarray of float64, shape (N,), or None
        How deep in a fold they lie, mm, positive in sulci: `Surface.sulcal_depth`, likewise.
    white_points, pial_points : ndarray of float64, shape (N, 3), or None
        The points on the white and on the pial surface, in `space`, where both are known: between them lies the cortex.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> flat_map
    <FlatMap: 441 points, 42 x 42 mm, relative error 3.6 %>
    >>> flat_map.uv.shape
    (441, 2)
    """

    uv: NDArray[np.float64]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    ids: NDArray[np.int64]
    faces: NDArray[np.uint32]
    torn: NDArray[np.bool_]
    sources: NDArray[np.int64]
    eigenvalues: NDArray[np.float64]
    distortion: Distortion
    metadata: dict[str, Any]
    rows: NDArray[np.float32] | Table | None = None
    bridges: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    curvature: NDArray[np.float64] | None = None
    sulcal_depth: NDArray[np.float64] | None = None
    white_points: NDArray[np.float64] | None = None
    pial_points: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        unit = self.metadata.get("unit", "mm")
        object.__setattr__(self, "distortion", replace(self.distortion, unit=unit))

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.uv)

    def __repr__(self) -> str:
        width, height = np.ptp(self.uv, axis=0)
        error = 100 * self.distortion.raw.relative_error
        size = in_unit(f"{width:.0f} x {height:.0f} mm", self.metadata)
        return f"<FlatMap: {len(self)} points, {size}, relative error {error:.1f} %>"

    @property
    def is_voxels(self) -> bool:
        """Whether a volume was flattened."""
        return bool(self.metadata["kind"] == "voxels")

    @cached_property
    def _triangles(self) -> FlatTriangles:
        cortex = (self.white_points, self.pial_points)
        on_surface = Sampler(self.points, self.normals, self.ids, self.metadata, self.faces, *cortex)
        return FlatTriangles(self.uv, self.faces, self.torn, on_surface)

    @property
    def space(self) -> Space:
        """The space of its points, as `Surface.space`; `Space.to_scanner` carries them to where volumes lie."""
        return Space._of(self.metadata)

    @property
    def affine(self) -> NDArray[np.float64]:
        """From voxel indices to RAS+ mm, shape (4, 4), of the volume that was flattened."""
        return self._triangles.on_surface.affine

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Shape of the volume that was flattened."""
        return self._triangles.on_surface.volume_shape

    @cached_property
    def spacing(self) -> float:
        """Typical distance of neighbouring points, mm: of voxels the geometric mean of the three spacings."""
        return usual_spacing(self.metadata, self.uv, self.faces)

    @property
    def pixel_size(self) -> float:
        """Side of a pixel unless another is given, mm: half of `spacing`."""
        return self.spacing / 2

    @telling()
    def heat_map(self, pixel_size: float | None = None) -> FlatImage:
        """Return the distortion of each point as an image on the same pixels as `image`.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default half of `spacing`.

        Returns
        -------
        FlatImage
            Mean relative error of the distances from each place, as a fraction; NaN outside the map.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.heat_map(pixel_size=1.0)
        <FlatImage: distortion: mean relative error of distances, 43 x 43 pixels of 1>
        """
        raster = self.raster(pixel_size)
        data = raster.interpolate(self.distortion.per_point)
        return FlatImage(
            data, raster.pixel_size, raster.origin, "distortion: mean relative error of distances", unit=raster.unit
        )

    def texture(self, picture: ArrayLike) -> NDArray[Any]:
        """Carry a picture back to the surface (Grossmann et al. 2002, figures 11 to 13).

        Parameters
        ----------
        picture : array_like, shape (H, W) or (H, W, C)
            Laid over the map: centred, in its proportions, just covering the map's bounding box.

        Returns
        -------
        ndarray, shape (N,) or (N, C)
            The picture's value at each surface voxel, of the picture's type.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.texture(np.zeros((64, 64))).shape
        (441,)
        """
        values = check_values(picture)
        found = values_at(values, place(self.uv, values.shape))
        return (np.round(found) if values.dtype.kind in "bui" else found).astype(values.dtype)

    @telling()
    def textured(self, picture: object, texel_size: float | None = None, *, repeat: bool = False) -> TexturedSurface:
        """Map a picture onto the surface (Zigelman et al. 2002, section V).

        It is laid over the map as in `texture`, and by the map onto the surface, which keeps its triangles; those that
        are torn are left out.

        Parameters
        ----------
        picture : path, ndarray or PIL.Image.Image
            Grey or colours, with opacity or not. An array: (H, W), (H, W, 3) or (H, W, 4) of uint8, of bool, or of
            floats from 0 to 1.
        texel_size : float, optional
            Side of a pixel of the picture, mm; by default the picture just covers the map's bounding box.
        repeat : bool
            Whether the picture goes on beyond its borders.

        Returns
        -------
        TexturedSurface
            To be saved as ``.obj``, ``.vtp``, ``.glb`` or ``.ply``.

        Raises
        ------
        InputError
            If it is no picture, or does not cover the map and is not to be repeated.
        FileNotFoundError, PermissionError
            If the file cannot be opened.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.textured(np.full((8, 8, 3), 255, np.uint8))
        <TexturedSurface: 441 points, 800 triangles, 8 x 8 texels>
        """
        colours, source = as_picture(picture)
        coordinates = place(self.uv, colours.shape, texel_size)
        if not checked_switch(repeat, "repeat") and texel_size is not None:
            check_cover(coordinates, colours.shape, texel_size)
        faces = self.faces[~self.torn].astype(np.int64)
        return TexturedSurface(self.space.to_scanner(self.points), faces, coordinates, colours, repeat, source)

    def paint(self, values: ArrayLike, background: float = 0) -> NDArray[Any]:
        """Put values of the points into a volume of the flattened volume's shape.

        Parameters
        ----------
        values : array_like, shape (N,) or (N, C)
            One value, or one row, a point.
        background : float, optional
            Value of all other voxels.

        Returns
        -------
        ndarray, shape (I, J, K) or (I, J, K, C)

        Raises
        ------
        InputError
            If there is not one value a point, or the type of the values cannot hold the background.

        Examples
        --------
        >>> disk = voxflat.surface(voxflat.samples.ball()).disk((4, 12, 12), 6)
        >>> flat_map = disk.flatten()
        >>> flat_map.paint(flat_map.uv[:, 0]).shape
        (24, 24, 24)
        """
        values = array_of(values, "values")
        if not is_number(background):
            raise InputError(f"background is {shown(background)}. Pass a number.")
        if not _holds(values.dtype, background):
            raise InputError(f"background is {shown(background)}, which {values.dtype} cannot hold. Convert values.")
        if values.ndim not in (1, 2) or len(values) != len(self):
            raise InputError(f"values has shape {values.shape}, but the map has {len(self)} points. Pass one each.")
        self._triangles.on_surface.need_volume("has no voxels to paint")
        volume = np.full((*self.volume_shape, *values.shape[1:]), background, dtype=values.dtype)
        volume[tuple(self.ids.T)] = values
        return volume

    @telling()
    def regions(self, rois: object, *, layer: str = "rois", pixel_size: float | None = None) -> Regions:
        """Take regions of interest that were drawn on the map, to carry them to vertices and voxels.

        Parameters
        ----------
        rois : dict, ndarray, sequence, FlatImage, path or napari Shapes layer
            Polygons in mm: (k, 2), several in a list, or by their names, {"V1": polygon}; a name may have several,
            which enclose a region together. A label image on the map's pixels, shape (H, W), 0 for none. A Shapes layer
            over the map in napari, with the column "name" of its features. A file: ``.svg``, a figure of voxflat with
            paths in a layer; ``.json``, polygons by their names; ``.npy``, ``.png``, ``.tif``, ``.nii``, ``.nii.gz``, a
            label image.
        layer : str
            The layer of an SVG file in which the regions were drawn.
        pixel_size : float, optional
            At which a label image was drawn, mm; by default what its file says, else `pixel_size`.

        Returns
        -------
        Regions

        Raises
        ------
        InputError
            If they cannot be understood, are empty, or lie beside the map.
        FileNotFoundError, PermissionError
            If a file cannot be opened.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> triangle = {"V1": [[-5, -5], [5, -5], [0, 5]]}
        >>> flat_map.regions(triangle)
        <Regions: V1>
        """
        return regions_of(self, rois, layer=layer, pixel_size=pixel_size)

    def description(self) -> dict[str, Any]:
        """Return the metadata with the distortion figures, ready for JSON.

        Returns
        -------
        dict
            ``metadata``, and ``distortion`` as from `Distortion.figures`.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.description()["method"]
        'voxflat'
        """
        return {**self.metadata, "distortion": self.distortion.figures()}

    @property
    def provenance(self) -> Record:
        """What made it: version, function, parameters, the files that were read, warnings, and figures."""
        told = {name: self.metadata[name] for name in ("space", "warnings") if name in self.metadata}
        return {**self.metadata.get("provenance", {}), **told, "figures": self.distortion.figures()}

    def _with_provenance(self, record: Record) -> "FlatMap":
        """Return the same map with a record of what made it; its store of rows gets the record, too."""
        full = resolved(record, self.metadata)
        if "store" in self.metadata:
            write_provenance(self.metadata["store"], full)
        return replace(self, metadata={**self.metadata, "provenance": full})

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the map to a file, all of it or nothing.

        Parameters
        ----------
        path : path
            Its ending says what is saved: .npz or .voxflat everything, to be loaded again; .vtp, .ply and .obj the
            triangles in the plane; .surf.gii a flat surface for Connectome Workbench; .patch.flat and .flat.patch.3d a
            FreeSurfer patch, for pycortex, too. A surface and a patch have the mesh's own vertex numbers and one place
            for each: where a cut doubles a vertex only one side of it is kept, and in a patch vertices on the lips are
            left out, so that its readers find no triangle across the cut. How many triangles that costs is said, and so
            is how many are left out because they are torn; a .vtp holds these, marked as such (cell data ``torn``).
            .npz, .voxflat and GIFTI hold `provenance`.
        sidecar : bool
            Write `provenance` to ``<path>.json``, too.
        overwrite : bool
            Replace a file of that name that voxflat did not write.

        Raises
        ------
        InputError
            If the path has another ending, or is a file that the map was made of.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.save("hill.npz")  # everything, for voxflat.load
        >>> flat_map.save("hill.surf.gii")  # a flat surface for other tools
        """
        path = checked_path(path)
        name = path.name.lower()
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite):
            self._write(path, name)

    def _write(self, path: Path, name: str) -> None:
        """Write the file that a name's ending says."""
        if name.endswith(SAVED_ENDINGS):
            self._save_all(path)
        elif name.endswith(FLAT_PATCH_ENDINGS):
            warn_of_unit(path, self.metadata)
            write_patch(path, self._patch())
        elif name.endswith(".surf.gii"):
            warn_of_unit(path, self.metadata)
            write_mesh(path, self._flat_mesh(), self.provenance)
        elif name.endswith(".vtp"):
            write_mesh(path, self._mesh(with_torn=True))
        elif name.endswith((".ply", ".obj")):
            write_mesh(path, self._mesh())
        else:
            endings = " or ".join(MAP_ENDINGS)
            why = f": {PATCH_ENDING} alone means a patch in 3-D space" if name.endswith(PATCH_ENDING) else ""
            raise InputError(f"Cannot save a map as {path.name}{why}. Use a name that ends in {endings}.")

    def _save_all(self, path: Path) -> None:
        arrays: dict[str, Any] = {
            "uv": self.uv,
            "points": self.points,
            "normals": self.normals,
            "ids": self.ids,
            "faces": self.faces,
            "torn": self.torn,
            "sources": self.sources,
            "eigenvalues": self.eigenvalues,
            "distortion_per_point": self.distortion.per_point,
            "distortion_scatter": self.distortion.scatter,
            "bridges": self.bridges,
        }
        if self.distortion.triangles is not None:
            arrays["distortion_areal"] = self.distortion.triangles.areal
            arrays["distortion_is_flipped"] = self.distortion.triangles.is_flipped
        for name in ("curvature", "sulcal_depth", "white_points", "pial_points"):
            if getattr(self, name) is not None:
                arrays[name] = getattr(self, name)
        if self.rows is not None and "store" not in self.metadata:
            arrays["rows"] = np.asarray(self.rows)
        write_map(path, arrays, self.description())

    @property
    def _places(self) -> NDArray[np.float64]:
        """The points' places as points in space, z = 0."""
        return np.column_stack([self.uv, np.zeros(len(self))])

    def _mesh(self, *, with_torn: bool = False) -> Mesh:
        """Return the map as a mesh in the plane; torn triangles are marked, or left out."""
        faces, face_data = self.faces.astype(np.int64), {}
        if with_torn and self.torn.any():
            face_data["torn"] = self.torn.astype(np.uint8)
        elif self.torn.any():
            faces = faces[~self.torn]
            log.warning(
                "%d of %d triangles are torn (there is no surface between their corners). They are not written to the "
                "file; save as .vtp to keep them, marked as torn.",
                len(self.torn) - len(faces),
                len(self.torn),
            )
        structure, point_data = self.metadata.get("structure"), {"distance_error": self.distortion.per_point}
        return Mesh(self._places, faces, structure=structure, point_data=point_data, face_data=face_data)

    def _flat_mesh(self) -> Mesh:
        """Return the map as a mesh in the plane, with the vertex numbers of the flattened mesh if it was one."""
        if self.is_voxels:
            return self._mesh()
        count, structure = self.metadata["vertices"], self.metadata.get("structure")
        return mesh_of_vertices(self._places, self.ids, self.faces, count, structure)

    def _patch(self) -> Patch:
        """Return the map as a FreeSurfer patch."""
        if self.is_voxels:
            raise InputError("A patch file needs vertex numbers of a mesh, but this map has voxels. Use .surf.gii.")
        merged = np.asarray(self.metadata.get("mended", {}).get("merged", []), dtype=np.int64).reshape(-1, 2)
        return patch_of(self._places, self.ids, self.faces, self.bridges, self.metadata["vertices"], merged)

    # ------------------------------------------------------------------- as objects of other packages

    def to_nilearn(self) -> Any:
        """Convert the map of a mesh to nilearn's ``InMemoryMesh``, for ``plot_surf`` and ``view_surf``.

        It has the vertices of the mesh that was flattened, in their order, so that data on that mesh can be plotted on
        it. Vertices that the map leaves out lie at the origin and belong to no triangle.

        Returns
        -------
        nilearn.surface.InMemoryMesh
            Coordinates (u, v, 0), mm.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.to_nilearn().n_vertices
        441
        """
        mesh = self._flat_mesh()
        return require("nilearn.surface", "demo").InMemoryMesh(mesh.points, mesh.faces)

    def to_gifti(self) -> Any:
        """Convert the map to nibabel's ``GiftiImage``, a flat surface as ``save("map.surf.gii")`` writes it.

        Returns
        -------
        nibabel.gifti.GiftiImage
            With the vertices of the mesh that was flattened.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.to_gifti().agg_data("pointset").shape
        (441, 3)
        """
        mesh = self._flat_mesh()
        return gifti.load(gifti.surface_bytes(mesh.points, mesh.faces, mesh.structure))

    def to_trimesh(self) -> Any:
        """Convert the map to ``trimesh.Trimesh``, in the plane.

        Returns
        -------
        trimesh.Trimesh
            With the vertices of the mesh that was flattened, (u, v, 0) in mm.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> len(flat_map.to_trimesh().vertices)
        441
        """
        mesh = self._flat_mesh()
        return require("trimesh").Trimesh(mesh.points, mesh.faces, process=False)

    def to_pyvista(self) -> Any:
        """Convert the map to ``pyvista.PolyData``, in the plane, with its distortion as point data.

        Returns
        -------
        pyvista.PolyData
            With a point for each row of the map, as ``mesh.voxflat()`` returns it.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.to_pyvista().n_points
        441
        """
        require("pyvista")
        return _drawing("_pyvista.flat").to_polydata(self)

    def plot(self, overlay: object | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the map, as `voxflat.figures.flat_map` and the command ``voxflat figure`` do.

        Parameters
        ----------
        overlay : Overlay, path, ndarray, image object or Volume, optional
            Data over the folds.
        ax : matplotlib.axes.Axes, optional
            Draw into these axes; by default into a new figure.
        **options
            As in `voxflat.figures.flat_map`.

        Returns
        -------
        matplotlib.axes.Axes or matplotlib.figure.Figure
            `ax`, or the new figure.

        Raises
        ------
        InputError
            As `voxflat.figures.flat_map`.

        Examples
        --------
        >>> import matplotlib.pyplot as plt
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> figure, ax = plt.subplots()
        >>> flat_map.plot(flat_map.points[:, 2], ax=ax) is ax
        True
        """
        figure = _drawing("figures").flat_map(self, overlay, ax=ax, **options)
        return figure if ax is None else ax

    def _repr_html_(self) -> str:
        """Return the picture and the figures of the map, for Jupyter."""
        figure = _drawing("figures").flat_map(self)
        return page(self, self.distortion.table(), figure, "The flat map, shaded by its folds")


def _drawing(module: str) -> Any:
    """Import a module that draws, which stands above maps and needs packages that not everybody has."""
    return importlib.import_module(f"voxflat.{module}")


def _holds(dtype: np.dtype[Any], number: float) -> bool:
    """Say whether a number is one of a type, but for the digits that rounding takes."""
    number = number.item() if isinstance(number, np.generic) else number  # or limits would be cast to its type
    if dtype.kind in "iu":
        bounds = np.iinfo(dtype)
        return bool(bounds.min <= number <= bounds.max) and int(number) == number
    if dtype.kind == "b":
        return number in (0, 1)
    return dtype.kind != "f" or not abs(number) < math.inf or abs(number) <= float(np.finfo(dtype).max)


def load(path: str | os.PathLike[str]) -> FlatMap:
    """Load a flat map that was saved with `FlatMap.save`.

    Parameters
    ----------
    path : path
        An .npz or .voxflat file.

    Returns
    -------
    FlatMap

    Raises
    ------
    InputError
        If the file is damaged or is no flat map.
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> voxflat.samples.hill().flatten().save("map.npz")
    >>> voxflat.load("map.npz")
    <FlatMap: 441 points, 42 x 42 mm, relative error 3.6 %>
    """
    return FlatMap(**read_map(path))
