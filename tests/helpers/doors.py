"""The doors to flattening: Python, the command line, PyVista, a VTK filter, and napari's window.

Each door has `takes`, the options that it offers, and is called with a kind of source and options by their Python
names. It returns an `Outcome`, or None if it offers no such value.
"""

from dataclasses import dataclass, fields

import composed
import numpy as np
import pyvista as pv
from command_line import run as command
from mesh_files import grid

import voxflat
from voxflat._pyvista.options import FlattenOptions
from voxflat.cli import main
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.methods import METHODS

SIZE = 11  # of the sources, points or voxels along each side
OF_METHODS = {one.name for kind in METHODS.values() for one in fields(kind)}
_I, _J = np.indices((SIZE, SIZE))
_HEIGHT = 3 * np.sin(_I / 3) * np.cos(_J / 4) + 0.02 * _I * _J


@dataclass(frozen=True)
class Outcome:
    """A map, or the text of a refusal."""

    uv: np.ndarray | None = None
    ids: np.ndarray | None = None
    refusal: str | None = None

    def __str__(self):
        return f"a map of {len(self.ids)} points" if self.refusal is None else f"refused: {self.refusal}"

    def same(self, other):
        """Return whether both are refusals, or have the same bits."""
        if self.refusal is not None or other.refusal is not None:
            return self.refusal is not None and other.refusal is not None
        return self.uv.tobytes() == other.uv.tobytes() and np.array_equal(self.ids, other.ids)


def mesh(lift=0.0):
    return grid(SIZE, (_HEIGHT + lift).ravel(), step=2.0)


def _sheet():
    labels = np.zeros((SIZE, SIZE, SIZE), dtype=np.uint8)
    labels[_I[1:-1, 1:-1], _J[1:-1, 1:-1], np.round(5 + _HEIGHT / 3).astype(int)[1:-1, 1:-1]] = 3
    return labels


SOURCES = {"mesh": mesh(), "labels": _sheet(), "intensities": _sheet() / np.float32(3)}


def of_array(values):
    """Return the outcome of work whose result is an array."""
    return Outcome(np.ascontiguousarray(values, dtype=np.float64), np.arange(len(values)))


def tried(work):
    """Return what some work returns as an array, or its refusal."""
    try:
        return of_array(work())
    except voxflat.InputError as error:
        return Outcome(refusal=str(error))


def filtered(make, source):
    """Run a filter of VTK, and return its output, or its refusal."""
    told = []
    try:
        one = make()
    except voxflat.InputError as error:  # of a method
        return Outcome(refusal=str(error))
    one.AddObserver("ErrorEvent", _Text(told))
    one.SetInputData(dataset(source))
    one.Update()
    assert not told or one.GetOutput().GetNumberOfPoints() == 0
    return Outcome(refusal=told[0]) if told else pv.wrap(one.GetOutput())


def _outcome(flat_map):
    return Outcome(np.asarray(flat_map.uv), np.asarray(flat_map.ids))


class Python:
    """`voxflat.surface`, the methods that choose a part, and `Surface.flatten`."""

    takes = None  # all

    def __call__(self, source, given):
        try:
            return _outcome(composed.flatten(SOURCES.get(source, source), **given))
        except voxflat.InputError as error:
            return Outcome(refusal=str(error))


class CommandLine:
    """A command, by default `voxflat flatten`, on files."""

    def __init__(self, folder, name="flatten"):
        self._folder, self._name = folder, name
        self._options = {option.name: option for option in main.get_command(None, name).params}
        self.takes = set(self._options)
        self._files = {name: self._write(name, source) for name, source in SOURCES.items()}

    def __call__(self, source, given):
        output = self._folder / "map.npz"
        return self.run(source, [], given, ["-o", output], lambda _: _outcome(voxflat.load(output)))

    def run(self, source, arguments, given, more, read):
        """Run the command with arguments, options and more words, and return what `read` makes of its output."""
        words = [word for name, value in given.items() for word in self._words(name, value)]
        result = command(self._name, self._files.get(source, source), *arguments, *words, *more)
        if result.exit_code == 0:
            return read(result.stdout)
        assert result.exit_code in (1, 2), result.output
        assert isinstance(result.exception, SystemExit), result.exception
        return Outcome(refusal=result.stderr.strip().splitlines()[-1])

    def _words(self, name, value):
        """Return an option as words."""
        option = self._options["relax_length" if name == "relax" and type(value) in (int, float) else name]
        flag = option.opts[-1]
        if isinstance(value, bool):
            off = option.secondary_opts
            return [flag] if value else [off[-1]] if off else []
        if isinstance(value, np.ndarray):
            return [flag, self._write(name, value)]
        if name == "cuts" and isinstance(value, list):
            return [word for number, path in enumerate(value) for word in (flag, self._write(f"cut{number}", path))]
        if isinstance(value, Mesh):
            return [flag, self._write(name, value)]
        return [flag, ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)]

    def _write(self, name, value):
        """Write a mesh, a volume, a FreeSurfer label, or a list of vertices."""
        if isinstance(value, Mesh):
            path = self._folder / f"{name}.vtp"
            if not path.exists():
                write_mesh(path, value)
        elif value.ndim == 3:
            path = self._folder / f"{name}.npy"
            np.save(path, value)
        else:
            path = self._folder / f"{name}{'.label' if name in ('keep', 'drop') else '.txt'}"
            rows = [f"{one} 0 0 0 0" if path.suffix == ".label" else str(one) for one in value.tolist()]
            header = ["#!ascii label", str(len(rows))] if path.suffix == ".label" else []
            path.write_text("\n".join([*header, *rows]) + "\n")
        return path


class PyVista:
    """``mesh.voxflat.flatten`` on a mesh or an image."""

    takes = frozenset({*FlattenOptions.__annotations__, *OF_METHODS})

    def __call__(self, source, given):
        try:
            return _outcome(dataset(source).voxflat.flatten(**composed.with_method(given)))
        except voxflat.InputError as error:
            return Outcome(refusal=str(error))


class Filter:
    """`voxflat.vtk.FlattenSurface` in a pipeline."""

    takes = frozenset({*voxflat.vtk.FlattenSurface.options(), *OF_METHODS})

    def __call__(self, source, given):
        flat = filtered(lambda: voxflat.vtk.FlattenSurface(**composed.with_method(given)), source)
        if isinstance(flat, Outcome):
            return flat
        ids = flat["vertex_ids" if source == "mesh" else "voxel_ids"]
        return Outcome(np.ascontiguousarray(flat.points[:, :2]), np.asarray(ids))


class _Text:
    """An observer of VTK that receives the text of an error."""

    CallDataType = "string0"

    def __init__(self, told):
        self._told = told

    def __call__(self, _caller, _event, text):
        self._told.append(text)


def dataset(source):
    """Return a source, or a file, as a dataset of PyVista."""
    if source not in SOURCES:
        return pv.read(source)
    if source == "mesh":
        return pv.PolyData.from_regular_faces(SOURCES[source].points, SOURCES[source].faces)
    image = pv.ImageData(dimensions=SOURCES[source].shape)
    image["values"] = SOURCES[source].ravel(order="F")
    return image


class Napari:
    """The form *Flatten surface* of a window, whose fields are set as a user sets them."""

    def __init__(self, viewer, widget, qtbot):
        self._viewer, self._widget, self._qtbot = viewer, widget, qtbot
        self._form = widget.form
        self._fields = {"method": self._form.method, "radius": self._form.radius, "threshold": self._form.threshold}
        self._fields |= {"seed": self._form.options.seed, **self._form.options.fields}
        self.takes = {"label", "keep", "seed_point", "polygon", "pial", *self._fields}

    def __call__(self, source, given):
        from napari_window import PATIENCE

        self._viewer.layers.clear()
        layer = self._added(source)
        self._form.surface.choose(layer)
        before = {name: self._value(field) for name, field in self._fields.items()}
        self._form.patch.setCurrentIndex(0)
        try:
            if type(layer).__name__ == "Labels":
                self._qtbot.waitUntil(lambda: self._form.label.label == 3, timeout=PATIENCE)
            if not all(self._is_set(layer, name, value) for name, value in given.items()):
                return None
            return self._ran()
        finally:
            for name, value in before.items():
                self._set(self._fields[name], value)

    def _added(self, source):
        viewer = self._viewer
        if source not in SOURCES:
            from napari_window import open_file

            (layer,) = open_file(viewer, self._qtbot, source)
            return layer
        made = SOURCES[source]
        if source == "mesh":
            return viewer.add_surface((made.points, made.faces), name=source)
        return (viewer.add_labels if source == "labels" else viewer.add_image)(made, name=source)

    def _ran(self):
        """Click *Flatten surface*, wait, and return the newest map, or the text under the button."""
        from napari_window import run

        from voxflat._napari.viewer_state import ViewerState

        earlier = ViewerState.of(self._viewer).current
        run(self._widget, self._qtbot)
        current = ViewerState.of(self._viewer).current
        if current is None or current is earlier:
            return Outcome(refusal=self._widget.status.text())
        return _outcome(current.flat_map)

    def _is_set(self, layer, name, value):
        """Set an option, and return whether the form could hold the value."""
        form, viewer = self._form, self._viewer
        is_mesh = layer.name == "mesh"
        if name in self._fields:
            field = self._fields[name]
            is_there = name not in form.options.fields or field.isVisibleTo(form.options)
            return is_there and self._set(field, value) and (name != "threshold" or layer.name == "intensities")
        if name == "label":
            if layer.name != "labels" or form.label.findData(value) < 0:
                return False
            form.label.choose(value)
        elif name == "pial":
            above = viewer.add_surface((value.points, value.faces), name="pial")
            if not is_mesh:
                return False
            form.pial.choose(above)
        elif name == "keep" and is_mesh:
            if not np.all((value >= 0) & (value < len(layer.vertices))):
                return False
            layer.data = (*layer.data[:2], np.isin(np.arange(len(layer.vertices)), value).astype(float))
            self._choose_part("values")
        elif name == "keep":
            mask = viewer.add_labels(value, name="mask")
            self._choose_part("mask")
            if mask not in form.masked_by._layers:
                return False
            form.masked_by.choose(mask)
        elif name == "seed_point":
            if is_mesh and not 0 <= value < len(layer.vertices):
                return False
            self._choose_part("disk")
            form.seed.set_point(value)
        elif name == "polygon":
            if not np.all((value >= 0) & (value < len(layer.vertices))):
                return False
            points = viewer.add_points(np.asarray(layer.vertices)[value], name="corners")
            self._choose_part("polygon")
            form.polygon.choose(points)
        return True

    def _choose_part(self, part):
        self._form.patch.setCurrentIndex(self._form.patch.findData(part))

    @staticmethod
    def _value(field):
        if hasattr(field, "currentData"):
            return field.currentData()
        return field.isChecked() if hasattr(field, "isChecked") else field.value()

    @classmethod
    def _set(cls, field, value):
        """Set a field, and return whether it holds the value."""
        if hasattr(field, "currentData"):
            field.setCurrentIndex(max(index := field.findData(value), 0))
            return index >= 0
        if hasattr(field, "isChecked"):
            field.setChecked(bool(value))
            return True
        try:
            field.setValue(value)
        except (TypeError, OverflowError):  # of Qt
            return False
        special = getattr(field, "specialValueText", str)()  # shown instead of the lowest value, which it is not
        return bool(cls._value(field) == value) and not (special and value == field.minimum())
