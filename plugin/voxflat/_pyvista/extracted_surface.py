"""Extract the surface of any PyVista dataset, and copy its data to the map."""

import warnings
from dataclasses import dataclass

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from scipy.spatial import KDTree

from voxflat.arguments import log
from voxflat.errors import InputError
from voxflat.io.files import naming
from voxflat.io.meshes import Mesh
from voxflat.io.objects import mesh_of_dataset
from voxflat.unique_rows import numbered


@dataclass(frozen=True, eq=False)
class ExtractedSurface:
    """The triangles of the surface of a dataset, with the points of the dataset."""

    dataset: pv.DataSet
    mesh: Mesh
    cell_ids: NDArray[np.int64]  # the cell of the dataset for each triangle

    @classmethod
    def of(cls, dataset: pv.DataSet) -> "ExtractedSurface":
        """Extract the outer surface of a dataset, as `voxflat.surface` does."""
        with naming(dataset, "pass a dataset with a surface"):
            return cls(dataset, *mesh_of_dataset(dataset))

    def point(self, seed: object, name: str) -> int:
        """Return the surface point for a single seed point."""
        point = self.points(seed, name)
        if point.ndim:
            value = np.asarray(seed).tolist()
            raise InputError(f"{name} is {value}. Pass one point number, or one position (three floats)")
        return int(point)

    def points(self, seeds: object, name: str) -> NDArray[np.int64]:
        """Return the surface points for point numbers, positions or cells."""
        if isinstance(seeds, pv.Cell):
            return self._of_cell(seeds, name)
        if isinstance(seeds, list | tuple) and any(isinstance(seed, pv.Cell) for seed in seeds):
            return np.array([int(self.points(seed, name)) for seed in seeds], dtype=np.int64)
        points = np.asarray(seeds)
        if points.dtype.kind == "f":
            return self._nearest(points, name)
        if points.dtype.kind not in "iu":
            raise InputError(f"{name} has data type {points.dtype}. Pass point numbers, positions (x, y, z) or cells")
        is_there = np.isin(points, self._used)
        if not is_there.all():
            missing, kind = int(points[~is_there].flat[0]), type(self.dataset).__name__
            raise InputError(f"{name}: point {missing} is not on the surface of the {kind}. Choose another point")
        return points.astype(np.int64)

    def _of_cell(self, cell: pv.Cell, name: str) -> NDArray[np.int64]:
        """Return the corner of a cell that lies on the surface and is nearest to the centre of the cell."""
        numbers = np.asarray(cell.point_ids)
        is_there = (numbers < self.dataset.n_points) & np.isin(numbers, self._used)
        same = self.dataset.points[numbers.clip(max=self.dataset.n_points - 1)]
        if not is_there.any() or not np.allclose(cell.points, same):
            kind = type(self.dataset).__name__
            raise InputError(f"{name}: the cell is not on the surface of the {kind}. Choose another cell")
        apart = np.linalg.norm(cell.points - cell.points.mean(axis=0), axis=1)
        return self.points(numbers[np.where(is_there, apart, np.inf).argmin()], name)

    def _nearest(self, positions: NDArray[np.float64], name: str) -> NDArray[np.int64]:
        """Return the surface points nearest to the given positions; a warning reports the most distant position."""
        if positions.shape[-1:] != (3,) or positions.ndim > 2 or not np.isfinite(positions).all():
            kind = f"shape {positions.shape} and data type {positions.dtype}"
            raise InputError(f"{name} has {kind}. Pass finite positions (x, y, z)")
        used = self._used
        apart, nearest = KDTree(self.mesh.points[used]).query(positions)
        corners = self.mesh.points[self.mesh.faces]
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        if np.any(apart > longest):
            far = np.asarray(positions).reshape(-1, 3)[np.argmax(apart)].tolist()
            log.warning("%s: the position %s is %.4g away from the surface", name, far, float(np.max(apart)))
        return np.asarray(used[nearest], dtype=np.int64)

    @property
    def _used(self) -> NDArray[np.int64]:
        """Return the points that are corners of triangles."""
        return np.unique(self.mesh.faces)

    def carry(self, flat: pv.PolyData, ids: NDArray[np.int64]) -> None:
        """Copy the arrays of the dataset to a flat mesh; arrays whose names are taken get the prefix ``mesh_``."""
        texture = self.dataset.GetPointData().GetTCoords()
        for name in self.dataset.point_data:
            free = _free(name, flat)
            flat.point_data[free] = self.dataset.point_data[name][ids]
            if texture is not None and name == texture.GetName():  # the picture of the mesh stays on the map
                flat.GetPointData().SetActiveTCoords(free)
        for name in self.dataset.field_data:
            flat.field_data[_free(name, flat)] = self.dataset.field_data[name]
        if not self.dataset.cell_data:
            return
        cells = self._cells(ids[flat.regular_faces])
        if cells is None:
            names = ", ".join(self.dataset.cell_data)
            warnings.warn(f"the mesh was repaired, so its cell data are not copied to the map: {names}", stacklevel=4)
            return
        for name in self.dataset.cell_data:
            flat.cell_data[_free(name, flat)] = self.dataset.cell_data[name][cells]

    def _cells(self, faces: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Return the cell of each triangle, found by its corners; None if any triangle is not part of the surface."""
        corners = np.sort(self.mesh.faces, axis=1)
        numbers, asked = numbered(corners, np.sort(faces, axis=1))
        triangle = np.full(len(corners) + len(faces), -1, dtype=np.int64)
        triangle[numbers] = np.arange(len(corners))
        triangles = triangle[asked]
        return None if (triangles < 0).any() else self.cell_ids[triangles]


def _free(name: str, flat: pv.PolyData) -> str:
    """Return an array name that a flat mesh does not yet use."""
    taken = {*flat.point_data, *flat.cell_data, *flat.field_data}
    if name not in taken:
        return name
    free = f"mesh_{name}"
    while free in taken:
        free = f"mesh_{free}"
    warnings.warn(f"the map already has an array {name!r}, so the array of the mesh is named {free!r}", stacklevel=5)
    return free
