"""The compiled core. Call the functions of `voxflat` instead: they check the arguments."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "FARTHEST",
    "KEPT_BYTES",
    "REFERENCE_SOURCES",
    "SMALLEST",
    "Group",
    "NearestFinder",
    "Surface",
    "TriangleFinder",
    "VoxelSurface",
    "__version__",
    "chain_weights",
    "component_sizes",
    "connect_columns",
    "damaged_rows",
    "defects",
    "draw",
    "is_sheet",
    "locate_on_sphere",
    "reference_sources",
    "repair",
    "ribbon_voxels",
    "solve",
    "store_memory_need",
    "turn_onto",
    "vertex_normals",
    "ways_pass",
]

__version__: str
FARTHEST: float
KEPT_BYTES: int
REFERENCE_SOURCES: int
SMALLEST: float

_Progress = Callable[[str, int, int], bool | None] | None
_Bands = tuple[float, float, float, float]
_Threads = int | None
_Folder = str | PathLike[str]
_Facts = dict[str, Any]
_Floats = NDArray[np.float64]
_Singles = NDArray[np.float32]
_Ints = NDArray[np.int64]
_Uints = NDArray[np.uint32]
_Mask = NDArray[np.bool_]

def chain_weights(spacing: list[float], link_lengths: str) -> list[float]: ...
def draw(
    uv: _Floats, faces: _Uints, torn: _Mask, pixel_size: float, progress: _Progress = None
) -> tuple[_Uints, _Singles, list[float]]: ...
def component_sizes(mask: _Mask, progress: _Progress = None) -> NDArray[np.uintp]: ...
def defects(points: _Floats, faces: _Ints) -> dict[str, list[Any]]: ...
def is_sheet(mask: _Mask, progress: _Progress = None) -> bool: ...
def locate_on_sphere(points: _Floats, faces: _Ints, places: _Floats) -> tuple[_Uints, _Floats]: ...
def repair(
    mask: _Mask, spacing: list[float], probability: _Singles | None = None, progress: _Progress = None
) -> tuple[_Mask, _Facts]: ...
def reference_sources(points: int, count: int, seed: int) -> _Uints: ...
def damaged_rows(
    directory: _Folder, columns: int, checksums: Sequence[int | None], progress: _Progress = None
) -> list[int]: ...
def solve(matrix: _Floats, right: _Floats) -> _Floats: ...
def store_memory_need(columns: int, rows: int, threads: int) -> int: ...
def turn_onto(uv: _Floats, places: _Floats, onto: _Floats) -> tuple[_Floats, float]: ...
def vertex_normals(points: _Floats, faces: _Uints) -> _Floats: ...
def ribbon_voxels(
    inner: _Floats,
    outer: _Floats,
    faces: _Uints,
    numbers: _Ints,
    shape: list[int],
    middle: float,
    progress: _Progress = None,
) -> tuple[NDArray[np.uint64], _Uints, _Floats, _Floats]: ...
def connect_columns(voxels: _Uints, columns: _Uints, halfway: _Floats, progress: _Progress = None) -> _Uints: ...

@final
class NearestFinder:
    def __new__(cls, points: _Floats, faces: _Uints) -> NearestFinder: ...
    def find(self, points: _Floats, limit: float) -> tuple[_Ints, _Floats, _Floats]: ...
    def sides(
        self,
        points: _Floats,
        normals: _Floats,
        faces: _Uints,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> tuple[_Floats, _Floats]: ...

@final
class TriangleFinder:
    def __new__(cls, corners: _Floats) -> TriangleFinder: ...
    def find(self, places: _Floats) -> tuple[_Ints, _Floats]: ...

@final
class Surface:
    def __new__(cls, points: _Floats, faces: _Uints, twins: _Uints, ids: _Uints) -> Surface: ...
    def __getnewargs__(self) -> tuple[_Floats, _Uints, _Uints, _Uints]: ...
    @staticmethod
    def from_triangles(points: _Floats, faces: _Ints, mend: bool = False) -> tuple[Surface, _Facts]: ...
    @staticmethod
    def from_mask(
        mask: _Mask,
        affine: list[list[float]],
        level: tuple[_Singles, float] | None = None,
        sheet: bool | None = None,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> tuple[Surface, _Uints, _Facts]: ...
    def pattern(self, progress: _Progress = None) -> tuple[_Floats, _Floats, _Floats]: ...
    def register(
        self,
        points: _Floats,
        faces: _Ints,
        templates: Sequence[tuple[_Floats, _Floats, _Floats]],
        named: int | None = None,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> _Facts: ...
    def __len__(self) -> int: ...
    @property
    def points(self) -> _Floats: ...
    @property
    def normals(self) -> _Floats: ...
    @property
    def faces(self) -> _Uints: ...
    @property
    def ids(self) -> _Uints: ...
    def part(self, keep: _Mask) -> Surface: ...
    def part_of_faces(self, keep: _Mask) -> Surface: ...
    def disk(
        self, seed: int, radius: float, threads: _Threads = None, progress: _Progress = None
    ) -> tuple[Surface, int]: ...
    def polygon(self, corners: _Uints, progress: _Progress = None) -> tuple[Surface, _Uints]: ...
    def largest_piece(self, progress: _Progress = None) -> Surface: ...
    def moved(self, points: _Floats) -> Surface: ...
    def with_ids(self, ids: _Uints) -> Surface: ...
    def topology(self, progress: _Progress = None) -> _Facts: ...
    def handles(self, threads: _Threads = None, progress: _Progress = None) -> list[_Facts]: ...
    def cut_handles(self, threads: _Threads = None, progress: _Progress = None) -> tuple[Surface, list[_Facts]]: ...
    def cut(self, paths: list[_Uints]) -> Surface: ...
    def cone_points(self) -> list[int]: ...
    def open_to_disk(
        self, points: list[int], threads: _Threads = None, progress: _Progress = None
    ) -> tuple[Surface, list[_Facts]]: ...
    def relax(
        self,
        length: float | None = None,
        least_relief: float = 0.0,
        bearable: float = 0.0,
        within: float | None = None,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> tuple[Surface, list[_Facts], list[float]]: ...
    def fill_holes(self, longest: float, progress: _Progress = None) -> tuple[Surface, int, int]: ...
    def thin_places(
        self, thickness: float, threads: _Threads = None, progress: _Progress = None
    ) -> tuple[int, tuple[int, float] | None]: ...
    def mean_curvature(self, smoothing: float, threads: _Threads = None, progress: _Progress = None) -> _Floats: ...
    def smooth_values(
        self, values: _Floats, deviation: float, threads: _Threads = None, progress: _Progress = None
    ) -> _Floats: ...
    def sulcal_depth(self, flow: float, threads: _Threads = None, progress: _Progress = None) -> _Floats: ...
    @property
    def area(self) -> float: ...
    def measure(self, uv: _Floats, progress: _Progress = None) -> _Facts: ...
    def judge(
        self,
        maps: list[_Floats],
        sources: _Uints,
        geodesic: str,
        kept: int,
        seed: int,
        bands: _Bands,
        threads: _Threads = None,
        progress: _Progress = None,
        period: float | None = None,
    ) -> list[_Facts]: ...
    def lower_bound_memory_need(self, threads: int) -> int: ...
    def lower_bound(self, geodesic: str, seed: int, threads: _Threads = None, progress: _Progress = None) -> float: ...
    def patches(
        self, limit: str, value: float, seeds: str, seed: int, threads: _Threads = None, progress: _Progress = None
    ) -> _Facts: ...
    def glue(
        self, labels: _Uints, flat: _Floats, bound: float, threads: _Threads = None, progress: _Progress = None
    ) -> _Facts: ...
    def zigelman2002(
        self,
        count: int,
        seed: int,
        bands: _Bands,
        vertices: _Uints | None = None,
        grid: tuple[_Uints, list[float]] | None = None,
        wave: str = "circle",
        keep_rows: bool = False,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> _Facts: ...
    def zigelman2002_memory_need(self, sources: int, threads: int) -> int: ...
    def saucan2006(
        self, bound: float, seed: int, bands: _Bands, threads: _Threads = None, progress: _Progress = None
    ) -> _Facts: ...
    def saucan2006_memory_need(self, threads: int) -> int: ...
    def schwartz1989(
        self,
        rings: int | None,
        sources: _Uints,
        starts: int,
        seed: int,
        bands: _Bands,
        keep_rows: bool = False,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> _Facts: ...
    def schwartz1989_rings(self, progress: _Progress = None) -> int: ...
    def schwartz1989_memory_need(
        self, rings: int | None, sources: int, threads: int, progress: _Progress = None
    ) -> int: ...
    def memory_need(self, sources: int, threads: int, rows: str = "dropped") -> int: ...
    def choose_sources(self, sampling: str, count: int, seed: int, progress: _Progress = None) -> _Uints: ...
    def cells(self, points: _Uints, count: int, seed: int, progress: _Progress = None) -> tuple[_Uints, _Uints]: ...
    def distances_between(
        self,
        members: _Uints,
        sizes: _Uints,
        linkage: str,
        geodesic: str = "graph",
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> _Floats: ...
    def rows(
        self, sources: _Uints, geodesic: str = "graph", threads: _Threads = None, progress: _Progress = None
    ) -> _Singles: ...
    def fingerprint(self, geodesic: str, progress: _Progress = None) -> int: ...
    def store_rows(
        self,
        directory: _Folder,
        identity: str,
        sources: _Uints,
        geodesic: str = "graph",
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> tuple[int, int]: ...
    def lay_out_store(
        self, directory: _Folder, identity: str, rows: int, progress: _Progress = None
    ) -> tuple[int, int]: ...
    def store_part(
        self,
        directory: _Folder,
        part: _Folder,
        identity: str,
        sources: _Uints,
        rows: _Uints,
        geodesic: str = "graph",
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> None: ...
    def error_of_distances(
        self, seed: int, geodesic: str = "graph", threads: _Threads = None, progress: _Progress = None
    ) -> float: ...
    def path(self, source: int, target: int) -> tuple[_Uints, float]: ...
    def exact_path(self, source: int, target: int) -> tuple[_Floats, _Ints, float]: ...
    def marching_path(self, source: int, target: int) -> tuple[_Floats, _Ints, float]: ...
    def edge_path(self, source: int, target: int) -> tuple[_Uints, float]: ...
    def edge_path_to_any(
        self, source: int, to: _Mask, may_pass: _Mask, factors: _Floats, progress: _Progress = None
    ) -> _Uints: ...
    def voxflat(
        self,
        sources: _Uints,
        seed: int,
        bands: _Bands,
        geodesic: str = "graph",
        weighting: float = 0.5,
        scale: str = "distances",
        keep_rows: bool = False,
        threads: _Threads = None,
        progress: _Progress = None,
        store: tuple[_Folder, str] | None = None,
        start: _Floats | None = None,
        patience: int = 1,
        max_area: float | None = None,
        group: Group | None = None,
    ) -> _Facts: ...
    def periodic(
        self,
        opened: Surface,
        seam: _Uints,
        sources: _Uints,
        seed: int,
        bands: _Bands,
        geodesic: str = "graph",
        weighting: float = 0.5,
        scale: str = "distances",
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> _Facts: ...

@final
class Group:
    def __new__(cls, surface: Surface, sources: _Uints, progress: _Progress = None) -> Group: ...
    @staticmethod
    def memory_need(points: int, sources: int) -> int: ...
    def add(
        self,
        surface: Surface,
        weight: float,
        geodesic: str = "graph",
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> None: ...

@final
class VoxelSurface:
    @staticmethod
    def from_mask(
        mask: _Mask, affine: list[list[float]], link_lengths: str, progress: _Progress = None
    ) -> VoxelSurface: ...
    def cut_out(
        self,
        keep: _Mask | None = None,
        seed_point: list[int] | None = None,
        radius: float | None = None,
        progress: _Progress = None,
    ) -> VoxelSurface: ...
    def __len__(self) -> int: ...
    @property
    def voxels(self) -> _Uints: ...
    @property
    def points(self) -> _Floats: ...
    @property
    def csr(self) -> tuple[_Uints, _Uints, _Singles]: ...
    def component_sizes(self) -> list[int]: ...
    def topology(self, progress: _Progress = None) -> _Facts: ...
    def check_flattenable(self, progress: _Progress = None) -> None: ...
    def find(self, voxels: _Ints) -> _Uints: ...
    def nearest(self, voxel: list[int]) -> tuple[int, float]: ...
    def choose_sources(self, sampling: str, count: int, seed: int, progress: _Progress = None) -> _Uints: ...
    def rows(self, sources: _Uints, threads: _Threads = None, progress: _Progress = None) -> _Singles: ...
    def fingerprint(self, progress: _Progress = None) -> int: ...
    def store_rows(
        self, directory: _Folder, identity: str, sources: _Uints, threads: _Threads = None, progress: _Progress = None
    ) -> tuple[int, int]: ...
    def path(self, source: int, target: int) -> tuple[_Uints, float]: ...
    def memory_need(self, sources: int, threads: int) -> int: ...
    def grossmann2002(
        self,
        sources: _Uints,
        seed: int,
        bands: _Bands,
        keep_rows: bool = False,
        threads: _Threads = None,
        progress: _Progress = None,
    ) -> _Facts: ...
    def map_faces(self, uv: _Floats, progress: _Progress = None) -> tuple[_Uints, _Mask]: ...

def ways_pass(
    mask: _Mask,
    to_voxels: list[list[float]],
    starts: _Floats,
    ends: _Floats,
    clear: _Floats,
    step: float,
    threads: _Threads = None,
) -> _Mask: ...
