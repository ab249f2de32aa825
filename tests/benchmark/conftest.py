"""A small benchmark in a folder: prepared surfaces with their true distances."""

import numpy as np
import pytest

from voxflat.benchmark.fetch import fetch
from voxflat.benchmark.manifest import Entry, Source, chosen
from voxflat.benchmark.prepare import Prepared, write
from voxflat.benchmark.truth import truth


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Return a folder with the surface `u-shape` and its true distances."""
    folder = tmp_path_factory.mktemp("benchmark")
    entries = chosen(["u-shape"])
    assert fetch(folder, entries, print) == {}
    truth(folder, entries, 0, print)
    return folder


@pytest.fixture(scope="session")
def cube():
    """Return a closed cube: the entry, and the surface before and after it is cut into a net without distortion."""
    from developable_shapes import closed_cube

    import voxflat

    whole = voxflat.surface(closed_cube())
    opened = whole.cut("automatic").surface
    source = Source("formula", "formula", "none needed")
    entry = Entry("cube", "analytic", "a cube", "none", source, "automatic")
    faces = whole.faces.astype(np.int64), opened.faces.astype(np.int64)
    return entry, Prepared("cube", whole.points, faces[0], opened.points, faces[1], opened.core.ids.astype(np.int64))


@pytest.fixture(scope="session")
def cube_folder(cube, tmp_path_factory):
    """Return a folder with the cube and its true distances."""
    entry, made = cube
    folder = tmp_path_factory.mktemp("cube")
    write(folder / "cube", made)
    truth(folder, [entry], 0, print)
    return folder
