"""Plain English in documentation, docstrings, comments, messages and names of tests: a list of
idioms to avoid.

The idioms are German constructions in English words, or words with a private meaning. A reader who
is a control engineer should understand every sentence at the first reading.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ENDINGS = {".py", ".pyi", ".c", ".h", ".m", ".md", ".in", ".ipynb"}
FOLDERS = ("flexgen", "docs", "examples", "benchmarks", "tests")
PAGES = ("README.md", "CONTRIBUTING.md", "models/README.md", "Makefile", "pyproject.toml")
# Golden files follow from other texts; the other two are lists of words.
DERIVED = ("tests/golden/", "tests/client/test_plain_english.py", "tests/client/test_docs.py")


@dataclass(frozen=True)
class Idiom:
    """A regular expression every hit of which is wrong, what is wrong with it, and what to write
    instead.
    """

    pattern: str
    why: str
    instead: str


IDIOMS = (
    Idiom(
        r"(?<=[\w`),;:.] )beside (?=[\w`\"{\[])(?!the lines|is |else )",
        "has four meanings",
        "in addition to, next to, relative to, besides",
    ),
    Idiom(
        r"what (?:is|was) left of",
        "a clause for a noun",
        "the remaining, the residual, the rest of",
    ),
    Idiom(
        r"(?:stands?|stood) for", "unclear: names, equals or replaces", "is, means, is the name of"
    ),
    Idiom(r"go(?:es)? on", "colloquial", "continue"),
    Idiom(
        r"(?:process|thread)(?:es|s)? of (?:its|their) own",
        "German word order",
        "a separate process",
    ),
    Idiom(
        r"(?:nobody|somebody|everybody|whoever)",
        "a program has users and processes",
        "name who it is, or use the passive",
    ),
    Idiom(r"in vain", "literary", "unnecessarily, without use"),
    Idiom(r"dust", "private word", "rounding errors, entries below the tolerance"),
    Idiom(r"(?:the|same|no|carr(?:y|ies)) matter", "private word", "body, mass, inertia"),
    Idiom(r"of now", "German 'von jetzt'", "current"),
    Idiom(r"as (?:one|you) likes?", "colloquial", "freely, arbitrarily"),
    Idiom(r"believe[sd]?", "programs do not believe", "trust, accept, rely on"),
    Idiom(
        r"(?<!there )(?:is|are|was|were) no (?!longer|more|less|larger|smaller|such|\w+er than)\w",
        "German 'ist kein'",
        "is not a ...",
    ),
    Idiom(r"(?:that|which) (?:is|are|was|were) none\b", "German 'die keine sind'", "invalid"),
    Idiom(r"half ?way", "colloquial", "at the midpoint, in the middle"),
    Idiom(r"honest\w*", "programs are not honest", "correct, exact, documented"),
    Idiom(r"leads? back", "a clause for a noun", "the inverse"),
    Idiom(r"so many times", "a clause for a noun", "multiplied by"),
    Idiom(r"share of itself", "private phrase", "is reduced by the factor"),
    Idiom(r"all the same(?=[.,;:\"])", "ambiguous: nevertheless, or equal", "nevertheless"),
)

# Rooms that are still to be rewritten: the largest number of hits, which may only decrease.
TO_DO: dict[str, int] = {}

_ANY = re.compile("|".join(rf"\b{idiom.pattern}" for idiom in IDIOMS), re.IGNORECASE)
_EACH = [(re.compile(rf"\b{idiom.pattern}", re.IGNORECASE), idiom) for idiom in IDIOMS]
_LINE_BREAK = re.compile(r"[ \t]*\n[ \t]*(?:(?:#:?|\*(?!/)|//|%)[ \t]*)?")


def flat(text: str) -> str:
    """The text in one line, without the signs of comments, and the names of its tests as
    sentences.
    """
    names = [name.replace("_", " ") for name in re.findall(r"\bdef (test_\w+)", text)]
    return _LINE_BREAK.sub(" ", "\n".join([text, *names]))


def hits(text: str) -> list[tuple[str, Idiom]]:
    """Idioms in a text, each with its surroundings."""
    whole = flat(text)
    if not _ANY.search(whole):
        return []
    return [
        (whole[max(0, found.start() - 50) : found.end() + 40], idiom)
        for pattern, idiom in _EACH
        for found in pattern.finditer(whole)
    ]


def files() -> Iterator[Path]:
    """All files of the repository with prose for its readers."""
    yield from (ROOT / page for page in PAGES)
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            name = path.relative_to(ROOT).as_posix()
            if (
                path.suffix in ENDINGS
                and not name.startswith(DERIVED)
                and "__pycache__" not in name
            ):
                yield path


def test_no_idiom_in_documentation_comments_messages_and_test_names():
    wrong = []
    counted = Counter[str]()
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        found = hits(path.read_text(encoding="utf-8"))
        room = "/".join(name.split("/")[:2])
        if room in TO_DO:
            counted[room] += len(found)
        else:
            wrong += [
                f"{name}: ...{near}...: {idiom.why}; write: {idiom.instead}"
                for near, idiom in found
            ]
    assert wrong == []
    assert {
        room: (counted[room], most) for room, most in TO_DO.items() if counted[room] > most
    } == {}


@pytest.mark.parametrize(
    "sentence",
    [
        "The noise of the sensors beside the encoders.",
        "ends where what is left of\n    # it is small",
        "one that is renamed is not believed",
        "/* results that many points would fill\n * in vain */",
        "gives the torques of now",
        "an R that is no rotation",
        "given a port that is none, expected [shape, unit]",
        "put back where somebody needs it",
        "def test_nobody_finds_it(tmp_path):",
        "is zero, but for dust.",
    ],
)
def test_planted_idiom_is_found(sentence):
    assert len(hits(f"# ok\n{sentence}\n")) == 1


@pytest.mark.parametrize(
    "sentence", ["It is no longer valid.", "There is no solution.", "spectra beside the lines"]
)
def test_plain_sentence_is_accepted(sentence):
    assert hits(sentence) == []
