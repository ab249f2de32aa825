"""Create the surface, or the part of a surface, that a command processes."""

import itertools
import os
import re
import statistics
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from voxflat._core import __version__
from voxflat.arguments import Progress, log
from voxflat.cli.output import SHOWN, WRITTEN
from voxflat.errors import HemisphereError, InputError
from voxflat.evaluation.given_map import load
from voxflat.io.partners import structure_of
from voxflat.io.provenance import check_beside
from voxflat.io.reading import reading
from voxflat.io.volumes import Volume, read_volume
from voxflat.laminar.rim import rim
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.hemispheres import hemisphere
from voxflat.surfaces.parts import is_medial_wall
from voxflat.wording import many

_MAKING = ("label", "threshold", "spacing", "unit", "probability", "pial", "repair")


def load_maps(maps: Sequence[Path], progress: Progress | None = None) -> list[FlatMap]:
    """Load maps; --surface and --pial name the surfaces of those that other tools made."""
    meta, count = click.get_current_context().meta, len(maps)
    shown = []
    for name in ("surface", "pial"):
        files = meta.get(f"{SHOWN}.{name}") or (None,) * count
        if len(files) != count:
            number = f"{many(len(files), 'time')} for {many(count, 'map')}"
            raise click.UsageError(f"--{name} is given {number}. Pass it once per map.")
        shown.append(files)
    return [load(path, surface, pial=pial, progress=progress) for path, surface, pial in zip(maps, *shown, strict=True)]


def surface_of(input_: Path, settings: dict[str, Any], progress: Progress | None) -> Surface:
    """Create the surface of an input, and remove the surface options from the command's options."""
    making, side = {name: settings.pop(name, None) for name in _MAKING}, settings.pop("hemisphere", None)
    making["probability"] = _probability(making["probability"], settings.pop("probability_channel", None), settings)
    smooth, source = settings.pop("smooth"), channel_of(input_, settings.pop("channel"), settings)
    made = _made(source, settings, making, side, progress)
    return made if smooth is None else made.smooth(smooth, progress=progress)


def channel_of(path: Path, channel: str | None, settings: dict[str, Any]) -> Path | Volume:
    """Return one channel of a file as a volume, or the path if no channel is chosen."""
    if channel is None:
        return path
    with reading(settings.get("memory_limit")):
        return read_volume(path, channel)


def _probability(path: Path | None, channel: str | None, settings: dict[str, Any]) -> Volume | None:
    """Return the image that --probability names, or one of its channels."""
    if path is None:
        if channel is not None:
            raise click.UsageError("--probability-channel requires --probability.")
        return None
    try:
        with reading(settings.get("memory_limit")):
            return read_volume(path, channel)
    except InputError as error:
        text = re.sub(r", as in voxflat\.io\.read_volume\(.*\)", " with --probability-channel", str(error))
        raise InputError(re.sub(r"\bchannel(?= is\b)|(?<=Omit )channel\b", "--probability-channel", text)) from error


def _made(
    input_: Path | Volume, settings: dict[str, Any], how: dict[str, Any], side: str | None, progress: Progress | None
) -> Surface:
    """Create the surface of a file or a volume."""
    limits = {name: settings[name] for name in ("memory_limit", "threads") if name in settings}
    if settings.pop("rim", False):
        named = ("label", "threshold", "unit", "probability", "pial", "repair")
        if refused := [name for name in named if how[name] is not None]:
            raise InputError(f"--{refused[0]} and --rim cannot be combined. Pass only one of them.")
        return rim(input_, hemisphere=side, spacing=how["spacing"], **limits, progress=progress).surface
    if side is None:
        return surface(input_, **how, **limits, progress=progress)
    for name in ("label", "unit", "probability", "pial"):
        if how[name] is not None:
            raise InputError(f"--{name} and --hemisphere cannot be combined. Pass only one of them.")
    try:
        white = hemisphere(input_, side, threshold=how["threshold"], spacing=how["spacing"], progress=progress)
    except HemisphereError as error:
        from voxflat import figures

        output = click.get_current_context().meta.get(WRITTEN, {}).get("output")
        if output is None:
            raise
        picture = output.with_name(f"{output.name}.failed.png")
        try:
            check_beside(output, picture)
            figures.save(error.figure(), picture, {"voxflat": __version__})
        except (InputError, OSError):  # the reason why the hemisphere was not found is more important
            raise error from None
        message = f"{str(error).rstrip('.')}. {picture} shows the voxels that were assumed to be white matter."
        raise InputError(message) from error
    return surface(white, repair=how["repair"] or "voxels", **limits, progress=progress)


def check_numbers(paths: Sequence[Path]) -> None:
    """Warn if the numbers in the names of frames have gaps or are not ascending, as in an alphabetical order."""
    names = [re.split(r"([0-9]+)", os.fspath(path)) for path in paths]
    if len({len(parts) for parts in names}) > 1:
        return
    columns = list(zip(*names, strict=True))
    varying = [n for n, column in enumerate(columns) if len(set(column)) > 1]
    if len(varying) != 1 or varying[0] % 2 == 0:  # the names differ in more than one number
        return
    digits = columns[varying[0]]
    steps = [int(after) - int(before) for before, after in itertools.pairwise(digits)]
    usual = statistics.mode([step for step in steps if step > 0] or [1])
    missing = []
    for n, step in enumerate(steps):
        if step < 0:
            text = "%s comes before %s, so the frames are not in the order of their numbers. Pass them in their order"
            log.warning(text, paths[n], paths[n + 1])
            return
        gap = range(int(digits[n]) + usual, int(digits[n + 1]), usual) if step else ()
        ends = [str(gap[place]).zfill(len(digits[n])) for place in ((0, -1) if len(gap) > 1 else (0,) if gap else ())]
        files = ["".join([*names[n][: varying[0]], end, *names[n][varying[0] + 1 :]]) for end in ends]
        missing += [" to ".join(files)] if files else []
    if missing:
        log.warning("frames are missing: %s", textwrap.shorten(", ".join(missing), 300, placeholder=" ..."))


def part_of(settings: dict[str, Any], progress: Progress | None) -> Callable[[Surface], Surface]:
    """Return a function that cuts out a part of a surface, and remove its options from the command's options."""
    keep, drop, polygon = (settings.pop(name) for name in ("keep", "drop", "polygon"))
    seed_point, radius = settings.pop("seed_point"), settings.pop("radius")
    if (seed_point is None) != (radius is None):
        named, missing = ("--seed-point", "--radius") if radius is None else ("--radius", "--seed-point")
        raise InputError(f"{named} is given without {missing}. Pass both or neither.")

    def choose(part: Surface) -> Surface:
        if keep is not None:
            part = part.keep(keep)
        for region in sorted(drop, key=lambda region: not is_medial_wall(region)):  # it is found on the whole surface
            part = part.drop(region)
        if seed_point is not None and radius is not None:
            part = part.disk(seed_point, radius, threads=settings.get("threads"), progress=progress)
        return part if polygon is None else part.polygon(polygon, progress=progress)

    return choose


def sides_of(path: Path, structures: Sequence[str | None]) -> list[int]:
    """Return the surfaces or maps, given by their structures, to which a file applies."""
    if len(structures) == 1:
        return [0]
    if path.name.lower().endswith((".dlabel.nii", ".dscalar.nii")):
        return [0, 1]
    own = structure_of(path)
    which = [n for n, structure in enumerate(structures) if own is not None and structure == own]
    if len(which) != 1:
        raise InputError(
            f"{path}: the hemisphere of the file is unknown. Begin its name with lh. or rh., or pass a CIFTI file"
        )
    return which


def parcels_of_sides(paths: Sequence[Path], structures: Sequence[str | None]) -> Any:
    """Return files of parcels as functions expect them: one or a list for each surface or map, or a file for both."""
    if not paths or len(structures) == 1:
        return None if not paths else paths[0] if len(paths) == 1 else list(paths)
    if len(paths) == 1 and paths[0].name.lower().endswith(".dlabel.nii"):
        return paths[0]
    each: list[list[Path]] = [[], []]
    for path in paths:
        for n in sides_of(path, structures):
            each[n].append(path)
    if not all(each):
        raise InputError("the parcels belong to one hemisphere. Pass parcels of both hemispheres, or of one only")
    return [own[0] if len(own) == 1 else own for own in each]
