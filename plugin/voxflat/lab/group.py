"""Group level of a study: a table of all measures, outliers, and means over maps with standard cuts."""

import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from voxflat._core import __version__
from voxflat.arguments import log
from voxflat.errors import InputError, user_message
from voxflat.io.files import from_json
from voxflat.io.reading import hash_of
from voxflat.lab.columns import columns_of, measures_in
from voxflat.lab.comparison import Mean, Row, Sums, counted, outliers, outliers_by_chance
from voxflat.lab.differences import not_averaged, warnings_about
from voxflat.lab.freshness import page_key, write_json, write_text
from voxflat.lab.inputs import Participant
from voxflat.lab.layouts import HEMISPHERES
from voxflat.lab.results import (
    COUNTS,
    FIGURES,
    FORMAT,
    LoadedResults,
    Results,
    check_outputs,
    figure_of,
    places_in,
    read_record,
    sealed,
)
from voxflat.lab.study import NO_FILES, Job, command
from voxflat.maps.flat_map import FlatMap

_STEM = "group_desc-voxflat"
_AGAIN = "Run voxflat bids again at the level participant"
_NOT_YET = "not flattened yet. Run voxflat bids at the level participant"


def group(
    everybody: Sequence[Participant],
    source: Path,
    out: Path,
    hemis: Sequence[str],
    *,
    is_study: bool = False,
    space: str | None = None,
) -> dict[str, Any]:
    """Compare participants of a study, and write a table, images of the means and a page to its output directory.

    If `is_study`, `everybody` contains all participants of the study, so that maps of others are reported. `space` is
    the one that was asked for, if any.

    Return the number of ``maps``, the same ``counted`` by side as text, the reasons why maps are ``missing`` and the
    ``outliers`` (measures, high or low), both keyed by participant and hemisphere, the number of
    ``outliers_by_chance``, ``warnings``, and the names of the files ``written`` (none if all were up to date) and
    ``deleted``.
    """
    rows = _rows(everybody, out, hemis)
    gone = _gone(everybody, out) if is_study else []
    again = command(source, out, "participant", space)
    record = out / f"{_STEM}_record.json"
    written: list[str] = []
    deleted: list[str] = []
    if not _is_done(record, _key(rows, gone)):
        from voxflat.lab.study_report import map_picture, study_page  # imports Matplotlib

        rows, means, maps = _compared(out, rows, map_picture)
        if not maps:
            sides = f" of the {HEMISPHERES[hemis[0]][1]} hemisphere" if len(hemis) == 1 else ""
            raise InputError(f"{out}: no participant has a map{sides}. Run {again} first")
        for mean in means:
            for statistic, image in (("mean", mean.mean), ("std", mean.deviation), ("count", mean.count)):
                name = f"group_hemi-{mean.letter}_stat-{statistic}_desc-voxflat_{mean.name}.nii.gz"
                image.save(out / name)
                written.append(name)
        there = {path.name for path in out.glob("group_hemi-*_stat-*_desc-voxflat_*.nii.gz")}
        if deleted := sorted(there - set(written)):
            of_others = "images of an earlier group that this one does not have will be deleted"
            log.info("%s", f"{of_others}: {', '.join(deleted)}")
        for name in deleted:
            (out / name).unlink()
        table, page = out / f"{_STEM}_measures.tsv", out / "group.html"
        write_text(table, _table(rows))
        write_json(table.with_suffix(".json"), _columns(rows))
        key, warnings = _key(rows, gone), _warnings(rows, gone, source, again)
        write_text(page, study_page(rows, means, maps, key, expected_outliers(rows), warnings))
        written += [table.name, table.with_suffix(".json").name, page.name]
        outputs = {name: hash_of(out / name) for name in written}
        write_json(record, sealed({"voxflat": __version__, "format": FORMAT, "key": key, "outputs": outputs}))
        written.append(record.name)
    rows = _with_outliers(rows)
    for warning in (warnings := _warnings(rows, gone, source, again)):
        log.warning("%s", warning)
    return {
        "warnings": warnings,
        "maps": sum(row.record is not None for row in rows),
        "counted": counted(rows),
        "missing": {row.hemisphere: row.reason for row in rows if row.record is None},
        "failed": sorted({row.name for row in rows if row.record is None}),
        "outliers": {row.hemisphere: row.outliers for row in rows if row.outliers},
        "outliers_by_chance": expected_outliers(rows),
        "written": written,
        "deleted": deleted,
    }


def _gone(everybody: Sequence[Participant], out: Path) -> list[str]:
    """Return the names of those who have maps but are not participants of the study."""
    paths = out.glob("sub-*/**/anat/sub-*_hemi-*_flat.json")
    return sorted({path.name.partition("_hemi-")[0] for path in paths} - {person.name for person in everybody})


def _warnings(rows: Sequence[Row], gone: Sequence[str], source: Path, again: str) -> list[str]:
    """Return the warnings about a group; the command `again` makes its maps."""
    if not gone:
        return warnings_about(rows, again)
    reason = f"the maps of {', '.join(gone)} are omitted, because {source} does not contain these participants"
    return [f"{reason}. Restore their files, or delete their maps", *warnings_about(rows, again)]


def _key(rows: Sequence[Row], gone: Sequence[str]) -> str:
    """Return the SHA-256 of everything that determines the files of the group."""
    faults = {row.hemisphere: row.reason or ", ".join(row.changed) for row in rows if row.record is None or row.changed}
    return page_key([row.record for row in rows if row.record is not None], {**faults, "gone": ", ".join(gone)})


def _is_done(record: Path, key: str) -> bool:
    """Return whether all files of the group are up to date and undamaged."""
    try:
        earlier = read_record(record)
        check_outputs(record.parent, earlier["outputs"])
    except (InputError, OSError):
        return False
    return bool(earlier["key"] == key)


def _compared(
    out: Path, rows: list[Row], picture: Callable[[Row, FlatMap, int], dict[str, Any]]
) -> tuple[list[Row], list[Mean], list[dict[str, Any]]]:
    """Return the rows, the means and a picture of each map; hemispheres that cannot be read become missing."""
    rows = _with_outliers(rows)
    there = [row for row in rows if row.record is not None]
    maps: list[dict[str, Any]] = []
    means, unreadable = _means(out, there, lambda row, flat_map: maps.append(picture(row, flat_map, len(there))))
    if not unreadable:
        return rows, means, maps
    rest = [
        replace(row, record=None, reason=unreadable[row.hemisphere]) if row.hemisphere in unreadable else row
        for row in rows
    ]
    return _compared(out, rest, picture)


def _rows(everybody: Sequence[Participant], out: Path, hemis: Sequence[str]) -> list[Row]:
    """Return the hemispheres of all participants, except a side that nobody has."""
    rows: list[Row] = []
    for person in everybody:
        job = Job.of(person, out)
        sides = [_row(person, job, hemi) for hemi in hemis]
        if all(row.reason == _NOT_YET for row in sides):
            sides = [replace(sides[0], letter="", reason=NO_FILES if person.folder is None else _NOT_YET)]
        rows += sides
    there = {row.letter for row in rows if row.reason != _NOT_YET} | {""}
    return [row for row in rows if row.letter in there]


def _row(person: Participant, job: Job, hemi: str) -> Row:
    """Return a hemisphere with its results, or the reason why it has none."""
    session = f"_ses-{person.session}" if person.session else ""
    about = (f"sub-{person.label}", session, HEMISPHERES[hemi][0], job.page.name)
    results = job.results(hemi)
    if results.failure.is_file():
        return Row(*about, None, _reason(results), results=results)
    if not results.record.is_file():
        return Row(*about, None, _NOT_YET, results=results)
    try:
        record = read_record(results.record)
        check_outputs(results.folder, record["outputs"])
    except (InputError, OSError) as error:
        return Row(*about, None, f"{user_message(error)}. {_AGAIN}", results=results)
    return Row(*about, record, changed=job.changed(hemi, record), results=results)


def _reason(results: Results) -> str:
    try:
        reason = str(from_json(results.failure.read_text(encoding="utf-8"))["reason"])
    except (ValueError, TypeError, KeyError, OSError):
        return f"{results.failure.name} is damaged. {_AGAIN}"
    return f"its last run failed: {reason}"


def _with_outliers(rows: list[Row]) -> list[Row]:
    """Mark outliers among the hemispheres of the same side."""
    marks: dict[int, dict[str, str]] = {}
    for side in _sides(rows):
        for place in dict.fromkeys((*FIGURES, *COUNTS)):
            values = np.array([figure_of(rows[n].record or {}, place) for n in side], dtype=np.float64)  # None is NaN
            far = values > 0 if place in COUNTS else outliers(values)
            for n, value in zip(np.array(side, dtype=int)[far].tolist(), values[far].tolist(), strict=True):
                marks.setdefault(n, {})[place] = "high" if place in COUNTS or value > np.nanmedian(values) else "low"
    return [replace(row, outliers=marks.get(n, {})) for n, row in enumerate(rows)]


def _sides(rows: Sequence[Row]) -> list[list[int]]:
    """Return the rows that have a map, of the left and of the right side."""
    return [[n for n, row in enumerate(rows) if row.letter == side and row.record is not None] for side in ("L", "R")]


def expected_outliers(rows: Sequence[Row]) -> float:
    """Return the number of outliers to expect by chance in all measures, if these are normally distributed."""
    measures = sum(place not in COUNTS for place in places_in([row.record for row in rows if row.record is not None]))
    return round(measures * sum(outliers_by_chance(len(numbers)) for numbers in _sides(rows)), 2)


def _table(rows: Sequence[Row]) -> str:
    """Return the table of all measures as a BIDS table, with n/a for missing values."""
    text = io.StringIO()
    columns = _columns(rows)
    print("\t".join(columns), file=text)
    for row in rows:
        cells: list[Any] = [row.name, row.session.removeprefix("_") or None, row.letter or None]
        cells += [
            "missing" if row.record is None else "done",
            row.reason or None,
            ", ".join(map(" ".join, row.outliers.items())) or None,
            "; ".join((row.record or {}).get("warnings", ())) or None,
        ]
        if row.record is None:
            cells += [None] * (len(columns) - len(cells))
        else:
            cells += [row.record["surface"]["cortex"]]
            cells += [row.record["map"][key] for key in ("cuts_by", "points", "width", "height")]
            measures = measures_in(row.record)
            cells += [measures.get(name) for name in list(columns)[len(cells) :]]
        print("\t".join("n/a" if cell is None else _cell(cell) for cell in cells), file=text)
    return text.getvalue()


def _columns(rows: Sequence[Row]) -> dict[str, dict[str, str]]:
    return columns_of([row.record for row in rows if row.record is not None])


def _cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else " ".join(str(value).split())


def _means(out: Path, rows: Sequence[Row], show: Callable[[Row, FlatMap], None]) -> tuple[list[Mean], dict[str, str]]:
    """Return means over standard maps, and why hemispheres cannot be read; pass every map to `show`.

    One map is in memory at a time.
    """
    excluded = not_averaged(rows)
    sums: dict[tuple[str, str], Sums] = {}
    unreadable: dict[str, str] = {}
    for row in rows:
        assert row.results is not None
        try:
            results = LoadedResults.read(row.results)
        except (InputError, OSError) as error:
            unreadable[row.hemisphere] = user_message(error)
            continue
        show(row, results.flat_map)
        if (row.letter, "") in excluded or results.record["map"]["frame"] != "standard":
            continue
        for name in (*results.record["overlays"], "curvature"):
            if name in results.values and (row.letter, name) not in excluded:
                if (key := (name, row.letter)) not in sums:
                    sums[key] = Sums(*_ends(rows, row.letter))
                sums[key].add(results.flat_map, results.values[name])
    return [total.result(name, letter) for (name, letter), total in sorted(sums.items()) if total.maps > 1], unreadable


def _ends(rows: Sequence[Row], letter: str) -> tuple[list[float], list[float]]:
    """Return the smallest and largest (u, v) of all maps of a side."""
    maps = [row.record["map"] for row in rows if row.letter == letter and row.record is not None]
    return np.min([box["low"] for box in maps], axis=0).tolist(), np.max([box["high"] for box in maps], axis=0).tolist()
