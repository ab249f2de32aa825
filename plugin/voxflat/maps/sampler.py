"""What the pixels of a flat image show: a volume, an overlay or a texture, looked up where they lie on the surface."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_number, log
from voxflat.errors import InputError
from voxflat.io.channels import Channels, points_of_nibabel, series_of
from voxflat.io.files import REMEDY, naming
from voxflat.io.overlays import holds_volume, read_channels
from voxflat.io.readers import has_place
from voxflat.io.spaces import Space
from voxflat.io.structures import refuse_other_side
from voxflat.io.volumes import Volume, as_volume
from voxflat.maps.raster import FlatImage, FlatStack, Raster, sample, show
from voxflat.maps.surface_texture import TEXTURE_ENDINGS, SurfaceTexture, are_colours, paint, read_texture

__all__ = ["Sampler", "usual_spacing"]

_CURVED = 0.15  # correlation with the mean curvature: fsaverage5's curv has 0.9, sulc 0.65, the other side's 0.05


def usual_spacing(metadata: dict[str, Any], uv: NDArray[np.float64], faces: NDArray[Any]) -> float:
    """Return the typical distance of neighbouring points, mm.

    Parameters
    ----------
    metadata : dict
        Of a map or an atlas.
    uv : ndarray, shape (N, 2)
        Places in the plane, mm.
    faces : ndarray of int, shape (F, 3)
        Triangles of them.

    Returns
    -------
    float
        Of voxels the geometric mean of the three spacings, of a mesh the median edge in the plane.
    """
    if metadata["kind"] == "voxels":
        affine = np.asarray(metadata["affine"], dtype=np.float64)
        return float(np.cbrt(np.prod(np.linalg.norm(affine[:3, :3], axis=0))))
    sides = uv[faces] - uv[np.roll(faces, 1, axis=1)]
    return float(np.median(np.linalg.norm(sides, axis=2)))


@dataclass(frozen=True, eq=False)
class Sampler:
    """The points whose numbers a raster's corners are, on the surface.

    Parameters
    ----------
    points : ndarray of float64, shape (N, 3)
        RAS+ mm in `space`.
    normals : ndarray of float64, shape (N, 3)
        Unit vectors that point outside; NaN for a sheet, which has no outside.
    ids : ndarray of int64, shape (N, 3) or (N,)
        Voxel indices, or vertex numbers in the mesh.
    metadata : dict
        What the surface was made of: its ``kind``, and of voxels ``affine`` and ``shape``, of a mesh ``vertices``; and
        the ``space`` of the points.
    faces : ndarray of int, shape (F, 3)
        Triangles of the points.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    ids: NDArray[np.int64]
    metadata: dict[str, Any]
    faces: NDArray[Any]

    @property
    def is_voxels(self) -> bool:
        """Whether the surface was made of a volume."""
        return bool(self.metadata["kind"] == "voxels")

    @property
    def space(self) -> Space:
        """The space of the points."""
        return Space.of(self.metadata)

    @cached_property
    def affine(self) -> NDArray[np.float64]:
        """From voxel indices to RAS+ mm, shape (4, 4), of the volume that was flattened."""
        self.need_volume("has no voxels and so no affine")
        return np.asarray(self.metadata["affine"], dtype=np.float64)

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Shape of the volume that was flattened."""
        self.need_volume("has no volume's shape")
        i, j, k = self.metadata["shape"]
        return (i, j, k)

    def need_volume(self, what: str) -> None:
        """Refuse what only the map of a volume has.

        Parameters
        ----------
        what : str
            What the map of a mesh lacks.

        Raises
        ------
        InputError
            If the surface was made of a mesh.
        """
        if not self.is_voxels:
            raise InputError(f"the map of a mesh {what}; give a volume with its own affine, or values at its vertices")

    def locate(self, raster: Raster) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Look up which place on the surface each pixel shows: as `FlatMap.locate`."""
        nearest = raster.nearest
        inside = (nearest >= 0)[..., None] if self.is_voxels else nearest >= 0
        ids = np.where(inside, self.ids[nearest], -1)
        return ids, raster.interpolate(self.points)

    def images(
        self, raster: Raster, volume: object, *, depth: float = 0.0, interpolation: str | None = None, name: str = ""
    ) -> FlatStack:
        """Sample all channels of a volume, an overlay or a texture onto pixels: as `FlatMap.images`."""
        depth = checked_number(depth, "depth")
        title = name or (Path(volume).name if isinstance(volume, str | os.PathLike) else "overlay")
        texture = None if self.is_voxels else self._surface_texture(volume)
        overlay = None if self.is_voxels or texture is not None else self._overlay(volume)
        if texture is not None:
            if depth != 0 or interpolation is not None:
                raise InputError(
                    "depth and interpolation are for volumes and overlays, not for textures; leave them out"
                )
            colours = paint(texture, raster, self.ids)
            channels = Channels(("",), lambda _: colours)
        elif overlay is not None:
            channels = overlay.mapped(lambda values: show(raster, values[self.ids], interpolation))
        else:
            volumes, placed, path = self._volumes(volume)
            title = name or (path.name if path else "volume")
            places = self._in_world(raster, depth)
            channels = volumes.mapped(lambda voxels: sample(placed(voxels), places, interpolation))
        return FlatStack(channels, raster.pixel_size, raster.origin, title)

    def image(
        self,
        raster: Raster,
        volume: object,
        *,
        channel: int | str | None = None,
        depth: float = 0.0,
        interpolation: str | None = None,
        name: str = "",
    ) -> FlatImage:
        """Sample one channel of a volume, an overlay or a texture onto pixels: as `FlatMap.image`."""
        stack = self.images(raster, volume, depth=depth, interpolation=interpolation, name=name)
        with naming(volume if isinstance(volume, str | os.PathLike) else type(volume).__name__, REMEDY):
            shown = stack[stack.channels.find(channel)]
        return replace(shown, name=name) if name else shown

    def _volumes(self, volume: object) -> tuple[Channels, Callable[[NDArray[Any]], Volume], Path | None]:
        """Return voxels, read one by one where there are several volumes, how they become a volume, and their file."""
        path = Path(volume) if isinstance(volume, str | os.PathLike) else None
        with naming(path or type(volume).__name__, REMEDY):
            series = series_of(path or volume)
        if series is not None:
            self._doubt_place(series[1], path)
            return series[0], lambda voxels: Volume(voxels, series[1], path), path
        if isinstance(volume, np.ndarray) and volume.ndim == 4 and volume.dtype != np.uint8 and volume.shape[3] > 1:
            return Channels(("",) * volume.shape[3], lambda n: volume[..., n]), self._placed, None
        placed = self._placed(volume)
        self._doubt_place(placed.affine, placed.path)
        return Channels(("",), lambda _: placed.data), lambda _: placed, placed.path

    def _surface_texture(self, volume: object) -> SurfaceTexture | NDArray[np.uint8] | None:
        """Return the texture of the mesh, or colours at its vertices, if that is what was given."""
        count = self.metadata["vertices"]
        if isinstance(volume, str | os.PathLike):
            path = Path(volume)
            is_textured = path.name.lower().endswith(TEXTURE_ENDINGS)
            return read_texture(path, count) if is_textured else None
        return np.asarray(volume) if are_colours(volume, count) else None

    def _overlay(self, volume: object) -> Channels | None:
        """Return values at the mesh's vertices, if that is what was given."""
        count, structure = self.metadata["vertices"], self.metadata.get("structure")
        if isinstance(volume, str | os.PathLike):
            if holds_volume(volume):
                return None
            refuse_other_side(volume, structure)
            channels = read_channels(volume, count, structure=structure)
            self._doubt(Path(volume), channels.read(0))
            return channels
        if hasattr(volume, "dataobj"):
            with naming(type(volume).__name__, REMEDY):
                return points_of_nibabel(volume, count, structure)
        if isinstance(volume, np.ndarray | list) and np.ndim(np.asarray(volume)) in (1, 2):
            values = np.asarray(volume)
            if len(values) != count:
                raise InputError(f"the overlay has {len(values)} values; the mesh has {count} vertices")
            return Channels.of_array(values)
        return None

    def _doubt(self, path: Path, values: NDArray[Any]) -> None:
        """Tell if a file of as many values seems to be of another surface: by its name, or by its curvature."""
        names = [re.findall(r"sub-[A-Za-z0-9]+", str(of)) for of in (self.metadata.get("input") or "", path)]
        if all(names) and names[0][-1] != names[1][-1]:
            log.warning("%s is of %s, the surface of %s: is it meant?", path.name, names[1][-1], names[0][-1])
        if re.search(r"(^|[._-])(curv|sulc)([._]|$)", path.name) and values.ndim == 1:
            r = self._correlation_with_curvature(values)
            if abs(r) < _CURVED:
                log.warning(
                    "%s does not follow the folds of the surface (correlation with its curvature %.2f, where 0.6 to "
                    "0.9 is usual): is it of this one?",
                    path.name,
                    r,
                )

    def _correlation_with_curvature(self, values: NDArray[Any]) -> float:
        """Return how values at the mesh's vertices go with its mean curvature; NaN where either is constant."""
        ends = np.concatenate([self.faces, self.faces[:, ::-1]])[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        steps = self.points[ends[:, 1]] - self.points[ends[:, 0]]
        with np.errstate(all="ignore"):
            bend = (self.normals[ends[:, 0]] * steps).sum(axis=1) / (steps**2).sum(axis=1)
        vertices, is_known = self.ids[ends[:, 0]], np.isfinite(bend)
        count = np.bincount(vertices[is_known], minlength=len(values))
        seen = np.flatnonzero(count)
        curvature = (np.bincount(vertices[is_known], bend[is_known], len(values)) / np.maximum(count, 1))[seen]
        with np.errstate(all="ignore"):
            return float(np.corrcoef(curvature, values[seen].astype(np.float64))[0, 1])

    def _doubt_place(self, affine: NDArray[np.float64], path: Path | None) -> None:
        """Tell if a volume's file does not say where it lies, unless it lies where the flattened one does."""
        is_same = self.is_voxels and np.array_equal(affine, self.affine)
        if path is not None and not is_same and not has_place(path):
            log.warning(
                "%s does not say where it lies (no sform, qform or goodRASFlag): its middle is taken as the origin; "
                "give it the header of an image that it belongs to",
                path.name,
            )

    def _in_world(self, raster: Raster, depth: float) -> NDArray[np.float64]:
        """Return where to sample for each pixel in the world of the volumes, shape (H, W, 3), scanner RAS, mm."""
        if self.space.doubt:
            log.warning(
                "the volume may be sampled beside the surface: %s; give a file that says it: FreeSurfer's own with its "
                "footer, such as lh.white, or what mris_convert --to-scanner of FreeSurfer 7.4 or later writes",
                self.space.doubt,
            )
        return self.space.to_scanner(self._at_depth(raster, depth))

    def _at_depth(self, raster: Raster, depth: float) -> NDArray[np.float64]:
        """Return where to sample for each pixel, shape (H, W, 3), RAS+ mm in the space of the points."""
        points = raster.interpolate(self.points)
        if depth == 0:
            return points
        if not np.isfinite(depth):
            raise InputError(f"the depth is {depth}; give a finite number of mm")
        if np.isnan(self.normals).all():
            raise InputError(f"depth is {depth:g} mm, but this sheet has background on both sides and so no outside")
        normals = raster.interpolate(self.normals)
        return np.asarray(points + depth * normals / np.linalg.norm(normals, axis=-1, keepdims=True))

    def _placed(self, volume: object) -> Volume:
        """Return a volume with its place; without one of its own it lies where the flattened volume lies."""
        given = as_volume(volume)
        if given.is_placed:
            return given
        if given.data.shape[:3] != self.volume_shape:
            raise InputError(
                f"the volume has shape {given.data.shape} and no affine, the flattened volume {self.volume_shape}; "
                "give a volume of that shape, or one with its affine"
            )
        return replace(given, affine=self.affine)
