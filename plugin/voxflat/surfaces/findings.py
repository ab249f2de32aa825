"""Check whether a surface can be flattened, and the effect of each remedy."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, rounded
from voxflat.io.spaces import Space
from voxflat.read_only import ReadOnly
from voxflat.surfaces.cuts import sketch_error
from voxflat.surfaces.cutting import CutManifold, CutSettings, cut_open, opened_to_disk
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.necks import parts_at_a_neck
from voxflat.surfaces.noise import noise_in_parts, noise_in_surface
from voxflat.surfaces.standard.choice import AUTOMATIC

_SHOWN = 5  # maximum number of handles, holes and loops in a table


@dataclass(frozen=True)
class Check(ReadOnly):
    """Findings about an input and its surface.

    `voxflat.check` and `Surface.check` return it.

    Parameters
    ----------
    path : str or None
        The input file.
    kind : {"volume", "mesh"}
        Kind of the input.
    contents : dict
        Content of the input. For a volume: ``shape``, ``dtype``, ``spacing`` (mm), ``orientation`` (such as "RAS"; None
        for microscopy files), ``affine``, ``labels`` (number of voxels by label; None for intensities) and ``range``.
        For a mesh: ``vertices``, ``triangles``, ``size`` (mm), ``structure``, and ``space``: ``name`` ("scanner",
        "tkRAS" or "unknown") and ``to_scanner``, the matrix from the coordinates to scanner RAS.
    defects : dict of str to list
        Defects that make a mesh invalid as a surface: the numbers of the triangles or vertices, keyed by defect.
        `advice` lists the defects that were repaired.
    foreground : int or None
        Number of foreground voxels; None for meshes, or if neither a label nor a threshold has been chosen.
    surface_points : int or None
        Number of vertices of the surface.
    sheet : bool or None
        Whether the foreground is a sheet one voxel thick, which is converted to a single surface.
    split_vertices : int or None
        Number of vertices that were added because a voxel belongs to several layers.
    components : tuple of int
        Number of vertices of each component of the surface, starting with the largest component.
    used : int or None
        Number of vertices of the part that would be flattened.
    euler_characteristic : int or None
        Euler characteristic χ of that part before it is cut open: 1 for a disk, 2 for a closed sphere.
    closed : bool or None
        Whether that part has no boundary.
    boundary : tuple of float
        Lengths of its boundary loops in mm, longest first; all but one are holes.
    handles : tuple of dict
        Its handles: ``length`` (mm) of a short loop around each, and its ``centre`` (RAS+ mm).
    thin : dict or None
        Regions where the solid is thinner than ``thickness`` (mm; 1.2 voxels, or the median edge length of a mesh): the
        number of ``points``, and the ``worst`` thickness and its ``place`` (RAS+ mm).
    automatic_cuts : tuple of dict
        Automatic cuts that would open the surface: ``length`` (mm), ``reason``, ``ids``.
    named_cuts : tuple of dict
        Cuts of a template, made before the automatic ones: ``name``, ``length`` (mm), ``ids``.
    cuts_by : str or None
        Origin of the cuts: "standard", a template file, "given" or "automatic".
    sketch_errors : dict of str to float
        If a template defines the cuts: estimated mean relative distance error with the cuts of `cuts_by` and with
        "automatic" cuts.
    noise : str or None
        Why the surface may be that of noise, such as thousands of components or handles; `advice` repeats it.
    can_flatten : bool
        Whether the surface can be flattened.
    advice : tuple of str
        Warnings and remedies.

    See Also
    --------
    voxflat.check : Check whether an input can be flattened.

    Examples
    --------
    >>> voxflat.samples.hill().check()
    <Check of an array: mesh, 441 vertices, can be flattened>
    """

    path: str | None
    kind: str
    contents: dict[str, object]
    defects: Mapping[str, Sequence[object]] = field(default_factory=dict)
    foreground: int | None = None
    surface_points: int | None = None
    sheet: bool | None = None
    split_vertices: int | None = None
    components: tuple[int, ...] = ()
    used: int | None = None
    euler_characteristic: int | None = None
    closed: bool | None = None
    boundary: tuple[float, ...] = ()
    handles: tuple[dict[str, object], ...] = ()
    thin: dict[str, object] | None = None
    automatic_cuts: tuple[dict[str, object], ...] = ()
    named_cuts: tuple[dict[str, object], ...] = ()
    cuts_by: str | None = None
    sketch_errors: dict[str, float] = field(default_factory=dict)
    noise: str | None = None
    can_flatten: bool = False
    advice: tuple[str, ...] = ()

    def __repr__(self) -> str:
        size = "" if self.surface_points is None else f"{self.surface_points} vertices, "
        verdict = "can" if self.can_flatten else "cannot"
        return f"<Check of {self.path or 'an array'}: {self.kind}, {size}{verdict} be flattened>"

    def rows(self) -> list[tuple[str, str]]:
        """Return the findings as pairs of a name and a value.

        The pairs do not include the advice.

        Returns
        -------
        list of tuple of str
            Pairs of a name and the finding as text.
        """
        rows = [("input", self.path or "array"), *self._contents()]
        rows += [(name, f"{len(places)}: {_shortened(places)}") for name, places in self.defects.items() if places]
        if self.surface_points is not None:
            rows += self._surface()
        reservation = ", but it may be noise" if self.noise else ""
        rows.append(("can be flattened", f"yes{reservation}" if self.can_flatten else "no"))
        return rows

    def table(self) -> str:
        """Return the findings as a table.

        The advice follows the table, one item per line.

        Returns
        -------
        str
            The table as text.
        """
        rows = self.rows()
        width = max(len(name) for name, _ in rows) + 2
        text = [f"{name:{width}}{value}" for name, value in rows]
        return "\n".join(text + [f"- {advice}" for advice in self.advice])

    def _contents(self) -> list[tuple[str, str]]:
        contents: dict[str, Any] = self.contents
        if self.kind == "mesh":
            size = " x ".join(f"{side:.4g}" for side in contents["size"])
            rows = [("mesh", f"{contents['vertices']} vertices, {contents['triangles']} triangles")]
            space = Space._of(contents["space"], self.kind)
            is_stack = self.foreground is not None and space.name == "unknown"
            axes = "x, y and z of the volume, without anatomical directions" if is_stack else str(space)
            rows += [("size", in_unit(f"{size} mm", contents["unit"])), ("coordinates", axes)]
            return rows + ([("structure", contents["structure"])] if contents["structure"] else [])
        labels = contents["labels"]
        return [
            ("shape", " x ".join(str(n) for n in contents["shape"]) + f", {contents['dtype']}"),
            ("spacing", " x ".join(f"{h:g}" for h in contents["spacing"]) + " " + contents["unit"]),
            *([("orientation", contents["orientation"])] if contents["orientation"] else []),
            ("values", f"{contents['range'][0]:g} to {contents['range'][1]:g}"),
            (
                "labels (voxels)",
                "intensities" if labels is None else _shortened([f"{k} ({n})" for k, n in labels.items()], 12),
            ),
        ]

    def _surface(self) -> list[tuple[str, str]]:
        rows = []
        if self.foreground is not None:
            rows.append(("foreground", f"{self.foreground} voxels" + (", one voxel thick" if self.sheet else "")))
        split = f", {self.split_vertices} of them split" if self.split_vertices else ""
        rows += [
            ("surface", f"{self.surface_points} vertices{split}"),
            ("components", f"{len(self.components)}: {_shortened(self.components)}"),
            ("used", f"{self.used} vertices"),
            ("Euler characteristic", f"{self.euler_characteristic} (disk: 1, closed sphere: 2)"),
            ("boundary loops", f"{len(self.boundary)}: {_shortened([f'{rounded(mm)} mm' for mm in self.boundary])}"),
            ("handles", f"{len(self.handles)}: {_shortened([_place(handle) for handle in self.handles])}"),
        ]
        thin: Any = self.thin or {"points": 0}
        if thin["points"]:
            thickness = rounded(thin["thickness"], 2)
            rows.append(("thin regions", f"{thin['points']} vertices below {thickness} mm"))
        if self.named_cuts:
            named: Any = self.named_cuts
            cuts = ", ".join(f"{cut['name']} {rounded(cut['length'])} mm" for cut in named)
            rows.append(("cuts", f"{self.cuts_by}: {cuts}"))
        return [(name, in_unit(value.removesuffix(": "), str(self.contents["unit"]))) for name, value in rows]


def _place(handle: Mapping[str, Any]) -> str:
    x, y, z = handle["centre"]
    return f"{rounded(handle['length'], 1)} mm around ({x:.0f}, {y:.0f}, {z:.0f})"


def _shortened(items: Sequence[Any], most: int = _SHOWN) -> str:
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(str(item) for item in items[:most]) + more


def check_surface(
    part: Manifold,
    check: Check,
    settings: CutSettings,
    repaired: Callable[[], Manifold] | None = None,
) -> Check:
    """Check whether a surface or a part can be flattened; `repaired` returns the same part of the repaired surface."""
    threads, progress = settings.threads, settings.progress
    whole = part._complete
    topology = whole.core.topology(progress)
    split: Any = whole.details.get("split_vertices")
    check = replace(
        check,
        foreground=whole.origin.voxels.foreground if whole.is_voxels else None,
        surface_points=len(whole),
        sheet=whole.origin.voxels.is_sheet if whole.is_voxels else None,
        split_vertices=split,
        components=tuple(topology["components"]["vertices"].tolist()),
    )
    try:
        cut = cut_open(part, settings, to_disk=False)
    except InputError as error:
        return replace(check, advice=(*part.warnings, str(error)))
    shape = cut.surface.core.topology(progress)
    noise = _noise(part, check.components, len(cut.surface), shape, progress)
    advice = [*([noise] if noise else []), *cut.warnings]
    handles = tuple(cut.surface.core.handles(threads, progress)) if shape["handles"] else ()
    if handles:
        total = sum(handle["length"] for handle in handles)
        length = in_unit(f"{rounded(total)} mm", part.origin.named_unit)
        advice.append(f"cutting {len(handles)} handle(s) open along {length} would keep all voxels (repair='cuts')")
    try:
        to_open = cut
        if shape["handles"] and repaired is not None:
            to_open = cut_open(repaired(), settings, to_disk=False)
        opened: CutManifold[Manifold] | None = opened_to_disk(to_open, None, threads, progress, holes=True)
    except InputError as error:
        opened = None
        advice.append(str(error))
    if opened is not None:
        advice += [warning for warning in opened.warnings if warning not in advice]
        if len(opened.surface) < 3:
            advice.append(f"the patch has only {len(opened.surface)} vertices. Choose a larger label or patch")
    is_solid = part.whole is None and part.foreground is not None and not whole.origin.voxels.is_sheet
    if is_solid and part.foreground and not part.foreground.touching and (shares := parts_at_a_neck(part.foreground)):
        first, second = (f"{100 * share:.0f}" for share in shares)
        advice.append(
            f"the foreground narrows between two parts ({first} and {second} % of its voxels). If two objects touch "
            "there, give each its own label"
        )
    errors = {} if opened is None or not opened.is_standard else _sketch_errors(opened, part, settings)
    if len(errors) == 2:
        (template, named), (_, automatic) = errors.items()
        advice.append(
            f"cuts that are the same for every brain ({template}) reduce accuracy: the estimated distance error is "
            f"{100 * named:.1f} %, compared with {100 * automatic:.1f} % for automatic cuts"
        )
    return replace(
        check,
        used=len(cut.surface),
        euler_characteristic=shape["euler"],
        closed=not shape["loops"],
        boundary=tuple(sorted((loop["length"] for loop in shape["loops"]), reverse=True)),
        handles=tuple({"length": handle["length"], "centre": tuple(handle["centre"])} for handle in handles),
        thin=_thin(cut.surface, threads, progress),
        named_cuts=tuple(
            {"name": cut.name, "length": cut.length, "ids": cut.ids.tolist()}
            for cut in cut.cuts
            if cut.reason == "template"
        ),
        cuts_by=cut.cuts_by,
        sketch_errors=errors,
        automatic_cuts=() if opened is None else tuple(cut._described() for cut in opened.cuts if cut.is_automatic),
        noise=noise,
        can_flatten=opened is not None and len(opened.surface) >= 3,
        advice=tuple(advice),
    )


def _noise(
    part: Manifold, components: Sequence[int], used: int, shape: dict[str, Any], progress: Progress | None
) -> str | None:
    """Return why the foreground of a volume or its surface looks like noise; a chosen part is examined by itself."""
    if not part.is_voxels:
        return None
    if part.whole is not None:
        components = ()
    elif part.foreground is not None and (reason := noise_in_parts(part.foreground.mask(), progress)):
        return reason
    return noise_in_surface(components, used, shape["handles"], len(shape["loops"]))


def _sketch_errors(opened: CutManifold[Manifold], part: Manifold, settings: CutSettings) -> dict[str, float]:
    """Return the estimated distance error with a template's cuts, and with automatic cuts."""
    assert opened.sketch_error is not None
    estimates = {opened.cuts_by: opened.sketch_error}
    try:
        other = cut_open(part, replace(settings, cuts=AUTOMATIC, sphere=None))
        estimates[AUTOMATIC] = sketch_error(other.surface, settings.threads, settings.progress)
    except InputError:
        pass  # the advice reports the error
    return {kind: error for kind, error in estimates.items() if np.isfinite(error)}


def _thin(part: Manifold, threads: int | None, progress: Progress | None) -> dict[str, Any]:
    """Return the regions where the solid is thin."""
    thickness = 1.2 * part._largest_spacing if part.is_voxels else part.usual_edge
    count, worst = part.core.thin_places(thickness, threads, progress)
    region: dict[str, Any] = {"thickness": thickness, "points": count, "worst": None, "place": None}
    if worst is not None:
        region |= {"worst": worst[1], "place": part.points[worst[0]].tolist()}
    return region
