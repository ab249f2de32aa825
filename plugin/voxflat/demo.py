"""Run the demo, which flattens the left cerebral hemisphere of the MNI152 template bundled with nilearn."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.io.files import installing, require
from voxflat.io.volumes import Volume
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.hemispheres import hemisphere

if TYPE_CHECKING:
    from matplotlib.figure import Figure

THRESHOLD = 0.5  # voxels with a greater probability are white matter
SEED_POINT = (136, 112, 127)  # voxel indices of the patch's centre: the right central cortex, at (38, −22, 55) mm
RADIUS = 45.0  # radius of the patch along the surface, in mm
DEPTH = 2.0  # distance outside white matter at which T1 is sampled, in mm; this is within grey matter


def demo_cortex() -> tuple[Volume, Volume, Volume]:
    """Load the white-matter, T1 and grey-matter templates that are bundled with nilearn."""
    package = importlib.util.find_spec("nilearn")
    if package is None or package.origin is None:
        raise InputError(f"the demo requires nilearn. Run {installing('nilearn')}")
    folder = Path(package.origin).parent / "datasets" / "data"
    return _template(folder, "wm"), _template(folder, "t1"), _template(folder, "gm")


def _template(folder: Path, kind: str) -> Volume:
    """Read a template as nilearn does, but without importing nilearn, whose import takes seconds."""
    image = require("nibabel").load(folder / f"mni_icbm152_{kind}_tal_nlin_sym_09a_converted.nii.gz")
    data = np.asarray(image.dataobj, dtype=np.float32)
    return Volume(data / data.max(), image.affine)


def run(output: Path, progress: Progress | None = None, tell: Callable[[str], None] = print) -> FlatMap:
    """Flatten the hemisphere, and write the map, pictures of the map and a summary of its distortion."""
    from voxflat import figures  # imports matplotlib

    output.mkdir(parents=True, exist_ok=True)
    white_matter, t1, grey_matter = demo_cortex()
    start = time.perf_counter()
    whole = surface(hemisphere(white_matter, "left", threshold=THRESHOLD), repair="voxels", progress=progress)
    flat_map = whole.cut("standard", progress=progress).flatten(progress=progress)
    seconds = time.perf_counter() - start
    flat_map.save(output / "map.npz")
    pictures: dict[str, Callable[[Path], None]] = {
        "folds.png": lambda path: figures.save(figures.flat_map(flat_map), path),
        "flat_image.png": lambda path: figures.save(_flat_image(flat_map, t1, "T1"), path),
        "grey_matter.png": lambda path: figures.save(_flat_image(flat_map, grey_matter, "Grey matter"), path),
        "heat_map.png": lambda path: figures.save(figures.heat_map(flat_map), path),
        "scatter.png": lambda path: figures.save(figures.scatter(flat_map), path),
        "spectrum.png": lambda path: figures.save(figures.spectrum(flat_map), path),
        "patch_3d.png": lambda path: figures.save_picture(figures.patch_3d(flat_map), path),
    }
    for name, write in pictures.items():
        write(output / name)
    summary = _summary(whole, flat_map, seconds)
    (output / "summary.txt").write_text(summary + "\n", encoding="utf-8", newline="\n")
    tell(summary)
    tell(f"\nThe results are in {output.resolve()}:")
    tell("  map.npz, summary.txt, " + ", ".join(pictures))
    return flat_map


def _flat_image(flat_map: FlatMap, volume: Volume, name: str) -> Figure:
    from voxflat import figures

    # at the border of white matter itself, T1 has the same value everywhere
    label = f"{name}, {DEPTH:g} mm outside white matter"
    return figures.flat_map(flat_map, figures.Overlay(volume, colour_map="gray", label=label), depth=DEPTH)


def _summary(whole: Surface, flat_map: FlatMap, seconds: float) -> str:
    width, height = np.ptp(flat_map.uv, axis=0)
    repair, triangles = whole.repair, flat_map.distortion.triangles
    assert repair is not None
    assert triangles is not None
    return "\n".join(
        [
            "Left hemisphere of the MNI152 template (white-matter probability > 0.5)",
            f"{repair.handles} handles repaired: {len(repair.cut)} voxels removed, {len(repair.filled)} added",
            f"medial wall excluded; standard cuts: {', '.join(cut.name for cut in flat_map.cuts if cut.name)}",
            f"{len(flat_map)} vertices flattened in {seconds:.0f} s using {len(flat_map.sources)} sources, "
            f"{width:.0f} x {height:.0f} mm",
            f"{triangles.flipped} of {len(flat_map.faces)} triangles are flipped, "
            f"{triangles.covering} overlap another triangle",
            "",
            flat_map.distortion.table(),
        ]
    )
