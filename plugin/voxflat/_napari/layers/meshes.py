"""From napari's Surface layers to meshes in RAS+ mm."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from napari.layers import Surface
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace, moved
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, named_structure
from voxflat.io.spaces import UNKNOWN, Space

_ELSEWHERE = frozenset({"inflated", "veryinflated", "sphere", "flat"})


@dataclass(frozen=True, eq=False)
class LayerMesh:
    """A Surface layer's triangles, values and place, read in the GUI's thread, for any other: the layer may change."""

    vertices: NDArray[Any] = field(repr=False)  # (V, 3), in data coordinates
    faces: NDArray[Any] = field(repr=False)
    values: NDArray[Any] = field(repr=False)  # (V,); napari gives each 1 where there are none
    place: LayerPlace
    structure: str | None = None

    @classmethod
    def of(cls, layer: Surface, world: str = "RAS") -> "LayerMesh":
        """Take a Surface layer; raises InputError unless it has triangles in space, in lengths, a value a vertex."""
        vertices, faces, values = (np.asarray(part) for part in layer.data)
        if values.ndim > 1:
            raise InputError(
                f"layer '{layer.name}' has {values.ndim} axes of values: give one value a vertex, e.g. "
                "layer.vertex_values = layer.vertex_values[0]"
            )
        place = LayerPlace.of(layer, world)
        if faces.ndim != 2 or faces.shape[1] != 3:
            corners = f"{faces.shape[1]} corners" if faces.ndim == 2 else f"shape {faces.shape}"
            raise InputError(f"the faces of layer '{layer.name}' have {corners} instead of 3: triangulate it first")
        if len(values) != len(vertices):
            raise InputError(f"layer '{layer.name}' has {len(values)} values at {len(vertices)} vertices")
        told = layer.metadata.get("structure")
        named = None if place.path is None else named_structure(place.path)
        structure = told if isinstance(told, str) else named
        return cls(vertices, faces, values, place, structure)

    @property
    def origin(self) -> dict[str, str]:
        """For the map's metadata: the layer's name, the world's axes, the unit of length."""
        return self.place.origin

    def read(self) -> Mesh:
        """Carry the vertices to RAS+ mm, or InputError; triangles that are mirrored on the way are turned over."""
        affine = self.place.affine
        is_mirrored = np.linalg.det(affine[:3, :3]) < 0
        faces = self.faces[:, ::-1] if is_mirrored else self.faces
        space = UNKNOWN if self.place.is_in_pixels else Space("scanner")
        return Mesh(moved(self.vertices, affine), faces, self.place.path, self.structure, space=space)

    def kept(self) -> NDArray[np.bool_]:
        """Return which vertices have a value, neither 0 nor NaN; raises InputError if none has."""
        kept = np.nan_to_num(self.values) != 0
        if not kept.any():
            raise InputError(f"layer '{self.origin['layer']}' has no value that is not 0: choose another patch")
        return np.asarray(kept)


def vary(values: NDArray[Any]) -> bool:
    """Whether values differ from each other, NaN aside."""
    known = values[values == values]
    return bool(known.size and (known != known[0]).any())


def surface_name(layer: Surface) -> str:
    """Return what a layer's surface is called: its file (lh.white), of values the one they lie on, or the layer."""
    path = layer.metadata.get("surface_file") or layer.source.path
    return Path(path).name if path else str(layer.name)


def is_elsewhere(name: str) -> bool:
    """Tell by a file's name whether its surface lies elsewhere than in the head, as the inflated one."""
    return not _ELSEWHERE.isdisjoint(re.split(r"[._]", name.lower().replace("very_inflated", "inflated")))
