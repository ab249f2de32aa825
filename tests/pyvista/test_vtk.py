"""VTK filters in a pipeline without PyVista classes, with VTK from PyPI and, if it is installed, from Debian."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = ROOT / "tests" / "helpers" / "vtk_pipeline.py"
DEBIAN = ROOT / ".tools" / "debian-vtk" / "bin" / "python"  # made by `make test`

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["PyPI", "Debian"])
def facts(request):
    python = sys.executable if request.param == "PyPI" else DEBIAN
    if not Path(python).exists():
        pytest.skip("Debian's VTK is not installed; `make test` installs it as root")
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "plugin")}
    done = subprocess.run([python, PROGRAM], capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr
    return {**json.loads(done.stdout.splitlines()[-1]), "stderr": done.stderr}


def test_the_arrays_are_the_accessors_bit_by_bit_and_those_of_the_input_beside_them(facts):
    assert facts["loaded by voxflat"] == []
    assert all(facts[name] for name in ("flat is the accessor's", "page is the accessor's", "image is the accessor's"))
    assert facts["elevation"]
    assert {"distance_error", "areal", "isometric", "flipped", "vertex_ids"} <= set(facts["arrays"])


def test_it_runs_when_its_input_or_an_option_has_changed_and_after_an_abort(facts):
    assert facts["runs"] == [1, 1, 1, 2, 3, 3, 3, 4, 5]
    assert facts["points after an abort"] == 0
    assert facts["points afterwards"] > 0


def test_progress_never_goes_back_and_names_the_stages(facts):
    shares = [share for share, _ in facts["progress"]]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0, 1)
    assert len({text for _, text in facts["progress"]}) > 3


def test_errors_are_events_with_their_text(facts):
    message = "seed_point: point 1000000 is not on the surface of the PolyData. Choose another point"
    assert facts["messages"] == [message]
    assert facts["points after an error"] == 0
    assert facts["misspelt"] == "FlattenSurface has no option 'raduis'. Did you mean radius?"
    assert facts["unknown"] == "FlattenSurface has no option 'treads'. Did you mean threads?"


def test_distances_keep_the_type_of_the_dataset(facts):
    of_grid, same, farthest, of_mesh = facts["geodesic"]
    assert (of_grid, of_mesh) == ("vtkStructuredGrid", "vtkPolyData")
    assert same
    assert farthest < 1e-5
