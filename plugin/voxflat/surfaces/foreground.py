"""Which voxels of a volume are foreground: a label, or what lies above a threshold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError

_SHOWN = 20  # labels named in a message
_WIDEST = 2**16  # range of integers that are counted one by one


def foreground(data: NDArray[Any], *, label: int | None = None, threshold: float | None = None) -> NDArray[np.bool_]:
    """Select the foreground of a volume.

    Parameters
    ----------
    data : ndarray, shape (I, J, K)
        Labels (bool or integer) or intensities (any real type).
    label : int, optional
        Foreground is where `data` equals this.
    threshold : float, optional
        Foreground is where `data` is greater than this. Without label and threshold, `data` must be a mask: bool, or
        integer with one label other than 0.

    Returns
    -------
    ndarray of bool, shape (I, J, K)

    Raises
    ------
    InputError
        If the choice is ambiguous or empty, or values are not finite; the message lists the labels that are there.
    """
    if data.ndim != 3:
        raise InputError(f"the volume has shape {data.shape}; labels and intensities need one value a voxel (I, J, K)")
    if data.size == 0:
        raise InputError(f"the volume has shape {data.shape}: it holds no voxel")
    if label is not None and threshold is not None:
        raise InputError(f"both label={label} and threshold={threshold} are given; give one of them")
    if data.dtype.kind == "f" and not np.isfinite(data).all():
        count = int(np.size(data) - np.isfinite(data).sum())
        voxels = "1 voxel is" if count == 1 else f"{count} voxels are"
        raise InputError(f"{voxels} NaN or infinite; replace them, for example with numpy.nan_to_num")
    if threshold is not None:
        return _above(data, threshold)
    return _labelled(data, _only_label(data) if label is None else label)


def labels_in(data: NDArray[Any]) -> dict[int, int] | None:
    """Labels other than 0 and how many voxels each has; None where the values are no labels.

    Parameters
    ----------
    data : ndarray
        Any real type. Floating-point volumes hold labels if all values are whole and they are few.

    Returns
    -------
    dict or None
    """
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


def _counted(data: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the different values and how often each occurs; much faster than numpy.unique for few integers."""
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
    found = np.flatnonzero(counts)
    return np.array([int(low) + int(value) for value in found], dtype=object), counts[found]


def _above(data: NDArray[Any], threshold: float) -> NDArray[np.bool_]:
    if not np.isfinite(threshold):
        raise InputError(f"the threshold is {threshold}; give a finite number")
    mask = np.asarray(data > threshold)
    if not mask.any():
        raise InputError(f"no voxel is above the threshold {threshold}; the largest value is {data.max()}")
    return mask


def _labelled(data: NDArray[Any], label: int) -> NDArray[np.bool_]:
    mask = np.asarray(data == label)
    if not mask.any():
        raise InputError(f"no voxel has label {label}; {_present(data)}")
    return mask


def _only_label(data: NDArray[Any]) -> int:
    if data.dtype.kind == "f" and labels_in(data) is None:
        raise InputError(
            f"the volume holds intensities ({data.dtype}, {data.min():g} to {data.max():g}); give a threshold"
        )
    labels = labels_in(data)
    if labels is None or len(labels) > 1:
        raise InputError(f"give a label or a threshold; {_present(data)}")
    if not labels:
        raise InputError("the volume is empty: every voxel is 0")
    return next(iter(labels))


def _present(data: NDArray[Any]) -> str:
    labels = labels_in(data)
    if labels is None:
        return f"the values go from {data.min():g} to {data.max():g}"
    if not labels:
        return "every voxel is 0"
    shown = ", ".join(str(label) for label in list(labels)[:_SHOWN])
    return f"the volume has labels {shown}" + (f" and {len(labels) - _SHOWN} more" if len(labels) > _SHOWN else "")
