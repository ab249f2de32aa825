"""Find out whether a map belongs to the other hemisphere, although its mesh has the vertices of the surface."""

import numpy as np

from voxflat.maps.matching import Matched, turns
from voxflat.surfaces.manifold import Manifold, are_triangles

_ONE_SIDED = 0.8  # least share of the area of a hemisphere on one side of the midline
_MOST_OMITTED = 0.25  # share of the area; the medial wall has less than this
_LATERAL = 0.5  # share of the area more medial than the omitted part; right maps 0.13–0.26, wrong ones 0.77–0.82
_UNLIKE = 0.3  # correlation of the lengths of edges; right maps of fsaverage 0.43–0.77, wrong ones 0.10–0.22
_REMEDY = "Pass the surface of its hemisphere"


def is_mirrored(flat: Matched) -> bool:
    """Return whether a map shows its surface from inside."""
    return bool(turns(flat.uv, flat.core.faces).sum() < 0)


def other_side(whole: Manifold, flat: Matched) -> str:
    """Return why a map probably belongs to the other hemisphere, or an empty text.

    The triangles of fs_LR are those of the other hemisphere, turned round. Those of fsaverage are the same, but the
    medial wall has other vertices.
    """
    if flat.structure is not None and whole.origin.structure is not None:  # they agree
        return ""
    if flat.is_clockwise is False and is_mirrored(flat):
        why = "its triangles are those of the surface, turned round"
        other = "If the surface is not a hemisphere, reverse the triangles of one of the files"
        return f"the map probably belongs to the other hemisphere, because {why}. {_REMEDY}. {other}"
    omitted = _omitted_on_the_outside(whole, flat)
    if not omitted or not _likeness(flat) < _UNLIKE:
        return ""
    why = f"the part that it omits ({100 * omitted:.0f} % of the area) is lateral on this surface, not medial"
    return f"the map probably belongs to the other hemisphere, because {why}. {_REMEDY}"


def _omitted_on_the_outside(whole: Manifold, flat: Matched) -> float:
    """Return the share of the area that a map of a hemisphere omits, if this part is lateral, and otherwise 0."""
    faces = whole.vertices[whole.faces]
    is_omitted = ~are_triangles(faces, flat.vertices[flat.core.faces])
    corners = whole.space.to_scanner(whole.points)[whole.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total, across = areas.sum(), corners[..., 0].mean(axis=1)
    outwards = across * np.sign(across @ areas)
    omitted = float(areas[is_omitted].sum() / total)
    if not 0 < omitted < _MOST_OMITTED or areas[outwards > 0].sum() < _ONE_SIDED * total:
        return 0.0
    place = np.average(outwards[is_omitted], weights=areas[is_omitted])
    return omitted if areas[outwards < place].sum() > _LATERAL * total else 0.0


def _likeness(flat: Matched) -> float:
    """Return the correlation between the logarithms of the lengths of edges on the map and on the surface."""
    ends = flat.core.faces, np.roll(flat.core.faces, 1, axis=1)
    lengths = [np.linalg.norm(at[ends[0]] - at[ends[1]], axis=2).ravel() for at in (flat.uv, flat.core.points)]
    is_long = (lengths[0] > 0) & (lengths[1] > 0)
    on_map, on_surface = (np.log(one[is_long]) for one in lengths)
    return float(np.corrcoef(on_map, on_surface)[0, 1]) if len(on_map) > 2 else np.nan
