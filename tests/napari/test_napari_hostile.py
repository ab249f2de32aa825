"""Files from strangers, opened in one window: it lives to the end, and what is whole is opened after them."""

import random

import pytest
from fuzz_files import corpus, damaged
from napari_window import open_file, wait_for_threads

pytestmark = pytest.mark.slow  # a window

ENDINGS = (".gii", ".gii.gz", ".white", ".vtp", ".ply", ".stl", "map.npz", ".voxflat")
"""Of what napari opens by voxflat alone."""


def test_the_window_lives_to_the_end(make_napari_viewer, qtbot, tmp_path, messages):
    entries = corpus(tmp_path / "corpus", ENDINGS)
    assert len(entries) > 8
    viewer, refused = make_napari_viewer(), 0
    for number, entry in enumerate(entries):
        path, _ = damaged(entry, entries, tmp_path / "case", random.Random(str(number)))
        try:
            refused += not open_file(viewer, qtbot, path)
        except ValueError:  # napari's own, where the reader does not know the file for one of its
            refused += 1
        viewer.layers.clear()
    assert refused > len(entries) // 2
    whole = next(entry for entry in entries if entry.main == "s.vtp")
    assert len(open_file(viewer, qtbot, whole.folder / whole.main)[0].data[0]) == 64
    wait_for_threads(qtbot)
    messages.clear()
