"""Load flat maps: complete ones, and those of any tool, which are matched with their surface and measured."""

import hashlib
import os
from contextlib import nullcontext
from functools import partial
from typing import Any

import numpy as np

from voxflat import _core
from voxflat.arguments import Progress, checked_threads, log
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.figures import TriangleFigures
from voxflat.distortion.later import MeasuredLater
from voxflat.errors import InputError
from voxflat.evaluation.charts import charts_of
from voxflat.evaluation.measure import measured_maps
from voxflat.evaluation.sides import is_mirrored, other_side
from voxflat.io.files import REMEDY, SAVED_ENDINGS, naming
from voxflat.io.meshes import is_mesh_name
from voxflat.io.origin import MeshOrigin
from voxflat.io.patches import is_patch
from voxflat.io.provenance import described, record_of
from voxflat.io.reading import reading
from voxflat.maps.flat_map import GIVEN, FlatMap, load_saved
from voxflat.maps.map_cuts import own_seams
from voxflat.maps.matching import NOT_A_MAP, Matched, check_flat, is_flat, loaded, match, mesh_of_map, turns
from voxflat.maps.surface_points import PASS_SURFACE
from voxflat.methods.common import (
    MUCH,
    error_of_distances,
    making_details,
    placed_map,
    warning_of_distances,
    warnings_of_triangles,
)
from voxflat.methods.method import FlattenSettings
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.surface import Surface
from voxflat.pipeline.surface import surface as _surface
from voxflat.surfaces.cuts import Cut
from voxflat.surfaces.cutting import CutManifold

_OTHER_SCALE = 1.0  # log2 of the largest usual factor between lengths on the map and on the surface
_FROM_INSIDE = (
    "the map shows the surface from inside, so that it is mirrored, unless it belongs to the other hemisphere. To show "
    "it from outside, multiply the first coordinate of all points of the map by -1"
)


def load(
    flat: object,
    surface: object | None = None,
    *,
    pial: object | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Load a flat map that was saved with `FlatMap.save`, or that any other tool made.

    Maps of other tools can be loaded with the surface that they show, or alone. No point is moved: the map keeps the
    positions in the file, also where triangles are flipped, and a warning reports their number. Another warning reports
    a map that shows the surface from inside. The distortion is measured when it is first read, from 200 random points,
    as for maps that voxflat makes.

    Without its surface, a map shows values, labels and borders at the vertices, and regions on it are written back to
    the vertices. Its `FlatMap.has_surface` is False. Operations that need positions in space or the distortion, such as
    sampling a volume, raise an error.

    Parameters
    ----------
    flat : path, or map
        A complete map (.npz or .voxflat), or any map that `measure` accepts: a FreeSurfer patch, a flat GIFTI surface,
        texture coordinates in an .obj, .ply or .glb file, arrays, or a mesh object. Patches, and arrays without
        triangles, require `surface`. A file with texture coordinates also contains the surface.
    surface : Surface, CutSurface, or any input of `voxflat.surface`, optional
        The surface that the map shows, such as the midthickness surface. A complete map can also be shown on another
        surface with the same triangles.
    pial : path, Mesh, (points, faces) or array_like of shape (V, 3), optional
        The pial surface, as in `voxflat.surface`, if `surface` is the white surface. Volumes can then be sampled
        between the two.
    threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    FlatMap
        The map. `FlatMap.method` of a map of another tool is "given".

    Raises
    ------
    InputError, Cancelled
        If the file is damaged or is not a flat map, if the map does not belong to the surface, or if `progress`
        returned False.
    FileNotFoundError
        If the file does not exist.

    See Also
    --------
    FlatMap.save : Save a map.
    measure : Measure a map of any tool.

    Examples
    --------
    >>> voxflat.samples.hill().flatten().save("map.npz")
    >>> voxflat.load("map.npz")
    <FlatMap: 441 points, 42 x 42 mm, relative error 3.6 % of interior pairs, 3.6 % of all pairs at the best scale>

    A map from above, without a file:

    >>> hill = voxflat.samples.hill()
    >>> voxflat.load(hill.points[:, :2], surface=hill)
    <FlatMap: 441 points, 40 x 40 mm, relative error not measured yet>
    """
    if surface is None:
        if pial is not None:
            raise InputError("a pial surface is given without a surface. Pass surface and pial, or omit pial")
        if isinstance(flat, str | os.PathLike) and not _is_of_other_tool(flat):
            return load_saved(flat)
        with (
            reading(memory_limit) as files,
            naming(flat, REMEDY) if isinstance(flat, str | os.PathLike) else nullcontext(),
        ):
            alone = _alone(flat)
        if alone is not None:
            record = record_of("load", described({"flat": flat}), dict(sorted(files.items())))
            return alone._with_provenance(record)
        surface = flat
    limits: dict[str, Any] = {"threads": checked_threads(threads), "progress": progress}
    with reading(memory_limit) as files:
        if isinstance(surface, CutSurface):
            surface = surface.whole
        whole: Surface = _surface(surface, pial=pial, memory_limit=memory_limit, **limits)._complete
        flat_map = loaded(flat)
        is_own = isinstance(flat_map, FlatMap) and flat_map.method != GIVEN  # these may be mirrored on request
        made = _on_surface(whole, match(whole, flat_map), memory_limit, is_own=is_own, **limits)
    if isinstance(flat_map, FlatMap):
        made = made._with(frame=flat_map.frame, cuts=flat_map.cuts, cuts_by=flat_map.cuts_by)
    record = record_of("load", described({"flat": flat, "surface": surface, "pial": pial}), dict(sorted(files.items())))
    return made._with_provenance(record)


def _on_surface(
    whole: Surface,
    flat: Matched,
    memory_limit: int | None,
    *,
    is_own: bool,
    threads: int | None,
    progress: Progress | None,
) -> FlatMap:
    """Return a map that is matched with a surface as a `FlatMap`, with the same positions."""
    settings = FlattenSettings(relax=False, memory_limit=memory_limit, threads=threads, progress=progress)
    if is_flat(whole.points) and np.array_equal(flat.uv, flat.core.points[:, :2]):
        raise InputError(
            "the surface is the flat map itself. Pass the curved surface that the map shows, or omit surface"
        )
    part = whole._with_core(flat.core)
    triangles = TriangleFigures(**flat.core.measure(flat.uv, progress))
    distortion = MeasuredLater(partial(_distortion, whole, flat, threads, memory_limit))
    paths = own_seams(flat)
    cuts = tuple(Cut(path if whole.voxels is None else whole.voxels[path], None, "given") for path in paths)
    cut = CutManifold(whole, part, part.faces, cuts, "given", whole.warnings, 0.0)
    result = {"uv": flat.uv, "normals": part.core.normals, "period": flat.period}
    result |= {"sources": np.zeros(0, dtype=np.int64), "eigenvalues": np.zeros(0)}
    merged, rows = part._also_merged()
    own = flat.uv[rows] if flat.places is None else flat.places[merged]
    own = np.where(np.isfinite(own), own, flat.uv[rows])
    warnings = [*whole.warnings, *warnings_of_triangles(triangles, len(part.faces))]
    if count := len(np.unique(merged[(own != flat.uv[rows]).any(axis=1)])):
        warnings.append(
            f"{count} of {whole.count} vertices coincide with others on the surface, but not on the map. They keep "
            "their positions, but triangles are drawn at the positions of the others"
        )
    inside = not is_own and is_mirrored(flat)
    if text := "" if is_own else other_side(whole, flat):
        warnings.append(text)
    elif inside:
        warnings.append(_FROM_INSIDE)
    scale = triangles.equal_area_scale
    if not is_own and abs(np.log2(scale)) > _OTHER_SCALE:  # as in texture coordinates, from 0 to 1
        warnings.append(
            f"the map is {1 / scale:.3g} times as large as the surface, so the scale bar and the pixel size are not "
            f"lengths on the surface. To draw it in the unit of the surface, multiply all points of the map by "
            f"{scale:.4g}"
        )
    made = placed_map(GIVEN, cut, settings, result, distortion, warnings, more={"mirrored": inside})
    return made._with(uv=np.concatenate([flat.uv, own]))


def _distortion(
    whole: Surface, flat: Matched, threads: int | None, memory_limit: int | None, progress: Progress | None
) -> Distortion:
    """Measure the distortion against graph distances, or against exact distances if graph distances are inaccurate."""
    settings = FlattenSettings(relax=False, memory_limit=memory_limit, threads=threads, progress=progress)
    largest, _ = charts_of(flat)[0]
    is_exact = error_of_distances(whole._with_core(largest.core), "graph", settings) > MUCH
    how: tuple[int | None, str] = (None, "exact") if is_exact else (_core.REFERENCE_SOURCES, "graph")
    limits: dict[str, Any] = {"seed": 0, "threads": threads, "memory_limit": memory_limit, "progress": progress}
    distortion = measured_maps(whole, {"": flat}, *how, **limits)[""].distortion
    if text := warning_of_distances(distortion):
        log.warning(text)
    return distortion


def _is_of_other_tool(path: str | os.PathLike[str]) -> bool:
    if not os.path.isfile(path) or os.fspath(path).lower().endswith(SAVED_ENDINGS):
        return False
    if is_patch(path) or is_mesh_name(path):
        return True
    raise InputError(f"{path}: {NOT_A_MAP}")


def _alone(flat: object) -> FlatMap | None:
    """Return a map without its surface, or None if the surface is also in the file."""
    if isinstance(flat, str | os.PathLike) and is_patch(flat):
        raise InputError(f"is a FreeSurfer patch, which has no triangles. {PASS_SURFACE}")
    mesh = None if isinstance(flat, FlatMap) else mesh_of_map(flat)
    if mesh is None:
        kind = f"the map is of type {type(flat).__name__}, but only a mesh can be loaded without its surface"
        raise InputError(f"{kind}. {PASS_SURFACE}")
    if "surface_points" in mesh.point_data:
        raise InputError(f"the map does not contain the vertex numbers of its surface. {PASS_SURFACE}")
    if mesh.texture_coordinates is not None and not is_flat(mesh.points):
        return None
    is_placed = np.asarray(np.isfinite(mesh.points).all(axis=1))
    faces = mesh.faces[is_placed[mesh.faces].all(axis=1)]
    if not len(faces):
        raise InputError("the map has no complete triangle. Pass a flat surface")
    ids, corners = np.unique(faces, return_inverse=True)
    check_flat(mesh.points[ids])
    uv, triangles = np.ascontiguousarray(mesh.points[ids, :2]), corners.reshape(-1, 3).astype(np.uint32)
    ways = turns(uv, triangles)
    is_inside = bool(ways.sum() < 0)
    warnings = list(mesh.warnings)
    if flipped := int((ways == (1 if is_inside else -1)).sum()):
        warnings.append(f"the map folds over: {flipped} of {len(faces)} triangles are flipped")
    if is_inside:
        warnings.append(_FROM_INSIDE)
    origin = MeshOrigin(
        input=None if mesh.path is None else str(mesh.path),
        input_sha256=hashlib.sha256(mesh.points.tobytes() + mesh.faces.tobytes()).hexdigest(),
        vertices=len(mesh.points),
        structure=mesh.structure,
        unit=mesh.unit,
    )
    missing: dict[str, Any] = dict.fromkeys(("points", "normals", "distortion"))
    return FlatMap(
        uv=uv,
        ids=ids,
        faces=triangles,
        torn=np.zeros(len(faces), dtype=np.bool_),
        sources=np.zeros(0, dtype=np.int64),
        eigenvalues=np.zeros(0),
        origin=origin,
        method=GIVEN,
        warnings=tuple(warnings),
        details={"mirrored": is_inside, **making_details(np.zeros(0), {}, None, warnings, None)},
        **missing,
    )
