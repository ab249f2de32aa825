"""Surfaces that were cut open; `Surface.cut` returns them, and `flatten` accepts them."""

import os
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat import display
from voxflat.arguments import Progress, checked_path, is_whole, shown
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit, rounded
from voxflat.io.notebook import page
from voxflat.io.provenance import Record, recording, saving
from voxflat.maps.flat_map import FlatMap
from voxflat.methods import Method, flattened, method_of
from voxflat.methods.method import FlattenSettings, Rows
from voxflat.surfaces.cuts import Cut, save_cuts
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import SurfaceT_co
from voxflat.surfaces.standard.template import Template
from voxflat.surfaces.standard.tracing import template_of

_SIDES = (("left", "right"), ("posterior", "anterior"), ("inferior", "superior"))
_HEMISPHERES = {"CortexLeft": ("lateral", "medial"), "CortexRight": ("medial", "lateral")}
_ASIDE = 1 / 3  # share of the distance from a surface's centre to its end; points farther out are on that side


def whereabouts(points: NDArray[np.float64], whole: NDArray[np.float64], structure: str | None = None) -> str:
    """Return the sides of a surface on which a cut lies, clearest first ("posterior, inferior"), or "middle".

    The left and right side of a hemisphere, whose GIFTI structure is given, are its lateral and medial side.
    """
    sides = _HEMISPHERES.get(structure or "", _SIDES[0]), *_SIDES[1:]
    low, high = whole.min(axis=0), whole.max(axis=0)
    aside = 2 * (points.mean(axis=0) - (low + high) / 2) / np.maximum(high - low, 1e-9)
    order = np.argsort(-np.abs(aside), kind="stable")[:2]
    return ", ".join(sides[axis][int(aside[axis] > 0)] for axis in order if abs(aside[axis]) > _ASIDE) or "middle"


@dataclass(frozen=True, eq=False, repr=False)
class CutSurface(CutManifold[SurfaceT_co]):
    """A surface that was cut open, as returned by `Surface.cut`.

    Flatten it, edit its cuts, or save them to apply them to other surfaces.

    Parameters
    ----------
    whole : Surface
        The surface before cutting.
    surface : Surface
        The remaining surface, cut open. Vertices on cuts are duplicated, and both copies have the same id.
    faces : ndarray of uint32, shape (F, 3)
        The triangles of `surface`, without those that close small holes.
    cuts : tuple of Cut
        The cuts, in the order in which they were made.
    cuts_by : str
        Who chose the cuts: "given", "automatic", "start", "charts" or the name of a template.
    warnings : tuple of str
        Warnings about the cuts.
    given_length : float or None
        Length of the given cuts or of those of a template, in mm; None if the cuts are automatic.
    sphere : Sphere or None
        The registered sphere of the whole surface, if known.
    is_standard : bool
        Whether the cuts follow a template.
    chart : Chart or None
        The place of a chart that `Surface.charts` returned.
    sketch_error : float or None
        Relative distance error of a coarse preview map, for cuts of a template.
    has_logged : bool
        Whether the logger ``voxflat`` has reported the warnings.
    provenance : dict
        Record of how the surface was cut.

    See Also
    --------
    Surface.cut : Cut a surface open.

    Examples
    --------
    >>> opened = voxflat.surface(voxflat.samples.ball()).cut()
    >>> flat_map = opened.flatten("zigelman2002")
    """

    @classmethod
    def _of(cls, cut: CutManifold[SurfaceT_co]) -> "CutSurface[SurfaceT_co]":
        """Return a cut surface whose warnings have been logged."""
        return cls(**{member.name: getattr(cut, member.name) for member in fields(cut)} | {"has_logged": True})

    @recording(method=method_of)
    def flatten(
        self,
        method: str | Method = "voxflat",
        *,
        mirror: bool = False,
        rows: Rows = False,
        seed: int = 0,
        threads: int | None = None,
        memory_limit: int | None = None,
        progress: Progress | None = None,
    ) -> FlatMap:
        """Flatten the surface along its cuts.

        Parameters
        ----------
        method : str or Method
            As in `Surface.flatten`.
        mirror, rows, seed, threads, memory_limit, progress : optional
            As in `Surface.flatten`.

        Returns
        -------
        FlatMap
            The flat map, with its distortion.

        Raises
        ------
        InputError, AreaBoundError, Cancelled
            As in `Surface.flatten`.

        See Also
        --------
        Surface.flatten : Cut and flatten a surface.
        """
        limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
        return flattened(self, method, FlattenSettings(mirror=mirror, rows=rows, seed=seed, **limits))

    def __repr__(self) -> str:
        counts = f"{len(self.surface)} vertices, {len(self.cuts)} cuts, {len(self.left_out)} excluded vertices"
        return f"<CutSurface: {counts}>"

    def _repr_html_(self) -> str:
        """Return a picture of the surface with its cuts and a table of their lengths, for Jupyter."""
        lengths = ["" if cut.length is None else f"{rounded(cut.length)} mm" for cut in self.cuts]
        names = [self.title(n) for n in range(len(self.cuts))]
        figure = display.views.cut_surface_views(self.surface)
        table = "\n".join(f"{name:40}{length:>8}" for name, length in zip(names, lengths, strict=True))
        caption = "The surface seen from its two broad sides, with the cuts in red"
        return page(self, in_unit(table, self.surface.origin.named_unit), figure, caption)

    def title(self, number: int) -> str:
        """Return the title of a cut: its name or number, and its location.

        Numbers in titles start at 1.

        Parameters
        ----------
        number : int
            Index of the cut in `cuts`, from 0.

        Returns
        -------
        str
            The title, such as "calcarine, posterior" or "cut 2, superior".

        Raises
        ------
        InputError
            If no cut has this number.
        """
        if not is_whole(number) or not 0 <= number < len(self.cuts):
            raise InputError(f"the cut number is {shown(number)}, but there are {len(self.cuts)} cuts, numbered from 0")
        cut, whole = self.cuts[number], self.whole
        name = cut.name or f"cut {number + 1}"
        if not len(cut.ids):
            return name
        points = whole.space.to_scanner(whole.points)
        return f"{name}, {whereabouts(points[whole.find(cut.ids)], points, whole.origin.structure)}"

    def _with_provenance(self, record: Record) -> "CutSurface[SurfaceT_co]":
        """Return a copy with a record of how it was made."""
        return replace(self, surface=self.surface._with_provenance(record), provenance=record)

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the cuts and the excluded vertices, or the cut surface, to a file.

        Pass the cuts file as the ``cuts`` argument of `flatten` or `Surface.cut` to apply the cuts again.

        Parameters
        ----------
        path : path
            If the name ends in ``.json``, the cuts are saved: ``{"format": 1, "cuts": [[vertex, ...], ...],
            "names": [name, ...], "drop": [vertex, ...], "provenance": {...}}``, without ``names`` if no cut has one.
            Otherwise the cut surface is saved as with `Surface.save`, for example as the FreeSurfer patch
            ``lh.cortex.patch.3d``.
        sidecar, overwrite : bool
            As in `Surface.save`.

        Raises
        ------
        InputError
            If the path is an input file, or the file extension is not supported.
        OSError
            If the file cannot be written.

        See Also
        --------
        CutSurface.save_template : Save the cuts for use on other surfaces.

        Examples
        --------
        >>> cut_open = voxflat.surface(voxflat.samples.ball()).cut()
        >>> cut_open.save("ball_cuts.json")
        """
        if not os.fspath(checked_path(path)).lower().endswith(".json"):
            self.surface.save(path, sidecar=sidecar, overwrite=overwrite)
            return
        save_cuts(path, self.cuts, self.left_out, self.provenance, sidecar=sidecar, overwrite=overwrite)

    def save_template(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the cuts, and the border of the excluded region, as a template.

        The lines are stored on the sphere. The template therefore applies to every surface with a registered sphere for
        the same hemisphere and space. Pass the file as the ``cuts`` argument of `flatten` or `Surface.cut`.

        Parameters
        ----------
        path : path
            A JSON file with the keys ``space``, ``side``, ``outlines``, ``cuts`` (names, lines on the unit sphere, and
            the ``root`` of each cut) and ``provenance``.
        sidecar, overwrite : bool
            As in `Surface.save`.

        Raises
        ------
        InputError
            If no sphere was passed to `Surface.cut`, or a cut starts neither at a border nor at another cut.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> from nilearn.datasets import fetch_surf_fsaverage
        >>> left = fetch_surf_fsaverage()  # fsaverage5, which is bundled with nilearn
        >>> cut_open = voxflat.surface(left.white_left).cut("standard", sphere=left.sphere_left)
        >>> cut_open.save_template("five_cuts.json")
        """
        template = self._template(checked_path(path).stem)
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite), atomic_path(path) as beside:
            beside.write_text(template.as_json(), encoding="utf-8", newline="\n")

    def _template(self, called: str) -> Template:
        """Return the cuts, and the border of the excluded region, as a template."""
        if self.sphere is None:
            raise InputError("a template requires a sphere, but this surface has none. Cut it with sphere (--sphere)")
        if not self.cuts and not len(self.left_out):
            raise InputError("cannot make a template: the surface has no cuts and no excluded vertices. Cut it first")
        is_kept = self.whole._has_triangles(self.surface.vertices[self.surface.faces])
        assert is_kept is not None
        names: dict[str, int] = {}
        cuts = []
        for cut in self.cuts:
            name = cut.name or cut.reason
            names[name] = names.get(name, 0) + 1
            cuts.append((name if cut.name else f"{name} {names[name]}", self._vertices(cut)))
        return replace(template_of(self.whole, is_kept, cuts, self.sphere), name=called, provenance=self.provenance)

    def _vertices(self, cut: Cut) -> NDArray[np.int64]:
        """Return the vertices of the whole surface along a cut."""
        return self.whole.vertices[self.whole.find(cut.ids)] if self.whole.is_voxels else cut.ids
