"""Choose the cuts of a surface: standard cuts, a template's cuts, or the automatic cuts of `voxflat.flatten`."""

import os
from dataclasses import dataclass
from pathlib import Path

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.surfaces.manifold import Manifold
from voxflat.surfaces.standard.registration import register
from voxflat.surfaces.standard.sphere import Sphere, registered_sphere, sphere_beside, sphere_of
from voxflat.surfaces.standard.template import STANDARD, Template, is_template, read_template, standard_template

AUTOMATIC = "automatic"  # value of `cuts` for cuts computed for each surface


@dataclass(frozen=True, eq=False)
class Choice:
    """Store the chosen cuts."""

    template: Template | None  # template whose cuts are used
    sphere: Sphere | None  # sphere of the surface, if known
    warnings: tuple[str, ...] = ()  # warnings for the user


def chosen(
    whole: Manifold,
    cuts: object,
    sphere: object | None,
    *,
    is_free: bool,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Choice:
    """Choose the cuts: by default standard cuts for a complete closed surface with a sphere."""
    asked: str | Path | Template | None = None
    if isinstance(cuts, Template) or (isinstance(cuts, str) and cuts == STANDARD):
        asked = cuts
    if asked is None and isinstance(cuts, str | os.PathLike) and cuts != AUTOMATIC and is_template(Path(cuts)):
        asked = Path(cuts)
    if asked is not None:
        place = sphere_beside(whole) if sphere is None else sphere
        if place is None:
            fitted = register(whole, None, threads, progress)
            text = f"the surface was registered by its folds ({fitted.side}, confidence {fitted.confidence:.2f})"
            warnings = [warning for warning in fitted.warnings if warning not in whole.warnings]
            placed, warnings = registered_sphere(fitted), [*warnings, f"no sphere was found, so {text}"]
        else:
            placed, warnings = sphere_of(whole, place)
        if isinstance(asked, Template):
            named = asked
        else:
            named = standard_template(placed.space, placed.side) if asked == STANDARD else read_template(asked)
        _check_fits(named, placed)
        return Choice(named, placed, tuple(warnings))
    place = sphere_beside(whole) if sphere is None and cuts is None and is_free else sphere
    if place is None:
        return Choice(None, None)
    try:
        placed, warnings = sphere_of(whole, place)
    except InputError as error:
        if sphere is not None:
            raise
        warning = f"automatic cuts are used, because the sphere next to the surface file does not match: {error}"
        return Choice(None, None, (warning,))
    is_standard = cuts is None and is_free and _is_closed(whole)
    return Choice(standard_template(placed.space, placed.side) if is_standard else None, placed, tuple(warnings))


def _check_fits(template: Template, sphere: Sphere) -> None:
    for name, wants, other in (("side", template.side, sphere.side), ("space", template.space, sphere.space)):
        if wants != other:
            raise InputError(
                f"the {name} of the template {template.name} is {wants}, but the {name} of the sphere {sphere.name} is "
                f"{other}. Pass a template and a sphere with the same {name}"
            )


def _is_closed(whole: Manifold) -> bool:
    topology = whole.core.topology()
    largest = topology["components"][0]
    return not topology["loops"] and int(largest["euler"]) == 2
