"""The command `voxflat figure`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat._core import __version__
from voxflat.cli import options
from voxflat.cli.looks import of_colours, of_data, of_page, overlay_of
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.io.provenance import Record, described, saving
from voxflat.io.reading import reading
from voxflat.maps.flat_map import load

FIGURE_ENDINGS = (".png", ".svg", ".pdf")


@cloup.command(
    "figure",
    epilog="""\b
Examples:
  voxflat figure map.npz -o folds.png
  voxflat figure map.npz --overlay lh.thickness --range 1,4 --unit mm -o thickness.pdf
  voxflat figure map.npz --overlay zstat.nii.gz --depth 2 --above 2.3 --below -2.3 -o zstat.svg
  voxflat figure map.npz --overlay angle.mgz --period 360 --strength r2.mgz --above 0.1 -o polar_angle.png
  voxflat figure map.npz --parcels lh.aparc.annot --width 170 -o areas.svg
  voxflat figure map.npz --parcels aseg.nii.gz --table FreeSurferColorLUT.txt -o aseg.png
""",
)
@cloup.argument("map_", metavar="MAP", type=FILE)
@of_data(
    cloup.option(
        "--overlay", type=FILE, metavar="F", help="Data over the folds: a volume, or values at the mesh's vertices."
    ),
    cloup.option(
        "--channel", metavar="NAME|N", help="Which map of F, where it has several: its name, or its number from 0."
    ),
    options.period,
)
@of_colours(
    cloup.option(
        "--strength",
        type=FILE,
        metavar="F",
        help="Apply --above and --below to this map instead of the overlay (for example t, R² or coherence).",
    ),
    cloup.option("--strength-channel", metavar="NAME|N", help="Which map of it, where it has several."),
    cloup.option(
        "--zero",
        type=click.Choice(["right", "top"]),
        default="right",
        help="Where the wheel of --period has phase 0: at the right, counterclockwise, or at the top, clockwise.",
    ),
    cloup.option(
        "--opacity", type=click.FloatRange(0, 1), help="Of the data, or of parcels without data.  [default: 1; 0.75]"
    ),
)
@options.section(
    "Parcels",
    cloup.option(
        "--parcels",
        type=FILE,
        metavar="F",
        help="Labels (.annot, .label.gii, .dlabel.nii, a volume): borders and names, and colours where there are no "
        "data.",
    ),
    cloup.option(
        "--table",
        type=FILE,
        metavar="F",
        help="Their names and colours: as FreeSurferColorLUT.txt, or a dseg.tsv of BIDS.",
    ),
)
@of_page(
    cloup.option(
        "--width", type=float, default=85.0, metavar="MM", help="Width on paper, mm: 85 for a column, 170 for two."
    )
)
@options.output("The figure's file: .png, .svg (with layers) or .pdf.")
@options.run()
def command(
    map_: Path,
    overlay: Path | None,
    output: Path,
    sidecar: bool,
    overwrite: bool,
    as_json: bool,
    **look: Any,
) -> None:
    """Draw a flat map: its folds, data over them, parcels, marks.

    MAP is a file that voxflat flatten made. Gyri are light and sulci dark; the marks are the directions of the body at
    the middle of the map, the side, a scale bar, and names of cuts, as far as these are known. Names of parcels that
    have no room are left out, and it is said how many. With --period data are phases, in hsv or another cyclic --cmap,
    and a wheel says which. A PNG is 1,700 pixels wide or more. In an SVG curvature, data, parcels, names and marks are
    layers. For values without axes and marks see voxflat image.
    """
    if look["table"] is not None and look["parcels"] is None:
        raise click.UsageError("--table is for --parcels.")
    if look["strength"] is not None and look["above"] is None and look["below"] is None:
        raise click.UsageError("--strength is what has to pass --above and --below; give one of them.")
    data = overlay_of(overlay, look)
    check_output(output, FIGURE_ENDINGS, sidecar=sidecar, overwrite=overwrite)
    from voxflat import figures  # brings in matplotlib

    with reading() as files:
        flat_map = load(map_)
        drawn = figures.flat_map(flat_map, data, **look)
    parameters = {"flat_map": flat_map, "overlay": data, **look}
    record: Record = {
        "voxflat": __version__,
        "function": "flat_map",
        "parameters": described(parameters),
        "files": files,
    }
    with saving(output, record, sidecar=sidecar, overwrite=overwrite):
        figures.save(drawn, output, record)
    width, height = (round(side * drawn.dpi) for side in drawn.get_size_inches())
    if as_json:
        print_json({"output": str(output), "width": width, "height": height, "provenance": record})
    else:
        click.echo(f"saved as {output}" + (f", {width} x {height} pixels" if output.suffix.lower() == ".png" else ""))
