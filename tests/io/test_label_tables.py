"""Names and colours of labels: as independent writers put them into files."""

import nibabel as nib
import numpy as np
import pytest
from mesh_files import gifti
from refusals import refused

from voxflat.io import read_region
from voxflat.io.label_tables import LabelTable, own_table, read_table

NAMES = ["unknown", "bankssts", "Größe"]
COLOURS = [(25, 5, 25), (25, 100, 40), (220, 20, 100)]


def test_annot(tmp_path):
    path = tmp_path / "lh.aparc.annot"
    table, names = np.array([(*colour, 0, 0) for colour in COLOURS]), [name.encode() for name in NAMES]
    nib.freesurfer.write_annot(path, np.array([0, 1, 2, 2, 1]), table, names, fill_ctab=True)
    found = own_table(path)
    assert (found.names, found.colours) == (dict(enumerate(NAMES)), dict(enumerate(COLOURS)))
    assert [found.is_region(label) for label in (-1, 0, 1, 2)] == [False, False, True, True]


def test_gifti(tmp_path):
    def named(image):
        for key, (name, colour) in enumerate(zip(NAMES, COLOURS, strict=True)):
            label = nib.gifti.GiftiLabel(10 * key, *(part / 255 for part in colour), 1.0)
            label.label = name
            image.labeltable.labels.append(label)

    found = own_table(gifti(tmp_path / "lh.areas.label.gii", [(np.array([0, 10, 20], "i4"), "label")], named))
    assert found.names == dict(zip((0, 10, 20), NAMES, strict=True))
    assert found.colours == dict(zip((0, 10, 20), COLOURS, strict=True))


def test_the_empty_table_of_values_is_none(tmp_path):
    def stub(image):
        image.labeltable.labels.append(nib.gifti.GiftiLabel(0, 1, 1, 1, 0))
        image.labeltable.labels[0].label = "???"

    values, labels = np.array([0.5, -3.0], "f4"), np.array([0, 4], "i4")
    assert own_table(gifti(tmp_path / "lh.depth.shape.gii", [(values, "shape")], stub)) is None
    assert own_table(gifti(tmp_path / "lh.areas.label.gii", [(labels, "label")], stub)).names == {0: "???"}


def test_cifti_has_a_table_for_each_map(tmp_path):
    axes = nib.cifti2.cifti2_axes
    tables = [{0: ("???", (0, 0, 0, 0)), 3: ("V1", (1.0, 0.2, 0.0, 1.0))}, {3: ("other", (0.0, 0.0, 1.0, 1.0))}]
    models = axes.BrainModelAxis.from_surface([0, 1, 2], 4, "CortexLeft")
    image = nib.Cifti2Image(np.array([[3.0, 0, 3], [3, 3, 3]]), (axes.LabelAxis(["a", "b"], tables), models))
    path = tmp_path / "areas.dlabel.nii"
    nib.save(image, path)
    assert own_table(path).colours[3] == (255, 51, 0)
    assert own_table(path, 1).names == {3: "other"}


def test_a_region_of_a_cifti_file_has_a_name(tmp_path):
    axes = nib.cifti2.cifti2_axes
    labels = axes.LabelAxis(
        ["a"], [{0: ("???", (0, 0, 0, 0)), 3: ("V1", (1.0, 0.2, 0.0, 1.0)), 4: ("V2", (0, 0, 1, 1))}]
    )
    models = axes.BrainModelAxis.from_surface([0, 1, 2], 4, "CortexLeft")
    path = tmp_path / "areas.dlabel.nii"
    nib.save(nib.Cifti2Image(np.array([[3.0, 4, 3]]), (labels, models)), path)
    assert read_region(path, 4, name="V1").tolist() == [True, False, True, False]
    refused("'V3' is not one of its labels. Choose one of .*V1, V2", read_region, path, 4, name="V3")


def test_what_has_no_table(tmp_path):
    nib.save(nib.Nifti1Image(np.zeros((3, 3, 3), "u1"), np.eye(4)), tmp_path / "labels.nii.gz")
    nib.freesurfer.write_morph_data(tmp_path / "lh.thickness", np.zeros(5))
    assert own_table(tmp_path / "labels.nii.gz") is own_table(tmp_path / "lh.thickness") is None
    assert [LabelTable().is_region(label) for label in (-1, 0, 1)] == [False, False, True]


def test_the_lookup_table_of_freesurfer(tmp_path):
    path = tmp_path / "FreeSurferColorLUT.txt"
    path.write_text("#$Id$\n\n#No. Label Name:   R G B A\n0   Unknown   0 0 0 0\n17  Left-Hippocampus  220 216 20 0\n")
    found = read_table(path)
    assert (found.names[17], found.colours[17]) == ("Left-Hippocampus", (220, 216, 20))
    assert not found.is_region(0)


def test_the_tsv_of_bids(tmp_path):
    path = tmp_path / "atlas_dseg.tsv"
    path.write_text("index\tname\tabbreviation\tcolor\n1\tGray Matter\tGM\t#ff53bb\n2\tno colour\tn\tn/a\n")
    found = read_table(path)
    assert found.names == {1: "Gray Matter", 2: "no colour"}
    assert found.colours == {1: (255, 83, 187)}


WRONG = {"1 name 1 2": "line 1", "1 name 1 2 300": "label 1 has the colour", "# nothing": "no labels"}
WRONG |= {"label\tname\n1\tx": "index and name", "index\tname\nx\ty": "table"}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_no_table_is_refused(tmp_path, text):
    path = tmp_path / ("a.tsv" if "\t" in text else "a.txt")
    path.write_text(text + "\n")
    refused(WRONG[text], read_table, path)
