"""Helpers of the reproductions of papers: files, lines of a table, pictures."""

import io
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "_generated" / "paper"
FSAVERAGE5 = Path(find_spec("nilearn").origin).parent / "datasets" / "data" / "fsaverage5"
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import shapes  # noqa: E402, F401


def reproduce(*parts):
    """Run the parts of a reproduction, then print the folder of the pictures and the duration."""
    matplotlib.use("Agg")
    PICTURES.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    for part in parts:
        part()
    print(f"\npictures in {PICTURES.relative_to(ROOT)}, {time.perf_counter() - start:.0f} s")


def timed(call, *arguments, **options):
    """Return the result of a call and its CPU seconds."""
    start = time.process_time()
    return call(*arguments, **options), time.process_time() - start


def row(what="", paper="", ours=""):
    """Print one line of the table."""
    print(f"{what:76}{paper:>12}{ours:>26}", flush=True)


def fsaverage5(*names):
    """Return files of the left hemisphere of fsaverage5."""
    return [str(FSAVERAGE5 / f"{name}_left.gii.gz") for name in names]


def show_flat(axes, raster, picture, **look):
    """Draw an image of the map, with axes in mm."""
    left, top = raster.origin
    height, width = raster.shape
    extent = (left, left + width * raster.pixel_size, top - height * raster.pixel_size, top)
    axes.imshow(picture, extent=extent, **look)
    axes.set(title="flattened", xlabel="mm", ylabel="mm")


def show(axes, picture, title):
    """Draw an image without axes."""
    axes.imshow(picture)
    axes.set_title(title)
    axes.set_axis_off()


def trimmed(picture):
    """Remove the white margin of a picture."""
    drawn = (picture < 255).any(axis=2)
    rows, columns = (np.flatnonzero(drawn.any(axis=axis)) for axis in (1, 0))
    return picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def save_small(figure, name):
    """Save a figure as a small file with few colours, which suffice for lines."""
    with io.BytesIO() as drawn:
        figure.savefig(drawn, dpi=110)
        Image.open(drawn).convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(PICTURES / name, optimize=True)
