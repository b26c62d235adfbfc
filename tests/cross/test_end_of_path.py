"""The end of an inversion does not depend on how long after the path it ends, and does not
ring.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inversion_cases import last_joint
from toolchain import needs_compiler

from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.model.reader import read
from flexgen.paths.path import Path

pytestmark = needs_compiler

PERIOD = 1e-3  # s
N = 301  # samples on the path of 0.3 s
AFTER = 60  # samples after it
# factors of stiffness and damping of a joint; its stable zeros have a time constant of 0.35 s
SLOW = (0.1, 0.02)
AGREES = 1e-6  # of the largest torque; the last samples were off by 1e-4 to 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("method", ["lq", "bvp"])
def test_the_last_samples_are_those_of_a_longer_inversion(method: str) -> None:
    model = last_joint(read("planar5_mp"), *SLOW)
    equations = derive(model)
    move = replace(model.moves[0], duration=(N - 1) * PERIOD, smoothness=4)
    path = Path(equations, move)
    y, dy, ddy = samples(Reduction(equations), path, PERIOD, N)
    library = inversion_library(equations, method)
    function = library.invert if method == "lq" else library.bvp
    torques = []
    for n_post in (AFTER, 20 * AFTER):
        found = function(
            y,
            dy,
            ddy,
            period=PERIOD,
            q_start=path.q_start,
            n_pre=20,
            n_post=n_post,
            samples_per_interval=5,
            tolerance=1e-6,
        )
        torques.append(found.tau_m[: 20 + N + AFTER])
    short, long = torques
    moving = np.abs(np.diff(long[-10:], axis=0)).max()
    assert moving > 1e-5 * np.abs(long).max()  # the arm has not settled there
    assert np.abs(short - long).max() < AGREES * np.abs(long).max()
