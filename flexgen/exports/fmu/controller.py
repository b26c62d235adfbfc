"""A P-PI cascade as a block: measured angles, reference angles and feedforward torques in, motor
torques out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission.spec import library_name
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.exports.fmu.block import Block, time_variable
from flexgen.exports.fmu.variables import INPUT, OUTPUT, PARAMETER, Variable
from flexgen.feedback.loop.controller_files import file_controller
from flexgen.feedback.loop.controllers import SOURCE, Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.loop.interface import Setup
from flexgen.model.elements import RobotModel

_GAINS = (
    ("position_gain", "1/s", "gain of the position error"),
    ("speed_gain", "N.m.s/rad", "gain of the speed error"),
    ("integral_gain", "1/s", "gain of the integral of the speed error"),
    ("torque_max", "N.m", "above it the integral does not grow; 0: no limit"),
)


def controller(model: RobotModel, given: Any, sample_time: float) -> Block:
    """The block of a cascade for a model.

    Parameters
    ----------
    model : RobotModel
        Its motors, and the equilibrium at home for the start values.
    given : Cascade, PPI, path of a file .toml with one of them, or None
        The gains of a `PPI` are those for the pose at home, with one sample time of delay; None: a
        `PPI`.
    sample_time : float
        [s].
    """
    held = hold_joints(derive(model), np.array(model.home))
    if isinstance(given, str | Path):
        if not Path(given).exists():
            raise ArgumentError(
                f"controller: given {str(given)!r}, which does not exist, expected a file .toml"
            )
        file = given
        given = file_controller(str(given)) if str(given).endswith(".toml") else None
        if given is None:
            raise ArgumentError(
                f"controller: given {str(file)!r}, expected a file .toml of type ppi or cascade"
            )
    given = PPI() if given is None else given
    if isinstance(given, PPI):
        rest_a = np.zeros((1, model.n_a))
        rest_m = np.zeros((1, model.n_m))
        motion = (held.q_a[None], rest_a, rest_a, held.q_m[None], rest_m, rest_m, held.tau_m[None])
        given = given.cascade(model, 2.0 * sample_time, motion)
    if not isinstance(given, Cascade):
        raise ArgumentError(
            f"controller: given {type(given).__name__}, expected a flexgen.Cascade or "
            "flexgen.PPI for the block 'controller'"
        )
    n = model.n_m
    # checks the gains and the filters
    given.compiled(Setup(held.q_m[None], sample_time, model.n_a, n, 2 * n))
    sections = np.array([np.tile(f.section(sample_time), (n, 1)) for f in given.filters]).reshape(
        len(given.filters), n, 5
    )
    most = np.zeros(n) if given.torque_max is None else np.asarray(given.torque_max, float)
    gains = (given.position_gain, given.speed_gain, given.integral_gain, most)
    name = f"{library_name(model)}_controller"
    count = 4 + 4 * n + sections.size + 3 * n + 2 * n * len(sections)
    return Block(
        name=name,
        title=name,
        text=f"P-PI cascade for {model.description}",
        macro="FMU_CONTROLLER",
        variables=tuple(_variables(model, held.q_m, held.tau_m, gains)),
        sources={SOURCE.name: SOURCE.read_text(encoding="ascii")},
        header="",
        defines={"N_M": str(n), "SECTIONS": str(len(sections))},
        constants={
            "SETTING_LEAST": [],
            "SETTING_MOST": [],
            "FILTERS": [float(x) for x in sections.ravel()],
        },
        sample_time=sample_time,
        step=sample_time,
        memory=str(count),
        work="0",
        derivatives=False,
    )


def _variables(
    model: RobotModel, q_m: np.ndarray, tau_m: np.ndarray, gains: Any
) -> list[Variable]:
    """Variables of the controller: time, measured and reference angles [rad], feedforward and
    commanded torques [N m], gains; ``q_m``, ``tau_m`` (n_m,): their start values.
    """
    n = model.n_m
    out = [time_variable()]
    for first, what, unit, starts, text in (
        (0, "measured_angle", "rad", q_m, "measured motor angle"),
        (n, "reference_angle", "rad", q_m, "reference of the motor angle"),
        (2 * n, "feedforward_torque", "N.m", tau_m, "feedforward torque, motor side"),
    ):
        for k, m in enumerate(model.motors):
            out.append(
                Variable(
                    f"motor.{m.name}.{what}",
                    INPUT,
                    first + k,
                    unit,
                    text,
                    float(starts[k]),
                    sampled=True,
                )
            )
    for k, m in enumerate(model.motors):
        name = f"motor.{m.name}.torque"
        text = "commanded motor torque, motor side"
        out.append(Variable(name, OUTPUT, k, "N.m", text, float(tau_m[k]), sampled=True))
    for i, (what, unit, text) in enumerate(_GAINS):
        for k, m in enumerate(model.motors):
            out.append(
                Variable(
                    f"motor.{m.name}.{what}", PARAMETER, i * n + k, unit, text, float(gains[i][k])
                )
            )
    return out
