"""Choices of an identification, measured: spectra, sensors, springs that are not linear, and
traps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.rigid.missing_springs import without
from flexgen.model.elements import RobotModel

SMOOTH = (
    Path(__file__).resolve().parent.parent
    / "tests"
    / "support"
    / "robots"
    / "two_smooth_gears.toml"
)
TOOL = [
    {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2", "noise": 0.02},
    *(
        {"name": f"{name}{k}", "type": kind, "coordinate": f"q{k}", "unit": unit, "noise": noise}
        for name, kind, unit, noise in (
            ("link", "link_encoder", "rad", 1e-6),
            ("torque", "joint_torque", "N m", 1.0),
        )
        for k in range(1, 7)
    ),
]


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _accuracy(predicted: dict[str, float], kind: str) -> float:
    return 100 * _rms([sd for name, sd in predicted.items() if name.endswith(kind)])


def spectra(model: RobotModel, options: dict[str, Any]) -> list[list[Any]]:
    """Predicted deviations of stiffness and damping for spectra of the speeds."""
    rows = []
    for label, spectrum in (
        ("f^-1", -1.0), ("f^-0.5", -0.5), ("flat", 0.0), ("f^0.5", 0.5), ("optimal", "optimal"),
    ):  # fmt: skip
        plan = flexgen.excite(model, spectrum=spectrum, **options)
        rows.append(
            [label, _accuracy(plan.predicted, "stiffness"), _accuracy(plan.predicted, "damping")]
        )
    return rows


def sensors(model: RobotModel, name: str, options: dict[str, Any]) -> list[list[Any]]:
    """Predicted deviations with sensors in addition to the motor encoders, one pose and many."""
    robot = replace(model, sensors=flexgen.read(name, overrides={"sensor": TOOL}).sensors)
    links, torques = ([f"{name}{k}" for k in range(1, 7)] for name in ("link", "torque"))
    added = [("a tool accelerometer", ["acc.x", "acc.y", "acc.z"]), ("link encoders", links)]
    added += [("joint torque sensors", torques)]
    rows = []
    for label, used in [("motor encoders", []), *((f"and {name}", used) for name, used in added)]:
        plans = [
            flexgen.excite(robot, sensors=used, **options | {"poses": n})
            for n in (1, options["poses"])
        ]
        rows.append(
            [
                label,
                *(
                    _accuracy(plan.predicted, x)
                    for plan in plans
                    for x in ("stiffness", "damping")
                ),
            ]
        )
    return rows


def smooth_gears(hardware: flexgen.DriveHardware) -> list[list[Any]]:
    """Errors of low and high stiffness and of the break: averaged springs; time domain with
    Coulomb friction.
    """
    model = flexgen.read(SMOOTH)
    kinds = ("low", "high", "break_at")
    names = [f"{joint}.{kind}" for joint in ("q1", "q2") for kind in kinds]
    motors = tuple(
        replace(m, friction=replace(m.friction, coulomb=0.3, beta=0.5)) for m in model.motors
    )
    sticky = replace(model, motors=motors)
    rows = []
    for label, robot, speed, refine in (
        ("averaged springs, 0.003 rad/s rms", model, 0.003, False),
        ("averaged springs, 0.02 rad/s rms", model, 0.02, False),
        ("the same with Coulomb friction", sticky, 0.02, False),
        ("time domain with Coulomb friction", sticky, 0.02, True),
    ):
        true = {p.name: p.value for p in select(robot, names)}
        rng = np.random.default_rng(0)
        start = with_values(
            robot, {name: value * np.exp(rng.uniform(-0.4, 0.4)) for name, value in true.items()}
        )
        plan = flexgen.excite(
            robot,
            poses=12,
            free=names,
            speed_rms=speed,
            periods=4,
            f_min=1.0,
            f_max=60.0,
            hardware=hardware,
            transients=2,
            realizations=3,
            progress=False,
        )
        experiment = flexgen.measure(plan, robot, progress=False)
        found = flexgen.identify(start, flexgen.frf(experiment), progress=False)
        if refine:
            found = flexgen.refine(found, experiment, progress=False)
        away = {
            name: abs(100 * np.log(found.values[name] / value)) for name, value in true.items()
        }
        rows.append(
            [label, *(max(away[f"{joint}.{kind}"] for joint in ("q1", "q2")) for kind in kinds)]
        )
    return rows


def traps(model: RobotModel, data: Frf, find: Callable[..., Any]) -> list[list[Any]]:
    """Errors that mistakes about the robot or the drives cause; exact responses with the weights
    of an experiment.
    """
    true = {p.name: p.value for p in select(model, ["stiffness", "damping"])}
    bodies = select(model, [f"{e.name}.mass" for e in model.elements])
    inertias = [
        p.name
        for e in model.elements
        for p in select(model, [f"{e.name}.inertia_{a}" for a in ("xx", "yy", "zz")])
    ]
    rotors = select(model, [f"{m.name}.inertia" for m in model.motors])
    one = (1.0,) * model.n_m
    heavy = {p.name: 1.02 * p.value for p in (*bodies, *select(model, inertias)) if p.value}
    cases: list[tuple[str, RobotModel, Drive, RobotModel, float]] = [
        ("none", model, Drive(data.sample_s), model, data.sample_s),
        ("hold left out of the model", model, Drive(data.sample_s), model, 0.0),
        (
            "delay of a sample that the model lacks",
            model,
            Drive(data.sample_s, data.sample_s),
            model,
            data.sample_s,
        ),
        (
            "one spring missing in the model (t5y)",
            model,
            Drive(data.sample_s),
            without(model, "t5y"),
            data.sample_s,
        ),
        (
            "masses and inertias 2 % larger",
            with_values(model, heavy),
            Drive(data.sample_s),
            model,
            data.sample_s,
        ),
        (
            "rotor inertias 2 % larger",
            with_values(model, {p.name: 1.02 * p.value for p in rotors}),
            Drive(data.sample_s),
            model,
            data.sample_s,
        ),
        (
            "torque constants 1 % larger",
            model,
            Drive(data.sample_s, 0.0, tuple(1.01 * x for x in one)),
            model,
            data.sample_s,
        ),
    ]
    rows = []
    for label, robot, drive, used, sample_s in cases:
        local = LocalModel(robot, ())
        G = local.response(local.values, data.poses, data.w, drive, derivatives=False).G
        found = find(used, replace(data, G=G, sample_s=sample_s))
        away = {
            name: 100 * np.log(found.values[name] / true[name])
            for name in found.vector.names
            if name in true and not found.is_weak(name)
        }
        k, d = (
            [x for name, x in away.items() if name.endswith(kind)]
            for kind in ("stiffness", "damping")
        )
        rows.append(
            [
                label,
                f"{_rms(k):.2g} ({np.abs(k).max():.2g})",
                _rms(d),
                found.cost,
                str(found.status),
            ]
        )
    return rows
