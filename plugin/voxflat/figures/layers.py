"""Write the layers of a figure to its SVG file, for Inkscape."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from matplotlib.figure import Figure

from voxflat.io.formats.svg import AXES, EXTENT

MAP = "map"  # label of the axes of a flat map, whose units are mm of the map

LAYERS = ("curvature", "data", "parcels", "names", "marks")  # from bottom to top; the gid of an artist names its layer

_INKSCAPE = "http://www.inkscape.org/namespaces/inkscape"


def name_layers(path: Path, drawn: Figure) -> None:
    """Sort the elements of a Matplotlib SVG file into layers by gid, and store the map position at the root."""
    text = path.read_text(encoding="utf-8")
    if not any(f'id="{name}"' in text for name in LAYERS):
        return
    head = re.match(r"(?s).*?(?=<svg)", text)
    root = _with_prefixes(text)
    root.set("xmlns:inkscape", _INKSCAPE)
    layers: dict[str, Any] = {}
    for name in ("background", *LAYERS):
        attributes = {"id": f"layer-{name}", "inkscape:groupmode": "layer", "inkscape:label": name}
        layers[name] = ElementTree.Element("g", attributes)
    for axes in drawn.axes:
        if axes.get_label() == MAP:
            box, (width, height) = axes.get_position(), 72 * drawn.get_size_inches()  # in points, y pointing down
            position = (box.x0 * width, (1 - box.y1) * height, box.width * width, box.height * height)
            root.set(AXES, " ".join(f"{value:.6g}" for value in position))
            root.set(EXTENT, " ".join(f"{value:.9g}" for value in (*axes.get_xlim(), *axes.get_ylim())))
    figure = next(child for child in root if child.get("id", "").startswith("figure"))
    _sort(figure, layers)
    place = list(root).index(figure)
    root.remove(figure)
    for layer in reversed([layer for layer in layers.values() if len(layer)]):
        root.insert(place, layer)
    body = ElementTree.tostring(root, encoding="unicode")
    path.write_text((head[0] if head else "") + body + "\n", encoding="utf-8", newline="\n")


def _with_prefixes(text: str) -> Any:
    """Parse XML, and keep the prefixes of names as they are; ElementTree has prefixes only for the whole process."""
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()


def _sort(group: Any, layers: dict[str, Any]) -> None:
    """Move each element into the layer that it names, and all other elements into the lowest layer."""
    for child in list(group):
        name = child.get("id", "")
        if name in layers:
            del child.attrib["id"]
            layers[name].append(child)
        elif name.startswith("axes"):
            _sort(child, layers)
        else:
            layers["background"].append(child)
