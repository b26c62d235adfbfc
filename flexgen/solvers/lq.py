"""Stable inversion by linear-quadratic Gauss-Newton steps, in C: the method for who does not choose.

Unknown are the accelerations of the non-actuated coordinates at three Gauss points of each interval, the control of the
double integrator y = (q_e, v_e). The non-actuated rows R(q_e, v_e, a_e, t) of the reduced problem are made to vanish in
the sense of least squares, with weights so small that they only decide what the rows leave open: of all motions that
satisfy them, the one that does not blow up. It starts exactly at rest, needs no eigenvalues, and passes flat points,
where the acceleration cannot be found from the rows.

Order: the motion at the nodes is of order six in the interval length where the zero dynamics is slow against it, and of
order four where it is fast.

Source: cf. D. Chen, B. Paden, Int. J. Control 64(1), 1996 (stable inversion); J. B. Rawlings, D. Q. Mayne, M. Diehl,
Model Predictive Control, 2017, sec. 8.8 (Riccati recursion of Gauss-Newton steps).
"""

from __future__ import annotations

from flexgen.solvers.answer import Answer
from flexgen.solvers.inverter import inverter
from flexgen.solvers.limited import keep
from flexgen.solvers.question import Question
from flexgen.solvers.reduction import Reduction
from flexgen.solvers.sampling import from_library, grid, samples

TOLERANCE = 1e-6  # residual on the mesh, relative to the torques of a hundredth of a radian
LONGEST = 1e-2  # s: of an interval


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
        return keep(ask, found, library, every, TOLERANCE)
    return from_library(found)
