"""Studies and distance rows on the workers of a Dask cluster, some of which are killed."""

import json
import logging
import os
import re
import shlex
import shutil
import signal
import sys
import threading
import time
from contextlib import nullcontext
from unittest.mock import Mock

import composed
import how_to
import numpy as np
import pytest
import studies
from cluster_work import no_package, tell, wait
from command_line import fail, run, succeed
from lab_runs import FEW, everything
from refusals import refused

import voxflat
from voxflat.distances import cluster, parts
from voxflat.distances.cluster import connected

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
fcntl = pytest.importorskip("fcntl")

BROKEN = "sub-02"
PAGE = how_to.text("job-array", "dask")

pytestmark = pytest.mark.slow  # workers are processes, which take seconds to start


@pytest.fixture(scope="module")
def workers():
    """Two workers with one thread each, restarted when they die, forked from a process that has imported everything."""
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        preload = ["distributed", "voxflat.lab.report", "voxflat.lab.subject", "nibabel", "scipy.spatial"]
        distributed.utils.get_mp_context().set_forkserver_preload(preload)
        how = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": "CRITICAL"}
        with distributed.LocalCluster(n_workers=2, **how) as started:
            yield started


@pytest.fixture
def ready(workers):
    """The address of the cluster, with both workers alive."""
    with distributed.Client(workers) as client:
        client.wait_for_workers(2, timeout=60)
    return workers.scheduler_address


def until(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "timeout"
        time.sleep(0.005)


def kill_one(workers):
    """Kill a worker, as a system without free memory does."""
    os.kill(next(iter(workers.workers.values())).pid, signal.SIGKILL)


# ------------------------------------------------------------------------------------------------ work


def test_workers_stop_when_nobody_waits_any_more(ready, tmp_path):
    def cancel(stage, done, total):
        assert (stage, done, total) == ("waiting", 0, 1)
        return not (tmp_path / "begun").exists()

    with connected(ready, most=1) as found, pytest.raises(voxflat.Cancelled):
        list(found.each(wait, [tmp_path], stage="waiting", progress=cancel))
    until((tmp_path / "stopped").exists)


def test_who_waits_for_workers_is_told_so_and_can_leave():
    stages = []

    def cancel(stage, done, total):
        stages.append((stage, done, total))
        return len(stages) < 3

    nobody = distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None, silence_logs="CRITICAL")
    with nobody, connected(nobody.scheduler_address, most=1) as found, pytest.raises(voxflat.Cancelled):
        list(found.each(tell, ["a"], stage="telling", progress=cancel))
    assert stages == [("waiting for workers", 0, 1)] * 3


def test_what_cannot_be_connected_is_told_with_a_remedy(ready, monkeypatch):
    def is_refused(address, match):
        with pytest.raises(voxflat.InputError, match=match), connected(address, most=1):
            pass

    monkeypatch.setattr(cluster, "_PATIENCE", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://here", "no/such/scheduler.json"):
        is_refused(address, rf"no Dask scheduler responds at {address} \(.*\)\. Check that it is running")
    monkeypatch.setattr(cluster, "__version__", "0.0.1")
    is_refused(ready, r"the worker tcp://\S+ has voxflat \S+ instead of 0\.0\.1. Install version")
    monkeypatch.setattr(cluster, "version", no_package)
    is_refused(ready, r"voxflat is not installed on the worker tcp://\S+. Install version 0\.0\.1")
    monkeypatch.setitem(sys.modules, "distributed", None)
    is_refused(ready, r"a cluster requires the package distributed\. Run pip install 'voxflat\[lab\]'")


# ----------------------------------------------------------------------------------------------- studies


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of four participants, one of them broken, and its results from one process."""
    pytest.importorskip("nilearn")
    root = tmp_path_factory.mktemp("study")
    of = studies.hemisphere("lh", FEW)
    for n in range(1, 5):
        studies.write_derivatives(root / "bids" / f"sub-{n:02}" / "anat", f"sub-{n:02}", "lh", studies.warped(of, n))
    (root / "bids" / BROKEN / "anat" / f"{BROKEN}_hemi-L_pial.surf.gii").unlink()
    command = ["bids", root / "bids", root / "alone", "participant", "--hemi", "L", "--threads", 1]
    assert run(*command).exit_code == 1
    return root


def made_of(folder):
    """Return the contents of files without times: those in records, and pages, which show them."""
    held = {name: content for name, (content, _) in everything(folder).items() if not name.endswith(".html")}
    held = {name: content for name, content in held.items() if "/." not in name}  # left by killed workers
    for name, content in held.items():
        if name.endswith("_flat.json"):
            held[name] = {key: value for key, value in json.loads(content).items() if key not in ("seconds", "sha256")}
    return held


def test_a_study_is_that_of_one_process_and_goes_on_where_a_worker_has_died(workers, ready, study, monkeypatch):
    out = study / "out"
    monkeypatch.setattr(workers.scheduler, "allowed_failures", 0)  # otherwise another worker would resume it at once
    killer = threading.Thread(target=lambda: (until(lambda: list(out.rglob("*_desc-voxflat_*"))), kill_one(workers)))
    killer.start()
    command = ["bids", study / "bids", out, "participant", "--hemi", "L", "--dask", ready]
    result = run(*command, "--json")
    killer.join()
    there = {name: of for name, of in everything(out).items() if name.endswith("_flat.json")}
    told = {one["participant"]: one for one in json.loads(result.stdout)["hemispheres"]}
    assert list(told) == [f"sub-{n:02}" for n in range(1, 5)]
    died = {name for name, one in told.items() if "the worker died 1 times" in (one["reason"] or "")}
    assert died
    assert result.exit_code == len({*died, BROKEN})
    assert {path.parts[-3] for path in out.rglob("*_failure.json")} == {*died, BROKEN}
    again = json.loads(run(*command, "--json").stdout)
    assert {one["participant"] for one in again["hemispheres"] if one["state"] == "made"} == died - {BROKEN}
    assert again["failed"] == [BROKEN]
    now = everything(out)
    assert there
    assert {name: now[name] for name in there} == there  # finished maps were not made again
    assert made_of(out) == made_of(study / "alone")
    assert {path.name for path in out.glob("*.html")} == {path.name for path in (study / "alone").glob("*.html")}


def test_a_local_cluster_leaves_the_environment_and_the_logs_as_they_were(monkeypatch):
    """Dask sets variables such as OMP_NUM_THREADS, which programs started later would inherit."""
    for name in [name for name in os.environ if name.startswith(("MALLOC_", "OMP_", "MKL_", "OPENBLAS_", "__DASK"))]:
        monkeypatch.delenv(name)

    def state():
        loggers = sorted(name for name in logging.root.manager.loggerDict if name.startswith("distributed"))
        return dict(os.environ), {name: level for name in loggers if (level := logging.getLogger(name).level)}

    before = state()
    with connected("local", most=1):
        assert "OMP_NUM_THREADS" in os.environ
    assert state() == before


def test_the_commands_of_the_page_run(workers, ready, study, tmp_path, monkeypatch):
    here = Mock(return_value=nullcontext(workers))
    monkeypatch.setattr(distributed, "LocalCluster", here)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(study / "bids" / "sub-01", tmp_path / "study" / "sub-01")
    studies.write_derivatives(tmp_path / "study" / "sub-01" / "anat", "sub-01", "rh", studies.hemisphere("rh", FEW))
    (tmp_path / "scheduler.json").write_text(json.dumps({"address": ready}))
    for name in ("white", "pial"):
        shutil.copy(tmp_path / "study" / "sub-01" / "anat" / f"sub-01_hemi-L_{name}.surf.gii", f"lh.{name}.surf.gii")
    steps = [f"bids study maps {step}" for step in ("participant --dry-run", "participant", "group")]
    assert all(step in PAGE for step in steps)
    commands = [*steps, *how_to.commands(PAGE)]
    dry, made, group, local, file, rows = (succeed(*shlex.split(command)).stdout for command in commands)
    assert [json.loads(line)["state"] for line in dry.splitlines()] == ["missing"] * 2
    assert "1 participant: 1 made" in made
    assert "maps: 1 left and 1 right hemispheres of 1 participant" in group
    assert "1 participant: 0 made, 1 up to date" in local
    assert local == file
    assert here.call_args_list[0].kwargs["n_workers"] == 1
    assert f"100 x {FEW} distances in mm" in rows


# ------------------------------------------------------------------------------------------------- rows

SHEET = np.ones((60, 60, 1), dtype=np.uint8)
SOURCES = 500


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The store written by one process."""
    return voxflat.surface(SHEET).geodesic(SOURCES, store=tmp_path_factory.mktemp("rows") / "store")


def rows_known(store):
    """Return the number of rows in the journals of a store and its parts."""
    return sum(path.read_text().count("crc32") for path in store.rglob("journal.jsonl"))


def contents(rows):
    """Verify rows; return the names in their store, the rows and the journal, whose entries may have any order."""
    rows.verify()
    first, *entries, last = (rows.store / "journal.jsonl").read_text().splitlines()
    names = sorted(path.name for path in rows.store.iterdir())
    return names, (rows.store / "rows.npy").read_bytes(), first, sorted(entries), last


def test_rows_are_those_of_one_process_though_a_worker_dies(workers, ready, expected, tmp_path):
    store = tmp_path / "store"
    killer = threading.Thread(target=lambda: (until(lambda: rows_known(store) > 60), kill_one(workers)))
    killer.start()
    rows = voxflat.surface(SHEET).geodesic(SOURCES, store=store, dask=ready)
    killer.join()
    assert contents(rows) == contents(expected)
    assert rows.provenance == expected.provenance | {"parameters": rows.provenance["parameters"]}


def test_rows_over_a_cut_patch_by_another_solver_from_given_sources_are_those_of_memory(ready, tmp_path):
    across = [(20 + n, 30, 0) for n in range(15)]
    patch = voxflat.surface(SHEET).disk((30, 30, 0), 20).cut([across], relax=False).surface
    sources = [(30, 32, 0), (30, 28, 0), (20, 30, 0)]
    rows = patch.geodesic(sources, geodesic="marching", store=tmp_path / "store", dask=ready)
    usual = patch.geodesic(sources, geodesic="marching")
    for name in ("rows", "points", "ids", "sources"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(usual, name))
    assert usual.rows[0, usual.sources[1]] > 8  # around the cut


def test_what_a_dead_caller_left_is_taken_over_and_computed_by_nobody_again(ready, expected, tmp_path, caplog):
    caplog.set_level("INFO", logger="voxflat")
    store = tmp_path / "store"
    seen = []

    def stop_after_some(stage, done, total):
        seen.append((stage, done, total))
        return rows_known(store) < 60 or not (store / "parts").exists()

    with pytest.raises(voxflat.Cancelled):
        voxflat.surface(SHEET).geodesic(SOURCES, store=store, dask=ready, progress=stop_after_some)
    assert ("measuring distances", SOURCES) in {(stage, total) for stage, _, total in seen}
    refused("not complete", voxflat.open_rows, store)
    until(lambda: _is_quiet(store))
    there = rows_known(store)
    assert 60 <= there <= SOURCES
    caplog.clear()
    rows = voxflat.surface(SHEET).geodesic(SOURCES, store=store, dask=ready)
    told = re.search(r"(\d+) rows were already in the store", caplog.text)
    assert there <= int(told[1]) <= SOURCES  # a worker may have started another part when the caller died
    assert contents(rows) == contents(expected)
    caplog.clear()
    assert contents(voxflat.surface(SHEET).geodesic(SOURCES, store=store, dask=ready)) == contents(expected)


def _is_quiet(store):
    """Tell whether no core holds a lock of the store or of its parts any more."""
    for path in store.rglob("lock"):
        with path.open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
    return True


def test_a_part_waits_until_the_worker_that_had_it_has_ended(ready, expected, tmp_path, monkeypatch):
    deal, released = parts._deal, []

    def deal_and_hold_one(*how):  # like a killed worker that is still writing
        places = deal(*how)
        lock = (places[0] / "lock").open("a")
        fcntl.flock(lock, fcntl.LOCK_EX)
        # for longer than the core waits for a lock
        threading.Timer(1.5, lambda: (released.append(rows_known(tmp_path / "store")), lock.close())).start()
        return places

    monkeypatch.setattr(parts, "_deal", deal_and_hold_one)
    rows = voxflat.surface(SHEET).geodesic(SOURCES, store=tmp_path / "store", dask=ready)
    assert released[0] < SOURCES
    assert contents(rows) == contents(expected)


def test_what_workers_cannot_do_is_told(ready, tmp_path, monkeypatch):
    store, sheet = tmp_path / "store", voxflat.surface(SHEET)
    for options, match in (
        ({}, "dask requires a store to which the workers can write. Also pass store"),
        ({"store": store, "geodesic": "chain"}, "does not have the option dask. Omit it"),
        ({"store": store, "memory_limit": 10**6}, "memory is needed, but the limit is 976.6 KiB. Use fewer threads"),
    ):
        refused(match, composed.geodesic, sheet, SOURCES, dask=ready, **options)
    assert run("rows", "none.npy", "--sources", 5, "--store", store, "--dask", ready).exit_code == 1
    monkeypatch.setattr("voxflat.distances.parts._PATIENCE", 0.1)
    with (store / "lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(OSError, match="in use by process"):
            voxflat.surface(SHEET).geodesic(SOURCES, store=store, dask=ready)


def test_dask_is_for_participants(study):
    words = ["bids", study / "bids", study / "alone"]
    fail(2, "--dask requires the level participant", *words, "group", "--dask", "local")
    fail(2, "--dask cannot be combined with --dry-run", *words, "participant", "--dry-run", "--dask", "local")
