"""Pictures of the distortion: distances, areas, angles and spread for a map; patches, C, K and areas for an atlas."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.map_viewer.pictures import ColourScale, Picture
from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.results.flat_layers import MovieMaps
from voxflat.atlases.atlas import Atlas
from voxflat.distortion.triangles import angle_changes
from voxflat.maps.colours import label_colours
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatImage

DISTANCES = "Distances"  # the measure that the line below the map always shows


@dataclass(frozen=True)
class Measure:
    """A measure of a map, whose picture is slow to draw."""

    name: str
    unit: str
    draw: Callable[[PreparedMap], Picture]


def measures(flat_map: FlatMap | Atlas) -> list[Measure]:
    """Return the measures of a map or an atlas, starting with the most important one."""
    if not isinstance(flat_map, FlatMap):
        return [
            Measure("Patches", "", _patches),
            Measure("Lengths, C", "", partial(_of_page, "isometric")),
            Measure("Angles, K", "", partial(_of_page, "quasi_conformal")),
            Measure("Areas", "log2", partial(_of_page, "areal")),
        ]
    of_triangles = [Measure("Areas", "log2", _areas), Measure("Angles", "°", _angles)]
    of_triangles = of_triangles if flat_map.distortion.triangles is not None else []
    of_group = [] if flat_map.spread is None else [Measure("Spread between people", "", _spread)]
    return [Measure(DISTANCES, "%", _distances), *of_triangles, *of_group]


def growth(movie: MovieMaps) -> Measure:
    """Return the measure of a movie: by how much the surface has grown between the flattened frame and each frame."""

    def draw(prepared: PreparedMap) -> Picture:
        series = movie.series
        factors = series.stretches(series.reference if prepared.frame is None else prepared.frame, series.reference)
        values = np.log2(factors.prod(axis=1))
        return _at_points(prepared, values, replace(_scale("areal", values), title="area growth (log2)"))

    return Measure(f"Growth since frame {movie.series.reference}", "log2", draw)


def _distances(prepared: PreparedMap) -> Picture:
    errors = 100 * _map(prepared).distortion.per_point
    return _at_points(prepared, errors, _scale("distance_error", errors))


def _areas(prepared: PreparedMap) -> Picture:
    triangles = _map(prepared).distortion.triangles
    assert triangles is not None
    return _at_points(prepared, triangles.areal, _scale("areal", triangles.areal))


def _angles(prepared: PreparedMap) -> Picture:
    flat_map = _map(prepared)
    values = angle_changes(flat_map.points, flat_map.faces, flat_map.uv)
    return _at_points(prepared, values, _scale("angle", values))


def _spread(prepared: PreparedMap) -> Picture:
    spread = _map(prepared).spread
    assert spread is not None
    return _at_points(prepared, spread, _scale("spread", spread))


def _patches(prepared: PreparedMap) -> Picture:
    image = prepared.run.flat_map.page().label_image(prepared.pixel_size)  # type: ignore[union-attr]
    return Picture(label_colours(image.data), image.origin, image.pixel_size, image.data.astype(np.float32))


def _of_page(name: str, prepared: PreparedMap) -> Picture:
    page = prepared.run.flat_map.page()  # type: ignore[union-attr]
    image: FlatImage = page.heat_map(prepared.pixel_size, of=name)
    if name == "areal":
        with np.errstate(divide="ignore", invalid="ignore"):
            image = replace(image, data=np.log2(image.data))
    return Picture.of(image, _scale(name, image.data.astype(np.float64)))


def _scale(name: str, values: NDArray[np.float64]) -> ColourScale:
    from matplotlib import colormaps

    from voxflat.figures.colours import HEATS, LOOKS

    look = (LOOKS | HEATS)[name]
    colours = colormaps[look.cmap](np.linspace(0, 1, 256), bytes=True)
    return ColourScale(look.label, np.asarray(colours), look.limits(values))


def _map(prepared: PreparedMap) -> FlatMap:
    flat_map = prepared.run.flat_map
    assert isinstance(flat_map, FlatMap)
    return flat_map


def _at_points(prepared: PreparedMap, values: NDArray[np.float64], scale: ColourScale) -> Picture:
    """Draw values at the points of the map, with linear interpolation."""
    raster = prepared.planar.raster(prepared.pixel_size)
    image = FlatImage(raster.interpolate(values), raster.pixel_size, raster.origin, scale.title)
    return Picture.of(image, scale)
