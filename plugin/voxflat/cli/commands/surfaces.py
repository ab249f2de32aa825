"""The commands `voxflat check`, `register`, `surface` and `smooth`, which examine and prepare surfaces."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from voxflat.arguments import log
from voxflat.cli import options
from voxflat.cli.console import bars, translated
from voxflat.cli.input import part_of, surface_of
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.distortion.figures import json_ready
from voxflat.errors import InputError
from voxflat.io.channels import distinct_names
from voxflat.io.files import atomic_path
from voxflat.io.formats.gifti import value_bytes
from voxflat.io.grid import scaled
from voxflat.io.meshes import check_mesh_name
from voxflat.io.overlays import read_channels
from voxflat.io.patches import FLAT_PATCH_ENDINGS, PATCH_ENDING
from voxflat.io.provenance import record_of, saving
from voxflat.io.reading import reading
from voxflat.io.volumes import check_volume_name, write_volume
from voxflat.pipeline.check import check
from voxflat.pipeline.surface import Surface


@options.command(
    "check",
    "voxflat check labels.nii.gz",
    "voxflat check wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45",
    "voxflat check lh.white --pial lh.pial --drop lh.Medial_wall.label",
)
@options.input_
@options.surface_options
@options.region
@options.choice_of_cuts
@options.run(options.threads, options.memory_limit, options.as_json)
def check_command(input_: Path, **settings: Any) -> None:
    """Check whether a surface can be flattened.

    The command lists the components, boundary loops, handles and defects of INPUT (a volume or a mesh), reports the
    changes that each remedy would make, and gives advice. The exit status is 0 if the surface can be flattened, and 1
    otherwise.
    """
    with bars() as bar:
        part = part_of(settings, bar.progress)
        source: Path | Surface = input_
        making = (
            "pial",
            "probability",
            "probability_channel",
            "repair",
            "hemisphere",
            "unit",
            "rim",
            "channel",
            "smooth",
        )
        if any(settings[name] is not None and settings[name] is not False for name in making):
            source = surface_of(input_, settings, bar.progress)
        else:
            settings = {name: value for name, value in settings.items() if name not in making}
        findings = check(source, part=part, progress=bar.progress, **settings)
    report(json_ready(asdict(findings)), translated(findings.table()))
    if not findings.can_flatten:
        raise click.exceptions.Exit(1)


@options.command(
    "register",
    "voxflat register lh.white -o lh.sphere.reg.surf.gii",
    "voxflat register wm.nii.gz --label 2 --repair voxels --side left -o lh.sphere.reg",
)
@options.input_
@options.surface_options
@options.section(
    "Registration", option_of(Surface.register, "side", type=options.SIDE, metavar="[left|right]", sentences=3)
)
@options.output(
    "Output file for the registered sphere, which has a radius of 100: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer "
    "name such as lh.sphere.reg."
)
@options.run(options.threads, options.memory_limit)
def register_command(input_: Path, output: Path, writing: dict[str, Any], **settings: Any) -> None:
    """Register a hemisphere to the fsaverage sphere.

    The registration aligns the folding pattern of the surface with that of fsaverage. The output can be used in place
    of the FreeSurfer file ?h.sphere.reg. Surfaces that are not recognised as cerebral hemispheres are rejected.
    """
    check_output(output, **writing)
    with bars() as bar:
        whole = surface_of(input_, settings, bar.progress)
        sphere = whole.register(settings["side"], threads=settings["threads"], progress=bar.progress)
    sphere.save(output, **writing)
    size = {"output": str(output), "vertices": len(sphere.points), "side": sphere.side, "confidence": sphere.confidence}
    text = (
        f"{sphere.side} hemisphere, confidence {sphere.confidence:.2f}\n{size['vertices']} vertices\nsaved as {output}"
    )
    report({**size, **sphere.figures, "warnings": list(sphere.warnings), "provenance": sphere.provenance}, text)


@options.command(
    "surface",
    "voxflat surface wm.nii.gz --threshold 0.5 --repair voxels -o wm.surf.gii",
    "voxflat surface labels.nii.gz --label 3 --repair voxels --repaired repaired.nii.gz -o label3.vtp",
)
@options.input_
@options.surface_options
@options.output(
    "Output file for the surface: .surf.gii, .vtp, .ply, .obj, or a FreeSurfer name such as lh.white.",
    options.writes(
        "--repaired", "Also write a label volume of the voxels that the repair changed: 1 for removed, 2 for added."
    ),
)
@options.run(options.threads, options.memory_limit)
def surface_command(input_: Path, output: Path, repaired: Path | None, writing: dict[str, Any], **making: Any) -> None:
    """Extract the surface of a volume, or check and convert a mesh.

    Each vertex of the surface of a volume represents one surface voxel and has a subvoxel position; voxflat does not
    compute an isosurface. FreeSurfer files are written in tkRAS coordinates with a footer that locates them in scanner
    space. All other formats are written in scanner RAS coordinates, which other tools expect when they display surfaces
    with volumes.
    """
    check_output(output, **writing)
    if repaired is not None:
        check_output(repaired)
        check_volume_name(repaired)
        if making["repair"] in ("none", "cuts"):
            reason = f"--repair {making['repair']} does not change any voxels"
            raise InputError(f"cannot write {repaired}: {reason}. Pass --repair voxels, or omit --repaired.")
    if not output.name.lower().endswith((*FLAT_PATCH_ENDINGS, PATCH_ENDING)):  # save() has a better message for these
        check_mesh_name(output)
    with bars() as bar:
        extracted = surface_of(input_, making, bar.progress)
        for warning in extracted.warnings:
            log.warning(warning)
    if repaired is not None:
        affine = scaled(extracted.origin.voxels.affine, extracted.origin.unit, "mm")
        write_volume(repaired, extracted.changed_voxels(), affine, extracted.provenance)
    extracted.save(output, **writing)
    size = {"vertices": len(extracted), "triangles": len(extracted.faces)}
    content = {"output": str(output), **size, "metadata": extracted.metadata, "warnings": list(extracted.warnings)}
    report(json_ready(content), f"{len(extracted)} vertices, {len(extracted.faces)} triangles\nsaved as {output}")


_VALUE_ENDINGS = (".func.gii", ".shape.gii", ".npy")


@options.command(
    "smooth",
    "voxflat smooth lh.white --pial lh.pial --values lh.thickness --fwhm 10 -o lh.thickness_10mm.shape.gii",
    "voxflat smooth lh.midthickness.surf.gii --values lh.bold.func.gii --fwhm 4 -o lh.bold_4mm.func.gii",
    "voxflat smooth lh.white --drop lh.Medial_wall.label --values lh.zstat.mgh --fwhm 6 -o lh.zstat_6mm.func.gii",
)
@options.input_
@options.surface_options
@options.region
@options.section(
    "Smoothing",
    options.reads("--values", "Values at the vertices: GIFTI, CIFTI, FreeSurfer or NIfTI.", required=True),
    option_of(Surface.smooth_values, "fwhm", type=options.NUMBER, metavar="MM", required=True),
)
@options.output("Output file for the smoothed values: .func.gii, .shape.gii or .npy.")
@options.run(options.threads, options.memory_limit)
def smooth_command(
    input_: Path, values: Path, fwhm: float, output: Path, writing: dict[str, Any], **settings: Any
) -> None:
    """Smooth values along a surface.

    The kernel is a Gaussian along INPUT. It stops at the boundary of the region (use --drop for the medial wall) and at
    vertices without a value, which stay NaN. With --pial, distances are those of the surface midway between both.
    """
    check_output(output, _VALUE_ENDINGS, **writing)
    with bars() as bar, reading(settings.get("memory_limit")) as files:
        part = part_of(settings, bar.progress)(surface_of(input_, settings, bar.progress))
        structure = None if part.is_voxels else part.origin.structure
        names = distinct_names(read_channels(values, part.count, structure=structure).names)
        smoothed = part.smooth_values(values, fwhm, threads=settings["threads"], progress=bar.progress)
    told = {"self": part.provenance, "values": str(values), "fwhm": fwhm}
    record = record_of("smooth_values", told, dict(sorted(files.items())))
    columns = smoothed.reshape(len(smoothed), -1).T
    with saving(output, record, **writing), atomic_path(output) as beside:
        if output.name.lower().endswith(".npy"):
            with beside.open("wb") as file:
                np.save(file, smoothed)
        else:
            beside.write_bytes(value_bytes(dict(zip(names, columns, strict=True)), structure, record))
    known = int(np.isfinite(columns[0]).sum())
    content = {"output": str(output), "maps": len(columns), "vertices": known, "provenance": record}
    text = f"{len(columns)} map{'s' * (len(columns) != 1)} at {known} of {part.count} vertices\nsaved as {output}"
    report(json_ready(content), text)
