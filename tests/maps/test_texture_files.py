"""Textured surfaces in files, and the command that writes them."""

import errno
import json
import struct

import numpy as np
import pytest
import pyvista as pv
from command_line import succeed
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused
from textures import chessboard, needs_window

from voxflat.io.meshes import read_mesh


class TestFiles:
    def test_obj(self, textured, tmp_path):
        textured.save(tmp_path / "a face.obj")
        assert sorted(file.name for file in tmp_path.iterdir()) == ["a face.obj", "a_face.mtl", "a_face.png"]
        own, vtk = read_mesh(tmp_path / "a face.obj"), pv.read(tmp_path / "a face.obj")
        for points, faces, coordinates in (
            (own.points, own.faces, own.texture_coordinates),
            (vtk.points, vtk.regular_faces, vtk.active_texture_coordinates),
        ):
            assert_allclose(points[faces], textured.points[textured.faces], atol=1e-5)
            assert_allclose(coordinates[faces], textured.texture_coordinates[textured.faces], rtol=1e-6, atol=1e-6)
        assert "mtllib a_face.mtl\n" in (tmp_path / "a face.obj").read_text()
        assert (tmp_path / "a_face.mtl").read_text().endswith("map_Kd a_face.png\n")
        assert_array_equal(np.asarray(Image.open(tmp_path / "a_face.png")), textured.picture)

    @needs_window
    def test_vtk_imports_the_obj_with_its_picture(self, textured, tmp_path):
        textured.save(tmp_path / "face.obj")
        plotter = pv.Plotter(off_screen=True)
        plotter.import_obj(tmp_path / "face.obj", tmp_path / "face.mtl")
        (actor,) = [one for one in plotter.actors.values() if one.GetMapper().GetInput().GetNumberOfCells()]
        actor.GetTexture().GetInputAlgorithm().Update()
        assert pv.wrap(actor.GetTexture().GetInput()).dimensions == (64, 64, 1)
        plotter.close()

    def test_vtp(self, textured, tmp_path):
        textured.save(tmp_path / "face.vtp")
        read = pv.read(tmp_path / "face.vtp")
        assert_array_equal(read.points, textured.points)
        assert_array_equal(read.regular_faces, textured.faces)
        assert_array_equal(read.active_texture_coordinates, textured.texture_coordinates)
        assert_array_equal(pv.read_texture(tmp_path / "face.png").to_array(), textured.picture)

    def test_glb(self, textured, tmp_path):
        textured.save(tmp_path / "face.glb")
        (read,) = [block for block in pv.read(tmp_path / "face.glb").recursive_iterator() if block is not None]
        metres = 1e-3 * textured.points[:, [0, 2, 1]] * [1, 1, -1]  # y is up
        assert_array_equal(read.triangulate().regular_faces, textured.faces)
        assert_allclose(read.points, metres, atol=1e-7)
        s, t = textured.texture_coordinates.T
        assert_allclose(read.active_texture_coordinates, np.column_stack([s, 1 - t]), atol=1e-6)
        data = (tmp_path / "face.glb").read_bytes()
        assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
        length = struct.unpack_from("<I", data, 12)[0]
        view = json.loads(data[20 : 20 + length])["bufferViews"][3]
        (tmp_path / "inside.png").write_bytes(data[28 + length + view["byteOffset"] :][: view["byteLength"]])
        assert_array_equal(np.asarray(Image.open(tmp_path / "inside.png")), textured.picture)

    @needs_window
    def test_vtk_draws_the_glb_with_its_picture_upright(self, plane_map, tmp_path):
        """The upper half of the picture is red: on the map's upper half the surface must be red, too."""
        picture = np.zeros((40, 40, 3), dtype=np.uint8)
        picture[:20, :, 0] = picture[20:, :, 2] = 255
        plane_map.textured(picture).save(tmp_path / "plane.glb")
        plotter = pv.Plotter(off_screen=True, window_size=[200, 200], lighting="none")
        plotter.import_gltf(tmp_path / "plane.glb")
        plotter.add_light(pv.Light(light_type="headlight"))
        plotter.view_vector((0, 1, 0), (0, 0, -1))
        plotter.reset_camera()
        drawn = plotter.screenshot(return_img=True).astype(int)
        plotter.close()
        red, blue = drawn[..., 0] > drawn[..., 2] + 80, drawn[..., 2] > drawn[..., 0] + 80
        assert min(red.sum(), blue.sum()) > 500
        # seen along −y of glTF with −z up: columns grow with x of space, rows downwards with −y of space
        v = plane_map.uv[:, 1]
        towards = (plane_map.points[v.argmax()] - plane_map.points[v.argmin()])[:2] * [1, -1]
        seen = (np.argwhere(red).mean(axis=0) - np.argwhere(blue).mean(axis=0))[::-1]
        assert seen @ towards > 0.9 * np.linalg.norm(seen) * np.linalg.norm(towards)

    def test_ply_has_colours(self, textured, tmp_path):
        fine = textured.subdivided()
        fine.save(tmp_path / "face.ply")
        read = pv.read(tmp_path / "face.ply")
        assert_allclose(read.points, fine.points, atol=1e-5)
        assert_array_equal(read.regular_faces, fine.faces)
        assert_array_equal(read.point_data["RGB"], fine.colours)
        own = read_mesh(tmp_path / "face.ply").point_data
        assert_array_equal(np.column_stack([own["red"], own["green"], own["blue"]]), fine.colours)

    def test_opacity(self, cylinder_map, tmp_path):
        picture = np.dstack([chessboard()] * 3 + [255 - chessboard()])
        textured = cylinder_map.textured(picture, texel_size=0.1, repeat=True)
        for name in ("face.obj", "face.glb", "face.ply"):
            textured.save(tmp_path / name)
        assert (tmp_path / "face.mtl").read_text().endswith("map_Kd face.png\nmap_d face.png\n")
        assert np.asarray(Image.open(tmp_path / "face.png")).shape == (64, 64, 4)
        assert b'"alphaMode": "BLEND"' in (tmp_path / "face.glb").read_bytes()
        assert b"10497" in (tmp_path / "face.glb").read_bytes()
        assert_array_equal(read_mesh(tmp_path / "face.ply").point_data["alpha"], textured.colours[:, 3])

    def test_nothing_is_half_written(self, textured, tmp_path, monkeypatch):
        def fails(*_):
            raise OSError(errno.ENOSPC, "the disk is full")

        for name in ("face.obj", "face.mtl", "face.png"):
            (tmp_path / name).write_text("old")
        monkeypatch.setattr("voxflat.maps.textures.textured._png", fails)
        for name in ("face.obj", "face.vtp", "face.glb"):
            with pytest.raises(OSError, match="the disk is full") as told:
                textured.save(tmp_path / name, overwrite=True)
            assert told.value.filename == str(tmp_path / name)
        left = {file.name: file.read_text() for file in tmp_path.iterdir()}
        assert left == dict.fromkeys(("face.obj", "face.mtl", "face.png"), "old")

    def test_what_cannot_be_written(self, textured, cylinder_map, tmp_path):
        refused(
            "unknown file name ending '.stl'. Use one of .obj, .vtp, .glb, .ply",
            textured.save,
            tmp_path / "face.stl",
        )
        with pytest.raises(FileNotFoundError, match=r"face\.obj"):
            textured.save(tmp_path / "missing" / "face.obj")
        (tmp_path / "face.png").mkdir()
        with pytest.raises(IsADirectoryError, match=r"face\.png"):
            textured.save(tmp_path / "face.obj", overwrite=True)
        assert [file.name for file in tmp_path.iterdir()] == ["face.png"]
        Image.fromarray(chessboard()).save(tmp_path / "chess.png")
        before = (tmp_path / "chess.png").read_bytes()
        of_file = cylinder_map.textured(tmp_path / "chess.png")
        refused("chess.png is the picture itself. Choose another name", of_file.save, tmp_path / "chess.obj")
        assert (tmp_path / "chess.png").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".obj", ".vtp", ".glb", ".ply"])
def test_the_command_writes_what_python_writes(cylinder_map, tmp_path, ending, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cylinder_map.save("map.npz")
    Image.fromarray(chessboard()).save("chess.png")
    textured = cylinder_map.textured(chessboard(), 0.25, repeat=True)
    if ending == ".ply":
        textured = textured.subdivided()
    command = ["texture", "map.npz", "chess.png", "--texel-size", 0.25, "--repeat", "-o"]
    result = succeed(*command, f"cli{ending}")
    assert f"{len(textured.points)} points, {len(textured.faces)} triangles" in result.output
    made = json.loads(succeed(*command, f"again{ending}", "--json").stdout)
    (tmp_path / "python").mkdir()
    textured._with_provenance(made["provenance"]).save(tmp_path / "python" / f"cli{ending}")
    for file in (tmp_path / "python").iterdir():
        assert (tmp_path / file.name).read_bytes() == file.read_bytes(), file.name
