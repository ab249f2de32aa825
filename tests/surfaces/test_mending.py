"""Defects of meshes with a unique remedy are repaired and reported, and every vertex keeps its number."""

import json

import numpy as np
import pytest
from hard_shapes import signed_areas
from refusals import refused
from triangle_meshes import bump, square

import voxflat
from voxflat.io.meshes import Mesh, write_mesh
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


def defective():
    """Return a bump with every repairable defect, its duplicated vertices, and the bump without defects."""
    mesh = clean = bump(16)
    of = [40, 77, 77, 120, 150]
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
    assert surface.warnings == (
        f"3 of {len(mesh[0])} vertices belong to no triangle and are excluded",
        f"1 of {len(mesh[1])} triangles duplicate others and were removed",
        f"12 of {len(mesh[1])} triangles have no area and were removed",
        f"5 of {len(mesh[0])} vertices coincide with others and share their position in the map",
    )
    assert surface.metadata["mended"]["merged"] == [[a, b] for a, b in twins.items()]
    json.dumps(surface.metadata)
    found = voxflat.check(mesh)
    assert found.can_flatten
    assert set(surface.warnings) <= set(found.advice)
    named = ("triangles without area", "triangles given twice", "vertices at the same place as another")
    assert [len(found.defects[name]) for name in named] == [12, 1, 5]


@pytest.mark.medium
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
    areas = signed_areas(places[:, :2].astype(float), read)
    assert (np.abs(areas) < 1e-6).sum() == 11
    assert (areas < -1e-6).sum() == 1  # the duplicate that was given so
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


def test_lips_of_a_cut_stay_apart():
    """Vertices that coincide but share no edge may do so on purpose."""
    whole = voxflat.surface(bump(16))
    cut = whole.cut(cuts=[_edges(whole, [8, 144])], relax=False).surface
    again = voxflat.surface((cut.points, cut.faces.astype(np.int64)))
    assert len(again) == len(cut) > len(whole)
    assert again.warnings == ()
    assert len(voxflat.check((cut.points, cut.faces.astype(np.int64))).defects["vertices at the same place as another"])


@pytest.mark.medium
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
                closed.setdefault(name, []).append(any("so that distances can cross" in one for one in cut.warnings))
        around = np.array([12 + 8**0.5, 4 + 8**0.5]) * scale
        assert closed["s.ply"] == closed["s.obj"] == closed["s.vtp"] == [False, True], scale
        assert closed["s.surf.gii"] == ([False, True] if scale < 0.01 else (around <= 15).tolist()), scale


def test_vertices_without_a_position_are_left_out_and_the_others_keep_their_numbers(tmp_path):
    points, faces = bump(16)
    missing = [40, 77]
    left = faces[~np.isin(faces, missing).any(axis=1)]
    gaps = np.vstack([points, np.full((1, 3), np.nan)])  # no triangle uses the last one
    gaps[missing] = np.nan
    nib.freesurfer.write_geometry(tmp_path / "lh.white", np.nan_to_num(gaps), faces)
    write_mesh(tmp_path / "gaps.ply", Mesh(gaps, faces))
    for source in ((gaps, faces), tmp_path / "gaps.ply"):
        surface = voxflat.surface(source)
        assert {frozenset(f) for f in surface.ids[surface.faces].tolist()} == {frozenset(f) for f in left.tolist()}
        (told,) = [warning for warning in surface.warnings if "finite" in warning]
        gone = len(faces) - len(left)
        assert told == (
            f"2 of {len(gaps)} vertices have no finite position (40, 77); "
            f"{gone} of {len(faces)} triangles there were removed"
        )
        refused("point 40", voxflat.surface, source, repair="none")
        assert voxflat.check(source).defects["vertices without a position"] == missing
    flat = voxflat.flatten((gaps, faces), Voxflat(sources=9))
    assert not set(missing) & set(flat.ids.tolist())
    assert flat.image(np.arange(len(gaps), dtype=float)).data.shape
    unused = gaps.copy()
    unused[missing] = points[missing]
    assert not voxflat.surface((unused, faces), repair="none").warnings


def test_triangles_with_a_masked_corner_are_left_out():
    points, faces = bump(16)
    surface = voxflat.surface((points, np.vstack([faces, [[0, 1, -1], [-1, -1, -1]]])))
    assert len(surface.faces) == len(faces)
    assert surface.warnings == (f"2 of {len(faces) + 2} triangles have a corner of -1 and were left out",)


def test_midway_is_missing_where_the_pial_vertex_is():
    points, faces = bump(16)
    pial = points + np.array([0.0, 0.0, 2.0])
    pial[40] = np.nan
    surface = voxflat.surface((points, faces), pial=(pial, faces))
    assert 40 not in surface.ids
    assert any("1 of" in warning and "(40)" in warning for warning in surface.warnings)


def test_a_stray_fin_is_split_off_and_told():
    points, faces = bump(16)
    a, b = faces[100, :2].tolist()
    fin = np.vstack([points, points[a] + np.array([0, 0, 5.0])]), np.vstack([faces, [[a, b, len(points)]]])
    surface, clean = voxflat.surface(fin), voxflat.surface((points, faces))
    low, high = sorted((a, b))
    assert f"more than two triangles meet at an edge, between the vertices {low} and {high}" in surface.warnings[0]
    assert surface.metadata["mended"]["crowded_edges"] == [[low, high]]
    flat, expected = surface.flatten(Voxflat(sources=9)), clean.flatten(Voxflat(sources=9))
    np.testing.assert_array_equal(flat.uv, expected.uv)
    assert any("2 components" in warning and "% of the area" in warning for warning in flat.metadata["warnings"])
    refused(f"between the vertices {low} and {high}", voxflat.surface, fin, repair="none")
