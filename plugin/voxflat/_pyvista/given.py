"""What the verbs of ``mesh.voxflat`` take: a dataset, arrays of it, places on it."""

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from voxflat._pyvista.images import volume_of
from voxflat._pyvista.skins import Skin
from voxflat.arguments import Progress, is_number
from voxflat.errors import InputError
from voxflat.io.volumes import Volume
from voxflat.methods import Method, method_of
from voxflat.pipeline.surface import Surface, surface


class Given:
    """A dataset of PyVista, and what it says of places and regions.

    It is an ``ImageData``, or anything that has a surface.
    """

    def __init__(self, mesh: pv.DataSet) -> None:
        self._mesh = mesh

    def volume(self, scalars: str | None = None) -> Volume:
        """Return an array of the image as a volume with its affine, without a copy.

        Parameters
        ----------
        scalars : str, optional
            Name of the array; by default the active one, or the only one.

        Returns
        -------
        Volume
            For the functions of voxflat: ``voxflat.check(image.voxflat.volume())``,
            ``flat_map.image(image.voxflat.volume("T1"))``. Colours, uint8 with 3 or 4 components, are a volume, too.

        Raises
        ------
        InputError
            If the dataset is no ``ImageData``, or the array is missing or has several components.

        Examples
        --------
        >>> image = pv.ImageData(dimensions=(8, 8, 8))
        >>> image["labels"] = np.ones(512, np.uint8)
        >>> image.voxflat.volume()
        <Volume: 8 x 8 x 8 of uint8, voxels of 1 x 1 x 1 mm, RAS>
        """
        return volume_of(self._mesh, scalars)

    def voxel_at(self, point: ArrayLike, scalars: str | None = None) -> tuple[int, int, int]:
        """Find the voxel at a point, for use as a seed point.

        Parameters
        ----------
        point : array_like, shape (3,)
            RAS+ mm, as ``image.points`` are.
        scalars : str, optional
            Name of the array, which may be of points or of cells; by default the active one, or the only one.

        Returns
        -------
        tuple of 3 ints
            Indices of the voxel with the nearest centre.

        Raises
        ------
        InputError
            If the point lies outside the image.

        Examples
        --------
        >>> image = pv.ImageData(dimensions=(8, 8, 8), spacing=(0.5, 0.5, 0.5))
        >>> image["labels"] = np.ones(512, np.uint8)
        >>> image.voxflat.voxel_at((1.0, 1.0, 2.1))
        (2, 2, 4)
        """
        volume = self.volume(scalars)
        place = np.linalg.solve(volume.affine, [*np.asarray(point, dtype=np.float64), 1.0])[:3]
        i, j, k = np.rint(place).astype(int).tolist()
        if not all(0 <= index < size for index, size in zip((i, j, k), volume.data.shape, strict=False)):
            raise InputError(
                f"the point {np.asarray(point).tolist()} mm lies outside the image, {tuple(self._mesh.bounds)}"
            )
        return i, j, k

    @property
    def _is_image(self) -> bool:
        return isinstance(self._mesh, pv.ImageData)

    def _skin(self, scalars: str | None) -> Skin:
        if self._is_image:
            raise InputError("ImageData: make a surface of it first, image.voxflat.surface()")
        if scalars is not None:
            raise InputError(f"scalars is {scalars!r}, but a mesh is flattened as it is; leave it out")
        return Skin.of(self._mesh)

    def _part(self, scalars: str | None, given: dict[str, Any], progress: Progress | None) -> Surface:
        """Return the part of the surface that is chosen; the options that say which are taken out of what is given."""
        skin = None if self._is_image else self._skin(scalars)
        making: dict[str, Any] = {name: given.pop(name) for name in ("label", "threshold", "unit") if name in given}
        making |= {name: given[name] for name in ("threads", "memory_limit") if name in given}
        part = surface(self.volume(scalars) if skin is None else skin.mesh, progress=progress, **making)
        for name in ("keep", "drop"):
            region = self._region(given.pop(name, None))
            if region is not None:
                region = region if skin is None else self._mask_of(skin, region, name)
                part = part.keep(region) if name == "keep" else part.drop(region)
        seed_point, radius = given.pop("seed_point", None), given.pop("radius", None)
        if (seed_point is None) != (radius is None):
            named, missing = ("seed_point", "radius") if radius is None else ("radius", "seed_point")
            raise InputError(f"{named} is given without {missing}; give both or neither")
        if seed_point is not None:
            seed = self._voxels(scalars, seed_point) if skin is None else skin.point(seed_point, "seed_point")
            part = part.disk(seed, radius, threads=given.get("threads"), progress=progress)
        if (corners := given.pop("polygon", None)) is not None:
            part = part.polygon(self._places(scalars, corners, "polygon"), progress=progress)
        if skin is not None and isinstance(given.get("cuts"), Sequence) and not isinstance(given["cuts"], str):
            given["cuts"] = [np.atleast_1d(skin.points(one, "cuts")) for one in given["cuts"]]
        return part

    def _method(self, scalars: str | None, method: str | Method) -> Method:
        """Return a method with its sources as the surface has them; a number says how many."""
        chosen = method_of(method)
        sources = getattr(chosen, "sources", 0)
        if is_number(sources):
            return chosen
        own: dict[str, Any] = {"sources": self._places(scalars, sources, "sources")}
        return replace(chosen, **own)

    def _places(self, scalars: str | None, places: Any, name: str) -> Any:
        """Return places on the dataset as the surface has them."""
        if self._is_image:
            return self._voxels(scalars, places)
        return np.atleast_1d(self._skin(scalars).points(places, name))

    def _voxels(self, scalars: str | None, places: Any) -> Any:
        """Return positions in an image as voxels; voxels stay what they are."""
        positions = np.asarray(places)
        if positions.dtype.kind != "f" or positions.shape[-1:] != (3,):
            return places
        voxels = [self.voxel_at(position, scalars) for position in positions.reshape(-1, 3)]
        return voxels[0] if positions.ndim == 1 else np.array(voxels)

    def _mask_of(self, skin: Skin, region: object, name: str) -> object:
        """Return a region of a dataset's points as one of its surface's."""
        if skin.is_dataset or not isinstance(region, np.ndarray):
            return region
        is_mask = region.dtype == bool and region.shape == (self._mesh.n_points,)
        return region[skin.point_ids] if is_mask else skin.points(region, name)

    def _region(self, region: object) -> object:
        """Return a region as `voxflat.flatten` takes it."""
        if isinstance(region, pv.DataSet):
            return volume_of(region)
        if not isinstance(region, str):
            return region
        names = self._mesh.array_names if self._is_image else self._mesh.point_data.keys()
        if region in names:
            if self._is_image:
                return self.volume(region)
            mask: NDArray[np.bool_] = np.asarray(self._mesh.point_data[region]) != 0
            return mask
        if not os.path.exists(region):
            there = ", ".join(names) or "none"
            raise InputError(f"{region!r} is neither an array of the points (there are: {there}) nor a file")
        return region
