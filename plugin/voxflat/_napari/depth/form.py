"""The form of *Cortical depth*: the rim, its number of layers, and the volume to sample."""

from typing import Any

from napari import Viewer
from napari.layers import Labels, Layer, Surface
from qtpy.QtWidgets import QDoubleSpinBox, QSpinBox

from voxflat._napari.forms.fields import choice, spin
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.layers.sampled import Sampled, shown
from voxflat._napari.layers.volumes import LayerVolume, shown_step
from voxflat._napari.map_viewer.drawings import OF_MAP
from voxflat.errors import InputError

_AREA = 1.0  # mm²
_LAYERINGS = {"equivolume": "equal volumes (equivolume)", "equidistant": "equal thickness (equidistant)"}


class DepthForm(LayerForm):
    """Lets the user choose a rim, layers, a volume and a region."""

    _settings = (*LayerForm._settings, "count", "layering", "area", "regions")

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        tip = (
            "Number of layers, from the inner border (white matter) to the outer border. The default is one layer per "
            "voxel of the median thickness, but at least 3 and at most 20"
        )
        self.count = spin(QSpinBox(), 0, 1000, tip, special="automatic")
        tip = "Mean area of a column on the surface halfway between the borders"
        self.area = spin(QDoubleSpinBox(), 0.01, 10_000, tip, " mm²", step=0.5)
        self.area.setValue(_AREA)
        tip = "Whether each layer has the same share of the volume or of the thickness of the grey matter around it"
        self.layering = choice(_LAYERINGS, tip)
        self.sampled.setToolTip("The layer to sample, such as functional data, at the displayed time point")
        self.regions = LayerChoice(viewer, self._region_rank, none="whole grey matter")
        self.regions.setToolTip(
            "Where the profile is computed: the whole grey matter, or each label of a Labels layer. To draw regions, "
            "set Click in the dock Flat map to 'draws a region', and double-click to close each one"
        )
        layers = (("Layers", self.count), ("Layering", self.layering), ("Column area", self.area))
        self._add_rows(*layers, ("Volume", self.sampled), ("Regions", self.regions), ("World axes", self.world))
        self.label.currentIndexChanged.connect(self._keep_rim)
        self._on_surface()
        self._keep_rim()

    def _keep_rim(self) -> None:
        """Keep a rim when other Labels layers, such as regions, are added."""
        if self.label.rim is not None:
            self.surface.keep()
        self.regions.refresh()

    def _set_unit(self, unit: str) -> None:
        super()._set_unit(unit)
        self.area.setSuffix(f" {unit}²")

    def _region_rank(self, layer: Layer) -> int | None:
        if not isinstance(layer, Labels) or layer.ndim != 3 or "voxflat" in layer.metadata:
            return None
        return None if layer is self.surface.layer else int(OF_MAP in layer.metadata)

    def rim(self) -> tuple[LayerVolume, str]:
        """Return the rim and its kind; raises InputError if the label of the form is not a rim."""
        layer = self._chosen()
        if not isinstance(layer, Labels) or self.label.rim is None:
            raise InputError(
                f"Layer '{layer.name}' is not used as a rim. Choose a Labels layer with the labels 1, 2 and 3, or a "
                "FreeSurfer ribbon, as the Surface, and the rim as its Label"
            )
        return LayerVolume.of(layer, self.world.currentData()), self.label.rim

    def volume(self) -> Sampled:
        """Return the volume at the displayed time; raises InputError if there is none."""
        layer = self.sampled.layer
        if layer is None or isinstance(layer, Surface):
            raise InputError("There is no volume to sample. Choose an Image layer as the Volume")
        found = shown(layer, self.world.currentData(), step=shown_step(layer, self._viewer))
        assert isinstance(found, Sampled)
        return found

    def region(self) -> LayerVolume | None:
        """Return the labels of the regions; None for the whole grey matter."""
        layer = self.regions.layer
        return None if layer is None else LayerVolume.of(layer, self.world.currentData())

    def layers(self) -> dict[str, Any]:
        """Return the number of layers (None if it is automatic) and the layering, as in `Rim.layers`."""
        return {"count": self.count.value() or None, "layering": self.layering.currentData()}

    def release(self) -> None:
        super().release()
        self.regions.release()
