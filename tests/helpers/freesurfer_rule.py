"""Read a patch entry by entry like FreeSurfer's MRISreadPatch, pycortex and autoflatten."""

import struct
from pathlib import Path


def read_patch(path, faces):
    """Return the positions of the listed vertices, the border vertices, and the remaining triangles.

    All vertices except the listed ones are ripped, and so are their faces. The sign of a number, which marks the
    border, rips nothing.
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
