"""Measured distortion, compared with analytic maps and between formats."""

import json
import logging
import re
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.spatial
import shapes
from command_line import fail, run, succeed
from hard_shapes import sheet
from mesh_files import icosphere, write_obj
from refusals import refused

import voxflat
from voxflat import figures
from voxflat.distortion.figures import Figures
from voxflat.evaluation.measure import _usual_sources
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.maps.matching import _check_share, _same_places
from voxflat.methods import Voxflat

DISTANCE_FIGURES = {one.name for one in fields(Figures)} - {"scale"}


def plane(side=12, step=3.0):
    """Return a square sheet with edges of `step` mm."""
    return sheet(lambda u, v: (u, v, 0 * u), (side * step, side * step), (side + 1, side + 1))


PLANE = plane()
X, Y = PLANE[0][:, :2].T
POINTS = np.column_stack([X, Y, 6 * np.exp(-((X - 16) ** 2 + (Y - 20) ** 2) / 120) + np.sin(X / 4)])
FACES = PLANE[1]
BUMPS = POINTS, FACES
UV = 1.1 * POINTS[:, :2] + 0.05 * np.column_stack([Y, X * Y / 30])  # a poor map of the bumps
FLAT = np.pad(UV, ((0, 0), (0, 1)))
APART = [(FLAT, FACES[part.all(axis=1)]) for part in (FACES < 60, FACES > 90)]


def tube():
    """Return a prism of 24 sides without ends, and the position of each triangle corner in its flat rectangle."""
    radius = 1 / np.sin(np.pi / 24)  # of edges of 2 mm
    points, faces = sheet(lambda u, v: (radius * np.cos(u), radius * np.sin(u), v), (2 * np.pi, 18.0), (25, 10))
    places = 2.0 * np.column_stack(np.divmod(np.arange(len(points)), 10))
    return points[:240], faces % 240, places[faces]


class TestAnalyticMaps:
    def test_the_reference_is_exact_where_links_are_not(self):
        points, faces, corners = tube()
        flat = np.zeros((len(points), 3))
        cut = (corners[..., 0] < 40).all(axis=1)  # without the last column of squares it lies flat
        flat[faces[cut].ravel(), :2] = corners[cut].reshape(-1, 2)
        exact, graph = (voxflat.measure((points, faces), (flat, faces[cut]), reference=by) for by in ("exact", "graph"))
        assert exact.raw.relative_error < 1e-6 < 1e-4 < graph.raw.relative_error
        assert (exact.reference, graph.reference) == ("exact", "graph")

    def test_a_plane_of_twice_its_size(self):
        found = voxflat.measure(PLANE, 2 * PLANE[0][:, :2], bands=(5, 10, 15, 30))
        assert found.best_scale.scale == pytest.approx(0.5, rel=1e-6)
        for name in DISTANCE_FIGURES:
            raw = {"absolute_error": found.mean_geodesic}.get(name, 1.0)
            assert getattr(found.raw, name) == pytest.approx(raw, rel=1e-5), name
            assert getattr(found.best_scale, name) == pytest.approx(0, abs=2e-5), name
        of = found.triangles
        assert (of.edge, of.quasi_conformal, of.isometric) == pytest.approx((1, 1, 2))
        assert (of.areal_median, of.areal_p95, of.symmetric_dirichlet) == pytest.approx((2, 2, 4.25))
        assert of.angle == pytest.approx(0, abs=1e-9)
        assert (of.flipped, of.collapsed, of.covering, of.crossings) == (0, 0, 0, 0)
        assert found.topology == {"components": 1, "euler": 1, "loops": 1, "handles": 0}
        assert found.standard_error.raw.relative_error < 1e-6

    def test_what_is_undefined_is_null(self):
        points, faces = plane(4, 40.0)
        found = voxflat.measure((points, faces), np.zeros((len(points), 2)), sources=1)
        assert found.raw.relative_error == 1
        for value in (found.best_scale.scale, found.pearson_r, found.raw.relative_error_30mm, found.triangles.angle):
            assert np.isnan(value)
        assert np.isnan(found.standard_error.raw.relative_error)
        content = json.loads(json.dumps(found.figures(), allow_nan=False))
        assert content["raw"]["relative_error_30mm"] is None
        assert content["standard_error"]["raw"]["stress_1"] is None
        assert "–" in found.table()


class TestFormats:
    def test_a_seam_of_an_obj_cuts_the_surface(self, tmp_path):
        points, faces, places = tube()
        write_obj(tmp_path / "tube.obj", points, faces, places)
        found = voxflat.measure((points, faces), tmp_path / "tube.obj")
        assert found.topology == {"components": 1, "euler": 1, "loops": 1, "handles": 0}
        assert len(found.per_point) == len(points) + 10  # the seam's vertices are there twice
        assert found.raw.relative_error < 1e-6
        assert found.triangles.areal_p95 < 1e-6

    def test_every_format_says_the_same(self, tmp_path):
        expected = voxflat.measure(BUMPS, UV, sources=20).raw
        flat, textured = Mesh(FLAT, FACES), Mesh(*BUMPS, texture_coordinates=UV)
        files = dict.fromkeys(("flat.surf.gii", "flat.ply", "flat.vtp", "flat.obj", "lh.flat"), flat)
        for name, mesh in (files | dict.fromkeys(("texture.obj", "texture.ply", "texture.vtp"), textured)).items():
            write_mesh(tmp_path / name, mesh)
            found = voxflat.measure(BUMPS, tmp_path / name, sources=20).raw
            of = (found.relative_error, found.stress_1)
            assert of == pytest.approx((expected.relative_error, expected.stress_1), rel=1e-5), name

    def test_triangles_that_the_surface_does_not_have_are_told(self, caplog):
        first = [set(face) in ({0, 13, 14}, {0, 1, 14}) for face in FACES.tolist()]
        assert sum(first) == 2
        others = np.concatenate([FACES[~np.array(first)], [[0, 13, 1], [1, 13, 14]]])  # the other diagonal
        with caplog.at_level(logging.WARNING, "voxflat"):
            voxflat.measure(BUMPS, (FLAT, FACES[(FACES < 150).all(axis=1)]), sources=3)
            assert not caplog.records
            found = voxflat.measure(BUMPS, (FLAT, others), sources=3)
        assert "the map has triangles that the surface does not have" in caplog.text
        assert len(found.triangles.is_flipped) == len(others)

    def test_a_map_in_charts(self):
        """Each chart has the values that it has alone, and the whole map their mean over all pairs."""
        faces = np.vstack([faces for _, faces in APART])
        scaled = FLAT * np.where(np.arange(len(FLAT)) > 80, 5.0, 1.0)[:, None]  # the second chart is larger
        everywhere = 10**6
        found = voxflat.compare(BUMPS, {"uv": (scaled, faces)}, sources=everywhere)
        assert list(found.maps) == ["uv, chart 1", "uv, chart 2", "uv"]
        alone = [voxflat.measure(BUMPS, (scaled, faces), sources=everywhere) for _, faces in APART[::-1]]
        charts = found["uv, chart 1"], found["uv, chart 2"]
        assert len(charts[0].per_point) > len(charts[1].per_point)
        for chart, one in zip(charts, alone, strict=True):
            assert chart.best_scale.relative_error == pytest.approx(one.best_scale.relative_error, rel=1e-9)
            assert chart.pairs == one.pairs
        whole, pairs = found["uv"], np.array([one.pairs for one in alone])
        for scale in ("raw", "best_scale"):
            for name in ("relative_error", "absolute_error"):
                mean = np.average([getattr(getattr(one, scale), name) for one in alone], weights=pairs)
                assert getattr(getattr(whole, scale), name) == pytest.approx(mean, rel=1e-9)
        interior = np.array([one.interior_share * one.pairs for one in charts])
        assert whole.interior_share == pytest.approx(interior.sum() / pairs.sum())
        mean = np.average([one.interior.relative_error for one in charts], weights=interior)
        assert whole.interior.relative_error == pytest.approx(mean, rel=1e-9)
        assert whole.pairs == pairs.sum()
        assert (whole.topology["components"], whole.topology["loops"]) == (2, 2)
        assert len(whole.triangles.is_flipped) == len(faces)
        assert whole.triangles.equal_area_p95 > 1 > max(one.triangles.equal_area_p95 for one in alone)
        of_points = np.concatenate([one.per_point for one in alone])
        np.testing.assert_allclose(np.sort(whole.per_point), np.sort(of_points), rtol=1e-9)
        assert whole.figures()["pearson_r"] is whole.figures()["best_scale"]["stress_1"] is None
        assert "components" in found.table()
        assert len(figures.heat_maps(found).axes) == 8
        assert voxflat.measure(BUMPS, (scaled, faces), sources=everywhere).figures() == whole.figures()

    def test_raw_figures_of_charts_are_those_of_the_map_as_it_is(self):
        two = np.vstack([FACES[part.all(axis=1)] for part in (FACES < 65, FACES >= 91)])  # rectangles
        raw = voxflat.measure(PLANE, (3 * PLANE[0][:, :2], two), sources=20).raw
        assert raw.relative_error == pytest.approx(3 * raw.scale - 1, rel=1e-6)  # all distances are 3 times as long

    def test_every_chart_has_sources(self):
        """Sources are in proportion to the vertices, but at least six."""
        faces = np.vstack([FACES[(FACES < 20).all(axis=1)], APART[1][1]])
        found = voxflat.compare(BUMPS, {"uv": (FLAT, faces), "whole": UV}, sources=20)
        assert found["uv, chart 2"].sources == 6
        assert found["whole"].sources == 20
        assert found["uv"].sources == found["uv, chart 1"].sources + 6

    @pytest.mark.medium
    def test_a_closed_surface_in_two_charts(self, tmp_path):
        """As Blender writes it: a sphere with two caps by Lambert's projection, which keeps areas, and a stray line."""
        points, faces = icosphere(20.0, 3)
        upper = points[faces][:, :, 2].mean(axis=1) > -8
        away = np.where(upper, 1, -1)[:, None] * points[faces][:, :, 2]  # towards the pole of the chart
        places = points[faces][:, :, :2] * np.sqrt(2 / (1 + away / 20))[..., None]
        places[~upper] = places[~upper] * [-1, 1] + [100, 0]
        path = tmp_path / "uv.obj"
        write_obj(path, points, faces, places / 1000)
        with path.open("a") as file:
            file.write("l 1 2\n")
        surface = voxflat.surface(path)
        found = voxflat.compare(surface, {"uv": path}, sources=40)
        for name, triangles in {"uv, chart 1": upper.sum(), "uv, chart 2": (~upper).sum(), "uv": len(faces)}.items():
            assert len(found.maps[name].faces) == triangles
            assert found[name].triangles.flipped == 0
            assert found[name].triangles.equal_area_p95 < 0.05
            assert found[name].triangles.equal_area_scale == pytest.approx(1000, rel=0.01)
        assert "uv.obj, chart 2" in succeed("measure", path, path, "--sources", "20").stdout
        flat = surface.flatten(Voxflat(start=path))
        assert len(flat.faces) == upper.sum()
        assert flat.distortion.raw.relative_error < found["uv, chart 1"].best_scale.relative_error

    def test_vertices_that_no_triangle_has(self):
        more = np.concatenate([POINTS, [[500.0, 0, 0]]]), FACES
        flat = np.concatenate([FLAT, [[3.0, 4, 0]]]), np.array([[0, 1, 169]])
        refused("vertex 169, which is in no triangle of the surface", voxflat.measure, more, flat)

    @pytest.mark.medium
    def test_voxels_are_measured_by_the_graph(self):
        surface = voxflat.surface(shapes.ball(9))
        flat = surface.disk(surface.ids[0], 12.0).flatten(Voxflat(sources=60))
        found = voxflat.measure(surface, flat, sources=200)
        assert (found.reference, found.voxel_size) == ("graph", pytest.approx(1.0))
        assert found.raw.relative_error == pytest.approx(flat.distortion.raw.relative_error, rel=1e-9)
        assert "voxels" in found.table()
        assert voxflat.measure(surface, flat, reference="exact").reference == "exact"

    def test_a_voxel_with_two_vertices(self):
        mask = np.zeros((14, 14, 12), dtype=bool)
        mask[2:12, 2:12, 2:5] = mask[2:12, 2:12, 6:9] = True
        mask[6:8, 2:12, 2:9] = True
        mask[3, 3:11, 9:11] = True  # a blade: its voxels have two sides
        surface = voxflat.surface(mask)
        ids, counts = np.unique(surface.ids, axis=0, return_counts=True)
        assert (counts > 1).any()
        flat = surface.disk(ids[counts > 1][0], 7.0).flatten(Voxflat(sources=60))
        assert len(np.unique(flat.ids, axis=0)) < len(flat.ids)
        found = voxflat.measure(surface, flat, sources=200)
        assert found.raw.relative_error == pytest.approx(flat.distortion.raw.relative_error, rel=1e-9)


class TestComparison:
    def test_vertices_in_another_order(self):
        flat = voxflat.flatten(BUMPS, method=Voxflat(sources=50))
        order = np.random.default_rng(0).permutation(len(flat))
        rank = np.argsort(order)
        shuffled = voxflat.FlatMap(
            **{name: getattr(flat, name)[order] for name in ("uv", "points", "normals", "ids")},
            **{
                name: getattr(flat, name)
                for name in ("torn", "sources", "eigenvalues", "distortion", "origin", "details")
            },
            faces=rank[flat.faces].astype(np.uint32),
        )
        compared = voxflat.compare(BUMPS, {"a": flat, "b": UV, "c": shuffled}, sources=40, bands=(5, 10, 15, 30))
        assert compared["c"].raw == compared["a"].raw
        np.testing.assert_array_equal(compared["c"].per_point, compared["a"].per_point[order])
        np.testing.assert_array_equal(compared.maps["c"].uv, compared.maps["a"].uv[order])

    def test_maps_with_other_cuts_have_the_same_sources(self):
        part = FACES[(FACES < 120).all(axis=1)]
        cut = voxflat.flatten(BUMPS, method=Voxflat(sources=40), cuts=[np.arange(6, 6 + 13 * 5, 13)])
        compared = voxflat.compare(BUMPS, {"all": UV, "part": (FLAT, part), "cut": cut}, sources=30)
        assert [compared[name].sources for name in compared.maps] == [30, 30, 30]
        assert [len(compared[name].per_point) for name in compared.maps] == [169, 120, 169 + 4]
        assert len(compared.maps["cut"].vertex_ids) == len(np.unique(compared.maps["cut"].vertex_ids)) + 4

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"sources": 0}, "sources is 0"),
            ({"sources": 2.5}, "sources is 2.5"),
            ({"reference": "chain"}, "reference is 'chain'. Pass 'exact' or 'graph'"),
            ({"maps": {}}, "maps is empty"),
            ({"maps": dict(zip("ab", APART, strict=True))}, "the maps have no vertex in common"),
        ],
    )
    def test_bad_arguments(self, options, message):
        refused(message, voxflat.compare, BUMPS, **{"maps": {"one": UV}, **options})

    def test_heat_maps_leave_out_what_is_undefined(self):
        figure = figures.heat_maps(voxflat.compare(BUMPS, {"good": UV, "in one place": 0 * UV}, sources=1))
        assert [len(axes.collections) for axes in figure.axes[:4]] == [1, 1, 1, 0]


@pytest.mark.slow
class TestCommandLine:
    @pytest.fixture
    def files(self, tmp_path):
        for name, points in (("surface.ply", POINTS), ("one.ply", FLAT), ("two.ply", 2 * FLAT)):
            write_mesh(tmp_path / name, Mesh(points, FACES))
        return tmp_path

    def test_one_map(self, files):
        result = succeed("measure", files / "surface.ply", files / "one.ply", "--sources", "30")
        found = voxflat.measure(files / "surface.ply", files / "one.ply", sources=30)
        assert result.stdout == f"{found.in_words()}\n\n{found.table()}\n"
        assert "exact distances" in result.stdout
        assert "±" in result.stdout

    def test_several_maps(self, files):
        arguments = (files / "surface.ply", files / "one.ply", files / "two.ply", "--sources", "30")
        lines = succeed("measure", *arguments, "--heat-maps", files / "maps.png").stdout.splitlines()
        assert [line.split(": Distances are off by ")[0] for line in lines[:2]] == ["one.ply", "two.ply"]
        assert lines[4].split() == ["one.ply", "two.ply"]
        assert len({len(line) for line in lines if "±" in line[30:]}) == 1  # aligned
        assert (files / "maps.png").read_bytes().startswith(b"\x89PNG")
        content = json.loads(run("measure", *arguments, "--json").stdout)
        assert list(content) == ["maps", "provenance"]
        one, two = (content["maps"].pop(name) for name in ("one.ply", "two.ply"))
        assert content["maps"] == {}
        assert two["best_scale"]["scale"] == pytest.approx(one["best_scale"]["scale"] / 2)
        assert one["reference"] == "exact"

    def test_an_own_map_shows_what_it_would_gain(self, files, tmp_path):
        write_mesh(tmp_path / "poor.ply", Mesh(FLAT * [1.0, 3.0, 1.0], FACES))
        arguments = ("measure", files / "surface.ply", tmp_path / "poor.ply", "--own-map", "--sources", "30", "--json")
        maps = json.loads(succeed(*arguments).stdout)["maps"]
        own, surface = maps["own map"], voxflat.surface(files / "surface.ply")
        made = voxflat.measure(surface, surface.flatten(cuts=tmp_path / "poor.ply"), sources=30)
        assert own["best_scale"]["relative_error"] == pytest.approx(made.best_scale.relative_error)
        assert own["best_scale"]["relative_error"] < maps["poor.ply"]["best_scale"]["relative_error"]

    def test_a_map_in_words(self):
        stretched = voxflat.measure((FLAT, FACES), FLAT[:, :2] * [1.0, 2.0], sources=20)
        near = stretched.best_scale.relative_error
        assert stretched.in_words().startswith(f"Distances are off by {100 * near:.1f} % on average")
        assert stretched.in_words().endswith("0 % of the area by more than 1.5 times.")
        halves = FLAT[:, :2].copy()
        halves[:, 0] *= np.where(halves[:, 0] > np.median(halves[:, 0]), 4.0, 1.0)
        share = voxflat.measure((FLAT, FACES), halves, sources=20).triangles.area_beyond_1_5
        words = voxflat.measure((FLAT, FACES), halves, sources=20).in_words()
        assert share > 0.2
        assert f"{100 * share:.0f} % of the area by more than 1.5 times" in words

    def test_refusals(self, files):
        surface, one = files / "surface.ply", files / "one.ply"
        assert run("measure", surface).exit_code == 2
        assert run("measure", surface, one, one).exit_code == 2
        fail(1, ".png or .pdf or .svg", "measure", surface, one, "--heat-maps", files / "maps.gif")


class TestGeometry:
    """A map is measured on the geometry on which it was made."""

    PIAL = POINTS * [1, 1, 5] + [0, 0, 3]
    MIDDLE = (POINTS + PIAL) / 2, FACES

    @pytest.fixture
    def flat(self, tmp_path):
        """Return a map made midway between a white and a pial sheet, and write their files."""
        for name, points in (("lh.white", POINTS), ("lh.pial", self.PIAL)):
            write_mesh(tmp_path / name, Mesh(points, FACES))
        flat = voxflat.flatten(voxflat.surface(BUMPS, pial=(self.PIAL, FACES)), method=Voxflat(sources=60))
        flat.save(tmp_path / "map.npz")
        return flat

    def test_a_map_made_midway_is_judged_there(self, flat, tmp_path, caplog):
        expected = voxflat.measure(self.MIDDLE, flat.uv, sources=20)
        on_white = voxflat.measure(BUMPS, flat.uv, sources=20)
        assert expected.raw.relative_error < 0.8 * on_white.raw.relative_error
        caplog.clear()
        with caplog.at_level(logging.WARNING, "voxflat"):
            found = voxflat.measure(tmp_path / "lh.white", tmp_path / "map.npz", sources=20)
        assert found.raw.relative_error == pytest.approx(expected.raw.relative_error, rel=1e-4)
        assert found.triangles.areal_p95 == pytest.approx(expected.triangles.areal_p95, rel=1e-4)
        assert "was made on a geometry (midthickness: halfway to" in caplog.text
        caplog.clear()
        with caplog.at_level(logging.WARNING, "voxflat"):
            forced = voxflat.measure(tmp_path / "lh.white", flat, sources=20, on_surface=True)
            given = voxflat.measure(voxflat.surface(BUMPS, pial=tmp_path / "lh.pial"), flat, sources=20)
        assert not caplog.records
        assert forced.raw.relative_error == pytest.approx(on_white.raw.relative_error, rel=1e-4)
        assert given.raw.relative_error == pytest.approx(expected.raw.relative_error, rel=1e-4)

    def test_all_maps_are_judged_on_one_geometry(self, flat, tmp_path):
        flat.save(tmp_path / "lh.flat.surf.gii")
        both = {"ours": tmp_path / "map.npz", "theirs": tmp_path / "lh.flat.surf.gii"}
        expected = voxflat.measure(self.MIDDLE, flat.uv, sources=20).raw.relative_error
        for maps in (both, dict(reversed(both.items()))):
            compared = voxflat.compare(BUMPS, maps, sources=20)
            for name in both:
                assert compared[name].raw.relative_error == pytest.approx(expected, rel=1e-4)
        maps = {"ours": flat, "white": voxflat.flatten(BUMPS, method=Voxflat(sources=60))}
        message = r"ours was made on midthickness.*, but white was made on the given surface, whose geometry"
        refused(message, voxflat.compare, BUMPS, maps, sources=20)
        assert set(voxflat.compare(BUMPS, maps, sources=20, on_surface=True).maps)

    def test_a_map_with_vertices_that_lie_nobody_knows_where(self):
        part = voxflat.surface(self.MIDDLE).keep(np.arange(100)).flatten(Voxflat(sources=40))
        whole = {"part": part, "all": POINTS[:, :2]}
        message = "part was made on a geometry that differs .* does not define the positions of 69 vertices of all"
        refused(message, voxflat.compare, BUMPS, whole, sources=20)
        assert voxflat.compare(self.MIDDLE, whole, sources=20)["all"].raw.relative_error > 0

    def test_the_space_alone_is_no_other_geometry(self, caplog):
        flat = voxflat.flatten(BUMPS, method=Voxflat(sources=40))
        moved = POINTS.astype(np.float32) @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) + [3, -17, 22]
        with caplog.at_level(logging.WARNING, "voxflat"):
            found = voxflat.measure((moved, FACES), flat, sources=20)
        assert not caplog.records
        expected = voxflat.measure(BUMPS, flat, sources=20).raw.relative_error
        assert found.raw.relative_error == pytest.approx(expected, rel=1e-4)

    @pytest.mark.parametrize(("grown", "warnings"), [(1.0, 0), (1.005, 1)])
    def test_single_precision_is_no_other_geometry_but_half_a_percent_is(self, caplog, grown, warnings):
        flat = voxflat.flatten((POINTS + 500, FACES), method=Voxflat(sources=20))
        caplog.clear()
        voxflat.measure(((grown * POINTS + 500).astype(np.float32), FACES), flat, sources=5)
        assert len(caplog.records) == warnings

    @pytest.mark.usefixtures("flat")
    def test_the_command(self, tmp_path):
        errors = {}
        for more in ((), ("--pial", tmp_path / "lh.pial"), ("--on-surface",)):
            result = succeed("measure", tmp_path / "lh.white", tmp_path / "map.npz", "--sources", "20", "--json", *more)
            errors[len(more)] = json.loads(result.stdout)["raw"]["relative_error"]
            assert ("other than that of the given surface" in result.stderr) == (more == ())
        assert errors[0] == pytest.approx(errors[2], rel=1e-4)
        assert errors[1] > 1.2 * errors[0]


def test_by_default_as_many_sources_are_taken_as_half_a_minute_allows():
    found = [_usual_sources([points], "exact") for points in (9, 10_242, 32_000, 160_000, 1_000_000)]
    assert found == [300, 300, 69, 6, 6]
    assert _usual_sources([32_000, 32_000], "exact") == 34  # their distances are measured one after the other
    assert _usual_sources([1_000_000], "graph") == 300


def test_the_table_has_each_figure_in_its_unit():
    found = voxflat.measure(PLANE, PLANE[0][:, :2], sources=5, bands=(5, 10, 15, 30))
    errors = {one.name: 0.01 * (n + 2) for n, one in enumerate(fields(Figures))}
    areas = {"area_beyond_1_25": 0.31, "area_beyond_1_5": 0.22, "area_beyond_2": 0.13, "edge": 0.04, "angle": 5.5}
    made = replace(found, raw=Figures(**errors), triangles=replace(found.triangles, **areas))
    cells = {}
    for line in made.table().splitlines():
        name, *values = re.split(r"  +", line.strip())
        cells.setdefault(name, values[0].split(" ")[0] if values else "")  # the first of two is RAW
    percent = {"pairs up to 5 mm": "0_5mm", "5 to 15 mm": "5_15mm", "15 to 30 mm": "15_30mm"}
    percent |= {"up to 10 mm": "10mm", "up to 30 mm": "30mm"}
    for name, key in percent.items():
        assert float(cells[name]) == pytest.approx(100 * errors[f"relative_error_{key}"])
    assert float(cells["relative error, %"]) == pytest.approx(100 * errors["relative_error"])
    others = {"absolute error, mm": "absolute_error", "stress-1": "stress_1", "Sammon stress": "sammon_stress"}
    assert [float(cells[name]) for name in others] == pytest.approx([errors[key] for key in others.values()])
    names = ("% beyond 1.25 times", "% beyond 1.5 times", "% beyond twice", "edges, %", "angles, degrees")
    assert [float(cells[name]) for name in names] == [31, 22, 13, 4, 5.5]


@pytest.mark.parametrize(("own", "told"), [(6, None), (4, "only 4 of the map's 10 triangles are triangles")])
def test_half_of_the_triangles_of_a_map_must_be_those_of_the_surface(own, told):
    faces = FACES[:10].copy()
    faces[own:, 2] += 2  # other triangles
    whole = SimpleNamespace(vertices=np.arange(len(POINTS)), faces=FACES)
    if told:
        refused(told, _check_share, whole, faces)
    else:
        _check_share(whole, faces)


def test_a_map_that_is_bent_by_one_percent_is_not_flat():
    refused("not flat", voxflat.measure, PLANE, PLANE[0] + 0.36 * (PLANE[0][:, :1] > 18) * [0, 0, 1], sources=5)


@pytest.mark.parametrize("near", [True, False])
def test_points_of_another_order_are_found_within_single_precision(near):
    own, order = voxflat.surface(BUMPS), np.random.default_rng(0).permutation(len(POINTS))
    points = POINTS[order].astype(np.float32) + (0.0 if near else 0.05)
    if near:
        np.testing.assert_array_equal(_same_places(own, points, FACES), order[FACES])
    else:
        refused("none of them is at", _same_places, own, points, FACES)


def small_cap(polar=90.0, rings=3):
    """Return points and triangles of a cap of a sphere with a radius of 20 mm, and its azimuthal equidistant map."""
    corners = [(0.0, 0.0)]
    corners += [(ring / rings, 2 * np.pi * n / (6 * ring)) for ring in range(1, rings + 1) for n in range(6 * ring)]
    radius, angle = np.array(corners).T
    flat = 20 * np.radians(polar) * radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    polar_angle = np.radians(polar) * radius
    points = 20 * np.column_stack(
        [np.sin(polar_angle) * np.cos(angle), np.sin(polar_angle) * np.sin(angle), np.cos(polar_angle)]
    )
    return (points, scipy.spatial.Delaunay(flat).simplices), flat


@pytest.mark.medium
class TestLowerBound:
    def test_no_map_is_below_it_and_a_good_map_is_less_than_three_times_above(self):
        cap, flat = small_cap()
        rng = np.random.default_rng(0)
        maps = {"azimuthal": flat, "seen from above": cap[0][:, :2], "default": voxflat.flatten(cap, relax=False)}
        maps |= {f"shaken {n}": flat + rng.normal(scale=n, size=flat.shape) for n in range(1, 6)}
        maps |= {f"random {n}": rng.uniform(-30, 30, size=flat.shape) for n in range(3)}
        found = voxflat.compare(cap, maps, lower_bound=True)
        errors = {name: found[name].best_scale.relative_error for name in maps}
        bound = found["default"].lower_bound
        assert {found[name].lower_bound for name in maps} == {bound}
        assert min(errors.values()) / 3 < bound < min(errors.values())

    def test_it_is_0_for_a_plane_and_undefined_by_default(self):
        sheet_ = plane(6)
        flat = sheet_[0][:, :2]
        found = voxflat.measure(sheet_, flat, lower_bound=True)
        assert found.lower_bound == 0
        assert "no map can be better than, %" in found.table()
        usual = voxflat.measure(sheet_, flat)
        assert np.isnan(usual.lower_bound)
        assert "no map" not in usual.table()
        assert usual.figures()["lower_bound"] is None

    @pytest.mark.slow
    def test_it_does_not_depend_on_the_unit_or_the_number_of_threads(self):
        (points, faces), flat = small_cap(60.0)
        bounds = [
            voxflat.measure((unit * points, faces), flat, lower_bound=True, threads=threads).lower_bound
            for unit, threads in ((1.0, 1), (1.0, 2), (1000.0, 1))
        ]
        assert bounds[0] == bounds[1]
        assert bounds[2] == pytest.approx(bounds[0], rel=1e-3)

    def test_charts_have_their_own_and_none_together(self):
        (points, faces), flat = small_cap()
        halves = np.vstack([faces[(side * flat[faces, 0] > 1).all(axis=1)] for side in (1, -1)])
        found = voxflat.compare((points, faces), {"uv": (flat, halves)}, lower_bound=True)
        bounds = [found[f"uv, chart {n}"].lower_bound for n in (1, 2)]
        assert min(bounds) > 0
        assert np.isnan(found["uv"].lower_bound)

    def test_its_memory_is_checked_before_anything_is_measured(self):
        cap, flat = small_cap()
        stages = set()
        more = {"memory_limit": 10**6, "progress": lambda stage, *_: stages.add(stage)}
        refused(
            "of memory is needed, but the limit is .* Use fewer threads",
            voxflat.measure,
            cap,
            flat,
            lower_bound=True,
            **more,
        )
        assert not any("distances" in stage for stage in stages)
        voxflat.measure(cap, flat, **more)

    def test_it_can_be_cancelled(self):
        cap, flat = small_cap()
        with pytest.raises(voxflat.Cancelled):
            voxflat.measure(cap, flat, lower_bound=True, progress=lambda stage, *_: stage != "bounding the error")

    @pytest.mark.slow
    def test_the_command_line_and_summaries_show_it(self, tmp_path):
        (points, faces), flat = small_cap()
        surface, flat_file = tmp_path / "cap.obj", tmp_path / "flat.obj"
        write_mesh(surface, Mesh(points, faces))
        write_mesh(flat_file, Mesh(np.pad(flat, ((0, 0), (0, 1))), faces))
        report = json.loads(succeed("measure", surface, flat_file, "--lower-bound", "--json").stdout)
        found = voxflat.measure(surface, flat_file, lower_bound=True)
        assert report["lower_bound"] == found.lower_bound > 0
        assert f"no map can be better than {100 * found.lower_bound:.1f} % of all pairs" in repr(found)
        assert "no map" not in repr(voxflat.measure(surface, flat_file))
