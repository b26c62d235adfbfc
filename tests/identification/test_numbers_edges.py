"""Small functions of many rooms at the edges of their ranges, by hand.

Of `flexgen.base.files.atomic_files`, `flexgen.base.files.npz_files`,
`flexgen.base.spec.toml_lines`, `flexgen.codegen.build.object_cache`,
`flexgen.paths.inverse_kinematics.targets`, `flexgen.exports.mujoco.mujoco`,
`flexgen.identification.responses.graybox`, `flexgen.inversion.comparison.initial_value`,
`flexgen.identification.servo.fit_result`, `flexgen.studies.scenarios.bench`,
`flexgen.identification.responses.amplitude`, `flexgen.exports.mujoco.mujoco_inertia`,
`flexgen.planning.learning.smoother`, `flexgen.codegen.emission.digest`,
`flexgen.exports.urdf.urdf`.
"""

from __future__ import annotations

import math
import os
import threading
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.special import erfc

import flexgen
from flexgen.analysis.zero_dynamics import solvability
from flexgen.backends.cuda.inversion import CudaManyInverter
from flexgen.base.errors import ArgumentError, BuildError, ModelError
from flexgen.base.files import atomic_files, npz_files
from flexgen.base.numerics.tableaus import gauss
from flexgen.base.spec import toml_lines
from flexgen.base.spec.tables import Table
from flexgen.base.spec.toml_lines import TextError
from flexgen.codegen.build import compiler, object_cache
from flexgen.codegen.emission import digest
from flexgen.codegen.statements import pivot_guards
from flexgen.dynamics.dae import taylor_series
from flexgen.exports.mujoco import mujoco, mujoco_inertia
from flexgen.exports.urdf import urdf
from flexgen.identification.responses import amplitude, graybox
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.servo.fit_result import ServoFit
from flexgen.inversion.comparison import initial_value
from flexgen.model.elements import Output
from flexgen.paths.inverse_kinematics import targets
from flexgen.planning.learning.smoother import PathSmoother
from flexgen.planning.optimal import model_limits
from flexgen.runtime.streams import stream
from flexgen.studies.scenarios import bench
from flexgen.studies.tolerances import in_loop
from flexgen.studies.tolerances.sources import PAYLOAD


def test_a_folder_is_own_where_its_user_is_the_one_who_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 7, raising=False)
    found: Any = [Made(st_uid=user) for user in (7, 0)]
    assert [atomic_files._is_own(x) for x in found] == [True, False]
    monkeypatch.delattr(os, "geteuid")
    assert atomic_files._is_own(found[1])  # of systems without users


def test_texts_of_more_than_60_characters_are_cut() -> None:
    assert [npz_files._shorten("x" * n) for n in (60, 61)] == ["x" * 60, "x" * 57 + "..."]
    assert npz_files._shorten(10**5000) == "a huge number"


def test_errors_of_a_text_without_a_place_have_no_line() -> None:
    for text, words in (
        ("a = " + "[" * 3000 + "]" * 3000, "nested too deeply"),
        ("a = 1\nb =", "not TOML"),
    ):
        with pytest.raises(TextError) as caught:
            toml_lines._parse(text, "a.toml", 1e5)
        assert words in caught.value.given
        assert caught.value.line == (0 if "nested" in words else 2)


@pytest.mark.parametrize("cached", [None, b"object"])
def test_an_object_is_fetched_where_the_cache_has_it(
    cached: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(object_cache, "fetch_entry", lambda folder, name: cached)
    source = tmp_path / "one.c"
    source.write_text("int x;\n")
    found = object_cache.Objects("gcc", {}).fetch(source)
    assert found is (cached is not None) and source.with_suffix(".o").exists() is found


@pytest.mark.parametrize(
    ("q", "before", "turns", "expected"),
    [
        ([0.5, 0.5], [0.0, 0.0], (), [0.5, 0.5]),
        # of the second one a turn less is beyond its limit
        ([0.5, 0.5], [6.0, -6.0], (), [0.5 + 2 * np.pi, 0.5]),
        ([2.0 + 0.9e-9, -1.0 - 0.9e-9], [0.0, 0.0], (), [2.0 + 0.9e-9, -1.0 - 0.9e-9]),
        ([0.5, 1.0 + 2e-9], [0.0, 0.0], (), None),
        ([0.5, -1.0 - 2e-9], [0.0, 0.0], (), None),
        ([0.5, 0.5], [0.0, 0.0], (-1, 0), [0.5 - 2 * np.pi, 0.5]),
        ([0.5, 0.5], [0.0, 0.0], (0, 1), None),
    ],
)
def test_angles_have_the_turns_that_are_closest_within_the_limits(
    q: list[float], before: list[float], turns: tuple[int, ...], expected: list[float] | None
) -> None:
    limits = [Made(lower=None, upper=None), Made(lower=-1.0, upper=1.0)]
    model: Any = Made(i_g=(0, 1), coordinates=[Made(unit="rad", dof=dof) for dof in limits])
    found = targets._choose_turns(model, np.array(q), np.array(before), turns)
    assert (found is None) == (expected is None)
    if found is not None:
        assert found == pytest.approx(np.array(expected), abs=1e-14)


def test_moving_bodies_in_mujoco_have_some_mass_and_inertia() -> None:
    """At least 2e-15 of both; bodies at rest have what they have, or nothing."""
    made = object.__new__(mujoco._Writer)
    made.small = 0
    least = 2e-15
    for mass, moments, moving, expected in (
        (2.0, (3.0, 2.0, 4.0), True, (2.0, (2.0, 3.0, 4.0))),
        (2.0, (3.0, 0.0, 3.0), True, (2.0, (least, 3.0 + least, 3.0 + least))),
        (0.0, (0.0, 0.0, 0.0), True, (least, (least, least, least))),
        (0.0, (0.0, 0.0, 0.0), False, None),
        (least, (least, least, least), True, (least, (least, least, least))),
    ):
        body = ET.Element("body")
        made._inertial(body, mass, np.zeros(3), np.diag(moments), moving=moving)
        if expected is None:
            assert len(body) == 0
            continue
        found = body[0].attrib
        assert float(found["mass"]) == expected[0]
        assert sorted(map(float, found["diaginertia"].split())) == pytest.approx(
            expected[1], rel=1e-12
        )
    assert made.small == 2


def test_directions_that_data_do_not_determine_are_told_in_words() -> None:
    """Standard deviations of logarithms, and of others over their prior; the largest entries
    first, two at most.
    """

    def lines(A: np.ndarray) -> tuple[str, ...]:
        unknowns = [Made(scale=scale) for scale in ("log", "log", "linear")]
        vector: Any = Made(
            unknowns=unknowns, prior_sd=np.array([5.0, 5.0, 4.0]), names=["a", "b", "c"]
        )
        return graybox.weak_directions(vector, A)

    strong = 0.5e6
    assert lines(np.diag([strong, strong, strong])) == ()
    sd = 2 * graybox.WEAK
    assert lines(np.diag([0.5 / sd**2, strong, strong])) == (
        f"a is not determined by the data (sd {100 * sd:.0f} %)",
    )
    assert lines(np.diag([strong, strong, 0.5 / (4 * sd) ** 2])) == (
        f"c is not determined by the data (sd {100 * sd:.0f} %)",
    )
    assert lines(np.diag([strong, strong, 0.5 / (0.99 * 4 * graybox.WEAK) ** 2])) == ()
    assert lines(np.diag([0.5e-3, strong, strong])) == (
        "a is not determined by the data (sd more than a factor of 10)",
    )
    together, against = (np.array(x) / np.sqrt(1.25) for x in ([1.0, 0.5, 0.0], [0.5, -1.0, 0.0]))
    A = strong * np.diag([0.0, 0.0, 1.0])
    for weak, strong_one, words in (
        (together, against, "a, b can change together"),
        (against, together, "b can change together, and a against them"),
    ):
        one = A + strong * np.outer(strong_one, strong_one) + 0.5 / sd**2 * np.outer(weak, weak)
        assert lines(one) == (f"{words} (sd {100 * sd:.0f} %)",)


def test_a_problem_without_zeros_has_none_along_its_path() -> None:
    some: Any = Made(zeros=[(0.0, np.array([1.0, 2.0])), (1.0, np.array([3.0]))])
    none: Any = Made(zeros=[])
    assert initial_value.zeros_along(some).tolist() == [1.0, 2.0, 3.0]
    assert initial_value.zeros_along(none).shape == (0,)


@pytest.mark.parametrize(("explained", "used"), [(0.9, True), (0.8999, False), (0.2, False)])
def test_a_servo_that_explains_too_little_is_not_used(explained: float, used: bool) -> None:
    made = object.__new__(ServoFit)
    vars(made).update(explained=explained, converged=True)
    text = (
        f"the servo explains {100 * explained:.0f} % of the lag of the robot, expected 90 %: "
        "another structure"
    )
    assert made.problem.startswith(text) != used and (made.problem == "") == used


def test_a_prefix_stands_before_each_line() -> None:
    lines: list[str] = []
    bench._add_prefix(lines.append, "draw 3: ")("step 1")
    assert lines == ["draw 3: step 1"]


@pytest.mark.parametrize("law", ["cubic", "backlash"])
def test_a_spring_in_place_of_the_linear_one_has_its_mean_stiffness(law: str) -> None:
    """Of Gaussian deflections without mean torque, over that of the first level: 1 + c s^2, and
    P(|d| > gap).
    """
    effects = next(x.effects for x in amplitude.LAWS if x.name == law)
    sizes = np.array([[[1.0, 1.0]], [[0.5, 2.0]]])
    z = np.array([[0.4, 0.7]])
    motions = [amplitude.Motion(s, np.ones((1, 3)), np.zeros((1, 2))) for s in sizes]
    found = effects(z, motions)
    mean = 1.0 + z[0] * sizes**2 if law == "cubic" else erfc(z[0] / sizes / np.sqrt(2))
    for effect, expected in zip(found, mean / mean[0], strict=True):
        assert effect.stiffness == pytest.approx(expected, rel=2e-3)
        assert not effect.loss.any() and not effect.friction.any()


def test_inertias_that_rounding_makes_impossible_get_as_much_as_is_missing() -> None:
    """Of a long rod: 2e-14 of its largest moment on all; a tensor that is possible stays."""
    model = flexgen.read("elbow")
    for size in (4.0, 0.25):
        rod = size * np.diag([1.0 + 4e-15, 1.0 - 4e-15, 0.0])
        kept = size * np.diag([1.0, 1.2, 0.4])
        found = mujoco_inertia.regroup(model, [rod, kept], [np.eye(3)] * 2)
        assert np.abs(found[0] - rod - 2e-14 * rod.max() * np.eye(3)).max() < 5e-16 * size
        assert np.array_equal(found[1], kept) and mujoco_inertia.missing(found[0]) <= 0.0


def test_a_smoother_goes_through_all_samples_twice() -> None:
    """Forward and backward recursions of the textbook, with other matrices in each part of two
    samples.
    """
    rng = np.random.default_rng(6)
    made = object.__new__(PathSmoother)
    shapes = {
        "_F": (3, 4, 4),
        "_G": (3, 4, 2),
        "_C": (3, 3, 4),
        "_D": (3, 3, 2),
        "_M": (3, 4, 3),
        "_J": (3, 4, 4),
    }
    for name, shape in shapes.items():
        setattr(made, name, 0.4 * rng.normal(size=shape))
    vars(made).update(samples=2, _begin=3, sample_s=0.25, model=Made(n_a=2))
    y = rng.normal(size=(9, 3))
    u = rng.normal(size=(9, 2))
    rest = slice(max(0, 3 - round(0.5 / 0.25)), 3)
    dy = y - y[rest].mean(axis=0)
    du = u - u[rest].mean(axis=0)
    z = np.zeros(4)
    before = []
    after = []
    for k in range(9):
        F, G, C, D, M, _ = (getattr(made, name)[min(k // 2, 2)] for name in shapes)
        before.append(F @ z + G @ du[k])
        z = before[k] + M @ (dy[k] - C @ before[k] - D @ du[k])
        after.append(z)

    def smooth(k: int) -> np.ndarray:
        if k == 8:
            return after[k]
        return after[k] + made._J[min((k + 1) // 2, 2)] @ (smooth(k + 1) - before[k + 1])

    np.testing.assert_allclose(
        made.deviation(y, u), [smooth(k)[:2] for k in range(9)], rtol=1e-10, atol=1e-12
    )


def test_digests_leave_out_newer_numbers_that_a_model_does_not_have() -> None:
    """So that digests of older models stay; each that is given enters, of its own class only."""
    model = flexgen.read("elbow")
    plain = digest._canonical(model)
    new = [
        name.rpartition(".")[2]
        for name in digest.NEWER
        if "." not in name or name.startswith(("Gear.", "Robot"))
    ]
    assert not [name for name in new if name != "torque_max" and f"{name}=" in plain]
    motor = replace(model.motors[0], torque_rms_max=3.0)
    assert "torque_rms_max=3.0" in digest._canonical(
        motor
    ) and "torque_rate_max" not in digest._canonical(motor)
    gears = [dof.gear for element in model.elements for dof in element.dofs]
    assert "torque_max" not in digest._canonical(gears[0])
    assert "torque_max=7.5" in digest._canonical(replace(gears[0], torque_max=7.5))
    assert "torque_max=" in digest._canonical(motor)  # that of motors is older
    assert "temperature=31.5" in digest._canonical(replace(model, temperature=31.5))
    assert digest._canonical({"a": (1, 2.5), "b": ["x"]}) == "{'a': [1, 2.5], 'b': ['x']}"
    assert "name=" not in digest._canonical(motor, ("name",)) and "name=" in digest._canonical(
        motor
    )


@pytest.mark.parametrize(
    ("stem", "taken", "name"),
    [
        ("link", (), "link"),
        ("link", ("link",), "link2"),
        ("link", ("link", "link2", "link3"), "link4"),
        ("base", (), "base2"),
        ("a" * 27, (), "a" * 27),
        ("a" * 28, (), "a" * 27),
        ("a" * 28, ("a" * 27,), "a" * 24 + "2"),
        ("a" * 26 + "_x", (), "a" * 26),
        ("a__b", (), "a_b"),
    ],
)
def test_new_names_of_links_are_short_and_not_taken(
    stem: str, taken: tuple[str, ...], name: str
) -> None:
    assert urdf._new_name(stem, taken) == name


def test_rates_of_torques_are_bounded_at_both_ends_of_each_interval() -> None:
    """Of `flexgen.planning.optimal.model_limits`: torques that are polynomials of second order
    have known slopes there.
    """
    mesh = gauss_mesh(np.array([0.5, 0.25]))
    begin = np.array([0.0, 0.5])
    c = mesh.table.c
    t = (begin[:, None] + mesh.h[:, None] * c).ravel()
    tau = np.stack([3.0 * t**2 - t, 7.0 * t])
    seen: list[tuple[Any, float, float]] = []
    phase: Any = Made(
        mesh=mesh,
        number=0,
        continuous_torque=lambda: None,
        nodes=lambda name: ca.DM(tau) if name == "tau_m" else ca.DM([0.0, 0.5, 0.75]),
        subject_to=lambda value, low, high, name: seen.append((value, low, high)),
    )
    model_limits._bound_rates(phase, np.array([2.0, np.inf]), True)
    slopes = 6.0 * np.array([0.0, 0.5, 0.5, 0.75]) - 1.0
    assert [
        np.array(value).ravel() == pytest.approx(sign * slopes - 0.75 * 2.0)
        for value, sign in zip((x[0] for x in seen), (1, -1), strict=True)
    ] == [True, True]
    assert [x[1:] for x in seen] == [(-np.inf, 0.0)] * 2
    phase.number = 1
    with pytest.raises(ArgumentError, match="one phase: between two the torque jumps"):
        model_limits._bound_rates(phase, np.array([2.0, np.inf]), True)


def gauss_mesh(h: np.ndarray) -> Any:
    """Two intervals with three nodes each."""
    return Made(table=gauss(3), s=3, N=len(h), h=h)


def test_deflections_have_the_spectrum_of_the_torques_that_drives_give() -> None:
    """Of `LocalModel.deflection_sd`: line by line, amplitude by amplitude, in the time domain."""
    rng = np.random.default_rng(8)

    def of(*shape: int) -> np.ndarray:
        return rng.normal(size=shape)

    M = np.eye(3) + 0.1 * np.diag(of(3)) ** 2
    D = 0.1 * np.eye(3)
    K = np.diag([5.0, 7.0, 9.0])
    B = of(3, 2)
    rows = of(2, 3)
    w = np.array([0.7, 1.9])
    U = of(1, 2, 2, 1) + 1j * of(1, 2, 2, 1)
    model: Any = Made(
        matrices=lambda *_: tuple(x[None] for x in (M, D, K, B)),
        springs=(0, 1),
        deflection_rows=rows,
        model=Made(n_m=2),
    )
    drive: Any = Made(transfer=lambda w, n_m: np.outer(1 / w, [2.0, 3.0]) * (1 + 0.5j))
    name = next(
        k
        for k, x in vars(LocalModel).items()
        if callable(x) and "UU" in getattr(x, "__annotations__", {})
    )
    found = getattr(LocalModel, name)(
        model, np.zeros(1), np.zeros((1, 2)), w, drive, U @ U.conj().swapaxes(-1, -2)
    )
    power = np.zeros(2)
    for k in range(2):
        torque = drive.transfer(w, 2)[k] * U[0, k, :, 0]
        x = rows @ np.linalg.solve(-(w[k] ** 2) * M + 1j * w[k] * D + K, B @ torque)
        power += np.abs(x) ** 2 / 2
    assert found[0] == pytest.approx(np.sqrt(power))


@pytest.mark.parametrize(
    ("problems", "own"), [({"y": 5}, "y"), ({"parameters": 4, "q_start": 4}, "q_start"), ({}, "")]
)
def test_problems_of_a_card_are_as_many_in_each_array(problems: dict[str, int], own: str) -> None:
    """Of `flexgen.backends.cuda.inversion`: paths, parameters or begins, one of each or one for
    each problem.
    """
    shapes = {"y": (9, 3), "dy": (9, 3), "ddy": (9, 3), "q_start": (2,), "parameters": (6,)}
    asked: dict[str, tuple[int, ...]] = {}
    given: dict[str, Any] = {}
    for name, shape in shapes.items():
        many = problems.get("y" if name in ("dy", "ddy") else name)
        full = shape if many is None else (many, *shape)
        given[name] = Made(
            shape=full, demand=lambda like, real, order, name=name: asked.update({name: like})
        )
    sizes = {"n_t": 3, "n_y": 3, "n_a": 2}
    made: Any = Made(_inverter=Made(_sizes=sizes, _real=float, _parameters=np.zeros(6)))
    if not problems:
        with pytest.raises(
            ArgumentError,
            match="given one path, one q_start and one set of parameters, expected the",
        ):
            CudaManyInverter._demand(made, given)
        return
    found, count = CudaManyInverter._demand(made, given)
    assert count == next(iter(problems.values()))
    for name in ("path", "parameters", "q_start"):
        assert found[f"own_{name}"] == int(("y" if name == "path" else name) in problems)
    assert asked["dy"] == given["y"].shape and asked["parameters"][-1] == 6 and own in problems
    given["q_start"] = Made(shape=(count + 1, 2), demand=lambda *_: None)
    with pytest.raises(ArgumentError, match=f"{count + 1} of q_start.*, expected the same"):
        CudaManyInverter._demand(made, given)


@pytest.mark.parametrize(("fails", "target"), [((), True), ((1,), False), ((1, 2), None)])
def test_a_compiler_for_another_processor_has_its_own_default(
    fails: tuple[int, ...], target: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of `flexgen.codegen.build.compiler`: without -march=native where that fails, and refused
    where it fails then, too.
    """
    calls: list[list[str]] = []

    def output(command: Any, text: str, folder: Any = None) -> Any:
        if "--version" in command:
            return Made(stdout="cc 1.0\nmore", returncode=0)
        calls.append(list(command))
        return Made(
            stdout=" ".join(compiler._WORLD),
            stderr="no such processor",
            returncode=int(len(calls) in fails),
        )

    monkeypatch.setattr(compiler, "_output", output)
    monkeypatch.setattr(compiler, "_choose_command", lambda: ["cc"])
    monkeypatch.setattr(compiler, "_packaged_compiler", lambda: None)
    find = compiler._find_compiler.__wrapped__
    if target is None:
        with pytest.raises(BuildError, match="which fails:\n  no such processor"):
            find(False, False, "native", None, None, None)
        return
    found = find(False, False, "native", None, None, None)
    assert ("-march=native" in found.flags) is target and len(calls) == 1 + len(fails)
    assert (found.version, found.command) == ("cc 1.0", ("cc",))


def test_the_tool_of_translations_is_in_units_of_the_reach() -> None:
    """Of `flexgen.analysis.zero_dynamics.solvability`: a length over a length, an angle times the
    reach.
    """
    coordinates = [Made(unit="rad"), Made(unit="m")]
    model: Any = Made(output=Output("tool_pose"), coordinates=coordinates, i_g=(0, 1))
    arm: Any = Made(W_g=np.ones((1, 6, 2)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solvability, "reach", lambda equations: 0.5)
        found = solvability._tool(Made(model=model), arm)[0]  # type: ignore[arg-type]
        assert found[:3] == pytest.approx(np.array([[2.0, 1.0]] * 3))
        assert found[3:] == pytest.approx(np.array([[1.0, 0.5]] * 3))
        model.output = Made(size=1, type="combination")
        assert solvability._tool(Made(model=model), Made(W_g=np.ones((1, 1, 2))))[
            0
        ] == pytest.approx(  # type: ignore[arg-type]
            np.array([[1.0, 0.5]])
        )


@pytest.mark.parametrize("call", ["update", "limit", "set_parameters", "set_force"])
def test_a_stream_takes_one_call_at_a_time(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of `flexgen.runtime.streams.stream`: a second one is refused at once, not kept waiting."""
    made = object.__new__(stream.Stream)
    lock = threading.Lock()
    real = np.dtype(float)
    entries = Made(
        refuse_closed=lambda: None, model_parameters=(), rows=(), real=real, push=1, limits=1
    )
    inputs = tuple(np.zeros(2) for _ in range(3))
    vars(made).update(_lock=lock, _entries=entries, _sizes={"n_y": 2, "n_m": 2}, _inputs=inputs)
    monkeypatch.setattr(stream, "parameters_of", lambda *_: np.zeros(1))
    monkeypatch.setattr(stream, "array_of", lambda name, what, x, shape, dtype: np.zeros(shape))
    given = {"update": (np.zeros(2),) * 3, "limit": (), "set_parameters": (1,), "set_force": (1,)}[
        call
    ]
    lock.acquire()
    with ThreadPoolExecutor(1) as pool:
        refused = pool.submit(getattr(made, call), *given)
        try:
            with pytest.raises(
                ArgumentError,
                match=r"while an(other)? (update|one) runs, expected one after the other",
            ):
                refused.result(timeout=2.0)
        finally:
            lock.release()


@pytest.mark.parametrize("code", taylor_series.RULES)
def test_rules_of_series_are_repeated_derivatives(code: int) -> None:
    """Of `flexgen.dynamics.dae.taylor_series`: up to order 6 at two points, against CasADi's
    derivatives in time.
    """
    t = ca.SX.sym("t")
    rule = taylor_series.RULES[code]
    points = np.array(
        [[0.7, 0.4, -0.3, 0.2, 0.5, -0.1, 0.3], [1.3, -0.6, 0.2, 0.7, -0.4, 0.1, 0.2]]
    )
    others = np.array(
        [[1.9, 0.3, 0.6, -0.2, 0.1, 0.4, -0.5], [0.8, 0.5, -0.1, 0.3, 0.2, -0.6, 0.1]]
    )
    if code == ca.OP_CONSTPOW:
        others = np.array([[3.0, *[0.0] * 6]] * 2)
    found = rule(points[:, :, None], others[:, :, None])
    for k, (a, b) in enumerate(zip(points, others, strict=True)):
        x, y = (ca.SX(sum(float(c) * t**n for n, c in enumerate(row))) for row in (a, b))
        unary = code in (
            ca.OP_NEG,
            ca.OP_TWICE,
            ca.OP_SQ,
            ca.OP_INV,
            ca.OP_SQRT,
            ca.OP_EXP,
            ca.OP_LOG,
            ca.OP_SIN,
            ca.OP_COS,
            ca.OP_TAN,
            ca.OP_SINH,
            ca.OP_COSH,
            ca.OP_TANH,
            ca.OP_ATAN,
            ca.OP_ASINH,
            ca.OP_FABS,
            ca.OP_SIGN,
            ca.OP_NOT,
            ca.OP_ASSIGN,
        )
        value = (
            x
            if code == ca.OP_ASSIGN
            else ca.SX.unary(code, x)
            if unary
            else ca.SX.binary(code, x, y)
        )
        for order in range(7):
            expected = float(ca.Function("f", [t], [value])(0.0)) / math.factorial(order)
            assert found[k, order, 0] == pytest.approx(expected, rel=1e-9, abs=1e-10), (
                code,
                order,
            )
            value = ca.jacobian(value, t)


@pytest.mark.parametrize(
    ("base", "power"), [(1.5, 0.0), (-1.5, 1.0), (-1.5, 8.0), (1.5, 9.0), (1.5, 2.5), (1.5, -1.0)]
)
def test_powers_of_series_are_products_or_exponentials(base: float, power: float) -> None:
    """Small whole ones of negative numbers, too, which have no logarithm."""
    a = np.array([[[base], [0.3], [-0.2], [0.1]]])
    b = np.array([[[power], [0.0], [0.0], [0.0]]])
    found = taylor_series._power(a, b)[0, :, 0]
    t = np.linspace(-1e-2, 1e-2, 9)
    assert np.polynomial.polynomial.polyval(t, found) == pytest.approx(
        np.polynomial.polynomial.polyval(t, a[0, :, 0]) ** power, rel=1e-6
    )


def test_drawn_robots_have_names_and_factors_of_their_sources(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of `flexgen.studies.tolerances.in_loop`: 1 and the error, and what is added to the payload,
    counted from one.
    """
    model: Any = Made(uncertainty="table")
    sources = Made(
        root=np.zeros((2, 3)),
        added=np.array([False, True]),
        owner=[0, 0, 1],
        parameters=[Made(name=name) for name in ("q1.stiffness", "q2.stiffness", PAYLOAD)],
        errors=lambda z: np.column_stack([z[:, 0], 10.0 + z[:, 1]]),
    )
    monkeypatch.setattr(in_loop, "sources_of", lambda robot, table: sources)
    found = in_loop.draw_plants(model, 2, seed=5)
    z = np.random.default_rng(5).standard_normal((2, 3))
    for k in (0, 1):
        expected = {
            "q1.stiffness": 1.0 + z[k, 0],
            "q2.stiffness": 1.0 + z[k, 0],
            "payload": 10.0 + z[k, 1],
        }
        assert found[f"drawn_{k + 1}"] == pytest.approx(expected)
    assert list(found) == ["drawn_1", "drawn_2"]


@pytest.mark.parametrize(("failures", "error"), [(0, 2.0), (1, 2.1), (2, None)])
def test_an_error_in_the_loop_is_what_twenty_robots_of_twenty_one_keep(
    failures: int, error: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {f"r{k}": {} for k in range(21)}
    robots = {
        name: Made(name=name, failure="x" * (k < failures), size=0.1 * (k + 1))
        for k, name in enumerate(reversed(names))
    }
    figures = lambda robot: {"error_max_m": robot.size, "error_max_rad": None}  # noqa: E731
    found = Made(runs=[Made(name="model", size=0.0), *robots.values()], figures=figures, ended="")
    monkeypatch.setattr(in_loop, "draw_plants", lambda model: names)
    monkeypatch.setattr(in_loop, "control", lambda model, **given: found)
    run: Any = Made(model=Made(uncertainty=Made(delay=1e-3)), solution="solution")
    result = in_loop.error_in_loop(run)
    assert (result["robots"], result["failed"], result["without_delay"]) == (21, failures, True)
    assert (
        result["error_m"] == (None if error is None else pytest.approx(error))
        and result["error_rad"] is None
    )


def test_operations_at_random_states_are_those_of_c() -> None:
    """Of `flexgen.codegen.statements.pivot_guards`: conditions are numbers, 1 where they hold."""
    a = np.array([0.0, 1.0, 2.0, 2.0, -1.5])
    b = np.array([0.0, 2.0, 1.0, 2.0, 0.0])
    pairs = list(zip(a.tolist(), b.tolist(), strict=True))
    expected: dict[str, Any] = {
        "add": [x + y for x, y in pairs],
        "sub": [x - y for x, y in pairs],
        "mul": [x * y for x, y in pairs],
        "lt": [float(x < y) for x, y in pairs],
        "le": [float(x <= y) for x, y in pairs],
        "eq": [float(x == y) for x, y in pairs],
        "ne": [float(x != y) for x, y in pairs],
        "and": [float(bool(x) and bool(y)) for x, y in pairs],
        "or": [float(bool(x) or bool(y)) for x, y in pairs],
        "if_else_zero": [y if x else 0.0 for x, y in pairs],
        "pow": [x**y for x, y in pairs],
    }
    for name, values in expected.items():
        assert pivot_guards._CALLS[name](a, b).tolist() == values, name
    for name, values in (
        ("not", [float(not x) for x in a]),
        ("fabs", [abs(x) for x in a]),
        ("sign", [float(np.sign(x)) for x in a]),
    ):
        assert pivot_guards._CALLS[name](a).tolist() == values, name
    assert pivot_guards._CALLS["div"](a, b + 3.0).tolist() == [x / (y + 3.0) for x, y in pairs]
    assert {
        "double": np.finfo(float).eps,
        "single": float(np.finfo(np.float32).eps),
    } == pivot_guards.EPSILON


def test_values_are_nested_up_to_the_stated_depth() -> None:
    """Of lists and of tables, which the text may mix."""
    for wrap in (lambda x: [x], lambda x: {"a": x}):
        data: Any = wrap(1)
        for _ in range(toml_lines.DEPTH):
            toml_lines.check_depth(data)
            data = wrap(data)
        with pytest.raises(TextError) as caught:
            toml_lines.check_depth(data)
        assert f"at most {toml_lines.DEPTH} levels" in caught.value.expected


@pytest.mark.parametrize(
    ("keys", "required", "expected"),
    [
        (("pose_rad",), True, "pose_rad"),
        (("pose_deg", "other"), True, "pose_deg"),
        ((), False, None),
        ((), True, "pose_rad: pose_rad or pose_deg"),
        (("pose_rad", "pose_deg"), False, "pose_deg: one of the two"),
    ],
)
def test_angles_have_one_key_with_their_unit(
    keys: tuple[str, ...], required: bool, expected: str | None
) -> None:
    """Of `flexgen.base.spec.tables`: the errors name the key."""

    def fail(key: str, wanted: str, given: str = "") -> Exception:
        return ModelError("a.toml", 1, key, given, wanted)

    table: Any = Made(entries=dict.fromkeys(keys), fail=fail)
    try:
        found = Table.unit_key(table, "pose", required)
    except ModelError as error:
        found = f"{error.key}: {error.expected}"
    assert found == expected
