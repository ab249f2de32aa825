"""Animations that unfold a surface into its map."""

import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, overload

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat._pyvista.bars import shown
from voxflat._pyvista.views import Shown, look_at
from voxflat.arguments import is_number, is_whole
from voxflat.errors import InputError
from voxflat.maps.placement import aligned


class Morph(Sequence[pv.PolyData]):
    """A sequence of meshes that morph a surface into its flat map.

    Each point moves on a straight line from its position on the surface to its position on the map. The map is rotated
    and translated, but not scaled, to minimise the sum of squared distances between matching points.

    Parameters
    ----------
    flat : pyvista.PolyData
        The flat map, which is not modified.
    n : int
        Number of frames, at least 2, including the first and the last one.

    See Also
    --------
    VoxflatAccessor.morph : Create a `Morph` from a mesh.

    Examples
    --------
    >>> import pyvista as pv
    >>> morph = pv.ParametricEnneper(u_res=12, v_res=12).voxflat.morph(5)
    >>> len(morph), morph[-1].n_points == morph.at(0.3).n_points
    (5, True)
    """

    def __init__(self, flat: pv.PolyData, n: int = 25) -> None:
        if not is_whole(n) or n < 2:
            raise InputError(f"n is {n!r}. Pass a whole number of at least 2")
        self._flat, self._n = flat, int(n)
        self._surface = np.array(flat.point_data["surface_points"], dtype=np.float64)
        self._turn, self._laid = aligned(np.asarray(flat.points, dtype=np.float64), self._surface)

    def __repr__(self) -> str:
        return f"<Morph: {self._n} frames of {self._flat.n_points} points>"

    def __len__(self) -> int:
        """Return the number of frames."""
        return self._n

    @overload
    def __getitem__(self, number: int) -> pv.PolyData: ...
    @overload
    def __getitem__(self, number: slice) -> list[pv.PolyData]: ...
    def __getitem__(self, number: int | slice) -> pv.PolyData | list[pv.PolyData]:
        """Return a frame. The first frame is the surface, and the last frame is the map."""
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(self._n))]
        return self.at(range(self._n)[number] / (self._n - 1))

    def __iter__(self) -> Iterator[pv.PolyData]:
        """Yield the frames."""
        return (self[number] for number in range(self._n))

    def at(self, share: float) -> pv.PolyData:
        """Return the mesh at a position between the surface and the map.

        The mesh contains all data of the map.

        Parameters
        ----------
        share : float
            Position from 0 (the surface) to 1 (the map).

        Returns
        -------
        pyvista.PolyData
            The mesh at this position.
        """
        if not is_number(share) or not 0 <= share <= 1:
            raise InputError(f"share is {share!r}. Pass a number from 0 (the surface) to 1 (the map)")
        frame: pv.PolyData = self._flat.copy(deep=False)
        frame.SetPoints(pv.vtk_points(self._places(share)))
        return frame

    def plot(
        self,
        scalars: str | None = None,
        *,
        cmap: str | None = None,
        clim: tuple[float, float] | None = None,
        window_size: tuple[int, int] = (960, 800),
        off_screen: bool | None = None,
        screenshot: str | os.PathLike[str] | None = None,
        show: bool = True,
    ) -> pv.Plotter:
        """Show the morph, with a slider from the surface to the map.

        The camera faces the flat map, and the surface is aligned with the map as closely as possible.

        Parameters
        ----------
        scalars : str, optional
            Name of the array to show. By default, the active array.
        cmap : str, optional
            Name of the colour map. The default depends on the array.
        clim : tuple of 2 floats, optional
            Values at the two ends of the colour bar.
        window_size : tuple of 2 ints
            Width and height of the window, in pixels.
        off_screen : bool, optional
            Render without a window. By default, PyVista's setting is used.
        screenshot : path, optional
            File to which a screenshot is written.
        show : bool
            Show the plot now.

        Returns
        -------
        pyvista.Plotter
            The plotter, which is closed if the plot has been shown.

        Raises
        ------
        InputError
            If the map does not have the array.
        """
        view, moved = self._view(scalars, cmap, clim, window_size=window_size, off_screen=off_screen)
        plotter: Any = view
        style = {"title_height": 0.025, "fmt": "%.2f", "color": "black", "interaction_event": "always"}
        place = {"pointa": (0.2, 0.94), "pointb": (0.8, 0.94)}
        plotter.add_slider_widget(moved, [0, 1], value=0, title="from the surface to the map", **place, **style)
        if show or screenshot is not None:
            plotter.show(screenshot=False if screenshot is None else os.fspath(screenshot))
        return view

    def save(
        self,
        path: str | os.PathLike[str],
        scalars: str | None = None,
        *,
        fps: float = 15.0,
        cmap: str | None = None,
        clim: tuple[float, float] | None = None,
        window_size: tuple[int, int] = (800, 800),
        progress_bar: bool = False,
    ) -> None:
        """Write a movie that morphs the surface to the map and back.

        The movie shows the frames of the sequence forwards and then backwards.

        Parameters
        ----------
        path : path
            Name of the file, which must end in ``.gif`` or ``.mp4``.
        scalars : str, optional
            Name of the array to show. By default, the active array.
        fps : float
            Frames per second.
        cmap : str, optional
            Name of the colour map. The default depends on the array.
        clim : tuple of 2 floats, optional
            Values at the two ends of the colour bar.
        window_size : tuple of 2 ints
            Width and height in pixels. Both must be even.
        progress_bar : bool
            Show a progress bar.

        Raises
        ------
        InputError
            If the file name has another extension, or a required package is not installed.
        OSError
            If the file cannot be written.

        See Also
        --------
        voxflat.figures.save_movie : Write any movie to a file.

        Examples
        --------
        >>> morph = pv.Plane().voxflat.morph(5)
        >>> morph.save("morph.gif")
        """
        from voxflat.figures.files import check_movie, save_movie  # imports Matplotlib

        if not is_number(fps) or not 0 < fps <= 100:
            raise InputError(f"fps is {fps!r}. Pass a number greater than 0 and at most 100")
        if any(side % 2 for side in window_size):
            raise InputError(f"window_size is {window_size}. For a movie, pass a width and a height that are even")
        check_movie(path)
        plotter, moved = self._view(scalars, cmap, clim, window_size=window_size, off_screen=True)
        shares = [number / (self._n - 1) for number in [*range(self._n), *range(self._n - 2, 0, -1)]]
        try:
            with shown(progress_bar, None) as progress:
                save_movie(_Frames(plotter, moved, shares, float(fps)), path, progress=progress)
        finally:
            plotter.close()

    def _places(self, share: float) -> NDArray[np.float64]:
        return (1 - share) * self._surface + share * self._laid

    def _view(
        self, scalars: str | None, cmap: str | None, clim: tuple[float, float] | None, **settings: Any
    ) -> tuple[pv.Plotter, Callable[[float], None]]:
        """Return a plotter that shows the surface and a function that moves its points; all positions are in view."""
        shown = Shown.of(self._flat, scalars, cmap, clim)
        plotter: Any = pv.Plotter(**settings)
        plotter.set_background("white")
        mesh = shown.mesh(self._surface)
        shown.add(plotter, mesh, bar=True, lighting=True)
        look_at(plotter, np.concatenate([self._surface, self._laid]), self._turn, settings["window_size"], bar=True)

        def moved(share: float) -> None:
            mesh.SetPoints(pv.vtk_points(self._places(share)))
            shown.turned(mesh)

        return plotter, moved


class _Frames:
    """Screenshots of a plotter, one for each position between the surface and the map."""

    def __init__(self, plotter: pv.Plotter, moved: Callable[[float], None], shares: list[float], rate: float) -> None:
        self._plotter, self._moved, self._shares = plotter, moved, shares
        self.rate = rate

    @property
    def size(self) -> tuple[int, int]:
        width, height = self._plotter.window_size
        return height, width

    def __len__(self) -> int:
        return len(self._shares)

    def __getitem__(self, n: int) -> NDArray[np.uint8]:
        self._moved(self._shares[n])
        self._plotter.render()
        return np.asarray(self._plotter.screenshot(return_img=True))[..., :3]
