"""Defects of meshes with a unique remedy are repaired and reported, and every vertex keeps its number."""

import json

import numpy as np
import pytest
from command_line import run, succeed
from refusals import refused
from triangle_meshes import bump, square

import voxflat
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.io.patches import read_patch
from voxflat.methods import Voxflat

nib = pytest.importorskip("nibabel")


def split(mesh, vertex):
    """Split an inner vertex into two at the same position, with two triangles without area between them."""
    points, faces = mesh
    after = {}
    for face in faces[(faces == vertex).any(axis=1)].tolist():
        k = face.index(vertex)
        after[face[(k + 1) % 3]] = face[(k + 2) % 3]
    ring = [min(after)]
    while after[ring[-1]] != ring[0]:
        ring.append(after[ring[-1]])
    twin, half = len(points), len(ring) // 2
    faces = faces.copy()
    for a in ring[:half]:
        row = (faces == vertex).any(axis=1) & (faces == a).any(axis=1) & (faces == after[a]).any(axis=1)
        faces[row] = np.where(faces[row] == vertex, twin, faces[row])
    between = [[vertex, twin, ring[half]], [twin, vertex, ring[0]]]
    return np.vstack([points, points[vertex]]), np.vstack([faces, between])


def defective(size=16):
    """Return a bump with every repairable defect, its duplicated vertices, and the bump without defects."""
    points, faces = clean = bump(size)
    of = [40, 77, 77, 120, 150]
    mesh = points, faces
    for vertex in of:
        mesh = split(mesh, vertex)
    points, faces = mesh
    speck = len(points) + np.array([[0, 1, 2]])  # and a triangle apart from all, without area
    points = np.vstack([points, np.arange(3)[:, None] * [1.0, 1.0, 1.0] + 90])
    faces = np.vstack([faces, faces[5, [1, 0, 2]], [[3, 3, 4]], speck])
    return (points, faces), dict(zip(range(len(clean[0]), len(clean[0]) + len(of)), of, strict=True)), clean


def test_the_surface_is_the_one_without_defects_and_all_is_told():
    mesh, twins, clean = defective()
    surface, expected = voxflat.surface(mesh), voxflat.surface(clean)
    np.testing.assert_array_equal(surface.points, expected.points)
    as_sets = [{frozenset(face) for face in one.faces.tolist()} for one in (surface, expected)]
    assert as_sets[0] == as_sets[1]
    assert dict(surface.merged.tolist()) == twins
    assert surface.find(list(twins)).tolist() == surface.find(list(twins.values())).tolist()
    assert surface.remarks == (
        f"3 of {len(mesh[0])} vertices belong to no triangle and are excluded",
        f"1 of {len(mesh[1])} triangles duplicate others and were removed",
        f"12 of {len(mesh[1])} triangles have no area and were removed",
        f"5 of {len(mesh[0])} vertices coincide with others and share their position in the map",
    )
    assert surface.metadata["mended"]["merged"] == [[a, b] for a, b in twins.items()]
    json.dumps(surface.metadata)
    found = voxflat.check(mesh)
    assert found.can_flatten
    assert set(surface.remarks) <= set(found.advice)
    named = ("triangles without area", "triangles given twice", "vertices at the same place as another")
    assert [len(found.defects[name]) for name in named] == [12, 1, 5]


def test_the_map_has_every_vertex_number(tmp_path):
    mesh, twins, clean = defective()
    flat, expected = (voxflat.flatten(one, Voxflat(sources=30), rows=True) for one in (mesh, clean))
    assert set(flat.ids) == set(range(len(clean[0]))) | set(twins)
    count = len(clean[0])
    np.testing.assert_array_equal(flat.uv[:count], expected.uv)
    rows = {number: row for row, number in enumerate(flat.ids.tolist())}
    for twin, of in twins.items():
        for name in ("uv", "points", "normals"):
            np.testing.assert_array_equal(getattr(flat, name)[rows[twin]], getattr(flat, name)[rows[of]])
        np.testing.assert_array_equal(flat.rows[:, rows[twin]], flat.rows[:, rows[of]])
    assert flat.faces.max() < count
    assert len(flat.distortion.per_point) == len(flat)
    # files have the numbers of the mesh, as nibabel reads them
    flat.save(tmp_path / "flat.surf.gii")
    places = nib.load(tmp_path / "flat.surf.gii").agg_data("pointset")
    assert len(places) == len(mesh[0])
    np.testing.assert_allclose(places[flat.ids, :2], flat.uv, atol=1e-4)
    flat.save(tmp_path / "lh.flat.patch.3d")
    patch = read_patch(tmp_path / "lh.flat.patch.3d")
    assert set(patch.vertex_ids) == set(flat.ids)
    np.testing.assert_allclose(patch.points[:, :2], places[patch.vertex_ids, :2], atol=1e-4)
    # by FreeSurfer's rule: all triangles of the mesh that was given, and nothing turned over
    read = mesh[1][np.isin(mesh[1], patch.vertex_ids).all(axis=1)]
    a, b, c = (places[read[:, k], :2].astype(float) for k in range(3))
    doubled = np.linalg.det(np.stack([b - a, c - a], 1))
    assert (np.abs(doubled) < 1e-6).sum() == 11
    turned = (doubled < -1e-6).sum()
    assert turned == 1  # which is the duplicate that was given so
    flat.save(tmp_path / "flat.npz")
    assert (voxflat.load(tmp_path / "flat.npz").ids == flat.ids).all()
    # judged on the mesh that was given, from memory and from files, and an image shows the values at the numbers
    pairs = (mesh, flat), (mesh, tmp_path / "flat.surf.gii"), (clean, expected)
    of_map, of_file, of_clean = (voxflat.measure(*pair, sources=5) for pair in pairs)
    assert of_map.best_scale.relative_error == pytest.approx(of_clean.best_scale.relative_error, abs=1e-9)
    assert of_file.best_scale.relative_error == pytest.approx(of_clean.best_scale.relative_error, rel=0.5)
    image = flat.image(np.arange(len(mesh[0]), dtype=float)).data
    assert 0 <= np.nanmin(image) < np.nanmax(image) < len(clean[0])


def test_regions_and_cuts_may_name_any_of_the_merged():
    mesh, twins, clean = defective()
    twin, of = next(iter(twins.items()))
    around = np.flatnonzero(np.linalg.norm(clean[0] - clean[0][of], axis=1) < 4)
    for named in (around, np.append(around[around != of], twin)):
        assert {of, twin} <= set(voxflat.surface(mesh).keep(named).flatten(Voxflat(sources=9)).ids)
    whole = voxflat.surface(mesh)
    beside = next(b for b in whole.ids[whole.faces[(whole.ids[whole.faces] == of).any(axis=1)][0]] if b != of)
    assert of in whole.cut(cuts=[[twin, int(beside)]], relax=False).surface.ids
    # a cut through a merged vertex: it has both sides, and so have those that are one with it
    np.testing.assert_array_equal(whole.path(0, twin).ids, whole.path(0, of).ids)
    disk = voxflat.flatten(whole, Voxflat(sources=9), cuts=[_edges(whole, [6, of, 74])])
    assert (disk.ids == twin).sum() == (disk.ids == of).sum() == 2


def _edges(whole, through):
    """Return a path along edges through vertices."""
    ids = []
    for a, b in zip(whole.find(through[:-1]), whole.find(through[1:]), strict=True):
        ids += whole.ids[whole.core.edge_path(int(a), int(b))[0]].tolist()[bool(ids) :]
    return ids


def test_white_and_pial_are_measured_midway_where_only_one_of_them_is_degenerate():
    (points, faces), twins, _ = defective()
    pial = points + np.array([0.0, 0.0, 2.0])
    pial[list(twins)] += np.arange(1, 6)[:, None] * [0.02, 0.01, 0]  # so that the midway surface needs no merging
    surface = voxflat.surface((points, faces), pial=(pial, faces))
    assert len(surface.merged) == 0
    np.testing.assert_array_equal(surface.points, ((points + pial) / 2)[surface.ids])


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        (lambda f: np.vstack([f, [[3, 3, 4]]]), "triangle 72 has no area"),
        (lambda f: np.vstack([f, f[:1]]), "triangle 72 has the same corners as another"),
        (lambda f: np.array([[0, 7, 8], [8, 16, 9]]), "touches itself at vertex 8"),
    ],
)
def test_none_forbids_it(faces, message, tmp_path):
    points, good = square()
    mesh = points, faces(good)
    assert len(voxflat.surface(mesh).faces) > 1
    refused(message, voxflat.surface, mesh, repair="none")
    write_mesh(tmp_path / "in.ply", Mesh(*mesh))
    command = ["surface", tmp_path / "in.ply", "-o", tmp_path / "out.vtp"]
    assert run(*command, "--repair", "none").exit_code == 1
    assert not (tmp_path / "out.vtp").exists()
    succeed(*command)
    assert len(read_mesh(tmp_path / "out.vtp").faces) == len(voxflat.surface(mesh).faces)


def test_lips_of_a_cut_stay_apart():
    """Vertices that coincide but share no edge may do so on purpose."""
    whole = voxflat.surface(bump(16))
    cut = whole.cut(cuts=[_edges(whole, [8, 144])], relax=False).surface
    again = voxflat.surface((cut.points, cut.faces.astype(np.int64)))
    assert len(again) == len(cut) > len(whole)
    assert again.remarks == ()
    assert len(voxflat.check((cut.points, cut.faces.astype(np.int64))).defects["vertices at the same place as another"])


def test_holes_are_small_beside_the_mesh_where_its_unit_is_unknown(tmp_path):
    """The limit is a circumference of 15 mm in files with a unit, and twelve edges in other files."""
    points, faces = square(30)
    inside = (np.abs(points[:, :2] - 15) < 1.1).all(axis=1)  # a hole of 14 edges
    small = faces[~(faces == 15 * 31 + 15).any(axis=1)]  # and one of 6
    faces = faces[~inside[faces].any(axis=1)]
    for scale in (0.001, 1.0, 40.0):
        closed = {}
        for name in ("s.ply", "s.obj", "s.vtp", "s.surf.gii"):
            for holed in (faces, small):
                write_mesh(tmp_path / name, Mesh(points * scale, holed))
                cut = voxflat.surface(tmp_path / name).cut(relax=False)
                closed.setdefault(name, []).append(any("so that distances can cross" in one for one in cut.remarks))
        around = np.array([12 + 8**0.5, 4 + 8**0.5]) * scale
        assert closed["s.ply"] == closed["s.obj"] == closed["s.vtp"] == [False, True], scale
        assert closed["s.surf.gii"] == ([False, True] if scale < 0.01 else (around <= 15).tolist()), scale
