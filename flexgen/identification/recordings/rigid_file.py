"""Motions for the rigid-body fit from described files, and the way back to a model file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.identification.recordings.description import Description
from flexgen.identification.recordings.rigid_body import Motion, RigidFit
from flexgen.identification.result import write_model
from flexgen.mechanics.parameters import select

BODY = ("mass", "com_x", "com_y", "com_z", "inertia_xx", "inertia_yy", "inertia_zz", "inertia_xy", "inertia_yz",
        "inertia_xz")  # fmt: skip
ROUNDING = 1e-15  # kg, m, kg m^2: smaller numbers are rounding errors, and a model file has none below 1e-18
FRICTION = ("viscous", "coulomb", "beta", "offset")


def motions_of(data: Description) -> list[Motion]:
    """The recordings as motions of the joints; springs of the gears are small."""
    inverse = np.linalg.inv(data.model.eta).T
    return [Motion(run.t, run.q_m @ inverse, run.tau_m) for _, run in data.recordings]


def rigid_numbers(fit: RigidFit) -> dict[str, float]:
    """Name -> value of all bodies, rotors and frictions; the payload is a part of the last body."""
    model, out = fit.model, {}
    names = [f"{element.name}.{name}" for element in model.elements for name in BODY]
    names += [f"{motor.name}.{name}" for motor in model.motors for name in (*FRICTION, "inertia")]
    for parameter in select(model, names):
        out[parameter.name] = parameter.value if abs(parameter.value) > ROUNDING else 0.0
    return out


def write_rigid(fit: RigidFit, path: str | Path, source: str) -> Path:
    """Write the new model file: the old text with the numbers of bodies, rotors and frictions replaced.

    Raises
    ------
    ArgumentError
        The model is not from a ``.toml`` file with ``[[element]]`` tables, or has a payload with an inertia.
    """
    if fit.file.payload.mass:
        raise ArgumentError(
            "model file: given a payload, expected none: the fit cannot tell it from the last body; remove [payload]"
        )
    head = (
        "# Bodies: only combinations of these numbers are determined; each body by itself may be another one.\n"
        "# A counterbalance is not in the model.\n"
    )
    return write_model(path, fit.file, rigid_numbers(fit), {}, source, head=head)
