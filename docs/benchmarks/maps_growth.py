"""Growth of time and memory with the size of the surface."""

import anatomy
import numpy as np
from maps_peers import made_by
from tables import exponent, judged, table

from voxflat.benchmark.making import GIB

STEEPEST = 1.05  # limit of the exponents of CPU time and memory as powers of the number of vertices
BOUNDS = {30_000: (10.0, None), 150_000: (20.0, 0.7), 890_000: (100.0, 2.5), 3_000_000: (480.0, 8.0)}
"""Limits of wall time on 2 cores, s, and memory, GiB, by the approximate number of vertices."""
NEAR = 0.15  # relative deviation of that number
MOST_OFF = 0.001  # limit of the relative error of lengths on the map of a developable sheet
NEAR_SAID = 0.2  # limit of the relative difference between the memory estimate and the memory used


def powers(sizes, costs):
    """Describe how CPU time and memory grow, without packages and input."""
    if len(sizes) < 2:
        return ""
    named = zip(("CPU time", "memory"), zip(*costs, strict=True), strict=True)
    time, memory = (judged(exponent(sizes, cost), ".2f", STEEPEST, f"{name}, exponent") for name, cost in named)
    return f"CPU time grows as the number of vertices to the power of {time}, memory to the power of {memory}."


def grown(title, kind, first, surfaces, options):
    """Flatten surfaces from small to large, and print the costs; `kind` names a surface that misses a target.

    `surfaces` gives, for each surface, the first cell, the job, and a function from a map to its error or None.
    """
    rows, sizes, costs = [], [], []
    for cell, job, error in surfaces:
        made = made_by(["voxflat"], job, options).get("voxflat")
        if made is None:
            continue
        uv, details = made.flat.uv, made.flat.details
        size, need = len(uv), details["need"] / GIB
        wall, peak = next((most for near, most in BOUNDS.items() if abs(size / near - 1) < NEAR), (None, None))
        name = f"{kind}, {size:,} vertices"
        off = "" if error is None else judged(100 * error(uv), ".4f", 100 * MOST_OFF, f"{name}, error %")
        shown = judged(made.wall, ".1f", wall, f"{name}, wall s")
        cells = [cell, f"{size:,}", shown, f"{made.cpu:.1f}", f"{1e6 * made.cpu / size:.0f}"]
        estimate = 100 * abs(need / made.taken - 1)
        estimate = judged(estimate, ".0f", 100 * NEAR_SAID, f"{name}, error of the memory estimate, %")
        memory = f"{made.taken:.2f}, {need:.2f}, {estimate}"
        cells += [judged(made.peak, ".2f", peak, f"{name}, GiB"), memory, off]
        rows.append(
            [*cells, str(len(details["descent"]["energies"])), "yes" if details["descent"]["converged"] else "no"]
        )
        sizes.append(size)
        costs.append((made.cpu, made.taken))
    columns = [first, "vertices", "wall s", "CPU s", "CPU µs per vertex", "GiB", "of the map: used, estimate, error %"]
    columns += ["error of a million distances, %", "steps", "converged"]
    table(title, columns, rows, powers(sizes, costs))


def growth(options):
    hemisphere = anatomy.fsaverage5("left")

    def of(spacing):
        labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], spacing)
        return f"{spacing} mm", {"labels": labels, "affine": affine}, None

    title = "Growth: fsaverage5 white left, whole, with surface and cuts"
    grown(title, "whole hemisphere", "voxels", map(of, options.spacings), options)


def sheets(options):
    """Flatten rolled, wavy sheets of irregular triangles whose flat positions are known."""

    def of(count):
        true, points, faces = waving_sheet(count)
        far = np.random.default_rng(0).integers(len(true), size=(2, 1_000_000))
        far = far[:, far[0] != far[1]]

        def error(places):
            return np.mean(np.abs(lengths(places, far) / lengths(true, far) - 1))

        return f"{count:,}", {"points": points, "faces": faces, "options": {"relax": False}}, error

    grown("Growth: a rolled, wavy sheet of irregular triangles", "sheet", "requested", map(of, options.sheets), options)


def lengths(places, pairs):
    return np.linalg.norm(places[pairs[0]] - places[pairs[1]], axis=1)


def waving_sheet(count):
    """Return about `count` points in the plane, mm, their positions on a sheet that is bent one way, and faces."""
    rng = np.random.default_rng(0)
    side = round(np.sqrt(count / 1.5))
    shape = (round(1.5 * side), side)
    edge = 250.0 / shape[0]  # as long as the map of a hemisphere
    rows, columns = np.indices(shape)
    true = edge * (np.stack([rows, columns], axis=2) + rng.uniform(-0.25, 0.25, (*shape, 2))).reshape(-1, 2)
    along = np.linspace(true[:, 0].min(), true[:, 0].max(), 1_000_001)
    turned = 1.5 * np.sin(along / 9) + along / 60  # direction of the sheet
    step = along[1] - along[0]
    middle = (turned[1:] + turned[:-1]) / 2
    x, z = (np.concatenate([[0.0], np.cumsum(step * turn(middle))]) for turn in (np.cos, np.sin))
    points = np.stack([np.interp(true[:, 0], along, x), true[:, 1], np.interp(true[:, 0], along, z)], axis=1)
    corner = (rows * side + columns)[:-1, :-1].ravel()
    a, b, c, d = corner, corner + side, corner + side + 1, corner + 1
    other = rng.random(len(corner)) < 0.5
    first = np.stack([a, b, np.where(other, c, d)], axis=1)
    second = np.stack([np.where(other, a, b), c, d], axis=1)
    return true, points, np.concatenate([first, second]).astype(np.int64)
