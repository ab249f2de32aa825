"""The command `voxflat bids`."""

import json
from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import labs, options
from voxflat.cli.console import bars
from voxflat.cli.output import print_json
from voxflat.lab.group import group
from voxflat.lab.study import plan, study

_MOST = 100  # of an exit status: greater ones mean something else to shells
_HEMIS = {"L": "lh", "R": "rh"}


@cloup.command(
    "bids",
    cls=labs.Several,
    epilog="""\b
Examples:
  voxflat bids study study/derivatives/voxflat participant
  voxflat bids $SUBJECTS_DIR maps participant --participant-label 01 02 --overlay thickness curv
  voxflat bids study maps participant --dry-run
  voxflat bids study maps participant --dask tcp://node1:8786
  voxflat bids study maps group
""",
)
@cloup.argument("source", metavar="BIDS_DIR", type=click.Path(path_type=Path))
@cloup.argument("out", metavar="OUT", type=click.Path(path_type=Path))
@cloup.argument("level", metavar="participant|group", type=click.Choice(["participant", "group"]))
@options.section(
    "Participants",
    cloup.option(
        "--participant-label",
        "--participant_label",
        "labels",
        multiple=True,
        metavar="LABEL",
        help="Only these, with or without sub-; several after each other.  [default: all]",
    ),
    cloup.option(
        "--hemi",
        "hemis",
        type=click.Choice(list(_HEMIS)),
        multiple=True,
        default=tuple(_HEMIS),
        help="Which hemispheres.",
    ),
    cloup.option(
        "--dry-run", is_flag=True, help="Say what would be done, one JSON object per hemisphere, and do nothing."
    ),
)
@labs.making
@options.section("Output", options.as_json)
@options.run(options.dask, options.seed, options.threads, options.memory_limit, options.quiet)
def command(
    source: Path,
    out: Path,
    level: str,
    labels: tuple[str, ...],
    hemis: tuple[str, ...],
    dry_run: bool,
    dask: str | None,
    as_json: bool,
    quiet: bool,
    **given: Any,
) -> int:
    """Flatten all participants of a study, as a BIDS-App.

    BIDS_DIR holds directories of FreeSurfer, derivatives of sMRIPrep or fMRIPrep, or masks of white matter, itself, in
    derivatives/ or in sourcedata/freesurfer. OUT gets derivatives of BIDS, sub-*_hemi-L_desc-voxflat_flat.surf.gii and
    others, and a report a participant. What is up to date, by the checksums of what is read and the parameters, is not
    made again; one participant who fails never stops the others. The exit status is the number of participants that
    failed (at most 100), and as of the other commands where nothing could be done at all. The level group writes a
    table of every measure, means over standard maps, and a page of all maps.
    """
    parameters = labs.parameters_of(given)
    if dask and (dry_run or level == "group"):
        raise click.UsageError("--dask is for the level participant, without --dry-run.")
    chosen = [_HEMIS[letter] for letter in dict.fromkeys(hemis)]
    if dry_run:
        if level == "group":
            raise click.UsageError("--dry-run is for the level participant.")
        for one in plan(source, out, chosen, parameters, labels):
            told = {"participant": one.name, "hemi": one.letter, "state": one.state, "reason": one.reason or None}
            click.echo(json.dumps(told))
        return 0
    if level == "group":
        _group(source, out, labels, as_json, quiet)
        return 0
    with bars(quiet, hushed=True) as shown:  # what is said of each map stands in its report
        tell = labs.teller(shown, is_told=not (as_json or quiet))
        how: dict[str, Any] = {"labels": labels, "tell": tell, "dask": dask, "progress": shown.progress, **given}
        outcomes = study(source, out, chosen, parameters, **how)
    everybody = {one.name for one in outcomes}
    failed = {one.name for one in outcomes if one.state == "failed"}
    if as_json:
        print_json({"output": str(out), "failed": sorted(failed), "hemispheres": labs.as_list(outcomes)})
    elif not quiet:
        made = len({one.name for one in outcomes if one.state == "made"} - failed)
        up_to_date = len(everybody) - made - len(failed)
        click.echo(f"{len(everybody)} participants: {made} made, {up_to_date} up to date, {len(failed)} failed")
    return min(len(failed), _MOST)


def _group(source: Path, out: Path, labels: tuple[str, ...], as_json: bool, quiet: bool) -> None:
    found = group(source, out, labels)
    if as_json:
        print_json({"output": str(out), **found})
    elif not quiet:
        state = f"written: {', '.join(found['written'])}" if found["written"] else "up to date"
        click.echo(f"{found['maps']} maps, {len(found['missing'])} missing, {len(found['outliers'])} stand out")
        click.echo(state)
