"""The form of *Flatten surface*: the surface to flatten, and the options."""

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer, Points, Shapes, Surface
from numpy.typing import NDArray
from qtpy.QtCore import Qt, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QCheckBox, QDoubleSpinBox
from superqt import QCollapsible

from voxflat._napari.forms.fields import choice, offer, show_row, spin
from voxflat._napari.forms.layer_choice import LayerChoice
from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.forms.options_form import OptionsForm, takes
from voxflat._napari.forms.plan import Plan
from voxflat._napari.forms.seed_choice import SeedChoice
from voxflat._napari.job import Frames, Job
from voxflat._napari.layers.declared_size import declared_size, use_declared_size
from voxflat._napari.layers.foreground import inside
from voxflat._napari.layers.meshes import LayerMesh, surface_name, vary
from voxflat._napari.layers.sampled import overlay
from voxflat._napari.layers.seed import corners
from voxflat._napari.layers.volumes import LayerVolume, finest, frames_of, nearest_step, time_axis
from voxflat._napari.layers.world import MADE_FROM, unit_of
from voxflat._napari.results.flat_layers import SingleFrame
from voxflat._napari.viewer_state import DrawnCuts
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import is_flat
from voxflat.methods import METHODS

_RADIUS = 45.0  # mm, as in the README
_METHODS = {name: name for name in METHODS}  # the summaries, which are wider than the box, are tooltips
_FRAMES = {"all": "all, on one map", "one": "displayed frame"}
_PARTS = {"whole": "whole surface", "disk": "disk around a point", "polygon": "within a polygon"}
_PARTS |= {"mask": "within a mask", "values": "nonzero values"}
_SETTINGS = (
    "pixel_size",
    "frames",
    "pial",
    "flat",
    "patch",
    "radius",
    "seed",
    "polygon",
    "masked_by",
    "method",
    "options",
)


class SurfaceForm(LayerForm):
    """Lets the user choose a surface to flatten and the options; `job` returns these choices."""

    _settings = (*LayerForm._settings, *_SETTINGS)
    action_changed = Signal(str)  # emitted with what the form does: the text of the button

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self._make_fields(viewer)
        disk = (("Seed point", self.seed), ("Radius", self.radius))
        part = (("Part", self.patch), *disk, ("Polygon", self.polygon), ("Mask", self.masked_by))
        display = (("Show on map", self.sampled), ("at depth", self.sample_depth))
        making = (("Method", self.method), ("Continue", self.continues), ("World axes", self.world))
        surfaces = (("Pial surface", self.pial), ("Flat map", self.flat))
        self._add_rows(("Frames", self.frames), *surfaces, *part, *display, *making)
        self._advanced = QCollapsible("Advanced", expandedIcon="▾", collapsedIcon="▸")
        self._advanced.addWidget(self.options)
        self._rows.addRow(self._advanced)
        self._rows.addRow(self.plan)
        self.patch.currentIndexChanged.connect(self._on_patch)
        self.method.currentIndexChanged.connect(self._on_method)
        self.frames.currentIndexChanged.connect(self._on_frames)
        for layers in (self.pial, self.polygon, self.masked_by, self.sampled):
            layers.chosen.connect(self._update_plan)
        self.flat.chosen.connect(self._on_flat)
        changes = (self.label.currentIndexChanged, self.options.changed, self.threshold.box.valueChanged)
        for change in (*changes, self.radius.valueChanged, self.continues.toggled):
            change.connect(self._update_plan)
        self._state.cuts_drawn.connect(self._on_cuts_drawn)
        self._state.changed.connect(self._offer_to_go_on)
        viewer.dims.events.current_step.connect(self._on_step)
        self._on_surface()
        self._on_patch()
        self._on_method()
        self._on_sampled()

    def _make_fields(self, viewer: Viewer) -> None:
        self.method = choice(_METHODS, "The flattening method: voxflat's own method, or the method of a paper")
        tip = "Flatten all frames with one map, on which cells stay in place, or only the frame that is displayed"
        self.frames = choice(_FRAMES, tip)
        self.pial = LayerChoice(viewer, self._pial_rank, none="none")
        self.pial.setToolTip("The pial surface of a white surface. Distances are measured midway between the two")
        self.flat = LayerChoice(viewer, self._flat_rank, none="none (make a map)")
        self.flat.setToolTip(
            "A flat map of the surface that another program made, with the same vertices. It is shown as it is, and no "
            "new map is made"
        )
        tip = "The part to flatten. Closed surfaces are cut open. Small parts are less distorted"
        self.patch = choice(_PARTS, tip)
        self.seed = SeedChoice(viewer, self._inside)
        self.radius = spin(QDoubleSpinBox(), 1, 100_000, "Radius of the disk, measured along the surface", " mm")
        self.radius.setDecimals(1)
        self.radius.setValue(_RADIUS)
        self.polygon = LayerChoice(viewer, _polygon_rank)
        self.polygon.setPlaceholderText("draw a polygon in a Shapes layer, or add Points")
        self.polygon.setToolTip(
            "The corners of the region, in order: the selected or last shape of a Shapes layer, or all points of a "
            "Points layer. Corners are moved to the nearest surface points, and joined by shortest paths on the surface"
        )
        self.masked_by = LayerChoice(viewer, self._mask_rank)
        self.masked_by.setPlaceholderText("open a Labels layer of the same shape")
        self.masked_by.setToolTip("Flatten only where this Labels layer, which must have the same shape, is not 0")
        self.continues = QCheckBox("from the displayed map")
        self.continues.setToolTip(
            "Start from the displayed map and keep its position, for example after you change cuts or options. The "
            "displayed map must contain the whole part to flatten. Its cuts are kept unless you choose other cuts"
        )
        self.options = OptionsForm()
        self.options.rows.addRow("Pixel size", self.pixel_size)
        self.plan = Plan(self._viewer)
        self.plan.linkActivated.connect(self._use_declared_size)

    def _on_surface(self) -> None:
        super()._on_surface()
        layer = self.surface.layer
        is_mesh, is_series = isinstance(layer, Surface), layer is not None and layer.ndim > 3
        show_row(self._rows, self.frames, _is_movie(layer))
        if is_series:
            self.patch.setCurrentIndex(self.patch.findData("whole"))
        offer(self.method, _METHODS, "grossmann2002", not is_mesh)
        for name, method in METHODS.items():
            self.method.setItemData(self.method.findData(name), method.summary, Qt.ItemDataRole.ToolTipRole)
        offer(self.patch, _PARTS, "values", is_mesh)
        offer(self.patch, _PARTS, "mask", not is_mesh)
        self.pial.refresh()
        self.masked_by.refresh()
        show_row(self._rows, self.pial, is_mesh and self.pial.count() > 1)
        self.flat.refresh()
        show_row(self._rows, self.flat, is_mesh and self.flat.count() > 1)
        self.seed.set_surface(None if is_series else layer)
        self.options.offer_drawn(self._state.cuts_of(layer))
        self._on_flat()

    def _on_flat(self) -> None:
        """Hide the options of a new map while a flat map is chosen."""
        makes = self.flat.layer is None
        show_row(self._rows, self.method, makes)
        self._advanced.setVisible(makes)
        self._offer_to_go_on()
        self._on_patch()
        self.action_changed.emit(self.action)

    @property
    def action(self) -> str:
        """What the form does."""
        return "Flatten surface" if self.flat.layer is None else "Show flat map"

    def _use_declared_size(self) -> None:
        """Give the layer the voxel size in its file."""
        layer = self.surface.layer
        declared = None if layer is None else declared_size(self._viewer, layer)
        if declared is not None:
            use_declared_size(self._viewer, layer, declared)
            self._on_surface()

    def _on_cuts_drawn(self, layer: Layer) -> None:
        self.surface.choose(layer)
        self.options.offer_drawn(self._state.cuts_of(self.surface.layer), chosen=True)

    def _on_frames(self) -> None:
        self._offer_to_go_on()
        self._update_plan()

    def _on_step(self) -> None:
        if self.surface.layer is not None and self.surface.layer.ndim > 3:
            self._update_plan()

    @property
    def _flattens_all(self) -> bool:
        layer = self.surface.layer
        return _is_movie(layer) and self.frames.currentData() == "all"

    def _set_unit(self, unit: str) -> None:
        super()._set_unit(unit)
        self.radius.setSuffix(f" {unit}")

    def _on_patch(self) -> None:
        part, layer = self.patch.currentData(), self.surface.layer
        makes = self.flat.layer is None
        show_row(self._rows, self.patch, makes and (layer is None or layer.ndim == 3))
        fields = {self.seed: "disk", self.radius: "disk", self.polygon: "polygon", self.masked_by: "mask"}
        for field, own in fields.items():
            show_row(self._rows, field, makes and part == own)
        self._update_plan()

    def _on_method(self) -> None:
        self.options.set_method(self.method.currentData())
        self._offer_to_go_on()
        self._update_plan()

    def _offer_to_go_on(self) -> None:
        is_there = self._map_to_go_on_from() is not None
        if not is_there:
            self.continues.setChecked(False)
        show_row(self._rows, self.continues, is_there)

    def _map_to_go_on_from(self) -> FlatMap | None:
        is_known = takes(self.method.currentData(), "start")
        is_single = is_known and not self._flattens_all and self.flat.layer is None
        return self._state.map_of(self.surface.layer) if is_single else None

    def continue_from_shown_map(
        self, layer: Layer, label: int | None = None, threshold: float | None = None, rim: str | None = None
    ) -> None:
        """Set the form to flatten a layer along its drawn cuts, starting from the displayed map."""
        self.surface.choose(layer)
        if (chosen := label if rim is None else rim) is not None:
            self.label.choose(chosen)
        if threshold is not None:
            self.threshold.setValue(threshold)
        self.method.setCurrentIndex(self.method.findData("voxflat"))
        self.patch.setCurrentIndex(self.patch.findData("whole"))
        self.options.offer_drawn(self._state.cuts_of(layer), chosen=True)
        self.continues.setChecked(True)

    def record(self) -> dict[str, Any]:
        record, layer = super().record(), self.surface.layer
        if self.patch.currentData() != "disk":
            record["seed"] = None
        if self.continues.isChecked():
            record["start"] = _checksum(self._map_to_go_on_from())
        if _is_movie(layer):
            record["frame"] = nearest_step(layer, self._viewer)[0]
        if (drawn := self._state.cuts_of(layer)) is not None:
            record["drawn"] = drawn.record()
        return record

    def _apply(self, record: Mapping[str, Any]) -> None:
        layer = self.surface.layer
        if layer is not None and _is_movie(layer) and "frame" in record:
            time_axis(layer).go_to(self._viewer, record["frame"])
        if layer is not None and "drawn" in record:
            self._state.set_cuts(layer, DrawnCuts.of(record["drawn"]))
        super()._apply(record)
        start = record.get("start")
        is_shown = start is not None and start == _checksum(self._map_to_go_on_from())
        self.continues.setChecked(is_shown)
        is_missing = start is not None and not is_shown
        self._set_problem("continues", "the map from which it started is not displayed" if is_missing else "")

    def _update_plan(self) -> None:
        layer = self.surface.layer
        is_mesh = isinstance(layer, Surface)
        if layer is None or layer.ndim < 3 or (is_mesh and layer.ndim > 3):
            self.plan.follow(None)
            return
        frame = None
        if layer.ndim > 3:
            frame = nearest_step(layer, self._viewer)[0], finest(layer).shape[0], self._flattens_all
        self.plan.follow(
            layer,
            method=self.method.currentData(),
            part=self.patch.currentData(),
            cuts=self.options.cuts,
            radius=self.radius.value(),
            has_pial=is_mesh and self.pial.layer is not None,
            given=None if self.flat.layer is None else self.flat.layer.name,
            goes_on=self.continues.isChecked(),
            frame=frame,
            **({} if is_mesh else self._foreground(layer)),
        )

    def _inside(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return a mask of the foreground values."""
        assert self.surface.layer is not None
        return inside(values, **self._foreground(self.surface.layer))

    def _pial_rank(self, layer: Layer) -> int | None:
        white = self.surface.layer
        if "voxflat" in layer.metadata or layer is white or not isinstance(white, Surface):
            return None
        if not isinstance(layer, Surface) or layer.ndim != 3 or len(layer.vertices) != len(white.vertices):
            return None
        return int("pial" in layer.name and "pial" not in surface_name(white))  # values may lie on the pial surface

    def _flat_rank(self, layer: Layer) -> int | None:
        surface = self.surface.layer
        if "voxflat" in layer.metadata or layer is surface or not isinstance(surface, Surface):
            return None
        if not isinstance(layer, Surface) or layer.ndim != 3 or len(layer.vertices) != len(surface.vertices):
            return None
        return 0 if is_flat(np.asarray(layer.vertices)[np.unique(layer.faces)]) else None

    def _mask_rank(self, layer: Layer) -> int | None:
        volume = self.surface.layer
        if "voxflat" in layer.metadata or not isinstance(layer, Labels) or layer is volume or volume is None:
            return None
        is_alike = not isinstance(volume, Surface) and layer.extent.data.tolist() == volume.extent.data.tolist()
        return 1 if is_alike else None

    def job(self) -> Job:
        """Return the job that the form describes; raises InputError if a choice is missing or unsuitable."""
        layer, world, method = self._chosen(), self.world.currentData(), self.method.currentData()
        surface, foreground = self.source()
        frames = self._frames(layer, surface) if self._flattens_all else None
        of_mesh: dict[str, Any] = {}
        if isinstance(surface, LayerMesh):
            if self.patch.currentData() == "values" and self.flat.layer is None:
                of_mesh["keep"] = surface.kept()
            of_mesh["values"] = overlay(layer, surface) if vary(surface.values) else None
            of_mesh["pial"] = None if self.pial.layer is None else LayerMesh.of(self.pial.layer, world, unit_of(layer))
            of_mesh["flat"] = None if self.flat.layer is None else LayerMesh.of(self.flat.layer, unit=unit_of(layer))
        self.threshold.preview.setChecked(False)
        self._waiting = None  # the user has chosen other settings
        return Job(
            form=self.record(),
            surface=surface,
            method=method,
            pixel_size=self.pixel_size.value() or None,
            shown=self._shown(layer, world),
            options=self.options.options(method),
            frames=frames,
            frame=self._frame(layer, surface) if frames is None and _is_movie(layer) else None,
            start=self._map_to_go_on_from() if self.continues.isChecked() else None,
            **self._part(layer, world),
            **foreground,
            **of_mesh,
        )

    def source(self) -> tuple[LayerVolume | LayerMesh, dict[str, Any]]:
        """Return the chosen layer, at the displayed frame of a movie, as `LayerForm.source` does."""
        layer = self._chosen()
        if isinstance(layer, Surface) or layer.ndim == 3:
            return super().source()
        step = nearest_step(layer, self._viewer)
        return LayerVolume.of(layer, self.world.currentData(), step), self._foreground(layer)

    def _frames(self, layer: Layer, surface: LayerVolume | LayerMesh) -> Frames:
        """Return the frames of a movie; raises InputError if it has options that only single surfaces have."""
        assert isinstance(surface, LayerVolume)
        if self.label.rim is not None:
            raise InputError("Movies cannot be flattened as rims. Choose a label, or flatten only the displayed frame")
        if "drop" in self.options.options(self.method.currentData()):
            raise InputError("Drawn cuts that exclude a part need a single surface. Flatten only the displayed frame")
        return Frames(frames_of(surface), surface.step[0], time_axis(layer))

    def _frame(self, layer: Layer, surface: LayerVolume | LayerMesh) -> SingleFrame:
        assert isinstance(surface, LayerVolume)
        return SingleFrame(surface.step[0], finest(layer).shape[0], time_axis(layer))

    def _part(self, layer: Layer, world: str) -> dict[str, Any]:
        """Return the arguments that select the part to flatten."""
        part = self.patch.currentData()
        for chosen in (self.pial, self.flat, self.seed, self.polygon, self.masked_by):
            chosen.keep()  # not replaced by layers that are added later
        if self.flat.layer is not None:
            return {}
        if part == "disk":
            if self.seed.point is None:
                raise InputError("There is no seed point. Click Pick, then click the surface, or choose another part")
            return {"seed_point": self.seed.point, "radius": self.radius.value()}
        if part == "polygon":
            if self.polygon.layer is None:
                raise InputError("There is no polygon. Draw it in a Shapes layer, or add its corners to a Points layer")
            return {"polygon": corners(self.polygon.layer, world, unit_of(layer))}
        if part == "mask":
            if self.masked_by.layer is None:
                raise InputError("There is no mask. Open a Labels layer of the same shape, or choose another part")
            return {"keep": LayerVolume.of(self.masked_by.layer, world)}
        return {}

    def release(self) -> None:
        super().release()
        self._state.cuts_drawn.disconnect(self._on_cuts_drawn)
        self._state.changed.disconnect(self._offer_to_go_on)
        self._viewer.dims.events.current_step.disconnect(self._on_step)
        self.plan.follow(None)
        for followed in (self.seed, self.pial, self.flat, self.polygon, self.masked_by):
            followed.release()


def _checksum(flat_map: FlatMap | None) -> int | None:
    return None if flat_map is None else zlib.crc32(flat_map.uv.tobytes())


def _is_movie(layer: Layer | None) -> bool:
    """Return whether a layer has several frames, along its first axis."""
    return isinstance(layer, Image | Labels) and layer.ndim > 3 and finest(layer).shape[0] > 1


def _polygon_rank(layer: Layer) -> int | None:
    if not isinstance(layer, Shapes | Points) or layer.ndim != 3 or "voxflat" in layer.metadata:
        return None
    return 1 if isinstance(layer, Shapes) and MADE_FROM not in layer.metadata else 0
