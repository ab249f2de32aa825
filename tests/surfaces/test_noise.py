"""A threshold within the noise: a warning comes before the long work, which shows its progress and can be cancelled."""

import logging
import re
import time
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

import voxflat
from voxflat.surfaces.noise import noise_in_surface

pytestmark = pytest.mark.slow


def volume():
    """Return noise of standard deviation 1, with a ball of radius 20 voxels that is brighter by 8."""
    x = np.indices((72, 72, 72)) - 36
    return np.random.default_rng(0).normal(0, 1, x.shape[1:]) + 8 * (np.sum(x**2, axis=0) < 400)


@pytest.mark.parametrize(("threshold", "told"), [(1.0, r"\d{5} parts, of which the largest .*\d %"), (0.0, r"\d{5} h")])
def test_noise_is_told_before_the_surface_is_sought(caplog, threshold, told):
    events, placed = [], []

    def progress(stage, done, total):
        events.append((stage, len(caplog.records)))
        placed.extend([done / total] * (stage == "placing the vertices"))
        return len(set(placed)) < 3

    with caplog.at_level(logging.WARNING, "voxflat"), pytest.raises(voxflat.Cancelled):
        voxflat.surface(volume(), threshold=threshold, progress=progress)
    (warning,) = [record.getMessage() for record in caplog.records]
    assert re.match(
        rf"the foreground has {told}.* may contain noise, whose surface takes long\. Check the label", warning
    )
    assert {told for stage, told in events if stage == "placing the vertices"} == {1}  # the warning came before
    assert 0 <= placed[0] < placed[-1] < 1  # several steps, until it was cancelled


def noise():
    """Return noise above 0.5, of millions of voxels."""
    return np.random.default_rng(0).random((200, 200, 200)), {"threshold": 0.5}


def large_ball():
    """Return a label of millions of voxels."""
    x = np.square(np.arange(-128, 128))
    return (x[:, None, None] + x[:, None] + x < 10_000).astype(np.int16), {}


@pytest.mark.parametrize("volume", [noise, large_ball])
def test_cancelling_takes_effect_before_the_surface_is_sought(volume):
    data, options = volume()

    def reports(last=None):
        """Return when the function begins, reports and ends, in seconds of computing, and the last stage."""
        times, stages = [time.process_time()], []  # the seconds of other programs do not count

        def progress(stage, done, total):
            times.append(time.process_time())
            stages.append(stage)
            return len(stages) != last and stage in ("preparing", "checking the foreground")

        with pytest.raises(voxflat.Cancelled):
            voxflat.surface(data, **options, progress=progress)
        return [*times, time.process_time()], stages[-1]

    times, _ = reports()
    silent = 1 + int(np.diff(times[:-1]).argmax())  # the worst moment to cancel is the beginning of the longest silence
    times, stage = reports(silent)
    assert stage in ("checking the foreground", "finding the surface")
    assert times[-1] - times[silent - 1] < 0.3  # about 0.1 s


def test_an_object_above_the_noise_causes_no_warning(caplog):
    voxflat.surface(volume(), threshold=5.0)
    assert "noise" not in caplog.text


@pytest.mark.parametrize("smoothing", [0.0, 1.0])
@pytest.mark.parametrize("threshold", [-1.0, 0.0, 1.0, 2.0])
def test_check_says_that_noise_may_be_noise(smoothing, threshold):
    noise = ndimage.gaussian_filter(np.random.default_rng(0).normal(0, 1, (36, 36, 36)), smoothing)
    found = voxflat.check(noise / noise.std(), threshold=threshold)
    assert re.search("may contain noise.*Check the label or threshold", found.noise)
    assert found.noise == found.advice[0]
    assert dict(found.rows())["can be flattened"] == "yes, but it may be noise"


REAL = [  # components, vertices used, handles and loops of real volumes: LayNii's rims and the MNI152 template
    ([22274, 51787 - 2483, *[1] * 2483], 22274, 1, 106),
    ([10432, *[40] * 876], 10432, 0, 14),
    ([38515, 20000, 2578], 38515, 0, 42),
    ([61045, 6, 6], 61045, 111, 0),
    ([171723, *[8] * 122], 171723, 138, 0),
    ([299963, *[14] * 412], 299963, 331, 0),
    ([231844, *[9] * 768], 231844, 248, 0),
]


@pytest.mark.parametrize("figures", REAL)
def test_real_volumes_cause_no_warning(figures):
    assert noise_in_surface(*figures) is None


def test_real_sheets_and_small_handles_cause_no_warning(caplog):
    torus = np.indices((21, 21, 9)) - np.reshape([10, 10, 4], (3, 1, 1, 1))
    solid = (np.hypot(torus[0], torus[1]) - 6) ** 2 + torus[2] ** 2 < 6
    for found in (
        voxflat.check(solid.astype(np.uint8)),
        voxflat.check(Path(__file__).parents[1] / "data" / "laynii" / "occipital_midGM.nii.gz", label=1),
    ):
        assert found.noise is None
        assert dict(found.rows())["can be flattened"] == "yes"
