"""The journal of a store of distance rows, as the compiled core writes it: a header, then a JSON object a line."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from voxflat.distances.store import OTHER
from voxflat.distances.table import FINISH
from voxflat.errors import InputError
from voxflat.io.files import from_json

_COMPLETE = '{"complete": true}'


@dataclass(frozen=True)
class Journal:
    """What a journal says."""

    header: str  # its first line
    rows: int  # sources
    columns: int  # points
    checksums: dict[int, int]  # CRC-32 of each row that is finished
    is_complete: bool  # whether it says that all are


def read_journal(store: Path) -> Journal:
    """Read the journal of a store; lines that cannot be read say nothing, and their rows are not finished."""
    path = store / "journal.jsonl"
    try:
        first, *lines = path.read_text(errors="replace").splitlines() or [""]
        header = from_json(first)
        rows, columns = (header.get(name) for name in ("rows", "columns"))
        if not (isinstance(rows, int) and isinstance(columns, int)):
            raise ValueError("its first line is no header")
    except FileNotFoundError:
        raise InputError(f"the store {store} has no rows yet; {FINISH}") from None
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({error}); {OTHER}") from error
    checksums: dict[int, int] = {}
    is_complete = False
    for line in lines:
        try:
            entry = from_json(line)
            is_complete |= entry.get("complete") is True
            if entry.get("row") in range(rows) and 0 <= (sum_ := int(entry["crc32"], 16)) < 1 << 32:
                checksums[int(entry["row"])] = sum_
        except (ValueError, AttributeError, KeyError, TypeError):
            continue
    return Journal(first, rows, columns, checksums, is_complete)


def append(store: Path, checksums: Mapping[int, int]) -> None:
    """Enter rows whose data are written."""
    _append(store, "".join(f'{{"row": {row}, "crc32": "{sum_:08x}"}}\n' for row, sum_ in checksums.items()))


def complete(store: Path) -> None:
    """Enter that all rows are finished, once their data are on the disk."""
    with (store / "rows.npy").open("r+b") as table:
        os.fsync(table.fileno())
    _append(store, _COMPLETE + "\n")


def _append(store: Path, text: str) -> None:
    with (store / "journal.jsonl").open("a") as journal:
        journal.write(text)
        journal.flush()
        os.fsync(journal.fileno())
