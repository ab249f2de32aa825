"""Features shared by maps and atlas pages: pixels, the data that they show, and lookups on the surface."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import checked_number, log, numbers_of, shown
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, voxel_size
from voxflat.io.provenance import Record, recording
from voxflat.maps.depth import Depths
from voxflat.maps.metric import Metric
from voxflat.maps.raster import FlatImage, FlatStack, Raster
from voxflat.maps.sampling import Sampling
from voxflat.maps.sources import source_of
from voxflat.maps.surface_points import NO_POINTS, SurfacePoints, needs_surface
from voxflat.read_only import ReadOnly

_FACTORS = {"mm": {"µm": 1e-3, "m": 1e3}, "µm": {"mm": 1e3, "nm": 1e-3}, "m": {"mm": 1e-3}}  # likely wrong units
LIMIT = 5.0  # default distance of points from the surface, mm; the cortex is up to 4.5 mm thick


@needs_surface(points=NO_POINTS)
@dataclass(frozen=True, eq=False)
class Places(ReadOnly):
    """Points in the plane, with their positions on the surface.

    `FlatMap.look_up` returns them.

    Parameters
    ----------
    face_ids : ndarray of int64, shape (...)
        The triangle at each point, as a row number of `faces`; −1 outside all triangles.
    weights : ndarray of float64, shape (..., 3)
        Barycentric coordinates with respect to the corners of the triangle; NaN outside all triangles.
    points : ndarray of float64, shape (..., 3)
        Positions on the surface, in RAS+ mm in its `space`; NaN outside all triangles. A map without its surface has
        none.
    piece_ids : ndarray of int64, shape (...)
        The piece of an atlas, or 0 on a map, which has only one piece; −1 outside all triangles.

    See Also
    --------
    FlatMap.look_up : Look up points in the plane.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> flat_map.look_up([flat_map.uv[0], (1e3, 1e3)])
    <Places: 1 of 2 on a triangle>
    """

    face_ids: NDArray[np.int64]
    weights: NDArray[np.float64]
    points: NDArray[np.float64]
    piece_ids: NDArray[np.int64]

    def __repr__(self) -> str:
        count = int(np.count_nonzero(self.face_ids >= 0))
        return f"<Places: {count} of {self.face_ids.size} on a triangle>"


@dataclass(frozen=True, eq=False)
class FlatTriangles(ReadOnly):
    """Triangles in the plane, with the corresponding points on the surface.

    Maps and pages use them for drawing and for looking up points.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        Positions in the plane, in mm.
    faces : ndarray of uint32, shape (F, 3)
        The triangles.
    torn : ndarray of bool, shape (F,)
        Mask of the triangles whose corners are not connected on the surface; they show the nearest corner.
    on_surface : SurfacePoints
        The same N points on the surface.
    piece_ids : ndarray of int64, shape (F,), or None
        The piece of each triangle, if there are several pieces.
    period : float or None
        The length after which the map repeats in v, in mm.

    See Also
    --------
    FlatMap : A flattened surface.

    Examples
    --------
    >>> len(voxflat.samples.hill().flatten().faces)
    800
    """

    uv: NDArray[np.float64]
    faces: NDArray[np.uint32]
    torn: NDArray[np.bool_]
    on_surface: SurfacePoints
    piece_ids: NDArray[np.int64] | None = None
    period: float | None = None

    @cached_property
    def spacing(self) -> float:
        """The typical distance between neighbours, in mm: the voxel spacing, or the median edge in the plane."""
        if self.on_surface.origin.is_voxels:
            return voxel_size(self.on_surface.affine)
        sides = self.uv[self.faces] - self.uv[np.roll(self.faces, 1, axis=1)]
        return float(np.median(np.linalg.norm(sides, axis=2)))


class Planar(ReadOnly, ABC):
    """Base class of maps and pages: triangles in the plane with known positions on the surface."""

    _default_interpolation: Callable[[int], str | None] | None = None  # of each channel, in a series

    @property
    @abstractmethod
    def _triangles(self) -> FlatTriangles:
        """The triangles that are drawn and looked up."""

    @property
    @abstractmethod
    def pixel_size(self) -> float:
        """The default side length of a pixel, in mm."""

    @cached_property
    def _rasters(self) -> dict[float, Raster]:
        return {}

    @cached_property
    def _finder(self) -> _core.TriangleFinder:
        flat = self._triangles
        return _core.TriangleFinder(np.ascontiguousarray(flat.uv[flat.faces], dtype=np.float64))

    def raster(self, pixel_size: float | None = None) -> Raster:
        """Return the pixels with their positions on the surface.

        Rasters are cached, so repeated calls are fast.

        Parameters
        ----------
        pixel_size : float, optional
            Side length of a pixel, in mm; by default `pixel_size`.

        Returns
        -------
        Raster
            On a map, `corners` are points of the map. On a page, corner 3 t + k is corner k of triangle t.

        Raises
        ------
        InputError
            If the pixel size is not positive, or so small that the image would be too large.
        """
        size = self.pixel_size if pixel_size is None else checked_number(pixel_size, "pixel size")
        if size not in self._rasters:
            flat = self._triangles
            corners, weights, (u, v) = _core.draw(flat.uv, flat.faces, flat.torn, size)
            unit = flat.on_surface.origin.named_unit
            self._rasters[size] = Raster(corners, weights, (u, v), size, unit)
        return self._rasters[size]

    def locate(self, pixel_size: float | None = None) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Find the position of each pixel on the surface.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        ids : ndarray of int64, shape (H, W, 3) or (H, W)
            The nearest surface voxel or vertex; −1 outside the map.
        points : ndarray of float64, shape (H, W, 3)
            Positions, in RAS+ mm in the surface's `space`, interpolated linearly between vertices; NaN outside the map.

        Examples
        --------
        >>> ids, points = voxflat.samples.hill().flatten().locate(pixel_size=1.0)
        >>> ids.shape, points.shape
        ((43, 43), (43, 43, 3))
        """
        surface, raster = self._triangles.on_surface, self.raster(pixel_size)
        nearest = raster.nearest
        inside = (nearest >= 0)[..., None] if surface.origin.is_voxels else nearest >= 0
        return np.where(inside, surface.ids[nearest], -1), raster.interpolate(surface.points)

    def look_up(self, places: ArrayLike) -> Places:
        """Look up the triangle, the piece and the surface position at points in the plane.

        In a torn triangle, whose corners are not connected on the surface, the nearest corner is used. Where triangles
        overlap, the first one is used.

        Parameters
        ----------
        places : array_like, shape (..., 2)
            Positions (u, v), in mm.

        Returns
        -------
        Places
            The results, with −1 and NaN outside all triangles.

        Raises
        ------
        InputError
            If `places` has the wrong shape.

        Examples
        --------
        >>> places = voxflat.samples.hill().flatten().look_up([[0.0, 0.0], [500.0, 0.0]])
        >>> places.face_ids[1]  # outside the map
        np.int64(-1)
        """
        points = numbers_of(places, "places")
        if points.ndim == 0 or points.shape[-1] != 2:
            raise InputError(f"places has shape {points.shape}. Pass (u, v) in mm as an array of shape (..., 2)")
        flat, rows, shape = self._triangles, points.reshape(-1, 2), points.shape[:-1]
        triangles, weights = self._finder.find(np.ascontiguousarray(rows))
        if (is_torn := (triangles >= 0) & flat.torn[triangles]).any():
            apart = np.linalg.norm(flat.uv[flat.faces[triangles[is_torn]]] - rows[is_torn, None], axis=2)
            weights[is_torn] = np.eye(3)[apart.argmin(axis=1)]
        spots: Any = None
        if flat.on_surface.is_known:
            spots = np.einsum("pc,pcx->px", weights, flat.on_surface.points[flat.faces[triangles]])  # NaN outside
            spots = spots.reshape(*shape, 3)
        pieces = np.where(triangles < 0, -1, 0 if flat.piece_ids is None else flat.piece_ids[triangles])
        return Places(triangles.reshape(shape), weights.reshape(*shape, 3), spots, pieces.reshape(shape))

    @cached_property
    def _nearest_finder(self) -> _core.NearestFinder:
        points = np.ascontiguousarray(self._triangles.on_surface.points, dtype=np.float64)
        return _core.NearestFinder(points, np.ascontiguousarray(self._whole_faces, dtype=np.uint32))

    @cached_property
    def _whole_faces(self) -> NDArray[np.uint32]:
        """The triangles that are not torn."""
        flat = self._triangles
        return flat.faces[~flat.torn] if flat.torn.any() else flat.faces

    @cached_property
    def _metric(self) -> Metric:
        flat = self._triangles
        return Metric.of(flat.on_surface.points, flat.uv, flat.faces, flat.torn)

    def _nearest(
        self, points: NDArray[np.float64], limit: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the nearest triangle that is not torn (−1 beyond the limit), the weights there, and the distance."""
        triangles, weights, distance = self._nearest_finder.find(np.ascontiguousarray(points), limit)
        whole = np.append(np.flatnonzero(~self._triangles.torn), -1)
        return whole[triangles], weights, distance

    def points_to_map(
        self, points: ArrayLike, limit: float = LIMIT, *, space: str = "surface"
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Find points in space on the map, each at the nearest position on the surface.

        Points on a cut are assigned to one of its sides.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points, in RAS+ mm.
        limit : float
            Maximum distance between a point and the surface, in mm; by default 5, more than the thickness of the
            cortex. The surface is that of the map's `points`, which lies midway between white and pial if ``pial=`` was
            passed.
        space : {"surface", "scanner"}
            Space of the points: the surface's own `space`, as in the result of `locate`, or scanner RAS, as for
            volumes.

        Returns
        -------
        uv : ndarray of float64, shape (..., 2)
            Positions on the map, in mm; NaN for points beyond the limit. A warning reports if this applies to all.
        distance : ndarray of float64, shape (...)
            Exact distance from each point to the triangles of the surface, in mm; NaN beyond the limit.

        Raises
        ------
        InputError
            If `points` has the wrong shape, or the limit or the space is not valid.

        Examples
        --------
        >>> uv, far = voxflat.samples.hill().flatten().points_to_map([[0.0, 0.0, 10.0]])
        >>> uv.shape, far.round(1)
        ((1, 2), array([0.]))
        """
        rows = self._checked_points(points, space)
        uv, _, distance = self._to_map(rows.reshape(-1, 3), limit)
        if warning := self._distance_warning(rows.reshape(-1, 3), limit, distance):
            log.warning("%s", warning)
        return uv.reshape(*rows.shape[:-1], 2), distance.reshape(rows.shape[:-1])

    def _distance_warning(self, points: NDArray[np.float64], limit: float, distance: NDArray[np.float64]) -> str:
        """Describe that few points lie near the surface: most of them would in another unit, or none does."""
        placed = int(np.count_nonzero(np.isfinite(distance)))
        if 10 * placed >= len(distance):
            return ""
        unit = self._triangles.on_surface.origin.named_unit
        near = in_unit(f"{limit:g} mm", unit)
        text = f"{placed:,} of {len(points):,} points are within {near} of the surface. "
        for other, factor in _FACTORS.get(unit, {}).items():
            _, _, distance = self._nearest(points * factor, limit)
            if 2 * np.count_nonzero(np.isfinite(distance)) > len(points):
                return f"{text}Most would be if they are in {other}. Convert them to {unit}, the unit of the map"
        kind = "has no unit" if unit == "unknown" else f"is in {unit}"
        return "" if placed else f"{text}Check their coordinate space and their unit; the map {kind}"

    def _checked_points(self, points: ArrayLike, space: str) -> NDArray[np.float64]:
        """Return points in the space of the surface."""
        rows = numbers_of(points, "points")
        if rows.ndim == 0 or rows.shape[-1] != 3:
            raise InputError(f"points has shape {rows.shape}. Pass RAS+ points in mm as an array of shape (..., 3)")
        if not isinstance(space, str) or space not in ("surface", "scanner"):
            raise InputError(f"space is {shown(space)}. Pass 'surface' or 'scanner'")
        native = self._triangles.on_surface.origin.space
        if space == "scanner":
            if native.warning:
                log.warning("points may not lie on the surface: %s", native.warning)
            rows = native.from_scanner(rows)
        return rows

    def _to_map(
        self, points: NDArray[np.float64], limit: float
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """Return the map positions of points, their triangles and their distances; NaN and −1 beyond the limit."""
        limit = checked_number(limit, "limit")
        if not limit >= 0:
            raise InputError(f"limit is {limit}. Pass 0 or a positive number")
        face_ids, weights, distance = self._nearest(points, limit)
        flat = self._triangles
        return np.einsum("pc,pcx->px", weights, flat.uv[flat.faces[face_ids]]), face_ids, distance

    def vectors_to_map(
        self, points: ArrayLike, vectors: ArrayLike, limit: float = LIMIT, *, space: str = "surface"
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Transfer vectors on the surface, such as velocities, to the map (push-forward).

        The metric of the map corrects their lengths and angles. Components along the normal of the surface vanish.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points at which the vectors start, as in `points_to_map`.
        vectors : array_like, shape (..., 3)
            Vectors along x, y and z, in mm or, for velocities, in mm per unit of time.
        limit, space : optional
            As in `points_to_map`; vectors have the same space as the points.

        Returns
        -------
        uv : ndarray of float64, shape (..., 2)
            Positions of the points on the map, in mm; NaN beyond the limit.
        flat : ndarray of float64, shape (..., 2)
            Vectors along u and v, in the unit of `vectors`; NaN beyond the limit.

        Raises
        ------
        InputError
            If the points or the vectors have the wrong shape, or the limit or the space is not valid.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> uv, flat = flat_map.vectors_to_map(flat_map.points, np.ones((441, 3)))
        >>> flat.shape
        (441, 2)
        """
        rows = self._checked_points(points, space)
        along = _checked_vectors(vectors, rows.shape, "points")
        if space == "scanner":
            native = self._triangles.on_surface.origin.space
            along = native.from_scanner(along) - native.from_scanner(np.zeros(3))
        uv, face_ids, distance = self._to_map(rows.reshape(-1, 3), limit)
        if warning := self._distance_warning(rows.reshape(-1, 3), limit, distance):
            log.warning("%s", warning)
        flat = np.einsum("pab,pb->pa", self._metric.to_map[face_ids], along.reshape(-1, 3))
        flat[face_ids < 0] = np.nan
        return uv.reshape(*rows.shape[:-1], 2), flat.reshape(*rows.shape[:-1], 2)

    def vectors_to_surface(
        self, places: ArrayLike, vectors: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Transfer vectors on the map, such as optical flow, to the surface (pull-back).

        The results are tangent to the surface and have the true lengths and angles. For a flow of (rows, columns) in
        pixels, pass ``(columns * pixel_size, -rows * pixel_size)``.

        Parameters
        ----------
        places : array_like, shape (..., 2)
            Positions (u, v) at which the vectors start, in mm.
        vectors : array_like, shape (..., 2)
            Vectors along u and v, in mm or, for velocities, in mm per unit of time.

        Returns
        -------
        points : ndarray of float64, shape (..., 3)
            Positions on the surface, as in `look_up`; NaN outside the map.
        on_surface : ndarray of float64, shape (..., 3)
            Vectors along x, y and z in the surface's `space`, in the unit of `vectors`; NaN outside the map.

        Raises
        ------
        InputError
            If `places` or `vectors` has the wrong shape.

        Examples
        --------
        >>> points, along = voxflat.samples.hill().flatten().vectors_to_surface([[0.0, 0.0]], [[1.0, 0.0]])
        >>> along.shape
        (1, 3)
        """
        hits = self.look_up(places)
        flat = _checked_vectors(vectors, (*hits.face_ids.shape, 2), "places")
        along = np.einsum("...ab,...b->...a", self._metric.to_surface[hits.face_ids], flat)
        return hits.points, np.where((hits.face_ids < 0)[..., None], np.nan, along)

    @property
    @abstractmethod
    def provenance(self) -> Record:
        """The record of how the map or page was made."""

    @recording()
    def image(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        channel: int | str | None = None,
        depth: float | Sequence[float] = 0.0,
        fraction: float | Sequence[float] | None = None,
        layering: str = "equivolume",
        projection: str = "mean",
        interpolation: str | None = None,
        period: float | None = None,
        nan_policy: str = "omit",
        name: str = "",
    ) -> FlatImage:
        """Show a volume, or values at the vertices, on the map.

        If there are several depths, their projection is shown. `images` returns each depth, frame or channel.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            Scalars or labels (I, J, K), or uint8 colours (I, J, K, 3 or 4). The grid may differ from that of the
            flattened volume: the affine defines the position, in scanner RAS. An array without an affine must have the
            shape of the flattened volume, and gets its affine. A dask or zarr array, or an OME-Zarr path, may be larger
            than memory; each chunk that the surface intersects is read once. For meshes, values at the vertices are
            also accepted: an array of shape (V,), or a file (GIFTI, CIFTI, FreeSurfer curv, annot or .mgh, NIfTI of
            shape (V, 1, 1)); uint8 colours of shape (V, 3) or (V, 4); or the texture of the surface as .obj, .vtp or
            .ply (Zigelman et al. 2002, figure 3). Files with several maps, arrays of shape (V, K) and series of volumes
            require `channel`.
        pixel_size : float, optional
            As in `raster`.
        channel : int or str, optional
            Number (from 0) or name of the channel to show, if there are several.
        depth : float or sequence of float
            Distance outside the surface at which to sample, in the unit of the map; negative values are inside. Grey
            matter lies about 2 mm outside white matter. Points move along the normals of the surface, which are
            averaged where layers between the surface and the depths would otherwise cross.
        fraction : float or sequence of float, optional
            Cortical depth at which to sample, from 0 (white surface) to 1 (pial surface), instead of `depth`. This
            requires a map of a white surface that was read with ``pial=``.
        layering : {"equivolume", "equidistant"}
            Whether a fraction refers to the local volume of the cortex (Waehnert et al. 2014), which follows layers
            through gyri and sulci, or to its thickness.
        projection : {"mean", "max", "sum"}
            The value that is shown for several depths or fractions. Of labels, "mean" is the most frequent one.
        interpolation : {"linear", "nearest", "majority"}, optional
            The default is "nearest" for bool and integer volumes, which may be labels, and "linear" for floating-point
            volumes and colours. Integers in TIFF and OME-Zarr files are labels only if most neighbouring voxels are
            equal, which a warning reports; otherwise they are intensities, and the default is "linear". "majority" is
            for labels: it shows the label with the greatest weight among the surrounding voxels (for an overlay, the
            corners of the triangle) at all depths, so that borders are smoother than voxel borders.
        period : float, optional
            Period of phase values, such as 360. Means of phases are circular, from 0 to the period, and interpolation
            is "linear" by default.
        nan_policy : {"omit", "propagate"}
            What to do at pixels where some of several depths have no value: they are NaN, infinite, or outside the
            volume. "omit" computes the mean and the maximum of the other depths, and "propagate" makes these pixels
            NaN. In both cases, a warning counts them. A sum always needs values at all depths.
        name : str, optional
            Title of the image.

        Returns
        -------
        FlatImage
            The image, with NaN (for colours, alpha 0) outside the triangles and where the volume has no value.

        Raises
        ------
        InputError
            If the volume does not fit, cannot be read, or has several channels and none is selected. Also raised for a
            mean of labels, and for fractions without a pial surface.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.image(flat_map.points[:, 2], pixel_size=1.0)  # heights, one value per vertex
        <FlatImage: overlay, 43 x 43 pixels of 1>
        """
        sampling = Sampling(Depths.of(depth, fraction, layering), projection, interpolation, period, nan_policy)
        source = source_of(self._triangles.on_surface, volume)
        return source.image(self.raster(pixel_size), sampling, channel=channel, name=name)

    @recording()
    def images(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        channel: int | str | None = None,
        depth: float | Sequence[float] = 0.0,
        fraction: float | Sequence[float] | None = None,
        depths: int | None = None,
        layering: str = "equivolume",
        projection: str | None = None,
        interpolation: str | None = None,
        period: float | None = None,
        nan_policy: str = "omit",
        time_step: float | None = None,
        name: str = "",
    ) -> FlatStack:
        """Show several depths, all maps in a file, or a series of volumes on the map.

        Images are sampled on demand. Except for rounding errors, each image equals the result of `image`.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            As in `image`.
        pixel_size : float, optional
            As in `raster`.
        channel : int or str, optional
            Number or name of the only channel to show, if there are several.
        depth, fraction : float or sequence of float
            As in `image`.
        depths : int, optional
            Number of layers between the white and the pial surface, each of which is sampled at its centre: layer k at
            the fraction (k + ½) / `depths`. The result is a flat volume.
        layering : {"equivolume", "equidistant"}
            As in `image`.
        projection : {"mean", "max", "sum"}, optional
            Show this projection of all depths of each channel, as in `image`, instead of one image per depth.
        interpolation : {"linear", "nearest", "majority"}, optional
            As in `image`.
        period : float, optional
            As in `image`.
        nan_policy : {"omit", "propagate"}
            As in `image`.
        time_step : float, optional
            Time between frames of a series, in seconds. By default, the time step stored in the file: NIfTI files have
            one if the header has a unit of time, ``.mgh`` and CIFTI series always have one, and GIFTI files and arrays
            never do.
        name : str, optional
            As in `image`.

        Returns
        -------
        FlatStack
            A sequence of `FlatImage`, indexed by number or name, with all depths of each channel. `FlatStack.data` is
            the array (depth, row, column), `FlatStack.times` holds the times of frames, and `FlatStack.save` writes all
            images.

        Raises
        ------
        InputError
            As in `image`.

        Examples
        --------
        >>> len(voxflat.samples.hill().flatten().images(np.ones((441, 4)), pixel_size=1.0))  # four frames
        4
        """
        default, where = self._default_interpolation, Depths.of(depth, fraction, layering, depths)
        sampling = Sampling(where, projection, interpolation, period, nan_policy, default)
        source = source_of(self._triangles.on_surface, volume)
        return source.stack(self.raster(pixel_size), sampling, channel=channel, name=name, time_step=time_step)


def _checked_vectors(vectors: ArrayLike, shape: tuple[int, ...], starts: str) -> NDArray[np.float64]:
    """Return vectors, one for each of the points or places where they start."""
    checked = numbers_of(vectors, "vectors")
    if checked.shape != shape:
        raise InputError(f"vectors has shape {checked.shape}, but {starts} has {shape}. Pass one vector for each")
    return checked
