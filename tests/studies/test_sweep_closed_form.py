"""Many joint moves at once: the torques are those of `flexgen.solve`, and no neighbour in the lot
changes a bit.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import trapezoid
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.gear_lag import gear_lag
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.force_laws import friction_torque
from flexgen.model.elements import NO_FRICTION, Friction, Move, RobotModel
from flexgen.model.reader import read
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.studies.sweeps import batches, closed_form_batch
from flexgen.studies.sweeps.batches import Batches
from flexgen.studies.sweeps.cases import Grid, RandomMove, random_moves
from flexgen.studies.sweeps.closed_form_batch import JointMoves, friction_derivatives, unfit
from flexgen.studies.sweeps.jobs import Job, Shard
from flexgen.studies.sweeps.sweep import sweep

# relative to the largest torque of the motor: what is promised; rounding and differences leave
# 1e-12
SAME = 1e-9
BATCH = {"verify": False, "batch": True}


def moves_of(model: RobotModel, count: int) -> tuple[list[Move], np.ndarray, np.ndarray]:
    moves = [move.of(model) for move in random_moves(count, seed=5)]
    return moves, np.array([move.start for move in moves]), np.array([move.end for move in moves])


def difference(equations: Equations, mover: JointMoves, count: int = 1) -> float:
    """Largest one from `solve`, relative to the largest torque of the motor."""
    moves, starts, ends = moves_of(equations.model, count)
    worst = 0.0
    for move, torque in zip(moves, mover.torques(starts, ends), strict=True):
        one = flexgen.solve(equations, move, "closed-form", verify=False).trajectory
        assert one.time == pytest.approx(mover.t, abs=1e-15)
        worst = max(
            worst,
            float(
                (
                    np.abs(torque - one["tau_m"]).max(axis=0) / np.abs(one["tau_m"]).max(axis=0)
                ).max()
            ),
        )
    return worst


def with_gears(
    model: RobotModel, friction: Friction = NO_FRICTION, damping: float | None = None
) -> RobotModel:
    """Elastic gears with friction of their joints, or with another damping."""
    elements = []
    for element in model.elements:
        dofs = []
        for dof in element.dofs:
            gear = dof.gear
            if gear is not None and not gear.rigid and damping is not None:
                gear = dataclasses.replace(gear, damping=damping)
            dofs.append(dataclasses.replace(dof, friction=friction, gear=gear))
        elements.append(dataclasses.replace(element, dofs=tuple(dofs)))
    return dataclasses.replace(model, elements=tuple(elements))


def coupled(model: RobotModel) -> RobotModel:
    """The second motor drives the first joint as well."""
    first, second = model.motors[:2]
    drives = (*first.drives, *second.drives)
    ratio = (0.3 * second.ratio[0], *second.ratio)
    return dataclasses.replace(
        model, motors=(first, dataclasses.replace(second, drives=drives, ratio=ratio))
    )


@pytest.mark.slow
@needs_compiler
def test_six_axes_by_emitted_c_against_solve(tmp_path) -> None:
    equations = derive("manutec_r3")
    made = flexgen.generate(equations, tmp_path / "library", functions=["inverse_dynamics"])
    mover = JointMoves(equations, TimeLaw(1.0, 5), flexgen.load(made.directory).inverse_dynamics)
    # until the deflections have decayed
    assert np.diff(mover.t) == pytest.approx(1e-3) and mover.t[-1] > 1.0
    assert difference(equations, mover, 2) < SAME


ELBOW = read("elbow")
VARIANTS = {
    "as it is": ELBOW,
    "no damping": with_gears(ELBOW, damping=0.0),
    "friction of the joints": with_gears(ELBOW, Friction(3.0, 20.0, 10.0, 2.0, 4.0, 1.0)),
    "rigid": read("elbow@rigid"),
    "coupled": coupled(ELBOW),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_gears_of_all_kinds_against_solve(name: str) -> None:
    equations = derive(VARIANTS[name])
    assert difference(equations, JointMoves(equations, TimeLaw(1.0, 5))) < SAME


def test_a_wrong_difference_is_seen(monkeypatch) -> None:
    """Planted bug: the second derivative of the gears' torque one thousandth off."""
    monkeypatch.setattr(closed_form_batch, "CENTER", closed_form_batch.CENTER * (1 + 1e-3))
    equations = derive(VARIANTS["no damping"])
    assert difference(equations, JointMoves(equations, TimeLaw(1.0, 5))) > SAME


def test_figures_are_those_of_the_torques() -> None:
    equations = derive(ELBOW)
    mover = JointMoves(equations, TimeLaw(0.5, 6), step=1e-3)
    moves, starts, ends = moves_of(ELBOW, 3)
    peaks = mover.peaks(starts, ends)
    tau = mover.torques(starts, ends)
    assert (peaks.torque_max == np.abs(tau).max(axis=1)).all()
    assert peaks.torque_rms == pytest.approx(
        np.sqrt(trapezoid(tau**2, mover.t, axis=1) / mover.t[-1]), rel=1e-12
    )
    one = flexgen.solve(
        equations, dataclasses.replace(moves[2], duration=0.5, smoothness=6), "closed-form"
    ).trajectory
    work = trapezoid(one["tau_m"] * one["v_m"], one.time, axis=0)
    # solve samples this short move more finely
    assert peaks.energy[2] == pytest.approx(work, rel=1e-4, abs=1e-3)
    assert peaks.speed_max[2] == pytest.approx(np.abs(one["v_m"]).max(axis=0), rel=1e-5)
    assert peaks.speed[2] == pytest.approx(np.abs(one["v_a"]).max(axis=0), rel=1e-5)
    assert peaks.acceleration[2] == pytest.approx(np.abs(one["a_a"]).max(axis=0), rel=1e-5)


def test_other_cases_of_the_batch_do_not_change_a_bit() -> None:
    mover = JointMoves(derive(ELBOW), TimeLaw(1.0, 5), step=5e-3)
    _, starts, ends = moves_of(ELBOW, closed_form_batch.WIDTH + 5)
    both = mover.torques(starts, ends)
    assert (mover.torques(starts[7:8], ends[7:8])[0] == both[7]).all()
    assert (mover.torques(starts[::-1], ends[::-1])[::-1] == both).all()
    peaks = mover.peaks(starts, ends)
    one = mover.peaks(starts[-1:], ends[-1:])
    assert all(
        (getattr(one, f.name)[0] == getattr(peaks, f.name)[-1]).all()
        for f in dataclasses.fields(one)
    )


FRICTIONS = [
    Friction(viscous=0.7, coulomb=3.0, stribeck=2.0, alpha=5.0, beta=9.0, offset=0.4),
    Friction(coulomb=0.7, beta=9.0),
    Friction(viscous=0.5),
]


@pytest.mark.parametrize("law", FRICTIONS)
def test_friction_and_its_derivatives_against_casadi(law: Friction) -> None:
    w = ca.SX.sym("w")
    torque = friction_torque(law, w)
    slope = ca.gradient(torque, w)
    at = ca.Function("f", [w], [torque, slope, ca.gradient(slope, w)]).map(41)
    speeds = np.linspace(-2.0, 2.0, 41) + 1e-3
    expected = [np.array(x).ravel() for x in at(speeds[None])]
    for found, right in zip(friction_derivatives(law, speeds), expected, strict=True):
        assert found == pytest.approx(right, rel=1e-11, abs=1e-11)
    assert closed_form_batch.friction(law, speeds) == pytest.approx(expected[0], rel=1e-13)
    assert np.isfinite(closed_form_batch.friction(law, np.array([1e4, -1e4]))).all()


Q1 = "element.upper.dof.q1"
OBSTACLES: dict[str, tuple[dict[str, object], str]] = {
    "a cubic spring": (
        {f"{Q1}.gear.spring": {"type": "cubic", "stiffness": 7e6, "cubic": 1e9}},
        "model elbow: given springs that are not linear (q1), expected linear ones",
    ),
    "another friction": (
        {
            "motor.m2.friction": {
                "type": "gear",
                "viscous": 0.1,
                "viscous_share": 0.5,
                "viscous_decay": 20.0,
            }
        },
        "model elbow has a friction law GearFriction",
    ),
    "hysteresis": (
        {f"{Q1}.gear.hysteresis": {"lost_motion": 3e-4, "stiffness": 1e5}},
        "the gear of q1 has hysteresis, whose torque depends on the motion before",
    ),
    "bristles": (
        {"motor.m2.lugre": {"stiffness": 1e3, "damping": 1.0, "coulomb": 2.0}},
        "motor m2 has lugre, a friction that depends on the motion before",
    ),
    "cogging": (
        {"motor.m2.cogging": {"harmonics": [6], "sin": [0.03]}},
        "motor m2 has cogging, expected none",
    ),
    "a limit of the tool": (
        {"tool.speed_max": 1.0},
        "model elbow has limits other than of motor torque and speed",
    ),
    "a limit of a gear": (
        {f"{Q1}.gear.torque_max": 1.0},
        "model elbow has limits other than of motor torque and speed",
    ),
    "a counterbalance": (
        {f"{Q1}.counterbalance": {"sin": [5.0]}},
        "model elbow: given a counterbalance (q1), expected none",
    ),
    "drag of a body": (
        {"element.fore.body.rotational_drag": 2.0},
        "model elbow: given bodies with rotational_drag (fore), expected none",
    ),
}
FREE: list[dict[str, object]] = [
    {},
    {"motor.m1.torque_max": 5.0, "motor.m2.speed_max": 100.0},
    {f"{Q1}.friction": {"viscous": 3.0, "coulomb": 2.0, "beta": 9.0}},
    {f"{Q1}.gear": {"type": "rigid"}},
]


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_model_that_has_no_batches_says_why(name: str) -> None:
    changes, why = OBSTACLES[name]
    model = read("elbow", overrides=changes)
    assert unfit(model) == why
    with pytest.raises(ArgumentError, match=r"batch of joint moves: .*; use flexgen\.solve"):
        JointMoves(derive(model), TimeLaw(1.0, 5))


def test_complete_coupling_has_no_batches() -> None:
    complete = dataclasses.replace(ELBOW, motor_coupling="complete")
    told = "model elbow has motor_coupling 'complete', expected 'simplified'"
    assert unfit(complete) == told


@pytest.mark.parametrize("changes", FREE)
def test_a_model_that_has_batches(changes: dict[str, object]) -> None:
    assert unfit(read("elbow", overrides=changes)) == ""


@pytest.mark.parametrize("name", ["planar5_mp", "four_mass"])
def test_coordinates_without_motor_are_refused(name: str) -> None:
    assert "without motor" in unfit(read(name))
    with pytest.raises(ArgumentError, match=r"use flexgen\.solve for each of them"):
        JointMoves(derive(name), TimeLaw(1.0, 5))


def test_a_gear_much_faster_than_the_samples_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"a time constant of 0\.00015 s, much less than a"):
        JointMoves(derive(ELBOW), TimeLaw(1.0, 5), step=0.05)


NOTHING = np.zeros((1, 2))
WRONG: dict[str, tuple[np.ndarray, np.ndarray, type[Exception], str]] = {
    "one joint": (
        np.zeros((3, 1)),
        np.zeros((3, 2)),
        ArgumentError,
        r"given starts \(3, 1\) and ends \(3, 2\), expected \(N, 2\) for both",
    ),
    "no number": (np.nan * NOTHING, NOTHING, ArgumentError, "not finite, expected finite numbers"),
    "no torque": (NOTHING, NOTHING, SolverError, "joint moves 0 to 0: the torques are not finite"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_moves_are_refused(name: str) -> None:
    starts, ends, kind, text = WRONG[name]
    broken = (lambda q, v, a, out: out.fill(np.nan)) if name == "no torque" else None
    with pytest.raises(kind, match=text):
        JointMoves(derive(ELBOW), TimeLaw(1.0, 5), broken, step=0.01).peaks(starts, ends)


# --- limits

SWING = Move("swing", "joint", (0.1, 0.2), 0.5, 5, end=(0.8, -0.5))


def limited(key: str, value: float) -> RobotModel:
    """The elbow with one limit of its first motor or joint."""
    if key.startswith("motor."):
        first = dataclasses.replace(ELBOW.motors[0], **{key.removeprefix("motor."): value})
        return dataclasses.replace(ELBOW, motors=(first, ELBOW.motors[1]))
    dof = dataclasses.replace(ELBOW.elements[0].dofs[0], **{key: value})
    first = dataclasses.replace(ELBOW.elements[0], dofs=(dof,))
    return dataclasses.replace(ELBOW, elements=(first, *ELBOW.elements[1:]))


def reached() -> dict[str, float]:
    """Largest values that the move reaches, by `flexgen.solve`."""
    found = flexgen.solve(ELBOW, SWING, "closed-form", verify=False, progress=False).trajectory
    largest = {name: float(np.abs(found[name][:, 0]).max()) for name in found.channels}
    return {
        "motor.torque_max": largest["tau_m"],
        "motor.speed_max": largest["v_m"],
        "speed_max": largest["v_a"],
        "acceleration_max": largest["a_a"],
        "upper": SWING.end[0],
        "lower": SWING.start[0],
    }


LIMITS = ("motor.torque_max", "motor.speed_max", "speed_max", "acceleration_max", "upper", "lower")


@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize("key", LIMITS)
def test_warnings_of_limits_are_those_of_solve(key: str, beyond: bool) -> None:
    """A limit 2 % inside of what is reached is told, in the words of solve; 2 % outside not."""
    value = reached()[key]
    inside = beyond != (key == "lower")
    robot = limited(key, value * (0.98 if inside else 1.02))
    mover = JointMoves(derive(robot), TimeLaw(0.5, 5))
    starts = np.array([SWING.start] * 2)
    ends = np.array([SWING.end, SWING.start])
    row, still = batches.figures(robot, mover, starts, ends)
    alone = flexgen.solve(robot, SWING, "closed-form", verify=False, progress=False)
    assert row["warnings"] == "\n".join(alone.warnings)
    assert row["status"] == ("limits exceeded" if beyond else "solved") == alone.status.value
    assert bool(row["warnings"]) == beyond
    assert still["status"] == ("limits exceeded" if beyond and key == "lower" else "solved")


# --- which cases of a shard


def rows_of(
    moves: list[Move | str | RandomMove],
    model: str = "elbow",
    method: str = "closed-form",
    **options: object,
) -> dict[int, dict]:
    """Rows of the cases that are computed in batches."""
    robots: dict[str, RobotModel | str] = {"a": read(model), "bad": "no model"}
    jobs = tuple(Job(k, "a", model, "", move, method) for k, move in enumerate(moves))
    jobs += (Job(len(jobs), "bad", "bad", "", SWING, "auto"),)
    shard = Shard(0, jobs, robots, BATCH | options, "")
    return {
        k: row for k, (row, _) in Batches(shard, lambda key, robot: derive(robot)).rows().items()
    }


LEFT: dict[str, dict[str, object]] = {
    "a line": {"type": "output_line"},
    "one joint": {"start": (0.1,)},
    "three joints": {"end": (0.1, 0.2, 0.3)},
    "no duration": {"duration": 0.0},
    "a profile": {"profile": (1.0, 2.0)},
    "a torque that jumps": {"smoothness": 3},
}


@needs_compiler
@pytest.mark.parametrize("name", LEFT)
def test_moves_that_a_batch_leaves_to_solve(name: str) -> None:
    """Next to one that it takes."""
    found = rows_of([dataclasses.replace(SWING, **LEFT[name]), SWING, "no such move", "line"])
    assert list(found) == [1] and found[1]["move"] == "swing"


@needs_compiler
def test_moves_of_several_time_laws_have_their_own_batches() -> None:
    slow = dataclasses.replace(SWING, name="slow", duration=2.0)
    back = dataclasses.replace(SWING, name="back", start=SWING.end, end=SWING.start)
    chance = random_moves(1)[0]
    together = rows_of([SWING, slow, back, chance], method="auto")
    assert [together[k]["move"] for k in range(4)] == ["swing", "slow", "back", "random0"]
    for k, move in enumerate((SWING, slow, back, chance)):
        assert rows_of([move])[0] == together[k]


ALONE: dict[str, dict[str, Any]] = {
    "verified": {"verify": True},
    "an option of a solver": {"mesh": 1e-3},
    "another method": {"method": "lq"},
    "no batches of this robot": {"model": "planar5_nmp"},
}


@needs_compiler
@pytest.mark.parametrize("name", ALONE)
def test_cases_that_are_solved_one_by_one(name: str) -> None:
    assert rows_of([SWING], **ALONE[name]) == {}


@needs_compiler
def test_options_that_leave_batches() -> None:
    assert list(rows_of([SWING], mesh=None, time_limit=9.0)) == [0]


@needs_compiler
def test_a_worker_keeps_the_buffers_of_few_time_laws(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest ones are left; one that is asked for again is not made again."""
    monkeypatch.setattr(batches, "MOVERS", {})
    made = []
    built = batches.JointMoves

    def counted(equations: Equations, law: TimeLaw, library: object) -> JointMoves:
        made.append(law.duration)
        return built(equations, law, library)

    monkeypatch.setattr(batches, "JointMoves", counted)
    times = [0.2, 0.3, 0.4, 0.2, 0.5, 0.6, 0.2]
    for duration in times:
        rows_of([dataclasses.replace(SWING, duration=duration)])
    assert made == [0.2, 0.3, 0.4, 0.5, 0.6, 0.2] and len(batches.MOVERS) == batches.KEPT == 4


# --- the same through a sweep --------------------------------------------------------------------


def test_the_bits_of_one_two_and_seven_shards() -> None:
    grid = Grid(["elbow"], random_moves(40), options=BATCH)
    found = [sweep(grid, workers=0, shard_size=-(-40 // shards)).results for shards in (1, 2, 7)]
    assert (found[0]["verdict"] == "not verified").all() and (found[0]["status"] == "solved").all()
    assert len({table.digest for table in found}) == 1


@pytest.mark.slow
def test_batched_and_single_cases_are_chosen_by_model_and_method() -> None:
    start = (0.1, 0.2)
    end = (0.4, -0.3)
    moves = (
        Move("plain", "joint", start, 1.0, 5, end=end),
        # the torque jumps at its ends: solve judges
        Move("rough", "joint", start, 1.0, 2, end=end),
        "line",
        Move("wrong", "joint", (0.1,), 1.0, 5, end=(0.2,)),
    )
    table = sweep(
        Grid(["elbow", "planar5_mp"], moves, ["closed-form"], options=BATCH), workers=0
    ).results
    assert list(table["verdict"] == "not verified") == [True] + 7 * [False]
    assert (
        list(table["status"][[0, 2]]) == ["solved", "solved"]
        and (table["status"][3:] == "failed").all()
    )
    assert table["status"][1] == "failed" or "makes the torque jump" in table["warnings"][1]
    assert list(table["move"][:3]) == ["plain", "rough", "line"]
    # both ways say the same of the same case
    alone = sweep(
        Grid(["elbow"], moves[:1], ["closed-form"], options={"verify": False}), workers=0
    ).results
    for name in ("torque_max", "torque_rms", "speed_max", "energy"):
        assert table[name][0] == pytest.approx(alone[name][0], rel=1e-9), name
    # a verification that is asked for is done
    verified = sweep(
        Grid(["elbow"], moves[:1], ["closed-form"], options={"batch": True}), workers=0
    ).results
    assert verified["tool_error_max"][0] < 1e-6


def test_a_bad_move_has_no_neighbours() -> None:
    start = (0.1, 0.2)
    end = (0.4, -0.3)
    moves = [
        Move(f"m{k}", "joint", start, 1.0, 5, end=(end[0] + 0.01 * k, end[1])) for k in range(7)
    ]
    for bad in (2, 6):
        moves[bad] = Move(f"m{bad}", "joint", start, 1.0, 5, end=(1e160, 0.0))
    grid = Grid(["elbow"], moves, ["closed-form"], options=BATCH)
    tables = [sweep(grid, workers=0, shard_size=size).results for size in (7, 3, 1)]
    assert list(tables[0]["status"]) == ["failed" if k in (2, 6) else "solved" for k in range(7)]
    assert all(tables[0]["error"][[2, 6]]) and not any(tables[0]["error"][[0, 1, 3, 4, 5]])
    assert len({table.digest for table in tables}) == 1


@pytest.mark.slow
def test_limits_have_the_same_messages_as_in_solve() -> None:
    model = read("manutec_r3", overrides={"motor.m1.torque_max": 0.5, "motor.m2.speed_max": 1.0})
    move = Move("fast", "joint", model.home, 0.5, 5, end=tuple(q + 1.0 for q in model.home))
    texts = [
        str(sweep(Grid([model], [move], options=options), workers=0).results["warnings"][0])
        for options in (BATCH, {"verify": False})
    ]
    assert texts[0] == texts[1] and "motor m1: torque" in texts[0] and "coordinate q1" in texts[0]


def test_without_a_compiler_casadi_does_it(monkeypatch) -> None:
    grid = Grid(["elbow"], random_moves(2), options=BATCH)
    compiled = sweep(grid, workers=0).results
    monkeypatch.setattr(batches, "MOVERS", {})
    monkeypatch.setattr(batches, "LIBRARIES", {})

    def refused(*args: object, **named: object) -> None:
        raise flexgen.BuildError("no compiler")

    monkeypatch.setattr(batches, "generate", refused)
    table = sweep(grid, workers=0).results
    assert (table["verdict"] == "not verified").all()
    assert table["torque_max"] == pytest.approx(compiled["torque_max"], rel=1e-12)


# --- the lag of a damped gear --------------------------------------------------------------------


STIFFNESS = 20.0


def lag_error(t: np.ndarray, damping: float, w: float, start: float) -> float:
    """Largest one of the twist under the torque sin(w t), against the solution by hand; relative
    to 1/K.
    """
    tau = np.stack([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)])[:, :, None]
    found = gear_lag(t, np.array([STIFFNESS]), np.array([damping])).deflections(
        tau, np.array([start])
    )[:, 0]
    decay = STIFFNESS / damping
    steady = (decay * np.sin(w * t) - w * np.cos(w * t)) / (damping * (decay**2 + w**2))
    exact = steady + (start - steady[0]) * np.exp(-decay * t)
    return float(np.abs(found - exact).max() * STIFFNESS)


@pytest.mark.parametrize("damping", [2.0, 0.02, 2e-5])
def test_the_lag_against_the_solution_by_hand(damping: float) -> None:
    """Time constants from ten times the steps to a ten-thousandth of them; the steps differ."""
    t = np.cumsum(np.r_[0.0, np.tile([0.008, 0.012], 50)])
    assert lag_error(t, damping, 2 * np.pi, 0.01) < 1e-10


def test_the_lag_is_of_sixth_order_and_exact_at_rest() -> None:
    errors = [lag_error(np.linspace(0.0, 1.0, n + 1), 2.0, 12.0, 0.0) for n in (16, 32)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(6, abs=0.3)
    for damping in (1e-3, 1.0, 1e3):
        constant = np.zeros((3, 101, 1))
        constant[0] = 7.0
        rest = gear_lag(
            np.linspace(0.0, 1.0, 101), np.array([STIFFNESS]), np.array([damping])
        ).deflections(constant, np.array([0.35]))
        assert np.abs(rest - 0.35).max() < 1e-15


@pytest.mark.slow
def test_a_sweep_of_a_model_with_hysteresis_is_that_of_solve() -> None:
    """One by one, as batches do not know the gears: the largest torque is another one than without
    hysteresis.
    """
    lossy = {"element.upper.dof.q1.gear.hysteresis": {"lost_motion": 3e-3, "stiffness": 7e6}}
    found = []
    for more in ({}, lossy):
        robot = read("elbow", overrides=more)
        row = sweep(
            Grid([robot], ["joints"], ["closed-form"], options={"verify": False}), workers=0
        ).results
        solved = flexgen.solve(robot, "joints", verify=False, progress=False)
        found.append(float(row["torque_max"][0]))
        assert found[-1] == pytest.approx(np.abs(solved.trajectory["tau_m"]).max(), rel=1e-6)
    assert abs(found[1] / found[0] - 1.0) > 5e-4
