"""Limits on a moving horizon: the quadratic program in C against OSQP, and a stream that bends its
path.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import osqp
import pytest
import scipy.sparse as sp
from bristled import bristled, tables
from clib_sections import section
from clib_shim import SHIM
from emitted import _folder, paths_library
from gear_friction import loaded
from harmonic import harmonic
from hysteretic import hysteretic
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import Port
from flexgen.codegen.build import model_library as built
from flexgen.codegen.build.compiler import find_compiler
from flexgen.codegen.emission import clib_files
from flexgen.dynamics.mechanics.output_columns import output_labels
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.paths.path import Path
from flexgen.runtime.inversion.limited_inversion import OF_TOOL, SIZES
from flexgen.runtime.library import Library
from flexgen.runtime.streams.stream import Interval
from flexgen.simulation.simulate import simulate

pytestmark = needs_compiler

CLOSE = 1e-4  # of z, after as many steps as it takes; OSQP's own tolerance is finer
STEPS = 4000
# of the stream
PERIOD = 5e-3
AHEAD = 20
GONE = 1e-4  # m: a deviation that fades, two horizons after the path has ended
SIX_AXES = [
    pytest.param("manutec_r3_18", 0, 20, id="18, line, 100 ms"),
    pytest.param("manutec_r3_18", 1, 30, id="18, joints, 150 ms"),
    pytest.param("manutec_r3_24", 0, 40, id="24, line, 200 ms"),
    pytest.param("manutec_r3_24", 3, 40, id="24, circle, 200 ms", marks=pytest.mark.slow),
]
# m: of the simulated tool; a thousandth of a deviation may act on the current motion
FOLLOWED = 2e-6

CALL = """\
#include "model_qp.h"
int run(int n, int rows, real *H, real *g, real *A, real *x, real *y, real *z, real *K, real *w, \
real *v, real *b,
    real price, int steps)
{
    qp p = {n, rows, H, g, A, x, y, z, K, w, v, b, 0.0};
    return run_qp(&p, price, steps);
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., np.ndarray]:
    """The program in C, compiled by itself."""
    folder: FilePath = tmp_path_factory.mktemp("program")
    (folder / "model_inversion_common.h").write_text(SHIM)
    qp = section("limits.h", "A small quadratic program")
    (folder / "model_qp.h").write_text(f'#include "model_inversion_common.h"\n{qp}')
    (folder / "call.c").write_text(CALL)
    compiler = find_compiler()
    assert compiler is not None
    command = [
        *compiler.command,
        "-std=c99",
        "-O2",
        "-shared",
        "-fPIC",
        "call.c",
        "-lm",
        "-o",
        "call.so",
    ]
    subprocess.run(command, cwd=folder, check=True)
    run = ctypes.CDLL(str(folder / "call.so")).run

    def solved(
        H: np.ndarray, g: np.ndarray, A: np.ndarray, x: np.ndarray, price: float
    ) -> np.ndarray:
        rows, n = A.shape
        sizes = [(n, n), n, (rows, n), rows, rows, n, (n, n), rows, rows, n]
        given = [H, g, A, x]
        memory = [np.array(given[i]) if i < 4 else np.zeros(size) for i, size in enumerate(sizes)]
        pointers = [ctypes.c_void_p(m.ctypes.data) for m in memory]
        assert run(n, rows, *pointers, ctypes.c_double(price), STEPS) == 1
        return memory[5]

    return solved


def problem(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A random program that zero does not solve, H with condition 100 or so."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 30))
    rows = int(rng.integers(5, 60))
    B = rng.normal(size=(n, n))
    A = 0.6 * rng.normal(size=(rows, n)) / np.sqrt(n)
    return B @ B.T / n + 0.1 * np.eye(n), 3 * rng.normal(size=n), A, rng.uniform(-0.9, 0.9, rows)


@pytest.mark.parametrize("seed", range(6))
def test_the_program_in_c_finds_what_osqp_finds(
    program: Callable[..., np.ndarray], seed: int
) -> None:
    H, g, A, x = problem(seed)
    solver = osqp.OSQP()
    solver.setup(
        sp.csc_matrix(np.triu(H)), g, sp.csc_matrix(A), -1 - x, 1 - x,
        verbose=False, eps_abs=1e-9, eps_rel=1e-9, max_iter=100_000,
    )  # fmt: skip
    expected = solver.solve(raise_error=True).x
    free = np.linalg.solve(H, -g)
    assert np.abs(x + A @ free).max() > 1.1  # the bounds matter
    assert np.abs(program(H, g, A, x, 1e4) - expected).max() < CLOSE * (1 + np.abs(expected).max())
    # a planted bug: a price that is too low buys violations
    assert np.abs(program(H, g, A, x, 1e-3) - expected).max() > CLOSE * (
        1 + np.abs(expected).max()
    )


def test_a_program_without_solution_passes_its_bounds_alike(
    program: Callable[..., np.ndarray],
) -> None:
    # z <= -1 and z >= 1 at once: any z between costs the same in bounds, so that the cost decides
    z = program(np.eye(1), np.array([-0.25]), np.array([[1.0], [1.0]]), np.array([2.0, -2.0]), 1e3)
    assert z[0] == pytest.approx(0.25, abs=CLOSE)


def streamed(
    model: str = "planar5_nmp", move: int = 0, ahead: int = AHEAD, **limits: Any
) -> list[Interval]:
    """A move on a moving horizon."""
    equations = flexgen.derive(model)
    path = Path(equations, equations.model.moves[move])
    y, dy, ddy = given(model, move, ahead)
    library = paths_library(equations, "invert", "stream")
    stream = library.stream(
        y[0], path.q_start, period=PERIOD, intervals=ahead, samples_per_interval=5
    )
    if limits:
        stream.limit(**limits)
    return [stream.update(*x) for x in zip(y, dy, ddy, strict=True)]


def given(model: str, move: int, ahead: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples of a move, and of rest after it."""
    equations = flexgen.derive(model)
    path = Path(equations, equations.model.moves[move])
    return samples(Reduction(equations), path, PERIOD, int(path.duration / PERIOD) + 3 * ahead)


def test_a_stream_keeps_torque_limits_and_returns_to_its_path() -> None:
    free = streamed()
    kept = streamed(torque=(22.0, 22.0))
    worst = [max(float(np.abs(x.tau_m).max()) for x in run) for run in (free, kept)]
    assert worst[0] > 24.0 and worst[1] < 22.0 * 1.01
    off = np.array([x.deviation_m for x in kept])
    assert 5e-4 < off.max() < 1e-2 and off[-1] < GONE
    assert strays("planar5_nmp", kept) < FOLLOWED
    assert (
        any(x.limits_active for x in kept)
        and not kept[0].limits_active
        and not any(x.limits_active for x in free)
    )


def a_tenth_less(free: list[Interval]) -> tuple[float, ...]:
    """Bounds that take a tenth away from what motion adds to the torques that hold the arm."""
    most = np.max([np.abs(x.tau_m).max(axis=0) for x in free], axis=0)
    held = np.max([np.abs(x.tau_m[0]) for x in (free[0], free[-1])], axis=0)
    bound = np.maximum(1.05 * held, held + 0.9 * (most - held))
    assert (most / bound > 1.02).sum() >= min(4, len(most))
    return tuple(bound)


def strays(model: str | flexgen.RobotModel, intervals: list[Interval]) -> float:
    """Largest distance between the tool of the simulated machine and the planned one [m]."""
    equations = flexgen.derive(model)
    robot = equations.model
    channels = {
        key: np.concatenate([getattr(x, key) for x in intervals])
        for key in ("tau_m", "q_m", "q_a")
    }
    y = evaluate(equations.function("output"), channels["q_a"])[0].reshape(
        len(channels["q_a"]), -1
    )
    channels["y_ref"] = y[:, : len(output_labels(robot)["y_ref"])]
    if "R_ref" in output_labels(robot):
        channels["R_ref"] = evaluate(equations.function("forward_kinematics"), channels["q_a"])[
            1
        ].reshape(-1, 9)
    arm = tuple(c.name for c in robot.coordinates)
    motors = tuple(m.name for m in robot.motors)
    labels = {"tau_m": motors, "q_m": motors, "q_a": arm, **output_labels(robot)}
    units = {"tau_m": "N m", "q_m": "rad", "q_a": "rad or m", "y_ref": "m", "R_ref": "-"}
    ports = {key: Port(key, (x.shape[1],), units[key], key) for key, x in channels.items()}
    t = np.arange(len(channels["tau_m"])) * PERIOD / len(intervals[0].tau_m)
    return (
        simulate(
            equations, Trajectory(t, channels, ports, labels, {"model": robot.name})
        ).tool_error_max_m
        or 0.0
    )


@pytest.mark.slow
@pytest.mark.parametrize(("model", "move", "ahead"), SIX_AXES)
def test_six_axes_keep_torque_limits_that_bind_in_all_motors(
    model: str, move: int, ahead: int
) -> None:
    bound = a_tenth_less(streamed(model, move, ahead))
    kept = streamed(model, move, ahead, torque=bound)
    assert max(float((np.abs(x.tau_m) / bound).max()) for x in kept) < 1.03
    off = np.array([x.deviation_m for x in kept])
    assert 1e-3 < off.max() < 0.03 and off[-1] < 0.5 * off.max()  # it fades in horizons
    assert all(x.converged for x in kept)
    assert strays(model, kept) < FOLLOWED
    # what is told to be off is where the planned motion is
    output = flexgen.derive(model).function("output")
    y = evaluate(output, np.array([x.q_a[0] for x in kept[ahead:]]))[0].reshape(
        len(kept) - ahead, -1
    )
    away = np.linalg.norm(y[:, :3] - given(model, move, ahead)[0][: len(y), :3], axis=1)
    # at either end of the interval
    assert np.abs(np.maximum(away[:-1], away[1:]) - off[ahead:-1]).max() < 1e-6


@pytest.mark.slow
def test_bends_that_come_too_soon_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planted bug: the path is bent right ahead, where zeros ask the motion that is under way to
    have known.
    """
    texts = clib_files.read_clib()
    wrong = texts["stream_update.h"].replace("preview_share = 1e-3;", "preview_share = 1e9;")
    assert wrong != texts["stream_update.h"]
    monkeypatch.setattr(clib_files, "read_clib", lambda: {**texts, "stream_update.h": wrong})
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    built.library_holder.cache_clear()
    try:
        free = streamed("manutec_r3_18")
        kept = streamed("manutec_r3_18", torque=a_tenth_less(free))
    finally:
        built.library_holder.cache_clear()
    assert all(x.converged for x in free) and not all(x.converged for x in kept)
    assert strays("manutec_r3_18", kept) > 100 * FOLLOWED


@pytest.mark.parametrize(
    ("name", "ahead", "torque"), [("planar5_nmp", 3, 22.0), ("manutec_r3_24", 15, 1.0)]
)
def test_a_horizon_that_the_zeros_fill_is_refused(name: str, ahead: int, torque: float) -> None:
    with pytest.raises(ArgumentError, match="horizon is too short to keep limits"):
        streamed(name, ahead=ahead, torque=(torque,) * flexgen.derive(name).model.n_m)


def test_limits_that_cannot_be_kept_end_the_stream_in_words() -> None:
    with pytest.raises(SolverError, match="limits cannot be kept"):
        streamed(torque=(0.5, 0.5))


def test_a_stream_keeps_speed_limits() -> None:
    kept = streamed(speed=(1000.0, 250.0))
    assert max(float(np.abs(x.v_m[:, 1]).max()) for x in kept) < 250.0 * 1.01
    assert kept[-1].deviation_m < GONE


def test_wide_limits_change_nothing_in_a_stream() -> None:
    free = streamed()
    wide = streamed(torque=(100.0, 100.0))
    assert all(np.array_equal(a.tau_m, b.tau_m) for a, b in zip(free, wide, strict=True))


def test_wrong_limits_of_a_stream_are_refused() -> None:
    for bad in (
        {"torque": (0.0, 1.0)},
        {"speed": (np.nan, 1.0)},
        {"torque": (1.0,)},
        {"deviation": -1.0},
    ):
        with pytest.raises(ArgumentError):
            streamed(**bad)


# --- all limits ----------------------------------------------------------------------------------
@cache
def with_all_limits(model: str, force: bool = False) -> Library:
    folder = _folder() / f"{model}_all_limits{'_planted' * force}"
    return flexgen.load(flexgen.generate(model, folder, parts=["limits"], force=force).directory)


def bounded(model: str, ahead: int = 30, force: bool = False, **limits: Any) -> list[Interval]:
    """A move on a moving horizon, within limits of all kinds, and the rest after it."""
    equations = flexgen.derive(model)
    path = Path(equations, equations.model.moves[0])
    y, dy, ddy = given(model, 0, ahead)
    stream = with_all_limits(model, force).stream(
        y[0], path.q_start, period=PERIOD, intervals=ahead, samples_per_interval=5
    )
    if limits:
        stream.limit_all(**limits)
    return [stream.update(*x) for x in zip(y, dy, ddy, strict=True)]


def largest_uses(model: str, run: list[Interval]) -> dict[str, np.ndarray]:
    """The largest values of all limited quantities at the ends of the intervals, by differences
    and the Jacobian.
    """
    equations = flexgen.derive(model)
    robot = equations.model
    n = len(run[0].tau_m)
    tau, v_m, tau_g, q, v = (
        np.concatenate([getattr(x, key) for x in run])[::n]
        for key in ("tau_m", "v_m", "tau_g", "q_a", "v_a")
    )
    joints = v[:, list(robot.i_g)]
    jacobian = evaluate(equations.function("jacobian"), q)[0].reshape(len(q), 6, -1)[:, :3]
    tool = np.einsum("nij,nj->ni", jacobian, v)
    friction = np.array(
        [evaluate(equations.function("motor_friction"), x)[0] for x in v_m]
    ).reshape(len(v_m), -1)
    signals = {
        "torque_max": tau,
        "speed_max": v_m,
        "torque_rate_max": np.diff(tau - friction, axis=0) / PERIOD,
        "gear_torque_max": tau_g,
        "deflection_max": q[:, list(robot.i_e)],
        "joint_speed_max": joints,
        "joint_acceleration_max": np.diff(joints, axis=0) / PERIOD,
        "tool_speed_max": np.linalg.norm(tool, axis=1)[:, None],
        "tool_acceleration_max": np.linalg.norm(np.diff(tool, axis=0), axis=1)[:, None] / PERIOD,
    }
    return {key: np.abs(x).max(axis=0) for key, x in signals.items()}


def a_little_less(model: str) -> dict[str, np.ndarray]:
    """Limits of all kinds that take a tenth away from what motion adds to the values at rest."""
    free = bounded(model)
    most = largest_uses(model, free)
    still = largest_uses(model, free[:1] * 2)
    return {
        key: np.maximum(1.02 * still[key], still[key] + 0.9 * (x - still[key]))
        for key, x in most.items()
    }


KEPT_IN_STREAMS = 4e-3  # relative: largest excess at the ends of the intervals


@pytest.mark.parametrize("kind", sorted({*SIZES, *OF_TOOL}))
def test_a_stream_keeps_a_limit_of_each_kind(kind: str) -> None:
    model = "planar5_nmp"
    limit = a_little_less(model)[kind]
    free = largest_uses(model, bounded(model))[kind]
    kept = bounded(model, **{kind: float(limit[0]) if kind in OF_TOOL else limit})
    assert (free / limit).max() > 1.01
    assert (largest_uses(model, kept)[kind] / limit).max() < 1.0 + KEPT_IN_STREAMS
    off = np.array([x.deviation_m for x in kept])
    assert 1e-4 < off.max() < 0.04 and off[-1] < 0.05 * off.max()
    assert any(x.limits_active for x in kept) and not any(x.limits_active for x in bounded(model))
    assert strays(model, kept) < FOLLOWED


def test_a_stream_keeps_the_torque_speed_curves_of_motors() -> None:
    model = "planar5_nmp"
    curves = [[(0.0, 27.0), (100.0, 21.0), (300.0, 5.0)], ()]
    free = bounded(model)
    kept = bounded(model, torque_speed=curves)

    def use(run: list[Interval]) -> float:
        tau, v = (
            np.abs(np.concatenate([getattr(x, key)[:1, 0] for x in run]))
            for key in ("tau_m", "v_m")
        )
        return float((tau / np.interp(v, *np.array(curves[0]).T)).max())

    assert use(free) > 1.03 and use(kept) < 1.0 + KEPT_IN_STREAMS
    # a planted bug: the torque at rest is allowed at each speed
    assert use(bounded(model, torque_max=[27.0, np.inf])) > 1.03
    end = [[(0.0, 1e3), (150.0, 999.0)], ()]  # the speed ends with the curve
    assert max(np.abs(x.v_m[:, 0]).max() for x in bounded(model, torque_speed=end)) < 150.0 * (
        1.0 + KEPT_IN_STREAMS
    )


@pytest.mark.slow
def test_a_limit_of_gears_does_not_follow_from_a_wrong_jacobian(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A planted bug: torques of gears do not depend on the acceleration of the path."""
    texts = clib_files.read_clib()
    wrong = texts["limits.h"].replace("f->F[i][j] = F[i][j];", "f->F[i][j] = 0.0;")
    assert wrong != texts["limits.h"]
    limit = a_little_less("planar5_nmp")["gear_torque_max"]
    monkeypatch.setattr(clib_files, "read_clib", lambda: {**texts, "limits.h": wrong})
    with pytest.raises(SolverError, match="the limits cannot be kept"):
        bounded("planar5_nmp", force=True, gear_torque_max=limit)


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({*SIZES, *OF_TOOL}))
def test_six_axes_keep_a_limit_of_each_kind(kind: str) -> None:
    model = "manutec_r3_18"
    limit = a_little_less(model)[kind]
    kept = bounded(model, **{kind: float(limit[0]) if kind in OF_TOOL else limit})
    assert (largest_uses(model, kept)[kind] / limit).max() < 1.0 + KEPT_IN_STREAMS
    assert max(x.deviation_m for x in kept) < 0.02 and strays(model, kept) < FOLLOWED


def test_limits_of_a_stream_that_it_cannot_have() -> None:
    equations = flexgen.derive("planar5_nmp")
    path = Path(equations, equations.model.moves[0])
    y = given("planar5_nmp", 0, 30)[0][0]
    plain = paths_library(equations, "invert", "stream").stream(
        y, path.q_start, period=PERIOD, intervals=30
    )
    with pytest.raises(
        ArgumentError, match=r"has no part limits; generate it with parts=\[\"limits\"\]"
    ):
        plain.limit_all(torque_max=[1.0, 1.0])
    stream = with_all_limits("planar5_nmp").stream(y, path.q_start, period=PERIOD, intervals=30)
    with pytest.raises(
        ArgumentError, match="stream: given the limit 'gear_torque', expected some of torque_max, "
    ):
        stream.limit_all(gear_torque=[1.0, 1.0])
    with pytest.raises(
        ArgumentError,
        match=r"stream, gear_torque_max: given \[ 1. -1.\], expected positive numbers",
    ):
        stream.limit_all(gear_torque_max=[1.0, -1.0])
    many = [(float(k), 100.0 - 0.1 * k * k) for k in range(22)]
    stream.limit_all(torque_speed=[many[:-1], ()])  # twenty edges
    with pytest.raises(ArgumentError, match="out of range"):
        stream.limit_all(torque_speed=[many, ()])
    short = with_all_limits("planar5_nmp").stream(y, path.q_start, period=PERIOD, intervals=3)
    with pytest.raises(ArgumentError, match="horizon is too short"):
        short.limit_all(gear_torque_max=[1.0, 1.0])


# --- drives with memory, and with Fourier sums of the motor angles -------------------------------
DRIVES: dict[str, Callable[[str], flexgen.RobotModel]] = {
    "hysteresis": hysteretic,
    "lugre": lambda name: bristled(name, tables(name)),
    "load": loaded,
    "sums": lambda name: harmonic(name, 0.3),
}
# m: as FOLLOWED, where jumps in the high derivatives of the modified path act on bristles
BENT = 5e-6
OF_DRIVES = [
    pytest.param(name, drive, marks=[pytest.mark.slow] * (name != "elbow"))
    for name in ("elbow", "planar5_nmp", "manutec_r3_18")
    for drive in DRIVES
]


@cache
def driven(name: str, drive: str) -> tuple[flexgen.RobotModel, Library]:
    robot = DRIVES[drive](name)
    folder = flexgen.generate(robot, _folder() / f"{name}_{drive}", parts=["limits"]).directory
    return robot, flexgen.load(folder)


def kept_by_drives(
    name: str, drive: str, library: Library | None = None, **limits: Any
) -> list[Interval]:
    """The first move on a moving horizon."""
    robot, own = driven(name, drive)
    y, dy, ddy = given(name, 0, 30)
    start = Path(flexgen.derive(name), robot.moves[0]).q_start
    stream = (library or own).stream(
        y[0], start, period=PERIOD, intervals=30, samples_per_interval=5
    )
    if limits:
        stream.limit_all(**limits)
    return [stream.update(*x) for x in zip(y, dy, ddy, strict=True)]


def largest_of(run: list[Interval]) -> dict[str, np.ndarray]:
    """The largest torques and speeds of the motors and torques of the gears at all samples."""
    names = {"torque_max": "tau_m", "speed_max": "v_m", "gear_torque_max": "tau_g"}
    return {
        key: np.abs(np.concatenate([getattr(x, name) for x in run])).max(axis=0)
        for key, name in names.items()
    }


@pytest.mark.parametrize(("name", "drive"), OF_DRIVES)
def test_streams_of_drives_with_memory_or_sums_keep_limits(name: str, drive: str) -> None:
    free = kept_by_drives(name, drive)
    most = largest_of(free)
    still = largest_of(free[:1])
    for key in most:
        limit = np.maximum(1.1 * still[key], still[key] + 0.9 * (most[key] - still[key]))
        run = kept_by_drives(name, drive, **{key: limit})
        assert (most[key] / limit).max() > 1.01
        assert (largest_of(run)[key] / limit).max() < 1.01  # between the ends of the intervals too
        assert all(x.converged for x in run) and any(x.limits_active for x in run)
        assert strays(driven(name, drive)[0], run) < (BENT if drive == "lugre" else FOLLOWED)


PLANTED = {
    "lugre": "tau_m[i] += sliding_torque(i, v_m[i]);",  # limits know nothing of the bristles
    "sums": "most[1] * speed[j] * speed[j]",  # nor that transmission errors accelerate the rotor
}


@pytest.mark.slow
@pytest.mark.parametrize("drive", PLANTED)
def test_a_limit_that_ignores_the_drive_is_exceeded(
    drive: str, monkeypatch: pytest.MonkeyPatch, tmp_path: FilePath
) -> None:
    texts = clib_files.read_clib()
    wrong = texts["limits.h"].replace(PLANTED[drive], ";" if drive == "lugre" else "0.0")
    assert wrong != texts["limits.h"]
    monkeypatch.setattr(clib_files, "read_clib", lambda: {**texts, "limits.h": wrong})
    robot, _ = driven("elbow", drive)
    library = flexgen.load(
        flexgen.generate(robot, tmp_path, parts=["limits"], force=True).directory
    )
    free = kept_by_drives("elbow", drive)
    most = largest_of(free)["torque_max"]
    still = largest_of(free[:1])["torque_max"]
    limit = np.maximum(1.1 * still, still + 0.9 * (most - still))
    run = kept_by_drives("elbow", drive, library, torque_max=limit)
    assert (largest_of(run)["torque_max"] / limit).max() > 1.01


@pytest.mark.slow
def test_swings_of_sums_follow_the_parameters(tmp_path: FilePath) -> None:
    """Cogging that grows at run time takes more of a torque limit."""
    robot = driven("elbow", "sums")[0]
    names = [f"m{j}.cogging_{part}_{k}" for j in (1, 2) for part in ("cos", "sin") for k in (2, 6)]
    made = flexgen.generate(robot, tmp_path, parts=["limits"], parameters=names)
    library = flexgen.load(made.directory)
    y, dy, ddy = given("elbow", 0, 30)
    start = Path(flexgen.derive("elbow"), robot.moves[0]).q_start
    free = largest_of(kept_by_drives("elbow", "sums"))["torque_max"]
    worst = []
    for factor in (1.0, 200.0):
        stream = library.stream(y[0], start, period=PERIOD, intervals=30, samples_per_interval=5)
        stream.limit_all(torque_max=1.25 * free)
        stream.set_parameters(factor * library.parameters)
        run = [stream.update(*x) for x in zip(y, dy, ddy, strict=True)]
        worst.append(max(x.deviation_m for x in run))
    assert worst[0] == 0.0 < 1e-4 < worst[1]


@pytest.mark.slow
def test_a_stream_that_exceeds_the_limit_of_a_rate_by_far_fails() -> None:
    """Torques of this motion jump: modifications cause one another."""
    model = "four_mass"
    failed = 0
    free = largest_uses(model, bounded(model))["torque_rate_max"]
    for share in (0.5, 0.3, 0.2):
        try:
            run = bounded(model, torque_rate_max=share * free)
        except SolverError as error:
            assert "the limits cannot be kept" in str(error)
            failed += 1
        else:  # at the ends of intervals that are not stated to be right
            assert not all(x.converged for x in run)
            assert (largest_uses(model, run)["torque_rate_max"] < 2.5 * share * free).all()
    assert failed
