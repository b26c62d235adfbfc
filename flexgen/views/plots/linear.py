"""Plots of the linearized robot at an equilibrium: poles and zeros, frequency response."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from flexgen.analysis.analyze import Analysis
from flexgen.analysis.zero_dynamics.zeros import ON_AXIS
from flexgen.base.registry import provides
from flexgen.views.plots import canvas as cv

FAR = 1e6  # 1/s; larger roots are counted, not drawn


def _bounds(values: np.ndarray) -> tuple[float, float]:
    """Largest absolute value, and the smallest one to be drawn on a logarithmic scale."""
    sizes = np.abs(values[np.abs(values) > 0])
    if not len(sizes):
        return 1.0, 1.0
    top = float(sizes.max())
    return top, float(max(sizes[sizes > 1e-6 * top].min(), top / 3e3))


def _root_axis(ax: Any, axis: str, values: np.ndarray) -> str:
    """Set scale, limits and ticks of the ``axis``, "x" or "y", for roots with these parts;
    logarithmic on both sides of zero where they differ much. Returns the text about the scale for
    its label.
    """
    top, low = _bounds(values)
    set_scale = getattr(ax, f"set_{axis}scale")
    set_limits = getattr(ax, f"set_{axis}lim")
    if top / low < 30:
        set_limits(-1.25 * top, 1.25 * max(float(values.max()), 0.2 * top))
        return ""
    first = int(np.floor(np.log10(low)))
    last = int(np.ceil(np.log10(1.3 * top)))
    set_scale("symlog", linthresh=10.0**first, linscale=0.6)
    right = float(values.max())  # no wider than needed
    set_limits(-2.2 * top, 2.2 * right if right > 10.0**first else 10.0**first)
    step = 1 if last - first <= 3 else 2
    decades = [10.0**k for k in range(last, first - 1, -step) if 10.0**k <= 2.2 * top]
    chosen = getattr(ax, f"{axis}axis")
    chosen.set_major_locator(FixedLocator([-d for d in decades] + [0.0] + decades[::-1]))
    chosen.set_minor_locator(NullLocator())
    chosen.set_major_formatter(FuncFormatter(cv.power))
    return f" (logarithmic outside ±{cv.power(10.0**first)})"


def _label_multiples(ax: Any, roots: np.ndarray, offset: tuple[float, float]) -> None:
    """Write the number of coincident roots, ``×2``, next to them, at an ``offset`` in points."""
    left = list(roots)
    while left:
        z = left.pop(0)
        same = [x for x in left if abs(x - z) <= 0.02 * abs(z) + 1e-9]
        left = [x for x in left if abs(x - z) > 0.02 * abs(z) + 1e-9]
        if same:
            text = f"\N{MULTIPLICATION SIGN}{len(same) + 1}"
            ax.annotate(
                text,
                (z.real, z.imag),
                xytext=offset,
                textcoords="offset points",
                fontsize=8,
                color=cv.INK,
            )


def phase_summary(analysis: Analysis) -> str:
    """The phase of the output in one line."""
    report = analysis.zeros
    if report.phase == "non-minimum phase":
        slowest = report.unstable_time_constant_s * 1e3
        return f"non-minimum phase, time constant of the slowest unstable zero {slowest:.3g} ms"
    words = {"flat": "no zeros (flat output)", "minimum phase": "minimum phase, no unstable zero"}
    return words.get(
        report.phase, "phase unknown, because the numbers of outputs and motors differ"
    )


def falls_under_gravity(analysis: Analysis) -> bool:
    """Whether the arm falls under gravity with free motors: it has a slow real pole in the right
    half plane.
    """
    poles = analysis.poles
    top = float(np.abs(analysis.poles).max(initial=0.0))
    slow = (
        (np.abs(poles.imag) <= 1e-9 * top) & (poles.real > 1e-6 * top) & (poles.real < 0.05 * top)
    )
    return any(analysis.model.gravity) and bool(slow.any())


@cv.apply_style
def pole_zero_map(analysis: Analysis) -> Figure:
    """Poles of the robot and zeros of its output at an equilibrium [1/s].

    Parameters
    ----------
    analysis : Analysis
        From `flexgen.analyze`.
    """
    figure = cv.new_figure(cv.WIDTH, 5.2, f"{analysis.model.title}: poles and zeros")
    _draw_roots(figure, analysis)
    return figure


def _draw_roots(figure: Any, analysis: Analysis) -> None:
    """Draw `pole_zero_map` into a figure or a part of one."""
    ax = figure.add_subplot()
    motor = (
        analysis.zeros_motor if analysis.zeros_motor is not None else np.zeros(0, dtype=complex)
    )
    sets = [analysis.poles, analysis.zeros.zeros, motor]
    roots = np.concatenate(sets)
    drawn = roots[np.abs(roots) <= FAR]
    drawn = np.where(np.abs(drawn) > 1e-9 * np.abs(drawn).max(initial=0.0), drawn, 0.0)
    for axis, part, values in (("x", "real", drawn.real), ("y", "imaginary", drawn.imag)):
        scale = _root_axis(ax, axis, np.where(np.abs(values) > 1e-6 * np.abs(drawn), values, 0.0))
        ax.set(**{f"{axis}label": f"{part} part, 1/s{scale}"})
    ax.axvspan(0.0, ax.get_xlim()[1], color="#F7E3D8", lw=0, zorder=0)
    ax.axvline(0.0, color=cv.INK, lw=0.8, zorder=1)
    ax.axhline(0.0, color=cv.GREY, lw=0.6, zorder=1)
    ax.plot(
        motor.real,
        motor.imag,
        "s",
        ms=9,
        mfc="none",
        mec="#B5B5B5",
        mew=1.0,
        label="zeros, motor torque to motor angle",
    )
    ax.plot(sets[0].real, sets[0].imag, "x", ms=6.5, color=cv.BLUE, mew=1.6, label="poles")
    zeros = sets[1]
    if len(zeros):
        unstable = zeros.real > ON_AXIS * np.abs(zeros)
        style: dict[str, Any] = {"ms": 7.5, "mfc": "none", "mew": 1.7}
        ax.plot(
            zeros[~unstable].real,
            zeros[~unstable].imag,
            "o",
            mec=cv.GREEN,
            label="zeros of the output",
            **style,
        )
        if unstable.any():
            ax.plot(
                zeros[unstable].real,
                zeros[unstable].imag,
                "o",
                mec=cv.RED,
                label="unstable zeros of the output",
                **style,
            )
        _label_multiples(ax, zeros[np.abs(zeros) <= FAR], (6, 6))
    near = np.abs(sets[0]) <= 1e-9 * np.abs(sets[0]).max()
    _label_multiples(ax, np.where(near, 0.0, sets[0])[near], (6, -12))
    far = int(np.sum(np.abs(roots) > FAR))
    if far:
        note = f"{far} root{'s' if far > 1 else ''} above {cv.power(FAR)} 1/s not drawn"
        ax.text(0.99, 0.02, note, transform=ax.transAxes, ha="right", fontsize=8, color=cv.GREY)
    ax.text(
        0.99,
        0.98,
        "unstable",
        transform=ax.transAxes,
        ha="right",
        va="top",
        color=cv.RED,
        fontsize=8.5,
    )
    figure.legend(loc="outside lower center", ncols=4, handletextpad=0.3, columnspacing=1.4)


def elastic_modes(analysis: Analysis) -> list[tuple[float, float]]:
    """Elastic modes (Hz, damping ratio): those above a hundredth of the fastest; slower ones are
    due to gravity.
    """
    top = max((f for f, _ in analysis.modes), default=0.0)
    return [(f, d) for f, d in analysis.modes if f >= 0.01 * top]


@cv.apply_style
def frequency_response(analysis: Analysis) -> Figure:
    """Magnitude from each motor's torque to its own acceleration and to the output's acceleration,
    in dB.

    Parameters
    ----------
    analysis : Analysis
        From `flexgen.analyze`. For several output directions, the norm of the vector is drawn.
    """
    figure = cv.new_figure(cv.WIDTH, 6.0, f"{analysis.model.title}: frequency response")
    _draw_response(figure, analysis)
    return figure


@provides("Analysis.plot")
@cv.apply_style
def plot_analysis(analysis: Analysis) -> Figure:
    """`pole_zero_map` above `frequency_response` in one figure, see `Analysis.plot`."""
    figure = cv.new_figure(cv.WIDTH, 10.6, f"{analysis.model.title}: {phase_summary(analysis)}")
    upper, lower = figure.subfigures(2, 1, height_ratios=[4.9, 5.7])
    _draw_roots(upper, analysis)
    _draw_response(lower, analysis)
    return figure


def _draw_response(figure: Any, analysis: Analysis) -> None:
    """Draw `frequency_response` into a figure or a part of one."""
    model = analysis.model
    linear = analysis.linear
    found = elastic_modes(analysis)
    low, high = (found[0][0] / 8, found[-1][0] * 6) if found else (0.1, 100.0)
    f = np.unique(
        np.concatenate(
            [
                np.geomspace(low, high, 700),
                *(x * (1 + d * np.linspace(-4, 4, 41)) for x, d in found),
            ]
        )
    )
    w = 2 * np.pi * f[(f >= low) & (f <= high)]
    # of the tool its position; of joints all
    position = slice(0, len(model.output.axes) or None)
    to_motor, to_output = (
        w[:, None, None] ** 2 * np.abs(linear.response(w, C))
        for C in (linear.C_m, linear.W[position])
    )
    unit = model.output.unit if model.output.type == "combination" else "m"
    name = "output" if model.output.type == "combination" else "tool"
    panels = [
        (
            np.einsum("kjj->kj", to_motor),
            "motor torque to acceleration of the same motor",
            "rad/s²",
        ),
        (
            np.linalg.norm(to_output, axis=1),
            f"motor torque to acceleration of the {name}",
            f"{unit}/s²",
        ),
    ]
    axes = figure.subplots(2, 1, sharex=True)
    for ax, (values, title, of) in zip(axes, panels, strict=True):
        level = 20 * np.log10(np.maximum(values, 1e-300))
        for j, motor in enumerate(model.motors):
            ax.plot(
                w / 2 / np.pi,
                level[:, j],
                color=cv.COLORS[j % 7],
                ls=cv.DASHES[j // 7 % 3],
                lw=1.3,
                label=motor.name,
            )
        top = level.max()
        ax.set_ylim(max(level.min(), top - 200) - 6, top + 8)
        ax.set_ylabel(f"dB re 1 {of}/(N m)")
        ax.set_title(title)
        for frequency, _ in found:
            ax.axvline(frequency, color=cv.GREY, lw=0.6, ls=(0, (6, 4)), zorder=0)
    axes[1].set(xscale="log", xlim=(low, high), xlabel="frequency, Hz")
    axes[1].xaxis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0) if high < 500 * low else (1.0,))
    )
    axes[1].xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes[1].xaxis.set_minor_formatter(NullFormatter())
    placed = 0.0
    for frequency, _ in found:
        if frequency > (high / low) ** 0.075 * placed:
            axes[0].annotate(
                f"{frequency:.3g} Hz",
                (frequency, 1),
                xycoords=("data", "axes fraction"),
                xytext=(2, -1),
                textcoords="offset points",
                va="top",
                fontsize=7.5,
                color=cv.GREY,
                bbox=cv.BACKGROUND,
            )
            placed = frequency
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=8)
