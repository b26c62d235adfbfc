"""Build the site: python docs/build_site.py [FOLDER], default build/docs.

The pages are those of the repository: docs/*.md, the README, the keys of model files, the
benchmarks. They stay readable on a Git host; here they are copied to one folder, and their links
are changed to it. The references of Python and of C are written from the docstrings, from the
table of functions and from the headers in generated/elbow. Warnings of Sphinx are errors. Nothing
is read from a network, and the pages load nothing from one.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from reference_pages import c_reference, python_reference
from sphinx.cmd.build import main as sphinx

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
# Pages outside docs/, and their names on the site.
OTHERS = {
    "README.md": "overview",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
    "models/README.md": "model_files",
    "generated/README.md": "emitted_library",
    **{
        str(page.relative_to(ROOT)): f"benchmark_{page.stem}"
        for page in (ROOT / "benchmarks").rglob("*.md")
    },
}
# The table of contents: caption, pages. Pages that are missing here come at its end.
CONTENTS = {
    "Learn": "overview five_minutes concepts theory gallery notebooks not_for",
    "How to": "own_robot datasheet identification calibration limits_and_streams "
    "in_a_controller motion_control cluster paths control planning equations extensions",
    "Arrays": "arrays cuda jax pytorch",
    "Other programs": "fmu fmu_tools ros2 matlab plc exchange",
    "Use": "command_line python c_library methods support_matrix verification real_machines "
    "platforms",
    "Reference": "python_reference c_reference model_files emitted_library",
    "Figures": "benchmarks "
    + " ".join(sorted(name for name in OTHERS.values() if name.startswith("benchmark_"))),
    "Project": "stability contributing changelog licenses",
}


def sources() -> dict[Path, str]:
    """The pages of the repository, with their names on the site."""
    own = {page: page.stem for page in sorted(DOCS.glob("*.md"))}
    return own | {ROOT / page: name for page, name in OTHERS.items()}


def with_links(page: Path, folder: Path, names: dict[Path, str]) -> str:
    """The text of a page whose relative links lead to the pages and to copies of the files of the
    site's folder.
    """

    def changed(found: re.Match[str]) -> str:
        file, _, anchor = found[1].partition("#")
        if not file or re.match(r"[a-z]+:", found[1]):
            return found[0]
        target = (page.parent / file).resolve()
        if target in names:
            return f"]({names[target]}.md{'#' * bool(anchor)}{anchor})"
        copy = folder / "files" / target.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(target, copy)
        return f"]({copy.relative_to(folder).as_posix()})"

    text = re.sub(r"\]\(([^)\s]+)\)", changed, page.read_text(encoding="utf-8"))
    return (
        text if text.startswith("#") else f"# Benchmark: {page.stem.replace('_', ' ')}\n\n{text}"
    )


def gallery(folder: Path, made: Path) -> str:
    """Pictures and output of the scripts of the gallery, where `make gallery` has made them."""
    lines = []
    for picture in sorted(made.glob("*.svg")):
        output = picture.with_suffix(".txt")
        if output.exists():
            shutil.copyfile(picture, folder / f"gallery_{picture.name}")
            lines += [
                "",
                f"## {picture.stem}",
                "",
                f"![{picture.stem}](gallery_{picture.name})",
                "",
            ]
            *text, last = output.read_text(encoding="utf-8").strip().splitlines()
            lines += ["```", *text, "```", "", f"Run time: {last.rpartition(', ')[2]}.", ""]
    return "\n".join(lines)


def contents(names: set[str]) -> str:
    """The tables of contents of the first page."""
    lines = []
    listed = {page for pages in CONTENTS.values() for page in pages.split()} | {"index"}
    for caption, pages in (CONTENTS | {"More": " ".join(sorted(names - listed))}).items():
        there = [page for page in pages.split() if page in names]
        lines += ["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *there, "```"]
    return "\n".join(lines) + "\n"


def write_sources(folder: Path) -> None:
    """Write all pages to an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    names = sources()
    pages = {name: with_links(page, folder, names) for page, name in names.items()}
    pages["c_reference"] = c_reference(ROOT / "generated" / "elbow")
    pages["gallery"] += gallery(folder, ROOT / "build" / "gallery")
    pages["index"] += contents({*pages, "python_reference"})
    for name, text in pages.items():
        (folder / f"{name}.md").write_text(text, encoding="utf-8")
    (folder / "python_reference.rst").write_text(python_reference(), encoding="utf-8")


def build(folder: Path) -> int:
    """Write the site to a folder; the exit status of Sphinx."""
    source = folder.parent / f"{folder.name}-source"
    write_sources(source)
    options = [
        "-b",
        "html",
        "-W",
        "--keep-going",
        "-n",
        "-q",
        "-c",
        str(DOCS),
        "-d",
        str(source / ".doctrees"),
    ]
    return sphinx([*options, str(source), str(folder)])


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build" / "docs").resolve()
    status = build(target)
    if status == 0:
        print(f"wrote {target / 'index.html'}")
    sys.exit(status)
