"""Quasi-isometric patches with a certificate: a `FlatAtlas`, of `FlatPatch`es."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_path
from voxflat.atlases.atlas import Atlas, figures_of
from voxflat.atlases.glued import GluedAtlas
from voxflat.atlases.glued import glue as _glue
from voxflat.atlases.pieces import Piece
from voxflat.io.files import REMEDY, check_regular, from_json, holding, naming
from voxflat.io.provenance import telling
from voxflat.io.readers import read_arrays

_COLUMNS = (
    ("patch", ">6"),
    ("triangles", ">11"),
    ("area, mm²", ">12.4g"),
    ("degrees", ">9.2f"),
    ("C", ">9.4f"),
    ("K", ">9.4f"),
)


@dataclass(frozen=True)
class Certificate:
    """What is proven for every triangle.

    Parameters
    ----------
    angle : float
        No direction on the surface is inclined by more to its patch's plane, degrees.
    c : float
        No length changes by more than this factor: max(σ1, 1/σ2) ≤ C.
    k : float
        Maximal dilatation: σ1/σ2 ≤ K.

    Examples
    --------
    >>> patch = voxflat.samples.hill().patches(max_angle=20)[0]
    >>> patch.certificate
    Certificate(angle=20.0, c=1.3639702342662023, k=1.5929690551104496)
    """

    angle: float
    c: float
    k: float


@dataclass(frozen=True)
class Plane:
    """A plane in space, seen from the side to which its normal points.

    Parameters
    ----------
    origin : ndarray, shape (3,)
        What lies at (0, 0), RAS+ mm.
    normal : ndarray, shape (3,)
        Unit normal.
    axes : ndarray, shape (2, 3)
        Orthogonal unit vectors, the directions of u and v.

    Examples
    --------
    >>> patch = voxflat.samples.hill().patches(max_angle=20)[0]
    >>> patch.plane.normal.shape
    (3,)
    """

    origin: NDArray[np.float64]
    normal: NDArray[np.float64]
    axes: NDArray[np.float64]

    def __repr__(self) -> str:
        origin, normal = (", ".join(f"{x:.3g}" for x in vector) for vector in (self.origin, self.normal))
        return f"<Plane through ({origin}), normal ({normal})>"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FlatPatch(Piece):
    """A part of a surface in its plane.

    Parameters
    ----------
    face_ids : ndarray of int64, shape (G,)
        Its triangles, as rows of the atlas's `faces`.
    vertex_ids : ndarray of int64, shape (P,)
        Its vertices, as rows of the atlas's `points`.
    uv : ndarray, shape (P, 2)
        Their places in the plane, mm.
    faces : ndarray of int64, shape (G, 3)
        Its triangles, by rows of `uv`; counterclockwise.
    plane : Plane
        Onto which it is projected.
    certificate : Certificate
        What is proven for it.
    tilt : float
        The greatest inclination of a triangle to the plane, degrees.
    area : float
        On the surface, mm².
    isometric, quasi_conformal : float
        The greatest max(σ1, 1/σ2) and σ1/σ2 of its triangles, measured in the plane.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20)[0]
    <FlatPatch: 479 triangles, area 971.2, C = 1.0641>
    """

    plane: Plane
    certificate: Certificate
    tilt: float


@dataclass(frozen=True, eq=False, kw_only=True)
class FlatAtlas(Atlas, Sequence[FlatPatch]):
    """A surface as flat patches, from the largest to the smallest: a sequence of `FlatPatch`.

    Parameters
    ----------
    points, faces, ids, piece_ids, patch_ids, stretch, starts, vertex_ids, uv, uv_faces, metadata
        As of any `Atlas`; each piece is a patch.
    certificate : Certificate
        What is proven for all patches.
    planes : ndarray, shape (patches, 4, 3)
        Origin, normal, and the axes u and v of each patch's plane.
    measured : ndarray, shape (patches, 4)
        Tilt, area, isometric and quasi_conformal of each patch.

    Examples
    --------
    >>> atlas = voxflat.samples.hill().patches(max_angle=20)
    >>> len(atlas)
    8
    """

    certificate: Certificate
    planes: NDArray[np.float64]

    _format = "voxflat atlas 3"
    _arrays = (*Atlas._arrays, "planes")

    def __repr__(self) -> str:
        return (
            f"<FlatAtlas of {len(self)} patches: {len(self.faces)} triangles, "
            f"C ≤ {self.certificate.c:.4f}, K ≤ {self.certificate.k:.4f}>"
        )

    def _piece(self, n: int) -> FlatPatch:
        origin, normal, *axes = self.planes[n]
        return FlatPatch(
            **self._parts(n),
            plane=Plane(origin, normal, np.stack(axes)),
            certificate=self.certificate,
            tilt=float(self.measured[n, 0]),
        )

    @property
    def patches(self) -> list[FlatPatch]:
        """The patches, from the largest to the smallest."""
        return list(self)

    def figures(self) -> dict[str, Any]:
        """Return the figures by their names, ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.figures()['patches']
        8
        """
        tilt, area, isometric, quasi_conformal = self.measured.T
        return {
            "patches": len(self),
            **self._shares(),
            "half_of_the_area": int(np.searchsorted(np.cumsum(area), 0.5 * area.sum()) + 1),
            "certificate": asdict(self.certificate),
            "measured": {
                "angle": float(tilt.max()),
                "c": float(isometric.max()),
                "k": float(quasi_conformal.max()),
                "mean_c": float(area @ isometric / area.sum()),
            },
            "broken": int(self.broken.sum()),
        }

    @property
    def title(self) -> str:
        """One line of what it is, for pictures."""
        of = self.certificate
        return f"{len(self)} patches, {len(self.faces)} triangles, C ≤ {of.c:.4f}, K ≤ {of.k:.4f}"

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Which triangles are measured beyond the certificate, shape (F,): so thin ones that rounding does it."""
        held = (self.isometric <= self.certificate.c) & (self.quasi_conformal <= self.certificate.k)
        return np.asarray(~held)

    def table(self) -> str:
        """Return certificates and measured figures as a table of text.

        Returns
        -------
        str

        Examples
        --------
        >>> print(voxflat.samples.hill().patches(max_angle=20).table().splitlines()[0])
        patches                            8
        """
        of, certified = self.figures(), self.certificate
        measured = of["measured"]
        lines = [
            f"{'patches':26}{len(self):>10}",
            f"{'triangles':26}{len(self.faces):>10}",
            f"{'patches of one triangle':26}{of['single_triangles']:>10}",
            f"{'patches of half the area':26}{of['half_of_the_area']:>10}",
            "",
            f"{'':26}{'certified':>10}{'measured':>10}",
            f"{'inclination, degrees':26}{certified.angle:>10.2f}{measured['angle']:>10.2f}",
            f"{'C, lengths':26}{certified.c:>10.4f}{measured['c']:>10.4f}",
            f"{'K, angles':26}{certified.k:>10.4f}{measured['k']:>10.4f}",
            "",
            *self._largest(_COLUMNS, self.measured[:, [1, 0, 2, 3]]),
        ]
        return "\n".join(lines)

    @telling()
    def glue(self, bound: float = 1.5, *, threads: int | None = None, progress: Progress | None = None) -> GluedAtlas:
        """Close the seams between the patches, as far as that is possible within a bound on C.

        Neighbouring patches are laid out so that the edges they share meet, and moved until the distortion is least.
        Every triangle keeps max(σ1, 1/σ2) ≤ `bound`, none is turned over, and no piece lies on itself. Where that
        cannot be, a seam stays cut, and pieces stay apart. A surface that can be made flat without distortion is.

        Parameters
        ----------
        bound : float
            The greatest factor by which lengths may change, above 1 and at most 10.
        threads, progress
            As in `surface`.

        Returns
        -------
        GluedAtlas
            The same for any number of threads and any numbering of vertices and triangles, but for the order of arrays.

        Raises
        ------
        InputError
            If the bound does not fit, or the patches themselves are beyond it.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> glued = voxflat.samples.hill().patches(max_angle=20).glue(bound=1.5)
        >>> glued
        <GluedAtlas of 1 pieces: 800 triangles, C ≤ 1.5, 100.0 % of the seams closed>
        """
        return _glue(self, self.certificate.c, bound, threads, progress)

    def _text(self) -> dict[str, Any]:
        return {"certificate": asdict(self.certificate)}

    @classmethod
    def _of_file(cls, text: dict[str, Any], arrays: dict[str, Any]) -> "FlatAtlas":
        certificate = Certificate(**figures_of(text.pop("certificate")))
        return cls(**arrays, patch_ids=arrays["piece_ids"], certificate=certificate, **text)


def load_atlas(path: str | os.PathLike[str]) -> FlatAtlas | GluedAtlas:
    """Load an atlas of patches, glued or not.

    Parameters
    ----------
    path : path
        An .npz or .voxflat file that `FlatAtlas.save` or `GluedAtlas.save` wrote.

    Returns
    -------
    FlatAtlas or GluedAtlas

    Raises
    ------
    InputError
        If the file is damaged or is no atlas.
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20).save("atlas.npz")
    >>> voxflat.load_atlas("atlas.npz")
    <FlatAtlas of 8 patches: 800 triangles, C ≤ 1.3640, K ≤ 1.5930>
    """
    with naming(path, REMEDY):
        check_regular(checked_path(path))
    with holding(path, "an atlas"):
        form = from_json(str(read_arrays(path, ["text"])["text"]))["format"]
    return GluedAtlas.load(path) if form == GluedAtlas._format else FlatAtlas.load(path)


def saved_kind(path: str | os.PathLike[str]) -> Literal["map", "atlas"] | None:
    """Say what a file holds that `FlatMap.save` or an atlas wrote; None if it is neither or cannot be read."""
    try:
        with np.load(path, allow_pickle=False) as file:
            names = set(file.files)
    except Exception:  # what damage leads to is known to no one
        return None
    if {"uv", "ids", "metadata"} <= names:
        return "map"
    return "atlas" if {"uv", "uv_faces", "text"} <= names else None
