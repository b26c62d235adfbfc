"""Own dynamics of closed loops: absolute coordinates of all bodies, and multipliers of joints and
loops.

    M a - J' lambda = f,    J a = gamma

Each joint has a frame of its own with 6 coordinates, without mass where it carries no body; each
joint adds 5 equations, each loop 3, 5 or 6; those that
follow from others are left out.
Reads the data of a model and shares no code with the package.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import least_squares


def skew(x: Any) -> np.ndarray:
    """The matrix with ``skew(x) y = x x y``."""
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def about(axis: Any, angle: float) -> np.ndarray:
    """Rotation about a unit axis."""
    K = skew(axis)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


@dataclass
class Node:
    """A moving frame: its pose, twist (linear, angular) in the world, and its bodies."""

    p: np.ndarray
    R: np.ndarray
    v: np.ndarray = field(default_factory=lambda: np.zeros(3))
    w: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bodies: list[tuple[float, np.ndarray, np.ndarray]] = field(default_factory=list)


# Columns of the two frames of a loop that are kept at a right angle.
PAIRS: dict[str, list[tuple[int, int]]] = {
    "point": [],
    "axis": [(0, 2), (1, 2)],
    "pose": [(1, 2), (2, 0), (0, 1)],
}


class Rows:
    """Constraints of accelerations between nodes: ``J a = right``, the first node at rest."""

    def __init__(self, tree: list[Node]) -> None:
        self.tree = tree
        self.rows: list[np.ndarray] = []
        self.right: list[float] = []

    def add(self, parts: dict[int, tuple[np.ndarray, np.ndarray]], value: float) -> None:
        """A row: linear and angular parts by node."""
        out = np.zeros(6 * len(self.tree))
        for k, (linear, angular) in parts.items():
            out[6 * k : 6 * k + 3] += linear
            out[6 * k + 3 : 6 * k + 6] += angular
        self.rows.append(out[6:])
        self.right.append(value)

    def coincide(self, i: int, r: np.ndarray, j: int, s: np.ndarray) -> None:
        """Points r and s of two nodes coincide."""
        one = self.tree[i]
        two = self.tree[j]
        a = one.R @ r
        b = two.R @ s
        bias = np.cross(two.w, np.cross(two.w, b)) - np.cross(one.w, np.cross(one.w, a))
        for e in np.eye(3):
            self.add({j: (e, np.cross(b, e)), i: (-e, -np.cross(a, e))}, -e @ bias)

    def hinge(self, i: int, j: int, r: np.ndarray, axis: np.ndarray) -> None:
        """Node j turns about an axis of node i through its point r."""
        one = self.tree[i]
        two = self.tree[j]
        self.coincide(i, r, j, np.zeros(3))
        for t in across(axis):
            self.add({j: (0 * t, t), i: (0 * t, -t)}, -np.cross(one.w, t) @ (two.w - one.w))

    def slide(self, i: int, j: int, r: np.ndarray, axis: np.ndarray) -> None:
        """Node j slides along an axis of node i from its point r."""
        one = self.tree[i]
        two = self.tree[j]
        for e in np.eye(3):
            self.add({j: (0 * e, e), i: (0 * e, -e)}, 0.0)
        a = one.R @ r
        d = two.p - one.p - a
        speed = two.v - one.v - np.cross(one.w, a)
        for t in across(axis):
            # t . (two.p - one.p - a) with t and a fixed in the first frame
            bias = np.cross(one.w, np.cross(one.w, t)) @ d + 2.0 * np.cross(one.w, t) @ speed
            bias -= t @ np.cross(one.w, np.cross(one.w, a))
            self.add({j: (t, 0 * t), i: (-t, np.cross(t, d) - np.cross(a, t))}, -bias)

    def keep_angle(self, i: int, x: np.ndarray, j: int, y: np.ndarray) -> None:
        """Directions x and y of two nodes stay at right angles."""
        w = self.tree[i].w
        u = self.tree[j].w
        normal = np.cross(x, y)
        dx = np.cross(w, x)
        dy = np.cross(u, y)
        bias = np.cross(w, dx) @ y + 2.0 * dx @ dy + x @ np.cross(u, dy)
        self.add({i: (0 * x, normal), j: (0 * x, -normal)}, -bias)


def across(axis: np.ndarray) -> np.ndarray:
    """Two directions at right angles to an axis."""
    out: np.ndarray = np.linalg.svd(axis[None, :])[2][1:]
    return out


def tension(line: Any, length: float) -> float:
    """Tension of a spring, rod or gas spring at rest."""
    if not hasattr(line, "pressure"):
        return float(getattr(line, "preload", 0.0) + line.stiffness * (length - line.length))
    outwards = 1.0 if line.acts == "push" else -1.0
    volume = line.volume + outwards * line.area * (length - line.length)
    pressure = line.pressure * np.exp(line.exponent * np.log(line.volume / volume))
    return float(-outwards * line.area * (pressure - line.ambient_pressure))


class Multipliers:
    """A robot with rigid or elastic gears, linear springs and closed loops."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self.names = [c.name for c in model.coordinates]
        dofs = [dof for element in model.elements for dof in element.dofs]
        self.axes: dict[str, np.ndarray] = {}
        self.passive = [dof.name for dof in dofs if dof.passive is not None]
        self.dofs = {dof.name: dof for dof in dofs}

    def nodes(self, q: dict[str, float], v: dict[str, float]) -> None:
        """Frames of all joints at joint positions and speeds, by walking the tree."""
        self.tree: list[Node] = [Node(np.zeros(3), np.eye(3))]
        self.joints: list[tuple[Any, int, int, np.ndarray]] = []
        base = self.model.base
        places = {"base": (0, np.array(base.position), np.array(base.rotation))}
        bodies = {"base": places["base"]}
        for element in self.model.elements:
            k, r, C = places[self.model.parents[element.name]]
            r = r + C @ np.array(element.origin.position)
            C = C @ np.array(element.origin.rotation)
            for dof in element.dofs:
                before = self.tree[k]
                axis = before.R @ C @ np.array(dof.axis)
                p = before.p + before.R @ r
                R = before.R @ C
                w = before.w
                speed = before.v + np.cross(before.w, before.R @ r)
                if dof.type == "rotation":
                    R = R @ about(dof.axis, q[dof.name])
                    w = w + axis * v[dof.name]
                else:
                    p = p + axis * q[dof.name]
                    speed = speed + np.cross(before.w, axis * q[dof.name]) + axis * v[dof.name]
                self.tree.append(Node(p, R, speed, w))
                self.joints.append((dof, k, len(self.tree) - 1, r))
                self.axes[dof.name] = axis
                k = len(self.tree) - 1
                r = np.zeros(3)
                C = np.eye(3)
            r = r + C @ np.array(element.link.position)
            C = C @ np.array(element.link.rotation)
            places[element.name] = bodies[element.name] = (k, r, C)
            self.add(k, r, C, element.body)
        self.places = places
        self.bodies = bodies
        self.add(*places[self.model.tip], self.model.payload)

    def add(self, k: int, r: np.ndarray, C: np.ndarray, body: Any) -> None:
        """A body at a frame: mass, center, tensor in its axes."""
        com = r + C @ np.array(body.com)
        self.tree[k].bodies.append((body.mass, com, C @ np.array(body.inertia) @ C.T))

    def tool(self) -> np.ndarray:
        """Position of the tool."""
        k, r, C = self.places[self.model.tip]
        node = self.tree[k]
        return node.p + node.R @ (r + C @ np.array(self.model.tool.position))

    def ends(self, loop: Any) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Node, offset and rotation of the two frames of a loop."""
        out = []
        for frame in (loop.start, loop.end):
            k, r, C = self.places[frame.element]
            out.append((k, r + C @ np.array(frame.position), C @ np.array(frame.rotation)))
        return out

    def errors(self) -> np.ndarray:
        """Errors of all loops."""
        out: list[float] = []
        for loop in self.model.loops:
            (i, r, A), (j, s, B) = self.ends(loop)
            one = self.tree[i]
            two = self.tree[j]
            out += list(two.p + two.R @ s - one.p - one.R @ r)
            out += self.tilts(loop.type, (one.R @ A).T @ two.R @ B)
        return np.array(out)

    @staticmethod
    def tilts(kind: str, E: np.ndarray) -> list[float]:
        """Entries of a rotation matrix that a loop keeps at zero."""
        if kind == "axis":
            return [E[0, 2], E[1, 2]]
        if kind == "pose":
            return [E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]
        return []

    def close(self, q_a: np.ndarray, start: np.ndarray) -> dict[str, float]:
        """Positions of all joints, the passive ones near ``start``."""
        q = dict(zip(self.names, q_a, strict=True))
        still = dict.fromkeys(self.dofs, 0.0)

        def error(x: np.ndarray) -> np.ndarray:
            self.nodes(q | dict(zip(self.passive, x, strict=True)), still)
            return self.errors()

        found = least_squares(error, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        for _ in range(2):  # to rounding
            steps = 1e-6 * np.eye(len(found))
            J = np.array([(error(found + h) - error(found - h)) / 2e-6 for h in steps]).T
            found = found - np.linalg.lstsq(J, error(found), rcond=None)[0]
        return q | dict(zip(self.passive, found, strict=True))

    def constraints(self) -> tuple[np.ndarray, np.ndarray]:
        """``J`` and ``gamma`` of the accelerations of all nodes but the first."""
        rows = Rows(self.tree)
        for dof, i, j, r in self.joints:
            if dof.type == "rotation":
                rows.hinge(i, j, r, self.axes[dof.name])
            else:
                rows.slide(i, j, r, self.axes[dof.name])
        for loop in self.model.loops:
            (i, r, A), (j, s, B) = self.ends(loop)
            rows.coincide(i, r, j, s)
            U = self.tree[i].R @ A
            V = self.tree[j].R @ B
            for k, m in PAIRS[loop.type]:
                rows.keep_angle(i, U[:, k], j, V[:, m])
        return np.array(rows.rows), np.array(rows.right)

    def accelerations(
        self, q: dict[str, float], v_a: np.ndarray, forces: dict[str, float]
    ) -> dict[str, float]:
        """Accelerations of all joints under ``forces`` along the joints, loops closed at q."""
        still = dict.fromkeys(self.dofs, 0.0)
        speeds = self.speeds(q, v_a)
        self.nodes(q, still | speeds)
        n = len(self.tree) - 1
        M = np.zeros((6 * n, 6 * n))
        f = np.zeros(6 * n)
        g = np.array(self.model.gravity)
        for k, node in enumerate(self.tree[1:]):
            at = slice(6 * k, 6 * k + 6)
            for mass, com, tensor in node.bodies:
                c = node.R @ com
                inertia = node.R @ tensor @ node.R.T
                P = np.hstack([np.eye(3), -skew(c)])
                M[at, at] += mass * P.T @ P
                M[at, at][3:, 3:] += inertia
                f[at] += P.T @ (mass * (g - np.cross(node.w, np.cross(node.w, c))))
                f[at][3:] -= np.cross(node.w, inertia @ node.w)
        for line in self.model.lines:
            self.add_line(line, M, f)
        for dof, i, j, _ in self.joints:
            x = np.zeros(6 * (n + 1))
            axis = self.axes[dof.name]
            if dof.type == "rotation":
                x[6 * j + 3 : 6 * j + 6] = axis
                x[6 * i + 3 : 6 * i + 6] = -axis
            else:
                lever = self.tree[j].p - self.tree[i].p
                x[6 * j : 6 * j + 3] = axis
                x[6 * i : 6 * i + 3] = -axis
                x[6 * i + 3 : 6 * i + 6] = -np.cross(lever, axis)
            f += forces.get(dof.name, 0.0) * x[6:]
        J, gamma = self.constraints()
        # rows that others imply are left out
        U, s, V = np.linalg.svd(J, full_matrices=False)
        kept = s > 1e-9 * s[0]
        gamma = (U[:, kept].T @ gamma) / s[kept]
        J = V[kept]
        K = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
        a = np.linalg.solve(K, np.concatenate([f, gamma]))[: 6 * n].reshape(n, 6)
        return self.joint_accelerations(np.vstack([np.zeros(6), a]))

    def add_line(self, line: Any, M: np.ndarray, f: np.ndarray) -> None:
        """Mass and tension of a rod or spring with the velocities of its ends, linear in between:
        m/3, m/6, m/3, half of the weight at each end.
        """
        ends = []
        for end in (line.start, line.end):
            k, r, C = self.bodies[end.element]
            node = self.tree[k]
            c = node.R @ (r + C @ np.array(end.position))
            P = np.zeros((3, 6 * len(self.tree)))
            P[:, 6 * k : 6 * k + 6] = np.hstack([np.eye(3), -skew(c)])
            bias = np.cross(node.w, np.cross(node.w, c))
            ends.append((P[:, 6:], bias, node.p + c))
        (P1, b1, p1), (P2, b2, p2) = ends
        m = line.mass
        M += m / 6.0 * (2.0 * P1.T @ P1 + P1.T @ P2 + P2.T @ P1 + 2.0 * P2.T @ P2)
        f -= m / 6.0 * (P1.T @ (2.0 * b1 + b2) + P2.T @ (b1 + 2.0 * b2))
        f += m / 2.0 * (P1 + P2).T @ np.array(self.model.gravity)
        length = np.linalg.norm(p2 - p1)
        along = (P1 - P2).T @ ((p2 - p1) / length)
        velocities = np.concatenate([[*node.v, *node.w] for node in self.tree[1:]])
        f += (tension(line, float(length)) - line.damping * along @ velocities) * along

    def joint_accelerations(self, a: np.ndarray) -> dict[str, float]:
        """Relative accelerations along the joints from those of the nodes."""
        out = {}
        for dof, i, j, r in self.joints:
            one = self.tree[i]
            two = self.tree[j]
            axis = self.axes[dof.name]
            if dof.type == "rotation":
                out[dof.name] = axis @ (a[j, 3:] - a[i, 3:])
                continue
            arm = one.R @ r
            d = two.p - one.p - arm
            moved = a[j, :3] - a[i, :3] - np.cross(a[i, 3:], arm)
            moved -= np.cross(one.w, np.cross(one.w, arm))
            speed = two.v - one.v - np.cross(one.w, arm)
            relative = moved - np.cross(a[i, 3:], d) - np.cross(one.w, np.cross(one.w, d))
            relative -= 2.0 * np.cross(one.w, speed - np.cross(one.w, d))
            out[dof.name] = axis @ relative
        return out

    def speeds(self, q: dict[str, float], v_a: np.ndarray) -> dict[str, float]:
        """Speeds of all joints where the loops stay closed."""
        known = dict(zip(self.names, v_a, strict=True))
        if not self.passive:
            return known

        def rate(v: dict[str, float]) -> np.ndarray:
            self.nodes(q, v)
            out: list[float] = []
            for loop in self.model.loops:
                (i, r, A), (j, s, B) = self.ends(loop)
                one = self.tree[i]
                two = self.tree[j]
                out += list(
                    two.v + np.cross(two.w, two.R @ s) - one.v - np.cross(one.w, one.R @ r)
                )
                dE = (one.R @ A).T @ skew(two.w - one.w) @ two.R @ B
                out += self.tilts(loop.type, dE)
            return np.array(out)

        zero = dict.fromkeys(self.dofs, 0.0)
        A = np.array([rate(zero | {name: 1.0}) for name in self.passive]).T
        b = rate(zero | known)
        return known | dict(zip(self.passive, -np.linalg.lstsq(A, b, rcond=None)[0], strict=True))

    def motion(
        self, q: dict[str, float], v_a: np.ndarray, q_m: Any, v_m: Any, tau_m: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations of the coordinates and of the motors, all behind elastic gears with linear
        springs and one joint each.
        """
        model = self.model
        forces = {}
        gear_torques = {}
        for j, motor in enumerate(model.motors):
            name = motor.drives[0]
            ratio = motor.ratio[0]
            gear = self.dofs[name].gear
            own = dict(zip(self.names, v_a, strict=True))[name]
            torque = gear.spring.stiffness * (q_m[j] / ratio - q[name])
            torque += gear.damping * (v_m[j] / ratio - own)
            forces[name] = torque
            gear_torques[j] = torque / ratio
        for name, speed in zip(self.names, v_a, strict=True):
            dof = self.dofs[name]
            if dof.spring is not None:
                forces[name] = -dof.spring.stiffness * q[name] - dof.damping * speed
        a = self.accelerations(q, v_a, forces)
        a_m = [(tau_m[j] - gear_torques[j]) / m.inertia for j, m in enumerate(model.motors)]
        return np.array([a[name] for name in self.names]), np.array(a_m)
