"""Base classes of the methods; a method is an object with options that flattens a surface."""

import os
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from voxflat import _core
from voxflat.arguments import (
    amount,
    check_memory,
    checked_seed,
    checked_switch,
    log,
    shown,
    workers,
)
from voxflat.errors import InputError
from voxflat.io.provenance import described
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.map_cuts import opened_along
from voxflat.surfaces.cutting import CutManifold, CutSettings, without_holes
from voxflat.surfaces.manifold import Manifold

Rows = bool | str | os.PathLike[str]  # whether to keep distances in memory, or the directory of a store


@dataclass(frozen=True, kw_only=True)
class FlattenSettings(CutSettings):
    """The arguments of `voxflat.Surface.flatten`, other than the method."""

    mirror: bool = False
    rows: Rows = False
    seed: int = 0
    memory_limit: int | None = None

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        if not isinstance(self.rows, str | os.PathLike):
            object.__setattr__(self, "rows", checked_switch(self.rows, "rows"))
        object.__setattr__(self, "mirror", checked_switch(self.mirror, "mirror"))
        object.__setattr__(self, "seed", checked_seed(self.seed))

    @property
    def keep_rows(self) -> bool:
        """Whether the distances are kept in memory."""
        return self.rows is True

    @property
    def store(self) -> str | os.PathLike[str] | None:
        """The directory of the store for the distances, or None."""
        return None if isinstance(self.rows, bool) else self.rows

    @property
    def workers(self) -> int:
        """Number of threads."""
        return workers(self.threads)

    def rows_memory_need(self, sources: int, points: int) -> int:
        """Return the memory that rows need in addition to the memory of the method."""
        if self.store is not None:
            return _core.store_memory_need(points, sources, self.workers)
        return 4 * sources * points if self.keep_rows else 0

    def check_memory(self, need: int, remedy: str = "flatten a smaller patch, or use fewer sources") -> int:
        """Return the memory that is needed; raise an error if it is not available."""
        check_memory(need, self.memory_limit, remedy)
        log.info("up to %s of memory will be used", amount(need))
        return need


@dataclass(frozen=True, kw_only=True)
class Method:
    """Base class of the methods that flatten a surface.

    Each method is a dataclass whose fields are its options. Its class attributes are its ``name``, which
    `Surface.flatten` accepts, and a ``summary``.

    See Also
    --------
    Surface.flatten : Flatten a surface with a method.
    method_of : Return a method object by name.

    Examples
    --------
    >>> voxflat.methods.method_of("zigelman2002").sources
    625
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    _takes_rows: ClassVar[bool] = True
    _takes_store: ClassVar[bool] = False
    _takes_tubes: ClassVar[bool] = False

    @property
    def provenance(self) -> dict[str, object]:
        """Return the name of the method and its options. Maps keep this record, so that they can be reproduced."""
        return {"method": self.name, **{option.name: described(getattr(self, option.name)) for option in fields(self)}}

    def _check(self, settings: FlattenSettings) -> None:
        """Raise an error if the method does not support the requested rows."""
        if settings.rows is not False and not self._takes_rows:
            raise InputError(f"the method {self.name!r} does not measure distances. Omit rows")
        if settings.store is not None and not self._takes_store:
            raise InputError(f"the method {self.name!r} cannot write a store. Pass rows=True to keep rows in memory")

    def _flatten(self, surface: Manifold | CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Flatten a surface."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class OverTriangles(Method):
    """A method that flattens a disk of triangles, possibly with holes."""

    _keeps_holes: ClassVar[bool] = False

    def _flatten(self, surface: Manifold | CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Cut the surface open and flatten it."""
        if isinstance(surface, CutManifold):
            if settings.defines_cuts:
                raise InputError("the surface is already cut. Omit cuts, sphere, relax and adapt")
            return self._map(surface if self._keeps_holes else without_holes(surface, settings), settings)
        return self._map(self._cut(surface, settings), settings)

    def _cut(self, surface: Manifold, settings: FlattenSettings) -> CutManifold[Manifold]:
        """Cut a surface open to a disk."""
        return opened_along(surface, settings, holes=self._keeps_holes)

    def _map(self, cut: CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Flatten a disk."""
        raise NotImplementedError


def checked_count(value: object, name: str, remedy: str) -> int:
    """Return a positive whole number."""
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and 1 <= value < 2**31:
        return int(value)
    raise InputError(f"{name} is {shown(value)}. Pass {remedy}")
