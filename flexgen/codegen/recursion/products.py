"""Products with derivatives (jvp, vjp) of inverse and forward dynamics, without the matrices of
the derivatives.

Of inverse dynamics by differentiation of its recursion, in one sweep. Of accelerations
``(M + A) a = f - h``, with the constant inertias A of the rotors, by a second solution with the
factors of the first:

    jvp:  (M + A) da = df - d(M a + h) at constant a
    vjp:  (M + A) mu = a_bar,    q_bar, v_bar = -(d(M a + h)/d(q, v))' mu,    f_bar = mu

Source: A. Griewank, A. Walther, Evaluating Derivatives, 2008, ch. 3; the second solution: own
derivation.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca
import numpy as np

from flexgen.codegen.recursion import accelerations
from flexgen.codegen.recursion.arm import Arm, Columns, vectors
from flexgen.codegen.recursion.dh_chain import Chain
from flexgen.codegen.recursion.tape import Scalar, Tape
from flexgen.dynamics.mechanics.products import differentiated, symbols_like
from flexgen.dynamics.mechanics.signatures import COTANGENT, TANGENT
from flexgen.dynamics.mechanics.system import Built

Q_V_A = ["q_a", "v_a", "a_a"]
STATE = ["q_a", "v_a", "q_m", "v_m", "tau_m"]


def of_function(arm: Arm, function: ca.Function, kind: str) -> Built:
    """The product by differentiation of a finished function."""
    names = [name for name in function.name_in() if name != "parameters"]
    inputs = [ca.SX.sym(name, function.sparsity_in(i)) for i, name in enumerate(names)]
    outputs = function.call([*inputs, *[arm.equations.symbols] * (function.n_in() - len(names))])
    return differentiated(arm.equations, kind, (inputs, names, outputs, function.name_out()))


def _inverse_dynamics(arm: Arm, kind: str) -> Built:
    """Derivatives of `tau_a` times tangents (kind ``"jvp"``), or cotangents times derivatives
    (``"vjp"``), by one sweep over the recorded operations, forward or back.
    """
    inputs = arm.symbols(*Q_V_A)
    n = arm.model.n_a
    suffix, like = (TANGENT, Q_V_A) if kind == "jvp" else (COTANGENT, ["tau_a"])
    more, named = symbols_like(inputs[: len(like)], like, suffix)

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        """One sweep from tangents of ``q, v, a``, or back from cotangents of the torques."""
        (q, v, a) = vectors(tape, *inputs)
        at = arm.joints(tape, q, v, a)
        tau = arm.torques_at(tape, chain, at, columns)
        if arm.closed is not None and kind == "jvp":
            return arm.closed.jvp(tape, tau, at, inputs, more)
        given = tape.vector(ca.veccat(*more))
        if arm.closed is not None:
            return arm.closed.vjp(tape, list(zip(tau, given, strict=True)), at, inputs)
        x = [*q, *v, *a]
        if kind == "jvp":
            return tape.jvp(tau, zip(x, given, strict=True))
        return tape.vjp(list(zip(tau, given, strict=True)), x)

    flat = arm.shortest([route], several=arm.closed is None)
    out = ["tau_a"] if kind == "jvp" else Q_V_A
    found = [ca.vertcat(*flat[k * n : (k + 1) * n]) for k in range(len(out))]
    return [*inputs, *more], [*Q_V_A, *named], found, [name + suffix for name in out]


def _arm_forward_dynamics(arm: Arm, kind: str) -> Built:
    """Products (``kind``: ``"jvp"`` or ``"vjp"``) of the arm's accelerations under joint torques
    ``tau_a``, without rotors.
    """
    tau_a = ca.SX.sym("tau_a", arm.model.n_a)
    inputs = [*arm.symbols("q_a", "v_a"), tau_a]
    names = ["q_a", "v_a", "tau_a"]
    still = np.zeros((arm.model.n_a, arm.model.n_a))
    if kind == "jvp":
        more, named = symbols_like(inputs, names, TANGENT)
        found = [_changes(arm, tau_a, still, *more)]
        return [*inputs, *more], [*names, *named], found, ["a_a" + TANGENT]
    more, named = symbols_like([tau_a], ["a_a"], COTANGENT)
    return (
        [*inputs, *more],
        [*names, *named],
        _weights(arm, tau_a, still, *more),
        [name + COTANGENT for name in names],
    )


def _forward_dynamics(arm: Arm, kind: str) -> Built:
    """Arm and motors: forces are differentiated as graphs, accelerations of the arm by `_changes`
    and `_weights`.
    """
    model = arm.model
    forces = arm.equations.lagrangian.forces
    inputs = arm.symbols(*STATE)
    n_a = model.n_a
    n_m = model.n_m
    i_m = list(model.i_m)
    i_g = list(model.i_g)
    inertia = [1.0 / model.motors[j].inertia for j in i_m]
    eta = ca.SX(
        ca.DM([[0.0 if j in i_m else x for x in row] for j, row in enumerate(model.eta.tolist())])
    )
    x = ca.veccat(*inputs)
    on_arm = forces[:n_a]
    if kind == "jvp":
        more, named = symbols_like(inputs, STATE, TANGENT)
        change = ca.jtimes(forces, x, ca.veccat(*more))
        da_a = _changes(arm, on_arm, arm.armature, more[0], more[1], change[:n_a])
        da_m = ca.mtimes(eta, da_a[i_g])
        for k, j in enumerate(i_m):
            da_m[j] = change[n_a + k] * inertia[k]
        return [*inputs, *more], [*STATE, *named], [da_a, da_m], ["a_a" + TANGENT, "a_m" + TANGENT]
    more, named = symbols_like([inputs[0], inputs[2]], ["a_a", "a_m"], COTANGENT)
    on_joints = ca.densify(more[0])
    on_joints[i_g] += ca.mtimes(eta.T, more[1])
    by_q, by_v, mu = _weights(arm, on_arm, arm.armature, on_joints)
    felt = ca.vertcat(mu, *[more[1][j] * inertia[k] for k, j in enumerate(i_m)])
    flat = ca.densify(ca.jtimes(forces, x, felt, True))
    flat[: 2 * n_a] += ca.vertcat(by_q, by_v)
    found = ca.vertsplit(flat, np.cumsum([0, n_a, n_a, n_m, n_m, n_m]).tolist())
    return [*inputs, *more], [*STATE, *named], found, [name + COTANGENT for name in STATE]


def _changes(
    arm: Arm, force: ca.SX, armature: np.ndarray, dq: ca.SX, dv: ca.SX, df: ca.SX
) -> ca.SX:
    """Change of the accelerations (n_a) for changes dq, dv of coordinates and speeds and df of
    ``force``: ``M da = df - (d(M a + h)/dq dq + dh/dv dv)`` at fixed a.
    """

    def route(
        by: accelerations.Solver, tape: Tape, chain: Chain, columns: Columns
    ) -> list[Scalar]:
        """By one recursion for a, which also solves the second system; a is constant in the
        derivatives.
        """
        at = by(tape, chain, columns)
        joints = arm.joints(tape, at.q, at.v, [tape.constant(x) for x in at.a])
        h = arm.torques_at(tape, chain, joints, columns)
        if arm.closed is not None:
            inputs = [ca.vertcat(*tape.build(x)) for x in (at.q, at.v, at.a)]
            changes = arm.closed.jvp(tape, h, joints, inputs, [dq, dv, 0 * dq])
        else:
            changes = tape.jvp(
                h, zip([*at.q, *at.v], tape.vector(ca.vertcat(dq, dv)), strict=True)
            )
        return at.solve([x - y for x, y in zip(tape.vector(df), changes, strict=True)])

    routes = [partial(route, by) for by in accelerations.routes(arm, force, armature)]
    return ca.vertcat(*arm.shortest(routes, kind=accelerations.kind(armature)))


def _weights(arm: Arm, force: ca.SX, armature: np.ndarray, weights: ca.SX) -> list[ca.SX]:
    """Derivatives of the accelerations' sum with ``weights`` (n_a) in coordinates, speeds and
    forces, (n_a) each: with ``M mu = weights``, -mu times those of ``M a + h``, and mu.
    """
    n = arm.model.n_a

    def route(
        by: accelerations.Solver, tape: Tape, chain: Chain, columns: Columns
    ) -> list[Scalar]:
        """By one recursion for a, which also solves for mu; a is constant in the derivatives."""
        at = by(tape, chain, columns)
        joints = arm.joints(tape, at.q, at.v, [tape.constant(x) for x in at.a])
        h = arm.torques_at(tape, chain, joints, columns)
        mu = at.solve(tape.vector(weights))
        pairs = list(zip(h, mu, strict=True))
        if arm.closed is not None:
            inputs = [ca.vertcat(*tape.build(x)) for x in (at.q, at.v, at.a)]
            found = arm.closed.vjp(tape, pairs, joints, inputs)[: 2 * n]
        else:
            found = tape.vjp(pairs, [*at.q, *at.v])
        return [*(-x for x in found), *mu]

    routes = [partial(route, by) for by in accelerations.routes(arm, force, armature)]
    flat = arm.shortest(routes, kind=accelerations.kind(armature))
    return [ca.vertcat(*flat[k * n : (k + 1) * n]) for k in range(3)]


BUILDERS: dict[str, Callable[[Arm, str], Built]] = {
    "inverse_dynamics": _inverse_dynamics,
    "arm_forward_dynamics": _arm_forward_dynamics,
    "forward_dynamics": _forward_dynamics,
}
