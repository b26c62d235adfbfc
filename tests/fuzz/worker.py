"""A process that reads mutated files and prints what it finds; started by `campaign`.

    python worker.py TARGET SEEDS FIRST LAST     the cases of these numbers
    python worker.py TARGET SEEDS FILE ...       these files, unmutated

Case ``n`` of a target is the same on every machine: ``random.Random("<target> <n>")`` chooses the
seed and its mutations. Before each case its number is printed, after a wrong one a JSON object.
The process has little memory: what takes more fails here.
"""

from __future__ import annotations

import json
import random
import shutil
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from mutations import mutate
from targets import LINKED, TARGETS, Target

from flexgen.base.errors import FlexgenError

MEMORY = 400 * 2**20  # bytes that a case may take beyond those of the process at its begin


def limit_memory() -> None:
    """Let the process have its present size and `MEMORY`, where the system can."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        size = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def cases(target: str, seeds: Path, words: list[str]) -> Iterator[tuple[str, str, bytes]]:
    """Name, kind and content of each file."""
    if not words[0].isdigit():
        for word in words:
            yield Path(word).name, Path(word).suffix, Path(word).read_bytes()
        return
    valid = sorted(path for path in seeds.iterdir() if path.is_file())
    contents = [path.read_bytes() for path in valid]
    for number in range(int(words[0]), int(words[1])):
        rng = random.Random(f"{target} {number}")
        k = rng.randrange(len(valid))
        yield str(number), valid[k].suffix, mutate(rng, valid[k].suffix, contents[k])


def problem(target: Target, read: object, path: Path) -> str:
    """Why the outcome of a case is not allowed; empty where the file is read, or refused by its
    name.
    """
    try:
        read(path)  # type: ignore[operator]
    except FlexgenError as error:
        if not any(name in str(error) for name in target.names):
            return f"the message does not name the file: {str(error)[:300]}"
        if len(str(error)) > 20_000:
            return f"a message of {len(str(error))} characters: {str(error)[:300]}"
    except BaseException as error:
        return (
            "".join(traceback.format_exception_only(error)).strip()[:300]
            + "\n"
            + traceback.format_exc()[-2000:]
        )
    return ""


def main(name: str, seeds: Path, words: list[str]) -> None:
    """Read the cases."""
    target = TARGETS[name]
    with tempfile.TemporaryDirectory() as above:
        folder = Path(above) / "cases"
        folder.mkdir()
        if (seeds / LINKED).is_dir():
            shutil.copytree(seeds / LINKED, folder, dirs_exist_ok=True)
        read = target.begin(seeds)
        for path in sorted(path for path in seeds.iterdir() if path.is_file()):
            shutil.copy(path, folder / f"mutated{path.suffix}")
            with suppress(FlexgenError):  # everything is imported before the memory is limited
                read(folder / f"mutated{path.suffix}")
        limit_memory()
        warnings.simplefilter("error")
        for case, suffix, content in cases(name, seeds, words):
            print(case, flush=True)
            path = folder / f"mutated{suffix}"
            path.write_bytes(content)
            found = problem(target, read, path)
            if found:
                print(json.dumps({"case": case, "problem": found}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])
