"""Prefixes of units and ticks of logarithmic axes."""

from __future__ import annotations

import pytest

from flexgen.views.plots import canvas


@pytest.mark.parametrize(
    ("largest", "unit", "prefix"),
    [
        (0.99e-7, "m", "nm"),
        (1.01e-7, "m", "µm"),
        (0.99e-3, "rad", "µrad"),
        (1.01e-3, "m", "mm"),
        (2.0, "N m", "N m"),
    ],
)
def test_prefixes_of_units(largest: float, unit: str, prefix: str) -> None:
    factor, found = canvas.choose_prefix(-largest, unit)
    assert found == prefix and factor == {"n": 1e9, "µ": 1e6, "m": 1e3, "N": 1.0}[prefix[0]]
    assert canvas.choose_prefix(1e-5, "rad or m") == (1e6, "µrad or µm")
    assert canvas.choose_prefix(-2.0, "rad or m") == (1.0, "rad or m")
    assert canvas.choose_prefix(2e-3, "N m") == (1.0, "N m")


def test_ticks_of_logarithmic_axes_are_powers() -> None:
    assert [canvas.power(x) for x in (0, 1.0, 10.0, 1e-3, -1e12, 99.0)] == [
        "0",
        "1",
        "10",
        "10⁻³",
        "\N{MINUS SIGN}10¹²",
        "10²",
    ]
