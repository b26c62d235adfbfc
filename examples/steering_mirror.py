"""Frequency responses of a fine steering mirror with three inputs and outputs, with their noise
and their distortion.

    python examples/steering_mirror.py U.npy Y.npy [PICTURE.svg]

The public records (M. Floren et al.; 300 mV, training) have 8192 samples of three channels, six
realizations of random phases and two periods. Three realizations at a time are orthogonal
experiments; the two blocks of three show how much the responses change with the realization, which
noise does not explain.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from flexgen.identification.responses.response_estimates import Estimate, estimate

EXCITED = 0.1  # of the largest amplitude


def responses(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, Estimate]:
    """Excited lines, and the estimate at them, of records (samples, channels, realizations,
    periods).
    """
    U, Y = (2 / len(x) * np.fft.rfft(x, axis=0) for x in (u, y))
    size = np.abs(U).max(axis=(1, 2, 3))
    lines = np.flatnonzero(size > EXCITED * size.max())
    channels, records, periods = u.shape[1:]
    blocks = [
        x[lines]
        .reshape(len(lines), channels, records // channels, channels, periods)
        .transpose(2, 4, 0, 1, 3)[None]
        for x in (U, Y)
    ]
    return lines, estimate(blocks[0], blocks[1])


def draw(lines: np.ndarray, found: Estimate, picture: Path) -> None:
    """Amplitudes with the deviations by noise and with distortion."""
    n = found.G.shape[-1]
    figure = Figure(figsize=(2.6 * n, 2.1 * n), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(n, n, sharex=True, sharey=True)
    assert found.total is not None
    for a in range(n):
        for b in range(n):
            ax = axes[a, b]
            ax.loglog(lines, np.abs(found.G[0, :, a, b]), label="response")
            ax.loglog(
                lines, np.sqrt(found.total[0, :, a, b]), lw=0.8, label="deviation, with distortion"
            )
            ax.loglog(
                lines, np.sqrt(found.variance[0, :, a, b]), lw=0.8, label="deviation by noise"
            )
            ax.set_title(f"input {b + 1}, output {a + 1}", fontsize=9)
    figure.supxlabel("line, multiples of 1/period")
    figure.supylabel("amplitude, m/V")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    figure.savefig(picture)


def main(words: list[str]) -> None:
    """Estimate, print and draw."""
    u, y = (np.load(word, allow_pickle=False) for word in words[:2])
    lines, found = responses(u, y)
    assert found.total is not None
    size = np.abs(found.G)
    print(f"{len(lines)} lines, {found.G.shape[-2]} x {found.G.shape[-1]} channels")
    print(f"median deviation by noise: {100 * np.median(np.sqrt(found.variance) / size):.3g} %")
    print(
        f"median deviation with distortion: {100 * np.median(np.sqrt(found.total) / size):.3g} %"
    )
    if len(words) > 2:
        draw(lines, found, Path(words[2]))
        print(f"wrote {words[2]}")


if __name__ == "__main__":
    main(sys.argv[1:])
