"""The amplitude test of a fit: whether responses at other levels of the excitation differ, and by
which nonlinearity.

See `flexgen.identification.responses.amplitude`, which compares; here are the linear model and the
motions at each level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.lagrangian import gear_stiffness, gears
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.responses.amplitude import Comparison, Level, Nonlinearity, compare
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.gear_changes import Linearization
from flexgen.identification.responses.noise_structure import structured_covariance
from flexgen.identification.responses.residuals import Residuals, noise_levels, output_powers
from flexgen.model.elements import BacklashSpring, RobotModel

LEAST_FACTOR = 1.3  # between the speeds of two levels
WORDS = {
    "backlash": "backlash",
    "cubic": "a stiffness that rises with the deflection",
    "hysteresis": "hysteresis",
    "Coulomb": "Coulomb friction",
}


@dataclass(frozen=True)
class NonlinearCause:
    """A nonlinearity that explains the differences between levels: words, and the part that it
    explains.
    """

    words: str
    share: float

    def __str__(self) -> str:
        return f"{self.words} explains {100 * self.share:.0f} % of it"


@dataclass(frozen=True)
class AmplitudeTest:
    """Whether the responses depend on the level of the excitation.

    Parameters
    ----------
    ratio : float
        Mean square of the differences of the responses over their noise: 1 for a linear robot.
    size : float
        Median difference, as a part of the responses.
    differs, changed : bool
        Whether the responses differ beyond the noise, and gears or motors beyond the distortion
        too.
    causes : tuple of NonlinearCause
        Those that the data do not distinguish, the most probable first; empty where none explains
        the differences.
    """

    ratio: float
    size: float
    differs: bool
    changed: bool
    causes: tuple[NonlinearCause, ...]

    def to_dict(self) -> dict[str, Any]:
        """The sentence and the figures, as JSON types."""
        causes = [{"words": cause.words, "share": cause.share} for cause in self.causes]
        return {
            "sentence": self.sentence,
            "differs": self.differs,
            "changed": self.changed,
            "difference_over_noise": self.ratio,
            "difference_over_response": self.size,
            "causes": causes,
        }

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if not self.differs:
            return "no difference between the levels beyond the noise"
        start = f"the levels differ by {100 * self.size:.2g} % of the responses"
        if not self.changed:
            return (
                f"{start} by distortion, and stiffness, loss and friction of gears and motors "
                "do not"
            )
        if not self.causes:
            return f"{start}; {', '.join(WORDS.values())} of gears and motors do not explain it"
        return f"{start}; {', or '.join(map(str, self.causes))}"


def compare_levels(residuals: Residuals, x: np.ndarray, others: Sequence[Frf]) -> AmplitudeTest:
    """Compare the responses of a fit with those of the same experiment at other levels.

    Parameters
    ----------
    residuals : Residuals
        Of the fit.
    x : array (n,)
        Its parameters.
    others : sequence of Frf

    Raises
    ------
    ArgumentError
        The responses are not at the same poses and frequencies, or the levels are alike.
    """
    check_levels(residuals.data, others)
    robot = with_values(residuals.vector.model, _numbers(residuals, x))
    names, stiffness = elastic_gears(robot)
    found = compare(
        [level_of(residuals, data, x, stiffness) for data in (residuals.data, *others)]
    )
    causes = tuple(cause_in_words(cause, found, robot, names) for cause in found.causes)
    return AmplitudeTest(found.ratio, found.size, found.differs, found.changed, causes)


def check_levels(data: Frf, others: Sequence[Frf]) -> None:
    """ArgumentError where levels are of other poses or frequencies, or alike."""
    for k, other in enumerate(others, 1):
        same = (
            (data.motors, data.w.shape, data.poses.shape)
            == (other.motors, other.w.shape, other.poses.shape)
            and np.allclose(data.w, other.w)
            and np.allclose(data.poses, other.poses, atol=1e-3)
        )
        if not same:
            raise ArgumentError(
                f"levels, {k}: given responses of other motors, poses or frequencies, expected "
                "those of data at another level: plan it with poses=plan.joints(model) and the "
                "same arguments but speed_rms"
            )
        factor = float(np.mean(other.speed_sd / data.speed_sd))
        if max(factor, 1 / factor) < LEAST_FACTOR:
            raise ArgumentError(
                f"levels, {k}: given {factor:.3g} times the speeds of data, expected another "
                "level, such as a third"
            )


def _numbers(residuals: Residuals, x: np.ndarray) -> dict[str, float]:
    named = residuals.vector.named(x)
    return {name: named[name] for name in residuals.local.names}


def elastic_gears(robot: RobotModel) -> tuple[list[int], np.ndarray]:
    """Coordinates with elastic gears, and the stiffness of those at zero, arm side."""
    for i, (gear, _) in zip(robot.i_g, gears(robot), strict=True):
        if isinstance(gear.spring, BacklashSpring):
            raise ArgumentError(
                "levels: given a model with backlash in the gear of "
                f"{robot.coordinates[i].name}, expected other springs: the levels are compared "
                "by the stiffness at zero, which a dead band does not have"
            )
    elastic = [k for k, (gear, _) in enumerate(gears(robot)) if gear.spring is not None]
    return [robot.i_g[k] for k in elastic], gear_stiffness(robot)[elastic]


def level_of(residuals: Residuals, data: Frf, x: np.ndarray, stiffness: np.ndarray) -> Level:
    """The responses, the linear model and the motions at one level."""
    at = residuals.on(data)
    at.average_springs(x)
    local = at.local
    model = at.vector.model
    n = len(data.motors)
    values = np.array(list(_numbers(at, x).values()))
    M, D, K, B = local.matrices(values, data.poses, data.speed_sd, at.deflection_sd)
    rest = local.rest(values, data.poses, at.deflection_sd)
    elastic = [j for j, (gear, _) in enumerate(gears(model)) if gear.spring is not None]
    turned = np.linalg.inv(model.eta) @ local.motor_rows
    deflection = (turned - np.eye(model.dof)[list(model.i_g)])[elastic]
    rows = np.vstack([deflection, local.motor_rows])
    s = 1j * data.w[:, None, None]
    Z = s**2 * M[:, None] + s * D[:, None] + K[:, None]
    inward = at.vector.drive_at(x, at.drive).transfer(data.w, n)[:, None, :]
    inverse = np.linalg.inv(Z)
    L = s**2 * (local.motor_rows @ inverse @ rows.T)
    S = rows @ inverse @ rows.T
    P = rows @ (inverse @ B[:, None]) * inward
    inertia = np.array([m.inertia for m in model.motors])
    linear = Linearization(data.w, at.response(x).G[:, :, :n], L, S, P, stiffness, inertia)
    G = data.G[:, :, :n]
    # torque of the gears
    gear = (model.eta.T @ (inward * np.eye(n) - inertia[:, None] * G))[:, :, elastic]
    power = np.einsum("klai,klij,klaj->ka", gear, data.UU / data.experiments, gear.conj()).real / 2
    return Level(
        linear,
        G,
        _variance(at)[:, :, :n],
        rest.y @ deflection.T,
        np.sqrt(power) / stiffness,
        data.speed_sd,
    )


def _variance(residuals: Residuals) -> np.ndarray:
    """Variance of the elements by noise, from its structure, so that few periods are enough."""
    data = residuals.data
    C = structured_covariance(data.G, output_powers(data, data.w), *noise_levels(data, data.G))
    S = np.linalg.inv(data.UU).swapaxes(-1, -2) / data.periods
    both = (np.einsum("klaa->kla", X).real for X in (C, S))
    outputs, inputs = both
    return np.asarray(outputs[..., None] * inputs[..., None, :])


def cause_in_words(
    cause: Nonlinearity, found: Comparison, robot: RobotModel, coordinates: Sequence[int]
) -> NonlinearCause:
    """The words for a cause, with its numbers in physical units."""
    names = [robot.coordinates[i].name for i in coordinates]
    motors = [motor.name for motor in robot.motors]
    parts = []
    for j, z in cause.numbers.items():
        if cause.law == "Coulomb":
            parts.append(f"{motors[j]} ({z[0] * found.friction[j]:.2g} N m)")
            continue
        dof = robot.coordinates[coordinates[j]].dof
        scale, unit = (
            (1e3, "mm") if dof is not None and dof.type == "translation" else (1e3, "mrad")
        )
        size = scale * found.deflection[j]
        parts.append(f"{names[j]} ({_size(cause.law, z, size, unit)})")
    return NonlinearCause(f"{WORDS[cause.law]} of {', '.join(parts)}", cause.share)


def _size(law: str, z: Sequence[float], size: float, unit: str) -> str:
    """The numbers of a gear; ``size``: standard deviation of its deflection."""
    if law == "backlash":
        return f"+-{z[0] * size:.2g} {unit}"
    if law == "cubic":
        return f"{100 * z[0]:.2g} % more at {size:.2g} {unit} rms"
    return f"{100 * z[0]:.2g} % of the stiffness slips at {z[1] * size:.2g} {unit}"
