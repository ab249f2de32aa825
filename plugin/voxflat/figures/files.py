"""Figures and pictures as files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from voxflat.errors import InputError
from voxflat.io.files import atomic_path

__all__ = ["save", "save_picture"]

_DPI = 200


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure to a file, all of it or nothing.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        A figure.
    path : path
        Ends in ``.png``, ``.pdf``, ``.svg`` or another ending that matplotlib writes.

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
        figure.savefig(temporary, format=kind, dpi=_DPI)


def save_picture(picture: NDArray[np.uint8], path: str | os.PathLike[str]) -> None:
    """Write a picture, such as `patch_3d` makes, to a file, all of it or nothing.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        Colours.
    path : path
        Ends in ``.png``, ``.tif`` or another ending that Pillow writes.

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
        Image.fromarray(picture).save(temporary)
