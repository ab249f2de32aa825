"""The command `voxflat worst`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import FILE
from voxflat.cli.output import FIGURE_ENDINGS, check_output, print_json
from voxflat.cli.parameter_options import option_of
from voxflat.io.reading import reading
from voxflat.maps.flat_map import load
from voxflat.maps.worst_places import WORST_ENDINGS
from voxflat.maps.worst_search import worst_places


@cloup.command(
    "worst",
    epilog="""\b
Examples:
  voxflat worst map.npz
  voxflat worst map.npz --beyond 2 --parcels lh.aparc.annot -o worst.tsv --figure worst.png
  voxflat worst map.npz --place 1 --save-cuts cuts.json
  voxflat flatten lh.white --pial lh.pial --cuts cuts.json -o relieved.npz
""",
)
@cloup.argument("map_", metavar="MAP", type=FILE)
@options.section(
    "Regions",
    option_of(worst_places, "count", type=click.IntRange(min=0), metavar="N"),
    option_of(
        worst_places,
        "beyond",
        type=float,
        metavar="FACTOR",
        help="List regions whose areas change by more than this factor.",
    ),
    options.reads("--parcels", "Name the regions after these parcels (.annot, .label.gii, .dlabel.nii or a volume)."),
    options.reads("--table", "Names of the parcels, in the format of FreeSurferColorLUT.txt or a BIDS dseg.tsv."),
)
@options.output(
    "Write the list of regions to this file: .json, or .tsv with one row per region.",
    options.writes(
        "--save-cuts",
        "Write the cuts of the map and the suggested cuts (.json), for --cuts of voxflat flatten.",
        "cuts_file",
    ),
    options.value(
        "--place", "N", "Save only the cut of region N; may be repeated.", "numbers", type=int, multiple=True
    ),
    options.writes("--figure", "Draw the regions on the map (.png, .svg or .pdf)."),
    options.writes("--picture", "Draw the regions on the surface, from both sides.", metavar="PNG"),
    required=False,
)
@options.run(options.threads)
def command(
    map_: Path,
    output: Path | None,
    cuts_file: Path | None,
    numbers: tuple[int, ...],
    figure: Path | None,
    picture: Path | None,
    writing: dict[str, Any],
    as_json: bool,
    **given: Any,
) -> None:
    """List the regions of highest area distortion.

    MAP is a file written by voxflat flatten. Regions are ranked by their area times its change, at the scale that
    preserves the total area. For each region, a cut is suggested that runs from the border through the region. Its gain
    is the decrease of the relative distance error of a coarse preview map of the default method, in percentage points.
    The gain can be negative, since a cut that reduces area distortion may increase distance errors.
    """
    if numbers and cuts_file is None:
        raise click.UsageError("--place requires --save-cuts.")
    if given["table"] is not None and given["parcels"] is None:
        raise click.UsageError("--table requires --parcels.")
    files = {output: WORST_ENDINGS, cuts_file: (".json",), figure: FIGURE_ENDINGS, picture: (".png",)}
    for file, endings in files.items():
        if file is not None:
            check_output(file, endings, **writing)
    with bars() as shown, reading() as read:
        worst = worst_places(load(map_), **given, progress=shown.progress)
        worst = worst._with_provenance({**worst.provenance, "files": read})
    saved = [file for file in files if file is not None]
    if output is not None:
        worst.save(output, **writing)
    if cuts_file is not None:
        worst.save_cuts(cuts_file, *numbers, **writing)
    if figure is not None or picture is not None:
        from voxflat import figures  # imports matplotlib

        if figure is not None:
            figures.save(figures.worst_places(worst), figure, worst.provenance)
        if picture is not None:
            figures.save_picture(figures.worst_places_3d(worst), picture, worst.provenance)
    if as_json:
        print_json({**worst.figures(), "files": [str(file) for file in saved], "provenance": worst.provenance})
    else:
        click.echo("\n".join([worst.table(), *(f"saved as {file}" for file in saved)]))
