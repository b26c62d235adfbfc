"""Progress of Python calls: on a terminal and in a notebook only, one line, removed at the end."""

from __future__ import annotations

import inspect
import io
import os
import pty
import subprocess
import sys
from types import SimpleNamespace

import pytest

import flexgen
from flexgen.base.calls import progress
from flexgen.base.errors import ArgumentError

CODE = (
    "import flexgen, flexgen.base.calls.progress as p\n"
    "p.QUIET = 0.0\n"
    "s = flexgen.solve('elbow', {arguments})\n"
    "print(s.status)\n"
)


def on_a_terminal(code: str) -> tuple[str, str]:
    """Standard output, and standard error where it is a terminal."""
    master, slave = pty.openpty()
    try:
        with subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=slave, text=True
        ) as process:
            os.close(slave)
            out = process.communicate()[0]
            seen = b""
            while True:
                try:
                    part = os.read(master, 4096)
                except OSError:
                    break
                if not part:
                    break
                seen += part
    finally:
        os.close(master)
    return out, seen.decode()


def test_a_terminal_shows_one_line_that_is_removed():
    out, shown = on_a_terminal(CODE.format(arguments=""))
    assert out == "solved\n"
    assert "\rsolve: deriving the equations of motion (" in shown and "\n" not in shown
    assert shown.endswith("\r") and not shown.split("\r")[-2].strip()


@pytest.mark.slow
def test_progress_can_be_switched_off():
    assert on_a_terminal(CODE.format(arguments="progress=False")) == ("solved\n", "")


@pytest.mark.slow
def test_pipes_show_nothing_unless_asked():
    for arguments, shows in (("", False), ("progress=True", True)):
        code = CODE.format(arguments=arguments)
        found = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        assert found.stdout == "solved\n" and ("deriving" in found.stderr) == shows


def test_functions_get_every_message():
    lines: list[str] = []
    flexgen.solve("elbow", progress=lines.append)
    assert "deriving the equations of motion" in lines


@pytest.mark.parametrize("verb", ["solve", "generate", "sweep", "simulate"])
def test_wrong_values_are_refused(verb):
    assert "progress" in inspect.signature(getattr(flexgen, verb)).parameters
    with pytest.raises(
        ArgumentError, match=r"^progress: given 'yes', expected a function of one line"
    ):
        getattr(flexgen, verb)("elbow", progress="yes")


class ZMQInteractiveShell:
    """The shell of a notebook."""


def test_a_notebook_shows_it_on_standard_output(monkeypatch):
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=ZMQInteractiveShell))
    monkeypatch.setattr(progress, "QUIET", 0.0)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress.reporting(None, "solve") as show:
        assert show is not None
        show("step\none")
        assert sys.stdout.getvalue() == "\rsolve: step one (0 s)"
        with progress.reporting(None, "simulate") as inner:
            assert inner is None  # the outer call reports
    assert (
        sys.stdout.getvalue().endswith("\r" + len("solve: step one (0 s)") * " " + "\r")
        and not sys.stderr.getvalue()
    )


def test_a_closed_stream_does_not_raise(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    assert not progress.is_interactive()
    with progress.reporting(True, "solve") as show:
        assert show is not None
        show("step")


def test_workers_of_sweeps_show_nothing(monkeypatch):
    monkeypatch.setattr(progress, "is_interactive", lambda: True)
    monkeypatch.setattr(progress, "QUIET", 0.0)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    grid = flexgen.Grid(models=["elbow"], moves=["line"], options={"verify": False})
    flexgen.sweep(grid, workers=0, progress=lambda line: None)
    assert sys.stderr.getvalue() == ""


def test_lines_of_a_loop_are_told_after_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    lines: list[str] = []
    tell = progress.tell_every(2.0, lines.append)
    for now in (0.1, 1.9, 2.0, 3.0, 4.5):
        clock[0] = now
        tell(f"at {now}")
    assert lines == ["at 2.0", "at 4.5"]
