"""The method "grossmann2002": chain codes, classical scaling, radial functions (Grossmann, Kiryati, Kimmel 2002)."""

from __future__ import annotations

from typing import Any

import numpy as np

from voxflat.distances.geodesic import stored_rows
from voxflat.distances.sources import source_choice
from voxflat.distances.store import prepare_store
from voxflat.distortion.distortion import Distortion
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import How, told
from voxflat.methods.options import default
from voxflat.surfaces.voxel_graph import VoxelGraph

__all__ = ["flatten"]

_TORN_WARNING = 0.05  # share of a map


def flatten(graph: VoxelGraph, how: How) -> FlatMap:
    """Flatten the surface voxels of a volume."""
    part, usual = graph.core, default("sources", "grossmann2002")
    part.check_flattenable(how.progress)  # the first reason to refuse is the one that matters
    choice = source_choice(graph, how.sources, how.sampling, how.seed, fewest=3, usual=usual)
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
        **told(how, chosen, result, need, _warnings(graph, topology, float(torn.mean()))),
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
        distortion=Distortion.of(result["distortion"], None, "chain", voxel_size=graph.voxel_size),
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
