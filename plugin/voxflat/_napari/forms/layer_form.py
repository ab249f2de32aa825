"""The fields that all forms share: the surface, the axes of the viewer, and the values that the map shows."""

from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer, Surface
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QDoubleSpinBox, QFormLayout, QWidget
from superqt.utils import signals_blocked

from voxflat._napari.forms.fields import choice, recorded, restore, show_row, spin
from voxflat._napari.forms.label_choice import LabelChoice
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.forms.threshold_choice import ThresholdChoice
from voxflat._napari.layers.meshes import LayerMesh, is_elsewhere, surface_name, vary
from voxflat._napari.layers.sampled import Shown, shown, usual_depth
from voxflat._napari.layers.volumes import LayerVolume, check_time, finest, shown_step, time_axis
from voxflat._napari.layers.world import MADE_FROM, WORLDS, same_kind_of_unit, unit_of
from voxflat._napari.map_viewer.viewer_parts import is_right, list_events, stand_upright
from voxflat._napari.stacks import world_of
from voxflat._napari.timers import single_shot
from voxflat._napari.viewer_state import ViewerState
from voxflat.errors import InputError

_RESTORED = "Restored the settings."


class LayerForm(QWidget):
    """Base class of the forms, with the surface and the values on its map; subclasses add the flattening options.

    `record` returns the settings, which `restore` brings back once the layer to flatten is open.
    """

    restored = Signal(str)  # emitted with a message when settings were restored, or could not be
    _settings: ClassVar[tuple[str, ...]] = ("label", "threshold", "world", "sampled", "sample_depth")

    def __init__(self, viewer: Viewer) -> None:
        super().__init__()
        self._viewer = viewer
        self._state = ViewerState.of(viewer)
        self.surface = LayerChoice(viewer, partial(_surface_rank, viewer), follows_selection=True)
        self.surface.setPlaceholderText("open a Labels, Image or Surface layer")
        self.surface.setToolTip("The layer to flatten: Labels, an Image with a threshold, or a Surface")
        self.label = LabelChoice()
        self.label.setToolTip(
            "The label whose surface is flattened. The default is the selected label of the layer. A rim, which "
            "contains the outer border (1), the inner border (2) and the grey matter (3), is flattened halfway "
            "between its borders. So is the grey matter of a FreeSurfer ribbon"
        )
        self.threshold = ThresholdChoice(viewer)
        self.world = choice(WORLDS, "Anatomical directions of the viewer's axes. A wrong choice mirrors the map")
        self.sampled = LayerChoice(viewer, self._sampled_rank, none="nothing")
        self.sampled.setToolTip("The layer that the map shows, such as a T1 image or an atlas, sampled at the surface")
        tip = "Sampling distance from the surface. Negative values are inside the surface"
        self.sample_depth = spin(QDoubleSpinBox(), -100, 100, tip, " mm", step=0.5)
        tip = "Pixel size of the map. The default is half the size of a voxel, or half the length of a mesh edge"
        self.pixel_size = spin(QDoubleSpinBox(), 0, 100, tip, " mm", step=0.1, special="automatic")
        self._depth_by_user = False
        self.sample_depth.editingFinished.connect(self._on_depth)
        self._waiting: Mapping[str, Any] | None = self._state.settings.get(type(self).__name__)
        self._problems: dict[str, str] = {}  # of the settings that were not restored
        self._soon = single_shot(self, 0, self._restore)  # after the choices of layers are up to date
        self._list_events = list_events(viewer.layers)
        for event in self._list_events:
            event.connect(self._soon_restore)
        self._soon.start()
        viewer.dims.events.ndisplay.connect(self._on_ndisplay)
        self._rows = QFormLayout(self)
        self._rows.setContentsMargins(0, 0, 0, 0)
        self._rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)

    def _add_rows(self, *rows: tuple[str, QWidget]) -> None:
        """Add the fields of the surface and then the given fields to the form, and connect their signals."""
        surface = (("Surface", self.surface), ("Label", self.label), ("Threshold", self.threshold))
        for text, field in (*surface, *rows):
            self._rows.addRow(text, field)
        for name in self._settings:
            if hasattr(getattr(self, name), "settled"):
                getattr(self, name).settled.connect(partial(self._on_settled, name))
        self.surface.chosen.connect(self._on_surface)
        self.world.currentIndexChanged.connect(self._on_world)
        self._state.world_chosen.connect(self._show_world)
        self.label.currentIndexChanged.connect(self._set_depth)
        if self._rows.labelForField(self.sample_depth) is not None:  # the form shows a map
            self.sampled.chosen.connect(self._on_sampled)

    def record(self) -> dict[str, Any]:
        """Return the settings for the description of a saved map."""
        layer = self.surface.layer
        if layer is None:  # settings of layers would be empty, but the next layers have their own
            free = (name for name in self._settings if name not in LayerForm._settings)
            return {"surface": None, **{name: recorded(getattr(self, name)) for name in free}}
        surface = [layer.name, *_size(layer)]
        return {"surface": surface, **{name: recorded(getattr(self, name)) for name in self._settings}}

    def restore(self, record: Mapping[str, Any]) -> None:
        """Restore settings, now or when the layer to flatten is opened."""
        self._waiting = record
        self._restore()
        if self._waiting is not None:
            self._tell_restored()

    @property
    def is_waiting(self) -> bool:
        """Whether settings wait for the layer to flatten."""
        return self._waiting is not None

    def _soon_restore(self) -> None:
        self._soon.start()

    def _restore(self) -> None:
        """Restore the settings that wait, if their layer is open."""
        if self._waiting is None:
            return
        record = self._waiting
        if record.get("surface") is not None:
            alike = (layer for layer in self._viewer.layers if _surface_rank(self._viewer, layer) is not None)
            found = next((layer for layer in alike if [layer.name, *_size(layer)] == list(record["surface"])), None)
            if found is None:
                return
            self.surface.choose(found)
        self._waiting, self._problems = None, {}
        self._depth_by_user = True
        self._apply(record)
        self._tell_restored()

    def _apply(self, record: Mapping[str, Any]) -> None:
        """Set the fields to recorded values."""
        for name in self._settings:
            if name in record:
                try:
                    self._set_problem(name, restore(getattr(self, name), record[name]))
                except (TypeError, ValueError, AttributeError):  # the record is damaged
                    self._set_problem(name, f"{record[name]!r} is not a setting")

    def _set_problem(self, name: str, problem: str) -> None:
        """Store why a setting was not restored, or, with an empty text, that it was."""
        self._problems.pop(name, None)
        if problem:
            self._problems[name] = problem

    def _on_settled(self, name: str, problem: str) -> None:
        if self._waiting is None:
            self._set_problem(name, problem)
            self._tell_restored()

    def _tell_restored(self) -> None:
        if self._waiting is not None:
            name = self._waiting["surface"][0]
            is_open = any(layer.name == name for layer in self._viewer.layers)
            other = f"The settings were not restored, because layer '{name}' has another size than the flattened layer."
            self.restored.emit(other if is_open else f"Open '{name}' to restore the settings.")
            return
        problems = "".join(f" {self._text(name)}: {problem}." for name, problem in self._problems.items())
        self.restored.emit(f"Restored the settings, except for the following.{problems}" if problems else _RESTORED)

    def _text(self, name: str) -> str:
        """Return the text beside a field."""
        label = self._rows.labelForField(getattr(self, name))
        return name.capitalize() if label is None else str(label.text())  # type: ignore[attr-defined]  # of a QLabel

    def _on_surface(self) -> None:
        layer = self.surface.layer
        self.label.follow(layer if isinstance(layer, Labels) else None)
        show_row(self._rows, self.label, isinstance(layer, Labels))
        show_row(self._rows, self.threshold, isinstance(layer, Image))
        self.threshold.follow(layer if isinstance(layer, Image) and not layer.rgb else None)
        self.sampled.refresh()
        self._set_depth()
        self._set_unit("mm" if layer is None else unit_of(layer))
        self._show_world()

    def _show_world(self) -> None:
        """Show the world axes of the surface: those that were chosen for this layer, or else the usual ones."""
        if (layer := self.surface.layer) is not None:
            with signals_blocked(self.world):
                self.world.setCurrentIndex(self.world.findData(world_of(self._viewer, layer)))

    def _on_world(self) -> None:
        if self.surface.layer is not None:
            self._state.choose_world(self.surface.layer, self.world.currentData())

    def _set_unit(self, unit: str) -> None:
        """Show the unit of the surface."""
        for box in (self.sample_depth, self.pixel_size):
            box.setSuffix(f" {unit}")

    def _set_depth(self) -> None:
        if not self._depth_by_user:
            self.sample_depth.setValue(0.0 if self.label.rim is not None else usual_depth(self.surface.layer))

    def _on_depth(self) -> None:
        self._depth_by_user = True

    def _on_ndisplay(self) -> None:
        """Stand the 3D view of a mesh upright, because napari shows meshes in RAS lying on their side."""
        layer, world = self.surface.layer, self.world.currentData()
        if self._viewer.dims.ndisplay == 3 and isinstance(layer, Surface) and layer.ndim == 3:
            with suppress(InputError):  # which is reported when the layer is flattened
                mesh = LayerMesh.of(layer, world).read()
                stand_upright(self._viewer, right=is_right(mesh.points, mesh.structure), world=world)

    def _on_sampled(self) -> None:
        show_row(self._rows, self.sample_depth, isinstance(self.sampled.layer, Image | Labels))

    def _sampled_rank(self, layer: Layer) -> int | None:
        """Return how suitable a layer is for display on the map; the values of the flattened mesh are most suitable."""
        if "voxflat" in layer.metadata:
            return None
        if isinstance(layer, Image | Labels):
            own = self.surface.layer
            suits = isinstance(layer, Image) and layer.ndim == max(3, 3 if own is None else own.ndim)
            if suits and own is not None and own.ndim == 3:  # otherwise, flattening would be refused
                suits = same_kind_of_unit(own, layer)
            return int(suits) + (suits and layer != self.surface.layer)  # an image is constant on its own isosurface
        mesh = self.surface.layer
        if not (isinstance(layer, Surface) and isinstance(mesh, Surface) and len(layer.vertices) == len(mesh.vertices)):
            return None
        return (3 if layer == mesh else 1) if vary(np.asarray(layer.vertex_values)) else 0

    def _chosen(self) -> Layer:
        if self.surface.layer is None:
            raise InputError("There is no surface to flatten. Open a Labels, Image or Surface layer")
        self.surface.keep()
        return self.surface.layer

    def source(self) -> tuple[LayerVolume | LayerMesh, dict[str, Any]]:
        """Return the chosen layer, and the foreground of a volume; raises InputError if the layer is unsuitable."""
        layer, world = self._chosen(), self.world.currentData()
        if isinstance(layer, Surface):
            return LayerMesh.of(layer, world), {}
        return LayerVolume.of(layer, world), self._foreground(layer)

    def _foreground(self, layer: Layer) -> dict[str, Any]:
        if isinstance(layer, Labels):
            return {"label": self.label.label, "threshold": None, "rim": self.label.rim}
        return {"label": None, "threshold": self.threshold.value(), "rim": None}

    def _shown(self, layer: Layer, world: str) -> Shown | None:
        sampled = self.sampled.layer
        if sampled is None:
            return None
        if not isinstance(sampled, Surface) and sampled.ndim == 3 and not same_kind_of_unit(layer, sampled):
            both = f"'{layer.name}' ({layer.units[0]}) and '{sampled.name}' ({sampled.units[0]})"
            raise InputError(f"The units of {both} do not match. Set both to units of length")
        step = () if isinstance(sampled, Surface) else self._step(layer, sampled)
        return shown(sampled, world, self.sample_depth.value(), step=step)

    def _step(self, layer: Layer, sampled: Layer) -> tuple[int, ...]:
        """Return the displayed time point of the sampled layer; raises InputError if it is not that of the surface."""
        if layer.ndim > 3:
            check_time(sampled, time_axis(layer), finest(layer).shape[0])
        return shown_step(sampled, self._viewer)

    def release(self) -> None:
        """Stop following the viewer."""
        self._state.settings[type(self).__name__] = self._waiting or self.record()
        self._soon.stop()
        self._state.world_chosen.disconnect(self._show_world, missing_ok=True)
        self._viewer.dims.events.ndisplay.disconnect(self._on_ndisplay)
        for event in self._list_events:
            event.disconnect(self._soon_restore)
        self.label.follow(None)
        self.threshold.follow(None)
        self.surface.release()
        self.sampled.release()


def _size(layer: Layer) -> list[int]:
    """Return the shape of a volume, or the numbers of vertices and faces of a mesh."""
    return [len(layer.vertices), len(layer.faces)] if isinstance(layer, Surface) else list(finest(layer).shape)


def _surface_rank(viewer: Viewer, layer: Layer) -> int | None:
    """Rank layers to flatten: labels, surfaces, values on them, images; a surface of another one has rank 0."""
    if "voxflat" in layer.metadata or not isinstance(layer, Image | Labels | Surface) or getattr(layer, "rgb", False):
        return None
    if isinstance(layer, Image | Labels) and layer.ndim > 3 and MADE_FROM not in layer.metadata:
        return 2 if isinstance(layer, Labels) else 1  # frames of a movie
    if layer.ndim != 3 or MADE_FROM in layer.metadata or any(_is_of(layer, other) for other in viewer.layers):
        return 0
    if isinstance(layer, Surface):
        return 3 if _is_of_values(layer) else 4 if _is_partner(layer) else 5
    return 6 if isinstance(layer, Labels) else 2


def _is_partner(layer: Surface) -> bool:
    """Return whether a surface is pial, inflated or spherical, and is therefore rarely flattened itself."""
    name = surface_name(layer)
    return "pial" in name or is_elsewhere(name)


def _is_of_values(layer: Surface) -> bool:
    """Return whether a layer was opened from a file of values, and shows them on another surface."""
    return "surface_file" in layer.metadata and layer.metadata["surface_file"] != str(layer.source.path)


def _is_of(layer: Layer | None, other: Layer) -> bool:
    """Return whether a layer is a pial, inflated or spherical surface that belongs to another layer."""
    if not isinstance(layer, Surface) or not isinstance(other, Surface) or not _is_partner(layer):
        return False
    is_same_mesh = len(other.vertices) == len(layer.vertices)
    return is_same_mesh and "voxflat" not in other.metadata and not _is_partner(other)
