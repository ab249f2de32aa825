"""Check that files belong together: both sides of fsaverage have the same number of vertices."""

import os
import re
from pathlib import Path

from voxflat.arguments import log
from voxflat.errors import InputError
from voxflat.io import formats
from voxflat.io.files import REMEDY, contents, naming
from voxflat.io.formats import gifti
from voxflat.io.formats.border import border_structure
from voxflat.io.meshes import LEFT, RIGHT, Mesh, named_structure
from voxflat.io.origin import Origin

_SIDES = {LEFT: "left", RIGHT: "right"}
_AS_ARRAY = "Pass a file for that hemisphere, or pass the values as an array to use them anyway"


def check_side(name: object, own: str | None, structure: object, remedy: str, of: str = "the surface") -> None:
    """Raise an error if structures in GIFTI notation, such as "CortexLeft", are different hemispheres."""
    if own in _SIDES and structure in _SIDES and own != structure:
        sides = f"belongs to the {_SIDES[own]} hemisphere, but {of} belongs to the {_SIDES[str(structure)]} one"
        raise InputError(f"{name}: {sides}. {remedy}")


def check_file_side(path: str | os.PathLike[str], structure: str | None, remedy: str = _AS_ARRAY) -> None:
    """Raise an error if a file belongs to the other hemisphere."""
    if isinstance(structure, str) and structure in _SIDES and os.path.isfile(path):
        check_side(path, structure_of(path), structure, remedy)


def structure_of(path: str | os.PathLike[str]) -> str | None:
    """Return the structure of a file in GIFTI notation, if known; GIFTI metadata override the file name."""
    side = named_structure(path)
    if os.fspath(path).lower().endswith(".border"):
        return border_structure(contents(Path(path))) or side
    if formats.by_name(Path(path)) != formats.GIFTI:
        return side
    with naming(path, REMEDY):
        image = gifti.load(contents(Path(path)))
        sides = [part.meta.get("AnatomicalStructurePrimary") for part in (*image.darrays[:1], image)]
        return next(filter(None, sides), side)


def check_partner(path: str | os.PathLike[str], origin: Origin, remedy: str = _AS_ARRAY) -> None:
    """Compare a file with the origin of a surface or a map.

    Raise an error if it belongs to the other hemisphere, and warn if the names of both contain different participants.
    """
    check_file_side(path, origin.structure, remedy)
    check_participant(path, origin.input)


def check_unit(name: str, mesh: Mesh, unit: str) -> None:
    """Raise an error if a mesh declares another unit than that of the surface to which it belongs."""
    declared = mesh.declared_unit or "unknown"
    if "unknown" not in (declared, unit) and declared != unit:
        raise InputError(f"{name} is in {declared}, but the surface is in {unit}. Convert one of them")


def check_participant(path: object, of: object) -> None:
    """Warn if a file's name and that of the surface's file contain different participants."""
    own, other = (re.findall(r"sub-[A-Za-z0-9]+", str(text or "")) for text in (path, of))
    if own and other and own[-1] != other[-1]:
        name = os.path.basename(str(path))
        log.warning("%s belongs to %s, but the surface belongs to %s. Check the file", name, own[-1], other[-1])
