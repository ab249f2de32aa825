"""What a flattening, or an opened file, gave."""

from __future__ import annotations

from dataclasses import dataclass

from voxflat._napari.results.flat_layers import FlatLayers
from voxflat.atlases.atlas import Atlas
from voxflat.maps.flat_map import FlatMap


@dataclass(frozen=True, eq=False)
class Run:
    """A map or an atlas, its layers, and how it is made again.

    Parameters
    ----------
    layers : FlatLayers
        The map or the atlas, and its layers.
    name : str
        Name of what was flattened.
    script : str or None
        A Python script that makes the same map without a window; None of what was opened from a file.
    """

    layers: FlatLayers
    name: str
    script: str | None = None

    @property
    def flat_map(self) -> FlatMap | Atlas:
        """The map, or the atlas."""
        return self.layers.flat_map
