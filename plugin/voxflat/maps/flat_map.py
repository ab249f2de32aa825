"""Flat maps: the class `FlatMap`, which `voxflat.flatten` returns, and `load`."""

import math
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import display
from voxflat.arguments import Progress, array_of, checked_choice, checked_switch, is_number, log, shown
from voxflat.distances.store import write_provenance
from voxflat.distances.table import Table
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.later import MeasuredLater
from voxflat.errors import InputError
from voxflat.io.files import SAVED_ENDINGS, require
from voxflat.io.formats import gifti
from voxflat.io.grid import in_unit, rounded, warn_of_unit
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.notebook import page
from voxflat.io.origin import Origin
from voxflat.io.patches import FLAT_PATCH_ENDINGS, PATCH_ENDING, Patch, write_patch
from voxflat.io.provenance import Record, recording, resolved
from voxflat.io.saved import Saved
from voxflat.io.spaces import Space
from voxflat.maps.drawn_regions import regions_of
from voxflat.maps.map_files import mesh_of_vertices, read_map, write_map
from voxflat.maps.plane import FlatTriangles, Planar
from voxflat.maps.raster import FlatImage
from voxflat.maps.regions import Regions
from voxflat.maps.surface_points import NO_NORMALS, NO_POINTS, SurfacePoints, needs_surface
from voxflat.maps.textures.pictures import as_picture, check_cover, check_values, place, values_at
from voxflat.maps.textures.textured import TexturedSurface
from voxflat.surfaces.cuts import Cut, described_cuts
from voxflat.surfaces.manifold import patch_of
from voxflat.unique_rows import distinct

if TYPE_CHECKING:
    import nibabel
    import nilearn.surface
    import pyvista
    import trimesh
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from typing_extensions import Unpack

    from voxflat.maps.option_types import FigureOptions

HEATS = {  # values of a heat map, and the name of its image
    "distances": "distortion: mean relative error of distances",
    "spread": "spread: standard deviation of people's changes of area (log2)",
}
MAP_ENDINGS = (*SAVED_ENDINGS, ".surf.gii", *FLAT_PATCH_ENDINGS, ".vtp", ".ply", ".obj")
GIVEN = "given"
"""The method of maps that another tool made."""

_ARRAYS = (  # fields that are saved as arrays, if they are known
    *("uv", "points", "normals", "ids", "faces", "torn", "sources", "eigenvalues", "bridges"),
    *("curvature", "sulcal_depth", "spread", "white_points", "pial_points"),
)


@needs_surface(points=NO_POINTS, normals=NO_NORMALS, distortion="its distortion is unknown")
@dataclass(frozen=True, eq=False)
class FlatMap(Planar, Saved):
    """A flattened surface.

    It holds the position of each point in the plane and on the surface. Its methods draw data on the map, transfer
    pictures and regions back to the surface, and save the map.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        Positions of the points in the plane, in mm. The surface is seen from outside, with superior up, unless another
        tool made the map.
    points : ndarray of float64, shape (N, 3)
        Positions of the points on the surface in RAS+ mm, in `space`; for meshes, the coordinates of the file.
    normals : ndarray of float64, shape (N, 3)
        Outward unit normals (towards the background, in RAS+). NaN for a one-voxel-thick surface, which has background
        on both sides.
    ids : ndarray of int64, shape (N, 3) or (N,)
        Voxel indices (i, j, k) or vertex numbers of the points; the two sides of a cut have the same values. Mesh
        vertices that were merged with another vertex have their own rows at the end, without triangles, and at the same
        position unless another tool made the map.
    faces : ndarray of uint32, shape (F, 3)
        Triangles that cover the map, counterclockwise except where they are flipped.
    torn : ndarray of bool, shape (F,)
        Triangles whose corners are neighbours in the plane but not on the surface, because the map is compressed or
        folded there. Only maps of the 26-neighbour graph, whose triangles are constructed in the plane, can have them.
    sources : ndarray of int64, shape (m,)
        Row numbers of the points from which distances were measured.
    eigenvalues : ndarray of float64, shape (K,)
        Eigenvalues of classical scaling with the largest magnitudes, in mm². Two dominant values mean low distortion.
    distortion : Distortion
        Errors of distances, and changes of areas and angles. The distortion of a map that another tool made is measured
        when it is first read, which takes most of the time on large surfaces.
    origin : Origin
        The flattened volume or mesh.
    rows : ndarray of float32, shape (m, N), or Table, or None
        Geodesic distances from the sources, in mm, if requested. Distance rows in a `store` stay there: `save` does not
        include them, and merged vertices have no column.
    bridges : ndarray of int64, shape (B, 3)
        Mesh triangles that are not part of the map although all their corners are. A patch file must exclude them.
    curvature : ndarray of float64, shape (N,), or None
        Mean curvature at the points, in 1/mm, positive on gyri, from `Surface.mean_curvature` of the whole surface
        before it was cut. None for the method "grossmann2002", whose surface has no triangles.
    sulcal_depth : ndarray of float64, shape (N,), or None
        Depth of the points in folds, in mm, positive in sulci, from `Surface.sulcal_depth` of the same surface.
    spread : ndarray of float64, shape (N,), or None
        For a map of a group, how much people differ at each point: the standard deviation of their changes of area, as
        log2 of the factor.
    white_points, pial_points : ndarray of float64, shape (N, 3), or None
        Positions of the points on the white and pial surfaces, in `space`, if both are known.
    cuts : tuple of Cut
        The cuts along which the surface was opened: given cuts or those of a template, then automatic ones.
    cuts_by : str or None
        Who chose the cuts: "given", "automatic", "standard" or the name of a template, "start" or "charts".
    method : str
        Name of the method; "given" for a map that another tool made.
    seed : int
        Seed of all random choices.
    warnings : tuple of str
        Reasons to check the map, which were also logged.
    frame : str or None
        What the axes are aligned with: "standard" for the flat map of fsaverage5, "axis" for that of a chart.
    period : float or None
        The period of a map of a tube, in mm. The map of the chart "cylinder" of `Surface.charts` repeats in v with this
        period: it continues beyond its upper side at its lower side. Its distortion compares distances around the tube
        with distances to the nearest copy.
    store : Path or None
        The directory of stored distance rows.
    details : dict
        Entries of `metadata` beside those that the other fields write.
    record : dict
        `provenance` without the measures.

    See Also
    --------
    Surface.flatten : Make a flat map.
    load : Load a saved map.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> flat_map
    <FlatMap: 441 points, 42 x 42 mm, relative error 3.6 % of interior pairs, 3.6 % of all pairs at the best scale>
    >>> flat_map.uv.shape
    (441, 2)
    """

    _kind = "a map"
    _endings = MAP_ENDINGS
    _formats = """
    ``.npz`` and ``.voxflat`` hold the complete map, for `load`. ``.vtp``, ``.ply`` and ``.obj`` hold the triangles in
    the plane. ``.surf.gii`` is a flat surface for Connectome Workbench. ``.patch.flat`` and ``.flat.patch.3d`` are
    FreeSurfer patches, which pycortex also reads. Surfaces and patches have the mesh's own vertex numbers and one
    position per vertex. Surfaces place vertices beside the map at the origin, where no triangle uses them. Where a cut
    duplicates vertices, only one side is kept; patches exclude vertices on both sides of cuts, so that no triangle
    spans a cut. A warning reports how many triangles are lost in this way, or because they are torn; a ``.vtp`` keeps
    torn triangles, marked in the cell data ``torn``. ``.npz``, ``.voxflat`` and GIFTI include `provenance`.
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
    origin: Origin
    rows: NDArray[np.float32] | Table | None = None
    bridges: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    curvature: NDArray[np.float64] | None = None
    sulcal_depth: NDArray[np.float64] | None = None
    spread: NDArray[np.float64] | None = None
    white_points: NDArray[np.float64] | None = None
    pial_points: NDArray[np.float64] | None = None
    cuts: tuple[Cut, ...] = ()
    cuts_by: str | None = None
    method: str = "voxflat"
    seed: int = 0
    warnings: tuple[str, ...] = ()
    frame: str | None = None
    period: float | None = None
    store: Path | None = None
    details: dict[str, object] = field(default_factory=dict)
    record: Record = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(distortion := vars(self)["distortion"], Distortion):
            object.__setattr__(self, "distortion", replace(distortion, unit=self.origin.unit))

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.uv)

    def __repr__(self) -> str:
        width, height = np.ptp(self.uv, axis=0)
        size = in_unit(f"{rounded(width)} x {rounded(height)} mm", self.origin.named_unit)
        if not self.has_surface:
            known = "without its surface"
        elif self._is_measured:
            known = f"relative error {self.distortion._summary()}"
        else:
            known = "relative error not measured yet"
        return f"<FlatMap: {len(self)} points, {size}, {known}>"

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields; copies contain the distortion, not the surface on which it is measured."""
        measured = {"distortion": self.distortion} if self.has_surface else {}
        return {**super().__getstate__(), **measured}

    @property
    def _is_measured(self) -> bool:
        """Whether the distortion is known, rather than measured when it is read."""
        later = vars(self)["distortion"]
        return later.is_known if isinstance(later, MeasuredLater) else later is not None

    def _measured(self, progress: Progress | None = None) -> "FlatMap":
        """Measure the distortion, unless it is known, and return the map."""
        if isinstance(later := vars(self)["distortion"], MeasuredLater):
            later(progress)
        return self

    @property
    def has_surface(self) -> bool:
        """Whether the surface is known. Without it, a map has no `points`, `normals` and `distortion`."""
        return vars(self)["points"] is not None

    @property
    def is_voxels(self) -> bool:
        """Whether a volume, rather than a mesh, was flattened."""
        return self.origin.is_voxels

    @cached_property
    def _triangles(self) -> FlatTriangles:
        points, normals = vars(self)["points"], vars(self)["normals"]
        cortex = (self.white_points, self.pial_points)
        on_surface = SurfacePoints(points, normals, self.ids, self.origin, self.faces, *cortex)
        return FlatTriangles(self.uv, self.faces, self.torn, on_surface, period=self.period)

    @property
    def space(self) -> Space:
        """The coordinate space of the points, as in `Surface.space`.

        `Space.to_scanner` converts points to the scanner space in which volumes lie.
        """
        return self.origin.space

    @property
    def affine(self) -> NDArray[np.float64]:
        """The affine of the flattened volume from voxel indices to RAS+ mm, of shape (4, 4).

        It is not available for maps of meshes.
        """
        return self._triangles.on_surface.affine

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """The shape of the flattened volume. It is not available for maps of meshes."""
        return self._triangles.on_surface.volume_shape

    @property
    def spacing(self) -> float:
        """The typical distance between neighbouring points, in mm.

        For voxels, it is the geometric mean of the three spacings.
        """
        return self._triangles.spacing

    @property
    def pixel_size(self) -> float:
        """The default side length of a pixel, in mm.

        It is half of `spacing`, or about half if the map has a `period`, of which it is a whole fraction.
        """
        half = self.spacing / 2
        return half if self.period is None else self.period / max(1, round(self.period / half))

    @recording()
    def heat_map(self, pixel_size: float | None = None, *, of: str = "distances") -> FlatImage:
        """Return the distance error, or the spread between people, at each point as an image.

        It has the same pixels as the images that `image` returns.

        Parameters
        ----------
        pixel_size : float, optional
            Side length of a pixel, in mm; by default half of `spacing`.
        of : {"distances", "spread"}
            The values: the mean relative error of the distances from each position, or the `spread` of a group's map.

        Returns
        -------
        FlatImage
            The image, with NaN outside the map.

        Raises
        ------
        InputError
            If the values are unknown, or if the map is not that of a group.
        """
        checked_choice(of, "of", HEATS)
        values = self.spread if of == "spread" else self.distortion.per_point
        if values is None:
            raise InputError("the map has no spread between people. Pass the map of a group (voxflat group-map)")
        raster = self.raster(pixel_size)
        return FlatImage(raster.interpolate(values), raster.pixel_size, raster.origin, HEATS[of], unit=raster.unit)

    def texture(self, picture: ArrayLike) -> NDArray[np.number]:
        """Transfer a picture from the map to the surface.

        Parameters
        ----------
        picture : array_like, shape (H, W) or (H, W, C)
            The picture. It is centred on the map and scaled to just cover the bounding box of the map; its proportions
            are kept.

        Returns
        -------
        ndarray, shape (N,) or (N, C)
            Value of the picture at each point, with the type of the picture.
        """
        values = check_values(picture)
        found = values_at(values, place(self.uv, values.shape))
        return (np.round(found) if values.dtype.kind in "bui" else found).astype(values.dtype)

    @recording()
    def textured(self, picture: object, texel_size: float | None = None, *, repeat: bool = False) -> TexturedSurface:
        """Return the surface with a picture on it (Zigelman et al. 2002, section V).

        The picture is placed on the map as in `texture`, and the map provides the texture coordinates of the surface.
        The surface keeps its triangles, except for torn ones. Cuts of the map are seams of the texture.

        Parameters
        ----------
        picture : path, ndarray or PIL.Image.Image
            A grey or colour picture, optionally with opacity. Arrays have shape (H, W), (H, W, 3) or (H, W, 4), and
            type uint8, bool, or float from 0 to 1.
        texel_size : float, optional
            Side length of a pixel of the picture, in mm; by default chosen so that the picture just covers the bounding
            box of the map.
        repeat : bool
            Whether the picture is repeated beyond its borders.

        Returns
        -------
        TexturedSurface
            The surface, which can be saved as ``.obj``, ``.vtp``, ``.glb`` or ``.ply``.

        Raises
        ------
        InputError
            If `picture` is not a picture, or if it does not cover the map and `repeat` is False.
        FileNotFoundError, PermissionError
            If the file cannot be opened.
        """
        colours, source = as_picture(picture)
        coordinates = place(self.uv, colours.shape, texel_size)
        if not checked_switch(repeat, "repeat") and texel_size is not None:
            check_cover(coordinates, colours.shape, texel_size)
        faces = self.faces[~self.torn].astype(np.int64)
        points = self.space.to_scanner(self.points)
        known: dict[str, Any] = {"unit": self.origin.unit, "is_ras": self.origin.has_known_axes}
        if (one := distinct(points)).which.max() + 1 == len(points):
            return TexturedSurface(points, faces, coordinates, colours, repeat, source, **known)
        order = np.argsort(np.argsort(one.first))  # the two sides of a cut are one point with two coordinates
        closed = order[one.which][faces]
        return TexturedSurface(points[np.sort(one.first)], closed, coordinates, colours, repeat, source, faces, **known)

    def paint(self, values: ArrayLike, background: float = 0) -> NDArray[np.number]:
        """Write values of the points into a volume with the shape of the flattened volume.

        The map must have been made from a volume.

        Parameters
        ----------
        values : array_like, shape (N,) or (N, C)
            One value, or one row of values, per point.
        background : float, optional
            Value of all other voxels.

        Returns
        -------
        ndarray, shape (I, J, K) or (I, J, K, C)
            The volume, with the type of the values.

        Raises
        ------
        InputError
            If the numbers of values and points differ, or if the type of the values cannot hold the background.

        Examples
        --------
        >>> flat_map = voxflat.surface(voxflat.samples.ball()).disk((4, 12, 12), 6).flatten()
        >>> flat_map.paint(flat_map.uv[:, 0]).shape
        (24, 24, 24)
        """
        values = array_of(values, "values", as_nan=True)
        check_background(background, values.dtype)
        if values.ndim not in (1, 2) or len(values) != len(self):
            raise InputError(f"values has shape {values.shape}. Pass one value for each of the {len(self)} points")
        self._triangles.on_surface.need_volume("has no voxels to paint", "Flatten a volume instead")
        if self.origin.frame is not None:
            raise InputError("the points of another frame are not voxels of the flattened volume. Use Regions.volume")
        volume = np.full((*self.volume_shape, *values.shape[1:]), background, dtype=values.dtype)
        volume[tuple(self.ids.T)] = values
        return volume

    @recording()
    def regions(self, rois: object, *, layer: str = "rois", pixel_size: float | None = None) -> Regions:
        """Read regions of interest that were drawn on the map, or labels of the vertices of the mesh.

        Parameters
        ----------
        rois : dict, ndarray, sequence, FlatImage, path or napari Shapes layer
            Polygons in mm, each of shape (k, 2): one polygon, a list of polygons, or a dict keyed by name, such as
            {"V1": polygon}. Several polygons with the same name enclose one region. Alternatively, a label image on the
            pixels of the map, shape (H, W), with 0 outside regions; a napari Shapes layer over the map, whose feature
            column "name" contains the names; or a file. An ``.svg`` file is a voxflat figure with paths in a layer, a
            ``.json`` file holds polygons keyed by name, and ``.npy``, ``.png``, ``.tif``, ``.nii`` and ``.nii.gz``
            files are label images. ``.annot``, ``.label.gii`` and ``.dlabel.nii`` files, one or several FreeSurfer
            ``.label`` files, and the closed lines of one or several Workbench ``.border`` files hold vertices of the
            mesh; names and colours are kept. A border encloses the side with fewer vertices.
        layer : str
            Layer of the SVG file in which the regions were drawn.
        pixel_size : float, optional
            Pixel size at which a label image was drawn, in mm; by default the size in its file, or `pixel_size`.

        Returns
        -------
        Regions
            The regions on the map.

        Raises
        ------
        InputError
            If the regions cannot be read, are empty, or lie outside the map.
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

    @property
    def metadata(self) -> dict[str, object]:
        """How the map was made, for people and files: written from the fields, and read by no operation."""
        is_cut = self.cuts_by is not None or bool(self.cuts)  # not over the 26-neighbour graph
        of_cuts = {**described_cuts(self.cuts), "cuts_by": self.cuts_by, "frame": self.frame} if is_cut else {}
        others = {"period": self.period, "store": self.store and str(self.store), "provenance": self.record or None}
        return {
            **{"method": self.method, **self.origin._described(), **self.details, **of_cuts},
            **{"seed": self.seed, "warnings": list(self.warnings)},
            **{name: value for name, value in others.items() if value is not None},
        }

    def description(self) -> dict[str, object]:
        """Return the metadata with the distortion measures, ready for JSON.

        Undefined figures are None.

        Returns
        -------
        dict
            The metadata, and under ``distortion`` the result of `Distortion.figures`.

        See Also
        --------
        FlatMap.provenance : Record of how the map was made.
        """
        return {**self.metadata, "distortion": self.distortion.figures() if self.has_surface else None}

    def _described(self) -> Record:
        """Return the description as files hold it: the names of figures do not depend on the unit."""
        return {**self.metadata, "distortion": self.distortion._described() if self.has_surface else None}

    @property
    def provenance(self) -> Record:
        """The record of how the map was made.

        It lists the version, function, parameters, input files, warnings and distortion measures. The record of a map
        that another tool made has no measures.
        """
        context = {"space": self.space._described(), "warnings": list(self.warnings)}
        is_own = self.has_surface and self.method != GIVEN
        return {**self.record, **context, "figures": self.distortion.figures() if is_own else None}

    def _with_provenance(self, record: Record) -> "FlatMap":
        """Return the map with a provenance record, which is also written to its store of distance rows."""
        full = resolved(record, self.metadata)
        if self.store is not None:
            write_provenance(self.store, {**full, "unit": self.origin.named_unit})
        return self._with(record=full)

    def _why_not(self, path: Path) -> str:
        return f": {PATCH_ENDING} alone means a patch in 3-D space" if path.name.lower().endswith(PATCH_ENDING) else ""

    def _write(self, path: Path) -> None:
        name = path.name.lower()
        if name.endswith(SAVED_ENDINGS):
            write_map(path, self._arrays(), self._described())
        elif name.endswith(FLAT_PATCH_ENDINGS):
            warn_of_unit(path, self.origin.unit)
            write_patch(path, self._patch())
        elif name.endswith(".surf.gii"):
            warn_of_unit(path, self.origin.unit)
            write_mesh(path, self._flat_mesh(), self.provenance)
        else:
            write_mesh(path, self._mesh(with_torn=name.endswith(".vtp")))

    def _arrays(self) -> dict[str, Any]:
        """Return the arrays that the complete map consists of, as files name them."""
        arrays = {name: vars(self)[name] for name in _ARRAYS if vars(self)[name] is not None}
        if not self.has_surface:
            return arrays
        arrays |= {f"distortion_{name}": getattr(self.distortion, name) for name in ("per_point", "scatter")}
        if (triangles := self.distortion.triangles) is not None:
            arrays |= {f"distortion_{name}": getattr(triangles, name) for name in ("areal", "is_flipped")}
        if self.rows is not None and self.store is None:
            arrays["rows"] = np.asarray(self.rows)
        return arrays

    @property
    def _places(self) -> NDArray[np.float64]:
        """Positions of the points in 3-D, with z = 0."""
        return np.column_stack([self.uv, np.zeros(len(self))])

    def _mesh(self, *, with_torn: bool = False) -> Mesh:
        """Return the map as a mesh in the plane; torn triangles are marked or removed."""
        faces, face_data = self.faces.astype(np.int64), {}
        if with_torn and self.torn.any():
            face_data["torn"] = self.torn.astype(np.uint8)
        elif self.torn.any():
            faces = faces[~self.torn]
            told = (
                "%d of %d triangles are torn (the surface does not connect their corners). They are not written to "
                "the file. Save as .vtp to keep them, marked as torn"
            )
            log.warning(told, len(self.torn) - len(faces), len(self.torn))
        point_data = {"distance_error": self.distortion.per_point} if self.has_surface else {}
        structure = self.origin.structure
        return Mesh(self._places, faces, structure=structure, point_data=point_data, face_data=face_data)

    def _flat_mesh(self) -> Mesh:
        """Return the map as a mesh in the plane; maps of meshes keep the vertex numbers of the mesh."""
        if self.is_voxels:
            return self._mesh()
        count, structure = self.origin.mesh.vertices, self.origin.structure
        return mesh_of_vertices(self._places, self.ids, self.faces, count, structure)

    def _patch(self) -> Patch:
        """Return the map as a FreeSurfer patch."""
        if self.is_voxels:
            raise InputError("patch files hold vertex numbers of a mesh, but this map has voxels. Save as .surf.gii")
        of = self.origin.mesh
        return patch_of(self._places, self.ids, self.faces, self.bridges, of.vertices, of.merged)

    # ------------------------------------------------------------------- as objects of other packages

    def to_nilearn(self) -> "nilearn.surface.PolyMesh":
        """Convert the map of a mesh to a nilearn ``InMemoryMesh`` for ``plot_surf`` and ``view_surf``.

        The result has the vertices of the flattened mesh, in the same order, so data on that mesh can be plotted on it.
        Vertices excluded from the map lie at the origin and do not belong to any triangle.

        Returns
        -------
        nilearn.surface.InMemoryMesh
            Coordinates (u, v, 0), in mm.
        """
        mesh = self._flat_mesh()
        return require("nilearn.surface").InMemoryMesh(mesh.points, mesh.faces)

    def to_gifti(self) -> "nibabel.GiftiImage":
        """Convert the map to a nibabel ``GiftiImage``.

        The result is the flat surface that ``save("map.surf.gii")`` writes.

        Returns
        -------
        nibabel.gifti.GiftiImage
            The flat surface, with the vertices of the flattened mesh.
        """
        mesh = self._flat_mesh()
        warn_of_unit("GIFTI image", self.origin.unit)
        image: nibabel.GiftiImage = gifti.load(gifti.surface_bytes(mesh.points, mesh.faces, mesh.structure))
        return image

    def to_trimesh(self) -> "trimesh.Trimesh":
        """Convert the map to a ``trimesh.Trimesh`` object in the plane.

        The result has the vertices of the flattened mesh.

        Returns
        -------
        trimesh.Trimesh
            Coordinates (u, v, 0), in mm (or the unit of the surface), and their ``units`` if they are known.
        """
        mesh = self._flat_mesh()
        made: trimesh.Trimesh = require("trimesh").Trimesh(mesh.points, mesh.faces, process=False)
        if (unit := self.origin.unit) != "unknown":
            made.units = {"µm": "microns", "nm": "nanometers"}.get(unit, unit)
        return made

    def to_pyvista(self) -> "pyvista.PolyData":
        """Convert the map to a ``pyvista.PolyData`` object in the plane.

        Distortion measures are included as point data, as in the result of ``mesh.voxflat()``.

        Returns
        -------
        pyvista.PolyData
            A mesh with one point for each point of the map.
        """
        require("pyvista")
        return display.views.map_to_pyvista(self)

    @overload
    def plot(
        self, overlay: object | None = None, *, ax: None = None, **options: "Unpack[FigureOptions]"
    ) -> "Figure": ...

    @overload
    def plot(self, overlay: object | None = None, *, ax: "Axes", **options: "Unpack[FigureOptions]") -> "Axes": ...

    def plot(
        self, overlay: object | None = None, *, ax: "Axes | None" = None, **options: "Unpack[FigureOptions]"
    ) -> "Figure | Axes":
        """Draw the map with matplotlib.

        It accepts the options of `voxflat.figures.flat_map` and of `voxflat.figures.Overlay`.

        Parameters
        ----------
        overlay : Overlay, path, ndarray, image object or Volume, optional
            Data to show on top of the cortical folds.
        ax : matplotlib.axes.Axes, optional
            Axes to draw in; by default, a new figure is created.
        **options
            As in `voxflat.figures.flat_map`, and as in `voxflat.figures.Overlay`, such as `channel` or `threshold`.

        Returns
        -------
        matplotlib.axes.Axes or matplotlib.figure.Figure
            `ax`, or the new figure.

        Raises
        ------
        InputError
            As in `voxflat.figures.flat_map`.

        Examples
        --------
        >>> import matplotlib.pyplot as plt
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> figure, ax = plt.subplots()
        >>> flat_map.plot(flat_map.points[:, 2], ax=ax) is ax
        True
        """
        figure = display.views.map_with_overlay(self, overlay, ax=ax, **options)
        return figure if ax is None else ax

    def _repr_html_(self) -> str:
        """Return a picture of the map and a table of its distortion measures, for Jupyter."""
        figure = display.views.map_with_overlay(self)
        table = self.distortion.table() if self.has_surface else ""
        return page(self, table, figure, "The flat map, shaded by its folds")


def check_background(background: object, dtype: np.dtype[Any]) -> None:
    """Check that a background is a number that a type can hold."""
    if not is_number(background):
        raise InputError(f"background is {shown(background)}. Pass a number")
    if not _holds(dtype, background):
        raise InputError(f"background is {shown(background)}, which {dtype} cannot hold. Use another type")


def _holds(dtype: np.dtype[Any], number: float) -> bool:
    """Return whether a type can hold a number, except for rounding."""
    number = number.item() if isinstance(number, np.generic) else number  # otherwise limits would be cast to its type
    if dtype.kind in "iu":
        bounds = np.iinfo(dtype)
        return bool(bounds.min <= number <= bounds.max) and int(number) == number
    if dtype.kind == "b":
        return number in (0, 1)
    return dtype.kind != "f" or not abs(number) < math.inf or abs(number) <= float(np.finfo(dtype).max)


def load_saved(path: str | os.PathLike[str]) -> FlatMap:
    """Load a complete map, as `FlatMap.save` writes it to an .npz or .voxflat file."""
    return FlatMap(**read_map(path))
