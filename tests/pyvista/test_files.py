"""Files of surfaces and maps read and saved by PyVista, compared with independent readers."""

import re
from importlib.metadata import EntryPoint
from pathlib import Path

import nibabel
import numpy as np
import pytest
import pyvista as pv
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from voxflat.io import Patch, patch_border, write_patch
from voxflat.methods import Voxflat

PROJECT = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
pytestmark = pytest.mark.skipif(not hasattr(pv, "register_reader"), reason="requires PyVista 0.48")


@pytest.fixture(scope="module", autouse=True)
def registered():
    """Register the entry points in pyproject.toml, which may differ from those of an installed version."""
    for group, register in (("read", pv.register_reader), ("write", pv.register_writer)):
        for name, value in re.findall(rf'^(\w+) = "(voxflat\._pyvista\.files:{group})"$', PROJECT, re.MULTILINE):
            register(f".{name}", EntryPoint(name, value, f"pyvista.{group}ers").load(), override=True)


@pytest.fixture(scope="module")
def ball():
    return pv.Icosphere(radius=20.0, nsub=2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lh.white", "lh.pial", "rh.inflated", "lh.sphere.reg"])
def test_surfaces_of_freesurfer(name, ball, tmp_path):
    nibabel.freesurfer.write_geometry(tmp_path / name, np.asarray(ball.points), ball.regular_faces)
    mesh = pv.read(tmp_path / name)
    assert_allclose(mesh.points, ball.points, atol=1e-5)
    assert_array_equal(mesh.regular_faces, ball.regular_faces)
    assert mesh.voxflat.check().can_flatten


def test_a_flat_map_is_saved_with_the_numbers_of_its_mesh(ball, tmp_path, caplog):
    flat = ball.voxflat(method=Voxflat(sources=20), relax=False)
    flat.save(tmp_path / "lh.flat.surf.gii")
    points, faces = (array.data for array in nibabel.load(tmp_path / "lh.flat.surf.gii").darrays)
    assert len(points) == ball.n_points
    ball.voxflat.flatten(method=Voxflat(sources=20), relax=False).save(tmp_path / "own.surf.gii")
    expected = [array.data for array in nibabel.load(tmp_path / "own.surf.gii").darrays]
    assert_allclose(points, expected[0], atol=1e-5)
    assert_array_equal(faces, expected[1])
    assert 0 < len(faces) < flat.n_cells
    assert "lie at a cut that duplicates vertices" in caplog.text
    assert_array_equal(pv.read(tmp_path / "lh.flat.surf.gii").regular_faces, faces)
    ball.save(tmp_path / "ball.surf.gii")
    assert_allclose(nibabel.load(tmp_path / "ball.surf.gii").darrays[0].data, ball.points, rtol=1e-6)


def test_a_saved_map_is_read(ball, tmp_path):
    flat_map = ball.voxflat.flatten(method=Voxflat(sources=20), relax=False)
    flat_map.save(tmp_path / "map.voxflat")
    mesh = pv.read(tmp_path / "map.voxflat")
    assert_array_equal(mesh.points[:, :2], flat_map.uv)
    assert_array_equal(mesh["areal"], flat_map.distortion.triangles.areal)
    assert_array_equal(mesh["surface_points"], flat_map.points)


def test_a_patch_is_read_with_its_surface(ball, tmp_path):
    faces = ball.regular_faces
    kept = np.flatnonzero(ball.points[:, 2] > 0)
    cap = Patch(kept, np.asarray(ball.points)[kept], patch_border(faces, kept, ball.n_points))
    write_patch(tmp_path / "lh.cap.patch.3d", cap)
    nibabel.freesurfer.write_geometry(tmp_path / "lh.white", np.asarray(ball.points), faces)
    patch = pv.read(tmp_path / "lh.cap.patch.3d", surface=str(tmp_path / "lh.white"))
    inside = np.isin(faces, kept).all(axis=1)
    assert_array_equal(np.sort(patch["vertex_ids"][patch.regular_faces]), np.sort(faces[inside]))
    assert_allclose(patch.points, ball.points[patch["vertex_ids"]], atol=1e-5)
    assert_allclose(patch["surface_points"], patch.points, atol=1e-5)
    refused(r"is a patch without triangles.*surface='lh.white'", pv.read, tmp_path / "lh.cap.patch.3d")
    refused("the file is not a patch", pv.read, tmp_path / "lh.white", surface=str(tmp_path / "lh.white"))


def test_what_is_damaged_or_no_surface_is_refused(ball, tmp_path):
    (tmp_path / "lh.pial").write_bytes(b"\xff\xff\xfe rubbish")
    (tmp_path / "map.voxflat").write_bytes(b"rubbish")
    for name in ("lh.pial", "map.voxflat"):
        refused(name, pv.read, tmp_path / name)
    wrong = r"grid\.surf\.gii: cannot save the UnstructuredGrid. Convert it to triangles"
    refused(wrong, ball.cast_to_unstructured_grid().save, tmp_path / "grid.surf.gii")
    refused(r"flat\.gii", ball.save, tmp_path / "flat.gii")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lh.pial", "map.voxflat"]


def test_no_reader_of_pyvista_is_replaced():
    from pyvista.core.utilities.reader import CLASS_READERS

    names = re.findall(r'^(\w+) = "voxflat\._pyvista\.files:read"$', PROJECT, re.MULTILINE)
    assert len(names) > 9
    assert not {f".{name}" for name in names} & set(CLASS_READERS)
