"""The architecture: floors, no import circles, rooms without CasADi, nothing heavy behind --help,
limits of size.

Imports and sizes are read from the syntax tree of the source; nothing is imported. A text that is
the name of a module counts as an import of it: such texts are imported when a function is called.
A planted violation of each rule shows that the test sees it.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from public_stub import STUB, stub
from room_picture import PICTURE, graph, graph_of, picture, reduced, rows_of

from flexgen.library.source_digest import CALLER, EMISSION, NUMERICAL, emission_files

ROOT = Path(__file__).resolve().parents[2]

# Applications of the middle rooms: none imports another, and no middle room imports one.
WINGS = (
    "autodiff",
    "benchmarks",
    "calibration",
    "cuda",
    "laws",
    "equations_text",
    "exports",
    "gears",
    "identification",
    "lab",
    "model_files",
    "observers",
    "performance",
    "planning",
    "plausibility",
    "servo",
    "sweeps",
    "templates",
    "uncertainty",
)

# A room (module or package below flexgen) imports from its own room and from rooms on lower floors
# only; rooms on the ground floor may use each other.
FLOORS = {
    "array_files": 0,
    "atomic_files": 0,
    "counts": 0,
    "deadline": 0,
    "deprecation": 0,
    "display": 0,
    "errors": 0,
    "interpolation": 0,
    "npz_files": 0,
    "position_servo": 0,
    "spec": 0,
    "progress": 0,
    "registry": 0,
    "results": 0,
    "sensors": 0,
    "torque_curve": 0,
    "trajectory": 0,
    "trajectory_files": 0,
    "type_checks": 0,
    "types_of_values": 0,
    "units": 0,
    "verb_rows": 0,
    "version": 0,
    "numerics": 1,
    "expressions": 1,
    "clib": 1,
    "model": 1,
    "runtime": 1,
    "mechanics": 2,
    "records": 2,
    "memory": 3,
    "recursion": 3,
    "dae": 3,
    "analysis": 4,
    "codegen": 4,
    "library": 5,
    "inverse_kinematics": 6,
    "environment": 6,
    "paths": 7,
    "accuracy": 8,
    "simulation": 8,
    "inversion": 9,
    "loop": 10,
    **dict.fromkeys(WINGS, 11),
    "jax": 12,
    "torch": 12,
    "plots": 12,
    "reports": 13,
    "": 14,  # the front room: tables of public names; only the command line imports it
    "verb_parameters": 15,
    "verb_texts": 15,
    "verbs": 16,
    "cli": 17,
    "__main__": 18,
}

WITHOUT_CASADI = ["errors", "spec", "trajectory", "model", "clib", "runtime", "cli", "__main__"]
INSTANT = ["cli", "__main__"]  # behind --help: the standard library only
HEAVY = {"casadi", "numpy", "scipy", "sympy", "matplotlib", "mujoco"}
RUNTIME_NEEDS = {
    "runtime",
    "counts",
    "errors",
    "progress",
    "spec",
    "type_checks",
    "types_of_values",
}
RUNTIME_NEEDS |= {
    "",
    "blas_threads",
    "deprecation",
    "registry",
    "version",
}  # the package itself, which is imported with its modules

# Modules that import what a variable names: a name from a table that another module has handed
# down, or a user's file.
IMPORT_BY_NAME = {"flexgen", "flexgen.registry"}

MEASURED = ["flexgen", "benchmarks", "examples"]

MOST = 8
# Functions and methods of flexgen with more parameters (without self) than `MOST`; each number may
# only fall, and new functions take a record of options. Those of verbs are the options of the
# command line, see test_former_names.py.
PARAMETERS = {
    "benchmarks/tune.py tune": 10,  # a verb
    "benchmarks/tune_cascade.py tune_cascade": 14,  # a verb: the loop of the verb control
    "calibration/calibrate.py calibrate": 10,  # a verb
    "exports/fmu/export.py export_fmu": 12,  # a verb
    "exports/ros2/export.py export_ros2": 10,  # a verb
    # a verb; numbers and exponents of elements are what gears differ in
    "gears/identify.py identify_gears": 13,
    "identification/experiments/plan.py excite": 18,  # a verb
    "identification/graybox.py identify": 18,  # a verb
    "identification/motion_fit.py fit_motion": 11,  # a verb
    # a verb; the force of a process is data of the problem, as the move is
    "inversion/solve.py solve": 19,
    "library/generate.py generate": 15,  # a verb
    # robots, drives and noise are given apart by five callers with other choices
    "loop/closed_loop.py __init__": 16,
    # a verb; two for the force that acts and the one that the feedforward assumes
    "loop/control.py control": 19,
    "loop/case.py control_case": 14,  # the options of the verb control but the controller
    "observers/constant_gain.py __init__": 9,  # a public class with keywords
    "observers/extended_kalman.py __init__": 9,  # a public class with keywords
    "performance/learn.py learn": 15,  # a verb
    # a verb; the force is data of the problem, as the move is
    "performance/minimum_time.py fastest": 10,
    "planning/problem.py solve": 9,  # a method of a public class
    # a public class; the arguments are the entries of the manifest
    "runtime/calls.py __init__": 11,
    "runtime/library.py stream": 13,  # a method of a public class
    # the members of the samples and of the options in C
    "runtime/limited_inversion.py __call__": 27,
    "runtime/path_inversion.py __call__": 16,  # the members of the samples and of the options in C
    "runtime/stream.py __init__": 15,  # the options of `Library.stream`
    "servo/command.py command_positions": 10,  # a verb
    "simulation/simulate.py simulate": 11,  # a verb
    "sweeps/sweep.py sweep": 9,  # a verb
}

# loaded by `flexgen.solve`, before a call, and by `flexgen --version`
MODULES_OF_SOLVE = 90
MODULES_OF_VERSION = 8

# Functions named by a participle, such as `turned`: public methods, decorators and changed copies;
# may only shrink.
PARTICIPLES = 25
PARTICIPLE = re.compile(
    r"^ *(?P<property>@[\w.]*property\n *)?def _*(?!(?:speed|feed|need|seed)\()[a-z]+ed"
    r"\((?:[^()]|\([^()]*\))*\) -> (?!bool)",
    re.MULTILINE,
)
NAMED = re.compile(r"flexgen(\.\w+)+[.:]?(\w+)?\Z")
IMPORTERS = ("import_module", "__import__")


@dataclass(frozen=True)
class Import:
    """``module`` imports ``target`` (dotted names).

    ``late``: inside a function, or for type checking only; ``text``: the name is in a text,
    imported when it is needed.
    """

    module: str
    target: str
    line: int
    late: bool
    text: bool = False


@dataclass(frozen=True)
class Source:
    """What the rules need to know of a source.

    Parameters
    ----------
    imports : list of tuple
        As written: module, name (empty for ``import module``), line, and whether it is late.
    functions : list of tuple
        Name, first line, number of lines, number of parameters without self.
    texts : list of tuple
        Texts that may name a module, of f-strings the part before the first brace, and their
        lines.
    unnamed : list of int
        Lines of imports of what a variable names.
    """

    imports: list[tuple[str, str, int, bool]]
    functions: list[tuple[str, int, int, int]]
    texts: list[tuple[str, int]]
    unnamed: list[int]


@cache
def source(text: str) -> Source:
    """One pass through the syntax tree of a source, which is made once for all tests."""
    out: list[tuple[str, str, int, bool]] = []
    functions: list[tuple[str, int, int, int]] = []
    texts: list[tuple[str, int]] = []
    unnamed: list[int] = []

    def walk(node: ast.AST, late: bool) -> None:
        if isinstance(node, ast.expr):  # there is no statement in it
            for part in ast.walk(node):
                if (
                    isinstance(part, ast.Constant)
                    and isinstance(part.value, str)
                    and NAMED.match(part.value)
                ):
                    texts.append((part.value, part.lineno))
                elif (
                    isinstance(part, ast.Call)
                    and part.args
                    and ast.unparse(part.func).endswith(IMPORTERS)
                ):
                    first = part.args[0]
                    first = first.values[0] if isinstance(first, ast.JoinedStr) else first
                    unnamed.extend([] if isinstance(first, ast.Constant) else [part.lineno])
            return
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = [
                a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            ]
            count = len(names) - (names[:1] in (["self"], ["cls"]))
            functions.append(
                (node.name, node.lineno, (node.end_lineno or node.lineno) - node.lineno + 1, count)
            )
        if isinstance(node, ast.Import):
            out.extend((alias.name, "", node.lineno, late) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import of {node.module}"
            assert node.module is not None
            out.extend((node.module, alias.name, node.lineno, late) for alias in node.names)
        inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        guard = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.iter_child_nodes(node):
            guarded = guard and isinstance(node, ast.If) and child in node.body
            walk(child, late or inside or guarded)

    walk(ast.parse(text), False)
    return Source(out, functions, texts, unnamed)


def imports_of(module: str, text: str, known: Collection[str]) -> list[Import]:
    """All imports of a module's source; names that are modules among the ``known`` ones are
    targets themselves.
    """
    found = [
        Import(
            module, f"{base}.{name}" if name and f"{base}.{name}" in known else base, line, late
        )
        for base, name, line, late in source(text).imports
    ]
    for name, line in source(text).texts:
        head = name.partition(":")[0]  # of "module:function"
        # the beginning of an f-string: each module of that package may be meant
        if head.endswith("."):
            targets = [other for other in known if other.startswith(head)]
        else:
            parts = head.split(".")
            # "module.function" too
            names = [".".join(parts[:k]) for k in range(len(parts), 1, -1)]
            targets = [other for other in names if other in known][:1]
        found += [Import(module, target, line, True, True) for target in targets]
    return found


@cache
def _read_sources() -> dict[str, str]:
    paths = sorted((ROOT / "flexgen").rglob("*.py"))
    return {
        module_name(path.relative_to(ROOT).as_posix()): path.read_text(encoding="utf-8")
        for path in paths
    }


def sources() -> dict[str, str]:
    """Text of every module of flexgen by its dotted name; the caller may change the dictionary."""
    return dict(_read_sources())


def all_imports(texts: dict[str, str]) -> list[Import]:
    return [found for module, text in texts.items() for found in imports_of(module, text, texts)]


def room(module: str) -> str:
    """The first name below flexgen; empty for flexgen itself."""
    return module.partition(".")[2].partition(".")[0]


def inner(imports: Iterable[Import]) -> list[Import]:
    return [found for found in imports if found.target.partition(".")[0] == "flexgen"]


def floor_violations(imports: Iterable[Import]) -> list[str]:
    """Imports that do not go down, late ones and those for types included."""
    out = []
    for found in inner(imports):
        here = room(found.module)
        there = room(found.target)
        if here == there:
            continue
        if FLOORS[there] > FLOORS[here] or (FLOORS[there] == FLOORS[here] and FLOORS[here] > 0):
            out.append(f"{found.module}:{found.line} imports {found.target}")
    return out


def sibling_violations(imports: Iterable[Import]) -> list[str]:
    """Imports from one of the `WINGS` to another."""
    rooms = set(WINGS)
    return [
        f"{found.module}:{found.line} imports {found.target}"
        for found in inner(imports)
        if room(found.module) in rooms and room(found.target) in rooms - {room(found.module)}
    ]


def circles(imports: Iterable[Import]) -> list[list[str]]:
    """Circles among the modules; imports inside functions and those for type checking count."""
    graph: dict[str, set[str]] = {}
    for found in inner(imports):
        if found.target != found.module:
            graph.setdefault(found.module, set()).add(found.target)
    out: list[list[str]] = []
    done: set[str] = set()

    def visit(module: str, trail: list[str]) -> None:
        if module in trail:
            out.append(trail[trail.index(module) :])
            return
        if module in done:
            return
        for target in sorted(graph.get(module, ())):
            visit(target, [*trail, module])
        done.add(module)

    for module in sorted(graph):
        visit(module, [])
    return out


def reached(start: str, imports: Iterable[Import]) -> set[str]:
    """All that importing a module imports, outside packages by their first name; parents of
    packages included.
    """
    graph: dict[str, set[str]] = {}
    for found in imports:
        if not found.late:
            graph.setdefault(found.module, set()).add(found.target)
    seen: set[str] = set()
    todo = [start]
    while todo:
        module = todo.pop()
        if module in seen:
            continue
        seen.add(module)
        if module.startswith("flexgen"):
            todo += graph.get(module, ())
            if "." in module:
                todo.append(module.rpartition(".")[0])
    return {
        module if module.startswith("flexgen") else module.partition(".")[0] for module in seen
    }


def unnamed_imports(texts: dict[str, str]) -> list[str]:
    """Modules that import what a variable names."""
    return [module for module, text in texts.items() if source(text).unnamed]


def modules_of(names: Iterable[str], texts: dict[str, str]) -> list[str]:
    return [module for module in texts if room(module) in set(names) and room(module)]


def module_name(path: str) -> str:
    """Dotted name of a file, given by its path below the root."""
    parts = Path(path).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def files(root: Path = ROOT) -> dict[str, str]:
    """Text of every Python file in the folders of `MEASURED`, by its path below the root."""
    found = (path for folder in MEASURED for path in sorted((root / folder).rglob("*.py")))
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in found}


def long_signatures(texts: dict[str, str]) -> dict[str, int]:
    """Functions of flexgen with more than `MOST` parameters, by file and name."""
    found = {
        f"{path.removeprefix('flexgen/')} {name}": count
        for path, text in texts.items()
        if path.startswith("flexgen/")
        for name, _, _, count in source(text).functions
    }
    return {name: count for name, count in found.items() if count > MOST}


def computing(imports: Iterable[Import]) -> list[str]:
    """Imports of packages for numbers in the command line, late ones too."""
    heavy = HEAVY | {"flexgen.numerics"}
    return [
        f"{found.module}:{found.line} imports {found.target}"
        for found in imports
        if room(found.module) == "cli"
        and any(f"{found.target}.".startswith(f"{name}.") for name in heavy)
    ]


# --- the rules -----------------------------------------------------------------------------------
def test_every_room_has_a_floor():
    unknown = {room(module) for module in sources()} - set(FLOORS)
    assert not unknown, f"add to FLOORS: {sorted(unknown)}"


def test_imports_go_down():
    assert floor_violations(all_imports(sources())) == []


def test_no_circles():
    assert circles(all_imports(sources())) == []


def test_no_module_imports_what_only_a_variable_names():
    assert set(unnamed_imports(sources())) == IMPORT_BY_NAME


def test_applications_do_not_import_one_another():
    assert sibling_violations(all_imports(sources())) == []


def test_no_further_function_has_more_than_eight_parameters():
    found = long_signatures(files())
    assert found.keys() == PARAMETERS.keys() and all(
        found[name] <= PARAMETERS[name] for name in found
    )


def test_a_planted_method_with_nine_parameters_is_seen():
    planted = {
        "flexgen/x.py": (
            "class A:\n    def f(self, a, b, c, d, e, *, f, g, h, i): ...\n    def g(self): ...\n"
        )
    }
    assert long_signatures(planted) == {"x.py f": 9}


def participles(text: str) -> int:
    """Functions with a participle as their name that are neither properties nor return a bool."""
    return sum(found["property"] is None for found in PARTICIPLE.finditer(text))


def test_functions_are_verbs():
    assert sum(map(participles, sources().values())) <= PARTICIPLES


def test_planted_participle_is_seen():
    method = "class A:\n    def _turned(self, x: tuple[()]) -> float: ...\n"
    assert (
        participles(method) == 1
        and participles(method.replace("    def", "    @property\n    def")) == 0
    )
    assert (
        participles(method.replace("float", "bool"))
        == participles(method.replace("turned", "turn"))
        == 0
    )


def test_rooms_without_casadi():
    texts = sources()
    imports = all_imports(texts)
    assert [m for m in modules_of(WITHOUT_CASADI, texts) if "casadi" in reached(m, imports)] == []


def test_nothing_heavy_behind_help():
    texts = sources()
    imports = all_imports(texts)
    assert {
        m: sorted(HEAVY & reached(m, imports)) for m in ["flexgen", *modules_of(INSTANT, texts)]
    } == {m: [] for m in ["flexgen", *modules_of(INSTANT, texts)]}


def test_the_command_line_computes_nothing():
    """Late imports too: what computes is in the room of the result, where Python users find it."""
    assert computing(all_imports(sources())) == []


def test_planted_arrays_in_the_command_line_are_seen():
    texts = sources()
    texts["flexgen.cli.verbs.run"] += "\ndef late():\n    import numpy as np\n"
    assert len(computing(all_imports(texts))) == 1


def test_runtime_needs_numpy_and_the_ground_floor_only():
    texts = sources()
    # late ones too
    imports = [Import(i.module, i.target, i.line, False) for i in all_imports(texts) if not i.text]
    needs = reached("flexgen.runtime", imports)
    assert {room(m) for m in needs if m.startswith("flexgen")} <= RUNTIME_NEEDS
    assert needs & HEAVY == {"numpy"}


def test_packages_of_the_wheel_are_those_of_the_tree():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]
    folders = [path.parent for path in (ROOT / "flexgen").rglob("__init__.py")]
    expected = {".".join(folder.relative_to(ROOT).parts) for folder in folders} | {
        "flexgen.models"
    }
    assert set(settings["packages"]) == expected
    assert settings["package-dir"] == {"": "."}  # an editable installation without an import hook
    assert (ROOT / "flexgen" / "models").resolve() == ROOT / "models"


def test_the_stub_has_the_public_names():
    assert STUB.read_text(encoding="utf-8") == stub(), "run: make golden"


def test_the_picture_of_the_rooms_is_that_of_the_imports():
    assert PICTURE.read_text(encoding="utf-8") == picture(), "run: make golden"


def test_all_rooms_lie_within_the_picture():
    width = float(re.findall(r'viewBox="0 0 (\d+)', picture())[0])
    boxes = re.findall(r'<rect x="(-?\d+)" y="\d+" width="(\d+)"', picture())
    assert len(boxes) > len(WINGS) and all(
        float(x) > 0.0 and float(x) + float(size) < width for x, size in boxes
    )


def test_wings_in_the_picture_are_those_of_the_rules():
    rows = rows_of(graph())
    assert sorted([*rows[-3], *rows[-2]]) == sorted(WINGS)


def test_planted_arrow_changes_the_picture():
    planted = graph_of([("b", "a"), ("c", "b"), ("c", "a")], set())
    assert reduced(planted)["c"] == {"b"} and reduced(planted | {"d": {"a"}})["d"] == {"a"}


def test_import_of_the_command_line_loads_nothing_heavy():
    code = (
        "import sys, flexgen.cli.main; print(*sorted({name.partition('.')[0] for name in "
        "sys.modules}))"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert not HEAVY & set(out.split())
    assert "argparse" in out.split()


def modules_loaded(code: str) -> set[str]:
    """The modules of flexgen that a new interpreter has loaded after these lines."""
    lines = f"import sys\n{code}\nprint('\\n' + ' '.join(name for name in sys.modules))"
    out = subprocess.run(
        [sys.executable, "-c", lines], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    return {name for name in out.splitlines()[-1].split() if name.partition(".")[0] == "flexgen"}


def test_solve_loads_at_most_90_modules_and_the_count_from_the_source_is_that_of_the_interpreter():
    # takes long
    found = modules_loaded(
        "import flexgen; flexgen.solve; assert 'scipy.signal' not in sys.modules"
    )
    reached_here = reached("flexgen.inversion.solve", all_imports(sources()))
    assert found == {name for name in reached_here if name.partition(".")[0] == "flexgen"}
    assert len(found) <= MODULES_OF_SOLVE, (
        "import what only some calls need in the function that needs it"
    )


def test_version_loads_no_verb_and_describe_no_solver():
    version = modules_loaded("from flexgen.cli.main import main; main(['--version'])")
    described = modules_loaded("from flexgen.cli.main import main; main(['describe', 'elbow'])")
    assert len(version) <= MODULES_OF_VERSION and "flexgen.cli.parser" not in version
    # of inversion and simulation only the names of methods and of holds, for the options of solve
    assert not {"codegen", "analysis"} & {room(name) for name in described}
    assert not described & {"flexgen.inversion.solve", "flexgen.simulation.simulate"}


def test_planted_import_is_in_the_count_of_solve():
    texts = sources()
    texts["flexgen.numerics.evaluate"] += "\nfrom flexgen.codegen.emit import emit\n"
    assert len(reached("flexgen.inversion.solve", all_imports(texts))) > MODULES_OF_SOLVE


def test_verbs_are_public_and_not_hidden_by_modules_of_the_same_name():
    code = (
        "import flexgen\n"
        "for verb in 'models describe derive analyze generate solve simulate'.split():\n"
        "    if verb not in flexgen.__all__:\n"
        "        print(verb, 'is missing')\n"
        "for _ in range(2):\n"
        "    for verb in flexgen.__all__:\n"
        "        if verb != '__version__' and not callable(getattr(flexgen, verb)):\n"
        "            print(verb)\n"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert out == ""


# --- planted bugs --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("flexgen.model.reader", "from flexgen.mechanics.equations import derive"),
        ("flexgen.mechanics.equations", "def late():\n    import flexgen.inversion.solve"),
        ("flexgen.library.generate", "from flexgen import inversion"),
        ("flexgen.runtime", "from flexgen.codegen import spec"),
        ("flexgen.analysis.linear", "from flexgen.paths.path import Path"),
        (
            "flexgen.paths.path",
            "if TYPE_CHECKING:\n    from flexgen.inversion.solution import Solution",
        ),
        ("flexgen.paths.path", "PLOT = 'flexgen.plots.solution'"),
        ("flexgen.paths.path", "PLOT = {'Path.plot': 'flexgen.plots.solution:plot_solution'}"),
        (
            "flexgen.paths.path",
            "def late():\n    return import_module('flexgen.plots.solution').plot_solution",
        ),
        ("flexgen.paths.path", "from flexgen import solve"),
    ],
)
def test_planted_import_upwards_is_seen(module, line):
    texts = sources()
    texts[module] += f"\n{line}\n"
    found = floor_violations(all_imports(texts))
    assert len(found) == 1 and found[0].startswith(module)


@pytest.mark.parametrize(
    ("module", "line", "other"),
    [
        ("flexgen.errors", "from flexgen.trajectory import Trajectory", "flexgen.trajectory"),
        (
            "flexgen.mechanics.outputs",
            "if TYPE_CHECKING:\n    from flexgen.mechanics.equations import Equations",
            "flexgen.mechanics.equations",
        ),
        (
            "flexgen.recursion.arm",
            "def late():\n    from flexgen.recursion.functions import fast_function",
            "flexgen.recursion.functions",
        ),
        (
            "flexgen.mechanics.outputs",
            "TABLE = {'derive': 'flexgen.mechanics.equations'}",
            "flexgen.mechanics.equations",
        ),
        (
            "flexgen.inversion.methods.lq",
            "def late(name):\n    return import_module(f'flexgen.inversion.{name}').solve",
            "flexgen.inversion.solve",
        ),
    ],
)
def test_planted_circle_is_seen(module, line, other):
    texts = sources()
    texts[module] += f"\n{line}\n"
    assert any({module, other} <= set(circle) for circle in circles(all_imports(texts)))


def test_planted_import_of_a_variable_is_seen():
    planted = (
        "from importlib import import_module\n\ndef late(name):\n    return import_module(name)\n"
    )
    texts = sources() | {"flexgen.paths.planted": planted}
    assert set(unnamed_imports(texts)) == {*IMPORT_BY_NAME, "flexgen.paths.planted"}


@pytest.mark.parametrize(
    "line",
    [
        "from flexgen.{other} import laws",
        "def late():\n    import flexgen.{other}.laws",
        "if TYPE_CHECKING:\n    from flexgen.{other}.laws import Law",
    ],
)
@pytest.mark.parametrize(
    ("one", "other"), [*zip(WINGS, [*WINGS[1:], WINGS[0]], strict=True), (WINGS[0], WINGS[0])]
)
def test_planted_import_of_a_sibling_is_seen(one, other, line):
    known = {f"flexgen.{name}{end}" for name in WINGS for end in ("", ".laws")}
    imports = imports_of(f"flexgen.{one}.planted", line.format(other=other) + "\n", known)
    for found in (sibling_violations(imports), floor_violations(imports)):
        assert len(found) == (one != other)


@pytest.mark.parametrize(
    ("module", "line", "rooms"),
    [
        ("flexgen.spec.ports", "import casadi as ca", WITHOUT_CASADI),
        # a package is imported with its modules
        ("flexgen.model", "from casadi import SX", WITHOUT_CASADI),
        ("flexgen.errors", "import numpy.linalg", INSTANT),
        (
            "flexgen.cli.result",
            "try:\n    import scipy.linalg\nexcept ImportError:\n    pass",
            INSTANT,
        ),
    ],
)
def test_planted_heavy_import_is_seen(module, line, rooms):
    texts = sources()
    texts[module] += f"\n{line}\n"
    imports = all_imports(texts)
    heavy = {"casadi"} if rooms is WITHOUT_CASADI else HEAVY
    assert any(heavy & reached(m, imports) for m in modules_of(rooms, texts))


def test_planted_late_import_is_allowed_behind_help():
    texts = sources()
    texts["flexgen.cli.main"] += "\ndef late():\n    import casadi\n"
    assert "casadi" not in reached("flexgen.cli.main", all_imports(texts))


def emission_modules(imports: Iterable[Import], known: Collection[str]) -> set[str]:
    """All modules that writing a library can import, late imports and names in texts included.

    Not the front room, whose names are those of all rooms.
    """
    graph: dict[str, set[str]] = {}
    for found in inner(imports):
        graph.setdefault(found.module, set()).add(found.target)
    caller = module_name(f"flexgen/{CALLER}")
    todo = {caller, *(module for module in known if f"{module}.".startswith(f"{EMISSION}."))}
    seen = {"flexgen"}
    while todo:
        module = todo.pop()
        seen.add(module)
        todo |= {*graph.get(module, ()), module.rpartition(".")[0]} - seen
    return seen - {"flexgen"}


def test_the_digest_of_a_library_covers_all_that_the_emission_imports() -> None:
    """Against the imports in the syntax trees; more files would only make libraries again."""
    texts = sources()
    expected = emission_modules(all_imports(texts), texts)
    covered = emission_files(ROOT / "flexgen")
    python = {module_name(f"flexgen/{file}") for file in covered if file.endswith(".py")}
    assert python >= expected and len(python - expected) <= 3
    fixed = {f"clib/{path.name}" for path in (ROOT / "flexgen" / "clib").glob("*.[ch]")}
    assert len(fixed) > 20 and fixed == {file for file in covered if not file.endswith(".py")}
    packages = {
        found.target.partition(".")[0] for found in all_imports(texts) if found.module in expected
    }
    # readers of XML and the number of threads do not affect a text
    others = packages - sys.stdlib_module_names - {"flexgen", "defusedxml", "threadpoolctl"}
    assert others == set(NUMERICAL)
    planted = texts | {
        "flexgen.codegen.motor_constants": 'def f():\n    __import__("flexgen.paths.jets")\n'
    }
    assert "flexgen.paths.jets" in emission_modules(all_imports(planted), planted) - python
