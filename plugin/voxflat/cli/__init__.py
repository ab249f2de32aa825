"""Define the command line; `program` collects the commands, which are defined in one module each.

`options` defines the options that several commands share, and `parameter_options` builds options from Python
parameters. `input` creates the surface that a command processes, `output` checks output files, and `console` shows
progress and errors.
"""

from voxflat.cli.program import main

__all__ = ["main"]
