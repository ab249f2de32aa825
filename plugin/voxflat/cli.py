"""The command line: `voxflat flatten`, `check`, `surface`, `measure`, `rows`, `image` and `demo`.

Exit status: 0 success; 1 the input cannot be used, the work failed or was cancelled, or `check` says no; 2 wrong usage.
"""

from __future__ import annotations

import json
import logging
import re
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np
from tqdm import tqdm

import voxflat
from voxflat._errors import Cancelled, InputError
from voxflat._prepare import Progress, log
from voxflat.flatmap import MAP_ENDINGS, FlatMap, json_ready
from voxflat.io import write_volume

__all__ = ["main"]

_Command = TypeVar("_Command", bound=Callable[..., Any])

_DEBUG = "voxflat.debug"


# ------------------------------------------------------------------------------------ errors, exit status


class _Failure(click.ClickException):
    """Ends the program with one line on stderr and exit status 1."""

    def show(self, file: Any = None) -> None:
        click.echo(f"voxflat: {self.message}", file=file, err=True)


class _Program(click.Group):
    """A group of commands that turns whatever goes wrong into a `_Failure`."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise  # click deals with these
        except (KeyboardInterrupt, Cancelled):
            raise _Failure("cancelled") from None
        except Exception as error:
            if ctx.meta.get(_DEBUG):
                traceback.print_exc()
            raise _Failure(f"error: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    if isinstance(error, voxflat.VoxflatError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "memory ran out; take a smaller patch or fewer sources"
    elif isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    else:
        text = f"{type(error).__name__}: {error} (not foreseen: please report it with the output of --debug)"
    return " ".join(text.split())


# ---------------------------------------------------------------------------------------------- options


def _three(kind: type[int] | type[float], example: str) -> Callable[..., tuple[float, ...] | None]:
    """Return a callback that takes an option's text as three numbers between commas."""

    def convert(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[float, ...] | None:
        try:
            numbers = None if value is None else tuple(kind(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if numbers is not None and len(numbers) != 3:
            raise click.BadParameter(f"{value!r} must be three numbers between commas, like {example}.")
        return numbers

    return convert


def _bytes(ctx: click.Context, param: click.Parameter, value: str | None) -> int | None:
    """Take an option's text as an amount of memory."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?) *([KMGT]?)(?:iB|B)?", value, re.IGNORECASE)
    if match is None:
        raise click.BadParameter(
            f"{value!r} is no amount of memory; give bytes, or a number with K, M, G or T, like 4G."
        )
    return int(float(match[1]) * 1024 ** " KMGT".index(match[2].upper() or " "))


def _place(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[int, ...] | int | None:
    """Take an option's text as voxel indices, or as the number of a vertex."""
    if value is not None and "," not in value:
        try:
            return int(value)
        except ValueError:
            raise click.BadParameter(f"{value!r} must be I,J,K, or the number of a vertex.") from None
    indices = _three(int, "136,112,127")(ctx, param, value)
    return None if indices is None else tuple(int(index) for index in indices)


def _paths(ctx: click.Context, param: click.Parameter, value: tuple[Path, ...]) -> list[Any] | None:
    """Take files of vertex lists as cuts: in each line a vertex number, or three voxel indices."""
    if not value:
        return None
    paths = []
    for file in value:
        try:
            path = np.loadtxt(file, dtype=np.int64, ndmin=1)
        except (OSError, ValueError) as error:
            raise click.BadParameter(f"{file} is no list of vertices: {error}") from None
        paths.append(path)
    return paths


def _set_debug(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    ctx.meta[_DEBUG] = value


_FILE = click.Path(path_type=Path)

_input = click.argument("input_", metavar="INPUT", type=_FILE)
_debug = click.option(
    "--debug", is_flag=True, expose_value=False, callback=_set_debug, help="Show where in the program an error arose."
)
_as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object to stdout instead of text.")


def _selection(command: _Command) -> _Command:
    """Add the options that say what is flattened."""
    options = [
        click.option("--label", type=int, help="Foreground is this label.  [default: the only one]"),
        click.option("--threshold", type=float, help="Foreground is what is greater, in the input's unit."),
        click.option(
            "--keep",
            type=_FILE,
            metavar="MASK",
            help="Flatten only this: a volume that is not 0 there; for meshes a label, patch or GIFTI file.",
        ),
        click.option(
            "--drop", type=_FILE, metavar="MASK", help="Leave this out, such as the medial wall; as for --keep."
        ),
        click.option(
            "--seed-point",
            metavar="I,J,K|V",
            callback=_place,
            help="Flatten a disk around this voxel (indices), or around this vertex of a mesh; counted from 0.",
        ),
        click.option("--radius", type=float, metavar="MM", help="Radius of that disk, mm along the surface."),
        click.option(
            "--cut",
            "cuts",
            type=_FILE,
            metavar="FILE",
            multiple=True,
            callback=_paths,
            help="Cut along the neighbouring vertices listed in this file; may be given again.",
        ),
        click.option(
            "--spacing",
            metavar="X,Y,Z",
            callback=_three(float, "0.5,0.5,0.5"),
            help="Voxel size in mm, for files that hold none (.npy).  [default: 1,1,1]",
        ),
        click.option(
            "--memory-limit",
            metavar="SIZE",
            callback=_bytes,
            help="Refuse to start what may need more memory, in bytes or like 4G.  [default: what is free]",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def _making(command: _Command) -> _Command:
    """Add the options that say how a surface is made."""
    options = [
        click.option(
            "--pial", type=_FILE, metavar="MESH", help="Where INPUT is a white surface: measure midway to this."
        ),
        click.option("--probability", type=_FILE, metavar="V", help="For volumes: an image whose 0.5 is the surface."),
        click.option(
            "--repair",
            type=click.Choice(["voxels", "cuts"]),
            help="Rid the surface of handles by changing the fewest voxels, or by cutting them open.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def _store(required: bool) -> Callable[[_Command], _Command]:
    """Return the option that names a store of distance rows."""
    return click.option(
        "--store",
        type=_FILE,
        metavar="DIR",
        required=required,
        help="Keep the distances from all sources in this directory, new or of an interrupted run, which is resumed.",
    )


# ------------------------------------------------------------------------------------------ the commands


@click.group(
    cls=_Program,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog="A first try: voxflat demo.  Help on a command: voxflat flatten --help.",
)
@click.version_option(voxflat.__version__, message="voxflat %(version)s")
def main() -> None:
    """Flatten curved surfaces, above all the cortex, into the plane while keeping geodesic distances."""


@main.command(
    epilog="""\b
Examples:
  voxflat flatten labels.nii.gz --label 3 -o map.npz
  voxflat flatten wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45 -o map.npz
  voxflat flatten mask.npy --spacing 0.5,0.5,0.5 --keep patch.npy --json -o map.npz
  voxflat flatten lh.white --pial lh.pial --drop lh.Medial_wall.label -o lh.flat.surf.gii
  voxflat flatten lh.midthickness.surf.gii --keep lh.cortex.patch.3d -o lh.cortex.patch.flat
"""
)
@_input
@click.option(
    "-o",
    "--output",
    type=_FILE,
    required=True,
    metavar="OUT",
    help="The map's file: .npz holds everything; .surf.gii, .patch.flat, .vtp, .ply and .obj the flat surface.",
)
@click.option(
    "--method",
    type=click.Choice(["voxflat", "grossmann2002"]),
    default="voxflat",
    help="Over the triangles of a surface, or after the paper over the voxels of a volume.",
)
@_making
@_selection
@click.option(
    "--sources",
    type=int,
    metavar="N",
    help="How many points distances are measured from.  [default: 400; grossmann2002: 1000]",
)
@click.option(
    "--sampling",
    type=click.Choice(["farthest", "random"]),
    default="farthest",
    help="How sources are chosen: evenly, each farthest from the others, or at random.",
)
@click.option(
    "--link-lengths",
    type=click.Choice(["chain-code", "euclidean"]),
    help="grossmann2002: the unbiased estimator, or 1, √2, √3 voxels for comparison.  [default: chain-code]",
)
@click.option("--seed", type=int, default=0, help="Seed of every random choice; the same seed gives the same map.")
@click.option("--threads", type=int, metavar="N", help="Threads that work.  [default: one a core]")
@click.option("--keep-rows", is_flag=True, help="Store the distances from all sources to all points, too (large).")
@_store(required=False)
@_as_json
@click.option("--quiet", is_flag=True, help="Show neither progress nor a summary.")
@_debug
def flatten(input_: Path, output: Path, as_json: bool, quiet: bool, **options: Any) -> None:
    """Flatten a surface.

    INPUT is a label or intensity volume (.nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd, .mgh, .mgz, .npy, .npz), or a mesh
    (.surf.gii, FreeSurfer geometry such as lh.white, .vtk, .vtp, .ply, .stl, .obj). Without --label and --threshold a
    volume must have a single label. Without a patch the largest component is flattened; what is no disk is cut open,
    and that is said.
    """
    _check_output(output, MAP_ENDINGS, (input_, options["keep"], options["drop"]))
    making = {name: options.pop(name) for name in ("pial", "probability", "repair")}
    with _bars(quiet) as bars:
        source: Any = input_
        if any(making.values()):
            if options["method"] != "voxflat":
                raise InputError("--pial, --probability and --repair are for the method voxflat; leave them out")
            place = {name: options.pop(name) for name in ("label", "threshold", "spacing")}
            source = _surface(input_, making, place, options, bars)
        flat_map = voxflat.flatten(source, progress=bars.progress, **options)
    flat_map.save(output)
    if as_json:
        _print_json({"output": str(output), **flat_map.description()})
    elif not quiet:
        click.echo(_summary(flat_map, output))


def _surface(input_: Path, making: dict[str, Any], place: dict[str, Any], options: dict[str, Any], bars: Any) -> Any:
    making = {**making, "repair": making["repair"] or False}
    limit = options.get("memory_limit")
    return voxflat.surface(input_, **making, **place, memory_limit=limit, progress=bars.progress)


@main.command(
    epilog="""\b
Examples:
  voxflat check labels.nii.gz
  voxflat check wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45
"""
)
@_input
@_selection
@_as_json
@_debug
def check(input_: Path, as_json: bool, **options: Any) -> None:
    """Say whether a surface can be flattened.

    It lists what INPUT, a volume or a mesh, holds: components, boundary loops, handles, defects; what each remedy would
    change; and gives advice. The exit status is 0 if its surface can be flattened, and 1 if not.
    """
    with _bars() as bars:
        findings = voxflat.check(input_, progress=bars.progress, **options)
    if as_json:
        _print_json(json_ready(asdict(findings)))
    else:
        click.echo(findings.table())
    if not findings.can_flatten:
        raise click.exceptions.Exit(1)


@main.command(
    epilog="""\b
Examples:
  voxflat surface wm.nii.gz --threshold 0.5 --repair voxels -o wm.surf.gii
  voxflat surface labels.nii.gz --label 3 --repair voxels --repaired repaired.nii.gz -o label3.vtp
"""
)
@_input
@click.option(
    "-o",
    "--output",
    type=_FILE,
    required=True,
    metavar="OUT",
    help="The surface's file: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as lh.white.",
)
@click.option("--label", type=int, help="Foreground is this label.  [default: the only one]")
@click.option("--threshold", type=float, help="Foreground is what is greater, in the input's unit.")
@_making
@click.option("--repaired", type=_FILE, metavar="FILE", help="Write the changed voxels as labels: 1 removed, 2 added.")
@_debug
def surface(
    input_: Path, output: Path, label: int | None, threshold: float | None, repaired: Path | None, **making: Any
) -> None:
    """Make the surface of a volume, or check and convert a mesh.

    Vertices are surface voxels, at places finer than the grid; nothing is interpolated.
    """
    _check_output(output, (), (input_,))
    with _bars() as bars:
        made = _surface(input_, making, {"label": label, "threshold": threshold}, {}, bars)
        for remark in made.remarks:
            log.warning(remark)
    if repaired is not None:
        if "repair" not in made.metadata:
            raise InputError(f"there are no changed voxels to write to {repaired}; give --repair voxels")
        changed = made.changed_voxels()
        write_volume(repaired, changed, made.metadata["affine"])
    made.save(output)
    click.echo(f"{len(made)} vertices, {len(made.faces)} triangles\nsaved as {output}")


@main.command(
    epilog="""\b
Examples:
  voxflat measure lh.white lh.cortex.patch.flat
  voxflat measure lh.midthickness.surf.gii lh.flat.surf.gii --json
"""
)
@click.argument("surface_", metavar="SURFACE", type=_FILE)
@click.argument("flat", metavar="FLAT", type=_FILE)
@click.option("--label", type=int, help="For volumes: foreground is this label.")
@click.option("--threshold", type=float, help="For volumes: foreground is what is greater.")
@click.option(
    "--sources", type=int, default=300, metavar="N", help="How many random points distances are measured from."
)
@click.option("--seed", type=int, default=0, help="Seed of their choice.")
@click.option("--threads", type=int, metavar="N", help="Threads that work.  [default: one a core]")
@_as_json
@_debug
def measure(surface_: Path, flat: Path, as_json: bool, **options: Any) -> None:
    """Judge a flat map of any tool.

    FLAT is a flat map of SURFACE: a FreeSurfer patch, a flat GIFTI surface, or a map that voxflat flatten made. The
    figures are defined in the documentation; distances are measured on SURFACE, cut as the map is.
    """
    with _bars() as bars:
        distortion = voxflat.measure(surface_, flat, progress=bars.progress, **options)
    if as_json:
        _print_json(distortion.figures())
    else:
        click.echo(distortion.table())


@main.command(
    epilog="""\b
Examples:
  voxflat rows wm.nii.gz --threshold 0.5 --sources 1000 --store wm.rows
  voxflat rows lh.white --pial lh.pial --sources 500 --store lh.rows --json
"""
)
@_input
@_store(required=True)
@click.option(
    "--geodesic",
    type=click.Choice(["graph", "chain"]),
    default="graph",
    help="Over the triangles of a surface, or by chain codes over the voxels of a volume.",
)
@_making
@_selection
@click.option("--sources", type=int, required=True, metavar="M", help="How many points distances are measured from.")
@click.option(
    "--sampling",
    type=click.Choice(["farthest", "random"]),
    default="farthest",
    help="How sources are chosen: evenly, each farthest from the others, or at random.",
)
@click.option(
    "--link-lengths",
    type=click.Choice(["chain-code", "euclidean"]),
    help="chain: the unbiased estimator, or 1, √2, √3 voxels for comparison.  [default: chain-code]",
)
@click.option("--seed", type=int, default=0, help="Seed of every random choice; the same seed gives the same rows.")
@click.option("--threads", type=int, metavar="N", help="Threads that work.  [default: one a core]")
@_as_json
@click.option("--quiet", is_flag=True, help="Show neither progress nor a summary.")
@_debug
def rows(input_: Path, sources: int, as_json: bool, quiet: bool, **options: Any) -> None:
    """Measure distances into a store on disk.

    DIR gets the geodesic distances from M sources to all points of a surface: rows.npy, float32, mm, which NumPy can
    map into memory, and voxflat.open_rows opens. Only a little of it is ever in memory. Give the same command again to
    resume what was interrupted.
    """
    making = {name: options.pop(name) for name in ("pial", "probability", "repair")}
    with _bars(quiet) as bars:
        source: Any = input_
        if any(making.values()):
            if options["geodesic"] != "graph":
                raise InputError("--pial, --probability and --repair are for --geodesic graph; leave them out")
            place = {name: options.pop(name) for name in ("label", "threshold", "spacing")}
            source = _surface(input_, making, place, options, bars)
        measured = voxflat.geodesic(source, sources, progress=bars.progress, **options)
    if as_json:
        _print_json({"store": str(measured.store), "shape": list(measured.shape), "bytes": measured.nbytes})
    elif not quiet:
        size = f"{measured.nbytes / 2**20:.0f} MiB"
        click.echo(f"{measured.shape[0]} x {measured.shape[1]} distances, {size}\nsaved in {measured.store}")


@main.command(
    epilog="""\b
Examples:
  voxflat image map.npz --volume t1.nii.gz --interpolation linear --depth 2 -o t1.png
  voxflat image map.npz --volume areas.nii.gz --pixel-size 0.5 -o areas.nii.gz
  voxflat image map.npz --heat-map -o distortion.png
"""
)
@click.argument("map_", metavar="MAP", type=_FILE)
@click.option("--volume", type=_FILE, metavar="V", help="The volume to show; its affine says where it lies.")
@click.option("--heat-map", is_flag=True, help="Show instead how much distances are distorted, point by point.")
@click.option(
    "-o",
    "--output",
    type=_FILE,
    required=True,
    metavar="OUT",
    help="The image's file: .png to look at; .tif, .tiff, .nii, .nii.gz (float32) or .npy to measure.",
)
@click.option("--pixel-size", type=float, metavar="MM", help="Side of a pixel, mm.  [default: half the voxel size]")
@click.option(
    "--depth",
    type=float,
    metavar="MM",
    help="How far outside the surface to sample, mm; negative is inside.  [default: 0]",
)
@click.option(
    "--interpolation",
    type=click.Choice(["linear", "nearest"]),
    help="Between voxels.  [default: nearest for whole numbers, which may be labels; linear for others]",
)
@_debug
def image(
    map_: Path,
    volume: Path | None,
    heat_map: bool,
    output: Path,
    pixel_size: float | None,
    depth: float | None,
    interpolation: str | None,
) -> None:
    """Show a volume, or the distortion, on a map.

    MAP is a file that voxflat flatten made. A PNG shows scalars in grey (1st to 99th percentile), labels in a colour
    each, and colours as they are; it is transparent outside the map. The PNG of a heat map is a figure with a colour
    bar. The other formats hold the values, NaN outside the map.
    """
    from voxflat import _picture  # brings in Pillow

    if heat_map == (volume is not None):
        raise click.UsageError("Give either --volume or --heat-map.")
    if heat_map and (interpolation or depth is not None):
        raise click.UsageError("--interpolation and --depth are for --volume.")
    _check_output(output, _picture.ENDINGS, (map_, volume))
    flat_map = voxflat.load(map_)
    if volume is None:
        picture = flat_map.heat_map(pixel_size)
    else:
        picture = flat_map.image(volume, pixel_size, depth=depth or 0.0, interpolation=interpolation)
        _check_overlap(picture.data[..., 3] > 0 if picture.is_colour else ~np.isnan(picture.data), volume)
    if heat_map and output.suffix.lower() == ".png":
        from voxflat import figures  # brings in matplotlib

        figures.save(figures.heat_map(flat_map, pixel_size), output)
    else:
        _picture.write_image(picture, output)
    height, width = picture.data.shape[:2]
    click.echo(f"{width} x {height} pixels of {picture.pixel_size:g} mm\nsaved as {output}")


@main.command()
@click.option(
    "-o",
    "--output",
    type=_FILE,
    default=Path("voxflat-demo"),
    metavar="DIR",
    help="A directory for the results; made if it is missing.",
)
@_debug
def demo(output: Path) -> None:
    """Flatten a patch of human cortex.

    The cortex is the MNI152 template, which comes with nilearn: nothing is downloaded. The map, its figures and the
    pictures of it are written to a directory.
    """
    try:
        from voxflat.demo import run

        with _bars() as bars:
            run(output, progress=bars.progress, tell=bars.tell)
    except ImportError as error:
        if error.name and error.name.startswith("voxflat"):
            raise
        raise InputError(f"the demo needs {error.name}: pip install 'voxflat[demo]'") from error


# ------------------------------------------------------------------------- what is said before and meanwhile


def _check_output(path: Path, endings: Sequence[str], inputs: Sequence[Path | None]) -> None:
    """Find out before the long work whether its result can be written."""
    if endings and not path.name.lower().endswith(tuple(endings)):
        raise InputError(f"cannot write {path}: its name must end in {' or '.join(endings)}")
    for other in inputs:
        if other is not None and path.exists() and other.exists() and path.samefile(other):
            raise InputError(f"cannot write {path}: it is an input; choose another name")
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a directory")
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}; choose another place") from error


class _Bars:
    """Progress on stderr, one bar a stage; it disappears when its stage is over."""

    def __init__(self, hidden: bool) -> None:
        # one object from the start, so that there is always one to close, wherever Ctrl-C strikes
        self._bar = tqdm(
            desc="reading",
            total=1,
            bar_format="{l_bar}{bar}| {elapsed}<{remaining}",
            leave=False,
            dynamic_ncols=True,
            file=sys.stderr,
            disable=hidden,
        )
        self._stage = ""
        self.progress: Progress | None = None if hidden else self._show
        self.close = self._bar.close

    def _show(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            self._stage = stage
            self._bar.set_description(stage, refresh=False)
            self._bar.reset(total)
        self._bar.update(done - self._bar.n)

    def tell(self, text: str) -> None:
        """Print a line where no bar is."""
        self._bar.clear()
        click.echo(text)


class _Notes(logging.Handler):
    """Print what the package logs, the memory that it needs and warnings, on stderr above the bars."""

    def emit(self, record: logging.LogRecord) -> None:
        kind = "warning: " if record.levelno >= logging.WARNING else ""
        tqdm.write(f"voxflat: {kind}{record.getMessage()}", file=sys.stderr)


@contextmanager
def _bars(quiet: bool = False) -> Iterator[_Bars]:
    bars = _Bars(hidden=quiet or not sys.stderr.isatty())
    notes = logging.NullHandler() if quiet else _Notes()
    level = log.level
    log.addHandler(notes)
    log.setLevel(logging.INFO)
    try:
        yield bars
    finally:
        log.removeHandler(notes)
        log.setLevel(level)
        bars.close()


# ------------------------------------------------------------------------------------ what is said afterwards


def _summary(flat_map: FlatMap, output: Path) -> str:
    metadata = flat_map.metadata
    width, height = np.ptp(flat_map.uv, axis=0)
    return "\n".join(
        [
            f"{'flattened':22}{metadata['points']} of {metadata['surface_points']} points, {_part(metadata)}",
            f"{'sources':22}{metadata['sources']}",
            f"{'map':22}{width:.1f} x {height:.1f} mm{_torn(metadata)}",
            f"{'memory, at most':22}{metadata['memory_need_bytes'] / 2**20:.0f} MiB",
            "",
            flat_map.distortion.table(),
            "",
            f"saved as {output}",
        ]
    )


def _torn(metadata: dict[str, Any]) -> str:
    return f", {100 * metadata['torn_faces']:.1f} % of it torn" if "torn_faces" in metadata else ""


def _part(metadata: dict[str, Any]) -> str:
    """Say which part of the surface was flattened."""
    what = "voxel" if metadata["kind"] == "voxels" else "vertex"
    parts = []
    if metadata["keep"] or metadata.get("drop"):
        parts.append("those of the mask")
    if metadata["seed_point"] is not None:
        parts.append(f"within {metadata['radius']} mm of {what} {metadata['seed_point']}")
    if parts:
        return " ".join(parts)
    return "all" if metadata["points"] == metadata["surface_points"] else "the largest component"


def _print_json(content: dict[str, Any]) -> None:
    click.echo(json.dumps(content, allow_nan=False))


def _check_overlap(covered: Any, volume: Path) -> None:
    if not covered.any():
        raise InputError(f"{volume} shows nothing on the map: it lies elsewhere; compare the affines by voxflat check")


if __name__ == "__main__":
    main(prog_name="voxflat")
