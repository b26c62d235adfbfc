"""Observer with constant gains, tabulated by the pose of a planned motion, in C.

    x- = F x + G (d + du),    e = dy - C x- - D (d + du),    x = x- + M_x e,    d <- d + M_d e

x: state minus reference, du and dy: torques and measurements minus those of the reference, d:
torques on motors that are not commanded. F, G: linearization in the middle of each part of the
motion, by the exponential; M: the stationary Kalman gain there.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from flexgen.analysis.second_order import motor_rows
from flexgen.base.calls.deadline import check_time
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.riccati import riccati
from flexgen.base.spec.arguments import is_whole
from flexgen.codegen.build.c_module import c_module
from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.channels import MOTORS, Noise, channels_of
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels
from flexgen.feedback.observers.design import (
    Noises,
    allocate_aligned,
    check_observable,
    process_noise,
    record,
    state_names,
)
from flexgen.feedback.sampled_plant import hold_effects
from flexgen.inversion.solution import Solution

SOURCE = Path(__file__).with_name("constant_gain.c")
PARTS = 40  # of the motion
# rows side by side in C
PANEL = 24
DENSE = 4
FLAGS = "-O3 -ftree-vectorize"  # no sum changes its order


@checked_class
class ConstantGainObserver:
    """Observer about a planned motion; see the module.

    Parameters
    ----------
    solution : Solution
        The planned motion; the robot rests for 2 s before it, as in `flexgen.control`.
    outputs : str or sequence of str
        As for `ExtendedKalmanFilter`.
    sample_time : float [s]
    noise, torque_noise, disturbance_rate, tool_force
        As for `ExtendedKalmanFilter`.
    parts : int
        Of the motion, each with gains of its own.
    native : bool
        Compile for this processor: faster, and the last digits depend on the processor.

    Attributes
    ----------
    time : array (n,) [s]
        Of the samples of the reference; zero where the path begins.
    outputs, states : tuple of str
        Channels, and ``q_a, q_m, v_a, v_m`` and disturbances by name.
    gains : array (n_parts, n_z, n_y)

    Raises
    ------
    ArgumentError
        An output is not known, a noise is not above zero, or the outputs do not determine the
        state.
    SolverError
        No gain exists at a pose.

    Examples
    --------
    >>> solution = flexgen.solve("elbow")
    >>> observer = flexgen.ConstantGainObserver(solution, parts=4)
    >>> observer.gains.shape  # parts, states, outputs
    (4, 10, 2)
    >>> run = flexgen.control("elbow", solution=solution, sample_time=1e-3).nominal
    >>> observer.run(run.measured, run.tau_m).shape
    (3505, 10)
    """

    def __init__(
        self,
        solution: Solution,
        outputs: str | Sequence[str] = MOTORS,
        *,
        sample_time: float = 1e-3,
        noise: Noise | None = None,
        torque_noise: float = 0.05,
        disturbance_rate: float = 1.0,
        tool_force: float = 50.0,
        parts: int = PARTS,
        native: bool = False,
    ) -> None:
        if not is_whole(parts, 1, 10000):
            raise ArgumentError(f"parts: given {parts!r}, expected 1 to 10000")
        case = control_case(solution.model, solution=solution, sample_time=sample_time)
        self.channels = channels_of(case.model, outputs, noise)
        self.model = self.channels.model
        self.outputs = self.channels.names
        self.sample_time = float(sample_time)
        self.noises = Noises(case.model, torque_noise, disturbance_rate, tool_force)
        self.states = state_names(self.model, True)
        self.time = case.reference.time
        rigid = [j for j in range(self.model.n_m) if j not in self.model.i_m]
        dense = (self.channels.index >= self.model.n_m) | np.isin(self.channels.index, rigid)
        self._order = np.argsort(dense, kind="stable")
        self._dense = int(dense.sum())
        self.samples = -(-len(self.time) // parts)
        poses = PoseModels(self.model)
        found = []
        motion = case.reference.parts(self.samples)
        for k in range(len(motion[0])):
            check_time("gains of the observer")
            at = poses.at([x[k : k + 1] for x in motion])
            if k == 0:
                check_observable(at, self.channels, self.states, self.noises, self.model.n_m)
            found.append(
                stationary(at, self.channels.index, self.channels.noise, self.noises, sample_time)
            )
        self.matrices = tuple(np.array(x) for x in zip(*found, strict=True))
        self.gains = self.matrices[-1]
        self._make(case.reference.motion, case.reference.held, native)

    def __repr__(self) -> str:
        sizes = f"{len(self.outputs)} outputs, {len(self.states)} states"
        return (
            f"<ConstantGainObserver {self.model.title}: {sizes}, samples of "
            f"{1e3 * self.sample_time:.4g} ms>"
        )

    def _make(self, motion: dict[str, np.ndarray], torque: np.ndarray, native: bool) -> None:
        """Lay out the matrices and the reference for C. ``motion``: samples of the reference;
        ``torque`` (n, n_m) [N m]: held ones; ``native``: compiled for this processor.

        Outputs that are single coordinates come first, their rows need no multiplication; rows and
        columns are padded to the width of the vector instructions.
        """
        model = self.model
        order = self._order
        index = self.channels.index[self._order]
        n_x = 2 * model.dof
        n_m = model.n_m
        n_y = len(index)
        n_dense = self._dense
        elastic = list(model.i_m)
        x_ref = np.hstack(
            [motion["q_a"], motion["q_m"][:, elastic], motion["v_a"], motion["v_m"][:, elastic]]
        )
        y_ref = x_ref[:, : model.dof] @ motor_rows(model).T
        if model.sensors:
            sensors = library_with(model, ["sensors"]).sensors
            y_ref = np.hstack(
                [y_ref, np.asarray(sensors(motion["q_a"], motion["v_a"], motion["a_a"]))]
            )
        u_ref = np.concatenate([torque[:1], torque[:-1]])
        state = [model.n_a + elastic.index(i) for i in index[: n_y - n_dense]]
        blocks = []
        wide = -(-n_dense // DENSE) * DENSE
        for F, G, C, D, M in zip(*self.matrices, strict=True):
            rows = np.zeros((-(-n_x // PANEL) * PANEL, n_x + n_m))
            rows[:n_x] = np.hstack([F, G])
            panels = rows.reshape(-1, PANEL, n_x + n_m).transpose(0, 2, 1)
            measured = np.zeros((wide, n_x + n_m))
            measured[:n_dense] = np.hstack([C, D])[order][n_y - n_dense :]
            sides = measured.reshape(-1, DENSE, n_x + n_m).transpose(0, 2, 1)
            blocks.append(np.concatenate([panels.ravel(), sides.ravel(), M[:, order].T.ravel()]))
        part = -(-len(blocks[0]) // 8) * 8  # each part begins at a cache line
        table = allocate_aligned(len(blocks) * part).reshape(len(blocks), part)
        table[:, : len(blocks[0])] = blocks
        self._tables = {
            "state": np.array(state or [0], np.int32),
            "matrices": table,
            "y_ref": np.ascontiguousarray(y_ref[:, index]),
            "u_ref": np.ascontiguousarray(u_ref),
            "x_ref": np.ascontiguousarray(x_ref),
        }
        self._module = c_module(SOURCE, "" if native else FLAGS, native=native)
        self._module.flexgen_constant_gain_size.restype = ctypes.c_int64
        self._module.flexgen_constant_gain_run.restype = ctypes.c_int64
        head = _ConstantGain(
            n_x=n_x,
            n_m=n_m,
            n_y=n_y,
            n_dense=n_dense,
            parts=len(blocks),
            samples=self.samples,
            part=part,
            references=len(x_ref),
            **{name: x.ctypes.data for name, x in self._tables.items()},
        )
        own = ctypes.sizeof(head) // 8
        self._memory = allocate_aligned(
            own + int(self._module.flexgen_constant_gain_size(ctypes.byref(head)))
        )
        ctypes.memmove(self._memory.ctypes.data, ctypes.byref(head), ctypes.sizeof(head))
        self._head = _ConstantGain.from_buffer(self._memory.data)
        self._begin = own
        self.reset()

    @checked_types(own=("sample",))
    def reset(self, sample: int = 0) -> None:
        """Begin on the reference, at a sample; ArgumentError where it is not a whole number from 0
        on.
        """
        if (
            isinstance(sample, bool)
            or not isinstance(sample, int | np.integer)
            or not 0 <= sample < 2**62
        ):
            raise ArgumentError(f"sample: given {sample!r}, expected a whole number from 0 on")
        self._memory[self._begin :] = 0.0
        self._head.failed = 0
        self.sample = sample

    def __deepcopy__(self, memo: dict[int, Any]) -> ConstantGainObserver:
        """An observer of its own in the same state, such as `flexgen.control` makes of a
        controller for each robot.
        """
        other = copy.copy(self)
        other._memory = allocate_aligned(self._memory.size)
        other._memory[:] = self._memory
        other._head = _ConstantGain.from_buffer(other._memory.data)
        return other

    @checked_types(own=("y", "u"))
    def step(self, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The state (n_z,) after one more sample: ``y`` (n_y,) measured now, ``u`` (n_m,) acted
        since the last one.
        """
        return np.asarray(
            self.run(np.asarray(y, dtype=float)[None], np.asarray(u, dtype=float)[None])[0]
        )

    @checked_types(own=("y", "u"))
    def run(self, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The states (n, n_z) of a record ``y`` (n, n_y), ``u`` (n, n_m); see
        `ExtendedKalmanFilter.run`.

        SolverError where a number is not finite.
        """
        count = len(y)
        y = np.ascontiguousarray(record("y", y, count, len(self.outputs))[:, self._order])
        u = record("u", u, count, self.model.n_m)
        z = np.empty((count, len(self.states)))
        done = self._module.flexgen_constant_gain_run(
            ctypes.c_void_p(self._memory.ctypes.data),
            ctypes.c_int64(self.sample),
            ctypes.c_int64(count),
            *(ctypes.c_void_p(x.ctypes.data) for x in (y, u, z)),
        )
        self.sample += int(done)
        if done < count:
            raise SolverError(
                f"constant-gain observer, sample {done} of {count}: a number is not finite; "
                "check measurements and torques"
            )
        return z


def stationary(
    at: PoseModel, index: np.ndarray, noise: np.ndarray, noises: Noises, sample_s: float
) -> tuple[np.ndarray, ...]:
    """``F, G, C, D`` of a pose and the stationary gain ``M`` (n_x + n_m, n_y) of the filter with
    disturbances.

    The gain corrects the prediction at the sample itself: ``M = P C' (C P C' + R)^-1``, P the
    covariance before it. ``index`` (n_y,): the channels used; ``noise`` (n_y,): their standard
    deviations.
    """
    n_x, n_m = at.B.shape
    F = expm(at.A * sample_s)
    G = hold_effects(at.A, at.B, sample_s, 0.0)[1]
    C = at.C[index]
    D = at.D[index]
    whole = np.eye(n_x + n_m)
    rows = np.hstack([C, D])
    whole[:n_x, :n_x] = F
    whole[:n_x, n_x:] = G
    Q = process_noise(at, G, noises, sample_s)
    P = riccati(whole.T, rows.T, Q, np.diag(noise**2))
    M = np.linalg.solve(rows @ P @ rows.T + np.diag(noise**2), rows @ P).T
    return F, G, C, D, M


class _ConstantGain(ctypes.Structure):
    """``constant_gain`` of constant_gain.c."""

    _fields_ = [
        *[(name, ctypes.c_int32) for name in "n_x n_m n_y n_dense parts failed".split()],
        *[(name, ctypes.c_int64) for name in "samples references part".split()],
        *[(name, ctypes.c_void_p) for name in "state matrices y_ref u_ref x_ref".split()],
    ]
