"""Filters for VTK pipelines that flatten a surface, measure distances on it, or divide it into patches.

`voxflat.vtk` requires PyVista and VTK 9.1 or later. Its filters return the same arrays as ``mesh.voxflat``. The options
of a filter are its attributes. After an option has changed, the next ``Update`` runs the filter again. Options hold
copies of arrays: after you change an array in place, set the option again.

>>> import voxflat
>>> from vtkmodules.vtkFiltersSources import vtkPlaneSource
>>> plane = vtkPlaneSource()
>>> plane.SetResolution(8, 8)
>>> flatten = voxflat.vtk.FlattenSurface(method=voxflat.methods.Voxflat(sources=9))
>>> flatten.SetInputConnection(plane.GetOutputPort())
>>> _ = flatten.Update()
>>> flatten.GetOutput().GetNumberOfPoints()
81
"""

from __future__ import annotations

import difflib
from abc import abstractmethod
from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import numpy as np
import pyvista as pv
from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase
from vtkmodules.vtkCommonCore import vtkOutputWindow
from vtkmodules.vtkCommonDataModel import vtkDataObject, vtkDataSet

from voxflat._pyvista.accessor import VoxflatAccessor
from voxflat._pyvista.options import Seed
from voxflat.errors import Cancelled, InputError
from voxflat.methods import Method
from voxflat.read_only import read_only

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform
else:

    def dataclass_transform(**_: object) -> Callable[[type], type]:
        """Return a decorator that does nothing, because only type checkers read it."""
        return lambda cls: cls


__all__ = ["FlattenSurface", "SurfaceGeodesic", "SurfacePatches"]


def __dir__() -> list[str]:
    return sorted(__all__)


_Value = TypeVar("_Value")


class _Option(Generic[_Value]):
    """An option of a filter; setting another value marks the filter as modified.

    The filter keeps a copy of an array or a list, so that it notices when a changed one is set again.
    """

    def __init__(self, default: _Value) -> None:
        self._default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> _Option[_Value]: ...
    @overload
    def __get__(self, instance: _Filter, owner: type) -> _Value: ...
    def __get__(self, instance: _Filter | None, owner: type) -> _Option[_Value] | _Value:
        if instance is None:
            return self
        value: _Value = instance.given.get(self.name, self._default)
        return value

    def __set__(self, instance: _Filter, value: _Value) -> None:
        if not _is_same(self.__get__(instance, type(instance)), value):
            instance.given[self.name] = read_only(deepcopy(value)) if isinstance(value, np.ndarray | list) else value
            instance.Modified()


@dataclass_transform(kw_only_default=True, field_specifiers=(_Option,))
class _Filter(VTKPythonAlgorithmBase):
    """Base class of the filters, with their options, progress reports, cancellation and VTK error events."""

    OUTPUT = "vtkPolyData"

    def __init__(self, **options: object) -> None:
        self.given: dict[str, Any] = {}
        initialise: Any = VTKPythonAlgorithmBase.__init__
        initialise(self, nInputPorts=1, inputType="vtkDataSet", nOutputPorts=1, outputType=self.OUTPUT)
        for name, value in options.items():
            if name not in self.options():
                raise TypeError(self._unknown(name))
            setattr(self, name, value)

    def __setattr__(self, name: str, value: object) -> None:
        """Set an option; other names, such as misspelt ones, are refused."""
        is_vtks = not name[:1].islower()  # such as InputType
        if not (is_vtks or name == "given" or hasattr(type(self), name)):
            raise AttributeError(self._unknown(name))
        super().__setattr__(name, value)

    def _unknown(self, name: str) -> str:
        options = self.options()
        near = difflib.get_close_matches(name, options, 1)
        rest = f"Did you mean {near[0]}?" if near else f"Its options are {', '.join(options)}"
        return f"{type(self).__name__} has no option {name!r}. {rest}"

    @classmethod
    def options(cls) -> list[str]:
        """Return the names of the options.

        Returns
        -------
        list of str
            The names in alphabetical order.
        """
        return [name for name in dir(cls) if isinstance(getattr(cls, name), _Option)]

    def SetInputData(self, data: vtkDataSet) -> None:  # noqa: N802
        """Set a dataset as the input.

        Use ``SetInputConnection`` to connect the output of another filter.

        Parameters
        ----------
        data : vtkDataSet
            The dataset.
        """
        self.SetInputDataObject(0, data)

    def GetOutput(self) -> vtkDataObject:  # noqa: N802
        """Return the output of the filter.

        Call ``Update`` first.

        Returns
        -------
        vtkDataSet
            The output, which is empty before ``Update``.

        Examples
        --------
        >>> flatten = voxflat.vtk.FlattenSurface()
        >>> flatten.SetInputData(pv.Plane())
        >>> _ = flatten.Update()
        >>> flatten.GetOutput().GetNumberOfPoints()
        121
        """
        output: vtkDataObject = self.GetOutputDataObject(0)
        return output

    def RequestData(self, _request: object, inputs: Any, outputs: Any) -> int:  # noqa: N802
        """Compute the output; called by VTK. After an error or an abort, the output is empty.

        An `InputError` is reported as an ErrorEvent or, without an observer, in VTK's output window.
        """
        output = vtkDataSet.GetData(outputs)
        try:
            result: Any = self._made(pv.wrap(vtkDataSet.GetData(inputs[0])), self._progress())
            output.ShallowCopy(result)
        except Cancelled:
            output.Initialize()
        except InputError as error:
            output.Initialize()
            if not self.HasObserver("ErrorEvent"):
                vtkOutputWindow.GetInstance().DisplayErrorText(f"{type(self).__name__}: {error}\n")
            self.InvokeEvent("ErrorEvent", str(error))
            return 0
        return 1

    @abstractmethod
    def _made(self, dataset: pv.DataSet, progress: Callable[[str, int, int], bool]) -> pv.DataSet:
        """Return the output."""

    def _progress(self) -> Callable[[str, int, int], bool]:
        """Return a function that reports progress to VTK and returns whether to continue.

        Each stage fills half of the remaining progress bar.
        """
        last, stages, reached = "", 0, 0.0

        def told(stage: str, done: int, total: int) -> bool:
            nonlocal last, stages, reached
            share = min(done / max(total, 1), 1.0)
            if stage != last or share < reached:  # a stage may be repeated on a finer surface
                last, stages = stage, stages + 1
                self.SetProgressText(stage)
            reached = share
            self.UpdateProgress(1 - 0.5 ** (stages - 1) * (1 - share / 2))
            return not (self.GetAbortExecute() or (hasattr(self, "CheckAbort") and self.CheckAbort()))

        return told


class FlattenSurface(_Filter):
    """Flatten a surface, or the surface of an image, into the plane z = 0.

    This filter is equivalent to ``mesh.voxflat()``. The input is any ``vtkDataSet``. The output is ``vtkPolyData`` with
    all arrays of the input and the measures of distortion.

    Parameters
    ----------
    **options : dict
        Initial values of the attributes below.

    Attributes
    ----------
    scalars : str or None
        Name of the image array to use, or None for the active array.
    label, threshold : int, float or None
        Label or threshold of the image foreground, as in `voxflat.surface`.
    keep, drop : str, ndarray or None
        Region to keep or to exclude: the name of a point array, or a mask.
    seed_point : int, position, pyvista.Cell or None
        Centre of a patch with the given `radius`.
    radius : float or None
        Radius of the patch along the surface, in the unit of the data.
    cuts, relax, method : object
        Cuts, relaxation cuts and method, as in `Surface.flatten`.
    seed : int
        Seed for random choices.
    threads : int or None
        Number of threads.

    See Also
    --------
    SurfacePatches : Flatten a surface in certified patches.

    Examples
    --------
    >>> flatten = voxflat.vtk.FlattenSurface(seed=1)
    >>> flatten.SetInputData(pv.Plane())
    >>> flatten.Update()
    True
    >>> flatten.GetOutput().GetNumberOfPoints()
    121
    """

    scalars: _Option[str | None] = _Option(default=None)
    label: _Option[int | None] = _Option(default=None)
    threshold: _Option[float | None] = _Option(default=None)
    keep: _Option[object] = _Option(default=None)
    drop: _Option[object] = _Option(default=None)
    seed_point: _Option[Seed | None] = _Option(default=None)
    radius: _Option[float | None] = _Option(default=None)
    cuts: _Option[object] = _Option(default=None)
    relax: _Option[float | bool | None] = _Option(default=None)
    method: _Option[str | Method] = _Option(default="voxflat")
    seed: _Option[int] = _Option(default=0)
    threads: _Option[int | None] = _Option(default=None)

    def _made(self, dataset: pv.DataSet, progress: Callable[[str, int, int], bool]) -> pv.DataSet:
        return VoxflatAccessor(dataset)(progress=progress, **self.given)


class SurfaceGeodesic(_Filter):
    """Measure distances along a surface.

    This filter is equivalent to ``mesh.voxflat.geodesic()``. The input is any ``vtkDataSet`` except an image. The
    output is a copy of the input with the point data ``geodesic_distance``.

    Parameters
    ----------
    **options : dict
        Initial values of the attributes below.

    Attributes
    ----------
    sources : int, position, pyvista.Cell, or several of them
        Points from which distances are measured. The default is point 0.
    method : {"graph", "marching", "exact"}
        How distances are measured, as in `Surface.geodesic`.

    See Also
    --------
    FlattenSurface : Flatten a surface into the plane.

    Examples
    --------
    >>> distances = voxflat.vtk.SurfaceGeodesic(sources=0)
    >>> distances.SetInputData(pv.Plane())
    >>> distances.Update()
    True
    >>> distances.GetOutput().GetPointData().GetNumberOfArrays()
    3
    """

    OUTPUT = "vtkDataSet"
    sources: _Option[Seed] = _Option(default=0)
    method: _Option[str] = _Option(default="graph")

    def RequestDataObject(self, _request: object, inputs: Any, outputs: Any) -> int:  # noqa: N802
        """Create an output of the same type as the input; called by VTK."""
        source, target = vtkDataSet.GetData(inputs[0]), vtkDataSet.GetData(outputs)
        if target is None or target.GetClassName() != source.GetClassName():
            outputs.GetInformationObject(0).Set(vtkDataSet.DATA_OBJECT(), source.NewInstance())
        return 1

    def _made(self, dataset: pv.DataSet, progress: Callable[[str, int, int], bool]) -> pv.DataSet:
        return VoxflatAccessor(dataset).geodesic(self.sources, method=self.method, progress=progress)


class SurfacePatches(_Filter):
    """Flatten a surface of any topology in certified patches.

    This filter is equivalent to ``mesh.voxflat.patches()``. The input is any ``vtkDataSet``. The output is
    ``vtkPolyData`` with all patches side by side.

    Parameters
    ----------
    **options : dict
        Initial values of the attributes below.

    Attributes
    ----------
    max_angle : float or None
        Largest angle between a triangle and the plane of its patch, in degrees. The default is 10.
    bound, count, glue, packing, seeds, seed, scalars, label, threshold, threads : object
        As in ``mesh.voxflat.patches``.

    See Also
    --------
    FlattenSurface : Flatten a surface into a single map.

    Examples
    --------
    >>> patches = voxflat.vtk.SurfacePatches(max_angle=20)
    >>> patches.SetInputData(pv.Icosphere(nsub=2))
    >>> patches.Update()
    True
    >>> patches.GetOutput().GetNumberOfCells()
    320
    """

    max_angle: _Option[float | None] = _Option(default=None)
    bound: _Option[float | None] = _Option(default=None)
    count: _Option[int | None] = _Option(default=None)
    glue: _Option[float | None] = _Option(default=None)
    packing: _Option[str] = _Option(default="boxes")
    seeds: _Option[str] = _Option(default="curvature")
    seed: _Option[int] = _Option(default=0)
    scalars: _Option[str | None] = _Option(default=None)
    label: _Option[int | None] = _Option(default=None)
    threshold: _Option[float | None] = _Option(default=None)
    threads: _Option[int | None] = _Option(default=None)

    def _made(self, dataset: pv.DataSet, progress: Callable[[str, int, int], bool]) -> pv.DataSet:
        return VoxflatAccessor(dataset).patches(progress=progress, **self.given)


def _is_same(value: object, other: object) -> bool:
    """Return whether two values are equal; arrays are compared by their values."""
    if value is other or type(value) is not type(other):
        return value is other
    if isinstance(value, Method):
        return bool(value.provenance == getattr(other, "provenance", None))
    if isinstance(value, np.ndarray):
        return value.dtype == np.asarray(other).dtype and np.array_equal(value, np.asarray(other))
    return isinstance(value, int | float | str | tuple) and value == other
