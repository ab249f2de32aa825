"""Turn a surface, or a part of it, into the disk (possibly with holes) that is flattened, and warn about changes."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Note, Progress, checked_threads, log
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, rounded
from voxflat.io.provenance import Record
from voxflat.read_only import ReadOnly
from voxflat.surfaces.cuts import (
    Cut,
    check_relax,
    close_holes,
    cut_along,
    described_cuts,
    opened,
    read_cuts,
    sketch_error,
)
from voxflat.surfaces.manifold import Manifold, Step, SurfaceT, SurfaceT_co
from voxflat.surfaces.parts import dropped, largest_piece
from voxflat.surfaces.standard.choice import AUTOMATIC, Choice, chosen
from voxflat.surfaces.standard.sphere import Sphere
from voxflat.surfaces.standard.template import STANDARD
from voxflat.surfaces.standard.tracing import TracedCut, kept_by, traced
from voxflat.surfaces.uncertainty import warning_of

_COVERED = 0.5  # share of a template's excluded region that a user's excluded region must cover to replace it


@dataclass(frozen=True)
class Tube:
    """A tube before it was cut open, on which the distances of a periodic map are measured."""

    part: Manifold
    seam: NDArray[np.int64]  # its vertices from the left to the right end

    def rows(self, opened: Manifold) -> NDArray[np.int64]:
        """Return the vertex of the tube for each vertex of the surface that was cut open along the seam."""
        rows = np.empty(len(opened), dtype=np.int64)
        rows[opened.faces] = self.part.faces
        return rows


@dataclass(frozen=True)
class Chart:
    """The place of a chart on a closed organ or a tube."""

    description: dict[str, object]  # its number, name, axis and overlap
    onto: NDArray[np.float64]  # where the vertices of the complete surface belong on the map, or NaN
    tube: Tube | None = None  # the tube before it was cut open, if the map is to be periodic


@dataclass(frozen=True, eq=False)
class CutManifold(ReadOnly, Generic[SurfaceT_co]):
    """The geometry of a surface that was cut open, and a record of the steps.

    `voxflat.CutSurface` describes the fields and adds operations that need the modules above.
    """

    whole: SurfaceT_co
    surface: SurfaceT_co
    faces: NDArray[np.uint32]
    cuts: tuple[Cut, ...]
    cuts_by: str
    warnings: tuple[str, ...] = ()
    given_length: float | None = None
    sphere: Sphere | None = None
    is_standard: bool = False
    chart: Chart | None = None
    sketch_error: float | None = None
    has_logged: bool = False
    provenance: Record = field(default_factory=dict)

    @property
    def left_out(self) -> NDArray[np.int64]:
        """Vertices of the whole surface that are excluded, or their voxels.

        They are numbered as in the input.
        """
        return self.whole.ids[~np.isin(self.whole.vertices, self.surface.vertices)]

    @property
    def _is_cut(self) -> bool:
        """Whether the user defined cuts, directly or by a patch's triangles."""
        return self.given_length is not None or any(step.by_triangles for step in self.surface.steps)

    @property
    def _is_fixed(self) -> bool:
        """Whether the user asked for no cut."""
        return self.given_length is not None and not self.cuts and not self.is_standard

    @property
    def _is_whole(self) -> bool:
        """Whether the user excluded nothing of the input."""
        return not any(step.verb != "outlines" for step in self.surface.steps)

    @property
    def metadata(self) -> dict[str, object]:
        """How the part was selected and cut, for people and files; `FlatMap.metadata` contains it."""
        of_cuts = {**described_cuts(self.cuts), "cuts_by": self.cuts_by}
        return {**self.whole.origin._described(), **self.details, **of_cuts}

    @property
    def details(self) -> dict[str, object]:
        """The entries of `metadata` beside those that the other fields write."""
        verbs = {step.verb: step for step in self.surface.steps}
        disk, corners = verbs.get("disk"), verbs.get("polygon")
        details = {"chart": None if self.chart is None else self.chart.description, "sketch_error": self.sketch_error}
        return {
            **self.whole.details,
            "keep": "keep" in verbs,
            "drop": "drop" in verbs,
            "seed_point": None if disk is None else disk.seed_point,
            "seed_found": None if disk is None else disk.seed_found,
            "radius": None if disk is None else disk.radius,
            "polygon": None if corners is None else corners.corners,
            "sphere": None if self.sphere is None else self.sphere._described(),
            "surface_points": len(self.whole),
            "points": len(np.unique(self.surface.vertices)),
            **{name: value for name, value in details.items() if value is not None},
        }

    def _anatomy(self, threads: int | None = None, progress: Progress | None = None) -> dict[str, NDArray[np.float64]]:
        """Return curvature and sulcal depth of the part's vertices, computed on the complete surface."""
        of_whole = {"curvature": self.whole.mean_curvature, "sulcal_depth": self.whole.sulcal_depth}
        anatomy = {}
        for name, measure in of_whole.items():
            placed = np.full(self.whole.count, np.nan)
            placed[self.whole.vertices] = measure(threads=threads, progress=progress)
            anatomy[name] = placed[self.surface.vertices]
        return anatomy


@dataclass(frozen=True, kw_only=True)
class CutSettings:
    """The arguments of `voxflat.Surface.cut`."""

    cuts: object | None = None
    sphere: object | None = None
    relax: float | bool | None = None
    adapt: float | None = None
    threads: int | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        """Check the number of threads."""
        object.__setattr__(self, "threads", checked_threads(self.threads))

    @property
    def defines_cuts(self) -> bool:
        """Whether the user defined where to cut."""
        return any(value is not None for value in (self.cuts, self.sphere, self.relax, self.adapt))


def cut_open(
    part: SurfaceT, settings: CutSettings, *, to_disk: bool = True, holes: bool = True
) -> CutManifold[SurfaceT]:
    """Cut a surface or a part open to a disk, or to a disk with holes where no cut improves the map.

    Without `holes`, the result is a disk. Without `to_disk`, only the requested cuts are made, and small holes stay.
    """
    cuts, relax, adapt = settings.cuts, settings.relax, settings.adapt
    threads, progress = settings.threads, settings.progress
    whole = part._complete
    check_relax(relax, adapt)
    is_free = all(step.verb == "drop" for step in part.steps)
    choice = chosen(whole, cuts, settings.sphere, is_free=is_free, threads=threads, progress=progress)
    warnings = list(choice.warnings)
    is_named = choice.template is not None or (isinstance(cuts, str) and cuts == AUTOMATIC)
    paths, left_out = (None, None) if is_named else read_cuts(whole, cuts)
    if left_out is not None:
        part = dropped(part, left_out)
    if choice.template is not None:
        part, of_outlines = _with_outlines(whole, choice, part)
        warnings += of_outlines
    part = largest_piece(part, progress)
    warnings = [*_warnings(part), *warnings]
    uncut = part
    if choice.template is None:
        part, cuts, length = cut_along(part, paths)
    else:
        part, named, of_cuts = _cut_by(choice, part, progress)
        cuts = [Cut(uncut.ids[cut.vertices], cut.length, "template", cut.name) for cut in named]
        length = sum(cut.length for cut in named)
        warnings += of_cuts
    origin = choice.template.name if choice.template else AUTOMATIC if paths is None else "given"
    is_standard = choice.template is not None
    user_length = length if is_standard or paths is not None else None
    fields = (whole, part, part.faces, tuple(cuts), origin, tuple(warnings), user_length)
    cut = CutManifold(*fields, sphere=choice.sphere, is_standard=is_standard)
    if adapt is not None and not is_standard:
        raise InputError("adapt requires a template. Pass cuts='standard' or a template file, or omit adapt")
    return opened_to_disk(cut, relax, threads, progress, adapt, holes=holes) if to_disk else cut


def cut_out_as(whole: SurfaceT, part: SurfaceT, cuts: Sequence[NDArray[np.int64]], by: str) -> CutManifold[SurfaceT]:
    """Cut a part along known cuts, paths of its vertices; like `cut_open` without `to_disk`."""
    is_all = len(part.faces) == len(whole.faces)
    named = tuple(Cut(part.ids[path], None, "given") for path in cuts)
    length = sum(float(np.linalg.norm(np.diff(part.points[path], axis=0), axis=1).sum()) for path in cuts)
    if cuts:
        part = part._with_core(part.core.cut([path.astype(np.uint32) for path in cuts]))
    part = largest_piece(part if is_all else replace(part, steps=(Step("keep"),)))
    return CutManifold(whole, part, part.faces, named, by, _warnings(part), length)


def _warnings(part: Manifold) -> tuple[str, ...]:
    """Return the warnings of a part, with that of uncertain depths in it."""
    if part.uncertain is None:
        return part.warnings
    text = warning_of(part.uncertain[part.vertices], "the patch" if part.steps else "the surface")
    return part.warnings if text is None else (*part.warnings, text)


def opened_to_disk(
    cut: CutManifold[SurfaceT],
    relax: float | bool | None,
    threads: int | None,
    progress: Progress | None,
    adapt: float | None = None,
    *,
    holes: bool = False,
) -> CutManifold[SurfaceT]:
    """Close small holes, and cut the surface open to a disk; with `holes`, keep others if no cut improves the map."""
    part, faces, of_holes = close_holes(cut.surface, progress)
    warnings = [*cut.warnings, *of_holes]
    automatic: list[Cut] = []
    is_fixed = cut._is_fixed
    if relax or not is_fixed:
        user_length = cut.given_length or 0.0
        state = {"holes": holes, "is_fixed": is_fixed, "is_cut": cut._is_cut, "is_given": cut._is_whole}
        part, automatic, of_cuts = opened(part, relax, user_length, threads, progress, **state, adapt=adapt)
        faces = part.faces[: len(faces)]
        warnings += of_cuts
    error = None
    if cut.is_standard:
        error = sketch_error(part, threads, progress)
        warnings.append(_standard_warning(cut, error))
    cuts = (*cut.cuts, *automatic)
    return replace(cut, surface=part, faces=faces, cuts=cuts, sketch_error=error, warnings=tuple(warnings))


def without_holes(cut: CutManifold[SurfaceT], settings: CutSettings) -> CutManifold[SurfaceT]:
    """Cut a surface that has kept its holes open to a disk."""
    if len(cut.surface.core.topology()["loops"]) < 2 or cut._is_fixed:
        return cut
    part, automatic, warnings = opened(cut.surface, False, 0.0, settings.threads, settings.progress)
    if cut.has_logged:
        for warning in warnings:
            log.warning(warning)
    faces, cuts = part.faces[: len(cut.faces)], (*cut.cuts, *automatic)
    return replace(cut, surface=part, faces=faces, cuts=cuts, warnings=(*cut.warnings, *warnings))


def _with_outlines(whole: SurfaceT, choice: Choice, part: SurfaceT) -> tuple[SurfaceT, list[str]]:
    """Return a part without the region that a template excludes, unless the user has excluded most of it already."""
    assert choice.template is not None
    assert choice.sphere is not None
    is_kept = kept_by(choice.template, whole, choice.sphere)
    warnings: list[str] = []
    if part.steps:
        region = whole._has_triangles(part.vertices[part.faces])
        assert region is not None
        covered = float((~region)[~is_kept].mean()) if not is_kept.all() else 1.0
        if covered >= _COVERED:
            return part, []
        names = ", ".join(line.name for line in choice.template.outlines)
        warnings = [
            f"the excluded region covers only {100 * covered:.0f} % of the region that the template excludes "
            f"({names}), so the template's region is also excluded"
        ]
        is_kept &= region
    left = replace(part, core=whole.core.part_of_faces(is_kept), steps=(*part.steps, Step("outlines")), whole=whole)
    return left, warnings


def _cut_by(choice: Choice, part: SurfaceT, progress: Progress | None) -> tuple[SurfaceT, list[TracedCut], list[str]]:
    """Cut a part along the lines of a template."""
    assert choice.template is not None
    assert choice.sphere is not None
    topology = part.core.topology()
    if topology["handles"]:
        raise InputError(
            f"the surface has {topology['handles']} handles, but a template requires a surface without handles. "
            "Pass cuts='automatic' or repair='cuts'"
        )
    cuts, warnings = traced(choice.template, part, choice.sphere, progress)
    if not cuts:
        return part, cuts, warnings
    opened_part = part._with_core(part.core.cut([cut.vertices.astype(np.uint32) for cut in cuts]))
    after = opened_part.core.topology()
    if (after["euler"], len(after["loops"])) != (min(topology["euler"], 1), max(len(topology["loops"]), 1)):
        raise InputError(
            "the lines of the template do not open the surface to a disk: after cutting, its Euler characteristic is "
            f"{after['euler']}, and it has {len(after['loops'])} boundary loops. Pass cuts='automatic'"
        )
    return opened_part, cuts, warnings


def _standard_warning(cut: CutManifold[Any], error: float) -> str:
    """Return a warning on the cuts of a template, their reason, and the alternative."""
    names = ", ".join(line.name or "" for line in cut.cuts)
    if not names:
        return f"no cut of {cut.cuts_by} lies in the flattened region"
    assert cut.sphere is not None
    length = sum(line.length or 0.0 for line in cut.cuts)
    name = os.path.basename(cut.sphere.name)
    kind = "standard cuts" if cut.cuts_by == STANDARD else f"the cuts of {cut.cuts_by}"
    estimate = "" if np.isnan(error) else f" The estimated distance error is {100 * error:.1f} %."
    text = (
        f"cut along {kind} ({names}; {rounded(length)} mm), located with {name}, so that maps of different brains "
        f"can be compared.{estimate} For less distortion, choose automatic cuts. `voxflat check` compares the two"
    )
    return Note(in_unit(text, cut.whole.origin.named_unit))


def cut_handles(whole: SurfaceT, threads: int | None, progress: Progress | None) -> SurfaceT:
    """Cut all handles open along short loops, and add a warning."""
    core, handles = whole.core.cut_handles(threads, progress)
    if not handles:
        return whole
    lengths = [handle["length"] for handle in handles]
    least, most = rounded(min(lengths), 1), rounded(max(lengths), 1)
    warning = in_unit(f"cut {len(handles)} handle(s) open along loops of {least} to {most} mm", whole.origin.named_unit)
    details = {**whole.details, "handles_cut": handles}
    return replace(whole, core=core, details=details, warnings=(*whole.warnings, warning))
