"""Files that ended the process, hung it, took its memory or led to other files, one by one: each is one line now."""

import contextlib
import gzip
import json
import os
import signal
import struct
import time
import warnings
import zipfile

import fuzz_files
import numpy as np
import pytest
from mesh_files import nib, refuses
from PIL import Image

import voxflat
from voxflat.io import apart
from voxflat.io.channels import series_of
from voxflat.io.files import nibabel_image, one_line
from voxflat.io.label_tables import own_table
from voxflat.io.meshes import read_mesh
from voxflat.io.overlays import holds_volume, read_overlay, read_region
from voxflat.io.patches import read_patch
from voxflat.io.reading import reading
from voxflat.io.volumes import read_volume
from voxflat.maps.colours import all_whole
from voxflat.maps.parcels import parcels_of
from voxflat.maps.textures.pictures import as_picture, values_at
from voxflat.methods import Voxflat

META = (
    "ObjectType = Image\nNDims = 3\nDimSize = 8 8 5\nElementSpacing = 1 1 1\nElementType = MET_UCHAR\n"
    "ElementDataFile = LOCAL\n"
)
ENDED = "(ITK|VTK) (ended at it|was not done with it|says)|memory are needed|cannot be read|by its header"
NRRD = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 5\nencoding: raw\ndata file: v.raw\n\n"
VOLUMES = {
    "colon.mhd": (META.replace("ElementDataFile", "ElementDataFile : ../secret.raw ="), "is no MetaImage"),
    "printf.mhd": (META.replace("LOCAL", "x%n%n%n 1 2 1"), "and not in one file"),
    "list.mhd": (META.replace("LOCAL", "LIST"), "and not in one file"),
    "outside.mhd": (META.replace("LOCAL", "../secret.raw"), "outside its directory: copy them beside it"),
    "absolute.mhd": (META.replace("LOCAL", "/dev/zero"), "outside its directory"),
    "missing.mhd": (META.replace("LOCAL", "missing.raw"), "is not there: copy it, too"),
    "ndims.mha": (META.replace("NDims = 3", "NDims = -1"), ENDED),
    "many.mha": (META.replace("NDims = 3", "NDims = 100"), ENDED),
    "sizes.mha": (META.replace("8 8 5", "-8 8 5"), ENDED),
    "long.mha": (META.replace("8 8 5", "8 " * 2000), ENDED),
    "channels.mha": (META.replace("DimSize", "ElementNumberOfChannels = -3\nDimSize"), ENDED),
    "blanks.mha": (META.replace("NDims", "x" + " " * 60_000 + "\nNDims"), "is no MetaImage, or its header is damaged"),
    "printf.nhdr": (NRRD.replace("v.raw", "x%n%n 1 5 1 2"), "and not in one file"),
    "list.nhdr": (NRRD.replace("v.raw", "LIST\n../secret.raw"), "and not in one file"),
    "outside.nhdr": (NRRD.replace("v.raw", "../secret.raw"), "outside its directory"),
}


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(apart, "_SECONDS", 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", VOLUMES)
def test_headers_of_volumes(tmp_path, name):
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret.raw").write_bytes(bytes(320))
    text, message = VOLUMES[name]
    (folder / name).write_text(text)
    start = time.process_time()
    refuses(folder / name, message, read_volume)
    assert time.process_time() - start < 5


@pytest.mark.parametrize("bits", [0, 8, -16])
def test_bits_that_are_not_those_of_the_type(tmp_path, bits):
    path = tmp_path / "v.nii"
    nib.save(nib.Nifti1Image(np.ones((3, 4, 5), np.int16), np.eye(4)), path)
    data = bytearray(path.read_bytes())
    data[72:74] = struct.pack("<h", bits)
    path.write_bytes(data)
    refuses(path, f"of type 4 and {bits} bits, which is none", read_volume)


@pytest.mark.parametrize("shape", [(65536, 1, 1, 65537), (65536, 32768, 2, 3)])  # products are beyond 32 bits
def test_sizes_of_a_series_whose_product_is_too_large(tmp_path, shape):
    path = tmp_path / "t.mgh"
    nib.save(nib.MGHImage(np.ones((3, 4, 5, 2), np.float32), np.eye(4)), path)
    data = bytearray(path.read_bytes())
    data[4:20] = struct.pack(">4i", *shape)
    path.write_bytes(data)
    with pytest.raises(voxflat.InputError, match=r"ends after 784 of \d{11,} bytes"):
        series_of(path)


VTK = (
    "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 9 0 0 0 9 0\nPOLYGONS 1 4\n3 0 1 2\n"
)
VTP = (
    '<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData>'
    '<Piece NumberOfPoints="3" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="1">'
    '<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 9 0 0 0 9 0</DataArray></Points>'
    '<Polys><DataArray type="Int32" Name="connectivity" format="ascii">0 1 2</DataArray>'
    '<DataArray type="Int32" Name="offsets" format="ascii">3</DataArray></Polys></Piece></PolyData></VTKFile>'
)
GIFTI = (
    '<?xml version="1.0"?><GIFTI Version="1.0" NumberOfDataArrays="1"><DataArray Intent="NIFTI_INTENT_POINTSET" '
    'DataType="NIFTI_TYPE_FLOAT32" ArrayIndexingOrder="RowMajorOrder" Dimensionality="2" Dim0="1" Dim1="3" '
    'Encoding="ASCII" Endian="LittleEndian"><Data>0 0 0</Data></DataArray></GIFTI>'
)
MESHES = {
    "tab.vtk": (VTK.replace("POLYGONS 1 4", "POLYGONS\t1\t400000000"), ENDED),
    "blank.vtk": (VTK.replace("POLYGONS 1 4", " POLYGONS 1 5"), ENDED),
    "same_line.vtk": (VTK.replace("0\nPOLYGONS 1 4", "0 POLYGONS 90 4"), ENDED),
    "minus.vtk": (VTK.replace("POLYGONS 1 4", "POLYGONS -1 -4"), ENDED),
    "points.vtk": (VTK.replace("POINTS 3", " POINTS -3"), ENDED),
    "strings.vtk": (VTK + "POINT_DATA 3\nFIELD f 1\nname 1 300000000 string\na\n", ENDED),
    "field.vtk": (VTK + "\tPOINT_DATA 3\n FIELD f 1\nname -3 3 double\n1\n", ENDED),
    "quotes.vtp": (VTP.replace('NumberOfPoints="3"', "NumberOfPoints='-3'"), ENDED),
    "blanks.vtp": (VTP.replace('NumberOfPolys="1"', 'NumberOfPolys = "-1"'), "has no faces"),
    "components.vtp": (VTP.replace('Components="3"', "Components = '-3'"), ENDED),
    "tags.vtp": (VTP + "<Piece NumberOfPoints\n" * 100_000, ENDED),
    "axes.surf.gii": (GIFTI.replace('ity="2"', 'ity="2000000000"'), "has 2000000000 dimensions"),
    "nested.surf.gii": (GIFTI.replace("<Data>", "<Data>" * 9).replace("</Data>", "</Data>" * 9), "within its data"),
    "lines.stl": ("solid x\n" + "\n" * 200_000 + "endsolid", "no points|in 0 facets"),
    "lines.vtk": ("# vtk DataFile Version 3.0\nx\nASCII\n" + "\n" * 200_000, "damaged header"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_headers_of_meshes(tmp_path, name, capfd):
    text, message = MESHES[name]
    (tmp_path / name).write_text(text)
    start = time.process_time()
    refuses(tmp_path / name, message)
    assert time.process_time() - start < 10
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_what_those_were_made_of_is_read(tmp_path, monkeypatch):
    """Words of VTK may also be names of arrays."""
    monkeypatch.setattr(apart, "_SECONDS", 5)  # the first file that is read loads more of ITK
    more = VTK + "POINT_DATA 3\nFIELD f 1\nlines 1 3 float\n1 2 3\n"
    for name, text in {"s.vtk": VTK, "more.vtk": more, "s.vtp": VTP}.items():
        (tmp_path / name).write_text(text)
        assert len(read_mesh(tmp_path / name).faces) == 1
    (tmp_path / "blanks.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\n" + "\n" * 200_000 + "f 1 2 3\n")
    assert len(read_mesh(tmp_path / "blanks.obj").faces) == 1
    (tmp_path / "v.raw").write_bytes(bytes(range(64)) * 5)
    for name, text in {"v.mhd": META.replace("LOCAL", "v.raw"), "v.nhdr": NRRD}.items():
        (tmp_path / name).write_text(text)
        assert read_volume(tmp_path / name).data[3, 1, 2] == 11


@pytest.fixture(scope="module")
def flat_map():
    volume = np.zeros((8, 8, 5), np.uint8)
    volume[:, :, 2] = 1
    return voxflat.flatten(volume, Voxflat(sources=9))


def _too_late(_number, _frame):
    raise TimeoutError


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_no_file_of_any_format_is_a_pipe(tmp_path):
    """Nor one that belongs to it: voxels, pictures, chunks, arrays of a store. It would be waited for."""
    asked = [(entry, file) for entry in fuzz_files.corpus(tmp_path) for file in entry.files]
    before = signal.signal(signal.SIGALRM, _too_late)
    told = {}
    for entry, file in asked:
        data = file.read_bytes()
        file.unlink()
        os.mkfifo(file)
        signal.alarm(20)
        try:
            fuzz_files.OPENERS[entry.opener](entry.folder / entry.main)
        except voxflat.InputError as error:
            told[entry.main, file.relative_to(entry.folder).as_posix()] = str(error)
        finally:
            signal.alarm(0)
            file.unlink()
            file.write_bytes(data)
    signal.signal(signal.SIGALRM, before)
    others = {name for name, text in told.items() if "is no regular file" not in text}
    # what says where the voxels lie is looked for first
    assert others == {("text.nhdr", "v.raw"), ("raw.mhd", "v.raw"), ("t.zarr", "t.zarr/.zattrs")}
    unread = {(entry.main, file.relative_to(entry.folder).as_posix()) for entry, file in asked} - set(told)
    assert unread == {("t.zarr", "t.zarr/.zgroup")}  # nothing asks for it


def test_pictures_of_other_kinds(tmp_path):
    """Pillow would run a program for PostScript."""
    (tmp_path / "p.png").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\nshowpage\n")
    with pytest.raises(voxflat.InputError, match=r"p\.png: cannot identify image file"):
        as_picture(tmp_path / "p.png")


@pytest.mark.parametrize("start", ["[", '{"cuts":', '{"a":'])
def test_json_that_is_nested_deeply(tmp_path, flat_map, start):
    path = tmp_path / "deep.json"
    path.write_text(start + "[" * 100_000)
    volume = np.zeros((8, 8, 5), np.uint8)
    volume[:, :, 2] = 1
    for read in (flat_map.regions, lambda path: voxflat.surface(volume).cut(cuts=path)):
        with pytest.raises(voxflat.InputError, match=r"deep\.json.* nested too deeply"):
            read(path)


def changed(path, name, change):
    """Write an archive again, with one array or the text changed."""
    with np.load(path) as file:
        arrays = dict(file)
    if name in arrays:
        arrays[name] = change(arrays[name])
    else:
        key = "metadata" if "metadata" in arrays else "text"
        told = json.loads(str(arrays[key]))
        within = told if key == "metadata" else told["metadata"]
        within[name] = change(within.get(name))
        arrays[key] = np.array(json.dumps(told))
    np.savez(path, **arrays)


CHANGES = {
    "fewer places": ("uv", lambda uv: uv[:-1]),
    "places in space": ("uv", lambda uv: np.column_stack([uv, uv])),
    "NaN": ("uv", lambda uv: uv * np.nan),
    "places at the edge of the universe": ("uv", lambda uv: uv + 1e300),
    "places in half precision": ("uv", lambda uv: (uv + np.inf).astype(np.float16)),
    "points there": ("points", lambda points: points + 1e12),
    "words for a record": ("provenance", lambda record: "x"),
    "other points": ("points", lambda points: points[:9]),
    "complex points": ("points", lambda points: points * 1j),
    "a corner too far": ("faces", lambda faces: faces + 1),
    "text for faces": ("faces", lambda faces: np.array("x")),
    "a voxel outside": ("ids", lambda ids: ids + 99),
    "flat ids": ("ids", np.ravel),
    "no shape": ("shape", lambda shape: None),
    "a shape of words": ("shape", lambda shape: ["x", 1, 2]),
    "an affine of two rows": ("affine", lambda affine: affine[:2]),
    "another kind": ("kind", lambda kind: "dream"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_arrays_that_do_not_fit_each_other(tmp_path, flat_map, name):
    flat_map.save(tmp_path / "map.npz")
    changed(tmp_path / "map.npz", *CHANGES[name])
    with pytest.raises(voxflat.InputError, match=r"map\.npz: .*: copy it again"):
        voxflat.load(tmp_path / "map.npz")


@pytest.mark.parametrize("value", ["NaN", "-Infinity", "1e400"])
def test_numbers_that_json_does_not_have(tmp_path, flat_map, atlas, value):
    """They are read by Python, and could not be written again."""
    for made, load in ((flat_map, voxflat.load), (atlas, voxflat.load_atlas)):
        path = tmp_path / f"{load.__name__}.npz"
        made.save(path)
        with np.load(path) as file:
            arrays = dict(file)
        key = "metadata" if "metadata" in arrays else "text"
        arrays[key] = np.array(str(arrays[key]).replace("{", f'{{"x": {value}, ', 1))
        np.savez(path, **arrays)
        with pytest.raises(voxflat.InputError, match=rf"{path.name} is not an? .* or is damaged \(ValueError\)"):
            load(path)


LARGE = (
    b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '|u1', 'fortran_order': False, 'shape': (73014444015,), }".ljust(117)
    + b"\n"
)


def test_arrays_that_are_larger_than_their_file(tmp_path, flat_map, atlas):
    """Their memory was taken before they were read."""
    (tmp_path / "rois.npy").write_bytes(LARGE)
    refuses(tmp_path / "rois.npy", r"ends after 128 of 73014444143 bytes", flat_map.regions)
    for made, load, name in ((flat_map, voxflat.load, "uv"), (atlas, voxflat.load_atlas, "points")):
        path = tmp_path / f"{name}.npz"
        made.save(path)
        with zipfile.ZipFile(path) as archive:
            members = {member: archive.read(member) for member in archive.namelist()}
        with zipfile.ZipFile(path, "w") as archive:
            for member, content in {**members, f"{name}.npy": LARGE}.items():
                archive.writestr(member, content)
        refuses(path, r"ends after 128 of 73014444143 bytes", load)


@pytest.fixture(scope="module")
def atlas():
    volume = np.zeros((8, 8, 5), np.uint8)
    volume[:, :, 2] = 1
    return voxflat.surface(volume).patches(bound=1.2)


PIECES = {
    "starts beyond": ("starts", lambda starts: starts + 1),
    "no starts": ("starts", lambda starts: starts[:0]),
    "piece beyond": ("piece_ids", lambda ids: ids + 1),
    "places at the edge of the universe": ("uv", lambda uv: uv + 1e300),
    "measured nothing": ("measured", lambda measured: measured[:, :1]),
    "unsigned starts of large pieces": ("starts", lambda starts: starts.astype(np.uint64) + 2**63),
    "fractional pieces": ("piece_ids", lambda ids: ids + 0.5),
}


@pytest.mark.parametrize("name", PIECES)
def test_pieces_that_do_not_fit_each_other(tmp_path, atlas, name):
    atlas.save(tmp_path / "atlas.npz")
    changed(tmp_path / "atlas.npz", *PIECES[name])
    with pytest.raises(voxflat.InputError, match=r"atlas\.npz: .*: copy it again"):
        voxflat.load_atlas(tmp_path / "atlas.npz")


@pytest.mark.parametrize("value", ["x", None, [], True])
@pytest.mark.parametrize("name", ["certificate", "seams", "bound"])
def test_figures_of_an_atlas_that_are_no_numbers(tmp_path, atlas, name, value):
    """They were shown, or compared, long after the file was loaded."""
    path = tmp_path / "atlas.npz"
    (atlas if name == "certificate" else atlas.glue()).save(path)
    with np.load(path) as file:
        arrays = dict(file)
    told = json.loads(str(arrays["text"]))
    if name == "bound":
        told[name] = value
    else:
        told[name][next(iter(told[name]))] = value
    np.savez(path, **{**arrays, "text": np.array(json.dumps(told))})
    with pytest.raises(voxflat.InputError, match=r"atlas\.npz is not an atlas of voxflat or is damaged"):
        voxflat.load_atlas(path)


def test_bytes_in_the_other_order(tmp_path, flat_map):
    flat_map.save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as file:
        np.savez(tmp_path / "map.npz", **{name: one.astype(one.dtype.newbyteorder(">")) for name, one in file.items()})
    found = voxflat.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(found.heat_map().data, flat_map.heat_map().data)


@pytest.mark.parametrize(
    ("floats", "integers"), [(np.float32, np.int32), (np.longdouble, np.uint64), (np.float64, np.int16)]
)
def test_numbers_of_other_sizes(tmp_path, flat_map, atlas, floats, integers):
    """The core takes one size of each: what it was written in is what it is read as."""
    change = {"f": floats, "i": integers, "u": integers}
    for made, load in ((flat_map, voxflat.load), (atlas, voxflat.load_atlas)):
        path = tmp_path / f"{load.__name__}.npz"
        made.save(path)
        with np.load(path) as file:
            arrays = {name: one.astype(change.get(one.dtype.kind, one.dtype)) for name, one in file.items()}
            types = {name: one.dtype for name, one in file.items() if one.dtype.kind in "iuf"}
        np.savez(path, **arrays)
        found = load(path)
        for name in types.keys() & vars(found).keys():
            assert getattr(found, name).dtype == types[name], name
        shown, known = ((one if load is voxflat.load else one.page()).heat_map().data for one in (found, made))
        np.testing.assert_allclose(shown, known, atol=1e-4)


def test_whole_numbers_beyond_those_of_a_map(tmp_path, flat_map):
    flat_map.save(tmp_path / "map.npz")
    changed(tmp_path / "map.npz", "bridges", lambda bridges: np.full((1, 3), 2**63, np.uint64))
    refuses(tmp_path / "map.npz", r"its bridges are not all from -9223372036854775808 to", voxflat.load)


@pytest.mark.parametrize("area", [0, -1, np.nan, np.inf])
def test_an_atlas_whose_pieces_have_no_area(tmp_path, atlas, area):
    def other(measured):
        measured[:, -3] = area
        return measured

    atlas.save(tmp_path / "atlas.npz")
    changed(tmp_path / "atlas.npz", "measured", other)
    refuses(tmp_path / "atlas.npz", r"its pieces have the areas .* mm²", voxflat.load_atlas)


def test_areas_of_an_atlas_in_numbers_that_hold_no_limit_of_ours(tmp_path, atlas):
    atlas.save(tmp_path / "atlas.npz")
    changed(tmp_path / "atlas.npz", "measured", lambda measured: measured.astype(np.float16))
    with warnings.catch_warnings(action="error"):
        voxflat.load_atlas(tmp_path / "atlas.npz")


def test_unsigned_numbers_of_an_atlas(tmp_path, atlas):
    atlas.save(tmp_path / "atlas.npz")
    changed(tmp_path / "atlas.npz", "starts", lambda starts: starts.astype(np.uint64))
    assert voxflat.load_atlas(tmp_path / "atlas.npz").page().used_share == atlas.page().used_share


def test_an_error_of_a_reader_that_repeats_the_file(tmp_path):
    """What is left out of messages of C++ was looked for from each of its letters on: minutes."""
    start = time.process_time()
    assert len(one_line(ValueError("x" * 10_000_000))) <= 200
    assert time.process_time() - start < 1


def test_cuts_in_a_damaged_gzip(tmp_path):
    packed = bytearray(gzip.compress(b'{"cuts": [[[0, 3, 2], [1, 3, 2]]]}' + b" " * 5000))
    packed[12:20] = b"\xff" * 8
    (tmp_path / "cuts.json").write_bytes(packed)
    volume = np.zeros((8, 8, 5), np.uint8)
    volume[:, :, 2] = 1
    with pytest.raises(voxflat.InputError, match=r"cuts\.json is no file of cuts: "):
        voxflat.surface(volume).cut(cuts=tmp_path / "cuts.json")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("lh.V1.label", "#!ascii\n1\ninf 0 0 0 0\n", "line 3 names point inf; the surface has the points 0 to 63"),
        ("lh.V1.label", "#!ascii\n1\nnan 0 0 0 0\n", "line 3 names point nan; the surface has the points 0 to 63"),
        ("v.txt", "# nothing\n", "has 0 values; the surface has 64 points"),
    ],
)
def test_text_of_no_numbers_or_none_prints_no_warning(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refuses(tmp_path / name, message, read_region, 64)


def test_a_place_in_an_mgh_file_that_none_has(tmp_path):
    """The system's error of looking for it names no file."""
    nib.save(nib.MGHImage(np.ones((64, 1, 1), np.float32), np.eye(4)), tmp_path / "v.mgh")
    data = bytearray((tmp_path / "v.mgh").read_bytes())
    data[4:20] = struct.pack(">4i", -64, 1, 1, 1)
    (tmp_path / "v.mgh").write_bytes(data)
    assert holds_volume(tmp_path / "v.mgh")
    with pytest.raises(voxflat.InputError):
        read_volume(tmp_path / "v.mgh")


def test_nan_where_nobody_asks_prints_no_warning(tmp_path):
    """Signalling NaN in CIFTI, which casts tell of, and in the place of MGH files."""
    values = np.ones((1, 64), np.float32)
    brain = nib.cifti2.BrainModelAxis.from_mask(np.ones(64, bool), "CortexLeft")
    nib.save(nib.Cifti2Image(values, (nib.cifti2.ScalarAxis(["a"]), brain)), tmp_path / "v.dscalar.nii")
    nib.save(nib.MGHImage(values.reshape(64, 1, 1), np.eye(4)), tmp_path / "v.mgh")
    data = bytearray((tmp_path / "v.dscalar.nii").read_bytes())
    data[-4:] = struct.pack("<I", 0x7FA00000)
    (tmp_path / "v.dscalar.nii").write_bytes(data)
    data = bytearray((tmp_path / "v.mgh").read_bytes())
    data[30:50] = struct.pack(">5I", *[0x7FA00000] * 5)
    (tmp_path / "v.mgh").write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_overlay(tmp_path / "v.dscalar.nii", 64)
        assert np.isnan(found[-1])
        assert (found[:-1] == 1).all()
        assert (read_overlay(tmp_path / "v.mgh", 64) == 1).all()


def test_what_nibabel_changes_is_logged_with_the_file(tmp_path, capfd, caplog):
    path = tmp_path / "v.mgh"
    nib.save(nib.MGHImage(np.ones((3, 4, 5), np.float32), np.eye(4)), path)
    data = bytearray(path.read_bytes())
    data[3] = 9  # the version
    path.write_bytes(data)
    with caplog.at_level("WARNING", "voxflat"), contextlib.suppress(voxflat.InputError):
        read_volume(path)
    assert f"{path}: Unknown MGH format version" in caplog.text
    assert capfd.readouterr() == ("", "")
    nib.imageglobals.logger.warning("of others")
    assert "of others" in caplog.text


@pytest.mark.parametrize("greatest", [800_000_000, -5])
def test_colour_tables_of_no_size(tmp_path, greatest):
    path = tmp_path / "lh.annot"
    nib.freesurfer.write_annot(path, np.zeros(4, int), np.array([[1, 2, 3, 0, 0]]), ["a"], fill_ctab=True)
    data = bytearray(path.read_bytes())
    data[44:48] = struct.pack(">i", greatest)
    path.write_bytes(data)
    for read in (own_table, lambda path: read_overlay(path, 4)):
        refuses(path, "colours by its header, which is damaged", read)


def test_headers_of_arrays_that_end_in_a_string(tmp_path):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3,"
    (tmp_path / "v.npy").write_bytes(b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head)
    assert holds_volume(tmp_path / "v.npy")  # those who read it say what is wrong
    refuses(tmp_path / "v.npy", "", read_volume)


@pytest.mark.parametrize("name", ["v.npy", "v.npz"])  # by its contents an array
def test_arrays_whose_bytes_no_number_counts(tmp_path, name):
    head = b"{'descr': '<f4', 'fortran_order': False, 'shape': (9223372036854775807,), }".ljust(117) + b"\n"
    (tmp_path / name).write_bytes(b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head)
    with warnings.catch_warnings(action="error"):  # NumPy's, of the product
        refuses(tmp_path / name, "ends after 128 of 36893488147419103356 bytes", lambda path: read_overlay(path, 4))
        holds_volume(tmp_path / name)


def test_what_nibabel_warns_of_is_logged_with_the_file(tmp_path, caplog):
    path = tmp_path / "a.nii"
    image = nib.Nifti1Image(np.ones((3, 4, 5), np.int16), np.eye(4))
    image.header.extensions.append(nib.nifti1.Nifti1Extension("comment", b"x"))
    nib.save(image, path)
    data = bytearray(path.read_bytes())
    data[352:356] = struct.pack("<i", 17)
    path.write_bytes(data)
    with warnings.catch_warnings(action="error"), pytest.raises(nib.spatialimages.HeaderDataError):
        nibabel_image(path)
    assert f"{path}: Extension size is not a multiple of 16 bytes" in caplog.text


@pytest.fixture(scope="module")
def sheet():
    """The map of a mesh of 36 points."""
    i, j = np.indices((6, 6)).reshape(2, -1)
    corner = np.arange(36).reshape(6, 6)[:-1, :-1].ravel()
    faces = np.concatenate([corner[:, None] + [0, 6, 1], corner[:, None] + [1, 6, 7]])
    return voxflat.flatten((np.column_stack([5.0 * i, 5.0 * j, 0 * i]), faces), method=Voxflat(sources=9))


def damaged_tag(path, shape, tag, kind, change):
    """Write a small TIFF of which one entry of the directory, 12 bytes, is changed."""
    Image.fromarray(np.ones(shape, np.uint8)).save(path, tiffinfo={270: "Pixel size: 1 mm"})
    data = path.read_bytes()
    at = data.index(struct.pack("<HH", tag, kind))
    path.write_bytes(data[:at] + change(data[at : at + 12]) + data[at + 12 :])


def test_tags_of_a_picture_that_are_damaged_are_not_told(tmp_path, sheet):
    path = tmp_path / "rois.tif"
    damaged_tag(path, (4, 4), 270, 2, lambda entry: entry[:4] + struct.pack("<L", 10**8) + entry[8:])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with pytest.raises(voxflat.InputError, match=r"rois\.tif: the label image has 4 x 4 pixels"):
            sheet.regions(path)
        assert (as_picture(path)[0] == 1).all()
    assert not told


@pytest.mark.parametrize("read", [as_picture, "regions"])
def test_what_pillow_logs_of_a_picture_is_told_by_us_with_the_file(tmp_path, sheet, caplog, read):
    """More channels than it reads."""
    path = tmp_path / "rois.tif"
    damaged_tag(path, (4, 4, 3), 277, 3, lambda entry: entry[:8] + struct.pack("<L", 99))
    with pytest.raises(voxflat.InputError, match=r"rois\.tif"):
        (sheet.regions if read == "regions" else read)(path)
    assert [record.name for record in caplog.records] == ["voxflat"]
    assert f"{path}: More samples per pixel than can be decoded: 99" in caplog.text


@pytest.mark.parametrize("read", [as_picture, "regions"])
def test_what_decoders_of_pictures_print_is_not_seen(tmp_path, sheet, capfd, read):
    """A fax of 8 bits a pixel, of which the decoder, in C, prints a line of its own."""
    path = tmp_path / "rois.tif"
    damaged_tag(path, (4, 4), 259, 3, lambda entry: entry[:8] + struct.pack("<L", 4))
    with pytest.raises(voxflat.InputError, match=r"rois\.tif: decoder error -2"):
        (sheet.regions if read == "regions" else read)(path)
    assert capfd.readouterr() == ("", "")


def test_what_a_picture_takes_is_known_before_it_is_decoded(tmp_path, sheet):
    path = tmp_path / "rois.png"
    Image.new("L", (12_000, 12_000)).save(path)
    with reading(1 << 30), pytest.raises(voxflat.InputError, match=r"rois\.png: .*3\.22 GiB of memory are needed"):
        as_picture(path)
    with reading(1 << 30), pytest.raises(voxflat.InputError, match=r"rois\.png: .*3\.22 GiB of memory are needed"):
        sheet.regions(path)


def signalling(shape):
    return np.full(shape, 0x7FA00000, np.uint32).view(np.float32)


def test_values_that_are_no_whole_numbers_or_signal_print_no_warning(sheet):
    """NaN that signals is NaN, and what 64 bits do not hold no label."""
    values = np.ones(36, np.float32)
    labels = np.ones(sheet.raster(1.0).shape, np.float32)
    with warnings.catch_warnings(action="error"):
        assert all_whole(signalling(3))
        values[:6] = 1e30
        assert (parcels_of(sheet, values).labels != 1).sum() == 6
        labels[:] = 1e30
        with pytest.raises(voxflat.InputError, match="labels"):
            sheet.regions(labels, pixel_size=1.0)


def test_numbers_of_patches_and_labels_that_are_none_are_refused_without_a_warning(tmp_path):
    (tmp_path / "lh.patch").write_bytes(struct.pack(">3i3I", -1, 1, 1, *[0x7FA00000] * 3))
    brain = nib.cifti2.BrainModelAxis.from_mask(np.ones(64, bool), "CortexLeft")
    names = nib.cifti2.LabelAxis(["a"], [{0: ("x", (0, 0, 0, 0))}])
    nib.save(nib.Cifti2Image(np.full((1, 64), np.inf, np.float32), (names, brain)), tmp_path / "v.dlabel.nii")
    with warnings.catch_warnings(action="error"):
        refuses(tmp_path / "lh.patch", r"entry 0 of the patch lies at \[nan, nan, nan\]", read_patch)
        refuses(tmp_path / "v.dlabel.nii", "has the label inf", read_overlay, 64)


def test_pictures_of_half_precision_are_looked_up_as_others():
    coordinates = np.random.default_rng(0).random((9, 2))
    picture = np.arange(16.0).reshape(4, 4)
    for kind in (np.float16, np.longdouble):
        np.testing.assert_array_equal(values_at(picture.astype(kind), coordinates), values_at(picture, coordinates))
