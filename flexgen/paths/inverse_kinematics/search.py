"""All joint configurations of a six-axis arm that reach a pose of the tool, with what is known
about each of them.

They are found by the emitted C, see ``flexgen/codegen/clib/inverse_kinematics.c``. A pose has at
most 16 of them for a general arm with six rotations, and finitely many unless the arm is singular
there. Deflections are zero, or with ``sag`` those at rest under gravity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.dynamics.mechanics.motor_harmonics import gear_angles_along, transmission_errors
from flexgen.dynamics.mechanics.output_columns import turn_angle
from flexgen.dynamics.mechanics.statics import gear_deflection
from flexgen.model.elements import RobotModel
from flexgen.paths.inverse_kinematics.few_axes import FewAxes, has_few_axes

SINGULAR = 1e-4  # smallest singular value of the scaled Jacobian over the largest
# the same, of a pose that a family of configurations reaches: the error that is left
FAMILY = 1e-12
# error of a pose by rounding: over the distance, that of the joints along the direction that is
# lost
ROUNDING = 1e-14
TURNED = 2e-3  # rad: rotation of the goal to where the search is not singular
TURNS = 16  # number of such rotations, about axes spread over the plane across the sixth axis
# distance from singularity of a configuration at the turned goal that is refined at the goal
NEAR = 0.05
REFINED = 1e-14  # largest error of a refined configuration
SAME = 1e-5  # rad or m: configurations that are as close are one
REFINEMENTS = 40
# last refinements, across the direction that is lost: along it, rounding moves the joints without
# an end
POLISHED = 3
JOINTS = 6
SAG_STEPS = 20


@checked_result
@dataclass(frozen=True)
class Configuration(Result):
    """A joint configuration.

    Attributes
    ----------
    q : array (n_g,) [rad or m]
        Actuated coordinates, rotations within half a turn of zero, or of the middle of their
        limits.
    error : float
        Of the pose: the larger of position over the reach and rotation [rad].
    within_limits : bool
        Of the joints of the model file.
    branch : int
        Sign of the Jacobian's determinant: configurations with other signs are separated by a
        singularity.
    distance : float
        From singularity: smallest over largest singular value of the Jacobian, lengths over the
        reach.
    parts : dict of str to float
        Of an arm with six rotations, signed numbers that vanish where it is singular:
        ``shoulder``, distance of the wrist from the plane of the first two axes over the reach;
        ``elbow``, sine of the angle between upper arm and forearm; ``wrist``, volume that the
        directions of the last three axes span. The same signs mean the same configuration: front
        or back, elbow up or down, wrist flipped or not.

    Examples
    --------
    >>> import numpy as np
    >>> found = flexgen.kinematics("manutec_r3", np.array([0.5, 0.6, 1.2]), np.eye(3))
    >>> found[0].q.shape, found[0].within_limits, sorted(found[0].parts)
    ((6,), True, ['elbow', 'shoulder', 'wrist'])
    """

    q: np.ndarray
    error: float
    within_limits: bool
    branch: int
    distance: float
    parts: dict[str, float]

    __repr__ = short_repr

    def content(self) -> tuple[Part, ...]:
        """Joints, and how far the configuration is from limits and singularities."""
        return (
            Prose("joint configuration", is_title=True),
            Row("actuated coordinates, rad or m", ", ".join(f"{x:.4g}" for x in self.q)),
            Row("error of the pose", self.error, "", "error"),
            Row("within the limits", "yes" if self.within_limits else "no"),
            Row("sign of the determinant of the Jacobian", self.branch, "", "branch"),
            Row("distance from singularity", self.distance, "", "singularity_distance"),
            *(Row(name, size) for name, size in self.parts.items()),
            Data("q", self.q),
            Data("within_limits", self.within_limits),
            Data("flags", self.flags),
            Data("parts", self.parts),
            Data("singular", self.singular),
        )

    @property
    def flags(self) -> tuple[int, ...]:
        """Signs of shoulder, elbow and wrist; empty for other arms."""
        return tuple(1 if x >= 0 else -1 for x in self.parts.values())

    @property
    def singular(self) -> bool:
        """Whether the arm is singular here: one configuration of a family that reaches the pose,
        nearest to home.
        """
        return self.distance < FAMILY

    @property
    def nearest_singularity(self) -> str:
        """The part that is closest to its singularity; empty for other arms."""
        return min(self.parts, key=lambda name: abs(self.parts[name])) if self.parts else ""


@checked_types
def kinematics(
    model: str | Path | RobotModel | Equations,
    position: np.ndarray,
    rotation: np.ndarray,
    *,
    fixed: dict[str, float] | None = None,
    sag: bool = False,
) -> tuple[Configuration, ...]:
    """All configurations that bring the tool to a pose, the one closest to home first.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
        With six actuated joints, or more with ``fixed`` ones; or with as many as the outputs of a
        ``tool_position_angle``, such as a SCARA.
    position : array (3,) [m]
        Of the tool in the world.
    rotation : array (3, 3)
        Its axes as columns.
    fixed : mapping, optional
        A joint of a redundant arm that keeps a value [rad or m]. Values by joint.
    sag : bool
        The elastic robot at rest under gravity reaches the pose. Its springs are deflected; ``q``
        are the joints as the motors see them, ``eta^-1 q_m``.

    Returns
    -------
    tuple of Configuration
        Empty where the pose cannot be reached.

    Raises
    ------
    ArgumentError
        The arm has not six free joints, or the rotation is none.
    SolverError
        The arm is singular at the pose, with more than 16 solutions that have no regular
        neighbors.

    Examples
    --------
    >>> import numpy as np
    >>> found = flexgen.kinematics("manutec_r3", np.array([0.5, 0.6, 1.2]), np.eye(3))
    >>> [configuration.flags for configuration in found]  # arm, elbow, wrist
    [(1, -1, 1), (1, -1, -1), (1, 1, -1), (1, 1, 1)]
    """
    robot = robot_of(model)
    p = np.asarray(position, dtype=float)
    R = np.asarray(rotation, dtype=float)
    if p.shape != (3,) or R.shape != (3, 3) or not (np.isfinite(p).all() and np.isfinite(R).all()):
        raise ArgumentError(
            f"pose: given shapes {p.shape}, {R.shape}, expected (3,) and (3, 3), finite"
        )
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
        raise ArgumentError(
            "rotation: given a matrix that is not a rotation, expected orthogonal columns, "
            "right-handed"
        )
    if has_few_axes(robot) and not fixed:
        return _of_few_axes(robot, p, R, sag)
    names = [robot.coordinates[i].name for i in robot.i_g]
    for name in fixed or {}:
        if name not in names:
            raise ArgumentError(
                f"fixed: given joint {name!r}, expected some of {', '.join(names)}"
            )
    solver = configuration_search(robot, tuple(sorted((fixed or {}).items())))
    goal = np.concatenate([p, R.ravel()])
    home = np.array(robot.home)
    found = solver.all_at(goal, home)
    if sag:
        found = [q for q in (solver.solve_sag(goal, q) for q in found) if q is not None]
    made = [solver.configuration(goal, q, sag) for q in found]
    return tuple(sorted(made, key=lambda c: float(np.abs(c.q - home).max())))


def _of_few_axes(
    robot: RobotModel, p: np.ndarray, R: np.ndarray, sag: bool
) -> tuple[Configuration, ...]:
    """The configurations of an arm whose output is the position ``p`` of the tool and its angle,
    the nearest one to home first; ``sag`` is refused.
    """
    if sag:
        raise ArgumentError(
            f"sag: given for model {robot.name} with {robot.n_g} axes, expected an arm with six"
        )
    search = FewAxes(derive(robot))
    home = np.array(robot.home)
    made = []
    for q in search.all_at(p, R):
        distance, branch = search.distance(q)
        inside = search.within_limits(q)
        made.append(Configuration(q, search.error(q, p, R), inside, branch, distance, {}))
    return tuple(sorted(made, key=lambda c: float(np.abs(c.q - home).max())))


def configuration_at(model: RobotModel, q_g: np.ndarray) -> Configuration:
    """Known values of the joints (n_g,) [rad or m] of an arm with six actuated coordinates,
    without deflections.
    """
    solver = configuration_search(model, ())
    full = np.zeros(model.n_a)
    full[list(model.i_g)] = q_g
    p, R = solver.library.forward_kinematics(full)
    return solver.configuration(
        np.concatenate([np.asarray(p), np.asarray(R).ravel()]), np.asarray(q_g, float), False
    )


def arm_parts(J: np.ndarray) -> dict[str, float]:
    """Shoulder, elbow and wrist from the Jacobian (6, 6) of six rotations, lengths over the reach;
    see `Configuration`.

    A column (v, z): velocity of the tool and direction of the axis, whose point next to the tool
    is z x v from it.
    """
    z = J[3:].T
    c = np.cross(z, J[:3].T)
    wrist_4 = _next_to(c[3], z[3], c[4], z[4])
    wrist_5 = _next_to(c[4], z[4], c[5], z[5])
    # across the second axis
    upper = np.cross(z[1], c[2] - c[1])
    fore = np.cross(z[1], wrist_4 - c[2])
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


def _rotation_about(vector: np.ndarray) -> np.ndarray:
    """The rotation matrix of a rotation vector that is not zero."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


@lru_cache(maxsize=16)
def configuration_search(
    model: RobotModel, fixed: tuple[tuple[str, float], ...]
) -> ConfigurationSearch:
    """The search for a robot with these joints fixed [rad or m]; one for each of them."""
    return ConfigurationSearch(model, dict(fixed))


class ConfigurationSearch:
    """The search for one robot, with its memory."""

    def __init__(self, model: RobotModel, fixed: dict[str, float]) -> None:
        self.model = model
        self.i_g = list(model.i_g)
        names = [model.coordinates[i].name for i in self.i_g]
        self.free = [i for i, name in zip(self.i_g, names, strict=True) if name not in fixed]
        if len(self.free) != JOINTS:
            raise ArgumentError(
                f"model {model.name}: given {len(self.free)} free joints ({', '.join(names)}), "
                "expected six; name the joints of a redundant arm that keep a value in fixed"
            )
        self.base = np.zeros(model.n_a)
        for name, value in fixed.items():
            self.base[self.i_g[names.index(name)]] = value
        self.rotary = np.array([model.coordinates[i].unit == "rad" for i in self.free])
        self.library = library_with(
            model, ("forward_kinematics", "jacobian"), ("inverse_kinematics",)
        )
        self.length = self._reach()
        self._at = [self.i_g.index(i) for i in self.free]

    def _reach(self) -> float:
        """Half of the largest way between the pose at zero and others [m]."""
        q = np.tile(self.base, (65, 1))
        q[1:, self.free] = np.random.default_rng(0).uniform(-np.pi, np.pi, (64, JOINTS))
        p = np.asarray(self.library.forward_kinematics(q).p)
        return float(max(np.linalg.norm(p[1:] - p[0], axis=1).max(), 2e-3)) / 2

    def all_at(self, goal: np.ndarray, home: np.ndarray) -> list[np.ndarray]:
        """All solutions (n_g,), also next to singularities, where the search in C finds copies or
        nothing.

        Those of `TURNS` goals that are rotated by `TURNED` are refined at the goal itself: at the
        edge of the workspace some of them can be out of reach. With parallel axes before the wrist
        (UR) the rotation determines the place along a family, of which only an arc is in reach. Of
        a family, one remains, the nearest to ``home``.
        """
        R = goal[3:].reshape(3, 3)
        each = [
            self.solve(np.concatenate([goal[:3], (turn @ R).ravel()])) for turn in self._turns(R)
        ]
        turned = [q for found in each for q in found]
        close = [q for q in turned if self._distance(q) < NEAR]
        try:
            found = self.solve(goal)
        except SolverError:  # copies of a few configurations, in which the others are lost
            if not close:
                raise
            found = []
            close = turned
        if not close:
            return found
        out = [q for q in found if self._distance(q) >= SINGULAR]
        close += [q for q in found if self._distance(q) < SINGULAR]
        refined = [self._refine(goal, q, home) for q in close]
        for q in sorted(
            (q for q in refined if q is not None), key=lambda q: float(np.abs(q - home).max())
        ):
            if not any(self._same(goal, q, other) for other in out):
                out.append(q)
        return out

    def _turns(self, R: np.ndarray) -> list[np.ndarray]:
        """Small rotations (3, 3) about axes across the sixth axis, where the tool has the rotation
        R (3, 3).
        """
        at_zero = np.asarray(self.library.forward_kinematics(self.base).R)
        sixth = R @ at_zero.T @ self._jacobian(self.base[self.i_g])[3:, -1]
        # two directions; where the sixth joint slides, any two
        across = np.linalg.svd(sixth[None])[2][1:]
        angles = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
        return [
            _rotation_about(TURNED * (np.cos(a) * across[0] + np.sin(a) * across[1]))
            for a in angles
        ]

    def _jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian (6, free joints) at the actuated coordinates ``q`` (n_g,), lengths over the
        reach.
        """
        full = self.base.copy()
        full[self.i_g] = q
        J = np.asarray(self.library.jacobian(full))[:, self.free].copy()
        J[:3] /= self.length
        return J

    def _null(self, q: np.ndarray) -> np.ndarray:
        """The direction (n_g,) in which the pose changes least."""
        out = np.zeros(len(q))
        out[self._at] = np.linalg.svd(self._jacobian(q))[2][-1]
        return out

    def _distance(self, q: np.ndarray) -> float:
        """From singularity."""
        sizes = np.linalg.svd(self._jacobian(q), compute_uv=False)
        return float(sizes[-1] / sizes[0])

    def _same(self, goal: np.ndarray, q: np.ndarray, other: np.ndarray) -> bool:
        """Whether two configurations (n_g,) at a goal are one, but for rounding and whole turns,
        or belong to one family of solutions at a singular pose.

        ``goal`` (12,): position and rows of the orientation.
        """
        rotary = np.array([self.model.coordinates[i].unit == "rad" for i in self.i_g])
        change = np.where(rotary, (q - other + np.pi) % (2 * np.pi) - np.pi, q - other)
        if np.abs(change).max() < SAME:
            return True
        distance = max(self._distance(q), self._distance(other))
        along = np.inf if distance < FAMILY else ROUNDING / distance
        null = self._null(q)
        if along < SAME:
            return False
        k = int(np.argmax(np.abs(null)))
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):  # a straight family
            move = change[k] + turn
            left = change - null * move / null[k]
            left = np.where(rotary, (left + np.pi) % (2 * np.pi) - np.pi, left)
            if abs(move) < along and np.abs(left).max() < SAME:
                return True
        if distance >= FAMILY:
            return False
        moved = self._refine(goal, q - change, q)  # along a curved one, as near as it comes
        return moved is not None and float(np.abs(moved - q).max()) < SAME

    def _refine(self, goal: np.ndarray, q: np.ndarray, home: np.ndarray) -> np.ndarray | None:
        """A solution (n_g,) at the ``goal`` (12,) by Newton's method with the singular values of
        the Jacobian, from ``q``; None where it is not found.

        Of a family of solutions, the one nearest to ``home``.
        """
        q = q.copy()
        at = self._at
        family = False
        for k in range(REFINEMENTS):
            full = self.base.copy()
            full[self.i_g] = q
            e = self._error(goal, full)
            U, sizes, V = np.linalg.svd(self._jacobian(q))
            family = bool(sizes[-1] < FAMILY * sizes[0])
            rank = 6 - (family or k >= REFINEMENTS - POLISHED)
            step = -(V[:rank].T @ ((U.T @ e)[:rank] / sizes[:rank]))
            if family and k < REFINEMENTS // 2:
                step += V[-1] * (V[-1] @ (home[at] - q[at]))
            q[at] += step * min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-300))
            if np.abs(step).max() < 1e-13:
                break
        full = self.base.copy()
        full[self.i_g] = q
        return q if self._miss(goal, full) < (10 * FAMILY if family else REFINED) else None

    def solve(self, goal: np.ndarray) -> list[np.ndarray]:
        """All solutions (n_g,), rotations within half a turn of zero; ``goal``: position, rotation
        by rows.
        """
        try:
            q = self.library.inverse_kinematics(
                goal[:3], goal[3:].reshape(3, 3), self.base, free=self.free
            )
        except SolverError as error:
            raise SolverError(f"model {self.model.name}: {error}") from None
        return [np.asarray(x) for x in q[:, self.i_g]]

    def configuration(self, goal: np.ndarray, q: np.ndarray, sag: bool) -> Configuration:
        """A solution ``q`` (n_g,) with its error at the goal, limits, branch and distance from
        singular poses; rotations beyond a limit are moved by a turn where this helps. ``sag``: the
        error of the elastic robot at rest.
        """
        model = self.model
        full = np.zeros(model.n_a)
        full[self.i_g] = q
        J = np.asarray(self.library.jacobian(full))[:, self.free].copy()
        J[:3] /= self.length
        singular = np.linalg.svd(J, compute_uv=False)
        inside = True
        placed = q.copy()
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
        error = self._miss(goal, self._solve_deflections(placed) if sag else full)
        branch = int(np.sign(np.linalg.det(J)))
        parts = arm_parts(J) if self.rotary.all() else {}
        return Configuration(
            placed, error, inside, branch, float(singular[-1] / singular[0]), parts
        )

    def _error(self, goal: np.ndarray, full: np.ndarray) -> np.ndarray:
        """Position over the length of the arm, and the sine of the turn times its axis, (6,)."""
        p, R = self.library.forward_kinematics(full)
        E = np.asarray(R) @ goal[3:].reshape(3, 3).T
        turn = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
        return np.concatenate([(p - goal[:3]) / self.length, turn])

    def _miss(self, goal: np.ndarray, full: np.ndarray) -> float:
        """Error of the tool at arm coordinates ``full`` (n_a,) from the goal: the larger one of
        distance over the reach and angle [rad].
        """
        p, R = self.library.forward_kinematics(full)
        distance = float(np.linalg.norm(p - goal[:3])) / self.length
        return max(
            distance, float(turn_angle(np.asarray(R)[None], goal[None, 3:].reshape(1, 3, 3))[0])
        )

    # --- the elastic robot at rest ---

    def _solve_deflections(self, q: np.ndarray) -> np.ndarray:
        """Arm coordinates (n_a,) at rest under gravity with the motors at ``eta q``, by
        fixed-point steps: gravity gives deflections, these change gravity.

        Springs without motor take a Newton step with their own slope, by a difference of 1e-6. At
        most `SAG_STEPS` steps.
        """
        model = self.model
        equations = derive(self.model)
        full = np.zeros(model.n_a)
        q = gear_angles_along(model, (model.eta @ q)[None])[0] if transmission_errors(model) else q
        full[self.i_g] = q
        i_e = list(model.i_e)
        for _ in range(SAG_STEPS):
            before = full.copy()
            g = evaluate(equations.function("gravity"), full)[0].ravel()
            full[self.i_g] = q - gear_deflection(equations, g[None, self.i_g])[0]
            if i_e:
                zero = np.zeros(model.n_a)
                step = 1e-6
                tau = evaluate(equations.function("elastic_torque"), full, zero)[0].ravel()
                for k, i in enumerate(i_e):
                    moved = full.copy()
                    moved[i] += step
                    slope = (
                        evaluate(equations.function("elastic_torque"), moved, zero)[0].ravel()[k]
                        - tau[k]
                    ) / step
                    full[i] += (g[i] - tau[k]) / slope
            if np.abs(full - before).max() < 1e-14:
                break
        return full

    def solve_sag(self, goal: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """The joints (n_g,) as the motors see them, such that the elastic robot at rest is at the
        ``goal`` (12,), from a rigid solution ``q``; None where it is not found.
        """
        q = q.copy()
        at = self._at
        for _ in range(SAG_STEPS):
            full = self._solve_deflections(q)
            e = self._error(goal, full)
            if np.abs(e).max() < 1e-13:
                break
            J = np.asarray(self.library.jacobian(full))[:, self.free].copy()
            J[:3] /= self.length
            q[at] -= np.linalg.lstsq(J, e, rcond=1e-10)[0]
        return q if self._miss(goal, self._solve_deflections(q)) < 1e-10 else None
