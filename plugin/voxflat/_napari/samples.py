"""Sample data: a human cortex to flatten, a synthetic rim, and a synthetic embryo."""

import importlib
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from napari import Viewer

from voxflat import samples
from voxflat._napari.layers.seed import MARKER
from voxflat._napari.results.flat_layers import LayerData, hidden
from voxflat.arguments import Progress
from voxflat.errors import Cancelled

PARTS = ("", "left hemisphere", "right hemisphere", "cerebellum and brain stem")  # names of the white-matter labels
SEED_POINT = (-38.0, -22.0, 55.0)  # in the left central cortex, scanner RAS, mm; the demo mirrors it to the right

_SAMPLE = ("voxflat", "demo_cortex")


def demo_cortex() -> list[LayerData]:
    """Open the MNI152 template: a seed point, and T1 and white matter, which a thread reads if there is a viewer."""
    from napari import current_viewer

    viewer = current_viewer()
    seed: LayerData = ([SEED_POINT], {**MARKER, "units": ("mm",) * 3}, "points")
    if viewer is None:
        return [*_cortex(lambda *_: None), seed]
    _make_ready(viewer)
    _add_when_read(viewer)
    return [hidden(seed)]


def demo_rim() -> list[LayerData]:
    """Open a small rim, and a volume that is high in the middle layers of one half of the gyrus."""
    rim = samples.rim()
    x, y, _ = np.indices(rim.data.shape) * rim.spacing[:, None, None, None]
    depth = (np.hypot(x - 7.8, y) - 4.5) / 2.5  # the radii of the grey matter are 4.5 and 7 mm
    active = np.exp(-(((depth - 0.5) / 0.2) ** 2)) * (x > 7.8)
    noise = np.random.default_rng(0).normal(0, 0.2, rim.data.shape)
    activity, labels = (data.T[:, ::-1] for data in ((active + noise).astype(np.float32), rim.data))  # seen as a hill
    place: dict[str, Any] = {"affine": rim.affine, "units": ("mm",) * 3}
    return [
        (activity, {"name": "activity", "colormap": "inferno", **place}, "image"),
        (labels, {"name": "rim", "opacity": 0.4, **place}, "labels"),
    ]


def demo_embryo() -> list[LayerData]:
    """Open a movie of a growing embryo with nuclei, and its segmentation, with the axes t, z, y, x."""
    embryo = samples.embryo()
    nuclei, labels = (np.stack([volume.data.T for volume in volumes]) for volumes in (embryo.images, embryo.labels))
    first = embryo.images[0]
    scale, translate = ((1.0 * time, *place[::-1]) for time, place in ((1, first.spacing), (0, first.affine[:3, 3])))
    place: dict[str, Any] = {"scale": scale, "translate": translate, "axis_labels": tuple("tzyx")}
    place["units"] = ("pixel", *["µm"] * 3)
    return [
        (nuclei, {"name": "nuclei", "colormap": "gray", "contrast_limits": (0, 255), **place}, "image"),
        (labels, {"name": "embryo", "opacity": 0.3, **place}, "labels"),
    ]


def _cortex(progress: Progress) -> list[LayerData]:
    """Read the T1 image, and the white matter with one label per part."""
    from voxflat.demo import THRESHOLD, demo_cortex
    from voxflat.surfaces.hemispheres import hemisphere

    def report(done: int) -> bool:
        if progress("reading the template", done, 4) is False:
            raise Cancelled("cancelled while reading the template")
        return True

    report(0)
    white_matter, t1, _ = demo_cortex()
    report(2)
    labels = np.where(white_matter.data > THRESHOLD, 3, 0).astype(np.uint8)
    for label, side in enumerate(("left", "right"), 1):
        half = hemisphere(white_matter, side, threshold=THRESHOLD, progress=lambda *_, at=label: report(1 + at))
        labels[half.data > 0] = label
        report(2 + label)
    place: dict[str, Any] = {"affine": white_matter.affine, "units": ("mm",) * 3}
    parts = {"index": range(len(PARTS)), "name": PARTS}
    return [
        (t1.data, {"name": "T1", "contrast_limits": (0, 1), **place}, "image"),
        (labels, {"name": "white matter", "features": parts, **place}, "labels"),
    ]


def _make_ready(viewer: Viewer) -> None:
    """Prepare the first layers in a thread or in small steps while the window is being drawn."""
    from qtpy.QtCore import QCoreApplication, QEventLoop

    from voxflat._napari.garbage_collection import defer_collections

    defer_collections()

    def load() -> None:
        with suppress(ImportError):  # because other versions of napari may need other modules
            importlib.import_module("pandas")
            importlib.import_module("pint").get_application_registry().Unit("mm")  # reads the unit definitions
            importlib.import_module("vispy.visuals.line.dash_atlas").DashAtlas()  # which polygons in Labels layers need

    thread = threading.Thread(target=load, daemon=True)
    thread.start()

    def live() -> None:  # user input is postponed
        QCoreApplication.processEvents(QEventLoop.ProcessEventsFlag.ExcludeUserInputEvents)
        thread.join(0.005)

    glyphs = _glyphs(viewer)
    while next(glyphs, False) or thread.is_alive():
        live()
    if not viewer.layers:
        viewer.dims.ndim = 3  # creates the sliders
        live()


def _glyphs(viewer: Viewer) -> Iterator[bool]:
    """Draw the letters with which vispy measures a font before it draws text, such as in Points; yield after each."""
    qt_viewer = getattr(getattr(getattr(viewer, "__wrapped__", viewer), "window", None), "_qt_viewer", None)
    fonts: Any = getattr(qt_viewer, "_font_manager", None)
    face = getattr(qt_viewer, "_overlay_font", None)
    if type(fonts).__name__ == "QtFontManager" and face is not None:  # vispy's own manager needs an OpenGL context
        font = fonts.get_font(face)
        for letter in "ÅÉÑŐjgpqy":
            yield font[letter] is not None


def _add_when_read(viewer: Viewer) -> None:
    """Read the data in another thread, add the layers below the seed point, and then show the seed point."""
    from napari.layers import Layer
    from napari.utils.notifications import show_error
    from qtpy.QtCore import QTimer

    from voxflat._napari.map_viewer.viewer_parts import show_sagittal
    from voxflat._napari.results.layer_list import drop_controls, insert, make_controls
    from voxflat._napari.timers import PAUSE
    from voxflat._napari.wording import error_text
    from voxflat._napari.worker import JobWorker

    there, earlier = weakref.ref(viewer), weakref.WeakSet(viewer.layers)
    arrived: list[Layer] = []
    steps: deque[Callable[[Viewer], None]] = deque()

    def proceed() -> None:
        """Take a step, and schedule the next one after the window has processed events."""
        shown = there()
        if shown is None:
            return
        if not any(layer.source.sample == _SAMPLE for layer in shown.layers):  # the sample was removed meanwhile
            for layer in arrived:
                if layer not in shown.layers:
                    drop_controls(shown, layer)
            return
        steps.popleft()(shown)
        if steps:
            QTimer.singleShot(PAUSE, proceed)

    def show_seed(viewer: Viewer) -> None:
        for layer in viewer.layers:
            if layer.source.sample == _SAMPLE and layer not in earlier:
                layer.visible = True

    def read(_: Viewer) -> None:
        worker = JobWorker(_cortex, "Demo cortex")
        worker.returned.connect(add)
        worker.errored.connect(lambda error: None if isinstance(error, Cancelled) else show_error(error_text(error)))
        worker.start()

    def add(found: list[LayerData]) -> None:
        """Add the layers, one step at a time."""
        steps.extend(partial(make, data=data) for data in found)
        steps.extend((choose, look, show_seed))  # the seed point, which would fill the view on its own, comes last
        QTimer.singleShot(0, proceed)

    def make(shown: Viewer, data: LayerData) -> None:
        layer = Layer.create(*hidden(data))
        arrived.append(layer)
        make_controls(shown, layer)
        steps.appendleft(partial(show, layer=layer))
        steps.appendleft(partial(insert, layer=layer, index=min(len(arrived) - 1, len(shown.layers))))

    def show(_: Viewer, layer: Layer) -> None:
        layer.visible = True

    def choose(shown: Viewer) -> None:
        if arrived[-1] in shown.layers:
            shown.layers.selection.active = arrived[-1]

    def look(shown: Viewer) -> None:
        if len(shown.layers) == len(arrived) + 1:  # nothing else is open
            show_sagittal(shown)
        shown.reset_view()
        shown.dims.set_point(range(3), SEED_POINT)

    steps.append(read)
    QTimer.singleShot(PAUSE, proceed)
