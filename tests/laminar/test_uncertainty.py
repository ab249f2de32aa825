"""Warnings say how much of a region is uncertain, and nothing about grey matter elsewhere."""

import numpy as np
import pytest
from command_line import succeed

import voxflat
from voxflat.io import write_volume


@pytest.fixture(scope="module")
def rim():
    """Return the rim of a flat bank 5 voxels thick, a sixth of which is 15 voxels thick."""
    labels = np.zeros((20, 36, 6), dtype=np.int16)
    labels[:2], labels[2:7], labels[7:] = 2, 3, 1
    labels[7:17, 30:] = 3
    return voxflat.rim(labels)


def warnings_of(caplog, call, *arguments, **options):
    """Return the warnings of a call."""
    caplog.clear()
    call(*arguments, **options)
    return [record.getMessage() for record in caplog.records]


def test_the_sound_part_of_a_rim_has_no_warning(rim, caplog):
    regions = np.zeros(rim.labels.volume.data.shape, dtype=np.int16)
    regions[:, :14] = 1
    assert not warnings_of(caplog, rim.profile, rim.labels.volume, regions)
    sound = rim.surface.disk((4, 6, 3), 4.0)
    assert not warnings_of(caplog, sound.flatten)
    flat_map = sound.flatten()
    assert not warnings_of(caplog, rim.paint, np.ones((3, *flat_map.raster().shape)), flat_map)


def test_warnings_give_the_share_of_their_own_region(rim, caplog):
    is_thick = rim.thickness().data > 2.5 * np.nanmedian(rim.thickness().data)
    is_grey = rim.labels.volume.data == 3

    def share(where):
        return f"the depth of {100 * is_thick[where & is_grey].mean():.1f} % of "

    regions = np.ones(is_grey.shape, dtype=np.int16)
    regions[:, 24:] = 2
    sound, thick = share(regions == 1), share(regions == 2)
    assert sound != thick
    found = warnings_of(caplog, rim.profile, rim.labels.volume, regions)
    assert [text.split(" is uncertain")[0] for text in found] == [thick + "the region 2"]
    assert "more than 2.5 times as thick as the median" in found[0]
    everywhere = share(is_grey) + "the grey matter is uncertain"
    for call in (rim.depth, rim.thickness, rim.streamlines):
        assert warnings_of(caplog, call)[0].startswith(everywhere)
    of_columns = warnings_of(caplog, rim.columns, 12)
    assert of_columns[-1].startswith(everywhere)
    flat_map = rim.surface.disk((9, 35, 3), 6.0).flatten()
    assert "the patch is uncertain" in flat_map.warnings[0]
    stack = np.ones((3, *flat_map.raster().shape))
    is_on = rim.paint(stack, flat_map).data > 0
    assert warnings_of(caplog, rim.paint, stack, flat_map)[0].startswith(share(is_on) + "the painted grey matter")


def test_columns_hold_their_share_of_uncertain_voxels(rim, caplog):
    columns = rim.columns(12)
    is_thick = rim.thickness().data > 2.5 * np.nanmedian(rim.thickness().data)
    for number, share in enumerate(columns.uncertain, start=1):
        assert share == is_thick[columns.volume.data == number].mean()
    mostly = (columns.uncertain > 0.5).sum()
    assert 0 < mostly < 12
    assert f"uncertain in {mostly} of 12 columns" in caplog.text


@pytest.mark.medium
def test_commands_warn_once_of_their_region(rim, tmp_path):
    path = tmp_path / "rim.nii.gz"
    write_volume(path, rim.labels.volume.data, np.eye(4))
    regions = np.zeros(rim.labels.volume.data.shape, dtype=np.int16)
    regions[:, :14] = 1
    write_volume(tmp_path / "regions.nii.gz", regions, np.eye(4))
    for arguments, count in (
        (("layers", path, "-n", 3, "-o", tmp_path / "layers.nii.gz"), 1),
        (("profile", path, "--volume", path, "--regions", tmp_path / "regions.nii.gz", "-o", tmp_path / "p.tsv"), 0),
        (("flatten", path, "--rim", "--seed-point", "4,6,3", "--radius", 4, "-o", tmp_path / "map.npz"), 0),
    ):
        assert succeed(*arguments).stderr.count("is uncertain") == count
