"""The widget of *Layers → Transform → Flatten in patches*."""

from __future__ import annotations

from typing import TYPE_CHECKING

from voxflat._napari.forms.patches_form import PatchesForm
from voxflat._napari.results.map_panel import MapPanel
from voxflat._napari.results.pages import C_MEANING
from voxflat._napari.widgets.flatten_widget import FlattenWidget

if TYPE_CHECKING:
    from napari import Viewer


class FlattenPatches(FlattenWidget):
    """Flattens a surface of any topology in patches whose distortion is certified, in another thread."""

    form: PatchesForm

    def __init__(self, napari_viewer: Viewer) -> None:
        panel = MapPanel(meaning=C_MEANING, what="atlas")
        super().__init__(napari_viewer, PatchesForm(napari_viewer), panel, "Flatten in patches")
