"""Options of commands that draw data over the folds: where they are sampled, and their colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from voxflat.cli import options
from voxflat.maps.depth import LAYERINGS

__all__ = ["checked_look", "of_colours", "of_depth", "of_page"]


def _limits(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    if value is None:
        return None
    ends = tuple(part.strip() for part in value.split(","))
    if len(ends) != 2:
        raise click.BadParameter(f"{value!r} is no pair such as 0,5 or 2%,98%", param=parameter)
    return ends


of_depth = options.group(
    click.option(
        "--depth",
        metavar="MM[,MM...]",
        callback=options.numbers,
        help="How far outside the surface to sample volumes, mm; of several the mean, of labels the most frequent.  "
        "[default: 0]",
    ),
    click.option(
        "--fraction",
        metavar="F[,F...]",
        callback=options.numbers,
        help="Instead of --depth, of maps made with --pial: how much of the cortex lies below, from 0 to 1.",
    ),
    click.option("--layering", type=click.Choice(LAYERINGS), help="What --fraction is of, as in voxflat image."),
    click.option("--interpolation", type=click.Choice(["linear", "nearest"]), help="As in voxflat image."),
)
"""Where volumes are sampled."""

of_colours = options.group(
    click.option("--above", type=float, metavar="X", help="Show data only where they are greater."),
    click.option(
        "--below",
        type=float,
        metavar="X",
        help="Show data only where they are less; with --above beyond either if X is the lesser one, else between "
        "them.",
    ),
    click.option(
        "--range",
        "limits",
        metavar="LO,HI",
        callback=_limits,
        help="Ends of the colours: values, or percentiles such as 2%,98%.  [default: 1%,99%; where the signs differ, "
        "the larger either way]",
    ),
    click.option("--cmap", metavar="NAME", help="A colour map of matplotlib.  [default: viridis, RdBu_r about 0]"),
)
"""Which data are shown, and in which colours."""

of_page = options.group(
    click.option("--label", metavar="TEXT", help="What the colour bar says.  [default: the file's name]"),
    click.option("--unit", metavar="TEXT", help="The unit behind it."),
    click.option(
        "--underlay",
        type=click.Choice(["curvature", "sulcal depth", "none"]),
        default="curvature",
        help="What the folds are shown by.",
    ),
    click.option("--title", metavar="TEXT", help="Above the map."),
)
"""What stands around the data."""


def checked_look(look: dict[str, Any], overlay: Path | None) -> dict[str, Any]:
    """Return the options above as the functions that draw take them.

    Parameters
    ----------
    look : dict
        What the command was given.
    overlay : Path or None
        The data.

    Returns
    -------
    dict
    """
    told = dict(look)
    if told["depth"] is not None and told["fraction"] is not None:
        raise click.UsageError("Give --depth or --fraction.")
    if told["layering"] is not None and told["fraction"] is None:
        raise click.UsageError("--layering is for --fraction.")
    for name in ("depth", "fraction", "layering"):
        if told[name] is None:
            del told[name]
    unit = told.pop("unit")
    if unit is not None:
        told["label"] = f"{told['label'] or (overlay.name if overlay else '')} ({unit})"
    told["colour_map"] = told.pop("cmap")
    return told
