"""Process the participants of a study: make missing or outdated results, and continue after failures."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from voxflat._core import __version__
from voxflat.distances.cluster import connected
from voxflat.errors import Cancelled, InputError, user_message
from voxflat.lab.freshness import is_page_of, page_key, request, state, write_json, write_text
from voxflat.lab.inputs import HEMISPHERES, Parameters, Participant, found_in, participants
from voxflat.lab.results import LoadedResults, Results, read_record
from voxflat.lab.subject import make

BIDS_VERSION = "1.10.0"

NO_FILES = "found neither a FreeSurfer directory nor a surface of this participant. Check the label and the inputs"

_IGNORED = """\
# BIDS defines neither flat surfaces (*_flat.surf.gii), nor measures of maps at vertices, nor pages of a study
*.surf.gii
*.shape.gii
*_flat.json
*_flat.npz
*_failure.json
*.html
group_*
"""

Report = Callable[["Outcome"], None]


@dataclass(frozen=True)
class Outcome:
    """The outcome for one hemisphere."""

    name: str  # name of the participant: sub-01, sub-01_ses-02, or the FreeSurfer subject
    hemi: str  # lh or rh
    state: str  # made, done (up to date) or failed; in a plan also missing or stale (has to be made)
    reason: str = ""  # reason why it failed or has to be made
    record: dict[str, Any] | None = None  # record of the results that were made

    @property
    def letter(self) -> str:
        """The BIDS letter: L or R."""
        return HEMISPHERES[self.hemi][0]


def freesurfer(
    folder: Path, hemis: Sequence[str], parameters: Parameters, *, tell: Report | None = None, **how: Any
) -> list[Outcome]:
    """Flatten the hemispheres of a FreeSurfer subject, and write the results into its directory.

    `folder`: the FreeSurfer directory of the subject. It receives ``surf/?h.voxflat...`` and the report
    ``voxflat.html``. `tell`: called with each outcome. `**how`: ``threads``, ``memory_limit`` and ``progress``, as in
    `voxflat.flatten`. Raises InputError if the directory is not a FreeSurfer subject, and Cancelled if `progress`
    returned False.
    """
    if not (folder / "surf").is_dir() and not (folder / "mri").is_dir():
        raise InputError(f"{folder} has no directory surf/. Pass the directory of a subject that recon-all made")
    name, results = folder.resolve().name, partial(Results.in_freesurfer, folder)
    return _each(name, folder, hemis, parameters, results, folder / "voxflat.html", tell or _nothing, how)


def study(
    source: Path,
    out: Path,
    hemis: Sequence[str],
    parameters: Parameters,
    *,
    labels: Sequence[str] = (),
    tell: Report | None = None,
    dask: str | None = None,
    **how: Any,
) -> list[Outcome]:
    """Flatten the hemispheres of participants, and write BIDS derivatives.

    `source`, `labels`: as in `participants`. `out`: the output directory; created if it does not exist. `tell`,
    `**how`: as in `freesurfer`. `dask`: a cluster, as in `connected`, on which each worker processes one participant at
    a time; the workers must have access to the same files. By default this process does all the work. Raises InputError
    if there are no participants or if `out` belongs to another program, OSError if `out` cannot be written, and
    Cancelled if `progress` returned False.
    """
    everybody = participants(source, labels)
    describe(source, out)
    tell = tell or _nothing
    outcomes: list[Outcome] = []
    if dask is None:
        for one in everybody:
            outcomes += _participant(one, out, hemis, parameters, tell=tell, **how)
        return outcomes
    work = partial(
        _participant, out=out, hemis=hemis, parameters=parameters, memory_limit=how.pop("memory_limit", None)
    )
    with connected(dask, most=len(everybody)) as cluster:
        for one, made, error in cluster.each(work, everybody, stage="participants", **how):
            if error is not None:  # an error of the worker; errors of the work itself are in the outcomes
                made = _without_worker(one, out, hemis, parameters, error)
            for outcome in made:
                tell(outcome)
            outcomes += made
    return sorted(outcomes, key=lambda outcome: outcome.name)


def _participant(
    one: Participant, out: Path, hemis: Sequence[str], parameters: Parameters, *, tell: Report | None = None, **how: Any
) -> list[Outcome]:
    """Make the missing or outdated results of a participant of a study, and the report."""
    results, page = results_of(one, out), pages_of(one, out)
    return _each(one.name, one.folder, hemis, parameters, results, page, tell or _nothing, how)


def _without_worker(
    one: Participant, out: Path, hemis: Sequence[str], parameters: Parameters, error: Exception
) -> list[Outcome]:
    """Return the outcomes of a participant whose worker failed."""
    outcomes = []
    for hemi in hemis:
        found = _planned(one, out, hemi, parameters)
        if found.state in ("missing", "stale"):
            found = _failed(one.name, hemi, results_of(one, out)(hemi), error)
        outcomes.append(found)
    _show(one.name, outcomes, results_of(one, out), pages_of(one, out))
    return outcomes


def plan(
    source: Path, out: Path, hemis: Sequence[str], parameters: Parameters, labels: Sequence[str] = ()
) -> Iterator[Outcome]:
    """Yield what `study` would do, without writing anything; the state is "failed" if input files are missing."""
    for one in participants(source, labels):
        for hemi in hemis:
            yield _planned(one, out, hemi, parameters)


def _planned(one: Participant, out: Path, hemi: str, parameters: Parameters) -> Outcome:
    try:
        wanted = request(_found(one.folder, hemi, parameters), parameters)
        return Outcome(one.name, hemi, *state(results_of(one, out)(hemi), wanted))
    except (InputError, OSError) as error:
        return Outcome(one.name, hemi, "failed", user_message(error))


def results_of(one: Participant, out: Path) -> Callable[[str], Results]:
    """Return a function from a hemisphere to the output files of a participant."""
    folder = out / f"sub-{one.label}" / (f"ses-{one.session}" if one.session else "") / "anat"
    return lambda hemi: Results.in_bids(folder, one.name, HEMISPHERES[hemi][0])


def pages_of(one: Participant, out: Path) -> Path:
    """Return the file of the report on a participant."""
    return out / f"{one.name}.html"


def describe(source: Path, out: Path) -> None:
    """Write the dataset description of BIDS derivatives; raise an InputError if another program owns the directory."""
    path = out / "dataset_description.json"
    if path.is_file() and '"voxflat"' not in path.read_text(encoding="utf-8", errors="replace"):
        raise InputError(f"{out} contains derivatives of another program ({path}). Pass another output directory")
    if out.resolve() == source.resolve():
        raise InputError(f"{out} contains the inputs. Pass another one, such as {out / 'derivatives' / 'voxflat'}")
    content = {
        "Name": "voxflat: flat maps of the cortex",
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "voxflat", "Version": __version__}],
        "SourceDatasets": [{"URL": source.resolve().as_uri()}],
    }
    write_json(path, content)
    write_text(out / ".bidsignore", _IGNORED)


def _found(folder: Path | None, hemi: str, parameters: Parameters) -> Any:
    if folder is None:
        raise InputError(NO_FILES)
    return found_in(folder, hemi, parameters)


def _nothing(_: Outcome) -> None:
    pass


def _each(
    name: str,
    folder: Path | None,
    hemis: Sequence[str],
    parameters: Parameters,
    results: Callable[[str], Results],
    page: Path,
    tell: Report,
    how: dict[str, Any],
) -> list[Outcome]:
    """Make the missing or outdated results of a participant, and the report."""
    outcomes = []
    for hemi in hemis:
        outcome = _one(name, folder, hemi, parameters, results(hemi), how)
        tell(outcome)
        outcomes.append(outcome)
    _show(name, outcomes, results, page)
    return outcomes


def _show(name: str, outcomes: Sequence[Outcome], results: Callable[[str], Results], page: Path) -> None:
    """Write the report, unless it is up to date."""
    there = {one.hemi: results(one.hemi) for one in outcomes if one.state != "failed"}
    failures = {one.hemi: one.reason for one in outcomes if one.state == "failed"}
    key = page_key([read_record(of.record) for of in there.values()], failures)
    is_due = bool(there) or page.is_file()  # otherwise an earlier report would not mention the failure
    if is_due and (any(one.state == "made" for one in outcomes) or not is_page_of(page, key)):
        from voxflat.lab.report import subject_page  # imports Matplotlib

        write_text(page, subject_page(name, {hemi: LoadedResults.read(of) for hemi, of in there.items()}, failures))


def _one(
    name: str, folder: Path | None, hemi: str, parameters: Parameters, results: Results, how: dict[str, Any]
) -> Outcome:
    """Make the results of a hemisphere unless they are up to date; errors become its outcome."""
    try:
        hemisphere = _found(folder, hemi, parameters)
        now, _ = state(results, request(hemisphere, parameters))
        if now == "done":
            results.failure.unlink(missing_ok=True)  # from a call with other parameters
            return Outcome(name, hemi, "done")
        return Outcome(name, hemi, "made", record=make(hemisphere, parameters, results, **how))
    except Cancelled:
        raise
    except Exception as error:
        return _failed(name, hemi, results, error)


def _failed(name: str, hemi: str, results: Results, error: Exception) -> Outcome:
    """Write the reason for a failure, and return the outcome."""
    reason = user_message(error)
    with suppress(OSError):  # the outcome has the reason even if the file cannot be written
        write_json(results.failure, {"voxflat": __version__, "hemi": HEMISPHERES[hemi][0], "reason": reason})
    return Outcome(name, hemi, "failed", reason)
