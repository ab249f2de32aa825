"""Draw the figures of the explanation pages in ten seconds: python docs/explanation/drawings.py [FOLDER] [svg]."""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon, Rectangle

import voxflat

GREY, BLUE, RED, GREEN = "#d9d9d9", "#2166ac", "#b2182b", "#1b7837"
FOLDER = Path(__file__).parents[1] / "_generated" / "explanation"


def panels(*titles, width=3.2, height=3.0):
    """Return a figure with one panel for each title."""
    figure, axes = plt.subplots(1, len(titles), figsize=(width * len(titles), height), layout="constrained")
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, fontsize=10)
        ax.set_aspect("equal")
        ax.set_axis_off()
    return figure, axes


def voxels():
    """Draw foreground voxels, their surfels, and the vertices before and after placement."""
    figure, axes = panels("1  surfels", "2  one vertex per surface voxel", "3  vertices placed between voxels")
    x, y = np.meshgrid(np.arange(9), np.arange(7))
    inside = (x - 3.6) ** 2 + (y - 1.2) ** 2 < 3.9**2
    angle = np.linspace(0, 2 * np.pi, 200)
    for ax in axes:
        for i, j in zip(x[inside], y[inside], strict=True):
            ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor=GREY, edgecolor="white"))
        ax.set(xlim=(-0.7, 8.7), ylim=(-0.1, 6.2))
    nodes, outside = [], lambda i, j: not (0 <= i < 9 and 0 <= j < 7 and inside[j, i])
    for i, j in zip(x[inside], y[inside], strict=True):
        steps = [(di, dj) for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)) if j + dj >= 0 and outside(i + di, j + dj)]
        for di, dj in steps:
            side = np.array([[di, dj]]) / 2 + [i, j] + np.array([[dj, di], [-dj, -di]]) / 2
            axes[0].plot(*side.T, color=BLUE, lw=3, solid_capstyle="round")
        if steps:
            nodes.append([i, j])
    nodes = np.array(nodes, dtype=float)
    away = nodes - [3.6, 1.2]
    placed = [3.6, 1.2] + away / np.linalg.norm(away, axis=1)[:, None] * 3.9
    axes[1].plot(*nodes.T, "o", color=BLUE, ms=6)
    axes[2].plot(3.6 + 3.9 * np.cos(angle), 1.2 + 3.9 * np.sin(angle), color=GREEN, lw=1)
    for ends in zip(nodes, placed, strict=True):
        axes[2].annotate("", ends[1], ends[0], arrowprops={"arrowstyle": "->", "color": BLUE})
    axes[2].plot(*placed.T, "o", color=BLUE, ms=6)
    return figure


def unfolding():
    """Draw a path along edges, a straight link across unfolded triangles, and a chain code."""
    figure, axes = panels("path along edges", "straight link over unfolded triangles", "chain code over voxels")
    top = np.array([[0.5, 1.0], [1.6, 1.1], [2.7, 0.95], [3.8, 1.0]])
    bottom = np.array([[0.0, 0.0], [1.1, 0.1], [2.2, -0.05], [3.3, 0.1]])
    for ax in axes[:2]:
        for n in range(3):
            for triangle in ([bottom[n], bottom[n + 1], top[n]], [bottom[n + 1], top[n + 1], top[n]]):
                ax.add_patch(Polygon(triangle, facecolor=GREY, edgecolor="white", lw=1.5))
    along = np.array([bottom[0], bottom[1], bottom[2], top[2], top[3]])
    axes[0].plot(*along.T, color=RED, lw=2.5)
    axes[1].plot(*np.array([bottom[0], top[3]]).T, color=BLUE, lw=2.5)
    steps = np.array([[0, 0], [1, 0], [2, 0], [3, 1], [4, 1], [5, 2], [6, 2]])
    for i, j in steps:
        axes[2].add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor=GREY, edgecolor="white"))
    axes[2].plot(*steps.T, color=RED, lw=2.5, marker="o", ms=4)
    axes[2].plot([0, 6], [0, 2], color=BLUE, lw=2.5)
    for ax, ends in ((axes[0], along), (axes[1], along), (axes[2], steps)):
        ax.plot(*ends[[0, -1]].T, "ko", ms=6)
        ax.margins(0.1)
    return figure


def curvature():
    """Draw a spherical cap, its map without cuts, and its map with gaps along cuts."""
    figure, axes = panels("a curved patch", "flattened without cuts", "flattened with three cuts", height=3.3)
    most, angle = 1.25, np.linspace(0, 2 * np.pi, 200)
    for height in np.linspace(0.25, most, 5):
        radius, drop = np.sin(height), np.cos(height)
        axes[0].plot(radius * np.cos(angle), drop + 0.35 * radius * np.sin(angle), color="#888888", lw=0.8)
        axes[1].plot(height * np.cos(angle), height * np.sin(angle), color=plt.cm.Reds(0.2 + height / 2.2), lw=2.5)
    for turn in np.arange(12) * np.pi / 6:
        height = np.linspace(0, most, 40)
        x, y = np.sin(height) * np.cos(turn), np.cos(height) + 0.35 * np.sin(height) * np.sin(turn)
        axes[0].plot(x, y, color="#888888", lw=0.8)
        axes[1].plot([0, most * np.cos(turn)], [0, most * np.sin(turn)], color="#888888", lw=0.8)
    axes[1].text(0, -1.55, "the rim is stretched by 32 %", ha="center", color=RED, fontsize=9)
    for piece in range(3):
        middle = np.pi / 2 + piece * 2 * np.pi / 3
        r = np.linspace(0, most, 60)
        half = np.where(r < 0.4, np.pi / 3, np.pi / 3 * np.sin(r) / np.maximum(r, 1e-9))
        half += np.where(r < 0.4, 0, (1 - np.sin(0.4) / 0.4) * np.pi / 3 * np.exp(-(r - 0.4) * 6))
        for share in np.linspace(-1, 1, 5):
            turn = middle + share * half
            edge = {"color": RED, "lw": 2} if abs(share) == 1 else {"color": "#888888", "lw": 0.8}
            begin = 24 if abs(share) == 1 else 0
            axes[2].plot(r[begin:] * np.cos(turn[begin:]), r[begin:] * np.sin(turn[begin:]), **edge)
        for n in (12, 24, 36, 48, 59):
            turn = middle + np.linspace(-1, 1, 40) * half[n]
            axes[2].plot(r[n] * np.cos(turn), r[n] * np.sin(turn), color="#888888", lw=0.8)
    axes[2].text(0, -1.55, "gaps open along the cuts", ha="center", color=RED, fontsize=9)
    return figure


def layers():
    """Draw layers at equal fractions of the thickness and of the volume of the cortex, over a gyrus and a sulcus."""
    figure, axes = panels("equidistant layers", "equivolume layers", width=4.6, height=2.6)
    x = np.linspace(0, 4 * np.pi, 400)
    white = np.column_stack([x, 1.1 * np.sin(x)])
    slope = np.gradient(white, axis=0)
    normal = np.column_stack([-slope[:, 1], slope[:, 0]]) / np.linalg.norm(slope, axis=1)[:, None]
    bend = np.gradient(np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))) / np.linalg.norm(slope, axis=1)
    thick = 0.7
    grown = np.maximum(1 - thick * bend, 0.05)
    for ax, is_volume in zip(axes, (False, True), strict=True):
        for share in (0, 0.25, 0.5, 0.75, 1):
            rho = share * (grown + 1) / (np.sqrt(share * grown**2 + 1 - share) + 1) if is_volume else share
            line = white + np.atleast_1d(rho)[:, None] * thick * normal
            colour = {0: BLUE, 1: RED}.get(share, "#666666")
            ax.plot(*line.T, color=colour, lw=2 if share in (0, 1) else 1)
        for n in range(12, 400, 25):
            ax.plot(*np.array([white[n], white[n] + thick * normal[n]]).T, color="#bbbbbb", lw=0.8, zorder=0)
        ax.set_xlim(1.5, 11)
    axes[0].text(7.85, -0.2, "white surface", color=BLUE, fontsize=9, ha="center")
    axes[0].text(4.7, 1.3, "pial surface", color=RED, fontsize=9, ha="center")
    return figure


def cuts():
    """Flatten the left hemisphere of fsaverage5 along standard and automatic cuts."""
    from nilearn.datasets import fetch_surf_fsaverage

    left = fetch_surf_fsaverage()
    surface = voxflat.surface(left.white_left)
    standard = surface.cut("standard", sphere=left.sphere_left)
    kept = surface.drop(standard.left_out).cut("automatic")
    maps = {"standard": standard.flatten(), "automatic": kept.flatten()}
    titles = [
        f"{name} cuts: distance error {100 * of.distortion.raw.relative_error:.1f} %" for name, of in maps.items()
    ]
    figure, axes = panels(*titles, width=4.2, height=4.2)
    for ax, of in zip(axes, maps.values(), strict=True):
        corners = of.curvature[of.faces].mean(axis=1)
        colours = np.where(corners > 0, 0.85, 0.55)
        ax.tripcolor(*of.uv.T, of.faces, facecolors=colours, cmap="gray", vmin=0, vmax=1, rasterized=True)
        edges = np.sort(np.concatenate([of.faces[:, [0, 1]], of.faces[:, [1, 2]], of.faces[:, [2, 0]]]), axis=1)
        found, counts = np.unique(edges, axis=0, return_counts=True)
        ax.add_collection(LineCollection(of.uv[found[counts == 1]], color=RED, lw=1))
    return figure


if __name__ == "__main__":
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    ending = sys.argv[2] if len(sys.argv) > 2 else "svg"
    folder.mkdir(parents=True, exist_ok=True)
    for draw in (voxels, unfolding, curvature, layers, cuts):
        drawn = draw()
        drawn.savefig(folder / f"{draw.__name__}.{ending}", dpi=110, facecolor="white", bbox_inches="tight")
