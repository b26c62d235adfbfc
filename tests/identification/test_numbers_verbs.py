"""Verbs that take long, with the function behind them replaced; recordings and results that they
read and print.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from verb_arguments import arguments

import flexgen
from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.cli.verbs import calibration, control, identify, robot
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.laws import chain, motor_laws
from flexgen.feedback.laws.passivity import Passivity
from flexgen.feedback.loop import robustness
from flexgen.identification.experiments import excitation, experiment
from flexgen.identification.motions import motion_fit
from flexgen.identification.poses.poses import StaticPoses
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.planning.fastest import minimum_time
from flexgen.planning.optimal.guesses import from_solution
from flexgen.studies.scenarios import tune as tuning

BENCH = Path(__file__).resolve().parents[2] / "examples" / "motor_bench" / "bench.toml"


def clock(*instants: float) -> SimpleNamespace:
    """The module `time` whose clock shows these numbers in turn."""
    rest = iter(instants)
    return SimpleNamespace(perf_counter=lambda: next(rest))


class Found:
    """A calibration that was made up."""

    problem = "not good"
    warnings = ("beware",)
    ended = ""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def to_dict(self) -> dict[str, Any]:
        return {"error_m": 1e-4}

    def to_text(self) -> str:
        return "calibrated"

    def propose_poses(self, count: int) -> np.ndarray:
        return np.arange(2.0 * count).reshape(count, 2) / 8

    def write(self, path: str, world: str) -> Path:
        self.asked += [path, world]
        return Path(path)

    def report(self, path: str) -> Path:
        return Path(path)


def test_the_verb_calibrate(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Found()
    given = {}
    monkeypatch.setattr(
        StaticPoses, "read", lambda path, model, columns: (path, model.name, columns)
    )

    def calibrate(model: Any, poses: Any, **more: Any) -> Found:
        given.update(model=model.name, poses=poses, **more)
        return found

    monkeypatch.setattr(flexgen, "calibrate", calibrate)
    args = arguments("calibrate", model="elbow", poses="poses.csv", free=["zeros"])
    answer = calibration.calibrate(args, print)
    assert (answer.text, answer.data, answer.problem) == (
        "calibrated",
        {"error_m": 1e-4},
        "not good",
    )
    assert answer.warnings == ["beware"]
    assert (
        given["poses"] == ("poses.csv", "elbow", None)
        and given["free"] == ["zeros"]
        and given["model"] == "elbow"
    )
    assert given["priors"] == flexgen.Priors()
    more = {
        "add_poses": 2,
        "out": "new.toml",
        "report": "page.html",
        "prior": [("zero", 1), ("mass", 0.5)],
    }
    answer = calibration.calibrate(arguments("calibrate", model="elbow", poses="p", **more), print)
    assert given["priors"].zero == 1.0 and given["priors"].mass == 0.5
    assert answer.data["proposed_poses"] == [{"q1": 0.0, "q2": 0.125}, {"q1": 0.25, "q2": 0.375}]
    assert answer.data["model_file"] == "new.toml" and answer.data["report"] == "page.html"
    lines = answer.text.splitlines()
    assert lines[:3] == [
        "calibrated",
        "",
        "poses that tell most, rad or m; check them for collisions:",
    ]
    assert "0.125" in answer.text and lines[-2:] == ["wrote new.toml", "wrote page.html"]
    assert found.asked == ["new.toml", "robot"]
    calibration.calibrate(
        arguments("calibrate", model="elbow", poses="p", out="b.toml", world="measurement"), print
    )
    assert found.asked[2:] == ["b.toml", "measurement"]
    for name, value in (("none", 1.0), ("zero", "x")):
        with pytest.raises(ArgumentError) as caught:
            calibration.calibrate(
                arguments("calibrate", model="elbow", poses="p", prior=[(name, value)]), print
            )
        start = (
            f"--prior: given {name}={value}, expected a number for one of zero, position, "
            "rotation, compliance"
        )
        assert str(caught.value).startswith(start)
    text = r"^--out: given manutec_r3@planar, expected a \.toml model file without @variant$"
    monkeypatch.setattr(
        calibration, "read_model", lambda args: SimpleNamespace(variant="planar", file="x.toml")
    )
    with pytest.raises(ArgumentError, match=text):
        calibration.calibrate(
            arguments("calibrate", model="manutec_r3@planar", poses="p", out="c.toml"), print
        )


def test_the_verbs_tune_and_fastest(monkeypatch: pytest.MonkeyPatch) -> None:
    class Tuned:
        ended = ""

        score = SimpleNamespace(accepted=True)

        def __str__(self) -> str:
            return "tuned"

        def save(self, path: str) -> str:
            return path

        def to_dict(self) -> dict[str, Any]:
            return {"score": 2.0}

    lines: list[str] = []
    monkeypatch.setattr(tuning, "tune", lambda scenario, **given: Tuned())
    monkeypatch.setattr(control, "time", clock(1000.0, 1001.5, 2000.0, 2000.25))
    args = arguments("tune", scenario="four_mass", starts=3, evaluations=40, out="c.toml")
    answer = control.tune(args, lines.append)
    assert lines[0] == "tune: 120 evaluations, about two seconds each"
    assert answer.text == "tuned\n  1.5 s\n\nwrote c.toml" and answer.problem == ""
    assert answer.data == {"score": 2.0, "controller": "c.toml"}
    Tuned.score = SimpleNamespace(accepted=False)
    assert control.tune(args, lines.append).problem == "the tuned controller is refused"
    asked: dict[str, Any] = {}

    class Fast:
        solution = SimpleNamespace(status=flexgen.Status.SOLVED)

        def __str__(self) -> str:
            return "fast"

        def to_dict(self) -> dict[str, Any]:
            return {"duration_s": 1.0}

    def fastest(model: Any, **given: Any) -> Fast:
        asked.update(given)
        return Fast()

    monkeypatch.setattr(minimum_time, "fastest", fastest)
    monkeypatch.setattr(control, "written", lambda args, solution: {"csv": Path("a.csv")})
    given = {"model": "elbow", "torque": [3.0, 4.0], "speed": [5.0], "reserve": 0.1}
    answer = control.fastest(arguments("fastest", **given), print)
    assert (answer.text, answer.problem) == ("fast\n\nwrote a.csv", "")
    assert answer.data == {"duration_s": 1.0, "csv": "a.csv"}
    limits = asked["limits"]
    assert (limits.torque, limits.reserve) == ((3.0, 4.0), 0.1) and limits.speed in (
        5.0,
        (5.0, 5.0),
    )
    none = {"model": "elbow", "torque": None, "speed": None, "reserve": None}
    control.fastest(arguments("fastest", **none), print)
    assert asked["limits"] == flexgen.Limits()
    for status, problem in (
        ("LIMITS_EXCEEDED", ""),
        ("TOLERANCE_NOT_MET", "the fastest move is tolerance not met"),
    ):
        Fast.solution = SimpleNamespace(status=flexgen.Status[status])
        assert control.fastest(arguments("fastest", **none), print).problem == problem


def test_the_verbs_derive_and_measure_say_how_long_they_took(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = SimpleNamespace(name="arm", variant="stiff", title="arm@stiff")
    equations = SimpleNamespace(
        model=made, sizes=lambda log: {"mass_matrix": 12, "forward_dynamics": 345}
    )
    monkeypatch.setattr(robot, "time", clock(100.0, 102.5))
    monkeypatch.setattr(robot, "derive_model", lambda args: equations)
    answer = robot.derive(arguments("derive", latex=False, text=False, json=True), print)
    sizes = {"mass_matrix": 12, "forward_dynamics": 345}
    assert answer.data == {"model": "arm", "variant": "stiff", "seconds": 2.5, "functions": sizes}
    assert [row.split() for row in answer.text.splitlines()[:1]] == [["function", "instructions"]]
    assert [row.split() for row in answer.text.splitlines()[-2:]] == [
        ["mass_matrix", "12"],
        ["forward_dynamics", "345"],
    ]

    planned = SimpleNamespace(duration_s=12.25, poses=[1, 2])

    class Run:
        plan = planned
        ended = ""
        speed_sd = np.array([0.25, 0.5])
        saturated = np.array([0, 3])

        def save(self, path: str) -> str:
            return path

        def to_text(self) -> str:
            return "measured"

    lines: list[str] = []
    monkeypatch.setattr(excitation.Plan, "load", lambda path: planned)
    monkeypatch.setattr(identify, "read_model", lambda args: made)
    monkeypatch.setattr(identify, "time", clock(7.0, 7.75, 8.0, 12.0))
    monkeypatch.setattr(experiment, "measure", lambda plan, robot, **given: Run())
    answer = identify.measure(
        arguments("measure", plan="p", raw=None, out="run.npz"), lines.append
    )
    assert lines == ["simulating 12 s of arm"]
    assert answer.data == {
        **{
            "model": "arm",
            "status": "done",
            "experiment": "run.npz",
            "duration_s": 12.25,
            "wall_s": 0.75,
        },
        **{"speed_rms_rad_s": [0.25, 0.5], "samples_at_torque_limit": [0, 3]},
    }
    assert answer.text == "arm: 12.25 s of robot in 0.75 s\n\nmeasured\n\nwrote run.npz"
    (warning,) = answer.warnings
    assert warning.startswith("torques were at their limits: 'flexgen frf' refuses these data")
    monkeypatch.setattr(Run, "saturated", np.array([0, 0]))
    answer = identify.measure(
        arguments("measure", plan="p", raw=None, out="run.npz"), lines.append
    )
    assert answer.data["wall_s"] == 4.0 and not answer.warnings


# --- recordings ----------------------------------------------------------------------------------
HEAD = """\
model = "bench.toml"
period_s = 0.2
hold = "zoh"

[time]
name = "t"
unit = "s"

[[torque]]
motor = "m1"
name = "u"
unit = "N m"
side = "motor"

[[angle]]
motor = "m1"
name = "q"
unit = "rad"
side = "motor"
"""


def described(folder: Path, *runs: tuple[float, int]) -> Path:
    """A description of recordings: the pose of each, and its samples of a millisecond."""
    (folder / "bench.toml").write_text(BENCH.read_text())
    text = HEAD
    for k, (pose, count) in enumerate(runs):
        t = 1e-3 * np.arange(count)
        np.savez(
            folder / f"{k}.npz",
            t=t,
            u=np.sin(2 * np.pi * 10 * t),
            q=1e-2 * np.cos(2 * np.pi * 10 * t),
        )
        text += f'\n[[recording]]\nfile = "{k}.npz"\npose_rad = [{pose}]\n'
    (folder / "runs.toml").write_text(text)
    return folder / "runs.toml"


def test_recordings_have_as_many_periods_at_every_pose(tmp_path: Path) -> None:
    found = read_experiment(described(tmp_path, (0.0, 400), (0.5, 450)))
    assert found.plan.periods == 2 and len(found.plan.poses) == 2
    words = "the same number of recordings, and of whole periods in each, at every pose"
    for runs in (((0.0, 400), (0.0, 400), (0.5, 400)), ((0.0, 400), (0.5, 600))):
        with pytest.raises(ModelError, match=words):
            read_experiment(described(tmp_path, *runs))
    with pytest.raises(
        ArgumentError,
        match=r"0\.npz: given 399 samples, expected at least two periods of 200 samples af",
    ):
        read_experiment(described(tmp_path, (0.0, 399)))


def test_a_recording_of_periods_is_their_mean_twice() -> None:
    """After the transients, which are left out; a rest of a period at the end counts for
    nothing.
    """
    values = {"period_s": 0.4, "transients": 1}

    class Root(dict[str, Any]):
        def number(self, name: str, above: float) -> float:
            return float(self[name])

        def whole(self, name: str, low: int, high: int) -> int:
            return int(self[name])

    x = np.arange(23.0)[:, None]
    recording: Any = SimpleNamespace(
        t=0.1 * x[:, 0], sample_s=0.1, tau_m=x, q_m=2 * x, signals=3 * x, file="run.csv"
    )
    data: Any = SimpleNamespace(root=Root(values))
    found = motion_fit.MotionRecord(data, recording)
    one = np.array([x[4 + k : 20 + k : 4].mean() for k in range(4)])
    assert_allclose(found.tau_m[:, 0], [*one, *one])
    assert_allclose(found.q_m, 2 * found.tau_m)
    assert_allclose(found.signals, 3 * found.tau_m)
    assert_allclose(found.t, 0.1 * np.arange(8))
    assert found.own == 4
    whole: Any = SimpleNamespace(root=Root())
    plain = motion_fit.MotionRecord(whole, recording)
    assert plain.own == 23 and plain.tau_m is x
    data.root = Root({"period_s": 0.4})
    assert motion_fit.MotionRecord(data, recording).tau_m[0, 0] == pytest.approx(x[0:20:4].mean())
    for wrong in ({"period_s": 3.0}, {"period_s": 0.1}, {"period_s": 0.4, "transients": 5}):
        data.root = Root(wrong)
        with pytest.raises(
            ArgumentError, match=r"^run\.csv: given 23 samples, expected a whole period$"
        ):
            motion_fit.MotionRecord(data, recording)


def test_torques_of_segments_are_those_of_the_recording() -> None:
    """Held from sample to sample, or along a curve; later by the delay, and none after the end of
    the recording.
    """
    made: Any = object.__new__(motion_fit.Shooting)
    held = np.arange(10.0)[:, None] * [1.0, -2.0]
    curve = lambda t: np.stack([np.asarray(t) ** 2, 1.0 + np.asarray(t)], axis=-1)  # noqa: E731
    vars(made).update(
        sample_s=0.5,
        steps=2,
        samples=3,
        starts=[(0, 2), (1, 1)],
        model=SimpleNamespace(n_m=2),
        _curves=[held, curve],
        _times=[0.0, 4.0],
        measured=[np.zeros(10), np.zeros(6)],
    )
    found = made._torque(0.6)
    assert found.shape == (2, 6, 3, 2)
    nodes = 0.25 * (np.arange(6)[:, None] + [0.0, 0.5, 1.0])
    middle = np.broadcast_to(nodes[:, 1:2] + 1.0 - 0.6, nodes.shape)
    assert_allclose(found[0, :, :, 0], np.floor(middle / 0.5))
    assert_allclose(found[0, :, :, 1], -2 * np.floor(middle / 0.5))
    t = np.clip(4.0 + 0.5 + nodes - 0.6, 4.0, 6.5)
    assert_allclose(found[1], np.stack([t**2, 1.0 + t], axis=-1))
    early = made._torque(-20.0)
    assert_allclose(early[0], np.broadcast_to(held[-1], (6, 3, 2)))
    assert_allclose(early[1, ..., 1], 7.5)


def test_differences_of_a_motion_fit_are_of_the_size_of_its_motion() -> None:
    """Angles by the scatter of the steps of the record, speeds by those of a sample, torques by
    their scatter.
    """
    made: Any = object.__new__(motion_fit.Shooting)
    held = np.r_[5.0, np.zeros(5)][:, None] * [1.0, 0.0]
    vars(made).update(
        sample_s=0.5, steps=1, samples=3, starts=[(0, 0)], y=np.array([[[0.0], [1.0], [4.0]]])
    )
    vars(made).update(
        model=SimpleNamespace(n_m=2, dof=2), _curves=[held], _times=[0.0], measured=[np.zeros(6)]
    )
    assert_allclose(made._scales(), [1.0, 1.0, 2.0, 2.0, np.std([5.0, 0.0, 0.0]), 1e-9])
    made.y = np.ones((1, 3, 1))
    assert_allclose(made._scales()[:4], [1e-9, 1e-9, 2e-9, 2e-9])


# --- laws ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("predicted", [False, True])
def test_a_chain_is_stable_up_to_its_largest_frequency(predicted: bool) -> None:
    """Two integrators with a hold and a delay of 1.4 samples, step by step; also with a state that
    is predicted.
    """
    timing = chain.Timing(1e-3, 1.4e-3, predicted, False)

    def moved(x: np.ndarray, u: float, h: float) -> np.ndarray:
        return np.array([x[0] + h * x[1] + h * h / 2 * u, x[1] + h * u])

    def growth(frequency: float) -> float:
        g = chain.chain_gains(frequency, 2, "continuous", 1e-3)
        x = np.array([1.0, 0.0])
        last = 0.0
        before = 0.0
        sizes = []
        for _ in range(1200):
            ahead = moved(moved(x, before, 0.4e-3), last, 1e-3) if predicted else x
            new = float(-g @ ahead)
            new = float(-g @ moved(ahead, new, 0.5e-3)) if predicted else new
            x = moved(moved(x, before, 0.4e-3), last, 0.6e-3)
            before = last
            last = new
            sizes.append(np.abs(x * [1.0, 1e-3]).max())
        return float(np.max(sizes[-300:]) / np.max(sizes[300:600]))

    for form in ("continuous", "discrete"):
        largest = chain.largest_frequency(2, form, timing)
        assert 1.0 < largest < 550.0  # the search ends above half of the sampling frequency
        if largest > 500.0:
            continue
        below, above = (
            chain.largest_eigenvalue(chain.chain_gains(x * largest, 2, form, 1e-3), timing)
            for x in (0.99, 1.01)
        )
        assert below < 1.0 < above
    largest = chain.largest_frequency(2, "continuous", timing)
    assert growth(0.98 * largest) < 1.0 < growth(1.02 * largest)
    cubic = chain.chain_gains(2.0, 3, "continuous", 1e-3)
    assert_allclose(cubic, [(4 * np.pi) ** 3, 3 * (4 * np.pi) ** 2, 12 * np.pi], rtol=1e-12)


@pytest.mark.parametrize("coupled", [False, True])
def test_gains_of_tomei_hold_the_arm_against_gravity(coupled: bool) -> None:
    """The least eigenvalue of springs and gains is above the largest change of gravity, by
    differences.

    ``coupled``: the first motor turns both joints.
    """
    drives = {"motor.m1.drives": ["q1", "q2"], "motor.m1.ratio": [250.0, -90.0]}
    equations = derive(flexgen.read("elbow", overrides=drives if coupled else {}))
    model = equations.model
    shares = np.array([1.0, 3.0])
    assert np.count_nonzero(model.eta) == 2 + coupled
    poses = np.linspace([0.2, -0.8], [1.2, 0.9], 20)
    motion: Any = SimpleNamespace(
        model=model,
        equations=equations,
        reference=SimpleNamespace(time=np.arange(20.0), motion={"q_a": poses}),
    )
    gravity = equations.function("gravity")
    h = 1e-6
    alpha = 0.0
    for q in poses:
        change = [
            (np.array(gravity(q + x)) - np.array(gravity(q - x))).ravel() / (2 * h)
            for x in h * np.eye(2)
        ]
        alpha = max(alpha, float(np.linalg.norm(np.array(change), 2)))
    K = np.diag([model.coordinates[i].dof.gear.spring.stiffness for i in model.i_g])

    def least(k_p: float) -> float:
        outer = model.eta.T @ (k_p * np.diag(shares)) @ model.eta
        return float(np.linalg.eigvalsh(np.block([[K, -K], [-K, K + outer]])).min())

    low = 1e-6
    high = 1e6
    for _ in range(100):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if least(middle) <= alpha else (low, middle)
    motor_laws._check_gravity(motion, 1.01 * high * shares)
    with pytest.raises(ArgumentError) as caught:
        motor_laws._check_gravity(motion, 0.99 * low * shares)
    words = (
        f"springs and gains is {least(0.99 * low):.4g} and gravity changes by {alpha:.4g} N "
        "m/rad; expected the first"
    )
    assert words in str(caught.value)


def test_passivity_in_words() -> None:
    margins = np.array([[2.0, 1.0, 3.0], [4.0, -0.5, -0.25]])
    found = Passivity("arm", "ppi", ("begin", "end"), np.array([1.0, 10.0, 100.0]), margins)
    assert (
        not found.passive
        and found.margin == -0.5
        and found.pose == "end"
        and found.fails_hz == 10.0
    )
    assert str(found).splitlines() == [
        "arm, controller ppi: not passive",
        "  begin: damping at the tool at least 1 N s/m, at 10 Hz",
        "  end: damping at the tool at least -0.5 N s/m, at 10 Hz",
    ]
    data = found.to_dict()
    assert (data["passive"], data["margin"], data["fails_hz"]) == (False, -0.5, 10.0)
    calm = Passivity("arm", "ppi", ("begin",), found.hz, np.array([[0.0, 1.0, 2.0]]))
    assert (
        calm.passive
        and calm.fails_hz is None
        and str(calm).startswith("arm, controller ppi: passive\n")
    )
    assert Passivity("a", "b", ("x",), found.hz, np.array([[1.0, 1.0, -1e-9]])).fails_hz == 100.0


def test_robustness_runs_every_robot_control_and_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[Any] = []

    class Run:
        def __init__(
            self, robot: Any, path: Any, trajectory: Any, until: float, gains: Any
        ) -> None:
            ran.append((robot, trajectory, until, gains))

        def figures(self) -> dict[str, float]:
            return {"error_max_m": float(len(ran))}

    for name, value in {
        "_Run": Run,
        "Path": lambda *given: given,
        "_gains": lambda *given: "gains",
    }.items():
        monkeypatch.setattr(robustness, name, value)
    monkeypatch.setattr(robustness, "perturb", lambda model, plant: f"{model} {plant.name}")
    monkeypatch.setattr(robustness, "Equations", lambda model: model)
    function = next(
        x
        for x in vars(robustness).values()
        if getattr(x, "__doc__", None) and "for each plant" in x.__doc__
    )
    move = SimpleNamespace(name="line")
    solutions = {
        name: SimpleNamespace(move=move, trajectory=SimpleNamespace(time=np.array([0.0, end])))
        for name, end in (("rigid", 1.0), ("exact", 2.0))
    }
    equations: Any = SimpleNamespace(model="arm")
    plants = [
        robustness.Plant("nominal", 1.0, 1.0),
        robustness.Plant("soft", 0.8, 1.0),
        robustness.Plant("b", 1.0, 2.0),
    ]
    told: list[str] = []
    rows = function(
        equations,
        solutions,
        plants=plants,
        controls=("feedback", "feedforward"),
        progress=told.append,
    )
    assert len(rows) == len(ran) == 12 and told[5] == "robustness: soft, feedback, exact"
    assert [x[0] for x in ran[:1]] == [equations] and [x[0] for x in ran[4::4]] == [
        "arm soft",
        "arm b",
    ]
    assert {x[2] for x in ran} == {2.0} and [x[3] for x in ran[:4]] == [
        "gains",
        "gains",
        None,
        None,
    ]
    expected = {
        "plant": "soft",
        "stiffness": 0.8,
        "mass": 1.0,
        "control": "feedback",
        "method": "exact",
    }
    assert rows[5] == expected | {"error_max_m": 6.0}
    with pytest.raises(ArgumentError, match=r"^controls: given 'none', expected "):
        function(equations, solutions, plants=plants, controls=("none",))
    other = {"a": solutions["rigid"], "b": SimpleNamespace(move=SimpleNamespace(name="arc"))}
    with pytest.raises(
        ArgumentError, match=r"^solutions: given moves arc, line, expected solutions of one move$"
    ):
        function(equations, other, plants=plants)
    with pytest.raises(
        ArgumentError, match=r"^solutions: given moves none, expected solutions of one move$"
    ):
        function(equations, {}, plants=plants)


def test_a_guess_is_the_motion_of_a_solution() -> None:
    """From the beginning of its path to the end of it; of a trajectory alone all of it."""
    equations = derive("elbow")
    solution = flexgen.solve("elbow", progress=False)
    trajectory = solution.trajectory
    guess = from_solution(equations, solution)
    assert guess.duration == pytest.approx(solution.move.duration)
    whole = from_solution(equations, trajectory)
    assert whole.duration == pytest.approx(trajectory.time[-1] - trajectory.time[0])
    t = np.array([0.3, 0.9])
    y, dy, ddy, tau = guess.at(t)
    found = trajectory.at(t)
    assert_allclose(y, np.hstack([found["q_a"], found["q_m"]]))
    assert_allclose(dy, np.hstack([found["v_a"], found["v_m"]]))
    assert_allclose(ddy, np.hstack([found["a_a"], found["a_m"]]))
    assert_allclose(tau, found["tau_m"])
    assert_allclose(
        whole.at(t)[0], np.hstack([(x := trajectory.at(t + trajectory.time[0]))["q_a"], x["q_m"]])
    )
    with pytest.raises(
        SolverError,
        match=r"^guess: given a trajectory of elbow, expected one of planar5_nmp with the ch",
    ):
        from_solution(derive("planar5_nmp"), trajectory)
