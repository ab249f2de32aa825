"""Check the contents of an input, and whether its surface can be flattened."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import ArrayLike

from voxflat import _core
from voxflat.arguments import Progress, checked_threads, shown
from voxflat.errors import InputError
from voxflat.io.chunks import is_stack_path
from voxflat.io.meshes import Mesh
from voxflat.io.reading import reading
from voxflat.io.sources import as_mesh, as_volume, check_ending
from voxflat.io.volumes import Volume
from voxflat.maps.map_cuts import along_map
from voxflat.pipeline.surface import Surface, middle_of_rim
from voxflat.pipeline.surface import surface as _surface
from voxflat.surfaces.cutting import CutSettings
from voxflat.surfaces.findings import Check, check_surface
from voxflat.surfaces.foreground import check_scalar, foreground, labels_in
from voxflat.surfaces.manifold import size_and_space


def check(
    source: object,
    *,
    label: int | Sequence[int] | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    part: Callable[[Surface], Surface] | None = None,
    cuts: object | None = None,
    sphere: object | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Check:
    """Check the contents of an input, whether its surface can be flattened, and the effect of each remedy.

    An input that cannot be converted to a surface does not cause an error; `Check.advice` gives the reason.

    Parameters
    ----------
    source : ndarray, path, image object, Volume, (points, faces), Mesh, pyvista.PolyData, Surface or Rim
        As in `voxflat.surface`.
    label, threshold, spacing, affine : optional
        As in `voxflat.surface`.
    part : callable, optional
        A function that takes the surface and returns the part to be flattened, such as
        ``lambda surface: surface.disk(5000, 40)``.
    cuts, sphere, threads, memory_limit, progress : optional
        As in `Surface.cut`.

    Returns
    -------
    Check
        The findings.

    Raises
    ------
    InputError
        If the input cannot be read, or the label, threshold or part does not match the input.

    See Also
    --------
    Surface.check : Check a surface in the same way.

    Examples
    --------
    >>> voxflat.check(voxflat.samples.ball()).can_flatten
    True
    """
    if part is not None and (not callable(part) or isinstance(part, type)):
        raise InputError(f"part is {shown(part)}. Pass a function that takes a Surface and returns a part of it")
    source = middle_of_rim(source)
    with reading(memory_limit):
        if isinstance(source, Surface):
            chosen = source if part is None else part(source)
            return chosen.check(cuts, sphere=sphere, threads=threads, progress=progress)
        making: dict[str, Any] = {"threads": checked_threads(threads), "progress": progress}
        voxels: dict[str, Any] = {"label": label, "threshold": threshold}
        mesh = as_mesh(source)
        settings = CutSettings(cuts=cuts, sphere=sphere, **making)
        if mesh is not None:
            found = _of_mesh(mesh)
            try:
                whole = _surface(mesh, **voxels, spacing=spacing, affine=affine, **making)
            except InputError as error:
                return replace(found, advice=(*mesh.warnings, str(error)))
            return _of_part(whole, part, found, settings, making)
        check_ending(source)
        volume = as_volume(source, spacing=spacing, affine=affine)
        check_scalar(volume.data)
        found = Check(None if volume.path is None else str(volume.path), "volume", _volume_contents(volume, progress))
        if label is None and threshold is None:
            try:
                foreground(volume.data, progress=progress)
            except InputError as error:
                return replace(found, advice=(str(error),))
        making |= {**voxels, "memory_limit": memory_limit}
        return _of_part(_surface(volume, **making, repair="none"), part, found, settings, making, volume)


def _of_part(
    whole: Surface,
    part: Callable[[Surface], Surface] | None,
    found: Check,
    settings: CutSettings,
    making: dict[str, Any],
    volume: Volume | None = None,
) -> Check:
    """Check a part of a surface."""

    def chosen(piece: Surface) -> Surface:
        return piece if part is None else part(piece)

    try:
        wanted = chosen(whole)
    except InputError as error:
        found = check_surface(whole, found, settings)
        return replace(found, can_flatten=False, advice=(*whole.warnings, str(error)))
    repaired = None if volume is None else lambda: along_map(chosen(_surface(volume, **making)), settings)[0]
    wanted, along = along_map(wanted, settings)
    return check_surface(wanted, found, along, repaired)


def _of_mesh(mesh: Mesh) -> Check:
    contents = size_and_space(mesh.points, len(mesh.faces), mesh.structure, mesh.space, mesh.unit)
    defects = _core.defects(mesh.points, mesh.faces)
    return Check(None if mesh.path is None else str(mesh.path), "mesh", contents, defects)


def _volume_contents(volume: Volume, progress: Progress | None) -> dict[str, Any]:
    return {
        "shape": volume.data.shape,
        "dtype": str(volume.data.dtype),
        "spacing": tuple(float(h) for h in volume.spacing),
        "unit": volume.unit,
        "orientation": None if is_stack_path(volume.path) else volume.orientation,
        "affine": volume.affine.tolist(),
        "labels": labels_in(volume.data, progress=progress),
        "range": (float(volume.data.min()), float(volume.data.max())),
    }
