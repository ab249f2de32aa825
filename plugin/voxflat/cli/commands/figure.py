"""The command `voxflat figure`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.looks import each, of_colours, of_data, of_page, overlay_of
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.io.provenance import described, record_of, saving
from voxflat.io.reading import reading
from voxflat.maps.flat_map import load

FIGURE_ENDINGS = (".png", ".svg", ".pdf")


@cloup.command(
    "figure",
    epilog="""\b
Examples:
  voxflat figure map.npz -o folds.png
  voxflat figure map.npz --overlay lh.thickness --range 1,4 --unit mm -o thickness.pdf
  voxflat figure map.npz --overlay zstat.nii.gz --depth 2 --threshold 2.3 -o zstat.svg
  voxflat figure lh.npz rh.npz --overlay zstat.nii.gz --threshold 2.3 -o both.png
  voxflat figure lh.npz rh.npz --overlay lh.func.gii --overlay rh.func.gii -o both.png
  voxflat figure map.npz --overlay effect.nii.gz --alpha zstat.nii.gz -o effect.png
  voxflat figure map.npz --overlay angle.mgz --period 360 --strength r2.mgz --above 0.1 -o polar_angle.png
  voxflat figure map.npz --parcels lh.aparc.annot --width 170 -o areas.svg
  voxflat figure map.npz --parcels aseg.nii.gz --table FreeSurferColorLUT.txt -o aseg.png
""",
)
@cloup.argument("maps", metavar="MAP [MAP]", type=FILE, nargs=-1, required=True)
@of_data(
    options.reads(
        "--overlay",
        "Data over the folds: a volume, or values at the mesh's vertices. For two maps a file that covers both, "
        "or two files, each with its own --overlay.",
        multiple=True,
    ),
    cloup.option(
        "--channel", metavar="NAME|N", help="Which map of F, where it has several: its name, or its number from 0."
    ),
    options.period,
)
@of_colours(
    options.reads(
        "--strength",
        "Apply --threshold to this map instead of the overlay (for example t, R² or coherence).",
        multiple=True,
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
    options.reads(
        "--alpha",
        "Take the opacity of the data from this map: transparent where it is 0, opaque where its magnitude "
        "reaches its 99th percentile, or --alpha-full.",
        multiple=True,
    ),
    cloup.option("--alpha-full", type=click.FloatRange(min=0, min_open=True), metavar="X", help="See --alpha."),
)
@options.section(
    "Parcels",
    options.reads(
        "--parcels",
        "Labels (.annot, .label.gii, .dlabel.nii, a volume): borders and names, and colours where there are no data.",
        multiple=True,
    ),
    options.reads("--table", "Their names and colours: as FreeSurferColorLUT.txt, or a dseg.tsv of BIDS."),
)
@of_page(
    cloup.option(
        "--width", type=float, metavar="MM", help="Width on paper, mm.  [default: 85, a column; 170 for two maps]"
    )
)
@options.output("The figure's file: .png, .svg (with layers) or .pdf.")
@options.run()
def command(maps: tuple[Path, ...], output: Path, writing: dict[str, Any], as_json: bool, **look: Any) -> None:
    """Draw a flat map, or both hemispheres side by side: folds, data over them, parcels, marks.

    Each MAP is a file that voxflat flatten wrote; two maps share one colour scale. Gyri are light and sulci dark. The
    marks are the directions of the body at the middle of the map, the side, a scale bar, and names of cuts, as far as
    these are known. Names of parcels that have no room are left out, and the program reports how many. With --period
    the data are phases, shown in hsv or another cyclic --cmap with a colour wheel. A PNG is at least 1,700 pixels wide.
    In an SVG curvature, data, parcels, names and marks are layers. For values without axes and marks see voxflat image.
    """
    if len(maps) > 2:
        raise click.UsageError(f"{len(maps)} maps are given: give one, or both hemispheres.")
    for name in ("overlay", "strength", "parcels", "alpha"):
        if len(look[name]) > len(maps):
            raise click.UsageError(f"--{name} is given {len(look[name])} times for {len(maps)} map: give one for each.")
        look[name] = each(look[name])
    full, alpha = look.pop("alpha_full"), look.pop("alpha")
    if alpha is not None and look["opacity"] is not None:
        raise click.UsageError("Give --opacity or --alpha.")
    if alpha is None and full is not None:
        raise click.UsageError("--alpha-full is for --alpha.")
    if look["table"] is not None and look["parcels"] is None:
        raise click.UsageError("--table is for --parcels.")
    if look["strength"] is not None and look["threshold"] is look["above"] is look["below"] is None:
        raise click.UsageError("--strength is compared with --threshold, --above or --below: give one of them.")
    if alpha is not None and look["overlay"] is None:
        raise click.UsageError("--alpha is for --overlay.")
    data = overlay_of(look.pop("overlay"), look)
    check_output(output, FIGURE_ENDINGS, **writing)
    from voxflat import figures  # brings in matplotlib

    if alpha is not None:
        look["opacity"] = figures.Overlay(alpha, limits=None if full is None else (0, full))
    with reading() as files:
        loaded = [load(one) for one in maps]
        shown = loaded[0] if len(loaded) == 1 else loaded
        drawn = figures.flat_map(shown, data, **look)
    record = record_of("flat_map", described({"flat_map": shown, "overlay": data, **look}), files)
    with saving(output, record, **writing):
        figures.save(drawn, output, record)
    width, height = (round(side * drawn.dpi) for side in drawn.get_size_inches())
    if as_json:
        print_json({"output": str(output), "width": width, "height": height, "provenance": record})
    else:
        click.echo(f"saved as {output}" + (f", {width} x {height} pixels" if output.suffix.lower() == ".png" else ""))
