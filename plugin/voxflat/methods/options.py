"""Which options the methods of `voxflat.flatten` take, and what they are where they are not given.

The command line, the docstrings and napari's form take methods and defaults from here.
"""

from __future__ import annotations

from collections.abc import Callable
from string import Template
from typing import Any, TypeVar

from voxflat.arguments import checked_choice, refuse
from voxflat.surfaces.voxel_graph import LINK_LENGTHS

__all__ = ["METHODS", "OPTIONS", "default", "resolved", "telling_defaults"]

METHODS = {
    "voxflat": "over the triangles of a surface",
    "grossmann2002": "over a volume's surface voxels",
    "zigelman2002": "by fast marching",
    "schwartz1989": "by exact distances from random starts",
    "saucan2006": "glued of certified patches",
}
"""The methods, and what each is."""

_OVER_TRIANGLES = ("voxflat", "zigelman2002", "schwartz1989", "saucan2006")

OPTIONS: dict[str, dict[str, Any]] = {
    "drop": dict.fromkeys(_OVER_TRIANGLES),
    "polygon": dict.fromkeys(_OVER_TRIANGLES),
    # None: standard ones where the sphere is known, and nobody has said what to flatten; else automatic ones
    "cuts": dict.fromkeys(_OVER_TRIANGLES),
    "sphere": dict.fromkeys(_OVER_TRIANGLES),
    "mirror": dict.fromkeys(_OVER_TRIANGLES, False),
    # None: as long as it pays, unless someone has said where to cut; gluing cuts where it must
    "relax": {**dict.fromkeys(_OVER_TRIANGLES), "saucan2006": False},
    "adapt": dict.fromkeys(_OVER_TRIANGLES),
    # voxflat: more change no map that was measured; the papers': 1,000; 25 x 25; fewer than 50 leave starts in a fold
    "sources": {"voxflat": 400, "grossmann2002": 1000, "zigelman2002": 625, "schwartz1989": 50},
    "sampling": {
        "voxflat": "farthest",
        "grossmann2002": "farthest",
        "zigelman2002": "decimation",
        "schwartz1989": "farthest",
    },
    # None: links, or where they are more than 1 % off what is not
    "geodesic": {"voxflat": None},
    "weighting": {"voxflat": 0.5},
    "scale": {"voxflat": "distances"},
    "max_area": {"voxflat": None},
    "start": {"voxflat": None},
    "link_lengths": {"grossmann2002": LINK_LENGTHS},
    # None: as many rings as hold a tenth of the points
    "neighbourhood": {"schwartz1989": None},
    "starts": {"schwartz1989": 3},  # as in the paper
    "bound": {"saucan2006": 1.5},
    "keep_rows": dict.fromkeys(("voxflat", "grossmann2002", "zigelman2002", "schwartz1989"), False),
    "store": dict.fromkeys(("voxflat", "grossmann2002")),
}
"""Of each option that not every method takes: the methods that do, with its default for each."""


def default(option: str, method: str) -> Any:
    """Return what an option is for a method where it is not given."""
    return OPTIONS[option][method]


def resolved(method: object, **given: Any) -> dict[str, Any]:
    """Return the options of a method, with its defaults for what is not given.

    Parameters
    ----------
    method : str
        One of `METHODS`.
    **given
        By the names in `OPTIONS`; None is not given, nor is what is switched off (False).

    Returns
    -------
    dict
        The options that the method takes.

    Raises
    ------
    InputError
        If there is no such method, or it knows no option that is given.
    """
    method = checked_choice(method, "method", METHODS)
    unknown = {name: value for name, value in given.items() if method not in OPTIONS[name]}
    refuse(method, **{name: None if value is False else value for name, value in unknown.items()})
    return {
        name: OPTIONS[name][method] if value is None else value
        for name, value in given.items()
        if method in OPTIONS[name]
    }


_Function = TypeVar("_Function", bound=Callable[..., Any])


def telling_defaults(function: _Function) -> _Function:
    """Write the defaults into a docstring: ``$option``, or ``$option_method`` where they differ."""
    told = {f"{option}_{method}": value for option, of in OPTIONS.items() for method, value in of.items()}
    told |= {option: next(iter(of.values())) for option, of in OPTIONS.items()}
    if function.__doc__ is not None:  # not under python -OO
        function.__doc__ = Template(function.__doc__).substitute(told)
    return function
