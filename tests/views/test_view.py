"""The verb view: the page and the video of a robot, a solution or a trajectory, and what it
refuses.
"""

from __future__ import annotations

import functools
import itertools
import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.cli.main import main
from flexgen.views.reports import video
from flexgen.views.reports.motion import FRAMES
from flexgen.views.reports.view import end_of_reference

FFMPEG = shutil.which("ffmpeg")


@functools.cache
def solution():
    return flexgen.solve("elbow")


def data_in(page):
    return json.loads(
        page.read_text(encoding="utf-8").split('id="data">')[1].split("</script>")[0]
    )


def test_a_robot_a_solution_and_a_trajectory_show_the_same_motion(tmp_path):
    a = flexgen.view("elbow", tmp_path / "a.html")
    b = flexgen.view(solution(), tmp_path / "b.html")
    assert a == tmp_path / "a.html" and a.read_bytes() == b.read_bytes()
    shown = data_in(a)
    assert (
        shown["simulated"]
        and len(shown["time"]) == FRAMES
        and shown["end"] == solution().move.duration
    )
    file = solution().trajectory.save(tmp_path / "t.npz")
    for what in (solution().trajectory, file, str(solution().trajectory.save(tmp_path / "t.csv"))):
        planned = data_in(flexgen.view(what, tmp_path / "c.html"))
        assert not planned["simulated"] and abs(planned["end"] - shown["end"]) < 2e-3
        assert np.abs(np.array(planned["poses"][0]) - np.array(shown["poses"][0])).max() < 1e-3


ENDS = {
    "in the path": ([[0, 0], [0, 0], [1, 0], [1, 2], [1, 2]], 1.0),
    "with the last sample": ([[0, 0], [0, 0], [1, 0], [1, 2], [1, 3]], 2.0),
    "at the start": ([[0, 1], [0, 0], [0, 0], [0, 0], [0, 0]], 0.0),
    "without motion": (5 * [[1, 1]], 0.0),
}


@pytest.mark.parametrize("name", ENDS)
def test_the_end_of_a_path_is_where_its_reference_stays(name):
    rows, end = ENDS[name]
    time = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    ports = {"y_ref": Port("y_ref", (2,), "m", "reference")}
    given = Trajectory(time, {"y_ref": np.array(rows, float)}, ports, {"y_ref": ("x", "z")})
    assert end_of_reference(given) == end
    assert end_of_reference(Trajectory(time, {}, {}, {})) == 2.0


def test_a_trajectory_of_a_robot_that_is_not_in_the_models(tmp_path):
    path = solution().trajectory
    other = replace(path, meta={**path.meta, "model": "mine"})
    with pytest.raises(
        ArgumentError, match=r"the trajectory is of model 'mine'.*expected also its model"
    ):
        flexgen.view(other, tmp_path / "a.html")
    assert flexgen.view(other, tmp_path / "a.html", model="elbow").is_file()
    with pytest.raises(
        ArgumentError, match="given a trajectory with 2 arm coordinates, expected q_a with 3"
    ):
        flexgen.view(other, tmp_path / "b.html", model="planar5_nmp")
    assert not (tmp_path / "b.html").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, r"given no file"),
        ({"path": "a.htm"}, r"ends in \.html"),
        ({"path": "a.html", "video": "a.avi"}, r"ends in \.gif or \.mp4"),
        ({"path": "a.html", "model": "elbow"}, "model together with a trajectory only"),
    ],
)
def test_wrong_arguments(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=words):
        flexgen.view("elbow", **arguments)
    with pytest.raises(ArgumentError, match="move together with a robot only"):
        flexgen.view(solution().trajectory, "a.html", move="line")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_row_of_masses_has_nothing_to_show(tmp_path):
    with pytest.raises(ArgumentError, match="without extent in space"):
        flexgen.view("four_mass@high", tmp_path / "a.html")


@pytest.mark.parametrize(
    "length", [1e-3, 0.037, 0.8, 1.0, 3.99, 4.0, 7.77, 29.9, 30.0, 61.0, 4000.0]
)
def test_frames_have_the_speed_of_the_title(length):
    """The time between frames as a GIF stores it, in 10 ms, is that of the speed, also where
    frames are left out.
    """
    shown = 1000 // video.RATE  # ms
    assert shown % 10 == 0 and shown * video.RATE == 1000
    speed, times = video.frames(2.0, 2.0 + length)
    steps = np.diff(times)
    assert times[0] == 2.0 and times[-1] == 2.0 + length and 2 <= len(times) <= video.FRAMES_MAX
    assert (
        np.abs(steps[:-1] - speed * shown / 1000).max(initial=0.0) < 1e-9
        and 0.0 < steps[-1] <= speed / 15
    )
    assert (len(times) - 1) / video.RATE >= video.LENGTH or speed == video.SLOW[-1]


@pytest.mark.slow
def test_a_gif_shows_the_motion(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "RATE", 10)  # half of the frames
    path = flexgen.view(solution(), video=tmp_path / "arm.gif")
    length = solution().trajectory.time[-1] - solution().trajectory.time[0]
    frames = []
    with Image.open(path) as image:
        # the move of 1 s is shown in slow motion
        assert image.info["duration"] == 1000 / video.RATE
        assert image.n_frames / video.RATE >= video.LENGTH > 2 * length
        for k in (0, image.n_frames // 2, image.n_frames - 1):
            image.seek(k)
            frames.append(np.array(image.convert("L"), dtype=float))
    assert frames[0].shape == (video.HEIGHT * video.DPI, video.WIDTH * video.DPI)
    assert all((np.abs(a - b) > 50).sum() > 500 for a, b in itertools.pairwise(frames))


@pytest.mark.slow
@pytest.mark.skipif(FFMPEG is None, reason="no ffmpeg: install the Debian package ffmpeg")
def test_an_mp4_has_all_frames(tmp_path):
    path = flexgen.view(solution(), tmp_path / "arm.html", video=tmp_path / "arm.mp4")
    assert path.suffix == ".html"
    command = [
        "ffprobe",
        "-v",
        "error",
        "-count_frames",
        "-select_streams",
        "v:0",
        "-show_entries",
    ]
    command += ["stream=nb_read_frames,width,height", "-of", "csv=p=0", str(tmp_path / "arm.mp4")]
    width, height, frames = map(
        int, subprocess.run(command, capture_output=True, check=True).stdout.split(b",")
    )
    assert (width, height) == (720, 540) and frames >= 60
    assert sorted(file.name for file in tmp_path.iterdir()) == ["arm.html", "arm.mp4"]


def test_without_ffmpeg_the_reason_is_given_before_anything_is_computed(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ArgumentError, match=r"ffmpeg is not installed.*ends in \.gif"):
        flexgen.view("no such model", tmp_path / "a.html", video=tmp_path / "a.mp4")


def test_command_line(tmp_path, capsys):
    file = solution().trajectory.save(tmp_path / "t.npz")
    out = tmp_path / "arm.html"
    assert main(["view", str(file), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["out"] == str(out) and out.is_file()
    assert main(["view", str(file), "--robot", "elbow@payload", "--out", str(out)]) == 0
    assert main(["view", "elbow"]) == 1
    assert (
        "given no file, expected a path that ends in .html, or a video" in capsys.readouterr().err
    )
    assert main(["view", "elbow", "--robot", "elbow", "--out", str(out)]) == 1
    assert (
        "given a robot and model, expected model together with a trajectory only"
        in capsys.readouterr().err
    )
    assert main(["view", str(file), "--move", "line", "--out", str(out)]) == 1
    assert (
        "given a trajectory and move, expected move together with a robot only"
        in capsys.readouterr().err
    )
    assert main(["view", str(file), "--set", "payload.mass=1", "--out", str(out)]) == 1
    assert "--set" in capsys.readouterr().err
