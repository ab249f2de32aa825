"""The metadata of files that were really written follow the schema that docs/reference publishes."""

import json
from pathlib import Path

import numpy as np
import pytest

import voxflat
from voxflat.io.descriptions import check_description

jsonschema = pytest.importorskip("jsonschema")

SCHEMA = json.loads((Path(__file__).parents[2] / "docs/reference/metadata.schema.json").read_text(encoding="utf-8"))
NOT_KEPT = {"format", "distortion"}  # in the metadata of a map that is loaded
HILL, BALL = voxflat.samples.hill(), voxflat.surface(voxflat.samples.ball(), label=3)
LONG = np.pad(np.ones((24, 6, 6), dtype=np.uint8), 3)
DEPTHS = np.add.outer(np.linspace(0, 2, 12) ** 2, np.linspace(0, 1, 9))


def defects(content, kind, *, complete=True, of=SCHEMA["$defs"]):
    """Return what the schema refuses; with `complete`, also keys that it does not describe."""
    rule = {"$ref": f"#/$defs/{kind}", **({"unevaluatedProperties": False} if complete else {})}
    validator = jsonschema.Draft202012Validator({"$schema": SCHEMA["$schema"], "$defs": SCHEMA["$defs"] | of, **rule})
    return [f"{error.json_path}: {error.message[:200]}" for error in validator.iter_errors(content)]


def archived(path, name="metadata"):
    """Return the JSON of an archive."""
    with np.load(path) as archive:
        return json.loads(str(archive[name]))


def part_of_ball():
    return BALL.disk(tuple(BALL.ids[0]), 6.0)


def moved_hill():
    return voxflat.flatten_series([HILL, (HILL.points * 1.1, HILL.faces)])


MAPS = {
    "voxels": lambda: part_of_ball().flatten(),
    "voxels above a threshold": lambda: voxflat.surface(
        voxflat.samples.ball(), threshold=2.5, repair="voxels"
    ).flatten(),
    "links between voxels": lambda: part_of_ball().flatten(voxflat.methods.Grossmann2002()),
    "mesh": lambda: HILL.flatten(relax=False),
    "mesh with cuts": lambda: HILL.cut([[200, 221, 242]]).flatten(),
    "mesh with a repair": lambda: voxflat.flatten(
        (np.vstack([HILL.points, HILL.points[:1]]), [*HILL.faces, (441, 1, 22)])
    ),
    "smoothed": lambda: HILL.smooth(2.0).flatten(),
    "areas": lambda: HILL.flatten(voxflat.methods.Voxflat(scale="areas", max_area=4.0)),
    "range image": lambda: voxflat.range_image(DEPTHS, spacing=(1.0, 1.0)).flatten(voxflat.methods.Zigelman2002()),
    "starts": lambda: HILL.flatten(voxflat.methods.Schwartz1989(starts=2)),
    "patches": lambda: HILL.flatten(voxflat.methods.Saucan2006()),
    "rim": lambda: voxflat.rim(voxflat.samples.rim()).surface.flatten(),
    "frame of a series": lambda: moved_hill()[1],
    "group": lambda: voxflat.flatten_group([HILL, (HILL.points * 1.1, HILL.faces)]),
    "without its surface": lambda: voxflat.load((HILL.points * [1, 1, 0], HILL.faces)),
    "chart": lambda: BALL.charts(2)[0].flatten(),
    "periodic": lambda: voxflat.surface(LONG, label=1).charts("cylinder")[0].flatten(),
}


@pytest.mark.medium
@pytest.mark.parametrize("name", MAPS)
def test_the_metadata_of_a_map_follow_the_schema(tmp_path, name):
    MAPS[name]().save(tmp_path / "map.npz", sidecar=True)
    assert defects(archived(tmp_path / "map.npz"), "map") == []
    assert voxflat.load(tmp_path / "map.npz").metadata.keys() == archived(tmp_path / "map.npz").keys() - NOT_KEPT
    assert defects(json.loads((tmp_path / "map.npz.json").read_text()), "record") == []


FILES = {
    "series": (lambda path: moved_hill().save(path), archived),
    "patches": (lambda path: HILL.patches(max_angle=20).save(path), lambda path: archived(path, "text")),
    "glued": (lambda path: part_of_ball().patches(max_angle=20).glue().save(path), lambda path: archived(path, "text")),
    "rows": (lambda path: HILL.geodesic(9, store=path), lambda path: json.loads((path / "store.json").read_text())),
    "cuts": (
        lambda path: HILL.cut([[200, 221]]).save(path.with_suffix(".json")),
        lambda path: json.loads(path.with_suffix(".json").read_text()),
    ),
}


@pytest.mark.medium
@pytest.mark.parametrize("kind", FILES)
def test_the_metadata_of_other_files_follow_the_schema(tmp_path, kind):
    write, read = FILES[kind]
    write(tmp_path / "made.npz")
    content = read(tmp_path / "made.npz")
    assert defects(content, kind) == []
    jsonschema.validate(content, SCHEMA)


PARTS = ("origin", "surface", "flattening", "pieces")
RULES = {key: rule for part in PARTS for key, rule in SCHEMA["$defs"][part]["properties"].items()}
ELSEWHERE = {"kind", "shape", "affine", "vertices", "space"}  # without which a map has no place


@pytest.mark.parametrize("key", sorted(RULES.keys() - ELSEWHERE))
def test_readers_check_every_key_of_the_schema(key):
    for value in ("x", -1, 1.5, True, [], 3, ["x"]):
        if defects(value, key, complete=False, of={key: RULES[key]}):
            with pytest.raises(voxflat.InputError, match=f"its key '{key}' is "):
                check_description({key: value})


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (["kind"], "points"),
        (["vertices"], 0),
        (["space", "name"], "MNI"),
        (["provenance", "files"], {"a.nii": "not a hash"}),
        (["distortion", "reference"], "straight"),
        (["format"], 4),
    ],
)
def test_the_schema_refuses_other_metadata(tmp_path, place, value):
    HILL.flatten(relax=False).save(tmp_path / "map.npz")
    content = archived(tmp_path / "map.npz")
    *parents, last = place
    holder = content
    for key in parents:
        holder = holder[key]
    holder[last] = value
    assert defects(content, "map", complete=False)


def test_readers_ignore_further_keys(tmp_path):
    HILL.flatten(relax=False).save(tmp_path / "map.npz")
    content = archived(tmp_path / "map.npz") | {"author": "another program"}
    assert defects(content, "map", complete=False) == []
    assert defects(content, "map")
