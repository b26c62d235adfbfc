"""Numbers of the rooms inversion and codegen by other routes: differences, balances of torques,
cases by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import flexgen
from flexgen.base.errors import SolverError
from flexgen.codegen.emission import constants_header
from flexgen.codegen.emission.motor_constants import motor_constants
from flexgen.dynamics.mechanics import statics
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.judge import settling
from flexgen.inversion.methods import closed_form, lq
from flexgen.inversion.problem import limits
from flexgen.inversion.problem.motor_side import deflections
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.elements import RobotModel
from flexgen.paths.path import Path


@dataclass(frozen=True)
class Found:
    """The arrays of an inversion."""

    q_a: Any
    v_a: Any
    a_a: Any
    tau_g: Any
    q_m: Any
    v_m: Any
    tau_m: Any
    n_post: int = 8
    period: float = 0.01


def moving(n: int = 12, n_post: int = 8) -> Found:
    rng = np.random.default_rng(2)
    return Found(*(rng.normal(size=(n, 2)) for _ in range(7)), n_post=n_post)


END: Any = Made(
    **{
        name: np.array([1.0, 2.0]) + 2 * k
        for k, name in enumerate(("q_a", "q_m", "tau_m", "tau_g"))
    }
)


@pytest.mark.parametrize(
    ("mesh", "h", "parts", "interval"),
    [
        (None, 2e-3, 1, 4e-3),
        (None, 4.9e-3, 1, 9.8e-3),
        (None, 6e-3, 1, 1e-2),
        (None, 6e-3, 4, 2.5e-3),
        (5e-4, 2e-2, 1, 2e-2),
        (5e-4, 2e-2, 2, 1e-2),
    ],
)
def test_intervals_of_the_inversion_in_c_are_two_steps_and_ten_milliseconds_at_most(
    mesh: float | None, h: float, parts: int, interval: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a mesh that is given, its own length; each divided into parts."""
    asked: list[float] = []

    def grid(problem: Any, length: float) -> None:
        asked.append(length)
        raise SolverError("asked")

    monkeypatch.setattr(lq, "grid", grid)
    monkeypatch.setattr(lq, "inversion_library", lambda *given, **more: None)
    given: Any = Made(
        check_options=lambda *names: None,
        equations=None,
        force=None,
        options={},
        progress=None,
        mesh=mesh,
    )
    with pytest.raises(SolverError, match="asked"):
        lq.invert_path(given, "lq", h, parts)
    assert asked == [pytest.approx(interval, rel=1e-12)]


def test_motions_that_are_cut_end_in_equilibrium() -> None:
    found = moving()
    for n_post in (1, 5, 8):
        cut = settling._cut(found, n_post, END)
        keep = 4 + n_post
        assert cut.n_post == n_post and [len(x) for x in (cut.q_a, cut.tau_m)] == [keep, keep]
        assert_array_equal(cut.q_a[:-1], found.q_a[: keep - 1])
        for name in ("q_a", "q_m", "tau_m", "tau_g"):
            assert_array_equal(getattr(cut, name)[-1], getattr(END, name))
        assert not any(getattr(cut, name)[-1].any() for name in ("v_a", "a_a", "v_m"))
    assert found.q_a[-1].all()


def test_motions_that_fade_out_have_speeds_and_accelerations_of_their_positions() -> None:
    """A smooth motion, faded: by differences; the torque carries the rotors' accelerations that
    are added.
    """
    n = 401
    n_post = 400
    t = np.linspace(0.0, 0.4, n)[:, None]
    w = np.array([[3.0, 5.0]])
    q = np.sin(w * t)
    v = w * np.cos(w * t)
    a = -(w**2) * np.sin(w * t)
    inertia = np.array([0.2, 0.5])
    found = Found(q, v, a, np.cos(t * w), q, v, np.exp(t * w), n_post, 1e-3)
    problem: Any = Made(equations=Made(model=Made(motors=[Made(inertia=x) for x in inertia])))
    faded: Any = settling.fade_to_equilibrium(problem, found, END)  # type: ignore[arg-type]
    half = n - n_post // 2
    assert_array_equal(faded.q_a[:half], q[:half])
    h = 1e-3
    for q_new, v_new in ((faded.q_a, faded.v_a), (faded.q_m, faded.v_m)):
        rate = (q_new[:-4] - 8 * q_new[1:-3] + 8 * q_new[3:-1] - q_new[4:]) / (12 * h)
        assert_allclose(v_new[2:-2], rate, atol=1e-4 * np.abs(v_new).max())
    rate = (faded.v_a[:-4] - 8 * faded.v_a[1:-3] + 8 * faded.v_a[3:-1] - faded.v_a[4:]) / (12 * h)
    assert_allclose(faded.a_a[2:-2], rate, atol=1e-3 * np.abs(faded.a_a).max())
    for name in ("q_a", "q_m", "tau_m", "tau_g"):
        assert_allclose(getattr(faded, name)[-1], getattr(END, name), atol=1e-9)
    assert np.abs(faded.v_a[-1]).max() < 1e-9 and np.abs(faded.a_a[-1]).max() < 1e-9
    share = (faded.tau_g[half:] - END.tau_g) / (found.tau_g[half:] - END.tau_g)
    rate = (faded.v_m[:-4] - 8 * faded.v_m[1:-3] + 8 * faded.v_m[3:-1] - faded.v_m[4:]) / (12 * h)
    added = rate[half - 2 :] - share[:-2] * a[half:-2]
    expected = END.tau_m + share[:-2] * (found.tau_m[half:-2] - END.tau_m) + inertia * added
    assert_allclose(faded.tau_m[half:-2], expected, atol=1e-3 * np.abs(expected).max())


def test_slow_gears_are_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settling, "gear_lag_times", lambda equations: np.array([0.1, 0.25]))
    long: Any = Made(equations=None, gear_settling=settling.LAGS * 0.25)
    assert settling.slow_gears(long) == ()
    (text,) = settling.slow_gears(Made(equations=None, gear_settling=1.0))
    assert "decays with D/K = 0.25 s and has not decayed 1 s after the path" in text
    monkeypatch.setattr(settling, "gear_lag_times", lambda equations: np.zeros(0))
    assert settling.slow_gears(Made(equations=None, gear_settling=0.0)) == ()


def test_samples_have_equal_steps_and_one_at_the_end_of_the_path() -> None:
    t, after = closed_form.instants(1.0, 0.3, 0.6)
    assert after == 3 and len(t) == 8 and t[4] == 1.0
    assert_allclose(np.diff(t), 0.25)
    t, after = closed_form.instants(2.0, 0.5, 0.0)
    assert after == 0 and len(t) == 5 and t[-1] == 2.0
    t, after = closed_form.instants(1.0, 1e-9, 1e9)
    assert len(t) == 2 * closed_form.SAMPLES + 1 and after == closed_form.SAMPLES


def geared(side: str, damping: float = 2.0) -> RobotModel:
    """A robot whose gears have their springs and dampers on one side, each with a motor of its
    own.
    """
    robot = flexgen.read("elbow")
    elements = []
    for k, element in enumerate(robot.elements):
        dofs = []
        for dof in element.dofs:
            gear = (
                None
                if dof.gear is None
                else replace(dof.gear, side=side, damping=damping * (1 + k))
            )
            dofs.append(replace(dof, gear=gear))
        elements.append(replace(element, dofs=tuple(dofs)))
    ratios = (30.0, 50.0)
    motors = tuple(
        replace(m, ratio=(r,), drives=m.drives[:1])
        for m, r in zip(robot.motors, ratios, strict=True)
    )
    return replace(robot, elements=tuple(elements), motors=motors)


@pytest.mark.parametrize("side", ["arm", "motor"])
def test_damping_on_the_motor_side_counts_with_the_square_of_the_ratio(side: str) -> None:
    model = geared(side)
    gears = [c.dof.gear for c in model.coordinates if c.dof is not None and c.dof.gear is not None]
    ratios = np.array([30.0, 50.0]) if side == "motor" else np.ones(2)
    expected = ratios**2 * [gear.damping for gear in gears]
    constants = motor_constants(model)
    assert_allclose(constants.gear_damping, expected)
    assert_allclose(constants.damping_factor, ratios**2)
    assert_allclose(statics.gear_damping(derive(model)), expected)
    assert constants.arm_side == (
        *(1.0,) * model.n_a,
        *np.abs(model.eta).max(axis=1)[list(model.i_m)],
    )
    assert_allclose(np.array(constants.eta) @ constants.eta_inverse, np.eye(model.n_m), atol=1e-12)
    assert constants.rotor_inertia == tuple(m.inertia for m in model.motors) and not any(
        constants.gear_is_rigid
    )


def test_damping_in_c_is_a_number_or_a_parameter_times_a_factor() -> None:
    constants: Any = Made(gears=("a", "b"), damping_factor=(100.0, 400.0), gear_damping=(7.0, 8.0))

    def text(*names: str) -> str:
        spec: Any = Made(name="arm", parameters=[Made(name=name) for name in names])
        return constants_header._damping(
            spec, constants, lambda values: "{" + ", ".join(f"{x:g}" for x in values) + "}"
        )

    assert "gear_damping[ARM_NG] = {7, 8};" in text("a.mass") and "damping_parameter" not in text(
        "a.mass"
    )
    first = text("a.damping", "payload.mass")
    assert (
        "gear_damping[ARM_NG] = {100, 8};" in first
        and "damping_parameter[ARM_NG] = {0, -1};" in first
    )
    both = text("b.damping", "x", "a.damping")
    assert (
        "gear_damping[ARM_NG] = {100, 400};" in both
        and "damping_parameter[ARM_NG] = {2, 0};" in both
    )


def test_deflections_of_gears_without_damping_are_static_with_derivatives_in_time() -> None:
    """Springs with curvature: p = spring^-1(tau), p' and p'' by differences; tiny damping gives
    the same.
    """
    t = np.linspace(0.0, 0.5, 2001)
    rates = np.stack([30 + 20 * np.sin(6 * t), 120 * np.cos(6 * t), -720 * np.sin(6 * t)], axis=1)
    tau = np.stack([rates, -2 * rates], axis=1)
    for damping, tolerance in ((0.0, 1e-6), (1e-4, 1e-4)):
        model = geared("arm", damping)
        equations = Equations(model)
        p, dp, ddp = deflections(equations, t, tau)
        torque = np.array(
            [np.array(equations.function("gear_law")(x)[0]).ravel() for x in p[::100]]
        )
        assert_allclose(torque, tau[::100, :, 0], rtol=max(tolerance, 1e-9))
        assert_allclose(dp[1:-1], (p[2:] - p[:-2]) / (2 * t[1]), atol=2e-4 * np.abs(dp).max())
        assert_allclose(ddp[1:-1], (dp[2:] - dp[:-2]) / (2 * t[1]), atol=2e-4 * np.abs(ddp).max())


def test_reduced_problems_close_the_kinematics_from_afar_and_refuse_singular_starts() -> None:
    equations = derive("planar5_nmp")
    reduction = Reduction(equations)
    model = equations.model
    path = Path(equations, model.move("line"))
    t = np.linspace(0.0, path.duration, 5)
    targets = reduction.targets(path.sample(t))
    start = np.tile(path.q_start, (5, 1))
    q = reduction.close(start + np.where(np.arange(model.n_a) < 1, 0.05, 0.0), targets)
    y = np.array([np.array(equations.function("output")(x)).ravel() for x in q])
    assert_allclose(y, targets, atol=1e-10)
    assert_array_equal(q[:, list(model.i_e)], start[:, list(model.i_e)])
    stretched = np.zeros(model.n_a)
    poor: Any = Made(q_start=stretched, sample=lambda at: path.sample(at))
    with pytest.raises(
        SolverError, match="the output does not determine the actuated coordinates at the start"
    ):
        reduction.start(poor)


@pytest.mark.parametrize(
    ("torque", "deflection", "text"),
    [
        ([5.0, 7.0], [0.03], ""),
        ([np.inf, np.inf], [np.inf], ""),
        (
            [4.9, 7.0],
            [0.03],
            (
                "motor {0} needs 5 N m to hold the arm at rest at the ends of the path, its "
                "limit is 4.9 N"
            ),
        ),
        (
            [5.0, 6.9],
            [0.03],
            (
                "motor {1} needs 7 N m to hold the arm at rest at the ends of the path, its "
                "limit is 6.9 N"
            ),
        ),
        (
            [5.0, 7.0],
            [0.029],
            (
                "coordinate {2} is deflected by 0.03 at rest at the ends of the path, its limit "
                "is 0.029; raise it or"
            ),
        ),
    ],
    ids=range(5),
)
def test_limits_hold_the_arm_at_both_ends_of_the_path(
    torque: list[float], deflection: list[float], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second motor and the deflection are larger at the end, which is found along the path
    from its start.
    """
    model = flexgen.read("planar5_nmp")
    (elastic,) = model.i_e

    class Rest:
        def __init__(self, t: float) -> None:
            self.t = t

        def start(self, path: Any) -> Any:
            return Made(q_a=np.full(model.n_a, 0.5))

        def follow(self, path: Any, t: np.ndarray, q_a: np.ndarray) -> np.ndarray:
            assert t[0] == 0.0 and t[-1] == 2.0 and (np.diff(t) > 0).all()
            return q_a + t[:, None]

        def equilibrium(self, path: Any, t: float, guess: np.ndarray) -> Any:
            assert t == self.t
            assert_allclose(guess, np.full(model.n_a, 0.25 if t == 0.0 else 2.5))
            q_a = np.zeros(model.n_a)
            q_a[elastic] = 0.01 if t == 0.0 else -0.03
            return Made(q_a=q_a, tau_m=np.array([-5.0, 3.0] if t == 0.0 else [4.0, -7.0]))

    monkeypatch.setattr(limits, "Reduction", Rest)
    path = Made(q_start=np.full(model.n_a, 0.25), duration=2.0)
    problem: Any = Made(equations=Made(model=model), path=path, at_rest=lambda t: t)
    bounds: Any = Made(torque=np.array(torque), deflection=np.array(deflection))
    if not text:
        limits._Bounds.check_equilibrium(bounds, problem)
        return
    names = [*(motor.name for motor in model.motors), model.coordinates[elastic].name]
    with pytest.raises(SolverError) as caught:
        limits._Bounds.check_equilibrium(bounds, problem)
    assert str(caught.value).startswith("limits: " + text.format(*names))
