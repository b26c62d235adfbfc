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
from room_picture import graph, graph_of, picture, reduced, rows_of

from flexgen.codegen.build.source_digest import CALLER, EMISSION, NUMERICAL, emission_files

ROOT = Path(__file__).resolve().parents[2]

# Applications of the middle rooms: none imports another, and no middle room imports one.
WINGS = ("backends", "exports", "identification", "planning", "studies")

# A room (a folder of flexgen) imports from its own room and from rooms on lower floors only.
FLOORS = {
    "base": 1,
    "model": 2,
    "runtime": 2,
    "dynamics": 3,
    "analysis": 4,
    "codegen": 5,
    "paths": 6,
    "backends": 6,
    "simulation": 7,
    "inversion": 8,
    "feedback": 9,
    "identification": 10,
    "planning": 10,
    "studies": 10,
    "exports": 10,
    "views": 11,
    "cli": 12,
}
# The files next to the rooms: modules of arrays, and tables of public names, which only the
# command line imports.
FILES = {"jax": 6.5, "torch": 6.5, "": 11.5, "__main__": 13}
LEVELS = FLOORS | FILES
MOST_FLOORS = 12
# Entries of the first level of flexgen besides the rooms, and of a room.
MOST_FILES = 6
MOST_ENTRIES = 12

WITHOUT_CASADI = [
    "base.errors",
    "base.spec",
    "base.motion",
    "model",
    "codegen.clib",
    "runtime",
    "cli",
    "__main__",
]
INSTANT = ["cli", "__main__"]  # behind --help: the standard library only
HEAVY = {"casadi", "numpy", "scipy", "sympy", "matplotlib", "mujoco"}
# All that loading a library imports; a package is imported with its modules.
RUNTIME_NEEDS = {
    "",
    "base",
    "base.calls",
    "base.calls.deprecation",
    "base.calls.progress",
    "base.checks",
    "base.errors",
    "base.registry",
    "base.spec",
    "base.version",
    "runtime",
}

# Modules that import what a variable names: a name from a table that another module has handed
# down, or a user's file.
IMPORT_BY_NAME = {"flexgen", "flexgen.base.registry"}

MEASURED = ["flexgen", "benchmarks", "examples"]

MOST = 8
# Functions and methods of flexgen with more parameters (without self) than `MOST`; each number may
# only fall, and new functions take a record of options. Those of verbs are the options of the
# command line, see test_former_names.py.
PARAMETERS = {
    "studies/scenarios/tune.py tune": 10,  # a verb
    "studies/scenarios/tune_cascade.py tune_cascade": 14,  # a verb: the loop of the verb control
    "identification/poses/calibrate.py calibrate": 10,  # a verb
    "exports/fmu/export.py export_fmu": 12,  # a verb
    "exports/ros2/export.py export_ros2": 10,  # a verb
    # a verb; numbers and exponents of elements are what gears differ in
    "identification/gears/identify.py identify_gears": 13,
    # a verb; records, spring, elements and columns are what tests differ in
    "identification/gears/identify_spring.py identify_spring": 13,
    "identification/experiments/plan.py excite": 20,  # a verb
    "identification/responses/graybox.py identify": 19,  # a verb; responses that are held out, too
    "identification/motions/motion_fit.py fit_motion": 11,  # a verb
    # a verb; the force of a process is data of the problem, as the move is
    "inversion/solve.py solve": 19,
    "codegen/build/generate.py generate": 15,  # a verb
    # robots, drives and noise are given apart by five callers with other choices
    "feedback/loop/closed_loop.py __init__": 16,
    # a verb; two for the force that acts and the one that the feedforward assumes
    "feedback/loop/control.py control": 19,
    "feedback/loop/case.py control_case": 14,  # the options of the verb control but the controller
    "feedback/observers/constant_gain.py __init__": 9,  # a public class with keywords
    "feedback/observers/extended_kalman.py __init__": 9,  # a public class with keywords
    "planning/learning/learn.py learn": 15,  # a verb
    # a verb; the force is data of the problem, as the move is
    "planning/fastest/minimum_time.py fastest": 10,
    "planning/optimal/problem.py solve": 9,  # a method of a public class
    # a public class; the arguments are the entries of the manifest
    "runtime/calls.py __init__": 11,
    "runtime/library.py stream": 13,  # a method of a public class
    # the members of the samples and of the options in C
    "runtime/inversion/limited_inversion.py __call__": 27,
    # the members of the samples and of the options in C
    "runtime/inversion/path_inversion.py __call__": 16,
    "runtime/streams/stream.py __init__": 15,  # the options of `Library.stream`
    "feedback/positions/command.py command_positions": 10,  # a verb
    "simulation/simulate.py simulate": 11,  # a verb
    "studies/sweeps/sweep.py sweep": 9,  # a verb
}

# Modules, without packages, loaded by `flexgen.solve`, before a call, and by `flexgen --version`.
MODULES_OF_SOLVE = 89
MODULES_OF_VERSION = 6

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
    """Facts of a source that the rules use.

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
        if LEVELS[there] >= LEVELS[here]:
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
    return [module for module in texts if any(is_below(module, name) for name in names)]


def is_below(module: str, name: str) -> bool:
    """Whether a module is the one of this name below flexgen, or in the package of this name."""
    return f"{module}.".startswith(f"flexgen.{name}." if name else "flexgen.")


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
    heavy = HEAVY | {"flexgen.base.numerics"}
    return [
        f"{found.module}:{found.line} imports {found.target}"
        for found in imports
        if room(found.module) == "cli"
        and any(f"{found.target}.".startswith(f"{name}.") for name in heavy)
    ]


# --- the rules -----------------------------------------------------------------------------------
def is_kept(path: Path) -> bool:
    """Whether a file or folder is more than what an interpreter or an editor leaves."""
    if path.name[0] == "." or path.name == "__pycache__":
        return False
    return not path.is_dir() or any(map(is_kept, path.iterdir()))


def first_level(root: Path) -> tuple[set[str], set[str]]:
    """Folders and files of a folder."""
    kept = list(filter(is_kept, root.iterdir()))
    folders = {path.name for path in kept if path.is_dir()}
    return folders, {path.name for path in kept} - folders


def crowded_rooms(root: Path) -> list[str]:
    """Rooms with more than `MOST_ENTRIES` folders and modules on their first level."""
    found = []
    for name in sorted(first_level(root)[0]):
        folders, files = first_level(root / name)
        modules = [file for file in files if file.endswith(".py") and file != "__init__.py"]
        if len(folders) + len(modules) > MOST_ENTRIES:
            found.append(name)
    return found


def test_the_first_level_is_the_rooms_and_six_files():
    folders, files = first_level(ROOT / "flexgen")
    assert folders == set(FLOORS)
    assert len(files) <= MOST_FILES
    assert max(FLOORS.values()) <= MOST_FLOORS


def test_the_first_level_of_a_room_is_seen_at_a_glance():
    assert crowded_rooms(ROOT / "flexgen") == []


def test_a_planted_crowded_room_is_seen(tmp_path):
    (tmp_path / "room").mkdir()
    for k in range(MOST_ENTRIES + 1):
        assert crowded_rooms(tmp_path) == []
        (tmp_path / "room" / f"module{k}.py").touch()
    assert crowded_rooms(tmp_path) == ["room"]


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
    inside = {m.partition(".")[2] for m in needs if m.partition(".")[0] == "flexgen"}
    allowed = [name for name in RUNTIME_NEEDS if name not in ("", "base", "base.calls")]
    assert {
        m
        for m in inside - RUNTIME_NEEDS
        if not any(is_below(f"flexgen.{m}", name) for name in allowed)
    } == set()
    assert needs & HEAVY == {"numpy"}


def test_packages_of_the_wheel_are_those_of_the_tree():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]
    folders = [path.parent for path in (ROOT / "flexgen").rglob("__init__.py")]
    expected = {".".join(folder.relative_to(ROOT).parts) for folder in folders} | {
        "flexgen.model.shipped"
    }
    assert set(settings["packages"]) == expected
    assert settings["package-dir"] == {"": "."}  # an editable installation without an import hook
    assert (ROOT / "flexgen" / "model" / "shipped").resolve() == ROOT / "models"


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


def with_code(names: Iterable[str]) -> set[str]:
    """Those that are not packages with a docstring only."""
    texts = sources()
    return {name for name in names if len(ast.parse(texts[name]).body) > 1}


def modules_loaded(code: str) -> set[str]:
    """The modules of flexgen that a new interpreter has loaded after these lines."""
    lines = f"import sys\n{code}\nprint('\\n' + ' '.join(name for name in sys.modules))"
    out = subprocess.run(
        [sys.executable, "-c", lines], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    return {name for name in out.splitlines()[-1].split() if name.partition(".")[0] == "flexgen"}


def test_solve_loads_few_modules_as_counted_from_the_source():
    # takes long
    found = modules_loaded(
        "import flexgen; flexgen.solve; assert 'scipy.signal' not in sys.modules"
    )
    reached_here = reached("flexgen.inversion.solve", all_imports(sources()))
    assert found == {name for name in reached_here if name.partition(".")[0] == "flexgen"}
    assert len(with_code(found)) <= MODULES_OF_SOLVE, (
        "import what only some calls need in the function that needs it"
    )


def test_version_loads_no_verb_and_describe_no_solver():
    version = modules_loaded("from flexgen.cli.main import main; main(['--version'])")
    described = modules_loaded("from flexgen.cli.main import main; main(['describe', 'elbow'])")
    assert len(with_code(version)) <= MODULES_OF_VERSION and "flexgen.cli.parser" not in version
    # of inversion and simulation only the names of methods and of holds, for the options of solve
    assert not {"codegen", "analysis"} & {room(name) for name in described}
    assert not described & {"flexgen.inversion.solve", "flexgen.simulation.simulate"}


def test_planted_import_is_in_the_count_of_solve():
    texts = sources()
    texts["flexgen.base.numerics.evaluate"] += "\nfrom flexgen.codegen.emission.emit import emit\n"
    found = reached("flexgen.inversion.solve", all_imports(texts)) & set(texts)
    assert len(with_code(found)) > MODULES_OF_SOLVE


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
        ("flexgen.model.reader", "from flexgen.dynamics.mechanics.equations import derive"),
        (
            "flexgen.dynamics.mechanics.equations",
            "def late():\n    import flexgen.inversion.solve",
        ),
        ("flexgen.codegen.build.generate", "from flexgen import inversion"),
        ("flexgen.runtime", "from flexgen.codegen.emission import spec"),
        ("flexgen.analysis.linear", "from flexgen.paths.path import Path"),
        (
            "flexgen.paths.path",
            "if TYPE_CHECKING:\n    from flexgen.inversion.solution import Solution",
        ),
        ("flexgen.paths.path", "PLOT = 'flexgen.views.plots.solution'"),
        (
            "flexgen.paths.path",
            "PLOT = {'Path.plot': 'flexgen.views.plots.solution:plot_solution'}",
        ),
        (
            "flexgen.paths.path",
            "def late():\n    return import_module('flexgen.views.plots.solution').plot_solution",
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
        (
            "flexgen.base.errors",
            "from flexgen.base.motion.trajectory import Trajectory",
            "flexgen.base.motion.trajectory",
        ),
        (
            "flexgen.dynamics.mechanics.outputs",
            "if TYPE_CHECKING:\n    from flexgen.dynamics.mechanics.equations import Equations",
            "flexgen.dynamics.mechanics.equations",
        ),
        (
            "flexgen.codegen.recursion.arm",
            "def late():\n    from flexgen.codegen.recursion.functions import fast_function",
            "flexgen.codegen.recursion.functions",
        ),
        (
            "flexgen.dynamics.mechanics.outputs",
            "TABLE = {'derive': 'flexgen.dynamics.mechanics.equations'}",
            "flexgen.dynamics.mechanics.equations",
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
    assert len(sibling_violations(imports)) == (one != other)
    upwards = one != other and FLOORS[other] >= FLOORS[one]
    assert len(floor_violations(imports)) == upwards


@pytest.mark.parametrize(
    ("module", "line", "rooms"),
    [
        ("flexgen.base.spec.ports", "import casadi as ca", WITHOUT_CASADI),
        # a package is imported with its modules
        ("flexgen.model", "from casadi import SX", WITHOUT_CASADI),
        ("flexgen.base.errors", "import numpy.linalg", INSTANT),
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
    folder = "codegen/clib"
    fixed = {f"{folder}/{path.name}" for path in (ROOT / "flexgen" / folder).glob("*.[ch]")}
    assert len(fixed) > 20 and fixed == {file for file in covered if not file.endswith(".py")}
    packages = {
        found.target.partition(".")[0] for found in all_imports(texts) if found.module in expected
    }
    # readers of XML and the number of threads do not affect a text
    others = packages - sys.stdlib_module_names - {"flexgen", "defusedxml", "threadpoolctl"}
    assert others == set(NUMERICAL)
    planted = texts | {
        "flexgen.codegen.emission.motor_constants": (
            'def f():\n    __import__("flexgen.paths.geometry.jets")\n'
        )
    }
    assert (
        "flexgen.paths.geometry.jets" in emission_modules(all_imports(planted), planted) - python
    )
