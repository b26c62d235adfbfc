"""The report of a solution: one self-contained HTML page with its figures, tables and pictures."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from flexgen import __version__
from flexgen.analysis.analyze import Analysis, analyze
from flexgen.analysis.zeros import ON_AXIS
from flexgen.analysis.zeros_along_path import ZeroPath, zero_path
from flexgen.errors import SolverError
from flexgen.inversion.bounds import Limits
from flexgen.inversion.comparison import error_rows
from flexgen.inversion.solution import Figure, Solution
from flexgen.inversion.status import Status
from flexgen.mechanics.equations import Equations
from flexgen.model.elements import Friction, Motor, RobotModel
from flexgen.paths.path import Path as ToolPath
from flexgen.plots import along_path
from flexgen.plots import solution as figures_of
from flexgen.plots.canvas import measure, title_of

_CSS = """
body { font: 16px/1.5 "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; color: #222; background: #fff;
  max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; } h2 { font-size: 1.2rem; margin: 2.2rem 0 .5rem; }
.sub { color: #555; margin: 0 0 1rem; } .source { color: #555; font-size: .85rem; white-space: pre-line; }
.status { display: inline-block; padding: .05rem .6rem; border-radius: .3rem; color: #fff; background: #00694d; }
.status.bad { background: #b34700; }
.warn { border-left: 4px solid #D55E00; background: #fdf3ec; padding: .5rem .9rem; margin: 1rem 0; }
.warn ul { margin: 0; padding-left: 1.1rem; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .2rem 1.1rem .2rem 0; border-bottom: 1px solid #ddd; vertical-align: top; }
th { font-weight: 600; border-bottom: 2px solid #888; } td.n, th.n { text-align: right; white-space: nowrap; }
figure { margin: 1.4rem 0 2rem; break-inside: avoid; } figure svg { max-width: 100%; height: auto; display: block; }
figcaption { font-size: .9rem; color: #444; max-width: 46rem; margin-top: .3rem; }
sup { line-height: 0; }
.wide { overflow-x: auto; } footer { color: #777; font-size: .8rem; margin-top: 3rem; border-top: 1px solid #ddd; }
@media print { body { margin: 0; max-width: none; font-size: 11pt; } tr { break-inside: avoid; } }
"""


_FALLING = (
    "Near the origin, a pole in the right half plane is the arm falling under gravity with free motors, not a fault of "
    "the controller."
)


def _number(x: float | None, digits: int = 4) -> str:
    """A number for people, ``5.065·10<sup>-4</sup>``; a dash for None."""
    if x is None or not np.isfinite(x):
        return "\N{EN DASH}"
    text = f"{x:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·10<sup>{int(exponent)}</sup>"
    return text.replace("-", "\N{MINUS SIGN}")


def _measure(value: float, unit: str) -> tuple[str, str]:
    """A size and its unit with a prefix."""
    number, shown = measure(value, unit)
    return html.escape(number), html.escape(shown)


def _complex(z: complex) -> str:
    """A root without what is rounding."""
    size = abs(z)
    re_, im = (0.0 if abs(x) < 1e-7 * size else x for x in (z.real, z.imag))
    if im == 0:
        return _number(re_)
    sign = "+" if im > 0 else "\N{MINUS SIGN}"
    return f"{_number(re_) if re_ else '0'} {sign} {_number(abs(im))} i"


def _table(head: Iterable[str], rows: Iterable[Iterable[str]], numeric: Iterable[int] = ()) -> str:
    """A table of ready HTML; the columns ``numeric`` are set flush right."""
    right = set(numeric)

    def row(cells: Iterable[str], tag: str) -> str:
        out = (f"<{tag}{' class=n' if k in right else ''}>{cell}</{tag}>" for k, cell in enumerate(cells))
        return f"<tr>{''.join(out)}</tr>".replace("class=n", 'class="n"')

    body = "\n".join(row(cells, "td") for cells in rows)
    return f'<div class="wide"><table><thead>{row(head, "th")}</thead><tbody>\n{body}\n</tbody></table></div>\n'


def _summary(solution: Solution) -> str:
    t = solution.trajectory.time
    rows = [_summary_row(figure) for figure in solution.figures() if figure.value is not None]
    if solution.simulation is None:
        rows.append(("verification", "not done", ""))
    rows += [
        ("duration of the path", _number(solution.move.duration), "s"),
        ("samples of the trajectory", f"{len(t)} from {_number(t[0])} to {_number(t[-1])} s", ""),
    ]
    note = (
        "<p>The limits keep the motion off the path. The error from the modified path shows how well this torque "
        "tracks the planned motion.</p>\n"
    )
    return _table(("what", "value", "unit"), rows, (1,)) + (note if solution.plan_error_max is not None else "")


def _summary_row(figure: Figure) -> tuple[str, str, str]:
    """A row of the summary; status as a colored label, lengths and angles with a prefix."""
    label, value, unit, key = figure
    if key == "status":
        bad = "" if value == Status.SOLVED else " bad"
        return label, f'<span class="status{bad}">{html.escape(str(value))}</span>', ""
    if isinstance(value, float) and unit in ("m", "rad"):
        return label, *_measure(value, unit)
    if isinstance(value, float):
        return label, _number(value), unit
    return label, html.escape(str(value)) or "\N{EN DASH}", unit


def _is_limited(solution: Solution) -> bool:
    """Whether limits keep the motion off the path."""
    return solution.status == Status.LIMITS_ACTIVE or solution.plan_error_max is not None


def _friction(f: Friction) -> str:
    named = [("viscous", f.viscous), ("Coulomb", f.coulomb), ("Stribeck", f.stribeck), ("offset", f.offset)]
    return ", ".join(f"{name} {_number(value)}" for name, value in named if value) or "none"


def _motors(model: RobotModel, solution: Solution, limits: Limits) -> str:
    tau, v = solution.trajectory["tau_m"], solution.trajectory["v_m"]

    def row(j: int, motor: Motor) -> tuple[str, ...]:
        drives = ", ".join(
            f"{html.escape(name)} ({_number(ratio)})" for name, ratio in zip(motor.drives, motor.ratio, strict=True)
        )
        torque = motor.torque_max if limits.torque is None else limits.torque[j]
        speed = motor.speed_max if limits.speed is None else limits.speed[j]
        peaks = [(tau, torque), (v, speed)]
        cells = [f"{_number(np.abs(x[:, j]).max())} / {_number(limit)}" for x, limit in peaks]
        rms = float(np.sqrt(trapezoid(tau[:, j] ** 2, solution.trajectory.time) / np.ptp(solution.trajectory.time)))
        return (
            html.escape(motor.name),
            drives,
            _number(motor.inertia),
            _friction(motor.friction),
            cells[0],
            _number(rms),
            cells[1],
        )

    head = (
        "motor",
        "drives (ratio)",
        "inertia, kg m²",
        "friction",
        "torque / limit, N m",
        "rms torque, N m",
        "speed / limit, rad/s",
    )
    return _table(head, (row(j, motor) for j, motor in enumerate(model.motors)), (2, 4, 5, 6))


def _dynamics(analysis: Analysis) -> str:
    """Tables of modes and zeros."""
    top = max((f for f, _ in analysis.modes), default=0.0)
    modes = [(f, d) for f, d in analysis.modes if f > 1e-6 * top]
    out = ["<h3>Modes</h3>\n"]
    if modes:
        rows = ((str(k + 1), _number(f), _number(100 * d, 3)) for k, (f, d) in enumerate(modes))
        out.append(_table(("mode", "frequency, Hz", "damping, % of critical"), rows, (0, 1, 2)))
    else:
        out.append("<p>No oscillatory mode.</p>\n")
    out.append("<h3>Zeros of the output</h3>\n")
    zeros = [z for z in analysis.zeros.zeros if z.imag >= -1e-9 * abs(z)]
    if zeros:
        written = ((f"{_complex(z)} and its conjugate" if z.imag > 1e-7 * abs(z) else _complex(z), z) for z in zeros)
        sides = ((text, _side(z)) for text, z in written)
        out.append(_table(("zero, 1/s", ""), sides))
    out.append(f"<p>{html.escape(figures_of.verdict(analysis).capitalize())}.")
    if analysis.zeros.preview_s > 0:
        out.append(f" Five time constants of preview are {_number(1e3 * analysis.zeros.preview_s, 3)} ms.")
    return "".join([*out, "</p>\n"])


def _side(z: complex) -> str:
    return "unstable" if z.real > ON_AXIS * abs(z) else "stable" if z.real < -ON_AXIS * abs(z) else "on the axis"


def _analysis(equations: Equations, solution: Solution) -> Analysis | None:
    """The machine at the start of the move; None where it has no equilibrium there."""
    try:
        return analyze(equations, solution.move.start)
    except SolverError:
        return None


def _pictures(
    equations: Equations, solution: Solution, analysis: Analysis | None, limits: Limits
) -> list[tuple[str, Any, str]]:
    """Name, figure and caption of each picture."""
    trajectory, simulation, model = solution.trajectory, solution.simulation, equations.model
    given = (equations, trajectory, simulation)
    end = solution.move.duration
    source = "planned" if simulation is None else "simulated"
    limited = " Limits keep the machine off the path." if _is_limited(solution) else ""
    exact = analysis if solution.method != "full" else None  # the optimum of the full model is free before the path
    unstable = exact is not None and exact.zeros.phase == "non-minimum phase"
    early = (
        "It begins before the path because the zero dynamics is unstable, and only what comes beforehand keeps it "
        "bounded; below, on a logarithmic scale, this early torque and the slope of the slowest unstable zero (dashed)."
        if unstable and trajectory.time[0] < 0
        else "Before the path it follows from the optimisation, which weighs the tool's error against steps of torque."
        if exact is None
        else "Where no zero is unstable, nothing has to happen before the path."
    )
    out = [
        (
            "robot",
            figures_of.robot(*given, end=end),
            f"The machine along the move; the {source} path and its reference.{limited}",
        ),
        (
            "torques",
            figures_of.torques(*given, analysis=exact, end=end, limits=limits.torque),
            f"Torque of each motor. {early}{limited}",
        ),
        (
            "speeds",
            figures_of.speeds(*given, end=end, limits=limits.speed),
            "Speed of each motor; dashed: its limits, where they are near.",
        ),
    ]
    if figures_of.elastic_groups(equations, trajectory):
        text = (
            "What bends: coordinates without a motor and twists of the gears; at rest they show the sag under gravity."
        )
        out.append(("deflections", figures_of.deflections(*given, end=end), text))
    if simulation is not None and "error" in simulation.trajectory.channels:
        text = (
            "Error of the full model, simulated forward under this torque by an integrator independent of the solver."
        )
        out.append(("errors", figures_of.errors(*given, end=end), text + limited))
    if analysis is not None:
        what = "output" if model.output.type == "combination" else "tool"
        text = f"Poles and zeros at the start of the move: {figures_of.verdict(analysis)}."
        if figures_of.falls(analysis):
            text += f" {_FALLING}"
        out.append(("pole_zero_map", figures_of.pole_zero_map(analysis), text))
        text = (
            "Resonances show as peaks, dashed lines mark the modes; the dips of the upper panel are the frequencies at "
            f"which the machine swings against a standing motor; below, what reaches the {what}."
        )
        out.append(("frequency_response", figures_of.frequency_response(analysis), text))
    return out


def _zeros_along(equations: Equations, solution: Solution) -> ZeroPath | None:
    """Zeros of the poses along the path; None where there are none to show."""
    if not (equations.model.n_e and equations.model.inversion_obstacle() is None):
        return None
    try:
        found = zero_path(equations, ToolPath(equations, solution.move))
    except SolverError:
        return None
    return found if np.isfinite(found.zeros).any() else None


def _comparison(beside: tuple[Solution, ...]) -> str:
    """Table of the tool errors of several methods."""
    rows = error_rows(beside)
    units = [unit for unit in ("m", "rad") if any(f"largest_{unit}" in row for row in rows)]
    head = ["method"] + [f"{what}, {unit}" for unit in units for what in ("at the start", "largest")]
    cells = [
        [html.escape(row["method"])]
        + [_number(row.get(f"{what}_{unit}"), 3) for unit in units for what in ("start", "largest")]
        for row in rows
    ]
    told = (
        "<p>The same move with the torque of simpler models, simulated open loop on the full model from rest: rigid "
        "(all springs stiff), fjm (elastic gears only), quasistatic (deflections follow their loads at once). The "
        "error at the start is what the arm sags where a model does not know of it.</p>\n"
    )
    return "<h2>Tool error by method</h2>\n" + told + _table(head, cells, range(1, len(head)))


def _robustness(rows: list[dict[str, Any]]) -> str:
    """Tables of the largest tool errors on machines that differ from the model: plants down, methods across."""
    methods, plants = (list(dict.fromkeys(row[key] for row in rows)) for key in ("method", "plant"))
    told = {
        "feedback": "torque and motor references with a cascade of speed and position control at the motors",
        "feedforward": "torque alone, open loop",
    }
    out = ["<h2>Robustness</h2>\n<p>Largest tool error on machines that differ from the model.</p>\n"]
    for control in sorted({row["control"] for row in rows}):
        for unit in ("m", "rad"):
            errors = {
                (row["plant"], row["method"]): row[f"error_max_{unit}"] for row in rows if row["control"] == control
            }
            if any(error is None for error in errors.values()):
                continue
            cells = [
                [html.escape(plant), *(" ".join(_measure(errors[plant, method], unit)) for method in methods)]
                for plant in plants
            ]
            what = "distance" if unit == "m" else "angle"
            out.append(f"<h3>{control.capitalize()}, {what}: {told[control]}</h3>\n")
            out.append(_table(["machine", *map(html.escape, methods)], cells, range(1, len(methods) + 1)))
    return "".join(out)


def _generated(generated: Any) -> str:
    """The C library, where one was made."""
    if generated is None:
        return ""
    rows = [
        ("functions", html.escape(", ".join(generated.functions))),
        ("files", html.escape(", ".join(Path(file).name for file in generated.files))),
        ("digest", f"<code>{html.escape(generated.digest[:16])}</code>"),
    ]
    return "<h2>C library</h2>\n" + _table(("what", ""), rows)


def write_report(
    equations: Equations,
    solution: Solution,
    directory: str | Path,
    analysis: Analysis | None = None,
    generated: Any = None,
    *,
    limits: Limits | None = None,
    beside: tuple[Solution, ...] = (),
    robustness: list[dict[str, Any]] | None = None,
) -> Path:
    """Write the report of a solution: ``index.html``, which needs no other file, and each picture as svg beside it.

    Parameters
    ----------
    equations : Equations
        Of the solution's model.
    solution : Solution
        With or without a verification.
    directory : str or Path
        Made where it does not exist.
    analysis : Analysis, optional
        Default: at the start of the move.
    generated : Generated, optional
        The C library, to be listed.
    limits : Limits, optional
        Bounds that the solution was made with; default: those of the model file.
    beside : tuple of Solution
        The solution among others of the same move, as `flexgen.inversion.comparison.compare_methods` finds them, to be
        shown together.
    robustness : list of dict, optional
        Rows of `flexgen.inversion.robustness.compare_plants`.

    Returns
    -------
    Path
        The page.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    model, move = equations.model, solution.move
    analysis = analysis if analysis is not None else _analysis(equations, solution)
    shown = []
    drawn = _pictures(equations, solution, analysis, limits or Limits())
    along = _zeros_along(equations, solution)
    if along is not None:
        caption = f"Zeros of the poses of rest along the path: {along.verdict}."
        drawn.append(("zeros_along", along_path.zeros_along(equations.model, along), caption))
    verified = tuple(s for s in beside if s.simulation is not None)
    if len(verified) > 1:
        caption = "Tool error of the full model under the torques of several methods, simulated open loop from rest."
        drawn.append(("methods", along_path.errors_of_methods(model, verified), caption))
    for name, figure, caption in drawn:
        figures_of.save(figure, directory / f"{name}.svg")
        label = f'<svg role="img" aria-label="{html.escape(caption)}" '
        drawing = re.sub(r"^<svg ", label, figures_of.svg(figure, f"{name}-"))
        shown.append(f'<figure id="{name}">\n{drawing}<figcaption>{html.escape(caption)}</figcaption>\n</figure>\n')
    title = f"{title_of(model)}, move {move.name}"
    warnings = "".join(f"<li>{html.escape(line)}</li>" for line in solution.warnings)
    counts = (
        f"{model.n_m} motors, {model.n_g} actuated and {model.n_e} elastic coordinates, {model.dof} degrees of freedom"
    )
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
        f"<title>{html.escape(title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n",
        f"<h1>{html.escape(title)}</h1>\n",
        f'<p class="sub">{html.escape(model.description)}. {html.escape(counts)}.</p>\n',
        f'<div class="warn"><ul>{warnings}</ul></div>\n' if warnings else "",
        "<h2>Summary</h2>\n",
        _summary(solution),
        "<h2>Pictures</h2>\n",
        *shown,
        _comparison(verified) if len(verified) > 1 else "",
        _robustness(robustness) if robustness else "",
        "<h2>Motors</h2>\n",
        _motors(model, solution, limits or Limits()),
        "<h2>Dynamics at the start of the move</h2>\n" + _dynamics(analysis) if analysis is not None else "",
        _generated(generated),
        f'<h2>Source of the model</h2>\n<p class="source">{html.escape(model.source.strip())}</p>\n'
        if model.source
        else "",
        f"<footer><p>flexgen {html.escape(__version__)}</p></footer>\n</body>\n</html>\n",
    ]
    page = directory / "index.html"
    page.write_text("".join(parts), encoding="utf-8", newline="\n")
    return page


def write_analysis(analysis: Analysis, directory: str | Path) -> list[Path]:
    """Write pole-zero map, frequency response and, with a path, the zeros along it, each as svg and png.

    Returns
    -------
    list of Path
        The files.
    """
    drawn = {
        "pole_zero_map": figures_of.pole_zero_map(analysis),
        "frequency_response": figures_of.frequency_response(analysis),
    }
    if analysis.zero_path is not None and np.isfinite(analysis.zero_path.zeros).any():
        drawn["zeros_along"] = along_path.zeros_along(analysis.model, analysis.zero_path)
    directory = Path(directory)
    return [
        figures_of.save(figure, directory / f"{name}.{end}") for name, figure in drawn.items() for end in ("svg", "png")
    ]
