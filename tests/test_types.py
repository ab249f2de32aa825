"""Type checkers and editors see the types of all public names, and all their public attributes are documented."""

import builtins
import dataclasses
import inspect
import re
import sys
import typing
from collections.abc import Callable
from functools import cached_property

import numpy as np
import pytest
from public_names import public

import voxflat
from voxflat.maps import option_types
from voxflat.pipeline.series import _Options

options = pytest.importorskip("voxflat._pyvista.options")

PUBLIC = {name: getattr(thing, "__func__", thing) for name, thing in public().items()}
CLASSES = {name: thing for name, thing in PUBLIC.items() if inspect.isclass(thing)}
OPERATORS = ("__call__", "__getitem__", "__init__", "__iter__")


class Imported(type):
    def __getattr__(cls, _):
        return cls

    def __getitem__(cls, parts):
        return tuple[parts]


class Unknown(metaclass=Imported):
    """A stand-in for a name that is imported for type checkers only."""


class Names(dict):
    def __missing__(self, name):
        return getattr(builtins, name, Unknown)


def holds_any(kind):
    """Return whether a type contains `Any`, apart from shapes of arrays and what NumPy's own aliases contain."""
    if kind is typing.Any:
        return True
    parts = typing.get_args(kind)
    if typing.get_origin(kind) is np.ndarray:
        return holds_any(parts[1])
    for alias in (typing.get_args(np.typing.ArrayLike), typing.get_args(np.typing.DTypeLike)):
        if all(one in parts for one in alias):
            parts = [one for one in parts if one not in alias]
    return any(holds_any(one) for part in parts for one in (part if isinstance(part, list) else [part]))


def annotations(thing):
    """Return the annotations of a function, of its overloads if it has some, or of the public fields of a class."""
    for one in typing.get_overloads(thing) or [inspect.unwrap(thing)]:
        names = Names(vars(sys.modules[one.__module__]) | {"Any": typing.Any})
        for name, kind in inspect.get_annotations(one).items():
            if not name.startswith("_"):
                yield name, eval(re.sub(r"\bSeed\b", "object", kind), names) if isinstance(kind, str) else kind


def classes(module):
    return inspect.getmembers(module, inspect.isclass)


def parts_of(name, thing):
    """Return a public function; or a class with its properties and operators."""
    yield name, thing
    for base in getattr(thing, "__mro__", ()):
        for own, value in vars(base).items() if base.__module__.startswith("voxflat") else ():
            get = (
                value.fget
                if isinstance(value, property)
                else value.func
                if isinstance(value, cached_property)
                else value
            )
            if own in OPERATORS or (get is not value and not own.startswith("_")):
                yield f"{name}.{own}", inspect.unwrap(get)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="typing.get_overloads")
def test_no_public_signature_contains_any():
    found = [
        f"{name}: {argument}"
        for thing in (*PUBLIC.items(), *classes(option_types), *classes(options))
        for name, part in parts_of(*thing)
        if isinstance(part, type | Callable)
        for argument, kind in annotations(part)
        if holds_any(kind)
    ]
    assert found == []
    assert holds_any(dict[str, list[typing.Any]])
    assert holds_any(np.typing.NDArray[typing.Any])
    assert not holds_any(np.typing.NDArray[np.number] | np.typing.ArrayLike)


def test_options_that_are_passed_on_have_the_types_of_the_function_that_takes_them():
    taken = {
        option_types.ImageOptions: (voxflat.FlatMap.image, {"volume", "pixel_size"}),
        option_types.StackOptions: (voxflat.FlatMap.images, {"volume", "pixel_size"}),
        option_types.FigureOptions: (voxflat.figures.flat_map, {"flat_map", "overlay", "ax"}),
        _Options: (voxflat.flatten_series, {"surfaces", "method", "cuts"}),
    }
    for kind, (function, named) in taken.items():
        expected = {name: one.annotation for name, one in inspect.signature(function).parameters.items()}
        assert set(kind.__annotations__) == expected.keys() - {"self", *named}
        for name, annotation in typing.get_type_hints(kind).items():
            stated = expected[name]
            names = vars(sys.modules[inspect.unwrap(function).__module__])
            assert annotation == (eval(stated, names) if isinstance(stated, str) else stated), (kind, name)


@pytest.mark.parametrize("name", [name for name in CLASSES if not name.startswith("voxflat.vtk.")])
def test_completion_on_an_object_lists_documented_names_alone(name):
    kind = CLASSES[name]
    text = "".join(one.__doc__ or "" for one in kind.__mro__)
    fields = {one.name for one in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    for attribute in {*dir(kind), *fields} - {*dir(Exception)}:
        if not attribute.startswith("_"):
            value = inspect.getattr_static(kind, attribute, None)
            is_text = isinstance(value, str | int | float | tuple | type(None))  # whose docstring is that of its class
            own = None if is_text else inspect.getdoc(value)
            assert own or re.search(rf"\b{attribute}\b", text), f"{attribute} is not documented"
