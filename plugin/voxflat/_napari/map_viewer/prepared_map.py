"""The map of a run, prepared for display with pixels, folds, a legend, and lookups between plane and space."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat._napari.map_viewer.pictures import Picture
from voxflat._napari.results.flat_layers import Run, unit_of_map
from voxflat._napari.results.session import Session, session_of
from voxflat.io.triangles import Points
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import rim
from voxflat.maps.plane import LIMIT, Planar

if TYPE_CHECKING:
    from voxflat.figures.marks import Direction

_IN_SLICE = 1.0  # mm

_PIXELS = 1e6  # in the bounding box of the map; about as many as in a large dock
_FINER = 4  # largest refinement of the run's pixels, for small maps
_EVEN = 168  # the grey level of a page, whose pieces have no folds
_ROUNDING = 1e-9  # tolerance for barycentric coordinates, so that a ray through an edge meets a triangle
_NEAR = 0.8  # largest distance of a point from a ray that meets it, as a fraction of the spacing


@dataclass(frozen=True, eq=False)
class Spot:
    """A location on the map, and the corresponding point of the surface."""

    point: NDArray[np.float64]  # (3,), RAS+ mm in scanner space
    row: int  # the index of the nearest map point
    vertex: int | tuple[int, ...]  # the nearest vertex or voxel of the input
    distortion: str  # a description of the distortion there; empty if unknown


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """The map of a run, prepared once outside the GUI thread, so that lookups are fast."""

    run: Run
    planar: Planar  # the run's map, or the page of its atlas
    pixel_size: float  # mm, finer than that of the run, so that pixels are not visible
    folds: Picture
    rim: list[NDArray[np.int64]]  # rows of points, in order
    directions: list[Direction]
    side: str | None  # L or R, if known
    points: NDArray[np.float64]  # (N, 3), RAS+ in scanner space
    frames: dict[int, PreparedMap] = field(default_factory=dict)  # of a movie
    frame: int | None = None

    @classmethod
    def of(cls, run: Run) -> PreparedMap:
        """Prepare the map of a run."""
        from voxflat.figures.flat_maps import folds
        from voxflat.figures.marks import directions, side

        flat_map = run.flat_map
        planar = flat_map if isinstance(flat_map, FlatMap) else flat_map.page()
        flat = planar._triangles
        pixel_size = max(float(np.sqrt(np.ptp(flat.uv, axis=0).prod() / _PIXELS)), planar.pixel_size / _FINER)
        raster = planar.raster(pixel_size)
        if isinstance(flat_map, FlatMap):
            grey, lines = folds(flat_map, raster), rim(flat.faces[~flat.torn], len(flat.uv))
        else:
            grey = np.zeros((*raster.shape, 4), dtype=np.uint8)
            grey[..., :3], grey[..., 3] = _EVEN, 255 * raster.inside
            corner = np.zeros(len(flat_map.uv), dtype=np.int64)  # one surface vertex for each vertex of the page
            corner[flat_map.uv_faces] = flat.faces
            lines = [corner[line] for line in rim(flat_map.uv_faces, len(flat_map.uv))]
        marks: tuple[list[Direction], str | None] = ([], None)
        if isinstance(flat_map, FlatMap) and unit_of_map(flat_map) == "mm":  # tissues have no anatomical axes
            marks = directions(flat_map), side(flat_map)
        points = flat.on_surface.origin.space.to_scanner(flat.on_surface.points)
        prepared = cls(run, planar, pixel_size, Picture(grey, raster.origin, pixel_size), lines, *marks, points)
        prepared._build()
        return prepared

    def at(self, frame: int | None) -> PreparedMap:
        """Return the map with the positions of a frame of a movie."""
        movie = self.run.layers.movie
        if movie is None or frame is None:
            return self
        if frame not in self.frames:
            planar = movie.series[frame]
            points = planar.space.to_scanner(planar.points)
            self.frames[frame] = replace(self, planar=planar, points=points, frame=frame)
            self.frames[frame]._build()
        return self.frames[frame]

    def _build(self) -> None:
        """Build the search trees, which the first lookups need."""
        self.spot(*self.planar._triangles.uv[0])
        self.place(self.points[0])
        self.met(self.points[0], np.ones(3))

    @property
    def session(self) -> Session:
        """The name of the flattened layer, the world axes and the unit."""
        return session_of(self.run.flat_map)

    @property
    def outline(self) -> list[NDArray[np.float64]]:
        """The border of the map, in mm, as lines of shape (k, 2)."""
        return [self.planar._triangles.uv[line] for line in self.rim]

    def spot(self, u: float, v: float) -> Spot | None:
        """Look up (u, v), in mm, on the surface; return None outside the map."""
        hit = self.planar.look_up((u, v))
        face = int(hit.face_ids)
        if face < 0:
            return None
        flat = self.planar._triangles
        row = int(flat.faces[face][int(hit.weights.argmax())])
        point = flat.on_surface.origin.space.to_scanner(hit.points)
        vertex = (flat.on_surface.ids[row] if self.planar is self.own else self._voxel(point)).tolist()
        return Spot(point, row, tuple(vertex) if isinstance(vertex, list) else vertex, self._distortion(row, face))

    @property
    def own(self) -> Planar:
        """The map of the run, which is that of the reference frame of a movie, or the page of its atlas."""
        return self.run.flat_map if isinstance(self.run.flat_map, FlatMap) else self.planar

    def _voxel(self, point: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the voxel that contains a point, or the nearest one, in another frame than the flattened one."""
        whole = self.planar._triangles.on_surface
        index = np.linalg.solve(whole.affine, [*point, 1.0])[:3]
        return np.clip(np.round(index), 0, np.subtract(whole.volume_shape, 1)).astype(np.int64)

    def _distortion(self, row: int, face: int) -> str:
        flat_map = self.run.flat_map
        if isinstance(flat_map, FlatMap):
            error = float(self.planar.distortion.per_point[row]) if isinstance(self.planar, FlatMap) else np.nan
            return "" if np.isnan(error) else f"distance error {100 * error:.1f} %"
        most, least = flat_map.stretch[face].tolist()
        return f"length change up to {100 * (max(most, 1 / least if least else np.inf) - 1):.1f} %"

    def place(self, point: NDArray[Any]) -> tuple[float, float] | None:
        """Look up a point in RAS+ mm on the map; return None if it is farther than `far` from the surface."""
        u, v = self.places(np.asarray(point)).tolist()
        return None if np.isnan(u) else (u, v)

    def places(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Return (u, v) of the surface points nearest to points (RAS+ mm), shape (..., 3); NaN beyond `far`."""
        rows = self.planar._triangles.on_surface.origin.space.from_scanner(points)
        return self.planar._to_map(rows.reshape(-1, 3), self.far)[0].reshape(*rows.shape[:-1], 2)

    def met(self, start: NDArray[Any], along: NDArray[Any]) -> NDArray[np.float64] | None:
        """Return the first intersection of the surface with a ray, given by a point and a direction in RAS+ mm."""
        along = np.asarray(along, dtype=np.float64) / np.linalg.norm(along)
        beside = np.zeros(len(self.points))  # squared; axis by axis is faster than a matrix product
        for across in np.linalg.svd(along[None])[2][1:]:
            x, y, z = (places * share for places, share in zip(self._axes, across.tolist(), strict=True))
            beside += (x + y + z - across @ start) ** 2
        if self.planar._triangles.torn.any():  # there may be no surface between the points, so find a nearby point
            return self._met_point(start, along, beside)
        close = beside <= self._longest_edge**2  # all corners of an intersected triangle are close
        first, second, third = self._corners
        near = np.flatnonzero(close[first])
        near = near[close[second[near]] & close[third[near]]]
        a, b, c = (self.points[corner[near]] for corner in self._corners)
        hit = _distances_along(start, along, a, b - a, c - a)
        nearest = float(np.min(hit, initial=np.inf))
        return start + nearest * along if np.isfinite(nearest) else None

    def _met_point(
        self, start: NDArray[Any], along: NDArray[np.float64], beside: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the first point near a ray; `beside` holds the squared distances of the points from the ray."""
        reach = _NEAR * self.spacing
        hits = np.flatnonzero(beside <= reach**2)
        if not len(hits):
            return None
        far = (self.points[hits] - start) @ along
        first = far <= far.min() + 2 * reach
        nearest = beside[hits[first]].argmin()
        return np.asarray(start + far[first][nearest] * along)

    @cached_property
    def _axes(self) -> NDArray[np.float64]:
        return np.ascontiguousarray(self.points.T)  # (3, N)

    @cached_property
    def _corners(self) -> NDArray[np.int64]:
        """The corners of the triangles, with shape (3, F), so that each row is contiguous in memory."""
        return np.ascontiguousarray(self.planar._triangles.faces.T, dtype=np.int64)

    @cached_property
    def _longest_edge(self) -> float:
        corners = self.points[self.planar._triangles.faces]
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())

    def colours(self, picture: Picture | None, opacity: float) -> NDArray[np.uint8]:
        """Return the colour of each map point, with shape (N, 4), with a picture drawn over the folds."""
        rows, columns = self._pixels
        under = self.folds.pixels[rows, columns].astype(np.float64)
        if picture is not None:
            over = picture.pixels[rows, columns]
            share = opacity * over[:, 3:] / 255
            under[:, :3] = share * over[:, :3] + (1 - share) * under[:, :3]
        return np.round(under).astype(np.uint8)

    @cached_property
    def _pixels(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The pixel of each map point; a point on the border gets the nearest pixel within the map."""
        (u, v), uv = self.folds.origin, self.planar._triangles.uv
        size = np.array(self.folds.pixels.shape[:2]) - 1
        cells = np.round(np.column_stack([v - uv[:, 1], uv[:, 0] - u]) / self.pixel_size).astype(np.int64)
        rows, columns = np.clip(cells, 0, size).T
        beside = self.folds.pixels[..., 3] == 0
        nearest = scipy.ndimage.distance_transform_edt(beside, return_distances=False, return_indices=True)
        return nearest[0][rows, columns], nearest[1][rows, columns]

    @property
    def unit(self) -> str:
        return unit_of_map(self.run.flat_map)

    @property
    def far(self) -> float:
        """The distance beyond which points are not on the map: more than the thickness of the cortex, or of cells."""
        return LIMIT if self.unit == "mm" else 5 * self.spacing

    @property
    def thickness(self) -> float:
        """The distance within which locations count as part of the displayed slice."""
        return _IN_SLICE if self.unit == "mm" else self.spacing

    @property
    def spacing(self) -> float:
        """The spacing of the surface points."""
        flat_map = self.run.flat_map
        return flat_map.spacing if isinstance(flat_map, FlatMap) else 2 * self.planar.pixel_size


def _distances_along(start: Points, along: Points, corner: Points, b: Points, c: Points) -> NDArray[np.float64]:
    """Return the distances along a ray to triangles, or infinity without an intersection (Möller and Trumbore, 1997).

    The corners are ``corner``, ``corner + b`` and ``corner + c``, with shape (F, 3). Intersections behind the start are
    included, because rays in the viewer start in the plane of the mouse position.
    """
    across = np.cross(along, c)
    volume = np.einsum("ij,ij->i", b, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_start = start - corner
        u = np.einsum("ij,ij->i", to_start, across) / volume
        turned = np.cross(to_start, b)
        v = turned @ along / volume
        far = np.einsum("ij,ij->i", turned, c) / volume
        inside = (u >= -_ROUNDING) & (v >= -_ROUNDING) & (u + v <= 1 + _ROUNDING)
    return np.where(inside & np.isfinite(far), far, np.inf)
