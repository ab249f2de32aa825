"""Map a chessboard onto a surface by its flat map: writes ``docs/pictures/texture.png``.

The surface, sin x sin y, is that of Zigelman, Kimmel, Kiryati (2002), figure 11: it has maxima, minima and saddles.
"""

from pathlib import Path

import numpy as np
import pyvista as pv

import voxflat

PICTURE = Path(__file__).parents[1] / "pictures" / "texture.png"
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


def main() -> None:
    """Draw the picture on the surface, and colours at its points before and after subdivision."""
    flat_map = voxflat.flatten(waves())
    textured = flat_map.textured(chessboard(), SQUARE / TEXELS, repeat=True)
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
            texture = pv.Texture(surface.picture)
            texture.repeat = True
            plotter.add_mesh(mesh, texture=texture, **light)
        else:
            plotter.add_mesh(mesh, scalars=surface.colours, rgb=True, **light)
        plotter.add_text(title, position="lower_edge", font_size=11, color="black")
        plotter.camera_position = [(66, -46, 66), (19.4, 19.2, 1), (0, 0, 1)]
        plotter.camera.zoom(1.05)
    plotter.enable_anti_aliasing("ssaa", all_renderers=True)
    PICTURE.parent.mkdir(exist_ok=True)
    plotter.screenshot(PICTURE)


if __name__ == "__main__":
    main()
