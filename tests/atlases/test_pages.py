"""What leaves an atlas: its page without overlaps, images, heat maps, the inverse look-up, textures."""

import json
import struct
import sys

import numpy as np
import pytest
import shapes
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
    uv = np.empty_like(page.uv)
    uv[np.arange(len(uv))] = page.uv[core.ids]
    return core.measure(uv)


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
        refused("of is 'error'. Give 'isometric'", atlas.heat_map, of="error")
        monkeypatch.setitem(sys.modules, "xatlas", None)
        refused(r"voxflat\[lab\]", atlas.page, 1.234, packing="shapes")


class TestImages:
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

    def test_overlays_and_colours_are_those_of_the_vertices(self, atlas):
        heights = atlas.points[:, 2]
        image = atlas.image(heights, 0.8)
        _, points = atlas.page().locate(0.8)
        assert_allclose(image.data, points[..., 2], atol=1e-5)
        painted = atlas.image(np.tile(np.array([[10, 200, 30]], dtype=np.uint8), (len(heights), 1)), 0.8)
        assert painted.data.shape == (*image.data.shape, 4)
        assert (painted.data[np.isfinite(image.data)] == [10, 200, 30, 255]).all()

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
        for of, values in (
            ("isometric", np.maximum(atlas.stretch[:, 0], 1 / atlas.stretch[:, 1])),
            ("quasi_conformal", atlas.stretch[:, 0] / atlas.stretch[:, 1]),
            ("areal", atlas.stretch[:, 0] * atlas.stretch[:, 1]),
        ):
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
        assert (found.face_ids == -1).all()
        assert (found.piece_ids == -1).all()
        assert np.isnan(found.points).all()
        assert np.isnan(found.weights).all()
        assert page.look_up(np.empty((0, 2))).points.shape == (0, 3)
        assert page.look_up([1.0, 1.0]).points.shape == (3,)
        refused("places has shape", page.look_up, [1.0, 2.0, 3.0])

    def test_a_map_has_it_too(self):
        sheet = voxflat.flatten(shapes.sheet(), method=voxflat.methods.Voxflat(sources=50))
        rng = np.random.default_rng(2)
        weights = rng.dirichlet([2, 2, 2], len(sheet.faces))
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
        image = atlas.heat_map()
        refused("colour_map is 'rainbows'", atlas.page().textured, image, colour_map="rainbows")
        grey = atlas.page().textured(image).picture
        assert (grey[..., 0] == grey[..., 1]).all()
        warm = atlas.page().textured(image, colour_map="inferno").picture
        assert (warm[..., 0] != warm[..., 2]).any()
        refused("does not belong to this page", atlas.page(30.0).textured, image)

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
