"""Frames of the video of a robot, as matplotlib draws them: poses between instants, axes and
titles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_results import derived, made_trajectory
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose

from flexgen.views.plots.canvas import GREEN, INK, ORANGE, RED
from flexgen.views.reports import motion, video

Lines = list[tuple[np.ndarray, str]]


def moving(name: str) -> dict[str, Any]:
    """The data of a moving robot, with magnified deflections."""
    equations = derived(name)
    data = motion.motion_data(equations, made_trajectory(equations), None, 0.8)
    assert data is not None
    return data


def frames(
    data: dict[str, Any], times: list[float], folder: Path, patch: pytest.MonkeyPatch
) -> list[tuple[str, list[tuple[Any, Lines]]]]:
    """Title, and of each view its axes and the points and color of its lines, for each frame."""
    seen: list[tuple[str, list[tuple[Any, Lines]]]] = []

    class Canvas(FigureCanvasAgg):
        """Keeps what it draws."""

        def draw(self) -> None:
            super().draw()
            views = [
                (ax, [(np.array(x.get_xydata()), to_hex(x.get_color())) for x in ax.lines])
                for ax in self.figure.axes
            ]
            seen.append((self.figure.get_suptitle(), views))

    patch.setattr(video, "FigureCanvasAgg", Canvas)
    patch.setattr(video, "DPI", 10)
    patch.setattr(video, "frames", lambda first, last: (0.5, np.array(times)))
    video.write_video(data, "arm", folder / "a.gif")
    return seen


def at(data: dict[str, Any], rows: Any, t: float) -> np.ndarray:
    """Points of the rows at an instant, (points, 3)."""
    columns = np.array(rows).reshape(len(data["time"]), -1).T
    return np.array([np.interp(t, data["time"], column) for column in columns]).reshape(-1, 3)


def expected(data: dict[str, Any], t: float, magnified: bool) -> Lines:
    """The lines of a frame in world axes, in the order in which they are drawn, with their
    colors; none for the markers of joints.
    """
    chosen = data["factors"].index(data["factor"])
    arm = at(data, data["poses"][chosen], t)
    tool = np.array(data["tool"])
    past = tool[np.array(data["time"]) <= t]
    lines = [(at(data, data["poses"][0], t), "#CCCCCC")] if magnified else []
    lines.append((np.vstack([past, at(data, tool, t)]), GREEN))
    if data["reference"] is not None:
        lines.append((np.array(data["reference"]), RED))
    lines.append((arm, INK))
    lines += [(arm[k : k + 2], ORANGE) for k in data["beams"]]
    lines += [(arm[[k]], "") for k, _ in data["joints"]]
    return [*lines, (arm[-1:], INK)]


@pytest.mark.parametrize("name", ["beam_arm", "elbow", "urdf_arm"])
@pytest.mark.parametrize("magnified", [True, False])
def test_a_frame_shows_the_robot_between_its_instants(
    name: str, magnified: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also before and after its instants; without a reference, and with the vertical axis
    downwards.
    """
    data = moving(name)
    largest = max(data["factors"])
    data |= {"factor": largest} if magnified else {"factor": 1, "reference": None, "sign": -1.0}
    assert largest > 1
    first = data["time"][0]
    last = data["time"][-1]
    times = [first - 1.0, first, data["time"][3] + 0.7 * (data["time"][4] - data["time"][3]), last]
    note = f"deflections \u00d7 {largest}" if magnified else "deflections as they are"
    points = np.array(data["poses"][data["factors"].index(data["factor"])]).reshape(-1, 3)
    everything = np.vstack([points, np.array(data["tool"])])
    low = everything.min(axis=0)
    high = everything.max(axis=0)
    margin = 0.07 * (high - low).max()
    found = frames(data, times, tmp_path, monkeypatch)
    assert len(found) == len(times)
    for t, (title, views) in zip(times, found, strict=True):
        assert title == f"arm, speed 0.5, {note}, {t:.3f} s"
        assert len(views) == min(2, len(data["views"]))
        for (ax, lines), (right, up) in zip(views, data["views"], strict=False):
            ends = (low[up] - margin, high[up] + margin)
            assert ax.get_xlim() == pytest.approx((low[right] - margin, high[right] + margin))
            assert ax.get_ylim() == pytest.approx(ends if data["sign"] > 0 else ends[::-1])
            assert (ax.get_xlabel(), ax.get_ylabel()) == (f"{'xyz'[right]}, m", f"{'xyz'[up]}, m")
            wanted = expected(data, t, magnified)
            for (drawn, color), (exact, named) in zip(lines, wanted, strict=True):
                assert_allclose(drawn, exact[:, [right, up]], rtol=1e-9, atol=1e-12)
                assert named in ("", color.upper(), color)
