"""The kernels of all functions: NVRTC compiles them for two cards, g++ gives the bits of the
library.

Neither needs a card. Registers and bytes of stack of a thread are compared with a table, since a
kernel that spills its registers is many times slower: where NVRTC or an emitted text has changed,
look at the change and write it again by `python tests/cross/test_cuda_kernels.py`.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from emitted import made
from fake_gpu import FakeDriver, compile_on_cpu
from inversion_cases import PERIOD, samples

import flexgen
from flexgen.backends.cuda import compiler, driver, sources

TABLE = Path(__file__).resolve().parents[1] / "golden" / "cuda_kernels.json"
ARCHITECTURES = ("sm_80", "sm_90")
MODELS = ("elbow", "planar5_nmp")


def library_files(name: str):
    """Manifest and files of a library."""
    folder = made(name).directory
    manifest = json.loads((folder / "manifest.json").read_text())
    return manifest, sources.read_files(folder, manifest)


def measure(name: str) -> dict[str, list[int]]:
    """By function and architecture: registers, stack and spilled bytes of a thread, as ptxas
    reports them.
    """
    manifest, files = library_files(name)
    headers = sources.headers_of(files)
    found = {}
    for row in manifest["functions"]:
        text = sources.kernel_text(manifest, files, row["name"])
        for architecture in ARCHITECTURES:
            options = [*compiler.options_of(name, architecture), "--ptxas-options=-v"]
            cubin, log = compiler.compile_text(text, headers, options)
            assert cubin.startswith(b"\x7fELF") and f"k_{row['name']}".encode() in cubin
            numbers = re.search(
                r"(\d+) bytes stack frame, (\d+) bytes spill stores.*?Used (\d+) registers",
                log,
                re.S,
            )
            assert numbers is not None, log
            stack, spilled, registers = map(int, numbers.groups())
            found[f"{row['name']} {architecture}"] = [registers, stack, spilled]
    return found


@pytest.fixture
def on_cpu(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    """A card that is played by the CPU."""
    fake = FakeDriver()
    monkeypatch.setattr(driver, "bindings", lambda: fake)
    monkeypatch.setattr(
        compiler,
        "nvrtc",
        lambda: type("Fake", (), {"nvrtcVersion": staticmethod(lambda: (0, 0, 0))}),
    )
    monkeypatch.setattr(compiler, "compile_text", compile_on_cpu)
    return fake


def nvrtc_or_skip() -> None:
    pytest.importorskip(
        "cuda.bindings.nvrtc", reason="the extra [cuda] is not installed: no NVRTC"
    )


@pytest.mark.parametrize("name", [MODELS[0], pytest.param(MODELS[1], marks=pytest.mark.slow)])
def test_nvrtc_compiles_every_function(name):
    nvrtc_or_skip()
    found = measure(name)
    expected = json.loads(TABLE.read_text())[name]
    assert found.keys() == expected.keys()
    for kernel, (registers, stack, spilled) in found.items():
        usual, usual_stack, usual_spilled = expected[kernel]
        assert registers <= 1.25 * usual + 8, kernel  # versions of NVRTC differ by a few
        assert stack <= 1.25 * usual_stack + 64, kernel
        assert spilled <= 1.25 * usual_spilled + 64, kernel


def test_a_kernel_that_spills_is_seen():
    """The planted bug: 2000 numbers of a thread in memory."""
    nvrtc_or_skip()
    manifest, files = library_files("elbow")
    text = sources.kernel_text(manifest, files, "gravity").replace(
        "if (k >= n)",
        "volatile double kept[2000]; kept[n % 2000] = 1.0; if (k >= n + 0 * kept[k % 2000])",
    )
    options = [*compiler.options_of("elbow", "sm_90"), "--ptxas-options=-v"]
    _, log = compiler.compile_text(text, sources.headers_of(files), options)
    assert int(re.search(r"(\d+) bytes stack frame", log)[1]) >= 16000


def test_text_that_is_wrong_is_refused():
    nvrtc_or_skip()
    with pytest.raises(
        flexgen.BuildError, match=r"NVRTC: given C that it does not compile for .*sm_90: .*error"
    ):
        compiler.compile_text("int x = y;", {}, compiler.options_of("elbow", "sm_90"))


@pytest.mark.parametrize("name", [MODELS[0], pytest.param(MODELS[1], marks=pytest.mark.slow)])
def test_the_library_in_one_file_is_cpp(name, tmp_path):
    written = flexgen.generate(name, directory=tmp_path / name, amalgamate=True, build=False)
    command = [
        "g++",
        "-x",
        "c++",
        "-fsyntax-only",
        f"-D{name.upper()}_NO_VECTORS",
        "-I.",
        f"{name}.c",
    ]
    subprocess.run(command, cwd=written.directory, check=True)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", MODELS)
def test_every_function_has_the_bits_of_the_library(name, precision, on_cpu, tmp_path):
    """By the whole path in Python, on a card that is played by the CPU."""
    folder = flexgen.generate(name, directory=tmp_path / name, precision=precision).directory
    library = flexgen.load(folder)
    on_card = flexgen.load(folder, device="cuda")
    random = np.random.default_rng(3)
    for function in library.functions.values():
        given = [
            np.asfortranarray(random.normal(size=(300, *port.shape)), library.parameters.dtype)
            for port in function.inputs
        ]
        expected = function(*given)
        found = on_card.functions[function.name](*map(on_card.array, given))
        pairs = (
            zip(found, expected, strict=True) if isinstance(found, tuple) else [(found, expected)]
        )
        for x, y in pairs:
            np.testing.assert_array_equal(x.numpy(), y, err_msg=function.name)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_whole_inversions_have_the_bits_of_the_library(precision, on_cpu, tmp_path):
    """Forty problems with loads of their own, one of them impossible: more than a block of
    threads.
    """
    folder = flexgen.generate(
        "planar5_nmp", directory=tmp_path, precision=precision, parameters=["payload"]
    ).directory
    library = flexgen.load(folder)
    on_card = flexgen.load(folder, device="cuda")
    path = samples()
    loads = np.repeat(library.parameters[None], 40, axis=0)
    loads[:, 0] += np.linspace(0.0, 3.0, 40)
    loads[17, 0] = np.nan
    options = flexgen.InversionOptions(n_pre=100, n_post=100, samples_per_interval=20)
    names = ("tau_m", "q_a")
    expected = library.invert_many(
        *(path[key] for key in ("y", "dy", "ddy")),
        period=PERIOD,
        q_start=path["q_start"],
        parameters=loads,
        outputs=names,
        options=options,
    )
    given = {key: on_card.array(x, order="C") for key, x in {**path, "parameters": loads}.items()}
    found = on_card.invert_many(period=PERIOD, outputs=names, options=options, **given)
    np.testing.assert_array_equal(found.status, expected.status)
    assert found.status[17] < 0 and (np.delete(found.status, 17) == 0).all()
    for key in (
        "residual",
        "residual_at_samples",
        "kinematic_mismatch",
        "iterations",
        "intervals",
        "n_post",
    ):
        np.testing.assert_array_equal(getattr(found, key), getattr(expected, key), err_msg=key)
    for key in names:
        np.testing.assert_array_equal(
            getattr(found, key).numpy(), getattr(expected, key), err_msg=key
        )
    stream = on_cpu.new_stream()
    again = on_card.invert_many.on(stream)(period=PERIOD, options=options, **given)
    np.testing.assert_array_equal(again.tau_m.numpy(), expected.tau_m)
    assert on_cpu.launched == [(0, 0), (0, stream.ptr)]
    with pytest.raises(
        flexgen.ArgumentError, match="expected at most 300000 on the card; invert them on the CPU"
    ):
        large = flexgen.InversionOptions(n_pre=100, n_post=100, samples_per_interval=1)
        on_card.invert_many(period=PERIOD, options=large, **given)
    with pytest.raises(
        flexgen.ArgumentError, match="growth: given True on the card, expected False"
    ):
        on_card.invert_many(period=PERIOD, options=flexgen.InversionOptions(growth=True), **given)
    with pytest.raises(
        flexgen.ArgumentError, match=r"invert_many, dy: given shape \(3, 2\), expected"
    ):
        on_card.invert_many(
            period=PERIOD, **{**given, "dy": on_card.array(np.zeros((3, 2)), order="C")}
        )
    with pytest.raises(
        flexgen.ArgumentError, match="given one path, one q_start and one set of parameters"
    ):
        on_card.invert_many(
            period=PERIOD, **{key: x for key, x in given.items() if key != "parameters"}
        )
    with pytest.raises(flexgen.ArgumentError, match="q_start: given ndarray on the CPU"):
        on_card.invert_many(period=PERIOD, **{**given, "q_start": path["q_start"]})


@pytest.mark.full
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_nvrtc_compiles_whole_inversions(architecture):
    """Some minutes; the workspace of a thread is in its stack."""
    nvrtc_or_skip()
    manifest, files = library_files("planar5_nmp")
    options = [*compiler.options_of("planar5_nmp", architecture), "--ptxas-options=-v"]
    text = sources.inversion_text(manifest, files, 20000)
    cubin, log = compiler.compile_text(text, sources.headers_of(files), options)
    assert b"k_invert_many" in cubin
    assert 160_000 <= int(re.search(r"(\d+) bytes stack frame", log)[1]) <= 200_000


if __name__ == "__main__":
    text = json.dumps({name: measure(name) for name in MODELS}, indent=1)
    TABLE.write_text(re.sub(r"\[\s+(\d+),\s+(\d+),\s+(\d+)\s+\]", r"[\1, \2, \3]", text) + "\n")
