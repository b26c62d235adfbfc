"""Measured points of an elastic tree at rest, and their exact derivatives in all parameters.

    q_k = command_k + shift_k + deflection_k,   deflection = c tau(q),
    q_mechanism = sum factor_k q_k
    y = f + F p
    f, F: pose of the world in the frame of the measurement

``c``: compliances; ``tau``: load of gravity on each elastic coordinate, where that of a mechanism
acts on the coordinates that it names, and the torques of counterbalance and friction at rest, by
the angle command + deflection. With ``T`` the nodes that an elastic coordinate moves,
``H = dtau/dq`` and ``J = dp/dq``, the implicit function theorem gives, for a number with direct
effects ``q'``, ``c'``, ``tau'``,

    L = J T (1 - c T' H T)^-1,      dp = (J + L c T' H) q' + L (c' tau + c tau')
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.identification.poses.parameters import Unknown, trackers_of
from flexgen.identification.poses.touches import Touches
from flexgen.identification.poses.tree import IDENTITY, Posture, Tree, rotations

NEWTON_STEPS = 20
TOGETHER = 16  # poses that are computed at a time, in the cache of a processor
SETTLED = 1e-10  # rad or m: largest difference of a deflection from load times compliance
# part that a step of Newton's method leaves of this difference from which on its matrix is renewed
SLOW = 0.1
NO_EQUILIBRIUM = "calibration: a pose has no static equilibrium, the springs do not carry the arm"


@dataclass(frozen=True)
class Numbers:
    """The numbers of a tree that are free, each set as a whole.

    ``shifts`` (n): of the nodes; ``frame`` (6); ``trackers`` (k, 3); ``compliances`` (n_E);
    ``factors``: (node of a mechanism, node of a coordinate) -> factor; ``masses`` (b); ``centers``
    (b, 3);
    ``points`` (m, 3): fixed points in the frame of the measurement; ``surfaces`` (m, 3): numbers
    of `flexgen.identification.poses.touches`.
    """

    shifts: np.ndarray
    frame: np.ndarray
    trackers: np.ndarray
    compliances: np.ndarray
    factors: dict[tuple[int, int], float]
    masses: np.ndarray
    centers: np.ndarray
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    surfaces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(
        cls, tree: Tree, unknowns: Sequence[Unknown] = (), x: Sequence[float] | np.ndarray = ()
    ) -> Numbers:
        """Those of the model, with the values ``x`` of the unknowns."""
        index = tree.index
        sensors = trackers_of(tree.model)
        new = cls(
            np.zeros(len(tree.nodes)),
            np.zeros(6),
            np.array([sensor.position for sensor in sensors], float),
            np.array(list(tree.elastic.values()), float),
            {
                (index[m], index[k]): f
                for m, factors in tree.mimics.items()
                for k, f in factors.items()
            },
            np.array([body.mass for _, _, body in tree.bodies]),
            np.array([body.com for _, _, body in tree.bodies], float).reshape(-1, 3),
            *(np.zeros((_count(unknowns, kind), 3)) for kind in ("point", "surface")),
        )
        arrays = {
            "node": new.shifts,
            "frame": new.frame,
            "tracker": new.trackers,
            "compliance": new.compliances,
            "factor": new.factors,
            "mass": new.masses,
            "center": new.centers,
            "point": new.points,
            "surface": new.surfaces,
        }
        for unknown, value in zip(unknowns, x, strict=True):
            place: tuple[int, ...] | int = unknown.at if len(unknown.at) > 1 else unknown.at[0]
            arrays[unknown.kind][place] = value  # type: ignore[index]
        return new


def _count(unknowns: Sequence[Unknown], kind: str) -> int:
    """Of the things with numbers of a kind."""
    return 1 + max((u.at[0] for u in unknowns if u.kind == kind), default=-1)


@dataclass(frozen=True)
class Near:
    """Where Newton's method starts: ``deflection`` (N, n_E); ``inverse`` (N, n_E, n_E): of
    ``1 - c T' H T`` nearby.
    """

    deflection: np.ndarray
    inverse: np.ndarray | None = None

    def among(self, rows: np.ndarray) -> Near:
        """Copy for some of the poses."""
        return Near(self.deflection[rows], None if self.inverse is None else self.inverse[rows])


@dataclass(frozen=True)
class Rest:
    """The robot at rest at N poses.

    ``q`` (N, n): values of the nodes; ``near``: deflections, and what found them; ``load`` (N,
    n_E): ``tau`` [N m or N]; ``points`` (N, k, 3): the trackers in the world; ``measured`` (N, k,
    3): in the frame of the measurement [m], from the fixed point where one is touched; of a
    surface, the difference from its reading and two zeros. ``tips`` (N, t, 3): ends of the axes of
    `Touches.tips` in the world.
    """

    q: np.ndarray
    near: Near
    load: np.ndarray
    points: np.ndarray
    measured: np.ndarray
    posture: Posture
    tips: np.ndarray


@dataclass(frozen=True)
class Loads:
    """Loads of gravity on all nodes.

    ``tau`` (n, N) [N m or N]; ``crossed`` (n, N, 3): ``g x z``, zero of translations; ``shift``
    (n, N, 3): change of the first moment of all bodies [kg m] in a node; ``centers`` (b, N, 3): of
    mass, in the world [m].
    """

    tau: np.ndarray
    crossed: np.ndarray
    shift: np.ndarray
    centers: np.ndarray


class Statics:
    """The equations of this module for a tree and its commands.

    Parameters
    ----------
    tree : Tree
    commands : array (N, n_g) [rad or m]
        Actuated coordinates of the model without deflections.
    groups : array (N, k), optional
        Index of the fixed point that each tracker touches, whose measured position is the distance
        from it; -1: none.
    touches : Touches, optional
        Surfaces and gauges.
    """

    def __init__(
        self,
        tree: Tree,
        commands: np.ndarray,
        groups: np.ndarray | None = None,
        touches: Touches | None = None,
    ) -> None:
        self.tree = tree
        self.model = tree.model
        self.commands = commands
        self.groups = groups
        down = np.array(tree.model.gravity)
        size = float(np.linalg.norm(down))
        if touches is not None and size > 0.0:
            touches = replace(touches, up=tuple((-down / size).tolist()))
        self.touches = touches
        self.actuated = [tree.index[c.name] for c in tree.model.coordinates if c.actuated]
        self.elastic = np.array([tree.index[name] for name in tree.elastic], int)
        self.mechanisms = [tree.index[name] for name in tree.mimics]
        self.rows = np.concatenate([self.elastic, self.mechanisms]).astype(int)
        self.slides = np.array([node.slides for node in tree.nodes])
        dofs = {c.name: c.dof for c in tree.model.coordinates}
        self.springs = [
            (k, dof) for k, name in enumerate(tree.elastic) if (dof := dofs[name]) is not None
        ]
        self.gravity = np.array(tree.model.gravity)
        self.held = np.array([mount.node for _, mount, _ in tree.bodies], int)
        self.places = [tree.tip(sensor.place) for sensor in trackers_of(tree.model)]

    def among(self, rows: np.ndarray) -> Statics:
        """Copy for some of the poses."""
        groups = None if self.groups is None else self.groups[rows]
        touches = None if self.touches is None else self.touches.among(rows)
        return Statics(self.tree, self.commands[rows], groups, touches)

    def with_commands(self, commands: np.ndarray) -> Statics:
        """Statics of other poses, without touches."""
        return Statics(self.tree, commands)

    def rest(self, numbers: Numbers, near: Near | None = None, *, rigid: bool = False) -> Rest:
        """The robot at rest under gravity, by Newton's method from ``near``, whose matrix is kept
        while it converges.

        ``rigid``: without deflections, and without their slopes.

        Raises
        ------
        SolverError
            A pose has no equilibrium nearby.
        """
        T = self._moves(numbers)
        direct = np.tile(numbers.shifts, (len(self.commands), 1))
        direct[:, self.actuated] += self.commands
        moving = self.actuated + ([] if rigid else list(self.elastic)) + self.mechanisms
        places = self.tree.places(numbers.shifts, np.unique(moving))
        near = near or Near(np.zeros((len(direct), len(self.elastic))))
        deflection = near.deflection
        inverse = near.inverse
        largest = np.inf
        last = None
        for _ in range(NEWTON_STEPS):
            q = self._values(numbers, direct, deflection)
            posture = self.tree.posture(q, places)
            if rigid:
                load = np.zeros_like(deflection)
                break
            tau = self._loads(numbers, posture, self.rows).tau
            load = (T[self.rows].T @ tau).T + self._joint_torques(numbers, q)[0]
            gap = numbers.compliances * load - deflection
            before = largest
            largest = np.abs(gap).max(initial=0.0)
            if largest < SETTLED:
                break
            if inverse is None or largest > SLOW * before:
                inverse = self._inverse(numbers, posture, q, T)
                last = None
            step = _broyden_step((inverse @ gap[..., None])[..., 0], last)
            if not np.abs(step).max() < 1.0:
                raise SolverError(NO_EQUILIBRIUM)
            deflection = deflection + step
            last = step
        else:
            raise SolverError(f"calibration: no static equilibrium in {NEWTON_STEPS} steps")
        trackers = zip(self.places, numbers.trackers, strict=True)
        points = np.stack([self.tree.point(posture, mount, x) for mount, x in trackers], axis=1)
        measured = numbers.frame[:3] + points @ frame_rotation(numbers.frame).T
        if self.groups is not None and len(numbers.points):
            touched = (self.groups >= 0)[..., None]
            measured = measured - np.where(touched, numbers.points[self.groups], 0.0)
        tips = self._tips(numbers, posture)
        if self.touches is not None:
            away = self.touches.residuals(points, tips, self._surfaces(numbers))
            scalar = away[..., None] * IDENTITY[0]
            measured = np.where(self.touches.touched[..., None], scalar, measured)
        return Rest(q, Near(deflection, inverse), load, points, measured, posture, tips)

    def _tips(self, numbers: Numbers, posture: Posture) -> np.ndarray:
        """Ends (N, t, 3) [m] in the world of the axes of 1 m that gauges measure along."""
        axes = () if self.touches is None else self.touches.tips
        ends = [
            self.tree.point(posture, self.places[k], numbers.trackers[k] + IDENTITY[axis])
            for k, axis in axes
        ]
        return np.stack(ends, axis=1) if ends else np.zeros((len(self.commands), 0, 3))

    def _surfaces(self, numbers: Numbers) -> np.ndarray:
        """Numbers (m, 3) of all surfaces; zero of those that have none."""
        out = np.zeros((0 if self.touches is None else len(self.touches.surfaces), 3))
        out[: len(numbers.surfaces)] = numbers.surfaces
        return out

    def _inverse(
        self, numbers: Numbers, posture: Posture, q: np.ndarray, T: np.ndarray
    ) -> np.ndarray:
        """That of ``1 - c T' H T`` (N, n_E, n_E)."""
        loads = self._loads(numbers, posture)
        rising = self._joint_torques(numbers, q)[1]
        try:
            parts = (
                self._matrix(numbers, self._load_slopes(loads, T, p), T, rising[p])
                for p in _parts(len(q))
            )
            return np.concatenate([np.linalg.inv(matrix) for matrix in parts])
        except np.linalg.LinAlgError:
            raise SolverError(NO_EQUILIBRIUM) from None

    def _matrix(
        self, numbers: Numbers, H: np.ndarray, T: np.ndarray, rising: np.ndarray
    ) -> np.ndarray:
        """``1 - c T' H T`` (N, n_E, n_E)."""
        slope = self._of_moves(H, T, self.elastic, self.mechanisms) + rising
        return np.asarray(np.eye(len(numbers.compliances)) - numbers.compliances[:, None] * slope)

    def slopes(
        self, numbers: Numbers, rest: Rest, unknowns: Sequence[Unknown]
    ) -> tuple[np.ndarray, Near]:
        """Derivatives (N, k, 3, p) of the measured positions in the unknowns, at a rest of the
        same numbers.

        And where a search for equilibria of numbers nearby starts.
        """
        loads = self._loads(numbers, rest.posture)
        T = self._moves(numbers)
        c = numbers.compliances
        at = np.array([unknown.at[0] for unknown in unknowns], int)
        nodes, springs, mechanisms, frame, masses, centers = (
            [i for i, unknown in enumerate(unknowns) if unknown.kind == kind]
            for kind in ("node", "compliance", "factor", "frame", "mass", "center")
        )
        heavy = masses + centers
        rising = self._joint_torques(numbers, rest.q)[1]
        weights = np.swapaxes(
            self._weight_slopes(numbers, rest.posture, loads, [unknowns[i] for i in heavy]), 1, 2
        )
        change = c * self._of_moves(weights, T, range(len(c)), range(len(c), len(self.rows)))
        places = [(mount, rest.points[:, k]) for k, mount in enumerate(self.places)]
        axes = () if self.touches is None else self.touches.tips
        places += [(self.places[k], rest.tips[:, t]) for t, (k, _) in enumerate(axes)]
        J = np.concatenate(
            [self.tree.point_slopes(rest.posture, mount, point) for mount, point in places], axis=1
        )
        out = np.zeros((len(rest.q), len(places), 3, len(unknowns)))  # in the world, until the end
        inverse = np.empty((len(out), len(c), len(c)))
        for some in _parts(len(out)):
            H = self._load_slopes(loads, T, some)
            matrix = self._matrix(numbers, H, T, rising[some])
            moved = self._of_moves(J[some], T, self.elastic, self.mechanisms)
            inverse[some] = np.linalg.inv(matrix)
            L = moved @ inverse[some]
            D = J[some] + (L * c) @ H
            part = out[some].reshape(len(D), -1, len(unknowns))
            part[:, :, nodes] = D[:, :, at[nodes]]
            for (m, on), f in numbers.factors.items():
                part[:, :, [i for i in nodes if at[i] == on]] += f * D[:, :, m, None]
            part[:, :, springs] = L[:, :, at[springs]] * rest.load[some][:, None, at[springs]]
            part[:, :, heavy] = L @ np.swapaxes(change[some], 1, 2)
            for i in mechanisms:
                m, on = unknowns[i].at
                reaction = (L @ (c * T[on])) * loads.tau[m, some, None]
                part[:, :, i] = D[:, :, m] * rest.q[some, on, None] + reaction
        for i, unknown in enumerate(unknowns):
            if unknown.kind == "tracker":
                k, axis = unknown.at
                mount = self.places[k]
                ends = [len(self.places) + t for t, (of, _) in enumerate(axes) if of == k]
                turned = rest.posture.frame(mount.node)[0] @ mount.rotation[:, axis]
                for place in (k, *ends):
                    out[:, place, :, i] = turned
        world = out
        out = frame_rotation(numbers.frame) @ world[:, : len(self.places)]
        turned = frame_slopes(numbers.frame)
        for i in frame:
            out[..., i] = IDENTITY[at[i]] if at[i] < 3 else rest.points @ turned[at[i] - 3].T
        for i, unknown in enumerate(unknowns):
            if unknown.kind == "point" and self.groups is not None:
                out[:, :, unknown.at[1], i] = -1.0 * (self.groups == unknown.at[0])
        if self.touches is not None:
            self._set_touches(out, numbers, rest, world, unknowns)
        return out, Near(rest.near.deflection, inverse)

    def _set_touches(
        self,
        out: np.ndarray,
        numbers: Numbers,
        rest: Rest,
        world: np.ndarray,
        unknowns: Sequence[Unknown],
    ) -> None:
        """Set the slopes of touches; ``world`` (N, k + t, 3, p): those of trackers and tips."""
        if self.touches is None:
            return
        at = self.touches.touched
        J, J_tips = np.split(world, [len(self.places)], axis=1)
        surfaces = self._surfaces(numbers)
        out[at] = 0.0
        out[at, 0] = self.touches.slopes(rest.points, rest.tips, surfaces, J, J_tips, unknowns)[at]

    def _moves(self, numbers: Numbers) -> np.ndarray:
        """``T`` (n, n_E): the nodes that each elastic coordinate moves, through mechanisms too."""
        T = np.zeros((len(self.tree.nodes), len(self.elastic)))
        T[self.elastic, np.arange(len(self.elastic))] = 1.0
        for m in self.mechanisms:
            T[m] = sum(f * T[on] for (which, on), f in numbers.factors.items() if which == m)
        return T

    def _values(self, numbers: Numbers, direct: np.ndarray, deflection: np.ndarray) -> np.ndarray:
        """Values (N, n) of the nodes."""
        q = direct.copy()
        q[:, self.elastic] += deflection
        for m in self.mechanisms:
            q[:, m] += sum(
                f * q[:, on] for (which, on), f in numbers.factors.items() if which == m
            )
        return q

    def _joint_torques(self, numbers: Numbers, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques (N, n_E) of counterbalance and friction at rest on the elastic coordinates;
        slopes (N, n_E, n_E).

        A zero turns the body in front of the counterbalance, as in the model file: the angle does
        not contain it.
        """
        angle = q[:, self.elastic] - numbers.shifts[self.elastic]
        torque = np.zeros_like(angle)
        slope = np.zeros((*angle.shape, angle.shape[1]))
        for k, dof in self.springs:
            torque[:, k] -= dof.friction.offset
            for n, (sine, cosine) in enumerate(dof.counterbalance, 1):
                x = n * angle[:, k]
                torque[:, k] += sine * np.sin(x) + cosine * np.cos(x)
                slope[:, k, k] += n * (sine * np.cos(x) - cosine * np.sin(x))
        return torque, slope

    def _loads(self, numbers: Numbers, posture: Posture, on: np.ndarray | None = None) -> Loads:
        """Loads and their slopes, of all nodes or only those on some; see
        `flexgen.identification.poses.tree`.
        """
        tree = self.tree
        g = self.gravity
        z, o = posture.every if on is None else posture.axes(on)
        on = np.arange(len(z)) if on is None else on
        bodies = zip(tree.bodies, numbers.centers, strict=True)
        centers = np.stack([tree.point(posture, mount, x) for (_, mount, _), x in bodies])
        weighted = tree.carries[on][:, self.held] * numbers.masses  # (n, b)
        mass = weighted.sum(axis=1)
        moment = np.tensordot(weighted, centers, 1) - mass[:, None, None] * o
        sliding = self.slides[on, None, None]
        shift = np.where(sliding, mass[:, None, None] * z, np.cross(z, moment))  # d(sum m c)/dq
        return Loads(shift @ g, np.where(sliding, 0.0, np.cross(g, z)), shift, centers)

    def _load_slopes(self, loads: Loads, T: np.ndarray, some: slice) -> np.ndarray:
        """``T' H`` (poses, n_E, n): slopes of the loads of the elastic coordinates in the values
        of all nodes.
        """
        carries = self.tree.carries
        rows = self.rows
        n = len(self.elastic)
        a = np.swapaxes(loads.crossed[:, some], 0, 1)  # (., n, 3)
        b = np.moveaxis(loads.shift[:, some], 0, 2)  # (., 3, n)
        H = a[:, rows] @ b
        carried = np.swapaxes(a @ b[:, :, rows], 1, 2)
        H = np.where(carries[rows], H, np.where(carries[:, rows].T, carried, 0.0))
        slopes = H[:, :n]
        for k, m in enumerate(self.mechanisms):
            for e in np.flatnonzero(T[m]):
                slopes[:, e] += T[m, e] * H[:, n + k]
        return slopes

    def _of_moves(
        self, H: np.ndarray, T: np.ndarray, elastic: Iterable[int], mechanisms: Iterable[int]
    ) -> np.ndarray:
        """``H T`` (N, n_E, n_E), H in some nodes; ``elastic``, ``mechanisms``: their columns of
        H.
        """
        out = H[:, :, list(elastic)]
        for k, m in zip(mechanisms, self.mechanisms, strict=True):
            for e in np.flatnonzero(T[m]):
                out[:, :, e] += T[m, e] * H[:, :, k]
        return out

    def _weight_slopes(
        self, numbers: Numbers, at: Posture, loads: Loads, unknowns: Sequence[Unknown]
    ) -> np.ndarray:
        """Derivatives (N, rows, p) of loads in masses and coordinates of centers of mass; rows:
        elastic, mechanisms.
        """
        rows = self.rows
        held = self.held[[unknown.at[0] for unknown in unknowns]]
        arms = np.empty((loads.tau.shape[1], 3, len(unknowns)))
        for i, unknown in enumerate(unknowns):
            body = unknown.at[0]
            if unknown.kind == "mass":
                arms[..., i] = loads.centers[body]
            else:
                axis = self.tree.bodies[body][1].rotation[:, unknown.at[1]]
                arms[..., i] = numbers.masses[body] * (at.frame(held[i])[0] @ axis)
        slopes = np.swapaxes(loads.crossed[rows], 0, 1) @ arms
        z, o = at.axes(rows)
        own = np.where(self.slides[rows], (z @ self.gravity).T, 0.0)
        own -= np.einsum("aNi,aNi->Na", loads.crossed[rows], o)
        slopes[:, :, [i for i, unknown in enumerate(unknowns) if unknown.kind == "mass"]] += own[
            ..., None
        ]
        return slopes * self.tree.carries[np.ix_(rows, held)]


def _broyden_step(step: np.ndarray, last: np.ndarray | None) -> np.ndarray:
    """A step (N, n_E) of Newton's method with a matrix kept, corrected by what the last step left
    of the difference.

    Source: C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math.
    Comp. 19, 1965.
    """
    if last is None:
        return step
    part = (last * step).sum(axis=1) / np.maximum((last**2).sum(axis=1), np.finfo(float).tiny)
    return np.asarray(step / (1.0 - np.clip(part, -0.5, 0.5))[:, None])


def _parts(count: int) -> list[slice]:
    """Poses that are computed at a time."""
    return [slice(first, first + TOGETHER) for first in range(0, count, TOGETHER)]


def frame_rotation(frame: np.ndarray) -> np.ndarray:
    """Rotation matrix of ``frame[3:]``: rotations about x, then the new y, then the new z
    [rad].
    """
    parts = [rotations(axis, frame[3 + k : 4 + k])[0] for k, axis in enumerate(IDENTITY)]
    return parts[0] @ parts[1] @ parts[2]


def frame_slopes(frame: np.ndarray) -> list[np.ndarray]:
    """Derivatives of `frame_rotation` in its three angles."""
    parts = [rotations(axis, frame[3 + k : 4 + k])[0] for k, axis in enumerate(IDENTITY)]
    hats = [np.cross(axis, IDENTITY).T for axis in IDENTITY]
    x, y, z = parts
    return [hats[0] @ x @ y @ z, x @ hats[1] @ y @ z, x @ y @ hats[2] @ z]
