"""The C interface of a library, one row for each fact: version, statuses, enums, limits and
structs.

Headers, C, manifest, and by way of the manifest the Python wrapper, are rendered from these rows.
Functions of one and of many points are rows of `flexgen.dynamics.mechanics.signatures`,
hand-written ones rows of `flexgen.codegen.emission.c_functions`.
"""

from __future__ import annotations

from dataclasses import replace

from flexgen.codegen.emission.clib_types import Enum, Field, Limit, Status, Struct
from flexgen.runtime.identity import ABI_VERSION as ABI_VERSION
from flexgen.runtime.identity import TOLERANCES

# of a stream: intervals of its horizon, samples per interval
INTERVALS_MAX = 10_000
SAMPLES_MAX = 1_000
DELAY_MAX = 4  # of the drive, in samples
DERIVATIVES = "derivatives"
FORCE = "force"
POSITION = "position"
BOUNDS = "limits"  # all limits in a stream
# optional: a solver, products, process forces, limits, positions
PARTS = ("bvp", DERIVATIVES, FORCE, BOUNDS, POSITION)
START_SAMPLES = 16  # that a stream needs beyond those of its horizon to start in motion
LIMITS = (
    Limit("STREAM_INTERVALS_MAX", INTERVALS_MAX, "intervals of a horizon, at most"),
    Limit("STREAM_SAMPLES_MAX", SAMPLES_MAX, "samples per interval, at most"),
    Limit(
        "STREAM_MORE_SAMPLES", START_SAMPLES, "that stream_start_moving takes beyond the intervals"
    ),
    Limit("HOLD_DELAY_MAX", DELAY_MAX, "delay of a hold in samples, at most"),
)
ENUMS = (
    Enum(
        "hold",
        "What the drive does between two samples of the motor torque. With HOLD_LINEAR and "
        "HOLD_ZOH, tau_m has the torques to send at the samples, not the torques there: a held "
        "sample is late by half a period. All other results are those at the samples.",
        (
            ("spline", "follows a spline through the samples"),
            ("linear", "follows a straight line to the next sample"),
            ("zoh", "holds each sample until the next one (zero-order hold)"),
        ),
    ),
    Enum(
        "interpolation",
        "What a robot makes of the positions that it is sent.",
        (
            ("hold", "stays at a position until the next one"),
            ("linear", "follows a straight line to the next one"),
            (
                "cubic",
                (
                    "follows polynomials; the speed at a position is that of the line between "
                    "its neighbors"
                ),
            ),
        ),
    ),
    Enum(
        "cause",
        "Why a stream did not meet its tolerance.",
        (
            ("none", "it did"),
            ("residual", "residual above the tolerance"),
            (
                "mismatch",
                "kinematic mismatch: samples too far apart, or a path that is not smooth",
            ),
            ("torque_step", "step of a motor torque: horizon too short"),
        ),
    ),
)


STATUSES = (
    Status("OK", 0, "success"),
    Status("NULL_ARGUMENT", -1, "an argument is a null pointer", "ArgumentError"),
    Status("INPUT_NOT_FINITE", -2, "an input is not finite; the outputs are NaN", "ArgumentError"),
    Status(
        "RESULT_NOT_FINITE",
        -3,
        "a result is not finite: the system of equations is singular, or a number overflows",
        "SolverError",
    ),
    Status(
        "BAD_COUNT", -4, "the number of points is negative, or above the stride", "ArgumentError"
    ),
    Status(
        "BAD_ARGUMENT",
        -5,
        "a size, a time or a rotation matrix is out of range, or the path does not begin and "
        "end at zero velocity",
        "ArgumentError",
    ),
    Status("WORK_TOO_SMALL", -6, "the workspace is too small", "ArgumentError"),
    Status(
        "UNREACHABLE",
        -7,
        "the path leaves the workspace of the robot or passes a singular pose",
        "SolverError",
    ),
    Status("NOT_CONVERGED", -8, "the iteration did not converge", "SolverError"),
    Status(
        "NOT_STARTED",
        -9,
        "the stream was not started by this library, or has failed",
        "ArgumentError",
    ),
    Status(
        "ZERO_AT_INFINITY",
        -10,
        "a zero of the zero dynamics goes through infinity on the path; use invert (method lq)",
        "SolverError",
    ),
    Status(
        "ZEROS_CHANGE",
        -11,
        "the number of unstable zeros differs between start and end; use invert (method lq)",
        "SolverError",
    ),
    Status(
        "ZERO_ON_AXIS",
        -12,
        "a zero is on the imaginary axis at an end of the path; use invert (method lq)",
        "SolverError",
    ),
    Status(
        "HORIZON_TOO_SHORT",
        -13,
        "the horizon is too short to keep limits: use at least 4 intervals, and 1.5 times the "
        "preview of the zeros",
        "ArgumentError",
    ),
    Status(
        "LIMITS_INFEASIBLE",
        -14,
        "the limits cannot be kept; increase them, slow down the path or give the motion more "
        "time",
        "SolverError",
    ),
    Status(
        "TOLERANCE_NOT_MET",
        1,
        "residual, mismatch, torque step or torque error above its tolerance (see the info): "
        "use a shorter period",
    ),
    Status(
        "LIMITS_ACTIVE",
        2,
        "the limits move the output away from its path, or are exceeded; the info says how far",
    ),
)

OUTPUT = "output; for a pose the position, then the rotation matrix by columns"
RATE = "its first time derivative; for a pose linear and angular velocity, world axes"
SECOND = "its second time derivative; for a pose linear and angular acceleration"
_TOLERANCE = (
    "largest residual of the unactuated rows, relative to the torques of a deflection of 0.01 "
    "rad or 0.01 m; 1e-6 is what flexgen solve uses (single precision: 1e-3)"
)
_HOLD = (
    Field(
        "hold", "hold", (), "", "what the drive does between two samples of tau_m", "HOLD_SPLINE"
    ),
    Field(
        "delay",
        "real",
        (),
        "1",
        f"from a sample until the motor has its torque, in samples, 0 to {DELAY_MAX}",
        "0.0",
    ),
)
_FOUND = (
    Field(
        "residual",
        "real",
        (),
        "1",
        "residual of the unactuated rows on the mesh, relative as the tolerance",
    ),
    Field("residual_at_samples", "real", (), "1", "the same at the samples of the results"),
    Field(
        "kinematic_mismatch",
        "real",
        (),
        "1",
        "largest difference between velocities and accelerations and the numerical derivatives "
        "of positions and velocities at the samples, relative to their largest value",
    ),
)
_COUNTS = (
    Field("iterations", "int", (), "1", "Newton iterations"),
    Field("intervals", "int", (), "1", "intervals of the mesh"),
)
_SETTLED = Field(
    "n_post",
    "int",
    (),
    "1",
    "samples after the path until the motion has settled; all after it are the equilibrium. "
    "Without the option settled, or where the motion has not settled: n_post of the options",
)
_GROWTH = Field(
    "growth",
    "real",
    (),
    "1",
    "largest growth of a perturbation along the motion, see the function growth: above about "
    "100 the torques need feedback; NaN where the option growth is 0, or the motion grows "
    "beyond all numbers",
)
_TORQUE_ERROR = Field(
    "torque_error",
    "real",
    (),
    "1",
    "estimate of the largest error of a motor torque by the mesh, relative to the largest "
    "torque of this motor",
)
STRUCTS: tuple[Struct, ...] = (
    Struct(
        "samples",
        "Samples of the output, one period apart. The output is at rest at the first and at the "
        "last sample.",
        (
            Field("n", "int", (), "1", "number of samples, at least 2"),
            Field("period", "real", (), "s", "time between two samples"),
            Field("y", "const real *", ("n", "n_t"), "mixed", OUTPUT),
            Field("dy", "const real *", ("n", "n_y"), "mixed", RATE),
            Field("ddy", "const real *", ("n", "n_y"), "mixed", SECOND),
        ),
    ),
    Struct(
        "inversion_options",
        "Options of a whole path; inversion_defaults gives their defaults.",
        (
            Field(
                "n_pre",
                "int",
                (),
                "1",
                "samples before the path, for the motion that unstable zeros require",
                "0",
            ),
            Field(
                "n_post",
                "int",
                (),
                "1",
                "samples after the path, in which stable zeros and the deflections of damped "
                "gears decay",
                "0",
            ),
            Field("samples_per_interval", "int", (), "1", "samples per interval of the mesh", "1"),
            Field("tolerance", "real", (), "1", _TOLERANCE, "tolerance"),
            *_HOLD,
            Field(
                "settled",
                "real",
                (),
                "1",
                "above 0: the samples after the path end once the residual motion changes the "
                "output by less than this [m or rad], but not before 0.05 s and 20 D / K of the "
                "slowest gear; 0: all n_post samples are computed, as bvp does",
                "0.0",
            ),
            Field(
                "growth",
                "int",
                (),
                "1",
                "1: the info of invert and invert_limited has the growth too, for a library "
                "with linearize; the motion needs q_a, v_a, q_m, v_m and tau_m. 0: NaN",
                "0",
            ),
        ),
    ),
    Struct(
        "motion",
        "Arrays of the caller for the results, N samples each. A null member is not written.",
        (
            Field("q_a", "real *", ("N", "n_a"), "mixed", "arm coordinates"),
            Field("v_a", "real *", ("N", "n_a"), "mixed", "arm velocities"),
            Field(
                "a_a",
                "real *",
                ("N", "n_a"),
                "mixed",
                "arm accelerations; not written by a stream",
            ),
            Field("tau_g", "real *", ("N", "n_g"), "mixed", "gear torques, arm side"),
            Field("q_m", "real *", ("N", "n_m"), "rad", "motor angles"),
            Field("v_m", "real *", ("N", "n_m"), "rad/s", "motor speeds"),
            Field("tau_m", "real *", ("N", "n_m"), "N m", "motor torques"),
        ),
    ),
    Struct(
        "problems",
        "Problems of invert_many, one behind the other in its arrays.",
        (
            Field("count", "int", (), "1", "number of problems"),
            Field(
                "own_path",
                "int",
                (),
                "1",
                "1: each has its own y, dy and ddy; 0: all have those of one path",
            ),
            Field(
                "own_parameters",
                "int",
                (),
                "1",
                "1: each has its own run-time parameters; 0: all have the same",
            ),
            Field(
                "own_q_start", "int", (), "1", "1: each has its own q_start; 0: all have the same"
            ),
        ),
    ),
    Struct(
        "invert_info",
        "What invert reports.",
        (*_FOUND, *_COUNTS, _SETTLED, _GROWTH, _TORQUE_ERROR),
    ),
    Struct(
        "bvp_info",
        "What bvp reports.",
        (
            *_FOUND,
            *_COUNTS,
            Field(
                "unstable_zeros_start", "int", (), "1", "unstable zeros at the start of the path"
            ),
            Field("unstable_zeros_end", "int", (), "1", "unstable zeros at its end"),
        ),
    ),
    Struct(
        "inversion_limits",
        "Limits of invert_limited. A null member or an infinite entry means no limit.",
        (
            Field(
                "torque_max", "const real *", ("n_m",), "N m", "largest motor torques, positive"
            ),
            Field(
                "speed_max", "const real *", ("n_m",), "rad/s", "largest motor speeds, positive"
            ),
            Field(
                "deflection_max",
                "const real *",
                ("n_e",),
                "mixed",
                "largest deflections of the unactuated coordinates",
            ),
            Field(
                "knot_samples",
                "int",
                (),
                "1",
                "samples between two knots of the deviation; 0: a thirtieth of the path",
            ),
            Field(
                "deviation",
                "real *",
                ("n", "n_y"),
                "mixed",
                "result: deviation from the path; not written if null",
            ),
            Field(
                "gear_torque_max",
                "const real *",
                ("n_g",),
                "mixed",
                "largest torques of the gears, arm side",
            ),
            Field(
                "torque_rate_max",
                "const real *",
                ("n_m",),
                "N m/s",
                "largest rates of motor torques, from samples",
            ),
            Field(
                "joint_speed_max",
                "const real *",
                ("n_g",),
                "mixed",
                "largest speeds of the actuated joints",
            ),
            Field(
                "joint_acceleration_max",
                "const real *",
                ("n_g",),
                "mixed",
                "largest accelerations of these joints",
            ),
            Field(
                "tool_speed_max",
                "real",
                (),
                "m/s",
                "of a path of the tool: its largest speed; 0: no limit",
            ),
            Field(
                "tool_acceleration_max",
                "real",
                (),
                "m/s^2",
                "its largest acceleration; 0: no limit",
            ),
            Field(
                "torque_speed",
                "const real *",
                ("n_m", "torque_speed_points", "2"),
                "rad/s, N m",
                "points (speed, torque) of the largest motor torques over the speed: a convex "
                "region, from speed 0 on, the last point repeated where a motor has fewer",
            ),
            Field(
                "torque_speed_points",
                "int",
                (),
                "1",
                "points of each motor, at least 2; ignored without a curve",
            ),
        ),
    ),
    Struct(
        "invert_limited_info",
        "What invert_limited reports.",
        (
            *_FOUND,
            Field("deviation_m", "real", (), "m", "largest distance from the given path"),
            Field("deviation_rad", "real", (), "rad", "the same of angles"),
            Field("limit_excess", "real", (), "1", "largest violation of a limit, relative"),
            Field("programs", "int", (), "1", "quadratic programs"),
            *_COUNTS,
            _SETTLED,
            _GROWTH,
        ),
    ),
    Struct(
        "stream",
        "A stream: memory of the caller that holds its whole state. Copy the memory to copy the "
        "stream.",
        (
            Field("memory", "real *", ("size",), "", ""),
            Field("size", "int64_t", (), "1", "its length, at least stream_work"),
        ),
    ),
    Struct(
        "stream_options",
        "Options of a stream; stream_defaults gives those that are recommended for the model.",
        (
            Field(
                "intervals",
                "int",
                (),
                "1",
                f"intervals of the horizon, 1 to {INTERVALS_MAX}",
                "STREAM_INTERVALS",
            ),
            Field(
                "samples_per_interval",
                "int",
                (),
                "1",
                f"samples of the results per update, 1 to {SAMPLES_MAX}",
                "STREAM_SAMPLES_PER_INTERVAL",
            ),
            Field(
                "period",
                "real",
                (),
                "s",
                "time between two updates: the length of an interval",
                "STREAM_PERIOD",
            ),
            Field("tolerance", "real", (), "1", _TOLERANCE, "tolerance"),
            *_HOLD,
        ),
    ),
    Struct(
        "stream_info",
        "What stream_update reports.",
        (
            Field(
                "residual",
                "real",
                (),
                "1",
                "residual of the unactuated rows, relative as the tolerance",
            ),
            Field(
                "kinematic_mismatch",
                "real",
                (),
                "1",
                "as in invert_info, limit 0.02 (single precision: 0.25)",
            ),
            Field(
                "torque_step",
                "real",
                (),
                "1",
                "largest step of a motor torque from the interval before, relative to its "
                "largest value; limit 2e-4 (single precision: 5e-3)",
            ),
            Field(
                "output_step_m",
                "real",
                (),
                "m",
                "distance by which the output leaves the plan before because the horizon is too "
                "short. No estimate of the error where it is long enough: mesh, samples and "
                "hold are not in it, only a simulation has them",
            ),
            Field("output_step_rad", "real", (), "rad", "the same of angles"),
            Field(
                "deviation_m", "real", (), "m", "distance of the modified path from the given one"
            ),
            Field("deviation_rad", "real", (), "rad", "angle between both"),
            Field("cause", "cause", (), "", "of TOLERANCE_NOT_MET"),
            Field(
                "limits_active",
                "int",
                (),
                "1",
                "1 where limits modify the path or are exceeded, else 0",
            ),
        ),
    ),
)


_FORCE = Field(
    "force",
    "const real *",
    ("n", "3 * n_y"),
    "mixed",
    "force on the output, dual to dy: of a pose force [N], then torque [N m] on the tool, world "
    "axes; then its first and its second time derivative. Before the first and after the last "
    "sample it stays as it is there. With own_path of invert_many each problem has its own. "
    "Null: none",
)
_HELD_FORCE = Field(
    "force",
    "const real *",
    ("n_y",),
    "mixed",
    "force on the output at the start, as in samples; it stays until stream_force. "
    "stream_start_moving takes that of its samples. Null: none",
    "0",
)


_SERVO = Struct(
    "servo",
    "The position servo of the motors, motor side; servo_defaults gives that of the model file.",
    (
        Field("position_gain", "const real *", ("n_m",), "1/s", "k_p, positive"),
        Field("speed_gain", "const real *", ("n_m",), "N m s/rad", "k_v, positive"),
        Field("integral_gain", "const real *", ("n_m",), "1/s", "k_i, at least 0"),
        Field(
            "speed_feedforward", "real", (), "1", "f, part of the speed of the reference, 0 to 2"
        ),
        Field(
            "reference_filter",
            "real",
            (),
            "s",
            "T, time constant of the filter of the reference; 0: none",
        ),
        Field(
            "sample_time",
            "real",
            (),
            "s",
            "h, of the samples of the results; filters need that of the model file",
        ),
        Field(
            "delay",
            "real",
            (),
            "s",
            "from its sample to the torque; the option delay is delay / h",
        ),
    ),
)
_INTERFACE = Struct(
    "robot_interface",
    "The interface of a robot that takes positions.",
    (
        Field(
            "samples_per_position",
            "int",
            (),
            "1",
            "samples of the servo from one position to the next",
        ),
        Field("interpolation", "interpolation", (), "", "of the robot between two positions"),
    ),
)
_OF_SERVO = Field(
    "servo",
    "const servo *",
    (),
    "",
    "that is sent positions; needs HOLD_ZOH, and samples and delay as it has them. Null: none, "
    "commands are NaN",
    "0",
)
_COMMANDS = (
    Field(
        "command_m",
        "real *",
        ("N", "n_m"),
        "rad",
        "positions to send, motor side: the reference of the servo",
    ),
    Field(
        "command_g",
        "real *",
        ("N", "n_g"),
        "mixed",
        "the same of the joints, as rigid gears would turn them",
    ),
)


def structs_with(force: bool, position: bool) -> tuple[Struct, ...]:
    """The structs of a library, with forces in the samples of a path, with commands of position,
    or without.
    """
    more: dict[str, tuple[Field, ...]] = {"samples": (_FORCE,)} if force else {}
    more |= {"inversion_options": (_OF_SERVO,), "motion": _COMMANDS} if position else {}
    more |= {"stream_options": (*(_HELD_FORCE,) * force, *(_OF_SERVO,) * position)}
    return tuple(
        replace(s, fields=(*s.fields, *more.get(s.name, ())))
        for s in (*(_SERVO, _INTERFACE) * position, *STRUCTS)
    )


def default_of(field: Field, precision: str) -> str:
    """The default of a member of options in C, without the library's name."""
    return repr(TOLERANCES[precision]) if field.default == "tolerance" else field.default
