"""The commands `voxflat measure` and `voxflat worst`, which report the distortion of flat maps."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import load_maps, parcels_of_sides, surface_of
from voxflat.cli.options import FILE
from voxflat.cli.output import FIGURE_ENDINGS, check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.evaluation.measure import compare, measure
from voxflat.io.label_tables import LABEL_FILES
from voxflat.io.reading import reading
from voxflat.maps.worst_places import WORST_ENDINGS
from voxflat.maps.worst_search import worst_places

_REFERENCE = (
    'How distances on the surface are measured: "exact", or the faster "graph" (see --geodesic of voxflat rows).'
)
_USUAL = "exact for meshes, graph for volumes"
_OWN = "own map"
_BEYOND = "List regions whose areas change by more than this factor."


@options.command(
    "measure",
    "voxflat measure lh.white lh.cortex.patch.flat",
    "voxflat measure lh.midthickness.surf.gii lh.flat.surf.gii --json",
    "voxflat measure lh.white map.npz lh.cortex.patch.flat unwrapped.obj --heat-maps maps.png",
    "voxflat measure sub.L.midthickness.surf.gii colin.L.flat.surf.gii --own-map --heat-maps maps.png",
)
@cloup.argument("surface_", metavar="SURFACE", type=FILE)
@cloup.argument("flat", metavar="FLAT...", type=FILE, nargs=-1, required=True)
@options.surface_options
@options.section(
    "Measure",
    option_of(measure, "sources", type=int, metavar="N", default="300, or fewer for exact distances on large meshes"),
    option_of(measure, "reference", type=click.Choice(["exact", "graph"]), default=_USUAL, help=_REFERENCE),
    option_of(
        measure,
        "bands",
        metavar="A,B,C,D",
        callback=options.several(4, float, "5,10,15,30"),
        default="5,10,15,30 mm for human hemispheres, and the same shares of the size of other surfaces",
    ),
    option_of(measure, "on_surface", is_flag=True, sentences=2),
    options.flag(
        "--own-map", f"Also flatten SURFACE, along the cuts of the first FLAT, and measure this map as {_OWN!r}."
    ),
    option_of(measure, "lower_bound", is_flag=True, sentences=3),
)
@options.section(
    "Output",
    options.writes(
        "--heat-maps", "Also draw the distance errors and area changes of all maps side by side (.png, .pdf or .svg)."
    ),
    options.as_json,
)
@options.run(options.seed, options.threads, options.memory_limit)
def measure_command(
    surface_: Path, flat: tuple[Path, ...], own_map: bool, heat_maps: Path | None, **settings: Any
) -> None:
    """Measure the distortion of flat maps made by any tool.

    Each FLAT is a flat map of SURFACE: a FreeSurfer patch, a flat GIFTI surface, an .obj file with texture coordinates,
    or a file written by voxflat flatten. Distances are measured in mm on SURFACE, with the same cuts as the map. A map
    that voxflat made midway between the white and pial surfaces is measured on that geometry, and a note reports this.
    All maps are measured from the same source points. A UV map in several charts has one column for each chart and one
    for the whole. With --own-map, the gain of a map made for this surface is shown. The documentation defines all
    measures.
    """
    names = [path.name for path in flat]
    if len(set(names)) < len(names):
        names = [str(path) for path in flat]
    if len(set(names)) < len(names):
        raise click.UsageError("The same FLAT is given twice. Remove one of them.")
    if heat_maps is not None:
        from voxflat import figures  # imports matplotlib

        check_output(heat_maps, FIGURE_ENDINGS)
    with bars() as bar:
        whole = surface_of(surface_, settings, bar.progress)
        maps: dict[str, object] = dict(zip(names, flat, strict=True))
        if own_map:
            how = {name: settings[name] for name in ("seed", "threads", "memory_limit")}
            maps[_OWN] = whole.flatten(cuts=flat[0], progress=bar.progress, **how)
        compared = compare(whole, maps, progress=bar.progress, **settings)
    if heat_maps is not None:
        figures.save(figures.heat_maps(compared), heat_maps, compared.provenance)
    single = compared[names[0]] if len(compared.maps) == 1 else None
    measures = {"maps": compared.figures()} if single is None else single.figures()
    words = (
        [single.in_words()]
        if single
        else [f"{name}: {one.distortion.in_words()}" for name, one in compared.maps.items()]
    )
    text = "\n".join([*words, "", (single or compared).table()])
    report({**measures, "provenance": compared.provenance}, text)


@options.command(
    "worst",
    "voxflat worst map.npz",
    "voxflat worst map.npz --beyond 2 --parcels lh.aparc.annot -o worst.tsv --figure worst.png",
    "voxflat worst map.npz --place 1 --save-cuts cuts.json",
    "voxflat flatten lh.white --pial lh.pial --cuts cuts.json -o relieved.npz",
)
@options.map_
@options.section(
    "Regions",
    option_of(worst_places, "count", type=click.IntRange(min=0), metavar="N"),
    option_of(worst_places, "beyond", type=options.NUMBER, metavar="FACTOR", help=_BEYOND),
    options.reads(
        "--parcels",
        f"Name the regions after these parcels ({LABEL_FILES}, a volume, or regions drawn on the map, .svg or .json).",
        multiple=True,
    ),
    options.reads("--table", "Names of the parcels, in the format of FreeSurferColorLUT.txt or a BIDS dseg.tsv."),
)
@options.output(
    "Write the list of regions to this file: .json, or .tsv with one row per region.",
    options.writes(
        "--save-cuts",
        "Write the cuts of the map and the suggested cuts to this file (.json). Pass the file to voxflat flatten "
        "with --cuts.",
        "cuts_file",
    ),
    options.value(
        "--place", "N", "Save only the cut for region N (may be repeated).", "numbers", type=int, multiple=True
    ),
    options.writes("--figure", "Draw the regions on the map (.png, .svg or .pdf)."),
    options.writes("--picture", "Draw the regions on the surface, seen from both sides.", metavar="PNG"),
    required=False,
)
@options.run(options.threads)
def worst_command(
    map_: Path,
    output: Path | None,
    cuts_file: Path | None,
    numbers: tuple[int, ...],
    figure: Path | None,
    picture: Path | None,
    writing: dict[str, Any],
    **settings: Any,
) -> None:
    """List the regions with the highest area distortion.

    MAP is a file written by voxflat flatten. Regions are ranked by the product of their area and its change, at the
    scale that preserves the total area. For each region, voxflat suggests a cut that runs from the border of the map
    through the region. The gain of a cut is the decrease, in percentage points, of the relative distance error of a
    coarse preview map made with the default method. The gain can be negative, because a cut that reduces area
    distortion may increase distance errors.
    """
    if numbers and cuts_file is None:
        raise click.UsageError("--place requires --save-cuts.")
    settings["parcels"] = parcels_of_sides(settings["parcels"], [None])
    if settings["table"] is not None and settings["parcels"] is None:
        raise click.UsageError("--table requires --parcels.")
    files = {output: WORST_ENDINGS, cuts_file: (".json",), figure: FIGURE_ENDINGS, picture: (".png",)}
    for file, endings in files.items():
        if file is not None:
            check_output(file, endings, **writing)
    with bars() as bar, reading() as read:
        worst = worst_places(load_maps([map_], bar.progress)[0], **settings, progress=bar.progress)
        worst = worst._with_provenance({**worst.provenance, "files": read})
    if output is not None:
        worst.save(output, **writing)
    if cuts_file is not None:
        worst.save_cuts(cuts_file, *numbers, **writing)
    if figure is not None or picture is not None:
        from voxflat import figures  # imports matplotlib

        if figure is not None:
            figures.save(figures.worst_places(worst), figure, worst.provenance)
        if picture is not None:
            figures.save_picture(figures.worst_places_3d(worst), picture, worst.provenance)
    saved = [str(file) for file in files if file is not None]
    text = "\n".join([worst.table(), *(f"saved as {file}" for file in saved)])
    report({**worst.figures(), "files": saved, "provenance": worst.provenance}, text)
