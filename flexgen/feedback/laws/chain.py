"""Gains and stability of a sampled chain of integrators, to which feedback linearization reduces
every joint.

    d^n q/dt^n = s,    s = -(g_0 q + g_1 q' + ...),    s held from t_k + delay to t_(k+1) + delay

The continuous gains are those of (p + w)^n; the discrete ones place all poles of the sampled chain
at exp(-w h). With the continuous gains four integrators are stable for w h < 0.5111, with a delay
of one sample for w h < 0.1979.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from numpy.linalg import eigvals, matrix_power, solve

from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.timing import Timing

STABLE = 1.0 + 1e-9  # largest size of an eigenvalue
BISECTIONS = 40
FormName = Literal["continuous", "discrete"]
FORMS: tuple[FormName, ...] = get_args(FormName)


def chain_gains(frequency_hz: float, n: int, form: str, sample_s: float) -> np.ndarray:
    """Gains ``g_0 ... g_(n-1)`` (n,) [1/s^n, ..., 1/s] that place all poles of a chain of ``n``
    integrators at -2 pi f.

    ``form``: "continuous", by the binomial formula; otherwise the poles of the sampled chain are
    placed at ``exp(-2 pi f h)``, h = ``sample_s``, by Ackermann's formula.
    """
    w = 2 * math.pi * frequency_hz
    if form == "continuous":
        return np.array([math.comb(n, k) * w ** (n - k) for k in range(n)])
    A, B = _integrators(n, 1.0)
    controllable = np.column_stack([matrix_power(A, k) @ B for k in range(n)])
    last = np.zeros(n)
    last[-1] = 1.0
    # Ackermann's formula, unit sample time
    placed = matrix_power(A - math.exp(-w * sample_s) * np.eye(n), n)
    gains = solve(controllable.T, last) @ placed
    return np.asarray(gains / sample_s ** np.arange(n, 0, -1))


def _integrators(n: int, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition of a chain of n integrators over a time h [s] with its input s held, ``x(h) = A x
    + B s``: A (n, n), B (n,), terms of the Taylor series.
    """
    A = np.array(
        [
            [h ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in range(n)]
            for i in range(n)
        ]
    )
    return A, np.array([h ** (n - i) / math.factorial(n - i) for i in range(n)])


def chain_loop(gains: np.ndarray, timing: Timing) -> np.ndarray:
    """Matrix of the sampled loop of a chain of integrators with these gains (n,).

    The state is the chain (n), its last measurement (n), and the inputs on their way (newest
    first), ``2 n + timing.whole + 2`` numbers. As in the law, odd derivatives may be differences
    of two samples, and the delay is predicted.
    """
    n = len(gains)
    h = timing.sample_s
    past = timing.whole + 2
    size = 2 * n + past
    pick = np.eye(size)
    x = pick[:n]
    last = pick[n : 2 * n]
    inputs = pick[2 * n :]
    seen = x.copy()
    if timing.differences:
        seen[1::2] = (x[::2][: len(seen[1::2])] - last[::2][: len(seen[1::2])]) / h
    ahead = seen
    for age, duration in timing.segments():
        A, B = _integrators(n, duration)
        ahead = A @ ahead + np.outer(B, inputs[age - 1])
    new = -gains @ ahead
    if timing.predicted:
        A, B = _integrators(n, 0.5 * h)
        new = -gains @ (A @ ahead + np.outer(B, new))
    inputs = np.vstack([new, inputs])  # (k samples old: row k)
    moved = x
    for age, duration in ((timing.whole + 1, timing.rest_s), (timing.whole, h - timing.rest_s)):
        A, B = _integrators(n, duration)
        moved = A @ moved + np.outer(B, inputs[age])
    return np.vstack([moved, x, inputs[:past]])


def largest_eigenvalue(gains: np.ndarray, timing: Timing) -> float:
    """Spectral radius of the sampled loop; stable below 1. Time in samples, which does not change
    the eigenvalues.
    """
    h = timing.sample_s
    n = len(gains)
    scaled = Timing(1.0, timing.delay_s / h, timing.predicted, timing.differences)
    return float(np.abs(eigvals(chain_loop(gains * h ** np.arange(n, 0, -1), scaled))).max())


def largest_frequency(n: int, form: str, timing: Timing) -> float:
    """The largest frequency [Hz] of the poles up to which the sampled loop is stable.

    The loop is that of a chain of ``n`` integrators with the `chain_gains` of a ``form``; by
    bisection from below. 0: it is unstable at 1e-3 of the sample rate already; about half the
    sample rate: it is stable wherever it was tried.
    """

    def stable(frequency: float) -> bool:
        return (
            largest_eigenvalue(chain_gains(frequency, n, form, timing.sample_s), timing) < STABLE
        )

    low = 1e-3 / timing.sample_s
    high = 1e-3 / timing.sample_s
    if not stable(low):
        return 0.0
    while stable(high) and high < 0.5 / timing.sample_s:
        low = high
        high = 1.1 * high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def stable_gains(
    frequency_hz: float, n: int, form: str, timing: Timing, allow_unstable: bool = False
) -> np.ndarray:
    """`chain_gains` of a chain whose sampled loop is stable.

    Raises
    ------
    ArgumentError
        The loop is unstable and not ``allow_unstable``; the message has the largest frequency [Hz]
        with which it is stable.
    """
    gains = chain_gains(frequency_hz, n, form, timing.sample_s)
    size = largest_eigenvalue(gains, timing)
    if not (np.isfinite(gains).all() and size < STABLE) and not allow_unstable:
        how = ", speeds by differences" if timing.differences else ""
        raise ArgumentError(
            f"controller, frequency_hz: given {frequency_hz:g} Hz, with which a chain of {n} "
            f"integrators is unstable at {1e3 * timing.sample_s:g} ms and a delay of "
            f"{1e3 * timing.delay_s:g} ms{how} (largest eigenvalue {size:.4g}); expected at "
            f"most {largest_frequency(n, form, timing):.4g} Hz"
        )
    return gains
