"""The command `voxflat points`."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.cli import options
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.cli.parameter_options import option_of
from voxflat.io.provenance import record_of, saving
from voxflat.io.reading import reading
from voxflat.io.tables import TABLE_ENDINGS, read_points
from voxflat.maps.flat_map import FlatMap, load


@cloup.command(
    "points",
    epilog="""\b
Examples:
  voxflat points map.npz electrodes.tsv --space scanner -o electrodes_uv.tsv
  voxflat points map.npz peaks.csv --space scanner --limit 3 -o peaks_uv.csv
""",
)
@cloup.argument("map_", metavar="MAP", type=FILE)
@cloup.argument("points", metavar="XYZ", type=FILE)
@options.section(
    "Points",
    option_of(FlatMap.points_to_map, "limit", type=float, metavar="MM"),
    option_of(FlatMap.points_to_map, "space", type=click.Choice(["surface", "scanner"])),
)
@options.output("Output table (.csv, .tsv or .txt): all columns of XYZ, and u, v and distance in mm.")
@options.run()
def command(
    map_: Path, points: Path, output: Path, limit: float, space: str, writing: dict[str, Any], as_json: bool
) -> None:
    """Find the positions of points in space on a flat map.

    XYZ is a table (.csv, .tsv or .txt) of coordinates in RAS+ mm, with columns named x, y and z or without a header.
    Each point is projected to the nearest point of the surface. u, v and distance are n/a for points beyond --limit.
    """
    check_output(output, TABLE_ENDINGS, **writing)
    with reading() as files:
        flat_map, table = load(map_), read_points(points)
    uv, distance = flat_map.points_to_map(table.points, limit, space=space)
    parameters = {"of": flat_map.provenance, "limit": limit, "space": space}
    record = record_of("points_to_map", parameters, dict(sorted(files.items())))
    with saving(output, record, **writing):
        table.save(output, {"u": uv[:, 0], "v": uv[:, 1], "distance": distance})
    shown = int(np.isfinite(distance).sum())
    if as_json:
        print_json({"output": str(output), "points": len(distance), "on_map": shown, "provenance": record})
    else:
        click.echo(f"{shown} of {len(distance)} points within {limit:g} mm of the surface\nsaved as {output}")
