"""What is known about the accuracy of the numbers of a model."""

from dataclasses import dataclass

KINDS = ("stiffness", "damping", "friction", "masses", "motor_inertia")  # whose standard deviations are relative


@dataclass(frozen=True)
class Tolerances:
    """Relative standard deviations of all numbers of a kind, or by name (names as in `flexgen.derive`).

    ``payload`` [kg]; ``common``: kinds with one relative error; ``correlation``: of the named ones, row by row.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    masses: float = 0.0
    motor_inertia: float = 0.0
    payload: float = 0.0
    common: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    sd: tuple[float, ...] = ()
    correlation: tuple[float, ...] = ()
