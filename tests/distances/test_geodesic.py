"""Distances by every solver, and paths, through the API and the command line."""

import json

import numpy as np
import pytest
from command_line import fail, run, succeed
from refusals import refused
from scipy.spatial import Delaunay

import voxflat

SOLVERS = ["graph", "marching", "exact"]


@pytest.fixture(scope="module")
def ball():
    """Return the points and faces of a sphere of radius 10 mm."""
    pyvista = pytest.importorskip("pyvista")
    return voxflat.surface(pyvista.Icosphere(radius=10.0, nsub=4))


@pytest.fixture(scope="module")
def rows(ball):
    return {solver: ball.geodesic([0, 7, 1000], geodesic=solver) for solver in SOLVERS}


@pytest.mark.parametrize(("solver", "worst"), [("graph", 0.03), ("marching", 0.015), ("exact", 0.003)])
def test_distances_on_a_sphere(rows, solver, worst):
    row = rows[solver]
    for n, source in enumerate([0, 7, 1000]):
        truth = 10 * np.arccos(np.clip(row.points @ row.points[source] / 100, -1, 1))
        far = truth > 1
        assert row[n][source] == 0
        assert np.abs(row[n][far] / truth[far] - 1).max() < worst


def test_links_in_a_plane_are_nearly_straight():
    places = np.random.default_rng(0).uniform(0, 40, (3000, 2))
    places = np.vstack([places, [[0, 0], [40, 0], [0, 40], [40, 40]]])
    surface = voxflat.surface((np.c_[places, np.zeros(len(places))], Delaunay(places).simplices), unit="mm")
    sources = list(range(0, 300, 10))
    straight = np.linalg.norm(places[sources][:, None] - places, axis=2)
    rows = np.array(list(surface.geodesic(sources)))
    longer = rows[straight > 0] / straight[straight > 0] - 1
    assert longer.min() > -1e-6
    assert longer.mean() < 7e-4  # half a thousandth, as a link crosses up to eleven edges


def test_an_unknown_solver_is_named(ball):
    refused("'heat'. Pass 'graph', 'marching', 'exact' or 'chain'", ball.geodesic, 5, geodesic="heat")
    refused("'heat'. Pass 'graph', 'marching', 'exact', 'edges' or 'chain'", ball.path, 0, 5, geodesic="heat")
    refused("link_lengths", ball.geodesic, 5, geodesic="exact", link_lengths="euclidean")


class TestPaths:
    @pytest.mark.parametrize("solver", ["graph", "marching", "exact", "edges"])
    def test_are_as_long_as_the_distance_says(self, ball, rows, solver):
        for target in (3, 500, 2000):
            found = ball.path(7, target, geodesic=solver)
            steps = np.linalg.norm(np.diff(found.points, axis=0), axis=1)
            if solver == "graph":
                assert steps.sum() < found.length < 1.01 * steps.sum()  # links run over faces from vertex to vertex
            else:
                assert found.length == pytest.approx(steps.sum(), rel=1e-6)
            if solver in ("graph", "exact"):
                assert found.length == pytest.approx(float(rows[solver][1][target]), rel=1e-6)
            assert (found.ids[0], found.ids[-1]) == (7, target)

    @pytest.mark.parametrize("solver", ["marching", "exact"])
    def test_over_triangles_cross_edges_on_the_surface(self, ball, solver):
        found = ball.path(7, 2000, 33, geodesic=solver)
        assert (found.ids == -1).sum() > 10
        np.testing.assert_array_equal(found.ids[found.ids >= 0][[0, -1]], [7, 33])
        assert 2000 in found.ids
        at = found.ids >= 0
        np.testing.assert_allclose(found.points[at], ball.points[found.ids[at]], atol=1e-9)
        assert np.abs(np.linalg.norm(found.points, axis=1) - 10).max() < 0.03

    @pytest.mark.parametrize("solver", ["graph", "edges", "exact", "chain"])
    def test_end_on_voxels_whose_places_coincide(self, solver):
        mask = np.zeros((5, 5, 5), np.uint8)
        held = "122 123 132 231 232 233 312 321 332 333"  # fuzzed: the place of the last but two is that of another
        mask[tuple(np.array([[int(index) for index in voxel] for voxel in held.split()]).T)] = 1
        found = voxflat.surface(mask).path((1, 2, 2), (3, 2, 1), geodesic=solver)
        assert (found.ids[0].tolist(), found.ids[-1].tolist()) == ([1, 2, 2], [3, 2, 1])
        assert len(found.ids) < 8

    @pytest.mark.parametrize("solver", ["marching", "exact", "chain"])
    def test_in_different_components_is_refused(self, solver):
        apart = np.ones((9, 9, 1), np.uint8)
        apart[4] = 0
        message = r"and \[8, 0, 0\]: they lie in different components"
        refused(message, voxflat.surface(apart).path, (0, 0, 0), (8, 0, 0), geodesic=solver)


class TestCommandLine:
    @pytest.fixture
    def mesh(self, ball, tmp_path):
        ball.save(tmp_path / "ball.surf.gii")
        return tmp_path / "ball.surf.gii"

    @pytest.mark.parametrize("solver", ["marching", "exact"])
    def test_prints_a_path_over_triangles_but_writes_none_for_cuts(self, mesh, ball, tmp_path, solver):
        command = ("path", mesh, 7, 2000, "--geodesic", solver)
        told = json.loads(run(*command, "--json").stdout)
        assert told["length"] == pytest.approx(ball.path(7, 2000, geodesic=solver).length, rel=1e-6)
        assert -1 in told["ids"]
        fail(2, "--geodesic edges", *command, "-o", tmp_path / "cut.txt")
        assert not (tmp_path / "cut.txt").exists()

    @pytest.mark.medium
    @pytest.mark.parametrize("solver", SOLVERS)
    def test_fills_a_store(self, mesh, tmp_path, solver):
        where = ("--store", tmp_path / "store", "--quiet")
        succeed("rows", mesh, "--sources", 5, "--geodesic", solver, *where)
        rows = voxflat.open_rows(tmp_path / "store")
        np.testing.assert_array_equal(rows, voxflat.surface(mesh).geodesic(5, geodesic=solver))


def test_distances_in_a_part_are_shown_at_their_vertices_and_never_at_others():
    """The columns are the points of the part, so that a row is not one value for each vertex of the mesh."""
    hill = voxflat.samples.hill()
    part = hill.keep(np.arange(100, 300))
    rows = part.geodesic(4)
    vertices = np.array([299, 100, 231])
    np.testing.assert_array_equal(rows.ids[part.find(vertices)], vertices)
    np.testing.assert_allclose(rows.points[part.find(vertices)], hill.points[vertices], rtol=1e-6)
    flat = part.flatten(voxflat.methods.Voxflat(sources=9))
    told = (
        "the overlay has 200 values, one for each point of the map, but the mesh has 441 vertices. Assign them to the"
    )
    refused(told, flat.image, rows[0])
    refused("the overlay has 200 values, but the mesh has 441 vertices. Pass one", hill.flatten().image, rows[0])
    refused("DistanceRows: has shape", flat.image, rows)
    everywhere = np.full(hill.count, np.nan)
    everywhere[flat.ids] = rows[0]
    shown = flat.image(everywhere).data
    np.testing.assert_allclose([np.nanmin(shown), np.nanmax(shown)], [rows[0].min(), rows[0].max()], atol=1.0)
