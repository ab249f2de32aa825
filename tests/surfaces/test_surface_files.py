"""Surfaces and patches in files."""

import lab
import numpy as np
import pytest
import shapes
from command_line import succeed
from refusals import refused

import voxflat
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.methods import Voxflat

pytest.importorskip("nilearn")


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
        refused("the overlay has 5 values; the mesh has 10242 vertices", flat_map.image, np.zeros(5))
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
    """The middle of grey matter as LayNii makes it: one voxel thick where it can be, folded, with pinholes."""
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
