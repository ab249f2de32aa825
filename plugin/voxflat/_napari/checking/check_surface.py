"""The widget of *Layers → Measure → Check surface*."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from qtpy.QtWidgets import QWidget

from voxflat._napari.checking.findings import Findings
from voxflat._napari.forms.layer_form import LayerForm
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.layers.world import from_ras
from voxflat._napari.workbench import Workbench
from voxflat.arguments import Progress
from voxflat.errors import VoxflatError
from voxflat.pipeline.check import check
from voxflat.surfaces.findings import Check

if TYPE_CHECKING:
    from napari import Viewer

_PLACES = {
    "size": 5,
    "symbol": "ring",
    "face_color": "#ff4d4d",
    "border_color": "#ff4d4d",
    "blending": "translucent_no_depth",  # in 3D they are seen through the surface
}


class CheckForm(LayerForm):
    """Asks which surface is checked."""

    def __init__(self, viewer: Viewer, parent: QWidget | None = None) -> None:
        super().__init__(viewer, parent)
        self._add_rows(
            (
                ("Surface", self.surface),
                ("Label", self.label),
                ("Threshold", self.threshold),
                ("World axes", self.world),
            )
        )
        self._on_surface()

    def _on_sampled(self) -> None:
        """Nothing is shown on a map here."""


@dataclass(frozen=True, eq=False)
class _CheckIt:
    """Checks a surface."""

    source: LayerVolume | LayerMesh
    foreground: dict[str, Any]

    def run(self, progress: Progress) -> Check:
        """Check it."""
        return check(self.source.read(), **self.foreground, progress=progress)


class CheckSurface(Findings):
    """Says what keeps a surface from being flattened, and marks where."""

    def __init__(self, napari_viewer: Viewer) -> None:
        self.form = CheckForm(napari_viewer)
        super().__init__("Check", self.form)
        self.asked.connect(self.look)
        self._viewer = napari_viewer
        Workbench.of(napari_viewer)  # for what it sees to while layers go
        self._origin: dict[str, str] = {}

    def look(self) -> None:
        """Start to check; errors are told."""
        try:
            source, foreground = self.form.source()
        except VoxflatError as error:
            self._fail(error)
            return
        self._origin = source.origin
        self._work(_CheckIt(source, foreground), self._show)

    def release(self) -> None:
        """Stop following the viewer."""
        self.form.release()

    def _show(self, found: Check) -> None:
        rows = dict(found.rows())
        self.tell_rows([("input", self._origin["layer"]), *list(rows.items())[1:]], found.advice)
        name = f"places to look at in {self._origin['layer']}"
        if name in self._viewer.layers:
            self._viewer.layers.remove(name)
        places, texts = _places(found)
        if not places:
            return
        units = None if self._origin["unit"].startswith("pixel") else ("mm",) * 3
        points = from_ras(np.array(places), self._origin["world_axes"])
        self._viewer.add_points(points, name=name, units=units, features={"finding": texts}, **_PLACES)


def _places(found: Check) -> tuple[list[Any], list[str]]:
    """Return where handles and the thinnest place are, RAS+ mm, and what each is."""
    places = [handle["centre"] for handle in found.handles]
    texts = [f"handle, {handle['length']:.1f} mm around" for handle in found.handles]
    if found.thin is not None and found.thin["place"] is not None:
        places.append(found.thin["place"])
        texts.append(f"thinnest place, {found.thin['worst']:.2f} mm")
    return places, texts
