"""How time and memory grow with the size of the surface."""

import anatomy
import numpy as np
from maps_makers import CUT_OPEN
from maps_peers import made_by
from tables import exponent, judged, table

STEEPEST = 1.05
"""Of CPU time and memory, as a power of the vertices."""

BOUNDS = {30_000: (10.0, None), 150_000: (20.0, 0.7), 890_000: (100.0, 2.5), 3_000_000: (480.0, 8.0)}
"""By the vertices that a surface has about: the most wall time, s, on 2 cores, and memory, GiB."""

NEAR = 0.15
"""A surface has about so many vertices if it has this share more or less."""

MOST_OFF = 0.001
"""Of lengths on the map of a developable sheet."""

OFF = "error of a million distances, %"

SAID = "of which taken, and said before"
"""Memory that a map takes beside packages and input."""

NEAR_SAID = 0.2
"""Part by which the memory that is said before the start may differ from what is taken."""


def said(made, name):
    """Return the memory that a map took and what was said of it, GiB, and note it if they are not near each other."""
    off = judged(100 * abs(made.need / made.taken - 1), ".0f", 100 * NEAR_SAID, f"{name}, memory said is off by %")
    return f"{made.taken:.2f}, {made.need:.2f}, off by % {off}"


def powers(sizes, costs):
    """Say how CPU time and memory, packages and input left out, grow from size to size."""
    if len(sizes) < 2:
        return ""
    named = zip(("CPU time", "memory"), zip(*costs, strict=True), strict=True)
    told = {name: f"growth of the {name}, power of the vertices" for name in ("CPU time", "memory")}
    time, memory = (judged(exponent(sizes, cost), ".2f", STEEPEST, told[name]) for name, cost in named)
    return f"With the vertices, CPU time grows to the power of {time}, memory to that of {memory}."


def grown(title, kind, first, surfaces, options):
    """Flatten surfaces from small to large, and say what that takes; `kind`: how one is called that misses a target.

    `surfaces`: of each surface the first cell, the job, and what the map's error is beside the true places, or None.
    """
    rows, sizes, costs = [], [], []
    for cell, job, error in surfaces:
        made = made_by(["voxflat"], job, options).get("voxflat")
        if made is None:
            continue
        size = len(made.places)
        wall, peak = next((most for near, most in BOUNDS.items() if abs(size / near - 1) < NEAR), (None, None))
        name = f"{kind}, {size:,} vertices"
        off = "" if error is None else judged(100 * error(made.places), ".4f", 100 * MOST_OFF, f"{name}, error %")
        shown = judged(made.wall, ".1f", wall, f"{name}, wall s")
        cells = [cell, f"{size:,}", shown, f"{made.cpu:.1f}", f"{1e6 * made.cpu / size:.0f}"]
        cells += [judged(made.peak, ".2f", peak, f"{name}, GiB"), said(made, name), off]
        rows.append([*cells, str(len(made.descent["energies"])), "yes" if made.descent["converged"] else "no"])
        sizes.append(size)
        costs.append((made.cpu, made.taken))
    columns = (first, "vertices", "wall s", "CPU s", "CPU µs a vertex", "GiB", SAID, OFF, "steps", "converged")
    table(title, columns, rows, powers(sizes, costs))


def growth(options):
    """Flatten whole hemispheres of voxels, from coarse to fine."""
    hemisphere = anatomy.fsaverage5("left")

    def of(spacing):
        labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], spacing)
        return f"{spacing} mm", {"labels": labels, "affine": affine, "options": CUT_OPEN}, None

    title = "Growth: fsaverage5 white left, whole, with surface and cuts"
    grown(title, "whole hemisphere", "voxels", map(of, options.spacings), options)


def sheets(options):
    """Flatten rolled, waving sheets of irregular triangles, whose flat places are known."""

    def of(count):
        true, points, faces = waving_sheet(count)
        far = np.random.default_rng(0).integers(len(true), size=(2, 1_000_000))
        far = far[:, far[0] != far[1]]

        def error(places):
            return np.mean(np.abs(lengths(places, far) / lengths(true, far) - 1))

        return f"{count:,}", {"points": points, "faces": faces}, error

    grown("Growth: a rolled, waving sheet of irregular triangles", "sheet", "asked", map(of, options.sheets), options)


def lengths(places, pairs):
    """Return how far pairs of places lie from each other."""
    return np.linalg.norm(places[pairs[0]] - places[pairs[1]], axis=1)


def waving_sheet(count):
    """Return about so many places in the plane, mm, where they are on a sheet that is bent one way, and faces."""
    rng = np.random.default_rng(0)
    side = round(np.sqrt(count / 1.5))
    shape = (round(1.5 * side), side)
    edge = 250.0 / shape[0]  # as long as a hemisphere's map
    rows, columns = np.indices(shape)
    true = edge * (np.stack([rows, columns], axis=2) + rng.uniform(-0.25, 0.25, (*shape, 2))).reshape(-1, 2)
    along = np.linspace(true[:, 0].min(), true[:, 0].max(), 1_000_001)
    turned = 1.5 * np.sin(along / 9) + along / 60  # the direction in which the sheet goes on
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
