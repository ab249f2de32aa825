"""The method "saucan2006": a map that is glued of certified patches (Appleboim, Saucan, Zeevi 2006)."""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress
from voxflat.atlases.making import patches
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import How, map_over_triangles
from voxflat.surfaces.region import Cutout
from voxflat.surfaces.surface import Surface

__all__ = ["checked", "flatten"]

_REFERENCES = 200  # random points from which a map is judged, as the core does
_ANGLE = 10.0  # of the patches, degrees, as in the paper's first figures


def checked(bound: float) -> dict[str, float]:
    """Return the bound on C, if it can be used."""
    if not (isinstance(bound, Real) and not isinstance(bound, bool) and 1 < bound <= 10):
        raise InputError(f"bound is {bound!r}; give a number above 1, up to 10: how much lengths may change at most")
    return {"bound": float(bound)}


def _glued_whole(
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
    uv[opened.faces] = glued.uv[glued.uv_faces]
    assert np.array_equal(uv[opened.faces], glued.uv[glued.uv_faces]), "the surface is cut where the piece is"
    figures = glued.figures()
    return opened, uv, {name: figures[name] for name in ("patches", "seams", "before", "measured")}


def flatten(cut: Cutout, how: How, *, bound: float) -> FlatMap:
    """Flatten a disk in patches that are glued to one piece."""
    part, uv, told = _glued_whole(cut.part, bound, how.threads, how.progress)
    referred = _core.reference_sources(len(part), _REFERENCES, how.seed)
    judged = part.core.judge([uv], referred, "graph", 4 * _REFERENCES * len(part), how.seed, how.threads, how.progress)
    result = {
        "uv": uv,
        "normals": part.core.normals,
        "sources": np.empty(0, dtype=np.uint32),
        "eigenvalues": np.empty(0),
        "planarity": None,
        "distortion": judged[0],
    }
    faces = part.faces[: len(cut.faces)]  # holes that were closed come last
    cut = replace(cut, part=part, faces=faces, metadata={**cut.metadata, "points": len(np.unique(part.vertices))})
    seams = told["seams"]
    doubts = [f"{seams['cuts']:.0f} mm of seams between patches stay cut"] if seams["cuts"] > 0 else []
    return map_over_triangles("saucan2006", cut, how, result, 0, None, {"bound": bound, **told}, doubts)
