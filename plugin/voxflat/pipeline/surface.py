"""The class `Surface`, whose methods are the main operations of voxflat, and the function that makes one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat.arguments import Progress, checked_seed, checked_threads, log, shown
from voxflat.atlases.certified import FlatAtlas
from voxflat.atlases.making import patches
from voxflat.distances.geodesic import geodesic as _geodesic
from voxflat.distances.path import Path
from voxflat.distances.path import path as _path
from voxflat.distances.rows import DistanceRows
from voxflat.errors import InputError
from voxflat.io.grid import named_unit
from voxflat.io.meshes import Mesh
from voxflat.io.provenance import recording
from voxflat.io.reading import reading
from voxflat.io.sources import taken
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.map_cuts import along_map, opened_along
from voxflat.methods import Method, flattened, method_of
from voxflat.methods.method import FlattenSettings, Rows
from voxflat.pipeline.cut_surface import CutSurface
from voxflat.pipeline.distance_matrix import DistanceMatrix
from voxflat.pipeline.distance_matrix import geodesic_matrix as _geodesic_matrix
from voxflat.surfaces.charts import charted
from voxflat.surfaces.cutting import CutSettings, cut_handles
from voxflat.surfaces.findings import Check, check_surface
from voxflat.surfaces.foreground import foreground_of
from voxflat.surfaces.manifold import Manifold, size_and_space
from voxflat.surfaces.of_mesh import of_mesh
from voxflat.surfaces.of_volume import of_volume
from voxflat.surfaces.parts import disk, dropped, kept, polygon
from voxflat.surfaces.smoothing import smoothed
from voxflat.surfaces.standard.registration import Registration, register
from voxflat.surfaces.value_smoothing import smooth_values

_REPAIRS = ("none", "voxels", "cuts")


@dataclass(frozen=True, eq=False, repr=False)
class Surface(Manifold):
    """A surface of triangles, made by `voxflat.surface`.

    `points`, `faces` and `ids` are its vertices, its triangles, and the voxel indices or vertex numbers of its vertices
    in the input. A part of a surface is also a `Surface`. Surfaces are immutable: each method returns a new one.

    Parameters
    ----------
    core : _core.Surface
        The surface in the compiled core.
    voxels : ndarray of int64, shape (V, 3), or None
        The voxel of each vertex of the whole surface, if the input was a volume.
    origin : Origin
        The input: a volume, or a mesh.
    details : dict
        Entries of `metadata` beside those that the other fields write.
    warnings : tuple of str
        Warnings about the surface.
    white_points, pial_points : ndarray of float64, shape (V, 3), or None
        The white and the pial position of each vertex of the whole surface, in RAS+ mm in `space`, if both are known.
    mesh_faces : ndarray of int64, shape (G, 3), or None
        The triangles of the whole mesh as given or repaired, as vertex numbers; None if the input was not a mesh.
    foreground : PackedMask or None
        The voxels from which the surface was made.
    whole : Manifold or None
        The surface of which this one is a part.
    steps : tuple of Step
        The steps that selected the part.
    repair : Repair or None
        The voxels that were changed to remove handles.
    uncertain : ndarray of uint8, shape (V,), or None
        Reasons why the depth around each vertex of the whole surface is uncertain, or 0, for the surface of a rim.
    provenance : dict
        Record of how the surface was made: the version, the function, its parameters, and the files that were read.

    See Also
    --------
    surface : Make a surface.
    FlatMap : The result of `Surface.flatten`.

    Examples
    --------
    >>> cap = voxflat.surface(voxflat.samples.ball()).disk((4, 12, 12), radius=6.0)
    >>> cap.flatten().uv.shape == (len(cap), 2)
    True
    """

    # ------------------------------------------------------------------------------------------ parts

    @recording()
    def keep(self, region: object) -> Surface:
        """Return the part of the surface inside a region.

        Parameters
        ----------
        region : mask, path or vertex numbers
            For surfaces from volumes: a mask of the volume's shape (array, path, image object or Volume), or voxel
            indices (k, 3). For meshes: a mask of shape (V,), vertex numbers, or a file. Supported files are FreeSurfer
            labels and patches, GIFTI labels and shapes, and GIFTI surfaces whose triangles define the part.

        Returns
        -------
        Surface
            The triangles with all corners in the region.

        Raises
        ------
        InputError
            If the region does not match the surface, or contains no triangle.
        """
        return kept(self, region)

    @recording()
    def drop(self, region: object) -> Surface:
        """Return the part of the surface outside a region, such as the medial wall.

        Parameters
        ----------
        region : mask, path or vertex numbers, or "medial wall"
            As in `keep`. ``"medial wall"`` selects the region where the white and pial surfaces touch.

        Returns
        -------
        Surface
            The triangles with no corner in the region.

        Raises
        ------
        InputError
            If the region does not match the surface, or nothing remains.
        """
        return dropped(self, region)

    @recording()
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
            Voxel indices or, for meshes, a vertex number, counted from 0. If a voxel is not on the surface, the nearest
            surface voxel is used; a warning reports the distance if it is large.
        radius : float
            Radius of the disk around `seed_point`, in mm along the surface.
        threads, progress : optional
            As in `flatten`.

        Returns
        -------
        Surface
            The disk.

        Raises
        ------
        InputError
            If the point is not on the surface, or the disk would cover most of it.

        Examples
        --------
        >>> sheet = voxflat.range_image(np.zeros((9, 9)), 1.0)
        >>> len(sheet.disk(40, 2.5)) < len(sheet)
        True
        """
        return disk(self, seed_point, radius, checked_threads(threads), progress)

    @recording()
    def polygon(self, corners: ArrayLike, *, progress: Progress | None = None) -> Surface:
        """Return the region enclosed by shortest paths between corners.

        The closed path follows edges from each corner to the next. The region is the smaller of the two sides of the
        path.

        Parameters
        ----------
        corners : array_like of voxel indices (k, 3) or vertex numbers (k,)
            The corners, in order.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        Surface
            The region.

        Raises
        ------
        InputError
            If a corner is not on the surface, or the path crosses itself.

        Examples
        --------
        >>> sheet = voxflat.range_image(np.zeros((9, 9)), 1.0)
        >>> len(sheet.polygon([20, 24, 60, 56]))
        25
        """
        return polygon(self, corners, progress)

    @recording()
    def smooth(self, length: float, *, progress: Progress | None = None) -> Surface:
        """Return the surface without short waves, such as the noise and the steps of a segmentation.

        Waves of the given length become half as high, waves of half the length become 17 times lower, and waves of
        twice the length keep 94 % of their height. The surface does not shrink as a whole. The last of its `warnings`
        reports how far it moved; `flatten` repeats it as a warning.

        Parameters
        ----------
        length : float
            The length of the waves to remove, in mm (or the unit of the surface). A few voxels are usual.
        progress : callable, optional
            As in `flatten`.

        Returns
        -------
        Surface
            The smoothed surface, with the same vertices and triangles. ``metadata["smoothed"]`` holds the mean and the
            95th percentile of the distance by which it moved along its normals, and its relative change in volume.

        Raises
        ------
        InputError
            If the length is not valid, or the surface is a part of another one or lies between two given surfaces.

        Examples
        --------
        >>> smooth = voxflat.surface(voxflat.samples.ball()).smooth(6.0)
        >>> smooth.metadata["smoothed"]["mean"] < 0.3
        True
        """
        return smoothed(self, length, progress)

    def smooth_values(
        self, values: object, fwhm: float, *, threads: int | None = None, progress: Progress | None = None
    ) -> NDArray[np.float64]:
        """Smooth values at the vertices along the surface.

        The kernel is the solution of the heat equation on the triangles, a Gaussian on a plane. It depends little on
        the sizes and shapes of the triangles, keeps constant values, and stops at the boundary of the surface, such as
        that of the medial wall after ``drop("medial wall")``, and at vertices without a finite value.

        Parameters
        ----------
        values : path, array_like or image object
            Values at the vertices of the complete mesh, of shape (V,), or (V, K) for K maps or frames: an array, a
            file (GIFTI, CIFTI, FreeSurfer, NIfTI), or an object of nilearn or nibabel.
        fwhm : float
            Full width at half maximum of the kernel, in mm (or the unit of the surface).
        threads, progress : optional
            As in `flatten`.

        Returns
        -------
        ndarray of float64, of the shape of the values
            The smoothed values; NaN outside the surface, and where `values` are not finite.

        Raises
        ------
        InputError, Cancelled
            If the width is not positive, the values do not fit the surface, or `progress` returned False.

        Examples
        --------
        >>> hill = voxflat.samples.hill()
        >>> noise = np.random.default_rng(0).normal(size=441)
        >>> bool(hill.smooth_values(noise, 10.0).std() < 0.5 * noise.std())
        True
        """
        return smooth_values(self, values, fwhm, threads, progress)

    # ------------------------------------------------------------------------------------------ cuts and maps

    @recording()
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
        """Cut the surface open to a disk, with further cuts where they reduce distortion.

        A surface without handles keeps its holes if cuts that join them would not improve the map. Methods that require
        a disk make these cuts when they flatten the result.

        Flatten the result with `CutSurface.flatten`, or pass the same options to `flatten`.

        Parameters
        ----------
        cuts : "standard", "automatic", list of paths, dict of paths by name, path of a file, or map, optional
            Where to cut. "standard" cuts along the same lines in every brain: the medial wall, the calcarine sulcus,
            three medial lines and a temporal line, which are traced on the registered `sphere`. "automatic" cuts open
            any surface that is not a disk, and adds the relaxation cuts that suit this surface best. A list or dict
            holds paths of neighbouring vertices (voxel indices (k, 3) or vertex numbers (k,)), for example from
            `Surface.path`; the keys of a dict are names of the cuts. A file holds cuts from `CutSurface.save`, or a
            template from `CutSurface.save_template`. A flat map of this surface (`FlatMap`, its file, or a file or mesh
            of any other tool) stands for the part that it covers and for its cuts. If the surface is still not a disk,
            it is cut open automatically and a warning reports it; pass ``[]`` to prevent this and to keep all holes. A
            cut must not separate a piece of the surface. The default is "standard" for a closed surface whose sphere is
            given, or is stored next to
            its file as in FreeSurfer (``lh.sphere.reg`` next to ``lh.white``), unless a part was chosen other than by
            `drop`; otherwise it is "automatic".
        sphere : path, Mesh, (points, faces), array_like of shape (V, 3) or Registration, optional
            The registered sphere of a mesh, on which standard cuts are traced, with one position for each vertex of the
            whole mesh; it is centred at the origin and may have any radius. It is in fsaverage space, or in fs_LR space
            if the file name indicates it. By default FreeSurfer's sphere is used if it is stored next to the surface
            file and standard cuts are made. Maps cut by a template, or along your own cuts with a `sphere`, are aligned
            with the flat map of fsaverage5 (`FlatMap.frame` is "standard").
        relax : bool or float, optional
            Add relaxation cuts, from the boundary inwards, where they reduce distortion most. True adds cuts as long as
            they pay off, a number limits their total length in mm (including your `cuts`), and False adds none. By
            default, cuts are added as for True if neither `cuts` nor a part defined by triangles is given. A surface
            that was not a closed sphere is then cut only if the distance error would otherwise exceed 4 % and the cuts
            reduce it by at least a tenth. A surface that is flattened unchanged, such as a scan or a patch, is cut only
            if the error would otherwise exceed 15 %.
        adapt : float, optional
            Distance in mm from their original position within which the cuts of a template may grow and branch to
            reduce distortion. By default they stay the same for every brain.
        threads, memory_limit, progress : optional
            As in `flatten`.

        Returns
        -------
        CutSurface
            The surface, cut open, with its cuts.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`.

        Examples
        --------
        >>> opened = voxflat.surface(voxflat.samples.ball()).cut()
        >>> opened.cuts[0].reason
        'closed sphere'
        """
        where: dict[str, Any] = {"cuts": cuts, "sphere": sphere, "relax": relax, "adapt": adapt}
        cut = opened_along(self, CutSettings(**where, threads=threads, progress=progress))
        for warning in cut.warnings:
            log.warning(warning)
        return CutSurface._of(cut)

    @recording()
    def charts(
        self,
        count: int | str = 1,
        *,
        axis: Sequence[Sequence[int] | int] | None = None,
        front: Sequence[int] | int | None = None,
        overlap: float = 0.0,
        relax: float | bool | None = None,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> tuple[CutSurface[Surface], ...]:
        """Divide a closed organ, or a tube with two open ends, into charts that reach from end to end.

        Flatten each chart with `CutSurface.flatten`. The maps are seen from outside and aligned: the axis of the organ
        is horizontal, with the anterior end on the left. Borders between charts follow harmonic longitudes, which are
        also defined for bent organs.

        Parameters
        ----------
        count : int or "cylinder"
            Number of charts. A single chart covers the complete surface, which is cut along a seam opposite `front`.
            Two charts are the front and the back. More charts are gores, numbered upwards from the front. "cylinder"
            returns one chart of a tube, whose map is periodic: the two sides of its seam differ by `FlatMap.period`.
            The ends of a closed organ, up to 60 % of its largest circumference, become two more charts, "anterior" and
            "posterior".
        axis : sequence of two points, optional
            The anterior and the posterior end of the organ: voxel indices, or vertex numbers of a mesh. By default, the
            two points that are farthest from each other along the surface, starting with the lower coordinate. The
            ends of a tube are its boundaries, and the axis only defines their order.
        front : sequence of 3 ints, or int, optional
            Point on the middle line of the first chart. By default, a single chart is cut opposite the shortest path
            between the ends, and several charts start on a broad side of the organ.
        overlap : float
            Width of the band that neighbouring charts share, in mm along the surface.
        relax : bool or float, optional
            Add relaxation cuts, as in `cut`; by default none are added.
        threads, progress : optional
            As in `flatten`.

        Returns
        -------
        tuple of CutSurface
            The charts, starting at the front. ``metadata["chart"]`` describes each one.

        Raises
        ------
        InputError, Cancelled
            If the surface is neither closed nor a tube, has handles, or an argument is not valid.

        See Also
        --------
        Surface.cut : Cut along other lines.
        Surface.patches : Divide any surface into patches with a bound on the distortion.

        Examples
        --------
        >>> ball = voxflat.surface(voxflat.samples.ball())
        >>> front, back = ball.charts(2, axis=[(4, 12, 12), (19, 12, 12)], front=(12, 12, 19), overlap=2.0)
        >>> front.flatten()
        <FlatMap: 388 points, 24 x 25 mm, relative error 7.6 % of interior pairs, 8.7 % of all pairs at the best scale>
        """
        found = charted(self, count, axis, front, overlap, relax, checked_threads(threads), progress)
        for warning in dict.fromkeys(warning for made in found for warning in made.warnings):
            log.warning(warning)
        return tuple(map(CutSurface._of, found))

    @recording(method=method_of)
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

        The surface is first cut open to a disk, as with `cut`. Warnings are sent to the logger ``voxflat`` and listed
        in `FlatMap.warnings`.

        Parameters
        ----------
        method : str or Method
            "voxflat" (the default), "grossmann2002", "zigelman2002", "schwartz1989" or "saucan2006"; or an object of
            `voxflat.methods` with the method's own options, such as ``Zigelman2002(sources=400)``.
        cuts, sphere, relax, adapt : optional
            Where the surface is cut, as in `Surface.cut`.
        mirror : bool
            Mirror the map left to right, so that maps of right hemispheres look like those of left hemispheres.
        rows : bool or path
            Keep the distances from all sources to all points in `FlatMap.rows`: in memory (True), or in a store (a
            directory on disk from which `FlatMap.rows` reads on demand). If the computation of a store is interrupted,
            the same call resumes it. `voxflat.open_rows` opens the directory.
        seed : int
            Seed for all random choices. The same seed gives the same map, bit by bit, for any number of threads.
        threads : int, optional
            Number of threads; by default one per core.
        memory_limit : int, optional
            Maximum amount of memory to use, in bytes; by default the free memory. The required memory is estimated
            before the computation starts.
        progress : callable, optional
            Called as ``progress(stage, done, total)`` about every 20 ms. If it returns False, the computation is
            cancelled.

        Returns
        -------
        FlatMap
            The flat map, with its distortion.

        Raises
        ------
        InputError
            If the input is not valid.
        AreaBoundError
            If no map was found that satisfies ``Voxflat(max_area=...)``.
        Cancelled
            If `progress` returned False.

        See Also
        --------
        Surface.cut : Cut the surface open to a disk.
        voxflat.flatten : Flatten any input.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> round(flat_map.distortion.raw.relative_error, 3)
        0.036
        """
        where: dict[str, Any] = {"cuts": cuts, "sphere": sphere, "relax": relax, "adapt": adapt}
        limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
        return flattened(self, method, FlattenSettings(**where, mirror=mirror, rows=rows, seed=seed, **limits))

    @recording()
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
        """Flatten a surface of any topology in certified patches (Appleboim, Saucan and Zeevi 2006).

        Each patch is projected orthogonally onto a plane to which no triangle is inclined by more than an angle θ. No
        length changes by more than a factor C ≤ 1 + tan θ, and the dilatation of angles is at most K ≤ (1 + tan θ)^1.5.
        The surface is neither cut open nor cropped: every triangle belongs to one patch, and no patch overlaps itself.

        Parameters
        ----------
        max_angle : float, optional
            Maximum angle θ between a triangle and the plane of its patch, in degrees, from 0.01 to 80; by default 10.
        bound : float, optional
            Maximum factor C by which lengths may change, as an alternative to `max_angle`. The angle is the largest one
            for which C = K = 1/cos θ, the exact bound of a projection, stays within `bound`. This needs fewer patches
            than the formula above.
        count : int, optional
            Maximum number of patches, as an alternative to `max_angle`. The smallest possible angle is used.
        seeds : {"curvature", "flattest", "random"}
            Where patches begin. "curvature" grows candidate patches around the flattest places, tilts their planes to
            make the patches as large as possible, and keeps the largest first; small patches are merged into their
            neighbours. "flattest" and "random" follow Appleboim, Saucan and Zeevi (2006): patches grow one after
            another on the plane of the flattest triangle or of a random one.
        seed : int
            Seed for random choices.
        threads, progress : optional
            As in `flatten`.

        Returns
        -------
        FlatAtlas
            The patches. Only the order of their arrays depends on the numbering of vertices and triangles.

        Raises
        ------
        InputError, Cancelled
            If an argument is not valid, or `progress` returned False.

        See Also
        --------
        FlatAtlas.glue : Glue patches into larger pieces.

        Examples
        --------
        >>> cube = voxflat.surface(np.pad(np.ones((4, 4, 4), dtype=bool), 1))
        >>> atlas = cube.patches(max_angle=30)
        >>> atlas.certificate.c < 2
        True
        """
        limits = {"max_angle": max_angle, "bound": bound, "count": count}
        return patches(self, limits, seeds, checked_seed(seed), checked_threads(threads), progress)

    # ------------------------------------------------------------------------------------------ distances

    @recording()
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

        Each source has one row of distances. If the surface has several components, the one that contains the sources
        is used, or the largest one if only the number of sources is given.

        Parameters
        ----------
        sources : int or array_like
            Number of points from which distances are measured, or the points themselves: voxel indices (m, 3) or vertex
            numbers (m,).
        geodesic : {"graph", "marching", "exact", "chain"}
            "graph": lengths of paths made of straight links across the triangles. They are a fraction of a percent too
            long, but are by far the fastest to compute for many sources. "marching": fast marching with circular fronts
            (Kimmel and Sethian 1998). "exact": exact distances on the triangles (Mitchell, Mount and Papadimitriou
            1987), which are slow to compute. "chain": chain-code lengths in the 26-neighbour graph of the surface
            voxels of a volume.
        sampling : {"farthest", "curvature", "random"}
            How sources are chosen: "farthest" spreads them evenly along the surface; "curvature" places them up to four
            times as densely where the surface bends (not for "chain"); "random" draws them at random.
        link_lengths : {"chain-code", "euclidean"}, optional
            Lengths of the links, for "chain" only, as in `voxflat.methods.Grossmann2002`.
        store : path, optional
            Keep the distances in this directory on disk instead of in memory. If the computation is interrupted, the
            same call resumes it.
        dask : str, optional
            Dask cluster whose workers compute the rows of the store, with bit-identical results: the scheduler address,
            a scheduler file, or "local" for workers on this machine. The workers must have access to the directory of
            the store. `threads` then applies to each worker.
        seed : int
            Seed for random choices.
        threads, memory_limit, progress : optional
            As in `flatten`.

        Returns
        -------
        DistanceRows
            The distances. With `store`, they are read from disk, as from `voxflat.open_rows`.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`.

        See Also
        --------
        Surface.path : Find the shortest path through points.
        open_rows : Open the rows of a store.

        Examples
        --------
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> rows = sheet.geodesic([0, 35])
        >>> round(float(rows[0][35]), 3)
        7.071
        """
        kinds: dict[str, Any] = {"geodesic": geodesic, "sampling": sampling, "link_lengths": link_lengths, "seed": seed}
        limits: dict[str, Any] = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
        rows = _geodesic(self, sources, **kinds, store=store, dask=dask, **limits)
        return replace(rows, unit=self.origin.named_unit)

    def geodesic_matrix(
        self,
        parcels: object | None = None,
        *,
        method: str = "mean",
        other: Surface | None = None,
        geodesic: str = "graph",
        table: object | None = None,
        file: str | os.PathLike[str] | None = None,
        dtype: str = "float32",
        sidecar: bool = False,
        overwrite: bool = False,
        threads: int | None = None,
        memory_limit: int | None = None,
        progress: Progress | None = None,
    ) -> DistanceMatrix:
        """Measure the geodesic distances between all vertices, or between all parcels.

        Paths stay on the surface. To exclude the medial wall from the paths and from the matrix, pass the part of the
        surface without it (`Surface.drop`).

        Parameters
        ----------
        parcels : path, ndarray, image object or pair of these, optional
            Labels of the vertices (``.annot``, ``.label.gii``, ``.dlabel.nii``, one or a list of ``.label`` or
            ``.border`` files, or whole numbers of shape (V,)), or a volume of labels. The distances are then those
            between parcels. With `other`, pass a ``.dlabel.nii`` file with both hemispheres, or a pair in the order of
            the surfaces.
        method : {"mean", "min", "centroid"}
            How parcels are compared. "mean": the mean of the distances from each vertex of one to each vertex of the
            other. "min": the shortest of these distances. "centroid": the distance between their centroids, which are
            the vertices closest in space to the mean position of the parcel. The distance of a parcel to itself is 0.
        other : Surface, optional
            The other hemisphere. The rows and columns of the left one come first, as in CIFTI files. Distances between
            hemispheres are infinite.
        geodesic : {"graph", "exact"}
            As in `geodesic`. The distances of "marching" differ between both directions by up to 2 mm, so they are not
            offered.
        table : path or LabelTable, optional
            Names of the parcels, if their file does not contain any, as in `figures.flat_maps`.
        file : path, optional
            Write the distances to this file instead of keeping them in memory: ``.npy`` (which NumPy can map into
            memory) or text (``.csv``, ``.tsv``, ``.txt``), with a table of the rows in ``<file>.rows.tsv``; ``.h5``;
            ``.zarr``; or CIFTI (``.dconn.nii`` for vertices, ``.pconn.nii`` for parcels).
        dtype : {"float32", "float16", "uint8"}
            The type of the values. uint8 holds whole numbers up to 254, and 255 where there is no path. A distance
            that is too long for the type raises an error.
        sidecar, overwrite : bool
            As in `save`, for `file`.
        threads, memory_limit, progress : optional
            As in `flatten`.

        Returns
        -------
        DistanceMatrix
            The distances. If the surface has several components, only the largest is used.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`, or if parcels do not fit the surface, or the file cannot hold the distances.

        See Also
        --------
        Surface.geodesic : Measure the distances from some points only.

        Examples
        --------
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> matrix = sheet.geodesic_matrix(np.repeat([1, 2, 3], 12), method="min")
        >>> matrix.values[0].tolist()
        [0.0, 1.0, 3.0]
        """
        common: dict[str, Any] = {"method": method, "geodesic": geodesic, "table": table, "file": file, "dtype": dtype}
        common |= {"sidecar": sidecar, "overwrite": overwrite, "threads": threads, "memory_limit": memory_limit}
        return _geodesic_matrix(self, parcels, other, **common, progress=progress)

    @recording()
    def path(self, *stops: Sequence[int] | int, geodesic: str = "graph", link_lengths: str | None = None) -> Path:
        """Find the shortest path through points.

        Parameters
        ----------
        *stops : sequence of 3 ints, or int
            Two or more points, in the order in which the path visits them: voxel indices, or vertex numbers of a mesh.
        geodesic : {"graph", "marching", "exact", "edges", "chain"}
            "graph", "exact" and "chain" are as in `geodesic`. "marching" traces the path back through the distances of
            fast marching. These are estimates, but the path is a line on the surface with its own `length`, which is
            never less than the exact distance and differs from the distance that ``geodesic(geodesic="marching")``
            returns. "edges" follows edges between neighbouring vertices, as cuts do.
        link_lengths : {"chain-code", "euclidean"}, optional
            Lengths of the links, for "chain" only, as in `voxflat.methods.Grossmann2002`.

        Returns
        -------
        Path
            The path and its length.

        Raises
        ------
        InputError
            If a stop is not on the surface, or stops lie in different components.

        Examples
        --------
        >>> sheet = voxflat.range_image(np.zeros((6, 6)), 1.0)
        >>> round(sheet.path(0, 5).length, 3)
        5.0
        """
        if len(stops) < 2:
            raise InputError(f"a path requires at least two stops, but got {len(stops)}. Pass at least its two ends")
        return _path(self, stops, geodesic, link_lengths)

    # ------------------------------------------------------------------------------------------ checks and registration

    def check(
        self,
        cuts: object | None = None,
        *,
        sphere: object | None = None,
        threads: int | None = None,
        memory_limit: int | None = None,
        progress: Progress | None = None,
    ) -> Check:
        """Check whether the surface can be flattened, and the effect of each remedy.

        Parameters
        ----------
        cuts, sphere, threads, memory_limit, progress : optional
            As in `cut`.

        Returns
        -------
        Check
            The findings.

        Raises
        ------
        Cancelled
            If `progress` returned False.
        """
        with reading(memory_limit):
            whole = self._complete
            structure, unit = whole.origin.structure, whole.origin.unit
            contents = size_and_space(whole.points, len(whole.faces), structure, whole.space, unit)
            found = Check(self.origin.input, "mesh", contents)
            settings = CutSettings(cuts=cuts, sphere=sphere, threads=threads, progress=progress)
            part, settings = along_map(self, settings)
            return check_surface(part, found, settings)

    @recording()
    def register(
        self, side: str | None = None, *, threads: int | None = None, progress: Progress | None = None
    ) -> Registration:
        """Register a hemisphere to the fsaverage sphere by its folding pattern.

        The surface is mapped one to one onto a sphere (Praun and Hoppe 2003). All rotations are compared with both
        hemispheres of the fsaverage5 template by the depth of the folds at three scales and by shape. The sphere is
        then warped, from coarse to fine (as in Yeo et al. 2010), until the depths agree; no triangle is flipped. The
        position, orientation and unit of the surface do not matter. Holes, such as an excluded medial wall, are closed
        for the registration; handles raise an error.

        Parameters
        ----------
        side : {"left", "right"}, optional
            The hemisphere. An error is raised if the surface matches the other hemisphere better. By default, the
            hemisphere is detected automatically.
        threads, progress : optional
            As in `flatten`.

        Returns
        -------
        Registration
            The position of each vertex on the sphere. Its ``confidence`` is a logistic function of two values: the
            agreement with the better hemisphere after the best rotation (the sum of the correlations of depth at the
            three scales, with half weight for the finest, and of the share explained by a rigid motion), and its excess
            over the agreement with the other hemisphere. Surfaces with a confidence below 0.5 are rejected; this value
            lies midway between known hemispheres and other shapes. See docs/decisions/0023-registration.md.

        Raises
        ------
        InputError
            If the pattern does not match a hemisphere or the given side, or the surface is not a sphere.
        Cancelled
            If `progress` returned False.

        See Also
        --------
        Surface.cut : Cut along standard lines on the sphere.

        Examples
        --------
        >>> found = voxflat.surface("lh.white").register()  # doctest: +SKIP
        >>> found.save("lh.sphere.reg")  # doctest: +SKIP
        """
        registration = register(self, side, threads, progress)
        for warning in registration.warnings:
            log.warning(warning)
        return registration


@recording()
def surface(
    source: object,
    *,
    label: int | Sequence[int] | None = None,
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
    """Make a surface from a label volume or a mesh.

    The surface of a volume has one vertex for each surface voxel and side. The faces between foreground and background
    voxels are glued along their edges, so that thin blades keep two sides and touching banks stay separate; the faces
    of each voxel are then merged. This is not an iso-surface: every vertex is a voxel, placed with sub-voxel precision.

    Parameters
    ----------
    source : ndarray, path, image object, Volume, (points, faces), Mesh, PyVista dataset, Surface or Rim
        A label or intensity volume (I, J, K), or a triangle mesh in RAS+ mm. The space of a mesh (`Surface.space`) is
        the one that its file defines: scanner RAS, FreeSurfer's tkRAS, or unknown. For a `Rim`, its middle surface.
    label : int or sequence of int, optional
        Label of the foreground, for volumes. Several labels form one foreground. By default, the only label in the
        volume.
    threshold : float, optional
        Value above which the voxels of a volume are foreground, in the units of the input.
    spacing : sequence of 3 floats, optional
        Voxel size in mm or `unit`, for volumes that do not define it (.npy files and arrays); by default 1. If a TIFF
        stack defines it along some axes only, these must agree, and the size is in the unit of the file.
    affine : array_like, shape (4, 4), optional
        Matrix from voxel indices to RAS+ mm, for volumes that do not define it.
    unit : {"mm", "µm", "nm", "cm", "m", "inch"}, optional
        Unit of the coordinates of a mesh, or of the spacing of an array, if the input does not define it. Results are
        shown and saved in this unit. By default arrays, GIFTI and FreeSurfer files are in mm, and the unit of other
        meshes is unknown.
    probability : ndarray, path, image object or Volume, optional
        For volumes, an image of the same shape, such as a probability map, whose value on the surface equals
        `threshold` (by default 0.5). Points are placed at this value. By default, the volume itself determines their
        positions if `threshold` is given and its values vary smoothly; otherwise, a fit to the voxels does.
    pial : path, Mesh, (points, faces) or pyvista.PolyData, optional
        The pial surface whose vertices correspond to those of the given white surface. Distances are then measured
        midway between the two surfaces. An error is raised if the pial surface does not lie outside the white one.
    repair : {"none", "voxels", "cuts"}, optional
        How to remove topological handles: edit as few voxels as possible ("voxels"), cut the handles open ("cuts"), or
        leave the surface unchanged and fail if it has defects ("none"). With "voxels" the surface of a volume becomes
        one sphere. By default, handles of a volume's largest component are removed if that changes at most 1 % of its
        voxels, and a warning is issued. Defects of a mesh are repaired if the repair is unambiguous, except with
        "none": triangles without area are removed, directly or by flipping edges (for this, vertices at the same
        position are merged, but keep their numbers); duplicate triangles and triangles with NaN vertices are removed;
        and parts that touch only at a vertex or at an edge of more than two triangles are separated there.
    memory_limit, threads, progress : optional
        As in `flatten`.

    Returns
    -------
    Surface
        The surface, ready to be cut, flattened or measured.

    Raises
    ------
    InputError, Cancelled
        If the input does not define a valid surface, or `progress` returned False.

    See Also
    --------
    range_image : Make a surface from a depth image.
    check : Check whether an input can be flattened.

    Examples
    --------
    >>> voxflat.surface(voxflat.samples.ball(), label=3)
    <Surface from voxels: 632 vertices, 1260 triangles>
    """
    if repair is not None and (not isinstance(repair, str) or repair not in _REPAIRS):
        raise InputError(f"repair is {shown(repair)}. Pass 'none', 'voxels' or 'cuts', or omit it")
    threads = checked_threads(threads)
    voxels = {"label": label, "threshold": threshold, "spacing": spacing, "affine": affine, "probability": probability}
    source = middle_of_rim(source)
    if isinstance(source, Surface):
        _refuse_options("a Surface", **voxels, pial=pial, unit=unit, repair=repair)
        return source
    unit = None if unit is None else named_unit(unit)
    content = taken(source, spacing=spacing, affine=affine, unit=unit, memory_limit=memory_limit)
    if isinstance(content, Mesh):
        _refuse_options("a mesh", **voxels)
        if repair == "voxels":
            raise InputError("repair is 'voxels', but a mesh has no voxels. Pass 'cuts' or 'none', or omit it")
        made = of_mesh(content, Surface, pial, mend=repair != "none", unit=unit)
    else:
        _refuse_options("a volume", pial=pial)
        inside = foreground_of(content, label=label, threshold=threshold, unit=unit, progress=progress)
        made = of_volume(inside, Surface, probability=probability, repair=repair, threads=threads, progress=progress)
    return cut_handles(made, threads, progress) if repair == "cuts" else made


def middle_of_rim(source: object) -> object:
    """Return the middle surface of a `Rim`, whose class is defined further up; any other source as it is."""
    if isinstance(source, CutSurface):
        raise InputError("a CutSurface is cut open already. Call its methods, or pass its `whole`, the surface before")
    middle = getattr(source, "surface", None)
    return middle if isinstance(middle, Surface) else source


def _refuse_options(kind: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} does not apply when the input is {kind}. Omit it")
