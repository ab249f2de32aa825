"""Distance rows, in memory or in a store on disk, which may be larger than memory and survives interruptions.

A store is a directory: `rows.npy`, `journal.jsonl` (the finished rows with their CRC-32), `store.json` (a description
of the distances), `points.npy`, `ids.npy`, `sources.npy`, and `lock`. The compiled core computes the rows, and writes
them and the journal.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import DTypeLike, NDArray

from voxflat import _core
from voxflat.arguments import checked_path
from voxflat.distances.store import (
    ARRAYS,
    OTHER,
    array_hash,
    read_description,
    read_journal,
    read_provenance,
    write_provenance,
)
from voxflat.distances.table import FINISH, Several, Table
from voxflat.errors import InputError
from voxflat.io.grid import UNITS
from voxflat.io.provenance import Record
from voxflat.read_only import ReadOnly

_CHUNK = 1 << 26  # best number of bytes per read


@dataclass(frozen=True, eq=False)
class DistanceRows(ReadOnly):
    """Geodesic distances from sources to all points of a surface, convertible to an array.

    Rows in a store are read from disk on demand, and slices are arrays in memory.

    Parameters
    ----------
    rows : ndarray of float32, shape (m, N)
        Distances in `unit`; for a store, a `Table` that is read on demand. Column n belongs to the point ``points[n]``,
        whose vertex number in the mesh is ``ids[n]``: a part of a surface has fewer columns than the mesh has vertices,
        and its `Surface.find` returns the columns of vertex numbers.
    ids : ndarray of int64, shape (N, 3) or (N,)
        Voxel indices or vertex numbers of the points.
    points : ndarray of float64, shape (N, 3)
        Positions of the points, in RAS+ in `unit` and in the space of the surface.
    sources : ndarray of int64, shape (m,)
        The sources, as row numbers of the points.
    store : Path, optional
        Directory of the store.
    provenance : dict
        Record of how the distances were computed; a store also contains this record.
    unit : str
        The unit of length of the distances and points; "unknown" if the surface has none, or the store does not tell.

    See Also
    --------
    Surface.geodesic : Measure distances.
    open_rows : Open the rows of a store.

    Examples
    --------
    >>> rows = voxflat.samples.hill().geodesic(5)
    >>> rows.shape, rows.dtype
    ((5, 441), dtype('float32'))
    """

    rows: NDArray[np.float32] | Table
    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    sources: NDArray[np.int64]
    store: Path | None = None
    provenance: Record = field(default_factory=dict)
    unit: str = "unknown"

    def _with_provenance(self, record: Record) -> DistanceRows:
        """Return the same rows with a provenance record and their unit, which are also written to their store."""
        record = {**record, "unit": self.unit}
        if self.store is not None:
            write_provenance(self.store, record)
        return replace(self, provenance=record)

    def __repr__(self) -> str:
        place = "memory" if self.store is None else str(self.store)
        return f"<DistanceRows: {self.shape[0]} sources, {self.shape[1]} points, in {place}>"

    @property
    def shape(self) -> tuple[int, int]:
        """The number of sources and the number of points."""
        return (self.rows.shape[0], self.rows.shape[1])

    @property
    def dtype(self) -> np.dtype[np.float32]:
        """The type of the distances. It is always float32."""
        return self.rows.dtype

    @property
    def ndim(self) -> int:
        """The number of axes. It is always 2."""
        return 2

    @property
    def nbytes(self) -> int:
        """The size of all distances in bytes.

        Rows in a store need this much memory only if they are converted to an array.
        """
        return int(self.rows.nbytes)

    @property
    def chunks(self) -> tuple[int, int]:
        """The shape of the blocks to read at once; each block consists of complete rows.

        Dask uses this shape as a hint.
        """
        height = self.shape[0] if self.store is None else _CHUNK // max(1, 4 * self.shape[1])
        return (max(1, min(height, self.shape[0])), self.shape[1])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.rows, dtype=dtype) if copy else np.asarray(self.rows, dtype=dtype)

    @overload
    def __getitem__(self, index: tuple[int, int]) -> np.float32: ...

    @overload
    def __getitem__(self, index: Several) -> NDArray[np.float32]: ...

    def __getitem__(self, index: Any) -> Any:
        return self.rows[index]

    def __len__(self) -> int:
        """Return the number of sources."""
        return len(self.rows)

    def verify(self) -> None:
        """Read a complete store and compare it with its checksums.

        Rows in memory have no checksums and always pass.

        Raises
        ------
        InputError
            If rows do not match their checksums; the message lists these rows.
        """
        if self.store is None:
            return
        damaged = damaged_rows(self.store, dict(enumerate(_checksums(self.store, self.shape))))
        if damaged:
            which = ", ".join(map(str, damaged[:5])) + (", ..." if len(damaged) > 5 else "")
            raise InputError(f"{self.store}: some rows ({which}) do not match their checksums. {FINISH}")


def open_rows(path: str | os.PathLike[str]) -> DistanceRows:
    """Open the distance rows of a store without reading them.

    Completeness, sizes, points, ids and sources are checked immediately. `DistanceRows.verify` reads all rows and
    compares their checksums.

    Parameters
    ----------
    path : path
        A directory that was passed as a store to `Surface.geodesic`, `Surface.flatten` or ``voxflat rows``.

    Returns
    -------
    DistanceRows
        The rows, which can be passed to NumPy, ``dask.array.from_array`` and ``viewer.add_image`` of napari.

    Raises
    ------
    InputError
        If the directory is not a store, or if the store is incomplete or damaged.

    See Also
    --------
    Surface.geodesic : Measure distances and keep them in a store.

    Examples
    --------
    >>> rows = voxflat.samples.hill().geodesic(5, store="five.rows")
    >>> voxflat.open_rows("five.rows").shape
    (5, 441)
    """
    path = checked_path(path)
    if not path.exists():
        raise InputError(f"{path}: store not found. Create a store first, for example with `voxflat rows`")
    description = read_description(path)
    arrays = {name: _array(path / f"{name}.npy", description[f"{name}_sha256"]) for name in ARRAYS}
    shape = (len(arrays["sources"]), len(arrays["points"]))
    counts = description["sources"], description["points"]
    if counts != shape:
        sizes = f"{counts[0]} sources and {counts[1]} points instead of {shape[0]} and {shape[1]}"
        raise InputError(f"{path / 'store.json'} is damaged: it names {sizes}. {OTHER}")
    _checksums(path, shape)
    rows = Table.open(path / "rows.npy")
    if rows.shape != shape or rows.dtype != np.dtype("<f4"):
        raise InputError(
            f"{path / 'rows.npy'} has data type {rows.dtype} and shape {rows.shape} instead of float32 and {shape}. "
            f"{FINISH}"
        )
    record = read_provenance(path)
    unit = record.get("unit") if record.get("unit") in UNITS else "unknown"
    return DistanceRows(rows, arrays["ids"], arrays["points"], arrays["sources"], path, record, str(unit))


def _array(path: Path, expected: str) -> NDArray[Any]:
    array = np.asarray(Table.open(path))
    if array_hash(array) != expected:
        raise InputError(f"{path} does not match its checksum in store.json. {FINISH}")
    return array


def _checksums(path: Path, shape: tuple[int, int]) -> list[int]:
    """Return the checksums of the rows in a complete store."""
    journal = read_journal(path)
    if (journal.rows, journal.columns) != shape:
        raise InputError(f"{path / 'journal.jsonl'} is damaged (expected {shape[0]} x {shape[1]} distances). {OTHER}")
    checksums = [journal.checksums[row] for row in range(journal.rows) if row in journal.checksums]
    if not journal.is_complete or len(checksums) < journal.rows:
        raise InputError(f"the store {path} is not complete ({len(checksums)} of {journal.rows} rows). {FINISH}")
    return checksums


def damaged_rows(store: Path, checksums: Mapping[int, int]) -> list[int]:
    """Read the rows of a store that the journal lists, and return those that do not match their CRC-32."""
    shape = Table.open(store / "rows.npy").shape
    if len(shape) != 2:
        raise InputError(f"{store / 'rows.npy'} has shape {shape}, but must have two axes. {FINISH}")
    rows, columns = shape
    if max(checksums, default=0) >= rows:
        raise InputError(f"{store / 'rows.npy'} has {rows} rows, but the journal lists row {max(checksums)}. {FINISH}")
    return _core.damaged_rows(store, columns, [checksums.get(row) for row in range(rows)])
