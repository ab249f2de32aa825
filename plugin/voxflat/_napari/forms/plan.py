"""The plan below the form, which summarises the steps of *Flatten surface*."""

from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Any

import numpy as np
import scipy
from napari import Viewer
from napari.layers import Labels, Layer, Surface
from numpy.typing import NDArray
from qtpy.QtCore import Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtWidgets import QLabel

from voxflat._napari.layers.declared_size import File, declared_size, read_sizes, unread_files
from voxflat._napari.layers.volumes import finest
from voxflat._napari.layers.world import ASSUMED_UNIT, unit_of
from voxflat._napari.timers import single_shot
from voxflat._napari.worker import BackgroundTask
from voxflat.surfaces.standard.sphere import sphere_at

_COUNTED = 2**27  # voxels; the surface voxels of larger layers, which may be remote, are not counted
_PAUSE = 300  # ms without a change before surface voxels are counted
_SECONDS = 2e-4  # run time per point on two cores (docs/decisions/0027)
_BYTES = 6500.0  # memory per point
_PARTS = {
    "whole": "the whole surface",
    "disk": "a disk of radius {radius:g} {unit} around the seed point",
    "polygon": "the region within the polygon",
    "mask": "the region within the mask",
    "values": "the region where values are not 0",
}


@dataclass(frozen=True)
class _Asked:
    """The choices made in the form."""

    layer: Layer
    method: str
    part: str
    cuts: str | None
    radius: float
    has_pial: bool
    goes_on: bool
    given: str | None = None  # the layer of a flat map that is shown as it is
    frame: tuple[int, int, bool] | None = None  # of a movie: the displayed one, their number, whether all are flattened
    label: int | None = None
    threshold: float | None = None
    rim: str | None = None


class Plan(QLabel):
    """Shows the steps of *Flatten surface*, the number of points, and the approximate run time."""

    refused = Signal(bool)  # emitted with True if there is nothing to flatten, and with False otherwise

    def __init__(self, viewer: Viewer) -> None:
        super().__init__()
        self._viewer = viewer
        self.setWordWrap(True)
        self.setToolTip("What Flatten surface will do with the current settings")
        self._asked: _Asked | None = None
        self._counted: tuple[Any, ...] = ()  # the layer and foreground whose points have been counted
        self._count: int | None = None
        self._reading: tuple[File, ...] = ()
        self._timer = single_shot(self, _PAUSE, self._start_counting)

    def follow(self, layer: Layer | None, **asked: Any) -> None:
        """Show the plan for a layer and the other choices of the form, or nothing if there is no layer."""
        self._asked = None if layer is None else _Asked(layer, **asked)
        self.refused.emit(self.is_refused)
        if self._asked is None or layer is None or self.is_refused:
            self._counted, self._count = (), None
            self._timer.stop()
            self._write()
            return
        key = (id(layer), self._asked.label, self._asked.threshold)
        if isinstance(layer, Surface):
            self._count = len(layer.vertices)
        elif self._asked.rim is not None or self._asked.frame is not None:
            self._counted, self._count = key, None
            self._timer.stop()
        elif key != self._counted:
            self._counted, self._count = key, None
            self._timer.start()
        self._write()

    @property
    def is_refused(self) -> bool:
        """Whether the layer has no labels to flatten."""
        asked = self._asked
        return asked is not None and isinstance(asked.layer, Labels) and asked.label is None and asked.rim is None

    def _start_counting(self) -> None:
        asked = self._asked
        if asked is None or not isinstance(data := finest(asked.layer), np.ndarray) or data.size > _COUNTED:
            return
        worker = BackgroundTask(partial(_surface_voxels, data, asked.label, asked.threshold, self._counted))
        worker.returned.connect(self._on_counted)
        worker.start()

    def _on_counted(self, found: tuple[int, tuple[Any, ...]]) -> None:
        count, of = found
        if of == self._counted:  # otherwise another layer or foreground has been chosen in the meantime
            self._count = count
            self._write()

    def _write(self) -> None:
        if self._asked is None:
            self.setText("")
        elif self.is_refused:
            name = escape(self._asked.layer.name)
            self.setText(f"Layer '{name}' has no labels. Paint the part to flatten, or choose another layer.")
            self._fit()
        else:
            told = [*_steps(self._asked), *_expected(self._asked, self._count)]
            self.setText(" ".join([*map(escape, told), *self._unit(self._asked.layer)]))
            self._fit()

    def _unit(self, layer: Layer) -> list[str]:
        """Return the unit that is assumed, or a link to the voxel size in a file."""
        if any(str(unit) != "pixel" for unit in layer.units[-3:]):
            return []
        files = unread_files(self._viewer, layer)
        if files and files != self._reading:
            self._reading = files
            worker = BackgroundTask(partial(read_sizes, files), logged=lambda _: None)  # reported when it is flattened
            worker.returned.connect(self._write)
            worker.start()
        declared = declared_size(self._viewer, layer)
        assumed = escape(ASSUMED_UNIT.format(unit_of(layer)))
        if declared is None:
            return [assumed]
        size = " x ".join(f"{length:g}" for length in declared.size)
        told = f"But {declared.path.name} has voxels of {size} {declared.unit} (z, y, x), which napari did not read:"
        return [assumed, f'<b>{escape(told)} <a href="size">use this size</a></b>']

    def resizeEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        """Keep all lines visible, because a form layout reserves the height that the label needed at another width."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        self.setMinimumHeight(max(0, self.heightForWidth(self.width())))  # no height is known for a hidden label


def _steps(asked: _Asked) -> list[str]:
    if asked.given is not None:
        return [f"Shows the flat map '{asked.given}' of this surface. No point is moved."]
    unit = unit_of(asked.layer)
    part = _PARTS[asked.part].format(radius=asked.radius, unit=unit)
    if asked.method == "grossmann2002":
        return [f"Flattens {part}, voxel by voxel. The surface must be open."]
    is_mesh, is_rim = isinstance(asked.layer, Surface), asked.rim is not None
    steps = [f"Flattens {'the largest component' if asked.part == 'whole' and not is_mesh else part}."]
    if asked.frame is not None:
        number, count, flattens_all = asked.frame
        steps = [f"Flattens the largest component in frame {number}."]
        if flattens_all:
            steps.append(f"Moves its mesh onto the other {count - 1} frames, so that all frames share the map.")
    if is_rim:
        steps = [f"Flattens {part}, halfway between the borders of the grey matter."]
    if asked.threshold is not None and asked.part == "whole" and unit == "mm":
        steps.append("In a whole brain, this component can include both hemispheres and the cerebellum.")
    if is_mesh and asked.has_pial:
        steps.append("Measures distances midway to the pial surface.")
    if not is_mesh and not is_rim:
        steps.append("Repairs topology if that changes at most 1\u00a0% of the voxels.")
    if asked.goes_on:
        steps.append("Starts from the displayed map.")
    if asked.part == "whole":
        steps.append(_cutting(asked))
    return steps


def _cutting(asked: _Asked) -> str:
    if asked.goes_on and asked.cuts is None:
        return "Keeps the cuts of that map."
    if asked.cuts == "drawn":
        return "Cuts along the drawn lines, and adds automatic cuts if the drawn cuts do not open the surface."
    if asked.cuts == "standard":
        place = "by its sphere if it is known, otherwise by its folds"
        return f"Opens a closed surface along standard cuts, located {place}."
    path = getattr(asked.layer.source, "path", None)
    sphere = sphere_at(path) if path and isinstance(asked.layer, Surface) and asked.cuts is None else None
    if sphere is not None:
        return f"Opens a closed surface along standard cuts, located by {sphere.name}."
    return "Opens a closed surface along automatic cuts."


def _expected(asked: _Asked, count: int | None) -> list[str]:
    if count is None or asked.given is not None:
        return []
    points = f"{float(f'{count:.2g}'):,.0f}\u00a0points"
    if asked.method != "voxflat" or asked.part != "whole":
        return [f"The whole surface has about {points}."]
    seconds, gigabytes = count * _SECONDS, count * _BYTES / 1e9
    need = f"{_about(seconds)}\u00a0s and {_about(gigabytes)}\u00a0GB of memory"
    return [f"The surface has about {points}. Flattening takes about {need}."]


def _about(value: float) -> str:
    return f"{float(f'{value:.1g}'):g}"


def _surface_voxels(
    data: NDArray[Any], label: int | None, threshold: float | None, of: tuple[Any, ...]
) -> tuple[int, tuple[Any, ...]]:
    """Count the foreground voxels that share a face with the background."""
    inside = data == label if threshold is None else data > threshold
    return int(np.count_nonzero(inside) - np.count_nonzero(scipy.ndimage.binary_erosion(inside, border_value=0))), of
