"""Score flat maps that any tool made: one file per surface in a folder."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat._core import __version__
from voxflat.benchmark.fetch import sha256
from voxflat.benchmark.manifest import Entry
from voxflat.benchmark.measures import (
    distance_measures,
    distances_on_map,
    others_distance_measures,
    triangle_measures,
)
from voxflat.benchmark.prepare import Prepared, load
from voxflat.benchmark.tools import GIVEN
from voxflat.benchmark.truth import Truth, distances, load_truth
from voxflat.distortion.bands import usual_bands
from voxflat.distortion.figures import json_ready
from voxflat.errors import InputError
from voxflat.evaluation.charts import charts_of
from voxflat.io.files import REMEDY, atomic_path, from_json, naming
from voxflat.maps.matching import match

FORMAT = "voxflat-benchmark-result 1"
RUN = "run.json"
"""The file beside the maps that tells which tool made them, and what each of them cost."""


def score(data: Path, maps: Path, track: str, entries: Sequence[Entry]) -> dict[str, Any]:
    """Measure the maps of a folder, and return the result, ready for JSON."""
    run = _run_of(maps)
    if run.get("track", track) != track:
        raise InputError(f"{maps} contains maps of the track {run['track']!r}. Pass this track")
    surfaces: dict[str, Any] = {}
    missing = dict(run.get("missing", {}))
    for entry in entries:
        path = file_of(maps, entry.name)
        if path is None:
            missing.setdefault(entry.name, "there is no file")
            continue
        missing.pop(entry.name, None)
        made = load(data, entry.name)
        with naming(path, REMEDY):
            measured = measure(made, load_truth(data, made), read_map(path), track)
        facts = {"map": path.name, "sha256": sha256(path), "surface": made.hashes["cut"]}
        surfaces[entry.name] = facts | measured | {"costs": run.get("costs", {}).get(entry.name, {})}
    if not surfaces:
        example = "fsaverage5-L-white.surf.gii"
        raise InputError(f"{maps} contains no map of the chosen surfaces. Name files after surfaces, such as {example}")
    about = {key: run.get(key, "") for key in ("tool", "version", "machine")}
    about["tool"] = about["tool"] or maps.resolve().name
    names = [entry.name for entry in entries]
    missing = {name: reason for name, reason in missing.items() if name in names}
    content = {"format": FORMAT, **about, "track": track, "scored_by": f"voxflat {__version__}"}
    return dict(json_ready(content | {"surfaces": surfaces, "missing": missing}))


def save_result(result: dict[str, Any], path: Path) -> None:
    """Write a result as JSON."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8", newline="\n")


def load_result(path: Path) -> dict[str, Any]:
    """Read a result."""
    with naming(path, "Pass a file that `voxflat bench score` wrote"):
        result = from_json(path.read_bytes())
        if not isinstance(result, dict) or result.get("format") != FORMAT:
            raise InputError("is not a result of `voxflat bench score`. Pass a file that it wrote")
        return result


def _run_of(maps: Path) -> dict[str, Any]:
    """Return what `voxflat bench run` recorded beside the maps, or what an author wrote there."""
    if not maps.is_dir():
        raise InputError(f"{maps} is not a directory. Pass the directory of the maps")
    path = maps / RUN
    if not path.is_file():
        return {}
    with naming(path, REMEDY):
        content = from_json(path.read_bytes())
        if not isinstance(content, dict):
            raise InputError("is not a JSON object. Write an object with tool, version, track and costs")
        return content


def file_of(maps: Path, name: str) -> Path | None:
    """Return the file of a surface's map, which has the name of the surface and any ending."""
    found = sorted(path for path in maps.iterdir() if path.name.startswith(f"{name}.") and path.is_file())
    if len(found) > 1:
        listed = ", ".join(path.name for path in found)
        raise InputError(f"{maps} contains several maps of {name}: {listed}. Keep one of them")
    return found[0] if found else None


def read_map(path: Path) -> object:
    """Return a map as `voxflat.measure` takes it; an .npz file may also contain just uv, faces and vertices."""
    if path.suffix == ".npz":
        with np.load(path) as file:
            if "uv" in file and "metadata" not in file:
                parts = [file[name] for name in ("uv", "faces", "vertices") if name in file]
                return parts[0] if len(parts) == 1 else tuple(parts)
    return path


def measure(made: Prepared, truth: Truth, flat: object, track: str) -> dict[str, Any]:
    """Return the measures of a map and their standard errors."""
    of_cut = track == GIVEN
    matched = match(made.cut if of_cut else made.uncut, _separated(made.points if of_cut else made.uncut_points, flat))
    if len(np.unique(matched.uv, axis=0)) < 3:
        raise InputError("all vertices of the map are at the same position. Pass a flat map")
    vertices = made.vertices[matched.vertices] if of_cut else matched.vertices  # of the uncut surface
    first, kept = _sources_in(matched.vertices, truth.sources if of_cut else made.vertices[truth.sources])
    faces = matched.core.faces.astype(np.int64)
    if of_cut:
        rows = truth.cut[kept][:, matched.vertices].astype(np.float64)
    else:
        rows = distances(matched.core.points, faces, first).astype(np.float64)
    bands = usual_bands(made.cut.core.area, made.unit)
    flat_rows = distances_on_map(matched.uv, first)
    measures, errors = distance_measures(rows, flat_rows, bands)
    whole, whole_errors = distance_measures(truth.uncut[kept][:, vertices].astype(np.float64), flat_rows, bands)
    measures |= {f"uncut_{name}": value for name, value in whole.items()}
    errors |= {f"uncut_{name}": value for name, value in whole_errors.items()}
    measures |= triangle_measures(matched.core, matched.uv, measures["scale"])
    charts = [flat for flat, _ in charts_of(matched)]
    if len(charts) > 1:  # each of them may be mirrored
        of_charts = [triangle_measures(chart.core, chart.uv, 1.0) for chart in charts]
        areas = np.array([chart.core.area for chart in charts])
        measures["flipped"] = sum(found["flipped"] for found in of_charts)
        measures["flipped_share"] = float(np.average([found["flipped_share"] for found in of_charts], weights=areas))
    measures |= others_distance_measures(rows, flat_rows, faces, first)
    total = len(made.points) if of_cut else len(made.uncut_points)
    measures |= {
        "charts": len(charts),
        "vertices_lost": int(total - len(np.unique(matched.vertices))),
        "sources": len(first),
        "within_charts": float(np.isfinite(rows).mean()),
        "cut_length": cut_length(made, matched.core.points, faces, vertices),
    }
    shown = {"near": bands[1], "far": bands[3], "unit": made.unit}
    return {"measures": measures, "standard_errors": errors, "bands": shown}


def _separated(points: NDArray[np.float64], flat: object) -> object:
    """Return a map in which parts that touch at a vertex have a vertex each, as charts of some tools do not have."""
    if not isinstance(flat, tuple) or len(flat) < 3:
        return flat
    uv, faces, vertices = (np.asarray(part) for part in flat)
    is_there = vertices.dtype.kind in "iu" and 0 <= vertices.min(initial=0) <= vertices.max(initial=0) < len(points)
    if not is_there or len(uv) != len(vertices):
        return flat  # `match` tells what is wrong
    core, _ = _core.Surface.from_triangles(points[vertices], faces.astype(np.int64), mend=True)
    return uv[core.ids], core.faces, vertices[core.ids]


def _sources_in(vertices: NDArray[np.int64], sources: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first copy of each source in a map, and which of the sources the map contains."""
    distinct, first = np.unique(vertices, return_index=True)
    places = np.searchsorted(distinct, sources).clip(max=len(distinct) - 1)
    kept = np.flatnonzero(distinct[places] == sources)
    if len(kept) < 2:
        raise InputError(f"the map contains {len(kept)} of the {len(sources)} sources. Pass a map of the whole surface")
    return first[places[kept]].astype(np.int64), kept


def cut_length(
    made: Prepared, points: NDArray[np.float64], faces: NDArray[np.int64], vertices: NDArray[np.int64]
) -> float:
    """Return the length of the boundary that a map has on the surface and that the uncut surface does not have."""
    edges = _boundary(faces)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    keys = np.sort(vertices[edges], axis=1) @ [len(made.uncut_points), 1]
    own = np.sort(_boundary(made.uncut_faces), axis=1) @ [len(made.uncut_points), 1]
    _, first = np.unique(keys, return_index=True)
    return float(lengths[first][~np.isin(keys[first], own)].sum())


def _boundary(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges that belong to a single triangle, shape (E, 2)."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    found, counts = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(found[counts == 1]).reshape(-1, 2)
