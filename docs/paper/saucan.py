"""Reproduce Appleboim, Saucan, Zeevi (2006): print the results of the paper and of voxflat, and draw the figures.

make paper-saucan

The skull is in tests/data (by YahooJAPAN, CC BY 3.0). The CT of a skull is skull_2.9.inr of CGAL, which `make` takes
from Debian's package libcgal-demo. Other meshes and INRIMAGE volumes can be passed as arguments.
"""

import gzip
import logging
import sys
from pathlib import Path

import numpy as np
import saucan_glue
from matplotlib.figure import Figure
from paper import ROOT, fsaverage5, reproduce, save_small, show, timed, trimmed

import voxflat
from voxflat import figures

SEEDS = 5  # random seeds whose numbers of patches are averaged
PAPER = {10.0: 1.1763, 5.0: 1.0875}
LIMITS = {"θ = 10°": {"max_angle": 10}, "θ = 5°": {"max_angle": 5}, "C = 1.1763": {"bound": 1.1763}}


def main(paths):
    logging.getLogger("voxflat").setLevel(logging.ERROR)
    surfaces = inputs(paths)
    certificates(surfaces)
    numbers(surfaces)
    edges_alone(surfaces)
    saucan_glue.gluing(surfaces["synthetic colon"])
    saucan_glue.developable()
    pictures(surfaces)
    save_small(saucan_glue.picture(surfaces["fsaverage5, white"]), "saucan_glued.png")


def inputs(paths):
    white, pial = fsaverage5("white", "pial")
    surfaces = {
        "fsaverage5, white": voxflat.surface(white),
        "fsaverage5, pial": voxflat.surface(pial),
        "skull (mesh)": voxflat.surface(ROOT / "tests" / "data" / "skull.ply"),
        "synthetic colon": voxflat.surface(colon()),
    }
    for path in map(Path, paths):
        if not path.exists():
            print(f"{path} does not exist and is skipped")
            continue
        name = "skull (CT)" if path.stem == "skull_2.9" else path.name
        surfaces[name] = inrimage(path) if ".inr" in path.name else voxflat.surface(path)
    return surfaces


def colon(around=120, along=250, length=300.0, folds=24):
    """Return a haustrated, folded tube that is open at both ends, mm, with 2 · around · along triangles."""
    t = np.linspace(0, 1, along + 1)
    aside, rise = 35 * np.sin(2.3 * np.pi * t), 25 * np.cos(1.7 * np.pi * t) + 8 * np.sin(7 * np.pi * t)
    axis = np.stack([length * t, aside, rise], axis=1)
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, (0, 0, 1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = 2 * np.pi * np.arange(around) / around
    haustra = np.abs(np.sin(np.pi * folds * t))[:, None] ** 0.7  # pouches between half-moon folds
    taeniae = 1 - 0.18 * np.exp(-((np.cos(1.5 * angle) / 0.25) ** 2))  # three bands along the tube
    radius = (13 + 9 * haustra * (0.75 + 0.25 * np.cos(3 * angle + 0.4))) * taeniae
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    points = (axis[:, None] + radius[..., None] * ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = a + around, b + around
    faces = np.stack([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)], axis=2).reshape(-1, 3)
    return points, faces


def inrimage(path, level=2.9):
    """Return the surface of an INRIMAGE-4 volume, the format of CGAL's examples."""
    data = path.read_bytes()
    data = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    header = dict(line.split("=", 1) for line in data[:256].decode("ascii").split("\n") if "=" in line)
    shape = [int(header[f"{axis}DIM"]) for axis in "XYZ"]
    kind = {"float": "f", "unsigned fixed": "u", "signed fixed": "i"}[header["TYPE"]]
    kind = ("<" if header["CPU"] in ("decm", "pc") else ">") + kind + str(int(header["PIXSIZE"].split()[0]) // 8)
    values = np.frombuffer(data, dtype=kind, offset=256, count=int(np.prod(shape))).reshape(shape, order="F")
    spacing = [float(header[f"V{axis}"]) for axis in "XYZ"]
    return voxflat.surface(values.astype(np.float32), threshold=level, spacing=spacing)


def certificates(surfaces):
    """Print the dilatations of figures 1 to 3: certified and measured."""
    print(f"\n{'':26}{'θ':>5}{'paper':>9}{'C':>9}{'C measured':>12}{'K':>9}{'K measured':>12}{'broken':>8}")
    for name, surface in surfaces.items():
        for angle, paper in PAPER.items():
            of = surface.patches(angle).figures()
            proven, measured = of["certificate"], of["measured"]
            print(
                f"{name:26}{angle:4.0f}°{paper:9.4f}{proven['c']:9.4f}{measured['c']:12.4f}"
                f"{proven['k']:9.4f}{measured['k']:12.4f}{of['broken']:8}",
                flush=True,
            )


def numbers(surfaces):
    """Print the number of patches by the order of their seeds."""
    head = f"{'random':>9}{'flattest':>10}{'curvature':>11}{'fewer':>8}{'CPU s':>8}"
    print(f"\n{'':26}{'triangles':>10}{'limit':>14}{head}")
    print(f"{'':50}{'the paper’s seeds':>19}{'ours':>11}")
    for name, surface in surfaces.items():
        for text, limit in LIMITS.items():
            counts = [len(surface.patches(**limit, seeds="random", seed=seed)) for seed in range(SEEDS)]
            flattest = len(surface.patches(**limit, seeds="flattest"))
            atlas, seconds = timed(surface.patches, **limit)
            ours = len(atlas)
            random = float(np.mean(counts))
            print(
                f"{name:26}{len(surface.faces):10}{text:>14}{random:9.0f}{flattest:10}{ours:11}"
                f"{100 * (1 - ours / random):6.0f} %{seconds:8.2f}",
                flush=True,
            )


def edges_alone(surfaces, angle=10.0):
    """Print the triangles that the test of the paper, which tests only edges, accepts wrongly."""
    print(f"\n{'only edges within 10°':26}{'patches':>9}{'steeper than 10°':>18}{'beyond C':>10}{'worst C':>10}")
    for name, surface in surfaces.items():
        tilt, count = edge_patches(surface.points, surface.faces.astype(int), angle)
        c = 1 / np.cos(np.radians(tilt))
        beyond = (c > 1 + np.tan(np.radians(angle))).sum()
        print(f"{name:26}{count:9}{(tilt > angle + 1e-9).sum():18}{beyond:10}{c.max():10.4g}", flush=True)


def edge_patches(points, faces, angle):
    """Grow patches by the test of the paper; return the inclination of each triangle, degrees, and their number."""
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    edges = np.roll(corners, -1, axis=1) - corners
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    beyond = {}
    for face, corner in enumerate(faces.tolist()):
        for k in range(3):
            beyond[corner[k], corner[(k + 1) % 3]] = face
    most = np.sin(np.radians(angle))
    tilt, free, count = np.zeros(len(faces)), np.ones(len(faces), dtype=bool), 0
    for seed in np.random.default_rng(0).permutation(len(faces)).tolist():
        if not free[seed]:
            continue
        count += 1
        free[seed] = False
        queue = [seed]
        while queue:
            corner = faces[queue.pop()].tolist()
            for k in range(3):
                other = beyond.get((corner[(k + 1) % 3], corner[k]))
                if other is None or not free[other] or np.abs(edges[other] @ normals[seed]).max() > most:
                    continue
                free[other] = False
                tilt[other] = np.degrees(np.arccos(np.clip(normals[other] @ normals[seed], -1, 1)))
                queue.append(other)
    return tilt, count


def pictures(surfaces):
    """Draw each surface with its patches, and the page of the colon."""
    figure = Figure(figsize=(4.2 * len(surfaces), 4.4), layout="constrained")
    for axes, (name, surface) in zip(np.atleast_1d(figure.subplots(1, len(surfaces))), surfaces.items(), strict=True):
        atlas = surface.patches(bound=1.1763)
        towards = (-1.0, -0.3, 0.3) if name.startswith("fsaverage5") else (0.6, -1.0, 0.5)
        show(axes, trimmed(figures.atlas_3d(atlas, towards=towards)), f"{name}\n{len(atlas)} patches, C ≤ 1.1763")
    save_small(figure, "saucan_surfaces.png")
    save_small(figures.atlas_page(surfaces["synthetic colon"].patches(bound=1.1763)), "saucan_page.png")


if __name__ == "__main__":
    reproduce(lambda: main(sys.argv[1:]))
