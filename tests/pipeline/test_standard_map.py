"""The same flat map for all densities of a standard mesh: `voxflat.standard_map`.

The meshes are small: fsaverage5 has 2,562 vertices here, and fsaverage6 has the 10,242 of the real fsaverage5.
"""

import gzip
import json
from importlib import util
from pathlib import Path

import numpy as np
import pytest
import studies
from command_line import succeed

import voxflat
from voxflat.errors import Cancelled, InputError
from voxflat.pipeline import standard_map as module
from voxflat.surfaces.standard.sphere import in_triangles

VERTICES = {"fsaverage5": 2562, "fsaverage6": 10242}


def unit(points):
    return points / np.linalg.norm(points, axis=1)[:, None]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder in FreeSurfer's layout."""
    folder = tmp_path_factory.mktemp("subjects")
    for name, vertices in VERTICES.items():
        of = studies.hemisphere("lh", vertices)
        surf = folder / name / "surf"
        surf.mkdir(parents=True)
        for kind in ("white", "pial", "sphere"):
            voxflat.io.write_mesh(surf / f"lh.{kind}", voxflat.io.Mesh(of[kind], of["faces"]))
    return folder


def _small(patch):
    patch.setattr(module, "VERTICES", {**module.VERTICES, **VERTICES})
    patch.setattr(module, "_PACKAGES", {})


@pytest.fixture
def small(monkeypatch):
    """Make the meshes small."""
    _small(monkeypatch)


@pytest.fixture(scope="module")
def maps(files):
    with pytest.MonkeyPatch.context() as patch:
        _small(patch)
        return {name: voxflat.standard_map(name, files=files) for name in VERTICES}


@pytest.mark.medium
def test_a_finer_mesh_has_the_same_map(maps, files):
    coarse, fine = maps.values()
    spheres = [unit(voxflat.io.read_mesh(files / name / "surf" / "lh.sphere").points) for name in maps]
    corners, weights, is_inside = in_triangles(spheres[1][fine.ids], fine.faces, spheres[0][coarse.ids])
    apart = np.linalg.norm(np.einsum("ij,ijk->ik", weights, fine.uv[corners]) - coarse.uv, axis=1)[is_inside]
    assert len(apart) > 0.99 * len(coarse)
    assert np.median(apart) < 1e-3
    assert np.quantile(apart, 0.95) < 1.0  # at the two sides of a cut, the other side may be found
    assert fine.distortion.triangles.flipped == 0
    assert fine.distortion.triangles.crossings == 0
    assert [cut.name for cut in fine.cuts] == [cut.name for cut in coarse.cuts]
    assert fine.frame == coarse.frame == "standard"


@pytest.mark.medium
def test_the_distortion_is_that_of_the_finer_surface(maps, files):
    fine = maps["fsaverage6"]
    white = voxflat.surface(files / "fsaverage6/surf/lh.white", pial=files / "fsaverage6/surf/lh.pial")
    found = voxflat.measure(white, fine, reference="graph")
    assert found.best_scale.relative_error == pytest.approx(fine.distortion.best_scale.relative_error, rel=0.02)


@pytest.mark.medium
def test_published_cuts_and_orientation_are_those_of_the_published_map(files, small, tmp_path):
    of = studies.hemisphere("lh", VERTICES["fsaverage5"])
    made = voxflat.flatten((of["white"], of["faces"]), cuts="standard", sphere=(of["sphere"], of["faces"]))
    places = np.zeros((len(of["white"]), 3))
    places[made.ids, :2] = made.uv @ [[0, 1], [-1, 0]]
    on_one_side = (places[made.ids, :2] == made.uv @ [[0, 1], [-1, 0]]).all(axis=1)
    faces = made.ids[made.faces[on_one_side[made.faces].all(axis=1)]]
    voxflat.io.write_mesh(tmp_path / "flat.surf.gii", voxflat.io.Mesh(places, faces))
    (tmp_path / "flat_left.gii.gz").write_bytes(gzip.compress((tmp_path / "flat.surf.gii").read_bytes()))
    found = voxflat.standard_map("fsaverage5", cuts="published", files=[files, tmp_path])
    assert np.array_equal(np.unique(np.sort(found.ids[found.faces]), axis=0), np.unique(np.sort(faces), axis=0))
    assert np.linalg.norm(found.uv - places[found.ids, :2], axis=1).mean() < 10  # mm, on a map of 300 mm


@pytest.mark.medium
def test_a_map_with_flipped_triangles_is_made_anew_near_the_first(maps, files, small, monkeypatch):
    carried = module.carried

    def folded(*arguments):
        uv = carried(*arguments)
        uv[100] += 5.0
        return uv

    monkeypatch.setattr(module, "carried", folded)
    found = voxflat.standard_map("fsaverage6", files=files)
    assert found.distortion.triangles.flipped == 0
    assert np.median(np.linalg.norm(found.uv - maps["fsaverage6"].uv, axis=1)) < 3  # mm


@pytest.mark.medium
def test_resampling_can_be_cancelled(files, small):
    def progress(stage, done, total):
        return stage != "resampling the map"

    with pytest.raises(Cancelled, match="resampling the map was cancelled"):
        voxflat.standard_map("fsaverage6", files=files, progress=progress)


def test_a_missing_file_is_named(files, small, tmp_path):
    told = r"found no white surface of fsaverage with 163842 vertices \(lh.white or white_left.gii.gz\). Pass files"
    with pytest.raises(InputError, match=told):
        voxflat.standard_map("fsaverage", files=files)
    with pytest.raises(InputError, match="found no midthickness surface of fs_LR 32k"):
        voxflat.standard_map("fs_LR", hemisphere="right", files=tmp_path)
    (tmp_path / "lh.white").write_bytes((files / "fsaverage5/surf/lh.white").read_bytes())
    with pytest.raises(InputError, match=r"found no pial surface of fsaverage5"):
        voxflat.standard_map("fsaverage5", files=tmp_path)
    with pytest.raises(InputError, match=r"lh.white has 2562"):
        voxflat.standard_map("fsaverage6", files=[files / "fsaverage5", tmp_path])


def test_wrong_arguments_are_named(files, tmp_path):
    with pytest.raises(InputError, match=r"mesh is 'onavg'"):
        voxflat.standard_map("onavg")
    with pytest.raises(InputError, match=r"density applies to fs_LR only, but mesh is 'fsaverage5'. Omit density"):
        voxflat.standard_map("fsaverage5", "32k")
    with pytest.raises(InputError, match=r"density is '100k'"):
        voxflat.standard_map("fs_LR", "100k")
    with pytest.raises(InputError, match=r"missing is not a folder"):
        voxflat.standard_map("fs_LR", files=tmp_path / "missing")


@pytest.mark.medium
def test_the_command_makes_the_map_of_the_function(maps, files, small, tmp_path):
    output = tmp_path / "map.npz"
    told = json.loads(succeed("standard-map", "fsaverage6", "--files", files, "--json", "-o", output).stdout)
    assert np.array_equal(voxflat.load(output).uv, maps["fsaverage6"].uv)
    assert told["points"] == maps["fsaverage6"].metadata["points"]


def test_fsaverage5_of_nilearn_needs_no_files():
    found = util.find_spec("nilearn")
    if found is None:
        pytest.skip("nilearn is missing")
    mesh = module.mesh_file("fsaverage", "fsaverage5", "right", "white surface", ())
    assert mesh.path == Path(found.origin).parent / "datasets/data/fsaverage5/white_right.gii.gz"
