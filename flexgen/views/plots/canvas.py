"""Common parts of all plots: style, colors, axes and files.

Figures are built without pyplot and under their own settings, which are restored afterwards; the
figures and the style of the caller stay unchanged. Colors: M. Okabe and K. Ito, Color Universal
Design, 2008 (for color-blind readers).
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import atomic_file, write_text
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.equations import Equations

BLUE: str = "#0072B2"
ORANGE: str = "#E69F00"
GREEN: str = "#009E73"
RED: str = "#D55E00"
PURPLE: str = "#CC79A7"
SKY: str = "#56B4E9"
INK = "#222222"
GREY = "#777777"
PALE = "#F1F1EE"
COLORS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, INK)
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)))
WIDTH = 8.6  # inches
AFTER = 3.0  # durations of a path, at most, are drawn after its end
BACKGROUND = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # of a text over lines
# least value, factor, prefix
_PREFIXES = ((1.0, 1.0, ""), (1e-3, 1e3, "m"), (1e-7, 1e6, "µ"), (0.0, 1e9, "n"))

_OURS = re.compile(
    r"(axes|font|grid|hatch|legend|lines|mathtext|patch|path|svg|text|[xy]tick|[xy]axis|scatter|"
    r"markers)\."
)
_STYLE = {key: value for key, value in matplotlib.rcParamsDefault.items() if _OURS.match(key)} | {
    "axes.axisbelow": True,
    "axes.edgecolor": GREY,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlepad": 5,
    "axes.titlesize": 9.5,
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "svg.fonttype": "path",
    "svg.hashsalt": "flexgen",
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": GREY,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.color": GREY,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8.5,
}


P = ParamSpec("P")
R = TypeVar("R")


def apply_style(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function under the settings of this module."""

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(_STYLE):
            return function(*args, **kwargs)

    return run


# --- files ---------------------------------------------------------------------------------------


@apply_style
def svg(figure: Figure, prefix: str = "") -> str:
    """The figure as the text of an ``<svg>`` element.

    Parameters
    ----------
    figure : Figure
    prefix : str
        Prefix of every id, for several figures in one page.
    """
    stream = io.StringIO()
    empty = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    FigureCanvasSVG(figure).print_svg(stream, metadata=empty)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{prefix}", text)


@provides("Result.picture")
@apply_style
def save(figure: Figure, path: str | Path, dpi: float = 150.0) -> Path:
    """Write a figure to a ``.svg`` or ``.png`` file, the latter with ``dpi`` pixels an inch; equal
    figures give equal bytes.

    Raises
    ------
    ArgumentError
        The name has another ending, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".svg", ".png"):
        raise ArgumentError(
            f"figure: given {path.name!r}, expected a file name ending in .svg or .png"
        )
    if path.suffix == ".svg":
        return write_text(
            path, f'<?xml version="1.0" encoding="utf-8"?>\n<!-- flexgen -->\n{svg(figure)}'
        )
    figure.set_dpi(dpi)
    with atomic_file(path) as stream:
        FigureCanvasAgg(figure).print_png(stream, metadata={"Software": "flexgen"})
    return path


# --- helpers -------------------------------------------------------------------------------------


def power(x: float, _: Any = None) -> str:
    """Tick label of a logarithmic axis at ``x``, a power of ten: ``10⁻³``, 1 or 10. The second
    argument, the position that matplotlib gives, is not used.
    """
    if x == 0:
        return "0"
    size = round(np.log10(abs(x)))
    raised = {0: "1", 1: "10"}.get(
        size, "10" + str(size).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    )
    return f"\N{MINUS SIGN}{raised}" if x < 0 else raised


def log_axis(axis: Any, ticks: int = 6) -> None:
    """Set labeled ticks of a logarithmic axis that has its limits: powers of ten, more numbers on
    a short axis.
    """
    low, high = sorted(axis.get_view_interval())
    if high / low < 3:
        axis.set_major_locator(MaxNLocator(5))
    elif high / low < 30:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    else:
        axis.set_major_locator(LogLocator(numticks=ticks))
    axis.set_major_formatter(FuncFormatter(power if high / low >= 30 else lambda x, _: f"{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def choose_prefix(largest: float, unit: str) -> tuple[float, str]:
    """Factor and prefixed unit for a value: nm below 0.1 µm, µm, mm from 1000 µm on, m; the same
    for rad.

    ``unit`` may be ``"rad or m"``; other units get no prefix.
    """
    if not set(unit.split(" or ")) <= {"m", "rad"}:
        return 1.0, unit
    size = float(f"{abs(largest):.3g}")
    factor, prefix = next((f, p) for least, f, p in _PREFIXES if size >= least)
    return factor, " or ".join(prefix + part for part in unit.split(" or "))


def measure(value: float, unit: str) -> tuple[str, str]:
    """A value >= 0 as text with three digits, and its prefixed unit."""
    factor, shown = choose_prefix(value, unit)
    number = float(f"{factor * value:.3g}")
    if 0 < number < 1e-3:
        return "< 0.001", shown
    return f"{number:.0f}" if number >= 1e3 else f"{number:.3g}", shown


def path_end(equations: Equations, trajectory: Trajectory) -> float:
    """Time at which the reference comes to rest [s], read from the trajectory."""
    if "y_ref" not in trajectory.channels:
        return float(trajectory.time[-1])
    t = trajectory.time
    y = trajectory["y_ref"]
    if "R_ref" in trajectory.channels:
        y = np.hstack([y, trajectory["R_ref"]])
    moving = np.abs(y - y[-1]).max(axis=1) > 1e-14 * max(1.0, float(np.abs(y).max()))
    found_end = float(t[min(int(np.flatnonzero(moving).max(initial=0)) + 1, len(t) - 1)])
    # the last changes of a smooth law are below rounding: use the duration of the move if it is in
    # the model
    for move in equations.model.moves:
        if (
            move.name == trajectory.meta.get("move")
            and 0 <= move.duration - found_end <= 0.1 * move.duration
        ):
            return move.duration
    return found_end


def hold(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Change of the motor torques from the initial equilibrium (n, n_m), and their range (n_m) [N
    m].
    """
    t = trajectory.time
    tau = trajectory["tau_m"]
    initial = np.median(tau[t <= t[0] / 2], axis=0) if t[0] < 0 else tau[0]
    return np.abs(tau - initial), np.ptp(tau, axis=0)


def begin(trajectory: Trajectory, end: float) -> float:
    """Start of plots over time [s]: shortly before the first visible change of torque."""
    t = trajectory.time
    away, span = hold(trajectory)
    early = (away > 1e-3 * np.maximum(span, 1e-12)).any(axis=1)
    first = t[int(np.argmax(early))] if early.any() else 0.0
    return float(max(t[0], min(first, 0.0) - 0.06 * end))


def finish(trajectory: Trajectory, end: float) -> float:
    """End of plots over time [s]: shortly after the last visible change of torque, and after the
    path.
    """
    t = trajectory.time
    tau = trajectory["tau_m"]
    away = np.abs(tau - tau[-1]) > 1e-3 * np.maximum(np.ptp(tau, axis=0), 1e-12)
    changing = np.flatnonzero(away.any(axis=1))
    last = t[changing[-1]] if len(changing) else end
    return float(min(t[-1], max(last, end) + 0.1 * end, longest(end)))


def longest(end: float) -> float:
    """Latest end of plots over time [s]: of vibrations that decay for minutes after a short path
    only the first.
    """
    return (1 + AFTER) * end


def time_axis(ax: Any, first: float, end: float, last: float, label: bool = True) -> None:
    """Set the limits of a time axis to ``first`` and ``last`` [s]; mark start, 0, and ``end`` of
    the path, and shade the time outside of it. ``label``: also name the axis.
    """
    until = max((float(np.max(line.get_xdata())) for line in ax.lines), default=last)
    ax.set_xlim(first, last)
    for a, b in ((first, 0.0), (end, last)):
        if b > a:
            ax.axvspan(a, b, color=PALE, lw=0, zorder=0)
    for x in (0.0, end):
        ax.axvline(x, color=GREY, lw=0.8, zorder=1)
    if label:
        notes = ["shaded: before and after the path"] if first < 0 or last > end else []
        notes += [f"the motion ends at {until:.3g} s"] if until > 1.5 * last else []
        ax.set_xlabel("time, s" + (f"   ({'; '.join(notes)})" if notes else ""))


class NotebookFigure(Figure):
    """A matplotlib Figure that a notebook shows without pyplot."""

    def _repr_svg_(self) -> str:
        """The picture for a notebook."""
        return svg(self)


def new_figure(width: float, height: float, title: str, layout: bool = True) -> Figure:
    """An empty white figure with the title on the left; sizes in inches; ``layout``: automatic
    layout of the axes.
    """
    engine = (
        ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.05, hspace=0.03, wspace=0.03)
        if layout
        else None
    )
    figure = NotebookFigure(figsize=(width, height), layout=engine, facecolor="white")
    FigureCanvasAgg(figure)
    if title:
        # y switches the automatic layout off
        position = {} if layout else {"y": 1 - 0.07 / height}
        size = min(11.0, 104.0 * width / len(title))  # smaller for long titles
        figure.suptitle(
            title,
            x=0.07 / width,
            ha="left",
            va="top",
            fontsize=size,
            fontweight="bold",
            **position,
        )
    return figure
