"""Real anatomy as label volumes, from data included in nilearn: nothing is downloaded.

The volumes are the white matter of fsaverage5 at any spacing, and of the MNI152 template at 1 mm: labels, and the
fraction of each voxel that is white matter. Benchmarks and tests import the functions.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull

from voxflat import _core, demo

SIDES = ("left", "right")
SPACINGS = (1.0, 0.7, 0.5)

JITTER = (3.1e-8, 4.7e-8)  # offset of columns, voxels: meshes often have vertices and edges at round coordinates
BATCH = 1 << 20  # pairs of a triangle and a column that are tested at a time


def fsaverage5_file(kind, side):
    if side not in SIDES:
        raise ValueError(f"side is {side!r}; give 'left' or 'right'")
    return Path(find_spec("nilearn").origin).parent / "datasets" / "data" / "fsaverage5" / f"{kind}_{side}.gii.gz"


def fsaverage5(side):
    """Load a hemisphere of fsaverage5, 10,242 vertices, the same in all surfaces, mm, RAS.

    ``mid`` lies halfway between ``white`` and ``pial``; ``faces`` are closed, of genus 0, and oriented outwards.
    ``flat`` is FreeSurfer's flat map: points at z = 0, NaN where it omits the medial wall and the cuts, and its faces.
    """
    import nibabel

    def arrays(kind):
        return [array.data for array in nibabel.load(fsaverage5_file(kind, side)).darrays]

    (white, faces), (pial, _), (flat, flat_faces) = arrays("white"), arrays("pial"), arrays("flat")
    (sulc,) = arrays("sulc")
    white, pial, flat = white.astype(float), pial.astype(float), flat.astype(float)
    flat[np.setdiff1d(np.arange(len(flat)), flat_faces)] = np.nan  # the file has points in space there
    return {
        "white": white,
        "pial": pial,
        "mid": (white + pial) / 2,
        "sphere": arrays("sphere")[0].astype(float),
        "faces": faces.astype(np.int64),
        "flat": (flat, flat_faces.astype(np.int64)),
        "sulc": sulc.astype(float),
    }


def mni152_white_matter(side):
    """Load the white matter of a hemisphere from the MNI152 template.

    The hemispheres are separated at x = 0 mm. The brain stem is cut in the slice z = -14 mm, so that the lower stem and
    the cerebellum are not in the largest component. Unlike in `voxflat.hemisphere`, ventricles and deep nuclei stay
    open.

    Returns labels, uint8, with voxels of 1 mm; their affine; and the template, which is 0 where it is above the
    threshold but not in the labels.
    """
    if side not in SIDES:
        raise ValueError(f"side is {side!r}; give 'left' or 'right'")
    white_matter, _, _ = demo.demo_cortex()
    affine, white = white_matter.affine, white_matter.data > demo.THRESHOLD
    x, y, z = (affine[axis, 3] + affine[axis, axis] * np.arange(length) for axis, length in enumerate(white.shape))
    white[x >= 0 if side == "left" else x <= 0] = False
    white[np.ix_(np.abs(x) <= 20, (y > -45) & (y < 0), z == -14)] = False
    labels = largest_component(white).astype(np.uint8)
    probability = np.where((white_matter.data > demo.THRESHOLD) & (labels == 0), 0, white_matter.data)
    return labels, white_matter.affine, probability


def mni152_marching_cubes(side):
    """Return the smoothed marching cubes of the repaired white matter of a hemisphere of the MNI152 template."""
    import pyvista as pv

    labels, affine, _ = mni152_white_matter(side)
    mask, _ = _core.repair(labels.astype(bool), [1.0] * 3)
    grid = pv.ImageData(dimensions=mask.shape)
    grid.point_data["white matter"] = mask.astype(np.float32).ravel(order="F")
    mesh = grid.contour([0.5], scalars="white matter", method="marching_cubes").clean().smooth_taubin()
    points = mesh.points.astype(float) @ affine[:3, :3].T + affine[:3, 3]
    return points, mesh.regular_faces.astype(np.int64)


def voxelise(points, faces, spacing, pad=4, columns=5):
    """Voxelise a closed triangle mesh, mm, with a margin of `pad` voxels.

    A point is inside if its winding number is positive, so overlapping parts are inside, and a part that is inside out
    is subtracted. All faces may point outwards or all inwards. Winding numbers are counted along lines parallel to the
    third axis, `columns`² lines per voxel.

    Returns the largest component of the voxels whose centre is inside, uint8; the affine; and the fraction of each
    voxel that is inside any component, exact along the third axis and sampled along the other two.
    """
    points, faces = np.asarray(points, dtype=float), np.asarray(faces, dtype=np.int64)
    spacing = np.broadcast_to(np.asarray(spacing, dtype=float), 3)
    if columns < 1 or columns % 2 == 0:
        raise ValueError(f"columns is {columns}; give an odd number, so that a line passes through each voxel's centre")
    origin = points.min(axis=0) - pad * spacing
    places = (points - origin) / spacing
    shape = tuple(np.ceil(places.max(axis=0)).astype(int) + pad + 1)

    a, b, c = places[faces].transpose(1, 0, 2)
    if np.einsum("ij,ij->", np.cross(a, b), c) < 0:
        faces = faces[:, ::-1]
    # columns 0, 1, ... along an axis are at -1/2 + 1/(2 columns), + 1/columns, ..., where voxel centres are integers
    fine = np.column_stack([(places[:, :2] - JITTER + 0.5) * columns - 0.5, places[:, 2]])
    i, j, height, step = transitions(*crossings(fine, faces))
    voxel = (i // columns, j // columns)

    central = (i % columns == columns // 2) & (j % columns == columns // 2)
    begins = np.ceil(height[central]).astype(int)
    inside = np.cumsum(scatter(shape, (voxel[0][central], voxel[1][central], begins), step[central]), axis=2) > 0.5

    # the part below a height fills its own voxel partly and those below it completely
    layer = np.floor(height + 0.5).astype(int)
    voxel = (*voxel, layer)
    own = scatter(shape, voxel, -step * (height + 0.5 - layer))
    whole = scatter(shape, voxel, -step)
    below = np.cumsum(whole[:, :, ::-1], axis=2)[:, :, ::-1] - whole
    fraction = np.clip((own + below) / columns**2, 0, 1).astype(np.float32)

    affine = np.diag([*spacing, 1.0])
    affine[:3, 3] = origin
    return largest_component(inside).astype(np.uint8), affine, fraction


def crossings(points, faces):
    """Find where lines along the third axis at integer first and second coordinates intersect triangles.

    The side of an edge on which a line lies is computed from the ends of the edge in the order of their coordinates,
    and therefore identically for both triangles: a line near an edge intersects exactly one of them, despite rounding.
    Returns i and j of the line, the height, and 1 where it enters, going up, a solid with outward faces, or -1 where it
    leaves it.
    """
    points, rank = np.unique(points, axis=0, return_inverse=True)
    faces = rank.reshape(-1)[faces]
    corners = points[faces]
    low = np.ceil(corners[:, :, :2].min(axis=1)).astype(int)
    extent = np.floor(corners[:, :, :2].max(axis=1)).astype(int) - low + 1
    counts = extent.prod(axis=1)
    a, b, c = corners.transpose(1, 2, 0)
    turn = cross(b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1])
    found = []
    hit = np.flatnonzero((counts > 0) & (turn != 0))
    batches = np.cumsum(counts[hit]) // BATCH
    for batch in np.split(hit, np.flatnonzero(np.diff(batches)) + 1):
        face = np.repeat(batch, counts[batch])
        number = np.arange(len(face)) - np.repeat(np.cumsum(counts[batch]) - counts[batch], counts[batch])
        i = low[face, 0] + number // extent[face, 1]
        j = low[face, 1] + number % extent[face, 1]
        lefts = np.zeros(len(face), dtype=np.int8)  # number of edges that have the line on their left
        for edge in range(3):
            start, end = faces[face, edge], faces[face, (edge + 1) % 3]
            first, last = points[np.minimum(start, end)], points[np.maximum(start, end)]
            left = cross(last[:, 0] - first[:, 0], last[:, 1] - first[:, 1], i - first[:, 0], j - first[:, 1]) > 0
            lefts += left ^ (start > end)
        inside = (lefts == 0) | (lefts == 3)
        face, i, j, sign = face[inside], i[inside], j[inside], np.where(lefts[inside] == 0, 1, -1)
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (corner[:, face] for corner in (a, b, c))
        u = cross(i - ax, j - ay, cx - ax, cy - ay) / turn[face]
        v = cross(bx - ax, by - ay, i - ax, j - ay) / turn[face]
        found.append((i, j, az + u * (bz - az) + v * (cz - az), sign))
    if not found:
        raise ValueError("no line intersects the mesh; give a smaller spacing")
    return tuple(map(np.concatenate, zip(*found, strict=True)))


def cross(ax, ay, bx, by):
    """Return the cross product in the plane, positive if b lies to the left of a."""
    return ax * by - ay * bx


def transitions(i, j, height, sign):
    """Keep the crossings at which the winding number becomes positive (step 1) or stops being so (step -1)."""
    order = np.lexsort([height, j, i])
    i, j, height, sign = i[order], j[order], height[order], sign[order]
    ends = np.append((np.diff(i) != 0) | (np.diff(j) != 0), True)
    after = np.cumsum(sign)
    if (after[ends] != 0).any():
        raise ValueError(f"{np.count_nonzero(after[ends])} lines enter the mesh without leaving it; give a closed mesh")
    step = (after > 0).astype(int) - (after - sign > 0)
    kept = step != 0
    return i[kept], j[kept], height[kept], step[kept]


def scatter(shape, voxel, values):
    return np.bincount(np.ravel_multi_index(voxel, shape), values, np.prod(shape)).reshape(shape)


def largest_component(mask):
    """Return the largest component under face adjacency."""
    components, _ = ndimage.label(mask)
    sizes = np.bincount(components.ravel())
    sizes[0] = 0
    return (components == sizes.argmax()) & mask


def border(faces):
    """Return the edges that belong to a single triangle, int (E, 2)."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(ends, axis=0, return_counts=True)
    return edges[counts == 1]


def outward_hull(points):
    """Return the triangles of the convex hull of points around the origin, oriented outwards."""
    faces = ConvexHull(points).simplices.astype(np.int64)
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces
