"""The how-to guides and their commands."""

import re
from pathlib import Path

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to"


def text(*names):
    return "\n".join((HOW_TO / f"{name}.md").read_text() for name in names)


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def commands(page):
    """Return the arguments of each voxflat command in the code blocks, except for commands with shell variables."""
    return re.findall(r"^voxflat ([^$\n]*)$", "".join(blocks(page, "bash")), re.MULTILINE)
