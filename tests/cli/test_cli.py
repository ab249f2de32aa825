import importlib.metadata
import inspect
import json
import os
import platform
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import nibabel as nib
import numpy as np
import pytest
from command_line import every_command, fail, run, succeed
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused

import voxflat
from voxflat import cli, demo
from voxflat.cli import options as _options
from voxflat.cli.console import in_options
from voxflat.io.volumes import read_volume, write_volume
from voxflat.maps.colours import are_labels, label_colours
from voxflat.maps.raster import FlatImage

pytestmark = pytest.mark.slow  # the fixtures take seconds

AFFINE = np.array([[0, -0.8, 0, 10], [0.8, 0, 0, -20], [0, 0, 0.8, 5], [0, 0, 0, 1.0]])
FLATTEN, IMAGE = "flatten a.nii -o m.npz", "image m.npz -o a.png"
PROGRAM = Path(sys.executable).with_name("voxflat")


def half_cylinder(radius=8, length=24):
    i, j = np.indices((2 * radius + 5, radius + 5))
    bow = (np.abs(np.hypot(i - radius - 2, j - 1) - radius) < 0.8) & (j >= 1)
    return np.repeat(bow[..., None], length, axis=2).astype(np.uint8)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """Create inputs and a map, which the tests do not change."""
    folder = tmp_path_factory.mktemp("shared")
    surface = half_cylinder()
    i, _, k = np.indices(surface.shape)
    rng = np.random.default_rng(3)
    volumes = {
        "surface": surface,
        "t1": (100 + 5 * k + rng.normal(0, 9, surface.shape)).astype(np.float32),
        "t1_whole": rng.integers(60, 200, surface.shape).astype(np.int16),
        "areas": (1 + k // 8 + 10 * (i // 7)).astype(np.int16),
        "colours": rng.integers(0, 256, (*surface.shape, 3), dtype=np.uint8),
    }
    for name, data in volumes.items():
        write_volume(folder / f"{name}.nii.gz", data, AFFINE)
    np.save(folder / "surface.npy", surface)
    voxflat.flatten(folder / "surface.nii.gz", method=voxflat.methods.Voxflat(sources=60)).save(folder / "map.npz")
    return folder


@pytest.fixture(scope="module")
def flat_map(shared):
    return voxflat.load(shared / "map.npz")


def test_flatten_saves_the_map_of_the_function_and_tells_what_it_did(shared, flat_map, tmp_path):
    out = tmp_path / "map.npz"
    result = succeed("flatten", shared / "surface.nii.gz", "-o", out, "--sources", 60)
    assert_array_equal(voxflat.load(out).uv, flat_map.uv)
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]
    assert re.search(rf"flattened +{len(flat_map)} of {len(flat_map)} points, all\n", result.stdout)
    assert flat_map.distortion.table() in result.stdout
    assert f"saved as {out}" in result.stdout
    assert "%|" not in result.stderr  # a pipe has no progress bar


def test_flatten_says_which_part(shared, tmp_path):
    surface = np.pad(half_cylinder(), [(0, 0), (0, 4), (0, 0)])
    surface[:4, -1, :4] = 1
    np.save(tmp_path / "two.npy", surface)
    arguments = ["flatten", tmp_path / "two.npy", "-o", tmp_path / "map.npz"]
    told = run(*arguments)
    assert "the largest component" in told.stdout
    assert "warning: the surface has 2 components" in told.stderr
    assert "within 6.0 mm of voxel [10, 9, 12]" in run(*arguments, "--seed-point", "10,9,12", "--radius", "6").stdout
    np.save(tmp_path / "keep.npy", np.indices(surface.shape)[2] > 8)
    assert "inside the mask" in run(*arguments, "--keep", tmp_path / "keep.npy").stdout


def test_flatten_warns_of_cuts_on_stderr(shared, tmp_path):
    surface = np.ones((20, 20, 1), np.uint8)
    surface[8:12, 8:12] = 0
    np.save(tmp_path / "ring.npy", surface)
    result = succeed("flatten", tmp_path / "ring.npy", "-o", tmp_path / "map.npz", "--method", "zigelman2002")
    memory, *warnings = result.stderr.splitlines()
    assert re.fullmatch(r"voxflat: up to \S+ [KM]iB of memory will be used", memory)
    wanted = "warning: the surface is not a disk (0 handles, 2 boundary loops), so it was cut open"
    assert any(wanted in warning for warning in warnings)
    assert "warning" not in result.stdout


def test_memory_sizes():
    sizes = {"1000": 1000, "4G": 2**32, "1.5k": 1536, "512MiB": 2**29, "2 TB": 2**41}
    assert {text: _options._bytes(None, None, text) for text in sizes} == sizes


def test_rows_are_kept_without_a_word(shared, tmp_path):
    result = run("flatten", shared / "surface.nii.gz", "-o", tmp_path / "map.npz", "--sources", 20, "--rows", "--quiet")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "", "")
    assert len(voxflat.load(tmp_path / "map.npz").rows) == 20


def test_spacing_places_an_array_and_its_mask(shared, tmp_path):
    np.save(tmp_path / "keep.npy", np.indices(half_cylinder().shape)[2] > 8)
    arguments = ["--spacing", "2,2,2", "--keep", tmp_path / "keep.npy", "-o", tmp_path / "map.npz"]
    succeed("flatten", shared / "surface.npy", *arguments)
    assert voxflat.load(tmp_path / "map.npz").spacing == pytest.approx(2)


def test_json_is_one_object_in_which_undefined_figures_are_null(shared, tmp_path):
    out = tmp_path / "map.npz"
    result = succeed("flatten", shared / "surface.npy", "-o", out, "--sources", "60", "--json")
    assert "of memory will be used" in result.stderr
    content, saved = json.loads(result.stdout), voxflat.load(out)
    assert (content["output"], content["points"]) == (str(out), len(saved))
    assert content["distortion"]["raw"]["relative_error"] == saved.distortion.raw.relative_error
    assert content["warnings"] == saved.metadata["warnings"]
    arguments = ["--spacing", "20,20,20", "--json", "-o", tmp_path / "map.npz"]
    result = run("flatten", shared / "surface.npy", *arguments)  # all pairs are at least 10 mm apart
    content = json.loads(result.stdout, parse_constant=pytest.fail)
    assert content["distortion"]["raw"]["relative_error_10mm"] is None
    assert content["distortion"]["raw"]["relative_error"] > 0


def test_check_says_yes_or_no(shared, tmp_path):
    result = succeed("check", shared / "surface.nii.gz")
    assert (result.stdout, result.stderr) == (voxflat.check(shared / "surface.nii.gz").table() + "\n", "")
    box = np.pad(np.ones((6, 6, 6), np.uint8), 2)
    box[0, 0, 0] = 2
    np.save(tmp_path / "box.npy", box)
    assert "pass a label or a threshold" in run("check", tmp_path / "box.npy").stdout
    content = json.loads(fail(1, "", "check", tmp_path / "box.npy", "--json").stdout)  # the label is ambiguous
    assert content["can_flatten"] is False
    assert content["contents"]["labels"] == {"1": 216, "2": 1}
    content = json.loads(succeed("check", tmp_path / "box.npy", "--label", 1, "--json").stdout)  # a closed surface
    assert (content["closed"], content["euler_characteristic"]) == (True, 2)
    assert "it was cut open along 1 path (" in content["advice"][0]
    volume = np.zeros((5, 5, 5))
    volume[2, 2, 2] = np.nan
    np.save(tmp_path / "nan.npy", volume)
    result = fail(1, "", "check", tmp_path / "nan.npy", "--json")
    content = json.loads(result.stdout, parse_constant=pytest.fail)
    assert content["contents"]["range"] == [None, None]
    assert "NaN" in content["advice"][0]


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_files_hold_the_values(shared, flat_map, tmp_path, interpolation):
    expected = flat_map.image(shared / "t1.nii.gz", 0.5, interpolation=interpolation)
    for ending in (".tif", ".tiff", ".nii", ".nii.gz", ".npy"):
        out = tmp_path / f"t1{ending}"
        options = ["--pixel-size", 0.5, "--interpolation", interpolation, "-o", out]
        succeed("image", shared / "map.npz", "--volume", shared / "t1.nii.gz", *options)
        if ending == ".npy":
            assert_array_equal(np.load(out), expected.data)
            continue
        if ".nii" in ending:
            volume = nib.load(out)
            assert_allclose(volume.affine, expected.affine, atol=1e-5)
            values = np.asarray(volume.dataobj)[..., 0]
        else:
            picture = Image.open(out)
            assert float(picture.tag_v2[282]) == float(picture.tag_v2[283]) == 20  # pixels
            assert picture.tag_v2[296] == 3  # per cm
            values = np.asarray(picture)
        assert values.dtype == np.float32
        assert_array_equal(values, expected.data.astype(np.float32))  # also NaN outside the map


def test_png_of_scalars_is_grey_and_transparent_outside(shared, flat_map, tmp_path):
    out = tmp_path / "t1.png"
    run("image", shared / "map.npz", "--volume", shared / "t1.nii.gz", "-o", out)
    expected = flat_map.image(shared / "t1.nii.gz")
    picture = Image.open(out)
    assert picture.mode == "LA"
    grey, alpha = (np.asarray(channel) for channel in picture.split())
    inside = np.isfinite(expected.data)
    assert_array_equal(alpha, np.where(inside, 255, 0))
    low, high = np.percentile(expected.data[inside], (1, 99))
    assert_array_equal(grey[inside], np.round(255 * np.clip((expected.data[inside] - low) / (high - low), 0, 1)))
    assert picture.text["Values"] == f"black {low:g}, white {high:g} (1st and 99th percentiles)"
    assert picture.text["Pixel size"] == f"{expected.pixel_size:.9g} mm"
    assert picture.info["dpi"][0] == pytest.approx(25.4 / expected.pixel_size, abs=0.02)


def test_png_of_labels_has_one_colour_each(shared, flat_map, tmp_path):
    out = tmp_path / "areas.png"
    run("image", shared / "map.npz", "--volume", shared / "areas.nii.gz", "-o", out)
    labels = flat_map.image(shared / "areas.nii.gz").data
    picture = np.asarray(Image.open(out).convert("RGBA"))
    assert_array_equal(picture[..., 3], np.where(np.isnan(labels), 0, 255))
    colours = [np.unique(picture[labels == label], axis=0) for label in np.unique(labels[np.isfinite(labels)])]
    assert all(len(colour) == 1 for colour in colours)
    assert len(np.unique(np.concatenate(colours), axis=0)) == len(colours) > 5


def test_neighbouring_label_numbers_look_different():
    colours = label_colours(np.arange(400.0)[:, None])[:, 0, :3].astype(float)
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=2) + 1e9 * np.eye(len(colours))
    assert distances.min() > 0
    near = np.abs(np.subtract.outer(np.arange(400), np.arange(400)))
    assert distances[(near > 0) & (near <= 4)].min() > 40


def test_whole_intensities_are_no_labels(shared):
    flat_map = voxflat.flatten(shared / "surface.nii.gz", method=voxflat.methods.Grossmann2002(sources=60))
    assert are_labels(flat_map.image(shared / "areas.nii.gz").data)
    assert not are_labels(flat_map.image(shared / "t1_whole.nii.gz").data)
    assert not are_labels(flat_map.image(shared / "t1_whole.nii.gz", 0.1).data)  # many pixels per voxel
    assert not are_labels(flat_map.image(shared / "t1.nii.gz").data)
    assert not are_labels(flat_map.image(shared / "colours.nii.gz").data)


@pytest.mark.parametrize("ending", [".png", ".tif", ".nii.gz", ".npy"])
def test_colours_stay_as_they_are(shared, flat_map, tmp_path, ending):
    out = tmp_path / f"colours{ending}"
    succeed("image", shared / "map.npz", "--volume", shared / "colours.nii.gz", "-o", out)
    expected = flat_map.image(shared / "colours.nii.gz").data
    if ending in (".png", ".tif"):
        picture = Image.open(out)
        assert picture.mode == "RGBA"
        values = np.asarray(picture)
    else:
        values = np.load(out) if ending == ".npy" else read_volume(out).data[:, :, 0]
    assert_array_equal(values, expected)


def test_heat_map(shared, flat_map, tmp_path):
    for ending in (".png", ".tif"):
        succeed("image", shared / "map.npz", "--heat-map", "-o", tmp_path / f"heat{ending}")
    assert min(Image.open(tmp_path / "heat.png").size) > 800  # a figure, not an image of the pixels
    assert_array_equal(np.asarray(Image.open(tmp_path / "heat.tif")), flat_map.heat_map().data.astype(np.float32))


def test_a_volume_that_lies_elsewhere_is_no_empty_picture(shared, tmp_path):
    far = AFFINE.copy()
    far[0, 3] += 500
    write_volume(tmp_path / "far.nii.gz", np.ones((5, 5, 5), np.float32), far)
    words = ["image", shared / "map.npz", "--volume", tmp_path / "far.nii.gz", "-o", tmp_path / "far.png"]
    fail(1, "does not overlap the map, so the image would be empty. Compare their positions", *words)
    told = "does not overlap the map at this depth, so the image would be empty. Pass a smaller --depth, or compare"
    fail(1, told, *words, "--depth", "500")
    assert not (tmp_path / "far.png").exists()


def test_labels_never_change_silently(tmp_path):
    image = FlatImage(np.array([[1.0, 614454277.0], [np.nan, 2.0]]), 0.5, (0.0, 0.0), "Allen atlas")
    for ending in (".tif", ".nii.gz"):
        refused(r"614454277, is too large for float32.*Save as \.npy", image.save, tmp_path / f"atlas{ending}")
    assert list(tmp_path.iterdir()) == []
    image.save(tmp_path / "atlas.npy")
    assert_array_equal(np.load(tmp_path / "atlas.npy"), image.data)


def test_constant_and_partly_infinite_images_can_be_drawn(tmp_path):
    for data in (np.full((4, 4), 0.5), np.array([[0.5, np.inf], [np.nan, 1.5]]), np.full((4, 4), np.nan)):
        FlatImage(data, 0.5, (0.0, 0.0), "volume").save(tmp_path / "image.png")
        alpha = np.asarray(Image.open(tmp_path / "image.png").convert("RGBA"))[..., 3]
        assert_array_equal(alpha, np.where(np.isfinite(data), 255, 0))


def test_demo_runs_in_its_directory_or_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "run", lambda output, progress=None, tell=print: tell(f"{output} {progress}"))
    result = run("demo", "-o", tmp_path / "results")
    assert (result.exit_code, result.stdout) == (0, f"{tmp_path / 'results'} None\n")
    missing = ModuleNotFoundError("No module named 'pyvista'", name="pyvista")
    monkeypatch.setattr(demo, "run", Mock(side_effect=missing))
    told = "voxflat: error: the demo requires pyvista. Run pip install 'voxflat[lab,pyvista]'\n"
    assert fail(1, "", "demo").stderr == told


@pytest.mark.parametrize("command", [(), ("bench",), *every_command()])
def test_help(command):
    for flag in ("-h", "--help"):
        assert succeed(*command, flag).stdout.startswith("Usage: voxflat")
    assert run("--version").stdout == f"voxflat {voxflat.__version__}\n"


def default_in_help(command, option, method):
    """Return the default in --help for a method, or the general default if the method does not have its own."""
    text = run(command, "--help").stdout
    found = re.search(rf"^  {option} .*?(?=^  -|\Z)", text, re.MULTILINE | re.DOTALL)[0]
    told = re.search(r"\[default: ([^]]*)\]", " ".join(found.split()))[1].split("; ")
    return dict(part.split(": ") for part in told[1:]).get(method, told[0])


@pytest.mark.parametrize(
    ("method", "size", "options"),
    [
        ("voxflat", 24, ["sources", "sampling", "weighting", "scale"]),
        ("grossmann2002", 33, ["sources", "sampling", "link_lengths"]),
        ("zigelman2002", 30, ["sources", "sampling"]),
        ("schwartz1989", 12, ["sources", "sampling", "starts"]),
        ("saucan2006", 12, ["bound"]),
    ],
)
def test_the_defaults_in_help_are_those_that_are_used(tmp_path, method, size, options):
    np.save(tmp_path / "sheet.npy", np.ones((size, size, 1), np.uint8))
    result = run("flatten", tmp_path / "sheet.npy", "--method", method, "--json", "-o", tmp_path / "map.npz")
    used = json.loads(result.stdout)
    if method == "voxflat":
        assert default_in_help("flatten", "--method", None) == method
    used["starts"] = len(used.get("starts", ()))  # one stress value per start
    for option in options:
        assert default_in_help("flatten", f"--{option.replace('_', '-')}", method) == str(used[option])


FUNCTIONS = {"flatten": voxflat.flatten, "check": voxflat.check, "surface": voxflat.surface, "measure": voxflat.compare}
FUNCTIONS |= {"rows": voxflat.Surface.geodesic}
FUNCTIONS |= {name: getattr(voxflat.Surface, name) for name in ("cut", "path", "patches")}


@pytest.mark.parametrize(("command", "function"), FUNCTIONS.items())
def test_commands_and_functions_have_the_same_defaults(command, function):
    usual = {name: parameter.default for name, parameter in inspect.signature(function).parameters.items()}
    for option in cli.main.get_command(None, command).params:
        if option.name in usual and not option.required:
            told = option.to_info_dict()["default"]
            assert (told or None) == (usual[option.name] or None)  # None, 0 and False are equivalent


@pytest.mark.parametrize(
    "arguments",
    [
        *("unknown", "flatten a.nii", f"{FLATTEN} --sampling best", f"{FLATTEN} --label 1.5"),
        *(f"{FLATTEN} --seed-point 1,2", f"{FLATTEN} --seed-point 1,2,x", f"{FLATTEN} --spacing 1;1;1"),
        *(f"{FLATTEN} --memory-limit much", f"{FLATTEN} --memory-limit -1G"),
        *(IMAGE, f"{IMAGE} --heat-map --volume t1.nii", f"{IMAGE} --heat-map --interpolation linear"),
    ],
)
def test_wrong_usage_is_status_2(arguments):
    assert fail(2, "Usage: voxflat", *arguments.split()).stdout == ""


@pytest.mark.parametrize(
    ("raised", "status", "told"),
    [
        (ZeroDivisionError("a\nb"), 1, r"voxflat: error: ZeroDivisionError: a b \(.*\n"),
        (KeyboardInterrupt(), 130, "voxflat: cancelled\n"),
        (voxflat.Cancelled("cancelled"), 130, "voxflat: cancelled\n"),
    ],
)
def test_errors_and_cancellation_are_one_line(shared, tmp_path, monkeypatch, raised, status, told):
    monkeypatch.setattr("voxflat.cli.commands.flatten.surface_of", Mock(side_effect=raised))
    arguments = ["flatten", shared / "surface.nii.gz", "-o", tmp_path / "map.npz"]
    result = run(*arguments)
    assert result.exit_code == status
    assert re.fullmatch(told, result.stderr)
    if status == 1:
        assert "Traceback" in run(*arguments, "--debug").stderr


@pytest.mark.skipif(os.name == "nt", reason="no pseudo-terminals")
def test_ctrl_c_during_the_long_work(tmp_path):
    import fcntl
    import pty
    import struct
    import termios

    np.save(tmp_path / "sheet.npy", np.ones((220, 220, 1), np.uint8))
    terminal, stderr = pty.openpty()
    fcntl.ioctl(stderr, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))  # progress bars need a width
    command = [PROGRAM, "flatten", tmp_path / "sheet.npy", "-o", tmp_path / "map.npz", "--sampling", "random"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr) as process:
        os.close(stderr)
        try:
            shown = read_terminal(terminal, until=b"measuring distances")
            assert b"measuring distances" in shown
            process.send_signal(signal.SIGINT)
            start = time.monotonic()
            status = process.wait(timeout=60)
            seconds = time.monotonic() - start
            shown += read_terminal(terminal)
        finally:
            process.kill()
            os.close(terminal)
        assert process.stdout.read() == b""
    assert status == 130
    assert seconds < 5  # half a second on an idle machine
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.npy"]
    assert shown.decode().rsplit("\r", 2)[-2] == "voxflat: cancelled"  # bars are overwritten by spaces
    assert "Traceback" not in shown.decode()


def read_terminal(terminal, until=None, seconds=120):
    """Read the output of a terminal until a text appears, or to the end."""
    shown = b""
    end = time.monotonic() + seconds
    while until is None or until not in shown:
        ready, _, _ = select.select([terminal], [], [], max(0, end - time.monotonic()))
        assert ready, f"nothing for {seconds} s after {shown!r}"
        try:
            piece = os.read(terminal, 4096)
        except OSError:  # Linux reports that the other end is closed
            return shown
        if not piece:
            return shown
        shown += piece
    return shown


@pytest.mark.skipif(os.name == "nt", reason="pipes differ")
def test_a_reader_that_leaves_early_is_no_error(shared):
    with subprocess.Popen([PROGRAM, "check", shared / "surface.npy"], stdout=-1, stderr=-1) as process:
        process.stdout.close()
        assert process.stderr.read() == b""


def test_python_m(shared):
    command = [sys.executable, "-m", "voxflat.cli", "check", shared / "surface.npy"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0
    assert re.search(r"can be flattened +yes", result.stdout)


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["flaten"]])
def test_starting_needs_no_numbers_no_plotting_and_no_gui(arguments):
    code = "import sys; from voxflat.cli import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
    heavy = {"numpy", "scipy", "psutil", "tqdm", "nibabel", "matplotlib", "napari", "pyvista", "itk"}
    code += f"print(*{heavy} & {{*sys.modules}})"
    command = [sys.executable, "-c", code, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout.splitlines()[-1] == ""


def test_the_table_of_commands_agrees_with_their_modules():
    modules = {path.stem for path in Path(cli.__file__).parent.glob("commands/[a-z]*.py")}
    assert modules == {module for module, _ in cli.program.COMMANDS.values()}
    assert list(cli.program.COMMANDS) == sorted(cli.main.commands)
    for name, (_, summary) in cli.program.COMMANDS.items():
        command = cli.main.get_command(None, name)
        assert (command.name, " ".join(command.help.split("\n\n")[0].split())) == (name, summary)


def test_every_command_prints_json():
    for command in every_command().values():
        assert any("--json" in parameter.opts for parameter in command.params)


def test_info_tells_what_a_bug_report_needs():
    told = json.loads(succeed("info", "--json").stdout)
    assert (told["voxflat"], told["threads"]) == (voxflat.__version__, os.cpu_count())
    assert told["python"].startswith(platform.python_version())
    assert 0 < told["free_memory_bytes"] <= told["memory_bytes"]
    assert told["packages"]["numpy"] == np.__version__
    text = succeed("info").stdout
    for name in ("voxflat", "python", "system", "cpu", "threads", "memory", *told["packages"]):
        assert re.search(rf"^{name} +\S", text, re.MULTILINE)
    assert platform.node() not in text


def test_info_works_in_a_checkout_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(importlib.metadata, "requires", Mock(side_effect=importlib.metadata.PackageNotFoundError))
    assert json.loads(succeed("info", "--json").stdout)["packages"].keys() == {"vtk", "pyqt6"}


def test_messages_name_options_in_place_of_keyword_arguments():
    flatten = cli.main.get_command(None, "flatten")
    for text, shown in (
        ("Use relax=False to omit them", "Use --no-relax to omit them"),
        ("Pass a file, or pass the values as an array to use them anyway", "Pass a file"),
        ("Pass cuts='automatic' or repair='cuts'", "Pass --cuts automatic or --repair cuts"),
        ("seed_point is given without radius", "--seed-point is given without --radius"),
        ("max_area and scale are both given", "--max-area and --scale are both given"),
        ("sources and scale are both given", "--sources and --scale are both given"),
        ("scale does not apply. Pass sources", "--scale does not apply. Pass --sources"),
        ("Pass sources, bound or max_area", "Pass --sources, --bound or --max-area"),
        ("the label is given by a radius or by seed_point", "the label is given by a radius or by --seed-point"),
        ("Pass repair='cuts' or a label", "Pass --repair cuts or a label"),
        ("the x=3 of lh.max_area_7.gii", "the x=3 of lh.max_area_7.gii"),
        ("label=2 is the left and label=[3, 41] the right", "--label 2 is the left and --label 3,41 the right"),
        ("start does not contain 3 triangles", "--start does not contain 3 triangles"),
        ("radius is (5, 1). Pass a number", "--radius is 5, 1. Pass a number"),
        ("Extract one hemisphere with voxflat.hemisphere", "Extract one hemisphere with --hemisphere"),
        (
            "Flatten the white surface with pial=, or pass depth= in mm",
            "Flatten the white surface with --pial, or pass --depth in mm",
        ),
        ("cannot read /data/seed_point/wm.nii", "cannot read /data/seed_point/wm.nii"),
    ):
        assert in_options(text, flatten, cli.main) == shown
        assert in_options(text, None) == text
