"""The worker with a planted bug in its readers, by the environment variable PLANTED."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from pathlib import Path
from typing import Any

import targets
import worker

from flexgen.base.errors import ArgumentError

KEPT: list[bytes] = []


def planted(read: Any, path: Path) -> Any:
    """The reader, spoiled for some of the files."""
    content = path.read_bytes()
    if len(content) % 5 == 0:
        kind = os.environ["PLANTED"]
        if kind == "key":
            return {}[content[:3]]
        if kind == "silent":
            raise ArgumentError("given a bad file")
        if kind == "hang":
            time.sleep(1000)
        if kind == "memory":
            KEPT.append(bytes(2**30))
        if kind == "crash":
            os.abort()
    return read(path)


if __name__ == "__main__":
    name = sys.argv[1]
    target = targets.TARGETS[name]

    def begin(folder: Path) -> Any:
        read = target.begin(folder)
        return lambda path: planted(read, path) if path.read_bytes() not in valid else read(path)

    valid = [path.read_bytes() for path in Path(sys.argv[2]).iterdir() if path.is_file()]
    targets.TARGETS[name] = dataclasses.replace(target, begin=begin)
    worker.main(name, Path(sys.argv[2]), sys.argv[3:])
