"""`voxflat pycortex`: the layout of pycortex's filestore, orientation, regions of interest, and backups."""

import inspect
import re
import shutil
import sys
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import nibabel as nib
import numpy as np
import pytest
import studies
from command_line import fail, succeed
from lab_runs import FEW, VERTICES, everything
from numpy.testing import assert_allclose, assert_array_equal

import voxflat

pytestmark = pytest.mark.slow  # its fixtures take seconds

HEMIS, SURFACES = ("lh", "rh"), ("wm", "pia", "inflated", "flat")
AFFINE = np.array([[-1.0, 0, 0, 12], [0, 0, 1, -9], [0, -1, 0, 30], [0, 0, 0, 1]])
NAMES = ["unknown", "front", "back", "corpuscallosum"]
AREA = "{http://www.w3.org/2000/svg}"
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"


def parcels(of):
    """Return the labels of an annotation: outside the cortex, in front, behind, and a piece of the callosum."""
    labels = np.where(of["white"][:, 1] > 0, 1, 2)
    labels[~of["cortex"]] = 0
    labels[np.flatnonzero(of["cortex"])[:3]] = 3
    return labels


def with_holes(of):
    """Return the vertices of a label with holes and islands that also touches the edge of the map."""
    random = np.random.default_rng(5)
    return np.flatnonzero(of["cortex"] & (of["white"][:, 2] > 10) & (random.random(len(of["white"])) > 0.1))


@pytest.fixture(scope="module")
def recon(made, tmp_path_factory):
    """Return a subject whose maps exist, with an annotation, a label and a volume."""
    folder = tmp_path_factory.mktemp("recon") / "sub-01"
    shutil.copytree(made, folder)
    for hemi in HEMIS:
        of = studies.hemisphere(hemi, VERTICES)
        table = np.array([[25, 5, 25, 0, 0], [200, 30, 30, 0, 0], [30, 60, 200, 0, 0], [120, 70, 50, 0, 0]])
        nib.freesurfer.write_annot(folder / "label" / f"{hemi}.aparc.annot", parcels(of), table, NAMES, fill_ctab=True)
        studies.write_label(folder / "label" / f"{hemi}.holes.label", with_holes(of), of["white"])
        nib.freesurfer.write_morph_data(folder / "surf" / f"{hemi}.sulc", of["curv"] * 3)
    volume = nib.MGHImage(np.arange(60, dtype=np.uint8).reshape(3, 4, 5), AFFINE)
    nib.save(volume, folder / "mri" / "T1.mgz")
    return folder


@pytest.fixture(scope="module")
def store(recon, tmp_path_factory):
    """Return a filestore with the subject."""
    folder = tmp_path_factory.mktemp("filestore")
    result = succeed("pycortex", recon, "--filestore", folder, "--roi", "aparc", "--roi", "holes")
    assert f"subject: {folder / 'sub-01'}" in result.stdout
    assert "sub-01 lacks mri/aseg.mgz, mri/wm.mgz" in result.stderr
    return folder


@pytest.fixture
def copied(store, tmp_path):
    """Return a copy of the filestore."""
    shutil.copytree(store, tmp_path / "filestore")
    return tmp_path / "filestore"


def surface(folder, name, hemi):
    return nib.load(folder / "surfaces" / f"{name}_{hemi}.gii").agg_data()


def mean_direction(uv, values):
    """Return the direction on the map in which values grow, as a unit vector."""
    slopes = np.linalg.lstsq(np.column_stack([uv, np.ones(len(uv))]), values, rcond=None)[0][:2]
    return slopes / np.linalg.norm(slopes)


# ------------------------------------------------------------------------------ layout


def test_the_subject_has_the_layout_of_pycortex(store):
    folder = store / "sub-01"
    wanted = {f"surfaces/{name}_{hemi}.gii" for name in SURFACES for hemi in HEMIS}
    wanted |= {"overlays.svg", "anatomicals/raw.nii.gz"}
    wanted |= {f"surface-info/{name}.npz" for name in ("sulcaldepth", "thickness", "curvature")}
    assert set(everything(folder)) == wanted
    assert {path.name for path in folder.iterdir() if path.is_dir()} == {
        *("transforms", "anatomicals", "cache", "surfaces", "surface-info", "views")
    }


@pytest.mark.parametrize("hemi", HEMIS)
def test_surfaces_share_their_vertices_and_lie_in_the_scanner(store, hemi):
    folder, of = store / "sub-01", studies.hemisphere(hemi, VERTICES)
    for name in SURFACES:
        points, faces = surface(folder, name, hemi)
        assert points.shape == (VERTICES, 3)
        if name != "flat":
            assert_array_equal(faces, of["faces"])
    assert_allclose(surface(folder, "wm", hemi)[0], of["white"] + studies.C_RAS, atol=1e-4)
    assert_allclose(surface(folder, "pia", hemi)[0], of["pial"] + studies.C_RAS, atol=1e-4)


@pytest.mark.parametrize("hemi", HEMIS)
def test_an_inflated_surface_that_recon_all_did_not_write_is_smooth(store, hemi):
    white, faces = surface(store / "sub-01", "wm", hemi)
    inflated, _ = surface(store / "sub-01", "inflated", hemi)
    assert_allclose(areas(inflated, faces).sum(), areas(white, faces).sum(), rtol=1e-4)
    assert bending(inflated, faces) < 0.5 * bending(white, faces)


def areas(points, faces):
    a, b, c = (points[faces[:, k]].astype(float) for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def bending(points, faces):
    """Return the mean angle between the normals of neighbouring triangles."""
    a, b, c = (points[faces[:, k]].astype(float) for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides = {}
    for number, triangle in enumerate(faces.tolist()):
        for k in range(3):
            sides.setdefault(frozenset((triangle[k], triangle[k - 1])), []).append(number)
    pairs = np.array([pair for pair in sides.values() if len(pair) == 2])
    return np.arccos(np.clip((normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1), -1, 1)).mean()


def test_values_are_negated_and_volumes_converted_like_those_of_import_subj(store):
    folder = store / "sub-01"
    for name, of, factor in (("curvature", "curv", 1), ("thickness", "thickness", 1), ("sulcaldepth", "curv", 3)):
        stored = np.load(folder / "surface-info" / f"{name}.npz")
        for side, hemi in (("left", "lh"), ("right", "rh")):
            assert_allclose(stored[side], -factor * studies.hemisphere(hemi, VERTICES)[of], rtol=1e-6)
    raw = nib.load(folder / "anatomicals" / "raw.nii.gz")
    assert_allclose(raw.affine, AFFINE)
    assert_array_equal(np.asarray(raw.dataobj), np.arange(60).reshape(3, 4, 5))


# ------------------------------------------------------------------------------ flat surfaces


@pytest.mark.parametrize("hemi", HEMIS)
def test_the_flat_surface_is_the_map_without_medial_wall_and_cuts(store, recon, hemi):
    uv, faces = surface(store / "sub-01", "flat", hemi)
    of = studies.hemisphere(hemi, VERTICES)
    on_map = np.unique(faces)
    assert of["cortex"][on_map].all()
    assert {frozenset(face) for face in faces.tolist()} < {frozenset(face) for face in of["faces"].tolist()}
    assert not uv[:, 2].any()
    assert not uv[np.setdiff1d(np.arange(VERTICES), on_map)].any()
    assert_allclose(uv[on_map, :2].min(axis=0), -uv[on_map, :2].max(axis=0), atol=1e-3)  # the origin is in the middle
    flat_map = voxflat.load(recon / "surf" / f"{hemi}.voxflat.flat.npz")
    shift = None
    for vertex in on_map[::7].tolist():  # one of the positions of each vertex, moved alike
        moves = uv[vertex, :2] - flat_map.uv[flat_map.ids == vertex]
        shift = moves[0] if shift is None and len(moves) == 1 else shift
        assert shift is None or np.abs(moves - shift).max(axis=1).min() < 1e-3


@pytest.mark.parametrize(("hemi", "front"), [("lh", -1), ("rh", 1)])
def test_the_frontal_poles_are_at_the_outer_sides_and_superior_is_up(store, hemi, front):
    uv, faces = surface(store / "sub-01", "flat", hemi)
    wm, _ = surface(store / "sub-01", "wm", hemi)
    on_map = np.unique(faces)
    assert mean_direction(uv[on_map, :2], wm[on_map, 1])[0] * front > 0.9
    assert mean_direction(uv[on_map, :2], wm[on_map, 2])[1] > 0.9
    a, b, c = (uv[faces[:, k], :2].astype(float) for k in range(3))
    assert (np.linalg.det(np.stack([b - a, c - a], axis=1)) > 0).mean() > 0.999  # seen from outside: no mirror image


# ------------------------------------------------------------------------------ regions of interest


def placed(folder):
    """Return the flat vertices of both hemispheres in pixels, and which are on the map, as pycortex places them."""
    flats = {hemi: surface(folder, "flat", hemi) for hemi in HEMIS}
    left, right = (flats[hemi][0][:, :2].copy() for hemi in HEMIS)
    left[:, 0] -= left[:, 0].max()
    right[:, 0] -= right[:, 0].min()
    places = np.concatenate([left, right])
    places -= places.min(axis=0)
    places /= places.max(axis=0)
    on_map = np.zeros(len(places), dtype=bool)
    on_map[np.concatenate([flats["lh"][1], flats["rh"][1] + len(left)])] = True
    root = ET.parse(folder / "overlays.svg").getroot()
    width, height = float(root.get("width")), float(root.get("height"))
    places = places * (width, height)
    places[:, 1] = height - places[:, 1]
    return root, places, on_map


def found_by_pycortex(folder):
    """Return the vertices on the map in each region: an independent implementation of cortex.utils.get_roi_verts."""
    root, places, on_map = placed(folder)
    layers = {layer.get(LABEL): layer for layer in root.findall(f"{AREA}g")}
    assert list(layers) == ["data", "rois", "sulci", "cutouts", "display"]
    found = {}
    for group in layers["rois"].find(f"{AREA}g[@id='rois_shapes']"):
        mask = np.zeros(len(places), dtype=bool)
        for path in group.findall(f"{AREA}path"):
            for part in re.findall("M ([^Z]*) Z", path.get("d")):
                corners = np.array([[float(x) for x in pair.split(",")] for pair in part.replace("L ", "").split()])
                mask |= crossings(corners, places) % 2 == 1  # pycortex tests each part on its own
        found[group.get(LABEL)] = (mask & on_map)[:VERTICES], (mask & on_map)[VERTICES:]
    return found, (on_map[:VERTICES], on_map[VERTICES:])


def crossings(corners, places):
    """Count the edges of a polygon on the right of each place."""
    count = np.zeros(len(places), dtype=int)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        between = (y0 > places[:, 1]) != (y1 > places[:, 1])
        if between.any():
            count[between] += places[between, 0] < x0 + (places[between, 1] - y0) / (y1 - y0) * (x1 - x0)
    return count


def test_regions_contain_exactly_the_vertices_of_labels_and_annotations(store):
    found, on_map = found_by_pycortex(store / "sub-01")
    assert set(found) == {"front", "back", "holes"}  # neither "unknown" nor the corpus callosum
    for side, hemi in enumerate(HEMIS):
        of = studies.hemisphere(hemi, VERTICES)
        labels = parcels(of)
        holes = np.isin(np.arange(VERTICES), with_holes(of))
        for name, wanted in (("front", labels == 1), ("back", labels == 2), ("holes", holes)):
            assert_array_equal(found[name][side], wanted & on_map[side], err_msg=f"{name} {hemi}")
            assert found[name][side].sum() > 20


def test_each_side_of_a_region_has_a_label_inside_and_its_colour(store):
    text = (store / "sub-01" / "overlays.svg").read_text()
    assert text.count(">front</") == text.count(">back</") == 2
    assert "stroke:#c81e1e" in text
    assert "stroke:#1e3cc8" in text


def test_regions_can_be_left_out(recon, tmp_path):
    voxflat.to_pycortex(recon, tmp_path, name="bare", rois=[])
    assert found_by_pycortex(tmp_path / "bare")[0] == {}


def test_the_usual_regions_are_those_of_aparc(recon, tmp_path):
    voxflat.to_pycortex(recon, tmp_path)
    assert set(found_by_pycortex(tmp_path / "sub-01")[0]) == {"front", "back"}


# ------------------------------------------------------------------------------ existing subjects


def test_flat_surfaces_are_never_replaced_without_overwrite(copied, recon):
    before = everything(copied)
    fail(1, "flat_lh.gii exists. To replace the flat map, pass --overwrite", "pycortex", recon, "--filestore", copied)
    assert everything(copied) == before


def test_what_is_replaced_is_kept_aside_and_can_be_copied_back(copied, recon):
    folder = copied / "sub-01"
    other = (folder / "surfaces" / "flat_lh.gii").read_bytes() + b"\n"
    (folder / "surfaces" / "flat_lh.gii").write_bytes(other)
    np.savez(folder / "surface-info" / "distortion[dist_type=areal].npz", left=np.ones(3), right=np.ones(3))
    (folder / "surface-info" / "mine.npz").write_bytes(b"mine")
    before = {name: content for name, (content, _) in everything(folder).items()}
    (folder / "cache" / "flatverts_1024.npz").write_bytes(b"of the old map")
    succeed("pycortex", recon, "--filestore", copied, "--overwrite")
    assert (folder / "surfaces" / "flat_lh.gii").read_bytes() == other[:-1]
    assert not list((folder / "cache").iterdir())
    assert not list((folder / "surface-info").glob("distortion*"))
    assert (folder / "surface-info" / "mine.npz").read_bytes() == b"mine"
    backup = folder / "voxflat-backup-1"
    kept = everything(backup)
    assert "overlays.svg" in kept
    assert "surfaces/flat_rh.gii" in kept
    assert all(content == before[name] for name, (content, _) in kept.items())
    shutil.copytree(backup, folder, dirs_exist_ok=True)
    shutil.rmtree(backup)
    assert {name: content for name, (content, _) in everything(folder).items()} == before


def test_other_files_of_a_subject_are_kept(copied, recon):
    folder = copied / "sub-01"
    for path in folder.glob("surfaces/flat_*"):
        path.unlink()
    (folder / "overlays.svg").unlink()
    (folder / "transforms" / "run1").mkdir()
    (folder / "transforms" / "run1" / "matrices.xfm").write_text("{}")
    before = everything(folder)
    succeed("pycortex", recon, "--filestore", copied, "--no-rois")
    after = everything(folder)
    assert set(after) - set(before) == {"surfaces/flat_lh.gii", "surfaces/flat_rh.gii", "overlays.svg"}
    assert all(after[name] == content for name, content in before.items())


def test_a_subject_of_the_filestore_keeps_its_regions(copied):
    folder = copied / "sub-01"
    before, on_old = found_by_pycortex(folder)
    kept = everything(folder / "surfaces")
    result = succeed("pycortex", "sub-01", "--filestore", copied, "--overwrite", "--cuts", "automatic")
    assert "found no cortex label" in result.stderr
    after, on_new = found_by_pycortex(folder)
    assert (folder / "voxflat" / "lh.voxflat.flat.npz").is_file()
    assert set(after) == set(before)
    for name, sides in before.items():
        for old, new, was, now in zip(sides, after[name], on_old, on_new, strict=True):
            assert_array_equal(new[was & now], old[was & now], err_msg=name)
    for name in ("wm_lh.gii", "pia_rh.gii", "inflated_lh.gii"):
        assert everything(folder / "surfaces")[name] == kept[name]


def test_a_region_drawn_by_hand_with_curves_is_drawn_on_the_new_map(copied, recon):
    folder = copied / "sub-01"
    root, places, _ = placed(folder)
    x, y = places[:VERTICES].mean(axis=0)
    r, k = 150.0, 150.0 * 0.5522847498  # four curves that differ from a circle by 0.03 %
    turns = [((0, k), (k - r, r), (-r, r)), ((-k, 0), (-r, k - r), (-r, -r))]
    turns += [((0, -k), (r - k, -r), (r, -r)), ((k, 0), (r, r - k), (r, r))]
    curves = " ".join(",".join(f"{part:.6f}" for part in pair) for turn in turns for pair in turn)
    group = ET.SubElement(root.find(f".//{AREA}g[@id='rois_shapes']"), f"{AREA}g", {LABEL: "drawn"})
    ET.SubElement(group, f"{AREA}path", {"d": f"m {x + r:.6f},{y:.6f} c {curves} z"})
    ET.ElementTree(root).write(folder / "overlays.svg")
    away = np.linalg.norm(places - (x, y), axis=1)[:VERTICES]
    old = np.unique(surface(folder, "flat", "lh")[1])
    succeed("pycortex", recon, "--filestore", copied, "--overwrite")
    found, on_map = found_by_pycortex(folder)
    is_clear = on_map[0] & np.isin(np.arange(VERTICES), old) & (np.abs(away - r) > 1)
    assert_array_equal(found["drawn"][0][is_clear], away[is_clear] < r)
    assert (away[is_clear] < r).sum() > 30
    assert not found["drawn"][1].any()


def test_another_brain_of_the_same_name_is_refused(copied, tmp_path):
    other = tmp_path / "sub-01"
    for hemi in HEMIS:
        studies.write_freesurfer(other, hemi, studies.hemisphere(hemi, FEW), studies.C_RAS)
    before = everything(copied)
    told = f"wm_lh.gii has {VERTICES} vertices, but the surface of recon-all has {FEW}. Pass another name"
    fail(1, told, "pycortex", other, "--filestore", copied, "--overwrite")
    assert everything(copied) == before


# ------------------------------------------------------------------------------ wrong input


@pytest.mark.parametrize(
    ("told", "options"),
    [
        ("the region V9 does not exist. Check its name", {"rois": ["V9"]}),
        ("rois is 'aparc'. Pass a list of names or files", {"rois": "aparc"}),
        ("Pass a name without directories", {"name": "../sub-01"}),
        ("overwrite is 'yes'", {"overwrite": "yes"}),
    ],
)
def test_a_wrong_argument_leaves_the_filestore_alone(recon, tmp_path, told, options):
    with pytest.raises(voxflat.InputError, match=re.escape(told)):
        voxflat.to_pycortex(recon, tmp_path / "filestore", **options)
    assert not (tmp_path / "filestore").exists()


def test_a_subject_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(voxflat.InputError, match=r"S9 is neither a FreeSurfer subject directory .* nor a subject in"):
        voxflat.to_pycortex("S9", tmp_path)


def test_a_region_of_one_side_is_refused(recon, tmp_path):
    with pytest.raises(voxflat.InputError, match=r"Write \{hemi\} instead of lh or rh"):
        voxflat.to_pycortex(recon, tmp_path, rois=[recon / "label" / "lh.holes.label"])
    assert list(tmp_path.iterdir()) == []


def test_equal_names_of_regions_are_refused(recon, tmp_path):
    for hemi in HEMIS:
        shutil.copy(recon / "label" / f"{hemi}.aparc.annot", tmp_path / f"{hemi}.copy.annot")
    with pytest.raises(voxflat.InputError, match="both have a region front"):
        voxflat.to_pycortex(recon, tmp_path / "filestore", rois=["aparc", tmp_path / "{hemi}.copy.annot"])
    assert not (tmp_path / "filestore").exists()


def test_damaged_overlays_are_refused_before_anything_is_written(copied, recon):
    (copied / "sub-01" / "overlays.svg").write_text("<svg")
    before = everything(copied)
    fail(1, "overlays.svg", "pycortex", recon, "--filestore", copied, "--overwrite")
    assert everything(copied) == before


# ------------------------------------------------------------------------------ pycortex itself


def test_the_filestore_is_that_of_pycortexs_configuration(recon, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with pytest.raises(voxflat.InputError, match="defines no filestore"):
        voxflat.to_pycortex(recon)
    (tmp_path / "pycortex").mkdir()
    config = tmp_path / "pycortex" / "options.cfg"
    config.write_text(f"[basic]\nfilestore = {tmp_path / 'db'}\ncache = {tmp_path / 'fast'}\n")
    with pytest.raises(voxflat.InputError, match="db, the filestore of pycortex, does not exist"):
        voxflat.to_pycortex(recon)
    (tmp_path / "db").mkdir()
    (tmp_path / "fast" / "sub-01" / "cache").mkdir(parents=True)
    assert voxflat.to_pycortex(recon) == tmp_path / "db" / "sub-01"
    assert not (tmp_path / "fast" / "sub-01" / "cache").exists()


def test_the_hook_has_the_call_of_pycortex_and_replaces_the_map(recon, copied, monkeypatch):
    wanted = "freesurfer_subject pycortex_subject freesurfer_subject_dir autoflatten_args import_flatmaps"
    parameters = inspect.signature(voxflat.autoflatten_subject).parameters
    assert " ".join(parameters) == wanted  # of cortex.freesurfer.autoflatten_subject, pycortex 1.4.0
    assert [parameters[name].default for name in wanted.split()[1:]] == [None, None, None, True]
    running = SimpleNamespace(default_filestore=str(copied))
    monkeypatch.setitem(sys.modules, "cortex.database", running)
    patches = voxflat.autoflatten_subject("sub-01", freesurfer_subject_dir=recon.parent)
    assert patches == {hemi: str(recon / "surf" / f"{hemi}.voxflat.flat.patch.3d") for hemi in HEMIS}
    assert (copied / "sub-01" / "voxflat-backup-1").is_dir()
    before = everything(copied)
    voxflat.autoflatten_subject("sub-01", "other", recon.parent, import_flatmaps=False)
    assert everything(copied) == before
    for arguments, told in ((["--n-cores", "4"], "--n-cores"), (["--cuts"], "expected one argument")):
        with pytest.raises(voxflat.InputError, match=told):
            voxflat.autoflatten_subject("sub-01", None, recon.parent, arguments)
