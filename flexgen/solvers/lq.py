"""Stable inversion by linear-quadratic Gauss-Newton steps, in C: the method for who does not choose.

Unknown are the accelerations of the non-actuated coordinates at three Gauss points of each interval, the control of the
double integrator y = (q_e, v_e). The non-actuated rows R(q_e, v_e, a_e, t) of the reduced problem are made to vanish in
the sense of least squares, with weights so small that they only decide what the rows leave open: of all motions that
satisfy them, the one that does not blow up. It starts exactly at rest, needs no eigenvalues, and passes flat points,
where the acceleration cannot be found from the rows.

Order: the motion at the nodes is of order six in the interval length where the zero dynamics is slow against it.

Source: cf. D. Chen, B. Paden, Int. J. Control 64(1), 1996 (stable inversion); J. B. Rawlings, D. Q. Mayne, M. Diehl,
Model Predictive Control, 2017, sec. 8.8 (Riccati recursion of Gauss-Newton steps).
"""

from __future__ import annotations

import numpy as np

from flexgen.errors import ArgumentError, SolverError
from flexgen.problems.path import Path
from flexgen.runtime.inversion import Inversion
from flexgen.solvers.answer import Answer
from flexgen.solvers.drives import Drives
from flexgen.solvers.inverter import inverter
from flexgen.solvers.question import Question
from flexgen.solvers.reduction import Reduction

TOLERANCE = 1e-6  # residual on the mesh, relative to the torques of a hundredth of a radian
LONGEST = 1e-2  # s: of an interval
SAMPLES = 900_000


def answer(ask: Question, h: float) -> Answer:
    """Invert along the whole path. Options: ``native`` (bool): compile for this processor."""
    ask.only("lq", "native")
    library = inverter(ask.equations, "lq", native=bool(ask.options.get("native", False)), progress=ask.progress)
    path = ask.path
    n, period, every, lead, tail = grid(ask, min(2 * h, LONGEST) if ask.mesh is None else h)
    place, rate, rate2 = samples(Reduction(ask.equations), path, period, n)
    found = library.invert(
        place,
        rate,
        rate2,
        period=period,
        q_start=path.q_start,
        lead=lead,
        tail=tail,
        every=every,
        tolerance=TOLERANCE,
    )
    if ask.limits is not None:
        from flexgen.solvers.limited import keep  # here, as it builds upon this

        return keep(ask, found, library, every, TOLERANCE)
    return from_library(found)


def grid(ask: Question, h: float) -> tuple[int, float, int, int, int]:
    """Samples on the path, their period [s], samples an interval of about ``h`` [s], samples before and after."""
    duration = ask.path.duration
    before, after = ask.windows
    if ask.preview is not None:
        before = float(ask.preview)
    steps = int(np.ceil(duration / min(ask.step, h) - 1e-9))
    whole = (duration + before + after) / duration
    if whole * steps > SAMPLES:
        coarser = int(SAMPLES / whole)
        if coarser < 1 or duration / coarser > h:
            raise ArgumentError(
                f"mesh: given {h:.3g} s, which makes {whole * duration / h:.3g} intervals over {whole * duration:.3g} s, "
                f"expected at most {SAMPLES}; take a coarser --mesh, a shorter --preview or a shorter move"
            )
        steps = coarser
    period = duration / steps
    every = max(1, round(h / period))
    return steps + 1, period, every, int(np.ceil(before / period - 1e-9)), int(np.ceil(after / period - 1e-9))


def samples(reduction: Reduction, path: Path, period: float, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place (n, n_t), rate and its rate (n, n_y) of the output at n samples of a path."""
    sample = path.sample(np.arange(n) * period)
    return tuple(np.ascontiguousarray(x) for x in (reduction.targets(sample), sample.rates(1), sample.rates(2)))  # type: ignore[return-value]


def from_library(found: Inversion) -> Answer:
    """The answer of an inversion in C; the motors' accelerations by differences, for pictures and residuals."""
    t = found.t
    step = t[1] - t[0]
    if not np.isfinite(found.tau_m).all():
        raise SolverError("the library returned torques that are not finite")
    return Answer(
        t,
        found.q_a,
        found.v_a,
        found.a_a,
        found.tau_g,
        Drives(found.q_m, found.v_m, slope(found.v_m, step), found.tau_m),
        lead=found.lead * found.period,
        iterations=found.iterations,
        intervals=found.intervals,
        details={"residual": found.residual, "residual_between": found.residual_between},
    )


def slope(x: np.ndarray, step: float) -> np.ndarray:
    """Time derivative of samples (n, m) by central differences of order six; constant before and after."""
    padded = np.concatenate([np.repeat(x[:1], 3, axis=0), x, np.repeat(x[-1:], 3, axis=0)])

    def apart(k: int) -> np.ndarray:
        return padded[3 + k : len(padded) - 3 + k] - padded[3 - k : len(padded) - 3 - k]

    return (45 * apart(1) - 9 * apart(2) + apart(3)) / (60 * step)
