"""Convert flat maps and atlases to layers: the map, or the page and the surface in the colours of the patches."""

import numpy as np

from voxflat._napari.layers.sampled import Overlay, Shown
from voxflat._napari.layers.world import from_ras
from voxflat._napari.results.flat_layers import FlatLayers, LayerData, described, shown_image, units
from voxflat._napari.results.session import session_of
from voxflat.atlases.atlas import Atlas
from voxflat.maps.colours import label_colours
from voxflat.maps.flat_map import FlatMap
from voxflat.unique_rows import distinct

# the meaning of the colours of the heat map of a map, and of a page
HEAT_MEANING = "the mean relative error of the distances from each point, as a fraction (0.1 is 10 %)"
C_MEANING = "C, the largest factor by which lengths change (1.1 is a change of up to 10 %)"
_HEAT_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)  # few, so that maps can be compared visually


def map_layers(
    flat_map: FlatMap,
    name: str,
    shown: Shown | None = None,
    values: Overlay | None = None,
    pixel_size: float | None = None,
) -> FlatLayers:
    """Draw a flat map and the values that it shows (by default, the mesh values); raises InputError on a mismatch."""
    image = flat_map.heat_map(pixel_size)
    heat = described(flat_map, name, "distortion", HEAT_MEANING, image)
    errors = flat_map.distortion.per_point
    most = np.nanpercentile(errors, 99) if np.isfinite(errors).any() else 1.0
    limit = next((limit for limit in _HEAT_LIMITS if most <= limit), _HEAT_LIMITS[-1])
    heat |= {"colormap": "inferno", "contrast_limits": (0.0, limit)}
    layers: list[LayerData] = [(image.data, heat, "image")]
    shown = values if shown is None else shown
    if shown is not None:
        layers.insert(0, shown_image(flat_map, name, shown, pixel_size))
    return FlatLayers(flat_map, layers, shown=shown)


def page_layers(atlas: Atlas, shown: Shown | None = None, pixel_size: float | None = None) -> FlatLayers:
    """Draw an atlas: its page (patches, values and C), and the surface in the colours of the patches."""
    name = session_of(atlas).layer
    image = atlas.page().label_image(pixel_size)
    patches = described(atlas, name, "patches", "one colour for each patch, as on the surface", image)
    layers: list[LayerData] = [(image.colours(), {**patches, "rgb": True}, "image")]
    if shown is not None:
        layers.append(shown_image(atlas, name, shown, pixel_size))
    image = atlas.heat_map(pixel_size)
    most = max(float(np.nanpercentile(atlas.isometric, 99)), 1.0 + 1e-4)
    heat = {"colormap": "inferno", "contrast_limits": (1.0, most)}
    layers.append((image.data, {**described(atlas, name, "C", C_MEANING, image), **heat}, "image"))
    return FlatLayers(atlas, layers, [_surface(atlas, name)], shown)


def _surface(atlas: Atlas, name: str) -> LayerData:
    """Return the surface, which is cut between patches so that each triangle has the colour of its patch."""
    ends = np.column_stack([np.repeat(atlas.patch_ids, 3), atlas.faces.reshape(-1)])
    edges = distinct(ends)
    owner, rows = edges.rows.T
    colours = label_colours(owner[:, None] + 1.0)[:, 0] / 255
    vertices = from_ras(atlas.space.to_scanner(atlas.points), session_of(atlas).world_axes)[rows]
    look = {"vertex_colors": colours, "shading": "smooth", "features": {"patch": owner}, "units": units(atlas, 3)}
    keywords = {**described(atlas, name, "in patches", "one colour for each patch, as on the page"), **look}
    return (vertices, edges.which.reshape(-1, 3)), keywords, "surface"
