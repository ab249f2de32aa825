"""The demo: a patch of the human central cortex, from the MNI152 template that nilearn carries."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voxflat._errors import InputError
from voxflat._prepare import Progress
from voxflat._surface import surface
from voxflat.api import flatten
from voxflat.flatmap import FlatMap
from voxflat.io import Volume

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["DEPTH", "RADIUS", "SEED_POINT", "THRESHOLD", "demo_cortex", "flatten_demo", "run"]

THRESHOLD = 0.5
"""White matter is where its probability is greater."""

SEED_POINT = (136, 112, 127)
"""Voxel indices of the patch's centre: the right central cortex, at (38, −22, 55) mm."""

RADIUS = 45.0
"""Radius of the patch, mm along the surface."""

DEPTH = 2.0
"""How far outside white matter T1 is sampled, mm: in grey matter."""


def demo_cortex() -> tuple[Volume, Volume]:
    """Load the demo's volumes from nilearn; nothing is downloaded.

    Returns
    -------
    white_matter : Volume
        Probability of white matter in the MNI152 template (0 to 1), 1 mm.
    t1 : Volume
        The T1-weighted template on the same grid.

    Raises
    ------
    InputError
        If nilearn is not installed.
    """
    try:
        from nilearn import datasets
    except ImportError:
        raise InputError("the demo needs nilearn: pip install 'voxflat[demo]'") from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # nilearn warns of its own coming changes
        images = (
            datasets.load_mni152_wm_template(resolution=1),
            datasets.load_mni152_template(resolution=1),
        )
    white_matter, t1 = (
        Volume(np.asarray(image.dataobj, dtype=np.float32), np.asarray(image.affine, dtype=np.float64))
        for image in images
    )
    return white_matter, t1


def flatten_demo(white_matter: Volume, progress: Progress | None = None) -> FlatMap:
    """Flatten the demo's patch.

    Parameters
    ----------
    white_matter : Volume
        The first volume of `demo_cortex`.
    progress : callable, optional
        As in `voxflat.flatten`.

    Returns
    -------
    FlatMap
    """
    whole = surface(white_matter, threshold=THRESHOLD, repair="voxels", progress=progress)
    return flatten(whole, seed_point=SEED_POINT, radius=RADIUS, progress=progress)


def run(output: Path, progress: Progress | None = None, tell: Callable[[str], None] = print) -> FlatMap:
    """Flatten the demo's patch and write the map, its pictures and its figures.

    Parameters
    ----------
    output : Path
        A directory; made if it is missing.
    progress : callable, optional
        As in `voxflat.flatten`.
    tell : callable, optional
        Takes each line of the summary.

    Returns
    -------
    FlatMap

    Raises
    ------
    InputError
        If a package of the demo is missing or the directory cannot be made.
    """
    from voxflat import figures  # brings in matplotlib

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the directory {output}: {error.strerror}; choose another place") from error
    white_matter, t1 = demo_cortex()
    start = time.perf_counter()
    flat_map = flatten_demo(white_matter, progress)
    seconds = time.perf_counter() - start
    flat_map.save(output / "map.npz")
    pictures: dict[str, Callable[[Path], None]] = {
        "flat_image.png": lambda path: figures.save(_flat_image(flat_map, t1), path),
        "heat_map.png": lambda path: figures.save(figures.heat_map(flat_map), path),
        "scatter.png": lambda path: figures.save(figures.scatter(flat_map), path),
        "spectrum.png": lambda path: figures.save(figures.spectrum(flat_map), path),
        "patch_3d.png": lambda path: figures.save_picture(figures.patch_3d(flat_map, white_matter), path),
    }
    for name, write in pictures.items():
        write(output / name)
    summary = _summary(flat_map, seconds)
    (output / "summary.txt").write_text(summary + "\n")
    tell(summary)
    tell(f"\nEverything lies in {output.resolve()}:")
    tell("  map.npz, summary.txt, " + ", ".join(pictures))
    return flat_map


def _flat_image(flat_map: FlatMap, t1: Volume) -> Figure:
    from voxflat import figures

    # right at the border of white matter T1 is the same everywhere
    return figures.flat_image(flat_map, t1, depth=DEPTH, title=f"T1, {DEPTH:g} mm outside white matter")


def _summary(flat_map: FlatMap, seconds: float) -> str:
    width, height = np.ptp(flat_map.uv, axis=0)
    metadata = flat_map.metadata
    repair = metadata["repair"]
    triangles = flat_map.distortion.triangles
    flipped = 0 if triangles is None else triangles.flipped
    return "\n".join(
        [
            "Right central cortex of the MNI152 template, white matter > 0.5",
            f"{repair['handles']} handles of the whole white matter were repaired: {len(repair['cut'])} voxels "
            f"removed, {len(repair['filled'])} added",
            f"a patch of {len(flat_map)} of {metadata['surface_points']} vertices, "
            f"within {metadata['radius']:g} mm of voxel {tuple(metadata['seed_point'])}",
            f"flattened in {seconds:.2f} s from {metadata['sources']} sources, {width:.0f} x {height:.0f} mm",
            f"{100 * metadata['planarity']:.1f} % of the distances' spectrum lies in the plane, "
            f"{flipped} of {len(flat_map.faces)} triangles are turned over",
            "",
            flat_map.distortion.table(),
        ]
    )
