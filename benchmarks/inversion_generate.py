"""Generating a complete library: wall and processor time with an empty cache."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROBOT = "manutec_r3_24"
QUICK_ROBOT = "planar5_nmp"
WANTED_S = 60.0  # on two cores


@dataclass(frozen=True)
class GenerateRow:
    """Wall time and processor time [s] of all processes, by build."""

    robot: str
    build: str
    wall_s: float
    processor_s: float


def generate_rows(quick: bool, say: Callable[[str], None]) -> list[GenerateRow]:
    """Both builds, each in a separate process with its own cache."""
    rows = []
    robot = QUICK_ROBOT if quick else ROBOT
    for native in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            text = (
                f"import flexgen; flexgen.generate({robot!r}, "
                f"{str(Path(folder) / 'library')!r}, native={native})"
            )
            environment = {**os.environ, "FLEXGEN_CACHE": str(Path(folder) / "cache")}
            before = os.times()
            began = time.perf_counter()
            subprocess.run([sys.executable, "-c", text], env=environment, check=True)
            wall = time.perf_counter() - began
            after = os.times()
        # what the children's children needed is counted, as they were waited for
        spent = (
            after.children_user
            + after.children_system
            - before.children_user
            - before.children_system
        )
        rows.append(GenerateRow(robot, "native" if native else "default", wall, spent))
        say(f"  {robot}, {rows[-1].build}: {wall:.1f} s wall, {spent:.1f} s of processor time")
    return rows
