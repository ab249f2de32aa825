"""Exact geodesic distances from fixed sources, on the cut and on the uncut surface.

`truth.npz` of a surface contains ``sources`` (S,), vertices of the cut surface; ``cut`` (S, N), their distances to all
vertices on the cut surface; ``uncut`` (S, V), those of the same places on the uncut surface; and ``surface``, the hash
of the cut surface. Distances are in the unit of the surface, in single precision.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.benchmark.manifest import Entry
from voxflat.benchmark.prepare import Prepared, load
from voxflat.errors import InputError
from voxflat.io.files import atomic_path

SOURCES = 100
"""Number of sources of a surface; large surfaces have fewer."""

_FEWEST, _WORK = 20, 6e8  # sum of points ** 1.5 over all sources
_SEED = 67
_TRUTH = "truth.npz"


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact distances of a surface."""

    sources: NDArray[np.int64]  # (S,), vertices of the cut surface
    cut: NDArray[np.float32]  # (S, N)
    uncut: NDArray[np.float32]  # (S, V)

    @property
    def hash(self) -> str:
        """The SHA-256 hash of the sources and of all distances."""
        parts = (
            self.sources.astype("<i4").tobytes(),
            self.cut.astype("<f4").tobytes(),
            self.uncut.astype("<f4").tobytes(),
        )
        return hashlib.sha256(b"".join(parts)).hexdigest()


def sources_of(made: Prepared) -> NDArray[np.int64]:
    """Return the sources of a surface: random vertices, ascending."""
    count = len(made.points)
    number = min(SOURCES, count, max(_FEWEST, int(_WORK / count**1.5)))
    return np.sort(_core.reference_sources(count, number, _SEED)).astype(np.int64)


def distances(points: NDArray[np.float64], faces: NDArray[Any], sources: NDArray[Any]) -> NDArray[np.float32]:
    """Return the exact distances from some vertices to all, infinite for those that are not connected."""
    rows = np.full((len(sources), len(points)), np.inf, dtype=np.float32)
    links = scipy.sparse.coo_array((np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())))
    links.resize((len(points), len(points)))
    _, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    for part in np.unique(label[sources]):
        core, _ = _core.Surface.from_triangles(points, faces[label[faces[:, 0]] == part])
        number = np.full(len(points), -1, dtype=np.int64)
        number[core.ids] = np.arange(len(core))
        inside = np.flatnonzero(label[sources] == part)
        found = core.rows(number[sources[inside]].astype(np.uint32), "exact")
        rows[np.ix_(inside, core.ids)] = found
    return rows


def compute(made: Prepared) -> Truth:
    """Compute the distances of a surface."""
    sources = sources_of(made)
    cut = distances(made.points, made.faces, sources)
    is_same = len(made.points) == len(made.uncut_points) and np.array_equal(made.faces, made.uncut_faces)
    uncut = cut if is_same else distances(made.uncut_points, made.uncut_faces, made.vertices[sources])
    return Truth(sources, cut, uncut)


def truth(folder: Path, entries: Sequence[Entry], check: int, tell: Callable[[str], None] = print) -> dict[str, Any]:
    """Compute and store the distances of surfaces, and return facts on each.

    `check`: number of sources whose distances are compared with those of pygeodesic.
    """
    facts: dict[str, Any] = {}
    for entry in entries:
        made = load(folder, entry.name)
        path = folder / entry.name / _TRUTH
        known = stored(folder, made)
        found = known or compute(made)
        if known is None:
            with atomic_path(path) as temporary, temporary.open("wb") as file:
                arrays: dict[str, Any] = {"sources": found.sources, "cut": found.cut, "uncut": found.uncut}
                np.savez(file, **arrays, surface=made.hashes["cut"])
        facts[entry.name] = {"sources": len(found.sources), "vertices": len(made.points), "sha256": found.hash}
        if check:
            facts[entry.name]["difference"] = difference(made, found, check)
        tell(f"{entry.name}: {json.dumps(facts[entry.name])}")
    return facts


def stored(folder: Path, made: Prepared) -> Truth | None:
    """Return the stored distances of a surface; None if there are none, or if they are those of another surface."""
    path = folder / made.name / _TRUTH
    if not path.is_file():
        return None
    with np.load(path) as file:
        if str(file["surface"]) != made.hashes["cut"]:
            return None
        return Truth(file["sources"], file["cut"], file["uncut"])


def load_truth(folder: Path, made: Prepared) -> Truth:
    """Return the stored distances of a surface, which must be there."""
    found = stored(folder, made)
    if found is None:
        raise InputError(f"the true distances of {made.name} are missing. Run `voxflat bench truth {folder}`")
    return found


def difference(made: Prepared, found: Truth, count: int) -> float:
    """Return the largest relative difference from the distances of pygeodesic, on the cut and on the uncut surface."""
    from voxflat.io.files import require

    geodesic = require("pygeodesic.geodesic")
    largest = 0.0
    chosen = np.linspace(0, len(found.sources) - 1, count).round().astype(int)
    surfaces = [(made.points, made.faces, found.cut, found.sources)]
    if found.uncut is not found.cut and found.uncut.shape != found.cut.shape:
        surfaces.append((made.uncut_points, made.uncut_faces, found.uncut, made.vertices[found.sources]))
    for points, faces, rows, sources in surfaces:
        solver = geodesic.PyGeodesicAlgorithmExact(points, faces)
        for number in chosen:
            other, _ = solver.geodesicDistances(np.array([sources[number]]), None)
            is_apart = other > 0
            largest = max(largest, float(np.max(np.abs(rows[number][is_apart] / other[is_apart] - 1))))
    return largest
