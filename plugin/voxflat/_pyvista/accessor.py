"""``mesh.voxflat``: voxflat operations on PyVista datasets."""

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
    """Flatten a mesh, or the surface of a segmented image.

    PyVista makes this accessor available as ``mesh.voxflat``. Call it to flatten the dataset. All methods raise
    `InputError` with an explanation if the dataset or an argument cannot be used, and `Cancelled` if the function given
    as ``progress`` returns False.

    Parameters
    ----------
    mesh : pyvista.DataSet
        An ``ImageData`` with labels or intensities as point data or cell data, in RAS+ mm, or any other dataset, whose
        surface is extracted and triangulated. The dataset is not modified.

    See Also
    --------
    voxflat.surface : Create a surface from arrays, files and other objects.
    BlocksAccessor : The accessor for a MultiBlock.

    Examples
    --------
    >>> import pyvista as pv
    >>> image = pv.ImageData(dimensions=(30, 40, 3))
    >>> image["labels"] = (image.points[:, 2] == 1).astype("uint8")
    >>> flat = image.voxflat()  # the flat map as PolyData, in mm
    >>> flat_map = image.voxflat.flatten()  # the flat map as a voxflat.FlatMap
    >>> patch = image.voxflat.to_surface_polydata(flat_map)  # the surface, with the same data
    >>> flat = pv.Plane().voxflat()  # the flat map of a mesh, with its arrays
    >>> page = pv.Icosphere(nsub=2).voxflat.patches(max_angle=20)  # certified patches, for any topology
    >>> distances = pv.Icosphere(nsub=2).voxflat.geodesic(0)  # along the surface, from point 0
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
        """Map an image onto the surface through its flat map.

        Each point of the surface receives the colour of the image at its position on the flat map.

        Parameters
        ----------
        picture : path, ndarray or PIL.Image.Image
            The image, as in `FlatMap.textured`.
        texel_size : float, optional
            Side length of an image pixel, in mm. By default, the image covers the bounding box of the map.
        repeat : bool
            Whether to repeat the image beyond its borders.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            Flattening options, as in a call to the accessor. Not accepted if the mesh is already a flat map.

        Returns
        -------
        surface : pyvista.PolyData
            The surface in 3D without torn triangles, with texture coordinates and all data of the map. The point data
            ``colours`` (uint8) hold the colour of the image at each point.
        texture : pyvista.Texture
            The image as a texture, for ``surface.plot(texture=texture)``.

        See Also
        --------
        FlatMap.textured : Texture a flat map, and write files that other programs can read.

        Examples
        --------
        >>> board = np.kron([[0, 255], [255, 0]], np.ones((8, 8))).astype("uint8")
        >>> flat = pv.ParametricEnneper(u_res=12, v_res=12).voxflat()
        >>> surface, texture = flat.voxflat.texture(board, 0.05, repeat=True)
        >>> surface.plot(texture=texture)  # doctest: +SKIP
        """
        flat = self._laid(progress_bar, options)
        colours, _ = as_picture(picture)
        coordinates = place(np.asarray(flat.points, dtype=np.float64)[:, :2], colours.shape, texel_size)
        if texel_size is not None and not repeat:
            check_cover(coordinates, colours.shape, texel_size)
        surface = flat.copy(deep=False)
        if "torn" in flat.cell_data and np.any(flat.cell_data["torn"]):
            surface = surface.remove_cells(np.flatnonzero(flat.cell_data["torn"]).tolist())
        surface.SetPoints(pv.vtk_points(np.array(surface.point_data["surface_points"])))  # leaves `flat` unchanged
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
        """Show the surface and its flat map side by side.

        Both views have the same colour scale. A click in either view marks the same point in both views and shows its
        number and value.

        Parameters
        ----------
        scalars : str, optional
            Name of the array to show: a measure such as ``"areal"``, or an array of the mesh. By default,
            the active array.
        cmap : str, optional
            Name of the colour map. The default depends on the array.
        clim : tuple of 2 floats, optional
            Values at the two ends of the colour bar. The default depends on the array.
        window_size : tuple of 2 ints
            Width and height of the window, in pixels.
        off_screen : bool, optional
            Render without a window. By default, PyVista's setting is used.
        screenshot : path, optional
            File to which a screenshot is written.
        show : bool
            Show the plot now. If False, the plot appears when you call `Plotter.show` on the result, for example after
            adding other meshes to it.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            Flattening options, as in a call to the accessor. Not accepted if the mesh is already a flat map.

        Returns
        -------
        pyvista.Plotter
            The plotter, which is closed if the plot has been shown.

        Examples
        --------
        >>> flat = pv.ParametricEnneper(u_res=12, v_res=12).voxflat()
        >>> plotter = flat.voxflat.plot("areal", off_screen=True)
        """
        from voxflat._pyvista.views import side_by_side  # imports Matplotlib, which is slow

        view = side_by_side(
            self._laid(progress_bar, options), scalars, cmap, clim, window_size=window_size, off_screen=off_screen
        )
        if show or screenshot is not None:
            view.show(screenshot=False if screenshot is None else os.fspath(screenshot))
        return view

    def morph(self, n: int = 25, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]) -> Morph:
        """Return a sequence of meshes from the folded surface to the flat map.

        Every point moves on a straight line from its position on the surface to its position on the map.

        Parameters
        ----------
        n : int
            Number of frames, including the first and the last (at least 2).
        progress_bar : bool
            Show a progress bar.
        **options : dict
            Flattening options, as in a call to the accessor. Not accepted if the mesh is already a flat map.

        Returns
        -------
        Morph
            A sequence of meshes from the surface to the map. `Morph.save` writes a movie; `Morph.plot` shows a slider.

        Examples
        --------
        >>> morph = pv.ParametricEnneper(u_res=12, v_res=12).voxflat.morph(10)
        >>> halfway = morph.at(0.5)
        >>> morph.save("unfold.gif")  # doctest: +SKIP
        """
        from voxflat._pyvista.morphs import Morph  # imports Matplotlib, which is slow

        return Morph(self._laid(progress_bar, options), n)

    def show(
        self, title: str = "Flat map", *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> MapPage:
        """Show the surface and its flat map in a notebook.

        The point under the mouse pointer is marked in both views. A menu selects the displayed array, and a slider
        unfolds the surface.

        Parameters
        ----------
        title : str
            Title of the page.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            Flattening options, as in a call to the accessor. Not accepted if the mesh is already a flat map.

        Returns
        -------
        MapPage
            An HTML page that Jupyter displays. `MapPage.save` writes it to a file.

        Examples
        --------
        >>> flat = pv.ParametricEnneper(u_res=12, v_res=12).voxflat()
        >>> page = flat.voxflat.show("Enneper's surface")
        >>> page.save("enneper.html")  # doctest: +SKIP
        """
        from voxflat._pyvista.browser import browser_page  # imports Matplotlib, which is slow

        return browser_page(self._laid(progress_bar, options), title)

    def export_html(
        self,
        path: str | os.PathLike[str],
        title: str = "Flat map",
        *,
        progress_bar: bool = False,
        **options: Unpack[FlattenOptions],
    ) -> None:
        """Write the page of `show` to an HTML file.

        The page does not require a network connection. It contains at most about 20,000 points; larger maps are
        simplified.

        Parameters
        ----------
        path : path
            Name of the file, which must end in ``.html``.
        title : str
            Title of the page.
        progress_bar : bool
            Show a progress bar.
        **options : dict
            As in `show`.

        Raises
        ------
        InputError
            If the file name has another extension.
        OSError
            If the file cannot be written.
        """
        self.show(title, progress_bar=progress_bar, **options).save(path)
