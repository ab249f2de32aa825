"""The commands `voxflat path`, `voxflat rows` and `voxflat distance-matrix`, which measure distances."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import parcels_of_sides, part_of, sides_of, surface_of
from voxflat.cli.options import FILE, OUT
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.distances.geodesic import SOLVERS
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit
from voxflat.io.label_tables import LABEL_FILES
from voxflat.io.matrices import MATRIX_ENDINGS, table_of
from voxflat.io.provenance import saving
from voxflat.pipeline.distance_matrix import KINDS, METHODS, SYMMETRIC
from voxflat.pipeline.surface import Surface, surface

_WAYS = click.Choice([*SOLVERS, "edges", "chain"])
_EDGES = '"edges": paths along the edges of the triangles, as required for cuts.'


@options.command(
    "path",
    "voxflat path lh.white 1204 8811 9032 --geodesic edges -o cut.txt",
    "voxflat path wm.nii.gz 136,112,127 136,90,130 --threshold 0.5",
)
@options.input_
@cloup.argument("stops", metavar="I,J,K|V...", nargs=-1, required=True, callback=options.places)
@options.surface_options
@options.section(
    "Path",
    option_of(Surface.path, "geodesic", type=_WAYS, sentences=5, like=Surface.geodesic, note=_EDGES),
    options.link_lengths(Surface.path),
)
@options.output("Write the vertices along the path to this file, one per line, for use with --cuts.", required=False)
@options.run(options.memory_limit)
def path_command(input_: Path, stops: list[Any], output: Path | None, writing: dict[str, Any], **settings: Any) -> None:
    """Find the shortest path through points on a surface.

    The command prints the length of the path. The points are voxel indices I,J,K or vertex numbers V, counted from 0.
    """
    if len(stops) < 2:
        raise click.UsageError(f"{len(stops)} stop is given. Pass at least two stops.")
    if output is not None:
        if settings["geodesic"] in ("marching", "exact"):
            raise click.UsageError("This path crosses triangles, so it cannot be a cut. Pass --geodesic edges with -o.")
        check_output(output, **writing)
    elif writing["sidecar"]:
        raise click.UsageError("--sidecar requires -o.")
    with bars() as bar:
        whole = surface_of(input_, settings, bar.progress)
        path = whole.path(*stops, geodesic=settings["geodesic"], link_lengths=settings["link_lengths"])
    if output is not None:
        with saving(output, path.provenance, **writing), atomic_path(output) as beside:
            beside.write_text("".join(f"{point}\n" for point in path.ids), encoding="utf-8", newline="\n")
    content: dict[str, Any] = {"length": path.length, "ids": path.ids.tolist(), "points": path.points.tolist()}
    length = in_unit(f"{path.length:.3f} mm", whole.origin.named_unit)
    saved = "" if output is None else f"\nsaved as {output}"
    content |= {"space": path.space._described(), "provenance": path.provenance}
    report(content, f"{length} through {len(path.ids)} points{saved}")


@options.command(
    "rows",
    "voxflat rows wm.nii.gz --threshold 0.5 --sources 1000 --store wm.rows",
    "voxflat rows lh.white --pial lh.pial --sources 500 --store lh.rows --json",
    "voxflat rows lh.white --pial lh.pial --sources 5000 --store lh.rows --dask tcp://node1:8786",
)
@options.input_
@options.surface_options
@options.region
@options.section("Cuts", options.where_cut[0])
@options.section(
    "Distances",
    option_of(Surface.geodesic, "geodesic", type=click.Choice([*SOLVERS, "chain"]), sentences=5),
    option_of(Surface.geodesic, "sources", type=int, required=True, metavar="N", until=", or "),
    options.sampling,
    options.link_lengths(Surface.geodesic),
)
@options.section(
    "Output", option_of(Surface.geodesic, "store", type=OUT, metavar="DIR", required=True), options.as_json
)
@options.run(options.dask, options.seed, options.threads, options.memory_limit, options.quiet)
def rows_command(input_: Path, sources: int, quiet: bool, **settings: Any) -> None:
    """Measure geodesic distances and store them on disk.

    The geodesic distances from N sources to all points of a surface are written to DIR/rows.npy (float32, in the unit
    of INPUT). To read them in Python, pass DIR to voxflat.open_rows, or memory-map the file with NumPy. Only a small
    part of the distances is held in memory at any time. To resume an interrupted computation, run the same command
    again.
    """
    with bars(quiet) as bar:
        cuts, choose = settings.pop("cuts"), part_of(settings, bar.progress)
        part = choose(surface_of(input_, settings, bar.progress))
        if cuts is not None:
            part = part.cut(cuts, relax=False, threads=settings["threads"], progress=bar.progress).surface
        measured = part.geodesic(sources, progress=bar.progress, **settings)
    size = {"shape": list(measured.shape), "bytes": measured.nbytes}
    named = "without a unit" if measured.unit == "unknown" else f"in {measured.unit}"
    text = f"{measured.shape[0]} x {measured.shape[1]} distances {named}, {measured.nbytes / 2**20:.0f} MiB"
    content = {"store": str(measured.store), **size, "unit": measured.unit, "provenance": measured.provenance}
    report(content, f"{text}\nsaved in {measured.store}", quiet=quiet)


@options.command(
    "distance-matrix",
    "voxflat distance-matrix L.midthickness.surf.gii --drop L.medial_wall.label.gii --dtype uint8 -o L.npy",
    "voxflat distance-matrix L.midthickness.surf.gii R.midthickness.surf.gii --parcels parcels.dlabel.nii "
    "-o parcels.pconn.nii",
    "voxflat distance-matrix lh.white --parcels lh.aparc.annot --method min -o lh.aparc.csv",
)
@cloup.argument("surfaces", metavar="SURFACE...", type=FILE, nargs=-1, required=True)
@options.section(
    "Distances",
    options.reads(
        "--drop",
        "Exclude this region, such as the medial wall, from the paths and from the matrix: a file as for voxflat "
        "flatten --drop. It may be repeated. With two surfaces, each file is used for its own hemisphere.",
        multiple=True,
    ),
    options.reads(
        "--parcels",
        f"Measure the distances between these parcels ({LABEL_FILES}) instead of between vertices. With two surfaces, "
        "pass a .dlabel.nii file, or files of both hemispheres.",
        multiple=True,
    ),
    option_of(Surface.geodesic_matrix, "method", type=click.Choice(METHODS), sentences=4),
    option_of(Surface.geodesic, "geodesic", type=click.Choice(SYMMETRIC), sentences=2),
    options.reads("--table", "Names of the parcels, in the format of FreeSurferColorLUT.txt or a BIDS dseg.tsv."),
)
@options.output(
    "Output file: .npy (which NumPy can map into memory), .csv, .tsv or .txt, each with a table of its rows in "
    "FILE.rows.tsv; .h5; .zarr; .dconn.nii for vertices; or .pconn.nii for parcels.",
    option_of(Surface.geodesic_matrix, "dtype", type=click.Choice(list(KINDS)), sentences=2),
)
@options.run(options.threads, options.memory_limit, options.quiet)
def distance_matrix_command(
    surfaces: tuple[Path, ...],
    drop: tuple[Path, ...],
    parcels: tuple[Path, ...],
    output: Path,
    writing: dict[str, Any],
    quiet: bool,
    **settings: Any,
) -> None:
    """Measure the geodesic distances between all vertices or parcels.

    Each SURFACE is the mesh of a hemisphere; pass one or two. The rows and columns of the left hemisphere come first.
    Distances between hemispheres are infinite, or 255 with --dtype uint8. Distances are in the unit of the surface.
    """
    if len(surfaces) > 2:
        raise click.UsageError(f"{len(surfaces)} surfaces are given. Pass one surface, or one of each hemisphere.")
    tables = [table_of(output)] if output.suffix.lower() in (".npy", ".csv", ".tsv", ".txt") else []
    check_output(output, MATRIX_ENDINGS, beside=tables, **writing)
    with bars(quiet) as bar:
        parts = [surface(path, memory_limit=settings["memory_limit"]) for path in surfaces]
        sides = [part.origin.structure for part in parts]
        for region in drop:
            for n in sides_of(region, sides):
                parts[n] = parts[n].drop(region)
        other = parts[1] if len(parts) > 1 else None
        matrix = parts[0].geodesic_matrix(
            parcels_of_sides(parcels, sides), other=other, file=output, **writing, **settings, progress=bar.progress
        )
    content = {"output": str(output), "rows": len(matrix.ids), "unit": matrix.unit, "names": list(matrix.names)}
    named = "without a unit" if matrix.unit == "unknown" else f"in {matrix.unit}"
    of = "parcels" if matrix.names else "points"
    text = f"{len(matrix.ids):,} x {len(matrix.ids):,} distances between {of}, {named}\nsaved as {output}"
    report({**content, "provenance": matrix.provenance}, text, quiet=quiet)
