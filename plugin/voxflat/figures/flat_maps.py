"""Figures of flat maps for publication: folds, data over them, parcels, names and annotations."""

import re
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, checked_instance, checked_number, checked_text, log, shown
from voxflat.errors import InputError
from voxflat.figures.overlays import Overlay, OverlayColours
from voxflat.figures.page import DARK, LIGHT, STRIP, WHEEL_STRIP, Page
from voxflat.maps.colours import WINDOW
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import outline
from voxflat.maps.parcels import Parcels, are_voxels, check_table, parcels_of
from voxflat.maps.raster import FlatImage, Raster
from voxflat.maps.sampling import Sampling
from voxflat.maps.sources import VolumeSource, source_of

UNDERLAYS = ("curvature", "sulcal depth", "none")  # measures that can show the folds

_LINE, _THIN = 0.5, 0.35  # points
_NO_FOLDS = 0.66  # grey where the folds are unknown
_EDGES = {"curvature": 0.02, "sulcal depth": 0.8}  # values with the lightest or darkest grey, 1/mm and mm
_PARCELS_OPACITY = 0.75
_COLUMN = 85.0  # mm


def flat_map(
    flat_map: FlatMap | Sequence[FlatMap],
    overlay: object | None = None,
    *,
    depth: float | Sequence[float] = 0.0,
    fraction: float | Sequence[float] | None = None,
    layering: str = "equivolume",
    opacity: object | None = None,
    parcels: object | None = None,
    table: object | None = None,
    underlay: str = "curvature",
    title: str | None = None,
    width: float | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw a flat map, or two maps side by side at the same scale.

    The figure shows the folds, data over them, the borders and names of parcels, a scale bar, the names of cuts, and
    the hemisphere or the name of the chart.
    Arrows show anatomical directions at the middle of the map if the space of the surface is known. A warning lists
    names that do not fit into their parcels. PNG files are at least 1,700 pixels wide.

    Parameters
    ----------
    flat_map : FlatMap, or sequence of two
        A flat map, or two maps that share one colour scale, such as those of the left and the right hemisphere, or of
        the front and the back of an embryo.
    overlay : Overlay, path, ndarray, image object or Volume, optional
        Data to draw over the folds: any input that `FlatMap.image` accepts, or an `Overlay` with display options. For
        two maps, pass a volume or CIFTI file that covers both, or a sequence of two inputs.
    depth, fraction : float or sequence of float, optional
        Where to sample overlays and parcels that are volumes, as in `FlatMap.image`.
    layering : str
        The meaning of `fraction`, as in `FlatMap.image`.
    opacity : float, Overlay, path, ndarray, image object or Volume, optional
        Opacity of the overlay: a number from 0 to 1, or a second map, such as t or R². The overlay is transparent where
        that map is 0, and opaque where its magnitude reaches the upper limit of ``Overlay(map, limits=(0, 5))`` or, by
        default, its 99th percentile. The default is 1. Without an overlay, this is the opacity of the parcels, whose
        default is 0.75.
    parcels : path, ndarray, image object, Volume, Regions or Parcels, optional
        Labels whose borders and names are drawn: ``.annot``, ``.label.gii``, ``.dlabel.nii``, one or a list of
        ``.label`` or ``.border`` files, whole numbers (V,) at the vertices, a volume, or regions of the map (``.svg``,
        ``.json``, or from `FlatMap.regions`). Without an overlay, the parcels are filled with the colours of the file.
        For two maps, pass one or two inputs, as for `overlay`.
    table : path, optional
        Names and colours of the parcels, if their file does not contain any: a table such as FreeSurferColorLUT.txt or
        a BIDS dseg.tsv.
    underlay : {"curvature", "sulcal depth", "none"}
        The measure that shows the folds: gyri are light, sulci are dark.
    title : str, optional
        Text above the map.
    width : float, optional
        Width of the figure on paper, in mm. The default is 85 (one column) for one map, and 170 for two. At this width,
        text is at least 6 points in size.
    ax : matplotlib.axes.Axes, optional
        Draw into these axes instead of a new figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, or the figure of `ax`.

    Raises
    ------
    InputError
        If an argument is invalid, or if the overlay does not cover the map.

    See Also
    --------
    movie : Draw each frame of a series.
    save : Write the figure to a file.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> figure = voxflat.figures.flat_map(flat_map, flat_map.points[:, 2], title="height")
    >>> voxflat.figures.save(figure, "height.png")
    """
    maps = maps_of(flat_map)
    checked_text(title, "title")
    checked_choice(underlay, "underlay", UNDERLAYS)
    check_table(parcels, table)
    depths = Depths.of(depth, fraction, layering)
    data = None if overlay is None else Overlay._of(overlay, len(maps))
    check_differ(maps, parcels, opacity, *(() if data is None else (data.values, data.strength)))
    shown_by = _opacity(opacity)
    if data is None and not isinstance(shown_by, float):
        raise InputError(f"opacity is {shown(opacity)}, which requires data. Also pass overlay, or pass a number")
    if data is None and parcels is None and opacity is not None:
        raise InputError(f"opacity is {shown(opacity)}, but there are neither data nor parcels. Pass overlay")
    strip = STRIP if data is None or data.period is None else WHEEL_STRIP
    page = Page.of(maps, _COLUMN * len(maps) if width is None else width, title, strip=strip, axes=ax)
    sides = [_Side(page, n, data, shown_by, parcels, table, depths) for n in range(len(maps))]
    if depths != ON_SURFACE and not any(side.has_volume for side in sides):
        raise InputError("depth and fraction apply only to volumes, but no volume is drawn. Omit depth and fraction")
    full = _full(sides, shown_by)
    colours = None
    if data is not None:
        pooled = _joined([side.image for side in sides])
        assert pooled is not None
        colours = OverlayColours.of(pooled, _joined([side.strength for side in sides]), data)
    for side in sides:
        under = folds(side.flat_map, side.raster, underlay)
        side.panel.image(under, side.raster, "curvature")
        look = under[..., :3].mean(axis=2)
        if colours is not None:
            assert side.image is not None
            over = colours.paint(side.image.data, None if side.strength is None else side.strength.data)
            share = shown_by
            if side.opacity is not None and full is not None:
                share = np.clip(np.abs(np.nan_to_num(side.opacity.data)) / full, 0, 1)
            over[..., 3] = np.round(over[..., 3] * share)
            side.panel.image(over, side.raster, "data")
            look = _over(over, look)
        if side.parcels is not None:
            labels = side.parcels.raster(side.raster)
            if colours is None:
                filled = side.parcels.coloured(labels)
                strength = _PARCELS_OPACITY if opacity is None else shown_by
                filled[..., 3] = np.round(255 * strength * (filled[..., 3] > 0))
                side.panel.image(filled, side.raster, "parcels")
                look = _over(filled, look)
            side.panel.lines(side.parcels.borders, "parcels", _THIN, "black")
            page.names(side.panel, side.parcels, labels, side.raster, look)
        rim = outline(side.flat_map.uv, side.flat_map.faces[~side.flat_map.torn])
        side.panel.lines(rim, "marks", _LINE, "0.25")
    if data is not None and colours is not None:
        label = data.label if data.label is not None else _named(sides[0], *data.thresholds)
        if full is not None and sides[0].opacity is not None:
            label += f", opacity: {_without_folder(sides[0].opacity.name)} from 0 to {full:.3g}"
        if colours.is_cyclic:
            page.wheel(colours, label, data.zero)
        elif colours.colour_map is not None:
            page.bar(colours, label)
    page.marks()
    figure: Figure = page.figure
    return figure


def maps_of(maps_or_map: object) -> list[FlatMap]:
    """Return the maps to draw: one map, or two."""
    maps: list[Any] = list(maps_or_map) if isinstance(maps_or_map, list | tuple) else [maps_or_map]
    if not 1 <= len(maps) <= 2:
        raise InputError(f"got {len(maps)} maps. Pass one map, or two, such as both hemispheres")
    for flat_map in maps:
        checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    return maps


def check_differ(maps: list[FlatMap], *values: object) -> None:
    """Raise an error for two equal maps with the same values."""
    first, *others = maps
    if any(isinstance(value, list | tuple) and len(value) == len(maps) for value in values):
        return
    if any(all(np.array_equal(vars(first)[name], vars(other)[name]) for name in ("uv", "points")) for other in others):
        raise InputError("both maps are the same. Pass two different maps, or an overlay for each of them")


def _opacity(opacity: object) -> Any:
    """Return the opacity as a number, or the map that sets it."""
    if opacity is None:
        return 1.0
    if not isinstance(opacity, int | float | np.number):
        return opacity
    if isinstance(opacity, bool) or not 0 <= checked_number(float(opacity), "opacity") <= 1:
        raise InputError(f"opacity is {shown(opacity)}. Pass a number from 0 to 1, or a map")
    return float(opacity)


class _Side:
    """A map in the figure, with its data."""

    def __init__(
        self, page: Page, number: int, overlay: Overlay | None, opacity: Any, parcels: Any, table: Any, depths: Depths
    ) -> None:
        self.panel, count = page.panels[number], len(page.panels)
        self.flat_map = self.panel.flat_map
        self.raster = self.flat_map.raster(page.pixel_size)
        self.has_volume = False
        self._number, self._count, self._depths = number, count, depths
        self._surface = self.flat_map._triangles.on_surface
        self.image = None if overlay is None else self._sampled(overlay, interpolation=overlay.interpolation)
        strength = None if overlay is None else overlay.strength
        self.strength = None if strength is None else self._sampled(Overlay._of(strength, count))
        is_map = overlay is not None and not isinstance(opacity, float)
        self.opacity = self._sampled(Overlay._of(opacity, count)) if is_map else None
        regions = self._own(parcels)
        if regions is not None and not isinstance(regions, Parcels):
            depths = self._depths_of(are_voxels(self._surface, regions))
            regions = parcels_of(self.flat_map, regions, table=table, depths=depths)
        self.parcels: Parcels | None = regions

    def _own(self, values: Any) -> Any:
        """Return the values of this side if each side has its own; otherwise all values."""
        is_each = isinstance(values, list | tuple) and len(values) == self._count > 1
        return values[self._number] if is_each else values

    def _depths_of(self, is_volume: bool) -> Depths:
        self.has_volume |= is_volume
        return self._depths if is_volume else ON_SURFACE

    def _sampled(self, overlay: Overlay, interpolation: str | None = None) -> FlatImage:
        source = source_of(self._surface, self._own(overlay.values))
        depths = self._depths_of(isinstance(source, VolumeSource))
        sampling = Sampling(depths, "mean", interpolation, overlay.period)
        return source.image(self.raster, sampling, channel=overlay.channel)


def _full(sides: list[_Side], opacity: Any) -> float | None:
    """Return the magnitude of the opacity map at which the overlay becomes opaque."""
    images = [side.opacity for side in sides if side.opacity is not None]
    if not images:
        return None
    if isinstance(opacity, Overlay) and opacity.limits is not None:
        full = max(abs(checked_number(float(end), "limit of the opacity")) for end in opacity.limits)
    else:
        values = np.abs(np.concatenate([image.data[np.isfinite(image.data)].ravel() for image in images]))
        full = float(np.percentile(values, WINDOW[1])) if len(values) else 0.0
    if full <= 0:
        raise InputError("the opacity map is 0 everywhere on the flat map. Check that the affines of the two agree")
    return full


def _joined(images: list[FlatImage | None]) -> FlatImage | None:
    """Return the images of all sides as one image, from which colours are chosen."""
    first = images[0]
    if first is None or len(images) == 1:
        return first
    present = [image for image in images if image is not None]
    data = [image.data.reshape(-1, 1, *image.data.shape[2:]) for image in present]
    return replace(first, data=np.concatenate(data), labels=all(image.is_labels for image in present))


def folds(flat_map: FlatMap, raster: Raster, underlay: str = "curvature") -> NDArray[np.uint8]:
    """Return an RGBA image of the folds: light gyri, dark sulci, and a uniform grey where the folds are unknown."""
    values = {"curvature": flat_map.curvature, "sulcal depth": flat_map.sulcal_depth, "none": None}[underlay]
    grey = np.where(raster.inside, _NO_FOLDS, np.nan)
    if values is None and underlay != "none":
        reason = "its surface has no triangles" if flat_map.has_surface else "it was loaded without its surface"
        log.info("The map has no %s because %s. The map is drawn in uniform grey", underlay, reason)
    if values is not None:
        outwards = raster.interpolate(values if underlay == "curvature" else -values)
        level = np.clip(outwards / _EDGES[underlay], -1, 1)
        grey = np.where(np.isnan(level), grey, DARK + (LIGHT - DARK) * (level + 1) / 2)
    pixels = np.zeros((*raster.shape, 4), dtype=np.uint8)
    pixels[..., :3] = np.round(255 * np.nan_to_num(grey))[..., None]
    pixels[..., 3] = 255 * raster.inside
    return pixels


def _named(side: _Side, above: float | None, below: float | None) -> str:
    """Return the default label of the colour bar: the name of the overlay, and the threshold on its strength."""
    assert side.image is not None
    name = "" if side.image.name == "volume" else _without_folder(side.image.name)
    if side.strength is None:
        return name
    ends = " or ".join(f"{sign} {end:g}" for sign, end in ((">", above), ("<", below)) if end is not None)
    return f"{name}, {_without_folder(side.strength.name)} {ends}"


def _without_folder(name: str) -> str:
    """Return a name without directories: programs such as Workbench use paths as names of maps."""
    return re.sub(r"(^|, )(?:[/~]|[A-Za-z]:)[^,]*[/\\]", r"\1", name)


def _over(pixels: NDArray[np.uint8], grey: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the lightness of pixels over a grey background."""
    share = pixels[..., 3] / 255
    return np.asarray(share * (pixels[..., :3] @ np.array([0.3, 0.59, 0.11])) + (1 - share) * grey)


def map_with_overlay(flat_map_: FlatMap, overlay: object | None = None, *, ax: Any = None, **options: Any) -> Figure:
    """Draw one map; `options` are those of `flat_map` and of `Overlay`."""
    overlay_options = {field.name: options.pop(field.name) for field in fields(Overlay) if field.name in options}
    if overlay_options and isinstance(overlay, Overlay):
        raise InputError(f"{next(iter(overlay_options))} and an Overlay are given. Pass it to the Overlay")
    return flat_map(flat_map_, Overlay(overlay, **overlay_options) if overlay_options else overlay, ax=ax, **options)
