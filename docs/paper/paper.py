"""What the reproductions of papers share: where files are, lines of a table, pictures."""

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
    """Print the parts of a paper one after the other; say where the pictures are, and how long it took."""
    matplotlib.use("Agg")
    PICTURES.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    for part in parts:
        part()
    print(f"\npictures in {PICTURES.relative_to(ROOT)}, {time.perf_counter() - start:.0f} s")


def timed(call, *arguments, **options):
    """Return what a call returns, and the CPU seconds that it took."""
    start = time.process_time()
    return call(*arguments, **options), time.process_time() - start


def row(what="", paper="", ours=""):
    """Print one line of the table."""
    print(f"{what:76}{paper:>12}{ours:>26}", flush=True)


def fsaverage5(*names):
    """Return the files of fsaverage5's left hemisphere."""
    return [str(FSAVERAGE5 / f"{name}_left.gii.gz") for name in names]


def show_flat(axes, raster, picture, **look):
    """Draw a picture of the pixels of a map, in mm."""
    left, top = raster.origin
    height, width = raster.shape
    extent = (left, left + width * raster.pixel_size, top - height * raster.pixel_size, top)
    axes.imshow(picture, extent=extent, **look)
    axes.set(title="flattened", xlabel="mm", ylabel="mm")


def show(axes, picture, title):
    """Draw a picture without axes."""
    axes.imshow(picture)
    axes.set_title(title)
    axes.set_axis_off()


def trimmed(picture):
    """Return a picture without the white around what it shows."""
    drawn = (picture < 255).any(axis=2)
    rows, columns = (np.flatnonzero(drawn.any(axis=axis)) for axis in (1, 0))
    return picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def save_small(figure, name):
    """Write a small picture: lines need few colours."""
    with io.BytesIO() as drawn:
        figure.savefig(drawn, dpi=110)
        Image.open(drawn).convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(PICTURES / name, optimize=True)
