"""Functions on a card that is played by the CPU: parameters, results, memory, statuses.

The kernel is the function of the C library, so that each difference is one of what Python gives
to the card or takes from it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fake_gpu import FakeDriver
from numpy.testing import assert_array_equal
from played_kernels import PlayedFunction, with_parameters
from toolchain import needs_compiler

from flexgen.backends.cuda import driver
from flexgen.backends.cuda.arrays import DeviceArray
from flexgen.backends.cuda.functions import CudaFunction, functions_of
from flexgen.base.errors import ArgumentError, BuildError

pytestmark = needs_compiler

N = 150  # points: more than a block of threads


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    fake = FakeDriver()
    monkeypatch.setattr(driver, "bindings", lambda: fake)
    return fake


def on_card(
    card: driver.Card, name: str, per_point: bool = False, reports: int | None = None
) -> tuple[CudaFunction, Any, PlayedFunction]:
    """A function on the card, on the CPU, and its kernel."""
    cpu = with_parameters().functions[name]
    kernel = PlayedFunction(cpu, per_point, reports)
    (made,) = functions_of(
        {name: cpu}, card, np.dtype(float), lambda function: kernel, per_point
    ).values()
    return made, cpu, kernel


def sent(card: driver.Card, x: Any, order: str = "F") -> DeviceArray:
    """A copy on the card."""
    values = np.asarray(x, dtype=float, order="F" if order == "F" else "C")
    made = DeviceArray.empty(card, values.shape, values.dtype, None, order)
    address = made.__cuda_array_interface__["data"][0]
    card.write(address, values.ctypes.data, values.nbytes, 0)
    return made


def drawn(name: str, count: int) -> list[np.ndarray]:
    """Inputs of a function but its parameters."""
    rng = np.random.default_rng(2)
    ports = with_parameters().functions[name].inputs
    return [rng.normal(size=(count, *p.shape)) for p in ports if p.name != "parameters"]


def given_parameters(count: int | None = None) -> np.ndarray:
    model = with_parameters().parameters
    rng = np.random.default_rng(3)
    return model * rng.uniform(0.9, 1.1, model.shape if count is None else (count, model.size))


def test_parameters_are_those_of_the_model_where_none_are_given(gpu: FakeDriver) -> None:
    """They are written to the card once, and used on all streams."""
    card = driver.Card(1)
    gravity, cpu, kernel = on_card(card, "gravity")
    (q,) = drawn("gravity", N)
    given = sent(card, q)
    free = gpu.free[1]
    for stream in (None, gpu.new_stream(), gpu.new_stream()):
        assert_array_equal(gravity(given, stream=stream).numpy(), cpu(q))
    parameters = with_parameters().parameters
    gpu.cuStreamSynchronize(0)
    assert len({start[2].value for start in kernel.started}) == 1
    assert kernel.grids == [(2, 128)] * 3
    for stream in gpu.streams:
        gpu.cuStreamSynchronize(stream)
    assert gpu.free[1] == free - parameters.nbytes
    other = given_parameters()
    assert_array_equal(gravity(given, sent(card, other)).numpy(), cpu(q, other))
    out = sent(card, np.zeros((N, 3)))
    assert gravity(parameters=sent(card, other), q_a=given, out=out) is out
    assert_array_equal(out.numpy(), cpu(q, other))
    assert gravity(sent(card, q[:0])).shape == (0, 3) and len(kernel.started) == 5
    gravity(sent(card, q[:128]))
    assert kernel.grids[-1] == (1, 128)
    assert repr(gravity) == "gravity(q_a, parameters)" == f"{gravity.__name__}(q_a, parameters)"


def test_parameters_may_be_different_for_each_point(gpu: FakeDriver) -> None:
    card = driver.Card(0)
    bias, cpu, _ = on_card(card, "bias", per_point=True)
    q, v = drawn("bias", N)
    parameters = given_parameters(N)
    found = bias(sent(card, q), sent(card, v), sent(card, parameters)).numpy()
    assert_array_equal(found, [cpu(*x) for x in zip(q, v, parameters, strict=True)])
    with pytest.raises(ArgumentError, match=r"bias, parameters: given shape \(\d+,\), expected"):
        bias(sent(card, q), sent(card, v))
    with pytest.raises(ArgumentError, match=r"bias, v_a: given shape \(9, 3\), expected \(150"):
        bias(sent(card, q), sent(card, v[:9]), sent(card, parameters))


def test_several_results_have_names_and_memory_of_their_own(gpu: FakeDriver) -> None:
    """Matrices too; a result may be next to an input, and not one byte in it."""
    card = driver.Card(0)
    pose, cpu, _ = on_card(card, "forward_kinematics")
    (q,) = drawn("forward_kinematics", N)
    given = sent(card, q)
    found = pose(given)
    expected = cpu(q)
    for name, value in zip(expected._fields, expected, strict=True):
        assert_array_equal(getattr(found, name).numpy(), value)
    outs = tuple(sent(card, np.zeros_like(x)) for x in expected)
    again = pose(given, out=outs)
    assert all(x is out for x, out in zip(again, outs, strict=True))
    assert_array_equal(outs[1].numpy(), expected[1])
    gravity, of_gravity, _ = on_card(card, "gravity")
    memory = sent(card, np.zeros(2 * q.size + 1))
    start = memory.__cuda_array_interface__["data"][0]

    def at(place: int) -> DeviceArray:
        """Points in the memory, from this byte on."""
        return DeviceArray(card, start + place, q.shape, (8, 8 * N), q.dtype, None)

    columns = np.asfortranarray(q)
    for place, result, good in (
        (0, q.nbytes, True),
        (q.nbytes, 0, True),
        (0, q.nbytes - 8, False),
        (q.nbytes - 8, 0, False),
        (0, 0, False),
    ):
        card.write(start + place, columns.ctypes.data, q.nbytes, 0)
        if good:
            assert_array_equal(gravity(at(place), out=at(result)).numpy(), of_gravity(q))
            continue
        with pytest.raises(ArgumentError, match=r"^gravity, out, g: given memory of another"):
            gravity(at(place), out=at(result))


def test_parameters_are_memory_that_results_may_not_have(gpu: FakeDriver) -> None:
    """One vector for all points; each point has its own with ``per_point``."""
    card = driver.Card(0)
    q = sent(card, np.zeros((2, 3)))
    size = with_parameters().parameters.size
    memory = sent(card, np.zeros(3 * size))
    start = memory.__cuda_array_interface__["data"][0]
    out = DeviceArray(card, start + 8 * size, (2, 3), (8, 16), np.dtype(float), None)
    shared, _, _ = on_card(card, "gravity")
    own, _, _ = on_card(card, "gravity", per_point=True)
    one = DeviceArray(card, start, (size,), (8,), np.dtype(float), None)
    both = DeviceArray(card, start, (2, size), (8, 16), np.dtype(float), None)
    assert shared(q, one, out=out) is out
    with pytest.raises(ArgumentError, match=r"^gravity, out, g: given memory of another"):
        own(q, both, out=out)


@pytest.mark.parametrize("check", [True, False])
def test_the_status_of_a_point_is_asked_for(check: bool, gpu: FakeDriver) -> None:
    """It takes memory only while it is read."""
    card = driver.Card(0)
    gravity, _, _ = on_card(card, "gravity", reports=6 * 256 + 200)
    given = sent(card, np.zeros((9, 3)))
    parameters = sent(card, given_parameters())
    gravity(given, check=False)  # (the parameters of the model stay on the card)
    gpu.cuStreamSynchronize(0)
    free = gpu.free[0]
    if check:
        with pytest.raises(BuildError, match=r"^gravity, point 6: unknown status -200; "):
            gravity(given, parameters)
    else:
        gravity(given, parameters, check=False)
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == free


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"out": (8, 3)}, r"out, g: given shape \(8, 3\), expected \(9, 3\)"),
        ({"parameters": (9, 3)}, r"parameters: given shape \(9, 3\), expected \(\d+\)"),
        ({"check": 1}, "check: given 1, expected True or False"),
        ({"stream": -1}, "stream: given -1, expected a stream"),
    ],
)
def test_calls_that_are_refused(changes: dict[str, Any], text: str, gpu: FakeDriver) -> None:
    card = driver.Card(0)
    gravity, _, _ = on_card(card, "gravity")
    given = sent(card, np.zeros((9, 3)))
    wrong = {
        key: sent(card, np.zeros(x)) if isinstance(x, tuple) else x for key, x in changes.items()
    }
    with pytest.raises(ArgumentError, match=f"^gravity, {text}"):
        gravity(given, **wrong)
    pair = (given, given)
    with pytest.raises(ArgumentError, match="gravity, out: given 2 arrays, expected one for each"):
        gravity(given, out=pair)
    gravity.close("arm")
    with pytest.raises(ArgumentError, match=r"^arm: given a library that was closed"):
        gravity(given)
