"""Register a surface to fsaverage's sphere by the pattern of its folds."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_threads, named_side
from voxflat.errors import InputError
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.provenance import Record
from voxflat.io.saved import Saved
from voxflat.read_only import ReadOnly
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.standard.pattern import SIDES, icosphere, pattern

_RADIUS = 100.0  # the radius of FreeSurfer's spheres
_MIDWAY, _WIDTH = 2.3, 0.08  # logistic function of the evidence: docs/decisions/0023
_STRUCTURES = {"CortexLeft": "left", "CortexRight": "right"}


@dataclass(frozen=True, eq=False)
class Registration(ReadOnly, Saved):
    """A surface that is registered to the unit sphere, in fsaverage space.

    `Surface.register` returns it.

    Parameters
    ----------
    surface : Manifold
        The registered surface.
    points : ndarray of float64, shape (N, 3)
        Position of each vertex on the unit sphere. No triangle is flipped: the surface covers the sphere once.
    side : {"left", "right"}
        The hemisphere.
    confidence : float
        Confidence, from 0 to 1, that the surface is that hemisphere, aligned with the template.
    figures : dict
        Values on which the confidence is based. ``score``: agreement with the template after the best rotation, by
        side. ``rigid``: fit of the smoothed surface to the template by a rigid motion, 1 for the same shape, by side.
        ``correlations``: correlation of fold depth with the template at scales of 24, 12 and 6 mm (for an adult's
        brain) after the warp; ``rotated``: the same before the warp. ``affine``: share of the template's positions that
        an affine map explains.
    warnings : tuple of str
        Warnings for the user.
    provenance : dict
        Record of how the registration was made.

    See Also
    --------
    voxflat.Surface.register : Register a surface.

    Examples
    --------
    >>> from nilearn.datasets import fetch_surf_fsaverage
    >>> white = fetch_surf_fsaverage().white_left  # of fsaverage5, which comes with nilearn
    >>> registration = voxflat.surface(white).register()
    >>> registration
    <Registration: 10242 vertices, left, confidence 1.00>
    """

    _kind = "a registration"
    _formats = """
    File name that ends in .surf.gii, .vtp, .ply or .obj, or a FreeSurfer name such as lh.sphere.reg. The file holds
    the sphere with a radius of 100, like FreeSurfer's ``?h.sphere.reg``, and the vertices and triangles of the mesh.
    For a surface from a volume, the vertices are those of `Surface.save`.
    """

    surface: Manifold
    points: NDArray[np.float64]
    side: str
    confidence: float
    figures: dict[str, object]
    warnings: tuple[str, ...] = ()
    provenance: Record = field(default_factory=dict)

    _used = ("side",)

    def __repr__(self) -> str:
        return f"<Registration: {len(self.points)} vertices, {self.side}, confidence {self.confidence:.2f}>"

    @property
    def sphere(self) -> NDArray[np.float64]:
        """Position of each vertex of the complete mesh on the unit sphere, shape (V, 3).

        Vertices without a triangle are NaN.
        """
        places = np.full((self.surface.count, 3), np.nan)
        places[self.surface.vertices] = self.points
        merged = self.surface.merged
        places[merged[:, 0]] = places[merged[:, 1]]
        return places

    def _write(self, path: Path) -> None:
        whole = self.surface
        faces = whole.faces.astype(np.int64) if whole.is_voxels or whole.mesh_faces is None else whole.mesh_faces
        places = np.nan_to_num(self.sphere) * _RADIUS  # vertices without a triangle lie at the centre
        structure = "CortexLeft" if self.side == "left" else "CortexRight"
        write_mesh(path, Mesh(places, faces, structure=structure), self.provenance)


def register(whole: Manifold, side: str | None, threads: int | None, progress: Progress | None) -> Registration:
    """Register a hemisphere to the fsaverage sphere; see `voxflat.Surface.register`."""
    if side is not None:
        side = named_side(side, "side")
    whole, warnings = _one_piece(whole)
    templates = [pattern(each) for each in SIDES]
    number = None if side is None else SIDES.index(side)
    result = whole.core.register(*icosphere(), templates, number, checked_threads(threads), progress)
    return _validated(whole, result, side, warnings)


def _one_piece(whole: Manifold) -> tuple[Manifold, tuple[str, ...]]:
    """Return the largest component, and a warning on the others."""
    topology = whole.core.topology()
    if topology["handles"]:
        remedy = "Repair the mesh in the program that created it"
        if whole.is_voxels:
            remedy = "Extract one hemisphere with voxflat.hemisphere, or repair the surface with "
            remedy += "repair='voxels'"
        raise InputError(f"the surface has {topology['handles']} handle(s), but a sphere has none. {remedy}")
    others = len(topology["components"]) - 1
    if not others:
        return whole, whole.warnings
    core = whole.core.largest_piece()
    warning = f"{others} smaller component(s) with {len(whole.core) - len(core)} vertices were excluded"
    return whole._with_core(core), (*whole.warnings, warning)


def _validated(whole: Manifold, result: dict[str, Any], named: str | None, warnings: tuple[str, ...]) -> Registration:
    """Return the registration; raise an error if the surface is not a hemisphere."""
    side = SIDES[result["template"]]
    other = SIDES[1 - result["template"]]
    aligned = dict(zip(SIDES, result["alignments"], strict=True))
    scores = {each: aligned[each]["score"] for each in SIDES}
    figures = {
        "score": scores,
        "rigid": {each: aligned[each]["rigid"] for each in SIDES},
        "rotated": aligned[side]["correlations"],
        "correlations": result["correlations"],
        "affine": result["affine"],
    }
    better, worse = sorted(scores.values(), reverse=True)
    evidence = better + (better - worse)
    confidence = float(1 / (1 + np.exp(-(evidence - _MIDWAY) / _WIDTH)))
    if evidence < _MIDWAY:
        raise InputError(
            f"judging by its folds, the surface is not a cortical hemisphere (confidence {confidence:.2f}): its "
            f"agreement is {better:.2f} with the better-matching side of the template, and {worse:.2f} with the other "
            "side. Pass the surface of one hemisphere without the cerebellum and brain stem. Do not use a template for "
            "other shapes"
        )
    if named is not None and scores[other] > scores[side]:
        raise InputError(
            f"side is {named!r}, but the surface agrees better with the {other} side of the template (score "
            f"{scores[other]:.2f} instead of {scores[side]:.2f}). Pass side={other!r}, or check whether the surface is "
            "mirrored"
        )
    declared = _STRUCTURES.get(str(whole.origin.structure))
    if declared not in (None, side):
        warnings = (*warnings, f"the file specifies the {declared} side, but the folds match the {side} side")
    return Registration(whole, result["points"], side, confidence, figures, warnings)
