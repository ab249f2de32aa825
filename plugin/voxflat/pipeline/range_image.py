"""Range images, which record depth on a grid as scanners do, and the surfaces that they describe."""

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from voxflat import _core
from voxflat.arguments import array_of, as_float, is_number, shown
from voxflat.errors import InputError
from voxflat.io.grid import FARTHEST, SMALLEST
from voxflat.io.origin import MeshOrigin, PixelGrid
from voxflat.io.provenance import recording
from voxflat.pipeline.surface import Surface

_JUMP = 8.0  # pixels: a slope of 83 degrees


@recording()
def range_image(
    depth: ArrayLike, spacing: float | Sequence[float], mask: ArrayLike | None = None, *, jump: float | None = None
) -> Surface:
    """Make a surface from a range image, in which every pixel with a depth is a vertex.

    Columns run along x, rows along −y and depth along z, so the surface is seen from +z.

    Parameters
    ----------
    depth : array_like, shape (H, W)
        Height towards the viewer, in mm, or NaN where there is no surface. For distances from a camera, pass their
        negative.
    spacing : float or sequence of 2 floats
        Distance between rows and between columns, in mm.
    mask : array_like of bool, shape (H, W), optional
        True where there is a surface.
    jump : float, optional
        Largest depth difference within a triangle, in mm. The surface is cut at larger differences, where one
        object hides another. The default is 8 times the larger spacing, which corresponds to a slope of 83 degrees.

    Returns
    -------
    Surface
        The pixel of each vertex is ``np.unravel_index(s.ids, depth.shape)``. ``metadata["range_image"]`` holds the
        grid, the limit ``jump`` (None for no limit) and the number of triangles that were ``cut``, which a warning also
        reports.

    Raises
    ------
    InputError
        If `depth` is not an image, contains infinite values (the message names a pixel), or leaves no triangle.

    See Also
    --------
    surface : Make a surface from a volume or a mesh.

    Examples
    --------
    >>> heights = np.add.outer(np.arange(20.0), np.zeros(30))
    >>> voxflat.range_image(heights, spacing=1.0)
    <Surface from a mesh: 600 vertices, 1102 triangles>
    """
    heights = _heights(depth, mask)
    steps = _steps(spacing)
    limit = _JUMP * max(steps) if jump is None else jump
    if not is_number(limit) or not limit > 0:
        raise InputError(f"jump is {shown(jump)} mm. Pass a positive depth difference, or np.inf for no limit")
    limit = as_float(limit)
    is_there = np.isfinite(heights)
    faces = _faces(heights)
    inside = is_there.ravel()[faces].all(axis=1)
    if not inside.any():
        raise InputError(
            f"no triangle of the range image has a depth at all three corners ({int(is_there.sum())} of {heights.size} "
            "pixels have a depth). Pass an image in which pixels with a depth are adjacent"
        )
    corners = np.where(is_there, heights, 0.0).ravel()[faces]
    is_kept = inside & (np.ptp(corners, axis=1) <= limit)
    cut = int(inside.sum() - is_kept.sum())
    if not is_kept.any():
        raise InputError(f"every triangle spans more than {limit:g} mm of depth. Increase jump, or check the units")
    warnings = []
    if cut:
        warnings.append(
            f"the surface was cut at {cut} of {int(inside.sum())} triangles, which span more than {limit:g} mm of "
            "depth. Set jump to change this limit"
        )
    points = _points(np.where(is_there, heights, 0.0), steps)
    core, _ = _core.Surface.from_triangles(points, faces)
    digest = hashlib.sha256(np.ascontiguousarray(heights).tobytes() + repr((heights.shape, steps, limit)).encode())
    rows, columns = heights.shape
    origin = MeshOrigin(
        input_sha256=digest.hexdigest(),
        vertices=heights.size,
        measured_on="the given range image",
        grid=PixelGrid((rows, columns), steps),
    )
    details: dict[str, object] = {
        "range_image": {
            "shape": list(heights.shape),
            "spacing": list(steps),
            "jump": float(limit) if np.isfinite(limit) else None,
            "cut": cut,
        },
    }
    return Surface(core.part_of_faces(is_kept), None, origin, details, tuple(warnings))


def _heights(depth: ArrayLike, mask: ArrayLike | None) -> NDArray[np.float64]:
    """Return depths as floats, with NaN where there is no surface."""
    if isinstance(depth, np.ma.MaskedArray):
        depth = np.ma.filled(depth.astype(np.float64), np.nan)
    try:
        depths = array_of(depth, "depths")
    except ValueError:
        raise InputError("the rows of depth have different lengths. Pass an array of shape (H, W)") from None
    if depths.ndim != 2 or min(depths.shape) < 2:
        raise InputError(f"depth has shape {depths.shape}. Pass an array of shape (H, W) with at least 2 x 2 pixels")
    if depths.dtype.kind not in "uif":
        raise InputError(f"depth has data type {depths.dtype}. Pass real numbers, in mm")
    heights = depths.astype(np.float64)
    if mask is not None:
        there = array_of(mask, "values of the mask")
        if there.shape != heights.shape:
            raise InputError(f"the shapes of mask {there.shape} and depth {heights.shape} differ. Pass equal shapes")
        if there.dtype.kind not in "buif" or not np.isin(there, (0, 1)).all():
            raise InputError(f"mask ({there.dtype}) has values other than 0 and 1. Pass True where there is a surface")
        heights[there == 0] = np.nan
    bad = np.abs(heights) > FARTHEST  # False for NaN
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"depth at row {row}, column {column} is {heights[row, column]:g} mm. Pass NaN where there is no surface, "
            f"and depths of at most {FARTHEST:g} mm elsewhere"
        )
    return heights


def _steps(spacing: float | Sequence[float]) -> tuple[float, float]:
    """Return the distances between rows and between columns."""
    steps = array_of(spacing, "spacings")
    if steps.dtype.kind not in "uif" or steps.shape not in ((), (2,)):
        raise InputError(f"spacing is {shown(spacing)}. Pass one number, or one for rows and one for columns, in mm")
    rows, columns = (float(step) for step in np.broadcast_to(steps, 2))
    if not (min(rows, columns) >= SMALLEST and max(rows, columns) <= FARTHEST):  # NaN fails both tests
        raise InputError(f"spacing is {shown(spacing)} mm. Pass numbers from {SMALLEST:g} to {FARTHEST:g} mm")
    return rows, columns


def _faces(heights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Split each square of pixels along its shorter diagonal; a diagonal to a pixel without depth counts as longer."""
    reached = np.where(np.isnan(heights), np.inf, heights)
    a, b, c, d = reached[:-1, :-1], reached[1:, :-1], reached[1:, 1:], reached[:-1, 1:]  # counterclockwise from +z
    with np.errstate(invalid="ignore"):
        along_ac = ~(np.abs(a - c) > np.abs(b - d))
    number = np.arange(heights.size).reshape(heights.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    first = np.where(along_ac[..., None], np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(along_ac[..., None], np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    return np.stack([first, second], axis=2).reshape(-1, 3)


def _points(heights: NDArray[np.float64], steps: tuple[float, float]) -> NDArray[np.float64]:
    row, column = np.indices(heights.shape)
    return np.stack([column * steps[1], -row * steps[0], heights], axis=-1).reshape(-1, 3)
