"""Names from files are text in every medium, checked by independent readers."""

import csv
import logging
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import nibabel as nib
import numpy as np
import pytest
import tifffile
from matplotlib.text import Text

import voxflat
from voxflat import figures
from voxflat.figures.names import text_size
from voxflat.io.files import file_name
from voxflat.io.formats.gifti import value_bytes
from voxflat.io.label_tables import LabelTable
from voxflat.io.tables import read_points
from voxflat.maps.drawn_regions import Outline, _drawn
from voxflat.maps.parcels import Parcels

HOSTILE = {
    "formula": r"$\frac{1}{2}$",
    "broken formula": r"$\frac{$",
    "one dollar": "US$",
    "escaped dollar": r"a\$b$",
    "control": "a\x00b\x0bc\x1bd",
    "lines": "a\tb\r\nc\u2028d",
    "surrogate": "latin\udce9",
    "tags": "<b onload=x>&amp;</b><script>alert(1)</script>]]>",
    "quotes": "\"a\", 'b',c;=1+1",
    "path": "../../etc/passwd",
    "underscore": "_hidden",
    "long": "M" * 3000,
    "words": "word " * 600,
    "right to left": "قشرة",
}
SHOWN = {"control": "a�b c�d", "lines": "a b  c d", "surrogate": "latin�"}


@pytest.fixture(scope="module")
def flat():
    return voxflat.samples.hill().flatten()


def texts(figure):
    return [text.get_text().replace(r"\$", "$") for text in figure.findobj(Text)]


def expected(kind):
    return SHOWN.get(kind, HOSTILE[kind])


@pytest.mark.slow
@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("ending", [".svg", ".pdf", ".png"])
def test_figures_show_names_as_text(flat, kind, ending, tmp_path, caplog):
    name = HOSTILE[kind]
    overlay = figures.Overlay(flat.points[:, 2], label=name)
    parcels = Parcels(flat, np.ones(len(flat), dtype=np.int64), LabelTable({1: name}))
    with caplog.at_level(logging.WARNING, logger="voxflat"):
        figure = figures.flat_map(flat, overlay, title=name, parcels=parcels)
    found = texts(figure)
    assert max(map(len, found + caplog.messages)) < 300
    if kind not in ("long", "words", "lines"):  # these are shortened, or consist of lines
        assert expected(kind) in found
    figures.save(figure, tmp_path / f"figure{ending}")
    if ending == ".svg":
        root = ElementTree.parse(tmp_path / "figure.svg").getroot()
        found = ["".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")]
        assert kind in ("long", "words", "lines") or expected(kind) in found
        assert not list(root.iter("{http://www.w3.org/2000/svg}script"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", HOSTILE)
def test_profiles_and_heat_maps_show_names_as_text(flat, kind, tmp_path):
    rim = voxflat.rim(voxflat.samples.rim())
    drawn = figures.profile(rim.profile(rim.thickness(), count=3), label=HOSTILE[kind])
    compared = figures.heat_maps(voxflat.compare(voxflat.samples.hill(), {HOSTILE[kind]: flat}, sources=5))
    for figure in (drawn, compared):
        figures.save(figure, tmp_path / "figure.svg")
        ElementTree.parse(tmp_path / "figure.svg")
        assert max(map(len, texts(figure))) < 200


def test_a_formula_takes_the_room_of_its_letters():
    assert text_size("", 10)[0] == text_size(" ", 10)[0] < text_size("a", 10)[0]
    assert text_size("$aaaaaaaaaaaa$", 10)[0] > text_size("aaaaaaaaaaaa", 10)[0]


@pytest.mark.parametrize("kind", HOSTILE)
def test_regions_keep_their_names_in_every_format(flat, kind, tmp_path):
    name = HOSTILE[kind]
    square = (np.array([[0, 0], [6, 0], [6, 6], [0, 6.0]]) + flat.uv.mean(axis=0),)
    regions = _drawn(flat, [Outline(name, square)])
    for ending in (".tsv", ".csv", ".annot", ".label.gii", ".label"):
        regions.save(tmp_path / f"regions{ending}")
    for ending, delimiter in ((".tsv", "\t"), (".csv", ",")):
        with open(tmp_path / f"regions{ending}", newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file, delimiter=delimiter))
        assert [len(row) for row in rows] == [len(rows[0])] * 2
        assert expected(kind) in rows[1]
        assert len(Path(file.name).read_text("utf-8").splitlines()) == 2
    assert nib.freesurfer.read_annot(tmp_path / "regions.annot")[2][1].decode().split() == expected(kind).split()
    table = nib.load(tmp_path / "regions.label.gii").labeltable.get_labels_as_dict()
    assert table[1].split() == expected(kind).split()
    assert len(nib.freesurfer.read_label(tmp_path / "regions.label")) > 0


@pytest.mark.parametrize("kind", HOSTILE)
def test_values_and_channels_keep_their_names(flat, kind, tmp_path):
    (tmp_path / "values.func.gii").write_bytes(value_bytes({HOSTILE[kind]: flat.curvature}, "CortexLeft"))
    image = nib.load(tmp_path / "values.func.gii")
    assert image.darrays[0].meta["Name"].split() == expected(kind).split()
    channels = np.column_stack([flat.curvature, flat.points[:, 2]])
    stack = flat.images(channels, 2.0, name=HOSTILE[kind])
    stack.save(tmp_path / "stack.ome.tif")
    with tifffile.TiffFile(tmp_path / "stack.ome.tif") as file:
        ElementTree.fromstring(file.ome_metadata)
        assert tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Name"].split() == expected(kind).split()


@pytest.mark.parametrize("kind", HOSTILE)
def test_pages_show_names_as_text(flat, kind, tmp_path):
    voxflat.map_page(flat, HOSTILE[kind]).save(tmp_path / "page.html")

    class Reader(HTMLParser):
        heading, scripts, path = "", 0, ()

        def handle_starttag(self, tag, attributes):
            self.path = (*self.path, tag)
            self.scripts += tag == "script"

        def handle_data(self, data):
            if "h1" in self.path[-1:]:
                self.heading += data

    usual, found = Reader(), Reader()
    usual.feed(voxflat.map_page(flat, "usual").html)
    found.feed((tmp_path / "page.html").read_text("utf-8"))
    assert found.scripts == usual.scripts
    assert usual.heading.strip() == "usual"
    assert found.heading.split() == expected(kind).split()


@pytest.mark.parametrize("kind", HOSTILE)
def test_file_names_are_made_from_names(kind, tmp_path):
    path = tmp_path / f"{file_name(HOSTILE[kind])}.tsv"
    assert path.resolve().parent == tmp_path.resolve()
    path.write_text("x", encoding="utf-8")


def test_reserved_and_empty_file_names_are_changed():
    assert [file_name(name) for name in ("", ".", "..", "con", "NUL.txt", "lh.V1 (left)")] == [
        "_",
        "_",
        "_",
        "_con",
        "_NUL.txt",
        "lh.V1_left_",
    ]


def test_a_table_of_points_keeps_its_rows(tmp_path):
    (tmp_path / "points.tsv").write_text("name\tx\ty\tz\na\x0bb\t1\t2\t3\n", encoding="utf-8")
    assert len(read_points(tmp_path / "points.tsv").rows) == 1


@pytest.mark.medium
@pytest.mark.parametrize("folder", ["/home/ann/secret/", "C:\\Users\\ann\\", "~/"])
def test_a_path_that_names_a_map_is_no_label_of_a_colour_bar(flat, folder, tmp_path):
    values = {f"{folder}zstat1.nii.gz": flat.curvature, "other": flat.curvature}
    (tmp_path / "values.func.gii").write_bytes(value_bytes(values, None))
    figure = figures.flat_map(flat, figures.Overlay(tmp_path / "values.func.gii", channel=0))
    assert "values.func.gii, zstat1.nii.gz" in texts(figure)
