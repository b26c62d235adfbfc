"""All joint configurations of a six-axis arm that reach a pose of the tool.

Many starts go down to solutions by damped Gauss-Newton steps in C, all side by side. New starts are made from the
solutions that were found (joints turned by half a turn, wrists flipped, signs changed), and others at random, until a
round finds nothing new. Solutions are polished to `POLISHED`; a pose has at most 16 of them for a general arm with six
rotations, and finitely many unless the arm is singular there.

Deflections are zero, or with ``sag`` those at rest under gravity.

Source: H.-Y. Lee, C.-G. Liang, Mechanism and Machine Theory 23(3), 1988 (sixteen solutions).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from flexgen.build.c_module import c_module
from flexgen.build.model_library import library_with
from flexgen.errors import ArgumentError, SolverError
from flexgen.mechanics.equations import derive
from flexgen.mechanics.statics import gear_deflection
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.numerics.evaluate import evaluate
from flexgen.numerics.rotations import turn_angle

SOURCE = Path(__file__).with_name("search.c")
STARTS = 128  # side by side
STEPS, POLISH = 14, 5
ROUNDS, FRUITLESS = 12, 2  # at most; rounds without a new solution before the search ends
FOUND = 1e-4  # error of a start that is polished: rotation [rad], and position over the reach
POLISHED = 1e-12
SAME = 1e-5  # rad: solutions that are as close are the same
SINGULAR = 1e-4  # smallest singular value of the scaled Jacobian over the largest
JOINTS = 6
MOST = 16
SAG_STEPS = 20


@dataclass(frozen=True)
class Configuration:
    """A joint configuration.

    Attributes
    ----------
    q : array (n_g,) [rad or m]
        Actuated coordinates, rotations within half a turn of zero, or of the middle of their limits.
    error : float
        Of the pose: the larger of position over the reach and rotation [rad].
    within_limits : bool
        Of the joints of the model file.
    branch : int
        Sign of the Jacobian's determinant: configurations with other signs are separated by a singularity.
    distance : float
        From singularity: smallest over largest singular value of the Jacobian, lengths over the reach.
    parts : dict of str to float
        Of an arm with six rotations, signed numbers that vanish where it is singular: ``shoulder``, distance of the
        wrist from the plane of the first two axes over the reach; ``elbow``, sine of the angle between upper arm and
        forearm; ``wrist``, volume that the directions of the last three axes span. The same signs mean the same
        configuration: front or back, elbow up or down, wrist flipped or not.
    """

    q: np.ndarray
    error: float
    within_limits: bool
    branch: int
    distance: float
    parts: dict[str, float]

    @property
    def flags(self) -> tuple[int, ...]:
        """Signs of shoulder, elbow and wrist; empty for other arms."""
        return tuple(1 if x >= 0 else -1 for x in self.parts.values())

    @property
    def nearest_singularity(self) -> str:
        """The part that is closest to its singularity; empty for other arms."""
        return min(self.parts, key=lambda name: abs(self.parts[name])) if self.parts else ""


def kinematics(
    model: str | Path | RobotModel,
    position: np.ndarray,
    rotation: np.ndarray,
    *,
    fixed: dict[str, float] | None = None,
    sag: bool = False,
) -> tuple[Configuration, ...]:
    """All configurations that bring the tool to a pose, the one closest to home first.

    Parameters
    ----------
    model : name, path or RobotModel
        With six actuated joints, or more with ``fixed`` ones.
    position : array (3,) [m]
        Of the tool in the world.
    rotation : array (3, 3)
        Its axes as columns.
    fixed : mapping, optional
        Joints of a redundant arm that keep a value [rad or m].
    sag : bool
        The elastic robot at rest reaches the pose, its springs deflected by gravity; ``q`` are the joints as the motors
        see them, ``eta^-1 q_m``.

    Returns
    -------
    tuple of Configuration
        Empty where the pose cannot be reached.

    Raises
    ------
    ArgumentError
        The arm has not six free joints, or the rotation is none.
    SolverError
        The arm is singular at the pose, with more than 16 solutions.
    """
    robot = model if isinstance(model, RobotModel) else read(model)
    p, R = np.asarray(position, dtype=float), np.asarray(rotation, dtype=float)
    if p.shape != (3,) or R.shape != (3, 3) or not (np.isfinite(p).all() and np.isfinite(R).all()):
        raise ArgumentError(f"pose: given shapes {p.shape}, {R.shape}, expected (3,) and (3, 3), finite")
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
        raise ArgumentError("rotation: given a matrix that is no rotation, expected orthogonal columns, right-handed")
    names = [robot.coordinates[i].name for i in robot.i_g]
    for name in fixed or {}:
        if name not in names:
            raise ArgumentError(f"fixed: given joint {name!r}, expected some of {', '.join(names)}")
    solver = _solver(robot, tuple(sorted((fixed or {}).items())))
    goal = np.concatenate([p, R.ravel()])
    found = solver.solve(goal)
    if sag:
        found = [q for q in (solver.sagged(goal, q) for q in found) if q is not None]
    home = np.array(robot.home)
    made = [solver.configuration(goal, q, sag) for q in found]
    return tuple(sorted(made, key=lambda c: float(np.abs(c.q - home).max())))


def configuration_at(model: RobotModel, q_g: np.ndarray) -> Configuration:
    """What is known about the joints (n_g,) [rad or m] of an arm with six actuated coordinates, without deflections."""
    solver, full = _solver(model, ()), np.zeros(model.n_a)
    full[list(model.i_g)] = q_g
    p, R = solver.library.forward_kinematics(full)
    return solver.configuration(np.concatenate([np.asarray(p), np.asarray(R).ravel()]), np.asarray(q_g, float), False)


def arm_parts(J: np.ndarray) -> dict[str, float]:
    """Shoulder, elbow and wrist from the Jacobian (6, 6) of six rotations, lengths over the reach; see `Configuration`.

    A column (v, z): velocity of the tool and direction of the axis, whose point next to the tool is z x v from it.
    """
    z = J[3:].T
    c = np.cross(z, J[:3].T)
    wrist_4, wrist_5 = _next_to(c[3], z[3], c[4], z[4]), _next_to(c[4], z[4], c[5], z[5])
    upper, fore = np.cross(z[1], c[2] - c[1]), np.cross(z[1], wrist_4 - c[2])  # across the second axis
    size = max(float(np.linalg.norm(upper) * np.linalg.norm(fore)), 1e-12)
    return {
        "shoulder": float(np.linalg.det(np.stack([z[0], wrist_5 - c[0], z[1]]))),
        "elbow": float(z[1] @ np.cross(upper, fore)) / size,
        "wrist": float(np.linalg.det(z[3:])),
    }


def _next_to(c: np.ndarray, z: np.ndarray, other: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The point of the line through c along z that is next to another line."""
    across = np.cross(z, direction)
    square = float(across @ across)
    if square < 1e-12:
        return c
    return np.asarray(c + z * float(np.cross(other - c, direction) @ across) / square)


@lru_cache(maxsize=16)
def _solver(model: RobotModel, fixed: tuple[tuple[str, float], ...]) -> _Solver:
    return _Solver(model, dict(fixed))


class _Problem(ctypes.Structure):
    """``ik_problem`` of search.c."""

    _fields_ = [
        ("n", ctypes.c_int32),
        ("n_a", ctypes.c_int32),
        ("joints", ctypes.c_int32 * JOINTS),
        ("pose", ctypes.c_void_p),
        ("jacobian", ctypes.c_void_p),
        ("work", ctypes.c_void_p),
        ("length", ctypes.c_double),
        *[(name, ctypes.c_void_p) for name in ("goal", "q", "error", "scratch")],
    ]


class _Solver:
    """The search for one robot, with its memory."""

    def __init__(self, model: RobotModel, fixed: dict[str, float]) -> None:
        self.model, self.i_g = model, list(model.i_g)
        names = [model.coordinates[i].name for i in self.i_g]
        self.free = [i for i, name in zip(self.i_g, names, strict=True) if name not in fixed]
        if len(self.free) != JOINTS:
            raise ArgumentError(
                f"model {model.name}: given {len(self.free)} free joints ({', '.join(names)}), expected six; name the "
                "joints of a redundant arm that keep a value in fixed"
            )
        self.base = np.zeros(model.n_a)
        for name, value in fixed.items():
            self.base[self.i_g[names.index(name)]] = value
        self.rotary = np.array([model.coordinates[i].unit == "rad" for i in self.free])
        self.library = library_with(model, ("forward_kinematics", "jacobian"))
        pose, work = self.library.forward_kinematics.batch_address()
        jacobian, more = self.library.jacobian.batch_address()
        self._work = work if work.size >= more.size else more
        points = np.asarray(self.library.forward_kinematics(self.base).p)
        others = self.library.forward_kinematics(self._random(np.random.default_rng(0).random((64, JOINTS)))).p
        self.length = float(max(np.linalg.norm(others - points, axis=1).max(), 1e-3)) / 2
        self._q = np.zeros((model.n_a, STARTS))
        self._error = np.zeros(STARTS)
        self._scratch = np.zeros((3 + 9 + 6 * model.n_a + 6 + 21 + 6) * STARTS)
        self._goal = np.zeros(12)
        arrays = (self._goal, self._q, self._error, self._scratch)
        self._problem = _Problem(
            STARTS, model.n_a, (ctypes.c_int32 * JOINTS)(*self.free), pose, jacobian, self._work.ctypes.data,
            self.length, *(x.ctypes.data for x in arrays),
        )  # fmt: skip
        self._iterate = c_module(SOURCE, "-ftree-vectorize").flexgen_ik_iterate
        self._sequence = qmc.Halton(JOINTS, seed=0).random(STARTS * (ROUNDS + 1))
        self._signs = self._changes()
        self._at = [self.i_g.index(i) for i in self.free]
        self._hash = np.random.default_rng(1).random(2 * JOINTS + len(self.i_g))

    def _random(self, unit: np.ndarray) -> np.ndarray:
        """Arm coordinates (n, n_a) from numbers between 0 and 1."""
        q = np.tile(self.base, (len(unit), 1))
        for k, i in enumerate(self.free):
            dof = self.model.coordinates[i].dof
            low, high = -np.pi, np.pi
            if not self.rotary[k] and dof is not None:
                low = dof.lower if dof.lower is not None else -1.0
                high = dof.upper if dof.upper is not None else 1.0
            q[:, i] = low + (high - low) * unit[:, k]
        return q

    @staticmethod
    def _changes() -> tuple[np.ndarray, np.ndarray]:
        """Changes of a solution that often lead to another one: factors and half turns (k, 6)."""
        factors, turns = [], []

        def add(flips: dict[int, float], halves: tuple[int, ...]) -> None:
            f, t = np.ones(JOINTS), np.zeros(JOINTS)
            for k, x in flips.items():
                f[k] = x
            t[list(halves)] = np.pi
            factors.append(f)
            turns.append(t)

        for k in range(JOINTS):
            add({k: -1.0}, ())
            add({}, (k,))
        add({4: -1.0}, (3, 5))
        add({1: -1.0, 2: -1.0}, (0,))
        add({2: -1.0}, (0,))
        add({1: -1.0}, (0, 3))
        add({2: -1.0, 4: -1.0}, (3, 5))
        return np.array(factors), np.array(turns)

    def solve(self, goal: np.ndarray) -> list[np.ndarray]:
        """All solutions (n_g,), rotations within half a turn of zero."""
        self._goal[:] = goal
        found: list[np.ndarray] = []
        fresh: list[np.ndarray] = []
        fruitless, used = 0, 0
        for _ in range(ROUNDS):
            starts = self._from(fresh)[:STARTS]
            count = STARTS - len(starts)
            more = self._random(self._sequence[used : used + count])
            used += count
            new = self._round(np.vstack([starts, more]), found)
            found += new
            if len(found) > MOST:
                raise SolverError(
                    f"kinematics: more than {MOST} configurations of {self.model.name} at this pose, which is singular"
                )
            fresh = new
            fruitless = 0 if new else fruitless + 1
            if fruitless >= FRUITLESS:
                break
        return found

    def _from(self, solutions: list[np.ndarray]) -> np.ndarray:
        """Starts (k, n_a) made from solutions."""
        out = [np.zeros((0, self.model.n_a))]
        factors, turns = self._signs
        for q in solutions:
            made = np.tile(self.base, (len(factors), 1))
            made[:, self.free] = q[self._at] * factors + turns * self.rotary
            out.append(made)
        return np.vstack(out)

    def _round(self, starts: np.ndarray, known: list[np.ndarray]) -> list[np.ndarray]:
        """New solutions from starts (STARTS, n_a)."""
        self._q[:] = starts.T
        self._iterate(ctypes.byref(self._problem), STEPS)
        if not np.any(self._error < FOUND):
            return []
        self._iterate(ctypes.byref(self._problem), POLISH)
        good = self._q[:, self._error < POLISHED][self.i_g].T
        if not len(good):
            return []
        at = self._at
        wrapped = np.remainder(good[:, at] + np.pi, 2 * np.pi) - np.pi
        good[:, at] = np.where(self.rotary, wrapped, good[:, at])
        # One of those with the same rounded values; a few equal ones may be left on both sides of a boundary.
        key = np.round(np.hstack([np.cos(good[:, at]), np.sin(good[:, at]), good]) * 1e3)
        _, first = np.unique(key @ self._hash, return_index=True)
        kept = np.array(known).reshape(-1, good.shape[1])
        new: list[np.ndarray] = []
        for q in good[np.sort(first)]:
            d = np.abs(kept - q)
            if not np.any(np.all(np.minimum(d, np.abs(d - 2 * np.pi)) < SAME, axis=1)):
                new.append(q)
                kept = np.vstack([kept, q])
        return new

    def configuration(self, goal: np.ndarray, q: np.ndarray, sag: bool) -> Configuration:
        """A solution with what is known about it."""
        model = self.model
        full = np.zeros(model.n_a)
        full[self.i_g] = q
        J = np.asarray(self.library.jacobian(full))[:, self.free].copy()
        J[:3] /= self.length
        singular = np.linalg.svd(J, compute_uv=False)
        inside, placed = True, q.copy()
        for k, i in enumerate(self.i_g):
            dof = model.coordinates[i].dof
            if dof is None:
                continue
            low = -np.inf if dof.lower is None else dof.lower
            high = np.inf if dof.upper is None else dof.upper
            if model.coordinates[i].unit == "rad" and not low <= placed[k] <= high:
                for turn in (2 * np.pi, -2 * np.pi):
                    if low <= placed[k] + turn <= high:
                        placed[k] += turn
                        break
            inside = inside and bool(low <= placed[k] <= high)
        error = self._miss(goal, self._deflected(placed) if sag else full)
        branch = int(np.sign(np.linalg.det(J)))
        parts = arm_parts(J) if self.rotary.all() else {}
        return Configuration(placed, error, inside, branch, float(singular[-1] / singular[0]), parts)

    def _miss(self, goal: np.ndarray, full: np.ndarray) -> float:
        p, R = self.library.forward_kinematics(full)
        distance = float(np.linalg.norm(p - goal[:3])) / self.length
        return max(distance, float(turn_angle(np.asarray(R)[None], goal[None, 3:].reshape(1, 3, 3))[0]))

    # --- the elastic robot at rest ---

    def _deflected(self, q: np.ndarray) -> np.ndarray:
        """Arm coordinates (n_a,) at rest under gravity with the motors at ``eta q``."""
        model, equations = self.model, derive(self.model)
        full = np.zeros(model.n_a)
        full[self.i_g] = q
        i_e = list(model.i_e)
        for _ in range(SAG_STEPS):
            before = full.copy()
            g = evaluate(equations.function("gravity"), full)[0].ravel()
            full[self.i_g] = q - gear_deflection(equations, g[None, self.i_g])[0]
            if i_e:
                zero, step = np.zeros(model.n_a), 1e-6
                tau = evaluate(equations.function("elastic_torque"), full, zero)[0].ravel()
                for k, i in enumerate(i_e):
                    moved = full.copy()
                    moved[i] += step
                    slope = (evaluate(equations.function("elastic_torque"), moved, zero)[0].ravel()[k] - tau[k]) / step
                    full[i] += (g[i] - tau[k]) / slope
            if np.abs(full - before).max() < 1e-14:
                break
        return full

    def sagged(self, goal: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """The joints as the motors see them, such that the elastic robot at rest is at the goal; None: not found."""
        q, at = q.copy(), self._at
        for _ in range(SAG_STEPS):
            full = self._deflected(q)
            p, R = self.library.forward_kinematics(full)
            E = R @ goal[3:].reshape(3, 3).T
            turn = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
            e = np.concatenate([(p - goal[:3]) / self.length, turn])
            if np.abs(e).max() < 1e-13:
                break
            J = np.asarray(self.library.jacobian(full))[:, self.free].copy()
            J[:3] /= self.length
            q[at] -= np.linalg.lstsq(J, e, rcond=1e-10)[0]
        return q if self._miss(goal, self._deflected(q)) < 1e-10 else None
