"""Functions for MATLAB and Octave, run in Octave: the bits of the library in Python. MATLAB itself
is not tested.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emitted import loaded, random_states
from remembering import check, compiled, remembering, samples, start
from toolchain import STRICT, needs_compiler, tool

import flexgen
from flexgen.base.errors import BuildError
from flexgen.cli.main import main
from flexgen.codegen.emission.clib_files import render
from flexgen.dynamics.mechanics.signatures import TABLE
from flexgen.runtime.inversion.limited_inversion import OF_TOOL, SIZES

STUBS = Path(__file__).resolve().parents[1] / "support" / "mex_stubs"
NAME = "planar5_nmp"
needs_octave = pytest.mark.skipif(
    shutil.which("octave") is None or shutil.which("mkoctfile") is None,
    reason="no octave or no mkoctfile; install the Debian packages octave and octave-dev",
)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The package of planar5_nmp, compiled. Without optimization: that changes no bits, and takes
    less time.
    """
    folder = tmp_path_factory.mktemp("mex")
    flexgen.export_mex(NAME, folder)
    octave(folder, f"build_{NAME} ('-O0', '-Wall', '-Wextra', '-Werror');")
    return folder


def octave(folder: Path, script: str, where: Path | None = None) -> str:
    """Output of a script in Octave, with the folder on the path."""
    place = where or folder
    (place / "script_of_test.m").write_text(f"addpath ('{folder}');\n{script}\n", encoding="ascii")
    run = subprocess.run(
        ["octave", "--no-gui", "--quiet", "--no-init-file", "--eval", "script_of_test"],
        cwd=place,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def exchanged(
    folder: Path, script: str, given: dict[str, np.ndarray], names: list[str]
) -> list[np.ndarray]:
    """Arrays in, arrays out, bit for bit: as files of doubles by columns."""
    lines = []
    for name, x in given.items():
        x = np.asarray(x, float)
        (folder / f"in_{name}.bin").write_bytes(np.asfortranarray(x).tobytes(order="F"))
        rows, columns = x.shape if x.ndim == 2 else (x.size, 1)
        read = f"fread (fopen ('{folder}/in_{name}.bin'), Inf, 'double')"
        lines.append(f"{name} = reshape ({read}, {rows}, {columns});")
    lines.append(script)
    lines += [
        f"fwrite (fopen ('{folder}/out_{k}.bin', 'w'), {name}, 'double');"
        for k, name in enumerate(names)
    ]
    octave(folder, "\n".join([*lines, "fclose ('all');"]))
    return [np.frombuffer((folder / f"out_{k}.bin").read_bytes()) for k in range(len(names))]


@needs_octave
@pytest.mark.slow
def test_the_example_of_the_readme(built):
    """The C and Python examples of README.md."""
    script = f"""
tau_a = {NAME}.inverse_dynamics ([0.3, -1.1, 0.0], [0.5, 0.2, 0.0], [1.0, -2.0, 0.0]);
M = {NAME}.mass_matrix ([0.3; -1.1; 0.0]);
printf ('%.3f %.3f %.3f N m\\n', tau_a);
"""
    tau_a, M = exchanged(built, script, {}, ["tau_a", "M"])
    library = loaded(NAME)
    q = [0.3, -1.1, 0.0]
    assert np.array_equal(tau_a, library.inverse_dynamics(q, [0.5, 0.2, 0.0], [1.0, -2.0, 0.0]))
    assert np.array_equal(M.reshape(3, 3).T, library.mass_matrix(q))
    assert octave(built, script).strip() == "904.937 137.763 35.799 N m"


def functions(library) -> dict[str, tuple[list[str], list[str]]]:
    """Names of the arrays of all functions of a library."""
    rows = {row.name: row for row in TABLE if row.name in library.functions}
    return {name: (row.inputs.split(), row.outputs.split()) for name, row in rows.items()}


def all_functions(folder: Path) -> list[str]:
    """Names of arrays whose bits differ from those of Python."""
    library = loaded(NAME)
    n = 5
    states = random_states(flexgen.read(NAME), n)
    lines = []
    names = []
    wrong = []
    for f, (inputs, outputs) in functions(library).items():
        results = [f"{f}_{x}" for x in outputs]
        lines.append(f"[{', '.join(results)}] = {NAME}.{f} ({', '.join(inputs)});")
        names += results
    given = {
        x: states[x].T for x in sorted({x for ins, _ in functions(library).values() for x in ins})
    }
    found = dict(zip(names, exchanged(folder, "\n".join(lines), given, names), strict=True))
    for f, (inputs, outputs) in functions(library).items():
        for k in range(n):
            result = getattr(library, f)(*(states[x][k] for x in inputs))
            results = [result] if len(outputs) == 1 else list(result)
            for x, expected in zip(outputs, results, strict=True):
                part = found[f"{f}_{x}"].reshape(n, -1)[k]
                if not np.array_equal(part, np.asarray(expected).ravel(order="F")):
                    wrong.append(f"{f}.{x}")
    return sorted(set(wrong))


@needs_octave
@pytest.mark.slow
def test_all_functions_have_the_bits_of_python(built):
    assert all_functions(built) == []


@needs_octave
@pytest.mark.slow
def test_a_planted_swap_of_arguments_is_seen(built, tmp_path):
    folder = tmp_path / "swapped"
    shutil.copytree(built, folder)
    table = folder / f"{NAME}_mex_table.h"
    text = table.read_text(encoding="ascii")
    changed = text.replace(
        f"{NAME}_bias(in[0], in[1], out[0])", f"{NAME}_bias(in[1], in[0], out[0])"
    )
    assert changed != text
    table.write_text(changed, encoding="ascii")
    octave(folder, f"build_{NAME} ('-O0');")
    assert all_functions(folder) == ["bias.h"]


@needs_octave
@pytest.mark.slow
def test_invert_and_stream_have_the_bits_of_python(built):
    path = flexgen.plan(NAME)
    y = path.sample(np.arange(501) * 1e-3).y
    y, dy, ddy = (y[:, :, k] for k in range(3))
    script = f"""
[m, info] = {NAME}.invert (y, dy, ddy, 1e-3, q, struct ('n_pre', 20, 'n_post', 50, \
'samples_per_interval', 10));
tau_m = m.tau_m; q_a = m.q_a; a_a = m.a_a; residual = info.residual; good = double \
(info.converged);
s = {NAME}.Stream (y(:, 1), q, struct ('period', 5e-3, 'intervals', 20, 'hold', 'zoh'));
at = []; before = [];
for k = 6:5:501
  if k == 251
    t = s.copy ();
    try
      s.update ([NaN; 0], dy(:, k), ddy(:, k));
    catch err
      assert (strcmp (err.identifier, 'flexgen:INPUT_NOT_FINITE'));
    end
  end
  [now, i] = s.update (y(:, k), dy(:, k), ddy(:, k));
  at = [at, now.tau_m, now.q_m, now.v_m];
end
[now, i] = t.update (y(:, 251), dy(:, 251), ddy(:, 251));
again = now.tau_m;
u = {NAME}.Stream (y(:, 1), q, struct ('period', 5e-3, 'intervals', 60));
u.limits ([22; 22], [Inf; Inf], 0.05);
limited = []; active = 0;
for k = [6:5:501, 501 * ones(1, 60)]
  [now, i] = u.update (y(:, k), dy(:, k), ddy(:, k));
  limited = [limited, now.tau_m]; active = active + i.limits_active;
end
"""
    names = ["tau_m", "q_a", "a_a", "residual", "good", "at", "again", "limited", "active"]
    given = {"y": y.T, "dy": dy.T, "ddy": ddy.T, "q": path.q_start}
    out = dict(zip(names, exchanged(built, script, given, names), strict=True))
    library = loaded(NAME)
    motion = library.invert(
        y, dy, ddy, period=1e-3, q_start=path.q_start, n_pre=20, n_post=50, samples_per_interval=10
    )
    for name in ("tau_m", "q_a", "a_a"):
        assert np.array_equal(out[name], getattr(motion, name).ravel()), name
    assert out["residual"][0] == motion.residual and bool(out["good"][0]) is motion.converged
    stream = library.stream(
        y[0], path.q_start, period=5e-3, intervals=20, samples_per_interval=5, hold="zoh"
    )
    rows = []
    for k in range(5, 501, 5):
        now = stream.update(y[k], dy[k], ddy[k])
        rows += [now.tau_m.ravel(), now.q_m.ravel(), now.v_m.ravel()]
        if k == 250:
            assert np.array_equal(out["again"], now.tau_m.ravel())
    assert np.array_equal(out["at"], np.concatenate(rows))
    stream = library.stream(y[0], path.q_start, period=5e-3, intervals=60, samples_per_interval=5)
    stream.limit(torque=[22.0, 22.0], deviation=0.05)
    rows = []
    active = 0
    for k in [*range(5, 501, 5), *[500] * 60]:
        now = stream.update(y[k], dy[k], ddy[k])
        rows.append(now.tau_m.ravel())
        active += now.limits_active
    assert np.array_equal(out["limited"], np.concatenate(rows)) and out["active"][0] == active > 0


def gateway(folder: Path, library: Path, name: str = "elbow") -> Path:
    """A program that drives the gateway without Octave."""
    text = render((STUBS / "drive.c").read_text(encoding="ascii"), name)
    (folder / "drive.c").write_text(text, encoding="ascii")
    program = folder / f"drive_{library.parent.name}"
    command = [
        tool("gcc"),
        *STRICT,
        "-O0",
        "-isystem",
        STUBS,
        "-I",
        folder,
        f'-DGATEWAY="{name}_mex.c"',
    ]
    subprocess.run([*command, folder / "drive.c", library, "-lm", "-o", program], check=True)
    return program


@needs_compiler
@pytest.mark.slow
def test_gears_and_motors_with_memory_have_the_torques_of_solve(tmp_path):
    """Compiled against a stub header; what the stream forgets from update to update is seen."""
    flexgen.export_mex(remembering(), tmp_path)
    given = np.hstack(samples())
    numbers = np.concatenate(
        [[10, 5, 5e-3, 1e-6, 0, 0, len(given)], *start(), given.ravel()]
    ).tobytes()

    def torques(forgets: str) -> np.ndarray:
        run = subprocess.run(
            [gateway(tmp_path, compiled(forgets, ("limits",)))],
            input=numbers,
            capture_output=True,
            check=True,
        )
        return np.frombuffer(run.stdout).reshape(-1, 2)

    check(torques)


def names_of_limits(folder: Path) -> list[str]:
    """The limits that the method all_limits of the class takes, in the order in which it gives
    them to C.
    """
    text = (folder / f"+{NAME}" / "Stream.m").read_text(encoding="ascii")
    return re.findall(r"'(\w+)'", re.search(r"names = \{(.*?)\};", text, re.DOTALL)[1])


def test_the_class_takes_all_limits_of_c(tmp_path):
    flexgen.export_mex(NAME, tmp_path)
    assert set(names_of_limits(tmp_path)) == {*SIZES, *OF_TOOL, "torque_speed"}


@needs_compiler
@pytest.mark.slow
def test_limits_of_all_kinds_have_the_bits_of_python(tmp_path):
    """Compiled against a stub header, which gets the limits in the order of the class. Planted:
    two swapped.
    """
    flexgen.export_mex(NAME, tmp_path)
    curve = [[0.0, 26.0], [60.0, 24.0], [400.0, 0.0]]
    limits = {"torque_max": [22.0, 12.0], "speed_max": [np.inf, 90.0], "deflection_max": [4e-4]}
    limits |= {
        "gear_torque_max": [1900.0, 600.0],
        "torque_rate_max": [900.0, 700.0],
        "joint_speed_max": [1.5, 2.0],
    }
    limits |= {
        "joint_acceleration_max": [9.0, 9.0],
        "tool_speed_max": 1.5,
        "tool_acceleration_max": 9.0,
    }
    path = flexgen.plan(NAME)
    y = path.sample(np.minimum(np.arange(0, 800, 5), 500) * 1e-3).y
    options = {"period": 5e-3, "intervals": 60, "samples_per_interval": 5}

    def torques(names: list[str]) -> np.ndarray:
        arrays = [np.atleast_1d(limits[name])[:, None] for name in names[:-1]]
        arrays += [np.array([curve, curve]).reshape(2, -1).T, np.array([[0.05]])]
        given = [[60, 5, 5e-3, 1e-6, 0, 0, len(y) - 1], y[0, :, 0], path.q_start]
        given += [x for a in arrays for x in (a.shape, a.ravel(order="F"))]
        given += [y[k, :, i] for k in range(1, len(y)) for i in range(3)]
        command = [gateway(tmp_path, tmp_path / f"{NAME}.c", NAME), "limits"]
        run = subprocess.run(
            command, input=np.concatenate(given).astype(float).tobytes(), capture_output=True
        )
        assert run.returncode == 0, run.stderr
        return np.frombuffer(run.stdout).reshape(-1, 5, 2)

    names = names_of_limits(tmp_path)
    library = flexgen.load(
        flexgen.generate(NAME, tmp_path / "library", parts=["limits"], progress=False).directory
    )
    stream = library.stream(y[0, :, 0], path.q_start, tolerance=1e-6, **options)
    stream.limit_all(deviation=0.05, torque_speed=[curve, curve], **limits)
    updates = [stream.update(*y[k, :, :3].T) for k in range(1, len(y))]
    expected = np.array([x.tau_m for x in updates])
    assert sum(x.limits_active for x in updates) > 10
    assert np.array_equal(torques(names), expected)
    swapped = {"gear_torque_max": "torque_rate_max", "torque_rate_max": "gear_torque_max"}
    assert not np.array_equal(torques([swapped.get(name, name) for name in names]), expected)


@needs_octave
@pytest.mark.slow
def test_wrong_arguments_are_errors_with_an_identifier(built):
    calls = [
        (
            f"{NAME}_mex ('inverse_dynamics', [1 2 3], [1 2 3]);",
            "flexgen:argument",
            "given 2 arguments, expected 3",
        ),
        (
            f"{NAME}.mass_matrix ([1 2]);",
            "flexgen:argument",
            "mass_matrix, q_a: given 1 x 2, expected 3 rows",
        ),
        (
            f"{NAME}.mass_matrix (int32 ([1 2 3]));",
            "flexgen:argument",
            "given int32, expected a real matrix",
        ),
        (f"{NAME}.mass_matrix ([1 2 3i]);", "flexgen:argument", "given a complex"),
        (
            f"{NAME}.bias (ones (3, 4), ones (3, 5));",
            "flexgen:argument",
            "given 5 columns, expected 4 as before",
        ),
        (f"{NAME}.mass_matrix ([1 NaN 3]);", "flexgen:INPUT_NOT_FINITE", "an input is not finite"),
        (
            f"[a, b] = {NAME}_mex ('mass_matrix', [1 2 3]);",
            "flexgen:argument",
            "given 2 arguments, expected 1",
        ),
        (f"{NAME}_mex ('nosuch');", "flexgen:argument", "given nosuch, expected a function"),
        (f"{NAME}_mex (3);", "flexgen:argument", "given no name"),
        (f"{NAME}.Stream ([5; 5], [0 0 0]);", "flexgen:UNREACHABLE", "leaves the workspace"),
        (
            f"{NAME}.Stream ([1; 0], [0 0 0], struct ('intervals', 0));",
            "flexgen:argument",
            "1 to 10000 intervals",
        ),
        (
            f"{NAME}.Stream ([1; 0], [0 0 0], struct ('intervals', 1.5));",
            "flexgen:argument",
            "a whole number",
        ),
        (
            f"{NAME}.Stream ([1; 0], [0 0 0], struct ('length', 3));",
            "flexgen:argument",
            "given length",
        ),
        (
            f"{NAME}.Stream ([1; 0], [0 0 0], struct ('hold', 'none'));",
            "flexgen:argument",
            "spline, linear or zoh",
        ),
        (
            f"s = {NAME}.Stream (); s.update ([1; 0], [0; 0], [0; 0]);",
            "flexgen:argument",
            "was not started",
        ),
        (
            f"{NAME}_mex ('stream_limits', [10 5 5e-3 1e-6 0 0], ones (4, 1), [1 1], [1 1], 1);",
            "flexgen:argument",
            "another memory",
        ),
        (
            f"s = {NAME}.Stream ([1; 0], [0 0 0]); s.all_limits (3, 1);",
            "flexgen:argument",
            "given double",
        ),
        (
            f"s = {NAME}.Stream ([1; 0], [0 0 0]); s.all_limits (struct ('torque', 1), 1);",
            "flexgen:argument",
            "given torque, expected some of torque_max",
        ),
        (
            (
                f"s = {NAME}.Stream ([1; 0], [0 0 0]); s.all_limits (struct ('torque_max', [1 "
                "0]), 1);"
            ),
            "flexgen:argument",
            "all_limits, torque_max: given 0, expected positive",
        ),
        (
            f"{NAME}.invert (1, 1, 1, 1, [0 0 0]);",
            "flexgen:argument",
            "invert, y: given 1 x 1, expected 2 rows",
        ),
        (
            f"{NAME}.invert (ones (2, 9), ones (2, 8), ones (2, 9), 1, [0 0 0]);",
            "flexgen:argument",
            "expected 2 x 9",
        ),
    ]
    script = "\n".join(
        f"try\n{call} disp('none');\ncatch e\ndisp ([e.identifier '|' e.message]);\nend"
        for call, *_ in calls
    )
    lines = octave(built, script).strip().splitlines()
    assert len(lines) == len(calls)
    for line, (call, identifier, message) in zip(lines, calls, strict=True):
        assert line.startswith(f"{identifier}|") and message in line, (call, line)


@needs_octave
@pytest.mark.slow
def test_help_shows_equation_sizes_and_units(built):
    out = octave(built, f"help {NAME}.forward_dynamics\nhelp {NAME}.Stream\nhelp build_{NAME}")
    for text in (
        "M a_a + c + g = tau_a",
        "2 x n  [N m]  motor torques, motor side",
        "addpath (FOLDER)",
    ):
        assert text in out
    assert "s.limits (torque_max" in out and "s.all_limits (limits" in out


@needs_octave
def test_octave_parses_every_file(tmp_path):
    """Without the compilation: functions with their help, and the class."""
    flexgen.export_mex(NAME, tmp_path)
    names = [p.stem for p in (tmp_path / f"+{NAME}").glob("*.m")]
    assert {"Stream", "invert", "options_", "inverse_dynamics"} <= set(names)
    calls = "\n".join(
        (
            "try\n"
            f"{NAME}.{name} (1);\n"
            "catch e\n"
            "assert (isempty (strfind (e.message, 'parse')), e.message);\n"
            "end"
        )
        for name in sorted(names)
    )
    octave(tmp_path, f"{calls}\ndisp ('parsed')")


def test_help_is_made_from_the_table(tmp_path):
    flexgen.export_mex(NAME, tmp_path)
    library = {row.name: row for row in TABLE}
    files = [p for p in (tmp_path / f"+{NAME}").glob("*.m") if p.stem in library]
    assert len(files) == len(list((tmp_path / f"+{NAME}").glob("*.m"))) - 3
    for file in files:
        text = " ".join(
            re.sub(r"^%", "", file.read_text(encoding="ascii"), flags=re.MULTILINE).split()
        )
        row = library[file.stem]
        assert " ".join(row.summary.split()) in text and " ".join(row.equation.split()) in text
        assert all(
            re.search(rf"\b{port}\b", text) for port in (*row.inputs.split(), *row.outputs.split())
        )
    assert not any("@" in re.sub(r"@\(", "", p.read_text("ascii")) for p in tmp_path.rglob("*.m"))


def test_the_bytes_are_the_same(tmp_path):
    first, second = (flexgen.export_mex(NAME, tmp_path / name) for name in "ab")
    assert [p.read_bytes() for p in first.files] == [p.read_bytes() for p in second.files]


def test_keywords_are_refused_as_names(tmp_path):
    for word in ("function", "spmd", "endif"):
        with pytest.raises(BuildError, match="a keyword of MATLAB or Octave"):
            flexgen.export_mex(replace(flexgen.read(NAME), name=word), tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_command_line(tmp_path, capsys):
    assert main(["export", "mex", NAME, "--out", str(tmp_path), "-q"]) == 0
    assert f"build_{NAME}.m" in capsys.readouterr().out


@needs_octave
@pytest.mark.slow
def test_the_code_of_the_page_runs(built):
    """The blocks of docs/matlab.md for Octave, in their order; those of Simulink need Simulink."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "matlab.md").read_text(encoding="utf-8")
    blocks = re.findall(
        r"^```matlab\n(.*?)^```$", page.partition("## Simulink")[0], re.MULTILINE | re.DOTALL
    )
    assert len(blocks) == 4
    lines = [
        line
        for line in "\n".join(blocks).splitlines()
        if not line.startswith(("addpath", "build_", "plot"))
    ]
    path = flexgen.plan(NAME)
    y = path.sample(np.arange(501) * 1e-3).y
    given = {"y": y[:, :, 0].T, "dy": y[:, :, 1].T, "ddy": y[:, :, 2].T, "q_start": path.q_start}
    script = "\n".join([*lines, "last = motion.tau_m; good = double (info.converged);"])
    last, good, tau_a = exchanged(built, script, given, ["last", "good", "tau_a"])
    assert last.shape == (10,) and good[0] == 1
    assert (
        "% 904.937 137.763 35.799 N m" in page
        and np.abs(tau_a - [904.937, 137.763, 35.799]).max() < 1e-3
    )
