"""Values nested up to a depth, and angles with the unit of their key."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import pytest

from flexgen.base.errors import ModelError
from flexgen.base.spec import toml_lines
from flexgen.base.spec.tables import Table
from flexgen.base.spec.toml_lines import TextError


def test_values_are_nested_up_to_the_stated_depth() -> None:
    """Of lists and of tables, which the text may mix."""
    for wrap in (lambda x: [x], lambda x: {"a": x}):
        data: Any = wrap(1)
        for _ in range(toml_lines.DEPTH):
            toml_lines.check_depth(data)
            data = wrap(data)
        with pytest.raises(TextError) as caught:
            toml_lines.check_depth(data)
        assert f"at most {toml_lines.DEPTH} levels" in caught.value.expected


@pytest.mark.parametrize(
    ("keys", "required", "expected"),
    [
        (("pose_rad",), True, "pose_rad"),
        (("pose_deg", "other"), True, "pose_deg"),
        ((), False, None),
        ((), True, "pose_rad: pose_rad or pose_deg"),
        (("pose_rad", "pose_deg"), False, "pose_deg: one of the two"),
    ],
)
def test_angles_have_one_key_with_their_unit(
    keys: tuple[str, ...], required: bool, expected: str | None
) -> None:
    """Of `flexgen.base.spec.tables`: the errors name the key."""

    def fail(key: str, wanted: str, given: str = "") -> Exception:
        return ModelError("a.toml", 1, key, given, wanted)

    table: Any = Made(entries=dict.fromkeys(keys), fail=fail)
    try:
        found = Table.unit_key(table, "pose", required)
    except ModelError as error:
        found = f"{error.key}: {error.expected}"
    assert found == expected
