"""The documentation: Python and C run, commands parse, output is printed, links resolve, words are
plain.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from selection import slow

from flexgen.cli.main import main
from flexgen.cli.parser import parse

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ROOMS = sorted(
    path
    for path in (ROOT / "flexgen").glob("**/README.md")
    if path.parent.name not in ("clib", "shipped", "models")
)
PROSE = [
    *PAGES,
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    ROOT / "models" / "README.md",
    *ROOMS,
]
CODE = [*PAGES, ROOT / "models" / "README.md", ROOT / "generated" / "README.md", *ROOMS]
SUPPORT = str(ROOT / "tests" / "support")
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)

needs_compiler = pytest.mark.skipif(
    COMPILER is None, reason="no C compiler: install the Debian package gcc"
)

# Words that had a private meaning in this project. A regular expression each; the text says what
# to write instead.
PRIVATE_WORDS = {
    r"lots?(?! of\b)": "batches",
    r"crews?": "executors",
    r"bent": "modified (path)",
    r"bends?(?! (?:in two|about|along|sideways))": "deviation (of a path)",
    r"told|tells?": "reported, printed, logged",
    r"says?": "states, prints",
    r"hard core": "reduced problem",
    r"what fades": "the decaying part",
    r"twist\w*": "deflection (of a gear)",
    r"slopes?": "derivatives",
    r"uneven": "kinematic mismatch",
    r"inexact": "TOLERANCE_NOT_MET",
    r"spoil\w*": "set to NaN",
    r"referees?|judges?|judged": "check, verification",
    r"strangers?": "third party",
    r"crowds?": "plain words",
    r"(?:who|whoever) does not choose": "the default method",
    r"none that is allowed": "is out of range",
    r"a status that is true": "a status you can rely on",
    (
        r"linearis\w*|analys(?:e|ed|ing)|modelled|modelling|normalis\w*|"
        r"optimis\w*"
    ): "American spelling",
    r"centres?|colours?|metres?|licence": "American spelling",
}


def page_id(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(text: str, language: str, marks: tuple[str, ...] = ("",)) -> list[str]:
    """The code blocks of a language behind one of these markers; empty: without a marker.

    ``<!-- slow -->``: tens of seconds; ``<!-- minutes -->``; ``<!-- scheduler -->``,
    ``<!-- sketch -->``: what no test can have, such as a cluster or a file of the user.
    """
    found = re.findall(
        rf"(?:<!-- (\w+) -->\n)?^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL
    )
    return [code for mark, code in found if mark in marks]


@cache
def marked(mark: str) -> list[Path]:
    """Pages with Python behind a marker."""
    return [
        page for page in (*PAGES, *ROOMS) if blocks(page.read_text("utf-8"), "python", (mark,))
    ]


def prose(text: str) -> str:
    """The text without code: blocks, indented lines, and words in backticks."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^    .*$", "", text, flags=re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "", text)


def private_words(text: str) -> list[str]:
    """Private words in the prose of a text."""
    plain = prose(text)
    return [
        f"{found[0]!r}: write {instead}"
        for word, instead in PRIVATE_WORDS.items()
        for found in re.finditer(rf"\b(?:{word})\b", plain, re.IGNORECASE)
    ]


def anchors(text: str) -> set[str]:
    """The anchors of the headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def broken_links(page: Path) -> list[str]:
    """The relative links of a page that lead to no file or heading."""
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+://", link):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (
            anchor and anchor not in anchors(target.read_text(encoding="utf-8"))
        ):
            broken.append(link)
    return broken


# --- code ----------------------------------------------------------------------------------------
def alone(page: Path) -> bool:
    """Whether a page has Python, and no other test runs all of it: where its tests are slow, they
    run it once.
    """
    name = "test_python_of_the_pages_runs"
    twice = page in marked("slow") and slow("client/test_docs.py", name, page_id(page))
    return bool(blocks(page.read_text("utf-8"), "python")) and not twice


@needs_compiler
@pytest.mark.parametrize("page", [page for page in CODE if alone(page)], ids=page_id)
def test_python_of_the_pages_runs(page, tmp_path):
    runs(page, tmp_path, ("",))


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("page", marked("slow"), ids=page_id)
def test_slow_python_of_the_pages_runs(page, tmp_path):
    runs(page, tmp_path, ("", "slow"))


@pytest.mark.full
@needs_compiler
@pytest.mark.parametrize("page", marked("minutes"), ids=page_id)
def test_long_python_of_the_pages_runs(page, tmp_path):
    runs(page, tmp_path, ("", "minutes"))


def runs(page: Path, tmp_path: Path, marks: tuple[str, ...]) -> None:
    """Run the Python of a page and look for the output that it states; the pictures of its reports
    are not drawn.
    """
    code = "\n".join(blocks(page.read_text(encoding="utf-8"), "python", marks))
    undrawn = (
        f"import sys; sys.path.append({SUPPORT!r}); import undrawn; undrawn.draw_nothing()\n"
        * (".report(" in code)
    )
    done = subprocess.run(
        [sys.executable, "-c", undrawn + code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    # which git ignores
    assert {path.name for path in tmp_path.iterdir()} <= {"generated", "reports"}
    for line in re.findall(r"^print\(.*\)\s+# (.*)$", code, re.MULTILINE):
        start = line.partition("...")[0].partition(":")[0].strip()
        assert start in done.stdout, f"{line!r} is not in the output:\n{done.stdout}"


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page.read_text("utf-8"), "c")], ids=page_id
)
def test_c_of_the_pages_runs(page, tmp_path):
    """Compile each program of a page with the command that follows it."""
    text = page.read_text(encoding="utf-8")
    programs = re.findall(
        r"^```c\n(.*?)^```\n+    (cc [^\n]*)\n    (\./reports/\w+)$",
        text,
        re.MULTILINE | re.DOTALL,
    )
    assert len(programs) == len(blocks(text, "c")), (
        "a program without the command that compiles it"
    )
    assert text.index("mkdir -p reports") < text.index("```c\n"), (
        "a program in a folder that no command has made"
    )
    (tmp_path / "reports").mkdir()
    for code, command, program in programs:
        assert command.split()[-1] == program.removeprefix("./")
        model = re.findall(r"-Igenerated/(\w+)", command)[0]
        with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()):
            assert main(["generate", model, "--quiet"]) == 0
            # a header of the program
            for line in re.findall("^flexgen plan .*--out.*$", text, re.MULTILINE):
                assert main(line.split()[1:]) == 0
        # there the sources are compiled as in the text; the library has the same bits
        if page.name == "README.md":
            command = command.replace(" -O2 ", " -O0 ")
        else:
            command = re.sub(r"(generated/\w+)/src/\*\.c", rf"\1/lib{model}.a", command)
        source = re.findall(r"reports/\w+\.c", command)[0]
        (tmp_path / source).write_text(code)
        strict = f"{COMPILER} -Wall -Wextra -Werror "
        subprocess.run(command.replace("cc ", strict, 1), shell=True, cwd=tmp_path, check=True)
        printed = subprocess.run(
            [tmp_path / program], capture_output=True, text=True, check=True
        ).stdout
        assert f"```text\n{printed}```" in text, printed


def test_statuses_in_the_pages_are_those_of_the_header():
    header = (ROOT / "generated" / "elbow" / "elbow.h").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "c_library.md").read_text(encoding="utf-8")
    stated = dict(re.findall(r"^\| `([A-Z_]+)` \| (-?\d+) \|", page, re.MULTILINE))
    assert stated == dict(re.findall(r"ELBOW_([A-Z_]+) = (-?\d+)", header))


def test_commands_of_the_pages_parse():
    lines = [
        line
        for page in PAGES
        for language in ("", "bash")
        for block in blocks(page.read_text(encoding="utf-8"), language)
        for line in block.splitlines()
        if line.startswith("flexgen ")
    ]
    assert len(lines) > 20
    for line in lines:
        given = vars(parse(line.partition(" #")[0].split()[1:]))
        for path in (given.get("out"), given.get("report"), given.get("trajectory")):
            assert path is None or path.parts[0] == "reports"  # which git ignores


@pytest.mark.parametrize(
    "command",
    ["analyze planar5_nmp --pose 0.3,-1.1,0 --move line", "derive elbow@rigid"],
    ids=["analyze", "derive"],
)
def test_output_in_the_pages_is_printed(command, capsys):
    text = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    shown = re.search(
        rf"`flexgen {re.escape(command)}`.*?^```\n(.*?)^```$", text, re.MULTILINE | re.DOTALL
    )
    assert shown is not None
    assert main([*command.split(), "--quiet"]) == 0
    printed = {" ".join(line.split()) for line in capsys.readouterr().out.splitlines()}
    missing = [
        line
        for line in shown[1].splitlines()
        if line.strip("- ") and " ".join(line.split()) not in printed
    ]
    assert missing == []


# --- text ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("page", PROSE, ids=page_id)
def test_links_lead_somewhere(page):
    assert broken_links(page) == []


def test_every_page_is_in_the_index():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert [
        page.name
        for page in PAGES[1:]
        if page.name != "index.md" and f"({page.name})" not in index
    ] == []


def test_contributing_names_every_room_and_only_files_that_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rooms = {path.parent.name for path in (ROOT / "flexgen").glob("*/__init__.py")}
    assert {room for room in rooms if f"`{room}/`" not in text} == set()
    named = re.findall(r"`([a-z_/.]+(?:/|\.py|\.md))`", text)
    assert len(named) > 30
    assert [
        name
        for name in named
        if not (ROOT / name).exists() and not (ROOT / "flexgen" / name).exists()
    ] == []
    stations = re.findall(r"^\d+\. ", text, re.MULTILINE)
    assert 8 <= len(stations) <= 12


def readme_problems(room: Path) -> list[str]:
    """Faults of the README of a room: each of its files has to be named, each named file has to
    exist, in at most 75 lines.
    """
    text = (room / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w.]+\.(?:py|c)|\w+/)`", text))
    files = {
        path.name
        for path in room.iterdir()
        if path.suffix in (".py", ".c") and path.name != "__init__.py"
    }
    files |= {f"{path.parent.name}/" for path in room.glob("*/__init__.py")}
    problems = [f"{name}: not named" for name in sorted(files - named)]
    problems += [
        f"{name}: does not exist" for name in sorted(named - files) if not (room / name).exists()
    ]
    return problems + ["more than 75 lines"] * (len(text.splitlines()) > 75)


def test_every_room_has_a_readme_of_at_most_75_lines_that_names_its_files(tmp_path):
    rooms = {path.parent.name for path in (ROOT / "flexgen").glob("*/__init__.py")}
    assert {page.parent.name for page in ROOMS if page.parents[1].name == "flexgen"} == rooms
    assert {
        page.parent.name: problems for page in ROOMS if (problems := readme_problems(page.parent))
    } == {}
    (tmp_path / "new.py").touch()
    (tmp_path / "README.md").write_text("# Planted\n\n`old.py`\n")
    assert readme_problems(tmp_path) == ["new.py: not named", "old.py: does not exist"]


@pytest.mark.parametrize("page", PROSE, ids=page_id)
def test_words_are_plain(page):
    assert private_words(page.read_text(encoding="utf-8")) == []


def test_words_of_the_notebooks_are_plain():
    for file in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        text = "\n\n".join(
            "".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"
        )
        assert len(text) > 200 and private_words(text) == [], file.name


@pytest.mark.parametrize("page", PROSE, ids=page_id)
def test_springs_of_toml_blocks_have_a_type(page):
    blocks = re.findall(
        r"^```toml$(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    springs = [spring for block in blocks for spring in re.findall(r"spring = \{([^}]*)\}", block)]
    assert [spring for spring in springs if "type = " not in spring] == []


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 130


# --- planted errors ------------------------------------------------------------------------------
def test_planted_word_and_link_are_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# Page\n\nThe path is bent, as [there](none.md) and [here](#nowhere) and [here](#page).\n"
    )
    assert len(private_words(page.read_text())) == 1
    assert broken_links(page) == ["none.md", "#nowhere"]
