"""The surfaces of the benchmark, and where each of them comes from."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Any

from voxflat.errors import InputError

PACKAGE, REPOSITORY, FORMULA = "package", "repository", "formula"
"""Kinds of sources: a package of the Python package index, a public repository, and a formula."""

PUBLISHED, STANDARD, AUTOMATIC, NONE = "published", "standard", "automatic", "none"
"""Cuts of the first track: those of a published flat map, the standard cuts of hemispheres, those that voxflat chooses
for the surface, and none for a disk."""


@dataclass(frozen=True)
class Source:
    """Where surfaces come from.

    A package has an archive, whose SHA-256 hash is `sha256`; a repository has a commit.
    """

    name: str
    kind: str
    licence: str
    address: str = ""  # of a person's browser
    package: str = ""
    version: str = ""
    archive: str = ""
    sha256: str = ""
    repository: str = ""
    commit: str = ""

    def __str__(self) -> str:
        if self.kind == PACKAGE:
            return f"{self.package} {self.version}"
        return f"{self.repository} at {self.commit[:8]}" if self.kind == REPOSITORY else "a formula"


@dataclass(frozen=True)
class File:
    """A file of a source: its path there, and its SHA-256 hash."""

    path: str
    sha256: str
    source: Source


@dataclass(frozen=True)
class Entry:
    """A surface of the benchmark."""

    name: str
    family: str
    title: str
    species: str
    source: Source
    cuts: str
    unit: str = "mm"
    files: dict[str, File] = field(default_factory=dict)  # by what they contain: surface, other, flat, sphere, volume
    side: str = ""  # of a hemisphere that is extracted from a volume
    shape: str = ""  # name of a formula in `shapes`
    is_quick: bool = False  # part of the quick set
    uncut: str = ""  # SHA-256 hash of the prepared surface before it is cut
    cut: str = ""  # and after

    @property
    def hashes(self) -> dict[str, str]:
        """The hashes of the prepared surface; empty if they are not known."""
        return {"uncut": self.uncut, "cut": self.cut} if self.cut else {}

    @property
    def is_computed(self) -> bool:
        """Whether voxflat computes positions or cuts, so that other processors may round them differently."""
        return bool(self.shape or self.side) or self.cuts in (STANDARD, AUTOMATIC)


@cache
def entries() -> tuple[Entry, ...]:
    """Return all surfaces, in the order of the tables."""
    content = json.loads(files("voxflat.benchmark").joinpath("surfaces.json").read_text(encoding="utf-8"))
    sources = {name: Source(name, **source) for name, source in content["sources"].items()}
    return tuple(_entry(item, sources) for item in content["surfaces"])


def _entry(item: Mapping[str, Any], sources: Mapping[str, Source]) -> Entry:
    files_ = item.get("files", {}).items()
    parts = {role: File(**{**file, "source": sources[file.get("source", item["source"])]}) for role, file in files_}
    return Entry(**{**item, "source": sources[item["source"]], "files": parts})


def chosen(names: Sequence[str] = (), *, quick: bool = False) -> tuple[Entry, ...]:
    """Return the surfaces with some names or families, or those of the quick set; by default all."""
    known = {entry.name for entry in entries()} | {entry.family for entry in entries()}
    for name in names:
        if name not in known:
            near = get_close_matches(name, known)
            hint = f"Did you mean {' or '.join(near)}?" if near else "`voxflat bench list` shows the names"
            raise InputError(f"{name} is not a surface or a family of the benchmark. {hint}")
    return tuple(
        entry
        for entry in entries()
        if (not names or entry.name in names or entry.family in names) and (entry.is_quick or not quick)
    )
