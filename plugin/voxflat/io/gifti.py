"""GIFTI files (https://www.nitrc.org/projects/gifti): surfaces, and values and labels on their points.

nibabel parses them. It takes any XML on trust (entities that multiply, data in other files, data that inflate without
end) and fills no gap that it could name, so each file is walked through once before, and refused with a reason.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any
from xml.parsers.expat import ParserCreate

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import require
from voxflat.io.freesurfer import cras_remark
from voxflat.io.provenance import Record, as_text
from voxflat.io.reading import allowed_memory

_POINTS, _TRIANGLES = "NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE"
_BLOCK = 1 << 20


# --------------------------------------------------------------------------------------------- XML


class _RootFound(Exception):  # noqa: N818  (nothing went wrong: it ends the parsing)
    pass


def _parser() -> Any:
    """Return an XML parser that refuses to define entities."""

    def refuse(name: str, *_: object) -> None:
        raise InputError(f"defines the XML entity {name!r}, which no mesh needs and attacks use: write it again")

    parser = ParserCreate()
    parser.buffer_text = True
    parser.EntityDeclHandler = refuse
    return parser


def xml_root(data: bytes) -> tuple[str, dict[str, str]]:
    """Return name and attributes of the root element; refuse entities, which can only be defined before it."""

    def start(name: str, attributes: dict[str, str]) -> None:
        raise _RootFound(name, attributes)

    parser = _parser()
    parser.StartElementHandler = start
    try:
        for first in range(0, len(data), _BLOCK):
            parser.Parse(data[first : first + _BLOCK], False)
        parser.Parse(b"", True)
    except _RootFound as root:
        name, attributes = root.args
        return name, attributes
    return "", {}  # not reached: XML without an element is an error of the parser


class _Walk:
    """Goes through the data arrays of a file, and refuses what nibabel would take on trust."""

    def __init__(self) -> None:
        self.arrays = 0
        self.named: str | None = None
        self.room = allowed_memory() // 4
        self.array: dict[str, str] = {}
        self.text: list[str] | None = None

    def start(self, name: str, attributes: dict[str, str]) -> None:
        if name == "GIFTI":
            self.named = attributes.get("NumberOfDataArrays")
        elif name == "DataArray":
            self.arrays += 1
            self.array = attributes
        elif name == "Data":
            self.text = []

    def characters(self, text: str) -> None:
        if self.text is not None:
            self.text.append(text)

    def end(self, name: str) -> None:
        if name == "Data" and self.text is not None:
            self._check("".join(self.text))
            self.text = None

    def _check(self, text: str) -> None:
        """Compare the length of an array's data to its header."""
        nibabel = require("nibabel")
        encoding = nibabel.gifti.util.gifti_encoding_codes.label[self.array.get("Encoding", "undef")]
        if encoding == "External":
            raise InputError(
                f"keeps data in another file, {self.array.get('ExternalFileName')!r}: write it as one file"
            )
        if encoding == "ASCII":
            return
        dims = [int(self.array.get(f"Dim{axis}", 0)) for axis in range(int(self.array.get("Dimensionality", 1)))]
        need = int(np.prod(dims, dtype=object)) * _item_size(self.array.get("DataType", ""))
        self.room -= need
        if min(dims, default=0) < 0 or self.room < 0:
            raise InputError(
                f"array {self.arrays} has the dimensions {dims}, more than memory may hold: is it damaged?"
            )
        stored = base64.b64decode(text.encode("ascii"))
        if encoding == "B64GZ":
            stream = zlib.decompressobj()
            stored = stream.decompress(stored, need + 1)  # one byte too many is enough to know
        if len(stored) != need:
            relation = "ends after" if len(stored) < need else "goes on after"
            have = f"{len(stored)} of {need}" if len(stored) < need else f"{need}"
            raise InputError(f"array {self.arrays} {relation} {have} bytes: copy or download it again")


def _item_size(name: str) -> int:
    """Return the bytes of a value of a NIfTI type."""
    return int(require("nibabel").nifti1.data_type_codes.dtype[name].itemsize)


def load(data: bytes) -> Any:
    """Parse GIFTI into nibabel's image."""
    nibabel = require("nibabel")
    walk, parser = _Walk(), _parser()
    parser.StartElementHandler, parser.EndElementHandler = walk.start, walk.end
    parser.CharacterDataHandler = walk.characters
    parser.Parse(data, True)
    if walk.named is not None and walk.named.strip() != str(walk.arrays):
        raise InputError(f"has {walk.arrays} arrays, by its header {walk.named}: copy or download it again")
    return nibabel.gifti.GiftiImage.from_bytes(data)


# ---------------------------------------------------------------------------------------- surfaces


def surface(image: Any) -> tuple[NDArray[Any], NDArray[Any], str | None, tuple[str, ...]]:
    """Return points, faces, structure and remarks of a surface."""
    points, triangles = _only(image, _POINTS, "point set"), _only(image, _TRIANGLES, "set of triangles")
    structure = points.meta.get("AnatomicalStructurePrimary") or image.meta.get("AnatomicalStructurePrimary")
    return points.data, triangles.data, structure or None, _remarks(points)


def has_triangles(image: Any) -> bool:
    """Tell whether a file holds a surface."""
    return bool(image.get_arrays_from_intent(_TRIANGLES))


def _only(image: Any, intent: str, name: str) -> Any:
    found = image.get_arrays_from_intent(intent)
    if len(found) != 1:
        others = ", ".join(sorted({require("nibabel").nifti1.intent_codes.niistring[a.intent] for a in image.darrays}))
        raise InputError(
            f"has {len(found) or 'no'} {name}{'s' * bool(found)} (its arrays: {others}): a surface has one"
        )
    return found[0]


def _remarks(points: Any) -> tuple[str, ...]:
    """Tell what the file says of another space.

    Workbench 1.5 and nilearn 0.14 take the coordinates as stored and apply no transform, and so does voxflat: a flat
    map must lie over the surfaces that they show. FreeSurfer's mris_convert writes coordinates of its own space, and
    how to leave it as a matrix or as VolGeomC_R, _A, _S.
    """
    remarks = []
    system = points.coordsys
    matrix = np.eye(4) if system is None or system.xform is None else np.asarray(system.xform)
    if matrix.size != 16:
        raise InputError(f"has a transform of {matrix.size} numbers, which needs 16: copy or download it again")
    matrix = matrix.reshape(4, 4)  # nibabel's is flat where it was written on one line
    if not np.array_equal(matrix, np.eye(4)):
        space = require("nibabel").nifti1.xform_codes.niistring[system.xformspace]
        shift = ", ".join(f"{value:g}" for value in matrix[:3, 3])
        remarks.append(
            f"has a transform to {space} (shift {shift} mm), which is not applied: coordinates are as stored"
        )
    cras = [float(points.meta.get(f"VolGeomC_{axis}") or 0) for axis in "RAS"]
    if any(cras):
        remarks.append(cras_remark(cras))
    return tuple(remarks)


def surface_bytes(
    points: NDArray[np.float64], faces: NDArray[np.int64], structure: str | None, record: Record | None = None
) -> bytes:
    """Write a surface as Workbench expects one, with a record of what made it where Workbench keeps its own."""
    nibabel = require("nibabel")
    is_flat = not points[:, 2].any()
    about = {"GeometricType": "Flat" if is_flat else "Anatomical"}
    if structure is not None:
        about["AnatomicalStructurePrimary"] = structure
    topology = "Closed" if _is_closed(faces) else "Cut" if is_flat else "Open"
    arrays = [(points.astype("f4"), _POINTS, about), (faces.astype("i4"), _TRIANGLES, {"TopologicalType": topology})]
    gifti = nibabel.gifti
    image = gifti.GiftiImage(meta=gifti.GiftiMetaData({} if record is None else {"Provenance": as_text(record)}))
    for data, intent, meta in arrays:
        image.add_gifti_data_array(
            gifti.GiftiDataArray(data, intent=intent, datatype=data.dtype, meta=gifti.GiftiMetaData(meta))
        )
    return bytes(image.to_bytes())


def _is_closed(faces: NDArray[np.int64]) -> bool:
    """Tell whether each edge lies between two faces."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges[:, 0] << 32 | edges[:, 1], return_counts=True)
    return bool((counts == 2).all())


# ------------------------------------------------------------------------------------------ values


def values(image: Any) -> NDArray[Any]:
    """Return the values at the points, shape (N,), or (N, K) of K maps."""
    surface_intents = require("nibabel").nifti1.intent_codes.code[_POINTS], 1009
    arrays = [array.data for array in image.darrays if array.intent not in surface_intents]
    if not arrays:
        raise InputError("holds a surface, but no values at its points")
    lengths = {len(array) for array in arrays}
    if len(lengths) > 1:
        raise InputError(f"its maps have different lengths, {sorted(lengths)}: write each as a file")
    maps = np.column_stack(arrays)
    return maps[:, 0] if maps.shape[1] == 1 else maps


def label_names(image: Any) -> dict[int, str]:
    """Return the names of the label table."""
    return {int(key): str(name) for key, name in image.labeltable.get_labels_as_dict().items()}
