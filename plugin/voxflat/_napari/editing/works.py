"""What takes long while cuts are drawn, and is done in another thread: the surface, cuts to begin with, their gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat.arguments import Progress
from voxflat.surfaces.cut import CutSurface, cut
from voxflat.surfaces.making import surface
from voxflat.surfaces.region import cut_out, sketch_error
from voxflat.surfaces.surface import Surface


@dataclass(frozen=True, eq=False)
class MakeSurface:
    """Makes the surface that cuts are drawn on.

    Parameters
    ----------
    source : LayerVolume or LayerMesh
        What is cut.
    foreground : dict
        ``label`` and ``threshold``, as in `voxflat.flatten`.
    """

    source: LayerVolume | LayerMesh
    foreground: dict[str, Any]

    def run(self, progress: Progress) -> tuple[Surface, NDArray[np.float64]]:
        """Make it.

        Returns
        -------
        Surface
        ndarray, shape (N,)
            Its mean curvature, 1/mm.
        """
        made = surface(self.source.read(), **self.foreground, progress=progress)
        return made, made.mean_curvature(progress=progress)


@dataclass(frozen=True, eq=False)
class FindCuts:
    """Finds cuts to begin with.

    Parameters
    ----------
    surface : Surface
        What is cut.
    by : str
        "standard", "automatic" or a file of cuts.
    """

    surface: Surface
    by: str

    def run(self, progress: Progress) -> CutSurface:
        """Find them."""
        return cut(self.surface, cuts=self.by, progress=progress)


@dataclass(frozen=True, eq=False)
class WeighCuts:
    """Says what each cut is worth.

    Parameters
    ----------
    surface : Surface
        What is cut.
    paths : sequence of array_like
        As `cuts` of `voxflat.flatten`.
    """

    surface: Surface
    paths: Sequence[NDArray[np.int64]]

    def run(self, progress: Progress) -> tuple[float, list[float]]:
        """Sketch the map with all cuts, and without each.

        Returns
        -------
        float
            Mean relative error of distances in a sketch of the map with all cuts.
        list of float
            How much greater it is without each of them.
        """
        with_all = self._error(self.paths, progress)
        others = [[path for path in self.paths if path is not left_out] for left_out in self.paths]
        return with_all, [self._error(paths, progress) - with_all for paths in others]

    def _error(self, paths: Sequence[NDArray[np.int64]], progress: Progress) -> float:
        opened = cut_out(self.surface, cuts=list(paths), relax=False, progress=progress) if paths else None
        opened = opened or cut_out(self.surface, cuts="automatic", relax=False, progress=progress)
        return sketch_error(opened.part, None, progress)
