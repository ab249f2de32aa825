"""Files in voxflat's own formats: a later version asks to update voxflat, and an older version is named."""

import json
import re
import shutil
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
    "cuts.json": (HILL.cut, lambda path: HILL.cut([[200, 221]]).save(path), None),
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


@pytest.mark.medium
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


KEPT = Path(__file__).parents[1] / "data" / "formats"
"""Files of every version since the first release. Later programs must open them: add files, never replace them."""


@pytest.mark.medium
def test_kept_maps_open():
    mesh, voxels = (voxflat.load(KEPT / name) for name in ("map-5.npz", "map-5.voxflat"))
    assert (len(mesh), mesh.uv[0].tolist()) == (49, [-3.2044743565226304, -3.220240423591828])
    assert (len(voxels), voxels.uv[0].tolist()) == (81, [-4.000260451081108, -4.112915964461625])
    errors = [flat.distortion.raw.relative_error for flat in (mesh, voxels)]
    assert errors == [0.006559079800173233, 0.0001655650852129655]
    assert all(flat.plot().axes for flat in (mesh, voxels))  # they can be used


def test_kept_atlases_open():
    atlas, glued = (voxflat.load_atlas(KEPT / f"{name}.npz") for name in ("patches-3", "glued-2"))
    assert (len(atlas), atlas.uv[0].tolist()) == (4, [-1.1490292080254034, -2.1108521704622154])
    assert (len(glued), glued.uv[0].tolist()) == (1, [-1.1916926839383042, -2.1522591049543927])


def test_kept_rows_open(tmp_path):
    rows = voxflat.open_rows(shutil.copytree(KEPT / "rows-2", tmp_path / "rows"))
    assert rows.sources.tolist() == [32, 0, 6]
    np.testing.assert_array_equal(np.asarray(rows.rows)[:, 0], np.float32([5.929156, 0, 6.579514]))


def test_kept_cuts_and_templates_open(tmp_path):
    mesh = voxflat.load(KEPT / "map-5.npz")
    cut = voxflat.surface((mesh.points, mesh.faces)).cut(KEPT / "cuts-1.json")
    assert [path.ids.tolist() for path in cut.cuts] == [[3, 10, 17]]
    (tmp_path / "cuts.json").write_text('{"cuts": [[200, 221]]}', encoding="utf-8")  # of the first version
    assert [path.ids.tolist() for path in HILL.cut(tmp_path / "cuts.json").cuts] == [[200, 221]]
    read = template.read_template(KEPT / "template-1.json")
    assert (read.space, read.side, len(read.cuts)) == ("fs_LR", "left", 5)
