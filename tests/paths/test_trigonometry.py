"""Sine, cosine and square root of paths against those of the C library."""

from __future__ import annotations

import math

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.paths.geometry.trigonometry import root, sine_cosine

RNG = np.random.default_rng(6)


def test_sine_cosine_and_root_are_exact_to_rounding() -> None:
    x = np.concatenate(
        [RNG.uniform(-1e6, 1e6, 2000), RNG.uniform(-10, 10, 2000), np.arange(-40, 41) * np.pi / 4]
    )
    sine, cosine = sine_cosine(x)
    assert np.abs(sine - [math.sin(v) for v in x]).max() <= 2.3e-16
    assert np.abs(cosine - [math.cos(v) for v in x]).max() <= 2.3e-16
    small = np.array([1e-300, 1e-9, -3e-8])
    assert_allclose(sine_cosine(small)[0], small, rtol=4e-16)
    for value in (1e6 + 1e-3, -2e6, np.nan):
        assert np.isnan(sine_cosine(np.array([value]))).all()
    assert np.isfinite(sine_cosine(np.array([1e6, -1e6]))).all()
    y = 10.0 ** RNG.uniform(-290, 290, 500)
    assert_allclose(root(y), np.sqrt(y), rtol=2.3e-16)
    assert_array_equal(root(np.array([0.0, -4.0, 1e300, np.inf])), [0.0, -4.0, 1e300, np.inf])
    assert_array_equal(root(np.array([4.0, 0.25, 16.0, 1.0])), [2.0, 0.5, 4.0, 1.0])
