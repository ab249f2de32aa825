"""The command `voxflat worst`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import FILE, OUT
from voxflat.cli.output import FIGURE_ENDINGS, check_output, print_json
from voxflat.cli.told import option_of
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
    "Places",
    option_of(worst_places, "count", type=click.IntRange(min=0), metavar="N"),
    option_of(worst_places, "beyond", type=float, metavar="FACTOR"),
    options.reads("--parcels", "Labels (.annot, .label.gii, .dlabel.nii, a volume) that name the places."),
    options.reads("--table", "Their names: as FreeSurferColorLUT.txt, or a dseg.tsv of BIDS."),
)
@options.output(
    "Write the places to a file: .json or .tsv, one row per place.",
    cloup.option(
        "--save-cuts",
        "cuts_file",
        type=OUT,
        metavar="FILE",
        help="Write the map's cuts and those that relieve the places (.json), for --cuts of voxflat flatten.",
    ),
    cloup.option(
        "--place", "numbers", type=int, multiple=True, metavar="N", help="Only the cut of this place; may be repeated."
    ),
    cloup.option("--figure", type=OUT, metavar="FILE", help="Draw the places on the map: .png, .svg or .pdf."),
    cloup.option("--picture", type=OUT, metavar="PNG", help="Draw them on the surface, from both sides."),
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
    """Say where a map changes areas most, and which cut would relieve each place.

    MAP is a file that voxflat flatten made. The first places are those that hold most distortion: their area times its
    change, at the scale that keeps the area of the whole. A cut leads from the border through its place. Its gain is by
    how much less a sketch of the map gets distances wrong; one that mends areas may cost some.
    """
    if numbers and cuts_file is None:
        raise click.UsageError("--place is for --save-cuts.")
    if given["table"] is not None and given["parcels"] is None:
        raise click.UsageError("--table is for --parcels.")
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
        from voxflat import figures  # brings in matplotlib

        if figure is not None:
            figures.save(figures.worst_places(worst), figure, worst.provenance)
        if picture is not None:
            figures.save_picture(figures.worst_places_3d(worst), picture, worst.provenance)
    if as_json:
        print_json({**worst.figures(), "files": [str(file) for file in saved], "provenance": worst.provenance})
    else:
        click.echo("\n".join([worst.table(), *(f"saved as {file}" for file in saved)]))
