"""Residual vibration of the tool after a move: robots of other stiffness under a P-PI cascade.

The output of a robot whose joints are its output, behind rigid gears, does not vibrate: its
vibration is that of the coordinates without motor, such as the hinge of a payload.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import columns_in, unit_of
from flexgen.dynamics.mechanics.parameters import has_group
from flexgen.feedback.loop.case import TOOL_FORCE
from flexgen.feedback.loop.closed_loop import TOOL, ClosedLoop
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI, lowest_locked_hz
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.hysteresis import hysteretic_robots, largest_rate, split_plants
from flexgen.feedback.loop.plants import LocalDynamics, plants_of
from flexgen.feedback.loop.reference import hold_torques, time_grid
from flexgen.model.elements import RobotModel
from flexgen.paths.force.process_force import ProcessForce
from flexgen.simulation.integration.hysteretic_rate import generalized_force

# of the drives, at most; in a period of the lowest frequency with locked motors
SAMPLE_S = 1e-3
SAMPLES = 50.0
BEFORE_S = 0.05  # at rest before the motion
WINDOW_S = 0.4  # after the path,
PERIODS = (1.0, 8.0)  # but as many of these periods, at least and at most
INSTANTS = 200  # of that time
POINT = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
PLANTS = {"soft": {"stiffness": 0.9}, "stiff": {"stiffness": 1.1}}


def has_springs(model: RobotModel) -> bool:
    """Whether a robot has springs whose stiffness may differ; a robot without springs does not
    vibrate.
    """
    return has_group(model, "stiffness")


def vibrating_coordinates(model: RobotModel) -> tuple[int, ...]:
    """Indices of the coordinates without motor whose vibration counts: those with the unit of the
    last one, where the output, joints behind rigid gears, does not vibrate; else none.
    """
    coordinates = model.coordinates
    gears = [coordinates[i].dof for i in model.i_g]
    is_rigid = all(dof is not None and dof.gear is not None and dof.gear.rigid for dof in gears)
    weights = np.array(model.output.weights)
    is_of_joints = model.output.type == "combination" and not weights[:, list(model.i_e)].any()
    if not (is_rigid and is_of_joints and model.i_e):
        return ()
    unit = coordinates[model.i_e[-1]].unit
    return tuple(i for i in model.i_e if coordinates[i].unit == unit)


def unit_of_vibration(model: RobotModel) -> str:
    """Unit of the vibration: ``"m"``, or ``"rad"`` where what vibrates has no lengths."""
    found = vibrating_coordinates(model)
    return model.coordinates[found[0]].unit if found else unit_of(model)


class ResidualVibration:
    """Simulated error of the tool after a move less its static part.

    Parameters
    ----------
    equations : Equations
    tell : callable
    pushed : bool
        A force acts on the tool.
    """

    def __init__(
        self, equations: Equations, tell: Callable[[str], None], pushed: bool = False
    ) -> None:
        """``tell``: takes lines of progress; ``pushed``: a force acts on the tool. The robots are
        those of `PLANTS`, and a library with their numbers as parameters is compiled.
        """
        self.equations = equations
        self.model = equations.model
        self.plants, laws = split_plants(self.model, plants_of(self.model, PLANTS))
        elastic = without_states(self.model)
        names = tuple(p.name for p in self.plants.parameters)
        functions = ("forward_dynamics", TOOL_FORCE) if pushed else ("forward_dynamics",)
        self._library = library_with(
            elastic, functions, parameters=names, per_point=True, progress=tell
        )
        self._local = LocalDynamics(derive(elastic, names))
        self._laws = laws
        self._robots = None
        if laws:
            moved = self._local.equations.pushed if pushed else self._local.equations
            self._robots = hysteretic_robots(moved, self.plants.values, laws, tell)
        self._coordinates = list(vibrating_coordinates(self.model))
        self._rows = columns_in(self.model, unit_of(self.model))
        if self._coordinates:
            self._rows = list(range(len(self._coordinates)))
        self._law: Cascade | None = None
        self._rate = 0.0
        self._sample = SAMPLE_S
        self._window = WINDOW_S

    def __call__(
        self, trajectory: Trajectory, path_end: float, force: ProcessForce | None = None
    ) -> np.ndarray:
        """Errors (robots, instants, rows) [m, or rad] from the end of the path on, as many for
        every motion.
        """
        if self._law is None:
            self._law = self._choose_law(trajectory)
        first = float(trajectory.time[0])
        last = float(trajectory.time[-1])
        end = path_end + self._window + 10 * self._sample
        time = time_grid(first, end, self._sample, BEFORE_S, 0.0)
        m = trajectory.at(np.clip(time, first, last))
        held = hold_torques(trajectory, time, self._sample, 0.0)
        lanes = len(self.plants.names)
        model = self.model
        rate = self._rate
        if self._laws:
            points = tuple(m[name][:1] for name in POINT)
            pairs = zip(self.plants.values, self._laws, strict=True)
            rate = max(
                rate,
                *(
                    1.2 * largest_rate(self._local, points, m, values, law)
                    for values, law in pairs
                ),
            )
        rests = self._local.under(force, time[0]).rests(m, self.plants.values)
        q_a, tau = (np.array(x) for x in zip(*rests, strict=True))
        loop = ClosedLoop(
            model,
            self._library,
            DriveHardware(self._sample),
            self._law,
            q_a,
            np.tile(m["q_m"][0], (lanes, 1)),
            rate,
            parameters=self._robots or self.plants.values,
        )
        loop.hold(tau)
        rows = np.hstack([m["q_m"], held])
        table = None if force is None else self._pushing(force, time, loop.steps)
        given = np.repeat(rows[:, None], lanes, axis=1)
        found = loop.run(given, len(time), motion=True, disturbances=table, check=False)
        assert found.motion is not None
        out = []
        instants = path_end + self._window / INSTANTS * np.arange(INSTANTS)
        last_rest = self._local.under(force, path_end)
        for lane, values in enumerate(self.plants.values):
            arm = np.ascontiguousarray(found.motion[:, : model.n_a, lane])
            more = self._memory(lane, loop.state[-1][lane], m["q_m"][-1])
            ended, _ = last_rest.rest(m["q_m"][-1], values, m["q_a"][-1], more)
            at_rest = self._output(ended[None])
            moving = self._output(arm)
            error = moving - at_rest
            # smooth in the duration, for slopes
            out.append(CubicSpline(time, error[:, self._rows])(instants))
        return np.array(out)

    def _choose_law(self, trajectory: Trajectory) -> Cascade:
        """The feedback; its sample time and the time after the path suit the lowest frequency at
        the start.
        """
        model = self.model
        q_a, q_m, tau_m = (trajectory[name][:1] for name in ("q_a", "q_m", "tau_m"))
        still_a = np.zeros((1, model.n_a))
        still_m = np.zeros((1, model.n_m))
        motion = (q_a, still_a, still_a, q_m, still_m, still_m, tau_m)
        lowest = lowest_locked_hz(model, motion)
        if lowest > 0:
            self._sample = min(SAMPLE_S, 1 / (SAMPLES * lowest))
            self._window = min(max(WINDOW_S, PERIODS[0] / lowest), PERIODS[1] / lowest)
        self._rate = 1.2 * max(
            self._local.largest_rate(motion, values) for values in self.plants.values
        )
        return PPI().cascade(model, self._sample, motion)

    def _pushing(self, force: ProcessForce, time: np.ndarray, steps: int) -> np.ndarray:
        """The force on the tools in each integration step, as `ClosedLoop.run` takes it."""
        h = self._sample / steps
        n_m = self.model.n_m
        table = np.zeros((len(time) * steps, n_m + TOOL, 1))
        table[:, n_m:, 0] = force.held(time[0] + h * (np.arange(len(table)) + 0.5), h)
        return table

    def _memory(self, lane: int, share: np.ndarray, q_m: np.ndarray) -> np.ndarray | float:
        """Forces on y (n,) of the hysteresis of the gears of robot ``lane`` at the motor angles
        q_m.

        ``share``: state of each element over its largest torque, z/W; 0.0 where no robot has any.
        """
        if not self._laws:
            return 0.0
        layers = self._laws[lane].gears
        n_g = self.model.n_g
        z = np.sum(
            [layer.slip * share[k * n_g : (k + 1) * n_g] for k, layer in enumerate(layers)], axis=0
        )
        return np.array(
            ca.DM(generalized_force(self.model, ca.SX(ca.DM(z)), ca.SX(ca.DM(q_m))))
        ).ravel()

    def _output(self, q_a: np.ndarray) -> np.ndarray:
        """Output, or coordinates that vibrate instead (n, rows), at coordinates (n, n_a)."""
        if self._coordinates:
            return q_a[:, self._coordinates]
        return evaluate(self.equations.function("output"), q_a)[0].reshape(len(q_a), -1)
