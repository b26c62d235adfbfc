"""Ctrl-C while compilers run: the command ends at once, and nothing of it stays."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from toolchain import CC, needs_compiler

from flexgen.base.errors import BuildError
from flexgen.codegen.build.programs import Programs

ROOT = Path(__file__).parents[2]
WITHIN = 2.0  # s
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

# It answers questions as the real one; compiling takes a minute, in a separate process.
SLOW = """#!/bin/sh
case " $* " in
*" -c "*) ;;
*) exec {real} "$@" ;;
esac
{trap}
sleep 60 &
echo $$ $! >> {pids}
wait
wait
"""


def slow_compiler(folder: Path, trap: str) -> Path:
    real = shutil.which(str(CC).split()[0])
    assert real is not None
    program = folder / "slow-cc"
    program.write_text(SLOW.format(real=real, trap=trap, pids=folder / "pids"))
    program.chmod(0o755)
    return program


def started(folder: Path) -> list[int]:
    """Numbers of the processes of the compiler that have begun."""
    file = folder / "pids"
    return [int(x) for x in file.read_text().split()] if file.exists() else []


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits for its parent does not."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] != "Z"


def until(condition: object, seconds: float) -> bool:
    assert callable(condition)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return bool(condition())


@needs_compiler
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("number", "trap"),
    [(signal.SIGINT, ""), (signal.SIGINT, "trap '' TERM INT"), (signal.SIGTERM, "")],
)
def test_an_interrupt_ends_compilers_and_leaves_nothing(
    tmp_path: Path, number: signal.Signals, trap: str
) -> None:
    environment = os.environ | {
        "CC": str(slow_compiler(tmp_path, trap)),
        "FLEXGEN_CACHE": str(tmp_path / "cache"),
        "TMPDIR": str(tmp_path / "temporary"),
        "PYTHONPATH": str(ROOT),
    }
    (tmp_path / "temporary").mkdir()
    words = ["-m", "flexgen", "generate", "elbow", "--out", str(tmp_path / "elbow")]
    with subprocess.Popen(
        [sys.executable, *words], cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert until(lambda: len(started(tmp_path)) >= 4, 60.0), process.poll()
            began = time.monotonic()
            process.send_signal(number)
            _, told = process.communicate(timeout=20.0)
            took = time.monotonic() - began
        finally:
            process.kill()
            left = [pid for pid in started(tmp_path) if alive(pid)]
            for pid in left:
                os.kill(pid, signal.SIGKILL)
    assert took < WITHIN and process.returncode == 130, told
    assert not left
    assert not (tmp_path / "elbow").exists()
    assert not [*(tmp_path / "temporary").iterdir()]
    assert not [*(tmp_path / "cache").glob("*.o"), *(tmp_path / "cache").glob(".*")]


def test_programs_do_not_begin_after_a_stop() -> None:
    programs = Programs()
    assert programs.run([sys.executable, "-c", "print(input())"], "text").stdout == "text\n"
    programs.stop()
    with pytest.raises(BuildError, match="was stopped"):
        programs.run([sys.executable, "-c", ""])
