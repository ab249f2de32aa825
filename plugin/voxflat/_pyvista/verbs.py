"""The verbs of ``mesh.voxflat`` that compute: maps, distances, patches, cuts, figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
import scipy

from voxflat._pyvista.bars import shown
from voxflat._pyvista.flat import is_map, to_cut_polydata, to_judged_polydata, to_page_polydata, to_polydata, triangles
from voxflat._pyvista.given import Given
from voxflat._pyvista.judged import rows_of
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


class Verbs(Given):
    """What is computed on a dataset."""

    def __call__(
        self,
        scalars: str | None = None,
        *,
        components: str = "largest",
        progress_bar: bool = False,
        **options: Unpack[FlattenOptions],
    ) -> pv.PolyData | pv.MultiBlock:
        """Flatten the mesh, or a surface of the image, into the plane z = 0.

        `scalars`: for images the name of the array; by default the active one, or the only one. `components`: flatten
        the "largest" connected component of a mesh, or "all" of them, each on its own: then a MultiBlock is returned,
        whose blocks "component 1", "component 2", ... are ordered by area. `progress_bar`: show how far it is.
        `**options`: ``label``, ``threshold``, ``keep``, ``seed_point``, ``radius`` and all others as in
        `flatten`. Returns: as from `to_polydata`; of a mesh, the arrays of its points, its cells and its field are
        carried over, and ``vertex_ids`` are numbers of its points. An array whose name the map has for its own gets
        ``mesh_`` before it, with a warning. Raises InputError, Cancelled: as in `flatten`.
        """
        if checked_choice(components, "components", ("largest", "all")) == "all":
            return self._components(scalars, progress_bar, options)
        if self._is_image:
            return to_polydata(self.flatten(scalars, progress_bar=progress_bar, **options))
        skin = self._skin(scalars)
        flat_map = self.flatten(scalars, progress_bar=progress_bar, **options)
        flat = to_polydata(flat_map)
        flat.point_data["vertex_ids"] = skin.point_ids[flat_map.ids]
        told = {**flat_map.description(), "vertices": self._mesh.n_points}  # as vertex_ids count them
        flat.field_data["voxflat"] = [json.dumps(told)]
        skin.carry(flat, flat_map.ids)
        flat.set_active_scalars("distance_error", preference="point")
        return flat

    def _components(self, scalars: str | None, progress_bar: bool, options: FlattenOptions) -> pv.MultiBlock:
        """Flatten each connected component; those that cannot be flattened are left out with a warning."""
        if "keep" in options:
            raise InputError("components='all' and keep cannot be combined: leave one of them out")
        skin = self._skin(scalars)
        corners = np.asarray(skin.mesh.regular_faces, dtype=np.int64)
        links = scipy.sparse.coo_array(
            (np.ones(2 * len(corners)), (corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel())),
            shape=(skin.mesh.n_points,) * 2,
        )
        _, of_points = scipy.sparse.csgraph.connected_components(links, directed=False)
        areas = skin.mesh.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
        total = np.bincount(of_points[corners[:, 0]], areas)
        found = pv.MultiBlock()
        for number, component in enumerate(np.argsort(-total)[: np.count_nonzero(total)].tolist(), 1):
            mask = np.zeros(self._mesh.n_points, dtype=np.bool_)
            mask[skin.point_ids[of_points == component]] = True
            name = f"component {number}"
            try:
                given: FlattenOptions = {**options, "keep": mask}
                found[name] = self(scalars, progress_bar=progress_bar, **given)
            except InputError as error:
                log.warning("%s is left out: %s", name, error)
        if not found.n_blocks:
            raise InputError("no component can be flattened: the warnings say why")
        return found

    def flatten(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> FlatMap:
        """Flatten the mesh, or a surface of the image.

        Parameters
        ----------
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        progress_bar : bool
            Show how far it is.
        **options
            For images ``label=3`` or ``threshold=0.5`` say what is foreground, as in `voxflat.surface`. ``keep``,
            ``drop``, ``seed_point`` with ``radius=45.0`` (mm) and ``polygon`` choose a part, as the methods of
            `Surface` do. A seed is the number of a point, a cell (``mesh.get_cell(9)``) or a position of three floats;
            of images a voxel (i, j, k) or a position. So are the corners of a ``polygon`` and the sources of a method.
            ``keep`` and ``drop`` may be names of other arrays of this dataset, or other images. All others are the
            keyword arguments of `Surface.flatten`. Voxel indices count from 0 at the image's first point or cell;
            `voxel_at` finds them from coordinates.

        Returns
        -------
        FlatMap
            Its ids are those of `surface`, which is a mesh of triangles itself.

        Raises
        ------
        InputError
            If the dataset has no surface, the array is missing or has several components, or `voxflat.flatten` refuses
            it; the message says what to do.
        Cancelled
            As in `voxflat.flatten`.

        Examples
        --------
        >>> pv.Plane(i_size=20, j_size=20).voxflat.flatten()
        <FlatMap: 121 points, 20 x 20, relative error 0.0 %>
        """
        given: dict[str, Any] = {**options}
        with shown(progress_bar, given.pop("progress", None)) as progress:
            part = self._part(scalars, given, progress)
            if "method" in given:
                given["method"] = self._method(scalars, given["method"])
            found: FlatMap = part.flatten(progress=progress, **given)
        return found

    def surface(self, scalars: str | None = None, **options: Unpack[SurfaceOptions]) -> pv.PolyData:
        """Return the surface that is flattened.

        Parameters
        ----------
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        **options
            ``label``, ``threshold``, ``threads``, ``memory_limit``, ``progress`` as in `voxflat.surface`.

        Returns
        -------
        pyvista.PolyData
            Of triangles. Point data ``vertex_ids``, numbers of the dataset's points, or ``voxel_ids`` (i, j, k).

        Raises
        ------
        InputError, Cancelled
            As in `voxflat.surface`.

        Examples
        --------
        >>> pv.Icosphere(nsub=2).voxflat.surface().n_points
        162
        """
        whole = surface(self.volume(scalars) if self._is_image else self._skin(scalars).mesh, **options)
        mesh = triangles(whole.points, whole.faces)
        ids = whole.ids if self._is_image else self._skin(scalars).point_ids[whole.ids]
        mesh.point_data["voxel_ids" if self._is_image else "vertex_ids"] = ids
        return mesh

    def check(self, scalars: str | None = None, **options: Unpack[PlaceOptions]) -> Check:
        """Say whether the surface can be flattened, and what to do.

        Parameters
        ----------
        scalars, **options
            As in `surface`.

        Returns
        -------
        Check

        Raises
        ------
        InputError, Cancelled
            As in `voxflat.check`.

        Examples
        --------
        >>> pv.Plane().voxflat.check().can_flatten
        True
        """
        return check(self.volume(scalars) if self._is_image else self._skin(scalars).mesh, **options)

    def geodesic(
        self,
        sources: Seed | Sequence[Seed],
        *,
        method: str = "graph",
        progress_bar: bool = False,
        progress: Progress | None = None,
    ) -> pv.DataSet:
        """Measure distances along the surface of a mesh.

        Parameters
        ----------
        sources : int, position, pyvista.Cell, or several of them
            Numbers of points; positions, of three floats, of which the nearest point is taken; or cells.
        method : {"graph", "marching", "exact"}
            What measures them, as ``geodesic`` of `Surface.geodesic`.
        progress_bar : bool
            Show how far it is.
        progress : callable, optional
            As in `Surface.geodesic`.

        Returns
        -------
        pyvista.DataSet
            A copy of the mesh with point data ``geodesic_distance`` (active): from the nearest source, in the mesh's
            unit; NaN where no way leads, or no surface is. Points that were merged with another have its distance.

        Raises
        ------
        InputError, Cancelled
            As in `Surface.geodesic`.

        Examples
        --------
        >>> distances = pv.Icosphere(nsub=2).voxflat.geodesic(0)
        >>> distances["geodesic_distance"].shape
        (162,)
        """
        skin = self._skin(None)
        numbers = np.atleast_1d(skin.points(sources, "sources"))
        with shown(progress_bar, progress) as told:
            whole = surface(skin.mesh, progress=told)
            rows = whole.geodesic(numbers, geodesic=method, progress=told)
        nearest = np.min([rows[number] for number in range(len(numbers))], axis=0)
        measured = self._mesh.copy(deep=False)
        distances = np.full(self._mesh.n_points, np.nan)
        distances[skin.point_ids[rows.ids]] = np.where(np.isfinite(nearest), nearest, np.nan)
        merged, one = skin.point_ids[whole.merged].T
        distances[merged] = distances[one]
        measured.point_data["geodesic_distance"] = distances
        measured.set_active_scalars("geodesic_distance", preference="point")
        return measured

    def path(self, a: Seed, b: Seed, *further: Seed, method: str = "exact") -> pv.PolyData:
        """Find the shortest path over the surface of a mesh.

        Parameters
        ----------
        a, b, *further : int, position or pyvista.Cell
            The ends, and further stops after `b`, each as a source of `geodesic`.
        method : {"exact", "graph", "marching", "edges"}
            As ``geodesic`` of `Surface.path`.

        Returns
        -------
        pyvista.PolyData
            A line. Point data ``vertex_ids`` (-1 where it crosses an edge); field data ``length``, in the mesh's unit.

        Raises
        ------
        InputError
            As in `Surface.path`.

        Examples
        --------
        >>> pv.Icosphere(nsub=2).voxflat.path(0, 11).n_points > 1
        True
        """
        skin = self._skin(None)
        stops = [skin.point(stop, "stops") for stop in (a, b, *further)]
        found = surface(skin.mesh).path(*stops, geodesic=method)
        line: pv.PolyData = pv.MultipleLines(found.points)
        line.point_data["vertex_ids"] = np.where(found.ids >= 0, skin.point_ids[found.ids], -1)
        line.field_data["length"] = [found.length]
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
        """Flatten the mesh, or a surface of the image, in patches with a certificate.

        Parameters
        ----------
        max_angle : float, optional
            Greatest inclination to a patch's plane, degrees; by default 10.
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        bound, count, seeds, seed
            As in `Surface.patches`.
        glue : float, optional
            Glue the patches within this bound on C, as `FlatAtlas.glue` does.
        packing : {"boxes", "shapes"}
            How the page is packed, as in `Atlas.page`.
        progress_bar : bool
            Show how far it is.
        **options
            ``label``, ``threshold``, ``threads``, ``memory_limit``, ``progress`` as in `Surface.patches`.

        Returns
        -------
        pyvista.PolyData
            The page, as from `to_page_polydata`, with ``patch``, ``piece``, ``isometric``, ``quasi_conformal`` and
            ``areal`` of its triangles; of a mesh all arrays are carried over, as by a call of the accessor.
            ``page.points = page["surface_points"]`` lays it back into space.

        Raises
        ------
        InputError, Cancelled
            As in `Surface.patches`.

        Examples
        --------
        >>> pv.Icosphere(nsub=2).voxflat.patches(max_angle=20).n_cells
        320
        """
        skin = None if self._is_image else self._skin(scalars)
        given: dict[str, Any] = {**options}
        how: dict[str, Any] = {"bound": bound, "count": count, "seeds": seeds, "seed": seed}
        with shown(progress_bar, given.pop("progress", None)) as progress:
            whole = surface(self.volume(scalars) if skin is None else skin.mesh, progress=progress, **given)
            how |= {"threads": given.get("threads"), "progress": progress}
            atlas = whole.patches(max_angle, **how)
            glued = atlas if glue is None else atlas.glue(glue, threads=given.get("threads"), progress=progress)
        page = to_page_polydata(glued, packing=packing)
        if skin is not None:
            ids = np.asarray(page.point_data["vertex_ids"], dtype=np.int64)
            page.point_data["vertex_ids"] = skin.point_ids[ids]
            skin.carry(page, ids)
            page.set_active_scalars("patch", preference="cell")
        return page

    def cut(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[CutOptions]
    ) -> pv.PolyData:
        """Cut the surface open, as it is before it is flattened.

        Parameters
        ----------
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        progress_bar : bool
            Show how far it is.
        **options
            ``cuts``, ``relax``, ``keep``, ``seed_point``, ``radius`` and others as in `Surface.cut`; seeds as in
            `flatten`.

        Returns
        -------
        pyvista.PolyData
            The surface in space, with two points wherever it is cut. Point data ``cut`` (active): the number of the cut
            on which a point lies, from 0, else -1; ``vertex_ids`` or ``voxel_ids``. Of a mesh all arrays are carried
            over. Field data ``voxflat``: ``cuts`` with ``ids``, ``length`` (mm), ``reason`` and ``name`` each, and
            ``remarks``.

        Raises
        ------
        InputError, Cancelled
            As in `Surface.cut`.

        Examples
        --------
        >>> import pyvista as pv
        >>> opened = pv.Icosphere(nsub=2).voxflat.cut()
        >>> flat = opened.voxflat()  # the map with these cuts
        >>> cuts = opened.extract_feature_edges(feature_edges=False, manifold_edges=False)  # as lines
        """
        skin = None if self._is_image else self._skin(scalars)
        given: dict[str, Any] = {**options}
        with shown(progress_bar, given.pop("progress", None)) as progress:
            done = self._part(scalars, given, progress).cut(progress=progress, **given)
        mesh = to_cut_polydata(done, None if skin is None else skin.point_ids)
        if skin is not None:
            skin.carry(mesh, done.surface.ids)
            mesh.set_active_scalars("cut", preference="point")
        return mesh

    def measure(
        self,
        flat: object,
        scalars: str | None = None,
        *,
        sources: int | None = None,
        reference: str | None = None,
        seed: int = 0,
        progress_bar: bool = False,
        **options: Unpack[PlaceOptions],
    ) -> pv.PolyData:
        """Measure a flat map of the surface, whoever made it.

        Parameters
        ----------
        flat : pyvista.PolyData, FlatMap, path, or array_like of shape (n_points, 2)
            A map of this accessor, with its cuts; one of any tool with as many points as the dataset; or another map,
            as in `voxflat.measure`.
        scalars : str, optional
            For images the name of the array; by default the active one, or the only one.
        sources, reference, seed
            As in `voxflat.measure`.
        progress_bar : bool
            Show how far it is.
        **options
            ``label``, ``threshold``, ``threads``, ``memory_limit``, ``progress`` as in `voxflat.surface`.

        Returns
        -------
        pyvista.PolyData
            The map in the plane z = 0 with its measures, named as in `to_polydata`; field data ``voxflat``:
            ``distortion``, its figures. Of a mesh all arrays are carried over.

        Raises
        ------
        InputError, Cancelled
            As in `voxflat.measure`.

        Examples
        --------
        >>> import pyvista as pv
        >>> mesh = pv.ParametricEnneper(u_res=12, v_res=12)
        >>> shadow = mesh.project_points_to_plane(normal=(0, 0, 1))  # any map
        >>> measured = mesh.voxflat.measure(shadow)
        >>> worst = measured["distance_error"].max()
        >>> measured.voxflat.plot("areal")  # doctest: +SKIP
        """
        skin = None if self._is_image else self._skin(scalars)
        given: dict[str, Any] = {**options}
        how: dict[str, Any] = {"sources": sources, "reference": reference, "seed": seed}
        with shown(progress_bar, given.pop("progress", None)) as progress:
            whole = surface(self.volume(scalars) if skin is None else skin.mesh, progress=progress, **given)
            how |= {"threads": given.get("threads"), "progress": progress}
            judged = compare(whole, {"": rows_of(flat, whole, skin)}, **how).maps[""]
        at = np.empty(whole.count, dtype=np.int64)
        at[whole.vertices] = np.arange(len(whole))
        ids = whole.ids[at[judged.vertex_ids]]
        points = whole.points[at[judged.vertex_ids]]
        if skin is None:
            return to_judged_polydata(judged, points, ids, in_voxels=True)
        mesh = to_judged_polydata(judged, points, skin.point_ids[ids])
        skin.carry(mesh, ids)
        mesh.set_active_scalars("distance_error", preference="point")
        return mesh

    def _laid(self, progress_bar: bool, options: FlattenOptions) -> pv.PolyData:
        """Return the map of this dataset; itself, if it is one."""
        if not is_map(self._mesh):
            return self(progress_bar=progress_bar, **options)
        if options:
            raise InputError(
                f"{', '.join(options)}: the mesh is a flat map already; leave it out, or flatten the surface"
            )
        return self._mesh  # type: ignore[return-value]
