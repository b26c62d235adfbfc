"""Motors behind gears with hysteresis, and with a friction that has a state, after the motion of
the arm.

At a reversal p'' jumps, or changes within the time constant D/K of the gear, and the motor torque
with it. Rates are differences of the deflections at the samples, whose sum is the change of speed:
samples of p'' itself would miss the impulse of the torque, and the robot would leave its path by
four orders of magnitude more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from flexgen.dynamics.hysteresis.hysteretic_gears import hysteretic_deflections
from flexgen.dynamics.hysteresis.lugre import bristle_torques, motor_bristles, torques_to_send
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import motors_behind
from flexgen.inversion.problem.sampling import differentiate
from flexgen.model.friction import memory_laws


def with_memory(equations: Equations, result: MethodResult) -> MethodResult:
    """The result of a method with hysteresis of gears and friction of motors that has a state,
    where there are any.
    """
    for law in memory_laws(equations.model):
        result = AFTER_THE_ARM[law.key](equations, result)
    return result


def with_lugre(equations: Equations, result: MethodResult) -> MethodResult:
    """The result with the torques of bristles, which begin at rest with z = 0; as it is where it
    has them.
    """
    if result.tau_b is not None:
        return result
    motors = result.motors
    torques = bristle_torques(motor_bristles(equations.model), result.t, motors.v_m, motors.a_m)
    tau_m = motors.tau_m + torques_to_send(equations, motors.q_m, torques)
    return replace(result, motors=replace(motors, tau_m=tau_m), tau_b=torques)


def with_hysteresis(equations: Equations, result: MethodResult) -> MethodResult:
    """The result of a method with the motors behind gears with hysteresis, which begin at rest
    with z = 0.
    """
    i_g = list(equations.model.i_g)
    step = result.t[1] - result.t[0]
    # the equilibrium by which `settling` replaces the last sample: its torque is held
    settled = equations.model.n_e > 0 and not (result.v[-1].any() or result.a[-1].any())
    p, z = hysteretic_deflections(
        equations, result.t, differentiate(result.tau_g, step, settled=settled)
    )
    jets = differentiate(p, step, settled=settled)
    motion = [x[:, i_g] + jets[:, :, k] for k, x in enumerate((result.q, result.v, result.a))]
    return replace(
        result, motors=motors_behind(equations, motion, result.tau_g), tau_h=z, tau_b=None
    )


# What a law with a state adds to the motion of the arm, by its key.
AFTER_THE_ARM: dict[str, Callable[[Equations, MethodResult], MethodResult]] = {
    "hysteresis": with_hysteresis,
    "lugre": with_lugre,
}
