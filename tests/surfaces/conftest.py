"""Provide fsaverage5's white surface and its flat map, which several test files share."""

import anatomy
import numpy as np
import pytest

import voxflat
from voxflat.methods import Voxflat


@pytest.fixture(scope="session")
def fsaverage():
    pytest.importorskip("nilearn")
    return anatomy.fsaverage5("left")


@pytest.fixture(scope="session")
def white(fsaverage):
    return fsaverage["white"], fsaverage["faces"]


@pytest.fixture(scope="session")
def shipped(fsaverage):
    """Return FreeSurfer's flat map of the same vertices."""
    places, faces = fsaverage["flat"]
    return np.nan_to_num(places), faces


@pytest.fixture(scope="session")
def flat_map(white, shipped):
    return voxflat.surface(white).keep(shipped).flatten(Voxflat(sources=150))
