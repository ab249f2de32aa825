"""Define coordinate spaces: scanner RAS, the space of volumes, and tkRAS, in which FreeSurfer stores its surfaces.

The origin of tkRAS (FreeSurfer's "surface RAS") is the centre of a volume. Its axes are defined as if the volume were
conformed, with voxel axes that point left, inferior and anterior. Let D be the direction cosines of the volume's axes
(columns xras, yras, zras), L those of a conformed volume, and c_ras the centre in scanner RAS. Then

    scanner RAS = D Lᵀ tkRAS + c_ras

The matrix equals vox2ras · inv(vox2ras_tkr) for any size and number of voxels. For a conformed volume, D = L, so only
c_ras is added. FreeSurfer writes D and c_ras to the surface file as its volume geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import array_of, checked_text, numbers_of, shown
from voxflat.errors import InputError
from voxflat.read_only import ReadOnly

_CONFORMED = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # the columns are left, inferior, anterior
_ROUNDING = 1e-3  # tolerance of direction cosines


@dataclass(frozen=True, eq=False)
class VolumeGeometry(ReadOnly):
    """Store FreeSurfer's volume geometry.

    It describes the volume whose centre is the origin of tkRAS.

    Parameters
    ----------
    cosines : ndarray, shape (3, 3)
        Directions of the volume axes in scanner RAS, as columns xras, yras, zras. They are orthonormal to within 1e-3.
    c_ras : ndarray, shape (3,)
        Centre of the volume in scanner RAS, in mm.
    shape : sequence of 3 ints
        Number of voxels along each axis.
    voxel_size : sequence of 3 floats
        Voxel size along each axis, in mm.
    filename : str
        File name of the volume.

    See Also
    --------
    Space : The space of the coordinates of a surface.

    Examples
    --------
    >>> geometry = voxflat.io.VolumeGeometry.of_volume(np.diag([1.0, 1.0, 1.0, 1.0]), (256, 256, 256))
    >>> geometry.c_ras
    array([128., 128., 128.])
    """

    cosines: NDArray[np.float64]
    c_ras: NDArray[np.float64]
    shape: Sequence[int] = (256, 256, 256)
    voxel_size: Sequence[float] = (1.0, 1.0, 1.0)
    filename: str = ""

    def __post_init__(self) -> None:
        shape, sizes = numbers_of(self.shape, "numbers of voxels"), numbers_of(self.voxel_size, "voxel sizes")
        if shape.shape != (3,) or sizes.shape != (3,) or not np.isfinite([shape, sizes]).all():
            raise InputError(f"shape is {shown(self.shape)} and voxel_size is {shown(self.voxel_size)}. Pass 3-tuples")
        checked_text(self.filename, "name of the volume's file")
        cosines, c_ras = (numbers_of(part, "axes and centre") for part in (self.cosines, self.c_ras))
        if cosines.shape != (3, 3) or c_ras.shape != (3,):
            raise InputError(f"cosines and c_ras have shapes {cosines.shape} and {c_ras.shape}, not (3, 3) and (3,)")
        if not np.isfinite(cosines).all() or np.abs(cosines.T @ cosines - np.eye(3)).max() > _ROUNDING:
            raise InputError(f"the axes of the volume, {cosines.T.tolist()}, are not orthonormal")
        if not np.isfinite(c_ras).all():
            raise InputError(f"c_ras, {c_ras.tolist()}, is not finite")
        object.__setattr__(self, "cosines", cosines)
        object.__setattr__(self, "c_ras", c_ras)
        object.__setattr__(self, "shape", tuple(int(n) for n in shape))
        object.__setattr__(self, "voxel_size", tuple(float(h) for h in sizes))
        super().__post_init__()

    @classmethod
    def conformed(cls, c_ras: ArrayLike = (0, 0, 0), filename: str = "") -> VolumeGeometry:
        """Return the geometry of a conformed volume.

        A conformed volume has 256³ voxels of 1 mm.

        Parameters
        ----------
        c_ras : array_like, shape (3,)
            Centre of the volume in scanner RAS, in mm.
        filename : str
            File name of the volume.

        Returns
        -------
        VolumeGeometry
            Geometry of the conformed volume.
        """
        return cls(_CONFORMED, numbers_of(c_ras, "coordinates of the centre"), filename=filename)

    @classmethod
    def of_volume(cls, affine: ArrayLike, shape: ArrayLike, filename: str = "") -> VolumeGeometry:
        """Return the geometry of a volume, or of the conformed volume with the same centre.

        If a volume and a conformed volume differ in orientation, the tkRAS of the volume would be rotated or mirrored.

        Parameters
        ----------
        affine : array_like, shape (4, 4)
            Affine from voxel indices to scanner RAS, in mm.
        shape : array_like, shape (3,)
            Number of voxels along each axis.
        filename : str
            File name of the volume.

        Returns
        -------
        VolumeGeometry
            Geometry of the volume itself if its axes point left, inferior and anterior, else of the conformed volume.
        """
        matrix, counts = numbers_of(affine, "affine"), array_of(shape, "numbers of voxels")
        sizes = np.linalg.norm(matrix[:3, :3], axis=0)
        c_ras = matrix[:3, :3] @ (counts / 2) + matrix[:3, 3]
        if np.abs(matrix[:3, :3] / sizes - _CONFORMED).max() > 1e-6:
            return cls.conformed(c_ras, filename)
        return cls(_CONFORMED, c_ras, tuple(counts.tolist()), tuple(sizes.tolist()), filename)

    @classmethod
    def _of_matrix(cls, matrix: ArrayLike) -> VolumeGeometry:
        """Return the geometry of a volume whose tkRAS is mapped to scanner RAS by a matrix."""
        whole = numbers_of(matrix, "matrix")
        return cls(whole[:3, :3] @ _CONFORMED, whole[:3, 3])

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Matrix from tkRAS to scanner RAS, of shape (4, 4).

        It is a rotation by the direction cosines, followed by a translation by c_ras.
        """
        whole = np.eye(4)
        whole[:3, :3] = self.cosines @ _CONFORMED.T
        whole[:3, 3] = self.c_ras
        return whole + 0.0  # avoid -0

    def _described(self) -> dict[str, Any]:
        axes = {axis: self.cosines[:, n].tolist() for n, axis in enumerate(("xras", "yras", "zras"))}
        sizes = {"volume": list(self.shape), "voxelsize": list(self.voxel_size)}
        return {"filename": self.filename, **sizes, **axes, "cras": self.c_ras.tolist()}

    def __repr__(self) -> str:
        return f"<VolumeGeometry: c_ras {_numbers(self.c_ras)} mm>"


@dataclass(frozen=True, eq=False)
class Space:
    """Describe the space of the coordinates of a surface.

    Coordinates in an unknown space are treated as scanner RAS.

    Parameters
    ----------
    name : {"scanner", "tkRAS", "unknown"}
        "scanner" is scanner RAS, the world space of volumes and templates. "tkRAS" is the surface space of FreeSurfer.
    volume : VolumeGeometry or None
        The volume that links scanner RAS and tkRAS; None if it is not known.
    warning : str
        Reason why this space is uncertain, for use in messages; empty if there is none.

    See Also
    --------
    VolumeGeometry : The volume that links both spaces.

    Examples
    --------
    >>> space = voxflat.io.Space("tkRAS", voxflat.io.VolumeGeometry.of_volume(np.eye(4), (256, 256, 256)))
    >>> space
    <Space: tkRAS: for scanner RAS add c_ras (128, 128, 128) mm>
    """

    name: str = "unknown"
    volume: VolumeGeometry | None = None
    warning: str = ""

    @classmethod
    def _of(cls, told: Mapping[str, Any] | None, kind: object) -> Space:
        """Return the space that a file describes; old files do not."""
        if told is None:
            return cls("scanner") if kind == "voxels" else UNKNOWN
        volume = told["volume"]
        if volume is not None:
            cosines = np.column_stack([volume[axis] for axis in ("xras", "yras", "zras")])
            volume = VolumeGeometry(cosines, volume["cras"], volume["volume"], volume["voxelsize"], volume["filename"])
        return cls(told["name"], volume, told["doubt"])

    def _described(self) -> dict[str, Any]:
        """Return the space as metadata, ready for JSON."""
        to_scanner = None if self._matrix is None else self._matrix.tolist()
        volume = None if self.volume is None else self.volume._described()
        return {"name": self.name, "to_scanner": to_scanner, "volume": volume, "doubt": self.warning}

    @property
    def _matrix(self) -> NDArray[np.float64] | None:
        if self.name == "scanner":
            return np.eye(4)
        return None if self.name != "tkRAS" or self.volume is None else self.volume.matrix

    @property
    def is_known(self) -> bool:
        """Whether the transformation to scanner RAS is known.

        For tkRAS, it is known if the volume geometry is known.
        """
        return self._matrix is not None

    def to_scanner(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transform points from this space to scanner RAS.

        Points are returned unchanged if the transformation is unknown.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in this space, in mm.

        Returns
        -------
        ndarray of float64, shape (..., 3)
            Points in scanner RAS, in mm.

        Examples
        --------
        >>> space = voxflat.io.Space("tkRAS", voxflat.io.VolumeGeometry.of_volume(np.eye(4), (256, 256, 256)))
        >>> space.to_scanner(np.zeros((1, 3)))
        array([[128., 128., 128.]])
        """
        return _carried(points, self._matrix)

    def from_scanner(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transform points from scanner RAS to this space.

        Points are returned unchanged if the transformation is unknown.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in scanner RAS, in mm.

        Returns
        -------
        ndarray of float64, shape (..., 3)
            Points in this space, in mm.
        """
        matrix = self._matrix
        return _carried(points, None if matrix is None else np.asarray(np.linalg.inv(matrix), dtype=np.float64))

    def to_tkras(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transform points from this space to tkRAS.

        Points are returned unchanged if the transformation is unknown.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in this space, in mm.

        Returns
        -------
        ndarray of float64, shape (..., 3)
            Points in tkRAS, mm.
        """
        if self.name != "scanner" or self.volume is None:
            return _carried(points, None)
        return _carried(points, np.asarray(np.linalg.inv(self.volume.matrix), dtype=np.float64))

    def __str__(self) -> str:
        if self.name == "scanner":
            return "scanner RAS"
        if self.name != "tkRAS":
            return "unknown, assumed to be scanner RAS"
        if self.volume is None:
            return "tkRAS with unknown c_ras: assumed to be scanner RAS"
        turned = "" if np.array_equal(self.volume.matrix[:3, :3], np.eye(3)) else ", after a rotation"
        return f"tkRAS: for scanner RAS add c_ras {_numbers(self.volume.c_ras)} mm{turned}"

    def __repr__(self) -> str:
        return f"<Space: {self}>"


UNKNOWN = Space()  # an unknown space is assumed to be scanner RAS


def _carried(points: ArrayLike, matrix: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Transform points by a matrix; the identity leaves every bit unchanged."""
    places = numbers_of(points, "points")
    if matrix is None or np.array_equal(matrix, np.eye(4)):
        return places
    return np.asarray(places @ matrix[:3, :3].T + matrix[:3, 3])


def _numbers(values: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
