"""The how-to guides contain only valid commands, and Python code that compiles."""

import re
import shlex

import click
import how_to
import pytest

from voxflat import cli

PAGES = sorted(path.stem for path in how_to.HOW_TO.glob("*.md"))


def parsed(command):
    """Parse a command with all options, choices and numbers; its files need not exist."""
    name, *words = shlex.split(command, comments=True)
    with click.Context(cli.main, info_name="voxflat") as parent:
        command = cli.main.get_command(parent, name)
        if isinstance(command, click.Group):
            name, *words = words
            command = command.commands[name]
        command.make_context(name, words, parent)


@pytest.mark.parametrize("page", PAGES)
def test_commands_are_taken_and_python_compiles(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = how_to.text(page)
    for name in re.findall(r"[\w.]+\.txt", text):  # lists of vertices are read during parsing
        (tmp_path / name).write_text("1\n2\n3\n")
    inline = [found for found in re.findall(r"`voxflat ([^`]+ [^`]+)`", text) if "..." not in found]
    for command in [*how_to.commands(text), *inline]:
        try:
            parsed(command)
        except click.MissingParameter:
            assert command in inline, command  # a command within a sentence may be shortened
    for code in how_to.blocks(text, "python"):
        compile(code, page, "exec")
    assert text.startswith("# ")
    assert page == "index" or len(text.split()) <= 450


def test_every_page_and_command_has_its_place():
    listed = re.findall(r"^([a-z-]+)$", re.sub(r"^[`:].*$", "", how_to.text("index"), flags=re.MULTILINE), re.MULTILINE)
    assert sorted([*listed, "index"]) == PAGES
    shown = {command.split()[0] for page in PAGES for command in how_to.commands(how_to.text(page))}
    assert shown == set(cli.main.commands) - {"demo", "info"}


def test_a_command_that_voxflat_does_not_take_is_found():
    for wrong in ("flatten a.ply --no-such-option -o b.npz", "flatten a.ply --repair never -o b.npz", "flatten a.ply"):
        with pytest.raises(click.UsageError):
            parsed(wrong)
