"""Invalid input causes a one-line error that names the value and the remedy, and no file is written."""

import os
import pickle
import re

import composed
import numpy as np
import pytest
import shapes
from command_line import run
from refusals import refused

import voxflat
from voxflat.methods import Voxflat

nib = pytest.importorskip("nibabel")


def sheet(*, cut=None):
    volume = np.pad(np.ones((40, 40, 1), np.uint8), [(0, 0), (0, 0), (2, 2)])
    if cut is not None:
        volume[cut] = 0
    return volume


def few(*voxels):
    volume = np.zeros((8, 8, 8), np.uint8)
    volume[tuple(np.transpose(voxels))] = 1
    return volume


def with_value(value):
    volume = sheet().astype(np.float32)
    volume[3, 4, 0] = value
    return volume


def kept(*slices):
    mask = np.zeros((40, 40, 5), np.uint8)
    for part in slices:
        mask[part] = 1
    return mask


def affine(**cells):
    matrix = np.eye(4)
    for cell, value in cells.items():
        matrix[int(cell[1]), int(cell[2])] = value
    return matrix


NAN, INF = float("nan"), float("inf")
LINE = few(*[(i, 2, 2) for i in range(8)])
DIAGONAL = few(*[(i, i, i) for i in range(8)])

# name: volume, options, what the message must match
API = {
    "2D": (np.ones((5, 5)), {}, r"has shape \(5, 5\). Select one 3-D volume \(I, J, K\)"),
    "4D": (np.ones((5, 5, 5, 2)), {}, r"has shape \(5, 5, 5, 2\). Select"),
    "no voxels": (np.ones((0, 5, 5)), {}, r"has shape \(0, 5, 5\)"),
    "colours": (np.ones((5, 5, 5, 3), np.uint8), {}, r"\(5, 5, 5, 3\).*Pass a volume with one value per voxel"),
    "complex": (sheet() * 1j, {}, r"complex128.*Convert"),
    "text": (np.array([[["a"]]]), {}, r"<U1.*Convert"),
    "nothing": (None, {}, r"NoneType"),
    "empty": (np.zeros((5, 5, 5), np.uint8), {}, r"empty: every voxel is 0"),
    "label absent": (sheet() * 3, {"label": 7}, r"no voxel has label 7; the volume has labels 3$"),
    "label ambiguous": (sheet() + sheet(cut=3), {}, r"pass a label or a threshold; the volume has labels 1, 2$"),
    "label and threshold": (
        sheet(),
        {"label": 1, "threshold": 0.5},
        r"label[= ]1 and (--)?threshold[= ]0.5 .* only one",
    ),
    "intensities": (sheet() * 0.3, {}, r"intensities from 0 to 0.3. Pass a threshold"),
    "threshold too high": (sheet(), {"threshold": 5}, r"above the threshold 5(\.0)?; the largest value is 1"),
    "threshold NaN": (sheet(), {"threshold": NAN}, r"threshold is nan. Pass a finite"),
    "threshold text": (sheet(), {"threshold": "high"}, r"threshold is 'high'. Pass a number"),
    "NaN in the data": (with_value(NAN), {"threshold": 0.5}, r"1 voxel is NaN or infinite. Replace"),
    "inf in the data": (with_value(INF), {"label": 1}, r"1 voxel is NaN or infinite. Replace"),
    "spacing NaN": (sheet(), {"spacing": (NAN, 1, 1)}, r"spacing is \(nan, .*\). Pass 3 positive, finite"),
    "spacing zero": (sheet(), {"spacing": (0, 1, 1)}, r"spacing is \(?0.*\)?. Pass 3 positive"),
    "spacing of two": (sheet(), {"spacing": (1, 1)}, r"spacing is \(1.*\). Pass 3"),
    "affine NaN": (sheet(), {"affine": affine(a03=NAN)}, r"nan.*is not finite. Repair"),
    "affine zero": (sheet(), {"affine": affine(a00=0)}, r"voxel sizes \[0.0, 1.0, 1.0\] mm"),
    "affine sheared": (sheet(), {"affine": affine(a01=0.5)}, r"sheared: the cosine .* is 0.447.*Resample"),
    "affine of shape (3, 3)": (sheet(), {"affine": np.eye(3)}, r"shape \(3, 3\). Pass a \(4, 4\)"),
    "affine and spacing": (sheet(), {"affine": np.eye(4), "spacing": (1, 1, 1)}, r"both .* Omit spacing"),
    "one voxel": (few((2, 2, 2)), {}, r"a point of 1 voxel\(s\).*wider label"),
    "a line": (LINE, {}, r"a line of 8 voxel\(s\).*wider label"),
    "a diagonal": (DIAGONAL, {}, r"a line of 8 voxel\(s\).*wider label"),
    "two sources": (sheet(), {"sources": 2}, r"2 sources are too few. Pass at least 3"),
    "two given sources": (sheet(), {"sources": [[0, 0, 2], [9, 9, 2]]}, r"2 sources are too few"),
    "sources off the surface": (
        sheet(),
        {"sources": [[0, 0, 2], [5, 9, 0], [20, 9, 2]]},
        r"voxel \[5, 9, 0\] is not on the surface. Pass a surface voxel; the nearest one is \[5, 9, 2\]",
    ),
    "sources outside": (sheet(), {"sources": [[0, 0, 2], [-1, 9, 2], [9, 9, 2]]}, r"\[-1, 9, 2\].*\[0, 9, 2\]"),
    "sources elsewhere": (
        sheet(cut=10),
        {"sources": [[20, 0, 2], [30, 9, 2], [3, 7, 2]]},
        r"source \[3, 7, 2\] .* outside the patch or component in use \(1160 of 1560 .*. Choose",
    ),
    "sources twice": (sheet(), {"sources": [[9, 9, 2], [0, 0, 2], [9, 9, 2]]}, r"\[9, 9, 2\] is given 2 times"),
    "sources on a line": (sheet(), {"sources": [[0, 0, 2], [9, 0, 2], [20, 0, 2]]}, r"only 1 eigenvalue\(s\)"),
    "fractional sources": (sheet(), {"sources": [[0.5, 0, 2]] * 3}, r"sources must be voxel indices \(integers\)"),
    "pieces": (sheet(), {"keep": kept(np.s_[:5], np.s_[30:])}, r"2 separate pieces \(400, 200 voxels\). Keep one"),
    "small mask": (sheet(), {"keep": np.ones((3, 4, 5))}, r"shape \(3, 4, 5\), but the volume has \(40, 40, 5\)"),
    "mask to drop": (sheet(), {"drop": np.ones((3, 3, 3))}, r"mask to drop has shape \(3, 3, 3\)"),
    "mask empty": (sheet(), {"keep": kept()}, r"mask to keep is empty: every voxel is 0"),
    "mask beside": (sheet(), {"keep": kept(np.s_[:, :, 0])}, r"contains no triangle of the surface \(1600 vertices"),
    "mask of NaN": (sheet(), {"keep": kept() + np.float32(NAN)}, r"mask to keep contains NaN. Set"),
    "radius zero": (sheet(), {"seed_point": (1, 1, 2), "radius": 0}, r"radius is 0 mm. Pass a positive"),
    "radius NaN": (sheet(), {"seed_point": (1, 1, 2), "radius": NAN}, r"radius is NaN mm. Pass a positive"),
    "radius infinite": (sheet(), {"seed_point": (1, 1, 2), "radius": INF}, r"radius is inf mm. Pass a .* finite"),
    "radius text": (sheet(), {"seed_point": (1, 1, 2), "radius": "5 mm"}, r"radius is '5 mm'. Pass a number"),
    "radius below a voxel": (sheet(), {"seed_point": (1, 1, 2), "radius": 0.5}, r"0.5 mm of it. Pass a larger radius"),
    "seed point outside": (
        sheet(),
        {"seed_point": (1, 1, 90), "radius": 5},
        r"outside the volume of 40 x 40 x 5 voxels",
    ),
    "seed point far off": (
        np.pad(sheet(), [(0, 0), (0, 0), (0, 95)]),
        {"seed_point": (1, 1, 90), "radius": 5},
        r"\[1, 1, 90\] is 88.0 mm away .* voxel \[1, 1, 2\]\), which is farther than the patch radius of 5 mm. Choose",
    ),
    "seed point afar": (sheet(), {"seed_point": (2**63 - 1, -(2**63), 0), "radius": 5}, r"Choose the seed point on"),
    "seed point of two": (sheet(), {"seed_point": (1, 1), "radius": 5}, r"seed point must be .*\(2,\)"),
    "seed point fractional": (sheet(), {"seed_point": (1.5, 1, 2), "radius": 5}, r"seed point must be .*whole"),
    "closed": (
        shapes.ball(8),
        {},
        r"the surface is closed.*Flatten a patch: pass a seed point and a radius .* or a mask",
    ),
    "memory": (sheet(), {"memory_limit": 10**6}, r"MiB of memory is needed, but the limit is 976.6 KiB. Crop"),
    "memory for the volume": (sheet(), {"memory_limit": 50_000}, r"KiB\. Crop or downsample the volume"),
    "method": (sheet(), {"method": "tsne"}, "Pass 'voxflat', .* 'saucan2006', or an object from voxflat.methods"),
    "sampling": (sheet(), {"sampling": "best"}, r"sampling is 'best'. Pass 'farthest' or 'random'"),
    "link lengths": (sheet(), {"link_lengths": "city-block"}, r"link_lengths is 'city-block'. Pass"),
    "seed negative": (sheet(), {"seed": -1}, r"seed is -1. Pass a whole number from 0"),
    "seed too large": (sheet(), {"seed": 2**64}, r"seed is 18446744073709551616. Pass"),
    "seed fractional": (sheet(), {"seed": 1.5}, r"seed is 1.5. Pass a whole number"),
    "no seed": (sheet(), {"seed": None}, r"seed is None. Pass a whole number"),
    "no thread": (sheet(), {"threads": 0}, r"threads is 0. Pass a number from 1"),
    "threads fractional": (sheet(), {"threads": 1.5}, r"threads is 1.5. Pass a number from 1"),
    "threads beyond all": (sheet(), {"threads": 100_000}, r"threads is 100000. Pass a number from 1 to \d+"),
}
OPTIONS = dict.fromkeys(("label", "threshold", "radius", "sources", "memory_limit", "seed", "threads"), str)
OPTIONS |= dict.fromkeys(("spacing", "seed_point"), lambda value: ",".join(map(str, value)))
"""Options of the API that also exist on the command line."""
WRONG_USAGE = {"spacing of two", "seed point of two", "seed point fractional", "threshold text", "radius text"}
WRONG_USAGE |= {"seed fractional", "no seed", "threads fractional", "sampling", "link lengths"}
WRONG_USAGE |= {"seed negative", "seed too large", "no thread", "threads beyond all"}
WRONG_USAGE |= {"threshold NaN", "radius NaN", "radius infinite"}


def on_the_command_line(name):
    """Tell whether a case can be passed on the command line without a usage error."""
    volume, options, _ = API[name]
    is_volume = isinstance(volume, np.ndarray) and volume.dtype.kind in "biuf"
    is_known = options.keys() <= {"keep", *OPTIONS} and not isinstance(options.get("sources"), list)
    return is_volume and is_known and name not in WRONG_USAGE


def fails(folder, *arguments):
    """Run a command that must print a one-line error and write nothing; return the line."""
    before = snapshot(folder)
    result = run(*arguments)
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    *notes, error = result.stderr.splitlines()
    assert all("of memory will be used" in note for note in notes)
    assert len(notes) <= 1
    assert error.startswith("voxflat: error: ")
    assert snapshot(folder) == before
    return error


def snapshot(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize("name", API)
def test_python(name):
    volume, options, message = API[name]
    refused(message, composed.flatten, volume, **{"method": "grossmann2002", **options})


@pytest.mark.parametrize("name", filter(on_the_command_line, API))
def test_command_line(name, tmp_path):
    volume, options, message = API[name]
    np.save(tmp_path / "in.npy", volume)
    arguments = ["--method", "grossmann2002"]
    for key, value in options.items():
        if key == "keep":
            np.save(tmp_path / "keep.npy", value)
        text = tmp_path / "keep.npy" if key == "keep" else OPTIONS[key](value)
        arguments += ["--" + key.replace("_", "-"), text]
    assert re.search(message, fails(tmp_path, "flatten", tmp_path / "in.npy", "-o", tmp_path / "map.npz", *arguments))


@pytest.mark.parametrize("name", sorted(WRONG_USAGE))
def test_wrong_usage(name, tmp_path):
    _, options, _ = API[name]
    np.save(tmp_path / "in.npy", sheet())
    arguments = ["flatten", tmp_path / "in.npy", "-o", tmp_path / "map.npz"]
    for key, value in options.items():
        arguments += ["--" + key.replace("_", "-"), OPTIONS.get(key, str)(value)]
    assert run(*arguments).exit_code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["in.npy"]


def test_memory_is_checked_before_the_start():
    stages = []
    how = {"method": "grossmann2002", "memory_limit": 10**6, "progress": lambda stage, *_: stages.append(stage)}
    refused("of memory is needed", voxflat.flatten, sheet(), **how)
    assert "measuring distances" not in stages
    assert "classical scaling" not in stages


# ---------------------------------------------------------------------------------------------- files


def nifti(path, volume=None, place=None):
    nib.save(nib.Nifti1Image(sheet() if volume is None else volume, np.eye(4) if place is None else place), path)
    return path


def nan_affine(path):
    nifti(path)
    raw = bytearray(path.read_bytes())
    for offset in (268, 280):  # of qoffset_x and srow_x
        raw[offset : offset + 4] = np.float32(NAN).tobytes()
    path.write_bytes(raw)


BAD_FILES = {
    "truncated.nii.gz": (lambda path: cut_file(nifti(path), -20), r"truncated\.nii\.gz: .*(ended|end|complete)"),
    "text.nii": (lambda path: path.write_text("no image\n" * 100), r"text\.nii: "),
    "empty.nii": (lambda path: path.write_bytes(b""), r"empty\.nii: "),
    "directory.nii": (lambda path: path.mkdir(), r"directory\.nii: is a directory. Pass a volume file"),
    "missing.nii": (lambda path: None, r"missing\.nii.*: No such file|No such file.*missing\.nii"),
    "unknown.xyz": (lambda path: path.write_bytes(b"?"), r"ending '\.xyz'. Use one of \.nii,"),
    "series.nii": (lambda path: nifti(path, np.ones((3, 3, 3, 2), np.uint8)), r"Select one"),
    "shear.nii": (lambda path: nifti(path, place=affine(a01=0.5)), r"shear\.nii: .*sheared: the cosine .* Resample"),
    "nan_affine.nii": (nan_affine, r"is not finite. Repair"),
    "pickle.npy": (lambda path: path.write_bytes(pickle.dumps(sheet())), r"pickle\.npy: "),
    "objects.npy": (lambda path: np.save(path, np.array([{}]), allow_pickle=True), r"objects\.npy: .*"),
    "truncated.npy": (lambda path: (np.save(path, sheet()), cut_file(path)), r"truncated\.npy: "),
    "truncated.npz": (lambda path: (np.savez(path, sheet()), cut_file(path)), r"truncated\.npz: .*Write it again"),
}


def cut_file(path, size=None):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2 if size is None else size])


@pytest.mark.parametrize("name", BAD_FILES)
@pytest.mark.parametrize("command", ["flatten", "check"])
def test_bad_files(name, command, tmp_path, capfd):
    make, message = BAD_FILES[name]
    make(tmp_path / name)
    with pytest.raises(FileNotFoundError if name.startswith("missing") else voxflat.InputError, match=message):
        getattr(voxflat, command)(tmp_path / name)
    assert capfd.readouterr().err == ""
    output = ["-o", tmp_path / "map.npz"] if command == "flatten" else []
    assert re.search(message, fails(tmp_path, command, tmp_path / name, *output))


def test_compressed_and_plain_file_of_one_name(tmp_path):
    nifti(tmp_path / "in.nii", sheet())
    nifti(tmp_path / "in.nii.gz", 2 * sheet())
    assert voxflat.check(tmp_path / "in.nii.gz").contents["labels"] == {2: 1600}


def test_a_mask_that_lies_elsewhere(tmp_path):
    surface = nifti(tmp_path / "in.nii.gz")
    keep = nifti(tmp_path / "keep.nii.gz", kept(np.s_[:20]), affine(a03=2.0))
    refused(r"the affines of the mask to keep and the volume differ. Resample", voxflat.surface(surface).keep, keep)
    assert "affines of the mask" in fails(tmp_path, "flatten", surface, "--keep", keep, "-o", tmp_path / "map.npz")


# --------------------------------------------------------------------------------------------- outputs


BAD_OUTPUTS = {
    "missing/map.npz": (FileNotFoundError, r"No such file or directory"),
    "file/map.npz": (NotADirectoryError, r"Not a directory"),
    "folder.npz": (IsADirectoryError, r"Is a directory"),
    "locked/map.npz": (PermissionError, r"Permission denied"),
    "map.gii": (voxflat.InputError, r"map\.gii.*(must end|ends) in \.npz"),
    "map": (voxflat.InputError, r"map.*(must end|ends) in \.npz"),
}


@pytest.fixture(scope="module")
def flat_map():
    return voxflat.flatten(sheet(), method=Voxflat(sources=20))


@pytest.mark.medium
@pytest.mark.parametrize("name", BAD_OUTPUTS)
def test_bad_outputs(name, flat_map, tmp_path, monkeypatch):
    if name.startswith("locked") and getattr(os, "geteuid", int)() == 0:
        pytest.skip("this user can write everywhere")
    (kind, message), out = BAD_OUTPUTS[name], tmp_path / name
    np.save(tmp_path / "in.npy", sheet())
    (tmp_path / "file").write_text("a file")
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "locked").mkdir(0o555)
    with pytest.raises(kind, match=message) as told:
        flat_map.save(out)
    assert kind is voxflat.InputError or told.value.filename == str(out)
    # the command line must check the output before the long computation
    monkeypatch.setattr("voxflat.cli.commands.flatten.surface_of", lambda *_, **__: pytest.fail("flattened first"))
    shown = fails(tmp_path, "flatten", tmp_path / "in.npy", "-o", out)
    assert re.search(message, shown)
    assert str(out) in shown


# ------------------------------------------------------------------------------------------ interruption


@pytest.mark.medium
@pytest.mark.parametrize("stage", ["placing the vertices", "choosing sources", "measuring distortion"])
def test_progress_that_says_no_cancels(stage):
    with pytest.raises(voxflat.Cancelled):
        voxflat.flatten(sheet(), method=Voxflat(sources=20), progress=lambda now, done, total: now != stage)


def test_an_error_in_progress_comes_through():
    def progress(stage, done, total):
        raise ZeroDivisionError(stage)

    with pytest.raises(ZeroDivisionError, match="checking the foreground"):
        voxflat.flatten(sheet(), progress=progress)


# ------------------------------------------------------------------------------------------ damaged maps


def other_byte(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)


def without(path, name):
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files if key != name}
    np.savez(path, **arrays)


BAD_MAPS = {
    "truncated": cut_file,
    "empty": lambda path: path.write_bytes(b""),
    "other byte": other_byte,
    "other npz": lambda path: np.savez(path, data=sheet()),
    "array without archive": lambda path: np.save(path.open("wb"), sheet()),
    "without uv": lambda path: without(path, "uv"),
    "without metadata": lambda path: without(path, "metadata"),
    "pickle": lambda path: path.write_bytes(pickle.dumps({"uv": 1})),
    "pickled objects": lambda path: np.savez(path, metadata=np.array([{}], dtype=object)),
    "metadata of another kind": lambda path: np.savez(path, metadata=np.array("[1, 2]")),
    "a number as metadata": lambda path: np.savez(path, metadata=np.array("7")),
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_damaged_maps(name, flat_map, tmp_path):
    path = tmp_path / "map.npz"
    flat_map.save(path)
    BAD_MAPS[name](path)
    refused(r"map\.npz is not a flat map of voxflat, or is damaged", voxflat.load, path)
    line = fails(tmp_path, "image", path, "--heat-map", "-o", tmp_path / "heat.png")
    assert "is not a flat map of voxflat, or is damaged" in line


def test_a_map_that_is_missing(tmp_path):
    path = tmp_path / "map.npz"
    with pytest.raises(FileNotFoundError):
        voxflat.load(path)
    assert "map.npz: No such file" in fails(tmp_path, "image", path, "--heat-map", "-o", tmp_path / "a.png")


BAD_IMAGES = {
    "ending": (["--heat-map", "-o", "a.jpg"], r"a\.jpg: unknown .* Choose a name that ends in \.png or \.tif"),
    "directory": (["--heat-map", "-o", "missing/a.png"], r"a\.png: No such file or directory"),
    "volume missing": (["--volume", "t1.nii", "-o", "a.png"], r"t1\.nii: No such file"),
    "volume of another shape": (["--volume", "small.npy", "-o", "a.png"], r"shape \(8, 8, 8\).*Pass a volume of that"),
    "pixel size negative": (["--heat-map", "--pixel-size", "-1", "-o", "a.png"], r"pixel size is -1 mm. Pass a pos"),
    "tiny pixels": (["--heat-map", "--pixel-size", "1e-9", "-o", "a.png"], r". Pass a pixel size above 0\.000000001"),
}


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_bad_images(name, flat_map, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, message = BAD_IMAGES[name]
    flat_map.save("map.npz")
    np.save("small.npy", LINE)
    assert re.search(message, fails(tmp_path, "image", "map.npz", *arguments))
