"""What the curvature of the positions adds to the covariance of a calibration.

    x_true - x = v + w(v),      v ~ N(0, C),      w = -1/2 H^-1 J' W y''[v, v],      covariance = C + E[w w']

Joint zeros and placements that the poses do not separate keep the width of their priors, and move together along an
arc: a length across it changes with the square of their angle, by far more than the noise of the measurement tells.

Source: D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and Its Applications, 1988, ch. 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexgen.calibration.fit import CalibrationFit, Problem
from flexgen.errors import SolverError

DRAWS = 20  # of v: the width of w to some ten percent
ROUNDING = 1e-4  # of the variances of normalized numbers, far above that of the inverse


def with_curvature(problem: Problem, found: CalibrationFit) -> CalibrationFit:
    """The fit with the covariance to second order; numbers at a bound stay without one."""
    x, rest = found.x, found.rest
    _, gap, _ = problem.evaluate(x, rest.deflection)
    slopes = problem.slopes(x, rest, gap, found.scale)
    free = np.diag(found.covariance) > 0.0
    inner = np.ix_(free, free)
    matrix = problem.curvature(slopes)[inner]
    sd = np.sqrt(np.diag(found.covariance)[free])
    variances, axes = np.linalg.eigh(found.covariance[inner] / np.outer(sd, sd))
    widths = variances / np.sqrt(np.abs(variances) + ROUNDING)  # roots; smooth at zero, where rounding has any sign
    root = sd[:, None] * (axes * widths) @ axes.T
    bends = []
    for unit in np.random.default_rng(0).normal(size=(DRAWS, len(sd))):
        step = np.zeros(len(x))
        step[free] = root @ unit
        try:
            bends.append(problem.bend(x, rest, slopes, step)[free])
        except SolverError:
            continue  # so far that the springs do not carry the arm
    if not bends:
        return found
    w = -0.5 * np.linalg.solve(matrix, np.transpose(bends))
    covariance = found.covariance.copy()
    covariance[inner] += w @ w.T / w.shape[1]
    return replace(found, covariance=covariance)
