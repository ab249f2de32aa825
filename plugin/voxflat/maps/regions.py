"""Regions of interest drawn on a map: their vertices, and their voxels in the cortex."""

import math
import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import checked_choice, checked_number, checked_path, log, numbers_of, shown
from voxflat.errors import InputError
from voxflat.io.channels import distinct_names
from voxflat.io.chunks import is_stack_path
from voxflat.io.dlabel import write_dlabel
from voxflat.io.files import atomic_path
from voxflat.io.formats.freesurfer import write_annot, write_label
from voxflat.io.formats.gifti import label_bytes
from voxflat.io.formats.svg import Outline, write_outlines
from voxflat.io.grid import in_unit
from voxflat.io.provenance import Record, Recorded, as_text, files_of, portable, saving
from voxflat.io.reading import check_room, reading
from voxflat.io.tables import cell_of, write_table
from voxflat.io.volumes import Volume, read_volume, write_volume
from voxflat.maps.depth import Depths
from voxflat.maps.missing import NAN_POLICIES
from voxflat.maps.plane import Planar
from voxflat.maps.raster import FlatImage, FlatStack
from voxflat.maps.region_properties import AREAS, LENGTHS, properties_of
from voxflat.maps.surface_points import SurfacePoints
from voxflat.maps.volume_place import placed, warn_of_extent
from voxflat.read_only import ReadOnly
from voxflat.unique_rows import distinct

VERTEX_ENDINGS = (".annot", ".label.gii", ".dlabel.nii", ".label")
TABLE_ENDINGS = (".tsv", ".csv")
_VOLUME_ENDINGS = (".nii", ".nii.gz", ".mgh", ".mgz", ".nrrd")
DRAWING = ".svg"
_NAME = "{name}"  # in the file name of several labels
REGION_ENDINGS = (*VERTEX_ENDINGS, DRAWING, *TABLE_ENDINGS, *_VOLUME_ENDINGS)  # of the files of `Regions.save`


_NO_VERTEX = "no vertex lies in a region. Draw regions that are larger than the triangles of the map"


class _Places(Protocol):
    """An object that returns the region at each position."""

    @property
    def pixel_size(self) -> float | None:
        """The side length of its pixels, if it consists of pixels."""

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the key at each position, shape (P,); 0 outside all regions."""

    def drawn(self, key: int) -> list[Outline]:
        """Return the outlines of a region."""


@dataclass(frozen=True, eq=False)
class _Only:
    """One of several regions, where it is not covered by the others."""

    places: _Places
    key: int

    @property
    def pixel_size(self) -> float | None:
        return self.places.pixel_size

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        codes = self.places.labels(places)
        return np.where(codes == self.key, codes, 0)

    def drawn(self, key: int) -> list[Outline]:
        return self.places.drawn(key)


@dataclass(frozen=True, eq=False)
class Regions(ReadOnly, Recorded):
    """Regions on a map, as returned by `FlatMap.regions`.

    They can be evaluated at map positions, vertices and voxels.

    Parameters
    ----------
    of : Planar
        The map.
    names : tuple of str
        Names of the regions.
    keys : tuple of int
        Number of each region in label files; never 0.
    colours : ndarray of uint8, shape (R, 3)
        Red, green, blue.
    places : object
        An object whose method ``labels(places)`` returns the keys at the given positions.
    provenance : dict
        Record of how the regions were made.

    See Also
    --------
    FlatMap.regions : Read regions that were drawn on the map.

    Examples
    --------
    >>> regions = voxflat.samples.hill().flatten().regions({"V1": [[-5, -5], [5, -5], [0, 5]]})
    >>> regions
    <Regions: V1>
    """

    of: Planar
    names: tuple[str, ...]
    keys: tuple[int, ...]
    colours: NDArray[np.uint8]
    places: _Places
    provenance: Record = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of regions."""
        return len(self.names)

    def __repr__(self) -> str:
        return f"<Regions: {textwrap.shorten(', '.join(self.names), 250, placeholder=' ...')}>"

    @property
    def _surface(self) -> SurfacePoints:
        return self.of._triangles.on_surface

    def at(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the region at each of the given positions on the map.

        Where regions overlap, the last one is returned.

        Parameters
        ----------
        places : ndarray, shape (..., 2)
            Positions (u, v), in mm.

        Returns
        -------
        ndarray of int64, shape (...)
            Keys of the regions; 0 outside all regions.

        Examples
        --------
        >>> regions = voxflat.samples.hill().flatten().regions({"V1": [[-5, -5], [5, -5], [0, 5]]})
        >>> regions.at(np.array([[0.0, 0.0], [30.0, 0.0]]))
        array([1, 0])
        """
        points = numbers_of(places, "places")
        if points.ndim == 0 or points.shape[-1] != 2:
            raise InputError(f"places has shape {points.shape}. Pass (u, v) in mm as an array of shape (..., 2)")
        return self.places.labels(points.reshape(-1, 2)).reshape(points.shape[:-1])

    @cached_property
    def labels(self) -> NDArray[np.int64]:
        """The key of the region at each point of the map, shape (N,). Points outside all regions have the key 0."""
        return self.at(self.of._triangles.uv)

    @property
    def vertex_labels(self) -> NDArray[np.int64]:
        """The key of the region at each vertex of the whole mesh, shape (V,).

        Vertices outside all regions or outside the map have the key 0. A vertex on a cut has two positions on the map;
        it is in a region if either position is.
        """
        if self._surface.origin.is_voxels:
            raise InputError("a map of a volume has no mesh vertices. Save a label volume (for example, .nii.gz)")
        labels = np.zeros(self._surface.origin.mesh.vertices, dtype=np.int64)
        is_in = self.labels != 0
        labels[self._surface.ids[is_in][::-1]] = self.labels[is_in][::-1]
        return labels

    def image(self, pixel_size: float | None = None) -> FlatImage:
        """Return an image of the regions on the map.

        It has the same pixels as the images that `FlatMap.image` returns.

        Parameters
        ----------
        pixel_size : float, optional
            As in `FlatMap.raster`.

        Returns
        -------
        FlatImage
            Keys; 0 outside all regions, NaN outside the map.
        """
        raster = self.of.raster(pixel_size)
        rows, columns = np.indices(raster.shape)
        u, v = raster.origin
        centres = np.stack([u + columns * raster.pixel_size, v - rows * raster.pixel_size], axis=-1)
        data = np.where(raster.inside, self.at(centres), np.nan)
        return FlatImage(data, raster.pixel_size, raster.origin, "regions", True, self.provenance, raster.unit)

    def properties(
        self,
        image: FlatImage | FlatStack | NDArray[np.float64] | None = None,
        *,
        pixel_size: float | None = None,
        nan_policy: str = "omit",
    ) -> dict[str, NDArray[np.number]]:
        """Measure the regions as on the surface, like ``regionprops_table`` of scikit-image.

        The metric of the map corrects areas, lengths and directions in each pixel. A region that continues on the other
        side of a cut is measured as a whole.

        Parameters
        ----------
        image : FlatImage, FlatStack or ndarray of shape (H, W), optional
            Values of which to compute the mean, on the pixels of the regions, such as a channel of a stack, or all of
            them.
        pixel_size : float, optional
            Side length of the pixels into which outlines are divided, in mm; by default that of `image` or, for a label
            image, its own, or else a quarter of that of the map.
        nan_policy : {"omit", "propagate"}
            What to do about pixels without a value: "omit" computes the mean of the others, and "propagate" makes the
            mean of their region NaN. In both cases, a warning counts them.

        Returns
        -------
        dict of str to ndarray, each of shape (R,)
            Columns for ``pandas.DataFrame``, with one value for each region:

            - ``label``, ``name``: key and name;
            - ``area``, ``perimeter``: on the surface, in mm² and mm;
            - ``map_area``: on the map, in mm²;
            - ``x``, ``y``, ``z``: centroid on the surface, in mm, in the `space` of the map;
            - ``u``, ``v``: the position on the map that is nearest to this centroid, in mm;
            - ``major_axis``, ``minor_axis``, ``elongation``: lengths of the axes of the ellipse in the tangent plane
              that has the same second moments, in mm, and their ratio;
            - ``direction_x``, ``direction_y``, ``direction_z``: unit vector along the major axis on the surface;
            - ``map_direction``: angle of the major axis on the map, from u towards v, in degrees from −90 to 90;
            - ``curvature``: mean of the map's `curvature`, in 1/mm, if it is known;
            - ``mean``: mean of `image`, if it was given, or ``mean_NAME`` for each of several images. Means are
              weighted by area on the surface.

            A region without a pixel has the area 0, and its other values are NaN.

        Raises
        ------
        InputError
            If the image has other pixels.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> cells = flat_map.regions({"V1": [[-5, -5], [5, -5], [0, 5]]}).properties(pixel_size=0.25)
        >>> cells["area"].round(), cells["map_area"].round()
        (array([58.]), array([50.]))
        """
        checked_choice(nan_policy, "nan_policy", NAN_POLICIES)
        size = getattr(image, "pixel_size", self._pixel_size) if pixel_size is None else pixel_size
        raster = self.of.raster(size)

        def values() -> Iterator[tuple[str, NDArray[np.float64]]]:
            for name, one in _named(image):
                data = numbers_of(one.data if isinstance(one, FlatImage) else one, "image", as_nan=True)
                if data.shape != raster.shape:
                    problem = f"the image has shape {data.shape}, but the map has {raster.shape} pixels of "
                    raise InputError(f"{problem}{raster.pixel_size:g}. Pass an image with these pixels")
                yield name, data

        labels = np.nan_to_num(self.image(raster.pixel_size).data).astype(np.int64)
        curvature = getattr(self.of, "curvature", None)  # which pages do not have
        are_outlines = self.places.pixel_size is None
        how: dict[str, Any] = {"are_outlines": are_outlines, "nan_policy": nan_policy}
        found = properties_of(self.of, labels, raster, self.keys, self.at, curvature, values(), **how)
        return {"label": found.pop("label"), "name": np.array(self.names), **found}

    @property
    def _pixel_size(self) -> float:
        """The side length of the pixels in which regions are measured by default."""
        return self.places.pixel_size or self.of.pixel_size / 4

    def volume(self, like: object, *, depth: tuple[float, float] | None = None) -> Volume:
        """Transfer the regions through the cortex to the voxels of a volume.

        Each triangle defines a column of the cortex. A voxel whose centre lies in a column is assigned the region at
        its position in the column. Columns extend from the white to the pial surface if both are known, otherwise along
        the normals.

        Parameters
        ----------
        like : path, image object or Volume
            A volume that defines the grid of the result.
        depth : tuple of 2 floats, optional
            Distances outside the surface at which columns begin and end, in mm. Required if no pial surface is known;
            not accepted otherwise.

        Returns
        -------
        Volume
            Keys as int32; 0 outside all regions.

        Raises
        ------
        InputError
            If the volume or the depths do not fit, or if no voxel centre lies in a region.

        Examples
        --------
        >>> disk = voxflat.surface(voxflat.samples.ball()).disk((4, 12, 12), 6)
        >>> regions = disk.flatten().regions({"patch": [[-3, -3], [3, -3], [0, 3]]})
        >>> regions.volume(voxflat.samples.ball(), depth=(-1.0, 1.0))
        <Volume: 24 x 24 x 24 of int32, voxels of 1 x 1 x 1 mm, RAS>
        """
        grid = self._voxels(like, depth)
        if not grid.data.any():
            raise InputError("no region contains the centre of a voxel. Use a finer volume that covers the regions")
        return grid

    def _voxels(self, like: object, depth: tuple[float, float] | None) -> Volume:
        """Return the keys of the voxels, which may all be 0."""
        is_stack = isinstance(like, str | os.PathLike) and is_stack_path(like)
        grid = placed(self._surface, read_volume(like, 0) if is_stack else like)  # type: ignore[arg-type]
        warn_of_extent(self._surface, grid)
        shape = grid.data.shape[:3]
        voxels, places = _columns(self.of, grid.affine, (shape[0], shape[1], shape[2]), depth)
        labels = np.zeros(math.prod(shape), dtype=np.int32)
        labels[voxels] = self.at(places)
        return replace(grid, data=labels.reshape(shape), path=None, provenance=None)

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        volume: object | None = None,
        depth: tuple[float, float] | None = None,
        sidecar: bool = False,
        overwrite: bool = False,
    ) -> None:
        """Save the regions to a file.

        The file extension determines the format. The file is written either completely or not at all.

        Parameters
        ----------
        path : path
            ``.annot``, ``.label.gii`` and ``.dlabel.nii`` hold names, colours and mesh vertices. ``.label`` holds the
            vertices of a single region; with ``{name}`` in the name of the file, such as ``lh.{name}.label``, each
            region gets its own file. ``.svg`` holds names, colours and outlines, to edit in Inkscape. ``.nii``,
            ``.nii.gz``, ``.mgh``, ``.mgz`` and ``.nrrd`` hold voxels, as returned by `volume`. ``.tsv`` and ``.csv``
            hold the table of `properties`, with units in its header.
        volume : path, image object or Volume, optional
            A volume that defines the grid of a label volume; by default the flattened volume. For a table, a volume or
            overlay; the mean of each of its channels is added.
        depth : tuple of 2 floats, optional
            As in `volume`. For a table, the range over which the volume is averaged; by default, on the surface.
        sidecar : bool
            Also write `provenance`, which includes the names of the regions, to ``<path>.json``.
        overwrite : bool
            As in `FlatMap.save`.

        Raises
        ------
        InputError
            If the file extension is not supported, the format cannot hold the regions, or the path is an input file.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> regions = voxflat.samples.hill().flatten().regions({"V1": [[-5, -5], [5, -5], [0, 5]]})
        >>> regions.save("v1.label")
        """
        path = checked_path(path)
        name = path.name.lower()
        if not name.endswith(REGION_ENDINGS):
            raise InputError(f"cannot save regions as {path.name}. Use a name that ends in {', '.join(REGION_ENDINGS)}")
        is_volume = holds_voxels(path)
        is_table = name.endswith(TABLE_ENDINGS)
        if not (is_volume or is_table) and (volume is not None or depth is not None):
            raise InputError(f"{path.name} does not store voxels, so volume and depth do not apply. Omit them")
        if is_table and volume is None and depth is not None:
            raise InputError("depth is given, but no volume to average over these depths. Pass volume")
        if name.endswith(".label") and _NAME in path.name:
            self._save_each(path, sidecar, overwrite)
            return
        made = rows = None
        with reading() as files:
            if is_table:
                rows = self._rows(None if volume is None else self._sampled(volume, depth))
            elif is_volume:
                made = self.volume(self._grid() if volume is None else volume, depth=depth)
        labels = dict(zip(map(str, self.keys), self.names, strict=True))
        inputs = dict(sorted({**files_of(self.provenance), **files}.items()))
        record = {**self.provenance, "labels": labels, "files": inputs}
        with saving(path, record, sidecar=sidecar, overwrite=overwrite):
            if made is not None:
                is_own_grid = volume is None or isinstance(volume, np.ndarray)
                has_unit = not is_own_grid or self._surface.origin.named_unit != "unknown"
                write_volume(path, made.data, made.in_unit("mm").affine, record, has_unit=has_unit)
            elif rows is not None:
                write_table(path, rows)
            elif name.endswith(DRAWING):
                with atomic_path(path) as temporary:
                    self._write_drawing(temporary, record)
            else:
                with atomic_path(path) as temporary:
                    self._write_vertices(temporary, name, record)

    def _grid(self) -> Volume:
        """Return the grid of the flattened volume, without its values."""
        if not self._surface.origin.is_voxels:
            raise InputError("a map of a mesh has no voxels. Pass volume to define the grid of the labels")
        empty = np.broadcast_to(np.uint8(0), self._surface.volume_shape)
        return Volume(empty, self._surface.affine, unit=self._surface.origin.unit)

    def _sampled(self, volume: object, depth: tuple[float, float] | None) -> FlatStack:
        """Return the channels of a volume on the pixels of the regions, averaged over a range of depths."""
        size, depths = self._pixel_size, np.zeros(1)
        if depth is not None:
            low, high = _range(depth)
            depths = np.linspace(low, high, 1 + math.ceil((high - low) / size))
        return self.of.images(volume, size, depth=depths.tolist(), projection="mean", interpolation="linear")

    def _rows(self, stack: FlatStack | None) -> list[list[str]]:
        """Return the properties as cells, under a header with units."""
        named = self._surface.origin.named_unit
        unit = "" if named == "unknown" else "_" + named.replace("µ", "u")
        units = {**dict.fromkeys(LENGTHS, unit), **dict.fromkeys(AREAS, unit and f"{unit}2")}
        units |= {"map_direction": "_degrees", "curvature": unit and f"_per{unit}"}
        found = self.properties(stack)
        columns = [
            [cell_of(value, ".7g") if isinstance(value, float) else str(value) for value in values.tolist()]
            for values in found.values()
        ]
        return [[name + units.get(name, "") for name in found], *map(list, zip(*columns, strict=True))]

    def _save_each(self, path: Path, sidecar: bool, overwrite: bool) -> None:
        """Save each region to its own label file, whose name contains that of the region."""
        present = np.unique(self.vertex_labels).tolist()
        files: dict[str, Regions] = {}
        for n, (key, name) in enumerate(zip(self.keys, self.names, strict=True)):
            file = path.name.replace(_NAME, re.sub(r"[^\w.+-]+", "_", name))
            if key not in present:
                log.warning("no vertex lies in %s, so %s is not written", name, file)
            elif file in files:
                raise InputError(f"two regions would be saved as {file}. Name them differently")
            else:
                files[file] = replace(
                    self, names=(name,), keys=(key,), colours=self.colours[n : n + 1], places=_Only(self.places, key)
                )
        if not files:
            raise InputError(_NO_VERTEX)
        for file, region in files.items():
            region.save(path.with_name(file), sidecar=sidecar, overwrite=overwrite)

    def _write_drawing(self, path: Path, record: Record) -> None:
        outlines = []
        for key, name, colour in zip(self.keys, self.names, self.colours.tolist(), strict=True):
            outlines += [replace(one, name=name, colour=tuple(colour)) for one in self.places.drawn(key)]
        corners = np.concatenate([self.of._triangles.uv, *(loop for one in outlines for loop in one.loops)])
        (left, bottom), (right, top) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        write_outlines(path, outlines, (left, right, bottom, top), "rois", as_text(portable(record)))

    def _write_vertices(self, path: Path, name: str, record: Record) -> None:
        labels = self.vertex_labels
        if not labels.any():
            raise InputError(_NO_VERTEX)
        if name.endswith(".annot"):
            write_annot(path, labels, self.keys, self.names, self.colours)
        elif name.endswith(".label.gii"):
            structure = self._surface.origin.structure
            path.write_bytes(label_bytes(labels, self.keys, self.names, self.colours, structure, record))
        elif name.endswith(".dlabel.nii"):
            structure = self._surface.origin.structure
            write_dlabel(path, labels, self.keys, self.names, self.colours, structure, record)
        else:
            if len(self) != 1:
                remedy = f"Write {_NAME} in the name of the file, such as lh.{_NAME}.label, or use .annot or .label.gii"
                raise InputError(f"a .label file can store only one region, not {len(self)}. {remedy}")
            vertices = np.flatnonzero(labels)
            rows = np.zeros(self._surface.origin.mesh.vertices, dtype=np.int64)
            rows[self._surface.ids[::-1]] = np.arange(len(self._surface.ids))[::-1]
            points = self._surface.points if self._surface.white_points is None else self._surface.white_points
            write_label(path, vertices, self._surface.origin.space.to_tkras(points[rows[vertices]]), self.names[0])


def holds_voxels(path: Path) -> bool:
    """Return whether regions are saved under this name as voxels; CIFTI files hold vertices."""
    name = path.name.lower()
    return name.endswith(_VOLUME_ENDINGS) and not name.endswith(VERTEX_ENDINGS)


def _named(
    image: FlatImage | FlatStack | NDArray[np.float64] | None,
) -> Iterator[tuple[str, FlatImage | NDArray[np.float64]]]:
    """Return the names of the columns of means, and the images, each of which is sampled on demand."""
    if isinstance(image, FlatStack) and len(image) > 1:
        names = distinct_names([re.sub(r"\s+", "_", name) for name in image.names])
        for n, name in enumerate(names):
            yield f"mean_{name}", image[n]
    elif image is not None:
        yield "mean", image[0] if isinstance(image, FlatStack) else image


def _range(depth: object) -> tuple[float, float]:
    """Return two distances from the surface, the smaller one first."""
    pair: object = list(depth) if isinstance(depth, np.ndarray) and depth.ndim else depth
    if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
        raise InputError(f"depth is {shown(pair)}. Pass two distances from the surface")
    low, high = (checked_number(value, "depth") for value in pair)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"depth is {low:g} to {high:g}. Pass two finite numbers, the smaller one first")
    return low, high


def _columns(
    of: Planar, affine: NDArray[np.float64], shape: tuple[int, int, int], depth: tuple[float, float] | None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the numbers of the voxels in the cortex and their positions (u, v) on the map, shape (P, 2)."""
    flat = of._triangles
    surface, middle = flat.on_surface, 0.5
    if surface.white_points is not None and surface.pial_points is not None:
        if depth is not None:
            raise InputError("depth does not apply to a map with white and pial surfaces. Omit depth")
        inner, outer = surface.white_points, surface.pial_points
    else:
        if depth is None:
            raise InputError(
                in_unit(
                    "this map has no pial surface. Pass depth, a range in mm such as (0, 2.5)",
                    surface.origin.named_unit,
                )
            )
        low, high = _range(depth)
        inner, outer = surface.at(Depths((low, high)))
        middle = min(max(-low / (high - low), 0.0), 1.0)
    inverse = np.linalg.inv(affine)
    ends = [surface.origin.space.to_scanner(points) @ inverse[:3, :3].T + inverse[:3, 3] for points in (inner, outer)]
    faces = np.ascontiguousarray(flat.faces[~flat.torn])
    corners = [points[faces] for points in ends]
    areas = [np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) for p in corners]
    thick = np.linalg.norm(ends[1] - ends[0], axis=1)[faces].mean(axis=1)
    check_room(int(200 * (np.mean(areas, axis=0) * thick).sum() / 2))  # bytes for each voxel of the ribbon
    numbers = distinct(surface.ids).which
    voxels, triangles, weights, _ = _core.ribbon_voxels(ends[0], ends[1], faces, numbers, list(shape), middle)
    return voxels.astype(np.int64), np.einsum("pc,pcx->px", weights, flat.uv[faces[triangles]])
