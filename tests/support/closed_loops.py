"""Loops at rest and references that move them, for the tests of the sampled closed loop."""

from __future__ import annotations

import numpy as np

from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.loop.closed_loop import ClosedLoop
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.experiment import largest_rate
from flexgen.identification.experiments.plan import default_cascade
from flexgen.identification.responses.local_model import LocalModel
from flexgen.model.elements import RobotModel

T = 5e-4


def loop_of(
    model: RobotModel,
    hardware: DriveHardware,
    lanes: int = 1,
    controller: Cascade | None = None,
    **more,
):
    """A loop at home, its feedforward included in the reference that comes with it."""
    local = LocalModel(model, ())
    q_m = np.tile(model.eta @ np.array(model.home), (lanes, 1))
    rest = local.rest(local.values, q_m)
    library = library_with(model, ("forward_dynamics",))
    cascade = controller or default_cascade(model)
    rate = largest_rate(local, q_m)
    loop = ClosedLoop(model, library, hardware, cascade, rest.y[:, : model.n_a], q_m, rate, **more)
    loop.hold(rest.tau_m)
    return loop, np.concatenate([q_m, rest.tau_m], axis=1), local, rest


def moving(at_rest: np.ndarray, n_m: int, samples: int, size: float = 0.05) -> np.ndarray:
    """References that start at rest and swing, one lane like the other but for the size."""
    t = np.arange(samples) * T
    swing = size * (1 - np.cos(2 * np.pi * 4.0 * t))
    reference = np.tile(at_rest, (samples, 1, 1))
    reference[:, :, :n_m] += swing[:, None, None] * (1 + 0.1 * np.arange(len(at_rest)))[:, None]
    return reference
