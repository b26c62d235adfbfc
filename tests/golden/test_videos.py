"""Videos of moving robots: one frame for each instant; a file only where it was written."""

from __future__ import annotations

import os
import sys
from pathlib import Path as File

import numpy as np
import pytest
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


@pytest.mark.skipif(os.name != "posix", reason="a program is a script with its interpreter")
@pytest.mark.parametrize(("status", "written"), [(0, True), (1, True), (0, False), (1, False)])
def test_a_video_of_ffmpeg_is_kept_where_it_ends_well(
    status: int, written: bool, tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    text = FFMPEG.format(python=sys.executable, written=written, status=status)
    program.write_text(text, encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
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
