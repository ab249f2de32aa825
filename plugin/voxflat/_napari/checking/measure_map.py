"""The widget of *Layers → Measure → Measure map*."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from voxflat._napari.checking.findings import Findings
from voxflat._napari.results.report import table
from voxflat._napari.workbench import Workbench
from voxflat.arguments import Progress
from voxflat.distortion.distortion import Distortion
from voxflat.judging.measure import measure

if TYPE_CHECKING:
    from napari import Viewer


@dataclass(frozen=True)
class _MeasureIt:
    """Measures a flat patch of any tool."""

    surface: str
    patch: str

    def run(self, progress: Progress) -> Distortion:
        """Measure it."""
        return measure(self.surface, self.patch, progress=progress)


class MeasureMap(Findings):
    """Tells all figures of the selected layer's map, or of the current run; another tool's flat patch is measured."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__("Measure")
        self.asked.connect(self.look)
        self._viewer = napari_viewer
        self.look()

    def look(self) -> None:
        """Tell the figures, or start to measure."""
        layer = self._viewer.layers.selection.active
        about: dict[str, Any] = {} if layer is None else layer.metadata
        run = Workbench.of(self._viewer).current
        flat_map = about.get("voxflat", None if run is None else run.flat_map)
        if "patch_file" in about:
            self._work(_MeasureIt(about["surface_file"], about["patch_file"]), self._show)
        elif flat_map is not None:
            self.tell_text(f"{flat_map.metadata['napari']['layer']}\n\n{table(flat_map)}")
        else:
            self.tell_text("No flat map: flatten, open one, or select a flat patch.")

    def _show(self, found: Distortion) -> None:
        self.tell_text(found.table())
