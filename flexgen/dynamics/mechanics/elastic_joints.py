"""Which models are arms with elastic joints: every arm coordinate is driven through a spring,
nothing else is elastic.

Feedback linearization and the other laws for elastic joints need such a model: the torque of the
springs alone accelerates the arm, and the motor torque appears in the fourth derivative of the arm
coordinates.
"""

from __future__ import annotations

from flexgen.model.elements import BacklashSpring, CubicSpring, LinearSpring, RobotModel, Spring
from flexgen.model.friction import has_harmonics


def flexible_joint_obstacle(model: RobotModel) -> str | None:
    """The reason why a model is not an arm with elastic joints, or None.

    Returns
    -------
    str or None
        A sentence without full stop for an error message: what the model has and what is expected.
    """
    expected = "expected a motor and a spring for each arm coordinate"
    if model.n_e:
        names = ", ".join(model.coordinates[i].name for i in model.i_e)
        return f"model {model.name}: given coordinates without motor ({names}), {expected}"
    if model.motor_coupling != "simplified":
        return (
            f"model {model.name}: given motor_coupling {model.motor_coupling!r}, expected "
            "'simplified'"
        )
    if found := has_harmonics(model):
        return f"model {model.name}: given a {found}, expected none"
    for i in model.i_g:
        dof = model.coordinates[i].dof
        assert dof is not None and dof.gear is not None  # what makes a coordinate actuated
        if dof.gear.spring is None:
            return f"model {model.name}: given a rigid gear in {dof.name}, {expected}"
        if not _stiff(dof.gear.spring):
            return (
                f"model {model.name}: given a spring in {dof.name} without stiffness somewhere, "
                f"{expected}"
            )
    return None


def _stiff(spring: Spring) -> bool:
    """Whether a spring is stiff at every deflection: the laws divide by its stiffness."""
    if isinstance(spring, BacklashSpring):
        return False
    if isinstance(spring, LinearSpring):
        return spring.stiffness > 0
    if isinstance(spring, CubicSpring):
        return spring.stiffness > 0 and spring.cubic >= 0
    return spring.low > 0 and spring.high > 0
