"""One flattening: what is asked for, and the way from volumes to layers."""

from __future__ import annotations

from dataclasses import dataclass, replace

from voxflat._errors import Cancelled
from voxflat._napari.results import FlatLayers, Sampled
from voxflat._napari.volumes import LayerVolume
from voxflat._prepare import Progress
from voxflat.api import flatten


@dataclass(frozen=True, eq=False)
class Job:
    """All that a flattening needs; it knows no layer, so it runs in any thread.

    Parameters
    ----------
    surface : LayerVolume
        The volume whose surface is flattened.
    label, threshold, seed_point, radius, sources
        As in `voxflat.flatten`.
    pixel_size : float or None
        As in `FlatMap.image`, mm.
    sampled : Sampled or None
        What the map shows.
    """

    surface: LayerVolume
    label: int | None = None
    threshold: float | None = None
    seed_point: tuple[int, int, int] | None = None
    radius: float | None = None
    sources: int | None = None
    pixel_size: float | None = None
    sampled: Sampled | None = None

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
        _tell(progress, "reading the volume")
        volume = self.surface.read()
        flat_map = flatten(
            volume,
            label=self.label,
            threshold=self.threshold,
            seed_point=self.seed_point,
            radius=self.radius,
            sources=self.sources,
            progress=progress,
        )
        flat_map = replace(flat_map, metadata={**flat_map.metadata, "napari": self.surface.origin})
        _tell(progress, "drawing the map")
        return FlatLayers.of(flat_map, self.surface.origin["layer"], self.sampled, self.pixel_size)


def _tell(progress: Progress, stage: str) -> None:
    if progress(stage, 0, 1) is False:
        raise Cancelled(f"cancelled while {stage}")
