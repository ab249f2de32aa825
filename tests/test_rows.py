"""Operations on rows agree with slow NumPy equivalents."""

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from voxflat.unique_rows import distinct, in_rows, numbered

SHAPES = st.one_of(st.tuples(st.integers(0, 40), st.integers(1, 4)), st.tuples(st.integers(0, 40)))
TYPES = st.sampled_from([np.int64, np.uint8, np.uint32, np.float64])


@st.composite
def rows(draw, count=1):
    shape, dtype = draw(SHAPES), draw(TYPES)
    few = st.sampled_from([0, 1, 2, 255]) if np.dtype(dtype).kind == "u" else st.sampled_from([-3, 0, 1, 2])
    other = [(draw(st.integers(0, 40)), *shape[1:]) for _ in range(count - 1)]
    return [draw(arrays.arrays(dtype, one, elements=few)) for one in (shape, *other)]


@given(rows())
def test_the_different_rows_are_numpys(given_rows):
    (array,) = given_rows
    found = distinct(array)
    expected = np.unique(array, axis=0, return_index=True, return_inverse=True, return_counts=True)
    assert found.rows.dtype == array.dtype
    for ours, numpys in zip(found, (expected[0], *(part.ravel() for part in expected[1:])), strict=True):
        np.testing.assert_array_equal(ours, numpys)


@given(rows(count=2))
def test_rows_are_found_among_others(given_rows):
    array, others = given_rows
    known = {tuple(np.atleast_1d(row)) for row in others.tolist()}
    is_there = [tuple(np.atleast_1d(row)) in known for row in array.tolist()]
    np.testing.assert_array_equal(in_rows(array, others), is_there)


@pytest.mark.medium
@given(rows(count=3))
def test_the_same_rows_have_the_same_number(given_rows):
    numbers = np.concatenate(numbered(*given_rows))
    array = np.concatenate(given_rows)
    assert [len(part) for part in numbered(*given_rows)] == [len(part) for part in given_rows]
    for row, number in zip(array, numbers, strict=True):
        is_same = (array == row) if array.ndim == 1 else (array == row).all(axis=1)
        np.testing.assert_array_equal(numbers == number, is_same)


def test_minus_zero_is_zero():
    found = distinct(np.array([[0.0, 1.0], [-0.0, 1.0]]))
    assert len(found.rows) == 1
    assert found.counts == pytest.approx([2])
