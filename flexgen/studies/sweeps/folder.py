"""The folder of a sweep: its description, the finished shards, and at the end the tables.

``sweep.json`` has the grid and the version of the code; ``shards/000017.json`` is a finished
shard, whose first line is the SHA-256 of the rest. Files are written atomically, so an
interruption loses only the shards in progress.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import follow_links, unwritable, write_text
from flexgen.base.spec.arguments import is_whole
from flexgen.studies.sweeps.cases import Grid
from flexgen.studies.sweeps.jobs import Rows
from flexgen.studies.sweeps.table import RESULTS, TIMES, are_rows

FORMAT = 1
SHARD_SIZE = 16  # cases of a shard by default, at most
BATCH_SIZE = 512  # the same where cases are computed in batches
SHARDS = 64  # of a grid, at least, where it has as many cases

Log = Callable[[str], None]


def default_size(grid: Grid) -> int:
    """Default number of cases in a shard."""
    most = BATCH_SIZE if grid.options.get("batch") else SHARD_SIZE
    return max(1, min(most, len(grid) // SHARDS))


class Folder:
    """The folder of a sweep, new or continued.

    Parameters
    ----------
    path : str or Path
    grid : Grid
    code : str
        Version of the code of this process.
    shard_size : int, optional
        Cases in a shard; default: that of the folder, `default_size` for a new one.
    resume : bool
        Continue the sweep in the folder; otherwise the folder must be empty or missing.
    log : callable
        Called with one line of text for each shard that has to be computed again.

    Raises
    ------
    ArgumentError
        The folder contains something else: another sweep, results of other code, or no sweep.
    """

    def __init__(
        self,
        path: str | Path,
        grid: Grid,
        code: str,
        shard_size: int | None,
        resume: bool,
        log: Log,
    ) -> None:
        """Begin a sweep in the folder ``path``, or continue the one in it (``resume``); ``code``:
        version that computes it, ``shard_size``: cases of a file. ArgumentError where the folder
        has something else.
        """
        self.path = Path(path)
        self._log = log
        follow_links(self.path)
        self._cases = len(grid)
        self._about = {"format": FORMAT, "grid": grid.digest, "code": code, "cases": self._cases}
        head = self.path / "sweep.json"
        if head.exists():
            self.shard_size = self._continue(head, shard_size, resume)
            return
        if self.path.exists() and not self.path.is_dir():
            raise ArgumentError(
                f"sweep: given {str(self.path)!r}, which is a file, expected a folder"
            )
        if self.path.is_dir() and any(
            not entry.name.startswith(".") for entry in self.path.iterdir()
        ):
            raise ArgumentError(
                f"sweep: given the folder {str(self.path)!r}, which contains other files, "
                "expected an empty or a new folder; take another folder"
            )
        self.shard_size = shard_size or default_size(grid)
        try:
            (self.path / "shards").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(self.path, error) from error
        about = self._about | {"shard_size": self.shard_size, "description": grid.describe()}
        write_text(head, json.dumps(about, indent=1) + "\n")

    def _continue(self, head: Path, shard_size: int | None, resume: bool) -> int:
        """The shard size of the sweep that ``head`` (its sweep.json) describes; ArgumentError
        where grid, code or sizes differ, or ``resume`` was not asked for.
        """
        where = f"sweep: given the folder {str(self.path)!r}"
        if not resume:
            raise ArgumentError(
                f"{where}, which contains a sweep; continue it with resume=True (--resume), or "
                "take another folder"
            )
        try:
            there = json.loads(head.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise ArgumentError(
                f"{where} with an unreadable sweep.json ({error}); take another folder"
            ) from None
        size: Any = there.get("shard_size") if isinstance(there, dict) else None
        if not is_whole(size):
            raise ArgumentError(
                f"{where} with a damaged sweep.json (no whole number shard_size); take another "
                "folder"
            )
        for key, value in self._about.items():
            if there.get(key) != value:
                what = {
                    "format": "of another version of flexgen",
                    "grid": "of another grid (or of models that have changed since)",
                    "code": f"computed by other code, {there.get('code')}, now {value}",
                    "cases": "of another number of cases",
                }[key]
                raise ArgumentError(
                    f"{where} with a sweep {what}, expected one of this grid and this code; "
                    "take another folder"
                )
        if shard_size not in (None, size):
            raise ArgumentError(
                f"{where} with shards of {size} cases and shard_size {shard_size}, expected {size}"
            )
        return int(size)

    def keep(self, number: int, rows: Rows) -> None:
        """Write a finished shard."""
        content = self._about | {"number": number, "results": rows.results, "times": rows.times}
        body = json.dumps(content, default=lambda x: x.item())  # numbers of numpy
        write_text(self._file(number), f"{_sum(body)}\n{body}")

    def rows(self, number: int) -> Rows | None:
        """A finished shard; None where there is none, or a damaged one."""
        file = self._file(number)
        try:
            checksum, _, body = file.read_text(encoding="utf-8").partition("\n")
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            checksum = ""
            body = ""
        if checksum != _sum(body):
            self._log(f"{file}: damaged; it is computed again")
            return None
        try:
            content = json.loads(body)
        except (ValueError, RecursionError):
            content = None
        if not isinstance(content, dict):
            self._log(f"{file}: damaged; it is computed again")
            return None
        for key, value in (self._about | {"number": number}).items():
            if content.get(key) != value:
                raise ArgumentError(
                    f"{file}: given a shard of another sweep ({key} {content.get(key)}), "
                    f"expected {key} {value}; remove the file to have it computed again"
                )
        first = number * self.shard_size
        cases = range(first, min(first + self.shard_size, self._cases))
        results: Any = content.get("results")
        times: Any = content.get("times")
        if not are_rows(results, RESULTS, cases) or not are_rows(times, TIMES, cases):
            self._log(f"{file}: damaged; it is computed again")
            return None
        return Rows(results, times)

    def _file(self, number: int) -> Path:
        return self.path / "shards" / f"{number:06d}.json"


def _sum(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()
