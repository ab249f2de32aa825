"""Seed points: the middle of a geodesic disk, which users give near the surface rather than on it."""

from __future__ import annotations

from typing import Any

from voxflat.arguments import array_of
from voxflat.errors import InputError

_FAR = 2.0  # voxels between a seed point and the surface that need no remark


def seed_voxel(seed_point: object) -> list[int]:
    """Return a seed point as voxel indices."""
    place = array_of(seed_point, "indices of the seed point")
    if place.shape != (3,) or place.dtype.kind not in "ui":
        raise InputError(
            f"the seed point must be whole voxel indices of shape (3,), not {place.dtype} of {place.shape}"
        )
    return [int(index) for index in place]


def found_seed(seed_point: list[int], voxel: Any, distance: float, voxel_size: float) -> list[str]:
    """Return a remark if the surface voxel that stands for a seed point lies farther away, mm, than two voxels."""
    if distance <= _FAR * voxel_size:
        return []
    return [
        f"the seed point {seed_point} is {distance:.1f} mm away from the surface; its nearest voxel {voxel} is taken"
    ]
