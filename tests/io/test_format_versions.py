"""Files in voxflat's own formats: a later version asks to update voxflat, and an older version is named."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import voxflat
from voxflat.distances.store import read_description
from voxflat.surfaces.standard import template

FORMAT = re.compile(r'("format": (?:"[a-z ]+ )?)(\d+)')


def with_format(text, change):
    """Return JSON with another format version."""
    assert len(FORMAT.findall(text)) == 1
    return FORMAT.sub(lambda found: f"{found[1]}{int(found[2]) + change}", text)


HILL = voxflat.samples.hill()
TEMPLATE = Path(template.__file__).parent / "fs_LR.left.json"
FILES = {  # reader, writer, and the array that contains the format of an archive
    "map.npz": (voxflat.load, lambda path: HILL.flatten(relax=False).save(path), "metadata"),
    "atlas.npz": (voxflat.load_atlas, lambda path: HILL.patches(max_angle=20).save(path), "text"),
    "glued.npz": (voxflat.load_atlas, lambda path: HILL.patches(max_angle=20).glue().save(path), "text"),
    "rows": (voxflat.open_rows, lambda path: HILL.geodesic(9, store=path), None),
    "template.json": (template.read_template, lambda path: path.write_bytes(TEMPLATE.read_bytes()), None),
}


def written(path, name, change):
    """Write a file with another format version."""
    _, write, key = FILES[name]
    write(path)
    if key is None:
        file = path / "store.json" if path.is_dir() else path
        file.write_text(with_format(file.read_text(encoding="utf-8"), change), encoding="utf-8")
        return path
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, key: np.array(with_format(str(arrays[key]), change))})
    return path


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_a_later_version_says_to_update(tmp_path, name):
    read = FILES[name][0]
    read(written(tmp_path / f"now.{name}", name, 0))
    newer = rf"{name}.* was made by a newer version of voxflat. Update voxflat$"
    refused(newer, read, written(tmp_path / name, name, 1))
    message = rf"older\.{name}.* has the format \S.*, but this version of voxflat reads \S.*\. [A-Z]"
    refused(message, read, written(tmp_path / f"older.{name}", name, -1))


def test_a_later_version_may_lack_the_arrays_of_this_one(tmp_path):
    np.savez(tmp_path / "a.npz", text=json.dumps({"format": "voxflat atlas 99"}))
    refused("newer version", voxflat.load_atlas, tmp_path / "a.npz")
    np.savez(tmp_path / "m.npz", metadata=json.dumps({"format": 99}))
    refused("newer version", voxflat.load, tmp_path / "m.npz")


@pytest.mark.parametrize("found", ["voxflat lines 3", "3", None, True, [9], -9, 9.5, "voxflat rows x"])
def test_anything_else_is_no_later_version(tmp_path, found):
    (tmp_path / "store.json").write_text(json.dumps({"format": found}), encoding="utf-8")
    refused("has the format", read_description, tmp_path)
