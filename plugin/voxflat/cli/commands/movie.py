"""The command `voxflat movie`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.cli.overlay_options import colour_section, data_section, one_or_all, overlay_of, page_section
from voxflat.io.files import require
from voxflat.io.provenance import described, record_of, saving
from voxflat.io.reading import reading
from voxflat.maps.flat_map import load

_ENDINGS = (".mp4", ".gif")


@cloup.command(
    "movie",
    epilog="""\b
Examples:
  voxflat movie map.npz --overlay bold.nii.gz --fraction 0.5 --change --range -3,3 -o bold.mp4
  voxflat movie map.npz --overlay residuals.dtseries.nii --threshold 1 --range -4,4 --unit % -o bold.mp4
  voxflat movie lh.npz rh.npz --overlay bold.dtseries.nii --range -3,3 -o both.mp4
  voxflat movie map.npz --overlay lh.bold.func.gii --time-step 2 --rate 5 --size 640 -o bold.gif
""",
)
@cloup.argument("maps", metavar="MAP [MAP]", type=FILE, nargs=-1, required=True)
@data_section(
    options.reads(
        "--overlay",
        "Series of volumes, or of values at the vertices of the mesh. For two maps, give one file that covers both or "
        "--overlay once per map.",
        required=True,
        multiple=True,
    ),
    options.flag("--change", "Show the change from the mean over time, in %, at each point."),
    options.time_step,
    interpolation="linear",
)
@colour_section(options.value("--opacity", "X", "Opacity of the data.", type=click.FloatRange(0, 1), default=1.0))
@page_section()
@options.output(
    "Output file: .mp4 (needs pip install 'voxflat[lab]'), or .gif for short movies.",
    options.value("--rate", "N", "Frames per second.", type=float, default=10.0),
    options.value("--size", "PIXELS", "Width of the movie, in pixels.", type=int, default=1280),
)
@options.run(options.quiet)
def command(
    maps: tuple[Path, ...],
    overlay: tuple[Path, ...],
    output: Path,
    writing: dict[str, Any],
    as_json: bool,
    quiet: bool,
    **look: Any,
) -> None:
    """Make a movie of a series on one or two flat maps.

    MAP is a file written by voxflat flatten. The two maps of both hemispheres are shown side by side. Each frame shows
    the data over the folds, with the time; all frames share one colour scale. Data that do not pass the threshold are
    transparent. To write the values of all frames, use voxflat image.
    """
    if len(maps) > 2 or len(overlay) > len(maps):
        raise click.UsageError("Give one map, or the maps of both hemispheres, and at most one --overlay per map.")
    data = overlay_of(one_or_all(overlay), look)
    check_output(output, _ENDINGS, **writing)
    if output.suffix.lower() == ".mp4":
        require("imageio_ffmpeg")  # before the long work
    from voxflat import figures  # imports matplotlib

    with bars(quiet) as shown:
        with reading() as files:
            loaded = [load(one) for one in maps]
            flat_map = loaded[0] if len(loaded) == 1 else loaded
            movie = figures.movie(flat_map, data, **look, progress=shown.progress)
        record = record_of("movie", described({"flat_map": flat_map, "overlay": data, **look}), files)
        with saving(output, record, **writing):
            figures.save_movie(movie, output, record, shown.progress)
    height, width = movie.size
    if as_json:
        size = {"frames": len(movie), "width": width, "height": height, "seconds": len(movie) / movie.rate}
        print_json({"output": str(output), **size, "provenance": record})
    elif not quiet:
        click.echo(
            f"{len(movie)} frames of {width} x {height} pixels, {len(movie) / movie.rate:g} s\nsaved as {output}"
        )
