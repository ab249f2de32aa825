"""Figures and pictures as files."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from voxflat.arguments import Progress, array_of, checked_kind, checked_path
from voxflat.errors import Cancelled, InputError
from voxflat.figures.layers import name_layers
from voxflat.io.files import atomic_path, one_line, require
from voxflat.io.provenance import Record, as_text
from voxflat.io.reading import check_room

MOVIE_ENDINGS = (".mp4", ".gif")  # how the name of a movie may end

_DPI = 200
_QUALITY = "18"  # of H.264, from 0 to 51: no loss that one sees
_BT709 = "bt709"  # what players take colours for that do not say
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

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> voxflat.figures.save(voxflat.figures.scatter(flat_map), "scatter.pdf")
    """
    path = checked_path(path)
    checked_kind(figure, "figure", "canvas", "a figure of Matplotlib")
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

    Examples
    --------
    >>> voxflat.figures.save_picture(np.zeros((4, 4, 3), np.uint8), "black.png")
    """
    path, array = checked_path(path), array_of(picture, "values of the picture")
    if array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,), (4,)) or not array.size:
        raise InputError(f"the picture has shape {array.shape} and type {array.dtype}; give (H, W, 3) of uint8")
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise InputError(f"cannot write a picture as {path.name}; give a name that ends in .png or .tif")
    with atomic_path(path) as temporary:
        more: dict[str, Any] = {}
        if path.suffix.lower() == ".png" and record is not None:
            more["pnginfo"] = PngImagePlugin.PngInfo()
            more["pnginfo"].add_itxt("Provenance", as_text(record))
        Image.fromarray(array).save(temporary, **more)


class Pictures(Protocol):
    """What a movie is made of: each picture, (H, W, 3), is drawn when it is asked for."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of each picture, pixels, even numbers."""

    @property
    def rate(self) -> float:
        """Frames a second."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def __getitem__(self, n: int) -> NDArray[np.uint8]:
        """Draw a frame."""


def check_movie(path: str | os.PathLike[str]) -> None:
    """Refuse a name that no movie can be written to, before the long work."""
    name = Path(path)
    if name.suffix.lower() not in MOVIE_ENDINGS:
        raise InputError(f"cannot write a movie as {name.name}; give a name that ends in {' or '.join(MOVIE_ENDINGS)}")
    if name.suffix.lower() == ".mp4":
        require("imageio_ffmpeg", "movie")


def save_movie(
    movie: Pictures, path: str | os.PathLike[str], record: Record | None = None, progress: Progress | None = None
) -> None:
    """Write a movie to a file, all of it or nothing.

    Parameters
    ----------
    movie : Movie
        Or anything else that draws pictures when they are asked for; an ``.mp4`` holds one in memory, a ``.gif`` all.
    path : path
        Ends in ``.mp4``, H.264 for slides and browsers (``pip install 'voxflat[movie]'``), or ``.gif``, whose pictures
        last whole hundredths of a second, two at least.
    record : dict, optional
        What made it: a comment in the file.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` after each picture; if it returns False nothing is written.

    Raises
    ------
    InputError
        If the ending is another, what writes it is missing, or a ``.gif`` needs more memory than there is.
    Cancelled
        If `progress` returned False.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> movie = voxflat.figures.movie(flat_map, np.random.default_rng(0).random((441, 3)), size=320)
    >>> voxflat.figures.save_movie(movie, "noise.gif")
    """
    path = checked_path(path)
    check_movie(path)
    write = {".mp4": _write_mp4, ".gif": _write_gif}[path.suffix.lower()]
    text = "" if record is None else as_text(record)
    with atomic_path(path) as temporary:
        write(temporary, movie, _drawn(movie, path.name, progress), text)


def _drawn(movie: Pictures, name: str, progress: Progress | None) -> Iterator[NDArray[np.uint8]]:
    for n in range(len(movie)):
        yield movie[n]
        if progress is not None and progress(f"writing {name}", n + 1, len(movie)) is False:
            raise Cancelled(f"cancelled while writing {name}")


def _write_mp4(path: Path, movie: Pictures, pictures: Iterator[NDArray[np.uint8]], text: str) -> None:
    ffmpeg = require("imageio_ffmpeg", "movie")
    height, width = movie.size
    space = ["-colorspace", _BT709, "-color_primaries", _BT709, "-color_trc", _BT709]
    more = ["-crf", _QUALITY, "-vf", f"scale=out_color_matrix={_BT709}", *space, "-movflags", "+faststart"]
    told = {"codec": "libx264", "fps": movie.rate, "quality": None, "macro_block_size": 2}
    comment = ["-metadata", f"comment={text}"]
    writer = ffmpeg.write_frames(str(path), (width, height), **told, output_params=[*more, *comment])
    try:
        writer.send(None)
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture))
    except OSError as error:
        if error.errno is not None:
            raise
        raise InputError(f"ffmpeg failed ({one_line(error)}): install imageio-ffmpeg again, or give a .gif") from error
    finally:
        writer.close()


def _write_gif(path: Path, movie: Pictures, pictures: Iterator[NDArray[np.uint8]], text: str) -> None:
    height, width = movie.size
    check_room(2 * len(movie) * height * width)  # Pillow holds them all
    shown = [Image.fromarray(movie[n]) for n in sorted({0, len(movie) // 2, len(movie) - 1})]
    together = Image.fromarray(np.concatenate([np.asarray(one) for one in shown]))
    palette = together.quantize(255, method=Image.Quantize.MAXCOVERAGE)
    frames = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    lasts = max(2, round(100 / movie.rate)) * 10  # ms; players make less than 20 longer
    first = next(frames)
    first.save(
        path, format="GIF", save_all=True, append_images=frames, duration=lasts, loop=0, comment=text.encode("utf-8")
    )
