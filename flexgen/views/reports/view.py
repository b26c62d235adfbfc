"""The robot in motion as one HTML file for the browser, or as a video."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flexgen.base.calls.progress import Choice
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.motion.trajectory import Trajectory, convert_to_si
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import channel_units
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import Move, RobotModel
from flexgen.simulation.result import Simulation
from flexgen.views.reports.motion import motion_data, motion_text, motion_title
from flexgen.views.reports.video import check_video, write_video

TRAJECTORIES = (".npz", ".csv")


@checked_types
def view(
    what: str | Path | RobotModel | Equations | Solution | Trajectory,
    path: str | Path | None = None,
    *,
    model: str | Path | RobotModel | Equations | None = None,
    move: str | Move | None = None,
    video: str | Path | None = None,
    progress: Choice = None,
) -> Path:
    """Show the robot, its move and its deflections in the browser or in a video.

    The page needs neither a server nor a network. It plays the motion, draws the path of the tool
    and its reference, and magnifies the deflections by a slider; a robot in space is turned with
    the mouse.

    Parameters
    ----------
    what : str, Path, RobotModel, Equations, Solution or Trajectory
        A robot (its move is solved and simulated), the solution of a move, or a trajectory or its
        file (.npz or .csv).
    path : str or Path, optional
        The page, a name that ends in ``.html``. Required without a video.
    model : str, Path, RobotModel or Equations, optional
        The model of a trajectory, where MODEL is a file .npz or .csv; default: the name in the
        trajectory.
    move : str or Move, optional
        A move or program of the model file; default: the first.
    video : str or Path, optional
        Write a video to this file, ``FILE.gif`` or ``FILE.mp4`` (needs the program ffmpeg).
    progress : bool or callable, optional
        As for `flexgen.solve`.

    Returns
    -------
    Path
        The page, or the video where no page is asked for.

    Raises
    ------
    ArgumentError
        An argument does not fit, the robot has no extent in space (a row of masses), a program for
        the video is missing, or a file cannot be written.
    SolverError, ModelError
        The move of a robot cannot be solved.

    Examples
    --------
    >>> print(flexgen.view("elbow", "elbow.html"))
    elbow.html
    """
    if path is None and video is None:
        raise ArgumentError("view: given no file, expected a path that ends in .html, or a video")
    if path is not None and Path(path).suffix != ".html":
        raise ArgumentError(f"view: given {str(path)!r}, expected a name that ends in .html")
    if video is not None:
        check_video(video)
    equations, trajectory, simulation, end = _motion(what, model, move, progress)
    data = motion_data(equations, trajectory, simulation, end)
    if data is None:
        raise ArgumentError(
            f"view: given model {equations.model.name}, a robot without extent in space, "
            "expected one whose tool or joints are at different places"
        )
    title = motion_title(equations, trajectory)
    written = None if path is None else write_text(path, motion_text(data, title))
    shown = None if video is None else write_video(data, title, video)
    out = written or shown
    assert out is not None
    return out


def _motion(
    what: str | Path | RobotModel | Equations | Solution | Trajectory,
    model: str | Path | RobotModel | Equations | None,
    move: str | Move | None,
    progress: Choice,
) -> tuple[Equations, Trajectory, Simulation | None, float]:
    """The robot, its trajectory, the simulation if there is one, and the end of the path [s]."""
    if isinstance(what, Solution):
        return derive(what.model), what.trajectory, what.simulation, what.move.duration
    if isinstance(what, (str, Path)) and str(what).endswith(TRAJECTORIES):
        what = Trajectory.load(what)
    if not isinstance(what, Trajectory):
        if model is not None:
            raise ArgumentError(
                "view: given a robot and model, expected model together with a trajectory only"
            )
        equations = what if isinstance(what, Equations) else derive(what)
        solution = solve(equations, move, progress=progress)
        return equations, solution.trajectory, solution.simulation, solution.move.duration
    if move is not None:
        raise ArgumentError(
            "view: given a trajectory and move, expected move together with a robot only"
        )
    equations = _robot_of(what, model)
    missing = [name for name in ("q_a", "q_m") if name not in what]
    n_a = equations.model.n_a
    n_m = equations.model.n_m
    if missing or what["q_a"].shape[1] != n_a or what["q_m"].shape[1] != n_m:
        given = (
            f"no channel {missing[0]}" if missing else f"{what['q_a'].shape[1]} arm coordinates"
        )
        raise ArgumentError(
            f"view: given a trajectory with {given}, expected q_a with {n_a} and q_m with {n_m} "
            f"columns, as 'flexgen solve' writes for model {equations.model.name}"
        )
    what = convert_to_si("view", what, channel_units(equations.model))
    return equations, what, None, end_of_reference(what)


def _robot_of(
    trajectory: Trajectory, model: str | Path | RobotModel | Equations | None
) -> Equations:
    """The robot of a trajectory: ``model``, or the one that its meta data name; ArgumentError
    where that cannot be found.
    """
    if model is not None:
        return model if isinstance(model, Equations) else derive(model)
    name = trajectory.meta.get("model")
    variant = trajectory.meta.get("variant")
    chosen = f"{name}@{variant}" if variant else str(name)
    try:
        return derive(chosen)
    except ArgumentError as error:
        raise ArgumentError(
            f"view: the trajectory is of model {chosen!r} ({error}), expected also its model "
            "(model= in Python, --robot on the command line)"
        ) from None


def end_of_reference(trajectory: Trajectory) -> float:
    """The end of the path [s]: from there on the reference stays where it is."""
    if "y_ref" not in trajectory:
        return float(trajectory.time[-1])
    moving = np.flatnonzero((trajectory["y_ref"] != trajectory["y_ref"][-1]).any(axis=1))
    return (
        float(trajectory.time[min(moving[-1] + 1, len(trajectory.time) - 1)])
        if len(moving)
        else 0.0
    )
