"""Regions of interest drawn on a map: what vertices and what voxels of the cortex lie in them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import array_of, checked_number, checked_path, log, numbers_of, shown
from voxflat.errors import InputError
from voxflat.io.files import REMEDY, atomic_path, check_regular, contents, from_json, naming
from voxflat.io.formats.freesurfer import write_annot, write_label
from voxflat.io.formats.gifti import label_bytes
from voxflat.io.formats.svg import Outline, read_outlines
from voxflat.io.provenance import Record, resolved, saving
from voxflat.io.readers import read_array
from voxflat.io.reading import check_room, note, reading
from voxflat.io.sources import as_volume
from voxflat.io.volumes import VOLUME_ENDINGS, Volume, write_volume
from voxflat.maps.colours import all_whole, label_colour
from voxflat.maps.depth import Depths
from voxflat.maps.lines import ellipse
from voxflat.maps.pictures import decoded, header
from voxflat.maps.plane import FlatTriangles, Planar
from voxflat.maps.raster import FlatImage, Raster
from voxflat.maps.sampler import Sampler
from voxflat.maps.sampling import majority
from voxflat.unique_rows import distinct

__all__ = ["REGION_ENDINGS", "Regions", "regions_of"]

_VERTEX_ENDINGS = (".annot", ".label.gii", ".label")
REGION_ENDINGS = (*_VERTEX_ENDINGS, ".nii", ".nii.gz", ".mgh", ".mgz", ".nrrd")
"""Endings of the files that `Regions.save` writes."""

_IMAGES = (".png", ".tif", ".tiff", ".npy", ".nii", ".nii.gz")
_EACH = 250  # bytes of memory for each voxel of the cortex
_BESIDE = 1.5  # pixels beyond the map in which a label image is continued


class _Places(Protocol):
    """What knows which region lies where."""

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the key at each place, shape (P,); 0 for none."""


@dataclass(frozen=True, eq=False)
class Regions:
    """Regions on a map: what `FlatMap.regions` returns.

    Parameters
    ----------
    of : Planar
        The map.
    names : tuple of str
        The regions' names.
    keys : tuple of int
        The number of each in label files, not 0.
    colours : ndarray of uint8, shape (R, 3)
        Red, green, blue.
    places : object
        What knows which region lies where: ``labels(places)``.
    provenance : dict
        What made them.
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
        return f"<Regions: {', '.join(self.names)}>"

    @property
    def _flat(self) -> FlatTriangles:
        return self.of._triangles

    @property
    def _surface(self) -> Sampler:
        return self.of._triangles.on_surface

    def with_provenance(self, record: Record) -> Regions:
        """Return the same regions with a record of what made them.

        Parameters
        ----------
        record : dict
            As `provenance`.

        Returns
        -------
        Regions
        """
        return replace(self, provenance=resolved(record, {}))

    def at(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return which region lies at places of the map.

        Parameters
        ----------
        places : ndarray, shape (..., 2)
            (u, v), mm.

        Returns
        -------
        ndarray of int64, shape (...)
            Its key; 0 for none. Where several lie over each other, that of the last.
        """
        wanted = numbers_of(places, "places")
        if wanted.ndim == 0 or wanted.shape[-1] != 2:
            raise InputError(f"places have shape {wanted.shape}; give (u, v) in mm, shape (..., 2)")
        return self.places.labels(wanted.reshape(-1, 2)).reshape(wanted.shape[:-1])

    @cached_property
    def labels(self) -> NDArray[np.int64]:
        """The key of the region at each point of the map, shape (N,); 0 for none."""
        return self.at(self._flat.uv)

    @property
    def vertex_labels(self) -> NDArray[np.int64]:
        """The same at each vertex of the whole mesh, shape (V,); 0 for none, and beyond the map.

        A vertex on a cut, which the map has twice, is in a region if either of its places is.
        """
        if self._surface.is_voxels:
            raise InputError("the map of a volume has no vertices that others know: save a label volume, as .nii.gz")
        found = np.zeros(self._surface.metadata["vertices"], dtype=np.int64)
        is_in = self.labels != 0
        found[self._surface.ids[is_in][::-1]] = self.labels[is_in][::-1]
        return found

    def image(self, pixel_size: float | None = None) -> FlatImage:
        """Show the regions on the map.

        Parameters
        ----------
        pixel_size : float, optional
            As in `FlatMap.raster`.

        Returns
        -------
        FlatImage
            Keys; 0 for none, NaN outside the map.
        """
        raster = self.of.raster(pixel_size)
        data = np.where(raster.inside, self.at(_centres(raster)), np.nan)
        return FlatImage(data, raster.pixel_size, raster.origin, "regions", True, self.provenance)

    def volume(
        self,
        like: object,
        *,
        depth: tuple[float, float] | None = None,
    ) -> Volume:
        """Carry the regions through the cortex into the voxels of a volume.

        A voxel whose centre lies in the column of a triangle gets the region at its place in that column. Columns lead
        from the white to the pial surface where both are known, else along the normals.

        Parameters
        ----------
        like : path, image object or Volume
            The volume whose grid is taken.
        depth : tuple of 2 floats, optional
            From how far to how far outside the surface, mm; needed where no pial surface is known, and not taken where
            one is.

        Returns
        -------
        Volume
            Keys as int32; 0 for none.

        Raises
        ------
        InputError
            If the volume or the depths do not fit, or no voxel's centre lies in a region.
        """
        grid = as_volume(like)
        if not grid.is_placed:
            grid = self._surface.placed(grid)
        shape = grid.data.shape[:3]
        voxels, places = _columns(self.of, grid.affine, (shape[0], shape[1], shape[2]), depth)
        found = np.zeros(math.prod(shape), dtype=np.int32)
        found[voxels] = self.at(places)
        if not found.any():
            raise InputError("no voxel of the volume has its centre in a region: it lies elsewhere, or is too coarse")
        return Volume(found.reshape(shape), grid.affine)

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        volume: object | None = None,
        depth: tuple[float, float] | None = None,
        sidecar: bool = False,
        overwrite: bool = False,
    ) -> None:
        """Save the regions, all of them or nothing.

        Parameters
        ----------
        path : path
            ``.annot``, ``.label.gii``: names, colours and the vertices of the mesh. ``.label``: the vertices of a
            single region. ``.nii``, ``.nii.gz``, ``.mgh``, ``.mgz``, ``.nrrd``: voxels, as from `volume`.
        volume : path, image object or Volume, optional
            For a label volume: whose grid it has. By default that of the flattened volume.
        depth : tuple of 2 floats, optional
            As in `volume`.
        sidecar : bool
            Write `provenance`, which names the regions, to ``<path>.json``, too.
        overwrite : bool
            Replace a file of that name that voxflat did not write.

        Raises
        ------
        InputError
            If the ending is another, the file cannot hold them, or it is a file that was read.
        OSError
            If it cannot be written.
        """
        path = checked_path(path)
        name = path.name.lower()
        if not name.endswith(REGION_ENDINGS):
            raise InputError(
                f"cannot save regions as {path.name}; give a name that ends in {', '.join(REGION_ENDINGS)}"
            )
        if name.endswith(_VERTEX_ENDINGS) and (volume is not None or depth is not None):
            raise InputError(f"volume and depth are for label volumes; {path.name} holds vertices: leave them out")
        made = None
        with reading() as files:
            if not name.endswith(_VERTEX_ENDINGS):
                made = self.volume(self._grid() if volume is None else volume, depth=depth)
        record = {
            **self.provenance,
            "labels": {str(key): own for key, own in zip(self.keys, self.names, strict=True)},
            "files": dict(sorted({**self.provenance.get("files", {}), **files}.items())),
        }
        with saving(path, record, sidecar=sidecar, overwrite=overwrite):
            if made is not None:
                write_volume(path, made.data, made.affine, record)
            else:
                with atomic_path(path) as temporary:
                    self._write_vertices(temporary, name, record)

    def _grid(self) -> Volume:
        """Return the grid of the flattened volume, without its values."""
        if not self._surface.is_voxels:
            raise InputError("the map of a mesh has no voxels: give the volume whose grid the labels get (volume)")
        empty = np.broadcast_to(np.uint8(0), self._surface.volume_shape)
        return Volume(empty, self._surface.affine)

    def _write_vertices(self, path: Path, name: str, record: Record) -> None:
        labels = self.vertex_labels
        if not labels.any():
            raise InputError("no vertex lies in a region: they lie beside the map, or are smaller than its triangles")
        if name.endswith(".annot"):
            write_annot(path, labels, self.keys, self.names, self.colours)
        elif name.endswith(".label.gii"):
            structure = self._surface.metadata.get("structure")
            path.write_bytes(label_bytes(labels, self.keys, self.names, self.colours, structure, record))
        else:
            if len(self) != 1:
                raise InputError(f"a .label holds one region, and there are {len(self)}: save as .annot or .label.gii")
            vertices = np.flatnonzero(labels)
            rows = np.zeros(self._surface.metadata["vertices"], dtype=np.int64)
            rows[self._surface.ids[::-1]] = np.arange(len(self._flat.uv))[::-1]
            points = self._surface.points if self._surface.white_points is None else self._surface.white_points
            write_label(path, vertices, self._surface.space.to_tkras(points[rows[vertices]]), self.names[0])


def _centres(raster: Raster) -> NDArray[np.float64]:
    """Return (u, v) of each pixel's centre, shape (H, W, 2)."""
    rows, columns = np.indices(raster.shape)
    u, v = raster.origin
    return np.stack([u + columns * raster.pixel_size, v - rows * raster.pixel_size], axis=-1)


def _columns(
    of: Planar, affine: NDArray[np.float64], shape: tuple[int, int, int], depth: tuple[float, float] | None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return which voxels lie in the cortex, by their numbers, and at which (u, v) of the map, shape (P, 2)."""
    flat = of._triangles
    surface, middle = flat.on_surface, 0.5
    if surface.white_points is not None and surface.pial_points is not None:
        if depth is not None:
            raise InputError("depth is given, but the cortex lies between white and pial surface here: leave it out")
        inner, outer = surface.white_points, surface.pial_points
    else:
        if depth is None:
            raise InputError("this map knows no pial surface: give depth, from how far to how far outside, mm")
        low, high = (checked_number(value, "depth") for value in _pair(depth))
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InputError(f"depth is {low:g} to {high:g} mm; give two finite numbers, the lower one first")
        inner, outer = surface.at(Depths((low, high)))
        middle = min(max(-low / (high - low), 0.0), 1.0)
    inverse = np.linalg.inv(affine)
    ends = [surface.space.to_scanner(points) @ inverse[:3, :3].T + inverse[:3, 3] for points in (inner, outer)]
    faces = np.ascontiguousarray(flat.faces[~flat.torn])
    areas = [
        np.linalg.norm(np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]), axis=1) for p in ends
    ]
    thick = np.linalg.norm(ends[1] - ends[0], axis=1)[faces].mean(axis=1)
    check_room(int(200 * (np.mean(areas, axis=0) * thick).sum() / 2))  # bytes for each voxel of the ribbon
    numbers = distinct(surface.ids).which
    voxels, triangles, weights, _ = _core.ribbon_voxels(ends[0], ends[1], faces, numbers, list(shape), middle)
    return voxels.astype(np.int64), np.einsum("pc,pcx->px", weights, flat.uv[faces[triangles]])


def _pair(depth: object) -> tuple[float, float]:
    depth = list(depth) if isinstance(depth, np.ndarray) and depth.ndim else depth
    if not isinstance(depth, Sequence) or isinstance(depth, str) or len(depth) != 2:
        raise InputError(f"depth is {shown(depth)}; give two numbers, from how far to how far outside, mm")
    return depth[0], depth[1]


# ------------------------------------------------------------------------------------- what is drawn


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Outlines, the last on top."""

    outlines: tuple[Outline, ...]
    keys: tuple[int, ...]

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        order = np.argsort(places[:, 1], kind="stable")
        sorted_places = places[order]
        found = np.zeros(len(places), dtype=np.int64)
        for outline, key in zip(self.outlines, self.keys, strict=True):
            winding = np.zeros(len(places), dtype=np.int64)
            for loop in outline.loops:
                winding += _winding(loop, sorted_places)
            found[order[(winding % 2 if outline.is_even_odd else winding) != 0]] = key
        return found


def _winding(loop: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return how often a polygon runs around places that are sorted by v, counterclockwise."""
    winding = np.zeros(len(places), dtype=np.int64)
    v = places[:, 1]
    starts, ends = loop, np.roll(loop, -1, axis=0)
    for (u0, v0), (u1, v1) in zip(starts.tolist(), ends.tolist(), strict=True):
        low, high = np.searchsorted(v, sorted((v0, v1)), side="left")  # edges hold their lower end
        if low == high:
            continue
        band = places[low:high]
        crossing = u0 + (band[:, 1] - v0) / (v1 - v0) * (u1 - u0)
        winding[low:high] += np.where(crossing > band[:, 0], 1 if v1 > v0 else -1, 0)
    return winding


@dataclass(frozen=True, eq=False)
class _Pixels:
    """A label image on the pixels of the map: between their centres the label of the greatest weight."""

    data: NDArray[np.int64]
    raster: Raster

    @cached_property
    def _continued(self) -> NDArray[np.int64]:
        """The image, continued a little beyond the map, where its border cuts pixels."""
        away, (rows, columns) = scipy.ndimage.distance_transform_edt(~self.raster.inside, return_indices=True)
        return np.where(away <= _BESIDE, self.data[rows, columns], 0)

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        u, v = self.raster.origin
        size, (height, width) = self.raster.pixel_size, self.raster.shape
        at = np.column_stack([(v - places[:, 1]) / size, (places[:, 0] - u) / size])
        is_on = (at > -0.5 - _BESIDE).all(axis=1) & (at < np.array([height, width]) - 0.5 + _BESIDE).all(axis=1)
        last = np.array([height - 1, width - 1])
        on = np.clip(at[is_on], 0, last)
        low = np.minimum(np.floor(on).astype(np.int64), np.maximum(last - 1, 0))
        rows, columns = low.T
        values = [self._continued[rows + i * (height > 1), columns + j * (width > 1)] for i in (0, 1) for j in (0, 1)]
        down, right = (on - low).T
        weights = [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
        found = np.zeros(len(places), dtype=np.int64)
        found[is_on] = majority(np.stack(values, axis=1), np.stack(weights, axis=1)).astype(np.int64)
        return found


def regions_of(of: Planar, rois: object, *, layer: str, pixel_size: float | None) -> Regions:
    """Take what was drawn as regions: as `FlatMap.regions`."""
    name = Path(rois).name.lower() if isinstance(rois, str | os.PathLike) else ""
    if isinstance(rois, str | os.PathLike):
        path = Path(rois)
        if name.endswith(".svg"):
            return _drawn(of, read_outlines(path, layer))
        if name.endswith(".json"):
            return _drawn(of, _read_polygons(path))
        if name.endswith(_IMAGES):
            with naming(path, REMEDY):
                data, size = _read_image(path)
                return _pixels(of, data, pixel_size or size)
        raise InputError(f"{path}: regions are read from .svg, .json, {', '.join(_IMAGES)}")
    if isinstance(rois, FlatImage):
        return _pixels(of, rois.data, rois.pixel_size)
    if hasattr(rois, "shape_type") and hasattr(rois, "data_to_world"):
        return _drawn(of, list(_of_shapes(rois)))
    if isinstance(rois, Mapping):
        return _drawn(of, [Outline(str(key), _loops(loops, str(key))) for key, loops in rois.items()])
    if isinstance(rois, np.ndarray) and rois.ndim == 2 and rois.shape[1] != 2 and rois.dtype.kind in "biuf":
        return _pixels(of, rois, pixel_size)
    if isinstance(rois, np.ndarray) and rois.ndim == 2:
        return _drawn(of, [Outline("region 1", _loops(rois, "region 1"))])
    if isinstance(rois, Sequence) and not isinstance(rois, str) and len(rois):
        if all(isinstance(item, Outline) for item in rois):
            return _drawn(of, list(rois))
        if np.ndim(rois[0]) == 1:
            return _drawn(of, [Outline("region 1", _loops(rois, "region 1"))])
        return _drawn(of, [Outline(f"region {n}", _loops(loop, f"region {n}")) for n, loop in enumerate(rois, 1)])
    raise InputError(
        f"regions are {type(rois).__name__}; give polygons of shape (k, 2) in mm by their names, a label image of the "
        "map, a Shapes layer of napari, or an .svg, .json or image file"
    )


def _loops(given: Any, name: str) -> tuple[NDArray[np.float64], ...]:
    """Return one polygon, or several that enclose a region together."""
    several = isinstance(given, Sequence) and len(given) and np.ndim(given[0]) == 2
    found = []
    for polygon in given if several else [given]:
        try:
            loop = numbers_of(polygon, "corners")
        except InputError:
            loop = np.zeros(0)
        if loop.ndim != 2 or loop.shape[1:] != (2,) or len(loop) < 3:
            raise InputError(f"{name}: a polygon has (u, v) of at least three corners, shape (k, 2), not {loop.shape}")
        if not np.isfinite(loop).all():
            raise InputError(f"{name}: corner {int(np.flatnonzero(~np.isfinite(loop).all(axis=1))[0])} is not finite")
        found.append(loop)
    return tuple(found)


def _drawn(of: Planar, outlines: Sequence[Outline]) -> Regions:
    """Return outlines as regions; those of one name are one region."""
    if not outlines:
        raise InputError("there is no region: draw one")
    names = tuple(dict.fromkeys(outline.name for outline in outlines))
    keys = {name: key for key, name in enumerate(names, 1)}
    colours = {outline.name: outline.colour for outline in reversed(outlines)}
    taken = list(colours.values())
    given = {name: colour for name, colour in colours.items() if colour is not None and taken.count(colour) == 1}
    shown = [given.get(name, label_colour(keys[name])) for name in names]
    uv = of._triangles.uv
    low, high = uv.min(axis=0), uv.max(axis=0)
    for outline in outlines:
        corners = np.concatenate(outline.loops)
        if (corners.max(axis=0) < low).any() or (corners.min(axis=0) > high).any():
            raise InputError(
                f"{outline.name} lies beside the map, around u = {corners[:, 0].mean():.4g}, "
                f"v = {corners[:, 1].mean():.4g} mm; the map reaches from {low[0]:.4g}, {low[1]:.4g} to {high[0]:.4g}, "
                f"{high[1]:.4g}"
            )
    drawn = _Drawn(tuple(outlines), tuple(keys[outline.name] for outline in outlines))
    counts = np.zeros(len(uv), dtype=np.int64)
    for name in names:
        own = [outline for outline in outlines if outline.name == name]
        counts += _Drawn(tuple(own), (1,) * len(own)).labels(uv)
    if (counts > 1).any():
        log.warning("%d points of the map lie in several regions; the last one drawn has them", int((counts > 1).sum()))
    return Regions(of, names, tuple(keys.values()), np.array(shown, dtype=np.uint8), drawn)


def _pixels(of: Planar, data: Any, pixel_size: float | None) -> Regions:
    """Return a label image as regions."""
    values = array_of(data, "labels")
    if values.ndim != 2 or values.dtype.kind not in "biuf":
        raise InputError(f"a label image has whole numbers of shape (H, W), not {values.dtype} of shape {values.shape}")
    raster = of.raster(pixel_size)
    if raster.shape != values.shape:
        raise InputError(
            f"the label image has {values.shape[1]} x {values.shape[0]} pixels, the map at {raster.pixel_size:g} mm a "
            f"pixel {raster.shape[1]} x {raster.shape[0]}: give the pixel size that it was drawn at"
        )
    if not all_whole(values):
        raise InputError("a label image has whole numbers, and this has others: is it one of intensities?")
    with np.errstate(invalid="ignore"):  # what no whole number holds becomes a negative one
        labels = np.nan_to_num(values).astype(np.int64)
    keys = tuple(np.unique(labels[raster.inside & (labels != 0)]).tolist())
    if not keys:
        raise InputError("the label image is 0 everywhere on the map: there is no region")
    if keys[0] < 0 or keys[-1] >= 2**31:
        raise InputError(f"labels are {keys[0]} to {keys[-1]}; give numbers from 1 to {2**31 - 1}")
    colours = np.array([label_colour(key) for key in keys], dtype=np.uint8)
    return Regions(of, tuple(map(str, keys)), keys, colours, _Pixels(labels, raster))


def _of_shapes(layer: Any) -> list[Outline]:
    """Return the shapes of a layer of napari, whose world has the axes −v and u."""
    names = layer.features["name"] if "name" in getattr(layer, "features", {}) else None
    outlines = []
    for n, (corners, kind) in enumerate(zip(layer.data, layer.shape_type, strict=True)):
        if kind in ("line", "path"):
            raise InputError(f"shape {n} of {layer.name} is a {kind}, which encloses nothing: draw polygons")
        world = np.array([layer.data_to_world(corner) for corner in np.asarray(corners, dtype=np.float64)])[:, -2:]
        if kind == "ellipse":
            world = ellipse(world)
        name = f"region {n + 1}" if names is None else str(names[n])
        outlines.append(Outline(name, _loops(np.column_stack([world[:, 1], -world[:, 0]]), name)))
    return outlines


def _read_polygons(path: Path) -> list[Outline]:
    """Read polygons by their names: {"V1": [[u, v], ...]}, or several polygons each."""
    with naming(path, 'give {"name": [[u, v], ...]} in mm'):
        content = from_json(contents(path))
        if not isinstance(content, dict):
            raise InputError("holds no regions by their names")
        return [Outline(name, _loops(loops, name)) for name, loops in content.items() if name != "provenance"]


def _read_image(path: Path) -> tuple[NDArray[Any], float | None]:
    """Return a label image, and the side of its pixels in mm, if its file says it."""
    name = path.name.lower()
    check_regular(path)
    if name.endswith(".npy"):
        data = read_array(path)
        note(path)
        return data, None
    if name.endswith(VOLUME_ENDINGS):
        volume = as_volume(path)
        return volume.data[:, :, 0] if volume.data.ndim == 3 and volume.data.shape[2] == 1 else volume.data, float(
            volume.spacing[0]
        )
    with header(path) as image:
        if image.mode not in ("L", "P", "I", "I;16", "F", "1"):
            raise InputError(f"has colours ({image.mode}), which are no labels: save it as .tif or .npy, or as greys")
        told = str(image.info.get("Pixel size", "")) or str(getattr(image, "tag_v2", {}).get(270, ""))
        data = decoded(path, image)
    size = told.split("Pixel size: ")[-1].split(" mm")[0]
    try:
        return data, float(size)
    except ValueError:
        return data, None
