"""Write the recipe of a conda package of the sdist: python .ci/conda.py [FOLDER], default dist.

Name, texts, requirements and commands are those of pyproject.toml; the packages have the same
names on conda-forge. The recipe is JSON, which is YAML. Build with `rattler-build build --recipe
FOLDER/recipe.yaml --channel conda-forge`.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tomllib
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]


def spec(requirement: str) -> str:
    """A requirement of pip as one of conda: name, blank, versions."""
    found = Requirement(requirement)
    return f"{found.name} {found.specifier}".strip()


def recipe(project: dict[str, Any], built_with: list[str], sdist: Path) -> dict[str, Any]:
    """The recipe of the package of an sdist; ``project``: the table of pyproject.toml."""
    python = f"python {project['requires-python']}"
    return {
        "schema_version": 1,
        "package": {
            "name": project["name"],
            "version": sdist.name.removesuffix(".tar.gz").rpartition("-")[2],
        },
        "source": {"path": sdist.name, "sha256": hashlib.sha256(sdist.read_bytes()).hexdigest()},
        "build": {
            "noarch": "python",
            "script": "python -m pip install . --no-deps --no-build-isolation",
            "python": {
                "entry_points": [
                    f"{name} = {target}" for name, target in project["scripts"].items()
                ]
            },
        },
        "requirements": {
            "host": [python, "pip", *map(spec, built_with)],
            "run": [python, *map(spec, project["dependencies"])],
        },
        "tests": [{"python": {"imports": ["flexgen"]}}, {"script": ["flexgen --version"]}],
        "about": {
            "summary": project["description"],
            "license": project["license"],
            "license_file": project["license-files"],
        },
    }


def write(folder: Path) -> Path:
    """Write FOLDER/recipe.yaml for the sdist in this folder."""
    archives = sorted(folder.glob("*.tar.gz"))
    if len(archives) != 1:
        sys.exit(
            f"{folder}: given {len(archives)} archives .tar.gz, expected one; make dist writes it"
        )
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    made = recipe(pyproject["project"], pyproject["build-system"]["requires"], archives[0])
    path = folder / "recipe.yaml"
    path.write_text(json.dumps(made, indent=2) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    print(f"wrote {write(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / 'dist').resolve())}")
