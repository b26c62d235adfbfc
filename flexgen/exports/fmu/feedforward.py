"""Inverse dynamics on a moving horizon as a block: path samples in, torques and references of the
motors out.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.stream_defaults import with_defaults
from flexgen.codegen.emission.amalgamation import merge_files
from flexgen.codegen.emission.c_functions import inversion_reason
from flexgen.codegen.emission.emit import emit, function_texts
from flexgen.codegen.emission.interface import INTERVALS_MAX, POSITION, STATUSES
from flexgen.codegen.emission.spec import StreamDefaults, library_name, library_spec
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.dynamics.mechanics.signatures import INVERTING, offered_functions
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints
from flexgen.exports.fmu.block import Block, time_variable
from flexgen.exports.fmu.plant import payload_variables
from flexgen.exports.fmu.variables import INPUT, OUTPUT, STATUS, Variable
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.keys import ServoTable

# Numbers of a figure of the stream: its name, unit and meaning.
_FIGURES = (
    (
        "quality.residual",
        "1",
        (
            "residual of the unactuated rows, relative to the torques of a deflection of 0.01 "
            "rad or m"
        ),
    ),
    (
        "quality.output_step",
        "m",
        "distance by which the output leaves the plan before: the horizon is too short",
    ),
    ("quality.output_turn", "rad", "the same of angles"),
)


def feedforward(model: RobotModel, look_ahead: float | None) -> Block:
    """The block of a model; ArgumentError where it has no inverse dynamics.

    Parameters
    ----------
    model : RobotModel
    look_ahead : float or None
        Length of the horizon [s]; None: that of the generated library.
    """
    if (obstacle := inversion_reason(model, offered_functions(model))) is not None:
        raise ArgumentError(
            f"block 'feedforward': {obstacle}; the blocks plant and controller need no inverse "
            "dynamics"
        )
    equations = derive(model, ("payload",))
    offered = offered_functions(model)
    spec = with_defaults(
        model, library_spec(equations, [x for x in INVERTING if x in offered], parts=(POSITION,))
    )
    options = spec.stream
    servo = None if spec.motor_constants is None else spec.motor_constants.servo
    if options is None:
        raise ArgumentError(
            f"block 'feedforward': model {model.name} has no equilibrium at its home pose, or a "
            "singular one; expected a home pose that the tool can leave in all directions of "
            "the output"
        )
    options = options if servo is None else _at_samples(options, servo.sample_time)
    options = options if look_ahead is None else _with(options, look_ahead)
    spec = replace(
        spec,
        stream=options,
        c_functions=tuple(
            f for f in spec.c_functions if f.file == "stream.c" or f.name == "servo_defaults"
        ),
    )
    texts = merge_files(spec.name, emit(spec, function_texts(spec)))
    held = hold_joints(derive(model), np.array(model.home))
    name = f"{library_name(model)}_feedforward"
    prefix = spec.name
    sizes = {
        "N_A": model.n_a,
        "N_M": model.n_m,
        "N_OUT": model.output.size,
        "N_T": model.output.target_size,
    }
    sizes |= {} if servo is None else {"N_C": model.n_g}
    results = options.samples_per_interval * (
        2 * model.n_a + 3 * model.n_m + sizes.get("N_C", 0)
    ) + len(_FIGURES)
    return Block(
        name=name,
        title=name,
        text=f"feedforward: {model.description}",
        macro="FMU_FEEDFORWARD",
        variables=tuple(_variables(model, equations, held, options, servo)),
        sources={file: text for file, text in texts.items() if file != "example.c"},
        header=f"{prefix}.h",
        defines={
            **{key: str(size) for key, size in sizes.items()},
            "INTERVALS": str(options.intervals),
            "SAMPLES": str(options.samples_per_interval),
            "PERIOD": repr(options.period),
            "TOLERANCE": repr(options.tolerance),
            "N_STREAM": f"(int)({prefix.upper()}_STREAM_SIZE(INTERVALS, SAMPLES))",
            "P_MASS": "0",
            **({} if servo is None else {"HELD": f"{prefix.upper()}_HOLD_ZOH"}),
            "MODEL(name)": f"{prefix}_##name",
            "REFUSED_NOT_FINITE": f"{prefix.upper()}_INPUT_NOT_FINITE",
            "REFUSED_ARGUMENT": f"{prefix.upper()}_BAD_ARGUMENT",
            "REFUSED_UNREACHABLE": f"{prefix.upper()}_UNREACHABLE",
        },
        constants={"SETTING_LEAST": [], "SETTING_MOST": [], "Q_START": list(held.q_a)},
        sample_time=options.period / options.samples_per_interval,
        step=options.period / options.samples_per_interval,
        memory=f"N_STREAM + {results}",
        work="0",
        derivatives=False,
    )


def _with(options: StreamDefaults, look_ahead: float) -> StreamDefaults:
    """The options with another horizon."""
    intervals = round(look_ahead / options.period)
    if not 1 <= intervals <= INTERVALS_MAX or not math.isclose(
        intervals * options.period, look_ahead, rel_tol=1e-6
    ):
        raise ArgumentError(
            f"look_ahead: given {look_ahead} s, expected 1 to {INTERVALS_MAX} times the period "
            f"of {options.period:g} s"
        )
    return replace(options, look_ahead=intervals * options.period, intervals=intervals)


def _at_samples(options: StreamDefaults, h: float) -> StreamDefaults:
    """The options with samples every ``h`` [s], those of a servo."""
    samples = max(round(options.period / h), 1)
    intervals = math.ceil(options.look_ahead / (samples * h) - 1e-9)
    return replace(
        options,
        period=samples * h,
        samples_per_interval=samples,
        intervals=intervals,
        look_ahead=intervals * samples * h,
    )


def home_output(model: RobotModel, equations: Equations, q_a: np.ndarray) -> np.ndarray:
    """The output at a pose, (n_t,): for a pose of the tool its position, then the rotation matrix
    by columns.
    """
    y = evaluate(equations.function("output"), q_a)[0].ravel()
    if model.output.type == "combination":
        found: np.ndarray = np.array(model.output.weights) @ q_a
        return found
    if not model.output.is_pose:
        return np.array(y)
    R = evaluate(equations.function("forward_kinematics"), q_a)[1][0]
    return np.concatenate([y, R.reshape(3, 3).T.ravel()])


def _variables(
    model: RobotModel,
    equations: Equations,
    held: Equilibrium,
    options: StreamDefaults,
    servo: ServoTable | None,
) -> list[Variable]:
    """All variables."""
    return [
        time_variable(),
        *path_inputs(model, equations, held, options),
        *_outputs(model, held, servo),
        Variable("quality.status", STATUS, 0, "", "of the last update: " + "; ".join(
            f"{status.code} {status.text}" for status in STATUSES if status.code >= 0), 0),
        *payload_variables(equations),
    ]  # fmt: skip


def path_inputs(
    model: RobotModel, equations: Equations, held: Equilibrium, options: StreamDefaults
) -> list[Variable]:
    """Inputs of a sample of the path, which begins at the output of the robot held at home."""
    n_y = model.output.size
    n_t = model.output.target_size
    ahead = f"of the path, {options.look_ahead:g} s ahead"
    start = home_output(model, equations, held.q_a)
    pose = model.output.type == "tool_pose"
    before = list(output_units(model))
    units = before + ["1"] * 9 if pose else before
    rates = before + ["rad"] * 3 if pose else before
    out = []
    turn = model.output.tool_size - 1 if model.output.has_angle else -1
    for k in range(n_t):
        text = (
            f"position {ahead}"
            if k < len(before) or not pose
            else f"rotation matrix by columns {ahead}"
        )
        if k == turn:
            text = f"angle of the tool {ahead}"
        out.append(
            Variable(
                f"path.position[{k + 1}]", INPUT, k, units[k], text, float(start[k]), sampled=True
            )
        )
    for k in range(n_y):
        text = f"velocity {ahead}"
        out.append(
            Variable(
                f"path.velocity[{k + 1}]", INPUT, n_t + k, f"{rates[k]}/s", text, 0.0, sampled=True
            )
        )
    for k in range(n_y):
        text = f"acceleration {ahead}"
        name = f"path.acceleration[{k + 1}]"
        out.append(Variable(name, INPUT, n_t + n_y + k, f"{rates[k]}/s2", text, 0.0, sampled=True))
    return out


def _outputs(model: RobotModel, held: Equilibrium, servo: ServoTable | None) -> list[Variable]:
    """Outputs of the feedforward: torques, planned motion of motors and arm, figures of the
    stream, and positions to send to a servo, with start values at rest.
    """
    rows: list[tuple[str, str, str, float]] = []
    for k, m in enumerate(model.motors):
        rows.append(
            (f"motor.{m.name}.torque", "N.m", "feedforward torque, motor side", held.tau_m[k])
        )
    for k, m in enumerate(model.motors):
        rows.append(
            (
                f"motor.{m.name}.reference_angle",
                "rad",
                "motor angle of the planned motion",
                held.q_m[k],
            )
        )
    rows += [(f"motor.{m.name}.reference_speed", "rad/s", "its speed", 0.0) for m in model.motors]
    for k, c in enumerate(model.coordinates):
        rows.append(
            (
                f"arm.{c.name}.reference_position",
                c.unit,
                "arm coordinate of the planned motion",
                held.q_a[k],
            )
        )
    rows += [
        (f"arm.{c.name}.reference_speed", f"{c.unit}/s", "its speed", 0.0)
        for c in model.coordinates
    ]
    rows += [(name, unit, text, 0.0) for name, unit, text in _FIGURES]
    if servo is not None:
        gains = (servo.position_gain, servo.speed_gain, servo.integral_gain)
        offset = [
            0.0 if k_i > 0 else tau / (k_p * k_v)
            for tau, k_p, k_v, k_i in zip(held.tau_m, *gains, strict=True)
        ]
        start = np.linalg.solve(model.eta, held.q_m + offset)
        for k, c in enumerate(model.coordinates[i] for i in model.i_g):
            rows.append(
                (f"arm.{c.name}.command", c.unit, "position to send to the servo", start[k])
            )
    return [
        Variable(name, OUTPUT, k, unit, text, float(start), sampled=True, depends=())
        for k, (name, unit, text, start) in enumerate(rows)
    ]
