"""Write glTF 2.0 without VTK, whose exporter requires a render window."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.io.triangles import Faces, Points, as_float32

_FLOAT, _UINT32 = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _MIPMAPS, _REPEAT, _CLAMP = 9729, 9987, 10497, 33071
_TO_METRES_Y_UP = [1e-3, 0, 0, 0, 0, 0, -1e-3, 0, 0, 1e-3, 0, 0, 0, 0, 0, 1]  # column by column


def write_glb(
    path: Path, points: Points, faces: Faces, texture: Points, picture: bytes, *, repeat: bool, transparent: bool
) -> None:
    """Write a binary glTF file; the picture is a PNG, and the texture coordinate t is 0 at its bottom edge."""
    single = as_float32(points)
    coordinates = texture * [1, -1] + [0, 1]  # t runs downwards in glTF
    arrays = (single.astype("<f4"), coordinates.astype("<f4"), faces.astype("<u4"))
    blocks = [*(array.tobytes() for array in arrays), picture]
    views, at = [], 0
    for block, target in zip(blocks, (_VERTICES, _VERTICES, _INDICES, None), strict=True):
        view = {"buffer": 0, "byteOffset": at, "byteLength": len(block)}
        views.append(view if target is None else {**view, "target": target})
        at += len(_padded(block, b"\0"))
    body = b"".join(_padded(block, b"\0") for block in blocks)
    described = _described(single, faces.size, views, len(body), repeat=repeat, transparent=transparent)
    content = _padded(json.dumps(described, allow_nan=False).encode(), b" ")
    chunks = struct.pack("<I4s", len(content), b"JSON") + content + struct.pack("<I4s", len(body), b"BIN\0") + body
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _padded(block: bytes, filler: bytes) -> bytes:
    return block + filler * (-len(block) % 4)


def _described(
    points: NDArray[np.float32], corners: int, views: list[Any], length: int, *, repeat: bool, transparent: bool
) -> dict[str, Any]:
    """Return the JSON part of a glTF file; its only node maps RAS+ mm to metres, with y pointing upwards."""
    wrap, count = _REPEAT if repeat else _CLAMP, len(points)
    extent = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1},
        "doubleSided": True,
        "alphaMode": "BLEND" if transparent else "OPAQUE",
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
