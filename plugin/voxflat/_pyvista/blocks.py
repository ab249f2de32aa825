"""``blocks.voxflat``: a MultiBlock, block by block."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import pyvista as pv

from voxflat._pyvista.accessor import VoxflatAccessor
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.surfaces.findings import Check

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat._pyvista.options import CutOptions, FlattenOptions, PlaceOptions

_Found = TypeVar("_Found")

_OF_ONE = {
    "geodesic": "a source is a point of one block, and no way leads to another",
    "path": "its ends are points of one block",
    "texture": "a picture lies on one map",
    "plot": "it shows one surface beside its map",
    "morph": "it unfolds one surface",
    "show": "a page has one surface and its map",
    "export_html": "a page has one surface and its map",
    "volume": "a volume is an array of one image",
    "voxel_at": "a voxel is of one image",
}


class BlocksAccessor:
    """Flatten each block: ``blocks.voxflat(...)``.

    What has one surface or one point in sight, such as ``plot`` and ``geodesic``, is a verb of a block:
    ``blocks["left"].voxflat.plot()``.

    Parameters
    ----------
    blocks : pyvista.MultiBlock
        Datasets, or blocks of them.

    Examples
    --------
    >>> import pyvista as pv
    >>> blocks = pv.MultiBlock({"ball": pv.Icosphere(nsub=1), "hills": pv.ParametricEnneper(u_res=9, v_res=9)})
    >>> flat = blocks.voxflat()
    >>> flat.keys()
    ['ball', 'hills']
    >>> worst = flat["ball"]["distance_error"].max()
    """

    def __init__(self, blocks: pv.MultiBlock) -> None:
        self._blocks = blocks

    def __call__(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> pv.MultiBlock:
        """Flatten each block into the plane z = 0.

        `scalars`, `progress_bar`, `**options`: as of `VoxflatAccessor`. Returns: a map for each block, by its name;
        blocks that are empty stay so. Raises InputError, Cancelled: as in `VoxflatAccessor`; the message names the
        block.
        """
        return self._made(lambda of, _: of(scalars, progress_bar=progress_bar, **options))

    def flatten(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> dict[str, FlatMap]:
        """Flatten each block.

        Parameters
        ----------
        scalars, progress_bar, **options
            As of `VoxflatAccessor.flatten`.

        Returns
        -------
        dict of str to FlatMap
            By the names of the blocks, ``"brain/left"`` within others; empty ones are left out.

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor.flatten`; the message names the block. Or if two have one name.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.flatten()["left"]
        <FlatMap: 121 points, 1 x 1, relative error 0.0 %>
        """
        return self._named(lambda of: of.flatten(scalars, progress_bar=progress_bar, **options))

    def surface(self, scalars: str | None = None, **options: Unpack[PlaceOptions]) -> pv.MultiBlock:
        """Return the surface of each block.

        Parameters
        ----------
        scalars, **options
            As of `VoxflatAccessor.surface`.

        Returns
        -------
        pyvista.MultiBlock

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor.surface`; the message names the block.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.surface().n_blocks
        2
        """
        return self._made(lambda of, _: of.surface(scalars, **options))

    def check(self, scalars: str | None = None, **options: Unpack[PlaceOptions]) -> dict[str, Check]:
        """Say of each block whether it can be flattened, and what to do.

        Parameters
        ----------
        scalars, **options
            As of `VoxflatAccessor.check`.

        Returns
        -------
        dict of str to Check
            As of `flatten`.

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor.check`; the message names the block. Or if two have one name.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.check()["right"].can_flatten
        True
        """
        return self._named(lambda of: of.check(scalars, **options))

    def patches(self, max_angle: float | None = None, **options: Any) -> pv.MultiBlock:
        """Flatten each block in patches with a certificate.

        Parameters
        ----------
        max_angle, **options
            As of `VoxflatAccessor.patches`.

        Returns
        -------
        pyvista.MultiBlock
            A page for each block.

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor.patches`; the message names the block.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.patches(max_angle=20).n_blocks
        2
        """
        return self._made(lambda of, _: of.patches(max_angle, **options))

    def cut(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[CutOptions]
    ) -> pv.MultiBlock:
        """Cut the surface of each block open.

        Parameters
        ----------
        scalars, progress_bar, **options
            As of `VoxflatAccessor.cut`.

        Returns
        -------
        pyvista.MultiBlock

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor.cut`; the message names the block.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.cut().n_blocks
        2
        """
        return self._made(lambda of, _: of.cut(scalars, progress_bar=progress_bar, **options))

    def measure(self, flat: pv.MultiBlock, scalars: str | None = None, **options: Any) -> pv.MultiBlock:
        """Measure a map of each block.

        Parameters
        ----------
        flat : pyvista.MultiBlock
            Maps, in the order of the blocks.
        scalars, **options
            As of `VoxflatAccessor.measure`.

        Returns
        -------
        pyvista.MultiBlock
            A map with its measures for each block.

        Raises
        ------
        InputError, Cancelled
            As in `VoxflatAccessor.measure`; the message names the block. Or if there are more or fewer maps.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.measure(both.voxflat()).keys()
        ['left', 'right']
        """
        return self._made(lambda of, one: of.measure(one, scalars, **options), flat)

    if not TYPE_CHECKING:  # a type checker is to find that they are not there

        def __getattr__(self, name: str) -> object:
            """Say why a verb is not one of several blocks."""
            if name not in _OF_ONE:
                raise AttributeError(f"'{type(self).__name__}' object has no attribute {name!r}")
            first = next(iter(self._blocks.keys()), "name")
            raise AttributeError(f"{_OF_ONE[name]}: take a block, blocks[{first!r}].voxflat.{name}(...)")

    def _made(
        self, verb: Callable[[Any, Any], pv.DataSet | pv.MultiBlock], beside: pv.MultiBlock | None = None
    ) -> pv.MultiBlock:
        """Return what a verb makes of each block, and of what stands beside it in other blocks."""
        if beside is not None and not (isinstance(beside, pv.MultiBlock) and len(beside) == len(self._blocks)):
            told = f"{len(beside)} blocks" if isinstance(beside, pv.MultiBlock) else type(beside).__name__
            raise InputError(f"the maps are {told}; give a MultiBlock with one for each of {len(self._blocks)} blocks")
        made = pv.MultiBlock()
        for number, (name, block) in enumerate(zip(self._blocks.keys(), self._blocks, strict=True)):
            one = None if beside is None else beside[number]
            if block is None:
                made.append(None, name)
                continue
            made.append(_told(name, block, verb, one), name)
        return made

    def _named(self, verb: Callable[[Any], Any]) -> dict[str, Any]:
        """Return what a verb makes of each block, by the blocks' names."""
        found: dict[str, Any] = {}
        for name, block in zip(self._blocks.keys(), self._blocks, strict=True):
            if block is None:
                continue
            result = _told(name, block, verb)
            inner = {f"{name}/{key}": value for key, value in result.items()} if isinstance(result, dict) else None
            for key, value in (inner or {name: result}).items():
                if key in found:
                    raise InputError(f"two blocks are called {key!r}: give them names, blocks.set_block_name(1, ...)")
                found[key] = value
        return found


def _told(name: str, block: object, verb: Callable[..., _Found], *beside: object) -> _Found:
    """Return what a verb makes of a block; errors name it."""
    if not isinstance(block, pv.DataSet | pv.MultiBlock):
        raise InputError(f"block {name!r} is a {type(block).__name__}, which has no surface; take it out")
    try:
        return verb(BlocksAccessor(block) if isinstance(block, pv.MultiBlock) else VoxflatAccessor(block), *beside)
    except InputError as error:
        raise InputError(f"block {name!r}: {error}") from None
