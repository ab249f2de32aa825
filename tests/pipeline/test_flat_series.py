"""One map for a movie: material points keep their places, and frames that do not belong together are refused."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import voxflat
from voxflat.errors import InputError
from voxflat.pipeline import following
from voxflat.pipeline.landmarks import checked_landmarks
from voxflat.pipeline.series import _largest
from voxflat.pipeline.shapes import Shape, boundary_edges

TURN = Rotation.from_euler("xyz", [5, -4, 6], degrees=True).as_matrix()


def sphere(count, seed):
    """Return a mesh of the unit sphere; each seed has other vertices."""
    step = np.arange(count) + 0.5
    z, turn = 1 - 2 * step / count, step * np.pi * (1 + np.sqrt(5))
    points = np.column_stack([np.cos(turn) * np.sqrt(1 - z**2), np.sin(turn) * np.sqrt(1 - z**2), z])
    points = points @ Rotation.random(random_state=seed).as_matrix()
    faces = ConvexHull(points).simplices
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    inwards = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    return points, faces


def sheet(move, side):
    """Return a mesh of the unit square, moved by a function of x and y."""
    axis = np.linspace(-1, 1, side)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))
    corners = np.arange(side**2).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]))
    return move(x, y), np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def tube(move, rings, side):
    """Return a mesh of an open tube of length 2 and radius 1 along x, moved by a function of its points."""
    along, around = np.meshgrid(np.linspace(-1, 1, rings), 2 * np.pi * np.arange(side) / side, indexing="ij")
    points = np.column_stack([along.ravel(), np.cos(around).ravel(), np.sin(around).ravel()])
    corners = np.arange(rings * side).reshape(rings, side)
    a, b = corners[:-1].ravel(), corners[1:].ravel()
    c, d = (np.roll(part, -1, axis=1).ravel() for part in (corners[1:], corners[:-1]))
    return move(points), np.concatenate([np.column_stack([a, c, b]), np.column_stack([a, d, c])])


def grown(points, frame):
    """Return points that moved with an ellipsoid that grows, turns and drifts."""
    moved = points * [10, 5, 3.5] * (1 + 0.1 * frame)
    return moved @ np.linalg.matrix_power(TURN, frame).T + [0, 2 * frame, 0]


@pytest.fixture(scope="module")
def growth():
    frames = [(grown(points, t), faces) for t, (points, faces) in enumerate(sphere(600 + 50 * t, t) for t in range(3))]
    return voxflat.flatten_series(frames, reference=1), frames


@pytest.mark.medium
def test_material_points_stay_in_place_on_a_growing_turning_surface(growth):
    series, _ = growth
    material = sphere(650, 1)[0][series.flat_map.ids]
    for frame in range(3):
        apart = np.linalg.norm(series.points[frame] - grown(material, frame), axis=1)
        assert np.median(apart) < 0.005 * 20
        assert np.percentile(apart, 95) < 0.015 * 20
    assert not series.folded.any()


@pytest.mark.medium
def test_all_frames_share_the_map_of_the_reference_frame(growth):
    series, frames = growth
    assert series[1] is series.flat_map
    assert np.array_equal(series[0].uv, series[2].uv)
    assert series[0].raster().shape == series[2].raster().shape
    assert np.array_equal(series[1].points, frames[1][0][series.flat_map.ids])
    assert [len(own) for own in series[:2]] == [len(series.flat_map)] * 2
    assert [np.isnan(own.distortion.raw.relative_error) for own in series] == [True, False, True]  # not measured there
    assert np.isnan(series[0].heat_map().data).all()
    for own, normals in zip(series, series.normals, strict=True):  # outwards
        assert ((own.points - own.points.mean(axis=0)) * normals).sum(axis=1).min() > 0


@pytest.mark.medium
def test_points_lie_on_their_frame_which_is_covered(growth):
    series, frames = growth
    for own, (points, faces) in zip(series, frames, strict=True):
        finder = voxflat._core.NearestFinder(np.ascontiguousarray(points), faces.astype(np.uint32))
        assert finder.find(np.ascontiguousarray(own.points), np.inf)[2].max() < 1e-6
    assert series.gaps.max() < 0.2  # a tenth of an edge


def test_stretches_are_those_of_the_growth(growth):
    series, _ = growth
    assert np.nanmedian(series.stretches(2, since=0), axis=0) == pytest.approx([1.2, 1.2], rel=0.02)
    of_map = series.stretches(1)
    assert (of_map[:, 0] >= of_map[:, 1]).all()
    assert np.median(of_map.prod(axis=1)) == pytest.approx(
        np.median(1 / 2**series.flat_map.distortion.triangles.areal), rel=0.01
    )


@pytest.mark.medium
def test_growth_is_shown_on_the_map_of_a_closed_surface():
    points, faces = sphere(800, 1)
    series = voxflat.flatten_series([(10 * points, faces), (11 * points, faces)])
    assert len(series.flat_map) > len(points)  # points on cuts have copies
    growth = series.flat_map.raster(1.0).interpolate(series.stretches(1, since=0).prod(axis=1))
    assert np.isfinite(growth).any()
    assert growth[np.isfinite(growth)] == pytest.approx(1.21, rel=1e-3)


def test_stretches_of_a_sheet_that_is_stretched_in_one_direction():
    frames = [sheet(lambda x, y, s=s: np.column_stack([s * x, y, 0 * x]), side) for s, side in ((1, 20), (1.3, 27))]
    series = voxflat.flatten_series(frames)
    stretches = series.stretches(1, since=0)
    assert np.median(stretches, axis=0) == pytest.approx([1.3, 1.0], abs=0.02)
    rim = np.abs(frames[0][0][:, :2]).max(axis=1) == 1
    on = series.points[1][rim[series.flat_map.ids]] / [1.3, 1, 1]
    assert np.abs(on[:, :2]).max(axis=1) == pytest.approx(1)


def test_each_volume_is_sampled_on_the_surface_of_its_frame(growth):
    series, _ = growth
    affine = np.diag([1.0, 1.0, 1.0, 1.0])
    affine[:3, 3] = -20
    heights = np.broadcast_to(np.arange(40.0) - 20, (40, 40, 40))  # z
    volumes = [voxflat.io.Volume(heights + 100 * t, affine) for t in range(3)]
    stacks = series.images(volumes, pixel_size=0.5, depth=[0.0, 1.0])
    data = np.stack([stack.data for stack in stacks])
    assert data.shape[:2] == (3, 2)
    for t in range(3):
        expected = 100 * t + series[t].raster(0.5).interpolate(series.points[t])[..., 2]
        assert data[t, 0] == pytest.approx(expected, nan_ok=True)


@pytest.mark.medium
@pytest.mark.parametrize("kind", [2, "cylinder"])
def test_charts_of_a_movie_agree_where_they_overlap(growth, kind):
    whole, frames = growth
    charts = voxflat.surface(frames[1]).charts(kind)
    made = voxflat.flatten_series(frames, reference=1, cuts=charts)
    assert [len(one.flat_map) for one in made] == [len(chart.flatten()) for chart in charts]
    points = np.full((3, len(frames[1][0]), 3), np.nan)
    points[:, whole.flat_map.ids] = whole.points
    for one in made:
        assert one.points == pytest.approx(points[:, one.flat_map.ids])
        assert one.gaps.tolist() == whole.gaps.tolist()
    assert np.isin(np.arange(len(frames[1][0])), np.concatenate([one.flat_map.ids for one in made])).all()
    for one in made:  # the two measurements take different samples of the pairs
        own = one.flat_map.distortion
        assert one.measure(1).best_scale.relative_error == pytest.approx(own.best_scale.relative_error, rel=0.01)
        assert one.measure(1).per_point == pytest.approx(own.per_point, rel=0.05, nan_ok=True)
    alone = voxflat.flatten_series(frames, reference=1, cuts=charts[0])
    assert alone.points == pytest.approx(made[0].points)
    assert (made[0].measure(2).best_scale.relative_error or 1) < 0.1  # uniform growth


@pytest.mark.medium
def test_a_wave_that_passes_carries_little_with_it():
    def narrowed(points, time):
        width = 1 - 0.3 * np.exp(-(((points[:, 0] + 0.6 - 1.2 * time) / 0.25) ** 2))
        return points * np.column_stack([10 + 0 * width, 4 * width, 3 * width])

    meshes = [sphere(500 + 9 * t, t) for t in range(9)]
    series = voxflat.flatten_series([(narrowed(points, t / 8), faces) for t, (points, faces) in enumerate(meshes)])
    truth = narrowed(meshes[0][0], 1)[series.flat_map.ids]
    assert np.median(np.linalg.norm(series.points[-1] - truth, axis=1)) < 0.05 * 20
    assert not series.folded.any()


def narrowed_tube(points, time):
    """Return points of a tube along which a contraction passes."""
    width = 1 - 0.3 * np.exp(-(((points[:, 0] + 0.6 - 1.2 * time) / 0.3) ** 2))
    return points * np.column_stack([10 + 0 * width, 4 * width, 3 * width])


def bent(x, y, time):
    """Return points of a square of side 20 that bends by 60 degrees; its normals point to positive z at first."""
    turn = max(time, 1e-6) * np.pi / 3
    return np.column_stack([20 / turn * np.sin(turn * x / 2), 10 * y, 20 / turn * (1 - np.cos(turn * x / 2))])


@pytest.mark.medium
@pytest.mark.parametrize(
    ("move", "made"),
    [
        (narrowed_tube, lambda move, number: tube(move, 29 + 2 * number, 20 + number)),
        (bent, lambda move, number: sheet(move, 22 + number)),
    ],
    ids=["tube", "disk"],
)
def test_open_surfaces_keep_their_material_boundary_and_orientation(move, made):
    def frame(time, number):
        return made(lambda *parts: move(*parts, time), number)

    times = np.linspace(0, 1, 6)
    frames = [frame(time, number) for number, time in enumerate(times)]
    series = voxflat.flatten_series(frames)
    assert not series.folded.any()
    ids, faces = series.flat_map.ids, frames[0][1].astype(np.uint32)
    rim = np.isin(ids, np.unique(boundary_edges(faces)))
    for own, normals, time, target in zip(series.points, series.normals, times, frames, strict=True):
        truth = frame(time, 0)[0]
        apart = np.linalg.norm(own - truth[ids], axis=1)
        assert np.median(apart) < 0.03 * 20
        assert np.percentile(apart, 95) < 0.06 * 20
        assert (normals * voxflat._core.vertex_normals(truth, faces)[ids]).sum(axis=1).min() > 0.5  # outwards
        on = Shape(target[0], target[1].astype(np.uint32)).border.nearest(own[rim])[0]
        assert np.linalg.norm(on - own[rim], axis=1).max() < 0.01


@pytest.mark.medium
def test_a_surface_does_not_turn_where_its_shape_does_not_show_it():
    balls = [sphere(600 + 9 * t, t) for t in range(3)]
    series = voxflat.flatten_series(balls)
    assert np.linalg.norm(series.points - series.points[0], axis=2).max() < 0.06


def turned_balls(count):
    """Return frames of a sphere that turns by 20 degrees per frame, the turns, and 5 landmarks."""
    turns = [Rotation.from_rotvec(np.radians(20) * t * np.array([1, 2, 2]) / 3).as_matrix() for t in range(count)]
    frames = [
        (points @ turn.T, faces)
        for turn, (points, faces) in zip(turns, (sphere(600 + 9 * t, t) for t in range(count)), strict=True)
    ]
    places = sphere(5, 7)[0]
    return frames, turns, np.array([places @ turn.T for turn in turns])


@pytest.mark.medium
def test_landmarks_show_how_a_sphere_turns():
    frames, turns, landmarks = turned_balls(4)
    landmarks[2, 1] = np.nan
    errors = []
    for known in (None, landmarks):
        series = voxflat.flatten_series(frames, landmarks=known)
        true = [frames[0][0][series.flat_map.ids] @ turn.T for turn in turns]
        errors.append(
            [np.linalg.norm(own - points, axis=1).max() for own, points in zip(true, series.points, strict=True)]
        )
        assert not series.folded.any()
    assert errors[0][3] > 0.5  # the shape alone does not tell
    assert max(errors[1]) < 0.06


@pytest.mark.medium
def test_warnings_about_the_surfaces_of_all_frames_are_told(caplog):
    balls = [voxflat.io.Volume(np.roll(voxflat.samples.ball(), n, axis=0), np.eye(4)) for n in (0, 0, 4, 4)]
    stray = balls[1].data.copy()
    stray[1, 1, 1] = stray.max()
    balls[1] = replace(balls[1], data=stray)
    surfaces = [voxflat.surface(one).smooth(4) for one in balls]
    assert not voxflat.flatten_series(surfaces).folded.any()
    told = [line for line in caplog.messages if line.startswith("frame")]
    assert len(told) == 2
    assert told[0].startswith("frame 1: the surface has 2 components; only the largest is used")
    assert told[1].startswith("frame 2: the foreground touches the border of the volume")
    assert told[1].endswith("(and similarly in frame 3)")


@pytest.mark.medium
def test_frames_that_do_not_fit_are_named(caplog):
    points, faces = sphere(600, 0)
    spiked = points * (1 + 1.5 * np.exp(-200 * ((points - points[0]) ** 2).sum(axis=1)))[:, None]
    frames = [voxflat.surface((p, faces), unit="µm") for p in (points, points, spiked * [1, 1, 0.05], points)]
    series = voxflat.flatten_series(frames)
    assert series.folded[:2].tolist() == [0, 0]
    assert series.folded[2] > 0
    (warning,) = [one for one in series.warnings if "folded" in one]
    assert "is folded in frame" in warning
    assert warning in caplog.text
    far = replace(series, gaps=np.array([0, 0.01, 0.5, 0.01]), folded=0 * series.folded)
    assert far.warnings == (
        "the moved surface does not fit frame 2 (95th percentile of the gap: 0.5 µm in frame 2). Check the surfaces "
        "there, or split the movie",
    )
    assert replace(far, gaps=np.full(4, 0.01)).warnings == ()
    many = replace(far, gaps=np.array([0, 0.08, 0.11, 0.03]))  # the median is 0.055
    assert many.warnings == ()
    assert "does not fit frame 2 (" in replace(many, gaps=many.gaps * [1, 1, 2, 1]).warnings[0]  # 0.22 > 3 x 0.055


@pytest.mark.medium
def test_gaps_are_95th_percentiles_of_the_distances_to_the_moved_surface():
    def rough(x, y):
        return np.column_stack([x, y, 0.15 * np.random.default_rng(0).standard_normal(len(x)) ** 3])

    frames = [sheet(lambda x, y: np.column_stack([x, y, 0 * x]), 9), sheet(rough, 21)]
    series = voxflat.flatten_series(frames, relax=False)
    assert len(series.flat_map) == 81  # the moved surface is that of the map, because nothing was cut
    moved = pv.PolyData.from_regular_faces(series.points[1], series.flat_map.faces.astype(int))
    _, nearest = moved.find_closest_cell(frames[1][0], return_closest_point=True)
    distances = np.linalg.norm(nearest - frames[1][0], axis=1)
    assert np.median(distances) < 0.5 * np.percentile(distances, 95)
    assert series.gaps == pytest.approx([0, np.percentile(distances, 95)], rel=1e-4)


@pytest.mark.medium
def test_landmarks_below_the_surface_do_not_pull_it_inwards():
    frames, turns, landmarks = turned_balls(3)
    below = 0.9 * landmarks
    below[1] = np.nan  # nothing is known of this frame
    series = voxflat.flatten_series(frames, landmarks=below)
    assert np.linalg.norm(series.points, axis=2) == pytest.approx(1, abs=0.02)
    truth = frames[0][0][series.flat_map.ids] @ turns[2].T
    assert np.linalg.norm(series.points[2] - truth, axis=1).max() < 0.06


BALL, PLATE = sphere(300, 0), sheet(lambda x, y: np.column_stack([x, y, x * y]), 10)


@pytest.mark.parametrize(
    ("surfaces", "options", "told"),
    [
        ([], {}, "list of surfaces is empty"),
        ([BALL], {}, "is a single frame. Pass two or more frames, or use flatten"),
        ([BALL, None, BALL], {}, "frame 1 is missing"),
        (
            [BALL, PLATE],
            {},
            "frame 1 has 1 component, 0 handles, 1 boundary loop, but frame 0 has 1 component, 0 handles",
        ),
        ([BALL, (BALL[0], BALL[1] + 1)], {}, "frame 1: "),
        ("movie.ply", {}, "Pass a list of surfaces"),
        ([BALL, BALL], {"reference": 2}, "reference is 2. Pass a frame number from 0 to 1"),
        ([BALL, BALL], {"reference": 0.5}, "reference is 0.5"),
        ([voxflat.surface(BALL, unit="µm"), BALL], {}, "frame 1 is in mm, but frame 0 is in µm"),
    ],
)
def test_frames_that_do_not_belong_together_are_refused(surfaces, options, told):
    with pytest.raises(InputError) as error:
        voxflat.flatten_series(surfaces, **options)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


MARKS = np.tile(BALL[0][:4], (2, 1, 1))


def changed(frame, landmark, value):
    """Return landmarks of two balls, one of which differs."""
    places = MARKS.copy()
    places[frame, landmark] = value
    return places


@pytest.mark.parametrize(
    ("landmarks", "told"),
    [
        ("here", "landmarks is 'here'. Pass an array of shape (frames, landmarks, 3)"),
        (MARKS[:1], "landmarks has shape (1, 4, 3). Pass an array of shape (2, landmarks, 3)"),
        (MARKS[..., :2], "landmarks has shape (2, 4, 2)"),
        (MARKS[:, :0], "landmarks has shape (2, 0, 3)"),
        (changed(0, 3, np.nan), "landmark 3 is not known in frame 0, the reference frame"),
        (changed(1, 2, np.inf), "landmark 2 is infinite in frame 1"),
        (changed(1, 2, 2.0), "landmark 2 is 2.47 mm away from the surface of frame 1"),
    ],
)
def test_landmarks_that_do_not_belong_to_the_frames_are_refused(landmarks, told):
    with pytest.raises(InputError) as error:
        voxflat.flatten_series([BALL, BALL], landmarks=landmarks)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="frame_2"):
        voxflat.flatten_series([BALL, tmp_path / "frame_2.ply"])


def test_wrong_frames_and_volumes_are_refused(growth):
    series, _ = growth
    with pytest.raises(IndexError, match="numbered from 0 to 2"):
        series[3]
    with pytest.raises(InputError, match="Pass a whole number"):
        series.stretches(1.5)
    with pytest.raises(InputError, match="got 2 volumes for 3 frames"):
        series.images([np.zeros((4, 4, 4))] * 2)


@pytest.mark.medium
def test_it_can_be_cancelled():
    def progress(stage, done, total):
        return stage != "following the surface"

    with pytest.raises(voxflat.Cancelled):
        voxflat.flatten_series([BALL, BALL], progress=progress)


PRINT_HASH = """
import hashlib, sys
import numpy as np
import voxflat
given = np.load(sys.argv[1])
series = voxflat.flatten_series([(given[f"points{t}"], given["faces"]) for t in range(2)])
print(hashlib.sha256(series.points.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_movies_are_bit_identical_for_any_number_of_threads(tmp_path):
    points, faces = sphere(3000, 0)
    np.savez(tmp_path / "frames.npz", points0=grown(points, 0), points1=grown(points, 1), faces=faces)
    command = [sys.executable, "-c", PRINT_HASH, str(tmp_path / "frames.npz")]
    found = [
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, "OPENBLAS_NUM_THREADS": threads})
        for threads in ("1", "2")
    ]
    assert found[0].stdout == found[1].stdout != b""


def test_the_friction_follows_the_best_rotation_and_never_a_reflection():
    """SciPy's alignment of vectors gives the same rotation, for shapes that turned and for those that are mirrored."""
    points, faces = sphere(300, 0)
    points = points * [3, 2, 1] + [1, 2, 3]
    before = Shape(points, faces.astype(np.uint32))
    turned = points @ Rotation.from_euler("xyz", [40, -70, 20], degrees=True).as_matrix()
    flat = points * [1, 1, 1e-3]
    for now in (turned, turned * [1, 1.2, 0.9], turned * [1, 1, -1], flat * [1, 1, -1]):
        own = points - before.centre
        there = now - Shape(now, before.faces).centre
        rotation, _ = Rotation.align_vectors(there, own, weights=before.areas)
        np.testing.assert_allclose(following._turned(before, now), rotation.apply(own), atol=1e-9)


def test_the_strain_of_a_small_movement_is_that_of_linear_elasticity():
    """A movement u = G x in the plane has the energy area * |(G + Gᵀ) / 2|², in which shear counts twice."""
    points, faces = sheet(lambda x, y: np.column_stack([x, y, 0 * x]), 6)
    surface = voxflat.surface((points, faces))
    follower = following.Follower(surface.core)
    shape = Shape(surface.points, follower.faces)
    for gradient in ([[1, 0], [0, 0]], [[0, 1], [0, 0]], [[0.3, -1], [1, 0.2]], [[0, -1], [1, 0]]):
        movement = np.column_stack([surface.points[:, :2] @ np.transpose(gradient), np.zeros(len(points))])
        parts, misfit, weights = follower._strain(shape, surface.points, len(follower.faces))
        changed = sum(part @ movement[:, axis] for axis, part in enumerate(parts))
        symmetric = (np.array(gradient) + np.transpose(gradient)) / 2
        np.testing.assert_allclose(misfit, 0, atol=1e-12)
        assert weights @ changed**2 == pytest.approx(4.0 * (symmetric**2).sum(), abs=1e-12)  # the area is 4


@pytest.mark.parametrize(("side", "told"), [(2.2, None), (2.4, "frame 3 has 2 components with areas of 100, 5.76 mm²")])
def test_at_most_5_percent_of_a_frame_are_left_out(side, told):
    square, faces = sheet(lambda x, y: np.column_stack([x / 2, y / 2, 0 * x]), 2)
    points = np.concatenate([10 * square, side * square + np.array([20, 0, 0])])
    both = voxflat.surface((points, np.concatenate([faces, faces + 4])))
    if told:
        with pytest.raises(InputError, match=told):
            _largest(both, "frame 3")
    else:
        assert len(_largest(both, "frame 3").faces) == 2


@pytest.mark.parametrize(("radius", "far"), [(1.18, False), (1.25, True)])
def test_landmarks_are_within_a_fifth_of_the_radius(radius, far):
    frames = [voxflat.surface(sphere(600, seed)) for seed in (0, 1)]
    places = np.array([[[1.0, 0, 0]], [[0, radius, 0]]])
    if far:
        with pytest.raises(InputError, match=r"landmark 0 is 0\.25\d? mm away from the surface of frame 1"):
            checked_landmarks(places, frames, 0)
    else:
        assert checked_landmarks(places, frames, 0)[1, 0] == pytest.approx([0, 1, 0], abs=0.02)
