"""Figures of maps: `scatter`, `heat_map(s)`, `flat_image`, `spectrum`, `patch_3d`; atlases: `atlas_page`, ...

The two in space return a picture, which `save_picture` writes, drawn by PyVista. The others return a
`matplotlib.figure.Figure`, to be changed, or written by `save`; none touches pyplot, so they work without a screen, in
threads, and beside the user's own figures.
"""

from __future__ import annotations

import os
import sys
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from voxflat.errors import InputError
from voxflat.figures.atlases import atlas_3d, atlas_heat_map, atlas_page
from voxflat.io.volumes import as_volume, atomic_path
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.image_files import are_labels, label_colours
from voxflat.maps.raster import FlatImage
from voxflat.surfaces.foreground import foreground

if TYPE_CHECKING:
    import pyvista

    from voxflat.judging.measure import Comparison

__all__ = [
    "atlas_3d",
    "atlas_heat_map",
    "atlas_page",
    "flat_image",
    "heat_map",
    "heat_maps",
    "patch_3d",
    "save",
    "save_picture",
    "scatter",
    "spectrum",
]

_ERRORS = "inferno"  # the colours of distortion, in the plane and in space
_ERROR_LABEL = "mean relative error of distances (%)"
_AREAS = "RdBu_r"  # from shrunk to grown
_AREA_LABEL = "area, log2(flat / surface)"
_USED, _POSITIVE, _NEGATIVE = "#c1440e", "#8a9ba8", "#ffffff"
_CLOSED = 0.05  # of what the normals would sum up to on a plane
_SURROUNDINGS = "#d8d8d4"
_OUTLINE = "#606060"
_MOST_LABELS = 12  # in a legend
_DPI = 200
_SCENE = 0.87  # width of the scene in a picture, the rest is the colour bar's


def scatter(flat_map: FlatMap) -> Figure:
    """Plot flat against geodesic distances (Grossmann et al. 2002, figures 6, 9 and 10b).

    Parameters
    ----------
    flat_map : FlatMap
        A flat map; `Distortion.scatter` has the pairs.

    Returns
    -------
    matplotlib.figure.Figure
        Colours say how many pairs there are; on the diagonal distances are kept.
    """
    distortion = flat_map.distortion
    geodesic, flat = distortion.scatter.T
    top = 1.03 * float(distortion.scatter.max())
    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    axes = figure.add_subplot(xlabel="geodesic distance δ (mm)", ylabel="flat distance d (mm)", aspect="equal")
    axes.plot([0, top], [0, top], color="black", linewidth=0.8, zorder=3, label="d = δ")
    shown = axes.hexbin(
        geodesic, flat, gridsize=90, extent=(0, top, 0, top), bins="log", mincnt=1, cmap="viridis", linewidths=0.1
    )
    axes.set(xlim=(0, top), ylim=(0, top))
    axes.legend(loc="upper left", frameon=False)
    _add_colour_bar(axes, shown, f"pairs in a hexagon, of {len(flat)}", ticks=LogLocator(subs=(1, 2, 5)), format="%g")
    raw = distortion.raw
    axes.set_title(
        rf"$\bar\varepsilon$ = {raw.absolute_error:.2f} mm,  $\bar\varepsilon_r$ = {100 * raw.relative_error:.1f} %,  "
        rf"$\bar\delta$ = {distortion.mean_geodesic:.1f} mm"
    )
    return figure


def heat_map(flat_map: FlatMap, pixel_size: float | None = None) -> Figure:
    """Show how well each place's distances are kept.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    pixel_size : float, optional
        Side of a pixel, mm; by default half the voxel size.

    Returns
    -------
    matplotlib.figure.Figure
        Mean relative error in %, from 0 to the 99th percentile of the points: a few torn places would take all colours.
    """
    image = flat_map.heat_map(pixel_size)
    figure, axes = _map_axes(image)
    shown = axes.imshow(100 * image.data, cmap=_ERRORS, vmin=0, vmax=_top_error(flat_map), **_placed(image))
    _add_colour_bar(axes, shown, _ERROR_LABEL, extend="max")
    return figure


def heat_maps(comparison: Comparison) -> Figure:
    """Show several maps of a surface side by side, in the same colours.

    Parameters
    ----------
    comparison : Comparison
        Judged maps, from `voxflat.compare`.

    Returns
    -------
    matplotlib.figure.Figure
        Above, how well each place's distances are kept, in % from 0 to the 99th percentile over all maps; below, how
        much each place's area has changed, to the 99th percentile either way. The maps are as they are, at scale 1;
        what is undefined is left white.
    """
    maps = comparison.maps
    errors = [100 * one.distortion.per_point for one in maps.values()]
    areas = [one.distortion.triangles.areal for one in maps.values() if one.distortion.triangles is not None]
    top, most = (_top(np.abs(np.concatenate(values))) for values in (errors, areas))
    figure = Figure(figsize=(1.6 + 4.2 * len(maps), 8.0), layout="constrained")
    grid = figure.subplots(2, len(maps), squeeze=False)
    looks = ((errors, _ERRORS, 0.0, top, _ERROR_LABEL, "max"), (areas, _AREAS, -most, most, _AREA_LABEL, "both"))
    for row, (values, colours, low, high, label, extend) in zip(grid, looks, strict=True):
        for axes, name, value in zip(row, maps, values, strict=True):
            one = maps[name]
            look = {"cmap": colours, "norm": Normalize(low, high), "shading": "gouraud", "rasterized": True}
            defined = one.faces[np.isfinite(value)[one.faces].all(axis=1)]
            if len(defined):
                axes.tripcolor(*one.uv.T, np.nan_to_num(value), triangles=defined, **look)
            axes.set(aspect="equal", xlabel="u (mm)", ylabel="v (mm)")
        colour_bar = ScalarMappable(Normalize(low, high), colours)
        figure.colorbar(colour_bar, ax=row.tolist(), label=label, extend=extend)
    for axes, name in zip(grid[0], maps, strict=True):
        axes.set_title(name)
    return figure


def flat_image(
    flat_map: FlatMap,
    volume: object,
    pixel_size: float | None = None,
    *,
    depth: float = 0.0,
    interpolation: str | None = None,
    title: str | None = None,
) -> Figure:
    """Show a volume on the flat map.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    volume, pixel_size, depth, interpolation
        As in `FlatMap.image`.
    title : str, optional
        By default the volume's file name, if it has one.

    Returns
    -------
    matplotlib.figure.Figure
        Scalars in grey from the 1st to the 99th percentile, labels each in a colour of its own, colours as they are;
        axes and scale bar in mm.

    Raises
    ------
    InputError
        As in `FlatMap.image`, or if the volume lies elsewhere than the map.
    """
    image = flat_map.image(volume, pixel_size, depth=depth, interpolation=interpolation)
    if not _inside(image).any():
        raise InputError("the volume has no value anywhere on the map; do their affines agree?")
    figure, axes = _map_axes(image)
    if image.is_colour:
        axes.imshow(image.data, **_placed(image))
    elif are_labels(image):
        axes.imshow(label_colours(image.data), **_placed(image))
        _name_labels(axes, image)
    else:
        low, high = np.nanpercentile(image.data, (1, 99))
        shown = axes.imshow(image.data, cmap="gray", vmin=low, vmax=high, **_placed(image))
        _add_colour_bar(axes, shown, "", extend="both")
    _add_scale_bar(axes, image)
    axes.set_title(title if title is not None else "" if image.name == "volume" else image.name)
    return figure


def spectrum(flat_map: FlatMap) -> Figure:
    """Plot the eigenvalues of the scaling: two that stand out mean a surface that unfolds into the plane.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.

    Returns
    -------
    matplotlib.figure.Figure
        The eigenvalues of the largest magnitude, by falling magnitude.

    Raises
    ------
    InputError
        If the map was made without sources, and so without a scaling.
    """
    values = flat_map.eigenvalues
    if len(values) == 0:
        raise InputError("the map was made without sources, so there are no eigenvalues; flatten with sources")
    used = np.argsort(-values)[:2]
    colours = np.where(values < 0, _NEGATIVE, _POSITIVE)
    colours[used] = _USED
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot(xlabel="eigenvalue, by falling magnitude", ylabel="|λ| (mm²)")
    rank = np.arange(1, len(values) + 1)
    axes.bar(rank, np.abs(values), color=colours.tolist(), edgecolor="black", linewidth=0.6)
    axes.set_xticks(rank)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(0, 0), useMathText=True)
    kinds = {_USED: "used for the map", _POSITIVE: "other, positive", _NEGATIVE: "other, negative"}
    handles = [Patch(facecolor=colour, edgecolor="black", linewidth=0.6, label=kind) for colour, kind in kinds.items()]
    axes.legend(handles=handles, frameon=False)
    axes.set_title(f"{100 * flat_map.metadata['planarity']:.1f} % of Σλ² lies in the plane")
    return figure


def patch_3d(
    flat_map: FlatMap, volume: object | None = None, *, size: tuple[int, int] = (1200, 1000)
) -> NDArray[np.uint8]:
    """Picture the surface patch in space, in the colours of `heat_map`.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    volume : path, ndarray, image object or Volume, optional
        The volume that was flattened: the surface around the patch is shown in grey, too.
    size : tuple of 2 ints
        Width and height in pixels.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        Seen from outside, superior up.

    Raises
    ------
    InputError
        If PyVista is missing or cannot draw, or the volume is another.
    """
    pyvista = _load_pyvista()
    meshes = [_patch_alone(flat_map)] if volume is None else _patch_in_place(flat_map, volume)
    width, height = size
    top = _top_error(flat_map)
    material = {"smooth_shading": True, "ambient": 0.35, "diffuse": 0.8, "specular": 0.0, "show_scalar_bar": False}
    window = [round(_SCENE * width), height]
    with pyvista.vtk_verbosity("error"):  # without a display VTK warns before it draws without
        plotter = pyvista.Plotter(off_screen=True, window_size=window, theme=pyvista.themes.DocumentTheme())
        try:
            plotter.add_mesh(meshes[0], scalars="error", cmap=_ERRORS, clim=(0, top), **material)
            for surroundings in meshes[1:]:
                plotter.add_mesh(surroundings, color=_SURROUNDINGS, **material)
            _look_from_outside(plotter, flat_map)
            plotter.enable_anti_aliasing("ssaa")
            scene = np.asarray(plotter.screenshot(return_img=True))
        finally:
            plotter.close()
    return _beside_colour_bar(scene, width, top)


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure to a file, all of it or nothing.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        A figure.
    path : path
        Ends in ``.png``, ``.pdf``, ``.svg`` or another ending that matplotlib writes.

    Raises
    ------
    InputError
        If the ending is another, or the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix[1:].lower()
    if kind not in figure.canvas.get_supported_filetypes():
        raise InputError(f"cannot write a figure as {path.name}; give a name that ends in .png, .pdf or .svg")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=kind, dpi=_DPI)


def save_picture(picture: NDArray[np.uint8], path: str | os.PathLike[str]) -> None:
    """Write a picture, such as `patch_3d` makes, to a file, all of it or nothing.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        Colours.
    path : path
        Ends in ``.png``, ``.tif`` or another ending that Pillow writes.

    Raises
    ------
    InputError
        If the ending is another, or the file cannot be written.
    """
    path = Path(path)
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise InputError(f"cannot write a picture as {path.name}; give a name that ends in .png or .tif")
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary)


# -------------------------------------------------------------------------------------- in the plane


def _top_error(flat_map: FlatMap) -> float:
    """Return the error, in %, at the upper end of the colours."""
    return 100 * float(np.nanpercentile(flat_map.distortion.per_point, 99)) or 1.0


def _top(values: NDArray[np.float64]) -> float:
    """Return the 99th percentile of the values that are defined, for the upper end of colours; it is not 0."""
    defined = values[np.isfinite(values)]
    return float(np.percentile(defined, 99)) or 1.0 if len(defined) else 1.0


def _map_axes(image: FlatImage) -> tuple[Figure, Axes]:
    """Return a figure with axes in mm around an image's outline."""
    left, right, bottom, top = image.extent
    height = float(np.clip(5.0 * (top - bottom) / (right - left), 2.0, 8.0))
    margin = 0.03 * max(right - left, top - bottom)
    figure = Figure(figsize=(6.8, height + 0.9), layout="compressed")
    axes = figure.add_subplot(xlabel="u (mm)", ylabel="v (mm)", aspect="equal")
    axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin), autoscale_on=False)
    step = image.pixel_size  # a pixel more on each side, where the outline closes
    around = (left - step, right + step, bottom - step, top + step)
    inside = np.pad(_inside(image), 1).astype(float)
    axes.contour(inside, [0.5], colors=_OUTLINE, linewidths=0.6, extent=around, origin="upper")
    return figure, axes


def _placed(image: FlatImage) -> dict[str, Any]:
    """Return the arguments by which `imshow` puts an image where it lies, pixel by pixel."""
    return {"extent": image.extent, "origin": "upper", "interpolation": "none", "aspect": "equal"}


def _inside(image: FlatImage) -> NDArray[np.bool_]:
    return np.asarray(image.data[..., 3] > 0 if image.is_colour else np.isfinite(image.data))


def _add_colour_bar(axes: Axes, shown: Any, label: str, **options: Any) -> None:
    axes.figure.colorbar(shown, ax=axes, label=label, fraction=0.045, pad=0.03, aspect=22, **options)


def _name_labels(axes: Axes, image: FlatImage) -> None:
    inside = _inside(image)
    labels, first = np.unique(image.data[inside], return_index=True)
    if len(labels) > _MOST_LABELS:
        return
    colours = label_colours(image.data)[inside][first] / 255
    handles = [Patch(color=colour, label=f"{label:g}") for label, colour in zip(labels, colours, strict=True)]
    axes.legend(handles=handles, title="label", loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _add_scale_bar(axes: Axes, image: FlatImage) -> None:
    """Draw a round length, up to a quarter of the image's width, in the corner where it hides least of the map."""
    left, right, bottom, top = image.extent
    room = (right - left) / 4
    power = 10.0 ** np.floor(np.log10(room))
    length = power * max(step for step in (1, 2, 5) if step * power <= room)
    inside = _inside(image)
    high = int(np.ceil(0.08 * inside.shape[0]))
    wide = int(np.ceil(length / (right - left) * inside.shape[1]))
    rows = {"bottom": slice(-high, None), "top": slice(None, high)}
    columns = {"right": slice(-wide, None), "left": slice(None, wide)}
    at_row, at_column = min(product(rows, columns), key=lambda at: inside[rows[at[0]], columns[at[1]]].sum())
    start = right - length if at_column == "right" else left
    height = bottom if at_row == "bottom" else top
    axes.plot([start, start + length], [height, height], color="black", linewidth=3, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} mm",
        (start + length / 2, height),
        xytext=(0, 4 if at_row == "bottom" else -4),
        textcoords="offset points",
        ha="center",
        va="bottom" if at_row == "bottom" else "top",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1},
    )


# ---------------------------------------------------------------------------------------- in space


def _load_pyvista() -> Any:
    """Import PyVista, and refuse what would end the process: an old VTK without a display."""
    try:
        import pyvista
    except ImportError as error:
        raise InputError("pictures in space need PyVista: pip install 'voxflat[pyvista]'") from error
    if sys.platform == "linux" and "DISPLAY" not in os.environ and pyvista.vtk_version_info < (9, 4):
        raise InputError("this VTK draws only with a display: run it under xvfb-run, or take VTK 9.4 or later")
    return pyvista


def _patch_alone(flat_map: FlatMap) -> pyvista.PolyData:
    """Return a skin around the patch's voxels; the map's faces would leave holes where the map is torn."""
    low, high = flat_map.ids.min(axis=0) - 3, flat_map.ids.max(axis=0) + 3
    field = np.zeros(high - low + 1, dtype=np.float32)
    field[tuple((flat_map.ids - low).T)] = 1
    return _iso_surface(flat_map, gaussian_filter(field, 1.0), 0.2, low)


def _patch_in_place(flat_map: FlatMap, volume: object) -> list[pyvista.PolyData]:
    """Return the patch and what surrounds it, as the surface between foreground and background voxels."""
    data = as_volume(volume).data
    if data.shape != flat_map.volume_shape:
        raise InputError(f"the volume has shape {data.shape}, the flattened one {flat_map.volume_shape}; give that one")
    mask = foreground(data, label=flat_map.metadata["label"], threshold=flat_map.metadata["threshold"])
    if not mask[tuple(flat_map.ids.T)].all():
        raise InputError("the map's points are no foreground of this volume; give the one that was flattened")
    mesh = _iso_surface(flat_map, np.pad(mask, 1).astype(np.float32), 0.5, np.array([-1, -1, -1]))
    # a point of this surface lies half-way between a foreground voxel and a background voxel
    mesh["inside"] = (mesh["distance"] < 0.51).astype(np.float32)
    return list(mesh.clip_scalar(scalars="inside", value=0.5, invert=False, both=True))


def _iso_surface(flat_map: FlatMap, field: NDArray[np.float32], level: float, first: NDArray[Any]) -> pyvista.PolyData:
    """Return where a field has a level, as a smooth surface in RAS+ mm with the error of the nearest point in %.

    `first` has the voxel indices of the field's first voxel. `distance` is that to the nearest point, in voxels.
    """
    import pyvista

    grid = pyvista.ImageData(dimensions=field.shape, origin=first)
    grid["field"] = field.ravel(order="F")
    mesh = grid.contour([level], "field")
    mesh["distance"], nearest = cKDTree(flat_map.ids).query(mesh.points)
    mesh["error"] = 100 * flat_map.distortion.per_point[nearest]
    mesh.transform(flat_map.affine, inplace=True)
    smooth: pyvista.PolyData = mesh.smooth_taubin(n_iter=30, pass_band=0.05).compute_normals(cell_normals=False)
    return smooth


def _look_from_outside(plotter: pyvista.Plotter, flat_map: FlatMap) -> None:
    """Point the camera at the patch against its mean normal, superior up, as near as it fits.

    What was closed has no such side: it is seen from the left if it lies on the left, else from the right.
    """
    a, b, c = (flat_map.points[flat_map.faces[~flat_map.torn, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    outward = normals.sum(axis=0)
    if np.linalg.norm(outward) < _CLOSED * np.linalg.norm(normals, axis=1).sum():
        outward = np.array([-1.0 if flat_map.points[:, 0].mean() < 0 else 1.0, 0.0, 0.0])
    outward = _unit(outward)
    superior = (0, 0, 1) if abs(outward[2]) < 0.9 else (0, 1, 0)
    right = _unit(np.cross(superior, outward))
    axes = np.stack([right, np.cross(outward, right), outward])
    seen = flat_map.points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height, depth = high - low
    pixels = plotter.window_size
    camera = plotter.camera
    camera.focal_point = axes.T @ (low + high) / 2
    camera.position = np.asarray(camera.focal_point) + (width + height + depth) * outward
    camera.up = axes[1]
    camera.parallel_projection = True
    camera.parallel_scale = 0.58 * max(height, width * pixels[1] / pixels[0])  # half of what is seen of the height
    plotter.reset_camera_clipping_range()


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vector)
    return np.asarray(vector / length if length > 0 else (0.0, -1.0, 0.0))  # nothing to see: from the front, then


def _beside_colour_bar(scene: NDArray[np.uint8], width: int, top: float) -> NDArray[np.uint8]:
    """Return a picture with a scene on its left and the colours of the errors on its right."""
    height = scene.shape[0]
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    share = scene.shape[1] / width
    axes = figure.add_axes((0, 0, share, 1))
    axes.imshow(scene, interpolation="none", aspect="auto")
    axes.set_axis_off()
    colours = ScalarMappable(Normalize(0, top), _ERRORS)
    bar = figure.add_axes((share + 0.015, 0.1, 0.03, 0.8))
    figure.colorbar(colours, cax=bar, label=_ERROR_LABEL, extend="max")
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
