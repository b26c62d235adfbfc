"""Averages of frequency responses: arithmetic, harmonic and logarithmic means of numbers known in
advance.
"""

from __future__ import annotations

import numpy as np
import pytest

from flexgen.identification.responses.response_estimates import average_of


@pytest.mark.parametrize(
    ("average", "expected"),
    [("arithmetic", 2.5), ("h1", 2.5), ("harmonic", 1.6), ("logarithmic", 2.0)],
)
def test_average_of_one_and_four(average, expected):
    each = np.array([1.0, 4.0]).reshape(1, 2, 1, 1, 1) * np.exp(0.3j)
    assert average_of(each, average) == pytest.approx(
        np.full((1, 1, 1, 1), expected * np.exp(0.3j)), rel=1e-15
    )


def test_harmonic_mean_of_matrices_is_that_of_their_inverses():
    each = np.random.default_rng(1).normal(size=(1, 3, 2, 2, 2)) + 3 * np.eye(2)
    inverse = np.mean([np.linalg.inv(each[0, k, 1]) for k in range(3)], axis=0)
    assert average_of(each, "harmonic")[0, 1] == pytest.approx(np.linalg.inv(inverse), rel=1e-12)
