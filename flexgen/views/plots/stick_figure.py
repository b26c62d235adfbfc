"""The robot as a stick figure at several instants, with its joints, the path of the tool and the
reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.markers import CARETUP

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.kinematics import corners
from flexgen.model.elements import RobotModel
from flexgen.simulation.result import Simulation
from flexgen.views.plots.canvas import BLUE, GREEN, INK, ORANGE, RED

INSTANTS = 6
FLAT = 1e-6  # of the largest extent; a smaller extent is zero

# Style of springs, rods and cables between two points.
LINES: dict[str, Any] = {
    "color": BLUE,
    "lw": 1.6,
    "ls": (0, (3, 1.2)),
    "marker": "o",
    "ms": 3.5,
    "zorder": 25,
}
_KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "elastic": (
        "joint with an elastic gear",
        {"marker": "o", "ms": 8, "mfc": BLUE, "mec": "white"},
    ),
    "rigid": (
        "joint with a rigid gear",
        {"marker": "o", "ms": 8, "mfc": "white", "mec": BLUE, "mew": 1.6},
    ),
    "free": (
        "elastic joint without motor",
        {"marker": "D", "ms": 5, "mfc": ORANGE, "mec": "white", "mew": 0.8},
    ),
    "passive": (
        "passive joint of a kinematic loop",
        {"marker": "o", "ms": 4, "mfc": "white", "mec": INK, "mew": 1.0},
    ),
}


@dataclass(frozen=True)
class Scene:
    """Data of the drawing in world axes: the robot at some instants, the path of the tool, its
    reference or None.

    ``frames`` (INSTANTS, 3, k), ``times`` (INSTANTS) [s], ``tool`` (n, 3), ``reference`` (n, 3)
    [m]; ``lines`` (INSTANTS, 3, 2 l): both ends of l springs, rods and cables [m]; ``views``:
    pairs of axes (right, up): one for a planar robot, three for a spatial one, none for a robot
    without extent.
    """

    frames: np.ndarray
    times: np.ndarray
    tool: np.ndarray
    reference: np.ndarray | None
    views: tuple[tuple[int, int], ...]
    lines: np.ndarray


def scene(
    equations: Equations, trajectory: Trajectory, simulation: Simulation | None, end: float
) -> Scene:
    """The `Scene` of a trajectory, with the simulated path of the tool if there is a
    simulation.
    """
    model = equations.model
    t = trajectory.time
    driven = trajectory if simulation is None else simulation.trajectory
    times = _instants(equations, trajectory, end)
    q = np.array([np.interp(times, t, column) for column in trajectory["q_a"].T]).T
    frames = evaluate(equations.function("chain_points"), q)[0]
    tool = evaluate(equations.function("forward_kinematics"), driven["q_a"])[0]
    reference = None
    if model.output.type != "combination" and "y_ref" in trajectory.channels:
        reference = tool.copy()
        axes = list(model.output.tool_rows)
        reference[:, axes] = trajectory["y_ref"][:, : len(axes)]
    lines = np.zeros((len(times), 3, 0))
    if model.lines:
        lines = evaluate(equations.function("line_points"), q)[0]
    return Scene(frames, times, tool, reference, _views(model, frames), lines)


def _instants(equations: Equations, trajectory: Trajectory, end: float) -> np.ndarray:
    """Instants [s] between which the robot moves by equal distances."""
    grid = np.linspace(
        max(0.0, float(trajectory.time[0])), min(end, float(trajectory.time[-1])), 201
    )
    q = np.array([np.interp(grid, trajectory.time, column) for column in trajectory["q_a"].T]).T
    steps = np.diff(evaluate(equations.function("chain_points"), q)[0], axis=0)
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=(1, 2)) + 1e-12)])
    return np.interp(np.linspace(0.0, distance[-1], INSTANTS), distance, grid)


def _views(model: RobotModel, frames: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Pairs of axes (right, up) from which a robot is drawn: one for a planar motion, three for a
    spatial one, none for a robot without extent. ``frames`` (k, 3, points) [m]: points of the
    chain at k poses; gravity points down where it can.
    """
    extent = np.ptp(frames.transpose(1, 0, 2).reshape(3, -1), axis=1)
    if np.linalg.norm(extent) < FLAT or np.linalg.norm(np.ptp(frames[0], axis=1)) < FLAT:
        return ()
    gravity = np.abs(model.gravity)
    flat = np.flatnonzero(extent < FLAT * extent.max())
    if len(flat):
        # if two axes have no extent, choose the plane that contains gravity
        across = next((int(k) for k in flat if gravity[k] < 0.5 * gravity.max()), int(flat[-1]))
        plane = [k for k in range(3) if k != across]
        up = plane[int(np.argmax(gravity[plane]))] if gravity[plane].any() else plane[1]
        return ((next(k for k in plane if k != up), up),)
    up = int(np.argmax(gravity)) if gravity.any() else 2
    first, second = (k for k in range(3) if k != up)
    return (first, up), (second, up), (first, second)


def spans(drawn: Scene) -> np.ndarray:
    """Range of each coordinate in the drawing, with a margin: (3, 2) [m]."""
    corners = np.concatenate([drawn.frames, drawn.lines], axis=2)
    points = np.vstack([corners.transpose(0, 2, 1).reshape(-1, 3), drawn.tool])
    low = points.min(axis=0)
    high = points.max(axis=0)
    margin = 0.07 * (high - low).max()
    return np.stack([low - margin, high + margin], axis=1)


def draw_view(
    ax: Any, model: RobotModel, drawn: Scene, view: tuple[int, int], label: str = ""
) -> None:
    """Draw one view with equal axes; early poses are pale, the last is dark."""
    right, up = view
    for k, frame in enumerate(drawn.frames):
        last = k == len(drawn.frames) - 1
        shade = INK if last else str(0.88 - 0.35 * k / len(drawn.frames))
        _chain(ax, model, frame[[right, up]], shade, 10 + k, joints=last or k == 0)
        if last or k == 0:
            ends = drawn.lines[k][[right, up]]
            for j in range(0, ends.shape[1], 2):
                ax.plot(*ends[:, j : j + 2], **(LINES | {"alpha": 1.0 if last else 0.4}))
    base = drawn.frames[0][[right, up], 0]
    upright = abs(model.gravity[up]) > 0 or not any(model.gravity)
    ax.plot(
        *base,
        marker=CARETUP if upright else "s",
        ms=15,
        color="#AAAAAA",
        mec="none",
        zorder=5,
        clip_on=False,
    )
    ax.plot(drawn.tool[:, right], drawn.tool[:, up], color=GREEN, lw=3.2, alpha=0.55, zorder=30)
    if drawn.reference is not None:
        ax.plot(
            drawn.reference[:, right],
            drawn.reference[:, up],
            color=RED,
            lw=1.1,
            ls=(0, (4, 2.5)),
            zorder=31,
        )
    limits = spans(drawn)
    ax.set(xlim=limits[right], ylim=limits[up], aspect="equal")
    ax.set(xlabel=f"{'xyz'[right]}, m", ylabel=f"{'xyz'[up]}, m", title=label)


def _chain(
    ax: Any, model: RobotModel, positions: np.ndarray, shade: str, order: int, joints: bool
) -> None:
    """Draw one pose from ``positions`` (2, k) [m]: base; origin, joint, body and beam tip of each
    element; tool. ``shade``: color; ``order``: of drawing; ``joints``: with their symbols.
    """
    ax.plot(*positions, color=shade, lw=3.2, solid_joinstyle="round", zorder=order)
    found, beams = chain_parts(model) if joints else ([], [])
    for k in beams:
        ax.plot(*positions[:, k : k + 2], color=ORANGE, lw=3.2, zorder=order)
    for k, kind in found:
        ax.plot(*positions[:, k], ls="none", zorder=order + 10, **_KINDS[kind][1])
    if joints:
        ax.plot(*positions[:, -1], marker="o", ms=4.5, color=shade, zorder=order + 10)


def chain_parts(model: RobotModel) -> tuple[list[tuple[int, str]], list[int]]:
    """Points of the chain with joints, each with its kind, and first points of the segments that
    are beams.
    """
    line = corners(model)
    joints = [
        (line.index((e.name, 0)), kind) for e in model.elements for kind in _kinds_of(e.dofs)
    ]
    return joints, [
        line.index((element.name, 2)) for element in model.elements if element.beam is not None
    ]


def joint_style(kind: str) -> dict[str, Any]:
    """Options of matplotlib for the marker of a kind of joint, as `chain_parts` names it."""
    return _KINDS[kind][1]


def _kinds_of(dofs: Any) -> list[str]:
    """Kinds of joints of some degrees of freedom, motor joints first."""
    found = {
        "free" if d.gear is None else "rigid" if d.gear.rigid else "elastic"
        for d in dofs
        if not d.dependent
    }
    found |= {"passive" for d in dofs if d.passive is not None}
    return [kind for kind in _KINDS if kind in found]


def handles(model: RobotModel, drawn: Scene) -> list[Any]:
    """Entries of the legend: kinds of joints that occur, beams, path, reference, first and last
    pose.
    """
    kinds = {kind for element in model.elements for kind in _kinds_of(element.dofs)}
    out = [
        Line2D([], [], ls="none", label=text, **style)
        for kind, (text, style) in _KINDS.items()
        if kind in kinds
    ]
    if any(element.beam is not None for element in model.elements):
        out.append(Line2D([], [], color=ORANGE, lw=3.2, label="elastic beam (chord)"))
    if model.lines:
        out.append(Line2D([], [], label="spring, rod or cable", **LINES))
    out.append(Line2D([], [], color=GREEN, lw=3.2, alpha=0.55, label="path of the tool"))
    if drawn.reference is not None:
        out.append(Line2D([], [], color=RED, lw=1.1, ls=(0, (4, 2.5)), label="reference"))
    first, last = drawn.times[[0, -1]]
    out.append(Line2D([], [], color="0.85", lw=3.2, label=f"pose at {first:.3g} s"))
    out.append(Line2D([], [], color=INK, lw=3.2, label=f"pose at {last:.3g} s"))
    return out
