"""The method "zigelman2002": fast marching and classical scaling (Zigelman, Kimmel, Kiryati 2002)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import checked_choice
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of, map_over_triangles
from voxflat.methods.method import FlattenSettings, OverTriangles
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold


@dataclass(frozen=True, kw_only=True)
class Zigelman2002(OverTriangles):
    r"""Flatten by classical scaling of fast-marching distances.

    As in [1]_, fast marching on triangles [2]_ measures geodesic distances from each of the `sources`. Let
    :math:`\Delta` be the matrix of distances among the sources, and :math:`J` the centring matrix. Classical scaling
    takes the two eigenvectors :math:`v_k` of the largest eigenvalues :math:`\lambda_k` of

    .. math:: B = -\tfrac{1}{2}\, J\, (\Delta \circ \Delta)\, J

    and places the sources at :math:`\sqrt{\lambda_k}\, v_k`. By default the sources are the vertices that remain after
    decimation. The other vertices are then re-inserted in the reverse order of their removal, each as a weighted mean
    of its neighbours. With ``sampling="grid"``, as in [1]_, vertices between sources are interpolated bilinearly.

    Parameters
    ----------
    sources : int or array_like of int
        Number of points from which distances are measured (all points, if there are fewer), or the points themselves:
        voxel indices (m, 3) or vertex numbers (m,). The default is 25 × 25 = 625, as in Zigelman et al. (2002).
    sampling : {"decimation", "farthest", "curvature", "random", "grid"}
        How sources are chosen. "decimation" keeps the vertices that remain after decimation (and any that cannot be
        removed without damaging the surface); "farthest" spreads sources evenly along the surface; "curvature" places
        them up to four times as densely where the surface bends; "random" draws them at random; "grid" takes pixels on
        a regular grid, and requires a surface from `range_image`.

    See Also
    --------
    Voxflat : The default method, whose maps have no flipped triangles.
    range_image : Make a surface from a depth image.
    Surface.flatten : Flatten a surface with a method.

    References
    ----------
    .. [1] G. Zigelman, R. Kimmel, N. Kiryati: Texture Mapping Using Surface Flattening via Multidimensional Scaling.
       IEEE Transactions on Visualization and Computer Graphics 8 (2), 198-207, 2002.
    .. [2] R. Kimmel, J. A. Sethian: Computing Geodesic Paths on Manifolds. Proceedings of the National Academy of
       Sciences 95 (15), 8431-8435, 1998.

    Examples
    --------
    >>> from voxflat.methods import Zigelman2002
    >>> depth = voxflat.range_image(np.zeros((12, 12)), 1.0)
    >>> flat_map = depth.flatten(Zigelman2002(sources=25))
    >>> flat_map.metadata["placed_by"]
    're-insertion'
    """

    name: ClassVar[str] = "zigelman2002"
    summary: ClassVar[str] = "uses fast marching and classical scaling"

    sources: int | ArrayLike = 625
    sampling: str = "decimation"

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", ("decimation", *SAMPLINGS, "grid"))

    def _map(self, cut: CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Flatten a disk of triangles, or a range image."""
        part = cut.surface
        choice = source_choice(part, self.sources, self.sampling, settings.seed, fewest=3, at_most_all=True)
        grid = vertices = None
        if self.sampling == "grid":
            if choice.given is not None:
                raise InputError("sampling is 'grid', which chooses the sources itself. Pass only a number of sources")
            grid = pixels_of(part)
        need = part.core.zigelman2002_memory_need(choice.count, settings.workers)
        need = settings.check_memory(need + settings.rows_memory_need(choice.count, len(part)))
        if grid is None and (choice.given is not None or self.sampling != "decimation"):
            vertices = choice.made(settings.progress)
        chosen = (choice.count, settings.seed, bands_of(part), vertices, grid, "circle")
        result = part.core.zigelman2002(*chosen, settings.keep_rows, settings.threads, settings.progress)
        placed = {"placed_by": "re-insertion" if grid is None else "bilinear functions between a grid's pixels"}
        rows, sampling = result["rows"], choice.rule
        return map_over_triangles(self.name, cut, settings, result, need, rows, placed, sampling=sampling)


def pixels_of(part: Manifold) -> tuple[NDArray[np.uint32], list[float]]:
    """Return the pixel (row, column) of each vertex of a range image, and the pixel spacing in mm."""
    grid = None if part.is_voxels else part.origin.mesh.grid
    if grid is None:
        raise InputError(
            "sampling is 'grid', but the surface is not a range image. Create one with voxflat.range_image, or pass "
            "sampling='decimation'"
        )
    ids = part.ids
    unique, counts = np.unique(ids, return_counts=True)
    if len(unique) < len(ids):
        row, column = (int(i) for i in np.unravel_index(unique[counts > 1][0], grid.shape))
        raise InputError(
            f"sampling is 'grid', but the surface is cut: pixel ({row}, {column}) lies on both sides of a cut. Pass "
            "sampling='decimation'"
        )
    return np.stack(np.unravel_index(ids, grid.shape), axis=1).astype(np.uint32), list(grid.spacing)
