"""The command `voxflat measure`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.options import FILE, OUT
from voxflat.cli.output import FIGURE_ENDINGS, check_output, print_json
from voxflat.cli.told import option_of
from voxflat.evaluation.measure import compare, measure


@cloup.command(
    "measure",
    epilog="""\b
Examples:
  voxflat measure lh.white lh.cortex.patch.flat
  voxflat measure lh.midthickness.surf.gii lh.flat.surf.gii --json
  voxflat measure lh.white map.npz lh.cortex.patch.flat unwrapped.obj --heat-maps maps.png
""",
)
@cloup.argument("surface_", metavar="SURFACE", type=FILE)
@cloup.argument("flat", metavar="FLAT...", type=FILE, nargs=-1, required=True)
@options.making
@options.section(
    "Measure",
    option_of(measure, "sources", type=int, metavar="N", sentences=3),
    option_of(
        measure, "reference", type=click.Choice(["exact", "graph"]), sentences=2, default="exact; graph for volumes"
    ),
    option_of(measure, "on_surface", is_flag=True),
)
@options.section(
    "Output",
    cloup.option(
        "--heat-maps", type=OUT, metavar="PNG", help="Draw the maps side by side: errors of distances, change of areas."
    ),
    options.as_json,
)
@options.run(options.seed, options.threads, options.memory_limit)
def command(surface_: Path, flat: tuple[Path, ...], heat_maps: Path | None, as_json: bool, **given: Any) -> None:
    """Judge flat maps of any tool.

    Each FLAT is a flat map of SURFACE: a FreeSurfer patch, a flat GIFTI surface, an .obj with texture coordinates, or a
    map that voxflat flatten made. The figures are defined in the documentation; distances are measured on SURFACE, cut
    as the map is, in mm; but where a map of voxflat was made on another geometry, midway to the pial surface, on that,
    and that is said. Several maps are measured from the same points.
    """
    names = _short_names(flat)
    if heat_maps is not None:
        from voxflat import figures  # brings in matplotlib

        check_output(heat_maps, FIGURE_ENDINGS)
    with bars() as shown:
        whole = surface_of(surface_, given, shown.progress)
        compared = compare(whole, dict(zip(names, flat, strict=True)), progress=shown.progress, **given)
    if heat_maps is not None:
        figures.save(figures.heat_maps(compared), heat_maps, compared.provenance)
    one = compared[names[0]] if len(names) == 1 else None
    if as_json:
        figures_of = {"maps": compared.figures()} if one is None else one.figures()
        print_json({**figures_of, "provenance": compared.provenance})
    else:
        click.echo((one or compared).table())


def _short_names(paths: Sequence[Path]) -> list[str]:
    """Return the names of files; whole paths if they are not enough to tell them apart."""
    for names in ([path.name for path in paths], [str(path) for path in paths]):
        if len(set(names)) == len(names):
            return names
    raise click.UsageError("A FLAT is given twice.")
