"""Compute depth, thickness and columns of the grey matter between two borders."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, log
from voxflat.io.reading import check_room
from voxflat.laminar.banks import between_banks, crosses, keep_to_bank, neighbours_of
from voxflat.laminar.labels import GREY, INNER, OUTER, Layered, grown, loose, reached
from voxflat.maps.depth import smooth_areas, vertex_areas
from voxflat.surfaces.uncertainty import APART, LOOSE, PLACED, THICK, TOO_THICK

_A_VOXEL = 60
"""Bytes of memory per voxel of the box; measured: 40 to 55."""

_BEYOND = 3  # voxels beyond the labels
_CHUNK = 1 << 14  # rows that fit into the cache of a core
_FAR = np.inf  # mm, no limit
_EXTENT = 100  # area of the middle surface, relative to the squared thickness, that shows how gyri and sulci differ
_FIFTHS = (0.2, 0.8)  # ends of the shares of columns that widen least and most towards the outer border
_THINNER = 0.9  # thickness of gyri, relative to that of the bottoms of sulci, below which borders may be swapped
_REACH = 4  # voxels from the end of the labels to which fits of borders mix both sides
_PER_VOXEL = 30.0  # factor of the weight of areas per voxel, so that the farthest from the end count alone


@dataclass(frozen=True, eq=False)
class Field:
    """Store the depths of grey-matter voxels, and the middle surface with its corresponding points on both borders."""

    depth: NDArray[np.float64]  # (G,), equidistant: 0 at the inner, 1 at the outer border
    volume_depth: NDArray[np.float64]  # (G,), equivolume
    thickness: NDArray[np.float64]  # (G,), mm
    halfway: NDArray[np.float64]  # (G, 3), the point of the middle surface on the column of each voxel, in mm; or NaN
    columns: NDArray[np.float64]  # (G, 3), outward normals of the middle surface there
    points: NDArray[np.float64]  # (V, 3), middle surface, RAS+ mm
    faces: NDArray[np.uint32]  # (F, 3)
    inner: NDArray[np.float64]  # (V, 3), nearest points on the inner border
    outer: NDArray[np.float64]  # (V, 3)
    uncertain: NDArray[np.uint8]  # (G,), reasons why depths are uncertain, or 0
    uncertain_points: NDArray[np.uint8]  # (V,), those of most voxels around each point of the middle surface


def field_of(rim: Layered, threads: int | None = None, progress: Progress | None = None) -> Field:
    """Compute the field of a rim."""
    check_room(_A_VOXEL * rim.labels.size)
    steps = _Steps(threads, progress)
    affine = rim.affine.tolist()
    # Fits move borders a few hundredths of a voxel into their solids, both away from the grey matter.
    borders = [_Border.of(rim.extended == label, affine, threads, progress) for label in (INNER, OUTER)]
    # Beyond the labels, a few voxels of extended grey matter let the middle surface reach the end of the labels.
    near = reached(rim.labels == GREY, _BEYOND)
    band = np.argwhere((rim.extended == GREY) & near)
    places = rim.places(band)
    borders, is_placed, (depth, thickness, inner, outer) = _within_banks(rim, band, borders, steps)
    image = np.select([rim.extended == INNER, rim.extended == OUTER], [0.5, -0.5]).astype(np.float32)  # ½ - depth
    image[tuple(band.T)] = 0.5 - depth
    thin = np.argwhere(_crossed(image, rim.extended != GREY) & near)  # the middle surface passes beside these
    image[tuple(thin.T)] = 0.5 - _depth(rim.places(thin), borders, steps)[0].clip(-1, 2)
    middle = _surface_in(image > 0, affine, (image, 0.0), threads, progress)
    points, faces = middle.points, middle.faces
    found = [border.find(points, steps) for border in borders]
    feet = [nearest for _, nearest in found]
    for side, (label, label_of_side) in enumerate(((OUTER, inner), (INNER, outer))):
        beyond = crosses(rim, label, points, feet[side], np.abs(found[1 - side][0]), threads)
        if len(beyond):  # on the other bank; the nearest voxel stays on its own
            feet[side][beyond] = label_of_side[scipy.spatial.cKDTree(places).query(points[beyond])[1]]
    normals = middle.normals
    # Beyond the ends of the labels, the middle surface does not continue for long, and has other areas.
    kept, faces = _in_grey(rim, points, faces, feet[1] - feet[0])
    points, normals, feet = points[kept], normals[kept], [foot[kept] for foot in feet]
    is_grey = rim.labels[tuple(band.T)] == GREY
    depth, thickness = depth[is_grey].clip(0, 1), thickness[is_grey]
    surfaces = (feet[0], points, feet[1])
    areas = smooth_areas(surfaces, points, faces, float(np.median(thickness)), _known(rim, surfaces, faces))
    _warn_if_swapped(areas, np.linalg.norm(feet[1] - feet[0], axis=1), vertex_areas(points, faces))
    halves = _half_depth(places[is_grey], depth, inner[is_grey], outer[is_grey])
    triangles, weights, _ = _core.NearestFinder(points, faces).find(halves, _FAR)
    corners = faces[triangles]
    halfway = _interpolated(points, corners, weights)
    voxels, unknown = band[is_grey], np.zeros(is_grey.sum())
    lost = np.unique(
        np.concatenate([crosses(rim, label, places[is_grey], halfway, unknown, threads) for label in (INNER, OUTER)])
    )
    taken = neighbours_of(rim, voxels, halfway, lost)
    is_apart = taken < 0
    taken[is_apart] = np.flatnonzero(is_apart)
    if len(lost):
        halfway, corners, weights = halfway[taken], corners[taken], weights[taken]
    halfway[is_apart] = np.nan
    around = _interpolated(np.stack(areas, axis=1), corners, weights).T
    columns = _interpolated(normals, corners, weights)
    lengths = np.linalg.norm(columns, axis=1, keepdims=True)
    columns /= np.where(lengths > 0, lengths, np.nan)
    is_thick = thickness > TOO_THICK * np.median(thickness)
    reasons = ((LOOSE, loose(rim)), (PLACED, is_placed[is_grey]), (APART, is_apart), (THICK, is_thick))
    uncertain = sum((np.uint8(reason) * where for reason, where in reasons), np.zeros(len(depth), dtype=np.uint8))
    nearest = corners[np.arange(len(corners)), weights.argmax(axis=1)]
    most = np.maximum(np.bincount(nearest, minlength=len(points)), 1) / 2
    of_points = sum(
        np.uint8(reason) * (np.bincount(nearest[where & ~is_apart], minlength=len(points)) > most)
        for reason, where in reasons
    )
    volume_depth, (inner, outer) = _share_below(depth, *around), feet
    return Field(
        depth, volume_depth, thickness, halfway, columns, points, faces, inner, outer, uncertain, np.asarray(of_points)
    )


def _warn_if_swapped(
    areas: Sequence[NDArray[np.float64]], thickness: NDArray[np.float64], sizes: NDArray[np.float64]
) -> None:
    """Warn if the grey matter is thinner where it bends towards the inner border, as if the borders were swapped.

    Gyri are thicker than the bottoms of sulci. `areas` are those of columns on the surfaces, and `sizes` are those
    around the vertices of the middle surface.
    """
    usual = np.median(thickness)
    if sizes.sum() < _EXTENT * usual**2:
        return
    inner, _, outer = areas
    is_single = thickness < TOO_THICK * usual
    growth = (outer / np.maximum(inner, np.finfo(float).tiny))[is_single]
    low, high = np.quantile(growth, _FIFTHS)
    ratio = np.median(thickness[is_single][growth >= high]) / np.median(thickness[is_single][growth <= low])
    if ratio < _THINNER:
        log.warning(
            "the grey matter is %.0f %% thinner where it bends towards the inner border than where it bends towards "
            "the outer one, but gyri are usually thicker than the bottoms of sulci. The labels of the borders may be "
            "swapped: check which one is the white matter",
            100 * (1 - ratio),
        )


def _in_grey(
    rim: Layered, points: NDArray[np.float64], faces: NDArray[np.uint32], outwards: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
    """Return the vertices and the triangles of the part of the middle surface that lies in the grey matter."""
    step = 0.5 * rim.volume.spacing.min()
    outwards = outwards * (step / np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9))
    sides = (rim.voxels(points + side * outwards) for side in (-1, 0, 1))
    is_grey = np.any([rim.labels[tuple(voxels.T)] == GREY for voxels in sides], axis=0)
    faces = faces[is_grey[faces].any(axis=1)]
    kept, corners = np.unique(faces, return_inverse=True)
    return kept.astype(np.int64), corners.reshape(-1, 3).astype(np.uint32)


def _known(rim: Layered, surfaces: Sequence[NDArray[np.float64]], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Return the weight of the areas of triangles: low where a column is near the end of the labels, or beyond it.

    Labels continue straight there, and fits of borders mix both sides.
    """
    is_beyond = (rim.extended == GREY) & (rim.labels != GREY)
    if not is_beyond.any():
        return np.ones(len(faces))
    away = scipy.ndimage.distance_transform_edt(~is_beyond)  # in voxels
    columns = (away[tuple(rim.voxels(points[faces].mean(axis=1)).T)] for points in surfaces)
    return np.asarray(_PER_VOXEL ** np.minimum(np.min(list(columns), axis=0) - _REACH, 0))


def _depth(
    places: NDArray[np.float64], borders: Sequence["_Border"], steps: "_Steps"
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the equidistant depth of places, the thickness, and the nearest points on the inner and outer border."""
    (inwards, inner), (outwards, outer) = (border.find(places, steps) for border in borders)
    return _share(inwards, outwards), inwards + outwards, inner, outer


def _share(inwards: NDArray[np.float64], outwards: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the equidistant depth from the distances from the borders."""
    thickness = inwards + outwards
    return np.asarray(inwards / np.where(thickness > 0, thickness, 1.0))


def _crossed(image: NDArray[np.float32], where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the voxels that differ in sign from one of their 26 neighbours."""
    near_inner, near_outer = grown(image > 0), grown(image <= 0)
    return np.asarray(where & near_inner & near_outer)


def _within_banks(
    rim: Layered, band: NDArray[np.int64], borders: list["_Border"], steps: "_Steps"
) -> tuple[list["_Border"], NDArray[np.bool_], tuple[NDArray[np.float64], ...]]:
    """Return `_depth` of voxels of grey matter with columns that stay within their bank, and the borders for this.

    The second value says whose depth a border that was placed between touching banks has changed.
    """
    places = rim.places(band)
    (inwards, inner), (outwards, outer) = (border.find(places, steps) for border in borders)
    inner = keep_to_bank(rim, OUTER, band, inner, np.abs(outwards), steps.threads)
    sheet = between_banks(band, rim.labels.shape, places, inner, outwards)
    is_placed = np.zeros(len(band), dtype=np.bool_)
    if len(sheet[0]):
        borders = [borders[0], borders[1].joined(*sheet)]
        near = np.flatnonzero(_may_be_nearer(sheet[0], places, outwards, rim.volume.spacing))
        before = outwards[near]
        outwards[near], outer[near] = borders[1].find(places[near], steps)
        is_placed[near] = outwards[near] < before
    outer = keep_to_bank(rim, INNER, band, outer, np.abs(inwards), steps.threads)
    inwards, outwards = (
        np.copysign(np.linalg.norm(places - foot, axis=1), side) for foot, side in ((inner, inwards), (outer, outwards))
    )
    return borders, is_placed, (_share(inwards, outwards), inwards + outwards, inner, outer)


def _may_be_nearer(
    points: NDArray[np.float64], places: NDArray[np.float64], distances: NDArray[np.float64], spacing: NDArray[Any]
) -> NDArray[np.bool_]:
    """Return which places may be nearer to a surface with these points than a distance."""
    limits = distances + float(np.linalg.norm(spacing))  # no place of the surface is farther from a point
    nearest, _ = scipy.spatial.cKDTree(points).query(places, distance_upper_bound=float(limits.max()))
    return np.asarray(nearest < limits)


def _half_depth(
    places: NDArray[np.float64], depth: NDArray[np.float64], inner: NDArray[np.float64], outer: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Move places along the straight line to their farther foot until they are at half the depth.

    The nearest point on the middle surface then belongs to the same bank, even if the other bank is nearer.
    """
    is_outer = (depth > 0.5)[:, None]
    foot, share = np.where(is_outer, inner, outer), np.where(is_outer[:, 0], depth, 1 - depth)
    return foot + (places - foot) * (0.5 / share)[:, None]


def _surface_in(
    mask: NDArray[np.bool_], affine: Any, level: Any, threads: int | None, progress: Progress | None
) -> _core.Surface:
    """Return the surface of a mask, open where the box ends."""
    core, voxels, _ = _core.Surface.from_mask(mask, affine, level, False, threads, progress)
    is_end = ((voxels == 0) | (voxels == np.array(mask.shape) - 1)).any(axis=1)
    return core.part_of_faces(~is_end[core.faces].any(axis=1))


def _share_below(
    depth: NDArray[np.float64], inner: NDArray[np.float64], middle: NDArray[np.float64], outer: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share of a column's volume below a depth, from the areas at depths 0, ½ and 1.

    Between these, the area is a quadratic function of depth, as it is on parallel surfaces (Steiner's formula).
    """
    slope, bend = 4 * middle - 3 * inner - outer, 2 * inner - 4 * middle + 2 * outer
    below = depth * (inner + depth * (slope / 2 + depth * bend / 3))
    total = inner + slope / 2 + bend / 3
    return np.where(total > 0, below / np.where(total > 0, total, 1.0), depth).clip(0, 1)


@dataclass(frozen=True, eq=False)
class _Border:
    """Find the nearest points on a border."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.uint32]
    finder: _core.NearestFinder

    @classmethod
    def of(cls, mask: NDArray[np.bool_], affine: Any, threads: int | None, progress: Progress | None) -> "_Border":
        core = _surface_in(mask, affine, None, threads, progress)
        return cls(core.points, core.normals, core.faces, _core.NearestFinder(core.points, core.faces))

    def joined(self, points: NDArray[np.float64], faces: NDArray[np.uint32]) -> "_Border":
        """Return the border with a surface added, both sides of which are outside."""
        points, faces = np.concatenate([self.points, points]), np.concatenate([self.faces, faces + len(self.points)])
        normals = np.zeros_like(points)
        normals[: len(self.normals)] = self.normals
        return _Border(points, normals, faces.astype(np.uint32), _core.NearestFinder(points, faces.astype(np.uint32)))

    def find(self, places: NDArray[np.float64], steps: "_Steps") -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the distance of places from the border in mm, positive outside, and the nearest points."""
        nearest, distances = self.finder.sides(places, self.normals, self.faces, steps.threads, steps.progress)
        return distances, nearest


@dataclass(frozen=True)
class _Steps:
    """How to compute: the number of threads, and the callback that receives the progress and can cancel."""

    threads: int | None
    progress: Progress | None


def _interpolated(
    values: NDArray[np.float64], corners: NDArray[np.uint32], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return values at points of triangles, from those at their corners."""
    found = np.empty((len(corners), values.shape[1]))
    for start in range(0, len(corners), _CHUNK):
        part = slice(start, start + _CHUNK)
        found[part] = np.einsum("nk,nkd->nd", weights[part], values[corners[part]])
    return found
