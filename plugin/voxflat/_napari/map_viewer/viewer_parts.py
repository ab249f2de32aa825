"""Parts of napari's viewer that differ between versions or can be reached only through its window."""

from collections.abc import Generator
from typing import Any

import numpy as np
from napari import Viewer
from napari.utils.events import Event
from napari.utils.theme import get_theme
from numpy.typing import NDArray
from qtpy.QtGui import QColor
from qtpy.QtWidgets import QWidget

from voxflat._napari.layers.world import from_ras, unit_ratio

_CANVAS = "CanvasBackendDesktop"  # the name of vispy's class
_UNTURNED = ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0))  # degrees; napari's initial 3D view in its versions
_FILLED = 0.9  # fraction of the canvas


def camera(viewer: Viewer) -> Any:
    """Return the camera of the viewer, whose location changed in napari 0.9."""
    return getattr(viewer, "scene", viewer).camera


def list_events(layers: Any) -> tuple[Any, ...]:
    """Return the events of the layer list that are emitted when layers are added, removed or renamed."""
    events = layers.events
    if "renamed" not in events.emitters:  # napari 0.6, which forwards the events of layers
        events.add(renamed=Event)
        events.connect(lambda event: events.renamed() if event.type == "name" else None)
    return events.inserted, events.removed, events.renamed


def look_from_side(viewer: Viewer, *, right: bool, world: str = "RAS") -> None:
    """Turn the 3D view to an upright lateral view of a complete hemisphere."""
    inwards, up = from_ras(np.array([[-1.0 if right else 1.0, 0, 0], [0, 0, 1]]), world).tolist()
    _in_their_order(viewer)
    viewer.reset_view()  # before turning, because a tighter fit would cut off the sides when docks open
    camera(viewer).set_view_direction(inwards, up)


def look_from_above(viewer: Viewer) -> None:
    """Turn the 3D view to a surface in the plane z = constant, with y upwards."""
    _in_their_order(viewer)
    viewer.reset_view()
    camera(viewer).set_view_direction((0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def is_right(points: NDArray[np.floating], structure: str | None) -> bool:
    """Return whether points in RAS belong to a right hemisphere, by its name or else by its position."""
    name = (structure or "").lower()
    return "right" in name if "right" in name or "left" in name else bool(np.mean(points[:, 0]) > 0)


def stand_upright(viewer: Viewer, *, right: bool = False, world: str = "RAS") -> None:
    """Turn the 3D view to an upright lateral view, unless the user has turned it before."""
    if any(np.allclose(camera(viewer).angles, angles) for angles in _UNTURNED):
        look_from_side(viewer, right=right, world=world)


def _in_their_order(viewer: Viewer) -> None:
    """Restore the axis order, the only one in which napari shows surfaces in 3D."""
    viewer.dims.order = tuple(range(viewer.dims.ndim))
    camera(viewer).orientation2d = ("down", "right")  # another orientation would mirror this order


def show_sagittal(viewer: Viewer) -> None:
    """Show sagittal slices of an RAS world, as in atlases, until the viewer is empty."""
    slices = (0, 2, 1), ("up", "right")

    def show(order: tuple[int, ...], orientation: tuple[Any, ...]) -> None:
        viewer.dims.order = order
        camera(viewer).orientation2d = orientation

    def turn() -> None:
        nonlocal slices
        if viewer.dims.ndisplay == 3:
            slices = viewer.dims.order, camera(viewer).orientation2d  # the user may have changed them
            _in_their_order(viewer)
            stand_upright(viewer)
        elif len(slices[0]) == viewer.dims.ndim:
            show(*slices)

    def forget() -> None:
        if not viewer.layers:
            viewer.dims.events.ndisplay.disconnect(turn)
            viewer.layers.events.removed.disconnect(forget)
            camera(viewer).orientation2d = ("down", "right")

    show(*slices)
    viewer.dims.events.ndisplay.connect(turn)
    viewer.layers.events.removed.connect(forget)


class UprightMaps:
    """Turns the 2D view so that images of maps have the top that they have in the dock *Flat map*.

    Once these images are hidden, the slices are shown as before.
    """

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._before: tuple[tuple[int, ...], dict[str, Any]] | None = None  # the axis order, and the camera

    def update(self) -> None:
        viewer = self._viewer
        if viewer.dims.ndisplay == 3:
            return
        is_shown = any(layer.visible and layer.ndim == 2 and layer.metadata.get("voxflat") for layer in viewer.layers)
        view, order = camera(viewer), viewer.dims.order
        if is_shown and self._before is None and order != tuple(range(viewer.dims.ndim)):
            self._before = order, {name: getattr(view, name) for name in ("orientation2d", "center", "zoom")}
            _in_their_order(viewer)
            viewer.reset_view()
        elif not is_shown and self._before is not None:
            (order, look), self._before = self._before, None
            if len(order) == viewer.dims.ndim:
                viewer.dims.order = order
                for name, value in look.items():
                    setattr(view, name, value)


def fill(viewer: Viewer, places: NDArray[np.float64], size: tuple[int, int], world: str = "RAS") -> None:
    """Zoom until points of shape (N, 3), seen in 3D after `look_from_side`, fill a canvas of a given size in pixels."""
    across, up = np.ptp(places @ from_ras(np.array([[0.0, 1, 0], [0, 0, 1]]), world).T, axis=0)
    if across > 0 and up > 0:
        camera(viewer).zoom = _FILLED * min(size[0] / across, size[1] / up)


def is_click(event: Any, most: int = 3) -> Generator[None, None, bool]:
    """Wait for the release in a mouse callback, and return whether the mouse moved by at most a few pixels."""
    pressed = np.asarray(event.pos)
    yield
    while event.type == "mouse_move":
        if np.abs(np.asarray(event.pos) - pressed).max() > most:
            return False
        yield
    return True


def in_grid(viewer: Viewer) -> bool:
    """Return whether the viewer shows its layers in a grid, in which each location is visible several times."""
    return bool((viewer.canvas if hasattr(viewer, "canvas") else viewer).grid.enabled)


def canvas_widget(inside: QWidget) -> QWidget | None:
    """Return the canvas of the viewer, given any widget of its window, or None outside a window."""
    middle = getattr(inside.window(), "centralWidget", lambda: None)()
    children = [] if middle is None else middle.findChildren(QWidget)
    return next((child for child in children if type(child).__name__ == _CANVAS), None)


def projected(viewer: Viewer, place: NDArray[np.float64], size: tuple[int, int]) -> tuple[float, float] | None:
    """Project a world point to a canvas of the given size in pixels; return None if it is behind the camera."""
    view = camera(viewer)
    point = np.asarray(place)[list(viewer.dims.displayed)]
    apart = point - np.asarray(view.center, dtype=np.float64)[-len(point) :]
    middle = np.asarray(size) / 2
    if len(point) == 2:
        vertical, horizontal = map(_named, view.orientation[1:])
        right, down = apart[1] * (1 if horizontal == "right" else -1), apart[0] * (1 if vertical == "down" else -1)
        nearness = 1.0
    else:
        along, up = (np.asarray(way, dtype=np.float64) for way in (view.view_direction, view.up_direction))
        sideways = np.cross(along, up) * (1 if _named(view.handedness) == "right" else -1)
        right, down = float(apart @ sideways), -float(apart @ up)
        away = 0.0 if view.perspective == 0 else 2 * np.tan(np.radians(view.perspective) / 2) * view.zoom / size[1]
        nearness = 1 + away * float(apart @ along)
    if nearness <= 0:
        return None
    x, y = middle + view.zoom * np.array([right, down]) / nearness
    return float(x), float(y)


def _named(way: Any) -> str:
    """Return the name of a direction, which is a string or an enum member depending on the version of napari."""
    return str(way).rpartition(".")[2].lower()


def show_scale_bar(viewer: Viewer) -> None:
    overlays = getattr(getattr(viewer, "canvas", None), "overlays", viewer)  # of the viewer itself before napari 0.9
    overlays.scale_bar.visible = True


def world_units(viewer: Viewer, unit: str) -> NDArray[np.float64]:
    """Return the units of the last three world axes in a unit of length; pixels are treated as this unit."""
    units = viewer.layers.units
    return np.ones(3) if units is None else unit_ratio([*units][-3:], [unit] * 3)


def theme_colours(viewer: Viewer) -> tuple[QColor, QColor]:
    theme = get_theme(viewer.theme)
    canvas, text = (QColor(colour.as_hex()) for colour in (theme.canvas, theme.text))
    return canvas, text
