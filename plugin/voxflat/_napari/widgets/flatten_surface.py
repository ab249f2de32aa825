"""The widget of *Layers → Transform → Flatten surface*."""

from __future__ import annotations

from typing import TYPE_CHECKING

from voxflat._napari.forms.surface_form import SurfaceForm
from voxflat._napari.results.map_panel import MapPanel
from voxflat._napari.widgets.flatten_widget import FlattenWidget

if TYPE_CHECKING:
    from napari import Viewer


class FlattenSurface(FlattenWidget):
    """Flattens a mesh, or the surface of a label or of what lies above a threshold, in another thread.

    Parameters
    ----------
    napari_viewer : Viewer
        The viewer, which napari gives by this parameter's name.
    """

    form: SurfaceForm

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__(napari_viewer, SurfaceForm(napari_viewer), MapPanel(), "Flatten surface")
