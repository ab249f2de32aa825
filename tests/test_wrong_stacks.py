"""Wrong input from microscopes ends in one line: other units, missing sizes and channels, damage, touching organs."""

import hashlib
import logging
import re

import h5py
import nibabel as nib
import numpy as np
import pytest
import tifffile
from command_line import fail, succeed
from matplotlib.backends.backend_agg import FigureCanvasAgg
from mesh_files import grid, icosphere
from refusals import refused

import voxflat
from voxflat.figures import Overlay
from voxflat.io import Mesh, write_mesh
from voxflat.methods import Voxflat

pytestmark = pytest.mark.medium

SHAPE, SIZE, RADIUS = (50, 30, 30), 0.5, 4.6  # voxels; µm
CENTRES = np.array([[7.5, 7.5, 7.5], [16.25, 7.5, 7.5]])  # µm, of two balls that touch


def balls():
    """Return a mask of each ball; the second one ends where the first begins."""
    places = np.moveaxis(np.indices(SHAPE), 0, -1) * SIZE
    first, second = (np.linalg.norm(places - centre, axis=-1) < RADIUS for centre in CENTRES)
    return first, second & ~first


def imagej(path, data, unit="um"):
    how = {"metadata": {"spacing": SIZE, "unit": unit, "axes": "ZYX"}, "resolution": (1 / SIZE, 1 / SIZE)}
    tifffile.imwrite(path, np.asarray(data, np.uint8).T, imagej=True, **how)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write volumes of a ball in several units, and maps of it from a volume and from a mesh."""
    folder = tmp_path_factory.mktemp("stacks")
    ball, other = balls()
    imagej(folder / "ball.tif", ball)
    imagej(folder / "fused.tif", ball | other)
    imagej(folder / "labels.tif", ball + 2 * other)
    imagej(folder / "apart.tif", ball | np.roll(other, 2, axis=0))
    imagej(folder / "empty.tif", 0 * ball)
    tifffile.imwrite(folder / "plain.tif", ball.astype(np.uint8).T)
    tifffile.imwrite(folder / "cropped.tif", ball[:, :, 3:].astype(np.uint8).T)
    nib.save(nib.Nifti1Image(ball.astype(np.uint8), np.diag([SIZE, SIZE, SIZE, 1])), folder / "mm.nii")
    points, faces = icosphere(RADIUS, 3)
    write_mesh(folder / "ball.ply", Mesh(points + CENTRES[0], faces))
    method = Voxflat(sources=30)
    voxflat.surface(folder / "ball.tif").flatten(method).save(folder / "um.npz")
    voxflat.surface(folder / "mm.nii").flatten(method).save(folder / "mm.npz")
    voxflat.surface(folder / "ball.ply", unit="µm").flatten(method).save(folder / "mesh.npz")
    return folder


@pytest.mark.parametrize(
    ("flat_map", "volume", "told"),
    [
        (
            "um.npz",
            "mm.nii",
            "has voxels that are larger than the map. Compare their positions and units; the map is in µ",
        ),
        ("mesh.npz", "mm.nii", "has voxels that are larger than the map."),
        (
            "mm.npz",
            "ball.tif",
            "does not overlap the map, so the image would be empty. Compare their positions and units",
        ),
        (
            "mesh.npz",
            "plain.tif",
            "the volume does not define the size and position of its voxels, nor does the map of",
        ),
        (
            "um.npz",
            "cropped.tif",
            "has shape (50, 30, 27) and no affine, but the flattened volume has shape (50, 30, 30)",
        ),
    ],
)
def test_volumes_in_other_units_or_without_a_size(files, tmp_path, flat_map, volume, told):
    fail(1, told, "image", files / flat_map, "--volume", files / volume, "-o", tmp_path / "image.tif")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(voxflat.errors.InputError):
        voxflat.load(files / flat_map).image(files / volume)


def test_a_volume_with_transposed_axes_is_named_as_such(tmp_path):
    labels = np.pad(voxflat.samples.ball(), ((0, 0), (0, 6), (40, 0)))
    flat_map = voxflat.surface(voxflat.io.Volume(labels, np.eye(4))).disk((4, 12, 52), 6).flatten()
    shape = "has 64 x 30 x 24 voxels along x, y and z, but the flattened volume has 24 x 30 x 64. Save it with the axes"
    with pytest.raises(voxflat.InputError, match=f"does not overlap the map.* It {shape} of the flattened volume"):
        flat_map.image(voxflat.io.Volume(labels.T, np.eye(4)))
    assert np.isfinite(flat_map.image(voxflat.io.Volume(labels.T, np.eye(4)[[2, 1, 0, 3]])).data).any()
    away = np.diag([1.0, 1, 1, 1])
    away[0, 3] = 100
    with pytest.raises(voxflat.InputError, match=r"would be empty\. Compare their positions and units"):
        flat_map.image(voxflat.io.Volume(labels, away))


def test_the_same_volume_in_the_same_unit_is_sampled(files):
    for flat_map, volume in (
        ("um.npz", "ball.tif"),
        ("um.npz", "plain.tif"),
        ("mm.npz", "mm.nii"),
        ("mesh.npz", "ball.tif"),
    ):
        shown = voxflat.load(files / flat_map).image(files / volume, interpolation="linear").data
        assert np.nanmean(np.abs(shown - 0.5)) < 0.3


def test_a_stack_without_a_size_is_reported(files, tmp_path):
    result = succeed("surface", files / "plain.tif", "-o", tmp_path / "ball.ply")
    assert (
        "plain.tif does not define the size of its voxels, which is assumed to be 1 mm. Pass --spacing" in result.stderr
    )
    fail(1, "defines its voxel size in µm. Omit --unit", "check", files / "ball.tif", "--unit", "mm")


@pytest.mark.parametrize("ending", [".tif", ".h5", ".ome.zarr"])
def test_check_names_no_anatomical_directions_of_a_stack(ending, tmp_path):
    ball, path = (voxflat.samples.ball() > 0).astype(np.uint8), tmp_path / f"ball{ending}"
    if ending == ".tif":
        imagej(path, ball)
    elif ending == ".h5":
        with h5py.File(path, "w") as file:
            file["data"] = ball.T
    else:
        zarr = pytest.importorskip("zarr", minversion="3")
        group, axes = zarr.open_group(path, mode="w", zarr_format=2), ("z", "y", "x")
        group.create_array("0", data=ball.T)
        scale = [{"type": "scale", "scale": [SIZE] * 3}]
        axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in axes]
        described = {"version": "0.4", "axes": axes, "datasets": [{"path": "0", "coordinateTransformations": scale}]}
        group.attrs["multiscales"] = [described]
    surface = voxflat.surface(path)
    found = [voxflat.check(path), surface.check(), surface.disk((4, 12, 12), 2.5).check()]
    texts = [one.table() for one in found] + [succeed("check", path, *more).output for more in ((), ("--smooth", 2))]
    for text in texts:
        assert not re.search("RAS|orientation|anterior|superior", text)
        assert "µm" in text or ending == ".h5"  # which has no unit
    assert sum("x, y and z of the volume, without anatomical directions" in text for text in texts) == 3


@pytest.fixture(scope="module")
def probabilities(tmp_path_factory):
    """Write the probability of a ball as the second channel of a stack, and alone."""
    folder = tmp_path_factory.mktemp("probabilities")
    away = np.linalg.norm(np.moveaxis(np.indices((24, 24, 24)), 0, -1) - 12, axis=-1)
    inside = (1 / (1 + np.exp(away - 8.2))).astype(np.float32)
    about = {"metadata": {"axes": "CZYX", "Channel": {"Name": ["background", "cell"]}}, "ome": True}
    tifffile.imwrite(folder / "two.ome.tif", np.stack([1 - inside, inside]), **about)
    np.save(folder / "one.npy", inside.T)
    np.save(folder / "ball.npy", (inside.T > 0.5).astype(np.uint8))
    return folder


def test_a_channel_of_a_probability_map_is_chosen(probabilities, tmp_path, monkeypatch):
    monkeypatch.chdir(probabilities)
    words = ("surface", "ball.npy", "-o", tmp_path / "s.vtp", "--probability")
    fail(1, "(background, cell). Choose one with --probability-channel", *words, "two.ome.tif")
    fail(1, "--probability-channel is '1', but only TIFF", *words, "one.npy", "--probability-channel", 1)
    fail(1, "has no channel 'dna'. Choose one of background", *words, "two.ome.tif", "--probability-channel", "dna")
    fail(2, "--probability-channel requires --probability", *words[:-1], "--probability-channel", 1)
    succeed(*words, "two.ome.tif", "--probability-channel", "cell")
    made = voxflat.surface("ball.npy", probability="one.npy")
    np.testing.assert_array_equal(voxflat.surface(tmp_path / "s.vtp").points, made.points)
    assert not np.array_equal(made.points, voxflat.surface("ball.npy").points)
    fail(1, "Choose one with --probability-channel", "check", *words[1:2], "--probability", "two.ome.tif")


def drawn(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def test_a_map_is_plotted_with_the_options_of_an_overlay(probabilities):
    flat = voxflat.surface(probabilities / "ball.npy").flatten(Voxflat(sources=9))
    stack, options = probabilities / "two.ome.tif", {"channel": "cell", "depth": -1.0, "limits": (0, 1)}
    figures = flat.plot(stack, **options), flat.plot(Overlay(stack, "cell", limits=(0, 1)), depth=-1.0)
    shown, expected = (drawn(figure) for figure in figures)
    np.testing.assert_array_equal(shown, expected)
    assert len(np.unique(shown.reshape(-1, 4), axis=0)) > 100  # colours
    refused(r"has 2 channels .*Choose one by its name or number \(channel\)", flat.plot, stack)
    refused("channel and an Overlay are given. Pass it to the Overlay", flat.plot, Overlay(stack), channel="cell")
    refused("the overlay has no values. Pass data, or omit the overlay options", flat.plot, channel="cell")


def test_channels_that_a_stack_does_not_have(files, tmp_path):
    words = ("image", files / "um.npz", "-o", tmp_path / "image.tif", "--volume")
    fail(
        1, "has only one channel, but channel is 'dna'. Omit --channel", *words, files / "ball.tif", "--channel", "dna"
    )
    two = np.stack([np.asarray(balls()[0], np.uint8).T] * 2)
    told = {"axes": "CZYX", "Channel": {"Name": ["wall", "nuclei"]}}
    tifffile.imwrite(tmp_path / "two.ome.tif", two, metadata=told)
    one = voxflat.io.read_volume(tmp_path / "two.ome.tif", "nuclei")
    told_of = voxflat.surface(one, label=int(one.data.max())).provenance["parameters"]["source"]
    assert told_of["parameters"] == {"path": str(tmp_path / "two.ome.tif"), "channel": "nuclei"}
    digest = hashlib.sha256((tmp_path / "two.ome.tif").read_bytes()).hexdigest()
    assert told_of["files"] == {str(tmp_path / "two.ome.tif"): digest}
    fail(1, "has no channel 'dna'. Choose one of wall, nuclei", *words, tmp_path / "two.ome.tif", "--channel", "dna")
    fail(
        1,
        "has no channel 2. Pass a number from 0 to 1 (wall, nuclei)",
        *words,
        tmp_path / "two.ome.tif",
        "--channel",
        2,
    )
    fail(
        1, "has 2 channels or time points (wall, nuclei). Choose one with --channel", "check", tmp_path / "two.ome.tif"
    )


def cut_off(path, share):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


STACKS = [
    {"imagej": True},
    {"ome": True},
    {"ome": True, "compression": "zlib"},
    {"ome": True, "compression": "zlib", "bigtiff": True, "tile": (16, 16)},
    {"compression": "zlib", "rowsperstrip": 8},
    {"compression": "zlib", "byteorder": ">"},
    {},
    {"bigtiff": True},
    {"metadata": None},
    {"metadata": None, "compression": "zlib", "bigtiff": True},
]


def stack_of(path, how):
    data = np.random.default_rng(0).integers(1, 200, (6, 24, 20)).astype(np.uint8)
    tifffile.imwrite(path, data, **{"metadata": {"axes": "ZYX"}, "photometric": "minisblack", **how})
    np.testing.assert_array_equal(voxflat.io.read_volume(path).data, data.T)
    return data.T


@pytest.mark.parametrize("how", STACKS, ids=str)
def test_a_tiff_stack_that_is_cut_off_anywhere_is_refused_or_complete(tmp_path, monkeypatch, caplog, how):
    """tifffile reads the first pages of most of them, and only logs that others are missing."""
    data, whole = stack_of(tmp_path / "whole.tif", how), (tmp_path / "whole.tif").read_bytes()
    monkeypatch.setattr(logging.getLogger("tifffile"), "disabled", True)
    path, refusals = tmp_path / "stack.tif", 0
    for end in sorted({*range(0, len(whole), 1 + len(whole) // 150), *range(len(whole) - 20, len(whole))}):
        path.write_bytes(whole[:end])
        try:
            found = voxflat.io.read_volume(path).data
        except voxflat.errors.InputError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017
            refusals += 1
        else:
            np.testing.assert_array_equal(found, data)
    assert refusals > 100
    assert not [record for record in caplog.records if record.name.startswith("voxflat")]


def test_a_tiff_stack_has_as_many_planes_as_its_text_says(tmp_path):
    stack_of(tmp_path / "ome.tif", {"ome": True})
    stack_of(tmp_path / "imagej.tif", {"imagej": True})
    stack_of(tmp_path / "shaped.tif", {})
    for name, old, new in (
        ("ome", b'SizeZ="6"', b'SizeZ="9"'),
        ("ome", b'PlaneCount="6"', b'PlaneCount="5"'),
        ("ome", b"<OME ", b"<OMX "),
        ("imagej", b"images=6", b"images=9"),
        ("imagej", b"slices=6", b"slices=9"),
        ("shaped", b'"shape": [6,', b'"shape": [9,'),
        ("shaped", b'"shape": [6,', b'"shape": [3,'),
    ):
        content = (tmp_path / f"{name}.tif").read_bytes()
        assert old in content
        (tmp_path / "other.tif").write_bytes(content.replace(old, new))
        refused("planes|OME-XML", voxflat.io.read_volume, tmp_path / "other.tif")


def ome_in(path, other):
    """Write an OME-TIFF file whose last three planes are in another file."""
    planes = np.random.default_rng(1).integers(1, 200, (6, 24, 20)).astype(np.uint8)
    blocks = "".join(
        f'<TiffData IFD="0" FirstZ="{first}" PlaneCount="3"><UUID FileName="{name}">{uuid}</UUID></TiffData>'
        for first, name, uuid in ((0, path.name, "urn:uuid:1"), (3, other, "urn:uuid:2"))
    )
    text = (
        '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:1"><Image ID="Image:0">'
        f'<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="20" SizeY="24" SizeZ="6" '
        f'SizeC="1" SizeT="1">'
        f'<Channel ID="Channel:0:0" SamplesPerPixel="1"/>{blocks}</Pixels></Image></OME>'
    )
    how = {"metadata": None, "photometric": "minisblack"}
    tifffile.imwrite(path, planes[:3], description=text, **how)
    return planes, lambda file, own="urn:uuid:2": tifffile.imwrite(
        file, planes[3:], description=text.replace('" UUID="urn:uuid:1"', f'" UUID="{own}"'), **how
    )


def test_planes_of_ome_tiff_in_other_files_are_read_from_their_own_directory_only(tmp_path):
    folder = tmp_path / "scan"
    (folder / "part").mkdir(parents=True)
    for name in ("b.ome.tif", "part/b.ome.tif"):
        planes, write = ome_in(folder / "a.ome.tif", name)
        refused("which does not exist. Copy that file too", voxflat.io.read_volume, folder / "a.ome.tif")
        write(folder / name)
        np.testing.assert_array_equal(voxflat.io.read_volume(folder / "a.ome.tif").data, planes.T)
        write(folder / name, "urn:uuid:3")
        refused("which belongs to another image", voxflat.io.read_volume, folder / "a.ome.tif")
        write(folder / name)
        cut_off(folder / name, 0.7)
        refused("ends before its last page", voxflat.io.read_volume, folder / "a.ome.tif")
        (folder / name).unlink()
    for name in ("../b.ome.tif", str(tmp_path / "b.ome.tif")):
        _, write = ome_in(folder / "a.ome.tif", name)
        write(tmp_path / "b.ome.tif")
        refused("outside its directory", voxflat.io.read_volume, folder / "a.ome.tif")


def test_sizes_of_voxels_that_ome_xml_leaves_out_or_that_are_negative(tmp_path):
    sizes = {f"PhysicalSize{axis}": 0.5 for axis in "XYZ"}
    for change, told in (({"Y": None}, "along Y"), ({"Z": None}, "along Z"), ({"X": -0.5}, "invalid voxel size")):
        changed = {key: change.get(key[-1], value) for key, value in sizes.items()}
        metadata = {"axes": "ZYX", **{key: value for key, value in changed.items() if value is not None}}
        tifffile.imwrite(tmp_path / "odd.ome.tif", np.ones((3, 4, 5), np.uint8), metadata=metadata)
        refused(told, voxflat.io.as_volume, tmp_path / "odd.ome.tif")


def test_a_size_that_a_stack_leaves_out_is_given_as_spacing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inside = np.sum((np.indices((9, 11, 11)) - np.array([4, 5, 5]).reshape(3, 1, 1, 1)) ** 2, axis=0) < 12
    two, labels = np.stack([inside, ~inside], 1).astype(np.uint8), inside.astype(np.uint8)
    sizes = {"PhysicalSizeX": 0.2, "PhysicalSizeY": 0.2}  # µm
    tifffile.imwrite("one.ome.tif", labels, metadata={"axes": "ZYX", **sizes})
    tifffile.imwrite("whole.ome.tif", labels, metadata={"axes": "ZYX", **sizes, "PhysicalSizeZ": 0.6})
    tifffile.imwrite("two.ome.tif", two, metadata={"axes": "ZCYX", **sizes})
    tifffile.imwrite("imagej.tif", labels, imagej=True, resolution=(5, 5), metadata={"axes": "ZYX", "unit": "um"})
    whole = voxflat.surface("whole.ome.tif")
    for source in ("one.ome.tif", voxflat.io.read_volume("two.ome.tif", 0), "imagej.tif"):
        for unit in (None, "µm"):
            made = voxflat.surface(source, spacing=(0.2, 0.2, 0.6), unit=unit)
            assert (made.metadata["unit"], made.points.tolist()) == ("µm", whole.points.tolist())
        for spacing in ((0.4, 0.2, 0.6), (2e-4, 2e-4, 6e-4)):
            refused("in µm, but spacing is", voxflat.surface, source, spacing=spacing)
        told = "unit is 'mm', but this volume defines its voxel size in µm"
        refused(told, voxflat.surface, source, spacing=(0.2, 0.2, 0.6), unit="mm")
        for door in (voxflat.surface, voxflat.io.as_volume, voxflat.hemisphere, voxflat.check, voxflat.rim):
            side = ["left"] if door is voxflat.hemisphere else []
            refused("size of its voxels along Z. Pass spacing, in µm as the other sizes", door, source, *side)
    told = (
        "defines the size of its voxels (0.2 x 0.2 x 0.6 µm). Omit --spacing, or correct the file, for example in Fiji"
    )
    fail(1, told, "surface", "whole.ome.tif", "--spacing", "0.2,0.2,0.5", "-o", "s.vtp")
    succeed("flatten", "two.ome.tif", "--channel", "0", "--spacing", "0.2,0.2,0.6", "-o", "map.npz")
    fail(1, "Pass --spacing, in µm", "surface", "one.ome.tif", "-o", "s.vtp")
    flat_map = voxflat.load("map.npz")
    assert flat_map.metadata["unit"] == "µm"
    image, other = (flat_map.image(name) for name in ("one.ome.tif", "whole.ome.tif"))  # on the grid of the map
    np.testing.assert_array_equal(image.data, other.data)


def test_an_empty_stack(files):
    fail(1, "the volume is empty: every voxel is 0", "flatten", files / "empty.tif", "-o", "never.npz")
    fail(
        1,
        "no voxel is above the threshold 0.5; the largest value is 0",
        "surface",
        files / "empty.tif",
        "--threshold",
        0.5,
        "-o",
        "never.ply",
    )


def test_organs_that_touch(files):
    """Fused organs are one surface; with one label each, both have clean closed surfaces where they should be."""
    fused = voxflat.surface(files / "fused.tif")
    assert fused.check().components == (len(fused),)
    for label, centre in zip((1, 2), CENTRES, strict=True):
        surface = voxflat.surface(files / "labels.tif", label=label)
        topology = surface.core.topology()
        assert (len(topology["components"]), topology["handles"], topology["loops"]) == (1, 0, [])
        away = np.linalg.norm(surface.points - centre, axis=1) - RADIUS
        beyond = np.abs(surface.points[:, 0] - CENTRES[:, 0].mean()) > 1  # µm from the contact
        assert np.sqrt(np.mean(away[beyond] ** 2)) < 0.3 * SIZE
        assert np.abs(away[beyond]).max() < SIZE
    fail(
        1, "pass a label or a threshold; the volume has labels 1, 2", "surface", files / "labels.tif", "-o", "never.ply"
    )


def test_two_organs_in_one_mask(files):
    told = succeed("check", files / "apart.tif").stdout
    assert "the surface has 2 components; only the largest is used" in told
    assert "To use another one, select its label or keep a part" in told


def test_surfaces_that_are_not_closed_have_no_charts():
    refused("charts require a closed surface, or a tube with two ends, but this", voxflat.surface(grid(12)).charts, 2)
    x, y, z = np.indices((24, 24, 10)) - np.array([12, 12, 5])[:, None, None, None]
    torus = (np.hypot(np.hypot(x, y) - 8, z) < 3).astype(np.uint8)
    refused(r"the surface has 1 handle\(s\), but charts require", voxflat.surface(torus, repair="none").charts, 2)


@pytest.fixture(scope="module")
def of_stack(tmp_path_factory):
    """Return the labels of a ball, and their map, made from a stack without a position."""
    folder = tmp_path_factory.mktemp("extents")
    labels = balls()[0][:30].astype(np.uint8)
    ome(folder / "labels.ome.tif", labels)
    return labels, voxflat.surface(folder / "labels.ome.tif").flatten()


def ome(path, data, spacing=(SIZE, SIZE, SIZE), unit="µm"):
    sizes = {f"PhysicalSize{axis}": size for axis, size in zip("XYZ", spacing, strict=True)}
    units = {f"PhysicalSize{axis}Unit": unit for axis in "XYZ"}
    tifffile.imwrite(path, data.T, metadata={"axes": "ZYX", **sizes, **units})


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"slices": 10}, "measures 15 x 15 x 20 µm along x, y and z, but the flattened volume 15 x 15 x 15 µm"),
        ({"crop": 4}, "measures 13 x 15 x 15 µm"),
        ({"spacing": (0.5, 0.5, 0.6)}, "measures 15 x 15 x 18 µm"),
        ({"slices": 1}, None),
        ({"fine": 2}, None),
    ],
)
def test_a_stack_of_another_extent_may_lie_elsewhere(of_stack, tmp_path, caplog, change, told):
    """TIFF has no positions, so the extents are the only sign that a stack is not on the grid of the flattened one."""
    labels, flat_map = of_stack
    image = np.pad(100 * labels, [(0, 0), (0, 0), (0, change.get("slices", 0))])[change.get("crop", 0) :]
    fine = change.get("fine", 1)
    image = image.repeat(fine, 0).repeat(fine, 1).repeat(fine, 2)
    ome(tmp_path / "other.ome.tif", image, change.get("spacing", (SIZE / fine,) * 3))
    regions = flat_map.regions({"all": [[-99, -99], [99, -99], [99, 99], [-99, 99]]})
    for use in (flat_map.image, lambda path: regions.volume(path, depth=(-2, 2))):
        caplog.clear()
        use(tmp_path / "other.ome.tif")
        assert ("Neither defines its position" in caplog.text) == (told is not None)
        assert (told or "") in caplog.text


@pytest.mark.parametrize("unit", ["pixel", "reference frame"])
def test_sizes_in_pixels_are_not_lengths(of_stack, tmp_path, unit):
    ome(tmp_path / "pixel.ome.tif", of_stack[0], (1, 1, 1), unit)
    volume = voxflat.io.read_volume(tmp_path / "pixel.ome.tif")
    assert not volume.is_placed
    assert "is assumed to be 1 mm" in succeed("check", tmp_path / "pixel.ome.tif").stderr
    succeed("flatten", tmp_path / "pixel.ome.tif", "--spacing", "2,2,5", "--unit", "µm", "-o", tmp_path / "map.npz")
    metadata = voxflat.load(tmp_path / "map.npz").metadata
    assert metadata["unit"] == "µm"
    assert np.diag(metadata["affine"]).tolist() == [2, 2, 5, 1]


def test_a_unit_that_is_not_a_length_is_that_of_the_file(of_stack, tmp_path):
    ome(tmp_path / "odd.ome.tif", of_stack[0], unit="pt")
    told = "odd.ome.tif: its unit of length, 'pt', is unknown. Save it in mm"
    fail(1, told, "check", tmp_path / "odd.ome.tif")
