"""Rules of the text of the code: width, one assignment a line, nesting, conditional expressions,
first words of docstrings.

Read from the syntax tree of all tracked Python files; the width also of C and C++. A planted
violation of each rule shows that the test sees it. The lists of old violations may only shrink.
"""

from __future__ import annotations

import ast
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Characters of a line: two files side by side on a screen, and the width of ruff.
WIDTH = 99
# Blocks within one another in a function: beyond these a reader loses the conditions.
DEEPEST = 4
# First words that stand in a docstring instead of the noun of the field.
VAGUE = re.compile(r"(What|How|The same)\b")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
BLOCKS = (ast.If, ast.For, ast.AsyncFor, ast.While, ast.With, ast.AsyncWith, ast.Try)
# Violations of before, by file; mend one and lower its number here.
NESTED = {
    "flexgen/base/files/atomic_files.py": 1,
    "flexgen/codegen/statements/function_text.py": 1,
    "flexgen/codegen/build/object_cache.py": 1,
    "flexgen/base/numerics/executors.py": 1,
    "flexgen/views/reports/video.py": 1,
    "flexgen/studies/sweeps/executors.py": 1,
}
CONDITIONAL = {
    "benchmarks/inversion_table.py": 1,
    "docs/reference_pages.py": 1,
    "flexgen/analysis/zero_dynamics/solvability.py": 1,
    "flexgen/analysis/zero_dynamics/zeros_along_path.py": 1,
    "flexgen/cli/parser.py": 1,
    "flexgen/cli/verbs/robot.py": 1,
    "flexgen/backends/cuda/driver.py": 1,
    "flexgen/dynamics/dae/strangeness_index.py": 2,
    "flexgen/analysis/printing/printing.py": 1,
    "flexgen/exports/fmu/description.py": 1,
    "flexgen/exports/c_code/selftest/motion.py": 1,
    "flexgen/exports/urdf/urdf.py": 2,
    "flexgen/codegen/statements/graph.py": 1,
    "flexgen/identification/motions/motion_fit.py": 2,
    "flexgen/identification/responses/parameters.py": 1,
    "flexgen/base/motion/interpolation.py": 1,
    "flexgen/paths/inverse_kinematics/targets.py": 1,
    "flexgen/feedback/loop/channels.py": 1,
    "flexgen/views/plots/control.py": 1,
    "flexgen/views/plots/stick_figure.py": 1,
    "flexgen/base/calls/progress.py": 1,
    "flexgen/studies/templates/dh_model.py": 1,
    "flexgen/base/checks/type_checks.py": 1,
    "tests/client/test_path_sampler.py": 1,
    "tests/cross/test_hysteresis_in_c.py": 1,
    "tests/support/hostile.py": 1,
    "tests/support/model_files.py": 1,
    "tests/support/public_stub.py": 1,
    "tests/analysis/test_solvability.py": 1,
}


@cache
def texts() -> dict[str, str]:
    """All tracked Python files, by path."""
    names = subprocess.run(
        ["git", "ls-files", "*.py", "*.pyi"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    found = {name: ROOT / name for name in names}
    return {name: path.read_text("utf-8") for name, path in found.items() if path.exists()}


# Kept as their authors wrote them: C that flexgen emits, whose names may be long, and FMI.
OTHERS = ("generated/", "flexgen/exports/fmu/standard/")


@cache
def texts_in_c() -> dict[str, str]:
    """All tracked files of C and C++ that are written by hand, by path."""
    kinds = ["*.c", "*.h", "*.cpp", "*.hpp"]
    names = subprocess.run(
        ["git", "ls-files", *kinds], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    found = {name: ROOT / name for name in names if not name.startswith(OTHERS)}
    return {name: path.read_text("utf-8") for name, path in found.items() if path.exists()}


@cache
def tree(text: str) -> ast.Module:
    return ast.parse(text)


def wide_lines(text: str) -> list[int]:
    """Numbers of the lines that are too wide."""
    return [k for k, line in enumerate(text.split("\n"), 1) if len(line) > WIDTH]


def joined_assignments(text: str) -> list[int]:
    """Lines that assign a tuple to a tuple where two assignments would do.

    Exchanged values, and values that read a target of the same assignment, need one statement.
    """
    return [
        node.lineno
        for node in ast.walk(tree(text))
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Tuple)
        and isinstance(node.targets[0], ast.Tuple | ast.List)
        and not needs_both(node.targets[0].elts, node.value.elts)
    ]


def needs_both(targets: list[ast.expr], values: list[ast.expr]) -> bool:
    """A value reads a target that stands before its own."""
    for k, value in enumerate(values):
        read = {ast.unparse(x) for x in ast.walk(value) if isinstance(x, ast.expr)}
        for target in targets[:k]:
            base = target
            while isinstance(base, ast.Subscript):
                base = base.value
            if ast.unparse(base) in read:
                return True
    return False


def deep_blocks(text: str) -> int:
    """Functions with blocks in more than `DEEPEST` others."""

    def depth(node: ast.AST, inside: int = 0) -> int:
        most = inside
        for name, value in ast.iter_fields(node):
            children = value if isinstance(value, list) else [value]
            for child in children:
                if not isinstance(child, ast.AST) or isinstance(
                    child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
                ):
                    continue
                is_elif = isinstance(node, ast.If) and name == "orelse" and len(children) == 1
                deeper = isinstance(child, BLOCKS) and not (is_elif and isinstance(child, ast.If))
                most = max(most, depth(child, inside + deeper))
        return most

    functions = (x for x in ast.walk(tree(text)) if isinstance(x, ast.FunctionDef))
    return sum(depth(function) > DEEPEST for function in functions)


def nested_conditions(text: str) -> int:
    """Conditional expressions within another."""
    return sum(
        isinstance(inner, ast.IfExp)
        for outer in ast.walk(tree(text))
        if isinstance(outer, ast.IfExp)
        for inner in (outer.test, outer.body, outer.orelse)
    )


def vague_docstrings(text: str) -> list[str]:
    """First lines of the docstrings that begin with words of `VAGUE`."""
    documented = (node for node in ast.walk(tree(text)) if isinstance(node, DOCUMENTED))
    docstrings = (ast.get_docstring(node) or "" for node in documented)
    return [docstring.split("\n")[0] for docstring in docstrings if VAGUE.match(docstring)]


def counts(rule) -> dict[str, int]:
    found = {name: rule(text) for name, text in texts().items()}
    return {name: count for name, count in found.items() if count}


def test_no_line_is_too_wide() -> None:
    assert {name: rows for name, text in texts().items() if (rows := wide_lines(text))} == {}


def test_no_line_of_c_is_too_wide() -> None:
    """At the width of clang-format, which does not break comments that it cannot."""
    found = texts_in_c()
    assert len(found) > 50, "no file was read"
    assert {name: rows for name, text in found.items() if (rows := wide_lines(text))} == {}
    assert f"ColumnLimit: {WIDTH}\n" in (ROOT / ".clang-format").read_text("utf-8")


def test_a_planted_wide_line_of_c_is_seen() -> None:
    name, text = next(iter(texts_in_c().items()))
    assert wide_lines(text) == [], name
    assert wide_lines(f"{text}/* {'x' * WIDTH} */\n") == [text.count("\n") + 1]


def test_one_assignment_a_line() -> None:
    found = {name: joined_assignments(text) for name, text in texts().items()}
    assert {name: rows for name, rows in found.items() if rows} == {}


def test_docstrings_begin_with_their_nouns() -> None:
    found = {
        name: vague_docstrings(text)
        for name, text in texts().items()
        if name.startswith("flexgen/")
    }
    assert found, "no file was read"
    assert {name: lines for name, lines in found.items() if lines} == {}


@pytest.mark.parametrize(
    ("rule", "known"), [(deep_blocks, NESTED), (nested_conditions, CONDITIONAL)]
)
def test_old_violations_only_shrink(rule, known: dict[str, int]) -> None:
    found = counts(rule)
    worse = {name: count for name, count in found.items() if count > known.get(name, 0)}
    assert worse == {}, "write these without nesting"
    better = {name: found.get(name, 0) for name in known if found.get(name, 0) < known[name]}
    assert better == {}, "lower their numbers in the list"


def test_a_planted_wide_line_is_seen() -> None:
    assert wide_lines("x = 1\n" + "y" * (WIDTH + 1)) == [2]


def test_a_planted_joined_assignment_is_seen() -> None:
    assert joined_assignments("a, b = 1, 2\nself.x, y = f(y), z\n") == [1, 2]


@pytest.mark.parametrize(
    "line", ["a, b = b, a", "x, y = x + y, x", "p[0], p[1] = p[1], 2 * p[0]", "a, b = f(1)"]
)
def test_what_needs_one_statement_is_allowed(line: str) -> None:
    assert joined_assignments(line) == []


@pytest.mark.parametrize("begin", ["What a spring does.", "How it\nmoves.", "The same, later."])
def test_planted_vague_docstrings_are_seen(begin: str) -> None:
    first = begin.split("\n")[0]
    method = f'class A:\n    def f(self):\n        """{begin}"""\n'
    for text in (f'"""{begin}"""\n', f'class A:\n    """{begin}"""\n', method):
        assert vague_docstrings(text) == [first]


@pytest.mark.parametrize(
    "begin", ["Whatever is given.", "The samples.", "Residual: what is left."]
)
def test_docstrings_with_nouns_are_allowed(begin: str) -> None:
    assert vague_docstrings(f'"""{begin}"""\n') == []


def test_planted_blocks_are_seen() -> None:
    lines = [" " * (4 * k + 4) + f"if x{k}:" for k in range(DEEPEST + 1)]
    text = "\n".join(["def f():", *lines, " " * (4 * DEEPEST + 8) + "pass"])
    assert deep_blocks(text) == 1
    assert deep_blocks(text.replace(f"if x{DEEPEST}:", "pass").rsplit("\n", 1)[0]) == 0


def test_a_planted_conditional_expression_is_seen() -> None:
    assert nested_conditions("x = 1 if a else 2 if b else 3") == 1
    assert nested_conditions("x = 1 if a else 2") == 0
