"""What every atlas can do, whoever made its pieces: a page, a sequence of pieces, figures, a file."""

import importlib
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_choice, checked_number, checked_path, is_number, shown
from voxflat.atlases.layout import PACKINGS, lay_out, usual_gap
from voxflat.atlases.page import FlatPage
from voxflat.atlases.pieces import FlatPieces
from voxflat.errors import InputError
from voxflat.io.files import (
    AGAIN,
    SAVED_ENDINGS,
    atomic_path,
    check_places,
    check_range,
    check_regular,
    check_shapes,
    from_json,
    holding,
    in_types,
    naming,
)
from voxflat.io.grid import FARTHEST, in_unit
from voxflat.io.notebook import page
from voxflat.io.provenance import Record, as_text, saving
from voxflat.io.readers import read_arrays
from voxflat.io.reading import note
from voxflat.maps.raster import FlatImage, FlatStack
from voxflat.maps.sampler import check_origin

_SHOWN = 12  # pieces in a table
_ARRAYS = ("points", "faces", "ids", "piece_ids", "stretch", "starts", "vertex_ids", "uv", "uv_faces", "measured")

Own = TypeVar("Own", bound="Atlas")


@dataclass(frozen=True, eq=False, kw_only=True)
class Atlas(FlatPieces, ABC):
    """A surface as flat pieces, from the largest to the smallest: a sequence of them, `FlatAtlas` or `GluedAtlas`.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        The surface's vertices, RAS+ mm in `space`.
    faces : ndarray of int64, shape (F, 3)
        Its triangles.
    ids : ndarray of int64, shape (N, 3) or (N,)
        What each vertex is in the input: voxel indices, or the number of a vertex.
    piece_ids : ndarray of int64, shape (F,)
        The piece of each triangle.
    patch_ids : ndarray of int64, shape (F,)
        The certified patch of each triangle: another than the piece where patches are glued.
    stretch : ndarray, shape (F, 2)
        σ1 ≥ σ2 of each triangle, measured in the plane.
    starts : ndarray of int64, shape (pieces + 1,)
        Where the rows of each piece begin in `vertex_ids` and `uv`.
    vertex_ids : ndarray of int64, shape (P,)
        What each row of `uv` is, as a row of `points`, one piece after another; a vertex that lies on both sides of a
        cut within a piece is there twice.
    uv : ndarray, shape (P, 2)
        Places in the plane, each piece in one of its own, mm.
    uv_faces : ndarray of int64, shape (F, 3)
        The corners of each triangle as rows of `uv`, in the order of `faces`; counterclockwise.
    metadata : dict
        How it was made, and of what: ``kind`` ("voxels" or "mesh"), and of voxels ``affine`` and ``shape``, of a mesh
        ``vertices``, their number; the ``space`` of the points.
    measured : ndarray, shape (pieces, K)
        Figures of each piece, by columns; the last three are area, isometric and quasi_conformal.

    Examples
    --------
    >>> atlas = voxflat.samples.hill().patches(max_angle=20)
    >>> atlas
    <FlatAtlas of 8 patches: 800 triangles, C ≤ 1.3640, K ≤ 1.5930>
    """

    measured: NDArray[np.float64]

    _format: ClassVar[str]  # name and version of its files
    _arrays: ClassVar[tuple[str, ...]] = _ARRAYS  # what its files hold beside text

    @property
    @abstractmethod
    def title(self) -> str:
        """One line of what it is, for pictures."""

    # -------------------------------------------------------------------------------- as a sequence

    def __getitem__(self, number: Any) -> Any:
        """Return a piece, or several for a slice."""
        if isinstance(number, slice):
            return [self._piece(n) for n in range(*number.indices(len(self)))]
        return self._piece(range(len(self))[number])

    def __iter__(self) -> Iterator[Any]:
        """Yield the pieces."""
        return (self._piece(n) for n in range(len(self)))

    @abstractmethod
    def _piece(self, n: int) -> Any:
        """Return a piece."""

    def _parts(self, n: int) -> dict[str, Any]:
        """Return what every piece has, by the fields of `Piece`."""
        rows = slice(self.starts[n], self.starts[n + 1])
        face_ids = self._faces_by_piece[n]
        area, isometric, quasi_conformal = self.measured[n, -3:].tolist()
        return {
            "face_ids": face_ids,
            "vertex_ids": self.vertex_ids[rows],
            "uv": self.uv[rows],
            "faces": self.uv_faces[face_ids] - self.starts[n],
            "area": area,
            "isometric": isometric,
            "quasi_conformal": quasi_conformal,
        }

    @cached_property
    def _faces_by_piece(self) -> list[NDArray[np.int64]]:
        order = np.argsort(self.piece_ids, kind="stable")
        return np.split(order, np.searchsorted(self.piece_ids[order], np.arange(1, len(self))))

    # ----------------------------------------------------------------------------------- on a page

    @cached_property
    def _pages(self) -> dict[tuple[float, str], FlatPage]:
        return {}

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

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.page()
        <FlatPage: 8 pieces, 55 x 71, 44 % of it used>
        """
        chosen = usual_gap(self.uv, self.starts) if gap is None else checked_number(gap, "gap")
        key = (chosen, checked_choice(packing, "packing", PACKINGS))
        if key not in self._pages:
            self._pages[key] = FlatPage(self, lay_out(self.uv, self.starts, self.uv_faces, chosen, packing), chosen)
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

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.layout().shape
        (559, 2)
        """
        return self.page(gap, packing=packing).uv

    def image(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        channel: int | str | None = None,
        depth: float | Sequence[float] = 0.0,
        interpolation: str | None = None,
        period: float | None = None,
        name: str = "",
    ) -> FlatImage:
        """Sample a volume onto the page: `page` and `FlatPage.image` in one.

        Parameters
        ----------
        volume, pixel_size, channel, depth, interpolation, period, name
            As in `FlatMap.image`; an atlas knows no pial surface.

        Returns
        -------
        FlatImage
            NaN (colours: alpha 0) beside the pieces and where the volume has no value.

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.image(np.arange(441.0))
        <FlatImage: overlay, 116 x 151 pixels of 0.477758>
        """
        how: dict[str, Any] = {"depth": depth, "interpolation": interpolation, "period": period, "name": name}
        return self.page().image(volume, pixel_size, channel=channel, **how)

    def images(
        self,
        volume: object,
        pixel_size: float | None = None,
        *,
        channel: int | str | None = None,
        depth: float | Sequence[float] = 0.0,
        average: bool = False,
        interpolation: str | None = None,
        period: float | None = None,
        time_step: float | None = None,
        name: str = "",
    ) -> FlatStack:
        """Sample a volume at several depths, all maps of a file, or a series of volumes, onto the page.

        Parameters
        ----------
        volume, pixel_size, channel, depth, average, interpolation, period, time_step, name
            As in `FlatMap.images`.

        Returns
        -------
        FlatStack

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> len(atlas.images(np.ones((441, 3))))
        3
        """
        how: dict[str, Any] = {"depth": depth, "average": average, "interpolation": interpolation, "name": name}
        how |= {"period": period, "time_step": time_step}
        return self.page().images(volume, pixel_size, channel=channel, **how)

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

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.heat_map(pixel_size=1.0)
        <FlatImage: C: by what factor lengths change at most, 56 x 73 pixels of 1>
        """
        return self.page().heat_map(pixel_size, of=of)

    # ------------------------------------------------------------------------------------- figures

    @abstractmethod
    def figures(self) -> dict[str, Any]:
        """Return the figures by their names, ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> sorted(atlas.figures())[:3]
        ['area', 'broken', 'certificate']
        """

    def _repr_html_(self) -> str:
        """Return the page and the table of the pieces, for Jupyter."""
        figure = importlib.import_module("voxflat.figures").atlas_page(self)  # it stands above atlases
        return page(self, self.table(), figure, "The pieces side by side, one colour per patch")

    @abstractmethod
    def table(self) -> str:
        """Return the figures as a table of text.

        Returns
        -------
        str

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> print(atlas.table().splitlines()[0])
        patches                            8
        """

    @property
    def _sizes(self) -> NDArray[np.int64]:
        """How many triangles each piece has."""
        return np.bincount(self.piece_ids, minlength=len(self))

    def _shares(self) -> dict[str, Any]:
        """Return the figures of how the surface is shared between the pieces."""
        area = self.measured[:, -3]
        return {
            "triangles": len(self.faces),
            "single_triangles": int((self._sizes == 1).sum()),
            "area": float(area.sum()),
            "largest_area_share": float(area[0] / area.sum()),
        }

    def _largest(self, columns: Sequence[tuple[str, str]], measured: NDArray[np.float64]) -> list[str]:
        """Return the lines of a table of the largest pieces: number, triangles, and what is measured."""
        lines = ["".join(in_unit(name, self.metadata).rjust(int(form[1:].split(".")[0])) for name, form in columns)]
        for n, values in enumerate(measured[:_SHOWN].tolist()):
            row = zip((n, self._sizes[n], *values), columns, strict=True)
            lines.append("".join(format(value, form) for value, (_, form) in row))
        if len(self) > _SHOWN:
            lines.append(f"{'...':>6}{len(self) - _SHOWN:>6} more")
        return lines

    # --------------------------------------------------------------------------------------- files

    @property
    def provenance(self) -> Record:
        """What made it: version, function, parameters, the files that were read, warnings, and figures."""
        told: Record = {name: self.metadata[name] for name in ("space", "warnings") if name in self.metadata}
        return {**super().provenance, **told, "figures": self.figures()}

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the atlas to a file, all of it or nothing.

        Parameters
        ----------
        path : path
            Ends in .npz or .voxflat, which hold `provenance`.
        sidecar : bool
            Write `provenance` to ``<path>.json``, too.
        overwrite : bool
            Replace a file of that name that voxflat did not write.

        Raises
        ------
        InputError
            If the path has another ending, or is a file that the atlas was made of.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.save("hill_atlas.npz")
        >>> voxflat.load_atlas("hill_atlas.npz")
        <FlatAtlas of 8 patches: 800 triangles, C ≤ 1.3640, K ≤ 1.5930>
        """
        path = checked_path(path)
        if path.suffix.lower() not in SAVED_ENDINGS:
            raise InputError(f"Cannot save an atlas as {path.name}. Use a name that ends in .npz or .voxflat.")
        text = {"format": self._format, "metadata": self.metadata, **self._text()}
        arrays: dict[str, Any] = {name: getattr(self, name) for name in self._arrays}
        with (
            saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite),
            atomic_path(path) as temporary,
            temporary.open("wb") as file,
        ):
            np.savez_compressed(file, text=np.array(as_text(text)), **arrays)

    @abstractmethod
    def _text(self) -> dict[str, Any]:
        """Return what JSON can hold, beside the metadata."""

    @classmethod
    @abstractmethod
    def _of_file(cls: type[Own], text: dict[str, Any], arrays: dict[str, Any]) -> Own:
        """Make one of what was saved."""

    @classmethod
    def load(cls: type[Own], path: str | os.PathLike[str]) -> Own:
        """Load an atlas that `save` wrote.

        Parameters
        ----------
        path : path
            An .npz or .voxflat file.

        Returns
        -------
        FlatAtlas or GluedAtlas
            Of the class that is asked.

        Raises
        ------
        InputError
            If the file is damaged or is no such atlas.
        FileNotFoundError
            If there is no such file.

        Examples
        --------
        >>> atlas = voxflat.samples.hill().patches(max_angle=20)
        >>> atlas.save("hill_patches.npz")
        >>> voxflat.FlatAtlas.load("hill_patches.npz")
        <FlatAtlas of 8 patches: 800 triangles, C ≤ 1.3640, K ≤ 1.5930>
        """
        with naming(path, AGAIN):
            check_regular(checked_path(path))
        with holding(path, "an atlas"):
            arrays = read_arrays(path, [*cls._arrays, "text"])
            text = from_json(str(arrays.pop("text")))
            note(path)
            if text.pop("format") != cls._format:
                raise InputError(f"{path} was written by another version of voxflat. Make the patches again.")
            with naming(path, AGAIN):
                arrays = _checked(arrays, text["metadata"])
            return cls._of_file(text, arrays)


def figures_of(told: Mapping[str, Any]) -> dict[str, float]:
    """Return figures that a file tells; ValueError if one is no number."""
    if not all(is_number(one) for one in told.values()):
        raise ValueError(f"{dict(told)} are not numbers")
    return {name: float(one) for name, one in told.items()}


_LAYOUT = {
    "points": ("f8", "points 3"),
    "faces": ("i8", "faces 3"),
    "piece_ids": ("i8", "faces"),
    "patch_ids": ("i8", "faces"),
    "stretch": ("f8", "faces 2"),
    "starts": ("i8", "?"),
    "vertex_ids": ("i8", "rows"),
    "uv": ("f8", "rows 2"),
    "uv_faces": ("i8", "faces 3"),
    "measured": ("f8", "pieces ?"),
    "planes": ("f8", "pieces 4 3"),
}
"""Types and axes of a file's arrays, as `check_shapes` takes them."""


def _checked(arrays: dict[str, NDArray[Any]], metadata: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file, checked against each other, and against what it was made of."""
    layout = {**_LAYOUT, "ids": ("i8", "points 3" if metadata.get("kind") == "voxels" else "points")}
    check_shapes(arrays, layout)
    points, rows, starts = len(arrays["points"]), len(arrays["uv"]), arrays["starts"].astype(np.int64)
    pieces = len(starts) - 1
    if (
        pieces != len(arrays["measured"])
        or pieces < 1
        or starts[0] != 0
        or starts[-1] != rows
        or (np.diff(starts) < 1).any()
    ):
        raise InputError(f"its {len(arrays['measured'])} pieces do not begin where its array starts says: {AGAIN}")
    check_range(arrays, {"faces": points, "vertex_ids": points, "piece_ids": pieces, "uv_faces": rows})
    check_range(arrays, {"patch_ids": len(arrays["faces"])})
    if arrays["measured"].shape[1] < 3:
        raise InputError(f"its figures are not complete: {AGAIN}")
    areas = arrays["measured"][:, -3].astype(np.float64)
    if not (areas >= 0).all() or not 0 < areas.max() <= FARTHEST**2:
        raise InputError(f"its pieces have the areas {shown(areas)} mm²: {AGAIN}")
    check_places({name: arrays[name] for name in ("uv", "points", "planes") if name in arrays})
    check_origin(metadata, arrays["ids"])
    return in_types(arrays, layout)
