"""Check that TIFF files are complete, because tifffile reads the pages that it finds and only logs missing ones."""

import math
import struct
from pathlib import Path
from typing import IO, Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, check_regular, companion, require
from voxflat.io.reading import record_file

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_WHOLE = {1: "u1", 3: "u2", 4: "u4", 13: "u4", 16: "u8", 18: "u8"}  # types of tags that are whole numbers
_WIDTH, _LENGTH, _BITS, _COMPRESSION, _SAMPLES, _PLANAR = 256, 257, 258, 259, 277, 284
_STRIPS, _TILES = (273, 279), (324, 325)  # tags of offsets and of sizes in bytes
_ROWS, _TILE_WIDTH, _TILE_LENGTH = 278, 322, 323
_SHORT = f"ends before its last page. {AGAIN}"


def check_pages(path: Path) -> None:
    """Raise an error if the file ends before a page, a tag, or a strip or tile of pixels that its tables list."""
    size = check_regular(path).st_size
    with path.open("rb") as file:
        order, is_big, offset = _header(file)
        seen: set[int] = set()
        while offset:
            if offset in seen:
                raise InputError(f"its list of pages has no end. {AGAIN}")
            seen.add(offset)
            tags, offset = _tags(file, offset, size, order, is_big=is_big)
            _check_pixels(tags, size, len(seen) - 1)
    if not seen:
        raise InputError(f"contains no pages. {AGAIN}")


def _header(file: IO[bytes]) -> tuple[Literal["<", ">"], bool, int]:
    """Return the order of bytes, whether the file is a BigTIFF file, and the position of the first page."""
    head = file.read(16)
    order: Literal["<", ">"] = ">" if head[:2] == b"MM" else "<"
    if head[:2] not in (b"II", b"MM") or len(head) < 8:
        raise InputError("is not a TIFF file. Check that its ending matches its format")
    version = struct.unpack_from(f"{order}H", head, 2)[0]
    if version == 43 and len(head) == 16:
        return order, True, struct.unpack_from(f"{order}Q", head, 8)[0]
    if version != 42:
        raise InputError("is not a TIFF file. Check that its ending matches its format")
    return order, False, struct.unpack_from(f"{order}I", head, 4)[0]


def _tags(
    file: IO[bytes], offset: int, size: int, order: str, *, is_big: bool
) -> tuple[dict[int, NDArray[np.uint64]], int]:
    """Return the tags of a page that are whole numbers, and the position of the next page, 0 for none."""

    def taken(position: int, length: int) -> bytes:
        if position + length > size:
            raise InputError(_SHORT)
        file.seek(position)
        return file.read(length)

    counting, row, link = ("Q", 20, "Q") if is_big else ("H", 12, "I")
    start = offset + struct.calcsize(counting)
    number = struct.unpack(order + counting, taken(offset, start - offset))[0]
    table = taken(start, number * row + struct.calcsize(link))
    tags = {}
    for place in range(0, number * row, row):
        code, kind, count = struct.unpack_from(f"{order}HH{link}", table, place)
        inline = table[place + row - struct.calcsize(link) : place + row]
        length = _SIZES.get(kind, 0) * count
        value = inline if length <= len(inline) else taken(struct.unpack(order + link, inline)[0], length)
        if kind in _WHOLE:
            tags[code] = np.frombuffer(value[:length], order + _WHOLE[kind]).astype(np.uint64)
    return tags, struct.unpack_from(order + link, table, number * row)[0]


def _check_pixels(tags: dict[int, NDArray[np.uint64]], size: int, page: int) -> None:
    """Raise an error if a strip or tile of a page is missing, or not completely in the file."""

    def one(code: int, default: int) -> int:
        return int(tags[code][0]) if len(tags.get(code, ())) else default

    width, length, samples = one(_WIDTH, 0), one(_LENGTH, 0), one(_SAMPLES, 1)
    is_tiled = _TILES[0] in tags
    offsets, counts = (tags.get(code, np.empty(0, np.uint64)) for code in (_TILES if is_tiled else _STRIPS))
    need = length * -(-width * int(tags.get(_BITS, np.ones(1)).max()) // 8) * samples
    if not len(counts) and len(offsets) == 1 and one(_COMPRESSION, 1) == 1:
        counts = np.array([need], np.uint64)
    sizes = (one(_TILE_WIDTH, 0), one(_TILE_LENGTH, 0)) if is_tiled else (width, min(one(_ROWS, length), length))
    if not (width and length and all(sizes)):
        raise InputError(f"its page {page} has no pixels. {AGAIN}")
    needed = -(-width // sizes[0]) * -(-length // sizes[1]) * (samples if one(_PLANAR, 1) == 2 else 1)
    is_short = one(_COMPRESSION, 1) == 1 and not is_tiled and sum(map(int, counts)) < need
    if len(offsets) != len(counts) or len(offsets) < needed or is_short or not counts.all():
        raise InputError(f"does not contain all pixels of its page {page}. {AGAIN}")
    if (offsets.astype(np.float64) + counts > size).any():
        raise InputError(_SHORT)


def check_companions(path: Path, text: str | None) -> int | None:
    """Check the other files that OME-XML names; return the number of values in its first image."""
    if text is None:
        return None
    try:
        root = ElementTree.fromstring(text)
        pixels = next(element for element in root.iter() if _name(element) == "Pixels")
        values = math.prod(int(pixels.attrib[f"Size{axis}"]) for axis in "XYZCT")
    except (ElementTree.ParseError, StopIteration, KeyError, ValueError):
        raise InputError(f"has OME-XML that does not define its axes. {AGAIN}") from None
    named = {}
    for element in root.iter():
        if _name(element) == "UUID" and element.get("FileName", path.name).lower() != path.name.lower():
            named[str(element.get("FileName"))] = element.text
    for name, identity in named.items():
        if identity == root.get("UUID") and identity is not None:
            continue  # the file was renamed
        other = companion(path, name, "planes")
        check_pages(other)
        with require("tifffile").TiffFile(other) as file:
            uuid = None if file.ome_metadata is None else ElementTree.fromstring(file.ome_metadata).get("UUID")
        if uuid not in (None, identity):
            raise InputError(f"stores planes in {name!r:.80}, which belongs to another image. Copy the original file")
        record_file(other)
    return values


def _name(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def check_series(file: Any, values: int | None) -> None:
    """Raise an error if the first series of an open file has fewer planes than its metadata define."""
    series = file.series[0]
    total, needed = math.prod(series.shape), [] if values is None else [values]
    if file.is_shaped:
        needed = [math.prod((file.shaped_metadata or [{"shape": [0]}])[0]["shape"])]
    elif file.imagej_metadata:
        counts = [int(file.imagej_metadata.get(key, 1)) for key in ("frames", "slices", "channels")]
        planes = max(math.prod(counts), int(file.imagej_metadata.get("images", 1)))
        needed.append(planes * math.prod(series.keyframe.shape))
    planes = total // max(math.prod(series.keyframe.shape), 1)
    if needed and total not in needed:
        raise InputError(f"has {planes} planes, which are not those that its metadata define. {AGAIN}")
    held = [] if len(series.pages) == 0 else series._pages
    if series.dataoffset is not None:
        is_complete = series.dataoffset + total * series.dtype.itemsize <= file.filehandle.size
    else:
        is_complete = len(held) == planes and all(page is not None for page in held)
    if not is_complete:
        there = sum(page is not None for page in held)
        raise InputError(f"has {there} of {planes} planes that its metadata define. {AGAIN}")
