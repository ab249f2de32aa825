"""The command `voxflat cut`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import voxflat
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.output import check_output
from voxflat.errors import InputError

__all__ = ["cut"]


@click.command(
    epilog="""\b
Examples:
  voxflat cut lh.white --pial lh.pial --drop medial-wall --relax -o lh.cuts.json
  voxflat cut lh.white --drop lh.Medial_wall.label --relax-length 250 -o lh.cuts.json
  voxflat flatten lh.white --pial lh.pial --cut lh.cuts.json -o lh.flat.surf.gii
"""
)
@options.input_
@click.option(
    "-o",
    "--output",
    type=options.FILE,
    required=True,
    metavar="OUT",
    help="The cuts' file (.json), for --cut; or the cut surface's: .surf.gii, .vtp, .ply, .obj.",
)
@options.volume
@options.making
@options.region
@options.relax
@options.threads
@options.memory_limit
@options.as_json
@options.debug
def cut(input_: Path, output: Path, as_json: bool, **options: Any) -> None:
    """Cut a surface open, as voxflat flatten would.

    What is no disk becomes one; further cuts relieve the map where that pays.
    """
    from voxflat.cli.program import _print_json, _source

    if output.suffix.lower() not in (".json", ".gii", ".vtp", ".ply", ".obj"):
        raise InputError(f"cannot write {output}: its name must end in .json, .surf.gii, .vtp, .ply or .obj")
    check_output(output, (), (input_, options["keep"], options["drop"]))
    with bars() as shown:
        made = voxflat.cut(_source(input_, options, shown), progress=shown.progress, **options)
    (made if output.suffix.lower() == ".json" else made.surface).save(output)
    if as_json:
        cuts = [{"ids": cut.ids.tolist(), "length": cut.length, "reason": cut.reason} for cut in made.cuts]
        _print_json({"output": str(output), "vertices": len(made.surface), "cuts": cuts})
        return
    for number, cut in enumerate(made.cuts):
        length = "" if cut.length is None else f", {cut.length:.1f} mm"
        click.echo(f"cut {number}: {cut.reason}, {len(cut.ids)} vertices{length}")
    click.echo(f"{len(made.surface)} vertices, {len(made.surface.faces)} triangles\nsaved as {output}")
