"""Pictures of an atlas: its patches on a page, and in colours on the surface."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from voxflat.atlases.glued import GluedAtlas
from voxflat.errors import InputError

if TYPE_CHECKING:
    from voxflat.atlases.pieces import FlatPieces

__all__ = ["atlas_3d", "atlas_heat_map", "atlas_page"]

_GOLDEN = 0.6180339887498949  # of a turn between the hues of patches that follow each other


def atlas_page(atlas: FlatPieces, *, packing: str = "boxes") -> Figure:
    """Show the pieces of an atlas side by side on a page, coloured by patch; cuts are black.

    Parameters
    ----------
    atlas : FlatPieces
        An atlas, of patches or glued.
    packing : {"boxes", "shapes"}
        As in `FlatAtlas.page`.

    Returns
    -------
    matplotlib.figure.Figure
        All at the same scale, in mm; colours as in `atlas_3d`.
    """
    places = atlas.layout(packing=packing)
    corners: Any = places[atlas.corners]
    colours = _colours(int(atlas.coloured.max()) + 1)[atlas.coloured]
    width, height = np.ptp(places, axis=0)
    figure = Figure(figsize=(8.0, float(np.clip(7.2 * height / width, 2.0, 12.0)) + 0.8), layout="constrained")
    axes = figure.add_subplot(xlabel="mm", ylabel="mm", aspect="equal")
    axes.add_collection(PolyCollection(corners, facecolor=colours, edgecolor=colours, linewidth=0.1, rasterized=True))
    axes.autoscale()
    if isinstance(atlas, GluedAtlas):  # where pieces end, colours of patches do not show
        axes.add_collection(LineCollection(list(places[atlas.outline]), colors="black", linewidth=0.5, rasterized=True))
    axes.set_title(atlas.title)
    return figure


def atlas_heat_map(atlas: FlatPieces, pixel_size: float | None = None, *, of: str = "isometric") -> Figure:
    """Show the distortion of each triangle on the page of an atlas.

    Parameters
    ----------
    atlas : FlatPieces
        An atlas.
    pixel_size : float, optional
        Side of a pixel, mm.
    of : {"isometric", "quasi_conformal", "areal"}
        C, K, or the change of area.

    Returns
    -------
    matplotlib.figure.Figure
        From 1, no change, to the 99th percentile of the triangles; of areas from the 1st.
    """
    image = atlas.heat_map(pixel_size, of=of)
    values = getattr(atlas, of)
    least, most = np.nanpercentile(values[np.isfinite(values)], (1, 99))
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    axes = figure.add_subplot(xlabel="mm", ylabel="mm")
    low = min(least, 1.0) if of == "areal" else 1.0
    shown = axes.imshow(
        image.data, cmap="inferno", vmin=low, vmax=max(most, low + 1e-6), extent=image.extent, interpolation="nearest"
    )
    figure.colorbar(shown, ax=axes, label=image.name, extend="both" if of == "areal" else "max", shrink=0.8)
    return figure


def atlas_3d(atlas: FlatPieces, *, towards: Any = (0.6, -1.0, 0.5), size: int = 1000) -> NDArray[np.uint8]:
    """Draw the surface with its patches in colours, by PyVista, or by matplotlib where that is missing.

    Parameters
    ----------
    atlas : FlatPieces
        An atlas, of patches or glued.
    towards : sequence of 3 floats
        From where it is seen, RAS+.
    size : int
        Width and height, pixels.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        A picture, for `save_picture`.

    Raises
    ------
    InputError
        If `towards` is no direction.
    """
    direction = np.asarray(towards, dtype=float)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise InputError(f"towards is {towards!r}; give a direction of three numbers")
    colours = (255 * _colours(int(atlas.coloured.max()) + 1)).astype(np.uint8)[atlas.coloured]
    pyvista = _load_pyvista()
    if pyvista is None:
        return _by_matplotlib(atlas, colours, direction, size)
    mesh = pyvista.PolyData.from_regular_faces(atlas.points, atlas.faces)
    mesh.cell_data["colours"] = colours
    with pyvista.vtk_verbosity("error"):  # without a display VTK warns before it draws without
        plotter = pyvista.Plotter(off_screen=True, window_size=[size, size], theme=pyvista.themes.DocumentTheme())
        try:
            plotter.add_mesh(mesh, scalars="colours", rgb=True, ambient=0.35, diffuse=0.75, specular=0.0)
            plotter.view_vector(direction, _up(direction))
            plotter.enable_anti_aliasing("ssaa")
            return np.asarray(plotter.screenshot(return_img=True))[..., :3].copy()
        finally:
            plotter.close()


def _load_pyvista() -> Any:
    """Import PyVista; None where it is missing, or where its VTK is old and would end a process without a display."""
    try:
        import pyvista
    except ImportError:
        return None
    blind = sys.platform == "linux" and "DISPLAY" not in os.environ
    return None if blind and pyvista.vtk_version_info < (9, 4) else pyvista


def _by_matplotlib(
    atlas: FlatPieces, colours: NDArray[np.uint8], direction: NDArray[np.float64], size: int
) -> NDArray[np.uint8]:
    """Draw the triangles from the farthest to the nearest."""
    direction = direction / np.linalg.norm(direction)
    right = np.cross(_up(direction), direction)
    axes_of_view = np.stack([right / np.linalg.norm(right), np.cross(direction, right) / np.linalg.norm(right)])
    corners = atlas.points[atlas.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = normals @ direction / np.linalg.norm(normals, axis=1)
    order = np.argsort((corners.mean(axis=1) @ direction), kind="stable")
    shade = (0.35 + 0.65 * np.abs(facing))[:, None] * colours / 255
    figure = Figure(figsize=(size / 100, size / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), aspect="equal")
    axes.add_collection(
        PolyCollection(corners[order] @ axes_of_view.T, facecolor=shade[order], edgecolor=shade[order], linewidth=0.2)
    )
    axes.autoscale()
    axes.set_axis_off()
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _up(direction: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return superior, or anterior where that is looked along."""
    return (0.0, 1.0, 0.0) if abs(direction[2]) > 0.9 * np.linalg.norm(direction) else (0.0, 0.0, 1.0)


def _colours(count: int) -> NDArray[np.float64]:
    """Return a colour for each patch; those of patches that follow each other are far apart."""
    number = np.arange(count)
    saturation = 0.45 + 0.2 * (number % 3)
    value = 0.95 - 0.13 * (number // 3 % 3)
    return np.asarray(hsv_to_rgb(np.stack([number * _GOLDEN % 1.0, saturation, value], axis=1)))
