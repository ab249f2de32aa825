import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import succeed
from scipy import ndimage

from voxflat import demo
from voxflat.io.volumes import write_volume

README = (Path(__file__).parents[1] / "README.md").read_text()


@pytest.fixture(scope="module")
def volumes(tmp_path_factory):
    """The files that README speaks of: white matter only around its seed point, and nothing far beyond it."""
    folder = tmp_path_factory.mktemp("volumes")
    white_matter, t1, _ = demo.demo_cortex()
    near = tuple(slice(at - 6, at + 7) for at in demo.SEED_POINT)
    ends = tuple(slice(at + 19) for at in demo.SEED_POINT)
    part = np.zeros_like(white_matter.data)
    part[near] = white_matter.data[near]
    write_volume(folder / "wm.nii.gz", part[ends], white_matter.affine)
    write_volume(folder / "t1.nii.gz", t1.data[ends], t1.affine)
    return folder


@pytest.fixture
def lab(volumes, tmp_path, monkeypatch):
    """The directory of a user who has these files."""
    shutil.copytree(volumes, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_python_example_runs(lab):
    code = re.search(r"```python\n(import voxflat\n.*?)```", README, re.DOTALL)[1]
    names = {"picture": np.zeros((20, 30, 3), np.uint8)}
    exec(code, names)
    assert len(names["m"]) == len(names["colours"]) > 400
    assert (lab / "t1_flat.tif").stat().st_size > 10_000
    assert names["rows"].shape[0] == 100
    assert names["path"].length > 10


@pytest.mark.slow
def test_the_commands_run(lab):
    white_matter, _, _ = demo.demo_cortex()
    grid = white_matter.affine @ np.diag([1.5, 1.5, 1.5, 1])
    whole = ndimage.affine_transform(white_matter.data, np.full(3, 1.5), output_shape=(132, 156, 126), order=1)
    write_volume(lab / "brain.nii.gz", whole, grid)
    write_volume(lab / "zstat.nii.gz", 9 * np.sin(np.indices(whole.shape)[1] / 9), grid)
    commands = re.findall(r"^ {4}voxflat (.*)$", README, re.MULTILINE)
    assert len(commands) == 8
    for command in commands:
        succeed(*shlex.split(command, comments=True))
    made = {"lh.npz", "rh.npz", "both.png", "map.npz", "t1_flat.png", "distortion.png", "t1_figure.png"}
    assert {path.name for path in lab.iterdir()} >= made


def test_links_lead_somewhere_and_from_the_readme_to_every_page():
    root = Path(__file__).parents[1]
    reached, pages = set(), [root / "README.md"]
    while pages:
        page = pages.pop()
        reached.add(page)
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            path = (page.parent / target).resolve()
            assert path.exists(), f"{page.name}: {target}"
            found = path.glob("*.md") if path.is_dir() else [path]
            pages += [path for path in found if path.suffix == ".md" and path not in reached]
    assert reached >= {root / "CONTRIBUTING.md", root / "CHANGELOG.md", *root.glob("docs/**/*.md")}
