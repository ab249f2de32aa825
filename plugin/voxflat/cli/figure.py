"""The command `voxflat figure`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from voxflat._core import __version__
from voxflat.cli import options
from voxflat.cli.options import FILE, OUT
from voxflat.cli.output import check_output, print_json
from voxflat.io.provenance import Record, described, saving
from voxflat.io.reading import reading
from voxflat.maps.depth import LAYERINGS
from voxflat.maps.flat_map import load

FIGURE_ENDINGS = (".png", ".svg", ".pdf")


def _limits(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    if value is None:
        return None
    ends = tuple(part.strip() for part in value.split(","))
    if len(ends) != 2:
        raise click.BadParameter(f"{value!r} is no pair such as 0,5 or 2%,98%", param=parameter)
    return ends


@click.command(
    "figure",
    epilog="""\b
Examples:
  voxflat figure map.npz -o folds.png
  voxflat figure map.npz --overlay lh.thickness --range 1,4 --unit mm -o thickness.pdf
  voxflat figure map.npz --overlay zstat.nii.gz --depth 2 --above 2.3 --below -2.3 -o zstat.svg
  voxflat figure map.npz --parcels lh.aparc.annot --width 170 -o areas.svg
  voxflat figure map.npz --parcels aseg.nii.gz --table FreeSurferColorLUT.txt -o aseg.png
""",
)
@click.argument("map_", metavar="MAP", type=FILE)
@click.option(
    "--overlay", type=FILE, metavar="F", help="Data over the folds: a volume, or values at the mesh's vertices."
)
@click.option(
    "--channel", metavar="NAME|N", help="Which map of F, where it has several: its name, or its number from 0."
)
@click.option(
    "--depth",
    metavar="MM[,MM...]",
    callback=options.numbers,
    help="How far outside the surface to sample volumes, mm; of several the mean, of labels the most frequent.  "
    "[default: 0]",
)
@click.option(
    "--fraction",
    metavar="F[,F...]",
    callback=options.numbers,
    help="Instead of --depth, of maps made with --pial: how much of the cortex lies below, from 0 to 1.",
)
@click.option("--layering", type=click.Choice(LAYERINGS), help="What --fraction is of, as in voxflat image.")
@click.option("--interpolation", type=click.Choice(["linear", "nearest"]), help="As in voxflat image.")
@click.option("--above", type=float, metavar="X", help="Show data only where they are greater.")
@click.option(
    "--below",
    type=float,
    metavar="X",
    help="Show data only where they are less; with --above beyond either if X is the lesser one, else between them.",
)
@click.option(
    "--range",
    "limits",
    metavar="LO,HI",
    callback=_limits,
    help="Ends of the colours: values, or percentiles such as 2%,98%.  [default: 1%,99%; where the signs differ, the "
    "larger either way]",
)
@click.option("--cmap", metavar="NAME", help="A colour map of matplotlib.  [default: viridis, or RdBu_r about 0]")
@click.option(
    "--opacity", type=click.FloatRange(0, 1), help="Of the data, or of parcels without data.  [default: 1; 0.75]"
)
@click.option("--label", metavar="TEXT", help="What the colour bar says.  [default: the file's name]")
@click.option("--unit", metavar="TEXT", help="The unit behind it.")
@click.option(
    "--parcels",
    type=FILE,
    metavar="F",
    help="Labels (.annot, .label.gii, .dlabel.nii, a volume): borders and names, and colours where there are no data.",
)
@click.option(
    "--table", type=FILE, metavar="F", help="Their names and colours: as FreeSurferColorLUT.txt, or a dseg.tsv of BIDS."
)
@click.option(
    "--underlay",
    type=click.Choice(["curvature", "sulcal depth", "none"]),
    default="curvature",
    help="What the folds are shown by.",
)
@click.option("--title", metavar="TEXT", help="Above the map.")
@click.option(
    "--width", type=float, default=85.0, metavar="MM", help="Width on paper, mm: 85 for a column, 170 for two."
)
@click.option(
    "-o",
    "--output",
    type=OUT,
    required=True,
    metavar="OUT",
    help="The figure's file: .png, .svg (with layers) or .pdf.",
)
@options.beside
@options.as_json
@options.debug
def command(
    map_: Path,
    overlay: Path | None,
    channel: str | None,
    unit: str | None,
    output: Path,
    sidecar: bool,
    overwrite: bool,
    as_json: bool,
    **look: Any,
) -> None:
    """Draw a flat map: its folds, data over them, parcels, marks.

    MAP is a file that voxflat flatten made. Gyri are light and sulci dark; the marks are the directions of the body at
    the middle of the map, the side, a scale bar, and names of cuts, as far as these are known. Names of parcels that
    have no room are left out, and it is said how many. A PNG is 1,700 pixels wide or more. In an SVG curvature, data,
    parcels, names and marks are layers. For values without axes and marks see voxflat image.
    """
    if overlay is None:
        given = {"channel": channel, "unit": unit, "cmap": look["cmap"], "range": look["limits"]}
        given |= {name: look[name] for name in ("interpolation", "above", "below", "label")}
        unused = [f"--{name}" for name, value in given.items() if value is not None]
        if unused:
            raise click.UsageError(f"{', '.join(unused)}: only with --overlay.")
    if look["depth"] is not None and look["fraction"] is not None:
        raise click.UsageError("Give --depth or --fraction.")
    if look["layering"] is not None and look["fraction"] is None:
        raise click.UsageError("--layering is for --fraction.")
    for name in ("depth", "fraction", "layering"):
        if look[name] is None:
            del look[name]
    if look["table"] is not None and look["parcels"] is None:
        raise click.UsageError("--table is for --parcels.")
    check_output(output, FIGURE_ENDINGS, sidecar=sidecar, overwrite=overwrite)
    from voxflat import figures  # brings in matplotlib

    if unit is not None:
        look["label"] = f"{look['label'] or (overlay.name if overlay else '')} ({unit})"
    told = {"colour_map": look.pop("cmap"), **look}
    with reading() as files:
        flat_map = load(map_)
        drawn = figures.flat_map(flat_map, overlay, channel=channel, **told)
    parameters = {"flat_map": flat_map, "overlay": overlay, "channel": channel, **told}
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
