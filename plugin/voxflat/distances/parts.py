"""A store written by many workers: each writes a part (some of the rows), with a journal in its own directory.

The caller copies the entries of these journals to the journal of the store. Parts are kept in the store's directory,
and remain if a worker or the caller dies. A row has the same bits on every worker, so two workers may write it at once.
"""

import errno
import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, check_memory, log
from voxflat.distances.cluster import Cluster, Work, connected
from voxflat.distances.rows import DistanceRows, damaged_rows, open_rows
from voxflat.distances.sources import SourceChoice
from voxflat.distances.store import Store, append, array_hash, complete, prepare_store, read_journal, store_path
from voxflat.distances.table import Table
from voxflat.errors import InputError
from voxflat.io.files import atomic_path, naming_file, save_array
from voxflat.io.temporary import temporary_beside
from voxflat.surfaces.manifold import Manifold

try:
    import fcntl
except ImportError:  # not on every system; without it two simultaneous callers compute rows twice
    fcntl = None  # type: ignore[assignment]

_UNKNOWN = 16  # number of parts if there is no worker yet
_PATIENCE = 5.0  # s within which a stopped core releases its lock
_ENDING = 60.0  # s within which a killed worker finishes its writes and ends
_LOOK = 1.0  # s between checks of the workers' progress

_kept: dict[str, _core.Surface] = {}  # in a worker: its current surface, with a prepared graph


@dataclass(frozen=True)
class Wanted:
    """Rows to compute."""

    surface: str  # hash of the surface
    sources: int | NDArray[np.uint32]  # number of sources to choose, or row numbers of the points
    sampling: str
    seed: int
    geodesic: str  # as in `voxflat.geodesic`, over triangles


def rows_by_workers(
    part: Manifold,
    choice: SourceChoice,
    store: str | os.PathLike[str],
    dask: str,
    *,
    geodesic: str,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> DistanceRows:
    """Compute the missing rows of a store on the workers of a cluster, and open the store; finished rows are kept."""
    path = store_path(store)
    beside = temporary_beside(path)  # used until the store exists
    sources = choice.count if choice.given is None else choice.given
    request = Wanted(_write_surface(part, beside), sources, choice.sampling, choice.seed, geodesic)
    run: dict[str, Any] = {"threads": threads, "progress": progress}
    try:
        with connected(dask, most=choice.count) as cluster:
            try:
                begin = partial(_begin, request)
                ((_, prepared, error),) = cluster.each(begin, [(beside, path)], stage="choosing sources", **run)
                if error is not None:
                    raise error
                _finish(cluster, prepared, beside, partial(_part, request, prepared.identity, memory_limit), run)
            finally:
                with suppress(Exception):  # workers may be gone
                    cluster.everywhere(_forget)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    rows = open_rows(path)
    rows.verify()
    return rows


# ------------------------------------------------------------------------------------------ the caller


def _write_surface(part: Manifold, folder: Path) -> str:
    """Write the surface for workers; return its hash."""
    core = part.core
    arrays: dict[str, NDArray[Any]] = {"points": core.points, "faces": core.faces, "ids": part.ids}
    with naming_file(folder):
        folder.mkdir()
        for name, array in arrays.items():
            save_array(folder / f"{name}.npy", array)
    return " ".join(array_hash(array) for array in arrays.values())


def _finish(cluster: Cluster, store: Store, surface: Path, work: Work, run: dict[str, Any]) -> None:
    """Compute the missing rows of a store."""
    path = store.path
    with _locked(path):
        _collect(path)
        journal = read_journal(path)
        missing = [row for row in range(journal.rows) if row not in journal.checksums]
        if missing:
            (path / "parts").mkdir()
            surface.rename(path / "parts" / "surface")
            _compute(cluster, path, _deal(path, missing, len(cluster) or _UNKNOWN), work, run)
        if not journal.is_complete:
            complete(path)
        shutil.rmtree(path / "parts", ignore_errors=True)


@contextmanager
def _locked(store: Path) -> Iterator[None]:
    """Hold the lock of a store, as the core does while it computes."""
    with naming_file(store), (store / "lock").open("r+", encoding="utf-8", newline="\n") as lock:
        if fcntl is not None:
            deadline = time.monotonic() + _PATIENCE
            while True:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > deadline:
                        text = f"the store is in use by process {lock.read().strip()}. Wait until it is finished"
                        raise OSError(errno.EAGAIN, text, str(store)) from None
                time.sleep(0.01)
            lock.truncate(0)
            lock.write(f"{os.getpid()}\n")
            lock.flush()
        yield


def _collect(store: Path) -> None:
    """Copy finished rows from parts of an earlier call."""
    whole = read_journal(store)
    rows = len(whole.checksums)
    for part in sorted((store / "parts").glob("*/journal.jsonl")):
        with suppress(InputError):  # the part was not started
            journal = read_journal(part.parent)
            if journal.header == whole.header:
                damaged = damaged_rows(store, journal.checksums)
                sound = {row: checksum for row, checksum in journal.checksums.items() if row not in damaged}
                append(store, sound)
                rows += len(sound)
    shutil.rmtree(store / "parts", ignore_errors=True)
    if rows:
        log.info("%d rows were already in the store %s", rows, store)


def _deal(store: Path, missing: list[int], workers: int) -> list[Path]:
    """Make one part per worker, with neighbouring sources, because each worker has to prepare the graph."""
    sources = Table.open(store / "points.npy")[Table.open(store / "sources.npy")[missing].astype(np.int64)]
    along = np.linalg.svd(sources - sources.mean(axis=0), full_matrices=False)[2][0]
    order = np.array(missing)[np.argsort(sources @ along, kind="stable")]
    places = []
    for rows in np.array_split(order, min(workers, len(missing))):
        place = store / "parts" / str(rows[0])
        place.mkdir()
        with atomic_path(place / "rows.json") as temporary:
            temporary.write_text(json.dumps(rows.tolist()), encoding="utf-8", newline="\n")
        places.append(place)
    return places


def _compute(cluster: Cluster, store: Path, places: list[Path], work: Work, run: dict[str, Any]) -> None:
    """Compute parts on the workers, and record finished rows."""
    errors = []
    if run["progress"] is not None:
        run = {**run, "progress": _Rows(store, run["progress"])}
    for place, checksums, error in cluster.each(work, places, stage="measuring distances", **run):
        if error is None:
            append(store, checksums)
            shutil.rmtree(place, ignore_errors=True)
        else:
            errors.append(error)
    if errors:
        raise errors[0]


class _Rows:
    """Progress in rows, read from journals."""

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
            self._rows, self._all = min(finished, whole.rows), whole.rows
        return self._progress(stage, self._rows, self._all)


# ------------------------------------------------------------------------------------------- a worker


def _begin(request: Wanted, places: tuple[Path, Path], *, threads: int, progress: Progress) -> Store:
    """Choose sources and create a store for them, or check that an existing store has the same rows."""
    folder, path = places
    core = _surface(request.surface, folder)
    if isinstance(request.sources, int):
        chosen = core.choose_sources(request.sampling, request.sources, request.seed, progress)
    else:
        chosen = request.sources
    ids = np.asarray(Table.open(folder / "ids.npy"))
    store = prepare_store(path, core, ids, chosen, geodesic=request.geodesic, progress=progress)
    core.lay_out_store(*store.key, len(chosen), progress=progress)
    return store


def _part(
    request: Wanted, identity: str, memory_limit: int | None, part: Path, *, threads: int, progress: Progress
) -> dict[int, int]:
    """Compute the rows of a part; return their checksums."""
    store = part.parents[1]
    core = _surface(request.surface, store / "parts" / "surface")
    rows = json.loads((part / "rows.json").read_text(encoding="utf-8"))
    need = _core.store_memory_need(len(core), len(rows), threads)
    check_memory(need, memory_limit, "use fewer threads")
    chosen = np.asarray(Table.open(store / "sources.npy")).astype(np.uint32)
    key = (store, part, identity, chosen, np.array(rows, dtype=np.uint32))
    deadline = time.monotonic() + _ENDING
    while True:
        try:
            core.store_part(*key, geodesic=request.geodesic, threads=threads, progress=progress)
            return read_journal(part).checksums
        except BlockingIOError:  # the previous worker has not ended yet
            if time.monotonic() > deadline:
                raise


def _surface(key: str, folder: Path) -> _core.Surface:
    """Return the surface of a folder; a worker caches it, with the data needed to compute distances."""
    if key not in _kept:
        _kept.clear()
        points, faces = (np.asarray(Table.open(folder / f"{name}.npy")) for name in ("points", "faces"))
        core, _ = _core.Surface.from_triangles(points, faces.astype(np.int64))
        if not (np.array_equal(core.points, points) and np.array_equal(core.faces, faces)):
            raise InputError("the surface differs between processes. Omit dask")
        _kept[key] = core
    return _kept[key]


def _forget() -> None:
    _kept.clear()
