"""What the choice of sources does to a map."""

from distances_tables import table
from maps_tables import cells, compared, fsaverage5_disk, made_by

SAMPLINGS = ("farthest", "curvature", "random")
COUNTS = {"voxflat": (100, 400), "zigelman2002": (100, 400)}
"""By the method: how many sources."""


def sampling(options):
    """Compare even, curvature-adaptive and random sources on fsaverage5's left hemisphere."""
    points, faces, _ = fsaverage5_disk("left")
    made = {}
    for method, counts in COUNTS.items():
        for count in counts:
            for chosen in SAMPLINGS:
                how = {"method": method, "sources": count, "sampling": chosen}
                found = made_by(["voxflat"], {"points": points, "faces": faces, "options": how}, options)
                made |= {f"{method}, {count}, {chosen}": one for one in found.values()}
    comparison = compared(points, faces, made, options.sources)
    columns = ("method, sources, sampling", "all %", "≤ 30 mm %", "≤ 10 mm %", "stress-1", "edges %", "area")
    rows = [[name, *cells(comparison[name])[4:10]] for name in comparison.maps]
    table("Which sources: fsaverage5 white left", columns, rows)
