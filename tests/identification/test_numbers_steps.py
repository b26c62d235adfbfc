"""Small steps of larger answers by other routes: horizons, splines, bounds of plans, changes of
models, frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.fourier import FourierSum
from flexgen.codegen.emission.spec import StreamDefaults
from flexgen.dynamics.mechanics import motor_harmonics
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.exports.fmu.feedforward import _at_samples, _with
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.gears.result import GearFit, Number
from flexgen.identification.poses import frames
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.inversion.judge import settling
from flexgen.inversion.methods.collocation import _smooth_by_spline
from flexgen.paths.inverse_kinematics.search import kinematics
from flexgen.paths.timing.time_laws import Clock
from flexgen.planning.learning import learn
from flexgen.planning.optimal import model_limits, result, start


# --- options and laws ----------------------------------------------------------------------------
def test_horizons_of_a_block_are_whole_periods() -> None:
    options = StreamDefaults(2.0, 0.2, 0.02, 10, 4, 1e-6, 1e-3)
    found = _with(options, 0.3)
    assert (found.intervals, found.look_ahead, found.period) == (15, pytest.approx(0.3), 0.02)
    for wrong in (0.31, 0.0, -0.02, 1e6):
        with pytest.raises(
            ArgumentError,
            match=rf"^look_ahead: given {wrong} s, expected 1 to \d+ times the period of",
        ):
            _with(options, wrong)
    found = _at_samples(options, 0.004)
    assert (found.samples_per_interval, found.intervals) == (5, 10)
    assert (found.period, found.look_ahead) == (pytest.approx(0.02), pytest.approx(0.2))
    found = _at_samples(options, 0.006)  # three of them in a period that is shorter
    assert (found.samples_per_interval, found.intervals) == (
        3,
        12,
    ) and found.look_ahead == pytest.approx(12 * 0.018)
    found = _at_samples(options, 0.05)
    assert (found.samples_per_interval, found.intervals, found.period) == (1, 4, 0.05)


def test_a_clock_has_a_distance_of_its_time() -> None:
    clock = Clock(2.0, 3)
    found = clock(np.array([-1.0, 0.0, 0.5, 2.0, 3.0]), 4)
    assert found.shape == (5, 5) and clock(np.zeros(1)).shape == (1, 6)
    assert_allclose(found[:, 0], [0.0, 0.0, 0.5, 2.0, 2.0])
    assert_allclose(found[:, 1], [0.0, 0.0, 1.0, 0.0, 0.0])
    assert not found[:, 2:].any() and clock.breaks.tolist() == [0.0, 2.0]


def test_decay_is_that_of_the_slowest_stable_zero() -> None:
    zeros = np.array([-2.0 + 3j, -2.0 - 3j, -0.5, 4.0, -9.0])
    problem: Any = SimpleNamespace(zeros=[(0.0, np.array([-0.1])), (1.0, zeros)])
    assert settling._slowest_decay(problem) == pytest.approx(2.0)
    problem.zeros = [(1.0, np.array([4.0]))]
    assert settling._slowest_decay(problem) == np.inf
    problem.zeros = [(1.0, np.array([1j, -1j, -3.0]))]  # without damping
    assert settling._slowest_decay(problem) == np.inf


def test_a_motion_through_a_spline_has_its_derivatives() -> None:
    """A motion that begins at rest, through two non-actuated coordinates."""
    nodes = np.linspace(0.0, 2.0, 101)
    rate = np.array([1.0, 2.0])
    q_e = (nodes[:, None] ** 8 / 256) * rate
    t = np.linspace(0.1, 1.9, 30)
    kept = {}

    class Kept:
        i_e = (1, 2)

        def targets(self, sample: Any) -> str:
            return f"targets of {sample}"

        def close(self, q: np.ndarray, targets: str) -> np.ndarray:
            assert targets == "targets of sample"
            return q + 1.0

        def motion_through(self, sample: Any, q: np.ndarray, derivatives: list[np.ndarray]) -> str:
            kept.update(q=q, derivatives=derivatives)
            return sample

    before = np.zeros((30, 3))
    reduction: Any = Kept()
    sample: Any = "sample"
    assert (
        _smooth_by_spline(reduction, sample, t, before, nodes, q_e) == "sample"
        and not before.any()
    )
    assert_allclose(kept["q"][:, 1:] - 1.0, t[:, None] ** 8 / 256 * rate, atol=1e-9)
    assert_allclose(kept["q"][:, 0], 1.0)
    factor = 1.0
    assert len(kept["derivatives"]) == 4
    for k, found in enumerate(kept["derivatives"], 1):
        factor *= 9 - k
        assert_allclose(found, factor * t[:, None] ** (8 - k) / 256 * rate, atol=1e-5 * 10**k)


def test_a_wrong_pose_of_the_tool_is_refused() -> None:
    p = np.array([0.5, 0.6, 1.2])
    R = np.eye(3)
    for wrong in (
        np.diag([1.0, 1.0, -1.0]),
        np.diag([1.0, 1.0, 1.1]),
        R + 2e-6 * np.eye(3, k=1),
        np.zeros((3, 3)),
    ):
        with pytest.raises(
            ArgumentError,
            match=r"^rotation: given a matrix that is not a rotation, expected orthogonal",
        ):
            kinematics("manutec_r3", p, wrong)
    for position, rotation in ((p[:2], R), (p, R[:2]), (p[:, None], R)):
        shapes = (
            f"pose: given shapes {position.shape}, {rotation.shape}, expected (3,) and (3, 3), "
            "finite"
        )
        with pytest.raises(ArgumentError) as caught:
            kinematics("manutec_r3", position, rotation)
        assert str(caught.value) == shapes
    with pytest.raises(
        ArgumentError, match=r"^fixed: given joint 'q9', expected some of q1, q2, q3, q4, q5, q6$"
    ):
        kinematics("manutec_r3", p, R, fixed={"q9": 0.0})


def test_a_smoothed_run_has_the_errors_of_the_estimated_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Inputs of the smoother are measurements minus the reference and the torques as they acted; a
    lost robot stays.
    """
    given: dict[str, Any] = {}

    class Smoother:
        def deviation(self, dy: np.ndarray, du: np.ndarray) -> np.ndarray:
            given.update(dy=dy, du=du)
            return np.full((6, 2), 0.5)

    def output_errors(
        equations: Any, reference: Any, q_a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        return q_a - 1.0, q_a[:, 0]

    monkeypatch.setattr(learn, "output_errors", output_errors)
    made: Any = object.__new__(learn._Smoothed)
    made._case = SimpleNamespace(equations=None)
    made._channels = SimpleNamespace(index=[2, 0])
    made._name = "a"
    made._smoother = Smoother()

    @dataclass(frozen=True)
    class Robot:
        measured: np.ndarray
        sensors: np.ndarray
        tau_m: np.ndarray
        failure: str = ""
        q_a: Any = None
        error: Any = None
        turn: Any = None

    @dataclass(frozen=True)
    class One:
        runs: tuple[Any, ...]
        reference: Any
        hardware: Any
        delay_samples: int = 1

        def __getitem__(self, name: str) -> Any:
            return self.runs[1]

    t = np.arange(6.0)[:, None]
    motion = {"q_m": np.hstack([t, t]), "q_a": np.hstack([2 * t, 3 * t])}
    reference = SimpleNamespace(motion=motion, y_s=t, held=np.hstack([t, t]))
    robot = Robot(
        motion["q_m"] + [0.1, 0.2], t + 0.3, np.hstack([t, t]) + np.arange(12.0).reshape(6, 2)
    )
    other = Robot(t, t, t)
    run: Any = One((other, robot), reference, SimpleNamespace(delay_s=5e-4, sample_s=1e-3))
    found = made(run)
    assert found.runs[0] is other
    assert_allclose(given["dy"], np.tile([0.3, 0.1], (6, 1)))
    torque = np.arange(12.0).reshape(6, 2)
    at = np.maximum(np.arange(6) - 2, 0)
    assert_allclose(given["du"], 0.5 * torque[at] + 0.5 * torque[np.maximum(np.arange(6) - 3, 0)])
    shown = found.runs[1]
    assert_allclose(shown.q_a, motion["q_a"] + 0.5)
    assert_allclose(shown.error, motion["q_a"] - 0.5)
    assert_allclose(shown.turn, shown.q_a[:, 0])
    lost: Any = One((other, Robot(t, t, t, "lost")), reference, None)
    assert made(lost) is lost


# --- bounds of plans -----------------------------------------------------------------------------
class Bounded(dict[str, Any]):
    """A phase that keeps what it is subject to."""

    def __init__(self, equations: Any, **symbols: Any) -> None:
        super().__init__(symbols)
        self.equations = equations
        self.rows = {}
        self.number = 0

    def subject_to(self, value: Any, low: Any, high: Any, *, name: str) -> None:
        self.rows[name] = value, low, high


def test_the_tool_of_a_plan_keeps_its_speed_and_acceleration() -> None:
    """By differences of the forward kinematics, over the squares of the bounds."""
    equations = derive("elbow")
    n = equations.model.n_a
    q, v, a, w = (ca.SX.sym(x, m) for x, m in (("q", n), ("v", n), ("a", n), ("w", 3)))
    phase: Any = Bounded(equations, q_a=q, v_a=v, a_a=a, tool_velocity=w)
    model_limits._bound_tool(phase, Limits(tool_speed=0.5, tool_acceleration=4.0))
    assert {name: row[1:] for name, row in phase.rows.items()} == {
        "speed of the tool": (-np.inf, 1.0),
        "acceleration of the tool": (-np.inf, 1.0),
    }
    speed = ca.Function("speed", [w], [phase.rows["speed of the tool"][0]])
    assert float(speed([0.3, 0.0, 0.4])) == pytest.approx(1.0)
    rng = np.random.default_rng(0)
    x = [rng.standard_normal(n) for _ in range(3)]

    def place(s: float) -> np.ndarray:
        return np.array(
            equations.function("forward_kinematics")(x[0] + s * x[1] + s**2 / 2 * x[2])[0]
        ).ravel()

    h = 1e-3
    size = np.linalg.norm((place(h) - 2 * place(0.0) + place(-h)) / h**2)
    found = ca.Function("size", [q, v, a], [phase.rows["acceleration of the tool"][0]])
    assert float(found(*x)) == pytest.approx((size / 4.0) ** 2, rel=1e-5)
    phase.rows.clear()
    model_limits._bound_tool(phase, Limits())
    assert phase.rows == {}


def test_torques_of_a_plan_keep_their_curves() -> None:
    """Two edges: full torque to 2 rad/s, then falling to a quarter at 4 rad/s; a tenth is left."""
    model: Any = SimpleNamespace(motors=[SimpleNamespace(name="a"), SimpleNamespace(name="b")])
    tau = ca.SX.sym("tau")
    v = ca.SX.sym("v")
    symbols = {"tau_m[a]": tau, "v_m[a]": v}
    phase: Any = Bounded(SimpleNamespace(model=model), **symbols)
    curve = ((0.0, 8.0), (2.0, 8.0), (4.0, 2.0))
    kept: Any = SimpleNamespace(reserve=0.1, torque_speed=(curve, ()))
    model_limits._bound_curves(phase, kept)
    value, low, high = phase.rows["torque of a at its speed"]
    assert low == -np.inf and len(phase.rows) == 1 and value.shape == (8, 1)
    f = ca.Function("f", [tau, v], [value - high])
    for speed, most in ((0.0, 8.0), (1.0, 8.0), (-3.0, 5.0), (4.0, 2.0)):
        for sign in (1, -1):
            assert float(ca.mmax(f(sign * 0.9 * most, speed))) == pytest.approx(0.0, abs=1e-9)
            assert float(ca.mmax(f(sign * 0.91 * most, speed))) > 0.0


def row(name: str, value: Any, low: float, high: float, slack: float | None = None) -> Any:
    """A row of a plan, or a bound: its value is that of symbols."""
    return SimpleNamespace(
        name=name, value=value, lower=np.array([low]), upper=np.array([high]), slack=slack
    )


def test_rows_of_a_plan_hold_where_the_arm_rests() -> None:
    """Speeds are zero there, unknown symbols are left out, and a millionth of a value is
    forgiven.
    """
    y = ca.SX.sym("y", 3)
    dy = ca.SX.sym("dy", 3)
    free = ca.SX.sym("free")
    rows: dict[str, list[Any]] = {"path": [], "start": [], "end": []}
    phase: Any = SimpleNamespace(
        signals=SimpleNamespace(y=y, dy=dy), content=SimpleNamespace(rows=rows, bands={})
    )
    at = np.array([2.0, 3.0])
    rows["path"] = [
        row("sum", y[0] + y[1] + 7 * dy[0], -np.inf, 5.0),
        row("unknown", free, 1.0, 2.0),
    ]
    rows["end"] = [row("far", y[0], 9.0, 10.0)]
    start.check_rest(phase, at, "start")
    start.check_rest(phase, at + np.array([0.0, 4e-6]), "start")
    with pytest.raises(
        SolverError,
        match=r"^plan: 'sum' is violated by 6e-06 at the start, where the arm is at rest; ch",
    ):
        start.check_rest(phase, at + np.array([0.0, 6e-6]), "start")
    with pytest.raises(
        SolverError, match=r"^plan: 'far' is violated by 7 at the end, where the arm is at rest"
    ):
        start.check_rest(phase, at, "end")
    phase.content.bands = {"q": row("q", y[1], 3.5, 4.0)}
    with pytest.raises(SolverError, match=r"^plan: 'bound of q' is violated by 0\.5 at the start"):
        start.check_rest(phase, at, "start")
    phase.content.bands = {}
    rows["path"] = [row("path", y[2], -1.0, 0.25)]  # the path parameter
    start.check_rest(phase, at, "start", 0.25)
    with pytest.raises(SolverError, match=r"^plan: 'path' is violated by 0\.25 at the start"):
        start.check_rest(phase, at, "start", 0.5)
    rows["path"] = [row("root", ca.sqrt(y[0] - 3.0), 0.0, 1.0)]
    with pytest.raises(
        ArgumentError,
        match=r"^plan: 'root' is NaN or infinite at the start, expected a finite number$",
    ):
        start.check_rest(phase, at, "start")


@dataclass(frozen=True)
class Planned:
    """Fields that a check of a plan changes."""

    status: Any = None
    warnings: tuple[str, ...] = ()


def test_rows_of_a_plan_are_checked_between_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """An excess of a hundredth of a bound, a thousandth of the range, or what is too small to
    matter is forgiven.
    """
    y, dy, ddy, tau, t = (ca.SX.sym(x) for x in ("y", "dy", "ddy", "tau", "t"))
    reference = ca.SX.sym("reference", 2)
    duration = ca.SX.sym("T")
    rows: dict[str, list[Any]] = {"path": []}
    mesh = SimpleNamespace(N=2, nodes=np.array([0.0, 0.5, 1.0]), h=np.array([0.5, 0.5]))
    signals = SimpleNamespace(symbols=[y, dy, ddy, tau, t, reference], reference=reference)
    phase = SimpleNamespace(
        content=SimpleNamespace(rows=rows, bands={}),
        mesh=mesh,
        signals=signals,
        duration=duration,
        number=0,
    )
    monkeypatch.setattr(result, "_between", lambda phase, theta: np.array([0.25, 0.75]))
    layout: Any = SimpleNamespace(phases=[phase], parameters=[])
    seen = []

    def at_of(phase: Any) -> Any:
        return lambda sigma: seen.append(sigma) or np.column_stack([sigma, -sigma])

    problem: Any = SimpleNamespace(reference_at=at_of)
    path = np.array([[0.0], [1.0], [2.01], [1.0]])
    zero = np.zeros((4, 1))
    at: Any = SimpleNamespace(
        y=path, dy=zero, ddy=zero, tau=zero, t=np.arange(4.0), theta=np.array([2.0])
    )
    made: Any = SimpleNamespace(names=["a", "a", "b"], scale=np.array([1e-3, 1e-5, 1.0]))

    def warnings(*given: Any) -> tuple[str, ...]:
        rows["path"] = list(given)
        found: Any = result._check_bounds(problem, layout, made, at, Planned())
        assert (found.status == flexgen.Status.TOLERANCE_NOT_MET) == bool(found.warnings)
        return tuple(
            text.partition("; take a finer mesh or a margin")[0] for text in found.warnings
        )

    inf = np.inf
    assert warnings(row("y", y, -inf, 2.0)) == () and warnings(
        row("y", y, -inf, 2.001 - 0.02)
    ) == ("'y' is violated by 0.029 between the collocation points",)
    assert warnings(row("z", y, -inf, 0.0)) == (
        "'z' is violated by 2.01 between the collocation points",
    )
    # of the range
    assert warnings(row("z", y, 0.0, inf)) == () and warnings(row("z", y, 1e-3, inf)) == ()
    assert warnings(row("z", y - 2e-1, -0.1, inf)) == (
        "'z' is violated by 0.1 between the collocation points",
    )
    assert (
        warnings(row("a", 0.05 * y, -inf, 1e-2)) == () != warnings(row("b", 0.05 * y, -inf, 1e-2))
    )
    assert warnings(row("s", y, -inf, 2.0, 0.005)) == (
        "'s' is violated by 0.01 between the collocation points",
    )
    assert warnings(row("s", y, -inf, 2.0, 0.03)) == () and not seen
    assert warnings(row("r", y - 2 * reference[0] - 0 * reference[1], -inf, 1.0)) == ()
    assert_allclose(seen[0], [0.125, 0.375, 0.625, 0.875])
    phase.content.bands = {"q": row("q", y, -inf, 1.5)}
    assert warnings() == ("'bound of q' is violated by 0.51 between the collocation points",)
    assert warnings(row("n", ca.sqrt(y - 1.0), -inf, inf)) == warnings()
    both = row("two", ca.vertcat(y, 2 * y), -inf, inf)
    both.lower = np.array([-inf, -inf])
    both.upper = np.array([1.9, 100.0])
    assert warnings(both)[0] == "'two' is violated by 0.11 between the collocation points"
    both.value = ca.vertcat(y, y + 98.04)  # that one exceeds 100 by less than a hundredth
    both.upper = np.array([1.9, 100.0])
    assert warnings(both)[0] == "'two' is violated by 0.11 between the collocation points"


def test_steps_to_a_motor_angle_are_as_many_as_its_bound_needs() -> None:
    """Fixed points until Newton's method halves at least; then the error is squared until it is
    below rounding.
    """
    for size, harmonic in ((1e-6, 3), (0.02, 5), (0.1, 4), (1e-3, 40)):
        error = FourierSum((harmonic,), (size,), (0.0,))
        slope = size * harmonic
        bend = size * harmonic**2
        curvature = bend / (2 * (1 - slope))
        left = size * slope
        fixed = 1
        while curvature * left > 0.5:
            left = slope * left
            fixed = fixed + 1
        newton = 0
        while left > 1e-17:
            left = curvature * left**2
            newton = newton + 1
        assert motor_harmonics._steps(error, 1.0) == (fixed, newton)
        assert motor_harmonics._steps(FourierSum((harmonic,), (0.0,), (-size / 3,)), -3.0) == (
            fixed,
            newton,
        )
        q = 0.7
        for step in range(fixed + newton):
            value = size * np.cos(harmonic * q)
            rate = -size * harmonic * np.sin(harmonic * q)
            q = 0.7 + value if step < fixed else q - (q - value - 0.7) / (1 - rate)
        assert abs(q - size * np.cos(harmonic * q) - 0.7) < 5e-16


# --- results -------------------------------------------------------------------------------------
def test_changes_of_a_model_from_identified_gears() -> None:
    def number(
        name: str, value: float, change: tuple[str, str, int], determined: bool = True
    ) -> Number:
        return Number(name, value, 0.1, "", change, determined)

    made: Any = object.__new__(GearFit)
    laws = {
        "a.hysteresis": ({"exponent": 2.0}, {"exponent": 3.0}),
        "b.hysteresis": ({"exponent": 1.5},),
    }
    rows = (
        number("q1.stiffness", 5.0, ("a.stiffness", "", -1)),
        number("q1.damping", 6.0, ("a.damping", "", -1), False),
        number("sum", 7.0, ("", "", -1)),
        number("x", 0.2, ("a.hysteresis", "lost_motion", 1)),
        number("y", 0.3, ("b.hysteresis", "lost_motion", 0)),
        number("c", 0.4, ("motor.m1.cogging", "sin", 1)),
        number("e", 0.5, ("a.transmission_error", "cos", 0)),
    )
    for name, value in {
        "numbers": rows,
        "laws": laws,
        "cogging": (4, 6),
        "harmonics": (1,),
    }.items():
        object.__setattr__(made, name, value)
    assert made.changes == {
        "a.stiffness": 5.0,
        "a.hysteresis": [{"exponent": 2.0}, {"exponent": 3.0, "lost_motion": 0.2}],
        "b.hysteresis": {"exponent": 1.5, "lost_motion": 0.3},
        "motor.m1.cogging": {"harmonics": [4, 6], "cos": [0.0, 0.0], "sin": [0.0, 0.4]},
        "a.transmission_error": {"harmonics": [1], "cos": [0.5], "sin": [0.0]},
    }
    object.__setattr__(made, "status", FitStatus.FITTED)
    assert made.problem == ""
    assert laws["a.hysteresis"][1] == {"exponent": 3.0}  # what is given stays


def test_the_best_pose_of_points_is_a_rotation_and_a_shift() -> None:
    """Also of points in a plane, whose mirror image would fit as well."""
    rng = np.random.default_rng(8)
    for flat in (1.0, 0.0):
        a = rng.standard_normal((10, 3)) * [1.0, 1.0, flat]
        R = Rotation.random(random_state=3).as_matrix()
        t = np.array([0.3, -2.0, 5.0])
        found = frames.best_pose(a, a @ R.T + t)
        assert_allclose(found[0], R, atol=1e-12)
        assert_allclose(found[1], t, atol=1e-12)
        angles = frames.angles_of(R)
        assert_allclose(Rotation.from_euler("XYZ", angles).as_matrix(), R, atol=1e-12)
    mirrored = frames.best_pose(a := rng.standard_normal((10, 3)), a * [1.0, 1.0, -1.0])
    assert np.linalg.det(mirrored[0]) == pytest.approx(1.0)


def test_the_frame_of_a_measurement_is_found_from_few_points() -> None:
    """Of a rigid robot at known commands, seen from a frame that is far off; some points were not
    seen.
    """
    trackers = [
        {
            "name": f"t{k}",
            "type": "tracker",
            "element": "tool",
            "position": place,
            "unit": "m",
            "noise": 1e-5,
        }
        for k, place in enumerate(([0.2, 0.0, 0.1], [0.0, 0.3, 0.0], [0.1, 0.1, 0.3]))
    ]
    model = flexgen.read("manutec_r3", overrides={"sensor": trackers})
    tree = Tree(model)
    rng = np.random.default_rng(2)
    statics = Statics(tree, rng.uniform(-1.0, 1.0, (25, model.n_g)))
    first = Numbers.of(tree)
    frame = np.array([0.4, -1.0, 0.2, 0.3, -0.4, 2.5])
    true = replace(first, frame=frame, compliances=0 * first.compliances)
    measured = statics.rest(true, rigid=True).measured.copy()
    measured[3] = np.nan
    found = frames.start_frames(statics, measured, ())
    errors = frames.rigid_errors(statics, measured, found)
    assert np.isnan(errors[3]).all() and np.nanmax(errors) < 0.05
    assert_allclose(frames.rigid_errors(statics, measured, true)[[0, 5]], 0.0, atol=1e-12)
