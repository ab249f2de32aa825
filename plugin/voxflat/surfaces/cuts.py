"""Make cuts: given cuts (paths or a file), cuts that open a surface to a disk, and relaxation cuts."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Note, Progress, is_whole, shown, unmasked
from voxflat.errors import InputError
from voxflat.io.files import atomic_path, check_format, contents, from_json, naming
from voxflat.io.grid import in_unit, rounded
from voxflat.io.provenance import Record, as_text, saving
from voxflat.read_only import ReadOnly
from voxflat.surfaces.manifold import Manifold, SurfaceT
from voxflat.unique_rows import distinct

CUTS_FORMAT = 1
"""The version of cuts files; a file without a version is of this one."""

_REMEDY = "Pass at least two neighbouring vertices"
_SMALL_HOLE = 15.0  # mm, largest circumference of a hole that is closed to measure distances
_SMALL_HOLE_VOXELS = 12.0  # the same in voxels, or in edges if the unit is unknown
_SMALL_HOLE_SHARE = 0.3  # upper limit for unknown units, relative to the surface's extent
_LEAST_RELIEF = 0.1  # least relative gain of automatic relaxation cuts
_FINE = 0.04  # distance error below which no more cuts are added
BEARABLE = 0.15  # distance error below which a given surface stays as it is
_CLEARLY = 0.5  # share of the distance error to which cuts to cone points must reduce it
_NO_TRIAL = 1e9  # an error limit that is never exceeded, so that no cut is tried


# ----------------------------------------------------------------------------------------- cuts that are given


@dataclass(frozen=True, eq=False)
class Cut(ReadOnly):
    """One cut of a surface.

    A `CutSurface` lists its cuts in the order in which they were made.

    Parameters
    ----------
    ids : ndarray of int64, shape (k,) or (k, 3)
        Vertices along the cut, or their voxels.
    length : float or None
        Length in mm; None for cuts that were passed by the user.
    reason : {"given", "template", "handle", "boundaries joined", "closed sphere", "cone point", "relaxation"}
        The reason for the cut.
    name : str or None
        Name of the cut if it comes from a template, such as ``"calcarine"``, or was passed with a name.

    See Also
    --------
    Surface.cut : Cut a surface open.

    Examples
    --------
    >>> cut_open = voxflat.surface(voxflat.samples.ball()).cut()
    >>> cut_open.cuts[0]
    <Cut along 21 vertices, length 26.3, closed sphere>
    """

    ids: NDArray[np.int64]
    length: float | None
    reason: str
    name: str | None = None

    @property
    def is_automatic(self) -> bool:
        """Whether the cut was neither passed by the user nor part of a template."""
        return self.reason not in ("given", "template")

    def _described(self) -> dict[str, Any]:
        """Return the cut as metadata, ready for JSON."""
        return {"ids": self.ids.tolist(), "length": self.length, "reason": self.reason}

    def __repr__(self) -> str:
        length = "" if self.length is None else f"length {self.length:.1f}, "
        name = "" if self.name is None else f"{self.name!r}, "
        return f"<Cut {name}along {len(self.ids)} vertices, {length}{self.reason}>"


def described_cuts(cuts: Sequence[Cut]) -> dict[str, Any]:
    """Return cuts as metadata, ready for JSON."""
    user_cuts = [cut for cut in cuts if not cut.is_automatic]
    return {
        "cuts": [cut.ids.tolist() for cut in user_cuts],
        "cut_names": [cut.name for cut in user_cuts],
        "automatic_cuts": [cut._described() for cut in cuts if cut.is_automatic],
    }


def save_cuts(
    path: str | os.PathLike[str], cuts: Sequence[Cut], left_out: NDArray[np.int64], record: Record, **writing: bool
) -> None:
    """Write cuts and excluded vertices to a file that `read_cuts` reads; see `voxflat.CutSurface.save`."""
    content: dict[str, Any] = {"format": CUTS_FORMAT, "cuts": [cut.ids.tolist() for cut in cuts]}
    if any(cut.name for cut in cuts):
        content["names"] = [cut.name for cut in cuts]
    content |= {"drop": left_out.tolist(), "provenance": record}
    with saving(path, record, **writing), atomic_path(path) as beside:
        beside.write_text(as_text(content) + "\n", encoding="utf-8", newline="\n")


@dataclass(frozen=True)
class Given:
    """A cut that the user passed."""

    path: Any  # its vertices, by input ids
    title: str  # its name or number in messages
    name: str | None = None


def read_cuts(whole: Manifold, cuts: object | None) -> tuple[list[Given] | None, NDArray[np.int64] | None]:
    """Return given cuts as paths of neighbouring vertices, and the vertices that a cuts file excludes, by input ids."""
    if cuts is None:
        return None, None
    if isinstance(cuts, str | os.PathLike):
        read, left_out = _from_file(Path(cuts), 3 if whole.is_voxels else None)
        return [_filled(whole, cut) for cut in read], left_out
    if isinstance(cuts, Mapping):
        for name in cuts:
            if not isinstance(name, str) or not name:
                raise InputError(f"the name of a cut is {shown(name)}. Pass names as text")
        unmasked(list(cuts.values()), "vertices of the cuts")
        return [Given(path, f"cut {name!r}", name) for name, path in cuts.items()], None
    unmasked(cuts, "vertices of the cuts")
    if isinstance(cuts, np.ndarray) and cuts.ndim:
        cuts = list(cuts)
    if isinstance(cuts, list | tuple) and len(cuts) and is_whole(cuts[0]):
        cuts = [cuts]
    if not isinstance(cuts, list | tuple):
        raise InputError(
            f"cuts has type {type(cuts).__name__}. Pass a list of paths (each a list of neighbouring vertices), or the "
            "path to a cuts file"
        )
    return [Given(path, f"cut {number}") for number, path in enumerate(cuts, 1)], None


def _from_file(path: Path, indices: int | None) -> tuple[list[Given], NDArray[np.int64] | None]:
    """Read a cuts file: lists of vertices with their names, and the excluded vertices."""
    try:
        content = from_json(contents(path))
    except OSError as error:
        remedy = "Pass 'standard', 'automatic', a file or paths"
        raise InputError(f"cannot read the cuts from {path}: {error.strerror}. {remedy}") from error
    except ValueError as error:
        raise InputError(f"{path} is not a cuts file: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("cuts"), list):
        raise InputError(f'{path} is not a cuts file. Pass a file with {{"cuts": [[vertex, ...], ...], "drop": [...]}}')
    check_format(path, content.get("format", CUTS_FORMAT), CUTS_FORMAT, "Save the cuts again")
    lists = [_vertices(path, values, indices) for values in content["cuts"]]
    left_out = _vertices(path, content.get("drop", []), indices)
    names = content.get("names") or [None] * len(lists)
    is_text = isinstance(names, list) and all(name is None or (isinstance(name, str) and name) for name in names)
    if not is_text or len(names) != len(lists):
        raise InputError(f"{path}: 'names' does not match the {len(lists)} cuts. Provide one name or null for each cut")
    titles = [f"{path}: cut {number if name is None else repr(name)}" for number, name in enumerate(names, 1)]
    cuts = [Given(*cut) for cut in zip(lists, titles, names, strict=True) if len(cut[0])]
    return cuts, left_out if len(left_out) else None


def _vertices(path: Path, values: object, indices: int | None) -> NDArray[np.int64]:
    try:
        array = np.asarray(values)
    except ValueError:
        array = np.empty((0, 0, 0))
    if array.size == 0 and array.ndim == 1:
        return np.empty((0,) if indices is None else (0, indices), dtype=np.int64)
    if array.dtype.kind not in "iu" or array.shape[1:] != (() if indices is None else (indices,)):
        kind = "vertex numbers" if indices is None else "voxel indices"
        raise InputError(f"{path} has a list with type {array.dtype} and shape {array.shape}. Provide lists of {kind}")
    return array.astype(np.int64)


def _filled(whole: Manifold, cut: Given) -> Given:
    """Connect vertices that are not neighbours by shortest paths along edges."""
    vertices = _vertices_along(whole, cut).tolist()
    passed = vertices[:1]
    if _are_linked(whole, np.asarray(vertices)):
        return cut
    for a, b in pairwise(vertices):
        try:
            steps, _ = whole.core.edge_path(a, b)
        except InputError:
            ends = [whole.ids[end].tolist() for end in (a, b)]
            remedy = "Pass a cut on one component"
            raise InputError(f"{cut.title}: the surface has no path from {ends[0]} to {ends[1]}. {remedy}") from None
        passed += steps[1:].tolist()
    return replace(cut, path=np.asarray(whole.ids[passed]))


def _vertices_along(part: Manifold, cut: Given) -> NDArray[np.uint32]:
    """Find the vertices of a path; if a voxel has several, choose those that are consecutive neighbours."""
    with naming(cut.title, _REMEDY):
        nearest = part.find(cut.path, "the path")
    if not part.is_voxels or len(nearest) < 2 or _are_linked(part, nearest):
        return nearest
    voxel = distinct(part.ids).which
    choices = [np.flatnonzero(voxel == voxel[vertex]).tolist() for vertex in nearest]
    links = _links(part, np.concatenate([np.array(vertices) for vertices in choices]))
    before: list[dict[int, int]] = [dict.fromkeys(choices[0], -1)]
    for vertices in choices[1:]:
        steps = ((b, next((a for a in before[-1] if (a, b) in links), None)) for b in vertices)
        before.append({b: a for b, a in steps if a is not None})
    if not before[-1]:
        return nearest
    chain = [next(iter(before[-1]))]
    for step in before[:0:-1]:
        chain.append(step[chain[-1]])
    return np.array(chain[::-1], dtype=np.uint32)


def _are_linked(part: Manifold, vertices: NDArray[Any]) -> bool:
    """Return whether consecutive vertices are neighbours."""
    links = _links(part, vertices)
    return all(pair in links for pair in pairwise(vertices.tolist()))


def _links(part: Manifold, vertices: NDArray[Any]) -> set[tuple[int, int]]:
    """Return the edges between any of the given vertices, in both directions."""
    is_given = np.zeros(len(part), dtype=np.bool_)
    is_given[vertices] = True
    ends = np.concatenate([part.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    ends = ends[is_given[ends].all(axis=1)]
    return {(a, b) for a, b in np.concatenate([ends, ends[:, ::-1]]).tolist()}


def cut_along(part: SurfaceT, cuts: list[Given] | None) -> tuple[SurfaceT, list[Cut], float]:
    """Cut along paths of neighbours; also return the cuts, and their length in mm."""
    cuts = cuts or []
    paths = [_vertices_along(part, cut) for cut in cuts]
    length = sum(float(np.linalg.norm(np.diff(part.points[path], axis=0), axis=1).sum()) for path in paths)
    named = [Cut(np.asarray(cut.path), None, "given", cut.name) for cut in cuts]
    if not paths:
        return part, named, length
    try:
        core = part.core.cut(paths)
        is_fine = min(map(len, paths)) > 1 and len(core.topology()["components"]) == 1
    except InputError:
        is_fine = False
    if not is_fine:
        _refuse(part, cuts, paths)
    return part._with_core(core), named, length


def _refuse(part: Manifold, cuts: list[Given], paths: list[NDArray[np.uint32]]) -> None:
    """Raise an error for the first cut that is not a path of neighbours, or that separates a piece of the surface."""
    for number, (cut, path) in enumerate(zip(cuts, paths, strict=True), 1):
        if len(path) < 2:
            raise InputError(f"{cut.title} has only one vertex. {_REMEDY}, or omit this cut")
        with naming(cut.title, _REMEDY):
            part.core.cut([path])
        pieces = part.core.cut(paths[:number]).topology()["components"]["area"].tolist()
        if len(pieces) > 1:
            share = 100 * (1 - max(pieces) / sum(pieces))
            raise InputError(
                f"{cut.title} separates {share:.2g} % of the area from the rest of the surface, because it forms a "
                "closed line, alone or with other cuts or the boundary. Shorten or remove this cut. To exclude the "
                "enclosed region, choose the part to flatten instead"
            )


# ------------------------------------------------------------------------------------------- holes and automatic cuts


def check_relax(relax: float | bool | None, adapt: float | None = None) -> None:
    """Raise an error for invalid values of `relax` or `adapt`."""
    if adapt is not None:
        if not (isinstance(adapt, Real) and not isinstance(adapt, bool) and adapt > 0 and math.isfinite(adapt)):
            raise InputError(f"adapt is {shown(adapt)}. Pass the maximum distance from the cuts of the template, in mm")
        if relax is False:
            raise InputError("adapt adds relaxation cuts, but relax=False disables them. Pass only one of them")
    if relax is not None and not (isinstance(relax, Real) and relax >= 0 and math.isfinite(relax)):
        raise InputError(f"relax is {shown(relax)}. Pass the total length of the cuts in mm, at least 0")


def close_holes(part: SurfaceT, progress: Progress | None) -> tuple[SurfaceT, NDArray[np.uint32], list[str]]:
    """Close small holes, so that distances can cross them; the faces of the input come first in the result."""
    longest = _SMALL_HOLE
    if part.is_voxels:
        longest = _SMALL_HOLE_VOXELS * part._largest_spacing
    elif part.origin.unit != "mm":
        across = float(np.ptp(part.points, axis=0).max())
        longest = min(_SMALL_HOLE_VOXELS * part.usual_edge, _SMALL_HOLE_SHARE * across)
    core, filled, _ = part.core.fill_holes(longest, progress)
    if not filled:
        return part, part.faces, []
    text = f"closed {filled} hole(s) with a circumference of up to {longest:g} mm, so that distances can cross them"
    return part._with_core(core), part.faces, [Note(in_unit(text, part.origin.named_unit))]


def opened(
    part: SurfaceT,
    relax: float | bool | None,
    user_length: float,
    threads: int | None,
    progress: Progress | None,
    *,
    holes: bool = False,
    is_fixed: bool = False,
    is_cut: bool = False,
    is_given: bool = False,
    adapt: float | None = None,
) -> tuple[SurfaceT, list[Cut], list[str]]:
    """Cut a surface open to a disk, and add relaxation cuts.

    `user_length` is the total length of the given cuts in mm, counted towards `relax`. With `holes`, the surface keeps
    its holes if a cut would not improve the map. If `is_fixed`, a surface that is not a disk stays as it is. A surface
    that the user has cut gets relaxation cuts only on request; a surface that the user passed and that stays as it is
    gets them on request, or if its distance error is large. `adapt` requests them within this distance (mm) of existing
    cuts.
    """
    topology = part.core.topology(progress)["components"][0]
    cuts: list[Cut] = []
    warnings = []
    uncut = part
    is_domain = topology["loops"] > 1 and not topology["handles"]
    if topology["euler"] != 1 and not is_fixed and not (holes and is_domain and _is_kept(part, threads, progress)):
        core, lines = part.core.open_to_disk([], threads, progress)
        part, cuts = part._with_core(core), _named(part, lines)
        paths, total = _counted(cuts, "path")
        warnings.append(
            f"the surface is not a disk ({topology['handles']} handles, {topology['loops']} boundary loops), so it was "
            f"cut open along {paths} ({rounded(total)} mm in total)"
        )
    if not is_fixed and not is_cut and adapt is None and (relax is None or relax is True):
        to_points = _cut_to_cone_points(uncut, part, threads, progress)
        if to_points is not None:
            part, cuts, warning = to_points
            warnings = [warning]
    was_closed = any(cut.reason == "closed sphere" for cut in cuts)
    kind = str if topology["handles"] else Note
    if relax is False or (relax is None and is_cut and not was_closed and adapt is None):
        return part, cuts, [kind(in_unit(text, part.origin.named_unit)) for text in warnings]
    length = None if relax is None or relax is True else max(0.0, float(relax) - user_length)
    least_relief, bearable = 0.0, 0.0
    if relax is None and not was_closed and adapt is None:
        least_relief, bearable = _LEAST_RELIEF, BEARABLE if is_given and not cuts else _FINE
    core, lines, errors = part.core.relax(length, least_relief, bearable, adapt, threads, progress)
    further = _named(part, lines)
    if further:
        paths, total = _counted(further, "relaxation cut")
        before, after = (100 * error for error in errors)
        warnings.append(
            f"added {paths} ({rounded(total)} mm in total), which reduce the estimated distance error from "
            f"{before:.1f} % to {after:.1f} %. Use relax=False to omit them"
        )
    return part._with_core(core), cuts + further, [kind(in_unit(text, part.origin.named_unit)) for text in warnings]


def _cut_to_cone_points(
    uncut: SurfaceT, part: SurfaceT, threads: int | None, progress: Progress | None
) -> tuple[SurfaceT, list[Cut], str] | None:
    """Return a surface cut open at its cone points, if this improves the map of the part clearly."""
    points = uncut.core.cone_points()
    if not points or not (before := sketch_error(part, threads, progress)) > _FINE:
        return None
    core, lines = uncut.core.open_to_disk(points, threads, progress)
    opened_part, cuts = uncut._with_core(core), _named(uncut, lines)
    after = sketch_error(opened_part, threads, progress)
    if not after < _CLEARLY * before:
        return None
    paths, total = _counted(cuts, "path")
    where = "one vertex" if len(points) == 1 else f"{len(points)} vertices"
    warning = (
        f"nearly all of the curvature lies at {where}, so the surface was cut open there along {paths} "
        f"({rounded(total)} mm in total), which reduces the estimated distance error from {100 * before:.1f} % to "
        f"{100 * after:.1f} %. Use relax=False to omit these cuts"
    )
    return opened_part, cuts, warning


def _is_kept(part: Manifold, threads: int | None, progress: Progress | None) -> bool:
    """Return whether cuts that join the boundary loops would not improve the map of a surface with holes."""
    try:
        error = sketch_error(part, threads, progress)
    except InputError:  # no map without folds, for example of a long tube
        return False
    if error <= _FINE:
        return True
    core, _ = part.core.open_to_disk([], threads, progress)
    return sketch_error(part._with_core(core), threads, progress) > (1.0 - _LEAST_RELIEF) * error


def sketch_error(part: Manifold, threads: int | None, progress: Progress | None) -> float:
    """Return the mean relative distance error of a coarse preview map at the best scale; NaN for tiny surfaces."""
    _, _, (error, _) = part.core.relax(None, 0.0, _NO_TRIAL, None, threads, progress)
    return float(error)


def relaxation_advice(part: Manifold, threads: int | None, progress: Progress | None) -> str:
    """Return what relaxation cuts would achieve, as the end of a warning; empty if they would not reduce the error."""
    _, lines, (before, after) = part.core.relax(None, _LEAST_RELIEF, 0.0, None, threads, progress)
    if not lines:
        return ""
    paths, total = _counted(_named(part, lines), "cut")
    text = (
        f". Use relax=True to add {paths} ({rounded(total)} mm in total), which would reduce the estimated distance "
        f"error from {100 * before:.1f} % to {100 * after:.1f} %"
    )
    return in_unit(text, part.origin.named_unit)


def _counted(cuts: list[Cut], name: str) -> tuple[str, float]:
    return f"{len(cuts)} {name}" + ("" if len(cuts) == 1 else "s"), sum(cut.length or 0.0 for cut in cuts)


def _named(part: Manifold, cuts: list[dict[str, Any]]) -> list[Cut]:
    """Return the cuts of the core, with the ids of their vertices."""
    ids = part.ids
    return [Cut(ids[cut["vertices"]], cut["length"], cut["reason"]) for cut in cuts]
