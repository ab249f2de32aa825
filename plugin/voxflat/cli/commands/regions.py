"""The command `voxflat regions`."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.cli import options
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.io.reading import reading
from voxflat.maps.flat_map import load
from voxflat.maps.regions import REGION_ENDINGS


@cloup.command(
    "regions",
    epilog="""\b
Examples:
  voxflat regions map.npz --svg drawn.svg -o lh.rois.annot
  voxflat regions map.npz --polygons v1.json -o lh.V1.label
  voxflat regions map.npz --image rois.tif -o rois.label.gii
  voxflat regions map.npz --svg drawn.svg --layer visual --volume t1.nii.gz -o labels.nii.gz
  voxflat regions map.npz --polygons v1.json --volume t1.nii.gz --depth 0,2.5 -o labels.nii.gz
""",
)
@cloup.argument("map_", metavar="MAP", type=FILE)
@options.section(
    "Regions",
    cloup.option("--svg", type=FILE, metavar="FILE", help="A figure of the map (.svg) with regions drawn in a layer."),
    cloup.option("--layer", metavar="NAME", help="That layer's name.  [default: rois]"),
    options.reads("--polygons", 'Polygons in mm by their names (.json): {"V1": [[u, v], ...]}.', metavar="FILE"),
    options.reads("--image", "A label image on the map's pixels: .npy, .png, .tif, .nii, .nii.gz.", metavar="FILE"),
    cloup.option(
        "--pixel-size",
        type=float,
        metavar="MM",
        help="Side of its pixels, mm.  [default: as the file says, else as of voxflat image]",
    ),
)
@options.output(
    "Of vertices .annot, .label.gii, or .label (one region); of voxels .nii, .nii.gz, .mgh, .mgz or .nrrd.",
    options.reads("--volume", "For voxels: whose grid.  [default: that of the flattened volume]", metavar="V"),
    cloup.option(
        "--depth",
        metavar="MM,MM",
        callback=options.numbers,
        help="For voxels, where no pial surface is known: from how far to how far outside the surface, mm.",
    ),
)
@options.run()
def command(
    map_: Path,
    svg: Path | None,
    layer: str | None,
    polygons: Path | None,
    image: Path | None,
    pixel_size: float | None,
    output: Path,
    volume: Path | None,
    depth: Any,
    writing: dict[str, Any],
    as_json: bool,
) -> None:
    """Carry regions that were drawn on a map to vertices or voxels.

    MAP is a file that voxflat flatten made. Voxels get the region at their place in the cortex, from the white to the
    pial surface where the map was made with --pial. Vertices on cuts are in a region if either of their places is.
    Where regions lie over each other, the last one drawn counts.
    """
    drawn = [given for given in (svg, polygons, image) if given is not None]
    if len(drawn) != 1:
        raise click.UsageError("Give one of --svg, --polygons and --image.")
    if layer is not None and svg is None:
        raise click.UsageError("--layer is for --svg.")
    if pixel_size is not None and image is None:
        raise click.UsageError("--pixel-size is for --image.")
    check_output(output, REGION_ENDINGS, **writing)
    with reading() as files:
        flat_map = load(map_)
        regions = flat_map.regions(drawn[0], pixel_size=pixel_size, **({} if layer is None else {"layer": layer}))
        regions = regions._with_provenance({**regions.provenance, "files": files})
        regions.save(output, volume=volume, depth=depth, **writing)
    counts = {
        name: int(np.count_nonzero(regions.labels == key))
        for name, key in zip(regions.names, regions.keys, strict=True)
    }
    if as_json:
        print_json({"output": str(output), "regions": counts, "provenance": regions.provenance})
    else:
        lines = [f"{name}: {count} points of the map" for name, count in counts.items()]
        click.echo("\n".join([*lines, f"saved as {output}"]))
