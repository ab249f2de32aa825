"""What flattening did, as pictures: distances, areas, angles; of an atlas its patches, C, K and areas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.map_viewer.pictures import ColourScale, Picture
from voxflat._napari.map_viewer.sheet import Sheet
from voxflat.atlases.atlas import Atlas
from voxflat.figures.colours import AREA_LABEL, AREAS, ERROR_LABEL, ERRORS, top, top_error
from voxflat.maps.colours import label_colours
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatImage

_WEIGHTED = np.spacing(1.0)  # areas of triangles without one


@dataclass(frozen=True)
class Measure:
    """A measure of a map.

    Parameters
    ----------
    name : str
        As it is listed.
    unit : str
        Of its values.
    draw : callable
        Returns its picture on a sheet; of long duration.
    """

    name: str
    unit: str
    draw: Callable[[Sheet], Picture]


def measures(flat_map: FlatMap | Atlas) -> list[Measure]:
    """Return the measures that a map or an atlas has.

    Parameters
    ----------
    flat_map : FlatMap or Atlas
        The map, or the atlas.

    Returns
    -------
    list of Measure
        The first says most.
    """
    if not isinstance(flat_map, FlatMap):
        return [
            Measure("Patches", "", _patches),
            Measure("Lengths, C", "", _lengths),
            Measure("Angles, K", "", _shapes),
            Measure("Areas", "log2", _page_areas),
        ]
    with_triangles = flat_map.distortion.triangles is not None
    return [
        Measure("Distances", "%", _distances),
        *([Measure("Areas", "log2", _areas), Measure("Angles", "°", _angles)] if with_triangles else []),
    ]


def colours(name: str) -> NDArray[np.uint8]:
    """Return a colour map of matplotlib as 256 colours.

    Parameters
    ----------
    name : str
        Its name.

    Returns
    -------
    ndarray of uint8, shape (256, 4)
    """
    from matplotlib import colormaps

    return np.asarray(colormaps[name](np.linspace(0, 1, 256), bytes=True))


def _distances(sheet: Sheet) -> Picture:
    flat_map = _map(sheet)
    errors = 100 * flat_map.distortion.per_point
    return _at_points(sheet, errors, ColourScale(ERROR_LABEL, colours(ERRORS), (0.0, top_error(flat_map))))


def _areas(sheet: Sheet) -> Picture:
    triangles = _map(sheet).distortion.triangles
    assert triangles is not None
    most = top(np.abs(triangles.areal))
    return _at_points(sheet, triangles.areal, ColourScale(AREA_LABEL, colours(AREAS), (-most, most)))


def _angles(sheet: Sheet) -> Picture:
    values = angle_changes(_map(sheet))
    return _at_points(sheet, values, ColourScale("mean change of angles (°)", colours("viridis"), (0.0, top(values))))


def angle_changes(flat_map: FlatMap) -> NDArray[np.float64]:
    """Return by how much the angles of the triangles around each point change on the map, in the mean.

    Parameters
    ----------
    flat_map : FlatMap
        The map.

    Returns
    -------
    ndarray of float64, shape (N,)
        Degrees; NaN where there is no triangle.
    """
    faces = flat_map.faces.astype(np.int64)
    change = np.abs(_corner_angles(flat_map.uv[faces]) - _corner_angles(flat_map.points[faces]))
    count = np.bincount(faces.ravel(), minlength=len(flat_map))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(faces.ravel(), np.degrees(change).ravel(), len(flat_map)) / count)


def _corner_angles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles of triangles (F, 3, 2 or 3), shape (F, 3), radians."""
    to_next, to_last = (np.roll(corners, step, axis=1) - corners for step in (-1, 1))
    lengths = np.linalg.norm(to_next, axis=2) * np.linalg.norm(to_last, axis=2)
    cosines = np.einsum("fcx,fcx->fc", to_next, to_last) / np.maximum(lengths, _WEIGHTED)
    return np.asarray(np.arccos(np.clip(cosines, -1, 1)))


def _patches(sheet: Sheet) -> Picture:
    image = sheet.run.flat_map.page().label_image(sheet.pixel_size)  # type: ignore[union-attr]
    return Picture(label_colours(image.data), image.origin, image.pixel_size, image.data.astype(np.float32))


def _lengths(sheet: Sheet) -> Picture:
    image = _page_image(sheet, "isometric")
    return Picture.of(image, ColourScale("C, factor by which lengths change at most", colours(ERRORS), _from_1(image)))


def _shapes(sheet: Sheet) -> Picture:
    image = _page_image(sheet, "quasi_conformal")
    return Picture.of(image, ColourScale("K, stretch one way by the other", colours("viridis"), _from_1(image)))


def _page_areas(sheet: Sheet) -> Picture:
    image = _page_image(sheet, "areal")
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log2(image.data)
    most = top(np.abs(logs))
    shown = FlatImage(logs, image.pixel_size, image.origin, image.name)
    return Picture.of(shown, ColourScale(AREA_LABEL, colours(AREAS), (-most, most)))


def _page_image(sheet: Sheet, of: str) -> FlatImage:
    page = sheet.run.flat_map.page()  # type: ignore[union-attr]
    image: FlatImage = page.heat_map(sheet.pixel_size, of=of)
    return image


def _from_1(image: FlatImage) -> tuple[float, float]:
    return 1.0, max(top(image.data), 1.0 + 1e-4)


def _map(sheet: Sheet) -> FlatMap:
    flat_map = sheet.run.flat_map
    assert isinstance(flat_map, FlatMap)
    return flat_map


def _at_points(sheet: Sheet, values: NDArray[np.float64], scale: ColourScale) -> Picture:
    """Draw values of the map's points, linearly in between."""
    raster = sheet.planar.raster(sheet.pixel_size)
    image = FlatImage(raster.interpolate(values), raster.pixel_size, raster.origin, scale.title)
    return Picture.of(image, scale)
