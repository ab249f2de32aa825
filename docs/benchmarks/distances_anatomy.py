"""Accuracy on voxels of a cortex, compared with exact distances on the voxelised mesh.

Each vertex of the voxel surface corresponds to the nearest point of the mesh. These points are inserted into the mesh
as vertices by dividing their faces, which does not change the surface. Exact distances are measured between them, so
the figures contain no error of looking up the nearest vertex.
"""

import anatomy
import distances_solvers as solvers
import numpy as np
import pyvista as pv
from scipy.spatial import Delaunay
from tables import judged, table

import voxflat
from voxflat import _core

BANDS = ((5, 15), (15, 50), (50, 150))
LIMITS = {1.0: (1.4, 1.0, 0.7), 0.7: (1.2, 0.7, 0.5), 0.5: (None, None, None)}
MOST_BIAS = 0.5
MOST_SHORT = 10  # pairs in a million that may be underestimated by more than 20 %
INSIDE = 1e-3  # distance of points from the edges of their faces, in barycentric coordinates (some micrometres)
SHORT = "too short by > 20 %, in a million"
LINKS = {"chain-code": "26 neighbours, chain code (the paper)", "euclidean": "26 neighbours, 1, √2, √3"}


def voxels(options):
    """Compare all estimators on voxelised white surfaces."""
    rows, notes = [], []
    for spacing in options.spacings:
        gathered = {}
        for side in options.sides:
            for name, found, true in of_hemisphere(side, spacing, options, notes):
                gathered.setdefault(name, []).append((found, true))
        for name, parts in gathered.items():
            found, true = (np.concatenate(part) for part in zip(*parts, strict=True))
            rows.append([f"{spacing} mm", name, *cells(spacing, name, found / true - 1, true)])
    table(
        "Voxels of a cortex: mean absolute error (bias), %, by true distance",
        ["voxels", "estimator", *(f"{low}-{high} mm" for low, high in BANDS), "bias beyond 15 mm, %", SHORT],
        rows,
        f"White surfaces of fsaverage5, {' and '.join(options.sides)}; {options.voxel_sources} sources and"
        f" {options.targets:,} targets per hemisphere. " + " ".join(notes),
    )


def cells(spacing, name, relative, true):
    ours = name in {f"voxflat {geodesic}" for geodesic in solvers.OURS}
    what = f"{spacing} mm, {name}"
    texts = []
    for (low, high), limit in zip(BANDS, LIMITS[spacing], strict=True):
        part = 100 * relative[(true >= low) & (true < high)]
        mean = judged(np.abs(part).mean(), ".2f", limit if ours else None, f"{what}, {low}-{high} mm, %")
        texts.append(f"{mean} ({part.mean():+.2f})")
    bias = 100 * relative[true >= BANDS[1][0]].mean()
    short = 1e6 * np.mean(relative[true >= BANDS[0][0]] < -0.2)
    return [
        *texts,
        judged(abs(bias), ".2f", MOST_BIAS if ours else None, f"{what}, bias beyond 15 mm, %"),
        judged(short, ".0f", MOST_SHORT if ours else None, f"{what}, {SHORT}"),
    ]


def of_hemisphere(side, spacing, options, notes):
    """Yield the name of each estimator, its distances, and the true distances."""
    mesh = anatomy.fsaverage5(side)
    labels, affine, fraction = anatomy.voxelise(mesh["white"], mesh["faces"], spacing)
    mask, _ = _core.repair(labels.astype(bool), [spacing] * 3)
    changed = np.count_nonzero(mask != labels.astype(bool))
    if changed:
        notes.append(f"{side} {spacing} mm: {changed} voxels were changed to remove handles.")
    surface = voxflat.surface(mask.astype(np.uint8), affine=affine)
    picked = np.random.default_rng(5).permutation(len(surface))
    picked = picked[: options.targets + options.voxel_sources]
    sources = picked[: options.voxel_sources]
    true, apart = true_rows(mesh, surface.points[picked], len(sources))
    notes.append(
        f"{side} {spacing} mm: {len(surface):,} vertices, {np.mean(apart):.3f} mm from the mesh on average,"
        f" {np.max(apart):.2f} mm at most."
    )
    for geodesic in solvers.OURS:
        found = surface.core.rows(sources.astype(np.uint32), geodesic=geodesic, threads=1)
        yield f"voxflat {geodesic}", found[:, picked].ravel(), true.ravel()
    for lengths, name in LINKS.items():
        chain = _core.VoxelSurface.from_mask(mask, affine.tolist(), lengths).cut_out()
        numbers = chain.find(surface.ids[picked])
        yield name, chain.rows(numbers[: len(sources)], 1)[:, numbers].ravel(), true.ravel()
    if spacing == max(options.spacings):
        level = voxflat.surface(mask.astype(np.uint8), affine=affine, probability=fraction)
        true, _ = true_rows(mesh, level.points[picked], len(sources))
        found = level.core.rows(sources.astype(np.uint32), geodesic="graph", threads=1)
        yield "voxflat graph, placed by volume fractions", found[:, picked].ravel(), true.ravel()


def true_rows(mesh, places, sources):
    """Return exact distances from the first points to all points, and the distance of each point from the mesh, mm."""
    points, faces = mesh["white"], mesh["faces"]
    cells = np.insert(faces, 0, 3, axis=1)
    face, nearest = pv.PolyData(points, cells).find_closest_cell(places, return_closest_point=True)
    points, faces, numbers = with_places(points, faces, face, nearest)
    true = solvers.ours(points, faces)(numbers[:sources], "exact")[:, numbers].astype(float)
    expected = solvers.exact(points, faces)(numbers[0])[numbers]
    np.testing.assert_allclose(true[0], expected, rtol=1e-6, atol=1e-9, err_msg="pygeodesic agrees")
    true[true < BANDS[0][0]] = np.nan  # excluded, like the source itself
    return true, np.linalg.norm(nearest - places, axis=1)


def with_places(points, faces, face, places):
    """Divide faces so that points in them become vertices; return the mesh and the vertex of each point."""
    a, b, c = points[faces[face]].swapaxes(0, 1)
    # barycentric coordinates by least squares; kept off the edges
    uv = np.einsum("nij,nj->ni", np.linalg.pinv(np.stack([b - a, c - a], axis=2)), places - a)
    weights = np.clip(np.column_stack([1 - uv.sum(axis=1), uv]), INSIDE, None)
    weights = np.round(weights / weights.sum(axis=1, keepdims=True), 9)
    added, which = np.unique(np.column_stack([face, weights[:, 1:]]), axis=0, return_inverse=True)
    owner, uv = added[:, 0].astype(int), added[:, 1:]
    a, b, c = points[faces[owner]].swapaxes(0, 1)
    new_points = a + uv[:, :1] * (b - a) + uv[:, 1:] * (c - a)
    divided = []
    for own in np.split(np.arange(len(added)), np.flatnonzero(np.diff(owner)) + 1):
        corners = np.concatenate([faces[owner[own[0]]], len(points) + own])
        plane = np.concatenate([[[0, 0], [1, 0], [0, 1]], uv[own]])
        triangles = Delaunay(plane).simplices
        assert len(triangles) == 2 * len(own) + 1, "all points are vertices"
        first, second, third = plane[triangles].swapaxes(0, 1)
        turned = np.linalg.det(np.stack([second - first, third - first], axis=1)) < 0
        triangles[turned] = triangles[turned][:, ::-1]
        divided.append(corners[triangles])
    kept = np.delete(faces, np.unique(owner), axis=0)
    more_points, more_faces = np.concatenate([points, new_points]), np.concatenate([kept, *divided])
    np.testing.assert_allclose(area(more_points, more_faces), area(points, faces), err_msg="the same surface")
    return more_points, more_faces, len(points) + which.reshape(-1)


def area(points, faces):
    a, b, c = points[faces].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
