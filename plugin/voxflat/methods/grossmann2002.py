"""The method "grossmann2002": chain codes, classical scaling, radial functions (Grossmann, Kiryati, Kimmel 2002)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import checked_choice
from voxflat.distances.geodesic import stored_rows
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.distances.store import prepare_store
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import told
from voxflat.methods.method import How, Method
from voxflat.surfaces.cutting import Cutout, Where
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.voxel_graph import LINK_LENGTHS, VoxelGraph, voxel_graph

_TORN_WARNING = 0.05  # share of a map


@dataclass(frozen=True, kw_only=True)
class Grossmann2002(Method):
    """Flatten the surface voxels of a volume, linked to their 26 neighbours.

    A path over the surface is a chain code with N₁ direct, N₂ minor diagonal and N₃ major diagonal links. Its length is
    estimated as 0.9016 N₁ + 1.289 N₂ + 1.615 N₃ voxels, which is right on average over all directions; for anisotropic
    voxels the weights are derived by the same principle. Classical scaling places the sources: of
    B = -½ J (Δ∘Δ) J, with Δ the distances among them, the two eigenvectors of the largest positive eigenvalues, times
    their square roots, are coordinates. The other voxels are placed by the smoothest functions through the sources,
    f(x) = Σ bᵢ |x - xᵢ| + a₀ + a·x. The foreground is taken as it was given, or repaired where
    ``repair="voxels"`` was asked for. The surface is not cut, so a closed one is refused: choose a part by
    `Surface.disk` or `Surface.keep`.

    Parameters
    ----------
    sources : int or array_like of int, shape (m, 3)
        How many points distances are measured from; all, if there are fewer. Or which: voxel indices. The paper has
        1,000.
    sampling : {"farthest", "random"}
        How sources are chosen: evenly, each farthest from the others along the surface, or at random.
    link_lengths : {"chain-code", "euclidean"}
        Lengths of the links between neighbouring voxels: the paper's unbiased estimator, or 1, √2, √3 for comparison.

    References
    ----------
    R. Grossmann, N. Kiryati, R. Kimmel: Computational Surface Flattening: A Voxel-Based Approach. IEEE Transactions on
    Pattern Analysis and Machine Intelligence 24 (4), 433-441, 2002.

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> from voxflat.methods import Grossmann2002
    >>> slab = np.zeros((12, 12, 5), dtype=np.uint8)
    >>> slab[1:-1, 1:-1, 2] = 1
    >>> flat_map = voxflat.flatten(slab, method=Grossmann2002(sources=50))
    >>> flat_map.metadata["link_lengths"]
    'chain-code'
    """

    name: ClassVar[str] = "grossmann2002"
    summary: ClassVar[str] = "over a volume's surface voxels"
    takes_store: ClassVar[bool] = True

    sources: int | ArrayLike = 1000
    sampling: str = "farthest"
    link_lengths: str = LINK_LENGTHS

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", [one for one in SAMPLINGS if one != "curvature"])
        checked_choice(self.link_lengths, "link_lengths", ("chain-code", "euclidean"))

    def _flatten(self, surface: Manifold | Cutout, where: Where, how: How) -> FlatMap:
        """Flatten the surface voxels that a surface was made of."""
        if isinstance(surface, Cutout) or where.is_given:
            raise InputError(
                "the method 'grossmann2002' cuts no surface: give a part of one (Surface.disk, Surface.keep), and "
                "leave out cuts, sphere, relax and adapt"
            )
        if how.mirror:
            raise InputError("the method 'grossmann2002' knows no mirror; leave it out")
        return self._map(voxel_graph(surface, self.link_lengths, how.progress), how)

    def _map(self, graph: VoxelGraph, how: How) -> FlatMap:
        part = graph.core
        part.check_flattenable(how.progress)  # the first reason to refuse is the one that matters
        choice = source_choice(graph, self.sources, self.sampling, how.seed, fewest=3, at_most_all=True)
        need = part.memory_need(choice.count, how.workers) + how.rows_memory_need(choice.count, len(part))
        need = how.check_memory(need)
        chosen = choice.made(how.progress)
        store = None
        if how.store is not None:
            lengths = graph.metadata["link_lengths"]
            store = prepare_store(
                how.store, part, graph.ids, chosen, geodesic="chain", link_lengths=lengths, progress=how.progress
            )
        result = part.grossmann2002(chosen, how.seed, how.keep_rows and store is None, how.threads, how.progress)
        topology = part.topology(how.progress)
        faces, torn = part.map_faces(result["uv"], how.progress)
        metadata = {
            "method": "grossmann2002",
            **graph.metadata,
            **told(how, chosen, result, need, _warnings(graph, topology, float(torn.mean())), choice.rule),
            "topology": topology,
            "torn_faces": float(torn.mean()),
        }
        rows = result["rows"]
        if store is not None:
            metadata["store"], rows = str(store.path), stored_rows(store, part, chosen, how.threads, how.progress).rows
        return FlatMap(
            uv=result["uv"],
            points=part.points,
            normals=result["normals"],
            ids=graph.ids,
            faces=faces,
            torn=torn,
            sources=chosen.astype(np.int64),
            eigenvalues=result["eigenvalues"],
            distortion=Distortion._of(result["distortion"], None, "chain", voxel_size=graph.voxel_size),
            metadata=metadata,
            rows=rows,
        )


def _warnings(graph: VoxelGraph, topology: dict[str, Any], torn: float) -> list[str]:
    """Return what the user should know of a map over the 26-neighbour graph."""
    sizes = graph.whole.component_sizes()
    warnings = list(graph.remarks)
    if len(sizes) > 1 and not (graph.metadata["keep"] or graph.metadata["seed_point"] is not None):
        warnings.append(f"{len(sizes)} components: the largest, {len(graph)} of {sum(sizes)} surface voxels, is used")
    if topology["euler_characteristic"] != 1:
        warnings.append(
            f"Euler characteristic {topology['euler_characteristic']} instead of a disk's 1: the patch has holes, "
            "handles, or banks that touch, across which distances jump. The method 'voxflat' keeps such banks apart"
        )
    if torn > _TORN_WARNING:
        warnings.append(
            f"{100 * torn:.1f} % of the map is torn: neighbours there are none on the surface; "
            "see the heat map, and take a smaller patch"
        )
    return warnings
