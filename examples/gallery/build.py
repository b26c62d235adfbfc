"""Run all scripts of the gallery: python examples/gallery/build.py [FOLDER], default
build/gallery.

The folder gets the picture and the output of each script, and the page index.html.
"""

from __future__ import annotations

import html
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Gallery</title>
<style>
body{{max-width:62em;margin:2em \
auto;font-family:sans-serif}}img{{width:100%}}pre{{overflow-x:auto}}</style></head>
<body><h1>Gallery</h1>
{entries}
</body></html>
"""


# The scripts that show most come first, the others by name.
FIRST = ("models_compared", "non_minimum_phase", "uncertain_robots", "identification")


def scripts() -> list[Path]:
    """The scripts of the gallery in the order of the page."""
    others = [
        path
        for path in sorted(HERE.glob("*.py"))
        if path.stem not in ("build", "exhibit", "linear_loop", *FIRST)
    ]
    return [*(HERE / f"{name}.py" for name in FIRST), *others]


def title(script: Path) -> str:
    """The name of a script as a heading."""
    words = script.stem.replace("_", " ").capitalize()
    return words[:-1] + words[-1].upper() if words.startswith("Benchmark") else words


def build(folder: Path) -> int:
    """Run the scripts one after the other; the number of those that failed."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    failed = 0
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")])
    }
    for script in scripts():
        command = [sys.executable, script, folder]
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            failed += 1
            print(f"{script.stem}: failed\n{done.stderr}", file=sys.stderr)
            continue
        print(done.stdout.splitlines()[-1])
        (folder / f"{script.stem}.txt").write_text(done.stdout, encoding="utf-8")
        entries.append(
            f'<h2>{title(script)}</h2>\n<img src="{script.stem}.svg" alt="{title(script)}">'
        )
        *lines, last = done.stdout.splitlines()  # the last one: picture, time
        entries.append(f"<pre>{html.escape(chr(10).join(lines).rstrip())}</pre>")
        entries.append(
            f"<p>Script: <code>{script.name}</code>. Run time: {last.rpartition(', ')[2]}.</p>"
        )
    (folder / "index.html").write_text(PAGE.format(entries="\n".join(entries)), encoding="utf-8")
    return failed


if __name__ == "__main__":
    target = Path(
        sys.argv[1] if len(sys.argv) > 1 else HERE.parents[1] / "build" / "gallery"
    ).resolve()
    failures = build(target)
    print(f"wrote {target / 'index.html'}" + (f", {failures} scripts failed" if failures else ""))
    sys.exit(1 if failures else 0)
