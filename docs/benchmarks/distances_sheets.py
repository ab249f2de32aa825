"""Accuracy on voxels of shapes whose distances are known: curled sheets, balls, and flat maps of the sheets."""

import sys
from pathlib import Path

import distances_solvers as solvers
import numpy as np
from distances_tables import exponent, judged, table
from scipy.spatial.transform import Rotation

import voxflat
from voxflat import _core
from voxflat.surfaces.parts import largest_piece

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))

import shapes

TURNS = 0.9
WIDTHS = (49.0, 98.0, 165.0)
"""Of the sheets, voxels; they are twice as long: 4,000, 16,000 and 45,000 voxels."""

RADII = (20, 40, 80)
SOURCES = 8


def sheets(options):
    """Compare distances on curled sheets with the truth, at three sizes."""
    rows = []
    means = {}
    for width in WIDTHS:
        sizes, gathered = [], {}
        for number in range(options.orientations):
            volume, surface, plane = curled_sheet(width, number)
            sizes.append(len(surface))
            sources = np.random.default_rng(number).choice(len(surface), SOURCES, replace=False)
            true = np.linalg.norm(plane[sources, None] - plane[None], axis=2)
            apart = true > 0
            for name, found in estimates(volume, surface, sources):
                gathered.setdefault(name, []).append(found[apart] / true[apart] - 1)
        for name, parts in gathered.items():
            relative = 100 * np.concatenate(parts)
            mean, bias = np.abs(relative).mean(), relative.mean()
            means.setdefault(name, []).append(mean)
            held = name.startswith("voxflat") and width == WIDTHS[1]
            what = f"curled sheet, {name}"
            rows.append(
                [
                    f"{np.mean(sizes):,.0f}",
                    name,
                    judged(mean, ".2f", 0.3 if held else None, f"{what}, mean error, %"),
                    f"{max(np.abs(100 * part).mean() for part in parts):.2f}",
                    f"{bias:+.2f}; size " + judged(abs(bias), ".2f", 0.2, f"{what}, size of the bias, %")
                    if held
                    else f"{bias:+.2f}",
                ]
            )
    falling = [name for name, found in means.items() if np.all(np.diff(found) < 0)]
    for name in means:
        if name.startswith("voxflat"):
            judged(float(name in falling), ".0f", 1.0, f"curled sheet, {name}, falls with the size", least=True)
    falls = ", ".join(f"{name} {exponent(WIDTHS, found):.2f}" for name, found in means.items() if name in falling)
    table(
        f"Curled sheet of voxels, {options.orientations} random orientations: errors against the truth",
        ["voxels", "estimator", "mean error, %", "worst orientation, %", "bias, %"],
        rows,
        f"{SOURCES} random sources to all voxels. Errors fall from size to size as the width to the power of: {falls}.",
    )


def estimates(volume, surface, sources):
    """Yield each estimator's name and its rows."""
    for geodesic in solvers.OURS:
        found = surface.core.rows(sources.astype(np.uint32), geodesic=geodesic, threads=1)
        yield f"voxflat {geodesic}", found.astype(float)
    for lengths, name in (("chain-code", "chain code (the paper)"), ("euclidean", "1, √2, √3")):
        chain = _core.VoxelSurface.from_mask(volume, np.eye(4).tolist(), lengths).cut_out()
        numbers = chain.find(surface.ids)
        yield f"26 neighbours, {name}", chain.rows(numbers[sources], 1)[:, numbers].astype(float)


def curled_sheet(width, number):
    """Make a curled sheet in a random orientation.

    Returns
    -------
    volume : ndarray of bool
    surface : Surface
    plane : ndarray, shape (N, 2)
        Where each vertex lies on the sheet before it was curled, voxels.
    """
    length = 2 * width
    rotation = Rotation.random(rng=number)
    volume = shapes.curled_sheet(length, width, TURNS, rotation)
    surface = largest_piece(voxflat.surface(volume))  # a corner may hang on by an edge only
    radius = length / (2 * np.pi * TURNS)
    angle = np.linspace(0, 2 * np.pi * TURNS, int(length * 16))
    edge = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=1)
    ends = np.concatenate([rotation.apply(edge), rotation.apply(edge + np.array([0, 0, width]))])
    # the voxel i, j, k spans i to i + 1 and so on from two voxels below the sheet's least coordinates
    places = rotation.inv().apply(surface.points + 0.5 + ends.min(axis=0) - 2)
    turned = np.arctan2(places[:, 1], places[:, 0])
    turned[turned < -np.pi * (1 - TURNS)] += 2 * np.pi  # the gap's middle is just below angle zero
    return volume, surface, np.column_stack([radius * turned, places[:, 2]])


def balls(options):
    """Compare distances on shells and on balls, at random places of the grid, with great circles."""
    del options
    rows = [row for shape in ("shell", "ball") for radius in RADII for row in sphere(shape, radius)]
    table(
        "Spheres of voxels: errors against great circles",
        ["shape", "radius, voxels", "vertices", "estimator", "mean error, %", "bias, %"],
        rows,
        f"Shells one voxel thick, and balls, at 3 random places of the grid, {SOURCES} random sources to all vertices.",
    )


def sphere(shape, radius):
    """Return the rows of a shell or a ball of a radius, voxels."""
    gathered = {}
    for number in range(3):
        rng = np.random.default_rng(number)
        centre = radius + 3 + rng.random(3)
        axes = np.ogrid[tuple(slice(0, 2 * radius + 8) for _ in range(3))]
        distance = np.sqrt(sum((axis - at) ** 2 for axis, at in zip(axes, centre, strict=True)))
        volume = np.abs(distance - radius) <= 0.5 if shape == "shell" else distance < radius
        surface = voxflat.surface(volume)
        sources = rng.choice(len(surface), SOURCES, replace=False)
        away = surface.points - centre
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        true = 2 * radius * np.arcsin(np.linalg.norm(away[sources, None] - away[None], axis=2).clip(max=2) / 2)
        apart = true > 0
        for name, found in estimates(volume, surface, sources):
            gathered.setdefault(name, []).append(100 * (found[apart] / true[apart] - 1))
    rows = []
    for name, parts in gathered.items():
        relative = np.concatenate(parts)
        limit = 0.4 if shape == "shell" and radius == 40 and name.startswith("voxflat") else None
        mean = judged(np.abs(relative).mean(), ".2f", limit, f"{shape} of radius {radius}, {name}, mean, %")
        rows.append([shape, str(radius), f"{len(surface):,}", name, mean, f"{relative.mean():+.2f}"])
    return rows


def maps(options):
    """Measure how far the points of a flat map of a curled sheet are from where they belong."""
    rows = []
    worst = np.zeros(2)
    for number in range(options.maps):
        volume, _, plane = curled_sheet(WIDTHS[1], number)
        flat = voxflat.flatten(volume, method=voxflat.methods.Voxflat(sources=150), threads=1)
        surface = voxflat.surface(volume)
        order = {tuple(voxel): index for index, voxel in enumerate(surface.ids.tolist())}
        true = plane[[order[tuple(voxel)] for voxel in flat.ids.tolist()]]
        off, scaled = (np.linalg.norm(laid - true, axis=1) for laid in laid_over(flat.uv, true))
        worst = np.maximum(worst, [off.mean(), off.max()])
        shown = [off.mean(), np.percentile(off, 99), off.max(), scaled.mean(), scaled.max()]
        rows.append([str(number), f"{len(flat):,}", *(f"{figure:.3f}" for figure in shown)])
    mean, most = (
        judged(value, ".3f", limit, f"flat map of a curled sheet, {what} position error, voxels")
        for value, limit, what in zip(worst, (0.2, 1.0), ("mean", "greatest"), strict=True)
    )
    rows.append(["worst", "", mean, "", most, "", ""])
    table(
        "Flat maps of curled sheets from 150 sources: position errors, voxels",
        ["orientation", "voxels", "mean", "99th percentile", "greatest", "at the best scale: mean", "greatest"],
        rows,
        "Laid over the truth by the best rigid motion, turned over if need be. Targets are for maps as they are.",
    )


def laid_over(places, true):
    """Move points nearest to others by a rigid motion, possibly with a reflection; and by that and the best scale."""
    centred, aim = places - places.mean(axis=0), true - true.mean(axis=0)
    left, stretch, right = np.linalg.svd(centred.T @ aim)
    turned = centred @ left @ right
    scale = stretch.sum() / (centred**2).sum()
    return turned + true.mean(axis=0), scale * turned + true.mean(axis=0)
