"""Make a self-contained, interactive HTML page of a map and its surface for browsers and notebooks."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._core import __version__
from voxflat.arguments import checked_instance, checked_path, checked_text, printable
from voxflat.distortion.triangles import measure_arrays
from voxflat.errors import InputError
from voxflat.figures.colours import LOOKS
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit
from voxflat.lab.pages import Layer, MapLike, colour_bar, filled, layers_of, scene
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.placement import aligned

_PATCHES = ("patch", "piece")  # labels that start at 0
_STEEP = 0.9  # z component of the normal beyond which a surface is viewed from above or below


@dataclass(frozen=True)
class MapPage:
    """An HTML page with a flat map and its surface.

    Notebooks display it automatically.

    Parameters
    ----------
    html : str
        The complete page.

    See Also
    --------
    map_page : Make a page of a flat map.

    Examples
    --------
    >>> page = voxflat.map_page(voxflat.samples.hill().flatten())
    >>> type(page).__name__
    'MapPage'
    """

    html: str

    def __repr__(self) -> str:
        return f"<MapPage: {len(self.html) / 1e6:.1f} MB of HTML>"

    def _repr_html_(self) -> str:
        """Return a frame that holds the page, for notebooks."""
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: 620px; border: 0"></iframe>'

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page to a file.

        The file is self-contained, so that browsers can display it offline.

        Parameters
        ----------
        path : path
            An ``.html`` file.

        Raises
        ------
        InputError
            The name does not end in ``.html`` or ``.htm``.
        """
        path = checked_path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"{path.name}: unknown file name ending {path.suffix!r}. Use a name that ends in .html")
        with atomic_path(path) as beside:
            beside.write_text(self.html, encoding="utf-8", newline="\n")


def map_page(flat_map: FlatMap, title: str = "Flat map") -> MapPage:
    """Show a flat map next to its surface in a notebook or a browser.

    The pointer marks the same point on the map and the surface, and shows its values. The page has a menu of measures
    and a slider that morphs the surface into the map. Larger maps are reduced to about 20,000 points.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    title : str
        Heading of the page.

    Returns
    -------
    MapPage
        The page. Jupyter displays it, and `MapPage.save` writes it to a file.

    See Also
    --------
    voxflat.figures.flat_map : Draw a figure for a paper.

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> flat_map = voxflat.flatten(np.ones((9, 9, 1), dtype=int))
    >>> page = voxflat.map_page(flat_map, "A flat sheet")
    >>> page.save("sheet.html")  # doctest: +SKIP
    """
    checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    of_points, of_triangles = measure_arrays(flat_map.distortion, flat_map.points, flat_map.faces, flat_map.uv)
    anatomy = {"curvature": flat_map.curvature, "sulcaldepth": flat_map.sulcal_depth}
    of_points |= {name: values for name, values in anatomy.items() if values is not None}
    return page_of(flat_map, of_points, of_triangles, title, unit=in_unit("mm", flat_map.origin.named_unit))


def page_of(
    flat: MapLike,
    of_points: Mapping[str, NDArray[Any]],
    of_triangles: Mapping[str, NDArray[Any]],
    title: str,
    *,
    first: str | None = None,
    unit: str = "",
) -> MapPage:
    """Return a page of a surface and its map with named values of points and triangles."""
    faces = flat.faces[~flat.torn]
    here = {name: _at_points(values[~flat.torn], faces, len(flat.uv)) for name, values in of_triangles.items()}
    values = {**of_points, **{name: array for name, array in here.items() if name not in of_points}}
    layers = [_layer(name, values[name], faces) for name in sorted(values, key=lambda name: name != first)]
    if not layers:
        raise InputError("the map has no array with one number per point. Add a point array")
    entries = [{"layer": layer, "bar": colour_bar(layer)} for layer in layers]
    turn, places = aligned(np.column_stack([flat.uv, np.zeros(len(flat.uv))]), flat.points)
    (x, y, z), up = turn[:, 2].tolist(), turn[:, 1]  # the view in which the surface has the orientation of the map
    around = np.arctan2(-up[0] * np.sign(z), up[1] * np.sign(z)) if abs(z) > _STEEP else np.arctan2(x, -y)
    view = float(around), float(np.arcsin(np.clip(z, -1.0, 1.0)))
    content = scene(flat, layers, {}, places, view=view, unit=unit)
    more = {"points": f"{len(flat.uv):,}", "version": __version__}
    return MapPage(
        filled(
            "map.html", key="map", title=printable(checked_text(title, "title")), layers=entries, scene=content, **more
        )
    )


def _layer(name: str, values: NDArray[Any], faces: NDArray[Any]) -> Layer:
    """Return values as a layer: measures in their own colours, labels with one colour each, others as overlays."""
    data = values.astype(np.float64)
    if look := LOOKS.get(name):
        data = look.factor * data
        return Layer(name, look.label, "", data, look.cmap, look.limits(data))
    if name in _PATCHES or _are_labels(values, faces):
        limits = (float(data.min()), float(data.max()))
        return Layer(name, name, "", data, "tab20", limits, 0 if name in _PATCHES else 1)
    return layers_of([{name: data}])[0][0]


def _are_labels(values: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether integers are labels: labels form regions, so most neighbours have the same one."""
    if values.dtype.kind not in "iu" or not len(faces):
        return False
    ends = values[faces]
    return bool(2 * np.mean(ends == np.roll(ends, 1, axis=1)) >= 1)


def _at_points(values: NDArray[Any], faces: NDArray[Any], count: int) -> NDArray[Any]:
    """Return triangle values at points: the majority of integers, whether any boolean is true, or the mean."""
    corners, held = faces.ravel(), np.repeat(values, 3)
    if values.dtype.kind == "f":
        is_known = np.isfinite(held)
        number = np.bincount(corners[is_known], minlength=count)
        summed = np.bincount(corners[is_known], held[is_known].astype(np.float64), count)
        return np.where(number > 0, summed / np.maximum(number, 1), np.nan)
    if values.dtype.kind == "b":
        return np.bincount(corners[held], minlength=count) > 0
    is_known, which = np.unique(held, return_inverse=True)
    pairs, times = np.unique(corners.astype(np.int64) * len(is_known) + which.reshape(-1), return_counts=True)
    order = np.argsort(times, kind="stable")  # the last value written is kept
    majority = np.zeros(count, dtype=values.dtype)
    majority[pairs[order] // len(is_known)] = is_known[pairs[order] % len(is_known)]
    return majority
