"""Options that several commands of the command line share."""

import functools
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
import cloup
import numpy as np

from voxflat.cli.output import READ, WRITTEN
from voxflat.cli.told import option_of
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.sources import SAMPLINGS
from voxflat.io.grid import UNITS
from voxflat.methods import METHODS, Grossmann2002, Method, Saucan2006, Schwartz1989, Voxflat
from voxflat.methods.voxflat import SCALES
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.standard.choice import AUTOMATIC
from voxflat.surfaces.standard.template import STANDARD

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


def _rings(ctx: click.Context, param: click.Parameter, value: str | None) -> int | str | None:
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


def paths(ctx: click.Context, param: click.Parameter, value: tuple[Path, ...]) -> list[Any] | Path | str | None:
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


# ----------------------------------------------------------------------------------------- sections

FILE = _File(READ)
"""The type of options and arguments that name what is read."""

OUT = _File(WRITTEN)
"""The same of what is written."""


def section(title: str, *options: Callable[..., Any]) -> Callable[[_Command], _Command]:
    """Return several options under a title, as one decorator."""
    decorator: Callable[[_Command], _Command] = cloup.option_group(title, *options)
    return decorator


def reads(name: str, told: str, *, metavar: str = "F", **more: Any) -> Callable[[_Command], _Command]:
    """Return an option that names a file that is read."""
    return cloup.option(name, type=FILE, metavar=metavar, help=told, **more)


input_ = cloup.argument("input_", metavar="INPUT", type=FILE)


def group(*options: Callable[..., Any]) -> Callable[[_Command], _Command]:
    """Return several options, or sections, as one decorator."""

    def decorate(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def _writing(ctx: click.Context, param: click.Parameter, value: bool) -> dict[str, bool]:
    """Return both options of what lies beside, as whatever writes takes them."""
    return {"sidecar": ctx.params.pop("sidecar"), "overwrite": value}


def output(help_: str, *further: Callable[..., Any], required: bool = True) -> Callable[[_Command], _Command]:
    """Return the section of what is written: the result, and what lies beside it."""
    return section(
        "Output",
        cloup.option("-o", "--output", type=OUT, required=required, metavar="OUT", help=help_),
        *further,
        cloup.option(
            "--sidecar",
            is_flag=True,
            is_eager=True,  # for what comes with it
            help="Write the record of how OUT was made beside it, as OUT.json: for formats that cannot hold it.",
        ),
        cloup.option(
            "--overwrite",
            "writing",
            is_flag=True,
            callback=_writing,
            help="Replace files beside OUT that voxflat did not write.",
        ),
        as_json,
    )


as_json = cloup.option("--json", "as_json", is_flag=True, help="Print one JSON object to stdout instead of text.")
debug = cloup.option("--debug", is_flag=True, expose_value=False, help="Show where in the program an error arose.")
quiet = cloup.option("--quiet", is_flag=True, help="Show neither progress nor a summary.")
seed = option_of(Surface.flatten, "seed", type=int)
threads = option_of(Surface.flatten, "threads", type=int, metavar="N")
memory_limit = option_of(Surface.flatten, "memory_limit", metavar="SIZE", callback=_bytes)


def run(*options: Callable[..., Any]) -> Callable[[_Command], _Command]:
    """Return the section on how to run: the options that a command has, and ``--debug``."""
    return section("Run control", *options, debug)


def _for_each_side(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that runs for either hemisphere when both are asked for; its files are named lh. and rh."""

    @functools.wraps(command)
    def each(**given: Any) -> None:
        if given["hemisphere"] != "both":
            return command(**given)
        meta = click.get_current_context().meta
        written = dict(meta.get(WRITTEN, {}))
        for prefix, side in (("lh", "left"), ("rh", "right")):
            own = {name: path.with_name(f"{prefix}.{path.name}") for name, path in written.items()}
            meta[WRITTEN] = own
            command(**{**given, **own, "hemisphere": side})
        return None

    return each


_making = section(
    "Input",
    option_of(surface, "label", type=int),
    option_of(surface, "threshold", type=float),
    cloup.option(
        "--hemisphere",
        type=click.Choice(["left", "right", "both"]),
        help="Extract this hemisphere from the white matter, or segmentation, of a whole brain: without cerebellum and "
        "brain stem, with ventricles and deep nuclei filled, repaired to a sphere. With both, the command runs for "
        "each, and the files that it writes are called lh.NAME and rh.NAME.",
    ),
    option_of(surface, "spacing", metavar="X,Y,Z", callback=_three(float, "0.5,0.5,0.5")),
    option_of(surface, "unit", type=click.Choice(UNITS)),
    option_of(surface, "probability", type=FILE, metavar="FILE"),
    option_of(surface, "pial", type=FILE, metavar="FILE"),
    option_of(surface, "repair", type=click.Choice(["none", "voxels", "cuts"])),
)


def making(command: _Command) -> _Command:
    """How a surface is made of INPUT."""
    return _making(_for_each_side(command))  # type: ignore[return-value]


region = section(
    "Region",
    reads(
        "--keep",
        "Work on this region only: a volume that is not 0 there; for meshes a label, patch or GIFTI file.",
        metavar="FILE",
    ),
    reads(
        "--drop",
        "Leave this region out: a file as for --keep, or medial-wall, where white and pial surface touch.",
        metavar="FILE",
    ),
    cloup.option(
        "--seed-point",
        metavar="I,J,K|V",
        callback=_place,
        help="Work on the geodesic disk around this voxel (indices), or vertex of a mesh (number), counted from 0.",
    ),
    option_of(Surface.disk, "radius", type=float, metavar="MM"),
    reads(
        "--polygon",
        "Work on the region enclosed by shortest paths between the corners listed in FILE (one corner per line).",
        metavar="FILE",
        callback=_vertices,
    ),
)
"""Which part of the surface is worked on."""


def _relax(ctx: click.Context, param: click.Parameter, value: bool | None) -> float | bool | None:
    """Take the length instead, where one is given."""
    length = ctx.params.pop("relax_length", None)
    if length is not None and value is False:
        raise click.BadParameter("--no-relax and --relax-length contradict each other.")
    return value if length is None else float(length)


where_cut = (
    option_of(
        Surface.cut, "cuts", type=FILE, metavar="standard|automatic|FILE", multiple=True, callback=paths, sentences=2
    ),
    option_of(Surface.cut, "sphere", type=FILE, metavar="FILE"),
)
further_cuts = (
    cloup.option(
        "--relax/--no-relax",
        default=None,
        callback=_relax,
        help="Cut the disk further where that reduces the distortion of the map, as long as it pays.  [default: where "
        "nothing says where to cut]",
    ),
    cloup.option(
        "--relax-length",
        type=click.FloatRange(min=0),
        metavar="MM",
        is_eager=True,
        help="The greatest length of relaxation cuts, those of --cuts included, mm.",
    ),
    option_of(Surface.cut, "adapt", type=click.FloatRange(min=0, min_open=True), metavar="MM"),
)
cuts = section("Cuts", *where_cut, *further_cuts)
"""Where the surface is cut."""

choice_of_cuts = section("Cuts", *where_cut)
"""The same for commands that cut no further."""


# ------------------------------------------------------------------------------------------- methods


def link_lengths(of: Any) -> Callable[[_Command], _Command]:
    """Return the option for the lengths of links between voxels."""
    return option_of(of, "link_lengths", type=click.Choice(["chain-code", "euclidean"]))


def _of_methods(option: str) -> str:
    """Return the defaults of an option that several methods have."""
    usual = {name: getattr(method(), option) for name, method in METHODS.items() if hasattr(method, option)}
    first = usual["voxflat"]
    return "; ".join([str(first), *(f"{name}: {value}" for name, value in usual.items() if value != first)])


method_options = group(
    section(
        "Method",
        cloup.option(
            "--method",
            type=click.Choice(list(METHODS)),
            default=next(iter(METHODS)),
            help="; ".join(f"{name}: {method.summary}" for name, method in METHODS.items()) + ".",
        ),
        option_of(Voxflat, "sources", type=int, metavar="N", default=_of_methods("sources")),
        option_of(Voxflat, "sampling", type=click.Choice([*SAMPLINGS, "decimation"]), default=_of_methods("sampling")),
    ),
    section(
        "Method voxflat",
        option_of(Voxflat, "geodesic", type=click.Choice(SOLVERS), default="graph, or one that is at most 1 % off"),
        option_of(Voxflat, "weighting", type=click.FloatRange(0, 1)),
        option_of(Voxflat, "scale", type=click.Choice(SCALES)),
        option_of(Voxflat, "max_area", type=float, metavar="FACTOR"),
        option_of(Voxflat, "start", type=FILE, metavar="MAP"),
    ),
    section("Method grossmann2002", link_lengths(Grossmann2002)),
    section(
        "Method schwartz1989",
        option_of(Schwartz1989, "neighbourhood", metavar="N|all", callback=_rings, default="a tenth of the points"),
        option_of(Schwartz1989, "starts", type=int, metavar="N"),
    ),
    section("Method saucan2006", option_of(Saucan2006, "bound", type=float, metavar="C")),
)
"""The methods and their options."""

_OPTIONS: tuple[str, ...] = ("sources", "sampling", "geodesic", "weighting", "scale", "max_area", "start")
_OPTIONS += ("link_lengths", "neighbourhood", "starts", "bound")


def method_of(given: dict[str, Any]) -> Method:
    """Take a method and its options out of what a command was given."""
    name = given.pop("method")
    chosen = {option: value for option in _OPTIONS if (value := given.pop(option)) is not None}
    for option in chosen:
        if not hasattr(METHODS[name], option):
            raise click.UsageError(f"--{option.replace('_', '-')}: the method {name} has no such option; leave it out.")
    return METHODS[name](**chosen)


# --------------------------------------------------------------------------------------------- others

period = cloup.option(
    "--period",
    type=click.FloatRange(min=0, min_open=True),
    metavar="P",
    help="Values are phases with this period, such as 360: means between them go the short way round, colours begin "
    "again.",
)
"""Whether values are phases."""

time_step = cloup.option(
    "--time-step",
    type=click.FloatRange(min=0, min_open=True),
    metavar="S",
    help="From each frame of a series to the next, s.  [default: what the file says]",
)
"""When the frames of a series were."""

store = option_of(Surface.geodesic, "store", type=OUT, metavar="DIR")
dask = option_of(Surface.geodesic, "dask", metavar="ADDRESS|FILE|local")
sampling = option_of(Surface.geodesic, "sampling", type=click.Choice(SAMPLINGS))
