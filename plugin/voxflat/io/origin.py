"""Where a surface comes from: the voxels of a volume, or the vertices of a mesh."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import is_whole
from voxflat.errors import InputError
from voxflat.io.descriptions import check_description
from voxflat.io.files import AGAIN
from voxflat.io.spaces import UNKNOWN, Space


@dataclass(frozen=True, eq=False, kw_only=True)
class Origin(ABC):
    """Where the points of a surface, a map or an atlas come from: a ``VoxelOrigin`` or a ``MeshOrigin``.

    Those made from a volume also hold ``affine``, ``shape``, ``label``, ``threshold``, ``foreground`` (the number of
    voxels) and ``is_sheet``; those made from a mesh hold ``vertices`` (their number), ``merged`` and ``grid``.

    Parameters
    ----------
    input : str or None
        The file; None for objects in memory.
    input_sha256 : str
        SHA-256 of the foreground or of the points and triangles.
    space : Space
        The space of the points.
    unit : str
        The unit of length of the points; "unknown" if it is not known.
    structure : str or None
        The hemisphere in GIFTI notation, such as "CortexLeft".
    measured_on : str or None
        The surface whose distances are preserved.
    has_known_axes : bool
        Whether the axes of the points are known; those of a mesh may be as in its file.
    in_pixels : bool
        Whether the user knows lengths as pixels, because the volume has no unit.
    frame : int or None
        The frame of a series to which the points belong, if it is not the flattened one.

    See Also
    --------
    voxflat.surface : Make a surface from any input.

    Examples
    --------
    >>> voxflat.samples.hill().origin.unit
    'mm'
    >>> voxflat.surface(voxflat.samples.ball(), label=3).origin.voxels.shape
    (24, 24, 24)
    """

    input: str | None = None
    input_sha256: str = ""
    space: Space = UNKNOWN
    unit: str = "mm"
    structure: str | None = None
    measured_on: str | None = None
    has_known_axes: bool = True
    in_pixels: bool = False
    frame: int | None = None

    @property
    def voxels(self) -> VoxelOrigin:
        """The same origin, if it is a volume. A mesh raises an `InputError`."""
        if not isinstance(self, VoxelOrigin):
            raise InputError("a mesh has no voxels. Pass a surface or a map that was made from a volume")
        return self

    @property
    def mesh(self) -> MeshOrigin:
        """The same origin, if it is a mesh. A volume raises an `InputError`."""
        if not isinstance(self, MeshOrigin):
            raise InputError("a volume has no vertices. Pass a surface or a map that was made from a mesh")
        return self

    @property
    def is_voxels(self) -> bool:
        """Whether the origin is a volume."""
        return isinstance(self, VoxelOrigin)

    @property
    @abstractmethod
    def size(self) -> int | tuple[int, int, int]:
        """The number of vertices of the mesh, or the shape of the volume."""

    @property
    def named_unit(self) -> str:
        """The unit for texts: "unknown" for pixels, whose lengths have none."""
        return "unknown" if self.in_pixels else self.unit

    def _described(self) -> dict[str, Any]:
        """Return the origin as metadata, ready for JSON; `take_origin` is the inverse."""
        told: dict[str, Any] = {"input": self.input, "input_sha256": self.input_sha256}
        told["space"] = self.space._described()
        told |= {} if self.unit == "mm" else {"unit": self.unit}
        told |= {} if self.has_known_axes else {"axes": "unknown"}
        told |= {} if self.measured_on is None else {"measured_on": self.measured_on}
        return told | ({} if self.frame is None else {"series_frame": self.frame})


@dataclass(frozen=True, eq=False, kw_only=True)
class VoxelOrigin(Origin):
    """The voxels of a volume, from which a surface was made.

    Surfaces, maps and atlases hold it as ``origin``.

    Parameters
    ----------
    affine : ndarray of float64, shape (4, 4)
        From voxel indices to RAS+ in `unit`.
    shape : tuple of 3 ints
        The shape of the volume.
    label : int, list of int or None
        The labels that were selected.
    threshold : float or None
        The threshold that was applied.
    foreground : int or None
        The number of selected voxels.
    is_sheet : bool or None
        Whether the surface is the middle of a one-voxel-thick sheet; None if it is not known yet.
    """

    affine: NDArray[np.float64]
    shape: tuple[int, int, int]
    label: Any = None
    threshold: float | None = None
    foreground: int | None = None
    is_sheet: bool | None = None

    @property
    def size(self) -> tuple[int, int, int]:
        """The shape of the volume."""
        return self.shape

    def _described(self) -> dict[str, Any]:
        """Return the origin as metadata, ready for JSON."""
        own: dict[str, Any] = {"kind": "voxels", "shape": list(self.shape), "affine": self.affine.tolist()}
        own |= {"label": self.label, "threshold": self.threshold, "foreground": self.foreground}
        return super()._described() | own | ({} if self.is_sheet is None else {"sheet": self.is_sheet})


def _no_pairs() -> NDArray[np.int64]:
    return np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True)
class PixelGrid:
    """The pixels of a range image: rows and columns, and the distances between them."""

    shape: tuple[int, int]
    spacing: tuple[float, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshOrigin(Origin):
    """The vertices of a mesh, from which a surface was made.

    Surfaces, maps and atlases hold it as ``origin``.

    Parameters
    ----------
    vertices : int
        The number of vertices of the mesh, including those without a triangle.
    merged : ndarray of int64, shape (M, 2)
        Pairs of vertices: a vertex, and the vertex at the same position that replaces it.
    grid : PixelGrid or None
        The pixels of a range image, which are the vertices.
    """

    vertices: int
    merged: NDArray[np.int64] = field(default_factory=_no_pairs)
    grid: PixelGrid | None = None

    @property
    def size(self) -> int:
        """The number of vertices of the mesh."""
        return self.vertices

    def _described(self) -> dict[str, Any]:
        """Return the origin as metadata, ready for JSON."""
        own = {"kind": "mesh", "vertices": self.vertices, "structure": self.structure}
        return super()._described() | own


def take_origin(metadata: dict[str, Any], ids: NDArray[np.int64]) -> Origin:
    """Take the origin out of the metadata of a file, and check it against the ids of the points."""
    check_description(metadata)
    kind = metadata.pop("kind", None)
    common: dict[str, Any] = {
        "input": metadata.pop("input", None),
        "input_sha256": str(metadata.pop("input_sha256", "")),
        "space": Space._of(metadata.pop("space", None), kind),
        "unit": str(metadata.pop("unit", "mm")),
        "structure": metadata.pop("structure", None),
        "measured_on": metadata.pop("measured_on", None),
        "has_known_axes": metadata.pop("axes", None) is None,
        "in_pixels": str(metadata.get("napari", {}).get("unit", "")).startswith("pixel"),
        "frame": metadata.pop("series_frame", None),
    }
    made: Origin
    if kind == "voxels":
        shape, affine = _shape(metadata.pop("shape", None)), _affine(metadata.pop("affine", None))
        common |= {name: metadata.pop(name, None) for name in ("label", "threshold", "foreground")}
        made = VoxelOrigin(**common, affine=affine, shape=shape, is_sheet=metadata.pop("sheet", None))
        most, width = np.array(shape), 3
    elif kind == "mesh":
        vertices = metadata.pop("vertices", None)
        if not (is_whole(vertices) and 0 < vertices < 2**31):
            raise InputError(f"its number of vertices is not valid: {vertices!r:.80}. {AGAIN}")
        grid = metadata.get("range_image")
        made = MeshOrigin(
            **common,
            vertices=int(vertices),
            merged=np.asarray(metadata.get("mended", {}).get("merged", []), dtype=np.int64).reshape(-1, 2),
            grid=None if grid is None else PixelGrid(tuple(grid["shape"]), tuple(grid["spacing"])),
        )
        most, width = np.array(vertices), 1
    else:
        raise InputError(f"its kind is {kind!r:.80} instead of 'voxels' or 'mesh'. {AGAIN}")
    if ids.size != width * len(ids) or (ids < 0).any() or (ids >= most).any():
        raise InputError(f"its ids are outside the range from 0 to {(most - 1).tolist()}. {AGAIN}")
    return made


def _shape(told: Any) -> tuple[int, int, int]:
    if not (isinstance(told, list) and len(told) == 3 and all(is_whole(n) and 0 < n < 2**31 for n in told)):
        raise InputError(f"the shape of its volume is not valid: {told!r:.80}. {AGAIN}")
    i, j, k = map(int, told)
    return (i, j, k)


def _affine(told: Any) -> NDArray[np.float64]:
    try:
        matrix = np.asarray(told, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InputError(f"the affine of its volume is not valid: {told!r:.80}. {AGAIN}")
    return matrix
