"""Properties of regions on a map, measured as on the surface: areas, perimeters, positions and shapes."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import log
from voxflat.maps.missing import is_defined
from voxflat.maps.plane import Planar
from voxflat.maps.raster import Raster, nearest_inside
from voxflat.unique_rows import distinct

_Floats = NDArray[np.float64]
_BLUR = 0.8  # pixels; after this Gaussian blur, the total variation of a region is its perimeter within about 1 %
_REACH = 4  # pixels to which the blur reaches
_STEP = 0.5  # pixels between samples along the outline of the map
# 16 positions in a pixel, of which each sixteenth of its width and of its height has one (a rotated 4 x 4 grid); as
# squares with a side of 1/16, they have the second moments of the pixel
_SPLIT = (np.array([(4 * i + j, 4 * j + 3 - i) for i in range(4) for j in range(4)]) + 0.5) / 16 - 0.5

AREAS = ("area", "map_area")
LENGTHS = ("perimeter", "x", "y", "z", "u", "v", "major_axis", "minor_axis")


def properties_of(
    of: Planar,
    labels: NDArray[np.int64],
    raster: Raster,
    keys: Sequence[int],
    at: Callable[[_Floats], NDArray[np.int64]],
    curvature: _Floats | None,
    images: Iterable[tuple[str, _Floats]],
    *,
    are_outlines: bool,
    nan_policy: str,
) -> dict[str, _Floats]:
    """Return the properties of regions, one value for each key, as `Regions.properties` documents them.

    Pixels on the borders of outlines are divided, because whole pixels would move a border by up to half a pixel.
    """
    size, (left, top) = raster.pixel_size, raster.origin
    rows, columns = np.nonzero(raster.inside & scipy.ndimage.binary_dilation(labels != 0, iterations=_REACH))
    centres = np.column_stack([left + columns * size, top - rows * size])
    places = of.look_up(centres)
    metric, sorted_keys = of._metric, np.sort(keys)
    faces = np.full(raster.shape, -1, dtype=np.int64)
    faces[rows, columns] = places.face_ids
    owner, pixel, share = labels[rows, columns], np.arange(len(rows)), np.ones(len(rows))
    face, weights, points = places.face_ids, places.weights, places.points
    if are_outlines:
        is_split = _on_borders(labels)[rows, columns]
        split = np.repeat(pixel[is_split], len(_SPLIT))
        beside = centres[split] + np.tile(size * _SPLIT, (len(split) // len(_SPLIT), 1))
        finer = of.look_up(beside)
        is_on = finer.face_ids >= 0  # samples beside the map stand for the part of their pixel that is on it
        share = np.concatenate([share[~is_split], np.full(len(split), 1 / len(_SPLIT))])
        owner = np.concatenate([owner[~is_split], at(beside)])
        face = np.concatenate([face[~is_split], np.where(is_on, finer.face_ids, face[split])])
        weights = np.concatenate([weights[~is_split], np.where(is_on[:, None], finer.weights, weights[split])])
        points = np.concatenate([points[~is_split], np.where(is_on[:, None], finer.points, points[split])])
        pixel = np.concatenate([pixel[~is_split], split])
    side, share = size * share, size**2 * share
    area = share * np.where(face < 0, 0.0, np.nan_to_num(metric.area[face]))
    is_used = (owner != 0) & (area > 0)
    which, area_of, face = np.searchsorted(sorted_keys, owner[is_used]), area[is_used], face[is_used]

    def total(*values: _Floats) -> _Floats:
        return np.stack([np.bincount(which, area_of * each, len(keys)) for each in values], axis=-1)

    def totals(of_faces: _Floats, times: _Floats | float = 1.0) -> _Floats:
        values = of_faces.reshape(len(of_faces), -1).T
        return total(*(times * each[face] for each in values)).reshape(-1, *of_faces.shape[1:])

    def mean(values: _Floats) -> _Floats:
        is_known = np.isfinite(values)
        weights, sums = total(is_known.astype(np.float64), np.where(is_known, values, 0.0)).T
        there = is_defined(weights, weights + total(~is_known * 1.0)[:, 0], nan_policy)
        return np.asarray(np.divide(sums, weights, out=np.full(len(keys), np.nan), where=there))

    areas = total(np.ones(len(which)))[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        centres = total(*points[is_used].T) / areas[:, None]
        apart = (points[is_used] - centres[which]).T
        between = total(*(a * b for a in apart for b in apart)).reshape(-1, 3, 3)
        within = totals(metric.to_surface @ metric.to_surface.swapaxes(1, 2), side[is_used] ** 2 / 12)
        spread = (between + within) / areas[:, None, None]
        normals = totals(metric.normals)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    found = {"area": areas, "perimeter": _perimeters(of, labels, raster, sorted_keys, at, faces)}
    found |= {"map_area": np.bincount(which, share[is_used], minlength=len(keys)).astype(np.float64)}
    found |= dict(zip("xyz", centres.T, strict=True))
    found |= _shapes(of, centres, spread, normals)
    if curvature is not None:
        corners = of._triangles.faces[face]
        found["curvature"] = mean(np.einsum("pc,pc->p", weights[is_used], curvature[corners]))
    for name, values in images:
        of_pixels = values[rows, columns][pixel[is_used]]
        seen = np.unique(pixel[is_used])
        without = np.count_nonzero(~np.isfinite(values[rows, columns][seen]))
        if without:
            fate = "are left out" if nan_policy == "omit" else "make the mean of their region NaN"
            text = "%s: %s of %s pixels of the regions have no value, and %s"
            log.warning(text, name, f"{without:,}", f"{len(seen):,}", fate)
        found[name] = mean(of_pixels)
    order = np.searchsorted(sorted_keys, keys)
    return {"label": np.array(keys), **{name: values[order] for name, values in found.items()}}


def _on_borders(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the pixels with a neighbour, also along the diagonal, of another label."""
    around = {"size": 3, "mode": "nearest"}
    return np.asarray(scipy.ndimage.maximum_filter(labels, **around) != scipy.ndimage.minimum_filter(labels, **around))


def _shapes(flat: Planar, centres: _Floats, spread: _Floats, normals: _Floats) -> dict[str, _Floats]:
    """Return the axes of the ellipses with the same second moments in the tangent planes, and their directions."""
    face, weights, _ = flat._nearest(centres, np.inf)
    uv = np.einsum("pc,pcx->px", weights, flat._triangles.uv[flat._triangles.faces[face]])
    is_known = np.asarray(np.isfinite(spread).all(axis=(1, 2)) & np.isfinite(normals).all(axis=1))
    tangent = np.eye(3) - normals[:, :, None] * normals[:, None]
    values, vectors = np.linalg.eigh(np.where(is_known[:, None, None], tangent @ spread @ tangent, 0.0))
    major, minor = (4 * np.sqrt(np.where(is_known, np.maximum(values[:, n], 0.0), np.nan)) for n in (2, 1))
    along = np.where(is_known[:, None], vectors[:, :, 2], np.nan)
    u, v = np.einsum("pab,pb->ap", flat._metric.to_map[face], along)
    turned = np.asarray((u < 0) | ((u == 0) & (v < 0)))  # of its two directions, take the one to the right of the map
    along = np.where(turned[:, None], -along, along)
    angle = np.degrees(np.arctan2(np.where(turned, -v, v), np.where(turned, -u, u)))
    with np.errstate(invalid="ignore", divide="ignore"):
        shapes = {"major_axis": major, "minor_axis": minor, "elongation": major / minor}
    shapes |= {f"direction_{axis}": along[:, n] for n, axis in enumerate("xyz")}
    return {"u": uv[:, 0], "v": uv[:, 1], **shapes, "map_direction": angle}


def _perimeters(
    of: Planar,
    labels: NDArray[np.int64],
    raster: Raster,
    keys: NDArray[np.int64],
    at: Callable[[_Floats], NDArray[np.int64]],
    faces: NDArray[np.int64],
) -> _Floats:
    """Return the perimeters: inside the map by the total variation of each region, and along its outline."""
    lengths, metric, size = _along_outline(of, keys, at, raster.pixel_size), of._metric, raster.pixel_size
    away, (rows, columns) = nearest_inside(raster)
    ranked = np.where(labels == 0, 0, np.searchsorted(keys, labels) + 1)
    ranked = np.where(away <= _REACH, ranked[rows, columns], 0)  # so that the outline of the map is not a border
    ranked, faces = np.pad(ranked, _REACH, mode="edge"), np.pad(faces, _REACH, constant_values=-1)
    for n, box in enumerate(scipy.ndimage.find_objects(ranked, max_label=len(keys))):
        if box is None:
            continue
        window = tuple(slice(max(0, side.start - _REACH), side.stop + _REACH) for side in box)
        mask, here = (ranked[window] == n + 1).astype(np.float64), faces[window]
        down, right = (scipy.ndimage.gaussian_filter(mask, _BLUR, order) for order in ((1, 0), (0, 1)))
        slope = np.stack([right, -down], axis=-1)  # along u and v, per pixel
        seen = (here >= 0) & (slope != 0).any(axis=-1)
        squares = np.einsum("pa,pab,pb->p", slope[seen], metric.inverse[here[seen]], slope[seen])
        lengths[n] += size * np.nansum(np.sqrt(np.maximum(squares, 0)) * metric.area[here[seen]])
    return lengths


def _along_outline(
    flat: Planar, keys: NDArray[np.int64], at: Callable[[_Floats], NDArray[np.int64]], size: float
) -> _Floats:
    """Return the lengths of the outline of the map along which regions end; at a cut, they may continue beyond it."""
    triangles = flat._triangles
    faces = flat._whole_faces.astype(np.int64)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges = distinct(np.sort(ends, axis=1))
    ends = ends[edges.first[edges.counts == 1]]
    points = distinct(triangles.on_surface.points).which  # the two sides of a cut have the same positions
    ends = np.where((points[ends[:, :1]] > points[ends[:, 1:]]), ends[:, ::-1], ends)
    sides = distinct(points[ends])
    lengths = np.linalg.norm(np.subtract(*triangles.on_surface.points[ends].swapaxes(0, 1)), axis=1)
    spans = np.linalg.norm(np.subtract(*triangles.uv[ends].swapaxes(0, 1)), axis=1)
    counts = np.zeros(len(sides.rows), dtype=np.int64)
    np.maximum.at(counts, sides.which, np.maximum(1, np.ceil(spans / (_STEP * size)).astype(np.int64)))
    counts = counts[sides.which]
    edge = np.repeat(np.arange(len(ends)), counts)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = ((step + 0.5) / counts[edge])[:, None]
    seen = at((1 - share) * triangles.uv[ends[edge, 0]] + share * triangles.uv[ends[edge, 1]])
    place = distinct(np.column_stack([sides.which[edge], step, seen]))
    ended = place.counts == 1  # not continued by the same region on the other side
    chosen = place.first[ended & (place.rows[:, 2] != 0)]
    total = np.bincount(np.searchsorted(keys, seen[chosen]), (lengths / counts)[edge[chosen]], len(keys))
    return np.asarray(total, dtype=np.float64)
