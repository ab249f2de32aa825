"""Parcels on a map: labels of its points, with names and colours from their file."""

import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import shown
from voxflat.errors import InputError
from voxflat.io.formats.border import Border
from voxflat.io.label_tables import LabelTable, are_region_files, own_table, read_table, region_files
from voxflat.io.partners import check_partner
from voxflat.maps.colours import all_whole, label_colour
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.enclosed import Enclosing
from voxflat.maps.lines import borders, region_corners
from voxflat.maps.plane import Planar
from voxflat.maps.raster import Raster, at_points
from voxflat.maps.regions import Regions
from voxflat.maps.sampling import Sampling
from voxflat.maps.sources import source_of, vertex_channels
from voxflat.maps.surface_points import SurfacePoints

_NONE = -1


@dataclass(frozen=True, eq=False)
class Parcels:
    """Parcels of a map: a label for each point, with names and colours."""

    flat_map: Planar
    labels: NDArray[np.int64]  # (N,); −1 where there is no parcel
    table: LabelTable  # the default name is the number of the label, and the default colour is `label_colour`

    @cached_property
    def names(self) -> dict[int, str]:
        """The name of each parcel on the map, by label."""
        present = (int(label) for label in np.unique(self.labels) if label != _NONE)
        return {label: self.table.names.get(label, str(label)) for label in present}

    @cached_property
    def colours(self) -> dict[int, tuple[int, int, int]]:
        """The colour of each parcel on the map, by label: red, green and blue, from 0 to 255."""
        return {label: self.table.colours.get(label) or label_colour(label) for label in self.names}

    @cached_property
    def borders(self) -> list[NDArray[np.float64]]:
        """The borders between parcels: smooth lines of shape (k, 2) in mm, from `lines.borders`."""
        return borders(self.flat_map._triangles.uv, self.flat_map._whole_faces, self.labels)

    def at(self, corners: NDArray[Any], weights: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """Return the labels of places, given by the corners (M, 3) of triangles and their weights."""
        flat = self.flat_map
        return self.labels[region_corners(flat._triangles.uv, flat._whole_faces, self.labels, corners, weights)]

    def raster(self, raster: Raster) -> NDArray[np.int64]:
        """Return the label of each pixel, with areas separated by the lines `borders`; −1 where there is no label."""
        inside = raster.inside
        pixels = np.full(raster.shape, _NONE)
        pixels[inside] = self.at(raster.corners[inside], np.asarray(raster.weights[inside], dtype=np.float64))
        return pixels

    def coloured(self, labels: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return the RGBA colours of labels, with opacity 0 where there is no parcel."""
        present, which = np.unique(labels, return_inverse=True)
        rows = [(*self.colours[label], 255) if label in self.colours else (0, 0, 0, 0) for label in present.tolist()]
        return np.array(rows, dtype=np.uint8)[which.reshape(labels.shape)]


@dataclass(frozen=True, eq=False)
class _Enclosed:
    """Find the vertices inside borders, on triangles that are arranged when the first border is read."""

    surface: SurfacePoints

    @cached_property
    def _enclosing(self) -> Enclosing:
        surface, count = self.surface, self.surface.origin.mesh.vertices
        points = None
        if surface.is_known:
            points = np.zeros((count, 3))
            points[surface.ids] = surface.points
        return Enclosing(surface.ids[np.asarray(surface.faces, dtype=np.int64)], points, count)

    def inside(self, border: Border) -> NDArray[np.bool_]:
        """Return a mask of the vertices of the mesh that a border encloses."""
        return self._enclosing.inside(border)


def check_table(parcels: object, table: object) -> None:
    """Raise an error if a table is given, but no labels to which its names apply."""
    if table is not None and (parcels is None or isinstance(parcels, Parcels)):
        raise InputError(f"table is {shown(table)}, but there are no labels that it names. Omit table, or pass parcels")


def are_drawn(labels: object) -> bool:
    """Return whether labels are regions of a map, or a file of regions that were drawn on a map."""
    if isinstance(labels, str | os.PathLike):
        return str(os.fspath(labels)).lower().endswith((".svg", ".json"))
    return isinstance(labels, Regions)


def are_voxels(surface: SurfacePoints, labels: object) -> bool:
    """Return whether labels belong to voxels, which are sampled at a depth."""
    return not (are_region_files(labels) or are_drawn(labels)) and vertex_channels(surface, labels) is None


def parcels_of(flat_map: Any, labels: object, *, table: object = None, depths: Depths = ON_SURFACE) -> Parcels:
    """Return labels on a map, as `labels_at` returns them at its points, or regions that were drawn on the map."""
    if are_drawn(labels):
        if table is not None:
            raise InputError("drawn regions have their own names, so a table does not apply. Omit the table")
        drawn: Regions = labels if isinstance(labels, Regions) else flat_map.regions(labels)
        if drawn.of is not flat_map:
            raise InputError("the regions belong to another map. Pass regions of this map, or their file")
        keys = zip(drawn.keys, drawn.names, map(tuple, drawn.colours.tolist()), strict=True)
        names, colours = {}, {}
        for key, name, colour in keys:
            names[key], colours[key] = name, colour
        return Parcels(flat_map, np.where(drawn.labels == 0, _NONE, drawn.labels), LabelTable(names, colours))
    return Parcels(flat_map, *labels_at(flat_map._triangles.on_surface, labels, table=table, depths=depths))


def labels_at(
    surface: SurfacePoints, labels: object, *, table: object = None, depths: Depths = ON_SURFACE
) -> tuple[NDArray[np.int64], LabelTable]:
    """Return the label of each point, −1 where there is none, and their table; raise an `InputError` if all are −1.

    Labels are given for the vertices of the mesh (``.annot``, ``.label.gii``, ``.dlabel.nii``, one or several
    FreeSurfer ``.label`` or Workbench ``.border`` files, or an array of whole numbers of shape (V,)), or as a volume.
    With a volume, each point takes the label of the nearest voxel or, at several depths, the most frequent label among
    the surrounding voxels. `table` provides names and colours that the file does not contain.
    """
    if are_drawn(labels):
        named = "regions of a map" if isinstance(labels, Regions) else str(labels)
        raise InputError(f"{named}: regions drawn on a map need the map. Save them with voxflat regions, as .annot")
    way = "nearest" if len(depths) == 1 else "majority"
    if are_region_files(labels) and not surface.origin.is_voxels:
        paths: Any = labels if isinstance(labels, list | tuple) else [labels]
        for path in paths:
            check_partner(path, surface.origin)
        if table is not None:
            raise InputError(".label and .border files have their own names, so a table does not apply. Omit the table")
        labels, table = region_files(paths, surface.origin.mesh.vertices, _Enclosed(surface).inside)
    values = source_of(surface, labels).image(at_points(len(surface.points)), Sampling(depths, "mean", way)).data
    file = f"{labels}: " if isinstance(labels, str | os.PathLike) else ""
    if values.ndim != 2 or not all_whole(values):
        raise InputError(f"{file}labels must be whole numbers. Show other values as an overlay")
    if not np.isfinite(values).any():
        raise InputError(f"{file}there are no labels on the surface. Check that the affines match")
    names = read_table(table) if isinstance(table, str | os.PathLike) else table
    if not isinstance(names, LabelTable):
        names = own_table(labels) or LabelTable()
    with np.errstate(invalid="ignore"):  # values out of range are not labels
        codes = np.nan_to_num(values[:, 0], nan=_NONE).astype(np.int64)
    for label in np.unique(codes):
        if not names.is_region(int(label)):
            codes[codes == label] = _NONE
    return codes, names
