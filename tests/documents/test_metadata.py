"""The files that describe voxflat to other programs agree with each other and with the package."""

import re
from pathlib import Path

import pytest

import voxflat
from voxflat.io.files import EXTRAS

yaml = pytest.importorskip("yaml")

ROOT, AUTHOR = Path(__file__).parents[2], "The voxflat developers"


def found(pattern, name):
    """Return the first match of a pattern with one group in a file."""
    return re.search(pattern, (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)[1]


FILES = ("CITATION.cff", "codemeta.json", ".zenodo.json", ".napari-hub/config.yml", "docs/packaging/recipe.yaml")
CITATION, CODEMETA, ZENODO, HUB, RECIPE = (
    yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))  # JSON is YAML as well
    for name in FILES
)


def test_every_file_has_the_version_of_the_package():
    versions = {CITATION["version"], CODEMETA["version"], RECIPE["context"]["version"]}
    versions |= {found(r'^version = "(.+?)"$', "Cargo.toml"), found(r"^## \[(\d.+?)\] - ", "CHANGELOG.md")}
    assert versions == {voxflat.__version__}


def test_every_file_has_the_same_author_and_licence():
    for authors in (CITATION["authors"], CODEMETA["author"], ZENODO["creators"], HUB["authors"]):
        assert [author["name"] for author in authors] == [AUTHOR]
    assert found(r'^authors = \[\{ name = "(.+?)" \}\]$', "pyproject.toml") == AUTHOR
    assert found(r"^Copyright \(c\) \d+, the (.+?)$", "LICENSE") in AUTHOR
    licences = {one["license"] for one in (CITATION, ZENODO, RECIPE["about"])}
    licences |= {CODEMETA["license"].rpartition("/")[2]}
    assert licences == {found(r'^license = "(.+?)"$', "pyproject.toml")}


def test_the_conda_recipe_needs_the_packages_of_the_wheel():
    needed = re.findall(r'^ *"(.+?)(>=.+?)"', found(r"^dependencies = \[\n(.*?)^\]", "pyproject.toml"), re.MULTILINE)
    names = {"matplotlib": "matplotlib-base"}
    assert RECIPE["requirements"]["run"][1:] == [f"{names.get(name, name)} {bound}" for name, bound in needed]


def test_the_extra_of_each_optional_package_is_that_of_the_project():
    table = found(r"^\[project.optional-dependencies\]\n(.*?)^\[project", "pyproject.toml")
    lists = {name: text for name, text in re.findall(r"^(\w+) = \[(.*?)\]$", table, re.MULTILINE | re.DOTALL)}
    assert set(lists) == {*EXTRAS.values(), "all"}
    named = {"itk": "itk-io", "imageio_ffmpeg": "imageio-ffmpeg", "vtkmodules": "pyvista"}  # PyVista requires VTK
    named |= {"igl": "libigl"}
    packages = {name: {named.get(one, one) for one, extra in EXTRAS.items() if extra == name} for name in lists}
    packages["pyvista"] |= {"imageio-ffmpeg"}  # is in two extras, as is xatlas
    packages["bench"] |= {"xatlas"}
    packages["all"] = {"voxflat"}
    assert {name: set(re.findall(r'"([\w-]+)[\[>]', text)) for name, text in lists.items()} == packages


def test_workflows_pin_actions_by_commit():
    files = list((ROOT / ".github").rglob("*.yml"))
    assert all(yaml.safe_load(path.read_text(encoding="utf-8")) for path in files)
    used = [one for path in files for one in re.findall(r"uses: ([^.\s]\S+)", path.read_text(encoding="utf-8"))]
    assert used
    assert all(re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", one) for one in used)
