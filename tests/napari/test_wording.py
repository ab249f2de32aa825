"""Messages in the words of the window."""

import ast
import re
from pathlib import Path

import pytest
from messages import NAMES_IN_FILES, OF_PYTHON, PYTHON, messages

import voxflat._napari
from voxflat._napari.wording import _FIELDS, error_text, in_window


def test_no_message_in_the_window_has_words_of_python():
    """All texts of the package, except those of other front ends and of the scripts for Python."""
    others = ("cli", "_pyvista", "vtk.py", "_napari/scripts.py", "_napari/wording.py")
    texts, found = {one.text for one in messages()}, {}
    for one in messages():
        if one.path.startswith(others) or OF_PYTHON.search(one.text):
            continue
        text = re.sub(r"\{[^{}]*\}|%[a-z]", "7", one.text)
        text = text if one.path.startswith("_napari") else in_window(text)  # its own texts are shown as they are
        for name in NAMES_IN_FILES:
            text = text.replace(name, "")
        is_part = not one.of and any(one.text in other and one.text != other for other in texts)
        if PYTHON.search(text) and "{" not in text and not is_part:
            found[one.place] = text
    assert found == {}


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("12 %. Use relax=False to omit them", "12 %. Set Relaxation cuts to disabled to omit them"),
        ("scale. Use relax=True to add 3 cuts", "scale. Set Relaxation cuts to enabled to add 3 cuts"),
        ("automatic cuts. `voxflat check` compares the two", "automatic cuts. Check surface compares the two"),
        ("right. Pass a file, or pass the values as an array to use them anyway", "right. Pass a file"),
        ("3 handles. Pass cuts='automatic' or repair='cuts'", "3 handles. Set Cuts to automatic"),
        ("repaired 2 handle(s). Use repair='none' to keep them", "repaired 2 handle(s)."),
        ("handles. Make it with repair='voxels', or remove the handles", "handles. Remove the handles"),
        ("a fold. Pass repeat=True, or a size of 7 mm.", "a fold. Pass a size of 7 mm."),
        ("limits is (5, 1). Pass the lower one first", "limits is 5, 1. Pass the lower one first"),
        ("link_lengths does not apply to geodesic='exact'", "Links does not apply to Distances exact"),
        ("packing='shapes' requires xatlas", "packing shapes requires xatlas"),
        ("no field max_area. Increase max_area", "no field max area."),
        ("no path. Cut it, pass sources=7, or increase max_area", "no path. Cut it or set Sources to 7"),
        ("/data/max_area.nii: 'relax_it' is not a label", "/data/max_area.nii: 'relax_it' is not a label"),
    ],
)
def test_arguments_become_fields_and_remedies_of_python_are_left_out(text, shown):
    assert in_window(text) == shown


def test_errors_of_the_system_have_no_numbers_of_python():
    assert error_text(FileNotFoundError(2, "No such file or directory", "a.ply")) == "a.ply: No such file or directory"
    assert error_text(MemoryError()) == "The computation ran out of memory. Use a smaller patch or fewer sources."


def test_the_fields_in_messages_are_those_of_the_form(qapp):
    from qtpy.QtWidgets import QLabel

    from voxflat._napari.forms.options_form import OptionsForm

    form = OptionsForm()
    for name, field in form.fields.items():
        title = form.rows.labelForField(field)
        assert isinstance(title, QLabel)
        assert _FIELDS[name] == title.text()


def _shows_itself(node, names):
    """Return whether a node makes text of an exception, except for a new exception."""
    if isinstance(node, ast.Raise):
        return False
    is_text = isinstance(node, ast.FormattedValue) or (
        isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("str", "repr")
    )
    of = [node.value] if isinstance(node, ast.FormattedValue) else getattr(node, "args", [])
    if is_text and any(isinstance(one, ast.Name) and one.id in names for one in of):
        return True
    return any(_shows_itself(child, names) for child in ast.iter_child_nodes(node))


def test_only_one_function_makes_texts_of_errors():
    found = []
    for path in Path(voxflat._napari.__file__).parent.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {one.name for one in ast.walk(tree) if isinstance(one, ast.ExceptHandler) and one.name} | {"error"}
        if path.name != "wording.py" and _shows_itself(tree, names):
            found.append(path.name)
    assert found == []
