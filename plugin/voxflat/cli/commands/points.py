"""The command `voxflat points`."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.cli import options
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, print_json
from voxflat.cli.told import option_of
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
@options.output("The table with u, v and distance, mm.")
@options.run()
def command(
    map_: Path, points: Path, output: Path, limit: float, space: str, writing: dict[str, Any], as_json: bool
) -> None:
    """Find where points in space lie on a map.

    XYZ is a table (.csv, .tsv, .txt) with the columns x, y and z, or without a header; RAS+ mm. Each point is shown at
    the place of the surface that is nearest to it. OUT has all columns of XYZ, and u, v, distance (n/a beyond the
    limit).
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
