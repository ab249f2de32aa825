"""Reproduce Grossmann, Kiryati, Kimmel (2002): print the results of the paper and of voxflat, and draw the figures.

make paper-grossmann
"""

import numpy as np
import pyvista as pv
from matplotlib.figure import Figure
from paper import PICTURES, reproduce, row, shapes, show, show_flat
from scipy.spatial.transform import Rotation

import voxflat
from voxflat import _core, figures

ORIENTATIONS = 20


def estimate(counts):
    """Return lengths from numbers of links, with the weights of the paper."""
    weights = _core.chain_weights([1.0, 1.0, 1.0], "chain-code")
    return counts @ [0, weights[1], weights[3], weights[7]]


def lines():
    """Section 2.1: straight lines of random direction."""
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    measured = (shapes.line_links(direction, rng) for direction in directions)
    errors = np.array([estimate(counts) / length - 1 for counts, length in measured])
    row("straight lines: mean error of the length, %", "0", f"{100 * errors.mean():.2f}")
    row("  RMS error, %", "2.88", f"{100 * np.sqrt((errors**2).mean()):.2f}")
    row("  minimum error, %", "-9.84", f"{100 * errors.min():.2f}")
    row("  maximum error, %", "4.59", f"{100 * errors.max():.2f}")


def circles():
    """Figure 2: 100 random circles per radius."""
    rng = np.random.default_rng(2)
    radii = [3, 5, 10, 20, 40, 80]
    errors = []
    for radius in radii:
        measured = (shapes.circle_links(radius, rng) for _ in range(100))
        errors.append([100 * (estimate(counts) / length - 1) for counts, length in measured])
    for radius, error in zip(radii, errors, strict=True):
        row(f"circles of radius {radius}: mean error, %", "-> 0", f"{np.mean(error):.2f}")
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.add_subplot()
    axes.semilogx(radii, np.mean(errors, axis=1), "k-", label="mean")
    axes.semilogx(radii, np.min(errors, axis=1), "k--", label="minimum and maximum")
    axes.semilogx(radii, np.max(errors, axis=1), "k--")
    axes.set(xlabel="radius (voxels)", ylabel="error of the perimeter (%)")
    axes.set_title("100 random circles per radius (figure 2)")
    axes.legend()
    figures.save(figure, PICTURES / "grossmann_circles.png")


def curled_sheets():
    """Figures 4 to 9: a curled sheet, axis-aligned and rotated."""
    aligned = flatten(shapes.curled_sheet())
    row("curled sheet, axis-aligned: mean geodesic, voxels", "35.4", f"{aligned.distortion.mean_geodesic:.1f}")
    row("  mean absolute error, voxels", "0.423", f"{aligned.distortion.raw.absolute_error:.3f}")
    row("  mean relative error, %", "2.13", f"{100 * aligned.distortion.raw.relative_error:.2f}")
    for traversed in (False, True):
        what = "all voxels that the sheet intersects" if traversed else "one voxel thick"
        for sources in (None, 1000):
            figures_of = [one_sheet(n, traversed, sources) for n in range(ORIENTATIONS)]
            size, geodesic, absolute, relative = np.mean(figures_of, axis=0)
            which = "all voxels are sources" if sources is None else f"{sources} sources"
            row(f"rotated, {what}, {which}", "", f"{size:.0f} voxels")
            row("  mean geodesic, voxels", "", f"{geodesic:.1f}")
            row("  mean absolute error, voxels", "0.428", f"{absolute:.3f}")
            row("  mean relative error, %", "2.06", f"{100 * relative:.2f}")
    figures.save(figures.scatter(aligned), PICTURES / "grossmann_sheet_scatter.png")
    chessboard_picture(aligned)


def flatten(volume, sources=None):
    """Flatten with `sources` sources; by default, every voxel is a source."""
    if sources is None:
        sources = len(voxflat.surface(volume).geodesic(1, geodesic="chain").ids)
    return voxflat.flatten(volume, method=voxflat.methods.Grossmann2002(sources=sources))


def one_sheet(seed, traversed, sources):
    """Flatten a randomly rotated sheet; return its size, mean geodesic distance, absolute and relative error."""
    flat_map = flatten(shapes.curled_sheet(rotation=Rotation.random(rng=seed), traversed=traversed), sources)
    raw = flat_map.distortion.raw
    return len(flat_map), flat_map.distortion.mean_geodesic, raw.absolute_error, raw.relative_error


def chessboard_picture(flat_map):
    """Figures 4 and 5: the curled sheet with a chessboard, and its flat map."""
    board = flat_map.texture(chessboard(600, 300, 50))
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    space, plane = figure.subplots(1, 2)
    show(space, voxel_picture(flat_map.points, board), "a curled sheet of voxels")
    raster = flat_map.raster(0.25)
    show_flat(plane, raster, raster.interpolate(board), cmap="gray")
    figures.save(figure, PICTURES / "grossmann_sheet.png")


def voxel_picture(points, shade):
    """Render voxels as grey cubes."""
    cloud = pv.PolyData(points)
    cloud["shade"] = shade
    plotter = pv.Plotter(off_screen=True, window_size=(1100, 1000))
    cubes = cloud.glyph(geom=pv.Cube(), scale=False, orient=False)
    plotter.add_mesh(cubes, scalars="shade", cmap="gray", clim=(-60, 255), show_scalar_bar=False)
    plotter.camera_position = "xy"
    plotter.camera.elevation = -35
    plotter.camera.azimuth = 20
    plotter.camera.zoom(1.2)
    return plotter.screenshot(return_img=True)


def chessboard(width, height, square):
    fields = np.add.outer(np.arange(height) // square, np.arange(width) // square) % 2
    return (fields * 255).astype(np.uint8)


def bricks(width, height, brick=(48, 20), joint=4):
    """Return a picture of a brick wall (figure 11)."""
    y, x = np.mgrid[:height, :width]
    course = y // brick[1]
    shifted = x + (course % 2) * brick[0] // 2
    mortar = (y % brick[1] < joint) | (shifted % brick[0] < joint)
    shade = np.random.default_rng(0).integers(-25, 25, size=(height // brick[1] + 1, width // brick[0] + 2))
    colour = np.array([170, 74, 52]) + shade[course, shifted // brick[0]][..., None]
    return np.where(mortar[..., None], [205, 200, 190], colour).astype(np.uint8)


def head():
    """Figures 10 to 13: a head as a depth image, its scatter plot, and textures mapped onto it."""
    volume = shapes.depth_surface(shapes.head_depth())
    upright = [[0, 1, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]  # rows of the image go down
    flat_map = voxflat.surface(volume, affine=upright).flatten("grossmann2002")
    distortion = flat_map.distortion
    row(f"head as a depth image, {len(flat_map)} voxels: mean geodesic", "141.9", f"{distortion.mean_geodesic:.1f}")
    row("  mean absolute error, voxels", "9.04", f"{distortion.raw.absolute_error:.2f}")
    row("  mean relative error, %", "7.66", f"{100 * distortion.raw.relative_error:.2f}")
    figures.save(figures.scatter(flat_map), PICTURES / "grossmann_head_scatter.png")
    depth = shapes.head_depth().astype(float)
    depth[depth == 0] = np.nan
    figure = Figure(figsize=(12, 5), layout="constrained")
    axes = figure.subplots(1, 3)
    axes[0].imshow(depth, cmap="gray")
    axes[0].set_title("depth image")
    show(axes[1], textured(flat_map, bricks(720, 720), volume.shape), "bricks mapped back")
    show(axes[2], textured(flat_map, chessboard(720, 720, 40), volume.shape), "chessboard mapped back")
    axes[0].set_axis_off()
    figures.save(figure, PICTURES / "grossmann_head.png")


def textured(flat_map, picture, shape):
    """Render the head from the front with a picture mapped onto it."""
    colours = flat_map.texture(picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2))
    painted = flat_map.paint(np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], axis=1))
    front = painted[..., 3] > 0
    top = np.where(front.any(axis=2), shape[2] - 1 - front[..., ::-1].argmax(axis=2), 0)
    image = np.take_along_axis(painted, top[..., None, None], axis=2)[:, :, 0]
    slope = np.stack(np.gradient(top.astype(float)), axis=-1)
    normal = np.concatenate([-slope, np.full((*top.shape, 1), 2.0)], axis=2)
    light = (normal @ [0.4, -0.3, 0.85]) / np.linalg.norm(normal, axis=2)
    image = image.astype(float)
    image[..., :3] *= np.clip(0.35 + 0.65 * light, 0, 1)[..., None]
    return np.clip(image, 0, 255).astype(np.uint8)


def path_round_an_obstacle():
    """Figure 3: the shortest path on hilly terrain with a river and one bridge, and contours of equal distance."""
    x, y = np.mgrid[:160, :160]
    height = np.round(14 + 7 * np.sin(x / 17) * np.cos(y / 23) + 4 * np.sin((x + 2 * y) / 19)).astype(int)
    river = np.abs(x - 80 - 8 * np.sin(y / 20)) < 4
    bridge = (np.abs(y - 118) < 4) & river
    volume = shapes.depth_surface(np.where(river & ~bridge, 0, height))
    top = {(int(i), int(j)): int(k) for i, j, k in np.argwhere(volume)}  # the highest voxel of each column is the last
    start, end = ((*ij, top[ij]) for ij in ((12, 14), (148, 20)))
    path = voxflat.surface(volume).path(start, end, geodesic="chain")
    rows = voxflat.surface(volume).geodesic([start], geodesic="chain")
    distance = np.full(volume.shape[:2], np.nan)
    distance[tuple(rows.ids[:, :2].T)] = rows.rows[0]
    figure = Figure(figsize=(6, 6), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(np.where(volume.any(axis=2), np.pad(height, 1), np.nan).T, cmap="terrain", origin="lower")
    axes.contour(distance.T, levels=np.arange(0, 400, 10), colors="0.35", linewidths=0.6)
    axes.plot(path.ids[:, 0], path.ids[:, 1], "k-", linewidth=2.5)
    axes.set_title(f"shortest path over the bridge, {path.length:.1f} voxels (figure 3)")
    axes.set_axis_off()
    figures.save(figure, PICTURES / "grossmann_path.png")


if __name__ == "__main__":
    reproduce(lambda: row("", "paper", "ours"), lines, circles, curled_sheets, head, path_round_an_obstacle)
