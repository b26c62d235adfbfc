"""The hand-written functions of the library: their arguments and descriptions.

They come with every library of a model that can be inverted, with all functions of `INVERTING`;
those of `PARTS` only where they are asked for, `bvp` in double precision only. With run-time
parameters they have one more argument. Inverse kinematics comes with arms of six motors or more.
Their C is in ``flexgen/codegen/clib/``, see `flexgen.codegen.emission.clib_files`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission.clib_types import CFunction, Field
from flexgen.codegen.emission.interface import (
    BOUNDS,
    DERIVATIVES,
    FORCE,
    OUTPUT,
    PARTS,
    POSITION,
    RATE,
    SECOND,
)
from flexgen.codegen.emission.kinematic_functions import kinematic_functions
from flexgen.codegen.emission.limited_functions import LIMITED_FUNCTIONS
from flexgen.codegen.emission.motor_constants import position_obstacle
from flexgen.codegen.emission.position_functions import POSITION_FUNCTIONS
from flexgen.codegen.emission.sampler_functions import SAMPLER_FUNCTIONS
from flexgen.dynamics.mechanics.signatures import INVERTING, offered_functions
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel

_N = "n_pre + n + n_post"
_PARAMETERS = "run-time parameters, listed in the header of the functions"
_BEHIND_PARAMETERS = (("q_start", "const real *"), ("t", "real"), ("growth", "real *"))
_GIVEN = Field("parameters", "const real *", ("n_p",), "mixed", _PARAMETERS)

_FORCE_OF_PATH = (
    Field(
        "force",
        "const real *",
        ("n_force", "3 * n_y"),
        "mixed",
        "on the output, as in the samples of the path; null: none",
    ),
    Field("n_force", "int", (), "1", "number of samples of the path; not read without force"),
    Field(
        "n_pre", "int", (), "1", "samples of the motion before the path; not read without force"
    ),
)
_UNDER_FORCE = (
    "A force on the output adds its stiffness, that of a direction which does not turn with the "
    "tool: the first n_y numbers of each sample are read. Before the path and after it the force "
    "stays as it is at its ends. The motion must be the one under this force."
)


def _whole(info: str) -> tuple[Field, ...]:
    """The arguments of a solver of whole paths with this info."""
    return (
        Field("samples", "const samples *", (), "", "samples of the output"),
        Field(
            "q_start",
            "const real *",
            ("n_a",),
            "mixed",
            "initial guess of the equilibrium at the first sample",
        ),
        Field("options", "const inversion_options *", (), "", ""),
        Field("motion", "motion *", (), "", f"results; N = {_N}"),
        Field("info", f"{info} *", (), "", "what the solver reports"),
        Field("work", "real *", ("work_size",), "", "workspace"),
    )


_WORK_OF = (
    Field("n", "int", (), "1", "samples of the path"),
    Field("options", "const inversion_options *", (), "", ""),
)


_STREAM = Field("stream", "const stream *", (), "", "")


def _size(of: str) -> Field:
    return Field("work_size", "int64_t", (), "1", f"its length, at least {of}_work")


C_FUNCTIONS: tuple[CFunction, ...] = (
    CFunction(
        "inversion_defaults",
        "",
        "The defaults of the options of a whole path.",
        "",
        (),
        returns="inversion_options",
    ),
    CFunction(
        "stream_defaults",
        "",
        "The recommended options of a stream; the intervals and the period are 0 where the home "
        "pose has none.",
        "",
        (),
        returns="stream_options",
    ),
    CFunction(
        "invert_work",
        "invert.c",
        "Length of the workspace of invert, in reals; -1 where an option is out of range.",
        "",
        _WORK_OF,
        returns="size",
    ),
    CFunction(
        "invert",
        "invert.c",
        "Inverse dynamics along a whole path: motion of arm and motors, and motor torques, for "
        "exact tracking of the output.",
        "The output is at rest before the path and after it. The arm starts at equilibrium. Its "
        "unactuated coordinates move before the path where zeros are unstable (n_pre), and "
        "after it until the stable zeros have decayed (n_post). OK: the residual is within the "
        "tolerance on the mesh and within 100 tolerances at the samples (single precision: "
        "within the tolerance), the kinematic mismatch is below 0.02 (0.25), and the torque "
        "error is at most 0.005 (or the residual at the samples within the tolerance); with "
        "Fourier sums of motor angles a residual within a hundredth of the tolerance replaces "
        "it. A residual of 1e-4 at the samples moves the output by at most 1e-5 rad, and m for "
        "each meter of reach: what flexgen solve accepts. TOLERANCE_NOT_MET: the iteration "
        "converged on the mesh, but the result between its nodes is not accurate: use a shorter "
        "period of the mesh (fewer samples_per_interval, or a shorter sampling period), or a "
        "smoother path. Do not use the results where the status is negative. BAD_ARGUMENT also "
        "means that the path does not begin and end at rest. UNREACHABLE also means that no "
        "equilibrium was found from q_start. Without unactuated coordinates nothing is solved "
        "and the residual is zero. Arrays are stored sample after sample: entry i of sample k "
        "is x[k * n_a + i].",
        (*_whole("invert_info"), _size("invert")),
    ),
    CFunction(
        "invert_many",
        "invert.c",
        "The function invert for many problems: paths, run-time parameters and starts that "
        "differ or are shared.",
        "Each problem has the bits of invert, its own status and its own info. A problem that "
        "fails affects no other; its results are NaN. The status of the first problem with a "
        "negative one is returned. The problems are solved one after the other in one "
        "workspace, that of invert: for several cores, give each thread a part of the arrays "
        "and a workspace of its own.",
        (
            Field("problems", "const problems *", (), "", ""),
            Field(
                "samples",
                "const samples *",
                (),
                "",
                "samples of the outputs: n and period of all paths are equal",
            ),
            Field(
                "q_start",
                "const real *",
                ("count", "n_a"),
                "mixed",
                "initial guesses, as of invert",
            ),
            Field("options", "const inversion_options *", (), "", ""),
            Field("motion", "motion *", (), "", f"results, count times N = {_N}"),
            Field("info", "invert_info *", ("count",), "", "what the solver reports"),
            Field("statuses", "status *", ("count",), "", "of each problem"),
            Field("work", "real *", ("work_size",), "", "workspace"),
            _size("invert"),
        ),
    ),
    CFunction(
        "bvp_work",
        "bvp.c",
        "Length of the workspace of bvp, in reals; -1 where an option is out of range.",
        "",
        _WORK_OF,
        returns="size",
        elastic=True,
        double=True,
        part="bvp",
    ),
    CFunction(
        "bvp",
        "bvp.c",
        "Inverse dynamics along a whole path as a two-point boundary value problem: an "
        "independent check of invert.",
        "Nothing is weighted, so the equations hold to rounding on the mesh. At the start the "
        "state may differ from equilibrium in the unstable directions of the zero dynamics, at "
        "the end in the stable ones. This requires the same number of unstable zeros at both "
        "ends (else ZEROS_CHANGE), no zero on the imaginary axis there (ZERO_ON_AXIS), and no "
        "zero that goes through infinity on the path (ZERO_AT_INFINITY). invert has none of "
        "these requirements.",
        (*_whole("bvp_info"), _size("bvp")),
        elastic=True,
        double=True,
        part="bvp",
    ),
    CFunction(
        "growth_work",
        "growth.c",
        "Length of the workspace of growth, in reals.",
        "",
        (),
        returns="size",
    ),
    CFunction(
        "growth",
        "growth.c",
        "Largest growth of a perturbation from the start of a motion to an instant of it, under "
        "motor torques alone.",
        "Errors of the model and of the start grow by this factor: where it is above about 100 "
        "only feedback keeps the robot on its path. It is the largest singular value of the "
        "transition matrix of the positions, of motors on the arm side, with the linearization "
        "every 10 ms (at most 1000 times); at most 1e300 (single precision: 1e37). Samples at "
        "the end in which the arm is at rest do not count; where there are any, the last torque "
        "is held for 0.5 s. The members q_a, v_a, q_m, v_m and tau_m of the motion are read, "
        "such as invert has written them; with a hold the factor is approximate.",
        (
            Field("motion", "const motion *", (), "", "N = n samples"),
            Field("n", "int", (), "1", "number of samples, at least 2"),
            Field("period", "real", (), "s", "time between two samples"),
            Field("growth", "real *", ("1",), "1", "result, at least 1"),
            Field("work", "real *", ("work_size",), "", "workspace"),
            _size("growth"),
        ),
    ),
    CFunction(
        "stream_work",
        "stream.c",
        "Length of the memory of a stream, in reals; -1 where an option is out of range.",
        "",
        (Field("options", "const stream_options *", (), "", ""),),
        returns="size",
    ),
    CFunction(
        "stream_start",
        "stream.c",
        "Start a stream: inverse dynamics on a moving horizon, at rest at a given output.",
        "The memory holds the whole state of the stream. It may be copied and moved between "
        "calls. Each stream needs its own. A stream that has failed can be started again.",
        (
            _STREAM,
            Field("options", "const stream_options *", (), "", ""),
            Field("y", "const real *", ("n_t",), "mixed", OUTPUT),
            Field(
                "q_start", "const real *", ("n_a",), "mixed", "initial guess of the equilibrium"
            ),
        ),
    ),
    CFunction(
        "stream_update",
        "stream.c",
        "Take the path sample at the end of the horizon; give motion and torques of the "
        "interval that starts now.",
        "The output reaches the sample after as many updates as the horizon has intervals. An "
        "update is one iteration of the solver, with a bounded number of operations. A sample "
        "that is refused (INPUT_NOT_FINITE, BAD_ARGUMENT, UNREACHABLE) changes nothing. After "
        "any other negative status the stream has failed, and later updates return NOT_STARTED. "
        "OK: in this interval the residual is within the tolerance, the kinematic mismatch is "
        "below 0.02 (single precision: 0.25), and the motor torque continues that of the "
        "interval before within 2e-4 (5e-3) of its largest value. TOLERANCE_NOT_MET: one of "
        "these three is too large; the cause in the info shows which. Motion below 3e-8 m or "
        "rad (1e-5) within an interval and steps of the output below 1e-8 m or rad (1e-6) are "
        "not counted. Reasons are a path that is not smooth, a horizon that is too short for "
        "the unstable zeros, a sampling period that is too long or too short, or fewer than 7 "
        "samples in the rest of the horizon: (intervals - 1) * samples_per_interval < 7 (with a "
        "hold 11, and the delay). TOLERANCE_NOT_MET and LIMITS_ACTIVE are positive and come "
        "with results. To stop, repeat the last position with zero derivatives until the "
        "results are at rest, at least for a whole horizon.",
        (
            _STREAM,
            Field("y", "const real *", ("n_t",), "mixed", OUTPUT),
            Field("dy", "const real *", ("n_y",), "mixed", RATE),
            Field("ddy", "const real *", ("n_y",), "mixed", SECOND),
            Field("motion", "motion *", (), "", "results; N = samples_per_interval"),
            Field("info", "stream_info *", (), "", "what the solver reports"),
        ),
    ),
    CFunction(
        "stream_begin",
        "stream.c",
        "Begin an update that is done in parts: take the path sample at the end of the horizon.",
        "For controllers whose sampling period is shorter than the time of an update: "
        "stream_begin, then stream_advance in as many sampling periods as there are, then "
        "stream_finish. The results have the bits of stream_update. A sample that is refused "
        "(INPUT_NOT_FINITE, BAD_ARGUMENT, UNREACHABLE) changes nothing. BAD_ARGUMENT also means "
        "that an update has begun and was not finished; between stream_begin and stream_finish "
        "stream_update, stream_limits and stream_parameters return it too.",
        (
            _STREAM,
            Field("y", "const real *", ("n_t",), "mixed", OUTPUT),
            Field("dy", "const real *", ("n_y",), "mixed", RATE),
            Field("ddy", "const real *", ("n_y",), "mixed", SECOND),
        ),
    ),
    CFunction(
        "stream_advance",
        "stream.c",
        "Do a part of an update that has begun: 1/parts of what is left.",
        "An update in five sampling periods: parts = 5, 4, 3, 2, 1. The shares are equal up to "
        "the smallest part that is done at once, about a seventh of an update. After a negative "
        "status other than NULL_ARGUMENT, BAD_ARGUMENT and NOT_STARTED (no update has begun) "
        "the stream has failed.",
        (
            _STREAM,
            Field("parts", "int", (), "1", "at least 1; 1: all that is left"),
        ),
    ),
    CFunction(
        "stream_finish",
        "stream.c",
        "Do the rest of an update that has begun; give motion and torques of the interval.",
        "Statuses and results are those of stream_update. NOT_STARTED: no update has begun, or "
        "the stream has failed.",
        (
            _STREAM,
            Field("motion", "motion *", (), "", "results; N = samples_per_interval"),
            Field("info", "stream_info *", (), "", "what the solver reports"),
        ),
    ),
    CFunction(
        "stream_start_moving",
        "stream.c",
        "Start a stream in motion: from samples of a path that does not begin at rest.",
        "The path has exactly intervals + 16 samples, one update apart. The next update takes "
        "the sample after the last one and gives the interval that begins at sample 16, counted "
        "from 0. The unactuated coordinates move as if the path had been like this before: in "
        "stable directions of the zero dynamics their motion is quasi-static, in unstable ones "
        "the path ahead determines it. Where the arm moves in another way, the difference "
        "decays with the stable zeros. The call takes the time of about 25 updates, so call it "
        "before the first results are needed. BAD_ARGUMENT also means another number of samples "
        "or another period than that of the options.",
        (
            _STREAM,
            Field("options", "const stream_options *", (), "", ""),
            Field(
                "samples",
                "const samples *",
                (),
                "",
                "of the output; the period is that of the options",
            ),
            Field(
                "q_start",
                "const real *",
                ("n_a",),
                "mixed",
                "initial guess of the equilibrium at sample 7, counted from 0",
            ),
        ),
    ),
    CFunction(
        "stream_parameters",
        "stream.c",
        "Change the run-time parameters of a stream, such as the payload; from the next update "
        "on they hold.",
        "Where the path rests in the whole horizon and the arm rests, the stream is in the new "
        "equilibrium at once, as one that is started with these parameters; z of hysteresis is "
        "zero there. Elsewhere the deflections of the gears change at once, and updates return "
        "TOLERANCE_NOT_MET until the motion has settled: their torques would move the motors so "
        "fast, do not send them. The horizon, its recommended length and the scale of the "
        "residual stay those of stream_start: where the new parameters make the unstable zeros "
        "much slower, start a new stream.",
        (
            _STREAM,
            Field("parameters", "const real *", ("n_p",), "mixed", _PARAMETERS),
        ),
        parametrized=True,
    ),
    CFunction(
        "stream_force",
        "stream.c",
        "Set the force on the output at the samples that follow: that of the next update, and "
        "of later ones until it is set again.",
        "A stream starts at the equilibrium with the force of its options, which is that of all "
        "samples until it is set. Set the force of each sample before its update; a force that "
        "has a step cannot be followed exactly.",
        (
            _STREAM,
            Field(
                "force",
                "const real *",
                ("3 * n_y",),
                "mixed",
                "dual to dy: of a pose force [N], then torque [N m]; then its first and its "
                "second time derivative",
            ),
        ),
        part=FORCE,
    ),
    CFunction(
        "stream_limits",
        "stream.c",
        "Set limits of the motors: the stream modifies the path ahead where a limit would be "
        "exceeded.",
        "The limits hold from the next update on, with a bounded number of operations per "
        "update: a small quadratic program changes the path within the horizon as little as "
        "possible, and the inversion follows the modified path. While the path is modified, or "
        "a limit is exceeded, update returns LIMITS_ACTIVE and reports the deviation, which "
        "decays when no limit is active. A limit that cannot be kept is exceeded: compare the "
        "torques with the limits. Where it is exceeded by a factor above 2.5 while the path is "
        "modified, the stream stops with LIMITS_INFEASIBLE. The path is modified only beyond "
        "the preview that the unstable zeros need; HORIZON_TOO_SHORT: fewer than 4 intervals, "
        "or less than half of this preview beyond it. Limits may be changed at any time. An "
        "infinite torque or speed means no limit.",
        (
            _STREAM,
            Field(
                "torque_max", "const real *", ("n_m",), "N m", "largest motor torques, positive"
            ),
            Field(
                "speed_max", "const real *", ("n_m",), "rad/s", "largest motor speeds, positive"
            ),
            Field(
                "deviation_max", "real", (), "mixed", "largest deviation of each output, m or rad"
            ),
        ),
    ),
    CFunction(
        "stream_all_limits",
        "stream.c",
        "Set limits of motors, gears, deflections, joints and tool, as stream_limits, which "
        "removes all but its own.",
        "Kept at the ends of the intervals: the rate of a torque is its change from one to the "
        "next over their time, without that of the friction of the motor, which changes at once "
        "where it reverses. A torque-speed curve has at most 21 points; the members "
        "knot_samples and deviation are ignored.",
        (
            _STREAM,
            Field(
                "limits",
                "const inversion_limits *",
                (),
                "",
                "null members and infinite entries: no limits",
            ),
            Field(
                "deviation_max", "real", (), "mixed", "largest deviation of each output, m or rad"
            ),
        ),
        part=BOUNDS,
    ),
    *LIMITED_FUNCTIONS,
    *POSITION_FUNCTIONS,
    *SAMPLER_FUNCTIONS,
)


def offered_c_functions(
    model: RobotModel,
    functions: Sequence[str],
    parameters: Sequence[object],
    precision: str,
    parts: Sequence[str] = (),
) -> tuple[CFunction, ...]:
    """The hand-written functions of a library with these functions, run-time parameters, precision
    and `PARTS`.
    """
    kinematic = kinematic_functions(model, functions, precision)
    if inversion_reason(model, functions) is not None:
        return kinematic
    offered = [f for f in C_FUNCTIONS if model.n_e or not f.elastic]
    needed = {"linearize", *(["inverse_dynamics_derivatives"] if FORCE in parts else [])}
    offered = [f for f in offered if f.file != "growth.c" or needed <= set(functions)]
    if FORCE in parts:
        offered = [_with_force(f) if f.name == "growth" else f for f in offered]
    if position_obstacle(model) is not None:
        offered = [f for f in offered if f.part != POSITION]
    offered = [
        f
        for f in offered
        if (precision == "double" or not f.double) and (not f.part or f.part in parts)
    ]
    if not parameters:
        return (*(function for function in offered if not function.parametrized), *kinematic)
    return (*(_with_parameters(function) for function in offered), *kinematic)


def check_parts(
    parts: Sequence[str], model: RobotModel, functions: Sequence[str], precision: str
) -> None:
    """ArgumentError for an optional part that is unknown, or that a library with these functions
    cannot have.
    """
    for part in parts:
        if part not in PARTS:
            raise ArgumentError(f"parts: given {part!r}, expected some of {', '.join(PARTS)}")
        if part != DERIVATIVES and not any(
            f.part == part for f in offered_c_functions(model, functions, (), precision, parts)
        ):
            own = {POSITION: position_obstacle(model)}
            alone = "it is in double precision only" * (precision != "double")
            elastic = f"model {model.name} has no coordinates without motor"
            reason = inversion_reason(model, functions) or own.get(part) or alone or elastic
            raise ArgumentError(f"parts: given {part!r}, but {reason}; leave it out")


def inversion_reason(model: RobotModel, functions: Sequence[str]) -> str | None:
    """Why a library with these functions has no invert and stream; None where it has them."""
    missing = [
        name for name in offered_functions(model) if name in INVERTING and name not in functions
    ]
    not_chosen = (
        f"they need the functions {', '.join(missing)}, which were not chosen" if missing else None
    )
    return obstacle(model, "inversion in C") or obstacle(model, "reduced problem") or not_chosen


def _with_force(function: CFunction) -> CFunction:
    """The function growth with the force on the output as arguments behind the period."""
    at = [a.name for a in function.arguments].index("period") + 1
    arguments = (*function.arguments[:at], *_FORCE_OF_PATH, *function.arguments[at:])
    return replace(function, notes=f"{function.notes} {_UNDER_FORCE}", arguments=arguments)


def _with_parameters(function: CFunction) -> CFunction:
    """The function with the run-time parameters as an argument, before ``q_start``, ``t`` or
    ``growth``.
    """
    inputs = [
        k for k, a in enumerate(function.arguments) if (a.name, a.kind) in _BEHIND_PARAMETERS
    ]
    if not inputs:
        return function
    at = inputs[0]
    given = replace(
        _GIVEN, extents=(*function.arguments[at].extents[:-1], "n_p")
    )  # as many as q_start, for invert_many
    return replace(function, arguments=(*function.arguments[:at], given, *function.arguments[at:]))
