"""Poses of an experiment: the information that each pose gives about the parameters, and the best
set of poses.

    F = 2 P sum_l sum_e Re (dG U_e)^H C^-1 (dG U_e),      C = G S_u G^H + w^(2 m) S_y

U: spectra of the torques in the closed loop, S_u, S_y: spectra of the noise of torques and outputs
(motor angles: m = 2). The frictions are eliminated (Schur complement), because a friction that
cannot be identified would otherwise decide alone.

Source: E. Wernholt and J. Lofberg, CDC 2007 (optimal operating points for robots); A. Atkinson, A.
Donev and R. Tobias, Optimum Experimental Designs, 2007 (exchange).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from time import perf_counter
from typing import Literal, get_args

import numpy as np

from flexgen.base.calls.deadline import check_time, is_over, keep_best, part_known
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import (
    SENSOR_DELAY,
    ParameterVector,
    is_of_drive,
    is_of_sensor,
)
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.response_outputs import noises, output_orders
from flexgen.model.elements import RobotModel

FRICTIONS = (".viscous", ".coulomb", ".stribeck", ".alpha", ".beta", ".offset")
# least noise of a sensor over what the noise of the torques gives in it: covariances stay regular
ROUNDING = 1e-6
RANGE = 1.0  # rad or m about home where a joint has no limits
CriterionName = Literal["A", "D", "random"]
CRITERIA: tuple[CriterionName, ...] = get_args(CriterionName)


def candidates(model: RobotModel, count: int, seed: int) -> np.ndarray:
    """Random motor angles (count, n_m) [rad] within the limits of the joints."""
    home = np.array(model.home)
    lower = home - RANGE
    upper = home + RANGE
    for k, i in enumerate(model.i_g):
        dof = model.coordinates[i].dof
        assert dof is not None  # an actuated coordinate
        lower[k] = lower[k] if dof.lower is None else dof.lower
        upper[k] = upper[k] if dof.upper is None else dof.upper
    q_g = np.random.default_rng(seed).uniform(lower, upper, (count, model.n_g))
    return q_g @ model.eta.T


def torque_spectra(G: np.ndarray, w: np.ndarray, plan: Plan) -> np.ndarray:
    """``U U^H`` (lines, n_m, n_m) over the experiments of one realization, of the commanded
    torques at one pose.

    ``G`` (lines, n_m, n_m): from commanded torques to motor accelerations, hold and delay
    included.
    """
    T = plan.hardware.sample_s
    n = len(plan.motors)
    difference = (1 - np.exp(-1j * w * T)) / T
    c = plan.controller
    gain = c.speed_gain * (difference[:, None] + c.position_gain)
    gain = gain * (1 + c.integral_gain / difference[:, None])
    closed = np.eye(n) - gain[:, :, None] * G / w[:, None, None] ** 2
    shaped = np.linalg.solve(closed, np.eye(n) * (gain / (1j * w[:, None]))[:, None, :])
    return (shaped * (n * plan.amplitudes**2)[:, None, :]) @ shaped.conj().transpose(0, 2, 1)


def noise_covariance(G: np.ndarray, w: np.ndarray, plan: Plan, model: RobotModel) -> np.ndarray:
    """Covariance (lines, n_o, n_o) of the error of ``Y - G U`` in one period, from the noise of
    drives and sensors.
    """
    hardware = plan.hardware
    n = len(plan.motors)
    scale = 4.0 / plan.samples  # of a Fourier coefficient that is an amplitude
    angle = hardware.encoder_noise_rad**2 + hardware.encoder_resolution_rad**2 / 12
    # A drive without noise still rounds: what is predicted must stay finite.
    torque = max(hardware.torque_noise_Nm, 1e-9) ** 2
    of = {name: sensor for sensor in model.sensors for name in sensor.channels}
    slower = {
        name: (of[name].sample_s or hardware.sample_s) / hardware.sample_s for name in plan.sensors
    }
    sensed = noises(model, plan.sensors) ** 2 * [slower[name] for name in plan.sensors]
    output = np.concatenate([np.full(n, angle), sensed])
    white = w[:, None] ** (2 * output_orders(model, plan.sensors)) * np.maximum(output, 1e-24)
    by_torques = torque * G @ G.conj().transpose(0, 2, 1)
    largest = np.einsum("loo->lo", by_torques.real)[:, n:].max(axis=0)
    white[:, n:] = np.maximum(white[:, n:], ROUNDING**2 * largest)
    return scale * (by_torques + white[:, :, None] * np.eye(len(output)))


def information(
    vector: ParameterVector,
    plan: Plan,
    poses: np.ndarray,
    *,
    every: int = 1,
    fewest: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Information matrices of poses.

    Parameters
    ----------
    vector : ParameterVector
        At its start values.
    plan : Plan
        All but its poses is used.
    poses : array (k, n_m) [rad]
    every : int
        Use every second, third ... line and weight it by this number.
    fewest : int, optional
        So many poses can be the result where the time limit or Ctrl-C ends it; default: all.
    progress : callable, optional

    Returns
    -------
    F : array (k', n, n)
        Of x, for the poses where the robot can rest.
    used : array of int (k',)
        Their indices.
    """
    local = LocalModel(vector.model, vector.of_model, plan.sensors)
    thinned = plan_lines(plan, slice(every // 2, None, every))
    out = []
    used = []
    for k, pose in enumerate(poses):
        began = perf_counter()
        with keep_best() if fewest is not None else nullcontext():
            check_time(f"pose {k + 1} of {len(poses)}")
            try:
                out.append(every * _by_line(vector, local, thinned, pose).sum(axis=0))
            except SolverError:
                continue
            used.append(k)
        if fewest is not None and is_over():
            break
        if fewest is not None and len(out) >= fewest:
            part_known("candidates", perf_counter() - began, len(poses) - k - 1)
        if progress is not None:
            progress(f"pose {k + 1} of {len(poses)}")
    if not out:
        raise SolverError(
            "poses: the robot can rest at none of them; check the limits of the joints"
        )
    return np.array(out), np.array(used)


def information_by_line(vector: ParameterVector, plan: Plan, pose: np.ndarray) -> np.ndarray:
    """Information of each line (lines, n, n) at one pose (n_m,)."""
    return _by_line(vector, LocalModel(vector.model, vector.of_model, plan.sensors), plan, pose)


def _by_line(
    vector: ParameterVector, local: LocalModel, plan: Plan, pose: np.ndarray
) -> np.ndarray:
    w = 2 * np.pi * plan.frequencies
    drive = vector.drive_at(
        vector.start, Drive(plan.hardware.sample_s, plan.hardware.delay_s, has_images=False)
    )
    response = local.response(local.values, pose[None], w, drive, speed_sd=plan.speed_sd)
    assert response.dG is not None
    G = response.G[0]
    dG = along_x(vector, local, vector.start, response.G, response.dG, w)[0]
    U = np.linalg.cholesky(torque_spectra(G[:, : len(plan.motors)], w, plan))
    L = np.linalg.cholesky(noise_covariance(G, w, plan, vector.model))
    J = np.linalg.solve(L, np.einsum("labp,lbe->lape", dG, U).reshape(*L.shape[:2], -1))
    J = (
        J.reshape(len(w), L.shape[1], len(vector), -1)
        .transpose(0, 2, 1, 3)
        .reshape(len(w), len(vector), -1)
    )
    return np.asarray(
        2 * plan.periods * plan.realizations * np.real(J.conj() @ J.swapaxes(-1, -2))
    )


def plan_lines(plan: Plan, lines: slice) -> Plan:
    """The plan with some of its lines."""
    return replace(
        plan,
        lines=plan.lines[lines],
        amplitudes=plan.amplitudes[lines],
        phases=plan.phases[:, lines],
    )


def along_x(
    vector: ParameterVector,
    local: LocalModel,
    x: np.ndarray,
    G: np.ndarray,
    dG: np.ndarray,
    w: np.ndarray,
) -> np.ndarray:
    """Derivatives of G (k, lines, outputs, n_m, n) in x from those in the numbers of the model."""
    values = vector.named(x)
    change = vector.dvalues(x)
    motors = [motor.name for motor in vector.model.motors]
    out = np.zeros((*G.shape, len(vector)), complex)
    at = {name: k for k, name in enumerate(local.names)}
    for i, unknown in enumerate(vector.unknowns):
        if unknown.name == "delay":
            out[..., i] = -1j * w[:, None, None] * G
        elif is_of_sensor(unknown.name):
            late = local.outputs.of(unknown.name.removesuffix(SENSOR_DELAY))
            out[..., i] = -1j * w[:, None, None] * G * late[:, None]
        elif is_of_drive(unknown.name):
            j = motors.index(unknown.name.rpartition(".")[0])
            out[..., :, j, i] = G[..., :, j] / values[unknown.name] * change[i]
        else:
            out[..., i] = dG[..., at[unknown.name]] * change[i]
        for name in unknown.tied:
            out[..., i] += dG[..., at[name]] * (values[name] / values[unknown.name] * change[i])
    return out


def covariance(F: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """Covariance (..., n, n) of x from its information and the prior."""
    return np.linalg.inv(F + np.diag(prior_sd**-2.0))


def choose(
    F: np.ndarray,
    count: int,
    vector: ParameterVector,
    criterion: str,
    names: Sequence[str] | None = None,
) -> list[int]:
    """Indices of the best ``count`` poses: greedy choice, then exchanges as long as one helps.

    Parameters
    ----------
    F : array (k, n, n)
        Information of each candidate.
    count : int
        No pose is taken twice: repeating a pose does not reduce its model error.
    vector : ParameterVector
    criterion : str
        ``"A"``: least sum of variances; ``"D"``: least determinant of the covariance.
    names : sequence of str, optional
        Parameters that count; default: all but the frictions.
    """
    if criterion not in ("A", "D"):
        raise ArgumentError(
            f"criterion: given {criterion!r}, expected one of {', '.join(CRITERIA)}"
        )
    if count > len(F):
        raise ArgumentError(
            f"poses: given {count}, expected at most {len(F)}, the number of candidates"
        )
    target = count_parameters(vector, names)

    def cost(total: np.ndarray) -> np.ndarray:
        block = covariance(total, vector.prior_sd)[..., target, :][..., target]
        return (
            np.trace(block, axis1=-2, axis2=-1)
            if criterion == "A"
            else np.linalg.slogdet(block)[1]
        )

    chosen: list[int] = []
    total = np.zeros_like(F[0])
    for _ in range(count):
        costs = cost(total + F)
        costs[chosen] = np.inf
        best = int(np.argmin(costs))
        chosen.append(best)
        total = total + F[best]
    improved = True
    now = float(cost(total))
    while improved:
        improved = False
        for k in range(count):
            rest = total - F[chosen[k]]
            costs = cost(rest + F)
            costs[[c for c in chosen if c != chosen[k]]] = np.inf
            best = int(np.argmin(costs))
            if costs[best] < now - 1e-9 * abs(now):
                chosen[k] = best
                total = rest + F[best]
                now = float(costs[best])
                improved = True
    return chosen


def count_parameters(vector: ParameterVector, names: Sequence[str] | None = None) -> np.ndarray:
    """Which parameters count: the named ones, by default all but the frictions; all where there
    are no others.
    """
    out = np.array(
        [not n.endswith(FRICTIONS) if names is None else n in names for n in vector.names]
    )
    return out if out.any() else np.ones(len(out), bool)
