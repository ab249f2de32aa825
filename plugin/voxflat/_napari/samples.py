"""Sample data: the human cortex, to be flattened."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from voxflat._napari.layers.seed import MARKER
from voxflat._napari.results.flat_layers import LayerData
from voxflat.arguments import Progress
from voxflat.errors import Cancelled

if TYPE_CHECKING:
    from napari import Viewer

PARTS = ("", "left hemisphere", "right hemisphere", "cerebellum and brain stem")
"""What the labels of the sample's white matter are called."""

SEED_POINT = (-38.0, -22.0, 55.0)
"""Scanner RAS, mm: the left central cortex, across from the demo's."""

_SAMPLE = ("voxflat", "demo_cortex")


def demo_cortex() -> list[LayerData]:
    """Open the MNI152 template: a seed point on the left central cortex at once, T1 and white matter as they are read.

    Returns
    -------
    list of LayerData
        In mm, RAS+: the seed point, to which another thread adds the rest; without a viewer all.
    """
    from napari import current_viewer

    viewer, cortex = current_viewer(), _Cortex()
    seed: LayerData = ([SEED_POINT], {**MARKER, "units": ("mm",) * 3}, "points")
    if viewer is None:
        return [*cortex.run(lambda *_: None), seed]
    _add_when_read(viewer, cortex)
    return [seed]


@dataclass(frozen=True)
class _Cortex:
    """Reads the sample's volumes."""

    def run(self, progress: Progress) -> list[LayerData]:
        """Return T1 and white matter in its parts.

        Parameters
        ----------
        progress : callable
            As in `voxflat.flatten`.

        Returns
        -------
        list of LayerData
        """
        from voxflat.demo import THRESHOLD, demo_cortex, hemisphere

        def tell(done: int) -> None:
            if progress("reading the template", done, 4) is False:
                raise Cancelled("cancelled while reading the template")

        tell(0)
        white_matter, t1, _ = demo_cortex()
        tell(2)
        labels = np.where(white_matter.data > THRESHOLD, 3, 0).astype(np.uint8)
        for label, side in enumerate(("left", "right"), 1):
            labels[hemisphere(white_matter, side).data > 0] = label
            tell(2 + label)
        place: dict[str, Any] = {"affine": white_matter.affine, "units": ("mm",) * 3}
        parts = {"index": range(len(PARTS)), "name": PARTS}
        return [
            (t1.data, {"name": "T1", "contrast_limits": (0, 1), **place}, "image"),
            (labels, {"name": "white matter", "features": parts, **place}, "labels"),
        ]


def _add_when_read(viewer: Viewer, cortex: _Cortex) -> None:
    """Read in another thread, and add the layers below the seed point."""
    from napari.utils.notifications import show_error

    from voxflat._napari.worker import JobWorker

    there = weakref.ref(viewer)

    def add(layers: list[LayerData], place: int = 0) -> None:
        """Add a layer, and come back for the next one when the window has lived."""
        from napari.layers import Layer
        from qtpy.QtCore import QTimer

        shown = there()
        if shown is None or not any(layer.source.sample == _SAMPLE for layer in shown.layers):
            return  # closed meanwhile
        first, *others = layers
        place = min(place, len(shown.layers))
        shown.layers.insert(place, Layer.create(*first))
        if others:
            QTimer.singleShot(0, lambda: add(others, place + 1))
            return
        shown.layers.selection.active = shown.layers[place]
        shown.reset_view()
        shown.dims.set_point(range(3), SEED_POINT)

    worker = JobWorker(cortex, "Demo cortex")
    worker.returned.connect(add)
    worker.errored.connect(lambda error: None if isinstance(error, Cancelled) else show_error(str(error)))
    worker.start()
