"""Zeros along a path from given roots: phases, changes, methods, and sentences about them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexgen.analysis.zero_dynamics.solvability import ALONE, name_largest
from flexgen.analysis.zero_dynamics.zeros import preview
from flexgen.analysis.zero_dynamics.zeros_along_path import (
    AXIS,
    INFINITY,
    NEAR,
    ZeroPath,
    summarize_zeros,
)

RIGHT = [[5.0, -2.0], [4.0, -1.0], [8.0, -3.0]]
LEFT = [[-5.0], [-2.0], [-3.0]]
CROSSING = [[-1.0], [0.5], [0.5]]
FLAT: list[list[float]] = [[], [], []]


def made(roots: list[list[float]], n_e: int = 1, **rest: Any) -> ZeroPath:
    """At t = 0, 1, ... s; ``sigma`` and ``sign`` are one unless they are given."""
    n = len(roots)
    given = {name: np.array(rest.get(name, [1.0] * n)) for name in ("sigma", "sign")}
    zeros = [np.array(row, complex) for row in roots]
    return summarize_zeros(n_e, np.arange(n, dtype=float), np.zeros((n, 1)), zeros, **given)


@pytest.mark.parametrize(
    ("roots", "phase", "rates", "needed"),
    [
        (RIGHT, "non-minimum phase", (4.0, 8.0, 1.0), preview(0.25)),
        (LEFT, "minimum phase", (None, None, 2.0), 0.0),
        (FLAT, "flat", (None, None, None), 0.0),
        # on the way the slowest is as slow as the poses are dense
        (CROSSING, "non-minimum phase", (0.5, 0.5, 1.0), 2.0),
    ],
)
def test_phases_and_rates_follow_from_the_roots(
    roots: list[list[float]], phase: str, rates: tuple[float | None, ...], needed: float
) -> None:
    found = made(roots)
    assert found.phase == phase
    assert (found.slowest, found.fastest, found.slowest_stable) == rates
    assert found.preview_s == min(needed, preview(2.0))


@pytest.mark.parametrize(
    ("roots", "rest", "methods"),
    [
        (RIGHT, {}, ("lq", "bvp")),
        (LEFT, {}, ("lq", "bvp", "reduced")),
        (CROSSING, {}, ("lq",)),
        (FLAT, {"n_e": 0}, ("closed-form",)),
        (LEFT, {"sigma": (1.0, 0.5 * NEAR, 1.0)}, ("lq",)),
        (LEFT, {"sigma": (1.0, NEAR, 1.0)}, ("lq", "bvp", "reduced")),
    ],
)
def test_methods_are_those_that_suit(
    roots: list[list[float]], rest: dict[str, Any], methods: tuple[str, ...]
) -> None:
    assert made(roots, **rest).methods == methods


@pytest.mark.parametrize(
    ("roots", "rest", "change"),
    [
        (CROSSING, {}, (0.5, 0, 1, AXIS)),
        # where the determinant of the inertia, here linear in time, is zero
        (
            [[-9.0], [9.0], [9.0]],
            {"sigma": (0.1, 0.3, 0.3), "sign": (1.0, -1.0, -1.0)},
            (0.25, 0, 1, INFINITY),
        ),
        ([[-1.0], [0.5, -2.0], [0.5, -2.0]], {}, (0.5, 0, 1, INFINITY)),
    ],
)
def test_a_zero_changes_its_half_plane(
    roots: list[list[float]], rest: dict[str, Any], change: tuple[float, int, int, str]
) -> None:
    found = made(roots, **rest)
    assert [tuple(vars(c).values()) for c in found.changes] == [
        (pytest.approx(change[0]), *change[1:])
    ]
    missing = [len(row) < max(map(len, roots)) for row in roots]
    assert np.isinf(found.zeros).any(axis=1).tolist() == missing


def alternating(changes: int) -> list[list[float]]:
    """A zero that crosses the imaginary axis ``changes`` times."""
    return [[-2.0 if k % 2 else 2.0] for k in range(changes + 1)]


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (made([[2.0, -3.0], [8.0, 5.0]]), ["1 to 2 of 2 zeros unstable, 2..8 1/s"]),
        (made([[2.0], [2.009]]), ["1 of 1 zeros unstable, 2 1/s", "use lq or bvp"]),
        (made([[2.0], [2.011]]), ["unstable, 2..2.01 1/s"]),
        (made([[2000.0], [2000.0]]), ["exact tracking 6.91 ms"]),
        (made(CROSSING), [f"0 to 1 unstable at t = 0.5 s, through {AXIS}", "use lq"]),
        (made(alternating(4)), ["at t = 2.5 s", "1 more changes"]),
        (made(alternating(9)), ["6 more changes"]),
        (made(LEFT), ["all 1 zeros stable, the slowest 2 1/s", "use lq or bvp or reduced"]),
        (made([[0.0], [0.0]]), ["all 1 zeros stable, on the imaginary axis"]),
        (made(FLAT, n_e=0), ["flat: no zeros", "derivatives alone; use closed-form"]),
        (made(LEFT, sign=(0.0, 1.0, 1.0)), ["a zero at infinity at 1 poses"]),
        (made(LEFT, sign=(0.0, 0.0, 0.0)), ["a zero at infinity at all poses"]),
        (made(LEFT, sigma=(1.0, 0.5 * NEAR, 1.0)), ["a zero near infinity"]),
        (made(LEFT, sigma=(1.0, NEAR, 1.0)), []),
        (made(CROSSING, sigma=(1.0, 0.5 * NEAR, 1.0)), []),
        (made(alternating(3)), []),
    ],
)
def test_verdicts_name_rates_changes_and_methods(found: ZeroPath, told: list[str]) -> None:
    assert [text for text in told if text not in found.verdict] == []
    # four changes or more are summed up; a change says already that a zero is near infinity
    assert ("more changes" in found.verdict) == (len(found.changes) > 3)
    near = found.sigma_min.min() < NEAR and not found.changes
    assert ("near infinity" in found.verdict) == near


@pytest.mark.parametrize(
    ("entries", "names"),
    [
        ([0.1 * ALONE, -8.0, 4.0, 0.0, 0.0, 0.0], "b, c"),
        ([-1.0, 0.99, 0.98, 0.97, 0.96, 0.95], "a, b, c, d"),
        ([500 * ALONE, 1010 * ALONE, 1000.0, 0.0, 0.0, 0.0], "c, b"),
    ],
)
def test_the_largest_entries_of_a_vector_are_named_in_order(
    entries: list[float], names: str
) -> None:
    assert name_largest(np.array(entries), list("abcdef")) == names
