"""Made-up results print their recorded texts: sentences, figures with their units and digits,
figures as JSON.

A net, not a proof: ``make golden`` writes `results.txt` again; read the difference before you
commit it.

Of `flexgen.studies.tolerances.result`, `flexgen.feedback.laws.passivity`,
`flexgen.identification.servo.fit_result`, `flexgen.feedback.positions.result`,
`flexgen.identification.gears.result`, `flexgen.identification.poses.result`,
`flexgen.identification.poses.content`.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from types import SimpleNamespace as Made
from typing import Any

import numpy as np

import flexgen
from flexgen.base.display import figure_rows
from flexgen.base.rows import Row
from flexgen.feedback.laws.passivity import Passivity
from flexgen.feedback.positions.result import PositionCommands
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.gears.result import GearFit, Number
from flexgen.identification.poses.components import Tilt
from flexgen.identification.poses.result import Calibration
from flexgen.identification.servo.fit_result import ServoFit
from flexgen.studies.tolerances.result import Band, Prediction, Share

FRAME = ("x", "y", "z", "rx", "ry", "rz")  # of the measurement


def made(kind: type, **fields: Any) -> Any:
    """A result with these attributes, which nothing checks."""
    out = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(out, name, value)
    return out


def prediction(error_m: float | None, error_rad: float | None, halves: int) -> Prediction:
    band = Band(("m1",), np.ones((2, 1)), np.full((2, 1), 0.5), 2 * np.ones((2, 1)))
    output = Made(type="combination" if error_m is None else "tool_pose")
    arm = Made(title="arm", output=output, not_measured=(), not_measured_sentence="")
    return made(
        Prediction,
        solution=Made(model=arm, move=Made(name="line")),
        feedback=Made(title="P-PI of 6 Hz"),
        sources=("a", "b", "c"),
        sd=np.array([0.1, 0.2, 0.3]),
        robots=48,
        seed=3,
        error_m=error_m,
        error_rad=error_rad,
        errors_m=None,
        errors_rad=np.array([1e-4, 2e-4]),
        time=np.array([0.0, 1.0]),
        torque=band,
        deflection=band,
        shares=tuple(Share(f"source {x}", "friction", x) for x in (0.625, 0.3701, 0.005, 0.00499)),
        to_halve=tuple(f"number {k}" for k in range(halves)),
    )


def servo(
    explained: float, noise: float = 2.5e-5, converged: bool = True, repeats: bool = False
) -> ServoFit:
    angle = np.array([[0.0], [0.0 if repeats else 0.5], [1.0]])
    law = flexgen.Cascade([20.0, 31.25], [5.0, 0.7], [1.0, 8.123456])
    return made(
        ServoFit,
        servo=flexgen.Servo(
            law, speed_feedforward=0.85, reference_filter_s=2.5e-3, sample_time=1e-3
        ),
        latency_s=3.125e-3,
        gain_sd=np.array([[0.011, 0.02], [0.03, 0.04], [0.05, 0.1234]]),
        common_sd={"speed_feedforward": 0.0123, "reference_filter_s": 1.5e-5, "latency_s": 2.5e-6},
        unexplained=np.array([1e-5, 3e-5]),
        noise=np.array([noise, noise]),
        explained=explained,
        converged=converged,
        motors=("m1", "m2"),
        record=Made(
            source="a.csv", notes=(), command=np.array([[0.0], [1.0], [2.0]]), angle=angle
        ),
        interpolation="linear",
        model="arm",
    )


def commands(failure: str, saturated: int, active: tuple[str, ...]) -> PositionCommands:
    model = Made(name="arm", title="arm@soft")
    time = np.array([-0.25, 0.0, 0.25, 0.5])
    joint = np.array([[0.0, 0.1], [0.1, 0.1], [0.3, 0.0], [0.2, 0.05]])
    run, today = (
        Made(
            model=model,
            solution=Made(move=Made(name="line"), status="solved"),
            nominal=Made(failure=failure, saturated=saturated),
            runs=("nominal",),
            tool_error_max_m=size,
            tool_error_max_rad=2 * size if saturated else None,
        )
        for size in (2.5e-5, 3e-3)
    )
    return made(
        PositionCommands,
        time=time,
        motor=100 * joint,
        joint=joint,
        joints=("q1", "q2"),
        units=("rad", "m"),
        period=0.25,
        interpolation="cubic",
        servo=None,
        run=run,
        today=today,
        active=active,
    )


def gears(status: FitStatus) -> GearFit:
    key = "element.upper.dof.q1.gear"
    numbers = (
        Number(
            "q1.stiffness", 7.5189e6, 1.25e4, "N m/rad", (f"{key}.spring.stiffness", "", -1), True
        ),
        Number("q1.damping", 1400.0, 2e3, "N m s/rad", (f"{key}.damping", "", -1), False),
        Number(
            "q1.hysteresis.lost_motion",
            2.9e-4,
            3e-6,
            "rad",
            (f"{key}.hysteresis", "lost_motion", 0),
            True,
        ),
        Number(
            "q1.hysteresis.stiffness",
            1e6,
            2e4,
            "N m/rad",
            (f"{key}.hysteresis", "stiffness", 0),
            True,
        ),
        Number(
            "q1.transmission_error.cos_1",
            1e-5,
            1e-6,
            "rad",
            (f"{key}.transmission_error", "cos", 0),
            True,
        ),
        Number(
            "q1.transmission_error.sin_3",
            2e-5,
            1e-6,
            "rad",
            (f"{key}.transmission_error", "sin", 1),
            True,
        ),
        Number("m1.cogging.cos_2", 0.25, 0.01, "N m", ("motor.m1.cogging", "cos", 0), True),
    )
    return made(
        GearFit,
        robot=Made(title="arm"),
        numbers=numbers,
        status=status,
        unexplained=np.array([0.5, 0.2]),
        noise=np.array([0.4, 0.1]),
        band_hz=24.5,
        delay_s=1.25e-4,
        joints=("q1",),
        loops=np.zeros((3, 1, 3)),
        harmonics=(1, 3),
        cogging=(2,),
        laws={f"{key}.hysteresis": ({"exponent": 2.0, "gamma": 0.5},)},
    )


def calibration(shared: bool, converged: bool = True) -> Calibration:
    names = ("q1.zero", "q2.compliance", "body.mass", *(f"measurement.{k}" for k in FRAME))
    kinds = ("zero", "compliance", "mass", *["frame"] * 6)
    unknowns = tuple(
        Made(name=n, kind=k, start=0.5, unit="rad", sd=0.1)
        for n, k in zip(names, kinds, strict=True)
    )
    errors = np.array([[1e-4, 2e-4], [np.nan, 6e-4]])
    out = made(
        Calibration,
        nominal=Made(title="arm"),
        poses=Poses(),
        unknowns=unknowns,
        x=np.arange(9.0),
        covariance=np.diag([1e-4, 0.0, 9e-3, *[1e-6] * 6]),
        errors_before=20 * errors,
        errors=errors,
        errors_held_out=2 * errors if shared else None,
        errors_seen=1.5 * errors if shared else None,
        sag=3 * errors,
        tilt=Tilt("chest", 2e-4, np.array([1e-3, 2e-3, 0.0]), 9e-4) if shared else None,
        converged=converged,
        warnings=("poses have an error above",),
    )
    return out


class Poses:
    """Poses of a file."""

    source = "poses.csv"
    is_measured = True

    def __len__(self) -> int:
        return 2


@functools.cache
def cases() -> dict[str, Callable[[], Any]]:
    """All results by name."""
    return dict(_cases())


def _cases() -> Iterator[tuple[str, Callable[[], Any]]]:
    yield "prediction of a pose", lambda: prediction(1.25e-3, 2e-4, 9)
    yield "prediction of an output", lambda: prediction(None, 2e-4, 2)
    yield "prediction of an unstable robot", lambda: prediction(None, None, 0)
    for least in (3.0, -0.25):
        margins = least + np.array([[0.0, 1.0, 2.0], [3.0, 0.125, 4.0]])
        fields = {
            "model": "arm",
            "controller": "pd",
            "poses": ("home", "end"),
            "hz": np.array([0.1, 1.5, 400.0]),
        }
        yield f"passivity {least}", functools.partial(made, Passivity, **fields, margins=margins)
    for explained in (0.987654, 0.5):
        yield f"servo {explained}", functools.partial(servo, explained)
    yield "servo with more than noise", functools.partial(servo, 0.99, 1e-5)
    yield "servo of a search without end", functools.partial(servo, 0.99, converged=False)
    yield "servo of coarse angles", functools.partial(servo, 0.99, repeats=True)
    yield "commands", lambda: commands("", 0, ())
    yield "commands at limits", lambda: commands("", 0, ("speed of q1", "acceleration of q2"))
    yield "commands of a saturated loop", lambda: commands("", 17, ())
    yield "commands of a loop that fails", lambda: commands("diverged at 0.3 s", 0, ())
    of_gears = (
        "fitted",
        "model error",
        "not converged",
        "noise too large",
        "time limit",
        "interrupted",
    )
    for status in map(FitStatus.of_value, of_gears):
        yield f"gears, {status}", functools.partial(gears, status)
    yield "calibration", lambda: calibration(True)
    yield "calibration without parts", lambda: calibration(False, converged=False)


def lines(name: str) -> list[str]:
    """The texts of a result."""
    found = cases()[name]()
    out = [
        *repr(found).splitlines(),
        *str(found).splitlines(),
        f"problem: {getattr(found, 'problem', '')}",
    ]
    if isinstance(found, Calibration):
        out += found.to_text().splitlines()
    if not isinstance(found, Calibration):
        rows = [part for part in found.content() if isinstance(part, Row)]
        out += [f"{name}: {text}" for name, text in figure_rows(rows)]
    figures = [
        f"{key}: {json.dumps(value, sort_keys=True, default=str)}"
        for key, value in found.to_dict().items()
    ]
    return [line.rstrip() for line in [*out, *figures]]
