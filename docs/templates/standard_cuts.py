"""Derive the standard cuts from the flat maps of fsaverage5: ``standard_cuts.py FOLDER``.

The triangles of the sphere of fsaverage5 that are missing in its flat map form the medial wall and strips along the
five cuts. FOLDER contains smriprep (Apache-2.0), installed by ``pip install --target``, whose spheres lead from
fsaverage to fs_LR. The script writes four files of some kilobytes into the package, each with its provenance.
"""

import argparse
import hashlib
import json
from importlib.util import find_spec
from pathlib import Path

import nibabel as nib
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

import voxflat
from voxflat import _core

NILEARN = Path(find_spec("nilearn").origin).parent
FSAVERAGE5 = NILEARN / "datasets" / "data" / "fsaverage5"
PACKAGE = Path(voxflat.__file__).parent / "surfaces" / "standard"
SIDES = {"left": "L", "right": "R"}
STRIP = 3  # maximal rings of triangles between the border and the middle of a strip
SMALLEST = 12  # minimal triangles of a strip; smaller pieces are corners of the wall
STEP = 3.0  # mm between points of a line on the sphere with a radius of 100 mm
ANCHORS = 200
INWARD = 10.0  # minimal mm on the map between its border and an anchor
RADIUS = 100.0


def arrays(path):
    return [array.data for array in nib.load(path).darrays]


def keys(faces):
    """Return one item per triangle, independent of its orientation."""
    rows = np.ascontiguousarray(np.sort(faces, axis=1).astype(np.int64))
    return rows.view([("", rows.dtype)] * 3).ravel()


def unit(points):
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def neighbours_at_corners(faces, count):
    """Return the adjacency matrix of triangles that share a corner."""
    face = np.repeat(np.arange(len(faces)), 3)
    incidence = coo_matrix((np.ones(len(face)), (face, faces.ravel())), shape=(len(faces), count)).tocsr()
    return incidence @ incidence.T


def opened(missing, beside):
    """Return the medial wall: the largest piece of the eroded missing triangles, dilated again."""
    core = missing.copy()
    for _ in range(STRIP):
        core &= ~(beside @ ~core > 0)
    _, piece = connected_components(beside[core][:, core], directed=False)
    wall = np.zeros_like(missing)
    wall[np.flatnonzero(core)[piece == np.bincount(piece).argmax()]] = True
    for _ in range(STRIP):
        wall |= missing & (beside @ wall > 0)
    return wall


def evenly(points, step=STEP, closed=False):
    """Return smoothed, equidistant points of a line on the sphere."""
    points = unit(np.asarray(points))
    for _ in range(3):
        around = (np.roll(points, 1, 0) + 2 * points + np.roll(points, -1, 0)) / 4
        points = unit(around if closed else np.concatenate([points[:1], around[1:-1], points[-1:]]))
    if closed:
        points = np.concatenate([points, points[:1]])
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]) * RADIUS
    count = max(3, round(lengths[-1] / step) + 1)
    at = np.linspace(0, lengths[-1], count)
    even = unit(np.column_stack([np.interp(at, lengths, points[:, axis]) for axis in range(3)]))
    return even[:-1] if closed else even


def centre_line(strip, wall, sphere, faces, touching):
    """Return the line through the middle of a strip, from the wall to the far end."""
    centres = unit(sphere[faces].mean(axis=1))
    chosen = np.flatnonzero(strip)
    graph = touching[chosen][:, chosen].tocoo()
    steps = np.linalg.norm(centres[chosen[graph.row]] - centres[chosen[graph.col]], axis=1)
    graph = coo_matrix((steps + 1e-9, (graph.row, graph.col)), shape=graph.shape).tocsr()
    at_wall = np.flatnonzero(np.isin(chosen, np.flatnonzero(touching @ wall > 0)))
    distance = dijkstra(graph, directed=False, indices=at_wall).min(axis=0)
    tip = int(np.where(np.isfinite(distance), distance, -1).argmax())
    # the means of distance bands across the strip form its middle
    width = 0.03
    bands = np.round(distance / width).astype(int)
    strips = (chosen[bands == band] for band in range(bands[tip] + 1))
    line = [unit(centres[strip].mean(axis=0)) for strip in strips if len(strip)]
    corners = faces[chosen[tip]]
    end = sphere[corners[np.argmax(np.linalg.norm(unit(sphere[corners]) - line[max(0, len(line) - 3)], axis=1))]]
    wall_point = unit(sphere[np.unique(faces[wall])])
    root = wall_point[np.argmin(np.linalg.norm(wall_point - line[0], axis=1))]
    return evenly([root, *line, unit(end)])


def outline(wall, faces, sphere):
    """Return the closed line around the wall, with the cortex on its left as seen from outside."""
    kept = faces[~wall]
    edges = np.concatenate([kept[:, [0, 1]], kept[:, [1, 2]], kept[:, [2, 0]]])
    inside = {tuple(edge) for face in faces[wall].tolist() for edge in (face[:2], face[1:], face[::2][::-1])}
    following = {a: b for a, b in edges.tolist() if (b, a) in inside}
    start = min(following)
    loop = [start]
    while following[loop[-1]] != start:
        loop.append(following[loop[-1]])
    assert len(loop) == len(following), "the wall has one boundary"
    return evenly(sphere[loop], closed=True)


def named(lines, white, sphere):
    """Name the lines by their positions on the white surface, mm."""
    tree = KDTree(unit(sphere))
    where = [white[tree.query(line)[1]] for line in lines]
    tips = np.array([place[-1] for place in where])
    names = {int(np.argmin(tips[:, 1])): "calcarine"}
    rest = set(range(5)) - set(names)
    temporal = min(rest, key=lambda i: where[i][:, 2].mean() + abs(where[i][:, 1]).mean())
    names[temporal] = "temporal"
    middle = sorted(rest - {temporal}, key=lambda i: -tips[i, 1])
    names.update({of: f"medial {number}" for number, of in enumerate(middle, 1)})
    ends = {names[i]: np.round(place[[0, -1]]).tolist() for i, place in enumerate(where)}
    return {names[i]: lines[i] for i in sorted(names, key=names.get)}, ends


def anchors(flat, faces, white):
    """Return evenly spaced vertices of the map, away from its border."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    single, counts = np.unique(edges, axis=0, return_counts=True)
    border = np.unique(single[counts == 1])
    inner = np.setdiff1d(np.unique(faces), border)
    inner = inner[KDTree(flat[border]).query(flat[inner])[0] > INWARD]
    chosen = [int(inner[np.argmin(np.linalg.norm(flat[inner] - flat[inner].mean(axis=0), axis=1))])]
    distance = np.linalg.norm(flat[inner] - flat[chosen[0]], axis=1)
    while len(chosen) < ANCHORS:
        chosen.append(int(inner[distance.argmax()]))
        distance = np.minimum(distance, np.linalg.norm(flat[inner] - flat[chosen[-1]], axis=1))
    return np.array(sorted(chosen))


def carried(points, from_, to, faces):
    """Map points from one sphere to another by the triangles that contain them."""
    from_, to = unit(from_), unit(to)
    face, _ = _core.locate_on_sphere(from_.astype(float), faces.astype(np.int64), points)
    corners = faces[face]
    weights = np.linalg.solve(from_[corners].transpose(0, 2, 1), points[..., None])
    return unit((weights * to[corners]).sum(axis=1))


def sha256(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def rounded(points, digits=5):
    return np.round(points, digits).tolist()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    atlases = parser.parse_args().folder / "smriprep" / "data" / "atlases"
    found = {side: derived(side, atlases) for side in SIDES}
    turn = alike(found)
    for side, one in found.items():
        for space in ("fsaverage", "fs_LR"):
            path = PACKAGE / f"{space}.{side}.json"
            path.write_text(json.dumps(one[space]) + "\n", encoding="utf-8")
            cuts = {cut["name"]: len(cut["line"]) for cut in one[space]["cuts"]}
            print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB, {cuts}")
        print(side, one["where"])
    print(f"the right map was rotated by {np.degrees(turn):.2f} degrees to become the mirror image of the left map")


def derived(side, atlases):
    files = {name: FSAVERAGE5 / f"{name}_{side}.gii.gz" for name in ("sphere", "flat", "white")}
    (sphere, faces), (flat, flat_faces), (white, _) = (arrays(path) for path in files.values())
    sphere, white, flat = sphere.astype(float), white.astype(float), flat[:, :2].astype(float)
    missing = ~np.isin(keys(faces), keys(flat_faces))
    touching = neighbours_at_corners(faces, len(sphere))
    wall = opened(missing, touching)
    rest = np.flatnonzero(missing & ~wall)
    _, piece = connected_components(touching[rest][:, rest], directed=False)
    strips = [rest[piece == number] for number in range(piece.max() + 1)]
    strips = [strip for strip in strips if len(strip) >= SMALLEST]
    assert len(strips) == 5, [len(strip) for strip in strips]
    lines = []
    for strip in strips:
        is_strip = np.zeros(len(faces), dtype=bool)
        is_strip[strip] = True
        lines.append(centre_line(is_strip, wall, sphere, faces, touching))
    lines, where = named(lines, white, sphere)
    chosen = anchors(flat, flat_faces, white)
    letter = SIDES[side]
    folder = atlases / f"fs_{letter}"
    leading = {
        "from": folder / f"fsaverage.{letter}.sphere.164k_fs_{letter}.surf.gii",
        "to": folder / f"fs_{letter}-to-fs_LR_fsaverage.{letter}_LR.spherical_std.164k_fs_{letter}.surf.gii",
    }
    from_, dense = arrays(leading["from"])
    to = arrays(leading["to"])[0]
    source = {
        "derived from": "the flat maps of fsaverage5 (FreeSurfer) as nilearn 0.14 carries them",
        "by": "docs/templates/standard_cuts.py",
        "files": {f"fsaverage5/{path.name}": sha256(path) for path in files.values()},
    }
    to_fs_lr = {
        "to fs_LR by": "spheres of smriprep 0.19.5 (Apache-2.0)",
        "spheres": {path.name: sha256(path) for path in leading.values()},
    }
    around = outline(wall, faces, sphere)
    out = {"where": where}
    for space in ("fsaverage", "fs_LR"):
        place = (lambda points: points) if space == "fsaverage" else (lambda p: carried(p, from_, to, dense))
        out[space] = {
            "voxflat": "template",
            "format": 1,
            "name": "standard",
            "space": space,
            "side": side,
            "outlines": [{"name": "medial wall", "line": rounded(place(around))}],
            "cuts": [{"name": name, "root": "medial wall", "line": rounded(place(of))} for name, of in lines.items()],
            "anchors": {
                "sphere": rounded(place(unit(sphere[chosen]))),
                "flat": rounded(flat[chosen], 2),
                "white": rounded(white[chosen], 1),
            },
            "provenance": source | (to_fs_lr if space == "fs_LR" else {}),
        }
    return out


def alike(found):
    """Rotate the anchors of the right map so that the maps are mirror images, by homologous points of fs_LR."""
    left, right = (found[side]["fs_LR"]["anchors"] for side in SIDES)
    on_right = np.array(right["sphere"])
    flat = np.array(right["flat"])
    mirrored = np.array(left["sphere"]) * [-1, 1, 1]
    near, nearest = KDTree(on_right).query(mirrored)
    pairs = near < 0.1
    goal = np.array(left["flat"])[pairs] * [-1, 1]
    turned, turn = _core.turn_onto(flat, flat[nearest[pairs]], goal)
    for space in ("fsaverage", "fs_LR"):
        found["right"][space]["anchors"]["flat"] = rounded(turned, 2)
    return turn


if __name__ == "__main__":
    main()
