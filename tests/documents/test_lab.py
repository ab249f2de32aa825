"""The commands for labs in README and the how-to guides work in a folder in FreeSurfer's layout."""

import re
import shlex
from pathlib import Path

import composed
import how_to
import lab
import nibabel as nib
import pytest
from command_line import succeed
from lab_runs import FEW, VERTICES
from mesh_files import write_obj

import voxflat

ROOT = Path(__file__).parents[2]
AS_GOOD = 1.1  # times the error of the best map with any option


def run(command):
    return succeed(*shlex.split(command)).output


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    """The folder after all commands in the order of the pages, and their output."""
    folder = tmp_path_factory.mktemp("surf")
    lab.write(folder, FEW)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run("cut lh.white --pial lh.pial --drop medial-wall -o lh.cortex.patch.3d")
        said = {}
        for command in how_to.commands(how_to.text("freesurfer-surfaces", "cuts", "own-cuts", "areas")):
            said[command] = run(command.replace("1204 811 2032", "104 61 132"))
        flat = voxflat.load("map.npz")
        white, _, _ = lab.hemisphere(FEW)
        write_obj(folder / "unwrapped.obj", white, flat.ids[flat.faces], flat.uv[flat.faces])
        for command in how_to.commands(how_to.text("compare-maps")):
            if command.startswith("measure lh."):
                said[command] = run(f"{command} --sources 20")
    return folder, said


@pytest.mark.slow
def test_the_commands_run_and_readmes_are_among_them(subject):
    folder, said = subject
    assert len(said) >= 8
    readme = (ROOT / "README.md").read_text()
    pattern = r"(?:^ {0,4}|`)voxflat ((?:flatten|measure) [^`\n]*[^`\n.])(?:`|$)"  # in lines and within sentences
    for command in re.findall(pattern, readme, re.MULTILINE):
        if command.startswith(("flatten lh.", "measure lh.")) and "-o" in command:
            assert command in said or command.startswith("flatten lh.white --pial lh.pial -o")
    places, faces = nib.load(folder / "lh.flat.surf.gii").agg_data()
    assert len(places) == FEW
    assert not places[:, 2].any()
    assert len(faces) > 200


@pytest.mark.slow
def test_what_is_left_out_gives_the_best_map_of_any_option(tmp_path, monkeypatch):
    lab.write(tmp_path, VERTICES)
    monkeypatch.chdir(tmp_path)
    surface = voxflat.surface("lh.white", pial="lh.pial")

    def error(**options):
        return composed.flatten(surface, **options).distortion.raw.relative_error

    patch = {"drop": "lh.Medial_wall.label"}
    flat = composed.flatten(surface, **patch)
    usual = flat.distortion.raw.relative_error
    assert usual < 0.08  # 0.2 without cuts
    own = {"cuts": [cut["ids"] for cut in flat.metadata["automatic_cuts"]], **patch}
    others = [{"weighting": 0.0}, {"weighting": 1.0}, {"geodesic": "marching"}, {"scale": "areas"}, {"sources": 600}]
    others += [{"sampling": "random"}]
    found = {str(options): error(**own, **options) for options in others}
    found["relax=False"] = error(**patch, relax=False)
    assert usual <= AS_GOOD * min(found.values()), found


@pytest.mark.slow
def test_a_patch_keeps_its_cuts_and_the_map_is_as_good(subject, monkeypatch):
    folder, _ = subject
    monkeypatch.chdir(folder)
    kept = voxflat.surface("lh.midthickness.surf.gii").keep("lh.cortex.patch.3d").flatten()
    assert kept.metadata["automatic_cuts"] == []
    assert kept.distortion.raw.relative_error < 0.08  # 0.2 without cuts
