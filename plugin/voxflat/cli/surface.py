"""The command `voxflat surface`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from voxflat.arguments import log
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output
from voxflat.errors import InputError
from voxflat.io.volumes import write_volume


@click.command(
    "surface",
    epilog="""\b
Examples:
  voxflat surface wm.nii.gz --threshold 0.5 --repair voxels -o wm.surf.gii
  voxflat surface labels.nii.gz --label 3 --repair voxels --repaired repaired.nii.gz -o label3.vtp
""",
)
@options.input_
@click.option(
    "-o",
    "--output",
    type=FILE,
    required=True,
    metavar="OUT",
    help="The surface's file: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as lh.white.",
)
@options.volume
@options.making
@click.option("--repaired", type=FILE, metavar="FILE", help="Write the changed voxels as labels: 1 removed, 2 added.")
@options.memory_limit
@options.debug
def command(input_: Path, output: Path, repaired: Path | None, **given: Any) -> None:
    """Make the surface of a volume, or check and convert a mesh.

    Vertices are surface voxels, at places finer than the grid; nothing is interpolated. FreeSurfer's files are written
    in tkRAS with the footer that says where it lies, all others in scanner RAS, as tools take them with volumes.
    """
    check_output(output, (), (input_,))
    with bars() as shown:
        made = surface_of(input_, given, shown)
        for remark in made.remarks:
            log.warning(remark)
    if repaired is not None:
        if given["repair"] in ("none", "cuts"):
            raise InputError(
                f"there are no changed voxels to write to {repaired}; give --repair voxels, or leave it out"
            )
        changed = made.changed_voxels()
        write_volume(repaired, changed, made.metadata["affine"])
    made.save(output)
    click.echo(f"{len(made)} vertices, {len(made.faces)} triangles\nsaved as {output}")
