"""Shorten files, and compare what is read from them: nothing may be missing without an error or a warning."""

import gzip
import hashlib
import io
import re
import shutil
import zipfile
from dataclasses import fields, is_dataclass

import numpy as np

ENDLESS = {
    "s.obj": "OBJ does not count its lines",
    "quads.obj": "OBJ does not count its lines",
    "points.csv": "a table does not count its rows",
    "points.tsv": "a table does not count its rows",
    "lut.txt": "a table does not count its rows",
    "lut.tsv": "a table does not count its rows",
}
"""Files that may end after any line, with the reason; a name may be the end of a longer one."""


OPTIONAL = {("v.npz", "affine.npy")}
"""Members of archives that a complete file need not have."""


def shortened(entry, to, chance):
    """Copy an entry to an emptied folder without one of its files, or the end of one; return the path, and how.

    The second value is "" if no reader can detect that the end is missing.
    """
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(entry.folder, to)
    path = to / entry.main
    file = to / chance.choice(entry.files).relative_to(entry.folder)
    if file != path and chance.random() < 0.4:
        file.unlink()
        return path, f"without {file.name}"
    data = file.read_bytes()
    if data[:2] == b"\x1f\x8b" and chance.random() < 0.5:
        inner = gzip.decompress(data)
        short = inner[: _end(inner, chance)]
        file.write_bytes(gzip.compress(short, 1, mtime=0))
        return path, _how(file, short, inner)
    if data[:2] == b"PK" and chance.random() < 0.7:
        return path, _in_archive(file, data, chance)
    short = data[: _end(data, chance)]
    file.write_bytes(short)
    return path, _how(file, short, data)


def _end(data, chance):
    """Draw a length less than that of the data: a few bytes less, a line or a block, or anything."""
    lines = [found.end() for found in re.finditer(rb"\n", data[:-1])]
    ways = [len(data) - chance.choice((1, 1, 2, 3, 4, 8, 12, 16, 64)), chance.randrange(max(1, len(data)))]
    ways += [chance.choice(lines)] * 2 if lines else [len(data) // 8 * chance.randrange(8)]
    return max(0, chance.choice(ways))


def _how(file, short, data):
    is_text = not re.search(rb"[^\t-\r -\x7e]", data)
    if is_text and (file.name in ENDLESS or len(short.split()) == len(data.split())):
        return ""  # the last word of a text may be a shorter word
    return f"{file.name} {len(short)} of {len(data)} bytes"


def _in_archive(file, data, chance):
    """Remove a member of an archive, or the end of one."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(sorted(members))
    if chance.random() < 0.3:
        del members[name]
    else:
        members[name] = members[name][: _end(members[name], chance)]
    with zipfile.ZipFile(file, "w") as archive:
        for member, content in members.items():
            archive.writestr(zipfile.ZipInfo(member), content)
    return "" if (file.name, name) in OPTIONAL and name not in members else f"{file.name}: {name}"


def digest(found):
    """Return a checksum of arrays, numbers and texts, nested in lists, dictionaries and data classes."""
    total = hashlib.sha256()

    def add(one):
        if isinstance(one, np.ndarray) and one.dtype != object:
            total.update(f"{one.dtype.str} {one.shape}".encode())
            total.update(np.ascontiguousarray(one).tobytes())
        elif isinstance(one, dict):
            add(sorted(one.items(), key=repr))
        elif isinstance(one, list | tuple | np.ndarray):
            total.update(f"{len(one)} of".encode())
            for each in one:
                add(each)
        elif is_dataclass(one):
            add([(field.name, getattr(one, field.name)) for field in fields(one)])
        else:
            total.update(repr(one).encode("utf-8", "replace"))

    add(found)
    return total.hexdigest()
