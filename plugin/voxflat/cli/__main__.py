"""Run the command line with `python -m voxflat.cli`."""

from voxflat.cli import main

main(prog_name="voxflat")
