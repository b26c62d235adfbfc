"""Numbers of a GPU: codes of CUDA as published, sizes of workspaces, shapes of many problems,
calls of a function.
"""

from __future__ import annotations

import ctypes
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from fake_gpu import FakeDriver
from numpy.testing import assert_array_equal

from flexgen.backends.cuda import driver, inversion
from flexgen.backends.cuda.arrays import DeviceArray
from flexgen.backends.cuda.functions import CudaFunction, functions_of
from flexgen.base.errors import ArgumentError, BuildError, SolverError
from flexgen.base.spec.ports import Port
from flexgen.runtime.inversion.many_inversion import InversionOptions


def test_codes_of_the_driver_are_those_of_its_header() -> None:
    """Of cuda.h: CU_DEVICE_ATTRIBUTE_..., CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL, CUDA_ERROR_..., and
    its largest grid.
    """
    assert (driver._MAJOR, driver._MINOR, driver._ORDINAL) == (75, 76, 9)
    assert (driver._OUT_OF_MEMORY, driver._NO_DEVICE, driver._LAUNCH_RESOURCES) == (2, 100, 701)
    assert driver._SMALLEST == (7, 5) and driver._MOST_BLOCKS == 2147483647


def test_workspaces_grow_in_steps_of_at_most_an_eighth() -> None:
    """No step below 16 reals; eight sizes between two powers of two."""
    found = {n: inversion.workspace_of(n) for n in range(1, 3000)}
    assert all(n <= size <= max(n, 9 * n / 8) for n, size in found.items())
    assert [found[n] for n in (1, 7, 15, 16, 17, 31, 32, 33, 63, 65, 1025)] == [
        1,
        7,
        15,
        16,
        18,
        32,
        32,
        36,
        64,
        72,
        1152,
    ]
    assert len({size for size in found.values() if 1024 <= size < 2048}) == 8


class Array:
    """An array on a card; what was demanded of it."""

    def __init__(self, *shape: int) -> None:
        self.shape = shape
        self.demanded = None

    def demand(self, shape: Any, real: Any, order: str) -> None:
        assert (real, order) == (np.float64, "C")
        self.demanded = shape


@pytest.mark.parametrize("own", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_many_problems_share_what_they_do_not_have_of_their_own(own: tuple[int, int, int]) -> None:
    """Paths with their rates, parameters, and starts: each of them one, or one for each of seven
    problems.
    """
    inverter = Made(
        _sizes={"n_t": 4, "n_y": 3, "n_a": 2}, _real=np.float64, _parameters=np.zeros(5)
    )
    made: Any = object.__new__(inversion.CudaManyInverter)
    made._inverter = inverter
    path, parameters, start = ((7,) * each for each in own)
    given: dict[str, Any] = {
        "y": Array(*path, 50, 4),
        "dy": Array(*path, 50, 3),
        "ddy": Array(*path, 50, 3),
        "q_start": Array(*start, 2),
        "parameters": Array(*parameters, 5),
    }
    if not any(own):
        with pytest.raises(
            ArgumentError,
            match="given one path, one q_start and one set of parameters, expected the",
        ):
            made._demand(given)
        return
    assert made._demand(given) == (
        dict(zip(("own_path", "own_parameters", "own_q_start"), own, strict=True)),
        7,
    )
    none = (None,)
    assert given["y"].demanded == (*none * own[0], None, 4)
    assert given["dy"].demanded == given["ddy"].demanded == (*path, 50, 3)
    assert given["q_start"].demanded == (*none * own[2], 2)
    assert given["parameters"].demanded == (*none * own[1], 5)
    if own == (1, 1, 1):
        given["q_start"] = Array(6, 2)
        with pytest.raises(
            ArgumentError,
            match="given 7 of y, 7 of dy, 7 of ddy, 6 of q_start, 7 of parameters, exp",
        ):
            made._demand(given)


# --- calls of one function -----------------------------------------------------------------------
class Kernel:
    """The kernel of y = p_0 q + (p_1, p_2), which fails with a status where q_1 is not finite."""

    def __init__(self, status: int = 3) -> None:
        self.status = status
        self.started = []
        self.grids = []

    def bind_arguments(self, where: ctypes.c_void_p) -> int:
        place = ctypes.cast(where, ctypes.POINTER(ctypes.c_void_p))
        self.started.append([ctypes.c_int64.from_address(place[k]).value for k in range(5)])
        return len(self.started)

    def run(self, call: ctypes.c_void_p, blocks: int, threads: int) -> None:
        self.grids.append((blocks, threads))
        n, q, p, y, flag = self.started[(call.value or 0) - 1]
        columns = [
            np.frombuffer((ctypes.c_double * (2 * n)).from_address(x)).reshape(2, n)
            for x in (q, y)
        ]
        p_0, *rest = np.frombuffer((ctypes.c_double * 3).from_address(p))
        columns[1][:] = p_0 * columns[0] + np.array(rest)[:, None]
        failed = ctypes.c_uint64.from_address(flag)
        assert failed.value == 2**64 - 1
        for k in np.flatnonzero(~np.isfinite(columns[0][0])):
            failed.value = min(failed.value, int(k) * 256 + self.status)


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    fake = FakeDriver()
    monkeypatch.setattr(driver, "bindings", lambda: fake)
    return fake


def function_on(card: driver.Card, kernel: Kernel, per_point: bool = False) -> CudaFunction:
    inputs = (
        Port("q", (2,), "rad", "angles"),
        Port("parameters", (3,), "mixed", "numbers of the model"),
    )
    on_cpu: Any = Made(
        name="scaled",
        summary="",
        equation="",
        inputs=inputs,
        outputs=(Port("y", (2,), "rad", "scaled angles"),),
        _failures={-3: (SolverError, "no number")},
        _parameters=np.array([3.0, 0.5, -1.0]),
    )
    (made,) = functions_of(
        {"scaled": on_cpu}, card, np.dtype(float), lambda name: kernel, per_point
    ).values()
    return made


def sent(card: driver.Card, x: Any) -> DeviceArray:
    """A copy on the card."""
    values = np.asfortranarray(x, dtype=float)
    made = DeviceArray.empty(card, values.shape, values.dtype, None)
    card.write(made._address, values.ctypes.data, values.nbytes, 0)
    return made


def test_parameters_are_those_of_the_model_where_none_are_given(gpu: FakeDriver) -> None:
    """They are written to the card once, and used on all streams; so are those of the caller."""
    card = driver.Card(1)
    kernel = Kernel()
    scaled = function_on(card, kernel)
    q = np.random.default_rng(2).normal(size=(150, 2))
    given = sent(card, q)
    free = gpu.free[1]
    found = [scaled(given, stream=stream) for stream in (None, gpu.new_stream(), gpu.new_stream())]
    for x in found:
        assert_array_equal(x.numpy(), 3.0 * q + [0.5, -1.0])
    assert gpu.free[1] == free - 3 * 8 - 3 * q.nbytes  # the parameters, and three results
    assert kernel.grids == [(2, 128)] * 3 and len({start[2] for start in kernel.started}) == 1
    assert_array_equal(scaled(given, sent(card, [2.0, 0.0, 1.0])).numpy(), 2.0 * q + [0.0, 1.0])
    out = sent(card, np.zeros((150, 2)))
    assert scaled(parameters=sent(card, [0.0, 4.0, 5.0]), q=given, out=out) is out
    assert_array_equal(out.numpy(), np.tile([4.0, 5.0], (150, 1)))
    assert scaled(sent(card, np.zeros((0, 2)))).shape == (0, 2) and len(kernel.started) == 5
    assert_array_equal(scaled(sent(card, q[:128])).numpy(), 3.0 * q[:128] + [0.5, -1.0])
    assert kernel.grids[-1] == (1, 128)


def test_what_a_function_on_a_card_refuses(gpu: FakeDriver) -> None:
    card = driver.Card(0)
    kernel = Kernel()
    scaled = function_on(card, kernel)
    q = np.ones((9, 2))
    bad = sent(card, np.where(np.arange(18).reshape(9, 2) == 12, np.nan, 1.0))
    free = gpu.free[0]
    with pytest.raises(SolverError, match=r"^scaled, point 6: no number$"):
        scaled(bad)
    kernel.status = 200
    with pytest.raises(BuildError, match=r"^scaled, point 6: unknown status -200; "):
        scaled(bad)
    assert np.isnan(scaled(bad, check=False).numpy()).sum() == 1
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == free - 3 * 8  # only the parameters are kept
    given = sent(card, q)
    both = sent(card, np.zeros((9, 4)))
    half = DeviceArray(card, both._address + 8, (9, 2), (8, 72), np.dtype(float), None)
    first = DeviceArray(card, both._address, (9, 2), (8, 72), np.dtype(float), None)
    last = DeviceArray(card, both._address + 144, (9, 2), (8, 72), np.dtype(float), None)
    # next to each other
    assert_array_equal(scaled(first, out=last).numpy(), np.tile([0.5, -1.0], (9, 1)))
    for x, out in ((given, given), (first, half), (half, first), (last, half)):
        with pytest.raises(
            ArgumentError,
            match=r"^scaled, out, y: given memory of another array, expected memory of",
        ):
            scaled(x, out=out)
    for changes, text in (
        ({"out": (given, given)}, "scaled, out: given 2 arrays, expected one for each of y"),
        (
            {"out": sent(card, np.zeros((8, 2)))},
            r"scaled, out, y: given shape \(8, 2\), expected \(9, 2\)",
        ),
        (
            {"parameters": sent(card, np.zeros((9, 3)))},
            r"scaled, parameters: given shape \(9, 3\), expected \(3\)",
        ),
        ({"check": 1}, "scaled, check: given 1, expected True or False"),
        ({"stream": -1}, "scaled, stream: given -1, expected a stream"),
    ):
        with pytest.raises(ArgumentError, match=text):
            scaled(given, **changes)
    each = function_on(card, kernel, per_point=True)
    with pytest.raises(
        ArgumentError, match=r"scaled, parameters: given shape \(3,\), expected \(9, 3\)"
    ):
        each(given)
    scaled.close("arm")
    with pytest.raises(ArgumentError, match=r"^arm: given a library that was closed"):
        scaled(given)


# --- whole inversions ----------------------------------------------------------------------------
class Problems(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_int64) for name in ("count", "own_path", "own_parameters", "own_q_start")
    )


class Samples(ctypes.Structure):
    _fields_ = (
        ("n", ctypes.c_int64),
        ("period", ctypes.c_double),
        *((x, ctypes.c_void_p) for x in ("y", "dy", "ddy")),
    )


class Options(ctypes.Structure):
    _fields_ = (
        ("n_pre", ctypes.c_int),
        ("n_post", ctypes.c_int),
        ("samples_per_interval", ctypes.c_int),
    )


class Motion(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_void_p) for name in ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")
    )


class Info(ctypes.Structure):
    _fields_ = (
        *(
            (name, ctypes.c_double)
            for name in ("residual", "residual_at_samples", "kinematic_mismatch", "growth")
        ),
        *((name, ctypes.c_int32) for name in ("iterations", "intervals", "n_post")),
    )


STRUCTS = {
    "problems": Problems,
    "samples": Samples,
    "inversion_options": Options,
    "motion": Motion,
    "invert_info": Info,
}
KINDS = (
    Problems,
    Samples,
    ctypes.c_void_p,
    ctypes.c_void_p,
    Options,
    Motion,
    ctypes.c_void_p,
    ctypes.c_void_p,
)


class Solver:
    """A kernel whose torques are y + dy ddy, times the parameter and plus q_start; positions are
    -y, twice as many.
    """

    def __init__(self) -> None:
        self.started: list[list[Any]] = []
        self.grids: list[tuple[int, int]] = []

    def bind_arguments(self, where: ctypes.c_void_p) -> int:
        place = ctypes.cast(where, ctypes.POINTER(ctypes.c_void_p))
        self.started.append(
            [
                kind.from_buffer_copy(ctypes.string_at(place[k], ctypes.sizeof(kind)))  # by value
                for k, kind in enumerate(KINDS)
            ]
        )
        return len(self.started)

    def run(self, call: ctypes.c_void_p, blocks: int, threads: int) -> None:
        self.grids.append((blocks, threads))
        problems, samples, parameters, q_start, options, motion, info, status = self.started[
            (call.value or 0) - 1
        ]
        n = samples.n
        total = samples.n + options.n_pre + options.n_post

        def numbers(address: int, *shape: int) -> np.ndarray:
            return np.frombuffer(
                (ctypes.c_double * int(np.prod(shape))).from_address(address)
            ).reshape(shape)

        for k in range(problems.count):
            y, dy, ddy = (
                numbers(x, problems.count if problems.own_path else 1, n)[k * problems.own_path]
                for x in (samples.y, samples.dy, samples.ddy)
            )
            factor = numbers(parameters.value, k * problems.own_parameters + 1)[-1]
            first = numbers(q_start.value, k * problems.own_q_start + 1)[-1]
            inside = slice(options.n_pre, options.n_pre + n)
            numbers(motion.tau_m, problems.count, total)[k] = first
            numbers(motion.tau_m, problems.count, total)[k, inside] = (
                factor * (y + dy * ddy) + first
            )
            if motion.q_a:
                numbers(motion.q_a, problems.count, total, 2)[k, inside] = -y[:, None]
            told = Info.from_address(info.value + k * ctypes.sizeof(Info))
            told.residual = samples.period * k
            told.iterations = 3 + k
            told.n_post = options.n_post
            ctypes.c_int.from_address(status.value + k * ctypes.sizeof(ctypes.c_int)).value = -k


def many(
    card: driver.Card, solver: Solver, asked: list[int], reals: int = 100
) -> inversion.CudaManyInverter:
    """Of a robot with one output, one motor and two coordinates, whose workspace has ``reals`` of
    a path of 5.
    """
    inverter: Any = Made(
        _sizes={"n_t": 1, "n_y": 1, "n_a": 1},
        _real=np.dtype(float),
        _parameters=np.array([2.0]),
        _structs=STRUCTS,
        _refuse_closed=lambda: None,
        _options=lambda n_pre, n_post, samples_per_interval, **more: {
            "n_pre": n_pre,
            "n_post": n_post,
            "samples_per_interval": samples_per_interval,
        },
        _work_size=lambda n, options, counts: reals * n // 5,
        _widths=lambda: {"q_a": 2, "v_a": 2, "a_a": 2, "tau_g": 1, "q_m": 1, "v_m": 1, "tau_m": 1},
        _interface=Made(sentences={0: "converged", -1: "not converged"}),
    )
    return inversion.CudaManyInverter(inverter, card, lambda work: asked.append(work) or solver)


def rows(card: driver.Card, x: Any) -> DeviceArray:
    """A copy on the card in the order of C."""
    values = np.ascontiguousarray(x, dtype=float)
    made = DeviceArray.empty(card, values.shape, values.dtype, None, "C")
    card.write(made._address, values.ctypes.data, values.nbytes, 0)
    return made


def test_many_problems_are_solved_by_one_kernel_with_their_own_numbers(gpu: FakeDriver) -> None:
    card = driver.Card(0)
    solver = Solver()
    asked = []
    solve = many(card, solver, asked)
    rng = np.random.default_rng(5)
    y, dy, ddy = rng.normal(size=(3, 40, 5, 1))
    options = InversionOptions(n_pre=2, n_post=3)
    path = [rows(card, x) for x in (y, dy, ddy)]
    common = {"period": 0.25, "options": options}
    start = rows(card, [7.0])
    found = solve(*path, q_start=start, **common)
    assert_array_equal(found.tau_m.numpy()[:, 2:7], 2.0 * (y + dy * ddy) + 7.0)
    assert (
        found.tau_m.shape == (40, 10, 1)
        and found.q_a is None
        and (found.tau_m.numpy()[:, 7:] == 7.0).all()
    )
    assert_array_equal(found.status, -np.arange(40))
    assert_array_equal(found.residual, 0.25 * np.arange(40))
    assert_array_equal(found.iterations, 3 + np.arange(40))
    assert (found.n_post == 3).all() and (found.n_pre, found.period) == (2, 0.25)
    assert found.sentence(1) == "not converged" and found.sentence(2) == "unknown status -2"
    # 40 threads; an eighth of 64 more than 100 reals, at most
    assert solver.grids == [(2, 32)] and asked == [104]
    shared = [rows(card, x[0]) for x in (y, dy, ddy)]
    factors = rows(card, [[1.0], [3.0]])
    stream = gpu.new_stream()
    found = solve.on(stream)(
        *shared,
        q_start=rows(card, [[5.0], [6.0]]),
        parameters=factors,
        outputs=("tau_m", "q_a"),
        **common,
    )
    expected = (
        np.array([1.0, 3.0])[:, None, None] * (y + dy * ddy)[0]
        + np.array([5.0, 6.0])[:, None, None]
    )
    assert_array_equal(found.tau_m.numpy()[:, 2:7], expected)
    assert_array_equal(found.q_a.numpy()[:, 2:7], np.tile(-y[0], (2, 1, 2)))
    assert gpu.launched[-1] == (0, stream.ptr) and solve._stream is None
    assert asked == [104]  # a workspace of the same size: the same kernel
    none = solve(*(rows(card, x[:0]) for x in (y, dy, ddy)), q_start=start, **common)
    assert len(none) == 0 and none.tau_m.shape == (0, 10, 1) and len(solver.started) == 2


def test_what_whole_inversions_on_a_card_refuse(gpu: FakeDriver) -> None:
    card = driver.Card(0)
    solver = Solver()
    asked = []
    path = [rows(card, np.ones((3, 5, 1))) for _ in range(3)]
    start = rows(card, [7.0])
    two = rows(card, np.zeros((2, 1)))
    free = gpu.free[0]
    solve = many(card, solver, asked, 36865)
    needed = (
        "given problems that need 327680 bytes of workspace each, expected at most 300000 on "
        "the card; "
    )
    with pytest.raises(ArgumentError, match=f"^invert_many: {needed}"):
        solve(*path, period=0.25, q_start=start)
    solve = many(card, solver, asked, 36864)
    for changes, text in (
        ({"period": 0.0}, "invert_many, period: given 0, expected a number above 0, below 1e6 s"),
        ({"period": 1e6}, r"invert_many, period: given 1e\+06, expected"),
        (
            {"outputs": "tau_m"},
            "invert_many, outputs: given .tau_m., expected some of q_a, v_a, a_a, tau_g, q_m",
        ),
        ({"outputs": ("tau",)}, r"invert_many, outputs: given \('tau',\), expected some of"),
        (
            {"options": InversionOptions(workers=2)},
            "invert_many, workers: given 2 on the card, expected None; ",
        ),
        (
            {"options": InversionOptions(growth=True)},
            "invert_many, growth: given True on the card, expected False; ",
        ),
        (
            {"q_start": np.zeros(1)},
            "invert_many, q_start: given ndarray on the CPU, expected an array on cuda:0",
        ),
        ({"q_start": two}, "given 3 of y, 3 of dy, 3 of ddy, 2 of q_start, expected the same"),
    ):
        with pytest.raises(ArgumentError, match=text):
            solve(*path, **({"period": 0.25, "q_start": start} | changes))
    solve._inverter._parameters = np.zeros(0)
    with pytest.raises(
        ArgumentError,
        match=r"^invert_many, parameters: given to a library without run-time parameters",
    ):
        solve(*path, period=0.25, q_start=start, parameters=start)
    with pytest.raises(
        ArgumentError, match="invert_many, stream: given 'mine', expected a stream"
    ):
        solve.on("mine")
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == free and not solver.started and not asked
    solve._inverter._parameters = np.array([2.0])
    assert (
        len(solve(*path, period=999999.0, q_start=start, parameters=rows(card, np.ones((3, 1)))))
        == 3
    )
    assert asked == [36864]
