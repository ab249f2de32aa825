"""The method "saucan2006": a map that is glued of certified patches (Appleboim, Saucan, Zeevi 2006)."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress
from voxflat.atlases.certified import patches
from voxflat.errors import InputError
from voxflat.surfaces.surface import Surface

BOUND = 1.5
_ANGLE = 10.0  # of the patches, degrees, as in the paper's first figures


def checked_bound(bound: float | None) -> float:
    """Return the bound on C, or its default."""
    bound = BOUND if bound is None else bound
    if not (isinstance(bound, Real) and not isinstance(bound, bool) and 1 < bound <= 10):
        raise InputError(f"bound is {bound!r}; give a number above 1, up to 10: how much lengths may change at most")
    return float(bound)


def glued_whole(
    part: Surface, bound: float, threads: int | None, progress: Progress | None
) -> tuple[Surface, NDArray[np.float64], dict[str, Any]]:
    """Flatten a surface in patches, and glue them to one piece.

    Parameters
    ----------
    part : Surface
        What is flattened, in one piece.
    bound : float
        The greatest max(σ1, 1/σ2) of a triangle.
    threads, progress
        As in `voxflat.flatten`.

    Returns
    -------
    part : Surface
        The same, cut open where seams could not be closed.
    uv : ndarray, shape (N, 2)
        The places of its vertices, mm.
    told : dict
        The figures of gluing.

    Raises
    ------
    InputError
        If there remains more than one piece.
    """
    # C of a projection is 1/cos of the angle; patches must be within the bound before they are glued
    angle = min(_ANGLE, max(0.999 * math.degrees(math.acos(1 / bound)), 0.01))
    glued = patches(part, angle, threads=threads, progress=progress).glue(bound, threads=threads, progress=progress)
    if len(glued) > 1:
        raise InputError(
            f"the patches cannot be glued to one piece within C ≤ {bound:g}: {len(glued)} remain. Give a greater bound,"
            " take a smaller patch, or keep the pieces: voxflat.patches(...).glue(...)"
        )
    opened = part.with_core(part.core.cut(glued.cuts.tolist())) if len(glued.cuts) else part
    uv = np.empty((len(opened), 2))
    uv[opened.faces] = glued.uv[glued.corners]
    assert np.array_equal(uv[opened.faces], glued.uv[glued.corners]), "the surface is cut where the piece is"
    figures = glued.figures()
    return opened, uv, {name: figures[name] for name in ("patches", "seams", "before", "measured")}
