"""Runs many cases of a target in separate processes: what crashes, hangs or takes too much memory
is found too.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
KEPT = HERE / "kept"  # files that were wrong once, by target
HANG = 20.0  # s: what takes longer hangs
BEGIN = 300.0  # s until the first case


@dataclass(frozen=True)
class Finding:
    """A case with an outcome that is not allowed."""

    target: str
    case: str
    problem: str

    def __str__(self) -> str:
        again = f"python {HERE.name}/worker.py {self.target} SEEDS {self.case}"
        return f"{self.target} case {self.case}: {self.problem}\n  ({again} ...)"


def run_cases(
    target: str,
    seeds: Path,
    first: int,
    last: int,
    *,
    worker: Path = HERE / "worker.py",
    hang: float = HANG,
) -> list[Finding]:
    """All cases from ``first`` to below ``last``; those that are wrong."""
    out: list[Finding] = []
    while first < last:
        found, reached = _run(target, seeds, [str(first), str(last)], worker, hang)
        out += found
        if reached is None:
            break
        first = int(reached) + 1  # that case ended the process
    return out


def run_files(
    target: str, seeds: Path, files: Sequence[Path], *, worker: Path = HERE / "worker.py"
) -> list[Finding]:
    """Files that are read as they are."""
    return _run(target, seeds, [str(file) for file in files], worker, HANG)[0]


def _run(
    target: str, seeds: Path, words: list[str], worker: Path, hang: float
) -> tuple[list[Finding], str | None]:
    """Findings of one process, and the case that ended it before its time."""
    command = [sys.executable, str(worker), target, str(seeds), *words]
    with (
        (seeds.parent / f"{target}-errors.txt").open("w+") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        lines: queue.Queue[str] = queue.Queue()
        reader = threading.Thread(target=_forward, args=(process, lines), daemon=True)
        reader.start()
        out: list[Finding] = []
        case = ""
        while True:
            try:
                line = lines.get(timeout=hang if case else BEGIN)
            except queue.Empty:
                process.kill()
                return [
                    *out,
                    Finding(target, case, f"takes more than {hang if case else BEGIN} s"),
                ], case or None
            if not line:
                break
            if line.startswith("{"):
                out.append(Finding(target, case, json.loads(line)["problem"]))
            else:
                case = line.strip()
        status = process.wait()
        reader.join()
        if status == 0:
            return out, None
        errors.seek(0)
        ended = f"ended the process with status {status}: {errors.read()[-2000:]}"
        return [*out, Finding(target, case, ended)], case or None


def _forward(process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")
