"""Where the results of a hemisphere go, what its record says, and whether they are up to date."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from voxflat._core import __version__
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.lab.inputs import Hemisphere, Parameters

__all__ = [
    "Request",
    "Results",
    "is_page_of",
    "page_key",
    "read_record",
    "request",
    "state",
    "write_json",
    "write_text",
]

_FORMAT = 1  # of what is written; raise it where a rerun should make all results anew
_BLOCK = 1 << 20
_HEAD = 4096  # bytes at the beginning of a page, in which its key stands

Request = dict[str, Any]
"""What results are made of: ``voxflat`` (the version), ``parameters``, ``inputs`` (path and SHA-256 of each file)."""


@dataclass(frozen=True)
class Results:
    """The files of one hemisphere.

    Parameters
    ----------
    folder : Path
        Where they lie.
    prefix : str
        How their names begin.
    of_freesurfer : bool
        Whether they are named as FreeSurfer's, ``lh.voxflat.flat.surf.gii``, or as those of BIDS,
        ``sub-01_hemi-L_desc-voxflat_flat.surf.gii``.
    """

    folder: Path
    prefix: str
    of_freesurfer: bool

    @classmethod
    def in_freesurfer(cls, folder: Path, hemi: str) -> Results:
        """Return those of a hemisphere in FreeSurfer's directory of a subject."""
        return cls(folder / "surf", f"{hemi}.voxflat", True)

    @classmethod
    def in_bids(cls, folder: Path, name: str, letter: str) -> Results:
        """Return those of a hemisphere of a participant, ``sub-01`` or ``sub-01_ses-02``, in a folder ``anat``."""
        return cls(folder, f"{name}_hemi-{letter}_desc-voxflat", False)

    def _named(self, name: str) -> Path:
        return self.folder / f"{self.prefix}{'.' if self.of_freesurfer else '_'}{name}"

    @property
    def record(self) -> Path:
        """What made them, with figures, as JSON; it is written last, so that where it is there, all are."""
        return self._named("flat.json")

    @property
    def failure(self) -> Path:
        """Why there are none."""
        return self._named("failure.json")

    @property
    def map(self) -> Path:
        """All of the map."""
        return self._named("flat.npz")

    @property
    def surface(self) -> Path:
        """The map as a flat surface."""
        return self._named("flat.surf.gii")

    @property
    def patch(self) -> Path:
        """The map as FreeSurfer's patch."""
        return self._named("flat.patch.3d")

    def values(self, name: str) -> Path:
        """Return where a measure or an overlay goes."""
        return self._named(f"{name}.shape.gii")


def request(hemisphere: Hemisphere, parameters: Parameters) -> Request:
    """Return what results are made of: they are up to date as long as it is the same.

    Parameters
    ----------
    hemisphere : Hemisphere
        Its files are read, for their SHA-256.
    parameters : Parameters
        What is made of it.

    Returns
    -------
    dict

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    inputs = {name: {"path": os.fspath(path), "sha256": _sha256(path)} for name, path in hemisphere.everything.items()}
    told = {**asdict(parameters), "overlays": list(parameters.overlays), "hemi": hemisphere.letter}
    return {"voxflat": __version__, "format": _FORMAT, "parameters": told, "inputs": inputs}


def _sha256(path: Path) -> str:
    hashed = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            hashed.update(block)
    return hashed.hexdigest()


def state(results: Results, wanted: Request) -> tuple[str, str]:
    """Say whether results are there and up to date.

    Parameters
    ----------
    results : Results
        Where they are.
    wanted : dict
        What they are to be made of.

    Returns
    -------
    state : {"missing", "stale", "done"}
    reason : str
        Why they are not done.
    """
    if not results.record.is_file():
        return "missing", "there is no result"
    try:
        record = read_record(results.record)
    except InputError as error:
        return "stale", str(error)
    for name in ("voxflat", "format"):
        if record[name] != wanted[name]:
            return "stale", f"it was made by voxflat {record['voxflat']} (format {record['format']})"
    changed = [
        f"{key}: {record['parameters'].get(key)!r} before, now {value!r}"
        for key, value in wanted["parameters"].items()
        if record["parameters"].get(key) != value
    ]
    if changed:
        return "stale", "; ".join(changed)
    before, now = ({name: file["sha256"] for name, file in of["inputs"].items()} for of in (record, wanted))
    changed = sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))
    if changed:
        return "stale", f"changed: {', '.join(changed)}"
    for name, size in record["outputs"].items():
        path = results.folder / name
        if not path.is_file() or path.stat().st_size != size:
            return "stale", f"{name} is missing, or not as it was written"
    return "done", ""


def read_record(path: Path) -> dict[str, Any]:
    """Read the record of a hemisphere's results.

    Parameters
    ----------
    path : Path
        `Results.record`.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If it is damaged.
    """
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        is_whole = all(name in record for name in ("voxflat", "format", "parameters", "inputs", "outputs", "figures"))
    except (ValueError, TypeError):
        is_whole = False
    if not is_whole:
        raise InputError(f"{path} is no record of voxflat, or damaged: delete it")
    return record


def page_key(records: Sequence[Mapping[str, Any]], failures: Mapping[str, str]) -> str:
    """Return what a page is made of, in short: it stands at its beginning.

    Parameters
    ----------
    records : sequence of dict
        Of the results that it shows.
    failures : dict of str to str
        What it says of those that there are none of.

    Returns
    -------
    str
        SHA-256, in hexadecimal digits.
    """
    made_of = [{key: record[key] for key in ("voxflat", "format", "parameters", "inputs")} for record in records]
    return hashlib.sha256(json.dumps([made_of, dict(failures)], sort_keys=True).encode()).hexdigest()


def is_page_of(path: Path, key: str) -> bool:
    """Say whether a page is there and made of what a key says."""
    if not path.is_file():
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        told = re.search(r'name="voxflat" content="([0-9a-f]+)"', file.read(_HEAD))
    return told is not None and told[1] == key


def write_json(path: Path, content: Mapping[str, Any]) -> bool:
    """Write JSON, unless the file holds it already; return whether it was written."""
    return write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> bool:
    """Write a text, all of it or nothing, unless the file holds it already; return whether it was written."""
    data = text.encode()
    if path.is_file() and path.read_bytes() == data:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return True
