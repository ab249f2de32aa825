"""Which of the two a file holds: a flat map or an atlas."""

from __future__ import annotations

import os
from typing import Literal

import numpy as np


def saved_kind(path: str | os.PathLike[str]) -> Literal["map", "atlas"] | None:
    """Say what a file holds that `FlatMap.save` or an atlas wrote; None if it is neither or cannot be read."""
    try:
        with np.load(path, allow_pickle=False) as file:
            names = set(file.files)
    except Exception:  # what damage leads to is known to no one
        return None
    if {"uv", "ids", "metadata"} <= names:
        return "map"
    return "atlas" if {"uv", "uv_faces", "text"} <= names else None
