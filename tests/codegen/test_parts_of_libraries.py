"""Contents, stacks and objects of a library, each of them by hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import pytest

from flexgen.base.errors import BuildError
from flexgen.codegen.build import object_cache
from flexgen.codegen.emission import clib_files
from flexgen.codegen.emission import constants_header as header
from flexgen.codegen.statements import column_loops


def test_contents_of_a_library_are_those_of_its_functions() -> None:
    def spec(**function: str) -> Any:
        return Made(
            c_functions=[Made(**{"name": "solve", "file": "invert.c", **function})],
            motor_constants=None,
        )

    assert header.has_growth(spec(file="growth.c")) and not header.has_growth(spec())
    assert header.has_bounds(spec(name="stream_all_limits")) and not header.has_bounds(spec())
    assert header.filter_sizes(spec()) == (0, 0, 0)


def test_stacks_of_functions_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """In whole KiB; each feature of a library adds its arrays."""
    asked: dict[str, Any] = {}
    defaults = {"has_positions": False, "filter_sizes": (0, 0, 0), "count_elements": 0}
    defaults |= {"is_curved": False, "is_harmonic": False, "is_bristled": False}

    def size(**more: Any) -> int:
        asked.clear()
        asked.update(defaults | more)
        for name, value in asked.items():
            monkeypatch.setattr(clib_files, name, lambda spec, value=value: value)
        spec: Any = Made(sizes={"n_a": 7, "n_e": 2, "n_y": 3, "n_g": 5, "n_m": 6})
        return clib_files.stack_bytes(spec)

    base = 7 * (7 + 12 + 6 + 16) + 3 * 2 * 3 + 80
    for more, reals in (
        ({}, 0),
        ({"has_positions": True}, 55 + 3),
        ({"has_positions": True, "filter_sizes": (9, 9, 4)}, 55 + 3 + 80),
        ({"filter_sizes": (9, 9, 4)}, 0),
        ({"count_elements": 1}, 80 * 13 + 80),
        ({"count_elements": 3}, 80 * 13 + 80 + 6 * 13),
        ({"count_elements": 3, "is_curved": True}, 80 * 13 + 80 + 6 * 13 + 3 * 13 + 60),
        ({"is_harmonic": True}, 960),
        ({"is_bristled": True}, 140),
    ):
        found = size(**more)
        least = 8 * (base + reals) + 10_000
        assert found % 1024 == 0 and least <= found < least + 1024, more


def test_loops_over_columns_have_sums_and_products_only() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [ca.sin(x[0]) + x[1]], ["x"], ["y"])
    step: Any = Made(function=function, tables={}, n=4)
    layout: Any = Made(at=lambda array, row: 10 * row, precision="double")
    with pytest.raises(
        BuildError, match="columns of f: given the operation sin, expected sums and products"
    ):
        column_loops.columns_text("f", step, layout, str)
    step.function = ca.Function("f", [x], [x[0] * x[1] - x[1]], ["x"], ["y"])
    text, operations, depth = column_loops.columns_text("f", step, layout, str)
    assert operations == 2 and depth >= 2 and "for (k = 0; k < ROW_COUNT(4); ++k) {" in text


@pytest.mark.parametrize("cached", [None, b"object"])
def test_an_object_is_fetched_where_the_cache_has_it(
    cached: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(object_cache, "fetch_entry", lambda folder, name: cached)
    source = tmp_path / "one.c"
    source.write_text("int x;\n")
    found = object_cache.Objects("gcc", {}).fetch(source)
    assert found is (cached is not None) and source.with_suffix(".o").exists() is found
