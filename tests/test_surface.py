"""Surfaces of voxels and of meshes, and what is done with both alike."""

import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_files import needs_workbench
from scipy.sparse.csgraph import dijkstra

import voxflat
from voxflat import cli
from voxflat.io.freesurfer import Patch, read_patch, write_patch
from voxflat.io.meshes import Mesh, read_mesh, write_mesh

pv = pytest.importorskip("pyvista")
sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "benchmarks"))
import anatomy  # noqa: E402

pytest.importorskip("nilearn")


@pytest.fixture(scope="module")
def fsaverage():
    return anatomy.fsaverage5("left")


@pytest.fixture(scope="module")
def white(fsaverage):
    return fsaverage["white"], fsaverage["faces"]


@pytest.fixture(scope="module")
def shipped(fsaverage):
    """FreeSurfer's flat map of the same vertices."""
    places, faces = fsaverage["flat"]
    return np.nan_to_num(places), faces


@pytest.fixture(scope="module")
def flat_map(white, shipped):
    return voxflat.flatten(white, keep=shipped, sources=150)


def bump(size=30):
    """A mesh over a square with a bump in its middle."""
    i, j = np.mgrid[: size + 1, : size + 1].astype(float)
    z = 6 * np.exp(-((i - size / 2) ** 2 + (j - size / 2) ** 2) / 30)
    corner = np.arange((size + 1) ** 2).reshape(size + 1, size + 1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    points = np.stack([i.ravel(), j.ravel(), z.ravel()], axis=1)
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def rolled(radius=10.0, angle=2.0, size=40):
    """A part of a cylinder as a mesh, and where it lies when it is unrolled."""
    s, t = np.meshgrid(np.linspace(0, radius * angle, size + 1), np.linspace(0, 20, size + 1), indexing="ij")
    points = np.stack([radius * np.sin(s / radius), t, radius * np.cos(s / radius)], axis=2).reshape(-1, 3)
    _, faces = bump(size)
    return (points, faces), np.stack([s.ravel(), t.ravel()], axis=1)


def apart(places):
    return np.linalg.norm(places[:, None] - places[None], axis=2)


class TestFromVoxels:
    @settings(max_examples=60, deadline=None)
    @given(st.integers(0, 2**32), st.floats(0.2, 0.8), st.integers(3, 9))
    def test_a_blob_is_a_closed_manifold_of_its_voxels(self, seed, share, size):
        from scipy.ndimage import gaussian_filter

        noise = gaussian_filter(np.random.default_rng(seed).normal(size=(size,) * 3), 0.8)
        volume = (noise > np.quantile(noise, share)).astype(np.uint8)
        surface = voxflat.surface(volume, sheet=False)
        topology = surface.core.topology()
        edges = np.sort(np.concatenate([surface.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1)
        _, counts = np.unique(edges, axis=0, return_counts=True)
        assert (counts == 2).all()
        assert topology["loops"] == []
        assert topology["euler"] == len(surface) - len(counts) + len(surface.faces)
        assert topology["euler"] % 2 == 0
        padded = np.pad(volume, 1)
        open_side = [np.roll(padded, step, axis) == 0 for axis in range(3) for step in (-1, 1)]
        expected = np.argwhere((padded != 0) & np.any(open_side, axis=0)) - 1
        np.testing.assert_array_equal(np.unique(surface.ids, axis=0), expected)

    def test_faces_look_outside_whatever_the_axes(self):
        ball = shapes.ball(8)
        for flip in ([1, 1, 1], [-1, 1, 1], [-1, -1, 1], [2, -1, 0.5]):
            surface = voxflat.surface(ball, affine=np.diag([*flip, 1.0]))
            corners = surface.points[surface.faces]
            volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
            assert volume == pytest.approx(ball.sum() * abs(np.prod(flip)), rel=0.1)

    @pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.6, 0.6, 3.0), (2.0, 0.5, 1.0)])
    def test_points_lie_near_the_surface(self, spacing):
        shape = [int(np.ceil(30 / h)) for h in spacing]
        ijk = np.indices(shape).reshape(3, -1).T * spacing
        inside = (11.3 - np.linalg.norm(ijk - 14.2, axis=1)).reshape(shape).astype(np.float32)
        off = {}
        for name, options in {"fit": {"label": 1}, "level": {"threshold": 0.0}}.items():
            volume = (inside > 0).astype(np.uint8) if name == "fit" else inside
            surface = voxflat.surface(volume, spacing=spacing, **options)
            off[name] = np.abs(np.linalg.norm(surface.points - 14.2, axis=1) - 11.3).mean() / max(spacing)
        assert off["fit"] < 0.16
        assert off["level"] < 0.05

    def test_how_points_were_placed_is_recorded(self):
        ball = shapes.ball(6)
        distance = np.linalg.norm(np.indices(ball.shape) - 8.0, axis=0)
        smooth = np.clip(6.5 - distance, 0, 1).astype(np.float32)
        assert voxflat.surface(ball).metadata["placed_by"] == "a fit to the voxels"
        assert voxflat.surface(smooth, threshold=0.5).metadata["placed_by"] == "the level 0.5 of the volume"
        assert voxflat.surface(smooth > 0.5, probability=smooth).metadata["placed_by"] == "the level 0.5 of an image"
        # a mask stored as numbers has no level between its voxels
        assert voxflat.surface(ball.astype(float), threshold=0.5).metadata["placed_by"] == "a fit to the voxels"
        for probability, message in ((smooth[:-1], "has shape"), (smooth * np.nan, "not finite")):
            with pytest.raises(voxflat.InputError, match=message):
                voxflat.surface(ball, probability=probability)

    def test_repair_leaves_a_sphere_and_tells_every_voxel(self, tmp_path):
        i, j, k = np.indices((30, 30, 14)) - np.array([15, 15, 7])[:, None, None, None]
        torus = (np.hypot(np.hypot(i, j) - 9, k) < 4).astype(np.uint8)
        assert voxflat.surface(torus).core.topology()["handles"] == 1
        repaired = voxflat.surface(torus, repair="voxels")
        assert repaired.core.topology()["euler"] == 2
        changed = repaired.changed_voxels()
        assert (torus[changed == 1] == 1).all()
        assert (torus[changed == 2] == 0).all()
        mended = np.where(changed == 1, 0, np.where(changed == 2, 1, torus))
        np.testing.assert_array_equal(voxflat.surface(mended).ids, repaired.ids)
        assert repaired.remarks[0].startswith("1 handle(s) were repaired: ")
        cut = voxflat.surface(torus, repair="cuts")
        assert cut.core.topology()["handles"] == 0
        assert len(cut.metadata["handles_cut"]) == 1
        np.testing.assert_array_equal(np.unique(cut.ids, axis=0), np.unique(voxflat.surface(torus).ids, axis=0))
        np.save(tmp_path / "torus.npy", torus)
        written = tmp_path / "changed.nii.gz"
        arguments = ["surface", tmp_path / "torus.npy", "--repair", "voxels", "--repaired", written]
        result = CliRunner().invoke(cli.main, [*map(str, arguments), "-o", str(tmp_path / "out.surf.gii")])
        assert result.exit_code == 0, result.output
        np.testing.assert_array_equal(voxflat.io.read_volume(written).data, changed)
        np.testing.assert_allclose(read_mesh(tmp_path / "out.surf.gii").points, repaired.points, atol=1e-5)

    def test_banks_that_touch_stay_apart(self):
        # two plates that touch along a row of edges only, joined far away
        volume = np.zeros((40, 20, 12), np.uint8)
        volume[2:38, 2:18, 2:5] = volume[2:38, 2:18, 7:10] = 1
        volume[2:5, 2:18, 2:10] = 1
        volume[30, 2:18, 5] = volume[29, 2:18, 6] = 1  # edges of these touch
        surface = voxflat.surface(volume)
        a, b = surface.find([[30, 10, 5], [29, 10, 6]])
        assert voxflat.geodesic(surface, surface.ids[[a]])[0][b] > 40
        assert voxflat.geodesic(volume, [[30, 10, 5]], geodesic="chain")[0].min() == 0
        assert voxflat.path(volume, (30, 10, 5), (29, 10, 6), geodesic="chain").length < 2


class TestSheets:
    @pytest.mark.slow
    @pytest.mark.parametrize("traversed", [False, True])
    def test_the_papers_curled_sheet_is_unrolled(self, traversed):
        """One surface with a boundary, not a pillow; its flat map is as long and wide as the sheet was."""
        from scipy.spatial.transform import Rotation

        volume = shapes.curled_sheet(rotation=Rotation.random(rng=4), traversed=traversed)
        flat = voxflat.flatten(volume, sources=150)
        assert flat.metadata["sheet"]
        assert flat.metadata["automatic_cuts"] == []
        assert flat.distortion.raw.relative_error < 0.005
        assert flat.distortion.triangles.areal_median < 0.1
        centred = flat.uv - flat.uv.mean(axis=0)
        sides = np.ptp(centred @ np.linalg.svd(centred, full_matrices=False)[2].T, axis=0)
        np.testing.assert_allclose(sides, [88, 44], atol=2.5)
        assert flat.distortion.triangles.flipped <= 3

    def test_a_level_sheet_has_every_voxel_once(self):
        surface = voxflat.surface(shapes.sheet((20, 30)))
        assert surface.metadata["sheet"]
        assert (len(surface), len(surface.faces)) == (600, 2 * 19 * 29)
        assert np.linalg.norm(surface.points - surface.ids, axis=1).max() < 1e-6
        pillow = voxflat.surface(shapes.sheet((20, 30)), sheet=False)
        assert pillow.core.topology()["euler"] == 2

    def test_a_sheet_on_a_slope_may_be_a_strip_of_edges(self):
        i, _, k = np.indices((20, 20, 20))
        surface = voxflat.surface((i + k == 19).astype(np.uint8))  # neighbours touch along edges alone
        topology = surface.core.topology()
        assert (topology["euler"], len(topology["components"])) == (1, 1)
        np.testing.assert_allclose(surface.points[:, [0, 2]].sum(axis=1), 19, atol=1e-6)

    @pytest.mark.slow
    def test_a_closed_organ_is_cut_open(self):
        i, j, k = np.indices((60, 44, 34)) - np.array([30, 22, 17])[:, None, None, None]
        kidney = ((i / 26) ** 2 + ((j - 0.012 * i**2) / 15) ** 2 + (k / 12) ** 2 < 1).astype(np.uint8)
        flat = voxflat.flatten(kidney, sources=200)
        first, *further = flat.metadata["automatic_cuts"]
        assert first["reason"] == "closed sphere"
        assert {cut["reason"] for cut in further} == {"relaxation"}
        assert len(np.unique(flat.ids, axis=0)) == len(np.unique(voxflat.surface(kidney).ids, axis=0))
        assert flat.distortion.raw.relative_error < 0.35


class TestDistances:
    def test_links_are_paths_on_the_surface(self):
        """Never shorter than through the air, never longer than along edges; symmetric; the triangle inequality."""
        points, faces = bump()
        rows = np.asarray(voxflat.geodesic((points, faces), np.arange(0, len(points), 97)), dtype=float)
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
        rows = voxflat.geodesic(mesh, [0, 800, 1680])
        expected = apart(places)[[0, 800, 1680]]
        far = expected > 2
        error = np.asarray(rows)[far] / expected[far] - 1
        assert -1e-3 < error.min() <= error.max() < 0.03
        assert np.abs(error).mean() < 0.01

    def test_paths_are_as_long_as_their_distances(self, white):
        rows = voxflat.geodesic(white, [17])
        for geodesic, least in (("graph", 1.0), ("edges", 1.0)):
            path = voxflat.path(white, 17, 4321, geodesic=geodesic)
            np.testing.assert_array_equal(path.ids[[0, -1]], [17, 4321])
            steps = np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum()
            assert path.length >= least * steps - 1e-3
            assert path.length >= rows[0][4321] - 1e-3
        assert voxflat.path(white, 17, 4321).length == pytest.approx(rows[0][4321], rel=1e-6)


class TestFlatten:
    def test_a_rolled_sheet_is_unrolled(self):
        mesh, places = rolled()
        flat = voxflat.flatten(mesh, sources=200)
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
        ours, theirs = (voxflat.measure(white, flat, sources=60) for flat in (flat_map, shipped))
        for name in ("relative_error", "relative_error_10mm", "relative_error_30mm", "stress_1"):
            assert getattr(ours.best_scale, name) < getattr(theirs.best_scale, name)
        for name in ("edge", "areal_median", "areal_p95"):
            assert getattr(ours.triangles, name) < getattr(theirs.triangles, name)

    @pytest.mark.parametrize("threads", [1, 2, 3])
    def test_bits_do_not_depend_on_threads(self, threads):
        flat, other = (voxflat.flatten(bump(), sources=80, threads=n) for n in (threads, None))
        np.testing.assert_array_equal(flat.uv, other.uv)
        np.testing.assert_array_equal(flat.distortion.per_point, other.distortion.per_point)

    def test_moving_the_mesh_turns_nothing(self):
        points, faces = bump()
        flat = voxflat.flatten((points, faces), sources=60)
        moved = voxflat.flatten((points + np.array([100.0, -50.0, 7.0]), faces), sources=60)
        np.testing.assert_allclose(moved.uv, flat.uv, atol=1e-4)

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
        flat = voxflat.flatten((points, faces), cuts=[path], sources=40)
        ids, counts = np.unique(flat.ids, return_counts=True)
        np.testing.assert_array_equal(ids[counts == 2], path[:-1])  # the last lies inside, the first on the boundary
        assert flat.metadata["cuts"] == [path.tolist()]
        both = np.flatnonzero(flat.ids == path[0])
        rows = voxflat.geodesic((points, faces), [path[0]], cuts=[path])
        assert rows.shape[1] == len(points) + 10
        assert np.linalg.norm(flat.uv[both[0]] - flat.uv[both[1]]) > 5

    @pytest.mark.slow
    def test_voxels_of_real_anatomy(self):
        labels, affine, probability = anatomy.mni152_white_matter("left")
        surface = voxflat.surface(labels, affine=affine, probability=probability, repair="voxels")
        changed = np.count_nonzero(surface.changed_voxels())
        assert changed <= 0.0015 * labels.sum()
        assert surface.core.topology()["euler"] == 2
        flat = voxflat.flatten(surface, seed_point=(60, 150, 120), radius=30.0, sources=150)
        assert flat.distortion.raw.relative_error < 0.1
        assert labels[tuple(flat.ids.T)].mean() > 0.99


class TestEveryWayIn:
    """The same patch through API, command line and PyVista (napari: test_napari.py) gives the same map, bit for bit."""

    @pytest.fixture(scope="class")
    def by_vertices(self, white, shipped):
        keep = np.zeros(len(white[0]), dtype=bool)
        keep[np.unique(shipped[1])] = True
        return keep, voxflat.flatten(white, keep=keep, sources=100)

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

    def test_pyvista(self, white, fsaverage, by_vertices):
        keep, expected = by_vertices
        mesh = pv.PolyData.from_regular_faces(*white)
        mesh["sulc"], mesh["cortex"] = fsaverage["sulc"], keep
        flat = mesh.voxflat(keep="cortex", sources=100)
        np.testing.assert_array_equal(flat.points[:, :2], expected.uv)
        np.testing.assert_array_equal(flat["sulc"], fsaverage["sulc"][expected.ids])
        np.testing.assert_array_equal(flat["vertex_ids"], expected.ids)
        assert (flat.points[:, 2] == 0).all()

    def test_a_surface_made_before(self, white, by_vertices):
        keep, expected = by_vertices
        flat = voxflat.flatten(voxflat.surface(white), keep=keep, sources=100)
        np.testing.assert_array_equal(flat.uv, expected.uv)

    def test_files(self, white, by_vertices, tmp_path):
        keep, expected = by_vertices
        for name in ("lh.white", "white.surf.gii", "white.ply", "white.obj"):
            write_mesh(tmp_path / name, Mesh(*white))
            flat = voxflat.flatten(tmp_path / name, keep=keep, sources=100)
            moved = np.linalg.norm(flat.uv - expected.uv, axis=1)  # some formats hold f32
            assert moved.mean() < 0.5
            assert np.percentile(moved, 99) < 2  # single vertices, in pits that no map can keep, may move farther
            assert moved.max() < 0.05 * np.ptp(expected.uv, axis=0).min()


class TestMeasure:
    def test_a_map_of_our_own(self, white, shipped, flat_map):
        seed = flat_map.metadata["seed"]
        again = voxflat.measure(white, flat_map, sources=200, seed=seed, reference="graph")
        assert again.raw.relative_error == pytest.approx(flat_map.distortion.raw.relative_error, rel=1e-5)
        assert again.raw.stress_1 == pytest.approx(flat_map.distortion.raw.stress_1, rel=1e-5)
        assert again.triangles.flipped == flat_map.distortion.triangles.flipped

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

    def test_files_of_every_kind_say_the_same(self, white, flat_map, tmp_path):
        write_mesh(tmp_path / "lh.white", Mesh(*white))
        figures = {}
        for name in ("map.npz", "map.surf.gii", "map.patch.flat"):
            flat_map.save(tmp_path / name)
            arguments = ["measure", tmp_path / "lh.white", tmp_path / name, "--sources", "30"]
            result = CliRunner().invoke(cli.main, [str(part) for part in arguments])
            assert result.exit_code == 0, result.output
            figures[name] = voxflat.measure(tmp_path / "lh.white", tmp_path / name, sources=30)
        errors = [found.raw.relative_error for found in figures.values()]
        np.testing.assert_allclose(errors, errors[0], rtol=0.04)  # a patch has no triangles between border vertices

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


class TestFiles:
    def test_a_map_of_a_mesh_is_saved_whole(self, flat_map, tmp_path):
        flat_map.save(tmp_path / "map.npz")
        again = voxflat.load(tmp_path / "map.npz")
        np.testing.assert_array_equal(again.ids, flat_map.ids)
        np.testing.assert_array_equal(again.distortion.triangles.areal, flat_map.distortion.triangles.areal)
        assert again.metadata == flat_map.metadata
        assert again.distortion.figures() == flat_map.distortion.figures()

    def test_flat_surfaces_keep_the_vertex_numbers(self, flat_map, white, tmp_path):
        flat_map.save(tmp_path / "flat.surf.gii")
        mesh = read_mesh(tmp_path / "flat.surf.gii")
        assert len(mesh.points) == len(white[0])
        np.testing.assert_allclose(mesh.points[flat_map.ids][:, :2], flat_map.uv, atol=1e-4)
        np.testing.assert_array_equal(mesh.faces, flat_map.ids[flat_map.faces])

    def test_patches(self, flat_map, tmp_path):
        flat_map.save(tmp_path / "lh.cortex.patch.flat")
        patch = read_patch(tmp_path / "lh.cortex.patch.flat")
        np.testing.assert_array_equal(patch.vertex_ids, np.sort(flat_map.ids))
        write_patch(tmp_path / "again", Patch(patch.vertex_ids, patch.points, patch.border))
        assert (tmp_path / "again").read_bytes() == (tmp_path / "lh.cortex.patch.flat").read_bytes()

    def test_a_patch_says_what_to_keep(self, white, flat_map, tmp_path):
        flat_map.save(tmp_path / "lh.patch.flat")
        again = voxflat.flatten(white, keep=tmp_path / "lh.patch.flat", sources=50)
        assert len(again) >= len(flat_map) - 20

    def test_an_overlay_is_shown_on_the_map(self, flat_map, fsaverage):
        image = flat_map.image(fsaverage["sulc"])
        inside = ~np.isnan(image.data)
        assert inside.any()
        assert (
            fsaverage["sulc"].min() <= image.data[inside].min() <= image.data[inside].max() <= fsaverage["sulc"].max()
        )
        labels = flat_map.image((fsaverage["sulc"] > 0).astype(int))
        assert set(np.unique(labels.data[inside])) == {0.0, 1.0}
        ids, points = flat_map.locate()
        assert ids.shape == image.data.shape
        assert (ids[inside] >= 0).all()
        assert np.isfinite(points[inside]).all()
        with pytest.raises(voxflat.InputError, match="the overlay has 5 values; the mesh has 10242 vertices"):
            flat_map.image(np.zeros(5))
        with pytest.raises(voxflat.InputError, match="no voxels to paint"):
            flat_map.paint(np.zeros(len(flat_map)))


class TestPatches:
    def test_own_cuts_come_first_and_the_rest_is_automatic(self, white, tmp_path):
        seam = voxflat.path(white, 100, 5000, geodesic="edges").ids
        np.savetxt(tmp_path / "seam.txt", seam, fmt="%d")
        write_mesh(tmp_path / "lh.white", Mesh(*white))
        away = np.linalg.norm(white[0][:, None] - white[0][seam][None], axis=2).min(axis=1)
        np.save(tmp_path / "wall.npy", np.linalg.norm(white[0] - white[0][away.argmax()], axis=1) < 15)
        arguments = ["flatten", "lh.white", "--drop", "wall.npy", "--cut", "seam.txt", "--sources", "60", "-o", "m.npz"]
        arguments = [str(tmp_path / part) if "." in part else part for part in arguments]
        result = CliRunner().invoke(cli.main, arguments)
        assert result.exit_code == 0, result.output
        flat = voxflat.load(tmp_path / "m.npz")
        assert flat.metadata["cuts"] == [seam.tolist()]
        ids, counts = np.unique(flat.ids, return_counts=True)
        assert np.isin(seam[1:-1], ids[counts > 1]).all()

    def test_dropping_is_the_opposite_of_keeping(self, white):
        chosen = white[0][:, 2] > 20
        kept, dropped = (voxflat.surface(white) for _ in range(2))
        a = voxflat.geodesic(kept, 1, keep=chosen)
        b = voxflat.geodesic(dropped, 1, drop=~chosen)
        np.testing.assert_array_equal(a.ids, b.ids)

    def test_disks_of_real_anatomy(self, white):
        for seed in (100, 2000, 7000):
            flat = voxflat.flatten(white, seed_point=seed, radius=25.0, sources=60)
            assert flat.metadata["seed_found"] == seed
            assert flat.distortion.triangles.flipped_share < 0.05

    def test_check_counts_what_is_there(self, white):
        found = voxflat.check(white)
        assert (found.euler_characteristic, found.closed, found.handles) == (2, True, ())
        assert found.components == (len(white[0]),)
        assert found.can_flatten
        ring = voxflat.check(white, keep=np.abs(white[0][:, 2] - 20) < 15)
        assert ring.boundary
        assert str(len(ring.boundary)) in ring.table()


def test_a_sheet_of_grey_matter_becomes_a_map():
    """The middle of grey matter as LayNii makes it: one voxel thick where it can be, folded, with pinholes."""
    sheet = voxflat.surface(shapes.DATA / "laynii" / "occipital_midGM.nii.gz", threshold=0)
    assert sheet.metadata["sheet"]
    assert sheet.core.topology()["components"][0]["faces"] > 0.999 * len(sheet.faces)
    flat = voxflat.flatten(sheet, seed_point=(53, 49, 57), radius=30.0)
    assert len(flat) > 2000
    assert [53, 49, 57] in flat.ids.tolist()
    reach = np.linalg.norm(flat.uv - flat.uv[(flat.ids == [53, 49, 57]).all(axis=1)][0], axis=1)
    assert 24 < reach.max() < 36
    assert flat.distortion.best_scale.relative_error < 0.07
    assert flat.distortion.triangles.flipped_share < 0.01
