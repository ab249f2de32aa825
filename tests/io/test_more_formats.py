"""Formats of other programs: TIFF stacks, Analyze, OFF, GLB and FreeSurfer's ASCII; and lengths that are not in mm."""

import re
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
import tifffile
import trimesh
from command_line import run, succeed
from mesh_files import glb
from PIL import Image
from refusals import refused

import voxflat
from voxflat.errors import InputError
from voxflat.io import VOLUME_ENDINGS, formats, read_mesh, read_volume
from voxflat.io.meshes import READERS

HILL = voxflat.samples.hill()
POINTS, FACES = HILL.points, HILL.faces.astype(np.int64)
STACK = np.random.default_rng(0).integers(0, 900, (5, 6, 7)).astype(np.uint16)  # z, y, x
SIZES = ("PhysicalSizeX", "PhysicalSizeY", "PhysicalSizeZ")
DOCS = Path(__file__).parents[2] / "docs"
NAMES = ["hill.asc", "hill.off", "hill.glb"]


def write(path):
    if path.suffix == ".asc":
        rows = [f"{x:.6f}  {y:.6f}  {z:.6f}  0" for x, y, z in POINTS] + [f"{a} {b} {c} 0" for a, b, c in FACES]
        path.write_text("\n".join(["#!ascii version of lh.white", f"{len(POINTS)} {len(FACES)}", *rows]) + "\n")
    else:
        trimesh.Trimesh(POINTS, FACES, process=False).export(path)


@pytest.mark.parametrize("name", NAMES)
def test_a_surface_is_read_as_it_was_written(tmp_path, name):
    write(tmp_path / name)
    mesh = read_mesh(tmp_path / name)
    np.testing.assert_allclose(mesh.points, POINTS, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, FACES)
    assert len(voxflat.surface(tmp_path / name)) == len(POINTS)
    (tmp_path / "without an ending").write_bytes((tmp_path / name).read_bytes())
    assert len(read_mesh(tmp_path / "without an ending").faces) == len(FACES)


@pytest.mark.parametrize("name", NAMES)
def test_a_damaged_surface_ends_in_one_line(tmp_path, name):
    path = tmp_path / name
    write(path)
    whole = path.read_bytes()
    for length in [*range(0, 60, 7), *np.linspace(60, len(whole) - 40, 20).astype(int)]:
        path.write_bytes(whole[:length])
        refused(name, read_mesh, path)
    damage_or_read(path, whole, read_mesh)


def test_a_damaged_stack_ends_in_one_line(tmp_path):
    path = tmp_path / "s.tif"
    tifffile.imwrite(path, STACK, imagej=True, metadata={"spacing": 2.0, "unit": "um"}, resolution=(2, 2))
    whole = path.read_bytes()
    damage_or_read(path, whole, read_volume)
    damage_or_read(path, whole[:400], read_volume)


def test_only_one_image_of_a_stack_is_read_and_that_is_told(tmp_path, caplog):
    """Several stacks, or pages that are no stack, are refused; an overview picture beside a stack is not."""
    path = tmp_path / "s.ome.tif"
    with tifffile.TiffWriter(path, ome=True) as file:
        for name in ("left", "right"):
            file.write(STACK, metadata={"axes": "ZYX", "Name": name, **dict.fromkeys(SIZES, 1)})
    told = (
        r"contains 2 images \('left' \(7 x 6 x 5\), 'right' \(7 x 6 x 5\)\). Save one image, or all slices as one stack"
    )
    refused(told, read_volume, path)
    for page in STACK:
        tifffile.imwrite(tmp_path / "pages.tif", page, append=True)
    refused(r"contains 5 images \(7 x 6, 7 x 6", read_volume, tmp_path / "pages.tif")
    with tifffile.TiffWriter(tmp_path / "overview.tif") as file:
        file.write(STACK, photometric="minisblack")
        file.write(STACK[0, ::2, ::2], photometric="minisblack")
    assert read_volume(tmp_path / "overview.tif").data.shape == (7, 6, 5)
    assert "overview.tif: contains 2 images (7 x 6 x 5, 4 x 3). Only the first one, a stack, is read" in caplog.text
    caplog.clear()
    with tifffile.TiffWriter(path, ome=True) as file:  # resolutions of one image
        file.write(STACK, subifds=1, metadata={"axes": "ZYX", **dict.fromkeys(SIZES, 1)})
        file.write(STACK[:, ::2, ::2], subfiletype=1)
    assert read_volume(path).data.shape == (7, 6, 5)
    assert not caplog.records


def damage_or_read(path, whole, read):
    """A file with a few changed bytes is read, or causes a one-line error."""
    rng = np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(whole)
        for at in rng.integers(0, min(len(whole), 400) if read is read_volume else len(whole), 3):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read(path)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017


def test_polygons_of_off_are_cut(tmp_path):
    (tmp_path / "quad.off").write_text("OFF\n# of four corners\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3 255 0 0\n")
    assert len(read_mesh(tmp_path / "quad.off").faces) == 2


SQUARE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def test_faces_of_off_may_continue_on_the_next_line(tmp_path):
    path = tmp_path / "square.off"
    for text in (
        "OFF\n4 2 0\n" + SQUARE + "3 0\n1 2\n3 0 2\n3 255 0 0\n",
        "OFF 4 2 5\n" + SQUARE + "3\n0 1 2\n3 0 2 3\n",
    ):
        path.write_text(text)
        np.testing.assert_array_equal(read_mesh(path).faces, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("header", ["OFF\n4 1 0\n", "OFF\n4 3 0\n", "4OFF\n4 2 0\n"])
def test_off_must_list_as_many_faces_as_it_specifies(tmp_path, header):
    (tmp_path / "square.off").write_text(header + SQUARE + "3 0 1 2\n3 0 2 3\n")
    refused(
        "square.off: (its header specifies 1 faces.*lists 2|has 6 lines|does not begin)",
        read_mesh,
        tmp_path / "square.off",
    )
    (tmp_path / "square.off").write_text("OFF\n4 2 0\n" + SQUARE + "3 0 1 2\n3 0 2\n")
    refused("its header specifies 2 faces, but the file lists an incomplete one", read_mesh, tmp_path / "square.off")


def test_tiff_stacks_are_volumes_in_their_unit(tmp_path):
    tifffile.imwrite(tmp_path / "plain.tif", STACK, photometric="minisblack")
    how = {"resolution": (1 / 0.5, 1 / 0.25), "metadata": {"spacing": 2.0, "unit": "um", "axes": "ZYX"}}
    tifffile.imwrite(tmp_path / "imagej.tif", STACK, imagej=True, **how)
    sizes = {f"PhysicalSize{axis}": size for axis, size in zip("XYZ", (0.5, 0.25, 2.0), strict=True)}
    units = {f"PhysicalSize{axis}Unit": "µm" for axis in "XYZ"}
    tifffile.imwrite(tmp_path / "stack.ome.tif", STACK, metadata={"axes": "ZYX", **sizes, **units})
    for name in ("plain.tif", "imagej.tif", "stack.ome.tif"):
        volume = read_volume(tmp_path / name)
        np.testing.assert_array_equal(volume.data, STACK.T)
        assert volume.is_placed == (name != "plain.tif")
        assert volume.unit == ("µm" if volume.is_placed else "mm")
        if volume.is_placed:
            np.testing.assert_allclose(np.diag(volume.affine), [0.5, 0.25, 2.0, 1], rtol=1e-5)
            np.testing.assert_allclose(volume.in_unit("mm").spacing, [0.0005, 0.00025, 0.002], rtol=1e-5)
    assert voxflat.surface(tmp_path / "plain.tif", threshold=450, spacing=(0.5, 0.25, 2.0)).is_voxels
    assert "0.5 x 0.25 x 2 µm" in succeed("check", tmp_path / "imagej.tif", "--threshold", "450").output


@pytest.mark.parametrize(
    ("axes", "shape", "channel", "named"),
    [
        ("CZYX", (2, 5, 6, 7), (1,), "c1"),
        ("TZYX", (3, 5, 6, 7), (2,), "t2"),
        ("TZCYX", (3, 5, 2, 6, 7), (1, 0), "t1 c0"),
    ],
)
def test_a_stack_of_several_volumes_is_read_by_channel(tmp_path, axes, shape, channel, named):
    path, stack = tmp_path / "s.ome.tif", np.random.default_rng(1).integers(0, 99, shape).astype(np.uint8)
    tifffile.imwrite(path, stack, metadata={"axes": axes})
    refused("s.ome.tif: has [236] channels or time points .*Choose one", read_volume, path)
    refused("has no channel 'c7'. Choose one of", read_volume, path, "c7")
    leading = [axis for axis in axes if axis in "TC"]
    expected = np.moveaxis(stack, [axes.index(axis) for axis in leading], range(len(leading)))[channel].T
    number = np.ravel_multi_index(channel, [shape[axes.index(axis)] for axis in leading])
    for given in (named, int(number)):
        np.testing.assert_array_equal(read_volume(path, given).data, expected)


def test_channels_have_the_names_of_the_file(tmp_path):
    path = tmp_path / "s.ome.tif"
    tifffile.imwrite(
        path, np.stack([STACK, STACK + 1]), metadata={"axes": "CZYX", "Channel": {"Name": ["wall", "dna"]}}
    )
    np.testing.assert_array_equal(read_volume(path, "dna").data, STACK.T + 1)


def test_axes_without_names_are_refused(tmp_path):
    tifffile.imwrite(tmp_path / "p.tif", np.zeros((2, 5, 6, 7), np.float32))
    refused(r"does not name its axes \(2 x 5 x 6 x 7\). Save it as OME-TIFF", read_volume, tmp_path / "p.tif")
    tifffile.imwrite(tmp_path / "c.tif", STACK, imagej=True, metadata={"axes": "CYX"})
    refused(r"one slice and several images \(5 along C\)", read_volume, tmp_path / "c.tif")
    np.save(tmp_path / "p.npy", STACK)
    refused("channel is 1, but only TIFF, HDF5 and OME-Zarr", read_volume, tmp_path / "p.npy", 1)


@pytest.mark.parametrize("kind", [nib.Nifti1Pair, nib.AnalyzeImage])
def test_images_of_two_files(tmp_path, kind):
    nib.save(kind(STACK.astype(np.int16), np.diag([1.0, 2, 3, 1])), tmp_path / "pair.img")
    expected = nib.load(tmp_path / "pair.hdr")
    for name in ("pair.img", "pair.hdr"):
        volume = read_volume(tmp_path / name)
        np.testing.assert_array_equal(volume.data, STACK)
        np.testing.assert_array_equal(volume.affine, expected.affine)
    (tmp_path / "pair.img").write_bytes((tmp_path / "pair.img").read_bytes()[:-9])
    refused("ends after 411 of 420 bytes", read_volume, tmp_path / "pair.hdr")
    (tmp_path / "pair.img").unlink()
    refused(r"has no companion file pair.img", read_volume, tmp_path / "pair.hdr")


@pytest.mark.parametrize(("unit", "factor"), [("micron", 1e-3), ("meter", 1e3), ("mm", 1), ("unknown", 1)])
@pytest.mark.parametrize("kind", [nib.Nifti1Image, nib.Nifti2Image])
def test_lengths_of_nifti_become_mm_and_that_is_said(tmp_path, caplog, unit, factor, kind):
    affine = np.diag([2.0, 3, 4, 1])
    affine[:3, 3] = 5, 6, 7
    image = kind(STACK, affine)
    image.header.set_xyzt_units(unit)
    nib.save(image, tmp_path / "v.nii.gz")
    expected = affine * [[factor], [factor], [factor], [1]]
    np.testing.assert_allclose(read_volume(tmp_path / "v.nii.gz").affine, expected)
    np.testing.assert_allclose(voxflat.io.as_volume(image).affine, expected)
    assert ("converted to mm" in caplog.text) == (factor != 1)


def test_surfaces_of_a_glb_are_placed_and_keep_their_texture(tmp_path):
    """Several surfaces, one mirrored, with and without texture coordinates; the picture is not opened."""
    picture = Image.new("RGB", (4, 4))
    scene = trimesh.Scene()
    uv = POINTS[:, :2] / 100
    look = trimesh.visual.TextureVisuals(uv, image=picture)
    scene.add_geometry(trimesh.Trimesh(POINTS, FACES, visual=look, process=False))
    scene.add_geometry(trimesh.Trimesh(POINTS, FACES, process=False), transform=np.diag([-1.0, 1, 1, 1]))
    scene.export(tmp_path / "two.glb")
    mesh = read_mesh(tmp_path / "two.glb")
    textured = np.isfinite(mesh.texture_coordinates).all(axis=1)
    for of, points, faces in ((textured, POINTS, FACES), (~textured, POINTS * [-1, 1, 1], FACES[:, ::-1])):
        np.testing.assert_allclose(mesh.points[of], points, atol=1e-5)
        np.testing.assert_array_equal(mesh.faces[of[mesh.faces].all(axis=1)], faces + np.flatnonzero(of)[0])
    np.testing.assert_allclose(mesh.texture_coordinates[textured], uv, atol=1e-6)


def test_parts_of_a_glb_are_where_trimesh_places_them(tmp_path):
    """Nodes within nodes, with matrices or with translation, rotation and scale; lists and strips; whole numbers."""
    rng = np.random.default_rng(0)
    points, corners = rng.normal(size=(9, 3)).astype("<f4"), np.array([0, 1, 2, 3, 4, 5], "<u2")
    body = points.tobytes() + corners.tobytes()
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 9, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "byteOffset": 12},
    ]
    views = [{"buffer": 0, "byteLength": 108}, {"buffer": 0, "byteOffset": 108, "byteLength": 12}]
    views[0]["byteStride"] = 12
    quaternion = rng.normal(size=4)
    moved = {
        "translation": [1, 2, 3],
        "rotation": (quaternion / np.linalg.norm(quaternion)).tolist(),
        "scale": [1, 2, -3],
    }
    matrix = {"matrix": [0, 2, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]}
    first = {"attributes": {"POSITION": 0}, "indices": 1}
    meshes = [{"primitives": [first, {**first, "mode": 5}, {**first, "mode": 1}]}]
    nodes = [{"children": [1, 2], **matrix}, {"mesh": 0, **moved}, {"mesh": 0, "children": [3]}, {"mesh": 0, **matrix}]
    told = {"scenes": [{"nodes": []}, {"nodes": [0]}], "scene": 1, "nodes": nodes, "meshes": meshes}
    told |= {"accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(body)}]}
    (tmp_path / "a.glb").write_bytes(glb(told, body))

    def triangles(points, faces):
        """Return the corners of all triangles in one order; a triangle begins at its lowest corner."""
        each = np.round(points[faces], 4)
        each = [np.roll(one, -min(range(3), key=lambda n: tuple(one[n])), axis=0) for one in each]
        return np.array(sorted(one.ravel().tolist() for one in each))

    mesh, scene = read_mesh(tmp_path / "a.glb"), trimesh.load_scene(tmp_path / "a.glb")
    expected = scene.to_geometry()
    assert len(mesh.faces) == 3 * (2 + 4)
    np.testing.assert_allclose(
        triangles(mesh.points, mesh.faces), triangles(expected.vertices, expected.faces), atol=1e-3
    )


def test_a_fan_of_a_glb_and_coordinates_as_shares_of_the_largest_number(tmp_path):
    points, places = (
        np.array([[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]], "<i2"),
        np.array([[0, 255], [255, 0]] * 2, "u1"),
    )
    body = points.tobytes() + places.tobytes()
    accessors = [{"bufferView": 0, "componentType": 5122, "count": 4, "type": "VEC3"}]
    accessors += [{"bufferView": 1, "componentType": 5121, "count": 4, "type": "VEC2", "normalized": True}]
    views = [{"buffer": 0, "byteLength": 24}, {"buffer": 0, "byteOffset": 24, "byteLength": 8}]
    part = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "mode": 6}
    told = {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [part]}]}
    told |= {"accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": 32}]}
    (tmp_path / "a.glb").write_bytes(glb(told, body))
    mesh = read_mesh(tmp_path / "a.glb")
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(mesh.points, points)
    np.testing.assert_array_equal(mesh.texture_coordinates, [[0, 0], [1, 1]] * 2)


def test_lines_of_an_obj_are_ignored(tmp_path):
    (tmp_path / "lines.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nl 1 2\nf 1 2 3\n")
    mesh = read_mesh(tmp_path / "lines.obj")
    assert len(mesh.faces) == 1
    assert mesh.warnings == ("has lines (1) in addition to its faces, which are ignored",)


def test_an_unknown_ending_lists_all_endings_that_are_read(tmp_path, monkeypatch):
    """A mesh or a volume where both fit, and the same endings in the reference."""
    monkeypatch.chdir(tmp_path)
    Path("a.foo").write_bytes(b"neither")
    rows = re.findall(r"^\| (volume|mesh) \| (.*?) \|", (DOCS / "reference/formats.md").read_text(), re.MULTILINE)
    of_volumes, of_meshes = (set(re.findall(r"`(\.[a-z0-9.]+)`", row)) for _, row in rows)
    assert of_volumes == {*VOLUME_ENDINGS, ".zarr"}
    assert of_meshes == set(formats.ENDINGS)
    assert {*formats.ENDINGS.values(), formats.FREESURFER} == set(READERS)
    calls = {read_volume: of_volumes, read_mesh: of_meshes}
    calls |= dict.fromkeys((voxflat.surface, voxflat.check), of_volumes | of_meshes)
    for call, endings in calls.items():
        with pytest.raises(InputError) as caught:
            call("a.foo")
        assert set(re.findall(r"(?<=[ ])\.[a-z0-9.]+", str(caught.value))) | {".zarr"} == endings | {".zarr"}, call
    assert ".glb" in run("flatten", "a.foo", "-o", "a.npz").output
