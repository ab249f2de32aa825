"""Files to damage: a small file of each format that voxflat reads, ways to damage it, and its opener."""

import base64
import gzip
import io
import json
import os
import re
import shutil
import struct
import zipfile
import zlib
from copy import copy
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import nibabel as nib
import numpy as np
import pyvista as pv
from fuzz_stacks import entries as stacks
from fuzz_stacks import stack
from PIL import Image

import voxflat
from voxflat.errors import InputError
from voxflat.io.files import contents
from voxflat.io.formats.gltf import write_glb
from voxflat.io.label_tables import own_table, read_table
from voxflat.io.meshes import Mesh, holds_mesh, is_mesh_name, read_mesh, write_mesh
from voxflat.io.overlays import holds_volume, read_channels, read_overlay, read_region
from voxflat.io.patches import Patch, is_patch, read_patch, write_patch
from voxflat.io.reading import hash_of
from voxflat.io.tables import read_points
from voxflat.io.volumes import read_volume, write_volume
from voxflat.lab.freshness import state
from voxflat.lab.results import FORMAT, Results, sealed
from voxflat.maps.textures.pictures import as_picture
from voxflat.surfaces.standard.template import is_template, read_template, standard_template

SIDE = 8  # points along a side of the flat sheet in most files
N = SIDE * SIDE


def sheet():
    volume = np.zeros((SIDE, SIDE, 5), np.uint8)
    volume[:, :, 2] = 1
    return volume


def grid():
    """Return a slightly bent sheet of triangles."""
    i, j = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    points = np.column_stack([5.0 * i.ravel(), 5.0 * j.ravel(), np.sin(i.ravel())])
    corner = (i[:-1, :-1] * SIDE + j[:-1, :-1]).ravel()
    halves = [(corner, corner + SIDE, corner + 1), (corner + 1, corner + SIDE, corner + SIDE + 1)]
    return Mesh(points, np.concatenate([np.column_stack(half) for half in halves]))


# -------------------------------------------------------------------------------------------------- openers


def _volume(path):
    volume = read_volume(path)
    return volume.data, volume.affine


def _mesh(path):
    is_mesh_name(path)
    holds_mesh(path)
    mesh = read_mesh(path)
    return mesh.points, mesh.faces, mesh.texture_coordinates


def _values(path):
    holds_volume(path)
    channels = read_channels(path, N)
    return read_overlay(path, N), channels.read(len(channels) - 1)


def _labels(path):
    own_table(path)
    return read_overlay(path, N), path.suffix == ".nii" or read_region(path, N, name="V1")


def _series(path):
    stack = _MADE["map"].images(path)
    return [stack[number].data for number in (0, len(stack) - 1)]


def _map(path):
    found = voxflat.load(path)
    found.heat_map()
    found.look_up([[0.0, 0.0]])
    found.save(path.with_name("again.vtp"))
    repr(found)
    image = found.image(np.ones(found.volume_shape) if found.is_voxels else np.ones(found.metadata["vertices"]))
    return found.uv, found.ids, found.faces, image.data


def _movie(path):
    found = voxflat.load_series(path)
    return found.points, found.flat_map.uv, found.images(metric=True)[len(found) - 1].data


def _atlas(path):
    found = voxflat.load_atlas(path)
    found.save(path.with_name("again.npz"))
    return found.table(), found.page().heat_map().data


def _store(path):
    rows = voxflat.open_rows(path)
    rows.verify()
    return rows.chunks, np.asarray(rows[0])


def _cuts(path):
    found = voxflat.surface(_MADE["surface"]).cut(cuts=path, relax=False)
    return [cut.ids for cut in found.cuts], found.left_out


def _regions(path):
    found = _MADE["map"].regions(path)
    return found.at(np.zeros((1, 2))), found.at(_MADE["map"].uv)


def _record(path):
    results = Results.in_bids(path.parent, "sub-01", "L")
    found, reason = state(results, _MADE["request"])
    if found != "done":
        raise InputError(" ".join(reason.split()))


OPENERS = {"volume": _volume, "series": _series, "mesh": _mesh, "stack": stack}
OPENERS |= {"values": _values, "labels": _labels, "region": lambda path: read_region(path, N)}
OPENERS |= {"patch": lambda path: (is_patch(path), read_patch(path)), "table": read_table, "points": read_points}
OPENERS |= {"map": _map, "movie": _movie, "atlas": _atlas, "store": _store, "cuts": _cuts}
OPENERS |= {"template": lambda path: (is_template(path), read_template(path))}
OPENERS |= {"regions": _regions, "picture": lambda path: as_picture(path)[0]}
OPENERS |= {"contents": contents, "record": _record}

_MADE = {}
"""Objects that openers need in addition to their file."""


# -------------------------------------------------------------------------------------------------- corpus


@dataclass(frozen=True)
class Entry:
    """A folder with a file, or with files that belong together, and the kind of its opener."""

    folder: Path
    main: str
    opener: str

    @property
    def files(self):
        return sorted(path for path in self.folder.rglob("*") if path.is_file())

    @property
    def kind(self):
        """The opener and the ending, by which cases are counted."""
        return f"{self.opener} {''.join(Path(self.main).suffixes) or self.main}"


def corpus(folder, endings=("",)):
    """Write a small file of each format, or of those with the given endings."""
    entries = []

    def entry(main, opener, write):
        if not main.endswith(endings):
            return
        own = folder / f"{len(entries):02}"
        own.mkdir(parents=True)
        write(own / main)
        entries.append(Entry(own, main, opener))

    surface = voxflat.surface(sheet())
    flat_map = voxflat.flatten(surface, method=voxflat.methods.Voxflat(sources=9))
    _MADE.update(surface=surface, map=flat_map)
    affine = np.diag([1.0, 1.0, 2.0, 1.0])
    floats = np.random.default_rng(0).random((6, 5, 4)).astype(np.float32)
    for ending in (".nii", ".nii.gz", ".nrrd", ".mha", ".mgh", ".mgz", ".npz"):
        entry(f"v{ending}", "volume", lambda path: write_volume(path, sheet(), affine))
    for name in ("f.nii", "f.mha"):
        entry(name, "volume", lambda path: write_volume(path, floats, affine))
    entry("v.npy", "volume", lambda path: write_volume(path, sheet(), np.eye(4)))
    entry("v2.nii", "volume", lambda path: nib.save(nib.Nifti2Image(sheet(), affine), path))
    entry("text.nhdr", "volume", _write_nhdr)
    entry("raw.mhd", "volume", _write_meta)
    entry("ascii.mha", "volume", _write_meta)
    series = nib.Nifti1Image(np.ones((SIDE, SIDE, 5, 3), np.float32), np.eye(4))
    entry("t.nii", "series", lambda path: nib.save(series, path))
    entry("t.nii.gz", "series", lambda path: nib.save(series, path))
    mgh = nib.MGHImage(np.ones((SIDE, SIDE, 5, 3), np.float32), np.eye(4))
    entry("t.mgz", "series", lambda path: nib.save(mgh, path))
    entry("t.zarr", "series", _write_zarr)
    stacks(entry)
    _meshes(entry)
    _on_points(entry)
    entry("map.npz", "map", flat_map.save)
    of_mesh = voxflat.flatten((grid().points, grid().faces), method=voxflat.methods.Voxflat(sources=9))
    entry("map.voxflat", "map", of_mesh.save)
    texture = _png_bytes()
    own = {"unit": "mm", "is_ras": True, "repeat": False, "transparent": False}
    arrays = grid().points, grid().faces, of_mesh.uv[:N] / 100, texture
    entry("textured.glb", "mesh", lambda path: write_glb(path, *arrays, **own))
    series = voxflat.flatten_series([(scale * grid().points, grid().faces) for scale in (1, 1.1)])
    entry("series.voxflat", "movie", series.save)
    atlas = surface.patches(bound=1.2)
    entry("atlas.npz", "atlas", atlas.save)
    entry("glued.npz", "atlas", atlas.glue().save)
    entry("store", "store", lambda path: surface.geodesic(9, store=path))
    entry("cuts.json", "cuts", lambda path: path.write_text('{"cuts": [[[0,3,2],[1,3,2],[2,3,2]]], "drop": [[7,7,2]]}'))
    cut = surface.cut(cuts=[[[0, 3, 2], [1, 3, 2]]], relax=False)
    entry("saved.json", "cuts", cut.save)
    entry("sub-01_hemi-L_flat.json", "record", _write_record)
    entry("t.json", "template", lambda path: path.write_text(standard_template("fsaverage", "left").as_json()))
    middle = flat_map.uv.mean(axis=0)
    square = (middle + 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])).tolist()
    entry("rois.json", "regions", lambda path: path.write_text(json.dumps({"V1": square, "V2": [square]})))
    entry("rois.svg", "regions", lambda path: _write_svg(path, flat_map))
    pixels = flat_map.heat_map().data
    entry("rois.npy", "regions", lambda path: np.save(path, np.ones(np.shape(pixels), np.uint8)))
    for ending in (".png", ".tif"):
        entry(f"rois{ending}", "regions", Image.fromarray(np.ones(np.shape(pixels), np.uint8)).save)
    entry("rois.nii", "regions", flat_map.heat_map().save)
    picture = Image.fromarray(np.arange(300, dtype=np.uint8).reshape(10, 10, 3))
    for ending in (".png", ".jpg", ".tif", ".bmp"):
        entry(f"p{ending}", "picture", picture.save)
    return entries


def _meshes(entry):
    mesh = grid()
    of_vtk = pv.PolyData.from_regular_faces(mesh.points, mesh.faces)
    for name in ("s.surf.gii", "lh.white", "s.vtp", "s.ply", "s.obj"):
        entry(name, "mesh", lambda path: write_mesh(path, mesh))
    entry("s.gii.gz", "mesh", lambda path: _packed(path, mesh))
    for name, binary in (("text.vtp", False), ("s.vtk", True), ("text.vtk", False), ("text.ply", False)):
        entry(name, "mesh", lambda path, binary=binary: of_vtk.save(path, binary=binary))
    entry("old.vtk", "mesh", lambda path: _write_old(path, of_vtk, 2))
    entry("oldtext.vtk", "mesh", lambda path: _write_old(path, of_vtk, 1))
    entry("s.stl", "mesh", of_vtk.save)
    entry("text.stl", "mesh", lambda path: of_vtk.save(path, binary=False))
    quads = b"".join(b"v %d %d 0 # z\n" % (i, j) for i in range(3) for j in range(3)) + b"vt 0 0\nvt 0 1\n"
    quads += b"mtllib m.mtl\nusemtl a\nf 1/1 2/2 5/1 4/2\nf 2//1 3//1 6//1 5//1\nf -1 -2 -5\n"
    off = [f"OFF\n{N} {len(mesh.faces)} 0", *(" ".join(map(str, row)) for row in mesh.points)]
    off += [f"3 {' '.join(map(str, row))}" for row in mesh.faces]
    entry("s.off", "mesh", lambda path: path.write_text("\n".join(off) + "\n"))
    asc = ["#!ascii", f"{N} {len(mesh.faces)}", *(f"{' '.join(map(str, row))} 0" for row in mesh.points)]
    asc += [f"{' '.join(map(str, row))} 0" for row in mesh.faces]
    entry("lh.white.asc", "mesh", lambda path: path.write_text("\n".join(asc) + "\n"))
    entry("nodes.glb", "mesh", _write_scene)
    entry("quads.obj", "mesh", lambda path: path.write_bytes(quads))


def _on_points(entry):
    values = np.linspace(0, 1, N, dtype=np.float32)
    labels = (np.arange(N) % 3).astype(np.int32)
    gifti = nib.gifti
    arrays = [gifti.GiftiDataArray(values, "NIFTI_INTENT_SHAPE"), gifti.GiftiDataArray(values, "NIFTI_INTENT_SHAPE")]
    entry("v.func.gii", "values", lambda path: nib.save(gifti.GiftiImage(darrays=arrays), path))
    table = gifti.GiftiLabelTable()
    for key, name in enumerate(("???", "V1", "V2")):
        label = gifti.GiftiLabel(key, 0.1, 0.2, 0.3, 1.0)
        label.label = name
        table.labels.append(label)
    parcels = gifti.GiftiImage(darrays=[gifti.GiftiDataArray(labels, "NIFTI_INTENT_LABEL")], labeltable=table)
    entry("v.label.gii", "labels", lambda path: nib.save(parcels, path))
    entry("lh.curv", "values", lambda path: nib.freesurfer.write_morph_data(path, values))
    colours = np.array([[10, 20, 30, 0], [40, 50, 60, 0], [70, 80, 90, 0]])
    annot = labels, np.c_[colours, [0, 0, 0]], ["unknown", "V1", "V2"]
    entry("lh.annot", "labels", lambda path: nib.freesurfer.write_annot(path, *annot, fill_ctab=True))
    entry("v.mgh", "values", lambda path: nib.save(nib.MGHImage(values.reshape(-1, 1, 1), np.eye(4)), path))
    points = nib.Nifti1Image(np.tile(values, (2, 1)).T.reshape(N, 1, 1, 2).copy(), np.eye(4))
    entry("v.nii", "values", lambda path: nib.save(points, path))
    axes = nib.cifti2
    brain = axes.BrainModelAxis.from_mask(np.ones(N, bool), "CortexLeft")
    scalars = nib.Cifti2Image(np.tile(values, (2, 1)), (axes.ScalarAxis(["a", "b"]), brain))
    entry("v.dscalar.nii", "values", lambda path: nib.save(scalars, path))
    keys = {0: ("???", (0, 0, 0, 0)), 1: ("V1", (1, 0, 0, 1)), 2: ("V2", (0, 1, 0, 1))}
    labelled = nib.Cifti2Image(labels[None].astype(np.float32), (axes.LabelAxis(["parcels"], keys), brain))
    entry("v.dlabel.nii", "labels", lambda path: nib.save(labelled, path))
    entry("v.npy", "values", lambda path: np.save(path, values))
    entry("v.txt", "values", lambda path: np.savetxt(path, values))
    rows = "".join(f"{n}  1.0  2.0  3.0 0.0\n" for n in range(5))
    entry("lh.V1.label", "region", lambda path: path.write_text(f"#!ascii label , from subject\n5\n{rows}"))
    patch = Patch(np.arange(9), np.zeros((9, 3)) + np.arange(9)[:, None], np.arange(9) % 2 == 0)
    entry("lh.cortex.patch.3d", "patch", lambda path: write_patch(path, patch))
    entry("lut.txt", "table", lambda path: path.write_text("# No. Name R G B A\n0 Unknown 0 0 0 0\n1 V1 255 0 9 0\n"))
    entry("lut.tsv", "table", lambda path: path.write_text("index\tname\tcolor\n0\tnone\t#000000\n1\tV1\t#ff0a0b\n"))
    entry("lut.label.gii", "table", lambda path: nib.save(parcels, path))
    entry("points.csv", "points", lambda path: path.write_text("name,x,y,z\na,1,2,3\nb,4,5,6\n"))
    entry("points.tsv", "points", lambda path: path.write_text("x\ty\tz\n1\t2\t3\n4\t5\t6\n"))


def _packed(path, mesh):
    plain = path.with_name("s.surf.gii")
    write_mesh(plain, mesh)
    path.write_bytes(gzip.compress(plain.read_bytes(), mtime=0))
    plain.unlink()


def _write_old(path, mesh, kind):
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter

    writer = vtkPolyDataWriter()
    writer.SetInputData(mesh)
    writer.SetFileName(str(path))
    writer.SetFileVersion(42)
    writer.SetFileType(kind)
    writer.Write()


def _png_bytes():
    made = io.BytesIO()
    Image.new("RGB", (2, 2)).save(made, "png")
    return made.getvalue()


def _write_scene(path):
    """Write GLB with trimesh: two nodes with transformations."""
    import trimesh

    scene, mesh = trimesh.Scene(), grid()
    shape = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    for shift in (0, 50):
        scene.add_geometry(shape, transform=trimesh.transformations.translation_matrix([shift, 0, 0]))
    path.write_bytes(scene.export(file_type="glb"))


def _write_record(path):
    """Write the record of a participant's results, and one of its files."""
    inputs = {"white": {"path": "lh.white", "sha256": "0" * 64}}
    wanted = {"voxflat": voxflat.__version__, "format": FORMAT, "parameters": {"cuts": "five"}, "inputs": inputs}
    _MADE["request"] = wanted
    output = path.with_name("sub-01_hemi-L_desc-voxflat_area.shape.gii")
    output.write_bytes(bytes(100))
    outputs = {output.name: hash_of(output)}
    content = {**wanted, "outputs": outputs, "figures": {"angle": 1.5}, "overlays": ["area"]}
    path.write_text(json.dumps(sealed(content)))


def _write_nhdr(path):
    head = "NRRD0004\ntype: uint8\ndimension: 3\nspace: right-anterior-superior\nsizes: 8 8 5\n"
    head += "space directions: (1,0,0) (0,1,0) (0,0,2)\nspace origin: (0,0,0)\nencoding: raw\ndata file: v.raw\n\n"
    path.write_text(head)
    path.with_name("v.raw").write_bytes(sheet().tobytes(order="F"))


def _write_meta(path):
    """Write MetaImage with the voxels as text in the same file (.mha), or raw in another file."""
    is_text = path.suffix == ".mha"
    head = (
        f"ObjectType = Image\nNDims = 3\nBinaryData = {not is_text}\nBinaryDataByteOrderMSB = False\nOffset = 0 0 0\n"
    )
    head += "ElementSpacing = 1 1 2\nDimSize = 8 8 5\nElementType = MET_UCHAR\nElementDataFile = "
    voxels = sheet().ravel(order="F")
    path.write_text(head + ("LOCAL\n" + " ".join(map(str, voxels)) if is_text else "v.raw") + "\n")
    if not is_text:
        path.with_name("v.raw").write_bytes(voxels.tobytes())


def _write_svg(path, flat_map):
    from voxflat import figures

    figures.save(figures.flat_map(flat_map), path)
    drawn = '<g id="rois"><path id="V1" d="M 50 50 L 150 50 L 150 150 Z"/></g></svg>'
    path.write_text(path.read_text().replace("</svg>", drawn))


def _write_zarr(path):
    import zarr

    group = zarr.open_group(path, mode="w", zarr_format=2)
    group.create_array("0", data=np.ones((5, SIDE, SIDE), np.float32), chunks=(5, 4, 4))
    steps = [{"type": "scale", "scale": [1, 1, 1]}, {"type": "translation", "translation": [0, 0, 0]}]
    sets = [{"path": "0", "coordinateTransformations": steps}]
    axes = [{"name": name, "type": "space", "unit": "millimeter"} for name in "zyx"]
    group.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": sets}]


# -------------------------------------------------------------------------------------------------- damage

_WORDS = b"0 -1 1 3 255 65536 2147483647 2147483648 -2147483648 4294967295 9223372036854775807".split()
_WORDS += (
    b"18446744073709551616 99999999999999999999 1e19 1e107 1e400 nan -inf 0.5 x ' /etc/hosts ../secret.tif None".split()
)
_WORDS += [b"", b"%n%x%s", b"\xff\xfe", b'"', b"1 2 3 4"]
_INTEGERS = [0, 1, 2, 3, 7, 127, 255, 256, 32767, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1, -1, -2, -(2**31)]
_FLOATS = [0.0, -0.0, 1.0, -1.0, 1e-30, 1e19, 1e30, float("nan"), float("inf"), float("-inf")]
_VALUES = [None, True, False, 0, -1, 1, 2**31, 2**63, 2**70, 1e19, 1e107, "", "x", "nan", "0", [], {}, [[]]]
_VALUES += [1e10, "../secret.tif", "../secret.raw", "/etc/hosts", "/dev/zero"]
_VALUES += [[None], [[1, 2], [3]], {"a": 1}, [1, 2, 3], float("nan"), float("inf"), ["a", "b"], "\x00", 0.5]
_ZEROS = gzip.compress(bytes(1 << 26), 1, mtime=0)
_NUMBER = re.compile(rb"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)")
_QUOTED = re.compile(rb"""(?:["'=])([\w.,:/ #-]{1,60})(?=["'\n])""")
_TEXTS = re.compile(rb"<\?xml[^\0]{40,}>|\{\"axes[^\0]{20,}\}|ImageJ=[^\0]{20,}|<svg[^\0]{40,}>")


def damage(data, chance, other):
    """Damage the bytes of a file; `other` returns the bytes of another file."""
    if chance.random() < 0.6:
        inside = _inside(data, chance, other)
        if inside is not None:
            return inside
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        data = chance.choice(_WAYS)(data, chance, other)
    return data


def _inside(data, chance, other):
    """Damage packed content and pack it again with valid checksums; return None if nothing is packed."""
    if data[:2] == b"\x1f\x8b":
        return gzip.compress(damage(gzip.decompress(data), chance, other), 1, mtime=0)
    if data[:2] == b"PK":
        return _in_archive(data, chance, other)
    if data[:6] == b"\x93NUMPY":
        return _in_array(data, chance)
    if data[:1] in (b"{", b"["):
        lines = data.splitlines() if b"}\n{" in data else [data]  # a journal has an object a line
        at = chance.randrange(len(lines))
        lines[at] = json.dumps(_in_json(json.loads(lines[at]), chance)).encode("utf-8", "replace")
        return b"\n".join(lines)
    if data[:4] == b"glTF":
        return _in_glb(data, chance)
    if data[:4] in (b"II*\0", b"MM\0*") and chance.random() < 0.5:
        return _in_tiff(data, chance)
    if texts := [
        found for found in _TEXTS.finditer(data) if found.end() - found.start() < len(data) or chance.random() < 0.5
    ]:
        text = chance.choice(texts)  # within a binary file, where it keeps its length
        changed = _in_text(text[0], chance)
        is_whole = len(text[0]) == len(data)
        return data[: text.start()] + (changed if is_whole else changed.ljust(len(text[0]))) + data[text.end() :]
    if blocks := list(re.finditer(rb">\s*([A-Za-z0-9+/]{40,}=*)\s*<", data)):
        block = chance.choice(blocks)
        inner = base64.b64decode(block[1])
        try:
            inner, pack = zlib.decompress(inner), zlib.compress
        except zlib.error:
            pack = bytes
        inner = base64.b64encode(pack(_numbers(inner, chance, other)))
        return data[: block.start(1)] + inner + data[block.end(1) :]
    return None


def _in_glb(data, chance):
    """Change the JSON of a GLB file, and correct the lengths."""
    length = int.from_bytes(data[12:16], "little")
    text = json.dumps(_in_json(json.loads(data[20 : 20 + length]), chance)).encode("utf-8", "replace")
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4s4I", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def _in_tiff(data, chance):
    """Change the type, the count or the value of a tag on any page."""
    changed, order = bytearray(data), "<" if data[:1] == b"I" else ">"
    tags, at = [], struct.unpack_from(f"{order}I", data, 4)[0]
    while at and at + 2 <= len(data):
        count = struct.unpack_from(f"{order}H", data, at)[0]
        tags += [at + 2 + 12 * n for n in range(count)]
        at = struct.unpack_from(f"{order}I", data, at + 2 + 12 * count)[0]
    tag = chance.choice(tags)
    form, shift = chance.choice((("H", 0), ("H", 2), ("I", 4), ("I", 8), ("H", 8)))
    struct.pack_into(order + form, changed, tag + shift, chance.choice(_INTEGERS) % (1 << 8 * struct.calcsize(form)))
    return bytes(changed)


def _in_text(text, chance):
    """Replace a quoted value or a number of XML or JSON, or the value of a line of ImageJ."""
    found = list(_QUOTED.finditer(text)) or list(_NUMBER.finditer(text))
    if not found:
        return text
    word = chance.choice(found)
    return text[: word.start(1)] + chance.choice(_WORDS) + text[word.end(1) :]


def _in_archive(data, chance, other):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(sorted(members))
    match chance.randrange(8):
        case 0:
            del members[name]
        case 1:
            members[name] = members[chance.choice(sorted(members))]
        case 2:
            members[name] = damage(members[name], chance, other)
        case _:
            members[name] = _in_array(members[name], chance)
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for member, content in members.items():
            archive.writestr(zipfile.ZipInfo(member), content)
    return made.getvalue()


def _in_array(data, chance):
    """Change the values, the shape or the type of an array, or JSON in text."""
    try:
        array = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except (ValueError, TypeError):
        return data[: len(data) // 2]
    if array.dtype.kind == "U" and array.ndim == 0 and str(array)[:1] == "{":
        array = np.array(json.dumps(_in_json(json.loads(str(array)), chance)))
    else:
        array = odd_array(array, chance)
    made = io.BytesIO()
    np.lib.format.write_array(made, array, allow_pickle=array.dtype.hasobject)
    return made.getvalue()


def odd_array(array, chance):
    """Return an array similar to another, but wrong somewhere."""
    array = np.array(array)
    ways = [
        lambda: array[: len(array) // 2],
        lambda: np.concatenate([array, array]),
        lambda: array[:0],
        lambda: array[..., None],
        array.ravel,
        lambda: np.array(chance.choice(("x", 3, 0.5, -1, np.nan))),
        lambda: array.astype(array.dtype.newbyteorder(">")),
    ]
    if not array.ndim:
        ways[:3] = [lambda: array[None]]
    if array.dtype.kind != "U":
        ways.append(lambda: array.astype(chance.choice(("f2", "f8", "i1", "u8", "c16", "?"))))
    if array.size and array.dtype.kind in "iufb":
        ways.append(lambda: _one_changed(array, chance))
    with np.errstate(all="ignore"):
        return chance.choice(ways)()


def _one_changed(array, chance):
    value = np.array(chance.choice(_FLOATS if array.dtype.kind == "f" else _INTEGERS)).astype(array.dtype)
    changed = array.copy()
    changed.reshape(-1)[chance.randrange(array.size)] = value
    return changed


def _in_json(value, chance):
    if chance.random() < 0.02:
        return reduce(lambda inner, _: [inner], range(20), 1)
    if not isinstance(value, dict | list) or not value:
        return chance.choice(_VALUES)
    keys = sorted(value) if isinstance(value, dict) else list(range(len(value)))
    inner = [key for key in keys if isinstance(value[key], dict | list) and value[key]]
    changed = copy(value)
    if inner and chance.random() < 0.5:
        key = chance.choice(inner)
        changed[key] = _in_json(value[key], chance)
    elif chance.random() < 0.3:
        del changed[chance.choice(keys)]
    else:
        changed[chance.choice(keys)] = chance.choice(_VALUES)
    return changed


def _numbers(data, chance, _):
    """Overwrite some bytes, mostly near the start, with numbers that are critical in headers."""
    if len(data) < 8:
        return data
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 3))):
        width = chance.choice((1, 2, 4, 4, 8))
        most = len(data) - width if chance.random() < 0.3 else min(len(data) - width, 512)
        at = chance.randrange(most + 1) // width * width + (chance.randrange(4) if chance.random() < 0.2 else 0)
        order = chance.choice("<>")
        if width >= 4 and chance.random() < 0.4:
            new = struct.pack(order + {4: "f", 8: "d"}[width], chance.choice(_FLOATS))
        else:
            new = (chance.choice(_INTEGERS) % 256**width).to_bytes(width, "little" if order == "<" else "big")
        changed[at : at + width] = new
    return bytes(changed)


def _words(data, chance, _):
    """Replace one number of a text."""
    found = list(_NUMBER.finditer(data[:100_000]))
    if not found:
        return data
    word = chance.choice(found[: 40 if chance.random() < 0.6 else None])
    return data[: word.start()] + chance.choice(_WORDS) + data[word.end() :]


def _lines(data, chance, _):
    """Delete, double, change or lengthen a line."""
    lines = data.split(b"\n")
    at = chance.randrange(min(len(lines), 60))
    match chance.randrange(5):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[chance.randrange(len(lines))])
        case 2:
            lines[at] = chance.choice((b"\t", b" ", b"\r")) + lines[at]
        case 3:
            lines.insert(at, chance.choice((b"\n", b" ", b"\t", b"(", b"<a>")) * chance.choice((100, 20_000)))
        case _:
            lines[at] = lines[at].replace(b"=", b" = ").replace(b'"', b"'")
    return b"\n".join(lines)


def _flipped(data, chance, _):
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8)) if data else 0):
        changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _replaced(data, chance, other):
    start = chance.randrange(len(data) + 1)
    end = min(len(data), start + chance.choice((1, 2, 4, 16, 100, 1000)))
    kinds = (b"", data[start:end] * 2, bytes(end - start), b"\xff" * (end - start), chance.randbytes(end - start))
    return data[:start] + chance.choice((*kinds, other()[start:end])) + data[end:]


def _cut(data, chance, _):
    return data[: chance.randrange(len(data) + 1)] if data else data


def _whole(data, chance, other):
    """Return completely different content."""
    kinds = (
        bytes,
        other,
        lambda: gzip.compress(data, 1, mtime=0),
        lambda: gzip.compress(gzip.compress(data, 1, mtime=0), 1, mtime=0),
        lambda: gzip.compress(data[:200], 1, mtime=0) + _ZEROS,
        lambda: data + bytes(1 << 16),
        lambda: data[::-1],
        lambda: b"[" * 100_000,
        lambda: data.decode("latin1").encode("utf-16"),
        lambda: chance.randbytes(400),
    )
    return chance.choice(kinds)()


_WAYS = (_numbers, _numbers, _words, _words, _lines, _flipped, _replaced, _cut, _whole)


def damaged(entry, entries, to, chance):
    """Copy an entry to an emptied folder, damage one of its files, and return its path and the kind of its opener."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(entry.folder, to)
    file = to / chance.choice(entry.files).relative_to(entry.folder)

    def other():
        return chance.choice(chance.choice(entries).files).read_bytes()

    file.write_bytes(damage(file.read_bytes(), chance, other))
    path, opener = to / entry.main, entry.opener
    if chance.random() < 0.04 and path.is_file():
        another = chance.choice([one for one in entries if (one.folder / one.main).is_file()])
        path, opener = path.rename(to / another.main), chance.choice((opener, another.opener))
    spoiled = path if path.is_file() else file
    if chance.random() < 0.01 and hasattr(os, "mkfifo") and spoiled.is_file():
        spoiled.unlink()
        os.mkfifo(spoiled)
    return path, opener
