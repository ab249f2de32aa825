"""The command line: `voxflat flatten`, `check`, `surface`, `cut`, `path`, `rows`, `measure`, `patches`, `image`, ...

Exit status: 0 success; 1 the input cannot be used, the work failed or was cancelled, or `check` says no; 2 wrong usage.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

import voxflat
from voxflat.arguments import log
from voxflat.cli import options
from voxflat.cli import patches as _atlascli
from voxflat.cli.console import Bars, Program, bars
from voxflat.cli.cut import cut as _cut_command
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output
from voxflat.distortion.figures import json_ready
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.volumes import write_volume
from voxflat.maps.flat_map import MAP_ENDINGS, FlatMap
from voxflat.maps.image_files import IMAGE_ENDINGS
from voxflat.maps.texture import TEXTURED_ENDINGS

__all__ = ["main"]


@click.group(
    cls=Program,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog="A first try: voxflat demo.  Help on a command: voxflat flatten --help.",
)
@click.version_option(voxflat.__version__, message="voxflat %(version)s")
def main() -> None:
    """Flatten curved surfaces, above all the cortex, into the plane while keeping geodesic distances."""


@main.command(
    epilog="""\b
Examples:
  voxflat flatten labels.nii.gz --label 3 -o map.npz
  voxflat flatten wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45 -o map.npz
  voxflat flatten mask.npy --spacing 0.5,0.5,0.5 --keep patch.npy --json -o map.npz
  voxflat flatten lh.white --pial lh.pial --drop lh.Medial_wall.label -o lh.flat.surf.gii
  voxflat flatten lh.midthickness.surf.gii --keep lh.cortex.patch.3d -o lh.cortex.patch.flat
"""
)
@options.input_
@click.option(
    "-o",
    "--output",
    type=FILE,
    required=True,
    metavar="OUT",
    help="The map's file: .npz holds everything; .surf.gii, .patch.flat, .vtp, .ply and .obj the flat surface.",
)
@click.option(
    "--method",
    type=click.Choice(["voxflat", "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006"]),
    default="voxflat",
    help="Over the triangles of a surface; or after the papers: over a volume's voxels, by fast marching, by exact "
    "distances from random starts, or glued of certified patches.",
)
@options.making
@options.volume
@options.region
@options.relax
@options.memory_limit
@click.option(
    "--sources",
    type=int,
    metavar="N",
    help="How many points distances are measured from.  [default: 400; grossmann2002: 1000; zigelman2002: 625; "
    "schwartz1989: 50]",
)
@click.option(
    "--sampling",
    type=click.Choice(["farthest", "curvature", "random", "decimation"]),
    help="How sources are chosen: evenly, each farthest from the others; closer where the surface bends; at random; or"
    " by decimation (zigelman2002).  [default: farthest; zigelman2002: decimation]",
)
@click.option(
    "--geodesic",
    type=click.Choice(["graph", "marching", "exact"]),
    help="voxflat: what measures the distances that are kept.  [default: graph]",
)
@click.option(
    "--weighting",
    type=click.FloatRange(0, 1),
    help="voxflat: from 0, near distances and shapes above all, to 1, far distances above all.  [default: 0.5]",
)
@click.option(
    "--link-lengths",
    type=click.Choice(["chain-code", "euclidean"]),
    help="grossmann2002: the unbiased estimator, or 1, √2, √3 voxels for comparison.  [default: chain-code]",
)
@click.option(
    "--neighbourhood",
    metavar="N|all",
    callback=options.rings,
    help="schwartz1989: keep distances within N rings around each point, or all.  [default: a tenth of the points]",
)
@click.option(
    "--starts", type=int, metavar="N", help="schwartz1989: random starts, the best of which is kept.  [default: 3]"
)
@click.option(
    "--bound", type=float, metavar="C", help="saucan2006: how much lengths may change at most.  [default: 1.5]"
)
@options.seed
@options.threads
@click.option("--keep-rows", is_flag=True, help="Store the distances from all sources to all points, too (large).")
@options.store(required=False)
@options.as_json
@options.quiet
@options.debug
def flatten(input_: Path, output: Path, as_json: bool, quiet: bool, **options: Any) -> None:
    """Flatten a surface.

    INPUT is a label or intensity volume (.nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd, .mgh, .mgz, .npy, .npz), or a mesh
    (.surf.gii, FreeSurfer geometry such as lh.white, .vtk, .vtp, .ply, .stl, .obj). Without --label and --threshold a
    volume must have a single label. Without a patch the largest component is flattened; what is no disk is cut open,
    and that is said.
    """
    check_output(output, MAP_ENDINGS, (input_, options["keep"], options["drop"]))
    with bars(quiet) as shown:
        source = _source(input_, options, shown)
        flat_map = voxflat.flatten(source, progress=shown.progress, **options)
    flat_map.save(output)
    if as_json:
        _print_json({"output": str(output), **flat_map.description()})
    elif not quiet:
        click.echo(_summary(flat_map, output))


main.add_command(_cut_command)

_MAKING = ("pial", "probability", "repair")
_VOLUME = ("label", "threshold", "spacing")


def _source(input_: Path, options: dict[str, Any], shown: Bars) -> Any:
    """Return what a command works on: the input, or the surface made of it if its options say how."""
    making = {name: options.pop(name) for name in _MAKING}
    if not any(making.values()):
        return input_
    if options.get("method") == "grossmann2002" or options.get("geodesic") == "chain":
        raise InputError("--pial, --probability and --repair are for surfaces of triangles; leave them out")
    making |= {name: options.pop(name) for name in _VOLUME}
    return _surface(input_, making, options.get("memory_limit"), shown)


def _surface(input_: Path, making: dict[str, Any], memory_limit: int | None, shown: Bars) -> voxflat.Surface:
    making["repair"] = making["repair"] or False
    return voxflat.surface(input_, **making, memory_limit=memory_limit, progress=shown.progress)


@main.command(
    epilog="""\b
Examples:
  voxflat check labels.nii.gz
  voxflat check wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45
  voxflat check lh.white --pial lh.pial --drop lh.Medial_wall.label
"""
)
@options.input_
@options.volume
@options.making
@options.region
@options.threads
@options.memory_limit
@options.as_json
@options.debug
def check(input_: Path, as_json: bool, **options: Any) -> None:
    """Say whether a surface can be flattened.

    It lists what INPUT, a volume or a mesh, holds: components, boundary loops, handles, defects; what each remedy would
    change; and gives advice. The exit status is 0 if its surface can be flattened, and 1 if not.
    """
    with bars() as shown:
        findings = voxflat.check(_source(input_, options, shown), progress=shown.progress, **options)
    if as_json:
        _print_json(json_ready(asdict(findings)))
    else:
        click.echo(findings.table())
    if not findings.can_flatten:
        raise click.exceptions.Exit(1)


@main.command(
    epilog="""\b
Examples:
  voxflat surface wm.nii.gz --threshold 0.5 --repair voxels -o wm.surf.gii
  voxflat surface labels.nii.gz --label 3 --repair voxels --repaired repaired.nii.gz -o label3.vtp
"""
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
def surface(input_: Path, output: Path, repaired: Path | None, memory_limit: int | None, **making: Any) -> None:
    """Make the surface of a volume, or check and convert a mesh.

    Vertices are surface voxels, at places finer than the grid; nothing is interpolated.
    """
    check_output(output, (), (input_,))
    with bars() as shown:
        made = _surface(input_, making, memory_limit, shown)
        for remark in made.remarks:
            log.warning(remark)
    if repaired is not None:
        if "repair" not in made.metadata:
            raise InputError(f"there are no changed voxels to write to {repaired}; give --repair voxels")
        changed = made.changed_voxels()
        write_volume(repaired, changed, made.metadata["affine"])
    made.save(output)
    click.echo(f"{len(made)} vertices, {len(made.faces)} triangles\nsaved as {output}")


@main.command(
    epilog="""\b
Examples:
  voxflat path lh.white 1204 8811 9032 --geodesic edges -o cut.txt
  voxflat path wm.nii.gz 136,112,127 136,90,130 --threshold 0.5
"""
)
@options.input_
@click.argument("stops", metavar="I,J,K|V...", nargs=-1, required=True, callback=options.places)
@click.option("-o", "--output", type=FILE, metavar="OUT", help="Write what it passes, one in each line, for --cut.")
@click.option(
    "--geodesic",
    type=click.Choice(["graph", "marching", "exact", "edges", "chain"]),
    default="graph",
    help="Straight links over the surface, back along the fronts of fast marching, the exact shortest path, along "
    "edges as cuts run, or the paper's links between voxels.",
)
@options.volume
@options.making
@options.memory_limit
@options.as_json
@options.debug
def path(input_: Path, stops: list[Any], output: Path | None, as_json: bool, **options: Any) -> None:
    """Find the shortest path through points of a surface.

    It prints the path's length and, with -o, writes the vertices (or voxel indices) that it passes.
    """
    if len(stops) < 2:
        raise click.UsageError("Give at least two stops.")
    if output is not None:
        if options["geodesic"] in ("marching", "exact"):
            raise click.UsageError("This path crosses triangles, no cut can: give --geodesic edges with -o.")
        check_output(output, (), (input_,))
    with bars() as shown:
        found = voxflat.path(_source(input_, options, shown), *stops, **options)
    if output is not None:
        with atomic_path(output) as beside:
            np.savetxt(beside, found.ids, fmt="%d")
    if as_json:
        _print_json({"length": found.length, "ids": found.ids.tolist(), "points": found.points.tolist()})
    else:
        saved = "" if output is None else f"\nsaved as {output}"
        click.echo(f"{found.length:.3f} mm through {len(found.ids)} points{saved}")


@main.command(
    epilog="""\b
Examples:
  voxflat measure lh.white lh.cortex.patch.flat
  voxflat measure lh.midthickness.surf.gii lh.flat.surf.gii --json
  voxflat measure lh.white map.npz lh.cortex.patch.flat unwrapped.obj --heat-maps maps.png
"""
)
@click.argument("surface_", metavar="SURFACE", type=FILE)
@click.argument("flat", metavar="FLAT...", type=FILE, nargs=-1, required=True)
@options.volume
@options.making
@click.option(
    "--sources", type=int, default=300, metavar="N", help="How many random points distances are measured from."
)
@click.option(
    "--reference",
    type=click.Choice(["exact", "graph"]),
    help="How distances are measured: exactly over the triangles, which takes its time, or by straight links."
    "  [default: exact; for volumes graph]",
)
@click.option(
    "--heat-maps", type=FILE, metavar="PNG", help="Draw the maps side by side: errors of distances, change of areas."
)
@options.seed
@options.threads
@options.as_json
@options.debug
def measure(surface_: Path, flat: tuple[Path, ...], heat_maps: Path | None, as_json: bool, **options: Any) -> None:
    """Judge flat maps of any tool.

    Each FLAT is a flat map of SURFACE: a FreeSurfer patch, a flat GIFTI surface, an .obj with texture coordinates, or a
    map that voxflat flatten made. The figures are defined in the documentation; distances are measured on SURFACE, cut
    as the map is, in mm. Several maps are measured from the same points.
    """
    names = _short_names(flat)
    if heat_maps is not None:
        from voxflat import figures  # brings in matplotlib

        check_output(heat_maps, (".png", ".pdf", ".svg"), (surface_, *flat))
    with bars() as shown:
        source = _source(surface_, options, shown)
        compared = voxflat.compare(source, dict(zip(names, flat, strict=True)), progress=shown.progress, **options)
    if heat_maps is not None:
        figures.save(figures.heat_maps(compared), heat_maps)
    one = compared[names[0]] if len(names) == 1 else compared
    if as_json:
        _print_json(one.figures())
    else:
        click.echo(one.table())


def _short_names(paths: Sequence[Path]) -> list[str]:
    """Return the names of files; whole paths if they are not enough to tell them apart."""
    for names in ([path.name for path in paths], [str(path) for path in paths]):
        if len(set(names)) == len(names):
            return names
    raise click.UsageError("A FLAT is given twice.")


main.add_command(_atlascli.patches)


@main.command(
    epilog="""\b
Examples:
  voxflat rows wm.nii.gz --threshold 0.5 --sources 1000 --store wm.rows
  voxflat rows lh.white --pial lh.pial --sources 500 --store lh.rows --json
"""
)
@options.input_
@options.store(required=True)
@click.option(
    "--geodesic",
    type=click.Choice(["graph", "marching", "exact", "chain"]),
    default="graph",
    help="Over the triangles of a surface: by straight links, fast marching, or exactly; or by chain codes over the "
    "voxels of a volume.",
)
@options.making
@options.volume
@options.region
@options.memory_limit
@click.option("--sources", type=int, required=True, metavar="M", help="How many points distances are measured from.")
@options.sampling
@click.option(
    "--link-lengths",
    type=click.Choice(["chain-code", "euclidean"]),
    help="chain: the unbiased estimator, or 1, √2, √3 voxels for comparison.  [default: chain-code]",
)
@options.seed
@options.threads
@options.as_json
@options.quiet
@options.debug
def rows(input_: Path, sources: int, as_json: bool, quiet: bool, **options: Any) -> None:
    """Measure distances into a store on disk.

    DIR gets the geodesic distances from M sources to all points of a surface: rows.npy, float32, mm, which NumPy can
    map into memory, and voxflat.open_rows opens. Only a little of it is ever in memory. Give the same command again to
    resume what was interrupted.
    """
    with bars(quiet) as shown:
        source = _source(input_, options, shown)
        measured = voxflat.geodesic(source, sources, progress=shown.progress, **options)
    if as_json:
        _print_json({"store": str(measured.store), "shape": list(measured.shape), "bytes": measured.nbytes})
    elif not quiet:
        size = f"{measured.nbytes / 2**20:.0f} MiB"
        click.echo(f"{measured.shape[0]} x {measured.shape[1]} distances, {size}\nsaved in {measured.store}")


@main.command(
    epilog="""\b
Examples:
  voxflat image map.npz --volume t1.nii.gz --interpolation linear --depth 2 -o t1.png
  voxflat image map.npz --volume areas.nii.gz --pixel-size 0.5 -o areas.nii.gz
  voxflat image map.npz --volume face.obj -o face.png
  voxflat image map.npz --heat-map -o distortion.png
  voxflat image atlas.npz --volume lh.sulc -o page.png
"""
)
@click.argument("map_", metavar="MAP", type=FILE)
@click.option("--volume", type=FILE, metavar="V", help="The volume to show; for a mesh an overlay, or its own texture.")
@click.option("--heat-map", is_flag=True, help="Show instead the distortion, place by place.")
@click.option(
    "-o",
    "--output",
    type=FILE,
    required=True,
    metavar="OUT",
    help="The image's file: .png to look at; .tif, .tiff, .nii, .nii.gz (float32) or .npy to measure.",
)
@click.option(
    "--pixel-size",
    type=float,
    metavar="MM",
    help="Side of a pixel, mm.  [default: half the voxel size or edge; of an atlas at most half the gaps]",
)
@click.option(
    "--depth",
    type=float,
    metavar="MM",
    help="How far outside the surface to sample, mm; negative is inside.  [default: 0]",
)
@click.option(
    "--interpolation",
    type=click.Choice(["linear", "nearest"]),
    help="Between voxels.  [default: nearest for whole numbers, which may be labels; linear for others]",
)
@options.debug
def image(
    map_: Path,
    volume: Path | None,
    heat_map: bool,
    output: Path,
    pixel_size: float | None,
    depth: float | None,
    interpolation: str | None,
) -> None:
    """Show a volume, or the distortion, on a map.

    MAP is a file that voxflat flatten made, or an atlas of voxflat patches, of which the page of all patches is shown;
    its heat map is of C, the factor by which lengths change. A PNG shows scalars in grey (1st to 99th percentile),
    labels in a colour each, and colours as they are; it is transparent outside the map. The PNG of a heat map is a
    figure with a colour bar. The other formats hold the values, NaN outside the map.
    """
    if heat_map == (volume is not None):
        raise click.UsageError("Give either --volume or --heat-map.")
    if heat_map and (interpolation or depth is not None):
        raise click.UsageError("--interpolation and --depth are for --volume.")
    check_output(output, IMAGE_ENDINGS, (map_, volume))
    flat_map = _atlascli.load_flat(map_)
    if volume is None:
        picture = flat_map.heat_map(pixel_size)
    else:
        picture = flat_map.image(volume, pixel_size, depth=depth or 0.0, interpolation=interpolation)
        _check_overlap(picture.data[..., 3] > 0 if picture.is_colour else ~np.isnan(picture.data), volume)
    if heat_map and output.suffix.lower() == ".png":
        from voxflat import figures  # brings in matplotlib

        if isinstance(flat_map, FlatMap):
            drawn = figures.heat_map(flat_map, pixel_size)
        else:
            drawn = figures.atlas_heat_map(flat_map, pixel_size)
        figures.save(drawn, output)
    else:
        picture.save(output)
    height, width = picture.data.shape[:2]
    click.echo(f"{width} x {height} pixels of {picture.pixel_size:g} mm\nsaved as {output}")


@main.command(
    epilog="""\b
Examples:
  voxflat texture map.npz bricks.jpg -o bricks.obj
  voxflat texture map.npz chessboard.png --texel-size 0.1 --repeat -o chessboard.glb
"""
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
def texture(map_: Path, picture: Path, output: Path, texel_size: float | None, repeat: bool) -> None:
    """Map a picture onto a surface.

    MAP is a file that voxflat flatten made; PICTURE is laid over it in its proportions, centred, and by it onto the
    surface. For .ply triangles are split where colours at their corners could not carry the picture.
    """
    check_output(output, TEXTURED_ENDINGS, (map_, picture))
    textured = voxflat.load(map_).textured(picture, texel_size, repeat=repeat)
    if output.suffix.lower() == ".ply":
        textured = textured.subdivided()
    textured.save(output)
    click.echo(f"{len(textured.points)} points, {len(textured.faces)} triangles\nsaved as {output}")


@main.command()
@click.option(
    "-o",
    "--output",
    type=FILE,
    default=Path("voxflat-demo"),
    metavar="DIR",
    help="A directory for the results; made if it is missing.",
)
@options.debug
def demo(output: Path) -> None:
    """Flatten a patch of human cortex.

    The cortex is the MNI152 template, which comes with nilearn: nothing is downloaded. The map, its figures and the
    pictures of it are written to a directory.
    """
    try:
        from voxflat.demo import run

        with bars() as shown:
            run(output, progress=shown.progress, tell=shown.tell)
    except ImportError as error:
        if error.name and error.name.startswith("voxflat"):
            raise
        raise InputError(f"the demo needs {error.name}: pip install 'voxflat[demo]'") from error


# ------------------------------------------------------------------------------------ what is said afterwards


def _summary(flat_map: FlatMap, output: Path) -> str:
    metadata = flat_map.metadata
    width, height = np.ptp(flat_map.uv, axis=0)
    return "\n".join(
        [
            f"{'flattened':22}{metadata['points']} of {metadata['surface_points']} points, {_part(metadata)}",
            *([f"{'sources':22}{metadata['sources']}"] if "sources" in metadata else []),
            f"{'map':22}{width:.1f} x {height:.1f} mm{_torn(metadata)}",
            f"{'memory, at most':22}{metadata['memory_need_bytes'] / 2**20:.0f} MiB",
            "",
            flat_map.distortion.table(),
            "",
            f"saved as {output}",
        ]
    )


def _torn(metadata: dict[str, Any]) -> str:
    return f", {100 * metadata['torn_faces']:.1f} % of it torn" if "torn_faces" in metadata else ""


def _part(metadata: dict[str, Any]) -> str:
    """Say which part of the surface was flattened."""
    what = "voxel" if metadata["kind"] == "voxels" else "vertex"
    parts = []
    if metadata["keep"] or metadata.get("drop"):
        parts.append("those of the mask")
    if metadata["seed_point"] is not None:
        parts.append(f"within {metadata['radius']} mm of {what} {metadata['seed_point']}")
    if parts:
        return " ".join(parts)
    return "all" if metadata["points"] == metadata["surface_points"] else "the largest component"


def _print_json(content: dict[str, Any]) -> None:
    click.echo(json.dumps(content, allow_nan=False))


def _check_overlap(covered: Any, volume: Path) -> None:
    if not covered.any():
        raise InputError(f"{volume} shows nothing on the map: it lies elsewhere; compare the affines by voxflat check")
