"""Missing values: NaN, infinite or outside a volume. Means are taken over the values that exist, or are missing too."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

NAN_POLICIES = ("omit", "propagate")  # named as in SciPy


def is_defined(known: NDArray[Any], total: NDArray[Any] | int, nan_policy: str) -> NDArray[np.bool_]:
    """Return where a mean of `total` values exists of which `known` exist: of any of them, or only of all."""
    return np.asarray((known > 0) & ((nan_policy == "omit") | (known == total)))


def mean_of_known(
    values: NDArray[Any], known: NDArray[np.bool_], nan_policy: str, axis: int = 0
) -> NDArray[np.float64]:
    """Return the mean along an axis; NaN where it does not exist."""
    each = known if known.ndim == values.ndim else known[..., None]
    sums, count = np.where(each, values, 0).sum(axis=axis, dtype=np.float64), each.sum(axis=axis)
    there = np.broadcast_to(is_defined(count, values.shape[axis], nan_policy), sums.shape)
    return np.asarray(np.divide(sums, count, out=np.full(sums.shape, np.nan), where=there))
