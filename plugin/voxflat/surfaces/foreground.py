"""Select the foreground voxels of a volume: a label, or the values above a threshold."""

import hashlib
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress, is_whole, log, optional_number, poll, shown
from voxflat.errors import InputError
from voxflat.io.chunks import is_stack_path
from voxflat.io.files import naming
from voxflat.io.origin import VoxelOrigin
from voxflat.io.overlays import as_mask
from voxflat.io.sources import volume_of
from voxflat.io.spaces import UNKNOWN, Space
from voxflat.io.volumes import Volume

Labels = int | Sequence[int]  # a label, or several that form one foreground

_T = TypeVar("_T", bound=np.generic)

_SHOWN = 20  # maximum number of labels in a message
_MOST_LISTED = 100  # labels without gaps, as in intensities
_LEAST_SHARE = 0.2  # of the foreground, of a label that is an object of its own
_MOST_LABELS = 3000  # more distinct values are intensities
_WIDEST = 2**16  # largest range of whole numbers for bincount
_SLAB = 2**21  # voxels between two checks for cancellation


@dataclass(frozen=True, eq=False)
class Foreground:
    """A volume and its foreground."""

    volume: Volume
    mask: NDArray[np.bool_]
    origin: VoxelOrigin


@dataclass(frozen=True, eq=False)
class Repair:
    """Voxels that were changed to remove handles; arrays have shape (k, 3)."""

    handles: int
    considered: list[int]  # voxels changed if all handles were cut, or all were filled
    cut: NDArray[Any]  # removed
    filled: NDArray[Any]  # added
    dropped: NDArray[Any]  # of smaller components, removed
    cavities: NDArray[Any]  # enclosed, added

    def _described(self) -> dict[str, Any]:
        """Return the repair as metadata, ready for JSON."""
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}


@dataclass(frozen=True, eq=False)
class PackedMask:
    """The foreground of a volume with one bit per voxel (`numpy.packbits`), as stored in surfaces."""

    bits: NDArray[np.uint8]
    origin: VoxelOrigin
    touching: Sequence[int] = ()  # labels that touch

    def mask(self) -> NDArray[np.bool_]:
        """Return a mask of the foreground, shape (I, J, K)."""
        shape = self.origin.shape
        return np.asarray(np.unpackbits(self.bits, count=int(np.prod(shape))).reshape(shape).view(np.bool_))


def slabs(shape: Sequence[int], progress: Progress | None) -> Iterator[slice]:
    """Divide the first axis of a volume into slabs, and check for cancellation before each."""
    voxels = math.prod(shape[1:])
    thickness = max(1, _SLAB // max(1, voxels))
    for start in range(0, shape[0], thickness):
        poll_check(progress)
        yield slice(start, start + thickness)


def poll_check(progress: Progress | None) -> None:
    """Raise `Cancelled` if the user has cancelled."""
    poll(progress, "checking the foreground")


def in_c_order(data: NDArray[Any], dtype: type[_T], progress: Progress | None) -> NDArray[_T]:
    """Return values of a type in C order, as the core reads them; reordering takes long."""
    if data.flags.c_contiguous and data.dtype == dtype:
        return data
    ordered = np.empty(data.shape, dtype=dtype)
    for slab in slabs(data.shape, progress):
        ordered[slab] = data[slab]
    return ordered


def foreground_of(
    volume: Volume,
    *,
    label: Labels | None = None,
    threshold: float | None = None,
    unit: str | None = None,
    progress: Progress | None = None,
) -> Foreground:
    """Select the foreground of a volume."""
    threshold = optional_number(threshold, "threshold")
    mask = in_c_order(foreground(volume.data, label=label, threshold=threshold, progress=progress), np.bool_, progress)
    labels = None if label is None else [int(number) for number in _several(label)]
    is_anatomical = volume.is_placed and not is_stack_path(volume.path)  # microscopes do not know right and left
    i, j, k = volume.data.shape
    origin = VoxelOrigin(
        input=None if volume.path is None else str(volume.path),
        input_sha256=hashlib.sha256(np.packbits(mask).tobytes() + str(mask.shape).encode()).hexdigest(),
        shape=(i, j, k),
        affine=volume.affine,
        space=Space("scanner") if is_anatomical else UNKNOWN,
        unit=volume.unit if unit is None else unit,
        label=labels[0] if labels is not None and len(labels) == 1 else labels,
        threshold=threshold,
        foreground=int(np.count_nonzero(mask)),
    )
    return Foreground(volume, mask, origin)


def check_scalar(data: NDArray[Any]) -> None:
    """Raise an error unless there is one value per voxel."""
    if data.ndim != 3:
        raise InputError(f"the volume has shape {data.shape}, as for colours. Pass a volume with one value per voxel")
    if data.size == 0:
        raise InputError(f"the volume has shape {data.shape}, so it contains no voxels. Pass a volume with voxels")


def keep_mask(keep: object, volume: Volume, name: str = "mask to keep") -> NDArray[np.bool_]:
    """Return a mask of selected voxels, on the grid of a volume."""
    mask = volume_of(keep).in_unit(volume.unit)
    if mask.data.shape != volume.data.shape:
        raise InputError(
            f"the {name} has shape {mask.data.shape}, but the volume has {volume.data.shape}. Resample the mask"
        )
    if mask.is_placed and not np.allclose(mask.affine, volume.affine, atol=1e-3 * volume.spacing.min()):
        raise InputError(f"the affines of the {name} and the volume differ. Resample the mask")
    if np.isnan(mask.data).any():
        raise InputError(f"the {name} contains NaN. Set the selected voxels to 1 and others to 0")
    if not mask.data.any():
        raise InputError(f"the {name} is empty: every voxel is 0. Set the selected voxels to 1")
    with naming(f"the {name}", ""):
        return as_mask(mask.data)


def _several(label: Labels) -> list[int]:
    """Return one or several labels as a list without repetitions."""
    labels = [label] if is_whole(label) or not isinstance(label, Sequence | np.ndarray) else list(label)
    if not labels or isinstance(label, str | bytes) or not all(is_whole(number) for number in labels):
        raise InputError(f"the label is {shown(label)}. Pass a whole number or several, or a threshold for intensities")
    return list(dict.fromkeys(labels))


def foreground(
    data: NDArray[Any],
    *,
    label: Labels | None = None,
    threshold: float | None = None,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Select voxels that equal a label or exceed a threshold, or are not 0 if the volume is a mask with one label."""
    check_scalar(data)
    if label is not None and threshold is not None:
        raise InputError(f"both label={label} and threshold={threshold} are given. Pass only one of them")
    if data.dtype.kind == "f" and not np.isfinite(data).all():
        count = int(np.size(data) - np.isfinite(data).sum())
        voxels = "1 voxel is" if count == 1 else f"{count} voxels are"
        raise InputError(f"{voxels} NaN or infinite. Replace these values, for example with numpy.nan_to_num")
    poll_check(progress)
    if threshold is not None:
        return _above(data, threshold)
    labels = [_only_label(data, progress)] if label is None else _several(label)
    mask = _labelled(data, labels[0])
    for further in labels[1:]:
        poll_check(progress)
        mask |= _labelled(data, further)
    return mask


def labels_in(
    data: NDArray[Any], mask: NDArray[np.bool_] | None = None, progress: Progress | None = None
) -> dict[int, int] | None:
    """Return the number of voxels of each label other than 0; None if there are too many or fractional values.

    With a mask, the values outside it count as 0.
    """
    counts: Counter[int] = Counter()
    for slab in slabs(data.shape, progress):
        values = data[slab] if mask is None else np.where(mask[slab], data[slab], 0)
        if values.dtype.kind == "f" and not (np.isfinite(values).all() and (values == np.round(values)).all()):
            return None
        counts.update(_counted(values))
        if len(counts) > _MOST_LABELS:
            return None  # intensities stored as whole numbers
    return {label: counts[label] for label in sorted(counts) if label != 0}


def touching_labels(data: NDArray[Any], mask: NDArray[np.bool_], progress: Progress | None = None) -> list[int]:
    """Return the labels of a foreground, each at least a fifth of it, that share a face with another such label."""
    counts = labels_in(data, mask, progress) or {}
    large = [label for label, count in counts.items() if count >= _LEAST_SHARE * sum(counts.values())]
    if len(large) < 2:
        return []
    touching: set[int] = set()
    for slab in slabs(data.shape, progress):
        values = data[slab.start : slab.stop + 1]  # and the first layer of the next slab
        numbers = np.zeros(values.shape, dtype=np.uint8)
        for number, label in enumerate(large, 1):
            numbers[values == label] = number
        for axis in range(3):
            low, high = np.moveaxis(numbers, axis, 0)[:-1], np.moveaxis(numbers, axis, 0)[1:]
            is_between = (low != high) & (low > 0) & (high > 0)
            touching |= {*np.unique(low[is_between]).tolist(), *np.unique(high[is_between]).tolist()}
    return [large[number - 1] for number in sorted(touching)]


def _counted(values: NDArray[Any]) -> dict[int, int]:
    """Return the number of each whole number; much faster than numpy.unique if their range is small."""
    if values.dtype.kind == "b":
        values = values.view(np.uint8)
    low, high = values.min(), values.max()
    if int(high) - int(low) > _WIDEST:
        distinct, counts = np.unique(values, return_counts=True)
        return dict(zip(map(int, distinct[: _MOST_LABELS + 1]), counts.tolist(), strict=False))
    # differences of int8 do not fit into int8, and those of half precision are rounded
    wide = values.dtype if values.dtype.kind == "u" else np.result_type(values, np.int64)
    counts = np.bincount((values.ravel().astype(wide, copy=False) - low.astype(wide)).astype(np.int64))
    return {int(low) + number: int(counts[number]) for number in np.flatnonzero(counts).tolist()}


def _above(data: NDArray[Any], threshold: float) -> NDArray[np.bool_]:
    if not np.isfinite(threshold):
        raise InputError(f"the threshold is {threshold}. Pass a finite number")
    with np.errstate(over="ignore"):  # no value exceeds the range of half precision
        mask = np.asarray(data > threshold)
    if not mask.any():
        raise InputError(f"no voxel is above the threshold {threshold}; the largest value is {data.max()}")
    if 0 < threshold < 1 and data.dtype in (np.uint8, np.uint16):
        largest, most = int(data.max()), int(np.iinfo(data.dtype).max)
        if 4 * largest > 3 * most and ((data > 0) & (data < largest)).any():  # not a mask
            text = "values range up to %d, so threshold=%g selects all voxels except zeros. For probabilities, pass %g"
            log.warning(text, largest, threshold, threshold * most)
    return mask


def _labelled(data: NDArray[Any], label: int) -> NDArray[np.bool_]:
    try:
        with np.errstate(over="ignore"):
            mask = np.asarray(data == label)
    except OverflowError:  # not representable in the type of the values
        mask = np.zeros(data.shape, dtype=np.bool_)
    if not mask.any():
        raise InputError(f"no voxel has label {label}; {_present(data)}")
    return mask


def _only_label(data: NDArray[Any], progress: Progress | None) -> int:
    labels = labels_in(data, progress=progress)
    if data.dtype.kind == "f" and labels is None:
        raise InputError(f"the volume has intensities from {data.min():g} to {data.max():g}. Pass a threshold")
    if labels is None or len(labels) > 1:
        is_rim = labels is not None and set(labels) == {1, 2, 3}
        hint = ". For a rim (borders and grey matter), use voxflat.rim" if is_rim else ""
        raise InputError(f"pass a label or a threshold; {_present(data)}{hint}")
    if not labels:
        raise InputError("the volume is empty: every voxel is 0")
    return next(iter(labels))


def _present(data: NDArray[Any]) -> str:
    labels = labels_in(data)
    if labels is None:
        return f"the values range from {data.min():g} to {data.max():g}"
    if not labels:
        return "every voxel is 0"
    if len(labels) > _MOST_LISTED and len(labels) > (max(labels) - min(labels)) / 2:  # few numbers are left out
        return f"the values are {len(labels)} whole numbers from {min(labels)} to {max(labels)}, labels or intensities"
    names = ", ".join(str(label) for label in list(labels)[:_SHOWN])
    names += f" and {len(labels) - _SHOWN} more" if len(labels) > _SHOWN else ""
    of_freesurfer = "; in FreeSurfer's aseg and ribbon, label=2 is the left and label=41 the right white matter"
    return f"the volume has labels {names}" + (of_freesurfer if {2, 41} <= labels.keys() else "")
