"""Bill of materials of flexgen and of what it needs to run: python .ci/sbom.py [FILE], default
dist/sbom.cdx.json.

CycloneDX 1.5, JSON. Versions and licenses are those of the installed packages, read with
importlib.metadata; the required packages are those of pyproject.toml without extras. The same
installation gives the same bytes.
"""

from __future__ import annotations

import json
import os
import sys
import tomllib
import uuid
from datetime import UTC, datetime
from importlib.metadata import PackageMetadata, PackageNotFoundError, metadata, requires
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def needed(requirements: list[str]) -> list[str]:
    """Names of the packages of these requirements that this computer needs, without extras."""
    found = (Requirement(text) for text in requirements)
    return sorted(
        {
            canonicalize_name(r.name)
            for r in found
            if r.marker is None or r.marker.evaluate({"extra": ""})
        }
    )


def closure(names: list[str]) -> dict[str, list[str]]:
    """Each package that is needed, directly or by another one, and what it needs.

    Raises
    ------
    SystemExit
        A package is not installed.
    """
    graph: dict[str, list[str]] = {}
    todo = list(names)
    while todo:
        name = todo.pop()
        if name not in graph:
            try:
                graph[name] = needed(requires(name) or [])
            except PackageNotFoundError:
                raise SystemExit(
                    f"sbom: package {name} is not installed; run: make setup"
                ) from None
            todo += graph[name]
    return dict(sorted(graph.items()))


def license_of(package: PackageMetadata) -> str:
    """License of a package: its expression, else its classifiers, else the first line of its
    text.
    """
    if expression := package.get("License-Expression"):
        return expression
    classifiers = (
        c
        for c in package.get_all("Classifier") or []
        if c.count("::") == 2 and c.startswith("License")
    )
    words = [c.rpartition("::")[2].strip() for c in classifiers]
    return " OR ".join(words) or next(
        iter((package.get("License") or "unknown").strip().splitlines())
    )


def version() -> str:
    """Of flexgen, from the text of the package."""
    text = (ROOT / "flexgen" / "base" / "version.py").read_text(encoding="utf-8")
    return text.partition('__version__ = "')[2].partition('"')[0]


def component(name: str, release: str, text: str, kind: str) -> dict[str, Any]:
    """An entry of the list."""
    reference = f"pkg:pypi/{name}@{release}"
    licenses = [{"license": {"name": text}}]
    return {
        "type": kind,
        "bom-ref": reference,
        "name": name,
        "version": release,
        "licenses": licenses,
        "purl": reference,
    }


def bill() -> dict[str, Any]:
    """The bill of materials."""
    own = component(PROJECT["name"], version(), PROJECT["license"], "application")
    graph = closure(needed(PROJECT["dependencies"]))
    parts = {
        n: component(n, metadata(n)["Version"], license_of(metadata(n)), "library") for n in graph
    }
    edges = [
        (own, needed(PROJECT["dependencies"])),
        *((parts[name], names) for name, names in graph.items()),
    ]
    listed = [
        {"ref": a["bom-ref"], "dependsOn": [parts[name]["bom-ref"] for name in names]}
        for a, names in edges
    ]
    content = json.dumps([own, *parts.values()], sort_keys=True)
    time = datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH", "315532800")), UTC)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, content)}",
        "version": 1,
        "metadata": {"timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ"), "component": own},
        "components": list(parts.values()),
        "dependencies": listed,
    }


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "dist" / "sbom.cdx.json")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(bill(), indent=2) + "\n", encoding="utf-8")
    print(f"wrote {target}")
