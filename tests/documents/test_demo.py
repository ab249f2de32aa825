import numpy as np
import pytest
from PIL import Image

import voxflat
from voxflat import demo

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    pytest.importorskip("nilearn", reason="the demo's data come with nilearn")
    lines = []
    directory = tmp_path_factory.mktemp("demo") / "new"
    return directory, demo.run(directory, tell=lines.append), "\n".join(lines)


def test_the_hemisphere_is_whole_and_its_map_is_fair(output):
    _, flat_map, _ = output
    assert len(flat_map) > 65_000
    assert flat_map.metadata["cut_names"] == ["calcarine", "medial 1", "medial 2", "medial 3", "temporal"]
    assert flat_map.distortion.best_scale.relative_error < 0.12
    triangles = flat_map.distortion.triangles
    assert (triangles.flipped, triangles.crossings, triangles.covering) == (0, 0, 0)


def test_everything_is_written_and_named(output):
    directory, flat_map, told = output
    for name in ("folds", "flat_image", "grey_matter", "heat_map", "scatter", "spectrum", "patch_3d"):
        picture = np.asarray(Image.open(directory / f"{name}.png").convert("RGB"))
        assert min(picture.shape[:2]) > 400
        assert picture.std() > 20  # not blank
        assert f"{name}.png" in told
    np.testing.assert_array_equal(voxflat.load(directory / "map.npz").uv, flat_map.uv)
    assert (directory / "summary.txt").read_text().strip() in told
    assert str(directory) in told


def test_a_directory_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError, match="demo"):
        demo.run(tmp_path / "file" / "demo")
