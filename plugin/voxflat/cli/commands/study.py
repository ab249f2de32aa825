"""The commands `voxflat bids` and `voxflat freesurfer`, which flatten the hemispheres of participants."""

import json
import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import Bars, Command, bars, translated
from voxflat.cli.output import is_json, report
from voxflat.errors import Cancelled, InputError
from voxflat.lab.comparison import LEAST
from voxflat.lab.group import group
from voxflat.lab.inputs import GEOMETRIES, Parameters, Participant, check_given, check_order, participants
from voxflat.lab.layouts import HEMISPHERES, SPACES
from voxflat.lab.results import COUNTS
from voxflat.lab.study import Job, Outcome, check_output, command, freesurfer, plan, study, warn_of_changes
from voxflat.surfaces.standard.choice import AUTOMATIC
from voxflat.surfaces.standard.template import STANDARD
from voxflat.wording import many

_MAX_STATUS = 100  # greater exit statuses have other meanings in shells
_RECORDED = ("outputs", "figures", "warnings", "notes")  # parts of a record that --json prints
_HEMIS = {"left": ("lh",), "right": ("rh",), "both": ("lh", "rh")}
_SPACE = options.choice(
    "--space",
    SPACES,
    "Surfaces to flatten if a participant has several: those of the reconstruction (native), or those on the 32k mesh "
    "of fs_LR, whose vertices are the grayordinates of CIFTI files (fsLR).  [default: native, if present]",
)
_HEMISPHERE = options.value(
    "--hemisphere",
    "[left|right|both]",
    "Hemispheres to process.",
    "--hemi",
    "hemis",
    type=options.SIDES,
    multiple=True,
    default=("both",),
)
_DASK = options.value(
    "--dask",
    "ADDRESS|FILE|local",
    'Dask cluster that processes the participants: the scheduler address, a scheduler file, or "local" for workers on '
    "this machine.",
)
_MAPS = options.section(
    "Maps",
    options.value(
        "--cuts",
        "standard|automatic|FILE",
        'How to cut the surfaces: along the same lines in every brain ("standard", which requires a registered '
        'sphere), along lines chosen for each surface ("automatic"), or along the cuts in a cuts file or template. '
        "{hemi} in the name of FILE is replaced with the hemisphere.",
        default=Parameters.cuts,
    ),
    options.choice(
        "--geometry", GEOMETRIES, "Surface on which distances are preserved and measured.", default=Parameters.geometry
    ),
    options.flag(
        "--volume",
        "Start from a white-matter volume instead of surfaces: mri/filled.mgz or, in BIDS derivatives, a mask or "
        "probability map (label-WM_mask or label-WM_probseg).",
    ),
    options.value(
        "--overlay",
        "F",
        "Data to show on the maps: a measure such as thickness or curv, a file of values, or a volume. Several "
        "overlays may be given. {hemi} and {subject} in a file name are replaced with the hemisphere and the subject.  "
        "[default: thickness, if present]",
        "overlays",
        multiple=True,
    ),
    options.reads(
        "--template",
        "Also measure this flat map of a template, such as that of fs_LR, on each subject, whose surface is resampled "
        "to the template's mesh. Pass one file per hemisphere, with the hemisphere in its name.",
        metavar="FLAT",
        multiple=True,
    ),
    options.reads(
        "--template-sphere",
        "Registered sphere of the template's mesh, in the space of the subjects' spheres, one file per hemisphere.",
        metavar="SPHERE",
        multiple=True,
    ),
)


class _MultipleValuesCommand(Command):
    """Command whose repeatable options also accept several values after one flag, as in BIDS Apps."""

    synonyms: ClassVar[dict[str, str]] = dict.fromkeys(("sub", "subject", "label"), "participant-label")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Repeat the option's name before each additional value, as long as the value is one of its choices."""
        several = {name: option for option in self.params if getattr(option, "multiple", False) for name in option.opts}
        words: list[str] = []
        option = ""
        for word in args:
            if word.startswith("-"):
                option = word if word in several else ""
            elif option and words[-1] != option:
                kind = several[option].type
                try:
                    if isinstance(kind, click.Choice):
                        kind.convert(word, several[option], ctx)
                    words.append(option)
                except click.BadParameter:  # an argument of the command
                    option = ""
            words.append(word)
        greedy = [name for name in several if words.count(name) > args.count(name)]
        try:
            return super().parse_args(ctx, words)
        except click.MissingParameter as error:
            if greedy and isinstance(error.param, click.Argument):
                order = [str(argument.metavar) for argument in self.params if isinstance(argument, click.Argument)]
                remedy = f"Write the arguments before it: {' '.join([ctx.command_path, *order, greedy[0]])} ..."
                problem = f"Missing argument {error.param.metavar}: {greedy[0]} uses all words that follow it. {remedy}"
                raise click.UsageError(problem, ctx) from None
            raise


@options.command(
    "bids",
    "voxflat bids study study/derivatives/voxflat participant",
    "voxflat bids $SUBJECTS_DIR maps participant --participant-label 01 02 --overlay thickness curv",
    "voxflat bids study maps participant --dry-run",
    "voxflat bids study maps participant --dask tcp://node1:8786",
    "voxflat bids study maps group",
    cls=_MultipleValuesCommand,
)
@cloup.argument("source", metavar="BIDS_DIR", type=click.Path(path_type=Path))
@cloup.argument("out", metavar="OUT", type=click.Path(path_type=Path))
@cloup.argument("level", metavar="participant|group", type=click.Choice(["participant", "group"]))
@options.section(
    "Participants",
    options.value(
        "--participant-label",
        "LABEL",
        "Labels of the participants to process, with or without the prefix sub-. Several labels may be given.  "
        "[default: all]",
        "--participant_label",
        "labels",
        multiple=True,
    ),
    _HEMISPHERE,
    _SPACE,
    options.flag("--dry-run", "Print the planned work as one JSON object per hemisphere, and exit."),
)
@_MAPS
@options.section("Output", options.as_json)
@options.run(_DASK, options.seed, options.threads, options.memory_limit, options.quiet)
def bids_command(
    source: Path,
    out: Path,
    level: str,
    labels: tuple[str, ...],
    hemis: tuple[str, ...],
    space: str | None,
    dry_run: bool,
    dask: str | None,
    quiet: bool,
    **settings: Any,
) -> int:
    """Flatten all participants of a study (BIDS App).

    BIDS_DIR contains FreeSurfer subjects, sMRIPrep or fMRIPrep derivatives, subjects of the HCP pipelines, or
    white-matter masks, either at the top level or in derivatives/ or sourcedata/freesurfer. At the "participant" level,
    voxflat writes BIDS derivatives, such as sub-01_hemi-L_flat.surf.gii, and one report per participant to OUT. Results
    are not recomputed if they are up to date according to the parameters and the checksums of the inputs. If a
    participant fails, the others are still processed. At the "group" level, voxflat writes a table of all measures,
    images of the means over maps with standard cuts, and a page that shows all maps.

    The exit status is the number of participants that failed or, at the "group" level, that lack a map (at most 100).
    If no participant could be processed, the exit status is 1 or 2, as for the other commands.
    """
    if level == "group":
        _refuse_at_group({"dry_run", "dask", *settings})
    if dask and dry_run:
        raise click.UsageError("--dask cannot be combined with --dry-run.")
    parameters = _parameters(settings)
    chosen = _chosen(hemis)
    try:
        everybody = participants(source, [label for text in labels for label in text.split(",")], space)
        check_output(source, out)
    except InputError:
        check_order(source, out)
        raise
    if level == "participant":
        check_given(everybody, chosen, parameters, source)
    if dry_run:
        for outcome in plan(everybody, out, chosen, parameters):
            click.echo(json.dumps(_listed(outcome)))
        return 0
    if level == "group":
        result = group(everybody, source, out, chosen, is_study=not labels, space=space)
        state = f"written: {len(result['written'])} files in {out}" if result["written"] else "up to date"
        for name, reason in result["missing"].items():
            click.echo(f"voxflat: {name}: error: {reason}", err=True)
        lines = [f"maps: {result['counted']}", *_outlier_lines(result), f"report: {out / 'group.html'}", state]
        report({"output": str(out), **result}, "\n".join(lines), quiet=quiet)
        return min(len(result["failed"]), _MAX_STATUS)
    warn_of_changes([Job.of(person, out) for person in everybody], chosen, parameters)
    with bars(quiet, notes=False) as bar:  # outcomes contain the warnings; the report also shows the notes
        tell = _outcome_printer(bar, quiet=quiet)
        waits = partial(_say, bar, quiet)
        common: dict[str, Any] = {"tell": tell, "waits": waits, "dask": dask, "progress": bar.progress}
        try:
            outcomes = study(everybody, source, out, chosen, parameters, **common, **settings)
        except (Cancelled, KeyboardInterrupt):
            bar.hide()
            click.echo("voxflat: finished maps are kept. Repeat the command to make the others", err=True)
            raise
    people = {_participant(outcome) for outcome in outcomes}
    failed = {_participant(outcome) for outcome in outcomes if outcome.state == "failed"}
    count = len({_participant(outcome) for outcome in outcomes if outcome.state == "made"} - failed)
    states = f"{count} made, {len(people) - count - len(failed)} up to date, {len(failed)} failed"
    content = {"output": str(out), "failed": sorted(failed), "hemispheres": [_listed(outcome) for outcome in outcomes]}
    only = "" if len(chosen) > 1 else f" (only {HEMISPHERES[chosen[0]][1]} hemispheres, because of --hemisphere)"
    summary = f"{many(len(people), 'participant')}: {states}{only}"
    report(content, "\n".join([summary, *_report_lines(source, out, everybody, space)]), quiet=quiet)
    return min(len(failed), _MAX_STATUS)


@options.command(
    "freesurfer",
    "voxflat freesurfer $SUBJECTS_DIR/sub-01",
    "voxflat freesurfer sub-01 --hemi lh --overlay thickness curv",
    "voxflat freesurfer sub-01 --overlay {hemi}.zstat.mgz --cuts automatic --json",
    cls=_MultipleValuesCommand,
)
@cloup.argument("subject", metavar="SUBJECT_DIR", type=click.Path(path_type=Path))
@options.section(
    "Hemispheres",
    _HEMISPHERE,
)
@_MAPS
@options.section("Output", options.as_json)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def freesurfer_command(subject: Path, hemis: tuple[str, ...], quiet: bool, **settings: Any) -> int:
    """Flatten a FreeSurfer subject and write a report.

    voxflat reads surf/?h.white, ?h.pial, ?h.sphere.reg, ?h.thickness and label/?h.cortex.label (or ?h.aparc.annot), and
    reports missing files. It writes the map to surf/?h.voxflat.flat.patch.3d, .surf.gii, .npz (the complete map) and
    .json (distortion and provenance), vertex-wise measures and overlays to surf/?h.voxflat.*.shape.gii, and the report
    to voxflat.html. Results are not recomputed if they are up to date according to the parameters and the checksums of
    the inputs. The exit status is 1 if a hemisphere could not be flattened.
    """
    parameters = _parameters(settings)
    with bars(quiet) as bar:
        tell = _outcome_printer(bar, quiet=quiet, notes=True)
        outcomes = freesurfer(subject, _chosen(hemis), parameters, tell=tell, progress=bar.progress, **settings)
    page = str(subject / "voxflat.html")
    failed = [outcome for outcome in outcomes if outcome.state == "failed"]
    content = {"subject": str(subject), "report": page, "hemispheres": [_listed(outcome) for outcome in outcomes]}
    report(content, f"report: {page}", quiet=quiet or len(failed) == len(outcomes))
    return 1 if failed else 0


def _refuse_at_group(names: Collection[str]) -> None:
    """Raise an error if one of these options, which only the level participant uses, is given."""
    ctx = click.get_current_context()
    for option in ctx.command.params:
        is_given = ctx.get_parameter_source(option.name or "") is click.core.ParameterSource.COMMANDLINE
        if is_given and option.name in names:
            raise click.UsageError(f"{option.opts[0]} requires the level participant.")


def _outlier_lines(result: Mapping[str, Any]) -> list[str]:
    """Return lines that count the outlying values of a group, and its maps with errors."""
    values = [place for places in result["outliers"].values() for place in places if place not in COUNTS]
    people = sum(bool(places.keys() - set(COUNTS)) for places in result["outliers"].values())
    wrong = sum(bool(places.keys() & set(COUNTS)) for places in result["outliers"].values())
    chance, which = result["outliers_by_chance"], "flipped or covering triangles or boundary crossings"
    counted = f"{many(len(values), 'value')} of {many(people, 'hemisphere')} (about {chance:.2g} expected by chance)"
    lines = [f"outliers: {counted if chance else f'not determined; they require {LEAST} maps of one side'}"]
    return lines + ([f"errors: {wrong} {'map has' if wrong == 1 else 'maps have'} {which}"] if wrong else [])


def _report_lines(source: Path, out: Path, everybody: Sequence[Participant], space: str | None) -> list[str]:
    """Return lines that name the reports of participants and the next command."""
    pages = [page for person in everybody if (page := Job.of(person, out).page).is_file()]
    if not pages:
        return []
    named = f"report: {pages[0]}" if len(pages) == 1 else f"reports: {len(pages)} pages, such as {pages[0]}"
    return [named, f"next: {command(source, out, 'group', space)}"]


def _participant(outcome: Outcome) -> str:
    """Return the name of a participant without the session."""
    return outcome.name.partition("_ses-")[0]


def _chosen(sides: tuple[str, ...]) -> list[str]:
    """Return lh, rh or both, in the order in which they were given."""
    return list(dict.fromkeys(hemi for side in sides for hemi in _HEMIS[side]))


def _parameters(settings: dict[str, Any]) -> Parameters:
    """Remove the map options from the command's options, and return them as parameters.

    Cuts that would make every hemisphere fail are refused.
    """
    is_word = re.fullmatch(r"\w+", settings["cuts"]) and settings["cuts"] not in (STANDARD, AUTOMATIC)
    if is_word and not Path(settings["cuts"]).exists():
        remedy = f'Pass "{STANDARD}", "{AUTOMATIC}" or the name of a file'
        raise click.BadParameter(f"{settings['cuts']!r} is not a kind of cuts. {remedy}.", param_hint="--cuts")
    cuts, overlays = settings.pop("cuts"), tuple(settings.pop("overlays"))
    rest = {name: settings.pop(name) for name in ("geometry", "volume", "seed")}
    for name in ("template", "template_sphere"):
        rest[name] = tuple(os.path.abspath(path) for path in settings.pop(name)) or None
    return Parameters(cuts=cuts, overlays=overlays, **rest)


def _say(bar: Bars, quiet: bool, message: str) -> None:
    """Print a message on stderr above the progress bar."""
    bar.hide()
    if not quiet:
        click.echo(f"voxflat: {message}", err=True)


def _outcome_printer(bar: Bars, *, quiet: bool, notes: bool = False) -> Callable[[Outcome], None]:
    """Return a function that prints the outcome of a hemisphere; the warnings on new maps, and failures, go to stderr.

    With `notes`, the notes on new maps are printed, too. Failures are printed even if `quiet`.
    """

    def tell(outcome: Outcome) -> None:
        begin = f"{outcome.name} {HEMISPHERES[outcome.hemi][0]}"
        record: Any = outcome.record or {"notes": [], "warnings": []}
        if outcome.state == "failed":
            bar.tell(f"voxflat: {begin}: error: {outcome.reason}", err=True)
        if quiet or outcome.state == "failed":
            return
        is_made, warnings = outcome.state == "made", record["warnings"]
        for note in record["notes"] if notes and is_made else ():
            bar.tell(f"voxflat: {begin}: {translated(note)}", err=True)
        for warning in warnings if is_made else ():
            bar.tell(f"voxflat: warning: {begin}: {translated(warning)}", err=True)
        if is_json():
            return
        if not is_made:
            count = f" ({many(len(warnings), 'warning')} in its report)" if warnings else ""
            bar.tell(f"{begin}: up to date{count}")
        else:
            error, seconds = record["figures"]["best_scale"]["relative_error"], sum(record["seconds"].values())
            points = record["map"]["points"]
            bar.tell(f"{begin}: {points} points, relative distance error {100 * error:.1f} %, {seconds:.1f} s")

    return tell


def _listed(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome, or the planned work of a hemisphere, as a dictionary for JSON."""
    hemi = HEMISPHERES[outcome.hemi][0]
    listed = {"participant": outcome.name, "hemi": hemi, "state": outcome.state, "reason": outcome.reason or None}
    return listed | {name: value for name, value in (outcome.record or {}).items() if name in _RECORDED}
