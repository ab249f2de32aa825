"""The one way to a surface, from whatever the user hands over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import Progress, checked_threads, give_back_memory, shown
from voxflat.errors import InputError
from voxflat.io.provenance import telling
from voxflat.surfaces.foreground import foreground_of
from voxflat.surfaces.of_mesh import as_mesh, of_mesh
from voxflat.surfaces.of_volume import of_volume
from voxflat.surfaces.surface import Surface

__all__ = ["surface"]

_REPAIRS = ("none", "voxels", "cuts")


@telling
def surface(
    source: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    probability: object | None = None,
    sheet: bool | None = None,
    pial: object | None = None,
    repair: str | None = None,
    memory_limit: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Surface:
    """Make a surface of a label volume or of a mesh.

    The surface of a volume has a vertex for each surface voxel and side: surfels, the faces between foreground and
    background voxels, are glued along their edges, so that thin blades keep two sides and touching banks stay apart,
    and drawn together voxel by voxel. No iso-surface is made: every vertex is a voxel, placed finer than the grid.

    Parameters
    ----------
    source : ndarray, path, image object, Volume, (points, faces), Mesh, pyvista.PolyData or Surface
        A label or intensity volume (I, J, K), or a mesh of triangles in RAS+ mm, in the space that its file says
        (`Surface.space`): scanner RAS, FreeSurfer's tkRAS, or unknown.
    label, threshold, spacing, affine
        What of a volume is foreground, and where it lies: as in `flatten`.
    probability : ndarray, path, image object or Volume, optional
        An image of the volume's shape whose value is `threshold`, or 0.5, on the surface: points are placed there. By
        default they are placed by the volume itself where `threshold` is given and its values change smoothly, and else
        by a fit to the voxels.
    sheet : bool, optional
        Whether the foreground is a sheet one voxel thick, of which one surface is made instead of two sides. By default
        this is recognised.
    pial : path, Mesh, (points, faces) or pyvista.PolyData, optional
        Where `source` is a white surface, the pial surface with the same vertices: distances are measured midway. One
        that does not lie outside it, vertex by vertex, is refused.
    repair : {"none", "voxels", "cuts"}, optional
        Rid the surface of handles: that of a volume by the fewest voxels taken away or added that leave one sphere
        ("voxels"), or by cutting them open ("cuts", also of meshes). By default handles of a volume's largest component
        are closed or opened where that changes no more than 1 % of its voxels, and this is said. A mesh is mended
        unless this is "none", where that has one right answer: triangles without area are dropped or flipped away, for
        which vertices at one place become one (each keeps its number), duplicates are dropped, and where sheets touch
        at a vertex each gets its own.
    memory_limit : int, optional
        Bytes that may be used; by default what is free.
    threads : int, optional
        By default one a core.
    progress : callable, optional
        As in `flatten`.

    Returns
    -------
    Surface

    Raises
    ------
    InputError
        If the input is no surface; the message names the place and the remedy.
    Cancelled
        If `progress` returned False.
    """
    _check_repair(repair)
    threads = checked_threads(threads)
    give_back_memory()
    if isinstance(source, Surface):
        made = source
        _refuse_options("a Surface", label=label, threshold=threshold, spacing=spacing, affine=affine, pial=pial)
        _refuse_options("a Surface", probability=probability, sheet=sheet, repair=repair)
    elif (mesh := as_mesh(source)) is not None:
        _refuse_options("a mesh", label=label, threshold=threshold, spacing=spacing, affine=affine)
        _refuse_options("a mesh", probability=probability, sheet=sheet)
        if repair == "voxels":
            raise InputError("repair is 'voxels', but a mesh has no voxels; give 'cuts' or 'none', or leave it out")
        made = of_mesh(mesh, pial, mend=repair != "none")
    else:
        _refuse_options("a volume", pial=pial)
        given = foreground_of(
            source, label=label, threshold=threshold, spacing=spacing, affine=affine, memory_limit=memory_limit
        )
        made = of_volume(given, probability=probability, sheet=sheet, repair=repair, threads=threads, progress=progress)
    return _cut_handles(made, threads, progress) if repair == "cuts" else made


def _check_repair(repair: object) -> None:
    if repair is None or (isinstance(repair, str) and repair in _REPAIRS):
        return
    instead = {True: "; 'voxels' is what True was", False: "; 'none' is what False was"}
    was = instead[bool(repair)] if isinstance(repair, bool | np.bool_) else ""
    raise InputError(f"repair is {shown(repair)}; give 'none', 'voxels' or 'cuts', or leave it out{was}")


def _refuse_options(what: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} is given, but the input is {what}, for which it means nothing; leave it out")


def _cut_handles(whole: Surface, threads: int | None, progress: Progress | None) -> Surface:
    core, handles = whole.core.cut_handles(threads, progress)
    if not handles:
        return whole
    lengths = [handle["length"] for handle in handles]
    remark = f"{len(handles)} handle(s) were cut open along loops of {min(lengths):.1f} to {max(lengths):.1f} mm"
    metadata = {**whole.metadata, "handles_cut": handles}
    return replace(whole, core=core, metadata=metadata, remarks=(*whole.remarks, remark))
