"""Textured surfaces as files: OBJ, VTP, glTF with their picture, PLY with colours at the points.

glTF is written here, after its specification (2.0): VTK's exporter writes what a window shows, and so needs one.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from voxflat.errors import InputError
from voxflat.io import freesurfer, graphics, vtk
from voxflat.io.readers import by_ending, naming
from voxflat.io.volumes import atomic_path
from voxflat.maps.texture import TexturedSurface

__all__ = ["TEXTURED_ENDINGS", "beside", "write_textured"]


def write_textured(path: str | os.PathLike[str], surface: TexturedSurface) -> None:
    """Write a textured surface; see `TexturedSurface.save`."""
    path = Path(path)
    with naming(path, "can this format hold it?"):
        write = by_ending(path, _WRITERS, "written")
    names = [path, *(beside(path, ending) for ending in _BESIDE.get(path.suffix.lower(), ()))]
    for name in names:
        if surface.source is not None and name.exists() and surface.source.exists() and name.samefile(surface.source):
            raise InputError(f"cannot write {path}: {name} is the picture itself; choose another name")
    with ExitStack() as files:  # they take their places in reverse: the surface last, when what it names is there
        temporary = [files.enter_context(atomic_path(name)) for name in names]
        with naming(path, "can this format hold it?"):
            write(temporary, surface, [name.name for name in names])


def beside(path: Path, ending: str) -> Path:
    """Return the file that goes with a surface; its name has no spaces, at which readers of OBJ would end it."""
    return path.with_name(re.sub(r"[\s#]+", "_", path.stem) + ending)


_Files = list[Path]


def _write_obj(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    _, library, picture = names
    # without -clamp on, which VTK takes for part of the file's name
    lines = ["newmtl texture", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Kd {picture}"]
    if surface.picture.shape[2] == 4:
        lines.append(f"map_d {picture}")
    files[1].write_text("\n".join(lines) + "\n", encoding="utf-8")
    graphics.write_obj(
        files[0], surface.points, surface.faces, surface.texture_coordinates, library, surface.texture_faces
    )
    files[2].write_bytes(_png(surface.picture))


def _write_vtp(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    surface = surface.opened()
    vtk.write_vtp(files[0], surface.points, surface.faces, surface.texture_coordinates, {})
    files[1].write_bytes(_png(surface.picture))


def _write_ply(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    surface = surface.opened()
    graphics.write_ply(files[0], surface.points, surface.faces, None, surface.colours)


def _png(picture: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG")
    return file.getvalue()


# ---------------------------------------------------------------------------------------------- glTF

_FLOAT, _UINT32 = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _MIPMAPS, _REPEAT, _CLAMP = 9729, 9987, 10497, 33071
_TO_METRES_Y_UP = [1e-3, 0, 0, 0, 0, 0, -1e-3, 0, 0, 1e-3, 0, 0, 0, 0, 0, 1]  # column by column


def _write_glb(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    surface = surface.opened()
    points = freesurfer.as_float32(surface.points)
    coordinates = surface.texture_coordinates * [1, -1] + [0, 1]  # t runs downwards in glTF
    blocks = [
        points.astype("<f4").tobytes(),
        coordinates.astype("<f4").tobytes(),
        surface.faces.astype("<u4").tobytes(),
        _png(surface.picture),
    ]
    views, at = [], 0
    for block, target in zip(blocks, (_VERTICES, _VERTICES, _INDICES, None), strict=True):
        view = {"buffer": 0, "byteOffset": at, "byteLength": len(block)}
        views.append(view if target is None else {**view, "target": target})
        at += len(_padded(block, b"\0"))
    body = b"".join(_padded(block, b"\0") for block in blocks)
    content = _padded(json.dumps(_gltf(surface, points, views, len(body)), allow_nan=False).encode(), b" ")
    chunks = struct.pack("<I4s", len(content), b"JSON") + content + struct.pack("<I4s", len(body), b"BIN\0") + body
    files[0].write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _padded(block: bytes, filler: bytes) -> bytes:
    return block + filler * (-len(block) % 4)


def _gltf(surface: TexturedSurface, points: NDArray[np.float32], views: list[Any], length: int) -> dict[str, Any]:
    """Return what a glTF file says of its binary part; its one node takes RAS+ mm to metres with y up."""
    wrap = _REPEAT if surface.repeat else _CLAMP
    count, corners = len(points), surface.faces.size
    extent = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1},
        "doubleSided": True,
        "alphaMode": "BLEND" if surface.picture.shape[2] == 4 else "OPAQUE",
    }
    return {
        "asset": {"version": "2.0", "generator": "voxflat"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": _TO_METRES_Y_UP}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [material],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": wrap, "wrapT": wrap}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3", **extent},
            {"bufferView": 1, "componentType": _FLOAT, "count": count, "type": "VEC2"},
            {"bufferView": 2, "componentType": _UINT32, "count": corners, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": length}],
    }


_WRITERS: dict[str, Callable[[_Files, TexturedSurface, list[str]], None]] = {
    ".obj": _write_obj,
    ".vtp": _write_vtp,
    ".glb": _write_glb,
    ".ply": _write_ply,
}
_BESIDE = {".obj": (".mtl", ".png"), ".vtp": (".png",)}
TEXTURED_ENDINGS = tuple(_WRITERS)
"""Endings of the files that `write_textured` writes."""
