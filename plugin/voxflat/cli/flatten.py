"""The command `voxflat flatten`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import source_of
from voxflat.cli.options import FILE, OUT
from voxflat.cli.output import check_output, print_json
from voxflat.distances.geodesic import SOLVERS
from voxflat.maps.flat_map import MAP_ENDINGS, FlatMap
from voxflat.methods.flatten import flatten
from voxflat.methods.options import METHODS
from voxflat.methods.voxflat import SCALES


@click.command(
    "flatten",
    epilog="""\b
Examples:
  voxflat flatten labels.nii.gz --label 3 -o map.npz
  voxflat flatten wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45 -o map.npz
  voxflat flatten mask.npy --spacing 0.5,0.5,0.5 --keep patch.npy --json -o map.npz
  voxflat flatten lh.white --pial lh.pial --drop lh.Medial_wall.label -o lh.flat.surf.gii
  voxflat flatten rh.midthickness.surf.gii --sphere rh.sphere.reg.surf.gii --mirror -o rh.npz
  voxflat flatten lh.midthickness.surf.gii --keep lh.cortex.patch.3d -o lh.cortex.patch.flat
  voxflat flatten lh.midthickness.surf.gii --start lh.cortex.patch.flat -o lh.better.npz
""",
)
@options.input_
@click.option(
    "-o",
    "--output",
    type=OUT,
    required=True,
    metavar="OUT",
    help="The map's file: .npz or .voxflat holds everything; .surf.gii, .patch.flat, .flat.patch.3d, .vtp, .ply and "
    ".obj the flat surface.",
)
@click.option(
    "--method",
    type=click.Choice(list(METHODS)),
    default=options.default_of(flatten, "method"),
    help="Over the triangles of a surface; or after the papers: over a volume's voxels, by fast marching, by exact "
    "distances from random starts, or glued of certified patches.",
)
@options.making
@options.volume
@options.region
@options.sphere
@options.relax
@options.memory_limit
@click.option(
    "--sources",
    type=int,
    metavar="N",
    help=options.telling_default("sources", "How many points distances are measured from."),
)
@click.option(
    "--sampling",
    type=click.Choice([*options.SAMPLINGS, "decimation"]),
    help=options.telling_default(
        "sampling",
        "How sources are chosen: evenly, each farthest from the others; closer where the surface bends; at random; or"
        " by decimation (zigelman2002).",
    ),
)
@click.option(
    "--geodesic",
    type=click.Choice(SOLVERS),
    help="voxflat: what measures the distances that are kept; left out, what is at most 1 % off if links are more."
    "  [default: graph]",
)
@click.option(
    "--weighting",
    type=click.FloatRange(0, 1),
    help=options.telling_default(
        "weighting", "voxflat: from 0, near distances and shapes above all, to 1, far distances above all."
    ),
)
@click.option(
    "--scale",
    type=click.Choice(SCALES),
    help=options.telling_default("scale", "voxflat: what the map's mm are right for; both are told."),
)
@click.option(
    "--max-area",
    type=float,
    metavar="FACTOR",
    help="voxflat: let no triangle change its area by more than this factor, such as 2; refused where no such map is "
    "found.",
)
@click.option(
    "--start",
    type=FILE,
    metavar="MAP",
    help="voxflat: a flat map of the surface to go on from, of any tool; unless you say otherwise what it covers is "
    "flattened, cut as it is.",
)
@options.link_lengths("grossmann2002")
@click.option(
    "--neighbourhood",
    metavar="N|all",
    callback=options.rings,
    help="schwartz1989: keep distances within N rings around each point, or all.  [default: a tenth of the points]",
)
@click.option(
    "--starts",
    type=int,
    metavar="N",
    help=options.telling_default("starts", "schwartz1989: random starts, the best of which is kept."),
)
@click.option(
    "--bound",
    type=float,
    metavar="C",
    help=options.telling_default("bound", "saucan2006: how much lengths may change at most."),
)
@click.option(
    "--mirror", is_flag=True, help="Exchange left and right of the map, so that right hemispheres look like left ones."
)
@options.seed
@options.threads
@click.option("--keep-rows", is_flag=True, help="Store the distances from all sources to all points, too (large).")
@options.store(required=False)
@options.beside
@options.as_json
@options.quiet
@options.debug
def command(
    input_: Path, output: Path, sidecar: bool, overwrite: bool, as_json: bool, quiet: bool, **given: Any
) -> None:
    """Flatten a surface.

    INPUT is a label or intensity volume (.nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd, .mgh, .mgz, .npy, .npz), or a mesh
    (.surf.gii, FreeSurfer geometry such as lh.white, .vtk, .vtp, .ply, .stl, .obj). Without --label and --threshold a
    volume must have a single label. Without a patch the largest component is flattened; what is no disk is cut open,
    and that is said.
    """
    check_output(output, MAP_ENDINGS, sidecar=sidecar, overwrite=overwrite)
    with bars(quiet) as shown:
        flat_map = flatten(source_of(input_, given, shown), progress=shown.progress, **given)
    flat_map.save(output, sidecar=sidecar, overwrite=overwrite)
    if as_json:
        print_json({"output": str(output), **flat_map.description()})
    elif not quiet:
        click.echo(_summary(flat_map, output))


def _summary(flat_map: FlatMap, output: Path) -> str:
    metadata = flat_map.metadata
    width, height = np.ptp(flat_map.uv, axis=0)
    return "\n".join(
        [
            f"{'flattened':22}{metadata['points']} of {metadata['surface_points']} points, {_part(metadata)}",
            *_cuts(metadata),
            *([f"{'sources':22}{metadata['sources']}"] if "sources" in metadata else []),
            f"{'map':22}{width:.1f} x {height:.1f} mm{_torn(metadata)}",
            f"{'memory, at most':22}{metadata['memory_need_bytes'] / 2**20:.0f} MiB",
            "",
            flat_map.distortion.table(),
            "",
            f"saved as {output}",
        ]
    )


def _cuts(metadata: dict[str, Any]) -> list[str]:
    """Say what said where to cut, if it was a template."""
    names = [name for name in metadata.get("cut_names", []) if name]
    return [f"{'cuts':22}{metadata['cuts_by']}: {', '.join(names)}"] if names else []


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
