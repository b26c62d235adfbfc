"""Arrays on a card that is played by the CPU: the layout of NumPy, other packages, streams."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_gpu import FakeDriver, Foreign
from numpy.testing import assert_array_equal

from flexgen.backends.cuda import driver
from flexgen.backends.cuda.arrays import DeviceArray, Given, steps_of, stream_handle
from flexgen.base.errors import ArgumentError

DOUBLE = np.dtype(float)


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    fake = FakeDriver()
    monkeypatch.setattr(driver, "bindings", lambda: fake)
    return fake


def address_of(x: DeviceArray) -> int:
    return int(x.__cuda_array_interface__["data"][0])


def sent(card: driver.Card, x: np.ndarray, stream: Any = None, order: str = "F") -> DeviceArray:
    """A copy on the card."""
    made = DeviceArray.empty(card, x.shape, x.dtype, stream, order)
    card.write(address_of(made), x.ctypes.data, x.nbytes, made.stream)
    return made


@pytest.mark.parametrize("shape", [(), (5,), (4, 3), (2, 3, 4)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_have_the_layout_of_numpy(
    shape: tuple[int, ...], order: Any, gpu: FakeDriver
) -> None:
    """Also seen from the other end; their memory is given back with the last view."""
    card = driver.Card(1)
    free = gpu.free[1]
    x = np.asarray(np.arange(np.prod(shape)).reshape(shape), dtype=np.float32, order=order)
    made = sent(card, x, order=order)
    assert gpu.free[1] == free - x.nbytes
    assert steps_of(shape, 4, order) == x.strides == made.strides
    assert_array_equal(made.numpy(), x)
    view = made.T
    assert (view.shape, view.strides) == (x.T.shape, x.T.strides)
    told = made.__cuda_array_interface__
    assert (told["shape"], told["strides"], told["typestr"]) == (shape, x.strides, "<f4")
    assert (told["version"], told["stream"], told["data"][1]) == (3, 1, False)
    assert made.__dlpack_device__() == (2, 1)
    assert repr(made) == f"<DeviceArray {shape}, float32, cuda:1>"
    del made
    assert_array_equal(view.numpy(), x.T)
    del view
    gpu.cuStreamSynchronize(0)
    assert gpu.free[1] == free


@pytest.mark.parametrize(
    ("stream", "handle"),
    [
        (None, 0),
        (9, 9),
        (SimpleNamespace(cuda_stream=5), 5),
        (SimpleNamespace(ptr=6), 6),
        (SimpleNamespace(__cuda_stream__=lambda: (0, 8)), 8),
        (SimpleNamespace(__cuda_stream__=(0, 4)), 4),
        *((bad, None) for bad in (True, -1, "s", 1.0, SimpleNamespace(ptr=-3))),
    ],
)
def test_streams_are_handles_or_objects_that_have_one(stream: Any, handle: int | None) -> None:
    if handle is not None:
        assert stream_handle("f", stream) == handle
        return
    expected = "expected a stream of CuPy, PyTorch or cuda.core, or its handle"
    with pytest.raises(ArgumentError, match=f"^f, stream: given .*, {expected}"):
        stream_handle("f", stream)


def waits_for(gpu: FakeDriver, stream: int, other: int) -> bool:
    """Whether the end of a stream's work is after that of the work that another one has."""
    gpu.cuStreamSynchronize(stream)
    return not gpu.streams[other]


@pytest.mark.parametrize("taker", ["own", "other", "default", "legacy", "unasked"])
def test_who_takes_an_array_waits_for_its_stream(taker: str, gpu: FakeDriver) -> None:
    """But the stream itself, and where no synchronization is asked for."""
    card = driver.Card(0)
    own = gpu.new_stream().ptr
    other = gpu.new_stream().ptr
    made = DeviceArray.empty(card, (2,), DOUBLE, own)
    card.fill(address_of(made), 0, 16, own)
    stream: Any = {"own": own, "other": other, "default": None, "legacy": 1, "unasked": -1}[taker]
    made.__dlpack__(stream=stream)
    assert len(gpu.streams[own]) == 1
    reader = {"default": 0, "legacy": 0}.get(taker, other)
    assert waits_for(gpu, reader, own) == (taker not in ("own", "unasked"))


@pytest.mark.parametrize("told", ["none", "default", "own", "other"])
def test_functions_wait_for_the_stream_of_an_array(told: str, gpu: FakeDriver) -> None:
    """The interface names it; 1 is the default stream, and no stream means that it is ready."""
    card = driver.Card(0)
    streams = {"own": gpu.new_stream().ptr, "other": gpu.new_stream().ptr, "default": 0}
    x = sent(card, np.zeros((2, 3)))
    for handle in streams.values():
        card.fill(address_of(x), 0, 8, handle)
    named = {"none": None, "default": 1}.get(told, streams.get(told))
    Given(card, "f", "q", Foreign(x, dlpack=False, stream=named), streams["own"])
    for name in ("other", "default"):
        assert waits_for(gpu, streams["own"], streams[name]) == (told == name)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"mask": 1}, "given an array with masked entries, expected real numbers"),
        ({"data": (0, False)}, "given an array in the memory of the CPU, expected one on cuda:0"),
        ({"strides": (8,)}, r"given strides \(8,\) for shape \(2, 3\), expected as many"),
        ({"data": None}, "given Foreign that does not give its memory .*x.detach()"),
    ],
)
def test_arrays_of_others_that_do_not_fit(
    changes: dict[str, Any], text: str, gpu: FakeDriver
) -> None:
    card = driver.Card(0)
    x = sent(card, np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match=f"^f, q: {text}"):
        Given(card, "f", "q", Foreign(x, dlpack=False, **changes), 0)
    for here, place in ((np.zeros(2), "ndarray"), ([1.0], "list"), (2.0, "float")):
        with pytest.raises(ArgumentError, match=f"^f, q: given {place} on the CPU, expected an a"):
            Given(card, "f", "q", here, 0)


def test_arrays_without_numbers_are_in_no_memory(gpu: FakeDriver) -> None:
    card = driver.Card(0)
    x = sent(card, np.zeros((2, 3)))
    none = Given(card, "f", "q", Foreign(x, False, shape=(0, 3), data=(0, False)), 0)
    none.demand((None, 3), DOUBLE, "C")
    assert none.strides == x.strides
    whole = Given(card, "f", "q", Foreign(x, False, strides=None), 0)
    assert (whole.shape, whole.strides, whole.dtype) == ((2, 3), None, "<f8")
    whole.demand((None, 3), DOUBLE, "C")  # without strides: in the order of C
    with pytest.raises(ArgumentError, match=r"given strides \(24, 8\) of bytes, expected \(8, 16"):
        whole.demand((2, 3), DOUBLE, "F")


@pytest.mark.parametrize(
    ("changes", "shape", "order", "text"),
    [
        ({}, (None, 4), "C", r"given shape \(2, 3\), expected \(N, 4\)$"),
        ({}, (3, 3), "C", r"given shape \(2, 3\), expected \(3, 3\)$"),
        ({}, (2, 3, 1), "C", r"given shape \(2, 3\), expected \(2, 3, 1\)$"),
        ({"typestr": "<f4"}, (2, 3), "C", "given numbers of type <f4, expected float64"),
        ({"strides": (8, 16)}, (2, 3), "C", r"expected \(24, 8\): rows without gaps"),
        ({"strides": (24, 8)}, (2, 3), "F", r"expected \(8, 16\): the order of Fortran"),
        ({"shift": 4}, (2, 3), "C", "given address 0x[0-9a-f]+, expected one for float64$"),
        # an axis of one entry has no step
        ({"shape": (2, 1), "strides": (8, 99)}, (2, 1), "C", ""),
        ({}, (None, 3), "C", ""),
    ],
)
def test_shape_type_order_and_place_are_demanded(
    changes: dict[str, Any], shape: Any, order: str, text: str, gpu: FakeDriver
) -> None:
    card = driver.Card(0)
    x = sent(card, np.zeros((2, 3)), order="C")
    told = {key: value for key, value in changes.items() if key != "shift"}
    if "shift" in changes:
        told["data"] = (address_of(x) + changes["shift"], False)
    given = Given(card, "f", "q", Foreign(x, dlpack=False, **told), 0)
    if not text:
        given.demand(shape, DOUBLE, order)
        return
    with pytest.raises(ArgumentError, match=f"^f, q: .*{text}"):
        given.demand(shape, DOUBLE, order)


def test_copies_and_other_devices_are_not_given(gpu: FakeDriver) -> None:
    made = sent(driver.Card(0), np.zeros(2))
    made.__dlpack__(copy=False, dl_device=(2, 0))
    for asked, text in (
        ({"copy": True}, "given copy=True, expected None or False"),
        ({"dl_device": (2, 1)}, r"given the device \(2, 1\), expected \(2, 0\)"),
    ):
        with pytest.raises(BufferError, match=text):
            made.__dlpack__(**asked)


def test_more_points_than_a_grid_has_are_refused(gpu: FakeDriver) -> None:
    card = driver.Card(0)
    most = 128 * (2**31 - 1)
    with pytest.raises(ArgumentError, match=f"given {most + 1} points, expected at most {most}$"):
        card.launch(None, most + 1, [], 0)
