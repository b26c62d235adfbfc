"""Elastic robots from public URDF files: chains of the package example-robot-data with seeded
elasticity and moves.

Robot number r is a chain of a family, a kind of elasticity and five moves; the same number gives
the same robot. The stiffness of a gear follows the torque class of its joint, the damping a
damping ratio, the rotor a share of the inertia that the joint feels. The text of a robot is an
overlay model file.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from itertools import pairwise
from pathlib import Path

import numpy as np

from flexgen.base.errors import FlexgenError, ModelError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.reader import read
from flexgen.model.urdf.urdf import Joint, Limit, Urdf

MOVES = 5  # of each robot
KINDS = ("gears", "bend", "light rotors", "rigid gears", "bends", "combination")
MARGIN = 0.1  # of the range of a joint, kept free at either end
POSES = 6  # at which the load of the joints is estimated
TRIES = 400  # random starts of a tool line
# least singular value of the tool's Jacobian relative to the largest, lengths measured by the
# reach
REGULAR = 0.08
NEAR = 0.03  # the same for joint moves


@dataclass(frozen=True)
class Family:
    """A chain in a URDF file of example-robot-data, its first and last link; ``tool``: type of its
    tool output.
    """

    file: str
    base: str
    tip: str
    tool: str = "combination"


FAMILIES = {
    "ur5": Family("ur_description/urdf/ur5_robot.urdf", "base_link", "tool0", "tool_pose"),
    "go2 leg": Family("go2_description/urdf/go2.urdf", "base", "FL_foot", "tool_position"),
    "panda": Family("panda_description/urdf/panda.urdf", "panda_link0", "panda_hand_tcp"),
    "talos leg": Family(
        "talos_data/robots/talos_reduced.urdf", "base_link", "left_sole_link", "tool_pose"
    ),
    "finger": Family(
        "finger_edu_description/robots/finger_edu.urdf",
        "base_link",
        "finger_tip_link",
        "tool_position",
    ),
    "z1": Family("z1_description/urdf/z1.urdf", "link00", "gripperStator", "tool_pose"),
    "solo leg": Family(
        "solo_description/robots/solo12.urdf", "base_link", "FL_FOOT", "tool_position"
    ),
    "ur10": Family("ur_description/urdf/ur10_robot.urdf", "base_link", "tool0", "tool_pose"),
    "xarm7": Family("xarm_description/urdf/xarm7.urdf", "link_base", "link_eef"),
    "anymal leg": Family(
        "anymal_c_simple_description/urdf/anymal.urdf", "base", "RF_FOOT", "tool_position"
    ),
    "tiago arm": Family(
        "tiago_description/robots/tiago_no_hand.urdf", "torso_lift_link", "wrist_ft_tool_link"
    ),
    "double pendulum": Family(
        "double_pendulum_description/urdf/double_pendulum.urdf", "base_link", "link2"
    ),
    "kinova": Family(
        "anymal_b_simple_description/robots/anymal-kinova.urdf",
        "base",
        "j2s6s200_end_effector",
        "tool_pose",
    ),
    "b1 leg": Family("b1_description/urdf/b1.urdf", "trunk", "FL_foot", "tool_position"),
    "ur3": Family("ur_description/urdf/ur3_robot.urdf", "base_link", "tool0", "tool_pose"),
    "talos arm": Family("talos_data/robots/talos_reduced.urdf", "torso_2_link", "arm_left_7_link"),
    "laikago leg": Family(
        "laikago_description/urdf/laikago.urdf", "trunk", "FL_foot", "tool_position"
    ),
    "so100": Family("so_arm_description/urdf/so100.urdf", "base", "wrist"),
    "baxter arm": Family("baxter_description/urdf/baxter.urdf", "torso", "left_wrist"),
    "a1 leg": Family("a1_description/urdf/a1.urdf", "base", "FR_foot", "tool_position"),
    "g1 leg": Family(
        "g1_description/urdf/g1_29dof_rev_1_0.urdf", "pelvis", "left_ankle_roll_link", "tool_pose"
    ),
    "pr2 arm": Family("pr2_description/urdf/pr2.urdf", "torso_lift_link", "r_gripper_tool_frame"),
    "go1 leg": Family("go1_description/urdf/go1.urdf", "base", "FL_foot", "tool_position"),
    "g1 arm": Family(
        "g1_description/urdf/g1_29dof_rev_1_0.urdf", "torso_link", "left_wrist_yaw_link"
    ),
    "romeo leg": Family(
        "romeo_description/urdf/romeo_small.urdf", "base_link", "l_sole", "tool_pose"
    ),
}


def robots_folder() -> Path | None:
    """The folder of the URDF files, or None where the package is not installed."""
    try:
        found = distribution("example-robot-data").locate_file(
            "cmeel.prefix/share/example-robot-data/robots"
        )
    except PackageNotFoundError:
        return None
    folder = Path(str(found))
    return folder if folder.is_dir() else None


def kind_of(number: int) -> tuple[str, str]:
    """Family and kind of elasticity of a robot."""
    return list(FAMILIES)[number % len(FAMILIES)], KINDS[number % len(KINDS)]


def generated_robot(number: int, folder: Path, out: Path) -> Path:
    """Write the overlay of robot ``number`` into the folder ``out``; its path. It has the moves
    m0 ... m4.
    """
    family_name, kind = kind_of(number)
    rng = np.random.default_rng([11, number])
    out.mkdir(parents=True, exist_ok=True)
    name = f"r{number}_{family_name.replace(' ', '_')}"
    chain = _Chain(FAMILIES[family_name], folder, name, out)
    elasticity = _elasticity(rng, kind, chain)
    output, weights = _output(rng, kind, chain)
    moves = [_move(rng, k, chain, weights) for k in range(MOVES)]
    path = out / f"{name}.toml"
    path.write_text(
        "\n".join([chain.head(name), *elasticity, output, *moves]) + "\n", encoding="utf-8"
    )
    return path


# --- the rigid chain -----------------------------------------------------------------------------


class _Chain:
    """The rigid chain: its joints, limits, inertia and load at random poses."""

    def __init__(self, family: Family, folder: Path, name: str, out: Path) -> None:
        self.family = family
        self.file = folder / family.file
        urdf = Urdf(self.file, family.file)
        self.joints = _joints(urdf, family)
        self.locked = _side_joints(urdf, family, self.joints)
        self.limits = [_limit(urdf, joint) for joint in self.joints]
        rigid = out / f"{name}_rigid.toml"
        rigid.write_text(self.head(f"{name}_rigid") + "\n", encoding="utf-8")
        self.equations: Equations = derive(read(rigid))
        self.n = len(self.joints)
        rng = np.random.default_rng(7)
        limits = self.limits
        pairs = [
            (-2.5, 2.5) if x is None or x.lower is None else (x.lower, x.upper) for x in limits
        ]
        self.lower = np.array([max(low, -2.5) for low, _ in pairs])
        self.upper = np.array([min(high, 2.5) for _, high in pairs])
        margin = MARGIN * (self.upper - self.lower)
        self.lower = self.lower + margin
        self.upper = self.upper - margin
        poses = [rng.uniform(self.lower, self.upper) for _ in range(POSES)]
        still = np.zeros(self.n)
        inertia = [np.diag(self._call("mass_matrix", q)[0]) for q in poses]
        load = [np.abs(self._call("inverse_dynamics", q, still, still)[0]).ravel() for q in poses]
        self.inertia = np.maximum(np.mean(inertia, axis=0), 1e-7)
        need = np.max(load, axis=0) + 4.0 * self.inertia
        effort = np.array([0.0 if x is None else x.effort for x in limits])
        # the class of a joint: what the file says, as far as it fits to what the joint has to
        # carry
        self.torque = np.clip(effort, 1.5 * need, 10.0 * need)

    def _call(self, function: str, *arguments: np.ndarray) -> list[np.ndarray]:
        return [
            np.array(x.full()) for x in self.equations.function(function).call(list(arguments))
        ]

    def head(self, name: str) -> str:
        """The tables that the rigid and the elastic robot have in common; joints are q1 ..., links
        link1 ...
        """
        family = self.family
        lines = [
            f'name = "{name}"',
            'description = "generated"',
            'source = "example-robot-data, with assumed elasticities"',
            "[urdf]",
            f'file = "{self.file}"',
            f'base = "{family.base}"',
            f'tip = "{family.tip}"',
            "dynamics = false",
        ]
        if self.locked:
            lines.append(f"lock = [{', '.join(quoted(joint) for joint in self.locked)}]")
        for k, (joint, limit) in enumerate(zip(self.joints, self.limits, strict=True)):
            lines += [f"[joint.{quoted(joint.name)}]", f'rename = "q{k + 1}"']
            if limit is None:
                lines.append("limits = false")
            lines += [
                f"[link.{quoted(joint.child)}]",
                f'rename = "link{k + 1}"',
                "inertia_reduced = true",
            ]
        if family.tip not in [joint.child for joint in self.joints]:
            lines += [f"[link.{quoted(family.tip)}]", 'rename = "tip"']
        return "\n".join(lines)

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, rotation and Jacobian (6, n) of the tool."""
        p, R = self._call("forward_kinematics", q)
        return p.ravel(), R, self._call("jacobian", q)[0]

    def reach(self) -> float:
        """Length of the chain [m]."""
        corners = self._call("chain_points", np.zeros(self.n))[0]
        return float(np.linalg.norm(np.diff(corners[:, 1:], axis=1), axis=0).sum())


def quoted(name: str) -> str:
    """A TOML string."""
    return f'"{name}"'


def _joints(urdf: Urdf, family: Family) -> list[Joint]:
    """The moving joints from base to tip."""
    out: list[Joint] = []
    link = family.tip
    while link != family.base:
        joint = urdf.parent_joint[link]
        if joint.movable:
            out.append(joint)
        link = joint.parent
    return out[::-1]


def _limit(urdf: Urdf, joint: Joint) -> Limit | None:
    """The limits of a joint; None where the file has none, or wrong ones."""
    try:
        return urdf.limit(joint)
    except ModelError:
        return None


def _side_joints(urdf: Urdf, family: Family, joints: list[Joint]) -> list[str]:
    """Names of the moving joints that hang on the chain without being part of it: they are
    locked.
    """
    chain = {joint.name for joint in joints}
    out = []
    todo = [joints[0].child]
    while todo:
        for joint in urdf.child_joints[todo.pop()]:
            if joint.movable and joint.name not in chain:
                out.append(joint.name)
            todo.append(joint.child)
    return out


# --- elasticity ----------------------------------------------------------------------------------


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _elasticity(rng: np.random.Generator, kind: str, chain: _Chain) -> list[str]:
    """Tables of gears, motors and bends; stiffness: 2.5 to 12 mrad at the torque class of the
    joint.
    """
    lines: list[str] = []
    stiffness = np.array([torque * _spread(rng, 80, 400) for torque in chain.torque])
    friction = kind == "light rotors" and bool(rng.integers(2))
    for k, joint in enumerate(chain.joints):
        ratio = float(rng.integers(50, 160))
        share = _spread(rng, 2e-3, 2e-2) if kind == "light rotors" else _spread(rng, 0.2, 2.0)
        rotor = share * chain.inertia[k]
        load = chain.inertia[k]
        law = ""
        # a twentieth of the class as Coulomb friction, full at 0.02 rad/s of the joint
        if friction:
            law = (
                f", friction = {{ coulomb = {0.05 * chain.torque[k] / ratio:.6g}, beta = "
                f"{50 / ratio:.6g} }}"
            )
        lines += [
            f"[joint.{quoted(joint.name)}.motor]",
            f"ratio = {ratio}",
            f"inertia = {rotor / ratio**2:.6g}",
        ]
        if law:
            lines[-1] += "\n" + law[2:]
        if kind != "rigid gears":
            damping = (
                2 * rng.uniform(0.01, 0.05) * np.sqrt(stiffness[k] * rotor * load / (rotor + load))
            )
            spring = f'type = "linear", stiffness = {stiffness[k]:.6g}'
            lines += [
                f"[joint.{quoted(joint.name)}.gear]",
                (
                    'type = "elastic"\n'
                    'side = "arm"\n'
                    f"spring = {{ {spring} }}\n"
                    f"damping = {damping:.6g}"
                ),
            ]
    low, high = {"gears": (0, 0), "bends": (2, 3), "rigid gears": (1, 3)}.get(kind, (1, 1))
    count = min(int(rng.integers(low, high + 1)), chain.n - 1)
    for k in sorted(rng.choice(chain.n - 1, count, replace=False).tolist()):
        lines += _bend(rng, chain, k, float(stiffness[k]))
    return lines


def _bend(rng: np.random.Generator, chain: _Chain, k: int, stiffness: float) -> list[str]:
    """A non-actuated spring before or after joint k, across its axis: one to five times as stiff
    as the gear.
    """
    joint = chain.joints[k]
    along = int(
        np.argmax(
            np.abs(
                next(
                    c.dof.axis for c in chain.equations.model.coordinates if c.name == f"q{k + 1}"
                )
            )
        )
    )
    across = int(rng.choice([i for i in range(3) if i != along]))
    spring = stiffness * _spread(rng, 1.0, 5.0)
    damping = 2 * rng.uniform(0.01, 0.05) * np.sqrt(spring * chain.inertia[k])
    return [
        f"[[joint.{quoted(joint.name)}.{rng.choice(['before', 'after'])}]]",
        f'name = "e{k + 1}"\ntype = "rotation"\naxis = {np.eye(3, dtype=int)[across].tolist()}',
        f'spring = {{ type = "linear", stiffness = {spring:.6g} }}\ndamping = {damping:.6g}',
    ]


def _output(rng: np.random.Generator, kind: str, chain: _Chain) -> tuple[str, np.ndarray | None]:
    """The output's table, and its weights where it is a combination of joints."""
    if chain.family.tool != "combination" and kind != "combination":
        return f'[output]\ntype = "{chain.family.tool}"', None
    weights = np.eye(chain.n)
    if kind == "combination":
        weights = np.round(
            weights + rng.uniform(-0.3, 0.3, (chain.n, chain.n)) / np.sqrt(chain.n), 3
        )
    rows = [
        "{ " + ", ".join(f"q{k + 1} = {w:.6g}" for k, w in enumerate(row) if w) + " }"
        for row in weights.tolist()
    ]
    return f'[output]\ntype = "combination"\nunit = "rad"\nrows = [{", ".join(rows)}]', weights


# --- moves ---------------------------------------------------------------------------------------


def _move(rng: np.random.Generator, k: int, chain: _Chain, weights: np.ndarray | None) -> str:
    """Move m0 ... m4: lines of the tool, or of the combination, and joint moves."""
    smoothness = int(rng.integers(5, 8))
    end = f"smoothness = {smoothness}"
    if weights is None and k % 2 == 0:
        start, displacement = _line(rng, chain)
        duration = rng.uniform(0.5, 1.5)
        what = f'type = "tool_line"\nstart_rad = {start}\ndisplacement = {displacement}'
        return f'[[move]]\nname = "m{k}"\n{what}\nduration = {duration:.3f}\n{end}'
    for _ in range(TRIES):
        first = rng.uniform(chain.lower, chain.upper)
        last = np.clip(first + rng.uniform(-0.8, 0.8, chain.n), chain.lower, chain.upper)
        if weights is not None or _is_away(chain, first, last):
            break
    duration = max(0.4, rng.uniform(1.0, 2.0) * float(np.abs(last - first).max()))
    if weights is not None and k % 2 == 0:
        displacement = np.round(weights @ (last - first), 6).tolist()
        what = f'type = "output_line"\nstart_rad = {rounded(first)}\ndisplacement = {displacement}'
    else:
        what = f'type = "joint"\nstart_rad = {rounded(first)}\nend_rad = {rounded(last)}'
    return f'[[move]]\nname = "m{k}"\n{what}\nduration = {duration:.3f}\n{end}'


def rounded(x: np.ndarray) -> list[float]:
    """Numbers for a model file."""
    return np.round(x, 4).tolist()


def _line(rng: np.random.Generator, chain: _Chain) -> tuple[list[float], list[float]]:
    """Start and displacement of a line of the tool without singular poses, 5 to 15 % of the
    reach.
    """
    reach = chain.reach()
    for _ in range(TRIES):
        start = np.round(rng.uniform(chain.lower, chain.upper), 4)
        direction = rng.normal(size=3)
        displacement = np.round(
            direction / np.linalg.norm(direction) * rng.uniform(0.05, 0.15) * reach, 5
        )
        if _is_regular(chain, start, displacement, reach):
            return start.tolist(), displacement.tolist()
    raise FlexgenError(f"{chain.file.name}: no line of the tool was found in {TRIES} tries")


def _is_away(chain: _Chain, first: np.ndarray, last: np.ndarray) -> bool:
    """Whether a joint move of the rigid chain stays away from singular poses, where the tool
    cannot be the output.
    """
    rows = slice(0, 6 if chain.family.tool == "tool_pose" else 3)
    scale = np.r_[np.ones(3) / chain.reach(), np.ones(3)][rows]
    for share in np.linspace(0.0, 1.0, 41):
        sizes = np.linalg.svd(
            scale[:, None] * chain.pose(first + share * (last - first))[2][rows], compute_uv=False
        )
        if sizes[-1] < NEAR * sizes[0]:
            return False
    return True


def _is_regular(chain: _Chain, start: np.ndarray, displacement: np.ndarray, reach: float) -> bool:
    """Whether the rigid chain follows the line within its limits and away from singular poses."""
    rows = slice(0, 6 if chain.family.tool == "tool_pose" else 3)
    scale = np.r_[np.ones(3) / reach, np.ones(3)][rows]
    q = start.copy()
    (p0, R0, _) = chain.pose(start)
    steps = np.linspace(0.0, 1.0, 9)
    for _, share in pairwise(steps):
        for _ in range(5):
            p, R, J = chain.pose(q)
            E = R0 @ R.T
            turn = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
            error = np.r_[p0 + share * displacement - p, turn][rows]
            sizes = np.linalg.svd(scale[:, None] * J[rows], compute_uv=False)
            if sizes[-1] < REGULAR * sizes[0]:
                return False
            q = q + np.linalg.solve(J[rows], error)
        if np.linalg.norm(error) > 1e-6 or (q < chain.lower).any() or (q > chain.upper).any():
            return False
    return True
