"""A flat map as the objects of other packages, and as Jupyter shows it."""

from __future__ import annotations

import importlib
from abc import abstractmethod
from typing import Any

from voxflat.distortion.distortion import Distortion
from voxflat.io.files import require
from voxflat.io.formats import gifti
from voxflat.io.meshes import Mesh
from voxflat.io.notebook import page


class Convertible:
    """The conversions of a flat map."""

    distortion: Distortion

    @abstractmethod
    def _flat_mesh(self) -> Mesh:
        """Return the map as a mesh in the plane, with the vertex numbers of the flattened mesh if it was one."""

    def to_nilearn(self) -> Any:
        """Convert the map of a mesh to nilearn's ``InMemoryMesh``, for ``plot_surf`` and ``view_surf``.

        It has the vertices of the mesh that was flattened, in their order, so that data on that mesh can be plotted on
        it. Vertices that the map leaves out lie at the origin and belong to no triangle.

        Returns
        -------
        nilearn.surface.InMemoryMesh
            Coordinates (u, v, 0), mm.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.to_nilearn().n_vertices
        441
        """
        mesh = self._flat_mesh()
        return require("nilearn.surface", "demo").InMemoryMesh(mesh.points, mesh.faces)

    def to_gifti(self) -> Any:
        """Convert the map to nibabel's ``GiftiImage``, a flat surface as ``save("map.surf.gii")`` writes it.

        Returns
        -------
        nibabel.gifti.GiftiImage
            With the vertices of the mesh that was flattened.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.to_gifti().agg_data("pointset").shape
        (441, 3)
        """
        mesh = self._flat_mesh()
        return gifti.load(gifti.surface_bytes(mesh.points, mesh.faces, mesh.structure))

    def to_trimesh(self) -> Any:
        """Convert the map to ``trimesh.Trimesh``, in the plane.

        Returns
        -------
        trimesh.Trimesh
            With the vertices of the mesh that was flattened, (u, v, 0) in mm.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> len(flat_map.to_trimesh().vertices)
        441
        """
        mesh = self._flat_mesh()
        return require("trimesh").Trimesh(mesh.points, mesh.faces, process=False)

    def to_pyvista(self) -> Any:
        """Convert the map to ``pyvista.PolyData``, in the plane, with its distortion as point data.

        Returns
        -------
        pyvista.PolyData
            With a point for each row of the map, as ``mesh.voxflat()`` returns it.

        Examples
        --------
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> flat_map.to_pyvista().n_points
        441
        """
        require("pyvista")
        return _drawing("_pyvista.flat").to_polydata(self)

    def plot(self, overlay: object | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the map, as `voxflat.figures.flat_map` and the command ``voxflat figure`` do.

        Parameters
        ----------
        overlay : Overlay, path, ndarray, image object or Volume, optional
            Data over the folds.
        ax : matplotlib.axes.Axes, optional
            Draw into these axes; by default into a new figure.
        **options
            As in `voxflat.figures.flat_map`.

        Returns
        -------
        matplotlib.axes.Axes or matplotlib.figure.Figure
            `ax`, or the new figure.

        Raises
        ------
        InputError
            As `voxflat.figures.flat_map`.

        Examples
        --------
        >>> import matplotlib.pyplot as plt
        >>> flat_map = voxflat.samples.hill().flatten()
        >>> figure, ax = plt.subplots()
        >>> flat_map.plot(flat_map.points[:, 2], ax=ax) is ax
        True
        """
        figure = _drawing("figures").flat_map(self, overlay, ax=ax, **options)
        return figure if ax is None else ax

    def _repr_html_(self) -> str:
        """Return the picture and the figures of the map, for Jupyter."""
        figure = _drawing("figures").flat_map(self)
        return page(self, self.distortion.table(), figure, "The flat map, coloured by its folds")


def _drawing(module: str) -> Any:
    """Import a module that draws, which stands above maps and needs packages that not everybody has."""
    return importlib.import_module(f"voxflat.{module}")
