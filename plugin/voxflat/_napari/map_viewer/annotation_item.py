"""The graphics item for points and shapes on the map, whose size does not depend on the zoom."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt
from qtpy.QtGui import QColor, QPainter, QPainterPath, QPen, QPolygonF
from qtpy.QtWidgets import QGraphicsItem

from voxflat._napari.map_viewer.annotations import OnMap
from voxflat.unique_rows import distinct

_DOT, _LINE, _RIM = 8.0, 2.0, 1.25  # pixels: diameter, line width, and width of the dark rim around both
_HALO = QColor(0, 0, 0, 190)
_TONES = 32  # levels of red, green and blue that are distinguished


class AnnotationItem(QGraphicsItem):
    """Dots and lines on the map, with a dark outline."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: list[tuple[QColor, QPainterPath]] = []
        self._dots: list[tuple[QColor, NDArray[np.float64]]] = []
        self._around = QRectF()
        self.setZValue(4)
        self.setAcceptedMouseButtons(Qt.MouseButton.NoButton)

    def show_annotations(self, annotations: OnMap | None, around: QRectF) -> None:
        """Show annotations within a rectangle of the scene, or show none."""
        self.prepareGeometryChange()
        self._around = around
        self._lines, self._dots = [], []
        if annotations is not None:
            for colour, rows in _by_colour(annotations.line_colours):
                path = QPainterPath()
                for row in rows.tolist():
                    path.addPolygon(polygon(annotations.lines[row]))
                self._lines.append((colour, path))
            self._dots = [(colour, annotations.dots[rows]) for colour, rows in _by_colour(annotations.colours)]
        self.update()

    @property
    def dots(self) -> NDArray[np.float64]:
        """Coordinates (u, v) of the dots in mm, with shape (P, 2)."""
        return np.concatenate([np.empty((0, 2)), *(places for _, places in self._dots)])

    @property
    def lines(self) -> list[QPainterPath]:
        return [path for _, path in self._lines]  # one per colour

    def boundingRect(self) -> QRectF:  # noqa: N802 - Qt's name
        return self._around

    def paint(self, painter: QPainter | None, *_: Any) -> None:
        assert painter is not None
        for colour, path in self._lines:
            for ink, width in ((_HALO, _LINE + 2 * _RIM), (colour, _LINE)):
                painter.strokePath(path, cosmetic_pen(ink, width))
        for colour, places in self._dots:
            dots = polygon(places)
            for ink, width in ((_HALO, _DOT + 2 * _RIM), (colour, _DOT)):
                painter.setPen(cosmetic_pen(ink, width))
                painter.drawPoints(dots)


def _by_colour(colours: NDArray[np.uint8]) -> list[tuple[QColor, NDArray[np.int64]]]:
    """Return the opaque colours, and the rows that have each colour."""
    tones = distinct(colours[:, :3] // (256 // _TONES))
    order = np.argsort(tones.which, kind="stable")
    rows = np.split(order, np.cumsum(tones.counts)[:-1]) if len(order) else []
    return [(QColor(*colours[group[0], :3].tolist()), group) for group in rows]


def cosmetic_pen(colour: QColor, width: float) -> QPen:
    pen = QPen(colour, width, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin)
    pen.setCosmetic(True)
    return pen


def polygon(places: NDArray[np.float64]) -> QPolygonF:
    return QPolygonF([QPointF(u, -v) for u, v in places.tolist()])
