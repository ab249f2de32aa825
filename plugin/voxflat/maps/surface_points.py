"""The points of a map on the surface, and their positions at other depths."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import log
from voxflat.distortion.later import MeasuredLater
from voxflat.errors import InputError
from voxflat.io.channels import LastKept
from voxflat.io.origin import Origin
from voxflat.maps.depth import Depths, equivolume, smooth_areas, uncrossed, vertex_areas
from voxflat.maps.raster import Raster
from voxflat.unique_rows import distinct

_Floats = NDArray[np.float64]
_T = TypeVar("_T")
PASS_SURFACE = "Also pass surface, the surface that it shows"
NO_POINTS, NO_NORMALS = "its points have no positions in space", "it has no inside and outside"


def needs_surface(**fields: str) -> Callable[[type[_T]], type[_T]]:
    """Return a decorator of dataclasses: reading these fields raises an error in maps without a surface (None)."""

    def decorate(cls: type[_T]) -> type[_T]:
        for name, shown_as in fields.items():
            setattr(cls, name, _OfSurface(name, shown_as))
        return cls

    return decorate


class _OfSurface:
    """A field that is None in maps without a surface, and then raises an error when it is read.

    A value that is measured later is measured when it is read for the first time.
    """

    def __init__(self, name: str, shown_as: str) -> None:
        self.name, self.shown_as = name, shown_as

    def __get__(self, result: Any, _: type | None = None) -> Any:
        if result is None:
            return self
        if (value := vars(result)[self.name]) is None:
            raise InputError(f"this map was loaded without its surface, so {self.shown_as}. {PASS_SURFACE}")
        return value() if isinstance(value, MeasuredLater) else value

    def __set__(self, result: Any, value: Any) -> None:
        vars(result)[self.name] = value


@needs_surface(points=NO_POINTS, normals=NO_NORMALS)
@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """The points of a map on the surface, in the order of the corners of rasters."""

    points: _Floats  # (N, 3), RAS+ in the space and unit of the origin
    normals: _Floats  # outward unit vectors; NaN for a one-voxel-thick surface
    ids: NDArray[np.int64]  # voxel indices (N, 3), or vertex numbers in the mesh (N,)
    origin: Origin
    faces: NDArray[Any]
    white_points: _Floats | None = None  # (N, 3), on the white and pial surfaces, if both are known
    pial_points: _Floats | None = None
    called: str = "flattened volume"  # in messages about volumes without an affine

    @property
    def is_known(self) -> bool:
        """Whether the points have positions, which maps without their surface lack."""
        return vars(self)["points"] is not None

    @property
    def affine(self) -> _Floats:
        """The affine of the flattened volume, from voxel indices to RAS+ mm, shape (4, 4)."""
        self.need_volume("has no affine")
        return self.origin.voxels.affine

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """The shape of the flattened volume."""
        self.need_volume("has no volume shape")
        return self.origin.voxels.shape

    def need_volume(self, fault: str, remedy: str = "Pass a volume with an affine, or values at its vertices") -> None:
        """Raise an error unless the map was made from a volume."""
        if not self.origin.is_voxels:
            raise InputError(f"a map of a mesh {fault}. {remedy}")

    def at(self, depths: Depths) -> list[_Floats]:
        """Return the points at each depth, shape (N, 3), in RAS+ mm in the space of the points."""
        if depths.layering is not None:
            return self._at_fractions(depths)
        return [self.points + (depth * self.directions(depths) if depth else 0) for depth in depths.values]

    def heights(self, depths: Depths) -> tuple[float, ...]:
        """Return the height of each depth in mm: a fraction of the median thickness, or the distance as given."""
        if depths.layering is None or self.white_points is None or self.pial_points is None:
            return depths.values
        thickness = _thickness(self.white_points, self.pial_points)
        return tuple(value * thickness for value in depths.values)

    def in_scanner(self, raster: Raster, depths: Depths) -> list[_Floats]:
        """Return the positions of pixels in scanner RAS and mm, shape (H, W, 3) for each depth."""
        to_scanner = self.origin.space.to_scanner
        if depths.layering is not None:
            return [to_scanner(raster.interpolate(points)) for points in self.at(depths)]
        points = raster.interpolate(self.points)
        if not any(depths.values):
            return [to_scanner(points)] * len(depths)
        normals = raster.interpolate(self.directions(depths))
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return [to_scanner(points + depth * normals if depth else points) for depth in depths.values]

    def directions(self, depths: Depths) -> _Floats:
        """Return unit vectors from the surface to all depths; layers along them do not cross, if that is possible."""
        return self._uncrossed(min(depths.values), max(depths.values))

    @cached_property
    def _uncrossed(self) -> Callable[[float, float], _Floats]:
        return cache(self._directions)

    def _directions(self, low: float, high: float) -> _Floats:
        if np.isnan(self.normals).all():
            depth = f"{high or low:g} mm"
            raise InputError(f"depth is {depth}, but a surface that is one voxel thick has no outside. Omit depth")
        directions, share = uncrossed(self.points, self.normals, self.faces, low, high)
        if share:
            ends = Depths((low, high)).names(self.origin.named_unit)
            between = ends[0] if low == high else " to ".join(ends)
            message = "layers at depths of %s cross at %.2g %% of the triangles, where the surface bends more tightly"
            log.warning(f"{message}. Use smaller depths, or smooth the surface", between, 100 * share)
        return directions

    @cached_property
    def _at_fractions(self) -> LastKept[Depths, list[_Floats]]:
        return LastKept(self._between)

    def _between(self, depths: Depths) -> list[_Floats]:
        """Return the points at fractions of the way from the white to the pial surface."""
        if self.white_points is None or self.pial_points is None:
            raise InputError(
                "fraction requires white and pial surfaces, but this map has no pial surface. Flatten the white "
                "surface with pial=, or pass depth= in mm"
            )
        surfaces = (self.white_points, self.pial_points)
        way = self.pial_points - self.white_points
        if depths.layering == "equidistant":
            return [self.white_points + value * way for value in depths.values]
        if self.origin.is_voxels:  # these surfaces are too rough for the areas around single points
            inner, outer = smooth_areas(surfaces, self.points, self.faces, _thickness(*surfaces))
        else:
            vertex = distinct(self.ids).which  # the area around a vertex is summed over the sides of a cut
            sums = [np.bincount(vertex, vertex_areas(points, self.faces)) for points in surfaces]
            inner, outer = (np.asarray(areas[vertex], dtype=np.float64) for areas in sums)
        return [self.white_points + equivolume(value, inner, outer)[:, None] * way for value in depths.values]

    @cached_property
    def label_channels(self) -> set[tuple[Path | None, str]]:
        """Stacks that were taken for labels, each of which is reported once."""
        return set()


def _thickness(inner: _Floats, outer: _Floats) -> float:
    """Return the median distance between two surfaces in mm."""
    return float(np.median(np.linalg.norm(outer - inner, axis=1)))
