"""The command line: `program` puts together the commands, one a module.

`options` holds what several commands take, `input` makes of it what they work on, `output` says whether a result can be
written, and `console` shows progress, notes and errors.
"""

from voxflat.cli.program import main

__all__ = ["main"]
