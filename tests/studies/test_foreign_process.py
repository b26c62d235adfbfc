"""The process in which controllers of others run: its answers message by message, and what the
scorer does with a process that answers otherwise.
"""

from __future__ import annotations

import io
import json
import struct
import sys
import textwrap
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from emitted import run
from numpy.testing import assert_allclose
from toolchain import CC, needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.interface import Setup
from flexgen.studies.scenarios import foreign
from flexgen.studies.scenarios.foreign import ForeignController
from flexgen.studies.scenarios.foreign_process import BEGIN, answer_messages

# Three robots at rest, of two joints and two motors, with a sensor.
SETUP = Setup(np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]), 1e-3, 2, 3, 13)

MINE = """
class Mine:
    def reset(self):
        self.steps = 0

    def step(self, k, y, ref):
        self.steps += 1
        if y.sensors[0] > 5:
            raise ValueError("x" * 600)
        first = ref.tau_m[0] + 10 * y.q_m[1] + ref.v_a[1] - 1000 * k
        return [first, 100 * self.steps + y.sensors[0]]
"""


def of_sample(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (3, 3) and references (3, 13); the second robot fails at sample 2."""
    y = 0.1 * np.arange(9.0).reshape(3, 3) + k
    y[1, 2] = 9.0 if k == 2 else 1.0
    return y, np.arange(39.0).reshape(3, 13) + 0.5 * k


def sample(k: int) -> bytes:
    return struct.pack("=q", k) + b"".join(x.tobytes() for x in of_sample(k))


def begin(**load: str) -> bytes:
    told = {"n_a": 2, "n_y": 3, "n_ref": 13, "sample_s": 1e-3, "q_m": SETUP.q_m.tolist()}
    text = json.dumps(told | {"path": sys.path} | load).encode()
    return struct.pack("=qq", BEGIN, len(text)) + text


def answers(given: bytes) -> io.BytesIO:
    written = io.BytesIO()
    answer_messages(io.BytesIO(given), written)
    return io.BytesIO(written.getvalue())


def torques(out: io.BytesIO) -> tuple[np.ndarray, str]:
    """The next answer to a sample: torques (3, 2) and the reports on robots."""
    size = struct.unpack("=q", out.read(8))[0]
    return np.frombuffer(out.read(48)).reshape(3, 2), out.read(size).decode()


def test_a_run_of_three_robots_one_of_which_fails(tmp_path: Path) -> None:
    """Each robot has its own controller; one that failed stays without torque until the next
    begin. A sample before the first begin has no answer.
    """
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    start = begin(file=f"{file}:Mine")
    given = sample(7) + start + sample(0) + sample(2) + sample(3) + start + sample(1) + b"end"
    out = answers(given)
    for k, steps, first in ((0, 1, True), (2, 2, False), (3, 3, False), (1, 1, True)):
        if first:
            assert out.read(8) == struct.pack("=q", 0)  # begun, nothing is wrong
        u, text = torques(out)
        y, ref = of_sample(k)
        expected = np.stack(
            [ref[:, 3] + 10 * y[:, 1] + ref[:, 10] - 1000 * k, 100 * steps + y[:, 2]], axis=1
        )
        if k in (2, 3):
            expected[1] = np.nan
        assert_allclose(u, expected, rtol=1e-14)
        if k != 2:
            assert text == ""
            continue
        ((robot, words),) = json.loads(text).items()
        assert robot == "1" and len(words) == 500
        assert words.startswith("step 1 raised ValueError: xxx")
    assert out.read() == b""


CANNOT_LOAD = {
    "raise ValueError('no class')": "no class",
    "raise TypeError": "TypeError",
    "raise OSError(5, 'gone')": "gone",
}


@pytest.mark.parametrize("line", CANNOT_LOAD)
def test_a_controller_that_cannot_be_loaded_is_an_answer(tmp_path: Path, line: str) -> None:
    file = tmp_path / "mine.py"
    file.write_text(f"{MINE}\n{line}\n")
    out = answers(begin(file=f"{file}:Mine") + sample(0))
    size = struct.unpack("=q", out.read(8))[0]
    text = out.read(size).decode()
    assert len(text) == size and CANNOT_LOAD[line] in text and out.read() == b""


@pytest.mark.parametrize("text", ["", "AAAA"])
def test_an_object_that_cannot_be_read_is_an_answer(text: str) -> None:
    out = answers(begin(object=text, main=""))
    told = out.read()[8:].decode()
    assert told.startswith("its class cannot be found in a separate process (")
    assert told.endswith("put it into a file and give 'file.py:Class'")


PLUG = """
#include "flexgen_controller.h"
int flexgen_controller_abi(void) { return 1; }
size_t flexgen_controller_size(const flexgen_controller_setup *s) { (void)s; return 8; }
int flexgen_controller_reset(void *x, const flexgen_controller_setup *s)
{ (void)s; *(double *)x = 0; return 0; }
int flexgen_controller_step(void *x, int64_t k, const double *y, const double *ref, double *u)
{ u[0] = y[0] + ref[12]; u[1] = (double)k + ++*(double *)x; return y[2] > 5 && y[2] < 10 ? 5 : 0; }
"""


@needs_compiler
def test_a_library_has_a_memory_for_each_robot_and_fails_by_its_status(tmp_path: Path) -> None:
    source = tmp_path / "plug.c"
    source.write_text(PLUG)
    include = Path(flexgen.__file__).parent / "feedback" / "loop"
    made = tmp_path / "plug.so"
    run(CC, "-shared", "-fPIC", f"-I{include}", source, "-o", made, folder=tmp_path)
    out = answers(begin(file=str(made)) + sample(0) + sample(2) + sample(1))
    assert out.read(8) == struct.pack("=q", 0)
    for step, k in enumerate((0, 2, 1)):
        u, text = torques(out)
        y, ref = of_sample(k)
        expected = np.stack([y[:, 0] + ref[:, 12], np.full(3, k + step + 1.0)], axis=1)
        if step:
            expected[1] = np.nan
        assert_allclose(u, expected)
        assert text == ('{"1": "step 1: controller failed"}' if k == 2 else "")


# --- a peer that answers otherwise


def peer(
    body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **limits: float
) -> ForeignController:
    """A controller whose process runs these lines."""
    head = "import json, os, struct, sys\ntake, give = sys.stdin.buffer, sys.stdout.buffer\n"
    head += "def tell(*parts):\n    give.write(b''.join(parts))\n    give.flush()\n"
    head += "def number(k): return struct.pack('=q', k)\n"
    head += "_, n = struct.unpack('=qq', take.read(16))\ntold = json.loads(take.read(n))\n"
    (tmp_path / "peer_of_tests.py").write_text(head + textwrap.dedent(body))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(foreign, "foreign_process", ModuleType("peer_of_tests"))
    return ForeignController("mine.py", **limits)


@pytest.mark.parametrize(("size", "read"), [(2**20 - 1, True), (2**20, False), (-1, False)])
def test_words_of_a_begin_have_less_than_a_mebibyte(
    size: int, read: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = peer(f"tell(number({size}), b'x' * {max(size, 0)})", tmp_path, monkeypatch)
    words = "controller mine.py: xxxx" if read else "mine.py: the controller's process ended"
    with pytest.raises(ArgumentError, match=words) as caught:
        made.compiled(SETUP)
    made.close()
    if read:
        assert len(str(caught.value)) == 2000 + len("controller mine.py: ")


class Own:
    """A controller of a class that a file has."""

    def reset(self) -> None: ...

    def step(self, k: int, y: object, ref: object) -> list[float]:
        return [0.0]


def test_a_class_of_a_file_is_found_without_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only a class of the program itself needs the file of the program."""
    body = "text = b'main is ' + told['main'].encode() + b'.'\ntell(number(len(text)), text)"
    peer(body, tmp_path, monkeypatch)
    made = ForeignController(Own())
    with pytest.raises(ArgumentError, match=r"^controller Own: main is \.$"):
        made.compiled(SETUP)
    made.close()


REPORTS: dict[str, tuple[str, bool]] = {
    "none": ("u = number(0) + bytes(48)", True),
    "a robot": ('u = number(13) + bytes(48) + b\'{"1": "lost"}\'', True),
    "no JSON": ("u = number(3) + bytes(48) + b'{1:'", False),
    "a list": ("u = number(2) + bytes(48) + b'[]'", False),
    "too long": ("u = number(2**20) + bytes(48)", False),
    "negative": ("u = number(-5) + bytes(48)", False),
    "torques cut off": ("u = number(0) + bytes(40)", False),
}


@pytest.mark.parametrize("name", REPORTS)
def test_reports_on_robots(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An unreadable answer is the end of the controller: no torque, a reason for every robot."""
    line, read = REPORTS[name]
    body = f"{line}\ntell(number(0))\ntake.read(8 + 8 * 48)\ntell(u)\n"
    found, errors = torques_of(peer(body, tmp_path, monkeypatch))
    if not read:
        assert np.isnan(found).all() and set(errors) == {0, 1, 2}
        assert all(text.startswith("the controller's process ended") for text in errors.values())
        return
    assert_allclose(found, 0.0)
    assert errors == ({1: "lost"} if name == "a robot" else {})


def torques_of(made: ForeignController, count: int = 1) -> tuple[np.ndarray, dict[int, str]]:
    """Torques (3, 2) of the last of some samples, and the errors of the robots."""
    compiled = made.compiled(SETUP)
    y, ref = of_sample(0)
    u = np.zeros((3, 2))
    for k in range(count):
        compiled.keep(k, *(x.ctypes.data for x in (y, ref, u)))
    made.close()
    return u, compiled.errors


def test_all_answers_together_have_a_time_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = """
    import time
    tell(number(0))
    while take.read(8 + 8 * 48):
        time.sleep(0.02)
        tell(number(0), bytes(48))
    """
    made = peer(body, tmp_path, monkeypatch, total_s=0.03)
    found, errors = torques_of(made, 3)
    assert np.isnan(found).all()
    assert errors[0] == "the controller took more than 0.03 s for all samples"


def test_a_process_that_does_not_answer_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = peer("tell(number(0))\nimport time\ntime.sleep(60)", tmp_path, monkeypatch, step_s=0.05)
    found, errors = torques_of(made)
    assert np.isnan(found).all()
    text = "the controller did not answer within 0.05 s; its process was ended"
    assert set(errors.values()) == {text}


def test_an_interrupt_ends_the_samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = peer("tell(number(0))\ntake.read()", tmp_path, monkeypatch)
    compiled = made.compiled(replace(SETUP))

    def interrupted(*given: Any) -> None:
        raise KeyboardInterrupt

    # The module alone is patched: threads of the test runner pack, too.
    patched = SimpleNamespace(pack=interrupted, unpack=struct.unpack, calcsize=struct.calcsize)
    monkeypatch.setattr(foreign, "struct", patched)
    u = np.zeros((3, 2))
    y, ref = of_sample(0)
    compiled.keep(0, *(x.ctypes.data for x in (y, ref, u)))
    made.close()
    assert np.isnan(u).all() and compiled.errors[0] == foreign.INTERRUPTED
