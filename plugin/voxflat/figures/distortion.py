"""Draw the distortion of flat maps: `scatter`, `heat_map`, `heat_maps`, `spectrum`."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator

from voxflat.arguments import checked_instance
from voxflat.errors import InputError
from voxflat.evaluation.measure import Comparison
from voxflat.figures.colours import AREA_LABEL, AREAS, ERROR_LABEL, ERRORS, HEATS, top
from voxflat.figures.names import plain
from voxflat.io.grid import in_unit, rounded
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatImage

_USED, _POSITIVE, _NEGATIVE = "#c1440e", "#8a9ba8", "#ffffff"
_OUTLINE = "#606060"


def scatter(flat_map: FlatMap) -> Figure:
    """Plot flat distances against geodesic distances.

    Pairs on the diagonal have the same distance on the map and on the surface. Colours show the number of pairs. The
    plot follows figures 6, 9 and 10b of Grossmann et al. (2002).

    Parameters
    ----------
    flat_map : FlatMap
        A flat map. The pairs are those of `Distortion.scatter`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    See Also
    --------
    heat_map : Draw the distance error of each point.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> figure = voxflat.figures.scatter(flat_map)
    >>> voxflat.figures.save(figure, "scatter.png")
    """
    checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    distortion = flat_map.distortion
    geodesic, flat = distortion.scatter.T
    end = 1.03 * float(distortion.scatter.max())
    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    x, y = (in_unit(name, flat_map.origin.named_unit) for name in ("geodesic distance δ (mm)", "flat distance d (mm)"))
    axes = figure.add_subplot(xlabel=x, ylabel=y, aspect="equal")
    axes.plot([0, end], [0, end], color="black", linewidth=0.8, zorder=3, label="d = δ")
    options: Any = {"gridsize": 90, "bins": "log", "mincnt": 1, "cmap": "viridis", "linewidths": 0.1}
    bins = axes.hexbin(geodesic, flat, extent=(0, end, 0, end), **options)
    axes.set(xlim=(0, end), ylim=(0, end))
    axes.legend(loc="upper left", frameon=False)
    _add_colour_bar(axes, bins, f"pairs per hexagon (of {len(flat)})", ticks=LogLocator(subs=(1, 2, 5)), format="%g")
    absolute, relative = distortion.raw.absolute_error, 100 * distortion.raw.relative_error
    errors = rf"$\bar\varepsilon$ = {rounded(absolute, 2)} mm,  $\bar\varepsilon_r$ = {relative:.1f} %"
    title = rf"{errors},  $\bar\delta$ = {rounded(distortion.mean_geodesic, 1)} mm"
    axes.set_title(in_unit(title, flat_map.origin.named_unit))
    return figure


def heat_map(flat_map: FlatMap, pixel_size: float | None = None, *, of: str = "distances") -> Figure:
    """Draw the mean relative error of the distances from each point, in %, or the spread between the people of a group.

    The colours range from 0 to the 99th percentile over the points, so a few torn regions do not dominate the scale.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    pixel_size : float, optional
        Side length of a pixel, in mm. The default is half the voxel size.
    of : {"distances", "spread"}
        The values, as in `FlatMap.heat_map`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    See Also
    --------
    heat_maps : Draw several maps side by side.
    patch_3d : Draw the same colours on the surface.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> figure = voxflat.figures.heat_map(flat_map)
    >>> voxflat.figures.save(figure, "heat_map.png")
    """
    checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    image = flat_map.heat_map(pixel_size, of=of)
    figure, axes = _map_axes(image, flat_map.origin.named_unit)
    place: dict[str, Any] = {"extent": image.extent, "origin": "upper", "interpolation": "none", "aspect": "equal"}
    look, values = HEATS[of], flat_map.spread if of == "spread" else flat_map.distortion.per_point
    assert values is not None
    least, most = look.limits(look.factor * values)
    colours = axes.imshow(look.factor * image.data, cmap=look.cmap, vmin=least, vmax=most, **place)
    _add_colour_bar(axes, colours, look.label, extend="max")
    return figure


def heat_maps(comparison: Comparison) -> Figure:
    """Draw the distortion of several maps of a surface side by side.

    The upper row shows the mean relative error of distances, in %, from 0 to the 99th percentile over all maps. The
    lower row shows the change of area, up to the 99th percentile of its magnitude. The maps are not rescaled. Undefined
    values are white.

    Parameters
    ----------
    comparison : Comparison
        The maps, as `voxflat.compare` returns them.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    See Also
    --------
    heat_map : Draw one map.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> comparison = voxflat.compare(surface, {"seen from above": surface.points[:, :2]})
    >>> figure = voxflat.figures.heat_maps(comparison)
    """
    checked_instance(comparison, Comparison, "comparison", "a Comparison, as returned by voxflat.compare")
    maps = comparison.maps
    errors = [100 * flat_map.distortion.per_point for flat_map in maps.values()]
    areas = [
        flat_map.distortion.triangles.areal for flat_map in maps.values() if flat_map.distortion.triangles is not None
    ]
    highest, most = (top(np.abs(np.concatenate(values))) for values in (errors, areas))
    figure = Figure(figsize=(1.6 + 4.2 * len(maps), 8.0), layout="constrained")
    grid = figure.subplots(2, len(maps), squeeze=False)
    looks = ((errors, ERRORS, 0.0, highest, ERROR_LABEL, "max"), (areas, AREAS, -most, most, AREA_LABEL, "both"))
    for row, (values, colours, low, high, label, extend) in zip(grid, looks, strict=True):
        for axes, name, value in zip(row, maps, values, strict=True):
            flat_map = maps[name]
            look = {"cmap": colours, "norm": Normalize(low, high), "shading": "gouraud", "rasterized": True}
            defined = flat_map.faces[np.isfinite(value)[flat_map.faces].all(axis=1)]
            if len(defined):
                axes.tripcolor(*flat_map.uv.T, np.nan_to_num(value), triangles=defined, **look)
            u, v = (in_unit(f"{axis} (mm)", flat_map.distortion.unit) for axis in "uv")
            axes.set(aspect="equal", xlabel=u, ylabel=v)
        colour_bar = ScalarMappable(Normalize(low, high), colours)
        figure.colorbar(colour_bar, ax=row.tolist(), label=label, extend=extend)
    for axes, name in zip(grid[0], maps, strict=True):
        axes.set_title(plain(name.replace(", chart ", "\nchart "), 80))
    return figure


def spectrum(flat_map: FlatMap) -> Figure:
    """Plot the eigenvalues of classical scaling.

    The eigenvalues of largest magnitude are drawn in descending order. If two of them are much larger than the others,
    the surface unfolds into the plane with little distortion.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If the map has no eigenvalues because it was made without sources.

    See Also
    --------
    scatter : Plot distances on the map against distances on the surface.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten("zigelman2002")
    >>> figure = voxflat.figures.spectrum(flat_map)
    """
    checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    values = flat_map.eigenvalues
    if flat_map.period is not None:
        raise InputError("a periodic map has no eigenvalues, because distances around a tube are not those in a plane")
    if len(values) == 0:
        reason = "the map has no eigenvalues because it was made without sources"
        raise InputError(f"{reason}. Flatten with sources=3 or more")
    used = np.argsort(-values)[:2]
    colours = np.where(values < 0, _NEGATIVE, _POSITIVE)
    colours[used] = _USED
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    magnitude = in_unit("|λ| (mm²)", flat_map.origin.named_unit)
    axes = figure.add_subplot(xlabel="eigenvalue, in descending order of magnitude", ylabel=magnitude)
    rank = np.arange(1, len(values) + 1)
    axes.bar(rank, np.abs(values), color=colours.tolist(), edgecolor="black", linewidth=0.6)
    axes.set_xticks(rank)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(0, 0), useMathText=True)
    kinds = {_USED: "used for the map", _POSITIVE: "other, positive", _NEGATIVE: "other, negative"}
    handles = [Patch(facecolor=colour, edgecolor="black", linewidth=0.6, label=kind) for colour, kind in kinds.items()]
    axes.legend(handles=handles, frameon=False)
    planarity: Any = flat_map.details.get("planarity")
    if planarity is not None:
        axes.set_title(f"{100 * planarity:.1f} % of Σλ² lies in the plane")
    return figure


def _map_axes(image: FlatImage, unit: str) -> tuple[Figure, Axes]:
    """Return a figure and its axes, in mm, with the outline of an image."""
    left, right, bottom, upper = image.extent
    height = float(np.clip(5.0 * (upper - bottom) / (right - left), 2.0, 8.0))
    margin = 0.03 * max(right - left, upper - bottom)
    figure = Figure(figsize=(6.8, height + 0.9), layout="compressed")
    u, v = (in_unit(f"{axis} (mm)", unit) for axis in "uv")
    axes = figure.add_subplot(xlabel=u, ylabel=v, aspect="equal")
    axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, upper + margin), autoscale_on=False)
    step = image.pixel_size  # one more pixel on each side, so that the outline closes
    around = (left - step, right + step, bottom - step, upper + step)
    inside = np.pad(np.isfinite(image.data), 1).astype(float)
    axes.contour(inside, [0.5], colors=_OUTLINE, linewidths=0.6, extent=around, origin="upper")
    return figure, axes


def _add_colour_bar(axes: Axes, colours: Any, label: str, **options: Any) -> None:
    axes.figure.colorbar(colours, ax=axes, label=label, fraction=0.045, pad=0.03, aspect=22, **options)
