"""The emitted sources in generated/elbow are those that flexgen writes today."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import pytest
from emitted import ROOT
from emitted_hashes import GOLDEN_CASADI

from flexgen.codegen.build.generate import generate

GOLDEN = ROOT / "generated" / "elbow"


def test_the_sources_in_the_repository_are_those_emitted_now(tmp_path):
    """``make golden`` writes them again; read the difference before you commit it."""
    if not version("casadi").startswith(f"{GOLDEN_CASADI}."):
        pytest.skip(
            f"written with CasADi {GOLDEN_CASADI}; run: pip install 'casadi~={GOLDEN_CASADI}.0'"
        )
    today = generate("elbow", tmp_path / "elbow", build=False)
    texts = {path.relative_to(today.directory): path.read_bytes() for path in today.files}
    texts.pop(Path("manifest.json"))
    kept = {
        path.relative_to(GOLDEN)
        for path in GOLDEN.rglob("*")
        if path.suffix in (".c", ".h", ".pc", ".txt")
    }
    assert kept == set(texts), "run: make golden"
    changed = [str(name) for name, text in texts.items() if (GOLDEN / name).read_bytes() != text]
    assert not changed, "run: make golden"
