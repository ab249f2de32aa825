"""The page of an atlas: its pieces side by side, as images, as a texture, and the way back to the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from voxflat.errors import InputError
from voxflat.maps.look_up import Places, TriangleFinder
from voxflat.maps.raster import FlatImage, Raster, draw
from voxflat.maps.sampler import Sampler, usual_spacing
from voxflat.maps.texture import TexturedSurface

if TYPE_CHECKING:
    from voxflat.atlases.pieces import FlatPieces

__all__ = ["FIGURES", "FlatPage"]

FIGURES = {
    "isometric": "C: by what factor lengths change at most",
    "quasi_conformal": "K: by what factor lengths change more one way than across",
    "areal": "area in the plane by area on the surface",
}
"""The figures of a triangle that a heat map shows, and what they mean."""


@dataclass(frozen=True, eq=False)
class FlatPage:
    """The pieces of an atlas side by side, without overlap: what `FlatPieces.page` returns.

    Parameters
    ----------
    pieces : FlatPieces
        The atlas.
    places : ndarray, shape (P, 2)
        For each row of the atlas's `uv` its place on the page, mm; pieces are turned and moved, and (0, 0) is the lower
        left corner.
    gap : float
        At least so much lies between pieces, mm.
    """

    pieces: FlatPieces
    places: NDArray[np.float64]
    gap: float
    _rasters: dict[float, Raster] = field(default_factory=dict, init=False, repr=False)

    def __repr__(self) -> str:
        width, height = self.places.max(axis=0)
        return (
            f"<FlatPage: {len(self.pieces)} pieces, {width:.0f} x {height:.0f} mm, {100 * self.use:.0f} % of it used>"
        )

    @property
    def corners(self) -> NDArray[np.float64]:
        """Where each triangle's corners lie, shape (F, 3, 2), mm."""
        return np.asarray(self.places[self.pieces.corners])

    @property
    def use(self) -> float:
        """How much of the page pieces cover, as a fraction."""
        a, b = (self.corners[:, k] - self.corners[:, 0] for k in (1, 2))
        return float(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / self.places.max(axis=0).prod())

    @property
    def pixel_size(self) -> float:
        """Side of a pixel unless another is given, mm: half the usual edge or voxel, and at most half the gap."""
        half = usual_spacing(self.pieces.metadata, self.places, self.pieces.corners) / 2
        return min(half, self.gap / 2) if self.gap > 0 else half

    @cached_property
    def _sampler(self) -> Sampler:
        """The corners of all triangles, one after another: a raster's corner leads to its triangle."""
        rows = self.pieces.faces.ravel()
        of = self.pieces
        return Sampler(of.points[rows], of.normals[rows], of.ids[rows], of.metadata)

    def raster(self, pixel_size: float | None = None) -> Raster:
        """Return the page's pixels.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default `pixel_size`.

        Returns
        -------
        Raster
            Its corners count those of all triangles: corner 3 t + k is corner k of triangle t.
        """
        size = self.pixel_size if pixel_size is None else float(pixel_size)
        if size not in self._rasters:
            count = len(self.pieces.faces)
            faces = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
            self._rasters[size] = draw(self.corners.reshape(-1, 2), faces, np.zeros(count, dtype=bool), size)
        return self._rasters[size]

    def triangles(self, pixel_size: float | None = None) -> NDArray[np.int64]:
        """Return which triangle each pixel shows.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        ndarray of int64, shape (H, W)
            Rows of the atlas's `faces`; −1 beside the pieces.
        """
        raster = self.raster(pixel_size)
        return np.where(raster.inside, raster.corners[..., 0].astype(np.int64) // 3, -1)

    def locate(self, pixel_size: float | None = None) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Look up which place on the surface each pixel shows.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        ids : ndarray of int64, shape (H, W, 3) or (H, W)
            The nearest surface voxel or vertex; −1 beside the pieces.
        points : ndarray of float64, shape (H, W, 3)
            RAS+ mm; NaN beside the pieces.
        """
        return self._sampler.locate(self.raster(pixel_size))

    def look_up(self, places: ArrayLike) -> Places:
        """Look up places on the page: which piece and triangle lies there, where in it, and where that is in space.

        Parameters
        ----------
        places : array_like, shape (..., 2)
            On the page, mm.

        Returns
        -------
        Places
            −1 and NaN for what lies beside the pieces.
        """
        return self._finder.look_up(places, self.pieces.points[self.pieces.faces], labels=self.pieces.labels)

    @cached_property
    def _finder(self) -> TriangleFinder:
        return TriangleFinder(self.corners)

    def image(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        depth: float = 0.0,
        interpolation: str | None = None,
        name: str = "",
    ) -> FlatImage:
        """Sample a volume onto the page; all is as in `FlatMap.image`.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            A volume; of a mesh also an overlay, colours of its vertices, or the texture that it has of its own.
        pixel_size : float, optional
            Side of a pixel, mm; by default `pixel_size`.
        depth : float
            How far outside the surface to sample, mm; negative is inside.
        interpolation : {"linear", "nearest"}, optional
            By default "nearest" for bool and integer volumes, and "linear" for others.
        name : str, optional
            What the image shows.

        Returns
        -------
        FlatImage
            NaN (colours: alpha 0) beside the pieces and where the volume has no value.

        Raises
        ------
        InputError
            If the volume does not fit or cannot be read.
        """
        raster = self.raster(pixel_size)
        return self._sampler.image(raster, volume, depth=depth, interpolation=interpolation, name=name)

    def heat_map(self, pixel_size: float | None = None, *, of: str = "isometric") -> FlatImage:
        """Return the distortion of each triangle as an image on the same pixels as `image`.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default `pixel_size`.
        of : {"isometric", "quasi_conformal", "areal"}
            C, K, or the change of area.

        Returns
        -------
        FlatImage
            NaN beside the pieces.

        Raises
        ------
        InputError
            If there is no such figure.
        """
        if of not in FIGURES:
            raise InputError(f"there is no figure {of!r}; give one of {', '.join(map(repr, FIGURES))}")
        return self._carried(getattr(self.pieces, of), FIGURES[of], pixel_size)

    def numbers(self, pixel_size: float | None = None) -> FlatImage:
        """Return the number of the patch at each pixel, from 1 on, as an image on the same pixels as `image`.

        Parameters
        ----------
        pixel_size : float, optional
            Side of a pixel, mm; by default `pixel_size`.

        Returns
        -------
        FlatImage
            NaN beside the pieces.
        """
        return self._carried(self.pieces.coloured + 1, "number of the patch", pixel_size)  # labels of 0 are drawn grey

    def _carried(self, values: NDArray[np.generic], name: str, pixel_size: float | None) -> FlatImage:
        """Carry values of the triangles to their pixels."""
        raster, triangles = self.raster(pixel_size), self.triangles(pixel_size)
        data = np.where(triangles < 0, np.nan, values.astype(np.float64)[triangles])
        return FlatImage(data, raster.pixel_size, raster.origin, name)

    def texture_coordinates(self, image: FlatImage | None = None) -> NDArray[np.float64]:
        """Return where the pieces lie in an image of the page.

        Parameters
        ----------
        image : FlatImage, optional
            From `image`, `heat_map` or `numbers`; by default one with the default pixels.

        Returns
        -------
        ndarray, shape (P, 2)
            For each row of `places` (s, t) from 0 to 1; (0, 0) is the image's lower left corner.

        Raises
        ------
        InputError
            If the image does not hold the whole page.
        """
        if image is None:
            raster = self.raster()
            image = FlatImage(np.empty((*raster.shape, 0)), raster.pixel_size, raster.origin, "")
        left, right, bottom, top = image.extent
        coordinates = (self.places - [left, bottom]) / [right - left, top - bottom]
        if (coordinates < 0).any() or (coordinates > 1).any():
            raise InputError("the image is none of this page")
        return np.asarray(coordinates)

    def textured(
        self,
        image: FlatImage | None = None,
        *,
        colour_map: str | None = None,
        limits: Sequence[float] | None = None,
    ) -> TexturedSurface:
        """Return the surface with an image of the page on it: a texture atlas.

        Parameters
        ----------
        image : FlatImage, optional
            From `image`, `heat_map` or `numbers`; by default the pieces in colours.
        colour_map : str, optional
            A colour map of matplotlib for values; by default grey, and for labels a colour each, as in a PNG.
        limits : sequence of 2 floats, optional
            The values at the ends of the colour map; by default the 1st and 99th percentile.

        Returns
        -------
        TexturedSurface
            The surface's own triangles and vertices; texture coordinates of their corners, with seams between pieces.
            The picture's colours reach into the gaps, so that seams do not show.
        """
        from voxflat.maps.image_files import coloured  # brings in Pillow

        shown = (
            self._carried(self.pieces.labels + 1, "pieces", None) if image is None else image
        )  # 0 is grey: unlabelled
        coordinates = self.texture_coordinates(shown)
        picture = _spread(coloured(shown, colour_map, limits))
        of = self.pieces
        return TexturedSurface(of.points, of.faces, coordinates, picture, texture_faces=of.corners)


def _spread(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colours without opacity, where there were none those of the nearest pixel."""
    empty = picture[..., 3] == 0
    if empty.all():
        raise InputError("the image shows nothing on the page")
    rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.ascontiguousarray(picture[rows, columns, :3])
