"""The robot in motion as a video: GIF, or MP4 by the program ffmpeg."""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.files.atomic_files import atomic_file, follow_links, staging_folder
from flexgen.views.plots.canvas import GREEN, INK, ORANGE, RED, apply_style
from flexgen.views.plots.stick_figure import joint_style

ENDINGS = (".gif", ".mp4")
RATE = 20  # frames/s: a GIF has the time of a frame in 10 ms, which divides 1000 ms / RATE
LENGTH = 4.0  # s: a shorter motion is shown in slow motion
# speeds of short motions; those of long ones: 1, 2, 5, 10 ...
SLOW = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
FRAMES_MAX = 600
# inches; the sizes in pixels are even, as video formats need
DPI = 100
WIDTH = 7.2
HEIGHT = 5.4
_PLAIN = "#CCCCCC"


def check_video(path: str | Path) -> None:
    """Refuse a video that cannot be written.

    Raises
    ------
    ArgumentError
        The name has another ending, or ffmpeg is missing.
    """
    suffix = Path(path).suffix
    if suffix not in ENDINGS:
        raise ArgumentError(
            f"video: given {str(path)!r}, expected a name that ends in {' or '.join(ENDINGS)}"
        )
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise ArgumentError(
            f"video: given {str(path)!r}, but the program ffmpeg is not installed; install it "
            "(Debian: apt install ffmpeg), or give a name that ends in .gif"
        )


def write_video(data: dict[str, Any], title: str, path: str | Path) -> Path:
    """Write the motion of `flexgen.views.reports.motion.motion_data` as a video.

    Parameters
    ----------
    data : dict
    title : str
    path : str or Path
        A name that ends in ``.gif`` or ``.mp4``.

    Raises
    ------
    ArgumentError
        See `check_video`; or the file cannot be written.
    BuildError
        ffmpeg failed; the text has its message.
    """
    check_video(path)
    path = Path(path)
    first = data["time"][0]
    last = data["time"][-1]
    speed, times = frames(first, last)
    pictures = _pictures(data, f"{title}, speed {speed:g}", times)
    (_write_gif if path.suffix == ".gif" else _write_mp4)(pictures, path)
    return path


def frames(first: float, last: float) -> tuple[float, np.ndarray]:
    """Speed of a video, and the instants of its frames, 1 / `RATE` seconds apart when it is
    played.

        t_k = first + k speed / RATE,   the last frame at the end of the motion

    Parameters
    ----------
    first, last : float
        Of the motion [s].

    Returns
    -------
    float
        A short motion is shown in slow motion, for `LENGTH` seconds or longer; a long one faster,
        in `FRAMES_MAX` frames or fewer.
    np.ndarray
        At least two.
    """
    length = last - first
    faster = (m * 10.0**k for k in range(12) for m in (1.0, 2.0, 5.0))
    speed = next((s for s in SLOW if length / s >= LENGTH), SLOW[-1])
    if speed == 1.0:
        speed = next(s for s in faster if length / s * RATE <= FRAMES_MAX - 1)
    count = max(2, math.ceil(length / speed * RATE - 1e-9) + 1)
    return speed, np.minimum(first + np.arange(count) * (speed / RATE), last)


def _write_gif(pictures: Iterator[np.ndarray], path: Path) -> None:
    """Write the pictures as an animated GIF with a palette of 64 colors."""
    from PIL import Image

    images = [Image.fromarray(picture).quantize(64) for picture in pictures]
    with atomic_file(path) as stream:
        images[0].save(
            stream, "GIF", save_all=True, append_images=images[1:], duration=1000 // RATE, loop=0
        )


def _write_mp4(pictures: Iterator[np.ndarray], path: Path) -> None:
    """Write the pictures as an MP4 by the program ffmpeg; BuildError where it fails."""
    follow_links(path.parent).mkdir(parents=True, exist_ok=True)
    with staging_folder(path.parent) as folder:
        size = f"{round(WIDTH * DPI)}x{round(HEIGHT * DPI)}"
        command = [
            "ffmpeg",
            "-loglevel",
            "error",
            "-y",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-s",
            size,
        ]
        command += [
            "-r",
            str(RATE),
            "-i",
            "-",
            "-an",
            "-pix_fmt",
            "yuv420p",
            "-movflags",
            "+faststart",
        ]
        made = folder / "video.mp4"
        status, message = _feed([*command, str(made.resolve())], pictures)
        if status or not made.is_file():
            raise BuildError(
                f"video: ffmpeg ended with status {status}: {message}; try a name that ends in "
                ".gif"
            )
        with atomic_file(path) as stream:
            stream.write(made.read_bytes())


def _feed(command: list[str], pictures: Iterator[np.ndarray]) -> tuple[int, str]:
    """Give a program the pictures one after the other, not all in memory; its status and its last
    message.
    """
    with tempfile.TemporaryFile() as errors:
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors
        ) as program:
            assert program.stdin is not None
            try:
                with suppress(BrokenPipeError):  # it ended: its status says why
                    for picture in pictures:
                        program.stdin.write(picture.tobytes())
                with suppress(BrokenPipeError):
                    program.stdin.close()
            except BaseException:  # such as an interruption while a picture is drawn
                program.kill()
                raise
        errors.seek(0)
        return program.returncode, errors.read().decode(errors="replace").strip()[-500:]


def _pictures(data: dict[str, Any], title: str, times: np.ndarray) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3) of the instants, drawn one after the other."""
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI)
    canvas = FigureCanvasAgg(figure)
    move = apply_style(_begin)(figure, data, title)
    draw = apply_style(canvas.draw)
    for t in times:
        move(float(t))
        draw()
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _begin(figure: Figure, data: dict[str, Any], title: str) -> Callable[[float], None]:
    """Draw the parts that do not move; returns the function that moves the others to an instant.

    The robot with magnified deflections is dark, the robot as it is pale, the path of the tool up
    to the instant green.
    """
    time = np.array(data["time"])
    tool = np.array(data["tool"])
    chosen = data["factors"].index(data["factor"])
    truth, robot = (np.array(data["poses"][k]).reshape(len(time), -1, 3) for k in (0, chosen))
    everything = np.concatenate([robot.reshape(-1, 3), tool])
    low = everything.min(axis=0)
    high = everything.max(axis=0)
    margin = 0.07 * (high - low).max()
    note = f"deflections \u00d7 {data['factor']}" if chosen else "deflections as they are"
    head = figure.suptitle("", fontsize=9, x=0.02, ha="left", color=INK)
    moved: list[tuple[Any, np.ndarray]] = []  # a line and its points (n, 2, points)
    trails: list[tuple[Any, list[int]]] = []
    views = data["views"][:2]  # a spatial robot from two sides
    for k, (right, up) in enumerate(views):
        ax = figure.add_subplot(1, len(views), k + 1)
        ends = (low[up] - margin, high[up] + margin)
        ax.set(
            xlim=(low[right] - margin, high[right] + margin),
            ylim=ends if data["sign"] > 0 else ends[::-1],
        )
        ax.set(aspect="equal", xlabel=f"{'xyz'[right]}, m", ylabel=f"{'xyz'[up]}, m")
        seen, plain = (values[:, :, [right, up]].transpose(0, 2, 1) for values in (robot, truth))
        if chosen:
            moved.append(
                (ax.plot([], [], color=_PLAIN, lw=3.0, solid_joinstyle="round")[0], plain)
            )
        trails.append((ax.plot([], [], color=GREEN, lw=3.2, alpha=0.55)[0], [right, up]))
        if data["reference"] is not None:
            reference = np.array(data["reference"])
            ax.plot(reference[:, right], reference[:, up], color=RED, lw=1.1, ls=(0, (4, 2.5)))
        moved.append((ax.plot([], [], color=INK, lw=3.2, solid_joinstyle="round")[0], seen))
        for point in data["beams"]:
            moved.append((ax.plot([], [], color=ORANGE, lw=3.2)[0], seen[:, :, point : point + 2]))
        for point, kind in data["joints"]:
            moved.append((ax.plot([], [], ls="none", **joint_style(kind))[0], seen[:, :, [point]]))
        moved.append((ax.plot([], [], marker="o", ms=4.5, color=INK)[0], seen[:, :, -1:]))

    def move(t: float) -> None:
        head.set_text(f"{title}, {note}, {t:.3f} s")
        for line, points in moved:
            line.set_data(*_between(time, points, t))
        for line, axes in trails:
            line.set_data(*np.vstack([tool[time <= t], _between(time, tool, t)])[:, axes].T)

    return move


def _between(time: np.ndarray, rows: np.ndarray, t: float) -> np.ndarray:
    """The row at an instant, interpolated."""
    k = int(np.clip(np.searchsorted(time, t, side="right") - 1, 0, len(time) - 2))
    share = float(np.clip((t - time[k]) / (time[k + 1] - time[k]), 0.0, 1.0))
    between: np.ndarray = (1 - share) * rows[k] + share * rows[k + 1]
    return between
