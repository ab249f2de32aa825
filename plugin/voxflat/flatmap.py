"""Flat maps: what `voxflat.flatten` returns."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _flatimage
from voxflat._errors import InputError
from voxflat._flatimage import FlatImage, Raster
from voxflat.io import Volume, as_volume, atomic_path

__all__ = ["Distortion", "Figures", "FlatMap", "load"]

_FORMAT = 1


@dataclass(frozen=True)
class Figures:
    """Distortion figures of a flat map at one scale.

    δ are geodesic distances on the surface, d flat distances times `scale`. NaN means undefined.

    Parameters
    ----------
    scale : float
        The factor on flat distances.
    relative_error : float
        Mean of |d − δ|/δ over all pairs (Grossmann et al. 2002: ε̄_r).
    relative_error_10mm, relative_error_30mm : float
        The same over pairs with δ ≤ 10 mm and ≤ 30 mm.
    absolute_error : float
        Mean of |d − δ|, mm (Grossmann et al. 2002: ε̄).
    stress_1 : float
        √(Σ(d − δ)² / Σδ²), Kruskal.
    sammon_stress : float
        (1/Σδ) Σ (d − δ)²/δ, Schwartz et al. 1989, equation 1.0.
    """

    scale: float
    relative_error: float
    relative_error_10mm: float
    relative_error_30mm: float
    absolute_error: float
    stress_1: float
    sammon_stress: float


@dataclass(frozen=True, eq=False)
class Distortion:
    """What flattening did to the distances, from reference sources (200 random points) to all points.

    Parameters
    ----------
    raw : Figures
        At scale 1: a flat map is in mm.
    best_scale : Figures
        At the scale with the least mean relative error.
    pearson_r : float
        Correlation of flat and geodesic distances.
    mean_geodesic : float
        Mean geodesic distance of the pairs, mm (Grossmann et al. 2002: δ̄).
    pairs : int
        Number of pairs.
    per_point : ndarray, shape (N,)
        Mean of |d − δ|/δ over the pairs of each point, at scale 1: the heat map.
    scatter : ndarray, shape (K, 2)
        Some pairs as (δ, d), mm.
    """

    raw: Figures
    best_scale: Figures
    pearson_r: float
    mean_geodesic: float
    pairs: int
    per_point: NDArray[np.float64]
    scatter: NDArray[np.float64]

    def figures(self) -> dict[str, Any]:
        """Return the figures without the arrays, ready for JSON: undefined ones are None.

        Returns
        -------
        dict
            ``raw`` and ``best_scale`` (dicts), ``pearson_r``, ``mean_geodesic``, ``pairs``.
        """
        values = {key: value for key, value in asdict(self).items() if not isinstance(value, np.ndarray)}
        return dict(json_ready(values))

    def table(self) -> str:
        """Return the figures as a table of text."""
        rows = [
            ("relative error", "relative_error", 100.0, "%"),
            ("  pairs up to 10 mm", "relative_error_10mm", 100.0, "%"),
            ("  pairs up to 30 mm", "relative_error_30mm", 100.0, "%"),
            ("absolute error", "absolute_error", 1.0, "mm"),
            ("stress-1", "stress_1", 1.0, ""),
            ("Sammon stress", "sammon_stress", 1.0, ""),
        ]
        lines = [f"{'':22}{'raw':>10}{'at scale ' + format(self.best_scale.scale, '.3f'):>18}"]
        for name, key, factor, unit in rows:
            raw, best = (factor * getattr(figures, key) for figures in (self.raw, self.best_scale))
            digits = 2 if unit else 4
            lines.append(f"{name:22}{raw:>10.{digits}f}{best:>18.{digits}f} {unit}".rstrip())
        lines.append(f"{'mean geodesic':22}{self.mean_geodesic:>10.2f}{'':18} mm")
        lines.append(f"{'correlation':22}{self.pearson_r:>10.4f}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class FlatMap:
    """A flattened surface.

    Parameters
    ----------
    uv : ndarray of float64, shape (N, 2)
        The points' places in the plane, mm. The surface is seen from outside, superior up.
    points : ndarray of float64, shape (N, 3)
        The points on the surface, RAS+ mm.
    normals : ndarray of float64, shape (N, 3)
        Unit vectors that point outside, to the background (RAS+); NaN for a sheet, which has background on both sides.
    ids : ndarray of int64, shape (N, 3)
        Their voxel indices (i, j, k).
    faces : ndarray of uint32, shape (F, 3)
        Triangles of points that cover the map, counterclockwise.
    torn : ndarray of bool, shape (F,)
        Triangles whose corners are neighbours in the plane but not on the surface: there the map is squeezed or folded.
    sources : ndarray of int64, shape (m,)
        The points from which distances were measured, as numbers into the rows above.
    eigenvalues : ndarray of float64, shape (K,)
        The scaling's eigenvalues of the largest magnitude, mm²; two that stand out mean a planar surface.
    distortion : Distortion
        What flattening did to the distances.
    metadata : dict
        Parameters, affine, versions, checksum of the input, topology.
    rows : ndarray of float32, shape (m, N), or None
        Geodesic distances from the sources, mm, if they were asked for.
    """

    uv: NDArray[np.float64]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    ids: NDArray[np.int64]
    faces: NDArray[np.uint32]
    torn: NDArray[np.bool_]
    sources: NDArray[np.int64]
    eigenvalues: NDArray[np.float64]
    distortion: Distortion
    metadata: dict[str, Any]
    rows: NDArray[np.float32] | None = None
    _rasters: dict[float, Raster] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.uv)

    def __repr__(self) -> str:
        width, height = np.ptp(self.uv, axis=0)
        error = 100 * self.distortion.raw.relative_error
        return f"<FlatMap: {len(self)} points, {width:.0f} x {height:.0f} mm, relative error {error:.1f} %>"

    @cached_property
    def affine(self) -> NDArray[np.float64]:
        """From voxel indices to RAS+ mm, shape (4, 4)."""
        return np.asarray(self.metadata["affine"], dtype=np.float64)

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Shape of the volume that was flattened."""
        i, j, k = self.metadata["shape"]
        return (i, j, k)

    @property
    def spacing(self) -> float:
        """Voxel size of the flattened volume, mm: the geometric mean of its three spacings."""
        return float(np.cbrt(np.prod(np.linalg.norm(self.affine[:3, :3], axis=0))))

    def raster(self, pixel_size: float | None = None) -> Raster:
        """Return the map's pixels, with the inverse look-up to the surface.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default half the voxel size.

        Returns
        -------
        Raster
        """
        size = self.spacing / 2 if pixel_size is None else float(pixel_size)
        if size not in self._rasters:
            self._rasters[size] = _flatimage.draw(self.uv, self.faces, self.torn, size)
        return self._rasters[size]

    def locate(self, pixel_size: float | None = None) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Look up which place on the surface each pixel shows.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        ids : ndarray of int64, shape (H, W, 3)
            The nearest surface voxel; −1 outside the map.
        points : ndarray of float64, shape (H, W, 3)
            RAS+ mm, linear between surface voxels; NaN outside the map.
        """
        raster = self.raster(pixel_size)
        nearest = raster.nearest
        ids = np.where(nearest[..., None] >= 0, self.ids[nearest], -1)
        return ids, raster.interpolate(self.points)

    def image(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        depth: float = 0.0,
        interpolation: str | None = None,
        name: str = "",
    ) -> FlatImage:
        """Sample a volume onto the flat map.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            Scalars or labels (I, J, K), or uint8 colours (I, J, K, 3 or 4). It may have another grid than the flattened
            volume: its affine says where it lies. A bare array must have the flattened volume's shape, and lies where
            that lies.
        pixel_size : float, optional
            Side of a pixel, mm; by default half the voxel size.
        depth : float
            How far outside the surface to sample, mm; negative is inside. 2 mm outside white matter lies grey matter.
        interpolation : {"linear", "nearest"}, optional
            By default "nearest" for bool and integer volumes, which may be labels, and "linear" for floating-point
            volumes and colours.
        name : str, optional
            What the image shows.

        Returns
        -------
        FlatImage
            NaN (colours: alpha 0) outside the map and where the volume has no value.

        Raises
        ------
        InputError
            If the volume does not fit or cannot be read.
        """
        placed = self._placed(volume)
        raster = self.raster(pixel_size)
        data = _flatimage.sample(placed, self._at_depth(raster, depth), interpolation)
        return FlatImage(
            data, raster.pixel_size, raster.origin, name or (placed.path.name if placed.path else "volume")
        )

    def heat_map(self, pixel_size: float | None = None) -> FlatImage:
        """Return the distortion of each point as an image on the same pixels as `image`.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default half the voxel size.

        Returns
        -------
        FlatImage
            Mean relative error of the distances from each place, as a fraction; NaN outside the map.
        """
        raster = self.raster(pixel_size)
        data = raster.interpolate(self.distortion.per_point)
        return FlatImage(data, raster.pixel_size, raster.origin, "distortion: mean relative error of distances")

    def texture(self, picture: ArrayLike) -> NDArray[Any]:
        """Carry a picture back to the surface (Grossmann et al. 2002, figures 11 to 13).

        Parameters
        ----------
        picture : array_like, shape (H, W) or (H, W, C)
            Laid over the map: centred, in its proportions, just covering the map's bounding box.

        Returns
        -------
        ndarray, shape (N,) or (N, C)
            The picture's value at each surface voxel, of the picture's type.
        """
        return _flatimage.sample_picture(np.asarray(picture), self.uv)

    def paint(self, values: ArrayLike, background: float = 0) -> NDArray[Any]:
        """Put values of the points into a volume of the flattened volume's shape.

        Parameters
        ----------
        values : array_like, shape (N,) or (N, C)
            One value, or one row, a point.
        background : float, optional
            Value of all other voxels.

        Returns
        -------
        ndarray, shape (I, J, K) or (I, J, K, C)

        Raises
        ------
        InputError
            If there is not one value a point.
        """
        values = np.asarray(values)
        if values.ndim not in (1, 2) or len(values) != len(self):
            raise InputError(f"values have shape {values.shape}; the map has {len(self)} points")
        volume = np.full((*self.volume_shape, *values.shape[1:]), background, dtype=values.dtype)
        volume[tuple(self.ids.T)] = values
        return volume

    def description(self) -> dict[str, Any]:
        """Return the metadata with the distortion figures, ready for JSON.

        Returns
        -------
        dict
            ``metadata``, and ``distortion`` as from `Distortion.figures`.
        """
        return {**self.metadata, "distortion": self.distortion.figures()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save everything to an .npz file, all of it or nothing.

        Parameters
        ----------
        path : path
            Ends in .npz.

        Raises
        ------
        InputError
            If the path has another ending or cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise InputError(f"cannot save a map as {path.name}; give a name that ends in .npz")
        arrays: dict[str, Any] = {
            "uv": self.uv,
            "points": self.points,
            "normals": self.normals,
            "ids": self.ids,
            "faces": self.faces,
            "torn": self.torn,
            "sources": self.sources,
            "eigenvalues": self.eigenvalues,
            "distortion_per_point": self.distortion.per_point,
            "distortion_scatter": self.distortion.scatter,
        }
        if self.rows is not None:
            arrays["rows"] = self.rows
        text = json.dumps({"format": _FORMAT, **self.description()}, allow_nan=False)
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, metadata=np.array(text), **arrays)

    def _at_depth(self, raster: Raster, depth: float) -> NDArray[np.float64]:
        """Return where to sample for each pixel, shape (H, W, 3), RAS+ mm."""
        points = raster.interpolate(self.points)
        if depth == 0:
            return points
        if not np.isfinite(depth):
            raise InputError(f"the depth is {depth}; give a finite number of mm")
        if np.isnan(self.normals).all():
            raise InputError(f"depth is {depth} mm, but this sheet has background on both sides and so no outside")
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


def json_ready(value: Any) -> Any:
    """Return the same with None for the numbers that JSON does not know: NaN, which means undefined, and infinity."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _undefined_as_nan(value: Any) -> Any:
    """Undo `json_ready` for figures."""
    if isinstance(value, dict):
        return {key: _undefined_as_nan(item) for key, item in value.items()}
    return float("nan") if value is None else value


def load(path: str | os.PathLike[str]) -> FlatMap:
    """Load a flat map that was saved with `FlatMap.save`.

    Parameters
    ----------
    path : path
        An .npz file.

    Returns
    -------
    FlatMap

    Raises
    ------
    InputError
        If the file is damaged or is no flat map.
    FileNotFoundError
        If there is no such file.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        metadata = json.loads(str(arrays.pop("metadata")))
        if metadata.pop("format") != _FORMAT:
            raise InputError(f"{path} was written by another version of voxflat; flatten again")
        distortion = _undefined_as_nan(metadata.pop("distortion"))
        return FlatMap(
            distortion=Distortion(
                raw=Figures(**distortion.pop("raw")),
                best_scale=Figures(**distortion.pop("best_scale")),
                per_point=arrays.pop("distortion_per_point"),
                scatter=arrays.pop("distortion_scatter"),
                **distortion,
            ),
            metadata=metadata,
            **arrays,
        )
    except InputError:
        raise
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except MemoryError:
        raise
    except Exception as error:  # what damage leads to is known to no one: zlib.error, BadZipFile, KeyError, ...
        raise InputError(f"{path} is not a flat map of voxflat or is damaged ({type(error).__name__})") from error
