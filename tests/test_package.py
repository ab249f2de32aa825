import ast
import subprocess
import sys
import zipfile
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import voxflat

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]


HEAVY = (
    *("napari", "qtpy", "PyQt6", "superqt", "pyvista", "vtk", "vtkmodules", "itk", "nibabel", "nilearn"),
    *("matplotlib", "PIL", "xatlas", "click", "tqdm", "dask", "distributed", "numpy", "scipy", "psutil"),
)
"""Packages that `import voxflat` must not import: front ends, and packages that only some functions need."""


def names_imported(path):
    """Yield the module and the name of each import from the package, None for the package itself."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "voxflat":
            yield from ((node.module, alias.name) for alias in node.names)
        if isinstance(node, ast.Import):
            yield from ((None, alias.name) for alias in node.names if alias.name == "voxflat")


def test_importing_voxflat_brings_in_nothing_heavy():
    code = f"import sys, voxflat; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_each_public_name_is_that_of_its_module():
    imported = [pair for pair in names_imported(Path(voxflat.__file__)) if pair[0] != "voxflat"]
    told = {(module.removeprefix("voxflat."), name) for module, name in imported}
    told -= {("_core", "__version__"), ("display", "provide")}
    assert told == {(module, name) for module, names in voxflat._MODULES.items() for name in names}
    assert {*voxflat.__all__} == {name for _, name in told} | {"__version__", "methods", "samples"}
    shown = {name for name in dir(voxflat) if not name.startswith("__")}
    assert shown | {"__version__"} == {*voxflat.__all__, "figures", "io", "vtk"}
    for module, name in told:
        assert getattr(voxflat, name) is getattr(import_module(f"voxflat.{module}"), name)
    assert issubclass(voxflat.InputError, ValueError)
    with pytest.raises(AttributeError, match="has no attribute 'flaten'"):
        voxflat.flaten  # noqa: B018


@pytest.mark.parametrize("name", ["figures", "io", "methods", "samples", "vtk"])
def test_completion_in_a_module_lists_its_public_names_alone(name):
    module = getattr(voxflat, name)
    assert dir(module) == sorted(module.__all__)
    assert all(hasattr(module, one) for one in module.__all__)


def test_inside_the_package_what_users_call_comes_from_its_own_module():
    # the import linter ignores imports from `voxflat` itself, because it does not know compiled modules
    package = Path(voxflat.__file__).parent
    modules = {"_core", *(path.stem for path in package.iterdir() if path.is_dir() or path.suffix == ".py")}
    imported = {pair for path in package.rglob("*.py") for pair in names_imported(path)}
    found = {name for module, name in imported if module in (None, "voxflat")}
    assert "_core" in found
    assert found <= modules


def test_what_scripts_of_the_docs_import_is_there():
    # also within functions, where a wrong name would be noticed only when they run
    wanted = {(path, *pair) for path in (ROOT / "docs").rglob("*.py") for pair in names_imported(path) if pair[0]}
    assert len(wanted) > 50
    for path, module, name in sorted(wanted):
        assert hasattr(import_module(module), name) or find_spec(f"{module}.{name}") is not None, path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "maturin", "build", "--release", "--quiet", "--out", out]
    subprocess.run(command, cwd=ROOT, check=True)
    (path,) = out.glob("*.whl")
    return path


def test_the_wheel_holds_what_users_need(wheel):
    assert "abi3" in wheel.name
    names = set(zipfile.ZipFile(wheel).namelist())
    wanted = {"napari.yaml", "py.typed", "_core.pyi", "_napari/__init__.py", "citation/methods_text.txt"}
    wanted |= {"citation/references.bib", "cli/__init__.py", "lab/templates/viewer.js"}
    assert names >= {f"voxflat/{name}" for name in wanted}
    assert any(name.endswith("licenses/LICENSE") for name in names)
    points = next(name for name in names if name.endswith("entry_points.txt"))
    text = zipfile.ZipFile(wheel).read(points).decode()
    for entry in ("voxflat=voxflat.cli:main", "voxflat=voxflat:napari.yaml", "voxflat=voxflat._pyvista"):
        assert entry in text.replace(" ", "")


def test_the_wheel_installs_and_flattens_with_its_base_packages_alone(wheel, tmp_path):
    # the packages of this environment serve as the index: only the wheel is new
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    code = f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r}); import numpy, voxflat; "
    code += "print(voxflat.__file__, voxflat.flatten(numpy.ones((9, 9, 1), int)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert str(tmp_path) in done.stdout
    assert "81 points" in done.stdout
