"""Make the arrays of results read-only, so that a result cannot contradict itself."""

from dataclasses import fields
from functools import cached_property, wraps
from typing import Any, TypeVar, cast

import numpy as np

_Own = TypeVar("_Own", bound="ReadOnly")


def read_only(value: Any) -> Any:
    """Return a read-only view of an array, or of the arrays in a tuple, list or dictionary; anything else as it is."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        view = value.view()
        view.flags.writeable = False
        return view
    if type(value) in (tuple, list):
        return type(value)(map(read_only, value))
    if type(value) is dict:
        return {name: read_only(item) for name, item in value.items()}
    return value


class ReadOnly:
    """Base class of results: dataclasses whose fields and properties give out arrays as read-only views."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        for name, value in list(vars(cls).items()):
            if name.startswith("_"):
                continue
            if isinstance(value, property) and value.fget is not None:
                setattr(cls, name, property(_protected(value.fget), doc=value.__doc__))
            elif isinstance(value, cached_property):
                value.func = _protected(value.func)

    def __post_init__(self) -> None:
        _protect(self)

    def _with(self: _Own, **changes: Any) -> _Own:
        """Return the result with other values of some fields; unlike `replace`, it may lack the surface."""
        own = {entry.name: vars(self)[entry.name] for entry in fields(cast("Any", self)) if entry.init}
        return type(self)(**own | changes)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without values derived from them, some of which cannot be copied."""
        return {entry.name: self.__dict__[entry.name] for entry in fields(cast("Any", self))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copied or unpickled result, whose arrays NumPy makes writeable."""
        self.__dict__.update(state)
        _protect(self)


def _protect(result: Any) -> None:
    for entry in fields(result):
        if isinstance(value := vars(result)[entry.name], np.ndarray):
            object.__setattr__(result, entry.name, read_only(value))


def _protected(get: Any) -> Any:
    @wraps(get)
    def got(self: Any) -> Any:
        return read_only(get(self))

    return got
