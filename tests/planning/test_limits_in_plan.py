"""Limits of all kinds in planned motions, measured on the trajectory by
`flexgen.dynamics.mechanics.limit_use`, in numbers.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from gear_friction import loaded
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.limit_use import uses_of_limits
from flexgen.inversion.judge.status import Status
from flexgen.planning.optimal import signals
from flexgen.planning.optimal.phase import Phase

pytestmark = needs_compiler
MODEL = "planar5_nmp"


@pytest.fixture(scope="module")
def equations() -> flexgen.Equations:
    return flexgen.derive(MODEL)


def calmest(equations, limits: flexgen.Limits) -> flexgen.Solution:
    problem = flexgen.plan_problem(equations, mesh=80, limits=limits)
    problem.add_cost(1e-4 * ca.sumsqr(problem["a_m"]))
    return problem.solve(progress=False)


def part_of(found: flexgen.Solution, limits: flexgen.Limits) -> float:
    """Largest part of a limit that a solution uses."""
    uses = uses_of_limits(found.model, limits, found.trajectory.__getitem__, found.trajectory.time)
    return max(use.part for use in uses)


@pytest.fixture(scope="module")
def free(equations) -> flexgen.Solution:
    return calmest(equations, flexgen.Limits())


def lowered(kind: str, free: flexgen.Solution) -> flexgen.Limits:
    """A limit of one kind that the motion without it exceeds by about an eighth."""
    path = free.trajectory
    size = (1e-3, 1e-3)
    torque = np.abs(path["tau_m"]).max(axis=0)
    speed = np.abs(path["v_m"]).max(axis=0)
    if kind == "reserve":
        return flexgen.Limits(torque=tuple(torque), reserve=0.12)
    if kind == "torque_speed":
        curves = [
            ((0.0, 1.2 * float(m)), (0.7 * float(v), 1.2 * float(m)), (0.9 * float(v), 0.1))
            for m, v in zip(torque, speed, strict=True)
        ]
        return flexgen.Limits(torque_speed=tuple(curves))
    some = flexgen.Limits(**{kind: 1e-3 if kind.startswith("tool") else size})
    uses = uses_of_limits(free.model, some, path.__getitem__, path.time)
    most = [1e-3 * 0.88 * use.part for use in uses]
    return flexgen.Limits(**{kind: most[0] if kind.startswith("tool") else tuple(most)})


KINDS = (
    "torque_rate",
    "torque_speed",
    "gear_torque",
    "joint_speed",
    "joint_acceleration",
    "tool_speed",
    "tool_acceleration",
    "reserve",
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_limit_is_kept_and_reached(equations, free, kind):
    limits = lowered(kind, free)
    assert part_of(free, limits) > 1.1
    found = calmest(equations, limits)
    assert found.status == Status.SOLVED and 0.99 < part_of(found, limits) < 1.01


def test_a_torque_that_may_jump_exceeds_its_rate(equations, free, monkeypatch):
    """Planted: intervals whose torques are not continuous."""
    limits = lowered("torque_rate", free)
    monkeypatch.setattr(Phase, "continuous_torque", lambda self: None)
    assert part_of(calmest(equations, limits), limits) > 1.05


@pytest.mark.slow
def test_torques_of_rigid_gears():
    """Torque of a rigid gear: the torque of the motor less those of its rotor and friction."""
    gears = {
        f"element.{e.name}.dof.{d.name}.gear": {"type": "rigid"}
        for e in flexgen.read(MODEL).elements
        for d in e.dofs
        if d.gear
    }
    equations = flexgen.derive(flexgen.read(MODEL, overrides=gears))
    limits = lowered("gear_torque", calmest(equations, flexgen.Limits()))
    found = calmest(equations, limits)
    assert found.status == Status.SOLVED and 0.99 < part_of(found, limits) < 1.01


def test_effective_torques_and_further_phases_are_refused(equations):
    with pytest.raises(ArgumentError, match="limits: given torque_rms, expected other kinds"):
        flexgen.plan_problem(equations, limits=flexgen.Limits(torque_rms=(1.0, 1.0)))
    problem = flexgen.plan_problem(equations, limits=flexgen.Limits(torque_rate=(900.0, 900.0)))
    with pytest.raises(ArgumentError, match="then: given in a problem with torque_rate"):
        problem.then(0.2, mesh=5)


@pytest.mark.slow
def test_a_plan_has_the_friction_of_the_load(monkeypatch):
    """The simulation of the full model agrees up to the mesh; planted: a friction of half the
    load.
    """

    def least_torque() -> flexgen.Solution:
        problem = flexgen.plan_problem(loaded("elbow", 40.0), mesh=120)
        problem.add_cost(ca.sumsqr(problem["tau_m"]))
        return problem.solve(progress=False)

    found = least_torque()
    assert found.status == Status.SOLVED and found.plan_error_max < 1e-5
    right = signals.motor_frictions
    monkeypatch.setattr(
        signals, "motor_frictions", lambda equations, v, tau: right(equations, v, tau / 2)
    )
    assert least_torque().status == Status.TOLERANCE_NOT_MET
