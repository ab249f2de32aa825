"""Quasi-isometric patches with a certificate: `FlatAtlas` and `FlatPatch`."""

import os
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
from voxflat.io.provenance import recording
from voxflat.io.readers import read_arrays
from voxflat.read_only import ReadOnly

_COLUMNS = {"patch": ">6", "triangles": ">11", "area, mm²": ">12.4g", "degrees": ">9.2f", "C": ">9.4f", "K": ">9.4f"}


@dataclass(frozen=True)
class Certificate:
    """Bounds that are proven for every triangle of an atlas.

    Measured values do not exceed them, except by rounding errors.

    Parameters
    ----------
    angle : float
        Largest angle between a direction on the surface and the plane of its patch, in degrees.
    c : float
        Largest factor by which lengths change: max(σ1, 1/σ2) ≤ C.
    k : float
        Maximal dilatation: σ1/σ2 ≤ K.

    See Also
    --------
    Surface.patches : Make certified patches.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20)[0].certificate
    Certificate(angle=20.0, c=1.3639702342662023, k=1.5929690551104496)
    """

    angle: float
    c: float
    k: float


@dataclass(frozen=True)
class Plane(ReadOnly):
    """A plane in 3D, viewed from the side to which its normal points.

    Each certified patch is projected onto such a plane.

    Parameters
    ----------
    origin : ndarray, shape (3,)
        The point at (u, v) = (0, 0), in RAS+ mm.
    normal : ndarray, shape (3,)
        Unit normal.
    axes : ndarray, shape (2, 3)
        Orthogonal unit vectors in the directions of u and v.

    See Also
    --------
    FlatPatch : A part of a surface in its plane.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20)[0].plane.normal.shape
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
    """A part of a surface, projected onto a plane.

    Each item of a `FlatAtlas` is such a patch.

    Parameters
    ----------
    face_ids : ndarray of int64, shape (G,)
        Triangles of the patch, as rows of the atlas's `faces`.
    vertex_ids : ndarray of int64, shape (P,)
        Vertices of the patch, as rows of the atlas's `points`.
    uv : ndarray, shape (P, 2)
        Positions of the vertices in the plane, in mm.
    faces : ndarray of int64, shape (G, 3)
        The same triangles as rows of `uv`, counterclockwise.
    area : float
        Area on the surface, mm².
    isometric, quasi_conformal : float
        Largest max(σ1, 1/σ2) and largest σ1/σ2 of the triangles, measured in the plane.
    plane : Plane
        The plane onto which the patch is projected.
    certificate : Certificate
        The bounds that are proven for the patch.
    tilt : float
        Largest angle between a triangle and the plane, in degrees.

    See Also
    --------
    FlatAtlas : A surface divided into flat patches.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20)[0]
    <FlatPatch: 479 triangles, area 971.2, C = 1.0641>
    """

    plane: Plane
    certificate: Certificate
    tilt: float


@dataclass(frozen=True, eq=False, kw_only=True)
class FlatAtlas(Atlas[FlatPatch]):
    """A surface divided into certified flat patches: a sequence of `FlatPatch`, from the largest to the smallest.

    `Surface.patches` returns it.

    Parameters
    ----------
    points, faces, ids, piece_ids, patch_ids, stretch, starts, vertex_ids, uv, uv_faces : ndarray
        As in `Atlas`; each piece is a patch.
    origin : Origin
        The volume or the mesh of the surface.
    warnings : tuple of str
        Reasons to check the atlas, which were also logged.
    details, record : dict
        As in `Atlas`.
    measured : ndarray, shape (patches, 4)
        Tilt, area, isometric and quasi_conformal of each patch.
    certificate : Certificate
        The bounds that are proven for all patches.
    planes : ndarray, shape (patches, 4, 3)
        Origin, normal, u axis and v axis of each patch's plane.

    See Also
    --------
    GluedAtlas : Patches that are glued into larger pieces.

    Examples
    --------
    >>> len(voxflat.samples.hill().patches(max_angle=20))
    8
    """

    certificate: Certificate
    planes: NDArray[np.float64]

    _format = "voxflat atlas 3"
    _arrays = (*Atlas._arrays, "planes")

    def __repr__(self) -> str:
        bounds = f"C ≤ {self.certificate.c:.4f}, K ≤ {self.certificate.k:.4f}"
        return f"<FlatAtlas of {len(self)} patches: {len(self.faces)} triangles, {bounds}>"

    def _piece(self, n: int) -> FlatPatch:
        origin, normal, *axes = self.planes[n]
        plane, tilt = Plane(origin, normal, np.stack(axes)), float(self.measured[n, 0])
        return FlatPatch(**self._parts(n), plane=plane, certificate=self.certificate, tilt=tilt)

    @property
    def patches(self) -> list[FlatPatch]:
        """The patches, from the largest to the smallest. The atlas itself is also a sequence of these patches."""
        return list(self)

    def _figures(self) -> dict[str, Any]:
        tilt, area, isometric, quasi_conformal = self.measured.T
        measured = {"angle": float(tilt.max()), "c": float(isometric.max()), "k": float(quasi_conformal.max())}
        return {
            "patches": len(self),
            **self._shares(),
            "half_of_the_area": int(np.searchsorted(np.cumsum(area), 0.5 * area.sum()) + 1),
            "certificate": asdict(self.certificate),
            "measured": {**measured, "mean_c": float(area @ isometric / area.sum())},
            "broken": int(self.broken.sum()),
        }

    def _title(self) -> str:
        certificate = self.certificate
        return f"{len(self)} patches, {len(self.faces)} triangles, C ≤ {certificate.c:.4f}, K ≤ {certificate.k:.4f}"

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Whether the measured distortion of each triangle exceeds the certificate, shape (F,).

        Only rounding errors in very thin triangles can cause this.
        """
        held = (self.isometric <= self.certificate.c) & (self.quasi_conformal <= self.certificate.k)
        return np.asarray(~held)

    def _lines(self) -> list[str]:
        measures, certified = self._figures(), self.certificate
        measured = measures["measured"]
        return [
            f"{'patches':26}{len(self):>10}",
            f"{'triangles':26}{len(self.faces):>10}",
            f"{'patches of one triangle':26}{measures['single_triangles']:>10}",
            f"{'patches with half the area':26}{measures['half_of_the_area']:>10}",
            "",
            f"{'':26}{'certified':>10}{'measured':>10}",
            f"{'inclination, degrees':26}{certified.angle:>10.2f}{measured['angle']:>10.2f}",
            f"{'C, lengths':26}{certified.c:>10.4f}{measured['c']:>10.4f}",
            f"{'K, angles':26}{certified.k:>10.4f}{measured['k']:>10.4f}",
            "",
            *self._largest(_COLUMNS, self.measured[:, [1, 0, 2, 3]]),
        ]

    @recording()
    def glue(self, bound: float = 1.5, *, threads: int | None = None, progress: Progress | None = None) -> GluedAtlas:
        """Close the seams between the patches as far as a bound on C allows.

        Neighbouring patches are joined along their common edges, and their vertices are moved to minimise distortion.
        Every triangle keeps max(σ1, 1/σ2) ≤ `bound`, no triangle is flipped, and no piece overlaps itself. Where this
        is not possible, the seam remains cut. A developable surface is flattened without distortion.

        Parameters
        ----------
        bound : float
            Largest factor by which lengths may change, above 1 and at most 10.
        threads : int, optional
            As in `surface`.
        progress : callable, optional
            As in `surface`.

        Returns
        -------
        GluedAtlas
            The pieces. They do not depend on the number of threads. The numbering of vertices and triangles affects
            only the order of the arrays.

        Raises
        ------
        InputError
            If the bound is invalid, or the patches themselves exceed it.
        Cancelled
            If `progress` returned False.

        See Also
        --------
        voxflat.methods.Saucan2006 : Make one flat map of glued patches.

        Examples
        --------
        >>> voxflat.samples.hill().patches(max_angle=20).glue(bound=1.5)
        <GluedAtlas of 1 piece: 800 triangles, C ≤ 1.5, 100.0 % of the seams closed>
        """
        return _glue(self, self.certificate.c, bound, threads, progress)

    def _text(self) -> dict[str, Any]:
        return {"certificate": asdict(self.certificate)}

    @classmethod
    def _of_file(cls, text: dict[str, Any], fields: dict[str, Any]) -> "FlatAtlas":
        certificate = Certificate(**figures_of(text.pop("certificate")))
        return cls(**fields, patch_ids=fields["piece_ids"], certificate=certificate)


def load_atlas(path: str | os.PathLike[str]) -> FlatAtlas | GluedAtlas:
    """Load an atlas of certified or glued patches.

    The file determines the class of the result.

    Parameters
    ----------
    path : path
        An .npz or .voxflat file that was written by `FlatAtlas.save` or `GluedAtlas.save`.

    Returns
    -------
    FlatAtlas or GluedAtlas
        The atlas.

    Raises
    ------
    InputError
        If the file is damaged or is not an atlas.
    FileNotFoundError
        If there is no such file.

    See Also
    --------
    Atlas.save : Save an atlas.

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
    is_glued = str(form).rpartition(" ")[0] == GluedAtlas._format.rpartition(" ")[0]  # of any version
    return GluedAtlas.load(path) if is_glued else FlatAtlas.load(path)


def saved_kind(path: str | os.PathLike[str]) -> Literal["map", "series", "atlas"] | None:
    """Return the kind of a file that voxflat wrote; None for other or unreadable files."""
    try:
        with np.load(path, allow_pickle=False) as file:
            names = set(file.files)
    except Exception:  # damaged files raise many kinds of errors
        return None
    if {"uv", "ids", "metadata"} <= names:
        return "series" if "series_points" in names else "map"
    return "atlas" if {"uv", "uv_faces", "text"} <= names else None
