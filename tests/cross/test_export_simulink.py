"""Blocks for Simulink, compiled against stub headers and called as Simulink calls them. Simulink
is not tested.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from emitted import loaded, random_states
from exports import library_object, without_streams
from remembering import check, compiled, remembering, samples, start
from toolchain import STRICT, needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.signatures import TABLE
from flexgen.exports.c_code.selftest.golden import output_at
from flexgen.exports.c_code.selftest.motion import targets

STUBS = Path(__file__).resolve().parents[1] / "support" / "simulink_stubs"
NAME = "planar5_nmp"
PERIOD = 5e-3
INTERVALS = 12
SAMPLES = 4


@pytest.fixture(scope="module")
def blocks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulink")
    flexgen.export_simulink(NAME, folder)
    return folder


def block(
    folder: Path, name: str, *flags: str, model: str = NAME, library: Path | None = None
) -> Path:
    """A program that drives an S-function."""
    program = folder / f"drive_{name}"
    include = ["-isystem", STUBS, "-I", folder, f'-DSFUNCTION="{model}_{name}_sfun.c"']
    command = [
        tool("gcc"),
        *STRICT,
        "-O0",
        *include,
        *flags,
        STUBS / "drive.c",
        folder / f"{model}_ccaller.c",
    ]
    subprocess.run(
        [*command, library or library_object(NAME)[1], "-lm", "-o", program], check=True
    )
    return program


def run(
    program: Path, parameters: list[np.ndarray], rows: np.ndarray, expected: int = 0
) -> np.ndarray | str:
    """Outputs of every step, after the sample time; with an error its text."""
    given = [[len(parameters)]]
    for x in parameters:
        given += [[np.size(x)], np.ravel(x)]
    given += [[len(rows)], rows.ravel()]
    data = np.concatenate([np.asarray(x, float) for x in given]).tobytes()
    done = subprocess.run([program], input=data, capture_output=True, check=False)
    assert done.returncode == expected, done.stderr.decode()
    return np.frombuffer(done.stdout) if expected == 0 else done.stderr.decode()


def stream_parameters(**changed) -> list:
    q_start = np.append(flexgen.read(NAME).home, 0.0)
    given = {
        "period": PERIOD,
        "intervals": INTERVALS,
        "samples": SAMPLES,
        "tolerance": 1e-6,
        "hold": 2,
        "delay": 0,
    }
    given |= {"start_output": output_at(flexgen.derive(NAME), q_start), "q_start": q_start}
    return list((given | changed).values())


def stream_samples(n: int) -> tuple[np.ndarray, ...]:
    sample = flexgen.plan(NAME).sample(np.arange(1, n + 1) * PERIOD)
    return targets(sample), sample.derivative(1), sample.derivative(2)


def expected_stream(samples) -> np.ndarray:
    y0, q = stream_parameters()[-2:]
    options = {
        "period": PERIOD,
        "intervals": INTERVALS,
        "samples_per_interval": SAMPLES,
        "hold": "zoh",
    }
    stream = loaded(NAME).stream(y0, q, **options)
    rows = []
    for y, dy, ddy in zip(*samples, strict=True):
        now = stream.update(y, dy, ddy)
        rows.append(
            np.concatenate(
                [
                    now.tau_m.ravel(),
                    now.q_m.ravel(),
                    now.v_m.ravel(),
                    [0.0 if now.converged else 1],
                ]
            )
        )
    return np.array(rows)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("flags", [(), ("-DMATLAB_MEX_FILE",)])
def test_the_stream_has_the_bits_of_python(blocks, flags):
    samples = stream_samples(120)
    out = run(block(blocks, "stream", *flags), stream_parameters(), np.hstack(samples))
    assert out[0] == PERIOD
    assert np.array_equal(out[1:].reshape(len(samples[0]), -1), expected_stream(samples))


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("memcpy(ssGetDWork(S, KEPT), ssGetDWork(S, SCRATCH),",
         "memcpy(ssGetDWork(S, SCRATCH), ssGetDWork(S, KEPT),"),
        ("ssGetInputPortRealSignal(S, 1), ssGetInputPortRealSignal(S, 2)",
         "ssGetInputPortRealSignal(S, 2), ssGetInputPortRealSignal(S, 1)"),
    ],
)  # fmt: skip
def test_planted_errors_are_seen(blocks, tmp_path, old, new):
    for path in blocks.iterdir():
        if path.suffix in (".c", ".h"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    file = tmp_path / f"{NAME}_stream_sfun.c"
    text = file.read_text(encoding="ascii")
    assert old in text
    file.write_text(text.replace(old, new), encoding="ascii")
    samples = stream_samples(60)
    out = run(block(tmp_path, "stream"), stream_parameters(), np.hstack(samples))
    assert not np.array_equal(out[1:].reshape(60, -1), expected_stream(samples))


@needs_compiler
@pytest.mark.slow
def test_gears_and_motors_with_memory_have_the_torques_of_solve(tmp_path):
    """Torques of the stream's block are those of `solve`; a state lost from update to update is
    seen.
    """
    flexgen.export_simulink(remembering(), tmp_path)
    y, q = start()
    parameters = stream_parameters(intervals=10, samples=5, hold=0, start_output=y, q_start=q)

    def torques(forgets):
        program = block(tmp_path, "stream", model="elbow", library=compiled(forgets))
        rows = run(program, parameters, np.hstack(samples()))[1:].reshape(len(samples()[0]), -1)
        return rows[:, :10].reshape(-1, 2)

    check(torques)


@needs_compiler
@pytest.mark.slow
def test_inverse_dynamics_has_the_bits_of_python(blocks):
    states = random_states(flexgen.read(NAME), 20)
    library = loaded(NAME)
    rows = np.hstack([states[x] for x in ("q_a", "v_a", "a_a")])
    out = run(block(blocks, "inverse_dynamics"), [], rows)
    assert out[0] == -1.0  # inherited
    expected = [
        library.inverse_dynamics(*(states[x][k] for x in ("q_a", "v_a", "a_a"))) for k in range(20)
    ]
    assert np.array_equal(out[1:].reshape(20, -1), expected)
    assert "an input is not finite" in run(
        block(blocks, "inverse_dynamics"), [], rows * np.nan, expected=3
    )


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"intervals": 0}, "1 to 10000 intervals"),
        ({"intervals": 10.5}, "must be whole numbers"),
        ({"hold": 3}, "hold 0 to 2"),
        ({"period": 0.0}, "a period above 0"),
        ({"delay": 5.0}, "a delay of 0 to 4"),
        ({"q_start": np.zeros(4)}, "of the right count"),
        ({"start_output": np.array([9.0, 9.0])}, "leaves the workspace"),
        ({"start_output": np.array([np.nan, 0.0])}, "not finite"),
    ],
)
def test_wrong_parameters_are_errors(blocks, changed, message):
    program = blocks / "drive_stream"
    if not program.exists():
        block(blocks, "stream")
    rows = np.zeros((1, 6))
    assert message in run(program, stream_parameters(**changed), rows, expected=3)


@needs_compiler
@pytest.mark.slow
def test_functions_for_c_caller_have_the_bits_of_python(blocks, tmp_path):
    import ctypes

    library = loaded(NAME)
    command = [
        tool("gcc"),
        *STRICT,
        "-O0",
        "-shared",
        "-fPIC",
        "-I",
        blocks,
        blocks / f"{NAME}_ccaller.c",
    ]
    subprocess.run([*command, library_object(NAME)[1], "-o", tmp_path / "c.so"], check=True)
    loaded_c = ctypes.CDLL(str(tmp_path / "c.so"))
    states = random_states(flexgen.read(NAME), 1)
    for row in (row for row in TABLE if row.name in library.functions):
        result = getattr(library, row.name)(*(states[x][0] for x in row.inputs.split()))
        results = [result] if len(row.outputs.split()) == 1 else list(result)
        given = [np.ascontiguousarray(states[x][0], dtype=float) for x in row.inputs.split()]
        found = [np.full(np.asarray(x).size, 7.0) for x in results]
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*given, *found)]
        assert loaded_c[f"{NAME}_ccaller_{row.name}"](*pointers) == 0
        for x, expected in zip(found, results, strict=True):
            assert np.array_equal(x, np.asarray(expected).ravel(order="F")), row.name


def test_the_header_for_c_caller_is_plain(blocks):
    """C Caller reads it: no typedefs, structs, enums or macros for sizes."""
    text = (blocks / f"{NAME}_ccaller.h").read_text(encoding="ascii")
    assert f"int {NAME}_ccaller_inverse_dynamics(const double q_a[3], const double v_a[3]" in text
    assert not any(word in text for word in ("typedef", "struct", "enum", f"{NAME.upper()}_N"))


def test_models_without_streams(tmp_path):
    model = without_streams()
    with pytest.raises(ArgumentError, match=r"a robot without streams, because .*turns a motor"):
        flexgen.export_simulink(model, tmp_path)
    assert not list(tmp_path.iterdir())
    flexgen.export_simulink(model, tmp_path, stream=False)
    assert (
        not (tmp_path / "elbow_stream_sfun.c").exists()
        and (tmp_path / "elbow_inverse_dynamics_sfun.c").exists()
    )
    assert "stream" not in (tmp_path / "setup_elbow.m").read_text()


def test_the_bytes_are_the_same(tmp_path):
    first, second = (flexgen.export_simulink(NAME, tmp_path / name) for name in "ab")
    assert [p.read_bytes() for p in first.files] == [p.read_bytes() for p in second.files]


def test_the_command_line(tmp_path, capsys):
    assert main(["export", "simulink", NAME, "--out", str(tmp_path), "-q"]) == 0
    assert f"{NAME}_stream_sfun.c" in capsys.readouterr().out
