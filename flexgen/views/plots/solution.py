"""Plots of a robot, its solution and its dynamics: matplotlib figures for files, reports and
notebooks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flexgen.analysis.analyze import Analysis
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.motor_harmonics import gear_angles_along
from flexgen.inversion.solution import Solution
from flexgen.simulation.result import Simulation
from flexgen.views.plots import canvas as cv
from flexgen.views.plots.canvas import save, svg
from flexgen.views.plots.linear import (
    falls_under_gravity,
    frequency_response,
    phase_summary,
    pole_zero_map,
)
from flexgen.views.plots.stick_figure import draw_view, handles, scene, spans

__all__ = [
    "deflections",
    "errors",
    "falls_under_gravity",
    "frequency_response",
    "overview",
    "phase_summary",
    "pole_zero_map",
    "robot",
    "save",
    "speeds",
    "svg",
    "torques",
]

# of the range of the torque: changes before the path that a panel on a linear axis shows
VISIBLE = 1e-3
EARLY = 1e-7  # of the range of the torque; smaller changes before the path are not drawn
ROUNDING = 1e-12  # rad or m; smaller deflections are drawn as zero
LEGEND = 2.9, 0.19  # inches: width, and height of an entry
ZERO = 1e-6  # of the largest value of all motors; a smaller signal is drawn as zero


# --- over time -----------------------------------------------------------------------------------


def _title(equations: Equations, trajectory: Trajectory, text: str) -> str:
    move = trajectory.meta.get("move")
    return f"{equations.model.title}{f', move {move}' if move else ''}: {text}"


def _window(
    equations: Equations, trajectory: Trajectory, end: float | None
) -> tuple[float, float, float]:
    """Start of the plot, end of the path and end of the plot [s]."""
    stop = cv.path_end(equations, trajectory) if end is None else end
    return cv.begin(trajectory, stop), stop, float(min(trajectory.time[-1], cv.longest(stop)))


def _limits(ax: Any, values: np.ndarray, bound: float | None, largest: float, unit: str) -> None:
    """Set the limits of the axis of one motor; draw its bound [unit] as dashed lines if it is
    near, else print it.

    ``values`` (n,): its signal; ``bound``: None or infinite where there is none; ``largest``:
    largest value of all motors; a signal that is zero in comparison gets an axis of that size.
    """
    low = float(min(values.min(), 0.0))
    high = float(max(values.max(), 0.0))
    size = max(-low, high)
    bound = bound if bound is not None and np.isfinite(bound) else None
    near = bound is not None and bound <= 2.5 * size
    if near and bound is not None:
        for sign in (-1, 1):
            if sign * (high if sign > 0 else low) > 0.4 * bound:
                ax.axhline(sign * bound, color=cv.RED, lw=1.1, ls=(0, (4, 3)), zorder=2)
                low = min(low, sign * bound)
                high = max(high, sign * bound)
    if bound is not None:
        text = f"limit ±{bound:.4g} {unit}"
        ax.set_title(text, loc="right", fontsize=8, color=cv.RED if near else cv.GREY)
    if high - low <= ZERO * largest:
        low = -0.1 * largest
        high = 0.1 * largest
    margin = 0.09 * (high - low)
    ax.set_ylim(low - margin, high + margin)


def _per_motor(
    figure: Any,
    equations: Equations,
    trajectory: Trajectory,
    channel: str,
    bounds: Sequence[float | None],
    window: tuple[float, float, float],
    label: str,
) -> None:
    """Draw the ``channel`` of a trajectory in one panel per motor: one column for up to three
    motors, else two.

    ``bounds``: limit of each motor; ``window``: begin of the axis, end of the path, end of the
    axis [s]; ``label``: name of the quantity.
    """
    model = equations.model
    t = trajectory.time
    values = trajectory[channel]
    columns = 1 if model.n_m <= 3 else 2
    rows = -(-model.n_m // columns)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    largest = float(np.abs(values).max()) or 1.0
    unit = trajectory.ports[channel].unit
    for j, ax in enumerate(axes.T.ravel()):
        if j >= model.n_m:
            ax.set_visible(False)
            continue
        ax.axhline(0.0, color=cv.GREY, lw=0.6, zorder=1)
        shown = (t >= window[0]) & (t <= window[2])
        ax.plot(t[shown], values[shown, j], color=cv.BLUE, zorder=4)
        _limits(ax, values[:, j], bounds[j], largest, unit)
        bottom = j % rows == rows - 1 or j == model.n_m - 1
        cv.time_axis(ax, *window, label=bottom)
        ax.tick_params(labelbottom=bottom)
        ax.set_title(model.motors[j].name, fontweight="bold")
        ax.set_ylabel(f"{label}, {unit}")


def _acts_early(trajectory: Trajectory, analysis: Analysis | None) -> bool:
    """Whether unstable zeros make the torque change before the path."""
    before = trajectory.time < 0
    if not before.any() or analysis is None or analysis.zeros.phase != "non-minimum phase":
        return False
    # such a motion may start early because of its limits
    if trajectory.meta.get("torque") == "limited":
        return False
    away, span = cv.hold(trajectory)
    return bool((away[before] > EARLY * np.maximum(span, 1e-12)).any())


def _early(ax: Any, equations: Equations, trajectory: Trajectory, T: float) -> None:
    """Change of the torque before the path on a logarithmic axis, with the line ``exp(t / T)`` of
    the slowest unstable zero, whose time constant is T [s].
    """
    away, span = cv.hold(trajectory)
    t = trajectory.time
    floor = 1e-3 * EARLY * float(span.max())
    above = (away > floor).any(axis=1)
    first = float(min(t[int(np.argmax(above))], 0.0))
    first = max(first, -12 * T)
    last = min(0.6 * -first, float(t[-1]))
    shown = (t >= first) & (t <= last)
    for j, motor in enumerate(equations.model.motors):
        y = np.where(away[shown, j] > floor, away[shown, j], np.nan)
        ax.semilogy(
            1e3 * t[shown], y, color=cv.COLORS[j % 7], ls=cv.DASHES[j // 7 % 3], label=motor.name
        )
    top = float(away[shown].max())
    begun = float(away[t <= 0][-1].max())
    grid = np.linspace(first, 0.0, 50)
    line = 4 * begun * np.exp(grid / T)
    label = f"exp(t / {1e3 * T:.3g} ms)"
    ax.plot(
        1e3 * grid[line > floor],
        line[line > floor],
        color=cv.INK,
        lw=1,
        ls=(0, (2, 2)),
        label=label,
    )
    cv.time_axis(ax, 1e3 * first, 1e3 * max(last, 1e-3) + 1, 1e3 * last)
    ax.set_ylim(max(floor, 1e-5 * begun), 3 * top)
    cv.log_axis(ax.yaxis)
    ax.set(
        xlabel="time, ms",
        ylabel="change of torque, N m",
        title="torque before the path starts at t = 0",
    )
    ax.legend(loc="upper left", ncols=2 if equations.model.n_m > 3 else 1)


@cv.apply_style
def torques(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None = None,
    *,
    end: float | None = None,
    analysis: Analysis | None = None,
    limits: Sequence[float] | None = None,
) -> Figure:
    """Motor torques over time, one panel per motor [N m, motor side].

    Parameters
    ----------
    equations : Equations
    trajectory : Trajectory
        As `flexgen.solve` returns it.
    simulation : Simulation, optional
        Not needed; the torque is the one that was simulated.
    end : float, optional [s]
        End of the path; default: read from the reference.
    analysis : Analysis, optional
        If it has unstable zeros, one more panel shows the torque before the path and the slope of
        the slowest zero.
    limits : sequence of n_m floats, optional [N m]
        Limits to draw; default: those of the model file.
    """
    model = equations.model
    window = _window(equations, trajectory, end)
    early = _acts_early(trajectory, analysis)
    rows = model.n_m if model.n_m <= 3 else -(-model.n_m // 2)
    height = 0.7 + 1.55 * rows
    extra = 2.7 if early else 0.0
    figure = cv.new_figure(
        cv.WIDTH, height + extra, _title(equations, trajectory, "motor torques, motor side")
    )
    parts: Any = figure.subfigures(2, 1, height_ratios=[height, extra]) if early else [figure]
    bounds: Sequence[float | None] = (
        [m.torque_max for m in model.motors] if limits is None else list(limits)
    )
    _per_motor(parts[0], equations, trajectory, "tau_m", bounds, window, "torque")
    if early and analysis is not None:
        _early(parts[1].subplots(), equations, trajectory, analysis.zeros.unstable_time_constant_s)
    return figure


@cv.apply_style
def speeds(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None = None,
    *,
    end: float | None = None,
    limits: Sequence[float] | None = None,
) -> Figure:
    """Motor speeds over time, one panel per motor [rad/s, motor side]; default limits: those of
    the model file.
    """
    model = equations.model
    rows = model.n_m if model.n_m <= 3 else -(-model.n_m // 2)
    figure = cv.new_figure(
        cv.WIDTH, 0.7 + 1.55 * rows, _title(equations, trajectory, "motor speeds, motor side")
    )
    bounds: Sequence[float | None] = (
        [m.speed_max for m in model.motors] if limits is None else list(limits)
    )
    _per_motor(
        figure, equations, trajectory, "v_m", bounds, _window(equations, trajectory, end), "speed"
    )
    return figure


def elastic_groups(
    equations: Equations, trajectory: Trajectory
) -> list[tuple[str, str, np.ndarray, list[str]]]:
    """Groups of deflections: title, unit, values (n, k) and names of non-actuated coordinates and
    of gears.
    """
    model = equations.model
    q = trajectory["q_a"]
    groups = []
    for unit, title in (
        ("rad", "elastic joints without motor"),
        ("m", "elastic translations and beam deflections"),
    ):
        chosen = [i for i in model.i_e if model.coordinates[i].unit == unit]
        groups.append((title, unit, q[:, chosen], [model.coordinates[i].name for i in chosen]))
    deflection = gear_angles_along(model, trajectory["q_m"]) - q[:, list(model.i_g)]
    for unit in ("rad", "m"):
        chosen = []
        for k, i in enumerate(model.i_g):
            dof = model.coordinates[i].dof
            if (
                model.coordinates[i].unit == unit
                and dof is not None
                and dof.gear is not None
                and not dof.gear.rigid
            ):
                chosen.append(k)
        names = [model.coordinates[model.i_g[k]].name for k in chosen]
        groups.append(
            ("deflection of the elastic gears, arm side", unit, deflection[:, chosen], names)
        )
    return [group for group in groups if group[3]]


@cv.apply_style
def deflections(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None = None,
    *,
    end: float | None = None,
) -> Figure:
    """Non-actuated coordinates and gear deflections over time; they include the sag under gravity.

    Raises
    ------
    ArgumentError
        The model has no elastic coordinate or gear.
    """
    groups = elastic_groups(equations, trajectory)
    window = _window(equations, trajectory, end)
    t = trajectory.time
    if not groups:
        raise ArgumentError(
            f"deflections: model {equations.model.name} has only rigid gears and no elastic "
            "coordinate, expected one"
        )
    figure = cv.new_figure(
        cv.WIDTH, 0.6 + 2.4 * len(groups), _title(equations, trajectory, "elastic deflections")
    )
    shown = (t >= window[0]) & (t <= window[2])
    for ax, (title, unit, values, names) in zip(
        figure.subplots(len(groups), 1, squeeze=False)[:, 0], groups, strict=True
    ):
        top = float(np.abs(values).max())
        zero = top < ROUNDING
        factor, shown_unit = cv.choose_prefix(1e-3 if zero else top, unit)
        for k, name in enumerate(names):
            ax.plot(
                t[shown],
                factor * values[shown, k],
                color=cv.COLORS[k % 7],
                ls=cv.DASHES[k // 7 % 3],
                label=name,
            )
        ax.axhline(0.0, color=cv.GREY, lw=0.6, zorder=1)
        if zero:
            ax.set_ylim(-1.0, 1.0)
        cv.time_axis(ax, *window)
        ax.set(ylabel=f"{'angle' if unit == 'rad' else 'deflection'}, {shown_unit}", title=title)
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=1 if len(names) <= 8 else 2)
    return figure


def _error_axis(
    ax: Any, t: np.ndarray, values: np.ndarray, unit: str, names: list[str], label: str
) -> None:
    """Absolute values (n, k) [unit] of the columns ``names`` on a logarithmic axis over t (n,)
    [s]; the largest value as a title.
    """
    top = float(np.abs(values).max())
    factor, shown = cv.choose_prefix(top, unit)
    size = factor * np.abs(values)
    floor = factor * max(1e-4 * top, 1e-15)
    for k, name in enumerate(names):
        ax.semilogy(
            t, np.maximum(size[:, k], 0.1 * floor), color=cv.COLORS[k % 7], lw=1.2, label=name
        )
    ax.set_ylim(floor, max(4 * factor * top, 10 * floor))
    cv.log_axis(ax.yaxis)
    ax.set_ylabel(f"{label}, {shown}")
    ax.set_title(f"largest {' '.join(cv.measure(top, unit))}", loc="right", fontsize=8.5)
    if len(names) > 1:
        ax.legend(loc="lower right", ncols=len(names))


def _error_parts(
    equations: Equations, simulation: Simulation | None
) -> list[tuple[np.ndarray, str, list[str], str]]:
    """Panels of the error: values (n, k), unit, names, label."""
    if simulation is None or "error" not in simulation.trajectory.channels:
        raise ArgumentError(
            "errors: given a solution that is not verified, expected one with a simulation"
        )
    done = simulation.trajectory
    output = equations.model.output
    if output.type == "combination":
        names = list(done.labels["error"])
        return [
            (done["error"], output.unit if output.unit != "mixed" else "rad or m", names, "error")
        ]
    error = done["error"][:, : len(output.axes)]
    parts = [(np.linalg.norm(error, axis=1)[:, None], "m", ["distance"], "distance")]
    if output.has_angle:
        of_angle = np.abs(done["error"][:, output.tool_size - 1 : output.tool_size])
        parts.append((of_angle, "rad", ["angle"], "angle"))
    if "turn" in done.channels:
        parts.append((done["turn"], "rad", ["angle"], "angle"))
    return parts


@cv.apply_style
def errors(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None,
    *,
    end: float | None = None,
) -> Figure:
    """Error of the simulated output over time on a logarithmic axis.

    Raises
    ------
    ArgumentError
        There is no simulation, or the simulation has no reference.
    """
    parts = _error_parts(equations, simulation)
    window = _window(equations, trajectory, end)
    figure = cv.new_figure(
        cv.WIDTH,
        0.6 + 2.3 * len(parts),
        _title(equations, trajectory, "simulated error from the reference"),
    )
    for ax, (values, unit, names, label) in zip(
        figure.subplots(len(parts), 1, squeeze=False)[:, 0], parts, strict=True
    ):
        _error_axis(ax, trajectory.time, values, unit, names, label)
        cv.time_axis(ax, *window)
    return figure


# --- the robot -----------------------------------------------------------------------------------


def _outputs(
    figure: Any,
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None,
    end: float,
) -> None:
    """The output over time, for robots without spatial extent."""
    model = equations.model
    t = trajectory.time
    driven = trajectory if simulation is None else simulation.trajectory
    y = evaluate(equations.function("output"), driven["q_a"])[0].reshape(len(t), -1)
    unit = model.output.unit if model.output.type == "combination" else "m"
    window = _window(equations, trajectory, end)
    name = "output" if simulation is None else "output, simulated"
    axes = figure.subplots(y.shape[1], 1, squeeze=False)[:, 0]
    for k, ax in enumerate(axes):
        ax.plot(t, y[:, k], color=cv.GREEN, lw=3.2, alpha=0.55, label=name)
        if "y_ref" in trajectory.channels:
            ax.plot(
                t,
                trajectory["y_ref"][:, k],
                color=cv.RED,
                lw=1.1,
                ls=(0, (4, 2.5)),
                label="reference",
            )
        cv.time_axis(ax, *window)
        ax.set_ylabel(
            f"output{'' if len(axes) == 1 else f' {k + 1}'}, "
            f"{unit if unit != 'mixed' else 'rad or m'}"
        )
    axes[0].legend(loc="upper left", bbox_to_anchor=(0.1, 0.97))


@cv.apply_style
def robot(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None = None,
    *,
    end: float | None = None,
) -> Figure:
    """The robot at several instants of its path, with its joints, the path of the tool and the
    reference.

    Planar robots are drawn in their plane, spatial robots in three views of equal scale. For
    robots without spatial extent (a row of masses) the output over time is drawn.

    Parameters
    ----------
    equations : Equations
    trajectory : Trajectory
        As `flexgen.solve` returns it.
    simulation : Simulation, optional
        Its tool path is drawn; without it that of the planned motion.
    end : float, optional [s]
        End of the path; default: read from the reference.
    """
    model = equations.model
    stop = cv.path_end(equations, trajectory) if end is None else end
    drawn = scene(equations, trajectory, simulation, stop)
    if not drawn.views:
        figure = cv.new_figure(cv.WIDTH, 3.4, _title(equations, trajectory, "output"))
        _outputs(figure, equations, trajectory, simulation, stop)
        return figure
    title = _title(
        equations,
        trajectory,
        f"{len(drawn.times)} instants, {drawn.times[0]:g} to {drawn.times[-1]:g} s",
    )
    size = np.ptp(spans(drawn), axis=1)
    right, up = drawn.views[0]
    spatial = len(drawn.views) > 1
    deep = next(k for k in range(3) if k not in (right, up)) if spatial else right
    wide, high = (
        (size[right] + size[deep], size[up] + size[deep]) if spatial else (size[right], size[up])
    )
    # inches per meter
    scale = min((7.0 if spatial else 5.4) / wide, (7.2 if spatial else 5.2) / high)
    gap = 0.75
    width = scale * wide + 1.0 + (gap if spatial else 2.7)
    height = scale * high + 1.05 + (gap if spatial else 0.0)
    entries = handles(model, drawn)
    height = max(height, 3.2)
    if spatial:  # the legend is below the side view, right of the top view
        width = max(width, 0.75 + scale * size[right] + gap + LEGEND[0], 0.09 * len(title))
        height = max(height, scale * size[up] + 1.05 + gap + LEGEND[1] * (len(entries) + 1))
    figure = cv.new_figure(width, height, title, layout=False)
    corners = [(0.75, height - 0.5 - scale * size[up])]  # lower left corner of each view, inches
    if spatial:
        corners += [(0.75 + scale * size[right] + gap, corners[0][1])]
        corners += [(0.75, corners[0][1] - gap - scale * size[deep])]
    for view, (x, y), label in zip(drawn.views, corners, ("front", "side", "top"), strict=False):
        box = (
            x / width,
            y / height,
            scale * size[view[0]] / width,
            scale * size[view[1]] / height,
        )
        draw_view(figure.add_axes(box), model, drawn, view, label if spatial else "")
    if spatial:
        anchor = (corners[1][0] / width, (corners[1][1] - gap) / height)
        where = "upper left"
    else:
        anchor = ((0.9 + scale * wide) / width, 0.5)
        where = "center left"
    figure.legend(handles=entries, loc=where, bbox_to_anchor=anchor)
    return figure


@provides("Solution.plot")
def plot_solution(solution: Solution) -> Figure:
    """The `overview` of a solution, see `flexgen.Solution.plot`."""
    return overview(
        derive(solution.model),
        solution.trajectory,
        solution.simulation,
        end=solution.move.duration,
    )


def _visible_early_torque(trajectory: Trajectory) -> bool:
    """Whether the torque before the path gets its own panel."""
    away, span = cv.hold(trajectory)
    return bool((away[trajectory.time <= 0] > VISIBLE * np.maximum(span, 1e-12)).any())


def _before_the_path(ax: Any, equations: Equations, trajectory: Trajectory) -> None:
    """Change of the motor torques from the equilibrium until the path starts."""
    t = trajectory.time
    tau = trajectory["tau_m"]
    before = t <= 0
    change = tau[before] - tau[0]
    size = np.abs(change).max()
    first = float(t[int(np.argmax((np.abs(change) > 1e-2 * size).any(axis=1)))])
    for j in range(equations.model.n_m):
        ax.plot(1e3 * t[before], change[:, j], color=cv.COLORS[j % 7], ls=cv.DASHES[j // 7 % 3])
    ax.set_xlim(1.1e3 * first, 0.0)
    ax.set(
        xlabel="time, ms", ylabel="change, N m", title="torques before the path starts at t = 0"
    )


@cv.apply_style
def overview(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None = None,
    *,
    end: float | None = None,
) -> Figure:
    """One figure of a solution: the robot on the left, motor torques and simulated error on the
    right.
    """
    model = equations.model
    window = _window(equations, trajectory, end)
    drawn = scene(equations, trajectory, simulation, window[1])
    verified = simulation is not None and "error" in simulation.trajectory.channels
    what = "planned motion" if trajectory.meta.get("kind") == "plan" else "inverse dynamics"
    figure = cv.new_figure(
        11.0, 4.6, _title(equations, trajectory, f"{what}, verified" if verified else what)
    )
    halves: Any = figure.subfigures(1, 2, width_ratios=[1.0, 1.15])
    left, right = halves
    if drawn.views:
        size = np.ptp(spans(drawn), axis=1)
        draw_view(
            left.subplots(),
            model,
            drawn,
            max(drawn.views, key=lambda view: size[view[0]] * size[view[1]]),
        )
        left.legend(handles=handles(model, drawn), loc="outside lower center", ncols=2)
    else:
        _outputs(left, equations, trajectory, simulation, window[1])
    first, stop, _ = window
    window = first, stop, cv.finish(trajectory, stop)
    early = _visible_early_torque(trajectory)
    axes = right.subplots(1 + early + verified, 1, squeeze=False)[:, 0]
    t = trajectory.time
    tau = trajectory["tau_m"]
    for j, motor in enumerate(model.motors):
        axes[0].plot(
            t, tau[:, j], color=cv.COLORS[j % 7], ls=cv.DASHES[j // 7 % 3], label=motor.name
        )
    axes[0].set(ylabel="torque, N m", title="motor torques, motor side")
    axes[0].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    if early:
        _before_the_path(axes[1], equations, trajectory)
    if verified:
        values, unit, names, label = _error_parts(equations, simulation)[0]
        _error_axis(axes[-1], t, values, unit, names, label)
        axes[-1].set_title("simulated error from the reference")
    for ax in axes[[0, -1]] if verified else axes[:1]:
        cv.time_axis(ax, *window, label=ax is axes[-1])
    return figure
