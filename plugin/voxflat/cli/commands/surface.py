"""The command `voxflat surface`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.arguments import log
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
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
@options.surface_options
@options.output(
    "Output file for the surface: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as lh.white.",
    options.writes(
        "--repaired", "Also write the voxels that the repair changed as a label volume: 1 for removed, 2 for added."
    ),
)
@options.run(options.threads, options.memory_limit)
def command(
    input_: Path, output: Path, repaired: Path | None, writing: dict[str, Any], as_json: bool, **given: Any
) -> None:
    """Extract the surface of a volume, or check and convert a mesh.

    Each vertex of a volume's surface is a surface voxel at a subvoxel position; no isosurface is made. FreeSurfer files
    are written in tkRAS coordinates with a footer that locates them in scanner space. All other formats are written in
    scanner RAS coordinates, which other tools expect for display with volumes.
    """
    check_output(output, **writing)
    if repaired is not None:
        check_output(repaired)
        check_volume_name(repaired)
        if given["repair"] in ("none", "cuts"):
            raise InputError(
                f"--repair {given['repair']} changes no voxels to write to {repaired}. Give --repair voxels, or leave "
                "out --repaired."
            )
    if not output.name.lower().endswith((*FLAT_PATCH_ENDINGS, PATCH_ENDING)):  # save() has a better message for these
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
        content = {"output": str(output), **size, "metadata": made.metadata, "warnings": list(made.remarks)}
        print_json(json_ready(content))
    else:
        click.echo(f"{len(made)} vertices, {len(made.faces)} triangles\nsaved as {output}")
