"""Show a surface and its map side by side, with a shared colour scale and linked by clicks."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.figures.colours import LOOKS, Look
from voxflat.maps.colours import label_colours
from voxflat.maps.placement import aligned

_LABELLED = 24  # up to this many distinct integers are shown as labels, each in its own colour
_BAR = {"vertical": False, "position_x": 0.2, "position_y": 0.02, "width": 0.6, "height": 0.09, "color": "black"}
_BAR |= {"n_labels": 3, "fmt": "%.3g", "title_font_size": 18, "label_font_size": 16}
_MARK = {"color": "lime", "point_size": 16, "render_points_as_spheres": True, "lighting": False, "pickable": False}
_PICKING = {"picker": "cell", "tolerance": 0.002, "left_clicking": True, "use_picker": True, "show_point": False}
_HINT = "Click on either view to mark a point in both"
_UPPER_LEFT = 2  # index of a VTK corner annotation
_IDS = ("vertex_ids", "voxel_ids")
_PATCHES = ("patch", "piece")  # integers, shown in the same colours as in textures of a page


@dataclass(frozen=True, eq=False)
class Shown:
    """The displayed array of a map, and its colours."""

    flat: pv.PolyData
    values: NDArray[Any]  # displayed values, one per point or triangle; colours have three or four components
    numbers: NDArray[Any]  # the values reported on a click
    name: str  # name of the array
    of_points: bool
    look: Look
    clim: tuple[float, float] | None  # None for colours

    @classmethod
    def of(cls, flat: pv.PolyData, scalars: str | None, cmap: str | None, clim: tuple[float, float] | None) -> "Shown":
        """Select an array of a map."""
        name = scalars or flat.active_scalars_name
        of_points = name is not None and name in flat.point_data
        if name is None or not (of_points or name in flat.cell_data):
            there = ", ".join([*flat.point_data, *flat.cell_data])
            raise InputError(f"the map has no array {name!r}. Choose one of these arrays: {there}")
        values = np.asarray((flat.point_data if of_points else flat.cell_data)[name])
        is_colour = values.ndim == 2 and values.shape[1] in (3, 4) and values.dtype == np.uint8
        if values.dtype.kind not in "biuf" or (values.ndim > 1 and not is_colour):
            kind = f"shape {values.shape} and data type {values.dtype}"
            raise InputError(f"the array {name!r} has {kind}. Choose an array with one number per point or triangle")
        if is_colour or name in _PATCHES:
            colours = values if is_colour else label_colours(values[:, None] + 1.0)[:, 0, :3]
            return cls(flat, colours, values, name, of_points, Look(name, "viridis"), None)
        is_labels = values.dtype.kind in "iub" and len(np.unique(values)) <= _LABELLED
        look = LOOKS.get(name) or Look(name, "tab20" if is_labels else "viridis")
        scaled = look.factor * values.astype(np.float64)
        usual = look.limits if name in LOOKS else _range
        limits = usual(scaled) if clim is None else _checked(clim)
        return cls(flat, scaled, scaled, name, of_points, Look(look.label, cmap or look.cmap), limits)

    def mesh(self, points: NDArray[np.float64]) -> pv.PolyData:
        """Return a mesh of the map's triangles at these positions, with only the displayed values."""
        mesh: pv.PolyData = pv.PolyData.from_regular_faces(points, np.asarray(self.flat.regular_faces))
        (mesh.point_data if self.of_points else mesh.cell_data)[self.look.label] = self.values
        self.turned(mesh)
        return mesh

    def turned(self, mesh: pv.PolyData) -> None:
        """Recompute the normals of a mesh whose points have moved."""
        normals = mesh.compute_normals(
            cell_normals=False, split_vertices=False, consistent_normals=False, auto_orient_normals=False
        )
        mesh.GetPointData().SetNormals(normals.GetPointData().GetNormals())

    def add(self, plotter: Any, mesh: pv.PolyData, *, bar: bool, lighting: bool) -> None:
        """Add a mesh returned by `mesh` to a plotter."""
        light = {"ambient": 0.35, "diffuse": 0.75, "specular": 0.0} if lighting else {"lighting": False}
        look: dict[str, Any] = {"rgb": True}
        if self.clim is not None:
            look = {"cmap": self.look.cmap, "clim": self.clim, "nan_color": "lightgrey", "show_scalar_bar": bar}
            look["scalar_bar_args"] = {"title": f"{self.look.label}\n", **_BAR} if bar else None
        plotter.add_mesh(mesh, scalars=self.look.label, **look, **light).GetProperty().SetInterpolationToPhong()

    def description(self, point: int, cell: int) -> str:
        """Describe the value at a point."""
        ids = next((self.flat.point_data[name] for name in _IDS if name in self.flat.point_data), None)
        which = point if ids is None else np.asarray(ids)[point].tolist()
        value = self.numbers[point if self.of_points else cell]
        text = ", ".join(map(str, value)) if np.ndim(value) else f"{value:.4g}"
        return f"point {which}\n{self.look.label}: {text}"


def side_by_side(
    flat: pv.PolyData, scalars: str | None, cmap: str | None, clim: tuple[float, float] | None, **settings: Any
) -> pv.Plotter:
    """Return a plotter with the surface on the left and the map on the right."""
    content = Shown.of(flat, scalars, cmap, clim)
    surface, plane = (np.array(array, dtype=np.float64) for array in (flat.point_data["surface_points"], flat.points))
    plotter: Any = pv.Plotter(shape=(1, 2), border=False, **settings)
    plotter.set_background("white")
    width, height = plotter.window_size
    meshes = []
    for column, (points, turn) in enumerate(((surface, aligned(plane, surface)[0]), (plane, np.eye(3)))):
        plotter.subplot(0, column)
        meshes.append(content.mesh(points))
        content.add(plotter, meshes[-1], bar=column == 1, lighting=column == 0)
        look_at(plotter, points, turn, (width / 2, height), bar=column == 1)
    _link(plotter, content, meshes)
    view: pv.Plotter = plotter
    return view


def look_at(
    plotter: Any, points: NDArray[np.float64], turn: NDArray[np.float64], size: tuple[float, float], *, bar: bool
) -> None:
    """Point the camera along an axis, with all points in view and above the colour bar."""
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


def _link(plotter: Any, shown: Shown, meshes: list[pv.PolyData]) -> None:
    """Mark a point in both views, at its position within its triangle, when it is clicked in either view."""
    faces, marks, actors = np.asarray(shown.flat.regular_faces), [], []
    for column, mesh in enumerate(meshes):
        plotter.subplot(0, column)
        marks.append(pv.PolyData(np.array(mesh.points[:1])))
        actors.append(plotter.add_mesh(marks[-1], reset_camera=False, **_MARK))
        actors[-1].SetVisibility(False)
    hint = "" if plotter.off_screen else _HINT
    text: Any = plotter.add_text(hint, position="upper_left", font_size=10, color="black")

    def picked(_place: object, picker: Any) -> None:
        cell = picker.GetCellId()
        if not 0 <= cell < len(faces):
            return
        first, second, _ = picker.GetPCoords()
        weights, corners = np.array([1 - first - second, first, second]), faces[cell]
        for mesh, mark, actor in zip(meshes, marks, actors, strict=True):
            mark.points = (weights @ np.asarray(mesh.points)[corners])[None]
            actor.SetVisibility(True)
        text.SetText(_UPPER_LEFT, shown.description(int(corners[weights.argmax()]), cell))

    plotter.enable_point_picking(picked, show_message=False, **_PICKING)


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the smallest and the largest value, or a range of length 1 if they are equal."""
    defined = values[np.isfinite(values)]
    if not len(defined):
        return 0.0, 1.0
    low, high = float(defined.min()), float(defined.max())
    return low, high if high > low else low + 1.0


def _checked(clim: Any) -> tuple[float, float]:
    """Return a range of values; raise InputError if it is invalid."""
    array = np.asarray(clim)
    if array.shape != (2,) or array.dtype.kind not in "iuf" or not np.isfinite(array).all() or not array[0] < array[1]:
        raise InputError(f"clim is {clim!r}. Pass two numbers, the lower one first")
    return float(array[0]), float(array[1])
