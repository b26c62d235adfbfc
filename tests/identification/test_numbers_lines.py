"""Lines of recorded periods: which are excited, between which bounds, and spectra next to them."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.identification.records import experiment_file
from flexgen.identification.records.experiment_file import EXCITED, REFERENCE
from flexgen.identification.responses.spectra import MOST_OFFSETS, all_spectra_beside, line_offsets


class Root:
    """A table of some keys; a refusal is what it says of a key."""

    def __init__(self, **entries: Any) -> None:
        rows = {
            key: [Made(value=x) for x in value]
            for key, value in entries.items()
            if isinstance(value, list)
        }
        self.entries = {key: Made(value=rows.get(key, value)) for key, value in entries.items()}
        self.given = entries

    def __contains__(self, key: str) -> bool:
        return key in self.given

    def choice(self, key: str, names: tuple[str, ...], default: str) -> str:
        assert names == ("excited", "odd", "all")
        return str(self.given.get(key, default))

    def number(self, key: str, default: float, above: float) -> float:
        assert (key, above) in (
            ("f_min", 0.0),
            ("f_max", self.given.get("f_min", above)),
        ) or key == "f_max"
        return float(self.given.get(key, default))

    def fail(self, key: str, expected: str) -> Exception:
        return ValueError(f"{key}: {expected}")


def lines_of(
    root: Root, amplitudes: dict[int, float], samples: int = 40, least: float = EXCITED
) -> list[int]:
    """Of sines with these amplitudes, as the second motor of the second experiment, and half of it
    of another.
    """
    t = np.arange(samples) / samples
    tau = np.zeros((1, 2, 3, samples, 2))
    for line, size in amplitudes.items():
        tau[0, 1, :, :, 1] += size * np.sin(2 * np.pi * line * t)
        tau[0, 0, :, :, 0] += 0.5 * size * np.cos(2 * np.pi * line * t)
    tau[..., 1] += np.array([1.0, -2.0, 1.0])[:, None]  # the mean over the periods is zero
    tau[:, 1] += 5.0  # the mean of a signal does not count
    return experiment_file._lines(root, tau, 2.0, least).tolist()  # type: ignore[arg-type]


def test_lines_of_recordings_are_excited_odd_or_all() -> None:
    """Above a fiftieth of the largest amplitude; of references above a thousandth of the largest
    speed.
    """
    sizes = {1: 1.0, 3: 0.021, 4: 0.5, 5: 0.019, 9: 0.03}
    assert lines_of(Root(), sizes) == [1, 3, 4, 9]
    # up to 0.45 of the sample rate
    assert lines_of(Root(lines="all"), sizes) == list(range(1, 19))
    assert lines_of(Root(lines="odd"), sizes) == list(range(1, 19, 2))
    speeds = {1: 1.0, 2: 0.00049, 4: 0.00026, 5: 0.00019}
    assert lines_of(Root(), speeds, least=REFERENCE) == [1, 4]
    for f_min, f_max, expected in (
        (0.5, 2.0, [1, 2, 3, 4]),
        (1.0, 1.5, [2, 3]),
        (0.5 + 1e-12, 2.0 - 1e-12, [1, 2, 3, 4]),  # rounding
        (0.51, 1.99, [2, 3]),
        (9.0, 30.0, [18, 19]),  # below half of the sample rate
        (0.1, 0.9, [1]),
    ):
        assert lines_of(Root(lines="all", f_min=f_min, f_max=f_max), sizes) == expected
    assert lines_of(Root(lines="all", f_min=9.0, f_max=30.0), sizes, samples=39) == [18, 19]
    with pytest.raises(
        ValueError, match="period_s: a period that has lines between f_min and f_max"
    ):
        lines_of(Root(lines="all", f_min=1.1, f_max=1.4), sizes)


def test_lines_by_number_are_whole_and_below_half_of_the_samples() -> None:
    """In order, without another choice."""
    assert lines_of(Root(line_numbers=[7, 1, 19, 7]), {}) == [1, 7, 19]
    for numbers in ([], [20], [0], [1.0], 3):
        with pytest.raises(ValueError, match="line_numbers: whole numbers from 1 to 19"):
            lines_of(Root(line_numbers=numbers), {})
    assert lines_of(Root(line_numbers=[19]), {}, samples=39) == [19]
    with pytest.raises(ValueError, match="line_numbers: whole numbers from 1 to 19"):
        lines_of(Root(line_numbers=[20]), {}, samples=39)
    for key, value in (("lines", "all"), ("f_min", 1.0), ("f_max", 2.0)):
        with pytest.raises(
            ValueError, match="line_numbers: no lines, f_min or f_max in addition to it"
        ):
            lines_of(Root(line_numbers=[1], **{key: value}), {})


def test_spectra_next_to_lines_are_those_of_the_whole_record() -> None:
    """Amplitudes of unexcited frequencies around each line; none where there are too few
    periods.
    """
    rng = np.random.default_rng(1)
    lines = np.array([2, 5])
    periods = 4
    samples = 16
    x = rng.normal(size=(1, 2, periods, samples, 3))
    kept = all_spectra_beside(x, lines)
    offsets = kept["offsets"]
    found = kept["beside"]
    assert 0 not in offsets % periods and found.shape == (1, 1, 2, len(offsets), 2, 3)
    whole = x.reshape(1, 2, periods * samples, 3)
    t = np.arange(periods * samples) / (periods * samples)
    for k, d in enumerate(offsets):
        for j, line in enumerate(lines):
            wave = np.exp(-2j * np.pi * (periods * line + d) * t)
            expected = 2 * np.einsum("t,petc->pec", wave, whole) / len(t)
            assert_allclose(found[:, 0, :, k, j], expected, atol=1e-12)
    # three periods have no record without the first
    later = all_spectra_beside(x[:, :, 1:], lines)
    assert set(later) == {"offsets", "beside"} and all_spectra_beside(x[:, :, :1], lines) == {}
    assert_allclose(kept["offsets_later"], later["offsets"])
    assert_allclose(kept["beside_later"], later["beside"], atol=1e-14)


def test_unexcited_frequencies_lie_between_the_lines() -> None:
    """Not at multiples of the period, not at excited ones, not below zero; the nearest first."""
    found = line_offsets(np.array([3, 7]), 4)
    assert 0 < len(found) <= 2 * MOST_OFFSETS
    assert_allclose(np.sort(found), np.sort(-found))
    free = [d for d in range(1, 12) if d % 4][:MOST_OFFSETS]
    assert sorted(set(np.abs(found))) == free
    with pytest.raises(
        ArgumentError,
        match="given 1 periods and lines from 3 on, expected two unexcited frequencies",
    ):
        line_offsets(np.array([3, 7]), 1)
    assert sorted(set(np.abs(line_offsets(np.array([1, 7]), 4)))) == [1, 2, 3]
    with pytest.raises(ArgumentError, match="transients: given 2 periods and lines from 1 on"):
        line_offsets(np.array([1, 7]), 2)
