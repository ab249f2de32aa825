"""The journal of a store of distance rows, as the compiled core writes it: a header, then a JSON object a line."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from voxflat.distances.store import FINISH, OTHER
from voxflat.errors import InputError
from voxflat.io.files import from_json

__all__ = ["Journal", "append", "complete", "read_journal"]

_COMPLETE = '{"complete": true}'


@dataclass(frozen=True)
class Journal:
    """What a journal says.

    Parameters
    ----------
    header : str
        Its first line.
    rows, columns : int
        Numbers of sources and of points.
    block_rows : int
        How many rows a block has; the last one may have fewer.
    checksums : dict of int to int
        CRC-32 of each block that is finished.
    is_complete : bool
        Whether it says that all are.
    """

    header: str
    rows: int
    columns: int
    block_rows: int
    checksums: dict[int, int]
    is_complete: bool

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-self.rows // self.block_rows)

    def rows_of(self, block: int) -> range:
        """Return the rows of a block."""
        return range(block * self.block_rows, min((block + 1) * self.block_rows, self.rows))


def read_journal(store: Path) -> Journal:
    """Read the journal of a store; lines that cannot be read say nothing, and their blocks are not finished.

    Parameters
    ----------
    store : Path
        The directory.

    Returns
    -------
    Journal

    Raises
    ------
    InputError
        If there is none, or its header cannot be read.
    """
    path = store / "journal.jsonl"
    try:
        first, *lines = path.read_text(errors="replace").splitlines() or [""]
        header = from_json(first)
        rows, columns, height = (header.get(name) for name in ("rows", "columns", "block_rows"))
        if not (isinstance(height, int) and height > 0):
            raise ValueError("its first line is no header")
    except FileNotFoundError:
        raise InputError(f"the store {store} has no rows yet; {FINISH}") from None
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({error}); {OTHER}") from error
    if not (isinstance(rows, int) and isinstance(columns, int)):
        rows = columns = 0
    checksums: dict[int, int] = {}
    is_complete = False
    for line in lines:
        try:
            entry = from_json(line)
            is_complete |= entry.get("complete") is True
            if "block" in entry:
                checksums[entry["block"]] = int(entry["crc32"], 16)
        except (ValueError, AttributeError, KeyError, TypeError):
            continue
    return Journal(first, rows, columns, height, checksums, is_complete)


def append(store: Path, checksums: Mapping[int, int]) -> None:
    """Enter blocks whose data are written."""
    _append(store, "".join(f'{{"block": {block}, "crc32": "{sum_:08x}"}}\n' for block, sum_ in checksums.items()))


def complete(store: Path) -> None:
    """Enter that all blocks are finished, once their data are on the disk."""
    with (store / "rows.npy").open("r+b") as table:
        os.fsync(table.fileno())
    _append(store, _COMPLETE + "\n")


def _append(store: Path, text: str) -> None:
    with (store / "journal.jsonl").open("a") as journal:
        journal.write(text)
        journal.flush()
        os.fsync(journal.fileno())
