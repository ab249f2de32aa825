"""Conversion of napari's Surface layers to meshes in RAS+ mm."""

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
    """The mesh of a Surface layer, read in the GUI thread for use in others, because the layer may change."""

    vertices: NDArray[Any] = field(repr=False)  # (V, 3), in data coordinates
    faces: NDArray[Any] = field(repr=False)
    values: NDArray[Any] = field(repr=False)  # (V,); all 1 in a layer without values
    place: LayerPlace
    structure: str | None = None

    @classmethod
    def of(cls, layer: Surface, world: str = "RAS") -> "LayerMesh":
        """Read a Surface layer; raises InputError unless it is 3D, in lengths, with triangles and values."""
        vertices, faces, values = (np.asarray(part) for part in layer.data)
        if values.ndim > 1:
            raise InputError(
                f"Layer '{layer.name}' has {values.ndim} axes of values. Select one value per vertex, for example with "
                "layer.vertex_values = layer.vertex_values[0]"
            )
        place = LayerPlace.of(layer, world)
        if faces.ndim != 2 or faces.shape[1] != 3:
            corners = f"{faces.shape[1]} corners" if faces.ndim == 2 else f"shape {faces.shape}"
            raise InputError(f"The faces of layer '{layer.name}' have {corners} instead of 3. Triangulate the mesh")
        if len(values) != len(vertices):
            raise InputError(
                f"Layer '{layer.name}': {len(values)} values, {len(vertices)} vertices. Set one per vertex"
            )
        given = layer.metadata.get("structure")
        named = None if place.path is None else named_structure(place.path)
        structure = given if isinstance(given, str) else named
        return cls(vertices, faces, values, place, structure)

    @property
    def origin(self) -> dict[str, str]:
        """The name of the layer, the axes of the world and the unit, for the metadata of the map."""
        return self.place.origin

    def read(self) -> Mesh:
        """Convert the vertices to RAS+ mm, or InputError; triangles that a transform mirrors are flipped."""
        affine = self.place.affine
        is_mirrored = np.linalg.det(affine[:3, :3]) < 0
        faces = self.faces[:, ::-1] if is_mirrored else self.faces
        space = UNKNOWN if self.place.is_in_pixels else Space("scanner")
        return Mesh(moved(self.vertices, affine), faces, self.place.path, self.structure, space=space)

    def kept(self) -> NDArray[np.bool_]:
        """Return which vertices have a value other than 0 and NaN; raises InputError if none has."""
        kept = np.nan_to_num(self.values) != 0
        if not kept.any():
            raise InputError(f"All values of layer '{self.origin['layer']}' are 0 or NaN. Choose another part")
        return np.asarray(kept)


def vary(values: NDArray[Any]) -> bool:
    """Return whether values vary, apart from NaN."""
    known = values[values == values]
    return bool(known.size and (known != known[0]).any())


def surface_name(layer: Surface) -> str:
    """Return the name of the surface of a layer: its file, such as lh.white, or else the layer."""
    path = layer.metadata.get("surface_file") or layer.source.path
    return Path(path).name if path else str(layer.name)


def is_elsewhere(name: str) -> bool:
    """Return, by a file name, whether a surface is not in anatomical position, such as the inflated one."""
    return not _ELSEWHERE.isdisjoint(re.split(r"[._]", name.lower().replace("very_inflated", "inflated")))
