"""The drawn cuts, with undo and redo."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count, pairwise
from typing import Any, ClassVar, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from voxflat._napari.history import History
from voxflat.pipeline.cut_surface import whereabouts
from voxflat.pipeline.surface import Surface
from voxflat.surfaces.standard.sphere import sphere_beside

Stops: TypeAlias = tuple[int, ...]  # the clicked vertices of a cut, which shortest paths along edges connect


@dataclass(frozen=True)
class Drawn:
    stops: Stops
    name: str

    @property
    def is_complete(self) -> bool:
        """Whether the cut has at least two points."""
        return len(self.stops) > 1


@dataclass(frozen=True)
class _State:
    cuts: tuple[Drawn, ...] = ()
    is_open: bool = False  # whether the next point continues the last cut
    left_out: Stops = ()
    sphere: str | None = None  # the registered sphere on which standard cuts were found, if known


class Drawing(History[_State]):
    """Cuts on a complete surface, with a history of their states."""

    _of: ClassVar["WeakKeyDictionary[Layer, list[Drawing]]"] = WeakKeyDictionary()

    def __init__(self, surface: Surface) -> None:
        super().__init__(_State())
        self.surface = surface
        self._ways: dict[tuple[int, int], NDArray[np.uint32]] = {}
        self._titles: dict[Drawn, str] = {}  # cached, because a title needs all points

    @classmethod
    def on(cls, layer: Layer, surface: Surface) -> "Drawing":
        """Return the drawing on this surface of a layer, which exists as long as the layer does."""
        drawings = cls._of.setdefault(layer, [])
        drawings[:] = [entry for entry in drawings if entry.can_undo or entry.can_redo]
        for drawing in drawings:
            if all(
                np.array_equal(getattr(drawing.surface, k), getattr(surface, k)) for k in ("points", "faces", "ids")
            ):
                return drawing
        drawings.append(cls(surface))
        return drawings[-1]

    @property
    def cuts(self) -> tuple[Drawn, ...]:
        return self.now.cuts

    @property
    def is_open(self) -> bool:
        """Whether the next point continues the last cut."""
        return self.now.is_open

    @property
    def left_out(self) -> NDArray[np.int64]:
        """The excluded vertices, such as the medial wall, as vertex ids of the input."""
        return np.asarray(self.surface.ids[np.array(self.now.left_out, dtype=np.int64)])

    def add_stop(self, vertex: int) -> None:
        """Continue the current cut, or begin a new one; raises InputError if no path leads to the vertex."""
        now = self.now
        if not now.is_open:
            names = (f"drawn {number}" for number in count(1))
            cut = Drawn((vertex,), next(name for name in names if name not in {cut.name for cut in now.cuts}))
            self.do(replace(now, cuts=(*now.cuts, cut), is_open=True))
            return
        last = now.cuts[-1]
        if vertex != last.stops[-1]:
            self._way(last.stops[-1], vertex)  # raises InputError if the vertices are in different components
            self.do(replace(now, cuts=(*now.cuts[:-1], replace(last, stops=(*last.stops, vertex)))))

    def end_cut(self) -> None:
        """End the current cut, so that the next point begins a new one."""
        if self.is_open:
            self.do(replace(self.now, is_open=False))

    def remove(self, number: int) -> None:
        """Remove the cut with this index in `cuts`."""
        now = self.now
        is_last = number == len(now.cuts) - 1
        cuts = (*now.cuts[:number], *now.cuts[number + 1 :])
        self.do(replace(now, cuts=cuts, is_open=now.is_open and not is_last))

    def set_cuts(
        self,
        paths: Sequence[NDArray[Any]],
        names: Sequence[str | None],
        left_out: NDArray[np.int64],
        sphere: str | None = None,
    ) -> None:
        """Replace all cuts, and number those without a name; raises InputError if a vertex id is not on the surface."""
        named = zip(paths, _distinct(names), strict=True)
        cuts = tuple(Drawn(tuple(self.surface.find(path, name).tolist()), name) for path, name in named)
        left = tuple(self.surface.find(left_out, "the excluded part").tolist())
        self.do(_State(cuts, left_out=left, sphere=sphere))

    def record(self) -> dict[str, Any]:
        """Return the cuts for the description of a saved map."""
        now = self.now
        cuts = [[cut.name, list(cut.stops)] for cut in now.cuts]
        return {"cuts": cuts, "left_out": list(now.left_out), "sphere": now.sphere}

    def restore(self, record: Mapping[str, Any]) -> None:
        """Bring the cuts of a record back, unless cuts were drawn or the record is that of another surface."""
        cuts = tuple(Drawn(tuple(stops), name) for name, stops in record.get("cuts", ()))
        left_out = tuple(record.get("left_out", ()))
        vertices = [*left_out, *(stop for cut in cuts for stop in cut.stops)]
        if cuts and not (self.can_undo or self.can_redo) and max(vertices) < len(self.surface.points):
            self.do(_State(cuts, left_out=left_out, sphere=record.get("sphere")))

    def vertices(self, cut: Drawn) -> NDArray[np.uint32]:
        """Return the vertices along a cut; each vertex is a neighbour of the next one."""
        first = np.array(cut.stops[:1], dtype=np.uint32)
        return np.concatenate([first, *(self._way(a, b)[1:] for a, b in pairwise(cut.stops))])

    def length(self, cut: Drawn) -> float:
        places = self.surface.points[self.vertices(cut)]
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())  # mm

    def title(self, cut: Drawn) -> str:
        """Return the name of a cut and its location, as `voxflat cut` prints them."""
        if cut not in self._titles:
            structure = self.surface.origin.structure
            place = whereabouts(self.points[self.vertices(cut)], self.points, structure)
            self._titles[cut] = f"{cut.name}, {place}"
        return self._titles[cut]

    def paths(self) -> dict[str, NDArray[np.int64]]:
        """Return the complete cuts by name, in the form of the parameter `cuts` of `voxflat.flatten`."""
        return {cut.name: self.surface.ids[self.vertices(cut)] for cut in self.cuts if cut.is_complete}

    @property
    def sphere(self) -> str | None:
        """The registered sphere of the surface, if known: a file, or `OWN_REGISTRATION`."""
        beside = sphere_beside(self.surface)
        sphere = self.now.sphere
        return sphere if sphere is not None or beside is None else str(beside)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        return self.surface.space.to_scanner(self.surface.points)  # RAS+ mm

    def _way(self, a: int, b: int) -> NDArray[np.uint32]:
        if (a, b) not in self._ways:
            self._ways[a, b] = self.surface.core.edge_path(a, b)[0]
        return self._ways[a, b]


def _distinct(names: Sequence[str | None]) -> list[str]:
    """Return names of cuts, with numbers for cuts that have no name, or the name of an earlier cut."""
    distinct: list[str] = []
    for number, name in enumerate(names, 1):
        titles = chain([name] if name else [], (f"{name or 'cut'} {n}" for n in count(2 if name else number)))
        distinct.append(next(t for t in titles if t not in distinct and (t == name or t not in names)))
    return distinct
