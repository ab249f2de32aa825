"""Image scraper of sphinx-gallery for the results of voxflat, which do not use pyplot.

In conf.py: ``"image_scrapers": ("matplotlib", "scrapers.results")`` and ``"capture_repr": ("_repr_html_",)``.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

from voxflat import figures


def results(block, block_vars, gallery_conf):
    """Save the last expression of a code block if it is a figure, picture or movie, and return reST to display it."""
    names = block_vars["example_globals"]
    value = names.get("___")  # sphinx-gallery's name for the last expression
    save = next((write for kind, write in WRITERS.items() if isinstance(value, kind)), None)
    if save is None or (isinstance(value, np.ndarray) and (value.dtype != np.uint8 or value.ndim != 3)):
        return ""
    path = Path(next(block_vars["image_path_iterator"]))
    names["___"] = None  # the next block might not end with an expression
    return figure_rst([str(save(value, path))], gallery_conf["src_dir"])


def _figure(figure, path):
    figure.savefig(path, dpi=figure.dpi if figure.dpi > 200 else 200)
    return path


def _picture(picture, path):
    figures.save_picture(picture, path)
    return path


def _movie(movie, path):
    path = path.with_suffix(".gif")
    figures.save_movie(movie, path)
    return path


WRITERS = {Figure: _figure, np.ndarray: _picture, figures.Movie: _movie}
