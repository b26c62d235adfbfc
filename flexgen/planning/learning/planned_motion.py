"""A motion that was sent to the robot, at rest before and after it, and what the model says about
the tool: where measured motors take it, and the errors that a robot makes that differs from its
model.

Errors of unit size, with the motors locked, from the model that is linear along the motion
(`motor_reaction.py`):

    springs     `SOFTER` of the torque of one spring more
    dampers     the rate of that torque times `DAMPED_S`: a damper that is as much stronger
    soft center `SOFT_CENTER` of T tanh(torque / T), T a quarter of the largest torque
    friction    of a joint behind its gear: the stiffness of the gear times `VISCOUS_S` and
                `COULOMB`; `STATED` of these where the model has a friction of the joint
    motors      that friction holds back at slow motion, where motor angles are not measured

Viscous friction of all joints, over their stiffnesses, is a delay of the tool: no record of its
positions tells it from a clock. Its size is the accuracy of a clock that is estimated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.loop.sampled_model import output_jacobian
from flexgen.model.friction import NO_FRICTION
from flexgen.planning.learning.corrected import CorrectedPath
from flexgen.planning.learning.measured_run import SharedAxes
from flexgen.planning.learning.motor_reaction import LinearisedArm
from flexgen.planning.learning.next_trajectory import MOTION

SOFTER = 0.2  # change of a spring
SOFT_CENTER = 0.4  # the same without load
DAMPED_S = 1e-3  # damper over spring
CENTER = 0.25  # of the largest torque
VISCOUS_S = 3e-5  # friction of a joint over the stiffness of its gear
COULOMB = 5e-5  # rad, the same
STATED = 0.3  # of these, where the model has a friction
RUBBING = 0.02  # rad/s: speed at which it is developed to 76 %
# Angle of a joint by which friction holds its motor back [rad], and the part of the largest speed
# below which it does so less.
HELD = 2e-4
SLOW = 0.02
STEP_S = 2e-3  # of the motion


class PlannedMotion:
    """A motion at equal steps, with rest before and after it, as long as a record may be.

    Parameters
    ----------
    corrected : CorrectedPath
    last : Trajectory
        That was sent.
    length : float [s]
        Of the record.
    rows : SharedAxes
        Axes of the tracker.
    """

    def __init__(
        self, corrected: CorrectedPath, last: Trajectory, length: float, rows: SharedAxes
    ) -> None:
        self.equations = corrected.equations
        self.rows = rows
        own = float(last.time[1] - last.time[0])
        every = max(1, round(STEP_S / own))
        step = every * own
        inner = last.time[::every]
        more = int(np.ceil(length / step))
        self.time = inner[0] + step * np.arange(-more, len(inner) + more)
        self.motion = []
        for name in MOTION:
            x = np.pad(last[name][::every], ((more, more), (0, 0)), mode="edge")
            if name[0] in "va":
                x[:more] = 0.0
                x[len(x) - more :] = 0.0
            self.motion.append(x)
        self.arm = LinearisedArm(self.equations, self.motion, step)
        W = evaluate(output_jacobian(self.equations), self.motion[0])[0]
        self._slopes = W.reshape(len(self.time), -1, self.equations.model.n_a)

    def tool_path(self, time: np.ndarray, lag: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Positions (k, d) [m] of the tracked point at instants (k,) [s] that the model expects
        with motors that deviate by ``lag`` (n, n_m) [rad] at the instants ``time`` (n,) [s].
        """
        curve = make_interp_spline(time, lag, k=5)
        inside = np.clip(self.time, time[0], time[-1])
        moved = self.arm.with_motors(*(np.asarray(curve(inside, order)) for order in range(3)))
        output = self.equations.model.output
        tool = list(range(3)) if output.type == "tool_pose" else list(output.tool_rows)
        p = evaluate(self.equations.function("forward_kinematics"), self.motion[0])[0]
        found = self._of_tool(moved)
        found[:, self.rows.tracker] += p.reshape(-1, 3)[:, tool]
        spline = make_interp_spline(self.time, found, k=3)
        return lambda t: np.asarray(spline(np.clip(t, self.time[0], self.time[-1])))

    def list_errors(self, motors_are_known: bool) -> tuple[np.ndarray, np.ndarray, int]:
        """Instants (k,) [s], errors of the tracked point (m, k, d) [m] that the model expects, of
        one standard deviation each, and the number of the first ones, of softer springs.
        """
        model = self.equations.model
        library = library_with(model, ["inverse_dynamics"])
        given = (np.ascontiguousarray(x) for x in self.motion[:3])
        torque = np.asarray(library.inverse_dynamics(*given))
        step = float(self.time[1] - self.time[0])
        rate = np.gradient(torque, step, axis=0)
        size = CENTER * np.abs(torque).max(axis=0) + 1e-12
        springs = [i for i in self.arm.free if i < model.n_a]
        acting = [
            factor * x * (np.arange(model.n_a) == i)
            for factor, x in (
                (SOFTER, torque),
                (DAMPED_S, rate),
                (SOFT_CENTER, size * np.tanh(torque / size)),
            )
            for i in springs
        ]
        speed = self.motion[1]
        stiffness = self.arm.stiffness()
        for i in (i for i in model.i_g if i in springs):
            dof = model.coordinates[i].dof
            known = STATED if dof is not None and dof.friction != NO_FRICTION else 1.0
            own = known * stiffness[:, i, None] * (np.arange(model.n_a) == i)
            acting.append(-VISCOUS_S * own * speed)
            acting.append(-COULOMB * own * np.tanh(speed / RUBBING))
        found = [self._of_tool(self.arm.under_torques(x)) for x in acting]
        if not motors_are_known:
            found += [self._of_tool(x) for x in self._held_motors()]
        return self.time, np.array(found), len(springs)

    def _held_motors(self) -> list[np.ndarray]:
        """Deviations (k, n_a) [rad or m] of the arm behind each motor that friction holds back."""
        model = self.equations.model
        twist = np.linalg.inv(model.eta)
        found = []
        for j in range(model.n_m):
            held = np.zeros((len(self.time), model.n_a))
            speed = self.motion[4][:, j]
            part = np.tanh(speed / max(float(np.abs(speed).max()), 1e-12) / SLOW)
            held[:, list(model.i_g)] = HELD * part[:, None] * np.sign(twist[:, j])
            found.append(held)
        return found

    def _of_tool(self, moved: np.ndarray) -> np.ndarray:
        """Deviations (k, d) [m] of the tracked point with those of the arm (k, n_a)."""
        found = np.zeros((len(self.time), len(self.rows.axes)))
        found[:, self.rows.tracker] = np.einsum("nij,nj->ni", self._slopes, moved)[
            :, self.rows.output
        ]
        return found
