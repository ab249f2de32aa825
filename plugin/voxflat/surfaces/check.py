"""What an input holds, whether its surface can be flattened, and what each remedy would change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from voxflat import _core
from voxflat.arguments import Progress, checked_threads
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh
from voxflat.io.reading import reading
from voxflat.io.spaces import Space
from voxflat.io.volumes import Volume, as_volume
from voxflat.surfaces.foreground import check_scalar, foreground, labels_in
from voxflat.surfaces.making import surface as _surface
from voxflat.surfaces.of_mesh import as_mesh
from voxflat.surfaces.region import Cutout, cut_out, opened_to_disk, sketch_error
from voxflat.surfaces.standard.choice import AUTOMATIC
from voxflat.surfaces.surface import Surface

__all__ = ["Check", "check"]

_SHOWN = 5  # handles, holes and loops that a table names one by one


@dataclass(frozen=True)
class Check:
    """What was read, and whether its surface can be flattened.

    Parameters
    ----------
    path : str or None
        The file.
    kind : {"volume", "mesh"}
        What it is.
    contents : dict
        What it holds. Of a volume ``shape``, ``dtype``, ``spacing`` (mm), ``orientation`` (such as "RAS"), ``affine``,
        ``labels`` (numbers of voxels by label; None for intensities), ``range``; of a mesh ``vertices``, ``triangles``,
        ``size`` (mm), ``structure``, and ``space``: ``name`` ("scanner", "tkRAS" or "unknown") and ``to_scanner``, the
        matrix from the coordinates to scanner RAS.
    defects : dict of str to list
        What keeps a mesh from being a surface, and where: numbers of triangles or vertices. What of it was mended
        stands in `advice`.
    foreground : int or None
        Number of foreground voxels; None for meshes, and if label or threshold are still to be chosen.
    surface_points : int or None
        Number of the surface's vertices.
    sheet : bool or None
        Whether the foreground is a sheet one voxel thick, of which one surface is made.
    split_vertices : int or None
        Vertices that were added because a voxel carries several sheets.
    components : tuple of int
        Numbers of vertices of the surface's components, the one of the largest area first.
    used : int or None
        Number of vertices of the part that would be flattened.
    euler_characteristic : int or None
        χ of that part before it is cut open: 1 is a disk, 2 a closed sphere.
    closed : bool or None
        Whether it has no boundary.
    boundary : tuple of float
        Lengths of its boundary loops, mm, longest first; all but one are holes.
    handles : tuple of dict
        Its handles: ``length`` (mm) of a short loop around each, and its ``centre`` (RAS+ mm).
    thin : dict or None
        Places where the solid is thinner than ``thickness`` (1.2 voxels; of a mesh its median edge), mm: how many
        ``points`` lie there, and the ``worst`` thickness and its ``place`` (RAS+ mm).
    automatic_cuts : tuple of dict
        What it would be cut open along: ``length`` (mm), ``reason``, ``ids``.
    named_cuts : tuple of dict
        The cuts of a template before: ``name``, ``length`` (mm), ``ids``.
    cuts_by : str or None
        What says where it is cut: "standard", a template's file, "given" or "automatic".
    sketch_errors : dict of str to float
        Where a template says it: by how much a sketch of the map gets distances wrong (mean relative error), by
        `cuts_by`, and for "automatic" cuts, which would be found otherwise.
    can_flatten : bool
        The verdict.
    advice : tuple of str
        What to know and what to do.
    """

    path: str | None
    kind: str
    contents: dict[str, Any]
    defects: dict[str, list[Any]] = field(default_factory=dict)
    foreground: int | None = None
    surface_points: int | None = None
    sheet: bool | None = None
    split_vertices: int | None = None
    components: tuple[int, ...] = ()
    used: int | None = None
    euler_characteristic: int | None = None
    closed: bool | None = None
    boundary: tuple[float, ...] = ()
    handles: tuple[dict[str, Any], ...] = ()
    thin: dict[str, Any] | None = None
    automatic_cuts: tuple[dict[str, Any], ...] = ()
    named_cuts: tuple[dict[str, Any], ...] = ()
    cuts_by: str | None = None
    sketch_errors: dict[str, float] = field(default_factory=dict)
    can_flatten: bool = False
    advice: tuple[str, ...] = ()

    def __repr__(self) -> str:
        size = "" if self.surface_points is None else f"{self.surface_points} vertices, "
        verdict = "can" if self.can_flatten else "cannot"
        return f"<Check of {self.path or 'an array'}: {self.kind}, {size}{verdict} be flattened>"

    def rows(self) -> list[tuple[str, str]]:
        """Return the findings, a name and what was found each, without the advice."""
        rows = [("input", self.path or "array"), *self._contents()]
        rows += [(name, f"{len(places)}: {_shortened(places)}") for name, places in self.defects.items() if places]
        if self.surface_points is not None:
            rows += self._surface()
        rows.append(("can be flattened", "yes" if self.can_flatten else "no"))
        return rows

    def table(self) -> str:
        """Return the findings as a table of text."""
        rows = self.rows()
        width = max(len(name) for name, _ in rows) + 2
        text = [f"{name:{width}}{value}" for name, value in rows]
        return "\n".join(text + [f"- {advice}" for advice in self.advice])

    def _contents(self) -> list[tuple[str, str]]:
        of = self.contents
        if self.kind == "mesh":
            size = " x ".join(f"{side:.4g}" for side in of["size"])
            rows = [("mesh", f"{of['vertices']} vertices, {of['triangles']} triangles"), ("size", f"{size} mm")]
            rows.append(("coordinates", str(Space.of(of))))
            return rows + ([("structure", of["structure"])] if of["structure"] else [])
        labels = of["labels"]
        return [
            ("shape", " x ".join(str(n) for n in of["shape"]) + f", {of['dtype']}"),
            ("spacing", " x ".join(f"{h:g}" for h in of["spacing"]) + " mm"),
            ("orientation", of["orientation"]),
            ("values", f"{of['range'][0]:g} to {of['range'][1]:g}"),
            (
                "labels (voxels)",
                "intensities" if labels is None else _shortened([f"{k} ({n})" for k, n in labels.items()], 12),
            ),
        ]

    def _surface(self) -> list[tuple[str, str]]:
        rows = []
        if self.foreground is not None:
            rows.append(("foreground", f"{self.foreground} voxels" + (", a sheet" if self.sheet else "")))
        split = f", {self.split_vertices} of them split" if self.split_vertices else ""
        rows += [
            ("surface", f"{self.surface_points} vertices{split}"),
            ("components", f"{len(self.components)}: {_shortened(self.components)}"),
            ("used", f"{self.used} vertices"),
            ("Euler characteristic", f"{self.euler_characteristic} (disk: 1, closed sphere: 2)"),
            ("boundary loops", f"{len(self.boundary)}: {_shortened([f'{mm:.0f} mm' for mm in self.boundary])}"),
            ("handles", f"{len(self.handles)}: {_shortened([_place(handle) for handle in self.handles])}"),
        ]
        if self.thin is not None and self.thin["points"]:
            rows.append(("thin places", f"{self.thin['points']} vertices below {self.thin['thickness']:.2f} mm"))
        if self.named_cuts:
            cuts = ", ".join(f"{cut['name']} {cut['length']:.0f} mm" for cut in self.named_cuts)
            rows.append(("cuts", f"{self.cuts_by}: {cuts}"))
        return [(name, value.removesuffix(": ")) for name, value in rows]


def _place(handle: dict[str, Any]) -> str:
    x, y, z = handle["centre"]
    return f"{handle['length']:.1f} mm around ({x:.0f}, {y:.0f}, {z:.0f})"


def _shortened(items: Sequence[Any], most: int = _SHOWN) -> str:
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(str(item) for item in items[:most]) + more


def check(
    surface: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    drop: object | None = None,
    seed_point: Sequence[int] | int | None = None,
    radius: float | None = None,
    polygon: ArrayLike | None = None,
    cuts: object | None = None,
    sphere: object | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Check:
    """Say what an input holds, whether its surface can be flattened, and what each remedy would change.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, keep, drop, seed_point, radius, polygon, cuts, sphere, threads, \
memory_limit, progress
        As in `flatten`.

    Returns
    -------
    Check

    Raises
    ------
    InputError
        If the input cannot be read, or a label, threshold or patch was given that does not fit.
    """
    with reading(memory_limit):
        how = _How(checked_threads(threads), progress)
        place: dict[str, Any] = {"label": label, "threshold": threshold}
        patch: dict[str, Any] = {
            "keep": keep,
            "drop": drop,
            "seed_point": seed_point,
            "radius": radius,
            "polygon": polygon,
            "cuts": cuts,
            "sphere": sphere,
        }
        if isinstance(surface, Surface):
            return _check_surface(surface, Check(surface.metadata["input"], *_of_surface(surface)), patch, how)
        mesh = as_mesh(surface)
        if mesh is not None:
            return _check_mesh(mesh, {**place, "spacing": spacing, "affine": affine}, patch, how)
        volume = as_volume(surface, spacing=spacing, affine=affine)
        check_scalar(volume)
        path = None if volume.path is None else str(volume.path)
        found = Check(path, "volume", _volume_contents(volume))
        if label is None and threshold is None:
            try:
                foreground(volume.data)
            except InputError as error:
                return _and(found, advice=(str(error),))
        making: dict[str, Any] = {**place, "memory_limit": memory_limit, "threads": how.threads, "progress": progress}
        as_it_is = _surface(volume, **making, repair="none")
        return _check_surface(as_it_is, found, patch, how, lambda: _surface(volume, **making))


@dataclass(frozen=True)
class _How:
    """How to work."""

    threads: int | None
    progress: Progress | None


def _and(found: Check, **values: Any) -> Check:
    return Check(**{**found.__dict__, **values})


def _volume_contents(volume: Volume) -> dict[str, Any]:
    return {
        "shape": volume.data.shape,
        "dtype": str(volume.data.dtype),
        "spacing": tuple(float(h) for h in volume.spacing),
        "orientation": volume.orientation,
        "affine": volume.affine.tolist(),
        "labels": labels_in(volume.data),
        "range": (float(volume.data.min()), float(volume.data.max())),
    }


def _mesh_contents(points: Any, triangles: int, structure: str | None, space: Space) -> dict[str, Any]:
    size = tuple(float(side) for side in np.ptp(points, axis=0))
    about = {"structure": structure, "space": space.described()}
    return {"vertices": len(points), "triangles": triangles, "size": size, **about}


def _of_surface(whole: Surface) -> tuple[str, dict[str, Any]]:
    return "mesh", _mesh_contents(whole.points, len(whole.faces), whole.metadata.get("structure"), whole.space)


def _check_mesh(mesh: Mesh, place: dict[str, Any], patch: dict[str, Any], how: _How) -> Check:
    contents = _mesh_contents(mesh.points, len(mesh.faces), mesh.structure, mesh.space)
    defects = _core.defects(mesh.points, mesh.faces)
    found = Check(None if mesh.path is None else str(mesh.path), "mesh", contents, defects)
    try:
        whole = _surface(mesh, **place, threads=how.threads, progress=how.progress)
    except InputError as error:
        return _and(found, advice=(*mesh.remarks, str(error)))
    return _check_surface(whole, found, patch, how)


def _check_surface(
    whole: Surface, found: Check, patch: dict[str, Any], how: _How, repaired: Callable[[], Surface] | None = None
) -> Check:
    topology = whole.core.topology()
    found = _and(
        found,
        foreground=whole.metadata.get("foreground"),
        surface_points=len(whole),
        sheet=whole.metadata.get("sheet"),
        split_vertices=whole.metadata.get("split_vertices"),
        components=tuple(component["vertices"] for component in topology["components"]),
    )
    try:
        cut = cut_out(whole, **patch, threads=how.threads, progress=how.progress, to_disk=False)
    except InputError as error:
        return _and(found, advice=(*whole.remarks, str(error)))
    part = cut.part.core.topology()
    advice = list(cut.remarks)
    handles = tuple(cut.part.core.handles(how.threads, how.progress)) if part["handles"] else ()
    if handles:
        advice.append(_cutting_changes(handles))
    try:
        to_open = cut
        if part["handles"] and repaired is not None:
            to_open = cut_out(repaired(), **patch, threads=how.threads, progress=how.progress, to_disk=False)
        opened: Cutout | None = opened_to_disk(to_open, None, how.threads, how.progress)
    except InputError as error:
        opened = None
        advice.append(str(error))
    if opened is not None:
        advice += [remark for remark in opened.remarks if remark not in advice]
        if len(opened.part) < 3:
            advice.append(f"only {len(opened.part)} vertices: take a larger label or patch")
    errors = {} if opened is None or not opened.is_standard else _sketch_errors(opened, whole, patch, how)
    if len(errors) == 2:
        (by, named), (_, automatic) = errors.items()
        advice.append(
            f"the same cuts for every brain ({by}) cost accuracy: distances of a sketch are {100 * named:.1f} % off, "
            f"with automatic cuts {100 * automatic:.1f} %"
        )
    return _and(
        found,
        used=len(cut.part),
        euler_characteristic=part["euler"],
        closed=not part["loops"],
        boundary=tuple(sorted((loop["length"] for loop in part["loops"]), reverse=True)),
        handles=tuple({"length": handle["length"], "centre": tuple(handle["centre"])} for handle in handles),
        thin=_thin(cut.part, how),
        named_cuts=tuple(
            {"name": one.name, "length": one.length, "ids": ids}
            for one, ids in zip(cut.traced, cut.metadata["cuts"], strict=cut.is_standard)
        ),
        cuts_by=cut.metadata["cuts_by"],
        sketch_errors=errors,
        automatic_cuts=() if opened is None else tuple(opened.metadata["automatic_cuts"]),
        can_flatten=opened is not None and len(opened.part) >= 3,
        advice=tuple(advice),
    )


def _sketch_errors(opened: Cutout, whole: Surface, patch: dict[str, Any], how: _How) -> dict[str, float]:
    """Return the error of the sketch with a template's cuts, and with those that would be found otherwise."""
    found = {opened.metadata["cuts_by"]: opened.metadata["sketch_error"]}
    try:
        otherwise = {**patch, "cuts": AUTOMATIC, "sphere": None}
        other = cut_out(whole, **otherwise, threads=how.threads, progress=how.progress)
        found[AUTOMATIC] = sketch_error(other.part, how.threads, how.progress)
    except InputError:
        pass  # they are advice
    return {by: error for by, error in found.items() if np.isfinite(error)}


def _thin(part: Surface, how: _How) -> dict[str, Any]:
    """Return where the solid is thin."""
    if part.is_voxels:
        thickness = 1.2 * float(np.linalg.norm(np.asarray(part.metadata["affine"])[:3, :3], axis=0).max())
    else:
        thickness = part.usual_edge
    count, worst = part.core.thin_places(thickness, how.threads, how.progress)
    found: dict[str, Any] = {"thickness": thickness, "points": count, "worst": None, "place": None}
    if worst is not None:
        found |= {"worst": worst[1], "place": part.points[worst[0]].tolist()}
    return found


def _cutting_changes(handles: Sequence[dict[str, Any]]) -> str:
    total = sum(handle["length"] for handle in handles)
    return f"repair='cuts' would cut {len(handles)} handle(s) open along {total:.0f} mm and change no voxel"
