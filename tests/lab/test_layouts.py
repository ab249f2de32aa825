"""The layouts of sMRIPrep, fMRIPrep and the HCP pipelines: names as these programs write them, and studies of each."""

import json
import re
import shutil
import signal
import subprocess
import sys
from xml.etree import ElementTree

import nibabel as nib
import numpy as np
import pytest
import studies
from command_line import fail, succeed
from lab_runs import FEW, VERTICES, everything
from mesh_files import needs_workbench, workbench
from nilearn.surface import load_surf_data, load_surf_mesh
from numpy.testing import assert_allclose
from PIL import Image
from refusals import refused

import voxflat
from voxflat.lab.inputs import Parameters, found_in, overlay_name, participants
from voxflat.lab.layouts import LAYOUTS, layout_in
from voxflat.lab.subject import registered_sphere

_FMRIPREP = """
anat/sub-01_desc-ribbon_mask.nii.gz
anat/sub-01_hemi-L_curv.shape.gii
anat/sub-01_hemi-L_desc-cortex_mask.label.gii
anat/sub-01_hemi-L_inflated.surf.gii
anat/sub-01_hemi-L_midthickness.surf.gii
anat/sub-01_hemi-L_pial.surf.gii
anat/sub-01_hemi-L_space-fsLR_den-32k_midthickness.surf.gii
anat/sub-01_hemi-L_space-fsLR_den-32k_pial.surf.gii
anat/sub-01_hemi-L_space-fsLR_den-32k_white.surf.gii
anat/sub-01_hemi-L_space-fsLR_desc-msmsulc_sphere.surf.gii
anat/sub-01_hemi-L_space-fsLR_desc-reg_sphere.surf.gii
anat/sub-01_hemi-L_space-fsaverage_desc-reg_sphere.surf.gii
anat/sub-01_hemi-L_sphere.surf.gii
anat/sub-01_hemi-L_sulc.shape.gii
anat/sub-01_hemi-L_thickness.shape.gii
anat/sub-01_hemi-L_white.surf.gii
anat/sub-01_label-WM_probseg.nii.gz
anat/sub-01_space-fsLR_den-91k_thickness.dscalar.nii
func/sub-01_task-mixedgamblestask_run-02_hemi-L_space-fsaverage5_bold.func.gii
func/sub-01_task-mixedgamblestask_run-02_hemi-L_space-fsnative_bold.func.gii
func/sub-01_task-mixedgamblestask_run-02_space-fsLR_den-91k_bold.dtseries.nii
"""
FMRIPREP = _FMRIPREP.split()
"""Names of the left hemisphere in the list of outputs by which fMRIPrep tests its derivatives of ds005."""

_HCP = """
MNINonLinear/Native/100307.L.roi.native.shape.gii
MNINonLinear/Native/100307.L.sphere.MSMSulc.native.surf.gii
MNINonLinear/Native/100307.L.sphere.native.surf.gii
MNINonLinear/Native/100307.L.sphere.reg.reg_LR.native.surf.gii
MNINonLinear/Native/100307.L.thickness.native.shape.gii
MNINonLinear/Native/100307.L.white.native.surf.gii
MNINonLinear/Results/rfMRI_REST1_LR/rfMRI_REST1_LR_Atlas.dtseries.nii
MNINonLinear/fsaverage_LR32k/100307.L.atlasroi.32k_fs_LR.shape.gii
MNINonLinear/fsaverage_LR32k/100307.L.flat.32k_fs_LR.surf.gii
MNINonLinear/fsaverage_LR32k/100307.L.pial.32k_fs_LR.surf.gii
MNINonLinear/fsaverage_LR32k/100307.L.sphere.32k_fs_LR.surf.gii
MNINonLinear/fsaverage_LR32k/100307.L.thickness.32k_fs_LR.shape.gii
MNINonLinear/fsaverage_LR32k/100307.L.white.32k_fs_LR.surf.gii
MNINonLinear/fsaverage_LR32k/100307.L.white_MSMAll.32k_fs_LR.surf.gii
MNINonLinear/fsaverage_LR32k/100307.MyelinMap_BC.32k_fs_LR.dscalar.nii
MNINonLinear/ribbon.nii.gz
T1w/Native/100307.L.pial.native.surf.gii
T1w/Native/100307.L.white.native.surf.gii
T1w/fsaverage_LR32k/100307.L.pial.32k_fs_LR.surf.gii
T1w/fsaverage_LR32k/100307.L.white.32k_fs_LR.surf.gii
T1w/ribbon.nii.gz
"""
HCP = _HCP.split()
"""Names of the left hemisphere that PostFreeSurfer of the HCP pipelines writes."""


def tree(folder, names):
    """Make empty files."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def files_of(folder, space, parameters=Parameters()):  # noqa: B008
    """Return the files of the left hemisphere, relative to a directory."""
    found = found_in(folder, "lh", parameters, layout_in(folder, space))
    paths = {**found.files, **{f"overlay {name}": path for name, path in found.overlays.items()}}
    return {name: path.relative_to(folder).as_posix() for name, path in paths.items()}


def test_the_native_surfaces_of_fmriprep_are_found_beside_resampled_ones(tmp_path):
    anat = tree(tmp_path / "sub-01", FMRIPREP) / "anat"
    start = "sub-01_hemi-L"
    wanted = {
        "white": f"{start}_white.surf.gii",
        "pial": f"{start}_pial.surf.gii",
        "sphere": f"{start}_space-fsaverage_desc-reg_sphere.surf.gii",
        "cortex": f"{start}_desc-cortex_mask.label.gii",
        "overlay thickness": f"{start}_thickness.shape.gii",
    }
    for space in (None, "native"):
        assert files_of(anat, space) == wanted
    parameters = Parameters(overlays=("bold", "ribbon", "sulc"))
    overlays = {name: path for name, path in files_of(anat, None, parameters).items() if "overlay" in name}
    assert overlays == {
        "overlay bold": "../func/sub-01_task-mixedgamblestask_run-02_hemi-L_space-fsnative_bold.func.gii",
        "overlay ribbon": "sub-01_desc-ribbon_mask.nii.gz",
        "overlay sulc": f"{start}_sulc.shape.gii",
    }


def test_the_surfaces_of_fmriprep_on_the_mesh_of_fs_lr_are_found(tmp_path):
    anat = tree(tmp_path / "sub-01", FMRIPREP) / "anat"
    start, mesh = "sub-01_hemi-L", "space-fsLR_den-32k"
    thickness = "sub-01_space-fsLR_den-91k_thickness.dscalar.nii"
    given = "{subject}_task-mixedgamblestask_run-02_space-fsLR_den-91k_bold.dtseries.nii"
    wanted = {
        "white": f"{start}_{mesh}_white.surf.gii",
        "pial": f"{start}_{mesh}_pial.surf.gii",
        "native sphere": f"{start}_space-fsLR_desc-msmsulc_sphere.surf.gii",
        "native white": f"{start}_white.surf.gii",
        "grayordinates": thickness,
        "overlay thickness": thickness,
    }
    assert files_of(anat, "fsLR") == wanted
    series = f"../func/{given.replace('{subject}', 'sub-01')}"
    for text in ("bold", given):
        assert files_of(anat, "fsLR", Parameters(overlays=(text,)))["overlay bold"] == series
    for name in ("white", "pial"):  # fMRIPrep wrote only the midthickness surface until 2023
        (anat / f"{start}_{mesh}_{name}.surf.gii").unlink()
    older = {
        "midthickness": f"{start}_{mesh}_midthickness.surf.gii",
        "native midthickness": f"{start}_midthickness.surf.gii",
    }
    assert files_of(anat, "fsLR") == {
        **older,
        **{name: path for name, path in wanted.items() if not name.endswith(("white", "pial"))},
    }


def test_surfaces_with_desc_preproc_are_found(tmp_path):
    names = [
        re.sub(r"(32k|hemi-L)_(white|pial|midthickness|inflated)\.", r"\1_desc-preproc_\2.", name) for name in FMRIPREP
    ]
    anat = tree(tmp_path / "sub-01", names) / "anat"
    assert files_of(anat, None)["white"] == "sub-01_hemi-L_desc-preproc_white.surf.gii"
    assert files_of(anat, "fsLR")["pial"] == "sub-01_hemi-L_space-fsLR_den-32k_desc-preproc_pial.surf.gii"


@pytest.mark.parametrize("entities", ["_ses-b", "_acq-MPRAGE", "_ses-b_acq-MPRAGE_rec-norm_run-1"])
def test_entities_of_the_anatomical_image_are_allowed(tmp_path, entities):
    names = [re.sub("sub-01(?=_hemi|_desc|_space)", f"sub-01{entities}", name) for name in FMRIPREP]
    anat = tree(tmp_path / "sub-01", names) / "anat"
    for space, mesh in (("native", ""), ("fsLR", "_space-fsLR_den-32k")):
        assert files_of(anat, space)["white"] == f"sub-01{entities}_hemi-L{mesh}_white.surf.gii"


@pytest.mark.parametrize(
    ("space", "lost", "wanted"),
    [
        (None, (), "T1w/Native/100307.L.white.native"),
        ("fsLR", (), "T1w/fsaverage_LR32k/100307.L.white.32k_fs_LR"),
        (None, ("T1w/Native",), "T1w/fsaverage_LR32k/100307.L.white.32k_fs_LR"),
        (None, ("T1w",), "MNINonLinear/fsaverage_LR32k/100307.L.white.32k_fs_LR"),
    ],
)
def test_the_preferred_surfaces_of_the_hcp_pipelines_are_found(tmp_path, space, lost, wanted):
    subject = tree(tmp_path / "100307", HCP)
    for name in lost:
        shutil.rmtree(subject / name)
    found = files_of(subject, space)
    mesh, at = ("native", "Native") if "Native" in wanted else ("32k_fs_LR", "fsaverage_LR32k")
    sphere = "sphere.MSMSulc" if mesh == "native" else "sphere"
    cortex = "roi" if mesh == "native" else "atlasroi"
    assert found == {
        "white": f"{wanted}.surf.gii",
        "pial": f"{wanted.replace('white', 'pial')}.surf.gii",
        "sphere": f"MNINonLinear/{at}/100307.L.{sphere}.{mesh}.surf.gii",
        "cortex": f"MNINonLinear/{at}/100307.L.{cortex}.{mesh}.shape.gii",
        "overlay thickness": f"MNINonLinear/{at}/100307.L.thickness.{mesh}.shape.gii",
    }
    (person,) = participants(tmp_path, space=space)
    assert (person.name, person.folder) == ("sub-100307", subject)
    assert person.layout is layout_in(subject, space)


def test_data_of_the_hcp_pipelines_are_found_by_name(tmp_path):
    subject = tree(tmp_path / "100307", HCP)
    series = "MNINonLinear/Results/rfMRI_REST1_LR/rfMRI_REST1_LR_Atlas.dtseries.nii"
    myelin = "MNINonLinear/fsaverage_LR32k/100307.MyelinMap_BC.32k_fs_LR.dscalar.nii"
    given = {
        "MyelinMap_BC": myelin,
        "{subject}.MyelinMap_BC.32k_fs_LR.dscalar.nii": myelin,
        "bold": series,
        "rfMRI_REST1_LR/rfMRI_REST1_LR_Atlas.dtseries.nii": series,
        "ribbon": "T1w/ribbon.nii.gz",
    }
    for text, path in given.items():
        found = files_of(subject, "fsLR", Parameters(overlays=(text,)))
        assert found[f"overlay {overlay_name(text)}"] == path
    for hemi, label in (("lh", 2), ("rh", 41)):
        found = found_in(subject, hemi, Parameters(volume=True))
        assert (found.files, found.label) == ({"volume": subject / "T1w" / "ribbon.nii.gz"}, label)


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("{subject}.{hemi}.sulc.native.shape.gii", "sulc"),
        ("{subject}.MyelinMap_BC.32k_fs_LR.dscalar.nii", "MyelinMapBC"),
        ("sub-01_task-rest_space-fsLR_den-91k_bold.dtseries.nii", "bold"),
        ("sub-01_space-fsLR_den-91k_thickness.dscalar.nii", "thickness"),
        ("lh.curv", "curv"),
    ],
)
def test_overlays_have_the_names_of_their_values(file, name):
    assert overlay_name(file) == name


def test_several_runs_are_named_and_one_can_be_passed(tmp_path):
    other = "func/sub-01_task-mixedgamblestask_run-03_space-fsLR_den-91k_bold.dtseries.nii"
    anat = tree(tmp_path / "sub-01", [*FMRIPREP, other]) / "anat"
    told = r"2 files for bold of hemisphere L \(.*run-02.*run-03.*pass one of them with --overlay"
    refused(told, files_of, anat, "fsLR", Parameters(overlays=("bold",)))


def test_a_space_that_nobody_has_is_refused(tmp_path):
    tree(tmp_path / "study" / "sub-01", [name for name in FMRIPREP if "fsLR" not in name])
    told = "no participant has surfaces in the space fsLR. Run fMRIPrep with --cifti-output, or omit --space"
    for level in ("participant", "group"):
        fail(1, told, "bids", tmp_path / "study", tmp_path / "out", level, "--space", "fsLR")
    assert not (tmp_path / "out").exists()


def test_a_single_subject_of_the_hcp_pipelines_is_not_a_study(tmp_path):
    subject = tree(tmp_path / "100307", HCP)
    refused(f"100307 is a single subject, not a study. Pass its parent directory, {tmp_path}$", participants, subject)


def test_all_layouts_have_a_different_place():
    assert len({str(layout) + layout.files["white"][0] for layout in LAYOUTS}) == len(LAYOUTS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a directory with two people in each layout, all flattened, and what the commands printed to stderr."""
    root = tmp_path_factory.mktemp("layouts")
    for hemi in ("lh", "rh"):
        for n in (1, 2):
            native, coarse = (studies.warped(studies.hemisphere(hemi, count), n) for count in (VERTICES, FEW))
            anat = root / "fmriprep" / f"sub-0{n}" / "anat"
            studies.write_derivatives(anat, f"sub-0{n}", hemi, native)
            sphere = f"sub-0{n}_hemi-{studies.SIDES[hemi][1]}_space-fsLR_desc-msmsulc_sphere.surf.gii"
            studies.write_surface(anat / sphere, hemi, native["sphere"], native["faces"])
            studies.write_32k(anat, f"sub-0{n}", hemi, coarse, series=3)
            studies.write_hcp(root / "hcp" / f"10000{n}", hemi, native, coarse)
    shutil.copytree(root / "hcp", root / "mni")
    for n in (1, 2):
        shutil.rmtree(root / "mni" / f"10000{n}" / "T1w")
    told = {}
    for name, words in RUNS.items():
        told[name] = succeed("bids", root / name.partition("_")[0], root / "out" / name, "participant", *words).stderr
    return root, told


RUNS = {
    "fmriprep_native": [],
    "fmriprep_fsLR": ["--space", "fsLR", "--overlay", "thickness", "bold"],
    "hcp_native": [],
    "hcp_fsLR": ["--space", "fsLR", "--overlay", "MyelinMap"],
    "mni_fsLR": [],
}


def maps_of(root, name):
    """Return the flat maps of a study by the beginning of their names."""
    paths = sorted((root / "out" / name).rglob("*_flat.npz"))
    assert len(paths) == 4
    return {path.name.removesuffix("_flat.npz"): path for path in paths}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_study_of_each_layout_has_maps_with_sidecars(made, name):
    root, _ = made
    mesh = "_space-fsLR_den-32k" if "fsLR" in name else ""
    people = ("01", "02") if "fmriprep" in name else ("100001", "100002")
    maps = maps_of(root, name)
    assert list(maps) == [f"sub-{label}_hemi-{letter}{mesh}" for label in people for letter in "LR"]
    linked = json.loads((root / "out" / name / "dataset_description.json").read_text())["DatasetLinks"]["source"]
    source = root / name.partition("_")[0]
    assert linked == source.as_uri()
    for path in maps.values():
        sidecar = json.loads(path.with_suffix(".json").read_text())
        sources = [text.split(":", 2) for text in sidecar["Sources"]]
        assert len(sources) >= 4
        assert all((scheme, of) == ("bids", "source") for scheme, of, _ in sources)
        assert all((source / file).is_file() for _, _, file in sources)
        assert ("SpatialReference" in sidecar, "Density" in sidecar) == (bool(mesh), bool(mesh))
        flat = nib.load(path.with_suffix(".surf.gii"))
        assert len(flat.agg_data("pointset")) == (FEW if mesh else VERTICES)
        assert voxflat.load(path).distortion.triangles.flipped == 0
        assert sidecar["surface"]["cortex"] == (
            "the grayordinates of the CIFTI files" if name == "fmriprep_fsLR" else "the cortex label"
        )
        assert (root / "out" / name / f"{path.name.partition('_hemi')[0]}{mesh}.html").is_file()


@pytest.mark.slow
def test_the_same_surfaces_in_two_layouts_have_the_same_map(made):
    root, _ = made
    for of, other in (("fmriprep_native", "hcp_native"), ("fmriprep_fsLR", "hcp_fsLR")):
        for one, two in zip(maps_of(root, of).values(), maps_of(root, other).values(), strict=True):
            first, second = voxflat.load(one), voxflat.load(two)
            assert first.ids.tolist() == second.ids.tolist()
            assert_allclose(first.uv, second.uv, atol=0.05)  # the spheres differ by rounding


@pytest.mark.slow
def test_the_distances_of_surfaces_in_the_space_of_mni_are_said_to_be_warped(made):
    root, told = made
    assert told["mni_fsLR"].count("the surfaces in MNINonLinear are warped to MNI152") == 4
    assert "MNINonLinear are warped" not in told["hcp_fsLR"]
    for one, two in zip(maps_of(root, "hcp_fsLR").values(), maps_of(root, "mni_fsLR").values(), strict=True):
        own, warped = (np.ptp(voxflat.load(path).uv, axis=0) for path in (one, two))
        assert_allclose(warped, 1.1 * own, rtol=0.03)  # the size in `write_hcp`


@pytest.mark.slow
def test_the_overlay_of_a_series_is_its_mean_over_time(made):
    root, _ = made
    for path in maps_of(root, "fmriprep_fsLR").values():
        start = str(path).removesuffix("_flat.npz")
        bold, thickness = (nib.load(f"{start}_desc-voxflat_{of}.shape.gii").agg_data() for of in ("bold", "thickness"))
        assert_allclose(bold, thickness + 1.0, rtol=1e-5)  # the frames have thickness + 0, 1 and 2
        assert np.isfinite(bold).sum() > FEW / 2


@pytest.mark.slow
def test_a_series_on_fsaverage5_is_shown_on_the_native_map(made, tmp_path):
    root, _ = made
    shutil.copytree(root / "fmriprep" / "sub-01", tmp_path / "fmriprep" / "sub-01")
    whole = studies.hemisphere("lh")
    name = "sub-01_task-rest_hemi-L_space-fsaverage5_bold.func.gii"
    frames = [(whole["sphere"][:, 2] + n).astype("f4") for n in range(3)]
    path = tmp_path / "fmriprep" / "sub-01" / "func" / name
    studies.write_gifti(path, "lh", *((frame, "TIME_SERIES") for frame in frames))
    words = ["bids", tmp_path / "fmriprep", tmp_path / "out", "participant", "--hemi", "L"]
    succeed(*words, "--overlay", "{subject}_task-rest_hemi-{hemi}_space-fsaverage5_bold.func.gii")
    (shown,) = (tmp_path / "out").rglob("*_desc-voxflat_bold.shape.gii")
    values = nib.load(shown).agg_data()
    is_shown = np.isfinite(values)
    assert is_shown.sum() > 0.8 * VERTICES
    # the first vertices of fsaverage5 are those of the coarser sphere, and the frames have z + 0, 1 and 2
    assert_allclose(values[is_shown], whole["sphere"][:VERTICES][is_shown, 2] + 1, atol=0.01)
    told = "is on fsaverage5, but no sphere registers the surface to it. Pass --space native"
    fail(1, told, *words, "--space", "fsLR", "--overlay", path)


@pytest.mark.slow
def test_a_resampled_surface_has_the_positions_of_its_vertices_on_the_native_sphere(made):
    root, _ = made
    anat = root / "fmriprep" / "sub-01" / "anat"
    found = found_in(anat, "lh", Parameters(), layout_in(anat, "fsLR"))
    sphere = registered_sphere(found.files, "midthickness")
    wanted = studies.hemisphere("lh", FEW)["sphere"]
    assert_allclose(sphere.points / 100, wanted / np.linalg.norm(wanted, axis=1)[:, None], atol=1e-4)
    strange = {**found.files, "native white": root / "fmriprep" / "sub-02" / "anat" / "sub-02_hemi-L_white.surf.gii"}
    refused(r"are \d\.\d mm from .*Pass surfaces of the same participant", registered_sphere, strange, "midthickness")


@pytest.mark.slow
def test_the_maps_of_two_spaces_lie_side_by_side(made, tmp_path):
    root, _ = made
    for space in ("native", "fsLR"):
        succeed("bids", root / "fmriprep", tmp_path, "participant", "--hemi", "L", "--space", space)
    before = everything(tmp_path)
    for space in ("native", "fsLR"):
        told = succeed("bids", root / "fmriprep", tmp_path, "participant", "--hemi", "L", "--space", space)
        assert "2 participants: 0 made, 2 up to date" in told.stdout
    assert everything(tmp_path) == before
    for space, count in (("native", VERTICES), ("fsLR", FEW)):
        told = json.loads(succeed("bids", root / "fmriprep", tmp_path, "group", "--space", space, "--json").stdout)
        assert (told["maps"], told["warnings"] == [], told["missing"]) == (2, space == "native", {})
        points = np.loadtxt(tmp_path / "group_desc-voxflat_measures.tsv", str, delimiter="\t")
        row = dict(zip(points[0], points[1], strict=True))
        assert FEW / 2 < int(row["points"]) < count


@pytest.mark.slow
def test_a_killed_run_continues_with_the_same_results(made, tmp_path):
    root, _ = made
    words = ["bids", root / "hcp", tmp_path, "participant"]
    run = subprocess.Popen([sys.executable, "-m", "voxflat.cli", *map(str, words)], stdout=subprocess.PIPE, text=True)
    run.stdout.readline()  # the first hemisphere is ready
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert 1 <= len(list(tmp_path.rglob("*_flat.json"))) < 4
    assert "0 failed" in succeed(*words).stdout
    whole = root / "out" / "hcp_native"
    names = [path.relative_to(whole) for path in sorted(whole.rglob("*.gii"))]
    assert len(names) == 4 * 6
    for name in names:
        assert nib.load(whole / name).darrays[0].data.tobytes() == nib.load(tmp_path / name).darrays[0].data.tobytes()
    assert {path.name for path in tmp_path.rglob("*")} == {path.name for path in whole.rglob("*")}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fmriprep_native", "fmriprep_fsLR", "hcp_native", "hcp_fsLR"])
def test_the_spec_lists_all_files_and_the_scene_those_that_are_opened(made, name):
    root, _ = made
    anat = next((root / "out" / name).rglob("anat"))
    (spec,), (scene,) = anat.glob("*.spec"), anat.glob("*.scene")
    assert (spec.stem, spec.stem) == (scene.stem, next(anat.glob("*_hemi-L*_flat.npz")).stem.replace("_hemi-L", ""))
    entries = {entry.text: entry.attrib for entry in ElementTree.parse(spec).iter("DataFile")}
    paths = {(anat / text).resolve(): of for text, of in entries.items()}
    assert all(path.is_file() for path in paths)
    assert {path for path in paths if path.parent == anat} == set(anat.glob("*.gii"))
    of_study = [path.name for path in paths if path.is_relative_to(root / name.partition("_")[0])]
    for surface in ("white", "pial"):
        assert len([file for file in of_study if re.search(rf"[_.]{surface}\.(.*\.)?surf\.gii$", file)]) == 2
    assert len([file for file in of_study if file.endswith(".nii")]) == (2 if name == "fmriprep_fsLR" else 0)
    for path, of in paths.items():
        is_series = path.name.endswith(".dtseries.nii")
        assert of["Selected"] == ("false" if is_series else "true")
        letter = re.search(r"hemi-([LR])|\.([LR])\.", path.name)
        sides = {"L": "CortexLeft", "R": "CortexRight"}
        assert of["Structure"] == (sides[letter[1] or letter[2]] if letter else "Invalid")
    opened = [of.text for of in ElementTree.parse(scene).iter("Object") if of.get("Name") == "fileName"]
    assert opened == [text for text, of in entries.items() if of["Selected"] == "true"]


def drawn(scene, folder):
    """Return the pixels of a scene."""
    workbench("-show-scene", scene, "1", folder / "scene.png", "600", "300")
    return np.asarray(Image.open(folder / "scene.png").convert("RGB")).astype(float)


@pytest.mark.slow
@needs_workbench
@pytest.mark.parametrize("name", ["fmriprep_native", "fmriprep_fsLR", "hcp_native", "hcp_fsLR"])
def test_workbench_opens_every_file_and_draws_the_scene(made, name, tmp_path):
    root, _ = made
    anat = next((root / "out" / name).rglob("anat"))
    for path in sorted(anat.glob("*.gii")):
        assert "Structure" in workbench("-file-information", path)
        assert len(load_surf_mesh(path).coordinates if path.name.endswith(".surf.gii") else load_surf_data(path))
    (spec,), (scene,) = anat.glob("*.spec"), anat.glob("*.scene")
    count = len(list(ElementTree.parse(spec).iter("DataFile")))
    assert len(re.findall(r"\.(?:gii|nii) ", workbench("-file-information", spec))) == count
    workbench("-spec-file-merge", spec, spec, tmp_path / "merged.spec")
    pixels = drawn(scene, tmp_path)
    tree = ElementTree.parse(scene)
    overlays = next(of for of in tree.iter("ObjectArray") if of.get("Name") == "m_overlays")
    members = [element[0] for element in overlays]
    for element, member in zip(overlays, members[::-1], strict=True):
        element[:] = [member]
    other = scene.with_name("reversed.scene")
    tree.write(other)
    assert np.abs(drawn(other, tmp_path) - pixels).mean() > 10  # the first overlay is on top
    other.unlink()
    for half in (pixels[:, :300], pixels[:, 300:]):  # the left and the right map on black
        assert 0.3 < (half.max(axis=2) > 40).mean() < 0.95
        shown = half[half.max(axis=2) > 40]
        assert shown.std(axis=0).max() > 20  # values, not a uniform surface


@pytest.mark.slow
def test_a_lost_spec_is_written_again(made, tmp_path):
    root, _ = made
    out = shutil.copytree(root / "out" / "hcp_native", tmp_path / "out")
    before = everything(out)
    (spec,) = out.glob("sub-100002/anat/*.spec")
    text = spec.read_text()
    spec.unlink()
    succeed("bids", root / "hcp", out, "participant")
    assert spec.read_text().count("<DataFile") == text.count("<DataFile")
    assert before.keys() == everything(out).keys()
