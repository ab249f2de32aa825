"""From atlases to napari's layers: the page of all patches, and the surface in their colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.sampled import Shown
from voxflat._napari.layers.world import from_ras
from voxflat._napari.results.flat_layers import FlatLayers, LayerData, description, placement, shown_image, units
from voxflat.atlases.atlas import Atlas
from voxflat.maps.colours import label_colours
from voxflat.unique_rows import distinct

C_MEANING = "C, the factor by which lengths change at most (1.1 is up to 10 %)"
"""What the colours of a page's heat map mean."""


def page_layers(atlas: Atlas, shown: Shown | None = None, pixel_size: float | None = None) -> FlatLayers:
    """Draw an atlas: its page as patches in colours, what it is to show and C, and the surface in the same colours.

    Its metadata's ``napari`` say from which layer it is. Raises InputError if something does not fit.
    """
    name = atlas.metadata["napari"]["layer"]
    layers = [_patches_image(atlas, name, pixel_size)]
    if shown is not None:
        layers.append(shown_image(atlas, shown, pixel_size))
    layers.append(_heat_image(atlas, name, pixel_size))
    return FlatLayers(atlas, layers, [_surface(atlas, name)], shown)


def _patches_image(atlas: Atlas, name: str, pixel_size: float | None) -> LayerData:
    image = atlas.page().label_image(pixel_size)
    keywords = {
        "name": f"{name} patches",
        "rgb": True,
        **placement(atlas, image),
        **description(atlas, "a colour for each patch, as on the surface"),
    }
    return image.colours(), keywords, "image"


def _heat_image(atlas: Atlas, name: str, pixel_size: float | None) -> LayerData:
    image = atlas.heat_map(pixel_size)
    most = float(np.nanpercentile(atlas.isometric, 99))
    keywords = {
        "name": f"{name} C",
        "colormap": "inferno",
        "contrast_limits": (1.0, max(most, 1.0 + 1e-4)),
        **placement(atlas, image),
        **description(atlas, C_MEANING),
    }
    return image.data, keywords, "image"


def _surface(atlas: Atlas, name: str) -> LayerData:
    """Return the surface, cut open between patches, so that each triangle has the colour of its patch alone."""
    ends = np.column_stack([np.repeat(atlas.patch_ids, 3), atlas.faces.reshape(-1)])
    (owner, rows), faces = _unique(ends)
    colours = label_colours(owner[:, None] + 1.0)[:, 0] / 255
    vertices = from_ras(atlas.space.to_scanner(atlas.points), atlas.metadata["napari"]["world_axes"])[rows]
    flat_units = units(atlas)
    keywords = {
        "name": f"{name} in patches",
        "vertex_colors": colours,
        "shading": "smooth",
        "features": {"patch": owner},
        "units": None if flat_units is None else ("mm",) * 3,
        **description(atlas, "a colour for each patch, as on the page"),
    }
    return (vertices, faces.reshape(-1, 3)), keywords, "surface"


def _unique(pairs: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two columns of the different pairs, in their order, and which of them each pair is."""
    found = distinct(pairs)
    return found.rows.T, found.which
