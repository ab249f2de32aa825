"""The compiled core: arguments are checked by the functions of `voxflat`, which are what to call."""

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
    "NearestFinder",
    "Surface",
    "TriangleFinder",
    "VoxelSurface",
    "__version__",
    "chain_weights",
    "damaged_rows",
    "defects",
    "draw",
    "is_sheet",
    "locate_on_sphere",
    "reference_sources",
    "repair",
    "ribbon_voxels",
    "store_memory_need",
    "turn_onto",
    "vertex_normals",
]

__version__: str
FARTHEST: float
KEPT_BYTES: int
REFERENCE_SOURCES: int
SMALLEST: float

_Progress = Callable[[str, int, int], bool | None]

def chain_weights(spacing: list[float], link_lengths: str) -> list[float]: ...
def draw(
    uv: NDArray[np.float64],
    faces: NDArray[np.uint32],
    torn: NDArray[np.bool_],
    pixel_size: float,
    progress: _Progress | None = None,
) -> tuple[NDArray[np.uint32], NDArray[np.float32], list[float]]: ...
def defects(points: NDArray[np.float64], faces: NDArray[np.int64]) -> dict[str, list[Any]]: ...
def is_sheet(mask: NDArray[np.bool_]) -> bool: ...
def locate_on_sphere(
    points: NDArray[np.float64], faces: NDArray[np.int64], places: NDArray[np.float64]
) -> tuple[NDArray[np.uint32], NDArray[np.float64]]: ...
def repair(
    mask: NDArray[np.bool_],
    spacing: list[float],
    probability: NDArray[np.float32] | None = None,
    progress: _Progress | None = None,
) -> tuple[NDArray[np.bool_], dict[str, Any]]: ...
def reference_sources(points: int, count: int, seed: int) -> NDArray[np.uint32]: ...
def damaged_rows(
    directory: str | PathLike[str],
    columns: int,
    checksums: Sequence[int | None],
    progress: Callable[[str, int, int], bool | None] | None = None,
) -> list[int]: ...
def store_memory_need(columns: int, rows: int, threads: int) -> int: ...
def turn_onto(
    uv: NDArray[np.float64], places: NDArray[np.float64], onto: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]: ...
def vertex_normals(points: NDArray[np.float64], faces: NDArray[np.uint32]) -> NDArray[np.float64]: ...
def ribbon_voxels(
    inner: NDArray[np.float64],
    outer: NDArray[np.float64],
    faces: NDArray[np.uint32],
    numbers: NDArray[np.int64],
    shape: list[int],
    middle: float,
    progress: _Progress | None = None,
) -> tuple[NDArray[np.uint64], NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64]]: ...

@final
class NearestFinder:
    def __new__(cls, points: NDArray[np.float64], faces: NDArray[np.uint32]) -> NearestFinder: ...
    def find(
        self, points: NDArray[np.float64], limit: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]: ...

@final
class TriangleFinder:
    def __new__(cls, corners: NDArray[np.float64]) -> TriangleFinder: ...
    def find(self, places: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...

@final
class Surface:
    @staticmethod
    def from_triangles(
        points: NDArray[np.float64], faces: NDArray[np.int64], mend: bool = False
    ) -> tuple[Surface, dict[str, Any]]: ...
    @staticmethod
    def from_mask(
        mask: NDArray[np.bool_],
        affine: list[list[float]],
        level: tuple[NDArray[np.float32], float] | None = None,
        sheet: bool | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> tuple[Surface, NDArray[np.uint32], dict[str, Any]]: ...
    def pattern(
        self, progress: _Progress | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
    def register(
        self,
        points: NDArray[np.float64],
        faces: NDArray[np.int64],
        templates: Sequence[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]],
        named: int | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def __len__(self) -> int: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def normals(self) -> NDArray[np.float64]: ...
    @property
    def faces(self) -> NDArray[np.uint32]: ...
    @property
    def ids(self) -> NDArray[np.uint32]: ...
    def part(self, keep: NDArray[np.bool_]) -> Surface: ...
    def part_of_faces(self, keep: NDArray[np.bool_]) -> Surface: ...
    def disk(
        self, seed: int, radius: float, threads: int | None = None, progress: _Progress | None = None
    ) -> tuple[Surface, int]: ...
    def polygon(
        self, corners: NDArray[np.uint32], progress: _Progress | None = None
    ) -> tuple[Surface, NDArray[np.uint32]]: ...
    def largest_piece(self) -> Surface: ...
    def moved(self, points: NDArray[np.float64]) -> Surface: ...
    def topology(self) -> dict[str, Any]: ...
    def handles(self, threads: int | None = None, progress: _Progress | None = None) -> list[dict[str, Any]]: ...
    def cut_handles(
        self, threads: int | None = None, progress: _Progress | None = None
    ) -> tuple[Surface, list[dict[str, Any]]]: ...
    def cut(self, paths: list[NDArray[np.uint32]]) -> Surface: ...
    def open_to_disk(
        self, threads: int | None = None, progress: _Progress | None = None
    ) -> tuple[Surface, list[dict[str, Any]]]: ...
    def relax(
        self,
        length: float | None = None,
        least_relief: float = 0.0,
        bearable: float = 0.0,
        within: float | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> tuple[Surface, list[dict[str, Any]], list[float]]: ...
    def fill_holes(self, longest: float, progress: _Progress | None = None) -> tuple[Surface, int, int]: ...
    def thin_places(
        self, thickness: float, threads: int | None = None, progress: _Progress | None = None
    ) -> tuple[int, tuple[int, float] | None]: ...
    def mean_curvature(
        self, smoothing: float, threads: int | None = None, progress: _Progress | None = None
    ) -> NDArray[np.float64]: ...
    def sulcal_depth(
        self, flow: float, threads: int | None = None, progress: _Progress | None = None
    ) -> NDArray[np.float64]: ...
    def measure(self, uv: NDArray[np.float64], progress: _Progress | None = None) -> dict[str, Any]: ...
    def judge(
        self,
        maps: list[NDArray[np.float64]],
        sources: NDArray[np.uint32],
        geodesic: str,
        kept: int,
        seed: int,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> list[dict[str, Any]]: ...
    def patches(
        self,
        limit: str,
        value: float,
        seeds: str,
        seed: int,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def glue(
        self,
        labels: NDArray[np.uint32],
        flat: NDArray[np.float64],
        bound: float,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def zigelman2002(
        self,
        count: int,
        seed: int,
        vertices: NDArray[np.uint32] | None = None,
        grid: tuple[NDArray[np.uint32], list[float]] | None = None,
        wave: str = "circle",
        keep_rows: bool = False,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def zigelman2002_memory_need(self, sources: int, threads: int) -> int: ...
    def saucan2006(
        self, bound: float, seed: int, threads: int | None = None, progress: _Progress | None = None
    ) -> dict[str, Any]: ...
    def saucan2006_memory_need(self, threads: int) -> int: ...
    def schwartz1989(
        self,
        rings: int | None,
        sources: NDArray[np.uint32],
        starts: int,
        seed: int,
        keep_rows: bool = False,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def schwartz1989_rings(self, progress: _Progress | None = None) -> int: ...
    def schwartz1989_memory_need(
        self, rings: int | None, sources: int, threads: int, progress: _Progress | None = None
    ) -> int: ...
    def memory_need(self, sources: int, threads: int, rows: str = "dropped") -> int: ...
    def links(self, progress: _Progress | None = None) -> int: ...
    def choose_sources(
        self, sampling: str, count: int, seed: int, progress: _Progress | None = None
    ) -> NDArray[np.uint32]: ...
    def rows(
        self,
        sources: NDArray[np.uint32],
        geodesic: str = "graph",
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> NDArray[np.float32]: ...
    def fingerprint(self, geodesic: str, progress: _Progress | None = None) -> int: ...
    def store_rows(
        self,
        directory: str | PathLike[str],
        identity: str,
        sources: NDArray[np.uint32],
        geodesic: str = "graph",
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> tuple[int, int]: ...
    def lay_out_store(
        self, directory: str | PathLike[str], identity: str, rows: int, progress: _Progress | None = None
    ) -> tuple[int, int]: ...
    def store_part(
        self,
        directory: str | PathLike[str],
        part: str | PathLike[str],
        identity: str,
        sources: NDArray[np.uint32],
        rows: NDArray[np.uint32],
        geodesic: str = "graph",
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> None: ...
    def error_of_distances(
        self,
        seed: int,
        geodesic: str = "graph",
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> float: ...
    def path(self, source: int, target: int) -> tuple[NDArray[np.uint32], float]: ...
    def exact_path(self, source: int, target: int) -> tuple[NDArray[np.float64], NDArray[np.int64], float]: ...
    def marching_path(self, source: int, target: int) -> tuple[NDArray[np.float64], NDArray[np.int64], float]: ...
    def edge_path(self, source: int, target: int) -> tuple[NDArray[np.uint32], float]: ...
    def edge_path_to_any(
        self,
        source: int,
        to: NDArray[np.bool_],
        may_pass: NDArray[np.bool_],
        factors: NDArray[np.float64],
        progress: _Progress | None = None,
    ) -> NDArray[np.uint32]: ...
    def voxflat(
        self,
        sources: NDArray[np.uint32],
        seed: int,
        geodesic: str = "graph",
        weighting: float = 0.5,
        scale: str = "distances",
        keep_rows: bool = False,
        threads: int | None = None,
        progress: _Progress | None = None,
        store: tuple[str | PathLike[str], str] | None = None,
        start: NDArray[np.float64] | None = None,
        patience: int = 1,
        max_area: float | None = None,
    ) -> dict[str, Any]: ...

@final
class VoxelSurface:
    @staticmethod
    def from_mask(
        mask: NDArray[np.bool_],
        affine: list[list[float]],
        link_lengths: str,
        progress: _Progress | None = None,
    ) -> VoxelSurface: ...
    def cut_out(
        self,
        keep: NDArray[np.bool_] | None = None,
        seed_point: list[int] | None = None,
        radius: float | None = None,
        progress: _Progress | None = None,
    ) -> VoxelSurface: ...
    def __len__(self) -> int: ...
    @property
    def links(self) -> int: ...
    @property
    def voxels(self) -> NDArray[np.uint32]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def csr(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32]]: ...
    def component_sizes(self) -> list[int]: ...
    def topology(self, progress: _Progress | None = None) -> dict[str, Any]: ...
    def check_flattenable(self, progress: _Progress | None = None) -> None: ...
    def find(self, voxels: NDArray[np.int64]) -> NDArray[np.uint32]: ...
    def nearest(self, voxel: list[int]) -> tuple[int, float]: ...
    def choose_sources(
        self, sampling: str, count: int, seed: int, progress: _Progress | None = None
    ) -> NDArray[np.uint32]: ...
    def rows(
        self, sources: NDArray[np.uint32], threads: int | None = None, progress: _Progress | None = None
    ) -> NDArray[np.float32]: ...
    def fingerprint(self, progress: _Progress | None = None) -> int: ...
    def store_rows(
        self,
        directory: str | PathLike[str],
        identity: str,
        sources: NDArray[np.uint32],
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> tuple[int, int]: ...
    def path(self, source: int, target: int) -> tuple[NDArray[np.uint32], float]: ...
    def memory_need(self, sources: int, threads: int) -> int: ...
    def grossmann2002(
        self,
        sources: NDArray[np.uint32],
        seed: int,
        keep_rows: bool = False,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def map_faces(
        self, uv: NDArray[np.float64], progress: _Progress | None = None
    ) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]: ...
