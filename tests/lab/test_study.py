"""`voxflat bids`: twenty participants with three damaged ones, a rerun, a change, the table and the group page."""

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import click
import nibabel as nib
import numpy as np
import pytest
import studies
from command_line import fail, run, succeed
from lab_runs import FEW, everything
from matplotlib.tri import LinearTriInterpolator, Triangulation
from numpy.testing import assert_allclose
from refusals import refused

import voxflat
from voxflat.cli.commands.study import bids_command
from voxflat.lab.inputs import Parameters, found_in, participants
from voxflat.lab.results import sealed

pytestmark = pytest.mark.slow  # its fixtures take seconds

BROKEN = {"05": r"found no \*_hemi-L_pial\.surf\.gii", "08": r"_white\.surf\.gii: .*Check that the file is complete"}
BROKEN["11"] = rf"has {FEW - 1} vertices"


def participant(root, *more):
    return run("bids", root / "bids", root / "out", "participant", "--hemi", "L", *more)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Return the directory of a study and its output, and the result of the command."""
    root = tmp_path_factory.mktemp("study")
    below = root / "bids" / "derivatives" / "smriprep"
    of = studies.hemisphere("lh", FEW)
    for n in range(1, 21):
        studies.write_derivatives(below / f"sub-{n:02}" / "anat", f"sub-{n:02}", "lh", studies.warped(of, n))
    (below / "sub-05" / "anat" / "sub-05_hemi-L_pial.surf.gii").unlink()
    white = below / "sub-08" / "anat" / "sub-08_hemi-L_white.surf.gii"
    white.write_bytes(white.read_bytes()[: white.stat().st_size // 2])
    sphere = next((below / "sub-11" / "anat").glob("*sphere.surf.gii"))
    points, faces = nib.load(sphere).agg_data()
    is_left = (faces != FEW - 1).all(axis=1)
    arrays = [nib.gifti.GiftiDataArray(points[:-1], "NIFTI_INTENT_POINTSET")]
    arrays += [nib.gifti.GiftiDataArray(faces[is_left], "NIFTI_INTENT_TRIANGLE")]
    nib.save(nib.gifti.GiftiImage(darrays=arrays), sphere)
    return root, participant(root)


@pytest.fixture(scope="module")
def root(study):
    return study[0]


@pytest.fixture(scope="module")
def compared(root):
    return run("bids", root / "bids", root / "out", "group", "--json")


def test_three_fail_by_name_and_never_stop_the_others(study):
    root, result = study
    assert result.exit_code == 3
    only = "(only left hemispheres, because of --hemisphere)"
    assert f"20 participants: 17 made, 0 up to date, 3 failed {only}" in result.stdout
    assert len(list((root / "out").glob("sub-*/anat/*_flat.surf.gii"))) == 17
    assert len(list((root / "out").glob("sub-*.html"))) == 17
    record = json.loads(next((root / "out").rglob("*_flat.json")).read_text())
    assert record["warnings"] == []
    assert "standard cuts" in record["notes"][0]  # not on the terminal
    assert "not written to the file" in record["notes"][1]
    assert f"\nreports: 17 pages, such as {root / 'out' / 'sub-01.html'}\n" in result.stdout
    assert result.stdout.splitlines()[-1] == f"next: voxflat bids {root / 'bids'} {root / 'out'} group"
    lines = result.stderr.splitlines()
    assert len(lines) == 3
    assert "earlier run" not in result.stderr
    for (label, reason), line in zip(BROKEN.items(), lines, strict=True):
        assert re.match(rf"voxflat: sub-{label} L: error: ", line)
        assert re.search(reason, line)
        assert not list((root / "out" / f"sub-{label}").rglob("*flat*surf*"))
        (failure,) = (root / "out" / f"sub-{label}").rglob("*_failure.json")
        assert json.loads(failure.read_text())["reason"] in line


def test_a_rerun_computes_nothing_and_writes_nothing(root, monkeypatch):
    made = []

    def make(hemisphere, *_, **__):
        made.append(next(iter(hemisphere.files.values())).name[:6])
        raise voxflat.InputError("not again")

    monkeypatch.setattr("voxflat.lab.study.make", make)
    monkeypatch.setattr("voxflat.lab.report.subject_page", make)
    before = everything(root / "out")
    failures = {name: content for name, content in before.items() if name.endswith("failure.json")}
    again = participant(root)
    assert (again.exit_code, "0 made, 17 up to date, 3 failed" in again.stdout) == (3, True)
    assert made == ["sub-08", "sub-11"]  # their files exist, so they are tried again
    monkeypatch.undo()
    for name, (content, _) in failures.items():
        (root / "out" / name).write_bytes(content)
    again = participant(root)
    assert again.exit_code == 3
    now = everything(root / "out")
    assert {name for name in now if now[name] != before[name]} <= set(failures)
    assert {name: of[0] for name, of in now.items()} == {name: of[0] for name, of in before.items()}


def test_a_dry_run_says_what_would_be_done_and_a_change_of_one_redoes_one(root, tmp_path):
    shutil.copytree(root / "bids", tmp_path / "bids")
    shutil.copytree(root / "out", tmp_path / "out")
    changed = next((tmp_path / "bids").rglob("sub-07_hemi-L_thickness.shape.gii"))
    image = nib.load(changed)
    image.darrays[0].data += 0.5
    nib.save(image, changed)
    lost = tmp_path / "out" / "sub-09" / "anat" / "sub-09_hemi-L_desc-voxflat_curvature.shape.gii"
    lost.unlink()
    before = everything(tmp_path / "out")
    plan = [json.loads(line) for line in participant(tmp_path, "--dry-run").stdout.splitlines()]
    assert everything(tmp_path / "out") == before
    assert len(plan) == 20
    stale = {one["participant"]: one["reason"] for one in plan if one["state"] == "stale"}
    missing = f"{lost.name} is missing"
    assert stale == {"sub-07": "changed inputs: overlay thickness", "sub-09": missing}
    assert [one["participant"] for one in plan if one["state"] == "failed"] == ["sub-05"]
    next((tmp_path / "bids").rglob("sub-06_hemi-L_white.surf.gii")).touch()  # times do not matter
    participant(tmp_path, "--participant_label", "sub-07", "06")
    now = everything(tmp_path / "out")
    touched = {name[:6] for name in now.keys() - {"dataset_description.json"} if now[name] != before.get(name)}
    assert touched == {"sub-07"}
    again = participant(tmp_path)
    assert (again.exit_code, "1 made, 16 up to date, 3 failed" in again.stdout) == (3, True)
    after = everything(tmp_path / "out")
    told = [name for name in after if after[name] != now.get(name) and not name.endswith("_failure.json")]  # with paths
    assert {name[:6] for name in told} == {"sub-09"}


def test_a_failure_of_other_parameters_is_forgotten(root):
    first = ["--participant-label", "01"]
    short = next((root / "bids").rglob("sub-01_hemi-L_thickness.shape.gii")).with_name("short.txt")
    short.write_text("1\n2\n")
    failed = participant(root, *first, "--overlay", "short.txt")
    assert failed.exit_code == 1
    assert f". The maps of an earlier run remain in {root / 'out' / 'sub-01' / 'anat'}\n" in failed.stderr
    short.unlink()
    (failure,) = (root / "out" / "sub-01").rglob("*_failure.json")
    assert "The maps of an earlier run remain" in json.loads(failure.read_text())["reason"]
    assert participant(root, *first).exit_code == 0
    assert not failure.exists()


def test_another_parameter_makes_all_stale(root):
    told = participant(root, "--dry-run", "--geometry", "white").stdout
    plan = [json.loads(line) for line in told.splitlines()]
    assert {one["state"] for one in plan if one["participant"] not in ("sub-05",)} == {"stale", "missing"}
    assert next(one["reason"] for one in plan if one["state"] == "stale").endswith(" instead of midthickness")


def test_results_of_other_options_are_not_replaced_without_a_warning(root, tmp_path, monkeypatch):
    shutil.copytree(root / "out", tmp_path / "out")
    shutil.copytree(root / "bids", tmp_path / "bids")
    assert participant(tmp_path, "--participant-label", "01,02", "--cuts", "automatic").exit_code == 0
    participant(tmp_path, "--participant-label", "03", "--geometry", "white", "--overlay", "thickness")
    (reason,) = {
        json.loads(line)["reason"] for line in participant(tmp_path, "--dry-run").stdout.splitlines() if "cuts:" in line
    }
    monkeypatch.setattr("voxflat.lab.study.make", Mock(side_effect=KeyboardInterrupt))
    told = participant(tmp_path).stderr
    first = "voxflat: warning: the maps of sub-01, sub-02 will be replaced, because other options are given"
    remedy = "To keep them, press Ctrl-C now, and repeat the command with --cuts automatic\n"
    assert f"{first} ({reason}). {remedy}" in told
    assert reason == "cuts: standard instead of automatic"
    assert "the maps of sub-03 " in told
    assert "geometry: midthickness instead of white" in told
    assert re.search(r"the command with --geometry white, with --overlay thickness\n", told)
    told = participant(tmp_path, "--volume", "--participant-label", "04").stderr
    assert "will be replaced" not in told  # there is no volume
    told = participant(tmp_path, "--seed", "3", "--cuts", "automatic", "--participant-label", "01").stderr
    assert "(seed: 3 instead of 0). To keep them, press Ctrl-C now, and repeat the command without --seed\n" in told
    told = participant(tmp_path, "--cuts", "automatic", "--participant-label", "01").stderr
    assert "will be replaced" not in told


def test_files_that_exist_for_nobody_are_refused_before_anything_changes(root):
    before = everything(root)
    for more in ([], ["--participant-label", "01"], ["--dry-run"]):
        told = "the overlay thicknes does not exist. Did you mean thickness? voxflat searched for "
        fail(1, told, "bids", root / "bids", root / "out", "participant", *more, "--overlay", "thicknes")
        told = "the cuts file own.cuts.json does not exist. Check the name; voxflat searched for "
        fail(1, told, "bids", root / "bids", root / "out", "participant", *more, "--cuts", "own.cuts.json")
    told = "the overlay lh.thickness does not exist. Did you mean thickness?"
    fail(1, told, "bids", root / "bids", root / "out", "participant", "--overlay", "lh.thickness")
    assert everything(root) == before


def test_an_overlay_that_only_one_participant_lacks_is_a_failure_of_that_one(root, tmp_path):
    shutil.copytree(root / "bids", tmp_path / "bids")
    next((tmp_path / "bids").rglob("sub-01_hemi-L_thickness.shape.gii")).unlink()
    alone = participant(tmp_path, "--participant-label", "01", "--overlay", "thickness")
    assert (alone.exit_code, "sub-01 L: error: the overlay thickness does not exist" in alone.stderr) == (1, True)
    assert list((tmp_path / "out").rglob("sub-01*_failure.json"))


def test_swapped_directories_are_suspected(root, tmp_path):
    before = everything(root)
    for out in (root / "out", tmp_path / "nothing"):
        for level in ("participant", "group"):
            told = f"{root / 'bids'} contains files of participants, but {out} "
            fail(1, told, "bids", out, root / "bids", level)
    assert everything(root) == before


def test_arguments_after_an_option_of_several_values_are_missed_with_a_remedy(root):
    told = "--participant-label uses all words that follow it. Write the arguments before it: voxflat bids BIDS_DIR OUT"
    fail(2, told, "bids", "--participant-label", "01", "02", root / "bids", root / "out", "participant")


def test_names_are_those_of_bids_as_far_as_its_schema_goes(root, compared):
    validator = pytest.importorskip("bidsschematools.validator")
    out = root / "out"
    assert [str(path) for path in validator.validate_bids(str(out), dummy_paths=False)["path_tracking"]] == []
    (out / ".bidsignore").rename(out / "ignored")
    try:
        assert len(validator.validate_bids(str(out), dummy_paths=False)["path_tracking"]) > 17
    finally:
        (out / "ignored").rename(out / ".bidsignore")
    described = json.loads((out / "dataset_description.json").read_text())
    assert described["DatasetType"] == "derivative"
    assert described["GeneratedBy"] == [{"Name": "voxflat", "Version": voxflat.__version__}]


def test_a_directory_of_another_program_is_left_alone(root, tmp_path):
    (tmp_path / "dataset_description.json").write_text('{"GeneratedBy": [{"Name": "fMRIPrep"}]}')
    for out, told in ((tmp_path, "derivatives of another program"), (root / "bids", "is the input")):
        before = everything(out)
        for level in (["participant"], ["participant", "--dry-run"], ["group"]):
            fail(1, told, "bids", root / "bids", out, *level)
        assert everything(out) == before


@pytest.mark.parametrize(
    ("label", "told"),
    [
        ("../evil", "the participant label is '../evil'. Pass letters and digits"),
        ("", "the participant label is ''"),
        ("01 02", "the participant label is '01 02'"),
        ("sub-", "the participant label is 'sub-'"),
        ("99", "no participant has the label 99. Pass labels that exist: 01, 02, 03,"),
        ("sub-sub-01", "the participant label is 'sub-sub-01'"),
    ],
)
def test_an_impossible_or_unknown_label_is_refused_before_anything_is_written(root, label, told):
    before = everything(root)
    for level in (["participant"], ["participant", "--dry-run"], ["group"]):
        fail(1, told, "bids", root / "bids", root / "out", *level, "--participant-label", "01", label)
    fail(1, told, "bids", root / "bids", root / "nothing", "participant", "--participant-label", label)
    assert everything(root) == before
    assert not (root / "nothing").exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--threads", "0"], "--threads is 0. Pass a number from 1"),
        (["--seed", "-1"], "the seed is -1"),
        (["--memory-limit", "0"], "'0' is less than one byte"),
        (["--cuts", "automatc"], '\'automatc\' is not a kind of cuts. Pass "standard", "automatic" or'),
    ],
)
def test_invalid_options_are_refused_once_before_any_work(root, options, told):
    before = everything(root)
    subject = next((root / "bids").rglob("sub-01"))
    for words in (["bids", root / "bids", root / "out", "participant"], ["freesurfer", subject]):
        assert fail(2, told, *words, *options).stderr.count("rror:") == 1
    assert everything(root) == before


def test_files_instead_of_directories_are_named(root, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    fail(1, f"{file} is a file. Pass the directory of a study", "bids", file, tmp_path / "out", "participant")
    for level in ("participant", "group"):
        fail(1, f"{file} is a file. Pass a directory for the output", "bids", root / "bids", file, level)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_participants_are_found_where_programs_leave_them(tmp_path):
    def file(path):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).touch()

    def named(folder, *labels):
        return [(one.name, one.folder and one.folder.name) for one in participants(tmp_path / folder, *labels)]

    for name in ("bert", "sub-02_ses-a", "sub-02_ses-a.long.sub-02", "sub-x_y", "fsaverage"):
        file(f"subjects/{name}/surf/lh.white")
    (tmp_path / "subjects" / "sub-03").mkdir()
    wanted = [("sub-02_ses-a", "sub-02_ses-a"), ("sub-03", "sub-03"), ("sub-bert", "bert"), ("sub-xy", "sub-x_y")]
    assert named("subjects") == wanted
    for name in ("sub-1", "sub-2"):
        file(f"raw/{name}/anat/{name}_T1w.nii.gz")
    file("raw/derivatives/fmriprep/sub-1/ses-b/anat/sub-1_ses-b_hemi-R_white.surf.gii")
    file("raw/derivatives/freesurfer/sub-2/surf/lh.white")
    (tmp_path / "raw" / "sub-3").mkdir()
    assert named("raw") == [("sub-1_ses-b", "anat"), ("sub-2", "sub-2"), ("sub-3", None)]
    assert named("raw", ["sub-1"]) == [("sub-1_ses-b", "anat")]
    for name in ("sub-1", "1"):
        file(f"clash/{name}/surf/lh.white")
    refused("are both sub-1. Rename one", participants, tmp_path / "clash")
    (tmp_path / "empty").mkdir()
    refused("no participant has", participants, tmp_path / "empty")


def test_a_second_derivative_hides_nobody_and_the_directories_are_told(tmp_path):
    of = studies.hemisphere("lh", FEW)
    below = tmp_path / "bids" / "derivatives"
    studies.write_derivatives(below / "fmriprep" / "sub-1" / "anat", "sub-1", "lh", of)
    (below / "fmriprep" / "sub-2" / "anat").mkdir(parents=True)  # unfinished
    for n in (1, 2, 3):
        studies.write_freesurfer(below / "freesurfer" / f"sub-{n}", "lh", of)
    told = participant(tmp_path)
    assert "3 participants: 3 made" in told.stdout
    first, second = below / "fmriprep", below / "freesurfer"
    assert f"voxflat: 1 participant is read from {first}, not from {second}\n" in told.stderr
    assert f"voxflat: 2 participants are read from {second}\n" in told.stderr
    records = {path.name[:5]: json.loads(path.read_text()) for path in (tmp_path / "out").rglob("*_flat.json")}
    taken = {name: Path(record["inputs"]["white"]["path"]).parents[2] for name, record in records.items()}
    assert taken == {"sub-1": first, "sub-2": second, "sub-3": second}
    assert "read from" not in participant(tmp_path, "--participant-label", "3").stderr


def test_white_matter_in_voxels_and_cuts_that_suit_it(tmp_path):
    i, j, k = np.indices((16, 16, 16)) - 7.5
    filled = np.where(i**2 + j**2 + k**2 < 6**2, 127, 0).astype(np.uint8)
    filled[7, 7, 7] = 0  # filled by the repair
    filled[0, 0, 0] = 255  # the other hemisphere
    mri = tmp_path / "subjects" / "sub-1" / "mri"
    mri.mkdir(parents=True)
    nib.save(nib.MGHImage(filled, np.diag([2.0, 2, 2, 1])), mri / "filled.mgz")
    nib.save(nib.MGHImage(i.astype(np.float32), np.diag([2.0, 2, 2, 1])), mri / "i.mgz")
    command = ["bids", tmp_path / "subjects", tmp_path / "out", "participant", "--volume", "--hemi", "R"]
    succeed(*command, "--cuts", "automatic", "--overlay", "mri/i.mgz")
    made = tmp_path / "out" / "sub-1" / "anat"
    flat = voxflat.load(made / "sub-1_hemi-R_flat.npz")
    values = nib.load(made / "sub-1_hemi-R_desc-voxflat_i.shape.gii").agg_data()
    assert_allclose(values, flat.points[:, 0] / 2 - 7.5, atol=1e-3)
    record = json.loads((made / "sub-1_hemi-R_flat.json").read_text())
    assert record["surface"]["voxels_changed"] == 1
    assert record["map"]["cuts_by"] == "automatic"
    page = (tmp_path / "out" / "sub-1.html").read_text()
    assert 'class="viewer card"' in page
    assert "automatic cuts</th>" in page  # reference maps


def test_white_matter_is_found_by_its_name(tmp_path):
    for name in ("sub-1_hemi-R_label-WM_probseg.nii.gz", "sub-1_hemi-L_label-WM_mask.nii.gz", "sub-1_T1w.nii.gz"):
        (tmp_path / name).write_bytes(b"")
    found = found_in(tmp_path, "rh", Parameters(volume=True))
    assert found.files == {"volume": tmp_path / "sub-1_hemi-R_label-WM_probseg.nii.gz"}
    (tmp_path / "sub-1_run-2_hemi-R_label-WM_probseg.nii.gz").write_bytes(b"")
    refused("has 2 files for volume of hemisphere R", found_in, tmp_path, "rh", Parameters(volume=True))


def test_the_table_has_everybody_and_every_figure(root, compared):
    assert compared.exit_code == 3, compared.output
    assert all(re.search(f"sub-{label} L: error: .*{why}", compared.stderr) for label, why in BROKEN.items())
    with (root / "out" / "group_desc-voxflat_measures.tsv").open() as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    assert [row["participant_id"] for row in rows] == [f"sub-{n:02}" for n in range(1, 21)]
    for row in rows:
        label = row["participant_id"].removeprefix("sub-")
        if label in BROKEN:
            assert (row["status"], row["raw.relative_error"]) == ("missing", "n/a")
            assert re.search(BROKEN[label], row["reason"])
            continue
        path = root / "out" / f"sub-{label}" / "anat" / f"sub-{label}_hemi-L_flat.json"
        figures = json.loads(path.read_text())["figures"]
        for of in ("raw", "best_scale", "interior", "triangles"):
            for name, value in figures[of].items():
                cell = row[f"{of}.{name}"]
                assert cell == "n/a" if value is None else float(cell) == pytest.approx(value, rel=1e-5)
        assert (row["reason"], row["cuts"]) == ("n/a", "standard")
    described = json.loads((root / "out" / "group_desc-voxflat_measures.json").read_text())
    assert list(described) == list(rows[0])
    assert all(of["Description"] for of in described.values())
    lengths = {"width", "height", "mean_geodesic", "voxel_size"}
    lengths |= {f"{scale}.absolute_error" for scale in ("raw", "best_scale", "interior")}
    assert {name for name, of in described.items() if of.get("Units") == "mm"} == lengths
    assert set(json.loads(compared.stdout)["missing"]) == {f"sub-{label} L" for label in BROKEN}


def test_a_vertex_at_a_cut_is_counted_once(root, compared):
    table = list(csv.DictReader((root / "out" / "group_desc-voxflat_measures.tsv").open(), delimiter="\t"))
    counts = {f"{row['participant_id']}_hemi-{row['hemi']}": row["points"] for row in table}
    saved = list((root / "out").rglob("*_flat.npz"))
    assert len(saved) > 1
    for path in saved:
        ids = voxflat.load(path).ids
        assert int(counts[path.name.removesuffix("_flat.npz")]) == len(set(ids.tolist())) < len(ids)


def test_means_are_those_of_the_maps_pixel_by_pixel(root, compared):
    out = root / "out"
    mean, spread = (nib.load(out / f"group_hemi-L_stat-{of}_desc-voxflat_thickness.nii.gz") for of in ("mean", "std"))
    stack = []
    for path in sorted(out.rglob("*_flat.npz")):
        flat = voxflat.load(path)
        values = nib.load(str(path).replace("_flat.npz", "_desc-voxflat_thickness.shape.gii")).agg_data()[flat.ids]
        stack.append(LinearTriInterpolator(Triangulation(*flat.uv.T, flat.faces.astype(int)), values))
    rows, columns = np.meshgrid(*(np.arange(0, size, 7) for size in mean.shape[:2]), indexing="ij")
    places = np.stack([rows, columns, 0 * rows, 1 + 0 * rows], axis=-1) @ mean.affine.T
    values = np.ma.filled(np.ma.stack([one(places[..., 0], places[..., 1]) for one in stack]), np.nan)
    count = np.isfinite(values).sum(axis=0)
    assert len(stack) == 17
    found, scattered = (np.asarray(of.dataobj)[..., 0][rows, columns] for of in (mean, spread))
    is_inner = count == 17
    assert is_inner.sum() > 500
    assert_allclose(found[is_inner], values[:, is_inner].mean(axis=0), rtol=1e-4)
    assert_allclose(scattered[is_inner], values[:, is_inner].std(axis=0, ddof=1), rtol=1e-3)
    assert np.isnan(found[count < 8]).all()
    counted = nib.load(out / "group_hemi-L_stat-count_desc-voxflat_thickness.nii.gz")
    assert np.mean(np.asarray(counted.dataobj)[..., 0][rows, columns] == count) > 0.999  # apart from borders


def test_a_broken_map_stands_out_in_table_and_page(root, compared, tmp_path):
    shutil.copytree(root / "out", tmp_path / "out")
    path = tmp_path / "out" / "sub-02" / "anat" / "sub-02_hemi-L_flat.json"
    record = json.loads(path.read_text())
    record["figures"]["triangles"]["flipped"] = 4
    record["figures"]["best_scale"]["relative_error"] = 0.31
    record["figures"]["triangles"]["edge"] = 0.01
    record["inputs"]["white"]["sha256"] = "0" * 64
    del record["sha256"]
    path.write_text(json.dumps(sealed(record)))
    told = json.loads(run("bids", root / "bids", tmp_path / "out", "group", "--json").stdout)
    assert told["outliers"]["sub-02 L"]["best_scale.relative_error"] == "high"
    assert {"triangles.flipped", "best_scale.relative_error"} <= set(told["outliers"]["sub-02 L"])
    words = run("bids", root / "bids", tmp_path / "out", "group").stdout
    marked = [of.keys() - {"triangles.flipped"} for of in told["outliers"].values()]
    values, hemispheres = sum(map(len, marked)), sum(map(bool, marked))
    assert re.search(rf"^outliers: {values} values? of {hemispheres} hemispheres? \(about 0\.\d+ exp", words, re.M)
    assert "\nerrors: 1 map has flipped or covering triangles" in words
    assert f"\nreport: {tmp_path / 'out' / 'group.html'}\n" in words
    page = (tmp_path / "out" / "group.html").read_text()
    assert f"{values} values are outliers" in page
    assert '<td class="n bad">31.0<span class="quiet"> ±' in page
    assert re.search(
        r'<td class="n bad">31\.0<span class="quiet"> ± [\d.]+</span> <span title="high">↑</span></td>', page
    )
    assert (
        '<td class="n bad">1.0 <span title="low">↓</span></td>' in page
    )  # an error of triangles has no standard error
    assert '<td class="n bad">4</td>' in page
    assert _ranked(page)[0] == "sub-02"


def _ranked(page):
    """Return the participants in the table of a page, from top to bottom."""
    return re.findall(r"<td>(?:<a [^>]*>)?(sub-\d\d)", page)


def test_the_table_of_the_page_begins_with_the_largest_distance_error(root, compared):
    page = (root / "out" / "group.html").read_text()
    records = {path.name[:6]: json.loads(path.read_text()) for path in (root / "out").rglob("*_flat.json")}
    error = {name: record["figures"]["best_scale"]["relative_error"] for name, record in records.items()}
    ranked = _ranked(page)
    assert ranked[:17] == sorted(error, key=error.get, reverse=True)
    assert ranked[17:] == [f"sub-{label}" for label in BROKEN]  # without a map
    spread = records[ranked[0]]["figures"]["standard_error"]["best_scale"]["relative_error"]
    first = f'<td class="n">{100 * error[ranked[0]]:.1f}<span class="quiet"> ± {100 * spread:.1f}</span></td>'
    assert first in page.replace("n bad", "n")
    assert "at the scale of each map that minimises the distance error" in page


def read(path):
    """Return the values in a file of results, whose provenance has paths."""
    return voxflat.load(path).uv.tolist() if path.suffix == ".npz" else nib.load(path).darrays[0].data.tobytes()


def _overwritten(path):
    """Overwrite four bytes in the middle of a file."""
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        four = file.read(4)
        file.seek(-4, 1)
        file.write(bytes(255 - of for of in four))


def test_damaged_outputs_are_made_again_and_stop_nobody(root, compared, tmp_path):
    shutil.copytree(root / "out", tmp_path / "out")
    shutil.copytree(root / "bids", tmp_path / "bids")
    files = {label: tmp_path / "out" / f"sub-{label}" / "anat" / f"sub-{label}_hemi-L" for label in ("01", "02", "03")}
    names = ("flat.npz", "flat.json", "desc-voxflat_curvature.shape.gii")
    damaged = [Path(f"{files[label]}_{of}") for label, of in zip(files, names, strict=True)]
    for path in damaged:
        _overwritten(path)
    (tmp_path / "out" / "sub-04.html").unlink()
    _overwritten(tmp_path / "out" / "sub-06.html")
    before = everything(tmp_path / "out")
    group = run("bids", tmp_path / "bids", tmp_path / "out", "group", "--json")
    assert group.exit_code == 6
    assert json.loads(group.stdout)["maps"] == 14
    for label, path in zip(files, damaged, strict=True):
        assert re.search(rf"voxflat: sub-{label} L: error: {path.name} .*Run voxflat bids again", group.stderr)
    plan = [json.loads(line) for line in participant(tmp_path, "--dry-run").stdout.splitlines()]
    assert [one["participant"] for one in plan if one["state"] == "stale"] == [f"sub-{n:02}" for n in (1, 2, 3, 4, 6)]
    assert "3 made, 14 up to date, 3 failed" in participant(tmp_path).stdout
    now, whole = everything(tmp_path / "out"), everything(root / "out")
    assert {name for name in now if name not in before or now[name][0] != before[name][0]} >= {
        "sub-04.html",
        "sub-06.html",
    }
    for name in ("sub-04.html", "sub-06.html"):
        assert now[name][0] == whole[name][0]
    for path in (damaged[0], damaged[2]):
        assert read(path) == read(root / path.relative_to(tmp_path))
    again = json.loads(run("bids", tmp_path / "bids", tmp_path / "out", "group", "--json").stdout)
    assert (again["maps"], len(again["missing"])) == (17, 3)


def test_two_runs_at_once_make_each_map_once(root, tmp_path):
    words = [sys.executable, "-m", "voxflat.cli", "bids", root / "bids", tmp_path, "participant"]
    words += ["--hemi", "L", "--participant-label", "01", "02"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    runs = [subprocess.Popen([*map(str, words)], **pipes) for _ in range(3)]
    told = [one.communicate() for one in runs]
    assert [one.returncode for one in runs] == [0, 0, 0], told
    for name in ("sub-01", "sub-02"):
        outcomes = [line for out, _ in told for line in out.splitlines() if line.startswith(f"{name} L: ")]
        assert outcomes.count(f"{name} L: up to date") == len(outcomes) - 1 == 2
    waiting = "voxflat: another voxflat process is making the maps of sub-01. Waiting for it\n"
    assert sum(waiting in error for _, error in told) >= 1
    assert not list(tmp_path.rglob("*.lock"))


def test_ctrl_c_tells_how_to_continue(root, tmp_path, monkeypatch):
    monkeypatch.setattr("voxflat.lab.study.make", Mock(side_effect=KeyboardInterrupt))
    stopped = run("bids", root / "bids", tmp_path / "out", "participant", "--hemi", "L")
    told = "voxflat: finished maps are kept. Repeat the command to make the others\nvoxflat: cancelled\n"
    assert (stopped.exit_code, told in stopped.stderr) == (130, True)


def test_a_page_that_cannot_be_written_stops_nobody(root, tmp_path):
    shutil.copytree(root / "out", tmp_path / "out")
    shutil.copytree(root / "bids", tmp_path / "bids")
    page = tmp_path / "out" / "sub-01.html"
    page.unlink()
    page.mkdir()
    (tmp_path / "out" / "sub-02.html").unlink()
    told = participant(tmp_path)
    assert "16 up to date, 4 failed" in told.stdout
    assert "voxflat: sub-01 L: error: " in told.stderr
    assert (tmp_path / "out" / "sub-02.html").is_file()
    page.rmdir()
    assert "17 up to date, 3 failed" in participant(tmp_path).stdout
    assert page.is_file()


@pytest.mark.parametrize("ending", ["html", "tsv", "json", "nii.gz"])
def test_a_damaged_or_missing_file_of_the_group_is_made_again(root, compared, tmp_path, ending):
    shutil.copytree(root / "out", tmp_path / "out")
    path = sorted((tmp_path / "out").glob(f"group*.{ending}"))[0]
    whole = path.read_bytes()
    for damage in (_overwritten, Path.unlink):
        damage(path)
        assert "written: " in run("bids", root / "bids", tmp_path / "out", "group").stdout
        assert path.read_bytes() == whole


def test_a_study_that_is_up_to_date_is_left_alone(root, compared):
    before = everything(root / "out")
    again = run("bids", root / "bids", root / "out", "group")
    assert (again.exit_code, again.stdout.splitlines()[-1]) == (3, "up to date")
    assert everything(root / "out") == before


def test_a_group_counts_its_maps_by_side_and_those_without(root, compared, tmp_path):
    counts = "17 left and no right hemispheres of 17 participants; without a map: 3 hemispheres"
    assert json.loads(compared.stdout)["counted"] == counts
    assert f"Maps: {counts}." in (root / "out" / "group.html").read_text()
    assert f"maps: {counts}\n" in run("bids", root / "bids", root / "out", "group").stdout
    shutil.copytree(root / "out", tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "sub-05")
    rest = run("bids", root / "bids", tmp_path / "out", "group", "--participant-label", "05", "06", "08").stdout
    one = "maps: 1 left and no right hemispheres of 1 participant"
    assert rest.startswith(f"{one}; without a map: 1 hemisphere and 1 participant\n")


def test_a_group_of_one_leaves_no_means_of_an_earlier_group(root, compared, tmp_path):
    shutil.copytree(root / "out", tmp_path / "out")
    assert list((tmp_path / "out").glob("group_hemi-L_stat-*.nii.gz"))
    words = ["bids", root / "bids", tmp_path / "out", "group", "--participant-label", "01"]
    assert "outliers: not determined; they require 5 maps of one side" in succeed(*words).stdout
    assert not list((tmp_path / "out").glob("group_hemi-*.nii.gz"))


def test_a_group_uses_or_refuses_its_options(root, compared, tmp_path):
    words = ["bids", root / "bids", root / "out", "group"]
    used = {"labels", "hemis", "space", "as_json", "quiet", "debug"}
    options = [one for one in bids_command.params if one.name not in used and isinstance(one, click.Option)]
    assert len(options) == 11
    before = everything(root / "out")
    for one in options:  # also those that will be added
        value = [] if one.is_flag else [one.type.choices[0] if isinstance(one.type, click.Choice) else "3"]
        fail(2, f"{one.opts[0]} requires the level participant", *words, one.opts[0], *value)
    assert everything(root / "out") == before
    shutil.copytree(root / "out", tmp_path / "out")
    told = "no participant has a map of the right hemisphere"
    fail(1, told, "bids", root / "bids", tmp_path / "out", "group", "--hemi", "rh")


@pytest.mark.parametrize(
    ("key", "value", "told", "averaged"),
    [
        ("geometry", "white", "--geometry is white for sub-02 L; midthickness for the other 16 hemispheres", []),
        ("cuts", "/d/own.json", "--cuts is /d/own.json for sub-02 L; standard for the other 16 hemispheres", []),
        ("overlays", ["b/thickness.mgh"], "The overlay thickness is b/thickness.mgh for sub-02 L", ["curvature"]),
        ("overlays", ["thickness"], "", ["curvature", "thickness"]),  # as by default
    ],
)
def test_maps_that_were_made_in_different_ways_are_not_averaged(root, compared, tmp_path, key, value, told, averaged):
    shutil.copytree(root / "out", tmp_path / "out")
    path = tmp_path / "out" / "sub-02" / "anat" / "sub-02_hemi-L_flat.json"
    record = json.loads(path.read_text())
    del record["sha256"]
    record["parameters"][key] = value
    path.write_text(json.dumps(sealed(record)))
    shutil.copytree(root / "bids", tmp_path / "bids")
    anat = tmp_path / "bids" / "derivatives" / "smriprep" / "sub-02" / "anat"
    (anat / "b").mkdir()
    shutil.copy(anat / "sub-02_hemi-L_thickness.shape.gii", anat / "b" / "thickness.mgh")
    for _ in range(2):  # also if everything is up to date
        group = run("bids", tmp_path / "bids", tmp_path / "out", "group", "--json")
        assert "".join(json.loads(group.stdout)["warnings"]).count(told or "not averaged") == (told != "")
        assert group.stderr.count("voxflat: warning: the maps of this group differ") == (told != "")
        assert ("they are not averaged, and may be outliers" in group.stderr) == (key != "overlays")
        assert told in group.stderr
    names = {path.name for path in (tmp_path / "out").glob("group_hemi-L_stat-mean_*.nii.gz")}
    assert names == {f"group_hemi-L_stat-mean_desc-voxflat_{one}.nii.gz" for one in averaged}
    with (tmp_path / "out" / "group_desc-voxflat_measures.tsv").open() as file:
        assert sum(row["status"] == "done" for row in csv.DictReader(file, delimiter="\t")) == 17
    assert told in (tmp_path / "out" / "group.html").read_text()


def test_the_page_of_the_study(root, compared):
    page = (root / "out" / "group.html").read_text()
    assert len(page) < 5e6
    assert page.count("no map.</strong>") == 3
    assert voxflat.cite(*map(voxflat.load, sorted((root / "out").rglob("*_flat.npz")))).text in page
    links = set(re.findall(r"""href=["']([^"'#d][^"']*)["']""", page))
    assert links == {f"sub-{n:02}.html" for n in range(1, 21) if f"{n:02}" not in BROKEN}
    assert all((root / "out" / link).is_file() for link in links)
    assert len(re.findall(r"<figure style=", page)) == 17
    sizes = re.findall(r"width: (\d+)px\">\s*<a[^>]*><img[^>]* width=\"(\d+)\"", page)
    scales = {round(int(shown) / int(width), 2) for shown, width in sizes}
    assert len(sizes) == 17
    assert max(scales) - min(scales) <= 0.01  # one scale


def test_nobody_has_a_map(root, tmp_path):
    words = ["bids", root / "bids", tmp_path / "out", "group"]
    fail(1, "no participant has a map. Run voxflat bids", *words)
    assert run(*words, "--dry-run").exit_code == 2


@pytest.fixture(scope="module")
def doubtful(tmp_path_factory):
    """Return the directory of four FreeSurfer subjects, two of them with a doubtful hemisphere, and the result."""
    root = tmp_path_factory.mktemp("doubtful")
    for n in range(1, 5):
        for hemi in ("lh", "rh"):
            studies.write_freesurfer(root / "bids" / f"sub-{n}", hemi, studies.warped(studies.hemisphere(hemi, FEW), n))
    (root / "bids" / "sub-2" / "label" / "lh.cortex.label").unlink()
    shutil.copy(root / "bids" / "sub-3" / "surf" / "rh.white", root / "bids" / "sub-3" / "surf" / "rh.pial")
    return root, run("bids", root / "bids", root / "out", "participant")


_FILES = "?h.cortex.label, *_desc-cortex_mask.label.gii or *.atlasroi.32k_fs_LR.shape.gii"
NO_LABEL = f"found no cortex label ({_FILES}), so the cortex is defined by the"
WARNINGS = {"sub-2 L": NO_LABEL, "sub-3 R": "the pial surface equals the given surface: distances are measured on it"}


def grouped(folder, *more):
    """Return what the level group prints as JSON and on stderr."""
    result = run("bids", folder / "bids", folder / "out", "group", "--json", *more)
    return json.loads(result.stdout), result.stderr


def averaged(folder):
    """Return the sides and the names of all means."""
    names = (path.name for path in (folder / "out").glob("group_hemi-*_stat-mean_*"))
    return {tuple(re.fullmatch(r"group_hemi-(.)_stat-mean_desc-voxflat_(\w+)\.nii\.gz", of).groups()) for of in names}


def copied(doubtful, folder):
    """Copy a study without its doubtful participants, and return the directory."""
    for name in ("bids", "out"):
        shutil.copytree(doubtful[0] / name, folder / name, ignore=shutil.ignore_patterns("sub-2*", "sub-3*"))
    return folder


BOTH = {(letter, name) for letter in "LR" for name in ("curvature", "thickness")}


def test_warnings_are_printed_with_the_hemisphere_and_notes_are_not(doubtful):
    root, result = doubtful
    assert result.exit_code == 0
    again = run("bids", root / "bids", root / "out", "participant")
    assert "4 participants: 0 made, 4 up to date" in again.stdout
    for line, (who, told) in zip(result.stderr.splitlines(), WARNINGS.items(), strict=True):
        assert line.startswith(f"voxflat: warning: {who}: {told}")
        assert f"{who}: up to date (1 warning in its report)" in again.stdout
    assert again.stderr == ""  # it was told when the maps were made
    assert again.stdout.count("up to date (") == 2
    assert run("bids", root / "bids", root / "out", "participant", "--quiet").stderr == ""
    for path in (root / "out").rglob("*_flat.json"):
        record = json.loads(path.read_text())
        who = f"{path.name[:5]} {path.name[11]}"
        assert [told for told in record["warnings"] if who not in WARNINGS or WARNINGS[who] not in told] == []
        assert "cut along standard cuts" in record["notes"][0]
    single = run("freesurfer", root / "bids" / "sub-2")
    assert [line for line in single.stderr.splitlines() if "warning" in line] == result.stderr.splitlines()[:1]
    assert "voxflat: sub-2 R: cut along standard cuts" in single.stderr


def test_a_map_whose_pial_surface_is_the_white_one_is_described_as_measured_on_it(doubtful):
    root, _ = doubtful
    page = (root / "out" / "sub-3.html").read_text()
    assert len(re.findall("Distances were measured on the given mesh", page)) == 1
    assert len(re.findall("Distances were measured on the midthickness surface", page)) == 1
    shown = re.findall(r"Distances measured on</th><td[^>]*>([^<]*)<", page)
    assert shown == ["midthickness: halfway to the pial surface", "the given surface"]


def test_a_failure_does_not_hide_the_warnings_before_it(doubtful, tmp_path):
    shutil.copytree(doubtful[0] / "bids" / "sub-3", tmp_path / "sub-3")
    values = nib.freesurfer.read_morph_data(tmp_path / "sub-3" / "surf" / "rh.curv")
    nib.freesurfer.write_morph_data(tmp_path / "sub-3" / "surf" / "rh.nothing", np.full_like(values, np.nan))
    failed = fail(
        1, "nothing has no values on the map", "freesurfer", tmp_path / "sub-3", "--hemi", "R", "--overlay", "nothing"
    )
    assert f"voxflat: warning: {WARNINGS['sub-3 R']}" in failed.stderr


def test_a_hemisphere_or_an_overlay_that_only_some_participants_have_is_reported(doubtful, tmp_path):
    folder = copied(doubtful, tmp_path)
    (folder / "bids" / "sub-4" / "surf" / "lh.thickness").unlink()
    assert run("bids", folder / "bids", folder / "out", "participant").exit_code == 0
    for path in (folder / "out" / "sub-4" / "anat").glob("*_hemi-R_*"):
        path.unlink()
    told, printed = grouped(folder)
    assert told["warnings"] == ["sub-4 L: the overlay thickness, which other maps have, is missing"]
    assert "voxflat: sub-4 R: error: not flattened yet. Run voxflat bids at the level participant\n" in printed
    assert told["missing"].keys() == {"sub-4 R"}
    assert grouped(folder, "--participant-label", "4")[0]["missing"] == {}  # nobody has a right map


def test_a_group_repeats_the_warnings_on_the_terminal_in_the_table_and_on_the_page(doubtful):
    root, _ = doubtful
    told, printed = grouped(root)
    table = list(csv.DictReader((root / "out" / "group_desc-voxflat_measures.tsv").open(), delimiter="\t"))
    of_row = {f"{row['participant_id']} {row['hemi']}": row["warnings"] for row in table if row["warnings"] != "n/a"}
    assert of_row.keys() == WARNINGS.keys()
    for who, text in WARNINGS.items():
        assert of_row[who].startswith(text)
        assert f"\nvoxflat: warning: {who}: {text}" in printed
        assert any(one.startswith(f"{who}: {text}") for one in told["warnings"])
        assert f"{who}: {text}" in (root / "out" / "group.html").read_text()


def test_maps_with_another_definition_of_the_cortex_or_measured_on_another_surface_are_not_averaged(doubtful):
    root, _ = doubtful
    differ = grouped(root)[0]["warnings"][0]
    assert "so they are not averaged, and may be outliers. The definition of the cortex is the medial wall of" in differ
    assert "the template for sub-2 L; the cortex label for the other 7 hemispheres. The surface of the dist" in differ
    assert "ances is the given surface for sub-3 R; midthickness: halfway to the pial surface for the other 7" in differ
    assert averaged(root) == set()
    table = list(csv.DictReader((root / "out" / "group_desc-voxflat_measures.tsv").open(), delimiter="\t"))
    assert {row["cortex"] for row in table if row["participant_id"] != "sub-2"} == {"the cortex label"}


def test_a_difference_on_one_side_leaves_the_means_of_the_other(doubtful, tmp_path):
    root, _ = doubtful
    for name in ("bids", "out"):
        shutil.copytree(root / name, tmp_path / name, ignore=shutil.ignore_patterns("sub-3*"))
    differ = grouped(tmp_path)[0]["warnings"][0]
    assert "so the left maps are not averaged, and may be outliers. The definition" in differ
    assert averaged(tmp_path) == {("R", "curvature"), ("R", "thickness")}


def test_maps_of_changed_inputs_are_named_and_not_averaged(doubtful, tmp_path):
    folder = copied(doubtful, tmp_path)
    surf = folder / "bids" / "sub-4" / "surf"
    assert grouped(folder)[0]["warnings"] == []
    assert averaged(folder) == BOTH
    thickness = nib.freesurfer.read_morph_data(surf / "lh.thickness")
    nib.freesurfer.write_morph_data(surf / "lh.thickness", thickness + 1)
    content, printed = grouped(folder)
    (told,) = content["warnings"]
    assert told.startswith(
        "inputs changed after these maps were made, so thickness of the left maps is not averaged: "
        f"sub-4 L (overlay thickness). Run voxflat bids {folder / 'bids'} {folder / 'out'} participant with the same"
    )
    assert f"voxflat: warning: {told}" in printed
    assert "sub-4 L (overlay thickness)" in (folder / "out" / "group.html").read_text()
    assert averaged(folder) == BOTH - {("L", "thickness")}
    points, faces = nib.freesurfer.read_geometry(surf / "rh.white")
    nib.freesurfer.write_geometry(surf / "rh.white", points + 0.01, faces)
    (surf / "lh.pial").unlink()
    (told,) = grouped(folder)[0]["warnings"]
    assert re.search(
        r"so they are not averaged: sub-4 L \(\S+lh\.pial: the file does not .*, sub-4 R \(white\)\.", told
    )
    assert averaged(folder) == set()


def test_participants_with_the_files_of_another_one_are_named(doubtful, tmp_path):
    folder = copied(doubtful, tmp_path)
    shutil.copytree(folder / "bids" / "sub-1", folder / "bids" / "sub-9")
    shutil.rmtree(folder / "out" / "sub-4")
    assert run("bids", folder / "bids", folder / "out", "participant", "--participant-label", "9").exit_code == 0
    told, printed = grouped(folder)
    assert told["warnings"] == [
        "sub-1, sub-9 have identical input files, so the same data are counted 2 times. Correct the files, or remove "
        "the copies"
    ]
    assert f"voxflat: warning: {told['warnings'][0]}" in printed
    assert told["warnings"][0][1:] in (folder / "out" / "group.html").read_text()


def test_a_single_subject_is_not_a_study(tmp_path):
    subject = tmp_path / "freesurfer" / "sub-01"
    (subject / "surf").mkdir(parents=True)
    told = f"{subject} is a single subject, not a study. Pass its parent directory, {subject.parent}, or use voxflat"
    fail(1, f"{told} freesurfer {subject}", "bids", subject, tmp_path / "out", "participant")
    assert not (tmp_path / "out").exists()


def test_maps_of_participants_who_left_the_study_are_reported(doubtful, tmp_path):
    folder = copied(doubtful, tmp_path)
    grouped(folder)
    shutil.rmtree(folder / "bids" / "sub-4")
    for _ in range(2):  # also if everything is up to date
        told, printed = grouped(folder)
        assert told["warnings"][0].startswith(f"the maps of sub-4 are omitted, because {folder / 'bids'} does not")
        assert f"voxflat: warning: {told['warnings'][0]}" in printed
    assert "The maps of sub-4 are omitted" in (folder / "out" / "group.html").read_text()
    assert grouped(folder, "--participant-label", "1")[0]["warnings"] == []


def test_images_that_a_group_deletes_are_named(doubtful, tmp_path):
    folder = copied(doubtful, tmp_path)
    assert grouped(folder)[0]["deleted"] == []
    told, printed = grouped(folder, "--hemi", "L")
    kinds = [(of, name) for of in ("count", "mean", "std") for name in ("curvature", "thickness")]
    assert told["deleted"] == [f"group_hemi-R_stat-{of}_desc-voxflat_{name}.nii.gz" for of, name in kinds]
    begin = "voxflat: images of an earlier group that this one does not have will be deleted"
    assert f"{begin}: {told['deleted'][0]}, " in printed


def test_images_that_a_group_deletes_are_named_before(doubtful, tmp_path, monkeypatch):
    folder = copied(doubtful, tmp_path)
    grouped(folder)

    delete = Path.unlink

    def unlink(path, **how):
        if path.name.startswith("group_hemi-R"):
            raise OSError("cannot delete it")
        delete(path, **how)

    monkeypatch.setattr(Path, "unlink", unlink)
    result = run("bids", folder / "bids", folder / "out", "group", "--hemi", "L")
    assert result.exit_code == 1
    assert "will be deleted: group_hemi-R_stat-count_desc-voxflat_curvature.nii.gz, " in result.stderr
