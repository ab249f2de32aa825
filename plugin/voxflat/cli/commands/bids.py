"""The command `voxflat bids`."""

import json
from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options, study_options
from voxflat.cli.console import bars
from voxflat.cli.output import print_json
from voxflat.lab.group import group
from voxflat.lab.study import plan, study

_MAX_STATUS = 100  # greater exit statuses have other meanings in shells
_HEMIS = {"L": "lh", "R": "rh"}
_DASK = options.value(
    "--dask",
    "ADDRESS|FILE|local",
    "Process the participants on the workers of a Dask cluster: give the address or the file of its scheduler, or "
    '"local" for workers on this machine.',
)


@cloup.command(
    "bids",
    cls=study_options.MultipleValuesCommand,
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
    options.value(
        "--participant-label",
        "LABEL",
        "Process only these participants, with or without the prefix sub-. Several may be given.  [default: all]",
        "--participant_label",
        "labels",
        multiple=True,
    ),
    options.choice("--hemi", list(_HEMIS), "Hemispheres to process.", "hemis", multiple=True, default=tuple(_HEMIS)),
    options.flag("--dry-run", "Print what would be done, as one JSON object per hemisphere, and stop."),
)
@study_options.map_options
@options.section("Output", options.as_json)
@options.run(_DASK, options.seed, options.threads, options.memory_limit, options.quiet)
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
    """Flatten all participants of a study (BIDS App).

    BIDS_DIR contains FreeSurfer subjects, sMRIPrep or fMRIPrep derivatives, or white-matter masks, either directly or
    in derivatives/ or sourcedata/freesurfer. At the level "participant", voxflat writes BIDS derivatives such as
    sub-01_hemi-L_desc-voxflat_flat.surf.gii to OUT, and one report per participant. Results are skipped if they are up
    to date according to the checksums of the inputs and the parameters. A participant that fails does not stop the
    others. The level "group" writes a table of all measures, means over standard maps, and a page of all maps.

    The exit status is the number of participants that failed (at most 100). If nothing could be processed at all, it
    is 1 or 2, as for the other commands.
    """
    parameters = study_options.parameters_of(given)
    if dask and (dry_run or level == "group"):
        raise click.UsageError("--dask requires the level participant and cannot be combined with --dry-run.")
    chosen = [_HEMIS[letter] for letter in dict.fromkeys(hemis)]
    if dry_run:
        if level == "group":
            raise click.UsageError("--dry-run requires the level participant.")
        for one in plan(source, out, chosen, parameters, labels):
            planned = {"participant": one.name, "hemi": one.letter, "state": one.state, "reason": one.reason or None}
            click.echo(json.dumps(planned))
        return 0
    if level == "group":
        _group(source, out, labels, as_json, quiet)
        return 0
    with bars(quiet, notes=False) as shown:  # the warnings about each map are in its report
        tell = study_options.outcome_printer(shown, verbose=not (as_json or quiet))
        how: dict[str, Any] = {"labels": labels, "tell": tell, "dask": dask, "progress": shown.progress, **given}
        outcomes = study(source, out, chosen, parameters, **how)
    everybody = {one.name for one in outcomes}
    failed = {one.name for one in outcomes if one.state == "failed"}
    if as_json:
        print_json({"output": str(out), "failed": sorted(failed), "hemispheres": study_options.as_list(outcomes)})
    elif not quiet:
        made = len({one.name for one in outcomes if one.state == "made"} - failed)
        up_to_date = len(everybody) - made - len(failed)
        click.echo(f"{len(everybody)} participants: {made} made, {up_to_date} up to date, {len(failed)} failed")
    return min(len(failed), _MAX_STATUS)


def _group(source: Path, out: Path, labels: tuple[str, ...], as_json: bool, quiet: bool) -> None:
    found = group(source, out, labels)
    if as_json:
        print_json({"output": str(out), **found})
    elif not quiet:
        state = f"written: {', '.join(found['written'])}" if found["written"] else "up to date"
        click.echo(f"{found['maps']} maps, {len(found['missing'])} missing, {len(found['outliers'])} outliers")
        click.echo(state)
