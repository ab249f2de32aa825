"""Flatten a patch of cortex within PyVista, and map a chessboard onto a surface: ``pyvista.png`` and ``texture.png``.

The surface of the latter, sin x sin y, is that of Zigelman, Kimmel, Kiryati (2002), figure 11. Needs ``pip install
'voxflat[demo]'``. The white matter of the MNI152 template comes with nilearn; nothing is downloaded.
"""

import colorsys
from pathlib import Path

import numpy as np
import pyvista as pv
from nilearn import datasets

import voxflat

PICTURES = Path(__file__).parents[1] / "pictures"
CENTRAL_CORTEX = (38, -22, 55)  # mm, right hemisphere


def white_matter() -> pv.ImageData:
    """Load the probability of white matter; its affine has neither rotation nor reflection."""
    template = datasets.load_mni152_wm_template(resolution=1)
    image = pv.ImageData(dimensions=template.shape, spacing=np.diag(template.affine)[:3], origin=template.affine[:3, 3])
    image["white matter"] = np.asarray(template.dataobj, dtype=np.float32).ravel(order="F")
    return image


def colour_wheel(size: int = 1024, rings: int = 5, spokes: int = 12) -> pv.Texture:
    """Draw a picture that shows where each part comes to lie: hue is its direction, chequers are its distance."""
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    turn = (np.arctan2(y, x) / (2 * np.pi)) % 1
    dark = (np.floor(rings * np.hypot(x, y)) + np.floor(spokes * turn)) % 2
    hues = np.array([colorsys.hsv_to_rgb(h, 0.7, 1.0) for h in np.linspace(0, 1, 256)])
    colours = hues[(255 * turn).astype(int)] * (1 - 0.3 * dark[..., None])
    return pv.Texture(np.round(255 * colours).astype(np.uint8))


def patch_of_cortex() -> None:
    """Flatten, and draw the patch on the brain, its map, and the map's distortion."""
    image = white_matter()
    seed_point = image.voxflat.voxel_at(CENTRAL_CORTEX)
    flat_map = image.voxflat.flatten(threshold=0.5, seed_point=seed_point, radius=45.0)
    flat = image.voxflat.to_polydata(flat_map)
    patch = image.voxflat.to_surface_polydata(flat_map)
    patch.points += 0.5 * patch.point_normals  # mm, above the contour, where both would lie
    title = "mean relative error of distances (%)\n"
    flat[title] = 100 * flat["distance_error"]

    picture = colour_wheel()
    light = {"smooth_shading": True, "ambient": 0.3, "diffuse": 0.8, "specular": 0.0}
    bar = {"position_x": 0.2, "position_y": 0.01, "width": 0.6, "height": 0.08, "n_labels": 3, "fmt": "%.0f"}
    bar |= {"title_font_size": 22, "label_font_size": 22}
    plotter = pv.Plotter(shape=(1, 3), off_screen=True, window_size=[2100, 800], border=False)
    plotter.set_background("white")
    plotter.add_mesh(image.contour([0.5]), color="#d8d8d4", **light)
    plotter.add_mesh(patch, texture=picture, **light)
    plotter.camera_position = [(260, -40, 160), patch.center, (0, 0, 1)]
    plotter.camera.zoom(1.55)

    plotter.subplot(0, 1)
    plotter.add_mesh(flat, texture=picture, lighting=False)
    plotter.camera.tight(padding=0.15, adjust_render_window=False)

    plotter.subplot(0, 2)
    plotter.add_mesh(flat, scalars=title, cmap="inferno", clim=(0, 10), lighting=False, scalar_bar_args=bar)
    plotter.camera.tight(padding=0.15, adjust_render_window=False)

    plotter.enable_anti_aliasing("ssaa", all_renderers=True)
    plotter.screenshot(PICTURES / "pyvista.png")


SQUARE = 2.0  # mm
TEXELS = 16  # along a square


def waves(count: int = 81, side: float = 40.0) -> tuple[np.ndarray, np.ndarray]:
    """Return points and triangles of a graph surface with bumps and hollows, mm."""
    x, y = np.meshgrid(np.linspace(0, side, count), np.linspace(0, side, count))
    z = 4 * np.sin(3 * np.pi * x / side) * np.sin(3 * np.pi * y / side)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + count])
    upper = np.column_stack([corner + 1, corner + count + 1, corner + count])
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()]), np.concatenate([lower, upper])


def chessboard() -> np.ndarray:
    """Draw two by two squares, to be repeated."""
    dark, light = np.array([40, 60, 110], dtype=np.uint8), np.array([240, 236, 220], dtype=np.uint8)
    is_dark = np.kron([[0, 1], [1, 0]], np.ones((TEXELS, TEXELS), dtype=int)) == 1
    return np.where(is_dark[..., None], dark, light)


def texture() -> None:
    """Draw the picture on the surface, and colours at its points before and after subdivision."""
    textured = voxflat.flatten(waves()).textured(chessboard(), SQUARE / TEXELS, repeat=True)
    finer = textured.subdivided()
    plotter = pv.Plotter(shape=(1, 3), off_screen=True, window_size=[1800, 560], border=False)
    plotter.set_background("white")
    light = {"ambient": 0.3, "diffuse": 0.8, "specular": 0.0, "smooth_shading": False}
    for column, (surface, title) in enumerate(
        (
            (textured, "the picture on the surface"),
            (textured, f"colours at its {len(textured.points)} points"),
            (finer, f"after subdivision: {len(finer.points)} points"),
        )
    ):
        plotter.subplot(0, column)
        mesh = pv.PolyData.from_regular_faces(surface.points, surface.faces)
        if column == 0:
            mesh.active_texture_coordinates = surface.texture_coordinates
            picture = pv.Texture(surface.picture)
            picture.repeat = True
            plotter.add_mesh(mesh, texture=picture, **light)
        else:
            plotter.add_mesh(mesh, scalars=surface.colours, rgb=True, **light)
        plotter.add_text(title, position="lower_edge", font_size=11, color="black")
        plotter.camera_position = [(66, -46, 66), (19.4, 19.2, 1), (0, 0, 1)]
        plotter.camera.zoom(1.05)
    plotter.enable_anti_aliasing("ssaa", all_renderers=True)
    plotter.screenshot(PICTURES / "texture.png")


if __name__ == "__main__":
    patch_of_cortex()
    texture()
