"""The C interface of a library, one row for each fact: version, statuses, enums, limits and structs.

Headers, C, manifest, and by way of the manifest the Python wrapper, are rendered from these rows. Functions of one and
of many points are rows of `flexgen.mechanics.signatures`, hand-written ones rows of `flexgen.codegen.c_functions`.
"""

from __future__ import annotations

from flexgen.codegen.clib_types import Field, Status, Struct
from flexgen.codegen.limited_functions import LIMITS_STRUCT

ABI_VERSION = 4
INTERVALS_MAX, SAMPLES_MAX = 10_000, 1_000  # of a stream: intervals of its horizon, samples per interval
DELAY_MAX = 4  # of the drive, in samples
PARTS = ("bvp",)  # optional parts of a library: hand-written functions that it has only where they are asked for
TOLERANCES = {"double": 1e-6, "single": 1e-3}  # recommended relative residuals
START_SAMPLES = 16  # that a stream needs beyond those of its horizon to start in motion
HOLDS = ("spline", "linear", "zoh")  # what the drive does between two samples, numbered in C


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
    Status("BAD_COUNT", -4, "the number of points is negative, or above the stride", "ArgumentError"),
    Status(
        "BAD_ARGUMENT",
        -5,
        "a size, a time or a rotation matrix is out of range, or the path does not begin and end at zero velocity",
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
    Status("NOT_STARTED", -9, "the stream was not started, or has failed", "ArgumentError"),
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
        "the horizon is too short to keep limits: use at least 4 intervals, and 1.5 times the preview of the zeros",
        "ArgumentError",
    ),
    Status(
        "LIMITS_INFEASIBLE",
        -14,
        "the limits cannot be kept; increase them, slow down the path or give the motion more time",
        "SolverError",
    ),
    Status(
        "TOLERANCE_NOT_MET",
        1,
        "residual, kinematic mismatch or torque step above its tolerance (see the info): use a shorter period",
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
    "largest residual of the unactuated rows, relative to the torques of a deflection of 0.01 rad or 0.01 m; 1e-6 is "
    "what flexgen solve uses (single precision: 1e-3)"
)
_HOLD = (
    Field(
        "hold",
        "int",
        (),
        "1",
        "what the drive does between two samples of tau_m, one of the enum; tau_m is then what to send at the samples",
    ),
    Field(
        "delay",
        "real",
        (),
        "1",
        f"from a sample until the motor has its torque, in samples, 0 to {DELAY_MAX}",
    ),
)
STRUCTS: tuple[Struct, ...] = (
    Struct(
        "path",
        "Samples of the output, one period apart. The output is at rest at the first and at the last sample.",
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
        "Options of invert and bvp.",
        (
            Field("n_pre", "int", (), "1", "samples before the path, for the motion that unstable zeros require"),
            Field(
                "n_post",
                "int",
                (),
                "1",
                "samples after the path, in which stable zeros and the deflections of damped gears decay",
            ),
            Field("samples_per_interval", "int", (), "1", "samples per interval of the mesh"),
            Field("tolerance", "real", (), "1", _TOLERANCE),
            *_HOLD,
            Field(
                "settled",
                "real",
                (),
                "1",
                "0: the motion after the path is computed at all n_post samples. invert, invert_limited: where what is "
                "left of it moves the output by less than this [m or rad], at least 0.05 s and 20 D / K of the slowest "
                "gear after the path, the samples from there on are the equilibrium. bvp: 0",
            ),
        ),
    ),
    Struct(
        "motion",
        "Arrays of the caller for the results, N samples each. A null member is not written.",
        (
            Field("q_a", "real *", ("N", "n_a"), "mixed", "arm coordinates"),
            Field("v_a", "real *", ("N", "n_a"), "mixed", "arm velocities"),
            Field("a_a", "real *", ("N", "n_a"), "mixed", "arm accelerations; not written by a stream"),
            Field("tau_g", "real *", ("N", "n_g"), "mixed", "gear torques, arm side"),
            Field("q_m", "real *", ("N", "n_m"), "rad", "motor angles"),
            Field("v_m", "real *", ("N", "n_m"), "rad/s", "motor speeds"),
            Field("tau_m", "real *", ("N", "n_m"), "N m", "motor torques"),
        ),
    ),
    Struct(
        "inversion_info",
        "What invert and bvp report.",
        (
            Field(
                "residual", "real", (), "1", "residual of the unactuated rows on the mesh, relative as the tolerance"
            ),
            Field("residual_at_samples", "real", (), "1", "the same at the samples of the results"),
            Field(
                "kinematic_mismatch",
                "real",
                (),
                "1",
                "largest difference between velocities and accelerations and the numerical derivatives of positions "
                "and velocities at the samples, relative to their largest value",
            ),
            Field("iterations", "int", (), "1", "Newton iterations"),
            Field("intervals", "int", (), "1", "intervals of the mesh"),
            Field("deviation_m", "real", (), "m", "invert_limited: largest distance from the given path; else 0"),
            Field("deviation_rad", "real", (), "rad", "the same of angles"),
            Field("limit_excess", "real", (), "1", "invert_limited: largest violation of a limit, relative; else 0"),
            Field("programs", "int", (), "1", "invert_limited: quadratic programs; else 0"),
            Field("unstable_zeros_start", "int", (), "1", "bvp: unstable zeros at the start of the path; else 0"),
            Field("unstable_zeros_end", "int", (), "1", "bvp: unstable zeros at its end; else 0"),
            Field(
                "n_post",
                "int",
                (),
                "1",
                "samples after the path until the motion has settled; the last of them, and all after it, are the "
                "equilibrium. n_post of the options where it has not settled, or settled is 0",
            ),
        ),
    ),
    LIMITS_STRUCT,
    Struct(
        "stream_options",
        "Options of a stream.",
        (
            Field("intervals", "int", (), "1", f"intervals of the horizon, 1 to {INTERVALS_MAX}"),
            Field("samples_per_interval", "int", (), "1", f"samples of the results per update, 1 to {SAMPLES_MAX}"),
            Field("period", "real", (), "s", "time between two updates: the length of an interval"),
            Field("tolerance", "real", (), "1", _TOLERANCE),
            *_HOLD,
        ),
    ),
    Struct(
        "stream_info",
        "What stream_update reports.",
        (
            Field("residual", "real", (), "1", "residual of the unactuated rows, relative as the tolerance"),
            Field("kinematic_mismatch", "real", (), "1", "as in inversion_info, limit 0.02 (single precision: 0.25)"),
            Field(
                "torque_step",
                "real",
                (),
                "1",
                "largest step of a motor torque from the interval before, relative to its largest value; limit 2e-4 "
                "(single precision: 5e-3)",
            ),
            Field(
                "output_step_m",
                "real",
                (),
                "m",
                "distance by which the output leaves the plan before because the horizon is too short. No estimate of "
                "the error where it is long enough: mesh, samples and hold are not in it, only a simulation has them",
            ),
            Field("output_step_rad", "real", (), "rad", "the same of angles"),
            Field("deviation_m", "real", (), "m", "distance of the modified path from the given one"),
            Field("deviation_rad", "real", (), "rad", "angle between both"),
            Field("iterations", "int", (), "1", "iterations of the solver: 1"),
            Field("intervals", "int", (), "1", "intervals of the horizon"),
            Field(
                "cause",
                "int",
                (),
                "1",
                "of TOLERANCE_NOT_MET: 1 residual, 2 kinematic mismatch (samples too far apart, or a path that is not "
                "smooth), 3 torque step (horizon too short); else 0",
            ),
            Field("limits_active", "int", (), "1", "1 where limits modify the path or are exceeded, else 0"),
        ),
    ),
)
