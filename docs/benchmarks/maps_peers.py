"""voxflat beside its peers on the same patches and the same cuts."""

import anatomy
import numpy as np
from maps_makers import CUT_OPEN
from maps_tables import SHIPPED, compared, fsaverage5_disk, made_by, print_maps


def fsaverage5(options):
    """Compare maps of the part of fsaverage5 that its shipped flat maps have."""
    for side in options.sides:
        for kind in options.kinds:
            points, faces, shipped = fsaverage5_disk(side, kind)
            made = made_by(options.makers, {"points": points, "faces": faces}, options)
            comparison = compared(points, faces, made, options.sources, **{SHIPPED: shipped})
            print_maps(f"fsaverage5 {kind} {side}", comparison, made)


def whole(options):
    """Compare maps of a whole hemisphere of voxels, cut open by voxflat."""
    hemisphere = anatomy.fsaverage5("left")
    labels, affine, _ = anatomy.voxelise(hemisphere["white"], hemisphere["faces"], options.whole)
    title = f"fsaverage5 white left, voxels of {options.whole} mm, whole"
    cut_open(title, {"labels": labels, "affine": affine}, options)


def mni152(options):
    """Compare maps of a hemisphere of the MNI152 template by marching cubes, cut open by voxflat."""
    points, faces = anatomy.mni152_marching_cubes("left")
    cut_open("MNI152 white matter left, marching cubes, whole", {"points": points, "faces": faces}, options)


def cut_open(title, job, options):
    """Compare maps of a closed surface with the cuts of voxflat's."""
    ours = made_by(["voxflat"], job | {"options": CUT_OPEN}, options)
    if not ours:
        return
    points, faces = ours["voxflat"].points, ours["voxflat"].faces.astype(np.int64)
    peers = [name for name in options.makers if name != "voxflat"]
    made = ours | made_by(peers, {"points": points, "faces": faces}, options)
    comparison = compared(points, faces, made, options.whole_sources)
    print_maps(
        title, comparison, made, "voxflat's time contains its cuts, and of voxels the surface; peers begin with these."
    )
