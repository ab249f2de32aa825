"""Write square matrices row by row: NumPy, text, CIFTI, HDF5 and Zarr."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.channels import cifti_structure
from voxflat.io.files import atomic_directory, atomic_path, check_new, require
from voxflat.io.provenance import Record, as_text, check_beside, portable, saving
from voxflat.io.tables import write_table

MATRIX_ENDINGS = (".npy", ".csv", ".tsv", ".txt", ".h5", ".hdf5", ".zarr", ".dconn.nii", ".pconn.nii")
_DELIMITERS = {".csv": ",", ".tsv": "\t", ".txt": " "}
_TABLE = "rows.tsv"  # of the rows, beside files that cannot contain it


@dataclass(frozen=True, eq=False)
class MatrixSide:
    """The rows of one surface: its vertices, or its parcels with their vertices."""

    structure: str | None  # in GIFTI notation
    vertices: int | None  # of the complete mesh; None for voxels
    ids: NDArray[np.int64]  # (n,) vertices or labels, or (n, 3) voxels
    names: tuple[str, ...] = ()  # of parcels
    members: tuple[NDArray[np.int64], ...] = ()  # vertices of each parcel

    def __len__(self) -> int:
        return len(self.ids)

    def rows(self) -> list[list[str]]:
        """Return the cells of a table: the hemisphere, the number of the vertex, voxel or label, and the name."""
        side = {"CortexLeft": "left", "CortexRight": "right"}.get(self.structure or "", "n/a")
        names = self.names or ("n/a",) * len(self)
        cells = [[",".join(map(str, np.atleast_1d(number).tolist()))] for number in self.ids]
        return [[side, *cell, name] for cell, name in zip(cells, names, strict=True)]


@contextmanager
def writing_matrix(
    path: Path, sides: list[MatrixSide], kind: np.dtype[Any], record: Record, **writing: bool
) -> Iterator[Any]:
    """Yield an array-like of shape (n, n) whose rows are written to a file, completely or not at all."""
    ending = ending_of(path, sides, kind)
    with saving(path, record, **writing):
        beside = None if ending in (".h5", ".hdf5", ".zarr", ".dconn.nii", ".pconn.nii") else table_of(path)
        if beside is not None:
            check_beside(path, beside, overwrite=writing.get("overwrite", False))
        elif ending == ".zarr":
            check_new(path)
        with atomic_directory(path) if ending == ".zarr" else atomic_path(path) as temporary:
            yield from _OPEN[ending](temporary, sides, kind, record)
        if beside is not None:
            write_table(beside, [["hemisphere", "id", "name"], *(row for side in sides for row in side.rows())])


def table_of(path: Path) -> Path:
    """Return the path of the table that lists the rows of a matrix."""
    return path.with_name(f"{path.name}.{_TABLE}")


def ending_of(path: Path, sides: list[MatrixSide], kind: np.dtype[Any]) -> str:
    """Return the ending of the name, after checking that the format can hold the matrix."""
    ending = next((end for end in MATRIX_ENDINGS if path.name.lower().endswith(end)), None)
    if ending is None:
        *first, last = MATRIX_ENDINGS
        raise InputError(f"cannot save the matrix as {path.name}. Use a name that ends in {', '.join(first)} or {last}")
    if ending in (".dconn.nii", ".pconn.nii"):
        if kind.name == "float16":
            raise InputError("CIFTI files cannot hold float16. Use float32 or uint8, or save as .npy")
        right = ".pconn.nii" if any(side.names for side in sides) else ".dconn.nii"
        if ending != right:
            of = "parcels" if right == ".pconn.nii" else "vertices"
            raise InputError(f"cannot save distances between {of} as {path.name}. Use a name that ends in {right}")
        for side in sides:
            if side.vertices is None or side.structure is None:
                raise InputError(
                    "CIFTI files hold the hemispheres of a mesh, but the hemisphere of the surface is unknown. Define "
                    "AnatomicalStructurePrimary in its GIFTI file, begin its name with lh. or rh., or save as .npy"
                )
    if ending in (".h5", ".hdf5"):
        require("h5py")
    if ending == ".zarr":
        require("zarr")
    return ending


def read_back(path: Path) -> Any:
    """Return the values of a matrix that was just written; those of NumPy, CIFTI and HDF5 stay on disk."""
    name = path.name.lower()
    if name.endswith(".npy"):
        return np.load(path, mmap_mode="r")
    if name.endswith(".nii"):
        proxy = require("nibabel").load(path).dataobj
        return _mapped(path, proxy.dtype, proxy.offset, proxy.shape[-2:]).T  # NIfTI stores columns
    if name.endswith((".h5", ".hdf5")):
        with require("h5py").File(path, "r") as file:
            stored = file["distances"]
            return _mapped(path, stored.dtype, stored.id.get_offset(), stored.shape)
    if name.endswith(".zarr"):
        return require("zarr").open_array(str(path / "distances"), mode="r")
    return np.loadtxt(path, delimiter=_DELIMITERS[path.suffix.lower()], ndmin=2)


def _mapped(path: Path, kind: Any, offset: int, shape: tuple[int, ...]) -> NDArray[Any]:
    return np.memmap(path, dtype=kind, mode="r", offset=offset, shape=shape)


def _shape(sides: list[MatrixSide]) -> tuple[int, int]:
    count = sum(map(len, sides))
    return count, count


@dataclass
class _Rows:
    """Rows that are written one after another; a memory map would count as memory of the process."""

    file: IO[bytes]

    def __setitem__(self, index: slice, rows: NDArray[Any]) -> None:
        self.file.write(np.ascontiguousarray(rows).data)


def _npy(path: Path, sides: list[MatrixSide], kind: np.dtype[Any], record: Record) -> Iterator[Any]:
    header = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": _shape(sides)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        yield _Rows(file)


def _text(path: Path, sides: list[MatrixSide], kind: np.dtype[Any], record: Record) -> Iterator[Any]:
    form, delimiter = "%d" if kind.kind == "u" else "%.7g", _DELIMITERS[path.suffix.lower()]
    with path.open("w", encoding="utf-8", newline="\n") as file:

        class Rows:
            def __setitem__(self, index: slice, rows: NDArray[Any]) -> None:
                np.savetxt(file, rows, form, delimiter)

        yield Rows()


def _cifti(path: Path, sides: list[MatrixSide], kind: np.dtype[Any], record: Record) -> Iterator[Any]:
    nib = require("nibabel")
    axes = nib.cifti2.cifti2_axes
    if any(side.names for side in sides):
        parcels: Any = []
        sizes = {cifti_structure(str(side.structure)): side.vertices for side in sides}
        for side in sides:
            name = cifti_structure(str(side.structure))
            none = np.empty((0, 3), dtype=int)
            parcels += [(text, none, {name: own}) for text, own in zip(side.names, side.members, strict=True)]
        names, voxels, vertices = zip(*parcels, strict=True)
        axis: Any = axes.ParcelsAxis(names, voxels, vertices, nvertices=sizes)
    else:
        each = [
            axes.BrainModelAxis.from_surface(side.ids, side.vertices, cifti_structure(str(side.structure)))
            for side in sides
        ]
        axis = each[0] if len(each) == 1 else each[0] + each[1]
    shape = _shape(sides)
    empty = np.broadcast_to(np.zeros(1, dtype=kind), shape)
    header = nib.Cifti2Header.from_axes((axis, axis))
    header.matrix.metadata = nib.cifti2.Cifti2MetaData({"voxflat": as_text(portable(record))})
    image = nib.Cifti2Image(empty, header)
    image.nifti_header.set_intent("NIFTI_INTENT_CONNECTIVITY_" + ("PARCELLATED" if sides[0].names else "DENSE"))
    image.nifti_header.set_data_dtype(kind)
    image.to_filename(path)
    with path.open("r+b") as file:
        file.seek(nib.load(path).dataobj.offset)
        yield _Rows(file)


def _hdf5(path: Path, sides: list[MatrixSide], kind: np.dtype[Any], record: Record) -> Iterator[Any]:
    h5py = require("h5py")
    with h5py.File(path, "w") as file:
        file.attrs["voxflat"] = as_text(portable(record))
        side, ids, names = zip(*(row for one in sides for row in one.rows()), strict=True)
        for name, column in {"hemisphere": side, "id": ids, "name": names}.items():
            file.create_dataset(name, data=np.array(column, dtype=object), dtype=h5py.string_dtype())
        yield file.create_dataset("distances", _shape(sides), kind)


def _zarr(path: Path, sides: list[MatrixSide], kind: np.dtype[Any], record: Record) -> Iterator[Any]:
    zarr = require("zarr")
    form: Any = {"zarr_format": 2} if int(zarr.__version__.split(".")[0]) > 2 else {}  # the only format before
    group = zarr.open_group(str(path), mode="a", **form)
    side, ids, names = zip(*(row for one in sides for row in one.rows()), strict=True)
    rows = {"hemisphere": list(side), "id": list(ids), "name": list(names)}
    group.attrs["voxflat"] = {"rows": rows, "provenance": portable(record)}
    shape = _shape(sides)
    chunks = (min(shape[0], 256), shape[1])
    yield zarr.open_array(str(path / "distances"), mode="w", shape=shape, chunks=chunks, dtype=kind, **form)


_OPEN: dict[str, Any] = {
    ".npy": _npy,
    **dict.fromkeys((".csv", ".tsv", ".txt"), _text),
    **dict.fromkeys((".dconn.nii", ".pconn.nii"), _cifti),
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
    ".zarr": _zarr,
}
