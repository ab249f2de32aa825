"""Files that ended the process, blocked it, used up its memory or referred to other files cause a one-line error."""

import contextlib
import gzip
import json
import os
import re
import signal
import struct
import time
import zipfile
from unittest.mock import Mock

import fuzz_files
import numcodecs
import numpy as np
import pytest
from mesh_files import grid, nib, patch, refuses
from PIL import Image
from PIL import __version__ as pillow
from refusals import refused, warnings_as_errors

import voxflat
from voxflat.io import subprocess_reader
from voxflat.io.channels import series_of
from voxflat.io.files import nibabel_image, one_line
from voxflat.io.label_tables import own_table
from voxflat.io.meshes import read_mesh
from voxflat.io.overlays import holds_volume, read_overlay, read_region
from voxflat.io.patches import read_patch
from voxflat.io.reading import reading
from voxflat.io.volumes import read_volume
from voxflat.lab.freshness import state
from voxflat.lab.group import _reason
from voxflat.lab.results import Results
from voxflat.maps.colours import all_whole
from voxflat.maps.parcels import parcels_of
from voxflat.maps.textures.pictures import as_picture, values_at
from voxflat.methods import Voxflat

META = "ObjectType = Image\nNDims = 3\nDimSize = 8 8 5\nElementSpacing = 1 1 1\nElementType = MET_UCHAR\n"
META += "ElementDataFile = LOCAL\n"
ENDED = "(ITK|VTK) (ended while it read|did not finish|reports)|memory is needed|cannot be read|its header specifies"
NRRD = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 5\nencoding: raw\ndata file: v.raw\n\n"
VOLUMES = {
    "colon.mhd": (META.replace("ElementDataFile", "ElementDataFile : ../secret.raw ="), "is not a MetaImage"),
    "printf.mhd": (META.replace("LOCAL", "x%n%n%n 1 2 1"), "instead of one file"),
    "list.mhd": (META.replace("LOCAL", "LIST"), "instead of one file"),
    "outside.mhd": (META.replace("LOCAL", "../secret.raw"), "outside its directory. Copy that file into the directory"),
    "absolute.mhd": (META.replace("LOCAL", "/dev/zero"), "outside its directory"),
    "missing.mhd": (META.replace("LOCAL", "missing.raw"), "does not exist. Copy that file too"),
    "ndims.mha": (META.replace("NDims = 3", "NDims = -1"), ENDED),
    "many.mha": (META.replace("NDims = 3", "NDims = 100"), ENDED),
    "sizes.mha": (META.replace("8 8 5", "-8 8 5"), ENDED),
    "long.mha": (META.replace("8 8 5", "8 " * 2000), ENDED),
    "channels.mha": (META.replace("DimSize", "ElementNumberOfChannels = -3\nDimSize"), ENDED),
    "blanks.mha": (META.replace("NDims", "x" + " " * 60_000 + "\nNDims"), "is not a MetaImage file, or its header"),
    "printf.nhdr": (NRRD.replace("v.raw", "x%n%n 1 5 1 2"), "instead of one file"),
    "list.nhdr": (NRRD.replace("v.raw", "LIST\n../secret.raw"), "instead of one file"),
    "outside.nhdr": (NRRD.replace("v.raw", "../secret.raw"), "outside its directory"),
    "cr.nhdr": (NRRD.replace("v.raw", "../secret.raw").replace("\n", "\r"), "outside its directory"),
}


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(subprocess_reader, "_SECONDS", 1)


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
    patch(path, {72: struct.pack("<h", bits)})
    refuses(path, f"voxel type 4 with {bits} bits does not exist", read_volume)


@pytest.mark.parametrize("shape", [(65536, 1, 1, 65537), (65536, 32768, 2, 3)])  # products are beyond 32 bits
def test_sizes_of_a_series_whose_product_is_too_large(tmp_path, shape):
    path = tmp_path / "t.mgh"
    nib.save(nib.MGHImage(np.ones((3, 4, 5, 2), np.float32), np.eye(4)), path)
    patch(path, {4: struct.pack(">4i", *shape)})
    refused(r"ends after 784 of \d{11,} bytes", series_of, path)


HEAD = "# vtk DataFile Version 3.0\nx\nASCII\n"
VTK = f"{HEAD}DATASET POLYDATA\nPOINTS 3 float\n0 0 0 9 0 0 0 9 0\nPOLYGONS 1 4\n3 0 1 2\n"
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
    "lines.vtk": (HEAD + "\n" * 200_000, "damaged header"),
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
    """Keywords of VTK may also be names of arrays."""
    monkeypatch.setattr(subprocess_reader, "_SECONDS", 5)  # the first file loads more parts of ITK
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


def sheet_of_voxels():
    return voxflat.surface(np.pad(np.ones((8, 8, 1), np.uint8), [(0, 0), (0, 0), (2, 2)]))


@pytest.fixture(scope="module")
def flat_map():
    return sheet_of_voxels().flatten(Voxflat(sources=9))


@pytest.fixture(scope="module")
def atlas():
    return sheet_of_voxels().patches(bound=1.2)


RECORD = "sub-01_hemi-L_flat.json"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_no_file_of_any_format_is_a_pipe(tmp_path):
    """The same applies to files of voxels, pictures, chunks and arrays of a store. Reading a pipe would block."""
    asked = [(entry, file) for entry in fuzz_files.corpus(tmp_path) for file in entry.files]
    before = signal.signal(signal.SIGALRM, Mock(side_effect=TimeoutError))
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
    others = {name for name, text in told.items() if "is not a regular file" not in text}
    # the reader first looks for the position of the voxels, and for the results of a participant
    assert {main for main, _ in others} == {"t.zarr", "v2.zarr", "blosc.zarr", "v3.zarr", "shards.zarr", RECORD}
    assert {file.rpartition("/")[2] for main, file in others if main != RECORD} == {".zattrs", "zarr.json"}
    unread = {(entry.main, file.relative_to(entry.folder).as_posix()) for entry, file in asked} - set(told)
    assert {file.rpartition("/")[2] for _, file in unread} == {".zgroup"}  # never read


def test_pictures_of_other_kinds(tmp_path):
    """Pillow would run a program for PostScript."""
    (tmp_path / "p.png").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\nshowpage\n")
    refused(r"p\.png: cannot identify image file", as_picture, tmp_path / "p.png")


@pytest.mark.parametrize("start", ["[", '{"cuts":', '{"a":'])
def test_json_that_is_nested_deeply(tmp_path, flat_map, start):
    path = tmp_path / "deep.json"
    path.write_text(start + "[" * 100_000)
    for read in (flat_map.regions, sheet_of_voxels().cut):
        refused(r"deep\.json.* nested too deeply", read, path)


def changed(made, path, change):
    """Save a map or an atlas with changed arrays, or with a changed text as a dictionary; return the path."""
    made.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    key = "metadata" if "metadata" in arrays else "text"
    arrays[key] = json.loads(str(arrays[key]))
    change(arrays)
    if isinstance(arrays[key], dict):
        arrays[key] = json.dumps(arrays[key])
    np.savez(path, **arrays)
    return path


def other(name, change):
    """Return a change of one array, or of a value of the metadata."""

    def changes(arrays):
        within = arrays if name in arrays else arrays.get("metadata") or arrays["text"]["metadata"]
        within[name] = change(within.get(name))

    return changes


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
    refuses(changed(flat_map, tmp_path / "map.npz", other(*CHANGES[name])), ": .*[.:] Copy or down", voxflat.load)


@pytest.mark.parametrize("value", ["NaN", "-Infinity", "1e400"])
def test_numbers_that_json_does_not_have(tmp_path, flat_map, atlas, value):
    """Python reads them, but they could not be written again."""

    def change(arrays):
        key = "metadata" if "metadata" in arrays else "text"
        arrays[key] = json.dumps(arrays[key]).replace("{", f'{{"x": {value}, ', 1)

    for made, load in ((flat_map, voxflat.load), (atlas, voxflat.load_atlas)):
        refuses(changed(made, tmp_path / "x.npz", change), r"is not an? .* or is damaged \(ValueError\)", load)


LARGE = b"{'descr': '|u1', 'fortran_order': False, 'shape': (73014444015,), }".ljust(117) + b"\n"
LARGE = b"\x93NUMPY\x01\x00v\x00" + LARGE


def test_arrays_that_are_larger_than_their_file(tmp_path, flat_map, atlas):
    """Memory was allocated before they were read."""
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
    refuses(changed(atlas, tmp_path / "atlas.npz", other(*PIECES[name])), ": .*[.:] Copy or", voxflat.load_atlas)


@pytest.mark.parametrize("value", ["x", None, [], True])
@pytest.mark.parametrize("name", ["certificate", "seams", "bound"])
def test_figures_of_an_atlas_that_are_no_numbers(tmp_path, atlas, name, value):
    """They are used long after the file is loaded."""

    def change(arrays):
        told = arrays["text"]
        told[name] = value if name == "bound" else {**told[name], next(iter(told[name])): value}

    path = changed(atlas if name == "certificate" else atlas.glue(), tmp_path / "atlas.npz", change)
    refuses(path, "its key '(angle|length|bound)' is .* instead of a number", voxflat.load_atlas)


def arrays_of(path, change):
    """Write an archive again with each array changed; return the written arrays."""
    with np.load(path) as file:
        arrays = {name: change(one) for name, one in file.items()}
    np.savez(path, **arrays)
    return arrays


def test_bytes_in_the_other_order(tmp_path, flat_map):
    flat_map.save(tmp_path / "map.npz")
    arrays_of(tmp_path / "map.npz", lambda one: one.astype(one.dtype.newbyteorder(">")))
    np.testing.assert_array_equal(voxflat.load(tmp_path / "map.npz").heat_map().data, flat_map.heat_map().data)


@pytest.mark.parametrize(("floats", "integers"), [("f4", "i4"), (np.longdouble, "u8"), ("f8", "i2")])
def test_numbers_of_other_sizes(tmp_path, flat_map, atlas, floats, integers):
    """Arrays are read in the types in which they were written, because the core accepts only these."""
    kinds = {"f": floats, "i": integers, "u": integers}
    for made, load in ((flat_map, voxflat.load), (atlas, voxflat.load_atlas)):
        made.save(tmp_path / "x.npz")
        types = {name: one.dtype for name, one in arrays_of(tmp_path / "x.npz", lambda one: one).items()}
        types = {name: kind for name, kind in types.items() if kind.kind in kinds}
        arrays_of(tmp_path / "x.npz", lambda one: one.astype(kinds.get(one.dtype.kind, one.dtype)))
        found = load(tmp_path / "x.npz")
        for name in types.keys() & vars(found).keys():
            assert getattr(found, name).dtype == types[name], name
        shown, known = ((one if load is voxflat.load else one.page()).heat_map(0.73).data for one in (found, made))
        np.testing.assert_allclose(shown, known, atol=1e-4)


def test_whole_numbers_beyond_those_of_a_map(tmp_path, flat_map):
    path = changed(flat_map, tmp_path / "map.npz", other("bridges", lambda _: np.full((1, 3), 2**63, np.uint64)))
    refuses(path, r"its array bridges has values outside the range -9223372036854775808 to", voxflat.load)


@pytest.mark.parametrize("area", [0, -1, np.nan, np.inf])
def test_an_atlas_whose_pieces_have_no_area(tmp_path, atlas, area):
    columns = np.arange(atlas.measured.shape[1])
    without = other("measured", lambda measured: np.where(columns == len(columns) - 3, area, measured))
    path = changed(atlas, tmp_path / "atlas.npz", without)
    refuses(path, r"the areas of its pieces are not valid: .* mm²", voxflat.load_atlas)


@pytest.mark.parametrize(("name", "kind"), [("measured", np.float16), ("starts", np.uint64)])
def test_other_types_of_numbers_of_an_atlas(tmp_path, atlas, name, kind):
    """For example, float16 cannot represent our limits."""
    path = changed(atlas, tmp_path / "atlas.npz", other(name, lambda numbers: numbers.astype(kind)))
    with warnings_as_errors():
        assert voxflat.load_atlas(path).page().used_share == pytest.approx(atlas.page().used_share)


def test_an_error_of_a_reader_that_repeats_the_file(tmp_path):
    """Searching such a message for the parts of C++ messages that are removed took minutes."""
    start = time.process_time()
    assert len(one_line(ValueError("x" * 10_000_000))) <= 200
    assert time.process_time() - start < 1


def test_cuts_in_a_damaged_gzip(tmp_path):
    path = tmp_path / "cuts.json"
    path.write_bytes(gzip.compress(b'{"cuts": [[[0, 3, 2], [1, 3, 2]]]}' + b" " * 5000))
    patch(path, {12: b"\xff" * 8})
    refuses(path, "is not a cuts file: ", sheet_of_voxels().cut)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("lh.V1.label", "#!ascii\n1\ninf 0 0 0 0\n", "line 3 names point inf, but the surface has points 0 to 63"),
        ("lh.V1.label", "#!ascii\n1\nnan 0 0 0 0\n", "line 3 names point nan, but the surface has points 0 to 63"),
        ("v.txt", "# nothing\n", "has 0 values, but the surface has 64 points"),
    ],
)
def test_text_of_no_numbers_or_none_prints_no_warning(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with warnings_as_errors():
        refuses(tmp_path / name, message, read_region, 64)


def test_a_place_in_an_mgh_file_that_none_has(tmp_path):
    """The system's error for an invalid offset does not name the file."""
    path = tmp_path / "v.mgh"
    nib.save(nib.MGHImage(np.ones((64, 1, 1), np.float32), np.eye(4)), path)
    patch(path, {4: struct.pack(">4i", -64, 1, 1, 1)})
    assert holds_volume(path)
    with pytest.raises(voxflat.InputError):
        read_volume(path)


def test_nan_where_nobody_asks_prints_no_warning(tmp_path):
    """CIFTI values may contain signalling NaN, for which casts warn, and so may the positions of MGH files."""
    values = np.ones((1, 64), np.float32)
    brain = nib.cifti2.BrainModelAxis.from_mask(np.ones(64, bool), "CortexLeft")
    cifti, mgh = tmp_path / "v.dscalar.nii", tmp_path / "v.mgh"
    nib.save(nib.Cifti2Image(values, (nib.cifti2.ScalarAxis(["a"]), brain)), cifti)
    nib.save(nib.MGHImage(values.reshape(64, 1, 1), np.eye(4)), mgh)
    patch(cifti, {cifti.stat().st_size - 4: struct.pack("<I", 0x7FA00000)})
    patch(mgh, {30: struct.pack(">5I", *[0x7FA00000] * 5)})
    with warnings_as_errors():
        found = read_overlay(cifti, 64)
        assert np.isnan(found[-1])
        assert (found[:-1] == 1).all()
        assert (read_overlay(mgh, 64) == 1).all()


def test_what_nibabel_changes_is_logged_with_the_file(tmp_path, capfd, caplog):
    path = tmp_path / "v.mgh"
    nib.save(nib.MGHImage(np.ones((3, 4, 5), np.float32), np.eye(4)), path)
    patch(path, {3: b"\t"})  # version
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
    patch(path, {44: struct.pack(">i", greatest)})
    for read in (own_table, lambda path: read_overlay(path, 4)):
        refuses(path, "its header is damaged: it specifies .* colours", read)


@pytest.mark.parametrize("is_old", [False, True])
def test_truncated_colour_tables_are_refused(tmp_path, is_old):
    """nibabel would take the red of the last colour for green and blue, too, and its points would lose their label."""
    path, names = tmp_path / "lh.annot", ["none", "V1"]
    colours = np.array([[1, 2, 3, 0, 0], [40, 50, 60, 0, 0]])
    nib.freesurfer.write_annot(path, np.array([0, 1, 1, 0]), colours, names, fill_ctab=True)
    if is_old:
        entries = [
            struct.pack(">i4s4i", 4, name.encode().ljust(4, b"\0"), *map(int, row[:4]))
            for name, row in zip(names, colours, strict=True)
        ]
        path.write_bytes(path.read_bytes()[:40] + struct.pack(">2i2s", 2, 2, b"x\0") + b"".join(entries))
    whole = path.read_bytes()
    assert read_overlay(path, 4).tolist() == [0, 1, 1, 0]
    for size in range(44, len(whole)):
        path.write_bytes(whole[:size])
        for read in (own_table, lambda path: read_overlay(path, 4)):
            refuses(path, "", read)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"format": ' + "[" * 100_000, "[]", "null", "{}", '{"format": 2}', '"a"']
)
def test_damaged_records_of_a_study_are_refused(tmp_path, text):
    results = Results.in_bids(tmp_path, "sub-01", "L")
    results.record.write_text(text)
    assert state(results, {}) == ("stale", f"{results.record.name} is damaged")
    results.failure.write_text(text)
    assert _reason(results).startswith(f"{results.failure.name} is damaged")


def test_headers_of_arrays_that_end_in_a_string(tmp_path):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3,"
    (tmp_path / "v.npy").write_bytes(b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head)
    assert holds_volume(tmp_path / "v.npy")
    refuses(tmp_path / "v.npy", "", read_volume)


@pytest.mark.parametrize("name", ["v.npy", "v.npz"])  # the content of both is an array
def test_arrays_whose_bytes_no_number_counts(tmp_path, name):
    head = b"{'descr': '<f4', 'fortran_order': False, 'shape': (9223372036854775807,), }".ljust(117) + b"\n"
    (tmp_path / name).write_bytes(b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head)
    with warnings_as_errors():  # NumPy would warn about the product
        refuses(tmp_path / name, "ends after 128 of 36893488147419103356 bytes", lambda path: read_overlay(path, 4))
        holds_volume(tmp_path / name)


def test_what_nibabel_warns_of_is_logged_with_the_file(tmp_path, caplog):
    path = tmp_path / "a.nii"
    image = nib.Nifti1Image(np.ones((3, 4, 5), np.int16), np.eye(4))
    image.header.extensions.append(nib.nifti1.Nifti1Extension("comment", b"x"))
    nib.save(image, path)
    patch(path, {352: struct.pack("<i", 17)})
    with warnings_as_errors(), pytest.raises(nib.spatialimages.HeaderDataError):
        nibabel_image(path)
    assert f"{path}: Extension size is not a multiple of 16 bytes" in caplog.text


@pytest.fixture(scope="module")
def sheet():
    """Return the map of a mesh of 36 points."""
    return voxflat.flatten(grid(6, step=5.0), Voxflat(sources=9))


def damaged_tag(path, shape, tag, kind, change):
    """Write a small TIFF file with a changed entry of 12 bytes in its directory."""
    Image.fromarray(np.ones(shape, np.uint8)).save(path, tiffinfo={270: "Pixel size: 1 mm"})
    data = path.read_bytes()
    at = data.index(struct.pack("<HH", tag, kind))
    path.write_bytes(data[:at] + change(data[at : at + 12]) + data[at + 12 :])


def test_tags_of_a_picture_that_are_damaged_are_not_told(tmp_path, sheet):
    path = tmp_path / "rois.tif"
    damaged_tag(path, (4, 4), 270, 2, lambda entry: entry[:4] + struct.pack("<L", 10**8) + entry[8:])
    with warnings_as_errors():
        if int(pillow.split(".")[0]) < 13:  # which refuses the file
            refused("cannot identify image file", sheet.regions, path)
            return
        refuses(path, "the label image has 4 x 4 pixels", sheet.regions)
        assert (as_picture(path)[0] == 1).all()


@pytest.mark.parametrize("read", [as_picture, "regions"])
def test_what_pillow_logs_of_a_picture_is_told_by_us_with_the_file(tmp_path, sheet, caplog, read):
    """The picture has more channels than Pillow reads."""
    path = tmp_path / "rois.tif"
    damaged_tag(path, (4, 4, 3), 277, 3, lambda entry: entry[:8] + struct.pack("<L", 99))
    refused(r"rois\.tif", sheet.regions if read == "regions" else read, path)
    assert [record.name for record in caplog.records] == ["voxflat"]
    assert f"{path}: More samples per pixel than can be decoded: 99" in caplog.text


@pytest.mark.parametrize("read", [as_picture, "regions"])
def test_what_decoders_of_pictures_print_is_not_seen(tmp_path, sheet, capfd, read):
    """For a fax with 8 bits per pixel, the C decoder prints a line."""
    path = tmp_path / "rois.tif"
    damaged_tag(path, (4, 4), 259, 3, lambda entry: entry[:8] + struct.pack("<L", 4))
    refused(r"rois\.tif: .*-2", sheet.regions if read == "regions" else read, path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.medium
def test_what_a_picture_takes_is_known_before_it_is_decoded(tmp_path, sheet):
    path = tmp_path / "rois.png"
    Image.new("L", (12_000, 12_000)).save(path)
    for read in (as_picture, sheet.regions):
        with reading(1 << 30):
            refuses(path, r"3\.22 GiB of memory is needed", read)


def test_values_that_are_no_whole_numbers_or_signal_print_no_warning(sheet):
    """A signalling NaN is NaN, and a value that exceeds 64 bits is not a label."""
    values = np.ones(36, np.float32)
    with warnings_as_errors():
        assert all_whole(np.full(3, 0x7FA00000, np.uint32).view(np.float32))
        values[:6] = 1e30
        assert (parcels_of(sheet, values).labels != 1).sum() == 6
        refused("labels", sheet.regions, np.full(sheet.raster(1.0).shape, 1e30, np.float32), pixel_size=1.0)


def test_numbers_of_patches_and_labels_that_are_none_are_refused_without_a_warning(tmp_path):
    (tmp_path / "lh.patch").write_bytes(struct.pack(">3i3I", -1, 1, 1, *[0x7FA00000] * 3))
    brain = nib.cifti2.BrainModelAxis.from_mask(np.ones(64, bool), "CortexLeft")
    names = nib.cifti2.LabelAxis(["a"], [{0: ("x", (0, 0, 0, 0))}])
    nib.save(nib.Cifti2Image(np.full((1, 64), np.inf, np.float32), (names, brain)), tmp_path / "v.dlabel.nii")
    with warnings_as_errors():
        refuses(tmp_path / "lh.patch", r"position of patch entry 0, \[nan, nan, nan\], is not finite", read_patch)
        refuses(tmp_path / "v.dlabel.nii", "label inf is not", read_overlay, 64)


def test_pictures_of_half_precision_are_looked_up_as_others():
    coordinates = np.random.default_rng(0).random((9, 2))
    picture = np.arange(16.0).reshape(4, 4)
    for kind in (np.float16, np.longdouble):
        np.testing.assert_array_equal(values_at(picture.astype(kind), coordinates), values_at(picture, coordinates))


@pytest.mark.slow
@pytest.mark.parametrize("form", ["2", "3", "3 in shards"])
@pytest.mark.parametrize("missing", [1, 8, 38])
def test_truncated_blosc_chunks_are_refused(tmp_path, form, missing):
    """Blosc reads beyond the end of a chunk, and returns whatever is in memory there."""
    more = {"shards": {"shape": (8, 4, 4), "index_location": "start"}} if "shards" in form else {}
    zarr = pytest.importorskip("zarr", minversion="3")
    codec = numcodecs.Blosc() if form == "2" else zarr.codecs.BloscCodec()
    group = zarr.open_group(tmp_path / "v.zarr", mode="w", zarr_format=int(form[0]))
    data = np.random.default_rng(0).integers(1, 9, (8, 4, 4), dtype=np.uint8)  # too short to be compressed
    group.create_array("0", data=data, chunks=(2, 4, 4), compressors=codec, **more)
    sets = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1, 1, 1]}]}]
    told = {"multiscales": [{"version": "0.4", "axes": list("zyx"), "datasets": sets}]}
    group.attrs.update(told if form == "2" else {"ome": told})
    chunk = next(path for path in (tmp_path / "v.zarr" / "0").rglob("*") if re.search(r"\d[./]0[./]0$", str(path)))
    assert np.array_equal(read_volume(tmp_path / "v.zarr").data, data.T)
    chunk.write_bytes(chunk.read_bytes()[:-missing])
    refuses(tmp_path / "v.zarr", r"contains a chunk that ends after \d+ of \d+ bytes", read_volume)
