"""How time and memory grow with the size of the surface."""

import anatomy
from distances_tables import exponent, judged, table
from maps_tables import made_by

STEEPEST = 1.2
"""Of CPU time, as a power of the vertices."""

BOUNDS = {30_000: (10.0, None), 150_000: (60.0, 2.0)}
"""By the vertices that a surface has about: the most wall time, s, on 2 cores, and memory, GiB."""

NEAR = 0.15
"""A surface has about so many vertices if it has this share more or less."""


def growth(options):
    """Flatten whole hemispheres of voxels, from coarse to fine."""
    hemisphere = anatomy.fsaverage5("left")
    rows, sizes, times = [], [], []
    for spacing in options.spacings:
        labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], spacing)
        made = made_by(["voxflat"], {"labels": labels, "affine": affine}, options).get("voxflat")
        if made is None:
            continue
        size = len(made.places)
        wall, peak = next((most for near, most in BOUNDS.items() if abs(size / near - 1) < NEAR), (None, None))
        named = f"whole hemisphere, {size:,} vertices"
        rows.append(
            [
                f"{spacing} mm",
                f"{size:,}",
                judged(made.wall, ".1f", wall, f"{named}, wall s"),
                f"{made.cpu:.1f}",
                f"{1e6 * made.cpu / size:.0f}",
                judged(made.peak, ".2f", peak, f"{named}, GiB"),
                str(len(made.descent["energies"])),
                "yes" if made.descent["converged"] else "no",
            ]
        )
        sizes.append(size)
        times.append(made.cpu)
    note = ""
    if len(sizes) > 1:
        power = judged(exponent(sizes, times), ".2f", STEEPEST, "growth of the CPU time, power of the vertices")
        note = f"CPU time grows with the vertices to the power of {power}."
    columns = ("voxels", "vertices", "wall s", "CPU s", "CPU µs a vertex", "GiB", "steps", "converged")
    table("Growth: fsaverage5 white left, whole, with surface and cuts", columns, rows, note)
