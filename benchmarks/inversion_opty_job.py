"""The problem for opty: the original equations of a planar arm as text, for another
interpreter.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp

from flexgen.analysis.printing.equations import symbolic
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.output_columns import output_labels
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction

# weights and bound that served opty best, of those tried
TRACKING = 1e6
SMOOTH = 1e-8
ITERATIONS = 1000


def job(problem: InversionProblem, nodes: int, tracking: bool) -> dict[str, Any]:
    """The equations in states, rates and torques, with path, equilibrium and initial guess at the
    nodes.

    The rows are ``q' - v`` and the equations of motion of arm and motors; the output is on its
    path by algebraic rows, or drawn to it (``tracking``). States and rates are symbols here; those
    of the rates end in ``_rate``.
    """
    s = symbolic(problem.equations.model)
    q = [*s.q_a, *s.q_m]
    v = [*s.v_a, *s.v_m]
    rate = {x: sp.Symbol(f"{x}_rate") for x in (*q, *v)}
    forces = dict(zip(s.tau, s.torques, strict=True))
    acceleration = dict(zip((*s.a_a, *s.a_m), (rate[x] for x in v), strict=True))
    arm = (
        s.M * sp.Matrix(s.a_a)
        + s.S * sp.Matrix(s.a_m)
        + s.c
        + s.g
        + s.friction
        + s.drag
        - sp.Matrix(s.torques)
    )
    motors = [left - tau for left, tau in zip(s.motor_equations, s.tau_m, strict=True)]
    reference = [sp.Symbol(f"y_{k}") for k in range(len(s.output))]
    rows = [
        *(rate[x] - w for x, w in zip(q, v, strict=True)),
        *(
            sp.sympify(row).xreplace(forces).xreplace(acceleration).xreplace(s.parameters)
            for row in (*arm, *motors)
        ),
    ]
    lead, settle = problem.windows
    t = np.linspace(-lead, problem.path.duration + settle, nodes)
    place = problem.path.sample(t).y[:, :, 0]
    reduction = Reduction(problem.equations)
    slow = reduction.follow(problem.path, t, reduction.start(problem.path).q_a)
    motor = slow[:, list(problem.equations.model.i_g)] @ problem.equations.model.eta.T
    states = np.hstack([slow, motor])
    guess = np.hstack([states, np.gradient(states, t, axis=0), np.zeros((nodes, len(s.tau_m)))])
    start = problem.equilibrium
    end = reduction.equilibrium(problem.path, problem.path.duration, slow[-1])
    still = np.zeros(len(q))
    return {
        "rows": [str(row) for row in rows],
        "output": [str(row) for row in s.output.xreplace(s.parameters)],
        "states": [str(x) for x in (*q, *v)],
        "inputs": [str(x) for x in s.tau_m],
        "reference": {str(y): list(place[:, k]) for k, y in enumerate(reference)},
        "rest": [list(np.r_[x.q_a, x.q_m, still]) for x in (start, end)],
        "guess": [list(column) for column in guess.T],
        "begin": t[0],
        "step": t[1] - t[0],
        "nodes": nodes,
        "tracking": TRACKING if tracking else 0.0,
        "smooth": SMOOTH,
        "iterations": ITERATIONS,
    }


def torque_of(problem: InversionProblem, told: dict[str, Any]) -> Trajectory:
    """opty's torques as a trajectory to simulate."""
    model = problem.equations.model
    tau = np.array(told["inputs"]).T
    states = np.array(told["states"]).T
    t = told["begin"] + told["step"] * np.arange(len(tau))
    arm = tuple(c.name for c in model.coordinates)
    motors = tuple(m.name for m in model.motors)
    q_a = states[:, : model.n_a]
    q_m = states[:, model.n_a : model.n_a + model.n_m]
    channels = {"tau_m": tau, "q_a": q_a, "q_m": q_m, "y_ref": problem.path.sample(t).y[:, :, 0]}
    units = {"tau_m": "N m", "q_a": "rad or m", "q_m": "rad", "y_ref": "m"}
    ports = {name: Port(name, (x.shape[1],), units[name], name) for name, x in channels.items()}
    labels = {"tau_m": motors, "q_a": arm, "q_m": motors, **output_labels(model)}
    return Trajectory(t, channels, ports, labels, {"model": model.name})
