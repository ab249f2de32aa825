"""Define the options that several commands share."""

import functools
import math
import re
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import click
import cloup
import numpy as np

from voxflat.arguments import checked_seed, checked_threads, named_side
from voxflat.cli.console import Command, translated
from voxflat.cli.output import JSON, READ, SHOWN, WRITTEN
from voxflat.cli.parameter_options import option_of
from voxflat.distances.geodesic import SOLVERS
from voxflat.distances.sources import SAMPLINGS
from voxflat.errors import InputError
from voxflat.io.grid import UNITS, named_unit
from voxflat.io.volumes import read_volume
from voxflat.maps.map_cuts import is_map
from voxflat.methods import METHODS, Grossmann2002, Method, Saucan2006, Schwartz1989, Voxflat
from voxflat.methods.voxflat import SCALES
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.charts import CYLINDER, MOST_CHARTS
from voxflat.surfaces.standard.choice import AUTOMATIC
from voxflat.surfaces.standard.template import STANDARD
from voxflat.surfaces.voxel_graph import LINK_LENGTHS

_Command = TypeVar("_Command", bound=Callable[..., Any])
_SIDECAR = "Also save the provenance of OUT (inputs, options, version) in OUT.json, for formats that cannot store it."
_OVERWRITE = "Replace existing companion files of OUT, such as OUT.json, even if voxflat did not write them."
_RELAX_LENGTH = "Maximum total length of relaxation cuts in mm, including any cuts passed to --cuts."
_PERIOD = "Treat the values as phases with this period, such as 360, so that averages and colours wrap around."
_TIME_STEP = "Time between frames of a series, in seconds.  [default: from the file]"
_SURFACES = {
    "surface": "Surface that MAP shows, if another tool made MAP: a mesh, or a file as for voxflat flatten. Without "
    "it, only values, labels and regions at the vertices can be shown.",
    "pial": "Pial surface, if --surface is the white surface.",
}
_MOST_NUMBERS = 1e6  # in a range
_ROUNDING = 1e-6  # steps by which the last number of a range may miss its end
_PER_LINE = "Write one vertex number, or three voxel indices, on each line."


class _Number(click.types.FloatParamType):
    """A number that is neither NaN nor infinite."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class _Range(click.FloatRange, _Number):
    name = "number"


NUMBER, POSITIVE, NOT_NEGATIVE, SHARE = _Number(), _Range(min=0, min_open=True), _Range(min=0), _Range(0, 1)
"""Types of options whose value is a finite number."""


def several(count: int, kind: type[int] | type[float], example: str) -> Callable[..., Any]:
    """Return a callback that converts an option's text to three or four numbers."""

    def convert(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[float, ...] | None:
        try:
            found = None if value is None else tuple(kind(part) for part in value.split(","))
        except ValueError:
            found = ()
        if found is not None and len(found) != count:
            words = {3: "three", 4: "four"}[count]
            raise click.BadParameter(f"{value!r} is not a list of {words} numbers. Pass numbers such as {example}.")
        return found

    return convert


def _bytes(ctx: click.Context, param: click.Parameter, value: str | None) -> int | None:
    """Convert an option's text to a number of bytes."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?) *([KMGT]?)(?:iB|B)?", value, re.IGNORECASE)
    if match is None:
        raise click.BadParameter(
            f"{value!r} is not an amount of memory. Pass a number of bytes, or a number with a unit (for example, 4G)."
        )
    if (size := int(float(match[1]) * 1024 ** " KMGT".index(match[2].upper() or " "))) == 0:
        raise click.BadParameter(f"{value!r} is less than one byte. Pass a larger amount, such as 4G.")
    return size


def _labels(ctx: click.Context, param: click.Parameter, value: tuple[str, ...]) -> int | list[int] | None:
    """Convert the texts of --label, such as 7,8, to one label or several."""
    try:
        labels = [int(part) for text in value for part in text.split(",")]
    except ValueError:
        raise click.BadParameter(f"{value[-1]!r} is not a label. Pass whole numbers such as 7,8.") from None
    return labels[0] if len(labels) == 1 else labels or None


def _rings(ctx: click.Context, param: click.Parameter, value: str | None) -> int | str | None:
    """Convert an option's text to a number of rings, or "all"."""
    if value is None or value == "all":
        return value
    try:
        return int(value)
    except ValueError:
        raise click.BadParameter(f"{value!r} is not a number of rings. Pass an integer or 'all'.") from None


def _place(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[int, ...] | int | None:
    """Convert an option's text to voxel indices or a vertex number."""
    if value is not None and "," not in value:
        try:
            return int(value)
        except ValueError:
            raise click.BadParameter(f"{value!r} is not a point. Pass I,J,K (a voxel) or a vertex number.") from None
    indices: tuple[int, ...] | None = several(3, int, "136,112,127")(ctx, param, value)
    return indices


def places(ctx: click.Context, param: click.Parameter, value: tuple[str, ...]) -> list[Any]:
    """Convert several texts to voxel indices or vertex numbers."""
    return [_place(ctx, param, text) for text in value]


def _vertices(ctx: click.Context, param: click.Parameter, value: Path | None) -> Any:
    """Read a list of vertices from a file with one vertex number, or three voxel indices, per line."""
    if value is None:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about empty files, which are reported below
            words = np.loadtxt(value, dtype=np.str_, ndmin=1)  # NumPy before 2.3 would read 1.5 as the integer 1
        vertices = words.astype(np.int64)
    except (OSError, ValueError) as error:
        raise click.BadParameter(f"{value} is not a list of vertices: {error}. {_PER_LINE}") from None
    if len(vertices) == 0:
        raise click.BadParameter(f"{value} does not list any vertices. {_PER_LINE}")
    return vertices if vertices.ndim == 1 or vertices.shape[1] == 3 else vertices.ravel()


def paths(ctx: click.Context, param: click.Parameter, value: tuple[Path, ...]) -> list[Any] | Path | str | None:
    """Convert the values of --cuts: a keyword, a cuts file, a map, or vertex lists (one per file)."""
    words = {str(file) for file in value} & {STANDARD, AUTOMATIC}
    if words:
        if len(value) > 1:
            raise click.BadParameter(f"{words.pop()} cannot be combined with other cuts. Pass it alone.")
        return words.pop()
    if any(file.suffix.lower() == ".json" or is_map(file) for file in value):
        if len(value) > 1:
            raise click.BadParameter("A cuts file, template or map cannot be combined with other cuts. Pass it alone.")
        return value[0]
    return [_vertices(ctx, param, file) for file in value] or None


def numbers(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[float, ...] | None:
    """Convert an option's text to numbers: one number, a list such as 0,2, or a range such as -10:10:1."""
    return None if value is None else tuple(number for part in value.split(",") for number in _numbers(part))


def _numbers(text: str) -> list[float]:
    """Return a number, or all numbers of a range, which includes both of its ends."""
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in (1, 3):
        kinds = "a number, a list of numbers such as 0.25,0.5 or a range such as -10:10:1 (first:last:step)"
        raise click.BadParameter(f"{text!r} is not {kinds}.")
    if not all(map(math.isfinite, parts)):
        raise click.BadParameter(f"{text!r} is not finite. Pass finite numbers.")
    if len(parts) == 1:
        return parts
    first, last, step = parts
    if step == 0:
        raise click.BadParameter(f"the step of the range {text!r} is 0. Pass first:last:step, such as -10:10:1.")
    steps = (last - first) / step
    if steps < 0:
        remedy = f"Pass {first:g}:{last:g}:{-step:g}."
        raise click.BadParameter(f"the step of the range {text!r} leads away from its last number. {remedy}")
    if steps >= _MOST_NUMBERS:
        raise click.BadParameter(f"the range {text!r} has more than {_MOST_NUMBERS:,.0f} numbers. Pass a larger step.")
    if abs(steps - round(steps)) > _ROUNDING:
        begin, end, reached = (f"{number:.12g}" for number in (first, last, first + step * math.floor(steps)))
        counts = sorted(range(1, math.ceil(2 * steps) + 1), key=lambda count: abs(count - steps))
        finer = (f"{(last - first) / count:.12g}" for count in counts)
        remedies = [f"{begin}:{end}:{next(by for by in finer if len(by) <= len(text) or by == f'{last - first:.12g}')}"]
        remedies = [f"{begin}:{reached}:{step:.12g}", *remedies] if steps > 1 else remedies
        problem = f"the range {text!r} ends at {reached}, not at {end}"
        raise click.BadParameter(f"{problem}. Pass {' or '.join(remedies)}.")
    return [float(f"{first + step * n:.12g}") for n in range(round(steps))] + [last]


class _File(click.Path):
    """Path parameter that is recorded in the command's context as read or written."""

    def __init__(self, key: str) -> None:
        super().__init__(path_type=Path)
        self._key = key

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = super().convert(value, param, ctx)
        if ctx is not None:
            name = param.name if param is not None and self._key == WRITTEN else path  # output options hold one path
            ctx.meta.setdefault(self._key, {})[name] = path
        return path


FILE = _File(READ)
"""Type of options and arguments that name a file to read."""

OUT = _File(WRITTEN)
"""Type of options that name a file to write."""


def section(title: str, *options: Callable[..., Any]) -> Callable[[_Command], _Command]:
    """Return a decorator that adds several options under a title."""
    decorator: Callable[[_Command], _Command] = cloup.option_group(title, *options)
    return decorator


def flag(name: str, help_: str, *names: str, **more: Any) -> Callable[[_Command], _Command]:
    """Return an option without a value."""
    return cloup.option(name, *names, is_flag=True, help=help_, **more)


def value(name: str, metavar: str, help_: str, *names: str, **more: Any) -> Callable[[_Command], _Command]:
    """Return an option with a value."""
    return cloup.option(name, *names, metavar=metavar, help=help_, **more)


def choice(name: str, words: Iterable[str], help_: str, *names: str, **more: Any) -> Callable[[_Command], _Command]:
    """Return an option whose value is one of several words."""
    return cloup.option(name, *names, type=click.Choice(list(words)), help=help_, **more)


def reads(name: str, help_: str, *, metavar: str = "FILE", **more: Any) -> Callable[[_Command], _Command]:
    """Return an option that names a file to read."""
    return value(name, metavar, help_, type=FILE, **more)


def writes(name: str, help_: str, *names: str, metavar: str = "FILE") -> Callable[[_Command], _Command]:
    """Return an option that names a file to write."""
    return value(name, metavar, help_, *names, type=OUT)


def command(name: str, *examples: str, **more: Any) -> Callable[[Callable[..., Any]], cloup.Command]:
    """Return a decorator that makes a command; its help ends with the examples."""
    epilog = "\b\nExamples:\n" + "".join(f"  {example}\n" for example in examples) if examples else None
    return cloup.command(name, **{"cls": Command, "epilog": epilog, **more})


input_ = cloup.argument("input_", metavar="INPUT", type=FILE)


def _of_map(ctx: click.Context, param: click.Parameter, value: tuple[Path, ...]) -> None:
    """Store the surfaces of maps that other tools made, which `load_maps` reads."""
    ctx.meta[f"{SHOWN}.{param.name}"] = value


def map_options(argument: Callable[[_Command], _Command]) -> Callable[[_Command], _Command]:
    """Return the argument for one or several maps, with the options for maps that other tools made."""
    shown = section(
        "Map of another tool",
        *(
            reads(
                f"--{name}",
                f"{text} For several maps, pass it once per map.",
                multiple=True,
                callback=_of_map,
                expose_value=False,
            )
            for name, text in _SURFACES.items()
        ),
    )
    return lambda command: argument(shown(command))


map_ = map_options(cloup.argument("map_", metavar="MAP", type=FILE))


def _writing(ctx: click.Context, param: click.Parameter, value: bool) -> dict[str, bool]:
    """Return --sidecar and --overwrite as keyword arguments for functions that save results."""
    return {"sidecar": ctx.params.pop("sidecar"), "overwrite": value}


def output(help_: str, *further: Callable[..., Any], required: bool = True) -> Callable[[_Command], _Command]:
    """Return the section of options for the output file and its companion files."""
    return section(
        "Output",
        value("-o", "OUT", help_, "--output", type=OUT, required=required),
        *further,
        flag("--sidecar", _SIDECAR, is_eager=True),  # so that it is known when --overwrite is handled
        flag("--overwrite", _OVERWRITE, "writing", callback=_writing),
        as_json,
    )


def _json(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    """Store whether ``--json`` was given."""
    ctx.meta[JSON] = value


as_json = flag(
    "--json", "Print one JSON object to stdout instead of text.", "as_json", callback=_json, expose_value=False
)
debug = flag("--debug", "Print the traceback if an error occurs.", expose_value=False)
quiet = flag("--quiet", "Do not print progress, warnings or a summary.")


def _checked(check: Callable[[Any], Any]) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Return a callback that checks the value of an option, also where a command does not use it."""

    def checked(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
        try:
            return None if value is None else check(value)
        except InputError as error:
            raise click.UsageError(f"{translated(str(error))}.", ctx) from None

    return checked


seed = option_of(Surface.flatten, "seed", type=int, callback=_checked(checked_seed))
threads = option_of(Surface.flatten, "threads", type=int, metavar="N", callback=_checked(checked_threads))
memory_limit = option_of(Surface.flatten, "memory_limit", metavar="SIZE", callback=_bytes)


def run(*options: Callable[..., Any]) -> Callable[[_Command], _Command]:
    """Return the section of options that control the run; ``--debug`` is always part of it."""
    return section("Run control", *options, debug)


def _for_each_side(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that runs once per hemisphere for ``--hemisphere both``, with outputs named lh.* and rh.*."""

    @functools.wraps(command)
    def each(**settings: Any) -> None:
        if settings["hemisphere"] != "both":
            return command(**settings)
        meta = click.get_current_context().meta
        written = dict(meta.get(WRITTEN, {}))
        for prefix, side in (("lh", "left"), ("rh", "right")):
            outputs = {name: path.with_name(f"{prefix}.{path.name}") for name, path in written.items()}
            meta[WRITTEN] = outputs
            command(**{**settings, **outputs, "hemisphere": side})
        return None

    return each


class _Hemisphere(click.Choice[str]):
    """A hemisphere by any of its names: left, L or lh, and right, R or rh."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return named_side(value, "hemisphere")
        except InputError:
            return super().convert(str(value).lower(), param, ctx)


SIDE, SIDES = _Hemisphere(["left", "right"]), _Hemisphere(["left", "right", "both"])
"""Types of options that name one hemisphere, and one or both."""


class _Unit(click.Choice[str]):
    """A unit of length by any of its names, such as um for µm."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return named_unit(value)
        except InputError:
            return super().convert(value, param, ctx)


channel = option_of(read_volume, "channel", metavar="NAME|N")
_of_volumes = (
    channel,
    option_of(surface, "label", metavar="N[,N...]", sentences=2, multiple=True, callback=_labels, default=None),
    option_of(surface, "threshold", type=NUMBER),
)
_of_grids = (
    option_of(surface, "spacing", metavar="X,Y,Z", callback=several(3, float, "0.5,0.5,0.5")),
    option_of(surface, "unit", type=_Unit(UNITS), sentences=2),
)
_of_surfaces = (
    option_of(surface, "repair", type=click.Choice(["none", "voxels", "cuts"])),
    value(
        "--smooth",
        "LENGTH",
        "Remove waves that are shorter than this from the surface, such as the noise and the steps of a segmentation. "
        "A few voxels are usual.",
        type=NUMBER,
    ),
)
frame_options = section("Input", *_of_volumes, *_of_grids, *_of_surfaces)  # of the surface of each frame
_surface_options = section(
    "Input",
    *_of_volumes,
    value(
        "--hemisphere",
        "[left|right|both]",
        "Extract this hemisphere from a white-matter volume or a whole-brain segmentation. The cerebellum and the "
        'brain stem are removed, and the ventricles and deep nuclei are filled. "both" runs the command once per '
        "hemisphere and writes lh.OUT and rh.OUT.",
        "--hemi",
        type=SIDES,
    ),
    flag("--rim", "Treat INPUT as a rim, as for voxflat layers, and use the surface halfway between its borders."),
    *_of_grids,
    option_of(surface, "probability", type=FILE, metavar="FILE"),
    value("--probability-channel", "NAME|N", "Channel of --probability: its name, or its number from 0."),
    option_of(surface, "pial", type=FILE, metavar="FILE", sentences=2),
    *_of_surfaces,
)


def surface_options(command: _Command) -> _Command:
    """Add the options that define how the surface of INPUT is created."""
    return _surface_options(_for_each_side(command))  # type: ignore[return-value]


region = section(
    "Region",
    reads("--keep", "Restrict the surface to this region: a mask volume or, for meshes, a label, patch or GIFTI file."),
    reads(
        "--drop",
        'Exclude this region: a file as for --keep, or "medial-wall" for the part where the white and pial surfaces '
        "touch. It may be repeated: all regions are excluded.",
        multiple=True,
    ),
    value(
        "--seed-point",
        "I,J,K|V",
        "Restrict the surface to the geodesic disk around this voxel (indices I,J,K) or mesh vertex (number V), both "
        "counted from 0. Requires --radius.",
        callback=_place,
    ),
    option_of(Surface.disk, "radius", type=NUMBER, metavar="MM"),
    reads(
        "--polygon",
        "Restrict the surface to the region enclosed by shortest paths between the corners listed in FILE (one corner "
        "per line).",
        callback=_vertices,
    ),
)


def _relax(ctx: click.Context, param: click.Parameter, value: bool | None) -> float | bool | None:
    """Return --relax-length if it is given, and --relax otherwise."""
    length = ctx.params.pop("relax_length", None)
    if length is not None and value is False:
        raise click.BadParameter("--no-relax and --relax-length cannot be combined. Pass only one of them.")
    return value if length is None else float(length)


where_cut = (
    option_of(
        Surface.cut,
        "cuts",
        type=FILE,
        metavar="standard|automatic|FILE",
        multiple=True,
        callback=paths,
        sentences=3,
        note="FILE is a cuts file, a template, a flat map, or a list of neighbouring vertices (repeat --cuts for "
        "several lists).",
    ),
    option_of(Surface.cut, "sphere", type=FILE, metavar="FILE"),
)
relaxation = (
    cloup.option(
        "--relax/--no-relax",
        default=None,
        callback=_relax,
        help="Add relaxation cuts where they reduce the distortion of the map enough to be worthwhile.  "
        "[default: --relax, unless --cuts or a patch file specifies the cuts]",
    ),
    value("--relax-length", "MM", _RELAX_LENGTH, type=NOT_NEGATIVE, is_eager=True),
)
further_cuts = (*relaxation, option_of(Surface.cut, "adapt", type=POSITIVE, metavar="MM"))
cuts = section("Cuts", *where_cut, *further_cuts)
frame_cuts = section("Cuts", where_cut[0], *relaxation)  # of the reference frame
group_cuts = section("Cuts", *where_cut, *relaxation)  # of the mean surface
choice_of_cuts = section("Cuts", *where_cut)  # for commands that do not add relaxation cuts


def _count_of_charts(ctx: click.Context, param: click.Parameter, value: str | None) -> int | str | None:
    """Return a number of charts, or "cylinder"."""
    if value is None or value == CYLINDER:
        return value
    if not value.isdecimal() or not 1 <= int(value) <= MOST_CHARTS:
        raise click.BadParameter(f"{value!r} is neither a number from 1 to {MOST_CHARTS} nor '{CYLINDER}'.")
    return int(value)


charts = section(
    "Charts",
    value(
        "--charts",
        "N|cylinder",
        "Divide a closed organ, or a tube with two open ends, into N charts that reach from end to end, with the axis "
        "horizontal and the anterior end on the left. 1 cuts it along a seam. 2 writes front.OUT and back.OUT, and "
        "larger numbers write chart1.OUT, chart2.OUT, and so on. 'cylinder' writes a periodic map of a tube as "
        "cylinder.OUT, and the ends of a closed organ as anterior.OUT and posterior.OUT.",
        callback=_count_of_charts,
    ),
    option_of(
        Surface.charts,
        "axis",
        nargs=2,
        metavar="I,J,K|V I,J,K|V",
        callback=lambda ctx, param, value: None if value is None else places(ctx, param, value),
        sentences=2,
    ),
    option_of(Surface.charts, "front", metavar="I,J,K|V", callback=_place, sentences=2),
    option_of(Surface.charts, "overlap", type=NUMBER, metavar="MM"),
)


def charts_of(settings: dict[str, Any]) -> dict[str, Any] | None:
    """Remove the options of the charts from the command's options, and return them; None if no charts are made."""
    count, axis, front, overlap = (settings.pop(name) for name in ("charts", "axis", "front", "overlap"))
    if count is None:
        if axis is not None or front is not None or overlap:
            raise click.UsageError("--axis, --front and --overlap require --charts.")
        return None
    cuts = [settings.pop(name, None) for name in ("cuts", "sphere", "adapt")]
    if any(value is not None for value in cuts):
        raise click.UsageError("--charts cannot be combined with --cuts, --sphere and --adapt.")
    return {"count": count, "axis": axis, "front": front, "overlap": overlap, "relax": settings.pop("relax")}


def link_lengths(function: Any) -> Callable[[_Command], _Command]:
    """Return the option for the lengths of links between neighbouring voxels."""
    note = "" if function is Grossmann2002 else "Requires --geodesic chain."
    kinds = click.Choice(LINK_LENGTHS)
    return option_of(function, "link_lengths", type=kinds, like=Grossmann2002, note=note)


def _of_methods(option: str) -> str:
    """Return the defaults of an option that several methods share, as text."""
    usual = {name: getattr(method(), option) for name, method in METHODS.items() if hasattr(method, option)}
    first = usual["voxflat"]
    return "; ".join([str(first), *(f"{name}: {value}" for name, value in usual.items() if value != first)])


_METHODS = f"Flattening method. {'; '.join(f'{name}: {method.summary}' for name, method in METHODS.items())}."
_START = "Flat map of the surface to start from, in any format that voxflat measure accepts."
_SOLVER = "graph, or a more exact method if its error exceeds 1 %"
_METHOD_SECTIONS = (
    section(
        "Method",
        choice("--method", list(METHODS), _METHODS, default=next(iter(METHODS))),
        option_of(Voxflat, "sources", type=int, metavar="N", default=_of_methods("sources"), until=", or the points"),
        option_of(Voxflat, "sampling", type=click.Choice([*SAMPLINGS, "decimation"]), default=_of_methods("sampling")),
    ),
    section(
        "Method voxflat",
        option_of(Voxflat, "geodesic", type=click.Choice(SOLVERS), sentences=4, like=Surface.geodesic, default=_SOLVER),
        option_of(Voxflat, "weighting", type=SHARE, metavar="W", sentences=2),
        option_of(Voxflat, "scale", type=click.Choice(SCALES), sentences=2),
        option_of(Voxflat, "max_area", type=NUMBER, metavar="FACTOR"),
        option_of(Voxflat, "start", type=FILE, metavar="MAP", help=_START),
    ),
    section("Method grossmann2002", link_lengths(Grossmann2002)),
    section(
        "Method schwartz1989",
        option_of(Schwartz1989, "neighbourhood", metavar="N|all", callback=_rings, default="a tenth of the points"),
        option_of(Schwartz1989, "starts", type=int, metavar="N"),
    ),
    section("Method saucan2006", option_of(Saucan2006, "bound", type=NUMBER, metavar="C")),
)


def method_options(command: _Command) -> _Command:
    """Add the options for the flattening method."""
    for section in reversed(_METHOD_SECTIONS):
        command = section(command)
    return command


_OPTIONS: tuple[str, ...] = ("sources", "sampling", "geodesic", "weighting", "scale", "max_area", "start")
_OPTIONS += ("link_lengths", "neighbourhood", "starts", "bound")


def method_of(settings: dict[str, Any]) -> Method:
    """Remove the method and its options from the command's options, and return the method."""
    name = settings.pop("method")
    chosen = {option: value for option in _OPTIONS if (value := settings.pop(option)) is not None}
    for option in chosen:
        if not hasattr(METHODS[name], option):
            flag = f"--{option.replace('_', '-')}"
            raise click.UsageError(f"{flag} is not an option of the method {name}. Omit it.")
    return METHODS[name](**chosen)


period = value("--period", "P", _PERIOD, type=POSITIVE)
time_step = value("--time-step", "S", _TIME_STEP, type=POSITIVE)
store = option_of(Surface.geodesic, "store", type=OUT, metavar="DIR")
dask = option_of(Surface.geodesic, "dask", metavar="ADDRESS|FILE|local")
sampling = option_of(Surface.geodesic, "sampling", type=click.Choice(SAMPLINGS))
