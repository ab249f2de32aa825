"""The ring that marks the same location on the map and in the viewer."""

from typing import Any

from qtpy.QtCore import QEvent, QPointF, QRectF, Qt
from qtpy.QtGui import QColor, QPainter, QPen
from qtpy.QtWidgets import QGraphicsItem, QWidget

from voxflat._napari.timers import single_shot

SIZE = 25.0  # side of the square around the ring, pixels

_RADIUS = 6.0
_REST = 200  # ms
_COLOUR, _HALO = QColor("#ffd23f"), QColor(0, 0, 0, 190)


def paint_ring(painter: QPainter, centre: QPointF) -> None:
    """Paint the ring in pixels, so that it is visible on light and dark backgrounds."""
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    for colour, width in ((_HALO, 4.0), (_COLOUR, 2.0)):
        painter.setPen(QPen(colour, width, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        painter.drawEllipse(centre, _RADIUS, _RADIUS)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            towards = QPointF(x, y)
            painter.drawLine(centre + towards * _RADIUS, centre + towards * (_RADIUS + 4))


class RingItem(QGraphicsItem):
    """The ring on the map; its size does not depend on the zoom."""

    def __init__(self) -> None:
        super().__init__()
        self.setFlag(QGraphicsItem.GraphicsItemFlag.ItemIgnoresTransformations)
        self.setZValue(10)
        self.hide()

    def boundingRect(self) -> QRectF:  # noqa: N802 - Qt's name
        return QRectF(-SIZE / 2, -SIZE / 2, SIZE, SIZE)

    def paint(self, painter: QPainter | None, *_: object) -> None:
        assert painter is not None
        paint_ring(painter, QPointF(0, 0))


class RingWidget(QWidget):
    """The ring over the canvas of the viewer; it is not a layer, so moving it does not redraw the scene."""

    def __init__(self, canvas: QWidget) -> None:
        super().__init__(canvas)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setAttribute(Qt.WidgetAttribute.WA_NoSystemBackground)
        self.setFixedSize(int(SIZE), int(SIZE))
        self.is_near = True
        self._has_moved = False
        self._rest = single_shot(self, _REST, canvas.update)
        self.hide()
        canvas.installEventFilter(self)

    def show_at(self, x: float, y: float, *, near: bool) -> None:
        """Show the ring at a canvas position in pixels, faintly if the marked location is not in the slice."""
        self._has_moved = True
        self.is_near = near
        self.move(round(x - SIZE / 2), round(y - SIZE / 2))
        self.show()
        self.update()

    def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802 - Qt's name
        """Repaint the canvas below the ring only once the ring has stopped moving."""
        if event.type() != QEvent.Type.Paint or not self._has_moved:
            return False
        self._has_moved = False
        self._rest.start()
        return True

    def paintEvent(self, event: object) -> None:  # noqa: N802 - Qt's name
        painter = QPainter(self)
        painter.setOpacity(1.0 if self.is_near else 0.4)
        paint_ring(painter, QPointF(SIZE / 2, SIZE / 2))
        painter.end()
