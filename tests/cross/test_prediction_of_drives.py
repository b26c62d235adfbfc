"""Predicted errors of robots whose drives have cogging, friction with a load or a state, or an
unknown delay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bristled import bristled, tables
from harmonic import COGGING, ERROR
from predicted import Drawn, in_the_loop
from toolchain import needs_compiler

import flexgen
from flexgen.base.spec.parts import Tolerances
from flexgen.studies.tolerances import bristle_states, response
from flexgen.studies.tolerances.sources import sources_of

pytestmark = needs_compiler
# rad at the motor: softer bristles than usual, which the loop simulates in less time
PRESLIDING = 5e-3
LATE_S = 2e-4
LOAD = {
    "type": "gear",
    "viscous": 0.004,
    "coulomb": 0.1,
    "beta": 1.0,
    "load_coulomb": 0.1,
    "load_smoothing": 1.0,
}


def with_sums() -> flexgen.RobotModel:
    gears = {
        f"element.{x}.gear.transmission_error": ERROR for x in ("upper.dof.q1", "fore.dof.q2")
    }
    return flexgen.read(
        "elbow", overrides=gears | {f"motor.{m}.cogging": COGGING for m in ("m1", "m2")}
    )


def with_load() -> flexgen.RobotModel:
    return flexgen.read(
        "elbow",
        overrides={f"motor.{m}.friction": LOAD for m in ("m1", "m2")} | {"temperature": 40.0},
    )


def predicted(model: flexgen.RobotModel, **known: float) -> flexgen.Prediction:
    return flexgen.predict(
        replace(model, uncertainty=Tolerances(**known)), robots=16, progress=False
    )


@pytest.mark.slow
@pytest.mark.parametrize("make", [with_sums, with_load])
def test_each_robot_has_the_error_of_the_loop(make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: forces of the sources that are 2 % too small."""
    found = predicted(make(), stiffness=0.1, friction=0.2, masses=0.03)
    robots = Drawn(found, 3)
    simulated = in_the_loop(found, robots.changes)
    assert robots.predicted() == pytest.approx(simulated, rel=0.005)
    along = robots.along
    monkeypatch.setattr(robots, "along", replace(along, force=0.98 * along.force))
    assert robots.predicted() != pytest.approx(simulated, rel=0.01)


@pytest.mark.slow
def test_bristles_of_each_robot_are_those_of_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: bristles that deflect ten times less before they slip."""
    model = bristled("elbow", tables("elbow", presliding=PRESLIDING))
    found = predicted(model, friction=0.2)
    assert {share.name for share in found.shares[:2]} == {"m1.lugre", "m2.lugre"}
    robots = Drawn(found, 3)
    simulated = in_the_loop(found, robots.changes)
    assert robots.predicted() == pytest.approx(simulated, rel=0.02)
    made = bristle_states.bristles_of
    monkeypatch.setattr(
        response,
        "bristles_of",
        lambda models, h: replace(x := made(models, h), stiffness=10.0 * x.stiffness),
    )
    stiff = Drawn(found, 3)
    assert stiff.predicted() != pytest.approx(simulated, rel=0.1)


def test_torques_that_are_late_have_the_error_of_the_loop() -> None:
    """Torques shifted in time; planted: the delay counted for one motor only, or to first
    order.
    """
    found = predicted(flexgen.read("elbow"), delay=0.2)
    assert found.sources == ("delay",) and found.shares[0].share == pytest.approx(1.0)
    robots = Drawn(found, 3)
    path = found.solution.trajectory
    simulated = []
    for (late,) in robots.errors:
        shifted = path.at(np.clip(path.time - late, path.time[0], path.time[-1]))["tau_m"]
        other = replace(path, channels={**path.channels, "tau_m": shifted})
        simulated.append(in_the_loop(found, [{}], replace(found.solution, trajectory=other))[0])
    assert robots.predicted() == pytest.approx(simulated, rel=0.02)
    exact = robots.along.late
    first = robots.along.force[0][:, None]
    one = np.arange(exact(robots.errors).shape[-1]) < exact(robots.errors).shape[-1] - 1
    for wrong in (lambda x: exact(x) * one, lambda x: first * x):
        robots.along = replace(robots.along, late=wrong)
        assert robots.predicted() != pytest.approx(simulated, rel=0.02)


def test_a_delay_may_be_negative_and_a_payload_not_below_nothing() -> None:
    model = replace(flexgen.read("elbow"), uncertainty=Tolerances(delay=LATE_S, payload=100.0))
    sources = sources_of(model, model.uncertainty)
    errors = sources.errors(np.random.default_rng(0).standard_normal((500, 2)))
    of_delay, of_payload = (errors[:, sources.kinds.index(kind)] for kind in ("delay", "payload"))
    assert of_delay.min() < -2 * LATE_S and of_delay.std() == pytest.approx(LATE_S, rel=0.1)
    assert of_payload.min() == -model.payload.mass
