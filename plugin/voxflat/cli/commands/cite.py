"""The command `voxflat cite`."""

from dataclasses import asdict
from pathlib import Path

import click
import cloup

from voxflat.citation.methods_text import cite
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import FILE
from voxflat.cli.output import print_json
from voxflat.maps.flat_map import load


@cloup.command(
    "cite",
    epilog="""\b
Examples:
  voxflat cite lh.npz rh.npz
  voxflat cite lh.npz rh.npz --bibtex > references.bib
""",
)
@cloup.argument("maps", metavar="[MAP]...", type=FILE, nargs=-1)
@options.section(
    "Output", cloup.option("--bibtex", is_flag=True, help="Print only the BibTeX entries."), options.as_json
)
@options.run()
def command(maps: tuple[Path, ...], bibtex: bool, as_json: bool) -> None:
    """Print a paragraph for the methods section of a paper, with references.

    Each MAP is a file that voxflat flatten wrote. The paragraph states the version of voxflat, the method, its options,
    the cuts, and the distance errors. Without MAP the paragraph is a general one with all references.
    """
    with bars():
        citation = cite(*map(load, maps))
    if as_json:
        print_json(asdict(citation))
    else:
        click.echo(citation.bibtex if bibtex else citation)
