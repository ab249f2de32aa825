"""Glue the patches of Appleboim, Saucan, Zeevi (2006), which the paper leaves open, for `saucan.py`."""

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from paper import FSAVERAGE5, timed
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

import voxflat
from voxflat.figures.colours import patch_colours

BOUND = 1.5
SEEN = 45.0  # mm, the side of the enlarged part


def gluing(colon):
    """Print the fraction of closed seams, and the dilatation before and after gluing."""
    names = [f"{kind} {side}" for kind in ("white", "pial") for side in ("left", "right")]
    files = {f"fsaverage5, {name}": FSAVERAGE5 / f"{name.replace(' ', '_')}.gii.gz" for name in names}
    surfaces = {name: voxflat.surface(str(path)) for name, path in files.items()}
    surfaces["synthetic colon"] = colon
    print(f"\ngluing, C ≤ {BOUND}")
    header = ("patches", "pieces", "seams, mm", "closed", "curved", "bound", "overlap", "C before", "C after", "mean C")
    print(f"{'':26}{'limit':>12}" + "".join(f"{name:>10}" for name in header) + f"{'CPU s':>8}")
    for name, surface in surfaces.items():
        for text, limit in {"θ = 10°": {"max_angle": 10}, "C = 1.1763": {"bound": 1.1763}}.items():
            atlas = surface.patches(**limit)
            glued, seconds = timed(atlas.glue, BOUND)
            seams, of = glued.seams, glued.figures()
            print(
                f"{name:26}{text:>12}{len(atlas):10}{len(glued):10}{seams.length:10.0f}"
                f"{100 * seams.closed_share:8.2f} %{seams.holonomy:7.0f} mm{seams.bound:7.0f} mm{seams.overlap:7.0f} mm"
                f"{glued.measured_before:10.4f}{of['measured']['c']:10.4f}{of['measured']['mean_c']:10.4f}{seconds:8.1f}",
                flush=True,
            )


def developable():
    """Print the deviation of developable surfaces from isometry, and the cuts of a closed cylinder."""
    print(f"\n{'developable':26}{'patches':>10}{'pieces':>10}{'cuts, mm':>10}{'max |σ − 1|':>14}")

    def cone(x, y):
        return 0.6 * (5 + y) * np.cos(0.2 * x), 0.6 * (5 + y) * np.sin(0.2 * x), 0.8 * (5 + y)

    for name, m, place in (
        ("wavy cylinder", 40, lambda x, y: (0.7 * x, y, 3 * np.sin(0.4 * x))),
        ("cone sector", 24, cone),
        ("closed cylinder, 20 mm", 36, lambda x, y: (5 * np.cos(x * np.pi / 18), 5 * np.sin(x * np.pi / 18), y)),
    ):
        atlas = voxflat.surface(sheet(m, 20, place)).patches(10)
        glued = atlas.glue(BOUND)
        change = np.abs(glued.stretch - 1).max()
        print(f"{name:26}{len(atlas):10}{len(glued):10}{glued.seams.cuts:10.3f}{change:14.1e}", flush=True)


def sheet(m, n, place):
    """Return an irregular mesh of a sheet bent along straight lines, joined where its ends meet."""
    rng = np.random.default_rng(0)
    x, y = (values.astype(float) for values in np.meshgrid(np.arange(m + 1), np.arange(n + 1), indexing="ij"))
    y[:, 1:-1] += rng.uniform(-0.4, 0.4, y[:, 1:-1].shape)
    y[-1] = y[0]
    number = np.arange(x.size).reshape(x.shape)
    points = np.stack(place(x.ravel(), y.ravel()), axis=1)
    if np.allclose(points[number[0]], points[number[-1]]):
        number[-1] = number[0]
        points = points[: number[-2].max() + 1]
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    halves = [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    return points, np.concatenate(halves)


def naive(atlas):
    """Place patches rigidly along the spanning tree of the longest shared boundaries; return triangles (F, 3, 2)."""
    edges = np.sort(atlas.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(int), axis=1)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], np.repeat(atlas.piece_ids, 3)[order]
    between = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1) & (owner[1:] != owner[:-1]))
    edges, pairs = edges[between], np.sort(np.column_stack([owner[between], owner[between + 1]]), axis=1)
    lengths = np.linalg.norm(np.diff(atlas.points[edges], axis=1)[:, 0], axis=1)
    tree = minimum_spanning_tree(coo_array((-lengths, pairs.T), shape=(len(atlas),) * 2).tocsr())
    place = {}
    for label, vertices in enumerate(np.split(atlas.vertex_ids, atlas.starts[1:-1])):
        rows = atlas.uv[atlas.starts[label] : atlas.starts[label + 1]]
        place[label] = dict(zip(vertices.tolist(), rows, strict=True))
    motion = {}
    for root in range(len(atlas)):
        if root in motion:
            continue
        motion[root] = np.eye(2), np.zeros(2)
        reached, before = breadth_first_order(tree, root, directed=False)
        for q in reached[1:].tolist():
            p = int(before[q])
            common = np.unique(edges[(pairs == sorted((p, q))).all(axis=1)])
            turn, shift = motion[p]
            to = np.array([place[p][v] for v in common]) @ turn.T + shift
            motion[q] = rigid(np.array([place[q][v] for v in common]), to)
    turns, shifts = (np.array([motion[label][k] for label in range(len(atlas))])[atlas.piece_ids] for k in (0, 1))
    return np.einsum("fij,fkj->fki", turns, atlas.uv[atlas.uv_faces]) + shifts[:, None]


def rigid(points, to):
    """Return the rotation and the translation that best move points onto others."""
    a, b = points - points.mean(axis=0), to - to.mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn, to.mean(axis=0) - turn @ points.mean(axis=0)


def covering(corners, pixel=0.25):
    """Return the fraction of the area of triangles in the plane that covers others, by pixels."""
    low = corners.reshape(-1, 2).min(axis=0)
    count = np.zeros(np.ceil((corners.reshape(-1, 2).max(axis=0) - low) / pixel).astype(int) + 2, dtype=np.int32)
    for a, b, c in (corners - low) / pixel:
        first = np.floor(np.minimum(np.minimum(a, b), c)).astype(int)
        last = np.ceil(np.maximum(np.maximum(a, b), c)).astype(int)
        x, y = np.meshgrid(*(np.arange(first[k], last[k]) + 0.5 for k in (0, 1)), indexing="ij")
        inside = np.ones(x.shape, dtype=bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) > 0
        count[first[0] : last[0], first[1] : last[1]] += inside
    return 1 - (count > 0).sum() / count.sum()


def picture(surface):
    """Draw rigidly placed patches beside glued ones: all of them, and an enlarged part."""
    atlas = surface.patches(10)
    glued = atlas.glue(BOUND)
    ours, theirs = glued.uv[glued.uv_faces], naive(atlas)
    # the same view: around a triangle in the middle of the largest piece
    largest = glued.piece_ids == 0
    middles = ours.mean(axis=1)
    middle = int(np.argmin(np.where(largest, np.linalg.norm(middles - middles[largest].mean(axis=0), axis=1), np.inf)))
    near = largest & (np.linalg.norm(middles - middles[middle], axis=1) < 6)
    turn, shift = rigid(theirs[near].reshape(-1, 2), ours[near].reshape(-1, 2))
    theirs = theirs @ turn.T + shift
    share = [covering(theirs), covering(ours[largest])]
    figure = Figure(figsize=(11.0, 11.2), layout="constrained")
    axes = figure.subplots(2, 2)
    colours = patch_colours(atlas) / 255
    outline = glued.uv[glued.outline[np.isin(glued.outline[:, 0], np.unique(glued.uv_faces[largest]))]]
    shown = np.concatenate([ours[largest].reshape(-1, 2), theirs.reshape(-1, 2)])
    centre, half = 0.5 * (shown.min(axis=0) + shown.max(axis=0)), 0.52 * np.ptp(shown, axis=0).max()
    for row, (at, reach) in enumerate([(centre, half), (middles[middle], 0.5 * SEEN)]):
        for column, (corners, kept) in enumerate([(theirs, slice(None)), (ours, largest)]):
            part = axes[row, column]
            drawn = PolyCollection(corners[kept], facecolor=colours[kept], edgecolor="none", antialiased=False)
            part.add_collection(drawn)
            if column:
                part.add_collection(LineCollection(list(outline), colors="black", linewidth=0.7 if row else 0.5))
            part.set(xlim=(at[0] - reach, at[0] + reach), ylim=(at[1] - reach, at[1] + reach), aspect="equal")
            part.set(xlabel="mm", ylabel="mm" if column == 0 else "")
            part.set_facecolor("white")
    axes[0, 0].set_title(f"placed rigidly: {100 * share[0]:.0f} % of the area covers other patches")
    axes[0, 1].set_title(f"glued: {100 * glued.seams.closed_share:.1f} % of the seams closed, C ≤ {BOUND}, no overlap")
    axes[1, 0].set_title("enlarged: holes and overlaps")
    axes[1, 1].set_title("enlarged: cuts are black")
    placed, joined = (100 * part for part in share)
    print(f"\narea that covers other patches: placed rigidly {placed:.1f} %, glued {joined:.2f} % (pixels of 0.25 mm)")
    return figure
