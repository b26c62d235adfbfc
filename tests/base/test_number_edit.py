"""Numbers of a model file changed in its text: values arrive, comments and all other lines
stay.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.spec.number_edit import with_numbers
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.model.reader import model_names

MODELS = Path(__file__).resolve().parents[2] / "models"
NAMES = [name for name in model_names() if name != "urdf_arm"]

TEXT = """\
# head
[[motor]]
name = "m1"  # first
inertia = 1e-3 # kg m^2
friction = { viscous = 0.1 }

[[motor]]
name = "m2"

[motor.friction]
viscous = 0.2
"""


@pytest.mark.parametrize("name", NAMES)
def test_every_number_comes_back(name, tmp_path):
    """Also numbers that the file does not have: frictions that are zero, a payload."""
    model = flexgen.read(name)
    chosen = select(
        model, ["payload", "stiffness", "damping", *(f"{m.name}.viscous" for m in model.motors)]
    )
    values = {p.name: 1.25 * p.value + 1e-3 for p in chosen}
    old = (MODELS / f"{name}.toml").read_text()
    new = with_numbers(
        old, {p.key: values[p.name] for p in chosen}, name, {p.key: "measured" for p in chosen}
    )
    (tmp_path / "new.toml").write_text(new)
    found = flexgen.read(tmp_path / "new.toml")
    expected = with_values(model, values)
    assert (found.elements, found.motors, found.payload) == (
        expected.elements,
        expected.motors,
        expected.payload,
    )
    comments = [line for line in old.splitlines() if line.strip().startswith("#")]
    assert all(line in new.splitlines() for line in comments)


def test_comments_and_other_lines_stay():
    new = with_numbers(TEXT, {"motor.m1.inertia": 2e-3, "motor.m2.friction.viscous": 0.5})
    assert new == TEXT.replace("1e-3", "0.002").replace("0.2", "0.5")


def test_missing_keys_are_added_to_their_table():
    numbers = {
        "motor.m1.friction.coulomb": 1.0,
        "motor.m2.friction.beta": 20.0,
        "motor.m2.inertia": 0.1,
    }
    new = with_numbers(TEXT, numbers, sources={"motor.m1.friction.coulomb": "sd 1 %"})
    assert "friction = { viscous = 0.1, coulomb = 1.0 }  # sd 1 %\n" in new
    assert "[motor.friction]\nbeta = 20.0\nviscous = 0.2\n" in new
    assert '[[motor]]\ninertia = 0.1\nname = "m2"\n' in new


def test_tables_of_the_root_are_added_at_the_end():
    new = with_numbers(TEXT, {"payload.mass": 2.0, "payload.com.1": 0.5})
    assert new.endswith("\n[payload]\nmass = 2.0\ncom = [0.0, 0.5, 0.0]\n")


@pytest.mark.parametrize(
    ("numbers", "row"),
    [
        ({"a.1": 5.0}, "a = [1.0, 5.0]"),
        ({"a.2": 5.0}, "a = [1.0, 2.0, 5.0]"),
        ({"a.4": 5.0, "a.2": 3.0}, "a = [1.0, 2.0, 3.0, 0.0, 5.0]"),
        ({"b.x.y": 5.0}, "x = { y = 5.0 }"),
        ({"b.x.y": 5.0, "b.x.z.4": 2.0}, "x = { y = 5.0, z = [0.0, 0.0, 0.0, 0.0, 2.0] }"),
        ({"b.x.1": 2.0}, "x = [0.0, 2.0, 0.0]"),
        ({"d.0.e": 5.0}, "e = 5.0"),
    ],
)
def test_entries_of_lists_and_tables_are_replaced_or_added(numbers, row):
    """A new list of numbers has three at least; those between are zero."""
    new = with_numbers("a = [1.0, 2.0]\n[b]\nc = 3.0\n[[d]]\ne = 4.0\n", numbers)
    assert row in new.splitlines()
    assert len(new.splitlines()) == 5 + ("x" in row)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (
            "a.6",
            1.0,
            r"robot\.toml:1:a\.6: given nothing of this name, expected a part of the mod",
        ),
        ("motor.m1.inertia.kg.g", 1.0, r"robot\.toml:5:motor\.m1\.inertia\.kg: given nothing"),
        ("motor.m3.inertia", 1.0, "nothing of this name, expected a part of the model"),
        ("motor.m1.friction", 1.0, "a table or list, expected a number"),
        ("motor.m1.inertia", float("nan"), "nan, expected a finite number"),
        ("motor.m1.inertia.kg", 1.0, "nothing of this name"),
    ],
)
def test_wrong_paths_are_refused(path, value, words):
    with pytest.raises(ModelError, match=words):
        with_numbers("a = [1.0, 2.0]\n" + TEXT, {path: value}, "robot.toml")


def test_line_ends_of_windows_are_read():
    assert "inertia = 0.002 #" in with_numbers(
        TEXT.replace("\n", "\r\n"), {"motor.m1.inertia": 2e-3}
    )
