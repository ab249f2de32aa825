"""Of which side of the brain a file is, by what it says or by its name."""

from __future__ import annotations

import os
import re
from pathlib import Path

from voxflat.arguments import checked_path
from voxflat.errors import InputError
from voxflat.io import formats
from voxflat.io.files import REMEDY, contents, naming
from voxflat.io.formats import gifti

_LEFT, _RIGHT = "CortexLeft", "CortexRight"
_NAMES = {
    r"^lh\.|[._]lh[._]|(^|_)hemi-L[_.]|\.L\.|_left[_.]": _LEFT,  # FreeSurfer, BIDS, HCP, nilearn
    r"^rh\.|[._]rh[._]|(^|_)hemi-R[_.]|\.R\.|_right[_.]": _RIGHT,
}


def named_structure(path: str | os.PathLike[str]) -> str | None:
    """Tell a side of the cortex by a name that says one: ``lh.thickness``, ``sub-01_hemi-L_curv.shape.gii``."""
    found = [structure for pattern, structure in _NAMES.items() if re.search(pattern, Path(path).name)]
    return found[0] if len(found) == 1 else None


def refuse_other_side(path: str | os.PathLike[str], structure: str | None) -> None:
    """Refuse a file of values of the other side of the cortex; what GIFTI says of itself counts more than its name."""
    if structure not in (_LEFT, _RIGHT):
        return
    path = checked_path(path)
    own = named_structure(path)
    if formats.by_name(path) == formats.GIFTI:
        with naming(path, REMEDY):
            own = gifti.first_metadata(contents(path)).get("AnatomicalStructurePrimary") or own
    if own in (_LEFT, _RIGHT) and own != structure:
        raise InputError(
            f"{path}: is of {own}, the surface of {structure}: give the file of this side, or, if it is meant, its "
            "values as an array"
        )
