"""Errors of the output of a whole move, by a simulation that shares no code with flexgen.

The robot is the list of steps of `referee.chain_of`; whole_move.c has its equations of motion and
integrates them. Torques, reference angles and reference speeds are splines of scipy through the
samples, held after the last one. Sharp friction needs an implicit method: scipy's Radau with the
same equations.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from math import factorial
from pathlib import Path

import numpy as np
from referee import Fixed, Joint, Mass, Return, Rotor, Tip, chain_of
from scipy.integrate import solve_ivp
from scipy.integrate._ivp import dop853_coefficients as dop853
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.spatial.transform import Rotation

from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    Friction,
    LinearSpring,
    PiecewiseSpring,
    RobotModel,
    SmoothSpring,
    Spring,
)

RTOL = 1e-11
ATOL = 1e-13
RTOL_STIFF = 1e-9
ATOL_STIFF = 1e-11
EVALUATIONS = 1.5e7  # more are stiff
STEP = 2e-3  # s: after the end of the trajectory
POWERS = 6
ROW = 16
SPRINGS = (LinearSpring, CubicSpring, SmoothSpring, PiecewiseSpring, BacklashSpring)
# position [1/s], speed [N m s/rad], integral [1/s], (n_m,)
Gains = tuple[np.ndarray, np.ndarray, np.ndarray]
Pair = tuple[float | None, float | None]


class _Robot(ctypes.Structure):
    """`robot` of whole_move.c."""

    _fields_ = [
        (name, ctypes.c_int)
        for name in ("n_steps", "n_a", "n_m", "dof", "n_laws", "feedback", "free")
    ] + [
        (name, ctypes.c_void_p)
        for name in ("steps", "laws", "spread", "rotors", "gravity", "gains")
    ]


@cache
def _library() -> ctypes.CDLL:
    source = Path(__file__).with_suffix(".c")
    out = Path(tempfile.mkdtemp()) / "whole_move.so"
    subprocess.run(
        ["cc", "-O3", "-march=native", "-fPIC", "-shared", "-o", str(out), str(source), "-lm"],
        check=True,
    )
    return ctypes.CDLL(str(out))


def _spring(spring: Spring | None, damping: float) -> list[float]:
    """Kind, three numbers and damping."""
    numbers = [] if spring is None else [float(x) for x in vars(spring).values()]
    kind = 0 if spring is None else 1 + SPRINGS.index(type(spring))
    return [float(kind), *(numbers + 3 * [0.0])[:3], damping]


def _friction(f: Friction) -> list[float]:
    return [f.viscous, f.coulomb, f.stribeck, f.alpha, f.beta, f.offset]


def _step(step: Fixed | Joint | Mass | Rotor) -> list[float]:
    """A row of numbers for whole_move.c."""
    match step:
        case Fixed(position, rotation):
            row = [0, 0, *position, *rotation.ravel()]
        case Joint(kind, axis, weights):
            ((index, weight),) = weights.items()
            assert weight == 1.0
            row = [1 if kind == "rotation" else 2, index, *axis]
        case Mass(mass, com, inertia, drag):
            row = [3, 0, mass, *com, *inertia.ravel(), drag]
        case Rotor(j, inertia, axis):
            row = [4, j, inertia, *axis]
    return row + [0.0] * (ROW - len(row))


def _laws(model: RobotModel) -> list[list[float]]:
    """Rows of springs, dampers and frictions: the strain over (q_a, q_m), the numbers."""
    n_a = model.n_a
    rows = np.eye(model.n_a + model.n_m)
    inverse = np.linalg.inv(model.eta)
    out = []
    for i, coordinate in enumerate(model.coordinates):
        dof = coordinate.dof
        spring, damping = (None, 0.0) if dof.actuated else (dof.spring, dof.damping)
        out.append([*rows[i], *_spring(spring, damping), *_friction(dof.friction)])
        if dof.actuated and not dof.gear.rigid:
            twist = -rows[i] + inverse[model.i_g.index(i)] @ rows[n_a:]
            if dof.gear.side == "motor":
                twist *= next(m.ratio[0] for m in model.motors if m.drives == (dof.name,))
            out.append([*twist, *_spring(dof.gear.spring, dof.gear.damping), *6 * [0.0]])
    out += [
        [*rows[n_a + j], *_spring(None, 0.0), *_friction(m.friction)]
        for j, m in enumerate(model.motors)
    ]
    return out


class WholeMove:
    """A robot, alone or with feedback of its motors, simulated along trajectories."""

    def __init__(self, model: RobotModel, gains: Gains | None = None) -> None:
        self.model = model
        self.gains = gains
        n_a = model.n_a
        n_m = model.n_m
        assert not model.branched, "this referee knows chains only"
        assert not any(d.counterbalance or d.mimic for e in model.elements for d in e.dofs), (
            "... without counterbalances and mimics"
        )
        steps = [_step(step) for step in chain_of(model) if not isinstance(step, (Tip, Return))]
        laws = _laws(model)
        spread = np.zeros((n_a + n_m, model.dof))
        spread[:n_a, :n_a] = np.eye(n_a)
        for j in range(n_m):
            spread[n_a + j, list(model.i_g)] = model.eta[j]
            if j in model.i_m:
                spread[n_a + j] = np.eye(model.dof)[n_a + model.i_m.index(j)]
        alone = model.motor_coupling != "complete"
        arrays = [
            steps,
            laws,
            spread,
            [m.inertia * alone for m in model.motors],
            model.gravity,
            gains or [0.0],
        ]
        self._kept = [np.ascontiguousarray(x, float) for x in arrays]
        sizes = (
            len(steps),
            n_a,
            n_m,
            model.dof,
            len(laws),
            int(gains is not None),
            int(np.array_equal(spread, np.eye(n_a + n_m))),
        )
        self._robot = _Robot(*sizes, *(x.ctypes.data for x in self._kept))
        self.n_x = 2 * model.dof + (0 if gains is None else n_m)

    def rate(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rates of the state; ``u``: torques, with feedback also reference angles and speeds."""
        out = np.empty(self.n_x)
        tool = np.empty(12)
        given = [np.ascontiguousarray(a, float) for a in (x, u)]
        _library().rate(
            ctypes.byref(self._robot),
            *(ctypes.c_void_p(a.ctypes.data) for a in (*given, out, tool)),
        )
        return out

    def states(self, t: Trajectory, after: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Instants, states and places of the tool (n, 12) until ``after`` [s] beyond the end."""
        model = self.model
        time = t.time
        count = round(after / STEP)
        times = np.concatenate([time, time[-1] + after * np.arange(1, count + 1) / count])
        torque = _curve(t, "tau_m")
        rest = np.zeros((count, POWERS, model.n_m))
        pieces = [_pieces(torque, time)]
        held = [t["tau_m"][-1]]
        if self.gains is not None:
            angle = make_interp_spline(time, t["q_m"], k=5)
            pieces += [_pieces(angle, time), _pieces(angle.derivative(), time)]
            held += [t["q_m"][-1], np.zeros(model.n_m)]
        after_end = [rest.copy() for _ in held]
        for piece, value in zip(after_end, held, strict=True):
            piece[:, 0] = value
        inputs = np.concatenate(
            [np.concatenate(pieces, axis=2), np.concatenate(after_end, axis=2)]
        )
        start = np.concatenate(
            [t["q_a"][0], t["q_m"][0][list(model.i_m)], np.zeros(self.n_x - model.dof)]
        )
        return times, *self.integrate(times, inputs, start)

    def integrate(
        self, t: np.ndarray, inputs: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """States (n, n_x) and tools (n, 12) at instants t [s] under the inputs of each interval,
        by `integrate_stiff` from where explicit steps fail.
        """
        states = np.zeros((len(t), self.n_x))
        tools = np.zeros((len(t), 12))
        states[0] = start
        n = dop853.N_STAGES
        parts = (dop853.C[:n], dop853.A[:n, :n], dop853.B, dop853.E3, dop853.E5)
        tableau = np.concatenate([x.ravel() for x in parts])
        inputs = np.ascontiguousarray(inputs)
        double = ctypes.c_double
        address = ctypes.c_void_p
        reached = _library().integrate(
            ctypes.byref(self._robot),
            len(t),
            address(t.ctypes.data),
            self.n_x,
            address(inputs.ctypes.data),
            inputs.shape[2],
            address(tableau.ctypes.data),
            double(RTOL),
            double(ATOL),
            double(EVALUATIONS),
            address(states.ctypes.data),
            address(tools.ctypes.data),
        )
        if reached < len(t):
            self.integrate_stiff(t, inputs, states, reached - 1)
            for k in range(reached - 1, len(t)):
                self.place(states[k], inputs[min(k, len(inputs) - 1), 0], tools[k])
        return states, tools

    def place(self, x: np.ndarray, u: np.ndarray, out: np.ndarray) -> None:
        """Position and rotation of the tool."""
        given = [np.ascontiguousarray(a, float) for a in (x, u)]
        addresses = [ctypes.c_void_p(a.ctypes.data) for a in (*given, np.empty(self.n_x), out)]
        _library().rate(ctypes.byref(self._robot), *addresses)

    def integrate_stiff(
        self, t: np.ndarray, inputs: np.ndarray, states: np.ndarray, first: int
    ) -> None:
        """Replace the states behind number ``first`` by those of an implicit method."""
        powers = np.arange(POWERS)[:, None]

        def rate(instant: float, x: np.ndarray) -> np.ndarray:
            k = min(int(np.searchsorted(t, instant, side="right")) - 1, len(inputs) - 1)
            return self.rate(x, (inputs[k] * (instant - t[k]) ** powers).sum(axis=0))

        span = (t[first], t[-1])
        tolerances = {"rtol": RTOL_STIFF, "atol": ATOL_STIFF}
        found = solve_ivp(rate, span, states[first], "LSODA", t[first:], **tolerances)
        assert found.success, found.message
        states[first:] = found.y.T

    def errors(self, t: Trajectory, after: Sequence[float] = (0.5,)) -> list[Pair]:
        """Largest errors of the output [m], [rad] until each of these times [s] beyond the end."""
        times, states, tools = self.states(t, max(after))
        error_m, error_rad = _output_errors(self.model, t, states[:, : self.model.n_a], tools)
        out = []
        for seconds in after:
            until = times <= t.time[-1] + seconds + 1e-9
            parts = (None if x is None else _largest(x[until]) for x in (error_m, error_rad))
            out.append((next(parts), next(parts)))
        return out


def _largest(x: np.ndarray) -> float:
    return float(x.max()) if np.isfinite(x).all() else np.inf


def _curve(t: Trajectory, name: str) -> Callable[..., np.ndarray]:
    """A quintic spline; a monotone cubic where limits are active."""
    if t.meta.get("torque") == "limited":
        return PchipInterpolator(t.time, t[name])
    return make_interp_spline(t.time, t[name], k=5)


def _pieces(curve: Callable[..., np.ndarray], t: np.ndarray) -> np.ndarray:
    """Polynomials of the time since each sample, (n - 1, POWERS, width)."""
    middle = (t[:-1] + t[1:]) / 2  # inside of a piece every derivative is one
    half = (t[1:] - t[:-1])[:, None] / 2
    taylor = [curve(middle, k) / factorial(k) for k in range(POWERS)]
    return np.stack(
        [
            sum(_choose(k, j) * taylor[k] * (-half) ** (k - j) for k in range(j, POWERS))
            for j in range(POWERS)
        ],
        1,
    )


def _choose(k: int, j: int) -> int:
    return factorial(k) // factorial(j) // factorial(k - j)


def _output_errors(
    model: RobotModel, t: Trajectory, q_a: np.ndarray, tools: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Distances [m] and angles [rad] between the output and its reference, which rests after its
    end.
    """
    last = np.minimum(np.arange(len(q_a)), len(t.time) - 1)
    y_ref = t["y_ref"][last]
    output = model.output
    if output.type == "combination":
        error = q_a @ np.array(output.weights).T - y_ref
        units = np.array(output_units(model))
        found = [
            np.linalg.norm(error[:, units == u], axis=1) if (units == u).any() else None
            for u in ("m", "rad")
        ]
        return found[0], found[1]
    axes = [
        "xyz".index(axis) for axis in (output.axes if output.type == "tool_position" else "xyz")
    ]
    distance = np.linalg.norm(tools[:, axes] - y_ref, axis=1)
    if "R_ref" not in t.channels:
        return distance, None
    R = tools[:, 3:].reshape(-1, 3, 3)
    wanted = t["R_ref"][last].reshape(-1, 3, 3)
    if not np.isfinite(R).all():
        return distance, np.full(len(R), np.inf)
    return distance, Rotation.from_matrix(R @ wanted.transpose(0, 2, 1)).magnitude()
