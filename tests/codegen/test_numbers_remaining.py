"""Small parts that no other quick test calls: written variants, exporters of others, curves in C,
graphs.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.memory import Hysteresis
from flexgen.base.spec.variants import add_variant
from flexgen.base.version import __version__
from flexgen.codegen.build import source_folder
from flexgen.codegen.build.agreement import compare_library
from flexgen.codegen.emission.constants_header import _curves
from flexgen.codegen.recursion.dh_chain import snap
from flexgen.codegen.statements.graph import LATENCY, OTHER_LATENCY, Graph
from flexgen.dynamics.hysteresis.hysteresis_law import curve_of
from flexgen.dynamics.mechanics import statics
from flexgen.dynamics.mechanics.equations import derive
from flexgen.exports.c_code import added
from flexgen.identification.poses.result import Calibration
from flexgen.identification.responses import result as identified
from flexgen.paths.geometry.redundancy import _Follower

FILE = """\
name = "arm"

[variant.stiff]
description = "stiffer"
remove = ["payload"]

[variant.stiff.set]
"q1.stiffness" = 2.0
"q2.stiffness" = 3.0
"""


def test_a_variant_is_added_to_the_text_of_a_model_file(tmp_path: Path) -> None:
    """With the changes of its base first, which it may set otherwise; the description is one line
    of 300 characters.
    """
    file = tmp_path / "arm.toml"
    file.write_text(FILE)
    text = add_variant(
        file, "new", {"q1.stiffness": 5.0, "m.mass": [1, 2]}, "two\n  lines " + 400 * "x", "stiff"
    )
    assert (
        text.startswith(FILE + "\n[variant.new]\n")
        and text.endswith("\n")
        and not text.endswith("\n\n")
    )
    found = tomllib.loads(text)["variant"]["new"]
    assert found["set"] == {"q2.stiffness": 3.0, "q1.stiffness": 5.0, "m.mass": [1, 2]}
    assert list(found["set"]) == ["q2.stiffness", "q1.stiffness", "m.mass"] and found[
        "remove"
    ] == ["payload"]
    assert found["description"] == ("two lines " + 400 * "x")[:300]
    alone = tomllib.loads(add_variant(file, "new", {"a": 1.0}, "x"))["variant"]
    assert (
        alone["new"] == {"description": "x", "set": {"a": 1.0}}
        and alone["stiff"]["set"]["q1.stiffness"] == 2.0
    )
    advice = (
        "expected one of a .toml file without that variant; the numbers are in the result and "
        "in --json"
    )
    with pytest.raises(ArgumentError) as caught:
        add_variant(file, "stiff", {}, "x")
    assert (
        str(caught.value)
        == f"write: given a model of arm.toml, which has a variant 'stiff', {advice}"
    )
    other = tmp_path / "arm.txt"
    other.write_text(FILE)
    for wrong in (other, tmp_path / "none.toml", ""):
        with pytest.raises(ArgumentError) as caught:
            add_variant(wrong, "new", {}, "x")
        assert (
            str(caught.value)
            == f"write: given a model of {str(wrong)!r}, which is no .toml file, {advice}"
        )


def test_exporters_of_other_packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "arm.my"
    answers: dict[str, Any] = {}

    def exporter(model: flexgen.RobotModel, path: Path) -> Any:
        assert model.name == "elbow" and path == out
        return answers["files"]

    monkeypatch.setattr(
        added, "added_names", lambda group: ("my", "other") if group == "exports" else ()
    )
    monkeypatch.setattr(added, "extension", lambda group, kind: exporter)
    files = [tmp_path / name for name in ("b.txt", "a.txt")]
    for file in files:
        file.write_text("x")
    for given, expected in (
        (files, files[::-1]),
        (str(files[0]), files[:1]),
        (files[1], files[1:]),
    ):
        answers["files"] = given
        found = added.export("my", "elbow", str(out))
        assert (found.kind, found.model, found.path, found.files) == (
            "my",
            "elbow",
            out,
            tuple(expected),
        )
    for wrong in (None, [], [files[0], tmp_path / "none"]):
        answers["files"] = wrong
        with pytest.raises(ArgumentError) as caught:
            added.export("my", "elbow", out)
        text = f"exporter my: given {wrong!r}, expected the paths of the files that it wrote"
        assert str(caught.value) == text
    with pytest.raises(ArgumentError, match=r"^export: given 'none', expected one of my, other$"):
        added.export("none", "elbow", out)
    monkeypatch.setattr(added, "added_names", lambda group: ())
    with pytest.raises(
        ArgumentError, match=r"^export: given 'my', expected one of none: no package adds any$"
    ):
        added.export("my", "elbow", out)


def test_the_record_of_an_exported_folder_is_a_text_to_read(tmp_path: Path) -> None:
    """Two spaces a level, digests by file, then a new line."""
    files = source_folder.write_folder(
        tmp_path / "arm", "kind", "arm", {"b.c": "int b;\n", "a/a.h": "int a;\n"}
    )
    names = [file.relative_to(tmp_path / "arm").as_posix() for file in files]
    assert names == ["a/a.h", "b.c", source_folder.RECORD]
    digest = {
        name: hashlib.sha256((tmp_path / "arm" / name).read_bytes()).hexdigest()
        for name in names[:2]
    }
    assert files[-1].read_text() == (
        f'{{\n  "format": 1,\n  "generator": "flexgen {__version__}",\n  "kind": "kind",\n'
        '  "name": "arm",\n  "files": {\n'
        f'    "a/a.h": "{digest["a/a.h"]}",\n    "b.c": "{digest["b.c"]}"\n  }}\n}}\n'
    )


def test_a_library_is_compared_with_the_equations() -> None:
    equations = derive("elbow")
    trajectory = flexgen.solve("elbow", progress=False).trajectory
    calls = []

    def inverse_dynamics(*given: np.ndarray) -> np.ndarray:
        calls.append(given[0].shape)
        right = np.array(
            equations.function("inverse_dynamics").map(len(given[0]))(*(x.T for x in given))
        ).T
        right[-1, 0] -= 0.25
        return right

    def quick(*given: np.ndarray) -> np.ndarray:
        if given[0].ndim > 1:
            return inverse_dynamics(*given)
        calls.append(given[0].shape)
        return given[0]

    found = compare_library(SimpleNamespace(inverse_dynamics=quick), equations, trajectory)
    assert found["difference_Nm"] == pytest.approx(0.25, rel=1e-6) and set(found) == {
        "difference_Nm",
        "call_us",
    }
    assert (
        len(calls) == 2001 and calls[1] == (equations.model.n_a,) and 0.0 < found["call_us"] < 1e4
    )


@pytest.mark.parametrize(("exponent", "gamma"), [(1.0, 0.3), (2.0, 0.5), (3.7, -0.4)])
def test_the_table_of_a_curve_in_c_is_the_curve(exponent: float, gamma: float) -> None:
    """Each row holds until the next one begins; the last one ends where the torque slips; C reads
    all of a row.
    """
    curve = curve_of(Hysteresis(1.0, 1.0, exponent, gamma))
    (first, dense, late), rows = curve.table()
    source = (Path(flexgen.__file__).parent / "codegen" / "clib" / "hysteresis.h").read_text(
        encoding="utf-8"
    )
    read = re.findall(r"\bc\[(\d+)\]", source.partition("real on_piece(")[2].partition("\n}\n")[0])
    # behind its begin and one over its length
    assert {int(k) for k in read} == set(range(rows.shape[1] - 2))
    begins = rows[:, 0]
    assert first == 0 and begins[dense] < 0.0 < begins[late] and (np.diff(begins) > 0).all()
    # pieces of one length
    assert np.ptp(np.diff(begins[: dense + 1])) < 1e-9 * np.abs(begins[0]) + 1e-12
    assert np.ptp(np.diff(begins[late:])) < 1e-9
    assert np.abs(begins[dense + 1 : late]).min() == 0.0
    for part in (0.0, 0.3, 0.999):
        u = begins + part / rows[:, 1]
        y = np.polynomial.polynomial.polyval(part, rows[:, 2:].T)
        assert_allclose(np.minimum(y, 1.0), curve.at(u), atol=1e-12)
    end = begins[-1] + 1 / rows[-1, 1]
    assert 1.0 - curve.at(np.array([end]))[0] <= 1e-13 < 1.0 - curve.at(begins[-2:-1])[0]


def test_curves_in_a_header_are_numbered_one_after_the_other() -> None:
    tables = [np.arange(20.0).reshape(2, 10), np.ones((3, 10))]
    constants: Any = SimpleNamespace(
        hysteresis_curve=((0, -1), (1, 0)),
        hysteresis_bend=((1.5, 0.0), (2.0, 3.0)),
        curves=[((0, 0, 1), tables[0]), ((0, 1, 2), tables[1])],
    )
    text = _curves(constants, "NG", lambda row: "{" + ", ".join(f"{x:g}" for x in row) + "}")
    assert "hysteresis_curve[ELEMENTS][NG] = {{0, -1}, {1, 0}};" in text
    assert "hysteresis_bend[ELEMENTS][NG] = {{1.5, 0}, {2, 3}};" in text
    assert "curve_part[3][3] = {{0, 0, 1}, {2, 3, 4}, {5, 5, 5}};" in text
    assert "curve_piece[5][10] = {\n    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9},\n    {10, 11," in text
    assert text.endswith("    {1, 1, 1, 1, 1, 1, 1, 1, 1, 1}};\n")


# --- graphs --------------------------------------------------------------------------------------
def value_of(graph: Graph, r: int, inputs: list[float]) -> float:
    """A reference by its operations."""
    node = r >> 1
    sign = -1.0 if r & 1 else 1.0
    kind = graph.kind[node]
    if kind == "constant":
        return sign * graph.value[node]
    if kind == "input":
        return sign * inputs[graph.operands[node][1]]
    x = [value_of(graph, operand, inputs) for operand in graph.operands[node]]
    ways = {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
    }
    ways |= {"fmin": min, "fmax": max, "pow": lambda a, b: a**b, "atan2": np.arctan2}
    ways["if_else_zero"] = lambda c, a: a if c else 0.0
    return sign * float((ways.get(kind) or getattr(np, kind))(*x))


def test_a_graph_computes_what_its_operations_say() -> None:  # noqa: C901
    """Random operations against numbers; each value is computed once, signs and constants are
    folded.
    """
    rng = np.random.default_rng(7)
    for _ in range(20):
        graph = Graph()
        inputs = rng.uniform(0.5, 2.0, 3).tolist()
        known = [(graph.input(0, k), x) for k, x in enumerate(inputs)]
        known += [(graph.constant(x), x) for x in (0.0, 1.0, -1.0, 2.5, -0.5)]
        for _ in range(60):
            (a, x), (b, y) = (known[k] for k in rng.integers(len(known), size=2))
            way = rng.integers(9)
            if way == 0:
                made = graph.add(a, b), x + y
            elif way == 1:
                made = graph.add(a, b ^ 1), x - y
            elif way == 2:
                made = graph.multiply(a, b), x * y
            elif way == 3 and y != 0.0:
                made = graph.divide(a, b), x / y
            elif way == 4:
                kind = ("sin", "cos", "tanh", "fabs", "atan")[rng.integers(5)]
                made = (
                    graph.call(kind, [a]),
                    float(
                        {"fabs": np.abs, "atan": np.arctan}.get(kind, getattr(np, kind, None))(x)
                    ),
                )
            elif way == 5:
                made = graph.call("fmin", [a, b]), min(x, y)
            elif way == 6:
                made = graph.call("pow", [a, graph.constant(2.0)]), x * x
            elif way == 7 and x * y != 0.0:
                made = graph.call("atan2", [a, b]), float(np.arctan2(x, y))
            else:
                made = graph.call("if_else_zero", [graph.input(0, 0), a]), x
            if abs(made[1]) < 1e3:
                known.append(made)
        for r, x in known:
            renamed = Graph(**vars(graph))
            assert value_of(renamed, r, inputs) == pytest.approx(x, rel=1e-9, abs=1e-12)


def test_a_graph_has_each_value_once() -> None:
    graph = Graph()
    a = graph.input(0, 0)
    b = graph.input(0, 1)
    two = graph.constant(2.0)
    half = graph.constant(0.5)
    assert graph.add(a, b) == graph.add(b, a) and graph.add(a, b ^ 1) == graph.add(b, a ^ 1) ^ 1
    assert graph.add(a, a ^ 1) == graph.constant(0.0) and graph.add(a, graph.constant(0.0)) == a
    assert graph.add(graph.constant(0.0), b) == b and graph.add(two, half) == graph.constant(2.5)
    assert graph.multiply(a, b) == graph.multiply(b, a) == graph.multiply(a ^ 1, b) ^ 1
    assert graph.multiply(two, graph.multiply(a, half)) == a  # constants meet
    assert graph.multiply(graph.constant(-3.0), graph.multiply(a, two)) == graph.multiply(
        graph.constant(-6.0), a
    )
    assert (
        graph.multiply(a, graph.constant(-1.0)) == a ^ 1
        and graph.multiply(a, graph.constant(0.0)) >> 1 in graph.value
    )
    assert graph.divide(a, two) == graph.multiply(half, a) and graph.divide(
        two, half
    ) == graph.constant(4.0)
    assert graph.divide(graph.constant(0.0), a) == graph.constant(0.0)
    assert (
        graph.kind[graph.divide(two, a) >> 1] == "div"
        and graph.kind[graph.divide(a, graph.constant(0.0)) >> 1] == "div"
    )
    assert graph.divide(a ^ 1, b) == graph.divide(a, b) ^ 1
    # its inverse is infinite
    assert graph.kind[graph.divide(a, graph.constant(5e-324)) >> 1] == "div"
    assert (
        graph.call("cos", [a ^ 1]) == graph.call("cos", [a])
        and graph.call("sin", [a ^ 1]) == graph.call("sin", [a]) ^ 1
    )
    assert graph.call("fmax", [b, a]) == graph.call("fmax", [a, b]) != graph.call("fmin", [a, b])
    assert graph.call("atan2", [b, a]) != graph.call("atan2", [a, b])
    assert graph.call("if_else_zero", [a, b ^ 1]) == graph.call("if_else_zero", [a, b]) ^ 1
    assert graph.call("pow", [a, two]) == graph.multiply(a, a) and graph.call(
        "sin", [two]
    ) == graph.constant(np.sin(2.0))
    assert (
        graph.call("sin", [two ^ 1]) == graph.constant(-np.sin(2.0))
        and graph.number(two ^ 1) == -2.0
    )
    assert graph.number(a) is None and np.isnan(graph.number(graph.constant(float("nan"))) or 0.0)
    deep = graph.call("exp", [graph.add(graph.divide(a, b), two)])
    assert graph.depth[deep >> 1] == LATENCY["div"] + LATENCY["add"] + LATENCY["exp"]
    assert graph.depth[graph.call("tan", [a]) >> 1] == OTHER_LATENCY and graph.depth[a >> 1] == 0
    graph.outputs.append((0, 0, graph.multiply(a, b)))
    alive = graph.alive()
    assert [k for k, x in enumerate(alive) if x] == sorted(
        [a >> 1, b >> 1, graph.multiply(a, b) >> 1]
    )


def test_an_equilibrium_of_small_torques_is_as_accurate() -> None:
    """Rows of 1e-9 N m: without their scale anything would be one."""
    q = ca.SX.sym("q", 2)
    rows = ca.vertcat(1e-9 * (q[0] ** 2 - 2 * q[1]), 1e3 * (q[1] - 1))
    function = ca.Function("rows", [q], [rows, ca.jacobian(rows, q)])
    assert_allclose(
        statics.solve_newton(function, np.array([1.2, 0.9]), [0, 1], "pose"),
        [np.sqrt(2), 1.0],
        rtol=1e-12,
    )
    none = ca.vertcat(1e-12 * (q[0] ** 2 + 1), q[1] - 1)
    with pytest.raises(SolverError, match=r"pose: not found, residual .* expected below 1e-9"):
        statics.solve_newton(
            ca.Function("none", [q], [none, ca.jacobian(none, q)]),
            np.array([1.2, 0.9]),
            [0, 1],
            "pose",
        )
    nothing = ca.Function("rows", [q], [rows + 1e3, ca.jacobian(rows, q) * 0])
    with pytest.raises(SolverError, match="pose: the equations are singular"):
        statics.solve_newton(nothing, np.array([1.0, 1.0]), [0, 1], "pose")


def test_rounding_of_ones_and_zeros_is_removed() -> None:
    x = np.array([1 - 1e-16, -1 + 2e-16, 3e-17, 0.5, 2.0])
    assert snap(x).tolist() == [1.0, -1.0, 0.0, 0.5, 2.0]
    assert snap(4 * x, 4.0).tolist() == [4.0, -4.0, 0.0, 2.0, 8.0]


@pytest.mark.parametrize(
    ("sd", "name", "text"),
    [
        (0.0123, "q1.stiffness", "1.2 %"),
        (0.0123, "arm1.com_x", "0.012"),
        (0.0123, "m1.offset", "0.012"),
        ("fixed", "m1.offset", "fixed"),
    ],
)
def test_deviations_of_numbers_with_a_sign_are_not_relative(sd: Any, name: str, text: str) -> None:
    assert identified._percent(sd, name) == text


def test_a_singular_pose_of_a_redundant_arm_is_stated_with_its_place() -> None:
    follower: Any = SimpleNamespace(free=np.array([0, 2]))
    # the free joints turn the output about one axis
    flat = np.array([[1.0, 5.0, 2.0], [2.0, 7.0, 4.0]])
    with pytest.raises(SolverError, match=r"a singular pose after 25 % of the path"):
        _Follower._solve_least_norm(follower, flat, np.array([1.0, 0.0]), 0.25)


def test_a_calibrated_model_is_of_the_variant_that_was_calibrated() -> None:
    model: Any = vars(Calibration)["model"]
    found = model.fget(
        SimpleNamespace(
            nominal=flexgen.read("planar5_nmp", "undamped"), changes={"motor.m1.inertia": 0.5}
        )
    )
    assert found.variant == "undamped" and found.motors[0].inertia == 0.5
    with pytest.raises(ArgumentError, match="given a model without a file"):
        model.fget(SimpleNamespace(nominal=SimpleNamespace(file="")))
