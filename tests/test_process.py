"""Importing and using voxflat leaves the user's process as it was."""

import json
import os
import subprocess
import sys

import pytest

pytest.importorskip("nibabel")

PROGRAM = r"""
import decimal, gc, json, locale, logging, multiprocessing, os, random, signal, sys, threading, warnings
from xml.etree import ElementTree

import matplotlib
import matplotlib.font_manager
import matplotlib.figure
import matplotlib.backends.backend_agg
import matplotlib.backends.backend_svg
import nibabel
import numpy as np
import PIL.Image
import PIL.ImageFile
import PIL.TiffImagePlugin
import pyvista
import scipy.ndimage, scipy.spatial, scipy.sparse.csgraph, scipy.sparse.linalg
import tifffile
import tqdm
from vtkmodules.vtkCommonCore import vtkObject, vtkOutputWindow

warnings.filterwarnings("default", message="one of the user's own")
logging.getLogger("user").addHandler(logging.NullHandler())


def state():
    found = {}
    for number in signal.valid_signals():
        found[f"signal {int(number)}"] = signal.getsignal(number)
    mask = os.umask(0)
    os.umask(mask)
    found |= {"umask": mask, "directory": os.getcwd(), "locale": locale.setlocale(locale.LC_ALL)}
    found |= {f"environment {name}": value for name, value in os.environ.items()}
    found |= {"environment": sorted(os.environ), "search path": sys.path, "importers": sys.meta_path}
    for name in ("excepthook", "displayhook", "unraisablehook", "breakpointhook"):
        found[f"sys.{name}"] = getattr(sys, name)
    found |= {"threading.excepthook": threading.excepthook, "recursion": sys.getrecursionlimit()}
    found |= {"switch": sys.getswitchinterval(), "digits": sys.get_int_max_str_digits(), "stdout": sys.stdout}
    found |= {"stderr": sys.stderr, "threads": sorted(one.name for one in threading.enumerate())}
    found |= {"gc": (gc.isenabled(), gc.get_threshold(), gc.callbacks, gc.get_freeze_count())}
    found |= {"start method": multiprocessing.get_start_method(allow_none=True)}
    found |= {"random": random.getstate(), "numpy random": np.random.get_state()[1:]}
    found |= {"errstate": np.geterr(), "print options": np.get_printoptions(), "decimal": decimal.getcontext()}
    found |= {"warnings": warnings.filters, "showwarning": warnings.showwarning}
    found |= {f"rc {name}": value for name, value in matplotlib.rcParams.items()}
    found |= {"backend": matplotlib.get_backend(auto_select=False), "interactive": matplotlib.is_interactive()}
    found |= {"fonts": [one.fname for one in matplotlib.font_manager.fontManager.ttflist]}
    found |= {"colour maps": sorted(matplotlib.colormaps)}
    found |= {"pixels": PIL.Image.MAX_IMAGE_PIXELS, "truncated": PIL.ImageFile.LOAD_TRUNCATED_IMAGES}
    found |= {"namespaces": dict(ElementTree._namespace_map), "nibabel": nibabel.imageglobals.error_level}
    found |= {"pyvista": (pyvista.OFF_SCREEN, pyvista.BUILDING_GALLERY, repr(pyvista.global_theme))}
    found |= {"vtk": vtkObject.GetGlobalWarningDisplay(), "vtk window": vtkOutputWindow.GetInstance().GetClassName()}
    try:
        import resource
        limits = [name for name in dir(resource) if "RLIMIT" in name]
        found |= {f"limit {name}": resource.getrlimit(getattr(resource, name)) for name in limits}
    except ImportError:
        pass
    names = [None, *sorted(logging.root.manager.loggerDict)]
    for log in map(logging.getLogger, names):
        handlers = [one for one in log.handlers if not isinstance(one, logging.NullHandler)]
        filters = [] if log.name == "voxflat" else log.filters  # our own logger passes warnings on to their task
        plain = (log.level, handlers, filters, log.disabled, log.propagate)
        if plain != (0, [], [], False, True):
            found[f"log {log.name}"] = plain
    return {name: repr(value) for name, value in found.items()}


def run():
    labels = np.zeros((24, 24, 24), dtype=np.uint8)
    labels[4:20, 4:20, 4:20] = 3
    nibabel.Nifti1Image(labels, np.eye(4)).to_filename("v.nii.gz")
    tifffile.imwrite("v.tif", labels)
    PIL.Image.fromarray(np.zeros((64, 64, 3), dtype=np.uint8)).save("picture.tif")
    surface = voxflat.surface("v.nii.gz", label=3, repair="voxels")
    voxflat.surface("v.tif", label=3, spacing=(1, 1, 1))
    flat_map = surface.cut().flatten(voxflat.methods.Voxflat(sources=20), threads=3)
    surface.geodesic(5, store="store")
    surface.patches(20)
    voxflat.flatten(voxflat.samples.hill(), progress=lambda *_: None)
    flat_map.save("map.npz")
    loaded = voxflat.load("map.npz")
    loaded.image("v.nii.gz").save("image.png")
    for ending in ("png", "svg", "pdf"):
        voxflat.figures.save(voxflat.figures.flat_map(loaded, "v.nii.gz"), f"figure.{ending}")
    loaded.textured("picture.tif").save("textured.obj")
    loaded.to_pyvista()
    loaded._repr_html_()
    voxflat.measure(voxflat.samples.hill(), voxflat.samples.hill().flatten(), sources=5)
    voxflat.cite(loaded)
    try:
        voxflat.surface("none.nii.gz")
    except OSError:
        pass


def changes(before, after):
    pairs = {name: (before.get(name), after.get(name)) for name in {*before, *after}}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def faults():
    import resource
    counts = []
    np.ones(30 << 17)  # glibc raises its thresholds when it frees a large array, unless somebody has fixed them
    for size in (1.5, 3, 8):
        start = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(100):
            np.ones(int(size * 2**17))
        counts.append((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - start) / 100)
    return counts


before = state()
import voxflat
imported = state()
run()
print(json.dumps([changes(before, imported), changes(imported, state()), faults() if sys.platform == "linux" else []]))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("process")
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")
    }  # of other tests
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_importing_and_running_changes_nothing_of_the_process(told):
    imported, ran, _ = told
    assert (imported, ran) == ({}, {})


@pytest.mark.slow
def test_temporary_arrays_reuse_memory_as_before(told):
    _, _, faults = told
    assert all(count < 50 for count in faults), faults  # new memory for 1.5 MB has 366 pages
