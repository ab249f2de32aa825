"""Maps that several files of tests share."""

from dataclasses import replace

import pytest
from textures import chessboard, cylinder, grid

import voxflat
from voxflat.methods import Voxflat


@pytest.fixture(scope="session")
def plane_map():
    points, faces = grid(13, 21)
    return replace(voxflat.flatten((points, faces), Voxflat(sources=100)), uv=points[:, :2])  # to be exact


@pytest.fixture(scope="session")
def cylinder_map():
    return voxflat.flatten(cylinder(), Voxflat(sources=300))


@pytest.fixture
def textured(cylinder_map):
    return cylinder_map.textured(chessboard())
