"""Limits of robots of another size: all lengths times a power of two and the same gravity scale
every answer.

The deviation that keeps a limit grows with the robot, whatever it costs: no length in meters may
decide.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from enlarged import enlarged
from toolchain import needs_compiler

import flexgen
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples

pytestmark = [needs_compiler, pytest.mark.slow]
# s of the robot of the model file
PERIOD = 5e-3
FACTOR = 16.0
SAME = 1e-5  # relative: two programs in other units


def made(folder: Path, factor: float) -> tuple[flexgen.Equations, flexgen.Library]:
    """Equations and library of an elbow arm whose lengths are `factor` times as large."""
    file = folder / f"elbow_{factor:g}.toml"
    file.write_text(enlarged("elbow", factor), encoding="utf-8")
    model = flexgen.read(file)
    library = flexgen.generate(model, folder / file.stem, parts=["limits"], progress=False)
    return flexgen.derive(model), flexgen.load(library.directory)


def streamed(
    robot: tuple[flexgen.Equations, flexgen.Library], factor: float, share: float
) -> tuple[float, float]:
    """Largest torque over its limit, the `share` of the free motion, and largest deviation over
    the factor [m].
    """
    equations, library = robot
    path = flexgen.plan(equations, "line")
    period = PERIOD * factor**0.5
    given = samples(Reduction(equations), path, period, round(path.duration / period) + 200)
    most = np.ones(2)
    for limited in (False, True):
        stream = library.stream(
            given[0][0], path.q_start, period=period, intervals=60, samples_per_interval=5
        )
        if limited:
            stream.limit_all(torque_max=share * most, deviation=0.3 * factor)
        motion = [stream.update(*at) for at in zip(*(x[1:] for x in given), strict=True)]
        most, before = np.max([np.abs(x.tau_m).max(axis=0) for x in motion], axis=0), most
    return float((most / (share * before)).max()), max(x.deviation_m for x in motion) / factor


def test_a_stream_of_a_larger_robot_keeps_its_limits_as_well(tmp_path: Path) -> None:
    small, large = (
        [streamed(made(tmp_path, f), f, share) for share in (0.95, 0.6)] for f in (1.0, FACTOR)
    )
    for (excess, off), (excess_large, off_large) in zip(small, large, strict=True):
        assert excess_large < 1.004 and excess_large == pytest.approx(excess, rel=SAME)
        assert 5e-3 < off < 0.1 and off_large == pytest.approx(off, rel=SAME)


def test_the_deviation_of_a_whole_path_grows_with_the_robot(tmp_path: Path) -> None:
    found = []
    for factor in (1.0, FACTOR):
        equations, library = made(tmp_path, factor)
        path = flexgen.plan(equations, "line")
        period = 1e-3 * factor**0.5
        y, dy, ddy = samples(Reduction(equations), path, period, round(path.duration / period) + 1)
        before, after = (np.repeat(y[k : k + 1], n, axis=0) for k, n in ((0, 300), (-1, 800)))
        still = [np.zeros_like(x[:, : dy.shape[1]]) for x in (before, after)]
        given = (
            np.vstack([before, y, after]),
            *(np.vstack([still[0], x, still[1]]) for x in (dy, ddy)),
        )
        options = {
            "period": period,
            "q_start": path.q_start,
            "n_pre": 200,
            "n_post": 300,
            "samples_per_interval": 5,
        }
        limit = 0.6 * np.abs(library.invert(*given, **options).tau_m).max(axis=0)
        kept = library.invert_limited(*given, **options, torque_max=limit)
        assert kept.limit_excess < 1e-3 and (np.abs(kept.tau_m) <= 1.001 * limit).all()
        found.append(kept.deviation_m / factor)
    assert 0.04 < found[0] < 0.06 and found[1] == pytest.approx(found[0], rel=SAME)
