"""Mutated files: each is read, or refused with an error that names it, in a bounded time and
memory.

A few cases of each target run with the quick tests, 1,000 with the slow ones and 10,000 with
``make fuzz``. What was wrong once is kept in ``kept/<target>`` and always read.
"""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from campaign import HERE, KEPT, run_cases, run_files
from mutations import mutate
from targets import LINKED, TARGETS

QUICK = 60
SLOW = 1000
MANY = 10_000
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


@pytest.fixture(scope="session")
def seeds(tmp_path_factory):
    """A function that gives the folder of a target's valid files, written once."""
    base = tmp_path_factory.mktemp("fuzz")

    def folder(target: str) -> Path:
        if target == "manifest" and COMPILER is None:
            pytest.skip("no C compiler")
        path = base / target
        if not path.exists():
            path.mkdir()
            TARGETS[target].seeds(path)
        return path

    return folder


def show(findings) -> str:
    return "\n".join(map(str, findings[:10]))


@pytest.mark.parametrize("target", [target for target in TARGETS if target != "tables"])
def test_few_mutations_are_read_or_refused(target, seeds):
    findings = run_cases(target, seeds(target), 0, QUICK)
    assert not findings, show(findings)


@pytest.mark.full
@pytest.mark.parametrize("target", TARGETS)
def test_many_mutations_are_read_or_refused(target, seeds):
    # 40 ms each
    findings = run_cases(
        target, seeds(target), QUICK, SLOW // 3 if target == "identification" else SLOW
    )
    assert not findings, show(findings)


@pytest.mark.full
@pytest.mark.fuzz
@pytest.mark.parametrize("target", TARGETS)
def test_ten_thousand_mutations_are_read_or_refused(target, seeds):
    findings = run_cases(target, seeds(target), 0, MANY)
    assert not findings, show(findings)


@pytest.mark.parametrize(
    "target", [target for target in TARGETS if any((KEPT / target).glob("*"))]
)
def test_mutations_that_failed_before_are_refused(target, seeds):
    findings = run_files(target, seeds(target), sorted((KEPT / target).iterdir()))
    assert not findings, show(findings)


@pytest.mark.parametrize("target", TARGETS)
def test_valid_files_are_read(target, seeds, tmp_path):
    """The mutations begin with files that are read without an error."""
    folder = tmp_path / "cases"
    folder.mkdir()
    if (seeds(target) / LINKED).is_dir():
        shutil.copytree(seeds(target) / LINKED, folder, dirs_exist_ok=True)
    read = TARGETS[target].begin(seeds(target))
    for path in (path for path in seeds(target).iterdir() if path.is_file()):
        shutil.copy(path, folder / f"mutated{path.suffix}")
        read(folder / f"mutated{path.suffix}")


def test_cases_are_known_by_their_numbers(seeds):
    path = next(seeds("trajectory").glob("*.npz"))
    first, again = (
        mutate(random.Random("trajectory 7"), ".npz", path.read_bytes()) for _ in range(2)
    )
    assert first == again


def test_most_mutations_change_the_file(seeds):
    for target in ("model", "urdf", "path", "trajectory"):
        valid = [
            (path.suffix, path.read_bytes())
            for path in sorted(seeds(target).iterdir())
            if path.is_file()
        ]
        changed = [
            mutate(random.Random(k), *valid[k % len(valid)]) != valid[k % len(valid)][1]
            for k in range(200)
        ]
        assert sum(changed) > 160, target


@pytest.mark.parametrize(
    ("bug", "expected"),
    [
        ("key", "KeyError"),
        ("silent", "the message does not name the file: given a bad file"),
        ("hang", "takes more than 2.0 s"),
        ("memory", "MemoryError"),
        ("crash", "ended the process with status -6"),
    ],
)
def test_a_planted_bug_is_found(bug, expected, seeds, monkeypatch):
    monkeypatch.setenv("PLANTED", bug)
    last = 12 if bug in ("hang", "crash") else 40
    planted = HERE / "planted_worker.py"
    findings = run_cases("trajectory", seeds("trajectory"), 0, last, worker=planted, hang=2.0)
    assert findings and all(expected in finding.problem for finding in findings), show(findings)
    assert all(0 <= int(finding.case) < last for finding in findings)
