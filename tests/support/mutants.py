"""Mutants of a room: a changed sign, operator, condition, order or unit; does a quick test fail?

    python tests/support/mutants.py numerics --count 200 --seed 1
    python tests/support/mutants.py numerics --modules riccati --list

The tests of a mutant are the quick tests in files that import its module, and those of the
folder ``tests/ROOM``; of them, the ones that reach its statement, the shortest first. Mutants
that no test reaches survive, as do those where all tests pass. The source is changed in a copy
only; `mutant_session` runs the tests there.

Named constants, bounds of loops, defaults, messages of errors and annotations are not changed.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# The quick tests, as `make test` chooses them.
QUICK = "not slow and not full and not robots and not fuzz"
OPPOSITE: dict[type[ast.cmpop], str] = {
    ast.Lt: ">=",
    ast.LtE: ">",
    ast.Gt: "<=",
    ast.GtE: "<",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
OTHER: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.Pow: "*",
}
# Their results do not depend on the order of the arguments, or another order fails at once.
SYMMETRIC = {
    *("min", "max", "minimum", "maximum", "fmin", "fmax", "hypot", "gcd", "add", "multiply"),
    *("allclose", "isclose", "array_equal", "logical_and", "logical_or", "isinstance", "cast"),
    *("getattr", "hasattr", "setattr", "issubclass", "clip"),
}
# Functions that only convert a unit, and factors that do.
CONVERSIONS = {"degrees", "radians", "deg2rad", "rad2deg"}
FACTORS = {1e-9, 1e-6, 1e-3, 60.0, 100.0, 180.0, 360.0, 1e3, 1e6, 1e9}
BOUNDS = {"range", "islice"}
# Of the repository: history, environment, and what was built.
NOT_COPIED = {".git", ".venv", "build", "dist", "reports"}


@dataclass(frozen=True)
class Mutant:
    """One change of a file.

    Attributes
    ----------
    file : str
        Path relative to the repository.
    kind : str
        ``sign``, ``operator``, ``condition``, ``order`` or ``unit``.
    line, last : int
        First and last line of the statement, of its head where it has a body.
    begin, end : int
        Bytes of the file that are replaced.
    before, after : str
        Old and new text.
    function : bool
        Whether the statement is in a function.
    """

    file: str
    kind: str
    line: int
    last: int
    begin: int
    end: int
    before: str
    after: str
    function: bool

    def applied(self, text: str) -> str:
        """The text of the file with the change."""
        data = text.encode()
        return (data[: self.begin] + self.after.encode() + data[self.end :]).decode()


def _call_name(node: ast.AST) -> str:
    """Last part of the name of a called function; empty for other expressions."""
    called = getattr(node, "func", None)
    return getattr(called, "attr", getattr(called, "id", ""))


def _is_text(node: ast.expr) -> bool:
    """Whether an operand is a literal text or list: other operators fail at once there."""
    if isinstance(node, ast.BinOp):
        return _is_text(node.left) or _is_text(node.right)
    literal = isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
    return literal or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp)


def _factor(node: ast.expr) -> str | None:
    """Replacement of a factor between two units; None for other operands."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return "1.0" if float(node.value) in FACTORS else None
    if isinstance(node, ast.Attribute) and node.attr == "pi":
        return "180.0"
    return None


def _of_operator(node: ast.BinOp) -> Iterator[tuple[str, ast.AST, str]]:
    left = ast.unparse(node.left)
    right = ast.unparse(node.right)
    if isinstance(node.op, ast.MatMult):
        yield "order", node, f"(({right}) @ ({left}))"
    if type(node.op) not in OTHER or _is_text(node):
        return
    kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "operator"
    yield kind, node, f"(({left}) {OTHER[type(node.op)]} ({right}))"
    if isinstance(node.op, ast.Mult | ast.Div):
        for part in (node.left, node.right):
            new = _factor(part)
            if new is not None:
                yield "unit", part, new


def _of_call(node: ast.Call) -> Iterator[tuple[str, ast.AST, str]]:
    name = _call_name(node)
    if name in CONVERSIONS and len(node.args) == 1:
        yield "unit", node, f"({ast.unparse(node.args[0])})"
    if name in SYMMETRIC or any(isinstance(x, ast.Starred) for x in node.args):
        return
    for k in range(len(node.args) - 1):
        one, other = node.args[k : k + 2]
        if _is_text(one) or _is_text(other) or ast.dump(one) == ast.dump(other):
            continue
        changed = [*node.args[:k], other, one, *node.args[k + 2 :]]
        yield "order", node, ast.unparse(ast.Call(node.func, changed, node.keywords))


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST, str]]:
    """Kind, changed node and new text of each change of an expression or statement."""
    if isinstance(node, ast.BinOp):
        yield from _of_operator(node)
    elif isinstance(node, ast.Call):
        yield from _of_call(node)
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        left = ast.unparse(node.left)
        right = ast.unparse(node.comparators[0])
        yield "condition", node, f"({left} {OPPOSITE[type(node.ops[0])]} {right})"
    elif isinstance(node, ast.BoolOp):
        word = " or " if isinstance(node.op, ast.And) else " and "
        yield "condition", node, "(" + word.join(f"({ast.unparse(x)})" for x in node.values) + ")"
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        kind = "condition" if isinstance(node.op, ast.Not) else "sign"
        yield kind, node, f"({ast.unparse(node.operand)})"
    elif isinstance(node, ast.AugAssign) and type(node.op) in OTHER and not _is_text(node.value):
        text = f"{ast.unparse(node.target)} {OTHER[type(node.op)]}= {ast.unparse(node.value)}"
        yield "operator", node, text
    elif isinstance(node, ast.If | ast.IfExp | ast.comprehension):
        tests = node.ifs if isinstance(node, ast.comprehension) else [node.test]
        for test in tests:
            if not isinstance(test, ast.Compare | ast.BoolOp | ast.UnaryOp):
                yield "condition", test, f"(not ({ast.unparse(test)}))"


def _is_constant(node: ast.AST) -> bool:
    """Whether a statement gives a named constant its value."""
    if isinstance(node, ast.AnnAssign):
        targets = [node.target]
    elif isinstance(node, ast.Assign):
        targets = node.targets
    else:
        return False
    names = [x.id for target in targets for x in ast.walk(target) if isinstance(x, ast.Name)]
    return bool(names) and all(name == name.upper() for name in names)


def _left_out(node: ast.AST) -> bool:
    """Whether nothing of a node is changed: texts, constants, messages, bounds of loops."""
    if isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert) or _is_constant(node):
        return True
    if isinstance(node, ast.ClassDef) and node.name.endswith("Tuning"):
        return True
    if isinstance(node, ast.Call) and _call_name(node) in BOUNDS:
        return True
    words = ("TYPE_CHECKING", "__name__ == '__main__'")
    return isinstance(node, ast.If) and ast.unparse(node.test) in words


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """The parts of a node that are searched for changes."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "defaults", "kw_defaults"):
            continue
        if isinstance(node, ast.While) and name == "test":
            continue
        for part in value if isinstance(value, list) else [value]:
            if isinstance(part, ast.AST):
                yield part


def _head(node: ast.stmt) -> tuple[int, int]:
    """First and last line of a statement, or of what stands before its body."""
    body = getattr(node, "body", None)
    last = node.end_lineno or node.lineno
    return node.lineno, max(node.lineno, body[0].lineno - 1) if body else last


def _walk(
    node: ast.AST, head: tuple[int, int], inside: bool
) -> Iterator[tuple[ast.AST, tuple[int, int], bool]]:
    """All nodes that are searched, the lines of their statement, and whether a function has it."""
    if _left_out(node):
        return
    if isinstance(node, ast.stmt):
        head = _head(node)
    yield node, head, inside
    inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    for part in _parts(node):
        yield from _walk(part, head, inside)


def mutants_of(text: str, file: str = "module.py") -> list[Mutant]:
    """All mutants of the text of a module."""
    starts = [0]
    for row in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(row.encode()))
    found = []
    data = text.encode()
    for node, head, inside in _walk(ast.parse(text), (1, 1), False):
        for kind, part, after in _changes(node):
            begin = starts[part.lineno - 1] + part.col_offset  # type: ignore[attr-defined]
            end = starts[part.end_lineno - 1] + part.end_col_offset  # type: ignore[attr-defined]
            before = data[begin:end].decode()
            found.append(Mutant(file, kind, *head, begin, end, before, after, inside))
    return found


def files_of(room: str, modules: Iterable[str] = ()) -> list[Path]:
    """The modules of a room, or those of these names."""
    names = set(modules)
    files = sorted((ROOT / "flexgen" / room).rglob("*.py"))
    return [path for path in files if not names or path.stem in names]


def drawn(files: Iterable[Path], count: int, seed: int) -> list[Mutant]:
    """Mutants of statements drawn at random, one each; all statements have the same
    probability.
    """
    chance = random.Random(seed)
    places: dict[tuple[str, int], list[Mutant]] = {}
    for path in files:
        file = path.relative_to(ROOT).as_posix()
        for mutant in mutants_of(path.read_text(encoding="utf-8"), file):
            places.setdefault((file, mutant.line), []).append(mutant)
    keys = sorted(places)
    return [chance.choice(places[key]) for key in chance.sample(keys, min(count, len(keys)))]


def imported(text: str) -> set[str]:
    """Dotted names of all modules and names that a file imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def files_with_tests(mutants: Iterable[Mutant], room: str) -> list[str]:
    """The files that hold the tests of these mutants."""
    files = {mutant.file.removesuffix(".py").removesuffix("/__init__") for mutant in mutants}
    modules = {file.replace("/", ".") for file in files}
    return [
        path.relative_to(ROOT).as_posix()
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
        if path.parent.name == room or modules & imported(path.read_text(encoding="utf-8"))
    ]


def run(mutants: list[Mutant], tests: list[str], folder: Path) -> subprocess.Popen[str]:
    """Start the tests of mutants in a copy of the repository, which is made in this folder."""
    copy = folder / "copy"
    copy.mkdir()
    for part in sorted(ROOT.iterdir()):
        if part.name in NOT_COPIED or part.name.endswith("_cache"):
            continue
        if part.is_dir():
            shutil.copytree(part, copy / part.name, symlinks=True)
        else:
            shutil.copy2(part, copy / part.name)
    (copy / "mutants.json").write_text(json.dumps([asdict(mutant) for mutant in mutants]))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p"]
    command += ["mutant_session", "-m", QUICK, *tests]
    there = {
        **os.environ,
        "PYTHONPATH": f"{copy}{os.pathsep}{copy / 'tests' / 'support'}",
        "MUTANTS": str(copy / "mutants.json"),
        "OPENBLAS_NUM_THREADS": "1",
    }
    return subprocess.Popen(command, cwd=copy, env=there, stdout=subprocess.PIPE, text=True)


def arguments() -> argparse.ArgumentParser:
    """The options of the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("room", help="folder of flexgen/")
    parser.add_argument("--modules", nargs="+", default=(), help="only these of the room")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1, help="each runs all tests once first")
    parser.add_argument("--tests", nargs="+", help="these files instead of those of the room")
    parser.add_argument("--list", action="store_true", help="print the mutants, run nothing")
    return parser


def main() -> None:
    """Print each mutant that survives, and the share of those killed."""
    given = arguments().parse_args()
    mutants = drawn(files_of(given.room, given.modules), given.count, given.seed)
    if given.list:
        for mutant in mutants:
            print(f"{mutant.kind} {mutant.file}:{mutant.line}: {mutant.before} -> {mutant.after}")
        return
    tests = given.tests or files_with_tests(mutants, given.room)
    print(f"{len(mutants)} mutants, {len(tests)} files of tests", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for k in range(given.workers):
            place = Path(folder) / str(k)
            place.mkdir()
            runs.append(run(mutants[k :: given.workers], tests, place))
        killed = 0
        for each in runs:
            for line in each.stdout or ():
                killed += line.startswith("killed")
                if line.startswith(("SURVIVES", "FAILS", "ERROR")):
                    print(line, end="", flush=True)
            each.wait()
    print(f"{killed} of {len(mutants)} killed, {100 * killed / max(1, len(mutants)):.0f} %")


if __name__ == "__main__":
    main()
