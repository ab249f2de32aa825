"""Cutting alone: the surface cut open as `flatten` would cut it, and where."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, checked_threads, log
from voxflat.io.files import atomic_path
from voxflat.io.provenance import Record, saving, telling
from voxflat.surfaces.making import surface as _surface
from voxflat.surfaces.region import cut_out
from voxflat.surfaces.surface import Surface

__all__ = ["Cut", "CutSurface", "cut"]


@dataclass(frozen=True, eq=False)
class Cut:
    """One cut.

    Parameters
    ----------
    ids : ndarray of int64, shape (k,) or (k, 3)
        The vertices along it, or their voxels.
    length : float or None
        mm; None of a given one.
    reason : {"given", "handle", "boundaries joined", "closed sphere", "relaxation"}
        Why it was made.
    """

    ids: NDArray[np.int64]
    length: float | None
    reason: str

    def __repr__(self) -> str:
        length = "" if self.length is None else f"{self.length:.1f} mm, "
        return f"<Cut along {len(self.ids)} vertices, {length}{self.reason}>"


@dataclass(frozen=True, eq=False)
class CutSurface:
    """A surface that was cut open.

    Parameters
    ----------
    surface : Surface
        What is left, cut open: vertices on cuts are there twice and share an id.
    cuts : tuple of Cut
        In the order in which they were made.
    left_out : ndarray of int64, shape (m,) or (m, 3)
        Vertices of the whole surface that it has not, or their voxels.
    remarks : tuple of str
        What the user should know of it.
    provenance : dict
        What made it.
    """

    surface: Surface
    cuts: tuple[Cut, ...]
    left_out: NDArray[np.int64]
    remarks: tuple[str, ...] = ()
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"<CutSurface: {len(self.surface)} vertices, {len(self.cuts)} cuts, {len(self.left_out)} vertices left out>"
        )

    def with_provenance(self, record: Record) -> CutSurface:
        """Return the same with a record of what made it.

        Parameters
        ----------
        record : dict
            As `provenance`.

        Returns
        -------
        CutSurface
        """
        return replace(self, surface=self.surface.with_provenance(record), provenance=record)

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Write the cuts, and what was left out, to a file that `cuts` of `flatten` takes.

        Parameters
        ----------
        path : path
            A JSON file: ``{"cuts": [[vertex, ...], ...], "drop": [vertex, ...], "provenance": {...}}``.
        sidecar, overwrite
            As in `Surface.save`.

        Raises
        ------
        InputError
            If it is a file that was read.
        OSError
            If it cannot be written.
        """
        content: dict[str, Any] = {"cuts": [cut.ids.tolist() for cut in self.cuts], "drop": self.left_out.tolist()}
        content["provenance"] = self.provenance
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite), atomic_path(path) as beside:
            beside.write_text(json.dumps(content) + "\n", encoding="utf-8")


@telling
def cut(
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
    relax: float | bool | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> CutSurface:
    """Cut a surface open to a disk, and further where that relieves its map, as `flatten` does.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, keep, drop, seed_point, radius, polygon, cuts, relax, threads, \
memory_limit, progress
        As in `flatten`.

    Returns
    -------
    CutSurface

    Raises
    ------
    InputError, Cancelled
        As in `flatten`.
    """
    place: dict[str, Any] = {"label": label, "threshold": threshold, "spacing": spacing, "affine": affine}
    threads = checked_threads(threads)
    whole = _surface(surface, **place, memory_limit=memory_limit, threads=threads, progress=progress)
    done = cut_out(
        whole,
        keep=keep,
        drop=drop,
        seed_point=seed_point,
        radius=radius,
        polygon=polygon,
        cuts=cuts,
        relax=relax,
        threads=threads,
        progress=progress,
    )
    for remark in done.remarks:
        log.warning(remark)
    given = [Cut(np.asarray(path), None, "given") for path in done.metadata["cuts"]]
    automatic = done.metadata["automatic_cuts"]
    made = [Cut(np.asarray(entry["ids"]), entry["length"], entry["reason"]) for entry in automatic]
    left_out = whole.ids[~np.isin(whole.vertices, done.part.vertices)]
    return CutSurface(done.part, (*given, *made), left_out, done.remarks)
