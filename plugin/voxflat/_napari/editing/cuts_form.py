"""The form of *Draw cuts*: the layer to cut, and the surface to draw on."""

from napari import Viewer
from napari.layers import Labels, Layer, Surface
from qtpy.QtWidgets import QWidget

from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.forms.layer_form import LayerForm
from voxflat.errors import InputError


class CutsForm(LayerForm):
    """Lets the user choose the layer to cut."""

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(viewer, parent)
        self.shown_on = LayerChoice(viewer, self._shown_rank, none="the surface itself")
        self.shown_on.setToolTip("Draw on another surface with the same vertices, such as the inflated one")
        self._add_rows(
            (
                ("Surface", self.surface),
                ("Label", self.label),
                ("Threshold", self.threshold),
                ("Draw on", self.shown_on),
                ("World axes", self.world),
            )
        )
        self._on_surface()

    def layer(self) -> Layer:
        """Return the layer to cut; raises InputError if there is none."""
        layer = self._chosen()
        if isinstance(layer, Labels) and self.label.label is None:
            raise InputError(f"Layer '{layer.name}' has no labels. Paint one, or choose another layer")
        return layer

    def _on_surface(self) -> None:
        super()._on_surface()
        self.shown_on.refresh()
        self._show_row(self.shown_on, self.shown_on.count() > 1)

    def _on_sampled(self) -> None:
        """Do nothing: this form does not show a map."""

    def _shown_rank(self, layer: Layer) -> int | None:
        """Return how suitable a layer is for drawing on it."""
        cut = self.surface.layer
        if "voxflat" in layer.metadata or layer is cut or not isinstance(layer, Surface) or layer.ndim != 3:
            return None
        if not isinstance(cut, Surface) or len(layer.vertices) != len(cut.vertices):
            return None
        return int("inflated" in layer.name)

    def release(self) -> None:
        """Stop following the viewer."""
        super().release()
        self.shown_on.release()
