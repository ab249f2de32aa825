"""From a surface to the disk that is flattened: patch, cuts, holes, and what the user should know of each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, array_of, shown
from voxflat.errors import InputError
from voxflat.io.meshes import holds_mesh
from voxflat.io.overlays import read_region
from voxflat.io.patches import Patch, is_patch, read_patch
from voxflat.io.volumes import Volume
from voxflat.surfaces.cuts import check_relax, close_holes, cut_along, opened, read_cuts
from voxflat.surfaces.foreground import keep_mask
from voxflat.surfaces.medial_wall import is_medial_wall, medial_wall_of
from voxflat.surfaces.of_mesh import as_mesh
from voxflat.surfaces.partners import check_region
from voxflat.surfaces.seed import check_disk, found_seed, seed_voxel
from voxflat.surfaces.standard.choice import AUTOMATIC, Choice, chosen
from voxflat.surfaces.standard.sphere import Sphere
from voxflat.surfaces.standard.template import STANDARD
from voxflat.surfaces.standard.tracing import TracedCut, kept_by, traced
from voxflat.surfaces.surface import Surface

_STRAY_SHARE = 0.05  # of a patch's area, that may lie in stray pieces
_COVERED = 0.5  # share of what a template leaves out that must be left out for a region to stand in its place
_NO_TRIAL = 1e9  # an error that is always bearable, so that no cut is tried


@dataclass(frozen=True)
class Cutout:
    """What is flattened, what it was cut from, and what was done."""

    whole: Surface
    part: Surface
    faces: NDArray[np.uint32]
    metadata: dict[str, Any]
    remarks: tuple[str, ...]
    given_length: float | None  # of the cuts that were given, mm; None if there is no word of cuts
    is_cut: bool  # whether someone has said where it is cut: by cuts, or by a patch's triangles
    is_whole: bool  # whether nothing was left out of what was handed over
    sphere: Sphere | None = None  # that of the whole surface, if it is known
    traced: tuple[TracedCut, ...] = ()  # cuts of a template, which are those in the metadata
    is_standard: bool = False  # whether a template's cuts were chosen

    def anatomy(self, threads: int | None = None, progress: Progress | None = None) -> dict[str, NDArray[np.float64]]:
        """Return curvature and sulcal depth of the part's vertices, as they are on the whole surface."""
        of_whole = {"curvature": self.whole.mean_curvature, "sulcal_depth": self.whole.sulcal_depth}
        found = {}
        for name, of in of_whole.items():
            placed = np.full(self.whole.count, np.nan)
            placed[self.whole.vertices] = of(threads=threads, progress=progress)
            found[name] = placed[self.part.vertices]
        return found


def cut_out(
    whole: Surface,
    *,
    keep: object | None = None,
    drop: object | None = None,
    seed_point: Sequence[int] | int | None = None,
    radius: float | None = None,
    polygon: ArrayLike | None = None,
    cuts: object | None = None,
    sphere: object | None = None,
    relax: float | bool | None = None,
    adapt: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    to_disk: bool = True,
    with_usual_cuts: bool = True,
) -> Cutout:
    """Cut the part to work on out of a surface.

    Parameters
    ----------
    whole : Surface
        The surface.
    keep, drop, seed_point, radius, polygon, cuts, sphere, relax, adapt, threads, progress
        As in `voxflat.flatten`.
    to_disk : bool
        Close small holes and open the rest to a disk; otherwise only what was asked for is cut.
    with_usual_cuts : bool
        Make standard cuts where nobody has said where to cut, and the sphere is known.

    Returns
    -------
    Cutout
    """
    radius = check_disk(seed_point, radius)
    if polygon is not None and seed_point is not None:
        raise InputError("a polygon is given, and a seed point with a radius, too; give one of them")
    check_relax(relax, adapt)
    remarks = list(whole.remarks)
    part = whole
    is_free = with_usual_cuts and keep is None and seed_point is None and polygon is None
    choice = chosen(whole, cuts, sphere, is_free=is_free, threads=threads, progress=progress)
    remarks += choice.remarks
    is_named = choice.template is not None or (isinstance(cuts, str) and cuts == AUTOMATIC)
    paths, left_out = (None, None) if is_named else read_cuts(whole, cuts)
    region, by_triangles = _region(whole, keep, drop, left_out)
    is_whole = region is None and seed_point is None and polygon is None
    if choice.template is not None:
        region, told = _with_outlines(whole, choice, region)
        remarks += told
    for given in (keep, drop):
        if isinstance(given, str | os.PathLike):
            remarks += check_region(whole, given)
    if region is not None:
        part = part.with_core(part.core.part_of_faces(region))
    seed_id = None
    if seed_point is not None and radius is not None:
        seed, told = _seed(part, seed_point)
        seed_id = part.ids[seed].tolist()
        remarks += told
        core, filled = part.core.disk(seed, radius, threads, progress)
        part = part.with_core(core)
        if filled:
            remarks.append(f"{filled} triangles beyond the radius that the disk encloses belong to it")
    if polygon is not None:
        core, _ = part.core.polygon(part.find(polygon, "the polygon's corners"), progress)
        part = part.with_core(core)
    part, told = _one_piece(part, region is not None or seed_id is not None or polygon is not None)
    remarks += told
    named: list[TracedCut] = []
    if choice.template is None:
        part, cut_paths, length = cut_along(part, paths)
    else:
        uncut = part
        part, named, told = _cut_by(choice, part, progress)
        cut_paths, length = [uncut.ids[cut.vertices].tolist() for cut in named], sum(cut.length for cut in named)
        remarks += told
    metadata = {
        **whole.metadata,
        "keep": keep is not None,
        "drop": drop is not None,
        "seed_point": None if seed_point is None else np.asarray(seed_point).tolist(),
        "seed_found": seed_id,
        "radius": radius,
        "polygon": None if polygon is None else np.asarray(polygon).tolist(),
        "cuts": cut_paths,
        "cut_names": [cut.name for cut in named] if named else [None] * len(cut_paths),
        "cuts_by": _cuts_by(choice, paths),
        "sphere": None if choice.sphere is None else choice.sphere.described(),
        "automatic_cuts": [],
        "surface_points": len(whole),
        "points": len(np.unique(part.vertices)),
    }
    is_standard = choice.template is not None
    given = length if is_standard or paths is not None else None
    is_cut = by_triangles or given is not None
    more: dict[str, Any] = {"sphere": choice.sphere, "traced": tuple(named), "is_standard": is_standard}
    cut = Cutout(whole, part, part.faces, metadata, tuple(remarks), given, is_cut, is_whole, **more)
    if adapt is not None and not is_standard:
        raise InputError("adapt is for the cuts of a template: give cuts='standard' or a template, or leave it out")
    return opened_to_disk(cut, relax, threads, progress, adapt) if to_disk else cut


def cut_out_as(whole: Surface, part: Surface, cuts: Sequence[NDArray[np.int64]], by: str) -> Cutout:
    """Take a part of a surface whose triangles and cuts are known.

    Parameters
    ----------
    whole : Surface
        The surface.
    part : Surface
        Some of its triangles.
    cuts : sequence of ndarray of int64
        Paths of vertices of the part.
    by : str
        What said where to cut.

    Returns
    -------
    Cutout
        As `cut_out` returns it with ``to_disk=False``.
    """
    remarks = list(whole.remarks)
    is_all = len(part.faces) == len(whole.faces)
    named = [part.ids[path] for path in cuts]
    length = sum(float(np.linalg.norm(np.diff(part.points[path], axis=0), axis=1).sum()) for path in cuts)
    if cuts:
        part = part.with_core(part.core.cut([path.astype(np.uint32) for path in cuts]))
    part, told = _one_piece(part, not is_all)
    metadata = {
        **whole.metadata,
        **dict.fromkeys(("seed_point", "seed_found", "radius", "polygon", "sphere")),
        "keep": not is_all,
        "drop": False,
        "cuts": [path.tolist() for path in named],
        "cut_names": [None] * len(named),
        "cuts_by": by,
        "automatic_cuts": [],
        "surface_points": len(whole),
        "points": len(np.unique(part.vertices)),
    }
    return Cutout(whole, part, part.faces, metadata, (*remarks, *told), length, True, is_all)


def opened_to_disk(
    cut: Cutout,
    relax: float | bool | None,
    threads: int | None,
    progress: Progress | None,
    adapt: float | None = None,
) -> Cutout:
    """Close small holes, and cut the rest open to a disk.

    Parameters
    ----------
    cut : Cutout
        As `cut_out` leaves it with ``to_disk=False``.
    relax, threads, progress, adapt
        As in `voxflat.flatten`.

    Returns
    -------
    Cutout
    """
    part, faces, told = close_holes(cut.part, progress)
    remarks = [*cut.remarks, *told]
    automatic: list[dict[str, Any]] = []
    is_fixed = cut.given_length is not None and not cut.metadata["cuts"] and not cut.is_standard
    if relax or not is_fixed:
        given = cut.given_length or 0.0
        part, automatic, told = opened(
            part,
            relax,
            given,
            threads,
            progress,
            is_fixed=is_fixed,
            is_cut=cut.is_cut,
            is_given=cut.is_whole,
            adapt=adapt,
        )
        faces = part.faces[: len(faces)]
        remarks += told
    metadata = {**cut.metadata, "automatic_cuts": automatic, "points": len(np.unique(part.vertices))}
    if cut.is_standard:
        error = sketch_error(part, threads, progress)
        metadata["sketch_error"] = error
        remarks.append(_told_of_standard(cut, error))
    return replace(cut, part=part, faces=faces, metadata=metadata, remarks=tuple(remarks))


def sketch_error(part: Surface, threads: int | None, progress: Progress | None) -> float:
    """Return by how much a sketch of a disk's map gets distances wrong: what relaxation cuts are judged by.

    Parameters
    ----------
    part : Surface
        A disk.
    threads, progress
        As in `voxflat.flatten`.

    Returns
    -------
    float
        Mean relative error, at the best scale; NaN where the disk is too small for a sketch.
    """
    _, _, (error, _) = part.core.relax(None, 0.0, _NO_TRIAL, None, threads, progress)
    return float(error)


# --------------------------------------------------------------------------------------------- templates


def _with_outlines(
    whole: Surface, choice: Choice, region: NDArray[np.bool_] | None
) -> tuple[NDArray[np.bool_], list[str]]:
    """Return what is kept: the user's region where it leaves out what the template does, else what both keep."""
    assert choice.template is not None
    assert choice.sphere is not None
    kept = kept_by(choice.template, whole, choice.sphere)
    if region is None:
        return kept, []
    left_out = ~kept
    covered = float((~region)[left_out].mean()) if left_out.any() else 1.0
    if covered >= _COVERED:
        return region, []
    names = ", ".join(line.name for line in choice.template.outlines)
    return region & kept, [
        f"the region that is left out holds {100 * covered:.0f} % of what the template leaves out ({names}): the "
        "template's is left out, too"
    ]


def _cut_by(choice: Choice, part: Surface, progress: Progress | None) -> tuple[Surface, list[TracedCut], list[str]]:
    """Cut along a template's lines."""
    assert choice.template is not None
    assert choice.sphere is not None
    topology = part.core.topology()
    if topology["handles"]:
        raise InputError(
            f"the surface has {topology['handles']} handles, and a sphere none: a template needs a surface that was "
            "repaired; give cuts='automatic', or repair='cuts'"
        )
    cuts, remarks = traced(choice.template, part, choice.sphere, progress)
    if not cuts:
        return part, cuts, remarks
    opened_part = part.with_core(part.core.cut([cut.vertices.astype(np.uint32) for cut in cuts]))
    after = opened_part.core.topology()
    if (after["euler"], len(after["loops"])) != (min(topology["euler"], 1), max(len(topology["loops"]), 1)):
        raise InputError(
            f"cut along the template the surface has Euler characteristic {after['euler']} and "
            f"{len(after['loops'])} borders: its lines do not fit; give cuts='automatic'"
        )
    return opened_part, cuts, remarks


def _cuts_by(choice: Choice, paths: list[Any] | None) -> str:
    if choice.template is not None:
        return choice.template.name
    return AUTOMATIC if paths is None else "given"


def _told_of_standard(cut: Cutout, error: float) -> str:
    """Say which cuts were made, why, and what else there is."""
    names = ", ".join(cut.metadata["cut_names"])
    if not names:
        return f"no cut of {cut.metadata['cuts_by']} lies in what is flattened"
    length = sum(one.length for one in cut.traced)
    by = cut.metadata["sphere"]["input"]
    what = "standard cuts" if cut.metadata["cuts_by"] == STANDARD else f"the cuts of {cut.metadata['cuts_by']}"
    sketch = "" if np.isnan(error) else f"; distances of a sketch are {100 * error:.1f} % off"
    return (
        f"{what} ({names}; {length:.0f} mm) by {by}, the same for every brain{sketch}; cuts='automatic' finds those "
        "that suit this surface best, and voxflat check says how well"
    )


# --------------------------------------------------------------------------------------------- regions


def _region(
    whole: Surface, keep: object | None, drop: object | None, left_out: NDArray[np.int64] | None
) -> tuple[NDArray[np.bool_] | None, bool]:
    """Return which triangles belong to the patch, and whether they were given, not their corners."""
    if keep is None and drop is None and left_out is None:
        return None, False
    of_mesh = None
    for name, region in (("keep", keep), ("drop", drop)):
        is_name = name == "drop" and is_medial_wall(region)
        if not is_name and isinstance(region, str | os.PathLike) and not os.path.exists(region):
            raise InputError(f"the region to {name}: there is no file {os.fspath(region)}")
    faces = whole.faces
    kept: NDArray[np.bool_] = np.ones(len(faces), dtype=np.bool_)
    if keep is not None:
        of_mesh = None if whole.is_voxels else _triangles(whole, keep)
        kept = _all_corners(_vertices(whole, keep, "the region to keep"), faces) if of_mesh is None else of_mesh
    if drop is not None:
        dropped = medial_wall_of(whole) if is_medial_wall(drop) else _vertices(whole, drop, "the region to drop")
        kept &= _all_corners(~dropped, faces)
    if left_out is not None:
        kept &= _all_corners(~_vertices(whole, left_out, "what the cuts leave out"), faces)
    if not kept.any():
        raise InputError(f"the patch holds no triangle of the surface ({len(whole)} vertices): does it belong to it?")
    return kept, of_mesh is not None


def _all_corners(chosen: NDArray[np.bool_], faces: NDArray[np.uint32]) -> NDArray[np.bool_]:
    return np.asarray(np.asarray(chosen[faces]).all(axis=1))


def _triangles(whole: Surface, keep: object) -> NDArray[np.bool_] | None:
    """Return which triangles another mesh of the same vertices has, if that is what was given."""
    if isinstance(keep, str | os.PathLike):
        if is_patch(keep):
            keep = read_patch(keep)
        elif not holds_mesh(keep):
            return None
    if isinstance(keep, Patch):
        return whole.in_patch(keep)
    mesh = as_mesh(keep)
    if mesh is None:
        return None
    if len(mesh.points) != whole.metadata["vertices"]:
        raise InputError(
            f"the surface to keep has {len(mesh.points)} vertices, the surface {whole.metadata['vertices']}; they must "
            "correspond one by one"
        )
    found = whole.has_triangles(mesh.faces)
    if found is None:
        raise InputError("the surface to keep has triangles that the surface does not have: is it of this one?")
    return found


def _vertices(whole: Surface, region: object, name: str) -> NDArray[np.bool_]:
    if whole.is_voxels and not _is_vertex_list(region):
        place = Volume(
            np.empty(whole.metadata["shape"], dtype=np.bool_), np.asarray(whole.metadata["affine"]), is_placed=True
        )
        return np.asarray(keep_mask(region, place)[tuple(whole.ids.T)])
    if whole.is_voxels:
        chosen = np.zeros(len(whole), dtype=np.bool_)
        chosen[whole.find(array_of(region, name), name)] = True
        return chosen
    count = whole.metadata["vertices"]
    if isinstance(region, str | os.PathLike):
        chosen = read_region(region, count, structure=whole.metadata.get("structure"))
    else:
        chosen = _as_mask(array_of(region, name), count, name)
    chosen = chosen.copy()
    np.logical_or.at(chosen, whole.merged[:, 1], chosen[whole.merged[:, 0]])
    return np.asarray(chosen[whole.vertices])


def _is_vertex_list(region: object) -> bool:
    return isinstance(region, np.ndarray | list) and array_of(region, "region's entries").ndim == 2


def _as_mask(region: NDArray[Any], count: int, name: str) -> NDArray[np.bool_]:
    """Take a mask of the vertices, or their numbers, as a mask."""
    if region.shape == (count,) and (region.dtype.kind == "b" or not region.any() or region.max() <= 1):
        return np.asarray(region != 0)
    if region.ndim != 1 or region.dtype.kind not in "ui":
        raise InputError(
            f"{name} is {region.dtype} of shape {region.shape}; give a mask of shape ({count},), "
            "vertex numbers, or a file"
        )
    bad = region[(region < 0) | (region >= count)]
    if len(bad):
        raise InputError(f"{name} names vertex {bad[0]}, but the mesh has {count} vertices, counted from 0")
    chosen = np.zeros(count, dtype=np.bool_)
    chosen[region] = True
    return chosen


def _seed(part: Surface, seed_point: Sequence[int] | int) -> tuple[int, list[str]]:
    """Return the vertex that a seed point stands for, and a remark if it lies elsewhere."""
    if not part.is_voxels:
        place = array_of(seed_point, "indices of the seed point")
        if place.ndim != 0 or place.dtype.kind not in "ui":
            raise InputError(f"the seed point is {shown(seed_point)}; for a mesh give the number of a vertex")
        return int(part.find(place[None], "the seed point")[0]), []
    wanted = seed_voxel(seed_point)
    vertex, distance = part.nearest(wanted)
    voxel = part.ids[vertex].tolist()
    size = float(np.linalg.norm(np.asarray(part.metadata["affine"])[:3, :3], axis=0).max())
    return vertex, found_seed(wanted, voxel, distance, size)


def _one_piece(part: Surface, is_chosen: bool) -> tuple[Surface, list[str]]:
    """Return the piece with the largest area, if that is what the user can have meant."""
    areas = [piece["area"] for piece in part.core.topology()["components"]]
    if len(areas) == 1:
        return part, []
    share = areas[0] / sum(areas)
    if is_chosen and 1 - share > _STRAY_SHARE:
        shown = ", ".join(f"{area:.4g}" for area in areas[:5]) + (", ..." if len(areas) > 5 else "")
        raise InputError(
            f"the patch falls into {len(areas)} pieces that do not touch (of {shown} mm²): keep one piece, or "
            "give a seed point and a radius"
        )
    what = "the patch" if is_chosen else "the surface"
    remark = f"{what} has {len(areas)} components: the largest, {100 * share:.1f} % of its area, is used"
    return part.with_core(part.core.largest_piece()), [remark]
