"""Videos of moving robots: one frame for each instant; a file only where it was written."""

from __future__ import annotations

from pathlib import Path as File
from typing import Any

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


@pytest.mark.parametrize(("status", "written"), [(0, True), (1, True), (0, False), (1, False)])
def test_a_video_of_ffmpeg_is_kept_where_it_ends_well(
    status: int, written: bool, tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    def feed(command: list[str], pictures: Any) -> tuple[int, str]:
        if written:
            File(command[-1]).write_bytes(b"frames")
        return status, "no such codec"

    monkeypatch.setattr(video, "_feed", feed)
    path = tmp_path / "made" / "a.mp4"
    if status == 0 and written:
        video._write_mp4(iter(()), path)
        assert path.read_bytes() == b"frames"
    else:
        with pytest.raises(
            BuildError,
            match=f"ffmpeg ended with status {status}: no such codec; try a name that ends",
        ):
            video._write_mp4(iter(()), path)
        assert not path.exists()
    assert [x.name for x in path.parent.iterdir()] == ["a.mp4"] * path.exists()
