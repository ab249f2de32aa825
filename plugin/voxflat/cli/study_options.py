"""Shared parts of `voxflat freesurfer` and `voxflat bids`: options for the maps, and how outcomes are printed."""

from collections.abc import Callable
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import Bars
from voxflat.lab.inputs import GEOMETRIES, Parameters


class MultipleValuesCommand(cloup.Command):
    """A command whose repeatable options also accept several values after one flag, as BIDS Apps do."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Repeat the option's name before each further value, as long as the value is one of its choices."""
        several = {name: own for own in self.params if getattr(own, "multiple", False) for name in own.opts}
        words: list[str] = []
        option = ""
        for word in args:
            if word.startswith("-"):
                option = word if word in several else ""
            elif option and words[-1] != option:
                kind = several[option].type
                if isinstance(kind, click.Choice) and word not in kind.choices:
                    option = ""
                else:
                    words.append(option)
            words.append(word)
        return super().parse_args(ctx, words)


map_options = options.section(
    "Maps",
    options.value(
        "--cuts",
        "standard|automatic|FILE",
        "Where the surfaces are cut: along the same lines in every brain (standard, needs a registered sphere), "
        "as suits each surface best (automatic), or as in a file of cuts or a template. {hemi} in the name of FILE "
        "is replaced by the hemisphere.",
        default=Parameters.cuts,
    ),
    options.choice(
        "--geometry", GEOMETRIES, "Surface on which distances are preserved and measured.", default=Parameters.geometry
    ),
    options.flag(
        "--volume",
        "Start from a white-matter volume instead of surfaces: mri/filled.mgz, or in BIDS derivatives a mask or "
        "probability map (label-WM_mask or label-WM_probseg).",
    ),
    options.value(
        "--overlay",
        "F",
        "Data to show on the maps: a name such as thickness or curv, a file of values, or a volume. Several may "
        "be given; {hemi} and {subject} in the name of a file are replaced.  [default: thickness, if present]",
        "overlays",
        multiple=True,
    ),
)
"""The options that say how the map of each hemisphere is made."""


def parameters_of(given: dict[str, Any]) -> Parameters:
    """Remove the options for maps from those of a command, and return them as parameters."""
    cuts, overlays = given.pop("cuts"), tuple(given.pop("overlays"))
    own = {name: given.pop(name) for name in ("geometry", "volume", "seed")}
    return Parameters(cuts=cuts, overlays=overlays, **own)


def outcome_printer(shown: Bars, *, verbose: bool) -> Callable[[Any], None]:
    """Return a function that prints the outcome of a hemisphere; failures are always printed on stderr."""

    def tell(one: Any) -> None:
        begin = f"{one.name} {one.hemi}"
        if one.state == "failed":
            shown.hide()
            click.echo(f"voxflat: {begin}: error: {one.reason}", err=True)
        elif verbose and one.record is None:
            shown.tell(f"{begin}: up to date")
        elif verbose:
            error, seconds = one.record["figures"]["best_scale"]["relative_error"], sum(one.record["seconds"].values())
            points = one.record["map"]["points"]
            shown.tell(f"{begin}: {points} points, relative distance error {100 * error:.1f} %, {seconds:.1f} s")

    return tell


def as_list(outcomes: list[Any]) -> list[dict[str, Any]]:
    """Return outcomes as dictionaries for JSON."""
    return [
        {
            **{"participant": one.name, "hemi": one.letter, "state": one.state, "reason": one.reason or None},
            **({} if one.record is None else {name: one.record[name] for name in ("outputs", "figures", "warnings")}),
        }
        for one in outcomes
    ]
