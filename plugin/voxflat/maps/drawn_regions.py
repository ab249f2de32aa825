"""Regions drawn on a map, as outlines or as pixels."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import array_of, checked_instance, log, numbers_of, shown, unmasked
from voxflat.errors import InputError
from voxflat.io.files import REMEDY, check_regular, contents, from_json, naming
from voxflat.io.formats.svg import Outline, read_outlines
from voxflat.io.grid import in_unit, millimetres
from voxflat.io.label_tables import LABEL_ENDINGS, is_label_file
from voxflat.io.readers import read_array
from voxflat.io.reading import record_file
from voxflat.io.sources import as_volume
from voxflat.io.volumes import VOLUME_ENDINGS
from voxflat.maps.colours import all_whole, label_colour
from voxflat.maps.lines import ellipse
from voxflat.maps.outlines import Collar, around_pixels
from voxflat.maps.parcels import Parcels, parcels_of
from voxflat.maps.plane import Planar
from voxflat.maps.raster import FlatImage, Raster, nearest_inside, rows_in, rows_of_period
from voxflat.maps.regions import Regions
from voxflat.maps.sampling import majority_at
from voxflat.maps.textures.pictures import decoded, header
from voxflat.read_only import ReadOnly

_IMAGES = (".png", ".tif", ".tiff", ".npy", ".nii", ".nii.gz")
_BESIDE = 1.5  # extent, in pixels, of a label image beyond the outline of the map


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Outlines of regions; where outlines overlap, the last one counts."""

    outlines: tuple[Outline, ...]
    keys: tuple[int, ...]

    pixel_size = None

    def drawn(self, key: int) -> list[Outline]:
        """Return the outlines of a region."""
        return [outline for outline, own in zip(self.outlines, self.keys, strict=True) if own == key]

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        order = np.argsort(places[:, 1], kind="stable")
        sorted_places = places[order]
        codes = np.zeros(len(places), dtype=np.int64)
        for outline, key in zip(self.outlines, self.keys, strict=True):
            winding = np.zeros(len(places), dtype=np.int64)
            for loop in outline.loops:
                winding += _winding(loop, sorted_places)
            codes[order[(winding % 2 if outline.is_even_odd else winding) != 0]] = key
        return codes


def _winding(loop: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the winding number of a polygon, counterclockwise, around places that are sorted by v."""
    winding = np.zeros(len(places), dtype=np.int64)
    v = places[:, 1]
    starts, ends = loop, np.roll(loop, -1, axis=0)
    for (u0, v0), (u1, v1) in zip(starts.tolist(), ends.tolist(), strict=True):
        low, high = np.searchsorted(v, sorted((v0, v1)), side="left")  # edges include their lower end
        if low == high:
            continue
        band = places[low:high]
        crossing = u0 + (band[:, 1] - v0) / (v1 - v0) * (u1 - u0)
        winding[low:high] += np.where(crossing > band[:, 0], 1 if v1 > v0 else -1, 0)
    return winding


@dataclass(frozen=True, eq=False)
class _Pixels(ReadOnly):
    """A label image on the pixels of the map, interpolated by majority between pixel centres."""

    data: NDArray[np.int64]
    raster: Raster

    @property
    def pixel_size(self) -> float:
        return self.raster.pixel_size

    def drawn(self, key: int) -> list[Outline]:
        """Return the outlines of the pixels of a region."""
        (u, v), size = self.raster.origin, self.raster.pixel_size
        loops = around_pixels(self._continued == key)
        placed = [np.column_stack([u + size * loop[:, 1], v - size * loop[:, 0]]) for loop in loops]
        return [Outline(str(key), tuple(placed), is_even_odd=True)] if placed else []

    @cached_property
    def _continued(self) -> NDArray[np.int64]:
        """The image, extended slightly beyond the outline of the map."""
        away, (rows, columns) = nearest_inside(self.raster)
        return np.where(away <= _BESIDE, self.data[rows, columns], 0)

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        u, v = self.raster.origin
        size, (height, width) = self.raster.pixel_size, self.raster.shape
        index = np.column_stack([(v - places[:, 1]) / size, (places[:, 0] - u) / size])
        is_on = (index > -0.5 - _BESIDE).all(axis=1) & (index < np.array([height, width]) - 0.5 + _BESIDE).all(axis=1)
        codes = np.zeros(len(places), dtype=np.int64)
        codes[is_on] = majority_at(self._continued[..., None], np.insert(index[is_on, None], 2, 0.0, axis=2))
        return codes


@dataclass(frozen=True, eq=False)
class _Labelled:
    """Labels of the vertices of a mesh, with the same borders between them as in figures."""

    parcels: Parcels

    pixel_size = None

    @cached_property
    def _collar(self) -> Collar:
        flat = self.parcels.flat_map
        return Collar.around(flat._triangles.uv, flat._whole_faces)

    def drawn(self, key: int) -> list[Outline]:
        """Return the outlines around the points of a region."""
        loops = self._collar.outlines(self.parcels.labels == key)
        return [Outline(str(key), loops, is_even_odd=True)] if loops else []

    def labels(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        hits, faces = self.parcels.flat_map.look_up(places), self.parcels.flat_map._triangles.faces
        is_on = hits.face_ids >= 0
        codes = np.zeros(len(places), dtype=np.int64)
        codes[is_on] = np.maximum(self.parcels.at(faces[hits.face_ids[is_on]], hits.weights[is_on]), 0)
        return codes


def _labelled(flat: Planar, files: Any) -> Regions:
    """Return the labels in files as regions with their names and colours; the key of label 0 is the next free one."""
    if flat._triangles.on_surface.origin.is_voxels:
        problem = "label files hold vertices of a mesh, but this is the map of a volume"
        raise InputError(f"{problem}. Pass polygons, a figure or a label image of the map")
    parcels = parcels_of(flat, files)
    keys = [key or max(parcels.names) + 1 for key in parcels.names]
    moved = replace(parcels, labels=np.where(parcels.labels == 0, keys[0], parcels.labels))
    colours = np.array(list(parcels.colours.values()), dtype=np.uint8)
    return Regions(flat, tuple(parcels.names.values()), tuple(keys), colours, _Labelled(moved))


def regions_of(flat: Planar, rois: object, *, layer: str, pixel_size: float | None) -> Regions:
    """Return regions from any supported input, as `FlatMap.regions` does."""
    checked_instance(layer, str, "layer", "its name")
    drawn = _regions_of(flat, rois, layer, pixel_size)
    if pixel_size is not None and not isinstance(drawn.places, _Pixels):
        raise InputError(f"pixel_size is {shown(pixel_size)}, but the regions are not an image. Omit pixel_size")
    return drawn


def _regions_of(flat: Planar, rois: object, layer: str, pixel_size: float | None) -> Regions:
    if is_label_file(rois):
        return _labelled(flat, rois)
    if isinstance(rois, str | os.PathLike):
        path = Path(rois)
        name = path.name.lower()
        if name.endswith(".svg"):
            return _drawn(flat, read_outlines(path, layer))
        if name.endswith(".json"):
            return _drawn(flat, _read_polygons(path))
        if name.endswith(_IMAGES):
            with naming(path, REMEDY):
                data, size = _read_image(path, flat._triangles.on_surface.origin.unit)
                return _pixels(flat, data, size if pixel_size is None else pixel_size)
        endings = ", ".join((".svg", ".json", *LABEL_ENDINGS, *_IMAGES))
        raise InputError(f"{path}: unsupported file type. Pass regions as {endings}")
    if isinstance(rois, FlatImage):
        return _pixels(flat, rois.data, rois.pixel_size)
    if hasattr(rois, "shape_type") and hasattr(rois, "data_to_world"):
        return _drawn(flat, list(_of_shapes(rois)))
    if isinstance(rois, Mapping):
        return _drawn(flat, [Outline(str(key), _loops(loops, str(key))) for key, loops in rois.items()])
    if isinstance(rois, np.ndarray) and rois.ndim == 2 and rois.shape[1] != 2 and rois.dtype.kind in "biuf":
        return _pixels(flat, rois, pixel_size)
    listed: Any = rois if isinstance(rois, Sequence) else ()
    if (isinstance(rois, np.ndarray) and rois.ndim == 2) or (len(listed) and _axes(listed[0]) == 1):
        return _drawn(flat, [Outline("region 1", _loops(rois, "region 1"))])
    if len(listed) and all(isinstance(item, Outline) for item in listed):
        return _drawn(flat, listed)
    if len(listed):
        return _drawn(flat, [Outline(f"region {n}", _loops(loop, f"region {n}")) for n, loop in enumerate(listed, 1)])
    raise InputError(
        f"cannot read regions from {type(rois).__name__}. Pass polygons as (k, 2) arrays in mm, keyed by name; a label "
        "image of the map; a napari Shapes layer; or an .svg, .json or image file"
    )


def _axes(value: Any) -> int:
    """Return the number of axes of an array or of nested lists, or 0 if their lengths differ."""
    try:
        return np.ndim(value)
    except ValueError:
        return 0


def _loops(loops: Any, name: str) -> tuple[NDArray[np.float64], ...]:
    """Return the polygons, one or several, that enclose a region."""
    several = isinstance(loops, Sequence) and len(loops) and _axes(loops[0]) == 2
    checked = []
    for polygon in loops if several else [loops]:
        unmasked(polygon, f"corners of {name}")
        try:
            loop = numbers_of(polygon, "corners")
        except InputError:
            loop = np.zeros(0)
        if loop.ndim != 2 or loop.shape[1:] != (2,) or len(loop) < 3:
            raise InputError(f"{name}: not a polygon (shape {loop.shape}). Pass at least 3 corners (u, v), in mm")
        if not np.isfinite(loop).all():
            bad = int(np.flatnonzero(~np.isfinite(loop).all(axis=1))[0])
            raise InputError(f"{name}: corner {bad} is not finite. Pass finite coordinates (u, v), in mm")
        checked.append(loop)
    return tuple(checked)


def _drawn(flat: Planar, outlines: Sequence[Outline]) -> Regions:
    """Return outlines as regions; outlines with the same name form one region."""
    if not outlines:
        raise InputError("there are no regions. Draw at least one region")
    names = tuple(dict.fromkeys(outline.name for outline in outlines))
    keys = {name: key for key, name in enumerate(names, 1)}
    colours = {outline.name: outline.colour for outline in reversed(outlines)}
    taken = list(colours.values())
    deliberate = {outline.name for outline in outlines if outline.is_coloured}
    chosen = {
        name: colour
        for name, colour in colours.items()
        if colour is not None and (name in deliberate or taken.count(colour) == 1)
    }
    painted = [chosen.get(name, label_colour(keys[name])) for name in names]
    uv = flat._triangles.uv
    low, high = uv.min(axis=0), uv.max(axis=0)
    for outline in outlines:
        corners = np.concatenate(outline.loops)
        if (corners.max(axis=0) < low).any() or (corners.min(axis=0) > high).any():
            raise InputError(
                f"{outline.name} lies outside the map: its centre is at u = {corners[:, 0].mean():.4g}, "
                f"v = {corners[:, 1].mean():.4g}, but the map extends from ({low[0]:.4g}, {low[1]:.4g}) to "
                f"({high[0]:.4g}, {high[1]:.4g}). Draw it on the map"
            )
    drawn = _Drawn(tuple(outlines), tuple(keys[outline.name] for outline in outlines))
    counts = np.zeros(len(uv), dtype=np.int64)
    for name in names:
        parts = [outline for outline in outlines if outline.name == name]
        counts += _Drawn(tuple(parts), (1,) * len(parts)).labels(uv)
    if (counts > 1).any():
        log.warning("Points in several regions belong to the region drawn last: %d", int((counts > 1).sum()))
    return Regions(flat, names, tuple(keys.values()), np.array(painted, dtype=np.uint8), drawn)


def _pixels(flat: Planar, data: Any, pixel_size: float | None) -> Regions:
    """Return a label image as regions."""
    values = array_of(data, "labels")
    if values.ndim != 2 or values.dtype.kind not in "biuf":
        problem = f"the label image has shape {values.shape} and data type {values.dtype}"
        raise InputError(f"{problem}. Pass an array of whole numbers with shape (H, W)")
    raster = flat.raster(pixel_size)
    period = flat._triangles.period
    if period is not None and values.shape == (rows_in(period, raster.pixel_size), raster.shape[1]):
        values = values[rows_of_period(raster, len(values))]  # from `FlatImage.one_period`
    if raster.shape != values.shape:
        size = in_unit(f"{raster.pixel_size:g} mm", raster.unit)
        raise InputError(
            f"the label image has {values.shape[1]} x {values.shape[0]} pixels, but the map has {raster.shape[1]} x "
            f"{raster.shape[0]} at {size} per pixel. Pass the pixel size of the label image"
        )
    if not all_whole(values):
        raise InputError("the label image has values that are not whole numbers. Pass labels instead of intensities")
    with np.errstate(invalid="ignore"):  # values out of range become negative
        labels = np.nan_to_num(values).astype(np.int64)
    keys = tuple(np.unique(labels[raster.inside & (labels != 0)]).tolist())
    if not keys:
        raise InputError("the label image is 0 everywhere on the map. Draw at least one region")
    if keys[0] < 0 or keys[-1] >= 2**31:
        raise InputError(f"labels range from {keys[0]} to {keys[-1]}. Use numbers from 1 to {2**31 - 1}")
    colours = np.array([label_colour(key) for key in keys], dtype=np.uint8)
    return Regions(flat, tuple(map(str, keys)), keys, colours, _Pixels(labels, raster))


def _of_shapes(layer: Any) -> list[Outline]:
    """Return the shapes of a napari layer, whose world coordinates are −v and u."""
    names = layer.features["name"] if "name" in getattr(layer, "features", {}) else None
    outlines = []
    for n, (corners, kind) in enumerate(zip(layer.data, layer.shape_type, strict=True)):
        if kind in ("line", "path"):
            raise InputError(f"shape {n} of {layer.name} is a {kind}, which encloses no area. Draw a polygon")
        world = np.array([layer.data_to_world(corner) for corner in np.asarray(corners, dtype=np.float64)])[:, -2:]
        if kind == "ellipse":
            world = ellipse(world)
        name = f"region {n + 1}" if names is None else str(names[n])
        outlines.append(Outline(name, _loops(np.column_stack([world[:, 1], -world[:, 0]]), name)))
    return outlines


def _read_polygons(path: Path) -> list[Outline]:
    """Read polygons keyed by name: {"V1": [[u, v], ...]}, with one or several polygons each."""
    with naming(path, 'write {"name": [[u, v], ...]} in the unit of the map'):
        content = from_json(contents(path))
        if not isinstance(content, dict):
            raise InputError('is not a JSON object. Write {"name": [[u, v], ...]} in the unit of the map')
        return [Outline(name, _loops(loops, name)) for name, loops in content.items() if name != "provenance"]


def _read_image(path: Path, unit: str) -> tuple[NDArray[Any], float | None]:
    """Return a label image, and its pixel size in the unit of the map if the file defines it."""
    name = path.name.lower()
    check_regular(path)
    if name.endswith(".npy"):
        data = read_array(path)
        record_file(path)
        return data, None
    if name.endswith(VOLUME_ENDINGS) and not name.endswith((".tif", ".tiff")):  # here TIFFs are pictures
        volume = as_volume(path)
        data = volume.data
        return data[:, :, 0] if data.shape[2:] == (1,) else data, float(volume.spacing[0]) * _ratio("mm", unit)
    with header(path) as image:
        if image.mode not in ("L", "P", "I", "I;16", "F", "1"):
            raise InputError(f"is a colour image (mode {image.mode}). Save the labels as grey levels, .tif or .npy")
        text = str(image.info.get("Pixel size", "")) or str(getattr(image, "tag_v2", {}).get(270, ""))
        data = decoded(path, image)
    match = re.match(r"([0-9.e+-]+)( (?:mm|um|nm|cm|m|inch)\b)?", text.split("Pixel size: ")[-1])
    try:
        return data, None if match is None else float(match[1]) * _ratio((match[2] or " unknown")[1:], unit)
    except ValueError:
        return data, None


def _ratio(unit: str, target: str) -> float:
    """Return the factor from one unit of length to another, or 1 if either is unknown."""
    return 1.0 if unit == target or "unknown" in (unit, target) else millimetres(unit) / millimetres(target)
