"""The directory of a store of distance rows: its description, its disk space, and its journal (one object per line)."""

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, amount, checked_path, log
from voxflat.distances.table import FINISH, Table
from voxflat.errors import InputError
from voxflat.io.descriptions import check_store
from voxflat.io.files import atomic_path, check_format, check_regular_within, from_json, naming, naming_file, save_array
from voxflat.io.provenance import Record, as_text
from voxflat.io.temporary import temporary_beside

FORMAT = "voxflat rows 2"
ARRAYS = ("points", "ids", "sources")
OTHER = "Choose another directory, or delete this one"


@dataclass(frozen=True)
class Store:
    """A directory that is ready to receive rows."""

    path: Path
    identity: str
    geodesic: str

    @property
    def key(self) -> tuple[Path, str]:
        """The arguments that the compiled core needs."""
        return (self.path, self.identity)

    def tell(self, counts: tuple[int, int]) -> None:
        """Log how many rows were already in the store, and how many were damaged."""
        rows, damaged = counts
        if rows:
            log.info("%d rows were already in the store %s", rows, self.path)
        if damaged:
            log.warning("recomputed %d rows of the store %s, which did not match their checksums", damaged, self.path)


def prepare_store(
    path: str | os.PathLike[str],
    core: _core.Surface | _core.VoxelSurface,
    ids: NDArray[np.int64],
    chosen: NDArray[np.uint32],
    *,
    geodesic: str,
    link_lengths: str | None = None,
    progress: Progress | None = None,
) -> Store:
    """Create a store, or open one with the same rows; `chosen`, shape (m,), contains the row numbers of the sources."""
    path = store_path(path)
    arrays = {"points": core.points, "ids": ids, "sources": chosen.astype(np.int64)}
    named = {} if isinstance(core, _core.VoxelSurface) else {"geodesic": geodesic}
    fingerprint = core.fingerprint(**named, progress=progress)
    identity: dict[str, Any] = {
        "format": FORMAT,
        "geodesic": geodesic,
        "link_lengths": link_lengths,
        "points": len(core),
        "sources": len(chosen),
        "fingerprint": f"{fingerprint:016x}",
        **{f"{name}_sha256": array_hash(array) for name, array in arrays.items()},
    }
    with naming_file(path):
        is_new = not _holds_files(path)
        if not is_new:
            _compare(path, identity)
        check_disk(path, 4 * len(chosen) * len(core))
        if is_new:
            _create(path, identity, arrays)
            _compare(path, identity)
        for name, array in arrays.items():
            _mend(path / f"{name}.npy", array, identity[f"{name}_sha256"])
    text = json.dumps(identity, sort_keys=True)
    return Store(path, hashlib.sha256(text.encode()).hexdigest(), geodesic)


def store_path(path: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a store, for messages and in case the working directory changes."""
    return Path(os.path.abspath(checked_path(path, "store")))


def read_description(path: Path) -> dict[str, Any]:
    """Return the description of a store."""
    file = path / "store.json"
    if not path.is_dir() or not file.exists():
        raise InputError(f"{path} is not a store of distance rows (store.json is missing). Pass another directory")
    check_regular_within(path)
    try:
        described = from_json(file.read_text(encoding="utf-8"))
        named = described["format"]
        keys = ["geodesic", "points", "sources", "fingerprint", *(f"{name}_sha256" for name in ARRAYS)]
        if named == FORMAT and not all(name in described for name in keys):
            raise ValueError("it is not complete")
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file} is damaged ({error}). {OTHER}") from error
    check_format(file, named, FORMAT, OTHER)
    with naming(file, OTHER):
        check_store(described, OTHER)
    return dict(described)


def write_provenance(path: str | os.PathLike[str], record: Record) -> None:
    """Write the provenance record of rows to their store."""
    with atomic_path(Path(path) / "provenance.json") as temporary:
        temporary.write_text(as_text(record, indent=2) + "\n", encoding="utf-8", newline="\n")


def read_provenance(path: Path) -> Record:
    """Return the provenance record of the rows in a store, which is empty if unknown. Nothing depends on it."""
    with suppress(OSError, ValueError):
        record = from_json((path / "provenance.json").read_text(encoding="utf-8"))
        return record if isinstance(record, dict) else {}
    return {}


def array_hash(array: NDArray[Any]) -> str:
    """Return a hash of the shape and values of an array, which is the same on every machine."""
    kind = array.dtype.newbyteorder("<")
    header = f"{kind.str} {array.shape} ".encode()
    return hashlib.sha256(header + np.ascontiguousarray(array, dtype=kind).tobytes()).hexdigest()


def _holds_files(path: Path) -> bool:
    if path.exists() and not path.is_dir():
        raise InputError(f"the store {path} is a file. Pass a directory")
    names = sorted(entry.name for entry in path.iterdir()) if path.exists() else []
    if names and "store.json" not in names:
        listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise InputError(f"{path} is not a store, but contains files ({listed}). Pass a new, empty directory")
    return bool(names)


def check_disk(path: Path, size: int) -> None:
    """Log the disk space that will be used, and raise an error if it is not available."""
    table = path / "rows.npy"
    need = max(0, size - (int(getattr(table.stat(), "st_blocks", 0)) * 512 if table.exists() else 0))
    free = shutil.disk_usage(path if path.exists() else path.parent).free
    if need > free:
        raise OSError(
            errno.ENOSPC,
            f"{amount(need)} of disk space is needed, but only {amount(free)} is free. Free some space, choose another "
            "directory, or use fewer sources or a smaller patch",
            str(path),
        )
    if need:
        log.info("up to %s of disk space will be used in %s", amount(need), path)


def _create(path: Path, identity: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Make a store in a temporary directory and rename it, so that it is either complete or absent."""
    beside = temporary_beside(path)
    try:
        beside.mkdir()
        for name, array in arrays.items():
            save_array(beside / f"{name}.npy", array)
            with (beside / f"{name}.npy").open("r+b") as file:
                _to_disk(file)
        with (beside / "store.json").open("x", encoding="utf-8", newline="\n") as text:
            text.write(json.dumps(identity, indent=2) + "\n")
            _to_disk(text)
        with suppress(FileNotFoundError):
            path.rmdir()  # it is empty
        beside.rename(path)
    except OSError:
        if not (path / "store.json").exists():  # otherwise another process was faster
            raise
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _to_disk(file: Any) -> None:
    file.flush()
    os.fsync(file.fileno())


def _compare(path: Path, identity: dict[str, Any]) -> None:
    """Raise an error that lists the differences if a store contains other rows."""
    there = read_description(path)
    if there == identity:
        return
    differ = [name for name in identity if there.get(name) != identity[name]]

    def counts(name: str) -> str:
        return f" ({there[name]} {name} instead of {identity[name]})" if name in differ else ""

    differences = [
        f"its {name} is {there.get(name)!r}, not {identity[name]!r}"
        for name in ("geodesic", "link_lengths")
        if name in differ
    ]
    if not differences and {"points", "points_sha256", "ids_sha256"} & set(differ):
        differences.append(f"its surface differs{counts('points')}")
    elif not differences and "fingerprint" in differ:
        differences.append("its surface has different triangles, or was processed by another version of voxflat")
    elif not differences and "sources_sha256" in differ:
        differences.append(f"its sources differ{counts('sources')}")
    reasons = " and ".join(differences) or "its store.json differs"
    raise InputError(f"the store {path} contains other distances: {reasons}. {OTHER}")


def _mend(path: Path, array: NDArray[Any], expected: str) -> None:
    """Rewrite a damaged array."""
    with suppress(InputError):
        if array_hash(np.asarray(Table.open(path))) == expected:
            return
    with atomic_path(path) as temporary:
        save_array(temporary, array)


# ------------------------------------------------------------------------------------------ the journal

_COMPLETE = '{"complete": true}'


@dataclass(frozen=True)
class Journal:
    """The contents of a journal."""

    header: str  # its first line
    rows: int  # number of sources
    columns: int  # number of points
    checksums: dict[int, int]  # CRC-32 of each row that is finished
    is_complete: bool  # whether all rows are recorded as finished


def read_journal(store: Path) -> Journal:
    """Read the journal of a store; lines that cannot be read are ignored, and their rows count as unfinished."""
    path = store / "journal.jsonl"
    try:
        first, *lines = path.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
        header = from_json(first)
        rows, columns = (header.get(name) for name in ("rows", "columns"))
        if not (isinstance(rows, int) and isinstance(columns, int)):
            raise ValueError("its first line is not a header")
    except FileNotFoundError:
        raise InputError(f"the store {store} has no rows yet. {FINISH}") from None
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({error}). {OTHER}") from error
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
    """Record rows whose data have been written."""
    _append(store, "".join(f'{{"row": {row}, "crc32": "{sum_:08x}"}}\n' for row, sum_ in checksums.items()))


def complete(store: Path) -> None:
    """Record that all rows are finished, after their data are on disk."""
    with (store / "rows.npy").open("r+b") as table:
        os.fsync(table.fileno())
    _append(store, _COMPLETE + "\n")


def _append(store: Path, text: str) -> None:
    with (store / "journal.jsonl").open("a", encoding="utf-8", newline="\n") as journal:
        journal.write(text)
        journal.flush()
        os.fsync(journal.fileno())
