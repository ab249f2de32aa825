"""Distances between all vertices of a surface, or between parcels, in memory or in a file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from voxflat.arguments import (
    Progress,
    amount,
    check_memory,
    checked_choice,
    checked_instance,
    checked_path,
    checked_threads,
    log,
    poll,
    shown,
)
from voxflat.errors import InputError
from voxflat.io.matrices import MatrixSide, read_back, writing_matrix
from voxflat.io.meshes import LEFT, RIGHT
from voxflat.io.provenance import Record, described, record_of
from voxflat.io.reading import reading
from voxflat.maps.parcels import labels_at
from voxflat.maps.surface_points import SurfacePoints
from voxflat.read_only import ReadOnly
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.parts import largest_piece

SYMMETRIC = ("graph", "exact")
"""The solvers whose distances are the same in both directions, up to rounding; those of fast marching are not."""

METHODS = ("mean", "min", "centroid")
KINDS = {"float32": np.inf, "float16": float(np.finfo(np.float16).max), "uint8": 254.0}
"""The types of the values, with the largest finite distance that they hold."""

NO_PATH = 255  # in uint8
_BLOCK = 1 << 28  # bytes of rows that are computed together: more neighbouring rows share a search
_NONE = -1


@dataclass(frozen=True, eq=False)
class DistanceMatrix(ReadOnly):
    """Geodesic distances between all pairs of vertices, voxels or parcels.

    `Surface.geodesic_matrix` makes one. NumPy converts it to an array.

    Parameters
    ----------
    values : ndarray, shape (N, N)
        The distances in `unit`. Those of a file are read on demand. Between hemispheres, they are infinite; a matrix of
        type uint8 has 255 there, and other distances as whole numbers up to 254.
    ids : ndarray of int64, shape (N,) or (N, 3)
        The vertex number or voxel of each row, or the label of its parcel.
    names : tuple of str
        The names of the parcels; empty for vertices and voxels.
    sides : ndarray of str, shape (N,)
        The hemisphere of each row: "left", "right", or "" if it is not known.
    unit : str
        The unit of length; "unknown" if the surface has none.
    provenance : dict
        Record of how the distances were computed.

    See Also
    --------
    Surface.geodesic_matrix : Compute a matrix.

    Examples
    --------
    >>> matrix = voxflat.samples.hill().geodesic_matrix()
    >>> matrix.values.shape
    (441, 441)
    """

    values: NDArray[np.number]
    ids: NDArray[np.int64]
    names: tuple[str, ...]
    sides: NDArray[np.str_]
    unit: str
    provenance: Record

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype) if copy else np.asarray(self.values, dtype=dtype)

    def __repr__(self) -> str:
        of = f"{len(self.names)} parcels" if self.names else f"{len(self.ids)} points"
        return f"<DistanceMatrix: {of}, {self.values.dtype}>"


@dataclass(frozen=True, eq=False)
class _Side:
    """One surface and, if distances are between parcels, the parcel of each of its points."""

    part: Manifold
    codes: NDArray[np.int64] | None = None  # (N,) of parcels from 0; −1 where there is none
    labels: tuple[int, ...] = ()
    names: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """The number of rows of the matrix."""
        return len(self.part) if self.codes is None else len(self.labels)

    def described(self) -> MatrixSide:
        """Return the rows for a file."""
        origin = self.part.origin
        is_mesh = not origin.is_voxels
        vertices = origin.mesh.vertices if is_mesh else None
        if self.codes is None:
            return MatrixSide(origin.structure, vertices, self.part.ids)
        codes = self.codes
        members = tuple(self.part.ids[codes == n] for n in range(self.size)) if is_mesh else ()
        return MatrixSide(origin.structure, vertices, np.array(self.labels, dtype=np.int64), self.names, members)


def geodesic_matrix(
    surface: Manifold,
    parcels: object | None,
    other: object | None,
    *,
    method: str,
    geodesic: str,
    table: object | None,
    file: str | os.PathLike[str] | None,
    dtype: str,
    sidecar: bool,
    overwrite: bool,
    threads: int | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> DistanceMatrix:
    """Compute the distances between all vertices or parcels; see `voxflat.Surface.geodesic_matrix`."""
    checked_choice(geodesic, "geodesic", SYMMETRIC)
    checked_choice(method, "method", METHODS)
    kind, threads = np.dtype(checked_choice(dtype, "dtype", KINDS)), checked_threads(threads)
    path = None if file is None else checked_path(file, "file")
    if parcels is None and (method != "mean" or table is not None):
        given = f"method is {method!r}" if method != "mean" else f"table is {shown(table)}"
        raise InputError(f"{given}, but there are no parcels. Pass parcels, or omit it")
    given_parts = [surface] if other is None else _both(surface, other)
    with reading(memory_limit) as files:
        sides = _sides(given_parts, _of_each(parcels, surface, given_parts), table)
    settings = {"of": surface, "parcels": parcels, "other": other, "method": None if parcels is None else method}
    settings |= {"geodesic": geodesic, "table": table, "dtype": dtype}
    record = record_of("geodesic_matrix", described(settings), dict(sorted(files.items())))
    record["unit"] = surface.origin.named_unit
    rows = [side.described() for side in sides]
    count = sum(map(len, rows))
    limits: dict[str, Any] = {"geodesic": geodesic, "threads": threads, "progress": progress}
    largest = max(len(side.part) for side in sides)
    need = 2 * min(_BLOCK, 4 * largest**2) + (0 if parcels is None else 24 * count * largest)
    if path is None:
        check_memory(need + kind.itemsize * count**2, memory_limit, "pass file, so that the distances stay on disk")
        values: Any = np.empty((count, count), dtype=kind)
        _fill(values, sides, method, kind, limits)
    else:
        check_memory(need, memory_limit, "use a smaller part of the surface")
        log.info("%s of disk space will be used for %s", amount(kind.itemsize * count**2), path)
        with writing_matrix(path, rows, kind, record, sidecar=sidecar, overwrite=overwrite) as sink:
            _fill(sink, sides, method, kind, limits)
        values = read_back(path)
    names = tuple(name for side in sides for name in side.names)
    texts = {LEFT: "left", RIGHT: "right"}
    of_side = np.repeat([texts.get(side.part.origin.structure or "", "") for side in sides], [s.size for s in sides])
    ids = np.concatenate([row.ids for row in rows])
    return DistanceMatrix(values, ids, names, of_side, surface.origin.named_unit, record)


def _both(surface: Manifold, other: object) -> list[Manifold]:
    """Return both hemispheres, the left one first."""
    checked_instance(other, Manifold, "other surface", "the surface of the other hemisphere")
    both: list[Any] = [surface, other]
    sides = [one.origin.structure for one in both]
    if set(sides) != {LEFT, RIGHT}:
        named = " and ".join("unknown" if side is None else f"the {side}" for side in sides)
        raise InputError(f"the hemispheres of the two surfaces are {named}. Pass a left and a right hemisphere")
    units = {one.origin.named_unit for one in both}
    if len(units) > 1:
        raise InputError(f"the surfaces are in {' and in '.join(sorted(units))}. Convert one of them")
    return both if sides[0] == LEFT else both[::-1]


def _of_each(parcels: object, surface: Manifold, parts: Sequence[Manifold]) -> list[object]:
    """Return the parcels of each surface: a single file with both hemispheres, or one for each."""
    if len(parts) == 1:
        return [parcels]
    if isinstance(parcels, list | tuple) and len(parcels) == 2:
        return list(parcels) if parts[0] is surface else list(parcels)[::-1]
    if parcels is None or (isinstance(parcels, str | os.PathLike) and os.fspath(parcels).endswith(".dlabel.nii")):
        return [parcels, parcels]
    raise InputError(f"parcels is {shown(parcels)}. Pass a .dlabel.nii file with both hemispheres, or a pair")


def _sides(parts: Sequence[Manifold], parcels: Sequence[object], table: object) -> list[_Side]:
    sides = []
    for part, labels in zip(parts, parcels, strict=True):
        part = largest_piece(part)
        if labels is None:
            sides.append(_Side(part))
            continue
        places = SurfacePoints(part.points, part.core.normals, part.ids, part.origin, part.faces)
        given, named = labels_at(places, labels, table=table)
        present = np.unique(given[given != _NONE])
        codes = np.where(given == _NONE, _NONE, np.searchsorted(present, given))
        names = tuple(named.names.get(int(label), str(label)) for label in present)
        sides.append(_Side(part, codes, tuple(present.tolist()), names))
    return sides


def _fill(sink: Any, sides: Sequence[_Side], method: str, kind: np.dtype[Any], limits: dict[str, Any]) -> None:
    """Write all rows; those of one side are infinite at the other."""
    count, start = sum(side.size for side in sides), 0
    for number, side in enumerate(sides):
        stage = "measuring distances" + (f" ({number + 1} of {len(sides)})" if len(sides) > 1 else "")
        own, first = {**limits, "stage": stage}, start
        for rows in _blocks(side, own) if side.codes is None else [_between_parcels(side, method, own)]:
            if side.size < count:
                own_rows, rows = rows, np.full((len(rows), count), np.inf, dtype=np.float32)
                rows[:, first : first + side.size] = own_rows
            sink[start : start + len(rows)] = _stored(rows, kind)
            start += len(rows)


def _blocks(side: _Side, limits: dict[str, Any], sources: NDArray[np.uint32] | None = None) -> Iterator[Any]:
    """Yield the distances from some points, or from all, to all points of a side, a block of rows at a time."""
    core, progress, stage = side.part.core, limits["progress"], limits["stage"]
    sources = np.arange(len(core), dtype=np.uint32) if sources is None else sources
    step = max(1, _BLOCK // (4 * len(core)))
    for start in range(0, len(sources), step):
        block = sources[start : start + step]
        inner = None if progress is None else _within(progress, stage, start, len(sources))
        yield core.rows(block, limits["geodesic"], threads=limits["threads"], progress=inner)
    poll(progress, stage, len(sources), len(sources))


def _within(progress: Progress, stage: str, start: int, total: int) -> Progress:
    """Return the progress of a block as that of all rows."""
    return lambda _, done, __: progress(stage, min(total, start + done), total)


def _between_parcels(side: _Side, method: str, limits: dict[str, Any]) -> NDArray[np.float64]:
    """Return the distances between the parcels of a side; the diagonal is 0."""
    codes, count = np.asarray(side.codes), side.size
    order = np.flatnonzero(codes != _NONE)
    order = order[np.argsort(codes[order], kind="stable")]
    sizes = np.bincount(codes[order], minlength=count)
    if method == "centroid":
        chosen = _centres(side.part.points, codes, order, sizes)
        sources = chosen.astype(np.uint32)
        values: NDArray[Any] = np.concatenate([rows[:, chosen] for rows in _blocks(side, limits, sources)])
        values = values.astype(np.float64)
    else:
        progress, stage = limits["progress"], limits["stage"]
        inner = None if progress is None else _named(progress, stage)
        how = {"threads": limits["threads"], "progress": inner}
        members = order.astype(np.uint32), sizes.astype(np.uint32)
        values = side.part.core.distances_between(*members, method, limits["geodesic"], **how)
    values = (values + values.T) / 2 if method != "min" else np.minimum(values, values.T)
    np.fill_diagonal(values, 0)
    return values


def _centres(
    points: NDArray[np.float64], codes: NDArray[np.int64], order: NDArray[np.int64], sizes: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the vertex of each parcel that is nearest to the mean position; `order` lists them parcel by parcel."""
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    means = np.add.reduceat(points[order], starts) / sizes[:, None]
    far = np.linalg.norm(points[order] - means[codes[order]], axis=1)
    return np.array([order[s + np.argmin(far[s : s + n])] for s, n in zip(starts, sizes, strict=True)])


def _named(progress: Progress, stage: str) -> Progress:
    """Return the progress under the name of a stage."""
    return lambda _, done, total: progress(stage, done, total)


def _stored(rows: NDArray[np.floating[Any]], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return distances in another type; raise an error if it cannot hold them."""
    limit = KINDS[kind.name]
    if limit == np.inf:
        return rows.astype(kind, copy=False)
    finite = np.isfinite(rows)
    if (longest := float(rows[finite].max(initial=0))) > limit:
        raise InputError(f"distances reach {longest:.4g}, but {kind.name} holds up to {limit:.0f}. Use float32")
    if kind.kind == "u":
        return np.where(finite, np.rint(rows), NO_PATH).astype(kind)
    return rows.astype(kind)
