"""Random calls of the public interface, drawn from the signatures: nonsense of all types and
sizes.
"""

from __future__ import annotations

import inspect
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
from public_entrances import Entrance, entrances

import flexgen
from flexgen.base.checks.type_checks import checks_of
from flexgen.base.errors import FlexgenError

NONSENSE: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 10**400, -(10**25), 2**63, 1e308, -1e308, 1e-320, 0.5, -2.5),
    *(
        float("nan"),
        float("inf"),
        -float("inf"),
        np.float64("nan"),
        np.int64(-7),
        np.array(2.0),
        1j,
    ),
    *(
        "",
        "x",
        "a\0b",
        "\ud800",
        "elbow",
        "nosuch@x",
        "../x",
        "x" * 5000,
        b"x",
        bytearray(b"y"),
        Path("nosuch"),
    ),
    *(
        [],
        [1, 2],
        [float("nan")],
        ["x", 1],
        [[1], [2, 3]],
        (),
        (1.5,),
        (0.1, 0.2),
        (None, None),
        {1, 2},
        range(3),
    ),
    *({}, {"a": 1}, {1: 2}, {"payload.mass": float("nan")}, {"nominal": {}}, {"x": None}),
    *(
        np.zeros(0),
        np.zeros(2),
        np.zeros((2, 3)),
        np.full(2, np.nan),
        np.array([None, "x"]),
        np.ones((2, 2)) * 1j,
    ),
    *(object(), object, len, lambda *a, **k: None, Ellipsis, NotImplemented),
)
# Functions and methods that compute for seconds where nothing is wrong: called with one wrong type
# at least.
HEAVY = set(
    "solve sweep generate excite measure frf identify refine fit_motion control feedback_study "
    "tune fastest identify_load identify_servo identify_gears identify_spring command_positions "
    "learn predict compare export_fmu score export_mex export_plcopen export_ros2 export_selftest "
    "compare_record compare_shapers commission next_run "
    "export_simulink export_mujoco export_urdf view models kinematics simulate load check "
    "report verdict then plot to_dataframe to_xarray to_control".split()
)
# constructors that compute before types are checked
COSTLY = {"ConstantGainObserver", "ExtendedKalmanFilter"}
NEVER = {"executor", "controller", "raw"}  # objects of the user, called by flexgen
LONGEST = 4.0  # s of the processor, of one call


class _Hang(BaseException):
    """A call took longer than `LONGEST`."""


def _stop(*_: Any) -> None:
    raise _Hang


@dataclass
class Outcome:
    """Counts of exceptions, and calls from which another exception than an error of flexgen or a
    TypeError left.
    """

    calls: int = 0
    refused: int = 0
    leaks: dict[str, str] = field(default_factory=dict)
    types: Counter[str] = field(default_factory=Counter)
    slowest: tuple[float, str] = (0.0, "")  # s of the processor, call


def known_objects() -> dict[type, Any]:
    """Objects that other calls need, and whose methods are called."""
    solution = flexgen.solve("elbow", verify=False)
    equations = flexgen.derive("elbow")
    path = flexgen.plan(equations)
    ones = np.ones(2)
    objects = [
        *(
            solution,
            solution.trajectory,
            solution.model,
            solution.move,
            equations,
            solution.torque_command,
            path,
        ),
        *(
            flexgen.analyze(equations),
            flexgen.Limits(torque=(10.0, 10.0)),
            path.sample(np.linspace(0, 1, 3)),
        ),
        *(
            flexgen.Notch(10.0),
            flexgen.LowPass(50.0),
            flexgen.PPI(),
            flexgen.Grid(models=["elbow"]),
        ),
        *(
            flexgen.DriveHardware(),
            flexgen.plan_problem(equations),
            flexgen.Sphere((1.0, 0.0, 0.0), 0.1),
        ),
        *(
            flexgen.Cascade(ones, ones, ones),
            flexgen.PID(ones, ones, ones),
            flexgen.LQG(),
            flexgen.RandomMove(0),
        ),
        *(
            flexgen.Linear(*[np.eye(2)] * 4),
            flexgen.TomeiPD(),
            flexgen.ComputedTorque(),
            flexgen.LoopShaping(),
        ),
        flexgen.Disturbance("step", "m1", 1.0),
        flexgen.Impedance(joint_stiffness=(1e6, 1e6)),
        flexgen.Wall((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 1e4),
    ]
    return {type(thing): thing for thing in objects}


def more_objects(folder: Path) -> dict[type, Any]:
    """Further objects for calls: results that take seconds, and a library in C."""
    quiet: dict[str, Any] = {"progress": False}
    known = known_objects()
    robot = flexgen.read("elbow")
    run = flexgen.control("elbow", solution=known[flexgen.Solution], **quiet)
    plan = flexgen.excite("elbow", period_s=0.5, periods=2, **quiet)
    spectra = flexgen.measure(plan, **quiet)
    responses = flexgen.frf(spectra)
    library = flexgen.load(flexgen.generate("elbow", folder, **quiet).directory)
    path = known[flexgen.Path]
    t = np.arange(200) * 0.004
    moved = (1 - np.cos(2 * t)[:, None]) ** 2 * [0.1, -0.05]
    record = flexgen.ServoRecord(t, moved, moved)
    objects = [
        *(
            run,
            run.accuracy(),
            run.runs[0],
            run.loops()["begin"],
            run.margins()["begin"],
            plan,
            spectra,
            responses,
        ),
        *(
            flexgen.check("elbow"),
            flexgen.identify("elbow", responses, **quiet),
            library,
            library.gravity,
        ),
        *(
            library.invert,
            library.invert_many,
            library.path_sampler(path.table()),
            flexgen.InversionOptions(),
        ),
        library.stream(path.sample([0.0]).y[0, :, 0], path.q_start, period=5e-3, intervals=20),
        *(flexgen.score("four_mass", steps=1, **quiet), flexgen.fastest("elbow", **quiet)),
        *(
            flexgen.ExtendedKalmanFilter(robot),
            flexgen.ConstantGainObserver(known[flexgen.Solution]),
        ),
        flexgen.CollisionDetector(robot, 1e-3),
        flexgen.predict(
            flexgen.read("elbow", overrides={"uncertainty": {"stiffness": 0.1}}),
            robots=16,
            **quiet,
        ),
        *(
            calibrated(),
            flexgen.Servo(flexgen.PPI()),
            record,
            flexgen.identify_servo("elbow", record, **quiet),
        ),
        flexgen.identify_gears("elbow", run.trajectory(), hysteresis=False, **quiet),
        flexgen.command_positions("elbow", solution=known[flexgen.Solution], **quiet),
        *recorded(),
        flexgen.compare_shapers("elbow", detuning=[1.0], **quiet),
        flexgen.Shaper.of_mode("zv", 3.0),
    ]
    return known | {type(thing): thing for thing in objects}


def recorded() -> tuple[flexgen.JointRecord, flexgen.RecordComparison]:
    """A record of joints that move once, and its comparison."""
    time = 1e-3 * np.arange(800)
    swing = 0.1 * np.sin(np.pi * np.clip((time - 0.2) / 0.3, 0.0, 1.0)) ** 4
    angle = np.outer(swing, [1.0, -1.0])
    record = flexgen.JointRecord(time, angle, np.zeros((800, 2)), ("q1", "q2"))
    return record, flexgen.compare_record("elbow", record)


def calibrated() -> flexgen.Calibration:
    """Of 20 poses of a robot with a tracker."""
    tracker = {"name": "p", "type": "tracker", "unit": "m", "position": [0.1, 0.0, 0.0]}
    robot = flexgen.read("elbow", overrides={"sensor": [tracker]})
    q = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    seen = flexgen.tracker_positions(robot, q)
    return flexgen.calibrate(
        robot, flexgen.StaticPoses(q, seen), free=["zeros"], folds=0, progress=False
    )


def callables(objects: dict[type, Any]) -> list[Entrance]:
    """Functions, constructors, static methods, and the methods of the objects."""
    found = []
    for each in entrances():
        name = each.name.rpartition(".")[2]
        if each.owner is None or each.is_constructor:
            found.append(each)
        elif not isinstance(inspect.getattr_static(each.owner, name), FunctionType):
            found.append(Entrance(each.name, getattr(each.owner, name), each.owner))
        elif each.owner in objects:
            found.append(Entrance(each.name, getattr(objects[each.owner], name), each.owner))
    return found


def is_heavy(entrance: Entrance) -> bool:
    return entrance.name.rpartition(".")[2] in HEAVY


def drawn(
    rng: np.random.Generator, entrance: Entrance, objects: dict[type, Any]
) -> tuple[dict[str, Any], list[Any]]:
    """Arguments of one call by name, and further positional ones."""
    arguments: dict[str, Any] = {}
    others: list[Any] = []
    for name, parameter in inspect.signature(entrance.call).parameters.items():
        if name in NEVER or parameter.kind is parameter.VAR_KEYWORD:
            continue
        if parameter.kind is parameter.VAR_POSITIONAL:
            others = [pick(rng) for _ in range(rng.integers(0, 3))]
        elif parameter.default is parameter.empty or rng.random() < 0.3:
            arguments[name] = (
                plausible(rng, str(parameter.annotation), name, objects)
                if rng.random() < 0.6
                else pick(rng)
            )
    return arguments, others


def pick(rng: np.random.Generator) -> Any:
    return NONSENSE[int(rng.integers(0, len(NONSENSE)))]


def plausible(
    rng: np.random.Generator, annotation: str, name: str, objects: dict[type, Any]
) -> Any:
    """A value of the type of a parameter, not always one that makes sense."""
    if name in ("model", "name") and "str" in annotation:
        return "elbow"
    for kind, thing in objects.items():
        if kind.__name__ in annotation:
            return thing
    choices: list[Any] = []
    if "float" in annotation or "Vector" in annotation:
        choices += [0.0, -1.0, 1e-3, 1.0, 1e300, -1e300, 5e-324]
    if "int" in annotation:
        choices += [0, 1, -1, 2, 40, -(2**62)]
    if "Sequence" in annotation or "tuple" in annotation or "Vector" in annotation:
        choices += [(), (0.1, 0.2), (0.1, 0.2, 0.3), (-1.0,), [1e300, 1e300]]
    if "ndarray" in annotation:
        choices += [
            np.zeros(0),
            np.ones(2),
            np.eye(2),
            -np.ones(3),
            np.ones((2, 3, 4)),
            np.full(2, 1e300),
            1.0,
        ]
    if "str" in annotation:
        choices += ["line", "", "x", "elbow", "q_m", "zoh"]
    if "bool" in annotation:
        choices += [True, False]
    if "Mapping" in annotation or "dict" in annotation:
        choices += [{}, {"payload.mass": 1.0}, {"x": -1.0}]
    return choices[int(rng.integers(0, len(choices)))] if choices else pick(rng)


def wrong_type(call: Callable[..., Any], arguments: dict[str, Any]) -> bool:
    """Whether a parameter of a call has a value that its annotation excludes."""
    checks = checks_of(call)
    return any(
        name in checks and not checks[name].passes(value) for name, value in arguments.items()
    )


def call_at_random(
    seed: int, calls: int, seconds: float, objects: dict[type, Any], doors: Sequence[Entrance] = ()
) -> Outcome:
    """Call the interface, or some entrances of it, until a number of calls or a time is
    reached.
    """
    rng = np.random.default_rng(seed)
    doors = doors or callables(objects)
    outcome = Outcome()
    end = time.process_time() + seconds
    while outcome.calls < calls and time.process_time() < end:
        entrance = doors[int(rng.integers(0, len(doors)))]
        arguments, others = drawn(rng, entrance, objects)
        if is_heavy(entrance) and not wrong_type(entrance.call, arguments):
            continue
        given = (others, {}) if others else ((), arguments)
        outcome.calls += 1
        began = time.process_time()
        error = raised(entrance.call, *given)
        if isinstance(error, FlexgenError | TypeError):
            outcome.refused += 1
        elif error is not None:
            outcome.types[type(error).__name__] += 1
            outcome.leaks.setdefault(
                f"{entrance.name}: {place(error)}", f"{error!s:.100} of {arguments!r:.300}"
            )
        spent = time.process_time() - began
        if spent > outcome.slowest[0]:
            outcome.slowest = (spent, f"{entrance.name} {arguments!r:.300}")
    return outcome


def raised(call: Callable[..., Any], args: Any, kwargs: dict[str, Any]) -> BaseException | None:
    """Exception of a call, also if it hangs."""
    before = signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        call(*args, **kwargs)
    except (Exception, _Hang) as error:
        # A wrapper of C code that _stop interrupts raises a SystemError from it.
        return error.__cause__ if isinstance(error.__cause__, _Hang) else error
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return None


def place(error: BaseException) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}"


@cache
def two_of_each_type(k: int) -> tuple[Any, ...]:
    """Values of `NONSENSE`: two of each type, others for each ``k``."""
    types: dict[type, list[Any]] = {}
    for value in NONSENSE:
        types.setdefault(type(value), []).append(value)
    return tuple(
        each[(k + more) % len(each)]
        for each in types.values()
        for more in range(min(2, len(each)))
    )


def accepted(entrance: Entrance, objects: dict[type, Any]) -> Iterator[str]:
    """Values that the annotation of a parameter excludes and that a call does not refuse, the
    others plausible.
    """
    rng = np.random.default_rng(0)
    parameters = inspect.signature(entrance.call).parameters
    for k, (name, check) in enumerate(checks_of(entrance.call).items(), len(entrance.name)):
        if name not in parameters:
            continue
        for value in NONSENSE[::8] if entrance.name in COSTLY else two_of_each_type(k):
            if check.passes(value):
                continue
            arguments = {
                other: plausible(rng, str(parameter.annotation), other, objects)
                for other, parameter in parameters.items()
                if parameter.default is parameter.empty
                and parameter.kind is not parameter.VAR_POSITIONAL
            }
            error = raised(entrance.call, (), arguments | {name: value})
            if not isinstance(error, FlexgenError | TypeError):
                yield f"{entrance.name}, {name}: given {value!r:.60}: {error!r:.200}"
                break
