"""Surfaces whose best flat map is known: developable ones, and the hemisphere."""

import numpy as np
from distances_tables import judged, table
from maps_tables import made_by
from scipy.optimize import minimize, minimize_scalar
from scipy.spatial import Delaunay
from scipy.spatial.distance import cdist

import voxflat

MOST = 0.1
"""Error of developable surfaces, %."""

SOURCES = 300
RADIUS = 30.0
"""Of the hemisphere, mm."""


def developable(options):
    """Flatten surfaces that unroll without error, and compare distances in the map with those in the plane."""
    rows = []
    for name, (plane, points, faces) in developables().items():
        for maker, made in made_by(options.makers, {"points": points, "faces": faces}, options).items():
            error = relative_errors(pairs(plane), pairs(made.places))
            edge = voxflat.measure((points, faces), made.places, sources=1, reference="graph").triangles.edge
            limit = MOST if maker == "voxflat" else None
            cells = [
                judged(100 * value, ".3f", limit, f"{name}, {what} error, %")
                for value, what in ((error, "raw relative"), (edge, "edges'"))
            ]
            rows.append([name, maker, f"{len(plane):,}", *cells, f"{made.cpu:.1f}"])
    table("Developable surfaces", ("surface", "map", "vertices", "raw relative error %", "edges %", "CPU s"), rows)


def developables():
    """Return points in the plane and on the surface that it is rolled to, mm, and faces, by the surface's name."""
    sheet = scattered(100.0, 40.0)
    x, y = sheet.T
    sector = scattered(120.0, 60.0)
    radius, angle = 20 + sector[:, 1], sector[:, 0] / 50 - 1.2
    cone = radius * np.array([np.cos(angle), np.sin(angle)])
    slope = 0.6  # of the cone's sides: circles of the sector become longer turns of a thinner one
    turned = radius * np.array(
        [slope * np.cos(angle / slope), slope * np.sin(angle / slope), np.full_like(radius, 0.8)]
    )
    faces, of_sector = (Delaunay(where).simplices.astype(np.int64) for where in (sheet, sector))
    return {
        "plane": (sheet, np.column_stack([sheet, np.zeros(len(sheet))]), faces),
        "cylinder": (sheet, np.column_stack([20 * np.cos(x / 20), 20 * np.sin(x / 20), y]), faces),
        "cone": (cone.T, turned.T, of_sector),
    }


def scattered(length, width, count=41):
    """Return points at random places near those of a grid over a rectangle, whose border is even."""
    x, y = np.meshgrid(
        np.linspace(0, length, round(count * length / width)), np.linspace(0, width, count), indexing="ij"
    )
    step = width / (count - 1)
    aside = np.random.default_rng(0).uniform(-0.3, 0.3, (2, *x.shape)) * step
    aside[:, [0, -1]] = aside[:, :, [0, -1]] = 0
    return np.column_stack([(x + aside[0]).ravel(), (y + aside[1]).ravel()])


def hemisphere(options):
    """Flatten a hemisphere, and compare with the best of the maps that keep directions from the pole."""
    plane = disk_points()
    faces = Delaunay(plane).simplices.astype(np.int64)
    polar, around = np.hypot(*plane.T), np.arctan2(plane[:, 1], plane[:, 0])
    points = RADIUS * np.column_stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
    some = np.random.default_rng(0).choice(len(points), SOURCES, replace=False)
    true = RADIUS * np.arccos(np.clip(points[some] @ points.T / RADIUS**2, -1, 1))

    def radial(shape):
        reach = polar * (1 + shape[0] * polar**2 + shape[1] * polar**4)
        return RADIUS * reach[:, None] * np.column_stack([np.cos(around), np.sin(around)])

    def best(measure):
        found = minimize(
            lambda shape: measure(true, cdist(radial(shape)[some], radial(shape))), [0, 0], method="Nelder-Mead"
        )
        return radial(found.x)

    maps = {
        "azimuthal equidistant": radial([0, 0]),
        "Lambert's, of equal area": 2 * RADIUS * np.sin(polar / 2)[:, None] * plane / np.maximum(polar, 1e-12)[:, None],
        "radial of least relative error": best(least_relative),
        "radial of least stress-1": best(least_stress),
    }
    job = {"points": points, "faces": faces}
    maps |= {name: made.places for name, made in made_by(options.makers, job, options).items()}
    for weighting in (0.0, 1.0):
        told = job | {"options": {"weighting": weighting}}
        maps |= {
            f"{name}, weighting {weighting:g}": one.places for name, one in made_by(["voxflat"], told, options).items()
        }
    rows = []
    for name, places in maps.items():
        flat = cdist(places[some], places)
        near = (true > 0) & (true <= 10)
        scale = best_scale(true, flat)
        local = np.mean(np.abs(scale * flat[near] / true[near] - 1))
        triangles = voxflat.measure((points, faces), places, sources=1, reference="graph").triangles
        figures = (least_relative(true, flat), local, least_stress(true, flat), triangles.equal_area_p95)
        rows.append(
            [name, *(f"{100 * value:.2f}" for value in figures[:2]), *(f"{value:.4f}" for value in figures[2:])]
        )
    columns = ("map", "all %", "≤ 10 mm %", "stress-1, at its own best scale", "area: 95 %")
    table(f"Hemisphere, {len(points):,} vertices, beside great circles", columns, rows)


def disk_points(rings=45):
    """Return points of a disk of radius π/2, evenly: rings of a sixth more points each; the last one is its border."""
    found = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        polar = np.pi / 2 * ring / rings
        angle = 2 * np.pi * (np.arange(round(4 * rings * np.sin(polar))) + ring / 2) / round(4 * rings * np.sin(polar))
        found.append(polar * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(found)


def pairs(places):
    """Return distances in the plane from some points to all."""
    some = np.random.default_rng(0).choice(len(places), SOURCES, replace=False)
    return cdist(places[some], places)


def relative_errors(true, found):
    """Return the mean relative error."""
    apart = true > 0
    return np.mean(np.abs(found[apart] / true[apart] - 1))


def best_scale(true, flat):
    """Return the scale of the least mean relative error."""
    apart = true > 0
    ratio = flat[apart] / true[apart]
    return minimize_scalar(lambda scale: np.mean(np.abs(scale * ratio - 1)), bounds=(0.3, 3), method="bounded").x


def least_relative(true, flat):
    """Return the mean relative error at the best scale."""
    return relative_errors(true, best_scale(true, flat) * flat)


def least_stress(true, flat):
    """Return stress-1 at the scale where it is least."""
    scale = np.sum(true * flat) / np.sum(flat**2)
    return np.sqrt(np.sum((scale * flat - true) ** 2) / np.sum(true**2))
