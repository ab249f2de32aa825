"""Python scripts that repeat a run without a window."""

import hashlib
import itertools
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._core import __version__
from voxflat._napari.job import Frames, Job, PatchesJob
from voxflat._napari.layers.foreground import RIMS
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.sampled import Overlay, Sampled, Shown
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.results.flat_layers import FlatLayers
from voxflat.arguments import Progress
from voxflat.atlases.atlas import Atlas
from voxflat.atlases.certified import load_atlas
from voxflat.errors import InputError
from voxflat.io.files import SAVED_ENDINGS, atomic_path, file_name
from voxflat.io.meshes import Mesh, read_mesh
from voxflat.io.overlays import read_overlay
from voxflat.io.volumes import Volume, read_volume
from voxflat.maps.flat_map import FlatMap, load_saved
from voxflat.methods import Method
from voxflat.pipeline.flat_series import load_series
from voxflat.surfaces.standard.sphere import OWN_REGISTRATION

_WIDTH = 100  # preferred line length of a script
_PATH, _NUMPY, _TREE = "from pathlib import Path", "import numpy as np", "from scipy.spatial import cKDTree"


class Recipe:
    """Runs a job, and writes a Python script that repeats it."""

    def __init__(self, job: Job | PatchesJob) -> None:
        self._job = job
        self._fingerprints: list[str] = []

    def run(self, progress: Progress) -> FlatLayers:
        """Run the job, and record fingerprints of its data."""
        result = self._job.run(progress)
        self._fingerprints = _fingerprints(self._job)
        return result

    def needs_folder(self) -> bool:
        """Return whether any data are not in a file and must be saved with the script."""
        return bool(_Script(self._job, None).unsaved)

    def script(self, folder: Path | None = None) -> str:
        """Return a script; data that are not in a file are saved in a folder. Raises InputError if layers changed."""
        if _fingerprints(self._job) != self._fingerprints:
            raise InputError("Layers of this run were changed after it finished. Flatten again, and copy the script")
        return _Script(self._job, folder).text()


class OpenedFile:
    """Writes a Python script that loads a map, an atlas or the maps of a movie from the file that was opened."""

    def __init__(self, path: str, opened: FlatMap | Atlas, *, is_movie: bool = False) -> None:
        self._path, self._opened, self._is_movie = Path(path).resolve(), opened, is_movie

    def needs_folder(self) -> bool:
        return False

    def script(self, folder: Path | None = None) -> str:
        """Return the script; raises InputError or OSError if the file does not contain this map any more."""
        found: FlatMap | Atlas
        if self._is_movie:
            found, what, name, function = load_series(self._path).flat_map, "movie", "series", "load_series"
        elif isinstance(self._opened, FlatMap):
            if self._opened.method == "given" and not self._path.name.lower().endswith(SAVED_ENDINGS):
                return self._of_other_tool(self._opened)
            found, what, name, function = load_saved(self._path), "map", "flat_map", "load"
        else:
            found, what, name, function = load_atlas(self._path), "atlas", "atlas", "load_atlas"
        if not _same(found.uv, self._opened.uv):
            raise InputError(f"{self._path}: contains another {what} than the opened one. Open the file again")
        about = f'"""Load the {what} that was opened in napari."""'
        return f"{about}\n\nimport voxflat\n\n{name} = voxflat.{function}({str(self._path)!r})\n"

    def _of_other_tool(self, flat_map: FlatMap) -> str:
        """Return the script of a map of another tool, which was opened with its surface."""
        parameters: Any = flat_map.record["parameters"]
        files = [parameters[name] for name in ("flat", "surface")]
        if not all(isinstance(file, str) and Path(file).is_file() for file in files):
            raise InputError("the layer of the map or of its surface was changed. Save the map, and open that file")
        flat, surface = (str(Path(file).resolve()) for file in files)
        load = f"flat_map = voxflat.load({flat!r}, surface={surface!r})"
        return f'"""Load the map that was opened in napari."""\n\nimport voxflat\n\n{load}\n'


class _Script:
    """The lines of a script, and the data that it needs."""

    def __init__(self, job: Job | PatchesJob, folder: Path | None) -> None:
        self._folder = folder
        self._imports: set[str] = set()
        self._readers: set[str] = set()
        self._lines: list[str] = []
        self._named: dict[int, str] = {}
        self.unsaved: list[str] = []  # names of the data that are not in a file
        self._title = job.surface.origin["layer"]
        if isinstance(job, Job):
            self._of_job(job)
        else:
            self._of_patches(job)

    def text(self) -> str:
        about = f'"""Repeat the run of voxflat {__version__} on {self._title!r} in napari."""'
        standard, others = ([line for line in lines if line in self._imports] for lines in ((_PATH,), (_NUMPY, _TREE)))
        own = ["import voxflat", f"from voxflat.io import {', '.join(sorted(self._readers))}"]
        blocks = [standard, others, own, self._lines]
        return "\n\n".join([about, *("\n".join(block) for block in blocks if block)]) + "\n"

    def _of_job(self, job: Job) -> None:
        if job.frames is not None:
            self._of_movie(job, job.frames)
            return
        pial = None if job.pial is None else _Code(self._surface(job.pial, "pial"))
        self._whole(job, pial=pial)
        if job.flat is not None:
            self._call("flat_map", "voxflat.load", self._surface(job.flat, "flat"), {"surface": _Code("surface")})
            self._result("flat_map", job.shown, job.pixel_size)
            return
        method, drop, how = job.split()
        if how.get("sphere") == OWN_REGISTRATION:
            self._lines.append("sphere = surface.register()")
            how["sphere"] = _Code("sphere")
        if job.polygon is not None:
            self._imports.add(_TREE)
            corners = self._array(job.polygon, "polygon")
            self._lines.append(f"_, nearest = cKDTree(surface.points).query({corners})")
            self._lines.append("corners = surface.ids[nearest]")
        if job.keep is not None:
            keep = job.keep
            region = self._surface(keep, "mask") if isinstance(keep, LayerVolume) else self._array(keep, "keep")
            self._lines.append(f"surface = surface.keep({region})")
        if drop is not None:
            self._lines.append(f"surface = surface.drop({self._array(drop, 'drop')})")
        if job.seed_point is not None:
            seed = self._value("seed_point", job.seed_point)
            self._lines.append(f"surface = surface.disk({seed}, {self._value('radius', job.radius)})")
        if job.polygon is not None:
            self._lines.append("surface = surface.polygon(corners)")
        self._call("flat_map", "surface.flatten", self._method(job, method), how)
        self._result("flat_map", job.shown, job.pixel_size)

    def _of_movie(self, job: Job, frames: Frames) -> None:
        """Add the lines that flatten all frames of a movie."""
        volumes = [volume.read() for volume in frames.volumes]
        arrays = {"data": np.stack([volume.data for volume in volumes]), "affine": volumes[0].affine}
        saved = self._load(job.surface.origin["layer"], **arrays)
        self._readers.add("Volume")
        place = f'{saved}["affine"], unit={volumes[0].unit!r}'
        self._lines.append(f'volumes = [Volume(frame, {place}) for frame in {saved}["data"]]')
        how = "threshold" if job.label is None else "label"
        self._lines.append(f"surfaces = [voxflat.surface(volume, {how}={getattr(job, how)!r}) for volume in volumes]")
        method, _, options = job.split()
        first = ", ".join(filter(None, ["surfaces", self._method(job, method)]))
        self._call("series", "voxflat.flatten_series", first, {"reference": frames.reference, **options})
        self._lines.append("flat_map = series.flat_map")
        self._result("flat_map", None, job.pixel_size)

    def _whole(self, job: Job | PatchesJob, **given: Any) -> None:
        """Add the lines that make the surface."""
        source = self._surface(job.surface)
        if job.rim is None:
            unit = job.surface.place.unit
            if isinstance(job.surface, LayerMesh) and unit != "mm":
                given["unit"] = unit
            given = {"label": job.label, "threshold": job.threshold, **given}
            self._call("surface", "voxflat.surface", source, given)
        else:
            self._call("rim", "voxflat.rim", source, {"hemisphere": RIMS[job.rim].hemisphere})
            self._lines.append("surface = rim.surface")

    def _method(self, job: Job, method: Method) -> str:
        """Return a method as an argument: an object with options, a name, or nothing for the default method."""
        changed = {name: value for name, value in job.options.items() if name in type(method).__dataclass_fields__}
        parts = [f"{name}={self._value(name, value)}" for name, value in changed.items()]
        if job.start is not None:
            parts.append(f"start={self._map(job.start)}")
        if parts:
            return f"voxflat.methods.{type(method).__name__}({', '.join(parts)})"
        return "" if job.method == "voxflat" else repr(job.method)

    def _of_patches(self, job: PatchesJob) -> None:
        self._whole(job)
        self._call("atlas", "surface.patches", "", job.limit)
        if job.glue is not None:
            self._lines.append(f"atlas = atlas.glue({job.glue!r})")
        self._result("atlas", job.shown, job.pixel_size)

    def _result(self, name: str, shown: Shown | None, pixel_size: float | None) -> None:
        self._lines.append(f"{name}.save({file_name(self._title) + '.voxflat'!r})")
        if shown is None:
            return
        if isinstance(shown, Sampled):
            what = self._surface(shown.volume, "shown")
            how: dict[str, Any] = {"interpolation": "nearest" if shown.kind == "labels" else "linear"}
            how |= {"depth": shown.depth} if shown.fraction is None else {"fraction": shown.fraction}
        else:
            what, how = self._overlay(shown), {}
        self._call("image", f"{name}.image", what, {"pixel_size": pixel_size, **how})
        self._lines.append(f"image.save({file_name(shown.name) + '_flattened.png'!r})")

    def _call(self, result: str, function: str, first: str, given: dict[str, Any]) -> None:
        keywords = [f"{key}={self._value(key, value)}" for key, value in given.items() if value is not None]
        parts = [first, *keywords] if first else keywords
        line = f"{result} = {function}({', '.join(parts)})"
        if len(line) > _WIDTH:
            line = f"{result} = {function}(\n" + "".join(f"    {part},\n" for part in parts) + ")"
        self._lines.append(line)

    def _value(self, name: str, value: Any) -> str:
        if isinstance(value, _Code):
            return str(value)
        if isinstance(value, np.ndarray):
            return self._array(value, name)
        if isinstance(value, np.generic):
            return repr(value.item())
        if isinstance(value, dict):
            return "{" + ", ".join(f"{key!r}: {self._value(str(key), part)}" for key, part in value.items()) + "}"
        if isinstance(value, list | tuple):
            inside = ", ".join(self._value(f"{name} {n}", part) for n, part in enumerate(value))
            return f"[{inside}]" if isinstance(value, list) else f"({inside}{',' * (len(value) == 1)})"
        return repr(value)

    def _surface(self, source: LayerVolume | LayerMesh, variable: str | None = None) -> str:
        """Add code that reads a layer from its file if the file contains the same data, otherwise from a saved file."""
        known = self._named.get(id(source.place))
        if known is not None:
            return known
        name, read = source.origin["layer"], source.read()
        if isinstance(read, Volume):
            variable = variable or "volume"
            self._volume(read, name, variable)
        else:
            variable = variable or "mesh"
            self._mesh(read, name, variable)
        self._named[id(source.place)] = variable
        return variable

    def _volume(self, volume: Volume, name: str, variable: str) -> None:
        unit = "" if volume.unit == "mm" else f", unit={volume.unit!r}"
        held = _voxels_in_file(volume)
        if held is None:
            saved = self._load(name, data=volume.data, affine=volume.affine)
            voxels, affine = f'{saved}["data"]', f'{saved}["affine"]'
        else:
            file, order = held
            self._readers.add("read_volume")
            self._lines.append(f"{variable} = read_volume({str(volume.path)!r})")
            in_order = order == tuple(range(len(order)))
            if in_order and file.is_placed and _same(file.affine, volume.affine) and file.unit == volume.unit:
                return
            self._imports.add(_NUMPY)
            voxels = f"{variable}.data" if in_order else f"{variable}.data.transpose{order}"
            affine = f"np.array({volume.affine.tolist()!r})"
        self._readers.add("Volume")
        self._lines.append(f"{variable} = Volume({voxels}, {affine}{unit})")

    def _mesh(self, mesh: Mesh, name: str, variable: str) -> None:
        self._readers.add("Mesh")
        if _is_in_file(mesh):
            self._readers.add("read_mesh")
            self._lines.append(f"{variable} = read_mesh({str(mesh.path)!r})")
            points = f"{variable}.space.to_scanner({variable}.points)"
            self._lines.append(f"{variable} = Mesh({points}, {variable}.faces, {variable}.path{self._known(mesh)})")
            return
        path = ""
        if mesh.path is not None:  # the registered sphere may be in the same folder
            self._imports.add(_PATH)
            path = f", Path({str(mesh.path)!r})"
        saved = self._load(name, points=mesh.points, faces=mesh.faces)
        self._lines.append(f'{variable} = Mesh({saved}["points"], {saved}["faces"]{path}{self._known(mesh)})')

    def _known(self, mesh: Mesh) -> str:
        known = "" if mesh.structure is None else f", structure={mesh.structure!r}"
        if mesh.space.name != "scanner":
            return known
        self._readers.add("Space")
        return f'{known}, space=Space("scanner")'

    def _overlay(self, shown: Overlay) -> str:
        values = shown.values
        if shown.path is None or not _holds(shown.path, values):
            return self._array(values, shown.name)
        self._readers.add("read_overlay")
        self._lines.append(f"shown = read_overlay({str(shown.path)!r}, {len(values)}).astype({values.dtype.name!r})")
        return "shown"

    def _array(self, values: NDArray[Any], name: str) -> str:
        """Return an expression for an array, which is a literal if the array is short."""
        if values.size <= 12 and values.dtype.kind in "biuf" and np.isfinite(values).all():
            self._imports.add(_NUMPY)
            return f"np.array({values.tolist()!r}, dtype=np.{values.dtype.name})"
        return f'{self._load(name, values=values)}["values"]'

    def _map(self, flat_map: FlatMap) -> str:
        self.unsaved.append("the map to start from")
        file = Path(f"{file_name(self._title)}_start.voxflat")
        if self._folder is not None:
            file = self._folder.resolve() / file
            flat_map.save(file, overwrite=True)
        self._lines += ["# the map to start from", f"start = voxflat.load({str(file)!r})"]
        return "start"

    def _load(self, name: str, **arrays: NDArray[Any]) -> str:
        """Save arrays, and add code that loads them."""
        self._imports.add(_NUMPY)
        self.unsaved.append(name)
        file = Path(f"{file_name(name)}_{len(self.unsaved)}.npz")
        if self._folder is not None:
            file = self._folder.resolve() / file
            with atomic_path(file) as temporary, temporary.open("wb") as opened:
                np.savez_compressed(opened, **arrays)  # type: ignore[arg-type]  # of its other parameters
        variable = f"saved_{len(self.unsaved)}"
        self._lines += [f"# saved because no file contains {name!r}", f"{variable} = np.load({str(file)!r})"]
        return variable


class _Code(str):
    """A Python expression, as opposed to a string literal."""


def _voxels_in_file(volume: Volume) -> tuple[Volume, tuple[int, ...]] | None:
    """Return what the file of a layer contains, and the order of its axes in the layer, if the voxels are the same."""
    if volume.path is None or not volume.path.is_file():
        return None
    try:
        file = read_volume(volume.path)
    except (InputError, OSError):
        return None
    orders = [(*order, *range(3, file.data.ndim)) for order in itertools.permutations(range(3))]
    return next(((file, order) for order in orders if _same(file.data.transpose(order), volume.data)), None)


def _is_in_file(source: Mesh) -> bool:
    """Return whether the file of a layer contains the same data as the layer, which may have been edited."""
    if source.path is None or not source.path.is_file():
        return False
    try:
        mesh = read_mesh(source.path)
    except (InputError, OSError):
        return False
    return _same(mesh.space.to_scanner(mesh.points), source.points) and _same(mesh.faces, source.faces)


def _holds(path: Path, values: NDArray[Any]) -> bool:
    try:
        return _same(read_overlay(path, len(values)).astype(values.dtype), values)
    except (InputError, OSError):
        return False


def _same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def _fingerprints(job: Job | PatchesJob) -> list[str]:
    """Return hashes of all arrays of a job, because arrays may be edited in place."""
    arrays: list[Any] = []
    for part in (getattr(job, of.name) for of in fields(job)):
        part = part.volume if isinstance(part, Sampled) else part
        if isinstance(part, LayerVolume):
            arrays.append(part.data)
        elif isinstance(part, LayerMesh):
            arrays += [part.vertices, part.faces]
        else:
            arrays.append(part.values if isinstance(part, Overlay) else part)
    held = (np.ascontiguousarray(array) for array in arrays if isinstance(array, np.ndarray) and array.size)
    return [hashlib.sha256(array.reshape(-1).view(np.uint8).data).hexdigest() for array in held]
