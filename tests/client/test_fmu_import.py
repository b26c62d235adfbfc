"""Importers of FMUs: FMPy and CasADi, strict compilers, saved states, threads, many cycles, no
allocation.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import fmpy
import fmus
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from toolchain import tool

import flexgen
from flexgen.exports.fmu.variables import INPUT, OUTPUT, STATE

SUPPORT = Path(__file__).resolve().parents[1] / "support" / "programs"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
slow = pytest.mark.slow
# the first is quick: it compiles in a second
BLOCKS = [
    pytest.param(("four_mass", "2.0", "plant"), id="one axis"),
    *(
        pytest.param((m, v, "plant"), id=f"{m}-{v}", marks=slow)
        for m in ("planar5_nmp", "manutec_r3_24")
        for v in ("2.0", "3.0")
    ),
    pytest.param(("four_mass", "3.0", "plant"), id="one axis-3.0", marks=slow),
    *(
        pytest.param(("planar5_nmp", v, b), id=f"{b}-{v}", marks=slow)
        for b in ("feedforward", "controller")
        for v in ("2.0", "3.0")
    ),
]  # fmt: skip


@pytest.fixture(autouse=True)
def same_folder() -> Iterator[None]:
    """FMPy changes the working directory while it loads a library, and eight threads at once do
    not find back.
    """
    before = Path.cwd()
    yield
    os.chdir(before)


@pytest.mark.parametrize("case", BLOCKS)
@pytest.mark.slow
def test_fmpy_finds_no_problem(case):
    written = fmus.exported(*case)
    assert validate_fmu(str(written.path)) == []
    described = fmus.description(written.path)
    assert described.modelExchange is not None and described.coSimulation is not None
    for v in described.modelVariables:
        assert v.unit or v.type in ("Integer", "Int32")


@pytest.mark.slow
def test_fmpy_finds_a_planted_problem(tmp_path):
    """A derivative without its state."""
    written = fmus.exported("four_mass", "2.0")
    with zipfile.ZipFile(written.path) as archive:
        text = archive.read("modelDescription.xml").decode()
    bad = tmp_path / "bad.fmu"
    with zipfile.ZipFile(bad, "w") as archive:
        archive.writestr("modelDescription.xml", text.replace(' derivative="', ' min="', 1))
    assert validate_fmu(str(bad)) != []


@slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize(
    "case", [p.values[0] for p in BLOCKS if "manutec_r3_24" not in p.values[0]], ids="-".join
)
def test_the_sources_pass_a_strict_compiler(case, compiler):
    folder = Path(fmus.unzipped(fmus.exported(*case).path)) / "sources"
    for source in sorted(folder.glob("*.c")):
        done = subprocess.run(
            [tool(compiler), *STRICT, "-fsyntax-only", source.name],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr[:2000]


@slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_fmpy_compiles_the_sources(version, tmp_path):
    """An FMU without a binary, compiled by FMPy through CMake: the motion is that of ours."""
    from fmpy.build import build_platform_binary

    written = flexgen.export_fmu(
        "four_mass", tmp_path / "sources.fmu", version=version, binary=False
    )
    assert written.details["binary"] is None
    folder = Path(fmpy.extract(str(written.path), unzipdir=str(tmp_path / "unzipped")))
    assert not (folder / "binaries").exists()
    build_platform_binary(folder, build_dir=tmp_path, all_warnings=True)
    built = list((folder / "binaries").rglob("*.so"))
    assert len(built) == 1
    options = {
        "stop_time": 0.01,
        "fmi_type": "CoSimulation",
        "start_values": {"motor.m1.torque": 1.0},
    }
    result = [
        fmpy.simulate_fmu(str(p), **options)
        for p in (folder, fmus.exported("four_mass", version).path)
    ]
    assert len(result[0]) > 3 and np.abs(result[0]["motor.m1.angle"]).max() > 1e-3
    for name in result[0].dtype.names:  # another compiler contracts products
        assert np.allclose(result[0][name], result[1][name], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("case", BLOCKS)
def test_a_saved_state_gives_the_same_bits(case):
    """Run on, go back, run again; by the saved state, and by its bytes in another instance. From
    elsewhere: others.
    """
    written = fmus.exported(*case)
    rng = np.random.default_rng(0)
    u = fmus.starts(written, INPUT) + 1e-3 * rng.standard_normal(
        (9, len(fmus.references(written, INPUT)))
    )

    def run(instance, first, last):
        rows = []
        for k in range(first, last):
            instance.put(fmus.references(written, INPUT), u[k])
            instance.step(k)
            rows.append(
                instance.get(fmus.references(written, STATE) + fmus.references(written, OUTPUT))
            )
        return np.array(rows)

    a = fmus.Instance(written)
    b = fmus.Instance(written)
    run(a, 0, 3)
    upper = case[1] == "3.0"
    save, restore = (
        (a.fmu.getFMUState, a.fmu.setFMUState) if upper else (a.fmu.getFMUstate, a.fmu.setFMUstate)
    )
    state = save()
    size_of = a.fmu.serializeFMUState if upper else a.fmu.serializeFMUstate
    data = size_of(state)
    first = run(a, 3, 9)
    restore(state)
    assert np.array_equal(run(a, 3, 9), first)
    other = (b.fmu.deserializeFMUState if upper else b.fmu.deSerializeFMUstate)(data)
    (b.fmu.setFMUState if upper else b.fmu.setFMUstate)(other)
    assert np.array_equal(run(b, 3, 9), first)
    fresh = fmus.Instance(written)
    for k in range(3):  # another start: other results
        fresh.put(fmus.references(written, INPUT), u[8])
        fresh.step(k)
    assert not np.array_equal(run(fresh, 3, 9), first)
    with pytest.raises(Exception, match=r"status|rror"):  # bytes of another FMU
        (b.fmu.deserializeFMUState if upper else b.fmu.deSerializeFMUstate)(b"x" * len(data))
    for instance, kept in ((a, state), (b, other)):
        (instance.fmu.freeFMUState if upper else instance.fmu.freeFMUstate)(kept)
    for instance in (a, b, fresh):
        instance.close()


@pytest.mark.parametrize("case", BLOCKS)
def test_eight_instances_in_eight_threads_are_equal(case):
    written = fmus.exported(*case)
    n = 3 if "manutec" in case[0] else 20
    u = fmus.starts(written, INPUT) + 1e-3

    def run(_):
        instance = fmus.Instance(written)
        for k in range(n):
            instance.put(fmus.references(written, INPUT), u * (1 + 1e-6 * k))
            instance.step(k)
        out = instance.get(fmus.references(written, STATE) + fmus.references(written, OUTPUT))
        instance.close()
        return out

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(run, range(8)))
    assert (
        all(np.array_equal(results[0], other) for other in results[1:])
        and np.isfinite(results[0]).all()
    )


def grown(written, tmp_path, *flags):
    """Pages of memory by which 2,000 cycles of load, run, free and unload grow a program in C."""
    folder = Path(fmus.unzipped(written.path))
    (library,) = (folder / "binaries").rglob("*.so")
    program = tmp_path / "cycles"
    given = [
        f"-I{folder / 'sources'}",
        f'-DGUID="{written.details["token"]}"',
        str(SUPPORT / "fmu_cycles.c"),
    ]
    subprocess.run(
        ["gcc", "-std=c99", "-O1", *flags, *given, "-ldl", "-o", str(program)], check=True
    )
    done = subprocess.run(
        [program, str(library), "2000"], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="reads the memory of the process from /proc"
)
@pytest.mark.parametrize("case", [p for p in BLOCKS if p.values[0][2] == "plant"])
def test_two_thousand_cycles_keep_the_memory(case, tmp_path):
    written = fmus.exported(*case)
    # the kernel maps 16 pages at a time, once or twice; no instance is kept
    assert grown(written, tmp_path, *["-DFMI3"] * (case[1] == "3.0")) <= 64
    if case[1] == "2.0":
        # planted: instances of several kB that are not freed
        assert grown(written, tmp_path, "-DLEAK") > 400


@slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("block", "kind"),
    [("plant", "co"), ("plant", "exchange"), ("feedforward", "co"), ("controller", "co")],
)
def test_nothing_is_allocated_after_the_instantiation(block, kind, version, tmp_path):
    """A program that counts calls of malloc, calloc and realloc by the linker's --wrap."""
    written = fmus.exported("planar5_nmp", version, block)
    folder = Path(fmus.unzipped(written.path)) / "sources"
    program = tmp_path / "count"
    wrap = [f"-Wl,--wrap={name}" for name in ("malloc", "calloc", "realloc")]
    sources = [str(path) for path in sorted(folder.glob("*.c"))]
    defined = ["-DFMI3"] * (version == "3.0") + ["-DEXCHANGE"] * (kind == "exchange")
    defined += [
        f"-DCONTINUOUS_STATES={2 * flexgen.read('planar5_nmp').dof}",
        f"-I{folder}",
        f'-DGUID="{written.details["token"]}"',
        *wrap,
    ]
    command = [
        "gcc",
        "-std=c99",
        "-O0",
        *defined,
        str(SUPPORT / "fmu_allocations.c"),
        *sources,
        "-lm",
        "-o",
        program,
    ]
    subprocess.run(command, check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    # instantiate; 300 steps; a saved state
    assert done.stdout.split() == ["1", "0", "1"], done.stdout


@pytest.mark.parametrize("case", [p for p in BLOCKS if p.values[0][2] == "plant"])
def test_casadi_imports_the_plant(case):
    """DaeBuilder evaluates the derivatives, and its Jacobians come from the FMU's directional
    derivatives.
    """
    written = fmus.exported(*case)
    definition = fmus.lagrange(case[0])
    dae = ca.DaeBuilder("robot", str(fmus.unzipped(written.path)))
    f = dae.create("f", ["x", "u"], ["ode", "y"])
    x = fmus.starts(written, STATE) + 1e-3
    u = fmus.inputs_over(written, 2)[1]
    order = [dae.var(name) if not isinstance(name, str) else name for name in dae.x()]
    names = [v.name for v in written.details["variables"] if v.kind == STATE]
    assert [str(name) for name in order] == names
    rate, y = (np.array(part).ravel() for part in f(x, u))
    expected = definition.rate(0.0, x, u)
    assert np.allclose(rate, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.allclose(y, definition.output(x), rtol=1e-9, atol=1e-12)
    m = definition.model
    n_a = definition.model.n_a
    n = definition.model.dof
    A = np.array(dae.create("j", ["x", "u"], ["jac_ode_x"])(x, np.r_[u[:-6], np.zeros(6)]))
    parts = definition.split(x)
    own = np.array(definition.equations.function("linearize")(*parts, u[: m.n_m])[0])
    assert own.shape == A.shape == (2 * n, 2 * n) and n >= n_a
    assert np.abs(A - own).max() <= 1e-10 * np.abs(own).max()


@slow
def test_a_function_called_in_the_wrong_state_is_an_error():
    """States of the call sequence, NaN, wrong value references, wrong token, a step back in
    time.
    """
    written = fmus.exported("four_mass", "2.0")
    instance = fmus.Instance(written)
    refused = [
        lambda: instance.put([3000], [float("nan")]),
        lambda: instance.put([4000], [1.0]),
        lambda: instance.put([3999], [1.0]),
        lambda: instance.get([9999]),
        lambda: instance.fmu.doStep(1.0, 1e-3),
        lambda: instance.fmu.doStep(0.0, -1e-3),
        lambda: instance.set_start("integration.method", 2),
        lambda: instance.fmu.enterInitializationMode(),
        lambda: instance.fmu.getBoolean([0]),
    ]
    for call in refused:
        with pytest.raises(Exception, match="status"):
            call()
    instance.step(0)
    instance.close()
    described = fmpy.read_model_description(str(written.path))
    described.guid = "{another}"
    with pytest.raises(Exception, match="nstantiat"):
        fmpy.instantiate_fmu(
            fmus.unzipped(written.path), described, fmi_type="CoSimulation", logger=fmus.quiet
        )
