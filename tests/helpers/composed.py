"""The pipeline in one call, for tests with tables of options: each option is passed to its stage."""

from dataclasses import fields

import voxflat
from voxflat import figures
from voxflat.methods import METHODS

MAKING = ("label", "threshold", "spacing", "affine", "probability", "sheet", "pial", "repair", "unit")
PARTS = ("keep", "drop", "seed_point", "radius", "polygon")


def part(source, given):
    """Make a surface, if the source is none, and choose its part; remove the options used from `given`."""
    making = {name: given.pop(name) for name in MAKING if name in given}
    chosen = {name: given.pop(name) for name in PARTS if given.get(name) is not None}
    limits = {name: given[name] for name in ("threads", "memory_limit", "progress") if name in given}
    surface = voxflat.surface(source, **making, **limits)
    if "keep" in chosen:
        surface = surface.keep(chosen["keep"])
    if "drop" in chosen:
        surface = surface.drop(chosen["drop"])
    if "seed_point" in chosen and "radius" in chosen:
        surface = surface.disk(chosen["seed_point"], chosen["radius"])
    return surface.polygon(chosen["polygon"]) if "polygon" in chosen else surface


def flatten(source, *, method="voxflat", **given):
    surface = source if isinstance(source, voxflat.CutSurface) else part(source, given)
    if isinstance(method, str) and method in METHODS:
        kind = METHODS[method]
        own = {one.name: given.pop(one.name) for one in fields(kind) if one.name in given}
        of_others = {one.name for other in METHODS.values() for one in fields(other)} & given.keys()
        if of_others:
            raise voxflat.InputError(f"the method {method} has no option {min(of_others)}")
        method = kind(**{name: value for name, value in own.items() if value is not None})
    return surface.flatten(method, **given)


def cut(source, cuts=None, **given):
    return part(source, given).cut(cuts, **given)


def geodesic(source, sources, **given):
    return part(source, given).geodesic(sources, **given)


def path(source, *stops, **given):
    return part(source, given).path(*stops, **given)


def patches(source, *limit, **given):
    surface = part(source, given)
    given.pop("memory_limit", None)
    return surface.patches(*limit, **given)


def check(source, **given):
    chosen = {name: given.pop(name) for name in PARTS if given.get(name) is not None}
    return voxflat.check(source, **given, part=lambda surface: part(surface, dict(chosen)))


def of_overlay(overlay, look):
    """Make an overlay if `look` contains its options, which are removed."""
    own = {one.name: look.pop(one.name) for one in fields(figures.Overlay) if one.name in look}
    return figures.Overlay(overlay, **own) if own else overlay


def flat_map(flat_map, overlay=None, **look):
    return figures.flat_map(flat_map, of_overlay(overlay, look), **look)


def movie(flat_map, overlay, **look):
    return figures.movie(flat_map, of_overlay(overlay, look), **look)


def with_method(given):
    """Return options of the accessor, with those of the method in a method object."""
    given = dict(given)
    kind = METHODS[given.pop("method", "voxflat")]
    own = {one.name: given.pop(one.name) for one in fields(kind) if one.name in given}
    return {**given, "method": kind(**own)}
