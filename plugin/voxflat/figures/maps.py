"""Figures of what flattening did: `scatter`, `heat_map`, `heat_maps`, `spectrum`."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator

from voxflat.arguments import checked_kind
from voxflat.errors import InputError
from voxflat.evaluation.measure import Comparison
from voxflat.figures.colours import AREA_LABEL, AREAS, ERROR_LABEL, ERRORS, top, top_error
from voxflat.io.grid import in_unit
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatImage

_USED, _POSITIVE, _NEGATIVE = "#c1440e", "#8a9ba8", "#ffffff"
_OUTLINE = "#606060"


def scatter(flat_map: FlatMap) -> Figure:
    """Plot flat against geodesic distances (Grossmann et al. 2002, figures 6, 9 and 10b).

    Parameters
    ----------
    flat_map : FlatMap
        A flat map; `Distortion.scatter` has the pairs.

    Returns
    -------
    matplotlib.figure.Figure
        Colours say how many pairs there are; on the diagonal distances are kept.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> figure = voxflat.figures.scatter(flat_map)
    >>> voxflat.figures.save(figure, "scatter.png")
    """
    checked_kind(flat_map, "flat map", "distortion", "a FlatMap")
    distortion = flat_map.distortion
    geodesic, flat = distortion.scatter.T
    end = 1.03 * float(distortion.scatter.max())
    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    names = (in_unit(name, flat_map.metadata) for name in ("geodesic distance δ (mm)", "flat distance d (mm)"))
    axes = figure.add_subplot(**dict(zip(("xlabel", "ylabel"), names, strict=True)), aspect="equal")
    axes.plot([0, end], [0, end], color="black", linewidth=0.8, zorder=3, label="d = δ")
    shown = axes.hexbin(
        geodesic, flat, gridsize=90, extent=(0, end, 0, end), bins="log", mincnt=1, cmap="viridis", linewidths=0.1
    )
    axes.set(xlim=(0, end), ylim=(0, end))
    axes.legend(loc="upper left", frameon=False)
    _add_colour_bar(axes, shown, f"pairs in a hexagon, of {len(flat)}", ticks=LogLocator(subs=(1, 2, 5)), format="%g")
    raw = distortion.raw
    title = (
        rf"$\bar\varepsilon$ = {raw.absolute_error:.2f} mm,  $\bar\varepsilon_r$ = {100 * raw.relative_error:.1f} %,  "
        rf"$\bar\delta$ = {distortion.mean_geodesic:.1f} mm"
    )
    axes.set_title(in_unit(title, flat_map.metadata))
    return figure


def heat_map(flat_map: FlatMap, pixel_size: float | None = None) -> Figure:
    """Show how well each place's distances are kept.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    pixel_size : float, optional
        Side of a pixel, mm; by default half the voxel size.

    Returns
    -------
    matplotlib.figure.Figure
        Mean relative error in %, from 0 to the 99th percentile of the points: a few torn places would take all colours.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> figure = voxflat.figures.heat_map(flat_map)
    >>> voxflat.figures.save(figure, "heat_map.png")
    """
    checked_kind(flat_map, "flat map", "heat_map", "a FlatMap")
    image = flat_map.heat_map(pixel_size)
    figure, axes = _map_axes(image, flat_map.metadata)
    place: dict[str, Any] = {"extent": image.extent, "origin": "upper", "interpolation": "none", "aspect": "equal"}
    shown = axes.imshow(100 * image.data, cmap=ERRORS, vmin=0, vmax=top_error(flat_map), **place)
    _add_colour_bar(axes, shown, ERROR_LABEL, extend="max")
    return figure


def heat_maps(comparison: Comparison) -> Figure:
    """Show several maps of a surface side by side, in the same colours.

    Parameters
    ----------
    comparison : Comparison
        Judged maps, from `voxflat.compare`.

    Returns
    -------
    matplotlib.figure.Figure
        Above, how well each place's distances are kept, in % from 0 to the 99th percentile over all maps; below, how
        much each place's area has changed, to the 99th percentile either way. The maps are as they are, at scale 1;
        what is undefined is left white.

    Examples
    --------
    >>> surface = voxflat.samples.hill()
    >>> comparison = voxflat.compare(surface, {"seen from above": surface.points[:, :2]})
    >>> figure = voxflat.figures.heat_maps(comparison)
    """
    checked_kind(comparison, "comparison", "maps", "a Comparison, as compare returns it")
    maps = comparison.maps
    errors = [100 * one.distortion.per_point for one in maps.values()]
    areas = [one.distortion.triangles.areal for one in maps.values() if one.distortion.triangles is not None]
    highest, most = (top(np.abs(np.concatenate(values))) for values in (errors, areas))
    figure = Figure(figsize=(1.6 + 4.2 * len(maps), 8.0), layout="constrained")
    grid = figure.subplots(2, len(maps), squeeze=False)
    looks = ((errors, ERRORS, 0.0, highest, ERROR_LABEL, "max"), (areas, AREAS, -most, most, AREA_LABEL, "both"))
    for row, (values, colours, low, high, label, extend) in zip(grid, looks, strict=True):
        for axes, name, value in zip(row, maps, values, strict=True):
            one = maps[name]
            look = {"cmap": colours, "norm": Normalize(low, high), "shading": "gouraud", "rasterized": True}
            defined = one.faces[np.isfinite(value)[one.faces].all(axis=1)]
            if len(defined):
                axes.tripcolor(*one.uv.T, np.nan_to_num(value), triangles=defined, **look)
            u, v = (in_unit(f"{axis} (mm)", {"unit": one.distortion.unit}) for axis in "uv")
            axes.set(aspect="equal", xlabel=u, ylabel=v)
        colour_bar = ScalarMappable(Normalize(low, high), colours)
        figure.colorbar(colour_bar, ax=row.tolist(), label=label, extend=extend)
    for axes, name in zip(grid[0], maps, strict=True):
        axes.set_title(name)
    return figure


def spectrum(flat_map: FlatMap) -> Figure:
    """Plot the eigenvalues of the scaling: two that stand out mean a surface that unfolds into the plane.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.

    Returns
    -------
    matplotlib.figure.Figure
        The eigenvalues of the largest magnitude, by falling magnitude.

    Raises
    ------
    InputError
        If the map was made without sources, and so without a scaling.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten("zigelman2002")
    >>> figure = voxflat.figures.spectrum(flat_map)
    """
    checked_kind(flat_map, "flat map", "eigenvalues", "a FlatMap")
    values = flat_map.eigenvalues
    if len(values) == 0:
        raise InputError("the map was made without sources, so there are no eigenvalues; flatten with sources")
    used = np.argsort(-values)[:2]
    colours = np.where(values < 0, _NEGATIVE, _POSITIVE)
    colours[used] = _USED
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot(xlabel="eigenvalue, by falling magnitude", ylabel=in_unit("|λ| (mm²)", flat_map.metadata))
    rank = np.arange(1, len(values) + 1)
    axes.bar(rank, np.abs(values), color=colours.tolist(), edgecolor="black", linewidth=0.6)
    axes.set_xticks(rank)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(0, 0), useMathText=True)
    kinds = {_USED: "used for the map", _POSITIVE: "other, positive", _NEGATIVE: "other, negative"}
    handles = [Patch(facecolor=colour, edgecolor="black", linewidth=0.6, label=kind) for colour, kind in kinds.items()]
    axes.legend(handles=handles, frameon=False)
    axes.set_title(f"{100 * flat_map.metadata['planarity']:.1f} % of Σλ² lies in the plane")
    return figure


def _map_axes(image: FlatImage, metadata: dict[str, Any]) -> tuple[Figure, Axes]:
    """Return a figure with axes in mm around an image's outline."""
    left, right, bottom, upper = image.extent
    height = float(np.clip(5.0 * (upper - bottom) / (right - left), 2.0, 8.0))
    margin = 0.03 * max(right - left, upper - bottom)
    figure = Figure(figsize=(6.8, height + 0.9), layout="compressed")
    u, v = (in_unit(f"{axis} (mm)", metadata) for axis in "uv")
    axes = figure.add_subplot(xlabel=u, ylabel=v, aspect="equal")
    axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, upper + margin), autoscale_on=False)
    step = image.pixel_size  # a pixel more on each side, where the outline closes
    around = (left - step, right + step, bottom - step, upper + step)
    inside = np.pad(np.isfinite(image.data), 1).astype(float)
    axes.contour(inside, [0.5], colors=_OUTLINE, linewidths=0.6, extent=around, origin="upper")
    return figure, axes


def _add_colour_bar(axes: Axes, shown: Any, label: str, **options: Any) -> None:
    axes.figure.colorbar(shown, ax=axes, label=label, fraction=0.045, pad=0.03, aspect=22, **options)
