"""The command line: `program` collects the commands, one per module.

`options` defines the options that several commands share, `parameter_options` builds options from Python parameters,
`input` makes the surface that a command works on, `output` checks output files, `console` shows progress and errors.
"""

from voxflat.cli.program import main

__all__ = ["main"]
