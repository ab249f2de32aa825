"""The base class of atlases: a sequence of pieces with a page, figures and files."""

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from voxflat import display
from voxflat.arguments import checked_choice, checked_number, checked_path, shown
from voxflat.atlases.layout import PACKINGS, lay_out, usual_gap
from voxflat.atlases.page import FlatPage
from voxflat.atlases.pieces import FlatPieces, Piece
from voxflat.errors import InputError
from voxflat.io import files
from voxflat.io.descriptions import check_atlas
from voxflat.io.grid import FARTHEST, in_unit
from voxflat.io.notebook import page
from voxflat.io.origin import take_origin
from voxflat.io.provenance import Record, as_text
from voxflat.io.readers import read_arrays
from voxflat.io.reading import record_file
from voxflat.io.saved import Saved
from voxflat.maps.raster import FlatImage, FlatStack

if TYPE_CHECKING:
    import typing_extensions
    from typing_extensions import Unpack

    from voxflat.maps.option_types import ImageOptions, StackOptions

    PieceT_co = typing_extensions.TypeVar("PieceT_co", bound=Piece, covariant=True, default=Piece)
else:
    PieceT_co = TypeVar("PieceT_co", bound=Piece, covariant=True)

_SHOWN = 12  # pieces in a table
_ARRAYS = ("points", "faces", "ids", "piece_ids", "stretch", "starts", "vertex_ids", "uv", "uv_faces", "measured")

_LAYOUT = {  # types and axes of the arrays in a file, in the form that `check_shapes` expects
    "points": ("f8", "points 3"),
    **dict.fromkeys(("faces", "uv_faces"), ("i8", "faces 3")),
    **dict.fromkeys(("piece_ids", "patch_ids"), ("i8", "faces")),
    "stretch": ("f8", "faces 2"),
    "starts": ("i8", "?"),
    "vertex_ids": ("i8", "rows"),
    "uv": ("f8", "rows 2"),
    "measured": ("f8", "pieces ?"),
    "planes": ("f8", "pieces 4 3"),
}

Own = TypeVar("Own", bound="Atlas")


@dataclass(frozen=True, eq=False, kw_only=True)
class Atlas(FlatPieces, Saved, Sequence[PieceT_co], ABC):
    """A surface divided into a sequence of flat pieces, from the largest to the smallest.

    It is either a `FlatAtlas` of certified patches, or a `GluedAtlas`.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Vertices of the surface, in RAS+ mm (see `space`).
    faces : ndarray of int64, shape (F, 3)
        Triangles of the surface, as rows of `points`.
    ids : ndarray of int64, shape (N, 3) or (N,)
        Voxel indices or vertex number of each vertex in the input.
    piece_ids : ndarray of int64, shape (F,)
        The piece that contains each triangle.
    patch_ids : ndarray of int64, shape (F,)
        The certified patch that contains each triangle. It differs from the piece if patches are glued.
    stretch : ndarray, shape (F, 2)
        Principal stretches σ1 ≥ σ2 of each triangle, measured in the plane.
    starts : ndarray of int64, shape (pieces + 1,)
        First row of each piece in `vertex_ids` and `uv`, followed by the total number of rows.
    vertex_ids : ndarray of int64, shape (P,)
        The row of `points` for each row of `uv`, piece by piece. A vertex on both sides of a cut within a piece has two
        rows.
    uv : ndarray, shape (P, 2)
        Positions in the plane, in mm. Each piece has its own plane.
    uv_faces : ndarray of int64, shape (F, 3)
        Corners of each triangle, counterclockwise, as rows of `uv`; triangles are in the order of `faces`.
    origin : Origin
        The volume or the mesh of the surface.
    warnings : tuple of str
        Reasons to check the atlas, which were also logged.
    details : dict
        Entries of `metadata` beside those that the other fields write.
    record : dict
        `provenance` without the measures.
    measured : ndarray, shape (pieces, K)
        Measures of each piece, one per column; the last three are area, isometric and quasi_conformal.

    See Also
    --------
    Surface.patches : Create an atlas.

    Examples
    --------
    >>> voxflat.samples.hill().patches(max_angle=20)
    <FlatAtlas of 8 patches: 800 triangles, C ≤ 1.3640, K ≤ 1.5930>
    """

    _kind = "an atlas"
    _endings = files.SAVED_ENDINGS
    _formats = """
    ``.npz`` and ``.voxflat`` hold the complete atlas with `provenance`, for `load_atlas`.
    """

    measured: NDArray[np.float64]

    _format: ClassVar[str]  # name and version of its files
    _arrays: ClassVar[tuple[str, ...]] = _ARRAYS  # arrays in its files

    @property
    def title(self) -> str:
        """A one-line description of the atlas, for pictures."""
        return self._title()

    @abstractmethod
    def _title(self) -> str: ...

    # -------------------------------------------------------------------------------- as a sequence

    @overload
    def __getitem__(self, number: int) -> PieceT_co: ...

    @overload
    def __getitem__(self, number: slice) -> list[PieceT_co]: ...

    def __getitem__(self, number: int | slice) -> PieceT_co | list[PieceT_co]:
        """Return a piece, or a list of pieces for a slice."""
        if isinstance(number, slice):
            return [self._piece(n) for n in range(*number.indices(len(self)))]
        return self._piece(range(len(self))[number])

    @abstractmethod
    def _piece(self, n: int) -> PieceT_co:
        """Return a piece."""

    def _parts(self, n: int) -> dict[str, Any]:
        """Return the fields of `Piece` for a piece."""
        rows = slice(self.starts[n], self.starts[n + 1])
        face_ids = self._faces_by_piece[n]
        figures = dict(zip(("area", "isometric", "quasi_conformal"), self.measured[n, -3:].tolist(), strict=True))
        faces, vertex_ids = self.uv_faces[face_ids] - self.starts[n], self.vertex_ids[rows]
        return {"face_ids": face_ids, "vertex_ids": vertex_ids, "uv": self.uv[rows], "faces": faces, **figures}

    @cached_property
    def _faces_by_piece(self) -> list[NDArray[np.int64]]:
        order = np.argsort(self.piece_ids, kind="stable")
        return np.split(order, np.searchsorted(self.piece_ids[order], np.arange(1, len(self))))

    # ----------------------------------------------------------------------------------- on a page

    @cached_property
    def _pages(self) -> dict[tuple[float, str], FlatPage]:
        return {}

    def page(self, gap: float | None = None, *, packing: str = "boxes") -> FlatPage:
        """Place the pieces side by side on a page, without overlap.

        Pages are cached, so repeated calls are fast.

        Parameters
        ----------
        gap : float, optional
            Gap between the pieces, in mm; by default a twentieth of their typical size.
        packing : {"boxes", "shapes"}
            "boxes" rotates each piece so that its bounding rectangle is as small as possible, and arranges the
            rectangles in rows. "shapes" fits the pieces together with the xatlas library (``pip install
            'voxflat[lab]'``), which wastes less space on the page if pieces are large.

        Returns
        -------
        FlatPage
            The page, with images, heat maps, lookups, and the surface with a texture.

        Raises
        ------
        InputError
            If the gap or the packing is invalid, or xatlas is not installed.
        """
        chosen = usual_gap(self.uv, self.starts) if gap is None else checked_number(gap, "gap")
        key = (chosen, checked_choice(packing, "packing", PACKINGS))
        if key not in self._pages:
            self._pages[key] = FlatPage(self, lay_out(self.uv, self.starts, self.uv_faces, chosen, packing), chosen)
        return self._pages[key]

    def layout(self, gap: float | None = None, *, packing: str = "boxes") -> NDArray[np.float64]:
        """Return the positions of the pieces on their page, without overlap.

        Pieces are rotated and moved, but not mirrored.

        Parameters
        ----------
        gap : float, optional
            As in `page`.
        packing : {"boxes", "shapes"}
            As in `page`.

        Returns
        -------
        ndarray, shape (P, 2)
            Position on the page for each row of `uv`, in mm.
        """
        return self.page(gap, packing=packing).uv

    def image(self, volume: object, pixel_size: float | None = None, **options: "Unpack[ImageOptions]") -> FlatImage:
        """Show a volume, or values at the vertices, on the page.

        Shorthand for `page` followed by `FlatPage.image`.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            As in `FlatMap.image`.
        pixel_size : float, optional
            As in `FlatMap.image`.
        **options
            As in `FlatMap.image`. Fractions are not available, because an atlas has no pial surface.

        Returns
        -------
        FlatImage
            The image, with NaN (for colours, alpha 0) outside the pieces and where the volume has no value.
        """
        return self.page().image(volume, pixel_size, **options)

    def images(self, volume: object, pixel_size: float | None = None, **options: "Unpack[StackOptions]") -> FlatStack:
        """Show several depths, all maps of a file, or a series of volumes on the page.

        Shorthand for `page` followed by `FlatPage.images`.

        Parameters
        ----------
        volume : path, ndarray, image object or Volume
            As in `FlatMap.images`.
        pixel_size : float, optional
            As in `FlatMap.images`.
        **options
            As in `FlatMap.images`, but without fractions.

        Returns
        -------
        FlatStack
            A sequence of images.
        """
        return self.page().images(volume, pixel_size, **options)

    def heat_map(self, pixel_size: float | None = None, *, of: str = "isometric") -> FlatImage:
        """Return an image of the distortion of each triangle on the page.

        Shorthand for `page` followed by `FlatPage.heat_map`.

        Parameters
        ----------
        pixel_size : float, optional
            As in `FlatPage.heat_map`.
        of : {"isometric", "quasi_conformal", "areal"}
            As in `FlatPage.heat_map`.

        Returns
        -------
        FlatImage
            The image, with NaN outside the pieces.
        """
        return self.page().heat_map(pixel_size, of=of)

    # ------------------------------------------------------------------------------------- figures

    def figures(self) -> dict[str, object]:
        """Return the measures of the atlas as a dictionary that can be written as JSON.

        They describe the patches or pieces, the bounds, the measured distortion and, if patches are glued, the seams.

        Returns
        -------
        dict
            The figures by name.
        """
        return self._figures()

    @abstractmethod
    def _figures(self) -> dict[str, Any]: ...

    def _repr_html_(self) -> str:
        """Return a picture of the page and a table of the pieces, for Jupyter."""
        figure = display.views.atlas_page(self)
        return page(self, self.table(), figure, "The pieces side by side, one colour per patch")

    def table(self) -> str:
        """Return a table of the measures as text.

        The largest patches or pieces have one row each.

        Returns
        -------
        str
            The table.
        """
        return "\n".join(self._lines())

    @abstractmethod
    def _lines(self) -> list[str]:
        """Return the lines of the table."""

    @property
    def _sizes(self) -> NDArray[np.int64]:
        """Number of triangles of each piece."""
        return np.bincount(self.piece_ids, minlength=len(self))

    def _shares(self) -> dict[str, Any]:
        """Return the numbers of triangles and the areas of the pieces."""
        area, single = self.measured[:, -3], int((self._sizes == 1).sum())
        areas = {"area": float(area.sum()), "largest_area_share": float(area[0] / area.sum())}
        return {"triangles": len(self.faces), "single_triangles": single, **areas}

    def _largest(self, columns: dict[str, str], measured: NDArray[np.float64]) -> list[str]:
        """Return a table of the largest pieces (number, triangles, measures); columns have a title and a format."""
        titles = (
            in_unit(name, self.origin.named_unit).rjust(int(form[1:].split(".")[0])) for name, form in columns.items()
        )
        rows = ((n, self._sizes[n], *values) for n, values in enumerate(measured[:_SHOWN].tolist()))
        more = [f"{'...':>6}{len(self) - _SHOWN:>6} more"] if len(self) > _SHOWN else []
        return ["".join(titles), *("".join(map(format, row, columns.values())) for row in rows), *more]

    # --------------------------------------------------------------------------------------- files

    @property
    def provenance(self) -> Record:
        """The record of how the atlas was made.

        It lists the version, function, parameters, input files, warnings and measures.
        """
        context = {"space": self.space._described(), "warnings": list(self.warnings)}
        return {**super().provenance, **context, "figures": self.figures()}

    def _write(self, path: Path) -> None:
        text = {"format": self._format, "metadata": self.metadata, **self._text()}
        arrays: dict[str, Any] = {name: getattr(self, name) for name in self._arrays}
        with files.atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, text=np.array(as_text(text)), **arrays)

    @abstractmethod
    def _text(self) -> dict[str, Any]:
        """Return the JSON part of the file, except for the metadata."""

    @classmethod
    @abstractmethod
    def _of_file(cls: type[Own], text: dict[str, Any], fields: dict[str, Any]) -> Own:
        """Return an atlas from the contents of a file: its own measures, and fields of all atlases."""

    @classmethod
    def load(cls: type[Own], path: str | os.PathLike[str]) -> Own:
        """Load an atlas that was saved with `save`.

        `load_atlas` loads an atlas of either kind.

        Parameters
        ----------
        path : path
            An .npz or .voxflat file.

        Returns
        -------
        FlatAtlas or GluedAtlas
            An atlas of the class on which this method is called.

        Raises
        ------
        InputError
            If the file is damaged or is not such an atlas.
        FileNotFoundError
            If the file does not exist.

        See Also
        --------
        load_atlas : Load an atlas of either kind.
        """
        with files.naming(path, files.AGAIN):
            files.check_regular(checked_path(path))
        with files.holding(path, "an atlas"):
            text = files.from_json(str(read_arrays(path, ["text"])["text"]))
            files.check_format(path, text.pop("format"), cls._format, "Create the atlas again")
            arrays = read_arrays(path, cls._arrays)
            record_file(path)
            with files.naming(path, files.AGAIN):
                check_atlas(text)
                fields = _checked(arrays, text.pop("metadata"))
            return cls._of_file(text, fields)


def figures_of(measures: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers of a file as floats, after `check_atlas`."""
    return {name: float(value) for name, value in measures.items()}


def _checked(arrays: dict[str, NDArray[Any]], metadata: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of an atlas, from arrays checked against each other and against the input."""
    layout = {**_LAYOUT, "ids": ("i8", "points 3" if metadata.get("kind") == "voxels" else "points")}
    files.check_shapes(arrays, layout)
    points, rows, starts = len(arrays["points"]), len(arrays["uv"]), arrays["starts"].astype(np.int64)
    pieces = len(starts) - 1
    is_split = pieces >= 1 and starts[0] == 0 and starts[-1] == rows and (np.diff(starts) >= 1).all()
    if not is_split or pieces != len(arrays["measured"]):
        raise InputError(f"its array 'starts' does not match the {len(arrays['measured'])} pieces. {files.AGAIN}")
    files.check_range(arrays, {"faces": points, "vertex_ids": points, "piece_ids": pieces, "uv_faces": rows})
    files.check_range(arrays, {"patch_ids": len(arrays["faces"])})
    if arrays["measured"].shape[1] < 3:
        raise InputError(f"its array 'measured' is incomplete. {files.AGAIN}")
    areas = arrays["measured"][:, -3].astype(np.float64)
    if not (areas >= 0).all() or not 0 < areas.max() <= FARTHEST**2:
        raise InputError(f"the areas of its pieces are not valid: {shown(areas)} mm². {files.AGAIN}")
    files.check_places({name: arrays[name] for name in ("uv", "points", "planes") if name in arrays})
    return {
        **files.in_types(arrays, layout),
        "origin": take_origin(metadata, arrays["ids"]),
        "warnings": tuple(metadata.pop("warnings", ())),
        "record": metadata.pop("provenance", {}),
        "details": metadata,
    }
