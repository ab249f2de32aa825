import errno
import json
import os
import struct
import sys
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import voxflat
from voxflat import InputError, TexturedSurface, cli
from voxflat.io.meshes import read_mesh

needs_window = pytest.mark.skipif(
    sys.platform == "linux" and "DISPLAY" not in os.environ and pv.vtk_version_info < (9, 4),
    reason="this VTK draws only with a display",
)


def chessboard(squares=8, texels=8, shape=None):
    """Draw a chessboard; its upper left square is white."""
    rows, columns = shape or (squares, squares)
    grey = np.indices((rows, columns)).sum(axis=0) % 2 == 0
    return np.repeat(np.repeat(np.where(grey, 255, 0).astype(np.uint8), texels, axis=0), texels, axis=1)


def grid(rows, columns, step=1.0):
    """Triangulate a rectangle in the plane z = 0."""
    y, x = np.mgrid[:rows, :columns] * step
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + columns])
    upper = np.column_stack([corner + 1, corner + columns + 1, corner + columns])
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), np.concatenate([lower, upper])


def cylinder(rows=25, columns=41, radius=10.0):
    """Bend a rectangle of 24 x 40 mm into two thirds of a cylinder; triangles stay nearly as they are."""
    points, faces = grid(rows, columns)
    angle = points[:, 0] / radius
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 1]]), faces


@pytest.fixture(scope="module")
def plane_map():
    points, faces = grid(13, 21)
    return replace(voxflat.flatten((points, faces), sources=100), uv=points[:, :2])  # to be exact


@pytest.fixture(scope="module")
def cylinder_map():
    return voxflat.flatten(cylinder(), sources=300)


@pytest.fixture
def textured(cylinder_map):
    return cylinder_map.textured(chessboard())


def areas(points, faces):
    a, b, c = points[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def side_counts(faces):
    """Count the triangles at each side."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)


class TestPlacing:
    @pytest.mark.parametrize("shape", [(64, 64), (30, 90), (90, 30), (1, 1)])
    def test_the_picture_just_covers_the_map_in_its_proportions(self, cylinder_map, shape):
        textured = cylinder_map.textured(np.zeros(shape, dtype=np.uint8))
        texels = textured.texture_coordinates * [shape[1], shape[0]]
        # a similarity: all distances in the picture are those on the map by one factor
        uv = cylinder_map.uv - cylinder_map.uv.mean(axis=0)
        factor = np.linalg.norm(np.ptp(texels, axis=0)) / np.linalg.norm(np.ptp(uv, axis=0))
        np.testing.assert_allclose(texels - texels.mean(axis=0), factor * uv, atol=1e-9 * max(shape))
        low, high = textured.texture_coordinates.min(axis=0), textured.texture_coordinates.max(axis=0)
        np.testing.assert_allclose((low + high) / 2, 0.5)
        np.testing.assert_allclose((high - low).max(), 1)

    def test_on_a_plane_it_is_a_similarity_of_space(self, plane_map):
        textured = plane_map.textured(chessboard(), texel_size=0.5)
        points, texels = textured.points, 64 * textured.texture_coordinates
        in_space = np.linalg.norm(points[:, None] - points, axis=2)
        in_picture = np.linalg.norm(texels[:, None] - texels, axis=2)
        np.testing.assert_allclose(0.5 * in_picture, in_space, atol=1e-12)

    def test_a_texel_has_the_size_that_is_asked_for(self, cylinder_map):
        textured = cylinder_map.textured(chessboard(), texel_size=0.25, repeat=True)
        moved = 0.25 * 64 * textured.texture_coordinates - cylinder_map.uv
        np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-9)
        assert textured.texture_coordinates.max() > 1

    def test_a_picture_that_is_too_small_must_be_repeated(self, cylinder_map):
        with pytest.raises(
            InputError, match=r"16 x 16 mm and does not cover the map; give repeat, or .* least (\S+) mm"
        ) as told:
            cylinder_map.textured(chessboard(), texel_size=0.25)
        enough = float(str(told.value).split()[-2])
        assert np.abs(cylinder_map.textured(chessboard(), enough).texture_coordinates - 0.5).max() <= 0.5
        with pytest.raises(InputError, match="does not cover"):
            cylinder_map.textured(chessboard(), 0.999 * enough)

    def test_a_repeated_picture_goes_on(self, cylinder_map):
        once = cylinder_map.textured(chessboard(), texel_size=0.25, repeat=True)
        tiled = cylinder_map.textured(np.tile(chessboard(), (5, 5)), texel_size=0.25)
        np.testing.assert_array_equal(once.colours, tiled.colours)

    def test_colours_are_those_of_texture(self, cylinder_map):
        picture = np.random.default_rng(0).integers(0, 256, (20, 33, 4), dtype=np.uint8)
        np.testing.assert_array_equal(cylinder_map.textured(picture).colours, cylinder_map.texture(picture))

    def test_torn_triangles_are_left_out(self):
        flat_map = voxflat.flatten(np.ones((9, 9, 1), int), method="grossmann2002", sources=81)
        torn = np.arange(len(flat_map.faces)) % 7 == 0
        object.__setattr__(flat_map, "torn", torn)
        np.testing.assert_array_equal(flat_map.textured(chessboard()).faces, flat_map.faces[~torn])

    def test_squares_of_a_chessboard_have_equal_area_on_a_cylinder(self, cylinder_map):
        """Each inner square, 2 x 2 mm on the map, covers that area of the surface, to the map's areal error."""
        textured = cylinder_map.textured(chessboard(12, 16), texel_size=2 / 16, repeat=True).subdivided()
        ratio = (
            areas(cylinder_map.points, cylinder_map.faces).sum()
            / areas(np.column_stack([cylinder_map.uv, 0 * cylinder_map.uv[:, 0]]), cylinder_map.faces).sum()
        )
        places = textured.texture_coordinates[textured.faces].mean(axis=1) * 12  # in squares
        inner = np.abs((places - 6) * 2 * [1, 1]).max(axis=1) < 9  # within 18 x 18 mm around the map's centre
        square = np.floor(places).astype(int)[inner]
        keys, which = np.unique(square, axis=0, return_inverse=True)
        found = np.bincount(which.ravel(), areas(textured.points, textured.faces)[inner])
        whole = (np.abs((keys + 0.5 - 6) * 2).max(axis=1)) < 8
        assert whole.sum() == 64
        areal = cylinder_map.distortion.triangles.areal
        worst = 2 ** np.abs(areal - np.median(areal)).max() - 1
        # triangles of at most a texel lie on both sides of a border: they blur it by less than a texel a side
        np.testing.assert_allclose(found[whole] / ratio, 4, rtol=worst + 4 / 16 / 4)
        np.testing.assert_allclose(found[whole].mean() / ratio, 4, rtol=0.02)


class TestPictures:
    @pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr"])
    def test_grey_and_colours_with_opacity_or_not(self, cylinder_map, tmp_path, mode):
        image = Image.fromarray(chessboard()).convert("RGBA" if mode == "LA" else "RGB").convert(mode)
        colours = cylinder_map.textured(image).picture
        assert colours.shape == (64, 64, 4 if "A" in mode else 3)
        np.testing.assert_array_equal(colours[..., :3], np.repeat(chessboard()[..., None], 3, axis=2))
        if mode not in ("CMYK", "YCbCr"):
            image.save(tmp_path / "picture.png")
            textured = cylinder_map.textured(tmp_path / "picture.png")
            np.testing.assert_array_equal(textured.picture, colours)
            assert textured.source == tmp_path / "picture.png"

    @pytest.mark.parametrize("picture", [chessboard() > 0, chessboard() / 255, (chessboard() / 255).astype(np.float32)])
    def test_arrays_of_bool_and_of_floats(self, cylinder_map, picture):
        np.testing.assert_array_equal(cylinder_map.textured(picture).picture[..., 0], chessboard())

    def test_deep_grey(self, cylinder_map, tmp_path):
        Image.fromarray(chessboard().astype(np.uint16) * 257).save(tmp_path / "deep.png")
        np.testing.assert_array_equal(cylinder_map.textured(tmp_path / "deep.png").picture[..., 1], chessboard())

    def test_photographs_are_turned_upright(self, cylinder_map, tmp_path):
        image = Image.fromarray(np.zeros((20, 30), dtype=np.uint8))
        exif = Image.Exif()
        exif[0x0112] = 6
        image.save(tmp_path / "photo.jpg", exif=exif)
        assert cylinder_map.textured(tmp_path / "photo.jpg").picture.shape == (30, 20, 3)

    @pytest.mark.parametrize(
        ("picture", "told"),
        [
            (np.full((4, 4), np.nan), "values reach from nan to nan; floats must lie from 0 to 1, without NaN"),
            (np.array([[0.0, 255.0]]), "values reach from 0 to 255; floats must lie from 0 to 1"),
            (np.zeros((4, 4), dtype=int), "type int64; give uint8, 0 to 255, or floats from 0 to 1"),
            (np.zeros((4, 4, 2)), r"shape \(4, 4, 2\); give \(H, W\), \(H, W, 3\) or \(H, W, 4\)"),
            (np.zeros((0, 4)), r"shape \(0, 4\)"),
            (np.zeros(4), r"shape \(4,\)"),
            (None, "type object"),
            (Image.new("F", (4, 4)), "more than 8 bits"),
        ],
    )
    def test_what_is_no_picture(self, cylinder_map, picture, told):
        with pytest.raises(InputError, match=told):
            cylinder_map.textured(picture)

    def test_files_that_are_no_picture(self, cylinder_map, tmp_path):
        with pytest.raises(FileNotFoundError):
            cylinder_map.textured(tmp_path / "missing.png")
        Image.fromarray(chessboard()).save(tmp_path / "whole.png")
        whole = (tmp_path / "whole.png").read_bytes()
        for damaged in (b"", b"text", whole[:60], whole[:-30]):
            (tmp_path / "bad.png").write_bytes(damaged)
            with pytest.raises(InputError, match=r"bad.png: .*is the file complete"):
                cylinder_map.textured(tmp_path / "bad.png")
        with pytest.raises(InputError, match="is the file complete"):
            cylinder_map.textured(tmp_path)

    @pytest.mark.parametrize("size", [0, -1, np.nan, np.inf])
    def test_texel_sizes(self, cylinder_map, size):
        with pytest.raises(InputError, match=r"texel size is .* mm; give a positive number"):
            cylinder_map.textured(chessboard(), size, repeat=True)


class TestSubdivision:
    def flat(self, picture, rows=3, columns=3, step=4.0, repeat=False):
        points, faces = grid(rows, columns, step)
        return TexturedSurface(points, faces, points[:, :2] / points[:, :2].max(), picture, repeat)

    def test_nothing_is_split_where_colours_carry_the_picture(self):
        even = np.full((64, 64, 3), 90, dtype=np.uint8)
        assert len(self.flat(even).subdivided().faces) == 8
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

    @given(st.integers(0, 2**32 - 1), st.sampled_from([4.0, 16.0, 100.0]), st.booleans())
    def test_the_surface_stays_and_carries_the_picture(self, seed, tolerance, repeat):
        rng = np.random.default_rng(seed)
        points, faces = grid(4, 5)
        coordinates = (points[:, :2] + rng.uniform(-0.2, 0.2, (20, 2))) / 5 * (2 if repeat else 1)
        points = points + rng.normal(size=points.shape)
        picture = np.kron(rng.integers(0, 256, (5, 6, 3)), np.ones((4, 4, 1))).astype(np.uint8)
        before = TexturedSurface(points, faces, coordinates, picture, repeat)
        after = before.subdivided(tolerance)
        n = len(points)
        np.testing.assert_array_equal(after.points[:n], points)
        np.testing.assert_array_equal(after.texture_coordinates[:n], coordinates)
        # no cracks: every side has two triangles but those of the boundary, which is as long as before; one disk
        sides, counts = side_counts(after.faces)
        sides_before, counts_before = side_counts(faces)
        assert counts.max() == 2
        length = lambda p, s: np.linalg.norm(p[s[:, 0]] - p[s[:, 1]], axis=1).sum()  # noqa: E731
        np.testing.assert_allclose(
            length(after.points, sides[counts == 1]), length(points, sides_before[counts_before == 1])
        )
        assert len(after.points) - len(sides) + len(after.faces) == 1
        # the same shape: area and volume below it, and each triangle's way round
        np.testing.assert_allclose(areas(after.points, after.faces).sum(), areas(points, faces).sum())
        a, b, c = after.texture_coordinates[after.faces].transpose(1, 2, 0)
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert (turn > 0).all()
        # halfway along the sides of triangles longer than a texel; colours are rounded
        corners = after.texture_coordinates[after.faces]
        ahead = np.roll(corners, -1, axis=1)
        is_long = np.linalg.norm((ahead - corners) * picture.shape[1::-1], axis=2).max(axis=1) > 1
        colours = after.colours.astype(float)[after.faces]
        true = replace(after, texture_coordinates=((corners + ahead) / 2).reshape(-1, 2)).colours.reshape(-1, 3)
        off = np.abs((colours + np.roll(colours, -1, axis=1)).reshape(-1, 3) / 2 - true)
        assert off[np.repeat(is_long, 3)].max(initial=0) <= tolerance + 1

    def test_a_chessboard_is_carried_by_colours(self, textured):
        after = textured.subdivided()
        middles = after.texture_coordinates[after.faces].mean(axis=1)
        seen = after.colours[after.faces].mean(axis=1)
        true = TexturedSurface(after.points, after.faces, middles, after.picture).colours
        before = np.abs(
            textured.colours[textured.faces].mean(axis=1)
            - TexturedSurface(
                textured.points,
                textured.faces,
                textured.texture_coordinates[textured.faces].mean(axis=1),
                textured.picture,
            ).colours
        )
        area = areas(after.points, after.faces)[:, None]
        error = (np.abs(seen - true) * area).sum() / (3 * area.sum())
        assert error < 6
        assert before.mean() > 7 * error

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
        with pytest.raises(InputError, match=r"tolerance is .*; give a positive number"):
            textured.subdivided(tolerance)

    def test_too_fine_a_picture_is_refused(self, textured, monkeypatch):
        monkeypatch.setattr("voxflat.maps.subdivision._MOST_FACES", 5000)
        with pytest.raises(InputError, match=r"64 x 64 texels need more than 5000 triangles; give a greater tolerance"):
            textured.subdivided()


class TestFiles:
    def test_obj(self, textured, tmp_path):
        textured.save(tmp_path / "a face.obj")
        assert sorted(file.name for file in tmp_path.iterdir()) == ["a face.obj", "a_face.mtl", "a_face.png"]
        own, vtk = read_mesh(tmp_path / "a face.obj"), pv.read(tmp_path / "a face.obj")
        for points, faces, coordinates in (
            (own.points, own.faces, own.texture_coordinates),
            (vtk.points, vtk.regular_faces, vtk.active_texture_coordinates),
        ):
            np.testing.assert_allclose(points[faces], textured.points[textured.faces], atol=1e-5)
            np.testing.assert_allclose(
                coordinates[faces], textured.texture_coordinates[textured.faces], rtol=1e-6, atol=1e-6
            )
        assert "mtllib a_face.mtl\n" in (tmp_path / "a face.obj").read_text()
        assert (tmp_path / "a_face.mtl").read_text().endswith("map_Kd a_face.png\n")
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a_face.png")), textured.picture)

    @needs_window
    def test_vtk_imports_the_obj_with_its_picture(self, textured, tmp_path):
        textured.save(tmp_path / "face.obj")
        plotter = pv.Plotter(off_screen=True)
        plotter.import_obj(tmp_path / "face.obj", tmp_path / "face.mtl")
        seen = [actor for actor in plotter.actors.values() if actor.GetMapper().GetInput().GetNumberOfCells()]
        (actor,) = seen
        actor.GetTexture().GetInputAlgorithm().Update()
        assert pv.wrap(actor.GetTexture().GetInput()).dimensions == (64, 64, 1)
        plotter.close()

    def test_vtp(self, textured, tmp_path):
        textured.save(tmp_path / "face.vtp")
        read = pv.read(tmp_path / "face.vtp")
        np.testing.assert_array_equal(read.points, textured.points)
        np.testing.assert_array_equal(read.regular_faces, textured.faces)
        np.testing.assert_array_equal(read.active_texture_coordinates, textured.texture_coordinates)
        np.testing.assert_array_equal(pv.read_texture(tmp_path / "face.png").to_array(), textured.picture)

    def test_glb(self, textured, tmp_path):
        textured.save(tmp_path / "face.glb")
        (read,) = [block for block in pv.read(tmp_path / "face.glb").recursive_iterator() if block is not None]
        metres = 1e-3 * textured.points[:, [0, 2, 1]] * [1, 1, -1]  # y is up
        faces = read.extract_surface(algorithm=None).triangulate().regular_faces
        np.testing.assert_array_equal(faces, textured.faces)
        np.testing.assert_allclose(read.points, metres, atol=1e-7)
        s, t = textured.texture_coordinates.T
        np.testing.assert_allclose(read.active_texture_coordinates, np.column_stack([s, 1 - t]), atol=1e-6)
        data = (tmp_path / "face.glb").read_bytes()
        assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
        length = struct.unpack_from("<I", data, 12)[0]
        view = json.loads(data[20 : 20 + length])["bufferViews"][3]
        (tmp_path / "inside.png").write_bytes(data[28 + length + view["byteOffset"] :][: view["byteLength"]])
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "inside.png")), textured.picture)

    @needs_window
    def test_vtk_draws_the_glb_with_its_picture_upright(self, plane_map, tmp_path):
        """The upper half of the picture is red: on the map's upper half the surface must be red, too."""
        picture = np.zeros((40, 40, 3), dtype=np.uint8)
        picture[:20, :, 0] = 255
        picture[20:, :, 2] = 255
        plane_map.textured(picture).save(tmp_path / "plane.glb")
        plotter = pv.Plotter(off_screen=True, window_size=[200, 200], lighting="none")
        plotter.import_gltf(tmp_path / "plane.glb")
        top, bottom = (
            plane_map.points[plane_map.uv[:, 1].argmax()],
            plane_map.points[plane_map.uv[:, 1].argmin()],
        )
        plotter.add_light(pv.Light(light_type="headlight"))
        plotter.view_vector((0, 1, 0), (0, 0, -1))
        plotter.reset_camera()
        drawn = plotter.screenshot(return_img=True).astype(int)
        plotter.close()
        red, blue = drawn[..., 0] > drawn[..., 2] + 80, drawn[..., 2] > drawn[..., 0] + 80
        assert min(red.sum(), blue.sum()) > 500
        # seen along −y of glTF with −z up: columns grow with x of space, rows downwards with −y of space
        rows = np.array([np.argwhere(red).mean(axis=0), np.argwhere(blue).mean(axis=0)])
        towards = (top - bottom)[:2] * [1, -1]
        seen = (rows[0] - rows[1])[::-1]
        assert seen @ towards > 0.9 * np.linalg.norm(seen) * np.linalg.norm(towards)

    def test_ply_has_colours(self, textured, tmp_path):
        fine = textured.subdivided()
        fine.save(tmp_path / "face.ply")
        read = pv.read(tmp_path / "face.ply")
        np.testing.assert_allclose(read.points, fine.points, atol=1e-5)
        np.testing.assert_array_equal(read.regular_faces, fine.faces)
        np.testing.assert_array_equal(read.point_data["RGB"], fine.colours)
        own = read_mesh(tmp_path / "face.ply").point_data
        np.testing.assert_array_equal(np.column_stack([own["red"], own["green"], own["blue"]]), fine.colours)

    def test_opacity(self, cylinder_map, tmp_path):
        picture = np.dstack([chessboard()] * 3 + [255 - chessboard()])
        textured = cylinder_map.textured(picture, texel_size=0.1, repeat=True)
        for name in ("face.obj", "face.glb", "face.ply"):
            textured.save(tmp_path / name)
        material = (tmp_path / "face.mtl").read_text()
        assert material.endswith("map_Kd face.png\nmap_d face.png\n")
        assert np.asarray(Image.open(tmp_path / "face.png")).shape == (64, 64, 4)
        assert b'"alphaMode": "BLEND"' in (tmp_path / "face.glb").read_bytes()
        assert b"10497" in (tmp_path / "face.glb").read_bytes()
        np.testing.assert_array_equal(read_mesh(tmp_path / "face.ply").point_data["alpha"], textured.colours[:, 3])

    def test_nothing_is_half_written(self, textured, tmp_path, monkeypatch):
        def fails(*_):
            raise OSError(errno.ENOSPC, "the disk is full")

        for name in ("face.obj", "face.mtl", "face.png"):
            (tmp_path / name).write_text("old")
        monkeypatch.setattr("voxflat.maps.texture._png", fails)
        for name in ("face.obj", "face.vtp", "face.glb"):
            with pytest.raises(OSError, match="the disk is full") as told:
                textured.save(tmp_path / name)
            assert told.value.filename == str(tmp_path / name)
        assert {file.name: file.read_text() for file in tmp_path.iterdir()} == dict.fromkeys(
            ("face.obj", "face.mtl", "face.png"), "old"
        )

    def test_what_cannot_be_written(self, textured, cylinder_map, tmp_path):
        with pytest.raises(InputError, match=r"ending '.stl' is unknown; .obj, .vtp, .glb, .ply can be written"):
            textured.save(tmp_path / "face.stl")
        with pytest.raises(FileNotFoundError, match=r"face\.obj"):
            textured.save(tmp_path / "missing" / "face.obj")
        (tmp_path / "face.png").mkdir()
        with pytest.raises(IsADirectoryError, match=r"face\.png"):
            textured.save(tmp_path / "face.obj")
        assert [file.name for file in tmp_path.iterdir()] == ["face.png"]
        Image.fromarray(chessboard()).save(tmp_path / "chess.png")
        before = (tmp_path / "chess.png").read_bytes()
        with pytest.raises(InputError, match=r"chess.png is the picture itself; choose another name"):
            cylinder_map.textured(tmp_path / "chess.png").save(tmp_path / "chess.obj")
        assert (tmp_path / "chess.png").read_bytes() == before


class TestCommand:
    @pytest.fixture
    def run(self, cylinder_map, tmp_path):
        cylinder_map.save(tmp_path / "map.npz")
        Image.fromarray(chessboard()).save(tmp_path / "chess.png")

        def run(*options):
            arguments = ["texture", tmp_path / "map.npz", tmp_path / "chess.png", *options]
            return CliRunner().invoke(cli.main, [str(argument) for argument in arguments])

        return run

    @pytest.mark.parametrize("ending", [".obj", ".vtp", ".glb", ".ply"])
    def test_it_writes_what_python_writes(self, run, cylinder_map, tmp_path, ending):
        result = run("--texel-size", 0.25, "--repeat", "-o", tmp_path / f"cli{ending}")
        assert result.exit_code == 0, result.output
        textured = cylinder_map.textured(chessboard(), 0.25, repeat=True)
        if ending == ".ply":
            textured = textured.subdivided()
        assert f"{len(textured.points)} points, {len(textured.faces)} triangles" in result.output
        (tmp_path / "python").mkdir()
        textured.save(tmp_path / "python" / f"cli{ending}")
        for file in (tmp_path / "python").iterdir():
            assert (tmp_path / file.name).read_bytes() == file.read_bytes(), file.name

    def test_refusals(self, run, tmp_path):
        for options, told in (
            (["-o", tmp_path / "chess.obj"], "chess.png is the picture itself; choose another name"),
            (["-o", tmp_path / "face.stl"], "its name must end in .obj or .vtp or .glb or .ply"),
            (["--texel-size", 0.1, "-o", tmp_path / "face.obj"], "does not cover the map; give repeat"),
        ):
            result = run(*options)
            assert result.exit_code == 1
            assert told in result.output
            assert len(result.output.splitlines()) == 1
        assert sorted(file.name for file in tmp_path.iterdir()) == ["chess.png", "map.npz"]
