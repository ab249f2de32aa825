"""Glued patches: `FlatAtlas.glue` closes the seams between certified patches and returns a `GluedAtlas`."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_threads, is_number, log, shown
from voxflat.atlases.atlas import Atlas, figures_of
from voxflat.atlases.pieces import Piece
from voxflat.distortion.triangles import isometric, quasi_conformal
from voxflat.errors import InputError
from voxflat.io.grid import in_unit
from voxflat.maps.lines import edges_of
from voxflat.read_only import ReadOnly

_COLUMNS = {"piece": ">6", "triangles": ">11", "area, mm²": ">12.4g", "C": ">9.4f", "K": ">9.4f"}


@dataclass(frozen=True)
class Seams(ReadOnly):
    """The lengths of closed and open seams between patches, in mm on the surface.

    Each seam counts once.

    Parameters
    ----------
    length : float
        Length of all seams.
    closed : float
        Length of closed seams.
    holonomy : float
        Length of cuts inside a piece that cannot be closed because of the curvature around them: a triangle would
        exceed the bound.
    bound : float
        Length of cuts between pieces that could not be joined within the bound.
    overlap : float
        Length of cuts that prevent a piece from overlapping itself.

    See Also
    --------
    FlatAtlas.glue : Close the seams between patches.

    Examples
    --------
    >>> round(voxflat.samples.hill().patches(max_angle=20).glue(bound=1.5).seams.closed_share, 2)
    1.0
    """

    length: float
    closed: float
    holonomy: float
    bound: float
    overlap: float

    @property
    def cuts(self) -> float:
        """The length of the remaining cuts, in mm. It is the sum of `holonomy`, `bound` and `overlap`."""
        return self.holonomy + self.bound + self.overlap

    @property
    def closed_share(self) -> float:
        """The fraction of the total seam length that is closed. It is 1 if there are no seams."""
        return self.closed / self.length if self.length > 0 else 1.0

    def figures(self) -> dict[str, float]:
        """Return the lengths, in mm, and the closed share.

        Returns
        -------
        dict
            The figures by name.
        """
        return {**asdict(self), "cuts": self.cuts, "closed_share": self.closed_share}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GluedPiece(Piece):
    """A flat piece of a surface, made of several patches.

    Each item of a `GluedAtlas` is such a piece.

    Parameters
    ----------
    face_ids, vertex_ids, uv, faces : ndarray
        As in `FlatPatch`; a vertex on both sides of a cut has two rows.
    area, isometric, quasi_conformal : float
        As in `FlatPatch`.

    See Also
    --------
    GluedAtlas : A surface divided into glued pieces.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20).glue(bound=1.5)[0]
    <GluedPiece: 800 triangles, area 1740, C = 1.2047>
    """


@dataclass(frozen=True, eq=False, kw_only=True)
class GluedAtlas(Atlas[GluedPiece]):
    """A surface divided into glued flat pieces: a sequence of `GluedPiece`, from the largest to the smallest.

    `FlatAtlas.glue` returns it.

    Parameters
    ----------
    points, faces, ids, piece_ids, patch_ids, stretch, starts, vertex_ids, uv, uv_faces : ndarray
        As in `Atlas`; `patch_ids` holds the original patch of each triangle.
    origin : Origin
        The volume or the mesh of the surface.
    warnings : tuple of str
        Reasons to check the atlas, which were also logged.
    details, record : dict
        As in `Atlas`.
    measured : ndarray, shape (pieces, 3)
        Area, isometric and quasi_conformal of each piece.
    bound : float
        Upper bound on max(σ1, 1/σ2) for all triangles.
    certified_before : float
        C in the certificate of the patches, before gluing.
    measured_before : float
        Largest max(σ1, 1/σ2) measured in the patches, before gluing.
    seams : Seams
        Lengths of closed and open seams.

    See Also
    --------
    FlatAtlas : A surface divided into certified patches.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20).glue(bound=1.5)
    <GluedAtlas of 1 piece: 800 triangles, C ≤ 1.5, 100.0 % of the seams closed>
    """

    bound: float
    certified_before: float
    measured_before: float
    seams: Seams

    _format = "voxflat glued atlas 2"
    _arrays = (*Atlas._arrays, "patch_ids")

    def __repr__(self) -> str:
        closed = f"{100 * self.seams.closed_share:.1f} % of the seams closed"
        return f"<GluedAtlas of {_pieces(len(self))}: {len(self.faces)} triangles, C ≤ {self.bound:g}, {closed}>"

    def _piece(self, n: int) -> GluedPiece:
        return GluedPiece(**self._parts(n))

    def _title(self) -> str:
        closed = 100 * self.seams.closed_share
        patches = f"{self.patch_ids.max() + 1} patches in {_pieces(len(self))}"
        return f"{patches}, {closed:.1f} % of the seams closed, C ≤ {self.bound:g}"

    @cached_property
    def outline(self) -> NDArray[np.int64]:
        """The boundary edges of all pieces, including both sides of cuts, shape (edges, 2).

        Each edge is a pair of rows of `uv`.
        """
        edges, _, counts = edges_of(self.uv_faces, len(self.uv))
        return np.asarray(edges[counts == 1])

    @cached_property
    def cuts(self) -> NDArray[np.int64]:
        """The edges of the surface that remain cut, shape (cuts, 2). Each edge is a pair of rows of `points`."""
        edges, sides = _edges(self.faces, self.uv_faces)
        paired = (edges[1:] == edges[:-1]).all(axis=1)
        apart = paired & (sides[1:] != sides[:-1]).any(axis=1)
        return np.asarray(edges[1:][apart])

    def _figures(self) -> dict[str, Any]:
        return {
            "pieces": len(self),
            "patches": int(self.patch_ids.max()) + 1,
            **self._shares(),
            "seams": self.seams.figures(),
            "bound": self.bound,
            "before": {"certified_c": self.certified_before, "c": self.measured_before},
            "measured": measured(self.stretch, self.points[self.faces]),
        }

    def _lines(self) -> list[str]:
        measures, seams = self._figures(), self.seams

        def share(length: float) -> str:
            return f"{100 * length / seams.length if seams.length > 0 else 0.0:>8.2f} %"

        measured, before = measures["measured"], measures["before"]
        return [
            f"{'patches':34}{measures['patches']:>10}",
            f"{'pieces':34}{len(self):>10}",
            f"{'triangles':34}{len(self.faces):>10}",
            f"{'area of the largest piece':34}{100 * measures['largest_area_share']:>8.2f} %",
            "",
            f"{'seams':34}{in_unit('mm', self.origin.named_unit):>10}",
            f"{'all':34}{seams.length:>10.1f}",
            f"{'closed':34}{seams.closed:>10.1f}{share(seams.closed)}",
            f"{'cut because of curvature':34}{seams.holonomy:>10.1f}{share(seams.holonomy)}",
            f"{'cut because of the bound':34}{seams.bound:>10.1f}{share(seams.bound)}",
            f"{'cut to avoid overlap':34}{seams.overlap:>10.1f}{share(seams.overlap)}",
            "",
            f"{'C, lengths':34}{'bound':>10}{'measured':>10}{'mean':>10}",
            f"{'patches':34}{before['certified_c']:>10.4f}{before['c']:>10.4f}",
            f"{'glued':34}{self.bound:>10.4f}{measured['c']:>10.4f}{measured['mean_c']:>10.4f}",
            "",
            *self._largest(_COLUMNS, self.measured),
        ]

    def _text(self) -> dict[str, Any]:
        names = ("bound", "certified_before", "measured_before")
        return {**{name: getattr(self, name) for name in names}, "seams": asdict(self.seams)}

    @classmethod
    def _of_file(cls, text: dict[str, Any], fields: dict[str, Any]) -> "GluedAtlas":
        seams = Seams(**figures_of(text.pop("seams")))
        return cls(**fields, **figures_of(text), seams=seams)


def _pieces(count: int) -> str:
    return f"{count} piece{'s' * (count != 1)}"


def measured(stretch: NDArray[np.float64], corners: NDArray[np.float64]) -> dict[str, float]:
    """Return the maxima and area-weighted means of C and K, given σ1, σ2 and the 3D corners of the triangles."""
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    measures: dict[str, float] = {}
    for name, values in (("c", isometric(stretch)), ("k", quasi_conformal(stretch))):
        measures |= {name: float(values.max()), f"mean_{name}": float(values @ area / area.sum())}
    return measures


def _edges(faces: NDArray[np.int64], corners: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the sorted sides of all triangles, with the smaller vertex first, and the corners at their ends."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    rows = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], rows[turned] = ends[turned, ::-1], rows[turned, ::-1]
    order = np.lexsort(ends.T[::-1])
    return ends[order], rows[order]


def glue(atlas: Atlas, certified: float, bound: float, threads: int | None, progress: Progress | None) -> GluedAtlas:
    """Glue the patches of an atlas whose certificate is C ≤ `certified`; see `FlatAtlas.glue`."""
    if not is_number(bound):
        raise InputError(f"bound is {shown(bound)}. Pass the largest factor by which lengths may change")
    threads = checked_threads(threads)
    core, told = _core.Surface.from_triangles(atlas.points, atlas.faces)
    if told["turned"] or told["unused"] or not np.array_equal(core.faces, atlas.faces):
        raise InputError("the triangles of the atlas do not form a surface. Create the atlas again")
    flat = np.ascontiguousarray(atlas.uv[atlas.uv_faces].reshape(-1, 6))
    result = core.glue(atlas.piece_ids.astype(np.uint32), flat, float(bound), threads, progress)
    glued = GluedAtlas(
        points=atlas.points,
        faces=atlas.faces,
        ids=atlas.ids,
        piece_ids=result["labels"].astype(np.int64),
        stretch=result["stretch"],
        starts=result["starts"].astype(np.int64),
        vertex_ids=result["vertices"].astype(np.int64),
        uv=result["uv"],
        uv_faces=result["corners"].astype(np.int64),
        origin=atlas.origin,
        warnings=atlas.warnings,
        details={**atlas.details, "glue": {"bound": float(bound)}},
        record=atlas.record,
        patch_ids=atlas.piece_ids,
        measured=result["measured"],
        bound=float(bound),
        certified_before=certified,
        measured_before=result["before"],
        seams=Seams(**result["seams"]),
    )
    log.info("%d patches were glued into %s", len(atlas), _pieces(len(glued)))
    return glued
