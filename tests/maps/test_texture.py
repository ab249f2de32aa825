"""Texture coordinates and pictures on a surface, whose triangles are divided where the map tears or bends; files."""

import errno
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
import trimesh
from command_line import succeed
from hard_shapes import signed_areas
from hypothesis import given
from hypothesis import strategies as st
from mesh_files import icosphere
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused
from textures import areas, chessboard, cylinder, grid, needs_window, side_counts

import voxflat
from voxflat import InputError
from voxflat.io.meshes import read_mesh
from voxflat.maps.textures.textured import TexturedSurface
from voxflat.methods import Grossmann2002, Voxflat


@pytest.fixture(scope="module")
def plane_map():
    points, faces = grid(13, 21)
    return replace(voxflat.flatten((points, faces), Voxflat(sources=100)), uv=points[:, :2])  # to be exact


@pytest.fixture(scope="module")
def cylinder_map():
    return voxflat.flatten(cylinder(), Voxflat(sources=300))


@pytest.fixture
def textured(cylinder_map):
    return cylinder_map.textured(chessboard())


class TestPlacing:
    @pytest.mark.parametrize("shape", [(64, 64), (30, 90), (90, 30), (1, 1)])
    def test_the_picture_just_covers_the_map_in_its_proportions(self, cylinder_map, shape):
        textured = cylinder_map.textured(np.zeros(shape, dtype=np.uint8))
        texels = textured.texture_coordinates * [shape[1], shape[0]]
        # a similarity: all distances in the picture are those on the map by one factor
        uv = cylinder_map.uv - cylinder_map.uv.mean(axis=0)
        factor = np.linalg.norm(np.ptp(texels, axis=0)) / np.linalg.norm(np.ptp(uv, axis=0))
        assert_allclose(texels - texels.mean(axis=0), factor * uv, atol=1e-9 * max(shape))
        low, high = textured.texture_coordinates.min(axis=0), textured.texture_coordinates.max(axis=0)
        assert_allclose((low + high) / 2, 0.5)
        assert_allclose((high - low).max(), 1)

    def test_on_a_plane_it_is_a_similarity_of_space(self, plane_map):
        textured = plane_map.textured(chessboard(), texel_size=0.5)
        points, texels = textured.points, 64 * textured.texture_coordinates
        in_space = np.linalg.norm(points[:, None] - points, axis=2)
        in_picture = np.linalg.norm(texels[:, None] - texels, axis=2)
        assert_allclose(0.5 * in_picture, in_space, atol=1e-12)

    def test_a_texel_has_the_size_that_is_asked_for(self, cylinder_map):
        textured = cylinder_map.textured(chessboard(), texel_size=0.25, repeat=True)
        moved = 0.25 * 64 * textured.texture_coordinates - cylinder_map.uv
        assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-9)
        assert textured.texture_coordinates.max() > 1

    def test_a_picture_that_is_too_small_must_be_repeated(self, cylinder_map):
        message = r"16 x 16 mm and does not cover the map. Pass repeat=True, or .* least (\S+) mm"
        with pytest.raises(InputError, match=message) as told:
            cylinder_map.textured(chessboard(), texel_size=0.25)
        enough = float(str(told.value).split()[-2])
        assert np.abs(cylinder_map.textured(chessboard(), enough).texture_coordinates - 0.5).max() <= 0.5
        refused("does not cover", cylinder_map.textured, chessboard(), 0.999 * enough)

    def test_a_repeated_picture_goes_on(self, cylinder_map):
        once = cylinder_map.textured(chessboard(), texel_size=0.25, repeat=True)
        tiled = cylinder_map.textured(np.tile(chessboard(), (5, 5)), texel_size=0.25)
        assert_array_equal(once.colours, tiled.colours)

    def test_colours_are_those_of_texture(self, cylinder_map):
        picture = np.random.default_rng(0).integers(0, 256, (20, 33, 4), dtype=np.uint8)
        assert_array_equal(cylinder_map.textured(picture).colours, cylinder_map.texture(picture))

    def test_torn_triangles_are_left_out(self):
        flat_map = voxflat.flatten(np.ones((9, 9, 1), int), method=Grossmann2002(sources=81))
        torn = np.arange(len(flat_map.faces)) % 7 == 0
        object.__setattr__(flat_map, "torn", torn)
        assert_array_equal(flat_map.textured(chessboard()).faces, flat_map.faces[~torn])


class TestPictures:
    @pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr"])
    def test_grey_and_colours_with_opacity_or_not(self, cylinder_map, tmp_path, mode):
        image = Image.fromarray(chessboard()).convert("RGBA" if mode == "LA" else "RGB").convert(mode)
        colours = cylinder_map.textured(image).picture
        assert colours.shape == (64, 64, 4 if "A" in mode else 3)
        assert_array_equal(colours[..., :3], np.repeat(chessboard()[..., None], 3, axis=2))
        if mode not in ("CMYK", "YCbCr"):
            image.save(tmp_path / "picture.png")
            textured = cylinder_map.textured(tmp_path / "picture.png")
            assert_array_equal(textured.picture, colours)
            assert textured.source == tmp_path / "picture.png"

    @pytest.mark.parametrize("picture", [chessboard() > 0, chessboard() / 255, (chessboard() / 255).astype(np.float32)])
    def test_arrays_of_bool_and_of_floats(self, cylinder_map, picture):
        assert_array_equal(cylinder_map.textured(picture).picture[..., 0], chessboard())

    def test_each_of_the_deep_greys_becomes_the_next_of_256(self, cylinder_map, tmp_path):
        deep = np.arange(1 << 16, dtype=np.uint16).reshape(256, 256)
        Image.fromarray(deep).save(tmp_path / "deep.tif")
        assert_array_equal(cylinder_map.textured(tmp_path / "deep.tif").picture[..., 0], np.round(deep / 65535 * 255))

    def test_photographs_are_turned_upright(self, cylinder_map, tmp_path):
        image = Image.fromarray(np.zeros((20, 30), dtype=np.uint8))
        exif = Image.Exif()
        exif[0x0112] = 6
        image.save(tmp_path / "photo.jpg", exif=exif)
        assert cylinder_map.textured(tmp_path / "photo.jpg").picture.shape == (30, 20, 3)

    def test_what_is_no_picture(self, cylinder_map):
        for picture, told in (
            (np.full((4, 4), np.nan), "values range from nan to nan. Scale floats to the range 0 to 1 .no NaN"),
            (np.array([[0.0, 255.0]]), "values range from 0 to 255. Scale floats to the range 0 to 1"),
            (np.zeros((4, 4), dtype=int), "type int64. Pass uint8 .0 to 255., or floats from 0 to 1"),
            (np.zeros((4, 4, 2)), r"shape \(4, 4, 2\). Pass an array of shape \(H, W\), \(H, W, 3\) or \(H, W, 4\)"),
            (np.zeros((0, 4)), r"shape \(0, 4\)"),
            (np.zeros(4), r"shape \(4,\)"),
            (None, r"the picture has shape \(\) and data type object"),
            (Image.new("F", (4, 4)), "more than 8 bits"),
        ):
            refused(told, cylinder_map.textured, picture)

    def test_files_that_are_no_picture(self, cylinder_map, tmp_path):
        with pytest.raises(FileNotFoundError):
            cylinder_map.textured(tmp_path / "missing.png")
        Image.fromarray(chessboard()).save(tmp_path / "whole.png")
        whole = (tmp_path / "whole.png").read_bytes()
        for damaged in (b"", b"text", whole[:60], whole[:-30]):
            (tmp_path / "bad.png").write_bytes(damaged)
            refused(r"bad.png: .*Check that the file is complete", cylinder_map.textured, tmp_path / "bad.png")
        refused("is a directory. Pass a path to a file", cylinder_map.textured, tmp_path)

    @pytest.mark.parametrize("size", [0, -1, np.nan, np.inf])
    def test_texel_sizes(self, cylinder_map, size):
        refused(r"texel_size is .* mm. Pass a positive number", cylinder_map.textured, chessboard(), size, repeat=True)


class TestSubdivision:
    def flat(self, picture, rows=3, columns=3, step=4.0, repeat=False):
        points, faces = grid(rows, columns, step)
        return TexturedSurface(points, faces, points[:, :2] / points[:, :2].max(), picture, repeat)

    def test_nothing_is_split_where_colours_carry_the_picture(self):
        assert len(self.flat(np.full((64, 64, 3), 90, dtype=np.uint8)).subdivided().faces) == 8
        ramp = np.repeat(np.arange(64, dtype=np.uint8)[:, None, None] * 4, 64, axis=1)
        assert len(self.flat(ramp, 9, 9).subdivided().faces) == 128

    def test_only_what_needs_it_is_split(self):
        """A black spot at the centre of one of 128 triangles: all that are far from it stay."""
        picture = np.full((128, 128, 3), 255, dtype=np.uint8)
        picture[70:74, 20:24] = 0  # at (22, 128 − 72) of 128
        before = self.flat(picture, 9, 9)
        after = before.subdivided()
        whole = {tuple(face) for face in after.faces.tolist()}
        split = np.array([tuple(face) not in whole for face in before.faces.tolist()])
        centres = 128 * before.texture_coordinates[before.faces].mean(axis=1)
        assert 1 <= split.sum() <= 24
        assert np.linalg.norm(centres[split] - [22, 56], axis=1).max() < 3 * 16
        assert len(after.faces) > 128 + 32

    @pytest.mark.slow
    @given(st.integers(0, 2**32 - 1), st.sampled_from([4.0, 16.0, 100.0]), st.booleans())
    def test_the_surface_stays_and_carries_the_picture(self, seed, tolerance, repeat):
        rng = np.random.default_rng(seed)
        points, faces = grid(4, 5)
        coordinates = (points[:, :2] + rng.uniform(-0.2, 0.2, (20, 2))) / 5 * (2 if repeat else 1)
        points = points + rng.normal(size=points.shape)
        picture = np.kron(rng.integers(0, 256, (5, 6, 3)), np.ones((4, 4, 1))).astype(np.uint8)
        after = TexturedSurface(points, faces, coordinates, picture, repeat).subdivided(tolerance)
        n = len(points)
        assert_array_equal(after.points[:n], points)
        assert_array_equal(after.texture_coordinates[:n], coordinates)
        # no cracks: every side has two triangles but those of the boundary, which is as long as before; one disk
        sides, counts = side_counts(after.faces)
        sides_before, counts_before = side_counts(faces)
        assert counts.max() == 2
        length = lambda p, s: np.linalg.norm(p[s[:, 0]] - p[s[:, 1]], axis=1).sum()  # noqa: E731
        assert_allclose(length(after.points, sides[counts == 1]), length(points, sides_before[counts_before == 1]))
        assert len(after.points) - len(sides) + len(after.faces) == 1
        # the same shape: area and volume below it, and each triangle's way round
        assert_allclose(areas(after.points, after.faces).sum(), areas(points, faces).sum())
        assert (signed_areas(after.texture_coordinates, after.faces) > 0).all()
        # halfway along the sides of triangles longer than a texel; colours are rounded
        corners = after.texture_coordinates[after.faces]
        ahead = np.roll(corners, -1, axis=1)
        is_long = np.linalg.norm((ahead - corners) * picture.shape[1::-1], axis=2).max(axis=1) > 1
        colours = after.colours.astype(float)[after.faces]
        true = replace(after, texture_coordinates=((corners + ahead) / 2).reshape(-1, 2)).colours.reshape(-1, 3)
        off = np.abs((colours + np.roll(colours, -1, axis=1)).reshape(-1, 3) / 2 - true)
        assert off[np.repeat(is_long, 3)].max(initial=0) <= tolerance + 1

    def test_angles_stay(self, textured):
        def least_angle(surface):
            corners = surface.texture_coordinates[surface.faces]
            ahead = np.roll(corners, -1, axis=1) - corners
            back = np.roll(corners, 1, axis=1) - corners
            cosine = (ahead * back).sum(axis=2) / np.linalg.norm(ahead, axis=2) / np.linalg.norm(back, axis=2)
            return np.arccos(cosine).min()

        assert least_angle(textured.subdivided()) >= least_angle(textured) / 2 - 1e-9

    @pytest.mark.parametrize("tolerance", [0, -1, np.nan, np.inf])
    def test_tolerances(self, textured, tolerance):
        refused(r"tolerance is .*. Pass a positive number", textured.subdivided, tolerance)

    def test_too_fine_a_picture_is_refused(self, textured, monkeypatch):
        monkeypatch.setattr("voxflat.maps.textures.subdivision._MOST_FACES", 5000)
        refused(r"64 x 64 texels need more than 5000 triangles. Increase the tolerance", textured.subdivided)


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
        (length,) = struct.unpack_from("<I", data, 12)
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
        told = "unknown file name ending '.stl'. Use one of .obj, .vtp, .glb, .ply"
        refused(told, textured.save, tmp_path / "face.stl")
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


@pytest.mark.medium
def test_cuts_of_a_map_are_seams_of_the_texture(tmp_path):
    """OBJ keeps the closed surface, GLB divides points, and other readers find the place of each corner in both."""
    surface = voxflat.surface(icosphere(20.0, 3))
    flat = surface.flatten(Voxflat(sources=30))
    textured = flat.textured(chessboard())
    assert len(textured.points) == 642 < len(flat) == len(textured.texture_coordinates)
    assert_array_equal(textured.points[textured.faces], flat.points[flat.faces])
    corners = textured.texture_coordinates[textured.texture_faces]
    for ending in (".obj", ".glb"):
        path = tmp_path / f"ball{ending}"
        textured.save(path)
        seen = trimesh.load(path, process=False, force="mesh")
        assert_allclose(seen.visual.uv[seen.faces], corners, atol=1e-6)
    assert len(read_mesh(tmp_path / "ball.obj").points) == 642
    own = read_mesh(tmp_path / "ball.glb")
    assert_allclose(own.texture_coordinates[own.faces], corners, atol=1e-6)
    whole = voxflat.measure(surface, tmp_path / "ball.obj", sources=10**6).best_scale.relative_error
    assert whole == pytest.approx(voxflat.measure(surface, flat, sources=10**6).best_scale.relative_error, rel=1e-6)
    by_glb = voxflat.measure(tmp_path / "ball.glb", tmp_path / "ball.glb", sources=10**6)
    assert by_glb.best_scale.relative_error == pytest.approx(whole, rel=1e-4)


@pytest.mark.parametrize(("unit", "metres"), [("µm", 1e-6), ("mm", 1e-3), ("m", 1.0), (None, 1.0)])
def test_a_glb_has_the_size_of_the_surface_and_stands_upright(tmp_path, unit, metres):
    """trimesh reads metres with y upwards; a GLB whose unit is unknown comes back unchanged."""
    hill = voxflat.samples.hill()
    trimesh.Trimesh(hill.points, hill.faces, process=False).export(tmp_path / "hill.glb")
    source = (hill.points, hill.faces.astype(np.int64)) if unit else tmp_path / "hill.glb"
    picture = np.full((8, 8, 3), 255, np.uint8)
    flat = voxflat.surface(source, unit=unit).flatten(voxflat.methods.Voxflat(sources=9))
    for surface in (flat.textured(picture), flat.textured(picture).subdivided()):
        surface.save(tmp_path / "saved.glb", overwrite=True)
        read = trimesh.load(tmp_path / "saved.glb", force="mesh", process=False)
        expected = hill.points if unit is None else metres * hill.points[:, [0, 2, 1]] * [1, 1, -1]
        assert_allclose(np.ptp(read.vertices, axis=0), np.ptp(expected, axis=0), rtol=1e-6)
        assert_allclose(read.bounds, [expected.min(axis=0), expected.max(axis=0)], rtol=1e-6, atol=1e-9 * metres)


@pytest.mark.parametrize(("name", "unit"), [("hill.glb", "m"), ("hill.obj", "mm"), ("scene", None), ("dataset", "µm")])
def test_a_unit_scales_a_glb_but_does_not_turn_meshes_whose_axes_are_not_defined(tmp_path, name, unit):
    hill = voxflat.samples.hill()
    made = trimesh.Trimesh(hill.points, hill.faces, process=False)
    for ending in (".glb", ".obj"):
        made.export(tmp_path / f"hill{ending}")
    objects = {"scene": trimesh.load_scene(tmp_path / "hill.glb", process=False), "dataset": pv.wrap(made)}
    surface = voxflat.surface(objects.get(name, tmp_path / name), unit=unit)
    flat = surface.flatten(voxflat.methods.Voxflat(sources=9))
    flat.textured(np.full((8, 8, 3), 255, np.uint8)).save(tmp_path / "saved.glb")
    read = trimesh.load(tmp_path / "saved.glb", force="mesh", process=False)
    metres = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, None: 1.0}[unit]  # trimesh says that a GLB is in metres
    assert_allclose(read.bounds, metres * made.bounds, rtol=1e-6, atol=1e-9 * metres)


@pytest.mark.medium
@pytest.mark.parametrize(("name", "unit"), [("arrays", "µm"), ("arrays", "m"), ("ball.obj", "cm")])
def test_a_glb_with_seams_belongs_to_its_surface_in_any_unit(tmp_path, name, unit):
    ball = icosphere(20.0, 3)
    trimesh.Trimesh(*ball, process=False).export(tmp_path / "ball.obj")
    surface = voxflat.surface(ball if name == "arrays" else tmp_path / name, unit=unit)
    flat = surface.flatten(Voxflat(sources=30))
    flat.textured(chessboard()).save(tmp_path / "saved.glb")
    saved = voxflat.measure(surface, tmp_path / "saved.glb", sources=10**6).best_scale.relative_error
    own = voxflat.measure(surface, flat, sources=10**6).best_scale.relative_error
    assert saved == pytest.approx(own, rel=1e-4)


def test_maps_and_pages_of_a_mesh_with_unknown_axes_are_not_turned(tmp_path):
    voxflat.samples.hill().save(tmp_path / "hill.obj")
    surface = voxflat.surface(tmp_path / "hill.obj")
    pages = surface.patches(max_angle=20).page().textured()
    for textured in (surface.flatten().textured(np.full((8, 8, 3), 255, np.uint8)), pages):
        textured.save(tmp_path / "hill.glb")
        (read,) = [block for block in pv.read(tmp_path / "hill.glb").recursive_iterator() if block is not None]
        assert np.argmin(np.ptp(read.points, axis=0)) == 2  # the height, as in the file
