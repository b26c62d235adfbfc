"""A recorded motion as a block of a joint fit: torques of the motors, and positions of trackers
where a tracker followed it.

The motors move as recorded, and the elastic arm behind them is simulated: torques and positions
follow, see `flexgen.identification.gears.driven_arm`. Friction of motors acts on torques only and
is linear there. At standstill the friction of a motor is any torque, and its torque has no
information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import binary_erosion

from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.identification.commissioning.blocks import Channel
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.poses_block import frame_slopes, in_frame, turn_rows
from flexgen.identification.commissioning.unknowns import COULOMB_WIDTH
from flexgen.identification.gears.driven_arm import MotorMotion
from flexgen.identification.gears.signals import Signals, signals_of

# Step of the simulation times its fastest eigenvalue: two thirds of what is stable where it is
# chosen, and the one from which on it is chosen anew, since dampings and friction grew.
STABLE = 1.8
SHORTEN = 2.5
LEAST_STEPS = 8  # from sample to sample: torques in the band are exact to 1e-5
MOST_HZ = 10.0  # of the band that is compared
MOVING = 0.01  # of the largest speed of a motor: slower, its friction is any torque
# Of differences: of logarithms, of a prior's deviation, of zeros [rad], of trackers [m].
STEP = 1e-4
LINEAR_STEP = 1e-2
ZERO_STEP = 1e-5
TRACKER_STEP = 1e-3
PIECES = 16  # parts of a record that count as independent
LEAST_PIECE = 0.3  # s
AT_REST = 0.02  # s at an end of a record, and the part of the largest speed below which it rests
REST_SPEED = 0.01
# Change of a number, in deviations of its prior, after which derivatives in bodies are taken anew.
FRESH = 0.3
POSES = 5  # along the record, for the fastest eigenvalue


@dataclass(frozen=True, eq=False)
class Motion:
    """A record: ``trajectory`` with ``q_m`` [rad] and ``tau_m`` [N m], motor side; ``positions``
    (n, 3 k) [m] of the trackers, nan where not seen; None: no tracker.
    """

    name: str
    trajectory: Trajectory
    positions: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class _Simulated:
    """A simulated motion: ``key``: its numbers of the model and zeros; ``places`` of the trackers;
    ``outputs`` (n, n_m + 3 k); ``of_trackers`` (n, 3 k, 3 k): derivatives in the places.
    """

    key: np.ndarray
    places: np.ndarray
    outputs: np.ndarray
    of_trackers: np.ndarray


class MotionBlock:
    """Torques, and positions, of one motion.

    Parameters
    ----------
    arm : ElasticArm
        With trackers where positions were measured.
    motion : Motion
    index : int
        Number of the record among the motions: which delay is its own.
    """

    def __init__(self, arm: ElasticArm, motion: Motion, index: int) -> None:
        self.arm = arm
        self.name = motion.name
        self.kind = "motion" if motion.positions is None else "tracked"
        self.index = index
        self._prepare(motion)
        parts = arm.unknowns.parts
        self.of_lengths = np.zeros((len(self.time), 3 * len(arm.sensors), 0))
        self._slow: np.ndarray | None = None
        self._slow_at = np.zeros(0)
        self._known: _Simulated | None = None
        self._columns_at = np.zeros(0)
        self._steps_of_sample = 0
        self.free = np.ones(parts.size, bool)
        self.relinearize(np.asarray(arm.unknowns.start))
        assert parts.size == len(arm.unknowns.start)

    def _prepare(self, motion: Motion) -> None:
        """The record in its band, with friction columns, masks and parts."""
        record, before = _pad(motion)
        robot = self.arm.robot
        q_m = record.trajectory["q_m"]
        moves = np.ptp(q_m, axis=0) > 0.0
        if not moves.any():
            raise ArgumentError(
                f"{motion.name}: given motors at rest, expected a motion; poses at rest are a "
                'record of the kind "poses"'
            )
        some = _of_motors(record.trajectory, moves)
        signals = signals_of(some, int(moves.sum()), None)
        if signals.band_hz > MOST_HZ:
            signals = signals_of(some, int(moves.sum()), MOST_HZ)
        self.signals: Signals = signals
        self.time = signals.time - signals.time[0]
        self.q_m = signals.reduce(q_m)
        self.tau_m = signals.reduce(record.trajectory["tau_m"])
        self.positions = None
        inside = np.zeros(len(q_m))
        inside[before : len(inside) - before] = 1.0
        recorded = signals.reduce(inside[:, None])[:, 0] > 0.5
        if record.positions is not None:
            seen = np.isfinite(record.positions)
            gaps = signals.reduce((~seen).astype(float))
            self.positions = signals.reduce(_fill(record.positions))
            self.path = make_interp_spline(self.time, self.positions, k=5)
            self.seen = self.inner((np.abs(gaps) < 1e-9) & recorded[:, None])
        speeds = MotorMotion.through(self.time, self.q_m, 1).samples[:, robot.n_m : 2 * robot.n_m]
        self.top = top = np.abs(speeds).max(axis=0)
        widths = self.widths(top)
        columns = [speeds, np.tanh(speeds / widths), np.ones_like(speeds)]
        has = np.array(self.arm.unknowns.has_friction, float)
        columns = [columns[0] * has, columns[1] * has, columns[2]]
        # motor by motor: viscous, Coulomb and constant friction, through the filter of torques
        self.friction = np.stack([signals.torques(column) for column in columns], axis=2)
        late = np.gradient(self.tau_m, signals.sample_s, axis=0)
        self.late = signals.torques(late)
        self.measured = signals.torques(self.tau_m)
        moving = (np.abs(speeds) > MOVING * np.maximum(top, 1e-12)) & recorded[:, None]
        lobe = max(1, round(0.5 / signals.band_hz / signals.sample_s))
        eroded = binary_erosion(moving, np.ones((2 * lobe + 1, 1)))
        self._told = self.inner(eroded)
        inner = self.inner(self.time)
        own = inner[self.inner(recorded)]
        if not len(own):
            raise ArgumentError(
                f"{motion.name}: given {self.time[-1]:.3g} s, expected a longer motion: the "
                "filters of its band take all of it"
            )
        # without the rest that was added at both ends
        length = max(LEAST_PIECE, (own[-1] - own[0]) / PIECES)
        whole = int((own[-1] - own[0]) / length)
        self.piece = np.clip((inner - own[0]) / length, 0, whole).astype(int)

    def widths(self, top: np.ndarray) -> np.ndarray:
        """Speeds (n_m,) [rad/s] over which Coulomb friction changes its sign."""
        betas = [getattr(motor.friction, "beta", 0.0) for motor in self.arm.robot.motors]
        own = np.array([1.0 / beta if beta else np.inf for beta in betas])
        return np.where(np.isfinite(own), own, np.maximum(COULOMB_WIDTH * top, 1e-9))

    def inner(self, x: np.ndarray) -> np.ndarray:
        """Samples where the second filter is filled."""
        return x[self.signals.margin : len(x) - self.signals.margin]

    def set_free(self, free: np.ndarray) -> None:
        """See `Block`."""
        if not np.array_equal(free, self.free):
            self._slow = None
        self.free = free

    def relinearize(self, x: np.ndarray) -> None:
        """See `Block`: steps of the simulation, and columns of bodies and dampings."""
        self._choose_steps(self._per_sample(self.arm.numbers(x)) / STABLE)
        if len(self._slow_at) == 0 or self._has_moved(x):
            self._slow = None

    def _per_sample(self, p: np.ndarray) -> float:
        """Fastest eigenvalue times the time from sample to sample, at numbers p (n_p,)."""
        poses = self.q_m[:: max(1, len(self.q_m) // POSES)]
        return float(self.signals.sample_s * self.arm.fastest(poses, p))

    def _choose_steps(self, least: float) -> None:
        """Steps of the simulation from sample to sample."""
        steps = max(LEAST_STEPS, int(np.ceil(least)))
        if steps == self._steps_of_sample:
            return
        self._steps_of_sample = steps
        self.motion = MotorMotion.through(self.time, self.q_m, steps)
        self.segments = self.arm.segments(self.signals.sample_s, steps)
        self._known = None

    def _has_moved(self, x: np.ndarray) -> bool:
        """Whether numbers changed much since the columns of bodies were computed."""
        unknowns = self.arm.unknowns
        model = unknowns.parts.model
        change = np.abs((x - self._slow_at) / unknowns.sd)[model]
        return bool((change > FRESH).any())

    def simulate(self, p: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Torques, then trackers in the world (R, n, n_m + 3 k), of R arms with numbers (R, n_p)
        and motor angles that differ by (R, n_m) [rad].
        """
        n_m = self.arm.robot.n_m
        first = self.motion.samples[0]
        q_m = first[:n_m] + offset
        start = self.arm.state(q_m, np.tile(first[n_m : 2 * n_m], (len(p), 1)), p)
        away = np.hstack([offset, np.zeros((len(p), 2 * n_m))])
        robots = np.zeros(len(p), int)
        return self.segments(start, self.motion.inputs[None], robots, away, p)

    def channels(self, x: np.ndarray, derivatives: bool) -> list[Channel]:
        """See `Block`."""
        unknowns = self.arm.unknowns
        robot = self.arm.robot
        p = self.arm.numbers(x)
        shift = robot.eta @ unknowns.zeros(x)
        here, of_trackers = self._outputs(x)
        steps: list[tuple[int, np.ndarray, np.ndarray, float]] = []
        changes = np.zeros((0, *here.shape))
        key = np.append(x[unknowns.parts.model], x[unknowns.parts.zeros])
        # the weights of the next round change nothing in the columns
        if derivatives and (self._slow is None or not np.array_equal(key, self._columns_at)):
            if self._slow is not None and self._has_moved(x):
                self._slow = None
            steps = self._steps(x, p, shift, slow=self._slow is None)
            self._columns_at = key
        if steps:
            found = self._simulate_all(
                np.array([numbers for _, numbers, _, _ in steps]),
                np.array([offset for *_, offset, _ in steps]),
            )
            changes = found - here
        J = np.zeros((0, 0, 0))
        if derivatives:
            if self._slow is None:
                self._slow_at = x.copy()
            J = self._jacobian(here, changes, steps, of_trackers)
        out = self._torque_channels(x, here[:, : robot.n_m], J)
        if self.positions is not None:
            out.append(self._position_channel(x, here[:, robot.n_m :], J))
        return out

    def _simulate_all(self, p: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """As `simulate`; ArgumentError where a motion is not finite."""
        found = self.simulate(p, offset)
        if not np.isfinite(found).all():
            raise ArgumentError(f"{self.name}: the simulated motion is not finite")
        return found

    def _outputs(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulated outputs at x (n, n_m + 3 k), and the derivatives of the trackers in their
        places (n, 3 k, 3 k); simulated where numbers of the model or zeros are new.

        Trackers are linear in their places.
        """
        parts = self.arm.unknowns.parts
        n_m = self.arm.robot.n_m
        key = np.append(x[parts.model], x[parts.zeros])
        places = x[parts.trackers] if self.positions is not None else np.zeros(0)
        known = self._known
        if known is None or not np.array_equal(known.key, key):
            numbers = self.arm.numbers(x)
            fastest = self._per_sample(numbers)
            if fastest > SHORTEN * self._steps_of_sample:
                self._choose_steps(fastest / STABLE)
            p = np.tile(numbers, (1 + len(places), 1))
            own = slice(p.shape[1] - len(places), p.shape[1])
            p[1:, own] += TRACKER_STEP * np.eye(len(places))
            shift = self.arm.robot.eta @ self.arm.unknowns.zeros(x)
            found = self._simulate_all(p, np.tile(shift, (len(p), 1)))
            rows = (found[1:, :, n_m:] - found[0, :, n_m:]) / TRACKER_STEP
            known = _Simulated(key, places.copy(), found[0], np.moveaxis(rows, 0, 2))
            self._known = known
        outputs = known.outputs.copy()
        outputs[:, n_m:] += known.of_trackers @ (places - known.places)
        return outputs, known.of_trackers

    def _steps(
        self, x: np.ndarray, p: np.ndarray, shift: np.ndarray, slow: bool
    ) -> list[tuple[int, np.ndarray, np.ndarray, float]]:
        """Column, numbers, shift of the motor angles and size of each difference; ``slow``: of
        all numbers, else of springs and zeros only.
        """
        unknowns = self.arm.unknowns
        parts = unknowns.parts
        out = []
        for k, unknown in enumerate(unknowns.vector.unknowns):
            kind = unknown.name.rpartition(".")[2]
            if not self.free[parts.model.start + k] or (not slow and kind not in SPRINGS):
                continue
            size = STEP if unknown.scale == "log" else LINEAR_STEP * unknown.prior_sd
            there = x.copy()
            there[parts.model.start + k] += size
            out.append((parts.model.start + k, self.arm.numbers(there), shift, size))
        for k in range(self.arm.robot.n_g):
            column = parts.zeros.start + k
            if self.free[column] and unknowns.sd[column] > ZERO_STEP:
                offset = shift + ZERO_STEP * self.arm.robot.eta[:, k]
                out.append((column, p, offset, ZERO_STEP))
        return out

    def _jacobian(
        self,
        here: np.ndarray,
        changes: np.ndarray,
        steps: list[tuple[int, np.ndarray, np.ndarray, float]],
        of_trackers: np.ndarray,
    ) -> np.ndarray:
        """Derivatives (n, outputs, unknowns) of the simulated outputs."""
        parts = self.arm.unknowns.parts
        if self._slow is None:
            self._slow = np.zeros((*here.shape, parts.size))
        J = self._slow
        for change, (column, _, _, step) in zip(changes, steps, strict=True):
            J[:, :, column] = change / step
        if self.positions is not None:
            J[:, self.arm.robot.n_m :, parts.trackers] = of_trackers
        return J

    def _torque_channels(self, x: np.ndarray, tau: np.ndarray, J: np.ndarray) -> list[Channel]:
        """Residual torques of each motor that moves."""
        parts = self.arm.unknowns.parts
        n_m = tau.shape[1]
        friction = x[parts.friction].reshape(n_m, 3)
        delay = parts.delays.start + self.index
        model = self.signals.torques(tau) + np.einsum("njc,jc->nj", self.friction, friction)
        residual = model - self.measured - x[delay] * self.late
        out = []
        for j, motor in enumerate(self.arm.robot.motors):
            told = self._told[:, j]
            if not told.any():
                continue
            rows = np.zeros((0, parts.size))
            if J.size:
                rows = self.signals.torques(J[:, j])
                at = parts.friction.start + 3 * j
                rows[:, at : at + 3] = self.friction[:, j]
                rows[:, delay] = -self.late[:, j]
                rows = np.where(told[:, None], rows, 0.0)
            r = np.where(told, residual[:, j], 0.0)
            size = float(np.std(self.measured[told, j]))
            out.append(Channel(f"torque of {motor.name}", r, rows, self.piece, told, size, "N m"))
        return out

    def measured_positions(self, x: np.ndarray, order: int = 0) -> np.ndarray:
        """Measured positions (n, 3 k) [m] by the clock of the drives, or their derivatives."""
        clock = self.arm.unknowns.parts.clocks.start + 2 * self.index
        time = self.inner(self.time)
        return np.asarray(self.path(time + x[clock] + x[clock + 1] * time, order))

    def _position_channel(self, x: np.ndarray, points: np.ndarray, J: np.ndarray) -> Channel:
        """Residual positions of all trackers."""
        assert self.positions is not None
        parts = self.arm.unknowns.parts
        lengths = self.inner(self.of_lengths)
        world = self.inner(points) + lengths @ x[parts.lengths]
        clock = parts.clocks.start + 2 * self.index
        time = self.inner(self.time)
        measured = self.measured_positions(x)
        frame = x[parts.frame]
        residual = np.where(self.seen, in_frame(frame, world) - measured, 0.0)
        n, k = residual.shape
        rows = np.zeros((0, parts.size))
        if J.size:
            whole = self.inner(J[:, self.arm.robot.n_m :]).copy()
            whole[:, :, parts.lengths] = lengths
            whole = turn_rows(frame, whole)
            whole[:, :, parts.frame] = frame_slopes(frame, world)
            rates = self.measured_positions(x, 1)
            whole[:, :, clock] = -rates
            whole[:, :, clock + 1] = -rates * time[:, None]
            rows = (whole * self.seen[:, :, None]).reshape(n * k, -1)
        seen = np.where(self.seen, measured, np.nan)
        size = float(np.sqrt(np.nanmean((seen - np.nanmean(seen, axis=0)) ** 2)))
        return Channel(
            "positions",
            residual.ravel(),
            rows,
            np.repeat(self.piece, k),
            self.seen.ravel(),
            size,
            "m",
            neighbors=k,
        )


def _fill(x: np.ndarray) -> np.ndarray:
    """Signals (n, k) without gaps: straight lines across them, which do not count."""
    at = np.arange(len(x))
    out = x.copy()
    for k in range(x.shape[1]):
        seen = np.isfinite(x[:, k])
        out[:, k] = np.interp(at, at[seen], x[seen, k])
    return out


SPRINGS = ("stiffness", "low", "high", "break_at", "gap")


def _of_motors(record: Trajectory, chosen: np.ndarray) -> Trajectory:
    """The channels of some motors."""
    channels = {name: record[name][:, chosen] for name in ("q_m", "tau_m")}
    labels = {
        name: tuple(x for x, keep in zip(record.labels[name], chosen, strict=True) if keep)
        for name in channels
    }
    ports = {name: replace(record.ports[name], shape=(int(chosen.sum()),)) for name in channels}
    return Trajectory(record.time, channels, ports, labels)


def _pad(motion: Motion) -> tuple[Motion, int]:
    """The record with rest before and after it where it begins and ends at rest, and how many
    samples at each end: its own motion then passes the filters whole.
    """
    record = motion.trajectory
    step = float(record.time[1] - record.time[0])
    speed = np.abs(np.gradient(record["q_m"], step, axis=0))
    count = max(2, round(AT_REST / step))
    rests = np.maximum(speed[:count], speed[-count:]) < REST_SPEED * speed.max(axis=0) + 1e-12
    if not rests.all():
        return motion, 0
    n = round(PAD / step)

    def pad(x: np.ndarray) -> np.ndarray:
        first = np.repeat(x[:count].mean(axis=0)[None], n, axis=0)
        last = np.repeat(x[-count:].mean(axis=0)[None], n, axis=0)
        return np.concatenate([first, x, last])

    time = record.time[0] + step * (np.arange(len(record.time) + 2 * n) - n)
    channels = {name: pad(record[name]) for name in ("q_m", "tau_m")}
    ports = {name: record.ports[name] for name in channels}
    labels = {name: record.labels[name] for name in channels}
    positions = None if motion.positions is None else pad(motion.positions)
    return replace(
        motion, trajectory=Trajectory(time, channels, ports, labels), positions=positions
    ), n


PAD = 2.0  # s of rest before and after a record that begins and ends at rest
