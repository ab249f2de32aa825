"""``mesh.voxflat``: the verbs of voxflat on datasets of PyVista."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from voxflat._pyvista.flat import to_page_polydata, to_polydata, to_surface_polydata
from voxflat._pyvista.verbs import Verbs
from voxflat.maps.textures.pictures import as_picture, check_cover, place, values_at

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat._pyvista.morphs import Morph
    from voxflat._pyvista.options import FlattenOptions
    from voxflat.lab.map_page import MapPage


class VoxflatAccessor(Verbs):
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
        flat = self._laid(progress_bar, options)
        colours, _ = as_picture(picture)
        uv = np.asarray(flat.points, dtype=np.float64)[:, :2]
        coordinates = place(uv, colours.shape, texel_size)
        if texel_size is not None and not repeat:
            check_cover(coordinates, colours.shape, texel_size)
        surface = flat.copy(deep=False)
        if "torn" in flat.cell_data and np.any(flat.cell_data["torn"]):
            surface = surface.remove_cells(np.flatnonzero(flat.cell_data["torn"]).tolist())
        surface.SetPoints(pv.vtk_points(np.array(surface.point_data["surface_points"])))  # those of `flat` stay
        surface.point_data["colours"] = np.round(values_at(colours, coordinates, repeat)).astype(np.uint8)
        surface.active_texture_coordinates = coordinates
        texture: pv.Texture = pv.Texture(colours)  # type: ignore[no-untyped-call]
        texture.repeat = repeat
        return surface, texture

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

        Examples
        --------
        >>> pv.Plane().voxflat.export_html("plane.html")
        """
        self.show(title, progress_bar=progress_bar, **options).save(path)
