"""Unfolding: what lies between a surface and its map."""

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
    """A surface that is unfolded into its map, frame by frame.

    Each point runs straight from its place on the surface to its place on the map, which is turned and moved, not
    scaled, to where this is shortest for all (the least sum of squares).

    Parameters
    ----------
    flat : pyvista.PolyData
        The map; it stays as it is.
    n : int
        How many frames, both ends included.

    Raises
    ------
    InputError
        If there are fewer than two frames.

    Examples
    --------
    >>> import pyvista as pv
    >>> morph = pv.ParametricEnneper(u_res=12, v_res=12).voxflat.morph(5)
    >>> len(morph), morph[-1].n_points == morph.at(0.3).n_points
    (5, True)
    """

    def __init__(self, flat: pv.PolyData, n: int = 25) -> None:
        if not is_whole(n) or n < 2:
            raise InputError(f"n is {n!r}; give at least 2 frames")
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
        """Return a frame: the first is the surface, the last the map."""
        if isinstance(number, slice):
            return [self[one] for one in range(*number.indices(self._n))]
        return self.at(range(self._n)[number] / (self._n - 1))

    def __iter__(self) -> Iterator[pv.PolyData]:
        """Yield the frames."""
        return (self[number] for number in range(self._n))

    def at(self, share: float) -> pv.PolyData:
        """Return the mesh after a share of the way.

        Parameters
        ----------
        share : float
            From 0, the surface, to 1, the map.

        Returns
        -------
        pyvista.PolyData
            With all data of the map.

        Raises
        ------
        InputError
            If the share is another.

        Examples
        --------
        >>> morph = pv.Plane().voxflat.morph(5)
        >>> morph.at(0.5).n_points
        121
        """
        if not is_number(share) or not 0 <= share <= 1:
            raise InputError(f"the share is {share!r}; give 0, the surface, to 1, the map")
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
        """Show it, with a slider from the surface to the map.

        Parameters
        ----------
        scalars, cmap, clim, window_size, off_screen, screenshot, show
            As of `VoxflatAccessor.plot`.

        Returns
        -------
        pyvista.Plotter
            Closed if it was shown.

        Raises
        ------
        InputError
            If the map has no such array.

        Examples
        --------
        >>> pv.OFF_SCREEN = True  # or a window opens
        >>> plotter = pv.Plane().voxflat.morph(5).plot()
        """
        view, moved = self._view(scalars, cmap, clim, window_size=window_size, off_screen=off_screen)
        plotter: Any = view
        style = {
            "pointa": (0.2, 0.94),
            "pointb": (0.8, 0.94),
            "title_height": 0.025,
            "fmt": "%.2f",
            "interaction_event": "always",
        }
        plotter.add_slider_widget(moved, [0, 1], value=0, title="from surface to map", color="black", **style)
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
        """Write a film that goes from the surface to the map and back.

        Parameters
        ----------
        path : path
            ``.gif`` or ``.mp4``, as `voxflat.figures.save_movie` writes it.
        scalars, cmap, clim
            As of `VoxflatAccessor.plot`.
        fps : float
            Frames a second.
        window_size : tuple of 2 ints
            Pixels, even numbers.
        progress_bar : bool
            Show how far it is.

        Raises
        ------
        InputError
            If the ending is another, or a package is missing.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> morph = pv.Plane().voxflat.morph(5)
        >>> morph.save("morph.gif")
        """
        from voxflat.figures.files import check_movie, save_movie  # brings in matplotlib

        if not is_number(fps) or not 0 < fps <= 100:
            raise InputError(f"fps is {fps!r}; give a number of frames a second, up to 100")
        if any(side % 2 for side in window_size):
            raise InputError(f"window_size is {window_size}; give even numbers of pixels for a film")
        check_movie(path)
        plotter, moved = self._view(scalars, cmap, clim, window_size=window_size, off_screen=True)
        shares = [number / (self._n - 1) for number in [*range(self._n), *range(self._n - 2, 0, -1)]]
        try:
            with shown(progress_bar, None) as progress:
                save_movie(_Film(plotter, moved, shares, float(fps)), path, progress=progress)
        finally:
            plotter.close()

    def _places(self, share: float) -> NDArray[np.float64]:
        return (1 - share) * self._surface + share * self._laid

    def _view(
        self, scalars: str | None, cmap: str | None, clim: tuple[float, float] | None, **how: Any
    ) -> tuple[pv.Plotter, Callable[[float], None]]:
        """Return a plotter that shows the surface, and what moves it; all of it stays in sight."""
        what = Shown.of(self._flat, scalars, cmap, clim)
        plotter: Any = pv.Plotter(**how)
        plotter.set_background("white")
        mesh = what.mesh(self._surface)
        what.add(plotter, mesh, bar=True, lighting=True)
        both = np.concatenate([self._surface, self._laid])
        look_at(plotter, both, self._turn, how["window_size"], bar=True)

        def moved(share: float) -> None:
            mesh.SetPoints(pv.vtk_points(self._places(share)))
            what.turned(mesh)

        return plotter, moved


class _Film:
    """Pictures of a plotter, one a share of the way."""

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
