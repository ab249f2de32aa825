"""The examples of ``mesh.voxflat``, a picture of each verb, and what verbs show on fsaverage5: ``pyvista_*``.

The calls of the former are those of the docstrings; they need nothing but PyVista. fsaverage5 comes with nilearn
(``pip install 'voxflat[demo]'``); nothing is downloaded.
"""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from voxflat.io import read_mesh, read_overlay

PICTURES = Path(__file__).parents[1] / "pictures"
SIZE = (1000, 500)
ABOVE = (0, 0, 0.06)  # what lies on a surface is not to be hidden by it
LIGHT = {"ambient": 0.35, "diffuse": 0.75, "specular": 0.0}
HILLS = ((-3, -2, 2.4, 1.6), (3, 1, 3.2, 2.0), (-1, 4, 1.8, 1.4), (2, -5, 2.0, 1.5))  # x, y, height, breadth


def hills() -> pv.DataSet:
    """Return an open surface of quads, 16 by 16."""
    x, y = np.meshgrid(np.linspace(-8, 8, 45), np.linspace(-8, 8, 45), indexing="ij")
    z = sum(height * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * broad**2)) for u, v, height, broad in HILLS)
    return pv.StructuredGrid(x, y, z)


def ball() -> pv.PolyData:
    """Return a sphere, which has to be cut."""
    made: pv.PolyData = pv.Icosphere(nsub=4)
    return made


def board() -> Any:
    """Return a chequered picture."""
    tone = np.kron([[250, 90], [90, 250]], np.ones((32, 32))).astype(np.uint8)
    return np.stack([tone, np.full_like(tone, 170), 255 - tone // 2], axis=-1)


def flatten(name: Path) -> None:
    """``mesh.voxflat()``, shown by ``.plot()``."""
    hills().voxflat().voxflat.plot(off_screen=True, screenshot=name, window_size=SIZE)


def cut(name: Path) -> None:
    """``.cut()``: where it is opened, and its map."""
    opened = ball().voxflat.cut(relax=False)
    opened.clear_field_data()  # and with it what names of its own the map has
    del opened.point_data["vertex_ids"]
    edges = opened.extract_feature_edges(feature_edges=False, manifold_edges=False)
    flat = opened.voxflat()
    plotter = scene()
    plotter.add_mesh(opened, color="#d8d8d4", **LIGHT)
    plotter.add_mesh(edges.scale(1.01), color="#c23b00", line_width=6)  # outside of what it lies on
    plotter.view_vector(np.asarray(edges.points).mean(axis=0))
    plotter.subplot(0, 1)
    plotter.add_mesh(flat, color="#d8d8d4", lighting=False)
    outline = flat.extract_feature_edges(feature_edges=False, manifold_edges=False)
    plotter.add_mesh(outline, color="#c23b00", line_width=6)
    plotter.view_xy()
    plotter.screenshot(name)


def geodesic(name: Path) -> None:
    """``.geodesic(sources)`` and ``.path(a, b)``: distances from two points, and the way between."""
    mesh = hills()
    ends = [230, 1704]
    measured = mesh.voxflat.geodesic(ends, method="exact")
    line = mesh.voxflat.path(*ends)
    bands = measured.contour(12, scalars="geodesic_distance")
    plotter = pv.Plotter(off_screen=True, window_size=[700, 560])
    plotter.set_background("white")
    plotter.add_mesh(measured, cmap="viridis", scalar_bar_args=bar("distance along the surface"), **LIGHT)
    plotter.add_mesh(bands.translate(ABOVE), color="white", line_width=1)
    plotter.add_mesh(line.translate(ABOVE), color="#c23b00", line_width=6)
    look(plotter)
    plotter.camera.zoom(0.85)
    plotter.camera.position, plotter.camera.focal_point = (
        np.subtract(place, (0, 0, 1.5)) for place in (plotter.camera.position, plotter.camera.focal_point)
    )  # room for the bar
    plotter.screenshot(name)


def patches(name: Path) -> None:
    """``.patches()``, shown by ``.plot()``."""
    ball().voxflat.patches(max_angle=25).voxflat.plot(off_screen=True, screenshot=name, window_size=SIZE)


def measure(name: Path) -> None:
    """``.measure(flat)``: how much the shadow of hills changes areas."""
    mesh = hills()
    shadow = np.asarray(mesh.points)[:, :2]
    measured = mesh.voxflat.measure(shadow)
    measured.voxflat.plot("areal", off_screen=True, screenshot=name, window_size=SIZE)


def texture(name: Path) -> None:
    """``.texture(picture)``: a picture on the map, and where it lies on the surface."""
    flat = hills().voxflat()
    size_of_texel = flat.length / 600
    surface, picture = flat.voxflat.texture(board(), size_of_texel, repeat=True)
    plain = surface.copy()
    plain.points = np.asarray(flat.points)
    plotter = scene()
    plotter.add_mesh(surface, texture=picture, smooth_shading=True, **LIGHT)
    look(plotter)
    plotter.subplot(0, 1)
    plotter.add_mesh(plain, texture=picture, lighting=False)
    plotter.view_xy()
    plotter.screenshot(name)


def morph(name: Path) -> None:
    """``.morph(n)``: four of the frames."""
    frames = hills().voxflat.morph(4)
    plotter: Any = pv.Plotter(shape=(1, 4), off_screen=True, window_size=[1200, 340], border=False)
    plotter.set_background("white")
    for number, frame in enumerate(frames):
        plotter.subplot(0, number)
        plotter.add_mesh(frame, scalars="distance_error", cmap="inferno", show_scalar_bar=False, **LIGHT)
        look(plotter)
    plotter.screenshot(name)


def scene() -> Any:
    """Return a plotter with two sides, white."""
    plotter: Any = pv.Plotter(shape=(1, 2), off_screen=True, window_size=list(SIZE), border=False)
    plotter.set_background("white")
    return plotter


def look(plotter: Any) -> None:
    """Look from the front and above."""
    plotter.view_vector((-0.3, -1, 1), viewup=(0, 0, 1))
    plotter.camera.zoom(1.05)


def bar(title: str) -> dict[str, Any]:
    """Return how a colour bar looks."""
    return {"title": f"{title}\n", "color": "black", "n_labels": 3, "fmt": "%.1f", "height": 0.1, "width": 0.6}


def hemisphere() -> pv.PolyData:
    """Load the left white surface of fsaverage5, with its sulcal depth."""
    nilearn = find_spec("nilearn")
    assert nilearn is not None
    assert nilearn.origin is not None
    data = Path(nilearn.origin).parent / "datasets" / "data" / "fsaverage5"
    white = read_mesh(data / "white_left.gii.gz")
    mesh = pv.PolyData.from_regular_faces(white.points, white.faces)
    mesh["sulcal depth"] = read_overlay(data / "sulc_left.gii.gz", mesh.n_points)
    return mesh


def cortex() -> None:
    """Flatten the hemisphere; draw its cuts, the map beside the surface, and the way between."""
    mesh = hemisphere()
    flat = mesh.voxflat(progress_bar=True)
    page = mesh.voxflat.patches(bound=1.5)
    size: Any = {"off_screen": True, "window_size": (1400, 700)}
    flat.voxflat.plot("areal", screenshot=PICTURES / "pyvista_plot.png", **size)
    flat.voxflat.plot("sulcal depth", cmap="gray_r", screenshot=PICTURES / "pyvista_depth.png", **size)
    page.voxflat.plot("patch", screenshot=PICTURES / "pyvista_patches.png", **size)
    frames = flat.voxflat.morph(14)
    frames.save(PICTURES / "pyvista_morph.gif", "sulcal depth", cmap="gray_r", window_size=(400, 400), fps=10)


VERBS: list[Callable[[Path], None]] = [flatten, cut, geodesic, patches, measure, texture, morph]


def main() -> None:
    """Draw them all."""
    cortex()
    for verb in VERBS:
        verb(PICTURES / f"pyvista_verb_{verb.__name__}.png")


if __name__ == "__main__":
    main()
