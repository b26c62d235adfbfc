"""An outside referee: the same machine in Pinocchio, built joint by joint.

The arm alone answers for the functions of ``q_a``. The whole machine has a joint more for each
rotor: on the world (simplified coupling) or on the body that carries it (complete). A rotor behind
a rigid gear of one joint is that joint's armature instead; where it is carried or coupled, its
joint is tied to those it follows by the projection ``(q_a, q_m) = P y``. Springs, dampers,
frictions and drags are assembled here, in numpy, from the laws of `referee`; their slopes only
where all of them are linear. Pinocchio knows no beams.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from referee import Referee, friction_torque, spring_torque

from flexgen.model.elements import Body, LinearSpring, Placement, RobotModel

WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def se3(placement: Placement) -> pin.SE3:
    """A placement as Pinocchio writes it."""
    return pin.SE3(np.array(placement.rotation), np.array(placement.position))


def inertia(body: Body) -> pin.Inertia:
    """A body's spatial inertia."""
    return pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))


def spin_inertia(moment: float, axis) -> pin.Inertia:
    """The inertia of what only turns about an axis."""
    return pin.Inertia(0.0, np.zeros(3), moment * np.outer(axis, axis))


class Tree:
    """A Pinocchio model of the chain, with a joint for each of some rotors, a locked one for each
    of some others.

    ``at``: index among Pinocchio's velocities of each arm coordinate, then of each of those
    rotors.
    """

    def __init__(
        self, model: RobotModel, rotors: tuple[int, ...] = (), locked: tuple[int, ...] = ()
    ):
        self.model = m = pin.Model()
        m.gravity = pin.Motion(np.array(model.gravity), np.zeros(3))
        m.armature = np.zeros(0)
        self._robot = model
        self._rotors = rotors
        self._locked = locked
        self._joint: dict[str, int] = {}
        self._drags: list[tuple[int, float]] = []
        joint = 0
        place = se3(model.base)
        self._carry("base", joint, place)
        for element in model.elements:
            place = place * se3(element.origin)
            for dof in element.dofs:
                kind = (
                    pin.JointModelRevoluteUnaligned
                    if dof.type == "rotation"
                    else pin.JointModelPrismaticUnaligned
                )
                joint = m.addJoint(joint, kind(np.array(dof.axis)), place, dof.name)
                self._joint[dof.name] = joint
                place = pin.SE3.Identity()
            place = place * se3(element.link)
            self._load(element.name, joint, place, element.body)
            self._carry(element.name, joint, place)
        self._load("payload", joint, place, model.payload)
        self.tool = m.addFrame(
            pin.Frame("tool", joint, 0, place * se3(model.tool), pin.FrameType.OP_FRAME)
        )
        if model.motor_coupling != "complete":
            for j in rotors:
                self._turn(j, 0, pin.SE3.Identity(), np.array([0.0, 0.0, 1.0]))
        names = [c.name for c in model.coordinates] + [
            f"rotor {model.motors[j].name}" for j in rotors
        ]
        self.at = np.array([m.idx_vs[self._joint[name]] for name in names], dtype=int)
        m.armature = np.zeros(m.nv)
        self.data = m.createData()

    def _load(self, name: str, joint: int, place: pin.SE3, body: Body) -> None:
        self.model.appendBodyToJoint(joint, inertia(body), place)
        frame = self.model.addFrame(pin.Frame(f"body {name}", joint, 0, place, pin.FrameType.BODY))
        if body.rotational_drag:
            self._drags.append((frame, body.rotational_drag))

    def _carry(self, carrier: str, joint: int, place: pin.SE3) -> None:
        if self._robot.motor_coupling != "complete":
            return
        for j, motor in enumerate(self._robot.motors):
            if motor.carrier == carrier and j in self._rotors:
                self._turn(j, joint, place, np.array(motor.axis))
            elif motor.carrier == carrier and j in self._locked:
                self.model.appendBodyToJoint(joint, spin_inertia(motor.inertia, motor.axis), place)

    def _turn(self, j: int, parent: int, place: pin.SE3, axis: np.ndarray) -> None:
        motor = self._robot.motors[j]
        name = f"rotor {motor.name}"
        self._joint[name] = self.model.addJoint(
            parent, pin.JointModelRevoluteUnaligned(axis), place, name
        )
        self.model.appendBodyToJoint(
            self._joint[name], spin_inertia(motor.inertia, axis), pin.SE3.Identity()
        )

    def set_armature(self, k: int, moment: float) -> None:
        """Add to the armature of arm coordinate k."""
        self.model.armature[self.at[k]] += moment

    def _in(self, *vectors) -> list[np.ndarray]:
        out = []
        for x in vectors:
            y = np.zeros(self.model.nv)
            y[self.at] = x
            out.append(y)
        return out

    def _block(self, matrix: np.ndarray) -> np.ndarray:
        return self._square(matrix)[np.ix_(self.at, self.at)]

    def _square(self, matrix: np.ndarray) -> np.ndarray:
        return np.reshape(matrix, (self.model.nv, self.model.nv))  # one by one comes flat

    def _whole(self, matrix: np.ndarray) -> np.ndarray:
        upper = np.triu(self._square(matrix))  # the other half is not promised
        return upper + np.triu(upper, 1).T

    def _columns(self, matrix: np.ndarray) -> np.ndarray:
        return np.reshape(matrix, (6, self.model.nv))[:, self.at]

    # the answers ---------------------------------------------------------------------------------

    def pose(self, q):
        """Position and rotation of the tool."""
        pin.framesForwardKinematics(self.model, self.data, *self._in(q))
        place = self.data.oMf[self.tool]
        return place.translation.copy(), place.rotation.copy()

    def jacobian(self, q):
        """Velocity and angular velocity of the tool over the speeds."""
        return self._columns(
            pin.computeFrameJacobian(self.model, self.data, *self._in(q), self.tool, WORLD)
        )

    def jacobian_dot(self, q, v):
        """The rate of the Jacobian."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, *self._in(q, v))
        pin.updateFramePlacements(self.model, self.data)
        return self._columns(
            pin.getFrameJacobianTimeVariation(self.model, self.data, self.tool, WORLD)
        )

    def mass_matrix(self, q):
        """Composite rigid body algorithm."""
        return self._block(self._whole(pin.crba(self.model, self.data, *self._in(q))))

    def inverse_dynamics(self, q, v, a):
        """Recursive Newton-Euler algorithm."""
        return pin.rnea(self.model, self.data, *self._in(q, v, a))[self.at].copy()

    def accelerations(self, q, v, tau):
        """Articulated body algorithm."""
        return pin.aba(self.model, self.data, *self._in(q, v, tau))[self.at].copy()

    def inverse_derivatives(self, q, v, a):
        """Slopes of the inverse dynamics over q and over v."""
        pin.computeRNEADerivatives(self.model, self.data, *self._in(q, v, a))
        return self._block(self.data.dtau_dq), self._block(self.data.dtau_dv)

    def acceleration_derivatives(self, q, v, tau):
        """Slopes of the accelerations over q, over v and over the forces."""
        pin.computeABADerivatives(self.model, self.data, *self._in(q, v, tau))
        return (
            self._block(self.data.ddq_dq),
            self._block(self.data.ddq_dv),
            self._block(self._whole(self.data.Minv)),
        )

    def energies(self, q, v):
        """Kinetic and potential energy; Pinocchio leaves out what stands on the ground."""
        q, v = self._in(q, v)
        kinetic = pin.computeKineticEnergy(self.model, self.data, q, v)
        ground = self.model.inertias[0]
        standing = -ground.mass * self.model.gravity.linear @ ground.lever
        return kinetic, pin.computePotentialEnergy(self.model, self.data, q) + standing

    def drag(self, q, v):
        """Generalised forces of the bodies' drags."""
        out = np.zeros(len(self.at))
        for frame, drag in self._drags:
            turning = self._columns(
                pin.computeFrameJacobian(self.model, self.data, *self._in(q), frame, WORLD)
            )[3:]
            out += drag * turning.T @ (turning @ v)
        return out


class PinocchioReferee:
    """Pinocchio's answers for one model without beams."""

    def __init__(self, model: RobotModel):
        if any(element.beam is not None for element in model.elements):
            raise ValueError("Pinocchio has no assumed-modes beam")
        self.model = model
        self.arm = Tree(model, locked=tuple(range(model.n_m)))
        every = tuple(range(model.n_m))
        armature = [
            j
            for j in every
            if model.motor_coupling != "complete"
            and j not in model.i_m
            and len(model.motors[j].drives) == 1
        ]
        self.rotors = tuple(j for j in every if j not in armature)
        self.machine = Tree(model, self.rotors)
        for j in armature:
            k = int(np.flatnonzero(model.eta[j])[0])
            self.machine.set_armature(model.i_g[k], model.motors[j].inertia * model.eta[j, k] ** 2)
        # from y = (q_a, q_me) to all arm coordinates and motors, and to the joints of the machine
        self.all = np.zeros((model.n_a + model.n_m, model.dof))
        self.all[: model.n_a, : model.n_a] = np.eye(model.n_a)
        for j in every:
            row = self.all[model.n_a + j]
            if j in model.i_m:
                row[model.n_a + model.i_m.index(j)] = 1.0
            else:
                row[list(model.i_g)] = model.eta[j]
        self.P = self.all[[*range(model.n_a), *(model.n_a + j for j in self.rotors)]]
        self.free = self.P.shape[0] == self.P.shape[1]
        self.whole = Tree(model, every)
        self._laws = Referee(model)

    # arm -----------------------------------------------------------------------------------------

    def forward_kinematics(self, q_a):
        """Position and rotation of the tool."""
        return self.arm.pose(q_a)

    def jacobian(self, q_a):
        """Jacobian of the tool in world axes, linear rows first."""
        return self.arm.jacobian(q_a)

    def jacobian_dot(self, q_a, v_a):
        """Its rate."""
        return self.arm.jacobian_dot(q_a, v_a)

    def mass_matrix(self, q_a):
        """Arm inertia."""
        return self.arm.mass_matrix(q_a)

    def inverse_dynamics(self, q_a, v_a, a_a):
        """Generalised forces of the arm's bodies."""
        return self.arm.inverse_dynamics(q_a, v_a, a_a)

    def bias(self, q_a, v_a):
        """Generalised forces at zero accelerations."""
        return self.arm.inverse_dynamics(q_a, v_a, 0 * v_a)

    def gravity(self, q_a):
        """Generalised forces at rest."""
        return self.arm.inverse_dynamics(q_a, 0 * q_a, 0 * q_a)

    def inverse_derivatives(self, q_a, v_a, a_a):
        """Slopes of the inverse dynamics of the arm over q_a and v_a."""
        return self.arm.inverse_derivatives(q_a, v_a, a_a)

    def rotor_torque(self, q_a, v_a, a_a, v_m, a_m):
        """Rates of the rotors' axial momenta, every motor with the speed and acceleration
        given.
        """
        q = np.concatenate([q_a, 0 * v_m])
        v = np.concatenate([v_a, v_m])
        a = np.concatenate([a_a, a_m])
        return self.whole.inverse_dynamics(q, v, a)[self.model.n_a :]

    # machine -------------------------------------------------------------------------------------

    def minimal(self, of_arm, of_motors):
        """y of arm and motor quantities."""
        return np.concatenate([of_arm, np.asarray(of_motors)[list(self.model.i_m)]])

    def forces(self, q_a, v_a, q_m, v_m, tau_m):
        """Springs, dampers, frictions, drags and motors as generalised forces on y."""
        model = self.model
        n_a = self.model.n_a
        x = self.all @ self.minimal(q_a, q_m)
        dx = self.all @ self.minimal(v_a, v_m)
        out = np.zeros(n_a + model.n_m)
        out[:n_a] -= self.arm.drag(q_a, v_a)
        for i, coordinate in enumerate(model.coordinates):
            dof = coordinate.dof
            out[i] -= friction_torque(dof.friction, v_a[i])
            if dof.spring is not None:
                out[i] -= spring_torque(dof.spring, q_a[i]) + dof.damping * v_a[i]
        gear = self._laws.gear_torque(q_a, v_a, x[n_a:], dx[n_a:])
        out[list(model.i_g)] += gear
        out[n_a:] -= np.linalg.solve(model.eta.T, gear)
        out[n_a:] += tau_m - [
            friction_torque(m.friction, w) for m, w in zip(model.motors, dx[n_a:], strict=True)
        ]
        return self.all.T @ out

    def forward_dynamics(self, q_a, v_a, q_m, v_m, tau_m):
        """Accelerations (a_a, a_m) of the full model, all of a_m."""
        y = self.minimal(q_a, q_m)
        dy = self.minimal(v_a, v_m)
        force = self.forces(q_a, v_a, q_m, v_m, tau_m)
        q = self.P @ y
        v = self.P @ dy
        if self.free:
            ddy = self.machine.accelerations(q, v, force)
        else:
            rest = self.P.T @ self.machine.inverse_dynamics(q, v, 0 * v)
            ddy = np.linalg.solve(self.machine_mass(q_a), force - rest)
        a = self.all @ ddy
        return a[: self.model.n_a], a[self.model.n_a :]

    def machine_mass(self, q_a):
        """Mass matrix of y."""
        y = np.zeros(self.model.dof)
        y[: self.model.n_a] = q_a
        return self.P.T @ self.machine.mass_matrix(self.P @ y) @ self.P

    def linear_laws(self):
        """The linear springs, dampers and frictions: (row, stiffness, damping),
        ``row @ (q_a, q_m)`` is the strain.
        """
        model = self.model
        n_a = self.model.n_a
        rows = np.eye(n_a + model.n_m)
        inverse = np.linalg.inv(model.eta)
        out = []
        for i, coordinate in enumerate(model.coordinates):
            dof = coordinate.dof
            out.append((rows[i], 0.0, dof.friction.viscous))
            if dof.spring is not None:
                assert isinstance(dof.spring, LinearSpring)
                out.append((rows[i], dof.spring.stiffness, dof.damping))
            elif not dof.gear.rigid:
                assert isinstance(dof.gear.spring, LinearSpring)
                twist = np.concatenate([-rows[i, :n_a], inverse[model.i_g.index(i)]])
                if dof.gear.side == "motor":
                    twist *= next(m.ratio[0] for m in model.motors if m.drives == (dof.name,))
                out.append((twist, dof.gear.spring.stiffness, dof.gear.damping))
        out += [
            (rows[n_a + j], 0.0, motor.friction.viscous) for j, motor in enumerate(model.motors)
        ]
        return out

    def linear_matrices(self):
        """Their stiffness and damping on y."""
        K = sum(k * np.outer(row, row) for row, k, _ in self.linear_laws())
        D = sum(d * np.outer(row, row) for row, _, d in self.linear_laws())
        return self.all.T @ K @ self.all, self.all.T @ D @ self.all

    def motor_columns(self):
        """Generalised forces on y of unit motor torques."""
        return self.all[self.model.n_a :].T

    def energies(self, q_a, v_a, q_m, v_m):
        """Kinetic and potential energy of a machine whose laws are all linear."""
        y = self.minimal(q_a, q_m)
        dy = self.minimal(v_a, v_m)
        kinetic, potential = self.whole.energies(self.all @ y, self.all @ dy)
        return kinetic, potential + sum(
            k * (row @ self.all @ y) ** 2 / 2 for row, k, _ in self.linear_laws()
        )

    def second_order(self, q_a, v_a, a_a, q_m, v_m, a_m):
        """M, D, K, B of a machine whose laws are all linear."""
        y = self.minimal(q_a, q_m)
        dy = self.minimal(v_a, v_m)
        ddy = self.minimal(a_a, a_m)
        K, D = self.linear_matrices()
        slopes = self.machine.inverse_derivatives(self.P @ y, self.P @ dy, self.P @ ddy)
        dq, dv = (self.P.T @ slope @ self.P for slope in slopes)
        return self.machine_mass(q_a), D + dv, K + dq, self.motor_columns()

    def linearize(self, q_a, v_a, q_m, v_m, tau_m):
        """A, B of a machine whose laws are all linear; None where a projection stands in the way
        of the algorithm.
        """
        if not self.free:
            return None
        y = self.minimal(q_a, q_m)
        dy = self.minimal(v_a, v_m)
        force = self.forces(q_a, v_a, q_m, v_m, tau_m)
        dq, dv, inverse = self.machine.acceleration_derivatives(self.P @ y, self.P @ dy, force)
        K, D = self.linear_matrices()
        n = self.model.dof
        lower = np.hstack([dq - inverse @ K, dv - inverse @ D])
        A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower])
        return A, np.vstack([np.zeros((n, self.model.n_m)), inverse @ self.motor_columns()])
