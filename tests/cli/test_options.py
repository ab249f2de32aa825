"""The rules that every option of every command obeys, tested on options collected from the commands themselves."""

import hashlib
import inspect
import json
import logging
import re
import warnings

import click
import numpy as np
import pytest
import tifffile
from command_line import every_command, fail, run, succeed
from messages import NAMES_IN_FILES, OF_PYTHON, PYTHON, messages

import voxflat
from voxflat import cli
from voxflat.cli.console import in_options
from voxflat.cli.options import numbers


def every_option():
    for words, command in every_command().items():
        for one in command.params:
            if isinstance(one, click.Option):
                yield " ".join(words), one


OPTIONS = [pytest.param(name, one, id=f"{name} {one.opts[-1]}") for name, one in every_option()]


@pytest.mark.parametrize(("command", "option"), OPTIONS)
def test_an_option_that_is_given_twice_is_used_twice_or_refused_by_its_name(command, option):
    values = [] if option.is_flag else ["1"] * option.nargs
    words = [option.opts[-1], *values]
    if option.multiple:
        parser = every_command()[tuple(command.split())].make_parser(click.Context(cli.main))
        assert len(parser.parse_args([*words, *words])[0][option.name]) == 2
        return
    result = run(*command.split(), *words, *words)
    assert result.exit_code == 2, result.output
    *_, line = result.stderr.strip().splitlines()
    assert line == f"Error: {option.opts[-1]} is given twice. Pass it once."
    second = (option.secondary_opts or option.opts)[0]  # another spelling is the same option
    assert run(*command.split(), *words, second, *values).exit_code == 2


@pytest.mark.parametrize(("command", "option"), [one for one in OPTIONS if one.values[1].name in ("seed", "threads")])
def test_seeds_and_threads_are_checked_before_any_work(command, option):
    """Some runs do not use them."""
    for value in ("-1", str(2**64)):
        name, remedy = option.opts[0], "Pass a (whole )?number from [01] to"
        assert re.search(f"{name[2:]} is {value}\\. {remedy}", run(command, name, value).stderr)
        assert run(command, name, value).exit_code == 2


HEMISPHERES = [one for one in every_option() if {"--hemisphere", "--hemi", "--side"} & set(one[1].opts)]


@pytest.mark.parametrize(("command", "option"), HEMISPHERES, ids=lambda one: getattr(one, "name", one))
@pytest.mark.parametrize("names", [("left", "L", "lh", "LEFT", "l", "LH"), ("right", "R", "rh", "Right")])
def test_every_option_for_a_hemisphere_accepts_all_its_names(command, option, names):
    assert {option.type.convert(name, option, None) for name in names} == {names[0]}
    with pytest.raises(click.BadParameter):
        option.type.convert("middle", option, None)


@pytest.mark.parametrize(
    ("command", "option", "told"),
    [
        ("bids", "--subject", "Did you mean --participant-label?"),
        ("bids", "--participants", "Did you mean --participant-label?"),
        ("bids", "--qiet", "Did you mean --quiet?"),
        ("flatten", "--subject", 'See "voxflat flatten --help".'),
        ("flatten", "--treads", "Did you mean --threads"),
    ],
)
def test_an_unknown_option_is_refused_with_options_that_are_similar(command, option, told):
    assert fail(2, f"No such option: {option}. {told}", command, option, "1").stderr.count("--quiet") <= ("q" in option)


def test_python_accepts_all_names_of_a_hemisphere():
    from voxflat.arguments import named_side

    assert {named_side(name, "side") for name in ("R", "rh", "RIGHT")} == {"right"}
    labels = np.zeros((3, 3, 12), np.uint8)
    labels[:, :, 2:6], labels[:, :, 6:9] = 41, 42
    assert len(voxflat.rim(labels, hemisphere="R").surface) == len(voxflat.rim(labels, hemisphere="right").surface)
    with pytest.raises(voxflat.InputError, match=r"hemisphere is 'middle'\. Pass 'left' or 'right'"):
        voxflat.rim(labels, hemisphere="middle")


@pytest.fixture
def two_labels(tmp_path):
    """Create a bar of the labels 7, 8 and 9, one after the other."""
    labels = np.zeros((9, 9, 26), np.uint8)
    labels[2:7, 2:7, 2:8], labels[2:7, 2:7, 8:14], labels[2:7, 2:7, 14:24] = 7, 8, 9
    np.save(tmp_path / "labels.npy", labels)
    return labels, tmp_path / "labels.npy"


@pytest.mark.parametrize("words", [("--label", 7, "--label", 8), ("--label", "7,8"), ("--label", "8,7,8")])
def test_several_labels_are_one_foreground(two_labels, tmp_path, words):
    labels, path = two_labels
    joined = voxflat.surface(np.isin(labels, (7, 8)).astype(np.uint8))
    succeed("surface", path, *words, "-o", tmp_path / "joined.ply")
    assert len(voxflat.surface(tmp_path / "joined.ply")) == len(joined)
    made = voxflat.surface(labels, label=[7, 8])
    np.testing.assert_array_equal(made.points, joined.points)
    assert made.metadata["label"] == [7, 8]
    fail(1, "no voxel has label 5", "surface", path, "--label", "7,5", "-o", tmp_path / "none.ply")
    fail(2, "'7,x' is not a label", "surface", path, "--label", "7,x", "-o", tmp_path / "none.ply")
    for wrong in ([], "78", [7, 1.5], {7}):
        with pytest.raises(voxflat.InputError, match=r"the label is .*Pass a whole number"):
            voxflat.surface(labels, label=wrong)


def test_several_regions_are_all_dropped(tmp_path):
    sheet = voxflat.range_image(np.zeros((12, 12)), 1.0)
    sheet.save(tmp_path / "sheet.ply")
    marks = {"a": np.zeros(144), "b": np.zeros(144)}
    marks["a"][:12], marks["b"][-24:] = 1, 1
    for name, values in marks.items():
        np.save(tmp_path / f"{name}.npy", values)
    drops = [word for name in marks for word in ("--drop", tmp_path / f"{name}.npy")]
    succeed("cut", tmp_path / "sheet.ply", *drops, "-o", tmp_path / "part.ply")
    assert len(voxflat.surface(tmp_path / "part.ply")) == 144 - 36


TAKING = sorted({name for name, one in every_option() if one.name in ("spacing", "volume")} - {"bids", "freesurfer"})


@pytest.mark.parametrize("command", TAKING)
def test_every_command_that_reads_a_volume_reads_one_with_channels(command):
    names = {one.name for of, one in every_option() if of == command}
    assert names & {"channel", "rim_channel"} if "spacing" in names else True
    assert names & {"channel", "volume_channel"} or command == "regions"  # which measures all channels


def test_a_channel_of_the_input_is_what_the_file_of_that_channel_is(tmp_path):
    """The surface is the same, and the record contains the channel and the hash of the file."""
    ball = (voxflat.samples.ball() > 0).astype(np.uint8).T
    about = {"imagej": True, "resolution": (0.5, 0.5), "metadata": {"axes": "ZYX", "spacing": 2, "unit": "um"}}
    tifffile.imwrite(tmp_path / "one.tif", ball, **about)
    about["metadata"]["axes"] = "ZCYX"
    tifffile.imwrite(tmp_path / "two.tif", np.stack([0 * ball + 5, ball], axis=1), **about)
    expected = voxflat.surface(tmp_path / "one.tif")
    fail(1, "has 2 channels or time points (c0, c1)", "surface", tmp_path / "two.tif", "-o", tmp_path / "s.vtp")
    told = json.loads(
        succeed("surface", tmp_path / "two.tif", "--channel", "c1", "-o", tmp_path / "s.vtp", "--json").stdout
    )
    np.testing.assert_array_equal(voxflat.surface(tmp_path / "s.vtp").points, expected.points)
    source = told["metadata"]["provenance"]["parameters"]["source"]
    digest = hashlib.sha256((tmp_path / "two.tif").read_bytes()).hexdigest()
    assert source["parameters"] == {"path": str(tmp_path / "two.tif"), "channel": "c1"}
    assert source["files"] == {str(tmp_path / "two.tif"): digest}


@pytest.mark.medium
def test_the_texture_of_patches_is_a_channel_of_their_volume(tmp_path):
    ball = (voxflat.samples.ball() > 0).astype(np.uint8).T
    about = {"imagej": True, "resolution": (0.5, 0.5), "metadata": {"axes": "ZYX", "spacing": 2, "unit": "um"}}
    tifffile.imwrite(tmp_path / "mask.tif", ball, **about)
    about["metadata"]["axes"] = "ZCYX"
    steps = np.broadcast_to(np.arange(24)[:, None, None], ball.shape).astype(np.uint8)
    tifffile.imwrite(tmp_path / "two.tif", np.stack([steps, steps.transpose(1, 0, 2)], axis=1), **about)
    words = (
        "patches",
        tmp_path / "mask.tif",
        "--volume",
        tmp_path / "two.tif",
        "-o",
        tmp_path / "a.obj",
        "--overwrite",
    )
    fail(1, "two.tif: has 2 channels", *words)
    pictures = []
    for channel in (0, 1):
        succeed(*words, "--volume-channel", channel)
        pictures.append((tmp_path / "a.png").read_bytes())
    assert pictures[0] != pictures[1]
    fail(2, "--volume-channel requires --volume", *words[:2], "--volume-channel", 1, *words[4:])


def test_an_option_is_refused_without_the_one_that_uses_it(tmp_path):
    path = tmp_path / "map.npz"
    voxflat.samples.hill().flatten(relax=False).save(path)
    drawn = tmp_path / "drawn.png"
    fail(2, "--strength-channel requires --strength", "figure", path, "--strength-channel", 0, "-o", drawn)
    fail(2, "--depths: only with --volume", "image", path, "--heat-map", "--depths", 0, "-o", drawn)


class _Asked(float):
    """A number that notes that a program asked whether it is true, as in ``if threshold:``, which forgets 0."""

    asked: tuple[str, ...] = ()

    def __bool__(self):
        frame = inspect.currentframe().f_back
        type(self).asked += (f"{frame.f_code.co_filename}:{frame.f_lineno}",)
        return float(self) != 0


NUMBERS = [
    pytest.param(name, one, id=f"{name} {one.opts[-1]}")
    for name, one in every_option()
    if isinstance(one.type, click.types.FloatParamType | click.types.IntParamType)
]


@pytest.mark.slow
@pytest.mark.parametrize(("command", "option"), NUMBERS)
def test_zero_is_a_number_like_any_other(command, option, tmp_path, monkeypatch):
    np.save(tmp_path / "ball.npy", voxflat.samples.ball())
    monkeypatch.setattr(_Asked, "asked", ())
    cast = option.type_cast_value

    def noted(context, value):
        made = cast(context, value)
        return _Asked(made) if type(made) in (int, float) else made

    monkeypatch.setattr(option, "type_cast_value", noted)
    flags = {one.opts[-1] for name, one in every_option() if name == command}
    for more in ([], *(["--rim"] for _ in flags & {"--rim"})):
        run(command, tmp_path / "ball.npy", option.opts[-1], 0, *more)
    assert _Asked.asked == ()


@pytest.mark.parametrize("name", ["threshold", "label"])
def test_an_option_that_rims_do_not_have_is_refused_at_0_too(name, tmp_path):
    np.save(tmp_path / "rim.npy", voxflat.samples.ball())
    fail(1, f"--{name} and --rim cannot be combined", "check", tmp_path / "rim.npy", "--rim", f"--{name}", 0)


@pytest.mark.medium
def test_remedies_say_pass_and_not_give():
    assert [one.place for one in messages() if re.search(r"(?:^|[.;:] )Give\b|\bgive --", one.text)] == []


@pytest.mark.medium
def test_messages_have_no_words_of_python():
    """All texts of the package, with the options of all commands."""
    every = {one.name: one for command in every_command().values() for one in command.params}
    everything = click.Command("all", params=list(every.values()))
    found = {}
    for one in messages():
        if one.path.startswith(("_napari", "_pyvista", "vtk.py")) or OF_PYTHON.search(one.text):
            continue
        text = in_options(re.sub(r"\{[^{}]*\}|%[a-z]", "7", one.text), everything, cli.main)
        for name in NAMES_IN_FILES:
            text = text.replace(name, "")
        if PYTHON.search(text) and "{" not in text:
            found[one.place] = text
    assert found == {}
    assert len(messages()) > 1000


@pytest.mark.medium
def test_all_warnings_have_one_form_and_are_told_once(tmp_path, monkeypatch):
    """Warnings of the package, of other libraries and of Python, in a command without a progress bar."""
    voxflat.samples.hill().flatten().save(tmp_path / "hill.npz")

    def warning(*_, **__):
        for _ in range(2):
            logging.getLogger("voxflat").warning("pass relax=False")
            logging.getLogger("tifffile").warning("page 1 is odd")
            warnings.warn("old", DeprecationWarning, stacklevel=1)
            warnings.warn_explicit("strange values", UserWarning, np.__file__, 7)

    monkeypatch.setattr("voxflat.figures.save", warning)
    before = logging.getLogger().handlers[:], logging.getLogger("voxflat").handlers[:]
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        result = succeed("figure", tmp_path / "hill.npz", "-o", tmp_path / "hill.png")
    told = [line for line in result.stderr.splitlines() if "warning:" in line and "old" not in line]
    expected = ["pass --no-relax", "tifffile: page 1 is odd", "numpy: strange values"]
    assert told == [f"voxflat: warning: {one}" for one in expected]
    assert all(line.startswith("voxflat: ") for line in result.stderr.splitlines())
    assert (logging.getLogger().handlers, logging.getLogger("voxflat").handlers) == before
    ball = tmp_path / "ball.npy"
    np.save(ball, voxflat.samples.ball())
    assert "relax=" not in run("check", ball).stdout


REALS = [one for one in NUMBERS if isinstance(one.values[1].type, click.types.FloatParamType)]
REALS = [one for one in REALS if one.values[1].name != "background"]  # which may be NaN


@pytest.mark.parametrize(("command", "option"), REALS)
def test_every_number_is_finite(command, option):
    for text in ("nan", "inf", "-inf", "1e400"):
        with pytest.raises(click.BadParameter, match=rf"^'{text}' is not a finite number\.$"):
            option.type.convert(text, option, None)
    with pytest.raises(click.BadParameter, match=r"^'x' is not a valid number\.$"):
        option.type.convert("x", option, None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:1:0.1", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]),
        ("0:2.1:0.7", [0.0, 0.7, 1.4, 2.1]),
        ("1:-1:-0.5", [1.0, 0.5, 0.0, -0.5, -1.0]),
        ("0:1:0.3333333333", [0.0, 0.3333333333, 0.6666666666, 1.0]),
        ("4:4:1", [4.0]),
    ],
)
def test_a_range_reaches_its_last_number_up_to_rounding(text, expected):
    assert numbers(None, None, text) == tuple(expected)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("5:-5:1", "the step of the range '5:-5:1' leads away from its last number. Pass 5:-5:-1."),
        ("-5:5:-0.5", "the step of the range '-5:5:-0.5' leads away from its last number. Pass -5:5:0.5."),
        ("-5:5:0", "the step of the range '-5:5:0' is 0. Pass first:last:step, such as -10:10:1."),
        ("0:1:1e-9", "the range '0:1:1e-9' has more than 1,000,000 numbers. Pass a larger step."),
        ("0:1:0.3", "the range '0:1:0.3' ends at 0.9, not at 1. Pass 0:0.9:0.3 or 0:1:0.25."),
        ("-10:10:3", "the range '-10:10:3' ends at 8, not at 10. Pass -10:8:3 or -10:10:2.5."),
        ("1:0:-0.3", "the range '1:0:-0.3' ends at 0.1, not at 0. Pass 1:0.1:-0.3 or 1:0:-0.25."),
        ("0:1:3", "the range '0:1:3' ends at 0, not at 1. Pass 0:1:1."),
        ("0,nan", "'nan' is not finite. Pass finite numbers."),
        ("0:inf:1", "'0:inf:1' is not finite. Pass finite numbers."),
        ("1:2", "'1:2' is not a number, a list of numbers such as 0.25,0.5 or a range such as -10:10:1"),
        ("0,", "'' is not a number, a list of numbers"),
    ],
)
def test_a_list_of_numbers_that_is_wrong_is_told_how(text, told):
    for name, option in every_option():
        if option.callback is numbers:
            with pytest.raises(click.BadParameter) as raised:
                option.callback(click.Context(cli.main), option, text)
            assert raised.value.message.startswith(told), name
