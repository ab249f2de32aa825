"""Distances on a surface, its maps by every way in, and their distortion."""

import numpy as np
import pytest
from click.testing import CliRunner
from mesh_files import needs_workbench
from scipy.sparse.csgraph import dijkstra
from triangle_meshes import bump, rolled

import voxflat
from voxflat import cli
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.methods import Voxflat

pv = pytest.importorskip("pyvista")
import anatomy  # noqa: E402

pytest.importorskip("nilearn")


def apart(places):
    return np.linalg.norm(places[:, None] - places[None], axis=2)


class TestDistances:
    def test_links_are_paths_on_the_surface(self):
        """Never shorter than through the air, never longer than along edges; symmetric; the triangle inequality."""
        points, faces = bump()
        rows = np.asarray(voxflat.surface((points, faces)).geodesic(np.arange(0, len(points), 97)), dtype=float)
        sources = np.arange(0, len(points), 97)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        import scipy.sparse

        lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        graph = scipy.sparse.csr_matrix((lengths, edges.T), shape=(len(points),) * 2)
        along = dijkstra(graph, directed=False, indices=sources)
        air = np.linalg.norm(points[sources][:, None] - points[None], axis=2)
        assert (rows <= along * (1 + 1e-6)).all()
        assert (rows >= air * (1 - 1e-6)).all()
        among = rows[:, sources]
        np.testing.assert_allclose(among, among.T, rtol=1e-6)
        assert (among[:, None] <= among[:, :, None] + among[None] + 1e-4).all()

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
        for geodesic, least in (("graph", 1.0), ("edges", 1.0)):
            path = voxflat.surface(white).path(17, 4321, geodesic=geodesic)
            np.testing.assert_array_equal(path.ids[[0, -1]], [17, 4321])
            steps = np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum()
            assert path.length >= least * steps - 1e-3
            assert path.length >= rows[0][4321] - 1e-3
        assert voxflat.surface(white).path(17, 4321).length == pytest.approx(rows[0][4321], rel=1e-6)


class TestFlatten:
    def test_a_rolled_sheet_is_unrolled(self):
        mesh, places = rolled()
        flat = voxflat.flatten(mesh, Voxflat(sources=200))
        assert flat.distortion.raw.relative_error < 0.015
        np.testing.assert_allclose(apart(flat.uv)[::50], apart(places)[::50], atol=0.4)
        assert flat.distortion.triangles.flipped == 0
        assert flat.distortion.triangles.areal_median < 0.03
        # seen from outside
        u, v = (
            flat.uv[flat.faces[:, 1]] - flat.uv[flat.faces[:, 0]],
            flat.uv[flat.faces[:, 2]] - flat.uv[flat.faces[:, 0]],
        )
        assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all()

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

    @pytest.mark.parametrize("threads", [1, 2, 3])
    def test_bits_do_not_depend_on_threads(self, threads):
        flat, other = (voxflat.flatten(bump(), Voxflat(sources=80), threads=n) for n in (threads, None))
        np.testing.assert_array_equal(flat.uv, other.uv)
        np.testing.assert_array_equal(flat.distortion.per_point, other.distortion.per_point)

    def test_moving_the_mesh_turns_nothing(self):
        points, faces = bump()
        flat = voxflat.flatten((points, faces), Voxflat(sources=60))
        moved = voxflat.flatten((points + np.array([100.0, -50.0, 7.0]), faces), method=Voxflat(sources=60))
        np.testing.assert_allclose(moved.uv, flat.uv, atol=1e-4)

    @pytest.mark.slow
    def test_a_left_hemisphere_is_not_mirrored(self, flat_map):
        corners = flat_map.uv[flat_map.faces]
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).min() > 0  # seen from outside

    def test_measured_midway_between_white_and_pial(self, fsaverage, white):
        pial = (fsaverage["pial"], fsaverage["faces"])
        surface = voxflat.surface(white, pial=pial)
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
        changed = np.count_nonzero(surface.changed_voxels())
        assert changed <= 0.0015 * labels.sum()
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


class TestEveryWayIn:
    """The same patch through API, command line and PyVista (napari: test_napari.py) gives the same map, bit for bit."""

    @pytest.fixture(scope="class")
    def by_vertices(self, white, shipped):
        on_map = np.unique(shipped[1])
        rows = voxflat.surface(white).geodesic([on_map[len(on_map) // 2]])
        keep = np.zeros(len(white[0]), dtype=bool)
        keep[rows.ids] = rows[0] < 45
        return keep, voxflat.surface(white).keep(keep).flatten(Voxflat(sources=100))

    @pytest.mark.slow
    def test_command_line(self, white, by_vertices, tmp_path):
        keep, expected = by_vertices
        np.save(tmp_path / "keep.npy", keep)
        write_mesh(tmp_path / "white.vtp", Mesh(*white))
        arguments = ["flatten", "white.vtp", "--keep", "keep.npy", "--sources", "100", "-o", "map.npz"]
        arguments = [str(tmp_path / part) if "." in part else part for part in arguments]
        result = CliRunner().invoke(cli.main, arguments)
        assert result.exit_code == 0, result.output
        flat = voxflat.load(tmp_path / "map.npz")
        np.testing.assert_array_equal(flat.uv, expected.uv)
        np.testing.assert_array_equal(flat.ids, expected.ids)
        assert flat.distortion.figures() == expected.distortion.figures()

    @pytest.mark.slow
    def test_pyvista(self, white, fsaverage, by_vertices):
        keep, expected = by_vertices
        mesh = pv.PolyData.from_regular_faces(*white)
        mesh["sulc"], mesh["cortex"] = fsaverage["sulc"], keep
        flat = mesh.voxflat(keep="cortex", method=Voxflat(sources=100))
        np.testing.assert_array_equal(flat.points[:, :2], expected.uv)
        np.testing.assert_array_equal(flat["sulc"], fsaverage["sulc"][expected.ids])
        np.testing.assert_array_equal(flat["vertex_ids"], expected.ids)
        assert (flat.points[:, 2] == 0).all()

    @pytest.mark.slow
    def test_a_surface_made_before(self, white, by_vertices):
        keep, expected = by_vertices
        flat = voxflat.surface(white).keep(keep).flatten(Voxflat(sources=100))
        np.testing.assert_array_equal(flat.uv, expected.uv)

    @pytest.mark.slow
    def test_files(self, white, by_vertices, tmp_path):
        keep, expected = by_vertices
        for name in ("lh.white", "white.surf.gii", "white.ply", "white.obj"):
            write_mesh(tmp_path / name, Mesh(*white))
            flat = voxflat.surface(tmp_path / name).keep(keep).flatten(Voxflat(sources=100))
            moved = np.linalg.norm(flat.uv - expected.uv, axis=1)  # some formats hold f32
            assert moved.mean() < 0.5
            assert np.percentile(moved, 99) < 2  # single vertices, in pits that no map can keep, may move farther
            assert moved.max() < 0.05 * np.ptp(expected.uv, axis=0).min()


class TestMeasure:
    @pytest.mark.slow
    def test_a_map_of_our_own(self, white, shipped, flat_map):
        seed = flat_map.metadata["seed"]
        again = voxflat.measure(white, flat_map, sources=200, seed=seed, reference="graph")
        assert again.raw.relative_error == pytest.approx(flat_map.distortion.raw.relative_error, rel=1e-5)
        assert again.raw.stress_1 == pytest.approx(flat_map.distortion.raw.stress_1, rel=1e-5)
        assert again.triangles.flipped == flat_map.distortion.triangles.flipped

    @pytest.mark.slow
    def test_the_shipped_map_has_no_flips(self, white, shipped):
        found = voxflat.measure(white, shipped, sources=30)
        assert (found.triangles.flipped, found.triangles.crossings) == (0, 0)
        assert 0.1 < found.raw.relative_error < 0.13

    def test_a_perfect_map(self):
        mesh, places = rolled()
        found = voxflat.measure(mesh, places, sources=20)
        assert found.raw.relative_error < 0.01  # that of the straight links
        assert found.triangles.areal_p95 < 1e-3
        assert found.triangles.edge < 1e-3

    @pytest.mark.slow
    def test_files_of_every_kind_say_the_same(self, white, flat_map, tmp_path):
        write_mesh(tmp_path / "lh.white", Mesh(*white))
        figures = {}
        for name in ("map.npz", "map.surf.gii", "map.patch.flat"):
            flat_map.save(tmp_path / name)
            figures[name] = voxflat.measure(tmp_path / "lh.white", tmp_path / name, sources=10)
        arguments = ["measure", tmp_path / "lh.white", tmp_path / name, "--sources", "10"]
        result = CliRunner().invoke(cli.main, [str(part) for part in arguments])
        assert result.exit_code == 0, result.output
        assert figures[name].table() in result.output
        errors = [found.raw.relative_error for found in figures.values()]
        scatter = [found.standard_error.raw.relative_error for found in figures.values()]
        assert errors[1] == pytest.approx(errors[0], rel=1e-4)
        assert abs(errors[2] - errors[0]) < 3 * np.hypot(scatter[0], scatter[2])  # of other sources

    @needs_workbench
    def test_areal_distortion_is_that_of_workbench(self, white, shipped, tmp_path):
        import subprocess

        places, faces = shipped
        paths = [tmp_path / name for name in ("white.surf.gii", "flat.surf.gii", "out.func.gii")]
        write_mesh(paths[0], Mesh(white[0], faces, structure="CortexLeft"))
        write_mesh(paths[1], Mesh(places * [1, 1, 0], faces, structure="CortexLeft"))
        information = subprocess.run(["wb_command", "-file-information", paths[1]], capture_output=True, text=True)
        assert "CORTEX_LEFT" in information.stdout.upper().replace("CORTEXLEFT", "CORTEX_LEFT")
        subprocess.run(["wb_command", "-surface-distortion", *paths], check=True, capture_output=True)
        theirs = voxflat.io.read_overlay(paths[2], len(white[0]))[np.unique(faces)]
        ours = voxflat.measure(paths[0], paths[1], sources=1).triangles.areal
        np.testing.assert_allclose(ours, theirs, atol=1e-4)
