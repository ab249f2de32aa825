"""The method "zigelman2002": fast marching, classical scaling, re-insertion (Zigelman, Kimmel, Kiryati 2002)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import checked_choice
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import map_over_triangles
from voxflat.methods.method import How, OverTriangles
from voxflat.surfaces.cutting import Cutout
from voxflat.surfaces.manifold import Manifold


@dataclass(frozen=True, kw_only=True)
class Zigelman2002(OverTriangles):
    """Flatten by fast marching and classical scaling.

    Fronts march from each source across the triangles (Kimmel, Sethian 1998). Classical scaling of the distances among
    the sources, the vertices that decimation leaves, gives their places: of B = -½ J (Δ∘Δ) J the two eigenvectors of
    the largest eigenvalues, times their square roots. The other vertices are re-inserted in the reverse order of their
    removal, each by weights of its neighbours.

    Parameters
    ----------
    sources : int or array_like of int
        How many points distances are measured from; all, if there are fewer. Or which: voxel indices (m, 3), or vertex
        numbers (m,). The paper has 25 × 25 = 625.
    sampling : {"decimation", "farthest", "curvature", "random", "grid"}
        How sources are chosen: what decimation leaves (vertices that cannot go without harm to the surface are sources,
        too); evenly, each farthest from the others along the surface; up to four times as close where the surface
        bends; at random; or the pixels on a grid over a `range_image`, between which the rest is placed by bilinear
        functions.

    References
    ----------
    G. Zigelman, R. Kimmel, N. Kiryati: Texture Mapping Using Surface Flattening via Multidimensional Scaling. IEEE
    Transactions on Visualization and Computer Graphics 8 (2), 198-207, 2002.

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> from voxflat.methods import Zigelman2002
    >>> depth = voxflat.range_image(np.zeros((12, 12)), 1.0)
    >>> flat_map = depth.flatten(Zigelman2002(sources=25))
    >>> flat_map.metadata["placed_by"]
    're-insertion'
    """

    name: ClassVar[str] = "zigelman2002"
    summary: ClassVar[str] = "by fast marching"

    sources: int | ArrayLike = 625
    sampling: str = "decimation"

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", ("decimation", *SAMPLINGS, "grid"))

    def _map(self, cut: Cutout, how: How) -> FlatMap:
        """Flatten a disk of triangles, or a range image."""
        part = cut.part
        choice = source_choice(part, self.sources, self.sampling, how.seed, fewest=3, at_most_all=True)
        grid = vertices = None
        if self.sampling == "grid":
            if choice.given is not None:
                raise InputError(
                    "sampling is 'grid', which chooses the sources itself; give their number, or leave it out"
                )
            grid = pixels_of(part)
        need = part.core.zigelman2002_memory_need(choice.count, how.workers)
        need = how.check_memory(need + how.rows_memory_need(choice.count, len(part)))
        if grid is None and (choice.given is not None or self.sampling != "decimation"):
            vertices = choice.made(how.progress)
        chosen = (choice.count, how.seed, vertices, grid, "circle")
        result = part.core.zigelman2002(*chosen, how.keep_rows, how.threads, how.progress)
        placed = {"placed_by": "re-insertion" if grid is None else "bilinear functions between a grid's pixels"}
        rows, sampling = result["rows"], choice.rule
        return map_over_triangles(self.name, cut, how, result, need, rows, placed, sampling=sampling)


def pixels_of(part: Manifold) -> tuple[NDArray[np.uint32], list[float]]:
    """Find the pixels, row and column, that the vertices of a range image are, and the distances of these, mm."""
    grid = part.metadata.get("range_image")
    if grid is None:
        raise InputError(
            "sampling is 'grid', but the surface is no range image; make one by voxflat.range_image, or give "
            "sampling='decimation'"
        )
    ids = part.ids
    unique, counts = np.unique(ids, return_counts=True)
    if len(unique) < len(ids):
        row, column = (int(i) for i in np.unravel_index(unique[counts > 1][0], grid["shape"]))
        raise InputError(
            f"sampling is 'grid', but the surface is cut: pixel ({row}, {column}) lies on both sides, and a grid knows "
            "one; give sampling='decimation'"
        )
    return np.stack(np.unravel_index(ids, grid["shape"]), axis=1).astype(np.uint32), list(grid["spacing"])
