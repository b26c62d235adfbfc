"""Closed loops as <constraint> of a URDF file: read back, the equations are the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.model.elements import LoopFrame
from tests.support.linkages import FOUR_BAR, drawn_text, read_text
from tests.support.loop_difference import loop_difference


def written(model: flexgen.RobotModel, folder: Path) -> Path:
    return Path(flexgen.export_urdf(model, folder / "arm.urdf").details["overlay"])


@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_drawn_loops_are_read_back(spatial: bool, seed: int, tmp_path: Path) -> None:
    model = read_text(tmp_path, drawn_text(np.random.default_rng(seed), spatial))
    again = flexgen.read(written(model, tmp_path))
    assert [c.name for c in again.coordinates] == [c.name for c in model.coordinates]
    assert loop_difference(again, model) < 1e-12


def test_a_length_that_is_off_by_1_mm_is_seen(tmp_path: Path) -> None:
    model = read_text(tmp_path, FOUR_BAR)
    overlay = written(model, tmp_path)
    urdf = tmp_path / "arm.urdf"
    text = urdf.read_text(encoding="utf-8")
    assert text.count('"-0.18 0 0"') == 1
    urdf.write_text(text.replace('"-0.18 0 0"', '"-0.181 0 0"'), encoding="utf-8")
    assert loop_difference(flexgen.read(overlay), model) > 1e-4


def ends(model: flexgen.RobotModel) -> tuple[LoopFrame, LoopFrame]:
    return model.loops[0].start, model.loops[0].end


@pytest.mark.parametrize("kind", ["point", "axis"])
def test_the_type_of_a_loop_is_kept(kind: str, tmp_path: Path) -> None:
    """A pin whose axis is not that of the frames of the links."""
    across = "rotation = [1, 0, 0, 0, 0, -1, 0, 1, 0]"
    text = FOUR_BAR.replace(
        "position = [0.35, 0, 0] }\nto", f"position = [0.35, 0, 0], {across} }}\nto"
    )
    text = text.replace("position = [-0.18, 0, 0] }", f"position = [-0.18, 0, 0], {across} }}")
    text = text.replace('name = "bar"\n', f'name = "bar"\ntype = "{kind}"\n', 1)
    model = read_text(tmp_path, text)
    again = flexgen.read(written(model, tmp_path))
    assert [loop.type for loop in again.loops] == [kind]
    for one, other in zip(ends(model), ends(again), strict=True):
        assert one.element.startswith(other.element[:3])
        if kind == "axis":
            z = np.array(one.rotation)[:, 2] - np.array(other.rotation)[:, 2]
            assert np.abs(z).max() < 1e-15
    assert loop_difference(again, model) < 1e-12
