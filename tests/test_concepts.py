import re
import sys
from pathlib import Path

import numpy as np
import pytest

import voxflat
from voxflat.io.volumes import write_volume

ROOT = Path(__file__).parents[1]
WALK = re.search(r"^## The walk.*?(?=^## )", (ROOT / "docs/concepts.md").read_text(), re.MULTILINE | re.DOTALL)[0]
FILES = re.findall(r"^\| `([^`]+)` \|", WALK, re.MULTILINE)


@pytest.fixture
def volumes(tmp_path):
    offsets = np.indices((20, 20, 20)) - 9.5
    write_volume(tmp_path / "labels.nii.gz", (np.square(offsets).sum(axis=0) < 49).astype(np.int16), np.eye(4))
    write_volume(tmp_path / "t1.nii.gz", offsets[0].astype(np.float32), np.eye(4))
    return tmp_path


@pytest.mark.slow
def test_the_walk_passes_the_python_files_that_are_told_in_that_order(volumes):
    passed = []

    def on_call(frame, event, _):
        module = frame.f_globals.get("__name__", "")
        is_call = event == "call" and frame.f_code.co_name != "<module>"
        if is_call and module.startswith("voxflat.") and module not in passed:
            passed.append(module)

    sys.setprofile(on_call)
    try:
        flat_map = voxflat.flatten(volumes / "labels.nii.gz")
        flat_map.image(volumes / "t1.nii.gz", depth=1.0).save(volumes / "t1_flat.png")
    finally:
        sys.setprofile(None)
    told = [file for file in FILES if file.endswith(".py")]
    assert [f"{module.removeprefix('voxflat.').replace('.', '/')}.py" for module in passed] == told


def test_the_walk_names_each_file_once_and_all_are_there():
    assert len(FILES) == len(set(FILES)) > 80
    for file in FILES:
        folder = "plugin/voxflat" if file.endswith(".py") else "rust/core/src"
        assert (ROOT / folder / file).is_file()
