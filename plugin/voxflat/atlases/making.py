"""From a surface of any topology to an atlas: `patches`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, checked_choice, checked_seed, checked_threads, is_number, is_whole, log, shown
from voxflat.atlases.certified import Certificate, FlatAtlas
from voxflat.errors import InputError
from voxflat.io.provenance import telling
from voxflat.surfaces.making import surface as _surface

__all__ = ["MAX_ANGLE", "SEEDS", "patches"]

MAX_ANGLE = 10.0
"""Greatest inclination to a patch's plane, degrees, where no limit is given."""

SEEDS = ("curvature", "flattest", "random")
"""Where patches may begin."""


@telling
def patches(
    surface: object,
    max_angle: float | None = None,
    *,
    bound: float | None = None,
    count: int | None = None,
    seeds: str = "curvature",
    seed: int = 0,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    memory_limit: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> FlatAtlas:
    """Flatten a surface of any topology in patches with a certificate (Appleboim, Saucan, Zeevi 2006).

    Each patch is projected orthogonally onto a plane to which no triangle is inclined by more than an angle θ. Then no
    length changes by more than a factor C ≤ 1 + tan θ, nor angles by a dilatation of more than K ≤ (1 + tan θ)^1.5.
    Nothing of the surface is cut or left out: every triangle belongs to one patch, and no patch lies on itself.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, memory_limit, threads, progress
        A volume, a mesh or a Surface, as in `surface`.
    max_angle : float, optional
        θ, degrees, from 0.01 to 80; by default 10.
    bound : float, optional
        Instead of the angle the greatest C that is wanted. The angle is the largest one for which C = K = 1/cos θ, the
        exact bound of a projection, is within it: fewer patches than the formula above needs.
    count : int, optional
        Instead of the angle the number of patches that must not be exceeded, for which the smallest angle is sought.
    seeds : {"curvature", "flattest", "random"}
        Where patches begin. "curvature": candidates are grown around the flattest places, turned to where they become
        largest, and the largest is kept first; small patches are dissolved in their neighbours. The others are the
        paper's: one patch after another, on the plane of the flattest or of a random triangle.
    seed : int
        Of the random choice.

    Returns
    -------
    FlatAtlas
        The same for any numbering of vertices and triangles, but for the order of arrays.

    Raises
    ------
    InputError
        If the surface cannot be used, or an argument does not fit.
    Cancelled
        If `progress` returned False.
    """
    limit, value = _limit(max_angle, bound, count)
    checked_choice(seeds, "seeds", SEEDS)
    seed = checked_seed(seed)
    threads = checked_threads(threads)
    place: dict[str, Any] = {"label": label, "threshold": threshold, "spacing": spacing, "affine": affine}
    whole = _surface(surface, **place, memory_limit=memory_limit, threads=threads, progress=progress)
    found = whole.core.patches(limit, value, seeds, seed, threads, progress)
    parts = found["patches"]
    faces, labels = whole.faces.astype(np.int64), found["labels"].astype(np.int64)
    starts = np.cumsum([0, *(len(part["vertices"]) for part in parts)])
    vertices = np.concatenate([part["vertices"] for part in parts]).astype(np.int64)
    atlas = FlatAtlas(
        points=whole.points,
        faces=faces,
        ids=whole.ids,
        piece_ids=labels,
        patch_ids=labels,
        stretch=found["stretch"],
        certificate=Certificate(*found["certificate"]),
        starts=starts,
        vertex_ids=vertices,
        uv=np.concatenate([part["uv"] for part in parts]),
        uv_faces=_uv_faces(faces, labels, starts, vertices),
        planes=np.stack([part["plane"] for part in parts]),
        measured=np.array([[part[name] for name in _MEASURED] for part in parts]),
        metadata={
            "method": "saucan2006",
            **{name: whole.metadata[name] for name in _SURFACE if name in whole.metadata},
            "limit": {limit: value},
            "seeds": seeds,
            "seed": seed,
            "warnings": list(whole.remarks),
        },
    )
    if broken := int(atlas.broken.sum()):
        atlas.metadata["warnings"].append(
            f"{broken} triangles are so thin that rounding takes them beyond the certificate; remesh the surface"
        )
    for remark in atlas.metadata["warnings"]:
        log.warning(remark)
    return atlas


def _uv_faces(
    faces: NDArray[np.int64], labels: NDArray[np.int64], starts: NDArray[np.int64], vertices: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Find each triangle's corners among the vertices of its patch, which ascend within each patch."""
    count = int(vertices.max()) + 1
    keys = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) * count + vertices
    return np.searchsorted(keys, labels[:, None] * count + faces)


_SURFACE = ("kind", "input", "input_sha256", "affine", "shape", "sheet", "vertices", "structure", "space")
_MEASURED = ("tilt", "area", "isometric", "quasi_conformal")


def _limit(max_angle: Any, bound: Any, count: Any) -> tuple[str, float]:
    """Return what limits the patches: the core's name for it, and its value."""
    limits = {"max_angle": max_angle, "bound": bound, "count": count}
    given = {name: value for name, value in limits.items() if value is not None}
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)} are given; give one of max_angle, bound and count")
    if not given:
        return "angle", MAX_ANGLE
    name, value = next(iter(given.items()))
    fits, what = (is_whole, "a whole number") if name == "count" else (is_number, "a number")
    if not fits(value):
        raise InputError(f"{name} is {shown(value)}; give {what}")
    number = float(value)
    if name == "count" and not 1 <= number < 2**32:
        raise InputError(f"count is {value}; give a positive whole number")
    return "angle" if name == "max_angle" else name, number
