# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera paths: accepted files, refused files, and frames between keyframes."""

import json
import math
import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.view.camera_path import hermite, read_camera_path

KEYS = [
    {"frame": 1, "eye": [0, 0, 100], "target": [0, 100, 0]},
    {"frame": 5, "eye": [40, 0, 100], "target": [0, 100, 0], "fov": 30},
    {"frame": 25, "eye": [40, 80, 60], "target": [0, 100, 10], "lens": 36},
]


def path_of(tmp_path, data):
    file = tmp_path / "flight.json"
    file.write_text(data if isinstance(data, str) else json.dumps(data))
    return read_camera_path(file)


def eye_of(view):
    return np.linalg.inv(view.world_to_camera)[:3, 3]


def fov_of(view):
    return math.degrees(2 * math.atan(1 / view.projection[0, 0]))


def test_the_flight_goes_through_its_keyframes(tmp_path):
    path = path_of(tmp_path, {"keyframes": KEYS, "clip": [1, 5000]})
    for key, fov in zip(KEYS, (50.0, 30.0, math.degrees(2 * math.atan(0.5))), strict=True):
        view = path.view(key["frame"], (1920, 1080))
        assert np.allclose(eye_of(view), key["eye"], atol=1e-9)
        assert fov_of(view) == pytest.approx(fov, abs=1e-9)
        looking = -view.world_to_camera[2, :3]
        wanted = np.subtract(key["target"], key["eye"])
        assert np.allclose(looking, wanted / np.linalg.norm(wanted), atol=1e-12)
        assert view.clip == (1, 5000) and view.resolution == (1920, 1080)


def test_outside_the_end_keyframes_hold(tmp_path):
    path = path_of(tmp_path, {"keyframes": KEYS})
    assert path.view(-7, (10, 10)).key() == path.view(1, (10, 10)).key()
    assert path.view(99, (10, 10)).key() == path.view(25, (10, 10)).key()


def test_one_keyframe_is_a_camera_that_stands(tmp_path):
    path = path_of(tmp_path, {"fov": 40, "keyframes": KEYS[:1]})
    assert path.view(3, (10, 10)).key() == path.view(1, (10, 10)).key()
    assert fov_of(path.view(1, (10, 10))) == pytest.approx(40)


def test_speed_is_continuous_and_straight_lines_stay_straight():
    times = np.array([0.0, 1.0, 4.0, 6.0])
    values = np.random.default_rng(1).normal(size=(4, 3))
    for at in (1.0, 4.0):
        before = (hermite(times, values, at) - hermite(times, values, at - 1e-6)) / 1e-6
        after = (hermite(times, values, at + 1e-6) - hermite(times, values, at)) / 1e-6
        assert np.allclose(before, after, atol=1e-4)
    line = np.outer(times, [1.0, -2.0])
    for at in np.linspace(0, 6, 25):
        assert np.allclose(hermite(times, line, at), [at, -2 * at], atol=1e-12)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("not json", "cannot be read"),
        ('{"keyframes": [], "fov": 50, "fov": 60}', "cannot be read ('fov' occurs twice in one object)"),
        ({"keyframes": []}, "has no keyframes"),
        ([1], "has no keyframes"),
        ({"keyframes": [3]}, "keyframe 1 is 3"),
        (
            {"keyframes": [{"frame": 1, "eye": [0, 0], "target": [0, 0, 1]}]},
            "keyframe 1 has eye [0, 0]; expected 3 numbers",
        ),
        ({"keyframes": [{"eye": [0, 0, 0], "target": [0, 0, 1]}]}, "keyframe 1 has frame None; expected a number"),
        ({"keyframes": [{"frame": 1, "eye": [0, 0, 1], "target": [0, 0, 1]}]}, "its eye at its target"),
        ({"keyframes": [KEYS[1], KEYS[0]]}, "expected each larger than the one before"),
        ({"keyframes": [KEYS[0]], "fov": 180}, "field of view of 180 degrees"),
        ({"keyframes": [KEYS[0]], "fov": float("nan")}, "has fov nan; expected a number"),
        ({"keyframes": [{**KEYS[0], "roll": 3}]}, "keyframe 1 has 'roll'; expected eye, fov, frame, lens, target"),
        ({"keyframes": [KEYS[0]], "clip": [1]}, "has clip [1]; expected 2 numbers"),
        ({"keyframes": [KEYS[0]], "clip": [5, 5]}, "has clip [5.0, 5.0]; expected two different distances"),
        ({"keyframes": [KEYS[0]], "clip": [1e200, 2e200]}, "expected two different distances"),
        ({"keyframes": [KEYS[0]], "fov": True}, "has fov True; expected a number"),
        (
            {"keyframes": [KEYS[0]], "fov": 1e-7},
            "field of view of 1e-07 degrees; expected between 1e-06 and 179.999999",
        ),
        ({"keyframes": [{**KEYS[0], "frame": 10**400}]}, "expected a number"),
        ("[" * 100_000, "cannot be read"),
    ],
)
def test_what_is_refused(tmp_path, data, message):
    with pytest.raises(TerrainError) as caught:
        path_of(tmp_path, data)
    assert message in str(caught.value) and "flight.json" in str(caught.value)


def test_the_field_of_view_stays_valid_between_extreme_keyframes(tmp_path):
    fovs = [179, 1, 1e-6, 179.9999, 179.9999, 50]
    keys = [{**KEYS[0], "frame": i**2, "fov": fov} for i, fov in enumerate(fovs)]
    path = path_of(tmp_path, {"keyframes": keys})
    for frame in np.linspace(0, 25, 501):
        view = path.view(frame, (100, 50))
        assert np.isfinite(view.projection).all() and view.projection[0, 0] > 0


def test_a_byte_order_mark_and_a_clip_backwards_are_read(tmp_path):
    path = path_of(tmp_path, "\ufeff" + json.dumps({"keyframes": KEYS[:1], "clip": [10, 1]}))
    assert path.clip == (10, 1)


FAR = [{**KEYS[0], "frame": -1e308}, {**KEYS[1], "frame": 1e308}]
MEETING = [{"frame": 0, "eye": [0, 0, 0], "target": [2, 0, 0]}, {"frame": 2, "eye": [2, 0, 0], "target": [0, 0, 0]}]


@pytest.mark.parametrize(
    ("keys", "frame"),
    [
        ([{**KEYS[0], "frame": 0}, {**KEYS[1], "frame": 1e-320}], 0),
        (FAR, 1),
        ([KEYS[0], {**KEYS[1], "target": [1e300, 0, 0]}], 5),
        (MEETING, 1),
    ],
)
def test_a_frame_without_a_place_is_named(tmp_path, keys, frame):
    path = path_of(tmp_path, {"keyframes": keys})
    with pytest.raises(TerrainError, match=f"no place and direction at frame {frame};"):
        path.view(frame, (10, 10))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TerrainError, match="none.json cannot be read"):
        read_camera_path(tmp_path / "none.json")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(TerrainError, match="pipe.json cannot be read .it is not a regular file"):
        read_camera_path(tmp_path / "pipe.json")
