"""Draw surfaces in 3-D with PyVista: `patch_3d` draws maps, and `atlas_3d` draws atlases."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from voxflat.arguments import checked_instance, checked_pixels, numbers_of, shown
from voxflat.atlases.pieces import FlatPieces
from voxflat.errors import InputError
from voxflat.figures.colours import ERROR_LABEL, ERRORS, patch_colours, top_error
from voxflat.figures.names import plain
from voxflat.figures.page import pixels_of
from voxflat.io.files import installing
from voxflat.io.sources import volume_of
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import surface
from voxflat.surfaces.foreground import foreground
from voxflat.surfaces.manifold import are_triangles

if TYPE_CHECKING:  # imported only when something is drawn
    import pyvista

_CLOSED = 0.05  # share of the total area below which the summed normals mean a closed surface
_SAME_PLACE = 1e-3  # mm
_SURROUNDINGS = "#d8d8d4"
_DPI = 200
_SCENE = 0.87  # share of the image width for the scene; the rest is for the colour bar


def patch_3d(
    flat_map: FlatMap, whole: object | None = None, *, size: tuple[int, int] = (1200, 1000)
) -> NDArray[np.uint8]:
    """Draw the surface patch in 3-D, in the colours of `heat_map`.

    The view is from outside, with superior at the top.

    Parameters
    ----------
    flat_map : FlatMap
        A flat map.
    whole : path, ndarray, image object, Volume, (points, faces), Mesh, pyvista.PolyData or Surface, optional
        The volume or mesh that was flattened. Its surface is drawn in grey around the patch.
    size : tuple of 2 ints
        Width and height in pixels.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        An image for `save_picture`.

    Raises
    ------
    InputError
        If PyVista is missing or cannot draw, or if the map was not made from the volume or mesh.

    See Also
    --------
    heat_map : Draw the errors on the map.

    Examples
    --------
    >>> flat_map = voxflat.samples.hill().flatten()
    >>> voxflat.figures.patch_3d(flat_map, size=(200, 150)).shape
    (150, 200, 3)
    """
    checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    if not isinstance(size, Sequence) or isinstance(size, str) or len(size) != 2:
        raise InputError(f"size is {shown(size)}. Pass the width and height in pixels")
    width, height = (checked_pixels(side, "size") for side in size)
    pyvista = load_pyvista()
    if flat_map.is_voxels:
        patch, *around = [_patch_alone(flat_map)] if whole is None else _patch_in_place(flat_map, whole)
    else:
        patch, *around = _patch_of_mesh(pyvista, flat_map, whole)
    highest = top_error(flat_map)
    material = {"smooth_shading": True, "ambient": 0.35, "diffuse": 0.8, "specular": 0.0, "show_scalar_bar": False}
    coloured = {"scalars": "error", "cmap": ERRORS, "clim": (0, highest), **material}
    meshes = [(patch, coloured), *((mesh, {"color": _SURROUNDINGS, **material}) for mesh in around)]
    window = (round(_SCENE * width), height)
    scene = _drawn(pyvista, meshes, window, lambda plotter: _look_from_outside(plotter, flat_map))
    return _beside_colour_bar(scene, width, highest)


def atlas_3d(atlas: FlatPieces, *, towards: ArrayLike = (0.6, -1.0, 0.5), size: int = 1000) -> NDArray[np.uint8]:
    """Draw the surface of an atlas with its patches in colours.

    PyVista draws the image, or Matplotlib if PyVista is missing.

    Parameters
    ----------
    atlas : Atlas
        An atlas of patches, or a glued atlas.
    towards : sequence of 3 floats
        The direction from the surface to the viewer, in RAS+.
    size : int
        Width and height in pixels.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        An image for `save_picture`.

    Raises
    ------
    InputError
        If `towards` is not a direction.

    See Also
    --------
    atlas_page : Draw the patches in the plane.

    Examples
    --------
    >>> atlas = voxflat.samples.hill().patches(max_angle=20)
    >>> voxflat.figures.atlas_3d(atlas, size=200).shape
    (200, 200, 3)
    """
    checked_instance(atlas, FlatPieces, "atlas", "an atlas")
    checked_pixels(size, "size")
    direction = numbers_of(towards, "coordinates of towards")
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise InputError(f"towards is {shown(towards)}. Pass a direction of three numbers that are not all 0")
    colours = patch_colours(atlas)
    try:
        pyvista = load_pyvista()
    except InputError:
        return _by_matplotlib(atlas, colours, direction, size)
    mesh = pyvista.PolyData.from_regular_faces(atlas.points, atlas.faces)
    mesh.cell_data["colours"] = colours
    meshes = [(mesh, {"scalars": "colours", "rgb": True, "ambient": 0.35, "diffuse": 0.75, "specular": 0.0})]
    return _drawn(pyvista, meshes, (size, size), lambda plotter: plotter.view_vector(direction, _up(direction)))


def drawn_from_both_sides(
    flat_map: FlatMap,
    meshes: Sequence[tuple[Any, dict[str, Any]]],
    names: Sequence[tuple[NDArray[np.float64], str]],
    size: tuple[int, int],
) -> NDArray[np.uint8]:
    """Draw meshes from two opposite sides, with names at their points; names of hidden points are in parentheses."""
    pyvista = load_pyvista()
    width, height = size
    extent = float(np.linalg.norm(np.ptp(flat_map.points, axis=0)))
    written: dict[str, tuple[float, float, str]] = {}  # position in pixels of the image, and text

    def look(plotter: Any, turned: bool) -> None:
        _look_from_outside(plotter, flat_map)
        camera = plotter.camera
        if turned:
            camera.azimuth = 180
            plotter.reset_camera_clipping_range()
        towards = _unit(np.asarray(camera.position) - np.asarray(camera.focal_point))
        right, pixels = np.cross(camera.up, towards), height / 2 / camera.parallel_scale
        for point, name in names:
            hits, _ = meshes[0][0].ray_trace(point + 0.004 * extent * towards, point + 2 * extent * towards)
            is_hidden = len(hits) > 0
            from_middle = point - np.asarray(camera.focal_point)
            if not is_hidden or (from_middle @ towards >= 0 and name not in written):
                across, up = (from_middle @ axis * pixels for axis in (right, camera.up))
                x = width // 2 * (0.5 + turned) + across
                written[name] = (x, height / 2 - up, f"({name})" if is_hidden else name)

    def view(turned: bool) -> NDArray[np.uint8]:
        return _drawn(pyvista, meshes, (width // 2, height), lambda plotter: look(plotter, turned))

    picture = np.concatenate([view(False), view(True)], axis=1)
    figure = Figure(figsize=(picture.shape[1] / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(picture, interpolation="none", aspect="auto")
    axes.set_axis_off()
    for x, y, name in written.values():
        above = -0.03 * height if y > 0.1 * height else 0.03 * height
        text = axes.text(x, y + above, plain(name, 80), ha="center", va="center", size=9, weight="bold")
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
    return pixels_of(figure)[..., :3]


def load_pyvista() -> Any:
    """Import PyVista; raise an error if it is missing, or if an old VTK would end the process for lack of a display."""
    try:
        import pyvista
    except ImportError as error:
        raise InputError(f"3-D images require PyVista. Run {installing('pyvista')}") from error
    if sys.platform == "linux" and "DISPLAY" not in os.environ and pyvista.vtk_version_info < (9, 4):
        raise InputError("this version of VTK requires a display. Run under xvfb-run, or install VTK 9.4 or later")
    return pyvista


def _drawn(
    pyvista: Any, meshes: Sequence[tuple[Any, dict[str, Any]]], window: tuple[int, int], look: Callable[[Any], None]
) -> NDArray[np.uint8]:
    """Draw meshes with their materials; `look` places the camera."""
    with pyvista.vtk_verbosity("error"):  # VTK warns if there is no display, but draws anyway
        plotter = pyvista.Plotter(off_screen=True, window_size=list(window), theme=pyvista.themes.DocumentTheme())
        try:
            for mesh, material in meshes:
                plotter.add_mesh(mesh, **material)
            look(plotter)
            plotter.enable_anti_aliasing("ssaa")
            pixels: NDArray[np.uint8] = np.asarray(plotter.screenshot(return_img=True))[..., :3].copy()
            return pixels
        finally:
            plotter.close()


def _up(direction: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the direction that is up in a view: superior, or anterior if the view is from above or below."""
    return (0.0, 1.0, 0.0) if abs(direction[2]) > 0.9 * np.linalg.norm(direction) else (0.0, 0.0, 1.0)


def _by_matplotlib(
    atlas: FlatPieces, colours: NDArray[np.uint8], direction: NDArray[np.float64], size: int
) -> NDArray[np.uint8]:
    """Draw the triangles with Matplotlib, from the farthest to the nearest."""
    direction = direction / np.linalg.norm(direction)
    right = np.cross(_up(direction), direction)
    axes_of_view = np.stack([right / np.linalg.norm(right), np.cross(direction, right) / np.linalg.norm(right)])
    corners = atlas.points[atlas.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = normals @ direction / np.linalg.norm(normals, axis=1)
    order = np.argsort((corners.mean(axis=1) @ direction), kind="stable")
    shade = (0.35 + 0.65 * np.abs(facing))[:, None] * colours / 255
    figure = Figure(figsize=(size / 100, size / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), aspect="equal")
    places, shade = corners[order] @ axes_of_view.T, shade[order]
    axes.add_collection(PolyCollection(places, facecolor=shade, edgecolor=shade, linewidth=0.2))
    axes.autoscale()
    axes.set_axis_off()
    return pixels_of(figure)[..., :3]


def _patch_alone(flat_map: FlatMap) -> pyvista.PolyData:
    """Return a smooth surface around the voxels of the patch, because the triangles of a torn map have holes."""
    low, high = flat_map.ids.min(axis=0) - 3, flat_map.ids.max(axis=0) + 3
    field = np.zeros(high - low + 1, dtype=np.float32)
    field[tuple((flat_map.ids - low).T)] = 1
    return _iso_surface(flat_map, gaussian_filter(field, 1.0), 0.2, low)


def _patch_in_place(flat_map: FlatMap, volume: object) -> list[pyvista.PolyData]:
    """Return the patch and the surface around it, both made from the boundary between foreground and background."""
    data = volume_of(volume).data
    if data.shape != flat_map.volume_shape:
        made_from = f"the map was made from a volume of shape {flat_map.volume_shape}"
        raise InputError(f"the volume has shape {data.shape}, but {made_from}. Pass the volume that was flattened")
    origin = flat_map.origin.voxels
    mask = foreground(data, label=origin.label, threshold=origin.threshold)
    if not mask[tuple(flat_map.ids.T)].all():
        raise InputError(
            "some points of the map are not in the foreground of this volume. Pass the volume that was flattened"
        )
    mesh = _iso_surface(flat_map, np.pad(mask, 1).astype(np.float32), 0.5, np.array([-1, -1, -1]))
    # a point of this surface lies half-way between a foreground voxel and a background voxel
    mesh["inside"] = (mesh["distance"] < 0.51).astype(np.float32)
    return list(mesh.clip_scalar(scalars="inside", value=0.5, invert=False, both=True))


def _patch_of_mesh(pyvista: Any, flat_map: FlatMap, whole: object | None) -> list[pyvista.PolyData]:
    """Return the triangles of the map on the surface, and the triangles of the mesh around them."""
    faces = flat_map.faces[~flat_map.torn].astype(np.int64)
    patch = pyvista.PolyData.from_regular_faces(flat_map.points, faces)
    patch["error"] = 100 * flat_map.distortion.per_point
    if whole is None:
        return [patch]
    mesh = surface(whole)
    if mesh.is_voxels or mesh.count != flat_map.origin.mesh.vertices:
        made_from = f"the map was made from a mesh with {flat_map.origin.mesh.vertices} vertices"
        raise InputError(f"the mesh has {mesh.count} vertices, but {made_from}. Pass the mesh that was flattened")
    place = np.full((mesh.count, 3), np.nan)
    place[mesh.ids] = mesh.points
    place[mesh.merged[:, 0]] = place[mesh.merged[:, 1]]
    apart = np.abs(place[flat_map.ids] - flat_map.points).max()
    if not apart <= _SAME_PLACE:
        raise InputError(
            f"the mesh is up to {apart:.3g} mm away from the points of the map. Pass the mesh that was flattened, "
            "together with its pial surface if it had one"
        )
    is_around = ~are_triangles(mesh.ids[mesh.faces], flat_map.ids[faces])
    if not is_around.any():
        return [patch]
    around = mesh.faces[is_around].astype(np.int64)
    return [patch, pyvista.PolyData.from_regular_faces(mesh.points, around).clean()]


def _iso_surface(flat_map: FlatMap, field: NDArray[np.float32], level: float, first: NDArray[Any]) -> pyvista.PolyData:
    """Return the smooth iso-surface (RAS+ mm) of a field whose first voxel is `first`, with errors of points in %."""
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
    """Point the camera at the patch along its mean normal, with superior up; view a closed surface from its side."""
    a, b, c = (flat_map.points[flat_map.faces[~flat_map.torn, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    outward = normals.sum(axis=0)
    if np.linalg.norm(outward) < _CLOSED * np.linalg.norm(normals, axis=1).sum():
        outward = np.array([-1.0 if flat_map.points[:, 0].mean() < 0 else 1.0, 0.0, 0.0])
    outward = _unit(outward)
    right = _unit(np.cross(_up(outward), outward))
    axes = np.stack([right, np.cross(outward, right), outward])
    seen = flat_map.points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height, depth = high - low
    pixels, camera = plotter.window_size, plotter.camera
    camera.focal_point = axes.T @ (low + high) / 2
    camera.position = np.asarray(camera.focal_point) + (width + height + depth) * outward
    camera.up = axes[1]
    camera.parallel_projection = True
    camera.parallel_scale = 0.58 * max(height, width * pixels[1] / pixels[0])  # half the visible height
    plotter.reset_camera_clipping_range()


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vector)
    return np.asarray(vector / length if length > 0 else (0.0, -1.0, 0.0))  # no direction: use the front


def _beside_colour_bar(scene: NDArray[np.uint8], width: int, highest: float) -> NDArray[np.uint8]:
    """Return an image with the scene on the left and the colour bar of errors on the right."""
    height = scene.shape[0]
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    share = scene.shape[1] / width
    axes = figure.add_axes((0, 0, share, 1))
    axes.imshow(scene, interpolation="none", aspect="auto")
    axes.set_axis_off()
    colours = ScalarMappable(Normalize(0, highest), ERRORS)
    bar = figure.add_axes((share - 0.02, 0.1, 0.03, 0.8))  # within the margin of the scene
    figure.colorbar(colours, cax=bar, label=ERROR_LABEL, extend="max")
    return pixels_of(figure)[..., :3]
