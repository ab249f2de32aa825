"""Volumes are sampled where they lie, whatever space the surface is in: tkRAS, scanner RAS, in each program's files."""

from dataclasses import replace

import brain_spaces
import nibabel as nib
import numpy as np
import pytest
from brain_spaces import AFFINES, C_RAS, CONFORMED, WAYS, ball, header, oblique, to_scanner, write_freesurfer
from command_line import succeed
from mesh_files import needs_workbench, workbench
from numpy.testing import assert_allclose

import voxflat
from voxflat.io import Space, VolumeGeometry
from voxflat.io.meshes import read_mesh
from voxflat.methods import Voxflat


def flat(path):
    return voxflat.surface(path).disk(0, 25.0).flatten(Voxflat(sources=20))


@pytest.fixture(scope="module")
def volumes(tmp_path_factory):
    """Write volumes of x, y and z of scanner RAS: linear, so that interpolation gives them everywhere."""
    folder = tmp_path_factory.mktemp("volumes")
    paths = {name: [folder / f"{name}_{axis}.mgz" for axis in "xyz"] for name in AFFINES}
    for name, affine in AFFINES.items():
        xyz = nib.affines.apply_affine(affine, np.moveaxis(np.indices((60, 60, 60)), 0, -1)).astype(np.float32)
        for axis, path in enumerate(paths[name]):
            nib.save(nib.MGHImage(xyz[..., axis], affine), path)
    return paths


def agrees(m, volumes, scanner, depth=0.0):
    """Compare what a map shows of x, y and z to where its pixels lie in scanner RAS."""
    raster = m.raster()
    there = raster.interpolate(scanner[m.ids])
    for axis in range(3):
        assert_allclose(m.image(volumes[axis], depth=depth).data, there[..., axis], atol=2e-4)
    assert raster.inside.sum() > 100


@pytest.mark.parametrize("axes", [CONFORMED, oblique()], ids=["conformed", "oblique"])
@pytest.mark.parametrize("name", WAYS)
def test_each_programs_surface_is_sampled_at_its_place(tmp_path, volumes, name, axes):
    (points, faces), of = ball(), header(axes)
    m = flat(WAYS[name](tmp_path / name, points, faces, of))
    scanner = to_scanner(points.astype(np.float64), of)
    agrees(m, volumes["RAS"], scanner)
    np.testing.assert_array_equal(m.points, read_mesh(tmp_path / name).points[m.ids])  # points stay the file's
    ids, places = m.locate()
    assert_allclose(m.space.to_scanner(places[ids >= 0]), m.raster().interpolate(scanner[m.ids])[ids >= 0], atol=1e-4)
    matrix = np.array(m.metadata["space"]["to_scanner"] or np.eye(4))
    assert_allclose(nib.affines.apply_affine(matrix, m.points), scanner[m.ids], atol=1e-4)
    assert m.metadata["warnings"] == []


@pytest.mark.parametrize("kind", AFFINES)
def test_each_affine(tmp_path, volumes, kind):
    (points, faces), of = ball(), header()
    m = flat(write_freesurfer(tmp_path / "lh.white", points, faces, of))
    agrees(m, volumes[kind], points + np.array(C_RAS))
    m.save(tmp_path / "map.npz")
    agrees(voxflat.load(tmp_path / "map.npz"), volumes[kind], points + np.array(C_RAS))


def test_freesurfers_own_volume_lies_with_its_surface(tmp_path):
    """Of orig.mgz the voxel at a vertex is inv(vox2ras_tkr) of its place, as FreeSurfer's tools have it."""
    (points, faces), of = ball(), header(oblique(), shape=(64, 64, 64), size=(4.0, 4.0, 4.0))
    ijk = np.stack(np.meshgrid(*[np.arange(64, dtype=np.float32)] * 3, indexing="ij"), axis=-1)
    m = flat(write_freesurfer(tmp_path / "lh.white", points, faces, of))
    voxels = m.raster().interpolate(nib.affines.apply_affine(np.linalg.inv(of.get_vox2ras_tkr()), points)[m.ids])
    for axis in range(3):
        nib.save(nib.MGHImage(ijk[..., axis].copy(), None, of), tmp_path / "orig.mgz")
        assert_allclose(m.image(tmp_path / "orig.mgz").data, voxels[..., axis], atol=2e-4)


def test_depth_and_pages(tmp_path, volumes):
    (points, faces), of = ball(), header(oblique())
    path = write_freesurfer(tmp_path / "lh.white", points, faces, of)
    m = flat(path)
    there = m.raster().interpolate(to_scanner(m.points + 3.0 * m.normals, of))
    shown = m.image(volumes["RAS"][2], depth=3.0).data
    assert np.nanmax(np.abs(shown - there[..., 2])) < 0.05  # normals between vertices are made unit vectors again
    page = voxflat.surface(path).patches(20.0).page()
    ids, places = page.locate()
    shown = page.image(volumes["RAS"][0]).data
    assert_allclose(shown[ids >= 0], to_scanner(places[ids >= 0], of)[:, 0], atol=2e-4)


@pytest.mark.slow
def test_without_c_ras_nothing_changes(tmp_path, volumes, caplog):
    """Bit for bit: a footer with c_ras 0, scanner RAS, or no word of a space."""
    points, faces = ball()
    bare, of = flat((points, faces)), header(c_ras=(0, 0, 0))
    for path in (
        write_freesurfer(tmp_path / "lh.white", points, faces, of),
        brain_spaces.smriprep_old(tmp_path / "smriprep.surf.gii", points, faces, of),
        brain_spaces.write_gifti(tmp_path / "plain.surf.gii", points, faces, {}),
        brain_spaces.write_gifti(tmp_path / "scanner.surf.gii", points, faces, {}, (1, 1)),
    ):
        m = flat(path)
        for volume in volumes["oblique"]:
            np.testing.assert_array_equal(m.image(volume).data, bare.image(volume).data)
    assert caplog.messages == []


def test_smriprep_of_old_set_the_centre_to_zero(tmp_path, volumes):
    (points, faces), of = ball(), header()
    path = brain_spaces.smriprep_old(tmp_path / "s.surf.gii", points, faces, of)
    agrees(flat(path), volumes["LAS"], to_scanner(points, of))


@pytest.mark.medium
def test_what_no_file_says_is_told(tmp_path, volumes, caplog):
    (points, faces), of = ball(), header()
    nib.freesurfer.write_geometry(tmp_path / "lh.white", points, faces)
    flat(tmp_path / "lh.white").image(volumes["RAS"][0])
    assert "c_ras). Use a surface file that defines its space" in caplog.text
    caplog.clear()
    meta = {name: value for name, value in brain_spaces.volume_geometry(of, points).items() if "Center" not in name}
    for spaces, moved, reading in (((0, 3), points + np.array(C_RAS), "(tkRAS)"), ((3, 3), points, "(scanner RAS)")):
        m = flat(brain_spaces.write_gifti(tmp_path / "s.surf.gii", points, faces, meta, spaces))
        assert caplog.messages == []  # it does not matter yet
        agrees(m, volumes["RAS"], moved)
        assert "c_ras (3, -17, 22) mm, but not whether its coordinates include it" in caplog.text
        assert reading in caplog.text
        caplog.clear()
    told = replace(read_mesh(tmp_path / "s.surf.gii"), space=Space("tkRAS", VolumeGeometry.conformed(C_RAS)))
    agrees(flat(told), volumes["RAS"], points + np.array(C_RAS))  # who knows it says it
    assert caplog.messages == []
    meta |= {"VolGeomX_R": "-0.5"}
    agrees(flat(brain_spaces.write_gifti(tmp_path / "s.surf.gii", points, faces, meta)), volumes["RAS"], points)
    assert "its volume geometry (VolGeom...) is damaged" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nifti1", "nifti2", "mgz"])
def test_a_volume_without_a_place_is_told(tmp_path, caplog, kind):
    """Its middle is the origin by nibabel; a mesh's map says so, that of a volume of the same header need not."""
    data = np.zeros((60, 60, 60), np.uint8)
    data[20:40, 20:40, 20:40] = 1
    affine = np.diag([2.0, 2, 2, 1])
    affine[:3, 3] = -59  # the centre is near the origin
    path = tmp_path / ("v.mgz" if kind == "mgz" else "v.nii.gz")

    def write(known):
        if kind == "mgz":
            image = nib.MGHImage(data, affine)
            image.header["goodRASFlag"] = known
        else:
            image = (nib.Nifti1Image if kind == "nifti1" else nib.Nifti2Image)(data, affine)
            image.set_qform(None, code=0)
            image.set_sform(affine, code=int(known))
        nib.save(image, path)

    write(known=True)
    flat(ball()).image(path)
    assert caplog.messages == []
    write(known=False)
    flat(ball()).image(path)
    assert f"{path.name} does not define its position" in caplog.text
    m = voxflat.surface(path).disk((30, 30, 39), 15.0).flatten(Voxflat(sources=20))
    caplog.clear()
    m.image(path)
    assert caplog.messages == []


def test_the_command_line_tells_the_space(tmp_path):
    (points, faces), of = ball(1), header()
    path, made = write_freesurfer(tmp_path / "lh.white", points, faces, of), tmp_path / "lh.surf.gii"
    assert "tkRAS: for scanner RAS add c_ras (3, -17, 22) mm" in succeed("check", path).output
    succeed("surface", path, "-o", made)
    assert "scanner RAS" in succeed("check", made).output


@pytest.mark.slow
@needs_workbench
@pytest.mark.parametrize("axes", [CONFORMED, oblique()], ids=["conformed", "oblique"])
def test_workbench_samples_the_same(tmp_path, axes):
    """Workbench takes coordinates as stored: it gets the surface as voxflat writes GIFTI, or as wb_command moves it."""
    (points, faces), of = ball(4), header(axes)
    rng = np.random.default_rng(0)
    volume = tmp_path / "t1.nii.gz"
    nib.save(nib.Nifti1Image(rng.normal(size=(60, 60, 60)).astype(np.float32), AFFINES["oblique"]), volume)
    white = write_freesurfer(tmp_path / "lh.white", points, faces, of)
    voxflat.surface(white).save(tmp_path / "ours.surf.gii")
    brain_spaces.mris_convert_old(tmp_path / "tk.surf.gii", points, faces, of)
    np.savetxt(tmp_path / "matrix.txt", of.get_vox2ras() @ np.linalg.inv(of.get_vox2ras_tkr()))
    workbench("-surface-apply-affine", tmp_path / "tk.surf.gii", tmp_path / "matrix.txt", tmp_path / "theirs.surf.gii")
    workbench("-set-structure", tmp_path / "tk.surf.gii", "CORTEX_LEFT")  # which writes a coordinate system of its own
    m = voxflat.surface(white).disk(0, 30.0).flatten(Voxflat(sources=20))
    assert len(m) > 300
    ours = brain_spaces.at_vertices(m, volume)
    for name in ("ours", "theirs"):
        out = tmp_path / "out.shape.gii"
        workbench("-volume-to-surface-mapping", volume, tmp_path / f"{name}.surf.gii", out, "-trilinear")
        assert_allclose(ours, nib.load(out).darrays[0].data[m.ids], atol=1e-4)
    for name in ("tk", "ours", "theirs"):
        again = voxflat.surface(tmp_path / f"{name}.surf.gii").disk(0, 30.0).flatten(Voxflat(sources=20))
        assert_allclose(brain_spaces.at_vertices(again, volume), ours, atol=1e-4)
