"""Draw the regions of highest area distortion on the map (`worst_places`) and on the surface (`worst_places_3d`)."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from voxflat.arguments import checked_instance
from voxflat.figures.colours import AREAS
from voxflat.figures.views_3d import drawn_from_both_sides, load_pyvista
from voxflat.io.grid import in_unit
from voxflat.maps.lines import outline, rim
from voxflat.maps.worst_places import WorstPlaces

_LABEL = "area on the map / on the surface"
_OUTLINE, _CUT, _BORDER = "black", "#1a7f37", "#606060"
_APART = 0.03  # distance of a number from its region, as a share of the map's height
_THICK = 0.0016  # radius of lines on the surface, as a share of its size
_FACTORS = (0.25, 0.5, 0.67, 0.8, 1.0, 1.25, 1.5, 2.0, 4.0)


def worst_places(worst: WorstPlaces) -> Figure:
    """Draw the regions of highest area distortion on the map.

    Colours show the change of area, at the scale that preserves the total area, up to twice `WorstPlaces.beyond` in
    both directions. The regions are outlined and numbered. Green lines are cuts that would reduce the distortion.

    Parameters
    ----------
    worst : WorstPlaces
        The regions, as `voxflat.worst_places` returns them.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    See Also
    --------
    worst_places_3d : Draw the regions on the surface.

    Examples
    --------
    >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
    >>> figure = voxflat.figures.worst_places(worst)
    """
    checked_instance(worst, WorstPlaces, "worst", "WorstPlaces, as returned by voxflat.worst_places")
    flat_map = worst.flat_map
    wide, high = np.ptp(flat_map.uv, axis=0).tolist()
    figure = Figure(figsize=(7.6, float(np.clip(6.4 * high / wide, 2.4, 8.0)) + 0.6), layout="compressed")
    u, v = (in_unit(f"{axis} (mm)", flat_map.origin.named_unit) for axis in "uv")
    axes = figure.add_subplot(xlabel=u, ylabel=v, aspect="equal")
    look: dict[str, Any] = {"cmap": AREAS, "norm": _norm(worst), "rasterized": True}
    axes.tripcolor(*flat_map.uv.T, triangles=flat_map.faces, facecolors=worst.logs, **look)
    _lines(axes, outline(flat_map.uv, flat_map.faces), _BORDER, 0.6)
    for place in worst.places:
        _lines(axes, outline(flat_map.uv, flat_map.faces[place.triangles]), _OUTLINE, 0.9)
        if place.cut is not None:
            _lines(axes, [place.cut.uv], _CUT, 1.4)
    middle = (flat_map.uv.min(axis=0) + flat_map.uv.max(axis=0)) / 2
    for place in worst.places:
        towards = middle - place.uv
        u, v = (place.uv + _APART * high * towards / max(float(np.linalg.norm(towards)), 1e-9)).tolist()
        text = axes.text(u, v, str(place.number), ha="center", va="center", size=10, weight="bold", zorder=5)
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
    bar = figure.colorbar(
        ScalarMappable(look["norm"], AREAS), ax=axes, label=_LABEL, fraction=0.045, pad=0.03, aspect=22, extend="both"
    )
    factors = [factor for factor in _FACTORS if abs(np.log2(factor)) <= look["norm"].vmax]
    bar.set_ticks(np.log2(factors).tolist(), labels=[f"{factor:g}" for factor in factors])
    return figure


def worst_places_3d(worst: WorstPlaces, *, size: tuple[int, int] = (1800, 800)) -> NDArray[np.uint8]:
    """Draw the regions of highest area distortion on the surface.

    The image shows the surface from outside and from the opposite side, in the colours of `worst_places`. The numbers
    of hidden regions are in parentheses.

    Parameters
    ----------
    worst : WorstPlaces
        The regions, as `voxflat.worst_places` returns them.
    size : tuple of 2 ints
        Width and height in pixels.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        An image for `save_picture`.

    Raises
    ------
    InputError
        If PyVista is missing or cannot draw.

    See Also
    --------
    worst_places : Draw the regions on the map.

    Examples
    --------
    >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
    >>> voxflat.figures.worst_places_3d(worst, size=(200, 100)).shape
    (100, 200, 3)
    """
    checked_instance(worst, WorstPlaces, "worst", "WorstPlaces, as returned by voxflat.worst_places")
    pyvista = load_pyvista()
    flat_map, norm = worst.flat_map, _norm(worst)
    patch = pyvista.PolyData.from_regular_faces(flat_map.points, flat_map.faces.astype(np.int64))
    patch.cell_data["areas"] = worst.logs
    material = {"scalars": "areas", "cmap": AREAS, "clim": (norm.vmin, norm.vmax), "show_scalar_bar": False}
    meshes = [(patch, {**material, "ambient": 0.5, "diffuse": 0.6, "specular": 0.0})]
    thick = _THICK * float(np.linalg.norm(np.ptp(flat_map.points, axis=0)))
    for place in worst.places:
        lines = [flat_map.points[line] for line in rim(flat_map.faces[place.triangles], len(flat_map))]
        meshes += [(pyvista.lines_from_points(line).tube(radius=thick), {"color": _OUTLINE}) for line in lines]
        if place.cut is not None:
            meshes.append((pyvista.lines_from_points(place.cut.points).tube(radius=1.4 * thick), {"color": _CUT}))
    numbers = [(place.point, str(place.number)) for place in worst.places]
    return drawn_from_both_sides(flat_map, meshes, numbers, size)


def _norm(worst: WorstPlaces) -> TwoSlopeNorm:
    most = 1 + float(np.log2(worst.beyond))
    return TwoSlopeNorm(0.0, -most, most)


def _lines(axes: Axes, lines: list[NDArray[np.float64]], colour: str, width: float) -> None:
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, capstyle="round", zorder=4))
