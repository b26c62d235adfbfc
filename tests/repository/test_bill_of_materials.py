"""The bill of materials, and the licenses in docs/licenses.md, compared with the metadata of the
installed packages.
"""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
FAMILIES = {
    "BSD": r"BSD",
    "MIT": r"\bMIT\b",
    "LGPL": r"LGPL|Lesser General Public",
    "Apache": r"Apache",
    "PSF": r"PSF|Python Software Foundation",
    "MPL": r"\bMPL\b|Mozilla",
    "NVIDIA": r"NVIDIA",
}


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sbom", ROOT / ".ci" / "sbom.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def listed() -> dict[str, str]:
    """Packages and licenses of the page."""
    page = (ROOT / "docs" / "licenses.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^\| `([\w-]+)` \| ([^|]*) \|", page, re.MULTILINE))


def families(text: str) -> set[str]:
    return {name for name, pattern in FAMILIES.items() if re.search(pattern, text)}


def disagreements(stated: dict[str, str], found: dict[str, str]) -> list[str]:
    """Packages that the page lacks, or whose license is of another family there."""
    return [
        name
        for name, text in found.items()
        if name not in stated
        or not families(stated[name])
        or not families(text) & families(stated[name])
    ]


def test_licenses_of_the_page_are_those_of_the_packages(script: ModuleType) -> None:
    names = set(script.closure(script.needed(script.PROJECT["dependencies"])))
    for extra in script.PROJECT["optional-dependencies"].values():
        names |= {Requirement(text).name for text in extra} - {script.PROJECT["name"]}
    found = {}
    for name in sorted(names):
        try:
            text = script.license_of(metadata(name))
            if text != "unknown":  # a package that does not state it: only its row
                found[name] = text
            assert name in listed(), name
        except PackageNotFoundError:
            assert name in listed(), name  # an extra that is not installed: only its row
    assert len(found) >= 12
    assert disagreements(listed(), found) == []
    # planted
    assert disagreements(listed(), {"numpy": "LGPL-3.0", "nosuch": "MIT"}) == ["numpy", "nosuch"]


def test_the_bill_lists_what_running_needs(script: ModuleType, tmp_path: Path) -> None:
    target = tmp_path / "sbom.json"
    subprocess.run(
        [sys.executable, ROOT / ".ci" / "sbom.py", target], check=True, capture_output=True
    )
    bill = json.loads(target.read_text(encoding="utf-8"))
    assert bill["bomFormat"] == "CycloneDX" and bill["specVersion"] == "1.5"
    parts = {part["name"]: part for part in bill["components"]}
    direct = {Requirement(text).name for text in script.PROJECT["dependencies"]}
    assert direct <= set(parts) and "contourpy" in parts  # needed by matplotlib
    for name, part in parts.items():
        assert (
            part["version"] == version(name)
            and part["purl"] == f"pkg:pypi/{name}@{part['version']}"
        )
        assert part["licenses"][0]["license"]["name"] != "unknown"
    references = {part["bom-ref"] for part in parts.values()} | {
        bill["metadata"]["component"]["bom-ref"]
    }
    assert {entry["ref"] for entry in bill["dependencies"]} == references
    assert all(set(entry["dependsOn"]) <= references for entry in bill["dependencies"])
    assert json.dumps(script.bill()) == json.dumps(bill)  # a second time, the same
