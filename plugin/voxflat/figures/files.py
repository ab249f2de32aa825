"""Write figures, images and movies to files."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from voxflat.arguments import Progress, array_of, checked_instance, checked_path
from voxflat.errors import InputError
from voxflat.figures.layers import name_layers
from voxflat.io.files import atomic_path, one_line, require
from voxflat.io.provenance import Record, as_text
from voxflat.io.reading import check_room
from voxflat.maps.image_files import reporting

MOVIE_ENDINGS = (".mp4", ".gif")  # valid endings of movie files

_DPI = 200
_QUALITY = "18"  # of H.264, from 0 (best) to 51; at 18 no loss is visible
_BT709 = "bt709"  # the colour space that players assume
_TEXT: Any = {"svg.fonttype": "none", "svg.hashsalt": "voxflat", "pdf.fonttype": 42}
"""Text stays editable, and equal figures give equal files."""


def save(figure: Figure, path: str | os.PathLike[str], record: Record | None = None) -> None:
    """Write a figure to a file.

    The file is written completely or not at all. Text remains editable in SVG and PDF files. An SVG file of `flat_map`
    has named layers for Inkscape.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    path : path
        The file to write: ``.png``, ``.pdf``, ``.svg`` or another format that Matplotlib supports.
    record : dict, optional
        The provenance to store in the file: as text in PNG, as the subject in PDF, or as the description in SVG.

    Raises
    ------
    InputError
        If Matplotlib cannot write the format.
    OSError
        If the file cannot be written.

    See Also
    --------
    save_picture : Write an image.
    save_movie : Write a movie.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> voxflat.figures.save(voxflat.figures.scatter(flat_map), "scatter.pdf")
    """
    path = checked_path(path)
    checked_instance(figure, Figure, "figure", "a Matplotlib figure")
    kind = path.suffix[1:].lower()
    if kind not in figure.canvas.get_supported_filetypes():
        raise InputError(f"cannot write {path.name}: unknown format. Use a name that ends in .png, .pdf or .svg")
    with atomic_path(path) as temporary:
        with rc_context(_TEXT):
            figure.savefig(temporary, format=kind, dpi=max(_DPI, figure.dpi), metadata=_metadata(kind, record))
        if kind == "svg":
            name_layers(temporary, figure)


def _metadata(kind: str, record: Record | None) -> dict[str, Any] | None:
    """Return the metadata of a file: the record, and no date, so that identical figures produce identical files."""
    place = {"png": "Provenance", "pdf": "Subject", "svg": "Description"}.get(kind)
    stored = {} if place is None or record is None else {place: as_text(record)}
    return {**stored, **{"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind, {})} or None


def save_picture(picture: NDArray[np.uint8], path: str | os.PathLike[str], record: Record | None = None) -> None:
    """Write an image, such as the result of `patch_3d`, to a file.

    The file is written completely or not at all.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        The colours of the pixels; shapes (H, W) and (H, W, 4) are also accepted.
    path : path
        The file to write: ``.png``, ``.tif`` or another format that Pillow supports.
    record : dict, optional
        The provenance to store as text in a PNG file.

    Raises
    ------
    InputError
        If Pillow cannot write the format, or the array is not an image.
    OSError
        If the file cannot be written.

    See Also
    --------
    save : Write a figure.

    Examples
    --------
    >>> voxflat.figures.save_picture(np.zeros((4, 4, 3), np.uint8), "black.png")
    """
    path, array = checked_path(path), array_of(picture, "values of the image")
    if array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,), (4,)) or not array.size:
        description = f"shape {array.shape} and data type {array.dtype}"
        raise InputError(f"the image has {description}. Pass a uint8 array of shape (H, W, 3)")
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise InputError(f"cannot write {path.name}: unknown format. Use a name that ends in .png or .tif")
    with atomic_path(path) as temporary:
        more: dict[str, Any] = {}
        if path.suffix.lower() == ".png" and record is not None:
            more["pnginfo"] = PngImagePlugin.PngInfo()
            more["pnginfo"].add_itxt("Provenance", as_text(record))
        Image.fromarray(array).save(temporary, **more)


class _Pictures(Protocol):
    """The frames of a movie. Each frame is an image of shape (H, W, 3) with even height and width, drawn on request."""

    @property
    def size(self) -> tuple[int, int]: ...

    @property
    def rate(self) -> float: ...

    def __len__(self) -> int: ...

    def __getitem__(self, n: int) -> NDArray[np.uint8]: ...


def check_movie(path: str | os.PathLike[str]) -> None:
    """Raise an error if a movie cannot be written to a file with this name."""
    name = Path(path)
    if name.suffix.lower() not in MOVIE_ENDINGS:
        endings = " or ".join(MOVIE_ENDINGS)
        raise InputError(f"cannot write {name.name}: unknown movie format. Use a name that ends in {endings}")
    if name.suffix.lower() == ".mp4":
        require("imageio_ffmpeg")


def save_movie(
    movie: _Pictures, path: str | os.PathLike[str], record: Record | None = None, progress: Progress | None = None
) -> None:
    """Write a movie to a file.

    The file is written completely or not at all. For ``.mp4``, only one frame is in memory at a time; for ``.gif``, all
    frames are in memory.

    Parameters
    ----------
    movie : Movie
        The movie, or another sequence that draws its frames on request.
    path : path
        The file to write: ``.mp4`` (H.264, for slides and browsers; requires ``pip install 'voxflat[lab]'``) or
        ``.gif``. The duration of a GIF frame is a multiple of 0.01 s, and at least 0.02 s.
    record : dict, optional
        The provenance to store as a comment in the file.
    progress : callable, optional
        A function that is called as ``progress(stage, done, total)`` after each frame. If it returns False, the file is
        not written.

    Raises
    ------
    InputError
        If the file has another format, if the package that writes it is missing, or if a GIF requires more memory than
        is available.
    Cancelled
        If `progress` returned False.
    OSError
        If the file cannot be written.

    See Also
    --------
    movie : Make a movie.

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
        pictures = (movie[n] for n in range(len(movie)))
        write(temporary, movie, reporting(pictures, len(movie), path.name, progress), text)


def _write_mp4(path: Path, movie: _Pictures, pictures: Iterator[NDArray[np.uint8]], text: str) -> None:
    ffmpeg = require("imageio_ffmpeg")
    height, width = movie.size
    space = ["-colorspace", _BT709, "-color_primaries", _BT709, "-color_trc", _BT709]
    more = ["-crf", _QUALITY, "-vf", f"scale=out_color_matrix={_BT709}", *space, "-movflags", "+faststart"]
    codec = {"codec": "libx264", "fps": movie.rate, "quality": None, "macro_block_size": 2}
    comment = ["-metadata", f"comment={text}"]
    writer = ffmpeg.write_frames(str(path), (width, height), **codec, output_params=[*more, *comment])
    try:
        writer.send(None)
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture))
    except OSError as error:
        if error.errno is not None:
            raise
        raise InputError(f"ffmpeg failed: {one_line(error)}. Reinstall imageio-ffmpeg, or write a .gif file") from error
    finally:
        writer.close()


def _write_gif(path: Path, movie: _Pictures, pictures: Iterator[NDArray[np.uint8]], text: str) -> None:
    height, width = movie.size
    check_room(2 * len(movie) * height * width)  # Pillow keeps all frames
    stills = [Image.fromarray(movie[n]) for n in sorted({0, len(movie) // 2, len(movie) - 1})]
    together = Image.fromarray(np.concatenate([np.asarray(picture) for picture in stills]))
    palette = together.quantize(255, method=Image.Quantize.MAXCOVERAGE)
    frames = (Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    lasts = max(2, round(100 / movie.rate)) * 10  # ms; players slow down frames of less than 20 ms
    first = next(frames)
    first.save(
        path, format="GIF", save_all=True, append_images=frames, duration=lasts, loop=0, comment=text.encode("utf-8")
    )
