"""The method "grossmann2002": chain codes and classical scaling of surface voxels (Grossmann, Kiryati, Kimmel 2002)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from voxflat.arguments import checked_choice
from voxflat.distances.geodesic import stored_rows
from voxflat.distances.sources import SAMPLINGS, source_choice
from voxflat.distances.store import prepare_store
from voxflat.distortion.bands import Bands
from voxflat.distortion.distortion import Distortion
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of, making_details
from voxflat.methods.method import FlattenSettings, Method
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.voxel_graph import LINK_LENGTHS, VoxelGraph, voxel_graph

_TORN_WARNING = 0.05  # share of a map


@dataclass(frozen=True, kw_only=True)
class Grossmann2002(Method):
    r"""Flatten the surface voxels of a volume by classical scaling of chain-code distances.

    The method follows [1]_. It needs no triangles: surface voxels are linked to their 26 neighbours, and a shortest
    path is a chain code with :math:`N_1` direct, :math:`N_2` minor diagonal and :math:`N_3` major diagonal links. The
    length of a path is estimated as

    .. math:: \ell = 0.9016\, N_1 + 1.289\, N_2 + 1.615\, N_3

    voxels, which is unbiased on average over all directions. For anisotropic voxels, the weights are derived from the
    same principle. Let :math:`\Delta` be the matrix of distances among the `sources`, and :math:`J` the centring
    matrix. Classical scaling takes the two eigenvectors :math:`v_k` of the largest positive eigenvalues
    :math:`\lambda_k` of

    .. math:: B = -\tfrac{1}{2}\, J\, (\Delta \circ \Delta)\, J

    and places the sources at :math:`\sqrt{\lambda_k}\, v_k`. The other voxels are interpolated by the smoothest
    functions through the sources,

    .. math:: f(x) = \sum_i b_i\, |x - x_i| + a_0 + a \cdot x .

    Parameters
    ----------
    sources : int or array_like of int, shape (m, 3)
        Number of points from which distances are measured (all points, if there are fewer), or the voxel indices of the
        points. The default is 1000, as in Grossmann et al. (2002).
    sampling : {"farthest", "random"}
        How sources are chosen: "farthest" spreads them evenly, each as far as possible from the others along the
        surface; "random" draws them at random.
    link_lengths : {"chain-code", "euclidean"}
        Lengths of the links between neighbouring voxels: "chain-code" uses the unbiased estimator of Grossmann et al.
        (2002); "euclidean" uses 1, √2 and √3 voxels.

    See Also
    --------
    Voxflat : The default method, which works on triangles.
    Surface.flatten : Flatten a surface with a method.

    Notes
    -----
    The surface is never cut, so a closed surface raises an error; choose a part with `Surface.disk` or `Surface.keep`.
    Banks of a sulcus that touch are linked, so distances can jump between them. The foreground is used unchanged unless
    ``repair="voxels"`` is passed to `voxflat.surface`.

    References
    ----------
    .. [1] R. Grossmann, N. Kiryati, R. Kimmel: Computational Surface Flattening: A Voxel-Based Approach. IEEE
       Transactions on Pattern Analysis and Machine Intelligence 24 (4), 433-441, 2002.

    Examples
    --------
    >>> from voxflat.methods import Grossmann2002
    >>> slab = np.zeros((12, 12, 5), dtype=np.uint8)
    >>> slab[1:-1, 1:-1, 2] = 1
    >>> flat_map = voxflat.flatten(slab, method=Grossmann2002(sources=50))
    >>> flat_map.metadata["link_lengths"]
    'chain-code'
    """

    name: ClassVar[str] = "grossmann2002"
    summary: ClassVar[str] = "uses chain codes on the surface voxels of a volume"
    _takes_store: ClassVar[bool] = True

    sources: int | ArrayLike = 1000
    sampling: str = "farthest"
    link_lengths: str = LINK_LENGTHS[0]

    def __post_init__(self) -> None:
        """Check the options."""
        checked_choice(self.sampling, "sampling", [name for name in SAMPLINGS if name != "curvature"])
        checked_choice(self.link_lengths, "link_lengths", LINK_LENGTHS)

    def _flatten(self, surface: Manifold | CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Flatten the surface voxels from which a surface was made."""
        if isinstance(surface, CutManifold) or settings.defines_cuts:
            raise InputError(
                "the method 'grossmann2002' does not cut surfaces. Flatten a part of the surface (Surface.disk, "
                "Surface.keep), and omit cuts, sphere, relax and adapt"
            )
        if settings.mirror:
            raise InputError("the method 'grossmann2002' does not support mirror. Omit it")
        return self._map(voxel_graph(surface, self.link_lengths, settings.progress), bands_of(surface), settings)

    def _map(self, graph: VoxelGraph, bands: Bands, settings: FlattenSettings) -> FlatMap:
        part = graph.core
        part.check_flattenable(settings.progress)  # report this error before others
        choice = source_choice(graph, self.sources, self.sampling, settings.seed, fewest=3, at_most_all=True)
        need = part.memory_need(choice.count, settings.workers) + settings.rows_memory_need(choice.count, len(part))
        need = settings.check_memory(need)
        chosen = choice.made(settings.progress)
        store = None
        if settings.store is not None:
            kind = {"geodesic": "chain", "link_lengths": graph.link_lengths}
            store = prepare_store(settings.store, part, graph.ids, chosen, **kind, progress=settings.progress)
        result = part.grossmann2002(
            chosen, settings.seed, bands, settings.keep_rows and store is None, settings.threads, settings.progress
        )
        topology = part.topology(settings.progress)
        faces, torn = part.map_faces(result["uv"], settings.progress)
        warnings = _warnings(graph, topology, float(torn.mean()))
        details = {
            **graph.details,
            **making_details(chosen, result, need, warnings, choice.rule),
            "topology": topology,
            "torn_faces": float(torn.mean()),
        }
        rows = result["rows"]
        if store is not None:
            rows = stored_rows(store, part, chosen, settings.threads, settings.progress).rows
        return FlatMap(
            uv=result["uv"],
            points=part.points,
            normals=result["normals"],
            ids=graph.ids,
            faces=faces,
            torn=torn,
            sources=chosen.astype(np.int64),
            eigenvalues=result["eigenvalues"],
            distortion=Distortion._of(result["distortion"], None, "chain", voxel_size=graph.voxel_size, bands=bands),
            origin=graph.origin,
            method=self.name,
            seed=settings.seed,
            warnings=tuple(warnings),
            store=None if store is None else store.path,
            details=details,
            rows=rows,
        )


def _warnings(graph: VoxelGraph, topology: dict[str, Any], torn: float) -> list[str]:
    """Return the warnings about a map over the 26-neighbour graph."""
    sizes = graph.whole.component_sizes()
    warnings = list(graph.warnings)
    if len(sizes) > 1 and not graph.is_chosen:
        warnings.append(f"only the largest of {len(sizes)} components is used ({len(graph)} of {sum(sizes)} voxels)")
    if topology["euler_characteristic"] != 1:
        warnings.append(
            f"the patch is not a disk: its Euler characteristic is {topology['euler_characteristic']} instead of 1. It "
            "has holes, handles, or touching banks, across which distances jump. The method 'voxflat' separates banks"
        )
    if torn > _TORN_WARNING:
        warnings.append(
            f"{100 * torn:.1f} % of the map is torn: points that are neighbours in the map are not neighbours on the "
            "surface. Check the heat map, or flatten a smaller patch"
        )
    return warnings
