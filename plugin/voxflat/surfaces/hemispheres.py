"""Extract the white matter of one hemisphere from whole-brain white matter.

An affine transform aligns a template of the MNI152 white matter, divided into both hemispheres and the rest, with the
brain. Each voxel of white matter belongs to the nearest part of the template. Ventricles and deep nuclei inside the
hemisphere are filled, as in FreeSurfer's ``filled.mgz``, so that the surface has no holes.
"""

import hashlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, log, named_side, optional_number
from voxflat.errors import Cancelled, HemisphereError, InputError
from voxflat.io.grid import Affine, voxel_size
from voxflat.io.provenance import record_default, recording
from voxflat.io.sources import as_volume
from voxflat.io.volumes import Volume

_SIDES = ("left", "right")
_STEP = 2.0  # mm, voxel size for the alignment
_SMOOTH = (10.0, 5.0, 3.0)  # mm, from coarse to fine
_SURE_OVERLAP = 0.75  # overlap at which no further start is tried
_STARTS = (-25.0, 25.0)  # degrees about each axis, in addition to no rotation
_BETTER = 0.9  # share of the first start's error below which another start is followed to the end
_GAINED = 0.1  # largest gain in overlap from the finest step
_ITERATIONS = 40
_LEAST_OVERLAP, _MOST_STRETCHED = 0.5, 1.45  # least Dice, and largest ratio of stretches: a ball has 0.57 and 2.3
_NEAR = 0.1  # least membership of the inner parts where gaps are closed
_CLOSED = 2.0  # mm, gaps between white matter and the filled parts
_SOFT = 1.5  # mm, smoothing of the borders between parts
_ROOM = 24.0  # mm around the template, within which a brain has to lie
_SLAB = 1 << 22  # voxels at a time
_BINS = 256

_WHITE_SHARE = 0.05  # least share of white matter of each side among labelled voxels: 0.16 is usual

# FreeSurfer's aseg and SynthSeg: white matter, lateral ventricle, deep nuclei and the tissue between them
_ASEG = {"left": (2, 4, 10, 11, 12, 13, 26, 28, 30, 31, 78), "right": (41, 43, 49, 50, 51, 52, 58, 60, 62, 63, 79)}
_ASEG_BOTH = (77, 80, 251, 252, 253, 254, 255)  # hypointensities and corpus callosum belong to the side where they lie


@recording()
def hemisphere(
    source: object,
    side: str,
    *,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Volume:
    """Extract the white matter of one hemisphere from whole-brain white matter.

    The result has a closed surface. The cerebellum and the brain stem are excluded, and the ventricles and deep nuclei
    are filled. The brain may have any position and any orientation that its affine defines, plus a rotation of up to
    about 30 degrees.

    Parameters
    ----------
    source : ndarray, path, image object or Volume
        A mask or probability map of white matter, or a segmentation with the labels of FreeSurfer's aseg or SynthSeg.
    side : {"left", "right"}
        The hemisphere. "L", "R", "lh" and "rh" are also accepted, in upper or lower case.
    threshold : float, optional
        Values above this threshold are white matter. By default, Otsu's method determines it; masks do not need it.
    spacing, affine, progress : optional
        As in `voxflat.surface`.

    Returns
    -------
    Volume
        A uint8 mask on the grid of the source: 1 in the hemisphere, which is a single face-connected component.

    Raises
    ------
    HemisphereError
        If the volume does not look like whole-brain white matter. The message names the step that failed, and the
        error's ``figure()`` shows it.
    InputError, Cancelled
        If the input is not a 3-D volume, or `progress` returned False.

    See Also
    --------
    voxflat.surface : Create the surface of a volume.

    Examples
    --------
    >>> from voxflat.demo import demo_cortex
    >>> white_matter, _, _ = demo_cortex()
    >>> voxflat.hemisphere(white_matter, "left", threshold=0.5)
    <Volume: 197 x 233 x 189 of uint8, voxels of 1 x 1 x 1 mm, RAS>
    """
    side = named_side(side, "side")
    volume = as_volume(source, spacing=spacing, affine=affine)
    if volume.data.ndim != 3:
        raise InputError(f"a 3-D volume is required, but this one has {volume.data.ndim} axes. Select one volume")
    if not volume.is_placed:
        log.warning("the volume does not define left and right, so its first axis is assumed to point to the right")
    threshold = optional_number(threshold, "threshold")
    is_side = _of_labels(volume, side) if threshold is None else None
    if is_side is None:
        white = _white_matter(volume, threshold)
        is_side = _of_mask(white, volume, side, _Steps(side, progress))
    if not is_side.any():
        raise HemisphereError(
            f"the volume contains no white matter of the {side} hemisphere. Check that the hemisphere is not cropped",
            _white_matter(volume, threshold),
            volume.affine,
        )
    mask = np.zeros(is_side.shape, dtype=np.uint8)
    box = scipy.ndimage.find_objects(is_side.astype(np.uint8))[0]
    mask[box] = _one_piece(is_side[box])
    return Volume(mask, volume.affine, is_placed=volume.is_placed, unit=volume.unit)


def _one_piece(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest component of a mask, with its cavities filled."""
    filled = scipy.ndimage.binary_fill_holes(mask)
    components, _ = scipy.ndimage.label(filled)
    sizes = np.bincount(components.ravel())
    sizes[0] = 0
    return np.asarray(components == sizes.argmax())


def _white_matter(volume: Volume, threshold: float | None) -> NDArray[np.bool_]:
    """Return the mask of white matter above a threshold, by default Otsu's threshold."""
    data = volume.data
    if data.dtype == np.bool_:
        return np.asarray(data)
    if threshold is None:
        values = np.unique(data.ravel()[:: max(1, data.size // 100_000)])
        threshold = 0.5 * float(values.max()) if len(values) <= 2 else _otsu(data)
        if len(values) > 2:
            log.warning("white matter is defined as values above %.4g. Check this threshold, or set another", threshold)
        record_default(threshold=threshold)
    white = np.asarray(data > threshold)
    if not white.any():
        said = f"no voxel is above the threshold {threshold:g}; the largest value is {data.max():g}"
        raise HemisphereError(said, white, volume.affine)
    return white


def _otsu(data: NDArray[np.generic]) -> float:
    """Return the threshold that minimises the sum of the variances of both classes (Otsu 1979)."""
    values = data[np.isfinite(data)] if data.dtype.kind == "f" else data
    counts, edges = np.histogram(values, _BINS)
    middles = (edges[:-1] + edges[1:]) / 2
    below = np.cumsum(counts)[:-1]
    above = values.size - below
    sums = np.cumsum(counts * middles)
    with np.errstate(all="ignore"):
        between = below * above * (sums[:-1] / below - (sums[-1] - sums[:-1]) / above) ** 2
    return float(edges[1:-1][np.nanargmax(between)])


def _of_labels(volume: Volume, side: str) -> NDArray[np.bool_] | None:
    """Return a hemisphere of a segmentation with FreeSurfer's labels; None for other volumes."""
    data = volume.data
    if data.dtype == np.bool_ or (data.dtype.kind == "f" and not np.all(data == np.round(data))):
        return None
    labelled = max(1, int(np.count_nonzero(data)))
    if min(np.count_nonzero(data == white) for white in (2, 41)) < _WHITE_SHARE * labelled:  # a probability of 0 to 255
        return None
    of_side = np.isin(data, _ASEG[side])
    both = np.isin(data, _ASEG_BOTH)
    if both.any():
        mine, rest = (np.isin(data, _ASEG[name]) for name in (side, *(name for name in _SIDES if name != side)))
        of_side |= both & (scipy.ndimage.distance_transform_edt(~mine) <= scipy.ndimage.distance_transform_edt(~rest))
    return np.asarray(of_side)


# ------------------------------------------------------------------------------------------ template


@dataclass(frozen=True, eq=False)
class _Template:
    """The parts of the MNI152 template.

    `affine`: to RAS+ mm. `white` bool: white matter. `parts` (3, ...) float32: membership of the left hemisphere, the
    right one and the rest, from the nearest white matter. `deep` (2, ...) float32: membership of the inner parts.
    """

    affine: Affine
    white: NDArray[np.bool_]
    parts: NDArray[np.float32]
    deep: NDArray[np.float32]


@lru_cache(maxsize=1)
def _template() -> _Template:
    with np.load(Path(__file__).with_name("standard") / "hemispheres.npz") as arrays:
        affine, edge = arrays["affine"], round(_ROOM / _STEP)
        white, deep = (np.pad(arrays[name], edge) for name in ("white", "deep"))
    affine = affine @ np.vstack([np.column_stack([np.eye(3), [-edge] * 3]), [0, 0, 0, 1]])
    nearest = scipy.ndimage.distance_transform_edt(white == 0, return_distances=False, return_indices=True)
    part = white[tuple(nearest)]

    def soft(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
        return np.asarray(scipy.ndimage.gaussian_filter(mask.astype(np.float32), _SOFT / _STEP))

    parts, inner = ([soft(codes == n) for n in numbers] for codes, numbers in ((part, (1, 2, 3)), (deep, (1, 2))))
    return _Template(affine, white > 0, np.stack(parts), np.stack(inner))


def _of_mask(white: NDArray[np.bool_], volume: Volume, side: str, steps: "_Steps") -> NDArray[np.bool_]:
    """Return a hemisphere of a mask of white matter."""
    template, number = _template(), _SIDES.index(side)
    fitted, overlap = _fitted(*_coarse(white, volume.affine), steps)
    stretches = np.linalg.svd(fitted[:3, :3], compute_uv=False)
    if overlap < _LEAST_OVERLAP or stretches[0] > _MOST_STRETCHED * stretches[2]:
        raise HemisphereError(
            "the volume does not match the white matter of a whole brain (overlap with MNI152 after alignment: "
            f"{overlap:.2f} of 1). Check the threshold and the orientation, or pass a mask of one hemisphere",
            white,
            volume.affine,
            _there(white.shape, volume.affine, fitted),
        )
    log.info("aligned the brain to MNI152 (overlap %.2f)", overlap)
    back = np.linalg.inv(template.affine) @ np.linalg.inv(fitted) @ volume.affine
    mask, is_near = np.zeros(white.shape, dtype=np.bool_), np.zeros(white.shape, dtype=np.bool_)
    step = max(1, _SLAB // max(1, white[0].size))
    for first in range(0, len(white), step):
        slab = np.indices(white[first : first + step].shape).reshape(3, -1)
        slab[0] += first
        steps.tell("extracting the hemisphere")
        places = back[:3, :3] @ slab + back[:3, 3:]
        is_white = white[first : first + step].ravel()
        row = np.zeros(slab.shape[1], dtype=np.bool_)
        shares = [_at(part, places[:, is_white]) for part in template.parts]
        row[is_white] = np.argmax(shares, axis=0) == number
        inner = _at(template.deep[number], places)
        row |= inner > 0.5
        mask[first : first + step] = row.reshape(white[first : first + step].shape)
        is_near[first : first + step] = (inner > _NEAR).reshape(white[first : first + step].shape)
    radius = max(1, round(_CLOSED / voxel_size(volume.affine)))
    box = scipy.ndimage.find_objects(is_near.astype(np.uint8))
    for part in box:  # elsewhere it would join banks of sulci
        mask[part] |= is_near[part] & scipy.ndimage.binary_closing(mask[part], iterations=radius)
    return mask


def _there(shape: tuple[int, ...], affine: Affine, fitted: Affine) -> NDArray[np.bool_]:
    """Return the template's white matter on a grid."""
    template = _template()
    back = np.linalg.inv(template.affine) @ np.linalg.inv(fitted) @ affine
    white = template.white.astype(np.float32)
    there = scipy.ndimage.affine_transform(white, back[:3, :3], back[:3, 3], output_shape=shape, order=1)
    return np.asarray(there > 0.5)


def _at(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.asarray(scipy.ndimage.map_coordinates(values, places, order=1, mode="nearest"))


# ----------------------------------------------------------------------------------------- alignment


@dataclass(frozen=True)
class _Steps:
    """Report progress with an unknown number of steps, and stop if the user cancels."""

    side: str
    progress: Progress | None

    def tell(self, stage: str) -> None:
        if self.progress is not None and self.progress(f"{stage}, {self.side}", 0, 1) is False:
            raise Cancelled(f"cancelled while {stage}")


_last: dict[bytes, tuple[Affine, float]] = {}  # the last alignment, by its input: both hemispheres need the same one


def _fitted(coarse: NDArray[np.float32], grid: Affine, steps: _Steps) -> tuple[Affine, float]:
    """Return the affine transform from the template to a brain in large voxels, in RAS+ mm, and the overlap (Dice).

    It minimises the sum of squared differences of both masks by Gauss-Newton steps, with decreasing smoothing. Points
    outside the brain's volume are ignored.
    """
    key = hashlib.sha256(repr(coarse.shape).encode() + coarse.tobytes() + grid.tobytes()).digest()
    if (stored := _last.get(key)) is not None:
        return stored
    template = _template()
    pairs = [_Pair.of(coarse, grid, template, width) for width in _SMOOTH]
    start = _aligned_middles(coarse, grid, template)
    turned = [start @ _turned(axis, angle, template) for axis in range(3) for angle in _STARTS]
    best, overlap = start, 0.0
    for moved in itertools.chain((start,), _more_promising(start, turned, pairs[0], steps)):
        for pair in pairs[:-1]:
            moved, _ = pair.descend(moved, _ITERATIONS, steps)
        if _overlap(coarse, grid, template, moved) > _LEAST_OVERLAP - _GAINED:
            moved, _ = pairs[-1].descend(moved, _ITERATIONS, steps)
        trial = _overlap(coarse, grid, template, moved)
        if trial > overlap:
            best, overlap = moved, trial
        if overlap > _SURE_OVERLAP:
            break
    _last.clear()
    _last[key] = best, overlap
    return best, overlap


def _more_promising(start: Affine, others: list[Affine], pair: "_Pair", steps: _Steps) -> Iterator[Affine]:
    """Yield the transforms that fit better than the first one after a quick descent with strong smoothing."""
    (_, first), *further = (pair.descend(move, _ITERATIONS, steps) for move in (start, *others))
    better = sorted((fit for fit in further if fit[1] < _BETTER * first), key=lambda fit: fit[1])
    yield from (moved for moved, _ in better)


def _coarse(white: NDArray[np.bool_], affine: Affine) -> tuple[NDArray[np.float32], Affine]:
    """Return the fraction of each voxel of a coarser grid that a mask fills, and the affine of that grid."""
    factors = [max(1, round(_STEP / size)) for size in np.linalg.norm(affine[:3, :3], axis=0)]
    beyond = [(0, -length % factor) for length, factor in zip(white.shape, factors, strict=True)]
    padded = np.pad(white, beyond)
    blocks = [part for length, factor in zip(padded.shape, factors, strict=True) for part in (length // factor, factor)]
    shares = padded.reshape(blocks).mean(axis=(1, 3, 5), dtype=np.float32)
    scale = np.diag([*map(float, factors), 1.0])
    scale[:3, 3] = [(factor - 1) / 2 for factor in factors]
    return shares, affine @ scale


def _aligned_middles(coarse: NDArray[np.float32], grid: Affine, template: _Template) -> Affine:
    """Return the translation and scaling that align the centre and size of the template with a brain."""
    (middle, size), (centre, own_size) = _moments(coarse, grid), _moments(template.white, template.affine)
    scale = float(np.clip(size / own_size, 0.5, 1.6))
    move = np.diag([scale, scale, scale, 1.0])
    move[:3, 3] = middle - scale * centre
    return move


def _moments(mask: NDArray[Any], affine: Affine) -> tuple[NDArray[np.float64], float]:
    """Return the centre of a mask and the root mean square distance from it, in mm."""
    places = np.argwhere(mask > 0.5)
    if len(places) == 0:
        said = "the volume contains hardly any white matter. Check the threshold"
        raise HemisphereError(said, np.asarray(mask > 0.5), affine)
    points = places @ affine[:3, :3].T + affine[:3, 3]
    middle = points.mean(axis=0)
    return middle, float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean()))


def _turned(axis: int, angle: float, template: _Template) -> Affine:
    """Return a rotation about an axis through the template's centre."""
    middle, _ = _moments(template.white, template.affine)
    vector = np.zeros(3)
    vector[axis] = np.radians(angle)
    turn = np.eye(4)
    turn[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(vector).as_matrix()
    turn[:3, 3] = middle - turn[:3, :3] @ middle
    return turn


@dataclass(frozen=True, eq=False)
class _Pair:
    """A brain's values, the transform from RAS+ mm to voxels, and the smoothed template at `points` (N, 3)."""

    values: NDArray[np.float32]
    to_index: Affine
    points: NDArray[np.float64]
    wanted: NDArray[np.float64]

    @classmethod
    def of(cls, coarse: NDArray[np.float32], grid: Affine, template: _Template, width: float) -> "_Pair":
        sizes = np.linalg.norm(grid[:3, :3], axis=0)
        values = scipy.ndimage.gaussian_filter(coarse, width / sizes, mode="constant")
        blurred = scipy.ndimage.gaussian_filter(template.white.astype(np.float32), width / _STEP)
        every = max(1, round(0.5 * width / _STEP))
        thinned = np.zeros(blurred.shape, dtype=np.bool_)
        thinned[::every, ::every, ::every] = True
        indices = np.argwhere(thinned & (blurred > 0.01))
        points = indices @ template.affine[:3, :3].T + template.affine[:3, 3]
        return cls(values, np.asarray(np.linalg.inv(grid)), points, blurred[tuple(indices.T)].astype(np.float64))

    def descend(self, moved: Affine, iterations: int, steps: _Steps) -> tuple[Affine, float]:
        """Return an improved transform and its mean squared difference."""
        middle = self.points.mean(axis=0)
        design = np.column_stack([self.points - middle, np.ones(len(self.points))])
        damping, (error, residual, slope) = 1e-3, self._compared(moved)
        for _ in range(iterations):
            steps.tell("aligning the brain")
            jacobian = (slope[:, :, None] * design[:, None, :]).reshape(len(design), 12)
            normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -gradient).reshape(3, 4)
            change = np.zeros((4, 4))
            change[:3, :3], change[:3, 3] = step[:, :3], step[:, 3] - step[:, :3] @ middle
            there = self._compared(moved + change)
            if there[0] < error:
                is_done = error - there[0] < 1e-5 * error
                moved, (error, residual, slope), damping = moved + change, there, damping / 5
                if is_done:
                    break
            else:
                damping *= 10
                if damping > 1e4:
                    break
        return moved, error

    def _compared(self, moved: Affine) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Return the mean squared difference, the differences, and the gradient of the brain at the points, per mm."""
        to_index = self.to_index @ moved
        places = (self.points @ to_index[:3, :3].T + to_index[:3, 3]).T
        ends = np.array(self.values.shape)[:, None] - 1
        is_inside = ((places >= 0) & (places <= ends)).all(axis=0)
        values = np.asarray(_at(self.values, places), dtype=np.float64)
        halves = [0.5 * axis for axis in _AXES]
        along = np.stack([_at(self.values, places + e) - _at(self.values, places - e) for e in halves], axis=1)
        slope = np.where(is_inside[:, None], along @ self.to_index[:3, :3], 0.0)
        residual = np.where(is_inside, values - self.wanted, 0.0)
        share = is_inside.mean()
        error = float((residual**2).sum() / max(is_inside.sum(), 1)) + (1.0 if share < 0.3 else 0.0)
        return error, residual, slope


_AXES = np.eye(3)[:, :, None]


def _overlap(coarse: NDArray[np.float32], grid: Affine, template: _Template, moved: Affine) -> float:
    """Return the overlap of both masks (Dice) within the brain's volume."""
    indices = np.argwhere(np.ones(coarse.shape, dtype=np.bool_))
    back = np.linalg.inv(template.affine) @ np.linalg.inv(moved) @ grid
    places = (indices @ back[:3, :3].T + back[:3, 3]).T
    there = scipy.ndimage.map_coordinates(template.white.astype(np.float32), places, order=1) > 0.5
    here = coarse.ravel() > 0.5
    return float(2 * (here & there).sum() / max(here.sum() + there.sum(), 1))
