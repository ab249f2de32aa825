"""Read the names and colours of labels from label files and from separate lookup tables."""

import csv
import io
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, log
from voxflat.errors import InputError
from voxflat.io import formats
from voxflat.io.channels import is_cifti, opened
from voxflat.io.files import REMEDY, contents, naming
from voxflat.io.formats import gifti
from voxflat.io.formats.border import Border, read_borders
from voxflat.io.formats.freesurfer import annot_table, read_label
from voxflat.io.objects import is_gifti

_LABEL = 1002  # NIFTI_INTENT_LABEL; Workbench also writes an empty table, with the label "???", for other values
LABEL_ENDINGS = (".annot", ".label.gii", ".dlabel.nii", ".label", ".border")
"""Endings of files that contain regions of a mesh with their names."""

LABEL_FILES = ".annot, .label.gii, .dlabel.nii, or one or several .label or .border files"
"""The same in words, for the help of options."""

_LISTS = (".label", ".border")  # of regions, each with its vertices or its outline
_NO_NAMES = {"", "???", "unknown", "none", "background", "clear label"}


@dataclass(frozen=True, eq=False)
class LabelTable:
    """Store the names of labels and their colours (red, green, blue from 0 to 255), both optional."""

    names: dict[int, str] = field(default_factory=dict)
    colours: dict[int, tuple[int, int, int]] = field(default_factory=dict)

    def is_region(self, label: int) -> bool:
        """Return whether a label is a region: neither negative, nor named "unknown", nor 0 without a name."""
        return label >= 0 and self.names.get(label, str(label) if label else "").strip().lower() not in _NO_NAMES


def read_table(path: str | os.PathLike[str]) -> LabelTable:
    """Read a lookup table, such as FreeSurferColorLUT.txt or a BIDS ``dseg.tsv`` (``index``, ``name``, ``color``)."""
    path = checked_path(path)
    with naming(path, "pass a table such as FreeSurferColorLUT.txt, or a BIDS dseg.tsv file"):
        text = contents(path).decode("utf-8-sig")
        table = _of_columns(text) if path.name.lower().endswith(".tsv") else _of_lines(text)
        if not table.names:
            raise InputError("contains no labels. Pass a table with one label per line")
        return table


def is_label_file(labels: object) -> bool:
    """Return whether the input is one file, or several, with regions of a mesh and their names."""
    is_one = isinstance(labels, str | os.PathLike) and os.fspath(labels).lower().endswith(LABEL_ENDINGS)
    return is_one or are_region_files(labels)


def are_region_files(labels: object) -> bool:
    """Return whether the input is one or several FreeSurfer ``.label`` or Workbench ``.border`` files."""
    several = labels if isinstance(labels, list | tuple) else [labels]
    names = [os.fspath(file) for file in several if isinstance(file, str | os.PathLike)]
    return 0 < len(names) == len(several) and all(str(name).lower().endswith(_LISTS) for name in names)


def region_files(
    files: Sequence[str | os.PathLike[str]], points: int, inside: Callable[[Border], NDArray[np.bool_]]
) -> tuple[NDArray[np.int64], LabelTable]:
    """Read FreeSurfer ``.label`` and Workbench ``.border`` files as labels from 1, with their names and colours.

    `inside` returns the vertices that a border encloses. Regions with common points are refused, because a point has
    one label.
    """
    labels = np.zeros(points, dtype=np.int64)
    rows: list[tuple[int, str, tuple[int, int, int] | None]] = []
    for file in files:
        path = checked_path(file)
        with naming(path, REMEDY):
            for name, colour, region in _regions_in(path, points, inside):
                common = np.unique(labels[region & (labels != 0)])
                if len(common):
                    other = rows[common[0] - 1][1]
                    raise InputError(f"its region {name} shares points with {other}. Draw them in separate figures")
                rows.append((len(rows) + 1, name, colour))
                labels[region] = len(rows)
    return labels, _table(rows)


def _regions_in(
    path: Path, points: int, inside: Callable[[Border], NDArray[np.bool_]]
) -> Iterator[tuple[str, tuple[int, int, int] | None, NDArray[np.bool_]]]:
    """Yield the name, the colour and the vertices of each region in a file."""
    if path.name.lower().endswith(".label"):
        yield _label_name(path.name), None, read_label(contents(path), points)
        return
    borders = read_borders(contents(path), points)
    closed = [border for border in borders if any(line.is_closed for line in border.lines)]
    if not closed:
        raise InputError("has only open borders, which enclose no region. Close them in Workbench")
    if len(closed) < len(borders):
        names = ", ".join(border.name for border in borders if border not in closed)
        log.warning("%s: open borders enclose no region and are omitted: %s", path, shorten(names, 200))
    for border in closed:
        yield border.name, border.colour, inside(border)


def _label_name(name: str) -> str:
    """Return the name of a label file without its ending and hemisphere."""
    return re.sub(r"^[lr]h\.|\.label$", "", name, flags=re.IGNORECASE)


def own_table(labels: object, channel: int = 0) -> LabelTable | None:
    """Read the names and colours in a label file or a nibabel image; for CIFTI, read those of one channel."""
    if not isinstance(labels, str | os.PathLike):
        return _of_image(labels, channel)
    path = checked_path(labels)
    name = path.name.lower()
    with naming(path, REMEDY):
        if name.endswith(".annot"):
            table, names = annot_table(path, contents(path))
            return _table((n, name, row[:3]) for n, (name, row) in enumerate(zip(names, table, strict=False)))
        if formats.by_name(path) == formats.GIFTI:
            return _of_image(gifti.load(contents(path)), channel)
        return _of_image(opened(path)[0], channel) if name.endswith(".nii") else None


def _of_image(image: Any, channel: int) -> LabelTable | None:
    if is_gifti(image):
        table = _table((e.key, e.label, _bytes([e.red, e.green, e.blue])) for e in image.labeltable.labels)
        is_label = any(part.intent == _LABEL for part in image.darrays)
        return table if table.names and (is_label or any(map(table.is_region, table.names))) else None
    if not is_cifti(image) or not hasattr(axis := image.header.get_axis(0), "label"):
        return None
    labels = axis.label[min(channel, len(axis) - 1)]
    return _table((key, name, _bytes(rgba[:3])) for key, (name, rgba) in labels.items())


def _table(rows: Iterable[tuple[Any, Any, Any]]) -> LabelTable:
    names, colours = {}, {}
    for label, name, colour in rows:
        names[int(label)] = str(name)
        if colour is not None:
            red, green, blue = (int(part) for part in colour)
            if min(red, green, blue) < 0 or max(red, green, blue) > 255:
                raise InputError(f"label {label} has the colour {red}, {green}, {blue}. Use values from 0 to 255")
            colours[int(label)] = (red, green, blue)
    return LabelTable(names, colours)


def _bytes(parts: Any) -> list[int]:
    """Return colour values from 0 to 1 as bytes."""
    return [round(255 * float(np.nan_to_num(part if part is not None else 0))) for part in parts]


def _of_lines(text: str) -> LabelTable:
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        match = re.fullmatch(r"\s*(\d+)\s+(\S.*?)\s+(\d+)\s+(\d+)\s+(\d+)(?:\s+\d+)?\s*", line)
        if match is None:
            raise InputError(f"line {number} is {line.strip()[:60]!r}. Write: label, name, red, green, blue")
        rows.append((int(match[1]), match[2], [match[3], match[4], match[5]]))
    return _table(rows)


def _of_columns(text: str) -> LabelTable:
    rows = []
    reader = csv.DictReader(io.StringIO(text), delimiter="\t")
    if not {"index", "name"} <= set(reader.fieldnames or ()):
        raise InputError("does not have the columns index and name. Add both columns")
    for row in reader:
        colour = (row.get("color") or "").strip().lstrip("#")
        is_known = re.fullmatch(r"[0-9a-fA-F]{6}", colour) is not None
        rows.append((int(row["index"]), row["name"], list(bytes.fromhex(colour)) if is_known else None))
    return _table(rows)
