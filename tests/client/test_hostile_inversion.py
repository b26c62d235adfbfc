"""A thousand hostile calls of the inversion in C: each ends in bounded time, with a status that is
true.
"""

from __future__ import annotations

import ctypes
from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hostile import (
    BEFORE,
    FOUND,
    LOST,
    NAMES,
    OUTPUTS,
    SPOILERS,
    Call,
    MethodResult,
    Streamed,
    Target,
    call_of,
    held,
    invert,
    output,
    struct_of,
    target,
    untouched,
    unwanted,
)
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError, FlexgenError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.emission.interface import START_SAMPLES
from flexgen.dynamics.mechanics.statics import reach
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.sampling import time_derivative
from flexgen.inversion.solve import solve
from flexgen.model.reader import read
from flexgen.runtime.inversion.limited_inversion import SIZES

pytestmark = needs_compiler

SEED = 20261120
CALLS = 400
UPDATES = 300
STEPS = 25  # of the solver, at most
ON_PATH = 1e-8  # m, rad: of the tool at the samples, relative to the size of y
SAMPLED = 1e2  # tolerances that OK allows at the samples, where the mesh meets one
UNEVEN = 2e-2  # what OK allows, see `unevenness`
TORQUE = 5e-3  # of the largest torque: what OK allows
OTHER_SCALE = 1.5  # the torques at rest that residuals are relative to, found in another way
ROUNDING = 1e-9  # of residuals that are evaluated by other operations
# of the largest gear torque: gears that follow at once lag by the square of 5e-3, and rounding
LAG = 1e-3
TARGETS = ("planar5_nmp", "elbow", "manutec_r3", "four_mass", "slack", "limp", "light")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Targets by name, made when they are first asked for."""
    folder = tmp_path_factory.mktemp("hostile")
    planar = read("planar5_nmp")

    def changed(name: str, **changes) -> object:
        arm1, arm2, arm3 = planar.elements
        gears = [element.dofs[0].gear for element in (arm1, arm2)]
        spring = changes.pop("spring", arm3.dofs[0].spring)
        springs = changes.pop("springs", [gear.spring for gear in gears])
        damping = changes.pop("damping", 1.0)
        inertia = changes.pop("inertia", 1.0)
        elements = [
            replace(
                e,
                dofs=(replace(e.dofs[0], gear=replace(g, spring=s, damping=damping * g.damping)),),
            )
            for e, g, s in zip((arm1, arm2), gears, springs, strict=True)
        ]
        last = replace(
            arm3,
            dofs=(replace(arm3.dofs[0], spring=spring, damping=damping * arm3.dofs[0].damping),),
        )
        motors = tuple(replace(m, inertia=inertia * m.inertia) for m in planar.motors)
        return replace(
            planar,
            name=f"hostile_{name}",
            text=name,
            elements=(*elements, last),
            motors=motors,
            **changes,
        )

    from flexgen.model.elements import BacklashSpring, LinearSpring, PiecewiseSpring

    models = {
        # a dead band, and a spring without damping that is all but none at first
        "slack": lambda: changed(
            "slack",
            springs=[BacklashSpring(4e5, 1e-3, 1e-4), PiecewiseSpring(1e-3, 2.5e5, 1e-3)],
            damping=0.0,
        ),
        # nothing holds the last link
        "limp": lambda: changed("limp", spring=LinearSpring(0.0), gravity=(0.0, 0.0, 0.0)),
        "light": lambda: changed("light", inertia=0.0, damping=0.0),
    }
    options = {
        "planar5_nmp": {"singular": 1},
        "elbow": {"singular": 1},
        "manutec_r3": {"move": "line", "singular": 4},
        "light": {"singular": 1},
    }

    @cache
    def one(name: str) -> Target:
        return target(models.get(name, lambda: name)(), folder / name, **options.get(name, {}))

    return one


# --- what is true --------------------------------------------------------------------------------
def all_places(call: Call, x: np.ndarray) -> np.ndarray:
    """Samples of a path with those before and after it."""
    return np.concatenate(
        [np.repeat(x[:1], call.n_pre, axis=0), x, np.repeat(x[-1:], call.n_post, axis=0)]
    )


def check_results(target: Target, call: Call, answer: MethodResult) -> None:
    """Results on the path satisfy the equations, by CasADi and by differences; they are exact, or
    the report says that they are not.
    """
    r = answer.results
    model = target.equations.model
    status = NAMES[answer.status]
    mesh, between, kinematic_mismatch, torque_error = answer.report
    rough = torque_error > TORQUE
    assert all(np.isfinite(x).all() for x in r.values()) and np.isfinite(answer.report).all()
    assert mesh <= call.tolerance
    wanted = all_places(call, call.y)
    y, R = output(target, r["q_a"])
    size = 1.0 + np.abs(wanted).max()
    assert np.abs(y - wanted[:, : y.shape[1]]).max() <= ON_PATH * size
    if R is not None:
        assert np.abs(R.transpose(0, 2, 1).reshape(len(R), 9) - wanted[:, 3:]).max() <= ON_PATH
    rest = slice(3, -3)
    # samples before and after: an arm without other coordinates rests there
    at_rest = 0 if model.n_e else 3
    a_m = time_derivative(r["v_m"], call.period)
    motion = (*(r[key] for key in ("q_a", "v_a", "a_a", "q_m", "v_m")), a_m, r["tau_m"])
    r_a, r_m = (
        x.reshape(len(y), -1) for x in evaluate(target.equations.function("residual"), *motion)
    )
    if model.n_e:
        q = r["q_a"][0]
        step = np.where(np.isin(np.arange(model.n_a), model.i_e), 1e-6, 0.0)
        law = target.equations.function("elastic_torque")
        ends = [evaluate(law, x[None], 0 * q[None])[0].ravel() for x in (q + step, q - step)]
        scale = 1e-2 * np.abs(ends[0] - ends[1]) / 2e-6
        found = float((np.abs(r_a[:, model.i_e]) / scale).max())
        allowed = ROUNDING * (1.0 + np.abs(r["tau_g"]).max() / scale.min())
        assert found <= OTHER_SCALE * between + allowed
        assert between <= OTHER_SCALE * found + allowed
    if status == "TOLERANCE_NOT_MET":
        assert between > SAMPLED * call.tolerance or kinematic_mismatch > UNEVEN or rough
        return
    assert between <= SAMPLED * call.tolerance and kinematic_mismatch <= UNEVEN and not rough
    for x, dy, least in (("q_a", "v_a", 1e-9), ("v_a", "a_a", 1e-6)):
        values = np.pad(
            r[x], ((at_rest, at_rest), (0, 0)), mode="edge" if x == "q_a" else "constant"
        )
        rates = np.pad(r[dy], ((at_rest, at_rest), (0, 0)))
        off = np.abs(time_derivative(values, call.period) - rates)[rest].max(initial=0.0)
        assert off <= 1.01 * UNEVEN * max(np.abs(r[dy]).max(), least)
    assert np.abs(r_a[:, model.i_g]).max() <= LAG * np.abs(r["tau_g"]).max() + ROUNDING
    inertia = np.array([motor.inertia for motor in model.motors])
    most = 2 * UNEVEN * (inertia * np.abs(a_m)).max() + 1e-6 * (1.0 + np.abs(r["tau_m"]).max())
    # behind a rigid gear it is the acceleration that is compared
    behind = np.isin(np.arange(model.n_m), model.i_m)
    assert np.abs(r_m[rest] * np.where(behind, 1.0, inertia)).max(initial=0.0) <= most


def check_held_torques(target: Target, call: Call, answer: MethodResult) -> None:
    """A hold changes the torques to send only, by less than the largest torque; without it the
    results are checked.
    """
    plain = invert(target, replace(call, hold=0, delay=0.0))
    assert plain.status == answer.status and np.array_equal(plain.report, answer.report)
    assert all(
        np.array_equal(plain.results[key], answer.results[key])
        for key in OUTPUTS
        if key != "tau_m"
    )
    tau = plain.results["tau_m"]
    sent = answer.results["tau_m"]
    assert np.isfinite(sent).all() and np.abs(sent - tau).max() <= 2 * np.abs(tau).max()
    check_results(target, call, plain)


def check_refusal(target: Target, call: Call, status: str, kind: str) -> None:
    """A path that was not followed is hard, judged without the library."""
    if target.equations.model.name == "hostile_limp":
        assert kind not in ("plain", "tolerances") or status == "NOT_CONVERGED"
        return
    if kind == "out_of_reach" and target.equations.model.output.type != "combination":
        assert np.abs(call.y[:, 0]).max() > reach(target.equations)
    assert kind not in ("plain", "tolerances") or status == "NOT_CONVERGED"


def test_invalid_paths_are_refused_or_have_a_failure_status(made):
    rng = np.random.default_rng(SEED)
    seen: Counter[str] = Counter()
    wrong = []
    for k in range(CALLS):
        one = made(TARGETS[k % len(TARGETS)])
        spoil = SPOILERS[k // len(TARGETS) % len(SPOILERS)]
        call, expected = spoil(one, rng)
        answer = invert(one, call)
        status = NAMES[answer.status]
        seen[status] += 1
        limp = one.equations.model.name == "hostile_limp" and expected & FOUND
        try:
            assert not answer.spilled
            assert status in (expected | {"NOT_CONVERGED"} if limp else expected)
            if spoil is unwanted:
                full = invert(one, replace(call, null=""))
                assert answer.status == full.status
                for key, x in answer.results.items():
                    assert np.array_equal(x, full.results[key]) or (
                        key == call.null and not np.isin(x, full.results[key]).any()
                    )
            elif answer.status >= 0 and spoil is held:
                check_held_torques(one, call, answer)
            elif answer.status >= 0:
                check_results(one, call, answer)
            else:
                check_refusal(one, call, status, spoil.__name__)
        except AssertionError as error:
            told = TARGETS[k % len(TARGETS)], spoil.__name__, status, answer.report
            wrong.append((k, *told, str(error)[:200]))
    assert not wrong, wrong
    assert {"OK", "TOLERANCE_NOT_MET", "UNREACHABLE", "NOT_CONVERGED", "RESULT_NOT_FINITE"} <= set(
        seen
    )


def test_the_check_finds_a_planted_wrong_torque(made):
    """Planted: another path, a jump of the joints by a turn, a torque that is too small."""
    one = made("elbow")
    call = call_of(one)
    answer = invert(one, call)
    check_results(one, call, answer)
    for key in ("q_a", "v_a", "a_a", "q_m", "tau_m"):
        right = answer.results[key]
        wrong = replace(answer, results={**answer.results, key: right + 0.2 * np.abs(right).max()})
        with pytest.raises(AssertionError):
            check_results(one, call, wrong)
    turned = {key: x.copy() for key, x in answer.results.items()}
    turned["q_a"][BEFORE + 20 :, 0] += 2 * np.pi
    with pytest.raises(AssertionError):
        check_results(one, call, replace(answer, results=turned))


def test_repeated_calls_give_the_same_bits(made):
    for name in ("planar5_nmp", "elbow"):
        call = call_of(made(name))
        first, second = (invert(made(name), call) for _ in range(2))
        assert all(np.array_equal(first.results[key], second.results[key]) for key in OUTPUTS)


# --- streams -------------------------------------------------------------------------------------
INTERVALS = 12
PARTS = 2


def begun(one: Target, **options) -> Streamed:
    stream = Streamed(one, INTERVALS, PARTS, **options)
    assert stream.start(one.path["y"][0], one.path["q_start"], one.period) == 0
    return stream


def sample(one: Target, k: int) -> list[np.ndarray]:
    return [np.array(one.path[key][min(k, len(one.path[key]) - 1)]) for key in ("y", "dy", "ddy")]


def refused(one: Target, k: int, rng: np.random.Generator) -> tuple[list[np.ndarray], str]:
    """A sample that a stream must refuse, and the status."""
    given = sample(one, k)
    kinds = ["INPUT_NOT_FINITE", "UNREACHABLE", "BAD_ARGUMENT"]
    pose = one.sizes["n_t"] > one.sizes["n_y"]
    kind = kinds[rng.integers(3 if pose else 2)]
    if kind == "INPUT_NOT_FINITE":
        given[rng.integers(3)][0] = rng.choice([np.nan, np.inf, -np.inf])
    elif kind == "UNREACHABLE":
        given[0][0] = 10.0 ** rng.uniform(1, 300)
    else:
        given[0][3:] *= -1.0
    return given, kind


def test_invalid_samples_of_streams_are_refused(made):
    rng = np.random.default_rng(SEED)
    streams = {
        name: (begun(made(name)), begun(made(name)))
        for name in ("planar5_nmp", "elbow", "manutec_r3")
    }
    for k in range(1, UPDATES // (2 * len(streams)) + 1):
        for name, (stream, twin) in streams.items():
            one = made(name)
            given, expected = refused(one, k, rng)
            before = stream.memory.copy()
            assert NAMES[stream.update(*given)] == expected
            if expected != "UNREACHABLE":  # to find out it has to use its scratch
                assert stream.memory.tobytes() == before.tobytes()
            status = stream.update(*sample(one, k))
            assert status == twin.update(*sample(one, k)) and NAMES[status] in FOUND
            results = stream.results()
            others = twin.results()
            assert all(np.array_equal(results[key], others[key]) for key in results)
            assert all(np.isfinite(x).all() for x in results.values()) and not stream.spilled
            assert (status == 0) == (
                stream.report.residual <= 1e-6
                and stream.report.kinematic_mismatch <= UNEVEN
                and stream.report.torque_step <= 0.01 * UNEVEN
            )
            y, _ = output(one, results["q_a"][:1])
            now = one.path["y"][min(max(k - INTERVALS, 0), len(one.path["y"]) - 1)]
            assert np.abs(y[0] - now[: y.shape[1]]).max() <= ON_PATH


@pytest.mark.parametrize("fill", [0.0, 1.0, 2.0, -1.0, 1e300, np.nan, np.inf])
def test_a_stream_that_was_not_started_refuses_calls(made, fill):
    one = made("elbow")
    stream = Streamed(one, INTERVALS, PARTS, fill=fill)
    assert NAMES[stream.update(*sample(one, 1))] == "NOT_STARTED"
    assert untouched(stream.block)


def test_a_failed_stream_can_be_started_again(made):
    one = made("planar5_nmp")
    y = one.path["y"][0]
    q = one.path["q_start"]
    stream = begun(one)
    for given, expected in (
        ((None, q, 1e-3), "NULL_ARGUMENT"),
        ((y, None, 1e-3), "NULL_ARGUMENT"),
        ((y, q, 0.0), "BAD_ARGUMENT"),
        ((y, q, np.nan), "BAD_ARGUMENT"),
        ((y, q, 1e-3, 1.0), "BAD_ARGUMENT"),
    ):
        assert NAMES[stream.start(*given)] == expected
        assert NAMES[stream.update(*sample(one, 1))] in FOUND  # as if nothing had been said
        assert stream.start(y, q, one.period) == 0
    for given, expected in (
        ((y * np.nan, q, 1e-3), "INPUT_NOT_FINITE"),
        ((y, q + np.inf, 1e-3), "INPUT_NOT_FINITE"),
        ((100 * y, q, 1e-3), "UNREACHABLE"),
        ((y, q + 1e9, 1e-3), "RESULT_NOT_FINITE"),
    ):
        assert NAMES[stream.start(*given)] == expected
        assert NAMES[stream.update(*sample(one, 1))] == "NOT_STARTED"
        assert stream.start(y, q, one.period) == 0
        assert NAMES[stream.update(*sample(one, 1))] in FOUND
    for key in range(3):
        nothing = sample(one, 2)
        nothing[key] = None
        assert NAMES[stream.update(*nothing)] == "NULL_ARGUMENT"
    for short in (1, 10**9):
        assert (
            NAMES[Streamed(one, INTERVALS, PARTS, short=short).start(y, q, 1e-3)]
            == "WORK_TOO_SMALL"
        )
    for counts in ((0, 1), (1, 0), (-(2**31), 1), (10001, 1), (1, 1001), (2**31 - 1, 2**31 - 1)):
        options = struct_of(
            one.structs["stream_options"], intervals=counts[0], samples_per_interval=counts[1]
        )
        assert one.function("stream_work", ctypes.c_int64)(ctypes.byref(options)) == -1
        assert NAMES[Streamed(one, *counts).start(y, q, 1e-3)] == "BAD_ARGUMENT"


def moving_path(one: Target, first: int = 0) -> dict[str, Any]:
    """Arguments of `stream_start_moving`: the path of a target, its last sample repeated."""
    k = [min(first + i, len(one.path["y"]) - 1) for i in range(INTERVALS + START_SAMPLES)]
    samples = {key: np.array(one.path[key])[k] for key in ("y", "dy", "ddy")}
    return {"n": len(k), "period": one.period, **samples}


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow", "four_mass"])
def test_bad_paths_of_streams_that_start_in_motion(made, name):
    """Each is refused; the memory around is untouched; a refused start leaves no stream that runs
    on a wrong path.
    """
    one = made(name)
    q = one.path["q_start"]
    rng = np.random.default_rng(SEED)
    stream = Streamed(one, INTERVALS, PARTS)
    for changes, expected in (
        ({"n": INTERVALS + START_SAMPLES - 1}, "BAD_ARGUMENT"),
        ({"n": 2**31 - 1}, "BAD_ARGUMENT"),
        ({"n": -1}, "BAD_ARGUMENT"),
        ({"period": np.nan}, "BAD_ARGUMENT"),
        ({"period": 2 * one.period}, "BAD_ARGUMENT"),
        ({"y": None}, "NULL_ARGUMENT"),
        ({"dy": None}, "NULL_ARGUMENT"),
        ({"ddy": None}, "NULL_ARGUMENT"),
    ):
        assert (
            NAMES[stream.start_moving({**moving_path(one), **changes}, q, one.period)] == expected
        )
    assert NAMES[stream.start_moving(moving_path(one), None, one.period)] == "NULL_ARGUMENT"
    for key in ("y", "dy", "ddy"):
        path = moving_path(one)
        path[key][rng.integers(len(path[key])), 0] = rng.choice([np.nan, np.inf])
        assert NAMES[stream.start_moving(path, q, one.period)] == "INPUT_NOT_FINITE"
    for _ in range(30):
        path = moving_path(one, int(rng.integers(60)))
        key = rng.choice(["y", "dy", "ddy"])
        where = rng.integers(INTERVALS + START_SAMPLES)
        path[key][where:] = path[key][where:] * rng.choice([1e3, 1e150, -1e6])
        status = NAMES[stream.start_moving(path, q, one.period)]
        assert not stream.spilled
        if status == "OK":
            answer = NAMES[stream.update(*sample(one, 1))]
            assert answer not in FOUND or all(
                np.isfinite(x).all() for x in stream.results().values()
            )
        else:
            assert status in {
                "UNREACHABLE",
                "NOT_CONVERGED",
                "RESULT_NOT_FINITE",
                "BAD_ARGUMENT",
                "INPUT_NOT_FINITE",
            }
            assert NAMES[stream.update(*sample(one, 1))] == "NOT_STARTED"
    assert NAMES[stream.start_moving(moving_path(one, 20), q, one.period)] == "OK"
    assert NAMES[stream.update(*sample(one, 20 + INTERVALS + START_SAMPLES))] == "OK"


@pytest.mark.parametrize("period", [1e-12, 1e-9, 1e-4, 1.0, 1e5])
def test_streams_of_strange_periods_and_rough_samples(made, period):
    """Whatever happens is said; a stream that failed after it took a sample says so from then
    on.
    """
    rng = np.random.default_rng(SEED)
    for name in ("planar5_nmp", "slack", "four_mass"):
        one = made(name)
        stream = Streamed(one, 3, 1)
        assert stream.start(one.path["y"][0], one.path["q_start"], period) == 0
        for k in range(1, 12):
            given = sample(one, k)
            given[1] = given[1] * rng.choice([1.0, one.period / period, 1e6, 1e200])
            status = NAMES[stream.update(*given)]
            assert status in {
                *FOUND,
                "UNREACHABLE",
                "NOT_CONVERGED",
                "RESULT_NOT_FINITE",
                "NOT_STARTED",
            }
            if status in FOUND:
                assert all(np.isfinite(x).all() for x in stream.results().values())
            if status in {"NOT_CONVERGED", "RESULT_NOT_FINITE"}:
                assert NAMES[stream.update(*given)] == "NOT_STARTED"
            if status == "UNREACHABLE":  # refused
                assert NAMES[stream.update(*sample(one, 0))] != "NOT_STARTED"


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow", "four_mass"])
def test_invalid_limits_are_refused(made, name):
    """Invalid bounds are refused; bounds that cannot be kept are exceeded, and the status reports
    it.
    """
    rng = np.random.default_rng(SEED)
    one = made(name)
    n = one.sizes["n_m"]
    endless = np.full(n, np.inf)
    assert (
        NAMES[Streamed(one, INTERVALS, PARTS, fill=1.0).limits(endless, endless)] == "NOT_STARTED"
    )
    stream = begun(one)
    for bad in (np.nan, 0.0, -1.0, -np.inf):
        for k in range(2):
            both = [endless.copy(), endless.copy()]
            both[k][rng.integers(n)] = bad
            before = stream.memory.tobytes()
            assert (
                NAMES[stream.limits(*both)] == "BAD_ARGUMENT" and stream.memory.tobytes() == before
            )
            both[k] = None
            assert (
                NAMES[stream.limits(*both)] == "NULL_ARGUMENT"
                and stream.memory.tobytes() == before
            )
    for bad in (np.nan, 0.0, -1.0, np.inf):
        assert NAMES[stream.limits(endless, endless, bad)] == "BAD_ARGUMENT"
    for size in (1e-300, 1e-9, 1e-3, 1.0, 10.0, 1e3, 1e300, np.inf):
        stream = begun(one)
        assert stream.limits(size * np.ones(n), 10.0 * size * np.ones(n)) == 0
        for k in range(1, 25):
            status = stream.update(*sample(one, k))
            assert not stream.spilled
            assert status >= 0 or NAMES[status] in LOST or k > 1
            if status < 0:
                break
            results = stream.results()
            assert all(np.isfinite(x).all() for x in results.values())
            kept = max(
                np.abs(results["tau_m"]).max() / size, np.abs(results["v_m"]).max() / (10.0 * size)
            )
            assert status > 0 or kept <= 1.0, (size, k, kept)


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow", "four_mass"])
def test_invalid_limits_of_all_kinds_are_refused(made, name):
    """No memory changes where one is refused; without any, and with infinite ones, a stream has
    the same bits.
    """
    rng = np.random.default_rng(SEED)
    one = made(name)
    sizes = one.sizes | {"n_e": one.equations.model.n_e}
    arrays = {key: np.full(sizes[size], np.inf) for key, size in SIZES.items() if sizes[size]}
    assert NAMES[Streamed(one, INTERVALS, PARTS, fill=1.0).all_limits(**arrays)] == "NOT_STARTED"
    stream = begun(one)
    plain = begun(one)
    curve = np.tile([[0.0, 1e3], [1e3, 5e2], [2e3, -1e3]], (sizes["n_m"], 1, 1))
    good = arrays | {"torque_speed": curve, "torque_speed_points": 3}
    assert stream.all_limits(**good) == 0
    before = stream.memory.tobytes()
    for bad in (np.nan, 0.0, -1.0, -np.inf):
        for key in arrays:
            wrong = arrays[key].copy()
            wrong[rng.integers(len(wrong))] = bad
            assert NAMES[stream.all_limits(**(good | {key: wrong}))] == "BAD_ARGUMENT", key
        assert NAMES[stream.all_limits(**good, tool_speed_max=bad or -1e-9)] == "BAD_ARGUMENT"
        assert (
            NAMES[stream.all_limits(**good, tool_acceleration_max=bad or -1e-9)] == "BAD_ARGUMENT"
        )
        assert NAMES[stream.all_limits(bad, **good)] == "BAD_ARGUMENT"
        for at in ((0, 0, 1), (0, 1, 1), (0, 2, 0)):
            wrong = curve.copy()
            wrong[at] = bad if np.isnan(bad) or at[1] != 1 else np.inf
            assert (
                NAMES[stream.all_limits(**(good | {"torque_speed": wrong}))] == "BAD_ARGUMENT"
            ), at
    for points in (-1, 0, 1, 22, 2**31 - 1):
        assert (
            NAMES[stream.all_limits(**(good | {"torque_speed_points": points}))] == "BAD_ARGUMENT"
        )
    assert stream.memory.tobytes() == before
    assert (
        stream.all_limits(**arrays)
        == stream.all_limits()
        == plain.limits(*[np.full(sizes["n_m"], np.inf)] * 2)
        == 0
    )
    for k in range(1, 25):
        given = sample(one, k)
        assert stream.update(*given) == plain.update(*given) and not stream.spilled
        assert all(np.array_equal(x, plain.results()[key]) for key, x in stream.results().items())
    for size in (1e-300, 1e-9, 1e-3, 1.0, 10.0, 1e3, 1e300):
        stream = begun(one)
        assert (
            stream.all_limits(
                **{key: size * np.ones(len(x)) for key, x in arrays.items()}, tool_speed_max=size
            )
            == 0
        )
        for k in range(1, 25):
            status = stream.update(*sample(one, k))
            assert not stream.spilled
            assert status >= 0 or NAMES[status] in {*LOST, "LIMITS_INFEASIBLE"}
            if status < 0:
                break
            assert all(np.isfinite(x).all() for x in stream.results().values())


# --- from Python ---------------------------------------------------------------------------------
def test_errors_in_python_are_messages_with_given_and_expected(made):
    one = made("elbow")
    given = {**one.path, "period": one.period}
    for changes, error, words in (
        ({"y": 100 * given["y"]}, SolverError, "leaves the workspace"),
        ({"dy": given["dy"] + 1.0}, ArgumentError, "begin and end at zero velocity"),
        ({"period": 0.0}, ArgumentError, "a size, a time"),
        ({"q_start": given["q_start"] * np.nan}, ArgumentError, "not finite"),
    ):
        with pytest.raises(error, match=words):
            one.library.invert(**{**given, **changes})


@pytest.mark.parametrize(
    "move",
    [{"displacement": (5.0, 0.0, 0.0)}, {"duration": 1e-6}, {"duration": 1e-3}, {"smoothness": 0}],
)
def test_invalid_moves_end_with_a_message_or_a_correct_status(made, move):
    model = read("planar5_nmp")
    try:
        changed = replace(model.move("line"), **move)
        solution = solve(model, changed, "lq")
    except FlexgenError as error:
        assert len(str(error)) > 30 and str(error)[-1] not in "\n"
    else:
        assert solution.status in (Status.SOLVED, Status.TOLERANCE_NOT_MET)
        assert solution.status == Status.TOLERANCE_NOT_MET or solution.tool_error_max_m <= 1e-5
