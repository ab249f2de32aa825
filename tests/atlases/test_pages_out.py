"""Atlases on the command line and in PyVista."""

import json

import numpy as np
import pytest
import shapes
from command_line import fail, succeed
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused
from triangle_meshes import torus

import voxflat
from voxflat import figures

pv = pytest.importorskip("pyvista")


class TestCommand:
    @pytest.fixture
    def mesh(self, tmp_path):
        voxflat.surface(torus(20)).save(tmp_path / "torus.obj")
        return tmp_path / "torus.obj"

    @pytest.fixture
    def overlay(self, tmp_path):
        points, faces = torus(20)
        mesh = pv.PolyData.from_regular_faces(points, faces)
        mesh.point_data["rgb"] = np.full((len(points), 3), [200, 100, 50], dtype=np.uint8)
        mesh.save(tmp_path / "coloured.vtp")
        return tmp_path / "coloured.vtp"

    def test_what_the_texture_shows(self, mesh, overlay, tmp_path):
        pictures = []
        for options in ((), ("--heat-map",), ("--volume", overlay)):
            succeed("patches", mesh, "--max-angle", 30, "-o", tmp_path / "atlas.obj", *options)
            with Image.open(tmp_path / "atlas.png") as picture:
                pictures.append(np.asarray(picture))
        assert pictures[0].shape == pictures[1].shape
        assert (pictures[0] != pictures[1]).any()
        assert (pictures[2] == [200, 100, 50]).all()

    def test_images_of_a_saved_atlas(self, mesh, overlay, tmp_path):
        atlas = tmp_path / "atlas.npz"
        succeed("patches", mesh, "--max-angle", 30, "-o", atlas)
        succeed("image", atlas, "--volume", overlay, "-o", tmp_path / "page.png")
        succeed("image", atlas, "--heat-map", "-o", tmp_path / "heat.png")
        succeed("image", atlas, "--heat-map", "--pixel-size", 0.5, "-o", tmp_path / "heat.npy")
        assert_array_equal(np.load(tmp_path / "heat.npy"), voxflat.FlatAtlas.load(atlas).heat_map(0.5).data)

    @pytest.mark.slow
    def test_it_writes_the_atlas_and_pictures(self, mesh, tmp_path):
        out, page, picture = (tmp_path / name for name in ("atlas.npz", "page.png", "torus.png"))
        result = succeed("patches", mesh, "-o", out, "--max-angle", 5, "--page", page, "--picture", picture)
        assert "1.0875" in result.output
        assert voxflat.FlatAtlas.load(out).certificate.angle == 5
        assert page.exists()
        assert picture.exists()
        glued, page = tmp_path / "glued.npz", tmp_path / "glued.png"
        result = succeed("patches", mesh, "-o", glued, "--glue", 1.2, "--page", page)
        loaded = voxflat.load_atlas(glued)
        assert loaded.bound == 1.2
        assert loaded.table() in result.output
        assert page.exists()

    def test_json(self, mesh, tmp_path):
        out = tmp_path / "atlas.npz"
        options = ["--bound", 1.2, "--seeds", "random", "--seed", 3]
        told = json.loads(succeed("patches", mesh, "-o", out, *options, "--json").stdout)
        assert told["certificate"]["c"] == 1.2
        assert told["patches"] == len(voxflat.FlatAtlas.load(out))
        assert told["metadata"]["seed"] == 3
        told = json.loads(succeed("patches", mesh, "-o", out, "--glue", 1.2, "--json").stdout)
        assert told["bound"] == 1.2
        assert told["seams"]["closed"] <= told["seams"]["length"]

    def test_errors_are_one_line(self, mesh, tmp_path):
        out = tmp_path / "atlas.npz"
        for arguments, message in (
            ((mesh, "-o", tmp_path / "atlas.stl"), "ends in .npz or .voxflat or .obj"),
            ((mesh, "-o", out, "--max-angle", 10, "--count", 5), "--max-angle and --count cannot be combined"),
            ((mesh, "-o", out, "--max-angle", 95), "the angle is 95°"),
            ((mesh, "-o", out, "--glue", 0.5), "a bound of 0.5"),
            ((mesh, "-o", out, "--picture", tmp_path / "torus.pdf"), "ends in .png"),
            ((tmp_path / "nowhere.obj", "-o", out), "nowhere.obj"),
        ):
            assert fail(1, message, "patches", *arguments).stderr.count("\n") == 1
        assert not out.exists()

    def test_options_that_do_not_fit_are_refused_before_the_work(self, mesh, tmp_path):
        for name, options, message in (
            ("atlas.npz", ("--heat-map",), "--heat-map"),
            ("atlas.npz", ("--pixel-size", 1), "--pixel-size"),
            ("atlas.obj", ("--heat-map", "--volume", mesh), "either --volume or --heat-map"),
            ("atlas.obj", ("--depth", 1), "--depth requires --volume"),
        ):
            fail(2, message, "patches", mesh, "-o", tmp_path / name, *options)
            assert not (tmp_path / name).exists()
        fail(1, "is not a flat map", "image", mesh, "--heat-map", "-o", tmp_path / "x.png")

    @pytest.mark.slow
    def test_the_heat_map_is_a_figure(self, tmp_path):
        atlas = voxflat.surface(torus(20)).patches(30)
        for of in ("isometric", "quasi_conformal", "areal"):
            figures.save(figures.atlas_heat_map(atlas, of=of), tmp_path / f"{of}.png")
            assert (tmp_path / f"{of}.png").stat().st_size > 10_000


class TestPyVista:
    def test_the_page_of_a_mesh(self):
        points, faces = torus(20)
        order = np.random.default_rng(5).permutation(len(faces))
        mesh = pv.PolyData.from_regular_faces(points, np.roll(faces[order], 1, axis=1))
        mesh.point_data["height"] = points[:, 2]
        page = mesh.voxflat.patches(max_angle=20)
        atlas = voxflat.surface((points, faces)).patches(20)
        assert_array_equal(page.cell_data["patch"], atlas.piece_ids[order])
        assert_allclose(page.cell_data["isometric"], atlas.isometric[order], rtol=1e-9)
        assert page.n_cells == mesh.n_cells
        assert not mesh.cell_data.keys()  # it stays as it is
        assert set(page.cell_data.keys()) == {"patch", "piece", "isometric", "quasi_conformal", "areal"}
        assert (page.points[:, 2] == 0).all()
        corners = page.regular_faces
        assert_array_equal(np.sort(page.point_data["vertex_ids"][corners]), np.sort(mesh.regular_faces))
        assert_array_equal(page.point_data["height"], points[page.point_data["vertex_ids"], 2])
        assert_array_equal(page.point_data["surface_points"], points[page.point_data["vertex_ids"]])
        ratio = page.compute_cell_sizes()["Area"] / mesh.compute_cell_sizes()["Area"]
        assert_allclose(np.log2(ratio), page.cell_data["areal"], atol=1e-4)
        assert json.loads(page.field_data["voxflat"][0])["method"] == "saucan2006"

    def test_the_page_of_glued_patches(self):
        mesh = pv.PolyData.from_regular_faces(*torus(20))
        page = mesh.voxflat.patches(max_angle=20, glue=1.6)
        glued = voxflat.surface(mesh).patches(20).glue(1.6)
        assert_array_equal(page.cell_data["patch"], glued.patch_ids)
        assert_array_equal(page.cell_data["piece"], glued.piece_ids)
        assert page.n_points == len(glued.uv)
        assert page.cell_data["isometric"].max() <= 1.6

    def test_texture_coordinates_are_those_of_the_image(self):
        mesh = pv.PolyData.from_regular_faces(*torus(20))
        atlas = voxflat.surface(mesh).patches(20)
        page = mesh.voxflat.to_page_polydata(atlas)
        image = atlas.image(atlas.points[:, 0])
        height, width = image.data.shape
        s, t = page.active_texture_coordinates.T
        left, right, bottom, top = image.extent
        assert_allclose(left + s * (right - left), page.points[:, 0], atol=1e-4)
        assert_allclose(bottom + t * (top - bottom), page.points[:, 1], atol=1e-4)
        assert right - left == pytest.approx(width * image.pixel_size)
        assert top - bottom == pytest.approx(height * image.pixel_size)

    def test_the_page_of_an_image(self):
        ball = shapes.ball(8)
        image = pv.ImageData(dimensions=ball.shape, spacing=(0.5, 0.5, 0.5))
        image["labels"] = ball.astype(np.uint8).ravel(order="F")
        page = image.voxflat.patches(bound=1.3, label=1)
        assert page.point_data["voxel_ids"].shape == (page.n_points, 3)
        assert page.cell_data["isometric"].max() <= 1.3
        refused("Omit scalars", page.voxflat.patches, scalars="labels")
