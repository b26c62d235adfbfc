"""The part of YAML that files of closed loops need, against PyYAML."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from flexgen.base.spec.toml_lines import TextError, unwrap
from flexgen.model.urdf.yaml_text import parse

HAND = """# by hand
ball_loops:
  # left
  - name: l_c
    parent: la
    xyz: [0.05, -0.0292, -0.026]

  - name: x   # a name
    axis:
      - 1
      - 2.0
pin: 'a # b'
b: {x: 1, 'y': [a, b c, d], z: {}, "w": -3.5e+3}
pairs: [['a_1', 'b_2'], ['c', 'd']]
"""


def test_a_text_by_hand_is_read() -> None:
    assert unwrap(parse(HAND, "f")) == yaml.safe_load(HAND)
    assert parse(HAND, "f").value["pin"].line == 12


@pytest.mark.parametrize("style", [None, True, False])
@pytest.mark.parametrize("seed", range(10))
def test_what_pyyaml_writes_is_read(style: bool | None, seed: int) -> None:
    """In its three styles, with lines that it breaks."""
    rng = np.random.default_rng(seed)

    def name() -> str:
        return "joint_" * int(rng.integers(1, 5)) + str(rng.integers(1000))

    data = {
        "closures": [
            {
                "link_a": name(),
                "link_b": f"{name()} b",
                "point": rng.standard_normal(3).round(8).tolist(),
                "axis": rng.integers(-1, 2, 3).tolist(),
            }
            for _ in range(rng.integers(1, 4))
        ],
        "dependent": [name() for _ in range(rng.integers(0, 12))],
        "flag": bool(rng.integers(2)),
        "empty": {},
    }
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=style)
    assert unwrap(parse(text, "f")) == yaml.safe_load(text) == data


@pytest.mark.parametrize(
    ("text", "line", "given"),
    [
        ("a: 1\nb: [1, 2\n", 2, "a bracket that is not closed"),
        ("a: &x 1", 1, '"&x 1"'),
        ("a: *x", 1, '"*x"'),
        ("a: !!python/name:os.system", 1, '"!!python'),
        ("a: |\n  text", 1, '"|"'),
        ("a: 1\n  b: 2\n", 2, '"b: 2"'),
        ("a: 1\nfoo\n", 2, '"foo"'),
        ("\ta: 1", 1, "a tab"),
        ("a: 1\n\na: 2", 3, 'a second key "a", the first one is in line 1'),
        ("a: {b: 1, b: 2}", 1, "a second key"),
        ("a: [1,,2]", 1, '","'),
        ("a: [1 2, {]}", 1, '"}"'),
        ("a: {b}", 1, '"}"'),
        ("a: [1] 2", 1, '"2"'),
        ("a: " + "[" * 40 + "]" * 40, 1, "a value nested too deeply"),
        ("---\na: 1\n---\nb: 2", 3, '"---"'),
    ],
)
def test_other_texts_are_refused_with_their_line(text: str, line: int, given: str) -> None:
    with pytest.raises(TextError) as found:
        parse(text, "f")
    assert found.value.line == line and found.value.given.startswith(given)
