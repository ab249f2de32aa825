"""A surface in flat pieces: what all atlases are, whoever made the pieces."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.atlases.layout import gap_of, lay_out
from voxflat.atlases.page import FlatPage
from voxflat.errors import InputError
from voxflat.io.volumes import atomic_path
from voxflat.maps.raster import FlatImage

__all__ = ["FlatPieces", "load_pieces", "save_pieces"]


@dataclass(frozen=True, eq=False, kw_only=True)
class FlatPieces:
    """A surface as flat pieces: every triangle lies in one of them.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        The surface's vertices, RAS+ mm.
    faces : ndarray of int64, shape (F, 3)
        Its triangles.
    ids : ndarray of int64, shape (N, 3) or (N,)
        What each vertex is in the input: voxel indices, or the number of a vertex.
    labels : ndarray of int64, shape (F,)
        The piece of each triangle.
    stretch : ndarray, shape (F, 2)
        σ1 ≥ σ2 of each triangle, measured in the plane.
    starts : ndarray of int64, shape (pieces + 1,)
        Where each piece's vertices begin in `vertices` and `uv`.
    vertices : ndarray of int64, shape (P,)
        Those of all pieces, one piece after another, as rows of `points`; one that lies on both sides of a cut within a
        piece is there twice.
    uv : ndarray, shape (P, 2)
        Their places, each piece in a plane of its own, mm.
    corners : ndarray of int64, shape (F, 3)
        The corners of each triangle as rows of `uv` and `vertices`, in the order of `faces`; counterclockwise.
    metadata : dict
        How it was made, and of what: ``kind`` ("voxels" or "mesh"), and of voxels ``affine`` and ``shape``, of a mesh
        ``vertices``, their number.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    ids: NDArray[np.int64]
    labels: NDArray[np.int64]
    stretch: NDArray[np.float64]
    starts: NDArray[np.int64]
    vertices: NDArray[np.int64]
    uv: NDArray[np.float64]
    corners: NDArray[np.int64]
    metadata: dict[str, Any] = field(default_factory=dict)
    _pages: dict[tuple[float, str], FlatPage] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.starts) - 1

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Outward unit normals of the vertices, weighted by areas, shape (N, 3); NaN for a sheet."""
        if self.metadata.get("sheet"):
            return np.full(self.points.shape, np.nan)
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        sums = np.zeros(self.points.shape)
        for corner in self.faces.T:
            np.add.at(sums, corner, across)
        with np.errstate(invalid="ignore"):
            return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))

    @property
    def title(self) -> str:
        """One line of what it is, for pictures."""
        return f"{len(self)} pieces, {len(self.faces)} triangles"

    @property
    def coloured(self) -> NDArray[np.int64]:
        """What triangles of the same colour have in common in pictures, shape (F,): their piece."""
        return self.labels

    @property
    def isometric(self) -> NDArray[np.float64]:
        """C of each triangle, max(σ1, 1/σ2): by what factor lengths change at most, shape (F,)."""
        most, least = self.stretch.T
        with np.errstate(divide="ignore"):
            return np.asarray(np.maximum(most, 1 / least))

    @property
    def quasi_conformal(self) -> NDArray[np.float64]:
        """K of each triangle, σ1/σ2, shape (F,)."""
        most, least = self.stretch.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(most / least)

    @property
    def areal(self) -> NDArray[np.float64]:
        """Area in the plane by area on the surface of each triangle, σ1 σ2, shape (F,)."""
        return np.asarray(self.stretch.prod(axis=1))

    def page(self, gap: float | None = None, *, packing: str = "boxes") -> FlatPage:
        """Lay the pieces out on a page, without overlap.

        Parameters
        ----------
        gap : float, optional
            Between the pieces, mm; by default a twentieth of their usual size.
        packing : {"boxes", "shapes"}
            "boxes": each piece turned into its smallest rectangle, these in rows. "shapes": into each other's bays, by
            the library xatlas (``pip install 'voxflat[atlas]'``), which uses a page better where pieces are large.

        Returns
        -------
        FlatPage
            With images, heat maps, the inverse look-up, and the surface with a texture.

        Raises
        ------
        InputError
            If the gap or the packing does not fit, or xatlas is missing.
        """
        chosen = gap_of(self) if gap is None else float(gap)
        key = (chosen, packing)
        if key not in self._pages:
            self._pages[key] = FlatPage(self, lay_out(self, chosen, packing), chosen)
        return self._pages[key]

    def layout(self, gap: float | None = None, *, packing: str = "boxes") -> NDArray[np.float64]:
        """Return where the pieces lie on their page, without overlap.

        Parameters
        ----------
        gap, packing
            As in `page`.

        Returns
        -------
        ndarray, shape (P, 2)
            For each row of `uv` its place on the page, mm; pieces are turned and moved, not mirrored.
        """
        return self.page(gap, packing=packing).places

    def image(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        depth: float = 0.0,
        interpolation: str | None = None,
        name: str = "",
    ) -> FlatImage:
        """Sample a volume onto the page: `page` and `FlatPage.image` in one.

        Parameters
        ----------
        volume, pixel_size, depth, interpolation, name
            As in `FlatMap.image`.

        Returns
        -------
        FlatImage
            NaN (colours: alpha 0) beside the pieces and where the volume has no value.
        """
        return self.page().image(volume, pixel_size, depth=depth, interpolation=interpolation, name=name)

    def heat_map(self, pixel_size: float | None = None, *, of: str = "isometric") -> FlatImage:
        """Return the distortion of each triangle on the page: `page` and `FlatPage.heat_map` in one.

        Parameters
        ----------
        pixel_size, of
            As in `FlatPage.heat_map`.

        Returns
        -------
        FlatImage
            NaN beside the pieces.
        """
        return self.page().heat_map(pixel_size, of=of)


def save_pieces(path: str | os.PathLike[str], form: str, text: Mapping[str, Any], arrays: dict[str, Any]) -> None:
    """Save an atlas to a file, all of it or nothing.

    Parameters
    ----------
    path : path
        Ends in .npz.
    form : str
        Name and version of the format.
    text : mapping
        What JSON can hold.
    arrays : dict of ndarray
        The rest.

    Raises
    ------
    InputError
        If the path has another ending or cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"cannot save an atlas as {path.name}; give a name that ends in .npz")
    content = json.dumps({"format": form, **text}, allow_nan=False)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, text=np.array(content), **arrays)


def load_pieces(
    path: str | os.PathLike[str], form: str, names: tuple[str, ...]
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Load what `save_pieces` wrote.

    Parameters
    ----------
    path : path
        An .npz file.
    form : str
        Name and version that it must have.
    names : tuple of str
        The arrays that it must hold.

    Returns
    -------
    text : dict
    arrays : dict

    Raises
    ------
    InputError
        If the file is damaged or is no such atlas.
    FileNotFoundError
        If there is no such file.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            text = json.loads(str(file["text"]))
            if text.pop("format") != form:
                raise InputError(f"{path} was written by another version of voxflat; make the patches again")
            return text, {name: file[name] for name in names}
    except (InputError, FileNotFoundError, IsADirectoryError, PermissionError, MemoryError):
        raise
    except Exception as error:  # what damage leads to is known to no one
        raise InputError(f"{path} is not an atlas of voxflat or is damaged ({type(error).__name__})") from error
