"""A map and its surface in one page of HTML, for a browser or a notebook: no other file, no network."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from voxflat._core import __version__
from voxflat.errors import InputError
from voxflat.figures.colours import LOOKS
from voxflat.io.files import atomic_path
from voxflat.lab.pages import Laid, Layer, colour_bar, filled, layers_of, scene

__all__ = ["MapPage", "map_page"]


@dataclass(frozen=True)
class MapPage:
    """A page of HTML; a notebook shows it by itself.

    Parameters
    ----------
    html : str
        All of it.
    """

    html: str

    def __repr__(self) -> str:
        return f"<MapPage: {len(self.html) / 1e6:.1f} MB of HTML>"

    def _repr_html_(self) -> str:
        """Return a frame that holds the page; called by notebooks."""
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: 620px; border: 0"></iframe>'

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page.

        Parameters
        ----------
        path : path
            An ``.html`` file.

        Raises
        ------
        InputError
            If it has another ending.
        OSError
            If it cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"cannot save a page as {path.name}; give a name that ends in .html")
        with atomic_path(path) as beside:
            beside.write_text(self.html, encoding="utf-8")


def map_page(flat: Laid, laid: NDArray[np.float64], values: Mapping[str, NDArray[np.float64]], title: str) -> MapPage:
    """Return a page with a surface and its map, linked, and a slider from one to the other.

    Parameters
    ----------
    flat : Laid
        The map.
    laid : ndarray of float64, shape (N, 3)
        The map's points, laid near the surface.
    values : dict of str to ndarray of float64, shape (N,)
        What can be shown, by its name: measures (`voxflat.distortion.triangles`) and any other; the first one at first.
    title : str
        Of the page.

    Returns
    -------
    MapPage

    Raises
    ------
    InputError
        If there is nothing to show.
    """
    layers = _layers(values)
    if not layers:
        raise InputError("the map has no array with a number a point: there is nothing to show")
    shown = [{"layer": layer, "bar": colour_bar(layer)} for layer in layers]
    count = f"{len(flat.uv):,}"
    content = scene(flat, layers, {}, laid)
    return MapPage(
        filled("map.html", key="map", title=title, layers=shown, scene=content, points=count, version=__version__)
    )


def _layers(values: Mapping[str, NDArray[np.float64]]) -> Sequence[Layer]:
    """Return values as layers: measures with their own look, others as overlays have it."""
    found = {layer.name: layer for layer in layers_of([{n: v for n, v in values.items() if n not in LOOKS}])[0]}
    for name in values.keys() & LOOKS.keys():
        look = LOOKS[name]
        shown = look.factor * values[name]
        found[name] = Layer(name, look.label, "", shown, look.cmap, look.limits(shown))
    return [found[name] for name in values]
