"""Power over the lines of an excitation that makes the parameters most accurate.

    min over p: trace C_s,   C = (sum_l p_l F_l + W)^-1,   sum_l p_l = 1,   p_l >= 0
    (A-optimal)

F_l: information of line l with all of the power, summed over the poses; W: prior; C_s: the block
of all parameters but the frictions. Multiplicative algorithm
``p_l <- p_l (d_l / sum_l p_l d_l)^(1/2)``, ``d_l = trace (S C F_l C S')``.

An optimal spectrum has few lines, which a wrong start model may misplace: half of the power stays
as it was.

Source: F. Pukelsheim, Optimal Design of Experiments, 1993; Y. Yu, Annals of Statistics 38(3), 2010
(convergence).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.experiments.operating_points import (
    count_parameters,
    covariance,
    information_by_line,
)
from flexgen.identification.responses.parameters import ParameterVector

KEPT = 0.5  # part of the power that stays where it was
STEPS = 500  # of the algorithm
SMALLEST_GAIN = 1e-5  # relative decrease of the trace where it ends


def with_optimal_spectrum(plan: Plan, vector: ParameterVector) -> Plan:
    """The plan with half of its power at the most informative frequencies of its poses; each motor
    keeps its rms.
    """
    F = sum(information_by_line(vector, plan, pose) for pose in plan.poses)
    power = plan.amplitudes[:, 0] ** 2
    # as if all of the power were in this line
    each = np.asarray(F) / power[:, None, None] * power.sum()
    best = optimal_power(each, vector)
    mixed = KEPT * power / power.sum() + (1 - KEPT) * best
    total = (plan.amplitudes**2).sum(axis=0)
    return replace(plan, amplitudes=np.sqrt(mixed[:, None] * total))


def optimal_power(F: np.ndarray, vector: ParameterVector) -> np.ndarray:
    """Parts of the power (lines,) that make the trace of the covariance least; ``F`` (lines, n,
    n).
    """
    target = count_parameters(vector)
    power = np.full(len(F), 1.0 / len(F))
    last = np.inf
    for _ in range(STEPS):
        C = covariance(np.einsum("l,lab->ab", power, F), vector.prior_sd)
        trace = float(np.trace(C[target][:, target]))
        if last - trace < SMALLEST_GAIN * trace:
            break
        last = trace
        gain = np.einsum("sa,lab,bs->l", C[target], F, C[:, target], optimize=True)
        power = power * np.sqrt(gain / (power @ gain))
        power = power / power.sum()
    return power
