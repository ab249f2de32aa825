"""Differences between systems, simulated on this one: Windows, macOS, and processes started by spawn."""

import ast
import errno
import io
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import fail
from refusals import refused

import voxflat
from voxflat import cli
from voxflat.cli import output
from voxflat.io import files, subprocess_reader
from voxflat.lab.inputs import Parameters
from voxflat.methods import Voxflat

PACKAGE = Path(voxflat.__file__).parent
SHEET = np.ones((9, 9, 1), np.uint8)


@pytest.mark.medium
def test_text_files_have_the_same_bytes_on_every_system():
    """Windows would use another encoding and other line ends."""
    wanted = {"write_text": {"encoding", "newline"}, "open": {"encoding", "newline"}, "read_text": {"encoding"}}
    seen = set()
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")}
    for file, node in ((file, node) for file, tree in trees.items() for node in ast.walk(tree)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in wanted:
            name, given = node.func.attr, {one.arg for one in node.keywords}
            first = next((str(one.value) for one in node.args if isinstance(one, ast.Constant)), "")
            if name != "open" or (first[:1] in set("wxar") and "b" not in first):
                assert given >= wanted[name] or first == "utf-8", f"{file}:{node.lineno}"
                seen.add(name)
    assert seen == set(wanted)


@pytest.mark.parametrize("encoding", ["cp932", "cp1252"])
def test_help_is_printed_to_pipes_without_greek_letters(monkeypatch, encoding):
    printed = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", printed)
    with pytest.raises(SystemExit) as done:
        cli.main(["patches", "--help"], prog_name="voxflat")
    assert done.value.code == 0
    printed.seek(0)
    text = printed.read()
    assert "θ" in text or "\\u03b8" in text


def test_a_file_that_another_program_holds_for_a_moment_is_replaced(tmp_path, monkeypatch):
    usual, asked = Path.replace, []

    def replace(one, other):
        asked.append(one)
        if len(asked) < 3:
            raise PermissionError(errno.EACCES, "used by another process")
        return usual(one, other)

    monkeypatch.setattr(Path, "replace", replace)
    monkeypatch.setattr(files, "_WAITS", (0.01, 0.01))
    with voxflat.io.atomic_path(tmp_path / "a.txt") as beside:
        beside.write_bytes(b"new")
    assert ([path.name for path in tmp_path.iterdir()], len(asked)) == (["a.txt"], 3)
    asked.clear()
    monkeypatch.setattr(files, "_WAITS", (0.01,))
    held = pytest.raises(PermissionError, match="used by another process")
    with held as told, voxflat.io.atomic_path(tmp_path / "b"):
        pass
    assert told.value.filename == str(tmp_path / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_an_open_file_that_cannot_be_deleted_hides_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "unlink", Mock(side_effect=PermissionError(errno.EACCES, "used by this process")))
    with pytest.raises(ZeroDivisionError), voxflat.io.atomic_path(tmp_path / "a.txt"):
        raise ZeroDivisionError


def test_a_broken_pipe_is_the_end_of_the_reader(monkeypatch):
    write = Mock(side_effect=OSError(errno.EINVAL, "Invalid argument"))  # the error on Windows
    monkeypatch.setattr(subprocess_reader, "_stop", lambda patience: None)
    child = SimpleNamespace(stdin=SimpleNamespace(write=write), stdout=io.BytesIO(), returncode=3221225477)
    asked = {"package": "PIL", "seconds": 5, "memory": 1 << 20}
    refused(r"Pillow ended while it read the file \(status 3221225477", subprocess_reader._answer, child, asked)


def test_limits_that_a_system_refuses_are_left_out(monkeypatch):
    resource = pytest.importorskip("resource")
    told = []

    def refuses(kind, limits):
        told.append(kind)
        if kind == resource.RLIMIT_AS:
            raise ValueError("current limit exceeds maximum limit")  # macOS

    monkeypatch.setattr(resource, "setrlimit", refuses)
    subprocess_reader._limit_addresses(1 << 30)
    assert told == [resource.RLIMIT_AS, resource.RLIMIT_CORE]
    monkeypatch.setitem(sys.modules, "resource", None)  # Windows
    subprocess_reader._limit_addresses(1 << 30)


def test_names_that_differ_in_case_are_one_file_where_the_system_says_so(tmp_path, monkeypatch):
    paths = [tmp_path / "Map.npz", tmp_path / "map.npz"]
    monkeypatch.setattr(output, "_IGNORES_CASE", False)
    assert not output._is_same(*paths)
    monkeypatch.setattr(output, "_IGNORES_CASE", True)
    assert output._is_same(*paths)
    np.save(tmp_path / "v.npy", SHEET)
    monkeypatch.chdir(tmp_path)
    words = ("surface", "v.npy", "--repair", "voxels", "--repaired", "A.vtp", "-o", "a.vtp")
    fail(1, "twice. Choose another name", *words)


def test_overlays_whose_names_differ_in_case_are_refused():
    refused("two overlays have the name Area", Parameters, overlays=("surf/{hemi}.area", "surf/{hemi}.Area"))


@pytest.mark.slow
def test_a_process_that_is_started_afresh_has_the_same_map():
    """Processes are started by spawn, as on Windows and macOS, so they inherit nothing."""
    expected = voxflat.flatten(SHEET, Voxflat(sources=20))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = pool.submit(voxflat.flatten, SHEET, Voxflat(sources=20)).result()
        again = pool.submit(np.asarray, expected.uv).result()
    np.testing.assert_array_equal(found.uv, expected.uv)
    np.testing.assert_array_equal(again, expected.uv)
