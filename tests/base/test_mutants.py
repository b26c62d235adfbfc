"""The tool that draws mutants and runs their tests: kinds of changes, and what is left out."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from mutant_session import change_functions
from mutants import drawn, files_of, imported, mutants_of


def changes(text: str) -> set[str]:
    """Kind and new text of all mutants of a module."""
    return {f"{mutant.kind}: {mutant.after}" for mutant in mutants_of(text)}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("y = a + b", {"sign: ((a) - (b))"}),
        ("y = -x", {"sign: (x)"}),
        ("y -= x", {"operator: y += x"}),
        ("y = a * b", {"operator: ((a) / (b))"}),
        ("y = A @ B", {"order: ((B) @ (A))"}),
        ("y = a < b", {"condition: (a >= b)"}),
        ("y = a and b", {"condition: ((a) or (b))"}),
        ("y = not a", {"condition: (a)"}),
        ("if a:\n    f()", {"condition: (not (a))"}),
        ("y = [x for x in y if x]", {"condition: (not (x))"}),
        ("f(a, b, c)", {"order: f(b, a, c)", "order: f(a, c, b)"}),
        ("y = np.degrees(x)", {"unit: (x)"}),
        ("y = 1e3 * x", {"operator: ((1000.0) / (x))", "unit: 1.0"}),
    ],
)
def test_each_kind_of_change(text: str, expected: set[str]) -> None:
    assert changes(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "LIMIT = 2 * 3.0",
        "class FitTuning:\n    steps: int = 2 + 3",
        "for k in range(n + 1):\n    pass",
        "while a < b:\n    pass",
        "def f(x=-1.0):\n    pass",
        "def f(x: A | B) -> C | D:\n    pass",
        "raise ValueError(a, b)",
        "y = f'{a + b}'",
        "y = 'a' + b",
        "f('name', b)",
        "max(a, b)",
        "f(a, a)",
    ],
)
def test_constants_bounds_texts_and_symmetric_calls_are_left_out(text: str) -> None:
    assert mutants_of(text) == []


def test_a_change_replaces_its_bytes_and_keeps_the_rest() -> None:
    text = "# in °\ny = (a\n     + b)\nz = 'é' if p < q else r\n"
    after = {mutant.applied(text) for mutant in mutants_of(text)}
    assert after == {
        "# in °\ny = (((a) - (b)))\nz = 'é' if p < q else r\n",
        "# in °\ny = (a\n     + b)\nz = 'é' if (p >= q) else r\n",
    }


def test_a_mutant_knows_its_statement_and_whether_it_is_in_a_function() -> None:
    text = "x = -a\ndef f(a):\n    if (a\n        < 3):\n        return 1\n"
    places = [(mutant.line, mutant.last, mutant.function) for mutant in mutants_of(text)]
    assert places == [(1, 1, False), (3, 4, True)]


def test_the_seed_decides_what_is_drawn_and_all_of_it_compiles() -> None:
    files = files_of("base/numerics")
    one = drawn(files, 40, 1)
    assert one == drawn(files, 40, 1) != drawn(files, 40, 2)
    assert len({(mutant.file, mutant.line) for mutant in one}) == len(one) == 40
    texts = {
        f"flexgen/base/numerics/{path.name}": path.read_text(encoding="utf-8") for path in files
    }
    for mutant in one:
        compile(mutant.applied(texts[mutant.file]), mutant.file, "exec")


def test_imported_modules_and_names_are_found() -> None:
    text = "from flexgen.base.numerics import nlp\nimport flexgen.base.numerics.riccati as r\n"
    assert imported(text) >= {"flexgen.base.numerics.nlp", "flexgen.base.numerics.riccati"}


TWO_FUNCTIONS = """import functools


@functools.cache
def area(a, b):
    return a * b


class Shape:
    def outline(self, a, b):
        return [side(x) for x in (a, b) for side in (lambda x: 2 * x,)]
"""


def test_functions_in_memory_get_the_code_of_the_mutant(tmp_path: Path) -> None:
    """Decorated functions, methods and functions within them, of an imported module."""
    path = tmp_path / "shapes.py"
    path.write_text(TWO_FUNCTIONS, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("shapes", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    change_functions(str(path), TWO_FUNCTIONS, TWO_FUNCTIONS.replace("*", "/"))
    assert module.area(3, 2) == 1.5
    assert module.Shape().outline(1, 4) == [2.0, 0.5]
