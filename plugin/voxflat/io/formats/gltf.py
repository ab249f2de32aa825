"""Read binary glTF 2.0 after comparing all counts with the file; write it without VTK, which needs a render window."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.files import AGAIN, from_json
from voxflat.io.grid import millimetres
from voxflat.io.reading import check_room
from voxflat.io.triangles import Faces, Points, as_float32, of_strips

_FLOAT, _UINT32 = 5126, 5125
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", _UINT32: "<u4", _FLOAT: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}  # other types are not those of positions
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_BYTES = 160  # of memory for each point and corner
_LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
_REMEDY = "Export the surface again as one .glb file, without compression"
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
    is_ras: bool,
    repeat: bool,
    transparent: bool,
) -> None:
    """Write a binary glTF file; the picture is a PNG, and the texture coordinate t is 0 at its bottom edge.

    glTF is in metres with y upwards. Points of an unknown unit, such as those of OBJ and GLB files, keep their
    coordinates; those of a known unit are scaled, and RAS+ is turned so that its z axis points upwards. Other axes
    stay.
    """
    single = as_float32(points)
    coordinates = texture * [1, -1] + [0, 1]  # t runs downwards in glTF
    arrays = (single.astype("<f4"), coordinates.astype("<f4"), faces.astype("<u4"))
    blocks = [*(array.tobytes() for array in arrays), picture]
    views, offset = [], 0
    for block, target in zip(blocks, (_VERTICES, _VERTICES, _INDICES, None), strict=True):
        view = {"buffer": 0, "byteOffset": offset, "byteLength": len(block)}
        views.append(view if target is None else {**view, "target": target})
        offset += len(_padded(block, b"\0"))
    body = b"".join(_padded(block, b"\0") for block in blocks)
    wrap, count = _REPEAT if repeat else _CLAMP, len(points)
    extent = {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
    look = {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1}
    alpha = "BLEND" if transparent else "OPAQUE"
    described = {
        "asset": {"version": "2.0", "generator": "voxflat"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": _to_metres(unit, is_ras)}],
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


def _to_metres(unit: str, is_ras: bool) -> list[float]:
    """Return the transformation to metres with y upwards, column by column."""
    scale = 1.0 if unit == "unknown" else millimetres(unit) / millimetres("m")
    if is_ras and unit != "unknown":
        return [scale, 0, 0, 0, 0, 0, -scale, 0, 0, scale, 0, 0, 0, 0, 0, 1]
    return [scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, 1]


def _padded(block: bytes, filler: bytes) -> bytes:
    return block + filler * (-len(block) % 4)


def read_glb(path: Path, data: bytes) -> dict[str, Any]:
    """Read the surfaces of a GLB file and their texture coordinates, and merge them into one; no picture is opened."""
    content, body = _chunks(data)
    others = [name for name in content.get("extensionsRequired", ()) if not name.startswith(_LOOKS)]
    if others:
        raise InputError(f"requires the glTF extension {others[0]!r:.80}, which voxflat does not read. {_REMEDY}")
    parts = []
    for matrix, part in _parts(content):
        if part.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN):  # not points or lines
            named = part["attributes"]
            accessors = ((named["POSITION"], 3), (part.get("indices"), 1), (named.get("TEXCOORD_0"), 2))
            parts.append((matrix, part.get("mode", _TRIANGLES), *(_stored(content, body, *key) for key in accessors)))
    check_room(
        _BYTES * sum(len(array) for _, _, *arrays in parts for array, _ in arrays)
    )  # parts may share their values
    points, faces, texture = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], [np.empty((0, 2))]
    for matrix, mode, (positions, scale), (corners, _), (places, share) in parts:
        turn = -1 if np.linalg.det(matrix[:3, :3]) < 0 else 1  # a mirrored surface keeps its outside
        numbers = corners.ravel().astype(np.int64) if len(corners) else np.arange(len(positions))
        faces.append(_triangles(numbers, mode)[:, ::turn] + sum(map(len, points)))
        points.append(_scaled(positions, scale) @ matrix[:3, :3].T + matrix[:3, 3])
        unplaced = np.full((len(positions), 2), np.nan)
        texture.append(_scaled(places, share) * [1, -1] + [0, 1] if len(places) else unplaced)
    if not sum(map(len, faces)):
        raise InputError("has no triangles. Export the surface as triangles")
    coordinates = np.concatenate(texture)
    is_textured = bool(np.isfinite(coordinates).any())
    read = {"points": np.concatenate(points), "faces": np.concatenate(faces)}
    return {**read, "texture_coordinates": coordinates if is_textured else None}


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the description and the binary data of a file."""
    version, length, size = (int(n) for n in np.frombuffer(data[4:16].ljust(12, b"\0"), "<u4"))
    if len(data) < max(length, 20) or 20 + size > length:
        raise InputError(f"ends after {len(data)} of {max(length, 20 + size)} bytes. {AGAIN}")
    if version != 2 or data[16:20] != b"JSON":
        raise InputError(f"is not a GLB file of version 2. {_REMEDY}")
    rest = data[20 + size : length]
    told = int.from_bytes(rest[:4], "little") if rest[4:8] == b"BIN\0" else 0
    if 8 + told > max(len(rest), 8):
        raise InputError(f"ends after {len(rest) - 8} of {told} bytes of its values. {AGAIN}")
    content = from_json(data[20 : 20 + size])
    if not isinstance(content, dict):
        raise InputError(f"does not describe its surfaces. {_REMEDY}")
    return content, rest[8 : 8 + told]


def _at(content: dict[str, Any], kind: str, number: object) -> dict[str, Any]:
    """Return an entry of the description."""
    entries = content.get(kind, [])
    if type(number) is not int or not 0 <= number < len(entries) or not isinstance(entries[number], dict):
        raise InputError(f"refers to entry {number!r:.80} of its {kind}, which does not exist. {_REMEDY}")
    entry: dict[str, Any] = entries[number]
    return entry


def _parts(content: dict[str, Any]) -> Iterator[tuple[NDArray[np.float64], dict[str, Any]]]:
    """Return each part of the scene with the matrix that places it."""
    nodes = content.get("nodes", [])
    children = {child for node in nodes for child in node.get("children", ())}
    roots = [number for number in range(len(nodes)) if number not in children]
    if "scenes" in content:
        roots = _at(content, "scenes", content.get("scene", 0)).get("nodes", [])
    seen, waiting = set(), [(number, np.eye(4)) for number in roots[::-1]]
    while waiting:
        number, around = waiting.pop()
        node = _at(content, "nodes", number)
        if number in seen:
            raise InputError(f"places node {number} of its scene twice. {_REMEDY}")
        seen.add(number)
        matrix = around @ _placed(node)
        waiting += [(child, matrix) for child in node.get("children", [])[::-1]]
        for part in _at(content, "meshes", node["mesh"])["primitives"] if "mesh" in node else ():
            yield matrix, part


def _placed(node: dict[str, Any]) -> NDArray[np.float64]:
    """Return the matrix that a node defines, possibly as translation, rotation (a quaternion) and scale."""
    if "matrix" in node:
        return np.asarray(np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T)
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), dtype=np.float64)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned = np.eye(3) + 2 / (x * x + y * y + z * z + w * w) * (w * cross + cross @ cross)
    matrix[:3, :3] = turned * np.array(node.get("scale", [1, 1, 1]), dtype=np.float64).reshape(3)
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _stored(content: dict[str, Any], body: bytes, number: object, columns: int) -> tuple[NDArray[Any], int]:
    """Return the values (N, columns) in the file that an accessor describes (none for None), and their divisor."""
    if number is None:
        return np.empty((0, columns)), 1
    accessor = _at(content, "accessors", number)
    if "sparse" in accessor or "bufferView" not in accessor:
        raise InputError(f"stores values {number} in a compressed form. {_REMEDY}")
    view, kind = _at(content, "bufferViews", accessor["bufferView"]), np.dtype(_TYPES[accessor["componentType"]])
    if "uri" in _at(content, "buffers", view["buffer"]) or view["buffer"] != 0:
        raise InputError(f"stores values {number} outside the file. {_REMEDY}")
    if _COLUMNS.get(accessor["type"]) != columns:
        raise InputError(f"stores values {number} as {accessor['type']!r:.80}. {_REMEDY}")
    count, row = accessor["count"], columns * kind.itemsize
    step, start, offset = view.get("byteStride", row), view.get("byteOffset", 0), accessor.get("byteOffset", 0)
    numbers = (count, step, start, offset, view["byteLength"])
    if not all(type(number) is int and number >= 0 for number in numbers) or count < 1 or step < row:
        raise InputError(f"its header is damaged: the size of values {number} is {numbers!r:.80}. {AGAIN}")
    if offset + step * (count - 1) + row > view["byteLength"] or start + view["byteLength"] > len(body):
        raise InputError(f"its header specifies {count} values, but the file contains {len(body)} bytes. {AGAIN}")
    values: NDArray[Any] = np.ndarray((count, columns), kind, body, start + offset, (step, kind.itemsize))
    return values, np.iinfo(kind).max if accessor.get("normalized") and kind.kind != "f" else 1


def _scaled(values: NDArray[Any], divisor: int) -> NDArray[np.float64]:
    """Return values as numbers; whole numbers may be shares of the largest one."""
    return np.asarray(values.astype(np.float64) if divisor == 1 else np.maximum(values / divisor, -1.0))


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the corners of the triangles of a list, a strip or a fan."""
    if mode == _STRIP:
        return of_strips([corners])
    if mode == _FAN:
        first = np.full(max(len(corners) - 2, 0), corners[0])
        return np.stack([first, corners[1:-1], corners[2:]], axis=1)
    if len(corners) % 3:
        raise InputError(f"has {len(corners)} corners of triangles, which is not a multiple of 3. {AGAIN}")
    return corners.reshape(-1, 3)
