"""Run the filters of ``voxflat.vtk`` in a plain VTK pipeline and print facts as JSON, with any Python that has VTK."""

import hashlib
import json
import sys
import warnings

import voxflat
from voxflat.methods import Voxflat

facts = {"loaded by voxflat": sorted({"pyvista", "vtkmodules"} & set(sys.modules))}
filters = voxflat.vtk

import numpy as np  # noqa: E402
import pyvista as pv  # noqa: E402
from vtkmodules.vtkCommonComputationalGeometry import vtkParametricEnneper  # noqa: E402
from vtkmodules.vtkCommonCore import vtkVersion  # noqa: E402
from vtkmodules.vtkFiltersCore import vtkElevationFilter  # noqa: E402
from vtkmodules.vtkFiltersSources import vtkParametricFunctionSource  # noqa: E402

warnings.simplefilter("ignore")
facts["version"] = vtkVersion.GetVTKVersion()


def same(mesh, output):
    """Tell whether a mesh of the accessor and an output of a filter are bit-identical."""
    found = pv.wrap(output)
    arrays = [(mesh.points, found.points)]
    for kind in ("point_data", "cell_data"):
        ours, theirs = getattr(mesh, kind), getattr(found, kind)
        if list(ours) != list(theirs):
            return False
        arrays += [(ours[name], theirs[name]) for name in ours]
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in arrays)


source = vtkParametricFunctionSource()
source.SetParametricFunction(vtkParametricEnneper())
source.SetUResolution(14)
source.SetVResolution(14)
height = vtkElevationFilter()
height.SetInputConnection(source.GetOutputPort())
height.Update()
mesh = pv.wrap(height.GetOutput())

flatten = filters.FlattenSurface(method=Voxflat(sources=10), relax=False)
flatten.SetInputConnection(height.GetOutputPort())
runs, told = [], []
flatten.AddObserver("StartEvent", lambda *_: runs.append(1))
flatten.AddObserver("ProgressEvent", lambda caller, _: told.append((caller.GetProgress(), caller.GetProgressText())))
flatten.Update()
expected = mesh.voxflat(method=Voxflat(sources=10), relax=False)
facts["flat is the accessor's"] = same(expected, flatten.GetOutput())
facts["arrays"] = list(expected.array_names)
facts["sha256"] = hashlib.sha256(np.ascontiguousarray(expected.points).tobytes()).hexdigest()
elevation = pv.wrap(flatten.GetOutput())["Elevation"]
facts["elevation"] = bool(np.array_equal(elevation, mesh["Elevation"][expected["vertex_ids"]]))
facts["progress"] = told[:]

counts = [len(runs)]
everywhere = np.ones(mesh.n_points, dtype=bool)
in_place = everywhere.copy()
for options, resolution in (
    ({}, 14),  # as it was
    ({"method": Voxflat(sources=10), "relax": False}, 14),  # the same values
    ({"method": Voxflat(sources=11)}, 14),
    ({"keep": everywhere}, 14),
    ({"keep": everywhere.copy()}, 14),  # an equal mask
    ({"keep": in_place}, 14),  # an equal mask, which changes before it is set again
    ({"keep": in_place}, 14),
    ({"keep": None}, 13),  # two changes, one of the surface
):
    for name, value in options.items():
        setattr(flatten, name, value)
    source.SetUResolution(resolution)
    flatten.Update()
    counts.append(len(runs))
    in_place[0] = options.get("keep") is not in_place
facts["runs"] = counts


def stop(caller, _):
    if caller.GetProgress() > 0.4:
        caller.SetAbortExecute(1)


watch = flatten.AddObserver("ProgressEvent", stop)
flatten.method = Voxflat(sources=12)
flatten.Update()
facts["points after an abort"] = flatten.GetOutput().GetNumberOfPoints()
flatten.RemoveObserver(watch)
flatten.SetAbortExecute(0)
flatten.Modified()
flatten.Update()
facts["points afterwards"] = flatten.GetOutput().GetNumberOfPoints()

messages = []


def listen(_caller, _event, message):
    messages.append(message)


listen.CallDataType = "string0"
with pv.VtkErrorCatcher(send_to_logging=False):
    flatten.AddObserver("ErrorEvent", listen)
    flatten.seed_point = 10**6
    flatten.radius = 1.0
    flatten.Update()
facts["messages"], facts["points after an error"] = messages, flatten.GetOutput().GetNumberOfPoints()
try:
    filters.FlattenSurface(raduis=3)
except TypeError as error:
    facts["misspelt"] = str(error)
try:
    flatten.treads = 3
except AttributeError as error:
    facts["unknown"] = str(error)

distances = filters.SurfaceGeodesic(sources=(0.0, 0.0, 0.0), method="exact")
x, y = np.meshgrid(np.linspace(0, 4, 5), np.linspace(0, 3, 4), indexing="ij")
grid = pv.StructuredGrid(x, y, 0 * x)
distances.SetInputData(grid)
distances.Update()
facts["geodesic"] = [
    distances.GetOutput().GetClassName(),
    same(grid.voxflat.geodesic((0.0, 0.0, 0.0), method="exact"), distances.GetOutput()),
    float(np.abs(pv.wrap(distances.GetOutput())["geodesic_distance"] - np.linalg.norm(grid.points, axis=1)).max()),
]
distances.SetInputConnection(height.GetOutputPort())
distances.Update()
facts["geodesic"].append(distances.GetOutput().GetClassName())

patches = filters.SurfacePatches(max_angle=20.0)
patches.SetInputConnection(height.GetOutputPort())
patches.Update()
height.Update()
facts["page is the accessor's"] = same(pv.wrap(height.GetOutput()).voxflat.patches(20.0), patches.GetOutput())

image = pv.ImageData(dimensions=(9, 9, 9))
image["ball"] = 4 - np.linalg.norm(image.points - 4, axis=1)
how = {"method": Voxflat(sources=9), "threshold": 0.4, "relax": False}
of_image = filters.FlattenSurface(**how)
of_image.SetInputData(image)
of_image.Update()
facts["image is the accessor's"] = same(image.voxflat(**how), of_image.GetOutput())
print(json.dumps(facts))
