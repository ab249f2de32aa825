import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from command_line import succeed
from scipy import ndimage

import voxflat
from voxflat import demo
from voxflat.io.volumes import write_volume

README = (Path(__file__).parents[2] / "README.md").read_text()


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A working directory with the files that README names, with white matter only around its seed point."""
    white_matter, t1, _ = demo.demo_cortex()
    near = tuple(slice(at - 6, at + 7) for at in demo.SEED_POINT)
    ends = tuple(slice(at + 19) for at in demo.SEED_POINT)
    part = np.zeros_like(white_matter.data)
    part[near] = white_matter.data[near]
    write_volume(tmp_path / "wm.nii.gz", part[ends], white_matter.affine)
    write_volume(tmp_path / "t1.nii.gz", t1.data[ends], t1.affine)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_python_example_runs(lab):
    code = re.search(r"```python\n(import voxflat\n.*?)```", README, re.DOTALL)[1]
    names = {}
    exec(code, names)
    assert len(names["flat"]) > 400
    assert (lab / "t1_flat.tif").stat().st_size > 10_000
    np.testing.assert_array_equal(voxflat.load(lab / "map.npz").uv, names["flat"].uv)
    assert names["distances"].shape[0] == 100
    assert names["atlas"].certificate.c == pytest.approx(1.2)


@pytest.mark.slow
def test_the_commands_run(lab):
    white_matter, _, _ = demo.demo_cortex()
    grid = white_matter.affine @ np.diag([1.5, 1.5, 1.5, 1])
    whole = ndimage.affine_transform(white_matter.data, np.full(3, 1.5), output_shape=(132, 156, 126), order=1)
    write_volume(lab / "brain.nii.gz", whole, grid)
    write_volume(lab / "zstat.nii.gz", 9 * np.sin(np.indices(whole.shape)[1] / 9), grid)
    rim = voxflat.samples.rim()
    write_volume(lab / "rim.nii.gz", rim.data, rim.affine)
    commands = re.findall(r"^ {4}voxflat (.*)$", README, re.MULTILINE)
    assert len(commands) == 7
    for command in commands:
        succeed(*shlex.split(command, comments=True))
    assert {path.name for path in lab.iterdir()} >= {
        "lh.npz",
        "rh.npz",
        "both.png",
        "map.npz",
        "t1_flat.png",
        "layers.nii.gz",
    }


def test_every_relative_link_exists_and_the_readme_is_short():
    """Pictures in docs/_generated, which the build of the documentation makes, need not exist."""
    root = Path(__file__).parents[2]
    pages = [*root.glob("*.md"), *root.glob("docs/*.md"), *root.glob("docs/[!_]*/**/*.md")]
    links = {(page, target) for page in pages for target in re.findall(r"\]\(([^)#:]+)[)#]", page.read_text())}
    assert len(links) > 50
    missing = [link for link in links if "_generated/" not in link[1] and not (link[0].parent / link[1]).exists()]
    assert missing == []
    assert len(README.split()) <= 900
