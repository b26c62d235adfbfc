"""Results of every function of a library, to compare two builds bit by bit."""

from __future__ import annotations

import numpy as np

from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.paths.path import Path as ToolPath
from flexgen.runtime.library import Library

POINTS = 37
SAMPLES = 401
# samples before and after the path, samples per interval
PRE = 30
POST = 60
EACH = 5
INTERVALS = 40  # of the stream
MOTION = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")


def arrays(library: Library) -> dict[str, np.ndarray]:
    """Results of all functions at many points and at one, of invert, bvp, invert_limited and the
    stream.
    """
    rng = np.random.default_rng(1)
    out: dict[str, np.ndarray] = {}
    for name, function in library.functions.items():
        given = [rng.normal(size=(POINTS, *port.shape)) for port in function.inputs]
        for label, results in (
            ("batch", function(*given)),
            ("point", function(*(x[0] for x in given))),
        ):
            for k, x in enumerate(results if isinstance(results, tuple) else (results,)):
                out[f"{name} {label} {k}"] = x
    equations = derive(library.name)
    path = ToolPath(equations, equations.model.move(None))
    period = path.duration / (SAMPLES - 1)
    y, dy, ddy = samples(Reduction(equations), path, period, SAMPLES)
    options = {"n_pre": PRE, "n_post": POST, "samples_per_interval": EACH, "tolerance": 1e-6}
    for solver in ("invert", "bvp") if equations.model.n_e else ("invert",):
        result = getattr(library, solver)(
            y, dy, ddy, period=period, q_start=path.q_start, **options
        )
        out |= {f"{solver} {key}": getattr(result, key) for key in MOTION}
    bound = 0.99 * np.abs(result.v_m).max(axis=0)
    limited = library.invert_limited(
        y, dy, ddy, period=period, q_start=path.q_start, speed_max=bound, **options
    )
    out |= {f"invert_limited {key}": getattr(limited, key) for key in (*MOTION, "deviation")}
    assert limited.limits_active
    stream = library.stream(
        y[0], path.q_start, period=4 * period, intervals=INTERVALS, samples_per_interval=4
    )
    rows = [stream.update(y[k], dy[k], ddy[k]) for k in range(4, SAMPLES, 4)]
    out |= {
        f"stream {key}": np.array([getattr(row, key) for row in rows])
        for key in MOTION
        if key != "a_a"
    }
    return out
