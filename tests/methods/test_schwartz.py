"""Flattening after Schwartz, Shaw and Wolfson (1989)."""

import json

import composed
import mesh_files
import numpy as np
import pytest
import shapes
from click.testing import CliRunner
from scipy.linalg import orthogonal_procrustes
from scipy.spatial.distance import pdist, squareform
from triangle_meshes import cylinder

import voxflat
from voxflat import Cancelled, InputError, figures
from voxflat.cli import main
from voxflat.methods import Schwartz1989

SMALL = (21, 16)
schwartz1989 = {"method": "schwartz1989", "sources": 20}


def apart(uv, other):
    """Return how far two maps are apart (RMS) after the best rotation or reflection."""
    uv, other = uv - uv.mean(axis=0), other - other.mean(axis=0)
    turn, _ = orthogonal_procrustes(other, uv)
    return np.sqrt(((other @ turn - uv) ** 2).sum(axis=1).mean())


def hemisphere():
    """Return half a sphere of radius 10 from its pole, in rings of six more nodes each."""
    points, start = [(0.0, 0.0)], [0]
    for ring in range(1, 9):
        start.append(len(points))
        points += [(ring / 8 * np.pi / 2, 2 * np.pi * n / (6 * ring)) for n in range(6 * ring)]
    faces = []
    for ring in range(1, 9):
        for side in range(6):
            for n in range(ring):
                outer = [start[ring] + (side * ring + n + more) % (6 * ring) for more in (0, 1)]
                inside = [start[ring - 1] + (side * (ring - 1) + n + more) % max(6 * (ring - 1), 1) for more in (0, 1)]
                faces.append([*outer, inside[0]])
                if n < ring - 1:
                    faces.append([outer[1], inside[1], inside[0]])
    polar, around = np.array(points).T
    places = [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)]
    return 10 * np.stack(places, axis=1), np.array(faces)


class TestFlatten:
    @pytest.mark.slow
    @pytest.mark.parametrize("neighbourhood", [None, 1, 3, "all"])
    def test_a_cylinder_is_unrolled(self, neighbourhood):
        mesh, truth = cylinder(SMALL)
        flat = composed.flatten(mesh, **schwartz1989, neighbourhood=neighbourhood)
        assert apart(flat.uv, truth[flat.ids]) < 0.02
        assert flat.distortion.triangles.flipped == 0
        metadata = flat.metadata
        assert metadata["method"] == "schwartz1989"
        assert metadata["neighbourhood"] == neighbourhood or neighbourhood is None
        assert metadata["descent"]["converged"]
        assert len(metadata["starts"]) == 3
        assert min(metadata["starts"]) == min(metadata["descent"]["energies"])
        assert metadata["warnings"] == []
        assert (metadata["pairs"] == 336 * 335 / 2) == (neighbourhood == "all")

    def test_it_keeps_exact_distances_by_sammons_stress(self):
        flat = voxflat.flatten(
            hemisphere(), method=Schwartz1989(sources=217, neighbourhood="all"), relax=False, rows=True
        )
        assert flat.rows.shape == (217, 217)
        rows = flat.rows[np.argsort(flat.sources)].astype(float)
        delta = squareform(np.minimum(rows, rows.T), checks=False)
        distances = pdist(flat.uv)
        stress = ((distances - delta) ** 2 / delta).sum() / delta.sum()
        assert stress == pytest.approx(min(flat.metadata["starts"]), rel=1e-4)

    @pytest.mark.slow
    @pytest.mark.parametrize("mesh", [hemisphere(), cylinder(SMALL)[0]], ids=["hemisphere", "cylinder"])
    def test_random_starts_end_in_the_same_map(self, mesh):
        options = {"method": "schwartz1989", "sources": list(range(0, 200, 5))}
        maps = [composed.flatten(mesh, **options, seed=seed) for seed in range(4)]
        assert not np.array_equal(maps[0].uv, maps[1].uv)
        for other in maps[1:]:
            assert apart(maps[0].uv, other.uv) < 0.05
            assert min(other.metadata["starts"]) == pytest.approx(min(maps[0].metadata["starts"]), rel=1e-3, abs=1e-8)

    @pytest.mark.parametrize("seed", range(4))
    def test_the_map_is_seen_from_outside(self, seed):
        flat = composed.flatten(hemisphere(), **schwartz1989, seed=seed)
        a, b, c = np.moveaxis(flat.uv[flat.faces], 1, 0)
        assert ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() > 0

    def test_short_distances_alone_fold_and_it_is_said(self):
        flat = voxflat.flatten(cylinder((41, 31))[0], method=Schwartz1989(sources=0, neighbourhood=1))
        assert flat.distortion.raw.relative_error > 0.1
        assert any("turned over" in warning for warning in flat.metadata["warnings"])
        assert any("by one of them only" in warning for warning in flat.metadata["warnings"])
        assert flat.metadata["planarity"] is None
        assert len(flat.sources) == len(flat.eigenvalues) == 0
        with pytest.raises(InputError, match="without sources"):
            figures.spectrum(flat)

    @pytest.mark.slow
    def test_the_same_bits_for_any_number_of_threads(self):
        maps = [composed.flatten(hemisphere(), **schwartz1989, threads=n) for n in (1, 2, 5)]
        for other in maps[1:]:
            np.testing.assert_array_equal(maps[0].uv, other.uv)
            assert maps[0].metadata["descent"] == other.metadata["descent"]

    @pytest.mark.slow
    def test_a_patch_of_the_cortex(self):
        white, pial = (str(mesh_files.fsaverage5(name)) for name in ("white_left", "pial_left"))
        patch = {"seed_point": 4000, "radius": 26.0}
        surface = voxflat.surface(white, pial=pial)
        flat = composed.flatten(surface, method="schwartz1989", **patch)
        usual = composed.flatten(surface, **patch)
        assert len(flat) == len(usual)
        assert flat.distortion.raw.sammon_stress < 1.2 * usual.distortion.raw.sammon_stress

    def test_volumes_are_flattened_too(self):
        flat = composed.flatten(shapes.curled_sheet(20, 15, 0.5), **schwartz1989)
        assert flat.is_voxels
        assert flat.distortion.raw.relative_error < 0.03

    def test_the_smallest_surfaces_are_flattened(self):
        corners = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 2, 1.0]])
        for faces in ([[0, 1, 2]], [[0, 1, 2], [1, 3, 2]]):
            points = corners[: len(faces) + 2]
            flat = voxflat.flatten((points, np.array(faces)), method=Schwartz1989(starts=5))
            flat_sides, sides = (x[flat.faces] - x[np.roll(flat.faces, 1, axis=1)] for x in (flat.uv, flat.points))
            np.testing.assert_allclose(np.linalg.norm(flat_sides, axis=2), np.linalg.norm(sides, axis=2), rtol=1e-3)

    def test_a_map_is_kept_in_a_file(self, tmp_path):
        for sources in (0, 20):
            flat = voxflat.flatten(hemisphere(), method=Schwartz1989(sources=sources, starts=1))
            flat.save(tmp_path / "map.npz")
            again = voxflat.load(tmp_path / "map.npz")
            np.testing.assert_array_equal(again.uv, flat.uv)
            assert again.metadata == flat.metadata

    @pytest.mark.slow
    def test_it_can_be_cancelled_in_each_stage(self):
        mesh, _ = cylinder((41, 31))  # large enough that each stage is seen
        for last in ("measuring neighbourhoods", "moving points from a random start"):
            with pytest.raises(Cancelled):
                composed.flatten(mesh, **schwartz1989, progress=lambda stage, *_, last=last: stage != last)


class TestBadInput:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"neighbourhood": 0}, "the neighbourhood is 0; give a number of rings, 1 or more, or 'all'"),
            ({"neighbourhood": "most"}, "the neighbourhood is 'most'; give a number of rings"),
            ({"neighbourhood": 2.5}, "the neighbourhood is 2.5; give"),
            ({"neighbourhood": True}, "the neighbourhood is True; give"),
            ({"neighbourhood": 2**40}, "the neighbourhood is 1099511627776; give"),
            ({"starts": 0}, "starts is 0; give a number of random starts, 1 or more"),
            ({"starts": "3"}, "starts is '3'; give"),
            ({"sources": 2}, "2 sources are too few; give at least 3"),
            ({"sources": [4, 4, 9]}, "source 4 is given 2 times"),
            ({"sources": 0, "rows": True}, "sources is 0, so there are no rows to keep"),
            ({"sampling": "grid"}, "give 'farthest', 'curvature' or 'random'"),
            ({"rows": "directory"}, "cannot write a store"),
        ],
    )
    def test_wrong_options_are_named(self, options, message):
        with pytest.raises(InputError, match=message):
            composed.flatten(cylinder(SMALL)[0], **{"method": "schwartz1989", **options})

    def test_what_does_not_fit_into_memory_is_refused_with_numbers(self):
        mesh, _ = cylinder((201, 161))
        pattern = (
            r"[\d.]+ GiB of memory are needed, 4.00 GiB is the limit; distances among all of 32361 points are kept"
        )
        with pytest.raises(InputError, match=pattern + ".*take the method 'voxflat'"):
            voxflat.flatten(mesh, method=Schwartz1989(neighbourhood="all"), memory_limit=4 << 30)


class TestCommandLine:
    @pytest.mark.slow
    def test_it_has_the_method_and_its_options(self, tmp_path):
        mesh, _ = cylinder(SMALL)
        path, output = tmp_path / "cylinder.ply", tmp_path / "map.npz"
        voxflat.surface(mesh).save(path)
        options = ["--method", "schwartz1989", "--sources", "30", "--neighbourhood", "4", "--starts", "2", "--json"]
        result = CliRunner().invoke(main, ["flatten", str(path), "-o", str(output), *options])
        assert result.exit_code == 0, result.output
        expected = voxflat.flatten(path, method=Schwartz1989(sources=30, neighbourhood=4, starts=2))
        np.testing.assert_array_equal(voxflat.load(output).uv, expected.uv)
        told = json.loads(result.stdout)
        assert (told["neighbourhood"], told["starts"]) == (4, expected.metadata["starts"])

    @pytest.mark.parametrize(("text", "code"), [("all", 0), ("many", 2), ("0", 1)])
    def test_neighbourhoods_are_numbers_or_all(self, tmp_path, text, code):
        path = tmp_path / "cylinder.ply"
        voxflat.surface(cylinder((9, 7))[0]).save(path)
        options = ["--method", "schwartz1989", "--neighbourhood", text, "--quiet"]
        result = CliRunner().invoke(main, ["flatten", str(path), "-o", str(tmp_path / "map.npz"), *options])
        assert result.exit_code == code, result.output
