"""The standard frame: maps of all brains turned alike, onto the flat map of fsaverage5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.standard.sphere import Sphere, in_triangles
from voxflat.surfaces.standard.template import standard_template

STANDARD_FRAME = "standard"
"""What ``metadata["frame"]`` of a map in it says."""

_FEWEST = 3  # corresponding points that settle a turn


@dataclass(frozen=True)
class Turned:
    """A map in the standard frame."""

    uv: NDArray[np.float64]  # (N, 2), mm
    anchors: int  # corresponding points by which it was turned; 0 if too few, and it is as it was
    residual: float  # root mean square distance of these from their places on the template's map, mm


def in_standard_frame(uv: NDArray[np.float64], part: Manifold, faces: NDArray[Any], sphere: Sphere) -> Turned:
    """Turn and move a map rigidly onto the flat map of fsaverage5, by points that correspond on the sphere.

    The points lie evenly on the template's map, so that each counts the same. The turn is the one of the least sum of
    squares (Schönemann 1966); nothing is scaled, nothing mirrored. Their mean comes to lie where it is on the
    template's.
    """
    anchors = standard_template(sphere.space, sphere.side).anchors
    assert anchors is not None
    corners, weights, is_inside = in_triangles(sphere.places[part.vertices], faces, anchors.sphere)
    count = int(is_inside.sum())
    if count < _FEWEST:
        return Turned(uv, 0, float("nan"))
    places = np.einsum("ij,ijk->ik", weights, uv[corners])[is_inside]
    turned, _ = _core.turn_onto(np.concatenate([uv, places]), places, anchors.flat[is_inside])
    apart = np.linalg.norm(turned[len(uv) :] - anchors.flat[is_inside], axis=1)
    return Turned(np.ascontiguousarray(turned[: len(uv)]), count, float(np.sqrt((apart**2).mean())))
