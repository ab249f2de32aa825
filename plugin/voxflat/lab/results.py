"""The results of a hemisphere: their files and measures, and functions that read them."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.distortion.bands import HUMAN, Bands, in_bands, key_in_bands
from voxflat.errors import InputError
from voxflat.io.files import REMEDY, from_json, naming
from voxflat.io.overlays import read_overlay
from voxflat.io.reading import hash_of
from voxflat.maps.flat_map import FlatMap, load_saved

FORMAT = 4  # version of the output; increase it to make all results again at the next run

MEASURES = {
    "distanceerror": "mean relative error of the distances from each point, as a fraction",
    "areachange": "log2(area on the map / area on the surface)",
    "curvature": "mean curvature, 1/mm, positive on gyri",
    "sulcaldepth": "sulcal depth, mm, positive in sulci",
}
"""The measures at every point of a map, by the names of their files."""

FIGURES: dict[str, tuple[str, float, str]] = {
    "best_scale.relative_error": ("Distance error", 100, "%"),
    "best_scale.relative_error_30mm": ("Distance error up to 30 mm", 100, "%"),
    "best_scale.relative_error_10mm": ("Distance error up to 10 mm", 100, "%"),
    "best_scale.stress_1": ("Stress\u20111", 1, ""),
    "triangles.edge": ("Edge length change", 100, "%"),
    "triangles.equal_area_median": ("Area change, |log2|: median", 1, ""),
    "triangles.equal_area_p95": ("Area change: 95th percentile", 1, ""),
    "triangles.flipped": ("Flipped triangles", 1, ""),
    "triangles.covering": ("Triangles covering another", 1, ""),
    "template.best_scale.relative_error": ("Distance error on the template's map", 100, "%"),
}
"""Measures of a page by their path in a record: name, factor, and unit."""


COUNTS = ("triangles.flipped", "triangles.covering", "triangles.crossings")
"""Measures that are 0 in a correct map."""


class Results:
    """The output files of one hemisphere, such as lh.voxflat.flat.npz or sub-01_hemi-L_flat.npz."""

    def __init__(self, folder: Path, prefix: str, *, of_freesurfer: bool) -> None:
        self.folder, self.prefix, self.of_freesurfer = folder, prefix, of_freesurfer
        self.record = self._named("flat.json")  # provenance and measures; written last, so if it exists, all files do
        self.failure = self._named("failure.json")  # reason for a failure
        self.map = self._named("flat.npz")  # the complete map
        self.surface = self._named("flat.surf.gii")  # the map as a flat surface
        self.patch = self._named("flat.patch.3d")  # the map as a FreeSurfer patch

    @classmethod
    def in_freesurfer(cls, folder: Path, hemi: str) -> "Results":
        """Return the results of a hemisphere in a FreeSurfer subject directory."""
        return cls(folder / "surf", f"{hemi}.voxflat", of_freesurfer=True)

    @classmethod
    def in_bids(cls, folder: Path, name: str, letter: str, mesh: str = "") -> "Results":
        """Return the results of a hemisphere of a participant, ``sub-01`` or ``sub-01_ses-02``, in ``anat``.

        `mesh` contains the entities of a mesh other than the native one, such as ``_space-fsLR_den-32k``.
        """
        return cls(folder, f"{name}_hemi-{letter}{mesh}", of_freesurfer=False)

    def _named(self, name: str) -> Path:
        if self.of_freesurfer:
            return self.folder / f"{self.prefix}.{name}"
        desc = "" if name.startswith("flat.") else "_desc-voxflat"  # other programs write thickness, too
        return self.folder / f"{self.prefix}{desc}_{name}"

    def values(self, name: str) -> Path:
        """Return the path to the file of a measure or an overlay."""
        return self._named(f"{name}.shape.gii")


def digest_of(content: Any) -> str:
    """Return the SHA-256 of a value of JSON."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a record with its own checksum."""
    return {**content, "sha256": digest_of(content)}


def read_record(path: Path) -> dict[str, Any]:
    """Read a record, without its checksum; a damaged record or one of another format raises an InputError."""
    with suppress(ValueError, TypeError, KeyError):
        record: dict[str, Any] = from_json(path.read_text(encoding="utf-8"))
        if record["format"] != FORMAT:
            raise InputError(f"made by voxflat {record['voxflat']} (format {record['format']})")
        if record.pop("sha256") == digest_of(record):
            return record
    raise InputError(f"{path.name} is damaged")


def check_outputs(folder: Path, outputs: Mapping[str, str]) -> None:
    """Raise an InputError if a file is missing or differs from its SHA-256; `outputs` is keyed by file name."""
    for name, digest in outputs.items():
        path = folder / name
        if not path.is_file():
            raise InputError(f"{name} is missing")
        if hash_of(path) != digest:
            raise InputError(f"{name} was modified or is damaged")


@dataclass(frozen=True, eq=False)
class LoadedResults:
    """The results of a hemisphere, read from their files."""

    results: Results
    record: dict[str, Any]
    flat_map: FlatMap
    values: dict[str, NDArray[np.float64]]  # measures and overlays at the points of the map, (N,)

    @classmethod
    def read(cls, results: Results) -> "LoadedResults":
        """Read results; damaged or missing files raise an InputError or an OSError."""
        record, flat_map = read_record(results.record), load_saved(results.map)
        names = [name for name in (*record["overlays"], *MEASURES) if results.values(name).name in record["outputs"]]
        structure = flat_map.origin.structure
        values = {}
        for name in names:
            path = results.values(name)
            with naming(path, REMEDY):
                count = len(flat_map) if flat_map.is_voxels else flat_map.origin.mesh.vertices
                data = read_overlay(path, count, structure=structure).astype(np.float64)
            values[name] = data if flat_map.is_voxels else data[flat_map.ids]
        return cls(results, record, flat_map, values)

    @property
    def cuts(self) -> dict[str, NDArray[np.int64]]:
        """The points of the map along each cut, keyed by the name of the cut."""
        rows = {_key(point): row for row, point in enumerate(self.flat_map.ids.tolist())}
        user_cuts = [cut for cut in self.flat_map.cuts if not cut.is_automatic]
        automatic = [cut for cut in self.flat_map.cuts if cut.is_automatic]
        named = [(cut.name or f"cut {n}", cut) for n, cut in enumerate(user_cuts, 1)]
        named += [(f"automatic {n}", cut) for n, cut in enumerate(automatic, 1)]
        lines = {name: [rows[_key(point)] for point in cut.ids.tolist() if _key(point) in rows] for name, cut in named}
        return {name: np.array(points, dtype=np.int64) for name, points in lines.items() if len(points) > 1}


def _key(point: Any) -> Any:
    return tuple(point) if isinstance(point, list) else point


def bands_in(record: Mapping[str, Any]) -> tuple[Bands, str]:
    """Return the distance bands of a record, and their unit."""
    figures = record["figures"]
    return tuple(figures.get("bands", HUMAN)), figures.get("unit", "mm")


def title_of(place: str, records: Iterable[Mapping[str, Any]]) -> str:
    """Return the title of a measure of `FIGURES`, with the distance bands of all records."""
    title = FIGURES[place][0]
    bands = dict.fromkeys(map(bands_in, records)) if "relative_error_" in place else {}
    head, ends = title.rpartition(" to ")[0], dict.fromkeys(in_bands(title, *of).rpartition(" to ")[2] for of in bands)
    return f"{head} to {' or '.join(ends)}" if ends else title


def places_in(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the measures of a page; those of a template only if some records have them."""
    return [
        place for place in FIGURES if place[:9] != "template." or any("template" in of["figures"] for of in records)
    ]


def figure_of(record: Mapping[str, Any], place: str) -> float | None:
    """Return a measure of a record by its path, such as ``best_scale.stress_1``; None if it is undefined.

    Bands are named as those of human hemispheres.
    """
    value: Any = record["figures"]
    bands, unit = bands_in(record)
    for key in place.split("."):
        value = None if value is None else value.get(key_in_bands(key, bands, unit))
    return None if value is None else float(value)
