"""Drift of painted points in movies with known movement, beside maps of single frames and blender-tissue-cartography.

    python docs/benchmarks/tissue_series.py --peer PYTHON    # an interpreter with blender-tissue-cartography

Each movie deforms a surface; each frame has its own mesh. 500 points move with the material. Prints the median
and the 95th percentile of the distance between where a method finds them and where they are, in µm and in % of the
length of the surface, over all frames and in the last frame. Maps of single frames are aligned with the points
themselves, by the best similarity. `--peer` wraps the first mesh onto each frame in turn (`shrinkwrap_igl`), and
through aligned spheres (`wrap_coords_via_sphere`).
"""

import argparse
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy.spatial

import voxflat
from voxflat import _core

PEER = """
import sys, time, warnings
import numpy as np
from blender_tissue_cartography import harmonic, mesh, wrapping
warnings.simplefilter("ignore")
np._core.numerictypes.sctypeDict["complex_"] = np.complex128  # removed from NumPy 2
given = np.load(sys.argv[1])
count = int(given["count"])
meshes = [mesh.ObjMesh(given[f"points{t}"], given[f"faces{t}"].tolist()) for t in range(count)]
for each in meshes:
    each.set_normals()
found = {}
for name in ("shrinkwrap_igl", "wrap_coords_via_sphere"):
    begun, places = time.process_time(), [meshes[0].vertices]
    moved = meshes[0]
    try:
        for frame in meshes[1:]:
            if name == "shrinkwrap_igl":
                moved = wrapping.shrinkwrap_igl(moved, frame)
                places.append(moved.vertices)
            else:
                places.append(harmonic.wrap_coords_via_sphere(meshes[0], frame)[0])
        found[name], found[name + "_s"] = np.array(places), time.process_time() - begun
    except Exception as error:
        print(name, "failed:", repr(error)[:200])
np.savez(sys.argv[2], **found)
"""


def sphere(count, seed):
    """Return a mesh of the unit sphere with uneven vertices; each seed has others."""
    rng = np.random.default_rng(seed)
    step = np.arange(count) + 0.5
    z, turn = 1 - 2 * step / count, step * np.pi * (1 + np.sqrt(5))
    points = np.column_stack([np.cos(turn) * np.sqrt(1 - z**2), np.sin(turn) * np.sqrt(1 - z**2), z])
    points = points @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for _ in range(3):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        points = points + 0.35 * np.sin(2 * points @ axis + rng.uniform(0, 6))[:, None] * np.cross(axis, points)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = scipy.spatial.ConvexHull(points).simplices
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    inwards = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    return points, faces.astype(np.int64)


def tube(count, seed):
    """Return a mesh of an open tube of length 2 and radius 1 along x, with about as many vertices."""
    rng = np.random.default_rng(seed)
    side = round(np.sqrt(count / 1.5))
    rings = count // side
    along = np.linspace(-1, 1, rings)[:, None] + np.zeros(side)
    along[1:-1] += rng.uniform(-0.5, 0.5, (rings - 2, side)) / rings
    turn = 2 * np.pi * (np.arange(side) + 0.3 * np.sin(4 * np.arange(side)) + rng.uniform()) / side + 0.3 * along
    points = np.column_stack([along.ravel(), np.cos(turn).ravel(), np.sin(turn).ravel()])
    corners = np.arange(rings * side).reshape(rings, side)
    a, b = corners[:-1].ravel(), corners[1:].ravel()
    c, d = (np.roll(part, -1, axis=1).ravel() for part in (corners[1:], corners[:-1]))
    return points, np.concatenate([np.column_stack([a, c, b]), np.column_stack([a, d, c])])


def disk(count, seed):
    """Return a flat mesh of the unit disk; each seed has other vertices."""
    rim = round(2 * np.sqrt(np.pi * count) / 2)
    turn = 2 * np.pi * (np.arange(rim) + np.random.default_rng(seed).uniform()) / rim
    step = np.arange(count - rim) + 0.5
    radius, spiral = (1 - np.pi / rim) * np.sqrt(step / len(step)), step * np.pi * (1 + np.sqrt(5)) + seed
    plane = np.concatenate(
        [
            np.column_stack([np.cos(turn), np.sin(turn)]),
            radius[:, None] * np.column_stack([np.cos(spiral), np.sin(spiral)]),
        ]
    )
    return np.column_stack([plane, np.zeros(len(plane))]), scipy.spatial.Delaunay(plane).simplices.astype(np.int64)


def growing(points, time):
    """Grow an ellipsoid of 200 x 90 x 70 µm by half in all directions."""
    return points * np.array([100, 45, 35]) * (1 + 0.5 * time)


def bending(points, time):
    """Grow it by 40 % in length, 15 % in width and 10 % in height, and bend it by 70 degrees."""
    length = 100 * (1 + 0.4 * time)
    x, y, z = (points * [length, 45 * (1 + 0.15 * time), 35 * (1 + 0.1 * time)]).T
    if time == 0:
        return np.column_stack([x, y, z])
    radius = 2 * length / (np.radians(70) * time)
    return np.column_stack([(radius - z) * np.sin(x / radius), y, radius - (radius - z) * np.cos(x / radius)])


def peristalsis(points, time):
    """Let a contraction by 35 % pass from one end of an ellipsoid to the other."""
    x = 100 * points[:, 0]
    narrow = 1 - 0.35 * np.exp(-(((x + 60 - 120 * time) / 18) ** 2))
    return np.column_stack([x, 34 * narrow * points[:, 1], 28 * narrow * points[:, 2]])


def bending_disk(points, time):
    """Bend a disk with a diameter of 200 µm by 90 degrees, to a part of a cylinder."""
    turn = max(time, 1e-6) * np.pi / 2
    x, y, _ = (100 * points).T
    return np.column_stack([200 / turn * np.sin(turn * x / 200), y, 200 / turn * (1 - np.cos(turn * x / 200))])


def convergent_extension(points, time):
    """Lengthen a tube by half and narrow it, at constant area."""
    factor = 1 + 0.5 * time
    return points * np.array([100 * factor, 34 / np.sqrt(factor), 28 / np.sqrt(factor)])


def bud(points, time):
    """Let a bud grow from a sphere with a diameter of 120 µm, outwards from the centre."""
    near = np.exp(-((points - [0, 0, 1]) ** 2).sum(axis=1) / 0.3)
    return 60 * points * (1 + 0.9 * time * near)[:, None]


MOVIES = {
    "growing": (sphere, growing, 11),
    "bending": (sphere, bending, 11),
    "peristalsis": (sphere, peristalsis, 31),
    "peristalsis of an open tube": (tube, peristalsis, 31),
    "bending disk": (disk, bending_disk, 11),
    "convergent extension of a tube": (tube, convergent_extension, 11),
    "bud": (sphere, bud, 11),
}


def places_on(points, faces, wanted):
    """Return corners and barycentric coordinates of the nearest places on a surface."""
    faces = faces.astype(np.uint32)
    triangles, weights, _ = _core.NearestFinder(np.ascontiguousarray(points), faces).find(wanted, np.inf)
    return faces[triangles], weights


def follow(frames, places):
    """Return where points on the first frame are in each frame, if its vertices move to `places` (T, V, 3)."""
    corners, weights = places_on(*frames[0][:2], frames[0][2])
    return np.einsum("pc,tpcx->tpx", weights, places[:, corners])


def aligned(places, onto):
    """Return positions in the plane after the best similarity without reflection."""
    z, w = (values @ [1, 1j] for values in (places - places.mean(axis=0), onto - onto.mean(axis=0)))
    turned = z * (np.vdot(z, w) / np.vdot(z, z))
    return np.column_stack([turned.real, turned.imag]) + onto.mean(axis=0)


def alone(frames):
    """Return the drift of points between maps of single frames, at the scale of the last one."""
    found = []
    for points, faces, painted in frames:
        flat_map = voxflat.flatten((points, faces))
        found.append(flat_map.points_to_map(painted)[0])
    return [np.linalg.norm(aligned(found[0], own) - own, axis=1) for own in found[1:]]


def show(name, method, apart, lengths, seconds):
    """Print one row of the table."""
    share = [100 * own / length for own, length in zip(apart, lengths, strict=True)]
    cells = []
    for values, relative in ((np.concatenate(apart), np.concatenate(share)), (apart[-1], share[-1])):
        cells.append(
            ", ".join(f"{np.percentile(values, q):.1f} ({np.percentile(relative, q):.2f} %)" for q in (50, 95))
        )
    print(f"| {name} | {method} | {cells[0]} | {cells[1]} | {seconds:.1f} |", flush=True)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer", help="interpreter with blender-tissue-cartography")
    parser.add_argument("--vertices", type=int, default=2000)
    parser.add_argument("--only", nargs="*", choices=list(MOVIES), default=list(MOVIES))
    options = parser.parse_args()
    print("| movie | method | drift, µm (% of length): median, 95 %, all frames | last frame | CPU s |")
    print("|---|---|---|---|---|")
    for name in options.only:
        mesh, move, count = MOVIES[name]
        painted = mesh(500, 999)[0]
        frames = []
        for t in range(count):
            points, faces = mesh(options.vertices + 37 * t, t)
            when = t / (count - 1)
            frames.append((move(points, when), faces, move(painted, when)))
        lengths = [np.ptp(truth, axis=0).max() for *_, truth in frames[1:]]

        def drift(places, frames=frames):
            found = follow(frames, places)
            return [np.linalg.norm(own - truth, axis=1) for own, (*_, truth) in zip(found[1:], frames[1:], strict=True)]

        begun = time.process_time()
        series = voxflat.flatten_series([(points, faces) for points, faces, _ in frames])
        seconds = time.process_time() - begun
        places = np.empty((count, len(frames[0][0]), 3))
        places[:, series.flat_map.ids] = series.points
        show(name, "flatten_series", drift(places), lengths, seconds)
        print(f"  folded triangles: {series.folded.sum()} of {count} frames, greatest gap {series.gaps.max():.2f} µm")
        begun = time.process_time()
        show(name, "each frame alone", alone(frames), lengths, time.process_time() - begun)
        if options.peer:
            with tempfile.TemporaryDirectory() as folder:
                given, found = Path(folder) / "given.npz", Path(folder) / "found.npz"
                arrays = {
                    f"{kind}{t}": frames[t][k] for t in range(count) for k, kind in enumerate(("points", "faces"))
                }
                np.savez(given, count=count, **arrays)
                subprocess.run([options.peer, "-c", PEER, str(given), str(found)], check=True)
                with np.load(found) as results:
                    for method in sorted({key.removesuffix("_s") for key in results.files}):
                        show(name, method, drift(results[method]), lengths, float(results[f"{method}_s"]))


if __name__ == "__main__":
    main()
