"""All golden texts; `update.py` writes them, `test_golden_texts.py` compares them."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import emitted_hashes
import export_hashes
import export_tables
import front_table
import key_page
import model_file_texts
import page_texts
import path_texts
import picture_texts
import printed_results
import public_face
import public_stub
import room_pages
import room_picture
import support_page
from golden_texts import Files, Golden, Rows, Sections

from flexgen.codegen.build.generate import generate

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
ELBOW = ROOT / "generated" / "elbow"
# Of the files of a generated library, those in the repository.
SOURCES = (".c", ".h", ".pc", ".txt")


def elbow_files() -> list[str]:
    """The files of the generated elbow in the repository and of today."""
    kept = {
        path.relative_to(ELBOW).as_posix() for path in ELBOW.rglob("*") if path.suffix in SOURCES
    }
    return sorted(kept | set(_elbow()))


def _elbow() -> dict[str, str]:
    if not _ELBOW:
        with tempfile.TemporaryDirectory() as folder:
            made = generate("elbow", Path(folder) / "elbow", build=False, progress=False)
            texts = {
                path.relative_to(made.directory).as_posix(): path.read_text(encoding="utf-8")
                for path in made.files
            }
        texts.pop("manifest.json")
        _ELBOW.update(texts)
    return _ELBOW


_ELBOW: dict[str, str] = {}


def rooms(_: str) -> str:
    """The picture of the rooms; it reads the imports as the test of the architecture does."""
    rules = next((ROOT / "tests").rglob("test_architecture.py"))
    sys.path.append(str(rules.parent))
    return room_picture.picture()


def _sections(name: str, module: object, casadi: bool = False) -> Golden:
    """A file of this folder that a module with ``cases`` and ``lines`` renders."""
    return Sections(
        HERE / name,
        lambda: list(module.cases()),  # type: ignore[attr-defined]
        lambda part: "\n".join(module.lines(part)),  # type: ignore[attr-defined]
        casadi,
    )


def _page_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


GOLDEN: dict[str, Golden] = {
    "elbow": Files(ELBOW, elbow_files, lambda part: _elbow().get(part, ""), casadi=True),
    "emitted": Rows(
        HERE / "emitted.txt", lambda: emitted_hashes.CHOICES, emitted_hashes.rows, casadi=True
    ),
    "front": Files(front_table.SOURCE, lambda: [front_table.FRONT.name], front_table.front),
    "stub": Files(
        public_stub.STUB.parent, lambda: [public_stub.STUB.name], lambda _: public_stub.stub()
    ),
    "room pages": Files(
        room_pages.SOURCE,
        lambda: [f"{room}/README.md" for room in room_pages.ORDER],
        lambda part: room_pages.pages()[room_pages.SOURCE / part],
    ),
    "rooms": Files(ROOT / "docs", lambda: [room_picture.PICTURE.name], rooms),
    "face": Files(
        public_face.FOLDER,
        lambda: [f"{name}.txt" for name in public_face.TEXTS],
        lambda part: public_face.TEXTS[part.removesuffix(".txt")](),
    ),
    "model_files": Files(
        HERE, lambda: ["model_files.txt"], lambda _: "\n".join(model_file_texts.today()) + "\n"
    ),
    "pictures": _sections("pictures.txt", picture_texts),
    "pages": _sections("pages.txt", page_texts),
    "results": _sections("results.txt", printed_results),
    "path_texts": _sections("path_texts.txt", path_texts),
    "exports": _sections("exports.txt", export_hashes, casadi=True),
    "keys": Files(ROOT / "docs", lambda: [key_page.PAGE.name], lambda _: key_page.page()),
    "recording_keys": Files(
        ROOT / "docs", lambda: [key_page.RECORDINGS.name], lambda _: key_page.recordings_page()
    ),
    "support": Files(
        ROOT / "docs", lambda: [support_page.PAGE.name], lambda _: support_page.page()
    ),
    "export_tables": Files(
        ROOT,
        lambda: [_page_of(path) for path in export_tables.pages()],
        lambda part: export_tables.pages()[ROOT / part],
    ),
}
