"""The command `voxflat texture`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.cli.parameter_options import option_of
from voxflat.io.reading import reading
from voxflat.maps.flat_map import FlatMap, load
from voxflat.maps.textures.textured import TEXTURED_ENDINGS, files_beside


@cloup.command(
    "texture",
    epilog="""\b
Examples:
  voxflat texture map.npz bricks.jpg -o bricks.obj
  voxflat texture map.npz chessboard.png --texel-size 0.1 --repeat -o chessboard.glb
""",
)
@cloup.argument("map_", metavar="MAP", type=FILE)
@cloup.argument("picture", metavar="PICTURE", type=FILE)
@options.section(
    "Picture",
    option_of(FlatMap.textured, "texel_size", type=float, metavar="MM"),
    option_of(FlatMap.textured, "repeat", is_flag=True, help="Repeat the picture beyond its borders."),
)
@options.output(
    "Output file for the textured surface: .obj (with .mtl and .png), .vtp (with .png), .glb, or .ply (with vertex "
    "colours)."
)
@options.run()
def command(
    map_: Path,
    picture: Path,
    output: Path,
    texel_size: float | None,
    repeat: bool,
    writing: dict[str, Any],
    as_json: bool,
) -> None:
    """Map a picture onto a surface as a texture.

    MAP is a file written by voxflat flatten. PICTURE is centred on the flat map, keeps its aspect ratio, and is carried
    from there to the surface. For .ply, triangles are subdivided where vertex colours would be too coarse.
    """
    check_output(output, TEXTURED_ENDINGS, beside=files_beside(output), **writing)
    with reading() as files:
        textured = load(map_).textured(picture, texel_size, repeat=repeat)
    textured = textured._with_provenance({**textured.provenance, "files": files})
    if output.suffix.lower() == ".ply":
        textured = textured.subdivided()
    textured.save(output, **writing)
    if as_json:
        size = {"points": len(textured.points), "triangles": len(textured.faces)}
        print_json({"output": str(output), **size, "provenance": textured.provenance})
    else:
        click.echo(f"{len(textured.points)} points, {len(textured.faces)} triangles\nsaved as {output}")
