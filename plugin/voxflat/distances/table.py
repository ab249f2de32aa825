"""An array on disk, read on demand. It is not memory-mapped: a truncated file would end the process (SIGBUS)."""

from dataclasses import dataclass
from pathlib import Path
from types import EllipsisType
from typing import IO, Any, TypeAlias, overload

import numpy as np
from numpy.lib import format as npy
from numpy.typing import DTypeLike, NDArray

from voxflat.errors import InputError
from voxflat.io.files import one_line
from voxflat.io.reading import check_room

_Part: TypeAlias = slice | EllipsisType | list[int] | NDArray[np.integer] | NDArray[np.bool_]
Several: TypeAlias = int | _Part | tuple[_Part, int | _Part] | tuple[int, _Part]
"""An index that selects more than one value of a table."""

FINISH = "Measure again with the same store to complete or repair it"  # remedy for a damaged or incomplete store


@dataclass(frozen=True, eq=False)
class Table:
    """A `.npy` file with one or two axes, in C order; converting it to an array reads all of it."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    start: int  # offset of its values, bytes

    @classmethod
    def open(cls, path: Path) -> "Table":
        """Open a file without reading its values; raise an error if it is shorter than its header specifies."""
        try:
            with path.open("rb") as file:
                major, _ = npy.read_magic(file)
                header = npy.read_array_header_1_0 if major == 1 else npy.read_array_header_2_0
                shape, is_fortran, dtype = header(file)
                start = file.tell()
        except Exception as error:  # NumPy's parser raises TokenError, OverflowError, ... for damaged headers
            raise InputError(f"{path} is damaged ({one_line(error)}). {FINISH}") from error
        if is_fortran or dtype.hasobject or not 1 <= len(shape) <= 2 or min(shape) < 0:
            raise InputError(f"{path} is damaged (it has data type {dtype} and shape {shape}). {FINISH}")
        table = cls(path, tuple(shape), dtype, start)
        if (there := path.stat().st_size) < start + table.nbytes:
            raise table._cut_short(there)
        return table

    def __repr__(self) -> str:
        return f"<Table {self.path}: {self.dtype} of shape {self.shape}>"

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def nbytes(self) -> int:
        """Size of all values in bytes."""
        return int(np.prod(self.shape, dtype=object)) * self.dtype.itemsize

    def __len__(self) -> int:
        """Return the length of the first axis."""
        return self.shape[0]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError(f"{self.path} is on disk, so its values must be copied. Do not pass copy=False")
        check_room(self.nbytes)
        return np.asarray(self._rows(np.arange(len(self)), 0, self._width), dtype=dtype).reshape(self.shape)

    @overload
    def __getitem__(self, index: tuple[int, int]) -> np.number: ...

    @overload
    def __getitem__(self, index: Several) -> NDArray[np.number]: ...

    def __getitem__(self, index: Any) -> Any:
        """Index like an array, and read only the rows that are selected."""
        parts = index if isinstance(index, tuple) else (index,)
        plain = all(isinstance(part, slice | int | np.integer | np.ndarray | list) for part in parts)
        if not plain or not 1 <= len(parts) <= self.ndim or any(np.ndim(part) > 1 for part in parts[:1]):
            return np.asarray(self)[index]
        numbers = np.arange(len(self))[parts[0]]
        columns = np.arange(self._width)[parts[1]] if len(parts) > 1 else np.arange(self._width)
        first, end = (int(columns.min()), int(columns.max()) + 1) if columns.size else (0, 0)
        rows = np.atleast_1d(numbers)
        block = self._rows(rows, first, end)
        if self.ndim == 1:
            return block[0, 0] if np.ndim(numbers) == 0 else block[:, 0]
        place: Any = 0 if np.ndim(numbers) == 0 else np.arange(len(rows))
        if len(parts) == 1:
            return block[place]
        if isinstance(parts[0], slice) or isinstance(parts[1], slice):
            return block[place][..., columns - first]
        return block[place, columns - first]

    @property
    def _width(self) -> int:
        return self.shape[1] if self.ndim == 2 else 1

    def _cut_short(self, there: int) -> InputError:
        return InputError(f"{self.path} was truncated to {there} of {self.start + self.nbytes} bytes. {FINISH}")

    def _rows(self, numbers: NDArray[np.int64], first: int, end: int) -> NDArray[Any]:
        """Read columns `first` to `end` of some rows."""
        block = np.empty((len(numbers), end - first), self.dtype)
        size = self.dtype.itemsize
        is_whole = end - first == self._width and (np.diff(numbers) == 1).all()
        with self.path.open("rb", buffering=0) as file:
            if is_whole and block.size:
                self._read(file, self.start + int(numbers[0]) * self._width * size, block)
            elif block.size:
                for row, number in zip(block, numbers.tolist(), strict=True):
                    self._read(file, self.start + (number * self._width + first) * size, row)
        return block

    def _read(self, file: IO[bytes], place: int, block: NDArray[Any]) -> None:
        file.seek(place)
        rest = block.reshape(-1).view(np.uint8).data
        while rest:
            if not (count := file.readinto(rest)):  # type: ignore[attr-defined]
                raise self._cut_short(self.path.stat().st_size)
            rest = rest[count:]
