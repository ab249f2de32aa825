"""The page of an atlas: its pieces side by side, as images and as a texture, with lookups on the surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, checked_instance
from voxflat.atlases.pieces import FIGURES, FlatPieces
from voxflat.errors import InputError
from voxflat.io.grid import rounded
from voxflat.io.provenance import Record, recording
from voxflat.maps.plane import FlatTriangles, Planar
from voxflat.maps.raster import FlatImage
from voxflat.maps.surface_points import SurfacePoints
from voxflat.maps.textures.textured import TexturedSurface


@dataclass(frozen=True, eq=False)
class FlatPage(Planar):
    """The pieces of an atlas side by side, without overlap.

    `Atlas.page` returns it.

    Parameters
    ----------
    atlas : Atlas
        The atlas.
    uv : ndarray, shape (P, 2)
        Position on the page for each row of the atlas's `uv`, in mm. Pieces are rotated and moved; (0, 0) is the lower
        left corner.
    gap : float
        Smallest distance between pieces, in mm.

    See Also
    --------
    Atlas.page : Place the pieces on a page.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20).page()
    <FlatPage: 8 pieces, 55 x 71, 44 % used>
    """

    atlas: FlatPieces
    uv: NDArray[np.float64]
    gap: float

    def __repr__(self) -> str:
        (width, height), used = self.uv.max(axis=0), 100 * self.used_share
        return f"<FlatPage: {len(self.atlas)} pieces, {rounded(width)} x {rounded(height)}, {used:.0f} % used>"

    @property
    def provenance(self) -> Record:
        """The record of how the atlas was made."""
        return self.atlas.provenance

    @property
    def corners(self) -> NDArray[np.float64]:
        """The positions of the corners of each triangle, in mm, shape (F, 3, 2).

        Triangles are in the order of the atlas's `faces`.
        """
        return np.asarray(self.uv[self.atlas.uv_faces])

    @property
    def used_share(self) -> float:
        """The fraction of the page that the pieces cover.

        The packing "shapes" increases this fraction if pieces are large.
        """
        a, b = (self.corners[:, k] - self.corners[:, 0] for k in (1, 2))
        return float(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / self.uv.max(axis=0).prod())

    @property
    def pixel_size(self) -> float:
        """The default side length of a pixel, in mm.

        It is half of the typical edge or voxel size, and at most half of the gap.
        """
        half = self._triangles.spacing / 2
        return min(half, self.gap / 2) if self.gap > 0 else half

    @cached_property
    def _triangles(self) -> FlatTriangles:
        """The triangles without shared corners, so that a corner of the raster identifies its triangle."""
        atlas, count = self.atlas, len(self.atlas.faces)
        rows = atlas.faces.ravel()
        faces = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
        on_surface = SurfacePoints(atlas.points[rows], atlas.normals[rows], atlas.ids[rows], atlas.origin, faces)
        torn = np.zeros(count, dtype=np.bool_)
        return FlatTriangles(self.corners.reshape(-1, 2), faces, torn, on_surface, atlas.piece_ids)

    def face_ids(self, pixel_size: float | None = None) -> NDArray[np.int64]:
        """Return the triangle at each pixel.

        The pixels are those of `raster`.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        ndarray of int64, shape (H, W)
            Rows of the atlas's `faces`; −1 outside the pieces.
        """
        raster = self.raster(pixel_size)
        return np.where(raster.inside, raster.corners[..., 0].astype(np.int64) // 3, -1)

    @recording()
    def heat_map(self, pixel_size: float | None = None, *, of: str = "isometric") -> FlatImage:
        """Return an image of the distortion of each triangle.

        It has the same pixels as the images that `image` returns.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.
        of : {"isometric", "quasi_conformal", "areal"}
            The measure: C, K, or the change in area.

        Returns
        -------
        FlatImage
            The image, with NaN outside the pieces.

        Raises
        ------
        InputError
            If the measure is unknown.
        """
        checked_choice(of, "of", FIGURES)
        return self._carried(getattr(self.atlas, of), FIGURES[of], pixel_size)

    @recording()
    def label_image(self, pixel_size: float | None = None) -> FlatImage:
        """Return an image of the patch numbers, starting from 1.

        It has the same pixels as the images that `image` returns.

        Parameters
        ----------
        pixel_size : float, optional
            As in `raster`.

        Returns
        -------
        FlatImage
            The image, with NaN outside the pieces.
        """
        numbers = self.atlas.patch_ids + 1  # 0 would be grey, as for unlabelled pixels
        return replace(self._carried(numbers, "number of the patch", pixel_size), labels=True)

    def _carried(self, values: NDArray[np.generic], name: str, pixel_size: float | None) -> FlatImage:
        """Return an image of the values of the triangles."""
        raster, pieces = self.raster(pixel_size), self.face_ids(pixel_size)
        data = np.where(pieces < 0, np.nan, values.astype(np.float64)[pieces])
        return FlatImage(data, raster.pixel_size, raster.origin, name, unit=raster.unit)

    def texture_coordinates(self, image: FlatImage | None = None) -> NDArray[np.float64]:
        """Return the texture coordinates of the pieces in an image of the page.

        They range from 0 to 1 over the whole image.

        Parameters
        ----------
        image : FlatImage, optional
            An image from `image`, `heat_map` or `label_image`; by default, an image with the default pixel size.

        Returns
        -------
        ndarray, shape (P, 2)
            (s, t) from 0 to 1 for each row of `uv`; (0, 0) is the lower left corner of the image.

        Raises
        ------
        InputError
            If the image does not contain the whole page.
        """
        if image is None:
            raster = self.raster()
            image = FlatImage(np.empty((*raster.shape, 0)), raster.pixel_size, raster.origin, "")
        checked_instance(image, FlatImage, "image", "a FlatImage of this page")
        left, right, bottom, top = image.extent
        coordinates = (self.uv - [left, bottom]) / [right - left, top - bottom]
        if (coordinates < 0).any() or (coordinates > 1).any():
            raise InputError("the image does not belong to this page. Pass an image that this page returned")
        return np.asarray(coordinates)

    @recording()
    def textured(
        self, image: FlatImage | None = None, *, colour_map: str | None = None, limits: Sequence[float] | None = None
    ) -> TexturedSurface:
        """Return the surface with an image of the page as its texture.

        Colours extend into the gaps between pieces, so that seams are not visible.

        Parameters
        ----------
        image : FlatImage, optional
            An image from `image`, `heat_map` or `label_image`; by default `label_image`, which colours the patches.
        colour_map : str, optional
            A matplotlib colour map. By default, values are shown in grey levels, and each label has its own colour.
        limits : sequence of 2 floats, optional
            The values at the ends of the colour map; by default the 1st and 99th percentiles.

        Returns
        -------
        TexturedSurface
            The surface with its own triangles and vertices, and texture coordinates with seams between pieces.

        Raises
        ------
        InputError
            If the image does not belong to this page or shows nothing, or if the colour map does not exist.

        Examples
        --------
        >>> page = voxflat.samples.hill().patches(max_angle=20).page()
        >>> page.textured(page.heat_map(pixel_size=1.0))
        <TexturedSurface: 441 points, 800 triangles, 56 x 73 texels>
        """
        shown = self.label_image() if image is None else image
        coordinates = self.texture_coordinates(shown)
        picture = _spread(shown.colours(colour_map, limits))
        atlas = self.atlas
        points = atlas.space.to_scanner(atlas.points)
        known: dict[str, Any] = {"unit": atlas.origin.unit, "is_ras": atlas.origin.has_known_axes}
        return TexturedSurface(points, atlas.faces, coordinates, picture, texture_faces=atlas.uv_faces, **known)


def _spread(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return opaque colours; pixels without a colour get the colour of the nearest pixel that has one."""
    empty = picture[..., 3] == 0
    if empty.all():
        raise InputError("the image has no values on the page. Pass an image that covers the pieces")
    rows, columns = scipy.ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.ascontiguousarray(picture[rows, columns, :3])
