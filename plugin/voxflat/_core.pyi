"""The compiled core: arguments are checked by `voxflat.api`, which is what to call."""

from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = ["VoxelSurface", "__version__", "chain_weights", "draw"]

__version__: str

_Progress = Callable[[str, int, int], bool | None]

def chain_weights(spacing: list[float], link_lengths: str) -> list[float]: ...
def draw(
    uv: NDArray[np.float64],
    faces: NDArray[np.uint32],
    torn: NDArray[np.bool_],
    pixel_size: float,
    progress: _Progress | None = None,
) -> tuple[NDArray[np.uint32], NDArray[np.float32], list[float]]: ...

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
    def path(self, source: int, target: int) -> tuple[NDArray[np.uint32], float]: ...
    def memory_need(self, sources: int, threads: int) -> int: ...
    def grossmann2002(
        self,
        sources: NDArray[np.uint32],
        seed: int,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> dict[str, Any]: ...
    def map_faces(
        self, uv: NDArray[np.float64], progress: _Progress | None = None
    ) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]: ...
