"""The commands `voxflat figure` and `voxflat movie`, which draw data on flat maps."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import load_maps, parcels_of_sides
from voxflat.cli.options import FILE
from voxflat.cli.output import FIGURE_ENDINGS, check_output, report
from voxflat.cli.overlay_options import colour_section, data_section, one_or_all, overlay_of, page_section
from voxflat.io.files import require
from voxflat.io.label_tables import LABEL_FILES, are_region_files
from voxflat.io.provenance import described, record_of, saving
from voxflat.io.reading import reading

_MOVIE_ENDINGS = (".mp4", ".gif")
_EACH = "For two maps, pass one file that covers both, or pass --overlay once per map."
_DATA = f"Data to draw over the folds: a volume, or values at the vertices of the mesh. {_EACH}"
_SERIES = f"Series of volumes, or of values at the vertices of the mesh. {_EACH}"
_ZERO = "Position of phase 0 on the colour wheel of --period: right (phases run counterclockwise) or top (clockwise)."
_OPACITY = "Opacity of the data (default 1) or, without data, of the parcels (default 0.75)."
_FULL = "Magnitude of the --alpha values at which the data become opaque.  [default: their 99th percentile]"
_maps = options.map_options(cloup.argument("maps", metavar="MAP [MAP]", type=FILE, nargs=-1, required=True))


@options.command(
    "figure",
    "voxflat figure map.npz -o folds.png",
    "voxflat figure map.npz --overlay lh.thickness --range 1,4 --unit mm -o thickness.pdf",
    "voxflat figure map.npz --overlay zstat.nii.gz --depth 2 --threshold 2.3 -o zstat.svg",
    'voxflat figure lh.npz rh.npz --overlay zstat.nii.gz --depth 2 --threshold 2.3 --label "z, right hand" -o both.png',
    "voxflat figure lh.npz rh.npz --overlay lh.func.gii --overlay rh.func.gii -o both.png",
    "voxflat figure map.npz --overlay effect.nii.gz --alpha zstat.nii.gz -o effect.png",
    "voxflat figure map.npz --overlay angle.mgz --period 360 --strength r2.mgz --above 0.1 -o polar_angle.png",
    "voxflat figure map.npz --parcels lh.aparc.annot --width 170 -o areas.svg",
    "voxflat figure map.npz --parcels aseg.nii.gz --table FreeSurferColorLUT.txt -o aseg.png",
)
@_maps
@data_section(
    options.reads("--overlay", _DATA, multiple=True),
    options.value(
        "--channel", "NAME|N", "Map to draw from an overlay with several maps: its name, or its number from 0."
    ),
    options.period,
    interpolation="nearest for integers, which may be labels; linear otherwise",
)
@colour_section(
    options.reads(
        "--strength", "Data to threshold instead of the overlay (for example, t, R² or coherence).", multiple=True
    ),
    options.value(
        "--strength-channel", "NAME|N", "Map to use from the --strength file: its name or number, as for --channel."
    ),
    options.choice("--zero", ["right", "top"], _ZERO, default="right"),
    options.value("--opacity", "X", _OPACITY, type=options.SHARE),
    options.reads(
        "--alpha",
        "File of values that set the opacity of the data: transparent where a value is 0, and opaque where its "
        "magnitude reaches --alpha-full.",
        multiple=True,
    ),
    options.value("--alpha-full", "X", _FULL, type=options.POSITIVE),
)
@options.section(
    "Parcels",
    options.reads(
        "--parcels",
        f"Draw the borders and names of these parcels ({LABEL_FILES}, a volume, or regions drawn on the map as .svg or "
        ".json), and fill them with their colours if there is no overlay.",
        multiple=True,
    ),
    options.reads(
        "--table", "Names and colours of the parcels, in the format of FreeSurferColorLUT.txt or a BIDS dseg.tsv."
    ),
)
@page_section(
    options.value(
        "--width",
        "MM",
        "Width of the printed figure, in mm.  [default: 85 (one column), or 170 for two maps]",
        type=options.NUMBER,
    )
)
@options.output("Output file: .png, .pdf, or .svg (with layers).")
@options.run()
def figure_command(maps: tuple[Path, ...], output: Path, writing: dict[str, Any], **look: Any) -> None:
    """Draw a figure of one or two flat maps.

    MAP is a file written by voxflat flatten. Two maps, such as both hemispheres or the front and the back of an embryo,
    are drawn side by side at the same scale, with the same colour scale. Gyri are light and sulci are dark. The figure
    is annotated with anatomical directions at the centre of the map, the hemisphere or the name of the chart, a scale
    bar and the names of cuts, as far as these are known. A warning lists the parcel names that are omitted because they
    do not fit. With --period, the data are treated as phases and drawn with a cyclic colour map (hsv, or --cmap) and a
    colour wheel. A PNG is at least 1,700 pixels wide. In an SVG, curvature, data, parcels, names and annotations are
    separate layers. To write only the values, use voxflat image.
    """
    if len(maps) > 2:
        raise click.UsageError(f"{len(maps)} maps are given. Pass one map, or two, such as both hemispheres.")
    for name in ("overlay", "strength", "parcels", "alpha"):
        if name == "parcels" and len(look[name]) > len(maps) and are_region_files(look[name]):
            continue
        if len(look[name]) > len(maps):
            count = f"{len(look[name])} times for {len(maps)} map{'s' * (len(maps) > 1)}"
            raise click.UsageError(f"--{name} is given {count}. Pass it once per map.")
        look[name] = one_or_all(look[name])
    full, alpha = look.pop("alpha_full"), look.pop("alpha")
    if alpha is not None and look["opacity"] is not None:
        raise click.UsageError("--opacity and --alpha cannot be combined. Pass only one of them.")
    if alpha is None and full is not None:
        raise click.UsageError("--alpha-full requires --alpha.")
    if look["table"] is not None and look["parcels"] is None:
        raise click.UsageError("--table requires --parcels.")
    if look["strength"] is not None and look["threshold"] is look["above"] is look["below"] is None:
        raise click.UsageError("--strength requires a threshold. Pass --threshold, --above or --below.")
    if alpha is not None and look["overlay"] is None:
        raise click.UsageError("--alpha requires --overlay.")
    data = overlay_of(look.pop("overlay"), look)
    check_output(output, FIGURE_ENDINGS, **writing)
    from voxflat import figures  # imports matplotlib

    if alpha is not None:
        look["opacity"] = figures.Overlay(alpha, limits=None if full is None else (0, full))
    with bars() as bar, reading() as files:
        loaded = load_maps(maps, bar.progress)
        flat_map = loaded[0] if len(loaded) == 1 else loaded
        if isinstance(look["parcels"], tuple):  # several files for a map
            look["parcels"] = parcels_of_sides(look["parcels"], [one.origin.structure for one in loaded])
        drawn = figures.flat_map(flat_map, data, **look)
    record = record_of("flat_map", described({"flat_map": flat_map, "overlay": data, **look}), files)
    with saving(output, record, **writing):
        figures.save(drawn, output, record)
    width, height = drawn.canvas.get_width_height()
    size = f", {width} x {height} pixels" if output.suffix.lower() == ".png" else ""
    report({"output": str(output), "width": width, "height": height, "provenance": record}, f"saved as {output}{size}")


@options.command(
    "movie",
    "voxflat movie map.npz --overlay bold.nii.gz --fraction 0.5 --change --range -3,3 -o bold.mp4",
    "voxflat movie map.npz --overlay residuals.dtseries.nii --threshold 1 --range -4,4 --unit % -o bold.mp4",
    "voxflat movie lh.npz rh.npz --overlay bold.dtseries.nii --range -3,3 -o both.mp4",
    "voxflat movie map.npz --overlay lh.bold.func.gii --time-step 2 --rate 5 --size 640 -o bold.gif",
)
@_maps
@data_section(
    options.reads("--overlay", _SERIES, required=True, multiple=True),
    options.flag("--change", "Show the percent change from the temporal mean at each point."),
    options.time_step,
    interpolation="linear",
)
@colour_section(options.value("--opacity", "X", "Opacity of the data.", type=options.SHARE, default=1.0))
@page_section()
@options.output(
    "Output file: .mp4 (requires pip install 'voxflat[lab]'), or .gif for short movies.",
    options.value("--rate", "N", "Frames per second.", type=options.NUMBER, default=10.0),
    options.value("--size", "PIXELS", "Width of the movie, in pixels.", type=int, default=1280),
)
@options.run(options.quiet)
def movie_command(
    maps: tuple[Path, ...], overlay: tuple[Path, ...], output: Path, writing: dict[str, Any], quiet: bool, **look: Any
) -> None:
    """Make a movie of a time series on one or two flat maps.

    MAP is a file written by voxflat flatten. The maps of both hemispheres are shown side by side. Each frame shows the
    time, and the data over the folds. All frames share the same colour scale. Data that do not pass the threshold are
    transparent. To write the values of all frames, use voxflat image.
    """
    if len(maps) > 2 or len(overlay) > len(maps):
        raise click.UsageError("Pass one map, or the maps of both hemispheres, and at most one --overlay per map.")
    data = overlay_of(one_or_all(overlay), look)
    check_output(output, _MOVIE_ENDINGS, **writing)
    if output.suffix.lower() == ".mp4":
        require("imageio_ffmpeg")  # before the long work
    from voxflat import figures  # imports matplotlib

    with bars(quiet) as bar:
        with reading() as files:
            loaded = load_maps(maps, bar.progress)
            flat_map = loaded[0] if len(loaded) == 1 else loaded
            movie = figures.movie(flat_map, data, **look, progress=bar.progress)
        record = record_of("movie", described({"flat_map": flat_map, "overlay": data, **look}), files)
        with saving(output, record, **writing):
            figures.save_movie(movie, output, record, bar.progress)
    height, width = movie.size
    seconds = len(movie) / movie.rate
    size = {"frames": len(movie), "width": width, "height": height, "seconds": seconds}
    text = f"{len(movie)} frames of {width} x {height} pixels, {seconds:g} s\nsaved as {output}"
    report({"output": str(output), **size, "provenance": record}, text, quiet=quiet)
