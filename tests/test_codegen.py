"""The emitted C: its numbers, its text, its names, and the strangers that compile it."""

from __future__ import annotations

import ctypes
import dataclasses
import re
import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from emitted import (
    CC,
    ROOT,
    SMALL,
    STRICT,
    loaded,
    machine,
    made,
    needs_compiler,
    random_states,
    run,
    sources,
)

from flexgen.codegen.build import generate
from flexgen.codegen.emit import emit, symbols
from flexgen.codegen.mathematics import literal, mathematics
from flexgen.codegen.spec import FUNCTIONS, checked, library_spec
from flexgen.errors import BuildError
from flexgen.mechanics.equations import derive
from flexgen.model.reader import model_names, read
from flexgen.ports import Port
from flexgen.runtime import load

pytestmark = needs_compiler

STATES = 200


# --- the numbers ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", model_names())
def test_c_agrees_with_the_virtual_machine_bit_for_bit(name):
    equations = derive(name)
    library = loaded(name)
    assert tuple(library.functions) == FUNCTIONS
    states = random_states(equations.model, STATES)
    for function in library.functions.values():
        inputs = [states[port.name] for port in function.inputs]
        given = function(*inputs)
        expected = machine(equations.function(function.name), inputs)
        for port, c, vm in zip(function.outputs, given if isinstance(given, tuple) else [given], expected, strict=True):
            different = c.reshape(vm.shape).view(np.int64) != vm.view(np.int64)
            assert not different.any(), f"{function.name}, {port.name}: {different.sum()} entries"


# --- the text ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", SMALL)
def test_sources_are_strict_c99_and_pure(name, tmp_path):
    folder = made(name).directory
    run(CC, *STRICT, "-Wshadow", *sorted(folder.glob("*.c")), "-lm", "-o", tmp_path / "example", folder=tmp_path)
    for path in [*sources(folder), folder / f"{name}.h"]:
        text = path.read_text(encoding="ascii")
        for word in ("malloc", "calloc", "stdio", "printf", "stdlib", "casadi", "free("):
            assert word not in text, (path.name, word)
        assert str(ROOT) not in text
        assert path.suffix != ".h" or max(map(len, text.splitlines())) <= 120
    run(CC, "-std=c99", "-O2", "-c", *sources(folder), folder=tmp_path)
    for thing in tmp_path.glob("*.o"):
        assert not re.search(r" [bBdDC] ", run("nm", thing, folder=tmp_path)), thing.name  # no writable static data


def test_only_the_headers_symbols_are_exported():
    folder = made("planar5_nmp").directory
    library = next(path for path in folder.iterdir() if path.suffix in (".so", ".dylib"))
    listed = run("nm", "-D", "--defined-only", library, folder=folder)
    exported = {line.split()[-1] for line in listed.splitlines() if " T " in line or " D " in line or " B " in line}
    assert exported == set(symbols(library_spec(derive("planar5_nmp"))))
    header = (folder / "planar5_nmp.h").read_text()
    assert all(f"{symbol}(" in header for symbol in exported)


def test_the_header_is_a_manual():
    header = (made("planar5_nmp").directory / "planar5_nmp.h").read_text()
    for line in (
        " *   q_a: 0 q1 [rad], 1 q2 [rad], 2 q3 [rad]",
        " *   q_m: 0 m1 [rad], 1 m2 [rad]",
        "#define PLANAR5_NMP_NA 3 /* arm coordinates */",
        " *   tau_a = M(q_a) a_a + c(q_a, v_a) + g(q_a)",
        " *   in  a_a   n_a [rad/s^2] arm accelerations",
        " *   out M   n_a x n_a [kg m^2] mass matrix, symmetric",
        " *   m1: eta 100.0 (q1); J_m 0.004 kg m^2",
    ):
        assert line in header.splitlines()
    assert "gravity (0.0, -9.81, 0.0) m/s^2" in header


def test_the_header_has_the_coupled_ratios():
    model = read("manutec_r3", overrides={"motor.m6.drives": ["q5", "q6"], "motor.m6.ratio": [0.5, -99]})
    spec = library_spec(derive(model), ["gravity"])
    assert spec.gears[5] == (("q5", 0.5), ("q6", -99.0)) and spec.rotor_inertias[5] == model.motors[5].inertia
    assert " *   m6: eta 0.5 (q5), -99.0 (q6); J_m 4.3e-05 kg m^2\n" in emit(spec)["manutec_r3.h"]


def test_prototypes_break_between_arguments_only():
    for line in "\n".join(emit(library_spec(derive("manutec_r3_efjm"), ["forward_dynamics"])).values()).splitlines():
        assert not line.endswith("double") and not line.strip().startswith("*work"), line


def test_constants_are_written_as_people_write_them():
    text = (made("planar5_nmp").directory / "example.c").read_text()
    assert "{0.3, -1.1, 0.0}" in text.replace("(", "").replace(")", "")
    for path in made("planar5_nmp").directory.glob("*.c"):
        for number in re.findall(r"(?<![\w.])\d+\.\d+(?:e[-+]?\d+)?", path.read_text()):
            assert repr(float(number)) == number, (path.name, number)


def test_units_follow_the_coordinates():
    units = {port.name: port for port in loaded("elbow").functions["inverse_dynamics"].inputs}
    assert units["a_a"].unit == "rad/s^2"
    model = read("elbow")
    element = dataclasses.replace(
        model.elements[-1], dofs=(dataclasses.replace(model.elements[-1].dofs[0], type="translation"),)
    )
    mixed = dataclasses.replace(model, elements=(*model.elements[:-1], element))
    f = library_spec(derive(mixed), ["mass_matrix", "gravity"]).functions
    assert f[0].outputs[0].unit == "mixed" and "kg m^2, kg m or kg" in f[0].outputs[0].doc
    assert f[1].outputs[0].doc == "gravity forces, arm side; N m for rotations, N for translations"


def test_two_runs_give_the_same_bytes(tmp_path):
    again = generate("elbow", tmp_path / "again")
    first = made("elbow")
    assert [path.name for path in again.files] == [path.name for path in first.files]
    for a, b in zip(again.files, first.files, strict=True):
        assert a.read_bytes() == b.read_bytes(), a.name


def test_cpp_and_two_models_in_one_program(tmp_path):
    cpp = shutil.which("c++") or shutil.which("g++")
    if cpp is None:
        pytest.skip("no C++ compiler")
    program = ["#include <cstdio>"]
    body = []
    for name in SMALL:
        program.append(f'#include "{name}.h"')
        body.append(f"double M{name}[{name.upper()}_NA * {name.upper()}_NA], w{name}[{name.upper()}_MASS_MATRIX_WORK];")
        body.append(f"double q{name}[{name.upper()}_NA] = {{}};")
        body.append(f"if ({name}_mass_matrix(q{name}, M{name}, w{name}) != {name.upper()}_OK) return 1;")
        body.append(f'std::printf("%.17g\\n", M{name}[0]);')
    (tmp_path / "two.cpp").write_text("\n".join([*program, "int main() {", *body, "}"]))
    folders = [made(name).directory for name in SMALL]
    includes = [f"-I{folder}" for folder in folders]
    files = [path for folder in folders for path in sources(folder)]
    run(CC, *STRICT, "-c", *files, folder=tmp_path)
    run(cpp, "-Wall", "-Wextra", "-Wpedantic", "-Werror", *includes, "-c", "two.cpp", folder=tmp_path)
    run(cpp, *sorted(tmp_path.glob("*.o")), "-lm", "-o", "two", folder=tmp_path)
    printed = [float(line) for line in run(tmp_path / "two", folder=tmp_path).split()]
    for folder, M11 in zip(folders, printed, strict=True):
        library = load(folder)
        assert library.mass_matrix(np.zeros(library.sizes["n_a"]))[0, 0] == M11


# --- clients ----------------------------------------------------------------------------------------------------------
def test_the_example_prints_plausible_numbers(tmp_path):
    folder = made("planar5_nmp").directory
    run(CC, *STRICT, *sorted(folder.glob("*.c")), "-lm", "-o", tmp_path / "example", folder=tmp_path)
    printed = run(tmp_path / "example", folder=tmp_path)
    assert [line.split(":")[0] for line in printed.splitlines() if line.endswith(": success")] == list(FUNCTIONS)
    lines = printed.splitlines()
    at = lines.index("  p [m]")
    q1, q2 = 0.3, -1.1
    expected = 0.8 * np.cos(q1) + 0.8 * np.cos(q1 + q2), 0.8 * np.sin(q1) + 0.8 * np.sin(q1 + q2)
    assert np.allclose([float(lines[at + 1]), float(lines[at + 2])], expected, atol=1e-5)
    at = lines.index("  g [N m]")
    last = 25 * 9.81 * 0.225 * np.cos(q1 + q2)
    assert np.isclose(float(lines[at + 3]), last, rtol=1e-5)


def test_a_controller_in_c_links_the_library(tmp_path):
    folder = made("planar5_nmp").directory
    controller = ROOT / "examples" / "controller.c"
    run(CC, *STRICT, f"-I{folder}", controller, *sources(folder), "-lm", "-o", tmp_path / "controller", folder=tmp_path)
    alone, fed = [float(line.split()[-2]) for line in run(tmp_path / "controller", folder=tmp_path).splitlines()]
    assert 5.0 < alone < 50.0  # mm
    assert 0.0 < fed < alone / 5.0


def test_the_library_agrees_with_the_model_in_c_only(tmp_path):
    """The shared library linked by a stranger's program that is told nothing but the header."""
    folder = made("elbow").directory
    library = next(path for path in folder.iterdir() if path.suffix in (".so", ".dylib"))
    (tmp_path / "client.c").write_text(
        '#include "elbow.h"\n#include <stdio.h>\n'
        "int main(void)\n{\n    double q[ELBOW_NA] = {0}, g[ELBOW_NA], work[ELBOW_GRAVITY_WORK];\n"
        '    printf("%d %d %s\\n", elbow_gravity(q, g, work), elbow_n_a(), elbow_digest());\n    return 0;\n}\n'
    )
    run(CC, *STRICT, f"-I{folder}", "client.c", library, f"-Wl,-rpath,{folder}", "-o", "client", folder=tmp_path)
    status, n_a, digest = run(tmp_path / "client", folder=tmp_path).split()
    assert (status, n_a, digest) == ("0", "2", load(folder).digest)


# --- names and operations ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name", ["int", "sin", "a b", "x; system()", "*/", "two__scores", "9q", "", "a" * 32, "q\n", "ä"]
)
def test_names_unfit_for_c_are_refused(name):
    equations = derive("elbow")
    model = equations.model

    class Renamed:
        function = staticmethod(equations.function)

    renamed = Renamed()
    renamed.model = dataclasses.replace(model, name=name)
    with pytest.raises(BuildError, match="expected a"):
        library_spec(renamed)
    renamed.model = dataclasses.replace(
        model, motors=(dataclasses.replace(model.motors[0], name=name), *model.motors[1:])
    )
    with pytest.raises(BuildError, match="expected a"):
        library_spec(renamed)
    spec = library_spec(equations, ["gravity"])
    for changed in (
        dataclasses.replace(spec, name=name),
        dataclasses.replace(spec, coordinates=(name, "q2")),
        dataclasses.replace(spec, functions=(dataclasses.replace(spec.functions[0], name=name),)),
    ):
        with pytest.raises(BuildError, match="name for C: given"):
            emit(changed)


def test_text_cannot_leave_a_comment(tmp_path):
    spec = library_spec(derive("elbow"), ["gravity"])
    evil = 'x */ int evil; /* y \\ ??/ \n #error "no" ä'
    f = spec.functions[0]
    port = dataclasses.replace(f.outputs[0], doc=evil, unit=evil)
    files = emit(
        dataclasses.replace(spec, functions=(dataclasses.replace(f, summary=evil, equation=evil, outputs=(port,)),))
    )
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="ascii")
    run(CC, *STRICT, "-fsyntax-only", *sorted(tmp_path.glob("*.c")), folder=tmp_path)
    assert "evil" not in run("nm", _compiled(tmp_path, "elbow.c"), folder=tmp_path)


def _compiled(folder: Path, source: str) -> Path:
    run(CC, "-std=c99", "-c", source, "-o", "one.o", folder=folder)
    return folder / "one.o"


def test_ports_may_not_clash_with_the_functions_own_names():
    spec = library_spec(derive("elbow"), ["gravity"])
    f = spec.functions[0]
    for name in ("t12", "w", "work", "n"):
        port = dataclasses.replace(f.inputs[0], name=name)
        with pytest.raises(BuildError, match="uses itself"):
            emit(dataclasses.replace(spec, functions=(dataclasses.replace(f, inputs=(port,)),)))


X, Y = ca.SX.sym("x", 2), ca.SX.sym("y", 3)
IN, OUT = (Port("x", (2,), "1", ""),), (Port("y", (2,), "1", ""),)


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (ca.Function("f", [X], [X * Y[0]], ["x"], ["y"], {"allow_free": True}), "given free variables"),
        (ca.Function("f", [X], [X], ["z"], ["y"]), "given inputs z, expected x"),
        (ca.Function("f", [Y], [Y], ["x"], ["y"]), r"f, x: given a dense \(3, 1\) array, expected dense \(2, 1\)"),
        (ca.Function("f", [X], [ca.SX(2, 1)], ["x"], ["y"]), r"f, y: given a sparse"),
    ],
)
def test_functions_that_are_not_what_their_ports_say(function, told):
    with pytest.raises(BuildError, match=told):
        checked("f", function, IN, OUT)


def test_matrix_graphs_are_expanded_or_refused():
    x = ca.MX.sym("x", 2)
    assert checked("f", ca.Function("f", [x], [2 * x], ["x"], ["y"]), IN, OUT).is_a("SXFunction")
    convex = ca.convexify(ca.mtimes(x, x.T))[:, 0]
    with pytest.raises(BuildError, match="cannot be written as scalar operations, expected an SX function"):
        checked("f", ca.Function("f", [x], [convex], ["x"], ["y"]), IN, OUT)


def test_solvers_inside_are_refused():
    """CasADi's emitted root finders and factorisations report success where they fail."""
    x = ca.MX.sym("x", 2)
    root = ca.rootfinder("r", "newton", {"x": X, "p": Y, "g": X * X - Y[:2]})
    f = checked("f", ca.Function("f", [x], [root(x, ca.DM.ones(3))], ["x"], ["y"]), IN, OUT)
    with pytest.raises(BuildError, match="operation OP_CALL cannot be written in C"):
        mathematics(f)


def test_an_unknown_operation_is_named():
    with pytest.raises(BuildError, match="function f: operation OP_ERFINV cannot be written in C"):
        mathematics(ca.Function("f", [X], [ca.erfinv(X)], ["x"], ["y"]))


def test_literals_read_back_to_the_same_bits():
    assert (literal(0.3), literal(-9.81), literal(2.0), literal(1e16)) == ("0.3", "(-9.81)", "2.0", "1e+16")
    for x in (0.0, -0.0, 1.0, -3.0, 0.1, 1e300, -5e-324, 2.0**53, 1e22):
        text = literal(x).strip("()")
        assert float(text).hex() == x.hex() and re.search(r"[.e]", text)
    assert (literal(np.inf), literal(-np.inf), literal(np.nan)) == ("INFINITY", "(-INFINITY)", "NAN")


def _every_operation() -> ca.SX:
    """One row per operation of CasADi's scalar graphs."""
    a, b = X[0], X[1]
    rows = [
        a + b,
        a - b,
        a * b,
        a / b,
        -a,
        a * a,
        2 * a,
        1 / a,
        ca.sqrt(ca.fabs(a)),
        ca.fabs(a) ** b,
        ca.fabs(a) ** 2.5,
    ]
    rows += [f(a) for f in (ca.sin, ca.cos, ca.tan, ca.atan, ca.sinh, ca.cosh, ca.tanh, ca.asinh, ca.exp, ca.expm1)]
    rows += [f(a) for f in (ca.erf, ca.floor, ca.ceil, ca.fabs, ca.sign)]
    rows += [f(ca.sin(a)) for f in (ca.asin, ca.acos, ca.atanh)]
    rows += [f(1 + ca.fabs(a)) for f in (ca.log, ca.log1p, ca.acosh)]
    rows += [f(a, b) for f in (ca.fmin, ca.fmax, ca.fmod, ca.remainder, ca.copysign, ca.atan2, ca.hypot)]
    rows += [a < b, a <= b, a == b, a != b, ca.logic_not(a), ca.logic_and(a < 0, b < 0), ca.logic_or(a < 0, b < 0)]
    rows += [ca.if_else(a < b, a * 3, b / 7), ca.SX.inf() + 0 * a]
    return ca.vertcat(*rows)


@pytest.mark.parametrize("chunk", [1000, 7])
def test_every_operation_and_every_cut_gives_the_machines_bits(chunk, tmp_path, monkeypatch):
    monkeypatch.setattr("flexgen.codegen.mathematics.CHUNK", chunk)
    monkeypatch.setattr("flexgen.codegen.mathematics.MARGIN", 0)
    rows = _every_operation()
    y = ca.densify(ca.vertcat(rows, ca.cumsum(ca.sin(rows[:20]))))
    function = ca.Function("f", [X], [y], ["x"], ["y"])
    written = mathematics(function)
    assert (len(written.call) > 1) == (chunk == 7) == (written.work > 0)
    calls = "\n".join(written.call)
    (tmp_path / "f.c").write_text(
        f"#include <math.h>\n{written.text}\nvoid f(const double *x, double *y, double *work);\n"
        f"void f(const double *x, double *y, double *work)\n{{\n(void)work;\n{calls}\n}}\n"
    )
    run(CC, *STRICT, "-O2", "-fPIC", "-shared", "f.c", "-lm", "-o", "f.so", folder=tmp_path)
    f = ctypes.CDLL(str(tmp_path / "f.so")).f
    f.argtypes = [ctypes.c_void_p] * 3
    points = np.vstack([np.random.default_rng(5).normal(size=(STATES, 2)), [[0.0, 0.0], [1.0, 1.0], [-0.0, 2.0]]])
    expected = machine(function, [points])[0][:, :, 0]
    out, work = np.zeros(y.shape[0]), np.zeros(max(1, written.work))
    for point, vm in zip(points, expected, strict=True):
        x = np.ascontiguousarray(point)
        f(x.ctypes.data, out.ctypes.data, work.ctypes.data)
        assert np.array_equal(np.isnan(out), np.isnan(vm))  # the sign of a NaN means nothing
        assert np.array_equal(out.view(np.int64)[~np.isnan(vm)], vm.view(np.int64)[~np.isnan(vm)])
