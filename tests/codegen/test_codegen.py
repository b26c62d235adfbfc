"""The emitted C: its numbers, its text, its names, and the strangers that compile it."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from emitted import ROOT, SMALL, STRICT, loaded, machine, made, random_states, run, sources
from toolchain import CC, needs_compiler, tool
from unchecked import unchecked

from flexgen.base.errors import BuildError
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.emit import emit, symbols
from flexgen.codegen.emission.routines import check_ports
from flexgen.codegen.emission.spec import library_spec
from flexgen.codegen.statements.graph import read_graph
from flexgen.dynamics.mechanics.dynamics import MOTION
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.signatures import offered_functions
from flexgen.model.reader import model_names, read
from flexgen.runtime import load

pytestmark = needs_compiler

STATES = 200


# --- the numbers ---------------------------------------------------------------------------------
# C and the virtual machine run different algorithms (recursion against Lagrange's equations) and
# agree up to the rounding of some hundred to some thousand operations. Accelerations are judged by
# the forces they take: rounding moves light links by the condition number of the mass matrix, up
# to 1e6. It comes in where that cannot be: in motors behind rigid gears, and in derivatives, which
# are taken at the accelerations that each route found itself.
ROUNDING = 1e-11
ROUNDING_TIMES_CONDITION = 1e-9


# Large ones need half a minute of two cores each: the slow tests compile one of them, the full
# ones the others.
LARGE = {"manutec_r3_24", "manutec_r3_30", "kr300_efjm", "manutec_r3_efjm"}
FULL = LARGE - {"manutec_r3_24"}
NAMES = [
    name
    if name in SMALL
    else pytest.param(name, marks=pytest.mark.full if name in FULL else pytest.mark.slow)
    for name in model_names()
]


@pytest.mark.parametrize("name", NAMES)
def test_c_agrees_with_lagranges_equations(name):
    equations = derive(name)
    library = loaded(name)
    assert tuple(library.functions) == offered_functions(equations.model)
    states = random_states(equations.model, STATES if name not in LARGE else STATES // 10)
    M = machine(equations.function("residual_jacobians"), [states[k] for k in MOTION])[0]
    n = equations.model.n_a
    for function in library.functions.values():
        inputs = [states[port.name] for port in function.inputs]
        given = function(*inputs)
        expected = _expected(equations, function.name, inputs)
        for port, c, vm in zip(
            function.outputs, given if isinstance(given, tuple) else [given], expected, strict=True
        ):
            c = c.reshape(vm.shape)
            weight = None
            if port.name in ("a_a", "da_dq", "da_dv", "da_dtau"):
                weight = M[:, :n, :n]
            elif port.name in ("A", "B"):
                half = M.shape[1]
                assert np.array_equal(c[:, :half], vm[:, :half])
                c = c[:, half:]
                vm = vm[:, half:]
                weight = M
            size = np.abs(vm)
            error = np.abs(c - vm)
            if weight is not None:  # forces, and what they are the sum of
                size = np.abs(weight) @ size
                error = np.abs(weight @ (c - vm))
            scale = size.max(axis=(1, 2)) + size.max() * 1e-3
            error = error.max(axis=(1, 2)) / np.where(scale > 0, scale, 1.0)
            conditioned = port.name == "a_m" or function.name in (
                "arm_forward_derivatives",
                "linearize",
            )
            tolerance = ROUNDING_TIMES_CONDITION if conditioned else ROUNDING
            assert error.max() < tolerance, f"{function.name}, {port.name}"


def _expected(equations, name, inputs):
    """Results of CasADi's virtual machine for the definition of a function."""
    if name != "arm_forward_derivatives":
        return machine(equations.function(name), inputs)
    q, v, _ = inputs
    a = machine(equations.function("arm_forward_dynamics"), inputs)[0][:, :, 0]
    M, R = machine(equations.function("arm_residual_jacobians"), [q, v, a])
    n = M.shape[1]
    X = -np.linalg.solve(M, R)
    return [X[:, :, :n], X[:, :, n:], np.linalg.inv(M)]


@pytest.mark.parametrize("name", SMALL)
def test_one_point_and_many_have_the_same_bits(name):
    library = loaded(name)
    states = random_states(read(name), 37)
    for function in library.functions.values():
        inputs = [states[port.name] for port in function.inputs]
        many = function(*inputs)
        for k in range(37):
            one = function(*(x[k] for x in inputs))
            pairs = zip(one, many, strict=True) if isinstance(one, tuple) else [(one, many)]
            assert all(np.array_equal(a, b[k]) for a, b in pairs), function.name


# --- the text ------------------------------------------------------------------------------------
def static_library(folder: Path) -> Path:
    """The static library that was compiled when the sources were written."""
    (library,) = folder.glob("lib*.a")
    return library


@pytest.mark.parametrize(
    ("name", "level"),
    [  # with optimization compilers see more, such as variables without a value
        ("elbow", "-O0"),
        pytest.param("elbow", "-O1", marks=pytest.mark.slow),
        pytest.param("planar5_nmp", "-O1", marks=pytest.mark.slow),
    ],
)
def test_sources_are_strict_c99_and_pure(name, level, tmp_path):
    folder = made(name).directory
    run(
        CC,
        *STRICT,
        level,
        "-Wshadow",
        folder / "example.c",
        *sources(folder),
        "-lm",
        "-o",
        tmp_path / "example",
        folder=tmp_path,
    )
    for path in [*sources(folder), folder / f"{name}.h"]:
        text = path.read_text(encoding="ascii")
        for word in ("malloc", "calloc", "stdio", "printf", "stdlib", "casadi", "free("):
            assert word not in text, (path.name, word)
        assert str(ROOT) not in text
        assert path.suffix != ".h" or max(map(len, text.splitlines())) <= 120
    # no writable static data
    assert not re.search(r" [bBdDC] ", run("nm", static_library(folder), folder=tmp_path))


def test_the_sources_are_few():
    """One to compile and one header for each function, and some for the library; a build lists the
    former. A limit of their size is withdrawn: it asked for short comments, which readers of C
    need.
    """
    library = made("planar5_nmp")
    files = {path.name for path in (library.directory / "src").iterdir() if path.is_file()}
    headers = {name for name in files if name.endswith("_math.h")}
    assert headers == {f"planar5_nmp_{name}_math.h" for name in library.functions}
    of_functions = {f"planar5_nmp_{name}.c" for name in library.functions}
    assert of_functions <= files
    fixed = files - headers - of_functions
    assert len([name for name in fixed if name.endswith(".c")]) <= 5
    assert len(fixed) <= 24


def test_emitted_sources_leave_no_macro_of_the_mathematics_behind():
    """A source includes each header once, its mathematics twice, and no source; what it defines
    for the mathematics is undefined after it.
    """
    folder = made("planar5_nmp").directory / "src"
    undefined = re.findall(r"#undef (\w+)", (folder / "planar5_nmp_undefine.h").read_text())
    for name in ("point", "lanes"):
        text = (folder / f"planar5_nmp_{name}.h").read_text()
        assert sorted(re.findall(r"#define (\w+)", text)) == sorted(undefined)
    for path in folder.glob("*.c"):
        included = re.findall(r'#include "(.*)"', path.read_text())
        assert not [name for name in included if name.endswith(".c")], path.name
        twice = {name for name in included if included.count(name) > 1}
        found = {f"{path.stem}_math.h"} if f"{path.stem}_math.h" in included else set()
        if path.name != "planar5_nmp_inversion.c":
            assert twice == found, path.name
    for name in made("planar5_nmp").functions:
        assert "#define" not in (folder / f"planar5_nmp_{name}.c").read_text()


SERVO = """
[servo]
type = "cascade"
position_gain = [30.0, 25.0]
speed_gain = [1.5, 0.4]
integral_gain = [6.0, 6.0]
"""
NOTCH = "notch = [{ frequency_hz = 60.0 }]\n"
LOW_PASS = "low_pass = [{ frequency_hz = 400.0 }]\n"


@pytest.mark.parametrize(
    ("parts", "precision", "parameters", "filters"),
    [
        (["bvp", "limits", "force", "position"], "double", ["payload"], NOTCH + LOW_PASS),
        (["position"], "double", [], NOTCH),
        (["position", "force"], "double", [], LOW_PASS),
        (["limits"], "double", [], ""),
        (["limits", "force", "position"], "single", ["payload", "damping"], LOW_PASS),
    ],
)
def test_libraries_with_optional_parts_compile_without_a_warning(
    parts, precision, parameters, filters, tmp_path
):
    file = tmp_path / "robot.toml"
    file.write_text(Path(read("planar5_nmp").file).read_text() + SERVO + filters)
    options = {"parts": parts, "precision": precision, "parameters": parameters, "build": False}
    folder = generate(file, tmp_path / "library", **options).directory
    words = [*STRICT, "-Wshadow", "-Wdouble-promotion", "-fsyntax-only", f"-I{folder}"]
    for source in sources(folder):
        run(CC, *words, source, folder=tmp_path)


def test_only_the_headers_symbols_are_exported():
    folder = made("planar5_nmp").directory
    library = next(path for path in folder.iterdir() if path.suffix in (".so", ".dylib"))
    listed = run("nm", "-D", "--defined-only", library, folder=folder)
    exported = {
        line.split()[-1]
        for line in listed.splitlines()
        if " T " in line or " D " in line or " B " in line
    }
    assert exported == set(symbols(library_spec(derive("planar5_nmp"))))
    header = (folder / "planar5_nmp.h").read_text()
    header += "".join(
        (folder / f"planar5_nmp_{name}.h").read_text() for name in ("batch", "inversion")
    )
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
    assert "Gravity is (0.0, -9.81, 0.0) m/s^2" in header


def test_the_header_has_the_coupled_ratios():
    model = read(
        "manutec_r3", overrides={"motor.m6.drives": ["q5", "q6"], "motor.m6.ratio": [0.5, -99]}
    )
    spec = library_spec(derive(model), ["gravity"])
    assert (
        spec.gears[5] == (("q5", 0.5), ("q6", -99.0))
        and spec.rotor_inertias[5] == model.motors[5].inertia
    )
    assert " *   m6: eta 0.5 (q5), -99.0 (q6); J_m 4.3e-05 kg m^2\n" in emit(spec)["manutec_r3.h"]


@pytest.mark.slow
def test_prototypes_break_between_arguments_only():
    for line in "\n".join(
        emit(library_spec(derive("manutec_r3_efjm"), ["forward_dynamics"])).values()
    ).splitlines():
        assert not line.endswith("double") and not line.strip().startswith("*work"), line


def test_constants_are_written_as_people_write_them():
    text = (made("planar5_nmp").directory / "example.c").read_text()
    assert "{0.3, -1.1, 0.0}" in text.replace("(", "").replace(")", "")
    for path in (made("planar5_nmp").directory / "src").glob("planar5_nmp_*_math.h"):
        text = path.read_text()
        for number in re.findall(r"(?<![\w.])\d+\.\d+(?:e[-+]?\d+)?", text):
            assert repr(float(number)) == number, (path.name, number)


def test_units_follow_the_coordinates():
    units = {port.name: port for port in loaded("elbow").functions["inverse_dynamics"].inputs}
    assert units["a_a"].unit == "rad/s^2"
    model = read("elbow")
    element = dataclasses.replace(
        model.elements[-1],
        dofs=(dataclasses.replace(model.elements[-1].dofs[0], type="translation"),),
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


@pytest.mark.slow
def test_cpp_and_two_models_in_one_program(tmp_path):
    cpp = tool("c++")
    program = ["#include <cstdio>"]
    body = []
    for name in SMALL:
        program.append(f'#include "{name}.h"')
        body.append(f"double M{name}[{name.upper()}_NA * {name.upper()}_NA];")
        body.append(f"double q{name}[{name.upper()}_NA] = {{}};")
        body.append(f"if ({name}_mass_matrix(q{name}, M{name}) != {name.upper()}_OK) return 1;")
        body.append(f'std::printf("%.17g\\n", M{name}[0]);')
    (tmp_path / "two.cpp").write_text("\n".join([*program, "int main() {", *body, "}"]))
    folders = [made(name).directory for name in SMALL]
    includes = [f"-I{folder}" for folder in folders]
    files = [path for folder in folders for path in sources(folder)]
    run(CC, *STRICT, "-O0", "-c", *files, folder=tmp_path)
    run(
        cpp,
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
        *includes,
        "-c",
        "two.cpp",
        folder=tmp_path,
    )
    run(cpp, *sorted(tmp_path.glob("*.o")), "-lm", "-o", "two", folder=tmp_path)
    printed = [float(line) for line in run(tmp_path / "two", folder=tmp_path).split()]
    for folder, M11 in zip(folders, printed, strict=True):
        library = load(folder)
        assert library.mass_matrix(np.zeros(library.sizes["n_a"]))[0, 0] == M11


# --- clients -------------------------------------------------------------------------------------
def test_the_example_prints_plausible_numbers(tmp_path):
    folder = made("planar5_nmp").directory
    run(
        CC,
        *STRICT,
        folder / "example.c",
        static_library(folder),
        "-lm",
        "-o",
        tmp_path / "example",
        folder=tmp_path,
    )
    printed = run(tmp_path / "example", folder=tmp_path)
    assert [line.split(":")[0] for line in printed.splitlines() if line.endswith(": success")] == [
        *offered_functions(read("planar5_nmp")),
        "invert",
        "stream",
    ]
    lines = printed.splitlines()
    at = lines.index("  p [m]")
    q1 = 0.3
    q2 = -1.1
    expected = 0.8 * np.cos(q1) + 0.8 * np.cos(q1 + q2), 0.8 * np.sin(q1) + 0.8 * np.sin(q1 + q2)
    assert np.allclose([float(lines[at + 1]), float(lines[at + 2])], expected, atol=1e-5)
    at = lines.index("  g [N m]")
    last = 25 * 9.81 * 0.225 * np.cos(q1 + q2)
    assert np.isclose(float(lines[at + 3]), last, rtol=1e-5)


def test_a_controller_in_c_links_the_library(tmp_path):
    folder = made("planar5_nmp").directory
    controller = ROOT / "examples" / "controller.c"
    words = [controller, static_library(folder), "-lm", "-o", tmp_path / "controller"]
    run(CC, *STRICT, f"-I{folder}", *words, folder=tmp_path)
    alone, fed = [
        float(line.split()[-2])
        for line in run(tmp_path / "controller", folder=tmp_path).splitlines()
    ]
    assert 5.0 < alone < 50.0  # mm
    assert 0.0 < fed < alone / 5.0


def test_the_library_agrees_with_the_model_in_c_only(tmp_path):
    """The shared library linked by a stranger's program that is told nothing but the header."""
    folder = made("elbow").directory
    library = next(path for path in folder.iterdir() if path.suffix in (".so", ".dylib"))
    (tmp_path / "client.c").write_text(
        '#include "elbow.h"\n#include <stdio.h>\n'
        "int main(void)\n{\n    double q[ELBOW_NA] = {0}, g[ELBOW_NA];\n"
        '    printf("%d %d %s\\n", elbow_gravity(q, g), elbow_n_a(), elbow_digest());\n'
        "    return 0;\n"
        "}\n"
    )
    run(
        CC,
        *STRICT,
        f"-I{folder}",
        "client.c",
        library,
        f"-Wl,-rpath,{folder}",
        "-o",
        "client",
        folder=tmp_path,
    )
    status, n_a, digest = run(tmp_path / "client", folder=tmp_path).split()
    assert (status, n_a, digest) == ("0", "2", load(folder).digest)


# --- names and operations ------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name",
    ["int", "sin", "a b", "x; system()", "*/", "two__scores", "9q", "", "a" * 32, "q\n", "ä"],
)
def test_names_unfit_for_c_are_refused(name):
    equations = derive("elbow")
    model = equations.model

    class Renamed:
        function = staticmethod(equations.function)

    renamed = Renamed()
    renamed.model = unchecked(model, name=name)
    with pytest.raises(BuildError, match="expected a"):
        library_spec(renamed)
    renamed.model = unchecked(
        model, motors=(unchecked(model.motors[0], name=name), *model.motors[1:])
    )
    # fine names of motors and coordinates: they are not identifiers in C
    reserved = name in ("int", "sin")
    spec = library_spec(equations, ["gravity"])
    if reserved:
        emit(dataclasses.replace(spec, coordinates=(name, "q2"), motors=(name, "m2")))
    else:
        with pytest.raises(BuildError, match="expected a"):
            library_spec(renamed)
    for changed in (
        dataclasses.replace(spec, name=name),
        *([] if reserved else [dataclasses.replace(spec, coordinates=(name, "q2"))]),
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
        dataclasses.replace(
            spec, functions=(dataclasses.replace(f, summary=evil, equation=evil, outputs=(port,)),)
        )
    )
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="ascii")
    run(CC, *STRICT, "-fsyntax-only", "example.c", *sources(tmp_path), folder=tmp_path)
    assert "evil" not in run("nm", _compiled(tmp_path, "src/elbow.c"), folder=tmp_path)


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


X = ca.SX.sym("x", 2)
Y = ca.SX.sym("y", 3)
IN = (Port("x", (2,), "1", ""),)
OUT = (Port("y", (2,), "1", ""),)


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (
            ca.Function("f", [X], [X * Y[0]], ["x"], ["y"], {"allow_free": True}),
            "given free variables",
        ),
        (ca.Function("f", [X], [X], ["z"], ["y"]), "given inputs z, expected x"),
        (
            ca.Function("f", [Y], [Y], ["x"], ["y"]),
            r"f, x: given a dense \(3, 1\) array, expected dense \(2, 1\)",
        ),
        (ca.Function("f", [X], [ca.SX(2, 1)], ["x"], ["y"]), r"f, y: given a sparse"),
    ],
)
def test_functions_that_contradict_their_ports_are_refused(function, told):
    with pytest.raises(BuildError, match=told):
        check_ports("f", function, IN, OUT)


def test_matrix_graphs_are_expanded_or_refused():
    x = ca.MX.sym("x", 2)
    assert check_ports("f", ca.Function("f", [x], [2 * x], ["x"], ["y"]), IN, OUT).is_a(
        "SXFunction"
    )
    convex = ca.convexify(ca.mtimes(x, x.T))[:, 0]
    with pytest.raises(
        BuildError, match="cannot be written as scalar operations, expected an SX function"
    ):
        check_ports("f", ca.Function("f", [x], [convex], ["x"], ["y"]), IN, OUT)


def test_solvers_inside_are_refused():
    """CasADi's emitted root finders and factorisations report success where they fail."""
    x = ca.MX.sym("x", 2)
    root = ca.rootfinder("r", "newton", {"x": X, "p": Y, "g": X * X - Y[:2]})
    f = check_ports("f", ca.Function("f", [x], [root(x, ca.DM.ones(3))], ["x"], ["y"]), IN, OUT)
    with pytest.raises(BuildError, match="operation OP_CALL cannot be written in C"):
        read_graph(f)


def test_an_unknown_operation_is_named():
    with pytest.raises(BuildError, match="function f: operation OP_ERFINV cannot be written in C"):
        read_graph(ca.Function("f", [X], [ca.erfinv(X)], ["x"], ["y"]))
