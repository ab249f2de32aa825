"""Distance rows on disk equal those in memory bit by bit, even after interruptions."""

import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import composed
import numpy as np
import pytest
import shapes
from command_line import fail, run, succeed
from refusals import refused
from triangle_meshes import square

import voxflat
from voxflat.distances import store as _store
from voxflat.distances.rows import damaged_rows
from voxflat.distances.table import Table
from voxflat.io.provenance import portable
from voxflat.methods import Voxflat

fcntl = pytest.importorskip("fcntl")

FILES = ["ids.npy", "journal.jsonl", "lock", "points.npy", "provenance.json", "rows.npy", "sources.npy", "store.json"]
SOURCES = 40
SHEET = np.ones((30, 20, 1), dtype=np.uint8)
SURFACE = voxflat.surface(SHEET)
INDICES = (3, -1, (4, 5), np.s_[2:30:3, ::-1], np.s_[:, 7], np.s_[[1, 5, 1]], np.s_[..., None], np.s_[[0, 3], [7, 599]])
INDICES += (np.s_[5:5], np.s_[:, 4:4], np.s_[[True, False] * 20, 3:9], np.s_[2, [8, 8]], np.s_[9:2:-2], np.s_[[], 5])


@pytest.fixture(scope="module")
def expected():
    return SURFACE.geodesic(SOURCES)


@pytest.fixture
def stored(tmp_path):
    return SURFACE.geodesic(SOURCES, store=tmp_path / "store")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(autouse=True)
def log(caplog):
    caplog.set_level(logging.INFO, logger="voxflat")
    return caplog


class TestAStore:
    def test_holds_the_rows_that_memory_would(self, stored, expected):
        for name in ("rows", "ids", "points", "sources"):
            np.testing.assert_array_equal(getattr(stored, name), getattr(expected, name))
        assert names(stored.store) == FILES
        np.testing.assert_array_equal(np.load(stored.store / "rows.npy", mmap_mode="r"), expected.rows)
        stored.verify()
        expected.verify()

    def test_of_chain_codes(self, tmp_path):
        options = {"geodesic": "chain", "link_lengths": "euclidean", "spacing": (1, 2, 1.5)}
        rows = composed.geodesic(SHEET, SOURCES, store=tmp_path / "store", **options)
        np.testing.assert_array_equal(rows, composed.geodesic(SHEET, SOURCES, **options))
        options |= {"link_lengths": None, "store": tmp_path / "store"}
        message = "its link_lengths is 'euclidean', not 'chain-code'. Choose another"
        refused(message, composed.geodesic, SHEET, SOURCES, **options)

    def test_is_opened_without_reading_it(self, stored, expected):
        rows = voxflat.open_rows(str(stored.store))
        assert isinstance(rows.rows, Table)
        assert (rows.shape, rows.dtype, rows.ndim, len(rows)) == (expected.shape, np.float32, 2, SOURCES)
        assert rows.chunks == (SOURCES, 600)  # less than 64 MiB
        assert rows.nbytes == expected.nbytes == 4 * 600 * SOURCES
        for index in INDICES:
            found = rows[index]
            np.testing.assert_array_equal(found, expected[index])
            assert np.shape(found) == np.shape(expected[index])
        assert np.asarray(rows, dtype=float).dtype == np.float64
        for beyond in (SOURCES, (0, 600), np.s_[[0, SOURCES]], (0, 0, 0)):
            with pytest.raises(IndexError):
                rows[beyond]

    def test_is_an_array_of_dask(self, stored, expected):
        array = pytest.importorskip("dask.array").from_array(stored, chunks=stored.chunks)
        assert array.chunks == ((SOURCES,), (600,))
        np.testing.assert_array_equal(array[5:20, ::7].compute(), expected[5:20, ::7])

    def test_is_shown_by_napari(self, stored, expected):
        layers = pytest.importorskip("napari.layers")
        layer = layers.Image(stored)
        assert layer.data is stored
        assert layer.contrast_limits == [0, expected.rows.max()]

    def test_can_be_an_empty_directory_beforehand(self, tmp_path, expected):
        (tmp_path / "empty").mkdir()
        np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=tmp_path / "empty"), expected)
        assert names(tmp_path) == ["empty"]

    def test_tells_what_it_needs(self, tmp_path, log):
        stored = SURFACE.geodesic(SOURCES, store=tmp_path / "store")
        memory, disk = log.messages
        assert re.fullmatch(r"up to \S+ [KM]iB of memory will be used for the rows being computed", memory)
        assert disk == f"up to 93.75 KiB of disk space will be used in {stored.store}"

    def test_follows_no_change_of_directory(self, tmp_path, monkeypatch, expected):
        monkeypatch.chdir(tmp_path)
        rows = SURFACE.geodesic(SOURCES, store="here")
        monkeypatch.chdir("/")
        assert rows.store == tmp_path / "here"
        rows.verify()


class TestFlatten:
    def test_takes_and_leaves_the_store_of_geodesic(self, stored, log):
        before = (stored.store / "journal.jsonl").stat().st_mtime_ns
        log.clear()
        voxflat.flatten(SHEET, method=Voxflat(sources=SOURCES), rows=stored.store)
        assert f"{SOURCES} rows were already in the store {stored.store}" in log.messages
        assert (stored.store / "journal.jsonl").stat().st_mtime_ns == before

    def test_saves_no_rows_of_a_store(self, tmp_path):
        voxflat.flatten(SHEET, method=Voxflat(sources=SOURCES), rows=tmp_path / "store").save(tmp_path / "map.npz")
        again = voxflat.load(tmp_path / "map.npz")
        assert again.rows is None
        voxflat.open_rows(tmp_path / again.metadata["store"]).verify()  # its name: no path is written

    def test_of_no_disk_is_refused_before_rows_are_measured(self, tmp_path):
        method, rows = Voxflat(sources=SOURCES), tmp_path / "store"
        refused("not a disk", voxflat.flatten, shapes.ball(), method=method, cuts=[], rows=rows)
        assert not (tmp_path / "store" / "rows.npy").exists()


# ----------------------------------------------------------------------------------------- interruptions


def test_what_was_cancelled_goes_on(tmp_path, expected):
    with pytest.raises(voxflat.Cancelled):
        SURFACE.geodesic(SOURCES, store=tmp_path / "store", progress=lambda stage, *_: stage != "measuring distances")
    np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=tmp_path / "store"), expected)


@pytest.mark.medium
def test_a_full_disk_is_told_and_the_run_goes_on_later(tmp_path, expected):
    limited = """
import resource, sys, numpy, voxflat
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY))
voxflat.surface(numpy.ones((30, 20, 1), numpy.uint8)).geodesic(40, store=sys.argv[1])
"""
    store = tmp_path / "store"
    done = subprocess.run([sys.executable, "-B", "-c", limited, store], capture_output=True, text=True, check=False)
    said = rf"OSError: \[Errno 27\] cannot write: File too large.*free space.*: '{store}/rows.npy'"
    assert re.search(said, done.stderr)
    refused("Measure again with the same store", voxflat.open_rows, store)
    np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=store), expected)


# ------------------------------------------------------------------------------------------------ damage


def spoil(path, at, value=b"\xff"):
    with path.open("r+b") as file:
        file.seek(at, os.SEEK_END if at < 0 else os.SEEK_SET)
        file.write(value)


def test_damaged_rows_are_found_and_mended(stored, expected, log):
    spoil(stored.store / "rows.npy", -5)
    refused(r"store: some rows \(39\) do not match .* Measure again", voxflat.open_rows(stored.store).verify)
    log.clear()
    np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=stored.store), expected)
    (warning,) = [record.getMessage() for record in log.records if record.levelno >= logging.WARNING]
    assert warning.startswith("recomputed 1 rows of the store")
    voxflat.open_rows(stored.store).verify()


def truncate(path):
    os.truncate(path, path.stat().st_size // 2)


DAMAGES = {
    "truncated rows": ("rows.npy", truncate),
    "no rows": ("rows.npy", Path.unlink),
    "a header of garbage": ("rows.npy", lambda path: spoil(path, 0, b"garbage")),
    "rows of another type": ("rows.npy", lambda path: np.save(path, np.zeros((SOURCES, 600)))),
    "no journal": ("journal.jsonl", Path.unlink),
    "a truncated journal": ("journal.jsonl", lambda path: os.truncate(path, path.stat().st_size - 50)),
    "a torn line": ("journal.jsonl", lambda path: os.truncate(path, path.stat().st_size - 9)),
    "damaged points": ("points.npy", lambda path: spoil(path, -3)),
    "truncated ids": ("ids.npy", truncate),
    "no sources": ("sources.npy", Path.unlink),
    "sources that are no array": ("sources.npy", lambda path: path.write_text("not an array")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_refused_by_readers_and_mended_by_writers(stored, expected, damage):
    name, spoiled = DAMAGES[damage]
    spoiled(stored.store / name)
    refused("Measure again with the same store", voxflat.open_rows, stored.store)
    np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=stored.store), expected)
    rows = voxflat.open_rows(stored.store)
    rows.verify()
    np.testing.assert_array_equal(rows.sources, expected.sources)
    assert names(stored.store) == FILES


@pytest.mark.parametrize("name", ["ids.npy", "points.npy", "sources.npy", "rows.npy"])
def test_one_flipped_bit_in_what_numpy_parses_locks_no_store(stored, expected, name):
    whole = (stored.store / name).read_bytes()
    marks = [at for at in range(10, 128) if whole[at : at + 1] in b"{}()"]
    assert len(marks) == 4
    for at in marks:
        spoil(stored.store / name, at, bytes([whole[at] ^ 1]))  # of which NumPy raises TokenError, or SyntaxError
        refused(rf"{name} is damaged .*[.] Measure again with the same store", voxflat.open_rows, stored.store)
        np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=stored.store), expected)
        assert (stored.store / name).read_bytes() == whole


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('"rows"', '"sows"', "journal.jsonl is damaged .* or delete this one"),
        ('"rows": 4', '"rows": 5', "journal.jsonl is damaged .* or delete this one"),
        (r'("row": 1, "crc32": ")\w+', r"\g<1>fffffffff", "is not complete"),
        (r'("row": 1, "crc32": ")\w+', r"\g<1>-1", "is not complete"),
    ],
)
def test_a_journal_of_other_rows_or_without_a_checksum_is_refused_by_readers(stored, before, after, message):
    journal = stored.store / "journal.jsonl"
    journal.write_text(re.sub(before, after, journal.read_text()))
    refused(message, voxflat.open_rows, stored.store)


@pytest.mark.medium
def test_rows_that_the_table_lacks_are_not_taken_for_sound(stored):
    refused("has 40 rows, but the journal lists row 40. Measure again", damaged_rows, stored.store, {0: 0, SOURCES: 0})
    assert damaged_rows(stored.store, {0: 0}) == [0]


def test_a_journal_without_its_first_line_is_refused(stored):
    spoil(stored.store / "journal.jsonl", 0, b"garbage")
    before = (stored.store / "rows.npy").read_bytes()
    message = r"journal.jsonl is not a journal of these distance rows.* or delete this store"
    refused(message, SURFACE.geodesic, SOURCES, store=stored.store)
    assert (stored.store / "rows.npy").read_bytes() == before
    refused(r"journal.jsonl is damaged .* or delete this one", voxflat.open_rows, stored.store)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "store.json is damaged"),
        ("[]", "store.json is damaged"),
        ('{"format": "voxflat rows 2"}', r"store.json is damaged \(it is not complete\)"),
        ('{"format": "voxflat rows 1"}', "format 'voxflat rows 1', but this version .* reads 'voxflat rows 2'"),
    ],
)
def test_a_bad_description_is_refused(stored, text, message):
    (stored.store / "store.json").write_text(text)
    for use in (voxflat.open_rows, lambda path: SURFACE.geodesic(SOURCES, store=path)):
        refused(message + r".*[.] Choose another directory, or delete this one", use, stored.store)


# -------------------------------------------------------------------------------------------- what is refused


def test_a_store_of_other_rows_is_refused_and_left_alone(stored):
    before = {name: (stored.store / name).read_bytes() for name in FILES if name != "lock"}
    hole = SHEET.copy()
    hole[0, 0] = 0
    mesh = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    for surface, sources, options, message in [
        (SHEET, SOURCES, {"geodesic": "chain"}, "its geodesic is 'graph', not 'chain'"),
        (SHEET, SOURCES + 1, {}, "its sources differ (40 sources instead of 41)"),
        (SHEET, SOURCES, {"sampling": "random"}, "its sources differ"),
        (SHEET, SOURCES, {"spacing": (1, 1, 2)}, "its surface differs"),
        (hole, SOURCES, {}, "its surface differs (600 points instead of 599)"),
        (mesh, 2, {}, "its surface differs (600 points instead of 4)"),
    ]:
        message = re.escape(f"contains other distances: {message}")
        refused(message, composed.geodesic, surface, sources, store=stored.store, **options)
    assert before == {name: (stored.store / name).read_bytes() for name in before}


def test_the_same_points_under_other_triangles_are_told_apart(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
    one, other = (
        voxflat.surface((points, np.array(faces))) for faces in ([[0, 1, 2], [1, 3, 2]], [[0, 1, 3], [0, 3, 2]])
    )
    one.geodesic([0, 3], store=tmp_path / "store")
    refused("its surface has different triangles", other.geodesic, [0, 3], store=tmp_path / "store")


def test_other_directories_and_files_are_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("much work")
    (tmp_path / "file").write_text("a file")
    other = r"is not a store, but contains files \(chapter.tex\). Pass a new, empty directory"
    for name, message in (("thesis", other), ("file", "is a file. Pass a directory")):
        refused(message, SURFACE.geodesic, SOURCES, store=tmp_path / name)
        refused("not a store", voxflat.open_rows, tmp_path / name)
    for name in ("missing/store", "file/store"):
        with pytest.raises(OSError, match=name.split("/")[0]):
            SURFACE.geodesic(SOURCES, store=tmp_path / name)
    assert names(tmp_path) == ["file", "thesis"]
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "much work"
    for store in ("", 5):
        refused("Pass a path to a file or directory", SURFACE.geodesic, SOURCES, store=store)


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="root may write everywhere")
def test_a_directory_that_is_not_writable_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError, match="store"):
        SURFACE.geodesic(SOURCES, store=tmp_path / "store")


@pytest.mark.medium
def test_a_store_in_use_is_refused(stored):
    with (stored.store / "lock").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(BlockingIOError, match=f"by process {os.getpid()}. Wait until that process ends") as told:
            SURFACE.geodesic(SOURCES, store=stored.store)
    assert told.value.filename == str(stored.store)
    SURFACE.geodesic(SOURCES, store=stored.store)  # a lock file that nobody holds is stale


def test_too_little_memory_is_refused_with_numbers(tmp_path):
    message = r"[\d.]+ \S+ of memory is needed, but the limit is 1000 bytes"
    refused(message, SURFACE.geodesic, SOURCES, store=tmp_path / "store", memory_limit=1000)
    message = r"MiB of memory is needed, but the limit is 976.6 KiB. .* pass store"
    refused(message, voxflat.surface(square(24)).geodesic, 600, memory_limit=1_000_000)
    assert names(tmp_path) == []


def test_too_little_room_on_the_disk_is_refused_with_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(_store.shutil, "disk_usage", lambda path: type("Usage", (), {"free": 1024}))
    with pytest.raises(OSError, match=r"93.75 KiB of disk space is needed, but only 1 KiB is free. Free some.*store"):
        SURFACE.geodesic(SOURCES, store=tmp_path / "store")
    assert names(tmp_path) == []


def test_a_complete_store_needs_no_room(stored, expected, monkeypatch, log):
    log.clear()
    monkeypatch.setattr(_store.shutil, "disk_usage", lambda path: type("Usage", (), {"free": 0}))
    np.testing.assert_array_equal(SURFACE.geodesic(SOURCES, store=stored.store), expected)
    assert f"{SOURCES} rows were already in the store" in log.text  # none was measured again


# ------------------------------------------------------------------------------------------- command line


def test_the_command_measures_and_goes_on(tmp_path):
    np.save(tmp_path / "sheet.npy", shapes.sheet((30, 20)))
    where = ("--spacing", "1,1,2", "--store", tmp_path / "store")
    command = ["rows", tmp_path / "sheet.npy", "--sources", SOURCES, *where]
    result = succeed(*command)
    assert result.stdout == f"40 x 600 distances in mm, 0 MiB\nsaved in {tmp_path / 'store'}\n"
    assert f"voxflat: up to 93.75 KiB of disk space will be used in {tmp_path / 'store'}" in result.stderr
    expected = voxflat.surface(tmp_path / "sheet.npy", spacing=(1, 1, 2)).geodesic(SOURCES)
    np.testing.assert_array_equal(voxflat.open_rows(tmp_path / "store"), expected)
    again = run(*command, "--json")
    told = json.loads(again.stdout)
    assert portable(told.pop("provenance")) == voxflat.open_rows(tmp_path / "store").provenance
    assert told == {"store": str(tmp_path / "store"), "shape": [40, 600], "bytes": 96000, "unit": "mm"}
    assert "40 rows were already in the store" in again.stderr
    assert run(*command, "--quiet").output == ""
    fail(1, "contains other distances", *command, "--radius", 9, "--seed-point", "9,9,1")


def test_flatten_keeps_its_rows(tmp_path):
    np.save(tmp_path / "sheet.npy", SHEET)
    succeed("flatten", tmp_path / "sheet.npy", "-o", tmp_path / "map.npz", "--sources", 20, "--store", tmp_path / "s")
    rows = voxflat.open_rows(tmp_path / "s")
    assert (rows.shape, rows.unit) == ((20, 600), "mm")
