"""An outside referee: the same machine in MuJoCo, rotors included.

Every element becomes a MuJoCo body at ``origin`` with the element's degrees of freedom as joints
in their order; the body's centre and principal axes are placed through ``link``. Massless bodies,
point masses and regrouped inertias are refused by MuJoCo's compiler, not by its dynamics: the
model is compiled with unit masses and inertias, and the true ones are written into the compiled
model. A rotor is a massless body on a hinge with an axial inertia only; it hangs on its carrier
(complete coupling) or on the world (simplified). It knows no beams.

`MujocoReferee` leaves springs, frictions and gears outside and answers for the rigid-body part
alone. `MujocoMachine` has them: elastic gears are fixed tendons between rotors and joints, the
other springs and the viscous frictions those of the joints. Rigid gears are not soft constraints
there but the projection ``(q_a, q_m) = P y``.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from flexgen.model.elements import Body, Dof, Element, LinearSpring, Motor, RobotModel

NO_BEAMS = "MuJoCo has no assumed-modes beam"


def text(values) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(x)) for x in np.ravel(values))


def quaternion(rotation: np.ndarray) -> str:
    """A rotation matrix as MuJoCo's (w, x, y, z)."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return text([w, x, y, z])


class MujocoReferee:
    """MuJoCo's mass matrix, bias forces and inverse dynamics in the coordinates (q_a, q_m) of a
    model without beams.
    """

    def __init__(self, model: RobotModel, rotors: bool = True):
        if any(element.beam is not None for element in model.elements):
            raise ValueError(NO_BEAMS)
        self.model = model
        self._rotors = rotors
        self._masses: dict[str, tuple[float, np.ndarray]] = {}
        standing = range(model.n_m) if rotors and model.motor_coupling != "complete" else ()
        world = "".join(self._rotor(j) for j in standing)
        xml = f"""
        <mujoco>
          <compiler angle="radian" inertiafromgeom="false" fusestatic="false"/>
          <option gravity="{text(model.gravity)}"/>
          <worldbody>{world}
            <body name="base" pos="{text(model.base.position)}" \
quat="{quaternion(np.array(model.base.rotation))}">
              \
{self._inertial("base", Body(), np.zeros(3), np.eye(3))}\
{self._carried("base", np.zeros(3), np.eye(3))}
              {self._children("base", np.zeros(3), np.eye(3))}
            </body>
          </worldbody>
          {self._tendons()}
        </mujoco>"""
        self.m = mujoco.MjModel.from_xml_string(xml)
        self.d = mujoco.MjData(self.m)
        for name, (mass, moments) in self._masses.items():
            k = self.m.body(name).id
            self.m.body_mass[k] = mass
            self.m.body_inertia[k] = moments
        names = [c.name for c in model.coordinates] + [
            f"rotor {m.name}" for m in model.motors if rotors
        ]
        joints = [self.m.joint(name).id for name in names]
        self.at_q = self.m.jnt_qposadr[joints]
        self.at_v = self.m.jnt_dofadr[joints]
        # a rotor without inertia would make the matrix singular that MuJoCo factorises: its
        # armature is taken out again
        for j, motor in enumerate(model.motors if rotors else ()):
            self.m.dof_armature[self.at_v[model.n_a + j]] = 0.0 if motor.inertia else 1.0
        mujoco.mj_setConst(self.m, self.d)
        # the compiler takes frames for the same that are tilted by up to some 1e-7 rad, and drops
        # the tilt
        self.m.body_sameframe[:] = 0
        self.m.site_sameframe[:] = 0
        assert self.m.nv == len(names)

    # the description -----------------------------------------------------------------------------

    def _inertial(self, name: str, body: Body, position: np.ndarray, rotation: np.ndarray) -> str:
        moments, axes = np.linalg.eigh(np.array(body.inertia))
        axes = axes * np.linalg.det(axes)
        self._masses[name] = (body.mass, moments)
        centre = position + rotation @ np.array(body.com)
        return (
            f'<inertial mass="1" diaginertia="1 1 1" pos="{text(centre)}" '
            f'quat="{quaternion(rotation @ axes)}"/>'
        )

    def _rotor(self, j: int, position=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)) -> str:
        motor = self.model.motors[j]
        axis = np.asarray(axis)
        x = np.linalg.svd(axis[None])[2][1]
        frame = np.column_stack([x, np.cross(axis, x), axis])
        name = f"rotor {motor.name}"
        self._masses[name] = (0.0, np.array([0.0, 0.0, motor.inertia]))
        joint = (
            f'<joint name="{name}" type="hinge" axis="0 0 1"{self._rub(motor)}/>'
            if self._rotors
            else ""
        )
        return (
            f'<body name="{name}" pos="{text(position)}" quat="{quaternion(frame)}">{joint}'
            '<inertial mass="1" diaginertia="1 1 1" pos="0 0 0"/></body>'
        )

    def _carried(self, carrier: str, position: np.ndarray, rotation: np.ndarray) -> str:
        if self.model.motor_coupling != "complete":
            return ""
        carried = [j for j, motor in enumerate(self.model.motors) if motor.carrier == carrier]
        return "".join(
            self._rotor(j, position, rotation @ np.array(self.model.motors[j].axis))
            for j in carried
        )

    def _children(self, name: str, position: np.ndarray, rotation: np.ndarray) -> str:
        """Bodies that an element carries; its tip is at this place in its MuJoCo body."""
        model = self.model
        out = ""
        if name == model.tip:
            payload = self._inertial("payload", model.payload, np.zeros(3), np.eye(3))
            tool = model.tool
            site = (
                f'<site name="tool" pos="{text(tool.position)}" '
                f'quat="{quaternion(np.array(tool.rotation))}"/>'
            )
            out = (
                f'<body name="payload" pos="{text(position)}" '
                f'quat="{quaternion(rotation)}">{payload}{site}</body>'
            )
        before = ["base", *(element.name for element in model.elements)]
        for k, element in enumerate(model.elements):
            if (element.parent or before[k]) == name:
                out += self._element(element, position, rotation)
        return out

    def _element(self, element: Element, position: np.ndarray, rotation: np.ndarray) -> str:
        """An element and what it carries; the tip of its parent stands at this place in the
        parent's MuJoCo body.
        """
        place = position + rotation @ np.array(element.origin.position)
        turn = rotation @ np.array(element.origin.rotation)
        types = {"rotation": "hinge", "translation": "slide"}
        joints = "".join(
            (
                f'<joint name="{dof.name}" type="{types[dof.type]}" '
                f'axis="{text(dof.axis)}"{self._rub(dof)}/>'
            )
            for dof in element.dofs
        )
        link = np.array(element.link.position), np.array(element.link.rotation)
        return (
            f'<body name="{element.name}" pos="{text(place)}" quat="{quaternion(turn)}">{joints}'
            f"{self._inertial(element.name, element.body, *link)}"
            f"{self._carried(element.name, *link)}"
            f"{self._children(element.name, *link)}</body>"
        )

    def _rub(self, moved: Dof | Motor) -> str:
        """Friction and damping of a single joint of MuJoCo, as attributes."""
        return ""

    def _tendons(self) -> str:
        """Coupling between joints, as tendons."""
        return ""

    # the answers ---------------------------------------------------------------------------------

    def set_state(self, q, v) -> None:
        """Take coordinates and speeds in the order of MuJoCo's joints; forces follow."""
        self.d.qpos[self.at_q] = q
        self.d.qvel[self.at_v] = v
        mujoco.mj_forward(self.m, self.d)

    def tool(self, q):
        """Position and rotation of the tool."""
        self.set_state(q, np.zeros_like(self.at_v))
        site = self.d.site("tool")
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def mass_matrix(self, q):
        """Inertia matrix."""
        self.set_state(q, np.zeros(len(self.at_v)))
        out = np.zeros((self.m.nv, self.m.nv))
        mujoco.mj_fullM(self.m, self.d, out)
        return (out - np.diag(self.m.dof_armature))[np.ix_(self.at_v, self.at_v)]

    def bias(self, q, v):
        """Centripetal, gyroscopic and gravity forces."""
        self.set_state(q, v)
        return self.d.qfrc_bias[self.at_v].copy()

    def inverse_dynamics(self, q, v, a):
        """Generalised forces for the accelerations a."""
        self.set_state(q, v)
        self.d.qacc[self.at_v] = a
        out = np.zeros(self.m.nv)
        mujoco.mj_rne(self.m, self.d, 1, out)
        return out[self.at_v]


class MujocoMachine(MujocoReferee):
    """MuJoCo with the rotors and the linear springs, dampers and frictions of a model."""

    def __init__(self, model: RobotModel):
        super().__init__(model)
        springs = [
            c.dof.spring or c.dof.gear.spring for c in model.coordinates if c.dof is not None
        ]
        if not all(spring is None or isinstance(spring, LinearSpring) for spring in springs):
            raise ValueError("this referee knows linear springs only")
        self.P = np.zeros((model.n_a + model.n_m, model.dof))
        self.P[: model.n_a, : model.n_a] = np.eye(model.n_a)
        for j in range(model.n_m):
            if j in model.i_m:
                self.P[model.n_a + j, model.n_a + model.i_m.index(j)] = 1.0
            else:
                self.P[model.n_a + j, list(model.i_g)] = model.eta[j]

    def _rub(self, moved: Dof | Motor) -> str:
        stiffness = 0.0
        damping = moved.friction.viscous
        if isinstance(moved, Dof) and moved.spring is not None:
            stiffness = moved.spring.stiffness
            damping = damping + moved.damping
        return f' stiffness="{text(stiffness)}" springref="0" damping="{text(damping)}"'

    def _tendons(self) -> str:
        model = self.model
        out = ""
        inverse = np.linalg.inv(model.eta)
        for k, i in enumerate(model.i_g):
            dof = model.coordinates[i].dof
            if dof.gear.rigid:
                continue
            on_motor = dof.gear.side == "motor"
            factor = (
                next(m.ratio[0] for m in model.motors if m.drives == (dof.name,))
                if on_motor
                else 1.0
            )
            ends = {dof.name: -factor}
            ends |= {
                f"rotor {m.name}": factor * inverse[k, j]
                for j, m in enumerate(model.motors)
                if inverse[k, j]
            }
            joints = "".join(
                f'<joint joint="{name}" coef="{text(coef)}"/>' for name, coef in ends.items()
            )
            laws = (
                f'stiffness="{text(dof.gear.spring.stiffness)}" '
                f'damping="{text(dof.gear.damping)}" springlength="0"'
            )
            out += f'<fixed name="gear {dof.name}" {laws}>{joints}</fixed>'
        return f"<tendon>{out}</tendon>" if out else ""

    def minimal_mass(self, q_a):
        """Mass matrix of the arm coordinates and the motors behind elastic gears."""
        return (
            self.P.T
            @ self.mass_matrix(self.P @ np.concatenate([q_a, np.zeros(len(self.model.i_m))]))
            @ self.P
        )

    def forward_dynamics(self, q_a, v_a, q_m, v_m, tau_m):
        """Accelerations (a_a, a_m) of the full model, all of a_m."""
        model = self.model
        n_a = self.model.n_a
        i_m = list(self.model.i_m)
        x = self.P @ np.concatenate([q_a, q_m[i_m]])
        dx = self.P @ np.concatenate([v_a, v_m[i_m]])
        self.d.qfrc_applied[self.at_v[n_a:]] = tau_m
        self.set_state(x, dx)
        self.d.qfrc_applied[:] = 0.0
        if len(i_m) == model.n_m:
            a = self.d.qacc[self.at_v]
        else:
            force = self.P.T @ self.d.qfrc_smooth[self.at_v]
            a = self.P @ np.linalg.solve(self.minimal_mass(q_a), force)
        return a[:n_a].copy(), a[n_a:].copy()
