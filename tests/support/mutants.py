"""Mutants: one changed operator, constant or condition on a line drawn at random; do the quick tests of its room fail?

    python tests/support/mutants.py --count 200 --seed 1

The tests of a room are the files that name its module, then those that name another module of its room. A mutant
survives where all of them pass, or where there is none. The source is changed in a copy only.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMPARED = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==", ast.Is: "is not"}
COMPARED |= {ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in"}
COMPUTED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.MatMult: "*", ast.Pow: "*"}
QUICK = "not slow and not full and not robots and not fuzz"  # `make test`
MOST_FILES, TIMEOUT_S = 12, 240


@dataclass(frozen=True)
class Mutant:
    """A part of a line of a file, its first and last column in bytes, and what stands there instead."""

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
        line, (first, last) = lines[self.line - 1].encode(), self.columns
        lines[self.line - 1] = (line[:first] + self.after.encode() + line[last:]).decode()
        return "".join(lines)


def mutants_of(file: Path) -> list[Mutant]:
    """All mutants of a file."""
    out = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        new = None
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARED:
            left, right = ast.unparse(node.left), ast.unparse(node.comparators[0])
            new = f"({left} {COMPARED[type(node.ops[0])]} {right})"
        elif isinstance(node, ast.BinOp) and type(node.op) in COMPUTED and not isinstance(node.left, ast.JoinedStr):
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


def tests_of(file: Path) -> list[str]:
    """The test files of a module, then those of its room."""
    module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
    room = ".".join(module.split(".")[:2])
    texts = {path: path.read_text(encoding="utf-8") for path in sorted((ROOT / "tests").rglob("test_*.py"))}
    own = [path for path, text in texts.items() if module in text]
    near = [path for path, text in texts.items() if room in text and path not in own]
    return [str(path.relative_to(ROOT)) for path in (*own, *near)[:MOST_FILES]]


def survives(mutant: Mutant, copy: Path) -> bool:
    """Whether the quick tests pass with the mutant in the copy."""
    tests = tests_of(mutant.file)
    if not tests:
        return True
    place = copy / mutant.file.relative_to(ROOT)
    place.write_text(mutant.text, encoding="utf-8")
    try:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", QUICK, *tests]
        there = {**os.environ, "PYTHONPATH": str(copy)}
        done = subprocess.run(command, cwd=copy, env=there, capture_output=True, timeout=TIMEOUT_S, check=False)
        return done.returncode in (0, 5)
    except subprocess.TimeoutExpired:
        return False  # it hangs
    finally:
        shutil.copy(mutant.file, place)


def main() -> None:
    """Print each mutant and the share that is killed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    killed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        hidden = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=hidden, symlinks=True)
        for number, mutant in enumerate(drawn(given.count, given.seed), 1):
            alive = survives(mutant, copy)
            killed += not alive
            place = f"{mutant.file.relative_to(ROOT)}:{mutant.line}"
            print(f"{'SURVIVES' if alive else 'killed'} {place}: {mutant.before} -> {mutant.after}", flush=True)
            print(f"  {killed} of {number} killed, {100 * killed / number:.0f} %", flush=True)


if __name__ == "__main__":
    main()
