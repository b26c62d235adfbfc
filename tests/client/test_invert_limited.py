"""Whole paths within limits by the emitted C: kept by the true torques, by the smallest deviation,
or refused.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from emitted import paths_library, run, sources
from hostile_client import SANITIZE, can_sanitize
from path_deviation import DEGREE, DeviationBasis, deviated_path
from toolchain import CC, needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.codegen.emission import clib_files
from flexgen.codegen.emission.path_header import path_header
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.paths.path import plan
from flexgen.runtime.inversion.path_inversion import Inversion
from flexgen.runtime.library import Library, load

pytestmark = needs_compiler
SUPPORT = Path(__file__).resolve().parents[1] / "support"
KEPT = 1e-3  # of a limit: what the C promises
# of the largest torque: the mesh of both inversions is the same, and so are the samples to 1e-9 m
SAME_TORQUE = 1e-6
NEAR = 0.1  # relative: method full weighs the deviation alike and smooths it differently


@dataclass(frozen=True)
class Case:
    """A path with time at rest before and after it, and the arguments of its inversion."""

    library: Library
    y: np.ndarray
    dy: np.ndarray
    ddy: np.ndarray
    options: dict

    def invert(self, **limits: object) -> Inversion:
        return self.library.invert_limited(self.y, self.dy, self.ddy, **self.options, **limits)


@cache
def case(name: str, move: str = "line", period: float = 1e-3) -> Case:
    equations = flexgen.derive(name)
    path = plan(equations, move)
    before = round(0.3 / period)
    after = round((0.3 + 0.5 * path.duration) / period)
    t = (np.arange(before + round(path.duration / period) + after + 1) - before) * period
    sample = path.sample(t)
    options = {
        "period": period,
        "q_start": path.q_start,
        "n_pre": 200,
        "n_post": 300,
        "samples_per_interval": 5,
    }
    return Case(
        paths_library(equations, "invert", "invert_limited"),
        Reduction(equations).targets(sample),
        sample.derivative(1),
        sample.derivative(2),
        options | {"knot_samples": max(round(path.duration / 30 / period), 10)},
    )


def free(one: Case) -> Inversion:
    options = {key: value for key, value in one.options.items() if key != "knot_samples"}
    return one.library.invert(one.y, one.dy, one.ddy, **options)


def modified(one: Case, found: Inversion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The path with the deviation, whose derivatives are those of scipy's splines through its
    samples.
    """
    spacing = one.options["knot_samples"]
    n = len(one.y)
    t = np.arange(n) * one.options["period"]
    count = (n - 1) // spacing - DEGREE
    basis = DeviationBasis(t, 0.0, spacing * one.options["period"], count)
    assert found.deviation is not None
    c, *_ = np.linalg.lstsq(basis.basis[0], found.deviation, rcond=None)
    assert np.abs(basis.along(c) - found.deviation).max() < 1e-12  # it is such a spline
    return deviated_path(
        one.y, one.dy, one.ddy, (basis.along(c), basis.along(c, 1), basis.along(c, 2))
    )


@pytest.mark.parametrize(
    ("name", "factor", "most"),
    [
        ("planar5_nmp", 0.9, 5e-2),
        ("planar5_nmp", 0.6, 5e-2),
        ("elbow", 0.85, 5e-2),
        ("elbow", 0.58, 8e-2),
        pytest.param("manutec_r3", 0.9, 5e-2, marks=pytest.mark.slow),
    ],
)
def test_torque_limits_are_kept_on_the_modified_path(
    name: str, factor: float, most: float
) -> None:
    """The torques are those of the modified path, inverted without limits: scipy's splines, the
    pose by rotations.
    """
    one = case(name)
    bound = factor * np.abs(free(one).tau_m).max(axis=0)
    # the arm rests at both ends
    bound = np.maximum(bound, 1.02 * np.abs(free(one).tau_m[[0, -1]]).max(axis=0))
    found = one.invert(torque_max=bound)
    assert found.limits_active and found.converged and found.programs >= 1
    assert (np.abs(found.tau_m).max(axis=0) <= bound * (1 + KEPT)).all()
    options = {key: value for key, value in one.options.items() if key != "knot_samples"}
    again = one.library.invert(*map(np.ascontiguousarray, modified(one, found)), **options)
    assert np.abs(again.tau_m - found.tau_m).max() <= SAME_TORQUE * np.abs(found.tau_m).max()
    assert found.deviation is not None
    n_p = 3 if one.y.shape[1] > one.dy.shape[1] else one.dy.shape[1]
    assert found.deviation_m == pytest.approx(
        np.linalg.norm(found.deviation[:, :n_p], axis=1).max()
    )
    assert found.limit_excess <= KEPT
    assert 1e-5 < found.deviation_m < most


@pytest.mark.parametrize(("torque", "price"), [(22.0, 1.02e-3), (20.0, 3.12e-3)])
def test_the_deviation_is_that_of_the_optimization_of_the_whole_motion(
    torque: float, price: float
) -> None:
    """``price`` [m]: deviation of method full, IPOPT on all states and torques, with the same
    limits.
    """
    found = case("planar5_nmp").invert(torque_max=[torque, torque])
    assert abs(found.deviation_m - price) < NEAR * price


def test_limits_of_speed_and_deflection_are_kept() -> None:
    one = case("planar5_nmp")
    motion = free(one)
    speed = 0.97 * np.abs(motion.v_m).max(axis=0)
    i_e = list(flexgen.read("planar5_nmp").i_e)
    bend = np.array([0.95 * np.abs(motion.q_a[:, i_e]).max()])
    found = one.invert(speed_max=speed, deflection_max=bend)
    assert found.limits_active
    assert (np.abs(found.v_m).max(axis=0) <= speed * (1 + KEPT)).all()
    assert np.abs(found.q_a[:, i_e]).max() <= bend[0] * (1 + KEPT)


def test_wide_limits_change_nothing() -> None:
    one = case("planar5_nmp")
    expected = free(one)
    for limits in ({"torque_max": [30.0, 30.0]}, {"torque_max": [np.inf, np.inf]}, {}):
        found = one.invert(**limits)
        assert not found.limits_active and found.programs == 0 and found.deviation_m == 0.0
        assert np.array_equal(found.tau_m, expected.tau_m)


def test_a_hold_changes_the_sent_torques_only() -> None:
    one = case("planar5_nmp")
    plain, held = (one.invert(torque_max=[22.0, 22.0], hold=hold) for hold in ("spline", "zoh"))
    assert np.array_equal(plain.q_a, held.q_a) and np.array_equal(plain.deviation, held.deviation)
    assert 1e-4 < np.abs(plain.tau_m - held.tau_m).max() < 1.0


def test_limits_that_cannot_be_kept_are_refused() -> None:
    one = case("planar5_nmp")
    with pytest.raises(SolverError, match=r"limits cannot be kept.*exceeded by"):
        one.invert(torque_max=[5.0, 30.0])  # 8.6 N m hold the arm
    with pytest.raises(SolverError, match=r"limits cannot be kept.*exceeded by"):
        one.invert(speed_max=[1000.0, 20.0])


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"torque_max": [1.0]}, r"torque_max: given shape \(1,\)"),
        ({"torque_max": [np.nan, 1.0]}, "torque_max: given .*positive"),
        ({"speed_max": [0.0, 1.0]}, "speed_max: given .*positive"),
        ({"deflection_max": [-1.0]}, "deflection_max: given .*positive"),
        ({"gear_torque_max": [1.0, -1.0]}, "gear_torque_max: given .*positive"),
        ({"torque_rate_max": [1.0]}, r"torque_rate_max: given shape \(1,\)"),
        ({"joint_speed_max": [np.nan, 1.0]}, "joint_speed_max: given .*positive"),
        ({"joint_acceleration_max": [0.0, 1.0]}, "joint_acceleration_max: given .*positive"),
        ({"tool_speed_max": -1.0}, "tool_speed_max: given -1.0, expected a number >= 0"),
        (
            {"tool_acceleration_max": np.nan},
            "tool_acceleration_max: given nan, expected a number >= 0",
        ),
        (
            {"torque_speed": [1.0, 1.0]},
            r"torque_speed: given \[1.0, 1.0\], expected for each of 2 motors two or more",
        ),
        (
            {"torque_speed": 2 * [[[0.0, 1.0], [5.0, 2.0]]]},
            "torque_speed: given .*the torque falls",
        ),
        (
            {"torque_speed": 2 * [[[0.0, 1.0], [5.0, 0.5], [9.0, 0.4]]]},
            "torque_speed: given .*falls faster",
        ),
        ({"torque_speed": 2 * [[[0.0, 1.0]]]}, "torque_speed: given .*two or more points"),
        (
            {"torque_speed": 5.0},
            "torque_speed: given 5.0, expected for each of 2 motors two or more",
        ),
        ({"torque_speed": [[[0.0, 1.0], [5.0]], ()]}, "torque_speed: given .*two or more points"),
        ({"torque_max": [1.0, 1.0], "knot_samples": 400}, "expected at least 9 knots"),
        ({"torque_max": [1.0, 1.0], "knot_samples": -1}, "expected at least 9 knots"),
    ],
)
def test_bad_arguments_are_named(limits: dict, message: str) -> None:
    one = case("planar5_nmp")
    options = one.options | limits
    with pytest.raises(ArgumentError, match=message):
        one.library.invert_limited(one.y, one.dy, one.ddy, **options)


def test_the_function_survives_pickling_and_refuses_calls_after_close() -> None:
    one = case("planar5_nmp")
    again = pickle.loads(pickle.dumps(one.library.invert_limited))
    found = again(one.y, one.dy, one.ddy, torque_max=[22.0, 22.0], **one.options)
    assert np.array_equal(found.tau_m, one.invert(torque_max=[22.0, 22.0]).tau_m)


# rad/s, N m
CURVE = [[[0.0, 22.0], [400.0, 20.0], [900.0, 8.0]], [[0.0, 9.0], [130.0, 8.0], [260.0, 2.0]]]


def use_of(kind: str, one: Case, found: Inversion, bound: np.ndarray) -> float:
    """The largest part of a limit that a motion uses, by other formulas than in C."""
    period = one.options["period"]
    i_g = list(flexgen.read("planar5_nmp").i_g)
    if kind.startswith("tool"):
        place = one.y if found.deviation is None else one.y + found.deviation
        x = np.gradient(place, period, axis=0)
        x = x if kind == "tool_speed_max" else np.gradient(x, period, axis=0)
        return float((np.linalg.norm(x, axis=1) / bound).max())
    if kind == "torque_speed":
        most = [
            np.interp(np.abs(v), *np.transpose(curve))
            for v, curve in zip(found.v_m.T, bound, strict=True)
        ]
        return float((np.abs(found.tau_m) / np.transpose(most)).max())
    values = {
        "gear_torque_max": found.tau_g,
        "torque_rate_max": np.diff(found.tau_m, axis=0) / period,
        "joint_speed_max": found.v_a[:, i_g],
        "joint_acceleration_max": found.a_a[:, i_g],
    }
    return float((np.abs(values[kind]) / bound).max())


@pytest.mark.parametrize(
    ("kind", "factor"),
    [
        ("gear_torque_max", 0.92),
        ("torque_rate_max", 0.9),
        ("joint_speed_max", 0.97),
        ("joint_acceleration_max", 0.9),
        ("tool_speed_max", 0.97),
        ("tool_acceleration_max", 0.9),
        ("torque_speed", 0.9),
    ],
)
def test_other_limits_are_kept(kind: str, factor: float) -> None:
    """Limits of a part of what the path needs."""
    one = case("planar5_nmp")
    size = 1 if kind.startswith("tool") else 2
    if kind == "torque_speed":
        bound = np.array(CURVE)
        bound[:, :, 1] *= factor * use_of(kind, one, free(one), bound)
    else:
        bound = factor * np.array([use_of(kind, one, free(one), x) for x in each(size)])
    assert use_of(kind, one, free(one), bound) == pytest.approx(1 / factor)
    found = one.invert(**{kind: float(bound[0]) if size == 1 else bound})
    assert found.limits_active and 1e-5 < found.deviation_m < 5e-2
    assert use_of(kind, one, found, bound) <= 1 + KEPT


def each(size: int) -> list[np.ndarray]:
    """Bounds of 1 for one quantity, and of infinity for the others."""
    return [np.where(np.arange(size) == k, 1.0, np.inf) for k in range(size)]


RESPONSE = "*response = (m->trial"
BUGS = {
    "responses": (RESPONSE, "*response = 1.2 * (m->trial"),
    "responses, one program": (RESPONSE, "*response = 1.2 * (m->trial"),
    "not compared": ("*worst = fmax_1(*worst, fabs_1(value) - 1.0);", "(void)value;"),
}


@pytest.mark.slow
@pytest.mark.parametrize("bug", BUGS)
def test_a_planted_bug_is_corrected_by_iterations_or_found(
    bug: str, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Responses with an error of a fifth: repeated programs correct it, a single one does not.
    Limits that are never compared with the motion are exceeded, which the tests above would see.
    """
    texts = dict(clib_files.read_clib())
    text = texts["invert_limited.c"]
    assert text.count(BUGS[bug][0]) == 1
    text = text.replace(*BUGS[bug])
    if bug.endswith("one program"):
        assert text.count("LIMITED_ROUNDS = 20,") == 1
        text = text.replace("LIMITED_ROUNDS = 20,", "LIMITED_ROUNDS = 1,")
    monkeypatch.setattr(clib_files, "read_clib", lambda: texts | {"invert_limited.c": text})
    wrong = load(flexgen.generate("planar5_nmp", tmp_path / "wrong").directory)
    one = case("planar5_nmp")

    def invert() -> Inversion:
        return wrong.invert_limited(one.y, one.dy, one.ddy, torque_max=[22.0, 22.0], **one.options)

    if bug == "responses":
        assert np.abs(invert().tau_m).max() <= 22.0 * (1 + KEPT)
    elif bug == "not compared":
        assert np.abs(invert().tau_m).max() > 22.0 * (1 + KEPT)
    else:
        with pytest.raises(SolverError, match="cannot be kept"):
            invert()


PARTS = {
    "torque_rate_max": ("- torque) / m->period;", "- torque) / (1.2 * m->period);"),
    "torque_speed": ("both[1] = out[i] - load;", "both[1] = out[i] - 0.5 * load;"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", PARTS)
def test_a_planted_bug_in_a_quantity_is_found(
    kind: str, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = dict(clib_files.read_clib())
    text = texts["invert_limited.c"]
    assert text.count(PARTS[kind][0]) == 1
    monkeypatch.setattr(
        clib_files, "read_clib", lambda: texts | {"invert_limited.c": text.replace(*PARTS[kind])}
    )
    wrong = replace(
        case("planar5_nmp"),
        library=load(flexgen.generate("planar5_nmp", tmp_path / "wrong").directory),
    )
    bound = np.array(CURVE) if kind == "torque_speed" else np.ones(2)
    bound = (
        bound * np.array([1.0, 0.9 * use_of(kind, wrong, free(wrong), bound)])[-bound.ndim // 2 :]
    )
    assert use_of(kind, wrong, wrong.invert(**{kind: bound}), bound) > 1 + KEPT


@pytest.mark.slow
def test_run_time_parameters_are_those_of_a_library_with_them_baked_in(tmp_path) -> None:
    one = case("elbow")
    made = load(flexgen.generate("elbow", tmp_path / "payload", parameters=["payload"]).directory)
    bound = 0.85 * np.abs(free(one).tau_m).max(axis=0)
    bound = np.maximum(bound, 1.02 * np.abs(free(one).tau_m[[0, -1]]).max(axis=0))
    found = made.invert_limited(one.y, one.dy, one.ddy, torque_max=bound, **one.options)
    expected = one.invert(torque_max=bound)
    assert found.limits_active
    assert np.abs(found.tau_m - expected.tau_m).max() <= SAME_TORQUE * np.abs(expected.tau_m).max()
    heavy = made.parameters * 1.3
    other = made.invert_limited(
        one.y, one.dy, one.ddy, torque_max=bound * 2, parameters=heavy, **one.options
    )
    assert not other.limits_active and np.abs(other.tau_m - expected.tau_m).max() > 1e-3


@pytest.mark.slow
def test_sanitizers_find_nothing(tmp_path) -> None:
    """Limits that are active, wide, too small or no numbers; knots too far apart; workspaces of
    the exact size.
    """
    if not can_sanitize(tmp_path):
        pytest.skip("the C compiler has no sanitizers; install the Debian package gcc or clang")
    folder = flexgen.generate("planar5_nmp", tmp_path / "library", build=False).directory
    table = plan("planar5_nmp", "line")
    header = path_header(flexgen.read("planar5_nmp"), "line", table.table(), table.duration)
    (tmp_path / "line.h").write_text(header, encoding="ascii")
    (tmp_path / "client.c").write_text(
        (SUPPORT / "programs" / "limited_path.c").read_text(encoding="ascii")
    )
    include = [f"-I{folder}", f"-I{folder / 'src'}"]
    used = ("inversion", "linearize", "invert_limited", "path_sampler", *INVERSION)
    files = [path for path in sources(folder) if path.stem.removeprefix("planar5_nmp_") in used]
    general = folder / "src" / "planar5_nmp.c"
    run(
        CC,
        "-std=c99",
        *SANITIZE,
        "client.c",
        *files,
        general,
        *include,
        "-lm",
        "-o",
        "client",
        folder=tmp_path,
    )
    statuses = [int(word) for word in run(tmp_path / "client", folder=tmp_path).split()]
    active = 2
    bad = -5
    infeasible = -14
    assert statuses[:6] == [active] * 4 + [bad] * 2
    assert statuses[6:12] == [0] * 4 + [bad] * 2
    assert statuses[12:18] == [infeasible] * 4 + [bad] * 2
    assert statuses[24:] == [bad] * 12


def test_the_solver_in_python_uses_it() -> None:
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(
        equations,
        method="lq",
        limits=Limits.from_model(equations.model, torque=22.0),
        verify=False,
    )
    assert solution.details["programs"] >= 1
