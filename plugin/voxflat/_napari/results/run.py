"""What a flattening, or an opened file, gave."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from voxflat._napari.results.flat_layers import FlatLayers
from voxflat.atlases.atlas import Atlas
from voxflat.maps.flat_map import FlatMap


class Script(Protocol):
    """Writes a script, as `Recipe`."""

    def needs_folder(self) -> bool:
        """Say whether data must be saved beside the script."""

    def script(self, folder: Path | None = None) -> str:
        """Write it."""


@dataclass(frozen=True, eq=False)
class Run:
    """A map or an atlas, its layers, and how it is made again.

    Parameters
    ----------
    layers : FlatLayers
        The map or the atlas, and its layers.
    name : str
        Name of what was flattened.
    script : Script or None
        Writes the Python that makes the same map without a window; None of what was opened from a file.
    """

    layers: FlatLayers
    name: str
    script: Script | None = None

    @property
    def flat_map(self) -> FlatMap | Atlas:
        """The map, or the atlas."""
        return self.layers.flat_map
