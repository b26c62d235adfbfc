"""The house keeps its shape: floors, no import circles, rooms without CasADi, nothing heavy behind --help.

Everything is read from the source by a walk over its syntax tree; nothing is imported. A planted bug for every rule
shows that the walk would see it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# A room (module or package below flexgen) imports from its own room and from rooms on lower floors; rooms on the ground
# floor may use each other.
FLOORS = {
    "": 0,
    "errors": 0,
    "ports": 0,
    "trajectory": 0,
    "numerics": 1,
    "expressions": 1,
    "clib": 1,
    "model": 1,
    "runtime": 1,
    "mechanics": 2,
    "recursion": 3,
    "closed_form": 3,
    "dae": 3,
    "simulation": 3,
    "analysis": 4,
    "codegen": 4,
    "build": 5,
    "paths": 5,
    "inversion": 6,
    "identify": 7,
    "control": 7,
    "export": 7,
    "sweeps": 7,
    "plots": 8,
    "reports": 9,
    "cli": 10,
    "__main__": 11,
}

WITHOUT_CASADI = ["errors", "ports", "trajectory", "model", "clib", "runtime", "cli", "__main__"]
INSTANT = ["cli", "__main__"]  # behind --help: the standard library only
HEAVY = {"casadi", "numpy", "scipy", "sympy", "matplotlib", "mujoco"}
RUNTIME_NEEDS = {"runtime", "errors", "ports", ""}


@dataclass(frozen=True)
class Import:
    """``module`` imports ``target`` (dotted names); ``late``: inside a function, or for type checking only."""

    module: str
    target: str
    line: int
    late: bool
    typing: bool


def imports_of(module: str, text: str, known: Iterable[str]) -> list[Import]:
    """All imports of a module's source."""
    modules = set(known)
    out: list[Import] = []

    def walk(node: ast.AST, late: bool, typing: bool) -> None:
        if isinstance(node, ast.Import):
            out.extend(Import(module, alias.name, node.lineno, late, typing) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: relative import"
            assert node.module is not None
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                out.append(Import(module, full if full in modules else node.module, node.lineno, late, typing))
        for child in ast.iter_child_nodes(node):
            inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            guarded = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test) and child in node.body
            walk(child, late or inside or guarded, typing or guarded)

    walk(ast.parse(text), False, False)
    return out


def sources(root: Path = ROOT) -> dict[str, str]:
    """Text of every module of flexgen by its dotted name."""
    out = {}
    for path in sorted((root / "flexgen").rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path.read_text(encoding="utf-8")
    return out


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
        here, there = room(found.module), room(found.target)
        if here == there or not there:
            continue
        if FLOORS[there] > FLOORS[here] or (FLOORS[there] == FLOORS[here] and FLOORS[here] > 0):
            out.append(f"{found.module}:{found.line} imports {found.target}")
    return out


def circles(imports: Iterable[Import]) -> list[list[str]]:
    """Circles among the modules, late imports included (those for types only are left out)."""
    graph: dict[str, set[str]] = {}
    for found in inner(imports):
        if not found.typing and found.target != found.module:
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
    """All that importing a module imports, outside packages by their first name; parents of packages included."""
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
    return {module if module.startswith("flexgen") else module.partition(".")[0] for module in seen}


def modules_of(names: Iterable[str], texts: dict[str, str]) -> list[str]:
    return [module for module in texts if room(module) in set(names) and room(module)]


# --- the rules --------------------------------------------------------------------------------------------------------
def test_every_room_has_a_floor():
    unknown = {room(module) for module in sources()} - set(FLOORS)
    assert not unknown, f"add to FLOORS: {sorted(unknown)}"


def test_imports_go_down():
    assert floor_violations(all_imports(sources())) == []


def test_no_circles():
    assert circles(all_imports(sources())) == []


def test_rooms_without_casadi():
    texts = sources()
    imports = all_imports(texts)
    assert [m for m in modules_of(WITHOUT_CASADI, texts) if "casadi" in reached(m, imports)] == []


def test_nothing_heavy_behind_help():
    texts = sources()
    imports = all_imports(texts)
    assert {m: sorted(HEAVY & reached(m, imports)) for m in ["flexgen", *modules_of(INSTANT, texts)]} == {
        m: [] for m in ["flexgen", *modules_of(INSTANT, texts)]
    }


def test_runtime_needs_numpy_and_the_ground_floor_only():
    texts = sources()
    imports = [Import(i.module, i.target, i.line, False, i.typing) for i in all_imports(texts)]  # late ones too
    needs = reached("flexgen.runtime", imports)
    assert {room(m) for m in needs if m.startswith("flexgen")} <= RUNTIME_NEEDS
    assert needs & HEAVY == {"numpy"}


def test_packages_of_the_wheel_are_those_of_the_tree():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = [path.parent for path in (ROOT / "flexgen").rglob("__init__.py")]
    expected = {".".join(folder.relative_to(ROOT).parts) for folder in folders} | {"flexgen.models"}
    assert set(settings["packages"]) == expected
    assert settings["package-dir"] == {"flexgen.models": "models"}


def test_import_of_the_command_line_loads_nothing_heavy():
    code = "import sys, flexgen.cli.main; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert not HEAVY & set(out.split())
    assert "argparse" in out.split()


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
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert out == ""


# --- planted bugs -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("flexgen.model.reader", "from flexgen.mechanics.equations import derive"),
        ("flexgen.mechanics.equations", "def late():\n    import flexgen.inversion.solve"),
        ("flexgen.build.generate", "from flexgen import inversion"),
        ("flexgen.runtime", "from flexgen.codegen import spec"),
        ("flexgen.analysis.linear", "from flexgen.paths.path import Path"),
        ("flexgen.paths.path", "if TYPE_CHECKING:\n    from flexgen.inversion.solution import Solution"),
    ],
)
def test_planted_import_upwards_is_seen(module, line):
    texts = sources()
    texts[module] += f"\n{line}\n"
    found = floor_violations(all_imports(texts))
    assert len(found) == 1 and found[0].startswith(module)


def test_planted_circle_is_seen():
    texts = sources()
    texts["flexgen.errors"] += "\nfrom flexgen.trajectory import Trajectory\n"
    assert any({"flexgen.errors", "flexgen.trajectory"} <= set(circle) for circle in circles(all_imports(texts)))


@pytest.mark.parametrize(
    ("module", "line", "rooms"),
    [
        ("flexgen.ports", "import casadi as ca", WITHOUT_CASADI),
        ("flexgen.model", "from casadi import SX", WITHOUT_CASADI),  # a package is imported with its modules
        ("flexgen.errors", "import numpy.linalg", INSTANT),
        ("flexgen.cli.verbs", "try:\n    import scipy.linalg\nexcept ImportError:\n    pass", INSTANT),
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
