"""The surface of a layer: of a label, of the voxels above a threshold, or halfway between the borders of a rim."""

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat.arguments import Progress
from voxflat.laminar.rim import Rim, rim
from voxflat.pipeline.surface import Surface, surface


@dataclass(frozen=True)
class RimLabels:
    """The labels of a kind of rim."""

    text: str
    labels: frozenset[int]  # all labels of a volume of this kind
    grey: int
    hemisphere: str | None = None  # as in `voxflat.rim`


_RIBBON = frozenset({2, 3, 41, 42})
RIMS = {
    "rim": RimLabels("rim: labels 1, 2, 3", frozenset({1, 2, 3}), 3),
    "left": RimLabels("left ribbon: 2, 3", _RIBBON, 3, "left"),
    "right": RimLabels("right ribbon: 41, 42", _RIBBON, 42, "right"),
}


def rims_in(labels: Collection[int]) -> list[str]:
    """Return the kinds of rims that a volume with these labels can be."""
    return [kind for kind, one in RIMS.items() if one.labels == set(labels)]


def inside(values: NDArray[Any], label: int | None, threshold: float | None, rim: str | None) -> NDArray[np.bool_]:
    """Return a mask of the voxels that belong to a foreground."""
    if threshold is not None:
        return np.asarray(values > threshold)
    return np.asarray(values == (label if rim is None else RIMS[rim].grey))


_last: dict[tuple[str, ...], Rim] = {}
"""The rim that was made last, by a fingerprint of its voxels, because flattening and each profile need it."""


def rim_of(source: LayerVolume, kind: str, progress: Progress) -> Rim:
    """Return the rim of a layer, which is computed again only if the layer or the kind has changed."""
    volume = source.read()
    arrays = (np.ascontiguousarray(volume.data), volume.affine)
    key = (kind, str(volume.data.shape), *(hashlib.sha256(array.tobytes()).hexdigest() for array in arrays))
    found = _last.get(key)
    if found is None:
        found = rim(volume, hemisphere=RIMS[kind].hemisphere, progress=progress)
        _last.clear()
        _last[key] = found
    return found


def surface_of(source: LayerVolume | LayerMesh, progress: Progress, *, rim: str | None = None, **more: Any) -> Surface:
    """Return the surface of a layer; `rim` is a key of `RIMS`, and the other keywords are as in `voxflat.surface`."""
    if rim is None:
        unit = source.place.unit if isinstance(source, LayerMesh) and source.place.unit != "mm" else None
        return surface(source.read(), **more, unit=unit, progress=progress)
    assert isinstance(source, LayerVolume)
    return rim_of(source, rim, progress).surface
