"""Read and write GIFTI files (https://www.nitrc.org/projects/gifti): surfaces, and values and labels at their points.

nibabel parses the files. It accepts dangerous XML (exponentially expanding entities, data in other files, data that
decompress without end) and does not report missing parts clearly, so each file is checked once beforehand.
"""

import base64
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any
from xml.parsers.expat import ParserCreate

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import printable
from voxflat.errors import InputError
from voxflat.io.files import AGAIN, require
from voxflat.io.provenance import Record, as_text
from voxflat.io.reading import allowed_memory
from voxflat.io.spaces import UNKNOWN, Space, VolumeGeometry
from voxflat.io.triangles import Faces, Points

_POINTS, _TRIANGLES = "NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE"
_BLOCK = 1 << 20
_MOST_DIMENSIONS = 6
_SCANNER = 1  # NIFTI_XFORM_SCANNER_ANAT


class _RootFound(Exception):  # noqa: N818  (not an error: it ends the parsing)
    pass


def _parser() -> Any:
    """Return an XML parser that rejects entity definitions."""

    def refuse(name: str, *_: object) -> None:
        raise InputError(f"defines the XML entity {name!r}, which is not allowed. Save the file without entities")

    parser = ParserCreate()
    parser.buffer_text = True
    parser.EntityDeclHandler = refuse
    return parser


def xml_root(data: bytes) -> str:
    """Return the name of the root element; reject entities, which can be defined only before it."""

    def start(name: str, _: dict[str, str]) -> None:
        raise _RootFound(name)

    parser = _parser()
    parser.StartElementHandler = start
    try:
        for first in range(0, len(data), _BLOCK):
            parser.Parse(data[first : first + _BLOCK], False)
        parser.Parse(b"", True)
    except _RootFound as root:
        return str(root)
    return ""  # not reached: the parser rejects XML without an element


class _Walk:
    """Check the data arrays of a file, because nibabel does not."""

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
            dimensions = attributes.get("Dimensionality", 1)
            if not 1 <= int(dimensions) <= _MOST_DIMENSIONS:
                raise InputError(f"array {self.arrays} has {dimensions} dimensions. Use at most {_MOST_DIMENSIONS}")
        elif self.text is not None:
            raise InputError(f"array {self.arrays} contains the element <{name}> within its data. {AGAIN}")
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
        """Compare the length of an array's data with its header."""
        nibabel = require("nibabel")
        types = nibabel.nifti1.data_type_codes
        encoding = nibabel.gifti.util.gifti_encoding_codes.label[self.array.get("Encoding", "undef")]
        if encoding == "External":
            raise InputError(f"refers to another file, {self.array.get('ExternalFileName')!r}. Embed its data instead")
        if encoding == "ASCII":
            return
        dims = [int(self.array.get(f"Dim{axis}", 0)) for axis in range(int(self.array.get("Dimensionality", 1)))]
        need = int(np.prod(dims, dtype=object)) * types.dtype[self.array.get("DataType", "")].itemsize
        self.room -= need
        if min(dims, default=0) < 0 or self.room < 0:
            raise InputError(f"array {self.arrays} with dimensions {dims} does not fit into memory. Check the file")
        stored = base64.b64decode(text.encode("ascii"))
        if encoding == "B64GZ":
            stream = zlib.decompressobj()
            stored = stream.decompress(stored, need + 1)  # one additional byte suffices
        if len(stored) != need:
            fault = f"ends after {len(stored)} of" if len(stored) < need else "is longer than"
            raise InputError(f"array {self.arrays} {fault} the {need} bytes that its header specifies. {AGAIN}")


def load(data: bytes) -> Any:
    """Parse GIFTI data into a nibabel image."""
    nibabel = require("nibabel")
    walk, parser = _Walk(), _parser()
    parser.StartElementHandler, parser.EndElementHandler = walk.start, walk.end
    parser.CharacterDataHandler = walk.characters
    parser.Parse(data, True)
    if walk.named is not None and walk.named.strip() != str(walk.arrays):
        raise InputError(f"has {walk.arrays} arrays, but its header specifies {walk.named}. {AGAIN}")
    return nibabel.gifti.GiftiImage.from_bytes(data)


def surface(image: Any) -> dict[str, Any]:
    """Return the parts of a `Mesh`."""
    points, triangles = _only(image, _POINTS, "point set"), _only(image, _TRIANGLES, "triangle set")
    structure = points.meta.get("AnatomicalStructurePrimary") or image.meta.get("AnatomicalStructurePrimary")
    more = {"structure": structure or None, "space": _space(points), "warnings": _warnings(points)}
    return {"points": points.data, "faces": triangles.data, **more}


def _has_triangles(image: Any) -> bool:
    """Return whether a file contains a surface."""
    return bool(image.get_arrays_from_intent(_TRIANGLES))


def _only(image: Any, intent: str, name: str) -> Any:
    arrays = image.get_arrays_from_intent(intent)
    if len(arrays) != 1:
        others = ", ".join(sorted({require("nibabel").nifti1.intent_codes.niistring[a.intent] for a in image.darrays}))
        count = f"{len(arrays) or 'no'} {name}{'s' * bool(arrays)}{' instead of one' * bool(arrays)}"
        raise InputError(f"has {count} (its arrays are {others}). Pass a file with one surface")
    return arrays[0]


def _warnings(points: Any) -> tuple[str, ...]:
    """Return a warning if there is a transformation to a template, which neither Workbench nor voxflat applies."""
    system, matrix = points.coordsys, _transform(points)
    if np.array_equal(matrix, np.eye(4)) or _SCANNER in (system.dataspace, system.xformspace):
        return ()
    space = require("nibabel").nifti1.xform_codes.niistring[system.xformspace]
    shift = ", ".join(f"{value:g}" for value in matrix[:3, 3])
    return (f"has a transformation to {space} (shift {shift} mm), but its coordinates are used as stored, without it",)


def _transform(points: Any) -> NDArray[np.float64]:
    """Return the matrix of the coordinate system, or the identity if there is none."""
    system = points.coordsys
    matrix = np.eye(4) if system is None or system.xform is None else np.asarray(system.xform, dtype=np.float64)
    if matrix.size != 16:
        raise InputError(f"has a transformation with {matrix.size} numbers instead of 16. {AGAIN}")
    return matrix.reshape(4, 4)  # nibabel returns a 1-D array if the matrix is on one line


def _space(points: Any) -> Space:
    """Determine the space of the coordinates.

    Workbench, sMRIPrep and nilearn use coordinates as stored, in the world space of volumes. FreeSurfer's mris_convert
    writes tkRAS unless ``--to-scanner`` is given, and the volume geometry (VolGeom...) in both cases:

    - FreeSurfer 7.4 and later versions store the coordinate system: SCANNER_ANAT is scanner RAS, and a matrix from
      UNKNOWN to SCANNER_ANAT maps tkRAS to scanner RAS.
    - Otherwise, SurfaceCenterX, Y, Z determine the space. They are the centre of the bounding box of the surface that
      mris_convert read; neither ``--to-scanner`` nor Workbench changes them when moving the points.
    - Otherwise, the space is uncertain: mris_convert writes tkRAS by default, and Workbench's coordinates (with its own
      coordinate system, TALAIRACH to TALAIRACH) are used as stored.

    Without c_ras, tkRAS is undefined: sMRIPrep moves surfaces to scanner RAS and sets c_ras to 0 or omits it.
    """
    meta, system = points.meta, points.coordsys
    dataspace, xformspace = (0, 0) if system is None else (system.dataspace, system.xformspace)
    try:
        volume = _volume_geometry(meta)
        is_led = dataspace == 0 and xformspace == _SCANNER
        if is_led and volume is None:
            volume = VolumeGeometry._of_matrix(_transform(points))
    except (InputError, ValueError) as error:
        warning = f"its volume geometry (VolGeom...) is damaged: {error}"
        return Space("scanner") if dataspace == _SCANNER else Space("unknown", None, warning)
    if dataspace == _SCANNER:
        return Space("scanner", volume)
    if is_led:
        return Space("tkRAS", volume)
    if volume is None:
        return UNKNOWN
    if np.array_equal(volume.matrix, np.eye(4)):
        return Space("scanner", volume)
    stored = np.full(3, np.nan)  # the centre of the surface as mris_convert read it
    with suppress(ValueError):
        stored = np.array([float(meta.get(f"SurfaceCenter{axis}") or "nan") for axis in "XYZ"])
    centre = (points.data.min(axis=0).astype(np.float64) + points.data.max(axis=0)) / 2
    moved = volume.matrix[:3, :3] @ stored + volume.c_ras
    far = np.linalg.norm(moved - stored)
    from_stored, from_moved = np.linalg.norm(centre - stored), np.linalg.norm(centre - moved)
    if min(from_stored, from_moved) < far / 4:
        return Space("tkRAS" if from_stored < from_moved else "scanner", volume)
    c_ras = ", ".join(f"{value:g}" for value in volume.c_ras)
    warning = f"its file defines FreeSurfer's c_ras ({c_ras}) mm, but not whether its coordinates include it: "
    if dataspace:
        reason = "they are assumed to include it (scanner RAS), because its coordinate system is not FreeSurfer's"
        return Space("scanner", volume, warning + reason)
    reason = "they are assumed not to include it (tkRAS), because mris_convert writes tkRAS without --to-scanner"
    return Space("tkRAS", volume, warning + reason)


def _volume_geometry(meta: Any) -> VolumeGeometry | None:
    """Return the volume geometry that FreeSurfer wrote, or that of a conformed volume if only c_ras is stored."""
    c_ras = [float(meta.get(f"VolGeomC_{axis}") or 0) for axis in "RAS"]
    if not any(f"VolGeomC_{axis}" in meta for axis in "RAS"):
        return None
    axes = [[meta.get(f"VolGeom{column}_{row}") for column in "XYZ"] for row in "RAS"]
    if any(cosine is None for row in axes for cosine in row):
        return VolumeGeometry.conformed(c_ras)
    cosines = np.array([[float(cosine) for cosine in row] for row in axes])
    shape = [int(meta.get(f"VolGeom{name}") or 256) for name in ("Width", "Height", "Depth")]
    sizes = [float(meta.get(f"VolGeom{axis}size") or 1) for axis in "XYZ"]
    return VolumeGeometry(cosines, np.array(c_ras), shape, sizes, meta.get("VolGeomFname") or "")


def surface_bytes(
    points: Points, faces: Faces, structure: str | None, *, is_scanner: bool = False, record: Record | None = None
) -> bytes:
    """Return a surface and its record in the Workbench convention: coordinates as given, in scanner RAS if known."""
    is_flat = not points[:, 2].any()
    about = {"GeometricType": "Flat" if is_flat else "Anatomical", **_named(structure)}
    topology = {"TopologicalType": "Closed" if _is_closed(faces) else "Cut" if is_flat else "Open"}
    is_scanner = is_scanner and not is_flat
    system = require("nibabel").gifti.GiftiCoordSystem(_SCANNER, _SCANNER) if is_scanner else None
    arrays = [_array(points.astype("f4"), _POINTS, about, system), _array(faces.astype("i4"), _TRIANGLES, topology)]
    return _file(arrays, {}, record)


def label_bytes(
    labels: NDArray[np.int64],
    keys: Sequence[int],
    names: Sequence[str],
    colours: NDArray[np.uint8],
    structure: str | None,
    record: Record | None = None,
) -> bytes:
    """Return labels at points in the Workbench convention (0 for no label), with their names and colours."""
    gifti = require("nibabel").gifti
    table = gifti.GiftiLabelTable()
    rows = [(0, "???", (0.0, 0.0, 0.0, 0.0))]
    shares = [(*(channel / 255 for channel in colour), 1.0) for colour in colours.tolist()]
    for key, name, (red, green, blue, alpha) in [*rows, *zip(keys, names, shares, strict=True)]:
        label = gifti.GiftiLabel(key=int(key), red=red, green=green, blue=blue, alpha=alpha)
        label.label = printable(name)
        table.labels.append(label)
    array = _array(labels.astype(np.int32), "NIFTI_INTENT_LABEL", {"Name": "regions"})
    return _file([array], _named(structure), record, labeltable=table)


def value_bytes(values: Mapping[str, NDArray[Any]], structure: str | None, record: Record | None = None) -> bytes:
    """Return values at points in the Workbench convention, with one map per name and NaN for missing values."""
    named = ((printable(name), array.astype(np.float32)) for name, array in values.items())
    arrays = [_array(array, "NIFTI_INTENT_NONE", {"Name": name}) for name, array in named]
    return _file(arrays, _named(structure), record)


def _named(structure: str | None) -> dict[str, str]:
    return {} if structure is None else {"AnatomicalStructurePrimary": structure}


def _array(data: NDArray[Any], intent: str, meta: dict[str, str], system: Any = None) -> Any:
    gifti = require("nibabel").gifti
    return gifti.GiftiDataArray(data, intent, data.dtype, meta=gifti.GiftiMetaData(meta), coordsys=system)


def _file(arrays: list[Any], meta: dict[str, str], record: Record | None, **more: Any) -> bytes:
    gifti = require("nibabel").gifti
    more["meta"] = gifti.GiftiMetaData(meta if record is None else {**meta, "Provenance": as_text(record)})
    return bytes(gifti.GiftiImage(darrays=arrays, **more).to_bytes())


def _is_closed(faces: Faces) -> bool:
    """Return whether each edge belongs to two faces."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges[:, 0] << 32 | edges[:, 1], return_counts=True)
    return bool((counts == 2).all())


def values(image: Any) -> NDArray[Any]:
    """Return the values at the points, of shape (N,), or (N, K) for K maps."""
    arrays = [array.data for array in _maps(image)]
    if not arrays:
        raise InputError("contains a surface, but no values at its points. Pass a file with values")
    lengths = {len(array) for array in arrays}
    if len(lengths) > 1:
        raise InputError(f"has maps with different lengths, {sorted(lengths)}. Write each map to its own file")
    maps = np.column_stack(arrays)
    return maps[:, 0] if maps.shape[1] == 1 else maps


def label_names(image: Any) -> dict[int, str]:
    """Return the names of the label table."""
    return {int(key): str(name) for key, name in image.labeltable.get_labels_as_dict().items()}


def _maps(image: Any) -> list[Any]:
    """Return the arrays that are not part of a surface."""
    surface_intents = require("nibabel").nifti1.intent_codes.code[_POINTS], 1009
    return [array for array in image.darrays if array.intent not in surface_intents]


def map_names(image: Any) -> tuple[str, ...]:
    """Return the names of the maps (empty for unnamed maps); a 2-D array contains several maps."""
    names: list[str] = []
    for array in _maps(image):
        names += [str(array.meta.get("Name", ""))] * (array.data.shape[1] if array.data.ndim > 1 else 1)
    return tuple(names)
