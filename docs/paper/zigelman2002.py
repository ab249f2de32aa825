"""Reproduce Zigelman, Kimmel, Kiryati (2002): print the results of the paper and of voxflat, and draw the figures.

make paper-zigelman
"""

import numpy as np
import paper
import pyvista as pv
from grossmann2002 import bricks, chessboard
from matplotlib.figure import Figure
from paper import PICTURES, fsaverage5, reproduce, row, shapes, show, timed
from scipy import ndimage
from scipy.spatial.distance import pdist

import voxflat
from voxflat import figures
from voxflat._pyvista import to_surface_polydata
from voxflat.methods.zigelman2002 import pixels_of

SOURCES = 625  # 25 x 25, as in the paper
PAIRS = 1500  # points whose distances are compared with the true ones


def flatten(surface, **options):
    """Return a map and its CPU seconds."""
    return timed(surface.flatten, voxflat.methods.Zigelman2002(sources=SOURCES, **options), relax=False)


def cylinder_image(side=100, arc=150):
    """Return an arc of a cylinder (figure 4), in degrees, and its unrolled vertices, mm."""
    half = np.radians(arc) / 2
    across = np.linspace(-np.sin(half), np.sin(half), side)
    radius = (side - 1) / (2 * np.sin(half))
    image = voxflat.range_image(np.broadcast_to(radius * np.sqrt(1 - across**2), (side, side)), 1.0)
    rows, columns = np.unravel_index(image.ids, (side, side))
    return image, np.stack([radius * np.arcsin(across[columns]), -rows], axis=1)


def bust():
    """Return a bust (figure 3: a face) with 1 mm pixels as one sheet, as the paper treats range images."""
    depth = shapes.head_depth().astype(float)  # smoothed, because integers form a staircase
    pieces, _ = ndimage.label(ndimage.binary_opening(depth > 0, iterations=2))
    there = pieces == np.bincount(pieces.ravel())[1:].argmax() + 1
    share = ndimage.gaussian_filter(there.astype(float), 1.5)
    smooth = ndimage.gaussian_filter(np.where(there, depth, 0.0), 1.5)
    return voxflat.range_image(np.where(there, smooth / np.where(there, share, 1), np.nan), 1.0, jump=np.inf)


def cylinder():
    """Figure 4: a cylinder as a range image, which can be flattened without error."""
    image, truth = cylinder_image()
    chosen = np.random.default_rng(0).choice(len(truth), PAIRS, replace=False)
    row(f"cylinder, {len(image)} vertices: mean relative error of flat distances, %", "", "")
    for sampling, how in (("grid", "bilinear"), ("decimation", "re-insertion")):
        for wave in ("circle", "plane"):
            grid = pixels_of(image) if sampling == "grid" else None
            uv = image.core.zigelman2002(SOURCES, 0, (5, 10, 15, 30), None, grid, wave)["uv"]
            error = np.abs(pdist(uv[chosen]) / pdist(truth[chosen]) - 1).mean()
            front = "circles" if wave == "circle" else "the paper's straight fronts"
            row(f"  {how}, {front}", "0", f"{100 * error:.3f}")
    flat_map, _ = flatten(image)
    wall = bricks(640, 512)
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    space, plane = figure.subplots(1, 2)
    show(space, textured(flat_map, wall, azimuth=35, elevation=25), "a cylinder with a picture")
    show_flat(plane, flat_map, wall)
    figures.save(figure, PICTURES / "zigelman_cylinder.png")


def waves():
    """Figure 11: the graph of sin x sin y with a chessboard."""
    x = np.linspace(-np.pi, np.pi, 141)
    image = voxflat.range_image(np.outer(np.sin(x), np.sin(x)), 2 * np.pi / 140)
    flat_map, _ = flatten(image)
    grid, _ = flatten(image, sampling="grid")
    row(f"sin x sin y, {len(image)} vertices", "", "")
    tell("bilinear", grid)
    tell("re-insertion", flat_map)
    figure = Figure(figsize=(11, 5), layout="constrained")
    space, plane = figure.subplots(1, 2)
    board = coloured(chessboard(768, 768, 48))
    show(space, textured(flat_map, board, azimuth=25, elevation=-40), "sin x sin y with a chessboard")
    show_flat(plane, flat_map, board)
    figures.save(figure, PICTURES / "zigelman_waves.png")


def tell(how, flat_map):
    """Print how well a map preserves distances and angles."""
    distortion = flat_map.distortion
    row(f"  {how}: mean relative error, %", "", f"{100 * distortion.raw.relative_error:.2f}")
    row("    correlation of flat with geodesic distances", "", f"{distortion.pearson_r:.4f}")
    row("    ratio of the two stretches of a triangle, median", "", f"{distortion.triangles.quasi_conformal:.3f}")
    row("    flipped triangles", "", f"{distortion.triangles.flipped}")


def face():
    """Figures 3 and 5: a face as a range image of about 40,000 vertices, with 25 x 25 samples."""
    image = bust()
    grid, seconds = flatten(image, sampling="grid")
    row(f"face, {len(grid)} vertices, {len(grid.sources)} grid pixels as sources: CPU s", "about 30", f"{seconds:.1f}")
    tell("bilinear", grid)
    flat_map, seconds = flatten(image)
    row(f"face, {len(flat_map.sources)} sources by decimation: CPU s", "", f"{seconds:.1f}")
    tell("re-insertion", flat_map)
    figures.save(figures.scatter(flat_map), PICTURES / "zigelman_scatter.png")
    light = 0.25 + 0.75 * np.clip(flat_map.normals @ np.array([-0.3, 0.3, 0.9]), 0, 1)
    figure = Figure(figsize=(13, 5), layout="constrained")
    space, plane, mapped = figure.subplots(1, 3)
    show(space, textured(flat_map, np.full((8, 8, 3), 225, np.uint8)), "range image")
    plane.imshow(flat_map.raster(0.5).interpolate(light), cmap="gray", vmin=0, vmax=1)
    plane.set_title("flat surface image")
    plane.set_axis_off()
    show(mapped, textured(flat_map, coloured(chessboard(720, 720, 30))), "chessboard")
    figures.save(figure, PICTURES / "zigelman_face.png")


def cortex():
    """Flatten fsaverage5 along its cuts, which is not part of the paper."""
    white, pial, flat = fsaverage5("white", "pial", "flat")
    surface = voxflat.surface(white, pial=pial)
    flat_map, seconds = flatten(surface.keep(flat))
    row(f"fsaverage5 along its cuts, {len(flat_map)} vertices: CPU s", "", f"{seconds:.1f}")
    tell("re-insertion", flat_map)
    usual = surface.keep(flat).flatten()
    row("  relative error of the default method, %", "", f"{100 * usual.distortion.raw.relative_error:.2f}")


def coloured(grey):
    """Colour a grey picture with a dark and a light colour that remain visible when shaded."""
    return np.where(grey[..., None] > 0, [245, 240, 228], [60, 78, 110]).astype(np.uint8)


def textured(flat_map, picture, azimuth=0, elevation=0):
    """Render a surface with a picture mapped onto it."""
    mesh = to_surface_polydata(flat_map, picture_shape=picture.shape)
    plotter = pv.Plotter(off_screen=True, window_size=(1000, 1000))
    plotter.add_mesh(mesh, texture=pv.numpy_to_texture(picture), smooth_shading=True, ambient=0.15, specular=0.0)
    plotter.camera_position = "xy"
    plotter.camera.azimuth = azimuth
    plotter.camera.elevation = elevation
    plotter.reset_camera()
    plotter.camera.zoom(1.2)
    return plotter.screenshot(return_img=True)


def show_flat(axes, flat_map, picture):
    """Draw the flat map with its picture."""
    raster = flat_map.raster(flat_map.spacing / 2)
    values = flat_map.texture(picture).astype(float) / 255
    shown = np.stack([raster.interpolate(values[:, channel]) for channel in range(3)], axis=-1)
    paper.show_flat(axes, raster, np.where(np.isnan(shown), 1.0, shown))


if __name__ == "__main__":
    reproduce(lambda: row("", "paper", "ours"), cylinder, waves, face, cortex)
