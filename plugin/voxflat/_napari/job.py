"""One flattening: what is asked for, and the way from volumes and meshes to layers."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.sampled import Overlay, Shown
from voxflat._napari.layers.seed import Seed
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.results.flat_layers import FlatLayers
from voxflat._napari.results.maps import map_layers
from voxflat._napari.results.pages import page_layers
from voxflat.arguments import Progress
from voxflat.atlases.making import patches
from voxflat.errors import Cancelled
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.flatten import flatten
from voxflat.surfaces.making import surface


@dataclass(frozen=True, eq=False)
class Job:
    """All that a flattening needs; it knows no layer, so it runs in any thread.

    Parameters
    ----------
    surface : LayerVolume or LayerMesh
        The volume whose surface is flattened, or the surface itself.
    method, label, threshold, seed_point, radius
        As in `voxflat.flatten`.
    keep : LayerVolume, ndarray or None
        As there; of a volume a mask of its shape.
    polygon : ndarray, shape (k, 3), or None
        Corners, RAS+ mm; the nearest places of the surface are meant.
    pial : LayerMesh or None
        As in `voxflat.surface`.
    options : mapping
        The method's other options.
    pixel_size : float or None
        As in `FlatMap.image`, mm.
    shown : Sampled, Overlay or None
        What the map shows.
    values : Overlay or None
        A mesh's own values, which its flat surface has too.
    start : FlatMap or None
        The map to go on from, as in `voxflat.flatten`.
    """

    surface: LayerVolume | LayerMesh
    method: str = "voxflat"
    label: int | None = None
    threshold: float | None = None
    keep: LayerVolume | NDArray[Any] | None = None
    seed_point: Seed | None = None
    radius: float | None = None
    polygon: NDArray[np.float64] | None = None
    pial: LayerMesh | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    pixel_size: float | None = None
    shown: Shown | None = None
    values: Overlay | None = None
    start: FlatMap | None = None

    def run(self, progress: Progress) -> FlatLayers:
        """Flatten.

        Parameters
        ----------
        progress : callable
            As in `voxflat.flatten`.

        Returns
        -------
        FlatLayers

        Raises
        ------
        InputError, Cancelled
            As in `voxflat.flatten`.
        """
        _tell(progress, "reading the layer")
        flat_map = self._flatten(progress)
        flat_map = replace(flat_map, metadata={**flat_map.metadata, "napari": self.surface.origin})
        _draw(progress, "map")
        return map_layers(flat_map, self.surface.origin["layer"], self.shown, self.values, self.pixel_size)

    def _flatten(self, progress: Progress) -> FlatMap:
        source: Any = self.surface.read()
        foreground: dict[str, Any] = {"label": self.label, "threshold": self.threshold}
        place: dict[str, Any] = {"seed_point": self.seed_point, "radius": self.radius}
        place["keep"] = self.keep.read() if isinstance(self.keep, LayerVolume) else self.keep
        if self.pial is not None or self.polygon is not None:
            pial = None if self.pial is None else self.pial.read()
            source, foreground = surface(source, **foreground, pial=pial, progress=progress), {}
        if self.polygon is not None:
            _, nearest = scipy.spatial.cKDTree(source.points).query(self.polygon)
            place["polygon"] = source.ids[nearest]
        if self.start is not None:
            place["start"] = self.start
        return flatten(source, method=self.method, **foreground, **place, **self.options, progress=progress)


@dataclass(frozen=True, eq=False)
class PatchesJob:
    """All that flattening in patches needs; it knows no layer, so it runs in any thread.

    Parameters
    ----------
    surface : LayerVolume or LayerMesh
        The volume whose surface is flattened, or the surface itself.
    limit : dict
        One of ``max_angle``, ``bound`` and ``count``, as in `voxflat.patches`.
    label, threshold
        As in `voxflat.patches`.
    glue : float or None
        Within which bound on C the patches are glued, if they are, as in `FlatAtlas.glue`.
    pixel_size : float or None
        As in `Atlas.image`, mm.
    shown : Sampled, Overlay or None
        What the page shows.
    """

    surface: LayerVolume | LayerMesh
    limit: dict[str, Any]
    label: int | None = None
    threshold: float | None = None
    glue: float | None = None
    pixel_size: float | None = None
    shown: Shown | None = None

    def run(self, progress: Progress) -> FlatLayers:
        """Flatten in patches.

        Parameters
        ----------
        progress : callable
            As in `voxflat.patches`.

        Returns
        -------
        FlatLayers

        Raises
        ------
        InputError, Cancelled
            As in `voxflat.patches`.
        """
        _tell(progress, "reading the layer")
        source = self.surface.read()
        atlas = patches(source, label=self.label, threshold=self.threshold, progress=progress, **self.limit)
        atlas.metadata["napari"] = self.surface.origin
        glued = None if self.glue is None else atlas.glue(self.glue, progress=progress)
        _draw(progress, "page")
        return page_layers(atlas if glued is None else glued, self.shown, self.pixel_size)


def _draw(progress: Progress, what: str) -> None:
    """Go on to drawing, and have imported what the dock will draw with: later the window waits for Python's lock."""
    _tell(progress, f"drawing the {what}")
    importlib.import_module("voxflat.figures")


def _tell(progress: Progress, stage: str) -> None:
    if progress(stage, 0, 1) is False:
        raise Cancelled(f"cancelled while {stage}")
