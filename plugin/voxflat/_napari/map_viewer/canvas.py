"""The canvas on which a map is drawn, moved and zoomed; it uses only Qt, so that it opens and responds quickly."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt, Signal  # type: ignore[attr-defined]  # qtpy makes it of pyqtSignal
from qtpy.QtGui import QColor, QImage, QPainter, QPainterPath, QPixmap
from qtpy.QtWidgets import QFrame, QGraphicsPathItem, QGraphicsPixmapItem, QGraphicsScene, QGraphicsView, QSizePolicy

from voxflat._napari.map_viewer.annotation_item import AnnotationItem, cosmetic_pen, polygon
from voxflat._napari.map_viewer.annotations import OnMap
from voxflat._napari.map_viewer.cursor import RingItem
from voxflat._napari.map_viewer.pictures import Picture
from voxflat._napari.results.sketch import Place, Polygon
from voxflat.maps.colours import label_colour

_MARGIN = 0.03  # margin around the map, as a fraction of the map size
_CLICK = 4  # pixels; a longer movement is not a click
_STEP = 1.2  # zoom factor per notch of the wheel
_CLOSEST = 80.0  # pixels per mm
_RIM = QColor(64, 64, 64)
_DRAWN = (255, 210, 63)  # the colour of corners and of the lines between them


class MapCanvas(QGraphicsView):
    """Shows a map in mm; the y axis of the scene points downwards, so y equals −v."""

    pointed = Signal(float, float)  # emitted with the position (u, v) of the mouse, mm
    clicked = Signal(float, float)  # emitted with the position (u, v) of a click, mm
    double_clicked = Signal()  # emitted after a double click
    left = Signal()  # emitted when the mouse leaves the canvas
    zoomed = Signal()  # emitted when the scale changes

    def __init__(self) -> None:
        super().__init__()
        self._scene = QGraphicsScene(self)
        self.setScene(self._scene)
        self.folds = self._pixmap(0)
        self.picture = self._pixmap(1)
        self._rim = QGraphicsPathItem()
        self._rim.setPen(cosmetic_pen(_RIM, 1.2))
        self._rim.setZValue(2)
        self.drawn, self.annotations, self.ring = AnnotationItem(), AnnotationItem(), RingItem()
        for item in (self._rim, self.drawn, self.annotations, self.ring):
            self._scene.addItem(item)
        self._is_fitted = True
        self._pressed: Any = None
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
        self.setTransformationAnchor(QGraphicsView.ViewportAnchor.AnchorUnderMouse)
        self.setResizeAnchor(QGraphicsView.ViewportAnchor.AnchorViewCenter)
        self.setDragMode(QGraphicsView.DragMode.ScrollHandDrag)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(160, 120)
        self.setMouseTracking(True)

    def _pixmap(self, z: int) -> QGraphicsPixmapItem:
        item = QGraphicsPixmapItem()
        item.setTransformationMode(Qt.TransformationMode.SmoothTransformation)
        item.setZValue(z)
        item.setShapeMode(QGraphicsPixmapItem.ShapeMode.BoundingRectShape)
        self._scene.addItem(item)
        return item

    def show_map(self, folds: Picture, rim: list[NDArray[np.float64]]) -> None:
        """Show another map, with its outline over the folds, fitted to the canvas."""
        self._put(self.folds, folds)
        self.show_picture(None)
        self.show_annotations(None)
        self._rim.setPath(_path(rim))
        around = self._map_rect()
        wide = max(around.width(), around.height())
        self._scene.setSceneRect(around.adjusted(-wide, -wide, wide, wide))  # so that every point can be centred
        self.fit()

    def hide_map(self) -> None:
        self.folds.setPixmap(QPixmap())
        self._rim.setPath(QPainterPath())
        self.show_picture(None)
        self.show_annotations(None)

    def show_picture(self, picture: Picture | None) -> None:
        """Show a picture over the folds, or only the folds."""
        self.picture.setVisible(picture is not None)
        if picture is not None:
            self._put(self.picture, picture)

    def show_drawn(self, regions: Sequence[Polygon], corners: Polygon, dots: Sequence[Place]) -> None:
        """Show regions, each in the colour of its number, the corners of the next one, and dots; all in mm."""
        lines = [np.array([*region, region[0]]) for region in regions] + ([np.array(corners)] if corners else [])
        colours = np.array([*map(label_colour, range(1, len(regions) + 1)), _DRAWN], dtype=np.uint8)
        of_dots = np.tile(colours[-1:], (len(dots), 1))
        drawn = OnMap(np.array(dots).reshape(-1, 2), of_dots, lines, colours[: len(lines)], "")
        self.drawn.show_annotations(drawn, self._scene.sceneRect())

    def show_annotations(self, annotations: OnMap | None) -> None:
        self.annotations.show_annotations(annotations, self._map_rect())

    def place_ring(self, place: tuple[float, float] | None) -> None:
        """Place the ring at (u, v) in mm, or hide it."""
        self.ring.setVisible(place is not None)
        if place is not None:
            self.ring.setPos(place[0], -place[1])

    def fit(self) -> None:
        """Fit the whole map to the canvas."""
        self._is_fitted = True
        around = self._map_rect()
        if not around.isEmpty():
            x, y = _MARGIN * around.width(), _MARGIN * around.height()
            self.fitInView(around.adjusted(-x, -y, x, y), Qt.AspectRatioMode.KeepAspectRatio)
            self.zoomed.emit()

    def centre(self, place: tuple[float, float]) -> None:
        self._is_fitted = False
        self.centerOn(place[0], -place[1])

    @property
    def scale_factor(self) -> float:
        return float(self.transform().m11())  # pixels per mm

    def position(self, u: float, v: float) -> Any:
        """Return the viewport position, in pixels, of the point (u, v), in mm."""
        return self.mapFromScene(QPointF(u, -v))

    def _put(self, item: QGraphicsPixmapItem, picture: Picture) -> None:
        height, width = picture.pixels.shape[:2]
        image = QImage(picture.pixels.tobytes(), width, height, 4 * width, QImage.Format.Format_RGBA8888)
        item.setPixmap(QPixmap.fromImage(image))  # copies the image
        item.setScale(picture.pixel_size)
        u, v = picture.origin
        item.setPos(u - picture.pixel_size / 2, -v - picture.pixel_size / 2)

    def _map_rect(self) -> QRectF:
        return self._rim.path().boundingRect()

    def mouseMoveEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        super().mouseMoveEvent(event)
        place = self.mapToScene(event.position().toPoint())
        self.pointed.emit(place.x(), -place.y())

    def mousePressEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        super().mousePressEvent(event)
        self._pressed = event.position() if event.button() == Qt.MouseButton.LeftButton else None

    def mouseReleaseEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        super().mouseReleaseEvent(event)
        self._point_out()
        if self._pressed is None:
            return
        moved = event.position() - self._pressed
        self._pressed = None
        if max(abs(moved.x()), abs(moved.y())) <= _CLICK:
            place = self.mapToScene(event.position().toPoint())
            self.clicked.emit(place.x(), -place.y())
        else:
            self._is_fitted = False

    def mouseDoubleClickEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        self.double_clicked.emit()

    def enterEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        super().enterEvent(event)
        self._point_out()

    def leaveEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        super().leaveEvent(event)
        self.left.emit()

    def wheelEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        factor = _STEP ** (event.angleDelta().y() / 120)
        if factor != 1 and (factor < 1 or self.scale_factor * factor <= _CLOSEST):
            self._is_fitted = False
            self.scale(factor, factor)
            self.zoomed.emit()

    def resizeEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        super().resizeEvent(event)
        if self._is_fitted:
            self.fit()

    def _point_out(self) -> None:
        """Show a cross cursor instead of a hand, which would hide the map below it."""
        viewport = self.viewport()
        assert viewport is not None
        viewport.setCursor(Qt.CursorShape.CrossCursor)


def _path(lines: list[NDArray[np.float64]]) -> QPainterPath:
    """Return lines of the map as a Qt path."""
    path = QPainterPath()
    for line in lines:
        path.addPolygon(polygon(line))
    return path
