"""Maps of real organs, beside the maps that their authors made in Blender and those of u-Unwrap3D.

    git clone https://github.com/nikolas-claussen/blender-tissue-cartography
    python docs/benchmarks/tissue.py blender-tissue-cartography --peer PYTHON    # an interpreter with u-Unwrap3D

The repository contains the surfaces and their stored UV maps, and an organoid as a TIFF file. All maps are measured by
exact distances from 60 random points per chart, within charts, each chart at its own best scale. The charts of UV maps
are scaled to the area of their surface first. u-Unwrap3D maps closed surfaces to the sphere (conformally, or with areas
relaxed); longitude and latitude are its map, with the organ's long axis from pole to pole and the aspect ratio of the
smallest distance error; triangles that contain a pole are omitted. CPU seconds and memory include the surface and all
charts, but not the measurement.
"""

import argparse
import concurrent.futures
import multiprocessing
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy.ndimage
import scipy.optimize
import scipy.sparse
import tables

import voxflat

LIBRARY, TUTORIALS = "nbs/Python library/datasets/", "nbs/Tutorials/"
MESHES = {
    "sheet": LIBRARY + "basics_example/basics_example_mesh_uv.obj",
    "fly embryo": LIBRARY + "drosophila_example/Drosophila_CAAX-mCherry_mesh_uv.obj",
    "fly embryo, sphere UV": LIBRARY + "registration_example/Drosophila_CAAX-mCherry_mesh_remeshed_sphere_uv.obj",
    "zebrafish, 1 chart": TUTORIALS + "fish_example/zebrafish_egg_nuclei_uv_first_iteration.obj",
    "zebrafish, 2 charts": TUTORIALS + "fish_example/zebrafish_egg_nuclei_uv_second_iteration.obj",
    "midgut, first UV": LIBRARY + "movie_example/initial_uv.obj",
    "midgut, final UV": LIBRARY + "movie_example/final_uv.obj",
    "midgut, ends cut": LIBRARY + "movie_example/mesh_1_cylinder_cut.obj",
}
ORGANOID = LIBRARY + "microscopy_nodes_example/organoid/Neural_tube_organoid_DAPI_betaCat-small.tif"
PEER = """
import sys
import numpy as np
import resource, time
import trimesh
from unwrap3D.Mesh import meshtools
given = np.load(sys.argv[1])
begun = time.process_time()
sphere = meshtools.direct_spherical_conformal_map(given["points"], given["faces"])
first = time.process_time() - begun
mesh, original = (trimesh.Trimesh(points, given["faces"], process=False) for points in (sphere, given["points"]))
steps = meshtools.area_distortion_flow_relax_sphere(mesh, original, max_iter=50)[0]
last = [step for step in steps if np.isfinite(step).all()][-1]
np.savez(sys.argv[2], conformal=sphere, relaxed=last, seconds=[first, time.process_time() - begun],
         memory=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def read_obj(path):
    """Return points, faces, texture coordinates and their triangles (None if there are none)."""
    points, texture, faces, corners = [], [], [], []
    for line in path.read_text(errors="replace").splitlines():
        kind, *values = line.split() or [""]
        if kind == "v":
            points.append([float(value) for value in values[:3]])
        elif kind == "vt":
            texture.append([float(value) for value in values[:2]])
        elif kind == "f":
            around = [value.split("/") for value in values]
            for k in range(1, len(around) - 1):
                triangle = around[0], around[k], around[k + 1]
                faces.append([int(corner[0]) - 1 for corner in triangle])
                corners.append([int(corner[1]) - 1 if len(corner) > 1 and corner[1] else -1 for corner in triangle])
    used, compact = np.unique(faces, return_inverse=True)
    faces = compact.reshape(-1, 3)
    return np.array(points)[used], faces, np.array(texture) if texture else None, np.array(corners)


def organoid(path):
    """Return the mesh of the outer surface of the organoid: its filled tissue, smoothed by 40 µm."""
    volume = voxflat.io.read_volume(path, channel=1)
    inside = scipy.ndimage.binary_fill_holes(scipy.ndimage.gaussian_filter(volume.data.astype(float), 2) > 70)
    surface = voxflat.surface(inside, affine=volume.affine, unit="µm").smooth(40)
    return surface.points, surface.faces.astype(np.int64), None, None


def area(points, faces):
    """Return the total area of triangles in space or in the plane."""
    a, b = (points[faces[:, side]] - points[faces[:, 0]] for side in (1, 2))
    return np.sqrt(np.maximum((a**2).sum(1) * (b**2).sum(1) - (a * b).sum(1) ** 2, 0)).sum() / 2


def stored(points, faces, texture, corners):
    """Return the stored map (places, triangles, vertices); each chart is scaled to the area of its surface."""
    used, compact = np.unique(corners, return_inverse=True)
    corners, uv = compact.reshape(-1, 3), texture[used]
    vertices = np.empty(len(uv), dtype=np.int64)
    vertices[corners] = faces
    for of in charts_of(corners):
        uv[np.unique(corners[of])] *= np.sqrt(area(points, faces[of]) / area(uv, corners[of]))
    return uv, corners, vertices


def charts_of(triangles):
    """Return masks of the connected parts of triangles."""
    count = triangles.max() + 1
    links = scipy.sparse.coo_array((np.ones(2 * len(triangles)), tuple(triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T)))
    links.resize((count, count))
    number, part = scipy.sparse.csgraph.connected_components(links, directed=False)
    return [part[triangles[:, 0]] == chart for chart in range(number)]


def longitudes(points, faces, sphere):
    """Return the map of longitude and latitude, with a seam, for the best aspect ratio."""
    way = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    along = points @ way
    axis = sphere[along.argmax()] - sphere[along.argmin()]
    turned = sphere @ np.linalg.qr(np.column_stack([axis, *np.eye(3)[:2]]))[0]
    latitude, longitude = np.arcsin(np.clip(turned[:, 0], -1, 1)), np.arctan2(turned[:, 2], turned[:, 1])
    around = longitude[faces]
    wraps = np.ptp(around, axis=1) > np.pi
    higher = (around < 0) & wraps[:, None]
    turns = np.diff(np.column_stack([around, around[:, :1]]), axis=1)
    polar = np.abs(((turns + np.pi) % (2 * np.pi) - np.pi).sum(axis=1)) > 1
    keys, triangles = np.unique(faces + len(points) * higher, return_inverse=True)
    triangles, vertices = triangles.reshape(-1, 3)[~polar], keys % len(points)
    uv = np.column_stack([longitude[vertices] + 2 * np.pi * (keys >= len(points)), latitude[vertices]])
    used, triangles = np.unique(triangles, return_inverse=True)
    uv, vertices, triangles = uv[used], vertices[used], triangles.reshape(-1, 3)
    if (signed := np.linalg.det(np.diff(uv[triangles], axis=1))).sum() < 0:
        uv[:, 0] *= -1
    uv *= np.sqrt(area(points, faces) / np.abs(signed).sum() * 2)

    def error(logarithm):
        stretched = uv * np.exp([logarithm, -logarithm])
        return voxflat.measure((points, faces), (stretched, triangles, vertices), sources=6).best_scale.relative_error

    best = scipy.optimize.minimize_scalar(error, bounds=(-1.5, 1.5), method="bounded", options={"xatol": 0.05}).x
    return uv * np.exp([best, -best]), triangles, vertices


def ours(kind, points, faces, map_of):
    """Return a map of voxflat, its CPU time and its peak memory; runs in a process of its own."""
    begun = time.process_time()
    if kind == "same seams":
        _, triangles, vertices = map_of
        maps, ids = [], []
        for chart in charts_of(triangles):
            used, own = np.unique(triangles[chart], return_inverse=True)
            surface = voxflat.surface((points[vertices[used]], own.reshape(-1, 3)), unit="µm")
            maps.append(surface.flatten(relax=False))
            ids.append(vertices[used[maps[-1].ids]])
    else:
        surface = voxflat.surface((points, faces), unit="µm")
        maps = [surface.flatten()] if kind == "default" else [chart.flatten() for chart in surface.charts(kind)]
        ids = [own.ids for own in maps]
    seconds = time.process_time() - begun
    starts = np.cumsum([0, *(len(own) for own in maps)])
    joined = [own.faces.astype(np.int64) + start for own, start in zip(maps, starts, strict=False)]
    places = np.cumsum([0, *(np.ptp(own.uv[:, 0]) + 1 for own in maps)])  # side by side
    uv = np.concatenate([own.uv - own.uv.min(axis=0) + [place, 0] for own, place in zip(maps, places, strict=False)])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return (uv, np.concatenate(joined), np.concatenate(ids)), seconds, memory


def alone(*work):
    """Run `ours` in a new process."""
    fresh = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=fresh) as pool:
        return pool.submit(ours, *work).result()


def peers(python, points, faces):
    """Yield the name, map, CPU time and memory of the maps of u-Unwrap3D."""
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.npz", Path(folder) / "found.npz"
        np.savez(given, points=points, faces=faces)
        if subprocess.run([python, "-c", PEER, str(given), str(found)], capture_output=True, check=False).returncode:
            yield "u-Unwrap3D", None, np.nan, np.nan
            return
        with np.load(found) as results:
            for name, seconds in zip(("conformal", "relaxed"), results["seconds"], strict=True):
                own = longitudes(points, faces, results[name])
                yield f"u-Unwrap3D, {name}", own, float(seconds), int(results["memory"])


def row(name, kind, points, faces, own, seconds=np.nan, memory=np.nan):
    """Return the cells of a map."""
    if own is None:
        return [name, kind, "failed", *[""] * 7]
    found = voxflat.measure((points, faces), own, sources=60)
    triangles = found.triangles
    links = (found.topology or {}).get("components", 1)
    return [
        name,
        kind,
        str(links),
        f"{100 * found.best_scale.relative_error:.2f}",
        f"{triangles.equal_area_median:.3f}, {triangles.equal_area_p95:.2f}",
        f"{triangles.angle:.2f}",
        f"{triangles.flipped} ({triangles.covering})",
        f"{seconds:.1f}" if np.isfinite(seconds) else "",
        f"{memory / 1024:.0f}" if np.isfinite(memory) else "",
    ]


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a clone of blender-tissue-cartography")
    parser.add_argument("--peer", help="interpreter with u-Unwrap3D")
    parser.add_argument("--only", nargs="*", help="parts of the names of inputs")
    options = parser.parse_args()
    rows = []
    for name, path in {**MESHES, "organoid": ORGANOID}.items():
        if options.only and not any(part in name for part in options.only):
            continue
        read = organoid if name == "organoid" else read_obj
        points, faces, texture, corners = read(options.folder / path)
        loops = len(voxflat.surface((points, faces)).core.topology()["loops"])
        kinds = ["default", *([] if loops == 1 else [1, 2])]
        if texture is not None:
            map_of = stored(points, faces, texture, corners)
            rows.append(row(name, "stored UV", points, faces, map_of))
            if voxflat.measure((points, faces), map_of, sources=6).topology["handles"] == 0:
                kinds.append("same seams")
        if options.peer and not loops:
            rows += [row(name, kind, points, faces, *own) for kind, *own in peers(options.peer, points, faces)]
        for kind in kinds:
            label = {"default": "voxflat", "same seams": "voxflat, the seams of the UV map"}.get(
                kind, f"charts({kind})"
            )
            given = map_of if kind == "same seams" else None
            rows.append(row(name, label, points, faces, *alone(kind, points, faces, given)))
        print(name, "done", flush=True)
    columns = ["surface", "map", "charts", "distance %", "area, log2: median, 95 %", "angle °", "flipped (covering)"]
    tables.table("Maps of organs", [*columns, "CPU s", "peak MB"], rows)


if __name__ == "__main__":
    main()
