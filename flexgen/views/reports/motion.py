"""The moving robot: one self-contained HTML page with a canvas, without network access.

The page draws the robot, the path of the tool up to the instant that is shown, and the reference.
Deflections can be exaggerated: with the factor f the robot is drawn at

    q_0 + f (q - q_0),
    q_0: actuated coordinates at the angles of their motors, all other coordinates zero,

while the path of the tool stays the true one.
"""

from __future__ import annotations

import html
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.files.atomic_files import write_text
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.simulation.result import Simulation
from flexgen.views.plots.canvas import begin
from flexgen.views.plots.stick_figure import chain_parts, scene
from flexgen.views.reports.folder import check_folder, foot

PAGE = "motion.html"
FRAMES = 240
# of the extent of the robot: the displacement by deflections at the factor that is chosen first
SHOWN = 0.08
FACTORS = tuple(m * 10**k for k in range(7) for m in (1, 2, 5))


def write_motion(
    equations: Equations,
    trajectory: Trajectory,
    simulation: Simulation | None,
    directory: str | Path,
    end: float,
) -> Path | None:
    """Write ``motion.html``; None for a robot without spatial extent (a row of masses).

    Parameters
    ----------
    equations : Equations
    trajectory : Trajectory
        As `flexgen.solve` returns it.
    simulation : Simulation or None
        Its motion is shown; without it the planned motion.
    directory : str or Path
    end : float [s]
        End of the path.

    Raises
    ------
    ArgumentError
        The folder has a file of another program under this name, or it cannot be written.
    """
    data = motion_data(equations, trajectory, simulation, end)
    if data is None:
        return None
    directory = Path(directory)
    check_folder(directory, (PAGE,))
    return write_text(directory / PAGE, motion_text(data, motion_title(equations, trajectory)))


def motion_title(equations: Equations, trajectory: Trajectory) -> str:
    """Robot and move."""
    move = trajectory.meta.get("move")
    return f"{equations.model.title}{f', move {move}' if move else ''}"


def motion_text(data: dict[str, Any], title: str) -> str:
    """The page of the data of `motion_data`."""
    text = files("flexgen.views.reports").joinpath("motion_page.html").read_text(encoding="utf-8")
    encoded = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    for mark, value in (("@TITLE@", html.escape(title)), ("@FOOT@", foot()), ("@DATA@", encoded)):
        text = text.replace(mark, value)
    return text


def motion_data(
    equations: Equations, trajectory: Trajectory, simulation: Simulation | None, end: float
) -> dict[str, Any] | None:
    """The data of the page, JSON types; None for a robot without spatial extent.

    ``time`` (n) [s]; ``poses``: for each factor of ``factors`` the points of the chain, n lists of
    x, y, z in turn [m]; ``factor``: the one that is shown first; ``tool``, ``reference`` (n lists
    or None) [m]; ``joints``: pairs of point and kind; ``beams``: first points of elastic segments;
    ``views``: pairs of axes (right, up).
    """
    model = equations.model
    drawn = scene(equations, trajectory, simulation, end)
    if not drawn.views:
        return None
    driven = trajectory if simulation is None else simulation.trajectory
    time = np.linspace(begin(trajectory, end), float(trajectory.time[-1]), FRAMES)

    def at(values: np.ndarray) -> np.ndarray:
        return np.array([np.interp(time, trajectory.time, column) for column in values.T]).T

    q = at(driven["q_a"])
    stiff = np.zeros((FRAMES, model.n_a))
    stiff[:, list(model.i_g)] = np.linalg.solve(model.eta, at(driven["q_m"]).T).T
    chain = equations.function("chain_points")
    true, undeflected = (evaluate(chain, x)[0] for x in (q, stiff))  # (n, 3, points)
    moved = float(np.linalg.norm(true - undeflected, axis=1).max())
    extent = float(np.ptp(true.transpose(0, 2, 1).reshape(-1, 3), axis=0).max())
    factor = (
        max((f for f in FACTORS if f * moved <= SHOWN * extent), default=1)
        if moved > 1e-9 * extent
        else 1
    )
    factors = sorted({1, factor, *(f for f in FACTORS if factor / 10 <= f <= 2 * factor)})
    poses = [true if f == 1 else evaluate(chain, stiff + f * (q - stiff))[0] for f in factors]
    joints, beams = chain_parts(model)
    digits = max(0, 4 - int(np.floor(np.log10(extent))))
    up = drawn.views[0][1]
    return {
        "time": np.round(time, 5).tolist(),
        "end": end,
        "factors": factors,
        "factor": factor,
        "poses": [_round(pose.transpose(0, 2, 1), digits) for pose in poses],
        "tool": _round(at(drawn.tool), digits),
        "reference": None if drawn.reference is None else _round(at(drawn.reference), digits),
        "joints": [[point, kind] for point, kind in joints],
        "beams": beams,
        "views": [list(view) for view in drawn.views],
        "sign": -1 if model.gravity[up] > 0 else 1,
        "simulated": simulation is not None,
    }


def _round(values: np.ndarray, digits: int) -> list[list[float]]:
    """Each sample as one list of rounded numbers."""
    return [
        [float(x) for x in row] for row in np.round(values.reshape(len(values), -1), digits) + 0.0
    ]
