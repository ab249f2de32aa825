"""Output files: inputs are never overwritten, results do not depend on the terminal, and each file has a record."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import nibabel as nib
import numpy as np
import pytest
from command_line import fail, run, succeed
from lab_runs import everything
from PIL import Image
from refusals import refused
from triangle_meshes import bump, square

import voxflat
from voxflat.io.provenance import described, portable
from voxflat.io.volumes import write_volume
from voxflat.methods import Voxflat

pytestmark = pytest.mark.slow  # the fixtures take seconds

PROGRAM = Path(sys.executable).with_name("voxflat")


def sha256(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Create a working directory with a white and a pial surface, a solid, an image of it, and a picture."""
    monkeypatch.chdir(tmp_path)
    points, faces = bump(12)
    nib.freesurfer.write_geometry("lh.white", points, faces)
    nib.freesurfer.write_geometry("lh.pial", points + np.array([0, 0, 2]), faces)
    solid = np.pad(np.ones((6, 6, 6), np.uint8), 3)
    write_volume("solid.nii.gz", solid, np.eye(4))
    write_volume("p.nii.gz", solid.astype(np.float32), np.eye(4))
    np.save("sheet.npy", np.pad(np.ones((10, 10, 1), np.uint8), 2))
    Image.fromarray(np.full((9, 9, 3), 77, np.uint8)).save("bricks.png")
    return tmp_path


REFUSED = {
    "pial": "surface lh.white --pial lh.pial -o lh.pial",
    "pial by another name": "surface lh.white --pial lh.pial -o ./lh.pial",
    "hard link": "surface lh.white --pial lh.pial -o lh.hard",
    "symbolic link": "surface lh.white --pial lh.pial -o lh.soft",
    "volume": "surface solid.nii.gz --repair voxels --repaired solid.nii.gz -o s.ply",
    "probability": "surface solid.nii.gz --probability p.nii.gz --repair voxels --repaired p.nii.gz -o s.ply",
    "cuts": "cut lh.white --cuts cuts.obj -o cuts.obj",
    "file of cuts": "cut lh.white --cuts cuts.json -o cuts.json",
    "polygon": "flatten lh.white --polygon corners.obj -o corners.obj",
    "sidecar": "flatten lh.white --drop drop.ply.json -o drop.ply --sidecar",
    "texture": "texture map.npz t.png -o t.vtp",
    "page": "patches lh.white --volume v.png --page v.png -o a.obj",
    "heat maps": "measure lh.white flat.png --heat-maps flat.png",
    "path": "path lh.white 0 5 --geodesic edges -o lh.white",
    "source": "flatten map.npz -o map.npz",
    "mask": "flatten sheet.npy --keep map.npz -o map.npz",
    "image": "image map.npz --volume v.nii -o v.nii",
    "volume twice": "surface solid.nii.gz --repair voxels --repaired s.ply -o ./s.ply",
    "page twice": "patches lh.white -o page.vtp --page page.png",
    "sidecar twice": "surface lh.white -o s.ply --sidecar --repaired s.ply.json",
}


@pytest.mark.parametrize("case", REFUSED)
def test_no_output_is_an_input_or_written_twice(folder, case):
    os.link("lh.pial", "lh.hard")
    os.symlink("lh.pial", "lh.soft")
    Path("cuts.obj").write_text("0\n1\n2\n")
    Path("corners.obj").write_text("0\n5\n100\n")
    for name in ("cuts.json", "drop.ply.json", "map.npz", "t.png", "v.png", "flat.png", "v.nii"):
        Path(name).write_text("{}")
    before = everything(folder)
    told = "twice" if case.endswith("twice") else "it is an input"
    fail(1, f"{told}. Choose another name", *REFUSED[case].split())
    assert everything(folder) == before


def test_files_beside_replace_only_what_is_ours(folder):
    succeed("flatten", "sheet.npy", "-o", "map.npz", "--sources", 20)
    for beside, name in (("brick.png", "brick.obj"), ("brick.mtl", "brick.obj"), ("brick.png", "brick.vtp")):
        Path(beside).write_bytes(b"another's")
        done = fail(1, f"{beside} exists and was not written", "texture", "map.npz", "bricks.png", "-o", name)
        assert "--overwrite" in done.stderr
        assert Path(beside).read_bytes() == b"another's"
        assert not Path(name).exists()
        refused("exists and was not written by voxflat", voxflat.load("map.npz").textured("bricks.png").save, name)
        succeed("texture", "map.npz", "bricks.png", "-o", name, "--overwrite")
        succeed("texture", "map.npz", "bricks.png", "-o", name)  # voxflat wrote these files
        for path in ("brick.obj", "brick.mtl", "brick.png", "brick.vtp"):
            Path(path).unlink(missing_ok=True)
    Path("s.ply.json").write_text('{"another": "tool"}')
    assert run("surface", "lh.white", "-o", "s.ply", "--sidecar").exit_code == 1
    assert not Path("s.ply").exists()
    for more in (["--overwrite"], []):
        succeed("surface", "lh.white", "-o", "s.ply", "--sidecar", *more)


def test_python_writes_over_no_input_either(folder):
    surface = voxflat.surface("lh.white", pial="lh.pial")
    flat_map = voxflat.flatten(surface, method=Voxflat(sources=20))
    before = everything(folder)
    for result, path in ((surface, "lh.pial"), (surface, folder / "lh.white"), (flat_map, "lh.pial")):
        refused("it is an input", result.save, path)
    assert everything(folder) == before
    flat_map.save("map.npz")
    voxflat.load("map.npz").save("map.npz")  # which is not an input of the map


def test_a_texture_found_beside_a_surface_is_an_input(folder):
    voxflat.flatten("lh.white", method=Voxflat(sources=20)).save("map.npz")
    points, faces = bump(12)
    lines = ["mtllib face.mtl", *("v {} {} {}".format(*point) for point in points)]
    lines += [*("vt {} {}".format(*point[:2] / 12) for point in points), "usemtl skin"]
    lines += ["f " + " ".join(f"{corner}/{corner}" for corner in face + 1) for face in faces]
    Path("face.obj").write_text("\n".join(lines) + "\n")
    Path("face.mtl").write_text("newmtl skin\nmap_Kd face.png\n")
    Image.fromarray(np.full((9, 9, 3), 77, np.uint8)).save("face.png")
    before = everything(folder)
    fail(1, "it is an input (face.png)", "image", "map.npz", "--volume", "face.obj", "-o", "face.png")
    assert everything(folder) == before
    done = run("image", "map.npz", "--volume", "face.obj", "-o", "flat.png", "--json")
    files = json.loads(done.stdout)["provenance"]["files"]
    assert files == {name: sha256(name) for name in ("map.npz", "face.obj", "face.mtl", "face.png")}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("where", ["2>&-", "2>/dev/full", ">&-", "0<&- >&- 2>&-", ">/dev/full"])
def test_the_map_is_saved_whatever_becomes_of_the_terminal(folder, where):
    command = f"{PROGRAM} flatten sheet.npy -o map.npz --sources 20 --json {where}"
    done = subprocess.run(command, shell=True, check=False, capture_output=True, timeout=120)
    assert done.returncode == (where == ">/dev/full")
    assert len(voxflat.load("map.npz")) == 100


@pytest.mark.parametrize(
    ("command", "status", "error"),
    [
        ("flatten none.npy -o m.npz", 1, "none.npy: No such file or directory"),
        ("surface sheet.npy --label 7 -o s.ply", 1, "no voxel has label 7"),
        ("image m.npz --heat-map -o m.bmp", 1, "cannot write m.bmp"),
        ("texture m.npz -o m.obj", 2, "Missing argument 'PICTURE'"),
        ("flatten lh.white --label 3 -o m.npz", 1, "label does not apply"),
        ("path lh.white 0", 2, "Pass at least two stops."),
        ("demo -o lh.white", 1, "lh.white"),
    ],
)
def test_errors_are_json_too(folder, command, status, error):
    result = run(*command.split(), "--json")
    assert result.exit_code == status
    told = json.loads(result.stdout)
    assert set(told) == {"error", "exit_code"}
    assert told["exit_code"] == status
    assert error in told["error"]
    assert result.stderr  # for human readers


def test_a_record_is_in_every_kind_of_file(folder):
    np.savetxt("keep.txt", np.ones(169), fmt="%d")
    arguments = ["flatten", "lh.white", "--pial", "lh.pial", "--keep", "keep.txt", "--sources", 20]
    succeed(*arguments, "-o", "lh.flat.surf.gii", "--sidecar")
    succeed(*arguments, "-o", "map.npz")
    record = json.loads(nib.load("lh.flat.surf.gii").meta["Provenance"])
    assert record == json.loads(Path("lh.flat.surf.gii.json").read_text())
    with np.load("map.npz") as file:
        kept = json.loads(str(file["metadata"]))["provenance"]
    assert kept == {name: value for name, value in record.items() if name not in ("figures", "warnings", "space")}
    assert (record["voxflat"], record["function"]) == (voxflat.__version__, "flatten")
    part = record["parameters"]["of"]
    surface = part["parameters"]["of"]
    assert (surface["parameters"]["source"], surface["parameters"]["pial"]) == ("lh.white", "lh.pial")
    assert (part["function"], part["parameters"]["region"]) == ("keep", "keep.txt")
    used = record["parameters"]["method"]
    assert used.items() >= {"method": "voxflat", "sources": 20, "geodesic": "graph", "weighting": 0.5}.items()
    assert record["parameters"]["seed"] == 0
    assert part["files"] == {"keep.txt": sha256("keep.txt")}
    assert surface["files"] == {name: sha256(name) for name in ("lh.white", "lh.pial")}
    flat_map = voxflat.load("map.npz")
    assert record["figures"] == flat_map.distortion.figures()

    np.savetxt("values.txt", np.arange(169.0))
    for name in ("image.png", "image.nii.gz", "image.tif", "image.npy"):
        done = run("image", "map.npz", "--volume", "values.txt", "-o", name, "--json", "--sidecar")
        told = json.loads(done.stdout)["provenance"]
        assert told["files"] == {name: sha256(name) for name in ("map.npz", "values.txt")}
        assert told["parameters"]["volume"] == "values.txt"
        assert told["parameters"]["pixel_size"] == flat_map.pixel_size
        assert told["parameters"]["of"] == record
        assert json.loads(Path(f"{name}.json").read_text()) == told
        if name == "image.png":
            assert json.loads(Image.open(name).text["Provenance"]) == told
        if name == "image.tif":
            (image,) = ElementTree.fromstring(Image.open(name).tag_v2[270]).findall("{*}Image")
            assert image.findtext("{*}Description").endswith("Provenance: " + json.dumps(told))
        if name == "image.nii.gz":
            (extension,) = nib.load(name).header.extensions
            assert (extension.get_code(), json.loads(extension.get_content())) == (6, told)
    succeed("image", "map.npz", "--heat-map", "-o", "heat.png")
    heat = json.loads(Image.open("heat.png").text["Provenance"])
    assert (heat["function"], heat["parameters"]["of"]) == ("heat_map", record)


def test_other_results_have_records(folder):
    files = {"lh.white": sha256("lh.white")}

    def told(*command):
        return json.loads(succeed(*command, "--json").stdout)

    succeed("cut", "lh.white", "-o", "cuts.json")
    record = json.loads(Path("cuts.json").read_text())["provenance"]
    assert (record["function"], record["parameters"]["of"]["files"]) == ("cut", files)
    succeed("flatten", "lh.white", "--cuts", "cuts.json", "-o", "m.npz", "--sources", 20)
    assert voxflat.load("m.npz").provenance["files"] == {"cuts.json": sha256("cuts.json")}
    made = told("surface", "lh.white", "-o", "s.surf.gii")
    assert made["metadata"]["provenance"] == json.loads(nib.load("s.surf.gii").meta["Provenance"])
    assert told("measure", "lh.white", "m.npz")["provenance"]["files"] == {"m.npz": sha256("m.npz")}
    kept = told("rows", "lh.white", "--sources", 5, "--store", "rows")
    assert kept["provenance"]["parameters"]["sources"] == 5
    assert voxflat.open_rows("rows").provenance == kept["provenance"]
    assert told("path", "lh.white", 0, 5)["provenance"]["parameters"]["of"]["files"] == files
    assert told("patches", "lh.white", "-o", "a.npz", "--glue", 1.5, "--page", "page.png")["metadata"]["provenance"]
    glued = json.loads(Image.open("page.png").text["Provenance"])
    assert (glued["function"], glued["parameters"]["bound"]) == ("glue", 1.5)
    assert glued["parameters"]["of"]["function"] == "patches"
    assert glued["parameters"]["of"]["parameters"]["of"]["files"] == files
    succeed("surface", "solid.nii.gz", "--repair", "voxels", "--repaired", "r.nii", "-o", "r.ply")
    (extension,) = nib.load("r.nii").header.extensions
    assert json.loads(extension.get_content())["files"] == {"solid.nii.gz": sha256("solid.nii.gz")}
    textured = told("texture", "m.npz", "bricks.png", "-o", "t.obj")
    assert json.loads(Image.open("t.png").text["Provenance"]) == textured["provenance"]
    assert textured["provenance"]["files"] == {name: sha256(name) for name in ("m.npz", "bricks.png")}


def test_no_path_travels_with_a_file(folder, tmp_path, monkeypatch):
    """No output contains the folder of an input; two inputs with the same name have different entries."""
    secret = tmp_path / "secret project"
    (secret / "a").mkdir(parents=True)
    (secret / "b").mkdir()
    for name in ("a", "b"):
        shutil.copy("lh.white", secret / name / "lh.white")
    with (secret / "b" / "lh.white").open("ab") as file:
        file.write(b" ")
    np.savetxt(secret / "values.txt", np.arange(169.0))
    surface = voxflat.surface(secret / "a" / "lh.white")
    voxflat.surface(str(secret / "b" / "lh.white"))
    made = surface.cut("automatic", relax=False)
    made.save("cuts.json")
    flat_map = made.flatten(Voxflat(sources=20))
    for name in ("m.npz", "m.surf.gii", "m.vtp"):
        flat_map.save(name, sidecar=True)
    image = flat_map.image(str(secret / "values.txt"))
    for name in ("i.png", "i.nii", "i.tif", "i.npy"):
        image.save(name, sidecar=True)
    voxflat.figures.save(flat_map.plot(secret / "values.txt"), "f.png")
    surface.patches(count=2).save("atlas.npz")
    written = [path for path in Path().iterdir() if path.suffix not in (".white",)]
    assert len(written) > 14
    for path in written:
        data = path.read_bytes() if path.is_file() else b""
        if path.suffix == ".npz":
            data = b"".join(bytes(array) for array in np.load(path).values())
        assert b"secret" not in data
        assert "secret".encode("utf-32-le") not in data  # the encoding of text in NumPy
    refused("is an input", voxflat.load("m.npz").save, secret / "a" / "lh.white")
    two = portable({"files": {str(secret / name / "lh.white"): name for name in "ab"}})
    assert two == {"files": {"lh.white": "a", "lh.white (2)": "b"}}
    monkeypatch.setenv("VOXFLAT_KEEP_PATHS", "1")
    flat_map.save("kept.npz")
    assert str(secret / "a" / "lh.white") in json.dumps(voxflat.load("kept.npz").provenance)


def test_arrays_are_told_by_their_hash(folder):
    points, faces = square(6)
    keep = np.arange(49) >= 0
    record = voxflat.surface((points, faces)).keep(keep).flatten(Voxflat(sources=[0, 5, 48])).provenance
    assert record["parameters"]["method"]["sources"] == [0, 5, 48]
    told = {"dtype": "bool", "shape": [49], "sha256": hashlib.sha256(keep.tobytes()).hexdigest()}
    assert record["parameters"]["of"]["parameters"]["region"] == told
    assert record["files"] == {}


def test_what_json_can_hold_of_a_parameter():
    assert described([np.float32(0.5), np.int64(3), np.bool_(True), float("nan")]) == [0.5, 3, True, "nan"]
    assert described({"a": (1, None), "b": Path("a/b.nii")}) == {"a": [1, None], "b": "a/b.nii"}
    assert described(np.eye(2)) == [[1.0, 0.0], [0.0, 1.0]]
    assert (described(np.array([object()])), described(object())) == ("ndarray", "object")


def test_long_lists_are_told_by_their_hash():
    ragged = [[0, 1], np.arange(3), *([1],) * 40]
    assert described(ragged) == described([list(map(int, path)) for path in ragged])
    assert described(ragged)["length"] == 42
    assert described(ragged) != described(ragged[::-1])
    assert described(np.arange(99.0))["sha256"] == described(np.arange(99.0).astype(">f8"))["sha256"]
    assert described(np.arange(99.0))["sha256"] == hashlib.sha256(np.arange(99.0).tobytes()).hexdigest()


def test_the_same_call_writes_the_same_bytes(folder):
    for name in ("a", "b"):
        for ending in (".npz", ".surf.gii"):
            arguments = ["flatten", "lh.white", "--sources", 20, "-o", f"{name}{ending}"]
            succeed(*arguments, "--threads", 1 if name == "a" else 2)
    assert sha256("a.surf.gii") == sha256("b.surf.gii")
    for name in ("a", "b"):
        voxflat.load("a.npz").heat_map().save(f"{name}.png")
    assert sha256("a.png") == sha256("b.png")


def test_points_of_which_none_is_on_the_map_are_an_error(tmp_path):
    flat_map = voxflat.samples.hill().flatten()
    flat_map.save(tmp_path / "map.npz")
    np.savetxt(tmp_path / "points.csv", 1000 * flat_map.points[:3], delimiter=",")
    words = ("points", tmp_path / "map.npz", tmp_path / "points.csv", "-o", tmp_path / "uv.csv")
    assert "in µm" in fail(1, "0 of 3 points are within", *words).stderr
    assert not (tmp_path / "uv.csv").exists()
