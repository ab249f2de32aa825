"""Process the participants of a study: make missing or outdated results, and continue after failures."""

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from voxflat._core import __version__
from voxflat.arguments import log
from voxflat.distances.cluster import connected
from voxflat.errors import Cancelled, InputError, user_message
from voxflat.io.locks import locked
from voxflat.lab.differences import listed
from voxflat.lab.freshness import (
    Request,
    as_recorded,
    changed_inputs,
    changes,
    is_page_of,
    page_key,
    request,
    state,
    write_json,
    write_page,
    write_text,
)
from voxflat.lab.inputs import Hemisphere, Parameters, Participant, check_given, found_in
from voxflat.lab.layouts import FREESURFER, HEMISPHERES, Finder, Layout
from voxflat.lab.results import MEASURES, LoadedResults, Results, read_record
from voxflat.lab.sidecars import SOURCE
from voxflat.lab.subject import make
from voxflat.lab.workbench import write_workbench

BIDS_VERSION = "1.10.0"

NO_FILES = (
    "found neither a FreeSurfer directory nor a surface for this participant. Check that recon-all or sMRIPrep finished"
)

_IGNORED = """\
# BIDS defines neither flat surfaces (*_flat.surf.gii), nor measures of maps at vertices, nor pages of a study
*.surf.gii
*.shape.gii
*_flat.json
*_flat.npz
desc-voxflat_*.json
*_flat.spec
*_flat.scene
*_failure.json
*.html
group_*
"""

_WAITING = "another voxflat process is making the maps of {}. Waiting for it"

Report = Callable[["Outcome"], None]
Waits = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """The outcome for one hemisphere."""

    name: str  # name of the participant: sub-01, sub-01_ses-02, or the FreeSurfer subject
    hemi: str  # lh or rh
    state: str  # made, done (up to date) or failed; in a plan also missing or stale (has to be made)
    reason: str = ""  # reason why it failed or has to be made
    record: dict[str, Any] | None = None  # record of the results, unless in a plan


@dataclass(frozen=True)
class Job:
    """The input and output files of a participant."""

    name: str  # as in `Outcome`
    folder: Path | None  # contains the input files; None if there are none
    layout: Layout | None  # of the input files; None if there are none
    results: Callable[[str], Results]  # return the output files of a hemisphere, lh or rh
    page: Path  # the report
    source: Path | None = None  # directory of the study
    scene: Path | None = None  # spec and scene of Workbench, without the ending; None for FreeSurfer directories

    @classmethod
    def of(cls, person: Participant, out: Path) -> "Job":
        """Return the files of a participant of a study, whose output directory is `out`."""
        folder = out / f"sub-{person.label}" / (f"ses-{person.session}" if person.session else "") / "anat"
        mesh = person.layout.entities if person.layout else ""

        def results(hemi: str) -> Results:
            return Results.in_bids(folder, person.name, HEMISPHERES[hemi][0], mesh)

        page = out / f"{person.name}{mesh}.html"
        scene = folder / f"{person.name}{mesh}_flat"
        return cls(person.name, person.folder, person.layout, results, page, person.source, scene)

    def request(self, hemi: str, parameters: Parameters) -> tuple[Hemisphere, Request]:
        """Return the input files of a hemisphere and everything that determines its results."""
        hemisphere = self.found(hemi, parameters)
        return hemisphere, request(hemisphere, parameters)

    def found(self, hemi: str, parameters: Parameters) -> Hemisphere:
        """Return the input files of a hemisphere."""
        if self.folder is None:
            raise InputError(NO_FILES)
        return replace(found_in(self.folder, hemi, parameters, self.layout), source=self.source)

    def write_workbench(self, hemis: Sequence[str]) -> None:
        """Write the spec and the scene of the hemispheres with a map, unless Workbench cannot open them."""
        if self.folder is None or self.layout is None or not hemis or self.scene is None:
            return
        results = {hemi: self.results(hemi) for hemi in hemis}
        if not any(read_record(files.record)["parameters"]["volume"] for files in results.values()):
            found = {hemi: (files, Finder(self.folder, hemi, self.layout)) for hemi, files in results.items()}
            write_workbench(self.scene, found)

    def changed(self, hemi: str, record: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the inputs that changed since a hemisphere was flattened, or why they cannot be read."""
        used = {key: value for key, value in record["parameters"].items() if key != "hemi"}
        try:
            tuples = {key: tuple(value) for key, value in used.items() if isinstance(value, list)}
            _, now = self.request(hemi, Parameters(**{**used, **tuples}))
        except (InputError, OSError) as error:
            return (user_message(error),)
        return tuple(changed_inputs(record, now))


def _nothing(_: Outcome) -> None:
    pass


def freesurfer(
    folder: Path, hemis: Sequence[str], parameters: Parameters, *, tell: Report = _nothing, **common: Any
) -> list[Outcome]:
    """Flatten the hemispheres of a FreeSurfer subject, and write the results and a report to its directory.

    `tell` is called with each outcome, and `common` contains ``threads``, ``memory_limit`` and ``progress``.
    """
    if not (folder / "surf").is_dir() and not (folder / "mri").is_dir():
        raise InputError(f"{folder} has no directory surf/. Pass a subject directory created by recon-all")
    results = partial(Results.in_freesurfer, folder)
    job = Job(folder.resolve().name, folder, FREESURFER, results, folder / "voxflat.html")
    check_given([Participant(job.name, None, folder, FREESURFER)], hemis, parameters)
    warn_of_changes([job], hemis, parameters)
    return _flatten(job, hemis, parameters, tell, **common)


def study(
    everybody: Sequence[Participant],
    source: Path,
    out: Path,
    hemis: Sequence[str],
    parameters: Parameters,
    *,
    tell: Report = _nothing,
    waits: Waits = log.info,
    dask: str | None = None,
    **common: Any,
) -> list[Outcome]:
    """Flatten the hemispheres of participants, and write BIDS derivatives; `tell` and `common` are as in `freesurfer`.

    `everybody` contains participants of the study in the directory `source`. `waits` is called with a message if
    another process is making results of a participant, which this process then waits for.

    On a `dask` cluster (see `connected`), each worker processes one participant at a time, and must have access to the
    same files. By default, this process does all the work.
    """
    describe(source, out)
    outcomes: list[Outcome] = []
    if dask is None:
        for person in everybody:
            outcomes += _flatten(Job.of(person, out), hemis, parameters, tell, waits, **common)
        return outcomes
    limit = common.pop("memory_limit", None)
    work = partial(_participant, out=out, hemis=hemis, parameters=parameters, memory_limit=limit)
    with connected(dask, most=len(everybody)) as cluster:
        for person, done, error in cluster.each(work, everybody, stage="participants", **common):
            if error is not None:  # an error of the worker; errors of the work itself are in the outcomes
                job = Job.of(person, out)
                planned = [_planned(job, hemi, parameters) for hemi in hemis]
                done = [_failed(job, run.hemi, error) if run.state in ("missing", "stale") else run for run in planned]
                done += _report(job, done)
            for outcome in done:
                tell(outcome)
            outcomes += done
    return sorted(outcomes, key=lambda outcome: outcome.name)


def _participant(person: Participant, out: Path, hemis: Sequence[str], parameters: Parameters, **common: Any) -> Any:
    """Process a participant on a worker."""
    return _flatten(Job.of(person, out), hemis, parameters, _nothing, **common)


def plan(
    everybody: Sequence[Participant], out: Path, hemis: Sequence[str], parameters: Parameters
) -> Iterator[Outcome]:
    """Yield what `study` would do, without writing anything; the state is "failed" if input files are missing."""
    for person in everybody:
        job = Job.of(person, out)
        planned = [_planned(job, hemi, parameters) for hemi in hemis]
        is_due = all(outcome.state in ("done", "failed") for outcome in planned) and _is_page_due(job, planned)
        reason = f"{job.page.name} is missing, outdated or damaged"
        for step in planned:
            yield replace(step, state="stale", reason=reason) if is_due and step.state == "done" else step


def warn_of_changes(jobs: Sequence[Job], hemis: Sequence[str], parameters: Parameters) -> None:
    """Warn of results that will be replaced because they were made with other parameters.

    The warning describes the differences as a plan does, and lists the participants and the options that keep the
    results.
    """
    new = as_recorded(parameters)
    people: dict[tuple[str, str], list[str]] = {}
    for job, hemi in product(jobs, hemis):
        with suppress(InputError, OSError):  # there are no results, or they will not be replaced
            earlier = read_record(job.results(hemi).record)["parameters"]
            job.found(hemi, parameters)
            if changed := changes(earlier, new):
                keep = ", ".join(_option(key, earlier.get(key)) for key in changed)
                people.setdefault(("; ".join(changed.values()), keep), []).append(job.name)
    for (described, keep), names in people.items():
        log.warning(
            "%s will be replaced, because other options are given (%s). To keep them, press Ctrl-C now, and repeat the "
            "command %s",
            f"the maps of {listed(list(dict.fromkeys(names)))}",
            described,
            keep,
        )


def _option(key: str, value: Any) -> str:
    """Return how to pass a parameter on the command line, such as "with --cuts automatic"."""
    flag = "--overlay" if key == "overlays" else f"--{key.replace('_', '-')}"
    if value == as_recorded(Parameters()).get(key):
        return f"without {flag}"
    several = value if isinstance(value, list) else [] if value is True else [value]
    return f"with {shlex.join([flag, *map(str, several)])}"


def _planned(job: Job, hemi: str, parameters: Parameters) -> Outcome:
    try:
        return Outcome(job.name, hemi, *state(job.results(hemi), job.request(hemi, parameters)[1]))
    except Exception as error:  # one participant never stops the others
        return Outcome(job.name, hemi, "failed", user_message(error))


def command(source: Path, out: Path, level: str, space: str | None = None) -> str:
    """Return the command that processes a study at a level, participant or group, in a space."""
    return shlex.join(["voxflat", "bids", str(source), str(out), level, *(["--space", space] if space else [])])


def check_output(source: Path, out: Path) -> None:
    """Raise an InputError if `out` is a file, the input, or a directory of another program."""
    path = out / "dataset_description.json"
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file. Pass a directory for the output")
    if path.is_file() and '"voxflat"' not in path.read_text(encoding="utf-8", errors="replace"):
        raise InputError(f"{out} contains derivatives of another program ({path}). Pass another output directory")
    if out.resolve() == source.resolve():
        raise InputError(f"{out} is the input. Pass another directory, such as {out / 'derivatives' / 'voxflat'}")


def describe(source: Path, out: Path) -> None:
    """Write the dataset description of BIDS derivatives."""
    content = {
        "Name": "voxflat: flat maps of the cortex",
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "voxflat", "Version": __version__}],
        "SourceDatasets": [{"URL": source.resolve().as_uri()}],
        "DatasetLinks": {SOURCE: source.resolve().as_uri()},
    }
    write_json(out / "dataset_description.json", content)
    write_text(out / ".bidsignore", _IGNORED)
    for name, text in MEASURES.items():  # the sidecars of all files with these measures
        write_json(out / f"desc-voxflat_{name}.json", {"Description": text})


def _flatten(
    job: Job, hemis: Sequence[str], parameters: Parameters, tell: Report, waits: Waits = log.info, **common: Any
) -> list[Outcome]:
    """Make the missing or outdated results of a participant, and the report, unless another process is doing this."""
    outcomes = []
    with locked(job.page.with_name(f".{job.page.name}.lock"), partial(waits, _WAITING.format(job.name))):
        for hemi in hemis:
            outcomes.append(_one(job, hemi, parameters, common))
            tell(outcomes[-1])
        for failure in _report(job, outcomes):
            outcomes.append(failure)
            tell(failure)
    return outcomes


def _report(job: Job, outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Write the report, unless it is up to date; if this fails, return the failure."""
    try:
        if _is_page_due(job, outcomes):
            from voxflat.lab.report import subject_page  # imports Matplotlib

            results = {hemi: LoadedResults.read(job.results(hemi)) for hemi in _with_map(job, outcomes)}
            write_page(job.page, subject_page(job.name, results, _failures(outcomes)))
        job.write_workbench(_with_map(job, outcomes))
    except Cancelled:
        raise
    except Exception as error:  # one participant never stops the others
        return [Outcome(job.name, outcomes[0].hemi, "failed", f"{job.page.name}: {user_message(error)}")]
    return []


def _is_page_due(job: Job, outcomes: Sequence[Outcome]) -> bool:
    """Return whether the report has to be written."""
    there = [job.results(hemi).record for hemi in _with_map(job, outcomes)]
    if not there and not job.page.is_file():  # an existing report must mention the failure
        return False
    key = page_key([read_record(record) for record in there], _failures(outcomes))
    return any(outcome.state == "made" for outcome in outcomes) or not is_page_of(job.page, key)


def _with_map(job: Job, outcomes: Sequence[Outcome]) -> list[str]:
    """Return the hemispheres with a map, those of earlier runs included if only the other one was asked for."""
    states = {outcome.hemi: outcome.state for outcome in outcomes}
    results = {hemi: job.results(hemi) for hemi in HEMISPHERES}
    earlier = {hemi for hemi, files in results.items() if files.record.is_file() and not files.failure.is_file()}
    return [hemi for hemi in HEMISPHERES if (states[hemi] != "failed" if hemi in states else hemi in earlier)]


def _failures(outcomes: Sequence[Outcome]) -> dict[str, str]:
    return {outcome.hemi: outcome.reason for outcome in outcomes if outcome.state == "failed"}


def _one(job: Job, hemi: str, parameters: Parameters, common: dict[str, Any]) -> Outcome:
    """Make the results of a hemisphere unless they are up to date; errors become its outcome."""
    results = job.results(hemi)
    try:
        hemisphere, asked = job.request(hemi, parameters)
        if state(results, asked)[0] == "done":
            results.failure.unlink(missing_ok=True)  # from a call with other parameters
            return Outcome(job.name, hemi, "done", record=read_record(results.record))
        return Outcome(job.name, hemi, "made", record=make(hemisphere, parameters, results, **common))
    except Cancelled:
        raise
    except Exception as error:
        return _failed(job, hemi, error)


def _failed(job: Job, hemi: str, error: Exception) -> Outcome:
    """Write the reason for a failure, and return the outcome."""
    reason, results = user_message(error), job.results(hemi)
    if results.record.is_file():
        reason += f". The maps of an earlier run remain in {results.folder}"
    with suppress(OSError):  # the outcome has the reason even if the file cannot be written
        content = {"voxflat": __version__, "hemi": HEMISPHERES[hemi][0], "reason": reason}
        write_json(results.failure, content)
    return Outcome(job.name, hemi, "failed", reason)
