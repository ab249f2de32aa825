"""Flat images as files: PNG for viewing, TIFF and NIfTI for measurements, NumPy for further use."""

import gzip
import json
import os
import textwrap
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Protocol, TypeVar
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_path, printable
from voxflat.errors import Cancelled, InputError
from voxflat.io.channels import Timing
from voxflat.io.files import atomic_directory, atomic_path, by_ending, require, save_array
from voxflat.io.grid import LONG_NAMES, millimetres
from voxflat.io.provenance import Record, Recorded, as_text, portable, saving
from voxflat.io.volumes import write_volume
from voxflat.maps.colours import WINDOW, all_whole, label_colours, levels

_TIFF_DESCRIPTION, _TIFF_PAGE_NAME, _TIFF_CENTIMETRE = 270, 285, 3
_TIFF_LIMIT = 1 << 32  # bytes
_GZIP_LEVEL = 1  # as in nibabel; higher levels hardly compress noise
_OME = "http://www.openmicroscopy.org/Schemas/OME/2016-06"


_T = TypeVar("_T")
_Values = Iterator[NDArray[Any]]  # float32, or uint8 colours of a single image


class _Image(Protocol):
    """The properties of `FlatImage` that this module uses."""

    @property
    def data(self) -> NDArray[Any]: ...
    @property
    def affine(self) -> NDArray[np.float64]: ...
    @property
    def unit(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def is_labels(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class Pages:
    """Images that are written to one file: all depths of each channel, for each frame.

    A series of single images has one channel without a name. `frames` is None if there is no series.
    """

    images: Sequence[_Image]
    names: tuple[str, ...]  # of the images
    channels: tuple[str, ...]  # names
    layers: tuple[str, ...]  # names of the depths, if there are several
    heights: tuple[float, ...]
    frames: int | None
    timing: Timing | None
    title: str

    @property
    def count(self) -> int:
        """The number of images."""
        return len(self.names)

    @property
    def shape(self) -> tuple[int, ...]:
        """The numbers of frames, channels and depths; files omit those that do not apply."""
        several = [] if self.frames is None else [self.frames]
        if self.frames is None or len(self.channels) > 1:
            several.append(len(self.channels))
        return (*several, *([len(self.layers)] if self.layers else []))


def write_image(path: Path, image: _Image, record: Record) -> None:
    """Write a flat image to a file (completely or not at all); see `FlatImage.save`."""
    by_ending(path, _WRITERS)(path, image, record)


def _placed(image: _Image) -> tuple[NDArray[np.float64], bool]:
    """Return the affine of an image and whether its unit is known; if so, the affine is in mm."""
    if image.unit == "unknown":
        return image.affine, False
    return np.asarray(np.diag([millimetres(image.unit)] * 3 + [1.0]) @ image.affine), True


def _write_png(path: Path, image: _Image, record: Record) -> None:
    from PIL import Image, PngImagePlugin

    text = PngImagePlugin.PngInfo()
    if image.data.ndim == 3:
        pixels, values = image.data, "colours"
    elif image.is_labels:
        pixels, values = label_colours(image.data), "labels, each in its own colour"
    else:
        pixels, values = _grey(image.data)
    for key, value in {**_description(image, image.name, record), "Values": values}.items():
        text.add_itxt(key, value)
    affine, has_unit = _placed(image)
    per_inch = 25.4 / affine[2, 2]  # PNG stores whole pixels per metre, so the pixel size is also written as text
    resolution = {"dpi": (per_inch, per_inch)} if has_unit else {}
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG", pnginfo=text, **resolution)


def _write_tiff(path: Path, image: _Image, record: Record) -> None:
    names = (image.name,)
    pages = Pages([image], names, channels=names, layers=(), heights=(), frames=None, timing=None, title=image.name)
    with atomic_path(path) as temporary:
        _write_tiff_pages(temporary, pages, image, iter([_measured(image.data)]), record)


def _write_nifti(path: Path, image: _Image, record: Record) -> None:
    affine, has_unit = _placed(image)
    write_volume(path, _measured(image.data)[:, :, None], affine, record, has_unit=has_unit)


def _write_npy(path: Path, image: _Image, record: Record) -> None:
    with atomic_path(path) as temporary:
        save_array(temporary, image.data)


_WRITERS: dict[str, Callable[[Path, _Image, Record], None]] = {
    ".png": _write_png,
    **dict.fromkeys((".tif", ".tiff"), _write_tiff),
    **dict.fromkeys((".nii", ".nii.gz"), _write_nifti),
    ".npy": _write_npy,
}
IMAGE_ENDINGS = tuple(_WRITERS)  # endings of the files that `FlatImage.save` writes


def write_stack(path: str | os.PathLike[str], pages: Pages, record: Record, progress: Progress | None) -> None:
    """Write several images to one file (completely or not at all); see `FlatStack.save`."""
    path = checked_path(path)
    write = next((write for ending, write in _STACK_WRITERS.items() if path.name.lower().endswith(ending)), None)
    if write is None:
        endings = ", ".join(_STACK_WRITERS)
        names = map(str, pages.names if any(pages.names) else range(pages.count))
        listed = textwrap.shorten(", ".join(names), 300, placeholder=" ...")
        raise InputError(
            f"{path.name} can hold only one image, but there are {pages.count} ({listed}). Select one by name or "
            f"number (channel), or use a name that ends in {endings}"
        )
    first = pages.images[0]
    if first.data.ndim != 2:
        raise InputError("colours cannot be saved as channels. Save each colour image separately")
    images = chain([first], (pages.images[n] for n in range(1, pages.count)))
    values = (_measured(image.data).astype("<f4", copy=False) for image in images)
    with atomic_directory(path) if write is _write_zarr else atomic_path(path) as temporary:
        write(temporary, pages, first, reporting(values, pages.count, path.name, progress), record)


class SavedPages(Recorded):
    """Base class of images that are saved to one file."""

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        sidecar: bool = False,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> None:
        """Save all images to one file.

        Images are sampled and written one by one, after the volumes of all frames have been checked. The file is
        written either completely or not at all.

        Parameters
        ----------
        path : path
            ``.tif`` and ``.tiff`` are OME-TIFF files with one page per image; depths are slices (Z), and the axes of a
            movie are TCZYX. ``.nii`` and ``.nii.gz`` files have shape (H, W, D) for D depths or (H, W, D, K) for K
            channels, or K frames of a single channel, with the names in a header extension (JSON). ``.zarr`` is a new
            OME-Zarr 0.4 directory with one chunk per image, y = −v and x = u. These formats store the pixel size and
            the distance between evenly spaced depths and, for series, the time between frames in seconds. ``.npy`` has
            shape (K, H, W), (D, H, W) or (K, D, H, W), or that of `FlatMovie.data`, and no names. Values are float32,
            with NaN outside the map. All formats except ``.npy`` include `provenance`.
        sidecar, overwrite : bool
            As in `FlatImage.save`; directories are never replaced.
        progress : callable, optional
            Called as ``progress(stage, done, total)`` after each image. If it returns False, nothing is written.

        Raises
        ------
        InputError
            If the file extension is not supported (``.png`` holds one image), the format cannot hold the values, the
            path is an input file, or the volumes of the frames differ in shape or number of channels.
        Cancelled
            If `progress` returned False.
        OSError
            If the file cannot be written.
        """
        record = self._checked(progress)
        with saving(path, record, sidecar=sidecar, overwrite=overwrite):
            write_stack(path, self._pages, record, progress)

    def _checked(self, progress: Progress | None) -> Record:
        """Check the images before the file is written; return the record that it stores."""
        image: Any = self
        record: Record = image.provenance
        return record

    @property
    @abstractmethod
    def _pages(self) -> Pages:
        """The images and their axes, as files describe them."""


def reporting(images: Iterator[_T], count: int, name: str, progress: Progress | None) -> Iterator[_T]:
    """Yield the images of a file that is being written, and report progress after each."""
    for done, image in enumerate(images, 1):
        yield image
        if progress is not None and progress(f"writing {name}", done, count) is False:
            raise Cancelled(f"cancelled while writing {name}")


def _depth_step(pages: Pages) -> float | None:
    """Return the distance between evenly spaced depths, if there are several."""
    steps = np.diff(pages.heights)
    is_even = len(steps) > 0 and steps[0] > 0 and np.allclose(steps, steps[0])
    return float(steps[0]) if is_even else None


def _write_tiff_pages(path: Path, pages: Pages, first: _Image, values: _Values, record: Record) -> None:
    from PIL import Image as Pillow
    from PIL import TiffImagePlugin

    if pages.count * (first.data.size * 4 + 4096) > _TIFF_LIMIT:
        raise InputError(f"{pages.count} images exceed the 4 GiB limit of TIFF. Save as .nii, .zarr or .npy")
    with TiffImagePlugin.AppendingTiffWriter(str(path), True) as file:
        for n, pixels in enumerate(values):
            tags = TiffImagePlugin.ImageFileDirectory_v2()
            if n == 0:
                tags[_TIFF_DESCRIPTION] = _ome(pages, first, record)
            tags[_TIFF_PAGE_NAME] = pages.names[n] or str(n)
            Pillow.fromarray(pixels).save(file, format="TIFF", tiffinfo=tags, **_resolution(first))
            file.newFrame()


def _ome(pages: Pages, first: _Image, record: Record) -> str:
    """Return the OME-XML description, from which Bio-Formats, Fiji and tifffile read the axes and units."""
    height, width, *samples = first.data.shape
    count = samples[0] if samples else 1  # of a colour, whose samples are one channel
    pixels = {"ID": "Pixels:0", "DimensionOrder": "XYZCT", "SizeX": str(width), "SizeY": str(height)}
    pixels |= {"Type": "uint8" if samples else "float"}
    pixels |= {"SizeC": str(count * len(pages.channels)), "SizeZ": str(max(1, len(pages.layers)))}
    pixels |= {"SizeT": str(pages.frames or 1)}
    step = _depth_step(pages)
    sizes = dict.fromkeys("XY", float(first.affine[2, 2])) | ({} if step is None else {"Z": step})
    for axis, size in sizes.items() if first.unit != "unknown" else ():
        unit = {"inch": "in"}.get(first.unit, first.unit)
        pixels |= {f"PhysicalSize{axis}": f"{size:.9g}", f"PhysicalSize{axis}Unit": unit}
    if pages.timing is not None:
        pixels |= {"TimeIncrement": f"{pages.timing.step:.9g}", "TimeIncrementUnit": "s"}
    root = ElementTree.Element("OME", {"xmlns": _OME})
    image = ElementTree.SubElement(root, "Image", {"ID": "Image:0", "Name": printable(pages.title)})
    ElementTree.SubElement(image, "Description").text = _described(first, printable(pages.title), record)
    body = ElementTree.SubElement(image, "Pixels", pixels)
    for n, name in enumerate(pages.channels):
        named = {"Name": printable(name)} if name else {}
        ElementTree.SubElement(body, "Channel", {"ID": f"Channel:0:{n}", **named, "SamplesPerPixel": str(count)})
    ElementTree.SubElement(body, "TiffData")
    text: bytes = ElementTree.tostring(root, encoding="us-ascii")  # TIFF text is ASCII
    return text.decode("ascii")


def _write_nifti_series(path: Path, pages: Pages, first: _Image, values: _Values, record: Record) -> None:
    nibabel = require("nibabel")
    height, width = first.data.shape
    if pages.frames is not None and len(pages.channels) > 1:
        count = len(pages.channels)
        raise InputError(f"NIfTI cannot hold {count} channels of each frame. Save as .ome.tif, .zarr or .npy")
    if max(height, width, pages.count) > np.iinfo(np.int16).max:
        raise InputError(
            f"{pages.count} images of {width} x {height} pixels exceed the limits of NIfTI-1. Save as .npy"
        )
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.float32)
    depths, timing = max(1, len(pages.layers)), pages.timing
    shape = (height, width, depths, pages.count // depths)
    affine, has_unit = _placed(first)
    step = _depth_step(pages)
    if step is not None:
        affine[2, 2:] = affine[2, 2] / first.affine[2, 2] * np.array([step, pages.heights[0]])  # in mm
    header.set_data_shape(shape if depths == 1 or shape[3] > 1 else shape[:3])
    zooms = (*np.linalg.norm(affine[:3, :3], axis=0), 1.0 if timing is None else timing.step)
    header.set_zooms(zooms[: len(header.get_data_shape())])
    header.set_sform(affine, "scanner")
    header.set_qform(affine, "scanner")
    header.set_xyzt_units("mm" if has_unit else "unknown", None if timing is None else "sec")
    header["toffset"] = 0 if timing is None else timing.start
    header["scl_slope"], header["scl_inter"] = 1, 0
    content: dict[str, Any] = {"names": list(pages.names)} if any(pages.names) else {}
    if record:
        content["provenance"] = record
    if content:
        header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", as_text(content).encode()))
    is_packed = path.name.lower().endswith(".gz")
    packed: Any = {"mode": "wb", "compresslevel": _GZIP_LEVEL, "mtime": 0}
    with path.open("wb") as plain, gzip.GzipFile(fileobj=plain, **packed) if is_packed else plain as file:
        header.write_to(file)
        file.write(bytes(int(header["vox_offset"]) - file.tell()))
        for pixels in values:
            file.write(pixels.tobytes(order="F"))


def names_in(path: Path) -> tuple[str, ...]:
    """Return the names of the images that voxflat stored in a NIfTI file; empty if there are none."""
    names = (content["names"] for content in _told_in(path) if isinstance(content.get("names"), list))
    return tuple(map(str, next(names, ())))


def is_flat(path: Path, shape: tuple[int, ...], affine: NDArray[np.float64]) -> bool:
    """Return whether a file is NIfTI with flat images that voxflat wrote, by its affine to mm and its header."""
    size = float(affine[0, 1])
    plane = np.array([[0, size, 0], [-size, 0, 0], [0, 0, affine[2, 2]]])
    if size <= 0 or not np.allclose(affine[:3, :3], plane, rtol=0, atol=1e-6 * size):
        return False
    # volumes hold their record itself; a slice with this affine is a single image
    records = (content if shape[2:] == (1,) else content.get("provenance") for content in _told_in(path))
    return any(isinstance(record, dict) and "voxflat" in record for record in records)


def _told_in(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the objects in the header extensions of a NIfTI file."""
    if path.name.lower().endswith((".nii", ".nii.gz")):
        for extension in require("nibabel").load(path).header.extensions:
            with suppress(ValueError, TypeError, AttributeError):  # of another program
                content = json.loads(extension.get_content().rstrip(b"\0"))
                if isinstance(content, dict):
                    yield content


def _write_npy_series(path: Path, pages: Pages, first: _Image, values: _Values, record: Record) -> None:
    is_single = pages.frames is None and len(pages.layers) == pages.count
    shape = (*pages.shape[is_single:], *first.data.shape)
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, described)
        for pixels in values:
            file.write(pixels.tobytes())


def _write_zarr(path: Path, pages: Pages, first: _Image, values: _Values, record: Record) -> None:
    """Write OME-Zarr 0.4, which all readers support, with axes t and c (or one), z for depths, y = −v, x = u."""
    zarr = require("zarr")
    form: Any = {"zarr_format": 2} if int(zarr.__version__.split(".")[0]) > 2 else {}  # the only format before
    affine, named = first.affine, LONG_NAMES.get(first.unit)
    timing, size = pages.timing, float(affine[2, 2])
    u, v = affine[:2, 3].tolist()
    leading: list[tuple[dict[str, str], int, float, float]] = []
    if pages.frames is not None:
        time = {"name": "t", "type": "time"} | ({} if timing is None else {"unit": "second"})
        leading.append((time, pages.frames, *((1.0, 0.0) if timing is None else (timing.step, timing.start))))
    if pages.frames is None or len(pages.channels) > 1:
        leading.append(({"name": "c", "type": "channel"}, len(pages.channels), 1.0, 0.0))
    step = _depth_step(pages)
    if pages.layers:
        depth = {"name": "z", "type": "space"} | ({"unit": named} if named and step is not None else {})
        leading.append((depth, len(pages.layers), step or 1.0, 0.0 if step is None else pages.heights[0]))
    lengths = tuple(length for _, length, _, _ in leading)
    space = [{"name": name, "type": "space", **({"unit": named} if named else {})} for name in "yx"]
    transforms = [
        {"type": "scale", "scale": [*(step for _, _, step, _ in leading), size, size]},
        {"type": "translation", "translation": [*(start for _, _, _, start in leading), -v, u]},
    ]
    group = zarr.open_group(str(path), mode="a", **form)
    axes = [*(axis for axis, _, _, _ in leading), *space]
    datasets = [{"path": "0", "coordinateTransformations": transforms}]
    group.attrs["multiscales"] = [{"version": "0.4", "name": pages.title, "axes": axes, "datasets": datasets}]
    group.attrs["voxflat"] = {"affine": affine.tolist(), "names": list(pages.names), "provenance": portable(record)}
    if any(pages.channels):
        state = {"color": "FFFFFF", "active": True}  # mandatory
        group.attrs["omero"] = {"channels": [{"label": name, **state} for name in pages.channels]}
    shape, chunks = (*lengths, *first.data.shape), (*[1] * len(lengths), *first.data.shape)
    form |= {"dtype": "<f4", "fill_value": np.nan, "dimension_separator": "/"}
    array = zarr.open_array(str(path / "0"), mode="w", shape=shape, chunks=chunks, **form)
    for n, pixels in enumerate(values):
        array[np.unravel_index(n, lengths)] = pixels


_STACK_WRITERS: dict[str, Callable[[Path, Pages, _Image, _Values, Record], None]] = {
    **dict.fromkeys((".tif", ".tiff"), _write_tiff_pages),
    **dict.fromkeys((".nii", ".nii.gz"), _write_nifti_series),
    ".zarr": _write_zarr,
    ".npy": _write_npy_series,
}
STACK_ENDINGS = tuple(_STACK_WRITERS)  # endings of the files that `FlatStack.save` writes


def _described(image: _Image, name: str, record: Record) -> str:
    return "; ".join(f"{key}: {value}" for key, value in _description(image, name, record).items())


def _resolution(image: _Image) -> dict[str, float]:
    """Return the TIFF resolution tags."""
    affine, has_unit = _placed(image)
    per_cm = 10 / float(affine[2, 2])
    tags = {"x_resolution": per_cm, "y_resolution": per_cm, "resolution_unit": _TIFF_CENTIMETRE}
    return tags if has_unit else {}


def _description(image: _Image, name: str, record: Record) -> dict[str, str]:
    (u, v), unit = image.affine[:2, 3], f" {image.unit}".replace("µ", "u") if image.unit != "unknown" else ""
    return {
        "Title": name,
        "Pixel size": f"{image.affine[2, 2]:.9g}{unit}",
        "Centre of the upper left pixel": f"u = {u:.9g}{unit}, v = {v:.9g}{unit}",
        "Software": "voxflat",
        "Provenance": as_text(record),
    }


def _grey(data: NDArray[Any]) -> tuple[NDArray[np.uint8], str]:
    """Return grey levels and opacity (H, W, 2), and a description of the values shown as black and white."""
    inside = np.isfinite(data)
    level, (low, high) = levels(data, None)
    pixels = np.zeros((*data.shape, 2), dtype=np.uint8)
    pixels[inside, 0] = np.round(255 * level[inside])
    pixels[inside, 1] = 255
    return pixels, f"black {low:g}, white {high:g} ({WINDOW[0]}st and {WINDOW[1]}th percentiles)"


def _measured(data: NDArray[Any]) -> NDArray[Any]:
    """Return colours unchanged and values as float32; labels that float32 cannot represent raise an error."""
    if data.ndim == 3:
        return data
    single = data.astype(np.float32)
    if all_whole(data) and not np.array_equal(single, data, equal_nan=True):
        most = np.nanmax(np.abs(data))
        raise InputError(
            f"the largest label, {most:.0f}, is too large for float32, which this format uses. Save as .npy"
        )
    return single
