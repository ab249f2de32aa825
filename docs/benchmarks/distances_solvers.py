"""Geodesic solvers of voxflat and other tools, as functions from a source to a row of distances on one mesh."""

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import potpourri3d
from pygeodesic import geodesic as pygeodesic

import voxflat
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.overlays import read_overlay

OURS = ("exact", "marching", "graph")

STRAIGHT_FRONTS = "marching-plane"
"""Fast marching with straight fronts (Kimmel and Sethian), for comparison; not public."""


def ours(points, faces):
    """Return a function from sources and a geodesic to voxflat's rows, shape (m, N), with one thread."""
    core = voxflat.surface((points, faces)).core
    assert np.array_equal(core.ids, np.arange(len(points))), "each vertex belongs to a face"
    return lambda sources, geodesic: core.rows(np.asarray(sources, dtype=np.uint32), geodesic=geodesic, threads=1)


def exact(points, faces):
    """Return the solver of Mitchell, Mount and Papadimitriou by pygeodesic, f64."""
    solver = pygeodesic.PyGeodesicAlgorithmExact(points, faces)
    return lambda source: solver.geodesicDistances([int(source)], None)[0]


def marching(points, faces):
    """Return fast marching by potpourri3d (geometry-central), f64."""
    solver = potpourri3d.MeshFastMarchingDistanceSolver(points, faces)
    return lambda source: np.asarray(solver.compute_distance([[(int(source), [])]]))


def heat(points, faces):
    """Return the heat method by potpourri3d, with its intrinsic Delaunay triangulation, f64."""
    return potpourri3d.MeshHeatMethodDistanceSolver(points, faces).compute_distance


def plain_heat(points, faces):
    """Return the heat method with plain cotangents and the squared mean edge as time step, as in pycortex."""
    return potpourri3d.MeshHeatMethodDistanceSolver(points, faces, use_robust=False).compute_distance


PEERS = {
    "potpourri3d marching": marching,
    "potpourri3d heat": heat,
    "heat over plain cotangents (as pycortex)": plain_heat,
}


def workbench(points, faces, sources):
    """Return the distances of Connectome Workbench, shape (m, N), or None if it is not installed."""
    if not shutil.which("wb_command"):
        return None
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        surface, out = Path(folder) / "mesh.surf.gii", Path(folder) / "out.func.gii"
        write_mesh(surface, Mesh(points, faces))
        for source in sources:
            command = ["wb_command", "-surface-geodesic-distance", surface, str(source), out]
            subprocess.run(command, check=True, capture_output=True)
            rows.append(read_overlay(out, len(points)))
    return np.array(rows, dtype=float)
