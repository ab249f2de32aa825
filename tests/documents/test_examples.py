"""Every public class and method is on the site, passes the checks of numpydoc, and has a working example."""

import doctest
import importlib
import inspect
import operator
import re
from pathlib import Path

import numpy as np
import pytest
from numpydoc.validate import validate
from public_names import NAMES, public

import voxflat
from voxflat.io.saved import Saved

pv = pytest.importorskip("pyvista")
pytest.importorskip("nilearn")

OF_CLASSES = {"ES01", "EX01", "SA01"}
"""Checks for an extended summary, examples and See Also: of classes and functions only."""

PUBLIC = public()


@pytest.mark.medium
@pytest.mark.parametrize("name", PUBLIC)
def test_the_docstring_passes_all_checks_of_numpydoc(name):
    is_method = "." in PUBLIC[name].__qualname__  # its class says more, and leads on
    assert [error for error in validate(name)["errors"] if not (is_method and error[0] in OF_CLASSES)] == []


def test_the_documentation_of_save_names_every_ending_that_it_writes():
    things = [getattr(importlib.import_module(module), name) for module, names in NAMES.items() for name in names]
    saved = [thing for thing in things if isinstance(thing, type) and issubclass(thing, Saved) and thing._endings]
    assert len(saved) >= 7
    for kind in saved:
        assert [ending for ending in kind._endings if f"``{ending}``" not in kind.save.__doc__] == []
        assert inspect.signature(kind.save) == inspect.signature(voxflat.FlatMap.save)


def test_the_reference_lists_every_public_name():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "python" / "index.rst").read_text()
    listed, module = set(), ""
    for line in page.splitlines():
        module = line.removeprefix(".. currentmodule:: ") if line.startswith(".. currentmodule") else module
        if re.fullmatch(r" {3}[\w.]+", line):
            listed.add(f"{module}.{line.strip()}")
    things = {f"{module}.{name}" for module, names in NAMES.items() for name in names}
    assert listed == {name for name in things if callable(operator.attrgetter(name.removeprefix("voxflat."))(voxflat))}


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLIC)
def test_the_example_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pv, "OFF_SCREEN", True)
    known = {"np": np, "pv": pv, "voxflat": voxflat}
    test = doctest.DocTestParser().get_doctest(inspect.getdoc(PUBLIC[name]), known, name, None, None)
    told = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=told.append)
    assert "".join(told) == ""
