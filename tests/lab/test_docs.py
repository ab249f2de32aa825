"""The commands and the Python code in the how-to guides for labs run as written."""

import re
import shlex
from fnmatch import fnmatch

import how_to
import numpy as np
import pytest
import studies
from command_line import succeed
from lab_runs import FEW

pytestmark = pytest.mark.slow  # its fixtures take seconds

PAGE = how_to.text("freesurfer-subject", "bids-study", "other-programs")
FILES = (how_to.HOW_TO.parent / "reference" / "study-files.md").read_text()


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Return a directory with a subject and a study after all commands, and the output of each command."""
    folder = tmp_path_factory.mktemp("lab")
    places = [folder / "sub-01", *(folder / "study" / "sourcedata" / "freesurfer" / f"sub-0{n}" for n in (1, 2))]
    for hemi in ("lh", "rh"):
        for seed, place in enumerate(places):
            studies.write_freesurfer(place, hemi, studies.warped(studies.hemisphere(hemi, FEW), seed))
    said = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in how_to.commands(PAGE):
            said[command] = succeed(*shlex.split(command)).stdout
    return folder, said


def test_the_commands_run(lab):
    _, said = lab
    assert len(said) == 7
    assert "2 participants: 2 made" in said["bids study maps participant"]
    assert "2 participants: 0 made, 2 up to date" in said["bids study maps participant --participant-label 01 02"]
    assert "maps: 2 left and 2 right hemispheres of 2 participants" in said["bids study maps group"]


def test_the_files_that_the_page_names_are_there(lab):
    folder, _ = lab
    for name in re.findall(r"^\| `([^`]+)`", how_to.text("freesurfer-subject"), re.MULTILINE):
        assert list(folder.glob(f"sub-01/{name}")), name
    for name in re.findall(r"`([a-z]+)` \(", re.search(r"at the vertices: (.*?), and every overlay", PAGE)[1]):
        assert (folder / "sub-01" / "surf" / f"lh.voxflat.{name}.shape.gii").is_file()
    for name in ("sub-01.html", "group.html", "dataset_description.json", ".bidsignore"):
        assert f"`{name}`" in PAGE
        assert (folder / "maps" / name).is_file()


def test_the_files_of_a_study_are_those_of_the_reference_page(lab):
    out = lab[0] / "maps"
    listed = re.findall(r"^\| `([\w-]+\.[a-z.]+)`", FILES, re.MULTILINE)
    names = {f"sub-01_hemi-{letter}_{name}" for letter in "LR" for name in listed}
    names |= set(re.findall(r"`(sub-01_flat\.\w+)`", FILES))
    assert {path.name for path in (out / "sub-01" / "anat").iterdir()} == {n for n in names if "failure" not in n}
    header = (out / "group_desc-voxflat_measures.tsv").read_text().split("\n")[0].split("\t")
    table = FILES[FILES.index("| columns") :]
    columns = [name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall("`(.*?)`", row)]
    assert all(any(fnmatch(name, column) for column in columns) for name in header)
    assert all(any(fnmatch(name, column) for name in header) for column in columns)


def test_nilearn_draws_the_flat_surface_with_an_overlay(lab, monkeypatch):
    folder, _ = lab
    monkeypatch.chdir(folder)
    code = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1]
    names = {}
    exec(code.replace("plotting.plot_surf(", "figure = plotting.plot_surf("), names)
    names["figure"].canvas.draw()
    assert len(np.unique(np.asarray(names["figure"].canvas.buffer_rgba())[..., :3].reshape(-1, 3), axis=0)) > 50
