"""Figures of closed loops, learning and fastest motions: metres and radians apart, as the output
has them.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.cli.main import main

pytestmark = needs_compiler

# its output is an angle
TWO_MASS = str(Path(__file__).parents[1] / "support" / "robots" / "two_mass.toml")
LENGTH = re.compile(r"[0-9] [unm]?m\b(?! )|, mm\b|_m\b")
DAMPED = {"element.load.dof.q1.gear.damping": 0.02}


@pytest.fixture(scope="module")
def turning():
    return flexgen.derive(flexgen.read(TWO_MASS, overrides=DAMPED))


@pytest.mark.slow
def test_control_of_an_angle_prints_and_reports_radians(turning, tmp_path, capsys):
    run = flexgen.control(turning, plants={"soft": {"stiffness": 0.8}}, progress=False)
    assert run.unit == "rad" and run.tool_error_max_m is None
    moving = run.reference.time >= run.reference.begin
    assert run.tool_error_max_rad == pytest.approx(float(np.abs(run.nominal.error[moving]).max()))
    figures = run.figures(run["soft"])
    assert figures["error_max_rad"] > 1e-5 and figures["dynamic_error_max_rad"] > 0
    assert all(
        figures[f"{key}_m"] is None for key in ("error_max", "error_end", "dynamic_error_max")
    )
    assert "rad, dynamic" in str(run) and not LENGTH.search(str(run))
    page = run.report(tmp_path / "page").read_text()
    assert "error, mrad" in page and ", mm" not in page and "output error, " in page
    words = ["control", TWO_MASS, "--set", "element.load.dof.q1.gear.damping=0.02", "-q"]
    assert main(words) == 0
    assert "error, mrad" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["plants"][0]["error_max_m"] is None


@pytest.mark.slow
def test_learning_of_an_angle_is_in_radians(turning, tmp_path):
    learned = flexgen.learn(turning, plant={"stiffness": 0.8}, iterations=1, progress=False)
    assert (
        learned.unit == "rad" and learned.errors[1] < learned.errors[0] and learned.errors_m == ()
    )
    assert "rad" in str(learned) + repr(learned) and not LENGTH.search(
        str(learned) + repr(learned)
    )
    assert {"errors_max_rad", "dynamic_errors_max_rad"} <= learned.to_dict().keys()
    page = learned.report(tmp_path / "page").read_text()
    assert "error, mrad" in page and ", mm" not in page


@pytest.mark.slow
def test_vibration_of_an_angle_is_in_radians(turning):
    found = flexgen.fastest(turning, coefficients=4, progress=False)
    assert found.unit == "rad" and found.vibration_m == {} and found.vibration["soft"] > 0
    assert (
        "rad" in str(found)
        and "vibration_rad" in found.to_dict()
        and not LENGTH.search(str(found))
    )


@pytest.mark.slow
def test_kinematics_takes_equations():
    equations = flexgen.derive("manutec_r3")
    p, R = (
        np.array(x)
        for x in equations.function("forward_kinematics")([0.3, -0.5, 0.8, 0.2, 0.7, -0.4])
    )
    found, again = (
        flexgen.kinematics(model, p.ravel(), R) for model in (equations, equations.model)
    )
    assert len(found) == len(again) > 0
