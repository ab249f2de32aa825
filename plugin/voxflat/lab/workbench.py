"""Spec and scene files of Connectome Workbench, which open the maps of a participant in ``wb_view``."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from voxflat.lab.freshness import write_text
from voxflat.lab.layouts import HEMISPHERES, Finder
from voxflat.lab.results import Results, read_record

_TYPES = {
    ".surf.gii": "SURFACE",
    ".shape.gii": "METRIC",
    ".func.gii": "METRIC",
    ".label.gii": "LABEL",
    ".dscalar.nii": "CONNECTIVITY_DENSE_SCALAR",
    ".dtseries.nii": "CONNECTIVITY_DENSE_TIME_SERIES",
}
"""The types of files that Workbench opens, by ending."""

_STRUCTURES = {"L": ("CortexLeft", "CORTEX_LEFT"), "R": ("CortexRight", "CORTEX_RIGHT"), "": ("Invalid", "INVALID")}
"""The structures of files, in spec files and in scenes; CIFTI files have none."""

_SURFACES = ("white", "pial", "midthickness", "inflated")  # of a participant
_SIDES = {"L": "left", "R": "right"}
_SIZE = (1200, 600)  # pixels of the graphics of a scene


@dataclass(frozen=True)
class OpenedFile:
    """A file that Workbench opens."""

    path: Path
    letter: str = ""  # L, R, or empty for a file of both hemispheres

    @property
    def kind(self) -> str:
        """The type of the file in spec files and scenes."""
        return next(kind for ending, kind in _TYPES.items() if self.path.name.endswith(ending))

    @property
    def is_series(self) -> bool:
        """Whether the file is a time series, which can be too large to open unasked."""
        return self.path.name.endswith((".dtseries.nii", "_bold.func.gii"))


def write_workbench(stem: Path, found: Mapping[str, tuple[Results, Finder]]) -> None:
    """Write a spec and a scene file, whose names begin with `stem`, for the results of hemispheres, lh and rh.

    The spec lists the maps and their values, the surfaces of the participant, and the data on the same vertices, of
    which time series are not selected. The scene shows the maps side by side with the overlays, above the curvature.
    """
    files: dict[OpenedFile, None] = {}
    maps: dict[str, Path] = {}
    layers: dict[str, list[OpenedFile]] = {}
    for hemi, (results, find) in found.items():
        letter, record = HEMISPHERES[hemi][0], read_record(results.record)
        maps[letter] = results.surface
        files[OpenedFile(results.surface, letter)] = None
        values = {name: OpenedFile(results.folder / name, letter) for name in record["outputs"] if ".shape." in name}
        for name in (*record["overlays"], "curvature"):
            layers.setdefault(name, []).append(values[results.values(name).name])
        surfaces = (path for name in _SURFACES if (path := find.one(name)) is not None)
        files |= dict.fromkeys([*(OpenedFile(path, letter) for path in surfaces if _can_open(path)), *values.values()])
        data = [*find.all("grayordinates"), *find.all("bold")]
        files |= {OpenedFile(path, "" if _is_cifti(path) else letter): None for path in data if _can_open(path)}
    folder, listed = stem.parent, list(files)
    write_text(stem.with_suffix(".spec"), spec_text(listed, folder))
    shown = [file for file in listed if not file.is_series]
    name = f"{re.sub('_flat$', '', stem.name)}: flat maps"
    top = [file for of_name in layers.values() for file in of_name]
    write_text(stem.with_suffix(".scene"), scene_text(shown, maps, top, name, folder))


def _can_open(path: Path) -> bool:
    return path.name.endswith(tuple(_TYPES)) and path.is_file()


def _is_cifti(path: Path) -> bool:
    return path.name.endswith(".nii")


def spec_text(files: Iterable[OpenedFile], folder: Path) -> str:
    """Return a spec file in a directory, with paths relative to it."""
    root = Element("CaretSpecFile", Version="1.0")
    SubElement(root, "MetaData")
    for file in files:
        structure = _STRUCTURES[file.letter][0]
        entry = SubElement(root, "DataFile", Structure=structure, DataFileType=file.kind)
        entry.set("Selected", "false" if file.is_series else "true")
        entry.text = _relative(file.path, folder)
    return _document(root)


def scene_text(
    files: Sequence[OpenedFile], maps: Mapping[str, Path], layers: Sequence[OpenedFile], name: str, folder: Path
) -> str:
    """Return a scene file in a directory that shows flat maps side by side.

    `maps` contains the flat surfaces, keyed by L and R, and `layers` the values on them, from the top down.
    """
    brain = _object(
        "Brain",
        "m_brains",
        _object(
            "SpecFile",
            "specFile",
            _path("specFileName", ""),
            _array("dataFilesArray", _spec_entries(files, folder)),
        ),
        _array("models", [_montage(maps, layers, folder)]),
        _array("m_brainStructures", []),
    )
    tab = _object(
        "BrowserTabContent",
        "m_browserTabs",
        _value("integer", "m_tabNumber", "0"),
        _value("string", "m_userName", name),
        _value("enumeratedType", "m_selectedModelType", "MODEL_TYPE_SURFACE_MONTAGE"),
        version="7",
    )
    session = _object(
        "SessionManager",
        "m_sessionManager",
        _array("m_brains", [brain]),
        _array("m_browserTabs", [tab]),
        _map("browserWindowContentMap", _window()),
    )
    shown = _object(
        "BrainBrowserWindow",
        "m_brainBrowserWindows",
        _value("integer", "m_browserWindowIndex", "0"),
        _object(
            "BrainBrowserWindowToolBar",
            "m_toolbar",
            _numbers("tabIndices", 0),
            _value("integer", "selectedTabIndex", "0"),
            _value("boolean", "toolBarVisible", "true"),
        ),
        version="2",
    )
    return _scene_file(name, _object("GuiManager", "guiManager", session, _array("m_brainBrowserWindows", [shown])))


def _scene_file(name: str, content: Element) -> str:
    root = Element("SceneFile", Version="3")
    listed = SubElement(SubElement(root, "SceneInfoDirectory"), "SceneInfo", Index="0")
    scene = SubElement(root, "Scene", Index="0", Type="SCENE_TYPE_FULL")
    for element in (listed, scene):
        SubElement(element, "Name").text = name
        SubElement(element, "Description").text = "Flat maps by voxflat"
    scene.append(content)
    return _document(root)


def _spec_entries(files: Sequence[OpenedFile], folder: Path) -> list[Element]:
    return [
        _object(
            "SpecFileDataFile",
            "specFileDataFile",
            _value("enumeratedType", "dataFileType", file.kind),
            _value("enumeratedType", "structure", _STRUCTURES[file.letter][1]),
            _path("fileName", _relative(file.path, folder)),
            _value("boolean", "selected", "true"),
        )
        for file in files
    ]


def _montage(maps: Mapping[str, Path], layers: Sequence[OpenedFile], folder: Path) -> Element:
    """Return the model that shows flat surfaces side by side."""
    overlays = [
        _object(
            "Overlay",
            "m_overlays",
            _value("float", "m_opacity", "1"),
            _value("boolean", "m_enabled", "true"),
            _path("selectedMapFileNameWithPath", _relative(layer.path, folder)),
            _value("string", "selectedMapFile", layer.path.name),
            _value("string", "selectedMapName", ""),
            _value("integer", "selectedMapIndex", "0"),
        )
        for layer in layers
    ]
    surfaces = [
        _object(
            "SurfaceSelectionModel",
            f"m_{_SIDES[letter]}SurfaceSelectionModel",
            _path("m_selectedSurfacePathName", _relative(path, folder)),
        )
        for letter, path in maps.items()
    ]
    shown = [
        _value("boolean", f"m_{side}Enabled", "true" if letter in maps else "false") for letter, side in _SIDES.items()
    ]
    flat = _object(
        "SurfaceMontageConfigurationAbstract",
        "m_flatMapsConfiguration[0]",
        _value("enumeratedType", "m_layoutOrientation", "LANDSCAPE_LAYOUT_ORIENTATION"),
        _object(
            "OverlaySet",
            "m_overlaySet",
            _value("integer", "m_numberOfDisplayedOverlays", str(max(1, len(layers)))),
            _array("m_overlays", overlays),
        ),
        *surfaces,
        *shown,
        _value("boolean", "m_cerebellumEnabled", "false"),
    )
    kind = Element("ObjectMap", Type="enumeratedType", Name="m_selectedConfigurationType")
    SubElement(kind, "Value", Key="0").text = "FLAT_CONFIGURATION"
    return _object(
        "Model",
        "models",
        _value("enumeratedType", "m_modelType", "MODEL_TYPE_SURFACE_MONTAGE"),
        _value("integer", "montageVersion", "3"),
        kind,
        _map("m_cerebellarConfiguration"),  # without these two, Workbench ignores that of the flat maps
        _map("m_cerebralConfiguration"),
        _map("m_flatMapsConfiguration", flat),
    )


def _window() -> Element:
    width, height = map(str, _SIZE)
    return _object(
        "BrowserWindowContent",
        "m_browserWindowContent",
        _value("boolean", "m_validFlag", "true"),
        _value("boolean", "m_tileTabsEnabled", "false"),
        _value("integer", "m_sceneGraphicsWidth", width),
        _value("integer", "m_sceneGraphicsHeight", height),
        _value("integer", "m_sceneSelectedTabIndex", "0"),
        _numbers("m_sceneTabIndices", 0),
        version="2",
    )


def _object(kind: str, name: str, *members: Element, version: str = "1") -> Element:
    element = Element("Object", Type="class", Class=kind, Name=name, Version=version)
    element.extend(members)
    return element


def _value(kind: str, name: str, text: str) -> Element:
    element = Element("Object", Type=kind, Name=name)
    element.text = text
    return element


def _path(name: str, text: str) -> Element:
    return _value("pathName", name, text)


def _array(name: str, members: Sequence[Element]) -> Element:
    element = Element("ObjectArray", Type="class", Name=name, Length=str(len(members)))
    for n, member in enumerate(members):
        SubElement(element, "Element", Index=str(n)).append(member)
    return element


def _numbers(name: str, *numbers: int) -> Element:
    element = Element("ObjectArray", Type="integer", Name=name, Length=str(len(numbers)))
    for n, number in enumerate(numbers):
        SubElement(element, "Element", Index=str(n)).text = str(number)
    return element


def _map(name: str, *members: Element) -> Element:
    element = Element("ObjectMap", Type="class", Name=name)
    for key, member in enumerate(members):
        SubElement(element, "Value", Key=str(key)).append(member)
    return element


def _relative(path: Path, folder: Path) -> str:
    """Return a path relative to a directory, or as it is on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def _document(root: Element) -> str:
    ElementTree.indent(root, "    ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
