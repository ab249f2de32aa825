"""Movies: the content and the time of each frame, and the files."""

import json
import sys
from functools import partial

import composed
import numpy as np
import pytest
from command_line import run
from matplotlib import colormaps
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused, writes_nothing_half
from textures import grid

import voxflat
from voxflat import figures

LONG, HIGH = 30, 16  # vertices of a sheet, 1 mm apart
COUNT = LONG * HIGH
FRAMES = 5


@pytest.fixture(scope="module")
def flat_map():
    """Return the map of a plane, whose positions are those of the surface."""
    return voxflat.flatten(grid(HIGH, LONG), method=voxflat.methods.Voxflat(sources=40), relax=False)


@pytest.fixture(scope="module")
def along(flat_map):
    """Return the position of each vertex along the map, from 0 (left) to 1 (right)."""
    u = np.empty(COUNT)
    u[flat_map.ids] = flat_map.uv[:, 0]
    return (u - u.min()) / np.ptp(u)


@pytest.fixture(scope="module")
def film(flat_map, along):
    """Return a movie: frame n is n + 1 in the left (n + 1) / 6 of the map, and 0 elsewhere."""
    values = np.stack([np.where(along < (n + 1) / 6, n + 1.0, 0.0) for n in range(FRAMES)], axis=1)
    look = {"threshold": (0.5, None), "limits": (0, 6), "colour_map": "magma", "underlay": "none"}
    return composed.movie(flat_map, values, **look, interpolation="nearest", time_step=0.75, rate=8, size=320)


def test_each_frame_shows_its_values_where_they_lie(film):
    height, width = film.size
    assert (width, height % 2) == (320, 0)
    reach = []
    for n in range(FRAMES):
        picture = film[n]
        assert (picture.shape, picture.dtype) == ((height, width, 3), np.uint8)
        shown = np.ptp(picture[: round(0.8 * height)].astype(int), axis=2) > 8  # not grey; without the strip below
        expected = np.array(colormaps["magma"]((n + 1) / 6, bytes=True)[:3], dtype=int)
        inner = shown[1:-1, 1:-1] & shown[2:, 1:-1] & shown[:-2, 1:-1] & shown[1:-1, 2:] & shown[1:-1, :-2]
        colours = picture[: len(shown)][1:-1, 1:-1][inner]
        assert (np.abs(colours - expected).max(axis=1) <= 1).mean() > 0.97  # except the outline and antialiased pixels
        columns = np.flatnonzero(shown.any(axis=0))
        reach.append((columns[-1] - columns[0] + 1) / (width * 117 / 120))  # the margins are 1.5 of 120 mm on each side
    assert_allclose(reach, np.arange(1, FRAMES + 1) / 6, atol=0.03)
    assert columns[0] == pytest.approx(width * 1.5 / 120, abs=2)


def test_frames_are_a_sequence_with_times(film):
    assert (len(film), film._caption(0), film._caption(3)) == (FRAMES, "0.00 s", "2.25 s")
    assert repr(film) == f"<Movie: overlay, 5 frames of 320 x {film.size[0]} pixels, 8 per second>"
    assert_array_equal(film[-1], film[4])
    assert [len(film[1:3]), len(list(film))] == [2, FRAMES]
    corners = [film[n][:16, :60] for n in range(FRAMES)]
    assert all((corner.min(axis=(0, 1)) < 100).all() for corner in corners)  # a text is drawn
    assert len({corner.tobytes() for corner in corners}) == FRAMES
    with pytest.raises(IndexError):
        film[FRAMES]


def test_limits_are_of_all_frames(flat_map):
    """The limits are computed from some of 40 frames."""
    values = np.linspace(-1, 3, 40)[None] + np.zeros((COUNT, 1))
    film = figures.movie(flat_map, values, size=320)
    assert film._caption(7) == "frame 7"
    low, high = film.colours.limits
    assert (low, high) == (-high, high)
    assert high == pytest.approx(3, abs=0.1)
    thirds = figures.movie(flat_map, figures.Overlay(values, limits=("0%", "100%")), size=320).colours.limits
    assert thirds == pytest.approx((-1, 3))


def test_the_change_of_raw_signals(flat_map, along):
    raw = (500 + 300 * along)[:, None] * np.array([1.01, 0.99, 1.0])
    film = figures.movie(flat_map, figures.Overlay(raw, limits=("0%", "100%")), change=True, size=320)
    assert film.colours.limits == pytest.approx((-1, 1), abs=1e-6)
    assert film.colours.colour_map == "RdBu_r"


def test_gif(film, tmp_path):
    figures.save_movie(film, tmp_path / "a.gif", {"voxflat": "x"})
    with Image.open(tmp_path / "a.gif") as file:
        assert (file.n_frames, file.size) == (FRAMES, film.size[::-1])
        assert (file.info["duration"], file.info["loop"]) == (120, 0)
        assert json.loads(file.info["comment"]) == {"voxflat": "x"}
        for n in range(FRAMES):
            file.seek(n)
            assert np.abs(np.asarray(file.convert("RGB")).astype(int) - film[n]).mean() < 3


@pytest.mark.medium
def test_mp4(film, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    figures.save_movie(film, tmp_path / "a.mp4", {"voxflat": "x"})
    frames = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    told = next(frames)
    assert (told["codec"], told["fps"], told["size"]) == ("h264", 8, film.size[::-1])
    assert "yuv420p" in told["pix_fmt"]
    pictures = [np.frombuffer(frame, np.uint8).reshape(*film.size, 3) for frame in frames]
    assert len(pictures) == FRAMES
    for n, picture in enumerate(pictures):
        assert np.abs(picture.astype(int) - film[n]).mean() < 4
    assert b'{"voxflat": "x"}' in (tmp_path / "a.mp4").read_bytes()


@pytest.mark.parametrize("name", ["a.gif", "a.mp4"])
def test_nothing_is_written_half(film, tmp_path, name):
    if name == "a.mp4":
        pytest.importorskip("imageio_ffmpeg")
    writes_nothing_half(partial(figures.save_movie, film), tmp_path / name, FRAMES)


def test_what_writes_mp4_is_named_where_it_is_missing(film, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    missing = r"requires imageio_ffmpeg. Install it with pip install 'voxflat\[lab\]'"
    refused(missing, figures.save_movie, film, tmp_path / "a.mp4")
    refused("cannot write a.avi: .* Use a name that ends in .mp4 or .gif", figures.save_movie, film, tmp_path / "a.avi")


@pytest.mark.medium
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"overlay": np.ones(COUNT)}, "has only one frame. Draw it as a figure"),
        ({"overlay": np.ones((3, 2))}, "3 values"),
        ({"overlay": np.full((COUNT, 2), np.nan)}, "has no values on the map"),
        ({"rate": 0}, "rate is 0. Pass"),
        ({"size": 100}, "size is 100. Pass"),
        ({"size": 640.5}, "size is 640.5. Pass"),
        ({"opacity": 2}, "opacity is 2. Pass a number"),
        ({"underlay": "sulc"}, "underlay is 'sulc'"),
        ({"colour_map": "nothing"}, "no colour map 'nothing'"),
        ({"limits": (3, 2)}, "Pass the lower limit first"),
        ({"time_step": -1}, "time_step is -1"),
    ],
)
def test_what_is_wrong_is_named(flat_map, wrong, said):
    given = {"overlay": np.arange(2.0 * COUNT).reshape(-1, 2), **wrong}
    refused(said, lambda: composed.movie(flat_map, **given)[0])


def test_the_command(flat_map, along, tmp_path):
    flat_map.save(tmp_path / "map.npz")
    np.save(tmp_path / "s.npy", np.outer(along, [1.0, -1.0, 2.0]))

    def movie(output, *more):
        return run("movie", tmp_path / "map.npz", "--overlay", tmp_path / "s.npy", "-o", tmp_path / output, *more)

    look = ["--range", "-2,2", "--above", "0.5", "--below", "-0.5", "--unit", "%", "--size", "320", "--rate", "5"]
    told = json.loads(movie("a.gif", *look, "--time-step", "2", "--json", "--sidecar").stdout)
    assert (told["frames"], told["width"], told["seconds"]) == (3, 320, 0.6)
    assert told["provenance"]["parameters"]["overlay"]["time_step"] == 2
    assert json.loads((tmp_path / "a.gif.json").read_text())["function"] == "movie"
    assert movie("a.avi").exit_code == 1
    assert movie("a.gif", "--depth", "1", "--fraction", "0.5").exit_code == 2
    assert movie("s.npy").exit_code == 1
