"""Figures of atlases in the plane: the page of their patches, and the distortion of their triangles."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from voxflat.arguments import checked_instance
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.glued import GluedAtlas
from voxflat.figures.colours import ERRORS, patch_colours
from voxflat.figures.names import plain
from voxflat.io.grid import in_unit


def atlas_page(atlas: Atlas, *, packing: str = "boxes") -> Figure:
    """Draw the pieces of an atlas side by side, coloured by patch.

    All pieces have the same scale, in mm. The colours are the same as in `atlas_3d`, image files and textures. Pieces
    of a glued atlas have black outlines.

    Parameters
    ----------
    atlas : Atlas
        An atlas of patches, or a glued atlas.
    packing : {"boxes", "shapes"}
        How to pack the pieces, as in `FlatAtlas.page`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    See Also
    --------
    atlas_3d : Draw the patches on the surface.

    Examples
    --------
    >>> atlas = voxflat.samples.hill().patches(max_angle=20)
    >>> figure = voxflat.figures.atlas_page(atlas)
    >>> voxflat.figures.save(figure, "atlas_page.svg")
    """
    checked_instance(atlas, Atlas, "atlas", "an atlas")
    places = atlas.layout(packing=packing)
    corners: Any = places[atlas.uv_faces]
    colours = patch_colours(atlas) / 255
    width, height = np.ptp(places, axis=0)
    figure = Figure(figsize=(8.0, float(np.clip(7.2 * height / width, 2.0, 12.0)) + 0.8), layout="constrained")
    axes = figure.add_subplot(aspect="equal", **_labels(atlas))
    axes.add_collection(PolyCollection(corners, facecolor=colours, edgecolor=colours, linewidth=0.1, rasterized=True))
    axes.autoscale()
    if isinstance(atlas, GluedAtlas):  # the colours of patches do not show the outlines of pieces
        axes.add_collection(LineCollection(list(places[atlas.outline]), colors="black", linewidth=0.5, rasterized=True))
    axes.set_title(plain(atlas.title, 80))
    return figure


def atlas_heat_map(atlas: Atlas, pixel_size: float | None = None, *, of: str = "isometric") -> Figure:
    """Draw the distortion of each triangle on the page of an atlas.

    The colours range from 1 (no distortion) to the 99th percentile over the triangles. For changes of area, the colours
    start at the 1st percentile.

    Parameters
    ----------
    atlas : Atlas
        An atlas.
    pixel_size : float, optional
        Side length of a pixel, in mm.
    of : {"isometric", "quasi_conformal", "areal"}
        The measure: C (change of lengths), K (change of angles), or the change of area.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    See Also
    --------
    heat_map : Draw the distance errors of a flat map.

    Examples
    --------
    >>> atlas = voxflat.samples.hill().patches(max_angle=20)
    >>> figure = voxflat.figures.atlas_heat_map(atlas)
    >>> voxflat.figures.save(figure, "atlas_heat_map.png")
    """
    checked_instance(atlas, Atlas, "atlas", "an atlas")
    image = atlas.heat_map(pixel_size, of=of)
    values = getattr(atlas, of)
    least, most = np.nanpercentile(values[np.isfinite(values)], (1, 99))
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    axes = figure.add_subplot(**_labels(atlas))
    low = min(least, 1.0) if of == "areal" else 1.0
    look: dict[str, Any] = {"cmap": ERRORS, "vmin": low, "vmax": max(most, low + 1e-6), "interpolation": "nearest"}
    drawn = axes.imshow(image.data, extent=image.extent, **look)
    figure.colorbar(drawn, ax=axes, label=plain(image.name, 80), extend="both" if of == "areal" else "max", shrink=0.8)
    return figure


def _labels(atlas: Atlas) -> dict[str, Any]:
    unit = in_unit("mm", atlas.origin.named_unit)
    return {"xlabel": unit, "ylabel": unit}
