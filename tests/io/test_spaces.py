"""Read and write the spaces of surfaces; nibabel reads the written files, and its matrices equal FreeSurfer's."""

import re

import brain_spaces
import nibabel as nib
import numpy as np
import pytest
from brain_spaces import C_RAS, CONFORMED, ball, footer, header, oblique, to_scanner, write_freesurfer, write_gifti
from mesh_files import patch
from refusals import refused

import voxflat
from voxflat.io.meshes import Mesh, named_structure, read_mesh, write_mesh
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.methods import Voxflat

IN_SCANNER = ["s.surf.gii", "s.vtp", "s.ply", "s.obj"]


@pytest.mark.parametrize("axes", [CONFORMED, oblique()], ids=["conformed", "oblique"])
@pytest.mark.parametrize("name", brain_spaces.WAYS)
def test_each_programs_space_is_known(tmp_path, name, axes):
    (points, faces), of = ball(), header(axes)
    mesh = read_mesh(brain_spaces.WAYS[name](tmp_path / name, points, faces, of))
    start, other = name.split(".")[0], "unknown" if name.startswith("smriprep") else "scanner"
    expected = "tkRAS" if start in ("lh", "mris_convert", "mris_convert_old") else other
    assert (mesh.space.name, mesh.space.warning, mesh.warnings) == (expected, "", ())
    np.testing.assert_allclose(mesh.space.to_scanner(mesh.points), to_scanner(points, of), atol=1e-4)
    np.testing.assert_allclose(mesh.space.from_scanner(mesh.space.to_scanner(mesh.points)), mesh.points, atol=1e-9)
    assert Space._of(mesh.space._described(), "mesh")._described() == mesh.space._described()


@pytest.mark.parametrize("shape", [(256, 256, 256), (320, 300, 257)])
@pytest.mark.parametrize("axes", [CONFORMED, oblique(), np.eye(3)], ids=["conformed", "oblique", "RAS"])
def test_the_matrix_is_freesurfers(axes, shape):
    of = header(axes, shape=shape, size=(1.0, 0.8, 1.2))
    volume = VolumeGeometry(np.transpose(axes), np.array(C_RAS), shape, (1.0, 0.8, 1.2))
    matrix = of.get_vox2ras() @ np.linalg.inv(of.get_vox2ras_tkr())
    np.testing.assert_allclose(volume.matrix, matrix, atol=1e-5)
    np.testing.assert_allclose(VolumeGeometry._of_matrix(matrix).matrix, matrix, atol=1e-5)


@pytest.mark.parametrize("name", list(brain_spaces.WAYS)[:4])
@pytest.mark.parametrize("axes", [CONFORMED, oblique()], ids=["conformed", "oblique"])
def test_freesurfers_files_get_tkras_and_a_footer(tmp_path, name, axes):
    (points, faces), of = ball(), header(axes)
    write_mesh(tmp_path / "lh.again", read_mesh(brain_spaces.WAYS[name](tmp_path / name, points, faces, of)))
    written, _, told = nib.freesurfer.read_geometry(tmp_path / "lh.again", read_metadata=True)
    np.testing.assert_allclose(written, points, atol=1e-4)
    assert told["filename"].endswith("filled.mgz")
    assert told["valid"].startswith("1")
    for key in footer(of).keys() - {"filename", "valid"}:
        np.testing.assert_allclose(told[key], footer(of)[key], atol=1e-6)
    if name == "lh.white":  # bit-identical
        np.testing.assert_array_equal(written, points)


@pytest.mark.medium
@pytest.mark.parametrize("name", IN_SCANNER)
def test_all_others_are_in_scanner_ras(tmp_path, name):
    """This is how tools combine them with volumes; no metadata would make another tool move them again."""
    (points, faces), of = ball(), header(oblique())
    voxflat.surface(write_freesurfer(tmp_path / "lh.white", points, faces, of)).save(tmp_path / name)
    read = read_mesh(tmp_path / name)
    np.testing.assert_allclose(read.points, to_scanner(points, of), atol=1e-4)
    if name.endswith(".gii"):
        array = nib.load(tmp_path / name).darrays[0]
        assert (array.coordsys.dataspace, array.coordsys.xformspace) == (1, 1)
        np.testing.assert_array_equal(array.coordsys.xform, np.eye(4))
        assert not [key for key in array.meta if key.startswith("VolGeom")]
        assert read.space.name == "scanner"


@pytest.mark.parametrize("kind", ["conformed", "other", "bare"])
def test_a_surface_of_a_volume_as_freesurfers(tmp_path, kind):
    """Its footer defines its position: that of the volume, or of the conformed volume with the same centre."""
    mask = np.pad(np.ones((8, 10, 8), np.uint8), [(6, 6), (5, 7), (8, 8)])
    of = header(CONFORMED if kind == "conformed" else oblique(), shape=mask.shape, size=(2.0, 2.0, 2.0))
    nib.save(nib.MGHImage(mask, None, of), tmp_path / "wm.mgz")
    made = voxflat.surface(mask if kind == "bare" else tmp_path / "wm.mgz")
    made.save(tmp_path / "lh.white")
    points, _, told = nib.freesurfer.read_geometry(tmp_path / "lh.white", read_metadata=True)
    if kind == "bare":  # its position is unknown
        np.testing.assert_allclose(points, made.points, atol=1e-5)
        assert told == {}
        return
    written = header([told[axis] for axis in ("xras", "yras", "zras")], told["cras"], told["volume"], told["voxelsize"])
    np.testing.assert_allclose(to_scanner(points, written), made.points, atol=1e-4)
    np.testing.assert_allclose(told["cras"], C_RAS, atol=1e-5)
    np.testing.assert_array_equal(written["Mdc"], CONFORMED)
    assert tuple(told["volume"]) == (mask.shape if kind == "conformed" else (256, 256, 256))
    again = voxflat.surface(tmp_path / "lh.white")
    np.testing.assert_allclose(again.space.to_scanner(again.points), made.points, atol=1e-4)


def test_scanner_ras_without_a_volume_gets_a_footer_that_moves_nothing(tmp_path):
    points, faces = ball()
    write_mesh(tmp_path / "lh.white", read_mesh(write_gifti(tmp_path / "s.surf.gii", points, faces, {}, (1, 1))))
    written, _, told = nib.freesurfer.read_geometry(tmp_path / "lh.white", read_metadata=True)
    np.testing.assert_array_equal(written, points)
    np.testing.assert_array_equal(told["cras"], 0)
    np.testing.assert_array_equal([told[axis] for axis in ("xras", "yras", "zras")], CONFORMED)


@pytest.mark.parametrize("filename", ["a=b\nvalid = 0.mgz", "Gehirn für später.mgz", ""])
def test_a_footer_holds_any_name(tmp_path, filename):
    points, faces = ball(1)
    volume = VolumeGeometry.conformed(C_RAS, filename)
    write_mesh(tmp_path / "lh.white", Mesh(points, faces, space=Space("tkRAS", volume)))
    told = nib.freesurfer.read_geometry(tmp_path / "lh.white", read_metadata=True)[2]
    np.testing.assert_array_equal(told["cras"], C_RAS)
    assert told["valid"].startswith("1")
    assert read_mesh(tmp_path / "lh.white").space.volume.filename == told["filename"]


def test_freesurfers_tag_of_scanner_ras(tmp_path):
    """mris_convert --to-scanner writes TAG_OLD_USEREALRAS = 1, where nibabel stops reading."""
    path = write_freesurfer(tmp_path / "lh.white", *ball(), header())
    tag = np.array([2, 0, 20], ">i4").tobytes()
    patch(path, {path.read_bytes().index(tag): np.array([2, 1, 20], ">i4").tobytes()})
    assert read_mesh(path).space.name == "scanner"


def test_a_footer_that_says_nothing(tmp_path, caplog):
    (points, faces), of = ball(), header()
    path = tmp_path / "lh.white"
    nib.freesurfer.write_geometry(path, points, faces, "me", footer(of, "0  # volume info invalid"))
    space = read_mesh(path).space
    assert (space.name, space.is_known) == ("tkRAS", False)
    assert "does not define the centre of the volume (c_ras)" in space.warning
    voxflat.surface(path).save(tmp_path / "s.surf.gii")
    assert re.search(r"s\.surf\.gii may be misaligned with volumes: .*c_ras", caplog.text)
    assert read_mesh(tmp_path / "s.surf.gii").space.name == "unknown"
    bad = {"xras": (np.nan, "are not orthonormal"), "cras": (np.inf, "c_ras, [inf, 0.0, 0.0], is")}
    for key, (value, told) in bad.items():
        nib.freesurfer.write_geometry(path, points, faces, "me", footer(of) | {key: np.array([value, 0, 0])})
        assert told in read_mesh(path).space.warning


def test_the_middle_must_be_near_one_of_both_readings(tmp_path):
    """Otherwise the file is ambiguous: a surface that was cut or replaced keeps the metadata of the original."""
    (points, faces), of = ball(), header()
    meta = brain_spaces.volume_geometry(of, points)

    def space(moved=0.0, **changes):
        path = tmp_path / "s.surf.gii"
        return read_mesh(write_gifti(path, points + moved * np.array(C_RAS), faces, meta | changes)).space

    for moved, name in ((0, "tkRAS"), (1, "scanner"), (0.5, "tkRAS")):
        assert (space(moved).name, bool(space(moved).warning)) == (name, moved == 0.5)
    for bad in ("x", "nan", "inf"):
        assert space(SurfaceCenterX=bad).warning
        assert "damaged" in space(VolGeomC_R=bad).warning


def test_a_matrix_without_a_volume_is_enough(tmp_path):
    (points, faces), of = ball(), header(oblique())
    matrix = of.get_vox2ras() @ np.linalg.inv(of.get_vox2ras_tkr())
    mesh = read_mesh(write_gifti(tmp_path / "s.surf.gii", points, faces, {}, (0, 1), matrix))
    np.testing.assert_allclose(mesh.space.to_scanner(mesh.points), to_scanner(points, of), atol=1e-4)
    bad = read_mesh(write_gifti(tmp_path / "s.surf.gii", points, faces, {}, (0, 1), np.diag([2.0, 1, 1, 1])))
    assert (bad.space.name, bad.space.is_known) == ("unknown", False)
    assert "orthonormal" in bad.space.warning


def test_a_pial_surface_of_another_space_is_brought_to_the_white_ones(tmp_path):
    (points, faces), of = ball(), header(oblique())
    outwards = points - points.mean(axis=0)
    outside = points + 2.5 * outwards / np.linalg.norm(outwards, axis=1)[:, None]
    white = write_freesurfer(tmp_path / "lh.white", points, faces, of)
    names = ("lh.white", "to_scanner.surf.gii")
    pials = [brain_spaces.WAYS[name](tmp_path / f"pial_{name}", outside, faces, of) for name in names]
    both = [voxflat.surface(white, pial=pial).points for pial in pials]
    np.testing.assert_allclose(both[0], both[1], atol=1e-4)
    assert len(both[0]) == len(voxflat.surface((points, faces)))


def test_flat_maps_have_no_space(tmp_path):
    (points, faces), of = ball(), header()
    surface = voxflat.surface(brain_spaces.mris_convert(tmp_path / "lh.surf.gii", points, faces, of))
    m = surface.disk(0, 25.0).flatten(Voxflat(sources=20))
    m.save(tmp_path / "flat.surf.gii")
    array = nib.load(tmp_path / "flat.surf.gii").darrays[0]
    assert (array.coordsys.dataspace, array.coordsys.xformspace) == (0, 0)
    np.testing.assert_allclose(array.data[m.ids, :2], m.uv, atol=1e-4)
    picture = np.zeros((8, 8, 3), np.uint8)
    m.textured(picture).save(tmp_path / "t.ply")  # on the surface, in scanner RAS like all formats except FreeSurfer's
    np.testing.assert_allclose(read_mesh(tmp_path / "t.ply").points, to_scanner(points, of)[m.ids], atol=1e-4)


def test_unknown_points_are_written_as_they_are(tmp_path):
    points, faces = ball()
    for name in (*IN_SCANNER, "lh.white"):
        write_mesh(tmp_path / name, Mesh(points, faces))
        np.testing.assert_allclose(read_mesh(tmp_path / name).points, points, rtol=1e-6)
    assert nib.freesurfer.read_geometry(tmp_path / "lh.white", read_metadata=True)[2] == {}
    brain_spaces.smriprep_old(tmp_path / "old.surf.gii", points, faces, header(c_ras=(0, 0, 0)))
    np.testing.assert_array_equal(read_mesh(tmp_path / "old.surf.gii").points, points)


def test_sides_by_names():
    left = "lh.thickness sub-01_hemi-L_curv.shape.gii bert.lh.curv.mgz"
    right = "rh.aparc.annot 100307.R.sulc.32k_fs_LR.shape.gii sub-01_ses-1_hemi-R_space-fsLR_den-91k_sulc.shape.gii"
    for structure, names in (("CortexLeft", left), ("CortexRight", right), (None, "lh.from.rh.label Left.txt hemi-Lx")):
        assert {named_structure(f"/rh.data/{name}") for name in names.split()} == {structure}


def test_axes_are_orthonormal_within_single_precision():
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0].astype(np.float32)
    VolumeGeometry(axes, C_RAS)
    refused("are not orthonormal", VolumeGeometry, axes + 0.01, C_RAS)
