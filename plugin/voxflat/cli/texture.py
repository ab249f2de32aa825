"""The command `voxflat texture`."""

from __future__ import annotations

from pathlib import Path

import click

from voxflat.cli import options
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output
from voxflat.maps.flat_map import load
from voxflat.maps.texture import TEXTURED_ENDINGS


@click.command(
    "texture",
    epilog="""\b
Examples:
  voxflat texture map.npz bricks.jpg -o bricks.obj
  voxflat texture map.npz chessboard.png --texel-size 0.1 --repeat -o chessboard.glb
""",
)
@click.argument("map_", metavar="MAP", type=FILE)
@click.argument("picture", metavar="PICTURE", type=FILE)
@click.option(
    "-o",
    "--output",
    type=FILE,
    required=True,
    metavar="OUT",
    help="The surface's file: .obj (with .mtl and .png), .vtp (with .png), .glb, or .ply with colours at its points.",
)
@click.option(
    "--texel-size", type=float, metavar="MM", help="Side of a pixel of PICTURE, mm.  [default: just cover the map]"
)
@click.option("--repeat", is_flag=True, help="PICTURE goes on beyond its borders.")
@options.debug
def command(map_: Path, picture: Path, output: Path, texel_size: float | None, repeat: bool) -> None:
    """Map a picture onto a surface.

    MAP is a file that voxflat flatten made; PICTURE is laid over it in its proportions, centred, and by it onto the
    surface. For .ply triangles are split where colours at their corners could not carry the picture.
    """
    check_output(output, TEXTURED_ENDINGS, (map_, picture))
    textured = load(map_).textured(picture, texel_size, repeat=repeat)
    if output.suffix.lower() == ".ply":
        textured = textured.subdivided()
    textured.save(output)
    click.echo(f"{len(textured.points)} points, {len(textured.faces)} triangles\nsaved as {output}")
