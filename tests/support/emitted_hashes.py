"""Hashes of all files that flexgen emits for six models, with nine digits of their numbers."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from typing import Any

from golden_texts import nine_digits

from flexgen.codegen.build.generate import generate

GOLDEN_CASADI = "3.8"  # another CasADi may order the operations of the same mathematics otherwise
# The models differ in output, gears and number of joints; each has another choice of `generate`.
CHOICES: dict[str, dict[str, Any]] = {
    "elbow": {"amalgamate": True},
    "planar5_nmp": {},
    "four_mass": {"precision": "single"},
    "beam_arm": {"parameters": ["payload"]},
    "abb_arm": {"per_point": True, "parameters": ["payload"]},
    "manutec_r3": {},
}
# of the manifest: versions and other hashes
_OF_TODAY = ("digest", "generator", "casadi", "files", "build")


def digest(text: str) -> str:
    """SHA-256 of a text with nine digits of each number, without the hash of the library in it."""
    return hashlib.sha256(nine_digits(re.sub(r"\b[0-9a-f]{64}\b", "", text)).encode()).hexdigest()


def hashes(model: str) -> dict[str, str]:
    """SHA-256 by file of the library of a model; of the manifest without what each version of
    flexgen changes.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = generate(model, folder, build=False, progress=False, **CHOICES[model])
        texts = {
            path.relative_to(made.directory).as_posix(): path.read_text(encoding="utf-8")
            for path in made.files
        }
    manifest = json.loads(texts.pop("manifest.json"))
    kept = {key: value for key, value in manifest.items() if key not in _OF_TODAY}
    texts["manifest.json"] = json.dumps(kept, sort_keys=True)
    return {file: digest(text) for file, text in sorted(texts.items())}


def rows(model: str) -> str:
    """One line for each file: model, file and hash."""
    return "".join(f"{model} {file} {found}\n" for file, found in hashes(model).items())
