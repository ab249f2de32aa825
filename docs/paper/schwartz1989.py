"""Reproduce Schwartz, Shaw, Wolfson (1989): print the results of the paper and of voxflat, and draw the figures.

make paper-mapmaker
"""

import logging

import numpy as np
import paper
import pyvista as pv
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from paper import row
from scipy.linalg import orthogonal_procrustes

import voxflat

STARTS = 20  # random starts that are compared
SURFACE, FLIPPED = "#4477aa", "#cc3311"
CURVES = ("#4477aa", "#ee7733", "#009988")


def main():
    logging.getLogger("voxflat").setLevel(logging.ERROR)  # the table counts the warnings
    row("", "paper", "ours")
    hemisphere()
    cortex = fsaverage5()
    same_map(cortex)
    neighbourhoods(cortex)
    striate(cortex)


def flatten(surface, *, seed=0, **options):
    """Return a map and its CPU seconds."""
    return paper.timed(voxflat.flatten, surface, voxflat.methods.Schwartz1989(**options), relax=False, seed=seed)


def tell(flat_map):
    """Print how well a map preserves distances."""
    distortion = flat_map.distortion
    row("  mean relative error of distances, %", "several", f"{100 * distortion.raw.relative_error:.2f}")
    row("  flipped triangles", "", f"{distortion.triangles.flipped} of {len(flat_map.faces)}")


def hemisphere(radius=20.0):
    """Figure 1: a hemispherical shell."""
    sphere = pv.PlatonicSolid("octahedron").subdivide(4, "linear").clean()
    directions = sphere.points / np.linalg.norm(sphere.points, axis=1, keepdims=True)
    faces = sphere.regular_faces
    used, faces = np.unique(faces[(directions[faces, 2] > -1e-6).all(axis=1)], return_inverse=True)
    flat_map, seconds = flatten((radius * directions[used].astype(float), faces.reshape(-1, 3)))
    row(f"figure 1: hemisphere of {len(flat_map)} nodes; CPU s of 3 starts", "", f"{seconds:.1f}")
    row("  stress of the 3 starts", "", " ".join(f"{stress:.4f}" for stress in flat_map.metadata["starts"]))
    tell(flat_map)
    picture(flat_map, (9, 4.4), "a hemisphere", (0.6, -0.8, 0.45), "mapmaker_hemisphere.png")


def fsaverage5():
    """Return the left midthickness surface and its most posterior vertex, the occipital pole."""
    white, pial = paper.fsaverage5("white", "pial")
    surface = voxflat.surface(white, pial=pial)
    return surface, int(surface.points[:, 1].argmin())


def disk(cortex, nodes):
    """Return a disk around the occipital pole with about `nodes` nodes."""
    surface, pole = cortex
    radii = np.arange(20.0, 80.0, 0.5)
    distances = np.asarray(surface.geodesic([pole]).rows)[0]
    radius = radii[np.abs([(distances <= radius).sum() - nodes for radius in radii]).argmin()]
    return surface.disk(pole, float(radius))


def same_map(cortex):
    """Figure 2: three random starts give the same map, up to rotation and reflection."""
    patch = disk(cortex, 600)
    sources = flatten(patch, starts=1)[0]
    sources = sources.ids[sources.sources]
    maps = [flatten(patch, neighbourhood=8, sources=sources, starts=1, seed=seed)[0] for seed in range(3)]
    row(f"figure 2: occipital cortex, {len(maps[0])} nodes (paper: 600), 8 rings", "", "")
    row("  stress of the 3 starts", "equal", " ".join(f"{m.metadata['starts'][0]:.5f}" for m in maps))
    apart = max(procrustes(maps[0].uv, other.uv) for other in maps[1:])
    row("  distance between the maps after rotation and reflection (RMS), mm", "0", f"{apart:.5f}")
    energies = [np.array(m.metadata["descent"]["energies"]) for m in maps]
    steps = [int(np.flatnonzero(of > 1.01 * of.min())[-1]) + 1 for of in energies]
    row("  iterations until the stress is within 1 % of its final value", "about 100", " ".join(map(str, steps)))
    tell(maps[0])
    figure = Figure(figsize=(9, 8.6), layout="constrained")
    axes = figure.subplots(2, 2).ravel()
    for number, flat_map in enumerate(maps):
        show_flat(axes[number], flat_map, f"random start {number + 1}", CURVES[number])
        axes[3].plot(energies[number], color=CURVES[number], label=f"start {number + 1}")
    axes[3].set(xlabel="iteration", ylabel="stress", yscale="log", xlim=(0, 1.5 * max(steps)), title="descent")
    axes[3].legend(frameon=False)
    paper.save_small(figure, "mapmaker_starts.png")


def procrustes(uv, other):
    """Return the RMS distance of two maps after the best rotation or reflection, mm."""
    uv, other = uv - uv.mean(axis=0), other - other.mean(axis=0)
    turn, _ = orthogonal_procrustes(other, uv)
    return float(np.sqrt(((other @ turn - uv) ** 2).sum(axis=1).mean()))


def neighbourhoods(cortex):
    """Compare neighbourhoods with and without long distances: short distances alone fold the map."""
    patch = disk(cortex, 600)
    print(f"\n{'distances used':44}{'of all pairs':>13}{'best of':>10}{'error':>9}{'flipped':>13}{'CPU s':>8}")
    print(f"{'':57}{f'{STARTS} starts':>10}")
    cases = {"nearest neighbours": (1, 0), "second neighbours": (2, 0), "a tenth of the nodes": (None, 0)}
    cases |= {"8 rings, as in figure 2": (8, 0), "12 rings": (12, 0)}
    cases |= {"nearest neighbours, and 50 nodes to all": (1, 50)}
    cases |= {"a tenth, and 50 nodes to all (the default)": (None, 50), "8 rings, and 50 nodes to all": (8, 50)}
    cases |= {"all pairs": ("all", 0)}
    maps = {}
    for name, (rings, sources) in cases.items():
        flat_map, seconds = flatten(patch, neighbourhood=rings, sources=sources, starts=STARTS)
        maps[name] = flat_map
        stresses = np.array(flat_map.metadata["starts"])
        share = flat_map.metadata["pairs"] / (len(flat_map) * (len(flat_map) - 1) / 2)
        best = (stresses <= 1.01 * stresses.min()).sum()
        distortion = flat_map.distortion
        error, flipped = 100 * distortion.raw.relative_error, distortion.triangles.flipped
        print(f"{name:44}{100 * share:11.1f} %{best:10}{error:7.1f} %{flipped:13}{seconds:8.1f}", flush=True)
    print()
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    shown = ("nearest neighbours", "a tenth of the nodes", "a tenth, and 50 nodes to all (the default)")
    for axes, name in zip(figure.subplots(1, 3), shown, strict=True):
        show_flat(axes, maps[name], name)
    paper.save_small(figure, "mapmaker_neighbourhoods.png")


def striate(cortex):
    """Figure 3: a patch of 1200 nodes."""
    patch = disk(cortex, 1200)
    flat_map, seconds = flatten(patch)
    metadata = flat_map.metadata
    row(f"figure 3: occipital cortex, {len(flat_map)} nodes (paper: 1200); CPU of 3 starts", "20 h", f"{seconds:.1f} s")
    stresses = " ".join(f"{stress:.5f}" for stress in metadata["starts"])
    row(f"  {metadata['neighbourhood']} rings, 50 nodes to all: stress of the 3 starts", "equal", stresses)
    tell(flat_map)
    usual = patch.flatten(relax=False)
    row("  relative error of the default method, %", "", f"{100 * usual.distortion.raw.relative_error:.2f}")
    row("", "", f"{usual.distortion.triangles.flipped} of {len(usual.faces)}")
    picture(flat_map, (10, 5.2), "occipital cortex from behind", (-0.35, -1.0, 0.15), "mapmaker_cortex.png")


def show_flat(axes, flat_map, title, colour=SURFACE):
    """Draw the triangles of a map, flipped ones in another colour."""
    flipped = flat_map.distortion.triangles.is_flipped
    for chosen, edge, zorder in ((~flipped, colour, 1), (flipped, FLIPPED, 2)):
        corners = flat_map.uv[flat_map.faces[chosen]]
        colours = {"facecolor": (*to_rgb(edge), 0.1), "edgecolor": edge}
        axes.add_collection(PolyCollection(corners, **colours, lw=0.5, zorder=zorder))
    if flipped.any():
        title = f"{title}\n{flipped.sum()} flipped triangles (red)"
    axes.autoscale()
    axes.set(title=title, aspect="equal", xlabel="mm")


def picture(flat_map, size, title, towards, name):
    """Draw the surface with its edges, and its map."""
    figure = Figure(figsize=size, layout="constrained")
    space, plane = figure.subplots(1, 2)
    mesh = pv.PolyData.from_regular_faces(flat_map.points, flat_map.faces)
    plotter = pv.Plotter(off_screen=True, window_size=(1100, 1000))
    plotter.add_mesh(mesh, color="#e8eef4", show_edges=True, edge_color=SURFACE, line_width=1.5, ambient=0.25)
    plotter.view_vector(towards, (0, 0, 1))
    plotter.camera.zoom(1.3)
    paper.show(space, paper.trimmed(plotter.screenshot(return_img=True)), title)
    show_flat(plane, flat_map, "flattened")
    paper.save_small(figure, name)


if __name__ == "__main__":
    paper.reproduce(main)
