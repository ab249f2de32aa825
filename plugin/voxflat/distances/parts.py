"""One store by many workers: each computes some of its blocks in a store of its own, a part, from which they are moved.

A part has all sources, its own blocks' first, so that it goes the same way to the same bits as the whole would; it is
stopped when these are finished. It lies in the store's directory, and is what a dead worker, or caller, leaves behind.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, check_memory, log
from voxflat.cluster import Cluster, Work, connected
from voxflat.distances.journal import Journal, append, complete, read_journal
from voxflat.distances.rows import DistanceRows, checksum, open_rows
from voxflat.distances.store import Store, array_hash, check_disk, mapped, prepare_store, store_path
from voxflat.errors import Cancelled, InputError
from voxflat.io.files import atomic_path, naming_file, save_array
from voxflat.surfaces.surface import Surface

try:
    import fcntl
except ImportError:  # not on every system: there two callers at once compute blocks twice
    fcntl = None  # type: ignore[assignment]

__all__ = ["rows_by_workers"]

_COMPUTING = ("preparing distances", "measuring distances")  # stages of the core, once it knows what is missing
_UNKNOWN = 16  # parts where no worker is there yet
_PATIENCE = 5.0  # s, within which a core that was stopped lets its lock go
_LOOK = 1.0  # s between two looks at how far workers are

_kept: dict[str, _core.Surface] = {}  # in a worker: the surface that it works on, whose neighbours are joined


@dataclass(frozen=True)
class Wanted:
    """Rows that are to be computed.

    Parameters
    ----------
    surface : str
        A hash of the surface.
    sources : int or ndarray of uint32
        How many to choose, or which, as numbers into the points.
    sampling : str
        How they are chosen.
    seed : int
        Of the choice.
    geodesic : str
        As in `voxflat.geodesic`, over triangles.
    """

    surface: str
    sources: int | NDArray[np.uint32]
    sampling: str
    seed: int
    geodesic: str


def rows_by_workers(
    part: Surface,
    sources: int | NDArray[np.uint32],
    store: str | os.PathLike[str],
    dask: str,
    *,
    geodesic: str,
    sampling: str,
    seed: int,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> DistanceRows:
    """Compute the blocks that a store lacks, on the workers of a cluster, and open it.

    Neighbours are joined by workers alone: what takes memory and time is theirs.

    Parameters
    ----------
    part : Surface
        What distances are measured over.
    sources : int or ndarray of uint32
        How many to choose, or which, as numbers into the points.
    store : path
        The directory.
    dask : str
        The cluster, as in `connected`.
    geodesic, sampling, seed
        As in `voxflat.geodesic`.
    threads : int, optional
        Of each worker.
    memory_limit : int, optional
        Bytes that rows in the making may take in each worker.
    progress : callable, optional
        As in `voxflat.flatten`.

    Returns
    -------
    DistanceRows

    Raises
    ------
    InputError, OSError
        If a part cannot be computed. What is finished, of this and others, is kept.
    Cancelled
        If `progress` returned False. Workers stop.
    """
    path = store_path(store)
    beside = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")  # until there is a store
    wanted = Wanted(_write_surface(part, beside), sources, sampling, seed, geodesic)
    how: dict[str, Any] = {"threads": threads, "progress": progress}
    count = sources if isinstance(sources, int) else len(sources)
    try:
        with connected(dask, most=count) as cluster:
            try:
                ((_, prepared, error),) = cluster.each(
                    partial(_begin, wanted), [(beside, path)], stage="choosing sources", **how
                )
                if error is not None:
                    raise error
                _finish(cluster, prepared, beside, partial(_part, wanted, prepared.identity, memory_limit), how)
            finally:
                with suppress(Exception):  # they may be gone
                    cluster.everywhere(_forget)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    rows = open_rows(path)
    rows.verify()
    return rows


# ------------------------------------------------------------------------------------------ the caller


def _write_surface(part: Surface, folder: Path) -> str:
    """Write what workers need to know of a surface; return its hash."""
    core = part.core
    arrays: dict[str, NDArray[Any]] = {"points": core.points, "faces": core.faces, "ids": part.ids}
    with naming_file(folder):
        folder.mkdir()
        for name, array in arrays.items():
            save_array(folder / f"{name}.npy", array)
    return " ".join(array_hash(array) for array in arrays.values())


def _finish(cluster: Cluster, store: Store, surface: Path, work: Work, how: dict[str, Any]) -> None:
    """Have computed what a store lacks."""
    path = store.path
    with _locked(path):
        _collect(path)
        journal = read_journal(path)
        missing = [block for block in range(journal.blocks) if block not in journal.checksums]
        if missing:
            check_disk(
                path, 2 * 4 * journal.rows * journal.columns
            )  # blocks are in a part before they are in the store
            (path / "parts").mkdir()
            surface.rename(path / "parts" / "surface")
            _compute(cluster, path, _deal(path, missing, len(cluster) or _UNKNOWN), work, how)
        if not journal.is_complete:
            complete(path)
        shutil.rmtree(path / "parts", ignore_errors=True)


@contextmanager
def _locked(store: Path) -> Iterator[None]:
    """Hold the lock of a store, as the core does while it computes."""
    with naming_file(store), (store / "lock").open("r+") as lock:
        if fcntl is not None:
            deadline = time.monotonic() + _PATIENCE
            while True:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > deadline:
                        text = f"the store is in use by process {lock.read().strip()}; wait until that has ended"
                        raise OSError(errno.EAGAIN, text, str(store)) from None
                time.sleep(0.01)
            lock.truncate(0)
            lock.write(f"{os.getpid()}\n")
            lock.flush()
        yield


def _collect(store: Path) -> None:
    """Take over what parts of an earlier call have finished."""
    whole = read_journal(store)
    rows = sum(len(whole.rows_of(block)) for block in whole.checksums)
    for part in sorted((store / "parts").glob("*/blocks.json")):
        with suppress(InputError, ValueError):  # it had not begun, or is of other blocks
            if read_journal(part.parent).header == whole.header:
                found = _moved(part.parent, store)
                append(store, found)
                rows += sum(len(whole.rows_of(block)) for block in found)
    shutil.rmtree(store / "parts", ignore_errors=True)
    if rows:
        log.info("%d rows were in the store %s already", rows, store)


def _deal(store: Path, missing: Sequence[int], workers: int) -> list[Path]:
    """Make parts of what is missing, one for each worker: each has to join neighbours, and to prepare distances."""
    places = []
    for blocks in np.array_split(np.array(missing), min(workers, len(missing))):
        place = store / "parts" / str(blocks[0])
        place.mkdir()
        with atomic_path(place / "blocks.json") as temporary:
            temporary.write_text(json.dumps(blocks.tolist()))
        places.append(place)
    return places


def _compute(cluster: Cluster, store: Path, places: list[Path], work: Work, how: dict[str, Any]) -> None:
    """Have parts computed, and enter what is finished."""
    errors = []
    if how["progress"] is not None:
        how = {**how, "progress": _Rows(store, how["progress"])}
    for place, found, error in cluster.each(work, places, stage="measuring distances", **how):
        if error is None:
            append(store, found)
            shutil.rmtree(place, ignore_errors=True)
        else:
            errors.append(error)
    if errors:
        raise errors[0]


class _Rows:
    """Progress in rows, as journals tell them."""

    def __init__(self, store: Path, progress: Progress) -> None:
        self._store, self._progress = store, progress
        self._looked, self._rows, self._all = -_LOOK, 0, 0

    def __call__(self, stage: str, done: int, total: int) -> bool | None:
        if time.monotonic() > self._looked + _LOOK:
            self._looked = time.monotonic()
            whole = read_journal(self._store)
            finished = len(whole.checksums)
            for part in (self._store / "parts").glob("*/journal.jsonl"):
                with suppress(InputError):
                    finished += len(read_journal(part.parent).checksums)
            self._rows, self._all = min(finished * whole.block_rows, whole.rows), whole.rows
        return self._progress(stage, self._rows, self._all)


# ------------------------------------------------------------------------------------------- a worker


def _begin(wanted: Wanted, places: tuple[Path, Path], *, threads: int, progress: Progress) -> Store:
    """Choose sources, and make a store of them, or find that an old one is of the same rows."""
    folder, path = places
    core = _surface(wanted.surface, folder)
    if isinstance(wanted.sources, int):
        chosen = core.choose_sources(wanted.sampling, wanted.sources, wanted.seed, progress)
    else:
        chosen = wanted.sources
    ids = np.array(mapped(folder / "ids.npy"))
    store = prepare_store(path, core, ids, chosen, geodesic=wanted.geodesic, progress=progress)
    is_laid_out = False

    def watch(stage: str, done: int, total: int) -> bool | None:
        nonlocal is_laid_out
        is_laid_out |= stage in _COMPUTING
        return False if is_laid_out else progress(stage, done, total)

    try:  # the core makes table and journal, or compares those that are there with their checksums
        core.store_rows(*store.key, chosen, geodesic=wanted.geodesic, threads=threads, progress=watch)
    except Cancelled:
        if not is_laid_out:
            raise
    return store


def _part(
    wanted: Wanted, identity: str, memory_limit: int | None, part: Path, *, threads: int, progress: Progress
) -> dict[int, int]:
    """Compute the blocks of a part and move them to the store; return their checksums."""
    store = part.parents[1]
    core = _surface(wanted.surface, store / "parts" / "surface")
    whole, blocks = read_journal(store), _blocks(part)
    need = _core.store_memory_need(whole.columns, whole.rows, threads)
    check_memory(need, memory_limit, "take fewer threads")
    own = np.concatenate([np.array(whole.rows_of(block)) for block in blocks])
    order = np.concatenate([own, np.setdiff1d(np.arange(whole.rows), own)])
    chosen = mapped(store / "sources.npy")[order].astype(np.uint32)
    watch = _Watch(part, len(blocks), progress)
    try:
        core.store_rows(part, identity, chosen, geodesic=wanted.geodesic, threads=threads, progress=watch)
    except Cancelled:
        if not watch.is_finished:
            raise
    found = _moved(part, store)
    if len(found) < len(blocks):
        raise InputError(f"rows in {part} do not agree with their checksums: is the disk sound?")
    return found


class _Watch:
    """Stops the core when the first blocks of a part, its own, are finished."""

    def __init__(self, part: Path, blocks: int, progress: Progress) -> None:
        self._part, self._blocks, self._progress = part, blocks, progress
        self._needed: int | None = None
        self.is_finished = False

    def __call__(self, stage: str, done: int, total: int) -> bool | None:
        if stage in _COMPUTING:
            rows = done if stage == _COMPUTING[1] else 0
            if self._needed is None:
                known = self._known()
                height = read_journal(self._part).block_rows
                self._needed = (self._blocks - known) * height - height  # the last one may be lower
            if rows >= self._needed and self._known() == self._blocks:
                self.is_finished = True
                return False
        return self._progress(stage, done, total)

    def _known(self) -> int:
        return sum(block < self._blocks for block in read_journal(self._part).checksums)


def _surface(key: str, folder: Path) -> _core.Surface:
    """Return the surface of a folder; a worker keeps it as long as it works on it, with what distances need."""
    if key not in _kept:
        _kept.clear()
        points, faces = np.array(mapped(folder / "points.npy")), np.array(mapped(folder / "faces.npy"))
        core, _ = _core.Surface.from_triangles(points, faces.astype(np.int64))
        if not (np.array_equal(core.points, points) and np.array_equal(core.faces, faces)):
            raise InputError("the surface is not the same in another process; leave dask out")
        _kept[key] = core
    return _kept[key]


def _forget() -> None:
    _kept.clear()


# ---------------------------------------------------------------------------------------------- both


def _blocks(part: Path) -> list[int]:
    return [int(block) for block in json.loads((part / "blocks.json").read_text())]


def _moved(part: Path, store: Path) -> dict[int, int]:
    """Copy the finished blocks of a part to their places in the store; return their checksums."""
    whole, own = read_journal(store), read_journal(part)
    rows, found = mapped(part / "rows.npy"), {}
    table = store / "rows.npy"
    with naming_file(table), table.open("r+b") as file:
        for place, block in enumerate(_blocks(part)):
            there = rows[own.rows_of(place).start : own.rows_of(place).stop]
            if place not in own.checksums or checksum(there) != own.checksums[place]:
                continue
            values = there[: len(whole.rows_of(block))]  # the last block of the store may be lower
            file.seek(_place(table, whole, block))
            file.write(np.ascontiguousarray(values, dtype="<f4").data)
            found[block] = own.checksums[place] if len(values) == len(there) else checksum(values)
        file.flush()
        os.fsync(file.fileno())
    return found


def _place(table: Path, whole: Journal, block: int) -> int:
    """Return where a block begins in the file of a table, whose values end it."""
    row = 4 * whole.columns
    return table.stat().st_size - (whole.rows - whole.rows_of(block).start) * row
