"""Reader of model files: finds the file, parses it, applies a variant and checks every value."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.registry import find_function
from flexgen.base.spec import toml_lines
from flexgen.base.spec.keys import Context
from flexgen.base.spec.keys import read as read_table
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.tables import Table, bare, closest, parse_file, part_of, show
from flexgen.base.spec.toml_lines import Entry
from flexgen.model.elements import RobotModel, UrdfJoint
from flexgen.model.format.format import MODEL, VARIANT
from flexgen.model.urdf.urdf_source import from_here, plain_urdf


@checked_types(own=("model",))
def read(
    model: str | Path,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    *,
    base: str | None = None,
    tip: str | None = None,
) -> RobotModel:
    """Read and check a model file.

    Parameters
    ----------
    model : str or Path
        A name in the models folder (such as ``"planar5_nmp"``) or the path of a ``.toml`` file;
        either may end in ``"@variant"``. Or a URDF file with the two ends of its chain: the path
        of a ``.urdf`` file or ``"package://NAME/PATH"``, either with ``base`` and ``tip`` or
        followed by ``"#base:tip"``.
    variant : str, optional
        Name of one of the file's variants.
    overrides : mapping, optional
        Values to set after the variant. A key is a dotted path; an entry of a list is selected by
        its name, as in ``"element.arm1.dof.q1.gear.damping"``.
    base, tip : str, optional
        Names of the first and the last link of the chain in a URDF file.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        The file has an error.
    ArgumentError
        There is no such file, name or variant.

    Examples
    --------
    >>> flexgen.read("elbow", overrides={"motor.m1.inertia": 0.004}).motors[0].inertia
    0.004
    """
    plain = plain_urdf(model, base, tip)
    if plain is not None:
        root, shown, again = plain
        folder = Path()
        chosen = variant or ""
    else:
        path, shown, chosen = _find(model, variant)
        root = parse_file(path, shown)
        folder = path.parent
        again = shown
    urdf = "urdf" in root.value
    joints: Mapping[str, UrdfJoint] = {}
    if urdf:
        from flexgen.model.urdf.overlay import expand

        joints = expand(root, folder, shown)
    variants = _variants(root, shown)
    if chosen and chosen not in variants:
        known = closest(chosen, variants)
        if not variants:
            known = f"no variant: the file has no table [variant.{bare(chosen)}]"
        raise ArgumentError(f"variant of {shown}: given {chosen!r}, expected {known}")
    unchanged = toml_lines.copy(root)
    if chosen:
        variants[chosen].apply(root)
    if overrides is not None and not isinstance(overrides, Mapping):
        raise ArgumentError(
            f"overrides: given {show(overrides)}, expected a mapping of dotted paths to values, "
            f"such as "
            '{"payload.mass": 2.0}'
        )
    kept = {}
    for key, value in (overrides or {}).items():
        kept[key] = _override(root, shown, key, value)
    robot = _robot(Table(shown, root, ""), chosen, tuple(variants))
    for other in variants.values():  # checks the paths of the variants that were not chosen
        other.apply(toml_lines.copy(unchanged))
    if urdf:
        _check_inertia(root, robot)
    return replace(robot, file=again, urdf_joints=joints, overrides=kept)


def model_names() -> list[str]:
    """List the names of all models in the models folders, sorted."""
    found = (path for folder in _folders() for path in folder.glob("[!.]*.toml"))
    return sorted({path.stem for path in found if path.is_file() and path.stem.isprintable()})


def _folders() -> list[Path]:
    """Folders in which names are looked up, in this order.

    FLEXGEN_MODELS, ``models/`` in the current directory, and the models that come with flexgen:
    inside the package, which in a clone has a link to the folder ``models/`` of the repository.
    """
    named = os.environ.get("FLEXGEN_MODELS")
    if named and not Path(named).is_dir():
        raise ArgumentError(
            f"FLEXGEN_MODELS: given {named!r}, which is not a folder, expected a folder of "
            "model files"
        )
    found = [Path(named)] if named else []
    found += [Path("models"), packaged_models()]
    return [folder for folder in found if folder.is_dir()]


def packaged_models() -> Path:
    """The folder of the models that come with flexgen."""
    return Path(__file__).with_name("shipped").resolve()


def _find(model: str | Path, variant: str | None) -> tuple[Path, str, str]:
    """The file, its name in messages, and the name of the variant (empty: none).

    ``model``: a name, which is searched in the folders of models, or a path; either may end in
    ``@variant``. ArgumentError where there is no such file, or two variants are given.
    """
    if not isinstance(model, (str, Path)) or not isinstance(variant, (str, type(None))):
        raise ArgumentError(
            f"model: given {model!r} and variant {variant!r}, expected a name or path, and the "
            "name of a variant"
        )
    text = str(model)
    chosen = variant or ""
    head, at, tail = text.rpartition("@")
    if at and not set(tail) & set("/\\."):
        if not tail or (chosen and chosen != tail):
            raise ArgumentError(
                f"model: given {text!r} and variant {variant!r}, expected one variant name"
            )
        if re.search(r"@[^@/\\.]*$", head):
            raise ArgumentError(
                f"model: given {text!r}, which has two variants, expected one, MODEL@VARIANT; for "
                "the changes of both write a third one in the file, or set single keys in addition"
            )
        text = head
        chosen = tail
    if not text.endswith(".toml") and not set(text) & set("/\\"):
        for folder in _folders():
            path = folder / f"{text}.toml"
            try:
                if path.is_file():
                    return path, from_here(path), chosen
            except (OSError, ValueError):  # a name that no file can have
                break
        raise ArgumentError(
            f"model: given {text!r}, expected a path ending in .toml or "
            f"{closest(text, model_names())}"
        )
    path = Path(text)
    try:
        exists = path.exists()
        regular = path.is_file()
    except (OSError, ValueError):
        exists = regular = False
    if not exists:
        raise ArgumentError(
            f"model: given {text!r}, which does not exist, expected the path of a .toml file"
        )
    if not regular:
        raise ArgumentError(
            f"model: given {text!r}, which is not a file, expected the path of a .toml file"
        )
    return path, text, chosen


class _NoSuchPath(Exception):
    """A dotted path does not exist; the text is what was expected."""


def _walk(root: Entry, dotted: str) -> tuple[Entry, Any]:
    """The table or list that holds the last part of a dotted path, and that part as a key or an
    index.
    """
    words = dotted.split(".")
    here = root
    for n, word in enumerate(words):
        key, known = part_of(here, word)
        last = n == len(words) - 1
        if last and isinstance(here.value, dict):
            return here, word
        if key is None:
            raise _NoSuchPath(f"{closest(word, known)} instead of {show(word)}")
        if last:
            return here, key
        here = here.value[key]
    raise AssertionError("a split text has at least one part")


def _set(root: Entry, dotted: str, value: Entry) -> None:
    holder, key = _walk(root, dotted)
    holder.value[key] = value


def _remove(root: Entry, dotted: str) -> None:
    holder, key = _walk(root, dotted)
    if isinstance(holder.value, dict) and key not in holder.value:
        raise _NoSuchPath(f"{closest(key, holder.value)} instead of {show(key)}")
    del holder.value[key]


class _Variant:
    """The changes of a variant."""

    def __init__(self, table: Table) -> None:
        values = read_table(table, VARIANT, Context())
        self.table = table
        self.sets = values["set"]
        self.removes = values["remove"]

    def apply(self, root: Entry) -> None:
        """Apply the removals, then the new values."""
        for dotted in self.removes:
            try:
                _remove(root, dotted)
            except _NoSuchPath as error:
                raise self.table.fail("remove", str(error), show(dotted)) from None
        if self.sets is None:
            return
        for dotted, value in self.sets.entries.items():
            try:
                _set(root, dotted, toml_lines.copy(value))
            except _NoSuchPath as error:
                raise self.sets.fail(dotted, str(error), show(dotted)) from None


def _variants(root: Entry, shown: str) -> dict[str, _Variant]:
    """Read the variants and remove them from the tree."""
    if "variant" not in root.value:
        return {}
    out: dict[str, _Variant] = {}
    tables = Table(shown, root.value.pop("variant"), "variant")
    for name, entry in tables.entries.items():
        problem = identifier_problem(name)
        if problem is not None:
            raise tables.fail(name, problem, show(name))
        out[name] = _Variant(Table(shown, entry, tables.path(name)))
    return out


def _override(root: Entry, shown: str, key: Any, value: Any) -> Any:
    """Set a value, and return it as plain data."""
    if not isinstance(key, str):
        raise ArgumentError(f"overrides: given the key {key!r}, expected a dotted path")
    plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    where = f"{shown}, changed by --set or overrides"
    try:
        toml_lines.check_depth(plain)
        _set(root, key, toml_lines.wrap(plain, 0, where))
    except toml_lines.TextError as error:
        raise ArgumentError(
            f"overrides {key}: given {error.given}, expected {error.expected}"
        ) from None
    except _NoSuchPath as error:
        raise ModelError(where, 0, key or '""', "a path that does not exist", str(error)) from None
    return deepcopy(plain)


def _robot(root: Table, variant: str, variants: tuple[str, ...]) -> RobotModel:
    """The model of a table; names of uncertain numbers are checked against those that it has."""
    found = read_table(root, MODEL, Context())
    robot = RobotModel(
        **found, variant=variant, variants=variants, file=root.file, text=_canonical(root)
    )
    if robot.loops or any(dof.passive is not None for e in robot.elements for dof in e.dofs):
        from flexgen.model.format.loop_checks import check_loops

        check_loops(root, robot)
    if robot.lines:
        from flexgen.model.format.line_checks import check_lines

        check_lines(root, robot)
    if robot.uncertainty is not None and robot.uncertainty.parameters:
        known = find_function("RobotModel.numbers")(robot)
        for name in robot.uncertainty.parameters:
            if name not in known:
                near = ", ".join(get_close_matches(name, known, 3, cutoff=0.0))
                table = Table(root.file, root.entries["uncertainty"], "uncertainty")
                raise table.fail(
                    "parameters", f"names of single numbers, such as {near}", show(name)
                )
    return robot


def _check_inertia(root: Entry, robot: RobotModel) -> None:
    """Raise an error for a coordinate of a URDF chain that moves no inertia: the inertia matrix is
    singular.
    """
    from flexgen.model.inertia import massless_coordinates

    massless = massless_coordinates(robot)
    for element in root.value["element"].value if massless else ():
        for dof in element.value["dof"].value if "dof" in element.value else ():
            if dof.value["name"].value == massless[-1]:
                what = "coordinates" if len(massless) > 1 else "coordinate"
                raise ModelError(
                    dof.file,
                    dof.line,
                    f"joint.{massless[-1]}",
                    f"the {what} {', '.join(massless)}, which can move without moving any mass",
                    "links with mass and inertia behind every joint (in the overlay: "
                    "[link.NAME] body = { mass = ..., com = [...], inertia = [...] }, a "
                    "payload, or a rotor inertia)",
                )


def _canonical(root: Table) -> str:
    """Canonical text of the data: sorted keys, every number as a float, no description and no
    uncertainty.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list):
            return [plain(item) for item in value]
        return float(value) if isinstance(value, int) and not isinstance(value, bool) else value

    unused = ("description", "source", "uncertainty", "not_measured")
    data = {
        key: toml_lines.unwrap(entry) for key, entry in root.entries.items() if key not in unused
    }
    return json.dumps(plain(data), sort_keys=True, ensure_ascii=True)
