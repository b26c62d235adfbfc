"""Contents of tables of names: signals of a plan, joints of a URDF file, rows of sweeps, printed
sines.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from flexgen.analysis.printing import printing
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.exports.urdf import urdf
from flexgen.planning.optimal import problem as planned
from flexgen.planning.optimal.signals import Signals
from flexgen.studies.sweeps import worker


# --- planning ------------------------------------------------------------------------------------
def test_signals_of_a_plan_by_their_definitions() -> None:
    """Of an arm with a joint without motor: names, labels, units and values."""
    equations = derive("planar5_nmp")
    model = equations.model
    made = Signals(equations, with_path=True, tracked=False, name="_1")
    rng = np.random.default_rng(4)
    y, dy, ddy = (rng.normal(size=model.dof + 1) for _ in range(3))
    tau = rng.normal(size=model.n_m)
    time = 0.7
    names = list(made._signals)
    at = ca.Function("at", made.symbols, [made[name] for name in names])
    values = dict(
        zip(names, (np.array(x).ravel() for x in at(y, dy, ddy, tau, time, [])), strict=True)
    )
    n_a = model.n_a
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    motors = [model.n_a + k for k in range(model.n_m)]
    assert model.n_m == len(model.i_m) == 2 and len(i_e) == 1
    p, R = (np.array(x) for x in equations.function("forward_kinematics")(y[:n_a]))
    h = 1e-6
    ahead, behind = (
        [np.array(x) for x in equations.function("forward_kinematics")(y[:n_a] + s * h * dy[:n_a])]
        for s in (1, -1)
    )
    spin = (ahead[1] - behind[1]) / (2 * h) @ R.T
    expected = {
        "q_a": (y[:n_a], "rad"),
        "v_a": (dy[:n_a], "rad/s"),
        "a_a": (ddy[:n_a], "rad/s^2"),
        "q_m": (y[motors], "rad"),
        "v_m": (dy[motors], "rad/s"),
        "a_m": (ddy[motors], "rad/s^2"),
        "tau_m": (tau, "N m"),
        "power_m": (tau * dy[motors], "W"),
        "gear_deflection": (np.linalg.solve(model.eta, y[motors]) - y[i_g], "rad"),
        "elastic_deflection": (y[i_e], "rad"),
        "tool_position": (p.ravel(), "m"),
        "tool_rotation": (R.T.ravel(), "1"),
        "tool_velocity": ((ahead[0] - behind[0]).ravel() / (2 * h), "m/s"),
        "tool_turn_rate": ([spin[2, 1], spin[0, 2], spin[1, 0]], "rad/s"),
        "output": (np.array(equations.function("output")(y[:n_a])).ravel(), "m"),
        "time": ([time], "s"),
        "s": (y[-1:], "1"),
        "s_rate": (dy[-1:], "1/s"),
        "s_acceleration": (ddy[-1:], "1/s^2"),
    }
    assert list(values) == list(expected)
    for name, (value, unit) in expected.items():
        signal, entries = made.find(name)
        assert_allclose(values[name], value, atol=1e-7, err_msg=name)
        assert signal.units == (unit,) * len(entries) and len(entries) == len(
            signal.labels
        ) == len(values[name])
    arm = tuple(c.name for c in model.coordinates)
    motor = tuple(m.name for m in model.motors)
    assert made.find("a_a")[0].labels == arm and made.find("power_m")[0].labels == motor
    assert made.find(f"v_a[{arm[1]}]")[1] == [1]
    assert len(made) == len(expected) and made.reference.numel() == 0
    with pytest.raises(
        ArgumentError, match=r"^signal tool_position: given entry 'w', expected one of x, y, z"
    ):
        made.find("tool_position[w]")
    assert Signals(equations, with_path=False, tracked=True).reference.numel() == model.output.size


@pytest.mark.parametrize(("given", "seconds"), [(None, None), (0, None), (0.0, None), (2.5, 2.5)])
def test_a_plan_is_searched_within_its_time_limit(
    given: float | None, seconds: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zero: no limit."""
    asked: list[Any] = []

    class Began(Exception):
        pass

    def running(limit: float | None) -> Any:
        asked.append(limit)
        raise Began

    monkeypatch.setattr(planned, "running", running)
    made: Any = object.__new__(planned.PlanProblem)
    monkeypatch.setattr(planned.PlanProblem, "_rests", lambda self: [])
    vars(made).update(phases=[], parameters=[], equations=Made(model=Made(dof=2)))
    monkeypatch.setattr(planned, "Layout", lambda phases, parameters: Made(size=0))
    with pytest.raises(Began):
        made.solve(time_limit=given)
    assert asked == [seconds]


# --- exports -------------------------------------------------------------------------------------
def joint(**dof: Any) -> Any:
    """The element of a joint between two links."""
    friction = Made(viscous=dof.pop("viscous", 0.0), coulomb=dof.pop("coulomb", 0.0))
    mimic = dof.pop("mimic", None)
    given = {
        "name": "q1",
        "type": "rotation",
        "lower": None,
        "upper": None,
        "speed_max": None,
    } | dof
    made = Made(**given, axis=(0.0, 0.0, 1.0), friction=friction)
    step: Any = Made(
        dof=made if dof.get("type") != "none" else None,
        joint="j1",
        link="tip",
        position=(1.0, 2.0, 3.0),
        rotation=np.eye(3),
        mimic=mimic,
    )
    root = ElementTree.Element("robot")
    urdf._joint(root, step, "base", {"q1": 7.0})
    return root.find("joint")


def test_joints_of_a_file_have_the_kind_of_their_limits() -> None:
    most = repr(urdf.UNLIMITED)
    found = joint()
    assert (
        found.attrib == {"name": "j1", "type": "continuous"}
        and found.find("limit").get("lower") is None
    )
    assert found.find("parent").get("link") == "base" and found.find("child").get("link") == "tip"
    assert (
        float(found.find("limit").get("effort")) == 7.0
        and float(found.find("limit").get("velocity")) > 1e3
    )
    assert found.find("mimic") is None and found.find("dynamics") is None
    for given, kind, lower, upper in (
        ({"lower": -1.0}, "revolute", "-1.0", most),
        ({"upper": 2.0, "speed_max": 3.0}, "revolute", f"-{most}", "2.0"),
        ({"type": "translation"}, "prismatic", f"-{most}", most),
        ({"type": "translation", "lower": 0.0, "upper": 0.5}, "prismatic", "0.0", "0.5"),
    ):
        found = joint(**given)
        limit = found.find("limit")
        assert (found.get("type"), limit.get("lower"), limit.get("upper")) == (kind, lower, upper)
        assert ("speed_max" in given) is (float(limit.get("velocity")) == 3.0)
    assert joint(type="none").get("type") == "fixed" and joint(type="none").find("axis") is None
    mimic = urdf.UrdfMimic("q0", -2.0, 0.0, None, None, None, None)
    found = joint(name="q9", mimic=mimic, viscous=0.3)
    assert float(found.find("limit").get("effort")) == urdf.UNLIMITED
    assert found.find("mimic").get("offset") is None
    assert (
        found.find("mimic").get("joint") == "q0"
        and float(found.find("mimic").get("multiplier")) == -2.0
    )
    dynamics = {name: float(value) for name, value in found.find("dynamics").attrib.items()}
    assert dynamics == {"damping": 0.3, "friction": 0.0}
    assert joint(coulomb=0.2).find("mimic") is None
    mimic = urdf.UrdfMimic("q0", 1.0, 0.2, -1.0, 2.0, 3.0, 4.0)
    found = joint(mimic=mimic)
    assert found.get("type") == "revolute"
    assert float(found.find("mimic").get("offset")) == 0.2
    limits = {name: float(value) for name, value in found.find("limit").attrib.items()}
    assert limits == {"effort": 4.0, "velocity": 3.0, "lower": -1.0, "upper": 2.0}


# --- sweeps --------------------------------------------------------------------------------------
def test_a_worker_solves_a_case_with_the_options_of_the_sweep(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a time limit where none is given; any error becomes the row of the case."""
    asked: list[Any] = []

    def solve(equations: Any, move: str, method: str, **options: Any) -> Any:
        asked.append((equations, move, method, options))
        if move == "bad":
            raise ZeroDivisionError("0")
        if move == "refused":
            raise ArgumentError("move: given refused")
        return Made(interrupted=move == "stopped")

    monkeypatch.setattr(worker, "solve", solve)
    monkeypatch.setattr(worker, "_row", lambda solution: {"move": "done"})
    monkeypatch.setattr(worker, "failed_row", lambda reason: {"failed": reason})
    monkeypatch.setattr(worker, "_equations", lambda key, robot: (key, robot))

    def one(move: str, robot: Any = 1.5, **options: Any) -> Any:
        job: Any = Made(number=1, key="a", method="lq", move_of=lambda robot: move)
        row, took = worker._one(job, Made(robots={"a": robot}, options=options))
        assert set(took) == {"wall", "cpu"} and all(0.0 <= value < 5.0 for value in took.values())
        return row

    assert one("line", batch=True, samples=9) == {"move": "done"}
    assert asked.pop() == (("a", 1.5), "line", "lq", {"time_limit": None, "samples": 9})
    assert one("line", time_limit=3.0) == {"move": "done"} and asked.pop()[3] == {
        "time_limit": 3.0
    }
    assert one("line", "no such file") == {"failed": "no such file"} and len(asked) == 0
    assert one("refused") == {"failed": "move: given refused"}
    assert one("bad") == {"failed": "ZeroDivisionError: 0"}
    with pytest.raises(KeyboardInterrupt):
        one("stopped")


def test_a_worker_keeps_the_equations_of_the_last_two_models(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[str] = []

    def derive(robot: str) -> str:
        made.append(robot)
        return robot.upper()

    monkeypatch.setattr(worker, "derive", derive)
    monkeypatch.setattr(worker, "_EQUATIONS", type(worker._EQUATIONS)())
    keys: Any = ["a", "b", "a", "c", "a", "b"]
    assert [worker._equations(key, key) for key in keys] == ["A", "B", "A", "C", "A", "B"]
    assert made == ["a", "b", "c", "b"]


# --- equations as text ---------------------------------------------------------------------------
def test_sines_are_printed_with_their_abbreviations_and_powers() -> None:
    q, w = sp.symbols("q1 w")
    latex = printing._Latex({sp.sin(q): "s_{1}"}, {q: "q_1", w: r"\omega"})
    assert latex.doprint(sp.sin(q)) == "s_{1}" and latex.doprint(sp.sin(q) ** 3) == "s_{1}^{3}"
    assert latex.doprint(sp.cos(w)) == r"\cos\left(\omega\right)"
    assert latex.doprint(sp.cos(w) ** 2) == r"\cos^{2}\left(\omega\right)"
    text = printing._Text({sp.sin(q): "s1"})
    assert text.doprint(sp.sin(q) ** 2 * sp.cos(w)) == "s1**2*cos(w)"
    piecewise = sp.Piecewise((q, sp.Abs(q) < w), (2 * q, True))
    assert text.doprint(piecewise) == "{ q1 if Abs(q1) < w; 2*q1 otherwise }"
    assert printing._condition(text, sp.StrictGreaterThan(w, sp.Abs(q))) == "Abs(q1) < w"
    assert printing._condition(text, sp.StrictGreaterThan(w, q)) == "w > q1"
    assert printing.escape_latex("a_b\n50 % \u2013 \u4e2d") == r"a\_b 50 \% -- ?"
