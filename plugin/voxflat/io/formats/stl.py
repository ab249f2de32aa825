"""STL files, parsed here: of files that are cut short VTK may return what there is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from voxflat.errors import InputError

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def is_binary_stl(data: bytes) -> bool:
    """Tell whether a file is as long as its header would have it if it were binary STL."""
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def read_stl(path: Path, data: bytes) -> dict[str, Any]:
    """Read an STL file; equal corners become one point."""
    if data.lstrip()[:5].lower() == b"solid" and not is_binary_stl(data):
        text = data.lower()
        found = re.findall(rb"(?m)^[ \t\r]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)[ \t\r]*$", text)
        number = len(re.findall(rb"(?m)^[ \t\r]*facet\b", text))
        if len(found) != 3 * number or b"endsolid" not in text[-200:]:
            raise InputError(f"has {len(found)} corners in {number} facets, or no end: copy or download it again")
        corners = np.array(found, dtype=np.float64).reshape(-1, 3)
    else:
        number = int.from_bytes(data[80:84], "little")
        if len(data) < 84 + _FACET.itemsize * number:
            raise InputError(f"has {number} faces by its header, but ends after {len(data)} bytes: copy it again")
        corners = np.frombuffer(data, _FACET, number, 84)["corners"].reshape(-1, 3).astype(np.float64)
    rows = np.ascontiguousarray(corners + 0.0).view("V24").ravel()  # + 0.0, so that −0 is 0
    _, first, place = np.unique(rows, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    points, faces = corners[np.sort(first)], rank[place].reshape(-1, 3)
    remark = f"STL knows no points: {len(corners)} corners with {len(points)} different places became as many points"
    return {"points": points, "faces": faces, "remarks": (remark,)}
