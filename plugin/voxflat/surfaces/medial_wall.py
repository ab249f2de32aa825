"""The medial wall: where a white and a pial surface lie on each other."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError

if TYPE_CHECKING:
    from voxflat.surfaces.manifold import Manifold

_TOUCHING = 0.3  # mm between white and pial surface; cortex is 1 to 5 mm thick
_SHARES = (0.01, 0.2)  # of a hemisphere's area that the wall may have; 7 % are usual
_CLEAR = 10  # times as large as the next such place


def is_medial_wall(region: object) -> bool:
    """Say whether a region is given by this name."""
    name = os.fspath(region) if isinstance(region, str | os.PathLike) else ""
    return name in ("medial wall", "medial-wall")


def medial_wall_of(whole: Manifold) -> NDArray[np.bool_]:
    """Find the medial wall, bool (N,): the one large place where cortex has no thickness."""
    advice = "give its label as the region to drop, or leave it out"
    if whole.thickness is None:
        raise InputError(f"the medial wall is where white and pial surface touch: give pial, too; or {advice}")
    touching = whole.thickness[whole.vertices] < _TOUCHING
    corners = np.asarray(np.asarray(touching[whole.faces]).all(axis=1))
    if not corners.any():
        raise InputError(f"white and pial surface touch nowhere, so the medial wall is not found: {advice}")
    places = whole.core.part_of_faces(corners)
    areas = [place["area"] for place in places.topology()["components"]]
    share = areas[0] / sum(piece["area"] for piece in whole.core.topology()["components"])
    if not _SHARES[0] <= share <= _SHARES[1] or (len(areas) > 1 and areas[1] * _CLEAR > areas[0]):
        raise InputError(
            f"white and pial surface touch in {len(areas)} places, the largest {100 * share:.1f} % of the surface: "
            f"that is not clearly the medial wall; {advice}"
        )
    wall = np.zeros(whole.count, dtype=np.bool_)
    wall[places.largest_piece().ids] = True
    return np.asarray(wall[whole.vertices])
