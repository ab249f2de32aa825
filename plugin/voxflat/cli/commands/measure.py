"""The command `voxflat measure`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.options import FILE
from voxflat.cli.output import FIGURE_ENDINGS, check_output, print_json
from voxflat.cli.parameter_options import option_of
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
@options.surface_options
@options.section(
    "Measure",
    option_of(measure, "sources", type=int, metavar="N", default="300, or fewer for exact distances on large meshes"),
    option_of(
        measure,
        "reference",
        type=click.Choice(["exact", "graph"]),
        default="exact for meshes, graph for volumes",
        help='How distances on the surface are measured: "exact", or the faster "graph" (see voxflat rows --geodesic).',
    ),
    option_of(measure, "on_surface", is_flag=True, sentences=2),
)
@options.section(
    "Output",
    options.writes(
        "--heat-maps", "Also draw the distance errors and area changes of all maps side by side (.png, .pdf or .svg)."
    ),
    options.as_json,
)
@options.run(options.seed, options.threads, options.memory_limit)
def command(surface_: Path, flat: tuple[Path, ...], heat_maps: Path | None, as_json: bool, **given: Any) -> None:
    """Measure the distortion of flat maps made by any tool.

    Each FLAT is a flat map of SURFACE: a FreeSurfer patch, a flat GIFTI surface, an .obj file with texture coordinates,
    or a file written by voxflat flatten. Distances are measured in mm on SURFACE, cut as the map is. A map that voxflat
    made midway to the pial surface is measured on that geometry, and a note reports it. Several maps are measured from
    the same source points. The documentation defines all measures.
    """
    names = _short_names(flat)
    if heat_maps is not None:
        from voxflat import figures  # imports matplotlib

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
    """Return the file names of paths, or the complete paths if the names are not unique."""
    for names in ([path.name for path in paths], [str(path) for path in paths]):
        if len(set(names)) == len(names):
            return names
    raise click.UsageError("The same FLAT is given twice. Remove one of them.")
