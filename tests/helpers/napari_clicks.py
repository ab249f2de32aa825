"""A simulated user of napari's window: menus, buttons, boxes, file dialogs, and the mouse over a canvas."""

from napari._qt.dialogs.qt_notification import NapariQtNotification
from napari_window import PATIENCE
from qtpy.QtCore import QPoint, QPointF, Qt, QTimer
from qtpy.QtGui import QWheelEvent
from qtpy.QtWidgets import QApplication, QComboBox, QFileDialog, QLineEdit


class Hand:
    """Use a window like a user; `qtbot` of pytest-qt presses keys and buttons."""

    def __init__(self, window, qtbot):
        self._window = window._qt_window
        self._qtbot = qtbot

    def menu(self, *path):
        """Choose a menu entry by the texts on its path; a final `…` can be omitted."""
        menu = self._window.menuBar()
        for text in path[:-1]:
            menu = _entry(menu, text).menu()
            menu.aboutToShow.emit()
        _entry(menu, path[-1]).trigger()
        QApplication.processEvents()

    def press(self, button):
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
        assert field.isVisible()
        edit = field.findChild(QLineEdit)
        edit.selectAll()
        self._qtbot.keyClicks(edit, text)
        self._qtbot.keyClick(edit, Qt.Key.Key_Return)

    def answer(self, path, kind=None):
        """Enter a file name, and choose a file type by its beginning, in the dialog that the next step opens."""

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
        move(self._qtbot, widget, at)

    def click(self, widget, at):
        self.move(widget, at)
        self._qtbot.mouseClick(widget, Qt.MouseButton.LeftButton, pos=at)

    def wheel(self, widget, clicks):
        """Turn the wheel over the middle of a widget; a positive number of clicks zooms in."""
        at = QPointF(widget.rect().center())
        for _ in range(abs(clicks)):
            turned = QPoint(0, 120 if clicks > 0 else -120)
            keys = Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier
            where = at, QPointF(widget.mapToGlobal(at.toPoint()))
            event = QWheelEvent(*where, QPoint(), turned, *keys, Qt.ScrollPhase.NoScrollPhase, False)
            QApplication.sendEvent(widget, event)
        QApplication.processEvents()

    def wait(self, done):
        self._qtbot.waitUntil(done, timeout=PATIENCE)

    def picture(self, path):
        """Save a picture of the window without notifications."""
        for notification in self._window.findChildren(NapariQtNotification):
            notification.close()
        QApplication.processEvents()
        path.parent.mkdir(parents=True, exist_ok=True)
        assert self._window.grab().save(str(path))


def move(qtbot, widget, at):
    """Move the mouse to a position in a widget, from a position beside it."""
    for shift in (3, 0):
        qtbot.mouseMove(widget, at + QPoint(shift, shift))
        QApplication.processEvents()


def _entry(menu, text):
    """Return an action of a menu by its text, without mnemonics and a final ellipsis."""
    found = [action for action in menu.actions() if action.text().replace("&", "").rstrip(".…") == text.rstrip(".…")]
    texts = [action.text() for action in menu.actions()]
    assert found, f"{text!r} is not among {texts}"
    return found[0]
