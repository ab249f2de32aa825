"""The command `voxflat patches`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.atlases.atlas import Atlas
from voxflat.atlases.layout import PACKINGS
from voxflat.atlases.making import SEEDS
from voxflat.atlases.page import FlatPage
from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.input import surface_of
from voxflat.cli.options import FILE
from voxflat.cli.output import FIGURE_ENDINGS, check_output, report
from voxflat.cli.parameter_options import option_of
from voxflat.io.files import SAVED_ENDINGS
from voxflat.maps.textures.textured import TEXTURED_ENDINGS, TexturedSurface, files_beside
from voxflat.pipeline.surface import Surface


@options.command(
    "patches",
    "voxflat patches lh.white -o atlas.npz",
    "voxflat patches skull.obj --bound 1.1763 -o atlas.npz --page page.png --picture skull.png",
    "voxflat patches labels.nii.gz --label 3 --count 200 --json -o atlas.npz",
    "voxflat patches lh.white --glue 1.5 -o glued.npz --page page.png",
    "voxflat patches lh.white --volume t1.nii.gz --depth 2 -o atlas.glb",
)
@cloup.argument("surface_", metavar="SURFACE", type=FILE)
@options.surface_options
@options.section(
    "Patches",
    option_of(Surface.patches, "max_angle", type=options.NUMBER, metavar="DEGREES"),
    option_of(Surface.patches, "bound", type=options.NUMBER, metavar="C"),
    option_of(Surface.patches, "count", type=int, metavar="N"),
    option_of(Surface.patches, "seeds", type=click.Choice(SEEDS), sentences=3),
    options.value(
        "--glue",
        "C",
        "Close seams between patches as long as no length changes by more than this factor.",
        type=options.NUMBER,
    ),
)
@options.section(
    "Texture",
    option_of(Atlas.page, "packing", type=click.Choice(PACKINGS), sentences=2),
    options.reads("--volume", "Show this volume. For a mesh, an overlay or the texture of the mesh is also accepted."),
    options.value("--volume-channel", "NAME|N", "Channel of --volume: its name, or its number from 0."),
    options.flag("--heat-map", "Show C, the factor by which lengths change."),
    options.value(
        "--depth",
        "MM",
        "Distance outside the surface at which the volume is sampled, in the unit of the map.  [default: 0]",
        type=options.NUMBER,
    ),
    options.value(
        "--pixel-size",
        "MM",
        "Side length of a pixel, in the unit of the map.  [default: as for voxflat image]",
        type=options.NUMBER,
    ),
)
@options.output(
    "Output file: .npz or .voxflat for the complete atlas, or .obj (with .mtl and .png), .vtp (with .png), .glb or "
    ".ply for the surface with the page as its texture.",
    options.writes("--page", "Also draw all patches on a page (.png, .pdf or .svg)."),
    options.writes("--picture", "Also draw the surface with each patch in its own colour.", metavar="PNG"),
)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def patches_command(
    surface_: Path,
    output: Path,
    page: Path | None,
    picture: Path | None,
    glue: float | None,
    packing: str,
    writing: dict[str, Any],
    quiet: bool,
    **settings: Any,
) -> None:
    """Flatten a surface in patches with certified distortion.

    SURFACE is a volume or a mesh of any topology. The surface is divided into patches, and each patch is projected onto
    a plane. The distortion has proven bounds: lengths change by at most a factor of C, and the dilatation of angles is
    at most K (Appleboim, Saucan and Zeevi 2006).

    By default, textured outputs show each patch in its own colour. To show data instead, use --volume or --heat-map. To
    draw images of an atlas that was saved as .npz, use voxflat image.
    """
    check_output(output, (*SAVED_ENDINGS, *TEXTURED_ENDINGS), beside=files_beside(output), **writing)
    is_textured = output.suffix.lower() not in SAVED_ENDINGS
    texture = {name: settings.pop(name) for name in ("volume", "volume_channel", "heat_map", "depth", "pixel_size")}
    _check_texture(is_textured, **texture)
    for path in (page, picture):
        if path is not None:
            check_output(path, FIGURE_ENDINGS if path is page else (".png",))
    with bars(quiet) as bar:
        whole = surface_of(surface_, settings, bar.progress)
        del settings["memory_limit"]
        certified = whole.patches(progress=bar.progress, **settings)
        common = {"threads": settings["threads"], "progress": bar.progress}
        atlas = certified if glue is None else certified.glue(glue, **common)
    if is_textured:
        _textured(atlas.page(packing=packing), output, **texture).save(output, **writing)
    else:
        atlas.save(output, **writing)
    if page is not None or picture is not None:
        from voxflat import figures  # imports matplotlib

        if page is not None:
            figures.save(figures.atlas_page(atlas, packing=packing), page, atlas.provenance)
        if picture is not None:
            figures.save_picture(figures.atlas_3d(atlas), picture, atlas.provenance)
    content = {"output": str(output), **atlas.figures(), "metadata": atlas.metadata}
    report(content, f"{atlas.table()}\n\nsaved as {output}", quiet=quiet)


def _check_texture(
    is_textured: bool,
    volume: Path | None,
    volume_channel: str | None,
    heat_map: bool,
    depth: float | None,
    pixel_size: float | None,
) -> None:
    """Raise a usage error, before the computation, if texture options contradict each other."""
    texture = {"--volume": volume is not None, "--heat-map": heat_map, "--depth": depth is not None}
    texture["--pixel-size"] = pixel_size is not None
    if not is_textured and (named := [name for name, is_given in texture.items() if is_given]):
        flags = " and ".join(named) + (" requires" if len(named) == 1 else " require")
        remedy = "For an .npz output, use voxflat image."
        raise click.UsageError(f"{flags} a textured output (.obj, .vtp, .glb or .ply). {remedy}")
    if volume is not None and heat_map:
        raise click.UsageError("Pass either --volume or --heat-map.")
    for name, value in (("--depth", depth), ("--volume-channel", volume_channel)):
        if value is not None and volume is None:
            raise click.UsageError(f"{name} requires --volume.")


def _textured(
    page: FlatPage,
    output: Path,
    volume: Path | None,
    volume_channel: str | None,
    heat_map: bool,
    depth: float | None,
    pixel_size: float | None,
) -> TexturedSurface:
    if heat_map:
        textured = page.textured(page.heat_map(pixel_size), colour_map="inferno")
    elif volume is not None:
        textured = page.textured(page.image(volume, pixel_size, depth=depth or 0.0, channel=volume_channel))
    else:
        textured = page.textured(page.label_image(pixel_size))
    return textured.subdivided() if output.suffix.lower() == ".ply" else textured
