"""The shorthand `flatten`: from any input to a flat map, with defaults."""

from typing import Any

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods import Method
from voxflat.methods.method import Rows
from voxflat.pipeline import surface as making
from voxflat.pipeline.cut_surface import CutSurface


def flatten(
    surface: object,
    method: str | Method = "voxflat",
    *,
    cuts: object | None = None,
    sphere: object | None = None,
    relax: float | bool | None = None,
    adapt: float | None = None,
    mirror: bool = False,
    rows: Rows = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Flatten a surface into the plane while preserving geodesic distances.

    Shorthand for ``voxflat.surface(surface).flatten(...)``. To choose the foreground of a volume or a part of the
    surface, call `voxflat.surface` first.

    Parameters
    ----------
    surface : path, ndarray, image object, Volume, (points, faces), Mesh, pyvista.PolyData, Surface, Rim or CutSurface
        Any input of `voxflat.surface`, or a surface that is already cut.
    method : str or Method
        As in `Surface.flatten`.
    cuts, sphere, relax, adapt : optional
        Where the surface is cut, as in `Surface.cut`.
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
    Surface.flatten : Flatten a surface (with a description of all parameters).

    Examples
    --------
    >>> flat_map = voxflat.flatten(voxflat.samples.hill())
    >>> flat_map.uv.shape
    (441, 2)
    """
    where: dict[str, Any] = {"cuts": cuts, "sphere": sphere, "relax": relax, "adapt": adapt}
    limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    if isinstance(surface, CutSurface):
        if any(value is not None for value in where.values()):
            raise InputError("the surface is already cut. Omit cuts, sphere, relax and adapt")
        return surface.flatten(method, mirror=mirror, rows=rows, seed=seed, **limits)
    return making.surface(surface, **limits).flatten(method, **where, mirror=mirror, rows=rows, seed=seed, **limits)
