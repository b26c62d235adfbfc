"""Pipes and devices as input files: refused at once by every reader, with an error of flexgen."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import flexgen
from flexgen.base.errors import FlexgenError
from flexgen.base.files.record_tables import read_arrays
from flexgen.base.spec.tables import open_file
from flexgen.identification.poses.poses import StaticPoses
from flexgen.identification.records.description import read_description
from flexgen.identification.records.motor_record import read_motor_record
from flexgen.identification.servo.record import ServoRecord
from flexgen.model.urdf.urdf import Urdf
from flexgen.paths.force.force_files import read_force
from flexgen.paths.samples.sample_files import read_samples

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
PATIENCE = 5  # s: a reader that waits for a writer is ended

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "model": (".toml", flexgen.read),
    "model of a URDF": (".urdf", lambda file: Urdf(file, str(file))),
    "trajectory": (".csv", flexgen.Trajectory.load),
    "trajectory, npz": (".npz", flexgen.Trajectory.load),
    "samples of a path": (".csv", lambda file: read_samples(str(file), flexgen.read("elbow"), 2)),
    "force": (".csv", lambda file: read_force(file, "time", "a table")),
    "record": (".csv", lambda file: read_arrays(file, 1000)),
    "record, npz": (".npz", lambda file: read_arrays(file, 1000)),
    "record, mat": (".mat", lambda file: read_arrays(file, 1000)),
    "record of motors": (".csv", lambda file: read_motor_record(flexgen.read("elbow"), file)),
    "record of motors, mat": (".mat", lambda file: read_motor_record(flexgen.read("elbow"), file)),
    "description": (".toml", lambda file: read_description(file)),
    "servo record": (".csv", lambda file: ServoRecord.read(file, flexgen.read("elbow"))),
    "poses": (".csv", lambda file: StaticPoses.read(file, flexgen.read("elbow"))),
}


@pytest.fixture(autouse=True)
def _impatient() -> Iterator[None]:
    def end(number: int, frame: object) -> None:
        raise TimeoutError("the reader waits for a writer")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_without_a_writer_is_refused_at_once(name: str, tmp_path: Path) -> None:
    ending, read = READERS[name]
    file = tmp_path / f"pipe{ending}"
    os.mkfifo(file)
    with pytest.raises(FlexgenError) as told:
        read(file)
    assert "pipe" in str(told.value).replace(file.name, "")


def test_a_device_without_an_end_is_refused_and_files_are_read(tmp_path: Path) -> None:
    if os.path.exists("/dev/zero"):
        with pytest.raises(OSError, match="a pipe or a device, expected a file"):
            open_file(Path("/dev/zero"))
    (tmp_path / "file").write_text("content")
    with open_file(tmp_path / "file", encoding="utf-8") as file:
        assert file.read() == "content"
    with pytest.raises(OSError, match="directory"):
        open_file(tmp_path)
