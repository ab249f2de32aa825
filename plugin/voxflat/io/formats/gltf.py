"""Write glTF 2.0 without VTK, whose exporter requires a render window."""

import json
import struct
from pathlib import Path

from voxflat.io.grid import millimetres
from voxflat.io.triangles import Faces, Points, as_float32

_FLOAT, _UINT32 = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _MIPMAPS, _REPEAT, _CLAMP = 9729, 9987, 10497, 33071


def write_glb(
    path: Path,
    points: Points,
    faces: Faces,
    texture: Points,
    picture: bytes,
    *,
    unit: str,
    repeat: bool,
    transparent: bool,
) -> None:
    """Write a binary glTF file; the picture is a PNG, and the texture coordinate t is 0 at its bottom edge.

    glTF is in metres with y upwards. Points of an unknown unit, such as those of OBJ and GLB files, keep their
    coordinates; those of a known unit are scaled, and RAS+ is turned so that its z axis points upwards.
    """
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
    wrap, count = _REPEAT if repeat else _CLAMP, len(points)
    extent = {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
    look = {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1}
    alpha = "BLEND" if transparent else "OPAQUE"
    described = {
        "asset": {"version": "2.0", "generator": "voxflat"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": _to_metres(unit)}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": look, "doubleSided": True, "alphaMode": alpha}],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": wrap, "wrapT": wrap}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3", **extent},
            {"bufferView": 1, "componentType": _FLOAT, "count": count, "type": "VEC2"},
            {"bufferView": 2, "componentType": _UINT32, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    content = _padded(json.dumps(described, allow_nan=False).encode(), b" ")
    chunks = struct.pack("<I4s", len(content), b"JSON") + content + struct.pack("<I4s", len(body), b"BIN\0") + body
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _to_metres(unit: str) -> list[float]:
    """Return the transformation to metres with y upwards, column by column."""
    if unit == "unknown":
        return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    scale = millimetres(unit) / millimetres("m")
    return [scale, 0, 0, 0, 0, 0, -scale, 0, 0, scale, 0, 0, 0, 0, 0, 1]


def _padded(block: bytes, filler: bytes) -> bytes:
    return block + filler * (-len(block) % 4)
