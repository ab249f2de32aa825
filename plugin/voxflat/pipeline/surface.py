"""From whatever the user hands over to a `Surface`, whose methods are the verbs of voxflat."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from numpy.typing import ArrayLike

from voxflat.arguments import Progress, checked_seed, checked_threads, give_back_memory, log, shown
from voxflat.atlases.certified import FlatAtlas
from voxflat.atlases.making import patches
from voxflat.distances.geodesic import geodesic as _geodesic
from voxflat.distances.path import Path
from voxflat.distances.path import path as _path
from voxflat.distances.rows import DistanceRows
from voxflat.errors import InputError
from voxflat.io.grid import named_unit
from voxflat.io.meshes import Mesh
from voxflat.io.provenance import telling
from voxflat.io.reading import reading
from voxflat.io.sources import taken
from voxflat.maps.flat_map import FlatMap
from voxflat.methods import Method, flattened, method_of
from voxflat.methods.method import How, Rows
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.surfaces.cutting import Where, cut_handles, cut_open
from voxflat.surfaces.findings import Check, check_surface
from voxflat.surfaces.foreground import foreground_of
from voxflat.surfaces.manifold import Manifold, size_and_space
from voxflat.surfaces.of_mesh import of_mesh
from voxflat.surfaces.of_volume import of_volume
from voxflat.surfaces.parts import disk, dropped, kept, polygon
from voxflat.surfaces.standard.registration import Registration, register

_REPAIRS = ("none", "voxels", "cuts")


@dataclass(frozen=True, eq=False, repr=False)
class Surface(Manifold):
    """A surface of triangles, made by `voxflat.surface`; a part of one is a `Surface` again.

    `points`, `faces` and `ids` are its vertices, triangles, and what each vertex is in the input: voxel indices, or
    vertex numbers. Nothing changes a surface: each method returns a new value.

    Examples
    --------
    >>> import voxflat
    >>> import numpy as np
    >>> ball = np.linalg.norm(np.indices((20, 20, 20)) - 9.5, axis=0) < 8
    >>> surface = voxflat.surface(ball)
    >>> cap = surface.disk((9, 9, 16), radius=6.0)
    >>> flat_map = cap.flatten()
    >>> flat_map.uv.shape == (len(cap), 2)
    True
    """

    @classmethod
    def _of(cls, made: Manifold) -> Surface:
        """Return what the core made as a surface."""
        return cls(**{one.name: getattr(made, one.name) for one in fields(Manifold)})

    # ------------------------------------------------------------------------------------------ parts

    @telling()
    def keep(self, region: object) -> Surface:
        """Return the part of the surface that lies in a region.

        Parameters
        ----------
        region : mask, path or vertex numbers
            For surfaces of volumes a mask of the volume's shape (array, path, image object or Volume), or voxel indices
            (k, 3). For meshes a mask of shape (V,), vertex numbers, or a file: FreeSurfer label or patch, GIFTI label
            or shape, or a GIFTI surface whose triangles are the part.

        Returns
        -------
        Surface
            The triangles all of whose corners lie in the region.

        Raises
        ------
        InputError
            If the region does not fit the surface, or holds no triangle of it.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> len(sheet.keep(np.arange(18)))
        18
        """
        return kept(self, region)

    @telling()
    def drop(self, region: object) -> Surface:
        """Return the part of the surface that lies outside a region, such as the medial wall.

        Parameters
        ----------
        region : mask, path or vertex numbers, or "medial wall"
            As for `keep`; ``"medial wall"`` finds it where white and pial surface touch.

        Returns
        -------
        Surface
            The triangles none of whose corners lies in the region.

        Raises
        ------
        InputError
            If the region does not fit the surface, or nothing is left.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> len(sheet.drop([14, 15]))
        34
        """
        return dropped(self, region)

    @telling()
    def disk(
        self,
        seed_point: Sequence[int] | int,
        radius: float,
        *,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> Surface:
        """Return the geodesic disk around a point.

        Parameters
        ----------
        seed_point : sequence of 3 ints, or int
            Voxel indices, or for meshes the number of a vertex, counted from 0. Of a voxel that is not on the surface
            the nearest one is taken; a warning tells how far away it is, if it is far.
        radius : float
            Radius of the disk, mm along the surface.
        threads : int, optional
            How many threads work; by default one for each core.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        Surface

        Raises
        ------
        InputError
            If the point is not on the surface, or the disk would be most of it.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> sheet = voxflat.range_image(np.zeros((9, 9)), 1.0)
        >>> len(sheet.disk(40, 2.5)) < len(sheet)
        True
        """
        return disk(self, seed_point, radius, checked_threads(threads), progress)

    @telling()
    def polygon(self, corners: ArrayLike, *, progress: Progress | None = None) -> Surface:
        """Return the region that a closed path of shortest ways between corners encloses.

        Parameters
        ----------
        corners : array_like of voxel indices (k, 3) or vertex numbers (k,)
            Corners in their order. The path runs along edges, the shortest way from each to the next, and the smaller
            side of it is the region.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        Surface

        Raises
        ------
        InputError
            If a corner is not on the surface, or the path crosses itself.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> sheet = voxflat.range_image(np.zeros((9, 9)), 1.0)
        >>> len(sheet.polygon([20, 24, 60, 56]))
        25
        """
        return polygon(self, corners, progress)

    # ------------------------------------------------------------------------------------------ cuts and maps

    @telling()
    def cut(
        self,
        cuts: object | None = None,
        *,
        sphere: object | None = None,
        relax: float | bool | None = None,
        adapt: float | None = None,
        threads: int | None = None,
        memory_limit: int | None = None,
        progress: Progress | None = None,
    ) -> CutSurface[Surface]:
        """Cut the surface open to a disk, and further where that relieves its map.

        Parameters
        ----------
        cuts : "standard", "automatic", list of paths, or path of a file, optional
            Where the surface is cut: "standard" for lines that are the same for every brain, "automatic" for cuts that
            suit this surface best, paths of vertices, or a file of cuts or a template. "standard": along the medial
            wall, the calcarine sulcus, three medial lines and a temporal one, which are the same for every brain,
            traced by the surface's registered `sphere`. A template that `CutSurface.save_template` wrote is applied in
            the same way. "automatic": a surface that is not a disk is cut open, and further as `relax` says, as suits
            this surface best. Or paths of neighbouring vertices (voxel indices (k, 3), or vertex numbers (k,)), which
            `Surface.path` finds, or a file of cuts, as `CutSurface.save` writes it; what is still not a disk is then
            cut open automatically, and a warning says so; ``[]`` forbids it. By default "standard" for a closed surface
            whose sphere is given, or lies beside its file as FreeSurfer's does (``lh.sphere.reg`` beside ``lh.white``),
            if no part but by `drop` was chosen; else "automatic".
        sphere : path, Mesh, (points, faces) or array_like of shape (V, 3), optional
            The registered sphere of a mesh, by which standard cuts are traced. It has one place for each vertex of the
            whole mesh, around the origin, at any radius. In fsaverage space, or in that of fs_LR where the file's name
            says so. By default FreeSurfer's, where it lies beside the surface's file and standard cuts are made. Maps
            cut by a template are turned onto the flat map of fsaverage5 by corresponding points (``metadata["frame"]``
            is "standard").
        relax : bool or float, optional
            Cut the disk further, from its boundary inwards, where that relieves the map most: as long as it pays
            (True), or up to a length in mm, of which yours (`cuts`) are part; or not at all (False). By default as long
            as it pays, where nobody has said where to cut: no `cuts` are given, and no part by triangles was kept. A
            surface that was not closed like a sphere is then cut only where distances would be more than 4 % off, and
            if that takes a tenth off their error; and a disk that was handed over as it is, a scan or a patch that
            someone has cut, only where they would be more than 15 % off.
        adapt : float, optional
            Let the cuts of a template grow and branch where that relieves the map, within this distance, mm. By
            default they stay the same for every brain.
        threads : int, optional
            How many threads work; by default one for each core.
        memory_limit : int, optional
            Bytes that files which are read may take; by default what is free.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        CutSurface

        Raises
        ------
        InputError, Cancelled
            As in `flatten`.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> ball = np.linalg.norm(np.indices((12, 12, 12)) - 5.5, axis=0) < 5
        >>> opened = voxflat.surface(ball).cut()
        >>> [cut.reason for cut in opened.cuts][0]
        'closed sphere'
        """
        made = cut_open(self, Where(cuts, sphere, relax, adapt), checked_threads(threads), progress)
        for remark in made.remarks:
            log.warning(remark)
        made = replace(made, is_told=True)
        return CutSurface._of(made, Surface._of(made.part))

    @telling(method=method_of)
    def flatten(
        self,
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
        """Flatten the surface into the plane while preserving geodesic distances.

        Parameters
        ----------
        method : str or Method
            "voxflat", the default; or after the papers "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006";
            or an object of `voxflat.methods` with a method's own options, such as ``Zigelman2002(sources=400)``.
        cuts, sphere, relax, adapt
            Where the surface is cut, as in `Surface.cut`.
        mirror : bool
            Exchange left and right of the map, so that maps of right hemispheres look like those of left ones.
        rows : bool or path
            Keep the distances from all sources to all points in `FlatMap.rows`: in memory (True), or in a directory on
            disk, from which `FlatMap.rows` reads what is looked at. If the work is interrupted, the same call goes on
            where it was. `voxflat.open_rows` opens the directory.
        seed : int
            Seed of every random choice. The same seed gives the same map, bit by bit, for any number of threads.
        threads : int, optional
            How many threads work; by default one for each core.
        memory_limit : int, optional
            Bytes that may be used; by default what is free. The need is computed before the work begins.
        progress : callable, optional
            Called as ``progress(stage, done, total)`` about every 20 ms; if it returns False the work is cancelled.

        Returns
        -------
        FlatMap
            Warnings are logged (logger ``voxflat``), and stand in ``metadata["warnings"]``.

        Raises
        ------
        InputError
            For anything wrong with the input; the message names the value and the remedy.
        AreaBoundError
            If no map was found that keeps ``Voxflat(max_area=...)``.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> rows, columns = np.indices((20, 30))
        >>> wave = voxflat.range_image(3 * np.sin(columns / 4), 1.0)
        >>> flat_map = wave.flatten()
        >>> flat_map.distortion.raw.relative_error < 0.01
        True
        """
        how = How(mirror, rows, seed, threads, memory_limit, progress)
        return flattened(self, method, Where(cuts, sphere, relax, adapt), how)

    @telling()
    def patches(
        self,
        max_angle: float | None = None,
        *,
        bound: float | None = None,
        count: int | None = None,
        seeds: str = "curvature",
        seed: int = 0,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> FlatAtlas:
        """Flatten the surface, of any topology, in patches with a certificate (Appleboim, Saucan, Zeevi 2006).

        Each patch is projected orthogonally onto a plane to which no triangle is inclined by more than an angle θ. Then
        no length changes by more than a factor C ≤ 1 + tan θ, nor angles by a dilatation of more than
        K ≤ (1 + tan θ)^1.5. Nothing of the surface is cut or left out: every triangle belongs to one patch, and no
        patch lies on itself.

        Parameters
        ----------
        max_angle : float, optional
            θ, degrees, from 0.01 to 80: the greatest inclination to a patch's plane; by default 10.
        bound : float, optional
            Instead of the angle the greatest factor C by which lengths may change. The angle is the largest one for
            which C = K = 1/cos θ, the exact bound of a projection, is within it: fewer patches than the formula above
            needs.
        count : int, optional
            Instead of the angle the greatest number of patches, for which the smallest angle is sought.
        seeds : {"curvature", "flattest", "random"}
            Where patches begin. "curvature": candidates are grown around the flattest places, turned to where they
            become largest, and the largest is kept first; small patches are dissolved in their neighbours. The others
            are the paper's: one patch after another, on the plane of the flattest or of a random triangle.
        seed : int
            Of the random choice.
        threads : int, optional
            How many threads work; by default one for each core.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        FlatAtlas
            The same for any numbering of vertices and triangles, but for the order of arrays.

        Raises
        ------
        InputError
            If an argument does not fit.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> cube = voxflat.surface(np.pad(np.ones((4, 4, 4), dtype=bool), 1))
        >>> atlas = cube.patches(max_angle=30)
        >>> atlas.certificate.c < 2
        True
        """
        limits = {"max_angle": max_angle, "bound": bound, "count": count}
        return patches(self, limits, seeds, checked_seed(seed), checked_threads(threads), progress)

    # ------------------------------------------------------------------------------------------ distances

    @telling()
    def geodesic(
        self,
        sources: int | ArrayLike,
        *,
        geodesic: str = "graph",
        sampling: str = "farthest",
        link_lengths: str | None = None,
        store: str | os.PathLike[str] | None = None,
        dask: str | None = None,
        seed: int = 0,
        threads: int | None = None,
        memory_limit: int | None = None,
        progress: Progress | None = None,
    ) -> DistanceRows:
        """Measure geodesic distances from sources to all points.

        Parameters
        ----------
        sources : int or array_like
            How many points distances are measured from, or which: voxel indices (m, 3), or vertex numbers (m,). Of a
            surface in several components that of the sources counts; without sources the largest one.
        geodesic : {"graph", "marching", "exact", "chain"}
            "graph": paths of straight links over the triangles of the surface, a fraction of a per cent too long, and
            by far the fastest for many sources. "marching": fast marching (Kimmel, Sethian 1998), with fronts taken for
            circles. "exact": the exact distances on the triangles (Mitchell, Mount, Papadimitriou 1987), slow. "chain":
            chain-code lengths over the 26-neighbour graph of a volume's surface voxels.
        sampling : {"farthest", "curvature", "random"}
            How sources are chosen: evenly, each farthest from the others along the surface; up to four times as close
            where the surface bends (not for "chain"); or at random.
        link_lengths : {"chain-code", "euclidean"}, optional
            "chain" only: lengths of the links, as in `voxflat.methods.Grossmann2002`.
        store : path, optional
            Keep the distances in this directory, on disk instead of in memory. If the work is interrupted, by whatever,
            the same call goes on where it was.
        dask : str, optional
            Let the workers of a Dask cluster compute a store's rows, the same bits: the scheduler's address, its file,
            or "local" for workers on this machine. They must see the store's directory. Threads are those of each
            worker.
        seed : int
            Of random choices.
        threads : int, optional
            How many threads work; by default one for each core.
        memory_limit : int, optional
            Bytes that may be used; by default what is free.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        DistanceRows
            Of a store as `voxflat.open_rows` opens it.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> rows = sheet.geodesic([0, 35])
        >>> round(float(rows[0][35]), 3)
        7.071
        """
        what: dict[str, Any] = {"geodesic": geodesic, "sampling": sampling, "link_lengths": link_lengths, "seed": seed}
        limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
        return _geodesic(self, sources, **what, store=store, dask=dask, **limits)

    @telling()
    def path(self, *stops: Sequence[int] | int, geodesic: str = "graph", link_lengths: str | None = None) -> Path:
        """Find the shortest path through points (Grossmann et al. 2002, figure 3).

        Parameters
        ----------
        *stops : sequence of 3 ints, or int
            Two points or more, in the order in which they are passed: voxel indices, or vertex numbers of a mesh.
        geodesic : {"graph", "marching", "exact", "edges", "chain"}
            "graph", "exact" and "chain" as in `geodesic`. "marching" is traced back on the distances of fast marching.
            Those are estimates, but the path is a line over the surface and `length` is its own: never less than the
            exact distance, and not the one that ``geodesic(geodesic="marching")`` returns. "edges" runs along edges
            from neighbour to neighbour, as cuts do.
        link_lengths : {"chain-code", "euclidean"}, optional
            "chain" only: lengths of the links, as in `voxflat.methods.Grossmann2002`.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            If a stop is not on the surface, or stops lie in different components.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> round(sheet.path(0, 5).length, 3)
        5.0
        """
        if len(stops) < 2:
            raise InputError(f"A path needs at least two stops, got {len(stops)}. Pass at least its two ends.")
        return _path(self, stops, geodesic, link_lengths)

    # ------------------------------------------------------------------------------------------ knowledge

    def check(
        self,
        cuts: object | None = None,
        *,
        sphere: object | None = None,
        threads: int | None = None,
        memory_limit: int | None = None,
        progress: Progress | None = None,
    ) -> Check:
        """Say whether the surface can be flattened, and what each remedy would change.

        Parameters
        ----------
        cuts, sphere, threads, memory_limit, progress
            As in `cut`.

        Returns
        -------
        Check

        Raises
        ------
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> import numpy as np
        >>> import voxflat
        >>> voxflat.range_image(np.zeros((6, 6)), 1.0).check().can_flatten
        True
        """
        with reading(memory_limit):
            of = self if self.whole is None else self.whole
            structure, unit = of.metadata.get("structure"), of.metadata.get("unit", "mm")
            contents = size_and_space(of.points, len(of.faces), structure, of.space, unit)
            found = Check(self.metadata["input"], "mesh", contents)
            return check_surface(self, found, Where(cuts, sphere), checked_threads(threads), progress)

    @telling()
    def register(
        self, side: str | None = None, *, threads: int | None = None, progress: Progress | None = None
    ) -> Registration:
        """Find where each vertex of a hemisphere lies on fsaverage's sphere, by the pattern of its folds.

        The surface is laid out on a sphere, one to one (Praun, Hoppe 2003); all rotations are tried against both sides
        of the template, fsaverage5, by depth in folds at three scales and by shape; then it is warped until the depths
        agree, coarse to fine (as in Yeo et al. 2010), by steps that turn no triangle over. Where the surface lies in
        space, and how it is turned, does not matter, nor does its unit. Holes, such as a medial wall that is left out,
        are closed while registering; handles are refused.

        Parameters
        ----------
        side : {"left", "right"}, optional
            Which hemisphere it is; refused where the other side's pattern agrees better. By default it is found.
        threads : int, optional
            How many threads work; by default one for each core.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        Registration
            Its ``confidence`` is a logistic function of the evidence: the agreement with the better side after the best
            rotation (the sum of the correlations of depth at the three scales, of which the finest counts half, and of
            the share that a rigid motion explains), and by how much it exceeds that with the other side. It is 0.5,
            below which a surface is refused, midway between what is known to be no hemisphere and what is known to be
            one; see docs/decisions/0023-registration.md.

        Raises
        ------
        InputError
            If the surface is no hemisphere, as far as its pattern says, not the one that was named, or no sphere.
        Cancelled
            If `progress` returned False.

        Examples
        --------
        >>> import voxflat
        >>> found = voxflat.surface("lh.white").register()  # doctest: +SKIP
        >>> found.save("lh.sphere.reg")  # doctest: +SKIP
        """
        found = register(self, side, threads, progress)
        for remark in found.remarks:
            log.warning(remark)
        return found


@telling()
def surface(
    source: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    unit: str | None = None,
    probability: object | None = None,
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
    label : int, optional
        For volumes: the foreground is this label. By default the only one that there is.
    threshold : float, optional
        For volumes: the foreground is where values are greater than this, in the input's unit.
    spacing : sequence of 3 floats, optional
        Voxel size, mm, for volumes that know none (.npy, arrays); by default 1.
    affine : array_like, shape (4, 4), optional
        From voxel indices to RAS+ mm, for volumes that know none.
    unit : {"mm", "µm", "nm", "cm", "m", "inch"}, optional
        Of the coordinates of a mesh, or of the spacing of an array, whose unit nothing tells; what is shown and written
        of the surface and its maps is in this unit. By default arrays, GIFTI and FreeSurfer's files are in mm, and the
        unit of other meshes is unknown.
    probability : ndarray, path, image object or Volume, optional
        For volumes: an image of the same shape whose value is `threshold`, or 0.5, on the surface. Points are placed
        there. By default they are placed by the volume itself where `threshold` is given and its values change
        smoothly, and else by a fit to the voxels.
    pial : path, Mesh, (points, faces) or pyvista.PolyData, optional
        The pial surface of a white one, with the same vertices: distances are measured midway. A pial surface that does
        not lie outside it, vertex by vertex, is refused.
    repair : {"none", "voxels", "cuts"}, optional
        How to remove topological handles: edit as few voxels as possible ("voxels"), cut the handles open ("cuts"), or
        leave the surface unchanged and fail if it has defects ("none"). With "voxels" the surface of a volume becomes
        one sphere. By default handles of a volume's largest component
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

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> labels = np.zeros((8, 8, 8), dtype=np.uint8)
    >>> labels[2:6, 2:6, 2:6] = 3
    >>> voxflat.surface(labels, label=3)
    <Surface from voxels: 56 vertices, 108 triangles>
    """
    if repair is not None and (not isinstance(repair, str) or repair not in _REPAIRS):
        raise InputError(f"repair is {shown(repair)}. Pass 'none', 'voxels' or 'cuts', or omit it.")
    threads = checked_threads(threads)
    give_back_memory()
    if isinstance(source, Surface):
        _refuse_options("a Surface", label=label, threshold=threshold, spacing=spacing, affine=affine, pial=pial)
        _refuse_options("a Surface", unit=unit, probability=probability, repair=repair)
        return source
    unit = None if unit is None else named_unit(unit)
    given = taken(source, spacing=spacing, affine=affine, unit=unit, memory_limit=memory_limit)
    if isinstance(given, Mesh):
        _refuse_options("a mesh", label=label, threshold=threshold, spacing=spacing, affine=affine)
        _refuse_options("a mesh", probability=probability)
        if repair == "voxels":
            raise InputError("repair is 'voxels', but a mesh has no voxels. Pass 'cuts' or 'none', or omit it.")
        made = of_mesh(given, pial, mend=repair != "none")
    else:
        _refuse_options("a volume", pial=pial)
        inside = foreground_of(given, label=label, threshold=threshold)
        made = of_volume(inside, probability=probability, repair=repair, threads=threads, progress=progress)
    if unit is not None:
        made = replace(made, metadata={**made.metadata, "unit": unit})
    return Surface._of(cut_handles(made, threads, progress) if repair == "cuts" else made)


def _refuse_options(what: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} does not apply when the input is {what}. Do not pass it.")
