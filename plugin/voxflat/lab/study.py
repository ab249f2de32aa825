"""Participants, one after the other: what is missing or stale is made, and one that fails never stops the others."""

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
from voxflat.lab.results import Results, Shown, read_record
from voxflat.lab.subject import make

BIDS_VERSION = "1.10.0"

NO_FILES = "there is neither a directory of FreeSurfer nor a surface of this participant"

_IGNORED = """\
# BIDS has no flat surfaces (*_flat.surf.gii), no measures of maps at vertices, and no pages of a whole study
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
    """What became of a hemisphere."""

    name: str  # the participant's: sub-01, sub-01_ses-02, or FreeSurfer's name of the subject
    hemi: str  # lh or rh
    state: str  # made, done (up to date) or failed; missing and stale are to be made, in a plan
    reason: str = ""  # why it failed, or is to be made
    record: dict[str, Any] | None = None  # of what was made

    @property
    def letter(self) -> str:
        """As BIDS has it: L or R."""
        return HEMISPHERES[self.hemi][0]


def freesurfer(
    folder: Path, hemis: Sequence[str], parameters: Parameters, *, tell: Report | None = None, **how: Any
) -> list[Outcome]:
    """Flatten the hemispheres of a subject of FreeSurfer, into its own directory.

    `folder`: FreeSurfer's of the subject, which gets ``surf/?h.voxflat...`` and the report ``voxflat.html``. `tell`:
    takes the outcome of each. `**how`: ``threads``, ``memory_limit``, ``progress``: as in `voxflat.flatten`. Raises
    InputError if there is no such directory; Cancelled if `progress` returned False.
    """
    if not (folder / "surf").is_dir() and not (folder / "mri").is_dir():
        raise InputError(f"{folder}: there is no surf/ in it: give the directory that recon-all made for a subject")
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
    """Flatten the hemispheres of participants, into derivatives of BIDS.

    `source`, `labels`: as in `participants`. `out`: a directory; made if it is missing. `tell`, `**how`: as in
    `freesurfer`. `dask`: a cluster, as in `connected`, whose workers take a participant each; they must see the same
    files. By default this process takes one after the other. Raises InputError if there are no participants, or `out`
    is that of another program; OSError if nothing can be written to `out`; Cancelled if `progress` returned False.
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
            if error is not None:  # the worker's: those of the work are in the outcomes
                made = _without_worker(one, out, hemis, parameters, error)
            for outcome in made:
                tell(outcome)
            outcomes += made
    return sorted(outcomes, key=lambda outcome: outcome.name)


def _participant(
    one: Participant, out: Path, hemis: Sequence[str], parameters: Parameters, *, tell: Report | None = None, **how: Any
) -> list[Outcome]:
    """Make what is missing or stale of a participant of a study, and the report."""
    results, page = results_of(one, out), pages_of(one, out)
    return _each(one.name, one.folder, hemis, parameters, results, page, tell or _nothing, how)


def _without_worker(
    one: Participant, out: Path, hemis: Sequence[str], parameters: Parameters, error: Exception
) -> list[Outcome]:
    """Say what became of a participant whose workers did not come to their end."""
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
    """Say what `study` would do, "failed" where files are not there: nothing is written."""
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
    """Return where the results of a participant go, by hemisphere."""
    folder = out / f"sub-{one.label}" / (f"ses-{one.session}" if one.session else "") / "anat"
    return lambda hemi: Results.in_bids(folder, one.name, HEMISPHERES[hemi][0])


def pages_of(one: Participant, out: Path) -> Path:
    """Return where the report on a participant goes."""
    return out / f"{one.name}.html"


def describe(source: Path, out: Path) -> None:
    """Write what BIDS asks for in a directory of derivatives; raises InputError if it is another program's."""
    path = out / "dataset_description.json"
    if path.is_file() and '"voxflat"' not in path.read_text(encoding="utf-8", errors="replace"):
        raise InputError(f"{out} holds derivatives of another program ({path}): give another directory")
    if out.resolve() == source.resolve():
        raise InputError(f"{out} holds the inputs: give another directory, such as {out / 'derivatives' / 'voxflat'}")
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
    """Make what is missing or stale of a participant, and the report."""
    outcomes = []
    for hemi in hemis:
        outcome = _one(name, folder, hemi, parameters, results(hemi), how)
        tell(outcome)
        outcomes.append(outcome)
    _show(name, outcomes, results, page)
    return outcomes


def _show(name: str, outcomes: Sequence[Outcome], results: Callable[[str], Results], page: Path) -> None:
    """Write the report, unless there is nothing new."""
    there = {one.hemi: results(one.hemi) for one in outcomes if one.state != "failed"}
    failures = {one.hemi: one.reason for one in outcomes if one.state == "failed"}
    key = page_key([read_record(of.record) for of in there.values()], failures)
    is_told = bool(there) or page.is_file()  # what an earlier call has written would say that all is well
    if is_told and (any(one.state == "made" for one in outcomes) or not is_page_of(page, key)):
        from voxflat.lab.report import subject_page  # brings in matplotlib

        write_text(page, subject_page(name, {hemi: Shown.read(of) for hemi, of in there.items()}, failures))


def _one(
    name: str, folder: Path | None, hemi: str, parameters: Parameters, results: Results, how: dict[str, Any]
) -> Outcome:
    """Make a hemisphere, unless it is up to date; whatever goes wrong is its own."""
    try:
        hemisphere = _found(folder, hemi, parameters)
        now, _ = state(results, request(hemisphere, parameters))
        if now == "done":
            results.failure.unlink(missing_ok=True)  # of a call with other parameters
            return Outcome(name, hemi, "done")
        return Outcome(name, hemi, "made", record=make(hemisphere, parameters, results, **how))
    except Cancelled:
        raise
    except Exception as error:
        return _failed(name, hemi, results, error)


def _failed(name: str, hemi: str, results: Results, error: Exception) -> Outcome:
    """Keep the reason why there is no result."""
    reason = user_message(error)
    with suppress(OSError):  # what cannot be written is told all the same
        write_json(results.failure, {"voxflat": __version__, "hemi": HEMISPHERES[hemi][0], "reason": reason})
    return Outcome(name, hemi, "failed", reason)
