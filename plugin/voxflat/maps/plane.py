"""What a map and the page of an atlas share: pixels, what they show, and the way back to the surface."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import checked_number, log, numbers_of, shown
from voxflat.errors import InputError
from voxflat.io.provenance import Record, telling
from voxflat.maps.depth import Depths
from voxflat.maps.raster import FlatImage, FlatStack, Raster, draw
from voxflat.maps.sampler import Sampler

LIMIT = 5.0  # how far from the surface points may lie that are shown on the map, mm: cortex is up to 4.5 mm thick


@dataclass(frozen=True, eq=False)
class Places:
    """Places in the plane, looked up on the surface.

    Parameters
    ----------
    face_ids : ndarray of int64, shape (...)
        The triangle that lies there, a row of `faces`; −1 for none.
    weights : ndarray of float64, shape (..., 3)
        Barycentric coordinates there, by the triangle's corners; NaN for none.
    points : ndarray of float64, shape (..., 3)
        The place on the surface, RAS+ mm in its `space`; NaN for none.
    piece_ids : ndarray of int64, shape (...)
        The piece of an atlas; 0 on a map, which has one; −1 for none.

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
        found = int(np.count_nonzero(self.face_ids >= 0))
        return f"<Places: {found} of {self.face_ids.size} on a triangle>"


@dataclass(frozen=True, eq=False)
class FlatTriangles:
    """Triangles in the plane, and what they are on the surface.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        Places in the plane, mm.
    faces : ndarray of uint32, shape (F, 3)
        Triangles of them.
    torn : ndarray of bool, shape (F,)
        Triangles between whose corners there is no surface: they show the nearest corner.
    on_surface : Sampler
        The same N points on the surface.
    piece_ids : ndarray of int64, shape (F,), or None
        The piece of each triangle, where there are several.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> len(flat_map.faces)
    800
    """

    uv: NDArray[np.float64]
    faces: NDArray[np.uint32]
    torn: NDArray[np.bool_]
    on_surface: Sampler
    piece_ids: NDArray[np.int64] | None = None


class Planar(ABC):
    """What lies flat: triangles in the plane, each of which is known on the surface."""

    @property
    @abstractmethod
    def _triangles(self) -> FlatTriangles:
        """All that is drawn and looked up."""

    @property
    @abstractmethod
    def pixel_size(self) -> float:
        """Side of a pixel unless another is given, mm."""

    @cached_property
    def _rasters(self) -> dict[float, Raster]:
        return {}

    @cached_property
    def _finder(self) -> _core.TriangleFinder:
        of = self._triangles
        return _core.TriangleFinder(np.ascontiguousarray(of.uv[of.faces], dtype=np.float64))

    def raster(self, pixel_size: float | None = None) -> Raster:
        """Return the pixels, with the inverse look-up to the surface.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default `pixel_size`.

        Returns
        -------
        Raster
            Its corners are points of a map; on a page corner 3 t + k is corner k of triangle t.

        Raises
        ------
        InputError
            If the pixel size is not positive, or so small that the image would be too large.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.raster(pixel_size=1.0).shape
        (43, 43)
        """
        size = self.pixel_size if pixel_size is None else checked_number(pixel_size, "pixel size")
        if size not in self._rasters:
            of = self._triangles
            drawn = draw(of.uv, of.faces, of.torn, size)
            self._rasters[size] = replace(drawn, unit=of.on_surface.metadata.get("unit", "mm"))
        return self._rasters[size]

    def locate(self, pixel_size: float | None = None) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Look up which place on the surface each pixel shows.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        ids : ndarray of int64, shape (H, W, 3) or (H, W)
            The nearest surface voxel or vertex; −1 where nothing is shown.
        points : ndarray of float64, shape (H, W, 3)
            RAS+ mm in the surface's `space`, linear between its vertices; NaN where nothing is shown.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> ids, points = flat_map.locate(pixel_size=1.0)
        >>> ids.shape, points.shape
        ((43, 43), (43, 43, 3))
        """
        return self._triangles.on_surface.locate(self.raster(pixel_size))

    def look_up(self, places: ArrayLike) -> Places:
        """Look up places: which triangle and piece lies there, where in it, and where that is in space.

        Parameters
        ----------
        places : array_like, shape (..., 2)
            (u, v), mm.

        Returns
        -------
        Places
            −1 and NaN for what lies beside all triangles. In a torn triangle, between whose corners there is no
            surface, the nearest corner is taken; where triangles overlap, the first.

        Raises
        ------
        InputError
            If the places have another shape.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> places = flat_map.look_up([[0.0, 0.0], [500.0, 0.0]])
        >>> places.face_ids[1]  # outside the map
        np.int64(-1)
        """
        wanted = numbers_of(places, "places")
        if wanted.ndim == 0 or wanted.shape[-1] != 2:
            raise InputError(f"places has shape {wanted.shape}. Pass (u, v) in mm, shape (..., 2).")
        of, rows, shape = self._triangles, wanted.reshape(-1, 2), wanted.shape[:-1]
        triangles, weights = self._finder.find(np.ascontiguousarray(rows))
        if (at := (triangles >= 0) & of.torn[triangles]).any():
            apart = np.linalg.norm(of.uv[of.faces[triangles[at]]] - rows[at, None], axis=2)
            weights[at] = np.eye(3)[apart.argmin(axis=1)]
        found = np.einsum("pc,pcx->px", weights, of.on_surface.points[of.faces[triangles]])  # NaN where there is none
        pieces = np.where(triangles < 0, -1, 0 if of.piece_ids is None else of.piece_ids[triangles])
        return Places(
            triangles.reshape(shape), weights.reshape(*shape, 3), found.reshape(*shape, 3), pieces.reshape(shape)
        )

    @cached_property
    def _nearest_finder(self) -> _core.NearestFinder:
        points = np.ascontiguousarray(self._triangles.on_surface.points, dtype=np.float64)
        return _core.NearestFinder(points, np.ascontiguousarray(self._whole_faces, dtype=np.uint32))

    @cached_property
    def _whole_faces(self) -> NDArray[np.uint32]:
        """The triangles that are not torn."""
        of = self._triangles
        return of.faces[~of.torn] if of.torn.any() else of.faces

    def points_to_map(
        self, points: ArrayLike, limit: float = LIMIT, *, space: str = "surface"
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Find where points in space lie on the map: each at the place of the surface that is nearest to it.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            RAS+ mm.
        limit : float
            How far from the surface a point may lie, mm; 5 by default, more than the cortex is thick. The surface is
            that of the map's `points`: with ``pial=`` the one midway.
        space : {"surface", "scanner"}
            Where the points lie: in the surface's own `space`, as `locate` gives them, or in scanner RAS, as volumes.

        Returns
        -------
        uv : ndarray of float64, shape (..., 2)
            Places on the map, mm; NaN beyond the limit. On a cut, either of its sides.
        distance : ndarray of float64, shape (...)
            From each point to the surface, exact over its triangles, mm; NaN beyond the limit.

        Raises
        ------
        InputError
            If the points have another shape, or the limit or the space is none.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> uv, far = flat_map.points_to_map([[0.0, 0.0, 10.0]])
        >>> uv.shape, far.round(1)
        ((1, 2), array([0.]))
        """
        wanted = numbers_of(points, "points")
        if wanted.ndim == 0 or wanted.shape[-1] != 3:
            raise InputError(f"points has shape {wanted.shape}. Pass RAS+ mm, shape (..., 3).")
        limit = checked_number(limit, "limit")
        if not limit >= 0:
            raise InputError(f"limit is {limit} mm. Pass 0 or a positive number.")
        if not isinstance(space, str) or space not in ("surface", "scanner"):
            raise InputError(f"space is {shown(space)}. Pass 'surface' or 'scanner'.")
        of = self._triangles
        if space == "scanner":
            if of.on_surface.space.doubt:
                log.warning("Points may lie beside the surface: %s.", of.on_surface.space.doubt)
            wanted = of.on_surface.space.from_scanner(wanted)
        triangles, weights, distance = self._nearest_finder.find(np.ascontiguousarray(wanted.reshape(-1, 3)), limit)
        uv = np.einsum("pc,pcx->px", weights, of.uv[self._whole_faces[triangles]])  # NaN where there is none
        return uv.reshape(*wanted.shape[:-1], 2), distance.reshape(wanted.shape[:-1])

    @property
    @abstractmethod
    def provenance(self) -> Record:
        """What made it."""

    @telling()
    def image(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        channel: int | str | None = None,
        depth: float | Sequence[float] = 0.0,
        fraction: float | Sequence[float] | None = None,
        layering: str = "equivolume",
        interpolation: str | None = None,
        period: float | None = None,
        name: str = "",
    ) -> FlatImage:
        """Sample a volume onto the plane.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            Scalars or labels (I, J, K), or uint8 colours (I, J, K, 3 or 4). It may have another grid than the flattened
            volume: its affine says where it lies, in scanner RAS. A bare array must have the flattened volume's shape,
            and lies where that lies. A dask or zarr array, or a path of OME-Zarr, may be larger than memory: each chunk
            that the surface meets is read once. For meshes also an overlay: values at the mesh's vertices, an array of
            shape (V,) or a file (GIFTI, CIFTI, FreeSurfer curv, annot or .mgh, also NIfTI of shape (V, 1, 1)); uint8
            colours there, shape (V, 3) or (V, 4); or the texture that the surface has of its own, as .obj, .vtp or .ply
            (Zigelman et al. 2002, figure 3). One of several: maps of such a file, an array of shape (V, K), a series of
            volumes.
        pixel_size : float, optional
            As in `raster`.
        channel : int or str, optional
            Which one, where there are several: its number, from 0, or its name. `images` gives all of them.
        depth : float or sequence of float
            How far outside the surface to sample, mm; negative is inside. 2 mm outside white matter lies grey matter.
            Of several depths the mean is shown (`images` gives each).
        fraction : float or sequence of float, optional
            Instead, where the map was made of a white surface with ``pial=``: how much of the cortex lies below, from
            0, the white surface, to 1, the pial one. Of several the mean.
        layering : {"equivolume", "equidistant"}
            What a fraction is of: the volume of the cortex there (Waehnert et al. 2014), which layers follow through
            gyri and sulci, or the way from white to pial.
        interpolation : {"linear", "nearest", "majority"}, optional
            By default "nearest" for bool and integer volumes, which may be labels, and "linear" for floating-point
            volumes and colours. "majority" is of labels: that which has the greatest weight among the voxels around (of
            an overlay the triangle's corners), over all depths; its borders are smoother than voxels.
        period : float, optional
            Values are phases with this period, such as 360: means between them go the short way round, and lie from 0
            to the period. They are "linear" by default.
        name : str, optional
            What the image shows.

        Returns
        -------
        FlatImage
            NaN (colours: alpha 0) where there is no triangle, and where the volume has no value; of a mean, where it
            has none at one of the depths.

        Raises
        ------
        InputError
            If the volume does not fit or cannot be read, or there are several and none is chosen; if a mean of labels
            is asked for, or fractions where no pial surface is known.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.image(flat_map.points[:, 2], pixel_size=1.0)  # heights, a value a vertex
        <FlatImage: overlay, 43 x 43 pixels of 1>
        """
        depths = Depths.of(depth, fraction, layering)
        how: dict[str, Any] = {"depths": depths, "interpolation": interpolation, "period": period, "name": name}
        return self._triangles.on_surface.image(self.raster(pixel_size), volume, channel=channel, **how)

    @telling()
    def images(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        channel: int | str | None = None,
        depth: float | Sequence[float] = 0.0,
        fraction: float | Sequence[float] | None = None,
        layering: str = "equivolume",
        average: bool = False,
        interpolation: str | None = None,
        period: float | None = None,
        time_step: float | None = None,
        name: str = "",
    ) -> FlatStack:
        """Sample a volume at several depths, all maps of a file, or a series of volumes: each when it is asked for.

        Parameters
        ----------
        volume, pixel_size, depth, fraction, layering, interpolation, period, name
            As in `image`.
        channel : int or str, optional
            Only this one, where there are several.
        average : bool
            Show of several depths the mean, channel by channel.
        time_step : float, optional
            From each frame of a series to the next, s; by default what the file says: NIfTI where its header has a unit
            of time, ``.mgh`` and CIFTI series always, GIFTI and arrays never.

        Returns
        -------
        FlatStack
            A sequence of `FlatImage`, by number or name: of each channel all depths. `FlatStack.data` is the array
            (depth, row, column), `FlatStack.times` when the frames of a series were; `FlatStack.save` writes them.
            Where there are several volumes or maps an image is, to the rounding of sums, what `image` makes of one.

        Raises
        ------
        InputError
            As `image`.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> len(flat_map.images(np.ones((441, 4)), pixel_size=1.0))  # four frames
        4
        """
        depths = Depths.of(depth, fraction, layering)
        how: dict[str, Any] = {"depths": depths, "average": average, "interpolation": interpolation, "name": name}
        how |= {"period": period, "time_step": time_step}
        return self._triangles.on_surface.images(self.raster(pixel_size), volume, channel=channel, **how)
