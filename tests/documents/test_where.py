"""The pages for developers name files and functions that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLACES = [ROOT, ROOT / "plugin/voxflat", ROOT / "rust/core/src"]
QUOTED = re.compile(r"`([^`\n]+)`")


def quoted(line):
    """Return the existing files of the paths that a line quotes, the paths without a file, and the other quotations."""
    words = QUOTED.findall(line)
    paths = [word for word in words if re.fullmatch(r"[\w./-]+(/|\.py|\.rs|\.toml|\.md)", word)]
    files = {path: [place / path for place in PLACES if (place / path).exists()] for path in paths}
    missing = [path for path in paths if not files[path]]
    return [file for path in paths for file in files[path]], missing, [word for word in words if word not in paths]


@pytest.mark.parametrize("page", ["where-is-what.md", "concepts.md"])
def test_each_path_exists(page):
    lines = (ROOT / "docs" / page).read_text(encoding="utf-8").splitlines()
    assert [missing for line in lines for missing in quoted(line)[1]] == []


def test_each_name_is_defined_in_a_file_of_its_line():
    lines = (ROOT / "docs/where-is-what.md").read_text(encoding="utf-8").splitlines()
    tables = [line for line in lines if line.startswith("|")]
    undefined = []
    for line in tables:
        files, _, names = quoted(line)
        texts = [file.read_text(encoding="utf-8") for file in files if file.is_file()]
        for name in names:
            definition = rf"(?:def|class|fn) {name}\b|^{name}\b.* = |\b{name}: "
            if "." not in name and not any(re.search(definition, text, re.MULTILINE) for text in texts):
                undefined.append(name)
    assert undefined == []
    assert len(tables) > 20
