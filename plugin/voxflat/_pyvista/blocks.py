"""``blocks.voxflat``: a MultiBlock, block by block."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyvista as pv

from voxflat._pyvista.accessor import VoxflatAccessor
from voxflat.errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat._pyvista.options import FlattenOptions


class BlocksAccessor:
    """Flatten each block: ``blocks.voxflat(...)``.

    Parameters
    ----------
    blocks : pyvista.MultiBlock
        Datasets, or blocks of them.
    """

    def __init__(self, blocks: pv.MultiBlock) -> None:
        self._blocks = blocks

    def __call__(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> pv.MultiBlock:
        """Flatten each block into the plane z = 0.

        Parameters
        ----------
        scalars, progress_bar, **options
            As of `VoxflatAccessor`.

        Returns
        -------
        pyvista.MultiBlock
            A map for each block, by its name; blocks that are empty stay so.

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor`; the message names the block.
        """
        flat = pv.MultiBlock()
        for name, block in zip(self._blocks.keys(), self._blocks, strict=True):
            if block is None:
                flat.append(None, name)
                continue
            accessor = BlocksAccessor if isinstance(block, pv.MultiBlock) else VoxflatAccessor
            try:
                flat.append(accessor(block)(scalars, progress_bar=progress_bar, **options), name)
            except InputError as error:
                raise InputError(f"block {name!r}: {error}") from None
        return flat
