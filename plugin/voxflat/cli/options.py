"""Options that several commands of the command line share."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np

from voxflat.cli.output import READ, WRITTEN
from voxflat.distances.geodesic import geodesic
from voxflat.methods.flatten import flatten
from voxflat.methods.options import OPTIONS
from voxflat.surfaces.standard.choice import AUTOMATIC
from voxflat.surfaces.standard.template import STANDARD
from voxflat.surfaces.voxel_graph import LINK_LENGTHS

__all__ = [
    "FILE",
    "MAKING",
    "OUT",
    "SAMPLINGS",
    "VOLUME",
    "as_json",
    "beside",
    "dask",
    "debug",
    "default_of",
    "input_",
    "link_lengths",
    "making",
    "memory_limit",
    "numbers",
    "places",
    "quiet",
    "region",
    "relax",
    "rings",
    "sampling",
    "seed",
    "sphere",
    "store",
    "telling_default",
    "threads",
    "volume",
]

_Command = TypeVar("_Command", bound=Callable[..., Any])


# ------------------------------------------------------------------------------------------- values


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


def rings(ctx: click.Context, param: click.Parameter, value: str | None) -> int | str | None:
    """Take an option's text as a number of rings, or as all."""
    if value is None or value == "all":
        return value
    try:
        return int(value)
    except ValueError:
        raise click.BadParameter(f"{value!r} must be a number of rings, or all.") from None


def _place(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[int, ...] | int | None:
    """Take an option's text as voxel indices, or as the number of a vertex."""
    if value is not None and "," not in value:
        try:
            return int(value)
        except ValueError:
            raise click.BadParameter(f"{value!r} must be I,J,K, or the number of a vertex.") from None
    indices = _three(int, "136,112,127")(ctx, param, value)
    return None if indices is None else tuple(int(index) for index in indices)


def places(ctx: click.Context, param: click.Parameter, value: tuple[str, ...]) -> list[Any]:
    """Take each of several texts as voxel indices, or as the number of a vertex."""
    return [_place(ctx, param, text) for text in value]


def _vertices(ctx: click.Context, param: click.Parameter, value: Path | None) -> Any:
    """Take a file as a list of vertices: in each line a vertex number, or three voxel indices."""
    if value is None:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty file, which the check below names
            words = np.loadtxt(value, dtype=np.str_, ndmin=1)  # as numbers, NumPy before 2.3 takes 1.5 for 1
        vertices = words.astype(np.int64)
    except (OSError, ValueError) as error:
        raise click.BadParameter(f"{value} is no list of vertices: {error}") from None
    if len(vertices) == 0:
        raise click.BadParameter(f"{value} lists no vertex.")
    return vertices if vertices.ndim == 1 or vertices.shape[1] == 3 else vertices.ravel()


def _paths(ctx: click.Context, param: click.Parameter, value: tuple[Path, ...]) -> list[Any] | Path | str | None:
    """Take files of vertex lists as cuts; a file of cuts, and a word, stay one."""
    words = {str(file) for file in value} & {STANDARD, AUTOMATIC}
    if words:
        if len(value) > 1:
            raise click.BadParameter(f"{words.pop()} says where to cut; give no other.")
        return words.pop()
    if any(file.suffix.lower() == ".json" for file in value):
        if len(value) > 1:
            raise click.BadParameter("a file of cuts or a template (.json) holds all of them; give no other.")
        return value[0]
    return [_vertices(ctx, param, file) for file in value] or None


def numbers(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[float, ...] | None:
    """Take an option's text as one number, or several between commas."""
    try:
        return None if value is None else tuple(float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} must be a number, or several between commas, like 0.25,0.5.") from None


class _File(click.Path):
    """A path that is noted in the command's context, under a key that says what for."""

    def __init__(self, key: str) -> None:
        super().__init__(path_type=Path)
        self._key = key

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = super().convert(value, param, ctx)
        if ctx is not None:
            name = param.name if param is not None and self._key == WRITTEN else path  # of what is written there is one
            ctx.meta.setdefault(self._key, {})[name] = path
        return path


# ------------------------------------------------------------------------------------------ defaults


def default_of(function: Callable[..., Any], name: str) -> Any:
    """Return the default of a function's parameter, for the option of that name."""
    return inspect.signature(function).parameters[name].default


def telling_default(option: str, help_: str) -> str:
    """Return the help on an option of `voxflat.flatten` with its default, and those of methods that have another."""
    (_, usual), *others = OPTIONS[option].items()
    told = [str(usual), *(f"{method}: {value}" for method, value in others if value != usual)]
    return f"{help_}  [default: {'; '.join(told)}]"


# ------------------------------------------------------------------------------------------ options

FILE = _File(READ)
"""The type of options and arguments that name what is read."""

OUT = _File(WRITTEN)
"""The same of what is written."""

SAMPLINGS = ("farthest", "curvature", "random")
"""How sources may be chosen on any surface."""

input_ = click.argument("input_", metavar="INPUT", type=FILE)
debug = click.option("--debug", is_flag=True, expose_value=False, help="Show where in the program an error arose.")
as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object to stdout instead of text.")
threads = click.option("--threads", type=int, metavar="N", help="Threads that work.  [default: one a core]")
dask = click.option(
    "--dask",
    metavar="ADDRESS|FILE|local",
    help="Let the workers of a Dask cluster work: the scheduler's address or its file (.json), or as many workers on "
    "this machine as it has room for.  [default: this process alone]",
)
quiet = click.option("--quiet", is_flag=True, help="Show neither progress nor a summary.")
seed = click.option(
    "--seed",
    type=int,
    default=default_of(flatten, "seed"),
    help="Seed of every random choice; the same seed gives the same result.",
)
sampling = click.option(
    "--sampling",
    type=click.Choice(SAMPLINGS),
    default=default_of(geodesic, "sampling"),
    help="How sources are chosen: evenly, each farthest from the others; closer where the surface bends; or at random.",
)
memory_limit = click.option(
    "--memory-limit",
    metavar="SIZE",
    callback=_bytes,
    help="Refuse to start what may need more memory, in bytes or like 4G.  [default: what is free]",
)


def group(*options: Callable[[_Command], _Command]) -> Callable[[_Command], _Command]:
    """Return several options as one decorator."""

    def decorate(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


beside = group(
    click.option(
        "--sidecar", is_flag=True, help="Write what made OUT beside it, as OUT.json: for formats that cannot hold it."
    ),
    click.option("--overwrite", is_flag=True, help="Replace files beside OUT that voxflat did not write."),
)
"""What is written beside the result."""

VOLUME = ("label", "threshold", "spacing")
"""Names of the options of `volume`."""

volume = group(
    click.option("--label", type=int, help="Foreground is this label.  [default: the only one]"),
    click.option("--threshold", type=float, help="Foreground is what is greater, in the input's unit."),
    click.option(
        "--spacing",
        metavar="X,Y,Z",
        callback=_three(float, "0.5,0.5,0.5"),
        help="Voxel size in mm, for files that hold none (.npy).  [default: 1,1,1]",
    ),
)
"""What of a volume is foreground, and where it lies."""

MAKING = ("pial", "probability", "repair")
"""Names of the options of `making`."""

making = group(
    click.option("--pial", type=FILE, metavar="MESH", help="Where INPUT is a white surface: measure midway to this."),
    click.option("--probability", type=FILE, metavar="V", help="For volumes: an image whose 0.5 is the surface."),
    click.option(
        "--repair",
        type=click.Choice(["none", "voxels", "cuts"]),
        help="Rid the surface of handles by changing the fewest voxels, or by cutting them open; or change nothing: "
        "what would be mended of a mesh is refused then.",
    ),
)
"""How a surface is made."""

region = group(
    click.option(
        "--keep",
        type=FILE,
        metavar="MASK",
        help="Flatten only this: a volume that is not 0 there; for meshes a label, patch or GIFTI file.",
    ),
    click.option("--drop", type=FILE, metavar="MASK", help="Leave this out; as for --keep, or medial-wall."),
    click.option(
        "--seed-point",
        metavar="I,J,K|V",
        callback=_place,
        help="Flatten a disk around this voxel (indices), or around this vertex of a mesh; counted from 0.",
    ),
    click.option("--radius", type=float, metavar="MM", help="Radius of that disk, mm along the surface."),
    click.option(
        "--polygon",
        type=FILE,
        metavar="FILE",
        callback=_vertices,
        help="Flatten what the shortest paths between the corners listed in this file enclose; a corner a line.",
    ),
    click.option(
        "--cuts",
        type=FILE,
        metavar="standard|automatic|FILE",
        multiple=True,
        callback=_paths,
        help="Cut along standard lines, the same for every brain; or where it suits this surface best; or as in this "
        "file of cuts or template (.json), as voxflat cut writes it; or along the neighbouring vertices listed in this "
        "file, as voxflat path writes it, which may be given again.  [default: standard where the sphere is known, "
        "else automatic]",
    ),
)
"""Which part of the surface is worked on."""


sphere = click.option(
    "--sphere",
    type=FILE,
    metavar="MESH",
    help="The surface's registered sphere, in fsaverage space, or in that of fs_LR by its name.  [default: "
    "lh.sphere.reg beside lh.white]",
)
"""By which standard cuts are traced."""


def _relax(ctx: click.Context, param: click.Parameter, value: bool | None) -> float | bool | None:
    """Take the length instead, where one is given."""
    length = ctx.params.pop("relax_length", None)
    if length is not None and value is False:
        raise click.BadParameter("--no-relax and --relax-length contradict each other.")
    return value if length is None else float(length)


relax = group(
    click.option(
        "--relax-length",
        type=click.FloatRange(min=0),
        metavar="MM",
        is_eager=True,
        help="Relaxation cuts, those of --cuts included, are no longer than this, mm.",
    ),
    click.option(
        "--relax/--no-relax",
        default=None,
        callback=_relax,
        help="Cut the disk further where that relieves the map, as long as it pays.  [default: where nobody"
        " has said where to cut]",
    ),
    click.option(
        "--adapt",
        type=click.FloatRange(min=0, min_open=True),
        metavar="MM",
        help="Let a template's cuts grow and branch where that relieves the map, within so many mm of their place.",
    ),
)
"""Which cuts are made beyond those that make a disk."""


period = click.option(
    "--period",
    type=click.FloatRange(min=0, min_open=True),
    metavar="P",
    help="Values are phases with this period, such as 360: means between them go the short way round, colours begin "
    "again.",
)
"""Whether values are phases."""

time_step = click.option(
    "--time-step",
    type=click.FloatRange(min=0, min_open=True),
    metavar="S",
    help="From each frame of a series to the next, s.  [default: what the file says]",
)
"""When the frames of a series were."""


def link_lengths(where: str) -> Callable[[_Command], _Command]:
    """Return the option for the lengths of links between voxels, where these are."""
    return click.option(
        "--link-lengths",
        type=click.Choice(["chain-code", "euclidean"]),
        help=f"{where}: the unbiased estimator, or 1, √2, √3 voxels for comparison.  [default: {LINK_LENGTHS}]",
    )


def store(*, required: bool) -> Callable[[_Command], _Command]:
    """Return the option that names a store of distance rows."""
    return click.option(
        "--store",
        type=OUT,
        metavar="DIR",
        required=required,
        help="Keep the distances from all sources in this directory, new or of an interrupted run, which is resumed.",
    )
