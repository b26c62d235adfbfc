"""Gears with hysteresis in the emitted C: whole paths and streams against the stage in Python; planted errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hysteretic import ARCMIN, hysteretic
from toolchain import needs_compiler

import flexgen
from flexgen.codegen import clib_files
from flexgen.errors import ArgumentError, SolverError
from flexgen.inversion.memory import with_hysteresis
from flexgen.inversion.motor_side import MotorMotion
from flexgen.inversion.sampling import from_library
from flexgen.library.generate import generate_parts
from flexgen.library.model_library import library_with
from flexgen.mechanics.hysteresis import without_hysteresis
from flexgen.mechanics.signatures import INVERSION
from flexgen.runtime.library import Library
from flexgen.runtime.path_inversion import Inverter

pytestmark = needs_compiler
GEARS = {"q1": "element.upper.dof.q1.gear", "q2": "element.fore.dof.q2.gear"}
CUBIC = {"type": "cubic", "stiffness": 1e5, "cubic": 4e10}
SAME = 1e-9  # relative: second differences of rounded deflections
HORIZON = 20  # intervals of a stream


def functions_of(model: flexgen.RobotModel) -> list[str]:
    return [name for name in INVERSION if name != "inversion_jacobians" or model.n_e]


def library_of(model: flexgen.RobotModel) -> Library:
    return library_with(model, functions_of(model), ("invert", "stream"))


def path_of(model: flexgen.RobotModel, period: float, still: int = 0) -> tuple[Any, list[np.ndarray]]:
    """A move and samples of its output with two derivatives, between ``still`` ones at rest."""
    move = flexgen.plan(model)
    t = np.clip((np.arange(round(move.duration / period) + 1 + 2 * still) - still) * period, 0.0, move.duration)
    y, dy, ddy = (np.ascontiguousarray(x) for x in move.sample(t).y.transpose(2, 0, 1)[:3])
    inside = ((t > 0.0) & (t < move.duration))[:, None]
    return move, [y, dy * inside, ddy * inside]


def by_the_stage(model: flexgen.RobotModel, samples: list[np.ndarray], **options: Any) -> MotorMotion:
    """The motors behind the motion of the arm without hysteresis, which the C gives, by the stage in Python."""
    found = library_of(without_hysteresis(model)).invert(*samples, **options)
    return with_hysteresis(flexgen.derive(model), from_library(found)).motors


def difference(one: Any, other: Any, leave: int = 8) -> float:
    """Largest relative difference of the motors' motion and torques, but for the last samples, held differently."""
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("q_m", "v_m", "tau_m")]
    return max(float(np.abs(a - b)[:-leave].max() / np.abs(b).max()) for a, b in pairs)


def elbow(kind: str) -> flexgen.RobotModel:
    """Gears with damping, without, with so much that their time constant is many samples, or a stiffening spring."""
    made: dict[str, Any] = {
        "undamped": {f"{gear}.damping": 0.0 for gear in GEARS.values()},
        "slow": {f"{gear}.damping": 9e3 for gear in GEARS.values()},
        "mixed": {f"{GEARS['q1']}.damping": 0.0},
    }.get(kind, {})
    model = hysteretic("elbow", **made)
    if kind == "cubic":
        table = {"lost_motion": ARCMIN, "stiffness": 1e5}
        changed = {f"{gear}.hysteresis": table for gear in GEARS.values()} | {f"{GEARS['q1']}.spring": CUBIC}
        return flexgen.read("elbow", overrides=changed)
    if kind == "one":
        return flexgen.read("elbow", overrides={f"{GEARS['q2']}.hysteresis": {"lost_motion": ARCMIN, "stiffness": 1e5}})
    return model


@pytest.mark.parametrize(
    "kind",
    ["undamped", *(pytest.param(x, marks=pytest.mark.slow) for x in ("damped", "slow", "mixed", "cubic", "one"))],
)
def test_whole_paths_are_those_of_the_stage(kind: str) -> None:
    model = elbow(kind)
    move, samples = path_of(model, 1e-3)
    options = {"period": 1e-3, "q_start": move.q_start, "n_post": 100}
    found = library_of(model).invert(*samples, **options)
    assert found.converged
    assert difference(found, by_the_stage(model, samples, **options)) < SAME


def inverted(model: flexgen.RobotModel, monkeypatch: pytest.MonkeyPatch) -> tuple[flexgen.Solution, Any, dict]:
    """The solution with the motors in Python, and how `solve` calls the C for the arm."""
    calls, own = [], Inverter.__call__
    with monkeypatch.context() as patch:
        patch.setattr(
            Inverter, "__call__", lambda self, *x, **named: (calls.append((x, named)), own(self, *x, **named))[1]
        )
        solution = flexgen.solve(model, verify=False, progress=False)
    return solution, *calls[-1]


@pytest.mark.parametrize("name", ["planar5_nmp", pytest.param("manutec_r3_18", marks=pytest.mark.slow)])
def test_elastic_arms_are_those_of_the_stage_and_stay_on_their_path(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool by the simulation, which integrates z itself: 0.05 um, of some 400 um without hysteresis."""
    model = hysteretic(name)
    solution, samples, options = inverted(model, monkeypatch)
    found = library_of(model).invert(*samples, **options)
    assert found.converged and difference(found, by_the_stage(model, samples, **options)) < SAME
    path, n = solution.trajectory, len(solution.trajectory.time)
    channels = dict(path.channels) | {key: getattr(found, key)[:n] for key in ("q_m", "v_m", "tau_m")}
    by_c = flexgen.Trajectory(path.time, channels, path.ports, path.labels, path.meta)
    assert flexgen.simulate(model, by_c, feedback="ppi").tool_error_max_m < 5e-8


def streamed(library: Library, samples: list[np.ndarray], q_start: np.ndarray, period: float) -> np.ndarray:
    """Motor torques of a stream at the samples."""
    y, dy, ddy = samples
    stream = library.stream(y[0], q_start, period=period, intervals=HORIZON)
    found = [stream.update(y[k], dy[k], ddy[k]) for k in range(1, len(y))]
    assert all(each.converged for each in found[HORIZON:])
    return np.concatenate([each.tau_m for each in found])[HORIZON - 1 :]


def stream_errors(model: flexgen.RobotModel, library: Library) -> float:
    """Largest difference of the torques of a stream to those of the whole path, relative."""
    move, samples = path_of(model, 1e-3, still=2 * HORIZON)
    whole = library.invert(*samples, period=1e-3, q_start=move.q_start).tau_m
    torques = streamed(library, samples, move.q_start, 1e-3)
    return float(np.abs(torques - whole[: len(torques)]).max() / np.abs(whole).max())


@pytest.mark.parametrize("kind", ["undamped", pytest.param("damped", marks=pytest.mark.slow)])
def test_streams_are_whole_paths(kind: str) -> None:
    """Whatever they carry from update to update."""
    model = elbow(kind)
    assert stream_errors(model, library_of(model)) < 1e-8


@pytest.mark.parametrize("intervals", [4, 24])
def test_torques_that_are_not_smooth_do_not_end_a_stream(intervals: int) -> None:
    """A horizon that is too short, and held torques beyond it: several reversals between two samples."""
    model = elbow("undamped" if intervals == 4 else "damped")
    move, (y, dy, ddy) = path_of(model, 5e-3, still=intervals)
    stream = library_of(model).stream(
        y[0], move.q_start, period=5e-3, intervals=intervals, samples_per_interval=2, hold="zoh", delay=3.5
    )
    for k in range(1, len(y)):
        assert np.isfinite(stream.update(y[k], dy[k] * (-1.0) ** k, ddy[k] * (-1.0) ** k).tau_m).all()


# --- planted errors ---------------------------------------------------------------------------------------------------

PLANTED = {
    "sign of z": ("store_v(value[k] + i, K * x + z);", "store_v(value[k] + i, K * x - z);"),
    "no reversal": ("store_v(b->s + i, select_v(is, -s, s));", "store_v(b->s + i, s);"),
    "z not carried": ("    copy(b->z_r, NG, x + 2 * NG);\n", ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("bug", PLANTED)
def test_planted_errors_of_the_c_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bug: str) -> None:
    old, new = PLANTED[bug]
    texts = dict(clib_files.read_clib())
    assert texts["hysteresis.h"].count(old) == 1
    texts["hysteresis.h"] = texts["hysteresis.h"].replace(old, new)
    monkeypatch.setattr(clib_files, "read_clib", lambda: texts)
    model = elbow("damped")
    made = generate_parts(model, tmp_path, functions_of(model), ("invert", "stream"), progress=lambda line: None)
    move, samples = path_of(model, 1e-3)
    with flexgen.load(made.directory) as library:
        if bug == "z not carried":
            assert stream_errors(model, library) > 1e-3
            return
        options = {"period": 1e-3, "q_start": move.q_start}
        try:
            found = library.invert(*samples, **options)
        except SolverError as error:
            assert "did not converge" in str(error)
        else:
            assert difference(found, by_the_stage(model, samples, **options)) > 1e-3


# --- what there is not ------------------------------------------------------------------------------------------------


def test_libraries_without_hysteresis_have_no_trace_of_it() -> None:
    for name, text in clib_files.read_clib().items():
        words = ("HYSTERESIS", "hysteretic", "branches(")
        assert name == "hysteresis.h" or not any(word in clib_files.render(text, "arm") for word in words)
    assert "hysteretic_rows" in clib_files.render(clib_files.read_clib()["whole_path.h"], "arm", parts=["HYSTERESIS"])


def test_limits_are_refused() -> None:
    library, (move, samples) = library_of(elbow("undamped")), path_of(elbow("undamped"), 1e-3)
    with pytest.raises(ArgumentError, match=r"without invert_limited, expected .* gears without hysteresis"):
        library.invert_limited(*samples, period=1e-3, q_start=move.q_start, torque=[1.0, 1.0])
    stream = library.stream(samples[0][0], move.q_start, period=1e-3, intervals=HORIZON)
    with pytest.raises(ArgumentError, match="stream: given limits, expected none where the model has hysteresis"):
        stream.limit(torque=[1.0, 1.0])
