"""The command line: `voxflat`, and a module a command."""

from voxflat.cli.program import main

__all__ = ["main"]
