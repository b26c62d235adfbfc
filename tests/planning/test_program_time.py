"""The fastest time laws of programs: every limit is kept by torques of another simulation, and
none is for free.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.limit_use import LimitRow, limit_rows, uses_of_limits
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.paths.path import Path
from flexgen.planning.fastest import minimum_time, program_time, time_search
from flexgen.planning.fastest.program_time import ProgramSearch, legs_of
from flexgen.planning.fastest.stated_speeds import StatedSpeeds, stated_speeds

pytestmark = needs_compiler
KEPT = 5e-4
MODEL = "planar5_nmp"


def program(*steps: object, **more: object) -> flexgen.Program:
    """A program of the arm planar5_nmp."""
    given = {"start": (0.3, -1.1), "smoothness": 5, "profile": (0.4, 2.0, 30.0, 600.0)}
    return flexgen.Program(
        "three", steps=steps, joint_profile=(1.0, 5.0, 60.0, 900.0), **(given | more)
    )


THREE = program(
    flexgen.MoveJ((0.5, -1.3)),
    flexgen.MoveL((-0.12, 0.0, 0.0), zone=0.03, speed=0.2),
    flexgen.MoveL((0.0, 0.12, 0.0), pause=0.1),
    flexgen.MoveJ((0.3, -1.1)),
)


def measures(solution: flexgen.Solution) -> dict[str, np.ndarray]:
    """Quantities that the limits bound, from the motion of the simulated robot and differences,
    without the code of the search.
    """
    t = solution.trajectory
    run = solution.simulation.trajectory
    h = t.time[1] - t.time[0]
    on_path = (t.time >= 0.0) & (t.time <= flexgen.plan(solution.model, solution.move).duration)
    place = evaluate(flexgen.derive(solution.model).function("forward_kinematics"), run["q_a"])[0]
    tool = np.linalg.norm(np.gradient(place, run.time, axis=0), axis=1)
    return {
        "torque": np.abs(t["tau_m"]).max(axis=0),
        "rate": np.abs(np.diff(t["tau_m"], axis=0)).max(axis=0) / h,
        "rms": np.sqrt(np.mean(t["tau_m"][on_path] ** 2, axis=0)),
        "gear": np.abs(t["tau_g"]).max(axis=0),
        "deflection": np.abs(run["q_a"][:, list(solution.model.i_e)]).max(axis=0),
        "tool": tool.max(keepdims=True),
    }


@pytest.fixture(scope="module")
def given() -> dict[str, np.ndarray]:
    return measures(flexgen.solve("planar5_nmp", THREE, progress=False))


def limits_of(given: dict[str, np.ndarray], **more: object) -> Limits:
    named = {
        "torque": tuple(1.3 * given["torque"]),
        "torque_rate": tuple(4.0 * given["rate"]),
        "gear_torque": tuple(1.3 * given["gear"]),
        "deflection": tuple(1.3 * given["deflection"]),
        "tool_speed": float(1.5 * given["tool"][0]),
        "reserve": 0.1,
    }
    return Limits(**(named | more))


@pytest.fixture(scope="module")
def found(given: dict[str, np.ndarray]) -> flexgen.FastestMove:
    return flexgen.fastest(
        "planar5_nmp", THREE, limits=limits_of(given), coefficients=8, progress=False
    )


@pytest.mark.slow
def test_a_program_is_faster_and_keeps_every_limit(
    given: dict[str, np.ndarray], found: flexgen.FastestMove
) -> None:
    limits = limits_of(given)
    now = measures(found.solution)
    assert found.duration_s < 0.85 * found.default_s and found.excess <= KEPT
    assert found.solution.status == "solved" and found.solution.tool_error_max_m < 1e-6
    assert (now["torque"] <= 0.9 * np.array(limits.torque) * (1 + KEPT)).all()
    assert (now["gear"] <= 0.9 * np.array(limits.gear_torque) * (1 + KEPT)).all()
    assert (now["rate"] <= np.array(limits.torque_rate) * (1 + KEPT)).all()
    assert (now["deflection"] <= np.array(limits.deflection) * (1 + KEPT)).all()
    assert now["tool"][0] <= limits.tool_speed * (1 + 2e-3)  # by differences of a simulation
    assert max(now["torque"] / (0.9 * np.array(limits.torque))) > 0.98  # and uses what it may
    assert found.rigid_s < found.duration_s


@pytest.mark.slow
def test_the_program_with_its_laws_is_a_program_like_others(found: flexgen.FastestMove) -> None:
    """A plan of the program found has its path, the speeds of its steps and its pause."""
    move = found.move
    assert isinstance(move, flexgen.Program) and len(move.laws) == 3 and move.steps == THREE.steps
    path = flexgen.plan("planar5_nmp", move)
    assert path.duration == pytest.approx(found.duration_s, rel=1e-12)
    _, second, third = path.segments
    assert third.start - second.start - second.law.duration == pytest.approx(0.1, abs=1e-12)
    t = second.start + np.linspace(0, second.law.duration, 4001)
    x = path.sample(t).y
    straight = np.abs(x[:, 1, 1]) < 1e-9
    straight &= np.arange(len(t)) < 1000
    assert np.linalg.norm(x[straight, :, 1], axis=1).max() <= 0.2 * (1 + 1e-3)
    assert np.linalg.norm(x[:, :, 1], axis=1).max() > 0.3  # the second leg states none
    ends = flexgen.plan("planar5_nmp", THREE)
    assert np.allclose(
        path.sample([path.duration]).y[:, :, 0], ends.sample([ends.duration]).y[:, :, 0], atol=1e-9
    )


@pytest.mark.full
def test_effective_torques_connect_the_motions(
    given: dict[str, np.ndarray], found: flexgen.FastestMove
) -> None:
    """A bound in the middle between those of the slow and the fast program; better than the fast
    one slowed down.
    """
    fast = measures(found.solution)["rms"]
    rms = tuple((given["rms"] + fast) / 2)
    limits = limits_of(given, torque_rms=rms)
    slower = flexgen.fastest("planar5_nmp", THREE, limits=limits, coefficients=8, progress=False)
    now = measures(slower.solution)["rms"]
    assert (now <= np.array(rms) * (1 + 2e-3)).all() and max(now / rms) > 0.98
    assert found.duration_s < slower.duration_s < found.default_s and slower.excess <= KEPT
    default = flexgen.solve("planar5_nmp", THREE, verify=False, progress=False)
    path = Path(flexgen.derive("planar5_nmp"), THREE)
    search = ProgramSearch(path, default, slower.limits, 8, lambda line: None)
    simple = search._slow_enough([np.array(law) for law in found.move.laws])
    assert slower.duration_s < search.duration(simple.x)


# --- the search ----------------------------------------------------------------------------------
@dataclass
class Leg:
    """A motion whose two limits are reached by a short duration T and by a coefficient c off its
    best one.
    """

    work: float
    best: float
    lost: float = 0.0
    found: Any = None
    programs: int = 3
    inversions: int = 2

    def try_constraints(self, x: np.ndarray) -> np.ndarray | None:
        if x[0] <= self.lost:
            return None
        self.found = SimpleNamespace(x=x.copy())
        return np.array([self.work * (1 + 2 * (x[1] - self.best) ** 2) / x[0] ** 2, -0.5 / x[0]])

    def differences(self, x: np.ndarray) -> Iterator[tuple[np.ndarray, float, np.ndarray | None]]:
        for k in range(2):
            other = x + 1e-6 * (np.arange(2) == k)
            yield other, 1e-6, self.try_constraints(other)

    def quick_start(self) -> np.ndarray:
        return np.array([np.sqrt(self.work), self.best])

    def start(self) -> np.ndarray:
        return np.array([5.0, self.best])

    def run(self, x: np.ndarray) -> tuple[np.ndarray, list[float]]:
        return x, []

    def slower(self, x: np.ndarray, excess: float) -> np.ndarray:
        return x * [1 + max(0.3 * excess, 1e-4), 1.0]


@pytest.fixture(scope="module")
def real() -> ProgramSearch:
    default = flexgen.solve(MODEL, THREE, verify=False, progress=False)
    limits = Limits(torque=(25.0, 10.0), torque_rms=(9.0, 4.0))
    path = Path(flexgen.derive(MODEL), default.move)
    return ProgramSearch(path, default, limits, 8, lambda line: None)


def toy(real: ProgramSearch, heat: float, lost: float = 0.0) -> Any:
    """Two motions whose effective torques are ``sqrt(mean of work / T^2)`` over ``heat``."""
    made = copy.copy(real)
    lines: list[str] = []
    legs = [Leg(1.0, 0.4, lost), Leg(0.5, 0.7, lost)]
    vars(made).update(legs=legs, pauses=[0.25], programs=0, tell=lines.append, lines=lines)

    def effective(x: list[np.ndarray], found: list[Any]) -> np.ndarray:
        assert all(np.array_equal(one.x, part) for one, part in zip(found, x, strict=True))
        whole = sum(
            leg.work * (1 + (part[1] - leg.best) ** 2) / part[0]
            for leg, part in zip(legs, x, strict=True)
        )
        return np.array([whole / made.duration(x) / heat, 0.2])

    made._effective = effective
    made._excesses = lambda x: [-0.1, -0.1, -0.1]
    return made


FIRST = [np.array([1.0, 0.4]), np.array([np.sqrt(0.5), 0.7])]


def test_effective_torques_connect_the_motions_of_a_program(real: ProgramSearch) -> None:
    """The durations are those of a nonlinear program by another solver; without the limit each
    motion is alone.
    """
    made = toy(real, 0.55)
    x, history = made.run()
    assert history[0] == pytest.approx(1.25 + np.sqrt(0.5)) and made.inversions == 4
    state = made._state(x)
    assert state.excess() < 2e-3 and state.duration == pytest.approx(history[-1] - 0.25)

    def all_of(z: np.ndarray) -> np.ndarray:
        own = made._state([z[:2], z[2:]])
        return np.concatenate([1 - own.c, *[1 - np.abs(g) for g in own.g]])

    best = minimize(
        lambda z: z[0] + z[2],
        np.array([1.5, 0.4, 1.2, 0.7]),
        constraints={"type": "ineq", "fun": all_of},
        tol=1e-9,
    )
    assert best.success and state.duration == pytest.approx(best.fun, rel=5e-3)
    assert np.allclose([x[0][0], x[1][0]], best.x[[0, 2]], rtol=0.05)
    assert made.lines[-1].startswith(f"{history[-1]:.4f} s, limits exceeded by ")
    assert made.programs > 6 + len(made.lines) - 1
    easy = toy(real, 100.0)
    assert [part[0] for part in easy.run()[0]] == [part[0] for part in FIRST]
    assert easy.lines == [] and easy.programs == 6


def test_a_program_is_slowed_down_as_much_as_its_torques_need(real: ProgramSearch) -> None:
    """By bisection: the factor of all durations at which the effective torques are those that are
    allowed; motions that cannot be inverted are slower still.
    """
    made = toy(real, 0.4)
    state = made._slow_enough(FIRST)
    factor = state.x[0][0] / FIRST[0][0]
    assert factor > 1.0 and state.x[1][1] == 0.7
    assert state.x[1][0] / FIRST[1][0] == pytest.approx(factor)

    def torque(factor: float) -> float:
        return float(made._state([part * [factor, 1.0] for part in FIRST]).c.max())

    assert state.c.max() <= 1.0 < torque(factor * (1 - 0.3 * factor / 2**program_time.BISECTIONS))
    late = toy(real, 0.4, 1.2)._slow_enough(FIRST)
    assert late.x[1][0] > 1.2 and late.c.max() <= 1.0
    text = "the effective torques cannot be kept in this program at the speeds that were tried"
    with pytest.raises(SolverError, match=text):
        toy(real, 1e-3)._slow_enough(FIRST)
    with pytest.raises(SolverError, match=r"times slower it needs inf of one$"):
        toy(real, 1e-3, 1e9)._slow_enough(FIRST)


def test_slopes_of_a_program_are_derivatives(real: ProgramSearch) -> None:
    made = toy(real, 0.5)
    state = made._state([np.array([1.3, 0.5]), np.array([0.9, 0.6])])
    own, connecting = made._slopes(state)
    T, c = state.x[0]
    row = [-2 * (1 + 2 * (c - 0.4) ** 2) / T**3, 4 * (c - 0.4) / T**2]
    assert np.allclose(own[0], [row, [0.5 / T**2, 0.0]], rtol=1e-4, atol=1e-6)
    whole = 1.01 / 1.3 + 0.5 * 1.01 / 0.9
    total = 1.3 + 0.9 + 0.25
    slopes = [(-1.01 / 1.3**2 / total - whole / total**2) / 0.5, 0.2 / 1.3 / total / 0.5]
    assert np.allclose(connecting[0], [slopes, [0.0, 0.0]], rtol=1e-4, atol=1e-6)


def test_a_program_is_slowed_down_until_all_of_it_keeps_its_limits(real: ProgramSearch) -> None:
    """Each motion by its own excess, and all by that of the whole."""
    made = toy(real, 100.0)
    lines: list[str] = []
    made.tell = lines.append

    def excesses(x: list[np.ndarray]) -> list[float]:
        return [1.8 / made.duration(x) - 1.0, 1.5 / x[0][0] - 1.0, 0.2 / x[1][0] - 1.0]

    made._excesses = excesses
    x = made._slow_down([np.array([0.9, 0.0]), np.array([0.3, 0.0])])
    assert max(excesses(x)) <= -1e-4 and x[0][0] / 0.9 > x[1][0] / 0.3
    assert lines[0] == "1.4500 s, limits of the whole program exceeded by 6.7e-01"
    made._excesses = lambda x: [0.3, 0.5, 0.1]
    made.connecting = Limits()
    with pytest.raises(
        SolverError, match=r"in this program at any speed; .* needs 1\.5 of a limit"
    ):
        made._slow_down(FIRST)
    made.connecting = Limits(torque_rms=(1.0, 1.0))  # of other time laws the mean may be smaller
    with pytest.raises(
        SolverError, match=r"at the speeds that were tried, up to .* needs 1\.5 of"
    ):
        made._slow_down(FIRST)


def test_effective_torques_are_those_of_the_whole_program(real: ProgramSearch) -> None:
    """By integrals of the torques of its solution, pauses included."""
    x = [leg.start() for leg in real.legs]
    state = real._state(x)
    program = real.move(x)
    assert program.duration == pytest.approx(real.duration(x)) and len(real.pauses) == 2
    assert real.duration(x) == pytest.approx(sum(p[0] for p in x) + sum(real.pauses))
    found = flexgen.solve(MODEL, program, verify=False, ignore_limits=True, progress=False)
    t = found.trajectory.time
    on_path = (t >= 0.0) & (t <= real.duration(x))
    square = np.trapezoid(found.trajectory["tau_m"][on_path] ** 2, t[on_path], axis=0)
    rms = np.sqrt(square / real.duration(x)) / [9.0, 4.0]
    assert np.allclose(state.c, rms, rtol=0.01)
    ends = real.windows(x)
    middle = x[0][0] + real.pauses[0] / 2
    assert ends[0] == (-np.inf, pytest.approx(middle + 0.02))
    assert ends[1][0] == pytest.approx(middle - 0.02) and ends[-1][1] == np.inf
    uses = uses_of_limits(found.model, real.single, found.trajectory.__getitem__, t)
    stated = [
        leg.speeds.parts(segment.law).max(initial=0.0)
        for leg, segment in zip(real.legs, real.retime(x).segments, strict=True)
    ]
    most = max(max(use.part for use in uses), rms.max(), *stated)
    assert real.excess(x) == pytest.approx(most - 1.0, abs=0.02)


@pytest.mark.parametrize("planted", ["reserve", "gears"])
def test_planted_errors_are_found(
    planted: str, given: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search that forgets the reserve, or the torques of the gears, exceeds a limit; `solve`
    notices.
    """
    own = limits_of(given, torque=tuple(9.0 * given["torque"])).without(
        "tool_speed", "deflection", "torque_rate"
    )

    def wrong_rows(model: Any, limits: Limits, *more: Any, **end: Any) -> Iterator[LimitRow]:
        if planted == "reserve":
            limits = replace(limits, reserve=0.0)
        rows = limit_rows(model, limits, *more, **end)
        return (row for row in rows if planted != "gears" or row.quantity != "gear torque")

    for module in (time_search, program_time, minimum_time):
        monkeypatch.setattr(module, "limit_rows", wrong_rows)
    move = replace(THREE, steps=(THREE.steps[0], THREE.steps[-1]))
    found = flexgen.fastest("planar5_nmp", move, limits=own, coefficients=4, progress=False)
    used = measures(found.solution)["gear"] / (0.9 * np.array(own.gear_torque))
    assert found.excess <= KEPT and used.max() > 1.05
    solved = flexgen.solve(
        "planar5_nmp", found.move, limits=replace(own, torque=None), verify=False, progress=False
    )
    assert solved.status in ("limits active", "limits exceeded")


def steepest(solution: flexgen.Solution) -> np.ndarray:
    """Largest rates of the torques, between their samples too."""
    t = solution.trajectory.time
    tau = solution.trajectory["tau_m"]
    rate = make_interp_spline(t, tau, k=5).derivative()
    return np.abs(rate(np.linspace(t[0], t[-1], 20 * len(t)))).max(axis=0)


@pytest.mark.slow
def test_the_last_check_keeps_what_the_search_forgets(
    given: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rates of torques between the samples of the solution, whose mesh is not that of the
    search.
    """
    own = Limits(torque=tuple(1.3 * given["torque"]), torque_rate=tuple(7.5 * given["rate"]))
    excesses = minimum_time._excesses
    seen = []

    def forgetful(model: Any, limits: Limits, *more: Any, **end: Any) -> Iterator[LimitRow]:
        return limit_rows(model, replace(limits, torque_rate=None), *more, **end)

    def seeing(found: flexgen.Solution, *more: Any) -> np.ndarray:
        seen.append((steepest(found) / np.array(own.torque_rate)).max())
        return excesses(found, *more)

    for module in (time_search, program_time):
        monkeypatch.setattr(module, "limit_rows", forgetful)
    monkeypatch.setattr(minimum_time, "_excesses", seeing)
    move = replace(THREE, steps=(THREE.steps[0], THREE.steps[-1]))
    found = flexgen.fastest("planar5_nmp", move, limits=own, coefficients=4, progress=False)
    assert seen[0] > 1.02 and 0.98 < seen[-1] <= 1.0 + KEPT and found.excess <= KEPT


def test_stated_speeds_of_steps_and_corners() -> None:
    assert stated_speeds(THREE) == [(None,), (0.2, None), (None,)]
    assert stated_speeds(flexgen.read("elbow").moves[0]) == [()]
    path = Path(flexgen.derive("planar5_nmp"), THREE)
    legs = legs_of(path)
    assert [leg.segments[0].start for leg in legs] == [0.0, 0.0, 0.0]
    speeds = StatedSpeeds.of(legs[1].segments[0], (0.2, None), 0.25)
    assert (
        speeds.s[0] == 0.0
        and 0.09 < speeds.s[-1] < 0.16
        and np.isclose(speeds.most, 0.2, rtol=1e-6).all()
    )
    law = legs[1].segments[0].law
    t = np.linspace(0, law.duration, 20001)
    s, rate = law(t, 1).T
    assert np.isclose(speeds.parts(law).max(), rate[s <= speeds.s[-1]].max() / 0.2, rtol=1e-3)
    assert not len(StatedSpeeds.of(legs[0].segments[0], (None,), 0.25).parts(law))


@pytest.mark.slow
def test_what_no_program_can_do_is_refused(given: dict[str, np.ndarray]) -> None:
    with pytest.raises(
        ArgumentError, match="vibration: given for the program three, expected a single move"
    ):
        flexgen.fastest("planar5_nmp", THREE, vibration=1e-3, progress=False)
    for laws in (((1.0, 0.5),), ((1.0, 0.5), (1.0, 0.5), ()), ((1.0, 0.5), (1.0,), (1.0, 0.5))):
        with pytest.raises(
            ArgumentError,
            match=r"laws .*, expected none, or 3, one for each motion from rest to rest",
        ):
            flexgen.plan("planar5_nmp", replace(THREE, laws=laws))
    weak = limits_of(given, torque_rms=tuple(0.3 * given["rms"]))
    move = replace(THREE, steps=(THREE.steps[0], THREE.steps[-1]))
    with pytest.raises(
        SolverError, match="effective torques cannot be kept in this program at the speeds"
    ):
        flexgen.fastest("planar5_nmp", move, limits=weak, coefficients=4, progress=False)


@pytest.mark.full
def test_six_axes_keep_all_limits_of_their_model_file() -> None:
    """Ten motions of manutec_r3_18 with every kind of limit."""
    from programs_of_moves import ten_motions

    model, move = ten_motions()
    found = flexgen.fastest(model, move, progress=False)
    t = found.solution.trajectory
    assert found.excess <= KEPT and found.duration_s < 0.8 * found.default_s
    assert (
        found.solution.status in ("solved", "limits exceeded")
        and found.solution.tool_error_max_m < 1e-6
    )
    for motor, tau, v in zip(model.motors, t["tau_m"].T, t["v_m"].T, strict=True):
        speeds, torques = np.array(motor.torque_speed).T
        assert (np.abs(tau) <= np.interp(np.abs(v), speeds, torques) * (1 + KEPT)).all()
        assert np.abs(tau).max() <= motor.torque_max * (1 + KEPT)
        on_path = (t.time >= 0.0) & (t.time <= found.duration_s)
        assert np.sqrt(np.mean(tau[on_path] ** 2)) <= motor.torque_rms_max * (1 + 2e-3)
    assert not [
        text for text in found.solution.warnings if "exceeds" in text and "coordinate" not in text
    ]


def test_a_program_of_one_motion_gets_its_law_too(given: dict[str, np.ndarray]) -> None:
    move = replace(THREE, steps=(flexgen.MoveJ((0.5, -1.3)),))
    own = Limits(torque=tuple(1.3 * given["torque"]))
    found = flexgen.fastest("planar5_nmp", move, limits=own, coefficients=4, progress=False)
    assert found.duration_s < found.default_s and len(found.move.laws) == 1
    assert found.solution.trajectory.time[-1] < found.default.trajectory.time[-1]


@pytest.mark.slow
def test_a_program_whose_residual_is_too_large_unverified_is_verified() -> None:
    """It was refused, with the advice to switch the verification on."""
    steps = tuple(flexgen.MoveJ(end=end) for end in ((0.5, -0.3), (0.6, -0.4)))
    two = flexgen.Program(
        "two", start=(0.4, -0.2), steps=steps, joint_profile=(1.0, 5.0, 50.0, 1000.0)
    )
    with pytest.raises(SolverError, match="does not satisfy the equations of motion"):
        flexgen.solve("elbow", two, verify=False, progress=False)
    found = flexgen.fastest(
        "elbow", two, limits=flexgen.Limits(torque=(40.0, 25.0)), progress=False
    )
    assert found.solution.status == "solved" and found.duration_s < found.default_s
