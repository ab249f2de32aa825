"""What takes long while cuts are drawn, and is done in another thread: the surface, cuts to begin with, their gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat.arguments import Progress
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.cutting import Where, cut_open, sketch_error
from voxflat.surfaces.standard.sphere import sphere_beside
from voxflat.unique_rows import in_rows

Found: TypeAlias = tuple[list[NDArray[np.int64]], list[str], NDArray[np.int64]]
"""Cuts, by what their vertices are in the input, their names, and what is left out."""


@dataclass(frozen=True, eq=False)
class MakeSurface:
    """Makes the surface that cuts are drawn on."""

    source: LayerVolume | LayerMesh
    foreground: dict[str, Any]

    def run(self, progress: Progress) -> tuple[Surface, NDArray[np.float64]]:
        """Make it; return its mean curvature, 1/mm, too."""
        made = surface(self.source.read(), **self.foreground, progress=progress)
        return made, made.mean_curvature(progress=progress)


@dataclass(frozen=True, eq=False)
class FindCuts:
    """Finds cuts to begin with: "standard", "automatic" or those of a file."""

    surface: Surface
    by: str

    def run(self, progress: Progress) -> Found:
        """Find them."""
        found = self.surface.cut(self.by, progress=progress)
        names = [one.name or f"cut {number}" for number, one in enumerate(found.cuts, 1)]
        return [one.ids for one in found.cuts], names, found.left_out


@dataclass(frozen=True, eq=False)
class CutsOfMap:
    """Finds the cuts that a map was made with, and what it leaves out of the whole surface."""

    surface: Surface
    flat_map: FlatMap

    def run(self, progress: Progress) -> Found:
        """Find them."""
        told = self.flat_map.metadata
        paths = [np.asarray(path, dtype=np.int64) for path in told.get("cuts") or []]
        names = [name or f"cut {number}" for number, name in enumerate(told.get("cut_names") or [None] * len(paths), 1)]
        further = told.get("automatic_cuts") or []
        names += [f"cut {number}" for number in range(len(paths) + 1, len(paths) + len(further) + 1)]
        paths += [np.asarray(cut["ids"], dtype=np.int64) for cut in further]
        shown, every = self.flat_map.ids[np.unique(self.flat_map.faces)], self.surface.ids
        return paths, names, every[~in_rows(every, shown)]


@dataclass(frozen=True, eq=False)
class SaveTemplate:
    """Turns cuts into a template for every brain, by the surface's sphere, or by its folds where it has none."""

    surface: Surface
    paths: Sequence[NDArray[np.int64]]  # as `cuts` of `Surface.cut`
    names: Sequence[str]
    left_out: NDArray[np.int64]  # as for `Surface.drop`; empty for nothing
    file: Path

    def run(self, progress: Progress) -> Path:
        """Write it; return the file."""
        sphere = sphere_beside(self.surface) or self.surface.register(progress=progress)
        part = self.surface.drop(self.left_out) if len(self.left_out) else self.surface
        found = part.cut(list(self.paths), sphere=sphere, relax=False, progress=progress)
        named = [replace(one, name=name) for one, name in zip(found.cuts, self.names, strict=False)]
        replace(found, cuts=(*named, *found.cuts[len(named) :])).save_template(self.file, overwrite=True)
        return self.file


@dataclass(frozen=True, eq=False)
class WeighCuts:
    """Says what each cut is worth; fields are as of `SaveTemplate`."""

    surface: Surface
    paths: Sequence[NDArray[np.int64]]
    left_out: NDArray[np.int64]

    def run(self, progress: Progress) -> tuple[float, list[float]]:
        """Return the mean relative error of distances in a sketch, and how much greater it is without each cut."""
        with_all = self._error(self.paths, progress)
        others = [[path for path in self.paths if path is not left_out] for left_out in self.paths]
        return with_all, [self._error(paths, progress) - with_all for paths in others]

    def _error(self, paths: Sequence[NDArray[np.int64]], progress: Progress) -> float:
        part = self.surface.drop(self.left_out) if len(self.left_out) else self.surface
        opened = cut_open(part, Where(list(paths) or "automatic", relax=False), progress=progress)
        return sketch_error(opened.part, None, progress)
