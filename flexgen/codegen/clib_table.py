"""The hand-written functions of the library, as nouns: what they take and give, and the numbers that they use.

They come with every library of a model that inverts and has all functions of `INVERSION`, in double precision, and not
where numbers of the model are run-time parameters. The texts lie in ``flexgen/clib/``.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.mechanics.signatures import INVERSION, offered_functions
from flexgen.model.elements import LinearSpring, RobotModel


@dataclass(frozen=True)
class Argument:
    """An argument of a core.

    Parameters
    ----------
    name : str
    kind : str
        ``"in"``, ``"out"``, or ``"kept"`` (read and written).
    extents : tuple of str
        Sizes: of the library (``"n_a"``), sums of other arguments (``"lead + n + tail"``), macros of the core; none for
        a scalar. Stored row after row: the last one runs fastest.
    unit, doc : str
    number : str
        ``"real"``, ``"int"`` or ``"int64_t"``.
    """

    name: str
    kind: str
    extents: tuple[str, ...]
    unit: str
    doc: str
    number: str = "real"


@dataclass(frozen=True)
class CFunction:
    """A function of the hand-written C.

    Parameters
    ----------
    name : str
        In C ``<library>_<name>``.
    file : str
        The text in ``flexgen/clib/`` that defines it.
    summary, notes : str
        For the header: one sentence; paragraphs.
    arguments : tuple of Argument
    returns : str
        ``"status"``, or ``"size"``: a number of reals.
    macros : tuple of (str, int, str)
        Sizes of its own, ``<NAME>_<macro>``, with what they are.
    elastic : bool
        Only where there are coordinates without motor.
    """

    name: str
    file: str
    summary: str
    notes: str
    arguments: tuple[Argument, ...]
    returns: str = "status"
    macros: tuple[tuple[str, int, str], ...] = ()
    elastic: bool = False

    @property
    def signature(self) -> str:
        """Names, kinds and sizes in one line, for the digest of the interface."""
        listed = ",".join(f"{a.kind} {a.number} {a.name}[{','.join(a.extents)}]" for a in self.arguments)
        return f"{self.name}({listed}){self.returns}"


@dataclass(frozen=True)
class Drives:
    """Numbers of the model that the cores use: gears, motors and what the output's rows are.

    Parameters
    ----------
    i_g, i_e : tuple of int
        Places in q_a of the coordinates with and without motor.
    eta, eta_inverse : tuple of tuple of float
        ``q_m = eta q_g``, rows.
    rotor_inertia : tuple of float
        Motor side [kg m^2].
    gear_damping : tuple of float
        Arm side [N m s/rad, N s/m]; zero for rigid gears.
    gear_is_rigid, gear_is_linear : tuple of bool
    pose : bool
        Whether the output is a pose.
    """

    i_g: tuple[int, ...]
    i_e: tuple[int, ...]
    eta: tuple[tuple[float, ...], ...]
    eta_inverse: tuple[tuple[float, ...], ...]
    rotor_inertia: tuple[float, ...]
    gear_damping: tuple[float, ...]
    gear_is_rigid: tuple[bool, ...]
    gear_is_linear: tuple[bool, ...]
    pose: bool


_MESH = (
    Argument("n", "in", (), "1", "samples of the path, at least 2", "int"),
    Argument("lead", "in", (), "1", "samples of rest before the path", "int"),
    Argument("tail", "in", (), "1", "samples of rest after it", "int"),
    Argument("every", "in", (), "1", "samples per interval of the mesh", "int"),
)
_HORIZON = (
    Argument("intervals", "in", (), "1", "of the horizon, 1 to 10000", "int"),
    Argument("parts", "in", (), "1", "samples of the results per interval, 1 to 1000", "int"),
)
_ALL = "lead + n + tail"
_WHOLE = (
    _MESH[0],
    Argument("period", "in", (), "s", "from sample to sample"),
    Argument("place", "in", ("n", "n_t"), "mixed", "output; for a pose position and rotation matrix by columns"),
    Argument("rate", "in", ("n", "n_y"), "mixed", "its rate; for a pose linear and angular velocity, world axes"),
    Argument("rate2", "in", ("n", "n_y"), "mixed", "its second derivative"),
    Argument("q_start", "in", ("n_a",), "mixed", "guess of the pose of rest at the first sample"),
    *_MESH[1:],
    Argument("tolerance", "in", (), "1", "of the equations without motor, relative to their torques at rest"),
    Argument("q_a", "out", (_ALL, "n_a"), "mixed", "arm coordinates"),
    Argument("v_a", "out", (_ALL, "n_a"), "mixed", "arm velocities"),
    Argument("a_a", "out", (_ALL, "n_a"), "mixed", "arm accelerations"),
    Argument("tau_g", "out", (_ALL, "n_g"), "mixed", "torques of the gears, arm side"),
    Argument("q_m", "out", (_ALL, "n_m"), "rad", "motor angles"),
    Argument("v_m", "out", (_ALL, "n_m"), "rad/s", "motor speeds"),
    Argument("tau_m", "out", (_ALL, "n_m"), "N m", "motor torques"),
)


def _space(core: str) -> tuple[Argument, Argument]:
    return (
        Argument("work", "kept", ("work_size",), "", "workspace"),
        Argument("work_size", "in", (), "1", f"its length, at least that of {core}_work", "int64_t"),
    )


C_FUNCTIONS: tuple[CFunction, ...] = (
    CFunction(
        "invert_work",
        "invert.c",
        "Numbers that the workspace of invert must hold; -1 where the sizes are not allowed.",
        "",
        _MESH,
        returns="size",
    ),
    CFunction(
        "invert",
        "invert.c",
        "Inverse dynamics along a whole path: motion of arm and motors, and torques, that keep the output there.",
        "The output is at rest at the first sample and before it, and after the last one; the arm starts at rest, and "
        "moves before the output does (lead) and after it (tail) where its zero dynamics ask for it. Without "
        "coordinates that have no motor nothing is solved. OK means that the residual is within the tolerance, on the "
        "mesh and at the samples, and that the motion at the samples is even: by differences positions, speeds and "
        "accelerations agree to 2 % of the largest. Without coordinates that have no motor the residual is zero, and "
        "OK is no more than that. INEXACT: on the mesh it is, the rest is not, as where the mesh is coarse, the "
        "path rough, or samples are too far apart or too close; the report tells how much. Results of a negative "
        "status mean nothing. A path that does not begin and end at rest is a BAD_ARGUMENT; UNREACHABLE may also mean "
        "that rest was not found from q_start. The matrices are stored sample after sample: entry i of sample k is "
        "x[k * n_a + i].",
        (
            *_WHOLE,
            Argument(
                "report",
                "out",
                ("INVERT_REPORT",),
                "1",
                "residual on the mesh and at the samples; steps; intervals; unevenness of the motion",
            ),
            *_space("invert"),
        ),
        macros=(("INVERT_REPORT", 5, "numbers that invert reports"),),
    ),
    CFunction(
        "stream_work",
        "stream.c",
        "Numbers that the memory of a stream must hold; -1 where the sizes are not allowed.",
        "",
        _HORIZON,
        returns="size",
    ),
    CFunction(
        "stream_start",
        "stream.c",
        "Begin a stream, inverse dynamics on a moving horizon: at rest, with the output at a place and staying there.",
        "The memory holds all that the stream knows; it may be copied and moved between calls; every stream has its "
        "own. One that has failed is started again.",
        (
            Argument("stream", "kept", ("stream_size",), "", "memory of the stream"),
            Argument("stream_size", "in", (), "1", "its length, at least that of stream_work", "int64_t"),
            *_HORIZON,
            Argument("period", "in", (), "s", "from update to update: an interval"),
            Argument("tolerance", "in", (), "1", "of the equations without motor, relative to their torques at rest"),
            Argument("place", "in", ("n_t",), "mixed", "output at rest; for a pose position and rotation by columns"),
            Argument("q_start", "in", ("n_a",), "mixed", "guess of the pose of rest"),
        ),
    ),
    CFunction(
        "stream_update",
        "stream.c",
        "Take the next sample of the path, at the end of the horizon, and give motion and torques of the interval "
        "that begins now.",
        "The output reaches the sample so many intervals later. One step of the solver, in bounded time. A sample that "
        "is refused (INPUT_NOT_FINITE, BAD_ARGUMENT, UNREACHABLE) changes nothing; after any other negative status the "
        "stream has failed, and NOT_STARTED follows. OK means that in this interval the residual is within the "
        "tolerance, and motors move evenly: by differences of the samples positions, speeds and accelerations agree to "
        "2 % of the largest of them within about a horizon, and the torque goes on where the interval before left it, "
        "to 2e-4 of its largest. It says nothing of intervals to come. INEXACT: the results are the best that one step "
        "found, or the path is rough there, or the samples are too far apart or too close, or fewer than 7 of them lie "
        "in the horizon beyond this interval: (intervals - 1) * parts < 7. "
        "INEXACT and LIMITED are positive and come with results: failures are `status < 0`. To stop, update with the "
        "last place and zero rates until the results rest, at least so many times as the horizon has intervals. A "
        "path that comes late or is refused is no such stop: without an update there are no further torques.",
        (
            Argument("stream", "kept", ("stream_work",), "", "memory of the stream"),
            Argument("place", "in", ("n_t",), "mixed", "output; for a pose position and rotation matrix by columns"),
            Argument("rate", "in", ("n_y",), "mixed", "its rate; for a pose linear and angular velocity, world axes"),
            Argument("rate2", "in", ("n_y",), "mixed", "its second derivative"),
            Argument("q_a", "out", ("parts", "n_a"), "mixed", "arm coordinates"),
            Argument("v_a", "out", ("parts", "n_a"), "mixed", "arm velocities"),
            Argument("tau_g", "out", ("parts", "n_g"), "mixed", "torques of the gears, arm side"),
            Argument("q_m", "out", ("parts", "n_m"), "rad", "motor angles"),
            Argument("v_m", "out", ("parts", "n_m"), "rad/s", "motor speeds"),
            Argument("tau_m", "out", ("parts", "n_m"), "N m", "motor torques"),
            Argument(
                "report",
                "out",
                ("STREAM_REPORT",),
                "1",
                "residual; unevenness; steps; intervals; distance [m] and angle [rad] off the path, where it is "
                "bent; 1 where that or a bound that is passed is LIMITED, whatever is returned, else 0",
            ),
        ),
        macros=(("STREAM_REPORT", 7, "numbers that stream_update reports"),),
    ),
    CFunction(
        "stream_limits",
        "stream.c",
        "Let a stream keep bounds of its motors: where they would be passed, the path ahead is bent.",
        "From the next update on, in bounded time: a small quadratic program an update changes the path within the "
        "horizon, as little as can be, and the inversion follows the changed path. While it does, and where a bound is "
        "passed, LIMITED is returned, or INEXACT where that holds, too; the report tells both, and the deviation, "
        "which fades when the bounds no longer bind. "
        "What cannot be kept is passed: the torques are to be compared with the bounds; where the path is bent and one "
        "is passed by more than 2.5 times, the stream ends with LIMITS_LOST. The path is bent only where the motion "
        "that is under way need not know of it yet, so many intervals ahead as the unstable zeros look, until a "
        "thousandth of a change is felt; SHORT_HORIZON: fewer than 4 intervals, or less than half as many beyond. As "
        "many are better, and time to brake in; bends are as quick as the horizon is short. "
        "Bounds may be changed at any time; an infinite torque or speed is none.",
        (
            Argument("stream", "kept", ("stream_work",), "", "memory of the stream"),
            Argument("torque_max", "in", ("n_m",), "N m", "of the motors, positive"),
            Argument("speed_max", "in", ("n_m",), "rad/s", "of the motors, positive"),
            Argument("bend_max", "in", (), "mixed", "of the deviation of each output, m and rad; weighed like them"),
        ),
    ),
    CFunction(
        "bvp_work",
        "bvp.c",
        "Numbers that the workspace of bvp must hold; -1 where the sizes are not allowed.",
        "",
        _MESH,
        returns="size",
        elastic=True,
    ),
    CFunction(
        "bvp",
        "bvp.c",
        "Inverse dynamics along a whole path like invert, as a two-point boundary value problem: an independent check.",
        "Nothing is weighed, so that the equations hold to rounding on the mesh. At the start the arm differs from "
        "rest by what its zero dynamics let grow, at the end by what they let fade. That needs as many unstable zeros "
        "at the start as at the end (or ZEROS_CHANGE), none on the imaginary axis there (ZERO_ON_AXIS), and none at "
        "infinity at the ends or between them (FLAT); invert needs none of this.",
        (
            *_WHOLE,
            Argument(
                "report",
                "out",
                ("BVP_REPORT",),
                "1",
                "residual on the mesh and at the samples; steps; intervals; unstable zeros at the ends; unevenness",
            ),
            *_space("bvp"),
        ),
        macros=(("BVP_REPORT", 7, "numbers that bvp reports"),),
        elastic=True,
    ),
)


def drives_of(model: RobotModel) -> Drives:
    """The `Drives` of a model that inverts."""
    from flexgen.mechanics.lagrangian import gears  # here, as it needs CasADi

    def rows(A: np.ndarray) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(float(x) for x in row) for row in A)

    made = gears(model)
    return Drives(
        i_g=model.i_g,
        i_e=model.i_e,
        eta=rows(model.eta),
        eta_inverse=rows(np.linalg.inv(model.eta)),
        rotor_inertia=tuple(float(motor.inertia) for motor in model.motors),
        gear_damping=tuple(0.0 if gear.rigid else float(ratio**2 * gear.damping) for gear, ratio in made),
        gear_is_rigid=tuple(gear.rigid for gear, _ in made),
        gear_is_linear=tuple(isinstance(gear.spring, LinearSpring) for gear, _ in made),
        pose=model.output.type == "tool_pose",
    )


def offered_cores(
    model: RobotModel, functions: Sequence[str], parameters: Sequence[object], precision: str
) -> tuple[CFunction, ...]:
    """The cores of a library with these functions and run-time parameters, in this precision."""
    needed = set(offered_functions(model)) & set(INVERSION)
    if parameters or precision != "double" or not model.inverts or not needed <= set(functions):
        return ()
    return tuple(core for core in C_FUNCTIONS if model.n_e or not core.elastic)
