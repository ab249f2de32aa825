"""Read surfaces, and find the surface to which a values file belongs."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.world import data_to_world, moved
from voxflat._napari.results.flat_layers import LayerData
from voxflat.errors import InputError
from voxflat.io.meshes import named_structure, read_mesh
from voxflat.io.spaces import UNKNOWN, Space

# the surfaces for a values file, in order of preference; surfaces that are not in anatomical position come last
_KINDS = ("white", "midthickness", "pial", "graymid", "smoothwm", "orig", "inflated")
_TRIED = 12  # largest number of files that are tried, because a directory may contain many surfaces


@dataclass(frozen=True, eq=False)
class Geometry:
    """A surface on which values are shown, in scanner RAS and mm."""

    vertices: NDArray[Any]
    faces: NDArray[Any]
    structure: str | None  # the hemisphere, as in GIFTI
    path: Path | None
    space: Space = UNKNOWN  # the space of the coordinates in the file

    @classmethod
    def read(cls, path: Path) -> "Geometry":
        mesh = read_mesh(path)
        return cls(mesh.space.to_scanner(mesh.points), mesh.faces, mesh.structure, path, mesh.space)

    def layer(self, path: Path, values: NDArray[Any] | None = None, **keywords: Any) -> LayerData:
        """Return a layer for a file on this surface; the values have shape (V,) or (K, V)."""
        about = {"structure": self.structure, "coordinates": str(self.space), **keywords.pop("metadata", {})}
        if self.path is not None:
            about["surface_file"] = str(self.path)
        data = (self.vertices, self.faces, *([] if values is None else [values]))
        given = {"name": path.name, "shading": "smooth", "units": ("mm",) * 3, **keywords}
        return data, {**given, "metadata": about}, "surface"


def surface_layers(path: Path) -> list[LayerData]:
    """Read a surface as a layer in scanner RAS and mm; raises InputError if the file is damaged."""
    return [Geometry.read(path).layer(path)]


def geometries_for(path: Path) -> Iterator[Geometry]:
    """Yield surfaces for a values file: open ones from nearby files, then other nearby files, then other open ones.

    Hidden surfaces come last, so that the values are not put on a surface that the user has hidden.
    """
    files = _beside(path)
    opened, hidden = (
        [one for one in _open(visible=visible) if _agree(_side(path), one.structure or _side(one.path))]
        for visible in (True, False)
    )
    yield from (one for one in opened if one.path in files)
    for file in files[:_TRIED]:
        try:
            yield Geometry.read(file)
        except (InputError, OSError):  # the file may not be a surface despite its name
            continue
    yield from (one for one in reversed(opened) if one.path not in files)
    yield from reversed(hidden)


def _beside(path: Path) -> list[Path]:
    """Return nearby surface files of the same hemisphere, those with the most similar names first."""
    words = _words(path)
    folders = [path.parent] + [path.parent.parent / "surf"] * (path.parent.name == "label")  # FreeSurfer's layout
    files = [file for folder in folders if folder.is_dir() for file in folder.iterdir() if _is_surface(file)]
    fitting = [file for file in files if file != path and _agree(_side(path), _side(file))]
    return sorted(fitting, key=lambda file: (len(words ^ _words(file)), _rank(file), file.name))


def _is_surface(path: Path) -> bool:
    name = path.name.lower()
    if name.endswith((".surf.gii", ".surf.gii.gz")):
        return True
    is_gifti = name.endswith((".gii", ".gii.gz")) and not _words(path).isdisjoint(_KINDS)
    return is_gifti or re.fullmatch(rf"[lr]h\.({'|'.join(_KINDS)})", name) is not None


def _words(path: Path) -> set[str]:
    return set(re.split(r"[._]", path.name.lower()))


def _rank(path: Path) -> int:
    return next((n for n, kind in enumerate(_KINDS) if kind in _words(path)), len(_KINDS))


def _side(path: Path | None) -> str | None:
    """Return the hemisphere that a file name indicates; the names used by nilearn are also recognised."""
    if path is None:
        return None
    named = {"left": "CortexLeft", "right": "CortexRight"}
    return named_structure(path) or next((named[word] for word in sorted(_words(path) & set(named))), None)


def _agree(side: str | None, other: str | None) -> bool:
    return side is None or other is None or side == other


def _open(*, visible: bool) -> list[Geometry]:
    """Return the visible or the hidden surfaces of the viewer, in world coordinates."""
    from napari import current_viewer
    from napari.layers import Surface

    viewer, found = current_viewer(), []
    for layer in [] if viewer is None else viewer.layers:
        about = layer.metadata
        if isinstance(layer, Surface) and (layer.ndim, layer.visible) == (3, visible) and "voxflat" not in about:
            path = about.get("surface_file") or layer.source.path
            vertices = moved(np.asarray(layer.vertices), data_to_world(layer))
            file = Path(path) if path else None
            found.append(Geometry(vertices, np.asarray(layer.faces), about.get("structure"), file))
    return found
