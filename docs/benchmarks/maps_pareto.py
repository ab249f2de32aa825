"""What `weighting` trades: near against far distances; pictures of that, of descent, and of all maps."""

import numpy as np
from distances_tables import table
from maps_tables import SHIPPED, compared, fsaverage5_disk, made_by
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

import voxflat
from voxflat import figures

LOOKS = {
    SHIPPED: ("s", "#4d4d4d"),
    "ARAP": ("^", "#1b7f5c"),
    "SLIM": ("D", "#8e44ad"),
    "autoflatten": ("v", "#c1440e"),
    "Floater": ("P", "#b8860b"),
}
COLOURS = "viridis"
PANELS = (
    ("relative error of distances ≤ 10 mm (%)", lambda of: 100 * of.best_scale.relative_error_10mm),
    ("areal distortion |log2|, 95th percentile", lambda of: of.triangles.equal_area_p95),
)


def pareto(options):
    """Compare the maps of all weightings with those of peers, on fsaverage5's left hemisphere."""
    points, faces, shipped = fsaverage5_disk("left")
    job = {"points": points, "faces": faces}
    ours = {}
    for weighting in np.linspace(0, 1, options.weightings):
        found = made_by(["voxflat"], job | {"options": {"weighting": float(weighting)}}, options)
        ours |= {float(weighting): made for made in found.values()}
    peers = made_by([name for name in options.makers if name != "voxflat"], job, options)
    called = {weighting: f"voxflat, weighting {weighting:g}" for weighting in ours}
    made = {called[weighting]: one for weighting, one in ours.items()} | peers
    comparison = compared(points, faces, made, options.sources, **{SHIPPED: shipped})
    columns = ("map", "≤ 10 mm %", "≤ 30 mm %", "all %", "stress-1", "area: median, 95 %", "edges %", "steps", "CPU s")
    rows = []
    for name in comparison.maps:
        of, triangles = comparison[name].best_scale, comparison[name].triangles
        errors = of.relative_error_10mm, of.relative_error_30mm, of.relative_error
        area = f"{triangles.equal_area_median:.3f}, {triangles.equal_area_p95:.3f}"
        last = ["", ""]
        if name in made:
            last = [str(len(made[name].descent.get("energies", [])) or ""), f"{made[name].cpu:.1f}"]
        cells = [*(f"{100 * error:.2f}" for error in errors), f"{of.stress_1:.4f}", area, f"{100 * triangles.edge:.2f}"]
        rows.append([name, *cells, *last])
    table("What weighting trades: fsaverage5 white left", columns, rows)
    of_ours = {weighting: comparison[name] for weighting, name in called.items()}
    of_others = {name: comparison[name] for name in comparison.maps if name not in called.values()}
    options.pictures.mkdir(parents=True, exist_ok=True)
    figures.save(trade(of_ours, of_others), options.pictures / "maps_pareto.png")
    figures.save(
        convergence({weighting: one.descent for weighting, one in ours.items()}),
        options.pictures / "maps_convergence.png",
    )
    usual = min(ours, key=lambda weighting: abs(weighting - 0.5))
    shown = {"voxflat": ours[usual].places, SHIPPED: shipped} | {name: one.places for name, one in peers.items()}
    scales = {"voxflat": of_ours[usual]} | of_others
    shown = {name: scales[name].best_scale.scale * turned(places, shown["voxflat"]) for name, places in shown.items()}
    judged = voxflat.compare((points, faces), shown, sources=options.sources // 4, reference="exact")
    figures.heat_maps(judged).savefig(options.pictures / "maps_heat.png", dpi=90)


def turned(places, like):
    """Return places turned, and mirrored if need be, to lie as others do (orthogonal Procrustes)."""
    places, like = places - places.mean(axis=0), like - like.mean(axis=0)
    left, _, right = np.linalg.svd(places.T @ like)
    return places @ left @ right


def trade(ours, others):
    """Plot the error of all distances against what it is traded for.

    Parameters
    ----------
    ours : dict of float to voxflat.Distortion
        By weighting.
    others : dict of str to voxflat.Distortion
        Maps of other tools.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(10.4, 4.4), layout="constrained")
    grid = figure.subplots(1, len(PANELS), sharey=True)
    for axes, (label, value) in zip(grid, PANELS, strict=True):
        x = [value(of) for of in ours.values()]
        y = [100 * of.best_scale.relative_error for of in ours.values()]
        axes.plot(x, y, color="0.6", linewidth=1, zorder=1)
        shown = axes.scatter(
            x, y, c=list(ours), cmap=COLOURS, vmin=0, vmax=1, s=42, zorder=2, edgecolor="white", linewidth=0.6
        )
        for end in (min(ours), 0.5, max(ours)):
            if end in ours:
                place = list(ours).index(end)
                axes.annotate(f"{end:g}", (x[place], y[place]), (6, 5), textcoords="offset points", fontsize=9)
        for name, of in others.items():
            marker, colour = LOOKS[name]
            axes.scatter(value(of), 100 * of.best_scale.relative_error, marker=marker, color=colour, s=54, label=name)
        axes.margins(0.1)
        axes.set_xlabel(label)
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
    grid[-1].legend(loc="lower right")
    grid[0].set_ylabel("relative error of all distances (%)")
    figure.colorbar(shown, ax=grid.tolist(), aspect=30).set_label("voxflat's weighting: local to global", labelpad=8)
    return figure


def convergence(descents):
    """Plot how energies fall to their end.

    Parameters
    ----------
    descents : dict of float to dict
        ``metadata["descent"]`` by weighting.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.add_subplot(xlabel="step on the full mesh", ylabel="energy above its end (%)", yscale="log")
    axes.yaxis.set_major_formatter("{x:g}")
    for weighting, descent in descents.items():
        energies = np.array(descent["energies"])
        above = 100 * (energies / energies[-1] - 1)
        axes.plot(
            np.arange(len(above))[above > 0],
            above[above > 0],
            color=colormaps[COLOURS](weighting),
            linewidth=1.4,
            label=f"{weighting:g}",
        )
    axes.set_ylim(bottom=0.01)
    axes.grid(color="0.92")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(title="weighting", frameon=False, ncols=2)
    return figure
