"""Makers of flat maps: voxflat and other tools.

    python docs/benchmarks/maps_makers.py MAKER JOB.npz MADE.npz

makes a map in this process. `make` starts such a process for each map, so that time and memory are those of one map. A
job contains the points and faces of a disk, or labels with their affine for voxflat to cut open, and voxflat's options.
ARAP and SLIM (libigl) run 100 iterations from the harmonic map to a disk, or from one with equal springs if that folds.
`autoflatten flatten` runs as a command with default options, so its time includes its start and compilation.
"""

import importlib
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ITERATIONS = 100
GIB = 2**30

CUT_OPEN = {"relax": None}
"""Options of voxflat for a closed surface: the default cuts. A disk is not cut any further."""


class NoMapError(Exception):
    """A maker made no map, for this reason."""


@dataclass(frozen=True, eq=False)
class Made:
    """A flat map and its costs, without reading the input and importing packages."""

    places: np.ndarray  # in the plane
    points: np.ndarray  # on the surface as it was cut, mm
    faces: np.ndarray
    wall: float  # s
    cpu: float  # s
    peak: float  # memory of the process at its peak, packages included, GiB
    taken: float  # the same without packages and input, GiB
    need: float = np.nan  # voxflat's estimate of its memory, GiB
    descent: dict = field(default_factory=dict)  # voxflat's `metadata["descent"]`


# ----------------------------------------------------------------------------- in the process of the caller


def make(maker, job, limit):
    """Make a map by one of `MAKERS` in a separate process, within `limit` seconds.

    `job` contains ``points`` and ``faces``, or ``labels`` and ``affine``, and ``options`` of `voxflat.flatten`.
    """
    with tempfile.TemporaryDirectory() as directory:
        path, made = (Path(directory, name) for name in ("job.npz", "made.npz"))
        np.savez(path, **{**job, "options": json.dumps(job.get("options", {}))})
        command = [sys.executable, __file__, maker, path, made]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=limit)
        except subprocess.TimeoutExpired:
            raise NoMapError(f"no map after {limit:.0f} s") from None
        if done.returncode:
            raise NoMapError(done.stderr.strip().splitlines()[-1] if done.stderr else f"ended {done.returncode}")
        with np.load(made) as found:
            arrays = {name: found[name] for name in ("places", "points", "faces")}
            costs = {name: float(found[name]) for name in ("wall", "cpu", "peak", "taken")}
            return Made(**arrays, **costs, **json.loads(str(found["told"])))


# ------------------------------------------------------------------------------------- in a separate process


def voxflat_map(job, options):
    """Return a map of the default method, the cut surface, the memory estimate, and the record of the descent."""
    import voxflat

    if "labels" in job:
        surface = voxflat.surface(job["labels"], affine=job["affine"], repair="voxels")
    else:
        surface = voxflat.surface((job["points"], job["faces"]))
    made = surface.flatten(**{"relax": False, **options})
    told = {"need": made.metadata["memory_need_bytes"] / GIB, "descent": made.metadata.get("descent", {})}
    return made.uv, made.points, made.faces, told


def arap(job, options):
    """Return an as-rigid-as-possible map (Liu, Zhang, Xu, Gotsman, Gortler 2008).

    One vertex is fixed. With dynamics instead, as in libigl's tutorial, 100 iterations are far too few.
    """
    import igl

    points, faces = job["points"], job["faces"]
    data = igl.ARAPData()
    data.max_iter = ITERATIONS
    start = on_disk(points, faces)
    igl.arap_precomputation(points, faces, 2, np.zeros(1, dtype=np.int32), data)
    return igl.arap_solve(np.ascontiguousarray(start[:1]), data, start), points, faces, {}


def slim(job, options):
    """Return a map of least symmetric Dirichlet energy (Rabinovich, Poranne, Panozzo, Sorkine-Hornung 2017)."""
    import igl

    points, faces = job["points"], job["faces"]
    start = np.asfortranarray(on_disk(points, faces))
    nothing = np.zeros(0, dtype=np.int32), np.zeros((0, 2), order="F")
    arrays = np.asfortranarray(points), np.asfortranarray(faces, dtype=np.int32)
    data = igl.slim_precompute(*arrays, start, igl.MappingEnergyType.SYMMETRIC_DIRICHLET, *nothing, 0.0)
    return np.asarray(igl.slim_solve(data, ITERATIONS))[:, :2], points, faces, {}


def on_disk(points, faces):
    """Return the harmonic map to a disk of the same area, or one with equal springs if that flips triangles."""
    import igl
    from scipy.sparse import coo_array, csr_array
    from scipy.sparse.linalg import spsolve

    loop = igl.boundary_loop(faces)
    circle = igl.map_vertices_to_circle(np.asfortranarray(points), loop.astype(np.int32))[:, :2]
    circle = np.ascontiguousarray(circle * np.sqrt(np.sum(igl.doublearea(points, faces)) / 2 / np.pi))
    places = igl.harmonic(points, faces, loop, circle, 1)
    if not len(igl.flipped_triangles(places, faces)) and np.isfinite(places).all():
        return places
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = np.concatenate([ends, ends[:, ::-1]])
    links = csr_array(coo_array((np.ones(len(ends)), ends.T), shape=(len(points), len(points))))
    springs = csr_array(coo_array((links.sum(axis=1), 2 * (np.arange(len(points)),)))) - links
    inner = np.setdiff1d(np.arange(len(points)), loop)
    places[loop] = circle
    places[inner] = spsolve(springs[inner][:, inner].tocsc(), -(springs[inner][:, loop] @ circle))
    return places


def autoflatten(job, options):
    from voxflat.io.meshes import Mesh, write_mesh
    from voxflat.io.patches import Patch, patch_border, patch_faces, read_patch, write_patch

    command = Path(sys.executable).with_name("autoflatten")
    command = command if command.exists() else shutil.which("autoflatten")
    if command is None:
        raise NoMapError("autoflatten is not installed")
    points, faces = job["points"], job["faces"]
    vertices = np.arange(len(points))
    with tempfile.TemporaryDirectory() as directory:
        files = ("lh.fiducial", "lh.cut.patch.3d", "lh.flat.patch.3d")
        surface, patch, flat = (Path(directory, name) for name in files)
        write_mesh(surface, Mesh(points, faces))
        write_patch(patch, Patch(vertices, points, patch_border(faces, vertices, len(points))))
        called = [command, "flatten", patch, "--base-surface", surface, "-o", flat, "--print-every", "1000"]
        done = subprocess.run(called, capture_output=True, text=True)
        if not flat.exists():
            raise NoMapError((done.stderr.strip() or done.stdout.strip()).splitlines()[-1])
        found = read_patch(flat)
    places = np.full((len(points), 2), np.nan)
    places[found.vertex_ids] = found.points[:, :2]
    kept = patch_faces(faces, found.vertex_ids, len(points))
    if len(kept) != len(faces):
        raise NoMapError(f"left out {len(faces) - len(kept)} triangles")
    return places, points, faces, {}


MAKERS = {"voxflat": voxflat_map, "ARAP": arap, "SLIM": slim, "autoflatten": autoflatten}


def main():
    maker, path, made = sys.argv[1:]
    with np.load(path) as file:
        job = {name: file[name] for name in file.files}
    options = json.loads(str(job.pop("options")))
    importlib.import_module("igl" if maker in ("ARAP", "SLIM") else "voxflat")
    start, before = (time.perf_counter(), _cpu()), _memory("VmRSS")
    try:
        places, points, faces, told = MAKERS[maker](job, options)
    except NoMapError as error:
        sys.exit(str(error))
    wall, cpu = time.perf_counter() - start[0], _cpu() - start[1]
    if not np.isfinite(places).all():
        sys.exit("places that are not finite")
    costs = {"wall": wall, "cpu": cpu, "peak": _peak() / GIB, "taken": (_peak() - before) / GIB}
    np.savez(made, places=places, points=points, faces=faces, told=json.dumps(told), **costs)


def _cpu():
    """Return the CPU time of this process and its finished children, s."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def _peak():
    """Return the peak memory of this process or of a child, bytes; `ru_maxrss` would begin with that of the parent."""
    return max(_memory("VmHWM"), 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)


def _memory(name):
    """Return an entry of `/proc/self/status`, bytes, or the peak memory on systems other than Linux."""
    status = Path("/proc/self/status")
    if not status.exists():
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    (line,) = (line for line in status.read_text().splitlines() if line.startswith(name))
    return 1024 * int(line.split()[1])


if __name__ == "__main__":
    main()
