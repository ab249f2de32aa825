"""Operations of ``mesh.voxflat``: maps, distances, patches, cuts and measures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
import scipy

from voxflat._pyvista import flat as meshes
from voxflat._pyvista.bars import shown
from voxflat._pyvista.flat import is_map, to_polydata, triangles
from voxflat._pyvista.given_maps import rows_of
from voxflat._pyvista.inputs import Inputs
from voxflat.arguments import Progress, checked_choice, log
from voxflat.errors import InputError
from voxflat.evaluation.measure import compare
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.check import check
from voxflat.pipeline.surface import surface
from voxflat.surfaces.findings import Check

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat._pyvista.options import CutOptions, FlattenOptions, PlaceOptions, Seed, SurfaceOptions


class Verbs(Inputs):
    """Operations that compute maps, distances, patches, cuts and measures of a dataset."""

    def __call__(
        self,
        scalars: str | None = None,
        *,
        components: str = "largest",
        progress_bar: bool = False,
        **options: Unpack[FlattenOptions],
    ) -> pv.PolyData | pv.MultiBlock:
        """Flatten the mesh, or the surface of the image, into the plane z = 0.

        `scalars` is the name of an image array; by default, the active array or the only array. `components` selects
        the "largest" connected component of a mesh, or "all" components; with "all", the result is a MultiBlock whose
        blocks "component 1", "component 2", ... are ordered by area. `progress_bar` shows a progress bar. `**options`
        are the options of `flatten`. The result is a mesh like that of `to_polydata`. The point, cell and field data of
        a mesh are copied to the map, and ``vertex_ids`` are point numbers of the mesh. If the map has an array of the
        same name, the array of the mesh gets the prefix ``mesh_``, and a warning is issued.
        """
        if checked_choice(components, "components", ("largest", "all")) == "all":
            return self._components(scalars, progress_bar, options)
        flat_map = self.flatten(scalars, progress_bar=progress_bar, **options)
        flat = to_polydata(flat_map)
        if self._is_image:
            return flat
        extracted = self._extracted(scalars)
        flat.point_data["vertex_ids"] = flat_map.ids
        description = {**flat_map.description(), "vertices": self._mesh.n_points}  # the numbering used by vertex_ids
        flat.field_data["voxflat"] = [json.dumps(description)]
        extracted.carry(flat, flat_map.ids)
        flat.set_active_scalars("distance_error", preference="point")
        return flat

    def _components(self, scalars: str | None, progress_bar: bool, options: FlattenOptions) -> pv.MultiBlock:
        """Flatten each connected component; a warning reports those that cannot be flattened."""
        if "keep" in options:
            raise InputError("components='all' and keep cannot be combined. Omit one of them")
        extracted = self._extracted(scalars)
        points, corners = extracted.mesh.points, extracted.mesh.faces
        ends = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
        links = scipy.sparse.coo_array((np.ones(2 * len(corners)), ends), shape=(len(points),) * 2)
        _, of_points = scipy.sparse.csgraph.connected_components(links, directed=False)
        a, b, c = np.moveaxis(points[corners], 1, 0)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        total = np.bincount(of_points[corners[:, 0]], areas)
        blocks = pv.MultiBlock()
        for number, component in enumerate(np.argsort(-total)[: np.count_nonzero(total)].tolist(), 1):
            name = f"component {number}"
            try:
                selected: FlattenOptions = {**options, "keep": of_points == component}
                blocks[name] = self(scalars, progress_bar=progress_bar, **selected)
            except InputError as error:
                log.warning("%s is omitted: %s", name, error)
        if not blocks.n_blocks:
            raise InputError("none of the components can be flattened. See the warnings for the reasons")
        return blocks

    def flatten(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> FlatMap:
        """Return the flat map of the mesh, or of the surface of the image.

        Parameters
        ----------
        scalars : str, optional
            Name of the image array to use. By default, the active array or the only array.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            ``label=3`` or ``threshold=0.5`` selects the foreground of an image, as in `voxflat.surface`. ``keep``,
            ``drop``, ``seed_point`` with ``radius=45.0`` (mm) and ``polygon`` choose a part, like the methods of
            `Surface`. A seed point is a point number, a cell (``mesh.get_cell(9)``) or a position of three floats;
            in an image it is a voxel (i, j, k) or a position. The corners of a ``polygon`` and the sources of a method
            are given in the same way. ``keep`` and ``drop`` may be names of other arrays of this dataset, or other
            images. All other options are keyword arguments of `Surface.flatten`. Voxel indices start from 0 at the
            first point or cell of the image; `voxel_at` computes them from coordinates.

        Returns
        -------
        FlatMap
            The map. Its ids are those of `surface`.

        Raises
        ------
        InputError
            If the dataset does not have a surface, if the array is missing or has several components, or if the surface
            cannot be flattened.
        Cancelled
            As in `voxflat.flatten`.

        See Also
        --------
        voxflat.flatten : Flatten arrays and files.
        surface : Return the surface that is flattened.
        """
        arguments: dict[str, Any] = {**options}
        with shown(progress_bar, arguments.pop("progress", None)) as progress:
            part = self._part(scalars, arguments, progress)
            if "method" in arguments:
                arguments["method"] = self._method(scalars, arguments["method"])
            flat_map: FlatMap = part.flatten(progress=progress, **arguments)
        return flat_map

    def surface(self, scalars: str | None = None, **options: Unpack[SurfaceOptions]) -> pv.PolyData:
        """Return the surface that `flatten` would flatten.

        The surface of an image lies between its foreground and background voxels.

        Parameters
        ----------
        scalars : str, optional
            Name of the image array to use. By default, the active array or the only array.
        **options : dict
            ``label``, ``threshold``, ``threads``, ``memory_limit`` and ``progress``, as in `voxflat.surface`.

        Returns
        -------
        pyvista.PolyData
            Triangles, with the point data ``vertex_ids`` (point numbers of the dataset) or ``voxel_ids`` (i, j, k).
        """
        extracted, source = self._source(scalars, options.get("unit"))
        whole = surface(source, **options)
        mesh = triangles(whole.points, whole.faces)
        if extracted is None:
            mesh.point_data["voxel_ids"] = whole.ids
        else:
            mesh.point_data["vertex_ids"] = whole.ids
        return mesh

    def check(self, scalars: str | None = None, **options: Unpack[PlaceOptions]) -> Check:
        """Report whether the surface can be flattened.

        If it cannot be flattened as it is, the report proposes remedies.

        Parameters
        ----------
        scalars : str, optional
            Name of the image array to use. By default, the active array or the only array.
        **options : dict
            As in `surface`.

        Returns
        -------
        Check
            Components, holes, handles, and the effect of each remedy.
        """
        return check(self._source(scalars)[1], **options)

    def geodesic(
        self,
        sources: Seed | Sequence[Seed],
        *,
        method: str = "graph",
        progress_bar: bool = False,
        progress: Progress | None = None,
    ) -> pv.DataSet:
        """Measure distances along the surface of a mesh.

        The result holds the distance from each point to its nearest source.

        Parameters
        ----------
        sources : int, position, pyvista.Cell, or several of them
            Point numbers, positions of three floats (the nearest point is used), or cells.
        method : {"graph", "marching", "exact"}
            How distances are measured, like the parameter ``geodesic`` of `Surface.geodesic`.
        progress_bar : bool
            Show a progress bar.
        progress : callable, optional
            A function that receives the progress, as in `Surface.geodesic`.

        Returns
        -------
        pyvista.DataSet
            A copy of the mesh with the active point data ``geodesic_distance``, in the unit of the mesh. The distance
            is NaN at points that cannot be reached or are not on the surface.

        Examples
        --------
        >>> distances = pv.Icosphere(nsub=2).voxflat.geodesic(0)
        >>> distances["geodesic_distance"].shape
        (162,)
        """
        extracted = self._extracted(None)
        numbers = np.atleast_1d(extracted.points(sources, "sources"))
        with shown(progress_bar, progress) as report:
            whole = surface(extracted.mesh, progress=report)
            rows = whole.geodesic(numbers, geodesic=method, progress=report)
        nearest = np.min([rows[number] for number in range(len(numbers))], axis=0)
        measured = self._mesh.copy(deep=False)
        distances = np.full(self._mesh.n_points, np.nan)
        distances[rows.ids] = np.where(np.isfinite(nearest), nearest, np.nan)
        merged, copy = whole.merged.T
        distances[merged] = distances[copy]
        measured.point_data["geodesic_distance"] = distances
        measured.set_active_scalars("geodesic_distance", preference="point")
        return measured

    def path(self, a: Seed, b: Seed, *further: Seed, method: str = "exact") -> pv.PolyData:
        """Find the shortest path along the surface of a mesh.

        Parameters
        ----------
        a, b : int, position or pyvista.Cell
            The first and second points of the path, in any form that `geodesic` accepts as a source.
        *further : int, position or pyvista.Cell
            More points, after `b`.
        method : {"exact", "graph", "marching", "edges"}
            How the path is found, like the parameter ``geodesic`` of `Surface.path`.

        Returns
        -------
        pyvista.PolyData
            A line with the point data ``vertex_ids`` (-1 where the path crosses an edge) and the field data ``length``,
            in the unit of the mesh.
        """
        extracted = self._extracted(None)
        stops = [extracted.point(stop, "stops") for stop in (a, b, *further)]
        path = surface(extracted.mesh).path(*stops, geodesic=method)
        count = len(path.points)
        line = pv.PolyData(np.array(path.points), lines=[count, *range(count)] if count > 1 else None)
        line.point_data["vertex_ids"] = path.ids
        line.field_data["length"] = [path.length]
        return line

    def patches(
        self,
        max_angle: float | None = None,
        *,
        scalars: str | None = None,
        bound: float | None = None,
        count: int | None = None,
        glue: float | None = None,
        packing: str = "boxes",
        seeds: str = "curvature",
        seed: int = 0,
        progress_bar: bool = False,
        **options: Unpack[PlaceOptions],
    ) -> pv.PolyData:
        """Flatten the mesh, or the surface of the image, in certified patches.

        The distortion of each patch has a proven bound, whatever the topology of the surface.

        Parameters
        ----------
        max_angle : float, optional
            Largest angle between a triangle and the plane of its patch, in degrees. The default is 10.
        scalars : str, optional
            Name of the image array to use. By default, the active array or the only array.
        bound : float, optional
            Largest factor by which a length may change, as in `Surface.patches`.
        count : int, optional
            Number of patches, as in `Surface.patches`.
        glue : float, optional
            Largest C allowed when patches are glued, as in `FlatAtlas.glue`.
        packing : {"boxes", "shapes"}
            How patches are arranged on the page, as in `Atlas.page`.
        seeds : {"curvature", "flattest", "random"}
            Where patches begin to grow, as in `Surface.patches`.
        seed : int
            Seed of the random number generator.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            ``label``, ``threshold``, ``threads``, ``memory_limit`` and ``progress``, as in `voxflat.surface`.

        Returns
        -------
        pyvista.PolyData
            The page of all patches, as in `to_page_polydata`. The arrays of a mesh are copied, as in a call to the
            accessor. ``page.points = page["surface_points"]`` moves the points of the page back onto the surface.
        """
        extracted, source = self._source(scalars)
        arguments: dict[str, Any] = {**options}
        with shown(progress_bar, arguments.pop("progress", None)) as progress:
            run: dict[str, Any] = {"threads": arguments.get("threads"), "progress": progress}
            whole = surface(source, progress=progress, **arguments)
            atlas = whole.patches(max_angle, bound=bound, count=count, seeds=seeds, seed=seed, **run)
            glued = atlas if glue is None else atlas.glue(glue, **run)
        page = meshes.to_page_polydata(glued, packing=packing)
        if extracted is not None:
            ids = np.asarray(page.point_data["vertex_ids"], dtype=np.int64)
            extracted.carry(page, ids)
            page.set_active_scalars("patch", preference="cell")
        return page

    def cut(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[CutOptions]
    ) -> pv.PolyData:
        """Cut the surface open, without flattening it.

        Calling the accessor of the result flattens it along these cuts.

        Parameters
        ----------
        scalars, progress_bar : optional
            As in `flatten`.
        **options : dict
            Options such as ``cuts``, ``relax``, ``keep``, ``seed_point`` and ``radius``, as in `Surface.cut`. Seed
            points are specified as in `flatten`.

        Returns
        -------
        pyvista.PolyData
            The surface in 3D, with two points wherever it is cut, and all arrays of a mesh. The active point data
            ``cut`` contain the number (from 0) of the cut on which a point lies, or -1. ``vertex_ids`` or ``voxel_ids``
            identify the points. The field data ``voxflat`` contain the ``cuts``, each with ``ids``, ``length`` (mm),
            ``reason`` and ``name``, and the ``warnings``.

        Examples
        --------
        >>> opened = pv.Icosphere(nsub=2).voxflat.cut()
        >>> flat = opened.voxflat()  # the map with these cuts
        >>> cuts = opened.extract_feature_edges(feature_edges=False, manifold_edges=False)  # as lines
        """
        extracted = None if self._is_image else self._extracted(scalars)
        arguments: dict[str, Any] = {**options}
        with shown(progress_bar, arguments.pop("progress", None)) as progress:
            done = self._part(scalars, arguments, progress).cut(progress=progress, **arguments)
        mesh = meshes.to_cut_polydata(done)
        if extracted is not None:
            extracted.carry(mesh, done.surface.ids)
            mesh.set_active_scalars("cut", preference="point")
        return mesh

    def measure(
        self,
        flat: object,
        scalars: str | None = None,
        *,
        sources: int | None = None,
        reference: str | None = None,
        bands: Sequence[float] | None = None,
        seed: int = 0,
        progress_bar: bool = False,
        **options: Unpack[PlaceOptions],
    ) -> pv.PolyData:
        """Measure the distortion of a flat map of the surface.

        Parameters
        ----------
        flat : pyvista.PolyData, FlatMap, path, or array_like of shape (n_points, 2)
            A map from this accessor, which may have cuts, a map from any tool with as many points as the dataset, or
            any other map that `voxflat.measure` accepts.
        scalars : str, optional
            Name of the image array to use. By default, the active array or the only array.
        sources : int, optional
            Number of points from which distances are measured, as in `voxflat.measure`.
        reference : {"exact", "graph"}, optional
            How reference distances are measured, as in `voxflat.measure`.
        bands : sequence of four float, optional
            Upper ends of the distance bands for which errors are also given, as in `voxflat.measure`.
        seed : int
            Seed of the random number generator.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            ``label``, ``threshold``, ``threads``, ``memory_limit`` and ``progress``, as in `voxflat.surface`.

        Returns
        -------
        pyvista.PolyData
            The map in the plane z = 0, with its measures as in `to_polydata` and all arrays of a mesh. The field data
            ``voxflat`` contain the measures of ``distortion``.

        Examples
        --------
        >>> mesh = pv.ParametricEnneper(u_res=12, v_res=12)
        >>> shadow = mesh.project_points_to_plane(normal=(0, 0, 1))  # any flat map
        >>> measured = mesh.voxflat.measure(shadow)
        >>> worst = measured["distance_error"].max()
        >>> measured.voxflat.plot("areal")  # doctest: +SKIP
        """
        extracted, source = self._source(scalars)
        arguments: dict[str, Any] = {**options}
        with shown(progress_bar, arguments.pop("progress", None)) as progress:
            whole = surface(source, progress=progress, **arguments)
            settings: dict[str, Any] = {"sources": sources, "reference": reference, "bands": bands, "seed": seed}
            settings["progress"] = progress
            maps = {"": rows_of(flat, extracted)}
            measured = compare(whole, maps, threads=arguments.get("threads"), **settings).maps[""]
        row = np.empty(whole.count, dtype=np.int64)
        row[whole.vertices] = np.arange(len(whole))
        ids = whole.ids[row[measured.vertex_ids]]
        points = whole.points[row[measured.vertex_ids]]
        if extracted is None:
            return meshes.to_measured_polydata(measured, points, ids, in_voxels=True)
        mesh = meshes.to_measured_polydata(measured, points, ids)
        extracted.carry(mesh, ids)
        mesh.set_active_scalars("distance_error", preference="point")
        return mesh

    def _laid(self, progress_bar: bool, options: FlattenOptions) -> pv.PolyData:
        """Return the flat map of this dataset, or the dataset itself if it is a flat map."""
        if not is_map(self._mesh):
            return self(progress_bar=progress_bar, **options)
        if options:
            names = ", ".join(options)
            raise InputError(f"{names}: the mesh is already a flat map. Omit these options, or flatten its surface")
        return self._mesh  # type: ignore[return-value]
