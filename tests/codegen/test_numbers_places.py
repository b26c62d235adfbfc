"""Where things lie: rows of arrays in a workspace, sensors and outputs in the overlay of a URDF
file.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.codegen.statements import routine, step_text
from flexgen.codegen.statements.layout import LONGEST, column_stride
from flexgen.codegen.statements.literals import literal
from flexgen.codegen.statements.pivot_guards import EPSILON
from flexgen.codegen.statements.step_text import StepText
from flexgen.exports.urdf.overlay_tables import beam_or_drag, output_table, sensor_table
from flexgen.model.elements import Output


@pytest.mark.parametrize(("precision", "size"), [("double", 8), ("single", 16)])
def test_rows_begin_an_odd_number_of_whole_vectors_apart(precision: str, size: int) -> None:
    """As few as the columns need: 64 bytes each, and never a power of two above one of them."""
    assert LONGEST[precision] == size
    for n in range(1, 200):
        vectors, rest = divmod(column_stride(n, precision), size)
        assert rest == 0 and vectors % 2 == 1 and (vectors - 2) * size < n <= vectors * size


def test_sensors_of_an_overlay_lie_in_the_frames_of_links() -> None:
    """Those of an element are shifted as its body frame is, that of the tool is not."""
    shifts = {"upper": np.array([0.1, 0.2, -0.3]), TOOL: np.array([9.0, 9.0, 9.0])}
    fields: dict[str, Any] = {
        "name": "acc",
        "type": "accelerometer",
        "place": "upper",
        "position": (1.0, 2.0, 3.0),
    }
    fields |= {
        "axes": ((1.0, 0.0, 0.0),),
        "labels": ("x",),
        "noise": 0.1,
        "sample_s": None,
        "delay_s": 0.0,
    }
    made = Sensor(**fields, unit="m/s^2")
    assert_allclose(sensor_table(made, shifts)["position"], [1.1, 2.2, 2.7])
    assert tuple(sensor_table(replace(made, place="fore"), shifts)["position"]) == (1.0, 2.0, 3.0)
    tool = sensor_table(replace(made, place=TOOL), shifts)
    assert tuple(tool["position"]) == (1.0, 2.0, 3.0) and (tool["name"], tool["type"]) == (
        "acc",
        "accelerometer",
    )


def test_outputs_of_an_overlay_name_their_coordinates() -> None:
    """Weighted sums without the coordinates that have no weight."""
    elbow = flexgen.read("elbow")
    assert output_table(elbow) == {"type": "tool_position", "axes": "xz"}
    sums = replace(
        elbow, output=Output("combination", weights=((0.5, 0.0), (1.0, -2.0)), unit="rad")
    )
    rows = [{"q1": 0.5}, {"q1": 1.0, "q2": -2.0}]
    assert output_table(sums) == {"type": "combination", "unit": "rad", "rows": rows}


def test_what_an_overlay_has_no_key_for_is_refused() -> None:
    """Beams, and rotational drags of bodies and of the payload."""
    elbow: Any = flexgen.read("elbow")
    beam_or_drag(elbow)
    first, second = elbow.elements
    drag = replace(second, body=replace(second.body, rotational_drag=0.1))
    for model, told in (
        (
            replace(elbow, elements=(first, drag)),
            "element.fore.body.rotational_drag: given a rotational_drag, expected",
        ),
        (
            replace(elbow, payload=replace(elbow.payload, rotational_drag=0.1)),
            "payload.rotational_drag: given a drag",
        ),
        (flexgen.read("beam_arm"), "beam: given a beam, expected for URDF an element without it"),
    ):
        with pytest.raises(ModelError) as refused:
            beam_or_drag(model)
        assert told in str(refused.value)


def test_texts_of_loops_state_their_operations(monkeypatch: pytest.MonkeyPatch) -> None:
    """And which outputs they take, in the order of the outputs, and whether they check their
    results.
    """
    names = ("solve", "factor", "products", "columns", "sums", "selected", "zeros")
    seen: dict[str, Any] = {}

    def text_of(name: str) -> Any:
        def text(*given: Any) -> Any:
            seen[name] = given
            return (name, 11, 12) if name == "columns" else name

        return text

    for name in names:
        monkeypatch.setattr(step_text, f"{name}_text", text_of(name))

    def made(kind: Any, **fields: Any) -> Any:
        step = object.__new__(kind)
        for name, value in fields.items():
            object.__setattr__(step, name, value)
        return step

    def text(step: Any) -> StepText:
        layout: Any = "layout"
        return step_text.step_text("f", step, layout, {"M": 4, "b": 2, "x": 1}, "double")

    # figures of the steps themselves
    for kind in (routine.Solve, routine.Factor, routine.Products):
        for name, value in (("operations", 7), ("depth", 8), ("ports", ("x", "M"))):
            monkeypatch.setattr(kind, name, value, raising=False)
    solve = made(routine.Solve, n=3)
    assert text(solve) == StepText("solve", 7, 8, ("M", "x"), True)
    assert seen["solve"][-1] == literal(3 * EPSILON["double"], precision="double") and seen[
        "solve"
    ][:2] == ("f", solve)
    assert text(made(routine.Factor, n=3)) == StepText("factor", 7, 8, (), True)
    assert text(made(routine.Products, target="b")) == StepText("products", 7, 8, ("b",), True)
    assert text(made(routine.Products, target="w")) == StepText("products", 7, 8, (), True)
    assert text(made(routine.Columns, n=5)) == StepText("columns", 55, 12, (), False)
    assert text(made(routine.Sums, rows=3, at=(0, 1, 2, 3))) == StepText("sums", 12, 16, (), False)
    assert text(made(routine.Selected)) == StepText("selected", 0, 0, (), False)
    assert text(made(routine.Zeros)) == StepText("zeros", 0, 0, (), False)
