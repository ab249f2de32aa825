"""Check whether results are up to date, by checksums of their inputs, and write files only if they change."""

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from voxflat._core import __version__
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.reading import hash_of
from voxflat.lab.inputs import Hemisphere, Parameters
from voxflat.lab.results import FORMAT, Results, check_outputs, digest_of, read_record

_HEAD = 4096  # number of bytes at the beginning of a page that contain its key
_SEAL = "\n<!-- sha256 {} -->\n"  # last line of a page: the checksum of everything before it

Request = dict[str, Any]
"""Everything that determines results: ``voxflat`` (version), ``parameters``, and ``inputs`` (paths and SHA-256)."""


def request(hemisphere: Hemisphere, parameters: Parameters) -> Request:
    """Return everything that determines the results; they are up to date as long as it does not change."""
    files = {**hemisphere.files, **{f"overlay {name}": path for name, path in hemisphere.overlays.items()}}
    inputs = {name: {"path": os.fspath(path), "sha256": hash_of(path)} for name, path in files.items()}
    options = {**as_recorded(parameters), "hemi": hemisphere.letter}
    return {"voxflat": __version__, "format": FORMAT, "parameters": options, "inputs": inputs}


def as_recorded(parameters: Parameters) -> dict[str, Any]:
    """Return parameters as a record contains them."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(parameters).items()}


def state(results: Results, asked: Request) -> tuple[str, str]:
    """Return whether results are "missing", "stale" or "done", and the reason if they are not done."""
    if not results.record.is_file():
        return "missing", "there are no results"
    try:
        record = read_record(results.record)
    except InputError as error:
        return "stale", str(error)
    if record["voxflat"] != asked["voxflat"]:
        return "stale", f"made by voxflat {record['voxflat']}"
    if reasons := changes(record["parameters"], asked["parameters"]):
        return "stale", "; ".join(reasons.values())
    if changed := changed_inputs(record, asked):
        return "stale", f"changed inputs: {', '.join(changed)}"
    try:
        check_outputs(results.folder, record["outputs"])
    except InputError as error:
        return "stale", str(error)
    return "done", ""


def changes(earlier: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Return how each parameter that differs from that of earlier results is described, keyed by its name."""
    pairs = [(key, earlier.get(key), value) for key, value in now.items()]
    return {key: f"{key}: {worded(new)} instead of {worded(old)}" for key, old, new in pairs if old != new}


def changed_inputs(record: Mapping[str, Any], asked: Request) -> list[str]:
    """Return the names of the inputs that were added, removed or modified since results were made."""
    before, now = ({name: file["sha256"] for name, file in source["inputs"].items()} for source in (record, asked))
    return sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))


def worded(value: object) -> str:
    """Return the value of a parameter in words."""
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "the default"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "the default" if value is None else str(value)


def page_key(records: Sequence[Mapping[str, Any]], failures: Mapping[str, str]) -> str:
    """Return the SHA-256 of everything that determines a page: records, and reasons for failures."""
    made_of = [{key: record[key] for key in ("voxflat", "format", "parameters", "inputs")} for record in records]
    return digest_of([made_of, dict(failures)])


def is_page_of(path: Path, key: str) -> bool:
    """Return whether a page exists, has this key, and is undamaged."""
    if not path.is_file():
        return False
    page = path.read_bytes()
    seal = re.search(rb'name="voxflat" content="([0-9a-f]+)"', page[:_HEAD])
    return seal is not None and seal[1] == key.encode() and page.endswith(_seal(page[: -len(_seal(b""))]))


def write_page(path: Path, html: str) -> bool:
    """Write a page with its checksum unless the file already has it; return whether it was written."""
    return write_text(path, html + _seal(html.encode()).decode())


def _seal(page: bytes) -> bytes:
    return _SEAL.format(hashlib.sha256(page).hexdigest()).encode()


def write_json(path: Path, content: Mapping[str, Any]) -> bool:
    """Write JSON unless the file already has this content; return whether it was written."""
    return write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> bool:
    """Write a text, completely or not at all, unless the file already has it; return whether it was written."""
    data = text.encode()
    if path.is_file() and path.read_bytes() == data:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return True
