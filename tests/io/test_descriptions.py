"""Values of the keys that describe a map or an atlas in its file: hostile ones are refused by file, key and value."""

import copy
import json

import numpy as np
import pytest
from shapes import ball

import voxflat
from voxflat.io.descriptions import check_atlas, check_description, check_distortion

HILL = voxflat.samples.hill()
MADE = {
    "mesh": lambda: HILL.cut([[200, 221, 242]]).flatten(),
    "voxels": lambda: voxflat.surface(ball(6)).flatten(),
    "range image": lambda: voxflat.range_image(np.hypot(*np.indices((9, 9))), 0.5).flatten(),
    "patches": lambda: HILL.patches(max_angle=20),
    "glued patches": lambda: HILL.patches(max_angle=20).glue(),
}
HOSTILE = ["x", -1, 1.5, 1e300, True, None, [], ["x"], [[]], {}, {"x": 1}]


@pytest.fixture(scope="module", params=MADE)
def saved(request, tmp_path_factory):
    """Return a file, its arrays, the name of the array with the description, and the description."""
    path = tmp_path_factory.mktemp("saved") / "made.npz"
    MADE[request.param]().save(path)
    with np.load(path) as file:
        arrays = dict(file)
    name = "metadata" if "metadata" in arrays else "text"
    return path, arrays, name, json.loads(str(arrays[name]))


def places(value, path=()):
    """Yield the path to each value of a description; of a list, the first entry stands for all."""
    if path:
        yield path
    entries = value.items() if isinstance(value, dict) else enumerate(value[:1]) if isinstance(value, list) else ()
    for key, entry in entries:
        if key != "provenance":
            yield from places(entry, (*path, key))


def with_value(saved, place, *value):
    """Write the file with another value at a place, or without it."""
    path, arrays, name, description = saved
    changed = copy.deepcopy(description)
    within = changed
    for key in place[:-1]:
        within = within[key]
    del within[place[-1]]
    if value:
        within.insert(0, *value) if isinstance(within, list) else within.update({place[-1]: value[0]})
    np.savez(path, **{**arrays, name: json.dumps(changed)})
    return path


def load_and_use(path):
    """Use everything that a description determines; errors name the file."""
    made = voxflat.load(path) if "map" in str(voxflat.atlases.certified.saved_kind(path)) else voxflat.load_atlas(path)
    made.save(path.with_name("again.npz"), overwrite=True)
    assert repr(made)
    if isinstance(made, voxflat.FlatMap):
        assert made.distortion.table()
        assert voxflat.cite(made).text
        assert json.dumps(made.description(), allow_nan=False)


@pytest.mark.slow
def test_no_value_of_a_description_ends_in_another_error_than_its_refusal(saved):
    """Each value is missing once, and is replaced by some hostile values in turn."""
    found = []
    for number, place in enumerate(places(saved[3])):
        for value in ((), *((HOSTILE[(number + step) % len(HOSTILE)],) for step in (0, 4))):
            path = with_value(saved, place, *value)
            try:
                load_and_use(path)
            except voxflat.InputError as error:
                if str(path) not in str(error):
                    found.append((place, value, str(error)))
            except Exception as error:
                found.append((place, value, repr(error)))
    assert found == []


WRONG = {  # values that were read without a word, or that ended in an error of Python when the map was used
    "seed": ("x", -1, 1.5, True, None, 2**64),
    "method": (3, None, []),
    "unit": ("ell", None, 2, []),
    "warnings": ("x", [3], {}, None),
    "structure": (3, []),
    "measured_on": (True, ["x"]),
    "frame": ("x", True),
    "period": (-1, 0, "x"),
    "sources": (-1, "x", 2.5),
    "points": (None, -4),
    "planarity": ("x", []),
    "sphere": ("x", 3),
    "mirrored": (1, "x"),
    "versions": ("x", {"numpy": 2}),
    "cut_names": ([3], "x"),
    "provenance": ("x", None),
    "threshold": ("x", True),
    "label": ("x", 1.5, ["x"]),
    "sheet": ("x", 0),
    "input_sha256": ("x", None),
    "axes": ("RAS", None),
    "scale": ("x", None),
    "link_lengths": ("x", 3),
    "radius": (-1, 0, "x"),
    "seed_point": (-1, [1, 2], [1, 2, -3], "x"),
    "polygon": ("x", [-1], [[1, 2]]),
    "touching_labels": ("x", [1.5]),
    "handles_cut": ("x", ["x"], [["x"]]),
    "components": (-1, None, True),
    "max_area": (0.5, "x"),
    "bound": (0.5, -1, "x", None),
    "limit": (3, {"max_angle": "x"}),
    "neighbourhood": (-1, "x"),
    "topology": ("x", {"handles": 1.5}),
    "keep": ("x", 1),
}
WRONG_SPACE = {"name": ("x", None, ["tkRAS"]), "volume": ("x", 3), "doubt": (None, 3)}
WRONG_MEASURES = {
    "relative_error": ("x", -1, [], {}, True),
    "relative_error_10mm": (-0.1, "x"),
    "pearson_r": (1.5, "x"),
    "interior": (3, "x"),
    "interior_share": (1.5, -0.1, "x"),
    "bands": (None, "x", [], [1, 2, 3], [1, 2, 3, 3], [0, 1, 2, 3], [4, 3, 2, 1], [1, 2, 3, "x"]),
    "sources": (-1, None, 1.5),
    "flipped": (-1, None, 0.5),
    "flipped_share": (1.5, -0.1),
    "voxel_size": (0, -1, "x"),
    "reference": ("x", None, []),
    "unit": ("ell", 3),
    "topology": ({}, 3, "x"),
}


WRONG_ATLAS = {
    "certificate": {"angle": (-1, 91, "x", None), "c": (0.5, -1, "x", True), "k": (0, "x")},
    "seams": {"length": (-1, "x"), "overlap": (-0.1, None)},
}
WRONG_BOUNDS = {"bound": (0.9, "x"), "certified_before": (-1, None), "measured_before": (0, []), "seams": ("x", None)}


@pytest.mark.parametrize(
    ("check", "told", "key", "value"),
    [(check_description, {key: value}, key, value) for key in WRONG for value in WRONG[key]]
    + [(check_description, {"space": {key: one}}, key, one) for key in WRONG_SPACE for one in WRONG_SPACE[key]]
    + [(check_distortion, {"raw": {key: one}}, key, one) for key in WRONG_MEASURES for one in WRONG_MEASURES[key]]
    + [
        (check_atlas, {of: {key: one}}, key, one)
        for of, kinds in WRONG_ATLAS.items()
        for key in kinds
        for one in kinds[key]
    ]
    + [(check_atlas, {key: one}, key, one) for key in WRONG_BOUNDS for one in WRONG_BOUNDS[key]],
)
def test_a_wrong_value_is_refused_by_its_key(check, told, key, value):
    with pytest.raises(voxflat.InputError) as raised:
        check(told)
    assert str(raised.value).startswith(f"its key {key!r} is {value!r} instead of ")


def test_a_file_with_a_wrong_value_is_named(tmp_path):
    for made, load, name in (
        (HILL.flatten(), voxflat.load, "metadata"),
        (HILL.patches(max_angle=20), voxflat.load_atlas, "text"),
    ):
        made.save(tmp_path / "made.npz", overwrite=True)
        with np.load(tmp_path / "made.npz") as file:
            arrays = dict(file)
        description = json.loads(str(arrays[name]))
        description.get("metadata", description)["seed"] = "x"
        np.savez(tmp_path / "made.npz", **{**arrays, name: json.dumps(description)})
        with pytest.raises(voxflat.InputError, match=r"made\.npz: its key 'seed' is 'x' instead of a whole number"):
            load(tmp_path / "made.npz")


@pytest.mark.parametrize(
    ("key", "values"),
    {
        "geodesic": ("x", None, 3, []),
        "link_lengths": ("x", 3),
        "points": (-441, 0, 4.5, "441", True, None),
        "sources": (-5, 0, [], 10**30),
        "fingerprint": ("x", 3, "", None),
        "ids_sha256": ("x", 3, None, "0" * 63),
    }.items(),
)
def test_a_store_with_a_wrong_value_is_named(tmp_path, key, values):
    HILL.geodesic(5, store=tmp_path / "rows")
    path = tmp_path / "rows" / "store.json"
    described = json.loads(path.read_text())
    for value in values:
        path.write_text(json.dumps({**described, key: value}))
        with pytest.raises(
            voxflat.InputError, match=rf"store\.json.*({key}|sources and 441 points).*another directory"
        ):
            voxflat.open_rows(tmp_path / "rows")
    path.write_text(json.dumps({**described, "author": "another program"}))
    assert voxflat.open_rows(tmp_path / "rows").shape == (5, 441)
