"""The linearized robot as a state space of the package python-control."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.analysis.analyze import Analysis
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units


@provides("Analysis.to_control")
def control_system(analysis: Analysis, units: bool = False) -> Any:
    """The linearization of an analysis as a ``control.StateSpace``; see
    `flexgen.analysis.analyze.Analysis.to_control`.

    States x = (q_a, q_m of the motors behind elastic gears, and their derivatives), inputs tau_m,
    outputs (y, q_m), as deviations from the equilibrium:

        x' = A x + B u,    y = C x

    Of an output that is a pose, y has the position and the small rotation of the tool (world
    axes). With ``units`` the names of the signals end in their units.

    Raises
    ------
    ArgumentError
        The package control is not installed.
    """
    try:
        import control
    except ImportError:
        raise ArgumentError(
            "to_control: the package control is not installed; run: pip install "
            "'flexgen-robotics[control]'"
        ) from None
    model = analysis.model
    linear = analysis.linear
    A, B = linear.state_space()
    C = np.vstack([linear.W, linear.C_m])
    motors = [motor.name for motor in model.motors]
    positions = [f"q_a[{c.name}]" for c in model.coordinates] + [
        f"q_m[{motors[j]}]" for j in model.i_m
    ]
    labels = list(output_labels(model)["y_ref"])
    if model.output.type == "tool_pose":
        labels += [f"rot_{axis}" for axis in "xyz"]
    names = {
        "states": [*positions, *(f"d_{name}" for name in positions)],
        "inputs": [f"tau_m[{name}]" for name in motors],
        "outputs": [*(f"y[{label}]" for label in labels), *(f"q_m[{name}]" for name in motors)],
    }
    if units:
        angles = [c.unit for c in model.coordinates] + ["rad"] * len(model.i_m)
        of_y = list(output_units(model))
        of_y += ["rad"] * (len(labels) - len(of_y))
        of = {
            "states": [*angles, *(f"{unit}/s" for unit in angles)],
            "inputs": ["N m"] * len(motors),
            "outputs": [*of_y, *["rad"] * len(motors)],
        }
        names = {
            key: [f"{n} {u}" for n, u in zip(words, of[key], strict=True)]
            for key, words in names.items()
        }
    D = np.zeros((len(C), B.shape[1]))
    return control.ss(A, B, np.hstack([C, np.zeros_like(C)]), D, name=model.name, **names)
