"""Load published flat maps without moving a point, and write regions back to their vertices.

    python docs/benchmarks/given_maps.py FLAT[=SURFACE] ... [--other FLAT=SURFACE ...]

Each FLAT is loaded alone and, if SURFACE is given, with its surface. FLAT and SURFACE are files, or `fsaverage5:left`
and `fsaverage5:right` for those that nilearn includes. The two flat maps of fsaverage5 are also written in the layouts
of Blender (.obj with seams) and glTF (.glb). The positions must equal those of the file exactly, as nibabel or a parser
in this script reads them, and a region drawn on the map must have the vertices that a test of each vertex finds.

A FLAT passed with a SURFACE is also loaded without its recorded side, and must not be reported as a map of the other
hemisphere. The pairs of --other, such as a left map and a right surface, must be reported.
"""

import argparse
import json
import logging
import tempfile
import time
from pathlib import Path

import nibabel
import numpy as np
import trimesh
from nilearn.datasets import load_fsaverage
from tables import table

import voxflat

OUTLINE = np.array([(0.13, 0.41), (0.47, 0.17), (0.83, 0.39), (0.61, 0.53), (0.71, 0.87), (0.29, 0.71)])
"""Corners of the region, as shares of the width and the height of the map."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="*", metavar="FLAT[=SURFACE]")
    parser.add_argument("--other", nargs="+", default=[], metavar="FLAT=SURFACE")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    rows = [row for given in options.maps for row in rows_of(*given.split("="))]
    with tempfile.TemporaryDirectory() as folder:
        for name, path in unwrapped(Path(folder)).items():
            rows.append(checked(name, path, None, *corners_of(path)))
    head = ["map", "surface", "points", "positions that differ", "vertices of the region", "wrong", "s"]
    table("Published flat maps: positions and a region", head, [[str(cell) for cell in row] for row in rows])
    pairs = [given.split("=") for given in options.maps if "=" in given]
    wrong = [
        (name, is_other)
        for pairs, is_other in ((pairs, False), ([o.split("=") for o in options.other], True))
        for name in pairs
        if is_reported(*name) != is_other
    ]
    print(f"{len(pairs)} right pairs and {len(options.other)} wrong ones, without sides. Misjudged: {wrong or 'none'}")
    if wrong or any(row[3] or row[5] for row in rows):
        raise SystemExit("a position, a region or a side is wrong")


def rows_of(flat, surface=None):
    """Check a map alone, and with its surface."""
    points, faces = read(flat, "flat")
    vertices = np.unique(faces)
    known = vertices, points[vertices, :2]
    name = Path(flat).name
    yield checked(name, given(flat, "flat"), None, *known)
    if surface is not None:
        yield checked(name, given(flat, "flat"), given(surface, "white_matter"), *known)


def is_reported(flat, surface):
    """Return whether a warning reports that the map belongs to the other hemisphere, although no side is recorded."""
    loaded = voxflat.load(read(flat, "flat"), read(surface, "white_matter"))
    return any("probably belongs to the other hemisphere" in text for text in loaded.warnings)


def given(name, kind):
    """Return a file name, or a mesh of nilearn."""
    mesh, _, side = name.partition(":")
    return load_fsaverage(mesh)[kind].parts[side] if mesh == "fsaverage5" else name


def read(name, kind):
    """Return the points and triangles of a file, as another reader than that of voxflat reads them."""
    if name.startswith("fsaverage5:"):
        mesh = given(name, kind)
        return mesh.coordinates, mesh.faces
    image = nibabel.load(name)
    return image.agg_data("pointset"), image.agg_data("triangle")


def checked(name, flat, surface, vertices, places):
    """Return the row of a map; `vertices` and `places` are the vertices and positions in its file."""
    start = time.perf_counter()
    loaded = voxflat.load(flat, surface)
    seconds = time.perf_counter() - start
    expected = {(int(vertex), *place) for vertex, place in zip(vertices, np.float64(places).tolist(), strict=True)}
    found = {(int(vertex), *place) for vertex, place in zip(loaded.ids, loaded.uv.tolist(), strict=True)}
    low, high = places.min(axis=0).astype(np.float64), places.max(axis=0).astype(np.float64)
    outline = low + OUTLINE * (high - low)
    inside = np.unique(vertices[within(np.float64(places), outline)])
    drawn = np.flatnonzero(loaded.regions({"region": outline}).vertex_labels)
    wrong = len(np.setxor1d(inside, drawn))
    known = "–" if not loaded.has_surface else "in the file" if surface is None else "given"
    return [name, known, len(loaded), len(expected ^ found), len(inside), wrong, f"{seconds:.1f}"]


def within(places, outline):
    """Return whether positions are within a polygon, by counting the sides to their right."""
    crossings = np.zeros(len(places), dtype=int)
    for (u0, v0), (u1, v1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        is_beside = (places[:, 1] >= v0) != (places[:, 1] >= v1)
        with np.errstate(all="ignore"):
            crossings += is_beside & (places[:, 0] < u0 + (places[:, 1] - v0) / (v1 - v0) * (u1 - u0))
    return crossings % 2 == 1


def unwrapped(folder):
    """Write the map of fsaverage5 as two islands, with the layouts of Blender (.obj) and glTF (.glb)."""
    white, flat = (load_fsaverage("fsaverage5")[kind].parts["left"] for kind in ("white_matter", "flat"))
    faces = np.asarray(flat.faces)
    places = np.float64(flat.coordinates)[:, :2][faces]
    places[places[..., 0].mean(axis=1) > 0] += (20.0, 5.0)  # the second island
    places = np.round((places - places.min(axis=(0, 1))) / np.ptp(places), 6)
    rows, numbers = np.unique(places.reshape(-1, 2), axis=0, return_inverse=True)
    numbers = numbers.reshape(-1, 3)
    lines = ["# Blender 4.2", "mtllib cortex.mtl", "o Cortex"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in np.asarray(white.coordinates).tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in rows.tolist()]
    lines += ["s 1", "usemtl Material"]
    for face, texture in zip((faces + 1).tolist(), (numbers + 1).tolist(), strict=True):
        lines.append("f " + " ".join(f"{a}/{b}/{a}" for a, b in zip(face, texture, strict=True)))
    normals = [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in trimesh.Trimesh(white.coordinates, faces).vertex_normals]
    first = lines.index("s 1")
    (folder / "blender.obj").write_text("\n".join([*lines[:first], *normals, *lines[first:]]) + "\n")
    corners = np.unique(np.column_stack([faces.ravel(), numbers.ravel()]), axis=0, return_inverse=True)
    points = np.asarray(white.coordinates)[corners[0][:, 0]]
    visual = trimesh.visual.TextureVisuals(uv=rows[corners[0][:, 1]])
    split = trimesh.Trimesh(points, corners[1].reshape(-1, 3), visual=visual, process=False)
    split.export(folder / "islands.glb")
    return {"Blender, two islands": folder / "blender.obj", "glTF, two islands": folder / "islands.glb"}


def corners_of(path):
    """Return the vertices and the positions of the corners of a file with texture coordinates."""
    if path.suffix == ".glb":
        data = path.read_bytes()
        length = int.from_bytes(data[12:16], "little")
        head, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
        accessor = head["accessors"][head["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
        start = head["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
        places = np.frombuffer(binary, "<f4", 2 * accessor["count"], start).reshape(-1, 2).astype(np.float64)
        return np.arange(len(places)), np.column_stack([places[:, 0], 1 - places[:, 1]])  # glTF has v downwards
    lines = [line.split() for line in path.read_text().splitlines()]
    places = np.array([line[1:3] for line in lines if line[:1] == ["vt"]], dtype=np.float64)
    pairs = np.array([corner.split("/")[:2] for line in lines if line[:1] == ["f"] for corner in line[1:]], dtype=int)
    pairs = np.unique(pairs, axis=0) - 1
    return pairs[:, 0], places[pairs[:, 1]]


if __name__ == "__main__":
    main()
