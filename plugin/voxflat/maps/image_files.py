"""Flat images as files: PNG for viewing, TIFF and NIfTI for measurements, NumPy for further use."""

import gzip
import json
import os
import textwrap
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Protocol, TypeVar
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_path
from voxflat.errors import Cancelled, InputError
from voxflat.io.channels import Timing
from voxflat.io.files import atomic_directory, atomic_path, require, save_array
from voxflat.io.grid import LONG_NAMES, millimetres
from voxflat.io.provenance import Record, as_text, portable
from voxflat.io.volumes import write_volume
from voxflat.maps.colours import WINDOW, all_whole, label_colours, levels

_TIFF_DESCRIPTION, _TIFF_PAGE_NAME, _TIFF_CENTIMETRE = 270, 285, 3
_TIFF_LIMIT = 1 << 32  # bytes
_GZIP_LEVEL = 1  # as in nibabel; higher levels hardly compress noise
_OME = "http://www.openmicroscopy.org/Schemas/OME/2016-06"


_T = TypeVar("_T")
_Values = Iterator[NDArray[np.float32]]


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


class _Stack(Protocol):
    """The properties of `FlatStack` that this module uses."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def layers(self) -> tuple[str, ...]: ...
    @property
    def heights(self) -> tuple[float, ...]: ...
    @property
    def timing(self) -> Timing | None: ...
    @property
    def name(self) -> str: ...
    @property
    def channel_names(self) -> tuple[str, ...]: ...
    def __len__(self) -> int: ...
    def __getitem__(self, channel: int) -> _Image: ...


def write_image(path: str | os.PathLike[str], image: _Image, record: Record) -> None:
    """Write a flat image to a file (completely or not at all); see `FlatImage.save`."""
    path = checked_path(path)
    write = next((write for ending, write in _WRITERS.items() if path.name.lower().endswith(ending)), None)
    if write is None:
        raise InputError(f"cannot save an image as {path.name}. Use a name that ends in {', '.join(IMAGE_ENDINGS)}")
    write(path, image, record)


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
    from PIL import Image, TiffImagePlugin

    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[_TIFF_DESCRIPTION] = _described(image, image.name, record)
    pixels = Image.fromarray(_measured(image.data))
    with atomic_path(path) as temporary:
        pixels.save(temporary, format="TIFF", tiffinfo=tags, **_resolution(image))


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


def write_stack(path: str | os.PathLike[str], stack: _Stack, record: Record, progress: Progress | None) -> None:
    """Write several images to one file (completely or not at all); see `FlatStack.save`."""
    path = checked_path(path)
    write = next((write for ending, write in _STACK_WRITERS.items() if path.name.lower().endswith(ending)), None)
    if write is None:
        endings = ", ".join(_STACK_WRITERS)
        listed = textwrap.shorten(", ".join(map(str, stack.names if any(stack.names) else range(len(stack)))), 300)
        raise InputError(
            f"{path.name} can hold only one image, but there are {len(stack)} ({listed}). Select one by name or number "
            f"(channel), or use a name that ends in {endings}"
        )
    first = stack[0]
    if first.data.ndim != 2:
        raise InputError("colours cannot be saved as channels. Save each colour image separately")
    images = chain([first], (stack[n] for n in range(1, len(stack))))
    values = (_measured(image.data).astype("<f4", copy=False) for image in images)
    with atomic_directory(path) if write is _write_zarr else atomic_path(path) as temporary:
        write(temporary, stack, first, reporting(values, len(stack), path.name, progress), record)


def reporting(images: Iterator[_T], count: int, name: str, progress: Progress | None) -> Iterator[_T]:
    """Yield the images of a file that is being written, and report progress after each."""
    for done, image in enumerate(images, 1):
        yield image
        if progress is not None and progress(f"writing {name}", done, count) is False:
            raise Cancelled(f"cancelled while writing {name}")


def _frames_and_channels(stack: _Stack) -> tuple[int, tuple[str, ...]]:
    """Return the number of frames of a stack (1 if it is not a series), and the names of the channels of each frame."""
    names = stack.channel_names
    return (1, names) if stack.timing is None else (len(names), ("",))


def _depth_step(stack: _Stack) -> float | None:
    """Return the distance between evenly spaced depths, if there are several."""
    steps = np.diff(stack.heights)
    is_even = len(steps) > 0 and steps[0] > 0 and np.allclose(steps, steps[0])
    return float(steps[0]) if is_even else None


def _write_tiff_pages(path: Path, stack: _Stack, first: _Image, values: _Values, record: Record) -> None:
    from PIL import Image as Pillow
    from PIL import TiffImagePlugin

    if len(stack) * (first.data.size * 4 + 4096) > _TIFF_LIMIT:
        raise InputError(f"{len(stack)} images exceed the 4 GiB limit of TIFF. Save as .nii, .zarr or .npy")
    with TiffImagePlugin.AppendingTiffWriter(str(path), True) as file:
        for n, pixels in enumerate(values):
            tags = TiffImagePlugin.ImageFileDirectory_v2()
            if n == 0:
                tags[_TIFF_DESCRIPTION] = _ome(stack, first, record)
            tags[_TIFF_PAGE_NAME] = stack.names[n] or str(n)
            Pillow.fromarray(pixels).save(file, format="TIFF", tiffinfo=tags, **_resolution(first))
            file.newFrame()


def _ome(stack: _Stack, first: _Image, record: Record) -> str:
    """Return the OME-XML description, from which Bio-Formats, Fiji and tifffile read the axes and units."""
    frames, channels = _frames_and_channels(stack)
    height, width = first.data.shape
    pixels = {"ID": "Pixels:0", "DimensionOrder": "XYZCT", "Type": "float", "SizeX": str(width), "SizeY": str(height)}
    pixels |= {"SizeC": str(len(channels)), "SizeZ": str(max(1, len(stack.layers))), "SizeT": str(frames)}
    step = _depth_step(stack)
    sizes = dict.fromkeys("XY", float(first.affine[2, 2])) | ({} if step is None else {"Z": step})
    for axis, size in sizes.items() if first.unit != "unknown" else ():
        unit = {"inch": "in"}.get(first.unit, first.unit)
        pixels |= {f"PhysicalSize{axis}": f"{size:.9g}", f"PhysicalSize{axis}Unit": unit}
    if stack.timing is not None:
        pixels |= {"TimeIncrement": f"{stack.timing.step:.9g}", "TimeIncrementUnit": "s"}
    root = ElementTree.Element("OME", {"xmlns": _OME})
    image = ElementTree.SubElement(root, "Image", {"ID": "Image:0", "Name": stack.name})
    ElementTree.SubElement(image, "Description").text = _described(first, stack.name, record)
    body = ElementTree.SubElement(image, "Pixels", pixels)
    for n, name in enumerate(channels):
        named = {"Name": name} if name else {}
        ElementTree.SubElement(body, "Channel", {"ID": f"Channel:0:{n}", **named, "SamplesPerPixel": "1"})
    ElementTree.SubElement(body, "TiffData")
    text: bytes = ElementTree.tostring(root, encoding="us-ascii")  # TIFF text is ASCII
    return text.decode("ascii")


def _write_nifti_series(path: Path, stack: _Stack, first: _Image, values: _Values, record: Record) -> None:
    nibabel = require("nibabel")
    height, width = first.data.shape
    if max(height, width, len(stack)) > np.iinfo(np.int16).max:
        raise InputError(f"{len(stack)} images of {width} x {height} pixels exceed the limits of NIfTI-1. Save as .npy")
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.float32)
    depths, timing = max(1, len(stack.layers)), stack.timing
    shape = (height, width, depths, len(stack) // depths)
    affine, has_unit = _placed(first)
    step = _depth_step(stack)
    if step is not None:
        affine[2, 2:] = affine[2, 2] / first.affine[2, 2] * np.array([step, stack.heights[0]])  # in mm
    header.set_data_shape(shape if depths == 1 or shape[3] > 1 else shape[:3])
    zooms = (*np.linalg.norm(affine[:3, :3], axis=0), 1.0 if timing is None else timing.step)
    header.set_zooms(zooms[: len(header.get_data_shape())])
    header.set_sform(affine, "scanner")
    header.set_qform(affine, "scanner")
    header.set_xyzt_units("mm" if has_unit else "unknown", None if timing is None else "sec")
    header["toffset"] = 0 if timing is None else timing.start
    header["scl_slope"], header["scl_inter"] = 1, 0
    told: dict[str, Any] = {"names": list(stack.names)} if any(stack.names) else {}
    if record:
        told["provenance"] = record
    if told:
        header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", as_text(told).encode()))
    is_packed = path.name.lower().endswith(".gz")
    packed: Any = {"mode": "wb", "compresslevel": _GZIP_LEVEL, "mtime": 0}
    with path.open("wb") as plain, gzip.GzipFile(fileobj=plain, **packed) if is_packed else plain as file:
        header.write_to(file)
        file.write(bytes(int(header["vox_offset"]) - file.tell()))
        for pixels in values:
            file.write(pixels.tobytes(order="F"))


def names_in(path: Path) -> tuple[str, ...]:
    """Return the names of the images that voxflat stored in a NIfTI file; empty if there are none."""
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        return ()
    for extension in require("nibabel").load(path).header.extensions:
        try:
            names = json.loads(extension.get_content().rstrip(b"\0"))["names"]
        except (ValueError, KeyError, TypeError, AttributeError):  # of another program
            continue
        if isinstance(names, list):
            return tuple(map(str, names))
    return ()


def _write_npy_series(path: Path, stack: _Stack, first: _Image, values: _Values, record: Record) -> None:
    depths = len(stack.layers)
    shape = (len(stack) // depths, depths) if 0 < depths < len(stack) else (len(stack),)
    described = {"descr": "<f4", "fortran_order": False, "shape": (*shape, *first.data.shape)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, described)
        for pixels in values:
            file.write(pixels.tobytes())


def _write_zarr(path: Path, stack: _Stack, first: _Image, values: _Values, record: Record) -> None:
    """Write OME-Zarr 0.4, which all readers support, with axes t and c (or one), z for depths, y = −v, x = u."""
    zarr = require("zarr")
    form: Any = {"zarr_format": 2} if int(zarr.__version__.split(".")[0]) > 2 else {}  # the only format before
    frames, channels = _frames_and_channels(stack)
    affine, named = first.affine, LONG_NAMES.get(first.unit)
    timing, size = stack.timing, float(affine[2, 2])
    u, v = affine[:2, 3].tolist()
    leading: list[tuple[dict[str, str], int, float, float]] = []
    if timing is not None:
        leading.append(({"name": "t", "type": "time", "unit": "second"}, frames, timing.step, timing.start))
    if timing is None or len(channels) > 1:
        leading.append(({"name": "c", "type": "channel"}, len(channels), 1.0, 0.0))
    step = _depth_step(stack)
    if stack.layers:
        depth = {"name": "z", "type": "space"} | ({"unit": named} if named and step is not None else {})
        leading.append((depth, len(stack.layers), step or 1.0, 0.0 if step is None else stack.heights[0]))
    lengths = tuple(length for _, length, _, _ in leading)
    space = [{"name": name, "type": "space", **({"unit": named} if named else {})} for name in "yx"]
    transforms = [
        {"type": "scale", "scale": [*(step for _, _, step, _ in leading), size, size]},
        {"type": "translation", "translation": [*(start for _, _, _, start in leading), -v, u]},
    ]
    group = zarr.open_group(str(path), mode="a", **form)
    axes = [*(axis for axis, _, _, _ in leading), *space]
    datasets = [{"path": "0", "coordinateTransformations": transforms}]
    group.attrs["multiscales"] = [{"version": "0.4", "name": stack.name, "axes": axes, "datasets": datasets}]
    group.attrs["voxflat"] = {"affine": affine.tolist(), "names": list(stack.names), "provenance": portable(record)}
    if timing is None and any(channels):
        group.attrs["omero"] = {"channels": [_rendering(name) for name in channels]}
    shape, chunks = (*lengths, *first.data.shape), (*[1] * len(lengths), *first.data.shape)
    form |= {"dtype": "<f4", "fill_value": np.nan, "dimension_separator": "/"}
    array = zarr.open_array(str(path / "0"), mode="w", shape=shape, chunks=chunks, **form)
    for n, pixels in enumerate(values):
        array[np.unravel_index(n, lengths)] = pixels


def _rendering(name: str) -> dict[str, Any]:
    """Return the name of a channel as OME-Zarr stores it, beside a colour, which is mandatory."""
    return {"label": name, "color": "FFFFFF", "active": True}


_STACK_WRITERS: dict[str, Callable[[Path, _Stack, _Image, _Values, Record], None]] = {
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
    known = {"x_resolution": per_cm, "y_resolution": per_cm, "resolution_unit": _TIFF_CENTIMETRE}
    return known if has_unit else {}


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
