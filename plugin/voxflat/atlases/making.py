"""Make an atlas of certified patches from a surface of any topology."""

from dataclasses import replace
from typing import Any

import numpy as np

from voxflat.arguments import Progress, checked_choice, checked_seed, checked_threads, is_number, is_whole, log, shown
from voxflat.atlases.certified import Certificate, FlatAtlas
from voxflat.errors import InputError
from voxflat.surfaces.manifold import Manifold

MAX_ANGLE = 10.0  # default greatest angle between a triangle and the plane of its patch, degrees
SEEDS = ("curvature", "flattest", "random")  # ways to start patches
_MEASURED = ("tilt", "area", "isometric", "quasi_conformal")


def patches(
    whole: Manifold,
    limits: dict[str, float | None],
    seeds: str,
    seed: int,
    threads: int | None,
    progress: Progress | None,
) -> FlatAtlas:
    """Flatten a surface in certified patches; see `voxflat.Surface.patches`."""
    limit, value = _limit(limits)
    checked_choice(seeds, "seeds", SEEDS)
    seed = checked_seed(seed)
    threads = checked_threads(threads)
    result = whole.core.patches(limit, value, seeds, seed, threads, progress)
    parts = result["patches"]
    faces, labels = whole.faces.astype(np.int64), result["labels"].astype(np.int64)
    starts = np.cumsum([0, *(len(part["vertices"]) for part in parts)])
    vertices = np.concatenate([part["vertices"] for part in parts]).astype(np.int64)
    count = int(vertices.max()) + 1  # vertices, and so keys, are sorted within each patch
    keys = np.repeat(np.arange(len(parts)), np.diff(starts)) * count + vertices
    atlas = FlatAtlas(
        points=whole.points,
        faces=faces,
        ids=whole.ids,
        piece_ids=labels,
        patch_ids=labels,
        stretch=result["stretch"],
        certificate=Certificate(*result["certificate"]),
        starts=starts,
        vertex_ids=vertices,
        uv=np.concatenate([part["uv"] for part in parts]),
        uv_faces=np.searchsorted(keys, labels[:, None] * count + faces),
        planes=np.stack([part["plane"] for part in parts]),
        measured=np.array([[part[name] for name in _MEASURED] for part in parts]),
        origin=whole.origin,
        details={"method": "saucan2006", "limit": {limit: value}, "seeds": seeds, "seed": seed},
    )
    warnings = list(whole.warnings)
    if broken := int(atlas.broken.sum()):
        text = f"{broken} very thin triangles exceed the certificate because of rounding errors. Remesh the surface"
        warnings.append(text)
    for warning in warnings:
        log.warning(warning)
    return replace(atlas, warnings=tuple(warnings))


def _limit(limits: dict[str, Any]) -> tuple[str, float]:
    """Return the name (as in the core) and the value of the limit on patches."""
    limit = {name: value for name, value in limits.items() if value is not None}
    if len(limit) > 1:
        raise InputError(f"{' and '.join(limit)} cannot be combined. Pass only one of max_angle, bound and count")
    if not limit:
        return "angle", MAX_ANGLE
    name, value = next(iter(limit.items()))
    fits, what = (is_whole, "a whole number") if name == "count" else (is_number, "a number")
    if not fits(value):
        raise InputError(f"{name} is {shown(value)}. Pass {what}")
    number = float(value)
    if name == "count" and not 1 <= number < 2**32:
        raise InputError(f"count is {value}. Pass a positive whole number")
    return "angle" if name == "max_angle" else name, number
