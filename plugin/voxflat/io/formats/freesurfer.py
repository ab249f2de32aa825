"""Read FreeSurfer surfaces, values and labels with nibabel, after comparing their counts with the file length."""

import io
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, printable
from voxflat.errors import InputError
from voxflat.io.files import AGAIN, check_size, contents, naming, require
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.io.triangles import Faces, Points, as_float32

_SCANNER_TAG = b"\0\0\0\x02\0\0\0\x01"  # useRealRAS: scanner RAS, not supported by nibabel
_REMEDY = "Check that the file is complete and in this format"
UNPLACED = "its coordinates are in FreeSurfer's tkRAS, but the file does not define the centre of the volume (c_ras)"


def read_geometry(path: Path, data: bytes) -> dict[str, Any]:
    """Read a surface file, and split its quadrangles as FreeSurfer does."""
    nibabel, is_quad = require("nibabel"), data[2] != 0xFE
    if is_quad:
        points, quads = (int.from_bytes(data[n : n + 3], "big") for n in (3, 6))
        need = 9 + (6 if data[2] == 0xFF else 12) * points + 12 * quads
        check_size(data, need, f"{points} points and {quads} quadrangles")
        warnings: tuple[str, ...] = (f"{quads} quadrangles were split into triangles",)
    else:
        start = data.index(b"\n", data.index(b"\n") + 1) + 1  # after the line with the creator, and an empty line
        points, triangles = (int(count) for count in np.frombuffer(data[start : start + 8].ljust(8, b"\xff"), ">i4"))
        need = start + 8 + 12 * points + 12 * triangles
        check_size(data, need if min(points, triangles) >= 0 else -1, f"{points} points and {triangles} faces")
        warnings = ()
    with catch_warnings():
        simplefilter("ignore")  # warnings about a missing volume geometry
        coordinates, faces, footer = nibabel.freesurfer.read_geometry(path, read_metadata=True)
    is_scanner = not is_quad and data[need : need + 8] == _SCANNER_TAG
    space = Space("scanner") if is_scanner else _space(footer)
    return {"points": coordinates, "faces": faces, "space": space, "warnings": warnings}


def _space(footer: dict[str, Any]) -> Space:
    """Return the coordinate space of a surface, tkRAS, as defined by the footer of its file."""
    if not str(footer.get("valid", "")).startswith("1"):
        return Space("tkRAS", None, UNPLACED)
    cosines = np.column_stack([footer[axis] for axis in ("xras", "yras", "zras")])
    try:
        volume = VolumeGeometry(cosines, footer["cras"], footer["volume"], footer["voxelsize"], footer["filename"])
    except InputError as error:
        return Space("tkRAS", None, f"its coordinates are in FreeSurfer's tkRAS, but {error}")
    return Space("tkRAS", volume)


def write_geometry(path: Path, points: Points, faces: Faces, volume: VolumeGeometry | None) -> None:
    """Write a surface file in tkRAS with its volume geometry; nibabel would not report a full disk."""
    counts = np.array([len(points), len(faces)], ">i4")
    parts = (counts, as_float32(points).astype(">f4"), faces.astype(">i4"))
    body = b"\xff\xff\xfecreated by voxflat\n\n" + b"".join(part.tobytes() for part in parts)
    path.write_bytes(body + (b"" if volume is None else _footer(volume)))


def _footer(volume: VolumeGeometry) -> bytes:
    """Return the footer of a surface file, which defines the position of its tkRAS."""
    # nibabel splits lines at "="
    named = "".join(letter if letter.isprintable() and letter != "=" else "_" for letter in volume.filename)
    lines = ["valid = 1  # volume info valid", f"filename = {named or 'unknown'}"]
    lines.append("volume = " + " ".join(map(str, volume.shape)))
    axes = {axis: volume.cosines[:, n] for n, axis in enumerate(("xras", "yras", "zras"))}
    for key, values in {"voxelsize": volume.voxel_size, **axes, "cras": volume.c_ras}.items():
        lines.append(f"{key:6} = " + " ".join(f"{value:.15e}" for value in values))
    return np.array([2, 0, 20], ">i4").tobytes() + "".join(f"{line}\n" for line in lines).encode()


def is_morph(data: bytes) -> bool:
    """Return whether a file that begins with ff ff ff contains values rather than a surface of quadrangles."""
    points, _, each = (int(count) for count in np.frombuffer(data[3:15].ljust(12, b"\xff"), ">i4"))
    return each > 0 and len(data) == 15 + 4 * points * each


def read_morph(path: Path, data: bytes) -> NDArray[Any]:
    """Return the values of a file such as lh.curv, lh.sulc or lh.thickness."""
    if data[:3] == b"\xff\xff\xff":
        points, _, each = (int(count) for count in np.frombuffer(data[3:15].ljust(12, b"\xff"), ">i4"))
        if each != 1:
            raise InputError(f"has {each} values per point. Pass a file with one value per point")
        check_size(data, 15 + 4 * points if points >= 0 else -1, f"{points} values", is_exact=True)
    elif len(data) < 6 or len(data) != 6 + 2 * int.from_bytes(data[:3], "big"):  # this format has no magic number
        raise InputError(f"is not in a known format for values, or is incomplete. {_REMEDY}")
    return np.asarray(require("nibabel").freesurfer.read_morph_data(path))


def read_mgh(data: bytes) -> NDArray[Any]:
    """Return the values of an MGH file, of shape (N,), or (N, F) for F frames."""
    version, *shape, kind = (int(number) for number in np.frombuffer(data[:24].ljust(24, b"\0"), ">i4"))
    if version != 1 or min(shape) < 1:
        raise InputError(f"is not an MGH file, or is damaged. {_REMEDY}")
    check_size(data, 284 + math.prod(shape) * {0: 1, 4: 2}.get(kind, 4), f"the shape {shape}")
    if sorted(shape[:3])[:2] != [1, 1]:
        raise InputError(f"has shape {shape}. Pass an array of shape (N, 1, 1) for N points")
    with np.errstate(all="ignore"):  # warnings about the position, which is not needed
        values = np.asarray(require("nibabel").MGHImage.from_bytes(data).dataobj).reshape(max(shape[:3]), -1)
    return values[:, 0] if values.shape[1] == 1 else values


def read_annot(path: Path, data: bytes) -> tuple[NDArray[np.int64], list[str]]:
    """Return the label of each point (−1 for no label) and the names of the labels."""
    points = int.from_bytes(data[:4], "big", signed=True)
    check_size(data, 4 + 8 * points if points >= 0 else -1, f"{points} points")
    pairs = np.frombuffer(data, ">i4", count=2 * points, offset=4).reshape(-1, 2)
    if not np.array_equal(pairs[:, 0], np.arange(points)):
        raise InputError("does not list the points in order. Write it again with FreeSurfer")
    table, names = annot_table(path, data)
    if len(names) != len(table):
        raise InputError(f"has {len(names)} names for {len(table)} colours. Write it again with FreeSurfer")
    labels = np.full(points, -1, dtype=np.int64)
    for index, colour in enumerate(table[:, 4]):  # nibabel would assign a neighbour to unknown colours
        labels[pairs[:, 1] == colour] = index
    return labels, names


def annot_table(path: Path, data: bytes) -> tuple[NDArray[Any], list[str]]:
    """Return an annotation's colours (red, green, blue, transparency, and the label formed from these) and names."""
    start = 8 + 8 * int.from_bytes(data[:4], "big", signed=True)
    entries, greatest = (int(n) for n in np.frombuffer(data[max(start, 0) :][:8].ljust(8, b"\0"), ">i4"))
    if not 0 <= (entries if entries > 0 else greatest) <= _MOST_COLOURS:  # nibabel would allocate this number
        raise InputError(f"its header is damaged: it specifies {max(entries, greatest)} colours. {_REMEDY}")
    if len(data) > start:
        _check_table(data, start)
    with np.errstate(all="ignore"):
        try:
            _, table, names = require("nibabel").freesurfer.read_annot(path, orig_ids=True)
        except MemoryError:
            raise InputError(f"contains a name that is longer than the available memory. {_REMEDY}") from None
    return table, [name.decode("utf-8", "replace") for name in names]


def _check_table(data: bytes, offset: int) -> None:
    """Raise an error if the file ends within its colour table, because nibabel repeats the numbers that are left."""

    def number(offset: int) -> int:
        return int.from_bytes(data[offset : offset + 4], "big", signed=True)

    rest, is_new = number(offset), number(offset) <= 0
    offset += 8 if is_new else 4
    offset += 4 + max(number(offset), 0)  # name of the table
    if is_new:
        rest, offset = number(offset), offset + 4
    while rest > 0 and offset <= len(data):
        offset += 4 if is_new else 0  # number of the label
        offset += 20 + max(number(offset), 0)  # name and colour
        rest -= 1
    check_size(data, offset, "more colours or longer names")


_MOST_COLOURS = 1 << 20  # FreeSurfer's own tables have up to 14,175


def read_label(data: bytes, n: int) -> NDArray[np.bool_]:
    """Return which of the n points are listed in a label file."""
    vertices = _label_columns(data, 1)[:, 0]
    bad = np.flatnonzero(~((vertices >= 0) & (vertices < n) & (vertices == np.floor(vertices))))
    if len(bad):
        raise InputError(f"line {bad[0] + 3} names point {vertices[bad[0]]:g}, but the surface has points 0 to {n - 1}")
    mask = np.zeros(n, dtype=bool)
    mask[vertices.astype(np.int64)] = True
    return mask


def read_label_points(path: str | os.PathLike[str]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read the vertices of a label and their positions in tkRAS, in mm; some programs write 0 for all positions."""
    path = checked_path(path)
    with naming(path, _REMEDY):
        data = contents(path)
        vertices = _label_columns(data, 1)[:, 0].astype(np.int64)
        try:
            return vertices, _label_columns(data, 4)[:, 1:]
        except ValueError:  # the file has only vertex numbers
            return vertices, np.zeros((len(vertices), 3))


def write_annot(
    path: Path, labels: NDArray[np.int64], keys: Sequence[int], names: Sequence[str], colours: NDArray[np.uint8]
) -> None:
    """Write the labels of all points (0 for no label), with names and with the colours that identify the labels."""
    table = np.zeros((len(keys) + 1, 5), dtype=np.int64)
    rows, taken = [(25, 5, 25), *map(tuple, colours.tolist())], set()
    for n, (red, green, blue) in enumerate(rows):
        code = red | green << 8 | blue << 16
        while code in taken or code == 0:  # next unused code
            code = (code + 1) % (1 << 24)
        taken.add(code)
        table[n, :3] = code & 255, code >> 8 & 255, code >> 16
    index = np.searchsorted(np.array([0, *sorted(keys)]), labels)
    order = [0, *(1 + n for n in np.argsort(keys))]
    named = [printable(["unknown", *names][n]) for n in order]
    values, colour_table = index.astype(np.int32), table[order].astype(np.int32)
    require("nibabel").freesurfer.write_annot(path, values, colour_table, named, fill_ctab=True)


def write_label(path: Path, vertices: NDArray[np.int64], points: Points, name: str) -> None:
    """Write a label: point numbers and their positions in tkRAS."""
    rows = [f"{v}  {x:.3f}  {y:.3f}  {z:.3f} 0.0000000000\n" for v, (x, y, z) in zip(vertices, points, strict=True)]
    text = f"#!ascii label {printable(name)}, from voxflat vox2ras=TkReg\n{len(vertices)}\n" + "".join(rows)
    path.write_text(text, encoding="utf-8", newline="\n")


def _label_columns(data: bytes, count: int) -> NDArray[np.float64]:
    """Return the first columns of a label file: point number, x, y and z."""
    lines = data.decode("utf-8", "replace").splitlines()
    if len(lines) < 2 or not lines[1].strip().isdigit():
        raise InputError("is not a label file: its second line is not the number of points. Check the file")
    named, rows = int(lines[1]), [line for line in lines[2:] if line.strip()]
    if named != len(rows):
        raise InputError(f"lists {len(rows)} points, but its header specifies {named}. {AGAIN}")
    return np.loadtxt(io.StringIO("\n".join(rows)), usecols=range(count), ndmin=2) if rows else np.zeros((0, count))
