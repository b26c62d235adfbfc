"""Learning of a real robot from its measured errors: how far it gets on a robot in MuJoCo, the
rule that ends it, and records that are refused.
"""

from __future__ import annotations

import csv
import shutil

import learning_plants as plants
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.equations import derive
from flexgen.planning.learning import frame_of_poses
from flexgen.planning.learning.alignment import align, procrustes
from flexgen.planning.learning.band import learning_band
from flexgen.planning.learning.history import LearningRun, best_of, judge
from flexgen.planning.learning.motor_reaction import LinearisedArm
from flexgen.planning.learning.window import learned_part

pytestmark = needs_compiler
TRACKER = (0.4, -0.2, 0.1, 0.2, -0.5, 1.0)
FEEDBACK = {
    "controller": flexgen.PPI(position_hz=5.0, speed_hz=15.0, integral_hz=0.5),
    "sample_time": 1e-3,
    "delay": 1e-3,
}


def learn(model, folder, run, move=None, **options):
    """`flexgen.next_run` with options."""
    chosen = flexgen.LearningOptions(**options)
    return flexgen.next_run(model, folder, run, move, options=chosen, progress=False)


MOTION = "q_a v_a a_a q_m v_m a_m tau_m".split()


def begin(folder, move, factors=(0.85, 1.15, 0.8, 1.2)):
    """Model and folder of a move whose torques `flexgen.solve` wrote."""
    file = folder / "arm.toml"
    file.write_text(plants.model_text(factors))
    model = flexgen.read(file)
    flexgen.solve(model, move, progress=False, verify=False).trajectory.save(
        folder / "trajectory.csv"
    )
    return model


def learn_on_plant(folder, model, move, runs, what="tool", **options):
    """Largest true error of the tool [m] in each run, and the last result."""
    path = flexgen.plan(model, move)
    errors = []
    for k in range(runs):
        trajectory = flexgen.Trajectory.load(folder / "trajectory.csv")
        done = plants.run(trajectory, seed=k, until=path.duration)
        near = (done.time >= 0) & (done.time <= path.duration + 0.3)
        away = np.linalg.norm(done.tool - path.sample(done.time).y[:, :, 0], axis=1)
        errors.append(float(away[near].max()))
        plants.write_record(folder / f"run_{k}.csv", done, what=what, frame=TRACKER, seed=k)
        found = learn(model, folder, folder / f"run_{k}.csv", **FEEDBACK, **options)
    return errors, found


def fake_record(file, model, move, error, *, rate=500.0, clock=0.0, factor=1e3, lead=0.3):
    """Write a record of the path of a move with an error [m] as a function of the instants."""
    path = flexgen.plan(model, move)
    time = np.arange(-lead, path.duration + 0.5, 1 / rate)
    table = np.column_stack([time + clock, factor * (path.sample(time).y[:, :, 0] + error(time))])
    axes = ",".join(f"{a}_mm" for a in model.output.axes)
    np.savetxt(file, table, delimiter=",", header=f"time_s,{axes}", comments="")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("move", "limit"),
    [
        ("line", 1e-4),
        pytest.param("circle", 1e-4, marks=pytest.mark.full),
        pytest.param("corner", 2e-4, marks=pytest.mark.full),
    ],
)
def test_a_robot_in_mujoco_learns_in_three_runs(tmp_path, move, limit):
    """Its user knows the frame of the tracker, not its clock, and a model 15 to 20 % off."""
    model = begin(tmp_path, move)
    errors, found = learn_on_plant(tmp_path, model, move, 4, frame=TRACKER)
    assert errors[3] <= limit < errors[0] / 2
    assert errors[2] < errors[1] < errors[0]
    assert found.clock_s == pytest.approx(3.7, abs=2e-4)
    assert [run.iteration for run in found.runs] == [0, 1, 2, 3] and found.last.unit == "m"
    with open(tmp_path / "history.csv") as stream:
        assert len(list(csv.reader(stream))) == 5


@pytest.mark.slow
def test_a_band_that_is_too_high_ends_and_does_not_diverge(tmp_path):
    """Springs 30 % off, and a low pass far above the natural frequencies."""
    model = begin(tmp_path, "corner", (0.7, 1.3, 0.7, 1.3))
    errors, found = learn_on_plant(
        tmp_path, model, "corner", 3, frame=TRACKER, clock=3.7, frequency_hz=40.0
    )
    assert found.last.state == "grew" and found.problem and "lower frequency" in found.stopped
    assert found.iteration == 1 and errors[1] == min(errors)
    best = (tmp_path / "command_1.csv").read_bytes()
    assert (tmp_path / "trajectory.csv").read_bytes() == best
    errors, found = learn_on_plant(tmp_path, model, "corner", 1, frame=TRACKER, clock=3.7)
    assert found.last.frequency_hz == 20.0 and found.iteration == 3 and not found.stopped


@pytest.mark.slow
def test_motors_alone_are_learned_and_what_they_hide_is_said(tmp_path):
    model = begin(tmp_path, "line")
    _, found = learn_on_plant(tmp_path, model, "line", 2, what="motors", clock=3.7)
    errors = [run.largest for run in found.runs]
    assert errors[1] < 0.4 * errors[0] and found.last.unit == "rad" and found.frame == ()
    assert "not seen" in found.to_text() and found.hidden_m is None


@pytest.fixture(scope="module")
def elbow(tmp_path_factory):
    """A folder of the line of the elbow, and its model."""
    folder = tmp_path_factory.mktemp("elbow")
    solution = flexgen.solve("elbow", "line", progress=False, verify=False)
    solution.trajectory.save(folder / "trajectory.csv")
    return folder, flexgen.read("elbow")


@pytest.fixture
def copy(elbow, tmp_path):
    """Such a folder of a test's own."""
    shutil.copy(elbow[0] / "trajectory.csv", tmp_path)
    return tmp_path, elbow[1]


def bump(t, size=4e-4):
    """A slow error of the tool of the elbow [m]."""
    return size * np.exp(-(((t - 0.5) / 0.15) ** 2))[:, None] * [[1.0, -0.5]]


def test_the_next_run_commands_the_error_away(copy):
    """Its tool follows the path less the error, its torques are those of that motion."""
    folder, model = copy
    fake_record(folder / "run.csv", model, "line", bump, clock=2.0)
    options = {"clock": 2.0, "frame": [0.0] * 6, "frequency_hz": 8.0}
    found = learn(model, folder, folder / "run.csv", "line", **options)
    new = flexgen.Trajectory.load(folder / "trajectory.csv")
    forward = derive(model).function("forward_kinematics")
    tool = np.array(forward.map(len(new.time))(new["q_a"].T)[0]).T[:, [0, 2]]
    wanted = new["y_ref"] - bump(new.time)
    assert np.abs(tool - wanted).max() < 0.02 * 4e-4
    assert found.last.largest == pytest.approx(4e-4 * np.hypot(1.0, 0.5), rel=1e-2)
    simulated = flexgen.simulate(model, new)
    assert np.abs(simulated.trajectory["q_a"][-1] - new["q_a"][-1]).max() < 1e-5
    assert found.iteration == new.meta["learning"] == 1
    assert (folder / "command_0.csv").exists() and (folder / "command_1.csv").exists()


def test_nothing_is_learned_from_a_perfect_run(copy):
    folder, model = copy
    fake_record(folder / "run.csv", model, "line", lambda t: 0.0 * bump(t), clock=-1.0)
    found = learn(model, folder, folder / "run.csv")
    assert np.abs(found.trajectory["correction"]).max() < 1e-6


def test_a_constant_delay_is_hidden_and_said(copy):
    """A clock that is estimated takes a delay of the tool away; the stated one shows it."""
    folder, model = copy
    path = flexgen.plan(model, "line")

    def late(t):
        return path.sample(t - 2e-3).y[:, :, 0] - path.sample(t).y[:, :, 0]

    fake_record(folder / "run.csv", model, "line", late)
    first = learn(model, folder, folder / "run.csv", frame=[0.0] * 6)
    assert "a constant delay along the path" in first.to_text()
    assert abs(first.clock_s - 2e-3) < 2e-4 and first.last.largest < 1e-4
    shutil.copy(folder / "command_0.csv", folder / "trajectory.csv")
    (folder / "history.csv").unlink()
    options = {"frame": [0.0] * 6, "clock": 0.0}
    seen = learn(model, folder, folder / "run.csv", **options)
    assert seen.last.largest > 1e-3 and seen.hidden_m == 0.0


def late_record(folder, model, late, offset, reading):
    """Write a record of a run all of which is late by a time [s], with motor angles by the clock
    of the drives, which reads ``reading`` [s] where the path begins, and a tracker that is read
    ``offset`` [s] later; return the path.
    """
    path = flexgen.plan(model, "line")
    sent = flexgen.Trajectory.load(folder / "trajectory.csv")
    time = np.arange(-0.3, path.duration + 0.5, 2e-3)
    at = np.clip(time - late, sent.time[0], sent.time[-1])
    motors = make_interp_spline(sent.time, sent["q_m"], k=5)(at)
    tool = path.sample(time - late + offset).y[:, :, 0]
    names = [f"q_m[{motor.name}] rad" for motor in model.motors]
    names += [f"{axis}_m" for axis in model.output.axes]
    table = np.column_stack([time + reading, motors, tool])
    header = ",".join(["time_s", *names])
    np.savetxt(folder / "run.csv", table, fmt="%.12g", delimiter=",", header=header, comments="")
    return path


@pytest.mark.parametrize("is_planted", [False, True])
def test_motors_tell_the_clock_of_a_tracker(copy, monkeypatch, is_planted):
    """Motors that are 3 ms late take the tool with them, since a motion that is late as a whole
    does not change; a tracker whose clock is 7 ms off shows its error.
    """
    folder, model = copy
    path = late_record(folder, model, late=3e-3, offset=7e-3, reading=1.0)
    if is_planted:
        monkeypatch.setattr(
            LinearisedArm, "with_motors", lambda self, *d: np.zeros((self.count, self.model.n_a))
        )
    options = {"frame": [0.0] * 6, "clock": 1.0, "clock_of": "drives", "frequency_hz": 6.0}
    found = learn(model, folder, folder / "run.csv", **options)
    time = np.linspace(0.0, path.duration, 1000)
    late = path.sample(time - 3e-3).y[:, :, 0] - path.sample(time).y[:, :, 0]
    error = float(np.linalg.norm(late, axis=1).max())
    is_right = abs(found.clock_s - (1.0 - 7e-3)) < 2e-5
    is_seen = found.last.largest == pytest.approx(error, rel=0.02)
    assert (is_right, is_seen) == (not is_planted, not is_planted)


def test_the_clock_of_drives_needs_motors(copy):
    folder, model = copy
    fake_record(folder / "run.csv", model, "line", bump)
    with pytest.raises(ArgumentError, match=r"clock_of: given 'drives'.*q_m"):
        learn(model, folder, folder / "run.csv", frame=[0.0] * 6, clock_of="drives")


def spoil(table, how):
    """A table of a record (n, 3), spoiled."""
    table = table.copy()
    n = len(table)
    if how == "gap":
        return np.delete(table, slice(n // 2, n // 2 + 30), axis=0)
    if how == "jump":
        table[n // 2 :, 1] += 3.0
    if how == "repeated":
        table[n // 2 : n // 2 + 8, 1:] = table[n // 2, 1:]
    if how == "units":
        table[:, 1:] *= 1e-3
    if how == "mirrored":
        table[:, 2] *= -1.0
    if how == "late":
        table = table[n // 3 :]
    if how == "other move":
        table[:, 1:] = table[:, 1:][::-1] * [[1.0, 0.2]]
    if how == "at rest":
        table[:, 1:] = table[0, 1:]
    return table


REFUSED = {
    "gap": "samples are missing",
    "jump": "jumps by about 3 mm at 0.5",
    "repeated": "samples are missing",
    "units": "m given as mm",
    "late": "start the record before the robot moves|does not cover",
    "other move": "another move",
    "at rest": "expected",
}


@pytest.mark.parametrize("how", REFUSED)
def test_spoiled_records_are_refused_and_nothing_is_written(copy, how):
    folder, model = copy
    fake_record(folder / "good.csv", model, "line", bump)
    table = spoil(np.loadtxt(folder / "good.csv", delimiter=",", skiprows=1), how)
    names = "time_s,x_mm,z_mm"
    np.savetxt(folder / "run.csv", table, delimiter=",", header=names, comments="")
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(ArgumentError, match=REFUSED[how]):
        learn(model, folder, folder / "run.csv")
    assert before == {file.name: file.read_bytes() for file in folder.iterdir()}


def test_other_arguments_are_refused(copy):
    folder, model = copy
    run = folder / "run.csv"
    fake_record(run, model, "line", bump, clock=1.0)
    for options, words in (
        ({"clock": 1.4}, "begins at about 1"),
        ({"frame": [0.0] * 5}, "six numbers"),
        ({"frame": [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]}, "check the frame"),
        ({"move": "joints"}, "of move line, expected one of move joints"),
        ({"frequency_hz": 400.0}, "at most 200"),
    ):
        with pytest.raises(ArgumentError, match=words):
            learn(model, folder, run, **options)
    with pytest.raises(ArgumentError, match="given a trajectory of model elbow"):
        learn("planar5_nmp", folder, run)
    with pytest.raises(ArgumentError, match=r"expected a folder with one file trajectory\.csv"):
        learn(model, folder / "none", run)
    learn(model, folder, run)
    with pytest.raises(ArgumentError, match="which was used"):
        learn(model, folder, run)


def test_motor_angles_in_degrees_that_are_radians_are_named(copy):
    folder, model = copy
    last = flexgen.Trajectory.load(folder / "trajectory.csv")
    table = np.column_stack([last.time, np.degrees(last["q_m"])])
    names = "time_s,q_m[m1] rad,q_m[m2] rad"
    np.savetxt(folder / "run.csv", table, delimiter=",", header=names, comments="")
    with pytest.raises(ArgumentError, match=r"motor m1.*57\.3 times.*wrong unit"):
        learn(model, folder, folder / "run.csv")


def test_the_command_line_learns(copy, capsys):
    folder, model = copy
    fake_record(folder / "run.csv", model, "line", bump)
    words = ["learn", "elbow", "--measured", str(folder / "run.csv"), "-q"]
    assert main([*words]) != 0 and "--folder" in capsys.readouterr().err
    assert main([*words, "--folder", str(folder), "--frame", "0", "0", "0", "0", "0", "0"]) == 0
    assert "iteration 1" in capsys.readouterr().out
    assert main(["learn", "elbow", "--folder", str(folder)]) != 0


def test_the_rule_ends_learning_where_the_error_grows_or_stays():
    """By hand: scatter 1, best error 10."""

    def run(iteration, rms, state="learns"):
        return LearningRun(iteration, "tool", rms, rms, 1.0, 8.0, 1.0, state, "", "")

    before = [run(0, 100.0), run(1, 10.0)]
    for rms, expected in ((6.0, "learns"), (8.0, "no longer falls"), (12.5, "no longer falls")):
        assert judge(before, 2, rms, rms, 1.0) == expected
    assert judge(before, 2, 14.0, 14.0, 1.0) == "grew" and judge([], 0, 1.0, 1.0, 0.0) == "learns"
    assert best_of([*before, run(2, 14.0), run(1, 12.0)]) == 1


def test_a_frame_is_found_again():
    """A drawn frame and clock of a curve in space; its mirror image is another thing."""
    rng = np.random.default_rng(3)
    frame = np.concatenate([rng.normal(size=3), rng.normal(size=3)])
    R = Rotation.from_rotvec(frame[3:]).as_matrix()

    def path(t):
        s = np.clip(t, 0.0, 1.0)
        s = s**3 * (10 - 15 * s + 6 * s * s)
        return np.stack([np.cos(4 * s), np.sin(4 * s), 0.3 * s], axis=1)

    time = np.arange(-0.3, 1.5, 0.004)
    measured = (path(time) - frame[:3]) @ R
    found = align("run", time + 7.25, measured, path, 1.0)
    assert found.clock_s == pytest.approx(7.25, abs=1e-5)
    assert np.abs(found.positions(measured) - path(time)).max() < 1e-4
    assert np.linalg.det(procrustes(measured * [1, 1, -1], path(time))[0]) == pytest.approx(1.0)
    with pytest.raises(ArgumentError, match="reflection"):
        align("run", time, measured * [1, 1, -1], path, 1.0)
    with pytest.raises(ArgumentError, match="the path is a line"):
        align("run", time, measured, lambda t: path(t)[:, :1] * [[1.0, 2.0, 0.5]], 1.0)


@pytest.mark.parametrize("place", [frame_of_poses.PLACE, 1e-9])
def test_static_poses_give_the_frame(tmp_path, monkeypatch, place):
    """Also where the tracker is 2 mm from where the file has it; planted: its place is kept."""
    monkeypatch.setattr(frame_of_poses, "PLACE", place)
    file = tmp_path / "arm.toml"
    file.write_text(plants.model_text())
    ball = {"name": "ball", "type": "tracker", "unit": "m", "element": "tool"}
    model, true = (
        flexgen.read(file, overrides={"sensor": [ball | {"position": at}]})
        for at in ([0.02, 0.05, 0.03], [0.0215, 0.0488, 0.0314])
    )
    rng = np.random.default_rng(3)
    q = np.array([0.0, -0.6, 1.2]) + rng.uniform(-0.9, 0.9, (40, 3))
    base = flexgen.tracker_positions(true, q)[:, 0]
    seen = (base - TRACKER[:3]) @ Rotation.from_rotvec(TRACKER[3:]).as_matrix()
    seen[5] += 0.02  # a gross error
    header = "q1_rad,q2_rad,q3_rad,ball_x_mm,ball_y_mm,ball_z_mm"
    rows = np.column_stack([q, 1e3 * (seen + 1e-5 * rng.normal(size=seen.shape))])
    np.savetxt(tmp_path / "poses.csv", rows, delimiter=",", header=header, comments="")
    found, rms, count = frame_of_poses.frame_of_poses(tmp_path / "poses.csv", model)
    is_right = np.abs(found - TRACKER).max() < 2e-5 and rms < 3e-5 and count == 39
    assert is_right == (place > 1e-3)


def test_poses_that_do_not_fit_are_refused(copy):
    folder, model = copy
    fake_record(folder / "run.csv", model, "line", bump)
    (folder / "poses.csv").write_text("q1_rad,q2_rad\n0,0\n")
    with pytest.raises(ArgumentError, match="no \\[\\[sensor\\]\\] of type"):
        learn(model, folder, folder / "run.csv", poses=str(folder / "poses.csv"))
    with pytest.raises(ArgumentError, match="poses: given with frame"):
        flexgen.LearningOptions(poses="poses.csv", frame=[0.0] * 6)
    point = {"name": "p", "type": "tracker", "unit": "m"}
    tracked = flexgen.read("elbow", overrides={"sensor": [point]})
    with pytest.raises(ArgumentError, match="expected also p_x_mm"):
        frame_of_poses.frame_of_poses(folder / "poses.csv", tracked)


def test_the_low_pass_keeps_slow_errors_and_ends_constant():
    """Of an error at rest at both ends; 60 Hz are taken away."""
    time = np.arange(0.0, 3.0, 0.002)
    slow = np.sin(np.pi * np.clip((time - 0.8) / 1.4, 0.0, 1.0)) ** 2
    fast = np.sin(2 * np.pi * 60.0 * time) * slow
    grid = np.linspace(0.0, 3.0, 1501)
    kept = learned_part(time, (1.0 + slow + fast)[:, None], grid, 8.0)[:, 0]
    assert np.abs(kept - 1.0 - np.interp(grid, time, slow)).max() < 0.02
    assert np.abs(kept[[0, 1, -2, -1]] - 1.0).max() < 1e-6


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp"])
def test_torques_of_moved_motors_are_those_of_the_full_model(name, monkeypatch):
    """Torques of the linear model in a simulation of the full one move the motors as asked; a
    planted error of the springs' side does not.
    """
    solution = flexgen.solve(name, progress=False)
    t = solution.trajectory
    step = float(t.time[1] - t.time[0])
    n = len(t.time)
    s = np.clip((t.time - t.time[0]) / (t.time[-1] - t.time[0]), 0.0, 1.0)
    shape = 1e-2 * (s * (1 - s)) ** 4 * 256
    ones = np.ones((1, t["q_m"].shape[1]))
    moved = [x[:, None] * ones for x in (shape, np.gradient(shape, step))]
    moved.append(np.gradient(moved[1], step, axis=0))

    def still(arm, x, v, a):
        return [np.zeros((len(x), len(arm.free))) for _ in range(3)]

    def away():
        arm = LinearisedArm(derive(solution.model), [t[x] for x in MOTION], step)
        channels = dict(t.channels) | {"tau_m": t["tau_m"] + arm.torque(*moved)}
        new = flexgen.Trajectory(t.time, channels, t.ports, t.labels, t.meta, t.units)
        run = flexgen.simulate(solution.model, new).trajectory
        q = np.stack([np.interp(t.time, run.time, x) for x in run["q_m"].T], axis=1)
        return np.abs(q - t["q_m"] - moved[0])[: 3 * n // 4].max() / 1e-2

    assert away() < 0.02
    monkeypatch.setattr(LinearisedArm, "free_motion", still)
    assert away() > 0.05


def test_stiffer_feedback_narrows_the_band(elbow):
    """Weak feedback lets torques act on free motors, a stiff one holds them."""
    t = flexgen.Trajectory.load(elbow[0] / "trajectory.csv")
    motion = [t[x][[0, len(t.time) // 2]] for x in MOTION]
    weak, stiff = (
        learning_band(derive("elbow"), motion, flexgen.PPI(p, s, 0.5), 1e-3, 0.0)
        for p, s in ((2.0, 8.0), (20.0, 90.0))
    )
    assert weak > stiff > 0.0
