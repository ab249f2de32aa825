"""Report how much of a region has an uncertain depth, and why."""

import numpy as np
from numpy.typing import NDArray

from voxflat.io.grid import rounded

LOOSE, PLACED, APART, THICK = 1, 2, 4, 8
"""Reasons why the depth of a voxel, or of a point of the middle surface, is uncertain; they can be added."""

TOO_THICK = 2.5  # thickness, relative to the median, from which two banks may touch

_REASONS = {  # with the share of a region up to which each is usual
    THICK: (0.01, f"more than {TOO_THICK:g} times as thick as the median, so the banks of a sulcus may touch"),
    PLACED: (0.0, "between banks that touch without an outer border; one was placed halfway"),
    LOOSE: (0.0, "parts that do not touch both borders"),
    APART: (0.0, "not connected to a border through grey matter, and in no column"),
}


def warning_of(reasons: NDArray[np.uint8], region: str) -> str | None:
    """Return a warning that says how much of a region is uncertain, from the reasons at its voxels or points."""
    shares = {reason: float(((reasons & reason) > 0).mean()) for reason in _REASONS}
    found = [reason for reason, (usual, _) in _REASONS.items() if shares[reason] > usual]
    if not found:
        return None
    parts = "; ".join(f"{_percent(shares[reason])} ({_REASONS[reason][1]})" for reason in found)
    share = float(((reasons & sum(found)) > 0).mean())
    return f"the depth of {_percent(share)} of {region} is uncertain: {parts}. Check the labels there"


def _percent(share: float) -> str:
    return f"{rounded(100 * share, 1)} %"
