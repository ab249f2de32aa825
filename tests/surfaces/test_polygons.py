"""Polygons and paths on surfaces, through every interface."""

import json
from importlib import import_module
from itertools import pairwise

import composed
import numpy as np
import pytest
import pyvista as pv
import shapes
from command_line import fail, run, succeed
from mesh_files import grid, sphere
from refusals import refused

import voxflat
from voxflat.io.meshes import write_mesh

SIDE = 12
SQUARE = [2 * SIDE + 2, 2 * SIDE + 8, 9 * SIDE + 8, 9 * SIDE + 2]  # 60 by 70 mm of a grid of 10 mm


@pytest.fixture(scope="module")
def sheet():
    mesh = grid(SIDE)
    return mesh.points, mesh.faces


def test_a_polygon_holds_what_it_encloses(sheet):
    flat = voxflat.surface(sheet).polygon(SQUARE).flatten()
    i, j = np.divmod(flat.ids, SIDE)
    assert len(flat) == 7 * 8
    assert (i.min(), i.max(), j.min(), j.max()) == (2, 9, 2, 8)
    assert flat.metadata["polygon"] == SQUARE
    np.testing.assert_allclose(np.sort(np.ptp(flat.uv, axis=0)), [60, 70], rtol=0.02)
    assert voxflat.check(sheet, part=lambda s: s.polygon(SQUARE)).used == len(flat)
    assert voxflat.surface(sheet).polygon(SQUARE).geodesic(5).shape == (5, len(flat))


def test_the_same_polygon_through_every_way_in(sheet, tmp_path):
    expected = voxflat.surface(sheet).polygon(SQUARE).flatten()
    write_mesh(tmp_path / "s.ply", grid(SIDE))
    (tmp_path / "corners.txt").write_text("\n".join(map(str, SQUARE)))
    succeed("flatten", tmp_path / "s.ply", "--polygon", tmp_path / "corners.txt", "-o", tmp_path / "map.npz")
    np.testing.assert_array_equal(voxflat.load(tmp_path / "map.npz").uv, expected.uv)
    mesh = pv.PolyData.from_regular_faces(*sheet)
    import_module("voxflat._pyvista")  # PyVista 0.48 does so itself
    np.testing.assert_array_equal(mesh.voxflat.flatten(polygon=SQUARE).uv, expected.uv)


def test_a_polygon_of_voxels():
    volume = shapes.sheet((30, 30))
    flat = voxflat.surface(volume).polygon([[5, 5, 1], [5, 20, 1], [25, 20, 1], [25, 5, 1]]).flatten()
    assert (flat.ids.min(axis=0) == [5, 5, 1]).all()
    assert (flat.ids.max(axis=0) == [25, 20, 1]).all()
    assert len(flat) == 21 * 16


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"polygon": [1, 2]}, "the polygon has 2 corners, but at least 3 are needed"),
        ({"polygon": [1, 2, 3]}, "do not enclose a region"),
        ({"polygon": [1, 2, 999]}, "vertex 999 is not on the surface"),
        ({"polygon": [[1, 2, 3]]}, "must be vertex numbers"),
        ({"polygon": [0.5, 1.0, 2.0]}, "integers"),
    ],
)
def test_bad_polygons(sheet, options, message):
    refused(message, composed.flatten, sheet, **options)


@pytest.mark.parametrize("text", ["", "1 2\nx", "1.5\n2\n3"])
def test_bad_files_of_corners(tmp_path, text):
    write_mesh(tmp_path / "s.ply", grid(SIDE))
    (tmp_path / "corners.txt").write_text(text)
    words = ["flatten", tmp_path / "s.ply", "--polygon", tmp_path / "corners.txt", "-o", tmp_path / "map.npz"]
    fail(2, "corners.txt", *words)


@pytest.mark.parametrize("geodesic", ["graph", "edges"])
def test_a_path_through_several_stops(sheet, geodesic):
    stops = [0, SIDE - 1, SIDE * SIDE - 1]
    path = voxflat.surface(sheet).path(*stops, geodesic=geodesic)
    legs = [voxflat.surface(sheet).path(a, b, geodesic=geodesic) for a, b in pairwise(stops)]
    assert path.length == pytest.approx(220.0)
    assert path.length == sum(leg.length for leg in legs)
    np.testing.assert_array_equal(path.ids, [*legs[0].ids, *legs[1].ids[1:]])


def test_a_path_through_voxels():
    volume = shapes.sheet((20, 20))
    stops = [[1, 1, 1], [1, 15, 1], [20, 15, 1]]
    for geodesic in ("graph", "edges", "chain"):
        path = voxflat.surface(volume).path(*stops, geodesic=geodesic)
        assert path.length == pytest.approx(33.0, rel=0.15)
        assert [1, 15, 1] in path.ids.tolist()


def test_the_command_writes_a_path_that_cuts(tmp_path):
    """A ball is cut only along the path that `voxflat path` wrote."""
    ball = sphere()
    write_mesh(tmp_path / "s.ply", ball)
    far = ball.points @ ball.points[0]
    stops = [0, int(np.abs(far).argmin()), int(far.argmin())]
    result = succeed("path", tmp_path / "s.ply", *stops, "--geodesic", "edges", "-o", tmp_path / "cut.txt", "--json")
    written = np.loadtxt(tmp_path / "cut.txt", dtype=int)
    assert json.loads(result.stdout)["ids"] == written.tolist()
    succeed("flatten", tmp_path / "s.ply", "--cuts", tmp_path / "cut.txt", "-o", tmp_path / "map.npz")
    flat = voxflat.load(tmp_path / "map.npz")
    assert flat.metadata["cuts"] == [written.tolist()]
    assert flat.metadata["automatic_cuts"] == []
    assert len(flat) == len(ball.points) + len(written) - 2


@pytest.mark.slow
def test_check_takes_what_flatten_takes(tmp_path):
    """`check` accepts a pial surface and a repair."""
    inner, outer = sphere(), sphere()
    write_mesh(tmp_path / "white.ply", inner)
    write_mesh(tmp_path / "pial.ply", type(outer)(1.2 * outer.points, outer.faces))
    answer = json.loads(run("check", tmp_path / "white.ply", "--pial", tmp_path / "pial.ply", "--json").stdout)
    np.testing.assert_allclose(answer["contents"]["size"], 1.1 * np.ptp(inner.points, axis=0))
    ring = np.zeros((16, 16, 7), dtype=np.uint8)
    ring[2:-2, 2:-2, 2:-2] = 1
    ring[6:-6, 6:-6] = 0
    np.save(tmp_path / "ring.npy", ring)
    for repair, handles in ([], 1), (["--repair", "voxels"], 0):
        told = json.loads(run("check", tmp_path / "ring.npy", "--json", *repair).stdout)
        assert len(told["handles"]) == handles
