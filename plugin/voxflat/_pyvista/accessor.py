"""``mesh.voxflat``: the verbs of voxflat on datasets of PyVista."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from voxflat._pyvista.bars import shown
from voxflat._pyvista.flat import (
    is_map,
    to_cut_polydata,
    to_judged_polydata,
    to_page_polydata,
    to_polydata,
    to_surface_polydata,
)
from voxflat._pyvista.images import volume_of
from voxflat._pyvista.judged import rows_of
from voxflat._pyvista.pictures import textured
from voxflat._pyvista.skins import Skin
from voxflat.arguments import Progress, is_number
from voxflat.errors import InputError
from voxflat.io.volumes import Volume
from voxflat.judging.measure import compare
from voxflat.maps.flat_map import FlatMap
from voxflat.methods import Method, method_of
from voxflat.pipeline.check import check
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.findings import Check

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat._pyvista.morphs import Morph
    from voxflat._pyvista.options import CutOptions, FlattenOptions, PlaceOptions, Seed
    from voxflat.lab.map_page import MapPage


class VoxflatAccessor:
    """Flatten a mesh, or a surface of an image: ``mesh.voxflat(...)``.

    Parameters
    ----------
    mesh : pyvista.DataSet
        An ``ImageData`` with a label volume or intensities, as point data or as cell data; of any other dataset its
        surface is taken, as ``extract_surface`` and ``triangulate`` do. In RAS+ mm. It stays as it is.

    Examples
    --------
    >>> import pyvista as pv
    >>> image = pv.ImageData(dimensions=(30, 40, 3))
    >>> image["labels"] = (image.points[:, 2] == 1).astype("uint8")
    >>> flat = image.voxflat()  # a flat map as PolyData, in mm
    >>> flat_map = image.voxflat.flatten()  # the same as voxflat.FlatMap
    >>> patch = image.voxflat.to_surface_polydata(flat_map)  # and the surface, with the same data
    >>> flat = pv.Plane().voxflat()  # meshes, too: every array is carried over
    >>> page = pv.Icosphere(nsub=2).voxflat.patches(max_angle=20)  # a surface of any topology, in certified patches
    >>> distances = pv.Icosphere(nsub=2).voxflat.geodesic(0)  # along the surface, from a point
    """

    to_polydata = staticmethod(to_polydata)
    to_surface_polydata = staticmethod(to_surface_polydata)
    to_page_polydata = staticmethod(to_page_polydata)

    def __init__(self, mesh: pv.DataSet) -> None:
        self._mesh = mesh

    def __call__(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> pv.PolyData:
        """Flatten the mesh, or a surface of the image, into the plane z = 0.

        `scalars`: for images the name of the array; by default the active one, or the only one. `progress_bar`: show
        how far it is. `**options`: ``label``, ``threshold``, ``keep``, ``seed_point``, ``radius`` and all others as in
        `flatten`. Returns: as from `to_polydata`; of a mesh, the arrays of its points, its cells and its field are
        carried over, and ``vertex_ids`` are numbers of its points. An array whose name the map has for its own gets
        ``mesh_`` before it, with a warning. Raises InputError, Cancelled: as in `flatten`.
        """
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
        """
        given: dict[str, Any] = {**options}
        with shown(progress_bar, given.pop("progress", None)) as progress:
            part = self._part(scalars, given, progress)
            if "method" in given:
                given["method"] = self._method(scalars, given["method"])
            found: FlatMap = part.flatten(progress=progress, **given)
        return found

    def surface(self, scalars: str | None = None, **options: Unpack[PlaceOptions]) -> pv.PolyData:
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
        """
        whole = surface(self.volume(scalars) if self._is_image else self._skin(scalars).mesh, **options)
        faces: Any = whole.faces.astype(np.int64)
        mesh: pv.PolyData = pv.PolyData.from_regular_faces(whole.points, faces)
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
        sources: int = 300,
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

    def texture(
        self,
        picture: object,
        texel_size: float | None = None,
        *,
        repeat: bool = False,
        progress_bar: bool = False,
        **options: Unpack[FlattenOptions],
    ) -> tuple[pv.PolyData, pv.Texture]:
        """Lay a picture onto the surface by its flat map.

        Parameters
        ----------
        picture : path, ndarray or PIL.Image.Image
            As in `FlatMap.textured`.
        texel_size : float, optional
            Side of a pixel of the picture, mm; by default the picture just covers the map's bounding box.
        repeat : bool
            Whether the picture goes on beyond its borders.
        progress_bar, **options
            As of a call of the accessor; of a mesh that is a flat map already, none.

        Returns
        -------
        surface : pyvista.PolyData
            In space, with texture coordinates and all data of the map but triangles that are torn; point data
            ``colours``, uint8: the picture's at each point.
        texture : pyvista.Texture
            For ``surface.plot(texture=texture)``.

        Raises
        ------
        InputError, Cancelled
            As in `flatten` and in `FlatMap.textured`.

        Examples
        --------
        >>> import numpy as np
        >>> import pyvista as pv
        >>> board = np.kron([[0, 255], [255, 0]], np.ones((8, 8))).astype("uint8")
        >>> flat = pv.ParametricEnneper(u_res=12, v_res=12).voxflat()
        >>> surface, texture = flat.voxflat.texture(board, 0.05, repeat=True)
        >>> surface.plot(texture=texture)  # doctest: +SKIP
        """
        return textured(self._laid(progress_bar, options), picture, texel_size, repeat=repeat)

    def plot(
        self,
        scalars: str | None = None,
        *,
        cmap: str | None = None,
        clim: tuple[float, float] | None = None,
        window_size: tuple[int, int] = (1600, 800),
        off_screen: bool | None = None,
        screenshot: str | os.PathLike[str] | None = None,
        show: bool = True,
        progress_bar: bool = False,
        **options: Unpack[FlattenOptions],
    ) -> pv.Plotter:
        """Show the surface and its flat map side by side, in one scale of colours.

        A click on either marks the same place on both, and tells the point's number and the value there.

        Parameters
        ----------
        scalars : str, optional
            Which array of the map is shown: a measure, such as ``"areal"``, or one that was carried over; by default
            the active one.
        cmap : str, optional
            Name of the colour map; by default that of the measure.
        clim : tuple of 2 floats, optional
            The values at both ends of the colours, as the bar shows them; by default up to their 99th percentile.
        window_size : tuple of 2 ints
            Pixels.
        off_screen : bool, optional
            Whether no window is opened; by default as PyVista is set.
        screenshot : path, optional
            A picture to be written.
        show : bool
            Whether it is shown now; if not, `Plotter.show` does it, after whatever else is added.
        progress_bar, **options
            As of a call of the accessor; of a mesh that is a flat map already, none.

        Returns
        -------
        pyvista.Plotter
            Closed if it was shown.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`; or if the map has no such array.

        Examples
        --------
        >>> import pyvista as pv
        >>> flat = pv.ParametricEnneper(u_res=12, v_res=12).voxflat()
        >>> plotter = flat.voxflat.plot("areal", off_screen=True)
        """
        from voxflat._pyvista.views import side_by_side  # colours are matplotlib's, which takes long to import

        view = side_by_side(
            self._laid(progress_bar, options), scalars, cmap, clim, window_size=window_size, off_screen=off_screen
        )
        if show or screenshot is not None:
            view.show(screenshot=False if screenshot is None else os.fspath(screenshot))
        return view

    def morph(self, n: int = 25, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]) -> Morph:
        """Unfold the surface into its map, frame by frame.

        Parameters
        ----------
        n : int
            How many frames, both ends included.
        progress_bar, **options
            As of a call of the accessor; of a mesh that is a flat map already, none.

        Returns
        -------
        Morph
            A sequence of PolyData, from the surface to the map; `Morph.save` writes a film, `Morph.plot` has a slider.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`; or if there are fewer than two frames.

        Examples
        --------
        >>> import pyvista as pv
        >>> morph = pv.ParametricEnneper(u_res=12, v_res=12).voxflat.morph(10)
        >>> halfway = morph.at(0.5)
        >>> morph.save("unfold.gif")  # doctest: +SKIP
        """
        from voxflat._pyvista.morphs import Morph  # colours are matplotlib's, which takes long to import

        return Morph(self._laid(progress_bar, options), n)

    def show(
        self, title: str = "Flat map", *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> MapPage:
        """Show the surface and its flat map in a notebook, side by side, linked under the pointer.

        All arrays with a number a point or a triangle can be chosen; a slider leads from the surface to the map.

        Parameters
        ----------
        title : str
            Above it.
        progress_bar, **options
            As of a call of the accessor; of a mesh that is a flat map already, none.

        Returns
        -------
        MapPage
            Which Jupyter shows by itself; `MapPage.save` writes it.

        Raises
        ------
        InputError, Cancelled
            As in `flatten`.

        Examples
        --------
        >>> import pyvista as pv
        >>> flat = pv.ParametricEnneper(u_res=12, v_res=12).voxflat()
        >>> page = flat.voxflat.show("Enneper's surface")
        >>> page.save("enneper.html")  # doctest: +SKIP
        """
        from voxflat._pyvista.browser import browser_page  # colours are matplotlib's, which takes long to import

        return browser_page(self._laid(progress_bar, options), title)

    def export_html(
        self,
        path: str | os.PathLike[str],
        title: str = "Flat map",
        *,
        progress_bar: bool = False,
        **options: Unpack[FlattenOptions],
    ) -> None:
        """Write what `show` shows as one file of HTML that needs no network.

        Parameters
        ----------
        path : path
            An ``.html`` file. It holds at most about 20,000 points, those of the map that stand for all.
        title, progress_bar, **options
            As of `show`.

        Raises
        ------
        InputError, Cancelled
            As in `show`; or if the name has another ending.
        OSError
            If it cannot be written.
        """
        self.show(title, progress_bar=progress_bar, **options).save(path)

    def volume(self, scalars: str | None = None) -> Volume:
        """Return an array of the image as a volume with its affine, without a copy.

        Parameters
        ----------
        scalars : str, optional
            Name of the array; by default the active one, or the only one.

        Returns
        -------
        Volume
            For the functions of voxflat: ``voxflat.check(image.voxflat.volume())``,
            ``flat_map.image(image.voxflat.volume("T1"))``. Colours, uint8 with 3 or 4 components, are a volume, too.

        Raises
        ------
        InputError
            If the dataset is no ``ImageData``, or the array is missing or has several components.
        """
        return volume_of(self._mesh, scalars)

    def voxel_at(self, point: ArrayLike, scalars: str | None = None) -> tuple[int, int, int]:
        """Find the voxel at a point, for use as a seed point.

        Parameters
        ----------
        point : array_like, shape (3,)
            RAS+ mm, as ``image.points`` are.
        scalars : str, optional
            Name of the array, which may be of points or of cells; by default the active one, or the only one.

        Returns
        -------
        tuple of 3 ints
            Indices of the voxel with the nearest centre.

        Raises
        ------
        InputError
            If the point lies outside the image.
        """
        volume = self.volume(scalars)
        place = np.linalg.solve(volume.affine, [*np.asarray(point, dtype=np.float64), 1.0])[:3]
        i, j, k = np.rint(place).astype(int).tolist()
        if not all(0 <= index < size for index, size in zip((i, j, k), volume.data.shape, strict=False)):
            raise InputError(
                f"the point {np.asarray(point).tolist()} mm lies outside the image, {tuple(self._mesh.bounds)}"
            )
        return i, j, k

    # ---------------------------------------------------------------------------------------- what is given

    @property
    def _is_image(self) -> bool:
        return isinstance(self._mesh, pv.ImageData)

    def _laid(self, progress_bar: bool, options: FlattenOptions) -> pv.PolyData:
        """Return the map of this dataset; itself, if it is one."""
        if not is_map(self._mesh):
            return self(progress_bar=progress_bar, **options)
        if options:
            raise InputError(
                f"{', '.join(options)}: the mesh is a flat map already; leave it out, or flatten the surface"
            )
        return self._mesh  # type: ignore[return-value]

    def _skin(self, scalars: str | None) -> Skin:
        if self._is_image:
            raise InputError("ImageData: make a surface of it first, image.voxflat.surface()")
        if scalars is not None:
            raise InputError(f"scalars is {scalars!r}, but a mesh is flattened as it is; leave it out")
        return Skin.of(self._mesh)

    def _part(self, scalars: str | None, given: dict[str, Any], progress: Progress | None) -> Surface:
        """Return the part of the surface that is chosen; the options that say which are taken out of what is given."""
        skin = None if self._is_image else self._skin(scalars)
        making: dict[str, Any] = {name: given.pop(name) for name in ("label", "threshold") if name in given}
        making |= {name: given[name] for name in ("threads", "memory_limit") if name in given}
        part = surface(self.volume(scalars) if skin is None else skin.mesh, progress=progress, **making)
        for name in ("keep", "drop"):
            region = self._region(given.pop(name, None))
            if region is not None:
                region = region if skin is None else self._mask_of(skin, region, name)
                part = part.keep(region) if name == "keep" else part.drop(region)
        seed_point, radius = given.pop("seed_point", None), given.pop("radius", None)
        if (seed_point is None) != (radius is None):
            named, missing = ("seed_point", "radius") if radius is None else ("radius", "seed_point")
            raise InputError(f"{named} is given without {missing}; give both or neither")
        if seed_point is not None:
            seed = self._voxels(scalars, seed_point) if skin is None else skin.point(seed_point, "seed_point")
            part = part.disk(seed, radius, threads=given.get("threads"), progress=progress)
        if (corners := given.pop("polygon", None)) is not None:
            part = part.polygon(self._places(scalars, corners, "polygon"), progress=progress)
        if skin is not None and isinstance(given.get("cuts"), Sequence) and not isinstance(given["cuts"], str):
            given["cuts"] = [np.atleast_1d(skin.points(one, "cuts")) for one in given["cuts"]]
        return part

    def _method(self, scalars: str | None, method: str | Method) -> Method:
        """Return a method with its sources as the surface has them; a number says how many."""
        chosen = method_of(method)
        sources = getattr(chosen, "sources", 0)
        if is_number(sources):
            return chosen
        own: dict[str, Any] = {"sources": self._places(scalars, sources, "sources")}
        return replace(chosen, **own)

    def _places(self, scalars: str | None, places: Any, name: str) -> Any:
        """Return places on the dataset as the surface has them."""
        if self._is_image:
            return self._voxels(scalars, places)
        return np.atleast_1d(self._skin(scalars).points(places, name))

    def _voxels(self, scalars: str | None, places: Any) -> Any:
        """Return positions in an image as voxels; voxels stay what they are."""
        positions = np.asarray(places)
        if positions.dtype.kind != "f" or positions.shape[-1:] != (3,):
            return places
        voxels = [self.voxel_at(position, scalars) for position in positions.reshape(-1, 3)]
        return voxels[0] if positions.ndim == 1 else np.array(voxels)

    def _mask_of(self, skin: Skin, region: object, name: str) -> object:
        """Return a region of a dataset's points as one of its surface's."""
        if skin.is_dataset or not isinstance(region, np.ndarray):
            return region
        is_mask = region.dtype == bool and region.shape == (self._mesh.n_points,)
        return region[skin.point_ids] if is_mask else skin.points(region, name)

    def _region(self, region: object) -> object:
        """Return a region as `voxflat.flatten` takes it."""
        if isinstance(region, pv.DataSet):
            return volume_of(region)
        if not isinstance(region, str):
            return region
        names = self._mesh.array_names if self._is_image else self._mesh.point_data.keys()
        if region in names:
            if self._is_image:
                return self.volume(region)
            mask: NDArray[np.bool_] = np.asarray(self._mesh.point_data[region]) != 0
            return mask
        if not os.path.exists(region):
            there = ", ".join(names) or "none"
            raise InputError(f"{region!r} is neither an array of the points (there are: {there}) nor a file")
        return region
