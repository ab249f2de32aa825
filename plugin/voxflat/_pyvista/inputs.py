"""Inputs of ``mesh.voxflat``: a dataset, its arrays, and positions on it."""

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from voxflat._pyvista.extracted_surface import ExtractedSurface
from voxflat.arguments import Progress, is_number
from voxflat.errors import InputError
from voxflat.io.grid import named_unit
from voxflat.io.objects import image_volume
from voxflat.io.volumes import Volume
from voxflat.methods import Method, method_of
from voxflat.pipeline.surface import Surface, surface


class Inputs:
    """An ``ImageData``, or any dataset that has a surface, with its arrays, positions and regions."""

    def __init__(self, mesh: pv.DataSet) -> None:
        self._mesh = mesh

    def volume(self, scalars: str | None = None, *, unit: str | None = None) -> Volume:
        """Return an array of the image as a volume with its affine.

        The values are not copied.

        Parameters
        ----------
        scalars : str, optional
            Name of the array. By default, the active array or the only array.
        unit : {"mm", "µm", "nm", "cm", "m", "inch"}, optional
            Unit of the image's spacing and origin, which VTK does not store. The default is mm.

        Returns
        -------
        Volume
            An object that voxflat functions accept, for example ``voxflat.check(image.voxflat.volume())`` or
            ``flat_map.image(image.voxflat.volume("T1"))``. The values may be colours (uint8 with 3 or 4 components).

        Raises
        ------
        InputError
            If the dataset is not an ``ImageData``, or the array is missing or has several components.

        Examples
        --------
        >>> image = pv.ImageData(dimensions=(8, 8, 8))
        >>> image["labels"] = np.ones(512, np.uint8)
        >>> image.voxflat.volume()
        <Volume: 8 x 8 x 8 of uint8, voxels of 1 x 1 x 1 mm, RAS>
        """
        volume = image_volume(self._mesh, scalars)
        return volume if unit is None else replace(volume, unit=named_unit(unit))

    def voxel_at(self, point: ArrayLike, scalars: str | None = None) -> tuple[int, int, int]:
        """Return the voxel at a position.

        The voxel can be used as a seed point.

        Parameters
        ----------
        point : array_like, shape (3,)
            The position in RAS+ mm, like ``image.points``.
        scalars : str, optional
            Name of a point or cell array. By default, the active array or the only array.

        Returns
        -------
        tuple of 3 ints
            Indices (i, j, k) of the voxel with the nearest centre.

        Raises
        ------
        InputError
            If the position lies outside the image.

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
            outside = f"outside the image, whose bounds are {tuple(self._mesh.bounds)}"
            raise InputError(f"the point {np.asarray(point).tolist()} mm is {outside}. Choose a point inside the image")
        return i, j, k

    @property
    def _is_image(self) -> bool:
        return isinstance(self._mesh, pv.ImageData)

    def _extracted(self, scalars: str | None) -> ExtractedSurface:
        if self._is_image:
            raise InputError("an ImageData is not a surface. Extract its surface first: image.voxflat.surface()")
        if scalars is not None:
            raise InputError(f"scalars is {scalars!r}, but this option applies only to images. Omit scalars")
        return ExtractedSurface.of(self._mesh)

    def _source(self, scalars: str | None, unit: str | None = None) -> tuple[ExtractedSurface | None, Any]:
        """Return the extracted surface of a mesh, and the mesh or the volume to make a `Surface` from."""
        if self._is_image:
            return None, self.volume(scalars, unit=unit)
        extracted = self._extracted(scalars)
        return extracted, extracted.mesh

    def _part(self, scalars: str | None, options: dict[str, Any], progress: Progress | None) -> Surface:
        """Return the selected part of the surface, and remove the options that select it from `options`."""
        extracted, source = self._source(scalars, options.get("unit"))
        making: dict[str, Any] = {name: options.pop(name) for name in ("label", "threshold", "unit") if name in options}
        making |= {name: options[name] for name in ("threads", "memory_limit") if name in options}
        part = surface(source, progress=progress, **making)
        for name in ("keep", "drop"):
            region = self._region(options.pop(name, None))
            if region is not None:
                region = region if extracted is None else self._mask_of(extracted, region, name)
                part = part.keep(region) if name == "keep" else part.drop(region)
        seed_point, radius = options.pop("seed_point", None), options.pop("radius", None)
        if (seed_point is None) != (radius is None):
            named, missing = ("seed_point", "radius") if radius is None else ("radius", "seed_point")
            raise InputError(f"{named} is given without {missing}. Pass both or neither")
        if seed_point is not None:
            seed = self._voxels(scalars, seed_point) if extracted is None else extracted.point(seed_point, "seed_point")
            part = part.disk(seed, radius, threads=options.get("threads"), progress=progress)
        if (corners := options.pop("polygon", None)) is not None:
            part = part.polygon(self._places(scalars, corners, "polygon"), progress=progress)
        if extracted is not None and isinstance(options.get("cuts"), Sequence) and not isinstance(options["cuts"], str):
            options["cuts"] = [np.atleast_1d(extracted.points(path, "cuts")) for path in options["cuts"]]
        return part

    def _method(self, scalars: str | None, method: str | Method) -> Method:
        """Return a method whose sources are surface points, or whose number of sources is fixed."""
        chosen = method_of(method)
        sources = getattr(chosen, "sources", 0)
        if is_number(sources):
            return chosen
        places: dict[str, Any] = {"sources": self._places(scalars, sources, "sources")}
        return replace(chosen, **places)

    def _places(self, scalars: str | None, places: Any, name: str) -> Any:
        """Convert positions on the dataset to surface points."""
        if self._is_image:
            return self._voxels(scalars, places)
        return np.atleast_1d(self._extracted(scalars).points(places, name))

    def _voxels(self, scalars: str | None, places: Any) -> Any:
        """Convert positions in an image to voxels; voxels are returned unchanged."""
        positions = np.asarray(places)
        if positions.dtype.kind != "f" or positions.shape[-1:] != (3,):
            return places
        voxels = [self.voxel_at(position, scalars) for position in positions.reshape(-1, 3)]
        return voxels[0] if positions.ndim == 1 else np.array(voxels)

    def _mask_of(self, extracted: ExtractedSurface, region: object, name: str) -> object:
        """Convert a region of dataset points to a region of surface points."""
        is_mask = not isinstance(region, np.ndarray) or region.shape == (self._mesh.n_points,)
        return region if is_mask else extracted.points(region, name)

    def _region(self, region: object) -> object:
        """Convert a region to a form that `Surface.keep` accepts."""
        if isinstance(region, pv.DataSet):
            return image_volume(region)
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
            raise InputError(f"{region!r} is neither a point array nor a file. Available arrays: {there}")
        return region
