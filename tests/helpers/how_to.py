"""The how-to guides, and the commands that they print."""

import re
from pathlib import Path

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to"


def text(*names):
    """Return the text of pages, one after the other."""
    return "\n".join((HOW_TO / f"{name}.md").read_text() for name in names)


def blocks(page, language):
    """Return the blocks of code in this language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def commands(page):
    """Return what follows `voxflat` in each line of a block of commands that begins with it and has no variables."""
    return re.findall(r"^voxflat ([^$\n]*)$", "".join(blocks(page, "bash")), re.MULTILINE)
