"""Flattening after Schwartz, Shaw and Wolfson (1989)."""

import composed
import numpy as np
import pytest
from command_line import run
from refusals import refused
from scipy.linalg import orthogonal_procrustes
from triangle_meshes import cylinder

import voxflat
from voxflat import figures
from voxflat.methods import Schwartz1989

SMALL, TRUTH = cylinder((21, 16))


def apart(uv, other):
    """Return the RMS distance between two maps after the best rotation or reflection."""
    uv, other = uv - uv.mean(axis=0), other - other.mean(axis=0)
    turn, _ = orthogonal_procrustes(other, uv)
    return np.sqrt(((other @ turn - uv) ** 2).sum(axis=1).mean())


class TestFlatten:
    @pytest.mark.slow
    @pytest.mark.parametrize("neighbourhood", [None, 1, "all"])
    def test_a_cylinder_is_unrolled(self, neighbourhood):
        flat = voxflat.flatten(SMALL, Schwartz1989(sources=20, neighbourhood=neighbourhood))
        assert apart(flat.uv, TRUTH[flat.ids]) < 0.02
        assert flat.distortion.triangles.flipped == 0
        metadata = flat.metadata
        assert metadata["method"] == "schwartz1989"
        assert metadata["neighbourhood"] == neighbourhood or neighbourhood is None
        assert metadata["descent"]["converged"]
        assert len(metadata["starts"]) == 3
        assert min(metadata["starts"]) == min(metadata["descent"]["energies"])
        assert metadata["warnings"] == []
        assert (metadata["pairs"] == 336 * 335 / 2) == (neighbourhood == "all")

    @pytest.mark.slow
    def test_random_starts_end_in_the_same_map(self):
        method = Schwartz1989(sources=list(range(0, 200, 5)))
        maps = [voxflat.flatten(SMALL, method, seed=seed) for seed in range(4)]
        assert not np.array_equal(maps[0].uv, maps[1].uv)
        for other in maps[1:]:
            assert apart(maps[0].uv, other.uv) < 0.05
            assert min(other.metadata["starts"]) == pytest.approx(min(maps[0].metadata["starts"]), rel=1e-3, abs=1e-8)

    @pytest.mark.medium
    def test_short_distances_alone_fold_and_it_is_said(self):
        flat = voxflat.flatten(cylinder((41, 31))[0], method=Schwartz1989(sources=0, neighbourhood=1))
        assert flat.distortion.raw.relative_error > 0.1
        assert any("are flipped" in warning for warning in flat.metadata["warnings"])
        assert any("only one of" in warning for warning in flat.metadata["warnings"])
        assert flat.metadata["planarity"] is None
        assert len(flat.sources) == len(flat.eigenvalues) == 0
        refused("without sources", figures.spectrum, flat)

    @pytest.mark.medium
    def test_a_map_is_kept_in_a_file(self, tmp_path):
        for sources in (0, 20):
            flat = voxflat.flatten(SMALL, method=Schwartz1989(sources=sources, starts=1))
            flat.save(tmp_path / "map.npz")
            again = voxflat.load(tmp_path / "map.npz")
            np.testing.assert_array_equal(again.uv, flat.uv)
            assert again.metadata == flat.metadata


class TestBadInput:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"neighbourhood": 0}, "neighbourhood is 0. Pass a number of rings, at least 1, or 'all'"),
            ({"neighbourhood": "most"}, "neighbourhood is 'most'. Pass a number of rings"),
            ({"neighbourhood": True}, "neighbourhood is True. Pass"),
            ({"neighbourhood": 2**40}, "neighbourhood is 1099511627776. Pass"),
            ({"starts": 0}, "starts is 0. Pass a number of random starts, at least 1"),
            ({"starts": "3"}, "starts is '3'. Pass"),
            ({"sources": 0, "rows": True}, "sources is 0, so there are no rows to keep"),
            ({"sampling": "grid"}, "Pass 'farthest', 'curvature' or 'random'"),
            ({"rows": "directory"}, "cannot write a store"),
        ],
    )
    def test_wrong_options_are_named(self, options, message):
        refused(message, composed.flatten, SMALL, method="schwartz1989", **options)

    def test_what_does_not_fit_into_memory_is_refused_with_numbers(self):
        told = r"the limit is 4.00 GiB. Distances between all pairs of 32361 points are stored.*the method 'voxflat'"
        how = {"method": Schwartz1989(neighbourhood="all"), "memory_limit": 4 << 30}
        refused(told, voxflat.flatten, cylinder((201, 161))[0], **how)

    @pytest.mark.parametrize(("text", "code"), [("all", 0), ("many", 2), ("0", 1)])
    def test_the_command_takes_a_number_of_rings_or_all(self, tmp_path, text, code):
        voxflat.surface(cylinder((9, 7))[0]).save(tmp_path / "cylinder.ply")
        options = ["--method", "schwartz1989", "--neighbourhood", text, "--quiet"]
        assert run("flatten", tmp_path / "cylinder.ply", "-o", tmp_path / "map.npz", *options).exit_code == code
