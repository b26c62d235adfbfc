"""Whole inversions on a card that is played by the CPU: the numbers of the C library.

Kernel and library are the same C, so that each difference is one of what Python gives to the card
or takes from it. `tests/cross/test_cuda_kernels.py` compiles the kernel itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from emitted import loaded, made
from fake_gpu import FakeDriver
from inversion_cases import PERIOD, samples
from numpy.testing import assert_array_equal
from played_kernels import PlayedInversion, with_parameters
from toolchain import needs_compiler

from flexgen.backends.cuda import driver, sources
from flexgen.backends.cuda.arrays import DeviceArray
from flexgen.backends.cuda.inversion import CudaManyInverter, workspace_of
from flexgen.base.errors import ArgumentError
from flexgen.runtime.identity import read_manifest
from flexgen.runtime.inversion.many_inversion import InversionOptions

pytestmark = needs_compiler

OPTIONS = InversionOptions(n_pre=100, n_post=120, samples_per_interval=20)
OUTPUTS = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")


@pytest.fixture(scope="module")
def library() -> Any:
    return with_parameters()


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    fake = FakeDriver()
    monkeypatch.setattr(driver, "bindings", lambda: fake)
    return fake


class OnCard:
    """The library on a card, and what it asked to be compiled."""

    def __init__(self, library: Any, gpu: FakeDriver) -> None:
        self.card = driver.Card(0)
        self.library = library
        self.gpu = gpu
        self.kernels: list[PlayedInversion] = []
        self.invert_many = CudaManyInverter(library.invert, self.card, self.load)

    def load(self, work: int) -> PlayedInversion:
        self.kernels.append(PlayedInversion(self.library.invert, work))
        return self.kernels[-1]

    def rows(self, x: Any) -> DeviceArray:
        """A copy on the card in the order of C."""
        values = np.ascontiguousarray(x, dtype=float)
        made = DeviceArray.empty(self.card, values.shape, values.dtype, None, "C")
        address = made.__cuda_array_interface__["data"][0]
        self.card.write(address, values.ctypes.data, values.nbytes, 0)
        return made


def problems(library: Any, own: str, count: int = 3) -> dict[str, np.ndarray]:
    """Inputs, of which ``own`` (path, start, load) are different for each problem."""
    rng = np.random.default_rng(4)
    given = {key: np.asarray(x) for key, x in samples().items()}
    scale = np.linspace(0.6, 1.0, count)[:, None, None]
    if "path" in own:
        first = given["y"][0]
        given["y"] = first + scale * (given["y"] - first)
        given["dy"] = scale * given["dy"]
        given["ddy"] = scale * given["ddy"]
    if "start" in own:
        given["q_start"] = given["q_start"] + rng.uniform(-0.01, 0.01, (count, 1))
    given["parameters"] = library.parameters
    if "load" in own:
        given["parameters"] = library.parameters * rng.uniform(0.9, 1.1, (count, 1))
    return given


@pytest.mark.parametrize("own", ["path", "start", "load", "path start load"])
def test_inversions_on_a_card_are_those_of_the_library(
    own: str, library: Any, gpu: FakeDriver
) -> None:
    """Arrays that all problems share are given once."""
    on_card = OnCard(library, gpu)
    given = problems(library, own)
    common = {"period": PERIOD, "outputs": OUTPUTS, "options": OPTIONS}
    expected = library.invert_many(**given, **common)
    stream = gpu.new_stream()
    solve = on_card.invert_many.on(stream)
    found = solve(**{key: on_card.rows(x) for key, x in given.items()}, **common)
    assert (expected.status == 0).all() and len(found) == 3
    for name in ("status", "residual", "residual_at_samples", "iterations", "intervals", "n_post"):
        assert_array_equal(getattr(found, name), getattr(expected, name), name)
    for name in OUTPUTS:
        assert_array_equal(getattr(found, name).numpy(), getattr(expected, name), name)
    assert (found.n_pre, found.period) == (100, PERIOD)
    assert found.sentence(0) == expected.sentence(0)
    # one thread a problem, on the caller's stream; others stay on the default stream
    assert on_card.kernels[0].grids == [(1, 32)] and gpu.launched == [(0, stream.ptr)]
    on_card.invert_many(**{key: on_card.rows(x) for key, x in given.items()}, **common)
    assert gpu.launched[1:] == [(0, 0)] and len(on_card.kernels) == 1


def test_parameters_are_those_of_the_model_where_none_are_given(
    library: Any, gpu: FakeDriver
) -> None:
    """Only the results that are asked for take memory, and all else is given back."""
    on_card = OnCard(library, gpu)
    given = problems(library, "start", 33)
    del given["parameters"]
    on_gpu = {key: on_card.rows(x) for key, x in given.items()}
    free = gpu.free[0]
    found = on_card.invert_many(**on_gpu, period=PERIOD, options=OPTIONS)
    expected = library.invert_many(**given, period=PERIOD, options=OPTIONS)
    assert_array_equal(found.tau_m.numpy(), expected.tau_m)
    assert found.q_a is None and on_card.kernels[0].grids == [(2, 32)]
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == free - expected.tau_m.nbytes
    none = {**on_gpu, "q_start": on_card.rows(given["q_start"][:0])}
    assert len(on_card.invert_many(**none, period=PERIOD, options=OPTIONS)) == 0
    assert len(gpu.launched) == 1
    text = "invert_many(y, dy, ddy, *, period, q_start"
    assert repr(on_card.invert_many).startswith(f"{text}, parameters=None, outputs=")
    plain = CudaManyInverter(loaded("elbow").invert, on_card.card, on_card.load)
    assert repr(plain).startswith(f"{text}, outputs=")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"period": 0.0}, "period: given 0, expected a number above 0, below 1e6 s"),
        ({"period": 1e6}, r"period: given 1e\+06, expected a number above 0"),
        ({"outputs": "tau_m"}, "outputs: given 'tau_m', expected some of q_a, v_a"),
        ({"outputs": ("tau",)}, r"outputs: given \('tau',\), expected some of q_a, v_a"),
        ({"options": InversionOptions(workers=2)}, "workers: given 2 on the card, expected None"),
        ({"options": InversionOptions(growth=True)}, "growth: given True on the card, expected F"),
        (
            {"options": InversionOptions(100, 100, 1)},
            r"need \d{6} bytes .*expected at most 300000",
        ),
        ({"q_start": np.zeros(3)}, "q_start: given ndarray on the CPU, expected an array on cuda"),
        ({"q_start": (5, 3)}, "given 5 of q_start, 3 of parameters, expected the same number"),
        ({"dy": (9, 2)}, r"dy: given shape \(9, 2\), expected"),
        ({"q_start": (3, 2)}, r"q_start: given shape \(3, 2\), expected \(N, 3\)"),
        ({"parameters": (1,)}, r"parameters: given shape \(1,\), expected"),
        ({"parameters": None}, "given one path, one q_start and one set of parameters, expected"),
    ],
)
def test_problems_that_a_card_refuses(
    changes: dict[str, Any], text: str, library: Any, gpu: FakeDriver
) -> None:
    on_card = OnCard(library, gpu)
    given: Any = {k: on_card.rows(x) for k, x in problems(library, "load").items()}
    free = gpu.free[0]
    wrong = {
        key: on_card.rows(np.zeros(x)) if key != "outputs" and isinstance(x, tuple) else x
        for key, x in changes.items()
    }
    with pytest.raises(ArgumentError, match=f"^invert_many.*{text}"):
        on_card.invert_many(**({**given, "period": PERIOD, "options": OPTIONS} | wrong))
    del wrong
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == free and not on_card.kernels


def test_a_library_that_cannot_is_refused(library: Any, gpu: FakeDriver) -> None:
    on_card = OnCard(library, gpu)
    with pytest.raises(ArgumentError, match="invert_many, stream: given 'mine', expected a stre"):
        on_card.invert_many.on("mine")
    plain = loaded("elbow")
    solve = CudaManyInverter(plain.invert, on_card.card, on_card.load)
    x = on_card.rows(np.zeros((5, 2)))
    given: Any = {"y": x, "dy": x, "ddy": x, "q_start": x, "period": PERIOD}
    with pytest.raises(ArgumentError, match="given to a library without run-time parameters"):
        solve(**given, parameters=x)
    plain.close()
    with pytest.raises(ArgumentError, match="given a library that was closed"):
        solve(**given)


def test_workspaces_grow_in_steps_of_at_most_an_eighth() -> None:
    """No step below 16 reals; eight sizes between two powers of two, so that few are compiled."""
    found = [workspace_of(n) for n in range(1, 3000)]
    assert all(n <= size <= max(n, 9 * n / 8) for n, size in enumerate(found, 1))
    assert found[:16] == list(range(1, 17)) and found == sorted(found)
    assert len({size for size in found if 1024 <= size < 2048}) == 8


def test_the_kernel_has_parameters_where_the_library_has(library: Any) -> None:
    """One file for each function and that of the inversion, or all in one."""
    for folder, many in ((library.directory, True), (made("elbow").directory, False)):
        place, manifest = read_manifest(folder)
        files = sources.read_files(place, manifest)
        text = sources.inversion_text(manifest, files, 640)
        assert ("const " + manifest["name"] + "_real *parameters, " in text) == many
        assert ("{&problems, &samples, parameters, q_start," in text) == many
        assert "work[640]" in text and "invert_problem(&arrays, k, work, 640)" in text
        included = [row.split('"')[1] for row in text.splitlines() if row.startswith("#include")]
        assert included[0] == f"{manifest['name']}_inversion.c"
        assert len(included) == len(set(included)) == len(manifest["functions"]) + 1
