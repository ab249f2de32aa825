"""The command `voxflat layers`."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.io.volumes import VOLUME_ENDINGS, check_volume_name, write_volume
from voxflat.laminar.rim import Rim, rim
from voxflat.maps.depth import LAYERINGS
from voxflat.surfaces.standard.pattern import SIDES


def _label(ctx: click.Context, param: click.Parameter, value: str | None) -> int | Path | None:
    """Convert a text to a label, or to the path of a mask, which is an input."""
    if value is None or value.lstrip("-").isdecimal():
        return None if value is None else int(value)
    path: Path = options.FILE.convert(value, param, ctx)
    return path


@options.command(
    "layers",
    "voxflat layers rim.nii.gz -n 20 -o layers.nii.gz",
    "voxflat layers ribbon.mgz --hemisphere left -n 3 --layering equidistant -o lh.layers.nii.gz",
    "voxflat layers labels.nii.gz --inner 1 --grey 2 --outer 5 -n 10 -o layers.nii.gz",
)
@options.input_
@options.section(
    "Input",
    *(
        option_of(rim, name, metavar="LABEL|FILE", callback=_label, help=f"{part}: a label or a mask file.{default}")
        for name, part, default in (
            ("inner", "Inner border (white matter)", "  [default: 2]"),
            ("outer", "Outer border (cerebrospinal fluid)", "  [default: 1, or all other voxels if --inner is given]"),
            ("grey", "Grey matter", "  [default: 3]"),
        )
    ),
    option_of(rim, "hemisphere", type=click.Choice(SIDES)),
    option_of(rim, "spacing", metavar="X,Y,Z", callback=options.three(float, "0.5,0.5,0.5")),
)
@options.section(
    "Layers",
    options.value("--count", "N", "Number of layers.", "-n", type=int, required=True),
    option_of(Rim.layers, "layering", type=click.Choice(LAYERINGS), until=", as in"),
)
@options.output(
    "Output volume for the layers, numbered from 1 at the inner border to N at the outer border. Volumes of the depth "
    "and the thickness are written to the same directory, with _depth and _thickness added to the name."
)
@options.run(options.threads, options.memory_limit)
def layers_command(
    input_: Path, output: Path, count: int, layering: str, writing: dict[str, Any], **given: Any
) -> None:
    """Divide the grey matter of a segmentation into layers.

    INPUT is a rim as used for layer fMRI: a label volume of the grey matter and its borders, for either a patch or a
    complete hemisphere. No surfaces are needed.
    """
    check_volume_name(output)
    ending = next(ending for ending in sorted(VOLUME_ENDINGS, key=len)[::-1] if output.name.lower().endswith(ending))
    beside = [
        output.with_name(f"{output.name[: -len(ending)]}_{name}{output.name[-len(ending) :]}")
        for name in ("depth", "thickness")
    ]
    check_output(output, beside=beside, **writing)
    with bars() as shown:
        made = rim(input_, **given, progress=shown.progress)
        volumes = [made.layers(count, layering), made.depth(layering), made.thickness()]
    for path, volume in zip((output, *beside), volumes, strict=True):
        write_volume(path, volume.data, volume.affine, volume.provenance)
    voxels, thickness = len(made.values.depth), float(np.median(made.values.thickness))
    report(
        {"output": [str(path) for path in (output, *beside)], "voxels": voxels, "median_thickness": thickness},
        f"{voxels} voxels of grey matter, median thickness {thickness:.2f} mm\nsaved as {output}, {beside[0]} and "
        f"{beside[1]}",
    )
