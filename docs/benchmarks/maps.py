"""Judge maps of the default method beside the flat maps that fsaverage5 comes with, and time them on large surfaces.

    make bench-flatten

Same vertices, same cuts, exact distances from the same 300 random points, figures at each map's best scale with their
standard errors. Whole hemispheres are judged as they are flattened: by straight links, from 200 points.
"""

import resource
import time

import anatomy
import numpy as np

import voxflat

SOURCES = 300
HEADER = (
    "| surface | map | vertices | wall s | CPU s | all % | ≤ 30 mm % | ≤ 10 mm % | stress-1 | edges % "
    "| area: median, 95 % | turned over | covering |"
)


def main():
    """Print the table."""
    print(HEADER)
    print("|---" * HEADER.count("|", 1) + "|")
    for side in ("left", "right"):
        hemisphere = anatomy.fsaverage5(side)
        places, faces = hemisphere["flat"]
        places = np.nan_to_num(places)  # vertices that no triangle has
        for kind in ("white", "mid", "pial"):
            surface = voxflat.surface((hemisphere[kind], hemisphere["faces"]))
            name = f"fsaverage5 {kind} {side}"
            ours, wall, cpu = flatten(surface, keep=(hemisphere[kind], faces))
            maps = {"voxflat": ours, "shipped": (places, faces)}
            compared = voxflat.compare(surface, maps, sources=SOURCES, reference="exact")
            report(name, "voxflat", len(ours), wall, cpu, compared["voxflat"])
            report(name, "shipped", len(ours), None, None, compared["shipped"])
    for side in ("left", "right"):
        labels, affine, _ = anatomy.mni152_white_matter(side)
        surface = voxflat.surface(labels, affine=affine, repair=True)
        ours, wall, cpu = flatten(surface)
        report(f"MNI152 white matter {side}, whole", "voxflat", len(ours), wall, cpu, ours.distortion)
    hemisphere = anatomy.fsaverage5("left")
    for spacing in (1.0, 0.7, 0.5):
        labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], spacing)
        surface = voxflat.surface(labels, affine=affine, repair=True)
        ours, wall, cpu = flatten(surface)
        report(
            f"fsaverage5 white left, voxels of {spacing} mm, whole", "voxflat", len(ours), wall, cpu, ours.distortion
        )
    print(f"\nmemory at its peak: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


def flatten(surface, **patch):
    """Return a map and how long it took: wall and CPU, s."""
    wall, cpu = time.monotonic(), time.process_time()
    made = voxflat.flatten(surface, **patch)
    return made, time.monotonic() - wall, time.process_time() - cpu


def report(surface, name, vertices, wall, cpu, distortion):
    """Print a row."""
    of, errors, triangles = distortion.best_scale, distortion.standard_error.best_scale, distortion.triangles
    seconds = " | | | " if wall is None else f" | {wall:.1f} | {cpu:.1f} | "
    names = ("relative_error", "relative_error_30mm", "relative_error_10mm")
    relative = (f"{100 * getattr(of, name):.2f} ± {100 * getattr(errors, name):.2f}" for name in names)
    print(
        f"| {surface} | {name} | {vertices}{seconds}{' | '.join(relative)} "
        f"| {of.stress_1:.4f} ± {errors.stress_1:.4f} | {100 * triangles.edge:.2f} "
        f"| {triangles.areal_median:.3f}, {triangles.areal_p95:.3f} | {triangles.flipped} | {triangles.covering} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
