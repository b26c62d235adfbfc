"""Compilers that run at once, and end with what started them.

A compiler starts programs of its own, which a signal to it alone leaves running. On POSIX systems
each one leads a group of processes, and the whole group is ended.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from flexgen.base.errors import BuildError

# s; a compiler that is asked to end removes its temporary files within less; then it is killed.
PATIENCE = 0.5
_PAUSE = 0.01  # s, between two looks at programs that end


class Programs:
    """Programs that run in the threads of one task; `stop` ends all of them.

    Examples
    --------
    >>> from flexgen.codegen.build.programs import Programs
    >>> Programs().run(["cat"], "text").stdout
    'text'
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[str]] = set()
        self._is_stopped = False

    def run(
        self,
        command: Sequence[str],
        text: str = "",
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """Run a program on a text to its end; it ends early with an error in this thread, or
        `stop`.

        Raises
        ------
        OSError
            It cannot be run.
        BuildError
            The programs were stopped before.
        """
        with self._lock:
            if self._is_stopped:
                raise BuildError("the C compiler was stopped")
            process = subprocess.Popen(
                list(command),
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                env=environment,
                start_new_session=os.name == "posix",
            )
            self._running.add(process)
        try:
            out, errors = process.communicate(text)
        except BaseException:
            _end([process])
            process.communicate()
            raise
        finally:
            with self._lock:
                self._running.discard(process)
        return subprocess.CompletedProcess(process.args, process.returncode, out, errors)

    def stop(self) -> None:
        """End what runs, and let nothing begin."""
        with self._lock:
            self._is_stopped = True
            running = list(self._running)
        _end(running)


def _end(processes: Sequence[subprocess.Popen[str]]) -> None:
    """Ask programs and those that they started to end, and kill them where they do not."""
    for process in processes:
        _signal(process, signal.SIGTERM)
    until = time.monotonic() + PATIENCE
    while any(process.poll() is None for process in processes) and time.monotonic() < until:
        time.sleep(_PAUSE)
    for process in processes:
        if os.name == "posix":
            _signal(process, signal.SIGKILL)
        else:
            process.kill()


def _signal(process: subprocess.Popen[str], number: int) -> None:
    """Send a signal to a program and those that it started."""
    with suppress(OSError):  # it has ended
        if os.name == "posix":
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
