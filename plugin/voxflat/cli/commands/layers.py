"""The commands for segmented grey matter: `voxflat layers`, `columns`, `profile` and `paint`."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import channel_of
from voxflat.cli.output import FIGURE_ENDINGS, check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.io.provenance import saving
from voxflat.io.reading import reading
from voxflat.io.volumes import VOLUME_ENDINGS, check_volume_name, write_volume
from voxflat.laminar.columns import check_number
from voxflat.laminar.profile import PROFILE_ENDINGS
from voxflat.laminar.rim import Rim, rim
from voxflat.maps.depth import LAYERINGS
from voxflat.maps.flat_map import load_saved
from voxflat.maps.missing import NAN_POLICIES


def _label(ctx: click.Context, param: click.Parameter, value: str | None) -> int | Path | None:
    """Convert a text to a label, or to the path of a mask, which is an input."""
    if value is None or value.lstrip("-").isdecimal():
        return None if value is None else int(value)
    path: Path = options.FILE.convert(value, param, ctx)
    return path


_parts = (
    *(
        option_of(rim, name, metavar="LABEL|FILE", callback=_label, help=f"{part}: a label or a mask file.{default}")
        for name, part, default in (
            ("inner", "Inner border (white matter)", "  [default: 2]"),
            ("outer", "Outer border (cerebrospinal fluid)", "  [default: 1, or all other voxels if --inner is given]"),
            ("grey", "Grey matter", "  [default: 3]"),
        )
    ),
    option_of(rim, "hemisphere", type=options.SIDE, metavar="[left|right]"),
    option_of(rim, "spacing", metavar="X,Y,Z", callback=options.several(3, float, "0.5,0.5,0.5")),
)
_rim_options = options.section("Input", options.channel, *_parts)

_layering = option_of(Rim.layers, "layering", type=click.Choice(LAYERINGS), until=", as in")


@options.command(
    "layers",
    "voxflat layers rim.nii.gz -n 20 -o layers.nii.gz",
    "voxflat layers ribbon.mgz --hemisphere left -n 3 --layering equidistant -o lh.layers.nii.gz",
    "voxflat layers labels.nii.gz --inner 1 --grey 2 --outer 5 -n 10 -o layers.nii.gz",
)
@options.input_
@_rim_options
@options.section(
    "Layers",
    options.value("--count", "N", "Number of layers.", "-n", type=int, required=True),
    _layering,
    options.flag(
        "--streamlines",
        "Also write the direction of the column of each voxel as unit vectors (right, anterior, superior), with "
        "_streamlines added to the name.",
    ),
)
@options.output(
    "Output volume for the layers, numbered from 1 at the inner border to N at the outer border. Volumes of the depth "
    "and the thickness are written to the same directory, with _depth and _thickness added to the name."
)
@options.run(options.threads, options.memory_limit)
def layers_command(
    input_: Path, output: Path, count: int, layering: str, streamlines: bool, writing: dict[str, Any], **settings: Any
) -> None:
    """Divide the grey matter of a segmentation into layers.

    INPUT is a rim as used for layer fMRI: a label volume of the grey matter and its borders, for either a patch or a
    complete hemisphere. No surfaces are needed.
    """
    check_volume_name(output)
    ending = next(ending for ending in sorted(VOLUME_ENDINGS, key=len)[::-1] if output.name.lower().endswith(ending))
    beside = [
        output.with_name(f"{output.name[: -len(ending)]}_{name}{output.name[-len(ending) :]}")
        for name in ("depth", "thickness", *(["streamlines"] if streamlines else []))
    ]
    check_output(output, beside=beside, **writing)
    with bars() as bar:
        grey = rim(channel_of(input_, settings.pop("channel"), settings), **settings, progress=bar.progress)
        volumes = [grey.layers(count, layering), grey.depth(layering), grey.thickness()]
        volumes += [grey.streamlines()] if streamlines else []
    with saving(output, volumes[0].provenance or {}, **writing):
        for path, volume in zip((output, *beside), volumes, strict=True):
            volume = volume.in_unit("mm")
            write_volume(path, volume.data, volume.affine, volume.provenance, is_vectors=volume.is_vectors)
    voxels, thickness = len(grey.values.depth), float(np.median(grey.values.thickness))
    report(
        {"output": [str(path) for path in (output, *beside)], "voxels": voxels, "median_thickness": thickness},
        f"{voxels} voxels of grey matter, median thickness {thickness:.3g} mm\nsaved as "
        f"{', '.join(map(str, (output, *beside[:-1])))} and {beside[-1]}",
    )


@options.command(
    "columns",
    "voxflat columns rim.nii.gz -n 1000 -o columns.nii.gz",
    "voxflat columns ribbon.mgz --hemisphere right --area 2 -o rh.columns.nii.gz",
)
@options.input_
@_rim_options
@options.section(
    "Columns",
    options.value("--count", "N", "Number of columns. Either --count or --area is required.", "-n", type=int),
    option_of(Rim.columns, "area", metavar="MM2", type=options.NUMBER),
)
@options.output("Output volume for the columns, numbered from 1; 0 outside the grey matter.")
@options.run(options.seed, options.threads, options.memory_limit)
def columns_command(
    input_: Path,
    output: Path,
    count: int | None,
    area: float | None,
    seed: int,
    writing: dict[str, Any],
    **settings: Any,
) -> None:
    """Divide the grey matter of a segmentation into columns.

    INPUT is a rim, as for voxflat layers. The centres of the columns are spread evenly over the surface halfway between
    the borders, and each voxel belongs to the nearest centre along that surface. All voxels of a column are connected.
    """
    check_volume_name(output)
    check_output(output, **writing)
    check_number(count, area)
    with bars() as bar:
        whole = rim(channel_of(input_, settings.pop("channel"), settings), **settings, progress=bar.progress)
        columns = whole.columns(count, area=area, seed=seed, progress=bar.progress)
    with saving(output, columns.provenance, **writing):
        write_volume(output, columns.volume.data, columns.volume.in_unit("mm").affine, columns.provenance)
    median = float(np.median(columns.areas))
    report(
        {"output": str(output), "columns": len(columns), "median_area": median, "provenance": columns.provenance},
        f"{len(columns)} columns, median area {median:.3g} mm²\nsaved as {output}",
    )


@options.command(
    "profile",
    "voxflat profile rim.nii.gz --volume bold.nii.gz -n 20 -o profile.tsv --figure profile.png",
    "voxflat profile rim.nii.gz --volume zstat.nii.gz --regions areas.nii.gz -n 10 -o profiles.csv",
    "voxflat profile rim.nii.gz --volume bold.nii.gz --channel 0 --map map.npz --regions drawn.svg -o profile.tsv",
)
@options.input_
@options.section(
    "Input",
    options.value("--rim-channel", "NAME|N", "Channel of INPUT: its name, or its number from 0.", "rim_channel"),
    *_parts,
)
@options.section(
    "Data",
    options.reads("--volume", "Volume to measure, on any grid. A 4-D file has several channels.", required=True),
    options.value("--channel", "NAME|N", "Channel to measure: its name, or its number from 0.  [default: all]"),
    option_of(Rim.profile, "interpolation", type=click.Choice(["linear", "nearest"])),
    option_of(Rim.profile, "nan_policy", type=click.Choice(NAN_POLICIES)),
)
@options.section(
    "Regions",
    options.reads(
        "--regions",
        "Mask or label volume, with one profile per label; with --map, regions drawn on that map, in any format that "
        "voxflat regions reads.  [default: all grey matter]",
    ),
    options.reads("--map", "Map of this rim (voxflat flatten --rim) on which the regions were drawn.", metavar="MAP"),
    options.value("--layer", "NAME", "Layer of an .svg file that contains the regions.  [default: rois]"),
)
@options.section(
    "Layers",
    options.value("--count", "N", "Number of layers.", "-n", type=int, default=20),
    _layering,
)
@options.output(
    "Output table (.tsv or .csv) with the columns region, layer, depth, mean, sd, voxels and, if there are several, "
    "channel.",
    options.writes("--figure", "Also draw the profiles, with bands of one standard deviation (.png, .svg or .pdf)."),
    options.value("--label", "TEXT", "Label of the vertical axis of the figure.  [default: the file name]"),
)
@options.run(options.threads, options.memory_limit)
def profile_command(
    input_: Path,
    volume: Path,
    regions: Path | None,
    map: Path | None,
    layer: str | None,
    output: Path,
    figure: Path | None,
    label: str | None,
    writing: dict[str, Any],
    **settings: Any,
) -> None:
    """Average a volume along cortical depth within regions.

    INPUT is a rim, as for voxflat layers. The table contains the mean and the standard deviation over the voxels of
    each layer and region. With --map, a voxel belongs to the region that contains its column.
    """
    if map is not None and regions is None:
        raise click.UsageError("--map requires --regions.")
    if regions is not None and map is None and regions.suffix.lower() in (".svg", ".json"):
        raise click.UsageError(f"--regions {regions.name} contains drawn regions and requires --map.")
    if layer is not None and map is None:
        raise click.UsageError("--layer requires --map.")
    if label is not None and figure is None:
        raise click.UsageError("--label requires --figure.")
    check_output(output, PROFILE_ENDINGS, **writing)
    if figure is not None:
        check_output(figure, FIGURE_ENDINGS, **writing)
    sampling = {name: settings.pop(name) for name in ("channel", "interpolation", "nan_policy", "count", "layering")}
    for path in filter(None, (volume, regions, map)):
        path.stat()  # a missing file is reported before depths are measured
    with bars() as bar:
        drawn = regions if map is None else load_saved(map).regions(regions, layer=layer or "rois")
        grey = rim(channel_of(input_, settings.pop("rim_channel"), settings), **settings, progress=bar.progress)
        profile = grey.profile(volume, drawn, **sampling)
    if figure is not None:
        from voxflat import figures  # imports matplotlib

        drawing = figures.profile(profile, label=label)
    profile.save(output, **writing)
    if figure is not None:
        figures.save(drawing, figure, profile.provenance)
    files = [str(path) for path in (output, figure) if path is not None]
    missing = int(profile.missing.sum(axis=0).max())
    left = "are left out" if sampling["nan_policy"] == "omit" else "make the values of their layers NaN"
    without = f"{missing} voxels have no finite value and {left}\n" if missing else ""
    content = {
        "files": files,
        "regions": list(profile.names),
        "voxels": profile.voxels.sum(axis=1).tolist(),
        "missing": profile.missing.tolist(),
        "provenance": profile.provenance,
    }
    parts = "1 region" if len(profile.names) == 1 else f"{len(profile.names)} regions"
    counted = f"{parts} with {profile.voxels.sum(axis=(0, 1)).max()} voxels in {len(profile.depths)} layers"
    report(content, f"{counted}\n{without}saved as {' and '.join(files)}")


@options.command(
    "paint",
    "voxflat image map.npz --volume t1.nii.gz --depths 21 -o flat_volume.nii.gz",
    "voxflat paint rim.nii.gz --map map.npz --values labels_drawn.nii.gz -o labels.nii.gz",
)
@options.input_
@_rim_options
@options.section(
    "Flat volume",
    options.reads("--map", "Map of the rim, made by voxflat flatten --rim.", required=True),
    options.reads(
        "--values",
        "Flat volume with the shape of the output of voxflat image --depths, or labels drawn in it.",
        required=True,
    ),
    option_of(Rim.paint, "layering", type=click.Choice(LAYERINGS)),
    option_of(
        Rim.paint, "pixel_size", type=options.NUMBER, metavar="MM", default="from the file, or as for voxflat image"
    ),
    option_of(Rim.paint, "background", type=float),
)
@options.output("Output volume with the grid of INPUT.")
@options.run(options.threads, options.memory_limit)
def paint_command(
    input_: Path,
    values: Path,
    output: Path,
    layering: str,
    pixel_size: float | None,
    background: float,
    writing: dict[str, Any],
    **settings: Any,
) -> None:
    """Transfer a flat volume to the voxels of the grey matter.

    INPUT is the rim from which the map was made. Each voxel takes the value of one pixel, at the position of its column
    on the map and in its layer. Values are not interpolated, so labels are transferred exactly.
    """
    check_volume_name(output)
    check_output(output, **writing)
    with bars() as bar, reading() as files:
        flat_map = load_saved(settings.pop("map"))
        grey = rim(channel_of(input_, settings.pop("channel"), settings), **settings, progress=bar.progress)
        sampling: dict[str, Any] = {"layering": layering, "pixel_size": pixel_size, "background": background}
        painted = grey.paint(values, flat_map, **sampling)
    record = {**(painted.provenance or {}), "files": files}
    with saving(output, record, **writing):
        write_volume(output, painted.data, painted.affine, record)
    count = int(np.count_nonzero(painted.data != background))
    text = f"{count} of {len(grey.values.depth)} voxels of grey matter have a value\nsaved as {output}"
    report({"output": str(output), "voxels": count, "provenance": record}, text)
