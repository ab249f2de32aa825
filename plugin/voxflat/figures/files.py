"""Figures and pictures as files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from voxflat.errors import InputError
from voxflat.figures.layers import name_layers
from voxflat.io.files import atomic_path
from voxflat.io.provenance import Record, as_text

__all__ = ["save", "save_picture"]

_DPI = 200
_TEXT: Any = {"svg.fonttype": "none", "svg.hashsalt": "voxflat", "pdf.fonttype": 42}
"""Text stays text, to be edited; equal figures are equal files."""


def save(figure: Figure, path: str | os.PathLike[str], record: Record | None = None) -> None:
    """Write a figure to a file, all of it or nothing.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        A figure.
    path : path
        Ends in ``.png``, ``.pdf``, ``.svg`` or another ending that matplotlib writes. Names are text in SVG and PDF; an
        SVG of `flat_map` has layers that Inkscape shows by name.
    record : dict, optional
        What made it, for PNG's text, PDF's subject, SVG's description.

    Raises
    ------
    InputError
        If the ending is another.
    OSError
        If the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix[1:].lower()
    if kind not in figure.canvas.get_supported_filetypes():
        raise InputError(f"cannot write a figure as {path.name}; give a name that ends in .png, .pdf or .svg")
    with atomic_path(path) as temporary:
        with rc_context(_TEXT):
            figure.savefig(temporary, format=kind, dpi=max(_DPI, figure.dpi), metadata=_metadata(kind, record))
        if kind == "svg":
            name_layers(temporary, figure)


def _metadata(kind: str, record: Record | None) -> dict[str, Any] | None:
    """Return what a kind of file can hold of a record; and no date, so that equal figures are equal files."""
    place = {"png": "Provenance", "pdf": "Subject", "svg": "Description"}.get(kind)
    told = {} if place is None or record is None else {place: as_text(record)}
    return {**told, **{"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind, {})} or None


def save_picture(picture: NDArray[np.uint8], path: str | os.PathLike[str], record: Record | None = None) -> None:
    """Write a picture, such as `patch_3d` makes, to a file, all of it or nothing.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        Colours.
    path : path
        Ends in ``.png``, ``.tif`` or another ending that Pillow writes.
    record : dict, optional
        What made it, for PNG's text.

    Raises
    ------
    InputError
        If the ending is another.
    OSError
        If the file cannot be written.
    """
    path = Path(path)
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise InputError(f"cannot write a picture as {path.name}; give a name that ends in .png or .tif")
    with atomic_path(path) as temporary:
        more: dict[str, Any] = {}
        if path.suffix.lower() == ".png" and record is not None:
            more["pnginfo"] = PngImagePlugin.PngInfo()
            more["pnginfo"].add_itxt("Provenance", as_text(record))
        Image.fromarray(picture).save(temporary, **more)
