"""The command `voxflat surface`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.arguments import log
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.options import OUT
from voxflat.cli.output import check_output, print_json
from voxflat.distortion.figures import json_ready
from voxflat.errors import InputError
from voxflat.io.meshes import check_mesh_name
from voxflat.io.patches import FLAT_PATCH_ENDINGS, PATCH_ENDING
from voxflat.io.volumes import check_volume_name, write_volume


@cloup.command(
    "surface",
    epilog="""\b
Examples:
  voxflat surface wm.nii.gz --threshold 0.5 --repair voxels -o wm.surf.gii
  voxflat surface labels.nii.gz --label 3 --repair voxels --repaired repaired.nii.gz -o label3.vtp
""",
)
@options.input_
@options.making
@options.output(
    "The surface's file: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as lh.white.",
    cloup.option(
        "--repaired", type=OUT, metavar="FILE", help="Write the changed voxels as labels: 1 removed, 2 added."
    ),
)
@options.run(options.threads, options.memory_limit)
def command(
    input_: Path, output: Path, repaired: Path | None, writing: dict[str, Any], as_json: bool, **given: Any
) -> None:
    """Make the surface of a volume, or check and convert a mesh.

    Vertices are surface voxels, at places finer than the grid; nothing is interpolated. FreeSurfer's files are written
    in tkRAS with the footer that says where it lies, all others in scanner RAS, as tools take them with volumes.
    """
    check_output(output, **writing)
    if repaired is not None:
        check_output(repaired)
        check_volume_name(repaired)
        if given["repair"] in ("none", "cuts"):
            raise InputError(
                f"there are no changed voxels to write to {repaired}; give --repair voxels, or leave it out"
            )
    if not output.name.lower().endswith((*FLAT_PATCH_ENDINGS, PATCH_ENDING)):  # of which saving says more
        check_mesh_name(output)
    with bars() as shown:
        made = surface_of(input_, given, shown.progress)
        for remark in made.remarks:
            log.warning(remark)
    if repaired is not None:
        changed = made.changed_voxels()
        write_volume(repaired, changed, made.metadata["affine"], made.provenance)
    made.save(output, **writing)
    if as_json:
        size = {"vertices": len(made), "triangles": len(made.faces)}
        told = {"output": str(output), **size, "metadata": made.metadata, "warnings": list(made.remarks)}
        print_json(json_ready(told))
    else:
        click.echo(f"{len(made)} vertices, {len(made.faces)} triangles\nsaved as {output}")
