"""A simulated user of napari's window: menus, buttons, boxes, file dialogs, and the mouse over a canvas."""

from napari_window import PATIENCE
from qtpy.QtCore import QPoint, QPointF, Qt, QTimer
from qtpy.QtGui import QWheelEvent
from qtpy.QtWidgets import QApplication, QComboBox, QFileDialog, QLineEdit


class Hand:
    """Uses a window as a user does; pytest-qt's `qtbot` presses keys and buttons."""

    def __init__(self, window, qtbot):
        self._window = window._qt_window
        self._qtbot = qtbot

    def menu(self, *path):
        """Choose an entry of a menu by the texts that lead there; `…` at its end may be left out."""
        menu = self._window.menuBar()
        for text in path[:-1]:
            menu = _entry(menu, text).menu()
            menu.aboutToShow.emit()
        _entry(menu, path[-1]).trigger()
        QApplication.processEvents()

    def press(self, button):
        """Press a visible button."""
        assert button.isVisible(), button.text()
        assert button.isEnabled(), button.text()
        self._qtbot.mouseClick(button, Qt.MouseButton.LeftButton)

    def choose(self, box, text):
        """Choose an entry of a box by the beginning of its text."""
        assert box.isVisible()
        row = next(row for row in range(box.count()) if box.itemText(row).startswith(text))
        box.showPopup()
        view = box.view()
        view.scrollTo(box.model().index(row, 0))
        place = view.visualRect(box.model().index(row, 0)).center()
        self._qtbot.mouseClick(view.viewport(), Qt.MouseButton.LeftButton, pos=place)
        self._qtbot.waitUntil(lambda: box.currentIndex() == row)

    def type(self, field, text):
        """Replace the text of a field, and press Return."""
        assert field.isVisible()
        edit = field.findChild(QLineEdit)
        edit.selectAll()
        self._qtbot.keyClicks(edit, text)
        self._qtbot.keyClick(edit, Qt.Key.Key_Return)

    def answer(self, path, kind=None):
        """Enter a file, and the beginning of its kind, in the dialog that the next step opens."""

        def type_name():
            dialog = QApplication.activeModalWidget()
            if not isinstance(dialog, QFileDialog):
                QTimer.singleShot(50, type_name)
                return
            if kind is not None:
                kinds = dialog.findChild(QComboBox, "fileTypeCombo")
                row = next(row for row in range(kinds.count()) if kinds.itemText(row).startswith(kind))
                kinds.setCurrentIndex(row)
                kinds.activated.emit(row)
            edit = dialog.findChild(QLineEdit, "fileNameEdit")
            edit.setText(str(path))
            self._qtbot.keyClick(edit, Qt.Key.Key_Return)

        QTimer.singleShot(50, type_name)

    def move(self, widget, at):
        """Move the mouse to a place of a widget."""
        move(self._qtbot, widget, at)

    def click(self, widget, at):
        """Click on a place of a widget."""
        self.move(widget, at)
        self._qtbot.mouseClick(widget, Qt.MouseButton.LeftButton, pos=at)

    def wheel(self, widget, clicks):
        """Turn the wheel over the middle of a widget, by a number of clicks that is positive to zoom in."""
        at = QPointF(widget.rect().center())
        for _ in range(abs(clicks)):
            turned = QPoint(0, 120 if clicks > 0 else -120)
            keys = Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier
            where = at, QPointF(widget.mapToGlobal(at.toPoint()))
            event = QWheelEvent(*where, QPoint(), turned, *keys, Qt.ScrollPhase.NoScrollPhase, False)
            QApplication.sendEvent(widget, event)
        QApplication.processEvents()

    def wait(self, done):
        """Wait until something is true."""
        self._qtbot.waitUntil(done, timeout=PATIENCE)

    def picture(self, path):
        """Take a picture of the window."""
        QApplication.processEvents()
        path.parent.mkdir(parents=True, exist_ok=True)
        assert self._window.grab().save(str(path))


def move(qtbot, widget, at):
    """Move the mouse to a place of a widget, from one beside it."""
    for shift in (3, 0):
        qtbot.mouseMove(widget, at + QPoint(shift, shift))
        QApplication.processEvents()


def _entry(menu, text):
    """Return an action of a menu by its text, without key marks and the ellipsis of a dialog."""
    found = [action for action in menu.actions() if action.text().replace("&", "").rstrip(".…") == text.rstrip(".…")]
    texts = [action.text() for action in menu.actions()]
    assert found, f"{text!r} is not among {texts}"
    return found[0]
