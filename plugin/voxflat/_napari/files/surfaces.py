"""Read surfaces, and find the surface to which a values file belongs."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.meshes import is_elsewhere
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
    layer_name: str | None = None  # of an open surface
    warnings: tuple[str, ...] = ()  # of the reader, which belong to the warnings about a map

    @classmethod
    def read(cls, path: Path) -> "Geometry":
        mesh = read_mesh(path)
        made = cls(mesh.space.to_scanner(mesh.points), mesh.faces, mesh.structure, path, mesh.space)
        return replace(made, warnings=mesh.warnings)

    @property
    def name(self) -> str:
        """The name for messages: that of the layer, or of the file."""
        return repr(self.layer_name) if self.path is None else self.path.name

    def fits(self, other: "Geometry") -> bool:
        """Return whether another surface may have the same mesh."""
        return len(self.vertices) == len(other.vertices) and _agree(self._side, other._side)

    @property
    def _side(self) -> str | None:
        return self.structure or _side(self.path)

    def layer(self, path: Path, values: NDArray[Any] | None = None, **keywords: Any) -> LayerData:
        """Return a layer for a file on this surface; the values have shape (V,) or (K, V)."""
        about = {"structure": self.structure, "coordinates": str(self.space), **keywords.pop("metadata", {})}
        about["surface_file"] = None if self.path is None else str(self.path)  # none if it is only a layer
        if self.warnings:
            about["warnings"] = self.warnings
        data = (self.vertices, self.faces, *([] if values is None else [values]))
        given = {"name": path.name, "shading": "smooth", "units": ("mm",) * 3, **keywords}
        return data, {**given, "metadata": about}, "surface"


def geometries_for(path: Path, *, has_size: bool) -> Iterator[Geometry]:
    """Yield surfaces for a values file: open ones, then nearby files.

    Open ones from nearby files come first, and hidden ones last, so that values are not put on a surface that the user
    has hidden. Other open ones come after nearby files if the values file does not have the size of its surface.
    """
    files, opened = _beside(path), _fitting(path, visible=True)
    near = sorted((one for one in opened if one.path in files), key=lambda one: files.index(one.path or path))
    others = [one for one in reversed(opened) if one.path not in files]
    yield from (*near, *others) if has_size else near
    for file in files[:_TRIED]:
        try:
            yield Geometry.read(file)
        except (InputError, OSError):  # the file may not be a surface despite its name
            continue
    yield from () if has_size else others
    yield from reversed(_fitting(path, visible=False))


def tell_choice(path: Path, chosen: Geometry) -> None:
    """Tell on which surface the values of a file are shown, if a visible surface could have been meant instead."""
    from napari.utils.notifications import show_info

    others: list[Geometry] = []
    for one in _fitting(path, visible=True):
        is_fitting = chosen.layer_name is None or len(one.vertices) == len(chosen.vertices)
        if is_fitting and not any(np.array_equal(one.vertices, other.vertices) for other in [chosen, *others]):
            others.append(one)
    if not others:
        return
    listed = ", ".join(f"'{one.layer_name}'" for one in others)
    if chosen.layer_name is None:
        show_info(f"{path.name} is shown on {chosen.path}, a surface from a file near it, instead of {listed}")
        return
    why = (
        "whose file is near it and has the most similar name" if chosen.path in _beside(path) else "the last one opened"
    )
    show_info(f"{path.name} is shown on '{chosen.layer_name}', {why}. It also fits {listed}")


def _fitting(path: Path, *, visible: bool) -> list[Geometry]:
    """Return the open surfaces that are not of the other hemisphere."""
    return [one for one in _open(visible=visible) if _agree(_side(path), one._side)]


def open_geometries() -> list[Geometry]:
    """Return the surfaces in the viewer, in world coordinates, the last ones first, and hidden ones after others."""
    return [*reversed(_open(visible=True)), *reversed(_open(visible=False))]


def anatomical_first(geometries: list[Geometry]) -> list[Geometry]:
    """Return surfaces, those that are not in anatomical position last."""
    return sorted(geometries, key=lambda one: is_elsewhere("" if one.path is None else one.path.name))


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
            path = about.get("surface_file", layer.source.path)
            vertices = moved(np.asarray(layer.vertices), data_to_world(layer))
            file = Path(path) if path else None
            given = about.get("structure"), file, UNKNOWN, layer.name, tuple(about.get("warnings", ()))
            found.append(Geometry(vertices, np.asarray(layer.faces), *given))
    return found
