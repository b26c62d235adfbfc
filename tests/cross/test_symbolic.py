"""The closed-form equations: against a published closed form, against the CasADi equations, and as
text and LaTeX.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.spatial.transform import Rotation
from unchecked import unchecked

import flexgen
from flexgen.analysis.printing.equations import SymbolicEquations, symbolic
from flexgen.analysis.printing.printing import escape_latex
from flexgen.analysis.printing.trigonometric import TrigonometricRing, accumulate_angles
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import (
    BacklashSpring,
    Beam,
    Bending,
    Body,
    CubicSpring,
    Dof,
    Element,
    Friction,
    Gear,
    LinearSpring,
    Motor,
    Output,
    PiecewiseSpring,
    Placement,
    RobotModel,
    SmoothSpring,
    Tool,
)
from flexgen.model.reader import read

GOLDEN = Path(__file__).parents[1] / "golden" / "elbow.txt"
ROUNDING = 1e-12  # of the largest entry: the same formulas, summed in another order
STATES = 10
FRICTION = Friction(viscous=0.3, coulomb=0.8, stribeck=0.4, alpha=2.0, beta=5.0, offset=0.1)
RIGID = Gear(rigid=True)


def place(position=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)) -> Placement:
    rows = Rotation.from_euler("xyz", rpy).as_matrix()
    return Placement(tuple(position), tuple(tuple(float(x) for x in row) for row in rows))


def body(
    mass: float, com, moments=(2.0, 3.0, 4.0), products=(0.0, 0.0, 0.0), drag: float = 0.0
) -> Body:
    (xx, yy, zz) = moments
    (xy, yz, xz) = products
    return Body(mass, tuple(com), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), drag)


def unit(*axis: float) -> tuple[float, ...]:
    return tuple(float(x) for x in np.array(axis) / np.linalg.norm(axis))


def elastic(spring, side: str = "arm", damping: float = 3.0) -> Gear:
    return Gear(False, side, spring, damping)


def robot(name: str, elements, motors, **more) -> RobotModel:
    return RobotModel(
        name=name,
        description=more.pop("description", "for a test"),
        source=more.pop("source", ""),
        gravity=more.pop("gravity", (0.0, 0.0, -9.81)),
        base=more.pop("base", Placement()),
        elements=tuple(elements),
        motors=tuple(motors),
        tool=more.pop("tool", place((0.1, 0.2, 0.3))),
        payload=more.pop("payload", Body()),
        output=Output("tool_position"),
        home=(),
        moves=(),
        **more,
    )


def skew() -> RobotModel:
    """Skew axes, a translation, a tilted base, gravity in no direction of the frame, full
    inertias, a payload, drag.
    """
    dofs = [
        Dof(
            "turn",
            "rotation",
            unit(0.6, 0.0, 0.8),
            elastic(LinearSpring(900.0)),
            friction=FRICTION,
        ),
        Dof("slide", "translation", (0.0, -1.0, 0.0), elastic(CubicSpring(500.0, 70.0), "motor")),
        Dof("bend", "rotation", unit(1.0, 2.0, 3.0), spring=CubicSpring(300.0, 40.0), damping=2.0),
    ]
    elements = [
        Element(
            "trunk",
            (dofs[0],),
            place((0.1, 0.0, 0.4), (0.0, 0.7, 0.0)),
            body=body(8.0, (0.1, 0.0, 0.2), drag=0.5),
        ),
        Element(
            "rail",
            (dofs[1],),
            place((0.0, 0.3, 0.0), (np.pi / 2, 0.0, np.pi)),
            body=body(5.0, (0.0, 0.2, 0.0)),
        ),
        Element(
            "hand",
            (dofs[2],),
            link=place((0.0, 0.0, 0.5)),
            body=body(3.0, (0.0, 0.1, 0.2), products=(0.1, 0.2, 0.3)),
        ),
    ]
    motors = [
        Motor("a", 0.01, ("turn",), (80.0,), FRICTION),
        Motor("b", 0.02, ("slide",), (-300.0,)),
    ]
    payload = body(4.0, (0.0, 0.1, 0.3), (0.2, 0.3, 0.25))
    return robot(
        "skew",
        elements,
        motors,
        base=place((1.0, 2.0, 3.0), (0.3, -0.2, 0.5)),
        gravity=(1.0, -2.0, -9.0),
        payload=payload,
    )


def anthropomorphic(coupling: str = "simplified", rigid: bool = False) -> RobotModel:
    """Waist, shoulder and elbow with a coupled pair of motors; motor side and nonlinear
    springs.
    """
    smooth = SmoothSpring(200.0, 900.0, 0.05)
    piecewise = PiecewiseSpring(300.0, 700.0, 0.04)
    dofs = [
        Dof("q1", "rotation", (0.0, 0.0, 1.0), RIGID if rigid else elastic(smooth, "motor")),
        Dof("q2", "rotation", (0.0, 1.0, 0.0), elastic(piecewise), friction=Friction(viscous=0.7)),
        Dof("q3", "rotation", (0.0, 1.0, 0.0), elastic(BacklashSpring(400.0, 0.03, 0.001))),
    ]
    elements = [
        Element("waist", (dofs[0],), body=body(20.0, (0.0, 0.0, 0.2))),
        Element("upper", (dofs[1],), place((0.1, 0.0, 0.5)), body=body(10.0, (0.2, 0.0, 0.0))),
        Element(
            "fore",
            (dofs[2],),
            place((0.6, 0.0, 0.0)),
            body=body(6.0, (0.3, 0.0, 0.0), (0.1, 0.4, 0.4)),
        ),
    ]
    motors = [
        Motor("m1", 0.01, ("q1",), (-60.0,), FRICTION, (0.0, 0.0, 1.0), "base"),
        Motor("m2", 0.02, ("q2", "q3"), (50.0, 1.0), FRICTION, (0.0, 1.0, 0.0), "waist"),
        Motor("m3", 0.03, ("q2", "q3"), (20.0, -40.0), FRICTION, unit(1.0, 1.0, 0.0), "upper"),
    ]
    return robot("arm", elements, motors, motor_coupling=coupling)


@cache
def model_of(name: str) -> RobotModel:
    """Models of the tests by name; others are files of the collection."""
    if name == "skew":
        return skew()
    if name == "tree":
        arm = anthropomorphic("complete")
        tool = Tool(arm.tool.position, arm.tool.rotation, "upper")
        return replace(
            arm, elements=(*arm.elements[:2], replace(arm.elements[2], parent="waist")), tool=tool
        )
    if name.startswith("arm-"):
        return anthropomorphic("complete" if "complete" in name else "simplified", "rigid" in name)
    return read(name)


@cache
def closed(name: str) -> SymbolicEquations:
    return symbolic(model_of(name))


FILES = ["elbow", "elbow@rigid", "planar5_mp", "planar5_nmp"]
SYNTHETIC = ["skew", "tree", "arm-simplified", "arm-complete", "arm-complete-rigid"]


def states(model: RobotModel, n: int = STATES):
    """Random q_a, v_a, a_a, q_m, v_m, a_m; motors behind rigid gears follow, others are somewhat
    off.
    """
    rng = np.random.default_rng(3)
    for _ in range(n):
        arm = [rng.uniform(-2.0, 2.0, model.n_a) for _ in range(3)]
        motors = []
        for k, x in enumerate(arm):
            follow = model.eta @ x[list(model.i_g)]
            off = model.eta @ rng.uniform(-0.1, 0.1, model.n_g)
            motors.append(
                follow
                + np.where(np.isin(range(model.n_m), model.i_m), off, 0.0) * (1 if k == 0 else 5)
            )
        yield (*arm, *motors)


def assert_close(found, expected, scale=None) -> None:
    found = np.asarray(found, dtype=float).ravel()
    expected = np.asarray(expected, dtype=float).ravel()
    scale = np.abs(expected).max() if scale is None else scale
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=ROUNDING * max(scale, 1e-3))


@pytest.mark.parametrize("name", FILES + SYNTHETIC)
def test_agrees_with_the_casadi_equations(name):
    model = model_of(name)
    equations = derive(model_of(name))
    found = closed(name)
    tool = found.function(found.tool)
    for q, v, a, *_ in states(model):
        M, c, g = found.numeric(q, v)
        assert_close(M, equations.function("mass_matrix")(q))
        scale = np.abs(M).max() + np.abs(c + g).max()
        assert_close(c + g, equations.function("bias")(q, v), scale)
        assert_close(g, equations.function("gravity")(q))
        assert_close(M @ a + c + g, equations.function("inverse_dynamics")(q, v, a))
        assert_close(
            tool(q)[0], equations.function("forward_kinematics")(q)[0], 1.0 + np.abs(q).max()
        )


@pytest.mark.parametrize("name", FILES + SYNTHETIC)
def test_whole_machine_agrees_with_the_casadi_residual(name):
    model = model_of(name)
    residual = derive(model_of(name)).function("residual")
    found = closed(name)
    n = model.n_a
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    held = {s: 0 for s, torque in zip(found.tau, found.torques, strict=True) if torque is None}
    torques = sp.Matrix([0 if torque is None else torque for torque in found.torques])
    arm = (
        found.M * sp.Matrix(found.a_a)
        + found.S * sp.Matrix(found.a_m)
        + found.c
        + found.g
        + found.friction
    )
    machine = found.function(
        arm + found.drag - torques, sp.Matrix(found.motor_equations).xreplace(held)
    )
    for state in states(model):
        tau_m = np.linspace(5.0, 9.0, model.n_m)
        r_a, left = (x.ravel() for x in machine(*state))
        r_m = left - tau_m
        # a rigid gear hands the motor's torque to the arm
        r_a[list(model.i_g)] += model.eta[rigid].T @ r_m[rigid]
        r_m[rigid] = 0.0
        expected = [np.asarray(x, dtype=float).ravel() for x in residual(*state, tau_m)]
        scale = np.abs(np.concatenate(expected)).max()
        assert r_a.size == n
        assert_close(r_a, expected[0], scale)
        assert_close(r_m, expected[1], scale)


def test_elbow_is_the_published_closed_form():
    m1 = 339.12
    xi1 = 0.441
    j1 = 88.67
    l1 = 1.150
    m2 = 190.25
    xi2 = 0.465
    j2 = 48.64
    for q, v, *_ in states(model_of("elbow")):
        (s1, s2) = np.sin(q)
        c2 = np.cos(q[1])
        c12 = np.cos(q[0] + q[1])
        M12 = j2 + m2 * (xi2**2 - l1 * xi2 * s2)
        M11 = j1 + m1 * xi1**2 + j2 + m2 * (l1**2 + xi2**2 - 2 * l1 * xi2 * s2)
        c = m2 * l1 * xi2 * c2 * np.array([-(2 * v[0] * v[1] + v[1] ** 2), v[0] ** 2])
        g = -9.81 * np.array([m1 * xi1 * s1 + m2 * (l1 * s1 + xi2 * c12), m2 * xi2 * c12])
        found = closed("elbow").numeric(q, v)
        for one, other in zip(found, ([[M11, M12], [M12, j2 + m2 * xi2**2]], c, g), strict=True):
            assert_close(one, other)


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp", "abb_arm", "four_mass"])
def test_output_is_the_one_that_is_followed(name):
    found = closed(name)
    output = derive(model_of(name)).function("output")
    y = found.function(found.output)
    for q, *_ in states(found.model):
        assert_close(y(q)[0], output(q), 1.0 + np.abs(q).max())


def test_declared_output_is_printed():
    text = closed("elbow").text()
    assert (
        "declared output y:  y = (p[1], p[3])" in text and "y_{1}" not in closed("elbow").latex()
    )
    text = closed("four_mass").text()
    assert "Declared output y, m\n\n  y[1] = 2.13*e2 + 1.53*e3 + 2.15*q1\n" in text
    assert "Position of the tool" not in text
    assert r"y_{1} &= 2.13\,e_{2} + 1.53\,e_{3} + 2.15\,q_{1}" in closed("four_mass").latex()
    pose = symbolic(replace(model_of("elbow"), output=Output("tool_pose")))
    assert "y = (p[1], p[2], p[3]) and the rotation" in pose.text()
    check_latex(pose.latex())


def test_coordinates_of_one_number_keep_their_names():
    found = closed("abb_arm")
    text = found.text()
    tex = found.latex()
    check_latex(tex)
    assert "(2)" not in text and "(2)" not in tex
    assert [s.name for s in (*found.v_a, *found.a_a, *found.tau)] == [
        f"{head}_{name}" for head in ("v", "a", "tau") for name in ("q1", "e1")
    ]
    assert r"\tau_{\mathrm{e1}} &= " in tex and "v_{1}" not in tex
    assert [s.name for s in closed("elbow").v_a] == ["v1", "v2"]
    elbow = model_of("elbow")
    motor = symbolic(
        unchecked(elbow, motors=(unchecked(elbow.motors[0], name="1"), elbow.motors[1]))
    )
    assert [s.name for s in (*motor.tau, *motor.tau_m)] == [
        "tau_1",
        "tau_2",
        "tau_1_motor",
        "tau_m2",
    ]


def test_gravity_vector_and_its_strength_have_different_names():
    found = closed("elbow")
    assert "g_0" in {entry.symbol.name for entry in found.entries} and r"g_{0}" in found.latex()
    assert not {entry.symbol.name for entry in found.entries} & {"g", "M", "c"}


def test_a_wrong_sign_would_be_seen():
    found = closed("elbow")
    q = np.array([0.3, -0.8])
    v = np.array([1.0, 0.5])
    wrong = found.function(found.M.xreplace({found.q_a[1]: -found.q_a[1]}))(q)[0]
    with pytest.raises(AssertionError):
        assert_close(wrong, found.numeric(q, v)[0])


def test_symbolic_equations_share_no_code_with_the_casadi_equations():
    own = {"equations", "chain", "elements", "trigonometric", "printing"}
    for name in own:
        source = (
            Path(flexgen.__file__).parent / "analysis" / "printing" / f"{name}.py"
        ).read_text(encoding="utf-8")
        assert "import casadi" not in source and "from casadi" not in source
        assert set(re.findall(r"from flexgen\.equations_text\.(\w+) import", source)) <= own
        assert (
            "flexgen.dynamics.mechanics" not in source
            and "flexgen.codegen.recursion" not in source
        )


@pytest.mark.slow
def test_complete_coupling_depends_on_the_motors():
    found = closed("arm-complete")
    q, v, _, _, v_m, _ = next(states(found.model))
    assert any(found.S)
    assert np.abs(found.numeric(q, v, v_m)[1] - found.numeric(q, v)[1]).max() > 1e-3
    assert not any(closed("arm-simplified").S)


@pytest.mark.slow
def test_symbolic_equations_of_planar5_mp_are_short_and_take_at_most_10_seconds():
    start = time.process_time()
    found = symbolic(model_of("planar5_mp"))
    assert time.process_time() - start < 10.0
    assert sp.count_ops(found.M) < 150 and sp.count_ops(found.c) < 100
    assert found.tool[2] == 0


def test_squares_of_absolute_angles_are_found():
    m, length, x, q1, q2 = (sp.Symbol(name, real=True) for name in ("m", "l", "x", "q1", "q2"))
    ring = TrigonometricRing(
        [m, length, x], [q1, q2], heavy=[m], absolute=accumulate_angles([0, 1])
    )
    cos_sum = ring.cos(q1) * ring.cos(q2) - ring.sin(q1) * ring.sin(q2)
    radius = ring.element(length) * ring.cos(q1) + ring.element(x) * cos_sum
    found = ring.expression(ring.reduce(ring.element(m) * radius**2))
    assert found == m * (length * sp.cos(q1) + x * sp.cos(q1 + q2)) ** 2


def test_text_of_the_elbow_is_as_recorded():
    text = closed("elbow").text()
    if os.environ.get("FLEXGEN_UPDATE_GOLDEN") == "1":
        GOLDEN.parent.mkdir(exist_ok=True)
        GOLDEN.write_text(text, encoding="utf-8")
    assert text == GOLDEN.read_text(encoding="utf-8")


def test_rows_of_the_equations_have_the_numbers_of_their_matrix():
    """Of the coupling of rotors and arm, which the elbow does not have: three motors of two
    coordinates.
    """
    found = closed("elbow")
    S = sp.Matrix(2, 3, lambda i, j: sp.Symbol(f"s{i + 1}{j + 1}"))
    lines = replace(found, S=S, q_m=(*found.q_m, found.q_m[0])).text().splitlines()
    assert [line.split() for line in lines if line.strip().startswith("S[")] == [
        [f"S[{i},{j}]", "=", f"s{i}{j}"] for i in (1, 2) for j in (1, 2, 3)
    ]


def check_latex(text: str) -> None:
    """Braces, dollars and environments are balanced; nothing but letters of the Latin script."""
    bare = re.sub(r"\\[\\{}$]", "", text)
    depth = 0
    for character in bare:
        depth += {"{": 1, "}": -1}.get(character, 0)
        assert depth >= 0
    assert depth == 0
    assert bare.count("$") % 2 == 0
    opened: list[str] = []
    for kind, environment in re.findall(r"\\(begin|end)\{(\w+\*?)\}", text):
        if kind == "begin":
            opened.append(environment)
        else:
            assert opened.pop() == environment
    assert not opened
    for left, right in (("left", "right"), ("bigl", "bigr")):
        assert len(re.findall(rf"\\{left}\b", text)) == len(re.findall(rf"\\{right}\b", text))


@pytest.mark.parametrize("name", FILES + SYNTHETIC)
def test_latex_is_well_formed(name):
    text = closed(name).latex()
    check_latex(text)
    assert text.startswith("\\documentclass") and text.endswith("\\end{document}\n")
    assert "Dummy" not in text and "\\left\\{\\begin{matrix}" not in text


HOSTILE = (
    "x} \\input{/etc/passwd} \\end{document} $^^5cwrite18{rm}$ % & # _ ~ <\n\n\\par \x00 é \u03b1"
)


def test_hostile_text_cannot_become_a_command():
    elbow = model_of("elbow")
    first, second = elbow.elements
    dof = replace(first.dofs[0], name=HOSTILE)
    motors = (replace(elbow.motors[0], name=HOSTILE, drives=(HOSTILE,)), elbow.motors[1])
    elements = (replace(first, name=HOSTILE, dofs=(dof,)), second)
    model = unchecked(
        elbow,
        name=HOSTILE,
        description=HOSTILE,
        source=HOSTILE,
        variant=HOSTILE,
        elements=elements,
        motors=motors,
    )
    found = symbolic(model)
    text = found.latex()
    check_latex(text)
    for command in ("\\input", "\\write", "\\par\n", "\\par ", "^^", "\\end{document} "):
        assert command not in text
    assert text.count("\\end{document}") == 1 and "%" not in text.replace("\\%", "")
    lines = found.text().splitlines()
    assert len(lines) == len(closed("elbow").text().splitlines()) - 9  # no abbreviations
    q = np.array([0.3, -0.8])
    v = np.array([1.0, 0.5])
    for one, other in zip(found.numeric(q, v), closed("elbow").numeric(q, v), strict=True):
        assert_close(one, other)


def test_escaping_is_invertible_where_it_must_be():
    assert escape_latex("50 % of a_b & {c}") == r"50 \% of a\_b \& \{c\}"
    assert (
        escape_latex("a\n\\b^c~d") == r"a \textbackslash{}b\textasciicircum{}c\textasciitilde{}d"
    )
    assert escape_latex("Türk \u2013 1990 \u65e5") == "Türk -- 1990 ?"


def test_equal_names_are_kept_apart():
    twice = replace(model_of("elbow"), payload=body(7.0, (0.1, 0.0, 0.0)))
    first, second = twice.elements
    model = replace(twice, elements=(replace(first, name="payload"), second))
    names = [entry.symbol.name for entry in symbolic(model).entries]
    assert len(names) == len(set(names)) and "m_payload_(2)" in names


def test_refusals():
    elbow = model_of("elbow")
    first, second = elbow.elements
    beam = Beam(1.0, 2.0, (Bending("y", 500.0, 1, 0.01),))
    with pytest.raises(ArgumentError, match=r"given beams \(fore\), expected rigid bodies"):
        symbolic(replace(elbow, elements=(first, replace(second, beam=beam))))
    with pytest.raises(ArgumentError, match=r"6 arm coordinates, expected at most 4 .*CasADi"):
        symbolic(read("manutec_r3"))


def test_a_model_too_large_is_refused_within_seconds():
    rng = np.random.default_rng(1)
    elements = [
        Element(
            f"e{k}",
            (Dof(f"q{k}", "rotation", unit(*rng.normal(size=3)), spring=LinearSpring(1.0)),),
            place(rng.normal(size=3), rng.normal(size=3)),
            body=body(1.0, rng.normal(size=3), products=(0.1, 0.2, 0.3)),
        )
        for k in range(4)
    ]
    start = time.process_time()
    with pytest.raises(ArgumentError, match=r"more than .* terms"):
        symbolic(robot("hopeless", elements, []))
    assert time.process_time() - start < 20.0
