"""How well a group map fits a person who is not in the group, and the picture of the guide to group maps.

    python docs/benchmarks/groups.py
    python docs/benchmarks/groups.py --picture docs/pictures/group_map.png

The people are the simulated subjects of standard.py, resampled to fsaverage5 with their registered spheres. All have
the folds of fsaverage5, smoothly deformed, so real people differ more.
"""

import argparse
import logging
from pathlib import Path

import anatomy
import numpy as np
from standard import subject, unit
from tables import DISTANCES, distance_cells, table

import voxflat
from voxflat.surfaces.standard.sphere import in_triangles

SIDE = "left"
SOURCES = 80


def main():
    """Print the table of people who are left out, or draw the spread of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=6, help="number of simulated people")
    parser.add_argument("--picture", type=Path, help="draw the spread between the people instead")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    people = [person(number) for number in range(options.people)]
    if options.picture is None:
        leave_out(people)
    else:
        figure = voxflat.figures.heat_map(voxflat.flatten_group(people), of="spread")
        voxflat.figures.save(figure, options.picture)


def person(number):
    """Return a simulated person on the mesh of fsaverage5, without the triangles that its flat map omits."""
    hemisphere = anatomy.fsaverage5(SIDE)
    points, faces, sphere, _ = subject(number, SIDE)
    corners, weights, _ = in_triangles(sphere, faces, unit(hemisphere["sphere"]))
    return np.einsum("ij,ijk->ik", weights, points[corners]), hemisphere["flat"][1]


def leave_out(people):
    """Print the errors of each person's distances, at the best scale, on maps that were made without this person."""
    flat, faces = anatomy.fsaverage5(SIDE)["flat"]
    own = {f"own {number}": voxflat.flatten(one) for number, one in enumerate(people)}
    rows = []
    for number, one in enumerate(people):
        group = voxflat.flatten_group(people[:number] + people[number + 1 :])
        maps = {"fsaverage5": (np.nan_to_num(flat), faces), "group": group, **own}
        found = voxflat.compare(one, maps, on_surface=True, sources=SOURCES, reference="graph")
        cells = {name: distance_cells(found[name]) for name in maps}
        mine = cells.pop(f"own {number}")
        others = [[float(cell) for cell in cells[name]] for name in own if name in cells]
        best = [f"{error:.2f}" for error in np.min(others, axis=0)]
        shown = (cells["fsaverage5"], cells["group"], best, mine)
        rows.append([str(number), *(", ".join(three) for three in shown), str(found["group"].triangles.flipped)])
    columns = ("left out", "fsaverage5's map", "group map", "best map of another", "own map", "flipped")
    table(f"Errors: {', '.join(DISTANCES)}", columns, rows)


if __name__ == "__main__":
    main()
