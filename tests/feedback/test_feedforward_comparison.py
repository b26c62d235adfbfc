"""Closed loops: feedforwards side by side, margins, frequencies in use, unstable loops."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.feedback.loop.control import run_case
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.feedback.sampled_plant import sampled_plant

MODEL = "planar5_nmp"
SOFT = {"soft": {"stiffness": 0.8}}


@pytest.fixture(scope="module")
def run():
    return flexgen.control(MODEL, plants=SOFT, progress=False)


@pytest.fixture(scope="module")
def compared(run):
    return flexgen.compare_feedforward(run, {"plants": SOFT}, progress=False)


def test_the_elastic_feedforward_is_exact_for_the_model_and_the_others_are_not(compared):
    assert list(compared.runs) == ["none", "rigid", "elastic"] and not compared.missing
    rows = {row["robot"]: row for row in compared.rows() if row["what"] == "error"}
    assert rows["nominal"]["elastic"] < 1e-9
    assert 1e-3 < rows["nominal"]["rigid"] < rows["nominal"]["none"]
    assert rows["nominal"]["elastic"] < rows["soft"]["elastic"] < rows["soft"]["rigid"]


def test_the_runs_differ_in_the_feedforward_only(compared):
    none, rigid, elastic = compared.runs.values()
    assert none.law is rigid.law is elastic.law
    assert np.ptp(none.reference.held, axis=0).max() < 1e-12
    assert np.array_equal(none.reference.motion["q_m"], rigid.reference.motion["q_m"])
    held = np.abs(rigid.reference.held - elastic.reference.held[: len(rigid.reference.held)])
    assert held.max() > 0.1
    assert [r.name for r in none.runs] == [r.name for r in elastic.runs]


def test_the_rigid_run_is_that_of_the_method_rigid(compared, run):
    alone = flexgen.control(MODEL, method="rigid", controller=run.law, plants=SOFT, progress=False)
    assert alone.solution.method == "rigid"
    assert np.array_equal(alone["soft"].error, compared.runs["rigid"]["soft"].error)
    with pytest.raises(ArgumentError, match="method: given 'rigid' with a solution"):
        flexgen.control(MODEL, method="rigid", solution=run.solution)


def test_a_feedforward_without_solution_is_named_with_its_reason(run):
    force = np.zeros((len(run.solution.trajectory.time), 3))
    options = {"force": force, "plants": {"soft": {"stiffnes": 0.8}}}
    found = flexgen.compare_feedforward(run, options, progress=False)
    assert list(found.runs) == ["elastic"] and set(found.missing) == {"none", "rigid"}


def test_margins_are_those_of_the_frequency_response(run):
    """det(1 + g L) and det(1 + exp(-i phi) L) vanish at the stated frequencies."""
    for loop in run.loops().values():
        margins = loop.margins()
        assert margins.gain_db == pytest.approx(20.0 * np.log10(margins.gain))
        lag = np.exp(-1j * np.radians(margins.phase_deg))
        for factor, hz in ((margins.gain, margins.gain_hz), (lag, margins.phase_hz)):
            smallest = [nyquist(loop, factor, hz * part) for part in (0.9, 1.0, 1.1)]
            assert smallest[1] < 1e-3 * min(smallest[0], smallest[2])


def nyquist(loop, factor, hz):
    """Smallest distance of the eigenvalues of ``factor L`` from -1."""
    z = np.exp(2j * np.pi * hz * loop.sample_s)
    m = loop.model
    F, G, Y = sampled_plant(m.A, m.B, m.C, m.D, loop.sample_s, loop.delay_s, loop.late)
    A, B, C, D = (x[0] for x in loop.controller.matrices)
    plant = Y @ np.linalg.solve(z * np.eye(len(F)) - F, G)
    feedback = D + C @ np.linalg.solve(z * np.eye(len(A)) - A, B)
    return np.abs(1.0 + factor * np.linalg.eigvals(feedback @ plant)).min()


def test_margins_of_an_unstable_loop_are_zero_and_json_has_no_infinity(run):
    loop = run.loops()["begin"]
    wild = replace(loop.controller, C=1e3 * loop.controller.C, D=1e3 * loop.controller.D)
    loop = type(loop)(loop.model, wild, loop.sample_s, loop.delay_s, loop.late)
    margins = loop.margins()
    assert not margins.stable and margins.gain == margins.phase_deg == 0.0
    assert json.loads(json.dumps(margins.to_dict(), allow_nan=False))["gain_db"] is None


@pytest.mark.parametrize("late, cut", [(0.0, False), (6e-3, True)])
def test_the_printed_frequencies_are_those_of_the_gains_in_use(late, cut):
    """speed gain / (2 pi J), with J of the equations at the start, is in the name."""
    law = flexgen.PPI(position_hz=5.0, speed_hz=25.0, integral_hz=1.0)
    found = flexgen.control(MODEL, controller=law, delay=late, progress=False)
    stiff, _ = motor_inertias(found.model, found.reference.points(np.array([0])))
    used = found.law.speed_gain / (2.0 * np.pi * stiff)
    assert cut == ("speed cut from 25 Hz" in found.controller)
    shown = re.match(r"ppi 5/(.*)/1 Hz", found.controller)[1]
    numbers = [float(x) for x in shown.split(" to ")]
    assert numbers == pytest.approx([used.min(), used.max()][: len(numbers)], rel=5e-3)


@pytest.mark.parametrize("part, stable", [(0.95, True), (1.05, False)])
def test_a_loop_beyond_its_gain_margin_has_a_status_of_its_own(run, part, stable):
    """Near the margin a diverging loop stays finite for the time of a move: it is not done."""
    gain = part * min(margins.gain for margins in run.margins().values())
    law = run.law
    faster = Cascade(law.position_gain, gain * law.speed_gain, law.integral_gain)
    found = flexgen.control(MODEL, controller=faster, solution=run.solution, progress=False)
    assert found.status.startswith("done" if stable else "unstable: nominal: ")
    assert bool(found.unstable) != stable


def test_a_robot_that_differs_is_unstable_by_its_own_linear_loop(run):
    """2 % of the stiffness in every spring: the other robot counts by its own loop."""
    integral = 25.0 * run.law.integral_gain
    law = Cascade(4.0 * run.law.position_gain, run.law.speed_gain, integral)
    other = {"softer": {"stiffness": 0.02}}
    options = {"controller": law, "solution": run.solution, "progress": False}
    found = flexgen.control(MODEL, plants=other, **options)
    largest = {
        name: max(loop.largest_eigenvalue() for loop in found.loops(name).values())
        for name in ("nominal", "softer")
    }
    expected = {name for name, size in largest.items() if size > 1.0 + 1e-6}
    assert set(found.unstable) == expected
    with pytest.raises(
        ArgumentError, match="robot: given 'hard', expected one of nominal, softer"
    ):
        found.margins("hard")


def test_the_linear_loop_of_a_robot_is_that_of_its_own_model_file(run):
    """The changed numbers in the equations, against a model that is read with them."""
    soft = flexgen.read(MODEL, overrides=softened(run.model, 0.8))
    own = flexgen.control(soft, controller=run.law, progress=False)
    at = run.pose_samples["begin"]
    one = run.loops("soft")["begin"].largest_eigenvalue()
    motion = run.reference.points(np.array([at]))
    other = own.loops()["begin"]
    pose = type(other)(
        PoseModels(soft).at(motion), other.controller, other.sample_s, other.delay_s, other.late
    )
    assert one == pytest.approx(pose.largest_eigenvalue(), rel=1e-9)
    assert abs(one - run.loops()["begin"].largest_eigenvalue()) > 1e-8


def softened(model, factor):
    """Overrides that multiply the stiffnesses of all springs of a model."""
    found = {}
    for element in model.elements:
        for dof in element.dofs:
            key = f"element.{element.name}.dof.{dof.name}"
            if dof.gear is not None and dof.gear.spring is not None:
                found[f"{key}.gear.spring.stiffness"] = factor * dof.gear.spring.stiffness
            if dof.spring is not None:
                found[f"{key}.spring.stiffness"] = factor * dof.spring.stiffness
    return found


class RunsAway:
    """A controller in Python whose torque grows at rest: it has no linear loop."""

    def reset(self):
        self.extra = 1e-6

    def step(self, k, y, ref):
        self.extra *= 1.003
        return ref.tau_m + self.extra


def test_motors_that_go_away_at_rest_are_unstable_without_a_linear_loop():
    found = flexgen.control(MODEL, controller=RunsAway(), torque_limits=False, progress=False)
    assert found.status.startswith("unstable: nominal:")


def test_the_command_line_prints_one_table_and_fails_where_the_loop_is_unstable(tmp_path, capsys):
    assert main(["control", MODEL, "--plant", "soft:stiffness=0.8"]) == 0
    said = capsys.readouterr().out
    assert "feedforward compared" in said and re.search(
        r"none, \w+ +rigid, \w+ +elastic, \w+", said
    )
    assert "phase margin, deg" in said and "dB" in said
    assert main(["control", MODEL, "--no-compare", "--method", "rigid", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert "feedforward" not in data and data["margins"]["begin"]["phase_deg"] > 30.0
    wild = tmp_path / "wild.toml"
    wild.write_text(
        'type = "cascade"\nposition_gain = [33.0, 33.0]\nspeed_gain = [20.0, 6.0]\n'
        "integral_gain = [6.0, 6.0]\n"
    )
    assert main(["control", MODEL, "--controller", str(wild)]) == 1
    assert "unstable: nominal:" in capsys.readouterr().err


def test_a_diverged_run_is_unstable_in_a_single_case_too(run):
    from flexgen.feedback.loop.case import control_case

    case = control_case(MODEL, solution=run.solution)
    law = Cascade(run.law.position_gain, 8.0 * run.law.speed_gain, run.law.integral_gain)
    assert run_case(case, law, "fast").status.startswith("unstable")
