"""Numbers of a GPU: codes of CUDA as published, sizes of workspaces, shapes of many problems, calls of a function."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from fake_gpu import FakeDriver
from numpy.testing import assert_array_equal

from flexgen.cuda import driver, inversion
from flexgen.cuda.arrays import DeviceArray
from flexgen.cuda.functions import CudaFunction, functions_of
from flexgen.errors import ArgumentError, BuildError, SolverError
from flexgen.spec.ports import Port


def test_codes_of_the_driver_are_those_of_its_header() -> None:
    """Of cuda.h: CU_DEVICE_ATTRIBUTE_..., CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL, CUDA_ERROR_..., and its largest grid."""
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
        self.shape, self.demanded = shape, None

    def demand(self, shape: Any, real: Any, order: str) -> None:
        assert (real, order) == (np.float64, "C")
        self.demanded = shape


@pytest.mark.parametrize("own", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_many_problems_share_what_they_do_not_have_of_their_own(own: tuple[int, int, int]) -> None:
    """Paths with their rates, parameters, and starts: each of them one, or one for each of seven problems."""
    inverter = Made(_sizes={"n_t": 4, "n_y": 3, "n_a": 2}, _real=np.float64, _parameters=np.zeros(5))
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
        with pytest.raises(ArgumentError, match="given one path, one q_start and one set of parameters, expected the"):
            made._demand(given)
        return
    assert made._demand(given) == (dict(zip(("own_path", "own_parameters", "own_q_start"), own, strict=True)), 7)
    none = (None,)
    assert given["y"].demanded == (*none * own[0], None, 4)
    assert given["dy"].demanded == given["ddy"].demanded == (*path, 50, 3)
    assert given["q_start"].demanded == (*none * own[2], 2)
    assert given["parameters"].demanded == (*none * own[1], 5)
    if own == (1, 1, 1):
        given["q_start"] = Array(6, 2)
        with pytest.raises(ArgumentError, match="given 7 of y, 7 of dy, 7 of ddy, 6 of q_start, 7 of parameters, exp"):
            made._demand(given)


# --- calls of one function --------------------------------------------------------------------------------------------
class Kernel:
    """The kernel of y = p_0 q + (p_1, p_2), which fails with a status where q_1 is not finite."""

    def __init__(self, status: int = 3) -> None:
        self.status, self.started, self.grids = status, [], []

    def bind_arguments(self, where: ctypes.c_void_p) -> int:
        place = ctypes.cast(where, ctypes.POINTER(ctypes.c_void_p))
        self.started.append([ctypes.c_int64.from_address(place[k]).value for k in range(5)])
        return len(self.started)

    def run(self, call: ctypes.c_void_p, blocks: int, threads: int) -> None:
        self.grids.append((blocks, threads))
        n, q, p, y, flag = self.started[(call.value or 0) - 1]
        columns = [np.frombuffer((ctypes.c_double * (2 * n)).from_address(x)).reshape(2, n) for x in (q, y)]
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
    inputs = Port("q", (2,), "rad", "angles"), Port("parameters", (3,), "mixed", "numbers of the model")
    on_cpu: Any = Made(
        name="scaled",
        summary="",
        equation="",
        inputs=inputs,
        outputs=(Port("y", (2,), "rad", "scaled angles"),),
        _failures={-3: (SolverError, "no number")},
        _parameters=np.array([3.0, 0.5, -1.0]),
    )
    (made,) = functions_of({"scaled": on_cpu}, card, np.dtype(float), lambda name: kernel, per_point).values()
    return made


def sent(card: driver.Card, x: Any) -> DeviceArray:
    """A copy on the card."""
    values = np.asfortranarray(x, dtype=float)
    made = DeviceArray.empty(card, values.shape, values.dtype, None)
    card.write(made._address, values.ctypes.data, values.nbytes, 0)
    return made


def test_parameters_are_those_of_the_model_where_none_are_given(gpu: FakeDriver) -> None:
    """They are written to the card once, and used on all streams; so are those of the caller."""
    card, kernel = driver.Card(1), Kernel()
    scaled, q = function_on(card, kernel), np.random.default_rng(2).normal(size=(150, 2))
    given, free = sent(card, q), gpu.free[1]
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
    card, kernel = driver.Card(0), Kernel()
    scaled, q = function_on(card, kernel), np.ones((9, 2))
    bad, free = sent(card, np.where(np.arange(18).reshape(9, 2) == 12, np.nan, 1.0)), gpu.free[0]
    with pytest.raises(SolverError, match=r"^scaled, point 6: no number$"):
        scaled(bad)
    kernel.status = 200
    with pytest.raises(BuildError, match=r"^scaled, point 6: unknown status -200; "):
        scaled(bad)
    assert np.isnan(scaled(bad, check=False).numpy()).sum() == 1
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == free - 3 * 8  # only the parameters are kept
    given, both = sent(card, q), sent(card, np.zeros((9, 4)))
    half = DeviceArray(card, both._address + 8, (9, 2), (8, 72), np.dtype(float), None)
    first = DeviceArray(card, both._address, (9, 2), (8, 72), np.dtype(float), None)
    last = DeviceArray(card, both._address + 144, (9, 2), (8, 72), np.dtype(float), None)
    assert_array_equal(scaled(first, out=last).numpy(), np.tile([0.5, -1.0], (9, 1)))  # next to each other
    for x, out in ((given, given), (first, half), (half, first), (last, half)):
        with pytest.raises(ArgumentError, match=r"^scaled, out, y: given memory of another array, expected memory of"):
            scaled(x, out=out)
    for changes, text in (
        ({"out": (given, given)}, "scaled, out: given 2 arrays, expected one for each of y"),
        ({"out": sent(card, np.zeros((8, 2)))}, r"scaled, out, y: given shape \(8, 2\), expected \(9, 2\)"),
        ({"parameters": sent(card, np.zeros((9, 3)))}, r"scaled, parameters: given shape \(9, 3\), expected \(3\)"),
        ({"check": 1}, "scaled, check: given 1, expected True or False"),
        ({"stream": -1}, "scaled, stream: given -1, expected a stream"),
    ):
        with pytest.raises(ArgumentError, match=text):
            scaled(given, **changes)
    each = function_on(card, kernel, per_point=True)
    with pytest.raises(ArgumentError, match=r"scaled, parameters: given shape \(3,\), expected \(9, 3\)"):
        each(given)
    scaled.close("arm")
    with pytest.raises(ArgumentError, match=r"^arm: given a library that was closed"):
        scaled(given)
