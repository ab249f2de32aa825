"""What leaves an atlas: its page, images, heat maps, the inverse look-up, textures; by command and in PyVista, too."""

import json
import struct
import sys

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
from voxflat.io import meshes

pv = pytest.importorskip("pyvista")


@pytest.fixture(scope="module")
def atlas():
    return voxflat.surface(torus()).patches(20)


@pytest.fixture(scope="module")
def of_voxels():
    return voxflat.surface(shapes.ball(9), spacing=(0.5, 0.6, 0.7)).patches(20)


@pytest.fixture(params=["boxes", "shapes"])
def packing(request):
    if request.param == "shapes":
        pytest.importorskip("xatlas")
    return request.param


def overlaps(page):
    """Triangles that lie on others, by the core's exact predicates over all triangles of the page."""
    of = page.atlas
    points = np.empty((len(of.uv), 3))
    points[of.uv_faces] = of.points[of.faces]
    core = voxflat.surface((points, of.uv_faces)).core
    return core.measure(page.uv[core.ids])


@pytest.mark.slow
class TestPage:
    @pytest.mark.parametrize("gap", [0.0, 0.7, None])
    def test_boxes_keep_their_gap(self, atlas, gap):
        page = atlas.page(gap)
        parts = np.split(page.uv, atlas.starts[1:-1])
        low, high = (np.array([getattr(part, side)(axis=0) for part in parts]) for side in ("min", "max"))
        apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
        np.fill_diagonal(apart, np.inf)
        assert apart.min() >= page.gap - 1e-9
        assert_allclose(page.uv.min(axis=0), 0, atol=1e-12)

    def test_a_piece_lies_in_its_smallest_rectangle(self, atlas):
        angles = np.radians(np.arange(0, 90, 0.25))
        for patch, part in zip(atlas, np.split(atlas.layout(), atlas.starts[1:-1]), strict=True):
            ways = np.stack([np.cos(angles), np.sin(angles)])
            sizes = np.ptp(patch.uv @ ways, axis=0) * np.ptp(patch.uv @ np.stack([-ways[1], ways[0]]), axis=0)
            assert np.ptp(part, axis=0).prod() <= sizes.min() * (1 + 1e-9)

    def test_no_triangle_lies_on_another(self, atlas, packing):
        page = atlas.page(packing=packing)
        found = overlaps(page)
        assert found["crossings"] == found["covering"] == 0
        assert not found["is_flipped"].any()
        together = overlaps(type(page)(atlas, page.uv * 0 + atlas.uv, 0.0))  # the check can fail
        assert together["crossings"] > 0

    def test_pieces_are_moved_rigidly(self, atlas, packing):
        page = atlas.page(packing=packing)
        for one, two in zip(np.split(atlas.uv, atlas.starts[1:-1]), np.split(page.uv, atlas.starts[1:-1]), strict=True):
            assert_allclose(np.linalg.norm(one - one[0], axis=1), np.linalg.norm(two - two[0], axis=1), atol=1e-9)
        area = 0.5 * np.abs(np.linalg.det(page.corners[:, 1:] - page.corners[:, :1])).sum()
        assert page.used_share == pytest.approx(area / np.ptp(page.uv, axis=0).prod())
        assert 0.3 < page.used_share < 1

    def test_wrong_arguments_are_named(self, atlas, monkeypatch):
        for gap in (-1, np.nan, np.inf):
            refused("gap is", atlas.page, gap)
        refused("packing is 'tight'", atlas.page, packing="tight")
        refused("of is 'error'. Pass 'isometric'", atlas.heat_map, of="error")
        monkeypatch.setitem(sys.modules, "xatlas", None)
        refused(r"voxflat\[lab\]", atlas.page, 1.234, packing="shapes")


class TestImages:
    @pytest.mark.medium
    def test_a_linear_volume_is_that_at_each_pixels_place(self, atlas):
        affine = np.diag([2.0, 2, 2, 1])
        affine[:3, 3] = -50
        i, j, k = np.indices((51, 51, 51))
        volume = voxflat.io.Volume((i + 2.0 * j - k).astype(float), affine)
        for depth in (0.0, 1.5):
            image = atlas.image(volume, 0.8, depth=depth)
            ids, points = atlas.page().locate(0.8)
            inside = ids >= 0
            assert_array_equal(np.isfinite(image.data), inside)
            expected = ((points[inside] + 50) / 2) @ [1, 2, -1]
            ring = points[inside] * [1, 1, 0]
            tube = points[inside] - 30 * ring / np.linalg.norm(ring, axis=1, keepdims=True)
            outward = tube / np.linalg.norm(tube, axis=1, keepdims=True)
            assert_allclose(image.data[inside], expected + depth / 2 * outward @ [1, 2, -1], atol=1e-4 + 0.1 * depth)

    @pytest.mark.medium
    def test_overlays_and_colours_are_those_of_the_vertices(self, atlas):
        heights = atlas.points[:, 2]
        image = atlas.image(heights, 0.8)
        _, points = atlas.page().locate(0.8)
        assert_allclose(image.data, points[..., 2], atol=1e-5)
        painted = atlas.image(np.tile(np.array([[10, 200, 30]], dtype=np.uint8), (len(heights), 1)), 0.8)
        assert painted.data.shape == (*image.data.shape, 4)
        assert (painted.data[np.isfinite(image.data)] == [10, 200, 30, 255]).all()

    @pytest.mark.medium
    def test_voxels_are_located_and_sampled(self, of_voxels):
        volume = np.indices(shapes.ball(9).shape)[0].astype(float)
        ids, points = of_voxels.page().locate()
        inside = ids[..., 0] >= 0
        assert_allclose(of_voxels.image(volume).data[inside], points[inside][:, 0] / 0.5, atol=1e-5)
        assert np.linalg.norm(points[inside] - ids[inside] * [0.5, 0.6, 0.7], axis=1).max() < 1.5

    def test_triangles_of_pixels_are_those_that_lie_there(self, atlas):
        page = atlas.page()
        triangles, raster = page.face_ids(0.5), page.raster(0.5)
        rows, columns = np.nonzero(triangles >= 0)
        places = np.stack([raster.origin[0] + 0.5 * columns, raster.origin[1] - 0.5 * rows], axis=1)
        a, b, c = (page.corners[triangles[rows, columns], k] - places for k in range(3))
        signed = [one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] for one, two in ((a, b), (b, c), (c, a))]
        assert np.min(signed) > -1e-6
        most, least = atlas.stretch.T
        changes = {"isometric": np.maximum(most, 1 / least), "quasi_conformal": most / least, "areal": most * least}
        for of, values in changes.items():
            heat = atlas.heat_map(0.5, of=of)
            assert_array_equal(np.isfinite(heat.data), triangles >= 0)
            assert_array_equal(heat.data[rows, columns], values[triangles[rows, columns]])
        assert_array_equal(page.label_image(0.5).data[rows, columns], 1 + atlas.piece_ids[triangles[rows, columns]])


class TestLookUp:
    def test_places_lead_to_their_triangles(self, atlas):
        rng = np.random.default_rng(1)
        triangles, weights = rng.integers(0, len(atlas.faces), (50, 40)), rng.dirichlet([1, 1, 1], (50, 40))
        found = atlas.page().look_up(np.einsum("...c,...cx->...x", weights, atlas.page().corners[triangles]))
        assert_array_equal(found.face_ids, triangles)
        assert_array_equal(found.piece_ids, atlas.piece_ids[triangles])
        assert_allclose(found.weights, weights, atol=1e-9)
        assert_allclose(found.points, np.einsum("...c,...cx->...x", weights, atlas.points[atlas.faces[triangles]]))

    def test_beside_the_pieces_there_is_nothing(self, atlas):
        page = atlas.page()
        width, height = page.uv.max(axis=0)
        found = page.look_up([[-1, 1], [width + 1, height / 2], [np.nan, 1], [1, np.inf], [width / 2, -1e300]])
        assert (np.stack([found.face_ids, found.piece_ids]) == -1).all()
        assert np.isnan(np.stack([found.points, found.weights])).all()
        assert page.look_up(np.empty((0, 2))).points.shape == (0, 3)
        assert page.look_up([1.0, 1.0]).points.shape == (3,)
        refused("places has shape", page.look_up, [1.0, 2.0, 3.0])

    def test_a_map_has_it_too(self):
        sheet = voxflat.flatten(shapes.sheet(), method=voxflat.methods.Voxflat(sources=50))
        weights = np.random.default_rng(2).dirichlet([2, 2, 2], len(sheet.faces))
        found = sheet.look_up(np.einsum("fc,fcx->fx", weights, sheet.uv[sheet.faces]))
        known = ~sheet.torn[found.face_ids]
        assert known.any()
        assert (found.piece_ids == 0).all()
        assert_array_equal(found.face_ids, np.arange(len(sheet.faces)))
        assert_allclose(found.points[known], np.einsum("fc,fcx->fx", weights, sheet.points[sheet.faces])[known])


class TestTextures:
    def test_corners_have_the_colour_of_their_place(self, atlas):
        page = atlas.page()
        heights = atlas.points[:, 2]
        surface = page.textured(page.image(heights), limits=(heights.min(), heights.max()))
        assert_array_equal(surface.faces, atlas.faces)
        expected = 255 * (heights - heights.min()) / np.ptp(heights)
        seen = surface.colours[surface.texture_faces][..., 0]
        assert np.abs(seen - expected[atlas.faces]).max() < 24  # in thin tips the nearest pixel is some way off
        assert np.abs(seen - expected[atlas.faces]).mean() < 1.5

    def test_no_seam_shows(self, atlas):
        colours = np.tile(np.array([[250, 200, 150]], dtype=np.uint8), (len(atlas.points), 1))
        assert (atlas.page().textured(atlas.image(colours)).colours == [250, 200, 150]).all()

    def test_an_obj_keeps_the_surfaces_vertices(self, atlas, tmp_path):
        page = atlas.page()
        page.textured().save(tmp_path / "atlas.obj")
        lines = (tmp_path / "atlas.obj").read_text().splitlines()
        assert sum(line.startswith("v ") for line in lines) == len(atlas.points)
        assert sum(line.startswith("vt ") for line in lines) == len(atlas.uv)
        read = meshes.read_mesh(tmp_path / "atlas.obj")
        assert_allclose(read.points, atlas.points, rtol=1e-8)
        assert_array_equal(read.faces, atlas.faces)
        assert (tmp_path / "atlas.mtl").exists()
        with Image.open(tmp_path / "atlas.png") as picture:
            assert picture.size == page.raster().shape[::-1]
        again = voxflat.surface(torus()).patches(20).image(tmp_path / "atlas.obj")  # its texture, across the seams
        own = page.textured().picture
        inside = page.face_ids() >= 0
        assert np.mean(np.abs(again.data[inside][:, :3].astype(int) - own[inside]).max(axis=1) < 8) > 0.9

    @pytest.mark.parametrize("ending", [".vtp", ".glb", ".ply"])
    def test_other_files_double_points_at_seams(self, atlas, tmp_path, ending):
        path = tmp_path / f"atlas{ending}"
        atlas.page().textured(atlas.heat_map(), colour_map="inferno").save(path)
        if ending == ".glb":
            data = path.read_bytes()
            length = struct.unpack("<I", data[12:16])[0]
            accessors = json.loads(data[20 : 20 + length])["accessors"]
            assert [accessor["count"] for accessor in accessors] == [len(atlas.uv), len(atlas.uv), atlas.faces.size]
        else:
            read = meshes.read_mesh(path)
            assert_array_equal(read.faces, atlas.uv_faces)
            assert_allclose(read.points[read.faces], atlas.points[atlas.faces], rtol=1e-6)

    def test_colours_of_values(self, atlas):
        image, page = atlas.heat_map(), atlas.page()
        refused("colour_map is 'rainbows'", page.textured, image, colour_map="rainbows")
        grey, warm = page.textured(image).picture, page.textured(image, colour_map="inferno").picture
        assert (grey[..., 0] == grey[..., 1]).all()
        assert (warm[..., 0] != warm[..., 2]).any()
        refused("does not belong to this page", atlas.page(30.0).textured, image)

    @pytest.mark.medium
    @pytest.mark.parametrize("bound", [None, 1.5])
    def test_a_patch_has_one_colour_wherever_it_is_shown(self, atlas, bound, tmp_path, monkeypatch):
        shown = atlas if bound is None else atlas.glue(bound)
        page = shown.page()
        page.label_image().save(tmp_path / "labels.png")
        pixels, triangles = np.asarray(Image.open(tmp_path / "labels.png")), page.face_ids()
        in_file = np.zeros((len(shown.faces), 3), dtype=int)
        in_file[triangles[triangles >= 0]] = pixels[triangles >= 0, :3]
        seen = np.unique(triangles[triangles >= 0])
        assert len(np.unique(in_file[seen], axis=0)) == len(np.unique(shown.patch_ids[seen]))

        textured = page.textured()
        s, t = textured.texture_coordinates[textured.texture_faces].mean(axis=1).T
        height, width = textured.picture.shape[:2]
        texels = textured.picture[((1 - t) * height).astype(int), (s * width).astype(int)]
        assert (texels[seen] == in_file[seen]).all(axis=1).mean() > 0.95  # a pixel of the border may be another's

        drawn = figures.atlas_page(shown).axes[0].collections[0].get_facecolor()
        assert_array_equal(np.round(255 * drawn[seen, :3]).astype(int), in_file[seen])

        monkeypatch.setitem(sys.modules, "pyvista", None)
        monkeypatch.setattr("voxflat.figures.views_3d._by_matplotlib", lambda atlas, colours, *view: colours)
        assert_array_equal(figures.atlas_3d(shown)[seen], in_file[seen])


class TestCommand:
    @pytest.fixture
    def mesh(self, tmp_path):
        voxflat.surface(torus(20)).save(tmp_path / "torus.obj")
        return tmp_path / "torus.obj"

    @pytest.fixture
    def overlay(self, tmp_path):
        mesh = pv.PolyData.from_regular_faces(*torus(20))
        mesh.point_data["rgb"] = np.full((mesh.n_points, 3), [200, 100, 50], dtype=np.uint8)
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

    @pytest.mark.medium
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
        fail(1, "torus.obj: the map is not flat", "image", mesh, "--heat-map", "-o", tmp_path / "x.png")

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

    @pytest.mark.medium
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
        s, t = page.active_texture_coordinates.T
        left, right, bottom, top = image.extent
        assert_allclose(left + s * (right - left), page.points[:, 0], atol=1e-4)
        assert_allclose(bottom + t * (top - bottom), page.points[:, 1], atol=1e-4)
        assert_allclose((top - bottom, right - left), np.multiply(image.data.shape, image.pixel_size), rtol=1e-6)

    def test_the_page_of_an_image(self):
        ball = shapes.ball(8)
        image = pv.ImageData(dimensions=ball.shape, spacing=(0.5, 0.5, 0.5))
        image["labels"] = ball.astype(np.uint8).ravel(order="F")
        page = image.voxflat.patches(bound=1.3, label=1)
        assert page.point_data["voxel_ids"].shape == (page.n_points, 3)
        assert page.cell_data["isometric"].max() <= 1.3
        refused("Omit scalars", page.voxflat.patches, scalars="labels")
