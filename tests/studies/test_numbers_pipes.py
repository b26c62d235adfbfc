"""Controllers of others in a separate process: messages in and out, of
`flexgen.studies.scenarios.foreign_process`.
"""

from __future__ import annotations

import io
import json
import struct
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.feedback.loop.interface import PythonController
from flexgen.studies.scenarios import foreign_process

TOLD = {
    "q_m": [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]],
    "sample_s": 1e-3,
    "n_a": 2,
    "n_y": 3,
    "n_ref": 13,
    "path": [],
}


class Mine:
    """Torques that tell what was seen; it fails where a sensor shows more than 5, or a robot is at
    0.5.
    """

    def reset(self) -> None:
        self.steps = 0

    def step(self, k: int, y: Any, ref: Any) -> np.ndarray:
        self.steps += 1
        if y.sensors[0] > 5:
            raise ValueError("x" * 600)
        return np.array(
            [ref.tau_m[0] + 10 * y.q_m[1] + ref.v_a[1] - 1000 * k, 100 * self.steps + y.sensors[0]]
        )


def numbers(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (3, 3) and references (3, 13) of a sample; the second robot fails at
    sample 2.
    """
    y = 0.1 * np.arange(9.0).reshape(3, 3) + k
    y[1, 2] = 9.0 if k == 2 else 1.0
    return y, np.arange(39.0).reshape(3, 13) + 0.5 * k


def samples(*ks: int) -> bytes:
    return b"".join(struct.pack("=q", k) + b"".join(x.tobytes() for x in numbers(k)) for k in ks)


def begin(**changes: Any) -> bytes:
    text = json.dumps(TOLD | changes).encode()
    return struct.pack("=qq", foreign_process.BEGIN, len(text)) + text


def answers(
    given: bytes, monkeypatch: pytest.MonkeyPatch, loads: Any
) -> tuple[io.BytesIO, list[Any]]:
    """Bytes that the process writes, and its calls on files."""
    taken = io.BytesIO(given)
    written = io.BytesIO()
    done = []
    files: dict[Any, Any] = {(100, "rb"): taken, (101, "wb"): written}

    def fdopen(number: int, mode: str, **more: Any) -> Any:
        done.append((number, more))
        return files[number, mode]

    fake = Made(
        dup=lambda number: 100 + number,
        fdopen=fdopen,
        dup2=lambda old, new: done.append((old, new)),
        open=lambda path, flags: (path, flags),
        devnull="null",
        O_RDONLY=7,
    )
    monkeypatch.setattr(foreign_process, "os", fake)
    monkeypatch.setattr(foreign_process.sys, "argv", ["program", "more"])
    monkeypatch.setattr(foreign_process, "_load_controller", loads)
    foreign_process.main()
    assert foreign_process.sys.argv == ["program"]
    return io.BytesIO(written.getvalue()), done


def test_a_run_of_three_robots_one_of_which_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[Any] = []

    def load(told: dict[str, Any]) -> PythonController:
        loaded.append(told)
        return PythonController(Mine())

    given = samples(7) + begin() + samples(0, 2, 3) + begin(n_a=2) + samples(1) + b"end"
    out, done = answers(given, monkeypatch, load)
    assert done == [(100, {}), (101, {"buffering": 0}), (2, 1), (("null", 7), 0)]
    # nothing is wrong; no answer without a begin
    assert len(loaded) == 1 and out.read(8) == struct.pack("=q", 0)
    for count, (k, steps) in enumerate(((0, 1), (2, 2), (3, 3), (1, 1))):
        if count == 3:
            assert out.read(8) == struct.pack("=q", 0)  # begun again
        size = struct.unpack("=q", out.read(8))[0]
        u = np.frombuffer(out.read(48)).reshape(3, 2)
        text = out.read(size).decode()
        y, ref = numbers(k)
        expected = np.stack(
            [ref[:, 3] + 10 * y[:, 1] + ref[:, 10] - 1000 * k, 100 * steps + y[:, 2]], axis=1
        )
        if k in (2, 3):
            expected[1] = np.nan
        assert_allclose(u, expected, rtol=1e-14)
        if k == 2:
            ((robot, words),) = json.loads(text).items()
            assert (
                robot == "1"
                and words.startswith("step 1 raised ValueError: xxx")
                and len(words) == 500
            )
        else:
            assert text == ""
    assert out.read() == b""


@pytest.mark.parametrize(
    ("error", "text"), [(ValueError("no class"), "no class"), (TypeError(), "TypeError")]
)
def test_a_controller_that_cannot_be_loaded_is_an_answer(
    error: Exception, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(told: dict[str, Any]) -> Any:
        raise error

    out, _ = answers(begin() + samples(0), monkeypatch, fail)
    assert out.read() == struct.pack("=q", len(text)) + text.encode()


def test_compiled_controllers_fail_by_their_status() -> None:
    """A function of C that counts in its memory and fails for the robot whose number is 1."""
    calls: list[tuple[int, int]] = []

    def step(memory: int, k: int, y: int, ref: int, u: int) -> int:
        lane = [x.ctypes.data for x in made.y].index(y)
        calls.append((lane, k))
        made.u[lane] = [k, lane]
        return 5 * (lane == 1)

    entry = foreign_process.STEP(step)
    address = foreign_process.ctypes.cast(entry, foreign_process.ctypes.c_void_p).value
    library: Any = object.__new__(foreign_process.PlugIn)
    library.compiled = lambda setup: Made(address=address, memory=np.zeros((3, 8), np.uint8))
    made = foreign_process._Robots(library, TOLD)
    for k in (4, 5):
        size = 8
        u = made.answer(k, io.BytesIO(samples(k)[8:]))
        found = np.frombuffer(u[size : size + 48]).reshape(3, 2)
        expected: Any = [[k, 0], [np.nan, np.nan], [k, 2]]
        assert_allclose(found, expected)
        text = u[size + 48 :].decode()
        assert struct.unpack("=q", u[:8])[0] == len(text)
        assert text == ('{"1": "step 0: controller failed"}' if k == 4 else "")
    assert calls == [(0, 4), (1, 4), (2, 4), (0, 5), (2, 5)] and made.count == 2
