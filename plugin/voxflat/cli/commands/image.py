"""The command `voxflat image`."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import load_atlas, saved_kind
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.cli.overlay_options import check_depth, depth_options
from voxflat.errors import InputError
from voxflat.io.provenance import saving
from voxflat.io.reading import reading
from voxflat.maps.flat_map import FlatMap, load
from voxflat.maps.image_files import IMAGE_ENDINGS, STACK_ENDINGS
from voxflat.maps.sampling import INTERPOLATIONS


@cloup.command(
    "image",
    epilog="""\b
Examples:
  voxflat image map.npz --volume t1.nii.gz --interpolation linear --depth 2 -o t1.png
  voxflat image map.npz --volume areas.nii.gz --pixel-size 0.5 -o areas.nii.gz
  voxflat image map.npz --volume face.obj -o face_flat.png
  voxflat image map.npz --heat-map -o distortion.png
  voxflat image atlas.npz --volume lh.sulc -o page.png
  voxflat image map.npz --volume zstats.dscalar.nii --channel "2BK-0BK" -o zstat.png
  voxflat image map.npz --volume bold.nii.gz --interpolation linear -o bold_flat.nii.gz
  voxflat image map.npz --volume lh.bold.func.gii --time-step 2 -o bold_flat.zarr
  voxflat image map.npz --volume t1.nii.gz --interpolation linear --fraction 0.1,0.3,0.5,0.7,0.9 -o layers.tif
  voxflat image map.npz --volume bold.nii.gz --interpolation linear --fraction 0.25,0.5,0.75 --average -o bold.nii.gz
""",
)
@cloup.argument("map_", metavar="MAP", type=FILE)
@options.section(
    "Data",
    options.reads(
        "--volume", "Volume to resample (also OME-Zarr); for the map of a mesh, an overlay or the mesh's own texture."
    ),
    options.value(
        "--channel",
        "NAME|N",
        "Map to show from a GIFTI, CIFTI or 4-D file with several maps: its name or number (from 0).  [default: "
        "all; a .png can hold only one]",
    ),
    options.flag("--heat-map", "Show the local distortion of the map instead of a volume."),
    options.period,
    options.time_step,
)
@options.section(
    "Sampling",
    *depth_options("Several give one image each."),
    options.flag("--average", "Average over all depths instead of writing one image per depth."),
    options.choice(
        "--interpolation",
        INTERPOLATIONS,
        'Interpolation between voxels. "majority" takes the most frequent label of the surrounding voxels over '
        "all depths.  [default: nearest for integers, which may be labels; linear otherwise]",
    ),
)
@options.output(
    "Output file: .png to look at, or .tif, .tiff, .nii, .nii.gz (float32) or .npy for the values. Several images can "
    "also be written to .zarr.",
    options.value(
        "--pixel-size",
        "MM",
        "Side length of a pixel, in mm.  [default: half the voxel size or edge length; for an atlas, at most half "
        "the gap between patches]",
        type=float,
    ),
)
@options.run(options.quiet)
def command(
    map_: Path,
    volume: Path | None,
    heat_map: bool,
    output: Path,
    pixel_size: float | None,
    writing: dict[str, Any],
    as_json: bool,
    quiet: bool,
    **given: Any,
) -> None:
    """Resample a volume, or the distortion, onto a flat map.

    MAP is a file written by voxflat flatten or voxflat patches. For an atlas of patches, the page of all patches is
    shown, and its heat map is of C, the factor by which lengths change. A PNG shows scalars in grey (1st to 99th
    percentile), labels in one colour each, and colours unchanged; it is transparent outside the map. The PNG of a heat
    map is a figure with a colour bar. All other formats hold the values, with NaN outside the map. A series is read,
    sampled and written frame by frame, so its length is not limited by memory.
    """
    if heat_map == (volume is not None):
        raise click.UsageError("Give either --volume or --heat-map.")
    _check_options(heat_map, given)
    how = {key: value[0] if isinstance(value, tuple) and len(value) == 1 else value for key, value in given.items()}
    how = {key: value for key, value in how.items() if value is not None}
    check_output(output, tuple(dict.fromkeys((*IMAGE_ENDINGS, *STACK_ENDINGS))), **writing)
    with bars(quiet), reading() as files:
        flat_map = _load(map_)
        if "fraction" in how and not isinstance(flat_map, FlatMap):
            raise InputError(
                "--fraction needs a pial surface, which an atlas does not have. Give --depth in mm instead."
            )
        if volume is None:
            picture = flat_map.heat_map(pixel_size)
        else:
            stack = flat_map.images(volume, pixel_size, **how)
            picture = stack[0]
    picture = picture._with_provenance({**picture.provenance, "files": files})
    count, step = 1, None
    if volume is not None:
        _check_overlap(picture.data[..., 3] > 0 if picture.is_colour else ~np.isnan(picture.data), volume)
    if volume is not None and len(stack) > 1:
        count = len(stack)
        step = None if stack.timing is None else stack.timing.step
        with bars(quiet) as shown:
            stack._with_provenance({**stack.provenance, "files": files}).save(
                output, **writing, progress=shown.progress
            )
    elif heat_map and output.suffix.lower() == ".png":
        from voxflat import figures  # imports matplotlib

        if isinstance(flat_map, FlatMap):
            drawn = figures.heat_map(flat_map, pixel_size)
        else:
            drawn = figures.atlas_heat_map(flat_map, pixel_size)
        with saving(output, picture.provenance, **writing):
            figures.save(drawn, output, picture.provenance)
    else:
        picture.save(output, **writing)
    height, width = picture.data.shape[:2]
    if as_json:
        size = {"images": count, "width": width, "height": height, "pixel_size": picture.pixel_size}
        print_json({"output": str(output), **size, "time_step": step, "provenance": picture.provenance})
    elif not quiet:
        images = "" if count == 1 else f"{count} images of "
        apart = "" if step is None else f", {step:g} s apart"
        click.echo(f"{images}{width} x {height} pixels of {picture.pixel_size:g} mm{apart}\nsaved as {output}")


def _check_options(heat_map: bool, given: dict[str, Any]) -> None:
    """Raise a usage error if options contradict each other."""
    if heat_map and (unused := [name for name, value in given.items() if value not in (None, False)]):
        raise click.UsageError(", ".join(f"--{name.replace('_', '-')}" for name in unused) + ": only with --volume.")
    check_depth(given)


def _check_overlap(covered: Any, volume: Path) -> None:
    if not covered.any():
        raise InputError(
            f"{volume} does not overlap the map, so the image would be empty. Compare the affines with voxflat check."
        )


def _load(path: Path) -> FlatMap | Atlas:
    """Load a flat map or an atlas; `load` raises an error for other files."""
    return load_atlas(path) if saved_kind(path) == "atlas" else load(path)
