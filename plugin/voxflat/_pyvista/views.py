"""A surface and its map side by side, in one scale of colours, linked by clicks."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.figures.colours import LOOKS, Look
from voxflat.maps.colours import label_colours
from voxflat.maps.placement import aligned

_LABELLED = 24  # different whole numbers that get colours of their own
_BAR = {
    "vertical": False,
    "position_x": 0.2,
    "position_y": 0.02,
    "width": 0.6,
    "height": 0.09,
    "n_labels": 3,
    "fmt": "%.3g",
    "title_font_size": 18,
    "label_font_size": 16,
    "color": "black",
}


@dataclass(frozen=True, eq=False)
class Shown:
    """What of a map is shown, and in which colours."""

    flat: pv.PolyData
    values: NDArray[Any]  # as they are shown, a point or a triangle each; of colours three or four
    numbers: NDArray[Any]  # what is told of each place: the values, or for what the colours stand
    name: str  # the array's
    of_points: bool
    look: Look
    clim: tuple[float, float] | None  # None of colours

    @classmethod
    def of(cls, flat: pv.PolyData, scalars: str | None, cmap: str | None, clim: tuple[float, float] | None) -> "Shown":
        """Take an array of a map."""
        name = scalars or flat.active_scalars_name
        of_points = name is not None and name in flat.point_data
        if name is None or not (of_points or name in flat.cell_data):
            there = ", ".join([*flat.point_data, *flat.cell_data])
            raise InputError(f"the map has no array {name!r}; it has {there}")
        values = np.asarray((flat.point_data if of_points else flat.cell_data)[name])
        is_colour = values.ndim == 2 and values.shape[1] in (3, 4) and values.dtype == np.uint8
        if values.dtype.kind not in "biuf" or (values.ndim > 1 and not is_colour):
            raise InputError(
                f"the array {name!r} is {values.dtype} of shape {values.shape}; give one with a number each"
            )
        if is_colour or name in _PATCHES:
            colours = values if is_colour else label_colours(values[:, None] + 1.0)[:, 0, :3]
            return cls(flat, colours, values, name, of_points, Look(name, "viridis"), None)
        look = LOOKS.get(name) or Look(name, _usual_cmap(values))
        shown = look.factor * values.astype(np.float64)
        usual = look.limits if name in LOOKS else _range
        limits = usual(shown) if clim is None else _checked(clim)
        return cls(flat, shown, shown, name, of_points, Look(look.label, cmap or look.cmap), limits)

    def mesh(self, points: NDArray[np.float64]) -> pv.PolyData:
        """Return a mesh of the map's triangles with these places and the values alone."""
        mesh: pv.PolyData = pv.PolyData.from_regular_faces(points, np.asarray(self.flat.regular_faces))
        (mesh.point_data if self.of_points else mesh.cell_data)[self.look.label] = self.values
        self.turned(mesh)
        return mesh

    def turned(self, mesh: pv.PolyData) -> None:
        """Give a mesh whose points have moved the normals that it now has."""
        normals = mesh.compute_normals(
            cell_normals=False, split_vertices=False, consistent_normals=False, auto_orient_normals=False
        )
        mesh.GetPointData().SetNormals(normals.GetPointData().GetNormals())

    def add(self, plotter: Any, mesh: pv.PolyData, *, bar: bool, lighting: bool) -> None:
        """Add a mesh of `mesh` to a plotter."""
        light = {"ambient": 0.35, "diffuse": 0.75, "specular": 0.0} if lighting else {"lighting": False}
        if self.clim is None:
            plotter.add_mesh(mesh, scalars=self.look.label, rgb=True, **light).GetProperty().SetInterpolationToPhong()
            return
        actor = plotter.add_mesh(
            mesh,
            scalars=self.look.label,
            cmap=self.look.cmap,
            clim=self.clim,
            nan_color="lightgrey",
            show_scalar_bar=bar,
            scalar_bar_args={"title": f"{self.look.label}\n", **_BAR} if bar else None,
            **light,
        )
        actor.GetProperty().SetInterpolationToPhong()

    def told(self, point: int, cell: int) -> str:
        """Say what is shown at a place."""
        ids = next((self.flat.point_data[name] for name in _IDS if name in self.flat.point_data), None)
        which = point if ids is None else np.asarray(ids)[point].tolist()
        value = self.numbers[point if self.of_points else cell]
        shown = ", ".join(map(str, value)) if np.ndim(value) else f"{value:.4g}"
        return f"point {which}\n{self.look.label}: {shown}"


_IDS = ("vertex_ids", "voxel_ids")
_PATCHES = ("patch", "piece")  # numbers that have colours as in files and textures of a page


def side_by_side(
    flat: pv.PolyData, scalars: str | None, cmap: str | None, clim: tuple[float, float] | None, **how: Any
) -> pv.Plotter:
    """Return a plotter with the surface on the left and the map on the right; the mesh stays as it is."""
    what = Shown.of(flat, scalars, cmap, clim)
    surface, plane = (np.array(of, dtype=np.float64) for of in (flat.point_data["surface_points"], flat.points))
    plotter: Any = pv.Plotter(shape=(1, 2), border=False, **how)
    plotter.set_background("white")
    width, height = plotter.window_size
    meshes = []
    for column, (points, turn) in enumerate(((surface, aligned(plane, surface)[0]), (plane, np.eye(3)))):
        plotter.subplot(0, column)
        meshes.append(what.mesh(points))
        what.add(plotter, meshes[-1], bar=column == 1, lighting=column == 0)
        look_at(plotter, points, turn, (width / 2, height), bar=column == 1)
    _Link(plotter, what, meshes)
    shown: pv.Plotter = plotter
    return shown


def look_at(
    plotter: Any, points: NDArray[np.float64], turn: NDArray[np.float64], size: tuple[float, float], *, bar: bool
) -> None:
    """Look at points along an axis, all of them in sight and above the colour bar."""
    along = points @ turn
    low, high = along.min(axis=0), along.max(axis=0)
    middle, (width, height, depth) = (low + high) / 2, high - low
    reach = (0.64 if bar else 0.55) * max(height, width * size[1] / size[0]) or 1.0
    middle[1] -= 0.15 * reach if bar else 0.0
    focus, away = turn @ middle, turn[:, 2] * (4 * reach + depth)
    plotter.camera_position = [focus + away, focus, turn[:, 1]]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = reach
    plotter.reset_camera_clipping_range()


class _Link:
    """Marks on both sides what is clicked on one."""

    def __init__(self, plotter: Any, what: Shown, meshes: list[pv.PolyData]) -> None:
        self._what, self._meshes, self._renderers = what, meshes, plotter.renderers
        self._corners = np.asarray(what.flat.regular_faces)
        self._marks, self._actors = [], []
        for column, mesh in enumerate(meshes):
            plotter.subplot(0, column)
            self._marks.append(pv.PolyData(np.array(mesh.points[:1])))
            self._actors.append(
                plotter.add_mesh(
                    self._marks[-1],
                    color="lime",
                    point_size=16,
                    render_points_as_spheres=True,
                    lighting=False,
                    pickable=False,
                    reset_camera=False,
                )
            )
            self._actors[-1].SetVisibility(False)
        self._text: Any = plotter.add_text(
            "" if plotter.off_screen else _HINT, position="upper_left", font_size=10, color="black"
        )
        plotter.enable_point_picking(
            self._picked,
            picker="cell",
            tolerance=0.002,
            left_clicking=True,
            use_picker=True,
            show_point=False,
            show_message=False,
        )

    def _picked(self, _place: object, picker: Any) -> None:
        """Mark the place that was met, where it lies in its triangle, on both meshes."""
        cell = picker.GetCellId()
        if not 0 <= cell < len(self._corners):
            return
        first, second, _ = picker.GetPCoords()
        weights = np.array([1 - first - second, first, second])
        corners = self._corners[cell]
        for mesh, mark, actor in zip(self._meshes, self._marks, self._actors, strict=True):
            mark.points = (weights @ np.asarray(mesh.points)[corners])[None]
            actor.SetVisibility(True)
        self._text.SetText(_UPPER_LEFT, self._what.told(int(corners[weights.argmax()]), cell))


_HINT = "click on either side"
_UPPER_LEFT = 2  # of VTK's corner annotations


def _usual_cmap(values: NDArray[Any]) -> str:
    """Return the colour map of values of which nothing is known."""
    is_labels = values.dtype.kind in "iub" and len(np.unique(values)) <= _LABELLED
    return "tab20" if is_labels else "viridis"


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the least and the greatest value, which are not the same."""
    defined = values[np.isfinite(values)]
    if not len(defined):
        return 0.0, 1.0
    low, high = float(defined.min()), float(defined.max())
    return low, high if high > low else low + 1.0


def _checked(clim: Any) -> tuple[float, float]:
    """Return a range of values that is one."""
    array = np.asarray(clim)
    if array.shape != (2,) or array.dtype.kind not in "iuf" or not np.isfinite(array).all() or not array[0] < array[1]:
        raise InputError(f"clim is {clim!r}; give two numbers, the lower one first")
    return float(array[0]), float(array[1])
