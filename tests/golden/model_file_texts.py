"""Messages of wrong files, what is read from valid ones, the JSON schema and files written back
are what they were.

``make golden`` writes `model_files.txt` again; read the difference before you commit it.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from bad_models import CASES, edited
from bad_urdfs import BAD_OVERLAY, BAD_URDF, OVERLAY, URDF
from model_files import ROOT, everything, mutated, outcome, overlay

import flexgen
from flexgen.studies.templates.new_model import TEMPLATES, new_model

MUTATIONS = {
    "everything": 60,
    "overlay": 20,
    "manutec_r3": 10,
    "planar5_family": 10,
    "four_mass": 10,
    "program": 20,
}
WRITTEN = ("planar5_nmp", "manutec_r3_18", "kr300_efjm", "everything")


def digest(value: Any) -> str:
    """A hash of JSON types whose keys have no order."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:10]


def edited_files(folder: Path) -> Iterator[str]:
    """The messages of the wrong models, URDF files and overlays of the tests."""
    path = folder / "arm.toml"
    for case, (edits, *_) in CASES.items():
        path.write_text(edited(edits))
        yield f"model, {case}: {outcome(flexgen.read, path)}"
    for kind, cases in (("URDF", BAD_URDF), ("overlay", BAD_OVERLAY)):
        for case, (edits, *_) in cases.items():
            for name, text in (("arm.urdf", URDF), ("arm.toml", OVERLAY)):
                for old, new in edits if (name == "arm.urdf") == (kind == "URDF") else ():
                    text = text.replace(old, new, 1)
                (folder / name).write_text(text, encoding="utf-8")
            yield f"{kind}, {case}: {outcome(flexgen.read, path)}"


def mutated_files(folder: Path) -> Iterator[str]:
    """Model files with changed keys and values."""
    robot = flexgen.read("manutec_r3")
    for name, count in MUTATIONS.items():
        read: Callable[[Path], Any] = flexgen.read
        source = ROOT / "models" / f"{name}.toml"
        if name == "everything":
            source = everything(folder)
        elif name == "overlay":
            source = overlay(folder)
        elif name == "program":
            source = ROOT / "tests/support/programs/manutec.toml"
            read = partial(flexgen.read_moves, model=robot)
        valid = tomllib.loads(source.read_text())
        for number in range(count):
            path = folder / "mutated.toml"
            path.write_text(mutated(name, number, valid))
            yield f"{name} {number}: {outcome(read, path)}"


def valid_files(folder: Path) -> Iterator[str]:
    """Hashes of all models, and of the texts that flexgen writes."""
    robots = sorted((ROOT / "tests/support/robots").glob("*.toml"))
    for path in [*sorted((ROOT / "models").glob("*.toml")), *robots]:
        if "package://" in path.read_text():
            continue  # of a package that is not always there
        shutil.copy(path, folder)
        shutil.copy(ROOT / "models/urdf_arm.urdf", folder)
        robot = flexgen.read(path)
        names = "".join(
            f", {name} {outcome(partial(flexgen.read, variant=name), path)}"
            for name in robot.variants
        )
        yield (
            f"{path.stem}: {outcome(flexgen.read, folder / path.name)}{names}; described "
            f"{digest(_described(robot))}"
        )
    for name in WRITTEN:
        source = ROOT / "models" / f"{name}.toml"
        if name == "everything":  # but beam and loop, which a URDF file cannot have
            source = everything(folder)
            before, _, rest = source.read_text().partition('[[element]]\nname = "left"')
            tree = before + rest[rest.index("[[motor]]") :]
            before, _, rest = tree.partition("[[loop]]")
            tree = before + rest[rest.index("[[line]]") :]
            source.write_text(tree.replace("mass = 2 }", "mass = 2, inertia = [1, 1, 1] }"))
        flexgen.export_urdf(source, folder / f"{name}_back.urdf")
        text = (folder / f"{name}_back.toml").read_text()
        tables = text.replace(flexgen.__version__, "VERSION").split("\n\n")
        yield f"{name} written back: " + " ".join(digest(table) for table in tables)
    for template in TEMPLATES:
        yield f"template {template}: {digest(new_model('robot', template))}"
    text = new_model("arm", urdf=f"{ROOT / 'models/urdf_arm.urdf'}#floor:tool_point", folder=ROOT)
    yield f"new overlay: {digest(text)}"


def _described(robot: flexgen.RobotModel) -> dict[str, Any]:
    return flexgen.describe(robot) | {"file": ""}


def schemas() -> Iterator[str]:
    """Hashes of each key of each table of the JSON schema."""

    def walk(path: str, here: Any) -> Iterator[str]:
        if isinstance(here, list):
            for k, item in enumerate(here):
                yield from walk(f"{path}[{k}]", item)
        if not isinstance(here, dict):
            return
        if here.get("type") == "object":
            keys = here.get("properties", {}).items()
            rest = digest({key: value for key, value in here.items() if key != "properties"})
            yield f"schema {path}: {rest}" + "".join(
                sorted(f" {key}={digest(value)[:6]}" for key, value in keys)
            )
        for key, value in sorted(here.items()):
            yield from walk(f"{path}.{key}".replace(".properties", ""), value)

    for kind in ("model", "program"):
        yield from walk(kind, {**flexgen.schema(kind), "title": ""})


def today() -> list[str]:
    """All lines."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        return [*schemas(), *valid_files(place), *edited_files(place), *mutated_files(place)]
