"""The container recipes, the Boutiques descriptor and the Nipype task, tested without a container."""

import importlib.util
import json
import os
import pickle
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import studies
from lab_runs import FEW

from voxflat.cli.commands.study import bids_command

ROOT = Path(__file__).parents[2]
CLUSTER = ROOT / "docs" / "cluster"
DESCRIPTOR = CLUSTER / "voxflat.boutiques.json"
GIVEN = {"source": str(ROOT), "out": "maps", "level": "participant", "labels": ["01", "02"], "hemis": ["left"]}
GIVEN |= {"overlays": ["thickness", "curv"], "cuts": "automatic", "volume": True, "dry_run": True, "threads": 2}
GIVEN |= {"memory_limit": "4G", "dask": "local"}


def text(name):
    return (CLUSTER / name).read_text()


def test_the_descriptor_is_that_of_the_command():
    spec = importlib.util.spec_from_file_location("descriptor", CLUSTER / "descriptor.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    found = json.loads(DESCRIPTOR.read_text())
    assert found == made.descriptor(), "python docs/cluster/descriptor.py > docs/cluster/voxflat.boutiques.json"
    assert {one["id"] for one in found["inputs"]} == {parameter.name for parameter in bids_command.params} >= set(GIVEN)


def test_boutiques_takes_it_and_makes_a_command_of_it_that_is_understood(tmp_path, capsys):
    bosh = pytest.importorskip("boutiques").bosh
    bosh(["validate", str(DESCRIPTOR)])
    (tmp_path / "invocation.json").write_text(json.dumps(GIVEN))
    capsys.readouterr()
    bosh(["exec", "simulate", str(DESCRIPTOR), "-i", str(tmp_path / "invocation.json")])
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("voxflat "))
    is_understood(line, GIVEN)


def is_understood(line, given):
    """Check that the command parses a line to the given parameters."""
    program, name, *arguments = shlex.split(line)
    assert (program, name) == ("voxflat", bids_command.name)
    taken = bids_command.make_context("bids", arguments).params
    for name, value in {**given, "memory_limit": 4 << 30, "source": ROOT, "out": Path(given["out"])}.items():
        assert taken[name] == (tuple(value) if isinstance(value, list) else value)


@pytest.fixture
def nipypes(monkeypatch):
    """Return the module of the Nipype workflow."""
    monkeypatch.setenv("NO_ET", "1")  # otherwise Nipype checks its server for updates
    pytest.importorskip("nipype")
    monkeypatch.syspath_prepend(CLUSTER)
    return importlib.import_module("nipype_workflow")


@pytest.mark.slow
def test_nipype_makes_a_command_that_is_understood_whatever_names_are(nipypes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hostile = {"out": "my maps; touch there", "overlays": ["$(touch there)", "it's", "%s"], "cuts": "{hemi} & 2.json"}
    for given in (GIVEN, GIVEN | hostile):
        task = nipypes.VoxflatBids(**given)
        is_understood(task.cmdline, {**given, "out": str(tmp_path / given["out"])})
    known = {one["id"] for one in json.loads(DESCRIPTOR.read_text())["inputs"]}
    assert set(task.inputs.get()) == known | {"args", "environ"}
    assert pickle.loads(pickle.dumps(task)).cmdline == task.cmdline  # as for other processes
    with pytest.raises(importlib.import_module("traits.api").TraitError, match="'participant' or 'group'"):
        nipypes.VoxflatBids(**GIVEN | {"level": "everybody"})


@pytest.mark.slow
def test_a_study_is_a_workflow_of_nipype(nipypes, tmp_path, monkeypatch):
    of = studies.hemisphere("lh", FEW)
    for n in (1, 2):
        studies.write_derivatives(tmp_path / "my study" / f"sub-0{n}" / "anat", f"sub-0{n}", "lh", of)
    (tmp_path / "my study" / "sub-01" / "anat" / "sub-01_hemi-L_pial.surf.gii").unlink()
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    script = [sys.executable, CLUSTER / "nipype_workflow.py", "my study", "maps", "--hemi", "left", "--cores", "1"]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, "failed: sub-01"), done.stderr
    assert "found no *_hemi-L_pial.surf.gii" in done.stdout + done.stderr
    out = tmp_path / "maps"
    monkeypatch.chdir(tmp_path)
    how = {"source": "my study", "out": "maps", "hemis": ["left"]}
    made = nipypes.VoxflatBids(**how, level="participant", labels="02").run().outputs
    assert made.surfaces == [str(out / "sub-02" / "anat" / "sub-02_hemi-L_flat.surf.gii")]
    assert (made.maps, made.pages) == (str(out), [str(out / "sub-02.html")])
    group = nipypes.VoxflatBids(**how, level="group")  # already run by the workflow
    assert group.aggregate_outputs().pages == [str(out / "group.html")]
    with pytest.raises(SystemExit, match="sub-01 L: error"):
        nipypes.said(nipypes.VoxflatBids(**how, level="participant", labels=["01"]))


def test_both_recipes_are_of_the_same_images_and_files():
    docker, apptainer = text("Dockerfile"), text("voxflat.def")
    assert re.findall(r"^FROM (\S+)", docker, re.MULTILINE) == re.findall(r"^From: (\S+)", apptainer, re.MULTILINE)
    files = set(re.findall(r"^!(\S+)", text("Dockerfile.dockerignore"), re.MULTILINE))
    assert files == set(re.findall(r"^ {4}(\S+) /voxflat/\1$", apptainer, re.MULTILINE))
    assert all((ROOT / name).exists() for name in files)
    entry = json.loads(re.search(r"^ENTRYPOINT (.*)$", docker, re.MULTILINE)[1])
    assert " ".join(entry) + ' "$@"' in apptainer
    assert entry == ["voxflat", bids_command.name]
    assert re.search(r"^USER [1-9]", docker, re.MULTILINE)


def test_what_the_images_have_is_enough():
    project = (ROOT / "pyproject.toml").read_text()
    rust, python = (re.search(rf"FROM {one}:([\d.]+)", text("Dockerfile"))[1] for one in ("rust", "python"))
    needed = re.search(r'rust-version = "([\d.]+)"', (ROOT / "Cargo.toml").read_text())[1]
    oldest = re.search(r'requires-python = ">=([\d.]+)"', project)[1]
    for found, least in ((rust, needed), (python, oldest)):
        assert tuple(map(int, found.split("."))) >= tuple(map(int, least.split(".")))
    extras = re.findall(r"--extra (\w+)", text("build"))
    assert extras == ["lab"]
    assert all(f"\n{extra} = [" in project for extra in extras)


@pytest.mark.skipif(os.name == "nt", reason="no shell and no executable bit")
def test_linters_have_nothing_to_say():
    for name in ("build", "install"):
        subprocess.run(["sh", "-n", CLUSTER / name], check=True)
        assert (CLUSTER / name).stat().st_mode & 0o111
    hadolint = shutil.which("hadolint", path=Path(sys.executable).parent)
    if hadolint is None:
        pytest.skip("hadolint is not installed")
    subprocess.run([hadolint, CLUSTER / "Dockerfile"], check=True)
