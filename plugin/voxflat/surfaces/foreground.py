"""Select the foreground voxels of a volume: a label, or the values above a threshold."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import is_whole, log, optional_number, shown
from voxflat.errors import InputError
from voxflat.io.chunks import is_stack_path
from voxflat.io.files import naming
from voxflat.io.origin import VoxelOrigin
from voxflat.io.overlays import as_mask
from voxflat.io.sources import volume_of
from voxflat.io.spaces import UNKNOWN, Space
from voxflat.io.volumes import Volume

Labels = int | Sequence[int]  # a label, or several that form one foreground

_SHOWN = 20  # maximum number of labels in a message
_MOST_LISTED = 100  # labels without gaps, as in intensities
_LEAST_SHARE = 0.2  # of the foreground, of a label that is an object of its own
_WIDEST = 2**16  # largest range of integers for bincount


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


def foreground_of(
    volume: Volume, *, label: Labels | None = None, threshold: float | None = None, unit: str | None = None
) -> Foreground:
    """Select the foreground of a volume."""
    threshold = optional_number(threshold, "threshold")
    mask = foreground(volume.data, label=label, threshold=threshold)
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


def foreground(data: NDArray[Any], *, label: Labels | None = None, threshold: float | None = None) -> NDArray[np.bool_]:
    """Select voxels that equal a label or exceed a threshold, or are not 0 if the volume is a mask with one label."""
    check_scalar(data)
    if label is not None and threshold is not None:
        raise InputError(f"both label={label} and threshold={threshold} are given. Pass only one of them")
    if data.dtype.kind == "f" and not np.isfinite(data).all():
        count = int(np.size(data) - np.isfinite(data).sum())
        voxels = "1 voxel is" if count == 1 else f"{count} voxels are"
        raise InputError(f"{voxels} NaN or infinite. Replace these values, for example with numpy.nan_to_num")
    if threshold is not None:
        return _above(data, threshold)
    labels = [_only_label(data)] if label is None else _several(label)
    mask = _labelled(data, labels[0])
    for further in labels[1:]:
        mask |= _labelled(data, further)
    return mask


def labels_in(data: NDArray[Any]) -> dict[int, int] | None:
    """Return the number of voxels of each label other than 0; None if there are too many or fractional values."""
    if data.dtype.kind == "f":
        sample = data.ravel()[:: max(1, data.size // 10_000)]
        if not (np.isfinite(sample).all() and (sample == np.round(sample)).all()):
            return None
    values, counts = _counted(data)
    if data.dtype.kind == "f" and not (np.isfinite(values).all() and (values == np.round(values)).all()):
        return None
    if len(values) > 3000:
        return None  # intensities stored as integers
    return {int(value): int(count) for value, count in zip(values, counts, strict=True) if value != 0}


def touching_labels(data: NDArray[Any], mask: NDArray[np.bool_]) -> list[int]:
    """Return the labels of a foreground, each at least a fifth of it, that share a face with another such label."""
    counts = labels_in(np.where(mask, data, 0)) or {}
    large = [label for label, count in counts.items() if count >= _LEAST_SHARE * sum(counts.values())]
    if len(large) < 2:
        return []
    numbers = np.zeros(data.shape, dtype=np.uint8)
    for number, label in enumerate(large, 1):
        numbers[data == label] = number
    touching: set[int] = set()
    for axis in range(3):
        low, high = np.moveaxis(numbers, axis, 0)[:-1], np.moveaxis(numbers, axis, 0)[1:]
        is_between = (low != high) & (low > 0) & (high > 0)
        touching |= {*np.unique(low[is_between]).tolist(), *np.unique(high[is_between]).tolist()}
    return [large[number - 1] for number in sorted(touching)]


def _counted(data: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the distinct values and their counts; much faster than numpy.unique for few integers."""
    if data.dtype.kind == "b":
        data = data.view(np.uint8)
    low, high = data.min(), data.max()
    if data.dtype.kind not in "iu" or int(high) - int(low) > _WIDEST:
        values, counts = np.unique(data, return_counts=True)
        return values, counts.astype(np.int64)
    counts = np.zeros(int(high) - int(low) + 1, dtype=np.int64)
    wide = np.int64 if data.dtype.kind == "i" else data.dtype  # differences of int8 do not fit into int8
    for layer in data:  # one at a time, to keep the copies small
        above = layer.ravel().astype(wide, copy=False) - low.astype(wide)
        counts += np.bincount(above.astype(np.int64), minlength=len(counts))
    offsets = np.flatnonzero(counts)
    return np.array([int(low) + int(value) for value in offsets], dtype=object), counts[offsets]


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


def _only_label(data: NDArray[Any]) -> int:
    if data.dtype.kind == "f" and labels_in(data) is None:
        raise InputError(f"the volume has intensities from {data.min():g} to {data.max():g}. Pass a threshold")
    labels = labels_in(data)
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
