"""Mutants: one changed operator, constant or condition on a line drawn at random; does a quick
test fail?

    python tests/support/mutants.py --count 200 --seed 1

The quick tests run once in a copy whose lines report which test reaches them. The tests of a
mutant are those that reach its statement: all in files that name its module, then one case of each
other test function before the others, those in files that name its room first, then the shortest
first. Of a line outside functions: those that call functions which use its names, and files that
name its module, first those that have its names. Of it and of defaults in signatures: those that
compare names, helps and defaults with files and pages, too. Numbers in texts and arguments that
change no result are left out. Tests that fail without a mutant do not count. A mutant survives
where all others pass, or where there are none. The source is changed in copies only.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[2]
COMPARED = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
}
COMPARED |= {ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in"}
COMPUTED = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.MatMult: "*",
    ast.Pow: "*",
}
QUICK = "not slow and not full and not robots and not fuzz"  # `make test`
# of pages
STATED = [
    "tests/repository/test_stated_numbers.py",
    "tests/repository/test_stated_defaults.py",
    "tests/model/test_keys.py",
]
STATED += ["tests/golden/test_public_face.py"]
SILENT = {"strict", "frozen", "repr", "slots", "eq"}  # arguments that change no result
MOST_TESTS = 200
MOST_FILES = 6
# time of tests: at least; over that of the first run; of a file in it
TIMEOUT_S = 240
SLOWER = 5.0
LONG_S = 60.0
HITS = """import os
_seen = set()


def hit(number):
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    if test and (number, test) not in _seen:
        _seen.add((number, test))
        with open(os.path.join(os.environ["MUTANT_HITS"], str(os.getpid())), "a") as file:
            file.write(f"{number} {test}\\n")
"""


@dataclass(frozen=True)
class Mutant:
    """A part of a line of a file, its first and last column in bytes, and what stands there
    instead.
    """

    file: Path
    line: int
    columns: tuple[int, int]
    after: str

    @property
    def before(self) -> str:
        """What the mutant replaces."""
        line = self.file.read_text(encoding="utf-8").splitlines()[self.line - 1]
        return line.encode()[slice(*self.columns)].decode()

    @property
    def text(self) -> str:
        """The file with the mutant."""
        lines = self.file.read_text(encoding="utf-8").splitlines(keepends=True)
        line = lines[self.line - 1].encode()
        (first, last) = self.columns
        lines[self.line - 1] = (line[:first] + self.after.encode() + line[last:]).decode()
        return "".join(lines)


def _silent(tree: ast.Module) -> set[int]:
    """Constants that change no result, by their `id`."""
    heads = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    heads += [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.keyword) and node.arg in SILENT
    ]
    return {
        id(node) for head in heads for node in ast.walk(head) if isinstance(node, ast.Constant)
    }


def mutants_of(file: Path) -> list[Mutant]:
    """All mutants of a file."""
    out = []
    tree = ast.parse(file.read_text(encoding="utf-8"))
    silent = _silent(tree)
    for node in ast.walk(tree):
        if id(node) in silent:
            continue
        new = None
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARED:
            left = ast.unparse(node.left)
            right = ast.unparse(node.comparators[0])
            new = f"({left} {COMPARED[type(node.ops[0])]} {right})"
        elif (
            isinstance(node, ast.BinOp)
            and type(node.op) in COMPUTED
            and not isinstance(node.left, ast.JoinedStr)
        ):
            new = f"({ast.unparse(node.left)} {COMPUTED[type(node.op)]} {ast.unparse(node.right)})"
        elif isinstance(node, ast.BoolOp):
            word = "or" if isinstance(node.op, ast.And) else "and"
            new = "(" + f" {word} ".join(f"({ast.unparse(x)})" for x in node.values) + ")"
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            new = f"({ast.unparse(node.operand)})"
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            new = str(not node.value)
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            new = f"({node.value!r} + 1)"
        if new is not None and node.lineno == node.end_lineno:  # type: ignore[attr-defined]
            columns = node.col_offset, node.end_col_offset  # type: ignore[attr-defined]
            out.append(Mutant(file, node.lineno, columns, new))  # type: ignore[attr-defined]
    return out


def _compiles(text: str) -> bool:
    try:
        compile(text, "mutant", "exec")
    except SyntaxError:
        return False
    return True


def drawn(count: int, seed: int) -> list[Mutant]:
    """Mutants on lines drawn at random, all lines that have one with the same probability."""
    chance = random.Random(seed)
    lines: dict[tuple[Path, int], list[Mutant]] = {}
    for file in sorted((ROOT / "flexgen").rglob("*.py")):
        for mutant in mutants_of(file):
            lines.setdefault((file, mutant.line), []).append(mutant)
    found = (chance.choice(lines[key]) for key in chance.sample(sorted(lines), len(lines)))
    return list(islice((mutant for mutant in found if _compiles(mutant.text)), count))


def functions_of(file: Path) -> list[ast.FunctionDef]:
    """All functions of a file."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def function_of(mutant: Mutant) -> ast.FunctionDef | None:
    """The innermost function around a mutant, its signature included; None for a line outside
    functions.
    """
    inside = [
        x for x in functions_of(mutant.file) if x.lineno <= mutant.line <= (x.end_lineno or 0)
    ]
    return max(inside, key=lambda node: node.lineno, default=None)


def names_of(mutant: Mutant) -> set[str]:
    """The names which the statement of a mutant assigns."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(mutant.file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.lineno <= mutant.line <= (
            node.end_lineno or 0
        ):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {
                x.id for target in targets for x in ast.walk(target) if isinstance(x, ast.Name)
            }
    return names


def reached_of(file: Path, number: int, function: ast.FunctionDef) -> ast.stmt:
    """The innermost statement of a function around a line that begins a line, else the first one
    of its body.
    """
    first = function.body[0]
    described = (
        isinstance(first, ast.Expr)
        and isinstance(first.value, ast.Constant)
        and len(function.body) > 1
    )
    lines = file.read_text(encoding="utf-8").splitlines()
    around = [
        node
        for part in function.body
        for node in ast.walk(part)
        if isinstance(node, ast.stmt) and node.lineno <= number <= (node.end_lineno or 0)
        if not lines[node.lineno - 1].encode()[: node.col_offset].strip()
        if not lines[node.lineno - 1].lstrip().startswith("elif")
    ]
    return max(
        around, key=lambda node: node.lineno, default=function.body[1] if described else first
    )


def users_of(mutant: Mutant) -> list[tuple[Path, ast.FunctionDef]]:
    """Functions that a mutant changes: the one around it, or those that use the names which its
    statement assigns.
    """
    function = function_of(mutant)
    if function is not None:
        return [(mutant.file, function)]
    names = names_of(mutant)
    module = ".".join(mutant.file.relative_to(ROOT).with_suffix("").parts)
    return [
        (file, function)
        for file in sorted((ROOT / "flexgen").rglob("*.py"))
        if file == mutant.file or module in file.read_text(encoding="utf-8")
        for function in functions_of(file)
        for parts in [[function.args, *function.body]]
        if any(
            getattr(x, "id", getattr(x, "attr", None)) in names
            for part in parts
            for x in ast.walk(part)
        )
    ]


def report_calls(mutants: list[Mutant], copy: Path) -> None:
    """Make the statements of the mutants in the copy, or the functions that use their names,
    report that they run.
    """
    added: dict[Path, dict[int, str]] = {}
    for number, mutant in enumerate(mutants):
        for file, function in users_of(mutant):
            first = reached_of(file, mutant.line if file == mutant.file else 0, function)
            text = file.read_text(encoding="utf-8").splitlines()[first.lineno - 1]
            if not text.encode()[: first.col_offset].strip():  # not on the line of its signature
                decorators = getattr(first, "decorator_list", [])
                place = decorators[0].lineno if decorators else first.lineno
                line = f"{' ' * first.col_offset}__import__('mutant_hits').hit({number})\n"
                lines = added.setdefault(file, {})
                lines[place] = lines.get(place, "") + line
    for file, lines in added.items():
        text = file.read_text(encoding="utf-8").splitlines(keepends=True)
        new = "".join(lines.get(number, "") + line for number, line in enumerate(text, 1))
        (copy / file.relative_to(ROOT)).write_text(new, encoding="utf-8")
    (copy / "mutant_hits.py").write_text(HITS, encoding="utf-8")


@dataclass(frozen=True)
class Calls:
    """The tests that call the function of each mutant, by its number, how long each takes [s], and
    which ones fail.
    """

    tests: dict[int, set[str]]
    seconds: dict[str, float]
    failing: set[str]


def cases_of(report: Path) -> dict[str, ElementTree.Element]:
    """The tests in a report of pytest, by their name."""
    if not report.exists():  # a test was not found
        return {}
    cases = ElementTree.parse(report).iter("testcase")
    return {
        f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}": case
        for case in cases
    }


def failing_of(report: Path) -> set[str]:
    """The tests that fail in a report of pytest."""
    return {
        test
        for test, case in cases_of(report).items()
        if {"failure", "error"} & {part.tag for part in case}
    }


def calls_of(mutants: list[Mutant], copy: Path, workers: int) -> Calls:
    """One run of the quick tests in the copy; those that fail run again, in a copy that reports no
    calls.
    """
    report_calls(mutants, copy)
    hits = copy / "hits"
    times = copy / "times.xml"
    again = copy / "again.xml"
    hits.mkdir()
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-n",
        str(workers),
        "-m",
        QUICK,
    ]
    there = {**os.environ, "PYTHONPATH": str(copy), "MUTANT_HITS": str(hits)}
    subprocess.run(
        [*command, f"--junitxml={times}"],
        cwd=copy,
        env=there,
        stdout=subprocess.DEVNULL,
        check=False,
    )
    found: dict[int, set[str]] = {}
    for file in hits.iterdir():
        for line in file.read_text(encoding="utf-8").splitlines():
            number, _, test = line.partition(" ")
            found.setdefault(int(number), set()).add(test)
    for file in {file for mutant in mutants for file, _ in users_of(mutant)}:
        shutil.copy(file, copy / file.relative_to(ROOT))
    seconds = {test: float(case.get("time", 0.0)) for test, case in cases_of(times).items()}
    failing = failing_of(times)
    if failing:
        there = {**os.environ, "PYTHONPATH": str(copy)}
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"--junitxml={again}",
        ]
        subprocess.run(
            [*command, *sorted(failing)],
            cwd=copy,
            env=there,
            stdout=subprocess.DEVNULL,
            check=False,
        )
        failing -= cases_of(again).keys() - failing_of(again)  # those that pass now
    return Calls(found, seconds, failing)


def tests_of(mutant: Mutant, number: int, calls: Calls) -> list[str]:
    """The tests of a mutant."""
    module = ".".join(mutant.file.relative_to(ROOT).with_suffix("").parts)
    room = ".".join(module.split(".")[:2])
    texts = {
        path: path.read_text(encoding="utf-8")
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
    }
    far = {
        path.relative_to(ROOT).as_posix(): (module not in text, room not in text)
        for path, text in texts.items()
    }
    called = sorted(calls.tests.get(number, set()), key=lambda test: calls.seconds.get(test, 1.0))
    # the shortest of each function
    first = set({test.partition("[")[0]: test for test in reversed(called)}.values())
    order = {test: far[test.partition("::")[0]] for test in called}
    called = sorted(called, key=lambda test: (order[test][0] and test not in first, order[test]))[
        :MOST_TESTS
    ]
    function = function_of(mutant)
    if function is not None:
        return called + STATED * (mutant.line < function.body[0].lineno)
    named = {name: any(x in texts[ROOT / name] for x in names_of(mutant)) for name in far}
    near = [name for name, (_, other) in far.items() if not other]
    near = sorted(near, key=lambda name: (far[name][0], not named[name]))[:MOST_FILES]
    return called + STATED + near


def survives(
    mutant: Mutant, tests: list[str], failing: set[str], copy: Path, timeout_s: float
) -> bool:
    """Whether these tests, without those that fail anyway, pass with the mutant in the copy."""
    if not tests:
        return True
    place = copy / mutant.file.relative_to(ROOT)
    place.write_text(mutant.text, encoding="utf-8")
    try:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-p",
            "no:cacheprovider",
            "-m",
            QUICK,
            *tests,
        ]
        command += [f"--deselect={test}" for test in sorted(failing)]
        there = {**os.environ, "PYTHONPATH": str(copy)}
        done = subprocess.run(
            command, cwd=copy, env=there, capture_output=True, timeout=timeout_s, check=False
        )
        return done.returncode in (0, 5)
    except subprocess.TimeoutExpired:
        return False  # it hangs
    finally:
        shutil.copy(mutant.file, place)


def main() -> None:
    """Print the tests that fail without a mutant, then each mutant and the share that is
    killed.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--workers", type=int, default=2, help="of the run that finds the tests of each mutant"
    )
    given = parser.parse_args()
    # a shell in the background has tests ignore it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    killed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        hidden = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=hidden, symlinks=True)
        mutants = drawn(given.count, given.seed)
        print("one run of the quick tests, to find the tests of each mutant", flush=True)
        calls = calls_of(mutants, copy, given.workers)
        for test in sorted(calls.failing):
            print(f"fails without a mutant: {test}", flush=True)
        for number, mutant in enumerate(mutants, 1):
            tests = tests_of(mutant, number - 1, calls)
            expected = sum(calls.seconds.get(test, LONG_S) for test in tests)
            alive = survives(mutant, tests, calls.failing, copy, TIMEOUT_S + SLOWER * expected)
            killed += not alive
            place = f"{mutant.file.relative_to(ROOT)}:{mutant.line}"
            verdict = f"SURVIVES {len(tests)} tests" if alive else "killed"
            print(f"{verdict} {place}: {mutant.before} -> {mutant.after}", flush=True)
            print(f"  {killed} of {number} killed, {100 * killed / number:.0f} %", flush=True)


if __name__ == "__main__":
    main()
