"""`voxflat bids --template`: how wrong the flat map of a template is for each hemisphere of a study."""

import csv

import numpy as np
import pytest
import studies
from command_line import fail, succeed
from lab_runs import FEW

import voxflat

pytestmark = pytest.mark.slow  # makes several maps
TITLE = "Distance error on the template"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Return a folder of two subjects, and a template on the mesh of the subjects: its flat map and its sphere."""
    root = tmp_path_factory.mktemp("study")
    of = studies.hemisphere("lh", FEW)
    for number in (1, 2):
        studies.write_freesurfer(root / "subjects" / f"sub-{number:02}", "lh", studies.warped(of, number))
    made = voxflat.flatten((of["white"], of["faces"]), cuts="standard", sphere=(of["sphere"], of["faces"]))
    places = np.zeros((FEW, 3))
    places[made.ids, :2] = made.uv
    on_one_side = (places[made.ids, :2] == made.uv).all(axis=1)
    faces = made.ids[made.faces[on_one_side[made.faces].all(axis=1)]]
    files = root / "tpl.L.flat.surf.gii", root / "tpl.L.sphere.surf.gii"
    for path, points, triangles in zip(files, (places, of["sphere"]), (faces, of["faces"]), strict=True):
        voxflat.io.write_mesh(path, voxflat.io.Mesh(points, triangles))
    return root, *files


def run(root, level, *more):
    return succeed("bids", root / "subjects", root / "out", level, "--hemi", "left", *more)


def test_the_study_has_a_column_for_the_template(study):
    root, flat, sphere = study
    run(root, "participant")
    run(root, "group")
    assert TITLE not in (root / "out" / "group.html").read_text()
    assert "2 made" in run(root, "participant", "--template", flat, "--template-sphere", sphere).stdout
    run(root, "group")
    page = (root / "out" / "group.html").read_text()
    assert TITLE in page
    assert TITLE in (root / "out" / "sub-01.html").read_text()
    with (root / "out" / "group_desc-voxflat_measures.tsv").open() as table:
        rows = list(csv.DictReader(table, delimiter="\t"))
    for number, row in enumerate(rows, 1):
        surf = root / "subjects" / f"sub-{number:02}" / "surf"
        person = voxflat.surface(surf / "lh.white", pial=surf / "lh.pial")
        error = voxflat.measure(person, flat, reference="graph").best_scale.relative_error
        assert float(row["template.best_scale.relative_error"]) == pytest.approx(error, rel=1e-4)
        assert f"{100 * error:.1f}" in page


def test_wrong_templates_are_named(study):
    root, flat, sphere = study
    words = ("bids", root / "subjects", root / "out", "participant", "--hemi", "left", "--dry-run", "--template")
    fail(1, "Pass --template and --template-sphere", *words, flat)
    told = "--template has 0 files for the left hemisphere. Pass one file per hemisphere"
    assert told in succeed(*words, root / "flat.surf.gii", "--template-sphere", sphere).stdout
    missing = root / "other.L.flat.surf.gii"
    assert f"{missing}: the file does not exist" in succeed(*words, missing, "--template-sphere", sphere).stdout
