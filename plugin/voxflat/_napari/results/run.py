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
    """A map or an atlas, its layers, how what was flattened is called, and its script, unless it comes from a file."""

    layers: FlatLayers
    name: str
    script: Script | None = None

    @property
    def flat_map(self) -> FlatMap | Atlas:
        """The map, or the atlas."""
        return self.layers.flat_map
