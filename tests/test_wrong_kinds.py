"""Whatever is handed over, an error is one line that names the argument and the value; arguments.py says so for all."""

from pathlib import Path

import numpy as np
import pytest

import voxflat
from voxflat import figures, io
from voxflat.arguments import checked_kind, checked_limit, checked_path, numbers_of, shown

VOLUME = np.zeros((8, 8, 5), np.uint8)
VOLUME[:, :, 2] = 1
ROW, COLUMN = np.mgrid[:6, :6].reshape(2, -1)
POINTS = np.column_stack([5.0 * ROW, 5.0 * COLUMN, np.zeros(36)])
CORNER = np.flatnonzero((ROW < 5) & (COLUMN < 5))
FACES = np.concatenate(
    [np.column_stack([CORNER, CORNER + 6, CORNER + 1]), np.column_stack([CORNER + 1, CORNER + 6, CORNER + 7])]
)


@pytest.mark.parametrize("path", [None, 3, 1j, b"x", [], {1}, "", "a\0b", "\ud800\udfff", np.zeros(2)])
def test_what_is_no_path(path):
    with pytest.raises(voxflat.InputError, match=r"^the path is .*; give the name of a file or directory$") as caught:
        checked_path(path)
    assert "\n" not in str(caught.value)


def test_paths_of_all_kinds_stay():
    assert checked_path("a/b") == checked_path(Path("a/b")) == Path("a/b")
    assert checked_path("\udcff") == Path("\udcff")  # bytes that are no UTF-8
    assert checked_path(".") == Path()


@pytest.mark.parametrize("value", [["a"], [[1, 2], [3]], "x", {}, int, [None], 1j, np.datetime64("2020-01-01")])
def test_what_is_no_number(value):
    with pytest.raises(voxflat.InputError, match=r"^the places are .*; give numbers$"):
        numbers_of(value, "places")


def test_numbers_stay():
    np.testing.assert_array_equal(numbers_of([[1, 2.5]], "places"), [[1, 2.5]])
    assert numbers_of([], "places").shape == (0,)
    assert numbers_of(np.float32(3), "places") == 3


def test_a_limit_is_finite():
    for limit in (float("nan"), float("inf"), "x", np.ones((9, 9))):
        with pytest.raises(voxflat.InputError, match=r"^the memory limit is [^\n]*; give a number of bytes$"):
            checked_limit(limit)


def test_values_are_shown_on_one_short_line():
    assert "\n" not in shown(np.ones((99, 99)))
    assert len(shown("x" * 999)) <= 80
    checked_kind([], "list", "append", "a list")
    with pytest.raises(voxflat.InputError, match=r"^the list is 3; give a list$"):
        checked_kind(3, "list", "append", "a list")


@pytest.fixture(scope="module")
def of_mesh():
    return voxflat.surface((POINTS, FACES))


CALLS = {
    "read_volume": (lambda s: io.read_volume(1j), "path is 1j"),
    "read_mesh": (lambda s: io.read_mesh("a\0b"), "path is 'a.x00b'"),
    "load": (lambda s: voxflat.load(np.ones((2, 2, 2))), "path is array"),
    "figures": (lambda s: figures.heat_maps({}), "comparison is {}; give a Comparison"),
    "save": (lambda s: figures.save([1], "x.png"), r"figure is \[1\]; give a figure of Matplotlib"),
    "in_patch": (lambda s: s.in_patch(np.arange(3)), "patch is array.*; give a Patch"),
    "nearest": (lambda s: s.nearest((0, 0, 2)), "a surface from a mesh has no voxels"),
    "no voxel": (lambda s: voxflat.surface(VOLUME).nearest("x"), "voxel are 'x'; give numbers"),
    "page": (lambda s: voxflat.map_page(3), "flat map is 3; give a FlatMap"),
    "border": (lambda s: io.patch_border(FACES, [0], "64"), "number of points is '64'"),
}


@pytest.mark.parametrize("name", CALLS)
def test_functions_say_it_so(name, of_mesh):
    call, message = CALLS[name]
    with pytest.raises(voxflat.InputError, match=message) as caught:
        call(of_mesh)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("scale", [1e19, 1e107, 1e300])
def test_sizes_beyond_a_billion_mm(scale):
    with pytest.raises(voxflat.InputError, match=r"point \d+ lies at .*, beyond 1e\+09 mm: is it right"):
        voxflat.surface((POINTS * scale, FACES))
    with pytest.raises(voxflat.InputError, match=r"affine .* goes beyond 1e\+09 mm"):
        voxflat.surface(VOLUME, affine=np.diag([scale, scale, scale, 1]))


def test_sizes_up_to_a_billion_mm_keep_their_distances():
    """A map is as good at any of the scales that are taken."""
    errors = [
        voxflat.flatten((POINTS * scale, FACES), sources=9).distortion.raw.relative_error for scale in (1e-3, 1.0, 3e7)
    ]
    np.testing.assert_allclose(errors, errors[1], atol=1e-3)
