"""A surface in flat pieces: what all atlases are, whoever made the pieces."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._errors import InputError
from voxflat.io import atomic_path

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
        How it was made.
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

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.starts) - 1

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
