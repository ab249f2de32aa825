"""The commands `voxflat cut`, `flatten`, `group-map`, `movie-map` and `standard-map`."""

from pathlib import Path
from typing import Any

import click
import cloup
import numpy as np

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import check_numbers, part_of, surface_of
from voxflat.cli.options import FILE
from voxflat.cli.output import check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.distortion.bands import key_in_bands
from voxflat.errors import InputError
from voxflat.io.files import SAVED_ENDINGS
from voxflat.io.grid import in_unit, rounded
from voxflat.io.patches import PATCH_ENDING
from voxflat.maps.flat_map import MAP_ENDINGS, FlatMap
from voxflat.maps.summary import summary_of
from voxflat.pipeline.flat_series import FlatSeries
from voxflat.pipeline.group_map import ERRORS, flatten_group
from voxflat.pipeline.series import checked_reference, flatten_series
from voxflat.pipeline.standard_map import CUTS, DENSITIES, MESHES, standard_map
from voxflat.pipeline.surface import Surface
from voxflat.surfaces.charts import names_of

_CUT_ENDINGS = (".json", ".surf.gii", ".vtp", ".ply", ".obj", PATCH_ENDING)


@options.command(
    "cut",
    "voxflat cut lh.white --pial lh.pial --drop medial-wall --cuts automatic -o lh.cuts.json",
    "voxflat cut lh.white --drop lh.Medial_wall.label --relax-length 250 -o lh.cuts.json",
    "voxflat flatten lh.white --pial lh.pial --cuts lh.cuts.json -o lh.flat.surf.gii",
    "voxflat cut lh.white --pial lh.pial --drop medial-wall -o lh.cortex.patch.3d",
    "voxflat cut lh.white --seed-point 5000 --radius 40 --sphere lh.sphere.reg -o v1.json "
    "--save-template v1.template.json",
)
@options.input_
@options.surface_options
@options.region
@options.cuts
@options.output(
    "Output file: .json for the cuts (to pass to --cuts), or .surf.gii, .vtp, .ply, .obj or .patch.3d (for "
    "mris_flatten) for the cut surface.",
    options.writes(
        "--save-template",
        "Also write the cuts and the border of the excluded region as a template (.json). The template can be passed "
        "to --cuts for any surface of the same hemisphere with a registered sphere in the same space.",
        "template",
    ),
)
@options.run(options.threads, options.memory_limit)
def cut_command(input_: Path, output: Path, template: Path | None, writing: dict[str, Any], **settings: Any) -> None:
    """Cut a surface open for flattening.

    The cuts are those that voxflat flatten would make: a surface that is not a disk is cut open, unless it
    can be flattened with its holes, and relaxation cuts are added where they reduce the distortion of the map.
    """
    check_output(output, _CUT_ENDINGS, **writing)
    if template is not None:
        check_output(template, (".json",))
    with bars() as bar:
        part = part_of(settings, bar.progress)(surface_of(input_, settings, bar.progress))
        opened = part.cut(progress=bar.progress, **settings)
    opened.save(output, **writing)
    if template is not None:
        opened.save_template(template, overwrite=writing["overwrite"])
    cuts = [{"ids": c.ids.tolist(), "length": c.length, "reason": c.reason, "name": c.name} for c in opened.cuts]
    content = {"output": str(output), "vertices": len(opened.surface), "cuts": cuts, "warnings": list(opened.warnings)}
    lines = []
    unit = opened.surface.origin.named_unit
    for number, cut in enumerate(opened.cuts):
        length = "" if cut.length is None else in_unit(f", {rounded(cut.length, 1)} mm", unit)
        lines.append(f"{opened.title(number)}: {cut.reason}, {len(cut.ids)} vertices{length}")
    lines.append(f"{len(opened.surface)} vertices, {len(opened.surface.faces)} triangles")
    lines.append(f"saved as {output}" + ("" if template is None else f", template as {template}"))
    report({**content, "provenance": opened.provenance}, "\n".join(lines))


@options.command(
    "flatten",
    "voxflat flatten wm.nii.gz --hemisphere left -o lh.npz",
    "voxflat flatten labels.nii.gz --label 3 -o map.npz",
    "voxflat flatten wm.nii.gz --threshold 0.5 --seed-point 136,112,127 --radius 45 -o map.npz",
    "voxflat flatten mask.npy --spacing 0.5,0.5,0.5 --keep patch.npy --json -o map.npz",
    "voxflat flatten lh.white --pial lh.pial --drop lh.Medial_wall.label -o lh.flat.surf.gii",
    "voxflat flatten rh.midthickness.surf.gii --sphere rh.sphere.reg.surf.gii --mirror -o rh.npz",
    "voxflat flatten lh.midthickness.surf.gii --keep lh.cortex.patch.3d -o lh.cortex.patch.flat",
    "voxflat flatten lh.midthickness.surf.gii --start lh.cortex.patch.flat -o lh.better.npz",
    "voxflat flatten embryo.tif --threshold 35 --charts 2 --front 65,36,60 --overlap 20 -o embryo.npz",
)
@options.input_
@options.surface_options
@options.region
@options.cuts
@options.charts
@options.method_options
@options.output(
    "Output file: .npz or .voxflat for the complete map, or .surf.gii, .patch.flat, .flat.patch.3d, .vtp, .ply or .obj "
    "for the flat surface.",
    option_of(Surface.flatten, "mirror", is_flag=True),
    options.flag(
        "--rows", "Also save the distances from all sources to all points in OUT, which makes the file large."
    ),
    options.store,
)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def flatten_command(input_: Path, output: Path, writing: dict[str, Any], quiet: bool, **settings: Any) -> None:
    """Flatten a surface into a flat map.

    INPUT is a label or intensity volume (.nii, .nii.gz, .hdr, .mgh, .mgz, .nrrd, .nhdr, .mha, .mhd, .tif, .npy, .npz)
    or a mesh (.surf.gii, FreeSurfer geometry such as lh.white, .asc, .vtk, .vtp, .ply, .stl, .obj, .off, .glb). A
    volume with several labels requires --label or --threshold. With --hemisphere, the surface is cut along standard
    cuts by default. If no region is given, the largest component is flattened. A surface that is not a disk is cut
    open, unless it can be flattened with its holes, and a warning lists the cuts.
    """
    method, rows, store = options.method_of(settings), settings.pop("rows"), settings.pop("store")
    charts = options.charts_of(settings)
    count = 1 if charts is None else charts["count"]
    outputs = _outputs(output, count, MAP_ENDINGS, writing)
    if count != 1 and store is not None:
        raise click.UsageError("--store holds the distances of one map. Omit it, or pass --charts 1.")
    if charts is None and settings["hemisphere"] is not None and settings["cuts"] is None:
        settings["cuts"] = "standard"
    keep = rows if store is None else store
    with bars(quiet) as bar:
        part = part_of(settings, bar.progress)(surface_of(input_, settings, bar.progress))
        if charts is None:
            maps = [part.flatten(method, rows=keep, progress=bar.progress, **settings)]
        else:
            opened = part.charts(**charts, threads=settings["threads"], progress=bar.progress)
            maps = [part_.flatten(method, rows=keep, progress=bar.progress, **settings) for part_ in opened]
    written = list(zip(maps, outputs, strict=False))  # a tube has only the first chart of a cylinder
    for flat_map, path in written:
        flat_map.save(path, **writing)
    content = [{"output": str(path), **flat.description()} for flat, path in written]
    text = "\n\n".join(_summary(flat, path) for flat, path in written)
    report(content[0] if count == 1 else {"charts": content}, text, quiet=quiet)


@options.command(
    "movie-map",
    "voxflat movie-map frame_*.tif --threshold 0.5 --smooth 4 -o movie.npz",
    "voxflat movie-map frame_*.ply --unit µm --reference 30 -o movie.npz",
    "voxflat movie-map frame_*.ply --unit µm --charts 2 --overlap 20 -o movie.npz",
    "voxflat image movie.npz --volume frame_*.tif --depth -4:4:2 --metric -o movie.ome.tif",
)
@cloup.argument("frames", metavar="FRAME...", type=FILE, nargs=-1, required=True)
@options.frame_options
@options.frame_cuts
@options.charts
@options.method_options
@options.output(
    "Output file for the map of all frames: .npz or .voxflat.",
    option_of(flatten_series, "reference", type=int, metavar="N"),
    option_of(Surface.flatten, "mirror", is_flag=True),
)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def movie_map_command(
    frames: tuple[Path, ...], output: Path, writing: dict[str, Any], quiet: bool, **settings: Any
) -> None:
    """Flatten the surfaces of all frames of a movie into one flat map.

    Each FRAME is a volume or a mesh, as for voxflat flatten. The frames are processed in the given order. The surface
    of the reference frame is flattened, and its mesh follows the surface from frame to frame, so that material points
    keep their places on the map. To show the volumes of all frames on the map, use voxflat image.
    """
    method, charts = options.method_of(settings), options.charts_of(settings)
    count = 1 if charts is None else charts["count"]
    outputs = _outputs(output, count, SAVED_ENDINGS, writing)
    making = ("channel", "label", "threshold", "spacing", "unit", "repair", "smooth")
    making_ = {name: settings.pop(name) for name in making}
    limits = {name: settings[name] for name in ("threads", "memory_limit")}
    with bars(quiet) as bar:
        check_numbers(frames)
        surfaces = []
        for number, file in enumerate(frames):
            if bar.progress is not None:
                bar.progress("reading the frames", number, len(frames))
            try:
                surfaces.append(surface_of(file, {**making_, **limits}, None))
            except InputError as error:
                raise InputError(f"frame {number} ({file.name}): {error}") from error
        if charts is not None:
            first = surfaces[checked_reference(settings["reference"], len(frames))]
            settings["cuts"] = first.charts(**charts, threads=settings["threads"], progress=bar.progress)
        movie = flatten_series(surfaces, method, progress=bar.progress, **settings)
    written = list(zip([movie] if isinstance(movie, FlatSeries) else movie, outputs, strict=False))
    for series, path in written:
        series.save(path, **writing)
    content = [_series_content(series, path) for series, path in written]
    text = "\n\n".join(_series_summary(series, path, frames) for series, path in written)
    report(content[0] if count == 1 else {"charts": content}, text, quiet=quiet)


@options.command(
    "group-map",
    "voxflat group-map sub-*/*.L.midthickness.32k_fs_LR.surf.gii --cuts lh.cuts.json -o group.npz",
    "voxflat group-map sub-*_hemi-L_space-fsLR_midthickness.surf.gii --cuts standard --sphere "
    "L.sphere.32k_fs_LR.surf.gii -o L.group.flat.surf.gii",
    "voxflat group-map sub-*/surf/lh.white --spheres lh.sphere.reg --sphere fsaverage5/surf/lh.sphere.reg -o group.npz",
    "voxflat measure sub-07.L.midthickness.32k_fs_LR.surf.gii group.npz",
)
@cloup.argument("surfaces", metavar="SURFACE...", type=FILE, nargs=-1, required=True)
@options.section(
    "People",
    option_of(flatten_group, "weights", metavar="W,W,...", callback=options.numbers),
    options.value(
        "--spheres",
        "NAME",
        "Name or pattern of the registered sphere next to each SURFACE, through which the surfaces are resampled to "
        "the mesh of --sphere; for example, lh.sphere.reg or '*_hemi-L_space-fsLR_desc-reg_sphere.surf.gii'. Both must "
        "be registered to the same space. voxflat register makes a sphere.",
    ),
)
@options.group_cuts
@options.output(
    "Output file: .npz or .voxflat for the complete map, or .surf.gii, .patch.flat, .flat.patch.3d, .vtp, .ply or .obj "
    "for the flat surface.",
    option_of(Surface.flatten, "mirror", is_flag=True),
)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def group_map_command(
    surfaces: tuple[Path, ...], output: Path, writing: dict[str, Any], quiet: bool, **settings: Any
) -> None:
    """Flatten the surfaces of several people into one flat map.

    Each SURFACE is a mesh of one person. All have the same triangles, as surfaces that were resampled to fs_LR,
    fsaverage, onavg or SUIT, or --spheres resamples them to the mesh of --sphere. The map fits the people as well as
    possible on average, and does not depend on their order. The cuts are made on the mean surface. A table lists the
    distance errors for each person, at the scale that is best for this person.
    """
    check_output(output, MAP_ENDINGS, **writing)
    with bars(quiet) as bar:
        flat_map = flatten_group(surfaces, progress=bar.progress, **settings)
    flat_map.save(output, **writing)
    report({"output": str(output), **flat_map.description()}, _group_summary(flat_map, output), quiet=quiet)


def _group_summary(flat_map: FlatMap, output: Path) -> str:
    """Return the table of the people, and the summary of their mean."""
    people: Any = flat_map.metadata["people"]
    bands = [key_in_bands(name, flat_map.distortion.bands, flat_map.origin.unit) for name in ERRORS]
    heads = [name.removeprefix("relative_error").replace("_", " up to ") or " all" for name in bands]
    lines = ["".join([f"{'distance error, %':40}", *(f"{head:>14}" for head in heads), f"{'scale':>9}"])]
    for row in people:
        errors = ("-" if row[name] is None else f"{100 * row[name]:.1f}" for name in ERRORS)
        lines.append(f"{row['surface'][:39]:40}" + "".join(f"{error:>14}" for error in errors) + f"{row['scale']:9.3f}")
    return "\n".join([*lines, "", f"mean of {len(people)} people", _summary(flat_map, output)])


@options.command(
    "standard-map",
    "voxflat standard-map fsaverage5 --hemisphere left -o lh.npz",
    "voxflat standard-map fs_LR --density 164k --hemisphere right --cuts published --files S1200 "
    "--files standard_mesh_atlases -o R.flat.surf.gii",
)
@cloup.argument("mesh", type=click.Choice(MESHES))
@options.section(
    "Mesh",
    option_of(standard_map, "density", type=click.Choice(DENSITIES)),
    option_of(standard_map, "hemisphere", type=options.SIDE, metavar="[left|right]"),
    option_of(standard_map, "cuts", type=click.Choice(CUTS), sentences=2),
    option_of(standard_map, "files", type=FILE, metavar="FOLDER", multiple=True, sentences=2, note="May be repeated."),
)
@options.output(
    "Output file: .npz or .voxflat for the complete map, or .surf.gii, .patch.flat, .flat.patch.3d, .vtp, .ply or .obj "
    "for the flat surface.  [default: MESH.HEMISPHERE.npz]",
    required=False,
)
@options.run(options.threads, options.memory_limit, options.quiet)
def standard_map_command(mesh: str, output: Path | None, writing: dict[str, Any], quiet: bool, **settings: Any) -> None:
    """Make the flat map of a standard mesh, fsaverage or fs_LR.

    MESH is fsaverage, fsaverage5, fsaverage6 or fs_LR. All densities of a mesh have the same map. The map is made from
    surfaces that are installed with other packages, or from your own files. If a file is missing, an error names it.
    """
    output = output or Path(f"{mesh}.{settings['hemisphere']}.npz")
    check_output(output, MAP_ENDINGS, **writing)
    with bars(quiet) as bar:
        flat_map = standard_map(mesh, progress=bar.progress, **settings)
    flat_map.save(output, **writing)
    report({"output": str(output), **flat_map.description()}, _summary(flat_map, output), quiet=quiet)


def _outputs(output: Path, count: int | str, endings: tuple[str, ...], writing: dict[str, Any]) -> list[Path]:
    """Return the output files of all charts, after checking them."""
    outputs = [output] if count == 1 else [output.with_name(f"{name}.{output.name}") for name in names_of(count)]
    for path in outputs:
        check_output(path, endings, **writing)
    return outputs


def _series_content(series: FlatSeries, output: Path) -> dict[str, Any]:
    content = {"output": str(output), "frames": len(series), "reference": series.reference}
    content |= {"map": series.flat_map.description(), "gaps": series.gaps.tolist(), "folded": series.folded.tolist()}
    return {**content, "provenance": series.provenance}


def _series_summary(series: FlatSeries, output: Path, frames: tuple[Path, ...]) -> str:
    flat_map, gaps, folded = series.flat_map, series.gaps, series.folded
    width, height = np.ptp(flat_map.uv, axis=0)
    rows = {"frames": f"{len(series)}, flattened: {series.reference} ({frames[series.reference].name})"}
    rows["map"] = f"{rounded(width, 1)} x {rounded(height, 1)} mm, {len(flat_map)} points"
    if flat_map.period is not None:
        rows["period"] = f"{rounded(flat_map.period, 1)} mm"
    rows["largest gap"] = f"{gaps.max():.2g} mm (95th percentile in frame {gaps.argmax()})"
    rows["folded triangles"] = f"{folded.max()}" + (f" in frame {folded.argmax()}" if folded.any() else "")
    lines = [f"{name:22}{value}" for name, value in rows.items()]
    text = in_unit("\n".join(lines), flat_map.origin.named_unit)
    return f"{text}\n\ndistortion of frame {series.reference}\n{flat_map.distortion.table()}\n\nsaved as {output}"


def _summary(flat_map: FlatMap, output: Path) -> str:
    details: dict[str, Any] = flat_map.details
    width, height = np.ptp(flat_map.uv, axis=0)
    torn = f", {100 * flat_map.torn.mean():.1f} % of it torn" if flat_map.distortion.triangles is None else ""
    cut_names = ", ".join(cut.name for cut in flat_map.cuts if cut.name)
    rows = {"flattened": f"{details['points']} of {details['surface_points']} points, {_part(flat_map, details)}"}
    if cut_names:
        rows["cuts"] = f"{flat_map.cuts_by}: {cut_names}"
    if flat_map.period is not None:
        rows["period"] = f"{rounded(flat_map.period, 1)} mm"
    if len(flat_map.sources):
        rows["sources"] = str(len(flat_map.sources))
    rows["map"] = f"{rounded(width, 1)} x {rounded(height, 1)} mm{torn}"
    if "memory_need_bytes" in details:
        rows["memory, at most"] = f"{details['memory_need_bytes'] / 2**20:.0f} MiB"
    rows["distance error"] = flat_map.distortion._summary()
    lines = [f"{name:22}{value}" for name, value in rows.items()]
    text = in_unit("\n".join(lines), flat_map.origin.named_unit)
    return f"{text}\n\n{flat_map.distortion.table()}\n\nsaved as {output}"


def _part(flat_map: FlatMap, details: dict[str, Any]) -> str:
    """Describe the part of the surface that was flattened."""
    if (chart := summary_of(flat_map).chart) is not None:
        return f"the chart {chart!r}"
    parts = ["inside the mask"] if details["keep"] or details.get("drop") else []
    if details["seed_point"] is not None:
        item = "voxel" if flat_map.is_voxels else "vertex"
        parts.append(f"within {details['radius']} mm of {item} {details['seed_point']}")
    return " ".join(parts) or ("all" if details["points"] == details["surface_points"] else "the largest component")
