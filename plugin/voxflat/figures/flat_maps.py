"""The figure of a flat map that one reads: folds, data over them, parcels, names and marks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, checked_kind, checked_number, checked_text, log, shown
from voxflat.errors import InputError
from voxflat.figures.overlays import Overlay, OverlayColours
from voxflat.figures.paper import DARK, LIGHT, STRIP, WHEEL_STRIP, Page
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.lines import outline
from voxflat.maps.parcels import Parcels, parcels_of
from voxflat.maps.raster import FlatImage, Raster
from voxflat.maps.sampler import Sampler

__all__ = ["UNDERLAYS", "check_underlay", "flat_map", "folds"]

UNDERLAYS = ("curvature", "sulcal depth", "none")
"""What the folds may be shown by."""

_LINE, _THIN = 0.5, 0.35  # points
_NO_FOLDS = 0.66  # grey where nothing is known
_EDGES = {"curvature": 0.02, "sulcal depth": 0.8}  # from where on it is all gyrus or sulcus, 1/mm, mm
_PARCELS_OPACITY = 0.75


def flat_map(
    flat_map: FlatMap,
    overlay: object | None = None,
    *,
    depth: float | Sequence[float] = 0.0,
    fraction: float | Sequence[float] | None = None,
    layering: str = "equivolume",
    opacity: float | None = None,
    parcels: object | None = None,
    table: object | None = None,
    underlay: str = "curvature",
    title: str | None = None,
    width: float = 85.0,
) -> Figure:
    """Show a flat map: its folds in two greys, over them data and parcels, and marks to find one's way.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    overlay : Overlay, path, ndarray, image object or Volume, optional
        Data over the folds: everything that `FlatMap.image` takes, or an `Overlay` that says how they are shown.
    depth, fraction, layering
        As in `FlatMap.image`, of overlay and parcels, as far as they are volumes.
    opacity : float, optional
        Of the overlay, from 0 to 1; by default 1. Without an overlay that of the parcels, by default 0.75.
    parcels : path, ndarray, image object, Volume or Parcels, optional
        Labels, as in `parcels_of`: their borders and names, and without an overlay their colours, as the file has them.
    table : path, optional
        Names and colours of the parcels where their file has none: as FreeSurferColorLUT.txt, or a dseg.tsv of BIDS.
    underlay : {"curvature", "sulcal depth", "none"}
        What the folds are shown by: gyri are light, sulci dark.
    title : str, optional
        Above the map.
    width : float
        Of the figure on paper, mm: 85 for one column, 170 for two. Fonts have 6 points or more at this size.

    Returns
    -------
    matplotlib.figure.Figure
        1,700 pixels wide or more in PNG. The directions of the body are those at the middle of the map, of a surface
        whose space is known. Names that have no room in their parcel are left out, and it is said how many.

    Raises
    ------
    InputError
        As in `FlatMap.image`; if a value is none of those above, or the overlay lies elsewhere than the map.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> figure = voxflat.figures.flat_map(flat_map, flat_map.points[:, 2], title="height")
    >>> voxflat.figures.save(figure, "height.png")
    """
    checked_kind(flat_map, "flat map", "eigenvalues", "a FlatMap")
    checked_text(title, "title")
    check_underlay(underlay)
    of = None if overlay is None else Overlay._of(overlay)
    strength = None if of is None or of.strength is None else Overlay._of(of.strength)
    if opacity is not None and not 0 <= checked_number(opacity, "opacity") <= 1:
        raise InputError(f"the opacity is {shown(opacity)}; give a number from 0 to 1")
    depths = Depths.of(depth, fraction, layering)
    sampler = flat_map._triangles.on_surface
    given = {"overlay": of and of.values, "strength": strength and strength.values, "parcels": parcels}
    in_volume = {name for name, values in given.items() if _is_volume(sampler, values)}
    if depths != ON_SURFACE and not in_volume:
        raise InputError("depth and fraction are for volumes: neither overlay nor parcels is one; leave them out")
    page = Page.of(flat_map, width, title, strip=STRIP if of is None or of.period is None else WHEEL_STRIP)
    raster = flat_map.raster(page.pixel_size)
    under = folds(flat_map, raster, underlay)
    page.image(under, raster, "curvature")
    look = under[..., :3].mean(axis=2)
    of_parcels = depths if "parcels" in in_volume else ON_SURFACE
    areas = None if parcels is None else _parcels(flat_map, parcels, table, of_parcels)
    if of is not None:
        where = {name: depths if name in in_volume else ON_SURFACE for name in ("overlay", "strength")}
        how: dict[str, Any] = {"interpolation": of.interpolation, "period": of.period, "depths": where["overlay"]}
        image, by = sampler.image(raster, of.values, channel=of.channel, **how), None
        if strength is not None:
            by = sampler.image(raster, strength.values, channel=strength.channel, depths=where["strength"])
        colours = OverlayColours.of(image, of, 1.0 if opacity is None else opacity, by)
        over = colours.paint(image.data, None if by is None else by.data)
        page.image(over, raster, "data")
        look = _over(over, look)
        told = of.label if of.label is not None else _named(image, by, of.above, of.below)
        if colours.is_cyclic:
            page.wheel(colours, told, of.zero)
        elif colours.colour_map is not None:
            page.bar(colours, told)
    if areas is not None:
        labels = areas.raster(raster)
        if of is None:
            filled = areas.coloured(labels)
            filled[..., 3] = np.round(255 * (_PARCELS_OPACITY if opacity is None else opacity) * (filled[..., 3] > 0))
            page.image(filled, raster, "parcels")
            look = _over(filled, look)
        page.lines(areas.borders, "parcels", _THIN, "black")
        page.names(areas, labels, raster, look)
    page.lines(outline(flat_map.uv, flat_map.faces[~flat_map.torn]), "marks", _LINE, "0.25")
    page.marks(flat_map)
    return page.figure


def check_underlay(underlay: str) -> None:
    """Refuse what the folds are not shown by."""
    checked_choice(underlay, "underlay", UNDERLAYS)


def folds(flat_map: FlatMap, raster: Raster, underlay: str = "curvature") -> NDArray[np.uint8]:
    """Return the grey picture of the folds: gyri light, sulci dark.

    `flat_map`: a flat map; one without curvature (of the method "grossmann2002") has an even grey. `raster`: its
    pixels. `underlay`, {"curvature", "sulcal depth", "none"}: what they are told by. Returns: uint8 (H, W, 4), opacity
    0 outside the map.
    """
    values = {"curvature": flat_map.curvature, "sulcal depth": flat_map.sulcal_depth, "none": None}[underlay]
    grey = np.where(raster.inside, _NO_FOLDS, np.nan)
    if values is None and underlay != "none":
        log.info("the map has no %s, whose surface has no triangles: it is shown in an even grey", underlay)
    if values is not None:
        outwards = raster.interpolate(values if underlay == "curvature" else -values)
        level = np.clip(outwards / _EDGES[underlay], -1, 1)
        grey = np.where(np.isnan(level), grey, DARK + (LIGHT - DARK) * (level + 1) / 2)
    pixels = np.zeros((*raster.shape, 4), dtype=np.uint8)
    pixels[..., :3] = np.round(255 * np.nan_to_num(grey))[..., None]
    pixels[..., 3] = 255 * raster.inside
    return pixels


def _named(image: FlatImage, by: FlatImage | None, above: float | None, below: float | None) -> str:
    """Return what the colour bar says of its own: the overlay, and where it is shown if that is not to be seen."""
    name = "" if image.name == "volume" else image.name
    if by is None:
        return name
    ends = " or ".join(f"{sign} {end:g}" for sign, end in ((">", above), ("<", below)) if end is not None)
    return f"{name}, {by.name} {ends}"


def _over(pixels: NDArray[np.uint8], grey: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return how light it is where pixels lie over a grey."""
    share = pixels[..., 3] / 255
    return np.asarray(share * (pixels[..., :3] @ np.array([0.3, 0.59, 0.11])) + (1 - share) * grey)


def _is_volume(sampler: Sampler, values: object) -> bool:
    return not (values is None or isinstance(values, Parcels) or sampler.is_overlay(values))


def _parcels(flat_map: FlatMap, parcels: object, table: object, depths: Depths) -> Parcels:
    if isinstance(parcels, Parcels):
        return parcels
    return parcels_of(flat_map, parcels, table=table, depths=depths)
