"""Distances between all vertices, or between parcels, in memory and in the files that other programs read."""

import h5py
import nibabel as nib
import numpy as np
import pytest
import zarr
from command_line import fail, succeed
from mesh_files import needs_workbench, workbench
from refusals import refused

import voxflat
from voxflat.io import Mesh, write_mesh

ENDINGS = (".npy", ".csv", ".tsv", ".txt", ".h5", ".zarr")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with two hemispheres: a hill and its mirror image."""
    folder = tmp_path_factory.mktemp("sides")
    hill = voxflat.samples.hill()
    write_mesh(folder / "lh.hill.surf.gii", Mesh(hill.points, hill.faces))
    write_mesh(folder / "rh.hill.surf.gii", Mesh(hill.points * [-1, 1, 1], hill.faces[:, ::-1]))
    return folder


@pytest.fixture(scope="module")
def sides(folder):
    return [voxflat.surface(folder / f"{side}.hill.surf.gii") for side in ("lh", "rh")]


def labels_of(surface):
    """Return four quarters from 1 to 4, and 0 in the middle, which is no parcel."""
    x, y = (surface.points[:, axis] - np.median(surface.points[:, axis]) for axis in (0, 1))
    labels = 1 + (x > 0) + 2 * (y > 0)
    return np.where(np.hypot(x, y) < 2, 0, labels)


def test_all_distances_are_those_of_rows_from_all_points():
    hill = voxflat.samples.hill()
    for geodesic in ("graph", "exact"):
        matrix = hill.geodesic_matrix(geodesic=geodesic)
        expected = hill.geodesic(np.arange(len(hill)), geodesic=geodesic)
        assert np.array_equal(matrix.values, np.asarray(expected))
        np.testing.assert_allclose(matrix.values, np.transpose(matrix.values), rtol=1e-5, atol=1e-5)
    assert np.array_equal(matrix.ids, hill.ids)
    assert matrix.unit == "mm"
    assert np.array_equal(np.asarray(matrix), matrix.values)


def test_a_part_without_a_region_has_neither_its_points_nor_paths_through_it():
    sheet = voxflat.range_image(np.zeros((9, 9)), 1.0)
    wall = np.zeros((9, 9), dtype=bool)
    wall[2:, 4] = True
    matrix = sheet.drop(wall.ravel()).geodesic_matrix(geodesic="exact")
    assert not np.isin(np.flatnonzero(wall), matrix.ids).any()
    far = matrix.values[matrix.ids.tolist().index(8 * 9), matrix.ids.tolist().index(8 * 9 + 8)]
    assert far > 15  # around the wall; 8 across it


@pytest.mark.parametrize("method", ["mean", "min", "centroid"])
def test_distances_between_parcels_equal_brute_force(method):
    hill = voxflat.samples.hill()
    labels = labels_of(hill)
    every = np.asarray(hill.geodesic_matrix(), dtype=np.float64)
    expected = np.zeros((4, 4))
    members = [np.flatnonzero(labels == number) for number in (1, 2, 3, 4)]
    centres = [
        own[np.argmin(np.linalg.norm(hill.points[own] - hill.points[own].mean(axis=0), axis=1))] for own in members
    ]
    for a in range(4):
        for b in range(4):
            block = every[np.ix_(members[a], members[b])]
            value = {"mean": block.mean(), "min": block.min(), "centroid": every[centres[a], centres[b]]}[method]
            expected[a, b] = 0 if a == b else value
    matrix = hill.geodesic_matrix(labels, method=method)
    np.testing.assert_allclose(matrix.values, expected, rtol=1e-5)
    assert np.array_equal(matrix.values, np.transpose(matrix.values))
    assert matrix.names == ("1", "2", "3", "4")
    assert matrix.ids.tolist() == [1, 2, 3, 4]


def read_by_others(path):
    """Return the values of a file as the libraries of its format read them."""
    if path.name.endswith(".npy"):
        return np.load(path)
    if path.name.endswith(".h5"):
        with h5py.File(path) as file:
            return file["distances"][:]
    if path.name.endswith(".zarr"):
        return zarr.open_array(str(path / "distances"), mode="r")[:]
    if path.name.endswith(".nii"):
        return nib.load(path).get_fdata()
    return np.loadtxt(path, delimiter={".csv": ",", ".tsv": "\t", ".txt": " "}[path.suffix])


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_hold_both_hemispheres_and_tell_their_rows(ending, sides, tmp_path):
    left, right = sides
    path = tmp_path / f"both{ending}"
    matrix = right.geodesic_matrix(other=left, file=path)  # the left one comes first
    values, count = read_by_others(path), len(left)
    assert values.shape == (2 * count, 2 * count)
    np.testing.assert_allclose(values[:count, :count], left.geodesic_matrix().values, rtol=2e-6)
    np.testing.assert_allclose(values[count:, count:], right.geodesic_matrix().values, rtol=2e-6)
    assert np.isposinf(values[:count, count:]).all()
    np.testing.assert_allclose(np.asarray(matrix), values, rtol=1e-6)
    assert matrix.sides.tolist() == ["left"] * count + ["right"] * count
    if ending == ".h5":
        with h5py.File(path) as file:
            rows = [column.asstr()[:].tolist() for column in (file["hemisphere"], file["id"])]
    elif ending == ".zarr":
        told = zarr.open_group(str(path), mode="r").attrs["voxflat"]["rows"]
        rows = [told["hemisphere"], told["id"]]
    else:
        lines = path.with_name(f"{path.name}.rows.tsv").read_text().splitlines()
        assert lines[0] == "hemisphere\tid\tname"
        rows = [list(column) for column in zip(*(line.split("\t")[:2] for line in lines[1:]), strict=True)]
    assert rows == [matrix.sides.tolist(), [str(number) for number in matrix.ids]]


@pytest.mark.parametrize("dtype", ["float32", "uint8"])
def test_cifti_files_of_vertices(dtype, sides, tmp_path):
    left, right = sides
    part = left.drop(np.arange(30))
    matrix = part.geodesic_matrix(other=right, file=tmp_path / "both.dconn.nii", dtype=dtype)
    image = nib.load(tmp_path / "both.dconn.nii")
    assert image.get_data_dtype() == dtype
    for axis in map(image.header.get_axis, (0, 1)):
        names = [(name.split("_")[-1], model.vertex.tolist()) for name, _, model in axis.iter_structures()]
        assert names == [("LEFT", part.ids.tolist()), ("RIGHT", right.ids.tolist())]
    assert image.nifti_header.get_intent()[0] == "ConnDense"
    values, count = image.get_fdata(), len(part)
    assert np.array_equal(values, np.asarray(matrix))
    expected = np.asarray(part.geodesic_matrix())
    across = 255 if dtype == "uint8" else np.inf
    assert (values[:count, count:] == across).all()
    np.testing.assert_allclose(values[:count, :count], expected, rtol=1e-6, atol=0.5 * (dtype == "uint8"))


def test_cifti_files_of_parcels(sides, tmp_path):
    left, right = sides
    given = [labels_of(left), labels_of(right)]
    left.geodesic_matrix(given, other=right, file=tmp_path / "both.pconn.nii")
    image = nib.load(tmp_path / "both.pconn.nii")
    axis = image.header.get_axis(0)
    assert image.nifti_header.get_intent()[0] == "ConnParcels"
    assert axis.name.tolist() == ["1", "2", "3", "4"] * 2
    for number in range(8):
        structure = "CIFTI_STRUCTURE_CORTEX_" + ("LEFT" if number < 4 else "RIGHT")
        expected = np.flatnonzero(given[number // 4] == number % 4 + 1)
        assert {name: own.tolist() for name, own in axis.vertices[number].items()} == {structure: expected.tolist()}
    np.testing.assert_allclose(image.get_fdata()[4:, 4:], right.geodesic_matrix(given[1]).values, rtol=1e-6)


@needs_workbench
def test_workbench_reads_the_cifti_files(sides, tmp_path):
    left, right = sides
    left.geodesic_matrix(other=right, file=tmp_path / "both.dconn.nii", dtype="uint8")
    left.geodesic_matrix(labels_of(left), file=tmp_path / "left.pconn.nii")
    told = workbench("-file-information", tmp_path / "both.dconn.nii")
    assert f"CortexRight:          {len(right)} out of {len(right)} vertices" in told
    workbench("-cifti-convert", "-to-text", tmp_path / "left.pconn.nii", tmp_path / "left.txt")
    np.testing.assert_allclose(
        np.loadtxt(tmp_path / "left.txt"), left.geodesic_matrix(labels_of(left)).values, rtol=1e-4
    )


def test_nothing_is_rounded_or_cut_off_in_silence(sides, tmp_path):
    left, right = sides
    long = voxflat.range_image(np.zeros((4, 4)), 100.0)
    refused("reach 424.3, but uint8 holds up to 254. Use float32", long.geodesic_matrix, dtype="uint8")
    refused("Use float32", long.geodesic_matrix, dtype="uint8", file=tmp_path / "long.npy")
    assert not list(tmp_path.iterdir())
    huge = voxflat.range_image(np.zeros((4, 4)), 1e5)
    refused("but float16 holds up to 65504", huge.geodesic_matrix, dtype="float16")
    half = left.geodesic_matrix(dtype="float16")
    assert np.array_equal(half.values, np.asarray(left.geodesic_matrix()).astype(np.float16))
    refused("method is 'min', but there are no parcels", left.geodesic_matrix, method="min")
    refused("hemispheres of the two surfaces are the CortexLeft and the CortexLeft", left.geodesic_matrix, other=left)
    refused("CIFTI files cannot hold float16", left.geodesic_matrix, file=tmp_path / "a.dconn.nii", dtype="float16")
    refused("between vertices as a.pconn.nii", left.geodesic_matrix, file=tmp_path / "a.pconn.nii")
    refused("Pass a .dlabel.nii file with both", left.geodesic_matrix, labels_of(left), other=right)
    refused("the hemisphere of the surface is unknown", long.geodesic_matrix, file=tmp_path / "a.dconn.nii")
    refused("Pass 'float32', 'float16' or 'uint8'", left.geodesic_matrix, dtype="float64")
    refused("ends in .npy, .csv", left.geodesic_matrix, file=tmp_path / "a.mat")
    refused("Pass file", left.geodesic_matrix, memory_limit=1000)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".npy", ".h5", ".zarr", ".dconn.nii"])
def test_a_cancelled_matrix_leaves_no_file(ending, sides, tmp_path):
    with pytest.raises(voxflat.Cancelled):
        sides[0].geodesic_matrix(file=tmp_path / f"a{ending}", progress=lambda *_: False)
    assert not list(tmp_path.iterdir())


def test_the_command_matches_files_to_hemispheres(folder, sides, tmp_path):
    walls = [np.arange(40), np.arange(60)]
    for side, wall in zip(("lh", "rh"), walls, strict=True):
        lines = "".join(f"{vertex} 0 0 0 0\n" for vertex in wall)
        (tmp_path / f"{side}.wall.label").write_text(f"#!ascii label\n{len(wall)}\n{lines}")
    surfaces = [folder / "rh.hill.surf.gii", folder / "lh.hill.surf.gii"]
    drop = ["--drop", tmp_path / "lh.wall.label", "--drop", tmp_path / "rh.wall.label"]
    told = succeed("distance-matrix", *surfaces, *drop, "-o", tmp_path / "both.npy")
    parts = [side.drop(wall) for side, wall in zip(sides, walls, strict=True)]
    expected = parts[0].geodesic_matrix(other=parts[1])
    assert np.array_equal(np.load(tmp_path / "both.npy"), expected.values)
    assert f"{len(expected.ids):,} x {len(expected.ids):,} distances between points, in mm" in told.output
    np.save(tmp_path / "wall.npy", np.isin(np.arange(441), walls[0]))
    wall = ["--drop", tmp_path / "wall.npy"]
    fail(1, "the hemisphere of the file is unknown", "distance-matrix", *surfaces, *wall, "-o", tmp_path / "no.npy")
    one = ["--parcels", tmp_path / "lh.wall.label"]
    fail(1, "belong to one hemisphere", "distance-matrix", *surfaces, *one, "-o", tmp_path / "no.csv")
    assert not (tmp_path / "no.npy").exists()
