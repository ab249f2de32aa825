"""The widget of *Layers → Transform → Flatten surface*."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from napari.utils.notifications import show_warning

from voxflat._napari.forms.surface_form import SurfaceForm
from voxflat._napari.results.map_panel import MapPanel
from voxflat._napari.widgets.flatten_widget import FlattenWidget
from voxflat._napari.workbench import Workbench

if TYPE_CHECKING:
    from napari import Viewer
    from napari.layers import Layer


class FlattenSurface(FlattenWidget):
    """Flattens a mesh, or the surface of a label or of what lies above a threshold, in another thread."""

    form: SurfaceForm

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__(napari_viewer, SurfaceForm(napari_viewer), MapPanel(), "Flatten surface")
        Workbench.of(napari_viewer).asked_again.connect(self._on_asked_again)

    def _on_asked_again(self, layer: Layer, foreground: Mapping[str, Any]) -> None:
        if not self.start.isEnabled():
            show_warning("Flatten surface is at work: wait for its map, or cancel it, then press Flatten again")
            return
        self.form.ask_again(layer, **foreground)
        self.flatten()

    def _release(self) -> None:
        super()._release()
        Workbench.of(self._viewer).asked_again.disconnect(self._on_asked_again, missing_ok=True)
