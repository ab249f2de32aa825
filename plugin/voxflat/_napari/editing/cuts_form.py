"""The form of *Draw cuts*: the layer to cut, and the surface to draw on."""

from napari import Viewer
from napari.layers import Labels, Layer, Surface

from voxflat._napari.forms.fields import show_row
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.forms.layer_form import LayerForm
from voxflat.errors import InputError


class CutsForm(LayerForm):
    _settings = (*LayerForm._settings, "shown_on")

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self.shown_on = LayerChoice(viewer, self._shown_rank, none="the surface itself")
        self.shown_on.setToolTip("Draw on another surface with the same vertices, such as the inflated one")
        self._add_rows(("Draw on", self.shown_on), ("World axes", self.world))
        self._on_surface()

    def layer(self) -> Layer:
        """Return the layer to cut; raises InputError if there is none."""
        layer = self._chosen()
        if isinstance(layer, Labels) and self.label.currentData() is None:
            raise InputError(f"Layer '{layer.name}' has no labels. Paint a label, or choose another layer")
        return layer

    def _on_surface(self) -> None:
        super()._on_surface()
        self.shown_on.refresh()
        show_row(self._rows, self.shown_on, self.shown_on.count() > 1)

    def _shown_rank(self, layer: Layer) -> int | None:
        cut = self.surface.layer
        if "voxflat" in layer.metadata or layer is cut or not isinstance(layer, Surface) or layer.ndim != 3:
            return None
        if not isinstance(cut, Surface) or len(layer.vertices) != len(cut.vertices):
            return None
        return int("inflated" in layer.name)

    def release(self) -> None:
        super().release()
        self.shown_on.release()
