"""Recorded durations of tests, `tests/durations.json`, and how a run records them anew.

    python -m pytest -m "slow or not slow" --record-durations [tests]

Only the tests of the run change. Those that take more than `SLOW_S` are written and are slow from
then on; a slow one becomes quick again below `QUICK_S`. A law keeps its shortest case quick,
up to `LAW_S`. ``null`` marks a slow test whose duration is not recorded yet.

The keys are names of files without their folder, so a file may move.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).resolve().parents[1] / "durations.json"
# Processor and other work change durations by half: between the two limits [s] a test stays what
# it is.
SLOW_S = 0.6
QUICK_S = 0.4
# Longest case of a law that stays with the quick tests because the others are longer [s].
LAW_S = 1.0

Cases = dict[str, dict[str, dict[str, float | None]]]


@dataclass(frozen=True)
class Recorded:
    """The file of durations.

    Attributes
    ----------
    laws : list of str
        Files whose tests are laws.
    full : dict
        Ids of cases by file and function that run with ``make test-full`` only: they have a
        shorter sibling, of the same code, with the slow or the quick tests, or they plant an
        error that a slow test would find.
    slow : dict
        Duration [s] of each slow case, by file, function and id; None where it is unknown.
    """

    laws: list[str]
    full: dict[str, dict[str, list[str]]]
    slow: Cases


def read(file: Path = FILE) -> Recorded:
    """The recorded durations."""
    return Recorded(**json.loads(file.read_text(encoding="utf-8")))


def write(recorded: Recorded, file: Path = FILE) -> None:
    """Write durations, a line for each test function."""
    parts = [f'"laws": {json.dumps(sorted(recorded.laws))}']
    for name, table in (("full", recorded.full), ("slow", recorded.slow)):
        files = []
        for key, functions in sorted(table.items()):
            rows = [f"   {json.dumps(x)}: {json.dumps(y)}" for x, y in sorted(functions.items())]
            files.append(f"  {json.dumps(key)}: {{\n" + ",\n".join(rows) + "\n  }")
        parts.append(f'"{name}": {{\n' + ",\n".join(files) + "\n }")
    file.write_text("{\n " + ",\n ".join(parts) + "\n}\n", encoding="utf-8")


def parts_of(test: str) -> tuple[str, str, str]:
    """File without its folder, function and id of the case of a test."""
    path, _, rest = test.partition("::")
    name, _, words = rest.partition("[")
    return path.rpartition("/")[2], name, words.removesuffix("]")


def updated(recorded: Recorded, seconds: Mapping[str, float], shortest: Iterable[str]) -> Recorded:
    """Durations with those of a run.

    Parameters
    ----------
    recorded : Recorded
        Those of before.
    seconds : Mapping
        Duration of each test of the run [s].
    shortest : iterable of str
        The shortest case of each test function.
    """
    spared = set(shortest)
    slow: Cases = {
        file: {name: dict(cases) for name, cases in functions.items()}
        for file, functions in recorded.slow.items()
    }
    for test, duration in seconds.items():
        file, name, words = parts_of(test)
        cases = slow.setdefault(file, {}).setdefault(name, {})
        least = QUICK_S if words in cases else SLOW_S
        if file in recorded.laws and test in spared:
            least = LAW_S
        cases.pop(words, None)
        if duration > least:
            cases[words] = round(duration, 1)
    kept = {
        file: {name: cases for name, cases in functions.items() if cases}
        for file, functions in slow.items()
    }
    named = {file: functions for file, functions in kept.items() if functions}
    return Recorded(recorded.laws, recorded.full, named)
