"""Adapters that make flat maps with unmodified tools, which are imported only here and only when they run.

Each adapter takes a job: `points` and `faces` of a surface (or `labels` and `affine` of a volume, for voxflat alone),
and options. It returns positions, the triangles of the map, and the vertex of the input for each position.
"""

import importlib
import importlib.metadata
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat._core import __version__
from voxflat.errors import InputError
from voxflat.io.files import require
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.patches import Patch, patch_border, patch_faces, read_patch, write_patch
from voxflat.pipeline.surface import surface

ITERATIONS = 100
"""Iterations of ARAP and SLIM."""

GIVEN, FREE = "given", "free"
"""The tracks: maps along given cuts, and maps whose tool cuts the surface itself."""

Job: TypeAlias = Mapping[str, Any]
Uv: TypeAlias = NDArray[np.float64]


class NoMapError(InputError):
    """A tool made no map, for this reason."""


@dataclass(frozen=True, eq=False)
class Flat:
    """A map that a tool made."""

    uv: Uv  # (N, 2)
    faces: NDArray[Any]  # (F, 3)
    vertices: NDArray[Any]  # (N,), of the input
    points: NDArray[np.float64]  # (N, 3)
    details: Mapping[str, Any]  # facts that only this tool knows, ready for JSON


@dataclass(frozen=True)
class Tool:
    """A tool of the benchmark."""

    name: str
    title: str
    packages: tuple[str, ...]  # distributions whose versions are printed; the first one is required
    tracks: tuple[str, ...]
    make: Callable[[Job, Mapping[str, Any]], Flat]
    module: str = ""  # imported before the time is taken

    @property
    def version(self) -> str:
        """The versions of the packages; an error names one that is not installed."""
        if not self.packages:
            return f"voxflat {__version__}"
        try:
            found = [f"{name} {importlib.metadata.version(name)}" for name in self.packages]
        except importlib.metadata.PackageNotFoundError as error:
            raise NoMapError(f"{error.name} is not installed. Run pip install 'voxflat[bench]'") from None
        return ", ".join(found)


def _flat(job: Job, uv: Uv) -> Flat:
    """Return a map with the triangles of the input."""
    return Flat(uv, job["faces"], np.arange(len(uv)), job["points"], {})


# ----------------------------------------------------------------------------------------------------------- voxflat


def voxflat_map(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return a map of voxflat, with further options of `voxflat.flatten`; a volume is repaired and cut open."""
    if "labels" in job:
        whole = surface(job["labels"], affine=job["affine"], repair="voxels")
    else:
        whole = surface((job["points"], job["faces"]))
    made = whole.flatten(**options)
    details = {"need": made.metadata.get("memory_need_bytes"), "descent": made.metadata.get("descent", {})}
    vertices = np.arange(len(made)) if whole.is_voxels else made.ids
    return Flat(made.uv, made.faces, vertices, made.points, details)


def _voxflat(method: str) -> Callable[[Job, Mapping[str, Any]], Flat]:
    def make(job: Job, options: Mapping[str, Any]) -> Flat:
        is_cut = options.get("track", FREE) == GIVEN
        more = {name: value for name, value in options.items() if name != "track"}
        return voxflat_map(job, {"method": method} | ({"relax": False} if is_cut else {}) | more)

    return make


# ------------------------------------------------------------------------------------------------- fixed boundaries


def on_circle(job: Job) -> tuple[NDArray[np.int64], Uv]:
    """Return the longest boundary, and its vertices on a circle that encloses the area of the surface.

    Their distances along the circle are in proportion to those along the boundary.
    """
    core = surface((job["points"], job["faces"])).core
    loops = core.topology()["loops"]
    if not loops:
        raise NoMapError("the surface is closed. Cut it open")
    longest = max(loops, key=_length)
    loop = core.ids[longest["vertices"]].astype(np.int64)
    points = job["points"][loop]
    steps = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    turn = 2 * np.pi * np.cumsum(steps) / steps.sum()
    return loop, np.sqrt(core.area / np.pi) * np.column_stack([np.cos(turn), np.sin(turn)])


def _length(loop: Mapping[str, Any]) -> float:
    return float(loop["length"])


def tutte(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the map of Tutte (1963): the boundary on a circle, each other vertex in the middle of its neighbours."""
    loop, circle = on_circle(job)
    faces, count = job["faces"], len(job["points"])
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = np.concatenate([ends, ends[:, ::-1]])
    links = scipy.sparse.csr_array(scipy.sparse.coo_array((np.ones(len(ends)), ends.T), shape=(count, count)))
    degrees = scipy.sparse.csr_array(scipy.sparse.diags_array(links.sum(axis=1)))
    springs = scipy.sparse.csr_array(degrees - links)
    inner = np.setdiff1d(np.arange(count), loop)
    uv = np.empty((count, 2))
    uv[loop] = circle
    pull = -(springs[inner][:, loop] @ circle)
    uv[inner] = scipy.sparse.linalg.spsolve(springs[inner][:, inner].tocsc(), pull)
    return _flat(job, uv)


def harmonic(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the harmonic map to a disk (libigl), with cotangent weights."""
    igl = require("igl")
    return _flat(job, igl.harmonic(job["points"], job["faces"], *on_circle(job), 1))


def _start(job: Job) -> Uv:
    """Return the harmonic map to a disk, or that of Tutte if the first one flips triangles."""
    igl = require("igl")
    uv: Uv = harmonic(job, {}).uv
    if len(igl.flipped_triangles(uv, job["faces"])) or not np.isfinite(uv).all():
        uv = tutte(job, {}).uv
    return uv


# ---------------------------------------------------------------------------------------------------- free boundaries


def lscm(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the least-squares conformal map (Lévy et al. 2002; libigl), two boundary vertices being fixed.

    The fixed vertices are half of the boundary apart.
    """
    igl = require("igl")
    loop = igl.boundary_loop(job["faces"])
    ends = np.array([loop[0], loop[len(loop) // 2]], dtype=np.int64)
    apart = np.linalg.norm(np.subtract(*job["points"][ends]))
    uv, _ = igl.lscm(job["points"], job["faces"], ends, np.array([[0.0, 0.0], [apart, 0.0]]))
    return _flat(job, np.asarray(uv))


def arap(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return an as-rigid-as-possible map (Liu, Zhang, Xu, Gotsman, Gortler 2008; libigl).

    One vertex is fixed. With dynamics instead, as in libigl's tutorial, 100 iterations are far too few.
    """
    igl = require("igl")
    data = igl.ARAPData()
    data.max_iter = ITERATIONS
    start = _start(job)
    igl.arap_precomputation(job["points"], job["faces"], 2, np.zeros(1, dtype=np.int32), data)
    return _flat(job, igl.arap_solve(np.ascontiguousarray(start[:1]), data, start))


def slim(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return a map of least symmetric Dirichlet energy (Rabinovich et al. 2017; libigl)."""
    igl = require("igl")
    start = np.asfortranarray(_start(job))
    nothing = np.zeros(0, dtype=np.int32), np.zeros((0, 2), order="F")
    arrays = np.asfortranarray(job["points"]), np.asfortranarray(job["faces"], dtype=np.int32)
    data = igl.slim_precompute(*arrays, start, igl.MappingEnergyType.SYMMETRIC_DIRICHLET, *nothing, 0.0)
    return _flat(job, np.asarray(igl.slim_solve(data, ITERATIONS))[:, :2])


def autoflatten(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the map of the command ``autoflatten flatten``; the time includes its start and its compilation."""
    command = _program("autoflatten")
    points, faces = job["points"], job["faces"]
    vertices = np.arange(len(points))
    with tempfile.TemporaryDirectory() as directory:
        base, patch, flat = (Path(directory, f"lh.{name}") for name in ("fiducial", "cut.patch.3d", "flat.patch.3d"))
        write_mesh(base, Mesh(points, faces))
        write_patch(patch, Patch(vertices, points, patch_border(faces, vertices, len(points))))
        words = [*command, "flatten", str(patch), "--base-surface", str(base), "-o", str(flat), "--print-every", "1000"]
        done = subprocess.run(words, capture_output=True, text=True)
        if not flat.exists():
            raise NoMapError(([*done.stderr.split("\n"), *done.stdout.split("\n")] or ["no map"])[-1])
        found = read_patch(flat)
    uv = np.full((len(points), 2), np.nan)
    uv[found.vertex_ids] = found.points[:, :2]
    kept = patch_faces(faces, found.vertex_ids, len(points))
    if len(kept) != len(faces):
        raise NoMapError(f"the map omits {len(faces) - len(kept)} triangles")
    return _flat(job, uv)


def _program(name: str) -> list[str]:
    """Return the command that runs a console script, whether or not it is on the path."""
    beside = Path(sys.executable).with_name(name)
    if found := str(beside) if beside.exists() else shutil.which(name):
        return [found]
    scripts = importlib.metadata.entry_points(group="console_scripts", name=name)
    for script in scripts:
        code = f"import sys; from {script.module} import {script.attr} as main; sys.exit(main())"
        return [sys.executable, "-c", code]
    raise NoMapError(f"{name} is not installed. Run pip install 'voxflat[bench]'")


# ------------------------------------------------------------------------------------------------------------- atlases


def xatlas(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the charts of xatlas with its default options."""
    atlas = require("xatlas").Atlas()
    atlas.add_mesh(job["points"].astype(np.float32), job["faces"].astype(np.uint32))
    atlas.generate()
    vertices, faces, uv = atlas[0]
    return _charts(job, uv.astype(float) * [atlas.width, atlas.height], faces, vertices)


def uvunwrap(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the charts of uvunwrap with its default options."""
    module = require("uvunwrap")
    mesh = module.Mesh(job["points"].astype(np.float32), job["faces"].astype(np.uint32))
    atlas = module.generate([mesh])
    out = atlas.meshes[0]
    uv = np.array(out.uv, dtype=float).reshape(-1, 2) * [atlas.width, atlas.height]
    return _charts(job, uv, np.array(out.indices, dtype=np.int64).reshape(-1, 3), np.array(out.xref, dtype=np.int64))


def meshlab(job: Job, options: Mapping[str, Any]) -> Flat:
    """Return the Voronoi atlas of MeshLab with its default options."""
    module = require("pymeshlab")
    meshes = module.MeshSet()
    meshes.add_mesh(module.Mesh(job["points"], job["faces"]))
    meshes.generate_voronoi_atlas_parametrization()
    mesh = meshes.mesh(meshes.mesh_number() - 1)  # the filter adds a mesh
    away, vertices = scipy.spatial.cKDTree(job["points"]).query(mesh.vertex_matrix())
    if away.max() > 1e-4 * np.ptp(job["points"], axis=0).max():
        raise NoMapError("the map has vertices that the surface does not have")
    corners = vertices[mesh.face_matrix()].reshape(-1, 1)
    rows, faces = np.unique(np.hstack([corners, mesh.wedge_tex_coord_matrix()]), axis=0, return_inverse=True)
    return _charts(job, rows[:, 1:], faces.reshape(-1, 3), rows[:, 0].astype(np.int64))


def _charts(job: Job, uv: Uv, faces: NDArray[Any], vertices: NDArray[Any]) -> Flat:
    return Flat(uv, faces.astype(np.int64), vertices.astype(np.int64), job["points"][vertices], {})


_IGL: dict[str, Any] = {"packages": ("libigl",), "tracks": (GIVEN,), "module": "igl"}
_OWN: dict[str, Any] = {"packages": (), "module": "voxflat.pipeline.surface"}

TOOLS = {
    tool.name: tool
    for tool in (
        Tool("voxflat", "voxflat", tracks=(GIVEN, FREE), make=_voxflat("voxflat"), **_OWN),
        Tool("arap", "ARAP (libigl)", make=arap, **_IGL),
        Tool("slim", "SLIM (libigl)", make=slim, **_IGL),
        Tool("lscm", "LSCM, conformal (libigl)", make=lscm, **_IGL),
        Tool("harmonic", "harmonic disk (libigl)", make=harmonic, **_IGL),
        Tool("tutte", "Tutte disk", (), (GIVEN,), tutte, "scipy.sparse.linalg"),
        Tool("autoflatten", "autoflatten", ("autoflatten", "jax"), (GIVEN,), autoflatten),
        Tool("zigelman2002", "Zigelman et al. 2002 (voxflat)", tracks=(GIVEN,), make=_voxflat("zigelman2002"), **_OWN),
        Tool("saucan2006", "Saucan et al. 2006 (voxflat)", tracks=(GIVEN,), make=_voxflat("saucan2006"), **_OWN),
        Tool("schwartz1989", "Schwartz et al. 1989 (voxflat)", tracks=(GIVEN,), make=_voxflat("schwartz1989"), **_OWN),
        Tool("xatlas", "xatlas", ("xatlas",), (FREE,), xatlas, "xatlas"),
        Tool("uvunwrap", "uvunwrap", ("uvunwrap",), (FREE,), uvunwrap, "uvunwrap"),
        Tool("meshlab", "MeshLab, Voronoi atlas", ("pymeshlab",), (FREE,), meshlab, "pymeshlab"),
    )
}
"""The tools by name."""

PUBLISHED = "published"
"""The name under which the flat maps that came with the surfaces are scored."""

NOT_RUN = {
    "mris_flatten (FreeSurfer)": "cannot be installed by pip; the published maps of fsaverage5 were made by it",
    "Boundary First Flattening": "has no Python package; a program for a window",
    "OptCuts": "has no Python package",
    "partuv": "needs CUDA",
    "u-Unwrap3D": "maps closed surfaces to the sphere; docs/benchmarks/tissue.py compares its maps of organs",
    "LN2_PATCH_FLATTEN (LayNii)": "flattens voxels, not triangles; docs/benchmarks/flat_volumes.py compares it",
    "Blender": "needs a Python of its own; UV maps that authors made with it are scored as published maps",
}
"""Tools that the benchmark does not run, and the reasons."""
