"""Zigelman, Kimmel, Kiryati (2002) beside Floater (1997), as in the paper's figure 13; and beside ARAP and SLIM.

The surfaces are the paper's, and the part of fsaverage5 that its shipped flat map has. A map is a texture: a picture in
the plane comes to the surface by it, so that what flattening stretches is seen as the size and shape of its squares.
"""

import sys
from pathlib import Path

import numpy as np
import pyvista as pv
from distances_tables import table
from maps_pareto import turned
from maps_tables import COLUMNS, cells, compared, fsaverage5_disk, made_by
from matplotlib.figure import Figure

from voxflat import figures

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "paper"))

import zigelman_surfaces as surfaces

PAPER = "zigelman2002"
HOW = {"method": PAPER, "sources": 625}
"""25 x 25 sources, as in the paper."""

UNIT = 10.0
"""Of sin x sin y, mm."""

WAVES, BUST = "sin x sin y", "bust"
VIEWS = {
    WAVES: ([(60, -95, 115), (31.4, -31.4, 0), (0, 0, 1)], 4.0, 1.0),
    BUST: ([(107, -140, 900), (107, -140, 0), (0, 1, 0)], 10.0, 1.0),
}
"""By the surface: the camera, a square's side, mm, and the zoom."""


def texture(options):
    """Compare maps as textures of the paper's surfaces; print a table and draw chessboards."""
    rows, drawn = [], {}
    for name, (points, faces) in disks().items():
        made = maps_of(points, faces, options)
        comparison = compared(points, faces, made, options.sources)
        rows += [[name, *row_of(maker, comparison[maker], one)] for maker, one in made.items()]
        if name in VIEWS and PAPER in made:
            like = made[PAPER].places
            drawn[name] = {
                maker: chessboard(points, faces, comparison[maker].best_scale.scale * turned(one.places, like), name)
                for maker, one in made.items()
            }
    table("Textures: the paper's method beside Floater's", columns(), rows)
    options.pictures.mkdir(parents=True, exist_ok=True)
    figures.save(side_by_side(drawn), options.pictures / "maps_texture.png")


def disks():
    """Return points, mm, and triangles of surfaces by their names."""
    images = {"cylinder": surfaces.cylinder()[0], WAVES: surfaces.waves(unit=UNIT), BUST: surfaces.bust()}
    found = {name: (image.points, image.faces.astype(np.int64)) for name, image in images.items()}
    return found | {"fsaverage5 white left": fsaverage5_disk("left")[:2]}


def maps_of(points, faces, options):
    """Return the maps of a disk by the paper's method, by Floater's, and by the makers that are asked for."""
    job = {"points": points, "faces": faces}
    paper = made_by(["voxflat"], job | {"options": HOW}, options).get("voxflat")
    others = ["Floater", *(name for name in options.makers if name not in ("Floater", "autoflatten"))]
    return ({} if paper is None else {PAPER: paper}) | made_by(others, job, options)


def columns():
    """Return the columns of the table: what a texture shows beside what all maps are judged by."""
    first, last = COLUMNS[:2], COLUMNS[5:11]
    return ("surface", *first, "CPU s", *last, "angles °", "σ1/σ2", *COLUMNS[11:13])


def row_of(maker, distortion, made):
    """Return the cells of a row of `columns` but for the first."""
    of = cells(distortion, made)
    triangles = distortion.triangles
    shapes = f"{triangles.angle:.1f}", f"{triangles.quasi_conformal:.2f}"
    return [maker, of[0], of[2], *of[4:10], *shapes, *of[10:12]]


def chessboard(points, faces, places, name):
    """Draw a surface with a chessboard that its flat map carries there."""
    camera, side, zoom = VIEWS[name]
    mesh = pv.PolyData.from_regular_faces(points, faces)
    mesh.active_texture_coordinates = (places - places.mean(axis=0)) / (2 * side)
    dark, light = np.array([60, 78, 110], np.uint8), np.array([245, 240, 228], np.uint8)
    is_dark = np.kron([[0, 1], [1, 0]], np.ones((64, 64), dtype=int)) == 1
    board = pv.Texture(np.where(is_dark[..., None], dark, light))
    board.repeat = True
    plotter = pv.Plotter(off_screen=True, window_size=(900, 900))
    plotter.set_background("white")
    plotter.add_mesh(mesh, texture=board, smooth_shading=True, ambient=0.25, diffuse=0.8, specular=0.0)
    plotter.camera_position = camera
    plotter.reset_camera()
    plotter.camera.zoom(zoom)
    plotter.enable_anti_aliasing("ssaa")
    return trimmed(plotter.screenshot(return_img=True))


def trimmed(picture, border=10):
    """Cut off what is white around a picture."""
    rows, across = ((picture < 250).any(axis=2).any(axis=axis).nonzero()[0] for axis in (1, 0))
    top, left = max(rows[0] - border, 0), max(across[0] - border, 0)
    return picture[top : rows[-1] + border, left : across[-1] + border]


def side_by_side(drawn):
    """Put pictures of surfaces, rows, by makers, columns, into one figure."""
    makers = list(next(iter(drawn.values())))
    heights = [max(picture.shape[0] / picture.shape[1] for picture in row.values()) for row in drawn.values()]
    width = 2.9
    figure = Figure(figsize=(width * len(makers), width * sum(heights) + 0.4), layout="constrained")
    grid = figure.subplots(len(drawn), len(makers), squeeze=False, gridspec_kw={"height_ratios": heights})
    for axes, (name, row) in zip(grid, drawn.items(), strict=True):
        for one, maker in zip(axes, makers, strict=True):
            one.set(xticks=[], yticks=[], frame_on=False)
            if maker in row:
                one.imshow(row[maker])
            if one.get_subplotspec().is_first_row():
                one.set_title(maker)
        axes[0].set_ylabel(name)
    return figure
