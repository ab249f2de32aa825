"""The commands `voxflat points` and `voxflat regions`, which relate places in space to places on a flat map."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np
from numpy.typing import NDArray

from voxflat.cli import options
from voxflat.cli.input import load_maps
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.errors import InputError
from voxflat.io.grid import in_unit
from voxflat.io.label_tables import LABEL_FILES
from voxflat.io.provenance import record_of, saving
from voxflat.io.reading import reading
from voxflat.io.sources import as_volume
from voxflat.io.tables import TABLE_ENDINGS, read_points
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.regions import REGION_ENDINGS, Regions, holds_voxels

_SPACE = 'Space of the coordinates: "surface" (the space of the surface) or "scanner" (scanner RAS, as for volumes).'
_PIXEL_SIZE = (
    "Side length of the pixels of --image, in the unit of the map.  [default: from the file, or as for voxflat image]"
)


@options.command(
    "points",
    "voxflat points map.npz electrodes.tsv --space scanner -o electrodes_uv.tsv",
    "voxflat points map.npz peaks.csv --space scanner --limit 3 -o peaks_uv.csv",
)
@options.map_
@cloup.argument("points", metavar="XYZ", type=FILE)
@options.section(
    "Points",
    option_of(FlatMap.points_to_map, "limit", type=options.NUMBER, metavar="MM"),
    option_of(FlatMap.points_to_map, "space", type=click.Choice(["surface", "scanner"]), help=_SPACE),
)
@options.output("Output table (.csv, .tsv or .txt): all columns of XYZ, plus u, v and distance in the unit of the map.")
@options.run()
def points_command(map_: Path, points: Path, output: Path, limit: float, space: str, writing: dict[str, Any]) -> None:
    """Find where points in space lie on a flat map.

    MAP is a file written by voxflat flatten. XYZ is a table (.csv, .tsv or .txt) of RAS+ coordinates in mm, either with
    columns named x, y and z or without a header. Each point is projected onto the nearest point of the surface. For
    points farther from the surface than --limit, u, v and distance are n/a.
    """
    check_output(output, TABLE_ENDINGS, **writing)
    with reading() as files:
        flat_map, table = load_maps([map_])[0], read_points(points)
    uv, distance = flat_map.points_to_map(table.points, limit, space=space)
    if not np.isfinite(distance).any():
        warning = flat_map._distance_warning(flat_map._checked_points(table.points, space), limit, distance)
        raise InputError(f"{points}: {warning or 'there are no points'}")
    parameters = {"of": flat_map.provenance, "limit": limit, "space": space}
    record = record_of("points_to_map", parameters, dict(sorted(files.items())))
    with saving(output, record, **writing):
        table.save(output, {"u": uv[:, 0], "v": uv[:, 1], "distance": distance})
    count = int(np.isfinite(distance).sum())
    within = in_unit(f"{limit:g} mm", flat_map.origin.named_unit)
    text = f"{count} of {len(distance)} points are within {within} of the surface\nsaved as {output}"
    report({"output": str(output), "points": len(distance), "on_map": count, "provenance": record}, text)


@options.command(
    "regions",
    "voxflat regions map.npz --svg drawn.svg -o lh.rois.annot",
    "voxflat regions map.npz --polygons v1.json -o lh.V1.label",
    "voxflat regions map.npz --image rois.tif -o rois.label.gii",
    "voxflat regions map.npz --image cells.tif --volume stack.ome.tif --depth -2,2 -o cells.tsv",
    "voxflat regions map.npz --labels lh.aparc.annot --volume thickness.func.gii -o lh.aparc.tsv",
    "voxflat regions map.npz --labels lh.areas.border -o lh.areas.dlabel.nii",
    'voxflat regions map.npz --labels lh.aparc.annot -o "labels/lh.{name}.label"',
    "voxflat regions map.npz --svg drawn.svg --layer visual --volume t1.nii.gz -o labels.nii.gz",
    "voxflat regions map.npz --polygons v1.json --volume t1.nii.gz --depth 0,2.5 -o labels.nii.gz",
)
@options.map_
@options.section(
    "Regions",
    options.reads("--svg", "Figure of the map (.svg) with the regions drawn in one layer."),
    options.value("--layer", "NAME", "Name of the layer in --svg that contains the regions.  [default: rois]"),
    options.reads(
        "--polygons",
        'File (.json) of polygons in the unit of the map, keyed by region name, such as {"V1": [[u, v], ...]}.',
    ),
    options.reads("--image", "Label image on the pixel grid of the map (.npy, .png, .tif, .nii or .nii.gz)."),
    options.value("--pixel-size", "MM", _PIXEL_SIZE, type=options.NUMBER),
    options.reads(
        "--labels",
        f"Labels of the vertices of the mesh ({LABEL_FILES}), whose names and colours are kept.",
        multiple=True,
    ),
)
@options.output(
    "Output file: .annot, .label.gii, .dlabel.nii or .label for vertex labels (with {name} in its name, one "
    ".label file per region); .svg for outlines; .nii, .nii.gz, .mgh, .mgz or .nrrd for voxel labels; .tsv or .csv for "
    "a table of areas, perimeters, positions and shapes on the surface.",
    options.reads(
        "--volume",
        "Volume whose grid is used for the voxel labels. For a table, volume or overlay whose mean is added for each "
        "channel.  [default: for voxel labels, the flattened volume]",
    ),
    options.value(
        "--depth",
        "MM,MM",
        "Range of distances from the surface, in the unit of the map, in which voxels are labelled, for maps made "
        "without --pial. For example, 0,2.5 covers the cortex outside the white matter. For a table, the volume is "
        "averaged over this range.  [default: on the surface]",
        callback=options.numbers,
    ),
)
@options.run()
def regions_command(
    map_: Path,
    svg: Path | None,
    layer: str | None,
    polygons: Path | None,
    image: Path | None,
    pixel_size: float | None,
    labels: tuple[Path, ...],
    output: Path,
    volume: Path | None,
    depth: Any,
    writing: dict[str, Any],
) -> None:
    """Convert regions on a flat map to vertex or voxel labels, or measure them.

    MAP is a file written by voxflat flatten. If MAP was made with --pial, the voxels between the white and pial
    surfaces are labelled. A vertex on a cut belongs to a region if either of its two positions on the map is inside the
    region. Where regions overlap, the last one drawn is used.
    """
    of_vertices: Any = labels[0] if len(labels) == 1 else list(labels) or None
    drawn = [drawing for drawing in (svg, polygons, image, of_vertices) if drawing is not None]
    if len(drawn) != 1:
        raise click.UsageError("Pass exactly one of --svg, --polygons, --image and --labels.")
    if layer is not None and svg is None:
        raise click.UsageError("--layer requires --svg.")
    if pixel_size is not None and image is None:
        raise click.UsageError("--pixel-size requires --image.")
    check_output(output, REGION_ENDINGS, **writing)
    with reading() as files:
        flat_map = load_maps([map_])[0]
        regions = flat_map.regions(drawn[0], pixel_size=pixel_size, **({} if layer is None else {"layer": layer}))
        regions = regions._with_provenance({**regions.provenance, "files": files})
        regions.save(output, volume=volume, depth=depth, **writing)
    counts = {"regions": _counts(regions, regions.labels)}
    if holds_voxels(output):
        counts["voxels"] = _counts(regions, as_volume(output).data)
    voxels = {name: f", {count} voxels" for name, count in counts.get("voxels", {}).items()}
    lines = [f"{name}: {n} points of the map{voxels.get(name, '')}" for name, n in counts["regions"].items()]
    text = "\n".join([*lines, f"saved as {output}"])
    report({"output": str(output), **counts, "provenance": regions.provenance}, text)


def _counts(regions: Regions, labels: NDArray[Any]) -> dict[str, int]:
    return {name: int(np.count_nonzero(labels == key)) for name, key in zip(regions.names, regions.keys, strict=True)}
