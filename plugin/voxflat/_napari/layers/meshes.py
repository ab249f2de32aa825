"""Convert napari Surface layers to meshes in RAS+ mm."""

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
    """The mesh of a Surface layer, read in the GUI thread for use in other threads because the layer may change."""

    vertices: NDArray[Any] = field(repr=False)  # (V, 3), in data coordinates
    faces: NDArray[Any] = field(repr=False)
    values: NDArray[Any] = field(repr=False)  # (V,); all 1 in a layer without values
    place: LayerPlace
    structure: str | None = None
    warnings: tuple[str, ...] = ()  # of the reader of the file

    @classmethod
    def of(cls, layer: Surface, world: str = "RAS", unit: str | None = None) -> "LayerMesh":
        """Read a Surface layer; raises InputError unless it is 3D, with triangles, length units and suitable values."""
        vertices, faces, values = (np.asarray(part) for part in layer.data)
        if values.ndim > 1:
            select = "Select one value per vertex, for example with layer.vertex_values = layer.vertex_values[0]"
            raise InputError(f"The values of layer '{layer.name}' have {values.ndim} axes. {select}")
        place = LayerPlace.of(layer, world, unit=unit)
        if faces.ndim != 2 or faces.shape[1] != 3:
            corners = f"{faces.shape[1]} corners" if faces.ndim == 2 else f"shape {faces.shape}"
            raise InputError(f"The faces of layer '{layer.name}' are not triangles ({corners}). Triangulate the mesh")
        if len(values) != len(vertices):
            counts = f"{len(values)} values for {len(vertices)} vertices"
            raise InputError(f"Layer '{layer.name}' has {counts}. Set one value per vertex")
        given, warnings = layer.metadata.get("structure"), tuple(layer.metadata.get("warnings", ()))
        named = None if place.path is None else named_structure(place.path)
        return cls(vertices, faces, values, place, given if isinstance(given, str) else named, warnings)

    @property
    def origin(self) -> dict[str, str]:
        return self.place.origin

    def read(self) -> Mesh:
        """Convert the vertices to RAS+; a mirroring transform reverses the triangles. May raise InputError."""
        affine = self.place.affine
        faces = self.faces[:, ::-1] if np.linalg.det(affine[:3, :3]) < 0 else self.faces
        space = UNKNOWN if self.origin["unit"].startswith("pixel") else Space("scanner")
        about: dict[str, Any] = {"structure": self.structure, "space": space, "warnings": self.warnings}
        return Mesh(moved(self.vertices, affine), faces, self.place.path, **about)

    def kept(self) -> NDArray[np.bool_]:
        """Return a mask of the vertices whose values are neither 0 nor NaN; raises InputError if there are none."""
        kept = np.nan_to_num(self.values) != 0
        if not kept.any():
            raise InputError(f"All values of layer '{self.origin['layer']}' are 0 or NaN. Choose another part")
        return np.asarray(kept)


def vary(values: NDArray[Any]) -> bool:
    """Return whether values vary, apart from NaN."""
    known = values[values == values]
    return bool(known.size and (known != known[0]).any())


def surface_name(layer: Surface) -> str:
    """Return the name of the surface file of a layer (such as lh.white), or the layer name if there is no file."""
    path = layer.metadata.get("surface_file", layer.source.path)
    return Path(path).name if path else str(layer.name)


def is_elsewhere(name: str) -> bool:
    """Return whether a file name indicates that a surface, such as the inflated one, is not in anatomical position."""
    return not _ELSEWHERE.isdisjoint(re.split(r"[._]", name.lower().replace("very_inflated", "inflated")))
