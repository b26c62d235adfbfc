"""Hostile calls of the inversion in C, made for the tests: by seed, with exactly sized arrays between sentinels."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from emitted import library_of

from flexgen.build.generate import generate
from flexgen.codegen.clib_table import C_FUNCTIONS
from flexgen.codegen.spec import STATUSES, library_name
from flexgen.mechanics.equations import Equations, derive
from flexgen.mechanics.signatures import INVERSION
from flexgen.numerics.evaluate import evaluate
from flexgen.paths.path import Path
from flexgen.runtime import Library, load

CODES = {status.name: status.code for status in STATUSES}
NAMES = {value: name for name, value in CODES.items()}
SENTINEL = -7.25e77
OUTPUTS = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")
ARRAYS = ("place", "rate", "rate2", "q_start")
SAMPLES, BEFORE, AFTER = 41, 12, 8  # of the paths that are spoiled
REPORTS = {name: number for core in C_FUNCTIONS for name, number, _ in core.macros}


def guarded(n: int) -> tuple[np.ndarray, np.ndarray]:
    """An array of n numbers and the block that it lies in, with sentinels on both sides."""
    block = np.full(n + 16, SENTINEL)
    return block[8 : 8 + n], block


def untouched(block: np.ndarray) -> bool:
    return bool((block[:8] == SENTINEL).all() and (block[-8:] == SENTINEL).all())


@dataclass(frozen=True)
class Target:
    """A model with its library, called by address, and a path of its first move, from rest to rest."""

    equations: Equations
    library: Library
    entry: Any
    sizes: dict[str, int]
    path: dict[str, np.ndarray]
    period: float
    singular: int  # the coordinate that is zero at a singular pose; -1 where none is
    directory: FilePath

    def with_library(self, file: FilePath) -> Target:
        """The same, with another shared library."""
        return replace(self, entry=ctypes.CDLL(str(file)))

    def function(self, name: str, returned: Any = ctypes.c_int) -> Callable[..., int]:
        function = getattr(self.entry, f"{library_name(self.equations.model)}_{name}")
        function.restype = returned
        return function


def target(model: Any, folder: FilePath, move: str | None = None, singular: int = -1) -> Target:
    """The target of a model; its library holds no more than the inversion."""
    equations = derive(model)
    names = [name for name in INVERSION if name != "inversion_jacobians" or equations.model.n_e]
    made = generate(model, folder, functions=names)
    library = load(made.directory)
    path = Path(equations, equations.model.move(move))
    t = np.linspace(0.0, path.duration, SAMPLES)
    sample = path.sample(t)
    place = sample.y[:, :, 0]
    if sample.R is not None:
        place = np.hstack([place, sample.R.transpose(0, 2, 1).reshape(SAMPLES, 9)])
    given = {"place": place, "rate": sample.rates(1), "rate2": sample.rates(2), "q_start": path.q_start}
    sizes = {key: library.sizes[key] for key in ("n_a", "n_g", "n_m", "n_y", "n_t")}
    return Target(
        equations, library, ctypes.CDLL(str(library_of(made.directory))), sizes, given, t[1], singular, made.directory
    )


@dataclass
class Call:
    """Arguments of one call of invert; ``null``: an argument that is a null pointer; ``short``: what work lacks."""

    place: np.ndarray
    rate: np.ndarray
    rate2: np.ndarray
    q_start: np.ndarray
    period: float
    lead: int = BEFORE
    tail: int = AFTER
    every: int = 1
    tolerance: float = 1e-6
    n: int | None = None
    null: str = ""
    short: int = 0


@dataclass
class MethodResult:
    """What came back; ``spilled``: whether anything was written beyond an array."""

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
    """The call of C, with arrays of the exact size."""
    s = target.sizes
    n = len(call.place) if call.n is None else call.n
    whole = [ctypes.c_int(x) for x in (call.lead, call.tail, call.every)]
    size = target.function("invert_work", ctypes.c_int64)(ctypes.c_int(n), *whole)
    total = n + call.lead + call.tail if size > 0 else 1
    widths = [s["n_a"], s["n_a"], s["n_a"], s["n_g"], s["n_m"], s["n_m"], s["n_m"]]
    numbers = dict(zip(OUTPUTS, (guarded(max(total, 1) * width) for width in widths), strict=True))
    numbers["report"] = guarded(REPORTS["INVERT_REPORT"])
    numbers["work"] = guarded(max(size - call.short, 0) if size > 0 else 8)
    given = {key: np.ascontiguousarray(getattr(call, key)) for key in ARRAYS}
    every = {**given, **{key: x for key, (x, _) in numbers.items()}}
    at = {key: pointer(None if key == call.null else x) for key, x in every.items()}
    status = target.function("invert")(
        ctypes.c_int(n),
        ctypes.c_double(call.period),
        *(at[key] for key in ARRAYS),
        *whole,
        ctypes.c_double(call.tolerance),
        *(at[key] for key in (*OUTPUTS, "report", "work")),
        ctypes.c_int64(every["work"].size if size > 0 else 8),
    )
    spilled = not all(untouched(block) for _, block in numbers.values())
    results = {key: every[key].reshape(total, -1) for key in OUTPUTS} if status >= 0 else {}
    return MethodResult(status, every["report"], spilled, results)


class Streamed:
    """A stream of C in memory of the exact size, or of what is left of it."""

    def __init__(self, target: Target, intervals: int, parts: int, short: int = 0, fill: float = 0.0) -> None:
        self.target, self.parts = target, parts
        size = target.function("stream_work", ctypes.c_int64)(ctypes.c_int(intervals), ctypes.c_int(parts))
        self.counts = ctypes.c_int(intervals), ctypes.c_int(parts)
        self.memory, self.block = guarded(max(size - short, 16))
        self.size = size - short if size > 0 else 16
        self.memory[:] = fill
        s = target.sizes
        rows = parts if size > 0 else 1
        widths = (s["n_a"], s["n_a"], s["n_g"], s["n_m"], s["n_m"], s["n_m"])
        self.out = dict(
            zip(("q_a", "v_a", "tau_g", "q_m", "v_m", "tau_m"), (guarded(rows * w) for w in widths), strict=True)
        )
        self.report = guarded(REPORTS["STREAM_REPORT"])

    def start(self, place: Any, q_start: Any, period: float, tolerance: float = 1e-6) -> int:
        return self.target.function("stream_start")(
            pointer(self.memory),
            ctypes.c_int64(self.size),
            *self.counts,
            ctypes.c_double(period),
            ctypes.c_double(tolerance),
            *(pointer(None if x is None else np.ascontiguousarray(x, dtype=float)) for x in (place, q_start)),
        )

    def update(self, place: Any, rate: Any, rate2: Any) -> int:
        given = [None if x is None else np.ascontiguousarray(x, dtype=float) for x in (place, rate, rate2)]
        return self.target.function("stream_update")(
            pointer(self.memory),
            *(pointer(x) for x in given),
            *(pointer(x) for x, _ in self.out.values()),
            pointer(self.report[0]),
        )

    def limits(self, torque: Any, speed: Any, bend: float = 0.1) -> int:
        given = [None if x is None else np.ascontiguousarray(x, dtype=float) for x in (torque, speed)]
        return self.target.function("stream_limits")(pointer(self.memory), *map(pointer, given), ctypes.c_double(bend))

    @property
    def spilled(self) -> bool:
        return not all(untouched(block) for block in (self.block, self.report[1], *(b for _, b in self.out.values())))

    def results(self) -> dict[str, np.ndarray]:
        return {key: x.reshape(self.parts, -1) for key, (x, _) in self.out.items()}


# --- what is wrong with a call ----------------------------------------------------------------------------------------
Spoiler = Callable[[Target, np.random.Generator], tuple[Call, set[str]]]
FOUND = {"OK", "INEXACT"}  # results that are there
LOST = {"UNREACHABLE", "NOT_CONVERGED", "RESULT_NOT_FINITE"}  # results that are not, where the path is to blame


def plain(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    every = int(rng.choice([1, 2, 3, 7, 50, 1000]))
    return call_of(target, every=every, lead=int(rng.integers(0, 30)), tail=int(rng.integers(0, 30))), (
        FOUND if every < 3 else FOUND | {"NOT_CONVERGED"}
    )


def not_finite(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    call = call_of(target)
    x = getattr(call, str(rng.choice(ARRAYS)))
    x.flat[rng.integers(x.size)] = rng.choice([np.nan, np.inf, -np.inf])
    return call, {"INPUT_NOT_FINITE"}


def bad_number(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    name = str(rng.choice(["period", "tolerance"]))
    values = [np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, *((1e6, 1e300) if name == "period" else (1.0, 2.0))]
    return call_of(target, **{name: float(rng.choice(values))}), {"BAD_ARGUMENT"}


def bad_count(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    name = str(rng.choice(["n", "lead", "tail", "every"]))
    values = [-1, -(2**31), 2**31 - 1, 1_000_001, *((0, 1) if name == "n" else (0,) if name == "every" else ())]
    return call_of(target, **{name: int(rng.choice(values))}), {"BAD_ARGUMENT"}


def null(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    return call_of(target, null=str(rng.choice([*ARRAYS, *OUTPUTS, "report", "work"]))), {"NULL_ARGUMENT"}


def too_small(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    return call_of(target, short=int(rng.choice([1, 2, 100, 10**9]))), {"WORK_TOO_SMALL"}


def out_of_reach(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A smooth path that leaves the workspace on the way, or a start outside."""
    call = call_of(target)
    s = np.linspace(0.0, 1.0, len(call.place))
    far = np.zeros(target.sizes["n_y"])
    far[0] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(1, 12)
    bump = (16 * (s * (1 - s)) ** 2) if rng.random() < 0.7 else np.ones(len(s))
    call.place[:, 0] += far[0] * bump
    slope = np.gradient(bump, target.period)
    slope[[0, -1]] = 0.0
    call.rate[:, 0] += far[0] * slope
    # joints reach any place of their own
    return call, LOST if target.equations.model.output.type != "combination" else FOUND | LOST


def singular(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """A path that joints without deflection would follow straight through a singular pose."""
    if target.singular < 0:
        return jump(target, rng)
    joint, most = target.singular, rng.uniform(0.2, 0.6)
    t = np.linspace(0.0, 1.0, SAMPLES)
    q = np.tile(target.path["q_start"], (3, SAMPLES, 1))
    apart = 1e-4
    share = rng.uniform(1.5, 2.5)
    for row, s in zip(q, (t - apart, t, t + apart), strict=True):
        row[:, joint] = most * (1.0 - share * s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
    y, R = zip(*(output(target, row) for row in q), strict=True)
    h = apart * target.period * (SAMPLES - 1)
    rate, rate2 = (y[2] - y[0]) / (2 * h), (y[2] - 2 * y[1] + y[0]) / h**2
    place = y[1]
    if R[1] is not None:
        spin = R[2] @ R[0].transpose(0, 2, 1)
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1) / (2 * h)
        rate = np.hstack([rate, omega])
        rate2 = np.hstack([rate2, np.gradient(omega, target.period, axis=0)])
        place = np.hstack([place, R[1].transpose(0, 2, 1).reshape(SAMPLES, 9)])
    rate[[0, -1]] = 0.0
    return call_of(target, place=place, rate=rate, rate2=rate2, q_start=q[1, 0]), {*LOST, "INEXACT"}


def jump(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    call = call_of(target, every=int(rng.choice([1, 2, 5])))
    k, j = rng.integers(1, len(call.place) - 1), rng.integers(min(3, target.sizes["n_y"]))
    call.place[k:, j] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-6, 0)
    return call, FOUND | LOST


def rough(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """Derivatives that have nothing to do with the places."""
    call = call_of(target, every=int(rng.choice([1, 2, 5])))
    size = 10.0 ** rng.uniform(-3, 8)
    inner = slice(1, -1)
    x = getattr(call, str(rng.choice(["rate", "rate2"])))
    x[inner] += size * rng.normal(size=x[inner].shape) * (rng.random(x[inner].shape) < 0.2)
    return call, FOUND | LOST


def restless(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """An end that is not at rest."""
    call = call_of(target)
    end = rng.choice([0, -1])
    call.rate[end, rng.integers(call.rate.shape[1])] = 10.0 ** rng.uniform(-4, 300)
    return call, {"BAD_ARGUMENT"}


def extreme(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """Numbers that cannot be computed with."""
    call = call_of(target)
    x = getattr(call, str(rng.choice(["place", "rate", "rate2"])))
    x[rng.integers(1, len(x) - 1), rng.integers(min(3, x.shape[1]))] = 10.0 ** rng.uniform(20, 308)
    return call, FOUND | LOST


def strange_time(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """The same path in no time, or in a day, and with derivatives that fit, or do not."""
    period = float(rng.choice([1e-12, 1e-9, 1e-6, 1e-4, 1.0, 1e3, 1e5]))
    call = call_of(target, period=period)
    if rng.random() < 0.7:
        call.rate *= target.period / period
        call.rate2 *= (target.period / period) ** 2
    return call, FOUND | LOST


def tolerances(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    tolerance = float(rng.choice([5e-324, 1e-300, 1e-16, 1e-13, 0.5, 1.0 - 1e-16]))
    return call_of(target, tolerance=tolerance), FOUND | {"NOT_CONVERGED"}


def far_start(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    q = target.path["q_start"] + rng.normal(size=target.sizes["n_a"]) * 10.0 ** rng.uniform(0, 300)
    return call_of(target, q_start=q), FOUND | LOST


def two_samples(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    ends = {key: target.path[key][[0, -1 if rng.random() < 0.5 else 0]] for key in ("place", "rate", "rate2")}
    ends["rate"], ends["rate2"] = 0 * ends["rate"], 0 * ends["rate2"]
    period = float(rng.choice([1e-3, 0.3, 3.0]))
    sizes = {key: int(rng.choice([0, 1, 5])) for key in ("lead", "tail")}
    return call_of(target, **ends, **sizes, period=period, every=int(rng.choice([1, 7, 10**6]))), (
        FOUND | LOST | {"BAD_ARGUMENT"}  # half a turn in one sample
    )


def no_rotation(target: Target, rng: np.random.Generator) -> tuple[Call, set[str]]:
    """For a pose: scaled, mirrored, sheared, or half a turn after the one before."""
    call = call_of(target)
    if target.sizes["n_t"] == target.sizes["n_y"]:
        return null(target, rng)
    k = int(rng.integers(1, len(call.place)))
    R = call.place[k, 3:].reshape(3, 3).T
    changed = [1.001 * R, -R, R + 1e-3, R @ np.diag([1.0, -1.0, -1.0]), 0 * R, 1e200 * R][rng.integers(6)]
    call.place[k, 3:] = changed.T.ravel()
    return call, {"BAD_ARGUMENT"}


SPOILERS: tuple[Spoiler, ...] = (
    plain,
    not_finite,
    bad_number,
    bad_count,
    null,
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
)
