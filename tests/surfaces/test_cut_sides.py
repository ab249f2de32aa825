"""Patch files and GIFTI surfaces of a cut surface contain the vertices that FreeSurfer's rule allows."""

import itertools
import logging
import re

import freesurfer_rule
import lab
import nibabel
import numpy as np
import pytest
from command_line import run, succeed
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_files import grid
from refusals import refused
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import voxflat
from voxflat import InputError
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.patches import read_patch
from voxflat.methods import Voxflat, Zigelman2002
from voxflat.surfaces.cut_sides import listed_points, one_point_a_vertex


def sheet(rows=8, columns=9):
    """Return a bumpy sheet of triangles."""
    i, j = np.indices((rows, columns))
    mesh = grid(rows, np.sin(i * 1.3 + j * 0.7).ravel(), 2.0, columns)
    return mesh.points, mesh.faces


def keys(triangles):
    return {tuple(sorted(triangle)) for triangle in triangles}


def said(caplog):
    """Return the numbers of the only warning."""
    (record,) = caplog.records
    caplog.clear()
    return [int(number) for number in re.findall(r"\d+", record.getMessage())]


def judge(path, mesh_faces, ids, faces, places):
    """Assert that a reader of a patch finds only triangles of the map at their positions; return both losses."""
    found, _, triangles = freesurfer_rule.read_patch(path, mesh_faces)
    own = {tuple(sorted(ids[face].tolist())): face for face in faces.astype(np.int64)}
    points = np.array([own[tuple(sorted(triangle))] for triangle in triangles])  # a KeyError: it is none of the map's
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    listed = [[found[int(vertex)] for vertex in face] for face in ids[points]]
    np.testing.assert_allclose(listed, places[points], rtol=1e-6, atol=1e-4)
    assert {vertex for triangle in triangles for vertex in triangle} == set(found)
    return len(np.unique(ids)) - len(found), len(faces) - len(triangles)


def pieces_and_euler(triangles):
    """Return the number of edge-connected pieces of triangles, and V − E + F."""
    edges = {}
    for number, triangle in enumerate(triangles):
        for edge in itertools.combinations(sorted(triangle), 2):
            edges.setdefault(edge, []).append(number)
    touching = [(numbers[0], other) for numbers in edges.values() for other in numbers[1:]]
    joined = np.array(touching, dtype=int).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(joined)), joined.T), shape=(len(triangles), len(triangles)))
    vertices = {vertex for triangle in triangles for vertex in triangle}
    return connected_components(graph, directed=False)[0], len(vertices) - len(edges) + len(triangles)


class TestAnyCuts:
    """Sheets with cuts and excluded triangles at any position."""

    @staticmethod
    def sheet_without(gone):
        points, faces = sheet()
        surface = voxflat.surface((points, faces))
        kept = np.ones(len(faces), dtype=bool)
        kept[list(gone)] = False
        return faces, surface._with_core(surface.core.part_of_faces(kept).largest_piece())

    def cut_sheet(self, data):
        faces, part = self.sheet_without(data.draw(st.sets(st.integers(0, 111), max_size=6)))
        paths = data.draw(st.lists(st.tuples(st.integers(0, 71), st.integers(0, 71)), max_size=3))
        for a, b in paths:
            if a != b and {a, b} <= set(part.vertices.tolist()):
                try:
                    part = part.cut(cuts=[part.path(a, b, geodesic="edges").ids], relax=False).surface
                except InputError:  # a cut that would fall along another one, or into two pieces
                    continue
        return faces, part

    @pytest.mark.slow
    @settings(max_examples=40)
    @given(data=st.data())
    def test_a_patch_holds_no_triangle_but_its_own(self, data):
        self.assert_own(*self.cut_sheet(data))

    def test_a_triangle_may_touch_the_others_with_its_corners_alone(self):
        # what bridges the holes takes vertices along, and with them all neighbours of a triangle
        self.assert_own(*self.sheet_without({0, 18, 32, 89}))

    @staticmethod
    def assert_own(faces, part):
        ids, own = part.vertices, part.faces.astype(np.int64)
        of_mesh = keys(faces.tolist())  # a slit may have been closed for measuring, by triangles of its own
        own = own[[tuple(sorted(triangle)) in of_mesh for triangle in ids[own].tolist()]]
        rows = listed_points(ids, own, part._bridges())
        listed = set(ids[rows].tolist())
        assert len(listed) == len(rows)
        read = [tuple(face) for face in faces.tolist() if set(face) <= listed]
        of_points = keys(own.tolist())
        point = dict(zip(ids[rows].tolist(), rows.tolist(), strict=True))
        assert all(tuple(sorted(point[v] for v in triangle)) in of_points for triangle in read)
        if read:
            assert {v for triangle in read for v in triangle} == listed
            assert pieces_and_euler(read)[0] == 1
        left_out = sorted(set(ids.tolist()) - listed)
        for vertex in left_out:  # none could be taken back and bring a triangle that hangs together with the others
            for candidate in np.flatnonzero(ids == vertex).tolist():
                more = {**point, vertex: candidate}
                new = [tuple(face) for face in faces.tolist() if vertex in face and set(face) <= set(more)]
                right = [tuple(sorted(more[v] for v in triangle)) in of_points for triangle in new]
                assert not (new and all(right)) or pieces_and_euler(read + new)[0] > 1

    @settings(max_examples=20)
    @given(data=st.data())
    def test_one_point_a_vertex_keeps_no_less_than_the_first_ones(self, data):
        _, part = self.cut_sheet(data)
        ids, own = part.vertices, part.faces.astype(np.int64)
        rows = one_point_a_vertex(ids, own)
        np.testing.assert_array_equal(ids[rows], np.unique(ids))
        first = np.unique(ids, return_index=True)[1]
        assert np.isin(own, rows).all(axis=1).sum() >= np.isin(own, first).all(axis=1).sum()


def test_without_cuts_all_is_kept(tmp_path, caplog):
    mesh = sheet()
    flat = voxflat.flatten(mesh, Voxflat(sources=30))
    with caplog.at_level(logging.WARNING, "voxflat"):
        flat.save(tmp_path / "lh.patch.flat")
    assert not caplog.records
    assert judge(tmp_path / "lh.patch.flat", mesh[1], flat.ids, flat.faces, flat.uv) == (0, 0)


def test_a_patch_with_cuts_is_read_back_as_it_is_by_others(tmp_path, caplog):
    mesh = sheet(12, 13)
    path = np.arange(6, 6 + 13 * 8, 13)
    flat = voxflat.flatten(mesh, Voxflat(sources=60), cuts=[path])
    with caplog.at_level(logging.WARNING, "voxflat"):
        flat.save(patch := tmp_path / "lh.cortex.patch.flat")
        vertices, _, triangles, _ = said(caplog)
    assert judge(patch, mesh[1], flat.ids, flat.faces, flat.uv) == (vertices, triangles)
    assert 0 < vertices <= len(path) - 1
    assert triangles <= 6 * (len(path) - 1)
    for other in (tmp_path / "lh.full.flat.patch.3d", tmp_path / "rh.autoflatten.flat.patch.3d"):
        voxflat.flatten(mesh, Voxflat(sources=60), cuts=[path], threads=1).save(other)
        assert other.read_bytes() == patch.read_bytes()
    _, border, read = freesurfer_rule.read_patch(patch, mesh[1])
    edges = [edge for triangle in read for edge in itertools.combinations(sorted(triangle), 2)]
    assert {vertex for edge in edges if edges.count(edge) == 1 for vertex in edge} == border
    again = voxflat.surface(mesh).keep(patch).flatten(Voxflat(sources=60))
    assert keys(again.ids[again.faces].tolist()) == keys(read)
    judged = voxflat.compare(mesh, {"patch": other}, sources=20).maps["patch"]
    assert keys(judged.vertex_ids[judged.faces].tolist()) == keys(read)


def test_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = sheet()
    write_mesh("lh.white", Mesh(*mesh))
    commands = [("flatten", "full.flat", 0), ("cut", "cortex", 0), ("flatten", "x", 1), ("cut", "y.flat", 1)]
    for command, name, code in commands:
        assert run(command, "lh.white", "-o", f"lh.{name}.patch.3d").exit_code == code
    message = "lh.x.patch.3d: .patch.3d alone means a patch in 3-D space. Use a name"
    refused(message, voxflat.flatten(mesh, Voxflat(sources=30)).save, "lh.x.patch.3d")
    names = {"lh.full.flat.patch.3d", "lh.cortex.patch.3d"}
    assert {path.name for path in tmp_path.iterdir()} == {"lh.white", *names}
    for keep in names:
        assert len(voxflat.surface("lh.white").keep(keep).geodesic(1).ids) == 72
    succeed("measure", "lh.white", "lh.full.flat.patch.3d", "--sources", 5)


def test_a_patch_of_another_surface(tmp_path):
    voxflat.flatten(sheet(), Voxflat(sources=30)).save(tmp_path / "lh.patch.flat")
    message = "entry 24 of the patch refers to vertex 24, but the surface has 24 points"
    refused(message, voxflat.surface(sheet(4, 6)).keep, tmp_path / "lh.patch.flat")


@pytest.mark.slow
class TestHemisphere:
    """fsaverage5 without its medial wall, cut open along the standard cuts, as is common in practice."""

    @pytest.fixture(scope="class")
    def cut(self, fsaverage):
        sphere = lab.fsaverage5("sphere_left")[0]
        white, pial = ((fsaverage[name], fsaverage["faces"]) for name in ("white", "pial"))
        return voxflat.surface(white, pial=pial).drop("medial wall").cut(cuts="standard", sphere=sphere).surface

    def test_the_flat_patch(self, cut, fsaverage, tmp_path, caplog):
        flat = voxflat.flatten(cut, Zigelman2002(sources=100), relax=False)
        assert len(flat.ids) > len(np.unique(flat.ids)) + 100
        caplog.clear()
        with caplog.at_level(logging.WARNING, "voxflat"):
            flat.save(tmp_path / "lh.flat.patch.3d")
            vertices, _, triangles, _ = said(caplog)
            flat.save(tmp_path / "lh.flat.surf.gii")
            lost, of = said(caplog)
        found = judge(tmp_path / "lh.flat.patch.3d", fsaverage["faces"], flat.ids, flat.faces, flat.uv)
        assert found == (vertices, triangles)
        doubled = np.unique(flat.ids, return_counts=True)[1] > 1
        assert vertices < doubled.sum()  # fewer than if all vertices on cuts were left out
        assert triangles < 0.04 * of
        read = freesurfer_rule.read_patch(tmp_path / "lh.flat.patch.3d", fsaverage["faces"])[2]
        assert pieces_and_euler(read) == (1, 1)
        assert lost == of - len(nibabel.load(tmp_path / "lh.flat.surf.gii").darrays[1].data) < triangles
        flat.save(tmp_path / "map.npz")
        voxflat.load(tmp_path / "map.npz").save(tmp_path / "lh.again.patch.flat")
        assert (tmp_path / "lh.again.patch.flat").read_bytes() == (tmp_path / "lh.flat.patch.3d").read_bytes()

    def test_the_patch_in_space(self, cut, fsaverage, tmp_path):
        cut.save(tmp_path / "lh.cortex.patch.3d")
        judge(tmp_path / "lh.cortex.patch.3d", fsaverage["faces"], cut.vertices, cut.faces, cut.points)
        _, _, read = freesurfer_rule.read_patch(tmp_path / "lh.cortex.patch.3d", fsaverage["faces"])
        assert pieces_and_euler(read) == (1, 1)

    def test_cuts_that_leave_triangles_out(self, flat_map, fsaverage, tmp_path):
        assert len(flat_map.bridges) == 94  # as there are in the shipped map
        flat_map.save(tmp_path / "lh.patch.flat")
        lost = judge(tmp_path / "lh.patch.flat", fsaverage["faces"], flat_map.ids, flat_map.faces, flat_map.uv)
        assert 0 < lost[0] < 94
        assert len(read_patch(tmp_path / "lh.patch.flat").vertex_ids) == len(flat_map.ids) - lost[0]
