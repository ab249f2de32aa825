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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, check_memory, log
from voxflat.cluster import Cluster, connected
from voxflat.distances.journal import Journal, append, complete, read_journal
from voxflat.distances.rows import checksum
from voxflat.distances.store import Store, check_disk, mapped, read_description
from voxflat.errors import Cancelled, InputError
from voxflat.io.files import atomic_path, naming_file, save_array

try:
    import fcntl
except ImportError:  # not on every system: there two callers at once compute blocks twice
    fcntl = None  # type: ignore[assignment]

__all__ = ["compute_on_workers"]

_COMPUTING = ("preparing distances", "measuring distances")  # stages of the core, once it knows what is missing
_UNKNOWN = 16  # parts where no worker is there yet
_PATIENCE = 5.0  # s, within which a core that was stopped lets its lock go
_LOOK = 1.0  # s between two looks at how far workers are


def compute_on_workers(
    store: Store,
    core: _core.Surface,
    chosen: NDArray[np.uint32],
    dask: str,
    *,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> None:
    """Compute the blocks that a store lacks, on the workers of a cluster.

    Parameters
    ----------
    store : Store
        As `prepare_store` made it.
    core : _core.Surface
        The surface; workers read it from the store's directory.
    chosen : ndarray of uint32, shape (m,)
        The sources, as numbers into the points.
    dask : str
        The cluster, as in `connected`.
    threads : int, optional
        Of each worker.
    memory_limit : int, optional
        Bytes that rows in the making may take in each worker.
    progress : callable, optional
        As in `voxflat.flatten`.

    Raises
    ------
    InputError, OSError
        If a part cannot be computed. What is finished, of this and others, is kept.
    Cancelled
        If `progress` returned False. Workers stop.
    """
    _lay_out(store, core, chosen, progress)
    path = store.path
    with _locked(path):
        _collect(path)
        journal = read_journal(path)
        missing = [block for block in range(journal.blocks) if block not in journal.checksums]
        if missing:
            check_disk(
                path, 2 * 4 * journal.rows * journal.columns
            )  # blocks are in a part before they are in the store
            with connected(dask, most=len(missing)) as cluster:
                places = _deal(path, missing, core, len(cluster) or _UNKNOWN)
                how = {"identity": store.identity, "geodesic": store.geodesic, "memory_limit": memory_limit}
                _compute(cluster, path, places, how, threads, progress)
        if not journal.is_complete:
            complete(path)
        shutil.rmtree(path / "parts", ignore_errors=True)


# ------------------------------------------------------------------------------------------ the caller


def _lay_out(store: Store, core: _core.Surface, chosen: NDArray[np.uint32], progress: Progress | None) -> None:
    """Let the core make table and journal, or compare those that are there with their checksums, and stop it then."""
    is_laid_out = False

    def watch(stage: str, done: int, total: int) -> bool | None:
        nonlocal is_laid_out
        is_laid_out |= stage in _COMPUTING
        if is_laid_out:
            return False
        return None if progress is None else progress(stage, done, total)

    try:
        core.store_rows(*store.key, chosen, geodesic=store.geodesic, progress=watch)
    except Cancelled:
        if not is_laid_out:
            raise


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


def _deal(store: Path, missing: Sequence[int], core: _core.Surface, workers: int) -> list[Path]:
    """Make parts of what is missing, one for each worker: each has to join neighbours, and to prepare distances."""
    (store / "parts").mkdir()
    save_array(store / "parts" / "faces.npy", core.faces)
    places = []
    for blocks in np.array_split(np.array(missing), min(workers, len(missing))):
        place = store / "parts" / str(blocks[0])
        place.mkdir()
        with atomic_path(place / "blocks.json") as temporary:
            temporary.write_text(json.dumps(blocks.tolist()))
        places.append(place)
    return places


def _compute(
    cluster: Cluster,
    store: Path,
    places: list[Path],
    how: dict[str, Any],
    threads: int | None,
    progress: Progress | None,
) -> None:
    """Have parts computed, and enter what is finished."""
    work, errors = partial(_part, **how), []
    told = None if progress is None else _Rows(store, progress)
    for place, found, error in cluster.each(work, places, stage="measuring distances", threads=threads, progress=told):
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


def _part(
    part: Path,
    *,
    identity: str,
    geodesic: str,
    memory_limit: int | None,
    threads: int,
    progress: Progress,
) -> dict[int, int]:
    """Compute the blocks of a part and move them to the store; return their checksums."""
    store = part.parents[1]
    core = _surface(store, geodesic, progress)
    whole, blocks = read_journal(store), _blocks(part)
    need = _core.store_memory_need(whole.columns, whole.rows, threads)
    check_memory(need, memory_limit, "take fewer threads")
    own = np.concatenate([np.array(whole.rows_of(block)) for block in blocks])
    order = np.concatenate([own, np.setdiff1d(np.arange(whole.rows), own)])
    chosen = mapped(store / "sources.npy")[order].astype(np.uint32)
    watch = _Watch(part, len(blocks), progress)
    try:
        core.store_rows(part, identity, chosen, geodesic=geodesic, threads=threads, progress=watch)
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


def _surface(store: Path, geodesic: str, progress: Progress) -> _core.Surface:
    """Return the surface of a store, whose distances are those of the caller's."""
    points, faces = mapped(store / "points.npy"), mapped(store / "parts" / "faces.npy")
    core, _ = _core.Surface.from_triangles(np.array(points), faces.astype(np.int64))
    found = f"{core.fingerprint(geodesic, progress=progress):016x}"
    if found != read_description(store)["fingerprint"]:
        raise InputError(f"the surface of {store} has other distances on this worker; leave dask out")
    return core


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
            there = own.rows_of(place)
            if place not in own.checksums or checksum(rows[there.start : there.stop]) != own.checksums[place]:
                continue
            values = rows[there.start :][: len(whole.rows_of(block))]  # the last block of the store may be lower
            file.seek(_place(table, whole, block))
            file.write(np.ascontiguousarray(values, dtype="<f4").data)
            found[block] = checksum(values)
        file.flush()
        os.fsync(file.fileno())
    return found


def _place(table: Path, whole: Journal, block: int) -> int:
    """Return where a block begins in the file of a table, whose values end it."""
    row = 4 * whole.columns
    return table.stat().st_size - (whole.rows - whole.rows_of(block).start) * row
