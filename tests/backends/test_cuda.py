"""The functions of a library on a GPU, by the whole path in Python, on a card that is played by
the CPU.

The kernels give the bits of the C library, and what a card cannot do is refused with a sentence.
Only speed, and what NVIDIA's compiler makes of the arithmetic, needs a card:
`tests/cross/test_cuda_kernels.py` compiles for two of them.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import numpy as np
import pytest
from emitted import made
from fake_gpu import FakeDriver, Foreign, Status, compile_on_cpu

import flexgen
from flexgen.backends.cuda import compiler, dlpack, driver, sources
from flexgen.base.errors import ArgumentError, BuildError, SolverError
from flexgen.runtime import identity

N = 150  # points: more than a block of threads


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeDriver]:
    fake = FakeDriver()
    monkeypatch.setattr(driver, "bindings", lambda: fake)
    monkeypatch.setattr(
        compiler,
        "nvrtc",
        lambda: type("Fake", (), {"nvrtcVersion": staticmethod(lambda: (0, 0, 0))}),
    )
    monkeypatch.setattr(compiler, "compile_text", compile_on_cpu)
    yield fake
    assert fake.contexts == []  # every context that was made current is no longer


def robot(device: str = "cuda"):
    return flexgen.load(made("elbow").directory, device=device)


def inputs(function, n: int = N) -> list[np.ndarray]:
    random = np.random.default_rng(7)
    return [np.asfortranarray(random.normal(size=(n, *port.shape))) for port in function.inputs]


@pytest.mark.parametrize(
    "name", [pytest.param("inverse_dynamics", marks=pytest.mark.slow), "forward_kinematics"]
)
def test_function_has_the_bits_of_the_library(gpu, name):
    library = robot("cpu")
    on_card = robot()
    given = inputs(library.functions[name])
    expected = library.functions[name](*given)
    found = on_card.functions[name](*map(on_card.array, given))
    for x, y in zip(
        *((z if isinstance(z, tuple) else (z,)) for z in (found, expected)), strict=True
    ):
        np.testing.assert_array_equal(x.numpy(), y)
    assert type(found).__name__ in ("DeviceArray", name)


def test_swapped_strides_are_seen(gpu, monkeypatch):
    """The planted bug: entries next to each other in place of points."""
    text = compiler.compile_text
    monkeypatch.setattr(
        compiler,
        "compile_text",
        lambda t, *rest: text(
            t.replace("q_a + k,", "q_a + 2 * k,").replace(", n)", ", 1)"), *rest
        ),
    )
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    library = robot("cpu")
    on_card = robot()
    q = inputs(library.gravity)
    assert not np.array_equal(on_card.gravity(on_card.array(q[0])).numpy(), library.gravity(*q))


def test_arrays_of_other_packages_are_read_where_they_are(gpu):
    on_card = robot()
    q = on_card.array(inputs(on_card.gravity)[0])
    expected = on_card.gravity(q).numpy()
    for x in (Foreign(q), Foreign(q, dlpack=False), Foreign(q, dlpack=False, stream=None)):
        np.testing.assert_array_equal(on_card.gravity(x).numpy(), expected)
    out = on_card.array(np.zeros((N, 2)))
    assert on_card.gravity(q, out=out) is out
    np.testing.assert_array_equal(out.numpy(), expected)
    # (2, N) in the order of Fortran, then (N, 2) in that of C
    rows = on_card.array(q.numpy().T.copy(order="F")).T
    with pytest.raises(
        ArgumentError,
        match=r"gravity, q_a: given strides \(16, 8\) of bytes, expected \(8, 1200\)",
    ):
        on_card.gravity(rows)
    in_c = on_card.transpose(Foreign(q.T))  # as JAX has it: (2, N) in the order of C
    assert in_c.shape == (N, 2)
    np.testing.assert_array_equal(on_card.gravity(in_c).numpy(), expected)


def test_results_wait_for_the_stream_of_the_caller(gpu):
    on_card = robot()
    stream = gpu.new_stream()
    other = gpu.new_stream()
    q = on_card.array(inputs(on_card.gravity)[0])
    expected = on_card.gravity(q).numpy()
    later = on_card.gravity(q, stream=stream, check=False)
    assert gpu.launched[-1] == (0, stream.ptr)
    assert len(gpu.streams[stream.ptr]) > 1  # not done yet
    # the other stream waits for the first
    twice = on_card.gravity(later, stream=other, check=False)
    np.testing.assert_array_equal(twice.numpy(), on_card.gravity(on_card.array(expected)).numpy())
    np.testing.assert_array_equal(later.numpy(), expected)
    with pytest.raises(BuildError, match=r"cuda:0: given an error of the driver .*invalid handle"):
        on_card.gravity(q, stream=0x77)
    with pytest.raises(
        ArgumentError, match="gravity, stream: given 'mine', expected a stream of CuPy"
    ):
        on_card.gravity(q, stream="mine")


def test_memory_is_given_back(gpu):
    on_card = robot()
    q = on_card.array(inputs(on_card.gravity)[0])
    before = gpu.free[0]
    for _ in range(3):
        on_card.gravity(Foreign(q)).numpy()
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == before
    del q
    gpu.cuStreamSynchronize(0)
    assert gpu.free[0] == before + 16 * N
    assert not dlpack.exported


def test_a_point_that_fails_is_named_and_nan(gpu):
    on_card = robot()
    q = inputs(on_card.gravity)[0]
    q[[40, 70], 0] = np.nan
    given = on_card.array(q)
    out = on_card.array(np.zeros((N, 2)))
    with pytest.raises(ArgumentError, match="gravity, point 40: an input is not finite"):
        on_card.gravity(given, out=out)
    assert np.flatnonzero(np.isnan(out.numpy()).all(axis=1)).tolist() == [40, 70]
    found = on_card.gravity(given, check=False).numpy()
    np.testing.assert_array_equal(found, out.numpy())


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            lambda r: np.zeros((N, 2)),
            r"gravity, q_a: given ndarray on the CPU, expected an array on cuda:0",
        ),
        (lambda r: "text", r"gravity, q_a: given str, expected an array with __dlpack__"),
        (
            lambda r: r.array(np.zeros((N, 3))),
            r"gravity, q_a: given shape \(150, 3\), expected \(N, 2\)",
        ),
        (lambda r: r.array(np.zeros(2)), r"gravity, q_a: given shape \(2,\), expected \(N, 2\)"),
        (
            lambda r: robot("cuda:1").array(np.zeros((N, 2))),
            "given an array in the memory of cuda:1, expected .*cuda:0",
        ),
        (
            lambda r: Foreign(r.array(np.zeros((N, 2))), dlpack=False, typestr="<f4"),
            "given numbers of type <f4, expected float64",
        ),
        (
            lambda r: Foreign(r.array(np.zeros((N, 2))), dlpack=False, data=(64, False)),
            "given an array in the memory of the CPU, expected one on cuda:0",
        ),
    ],
)
def test_an_array_that_does_not_fit_is_refused(gpu, given, sentence):
    on_card = robot()
    with pytest.raises(ArgumentError, match=sentence):
        on_card.gravity(given(on_card))


def test_inputs_of_different_length_and_shared_results_are_refused(gpu):
    on_card = robot()
    q = on_card.array(np.zeros((N, 2)))
    with pytest.raises(
        ArgumentError, match=r"bias, v_a: given shape \(3, 2\), expected \(150, 2\)"
    ):
        on_card.bias(q, on_card.array(np.zeros((3, 2))))
    with pytest.raises(ArgumentError, match="gravity, out, g: given memory of another array"):
        on_card.gravity(q, out=q)
    with pytest.raises(ArgumentError, match="gravity: given 0 arguments, expected q_a"):
        on_card.gravity()
    assert on_card.gravity(on_card.array(np.zeros((0, 2)))).numpy().shape == (0, 2)


def test_a_card_that_cannot_is_refused(gpu, monkeypatch):
    on_card = robot()
    q = on_card.array(np.zeros((N, 2)))
    gpu.free[0] = 100
    with pytest.raises(
        SolverError, match=r"cuda:0: given more than its memory holds .*expected a smaller call"
    ):
        on_card.gravity(q)
    gpu.capability = (6, 1)
    with pytest.raises(BuildError, match=r"of compute capability 6\.1, expected 7\.5 or newer"):
        robot()
    with pytest.raises(
        BuildError,
        match="given 'cuda:2' on a computer with GPU 0 to 1, expected one that is there",
    ):
        robot("cuda:2")
    gpu.cards = 0
    with pytest.raises(BuildError, match="given 'cuda:0' on a computer with no GPU"):
        robot()
    with pytest.raises(
        ArgumentError, match="device: given 'tpu', expected 'cpu', 'cuda', or 'cuda:1'"
    ):
        robot("tpu")

    gpu.cards = 1
    with pytest.raises(BuildError, match="given 'cuda:1' on a computer with GPU 0 only"):
        robot("cuda:1")
    with monkeypatch.context() as without:
        without.setattr(gpu, "cuGetErrorString", lambda status: (0, b""))
        without.setattr(gpu, "cuInit", lambda flags: (100,))  # CUDA_ERROR_NO_DEVICE
        with pytest.raises(BuildError, match="given 'cuda' on a computer without a GPU"):
            robot()

    def missing(flags: int):
        raise RuntimeError("libcuda.so.1 is not there")

    monkeypatch.setattr(gpu, "cuInit", missing)
    with pytest.raises(
        BuildError, match=r"where no NVIDIA driver is \(libcuda\.so\.1 is not there\)"
    ):
        robot()


def test_an_old_driver_is_named(gpu, monkeypatch):
    on_card = robot()
    monkeypatch.setattr(gpu, "cuModuleLoadData", lambda image: (Status.INVALID_VALUE, None))
    with pytest.raises(BuildError, match="where the driver is older than NVRTC, update it"):
        on_card.gravity.compile()


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cuda.bindings", None)
    monkeypatch.setitem(__import__("sys").modules, "cuda", None)
    with pytest.raises(BuildError, match=r"pip install 'flexgen-robotics\[cuda\]'"):
        robot()
    with pytest.raises(BuildError, match=r"pip install 'flexgen-robotics\[cuda\]'"):
        compiler.nvrtc()


def test_a_library_on_a_card_is_closed_and_pickled(gpu):
    on_card = robot("cuda:1")
    again = pickle.loads(pickle.dumps(on_card))
    assert again.card.ordinal == 1
    assert repr(again).endswith("double precision, on a card on the CPU>")
    again.close()
    with pytest.raises(ArgumentError, match="given a library that was closed"):
        again.gravity(on_card.array(np.zeros((1, 2))))


def test_arrays_of_a_library_have_its_precision_and_an_order(gpu):
    on_card = robot()
    x = np.arange(6).reshape(2, 3)
    for order, strides in (("F", (8, 16)), ("C", (24, 8))):
        made = on_card.array(x, order=order)
        assert (made.strides, made.dtype) == (strides, np.dtype(float))
        np.testing.assert_array_equal(made.numpy(), x)
        np.testing.assert_array_equal(on_card.transpose(made).numpy(), x.T)
        np.testing.assert_array_equal(on_card.transpose(Foreign(made)).numpy(), x.T)
    in_c = Foreign(made, dlpack=False, strides=None)
    np.testing.assert_array_equal(on_card.transpose(in_c).numpy(), x.T)
    single = Foreign(made, dlpack=False, typestr="<f4")
    for call, text in (
        (lambda: on_card.array(x, order="A"), "array, order: given 'A', expected 'F' or 'C'"),
        (lambda: on_card.array("x"), "array: given .*, expected real numbers on the CPU"),
        (lambda: on_card.transpose(single), "transpose, x: given numbers of type <f4, expected "),
    ):
        with pytest.raises(ArgumentError, match=text):
            call()
    several = on_card.invert_many
    assert on_card.invert_many is several and repr(several).startswith("invert_many(y, dy, ddy")


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("elbow_gravity.c", "elbow_gravity.c: given no readable file"),
        ("", "elbow_gravity.c: given a library without this file"),
        ("gravity_shape", "gravity: given a source without the shape of the function"),
    ],
)
def test_a_library_without_a_part_is_refused(file, text, tmp_path):
    written = flexgen.generate("elbow", functions=["gravity"], directory=tmp_path / "elbow")
    folder, manifest = identity.read_manifest(written.directory)
    files = sources.read_files(folder, manifest)
    if file == "elbow_gravity.c":
        (folder / "src" / file).unlink()
        with pytest.raises(BuildError, match=text):
            sources.read_files(folder, manifest)
        return
    kept = {name: x for name, x in files.items() if file}
    left = {name: x.replace("gravity_shape", "other_shape") for name, x in kept.items()}
    with pytest.raises(BuildError, match=text):
        sources.kernel_text(manifest, left, "gravity")


def test_a_changed_source_is_refused(gpu, tmp_path):
    written = flexgen.generate("elbow", functions=["gravity"], directory=tmp_path / "elbow")
    source = written.directory / "src" / "elbow_gravity.c"
    source.write_text(source.read_text() + "\n")
    with pytest.raises(
        BuildError, match=r"elbow_gravity\.c: given another file than flexgen wrote"
    ):
        flexgen.load(written.directory, device="cuda")


def test_capsules_are_those_of_numpy(monkeypatch):
    """NumPy reads what `give` makes, and `take` reads what NumPy makes."""
    x = np.arange(12.0).reshape(3, 4)[:, ::2]
    taken = dlpack.take(x.__dlpack__())
    assert (taken.address, taken.shape, taken.strides, taken.dtype) == (
        x.ctypes.data,
        (3, 2),
        (32, 16),
        "<f8",
    )
    taken.release()

    class OnCpu:
        def __dlpack__(self, **options: object) -> object:
            return dlpack.give(x, x.ctypes.data, x.shape, x.strides, 8, 0)

        def __dlpack_device__(self) -> tuple[int, int]:
            return 1, 0

    monkeypatch.setattr(dlpack, "CUDA", 1)  # kDLCPU
    np.testing.assert_array_equal(y := np.from_dlpack(OnCpu()), x)
    assert y.ctypes.data == x.ctypes.data
    assert len(dlpack.exported) == 1
    del y
    OnCpu().__dlpack__()  # it is not taken
    assert not dlpack.exported
