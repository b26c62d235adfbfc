"""The page with the moving robot: its data, its safety, and its script, run with a canvas that
records.
"""

from __future__ import annotations

import functools
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.views.plots.canvas import begin
from flexgen.views.reports.motion import FRAMES, motion_data, write_motion

NODE = shutil.which("node")
PROGRAM = Path(__file__).resolve().parents[1] / "support" / "programs" / "page_in_node.js"


@functools.cache
def solved(name: str, verify: bool = False):
    equations = flexgen.derive(name)
    return equations, flexgen.solve(equations, verify=verify)


def data_of(name: str, verify: bool = False):
    equations, solution = solved(name, verify)
    return motion_data(equations, solution.trajectory, solution.simulation, solution.move.duration)


@pytest.mark.parametrize(
    "name",
    ["elbow", "planar5_nmp", "beam_arm", pytest.param("manutec_r3", marks=pytest.mark.slow)],
)
def test_the_poses_are_those_of_the_robot(name):
    equations, solution = solved(name)
    data = data_of(name)
    trajectory = solution.trajectory
    assert (
        len(data["time"]) == FRAMES
        and data["factors"][0] == 1
        and data["factor"] in data["factors"]
    )
    assert all(len(poses) == FRAMES for poses in data["poses"])
    k = FRAMES // 2
    q = trajectory.at(data["time"][k])["q_a"]
    tool = evaluate(equations.function("forward_kinematics"), q)[0].ravel()
    assert np.abs(np.array(data["poses"][0][k][-3:]) - tool).max() < 2e-3
    assert np.abs(np.array(data["tool"][k]) - tool).max() < 2e-3
    motors = [kind for _, kind in data["joints"] if kind != "free"]
    assert len(motors) <= equations.model.n_g and len(data["poses"][0][0]) % 3 == 0
    assert all(point < len(data["poses"][0][0]) // 3 for point, _ in data["joints"])
    assert len(data["beams"]) == sum(
        element.beam is not None for element in equations.model.elements
    )
    assert len(data["views"]) == (3 if name == "manutec_r3" else 1)


def test_deflections_are_exaggerated_by_the_factor():
    equations, solution = solved("planar5_nmp")
    data = data_of("planar5_nmp")
    model = equations.model
    begun = begin(solution.trajectory, solution.move.duration)
    assert data["time"] == pytest.approx(
        np.linspace(begun, solution.trajectory.time[-1], FRAMES), abs=1e-5
    )
    true, twice = (
        np.array(data["poses"][data["factors"].index(f)]).reshape(FRAMES, -1, 3)
        for f in data["factors"][:2]
    )
    moved = np.linalg.norm(twice - true, axis=2).max() / (data["factors"][1] - 1)
    # of the factor that is shown first
    largest = 0.08 * np.ptp(true.reshape(-1, 3), axis=0).max() / moved
    steps = np.outer(10.0 ** np.arange(7), [1, 2, 5]).ravel()
    assert data["factor"] == steps[steps <= largest].max() > 1
    assert data["factors"] == [
        1,
        *steps[(steps > 1) & (steps >= data["factor"] / 10) & (steps <= 2 * data["factor"])],
    ]
    k = FRAMES // 2
    at = solution.trajectory.at(data["time"][k])
    undeflected = np.zeros(model.n_a)
    undeflected[list(model.i_g)] = np.linalg.solve(model.eta, at["q_m"])
    for factor, poses in zip(data["factors"], data["poses"], strict=True):
        q = undeflected + factor * (at["q_a"] - undeflected)
        points = evaluate(equations.function("chain_points"), q)[0].reshape(3, -1).T
        assert np.abs(np.array(poses[k]).reshape(-1, 3) - points).max() < 2e-3


def test_a_simulated_motion_is_shown_where_there_is_one():
    equations, solution = solved("planar5_nmp")
    planned = solution.trajectory
    still = {name: np.tile(planned[name][0], (len(planned.time), 1)) for name in ("q_a", "q_m")}
    other = SimpleNamespace(trajectory=still)
    data = motion_data(equations, planned, other, solution.move.duration)
    assert data["simulated"] and np.ptp(np.array(data["poses"][0]), axis=0).max() == 0.0
    assert (
        not data_of("planar5_nmp")["simulated"]
        and np.ptp(data_of("planar5_nmp")["poses"][0], axis=0).max() > 0.01
    )


def test_rigid_robots_are_not_exaggerated():
    data = data_of("elbow@rigid")
    assert data["factors"] == [1] or data["factor"] == 1


@pytest.mark.slow
def test_robots_without_extent_have_no_page(tmp_path):
    equations, solution = solved("four_mass@high")
    assert (
        write_motion(equations, solution.trajectory, None, tmp_path, solution.move.duration)
        is None
    )
    assert list(tmp_path.iterdir()) == []


def test_the_page_needs_nothing_else_and_runs_no_text_of_a_model(tmp_path):
    equations, solution = solved("elbow")
    evil = "</script><script>alert(1)</script>@DATA@"
    trajectory = replace(solution.trajectory, meta={**solution.trajectory.meta, "move": evil})
    path = write_motion(equations, trajectory, None, tmp_path, 1.0)
    text = path.read_text(encoding="utf-8")
    assert "alert(1)</script>" not in text and "&lt;/script&gt;" in text
    assert text.count("<script") == 2 and "default-src 'none'" in text
    assert not re.search(r"https?://|\bsrc=|@import|@TITLE@|@FOOT@|NaN", text)
    json.loads(text.split('id="data">')[1].split("</script>")[0])
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "motion.html").write_text("mine")
    with pytest.raises(ArgumentError, match=r"where motion\.html is of another program"):
        write_motion(equations, trajectory, None, tmp_path / "b", 1.0)
    assert (
        write_motion(equations, trajectory, None, tmp_path, 1.0).read_text(encoding="utf-8")
        == text
    )


@pytest.mark.slow
def test_reports_have_the_page_and_a_link_to_it(tmp_path):
    _, solution = solved("elbow")
    page = solution.report(tmp_path).read_text(encoding="utf-8")
    assert '<a href="motion.html">' in page and (tmp_path / "motion.html").is_file()


@pytest.mark.skipif(NODE is None, reason="no node: install the Debian package nodejs")
@pytest.mark.parametrize("name", ["planar5_nmp", "manutec_r3"])
def test_the_script_draws_plays_and_stops(tmp_path, name):
    equations, solution = solved(name)
    path = write_motion(equations, solution.trajectory, None, tmp_path, solution.move.duration)
    data = data_of(name)
    late = 0.9 * data["time"][-1]

    def run(actions):
        command = [NODE, str(PROGRAM), str(path), json.dumps(actions)]
        return json.loads(
            subprocess.run(command, capture_output=True, text=True, check=True).stdout
        )

    played = run([["frame", None, 0, None], ["frame", None, 1000, None]])
    assert played["texts"]["play"] == "" and played["value"] > data["time"][0]
    stopped = run(
        [["play", None, None, "click"], ["frame", None, 0, None], ["frame", None, 1000, None]]
    )
    assert stopped["texts"]["play"] == "Play" and stopped["value"] == data["time"][0]
    found = run([["slider", "value", late, "input"], ["factor", "value", 0, "input"]])
    assert found["texts"]["clock"] == f"{late:.3f} s" and found["texts"]["play"] == "Play"
    texts = [
        next(call[1] for call in drawing if call[0] == "fillText") for drawing in found["drawings"]
    ]
    if data["factor"] > 1:
        assert texts[0] == texts[1] == f"deflections \u00d7 {data['factor']}"
    assert texts[2] == "deflections as they are"
    # the tool is drawn where the robot ends, inside of the canvas
    x, y = [call for call in found["drawings"][2] if call[0] == "arc"][-1][1:3]
    last = [call for call in found["drawings"][2] if call[0] == "lineTo"]
    assert 0 < x < 800 and 0 < y < 500 and [x, y] in [call[1:3] for call in last]
    if len(data["factors"]) > 2:  # between two factors of the data
        found = run([["factor", "value", 1.5, "input"]])
        low, high = data["factors"][1:3]
        assert found["texts"]["size"] == f"\u00d7 {(low + high) / 2:g}"
    numbers = [
        value
        for drawing in found["drawings"]
        for call in drawing
        for value in call
        if value is None
    ]
    assert numbers == []  # JSON writes NaN as null
