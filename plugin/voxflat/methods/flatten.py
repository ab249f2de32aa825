"""A surface goes in, a flat map comes out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from voxflat.arguments import Progress, checked_seed, checked_switch, checked_threads
from voxflat.io.provenance import telling
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.matching import match
from voxflat.methods import grossmann2002, options, saucan2006, schwartz1989, voxflat, zigelman2002
from voxflat.methods.common import How
from voxflat.methods.start import cut_as
from voxflat.surfaces.making import surface as _surface
from voxflat.surfaces.region import cut_out
from voxflat.surfaces.voxel_graph import voxel_graph

__all__ = ["flatten"]

_OVER_TRIANGLES: dict[str, Any] = {
    "voxflat": voxflat,
    "zigelman2002": zigelman2002,
    "schwartz1989": schwartz1989,
    "saucan2006": saucan2006,
}
"""Modules with two verbs: `checked` takes a method's own options before the long work, `flatten` what is to be flat."""

_OWN = ("geodesic", "weighting", "scale", "max_area", "neighbourhood", "starts", "bound")


@telling
@options.telling_defaults
def flatten(
    surface: object,
    *,
    method: str = "voxflat",
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
    sphere: object | None = None,
    mirror: bool = False,
    relax: float | bool | None = None,
    adapt: float | None = None,
    sources: int | ArrayLike | None = None,
    sampling: str | None = None,
    geodesic: str | None = None,
    weighting: float | None = None,
    scale: str | None = None,
    max_area: float | None = None,
    start: object | None = None,
    link_lengths: str | None = None,
    neighbourhood: int | str | None = None,
    starts: int | None = None,
    bound: float | None = None,
    seed: int = 0,
    keep_rows: bool = False,
    store: str | os.PathLike[str] | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> FlatMap:
    """Flatten a surface into the plane, keeping geodesic distances.

    Parameters
    ----------
    surface : ndarray, path, image object, Volume, (points, faces), Mesh, pyvista.PolyData or Surface
        A label volume or an intensity volume (I, J, K) of any bool, integer or floating-point type and any strides, or
        a mesh of triangles in RAS+ mm; `voxflat.surface` makes a `Surface` of either, with more choices.
    method : {"voxflat", "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006"}
        "voxflat" works on triangles: straight links over the surface, then the map of least stress whose triangles keep
        their shape; none is turned over. "grossmann2002" works on the 26-neighbour graph of a volume's surface voxels:
        chain-code geodesics, classical scaling, radial functions (Grossmann, Kiryati, Kimmel 2002). "zigelman2002"
        works on triangles: fast marching, classical scaling of what decimation leaves, and the rest re-inserted in
        reverse order (Zigelman, Kimmel, Kiryati 2002). "schwartz1989" works on triangles: exact distances within
        neighbourhoods and from some sources, and from random starts Newton steps to the least of Sammon's stress; every
        point takes part (Schwartz, Shaw, Wolfson 1989). "saucan2006" measures no distances: patches within 10° of their
        planes (Appleboim, Saucan, Zeevi 2006) are glued, and cut further where no triangle could keep `bound`.
    label : int, optional
        Foreground is this label.
    threshold : float, optional
        Foreground is what is greater. Without label and threshold the volume must have a single label.
    spacing : sequence of 3 floats, optional
        Voxel size, mm, for volumes without an affine.
    affine : array_like, shape (4, 4), optional
        From voxel indices to RAS+ mm, for volumes without an affine.
    keep : mask, path or vertex numbers, optional
        What to flatten. For volumes a mask of the volume's shape (array, path, image object or Volume); for meshes a
        mask of shape (V,), vertex numbers, or a file: FreeSurfer label or patch, GIFTI label or shape, or a GIFTI
        surface whose triangles are the patch.
    drop : as `keep`, optional
        What not to flatten, such as the medial wall; ``"medial wall"`` finds it where white and pial surface touch.
    seed_point : sequence of 3 ints, or int, optional
        Voxel indices, or for meshes the number of a vertex; the surface within `radius` of it is flattened.
    radius : float, optional
        Radius of the geodesic disk around `seed_point`, mm along the surface.
    polygon : array_like of voxel indices (k, 3) or vertex numbers (k,), optional
        Corners; what is flattened is the smaller side of the closed path along edges that is shortest from each to the
        next.
    cuts : "standard", "automatic", list of paths, or path of a file, optional
        "standard": along the medial wall, the calcarine sulcus, three medial lines and a temporal one, which are the
        same for every brain, traced by the surface's registered `sphere`. A template that `CutSurface.save_template`
        wrote is applied so, too. "automatic": what is no disk is cut open, and further as `relax` says, as suits this
        surface best. Or paths of neighbouring vertices (voxel indices (k, 3), or vertex numbers (k,)) along which the
        surface is cut before, which `voxflat.path` finds, or a file of cuts, as `voxflat.cut` saves it; what is still
        no disk is cut open automatically, and that is said; ``[]`` forbids it. By default "standard" for a closed
        surface whose sphere is given, or lies beside its file as FreeSurfer's does (``lh.sphere.reg`` beside
        ``lh.white``), if neither `keep` nor a patch is given; else "automatic".
    sphere : path, Mesh, (points, faces) or array_like of shape (V, 3), optional
        The registered sphere of a mesh: one place for each vertex of the whole mesh, around the origin, of any radius.
        In fsaverage space, or in that of fs_LR where the file's name says so. By default FreeSurfer's, where it lies
        beside the surface's file and standard cuts are made. Maps cut by a template are turned onto the flat map of
        fsaverage5 by corresponding points (``metadata["frame"]`` is "standard").
    mirror : bool
        Exchange left and right of the map, so that maps of right hemispheres look like those of left ones.
    relax : bool or float, optional
        Cut the disk further, from its boundary inwards, where that relieves the map most: as long as it pays (True), or
        up to a length in mm, of which yours (`cuts`) are part; or not at all (False). By default as long as it pays,
        where nobody has said where to cut: no `cuts` are given, and no patch of triangles as `keep`. What was not
        closed like a sphere is then cut only where distances would be more than 4 % off, and if that takes a tenth off
        their error; and a disk that was handed over as it is, a scan or a patch that someone has cut, only where they
        would be more than 15 % off.
    adapt : float, optional
        Let the cuts of a template grow where that relieves the map, longer and with branches, as long as it pays, no
        farther from where they are than this, mm. By default they stay the same for every brain.
    sources : int or array_like, optional
        How many points distances are measured from, or which: voxel indices (m, 3), or vertex numbers (m,). By default
        $sources, "grossmann2002": $sources_grossmann2002, "zigelman2002": $sources_zigelman2002, "schwartz1989":
        $sources_schwartz1989, or all points if there are fewer. To
        "schwartz1989" they are a sampling of long distances beside the neighbourhoods (Wolfson, Schwartz 1989); with 0
        most starts end in a fold.
    sampling : {"farthest", "curvature", "random", "decimation", "grid"}, optional
        How sources are chosen: evenly, each farthest from the others along the surface (the default); up to four times
        as close where the surface bends ("curvature"; not for "grossmann2002"); or at random.
        "zigelman2002" only: what decimation leaves (its default; vertices that cannot go without harm to the surface
        are sources, too); or the pixels on a grid over a `range_image`, between which the rest is placed by bilinear
        functions.
    geodesic : {"graph", "marching", "exact"}, optional
        "voxflat" only. What measures the distances that the map keeps, as in `voxflat.geodesic`. By default "graph",
        but where that is more than 1 % off exact distances from a sample of sources, which thin triangles can cause,
        "marching", and "exact" where that is, too.
    weighting : float, optional
        "voxflat" only. From 0, local, where near distances and the shape of triangles count ten times as much as usual,
        to 1, global, where they count a tenth and far distances rule; by default $weighting.
    scale : {"distances", "areas"}, optional
        "voxflat" only. What the map's mm are right for. A surface that is not flat has no map in which both are: one
        whose area is that of the surface has distances that are too long. By default "$scale": their mean relative
        error is the least of any scale. With "areas" the map has the surface's area.
        ``distortion.triangles.equal_area_scale`` is the factor from a map to the one with the surface's area,
        ``distortion.best_scale.scale`` to the one with the best distances.
    max_area : float, optional
        "voxflat" only. A factor greater than 1 by which no triangle may change its area, at the scale that keeps the
        area of the whole (`voxflat.worst_places` tells what a map does). From the usual map descent goes on with a
        price on what is beyond, which grows until nothing is. ``metadata["area_change"]`` is the factor that is
        reached. If no such map is found, that is an `AreaBoundError`, with the best map and the cuts that would help.
    start : map, optional
        "voxflat" only. A flat map of the surface, of whatever tool, as `voxflat.measure` takes it: descent goes on from
        there, instead of from nothing, and ends in the map of least energy near it, which lies as the start does. On
        small surfaces that takes as long as from nothing. It may lie anywhere, at any scale, mirrored or not; the map
        is turned as it lies, and not mirrored (``mirror=True`` for that). Where nothing says what to flatten and where
        to cut (`keep`, `drop`, `seed_point`, `polygon`, `cuts`, `sphere`, `relax`, `adapt`), it is what the start
        covers, cut as the start is. Otherwise the start needs a place for every triangle, and may lack cuts, whose lips
        are drawn apart. A few folds are mended; what cannot be mended is refused.
    link_lengths : {"chain-code", "euclidean"}, optional
        "grossmann2002" only. Lengths of the links between neighbouring voxels: the paper's unbiased estimator (0.9016,
        1.289, 1.615 voxels, or its generalisation to anisotropic voxels; the default), or 1, √2, √3 for comparison.
    neighbourhood : int or "all", optional
        "schwartz1989" only. Distances from each point are kept to those that so many edges lead to, or to all. By
        default as far as a tenth of the points, which the paper found to be enough, and a hundred if there are so many.
    starts : int, optional
        "schwartz1989" only. Random starts, of which the map of least stress is kept; by default $starts, as in the
        paper. ``metadata["starts"]`` is the stress of each.
    bound : float, optional
        "saucan2006" only. The greatest factor by which lengths may change: max(σ1, 1/σ2) ≤ C for every triangle. By
        default $bound. Where patches cannot be glued to one piece that is an error; `voxflat.patches` keeps pieces.
    seed : int
        Seed of every random choice. The same seed gives the same map, bit by bit, for any number of threads.
    keep_rows : bool
        Keep the distances from all sources to all points in `FlatMap.rows`.
    store : path, optional
        A directory to keep them in, on disk instead of in memory; `FlatMap.rows` is then read there where it is looked
        at. If the work is interrupted, the same call goes on where it was. `voxflat.open_rows` opens it.
    threads : int, optional
        By default one a core.
    memory_limit : int, optional
        Bytes that may be used; by default what is free. The need is computed before the start.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` about every 20 ms; if it returns False the work is cancelled.

    Returns
    -------
    FlatMap
        What the user should know of it is logged (logger ``voxflat``) and stands in ``metadata["warnings"]``.

    Raises
    ------
    InputError
        For anything wrong with the input; the message names the value and the remedy.
    AreaBoundError
        If no map was found that keeps `max_area`.
    Cancelled
        If `progress` returned False.
    """
    taken = options.resolved(
        method,
        drop=drop,
        polygon=polygon,
        cuts=cuts,
        sphere=sphere,
        mirror=mirror,
        relax=relax,
        adapt=adapt,
        sources=sources,
        sampling=sampling,
        geodesic=geodesic,
        weighting=weighting,
        scale=scale,
        max_area=max_area,
        start=start,
        link_lengths=link_lengths,
        neighbourhood=neighbourhood,
        starts=starts,
        bound=bound,
        keep_rows=keep_rows,
        store=store,
    )
    how = How(
        sources=sources,  # the methods know how many are usual
        sampling=taken.get("sampling", ""),
        mirror=checked_switch(mirror, "mirror"),
        seed=checked_seed(seed),
        keep_rows=checked_switch(keep_rows, "keep_rows"),
        store=store,
        threads=checked_threads(threads),
        memory_limit=memory_limit,
        progress=progress,
    )
    place: dict[str, Any] = {"label": label, "threshold": threshold, "spacing": spacing, "affine": affine}
    patch: dict[str, Any] = {"keep": keep, "seed_point": seed_point, "radius": radius}
    common: dict[str, Any] = {"memory_limit": memory_limit, "progress": progress}
    if method == "grossmann2002":
        graph = voxel_graph(surface, **place, **patch, link_lengths=taken["link_lengths"], **common)
        return grossmann2002.flatten(graph, how)
    way = _OVER_TRIANGLES[method]
    own = way.checked(**{name: taken[name] for name in _OWN if name in taken})
    whole = _surface(surface, **place, threads=how.threads, **common)
    patch |= {name: taken[name] for name in ("drop", "polygon", "cuts", "sphere", "relax", "adapt")}
    if taken.get("start") is not None:
        own["start"] = match(whole, taken["start"])
    if "start" in own and all(value is None for value in patch.values()):
        cut = cut_as(whole, own["start"], how.threads, progress)
    else:
        cut = cut_out(whole, **patch, threads=how.threads, progress=progress)
    flat: FlatMap = way.flatten(cut, how, **own)
    return flat
