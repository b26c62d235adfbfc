"""Videos of moving robots: one frame for each instant; a file only where it was written."""

from __future__ import annotations

import os
import sys
import tracemalloc
from pathlib import Path as File

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from page_texts import moved
from PIL import Image

from flexgen.base.errors import BuildError
from flexgen.views.reports import video


def test_a_video_has_a_frame_for_each_instant(
    tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`flexgen.views.reports.video`: as many frames as instants, each 50 ms, without end, in the
    size of the figure.
    """
    monkeypatch.setattr(video, "DPI", 10)
    monkeypatch.setattr(video, "LENGTH", 0.1)
    monkeypatch.setattr(
        video, "frames", lambda first, last: (0.5, np.array([first, 0.5 * (first + last), last]))
    )
    path = video.write_video(moved("planar5_nmp"), "title", tmp_path / "a.gif")
    with Image.open(path) as image:
        assert (image.n_frames, image.size, image.info["duration"], image.info["loop"]) == (
            3,
            (72, 54),
            50,
            0,
        )


# Reads the pictures, and writes the file or not.
FFMPEG = """#!{python}
import pathlib, sys
frames = sys.stdin.buffer.read()
if {written}:
    pathlib.Path(sys.argv[-1]).write_bytes(b"frames %d" % len(frames))
sys.exit({status} and "no such codec")
"""


def named_ffmpeg(text: str, folder: File, patch: pytest.MonkeyPatch) -> None:
    """Put a program of this text in the place of ffmpeg."""
    program = folder / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(text, encoding="utf-8")
    program.chmod(0o755)
    patch.setenv("PATH", str(program.parent))


needs_scripts = pytest.mark.skipif(os.name != "posix", reason="a program is a script here")


@needs_scripts
@pytest.mark.parametrize(("status", "written"), [(0, True), (1, True), (0, False), (1, False)])
def test_a_video_of_ffmpeg_is_kept_where_it_ends_well(
    status: int, written: bool, tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = FFMPEG.format(python=sys.executable, written=written, status=status)
    named_ffmpeg(text, tmp_path, monkeypatch)
    monkeypatch.setattr(video, "DPI", 10)
    monkeypatch.setattr(video, "frames", lambda first, last: (0.5, np.array([first, last])))
    path = tmp_path / "made" / "a.mp4"
    data = moved("planar5_nmp")
    if status == 0 and written:
        assert video.write_video(data, "title", path) == path
        assert path.read_bytes() == b"frames %d" % (2 * 72 * 54 * 3)
    else:
        reason = "no such codec" if status else ""
        with pytest.raises(
            BuildError,
            match=f"ffmpeg ended with status {status}: {reason}; try a name that ends",
        ):
            video.write_video(data, "title", path)
        assert not path.exists()
    assert [x.name for x in path.parent.iterdir()] == ["a.mp4"] * path.exists()


@needs_scripts
def test_the_pictures_are_drawn_one_after_the_other(
    tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing waits in memory: 40 pictures need at most three more than four pictures do."""
    text = FFMPEG.format(python=sys.executable, written=True, status=0)
    named_ffmpeg(text, tmp_path, monkeypatch)

    class Empty(FigureCanvasAgg):
        """Its pictures have no lines: drawing them takes long where memory is traced."""

        def draw(self) -> None:
            self.get_renderer()

    monkeypatch.setattr(video, "FigureCanvasAgg", Empty)
    monkeypatch.setattr(video, "DPI", 40)
    data = moved("planar5_nmp")
    picture = int(7.2 * 40) * int(5.4 * 40) * 3
    peaks = []
    for count in (4, 4, 40):  # the first one fills the caches
        times = np.linspace(data["time"][0], data["time"][-1], count)
        monkeypatch.setattr(video, "frames", lambda first, last, times=times: (0.5, times))
        tracemalloc.start()
        video.write_video(data, "title", tmp_path / "a.mp4")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert (tmp_path / "a.mp4").read_bytes() == b"frames %d" % (count * picture)
    assert peaks[2] - peaks[1] < 3 * picture


@needs_scripts
def test_a_program_that_ends_early_is_told_with_its_message(
    tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It reads none of more pictures than a pipe holds."""
    named_ffmpeg(f"#!{sys.executable}\nimport sys\nsys.exit('no space')\n", tmp_path, monkeypatch)
    monkeypatch.setattr(video, "DPI", 40)
    times = np.linspace(0.0, 0.5, 12)
    monkeypatch.setattr(video, "frames", lambda first, last: (0.5, times))
    with pytest.raises(BuildError, match="ffmpeg ended with status 1: no space; try a name"):
        video.write_video(moved("planar5_nmp"), "title", tmp_path / "a.mp4")
    assert not (tmp_path / "a.mp4").exists()
