"""What the verbs of ``mesh.voxflat`` show, on fsaverage5: writes ``docs/pictures/pyvista_*``.

Needs ``pip install 'voxflat[demo]'``. fsaverage5 comes with nilearn; nothing is downloaded.
"""

from importlib.util import find_spec
from pathlib import Path

import pyvista as pv

from voxflat.io import read_mesh, read_overlay

PICTURES = Path(__file__).parents[1] / "pictures"


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


def main() -> None:
    """Flatten the hemisphere; draw its cuts, the map beside the surface, and the way between."""
    mesh = hemisphere()
    flat = mesh.voxflat(progress_bar=True)
    flat.voxflat.plot("areal", off_screen=True, window_size=(1400, 700), screenshot=PICTURES / "pyvista_plot.png")
    flat.voxflat.plot(
        "sulcal depth",
        cmap="gray_r",
        off_screen=True,
        window_size=(1400, 700),
        screenshot=PICTURES / "pyvista_depth.png",
    )
    flat.voxflat.morph(14).save(
        PICTURES / "pyvista_morph.gif", "sulcal depth", cmap="gray_r", window_size=(400, 400), fps=10
    )

    page = mesh.voxflat.patches(bound=1.5)
    page.voxflat.plot("patch", off_screen=True, window_size=(1400, 700), screenshot=PICTURES / "pyvista_patches.png")


if __name__ == "__main__":
    main()
