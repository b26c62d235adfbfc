"""Features of robots, and which functions take them into account: one table, `FEATURES`.

A row is a `Feature`: how it is found in a robot, the functions that refuse it and why, and those
that compute the robot without it. Every other function takes it into account. `needs` refuses at
the entrance of a public function, with the reason of the row; `obstacle` gives the reason to code
that chooses between ways to compute. The page docs/support_matrix.md is rendered from the table,
and `tests/model/test_abilities.py` calls each function with a robot of each row.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from flexgen.base.errors import ArgumentError
from flexgen.model.elements import (
    BacklashSpring,
    CubicSpring,
    LinearSpring,
    PiecewiseSpring,
    RobotModel,
    Spring,
)
from flexgen.model.friction import (
    bristled_motors,
    harmonic_sums,
    hysteretic_joints,
    loaded_motors,
)

F = TypeVar("F", bound=Callable[..., Any])

# The public functions and classes of the table, in the order of the page.
FUNCTIONS = (
    "analyze",
    "check",
    "plan",
    "solve",
    "simulate",
    "control",
    "learn",
    "predict",
    "fastest",
    "plan_problem",
    "command_positions",
    "compare_shapers",
    "feedback_study",
    "excite",
    "measure",
    "identify",
    "identify_rigid",
    "identify_load",
    "identify_gears",
    "compare_record",
    "calibrate",
    "ExtendedKalmanFilter",
    "CollisionDetector",
    "generate",
    "symbolic",
    "export_mujoco",
    "export_urdf",
)
# Parts of functions that some robots lack, so that another way is taken or an argument is refused.
PARTS = {
    "reduced problem": "inverse dynamics of the output: `solve` but for `full`, streams in C",
    "full problem": 'inverse dynamics of the full equations of motion: `solve(method="full")`',
    "simplified coupling": "rotors that turn with their gears alone: `solve` but for `full`",
    "path without force": "`solve` by `spline`, `collocation`, `full` and the baselines",
    "limits without force": "these methods within limits",
    "closed form": '`solve(method="closed-form")`',
    "zero dynamics": "`solve` by `bvp` and `spline`",
    "differentiated equations": "methods that differentiate the equations of motion",
    "batches of moves": "many moves of a `sweep` at once; else one by one",
    "forces of an instant": "`forward_dynamics`, `linearize`, `flexible_joint_torque` in C",
    "friction of speeds": "`motor_friction` of an emitted library",
    "friction of loads": "`loaded_friction` of an emitted library",
    "harmonics in C": "`motor_harmonics` of an emitted library",
    "inner zeros": "zeros from the reduced problem; else from the whole linear system",
    "rotors in C": "`rotor_coupling` of an emitted library",
    "inversion in C": "`invert` and streams of an emitted library",
    "inversion Jacobians": "`inversion_jacobians` of an emitted library",
    "elastic joints": "feedback linearization, `TomeiPD`, `JointTorqueFeedback`, `feedback_study`",
    "computed torque": "`ComputedTorque`",
    "control laws": "feedback laws that evaluate the model",
    "parameters": "run-time parameters other than those of the payload",
    "velocities of ROS 2": "`getFrictionVector` of the ROS 2 plugin: velocities alone",
    "recursion": "recursive forms of the functions, with fewer operations",
    "sensors": "`sensors` of an emitted library",
}


@dataclass(frozen=True)
class Feature:
    """A row of the table.

    ``find``: where a robot has it, such as "the gear of q1 has hysteresis"; empty: it has not.
    ``expected`` and ``remedy`` end the error. ``refused``: the reason by function, ``parts``: the
    end of the sentence that `find` begins, by part. ``without``: functions that compute the robot
    without the feature, with what their result is then. ``own``: refusing functions that name the
    key of the model file by themselves.
    """

    name: str
    meaning: str
    find: Callable[[RobotModel], str]
    expected: str = ""
    remedy: str = ""
    refused: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, str] = field(default_factory=dict)
    without: Mapping[str, str] = field(default_factory=dict)
    own: tuple[str, ...] = ()

    @property
    def able(self) -> tuple[str, ...]:
        """The functions that take it into account."""
        lacking = {*self.refused, *self.without}
        return tuple(name for name in FUNCTIONS if name not in lacking)

    def refusal(self, robot: RobotModel, function: str) -> str:
        """The error of a function for a robot with the feature; empty: it takes the robot."""
        found = self.find(robot) if function in {*self.refused} - {*self.own} else ""
        if not found:
            return ""
        given = found
        if not found.startswith("model "):
            given = f"given {robot.title}, whose {found.removeprefix('the ')}"
        expected = f", expected {self.expected}" if self.expected else ""
        return (
            f"{function}: {given}{expected}, since {self.refused[function]}; {self.remedy}, or "
            f"use a function that takes it into account: {', '.join(self.able)}"
        )


def _has_free_joints(robot: RobotModel) -> bool:
    """Whether a tool leaves joints free, of an arm with a motor for each joint."""
    return robot.output.size < robot.n_g == robot.n_m


def _find_unmatched_outputs(robot: RobotModel) -> str:
    """Why the inverse dynamics cannot be stated, where no joints can be added."""
    return "" if _has_free_joints(robot) else robot.inversion_obstacle(any_coupling=True) or ""


def _find_free_joints(robot: RobotModel) -> str:
    """Numbers of outputs and motors of an arm whose tool leaves joints free."""
    return robot.inversion_obstacle(any_coupling=True) or "" if _has_free_joints(robot) else ""


def _name_first(found: Sequence[str], text: str) -> str:
    """A text with the first of some names; empty without names."""
    return text.format(found[0]) if found else ""


def _list_names(robot: RobotModel, found: Sequence[str], what: str) -> str:
    """Message with a property of a robot and the names of the parts that have it; empty without
    names.
    """
    return f"model {robot.name}: given {what} ({', '.join(found)})" if found else ""


def _find_springs(robot: RobotModel) -> list[tuple[str, Spring | None]]:
    """The springs of gears and of coordinates without motor, by name of the coordinate."""
    dofs = [dof for element in robot.elements for dof in element.dofs]
    return [(dof.name, dof.gear.spring if dof.gear is not None else dof.spring) for dof in dofs]


def _find_nonlinear(robot: RobotModel) -> str:
    """Names of the springs that are not linear, in words; empty: none."""
    found = [
        name
        for name, spring in _find_springs(robot)
        if spring is not None and not isinstance(spring, LinearSpring)
    ]
    return _list_names(robot, found, "springs that are not linear")


def _find_backlash(robot: RobotModel) -> str:
    found = [name for name, spring in _find_springs(robot) if isinstance(spring, BacklashSpring)]
    return _list_names(robot, found, "springs with a smooth dead band")


def _find_kinks(robot: RobotModel) -> str:
    found = [
        name for name, spring in _find_gear_springs(robot) if isinstance(spring, PiecewiseSpring)
    ]
    return _list_names(robot, found, "springs of gears with a kink")


def is_stiff(spring: Spring) -> bool:
    """Whether a spring is stiff at every deflection; laws for elastic joints divide by this."""
    if isinstance(spring, BacklashSpring):
        return False
    if isinstance(spring, LinearSpring):
        return spring.stiffness > 0
    if isinstance(spring, CubicSpring):
        return spring.stiffness > 0 and spring.cubic >= 0
    return spring.low > 0 and spring.high > 0


def _find_loose_spring(robot: RobotModel) -> str:
    """A gear whose spring has no stiffness at some deflection."""
    for name, spring in _find_gear_springs(robot):
        if spring is not None and not is_stiff(spring):
            return f"model {robot.name}: given a spring in {name} without stiffness somewhere"
    return ""


def _find_gear_springs(robot: RobotModel) -> list[tuple[str, Spring | None]]:
    dofs = [dof for element in robot.elements for dof in element.dofs]
    return [(dof.name, dof.gear.spring) for dof in dofs if dof.gear is not None]


def _find_rigid_gear(robot: RobotModel) -> str:
    found = [name for name, spring in _find_gear_springs(robot) if spring is None]
    return _name_first(found, f"model {robot.name}: given a rigid gear in {{}}")


def _find_harmonics(robot: RobotModel) -> str:
    return next(iter(harmonic_sums(robot)), "")


def _find_state_and_harmonics(robot: RobotModel) -> str:
    motors = bristled_motors(robot)
    found = _find_harmonics(robot)
    return f"motor {motors[0]} has lugre and {found}" if motors and found else ""


def _find_coupling(robot: RobotModel) -> str:
    if robot.motor_coupling == "simplified":
        return ""
    return f"model {robot.name} has motor_coupling {robot.motor_coupling!r}"


def _find_springs_that_turn(robot: RobotModel) -> str:
    """A coordinate without motor that turns a motor, in complete motor coupling."""
    if robot.motor_coupling == "simplified":
        return ""
    from flexgen.model.inertia import turning_coordinates  # here: most robots need it not

    for motor, turning in zip(robot.motors, turning_coordinates(robot), strict=True):
        found = [robot.coordinates[i].name for i in robot.i_e if i in turning]
        if found:
            return f"model {robot.name}: {found[0]}, which has no motor, turns motor {motor.name}"
    return ""


def _find_circle(robot: RobotModel) -> str:
    """Why the torques of the gears do not follow from each other in complete motor coupling."""
    if robot.motor_coupling == "simplified":
        return ""
    from flexgen.model.inertia import rotor_stages

    stages = zip(robot.i_g, rotor_stages(robot), strict=True)
    circle = [robot.coordinates[i].name for i, stage in stages if stage < 0]
    if circle:
        return f"model {robot.name}: joint {circle[-1]} turns a motor whose torque it needs"
    if not (hysteretic_joints(robot) or harmonic_sums(robot)):
        return ""
    return f"model {robot.name} has motor_coupling 'complete' with hysteresis or harmonics"


def _miss_coupling(robot: RobotModel) -> str:
    lacking = f"model {robot.name} has no complete motor coupling"
    return "" if robot.motor_coupling == "complete" else lacking


def _find_elastic(robot: RobotModel) -> str:
    return _list_names(
        robot, [robot.coordinates[i].name for i in robot.i_e], "coordinates without motor"
    )


def _find_beams(robot: RobotModel) -> str:
    found = [element.name for element in robot.elements if element.beam is not None]
    return _list_names(robot, found, "beams")


def _find_mechanisms(robot: RobotModel) -> str:
    found = [dof.name for element in robot.elements for dof in element.dofs if dof.mimic]
    return _list_names(robot, found, "axes moved by mechanisms")


def _find_loops(robot: RobotModel) -> str:
    return _list_names(robot, [loop.name for loop in robot.loops], "closed loops")


def _find_counterbalances(robot: RobotModel) -> str:
    found = [c.name for c in robot.coordinates if c.dof is not None and c.dof.counterbalance]
    return _list_names(robot, found, "a counterbalance")


def _find_lines(robot: RobotModel) -> str:
    return _list_names(robot, [line.name for line in robot.lines], "lines between two points")


def _find_undriven(robot: RobotModel) -> str:
    """Motors that move the output through the deflection of lines alone."""
    if not robot.lines:
        return ""
    from flexgen.model.format.driven_output import undriven_output  # here: few robots have lines

    return undriven_output(robot)


def _find_heavy_lines(robot: RobotModel) -> str:
    return _list_names(robot, [line.name for line in robot.lines if line.mass], "lines with mass")


def _find_drags(robot: RobotModel) -> str:
    found = [element.name for element in robot.elements if element.body.rotational_drag]
    found += ["payload"] if robot.payload.rotational_drag else []
    return _list_names(robot, found, "bodies with rotational_drag")


def _find_branches(robot: RobotModel) -> str:
    return f"model {robot.name}: given several branches" if robot.branched else ""


def _find_coupled_motors(robot: RobotModel) -> str:
    found = [motor.name for motor in robot.motors if len(motor.drives) > 1]
    return _list_names(robot, found, "motors that drive several joints")


def _miss_load(robot: RobotModel) -> str:
    lacking = f"model {robot.name} has no friction that depends on the load"
    return "" if loaded_motors(robot) else lacking


def _miss_harmonics(robot: RobotModel) -> str:
    lacking = f"model {robot.name} has no transmission error, cogging or torque ripple"
    return "" if harmonic_sums(robot) else lacking


# Reasons that several functions share.
OF_THE_PAST = "whose torque depends on the motion before"
NOT_SHAPED = "motors that follow positions have springs and dampers behind them alone"
NO_STATE = "the optimal control problem lacks its state"
LINEAR = "responses of small motions about a pose are identified, which such a law does not have"
NOT_FITTED = "its torques are not among those that are fitted"
NOT_IN_LAWS = "the feedback laws have no such torque"
NOT_IN_TEXT = "the printed equations have no such term"
NOT_IN_STATICS = "its statics have no such part"
NEEDS_MOTORS = "feedback linearization needs a motor and a spring for each coordinate"
NOT_IN_MUJOCO = "MuJoCo has no such law"
NOT_IN_RESIDUAL = "the residual has no such torque, and would take it for a contact"
AS_RIGID = "taken as a gear without, for motions in which the gears are as good as rigid"
ROD_AS_COORDINATE = (
    'make the stretch of the driving rod a coordinate, a dof of type "translation" with a spring, '
    "close the rod by a table [[loop]], and make the joint that it drives passive"
)
# Functions that need the inverse dynamics, in addition to `solve`, and for what.
OF_INVERSE = {
    "learn": "its feedforward is the inverse dynamics",
    "fastest": "its search needs the inverse dynamics",
    "control": "its feedforward is the inverse dynamics, unless a `solution` is given",
    "predict": "its feedforward is the inverse dynamics, unless a `solution` is given",
    "command_positions": "they need the inverse dynamics, unless a `solution` is given",
    "compare_shapers": "the outputs must determine the positions of all motors",
    "plan_problem": "the ends of the path must determine the pose of all joints",
    "feedback_study": "its feedforward is the inverse dynamics",
    "CollisionDetector": "its library is that of the inverse dynamics",
}
MOTOR_FOR_EACH = "expected a motor and a spring for each arm coordinate"

FEATURES: tuple[Feature, ...] = (
    Feature(
        "hysteresis",
        "A gear has a table `hysteresis`: a torque that depends on the motion before.",
        lambda robot: _name_first(hysteretic_joints(robot), "the gear of {} has hysteresis"),
        "gears without it",
        "remove the table hysteresis of the gear from the model file",
        refused={
            "plan_problem": NO_STATE,
            "compare_shapers": NOT_SHAPED,
            "feedback_study": NOT_IN_LAWS,
            "excite": LINEAR,
            "measure": LINEAR,
            "identify": LINEAR,
            "ExtendedKalmanFilter": "the state of the filter lacks its torques",
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": NOT_IN_MUJOCO,
        },
        parts={
            "path without force": "expected gears without it",
            "limits without force": "expected gears without it",
            "forces of an instant": OF_THE_PAST,
            "parameters": OF_THE_PAST,
            "batches of moves": OF_THE_PAST,
        },
        without={
            "analyze": "poles, zeros and responses are those of the springs, as for large motions",
            "identify_rigid": AS_RIGID,
            "identify_load": AS_RIGID,
            "calibrate": AS_RIGID,
            "CollisionDetector": AS_RIGID,
        },
    ),
    Feature(
        "friction with a state",
        "A motor has a table `lugre`: bristles, a friction that depends on the motion before.",
        lambda robot: _name_first(bristled_motors(robot), "motor {} has lugre"),
        "motors without it",
        "remove the table lugre of the motor",
        refused={
            "plan_problem": NO_STATE,
            "compare_shapers": NOT_SHAPED,
            "feedback_study": NOT_IN_LAWS,
            "excite": LINEAR,
            "measure": LINEAR,
            "identify": LINEAR,
            "identify_rigid": NOT_FITTED,
            "identify_load": NOT_FITTED,
            "identify_gears": NOT_FITTED,
            "calibrate": NOT_IN_STATICS,
            "ExtendedKalmanFilter": "the state of the filter lacks its torques",
            "CollisionDetector": NOT_IN_RESIDUAL,
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": NOT_IN_MUJOCO,
        },
        parts={
            "path without force": "expected motors without it",
            "limits without force": "expected motors without it",
            "forces of an instant": "a friction that depends on the motion before",
            "parameters": "a friction that depends on the motion before",
            "control laws": "a friction that depends on the motion before",
            "computed torque": "a friction that depends on the motion before",
            "velocities of ROS 2": "which depends on the motion before",
            "batches of moves": "a friction that depends on the motion before",
        },
        without={
            "analyze": "poles, zeros and responses are those of a motor that slides",
        },
    ),
    Feature(
        "friction by load",
        "A friction depends on the torque of a gear: `load_coulomb`, `load_stribeck`.",
        lambda robot: _name_first(
            loaded_motors(robot), "motor {} has a friction that depends on the torque of its gear"
        ),
        "motors without it",
        "set load_coulomb, load_stribeck and load_smoothing of its friction to 0",
        refused={
            "feedback_study": NOT_IN_LAWS,
            "identify_rigid": NOT_FITTED,
            "identify_load": NOT_FITTED,
            "identify_gears": NOT_FITTED,
            "calibrate": NOT_IN_STATICS,
            "CollisionDetector": NOT_IN_RESIDUAL,
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": NOT_IN_MUJOCO,
        },
        parts={
            "limits without force": "expected motors without it",
            "friction of speeds": "it is loaded_friction",
            "control laws": "expected motors without it",
            "computed torque": "expected motors without it",
            "velocities of ROS 2": "",
        },
    ),
    Feature(
        "harmonics",
        "Fourier sums of a motor angle: `transmission_error`, `cogging`, `torque_ripple`.",
        _find_harmonics,
        "gears and motors without transmission_error, cogging and torque_ripple",
        "remove these tables from the model file",
        refused={
            "plan_problem": "its mesh may be too coarse for them",
            "compare_shapers": NOT_SHAPED,
            "feedback_study": NOT_IN_LAWS,
            "identify_rigid": NOT_FITTED,
            "identify_load": NOT_FITTED,
            "identify_gears": "it finds them by itself from a model without them",
            "calibrate": NOT_IN_STATICS,
            "CollisionDetector": NOT_IN_RESIDUAL,
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": NOT_IN_MUJOCO,
        },
        parts={
            "path without force": "expected motors and gears without these sums",
            "limits without force": "expected motors and gears without these sums",
            "elastic joints": "expected none",
            "control laws": "expected none",
            "computed torque": "expected none",
            "batches of moves": "expected none",
        },
    ),
    Feature(
        "friction with a state and harmonics",
        "A motor has a table `lugre`, and the robot Fourier sums of motor angles.",
        _find_state_and_harmonics,
        parts={"inversion in C": "of which C has one or the other"},
    ),
    Feature(
        "complete coupling",
        'The rotors turn with the elements that carry them: `motor_coupling = "complete"`.',
        _find_coupling,
        "'simplified'",
        'set motor_coupling = "simplified"',
        refused={
            "learn": "its model of the errors has rotors that only their gears turn",
            "fastest": "its limits are those of rotors that only their gears turn",
            "feedback_study": "feedback linearization needs rotors that only their gears turn",
            "identify_rigid": "its regressor has rotors that only their gears turn",
            "identify_load": "its regressor has rotors that only their gears turn",
            "compare_record": "rotors that turn with the bodies add to the torques of the joints",
            "CollisionDetector": "its residual is that of the simplified equations",
        },
        parts={
            "simplified coupling": "expected 'simplified'",
            "elastic joints": "expected 'simplified'",
            "batches of moves": "expected 'simplified'",
            "computed torque": "expected 'simplified'",
        },
    ),
    Feature(
        "complete coupling behind springs",
        "Complete coupling, where a coordinate without motor turns a motor: the rows of such "
        "coordinates have rotors that move as behind rigid gears.",
        _find_springs_that_turn,
        parts={"inner zeros": ""},
    ),
    Feature(
        "complete coupling in a circle",
        "Complete coupling, where a joint turns a motor whose torque depends on that of the "
        "joint, or with hysteresis or harmonics.",
        _find_circle,
        parts={
            "reduced problem": "expected motors that joints before their own turn",
            "rotors in C": "",
            "differentiated equations": "expected motors that joints before their own turn",
        },
    ),
    Feature(
        "no complete coupling",
        'Rotors turn with their gears alone: `motor_coupling = "simplified"`.',
        _miss_coupling,
        parts={"rotors in C": ""},
    ),
    Feature(
        "elastic coordinates",
        "Coordinates without a motor: axes with springs, and the modes of beams.",
        _find_elastic,
        "a motor for each",
        "model them as rigid",
        refused={
            "feedback_study": NEEDS_MOTORS,
            "identify_rigid": "its regressor is that of rigid bodies",
        },
        parts={
            "closed form": "expected none",
            "elastic joints": MOTOR_FOR_EACH,
            "computed torque": "expected a motor for each",
            "batches of moves": "expected none",
        },
    ),
    Feature(
        "no elastic coordinates",
        "Each coordinate has a motor: there are no zero dynamics.",
        lambda robot: "" if robot.n_e else f"model {robot.name} has no coordinates without motor",
        parts={"zero dynamics": "expected some", "inversion Jacobians": ""},
    ),
    Feature(
        "beam",
        "An element is an elastic beam: a table `beam`.",
        _find_beams,
        "rigid bodies",
        "replace the beam by elastic axes, [[element.dof]] with a spring",
        refused={
            "feedback_study": NEEDS_MOTORS,
            "identify_rigid": "its regressor is that of rigid bodies",
            "calibrate": NOT_IN_STATICS,
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": "MuJoCo has no beams with assumed modes",
            "export_urdf": "URDF has rigid links alone",
        },
        parts={"recursion": ""},
        own=("calibrate", "export_mujoco", "export_urdf"),
    ),
    Feature(
        "mechanism",
        "An axis is moved by others: the key `mimic`.",
        _find_mechanisms,
        "none",
        "model the axis as fixed",
        refused={"symbolic": NOT_IN_TEXT},
    ),
    Feature(
        "kinematic loops",
        "Frames of two bodies coincide: the tables `[[loop]]`, with joints that are `passive`.",
        _find_loops,
        "none",
        "model the mechanism by the key mimic, if it is a parallelogram, or leave it out",
        refused={
            "identify_rigid": "its regressor is that of trees",
            "calibrate": "its geometry is that of trees",
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": "MuJoCo's equality constraints are soft: its loops open under load",
        },
        parts={"batches of moves": "expected none"},
    ),
    Feature("branches", "Several elements have one parent: a tree.", _find_branches),
    Feature(
        "counterbalance",
        "A torque on an axis by its angle, as of a gas spring: the key `counterbalance`.",
        _find_counterbalances,
        "none",
        "remove the key counterbalance",
        refused={"symbolic": NOT_IN_TEXT, "export_mujoco": "MuJoCo has no such force"},
        own=("export_mujoco",),
        parts={"batches of moves": "expected none"},
    ),
    Feature(
        "lines",
        "Springs, gas springs, rods or cables between two points: the tables `[[line]]`.",
        _find_lines,
        "none",
        "remove the tables [[line]]",
        refused={
            "feedback_study": NOT_IN_LAWS,
            "identify_rigid": NOT_FITTED,
            "calibrate": NOT_IN_STATICS,
            "symbolic": NOT_IN_TEXT,
            "export_mujoco": "MuJoCo has springs and rods without mass alone",
        },
        own=("export_mujoco",),
        parts={"batches of moves": "expected none", "elastic joints": "expected none"},
    ),
    Feature(
        "outputs that lines move",
        "A line alone connects a motor with the output: a driving rod that is not a coordinate.",
        _find_undriven,
        "an output that moves with the motors without deflection",
        ROD_AS_COORDINATE,
        refused={
            "solve": "inverse dynamics would be singular",
            **OF_INVERSE,
        },
        own=("control", "predict", "command_positions", "feedback_study"),
        parts={
            "reduced problem": f"expected another model: {ROD_AS_COORDINATE}",
            "full problem": f"expected another model: {ROD_AS_COORDINATE}",
            "computed torque": f"expected another model: {ROD_AS_COORDINATE}",
        },
    ),
    Feature(
        "lines with mass",
        "A rod, spring or cable between two points has a mass.",
        _find_heavy_lines,
        "none",
        "set their mass to 0, or add it to the bodies at their ends",
        parts={"recursion": ""},
    ),
    Feature(
        "drag",
        "A damping of the rotation of a body: the key `rotational_drag`.",
        _find_drags,
        "none",
        "set rotational_drag = 0",
        refused={"export_urdf": "URDF has no such force"},
        own=("export_urdf",),
        parts={"batches of moves": "expected none"},
    ),
    Feature(
        "kinked spring",
        "A spring of type `piecewise`, whose stiffness jumps.",
        _find_kinks,
        parts={"differentiated equations": "where the torque jumps"},
    ),
    Feature(
        "nonlinear spring",
        "A spring of another type than `linear`.",
        _find_nonlinear,
        "linear springs",
        "choose a linear spring",
        refused={"calibrate": "its compliances are those of linear springs"},
        own=("calibrate",),
        parts={"batches of moves": "expected linear ones"},
    ),
    Feature(
        "backlash",
        "A spring of type `backlash`, with a gap.",
        _find_backlash,
        "linear, cubic, smooth or piecewise springs",
        "choose another type of spring",
        refused={
            "feedback_study": "feedback linearization divides by the stiffness",
            "calibrate": "its compliances are those of linear springs",
            "export_mujoco": NOT_IN_MUJOCO,
        },
        own=("calibrate", "export_mujoco"),
    ),
    Feature(
        "loose spring",
        "The spring of a gear has no stiffness at some deflection, as in a gap.",
        _find_loose_spring,
        "springs that are stiff at every deflection",
        "choose another spring",
        parts={"elastic joints": MOTOR_FOR_EACH},
    ),
    Feature(
        "rigid gear",
        "A gear has no spring: the motor angle is the joint angle times the ratio.",
        _find_rigid_gear,
        "elastic gears",
        "give the gear a spring",
        refused={"feedback_study": "feedback linearization needs a spring for each motor"},
        parts={"elastic joints": MOTOR_FOR_EACH},
    ),
    Feature(
        "coupled motors",
        "A motor drives several joints: `drives` has several names.",
        _find_coupled_motors,
        "a motor for each joint",
        "leave harmonics out, or choose other joints",
        refused={
            "identify_gears": "the transmission error of a gear follows the angle of one motor"
        },
        own=("identify_gears",),
    ),
    Feature(
        "other outputs than motors",
        "The output has more rows than the robot has motors, or fewer, with joints without motor.",
        _find_unmatched_outputs,
        remedy="choose an output with as many rows as motors",
        refused={
            "solve": "inverse dynamics needs as many outputs as motors",
            **OF_INVERSE,
        },
        own=("control", "predict", "command_positions", "plan_problem", "feedback_study"),
        parts={"reduced problem": "", "full problem": "", "computed torque": ""},
    ),
    Feature(
        "fewer outputs than motors",
        "A motor for each joint, and an output with fewer rows: the tool leaves joints free.",
        _find_free_joints,
        remedy="choose an output with as many rows as motors, or the joints as output",
        refused={
            "learn": "it does not choose the joints that the tool leaves free",
            "fastest": "it does not choose the joints that the tool leaves free",
            "plan_problem": "the ends of the path must determine the pose of all joints",
            "feedback_study": "it does not choose the joints that the tool leaves free",
            "CollisionDetector": "its library is that of the inverse dynamics",
        },
        own=("plan_problem", "feedback_study"),
        parts={"reduced problem": "", "full problem": "", "computed torque": ""},
    ),
    Feature(
        "no friction by load",
        "No friction depends on the torque of a gear.",
        _miss_load,
        parts={"friction of loads": ""},
    ),
    Feature(
        "no harmonics",
        "There are no Fourier sums of motor angles.",
        _miss_harmonics,
        parts={"harmonics in C": ""},
    ),
    Feature(
        "no sensors",
        "The model file has no table `[[sensor]]`.",
        lambda robot: "" if robot.sensors else f"model {robot.name} has no sensors",
        parts={"sensors": ""},
    ),
)


def obstacle(robot: RobotModel, part: str) -> str | None:
    """The reason why a robot lacks a part of functions, of `PARTS`; None where it has it.

    A sentence without full stop for an error message: what the robot has, and what is expected.
    """
    if part not in PARTS:
        raise KeyError(part)
    for feature in FEATURES:
        found = feature.find(robot) if part in feature.parts else ""
        if found:
            return ", ".join(filter(None, (found, feature.parts[part])))
    return None


def check_ability(robot: RobotModel, function: str) -> None:
    """ArgumentError where a function refuses a robot, with the reason of the table."""
    if function not in FUNCTIONS:
        raise KeyError(function)
    for feature in FEATURES:
        if text := feature.refusal(robot, function):
            raise ArgumentError(text)


def needs(function: str, argument: str = "model") -> Callable[[F], F]:
    """Decorate a public function that takes a robot: ArgumentError for one that it refuses.

    Parameters
    ----------
    function : str
        Its name in `FUNCTIONS`.
    argument : str
        The parameter with the robot: its name, its file, a `RobotModel` or its equations. A robot
        that is read for the check is passed on.
    """

    def decorate(call: F) -> F:
        """The function with a check, before each call, that it takes the robot of its argument."""
        signature = inspect.signature(call)

        @functools.wraps(call)
        def refuse_or_call(*args: Any, **kwargs: Any) -> Any:
            """Read the model where it is a name or path, refuse one without the ability, then
            call.
            """
            given = signature.bind_partial(*args, **kwargs)
            value = given.arguments.get(argument)
            if value is None:
                return call(*args, **kwargs)
            robot = value if isinstance(value, RobotModel) else getattr(value, "model", None)
            if robot is None:
                from flexgen.model.reader import read  # here: most callers need no reader

                robot = given.arguments[argument] = read(value)
            check_ability(robot, function)
            return call(*given.args, **given.kwargs)

        return refuse_or_call  # type: ignore[return-value]

    return decorate
