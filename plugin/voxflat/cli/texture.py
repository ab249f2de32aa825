"""The command `voxflat texture`."""

from __future__ import annotations

from pathlib import Path

import click

from voxflat.cli import options
from voxflat.cli.options import FILE, OUT
from voxflat.cli.output import check_output, print_json
from voxflat.io.reading import reading
from voxflat.maps.flat_map import load
from voxflat.maps.texture import TEXTURED_ENDINGS, files_beside


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
    type=OUT,
    required=True,
    metavar="OUT",
    help="The surface's file: .obj (with .mtl and .png), .vtp (with .png), .glb, or .ply with colours at its points.",
)
@click.option(
    "--texel-size", type=float, metavar="MM", help="Side of a pixel of PICTURE, mm.  [default: just cover the map]"
)
@click.option("--repeat", is_flag=True, help="PICTURE goes on beyond its borders.")
@options.beside
@options.as_json
@options.debug
def command(
    map_: Path,
    picture: Path,
    output: Path,
    texel_size: float | None,
    repeat: bool,
    sidecar: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Map a picture onto a surface.

    MAP is a file that voxflat flatten made; PICTURE is laid over it in its proportions, centred, and by it onto the
    surface. For .ply triangles are split where colours at their corners could not carry the picture.
    """
    check_output(output, TEXTURED_ENDINGS, beside=files_beside(output), sidecar=sidecar, overwrite=overwrite)
    with reading() as files:
        textured = load(map_).textured(picture, texel_size, repeat=repeat)
    textured = textured.with_provenance({**textured.provenance, "files": files})
    if output.suffix.lower() == ".ply":
        textured = textured.subdivided()
    textured.save(output, sidecar=sidecar, overwrite=overwrite)
    if as_json:
        size = {"points": len(textured.points), "triangles": len(textured.faces)}
        print_json({"output": str(output), **size, "provenance": textured.provenance})
    else:
        click.echo(f"{len(textured.points)} points, {len(textured.faces)} triangles\nsaved as {output}")
