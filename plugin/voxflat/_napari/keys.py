"""Keyboard shortcuts of a dock, which work in the viewer and in the dock while the dock is open."""

from collections.abc import Callable, Mapping

from app_model.backends.qt import QKeyBindingSequence
from app_model.types import KeyBinding
from napari import Viewer
from qtpy.QtCore import Qt
from qtpy.QtGui import QKeySequence, QShortcut  # type: ignore[attr-defined]  # in another module in Qt 5
from qtpy.QtWidgets import QWidget


def key_text(key: int) -> str:
    """Return the name of a key of app-model (`KeyMod` and `KeyCode`) on this system, such as Ctrl+Z."""
    return str(QKeyBindingSequence(KeyBinding.from_int(key)).toString(QKeySequence.SequenceFormat.NativeText))


class Keys:
    """Binds keys in the dock and on napari's canvas, and keeps existing key bindings of the viewer."""

    def __init__(
        self,
        viewer: Viewer,
        dock: QWidget,
        actions: Mapping[int, Callable[[], object]],
        of_dock: Mapping[int, Callable[[], object]] | None = None,  # bound only in the dock
    ) -> None:
        self._viewer = viewer
        self._bound: list[int] = []
        for key, act in {**actions, **(of_dock or {})}.items():
            shortcut = QShortcut(QKeyBindingSequence(KeyBinding.from_int(key)), dock)
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            shortcut.activated.connect(act)
            if key in actions and KeyBinding.from_int(key) not in viewer.keymap:
                viewer.bind_key(key, _for_viewer(act))
                self._bound.append(key)

    def release(self) -> None:
        for key in self._bound:
            self._viewer.bind_key(key, None)
        self._bound = []


def _for_viewer(act: Callable[[], object]) -> Callable[[Viewer], None]:
    def pressed(viewer: Viewer) -> None:  # must be a function, because napari reads its name
        act()

    return pressed
