"""Hypotheses on errors of a model or a record, each with one size: numbers of the model, changes
of the responses.

G -> L G R,   var -> |L|^2 var |R|^2,   C -> L C L^T,   U U^H -> R^-1 U U^H R^-T
angles and torques
w -> w/z,     G -> z^-m G     (m: time derivatives of an output)
true sample time over the stated one: z
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.parameters import CONSTANT, DELAY, ParameterVector
from flexgen.identification.responses.response_outputs import ANGLE
from flexgen.model.elements import RobotModel

# where the search for what the model does not have begins [N m s/rad], [kg]
LEAST = {"viscous": 1e-4, "mass": 0.01}

Words = Callable[[float], str]
Change = Callable[[Frf, float], Frf]


@dataclass(frozen=True)
class Number:
    """Numbers of model or drives that are not free, which change by the same factor; ``say``:
    words for its value.

    ``names``: the first is fitted, the others are tied to it. The value is a factor to that of the
    file, but for a number that is zero there, and for one that the record states: there it is the
    difference from ``stated``.
    """

    names: tuple[str, ...]
    say: Words
    stated: float = 0.0


@dataclass(frozen=True)
class Changed:
    """A change of the responses by a factor that undoes the fault; ``gross``: only as a whole,
    with the factor 1.
    """

    change: Change
    say: Words
    gross: bool = False


def numbers_of(vector: ParameterVector, delay: float = 0.0) -> list[Number]:
    """Masses, rotor inertias, torque constants, delay and frictions that are not free; ``delay``
    [s]: of the torques, as the record states.
    """
    model = vector.model
    bodies = [e.name for e in model.elements if e.body.mass > 0]
    out = [
        Number((f"{name}.mass",), _say_change(f"mass of {name}", "larger", "smaller"))
        for name in bodies
    ]
    change = _say_change("payload", "heavier", "lighter")
    say = change if model.payload.mass > 0 else _say_value("a missing payload", 1.0, "kg")
    out.append(Number(("payload.mass",), say))
    for motor in model.motors:
        name = motor.name
        out.append(
            Number(
                (f"{name}.inertia",), _say_change(f"rotor inertia of {name}", "larger", "smaller")
            )
        )
        out.append(Number((name + CONSTANT,), _say_recorded(f"torque of {name}", inverse=True)))
        if motor.friction.viscous == 0.0:
            out.append(
                Number(
                    (f"{name}.viscous",),
                    _say_value(f"viscous friction of {name}", 1.0, "N m s/rad"),
                )
            )
    out.append(Number((DELAY,), _say_delay, delay))
    every = masses_of(model)
    if len(bodies) > 1:
        out.append(Number(every, _say_change("all masses", "larger", "smaller")))
    taken = {name for u in vector.unknowns for name in (u.name, *u.tied)}
    return [number for number in out if not taken & set(number.names)]


def masses_of(model: RobotModel) -> tuple[str, ...]:
    """Names of all masses and inertias of bodies and payload that are not zero."""
    parts = [e.name for e in model.elements if e.body.mass > 0]
    axes = ("xx", "yy", "zz", "xy", "xz", "yz")
    names = [
        f"{part}.{what}" for part in parts for what in ("mass", *(f"inertia_{k}" for k in axes))
    ]
    names += ["payload.mass"]
    there = {p.name for p in select(model, names) if p.value != 0.0}
    return tuple(name for name in names if name in there)


def extend(
    vector: ParameterVector,
    names: tuple[str, ...],
    model: RobotModel | None = None,
    delay: float = 0.0,
) -> ParameterVector:
    """The vector of a fit with more names: the first is free, the others follow it; with a model
    given all are free.

    A delay of the torques begins at that of the record, ``delay`` [s].
    """
    ties = {name: u.name for u in vector.unknowns for name in u.tied}
    more = names[:1] if model is None else names
    ties |= {name: names[0] for name in names[len(more) :]}
    robot = model or vector.model
    zero = [n for n in more if n.endswith(".viscous") or n == "payload.mass"]
    least = {
        p.name: LEAST[p.name.partition(".")[2]] for p in select(robot, zero) if p.value == 0.0
    }
    late = {name: delay for name in more if name == DELAY}
    return ParameterVector(
        robot,
        [*vector.names, *more],
        start={u.name: u.start for u in vector.unknowns} | least | late,
        bounds={u.name: (u.lower, u.upper) for u in vector.unknowns},
        priors={u.name: u.prior_sd for u in vector.unknowns},
        ties=ties,
    )


def changes_of(data: Frf) -> Iterator[Changed]:
    """Faults of the record: scales, signs, exchanged channels, units, hold and sample time."""
    yield Changed(
        with_sample_time, _say_change("sample time", "longer than stated", "shorter than stated")
    )
    if len(data.motors) > 1:
        yield Changed(_scale_torques, _say_recorded("torques of all motors"))
    for i, motor in enumerate(data.motors):
        yield Changed(_scale_of_angle(i), _say_recorded(f"angle of {motor}"))
    n = len(data.motors)
    motors = data.motors
    whole = np.eye(len(data.outputs)), np.eye(n)
    units = (("degrees, read as radians", np.pi / 180), ("radians, read as degrees", 180 / np.pi))
    for name, factor in units:
        for words, these in (
            ("angles", range(n)),
            *((f"angle of {motor}", [i]) for i, motor in enumerate(motors)),
        ):
            left = np.diag(np.where(np.isin(np.arange(len(data.outputs)), these), factor, 1.0))
            yield _gross(f"{words} in {name},", left, whole[1])
    for i, motor in enumerate(motors):
        left, right = (np.diag(np.where(np.arange(len(x)) == i, -1.0, 1.0)) for x in whole)
        yield _gross(f"the sign of the angle of {motor}", left, whole[1])
        yield _gross(f"the sign of the torque of {motor}", whole[0], right)
    # without sensors, both signs of one of two axes change the responses as those of the other do,
    # and both signs of all axes change nothing
    apart = n > 2 or len(data.outputs) > n
    for i in range(n) if apart else range(n - 1):
        left, right = (np.diag(np.where(np.arange(len(x)) == i, -1.0, 1.0)) for x in whole)
        named = motors[i] if apart else " or of ".join(motors)
        yield _gross(f"the signs of angle and torque of {named}", left, right)
    for i, k in combinations(range(n), 2):
        left, right = (np.eye(len(x))[_swap(len(x), i, k)] for x in whole)
        yield _gross(f"exchanged angles of {motors[i]} and {motors[k]}", left, whole[1])
        yield _gross(f"exchanged torques of {motors[i]} and {motors[k]}", whole[0], right)
        yield _gross(f"exchanged angles and torques of {motors[i]} and {motors[k]}", left, right)
    if data.sample_s > 0:
        yield Changed(
            lambda x, _: replace(x, sample_s=0.0), lambda _: "torques without hold", gross=True
        )


def transform(data: Frf, left: np.ndarray, right: np.ndarray) -> Frf:
    """The responses ``L G R`` of other angles and torques; L (outputs, outputs), R (n_m, n_m)."""
    inverse = np.linalg.inv(right)
    powers = left**2, right**2
    return replace(
        data,
        G=left @ data.G @ right,
        variance=powers[0] @ data.variance @ powers[1],
        total=None if data.total is None else powers[0] @ data.total @ powers[1],
        C=left @ data.C @ left.T,
        UU=inverse @ data.UU @ inverse.T,
    )


def with_sample_time(data: Frf, factor: float) -> Frf:
    """The responses with a sample time that is longer by a factor than the record states."""
    orders = np.array([ANGLE] * len(data.motors) + list(data.orders))
    scaled = transform(data, np.diag(factor**-orders), np.eye(len(data.motors)))
    return replace(
        scaled, w=data.w / factor, sample_s=data.sample_s * factor, delay_s=data.delay_s * factor
    )


def _scale_of_angle(i: int) -> Change:
    """Undoes an angle that is recorded too large by a factor."""

    def change(data: Frf, factor: float) -> Frf:
        scale = np.ones(len(data.outputs))
        scale[i] = 1.0 / factor
        return transform(data, np.diag(scale), np.eye(len(data.motors)))

    return change


def _scale_torques(data: Frf, factor: float) -> Frf:
    """Undoes torques that are all recorded too large by a factor."""
    return transform(data, np.eye(len(data.outputs)), factor * np.eye(len(data.motors)))


def _gross(words: str, left: np.ndarray, right: np.ndarray) -> Changed:
    return Changed(lambda data, _: transform(data, left, right), lambda _: words, gross=True)


def _swap(count: int, i: int, k: int) -> list[int]:
    order = list(range(count))
    order[i] = k
    order[k] = i
    return order


def _say_change(what: str, more: str, less: str) -> Words:
    """Words for a factor: ``payload 20 % heavier``."""
    return lambda factor: (
        f"{what} {float(f'{100 * abs(factor - 1):.2g}'):g} % {more if factor > 1 else less}"
    )


def _say_recorded(what: str, inverse: bool = False) -> Words:
    """Words for the scale of a channel: the value recorded over the true one, or the reverse."""
    say = _say_change(what, "too large in the record", "too small in the record")
    return (lambda factor: say(1.0 / factor)) if inverse else say


def _say_delay(seconds: float) -> str:
    return (
        f"torques that act {1e3 * abs(seconds):.3g} ms {'later' if seconds > 0 else 'earlier'} "
        "than stated"
    )


def _say_value(what: str, scale: float, unit: str) -> Words:
    return lambda value: f"{what} of {scale * value:.3g} {unit}"
