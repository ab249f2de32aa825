"""Define options of commands that draw data over the folds; they set how the data are sampled and shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from voxflat.cli import options
from voxflat.maps.depth import LAYERINGS

if TYPE_CHECKING:
    from voxflat.figures import Overlay

_Command = TypeVar("_Command", bound=Callable[..., Any])


def check_depth(settings: dict[str, Any]) -> None:
    """Raise a usage error if the depth options contradict each other."""
    places = [name for name in ("depth", "fraction", "depths") if settings.get(name) is not None]
    if len(places) > 1:
        raise click.UsageError(f"--{places[0]} and --{places[1]} cannot be combined. Pass only one of them.")
    if settings["layering"] is not None and places in ([], ["depth"]):
        raise click.UsageError(f"--layering requires --fraction{' or --depths' if 'depths' in settings else ''}.")


def _limits(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    if value is None:
        return None
    ends = tuple(part.strip() for part in value.split(","))
    if len(ends) != 2:
        raise click.BadParameter(f"{value!r} is not a pair of limits. Pass two limits, such as 0,5 or 2%,98%.")
    return ends


def depth_options(several: str) -> tuple[Callable[..., Any], ...]:
    """Return the options for the depth at which volumes are sampled; `several` explains the use of several depths."""
    depth = "Distance from the surface, in the unit of the map, at which volumes are sampled: positive outside, "
    depth += "negative inside. -10:10:1 stands for -10, -9, ..., 10."
    fraction = "Cortical depth from 0 (white surface) to 1 (pial surface). Replaces --depth for maps made with --pial."
    layering = "Interpret --fraction as a share of the cortical volume (equivolume) or of the thickness (equidistant)."
    return (
        options.value("--depth", "D[,D...]", f"{depth} {several}  [default: 0]", callback=options.numbers),
        options.value("--fraction", "F[,F...]", f"{fraction} {several}", callback=options.numbers),
        options.choice("--layering", LAYERINGS, f"{layering}  [default: equivolume]"),
    )


def data_section(overlay: Any, *further: Any, interpolation: str) -> Callable[[_Command], _Command]:
    """Return the section of options that specify the data and how they are sampled."""
    help_ = f"Interpolation between voxels.  [default: {interpolation}]"
    between = options.choice("--interpolation", ["linear", "nearest"], help_)
    depths = depth_options("With several depths, the mean value or the most frequent label is shown.")
    return options.section("Data", overlay, *depths, between, *further)


def colour_section(*further: Any) -> Callable[[_Command], _Command]:
    """Return the section of options for thresholds and colours."""
    return options.section(
        "Colours",
        options.value("--threshold", "X", "Show only values above X or below -X.", type=options.NOT_NEGATIVE),
        options.value("--above", "X", "Show only values greater than X.", type=options.NUMBER),
        options.value(
            "--below",
            "X",
            "Show only values less than X. If both --above and --below are given, values outside the two limits are "
            "shown if --below is smaller than --above, and values between them otherwise.",
            type=options.NUMBER,
        ),
        options.value(
            "--range",
            "LO,HI",
            "Values at the two ends of the colour scale, as numbers or as percentiles such as 2%,98%.  [default: "
            "1%,99%, made symmetric about 0 if their signs differ]",
            "limits",
            callback=_limits,
        ),
        options.value(
            "--cmap", "NAME", "Matplotlib colour map.  [default: viridis, or RdBu_r if LO < 0 < HI]", "colour_map"
        ),
        options.value("--label", "TEXT", "Label of the colour bar.  [default: the file name]"),
        options.value("--unit", "TEXT", "Unit of the data, added in parentheses to the label of the colour bar."),
        *further,
    )


def page_section(*further: Any) -> Callable[[_Command], _Command]:
    """Return the section of options for the background, the title and other elements of the page."""
    kinds, help_ = ("curvature", "sulcal depth", "none"), "Measure to show in grey beneath the data."
    underlay = options.choice("--underlay", kinds, help_, default=kinds[0])
    return options.section("Page", underlay, options.value("--title", "TEXT", "Title above the map."), *further)


_OF_OVERLAY: tuple[str, ...] = ("channel", "interpolation", "threshold", "strength", "period", "zero", "limits")
_OF_OVERLAY += ("colour_map", "label", "time_step")


def one_or_all(files: tuple[Path, ...]) -> Any:
    """Return the file of an option, a tuple of files if the option was given several times, or None."""
    return files if len(files) > 1 else files[0] if files else None


def overlay_of(data: Any, settings: dict[str, Any]) -> Overlay | None:
    """Remove the overlay options from the command's options, and return the overlay of the files `data`."""
    from voxflat.figures import Overlay  # imports matplotlib

    check_depth(settings)
    for name in ("depth", "fraction", "layering"):
        if settings[name] is None:
            del settings[name]
    names = {"limits": "range", "colour_map": "cmap", "time_step": "time-step"}
    sides = settings.pop("above"), settings.pop("below")
    if sides != (None, None):
        if settings["threshold"] is not None:
            raise click.UsageError("--threshold cannot be combined with --above or --below. Omit --threshold.")
        settings["threshold"], names["threshold"] = sides, "above" if sides[0] is not None else "below"
    unit, looks = settings.pop("unit"), {name: settings.pop(name, None) for name in _OF_OVERLAY}
    looks = {name: value for name, value in looks.items() if value is not None}
    channel = settings.pop("strength_channel", None)
    if channel is not None and "strength" not in looks:
        raise click.UsageError("--strength-channel requires --strength.")
    if data is None:
        unused = [f"--{names.get(name, name)}" for name in looks if name != "zero"] + ["--unit"] * (unit is not None)
        if unused:
            raise click.UsageError(f"{', '.join(unused)}: only with --overlay. Also pass --overlay.")
        return None
    if unit is not None:
        name = data[0].name if isinstance(data, tuple) else data.name
        looks["label"] = f"{looks.get('label') or name} ({unit})"
    if channel is not None:
        looks["strength"] = Overlay(looks["strength"], channel)
    return Overlay(data, **looks)
