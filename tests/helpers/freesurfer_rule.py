"""How FreeSurfer's MRISreadPatch reads a patch, and pycortex and autoflatten after it; written out, entry by entry."""

import struct
from pathlib import Path


def read_patch(path, faces):
    """Return the places of the listed vertices, those at the border, and the triangles that a reader of the patch has.

    All vertices begin as ripped; those listed are not. A face is ripped if one of its corners is. Whether a vertex is
    at the border, the sign of its number, rips nothing.
    """
    data = Path(path).read_bytes()
    version, count = struct.unpack_from(">2i", data)
    assert version == -1
    assert len(data) == 8 + 16 * count
    places, border = {}, set()
    for entry in range(count):
        number, x, y, z = struct.unpack_from(">i3f", data, 8 + 16 * entry)
        assert number != 0
        vertex = abs(number) - 1
        assert vertex not in places
        places[vertex] = (x, y, z)
        if number < 0:
            border.add(vertex)
    triangles = [tuple(face) for face in faces.tolist() if all(vertex in places for vertex in face)]
    return places, border, triangles
