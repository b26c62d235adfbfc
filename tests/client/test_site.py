"""The site: it is built without a warning, has every public name, and loads nothing from a
network.
"""

from __future__ import annotations

import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

import flexgen
from flexgen.dynamics.mechanics.equations import BUILDERS
from flexgen.dynamics.mechanics.signatures import TABLE

ROOT = Path(__file__).resolve().parents[2]


def names_in_inventory(file: Path) -> set[str]:
    """The objects of Python in an inventory of Sphinx, format 2: four lines of text, then
    compressed lines.
    """
    _, _, _, _, packed = file.read_bytes().split(b"\n", 4)
    lines = zlib.decompress(packed).decode("utf-8").splitlines()
    return {line.split()[0] for line in lines if line.split()[1].startswith("py:")}


def missing_names(names: set[str]) -> list[str]:
    """The public names that a reference lacks."""
    public = (name for name in flexgen.__all__ if name != "__version__")
    return [name for name in public if f"flexgen.{name}" not in names]


def loaded_from_a_network(page: str) -> list[str]:
    """Addresses that a browser loads with a page: scripts, pictures, frames, style sheets and
    fonts; no links.
    """
    tags = re.findall(r"<(?:script|img|iframe|link|source|video)\b[^>]*>", page)
    return [tag for tag in tags if re.search(r"(?:src|href)=[\"']?(?:https?:)?//", tag)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("furo")
    folder = tmp_path_factory.mktemp("site") / "docs"
    command = [sys.executable, ROOT / "docs" / "build_site.py", folder]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_every_public_name_is_in_the_reference(site: Path) -> None:
    names = names_in_inventory(site / "objects.inv")
    assert missing_names(names) == []
    assert missing_names(names - {"flexgen.solve"}) == ["solve"]  # planted


@pytest.mark.slow
def test_every_function_of_the_table_is_in_the_references(site: Path) -> None:
    python, c = (
        (site / page).read_text(encoding="utf-8")
        for page in ("python_reference.html", "c_reference.html")
    )
    text = re.sub(r"<[^>]*>", "", python)
    assert [name for name in BUILDERS if f"{name}(" not in text] == []
    assert [row.name for row in TABLE if f">{row.name}<" not in c] == []
    for name in ("invert", "stream_update", "path_sample", "status_text"):
        assert name in c


@pytest.mark.slow
def test_no_page_loads_from_a_network(site: Path) -> None:
    pages = list(site.glob("*.html"))
    assert len(pages) > 25
    assert {
        page.name: found
        for page in pages
        if (found := loaded_from_a_network(page.read_text("utf-8")))
    } == {}
    styles = list(site.rglob("*.css"))
    assert styles and not any(
        re.search(r"url\([\"']?(?:https?:)?//", page.read_text("utf-8")) for page in styles
    )


def test_a_planted_address_is_seen() -> None:
    assert (
        len(
            loaded_from_a_network(
                '<script src="https://x.org/a.js"></script><a href="https://x.org">x</a>'
            )
        )
        == 1
    )
    assert (
        len(
            loaded_from_a_network(
                '<link rel="stylesheet" href="//x.org/a.css"/><img src="_static/a.png">'
            )
        )
        == 1
    )
