"""Glued patches: `FlatAtlas.glue` closes the seams between certified patches, into a `GluedAtlas`."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_threads, log
from voxflat.atlases.pieces import FlatPieces, load_pieces, save_pieces
from voxflat.errors import InputError

if TYPE_CHECKING:
    from voxflat.atlases.certified import FlatAtlas

__all__ = ["GluedAtlas", "GluedPiece", "Seams", "glue", "load_atlas"]

_FORMAT = "voxflat glued atlas 1"
_SHOWN = 12  # pieces in a table


@dataclass(frozen=True)
class Seams:
    """What became of the seams between patches; lengths on the surface, mm, each seam once.

    Parameters
    ----------
    length : float
        All seams.
    closed : float
        Those that were closed.
    holonomy : float
        Cuts inside a piece: closing them would take a triangle beyond the bound, as the surface is curved around them.
    bound : float
        Cuts between pieces that could not be united within the bound.
    overlap : float
        Cuts that are needed for a piece not to lie on itself.
    """

    length: float
    closed: float
    holonomy: float
    bound: float
    overlap: float

    @property
    def cuts(self) -> float:
        """The length of what remains cut, mm."""
        return self.holonomy + self.bound + self.overlap

    @property
    def closed_share(self) -> float:
        """The part of the seams' length that is closed; 1 where there are none."""
        return self.closed / self.length if self.length > 0 else 1.0


@dataclass(frozen=True, eq=False)
class GluedPiece:
    """A flat piece of a surface, of several patches.

    Parameters
    ----------
    faces : ndarray of int64, shape (G,)
        Its triangles, as rows of the atlas's `faces`.
    vertices : ndarray of int64, shape (P,)
        The vertex of each row of `uv`, as rows of the atlas's `points`; twice where it lies on both sides of a cut.
    uv : ndarray, shape (P, 2)
        Their places, mm.
    triangles : ndarray of int64, shape (G, 3)
        Its triangles, by rows of `uv`; counterclockwise.
    area : float
        On the surface, mm².
    isometric, quasi_conformal : float
        The greatest max(σ1, 1/σ2) and σ1/σ2 of its triangles, measured in the plane.
    """

    faces: NDArray[np.int64]
    vertices: NDArray[np.int64]
    uv: NDArray[np.float64]
    triangles: NDArray[np.int64]
    area: float
    isometric: float
    quasi_conformal: float

    def __repr__(self) -> str:
        return f"<GluedPiece: {len(self.faces)} triangles, {self.area:.4g} mm², C = {self.isometric:.4f}>"


@dataclass(frozen=True, eq=False, kw_only=True)
class GluedAtlas(FlatPieces, Sequence[GluedPiece]):
    """A surface as flat pieces of glued patches, from the largest to the smallest: a sequence of `GluedPiece`.

    Parameters
    ----------
    points, faces, ids, labels, stretch, starts, vertices, uv, corners, metadata
        As in `FlatPieces`.
    patches : ndarray of int64, shape (F,)
        The patch that each triangle belonged to.
    measured : ndarray, shape (pieces, 3)
        Area, isometric and quasi_conformal of each piece.
    bound : float
        No triangle has a greater max(σ1, 1/σ2).
    certified : float
        The bound of the certificate that the patches had before.
    before : float
        The greatest max(σ1, 1/σ2) that was measured in the patches before.
    seams : Seams
        What became of the seams.
    """

    patches: NDArray[np.int64]
    measured: NDArray[np.float64]
    bound: float
    certified: float
    before: float
    seams: Seams

    def __repr__(self) -> str:
        return (
            f"<GluedAtlas of {len(self)} pieces: {len(self.faces)} triangles, C ≤ {self.bound:g}, "
            f"{100 * self.seams.closed_share:.1f} % of the seams closed>"
        )

    def __getitem__(self, number: Any) -> Any:
        """Return a piece, or several for a slice."""
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(len(self)))]
        n = range(len(self))[number]
        rows = slice(self.starts[n], self.starts[n + 1])
        faces = self._faces_by_piece[n]
        area, isometric, quasi_conformal = self.measured[n].tolist()
        return GluedPiece(
            faces=faces,
            vertices=self.vertices[rows],
            uv=self.uv[rows],
            triangles=self.corners[faces] - self.starts[n],
            area=area,
            isometric=isometric,
            quasi_conformal=quasi_conformal,
        )

    def __iter__(self) -> Iterator[GluedPiece]:
        """Yield the pieces."""
        return (self[n] for n in range(len(self)))

    @cached_property
    def _faces_by_piece(self) -> list[NDArray[np.int64]]:
        order = np.argsort(self.labels, kind="stable")
        return np.split(order, np.searchsorted(self.labels[order], np.arange(1, len(self))))

    @property
    def title(self) -> str:
        """One line of what it is, for pictures."""
        closed = 100 * self.seams.closed_share
        count = int(self.patches.max()) + 1
        return f"{count} patches in {len(self)} pieces, {closed:.1f} % of the seams closed, C ≤ {self.bound:g}"

    @property
    def coloured(self) -> NDArray[np.int64]:
        """What triangles of the same colour have in common in pictures, shape (F,): their patch."""
        return self.patches

    @cached_property
    def outline(self) -> NDArray[np.int64]:
        """Where pieces end, at cuts and at the surface's boundary: edges as pairs of rows of `uv`, shape (edges, 2)."""
        edges = np.sort(np.stack([self.corners, np.roll(self.corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        found, uses = np.unique(edges, axis=0, return_counts=True)
        return np.asarray(found[uses == 1])

    @cached_property
    def cuts(self) -> NDArray[np.int64]:
        """The edges of the surface that stayed cut, as pairs of rows of `points`, shape (cuts, 2)."""
        edges, sides = _edges(self.faces, self.corners)
        paired = (edges[1:] == edges[:-1]).all(axis=1)
        apart = paired & (sides[1:] != sides[:-1]).any(axis=1)
        return np.asarray(edges[1:][apart])

    def figures(self) -> dict[str, Any]:
        """Return the figures by their names.

        Returns
        -------
        dict
        """
        area = self.measured[:, 0]
        triangle_area = _areas(self.points[self.faces])
        sizes = np.bincount(self.labels, minlength=len(self))
        c, k = self.isometric, self.quasi_conformal
        return {
            "pieces": len(self),
            "patches": int(self.patches.max()) + 1,
            "triangles": len(self.faces),
            "single_triangles": int((sizes == 1).sum()),
            "area": float(area.sum()),
            "largest_area_share": float(area[0] / area.sum()),
            "seams": {**asdict(self.seams), "cuts": self.seams.cuts, "closed_share": self.seams.closed_share},
            "bound": self.bound,
            "before": {"certified_c": self.certified, "c": self.before},
            "measured": {
                "c": float(c.max()),
                "mean_c": float(c @ triangle_area / triangle_area.sum()),
                "k": float(k.max()),
                "mean_k": float(k @ triangle_area / triangle_area.sum()),
            },
        }

    def table(self) -> str:
        """Return what became of the seams, and bounds beside measured figures, as a table of text.

        Returns
        -------
        str
        """
        of, seams = self.figures(), self.seams

        def share(length: float) -> str:
            return f"{100 * length / seams.length if seams.length > 0 else 0.0:>8.2f} %"

        measured, before = of["measured"], of["before"]
        lines = [
            f"{'patches':34}{of['patches']:>10}",
            f"{'pieces':34}{len(self):>10}",
            f"{'triangles':34}{len(self.faces):>10}",
            f"{'area of the largest piece':34}{100 * of['largest_area_share']:>8.2f} %",
            "",
            f"{'seams':34}{'mm':>10}",
            f"{'all':34}{seams.length:>10.1f}",
            f"{'closed':34}{seams.closed:>10.1f}{share(seams.closed)}",
            f"{'cut, for the curvature inside':34}{seams.holonomy:>10.1f}{share(seams.holonomy)}",
            f"{'cut, for the bound between pieces':34}{seams.bound:>10.1f}{share(seams.bound)}",
            f"{'cut, for overlaps':34}{seams.overlap:>10.1f}{share(seams.overlap)}",
            "",
            f"{'C, lengths':34}{'bound':>10}{'measured':>10}{'mean':>10}",
            f"{'patches':34}{before['certified_c']:>10.4f}{before['c']:>10.4f}",
            f"{'glued':34}{self.bound:>10.4f}{measured['c']:>10.4f}{measured['mean_c']:>10.4f}",
            "",
            f"{'piece':>6}{'triangles':>11}{'area, mm²':>12}{'C':>9}{'K':>9}",
        ]
        sizes = np.bincount(self.labels, minlength=len(self))
        for n, (area, c, k) in enumerate(self.measured[:_SHOWN].tolist()):
            lines.append(f"{n:>6}{sizes[n]:>11}{area:>12.4g}{c:>9.4f}{k:>9.4f}")
        if len(self) > _SHOWN:
            lines.append(f"{'...':>6}{len(self) - _SHOWN:>6} more")
        return "\n".join(lines)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the atlas to a file, all of it or nothing.

        Parameters
        ----------
        path : path
            Ends in .npz.

        Raises
        ------
        InputError
            If the path has another ending or cannot be written.
        """
        text = {
            "bound": self.bound,
            "certified": self.certified,
            "before": self.before,
            "seams": asdict(self.seams),
            "metadata": self.metadata,
        }
        save_pieces(path, _FORMAT, text, {name: getattr(self, name) for name in _ARRAYS})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> GluedAtlas:
        """Load an atlas that `save` wrote.

        Parameters
        ----------
        path : path
            An .npz file.

        Returns
        -------
        GluedAtlas

        Raises
        ------
        InputError
            If the file is damaged or is no glued atlas.
        FileNotFoundError
            If there is no such file.
        """
        text, arrays = load_pieces(path, _FORMAT, _ARRAYS)
        try:
            values: dict[str, Any] = {**arrays, **text, "seams": Seams(**text["seams"])}
            return cls(**values)
        except (KeyError, TypeError) as error:
            raise InputError(f"{path} is not a glued atlas of voxflat or is damaged") from error


_ARRAYS = ("points", "faces", "ids", "labels", "stretch", "starts", "vertices", "uv", "corners", "patches", "measured")


def _areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the areas of triangles in space, mm²."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(normals, axis=1))


def _edges(faces: NDArray[np.int64], corners: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each side of each triangle, the lesser vertex first, sorted; and the corners at its ends."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    rows = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], rows[turned] = ends[turned, ::-1], rows[turned, ::-1]
    order = np.lexsort(ends.T[::-1])
    return ends[order], rows[order]


def glue(atlas: FlatAtlas, bound: float, threads: int | None, progress: Progress | None) -> GluedAtlas:
    """Glue the patches of an atlas: see `FlatAtlas.glue`."""
    if not isinstance(bound, Real) or isinstance(bound, bool):
        raise InputError(f"bound is {bound!r}; give a number, the greatest factor by which lengths may change")
    threads = checked_threads(threads)
    core, turned, unused = _core.Surface.from_triangles(atlas.points, atlas.faces)
    if turned or unused or not np.array_equal(core.faces, atlas.faces):
        raise InputError("the atlas's triangles are no surface; make the patches again")
    flat = np.ascontiguousarray(atlas.uv[atlas.corners].reshape(-1, 6))
    found = core.glue(atlas.labels.astype(np.uint32), flat, float(bound), threads, progress)
    glued = GluedAtlas(
        points=atlas.points,
        faces=atlas.faces,
        ids=atlas.ids,
        labels=found["labels"].astype(np.int64),
        stretch=found["stretch"],
        starts=found["starts"].astype(np.int64),
        vertices=found["vertices"].astype(np.int64),
        uv=found["uv"],
        corners=found["corners"].astype(np.int64),
        metadata={**atlas.metadata, "glue": {"bound": float(bound)}},
        patches=atlas.labels,
        measured=found["measured"],
        bound=float(bound),
        certified=atlas.certificate.c,
        before=found["before"],
        seams=Seams(**found["seams"]),
    )
    log.info("%d patches are glued to %d pieces", len(atlas), len(glued))
    return glued


def load_atlas(path: str | os.PathLike[str]) -> FlatAtlas | GluedAtlas:
    """Load an atlas of patches, glued or not.

    Parameters
    ----------
    path : path
        An .npz file that `FlatAtlas.save` or `GluedAtlas.save` wrote.

    Returns
    -------
    FlatAtlas or GluedAtlas

    Raises
    ------
    InputError
        If the file is damaged or is no atlas.
    FileNotFoundError
        If there is no such file.
    """
    from voxflat.atlases.certified import FlatAtlas

    try:
        with np.load(Path(path), allow_pickle=False) as file:
            form = json.loads(str(file["text"]))["format"]
    except (FileNotFoundError, IsADirectoryError, PermissionError, MemoryError):
        raise
    except Exception as error:  # what damage leads to is known to no one
        raise InputError(f"{path} is not an atlas of voxflat or is damaged ({type(error).__name__})") from error
    return GluedAtlas.load(path) if form == _FORMAT else FlatAtlas.load(path)
