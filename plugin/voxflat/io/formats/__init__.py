"""Determine the format of a file that contains a surface, a part of a surface, or values at the points of a surface."""

from pathlib import Path

from voxflat.io.formats import freesurfer, gifti
from voxflat.io.formats.polygons import is_binary_stl

GIFTI, FREESURFER, VTK, VTP, PLY, STL, OBJ = "GIFTI", "FreeSurfer surface", "VTK", "VTP", "PLY", "STL", "OBJ"
OFF, ASC, GLB = "OFF", "FreeSurfer ASCII surface", "GLB"
PATCH, MORPH = "FreeSurfer patch", "FreeSurfer file of values"
ENDINGS = {".gii": GIFTI, ".gii.gz": GIFTI, ".vtk": VTK, ".vtp": VTP, ".ply": PLY, ".stl": STL, ".obj": OBJ}
ENDINGS |= {".off": OFF, ".asc": ASC, ".glb": GLB}
HINTS = {PATCH: "Pass the patch as a flat map, or as a region to keep", MORPH: "Pass the values as an overlay"}
HINTS |= {"FreeSurfer label": "Pass the label as a region"}
"""Remedies for files that do not contain a surface."""


def by_name(path: Path) -> str | None:
    """Return the format indicated by the ending of a file name."""
    return next((entry for ending, entry in ENDINGS.items() if path.name.lower().endswith(ending)), None)


def by_content(data: bytes) -> str | None:
    """Return the format indicated by the first bytes of a file."""
    start = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(b"<") or data[:4] in (b"\xff\xfe<\0", b"\xfe\xff\0<"):  # the latter two are UTF-16
        root = gifti.xml_root(data)
        return {"GIFTI": GIFTI, "VTKFile": VTP}.get(root, f"XML <{root}>")
    for magic, name in _MAGIC.items():
        if data.startswith(magic):
            return name
    if data.startswith(b"\xff\xff\xff"):
        return MORPH if freesurfer.is_morph(data) else FREESURFER
    if data[344:348] in (b"n+1\0", b"ni1\0") or data[4:8] in (b"n+2\0", b"ni2\0"):
        return "a NIfTI volume"
    is_text_stl = start.startswith(b"solid") and b"facet" in data[:1024]
    return STL if is_text_stl or is_binary_stl(data) else None


_MAGIC = {
    b"\xff\xff\xff\xff": PATCH,
    b"\xff\xff\xfe": FREESURFER,
    b"\xff\xff\xfd": FREESURFER,
    b"ply\n": PLY,
    b"ply\r": PLY,
    b"# vtk DataFile": VTK,
    b"#!ascii label": "FreeSurfer label",
    b"#!ascii version": ASC,
    b"glTF": GLB,
    b"OFF": OFF,
    b"\x93NUMPY": "a NumPy array",
}
