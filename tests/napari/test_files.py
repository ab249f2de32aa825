"""Files that napari opens and saves with voxflat, compared with other readers."""

import gzip
import os
import random
import shutil
import weakref
from pathlib import Path

import itk
import nibabel as nib
import numpy as np
import PIL.Image
import pytest
import pyvista
import tifffile
import trimesh
from fuzz_files import corpus, damaged
from mesh_files import fsaverage5
from napari.layers import Image, Labels, Layer
from napari_window import (
    bumps,
    cap,
    map_dock,
    open_file,
    prepared_map_of,
    run_whole,
    wait_for_picture,
    wait_for_threads,
)
from npe2 import PluginManager, PluginManifest, io_utils
from numpy.testing import assert_allclose, assert_array_equal
from qtpy.QtWidgets import QWidget

import voxflat
from voxflat._napari.files.readers import map_reader, surface_reader
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.map_viewer.dock import REGION
from voxflat._napari.map_viewer.drawings import OF_MAP
from voxflat._napari.map_viewer.movies import MovieWindow
from voxflat._napari.map_viewer.segmentations import Segmentations
from voxflat._napari.map_viewer.viewer_parts import camera, look_from_side
from voxflat._napari.results.flat_layers import KEPT, MovieMaps, Run
from voxflat._napari.results.maps import map_layers
from voxflat._napari.stacks import viewer_order, world_of
from voxflat._napari.viewer_state import ViewerState
from voxflat.io import Mesh, Patch, Space, VolumeGeometry, formats, patch_border, write_mesh, write_patch
from voxflat.methods import Voxflat

CENTRE = np.array([3.0, -20.0, 15.0])  # of the volume, scanner RAS


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    """A FreeSurfer folder: a bumpy surface in tkRAS, values on it, and a patch of it."""
    points, faces, values = bumps()
    home = tmp_path_factory.mktemp("subject")
    surf, label = home / "surf", home / "label"
    for folder in (surf, label):
        folder.mkdir()
    space = Space("tkRAS", VolumeGeometry.conformed(CENTRE))
    for name, lift in (("lh.white", 0), ("lh.pial", 2), ("rh.white", 5)):
        write_mesh(surf / name, Mesh(points + np.array([0, 0, lift]), faces, space=space))
    for name in ("lh.thickness", "lh.area.pial"):
        nib.freesurfer.write_morph_data(surf / name, values.astype(np.float32))
    nib.save(nib.MGHImage(values.astype(np.float32)[:, None, None], np.eye(4)), surf / "lh.smooth.mgh")
    colours = np.array([[25, 5, 25, 0, 0], [220, 20, 20, 0, 0], [20, 220, 20, 0, 0]])
    labels = (np.arange(len(points)) % 3).astype(np.int32)
    nib.freesurfer.write_annot(label / "lh.parts.annot", labels, colours, ["unknown", "red", "green"], fill_ctab=True)
    ids = np.flatnonzero(values)
    flat = np.column_stack([points[ids, :2], np.zeros(len(ids))])
    write_patch(surf / "lh.cortex.patch.flat", Patch(ids, flat, patch_border(faces, ids, len(points))))
    return home


@pytest.fixture
def viewer(make_napari_viewer):
    return make_napari_viewer()


@pytest.fixture
def last_of(viewer, qtbot, messages):
    """A function that opens a file in the viewer as File → Open does, and returns its last layer."""
    return lambda path: open_file(viewer, qtbot, path)[-1]


def test_freesurfer_files_open_on_their_surface(subject, viewer, last_of, messages):
    points, _, values = bumps()
    white = last_of(subject / "surf" / "lh.white")
    assert viewer.dims.ndisplay == 3
    assert [str(unit) for unit in white.units] == ["millimeter"] * 3
    assert_allclose(white.vertices, points + CENTRE, atol=1e-5)
    viewer.layers.clear()
    for name in ("lh.thickness", "lh.smooth.mgh", "lh.area.pial"):
        layer = last_of(subject / "surf" / name)
        assert layer.name == name
        assert_allclose(layer.vertices, points + CENTRE, atol=1e-5)  # the white one of this side
        assert_allclose(layer.vertex_values, values, rtol=1e-6)
    labels = last_of(subject / "label" / "lh.parts.annot")
    assert_allclose(labels.vertex_colors[1][:3], np.array([220, 20, 20]) / 255)
    assert labels.features["name"][2] == "green"
    viewer.layers.clear()
    pial = last_of(subject / "surf" / "lh.pial")
    assert_allclose(last_of(subject / "surf" / "lh.thickness").vertices, pial.vertices)  # what is open comes first
    for layer in viewer.layers:
        layer.visible = False
    assert_allclose(
        last_of(subject / "surf" / "lh.thickness").vertices, points + CENTRE, atol=1e-5
    )  # hidden layers are not saved
    flat = last_of(subject / "surf" / "lh.cortex.patch.flat")
    assert_allclose(flat.vertices, points[values != 0][:, [1, 0]] * [-1, 1])
    assert_array_equal(flat.features["vertex"], np.flatnonzero(values))
    assert not messages


@pytest.mark.parametrize("name", ["lh.pial", "lh.white", "of a script"])
def test_values_are_not_flattened_instead_of_their_surface(subject, viewer, last_of, name):
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    if name == "of a script":
        mesh = viewer.add_surface(bumps()[:2], name=name, units="mm")
    else:
        mesh = last_of(subject / "surf" / name)
    values = last_of(subject / "surf" / "lh.thickness")
    assert_array_equal(values.vertices, mesh.vertices)
    assert widget.form.surface.layer is mesh
    assert widget.form.sampled.layer is values
    path = LayerMesh.of(values).place.path
    assert path == (None if name == "of a script" else subject / "surf" / name)


def hemisphere(side):
    """A small surface on one side."""
    points, faces, _ = bumps(9)
    return Mesh(points - points.mean(axis=0) + np.array([-30.0 if side == "left" else 30.0, 0, 0]), faces)


@pytest.mark.parametrize("side", ["left", "right"])
def test_surfaces_are_seen_upright_from_their_side(viewer, last_of, tmp_path, qtbot, side):
    names = [f"{side[0]}h.{kind}" for kind in ("inflated", "pial", "white", "sphere")]  # as dialogs sort them, and not
    for name in names:
        write_mesh(tmp_path / name, hemisphere(side))
    inflated = last_of(tmp_path / names[0])
    assert inflated.visible  # because there is no other surface
    assert [last_of(tmp_path / name).visible for name in names[1:]] == [True, True, False]
    assert not inflated.visible
    towards = {"left": 1.0, "right": -1.0}[side]
    qtbot.waitUntil(lambda: np.allclose(camera(viewer).view_direction, (towards, 0, 0), atol=1e-6))
    assert_allclose(camera(viewer).up_direction, (0, 0, 1), atol=1e-6)
    camera(viewer).angles = (10, 20, 30)
    last_of(tmp_path / names[2])
    assert_allclose(camera(viewer).angles, (10, 20, 30))  # someone turned it


@pytest.mark.parametrize("before", ["nothing", "a volume", "a volume that is gone"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_front_is_on_the_side_of_which_a_hemisphere_is(viewer, last_of, tmp_path, qtbot, side, before):
    """Left hemispheres face left; otherwise the view would be mirrored."""
    if before != "nothing":
        nib.save(nib.Nifti1Image(ramp((5, 6, 7)).astype(np.float32), np.eye(4)), tmp_path / "t1.nii")
        last_of(tmp_path / "t1.nii")
        qtbot.waitUntil(lambda: viewer.dims.order == (0, 2, 1))
    if before == "a volume that is gone":
        viewer.layers.clear()
    write_mesh(tmp_path / f"{side[0]}h.white", hemisphere(side))
    surface = last_of(tmp_path / f"{side[0]}h.white")
    qtbot.wait(10)  # what is posted then
    viewer.dims.ndisplay = 3
    look_from_side(viewer, right=side == "right")  # as Draw cuts does
    visual = viewer.window._qt_viewer.canvas.layer_to_visual[surface].node
    seen = visual.get_transform("visual", "canvas").map(visual.mesh_data.get_vertices())
    across, down = (seen[:, :2] / seen[:, 3:]).T
    _, y, z = surface.vertices.T
    assert np.sign(across[y.argmax()] - across[y.argmin()]) == {"left": -1, "right": 1}[side]
    assert down[z.argmax()] < down[z.argmin()]
    viewer.dims.ndisplay = 2
    assert viewer.dims.order == ((0, 2, 1) if before == "a volume" else (0, 1, 2))


def test_gifti_of_fsaverage_opens_on_the_same_side(viewer, last_of):
    surface = last_of(fsaverage5("white_left"))
    points = nib.load(fsaverage5("white_left")).agg_data("pointset")
    assert_array_equal(surface.vertices, points)
    viewer.layers.clear()
    sulc = last_of(fsaverage5("sulc_left"))
    assert_array_equal(sulc.vertices, points)
    assert_allclose(sulc.vertex_values, nib.load(fsaverage5("sulc_left")).agg_data())
    assert sulc.contrast_limits[0] == -sulc.contrast_limits[1]


def ramp(shape):
    return np.arange(np.prod(shape)).reshape(shape)


# as FreeSurfer's: left, inferior, anterior
CONFORMED = np.array([[-1.0, 0, 0, 20], [0, 0, 1.5, -30], [0, -2.0, 0, 40], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("name", "data", "kind"),
    [
        ("T1.mgz", ramp((5, 6, 7)).astype(np.float32), Image),
        ("count.nii.gz", ramp((5, 6, 7)).astype(np.int16), Image),
        ("aseg.mgz", ramp((5, 6, 7)).astype(np.int32), Labels),
        ("wm.nii", (ramp((5, 6, 7)) % 3).astype(np.uint8), Labels),
    ],
)
def test_volumes_open_where_they_lie(viewer, last_of, qtbot, messages, tmp_path, name, data, kind):
    """napari asks which plugin reads NIfTI, because its own reader claims the format, but cannot read it."""
    make = nib.MGHImage if name.endswith("mgz") else nib.Nifti1Image
    nib.save(make(data, CONFORMED), tmp_path / name)
    layer = last_of(tmp_path / name)
    assert type(layer) is kind
    assert layer.name == name.partition(".")[0]
    assert [str(unit) for unit in layer.units] == ["millimeter"] * 3
    assert layer.data.shape == (5, 7, 6)  # along x, y and z
    for voxel in ((0, 0, 0), (4, 5, 6), (1, 3, 2)):
        place = CONFORMED[:3, :3] @ voxel + CONFORMED[:3, 3]
        assert layer.data[tuple(np.round(layer.world_to_data(place)).astype(int))] == data[voxel]
    of = LayerVolume.of(layer)
    assert_allclose(of.place.affine[:3, :3], np.diag([-1, 1.5, -2]))
    assert of.place.path == tmp_path / name
    qtbot.waitUntil(lambda: viewer.dims.order == (0, 2, 1))  # upright
    assert not messages


TURNED = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)) + 2 * np.eye(3))[0]
OBLIQUE = np.block([[TURNED * [0.8, 0.8, 1.5], np.array([[-12.0], [30], [7]])], [np.zeros((1, 3)), 1.0]])


@pytest.mark.parametrize(
    ("name", "affine", "saved"),
    [
        ("stack.tif", None, "regions.nii.gz"),
        ("stack.tif", None, "regions.tif"),
        ("cube.tif", None, "regions.nii.gz"),
        ("µm.tif", None, "regions.nii.gz"),
        ("µm.tif", None, "regions.tif"),
        ("oblique.nii.gz", OBLIQUE, "regions.nii.gz"),
        ("conformed.nii.gz", CONFORMED, "regions.nii.gz"),
    ],
)
def test_regions_in_a_volume_are_opened_on_its_voxels(open_widget, qtbot, tmp_path, messages, name, affine, saved):
    """In napari, and in Python and on the command line, where stacks have the axes x, y, z instead of z, y, x."""
    data = cap()[:, :, (0 if name == "cube.tif" else 4) :]
    viewer, widget = open_widget(show=True)
    path, regions = tmp_path / name, tmp_path / saved
    if affine is not None:
        nib.save(nib.Nifti1Image(data, affine), path)
        (layer,) = open_file(viewer, qtbot, path)
    else:
        sizes = {f"PhysicalSize{axis}": length for axis, length in zip("XYZ", (0.4, 0.4, 0.9), strict=True)}
        about = {"ome": True, "metadata": {"axes": "ZYX", **sizes}} if name == "µm.tif" else {}
        tifffile.imwrite(path, data, photometric="minisblack", **about)
        (layer,) = viewer.open(str(path), layer_type="labels")
        if name == "µm.tif":  # which napari's reader leaves out
            layer.scale, layer.units = (0.9, 0.4, 0.4), ("µm",) * 3
    run_whole(widget, qtbot)
    dock = map_dock(viewer, qtbot)
    made = dock.prepared.run.flat_map.metadata["napari"]
    assumed = "The layer does not have a unit of length; its coordinates are assumed to be in mm."
    assert (assumed in widget.results.warnings.text()) == (str(layer.units[0]) == "pixel")
    middle, size = dock.prepared.run.flat_map.uv.mean(axis=0), dock.prepared.spacing
    dock.click.setCurrentText(REGION)
    for corner in ((-5, -4), (4, -3), (1, 5)):
        dock.canvas.clicked.emit(*(middle + size * np.array(corner)))
    dock.canvas.double_clicked.emit()
    wait_for_picture(dock, qtbot)
    (drawn,) = [one for one in viewer.layers if OF_MAP in one.metadata]
    viewer.layers.selection = {drawn}
    viewer.layers.save(str(regions), selected=True, plugin="voxflat")
    messages.clear()
    if saved == "regions.tif":
        (opened,) = viewer.open(str(regions), layer_type="labels")
        if name == "µm.tif":
            opened.scale, opened.units = layer.scale, layer.units
    else:
        (opened,) = open_file(viewer, qtbot, regions)
        told = [f"{saved} has the voxels of '{layer.name}', and was opened with its axes (SAR)"]
        assert [one.message for one in messages] == (told if affine is None else [])
    assert_array_equal(opened.data, drawn.data)
    assert opened.units == drawn.units == layer.units
    for voxel in (np.zeros(3), np.array(opened.data.shape) - 1):
        assert_allclose(opened.data_to_world(voxel), layer.data_to_world(voxel), rtol=1e-5, atol=1e-5)
    own, found = (voxflat.io.read_volume(one).in_unit("mm") for one in (path, regions))
    voxels = np.column_stack([np.argwhere(found.data), np.ones(np.count_nonzero(found.data))])
    at = (voxels @ (np.linalg.inv(own.affine) @ found.affine).T)[:, :3]
    assert_allclose(at, np.round(at), atol=1e-3)
    inside = np.zeros(own.data.shape, dtype=bool)
    inside[tuple(np.round(at).astype(int).T)] = True
    order = [2, 1, 0] if affine is None else list(viewer_order(affine))
    assert_array_equal(inside.transpose(order), drawn.data != 0)
    if saved == "regions.nii.gz":  # a map of Python or the command line has the same axes beside the layer
        flat_map = voxflat.surface(path, label=3).flatten(Voxflat(sources=20))
        flat_map.save(tmp_path / "map.voxflat")
        origin = open_file(viewer, qtbot, tmp_path / "map.voxflat")[0].metadata["voxflat"].metadata["napari"]
        assert [origin[name] for name in ("world_axes", "unit")] == [made[name] for name in ("world_axes", "unit")]
    wait_for_threads(qtbot)


@pytest.mark.parametrize("unit", ["pixel", "µm"])
def test_labels_opened_before_their_stack_get_its_axes(viewer, qtbot, tmp_path, messages, unit):
    """As soon as the stack gets voxel sizes, which napari's reader of TIFF files leaves out."""
    data = cap()[:, :, 4:]
    sizes = {f"PhysicalSize{axis}": length for axis, length in zip("XYZ", (0.4, 0.4, 0.9), strict=True)}
    path, labels = tmp_path / "stack.ome.tif", tmp_path / "cells.nii.gz"
    tifffile.imwrite(path, data, photometric="minisblack", metadata={"axes": "ZYX", **(sizes if unit == "µm" else {})})
    own = voxflat.io.read_volume(path).in_unit("mm")  # as Python and the command line read it
    nib.save(nib.Nifti1Image((own.data * 2).astype(np.uint8), own.affine), labels)
    flat_map = voxflat.surface(path, label=3).flatten(Voxflat(sources=20))
    flat_map.save(tmp_path / "map.voxflat")
    open_file(viewer, qtbot, tmp_path / "map.voxflat")
    viewer.window._qt_window.show()
    open_file(viewer, qtbot, labels)  # as do dialogs, which open one file after the other
    viewer.open(str(path))
    cells, stack = viewer.layers["cells"], viewer.layers["stack.ome"]
    if unit == "µm":
        assert cells.data.shape != data.shape
        stack.scale, stack.units = (0.9, 0.4, 0.4), ("µm",) * 3
    assert_array_equal(cells.data, 2 * data)
    assert cells.units == stack.units
    for voxel in (np.zeros(3), np.array(data.shape) - 1):
        assert_allclose(cells.data_to_world(voxel), stack.data_to_world(voxel), rtol=1e-5, atol=1e-5)
    told = [one.message for one in messages]
    assert "'cells' has the voxels of 'stack.ome', and now has its axes (SAR)" in told
    assert any(text.startswith("The map 'map' is older than the stack 'stack.ome'") for text in told)
    count = len(told)
    stack.translate, cells.translate = (1, 0, 0), (1, 0, 0)
    assert len(messages) == count  # told once
    assert_array_equal(LayerVolume.of(cells, world_of(viewer, cells)).read().data, 2 * data)
    wait_for_threads(qtbot)


def test_a_series_is_read_frame_by_frame(viewer, last_of, tmp_path, monkeypatch):
    data = np.random.default_rng(0).random((5, 6, 7, 4)).astype(np.float32)
    nib.save(nib.Nifti1Image(data, CONFORMED), tmp_path / "bold.nii")
    layer = last_of(tmp_path / "bold.nii")
    assert layer.data.shape == (4, 5, 7, 6)
    assert hasattr(layer.data, "dask")
    assert_array_equal(np.asarray(layer.data[2]), data[..., 2].transpose(0, 2, 1))
    assert_allclose(LayerVolume.of(layer, step=(2,)).place.affine, CONFORMED[:, [0, 2, 1, 3]])
    (tmp_path / "broken.nii.gz").write_bytes(b"\x1f\x8b no volume")
    viewer.open(str(tmp_path / "broken.nii.gz"), plugin="voxflat")
    assert len(viewer.layers) == 1


def test_values_without_their_surface_say_what_to_open(subject, viewer, last_of, messages, tmp_path):
    shutil.copy(subject / "surf" / "lh.thickness", tmp_path)
    viewer.open(str(tmp_path / "lh.thickness"), plugin="voxflat")
    assert not viewer.layers
    assert "Open it first (for example, lh.white)" in messages[-1].message
    points, faces, _ = bumps()
    viewer.add_surface((points[:-1], faces[(faces < len(points) - 1).all(axis=1)]), name="other")
    viewer.open(str(tmp_path / "lh.thickness"), plugin="voxflat")
    assert "has 625 values, but the surface has 624 points" in messages[-1].message
    viewer.add_surface((points, faces), name="mesh", translate=(1, 2, 3))
    assert_allclose(last_of(tmp_path / "lh.thickness").vertices, points + np.array([1, 2, 3]))


def test_values_are_shown_on_the_open_surface_that_fits(subject, viewer, last_of, messages):
    """Even beside their own surface; where several fit, a message names the chosen one and the others."""
    surf, (points, faces, _) = subject / "surf", bumps()
    shifts = {"first": 1, "last": 2}
    smaller = (points[:-1], faces[(faces < len(points) - 1).all(axis=1)])
    for name, shift in shifts.items():
        viewer.add_surface((points, faces), name=name, translate=(shift, 0, 0), units=["mm"] * 3)
    viewer.add_surface(smaller, name="smaller", units=["mm"] * 3)
    viewer.add_surface((points, faces), name="right", metadata={"structure": "CortexRight"}, units=["mm"] * 3)
    assert_allclose(last_of(surf / "lh.thickness").vertices, points + np.array([2, 0, 0]))
    assert [one.message for one in messages] == [
        "lh.thickness is shown on 'last', the last one opened. It also fits 'first'"
    ]
    viewer.layers.clear()
    messages.clear()
    for name in ("lh.pial", "lh.white"):
        last_of(surf / name)
    for name, kind in (("lh.area.pial", "pial"), ("lh.thickness", "white")):
        assert_allclose(last_of(surf / name).vertices, viewer.layers[f"lh.{kind}"].vertices)
    near = "whose file is near it and has the most similar name"
    assert [one.message for one in messages] == [
        f"lh.area.pial is shown on 'lh.pial', {near}. It also fits 'lh.white'",
        f"lh.thickness is shown on 'lh.white', {near}. It also fits 'lh.pial'",
    ]
    viewer.layers.clear()
    messages.clear()
    viewer.add_surface(smaller, name="smaller", units=["mm"] * 3)
    assert_allclose(last_of(surf / "lh.thickness").vertices, points + CENTRE, atol=1e-5)
    last_of(subject / "label" / "lh.parts.annot")
    told = f"lh.thickness is shown on {surf / 'lh.white'}, a surface from a file near it, instead of 'smaller'"
    assert [one.message for one in messages] == [told]


def test_a_label_is_shown_on_its_own_surface(subject, viewer, last_of, messages):
    """Because it does not tell how many vertices its surface has."""
    points, faces, _ = bumps(30)
    viewer.add_surface((points, faces), name="larger", units=["mm"] * 3)
    (subject / "label" / "lh.V1.label").write_text("#!ascii label\n1\n7 0 0 0 0\n")
    assert len(last_of(subject / "label" / "lh.V1.label").vertices) == len(bumps()[0])
    assert "V1.label is shown on" in messages[-1].message


def test_damaged_files_give_one_line_messages(subject, viewer, messages, tmp_path):
    whole = (subject / "surf" / "lh.white").read_bytes()
    huge = b"\xff\xff\xfea\n\n" + np.array([2**31 - 1, 2**31 - 1], ">i4").tobytes()
    xml = b'<?xml version="1.0"?><!DOCTYPE GIFTI [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><GIFTI>&b;</GIFTI>'
    damaged = {"lh.white": whole[:1000], "rh.pial": huge, "a.surf.gii": xml, "b.gii.gz": gzip.compress(bytes(1 << 24))}
    damaged |= {"lh.x.patch.flat": b"\xff\xff\xff\xff\x7f\xff\xff\xff", "lh.thickness": b"\xff\xff\xff\x7f\xff\xff\xff"}
    damaged |= {"lh.parts.annot": b"\0\0\0\x09", "a.voxflat": b"PK\x03\x04 no archive"}
    for name, data in damaged.items():
        (tmp_path / name).write_bytes(data)
        messages.clear()
        viewer.open(str(tmp_path / name), plugin="voxflat")
        (message,) = messages
        assert "\n" not in message.message
        assert name in message.message
    assert not viewer.layers


def write_as(path, values, points, faces):
    """Write a file of the kind that its name indicates: a volume, a surface, or values on one."""
    name, voxels = path.name, np.ones((4, 5, 6), np.uint8)
    if name.endswith((".voxflat", ".npz")):
        voxflat.flatten((points, faces)).save(path)
    elif name.endswith((".nrrd", ".nhdr", ".mha", ".mhd")):
        itk.imwrite(itk.image_from_array(voxels), str(path))
    elif name.endswith((".nii", ".nii.gz", ".mgz")):
        nib.save((nib.MGHImage if name.endswith(".mgz") else nib.Nifti1Image)(voxels, np.eye(4)), path)
    elif name.endswith(".mgh"):
        nib.save(nib.MGHImage(values.astype(np.float32)[:, None, None], np.eye(4)), path)
    elif name.endswith(".annot"):
        colours = np.array([[25, 5, 25, 0, 0], [220, 20, 20, 0, 0]])
        nib.freesurfer.write_annot(path, np.arange(len(points)) % 2, colours, ["unknown", "red"], fill_ctab=True)
    elif name.endswith(".label"):
        path.write_text("#!ascii label\n1\n7 0 0 0 0\n")
    elif name.endswith((".patch.flat", ".patch.3d")):
        ids = np.arange(len(points))
        write_patch(path, Patch(ids, points * [1, 1, 0], patch_border(faces, ids, len(points))))
    elif name.endswith((".gii.gz", ".gii")):
        write_mesh(path.with_name("a.surf.gii"), Mesh(points, faces))
        whole = path.with_name("a.surf.gii").read_bytes()
        path.write_bytes(gzip.compress(whole) if name.endswith(".gz") else whole)
    elif name.endswith(".stl"):
        pyvista.make_tri_mesh(points, faces).save(path)
    elif name.endswith((".curv", ".avg_curv", ".sulc", ".thickness", ".area", ".volume")):
        nib.freesurfer.write_morph_data(path, values.astype(np.float32))
    elif name.endswith(".txt"):
        np.savetxt(path, values)
    elif name.endswith(".off"):
        path.write_text(mesh_text(f"OFF\n{len(points)} {len(faces)} 0\n", points, faces, "3 ", ""))
    elif name.endswith(".asc"):
        path.write_text(mesh_text(f"#!ascii version\n{len(points)} {len(faces)}\n", points, faces, "", " 0"))
    elif name.endswith((".vtk", ".glb")):
        mesh = trimesh.Trimesh(points, faces, process=False)
        pyvista.wrap(mesh).save(path) if name.endswith(".vtk") else mesh.export(path)
    elif name.endswith((".ply", ".vtp", ".obj")):
        write_mesh(path, Mesh(points, faces))
    else:
        nib.freesurfer.write_geometry(path, points, faces)


def mesh_text(start, points, faces, before, after):
    rows = [" ".join(map(str, point)) + after for point in points]
    return start + "\n".join([*rows, *(before + " ".join(map(str, face)) + after for face in faces)]) + "\n"


@pytest.fixture
def contributions():
    PluginManager.instance().discover()  # as napari does when it starts
    return PluginManifest.from_distribution("voxflat").contributions


@pytest.mark.parametrize("reader", ["read_flat_map", "read_surface", "read_volume"])
def test_each_kind_of_file_in_the_manifest_is_read(reader, contributions, tmp_path):
    (patterns,) = [one.filename_patterns for one in contributions.readers if one.command == f"voxflat.{reader}"]
    points, faces, values = bumps(9)
    for number, pattern in enumerate(patterns):
        folder = tmp_path / str(number)
        folder.mkdir()
        nib.freesurfer.write_geometry(folder / "lh.white", points, faces)  # on which values lie
        path = folder / pattern.replace("*", "lh" if reader == "read_surface" else "a")
        write_as(path, values, points, faces)
        layers = io_utils.read([str(path)], stack=False, plugin_name="voxflat")
        assert [len(layer) for layer in layers] == [3] * len(layers), pattern  # of nothing one


def test_each_ending_in_the_manifest_is_written(contributions, tmp_path):
    flat_map = voxflat.flatten(bumps(9)[:2])
    flat_map.metadata["napari"] = {"layer": "bumps", "world_axes": "RAS", "unit": "millimeter"}
    (heat,) = map_layers(flat_map, "bumps").layers
    writers = [writer for writer in contributions.writers if writer.command != "voxflat.write_regions"]
    for ending in (ending for writer in writers for ending in writer.filename_extensions):
        path = str(tmp_path / f"map{ending}")
        assert io_utils.write(path, [Layer.create(*heat)], plugin_name="voxflat") == [path], ending
        assert Path(path).stat().st_size > 0, ending


def test_other_files_are_declined(tmp_path):
    np.savez(tmp_path / "a.npz", data=np.ones(3))
    nib.save(nib.MGHImage(np.ones((4, 5, 6), np.float32), np.eye(4)), tmp_path / "voxels.mgh")
    for name in ("x.area", "x.orig", "x.volume", "x.txt"):
        (tmp_path / name).write_text("something else")
        assert surface_reader(str(tmp_path / name)) is None
    assert map_reader(str(tmp_path / "a.npz")) is None
    assert surface_reader(str(tmp_path / "voxels.mgh")) is None
    assert surface_reader([str(tmp_path / "x.area")]) is None


def test_an_opened_map_is_the_current_run(viewer, last_of, tmp_path):
    flat_map = voxflat.flatten(bumps()[:2])
    for name in ("a", "b"):
        flat_map.save(tmp_path / f"{name}.voxflat")
        last_of(tmp_path / f"{name}.voxflat")
    runs = ViewerState.of(viewer).runs
    assert [run.name for run in runs] == ["a", "b"]
    assert ViewerState.of(viewer).current is runs[1]
    for run, names in zip(runs, (["a distortion"], ["b distortion"]), strict=True):
        assert [keywords["name"] for _, keywords, _ in run.layers.layers] == names
        assert_array_equal(run.flat_map.uv, flat_map.uv)
        assert run.flat_map.distortion.figures() == flat_map.distortion.figures()
    write_mesh(tmp_path / "bumps.surf.gii", Mesh(*bumps()[:2]))
    last_of(tmp_path / "bumps.surf.gii")  # as when work goes on
    assert viewer.dims.ndisplay == 3  # a slice shows nothing of it


def test_slices_are_upright_if_the_map_is_opened_before_its_volume(viewer, last_of, tmp_path, qtbot):
    voxflat.flatten(bumps()[:2]).save(tmp_path / "a.voxflat")
    nib.save(nib.Nifti1Image(ramp((5, 6, 7)).astype(np.float32), np.eye(4)), tmp_path / "t1.nii")
    last_of(tmp_path / "a.voxflat")
    last_of(tmp_path / "t1.nii")
    qtbot.waitUntil(lambda: viewer.dims.order == (0, 2, 1))


@pytest.mark.parametrize("ending", formats.ENDINGS)
def test_a_surface_is_offered_to_napari_and_shown_in_3d(viewer, last_of, contributions, tmp_path, ending):
    """In every format that `voxflat.surface` reads; napari asks where its own reader takes the name as well."""
    points, faces, values = bumps()
    path = tmp_path / f"lh.bumps{ending}"
    write_as(path, values, points, faces)
    readers = {one.command for one in PluginManager.instance().iter_compatible_readers([str(path)])}
    own = {".obj": {"napari.get_obj_reader"}, ".vtk": {"napari.get_reader"}}
    assert readers == {"voxflat.read_surface", *own.get(ending, ())}
    layer = last_of(path)
    assert layer.data[0].shape == voxflat.surface(path).points.shape == points.shape
    assert viewer.dims.ndisplay == 3  # a slice shows nothing of it


@pytest.mark.parametrize("ending", [".obj", ".surf.gii"])
def test_warnings_of_the_reader_of_a_mesh_are_shown_with_its_map(open_widget, qtbot, tmp_path, ending):
    """Such as on a unit that was assumed."""
    points, faces, _ = bumps()
    write_mesh(tmp_path / f"tiny{ending}", Mesh(points / 100, faces))
    viewer, widget = open_widget(show=True)
    open_file(viewer, qtbot, tmp_path / f"tiny{ending}")
    run_whole(widget, qtbot)
    assert "coordinates are assumed to be in mm" in widget.results.warnings.text()
    wait_for_threads(qtbot)


def test_a_map_is_saved_and_read_by_others(viewer, last_of, tmp_path):
    flat_map = voxflat.surface(bumps()[:2]).disk(312, 15).flatten()
    flat_map.save(tmp_path / "map.voxflat")
    heat = last_of(tmp_path / "map.voxflat")
    viewer.layers.selection = set(viewer.layers)  # all of one map
    paths = {ending: str(tmp_path / f"again{ending}") for ending in (".voxflat", ".surf.gii", ".flat.patch.3d")}
    for path in paths.values():
        assert viewer.layers.save(path, selected=True, plugin="voxflat") == [path]
    assert_array_equal(voxflat.load(paths[".voxflat"]).uv, flat_map.uv)
    placed, triangles = nib.load(paths[".surf.gii"]).agg_data(("pointset", "triangle"))
    assert_allclose(placed[flat_map.ids, :2], flat_map.uv, atol=1e-4)
    assert_array_equal(triangles, flat_map.ids[flat_map.faces])
    entries = np.frombuffer((tmp_path / "again.flat.patch.3d").read_bytes()[8:], [("v", ">i4"), ("p", ">f4", 3)])
    assert_array_equal(np.sort(np.abs(entries["v"]) - 1), np.sort(flat_map.ids))
    viewer.layers.selection = {heat}
    for ending in (".nii", ".tif", ".png"):
        assert viewer.layers.save(str(tmp_path / f"heat{ending}"), selected=True, plugin="voxflat")
    image = flat_map.heat_map()
    volume = nib.load(tmp_path / "heat.nii")
    assert_allclose(volume.get_fdata()[:, :, 0], image.data, rtol=1e-6)
    assert_allclose(volume.affine, image.affine)
    assert_allclose(np.asarray(PIL.Image.open(tmp_path / "heat.tif")), image.data, rtol=1e-6)
    assert PIL.Image.open(tmp_path / "heat.png").size == image.data.shape[::-1]


def test_a_flat_stack_opens_with_a_slider_of_its_depths(viewer, last_of, tmp_path):
    points, faces, values = bumps(13)
    flat_map = voxflat.flatten((points, faces))
    volume = voxflat.io.Volume(ramp((30, 30, 20)).astype(np.float32), np.eye(4))
    flat_map.images(volume, depth=[-1.0, 0.5, 2.0]).save(tmp_path / "stack.nii.gz")
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    layer = last_of(tmp_path / "stack.nii.gz")
    expected = flat_map.images(volume, depth=[-1.0, 0.5, 2.0])
    assert_array_equal(layer.data, expected.data.astype(np.float32))
    (u, v), size = expected.origin, expected.pixel_size
    assert_allclose(layer.scale, (1.5, size, size), rtol=1e-6)
    assert_allclose(layer.translate, (-1.0, -v, u), rtol=1e-6)
    assert (viewer.dims.ndisplay, viewer.dims.order, viewer.dims.not_displayed) == (2, (0, 1, 2), (0,))
    assert str(camera(viewer).orientation2d[0]).lower().endswith("down")
    assert widget.form.surface.layer is None
    series = np.stack([values, values + 1], axis=1)
    flat_map.images(series).save(tmp_path / "series.nii")
    layer = last_of(tmp_path / "series.nii")
    assert_allclose(layer.data, flat_map.images(series).data)
    assert layer.ndim == 3
    own = voxflat.io.Volume(volume.data, expected[0].affine)  # voxels in the order of a flat image
    voxflat.io.write_volume(tmp_path / "volume.nii", own.data, own.affine, expected.provenance)
    assert_allclose(last_of(tmp_path / "volume.nii").data, np.transpose(own.data, (1, 0, 2)))


def test_commands_of_the_palette_ask_for_a_file(subject, viewer, last_of, qtbot, tmp_path, monkeypatch):
    from napari._app_model import get_app_model

    for ending in ("voxflat", "npz"):
        voxflat.flatten(bumps()[:2]).save(tmp_path / f"map.{ending}")
    viewer.layers.selection = {last_of(tmp_path / "map.voxflat")}
    nib.save(nib.Nifti1Image(np.ones((4, 5, 6), np.uint8), np.eye(4)), tmp_path / "ones.nii")
    paths = [tmp_path / "again.voxflat", tmp_path / "again.nii", subject / "surf" / "lh.white", tmp_path / "ones.nii"]
    paths += [tmp_path / "map.npz"]
    answers = [*map(str, paths), ""]
    for way in ("Save", "Open"):
        monkeypatch.setattr(f"qtpy.QtWidgets.QFileDialog.get{way}FileName", lambda *_: (answers.pop(0), ""))
    reading = ("read_surface", "read_volume", "read_flat_map", "read_flat_map")  # the last time nothing is chosen
    for command in ("write_flat_map", "write_flat_image", *reading):
        get_app_model().commands.execute_command(f"voxflat.{command}").result()
        qtbot.waitUntil(lambda: ViewerState.of(viewer).is_settled)
    assert all(path.is_file() for path in paths)
    assert [layer.name for layer in viewer.layers[1:]] == ["lh.white", "ones", "map (2) distortion"]
    assert not answers


def test_layers_without_a_map_are_not_saved_as_one(viewer, tmp_path):
    viewer.add_layer(Labels(cap(), name="sheet"))
    with pytest.raises(voxflat.VoxflatError, match=r"not belong to a flat map.* as 'voxflat flat image'"):
        viewer.layers.save(str(tmp_path / "a.voxflat"), plugin="voxflat")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("name", ["lh.white", "a.mgh", "lh.curv"])
def test_napari_does_not_wait_for_a_pipe(tmp_path, name):
    os.mkfifo(tmp_path / name)  # without a writer, which `open` would wait for in the window's thread
    with pytest.raises(voxflat.InputError, match=f"{name}: is not a regular file"):
        surface_reader(str(tmp_path / name))(str(tmp_path / name))


ENDINGS = (".gii", ".gii.gz", ".white", ".vtp", ".ply", ".stl", "map.npz", ".voxflat")
"""The files that napari opens only with voxflat."""


def test_a_session_from_files_to_files(make_napari_viewer, qtbot, tmp_path, messages):
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


def test_flat_labels_are_saved_by_the_map_with_their_pixels(viewer, qtbot, tmp_path):
    """Not by the displayed map, whose pixels have almost the same size."""
    points, faces, _ = bumps()
    state, maps = ViewerState.of(viewer), {}
    for name, of in (("first", points), ("second", 0.999 * points)):
        maps[name] = prepared_map_of(of, faces).run
        maps[name].title = name
        state.keeps_earlier = True
        state.add(maps[name])
    flat = maps["first"].layers.layers[-1]
    values = np.ones(flat[0].shape, dtype=int)
    values[:, : flat[0].shape[1] // 2] = 2
    place = {"scale": flat[1]["scale"], "translate": flat[1]["translate"]}
    assert state.current is maps["second"]
    labels = viewer.add_labels(values, name="painted", **place)
    assert flat[0].shape == maps["second"].layers.layers[-1][0].shape
    viewer.layers.selection = {labels}
    viewer.layers.save(str(tmp_path / "a.tsv"), selected=True, plugin="voxflat")
    maps["first"].flat_map.regions(values, pixel_size=flat[1]["scale"][0]).save(tmp_path / "expected.tsv")
    assert (tmp_path / "a.tsv").read_text() == (tmp_path / "expected.tsv").read_text()
    owner = QWidget()
    qtbot.addWidget(owner)
    offered = Segmentations(viewer, MovieWindow(viewer, owner))
    for name, count in (("second", 0), ("first", 1)):
        offered.offer(maps[name])
        assert offered.box.count() == count
    movie = MovieMaps(None, None)
    about = {"voxflat": None, KEPT: weakref.ref(movie)}  # as labels from the window of a movie have
    viewer.add_labels(np.ones((2, 1, 1, 4, 4), dtype=int), metadata=about)
    assert offered.box.count() == 1
    other = maps["second"].flat_map.image(points[:, 2], pixel_size=0.37)  # a size of its own, as in Python
    (u, v), size = other.origin, other.pixel_size
    fine = viewer.add_labels(np.ones(other.data.shape, dtype=int), name="fine", scale=(size,) * 2, translate=(-v, u))
    assert state.run_under(fine) is maps["second"]
    viewer.layers.selection = {fine}
    viewer.layers.save(str(tmp_path / "fine.tsv"), selected=True, plugin="voxflat")
    maps["second"].flat_map.regions(fine.data, pixel_size=size).save(tmp_path / "expected.tsv", overwrite=True)
    assert (tmp_path / "fine.tsv").read_text() == (tmp_path / "expected.tsv").read_text()
    same = Run(map_layers(maps["second"].flat_map, "same", pixel_size=size), "same")
    state.add(same)
    state.choose(maps["second"])
    state._over.clear()
    assert state.run_under(fine) is same  # whose image has these pixels
    viewer.layers.selection = {labels}
    labels.scale = np.array(labels.scale) * 1.00003
    with pytest.raises(voxflat.VoxflatError, match=r"not those of an open map \('first', 'second', 'same'\)"):
        viewer.layers.save(str(tmp_path / "b.tsv"), selected=True, plugin="voxflat")
    offered.release()
