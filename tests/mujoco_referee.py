"""An outside referee: the same machine in MuJoCo, rotors included.

Every element becomes a MuJoCo body at ``origin`` with the element's degrees of freedom as joints in their order; the
body's centre and principal axes are placed through ``link``. Massless bodies, point masses and regrouped inertias are
refused by MuJoCo's compiler, not by its dynamics: the model is compiled with unit masses and inertias, and the true
ones are written into the compiled model. A rotor is a massless body on a hinge with an axial inertia only; it hangs on
its carrier (complete coupling) or on the world (simplified). Springs, frictions and gears stay outside: MuJoCo
answers for the rigid-body part alone. It knows no beams.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from flexgen.model.elements import Body, RobotModel

NO_BEAMS = "MuJoCo has no assumed-modes beam"


def text(values) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(x)) for x in np.ravel(values))


def quaternion(rotation: np.ndarray) -> str:
    """A rotation matrix as MuJoCo's (w, x, y, z)."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return text([w, x, y, z])


class MujocoReferee:
    """MuJoCo's mass matrix, bias forces and inverse dynamics in the coordinates (q_a, q_m) of a model without beams."""

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
            <body name="base" pos="{text(model.base.position)}" quat="{quaternion(np.array(model.base.rotation))}">
              {self._inertial("base", Body(), np.zeros(3), np.eye(3))}{self._carried("base", np.zeros(3), np.eye(3))}
              {self._element(0, np.zeros(3), np.eye(3))}
            </body>
          </worldbody>
        </mujoco>"""
        self.m = mujoco.MjModel.from_xml_string(xml)
        self.d = mujoco.MjData(self.m)
        for name, (mass, moments) in self._masses.items():
            k = self.m.body(name).id
            self.m.body_mass[k], self.m.body_inertia[k] = mass, moments
        mujoco.mj_setConst(self.m, self.d)
        names = [c.name for c in model.coordinates] + [f"rotor {m.name}" for m in model.motors if rotors]
        joints = [self.m.joint(name).id for name in names]
        self.at_q, self.at_v = self.m.jnt_qposadr[joints], self.m.jnt_dofadr[joints]
        assert self.m.nv == len(names)

    # the description -----------------------------------------------------------------------------------------------

    def _inertial(self, name: str, body: Body, position: np.ndarray, rotation: np.ndarray) -> str:
        moments, axes = np.linalg.eigh(np.array(body.inertia))
        axes = axes * np.linalg.det(axes)
        self._masses[name] = (body.mass, moments)
        centre = position + rotation @ np.array(body.com)
        return f'<inertial mass="1" diaginertia="1 1 1" pos="{text(centre)}" quat="{quaternion(rotation @ axes)}"/>'

    def _rotor(self, j: int, position=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)) -> str:
        motor = self.model.motors[j]
        axis = np.asarray(axis)
        x = np.linalg.svd(axis[None])[2][1]
        frame = np.column_stack([x, np.cross(axis, x), axis])
        name = f"rotor {motor.name}"
        self._masses[name] = (0.0, np.array([0.0, 0.0, motor.inertia]))
        joint = f'<joint name="{name}" type="hinge" axis="0 0 1"/>' if self._rotors else ""
        return (
            f'<body name="{name}" pos="{text(position)}" quat="{quaternion(frame)}">{joint}'
            '<inertial mass="1" diaginertia="1 1 1" pos="0 0 0"/></body>'
        )

    def _carried(self, carrier: str, position: np.ndarray, rotation: np.ndarray) -> str:
        if self.model.motor_coupling != "complete":
            return ""
        carried = [j for j, motor in enumerate(self.model.motors) if motor.carrier == carrier]
        return "".join(self._rotor(j, position, rotation @ np.array(self.model.motors[j].axis)) for j in carried)

    def _element(self, k: int, position: np.ndarray, rotation: np.ndarray) -> str:
        """Element k and what follows; the previous tip stands at this place in the parent's MuJoCo body."""
        model = self.model
        if k == len(model.elements):
            payload = self._inertial("payload", model.payload, np.zeros(3), np.eye(3))
            tool = model.tool
            site = f'<site name="tool" pos="{text(tool.position)}" quat="{quaternion(np.array(tool.rotation))}"/>'
            return f'<body name="payload" pos="{text(position)}" quat="{quaternion(rotation)}">{payload}{site}</body>'
        element = model.elements[k]
        place = position + rotation @ np.array(element.origin.position)
        turn = rotation @ np.array(element.origin.rotation)
        types = {"rotation": "hinge", "translation": "slide"}
        joints = "".join(
            f'<joint name="{dof.name}" type="{types[dof.type]}" axis="{text(dof.axis)}"/>' for dof in element.dofs
        )
        link = np.array(element.link.position), np.array(element.link.rotation)
        return (
            f'<body name="{element.name}" pos="{text(place)}" quat="{quaternion(turn)}">{joints}'
            f"{self._inertial(element.name, element.body, *link)}{self._carried(element.name, *link)}"
            f"{self._element(k + 1, *link)}</body>"
        )

    # the answers -------------------------------------------------------------------------------------------------

    def _set(self, q, v) -> None:
        self.d.qpos[self.at_q], self.d.qvel[self.at_v] = q, v
        mujoco.mj_forward(self.m, self.d)

    def tool(self, q):
        """Position and rotation of the tool."""
        self._set(q, np.zeros_like(self.at_v))
        site = self.d.site("tool")
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def mass_matrix(self, q):
        """Inertia matrix."""
        self._set(q, np.zeros(len(self.at_v)))
        out = np.zeros((self.m.nv, self.m.nv))
        mujoco.mj_fullM(self.m, self.d, out)
        return out[np.ix_(self.at_v, self.at_v)]

    def bias(self, q, v):
        """Centripetal, gyroscopic and gravity forces."""
        self._set(q, v)
        return self.d.qfrc_bias[self.at_v].copy()

    def inverse_dynamics(self, q, v, a):
        """Generalised forces for the accelerations a."""
        self._set(q, v)
        self.d.qacc[self.at_v] = a
        out = np.zeros(self.m.nv)
        mujoco.mj_rne(self.m, self.d, 1, out)
        return out[self.at_v]
