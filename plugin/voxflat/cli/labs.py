"""What the commands for labs share: options that take several values, what is to be made, and how it is told."""

from collections.abc import Callable
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import Bars
from voxflat.lab.inputs import GEOMETRIES, Parameters

_CUTS = {"auto": "automatic"}


class Several(cloup.Command):
    """A command whose options that may be given again also take several values at once, as BIDS-Apps' do."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give such an option again before each further value; of a choice only what may be chosen is one."""
        several = {name: own for own in self.params if getattr(own, "multiple", False) for name in own.opts}
        told: list[str] = []
        option = ""
        for word in args:
            if word.startswith("-"):
                option = word if word in several else ""
            elif option and told[-1] != option:
                kind = several[option].type
                if isinstance(kind, click.Choice) and word not in kind.choices:
                    option = ""
                else:
                    told.append(option)
            told.append(word)
        return super().parse_args(ctx, told)


making = options.section(
    "Maps",
    cloup.option(
        "--cuts",
        default=Parameters.cuts,
        metavar="standard|auto|FILE",
        help="Cut along standard lines, by the registered sphere; or where it suits each surface best; or as in a file "
        "of cuts or a template, in whose name {hemi} is filled in.",
    ),
    cloup.option(
        "--geometry",
        type=click.Choice(GEOMETRIES),
        default=Parameters.geometry,
        help="The surface on which distances are preserved and measured.",
    ),
    cloup.option(
        "--volume",
        is_flag=True,
        help="Start from white matter in voxels instead of surfaces: mri/filled.mgz, or *_hemi-L_label-WM_mask.nii.gz "
        "(or _probseg).",
    ),
    cloup.option(
        "--overlay",
        "overlays",
        multiple=True,
        metavar="F",
        help="Data to show on the maps, several after each other: a name such as thickness or curv, or a file of "
        "values or a volume, in whose name {hemi} and {subject} are filled in.  [default: thickness, if any]",
    ),
)
"""What is made of each hemisphere."""


def parameters_of(given: dict[str, Any]) -> Parameters:
    """Take what is to be made of each hemisphere out of what is given."""
    cuts, overlays = given.pop("cuts"), tuple(given.pop("overlays"))
    own = {name: given.pop(name) for name in ("geometry", "volume", "seed")}
    return Parameters(cuts=_CUTS.get(cuts, cuts), overlays=overlays, **own)


def teller(shown: Bars, *, is_told: bool) -> Callable[[Any], None]:
    """Return what says what became of a hemisphere: failures on stderr, in any case."""

    def tell(one: Any) -> None:
        begin = f"{one.name} {one.hemi}"
        if one.state == "failed":
            shown.hide()
            click.echo(f"voxflat: {begin}: error: {one.reason}", err=True)
        elif is_told and one.record is None:
            shown.tell(f"{begin}: up to date")
        elif is_told:
            error, seconds = one.record["figures"]["raw"]["relative_error"], sum(one.record["seconds"].values())
            shown.tell(f"{begin}: {one.record['map']['points']} points, error {100 * error:.1f} %, {seconds:.1f} s")

    return tell


def as_list(outcomes: list[Any]) -> list[dict[str, Any]]:
    """Return outcomes, ready for JSON."""
    return [
        {
            **{"participant": one.name, "hemi": one.letter, "state": one.state, "reason": one.reason or None},
            **({} if one.record is None else {name: one.record[name] for name in ("outputs", "figures", "warnings")}),
        }
        for one in outcomes
    ]
