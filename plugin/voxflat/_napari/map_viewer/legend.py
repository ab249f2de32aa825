"""The legend below the map, with anatomical directions, a scale bar and a colour bar."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from qtpy.QtCore import QPointF, QRectF, QSize, Qt
from qtpy.QtGui import QColor, QFont, QImage, QPainter, QPen, QPolygonF
from qtpy.QtWidgets import QSizePolicy, QWidget

from voxflat._napari.map_viewer.pictures import ColourScale

if TYPE_CHECKING:
    from voxflat.figures.marks import Direction

_HEIGHT = 50
_EDGE = 8.0
_ARROW, _LETTER = 13.0, 20.0  # distances from the origin of the arrows
_ARROWS = 54.0  # width of the arrows
_SIDE = 22.0
_LENGTH = 90.0  # largest length of the scale bar
_BAR, _THICK = 240.0, 9.0  # largest width of the colour bar, and its height


class Legend(QWidget):
    """Paints the legend of a map."""

    def __init__(self) -> None:
        super().__init__()
        self._directions: list[Direction] = []
        self._side: str | None = None
        self._pixels, self._unit = 0.0, "mm"
        self._ink = QColor("black")
        self.scale: ColourScale | None = None
        self.setFixedHeight(_HEIGHT)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def minimumSizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        return QSize(160, _HEIGHT)

    def show_marks(self, directions: list[Direction], side: str | None) -> None:
        """Show the anatomical directions, and the hemisphere (L or R) if it is known."""
        self._directions, self._side = directions, side
        self.update()

    def show_length(self, pixels: float, unit: str) -> None:
        """Set the scale of the map, in screen pixels per unit of length."""
        self._pixels, self._unit = pixels, unit
        self.update()

    def show_colours(self, scale: ColourScale | None) -> None:
        self.scale = scale
        self.update()

    def set_ink(self, colour: QColor) -> None:
        self._ink = colour
        self.update()

    def paintEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(self._ink, 1.5))
        x = _EDGE
        if self._directions:
            self._paint_arrows(painter, x)
            x += _ARROWS
        if self._side is not None:
            painter.save()
            painter.setFont(self._font(13, bold=True))
            painter.drawText(QRectF(x, 0, _SIDE, _HEIGHT), Qt.AlignmentFlag.AlignVCenter, self._side)
            painter.restore()
            x += _SIDE
        if self._pixels > 0:
            x = self._paint_length(painter, x)
        if self.scale is not None:
            self._paint_bar(painter, self.scale, x + 2 * _EDGE)
        painter.end()

    def _font(self, size: int, *, bold: bool = False) -> QFont:
        font = QFont(self.font())
        font.setPointSize(size)
        font.setBold(bold)
        return font

    def _paint_arrows(self, painter: QPainter, x: float) -> None:
        towards = [QPointF(direction.u, -direction.v) for direction in self._directions]
        centre = QPointF(x + _ARROWS / 2 - 4, _HEIGHT / 2)
        for way in towards:
            centre -= way * (_LETTER / 2 - 3)
        painter.setFont(self._font(9))
        painter.setBrush(self._ink)
        for axis, way in zip(self._directions, towards, strict=True):
            tip, across = centre + way * _ARROW, QPointF(-way.y(), way.x())
            painter.drawLine(centre, tip)
            painter.drawPolygon(QPolygonF([tip + way * 2, tip - way * 4 + across * 3, tip - way * 4 - across * 3]))
            place = centre + way * _LETTER
            painter.drawText(QRectF(place.x() - 8, place.y() - 8, 16, 16), Qt.AlignmentFlag.AlignCenter, axis.letter)

    def _paint_length(self, painter: QPainter, x: float) -> float:
        from voxflat.figures.marks import round_length

        length = round_length(_LENGTH / self._pixels)
        wide = length * self._pixels
        painter.save()
        painter.setPen(QPen(self._ink, 2.5, Qt.PenStyle.SolidLine, Qt.PenCapStyle.FlatCap))
        painter.drawLine(QPointF(x, 33), QPointF(x + wide, 33))
        painter.restore()
        painter.setFont(self._font(9))
        text = f"{length:g} {self._unit}".rstrip()
        room = max(wide, float(painter.fontMetrics().horizontalAdvance(text)) + 2)
        painter.drawText(QRectF(x, 12, room, 18), Qt.AlignmentFlag.AlignCenter, text)
        return x + room

    def _paint_bar(self, painter: QPainter, scale: ColourScale, x: float) -> None:
        wide = min(_BAR, self.width() - _EDGE - x)
        if wide < 80:
            return
        left = self.width() - _EDGE - wide
        box = QRectF(left, 19, wide, _THICK)
        painter.drawImage(box, QImage(scale.colours.tobytes(), 256, 1, 4 * 256, QImage.Format.Format_RGBA8888))
        painter.save()
        painter.setPen(QPen(self._ink, 0.5))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRect(box)
        painter.restore()
        painter.setFont(self._font(9))
        metrics = painter.fontMetrics()
        title = metrics.elidedText(scale.title, Qt.TextElideMode.ElideRight, int(self.width() - _EDGE - x))
        centred = metrics.horizontalAdvance(title) <= wide
        flags = Qt.AlignmentFlag.AlignHCenter if centred else Qt.AlignmentFlag.AlignRight
        start = left if centred else x
        painter.drawText(QRectF(start, 1, self.width() - _EDGE - start, 16), flags, title)
        from matplotlib.ticker import MaxNLocator  # already imported by the code that drew the map

        low, high = scale.limits
        for value in MaxNLocator(4).tick_values(low, high):
            if low - 1e-9 <= value <= high + 1e-9:
                place = left + wide * (value - low) / ((high - low) or 1.0)
                painter.drawLine(QPointF(place, 19 + _THICK), QPointF(place, 22 + _THICK))
                text = f"{value:g}".replace("-", "−")
                half = metrics.horizontalAdvance(text) / 2 + 1
                place = min(max(place, left + half - _EDGE / 2), self.width() - half)
                painter.drawText(QRectF(place - half, 33, 2 * half, 16), Qt.AlignmentFlag.AlignCenter, text)
