"""Read CSV and TSV tables of points, such as electrodes or peaks, and write them with additional columns."""

import csv
import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, printable
from voxflat.errors import InputError
from voxflat.io.files import atomic_path, contents, naming

TABLE_ENDINGS = (".csv", ".tsv", ".txt")  # endings of point files: comma-, tab- or space-separated

_MISSING = ("", "n/a", "na", "nan")


@dataclass(frozen=True, eq=False)
class PointTable:
    """Store the points of a table and its other columns."""

    points: NDArray[np.float64]  # (P, 3), in mm; NaN for missing coordinates
    header: list[str]  # empty if the file has none
    rows: list[list[str]]  # all cells, as read

    def save(self, path: str | os.PathLike[str], more: dict[str, NDArray[np.float64]]) -> None:
        """Write the table with additional columns, completely or not at all; missing numbers are written as ``n/a``."""
        columns = [[cell_of(value) for value in values.tolist()] for values in more.values()]
        header = self.header or [*"xyz", *(f"column{n}" for n in range(4, len(self.rows[0]) + 1))]
        rows = ([*row, *(column[n] for column in columns)] for n, row in enumerate(self.rows))
        write_table(path, [[*header, *more], *rows])


def cell_of(value: float, form: str = ".6f") -> str:
    """Return a number as text, or ``n/a`` if it is missing."""
    return "n/a" if np.isnan(value) else format(value, form)


def write_table(path: str | os.PathLike[str], rows: Iterable[Sequence[str]]) -> None:
    """Write rows of cells, separated by commas (.csv), tabs (.tsv) or spaces, completely or not at all."""
    path = checked_path(path)
    text = io.StringIO()
    delimiter = {".csv": ",", ".tsv": "\t"}.get(path.suffix.lower(), " ")
    cells = ([printable(cell) for cell in row] for row in rows)
    csv.writer(text, delimiter=delimiter, lineterminator="\n").writerows(cells)
    with atomic_path(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8", newline="\n")


def aligned(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """Return rows as text in columns, which are right-aligned except for those numbered in `left`."""
    rows = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    line = "  ".join(f"{{:{'<' if column in left else '>'}{width}}}" for column, width in enumerate(widths))
    return "\n".join(line.format(*row).rstrip() for row in rows)


def read_points(path: str | os.PathLike[str]) -> PointTable:
    """Read points from a table: from the columns x, y and z if it has a header, otherwise from the first three."""
    path = checked_path(path)
    with naming(path, "provide columns x, y and z in mm"):
        ending = path.suffix.lower()
        if ending not in TABLE_ENDINGS:
            raise InputError(f"unknown file name ending {path.suffix!r}. Use one of {', '.join(TABLE_ENDINGS)}")
        lines = io.StringIO(contents(path).decode("utf-8-sig"), newline="")
        if ending == ".txt":
            rows = [line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")]
        else:
            table = csv.reader(lines, delimiter="\t" if ending == ".tsv" else ",")
            rows = [[cell.strip() for cell in row] for row in table if any(cell.strip() for cell in row)]
        if not rows:
            raise InputError("is empty. Write one point per row")
        header: list[str] = []
        if not any(_is_number(cell) and cell for cell in rows[0]):
            header, rows = rows[0], rows[1:]
        names = [name.lower() for name in header]
        columns = [names.index(axis) for axis in "xyz"] if {"x", "y", "z"} <= set(names) else [0, 1, 2]
        points = np.full((len(rows), 3), np.nan)
        for n, row in enumerate(rows):
            if len(row) != len(rows[0]) or len(row) <= max(columns) or (header and len(row) != len(header)):
                raise InputError(f"row {n + 1} has {len(row)} cells, but other rows have {len(header or rows[0])}")
            for axis, column in enumerate(columns):
                if not _is_number(row[column]):
                    raise InputError(f"row {n + 1}: {row[column]!r} is not a number. Write a coordinate in mm, or n/a")
                points[n, axis] = np.nan if row[column].lower() in _MISSING else float(row[column])
        if not rows:
            raise InputError("has a header, but no points. Write one point per row")
        return PointTable(points, header, rows)


def _is_number(cell: str) -> bool:
    try:
        return cell.lower() in _MISSING or bool(np.isfinite(float(cell)))
    except ValueError:
        return False
