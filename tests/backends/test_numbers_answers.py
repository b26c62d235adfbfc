"""Answers that are asked for with wrong or rare arguments: cards, frictions, files of others,
methods of the lab.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.backends.cuda import inversion
from flexgen.backends.cuda.inversion import CudaManyInverter, workspace_of
from flexgen.base.errors import ArgumentError
from flexgen.cli.result import check_own
from flexgen.codegen.recursion.functions import operations_of
from flexgen.dynamics.hysteresis.hysteresis import elements_of, gear_hysteresis, gear_layers
from flexgen.dynamics.mechanics.force_laws import friction_torque
from flexgen.inversion.comparison import bdf
from flexgen.model.friction import GearFriction
from flexgen.runtime.inversion.many_inversion import InversionOptions
from flexgen.views.reports import texts


# --- cards ---------------------------------------------------------------------------------------
def made_inverter(parameters: int) -> Any:
    made: Any = object.__new__(CudaManyInverter)
    made._inverter = Made(_parameters=np.arange(float(parameters)), _refuse_closed=lambda: None)
    made._card = "card"
    made._stream = None
    return made


def test_a_workspace_is_at_most_an_eighth_larger_than_it_must_be() -> None:
    for reals in range(1, 3000):
        found = workspace_of(reals)
        assert reals <= found <= reals * 9 / 8
    assert len({workspace_of(x) for x in range(1024, 2049)}) == 9 and workspace_of(16) == 16


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"period": 0.0}, "invert_many, period: given 0, expected a number above 0, below 1e6 s"),
        (
            {"period": 1e6},
            "invert_many, period: given 1e+06, expected a number above 0, below 1e6 s",
        ),
        ({"outputs": "tau_m"}, "invert_many, outputs: given 'tau_m', expected some of "),
        (
            {"outputs": ("tau_m", "x")},
            "invert_many, outputs: given ('tau_m', 'x'), expected some of ",
        ),
        (
            {"parameters": [1.0]},
            "invert_many, parameters: given to a library without run-time parameters",
        ),
        (
            {"options": InversionOptions(workers=2)},
            "invert_many, workers: given 2 on the card, expected None; use it ",
        ),
        (
            {"options": InversionOptions(growth=True)},
            "invert_many, growth: given True on the card, expected False; ",
        ),
    ],
)
def test_problems_that_a_card_refuses(given: dict[str, Any], said: str) -> None:
    usual: dict[str, Any] = {"period": 1e-3, "q_start": None}
    with pytest.raises(ArgumentError) as refused:
        made_inverter(0)(None, None, None, **(usual | given))
    assert str(refused.value).startswith(said)


@pytest.mark.parametrize("count", [0, 3])
def test_arguments_of_a_card_are_released_and_parameters_are_those_of_the_model(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Any] = []

    class Given:
        def __init__(self, card: str, function: str, name: str, x: Any, stream: int) -> None:
            self.name = name
            self.x = x

        def release(self) -> None:
            seen.append(self.name)

    made = made_inverter(count)
    made._on_card = lambda x, stream: x.tolist()
    made._demand = lambda given: ({name: one.x for name, one in given.items()}, 7)
    made._solve = lambda given, own, problems, period, kept, chosen: (own, problems, period, kept)
    monkeypatch.setattr(inversion, "Given", Given)
    outputs = ("q_m", "tau_m")
    own, problems, period, kept = made("y", "dy", "ddy", period=2e-3, q_start="q", outputs=outputs)
    assert own == {"y": "y", "dy": "dy", "ddy": "ddy", "q_start": "q"} | (
        {"parameters": [0.0, 1.0, 2.0]} if count else {}
    )
    assert (problems, period, sorted(kept)) == (7, 2e-3, sorted(outputs)) and seen == list(own)
    known = ", parameters=None" * bool(count)
    assert (
        repr(made)
        == f"invert_many(y, dy, ddy, *, period, q_start{known}, outputs=('tau_m',), options=None)"
    )


# --- friction and hysteresis ---------------------------------------------------------------------
def test_frictions_say_what_they_lack() -> None:
    w = ca.SX.sym("w")
    law = GearFriction(coulomb=0.1, beta=2.0, load_coulomb=0.5, load_smoothing=0.3)
    for load, temperature, missing in (
        (ca.SX(1.0), None, "the temperature"),
        (None, 20.0, "the torque of the gear"),
        (None, None, "the temperature"),
    ):
        with pytest.raises(ArgumentError) as refused:
            friction_torque(law, w, load, temperature)
        assert (
            str(refused.value)
            == f'friction: given type = "gear" without {missing}, on which it depends'
        )
    friction_torque(GearFriction(coulomb=0.1, beta=2.0), w, None, 20.0)  # not loaded
    other: Any = 3.0
    with pytest.raises(ArgumentError) as refused:
        friction_torque(other, w, None, 20.0)
    assert str(refused.value) == "friction: given a float, expected a law with a method torque"


def test_layers_are_the_elements_of_all_gears_one_after_the_other() -> None:
    """Slip is half the lost motion times the stiffness of the spring; both grow with the square of
    the ratio.
    """
    elements = [
        {"stiffness": 2e5, "lost_motion": 1e-4},
        {"stiffness": 1e5, "lost_motion": 4e-4, "exponent": 3.0},
    ]
    changes = {
        "element.upper.dof.q1.gear.hysteresis": elements,
        "element.fore.dof.q2.gear.hysteresis": elements[0],
    }
    plain = flexgen.read("elbow")
    names = {dof.name: element.name for element in plain.elements for dof in element.dofs}
    changes = {key.replace("fore", names["q2"]): value for key, value in changes.items()}
    model = flexgen.read("elbow", overrides=changes)
    springs: Any = [
        dof.gear.spring
        for element in plain.elements
        for dof in element.dofs
        if dof.gear is not None
    ]
    k = [spring.stiffness for spring in springs]
    first, second = gear_layers(model)
    assert_allclose(first.stiffness, [2e5, 2e5])
    assert_allclose(second.stiffness, [1e5, 0.0])
    assert_allclose(first.slip, [1e-4 * k[0] / 2, 1e-4 * k[1] / 2], rtol=1e-14)
    assert_allclose(second.slip, [4e-4 * k[0] / 2, 0.0], rtol=1e-14)
    whole = gear_hysteresis(model)
    assert_allclose(whole.stiffness, [3e5, 2e5])
    assert_allclose(whole.slip, [5e-4 * k[0] / 2, 1e-4 * k[1] / 2], rtol=1e-14)
    (none,) = gear_layers(plain)
    assert not none.stiffness.any() and not none.slip.any()
    one = model.elements[0].dofs[0].gear.hysteresis  # type: ignore[union-attr]
    assert (
        elements_of(None) == ()
        and len(elements_of(one)) == 2
        and elements_of(elements_of(one)[0]) == one[:1]
    )  # type: ignore[index]


# --- operations ----------------------------------------------------------------------------------
def test_operations_are_sums_products_roots_and_signs() -> None:
    x = ca.SX.sym("x")
    y = ca.SX.sym("y")
    for expression, count in (
        (x + y, 1),
        (ca.sin(x) * y, 1),
        (ca.sqrt(x) / y - x * x, 4),
        (-ca.cos(x), 1),
        (2 * x + 1 / y, 3),
        (ca.exp(x), 0),
        (ca.tanh(x + 1), 1),
    ):
        assert operations_of(ca.Function("f", [x, y], [expression])) == count, expression


# --- files and texts -----------------------------------------------------------------------------
def test_files_of_others_are_not_replaced(tmp_path: Path) -> None:
    own = tmp_path / "own.html"
    other = tmp_path / "other.html"
    own.write_bytes(b"x" * 4091 + b"marks" + b"y")
    other.write_bytes(b"x" * 4092 + b"marks")
    for path in (None, tmp_path / "new.html", tmp_path, own):
        check_own(path, b"marks")
    with pytest.raises(ArgumentError) as refused:
        check_own(other, b"marks")
    assert str(refused.value) == (
        f"output: given {str(other)!r}, a file that flexgen did not write, expected a new one "
        "or one of its own; choose another name, or move that file away"
    )


@pytest.mark.parametrize(("modes", "slow", "cached"), [([3.5, 9.0], 0.25, False), ([], 0.0, True)])
def test_the_steps_of_a_robot_in_figures(
    modes: list[float], slow: float, cached: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = {
        "modes_hz": modes,
        "unstable_time_constant_s": slow,
        "phase": "flat",
        "structural_index": 3,
    }
    analysis: Any = Made(model=Made(title="r@v", n_m=2, dof=5), to_dict=lambda: facts)
    library: Any = Made(functions=[1, 2, 3], cached=cached, seconds=12.5)
    rows: list[Any] = []
    monkeypatch.setattr(texts, "figures", rows.extend)
    monkeypatch.setattr(texts, "figure_rows", lambda solution: [("own", 1.0, "m")])
    checked = {"call_us": 1.5, "difference_Nm": 1e-12}
    solution: Any = Made(move=Made(name="line"))
    texts.steps_text(analysis, library, checked, solution, 60.0)
    found = {name: (value, unit) for name, value, unit in rows}
    assert found["lowest mode"] == (3.5 if modes else None, "Hz") and found["model"] == ("r@v", "")
    assert found["slowest unstable zero"] == (4.0 if slow else None, "1/s")
    assert found["C library built in"] == (None if cached else 12.5, "s")
    assert found["motors, degrees of freedom"] == ("2, 5", "") and found[
        "C functions generated"
    ] == (3, "")
    assert found["C inverse_dynamics, one call from Python"] == (1.5, "us")
    assert rows[-1] == ("total time, wall", 60.0, "s") and ("own", 1.0, "m") in rows


# --- methods of the lab --------------------------------------------------------------------------
@pytest.mark.parametrize(("options", "order"), [({}, 2), ({"order": 4, "richardson": True}, 4)])
def test_differences_have_a_fifth_of_the_step_and_a_stable_order(
    options: dict[str, Any], order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    problem: Any = Made(
        options=options,
        step=1e-3,
        path="path",
        equilibrium="rest",
        check_options=lambda *names: asked.append(names),
    )
    found = Made(x="x", dx="dx", iterations=9)

    def run(name: str, *given: Any) -> Any:
        asked.append((name, *given[2:]))
        return found

    for name in ("march", "extrapolate"):
        monkeypatch.setattr(bdf, name, partial(run, name))
    monkeypatch.setattr(
        bdf,
        "check_causal",
        lambda problem, *given, **named: asked.append((*given, *named.values())),
    )
    monkeypatch.setattr(bdf, "dae_of", lambda problem: Made(pack=lambda rest: f"packed {rest}"))
    monkeypatch.setattr(bdf, "instants", lambda problem, step: np.array([0.0, step]))
    monkeypatch.setattr(bdf, "zeros_along", lambda problem: "zeros")
    monkeypatch.setattr(bdf, "stable_order", lambda zeros, step: 2)
    monkeypatch.setattr(
        bdf, "result_of_states", lambda problem, dae, states, **more: (states, more)
    )
    for h, step in ((2.5e-3, 5e-4), (0.1, 1e-3)):
        asked.clear()
        answer: Any = bdf.solve(problem, h)
        states, more = answer
        assert asked[:2] == [("bdf", "order", "richardson"), ("bdf", False)]
        name, t, start, own = asked[2]
        assert (name, start, own) == ("extrapolate" if options else "march", "packed rest", order)
        assert t.tolist() == [0.0, step] == states.t.tolist()
        assert more["details"] == {"order": order, "richardson": bool(options), "step_s": step}
        assert more["verdict"] == f"BDF of order {order}" + (", extrapolated" if options else "")
        assert more["iterations"] == 9
    for wrong, said in (
        ({"order": 5}, "options: method bdf was given order 5, expected 1, 2, 3 or 4"),
        ({"order": True}, "options: method bdf was given order True, expected 1, 2, 3 or 4"),
        ({"richardson": 1}, "options: method bdf was given richardson 1, expected True or False"),
    ):
        problem.options = wrong
        with pytest.raises(ArgumentError) as refused:
            bdf.solve(problem, 0.1)
        assert str(refused.value) == said
