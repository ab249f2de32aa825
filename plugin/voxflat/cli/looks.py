"""Options of commands that draw data over the folds: where they are sampled, and how they are shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import cloup

from voxflat.cli import options
from voxflat.maps.depth import LAYERINGS

if TYPE_CHECKING:
    from voxflat.figures import Overlay

_Command = TypeVar("_Command", bound=Callable[..., Any])


def check_depth(given: dict[str, Any]) -> None:
    """Refuse options of the depth that do not fit each other."""
    if given["layering"] is not None and given["fraction"] is None:
        raise click.UsageError("--layering is for --fraction.")
    if given["depth"] is not None and given["fraction"] is not None:
        raise click.UsageError("Give --depth or --fraction.")


def _limits(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    if value is None:
        return None
    ends = tuple(part.strip() for part in value.split(","))
    if len(ends) != 2:
        raise click.BadParameter(f"{value!r} is not a pair such as 0,5 or 2%,98%", param=parameter)
    return ends


of_depth = (
    cloup.option(
        "--depth",
        metavar="MM[,MM...]",
        callback=options.numbers,
        help="How far outside the surface to sample volumes, mm; of several the mean, of labels the most frequent.  "
        "[default: 0]",
    ),
    cloup.option(
        "--fraction",
        metavar="F[,F...]",
        callback=options.numbers,
        help="Instead of --depth, of maps made with --pial: how much of the cortex lies below, from 0 to 1.",
    ),
    cloup.option("--layering", type=click.Choice(LAYERINGS), help="The meaning of --fraction, as in voxflat image."),
)
interpolation = cloup.option("--interpolation", type=click.Choice(["linear", "nearest"]), help="As in voxflat image.")


def of_data(overlay: Any, *further: Any) -> Callable[[_Command], _Command]:
    """Return the section on the data, and where they are sampled."""
    return options.section("Data", overlay, *of_depth, interpolation, *further)


def of_colours(*further: Any) -> Callable[[_Command], _Command]:
    """Return the section on which data are shown, and in which colours."""
    return options.section(
        "Colours",
        cloup.option(
            "--threshold",
            type=click.FloatRange(min=0),
            metavar="X",
            help="Show data only where their magnitude is greater than this: above X and below -X.",
        ),
        cloup.option("--above", type=float, metavar="X", help="Show data only where they are greater than this."),
        cloup.option(
            "--below",
            type=float,
            metavar="X",
            help="Show data only where they are less than this; with --above, beyond either where --below is the "
            "lesser one, else between them.",
        ),
        cloup.option(
            "--range",
            "limits",
            metavar="LO,HI",
            callback=_limits,
            help="Ends of the colours: values, or percentiles such as 2%,98%.  [default: 1%,99%; where the signs "
            "differ, the larger either way]",
        ),
        cloup.option(
            "--cmap",
            "colour_map",
            metavar="NAME",
            help="A colour map of matplotlib.  [default: viridis; RdBu_r about 0]",
        ),
        cloup.option("--label", metavar="TEXT", help="The text at the colour bar.  [default: the file's name]"),
        cloup.option("--unit", metavar="TEXT", help="The unit behind it."),
        *further,
    )


def of_page(*further: Any) -> Callable[[_Command], _Command]:
    """Return the section on everything around the data."""
    return options.section(
        "Page",
        cloup.option(
            "--underlay",
            type=click.Choice(["curvature", "sulcal depth", "none"]),
            default="curvature",
            help="What the folds are shown by.",
        ),
        cloup.option("--title", metavar="TEXT", help="Above the map."),
        *further,
    )


_OF_OVERLAY: tuple[str, ...] = ("channel", "interpolation", "threshold", "strength", "period", "zero", "limits")
_OF_OVERLAY += ("colour_map", "label", "time_step")


def each(files: tuple[Path, ...]) -> Any:
    """Return the only file of an option that may be given for each map, or all of them; None if there is none."""
    return files if len(files) > 1 else files[0] if files else None


def overlay_of(data: Any, given: dict[str, Any]) -> Overlay | None:
    """Take an overlay's options out of those of a command, and also those that nobody gave; `data` are its files."""
    from voxflat.figures import Overlay  # brings in matplotlib

    check_depth(given)
    for name in ("depth", "fraction", "layering"):
        if given[name] is None:
            del given[name]
    names = {"limits": "range", "colour_map": "cmap", "time_step": "time-step"}
    sides = given.pop("above"), given.pop("below")
    if sides != (None, None):
        if given["threshold"] is not None:
            raise click.UsageError("Give --threshold, or --above and --below.")
        given["threshold"], names["threshold"] = sides, "above" if sides[0] is not None else "below"
    unit, own = given.pop("unit"), {name: given.pop(name, None) for name in _OF_OVERLAY}
    own = {name: value for name, value in own.items() if value is not None}
    channel = given.pop("strength_channel", None)
    if data is None:
        unused = [f"--{names.get(name, name)}" for name in own if name != "zero"] + ["--unit"] * (unit is not None)
        if unused:
            raise click.UsageError(f"{', '.join(unused)}: only with --overlay.")
        return None
    if unit is not None:
        name = data[0].name if isinstance(data, tuple) else data.name
        own["label"] = f"{own.get('label') or name} ({unit})"
    if channel is not None:
        if "strength" not in own:
            raise click.UsageError("--strength-channel is for --strength.")
        own["strength"] = Overlay(own["strength"], channel)
    return Overlay(data, **own)
