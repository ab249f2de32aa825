"""The command `voxflat group-map`."""

import json

import numpy as np
import pytest
from command_line import fail, succeed

import voxflat

HILL = voxflat.samples.hill()


@pytest.fixture
def people(tmp_path):
    files = [tmp_path / f"sub-{number}.surf.gii" for number in range(3)]
    for height, file in zip((0.5, 1.0, 1.5), files, strict=True):
        voxflat.io.write_mesh(file, voxflat.io.Mesh(HILL.points * [1, 1, height], HILL.faces))
    return files


@pytest.mark.medium
def test_the_command_makes_the_map_of_the_function_and_prints_the_people(people, tmp_path):
    output = tmp_path / "group.npz"
    text = succeed("group-map", *people, "-o", output).stdout
    found, expected = voxflat.load(output), voxflat.flatten_group(people)
    assert np.array_equal(found.uv, expected.uv)
    for row in expected.metadata["people"]:
        assert f"{100 * row['relative_error']:.1f}" in text
        assert row["surface"] in text
    told = json.loads(succeed("group-map", *people, "--json", "-o", output, "--overwrite").stdout)
    assert told["people"] == expected.metadata["people"]
    spread = tmp_path / "spread.npy"
    succeed("image", output, "--heat-map", "--of", "spread", "--pixel-size", "1", "-o", spread)
    np.testing.assert_allclose(np.load(spread), expected.heat_map(1.0, of="spread").data, rtol=1e-6)
    succeed("image", output, "--heat-map", "--of", "spread", "-o", tmp_path / "spread.png")
    fail(2, "--of requires --heat-map", "image", output, "--volume", people[0], "--of", "spread", "-o", spread)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ("0,0,0", "--weights is 0.0, 0.0, 0.0. Pass one positive number for each of 3 surfaces"),
        ("1,-1,1", "--weights is 1.0, -1.0, 1.0. Pass one positive number for each of 3 surfaces"),
        ("1,2", "--weights is 1.0, 2.0. Pass one positive number for each of 3 surfaces"),
    ],
)
def test_wrong_weights_are_refused(people, tmp_path, weights, message):
    fail(1, message, "group-map", *people, "--weights", weights, "-o", tmp_path / "group.npz")


def test_a_wrong_partner_is_named(people, tmp_path):
    wrong = tmp_path / "other.surf.gii"
    voxflat.io.write_mesh(wrong, voxflat.io.Mesh(np.eye(3), [[0, 1, 2]]))
    told = "surface 2 (other.surf.gii) has 3 vertices, but surface 1 (sub-0.surf.gii) has 441"
    fail(1, told, "group-map", people[0], wrong, "-o", tmp_path / "group.npz")
