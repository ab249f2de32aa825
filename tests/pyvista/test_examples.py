"""The examples of the docstrings run, and what they print is what they say."""

import doctest
import importlib

import pytest

pytest.importorskip("pyvista")

MODULES = ["_pyvista.accessor", "_pyvista.blocks", "_pyvista.morphs", "_pyvista.files", "lab.map_page", "vtk"]
MODULES += [
    "pipeline.surface",
    "pipeline.cut_surface",
    "pipeline.flatten",
    "pipeline.check",
    "methods",
    "methods.voxflat",
]
MODULES += ["methods.grossmann2002", "methods.zigelman2002", "methods.schwartz1989", "methods.saucan2006"]
MODULES += ["figures.overlays"]


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_examples_of_docstrings(name):
    module = importlib.import_module(f"voxflat.{name}")
    failed, tried = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert tried > 0 or name == "_pyvista.files"  # whose examples need files
    assert failed == 0
