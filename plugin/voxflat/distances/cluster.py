"""Share work among many machines: workers of a Dask cluster process one item after another, and may die at any time."""

import importlib
import json
import logging
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

from voxflat._core import __version__
from voxflat.arguments import Progress, free_memory, log
from voxflat.errors import Cancelled, InputError
from voxflat.io.files import installing

LOCAL = "local"  # instead of an address: start workers on this machine

_PATIENCE = 30  # s within which a scheduler must answer
_WAITING = "waiting for workers"  # shown while there are no workers
_POLL = 0.1  # s between checks for cancellation
_COUNT = 1.0  # s between queries of the number of workers
_ROOM = 2 << 30  # minimum bytes for a local worker: a hemisphere of 160,000 vertices needs 1.3 GiB
_ALONE = threading.Lock()  # the working directory and the log belong to the whole process

Work = Callable[..., Any]
"""A function called on a worker as ``work(item, threads=, progress=)``: importable, or a `partial` of such."""

_Item = TypeVar("_Item")


class Cluster:
    """The workers of a Dask cluster, reached through a `distributed.Client`, which connects to the scheduler."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def __len__(self) -> int:
        """Return the current number of workers."""
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def everywhere(self, function: Callable[[], object]) -> None:
        """Call a function on every worker."""
        self._client.run(function)

    def each(
        self,
        work: Work,
        items: Sequence[_Item],
        *,
        stage: str,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> Iterator[tuple[_Item, Any, Exception | None]]:
        """Process each item on a free worker; if a worker dies, another one takes over the item, up to 4 times."""
        finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        run = partial(_run, work, folder=Path.cwd(), version=__version__, threads=threads)
        futures = self._client.map(run, items, pure=False, retries=0)
        item_of = {future.key: item for future, item in zip(futures, items, strict=True)}
        try:
            for future in futures:
                future.add_done_callback(finished.put)
            done, workers, counted = 0, 0, -math.inf
            while done < len(items):
                if progress is not None:
                    if time.monotonic() > counted + _COUNT:
                        workers, counted = len(self), time.monotonic()
                    if progress(stage if workers else _WAITING, done, len(items)) is False:
                        raise Cancelled("cancelled")
                with suppress(queue.Empty):
                    future = finished.get(timeout=_POLL)
                    done += 1
                    outcome = _outcome(future)
                    future.release()  # otherwise it is recomputed if the worker that holds the result dies
                    yield item_of[future.key], *outcome
        finally:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel(futures)


def _outcome(future: Any) -> tuple[Any, Exception | None]:
    """Return the result of a finished future, or its error."""
    if future.status == "cancelled" or future.status == "lost":
        return None, InputError("the connection to the scheduler was lost. Run the same command again to resume")
    error = future.exception()
    if error is None:
        return future.result(), None
    if type(error).__name__ == "KilledWorker":
        return None, InputError(
            f"the worker died {error.allowed_failures + 1} times (most recently at {error.last_worker.address}). Pass "
            "the workers more memory or time"
        )
    return None, error if isinstance(error, Exception) else RuntimeError(str(error))


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Restore the environment variables at the end, because Dask sets some for its local workers.

    Programs that the user starts later would otherwise inherit them, such as a single thread for OpenMP.
    """
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in set(os.environ) - set(before):
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def connected(address: str, *, most: int) -> Iterator[Cluster]:
    """Connect to a Dask cluster, or start one on this machine, until the block ends."""
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError(f"a cluster requires the package {error.name}. Run {installing('distributed')}") from error
    if address == LOCAL:
        cores = os.cpu_count() or 1
        count = max(1, min(cores, free_memory() // _ROOM, most))
        threads = math.ceil(cores / count)
        quiet: dict[str, Any] = {"silence_logs": "CRITICAL", "dashboard_address": None}
        with (
            _environment_kept(),
            distributed.LocalCluster(n_workers=count, threads_per_worker=threads, **quiet) as here,
            distributed.Client(here) as client,
        ):
            yield Cluster(client)
        return
    try:  # the client would wait for a file forever
        scheduler = (
            json.loads(Path(address).read_text(encoding="utf-8"))["address"] if address.endswith(".json") else address
        )
        client = distributed.Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError, KeyError, TypeError) as error:
        remedy = "Check that it is running and can be reached from this machine"
        raise InputError(f"no Dask scheduler responds at {address} ({error}). {remedy}") from error
    with client:
        versions = client.run(version, "voxflat", on_error="return")
        for worker, other in versions.items():
            if isinstance(other, PackageNotFoundError):
                raise InputError(f"voxflat is not installed on the worker {worker}. Install version {__version__}")
            if isinstance(other, str):  # otherwise the worker has died
                _check_version(worker, other, __version__)
        yield Cluster(client)


def _check_version(worker: str, version: str, expected: str) -> None:
    if version != expected:
        raise InputError(
            f"the worker {worker} has voxflat {version} instead of {expected}. Install version {expected} on it"
        )


def _run(work: Work, item: Any, folder: Path, version: str, threads: int | None) -> Any:
    """Process an item on a worker, one at a time, because the core uses several threads."""
    distributed = importlib.import_module("distributed")
    worker, key = distributed.get_worker(), distributed.worker.thread_state.key
    _check_version(worker.address, __version__, version)  # the worker may have joined after the client

    def go_on(*_: object) -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state == "executing"  # otherwise the result is no longer needed

    with _ALONE, _in(folder):
        return work(item, threads=threads or worker.state.nthreads, progress=go_on)


@contextmanager
def _in(folder: Path) -> Iterator[None]:
    """Change to the caller's directory, so that file names match; log messages are returned with the results."""
    before, hushed = os.getcwd(), logging.NullHandler()
    os.chdir(folder)
    log.addHandler(hushed)
    try:
        yield
    finally:
        log.removeHandler(hushed)
        os.chdir(before)
