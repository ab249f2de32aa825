"""The command `voxflat patches`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

import voxflat
from voxflat import _options
from voxflat._console import bars
from voxflat._options import FILE
from voxflat._output import check_output

__all__ = ["patches"]

_PICTURES = (".png", ".pdf", ".svg")


@click.command(
    epilog="""\b
Examples:
  voxflat patches lh.white -o atlas.npz
  voxflat patches skull.obj --bound 1.1763 -o atlas.npz --page page.png --picture skull.png
  voxflat patches labels.nii.gz --label 3 --count 200 --json -o atlas.npz
"""
)
@click.argument("surface_", metavar="SURFACE", type=FILE)
@click.option("-o", "--output", type=FILE, required=True, metavar="OUT", help="The atlas's file: .npz.")
@click.option(
    "--max-angle", type=float, metavar="DEGREES", help="Greatest inclination to a patch's plane.  [default: 10]"
)
@click.option("--bound", type=float, metavar="C", help="Instead: the greatest factor by which lengths may change.")
@click.option("--count", type=int, metavar="N", help="Instead: the greatest number of patches.")
@click.option(
    "--seeds",
    type=click.Choice(["curvature", "flattest", "random"]),
    default="curvature",
    help="Where patches begin: compared, the largest first; or as in the paper at the flattest or a random triangle.",
)
@_options.seed
@click.option("--page", type=FILE, metavar="FILE", help="Draw the patches laid out on a page: .png, .pdf or .svg.")
@click.option("--picture", type=FILE, metavar="PNG", help="Draw the surface with its patches in colours.")
@_options.volume
@_options.making
@_options.memory_limit
@_options.threads
@_options.as_json
@_options.quiet
@_options.debug
def patches(
    surface_: Path,
    output: Path,
    page: Path | None,
    picture: Path | None,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Flatten a surface in certified patches.

    SURFACE is a volume or a mesh of any topology, as for voxflat surface. It falls into patches, each projected onto a
    plane, whose distortion has proven bounds: lengths change by at most a factor C, angles by a dilatation of at most K
    (Appleboim, Saucan, Zeevi 2006).
    """
    check_output(output, (".npz",), (surface_,))
    for path in (page, picture):
        if path is not None:
            check_output(path, _PICTURES if path is page else (".png",), (surface_,))
    making = {name: options.pop(name) for name in ("pial", "probability", "repair", "label", "threshold", "spacing")}
    making["repair"] = making["repair"] or False
    with bars(quiet) as shown:
        limits = {name: options.pop(name) for name in ("memory_limit", "threads")}
        source = voxflat.surface(surface_, **making, **limits, progress=shown.progress)
        atlas = voxflat.patches(source, **options, threads=limits["threads"], progress=shown.progress)
    atlas.save(output)
    if page is not None or picture is not None:
        _draw(atlas, page, picture)
    if as_json:
        click.echo(json.dumps({"output": str(output), **atlas.figures(), "metadata": atlas.metadata}, allow_nan=False))
    elif not quiet:
        click.echo(f"{atlas.table()}\n\nsaved as {output}")


def _draw(atlas: voxflat.FlatAtlas, page: Path | None, picture: Path | None) -> None:
    from voxflat import figures  # brings in matplotlib

    if page is not None:
        figures.save(figures.atlas_page(atlas), page)
    if picture is not None:
        figures.save_picture(figures.atlas_3d(atlas), picture)
