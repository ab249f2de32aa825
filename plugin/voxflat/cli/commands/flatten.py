"""The command `voxflat flatten`."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import part_of, surface_of
from voxflat.cli.output import check_output, print_json
from voxflat.cli.parameter_options import option_of
from voxflat.io.grid import in_unit
from voxflat.maps.flat_map import MAP_ENDINGS, FlatMap
from voxflat.pipeline.surface import Surface


@cloup.command(
    "flatten",
    epilog="""\b
Examples:
  voxflat flatten wm.nii.gz --hemisphere left -o lh.npz
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
@options.surface_options
@options.region
@options.cuts
@options.method_options
@options.output(
    "Output file. .npz and .voxflat hold the complete map; .surf.gii, .patch.flat, .flat.patch.3d, .vtp, .ply and .obj "
    "hold the flat surface.",
    option_of(Surface.flatten, "mirror", is_flag=True),
    options.flag("--rows", "Save the distances from all sources to all points in OUT (large)."),
    options.store,
)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def command(input_: Path, output: Path, writing: dict[str, Any], as_json: bool, quiet: bool, **given: Any) -> None:
    """Flatten a surface into a flat map.

    INPUT is a label or intensity volume (.nii, .nii.gz, .hdr, .mgh, .mgz, .nrrd, .nhdr, .mha, .mhd, .tif, .npy, .npz)
    or a mesh (.surf.gii, FreeSurfer geometry such as lh.white, .asc, .vtk, .vtp, .ply, .stl, .obj, .off, .glb). A
    volume with several labels needs --label or --threshold. With --hemisphere, the surface is cut along standard cuts
    by default. Without a region, the largest component is flattened. A surface that is not a disk is cut open, and a
    warning lists the cuts.
    """
    check_output(output, MAP_ENDINGS, **writing)
    method, rows, store = options.method_of(given), given.pop("rows"), given.pop("store")
    if given["hemisphere"] is not None and given["cuts"] is None:
        given["cuts"] = "standard"
    with bars(quiet) as shown:
        choose = part_of(given, shown.progress)
        part = choose(surface_of(input_, given, shown.progress))
        flat_map = part.flatten(method, rows=rows if store is None else store, progress=shown.progress, **given)
    flat_map.save(output, **writing)
    if as_json:
        print_json({"output": str(output), **flat_map.description()})
    elif not quiet:
        click.echo(_summary(flat_map, output))


def _summary(flat_map: FlatMap, output: Path) -> str:
    metadata = flat_map.metadata
    width, height = np.ptp(flat_map.uv, axis=0)
    summary = "\n".join(
        [
            f"{'flattened':22}{metadata['points']} of {metadata['surface_points']} points, {_part(metadata)}",
            *_cuts(metadata),
            *([f"{'sources':22}{metadata['sources']}"] if "sources" in metadata else []),
            f"{'map':22}{width:.1f} x {height:.1f} mm{_torn(metadata)}",
            f"{'memory, at most':22}{metadata['memory_need_bytes'] / 2**20:.0f} MiB",
            "",
            flat_map.distortion.table(),
            "",
        ]
    )
    return f"{in_unit(summary, metadata)}\nsaved as {output}"


def _cuts(metadata: dict[str, Any]) -> list[str]:
    """Return the summary line that names the template cuts, if the map has any."""
    names = [name for name in metadata.get("cut_names", []) if name]
    return [f"{'cuts':22}{metadata['cuts_by']}: {', '.join(names)}"] if names else []


def _torn(metadata: dict[str, Any]) -> str:
    return f", {100 * metadata['torn_faces']:.1f} % of it torn" if "torn_faces" in metadata else ""


def _part(metadata: dict[str, Any]) -> str:
    """Describe the part of the surface that was flattened."""
    what = "voxel" if metadata["kind"] == "voxels" else "vertex"
    parts = []
    if metadata["keep"] or metadata.get("drop"):
        parts.append("inside the mask")
    if metadata["seed_point"] is not None:
        parts.append(f"within {metadata['radius']} mm of {what} {metadata['seed_point']}")
    if parts:
        return " ".join(parts)
    return "all" if metadata["points"] == metadata["surface_points"] else "the largest component"
