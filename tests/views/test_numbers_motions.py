"""Numbers of motions by hand: pictures of a video, large motions of an oscillator, parts of a
closed loop.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

import flexgen
from flexgen.feedback.loop import case
from flexgen.feedback.observers import constant_gain
from flexgen.feedback.observers.constant_gain import ConstantGainObserver
from flexgen.identification.responses import large_motions
from flexgen.paths.force.process_force import CHANNEL
from flexgen.views.plots.canvas import GREEN, INK, ORANGE, RED
from flexgen.views.reports import video


def moving(factor: int, sign: float = 1.0, views: Any = ((0, 2), (0, 1))) -> dict[str, Any]:
    """Four points at three instants, and ten times the deflections."""
    truth = np.arange(36.0).reshape(3, 12) / 10
    return {
        "time": [1.0, 2.0, 4.0],
        "tool": [[0.0, 0.0, -1.0], [1.0, 2.0, 3.0], [5.0, 2.0, 4.0]],
        "factors": [1, 10],
        "factor": factor,
        "poses": [truth.tolist(), (2 * truth - 1).tolist()],
        "views": views,
        "sign": sign,
        "reference": [[0.0, 0.5, 1.0], [2.0, 2.5, 3.0]],
        "beams": [1],
        "joints": [(0, "rigid"), (2, "elastic")],
    }


def test_a_video_shows_the_robot_between_its_instants() -> None:
    """Three quarters of the way from the second to the third instant; axes with a margin of 7
    %.
    """
    figure = Figure()
    data = moving(10)
    video._begin(figure, data, "arm")(3.5)
    assert figure._suptitle.get_text() == "arm, deflections \u00d7 10, 3.500 s"
    truth, robot = (np.array(x).reshape(3, 4, 3) for x in data["poses"])
    tool = np.array(data["tool"])
    everything = np.concatenate([robot.reshape(-1, 3), tool])
    low = everything.min(axis=0)
    high = everything.max(axis=0)
    margin = 0.07 * (high - low).max()
    assert len(figure.axes) == 2
    for axes, (right, up), names in zip(figure.axes, data["views"], ("xz", "xy"), strict=True):
        assert axes.get_xlim() == pytest.approx((low[right] - margin, high[right] + margin))
        assert axes.get_ylim() == pytest.approx((low[up] - margin, high[up] + margin))
        assert (axes.get_xlabel(), axes.get_ylabel()) == (f"{names[0]}, m", f"{names[1]}, m")
        plain, trail, reference, arm, beam, first, second, last = axes.lines
        for line, points, color in (
            (plain, 0.25 * truth[1] + 0.75 * truth[2], "#cccccc"),
            (arm, 0.25 * robot[1] + 0.75 * robot[2], INK),
            (beam, (0.25 * robot[1] + 0.75 * robot[2])[1:3], ORANGE),
            (first, (0.25 * robot[1] + 0.75 * robot[2])[:1], None),
            (second, (0.25 * robot[1] + 0.75 * robot[2])[2:3], None),
            (last, (0.25 * robot[1] + 0.75 * robot[2])[3:], INK),
            (trail, np.vstack([tool[:2], 0.25 * tool[1] + 0.75 * tool[2]]), GREEN),
            (reference, np.array(data["reference"]), RED),
        ):
            assert_allclose(line.get_xydata(), points[:, [right, up]], rtol=1e-12)
            assert color is None or to_hex(line.get_color()) == color.lower()


def test_a_video_of_a_robot_as_it_is_shows_it_once() -> None:
    """Without a reference, in one view, with the vertical axis downwards; also before and after
    its instants.
    """
    figure = Figure()
    data = moving(1, -1.0, [(0, 2)]) | {"reference": None, "beams": [], "joints": []}
    move = video._begin(figure, data, "arm")
    (axes,) = figure.axes
    trail, arm, last = axes.lines
    low, high = axes.get_ylim()
    assert low > high
    for t, k in ((0.0, 0), (1.0, 0), (2.0, 1), (4.0, 2), (5.0, 2)):
        move(t)
        assert figure._suptitle.get_text() == f"arm, deflections as they are, {t:.3f} s"
        points = np.array(data["poses"][0][k]).reshape(4, 3)[:, [0, 2]]
        assert_allclose(arm.get_xydata(), points, atol=1e-15)
        assert_allclose(last.get_xydata(), points[-1:], atol=1e-15)
        shown = [
            row for time, row in zip(data["time"], data["tool"], strict=True) if time <= t
        ] + [data["tool"][k]]
        assert_allclose(trail.get_xydata(), np.array(shown)[:, [0, 2]], atol=1e-15)


@pytest.mark.parametrize("channels", [[], [0]])
def test_large_motions_of_oscillators_follow_from_sums(
    channels: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two masses, a spring of `sin`, two steps by sums over 15 samples; a sensor of a product of
    three rates.
    """
    m = 0.5
    k = 8.0
    speed = 2.0
    lines = np.array([1, 3])
    rest = np.array([0.3, 0.1])
    q, v, a = (ca.SX.sym(name, 2) for name in ("q", "v", "a"))
    symbol = ca.SX.sym("m")
    force = k * ca.sin(q[0] - q[1])
    left = ca.vertcat(symbol * a[0] + force, a[1] + 3 * q[1] - force)
    equations: Any = Made(y=(q, v, a), left=left, symbols=symbol, model=Made(dof=2))
    monkeypatch.setattr(large_motions, "motor_rows", lambda model: np.array([[2.0, 1.0]]))
    monkeypatch.setattr(
        large_motions, "sensor_signals", lambda equations: ca.vertcat(v[0] ** 2 * a[1], q)
    )
    made = large_motions.LargeMotions(
        equations, np.array([m]), channels, lambda function: function
    )
    s = 1j * speed * np.arange(7)[:, None, None]
    K = k * np.cos(0.2) * np.array([[1, -1], [-1, 1]]) + np.diag([0, 3])
    Z = s**2 * np.diag([m, 1.0]) + 0.4 * s * np.eye(2) + K
    held = 0.1 * s * np.ones((2, 2))
    linear = np.array([[0.2 + 0.1j, 0.1], [-0.1j, 0.05j]])  # lines, coordinates
    found = made.outputs(rest, lines, speed, Z, held, linear[:, :, None])
    # samples, multiples
    turns = np.exp(1j * np.outer(np.arange(15) * 2 * np.pi / 15, np.arange(7)))

    def motion(Y: np.ndarray) -> list[np.ndarray]:
        return [np.real(turns @ x) for x in (Y, s[:, 0] * Y, s[:, 0] ** 2 * Y)]

    def spectrum(x: np.ndarray) -> np.ndarray:
        return np.asarray(turns.conj().T @ x) * 2 / 15

    def nonlinear(Y: np.ndarray) -> np.ndarray:
        x = motion(Y)[0] @ np.array([1, -1])
        return spectrum(np.outer(k * (np.sin(0.2 + x) - np.sin(0.2) - np.cos(0.2) * x), [1, -1]))

    Y = np.zeros((7, 2), complex)
    Y[lines] = linear
    N = nonlinear(Y)[:, :, None]
    Y = -np.linalg.solve(Z + held, N)[:, :, 0]
    Y[0] /= 2  # the mean has no second half
    Y[lines] = linear - np.linalg.solve(Z, N)[lines, :, 0]
    Y[lines] = linear - np.linalg.solve(Z, nonlinear(Y)[:, :, None])[lines, :, 0]
    expected = [Y[lines] @ [2.0, 1.0]]
    # not those of linear oscillators
    assert np.abs(linear @ [2.0, 1.0] - expected[0]).min() > 2e-4
    if channels:
        _, rates, accelerations = motion(Y)
        expected.append(spectrum(rates[:, 0] ** 2 * accelerations[:, 1])[lines])
    assert_allclose(found[:, :, 0], np.array(expected).T, atol=1e-12)
    # products of three lines up to 3 do not fall on lines
    assert {count for _, count in made._many} == {15}


class Local:
    """Dynamics of a robot under a force; its largest rates are given."""

    equations: Any

    def __init__(self, equations: Any) -> None:
        self.equations = equations
        self.forces = list[Any]()
        self.seen = list[Any]()

    def under(self, process: Any, time: float) -> Local:
        self.seen.append((process, time))
        return self

    def rests(self, motion: Any, values: Any) -> Any:
        return ("rest",) * len(values)

    def largest_rate(self, points: Any, values: np.ndarray) -> float:
        return 3.0


@pytest.mark.parametrize(
    ("delay", "whole", "rest"), [(0.0, 0, 0.0), (2.5e-3, 2, 5e-4), (3e-3, 3, 0.0)]
)
def test_a_closed_loop_begins_with_the_parts_of_its_move(
    delay: float, whole: int, rest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its delay as samples and the rest of one; a force of the trajectory begins with its first
    value.
    """
    robot = flexgen.read("elbow")
    seen = dict[str, Any]()
    force = np.arange(12.0).reshape(2, 6)

    class Path:
        def __init__(self, *given: Any) -> None:
            self.duration = 0.7

    class Trajectory:
        time = np.array([0.1, 0.8])

        def __contains__(self, name: str) -> bool:
            return name == CHANNEL

        def __getitem__(self, name: str) -> Any:
            return force

    def made_force(given: Any, model: Any, duration: float) -> str:
        seen["force"] = type(given), duration
        return "process"

    def resting(reference: Any, local: Any, values: Any) -> Any:
        seen["pushed"] = local.equations
        return reference

    def reference_of(
        trajectory: Any,
        path: Any,
        sample_s: float,
        late: float,
        library: Any,
        time: Any,
        known: Any,
    ) -> Any:
        seen.update(time=time, late=late)
        count = len(time)
        return Made(
            time=time,
            motion="motion",
            points=lambda at: seen.update(points=at) or "points",
            count=count,
        )

    equations = Made(model=robot, pushed_by=lambda one: ("pushed by", one.tolist()))
    names: list[Any] = []
    monkeypatch.setattr(case, "derive", lambda model, names=(): equations)
    monkeypatch.setattr(case, "Path", Path)
    monkeypatch.setattr(case, "LocalDynamics", Local)
    monkeypatch.setattr(case, "make_force", made_force)
    monkeypatch.setattr(case, "resting", resting)
    monkeypatch.setattr(case, "motion_reference", reference_of)
    monkeypatch.setattr(
        case, "library_with", lambda model, functions, **more: names.append((functions, more))
    )
    solution: Any = Made(trajectory=Trajectory(), move=None)
    made = case.control_case(
        robot, solution=solution, sample_time=1e-3, delay=delay, encoder_noise=1e-6
    )
    assert seen["force"] == (Trajectory, 0.7) and seen["pushed"] == (
        "pushed by",
        force[0].tolist(),
    )
    assert seen["late"] == delay and made.delay == pytest.approx(delay)
    assert (made.delay_samples, made.hardware.delay_s) == (whole, pytest.approx(rest, abs=1e-15))
    assert (made.hardware.delay_s == 0) == (rest == 0) and made.hardware.encoder_noise_rad == 1e-6
    assert made.hardware.torque_max_Nm == tuple(motor.torque_max or 0.0 for motor in robot.motors)
    assert (made.hardware.encoder_resolution_rad, made.hardware.torque_noise_Nm) == (0.0, 0.0)
    assert seen["time"][0] == pytest.approx(0.1 - 2.0) and seen["time"][-1] == pytest.approx(
        0.8 + 0.5
    )
    assert len(seen["points"]) == 40 and seen["points"][[0, -1]].tolist() == [
        0,
        len(seen["time"]) - 1,
    ]
    assert (
        made.rate == 3.0
        and made.rests == ("rest",)
        and made.force == "process"
        and made.gears is None
    )
    assert names == [(["forward_dynamics", "forward_dynamics_tool_force"], names[0][1])]
    assert names[0][1]["parameters"] == () and names[0][1]["per_point"] is False
    free = case.control_case(robot, solution=solution, sample_time=1e-3, torque_limits=False)
    assert free.hardware.torque_max_Nm == () and free.hardware.encoder_noise_rad == 0.0


def test_numbers_of_an_observer_lie_as_its_program_reads_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Panels of 24 rows, 4 outputs side by side, and each part from a cache line on."""
    model = flexgen.read("elbow")
    n_a = model.n_a
    n_m = model.n_m
    n_x = 2 * model.dof
    made: Any = object.__new__(ConstantGainObserver)
    rng = np.random.default_rng(2)
    order = np.array([1, 0, 2])  # a motor angle, then two outputs that are sums
    shapes = ((n_x, n_x), (n_x, n_m), (3, n_x), (3, n_m), (n_x + 2, 3))
    matrices = tuple(rng.normal(size=(2, *shape)) for shape in shapes)
    values = {
        "model": model,
        "_order": order,
        "channels": Made(index=np.array([1, 0, 1])),
        "_dense": 2,
        "matrices": matrices,
        "samples": 3,
    }
    for name, value in values.items():
        object.__setattr__(made, name, value)

    class Program:
        flexgen_constant_gain_size: Any = staticmethod(lambda head: 16)
        flexgen_constant_gain_run: Any = staticmethod(lambda *given: 0)

    monkeypatch.setattr(constant_gain, "c_module", lambda *given, **more: Program)
    motion = {
        name: rng.normal(size=(5, n))
        for name, n in (("q_a", n_a), ("q_m", n_m), ("v_a", n_a), ("v_m", n_m))
    }
    torque = rng.normal(size=(5, n_m))
    ConstantGainObserver._make(made, motion, torque, False)
    tables = made._tables
    (F, G, C, D, M) = matrices
    size = 24 * (n_x + n_m) + 4 * (n_x + n_m) + 3 * (n_x + 2)
    part = -(-size // 8) * 8
    assert tables["matrices"].shape == (2, part)
    for k, found in enumerate(tables["matrices"]):
        panel = found[: 24 * (n_x + n_m)].reshape(n_x + n_m, 24)
        assert_allclose(panel[:, :n_x], np.vstack([F[k].T, G[k].T]))
        assert_allclose(panel[:, n_x:], 0.0)
        side = found[24 * (n_x + n_m) : 28 * (n_x + n_m)].reshape(n_x + n_m, 4)
        assert_allclose(
            side, np.hstack([np.vstack([C[k].T, D[k].T])[:, order[1:]], np.zeros((n_x + n_m, 2))])
        )
        assert_allclose(
            found[28 * (n_x + n_m) : size], np.vstack([M[k][:, j] for j in order]).ravel()
        )
    assert_allclose(tables["u_ref"], np.vstack([torque[:1], torque[:4]]))
    assert_allclose(
        tables["x_ref"], np.hstack([motion[name] for name in ("q_a", "q_m", "v_a", "v_m")])
    )
    assert_allclose(tables["y_ref"], motion["q_m"][:, [0, 1, 1]])
    assert tables["state"].tolist() == [n_a + 0]
    head = made._head
    assert (head.n_x, head.n_m, head.n_y, head.n_dense, head.parts) == (n_x, n_m, 3, 2, 2)
    assert (head.samples, head.part, head.references) == (3, part, 5)
