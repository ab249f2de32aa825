"""`voxflat freesurfer`: files for other programs, up-to-date and repeated results, and failures."""

import hashlib
import json
import re
from pathlib import Path
from unittest.mock import Mock

import nibabel as nib
import numpy as np
import pytest
import studies
from command_line import fail, run, succeed
from freesurfer_rule import read_patch
from lab_runs import FEW, VERTICES, console_of, everything
from mesh_files import needs_workbench, workbench
from nilearn.surface import load_surf_data, load_surf_mesh
from numpy.testing import assert_allclose, assert_array_equal

import voxflat
from voxflat.lab.report import REFERENCES
from voxflat.lab.results import FIGURES

pytestmark = pytest.mark.slow  # its fixtures take seconds

ALL = ("distanceerror", "areachange", "curvature", "sulcaldepth", "thickness", "z")


def values(folder, name):
    return nib.load(folder / "surf" / f"lh.voxflat.{name}.shape.gii").agg_data()


def flat_of(folder, hemi="lh"):
    return voxflat.load(folder / "surf" / f"{hemi}.voxflat.flat.npz")


def record_of(folder):
    return json.loads((folder / "surf" / "lh.voxflat.flat.json").read_text())


@pytest.fixture(scope="module")
def flat_map(made):
    return flat_of(made)


def test_what_is_written(flattened):
    made, result = flattened
    wanted = {f"{h}.voxflat.flat.{end}" for h in ("lh", "rh") for end in ("patch.3d", "surf.gii", "npz", "json")}
    wanted |= {f"{h}.voxflat.{name}.shape.gii" for h in ("lh", "rh") for name in ALL}
    assert {path.name for path in (made / "surf").glob("*voxflat*")} == wanted
    assert re.search(r"sub-01 L: \d+ points, relative distance error \d+\.\d %", result.stdout)
    assert f"report: {made}/voxflat.html" in result.stdout


def test_the_record_says_what_made_it(made, flat_map):
    record = record_of(made)
    for file in record["inputs"].values():
        assert file["sha256"] == hashlib.sha256(Path(file["path"]).read_bytes()).hexdigest()
    assert set(record["inputs"]) == {"white", "pial", "sphere", "cortex", "overlay thickness", "overlay z"}
    assert record["figures"] == flat_map.distortion.figures()
    assert record["map"]["cut_names"] == ["calcarine", "medial 1", "medial 2", "medial 3", "temporal"]
    assert (record["surface"]["vertices"], record["surface"]["euler"]) == (VERTICES, 2)
    assert "are not written" in " ".join(record["notes"])  # triangles at the cuts of the surface and the patch
    for name, digest in record["outputs"].items():
        assert hashlib.sha256((made / "surf" / name).read_bytes()).hexdigest() == digest


def test_what_a_call_reads_is_what_the_record_watches(made, flat_map):
    record = record_of(made)
    watched = {file["sha256"] for file in record["inputs"].values()}
    provenance = flat_map.provenance
    region = provenance["parameters"]["of"]
    records = (provenance, region, region["parameters"]["of"])  # flatten, keep, surface
    read = {digest for record in records for digest in record["files"].values()}
    assert read <= watched
    assert len(read) == 4


def test_the_map_is_that_of_the_functions_on_what_the_cortex_label_says(made, flat_map):
    surf = made / "surf"
    whole = voxflat.surface(surf / "lh.white", pial=surf / "lh.pial")
    own = whole.keep(made / "label" / "lh.cortex.label").flatten(cuts="standard", sphere=surf / "lh.sphere.reg")
    assert_array_equal(flat_map.uv, own.uv)
    assert_array_equal(flat_map.ids, own.ids)
    of = studies.hemisphere("lh", VERTICES)
    assert of["cortex"][flat_map.ids].all()
    assert len(np.unique(flat_map.ids)) > 0.97 * of["cortex"].sum()  # the largest piece of whole triangles


def test_measures_lie_at_the_vertices_and_nothing_lies_elsewhere(made, flat_map):
    on_map = np.unique(flat_map.ids)
    for name in ALL[:-1]:
        assert_array_equal(np.flatnonzero(np.isfinite(values(made, name))), on_map)
    of_points, found = flat_map.distortion.per_point.astype(np.float32), values(made, "distanceerror")
    for vertex in on_map.tolist():  # on either side of a cut
        assert found[vertex] in of_points[flat_map.ids == vertex]
    thickness = nib.freesurfer.read_morph_data(made / "surf" / "lh.thickness")
    assert_array_equal(values(made, "thickness")[on_map], thickness[on_map])


def test_a_volume_is_sampled_where_it_lies_in_the_middle_of_the_cortex(made, flat_map):
    of, on_map = studies.hemisphere("lh", VERTICES), np.unique(flat_map.ids)
    white, pial = (of[name][:, 2] + studies.C_RAS[2] for name in ("white", "pial"))
    share = (values(made, "z") - white)[on_map] / (pial - white)[on_map]
    is_telling = np.abs(pial - white)[on_map] > 1
    # equivolume: between 0.3 and 0.7 of the way, by how the surface bends
    assert is_telling.sum() > 200
    assert (np.abs(share[is_telling] - 0.5) < 0.25).mean() > 0.97


def test_the_patch_is_the_map_by_freesurfers_rule_and_turned_by_pycortexs(made, flat_map):
    _, faces = nib.freesurfer.read_geometry(made / "surf" / "lh.smoothwm")
    listed, _, triangles = read_patch(made / "surf" / "lh.voxflat.flat.patch.3d", faces)
    of_map = {tuple(sorted(triangle)) for triangle in flat_map.ids[flat_map.faces].tolist()}
    assert {tuple(sorted(triangle)) for triangle in triangles} <= of_map
    assert len(triangles) > 0.8 * len(of_map)
    for vertex, place in listed.items():  # on one of the sides of a cut
        assert np.abs(flat_map.uv[flat_map.ids == vertex] - place[:2]).max(axis=1).min() < 1e-3
    points = pycortex_flat(made, "lh", "voxflat")  # u is y of the file, v is −x: turned by a right angle, no mirror
    some = np.array(sorted(listed))
    places = np.array([listed[vertex] for vertex in some.tolist()])
    assert_allclose(points[some, 0], places[:, 1], atol=1e-4)
    assert_allclose(points[some, 1], -places[:, 0], atol=1e-4)


def pycortex_flat(folder, hemi, patch):
    """Read surf/?h.{patch}.flat.patch.3d with the vertices of ?h.smoothwm, like cortex.freesurfer.import_flat."""
    points, _ = nib.freesurfer.read_geometry(folder / "surf" / f"{hemi}.smoothwm")
    data = (folder / "surf" / f"{hemi}.{patch}.flat.patch.3d").read_bytes()
    count = int.from_bytes(data[4:8], "big")
    entries = np.frombuffer(data[8:], [("vert", ">i4"), ("x", ">f4"), ("y", ">f4"), ("z", ">f4")])
    assert len(entries) == count
    for sign in (1, -1):
        own = entries[sign * entries["vert"] > 0]
        points[sign * own["vert"] - 1] = np.stack([own["x"], own["y"], own["z"]], axis=1)
    flat = points[:, [1, 0, 2]]
    flat[:, 1] = -flat[:, 1]
    return flat


@needs_workbench
def test_workbench_reads_every_value(made, tmp_path):
    surf = made / "surf"
    for name in ("flat.surf.gii", "distanceerror.shape.gii"):
        told = workbench("-file-information", surf / f"lh.voxflat.{name}")
        assert re.search(rf"Number of Vertices: +{VERTICES}\b", told)
        assert re.search(r"Structure: +CortexLeft", told)
    workbench("-surface-coordinates-to-metric", surf / "lh.voxflat.flat.surf.gii", tmp_path / "places.func.gii")
    places = np.stack(nib.load(tmp_path / "places.func.gii").agg_data(), axis=1)
    assert_array_equal(places, nib.load(surf / "lh.voxflat.flat.surf.gii").agg_data("pointset"))
    for name in ALL:
        workbench("-metric-convert", "-to-nifti", surf / f"lh.voxflat.{name}.shape.gii", tmp_path / "one.nii")
        assert_array_equal(np.asarray(nib.load(tmp_path / "one.nii").dataobj).ravel(), values(made, name))


def test_nilearn_reads_every_value(made, flat_map):
    surf = made / "surf"
    mesh = load_surf_mesh(surf / "lh.voxflat.flat.surf.gii")
    on_map = np.unique(flat_map.ids)
    assert mesh.n_vertices == VERTICES
    for vertex in on_map.tolist():  # on one of the sides of a cut
        assert np.abs(flat_map.uv[flat_map.ids == vertex] - mesh.coordinates[vertex, :2]).max(axis=1).min() < 1e-4
    for name in ("distanceerror", "thickness", "z"):
        assert_array_equal(load_surf_data(surf / f"lh.voxflat.{name}.shape.gii"), values(made, name))


def test_what_is_up_to_date_is_left_alone(made):
    before = everything(made)
    again = run("freesurfer", made, "--overlay", "mri/z.mgz", "--overlay", "thickness")
    assert (again.exit_code, again.stdout.count("up to date")) == (0, 2)
    assert everything(made) == before
    left = run("freesurfer", made, "--hemi", "lh", "--overlay", "mri/z.mgz", "--overlay", "thickness")
    assert (left.exit_code, left.stdout.count("up to date")) == (0, 1)
    assert everything(made) == before  # the report shows the other hemisphere, too


def test_another_parameter_makes_it_anew_and_the_first_one_as_it_was(subject):
    succeed("freesurfer", subject, "--hemi", "lh")
    first = everything(subject / "surf")
    curv = run("freesurfer", subject, "--hemi", "lh", "--overlay", "curv", "--json")
    (told,) = json.loads(curv.stdout)["hemispheres"]
    assert (told["state"], "lh.voxflat.curv.shape.gii" in told["outputs"]) == ("made", True)
    succeed("freesurfer", subject, "--hemi", "lh")
    made_again = everything(subject / "surf")
    assert set(first) == set(made_again)  # the overlay of the second call is gone
    unequal = {name for name in first if first[name][0] != made_again[name][0]}
    assert unequal <= {"lh.voxflat.flat.json"}  # contains the run time
    assert "up to date" in run("freesurfer", subject, "--hemi", "lh").stdout


def test_ctrl_c_leaves_nothing_that_looks_finished(subject, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("voxflat.lab.subject.value_bytes", Mock(side_effect=KeyboardInterrupt))
        assert run("freesurfer", subject, "--hemi", "lh").exit_code == 130
    left = {path.name for path in (subject / "surf").iterdir()}
    assert not any(name.startswith(".") or name.endswith(("flat.json", "failure.json")) for name in left)
    assert not (subject / "voxflat.html").exists()
    assert "points" in run("freesurfer", subject, "--hemi", "lh").stdout


def test_the_geometry_is_what_distances_are_measured_on(subject):
    succeed("freesurfer", subject, "--hemi", "lh", "--geometry", "pial")
    flat = flat_of(subject)
    assert_allclose(flat.points, studies.hemisphere("lh", FEW)["pial"][flat.ids], atol=1e-3)


def test_without_a_label_the_parcellation_says_what_cortex_is_and_without_both_the_template(subject):
    of = studies.hemisphere("lh", FEW)
    (subject / "label" / "lh.cortex.label").unlink()
    areas = np.where(of["cortex"], 1 + (of["white"][:, 2] > 0), 0)
    table = np.array([[25, 5, 25, 0, 0], [100, 9, 9, 0, 0], [9, 100, 9, 0, 0]])
    path = subject / "label" / "lh.aparc.annot"
    nib.freesurfer.write_annot(path, areas, table, ["unknown", "low", "high"], fill_ctab=True)
    succeed("freesurfer", subject, "--hemi", "lh")
    assert of["cortex"][flat_of(subject).ids].all()
    path.unlink()
    succeed("freesurfer", subject, "--hemi", "lh")
    flat = flat_of(subject)
    assert not of["cortex"][flat.ids].all()
    assert 0.85 < len(np.unique(flat.ids)) / FEW < 0.99


def test_cuts_of_a_file(subject):
    succeed("cut", subject / "surf" / "lh.white", "--cuts", "standard", "-o", subject / "lh.mine.json")
    succeed("freesurfer", subject, "--hemi", "lh", "--cuts", "{hemi}.mine.json")
    assert record_of(subject)["inputs"]["cuts"]["path"].endswith("lh.mine.json")
    told = (subject / "lh.mine.json").read_text()
    cuts = flat_of(subject).metadata["cuts"]
    assert len(cuts) == 5
    assert all(json.dumps(cut)[1:-1].replace(" ", "") in re.sub(r"\s", "", told) for cut in cuts)


def test_a_missing_file_is_named_and_the_other_hemisphere_made(subject):
    told = f"sub-02 R: error: {subject}/surf/rh.white: the file does not exist. Check that recon-all"
    result = fail(1, told, "freesurfer", subject)
    assert "sub-02 L: " in result.stdout
    assert "The right hemisphere has no map" in (subject / "voxflat.html").read_text()
    assert json.loads((subject / "surf" / "rh.voxflat.failure.json").read_text())["reason"] in result.stderr


def test_an_earlier_report_does_not_outlive_a_failure(subject):
    succeed("freesurfer", subject, "--hemi", "lh")
    (subject / "surf" / "lh.white").write_bytes(b"")
    failed = run("freesurfer", subject, "--hemi", "lh")
    assert failed.exit_code == 1
    page = (subject / "voxflat.html").read_text()
    assert "The left hemisphere has no map" in page
    assert all("lh.white is not a surface (0 bytes). Run recon-all" in text for text in (page, failed.stderr))
    assert "<img" not in page


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--overlay", "zstat"], r"zstat does not exist.* \S+sub-02/surf/lh.zstat, \S+sub-02/zstat, /\S+/zstat\n"),
        (["--overlay", "surf/{hemi}.curv", "curv"], "two overlays have the name curv"),
        (["--cuts", "{hemi}.mine.json"], r"the cuts file \{hemi\}\.mine\.json does not exist\. .*/lh\.mine\.json"),
        (["--volume"], r"mri/filled\.mgz: the file does not exist"),
        (["--overlay", "label/{hemi}.cortex.label"], "contains labels. Draw them with voxflat figure MAP"),
    ],
)
def test_what_was_asked_for_and_is_not_there_is_said(subject, arguments, told):
    result = run("freesurfer", subject, "--hemi", "lh", *arguments)
    assert result.exit_code == 1
    assert re.search(told, result.stderr)
    assert not list((subject / "surf").glob("*voxflat.flat*"))


def test_a_series_is_no_overlay(subject):
    count = len(nib.freesurfer.read_morph_data(subject / "surf" / "lh.thickness"))
    nib.save(nib.MGHImage(np.ones((count, 1, 1, 3), np.float32), np.eye(4)), subject / "surf" / "lh.bold.mgz")
    (subject / "mri").mkdir(exist_ok=True)
    nib.save(nib.Nifti1Image(np.ones((9, 9, 9, 3), np.float32), np.eye(4)), subject / "mri" / "bold.nii")
    for name, told in (("lh.bold.mgz", "3 maps"), ("bold.nii", "3 frames")):
        result = run("freesurfer", subject, "--hemi", "lh", "--overlay", next(subject.rglob(name)).relative_to(subject))
        assert result.exit_code == 1
        assert re.search(rf"the overlay \S+{name} has {told}. Pass a file with one map, or", result.stderr)
    assert not list((subject / "surf").glob("*voxflat.flat*"))


def test_what_is_no_directory_of_freesurfer_is_refused(tmp_path):
    fail(1, "has no directory surf/. Pass", "freesurfer", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_report_holds_everything_and_needs_no_network(made):
    page = (made / "voxflat.html").read_text()
    assert len(page) < 5e6
    assert re.findall(r"""(?:src|href)=["'](?!data:|#)""", page) == []
    assert re.findall(r"""url\(|@import|https?://(?!www\.w3\.org)""", page) == []
    record = record_of(made)
    assert f"{100 * record['figures']['best_scale']['relative_error']:.2f}" in page
    citation = voxflat.cite(flat_of(made), flat_of(made, "rh"))
    for text in (*record["warnings"], *record["notes"]):
        assert "<code>".join((text[0].upper() + text[1:]).split("`", 1)).replace("`", "</code>") + ".</p>" in page
    assert "<code>voxflat check</code>" in page
    for text in (record["versions"]["numpy"], citation.text, citation.bibtex):
        assert text.replace("'", "&#39;") in page
    assert page.count('<script type="application/json">') == 2
    assert page.count("<img ") == 2 * 5  # folds, two overlays, errors, areas


def test_the_report_shows_both_hemispheres_side_by_side(made):
    page = (made / "voxflat.html").read_text()
    found = re.findall(r'width="(\d+)" height="\d+" alt="(.*?) on the flat map of the (left|right) hemisphere"', page)
    titles = [title for _, title, _ in found[::2]]
    assert [(title, side) for _, title, side in found] == [(one, side) for one in titles for side in ("left", "right")]
    assert titles[0] == "Folds"
    assert len(titles) == 5  # thickness, z, errors of distances and areas
    maps = [flat_of(made, hemi).uv[:, 0] for hemi in ("lh", "rh")]
    wide = [int(width) for width, *_ in found[:2]]
    assert wide[0] / wide[1] == pytest.approx(np.ptp(maps[0]) / np.ptp(maps[1]), rel=0.02)  # the same scale


def test_references_are_those_of_the_benchmark():
    text = (Path(__file__).parents[2] / "docs/explanation/evidence.md").read_text()
    rows = {
        "fsaverage5 white surface, standard cuts": "standard",
        "FreeSurfer's flat map of fsaverage5": "distributed map",
        "fsaverage5 white surface, automatic cuts": "automatic",
    }
    for references in REFERENCES.values():
        for name, of_sides in references.items():
            for side, told in zip(("left", "right"), of_sides, strict=True):
                (row,) = re.findall(rf"^\| {side} \| {rows[name]} \|(.*)\|$", text, re.MULTILINE)
                cells = [cell.strip() for cell in row.split("|")]
                cells = [*cells[1:6], *cells[6].split(", "), *cells[7:]]
                assert [float(cell) for cell in cells] == list(told)
                assert len(told) == len([place for place in FIGURES if not place.startswith("template.")])


def test_chromium_draws_the_report_on_a_dark_phone_and_says_nothing(made):
    said, page = console_of(made / "voxflat.html", "--window-size=390,840", "--force-dark-mode")
    assert said == []
    assert '<p class="note">This browser' not in page
    assert 'class="viewer card"' in page
    assert not re.search(r'class="viewer card"[^>]*hidden', page)  # viewers appear after they are drawn
