import struct

import freesurfer_rule
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from mesh_files import FORMATS, fast, gifti, grid, nib, refuses, sphere
from refusals import refused

from voxflat.io.meshes import Mesh, holds_mesh, write_mesh
from voxflat.io.overlays import read_overlay, read_region
from voxflat.io.patches import Patch, patch_border, patch_faces, read_patch, write_patch


def overlays(folder, values):
    """Write the same values in all formats."""
    values = values.astype(np.float32)
    nib.freesurfer.write_morph_data(folder / "lh.curv", values)
    gifti(folder / "s.shape.gii", [(values, "shape")])
    nib.save(nib.MGHImage(values[:, None, None], np.eye(4)), folder / "s.mgh")
    nib.save(nib.MGHImage(values[:, None, None], np.eye(4)), folder / "s.mgz")
    np.save(folder / "s.npy", values.astype(">f4"))
    np.savetxt(folder / "s.txt", values, "%.9g")
    return sorted(folder.iterdir())


def test_overlays(tmp_path):
    values = np.random.default_rng(3).normal(size=42).astype(np.float32)
    for path in overlays(tmp_path, values):
        read = read_overlay(path, 42)
        np.testing.assert_array_equal(read.astype(np.float32), values)
        assert read.dtype.isnative
        refuses(path, "has 42 values, but the surface has 43 points", read_overlay, 43)
        whole = path.read_bytes()
        for length in (len(whole) // 2, len(whole) - (24 if path.suffix in (".mgh", ".txt") else 2)):
            path.write_bytes(whole[:length])  # MGH ends in 20 bytes that matter not, text in digits
            refuses(path, "", read_overlay, 42)


def test_overlays_with_several_maps(tmp_path):
    maps = np.arange(12, dtype=np.float32).reshape(4, 3)
    gifti(tmp_path / "s.func.gii", [(column, "time_series") for column in maps.T.copy()])
    nib.save(nib.MGHImage(maps[:, None, None, :], np.eye(4)), tmp_path / "s.mgz")
    np.save(tmp_path / "s.npy", maps)
    for name in ("s.func.gii", "s.mgz", "s.npy"):
        np.testing.assert_array_equal(read_overlay(tmp_path / name, 4), maps)
        refuses(tmp_path / name, "has 3 maps. Pass a file with one", read_region, 4)


def test_older_freesurfer_values(tmp_path):
    (tmp_path / "lh.curv").write_bytes(b"\0\0\x03\0\0\x01" + struct.pack(">3h", -100, 0, 250))
    np.testing.assert_array_equal(read_overlay(tmp_path / "lh.curv", 3), [-1, 0, 2.5])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("s.npy", b"hello", "is not a NumPy array"),
        ("lh.curv", b"hello", "is not in a known format for values"),
        ("lh.white", b"\xff\xff\xfehello", "does not contain values at points: its content is FreeSurfer surface"),
        ("s.mgh", b"hello", "is not an MGH file"),
        ("s.mgh", struct.pack(">6i", 1, 5, 1, 1, 1, 3), "specifies the shape .5, 1, 1, 1., but the file ends after 24"),
        ("s.mgh", struct.pack(">6i", 1, 5, 5, 1, 1, 3) + bytes(400), "Pass an array of shape"),
        ("s.mgz", b"\x1f\x8bhello", "its gzip data are damaged"),
        ("lh.annot", b"\xff\xff\xff\xf0", "header is damaged"),
        ("lh.annot", struct.pack(">5i", 2, 1, 0, 0, 0), "does not list the points in order"),
        ("s.txt", b"1\n2\nthree\n", "three"),
        ("lh.curv", b"\xff\xff\xff" + struct.pack(">3i", 5, 0, 1), "5 values, but the file ends after 15 of 35"),
    ],
)
def test_bad_overlays(tmp_path, name, content, message, capfd):
    (tmp_path / name).write_bytes(content)
    refuses(tmp_path / name, message, read_overlay, 3)
    assert capfd.readouterr() == ("", "")


def test_an_array_of_objects_is_not_unpickled(tmp_path):
    np.save(tmp_path / "s.npy", np.array([print], dtype=object), allow_pickle=True)
    refuses(tmp_path / "s.npy", "", read_overlay, 1)
    np.save(tmp_path / "s.npy", np.zeros(3, complex))
    refuses(tmp_path / "s.npy", r"values have data type complex128 and shape \(3,\)", read_overlay, 3)


def test_annotations(tmp_path):
    path, labels = tmp_path / "lh.aparc.annot", np.array([0, 1, 1, 2, -1, 2])
    table = np.array([[25, 5, 25, 0], [25, 100, 40, 0], [125, 100, 160, 0]])
    nib.freesurfer.write_annot(path, labels, table, ["unknown", "bankssts", "Größe"])
    np.testing.assert_array_equal(read_overlay(path, 6), labels)
    np.testing.assert_array_equal(read_region(path, 6, name="bankssts"), labels == 1)
    np.testing.assert_array_equal(read_region(path, 6, name="Größe"), labels == 2)
    message = "'wall' is not one of its labels. Choose one of unknown, bankssts, Größe"
    refused(message, read_region, path, 6, name="wall")
    refuses(path, "contains the labels unknown, bankssts, Größe. Pass the name of one", read_region, 6)
    refuses(path, "has 6 values, but the surface has 7 points", read_overlay, 7)
    whole = path.read_bytes()
    stray = bytearray(whole)
    stray[8:12] = struct.pack(">i", 77)  # a colour that is not in the table
    path.write_bytes(stray)
    assert read_overlay(path, 6)[0] == -1
    for length in range(0, len(whole) - 1, 7):
        path.write_bytes(whole[:length])
        refuses(path, "", read_overlay, 6)


def test_gifti_labels(tmp_path):
    def change(image):
        for key, name in [(0, "???"), (7, "Medial_wall"), (9, "V1")]:
            label = nib.gifti.GiftiLabel(key, 1, 0, 0, 1)
            label.label = name
            image.labeltable.labels.append(label)

    keys = np.array([0, 7, 9, 7], dtype=np.int32)
    path = gifti(tmp_path / "s.label.gii", [(keys, "label")], change)
    np.testing.assert_array_equal(read_region(path, 4), keys != 0)
    np.testing.assert_array_equal(read_region(path, 4, name="Medial_wall"), keys == 7)
    np.testing.assert_array_equal(read_overlay(path, 4), keys)
    message = r"'V2' is not one of its labels. Choose one of \?\?\?, Medial_wall, V1"
    refused(message, read_region, path, 4, name="V2")


def test_values_as_regions(tmp_path):
    values = np.array([0, 1, -2, np.nan, 3])
    for path in overlays(tmp_path, values):
        np.testing.assert_array_equal(read_region(path, 5), [False, True, True, False, True])
        refused(r"not one of its labels|contains no named labels", read_region, path, 5, name="V1")
    np.save(tmp_path / "mask.npy", values > 0)
    np.testing.assert_array_equal(read_region(tmp_path / "mask.npy", 5), values > 0)


LABEL = "#!ascii label  , from subject bert vox2ras=TkReg\n{}\n{}"


@pytest.mark.parametrize(
    ("number", "rows", "message"),
    [
        ("2", "4 0 0 0 0\n", "lists 1 points, but its header specifies 2"),
        ("1", "4 0 0 0 0\n5 0 0 0 0\n", "lists 2 points, but its header specifies 1"),
        ("two", "4 0 0 0 0\n", "second line is not the number"),
        ("1", "9 0 0 0 0\n", "line 3 names point 9, but the surface has points 0 to 5"),
        ("2", "1 0 0 0 0\n-1 0 0 0 0\n", "line 4 names point -1"),
        ("1", "1.5 0 0 0 0\n", "line 3 names point 1.5"),
        ("1", "one 0 0 0 0\n", "one"),
    ],
)
def test_bad_labels(tmp_path, number, rows, message):
    (tmp_path / "lh.V1.label").write_text(LABEL.format(number, rows))
    refuses(tmp_path / "lh.V1.label", message, read_region, 6)


def test_labels(tmp_path):
    path = tmp_path / "lh.V1.label"
    path.write_text(LABEL.format(2, "4  -1.0  0.5 3 0.0\n0 0 0 0 1\n"))
    np.testing.assert_array_equal(read_region(path, 6), [True, False, False, False, True, False])
    np.testing.assert_array_equal(nib.freesurfer.read_label(path), [4, 0])
    refuses(path, "contains no named labels", lambda file: read_region(file, 6, name="V1"))
    path.write_text(LABEL.format(0, ""))
    assert not read_region(path, 6).any()


def test_surfaces_as_regions(tmp_path):
    part = Mesh(grid().points, grid().faces[:2])
    for name in FORMATS:
        write_mesh(tmp_path / name, part)
        assert set(np.flatnonzero(read_region(tmp_path / name, 16))) == set(part.faces.ravel())
        refuses(tmp_path / name, "has 16 values, but the surface has 17 points", read_region, 17)
        refuses(tmp_path / name, "contains a surface|not contain values at|not a NumPy array|values", read_overlay, 16)
        assert holds_mesh(tmp_path / name)


@st.composite
def patches(draw):
    vertices = draw(st.lists(st.integers(0, 2**31 - 2), min_size=1, max_size=20, unique=True))
    k = len(vertices)
    points = draw(npst.arrays(np.float32, (k, 3), elements=st.floats(-1e6, 1e6, width=32)))
    return Patch(np.array(vertices), points, draw(npst.arrays(np.bool_, k)))


@fast
@given(patch=patches())
def test_patch_round_trip(tmp_path, patch):
    path = tmp_path / "lh.cortex.patch.flat"
    write_patch(path, patch)
    data, read = path.read_bytes(), read_patch(path)
    assert (read.vertex_ids.dtype, read.points.dtype, read.border.dtype) == (np.int64, np.float64, np.bool_)
    for one, other in [(read.vertex_ids, patch.vertex_ids), (read.points, patch.points), (read.border, patch.border)]:
        np.testing.assert_array_equal(one, other)
    places, border, _ = freesurfer_rule.read_patch(path, np.empty((0, 3), int))
    assert places == dict(zip(patch.vertex_ids.tolist(), map(tuple, patch.points.tolist()), strict=True))
    assert border == set(patch.vertex_ids[patch.border].tolist())
    write_patch(path, read)
    assert path.read_bytes() == data


def entries(*rows):
    return struct.pack(">2i", -1, len(rows)) + b"".join(struct.pack(">i3f", *row) for row in rows)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"\xff\xff\xff", "begins with ff ff ff, not"),
        (b"#!ascii version of patch", "begins with 23 21 61 73"),
        (struct.pack(">2i", 5, 1), "is not a binary patch file"),
        (struct.pack(">2i", -1, -7), "its header is damaged: it specifies -7 points"),
        (struct.pack(">2i", -1, 2**31 - 1), "but the file ends after 8 of"),
        (entries((1, 0, 0, 0))[:-1], "its header specifies 1 points, but the file ends after 23 of 24 bytes"),
        (entries((1, 0, 0, 0)) + b"\0", "the file has 1 extra bytes"),
        (entries((1, 0, 0, 0), (0, 0, 0, 0)), "entry 1 refers to vertex 0, but patch files count from 1"),
        (entries((1, 0, 0, 0), (-1, 0, 0, 0)), "entry 1 of the patch repeats vertex 0"),
        (entries((1, 0, 0, 0), (2, 0, float("nan"), 0)), r"of patch entry 1, \[0.0, nan, 0.0\], is not finite"),
        (entries(), "vertices have data type .*Pass an integer"),
    ],
)
def test_bad_patches(tmp_path, data, message):
    (tmp_path / "lh.patch.3d").write_bytes(data)
    refuses(tmp_path / "lh.patch.3d", message, read_patch)
    refuses(tmp_path / "lh.patch.3d", "", read_region, 9)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (([0, -1], np.zeros((2, 3)), [True, False]), "entry 1 of the patch refers to vertex -1. Number vertices"),
        (([0.0], np.zeros((1, 3)), [True]), "float64"),
        (([0], np.zeros((2, 3)), [True]), r"Pass arrays of shape \(1, 3\) and \(1,\)"),
        (([3, 0, 3], np.zeros((3, 3)), [True] * 3), "entry 2 of the patch repeats vertex 3"),
    ],
)
def test_bad_patch_arrays(arrays, message):
    refused(message, Patch, *(np.asarray(array) for array in arrays))


def test_patches_that_cannot_be_written(tmp_path):
    far = Patch(np.array([2**31 - 1]), np.zeros((1, 3)), np.array([True]))
    refuses(tmp_path / "p", "vertex 2147483647 exceeds", write_patch, far)
    assert not any(tmp_path.iterdir())


def test_faces_and_border_of_a_patch():
    """A 5 x 5 grid without a corner: the border is its old edge and the neighbours of the corner."""
    mesh = grid(5)
    vertices = np.arange(24, 0, -1)  # all but point 0, backwards
    faces = patch_faces(mesh.faces, vertices, 25)
    np.testing.assert_array_equal(vertices[faces], mesh.faces[(mesh.faces != 0).all(axis=1)])
    border = set(vertices[patch_border(mesh.faces, vertices, 25)])
    assert border == {i * 5 + j for i in range(5) for j in range(5) if i in (0, 4) or j in (0, 4)} - {0}
    inner = np.array([5 * i + j for i in (1, 2, 3) for j in (1, 2, 3)])
    assert set(inner[patch_border(mesh.faces, inner, 25)]) == set(inner) - {12}
    assert patch_border(mesh.faces, [3, 17], 25).all()
    assert patch_faces(mesh.faces, [3, 17], 25).shape == (0, 3)
    assert not patch_border(sphere().faces, np.arange(42), 42).any()
    for function in (patch_faces, patch_border):
        refused("the patch refers to vertex 25, but the surface has 25 points", function, mesh.faces, [0, 25], 25)
        refused(r"face 0 is \[0, 5, 1\], but the surface has points 0 to 3", function, mesh.faces, [0], 4)
