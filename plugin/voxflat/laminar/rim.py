"""The class `Rim`, and the function that makes one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from voxflat import _core, display
from voxflat.arguments import Progress, checked_choice, checked_threads, log
from voxflat.errors import InputError
from voxflat.io.files import require
from voxflat.io.provenance import Record, Recorded, recording
from voxflat.io.sources import as_volume
from voxflat.io.volumes import Volume
from voxflat.laminar.columns import Columns, columns_of
from voxflat.laminar.field import Field, field_of
from voxflat.laminar.labels import Layered, layered
from voxflat.laminar.painting import flat_volume, on_map, pixels_of
from voxflat.laminar.profile import Layers, Profile, groups_of, profile_of
from voxflat.maps.colours import all_whole
from voxflat.maps.depth import LAYERINGS, checked_layers, vertex_areas
from voxflat.maps.flat_map import FlatMap, check_background
from voxflat.maps.surface_points import SurfacePoints
from voxflat.pipeline.surface import Surface
from voxflat.read_only import ReadOnly
from voxflat.surfaces.foreground import foreground_of
from voxflat.surfaces.uncertainty import warning_of

if TYPE_CHECKING:
    import pyvista

_FRAGMENT = 0.01  # area of a component of the middle surface, relative to the largest one, below which it is dropped
_PLAUSIBLE = (0.1, 20.0)  # thickness in mm


@dataclass(frozen=True, eq=False, repr=False)
class Rim(ReadOnly, Recorded):
    """Grey matter between an inner and an outer border, made by `voxflat.rim`.

    Each voxel of grey matter has a depth, from 0 at the inner border (white matter) to 1 at the outer border
    (cerebrospinal fluid), and a thickness.

    Parameters
    ----------
    labels : Layered
        The labels, in a box around the grey matter.
    values : Field
        The depths of the voxels, and the middle surface.
    surface : Surface
        The middle surface. Its `white_points` and `pial_points` are the nearest points on the inner and the outer
        border. It is open where the segmentation ends.
    provenance : dict
        The record of how the rim was made.

    See Also
    --------
    rim : Make a rim.

    Examples
    --------
    >>> voxflat.rim(voxflat.samples.rim())
    <Rim: 5680 voxels of grey matter, median thickness 2.44 mm>
    """

    labels: Layered
    values: Field
    surface: Surface
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        thickness = float(np.median(self.values.thickness))
        return f"<Rim: {len(self.values.depth)} voxels of grey matter, median thickness {thickness:.3g} mm>"

    def _with_provenance(self, record: Record) -> Rim:
        """Return the same rim with a provenance record, which its surface shares."""
        return replace(super()._with_provenance(record), surface=self.surface._with_provenance(record))

    def _report(self, where: Any = np.s_[:], region: str = "the grey matter") -> None:
        """Warn of uncertain depths in a region, which is given by an index of the voxels of grey matter."""
        if text := warning_of(self.values.uncertain[where], region):
            log.warning(text)

    def _depth(self, layering: str) -> Any:
        checked_choice(layering, "layering", LAYERINGS)
        return self.values.depth if layering == "equidistant" else self.values.volume_depth

    def _layer(self, count: int, layering: str) -> NDArray[np.int16]:
        """Return the layer of each voxel of grey matter, from 0."""
        depth: NDArray[np.float64] = self._depth(layering)
        count = checked_layers(count, "count")
        return np.minimum(np.floor(depth * count), count - 1).astype(np.int16)

    @recording()
    def depth(self, layering: str = "equivolume") -> Volume:
        """Return the depth of each voxel of grey matter.

        It is 0 at the inner border and 1 at the outer border.

        Parameters
        ----------
        layering : {"equivolume", "equidistant"}
            "equidistant" is the distance from the inner border, divided by the sum of the distances from both borders.
            "equivolume" is the share of the column's volume that lies below the voxel. As in Bok's principle, layers
            are then thinner on the convex side of a fold.

        Returns
        -------
        Volume
            Depth as float32; NaN outside the grey matter.

        Raises
        ------
        InputError
            The layering is unknown.

        Examples
        --------
        >>> rim = voxflat.rim(voxflat.samples.rim())
        >>> depth = rim.depth().data
        >>> bool(0 <= np.nanmin(depth) and np.nanmax(depth) <= 1)
        True
        """
        depth = self._depth(layering).astype(np.float32)
        self._report()
        return self.labels.in_volume(depth, np.nan)

    @recording()
    def layers(self, count: int, layering: str = "equivolume") -> Volume:
        """Divide the grey matter into layers.

        Layer k contains the voxels with a depth from (k - 1) / `count` to k / `count`.

        Parameters
        ----------
        count : int
            Number of layers.
        layering : {"equivolume", "equidistant"}
            Whether layers have equal volumes or equal thicknesses in each column, as in `depth`.

        Returns
        -------
        Volume
            Layers as int16, from 1 at the inner border to `count` at the outer border; 0 outside the grey matter.

        Raises
        ------
        InputError
            The number of layers is not between 1 and 1000, or the layering is unknown.

        Examples
        --------
        >>> rim = voxflat.rim(voxflat.samples.rim())
        >>> np.unique(rim.layers(3).data)
        array([0, 1, 2, 3], dtype=int16)
        """
        layers = self._layer(count, layering) + np.int16(1)
        self._report()
        return self.labels.in_volume(layers, 0)

    @recording()
    def paint(
        self,
        values: object,
        flat_map: FlatMap,
        *,
        layering: str = "equivolume",
        pixel_size: float | None = None,
        background: float = 0,
    ) -> Volume:
        """Transfer a flat volume to the voxels of the grey matter.

        Each voxel takes the value of one pixel, at the position of its column on the map and in its layer. Values are
        not interpolated, so labels are transferred exactly.

        Parameters
        ----------
        values : ndarray, FlatStack, path, image object or Volume
            The flat volume, such as ``flat_map.images(volume, depths=21)``, or labels drawn in it. An array has the
            shape (depth, row, column), as `FlatStack.data`. An image has the axes (row, column, depth), as the NIfTI
            files of `FlatStack.save`.
        flat_map : FlatMap
            The map of `surface`, or of a part of it.
        layering : {"equivolume", "equidistant"}
            The layering with which the flat volume was made.
        pixel_size : float, optional
            Side length of a pixel of an array, in mm; by default that of `FlatMap.raster`.
        background : float
            Value of voxels whose column is not on the map, and of those without a value.

        Returns
        -------
        Volume
            The values; whole numbers of a floating-point type become int32.

        Raises
        ------
        InputError
            The flat volume does not fit the map or the layering, no column lies on the map, or the type of the values
            cannot hold the background.

        Examples
        --------
        >>> rim = voxflat.rim(voxflat.samples.rim())
        >>> flat_map = rim.surface.flatten()
        >>> flat_volume = flat_map.images(rim.layers(3), depths=3)
        >>> np.unique(rim.paint(flat_volume, flat_map).data)
        array([0, 1, 2, 3], dtype=int32)
        """
        data, raster = flat_volume(values, flat_map, pixel_size, layering)
        check_background(background, data.dtype)
        layer = self._layer(len(data), layering)
        uv, is_on = on_map(flat_map, self.values.halfway, self.labels.affine, self.surface.space)
        if not is_on.any():
            raise InputError("no column of the rim lies on the map. Pass a map of the surface of this rim")
        self._report(is_on, "the painted grey matter")
        rows, columns = pixels_of(uv, raster)
        painted = np.full(len(layer), background, dtype=data.dtype)
        painted[is_on] = data[layer[is_on], rows, columns]
        if painted.dtype.kind == "f":
            painted[np.isnan(painted)] = background
            if all_whole(painted) and np.abs(painted).max() <= np.iinfo(np.int32).max:
                painted = painted.astype(np.int32)
        return self.labels.in_volume(painted, background)

    @recording()
    def streamlines(self) -> Volume:
        """Return the direction of the column of each voxel of grey matter, from the inner to the outer border.

        It is perpendicular to the middle surface where the column crosses it. Use it, for example, to compute the angle
        between the cortex and the main magnetic field.

        Returns
        -------
        Volume
            Unit vectors (right, anterior, superior) of shape (I, J, K, 3) as float32; NaN outside the grey matter.

        Examples
        --------
        >>> rim = voxflat.rim(voxflat.samples.rim())
        >>> directions = rim.streamlines().data
        >>> directions.shape[3]
        3
        """
        self._report()
        return self.labels.in_volume(self.values.columns.astype(np.float32), np.nan)

    @recording()
    def thickness(self) -> Volume:
        """Return the thickness of the grey matter at each of its voxels.

        It is the sum of the distances from the inner and outer borders.

        Returns
        -------
        Volume
            Thickness in mm as float32; NaN outside the grey matter.
        """
        self._report()
        return self.labels.in_volume(self.values.thickness.astype(np.float32), np.nan)

    @recording()
    def profile(
        self,
        volume: object,
        regions: object | None = None,
        *,
        count: int = 20,
        layering: str = "equivolume",
        channel: int | str | None = None,
        interpolation: str | None = None,
        nan_policy: str = "omit",
    ) -> Profile:
        """Return the mean and the standard deviation of a volume in each layer, for each region.

        The volume is sampled at the centres of the voxels of grey matter.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            Scalars of shape (I, J, K), or (I, J, K, C) for several channels or frames. The grid may differ from that of
            the rim: the affine defines the position. An array without an affine must have the shape of the rim.
        regions : path, ndarray, image object, Volume or Regions, optional
            A mask, or a volume of labels, in which 0 is outside all regions; voxels take the nearest label if the grid
            differs from that of the rim. Alternatively, the result of `FlatMap.regions` for a map of `surface`. Each
            voxel then belongs to the region that contains its column. By default, one region of all grey matter.
        count : int
            Number of layers, as in `layers`.
        layering : {"equivolume", "equidistant"}
            As in `layers`.
        channel : int or str, optional
            Number (from 0) or name of the channel, if there are several; by default all of them.
        interpolation : {"linear", "nearest"}, optional
            Interpolation between voxels of the volume; by default nearest for integers, and linear otherwise.
        nan_policy : {"omit", "propagate"}
            What to do about voxels at which the volume has no finite value: "omit" leaves them out, and "propagate"
            makes the values of their layer NaN. `Profile.missing` counts them.

        Returns
        -------
        Profile
            The values, which can be drawn and saved as a table.

        Raises
        ------
        InputError
            A parameter is not valid, the volume has no values in the grey matter, or a region contains no voxel.

        Examples
        --------
        >>> rim = voxflat.rim(voxflat.samples.rim())
        >>> rim.profile(rim.depth(), count=4).mean.round(1)
        array([[0.1, 0.4, 0.6, 0.9]])
        """
        places = SurfacePoints(
            points=self.labels.places(self.labels.grey),
            normals=np.empty((0, 3)),
            ids=self.labels.grey + self.labels.first,
            origin=self.surface.origin,
            faces=np.empty((0, 3), dtype=np.uint32),
            called="rim",
        )
        layers = Layers(self._layer(count, layering), count, layering)
        groups = groups_of(regions, places, self.values.halfway)
        for number, name in enumerate(groups.names):
            self._report(groups.of == number, f"the {name}" if regions is None else f"the region {name}")
        return profile_of(volume, places, groups, layers, channel, interpolation, nan_policy)

    @recording()
    def columns(
        self, count: int | None = None, *, area: float | None = None, seed: int = 0, progress: Progress | None = None
    ) -> Columns:
        """Divide the grey matter into columns from the inner to the outer border.

        The centres of the columns are spread evenly over the middle surface: each is the point farthest along the
        surface from the previous ones. Each voxel belongs to the column whose centre is nearest, along the surface, to
        the point of the middle surface on the voxel's path between the borders. All voxels of a column are connected.

        Parameters
        ----------
        count : int, optional
            Number of columns.
        area : float, optional
            Mean area of a column on the middle surface in mm², instead of `count`.
        seed : int
            Seed of the first centre.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        Columns
            The column of each voxel and of each vertex of the middle surface, with centres and areas.

        Raises
        ------
        InputError
            Neither or both of `count` and `area` are given, or there are more columns than vertices.
        Cancelled
            `progress` returned False.

        Examples
        --------
        >>> columns = voxflat.rim(voxflat.samples.rim()).columns(area=10.0)
        >>> len(columns)
        16
        """
        columns = columns_of(self.labels, self.values, self.surface, count, area, seed, progress)
        self._report()
        return columns

    def to_pyvista(self, columns: Columns | None = None) -> pyvista.MultiBlock:
        """Convert the borders and the middle surface to PyVista meshes, in RAS+ mm.

        The same point number refers to corresponding places on the three meshes.

        Parameters
        ----------
        columns : Columns, optional
            Columns of this rim, to include their numbers.

        Returns
        -------
        pyvista.MultiBlock
            The blocks ``inner``, ``middle`` and ``outer``. Their point data are ``thickness``, which is the distance
            between the borders in mm, ``voxel_ids`` (i, j, k) and, if given, ``column`` (0 for none). The column is
            active if it is given, otherwise the thickness.

        Raises
        ------
        InputError
            The columns are not those of this rim.
        """
        require("pyvista")
        if columns is not None and len(columns.vertex_columns) != len(self.surface):
            raise InputError(
                f"the columns have {len(columns.vertex_columns)} vertices, but the middle surface has "
                f"{len(self.surface)}. Pass columns of this rim"
            )
        return display.views.rim_to_pyvista(self, columns)


@recording()
def rim(
    source: object,
    *,
    inner: object | None = None,
    outer: object | None = None,
    grey: object | None = None,
    hemisphere: str | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    memory_limit: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Rim:
    """Measure depth in a segmentation of the grey matter and its borders, as used for layer fMRI.

    The segmentation may cover a patch of cortex, a few slices or a complete hemisphere, and the borders may be lines of
    single voxels. Where it ends, the layers are assumed to continue straight outwards, so the ends belong to neither
    border. Borders are surfaces with subvoxel positions, and distances to them are exact. The middle surface, where the
    equidistant depth is one half, can be flattened like any other surface.

    Parameters
    ----------
    source : ndarray, path, image object or Volume
        The labels, of shape (I, J, K). By default 1 is the outer border (cerebrospinal fluid), 2 the inner border
        (white matter) and 3 grey matter, as in LayNii.
    inner, outer, grey : int, or mask, optional
        Other labels, or masks with the shape of the volume (array, path, image object or Volume). If `inner` and `grey`
        are given without `outer`, all other voxels belong to the outer border.
    hemisphere : {"left", "right"}, optional
        The hemisphere, if the labels are those of a FreeSurfer ``ribbon.mgz`` (2 and 3, or 41 and 42).
    spacing : sequence of 3 floats, optional
        Voxel size in mm, for volumes that do not define it (.npy files and arrays); by default 1.
    affine : array_like, shape (4, 4), optional
        Matrix from voxel indices to RAS+ mm, for volumes that do not define it.
    memory_limit : int, optional
        Maximum amount of memory to use, in bytes; by default the free memory.
    threads : int, optional
        Number of threads; by default one per core.
    progress : callable, optional
        As in `flatten`.

    Returns
    -------
    Rim
        Depth and thickness of the grey matter, and its middle surface.

    Raises
    ------
    InputError
        A part is missing, the grey matter does not touch both borders, or the labels are not whole numbers.
    Cancelled
        `progress` returned False.

    See Also
    --------
    surface : Make a surface from a label volume or a mesh.

    References
    ----------
    Waehnert et al. (2014), Anatomically motivated modeling of cortical laminae, NeuroImage 93. Huber et al. (2021),
    LayNii: a software suite for layer-fMRI, NeuroImage 237.

    Examples
    --------
    >>> rim = voxflat.rim(voxflat.samples.rim())
    >>> rim.layers(10).data.max()
    np.int16(10)
    >>> flat_map = rim.surface.flatten()
    """
    threads = checked_threads(threads)
    volume = as_volume(source, spacing=spacing, affine=affine).in_unit("mm")
    labels = layered(volume, {"inner": inner, "outer": outer, "grey": grey}, hemisphere)
    values = field_of(labels, threads, progress)
    usual = float(np.median(values.thickness))
    if not _PLAUSIBLE[0] < usual < _PLAUSIBLE[1]:
        log.warning("the median thickness of the grey matter is %.3g mm. Check the voxel size", usual)
    return Rim(labels, values, _middle_surface(labels, values))


def _is_fragment(core: _core.Surface, area: float) -> NDArray[np.bool_]:
    """Return the triangles of components that are smaller than an area, and much smaller than the largest one.

    Where the grey matter is thinner than a voxel, the middle surface consists of many small components.
    """
    faces = core.faces
    links = scipy.sparse.coo_matrix(
        (np.ones(faces.size), (faces.ravel(), np.roll(faces, 1, axis=1).ravel())), shape=(len(core), len(core))
    )
    component = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    areas = np.bincount(component, vertex_areas(core.points, faces))
    return np.asarray((areas < min(area, _FRAGMENT * areas.max()))[component[faces[:, 0]]])


def _middle_surface(labels: Layered, values: Field) -> Surface:
    """Return the part of the middle surface that lies in the grey matter."""
    core, _ = _core.Surface.from_triangles(values.points, values.faces.astype(np.int64), True)
    core = core.part_of_faces(~_is_fragment(core, 4 * np.pi * float(np.median(values.thickness)) ** 2))
    volume = labels.volume
    grey = np.zeros(volume.data.shape, dtype=np.uint8)
    grey[tuple((labels.grey + labels.first).T)] = 1
    made_of = foreground_of(replace(volume, data=grey), label=1).origin
    halfway = "midthickness: halfway between the borders of the grey matter"
    origin = replace(made_of, is_sheet=False, measured_on=halfway)
    details: dict[str, object] = {"placed_by": "half of the equidistant depth"}
    voxels = labels.voxels(values.points) + labels.first  # vertices at an end of the volume may lie just outside it
    voxels = voxels.clip(0, np.array(volume.data.shape) - 1)
    return Surface(
        core,
        voxels,
        origin,
        details,
        white_points=values.inner,
        pial_points=values.outer,
        uncertain=values.uncertain_points,
    )
