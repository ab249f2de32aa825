"""Distances on a surface, its maps, their distortion and their files."""

import re

import anatomy
import lab
import numpy as np
import pytest
import shapes
from command_line import succeed
from hard_shapes import signed_areas
from mesh_files import needs_workbench, workbench
from refusals import refused
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from triangle_meshes import bump, rolled

import voxflat
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.methods import Voxflat

pytest.importorskip("nilearn")


def apart(places):
    return np.linalg.norm(places[:, None] - places[None], axis=2)


class TestDistances:
    def test_links_are_paths_on_the_surface(self):
        """Distances lie between those in space and along edges, are symmetric, and obey the triangle inequality."""
        points, faces = bump()
        sources = np.arange(0, len(points), 97)
        rows = np.asarray(voxflat.surface((points, faces)).geodesic(sources), dtype=float)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        along = dijkstra(csr_matrix((lengths, edges.T), shape=(len(points),) * 2), directed=False, indices=sources)
        air = np.linalg.norm(points[sources][:, None] - points[None], axis=2)
        assert (rows <= along * (1 + 1e-6)).all()
        assert (rows >= air * (1 - 1e-6)).all()
        among = rows[:, sources]
        np.testing.assert_allclose(among, among.T, rtol=1e-6)
        assert (among[:, None] <= among[:, :, None] + among[None] + 1e-4).all()

    @pytest.mark.medium
    def test_a_rolled_sheet_has_its_flat_distances(self):
        mesh, places = rolled()
        rows = voxflat.surface(mesh).geodesic([0, 800, 1680])
        expected = apart(places)[[0, 800, 1680]]
        far = expected > 2
        error = np.asarray(rows)[far] / expected[far] - 1
        assert -1e-3 < error.min() <= error.max() < 0.03
        assert np.abs(error).mean() < 0.01

    @pytest.mark.slow
    def test_paths_are_as_long_as_their_distances(self, white):
        rows = voxflat.surface(white).geodesic([17])
        for geodesic in ("graph", "edges"):
            path = voxflat.surface(white).path(17, 4321, geodesic=geodesic)
            np.testing.assert_array_equal(path.ids[[0, -1]], [17, 4321])
            assert path.length >= np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum() - 1e-3
            assert path.length >= rows[0][4321] - 1e-3
        assert voxflat.surface(white).path(17, 4321).length == pytest.approx(rows[0][4321], rel=1e-6)


class TestFlatten:
    @pytest.mark.medium
    def test_a_rolled_sheet_is_unrolled(self):
        mesh, places = rolled()
        flat = voxflat.flatten(mesh, Voxflat(sources=200))
        assert flat.distortion.raw.relative_error < 0.015
        np.testing.assert_allclose(apart(flat.uv)[::50], apart(places)[::50], atol=0.4)
        assert flat.distortion.triangles.flipped == 0
        assert flat.distortion.triangles.areal_median < 0.03
        assert (signed_areas(flat.uv, flat.faces) > 0).all()  # seen from outside

    @pytest.mark.slow
    def test_no_triangle_is_turned_over_and_descent_is_told(self, flat_map):
        of = flat_map.distortion.triangles
        assert (of.flipped, of.collapsed, of.crossings, of.covering) == (0, 0, 0, 0)
        descent = flat_map.metadata["descent"]
        assert descent["converged"]
        energies = np.array(descent["energies"])
        assert (np.diff(energies) < 0.01 * energies[0]).all()  # between rounds the scale is found anew
        assert energies[-1] < energies[0]

    @pytest.mark.slow
    def test_better_than_the_shipped_map_in_every_column(self, white, shipped, flat_map):
        ours, theirs = (voxflat.measure(white, flat, sources=20) for flat in (flat_map, shipped))
        for name in ("relative_error", "relative_error_10mm", "relative_error_30mm", "stress_1"):
            assert getattr(ours.best_scale, name) < getattr(theirs.best_scale, name)
        for name in ("edge", "areal_median", "areal_p95"):
            assert getattr(ours.triangles, name) < getattr(theirs.triangles, name)
        assert (theirs.triangles.flipped, theirs.triangles.crossings) == (0, 0)
        assert 0.1 < theirs.raw.relative_error < 0.13

    @pytest.mark.medium
    def test_bits_do_not_depend_on_threads(self):
        flat, *others = (voxflat.flatten(bump(), Voxflat(sources=80), threads=n) for n in (None, 1, 2, 3))
        for other in others:
            np.testing.assert_array_equal(flat.uv, other.uv)
            np.testing.assert_array_equal(flat.distortion.per_point, other.distortion.per_point)

    @pytest.mark.medium
    def test_moving_the_mesh_turns_nothing(self):
        points, faces = bump()
        flat = voxflat.flatten((points, faces), Voxflat(sources=60))
        moved = voxflat.flatten((points + np.array([100.0, -50.0, 7.0]), faces), Voxflat(sources=60))
        np.testing.assert_allclose(moved.uv, flat.uv, atol=1e-4)

    def test_measured_midway_between_white_and_pial(self, fsaverage, white):
        surface = voxflat.surface(white, pial=(fsaverage["pial"], fsaverage["faces"]))
        np.testing.assert_allclose(surface.points, fsaverage["mid"], atol=1e-5)
        assert surface.metadata["measured_on"].startswith("midthickness")
        np.testing.assert_array_equal(surface.ids, np.arange(len(fsaverage["white"])))

    def test_cuts_keep_ids_on_both_sides(self):
        points, faces = bump(20)
        path = np.arange(10 * 21, 10 * 21 + 11)
        flat = voxflat.flatten((points, faces), Voxflat(sources=40), cuts=[path])
        ids, counts = np.unique(flat.ids, return_counts=True)
        np.testing.assert_array_equal(ids[counts == 2], path[:-1])  # the last lies inside, the first on the boundary
        assert flat.metadata["cuts"] == [path.tolist()]
        both = np.flatnonzero(flat.ids == path[0])
        rows = voxflat.surface((points, faces)).cut([path], relax=False).surface.geodesic([path[0]])
        assert rows.shape[1] == len(points) + 10
        assert np.linalg.norm(flat.uv[both[0]] - flat.uv[both[1]]) > 5

    @pytest.mark.slow
    def test_voxels_of_real_anatomy(self):
        labels, affine, probability = anatomy.mni152_white_matter("left")
        surface = voxflat.surface(labels, affine=affine, probability=probability, repair="voxels")
        assert np.count_nonzero(surface.changed_voxels()) <= 0.0015 * labels.sum()
        assert surface.core.topology()["euler"] == 2
        seed = (60, 150, 120)  # and a patch of what lies around it: sulcal depth is measured on all of a surface
        near, ends = tuple(slice(at - 40, at + 40) for at in seed), tuple(slice(at + 44) for at in seed)
        part, chance = np.zeros((2, *labels.shape), np.float32)
        part[near], chance[near] = labels[near], probability[near]
        part = anatomy.largest_component(part[ends] > 0).astype(np.uint8)
        surface = voxflat.surface(part, affine=affine, probability=chance[ends], repair="voxels")
        flat = surface.disk(seed, 30.0).flatten(Voxflat(sources=150), relax=False)
        assert flat.distortion.raw.relative_error < 0.1
        assert labels[tuple(flat.ids.T)].mean() > 0.99


@pytest.mark.slow
class TestFiles:
    def test_a_map_of_a_mesh_is_saved_whole(self, flat_map, tmp_path):
        flat_map.save(tmp_path / "map.npz")
        again = voxflat.load(tmp_path / "map.npz")
        np.testing.assert_array_equal(again.ids, flat_map.ids)
        np.testing.assert_array_equal(again.distortion.triangles.areal, flat_map.distortion.triangles.areal)
        assert again.metadata == flat_map.metadata
        assert again.distortion.figures() == flat_map.distortion.figures()

    def test_an_overlay_is_shown_on_the_map(self, flat_map, fsaverage):
        sulc = fsaverage["sulc"]
        image = flat_map.image(sulc).data
        inside = ~np.isnan(image)
        assert inside.any()
        assert sulc.min() <= image[inside].min() <= image[inside].max() <= sulc.max()
        assert set(np.unique(flat_map.image((sulc > 0).astype(int)).data[inside])) == {0.0, 1.0}
        ids, points = flat_map.locate()
        assert (ids[inside] >= 0).all()
        assert np.isfinite(points[inside]).all()
        refused("the overlay has 5 values, but the mesh has 10242 vertices", flat_map.image, np.zeros(5))
        refused("no voxels to paint", flat_map.paint, np.zeros(len(flat_map)))


class TestPatches:
    @pytest.mark.slow
    def test_own_cuts_come_first_and_the_rest_is_automatic(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        points, _, faces = lab.hemisphere()
        seam = voxflat.surface((points, faces)).path(100, 1200, geodesic="edges").ids
        np.savetxt("seam.txt", seam, fmt="%d")
        write_mesh("lh.white", Mesh(points, faces))
        away = np.linalg.norm(points[:, None] - points[seam][None], axis=2).min(axis=1)
        np.save("wall.npy", np.linalg.norm(points - points[away.argmax()], axis=1) < 15)
        succeed(*["flatten", "lh.white", "--drop", "wall.npy", "--cuts", "seam.txt", "--sources", "60", "-o", "m.npz"])
        flat = voxflat.load("m.npz")
        assert flat.metadata["cuts"] == [seam.tolist()]
        ids, counts = np.unique(flat.ids, return_counts=True)
        assert np.isin(seam[1:-1], ids[counts > 1]).all()

    @pytest.mark.slow
    def test_disks_of_real_anatomy(self, white):
        for seed in (100, 2000, 7000):
            flat = voxflat.surface(white).disk(seed, 25.0).flatten(Voxflat(sources=60))
            assert flat.metadata["seed_found"] == seed
            assert flat.distortion.triangles.flipped_share < 0.05

    @pytest.mark.slow
    def test_check_counts_what_is_there(self):
        points, _, faces = lab.hemisphere(162)
        found = voxflat.check((points, faces))
        assert (found.euler_characteristic, found.closed, found.handles) == (2, True, ())
        assert found.components == (len(points),)
        assert found.can_flatten
        ring = voxflat.check((points, faces), part=lambda s: s.keep(np.abs(points[:, 2] - 20) < 25))
        assert ring.boundary
        assert str(len(ring.boundary)) in ring.table()


@pytest.mark.slow
def test_a_sheet_of_grey_matter_becomes_a_map():
    """The middle of grey matter from LayNii: mostly one voxel thick, folded, and with pinholes."""
    sheet = voxflat.surface(shapes.DATA / "laynii" / "occipital_midGM.nii.gz", threshold=0)
    assert sheet.metadata["sheet"]
    assert sheet.core.topology()["components"][0]["faces"] > 0.999 * len(sheet.faces)
    flat = voxflat.surface(sheet).disk((53, 49, 57), 30.0).flatten(Voxflat(sources=200))
    assert len(flat) > 2000
    assert [53, 49, 57] in flat.ids.tolist()
    reach = np.linalg.norm(flat.uv - flat.uv[(flat.ids == [53, 49, 57]).all(axis=1)][0], axis=1)
    assert 24 < reach.max() < 36
    assert flat.distortion.best_scale.relative_error < 0.07
    assert flat.distortion.triangles.flipped_share < 0.01


class TestMeasure:
    @pytest.mark.slow
    def test_a_map_of_our_own(self, white, shipped, flat_map):
        again = voxflat.measure(white, flat_map, sources=200, seed=flat_map.metadata["seed"], reference="graph")
        assert again.raw.relative_error == pytest.approx(flat_map.distortion.raw.relative_error, rel=1e-5)
        assert again.raw.stress_1 == pytest.approx(flat_map.distortion.raw.stress_1, rel=1e-5)
        assert again.triangles.flipped == flat_map.distortion.triangles.flipped

    @pytest.mark.medium
    @needs_workbench
    def test_areal_distortion_is_that_of_workbench(self, white, shipped, tmp_path):
        places, faces = shipped
        paths = [tmp_path / name for name in ("white.surf.gii", "flat.surf.gii", "out.func.gii")]
        write_mesh(paths[0], Mesh(white[0], faces, structure="CortexLeft"))
        write_mesh(paths[1], Mesh(places * [1, 1, 0], faces, structure="CortexLeft"))
        workbench("-surface-distortion", *paths)
        told = workbench("-file-information", paths[1])
        assert re.search(r"Structure: +CortexLeft.*Surface Type \(Primary\): +Flat", told, re.DOTALL)
        theirs = voxflat.io.read_overlay(paths[2], len(white[0]))[np.unique(faces)]
        np.testing.assert_allclose(voxflat.measure(paths[0], paths[1], sources=1).triangles.areal, theirs, atol=1e-4)
