"""Generate the Boutiques descriptor of `voxflat bids` from the command itself.

python docs/cluster/descriptor.py > docs/cluster/voxflat.boutiques.json
"""

from __future__ import annotations

import json
import re
from typing import Any

import click

import voxflat
from voxflat.cli.commands.study import bids_command

OUTPUT = "Maps, measures and reports as BIDS derivatives."


def descriptor() -> dict[str, Any]:
    """Return the descriptor."""
    inputs = [entry(parameter) for parameter in bids_command.params if parameter.name != "help"]
    summary, _, text = (bids_command.help or "").partition("\n\n")
    return {
        "name": "voxflat bids",
        "author": "The voxflat developers",
        "description": plain(summary + " " + text),
        "tool-version": voxflat.__version__,
        "schema-version": "0.5",
        "url": "https://bids-apps.neuroimaging.io",
        "command-line": "voxflat bids " + " ".join(one["value-key"] for one in inputs),
        "container-image": {"type": "docker", "image": "voxflat", "entrypoint": False},
        "inputs": inputs,
        "output-files": [{"id": "maps", "name": "Derivatives", "description": OUTPUT, "path-template": "[OUT]"}],
        "suggested-resources": {"cpu-cores": 2, "ram": 4, "walltime-estimate": 300},
        "tags": {"domain": ["neuroinformatics", "neuroimaging"], "toolbox": "voxflat"},
    }


def entry(parameter: click.Parameter) -> dict[str, Any]:
    """Return the descriptor of an argument or option."""
    assert parameter.name
    told: dict[str, Any] = {"id": parameter.name, "name": parameter.name.replace("_", " "), "type": "String"}
    told |= {"value-key": f"[{parameter.name.upper()}]", "optional": not parameter.required}
    kind = parameter.type
    if parameter.name == "source":
        told["type"] = "File"
    if isinstance(kind, click.Choice):
        told["value-choices"] = list(kind.choices)
    if isinstance(kind, click.types.IntParamType):
        told |= {"type": "Number", "integer": True}
    if isinstance(parameter, click.Option):
        told |= {"description": plain(parameter.help or ""), "command-line-flag": parameter.opts[0]}
        if parameter.is_flag:
            told["type"] = "Flag"
        if parameter.multiple:
            told["list"] = True
    return told


def plain(text: str) -> str:
    """Return a text on one line."""
    return re.sub(r"\s+", " ", text).strip()


if __name__ == "__main__":
    print(json.dumps(descriptor(), indent=2, ensure_ascii=False))
