"""Hostile calls of the inversion in C, made for the tests: by seed, with exactly sized arrays
between sentinels.
"""

from __future__ import annotations

import ctypes
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from emitted import library_of

from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.interface import STATUSES
from flexgen.codegen.emission.spec import library_name
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.model.elements import RobotModel
from flexgen.paths.path import Path
from flexgen.runtime import Library, load
from flexgen.runtime.structs import struct_of, structs_of

CODES = {status.name: status.code for status in STATUSES}
NAMES = {value: name for name, value in CODES.items()}
SENTINEL = -7.25e77
OUTPUTS = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")
ARRAYS = ("y", "dy", "ddy", "q_start")
# of the paths that are spoiled
SAMPLES = 41
BEFORE = 12
AFTER = 8
STRUCTURES = ("path", "options", "motion", "info")  # of an inversion, passed by address


def guarded(n: int) -> tuple[np.ndarray, np.ndarray]:
    """An array of n numbers and the block that it lies in, with sentinels on both sides."""
    block = np.full(n + 16, SENTINEL)
    return block[8 : 8 + n], block


def untouched(block: np.ndarray) -> bool:
    return bool((block[:8] == SENTINEL).all() and (block[-8:] == SENTINEL).all())


@dataclass(frozen=True)
class Target:
    """A model with its library, called by address, and a path of its first move, from rest to
    rest.
    """

    equations: Equations
    library: Library
    entry: Any
    sizes: dict[str, int]
    path: dict[str, np.ndarray]
    period: float
    singular: int  # the coordinate that is zero at a singular pose; -1 where none is
    directory: FilePath
    structs: dict[str, type[ctypes.Structure]]

    def with_library(self, file: FilePath) -> Target:
        """The target with another shared library."""
        return replace(self, entry=ctypes.CDLL(str(file)))

    def function(self, name: str, returned: Any = ctypes.c_int) -> Callable[..., int]:
        function = getattr(self.entry, f"{library_name(self.equations.model)}_{name}")
        function.restype = returned
        return function


def parts_of(model: RobotModel) -> list[str]:
    """The optional parts of its library."""
    return ["bvp"] * bool(model.n_e) + ["limits"]


def target(model: Any, folder: FilePath, move: str | None = None, singular: int = -1) -> Target:
    """The target of a model; its library has the inversion, with bvp, and nothing else."""
    equations = derive(model)
    names = [name for name in INVERSION if name != "inversion_jacobians" or equations.model.n_e]
    made = generate(model, folder, functions=names, parts=parts_of(equations.model))
    library = load(made.directory)
    path = Path(equations, equations.model.move(move))
    t = np.linspace(0.0, path.duration, SAMPLES)
    sample = path.sample(t)
    y = sample.y[:, :, 0]
    if sample.R is not None:
        y = np.hstack([y, sample.R.transpose(0, 2, 1).reshape(SAMPLES, 9)])
    given = {
        "y": y,
        "dy": sample.derivative(1),
        "ddy": sample.derivative(2),
        "q_start": path.q_start,
    }
    sizes = {key: library.sizes[key] for key in ("n_a", "n_g", "n_m", "n_y", "n_t")}
    structs = structs_of(json.loads((made.directory / "manifest.json").read_text()))
    entry = ctypes.CDLL(str(library_of(made.directory)))
    return Target(equations, library, entry, sizes, given, t[1], singular, made.directory, structs)


@dataclass
class Call:
    """Arguments of one call of invert; ``null``: an argument that is a null pointer; ``short``:
    what work lacks.
    """

    y: np.ndarray
    dy: np.ndarray
    ddy: np.ndarray
    q_start: np.ndarray
    period: float
    n_pre: int = BEFORE
    n_post: int = AFTER
    samples_per_interval: int = 1
    tolerance: float = 1e-6
    hold: int = 0
    delay: float = 0.0
    n: int | None = None
    null: str = ""
    short: int = 0


@dataclass
class MethodResult:
    """Result of a call; ``spilled``: whether anything was written beyond an array."""

    status: int
    report: np.ndarray
    spilled: bool
    results: dict[str, np.ndarray] = field(default_factory=dict)


def call_of(target: Target, **changes: Any) -> Call:
    arrays = {key: np.array(value, dtype=float) for key, value in target.path.items()}
    return Call(**{**arrays, "period": target.period, **changes})


def output(target: Target, q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Output (n, n_y), for a pose position and rotation (n, 3, 3), by CasADi."""
    y = evaluate(target.equations.function("output"), q_a)[0].reshape(len(q_a), -1)
    if target.sizes["n_t"] == target.sizes["n_y"]:
        return y, None
    return y[:, :3], evaluate(target.equations.function("forward_kinematics"), q_a)[1]


def pointer(x: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None if x is None else x.ctypes.data)


def invert(target: Target, call: Call) -> MethodResult:
    """The call of C, with arrays of the exact size; structs lie between sentinels too."""
    s = target.sizes
    structs = target.structs
    n = len(call.y) if call.n is None else call.n
    options = guarded_struct(
        structs["inversion_options"],
        n_pre=call.n_pre,
        n_post=call.n_post,
        samples_per_interval=call.samples_per_interval,
        tolerance=call.tolerance,
        hold=call.hold,
        delay=call.delay,
    )
    size = target.function("invert_work", ctypes.c_int64)(ctypes.c_int(n), pointer(options[0]))
    total = n + call.n_pre + call.n_post if size > 0 else 1
    widths = [s["n_a"], s["n_a"], s["n_a"], s["n_g"], s["n_m"], s["n_m"], s["n_m"]]
    numbers = dict(zip(OUTPUTS, (guarded(max(total, 1) * width) for width in widths), strict=True))
    numbers["work"] = guarded(max(size - call.short, 0) if size > 0 else 8)
    given = {key: np.ascontiguousarray(getattr(call, key)) for key in ARRAYS}
    arrays = {**given, **{key: x for key, (x, _) in numbers.items()}}
    at = {key: None if key == call.null else x.ctypes.data for key, x in arrays.items()}
    numbers["options"] = options
    numbers["path"] = guarded_struct(
        structs["samples"], n=n, period=call.period, y=at["y"], dy=at["dy"], ddy=at["ddy"]
    )
    numbers["motion"] = guarded_struct(structs["motion"], **{key: at[key] for key in OUTPUTS})
    numbers["info"] = guarded_struct(structs["invert_info"])
    where = {
        key: ctypes.c_void_p(None if key == call.null else numbers[key][0].ctypes.data)
        for key in STRUCTURES
    }
    status = target.function("invert")(
        where["path"],
        ctypes.c_void_p(at["q_start"]),
        where["options"],
        where["motion"],
        where["info"],
        ctypes.c_void_p(at["work"]),
        ctypes.c_int64(arrays["work"].size if size > 0 else 8),
    )
    spilled = not all(untouched(block) for _, block in numbers.values())
    results = {key: arrays[key].reshape(total, -1) for key in OUTPUTS} if status >= 0 else {}
    info = structs["invert_info"].from_buffer(numbers["info"][0])
    report = np.array(
        [info.residual, info.residual_at_samples, info.kinematic_mismatch, info.torque_error]
    )
    return MethodResult(status, report, spilled, results)


def guarded_struct(
    structure: type[ctypes.Structure], **members: Any
) -> tuple[np.ndarray, np.ndarray]:
    """The bytes of a struct as numbers, and the block that it lies in, with sentinels on both
    sides.
    """
    numbers, block = guarded(-(-ctypes.sizeof(structure) // 8))
    made = bytes(struct_of(structure, **members))
    numbers[:] = np.frombuffer(made.ljust(8 * len(numbers), bytes(1)))
    return numbers, block


class Streamed:
    """A stream of C in memory of the exact size, or smaller."""

    def __init__(
        self,
        target: Target,
        intervals: int,
        samples_per_interval: int,
        short: int = 0,
        fill: float = 0.0,
    ) -> None:
        self.target = target
        self.samples_per_interval = samples_per_interval
        self.counts = {"intervals": intervals, "samples_per_interval": samples_per_interval}
        options = struct_of(target.structs["stream_options"], **self.counts)
        size = target.function("stream_work", ctypes.c_int64)(ctypes.byref(options))
        self.memory, self.block = guarded(max(size - short, 16))
        self.size = size - short if size > 0 else 16
        self.memory[:] = fill
        s = target.sizes
        rows = samples_per_interval if size > 0 else 1
        widths = (s["n_a"], s["n_a"], s["n_g"], s["n_m"], s["n_m"], s["n_m"])
        self.out = dict(
            zip(
                ("q_a", "v_a", "tau_g", "q_m", "v_m", "tau_m"),
                (guarded(rows * w) for w in widths),
                strict=True,
            )
        )
        members = {key: x.ctypes.data for key, (x, _) in self.out.items()}
        self.motion = guarded_struct(target.structs["motion"], **members)
        self.info = guarded_struct(target.structs["stream_info"])

    @property
    def handle(self) -> Any:
        """The struct that says where the memory is."""
        at = None if self.memory is None else self.memory.ctypes.data
        return struct_of(self.target.structs["stream"], memory=at, size=self.size)

    def start(self, y: Any, q_start: Any, period: float, tolerance: float = 1e-6) -> int:
        options = struct_of(
            self.target.structs["stream_options"],
            **self.counts,
            period=period,
            tolerance=tolerance,
        )
        return self.target.function("stream_start")(
            ctypes.byref(self.handle),
            ctypes.byref(options),
            *(
                pointer(None if x is None else np.ascontiguousarray(x, dtype=float))
                for x in (y, q_start)
            ),
        )

    def start_moving(
        self, path: dict[str, Any], q_start: Any, period: float, tolerance: float = 1e-6
    ) -> int:
        """``path``: members of its struct; arrays or None."""
        options = struct_of(
            self.target.structs["stream_options"],
            **self.counts,
            period=period,
            tolerance=tolerance,
        )
        kept = {
            key: np.ascontiguousarray(x, float) if isinstance(x, np.ndarray) else x
            for key, x in path.items()
        }
        given = struct_of(self.target.structs["samples"], **kept)
        return self.target.function("stream_start_moving")(
            ctypes.byref(self.handle),
            ctypes.byref(options),
            ctypes.byref(given),
            pointer(None if q_start is None else np.ascontiguousarray(q_start, dtype=float)),
        )

    def update(self, y: Any, dy: Any, ddy: Any) -> int:
        given = [None if x is None else np.ascontiguousarray(x, dtype=float) for x in (y, dy, ddy)]
        where = (*given, self.motion[0], self.info[0])
        return self.target.function("stream_update")(
            ctypes.byref(self.handle), *map(pointer, where)
        )

    def limits(self, torque: Any, speed: Any, deviation: float = 0.1) -> int:
        given = [
            None if x is None else np.ascontiguousarray(x, dtype=float) for x in (torque, speed)
        ]
        largest = ctypes.c_double(deviation)
        return self.target.function("stream_limits")(
            ctypes.byref(self.handle), *map(pointer, given), largest
        )

    def all_limits(self, deviation: float = 0.1, **members: Any) -> int:
        """Members of the struct: arrays, numbers or None."""
        given = struct_of(self.target.structs["inversion_limits"], **members)
        call = self.target.function("stream_all_limits")
        return call(ctypes.byref(self.handle), ctypes.byref(given), ctypes.c_double(deviation))

    @property
    def report(self) -> Any:
        """Report of the last update."""
        return self.target.structs["stream_info"].from_buffer(self.info[0])

    @property
    def spilled(self) -> bool:
        blocks = (self.block, self.info[1], self.motion[1], *(b for _, b in self.out.values()))
        return not all(untouched(block) for block in blocks)

    def results(self) -> dict[str, np.ndarray]:
        return {key: x.reshape(self.samples_per_interval, -1) for key, (x, _) in self.out.items()}


# --- what is wrong with a call -------------------------------------------------------------------
Spoiler = Callable[[Target, np.random.Generator], tuple[Call, set[str]]]
FOUND = {"OK", "TOLERANCE_NOT_MET"}  # results that are there
# results that are not, where the path is to blame
LOST = {"UNREACHABLE", "NOT_CONVERGED", "RESULT_NOT_FINITE"}


def plain(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    samples_per_interval = int(rng.choice([1, 2, 3, 7, 50, 1000]))
    return call_of(
        target,
        samples_per_interval=samples_per_interval,
        n_pre=int(rng.integers(0, 30)),
        n_post=int(rng.integers(0, 30)),
    ), (FOUND if samples_per_interval < 3 else FOUND | {"NOT_CONVERGED"})


def not_finite(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    call = call_of(target)
    x = getattr(call, str(rng.choice(ARRAYS)))
    x.flat[rng.integers(x.size)] = rng.choice([np.nan, np.inf, -np.inf])
    return call, {"INPUT_NOT_FINITE"}


def bad_number(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    name = str(rng.choice(["period", "tolerance"]))
    values = [
        np.nan,
        np.inf,
        -np.inf,
        0.0,
        -0.0,
        -1.0,
        *((1e6, 1e300) if name == "period" else (1.0, 2.0)),
    ]
    return call_of(target, **{name: float(rng.choice(values))}), {"BAD_ARGUMENT"}


def bad_count(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    name = str(rng.choice(["n", "n_pre", "n_post", "samples_per_interval"]))
    values = [
        -1,
        -(2**31),
        2**31 - 1,
        1_000_001,
        *((0, 1) if name == "n" else (0,) if name == "samples_per_interval" else ()),
    ]
    return call_of(target, **{name: int(rng.choice(values))}), {"BAD_ARGUMENT"}


def held(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A drive that holds the torques, or something that no drive does."""
    hold = int(rng.integers(0, 3))
    delay = float(rng.choice([0.0, 5e-324, 0.3, 1.0, 3.999, 4.0]))
    if rng.random() < 0.5:
        return call_of(target, hold=hold, delay=delay), FOUND
    if rng.random() < 0.5:
        hold = int(rng.choice([-1, 3, 7, 2**31 - 1, -(2**31)]))
    else:
        delay = float(rng.choice([np.nan, np.inf, -np.inf, -5e-324, -1.0, 4.0 + 1e-12, 1e300]))
    return call_of(target, hold=hold, delay=delay), {"BAD_ARGUMENT"}


def null(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    return call_of(target, null=str(rng.choice([*ARRAYS, *STRUCTURES, "work"]))), {"NULL_ARGUMENT"}


def unwanted(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A result that the caller does not want is not written."""
    return call_of(target, null=str(rng.choice(OUTPUTS))), FOUND


def too_small(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    return call_of(target, short=int(rng.choice([1, 2, 100, 10**9]))), {"WORK_TOO_SMALL"}


def out_of_reach(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A smooth path that leaves the workspace on the way, or a start outside."""
    call = call_of(target)
    s = np.linspace(0.0, 1.0, len(call.y))
    far = np.zeros(target.sizes["n_y"])
    far[0] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(1, 12)
    bump = (16 * (s * (1 - s)) ** 2) if rng.random() < 0.7 else np.ones(len(s))
    call.y[:, 0] += far[0] * bump
    slope = np.gradient(bump, target.period)
    slope[[0, -1]] = 0.0
    call.dy[:, 0] += far[0] * slope
    # joints reach any y of their own
    return call, LOST if target.equations.model.output.type != "combination" else FOUND | LOST


def singular(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A path that joints without deflection would follow straight through a singular pose."""
    if target.singular < 0:
        return jump(target, rng)
    joint = target.singular
    most = rng.uniform(0.2, 0.6)
    t = np.linspace(0.0, 1.0, SAMPLES)
    q = np.tile(target.path["q_start"], (3, SAMPLES, 1))
    apart = 1e-4
    share = rng.uniform(1.5, 2.5)
    for row, s in zip(q, (t - apart, t, t + apart), strict=True):
        row[:, joint] = most * (1.0 - share * s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
    y, R = zip(*(output(target, row) for row in q), strict=True)
    h = apart * target.period * (SAMPLES - 1)
    dy = (y[2] - y[0]) / (2 * h)
    ddy = (y[2] - 2 * y[1] + y[0]) / h**2
    y = y[1]
    if R[1] is not None:
        spin = R[2] @ R[0].transpose(0, 2, 1)
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1) / (2 * h)
        dy = np.hstack([dy, omega])
        ddy = np.hstack([ddy, np.gradient(omega, target.period, axis=0)])
        y = np.hstack([y, R[1].transpose(0, 2, 1).reshape(SAMPLES, 9)])
    dy[[0, -1]] = 0.0
    return call_of(target, y=y, dy=dy, ddy=ddy, q_start=q[1, 0]), {*LOST, "TOLERANCE_NOT_MET"}


def jump(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    call = call_of(target, samples_per_interval=int(rng.choice([1, 2, 5])))
    k = rng.integers(1, len(call.y) - 1)
    j = rng.integers(min(3, target.sizes["n_y"]))
    call.y[k:, j] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-6, 0)
    return call, FOUND | LOST


def rough(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """Derivatives that have nothing to do with the outputs."""
    call = call_of(target, samples_per_interval=int(rng.choice([1, 2, 5])))
    size = 10.0 ** rng.uniform(-3, 8)
    inner = slice(1, -1)
    x = getattr(call, str(rng.choice(["dy", "ddy"])))
    x[inner] += size * rng.normal(size=x[inner].shape) * (rng.random(x[inner].shape) < 0.2)
    return call, FOUND | LOST


def restless(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """An end that is not at rest."""
    call = call_of(target)
    end = rng.choice([0, -1])
    call.dy[end, rng.integers(call.dy.shape[1])] = 10.0 ** rng.uniform(-4, 300)
    return call, {"BAD_ARGUMENT"}


def extreme(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """Numbers that cannot be computed with."""
    call = call_of(target)
    x = getattr(call, str(rng.choice(["y", "dy", "ddy"])))
    x[rng.integers(1, len(x) - 1), rng.integers(min(3, x.shape[1]))] = 10.0 ** rng.uniform(20, 308)
    return call, FOUND | LOST


def strange_time(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A path with a period of 1e-12 to 1e5 s, and with derivatives that fit, or do not."""
    period = float(rng.choice([1e-12, 1e-9, 1e-6, 1e-4, 1.0, 1e3, 1e5]))
    call = call_of(target, period=period)
    if rng.random() < 0.7:
        call.dy *= target.period / period
        call.ddy *= (target.period / period) ** 2
    return call, FOUND | LOST


def tolerances(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    tolerance = float(rng.choice([5e-324, 1e-300, 1e-16, 1e-13, 0.5, 1.0 - 1e-16]))
    return call_of(target, tolerance=tolerance), FOUND | {"NOT_CONVERGED"}


def far_start(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    q = target.path["q_start"] + rng.normal(size=target.sizes["n_a"]) * 10.0 ** rng.uniform(0, 300)
    return call_of(target, q_start=q), FOUND | LOST


def two_samples(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    ends = {
        key: target.path[key][[0, -1 if rng.random() < 0.5 else 0]] for key in ("y", "dy", "ddy")
    }
    ends["dy"] = 0 * ends["dy"]
    ends["ddy"] = 0 * ends["ddy"]
    period = float(rng.choice([1e-3, 0.3, 3.0]))
    sizes = {key: int(rng.choice([0, 1, 5])) for key in ("n_pre", "n_post")}
    return call_of(
        target, **ends, **sizes, period=period, samples_per_interval=int(rng.choice([1, 7, 10**6]))
    ), (
        FOUND | LOST | {"BAD_ARGUMENT"}  # half a turn in one sample
    )


def no_rotation(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """For a pose: scaled, mirrored, sheared, or half a turn after the one before."""
    call = call_of(target)
    if target.sizes["n_t"] == target.sizes["n_y"]:
        return null(target, rng)
    k = int(rng.integers(1, len(call.y)))
    R = call.y[k, 3:].reshape(3, 3).T
    changed = [1.001 * R, -R, R + 1e-3, R @ np.diag([1.0, -1.0, -1.0]), 0 * R, 1e200 * R][
        rng.integers(6)
    ]
    call.y[k, 3:] = changed.T.ravel()
    return call, {"BAD_ARGUMENT"}


SPOILERS: tuple[Spoiler, ...] = (
    plain,
    not_finite,
    bad_number,
    bad_count,
    null,
    unwanted,
    too_small,
    out_of_reach,
    singular,
    jump,
    rough,
    restless,
    extreme,
    strange_time,
    tolerances,
    far_start,
    two_samples,
    no_rotation,
    held,
)
