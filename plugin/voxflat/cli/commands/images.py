"""The commands `voxflat image` and `voxflat texture`, which transfer pictures to and from flat maps."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import load_atlas, saved_kind
from voxflat.atlases.pieces import FIGURES
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import check_numbers, load_maps
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, report
from voxflat.cli.overlay_options import check_depth, depth_options
from voxflat.cli.parameter_options import option_of
from voxflat.errors import InputError
from voxflat.io.grid import in_unit
from voxflat.io.provenance import saving
from voxflat.io.reading import reading
from voxflat.maps.flat_map import HEATS, FlatMap
from voxflat.maps.image_files import IMAGE_ENDINGS, STACK_ENDINGS
from voxflat.maps.missing import NAN_POLICIES
from voxflat.maps.plane import Planar
from voxflat.maps.sampling import INTERPOLATIONS, PROJECTIONS
from voxflat.maps.textures.textured import TEXTURED_ENDINGS, files_beside
from voxflat.pipeline.flat_series import FlatSeries, load_series

_VOLUME = (
    "Volume to resample (including OME-Zarr images). For the map of a mesh, an overlay or the texture of the mesh is "
    "also accepted."
)


@options.command(
    "image",
    "voxflat image map.npz --volume t1.nii.gz --interpolation linear --depth 2 -o t1.png",
    "voxflat image map.npz --volume areas.nii.gz --pixel-size 0.5 -o areas.nii.gz",
    "voxflat image map.npz --volume face.obj -o face_flat.png",
    "voxflat image map.npz --heat-map -o distortion.png",
    "voxflat image group.npz --heat-map --of spread -o spread.png",
    "voxflat image atlas.npz --volume lh.sulc -o page.png",
    'voxflat image map.npz --volume zstats.dscalar.nii --channel "2BK-0BK" -o zstat.png',
    "voxflat image map.npz --volume bold.nii.gz --interpolation linear -o bold_flat.nii.gz",
    "voxflat image map.npz --volume lh.bold.func.gii --time-step 2 -o bold_flat.zarr",
    "voxflat image map.npz --volume t1.nii.gz --interpolation linear --fraction 0.1,0.3,0.5,0.7,0.9 -o layers.tif",
    "voxflat image map.npz --volume bold.nii.gz --interpolation linear --depths 21 -o flat_volume.nii.gz",
    "voxflat image map.npz --volume bold.nii.gz --interpolation linear --fraction 0.25,0.5,0.75 "
    "--projection mean -o bold.nii.gz",
    "voxflat image map.npz --volume stack.ome.tif --depth -10:10:1 -o layers.ome.tif",
    "voxflat image movie.npz --volume frame_*.tif --depth -4:4:2 --metric --time-step 60 -o movie.ome.tif",
)
@options.map_
@cloup.argument(
    "further", metavar="[VOLUME]...", type=FILE, nargs=-1, help="Volumes of further frames, after --volume."
)
@options.section(
    "Data",
    options.reads("--volume", _VOLUME),
    options.value(
        "--channel",
        "NAME|N",
        "Map to show from a GIFTI, CIFTI or 4-D file with several maps: its name, or its number from 0.  "
        "[default: all; a .png can hold only one]",
    ),
    options.flag("--heat-map", "Show the local distortion of the map instead of a volume."),
    options.choice(
        "--of",
        [*HEATS, *FIGURES],
        "Values of --heat-map. Flat maps have distances (errors, the default) and, for the map of a group, spread: how "
        "much people differ. The other values are for atlases; isometric is their default.",
    ),
    option_of(
        FlatSeries.images,
        "metric",
        is_flag=True,
        help="Add three channels for the map of a movie: the area factor and the two stretches of each frame. --volume "
        "may then be omitted.",
    ),
    options.period,
    options.time_step,
)
@options.section(
    "Sampling",
    *depth_options("Several depths produce one image per depth."),
    option_of(
        Planar.images,
        "depths",
        type=int,
        metavar="N",
        until=": layer k",
        note="Replaces --fraction; the images are a flat volume.",
    ),
    option_of(Planar.images, "projection", type=click.Choice(PROJECTIONS), until=" of each channel"),
    options.choice(
        "--nan-policy",
        NAN_POLICIES,
        "At pixels where some of several depths have no value (NaN, infinite, or outside the volume), show the mean or "
        "the maximum of the other depths, or NaN. A sum needs values at all depths.  [default: omit]",
    ),
    options.choice(
        "--interpolation",
        INTERPOLATIONS,
        'Interpolation between voxels. "majority" selects the most frequent label among the surrounding voxels at '
        "all depths.  [default: nearest for integers, which may be labels; linear otherwise, and for intensities in "
        "TIFF or OME-Zarr files]",
    ),
)
@options.output(
    "Output file: .png for viewing, or .tif, .tiff, .nii, .nii.gz (float32) or .npy for the values. Several images can "
    "also be written to a .zarr store.",
    options.value(
        "--pixel-size",
        "MM",
        "Side length of a pixel, in the unit of the map.  [default: half the voxel size or edge length; for an atlas, "
        "at most half the gap between patches]",
        type=options.NUMBER,
    ),
)
@options.run(options.quiet)
def image_command(
    map_: Path,
    further: tuple[Path, ...],
    volume: Path | None,
    heat_map: bool,
    of: str | None,
    metric: bool,
    output: Path,
    pixel_size: float | None,
    writing: dict[str, Any],
    quiet: bool,
    **settings: Any,
) -> None:
    """Resample a volume onto a flat map, or show the distortion of the map.

    MAP is a file written by voxflat flatten or voxflat patches. For an atlas of patches, the image shows the page with
    all patches. A PNG shows scalars in grey (from the 1st to the 99th percentile), each label in its own colour, and
    colours unchanged. Pixels outside the map are transparent. A heat map saved as a PNG is a figure with a colour bar.
    All other formats store the values, with NaN outside the map. A series is read, sampled and written frame by frame,
    so its length is not limited by memory.

    If MAP was written by voxflat movie-map, pass the volumes of all frames in order: --volume frame_*.tif.
    """
    kind = saved_kind(map_)
    if heat_map and kind == "series":
        raise click.UsageError("--heat-map applies to single maps. Pass --metric for the map of a movie.")
    if heat_map == (volume is not None or metric):
        raise click.UsageError("Pass either --volume or --heat-map (for the map of a movie, --volume or --metric).")
    if heat_map and (unused := [name for name, value in settings.items() if value is not None and value is not False]):
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in unused)
        raise click.UsageError(f"{flags}: only with --volume. Pass --volume instead of --heat-map.")
    if of is not None and not heat_map:
        raise click.UsageError("--of requires --heat-map.")
    heat = {} if of is None else {"of": of}
    check_depth(settings)
    sampling = {key: value for key, value in settings.items() if value is not None}
    sampling |= {key: value[0] for key, value in sampling.items() if isinstance(value, tuple) and len(value) == 1}
    endings = () if kind == "series" else IMAGE_ENDINGS
    check_output(output, tuple(dict.fromkeys((*endings, *STACK_ENDINGS))), **writing)
    if kind == "series":
        volumes = None if volume is None else (volume, *further)
        return _movie(map_, volumes, {**sampling, "metric": metric}, output, pixel_size, writing, quiet)
    if further or metric:
        if kind is None:
            load_maps([map_])  # raises an error if there is no such map
        wrong = f"{1 + len(further)} volumes are given" if further else "--metric is given"
        raise InputError(f"{wrong}, but {map_} is a single map. Pass one volume, or the map of voxflat movie-map.")
    with bars(quiet) as bar, reading() as files:
        flat_map: FlatMap | Atlas = load_atlas(map_) if kind == "atlas" else load_maps([map_], bar.progress)[0]
        for name in {"fraction", "depths"} & sampling.keys() if isinstance(flat_map, Atlas) else ():
            raise InputError(
                f"--{name} requires a pial surface, which an atlas does not have. Pass --depth in mm instead."
            )
        stack = None if volume is None else flat_map.images(volume, pixel_size, **sampling)
        picture = flat_map.heat_map(pixel_size, **heat) if stack is None else stack[0]
    picture = picture._with_provenance({**picture.provenance, "files": files})
    if stack is not None and not (picture.data[..., 3] > 0 if picture.is_colour else ~np.isnan(picture.data)).any():
        raise _empty(volume, sampling)
    count, step = 1, None
    if stack is not None and len(stack) > 1:
        count = len(stack)
        step = None if stack.timing is None else stack.timing.step
        with bars(quiet) as bar:
            stack = stack._with_provenance({**stack.provenance, "files": files})
            stack.save(output, **writing, progress=bar.progress)
    elif heat_map and output.suffix.lower() == ".png":
        from voxflat import figures  # imports matplotlib

        if isinstance(flat_map, FlatMap):
            drawn = figures.heat_map(flat_map, pixel_size, **heat)
        else:
            drawn = figures.atlas_heat_map(flat_map, pixel_size, **heat)
        with saving(output, picture.provenance, **writing):
            figures.save(drawn, output, picture.provenance)
    else:
        picture.save(output, **writing)
    height, width = picture.data.shape[:2]
    size = {"images": count, "width": width, "height": height, "pixel_size": picture.pixel_size}
    images = "" if count == 1 else f"{count} images of "
    apart = "" if step is None else f", {step:g} s apart"
    text = f"{images}{width} x {height} pixels of {in_unit(f'{picture.pixel_size:g} mm', flat_map.origin.named_unit)}"
    text += f"{apart}\nsaved as {output}"
    content = {"output": str(output), **size, "time_step": step, "provenance": picture.provenance}
    report(content, text, quiet=quiet)


def _movie(
    map_: Path,
    volumes: tuple[Path, ...] | None,
    sampling: dict[str, Any],
    output: Path,
    pixel_size: float | None,
    writing: dict[str, Any],
    quiet: bool,
) -> None:
    """Write the images of all frames of a series."""
    with bars(quiet) as bar:
        with reading() as files:
            check_numbers(volumes or ())
            movie = load_series(map_).images(volumes, pixel_size, **sampling)
            first = movie[0][0]
        if not (~np.isnan(first.data)).any():
            raise _empty(volumes[0] if volumes else map_, sampling)
        movie = movie._with_provenance({**movie.provenance, "files": files})
        movie.save(output, **writing, progress=bar.progress)
    height, width = first.data.shape[:2]
    depths, step = max(1, len(movie.layers)), None if movie.timing is None else movie.timing.step
    size = {"frames": len(movie), "channels": len(movie.channel_names), "depths": depths}
    extent = " x ".join(f"{count} {name.removesuffix('s' * (count == 1))}" for name, count in size.items())
    pixels = f"{width} x {height} pixels of {movie.pixel_size:g} {first.unit}"
    text = f"{extent} of {pixels}{'' if step is None else f', {step:g} s apart'}\nsaved as {output}"
    content = {"output": str(output), **size, "width": width, "height": height, "pixel_size": movie.pixel_size}
    report({**content, "time_step": step, "provenance": movie.provenance}, text, quiet=quiet)


def _empty(path: object, sampling: dict[str, Any]) -> InputError:
    """Return the error that a volume has no value on the map at the depth that was given, if any."""
    depth = "" if sampling.get("depth") in (None, 0.0) else " at this depth"
    remedy = "Pass a smaller --depth, or compare" if depth else "Compare"
    problem = f"{path} does not overlap the map{depth}, so the image would be empty"
    return InputError(f"{problem}. {remedy} the affines with voxflat check.")


@options.command(
    "texture",
    "voxflat texture map.npz bricks.jpg -o bricks.obj",
    "voxflat texture map.npz chessboard.png --texel-size 0.1 --repeat -o chessboard.glb",
)
@options.map_
@cloup.argument("picture", metavar="PICTURE", type=FILE)
@options.section(
    "Picture",
    option_of(FlatMap.textured, "texel_size", type=options.NUMBER, metavar="MM"),
    option_of(FlatMap.textured, "repeat", is_flag=True, help="Repeat the picture beyond its borders."),
)
@options.output(
    "Output file for the textured surface: .obj (with .mtl and .png), .vtp (with .png), .glb, or .ply (with vertex "
    "colours)."
)
@options.run()
def texture_command(
    map_: Path, picture: Path, output: Path, texel_size: float | None, repeat: bool, writing: dict[str, Any]
) -> None:
    """Map a picture onto a surface as a texture.

    MAP is a file written by voxflat flatten. PICTURE is centred on the flat map, keeps its aspect ratio, and is
    transferred from the map to the surface. For .ply output, triangles are subdivided where vertex colours would be too
    coarse.
    """
    check_output(output, TEXTURED_ENDINGS, beside=files_beside(output), **writing)
    with reading() as files:
        textured = load_maps([map_])[0].textured(picture, texel_size, repeat=repeat)
    textured = textured._with_provenance({**textured.provenance, "files": files})
    if output.suffix.lower() == ".ply":
        textured = textured.subdivided()
    textured.save(output, **writing)
    points, triangles = len(textured.points), len(textured.faces)
    content = {"output": str(output), "points": points, "triangles": triangles, "provenance": textured.provenance}
    report(content, f"{points} points, {triangles} triangles\nsaved as {output}")
